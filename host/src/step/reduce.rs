//! What a balance is to each tool: wrench, tangent, gap and, if asked for, rows.
//!
//! Entry point: [`reduce`].

use super::path::{NEAR, Targets, displaced, nearest};
use super::{Row, State, StepReport, Workspace};
use crate::contact::reduction::{MAX_TOOL_ROWS, Surroundings, ToolRows};
use crate::contact::shape::Solid;
use crate::contact::tangent;
use crate::model::Model;
use crate::tool::ToolSample;
use nalgebra::Vector3;

/// Vertices that will be touched at once, in radii: as far as one is nearer than another.
const AT_ONCE: f64 = 1e-3;

/// Wrenches, tangents, gaps, rows and the energy at the balance.
pub(super) fn reduce(
    model: &Model,
    state: &State,
    samples: &[ToolSample],
    targets: &Targets,
    work: &mut Workspace,
    report: &mut StepReport,
) {
    report.tools = samples.len();
    for (contact, sample) in report.contacts.iter_mut().zip(samples) {
        contact.id = sample.id;
        // Read once already: the id is known and its shape is there.
        let Some((index, _)) = model.tool(sample.id) else {
            continue;
        };
        let (Some(solid), Some(_)) = (work.solids[index], targets[index]) else {
            continue;
        };
        let tool = index as u32;
        let grip = Vector3::from(sample.position_m);
        contact.rows = state.rows.iter().filter(|row| row.tool == tool).count() as u32;
        let wrench = tangent::wrench(&state.rows, tool, &grip, &work.contact);
        let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
        let moment: Vector3<f64> = wrench.fixed_rows::<3>(3).into();
        let mut tangent =
            work.pose
                .differentiate(&state.rows, tool, &grip, &moment, &mut work.contact);
        let mut rows = ToolRows::NONE;
        let most_rows = work.most_rows.min(MAX_TOOL_ROWS);
        let ahead_m = Vector3::from(work.ahead_m);
        if contact.rows > 0 {
            let normal = force.try_normalize(0.0).unwrap_or_else(Vector3::z);
            contact.normal = normal.into();
            if most_rows > 0 && !work.spares_rows {
                let near = (ahead_m, NEAR * solid.radius(), most_rows);
                rows_of(state, tool, &grip, &solid, near, work, &mut rows);
            }
        } else {
            let (gap, normal) = apart(&solid, work);
            contact.gap_m = gap.max(0.0);
            contact.normal = normal.into();
            let reach_m = NEAR * solid.radius() + work.reach_m;
            let soon = || {
                let then = nearest(displaced(work), &solid.moved(&ahead_m));
                then.is_some_and(|(_, gap)| gap < reach_m)
            };
            // Rows that are spared say how it will be when it touches, as those that are sent would.
            if gap < reach_m || (most_rows > 0 && soon()) {
                let at_once = contact.gap_m + AT_ONCE * solid.radius();
                let near = if most_rows > 0 {
                    (ahead_m, reach_m, MAX_TOOL_ROWS)
                } else {
                    (Vector3::zeros(), at_once, MAX_TOOL_ROWS)
                };
                rows_of(state, tool, &grip, &solid, near, work, &mut rows);
                let dense = &mut work.contact.newton.dense;
                tangent = work.reduction.coming(&rows, at_once, dense);
                rows.truncate(most_rows);
            }
        }
        if most_rows > 0 && !work.spares_rows {
            rows.tool = sample.id;
            for id in &mut rows.id[..rows.count] {
                *id = model.touchable[*id as usize];
            }
            work.rows.push(rows);
        }
        contact.wrench = wrench.into();
        contact.tangent = tangent.transpose().into();
    }
    let potential_j = model.body.potential_j(&state.motion, &work.body);
    report.stored_energy_j = match potential_j {
        Some(potential_j) => potential_j - model.resting_potential_j,
        None => {
            let work_of = |row: &Row| {
                let at = 3 * row.vertex as usize;
                row.force
                    .dot(&Vector3::from_column_slice(&work.displacement[at..at + 3]))
            };
            0.5 * state.rows.iter().map(work_of).sum::<f64>()
        }
    };
}

/// Gap to the nearest vertex \[m\], and the normal there, out of the tissue.
fn apart(solid: &Solid, work: &Workspace) -> (f64, Vector3<f64>) {
    let near = nearest(displaced(work), solid);
    let Some((vertex, gap)) = near else {
        return (f64::MAX, Vector3::z());
    };
    let u = Vector3::from_column_slice(&work.displacement[3 * vertex..3 * vertex + 3]);
    let touch = solid.touch(&(work.resting_m[vertex] + u));
    (gap, touch.map_or_else(Vector3::z, |touch| -touch.normal))
}

fn rows_of(
    state: &State,
    tool: u32,
    grip: &Vector3<f64>,
    solid: &Solid,
    (ahead_m, most_gap, most_rows): (Vector3<f64>, f64, usize),
    work: &mut Workspace,
    rows: &mut ToolRows,
) {
    let around = Surroundings {
        tool,
        grip: *grip,
        solid,
        columns: &work.columns,
        resting_m: &work.resting_m,
        displacement: &work.displacement,
        ahead_m,
        most_gap,
        most_rows,
    };
    work.reduction
        .rows_of(&state.rows, &around, &mut work.contact, &work.pose, rows);
}
