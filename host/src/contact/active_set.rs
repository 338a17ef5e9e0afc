//! Which vertices touch: the set by signs around the Newton steps of `newton`.
//!
//! Entry point: [`solve`]. After each step rows that pull are dropped and vertices inside a tool added
//! (primal-dual active set, Hintermueller, Ito & Kunisch 2002).

use super::newton::{self, Newton};
use super::shape::Solid;
use crate::columns::Columns;
use crate::tool::MAX_TOOLS;
use nalgebra::Vector3;
use serde::Serialize;

/// Most rows at once, of all tools: what a punch of eight edges' radius touches.
pub(crate) const MAX_ROWS: usize = 192;
/// Newton steps before a solve is given up: five reach round-off when the set is right.
const MAX_ITERATIONS: u32 = 40;
/// Steps after which the set changes by one row at a time, which cannot go round in circles as
/// easily as changing it everywhere at once.
const CAREFUL_AFTER: u32 = 12;
/// Balance: largest gap over radius, and largest tangential over largest force.
const TOLERANCE: f64 = 1e-11;
/// A vertex counts as inside a tool when it is deeper than this part of the tool's radius.
pub(crate) const DEPTH: f64 = 1e-10;

/// One vertex touched by one tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Row {
    /// Among the touchable vertices.
    pub vertex: u32,
    /// Index of the tool.
    pub tool: u32,
    /// Force of the tool on the tissue \[N\].
    pub force: Vector3<f64>,
}

/// The tools' shapes where they are; a tool that was not sampled touches nothing.
pub(crate) type Solids = [Option<Solid>; MAX_TOOLS];

/// Why there is no balance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    Missing,
    TooManyRows,
    NotConverged,
}

/// Buffers of the solve, at their largest size; after a solve they describe the balance found.
pub(crate) struct ContactWork {
    pub newton: Newton,
    /// Vertices near a tool, and which.
    pub near: Vec<Near>,
    /// Near vertices whose columns a solve asked for and did not find.
    pub missing: Vec<u32>,
    /// Near vertices inside their tool, with their gap over its radius.
    entering: Vec<(f64, Near)>,
    pub iterations: u32,
    pub residual: f64,
}

/// A vertex that a tool might touch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Near {
    pub vertex: u32,
    pub tool: u32,
    /// Gap when it was listed, in radii.
    pub gap: f64,
}

impl ContactWork {
    /// For a model with so many touchable vertices and tools.
    pub fn new(vertices: usize, tools: usize) -> Self {
        Self {
            newton: Newton::new(MAX_ROWS.min(vertices)),
            near: Vec::with_capacity(vertices * tools),
            missing: Vec::with_capacity(vertices),
            entering: Vec::with_capacity(vertices * tools),
            iterations: 0,
            residual: 0.0,
        }
    }
}

/// Finds the balance with the tools where they are, starting from `rows`.
pub(crate) fn solve(
    solids: &Solids,
    resting: &[Vector3<f64>],
    columns: &Columns,
    rows: &mut Vec<Row>,
    work: &mut ContactWork,
) -> Result<(), Failure> {
    work.newton.clear();
    work.residual = 0.0;
    let mut changed = !rows.is_empty();
    for iteration in 0..MAX_ITERATIONS {
        let all_at_once = iteration < CAREFUL_AFTER;
        if rows.is_empty() || iteration == 0 {
            changed |= update_set(solids, resting, columns, rows, work, all_at_once)?;
            if rows.is_empty() {
                return Ok(());
            }
        }
        if changed {
            work.newton.condense(columns, rows)?;
        }
        work.residual = work.newton.look(solids, resting, columns, rows)?;
        if work.residual <= TOLERANCE && !changed {
            return work.newton.finish();
        }
        work.newton.step(solids, rows)?;
        work.iterations += 1;
        changed = update_set(solids, resting, columns, rows, work, all_at_once)?;
    }
    Err(Failure::NotConverged)
}

/// Drops rows that pull and adds near vertices that are inside their tool, all at once or only the
/// worst. Whether anything changed.
fn update_set(
    solids: &Solids,
    resting: &[Vector3<f64>],
    columns: &Columns,
    rows: &mut Vec<Row>,
    work: &mut ContactWork,
    all_at_once: bool,
) -> Result<bool, Failure> {
    work.missing.clear();
    work.entering.clear();
    for near in &work.near {
        let held = |row: &Row| row.vertex == near.vertex && row.tool == near.tool;
        let Some(solid) = &solids[near.tool as usize] else {
            continue;
        };
        if rows.iter().any(held) {
            continue;
        }
        let at = resting[near.vertex as usize] + newton::displacement(columns, rows, near.vertex);
        let gap = solid.gap(&at) / solid.radius();
        if gap < -DEPTH {
            work.entering.push((gap, *near));
            if !columns.has(near.vertex) && !work.missing.contains(&near.vertex) {
                work.missing.push(near.vertex);
            }
        }
    }

    // The multiplier of the last Newton step acts along the normal that the step started from. A row
    // that has not seen a step yet stays.
    let geometry = &work.newton.geometry;
    let pulls = |index: usize, row: &Row| {
        geometry
            .get(index)
            .map_or(0.0, |geometry| geometry.normal.dot(&row.force))
    };
    let before = rows.len();
    if all_at_once {
        let mut index = 0;
        rows.retain(|row| {
            index += 1;
            pulls(index - 1, row) >= 0.0
        });
    } else {
        let forces = rows
            .iter()
            .enumerate()
            .map(|(index, row)| (pulls(index, row), index));
        if let Some((force, index)) = forces.min_by(|a, b| a.0.total_cmp(&b.0))
            && force < 0.0
        {
            rows.remove(index);
            return Ok(true);
        }
        // No row pulls: let the deepest vertex in.
        work.entering.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        work.entering.truncate(1);
    }

    if !work.missing.is_empty() {
        return Err(Failure::Missing);
    }
    if rows.len() + work.entering.len() > work.newton.most_rows() {
        return Err(Failure::TooManyRows);
    }
    rows.extend(work.entering.iter().map(|(_, near)| Row {
        vertex: near.vertex,
        tool: near.tool,
        force: Vector3::zeros(),
    }));
    Ok(rows.len() != before || !work.entering.is_empty())
}
