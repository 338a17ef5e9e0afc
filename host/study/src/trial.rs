//! How fast steps will be on a mesh that no scene has yet: the real factorisation, columns and steps of a
//! sphere pressed into it, timed here and now.
//!
//! Entry point: [`trial`]. Nothing is extrapolated: the figures are medians of what ran on this machine.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;
use sutura_host::fem::{LinearTissue, Loads, Material};
use sutura_host::mesh::{Surface, TetMesh};
use sutura_host::model::{LEAST_RADIUS_IN_EDGES, Model, ModelError};
use sutura_host::scene::Pose;
use sutura_host::script::at_rest;
use sutura_host::step::{State, Status, StepOptions, Workspace, step};
use sutura_host::tool::Tool;

/// Any soft tissue: the time does not depend on it.
const MATERIAL: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};
/// Steps of one press, and presses: a finger takes a quarter of a second for one, at 200 steps a second.
const STEPS: u32 = 50;
const PRESSES: u32 = 3;

/// Times of one mesh on this machine.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Trial {
    /// Assembly and factorisation, with the lowest nodes fixed \[ms\].
    pub factor_ms: f64,
    /// Memory of the factor \[MB\].
    pub factor_mb: f64,
    /// The compliance columns of one vertex, when it is touched for the first time \[us\].
    pub column_us: f64,
    /// Median of the deeper steps of the press, with all columns at hand \[us\]; `None` if none had a rest.
    pub step_us: Option<f64>,
    /// Vertices that the sphere touched at most: the rows of the step.
    pub step_rows: u32,
    /// Radius of the sphere \[m\].
    pub step_radius_m: f64,
    /// How the last step ended, `ok` if all is well.
    pub step_status: &'static str,
}

/// Fixes the lowest nodes of every connected part of `mesh` and presses a sphere on its highest vertex, large enough for about
/// `rows` vertices to be touched.
///
/// # Errors
/// What [`Model::new`] refuses: a mesh that its lowest nodes do not hold, as where they are on one line.
pub fn trial(mesh: &TetMesh, rows: u32) -> Result<Trial, ModelError> {
    let fixed = lowest(mesh);
    let started = Instant::now();
    let tissue = LinearTissue::new(mesh, MATERIAL, &fixed)?;
    let factor_ms = 1e3 * started.elapsed().as_secs_f64();
    let factor_mb = 1e-6 * (size_of::<f64>() * tissue.factor_entries()) as f64;
    drop(tissue);

    let surface = mesh.surface();
    let radius_m = radius(&surface, rows);
    let tool = Tool::sphere(radius_m, [0.0; 3]);
    let model = Model::new(mesh, MATERIAL, &fixed, Loads::default(), &[(0, tool)])?;
    let mut trial = Trial {
        factor_ms,
        factor_mb,
        column_us: 0.0,
        step_us: None,
        step_rows: 0,
        step_radius_m: radius_m,
        step_status: Status::Ok.name(),
    };
    let mut state = State::new(&model);
    let mut work = Workspace::new(&model);
    let (top, normal) = highest(mesh, &surface);
    let started = Instant::now();
    let count = work.prepare(&model, |at| (Vector3::from(at) - top).norm() < radius_m);
    trial.column_us = 1e6 * started.elapsed().as_secs_f64() / count.max(1) as f64;

    let mut times: Vec<(u32, f64)> = Vec::new();
    for number in 0..=PRESSES * STEPS {
        // A quarter of the radius touches an area of about a quarter of the sphere's disc.
        let deep = 0.5 - 0.5 * (std::f64::consts::TAU * f64::from(number) / f64::from(STEPS)).cos();
        let pose = Pose {
            position_m: (top + normal * radius_m * (1.01 - 0.26 * deep)).into(),
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let started = Instant::now();
        let report = step(
            &model,
            &mut state,
            &[at_rest(0, &pose)],
            &StepOptions::default(),
            &mut work,
        );
        let us = 1e6 * started.elapsed().as_secs_f64();
        if report.status != Status::Ok {
            trial.step_status = report.status.name();
        } else if report.columns_computed == 0 {
            times.push((report.rows, us));
        }
    }
    trial.step_rows = times.iter().map(|(rows, _)| *rows).max().unwrap_or(0);
    // The deeper half of the press: nearly as many rows as at the deepest.
    times.retain(|(rows, _)| *rows > 0 && 5 * rows >= 4 * trial.step_rows);
    times.sort_by(|a, b| a.1.total_cmp(&b.1));
    trial.step_us = times.get(times.len() / 2).map(|(_, us)| *us);
    Ok(trial)
}

/// Nodes of the lowest tenth of each connected part, or of more of it until three are there.
fn lowest(mesh: &TetMesh) -> Vec<u32> {
    let mut parts: BTreeMap<u32, Vec<(u32, f64)>> = BTreeMap::new();
    for ((node, part), x) in (0u32..).zip(connected(mesh)).zip(mesh.points_m()) {
        parts.entry(part).or_default().push((node, x[2]));
    }
    let lowest_of = |nodes: &Vec<(u32, f64)>| -> Vec<u32> {
        let heights = nodes.iter().map(|(_, z)| *z);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| {
            (low.min(z), high.max(z))
        });
        let below = |share: f64| -> Vec<u32> {
            let chosen = nodes
                .iter()
                .filter(|(_, z)| *z <= low + share * (high - low));
            chosen.map(|(node, _)| *node).collect()
        };
        let [tenth, more, most] = [0.1, 0.3, 0.6].map(below);
        let enough = [tenth, more].into_iter().find(|nodes| nodes.len() >= 3);
        enough.unwrap_or(most)
    };
    parts.values().flat_map(lowest_of).collect()
}

/// For each node one node of the part that it is connected to, the same for the whole part.
fn connected(mesh: &TetMesh) -> Vec<u32> {
    let mut towards: Vec<u32> = (0u32..).take(mesh.points_m().len()).collect();
    let root = |towards: &mut Vec<u32>, mut node: u32| {
        while towards[node as usize] != node {
            let next = towards[towards[node as usize] as usize];
            towards[node as usize] = next;
            node = next;
        }
        node
    };
    for [first, others @ ..] in mesh.cells() {
        for other in others {
            let (a, b) = (root(&mut towards, *first), root(&mut towards, *other));
            towards[a.max(b) as usize] = a.min(b);
        }
    }
    (0u32..)
        .take(towards.len())
        .map(|node| root(&mut towards, node))
        .collect()
}

/// Radius of a sphere that, pressed in by a quarter of it, touches about so many vertices: an area of
/// pi R R / 4, in which each vertex has sqrt(3) / 2 squared edges.
fn radius(surface: &Surface, rows: u32) -> f64 {
    let in_edges = (f64::from(rows) * 2.0 * 3f64.sqrt() / std::f64::consts::PI).sqrt();
    surface.mean_edge_m * in_edges.max(LEAST_RADIUS_IN_EDGES)
}

/// The highest vertex of the surface and its normal; of several the one nearest to the middle.
fn highest(mesh: &TetMesh, surface: &Surface) -> (Vector3<f64>, Vector3<f64>) {
    let points = mesh.points_m();
    let at = |node: u32| Vector3::from(points[node as usize]);
    let middle = points
        .iter()
        .map(|x| Vector3::from(*x))
        .sum::<Vector3<f64>>()
        / points.len() as f64;
    let top = surface
        .vertices
        .iter()
        .map(|node| at(*node).z)
        .fold(f64::NEG_INFINITY, f64::max);
    let near_top = surface
        .vertices
        .iter()
        .zip(&surface.normals)
        .map(|(node, normal)| (at(*node), Vector3::from(*normal)))
        .filter(|(x, _)| x.z >= top - 0.01 * surface.mean_edge_m);
    let aside = |x: &Vector3<f64>| (x - middle).xy().norm();
    near_top
        .min_by(|a, b| aside(&a.0).total_cmp(&aside(&b.0)))
        .unwrap_or((middle, Vector3::z()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_host::mesh::slab;

    /// The sphere is sized for the rows that are asked for, and the press finds a rest.
    #[test]
    fn a_slab_is_pressed_with_about_as_many_rows_as_asked_for() {
        let mesh = slab([0.06, 0.06, 0.03], [14, 14, 6]).expect("a slab");
        for rows in [15, 40] {
            let trial = trial(&mesh, rows).expect("held at its bottom");
            assert_eq!(trial.step_status, "ok", "{trial:?}");
            let found = f64::from(trial.step_rows) / f64::from(rows);
            assert!((0.5..2.0).contains(&found), "{trial:?}");
            assert!(trial.step_us > Some(0.0) && trial.column_us > 0.0 && trial.factor_ms > 0.0);
        }
    }

    /// Two slabs side by side are held both, and each node is with its own.
    #[test]
    fn parts_that_do_not_touch_are_held_each_by_itself() {
        let one = slab([0.06, 0.06, 0.03], [6, 6, 3]).expect("a slab");
        let count = one.points_m().len() as u32;
        let beside = one
            .points_m()
            .iter()
            .map(|[x, y, z]| [x + 0.1, *y, z + 0.02]);
        let points = one.points_m().iter().copied().chain(beside).collect();
        let others = one.cells().iter().map(|cell| cell.map(|node| node + count));
        let cells = one.cells().iter().copied().chain(others).collect();
        let two = TetMesh::new(points, cells).expect("good");
        let parts = connected(&two);
        assert!(parts[..count as usize].iter().all(|part| *part == 0));
        assert!(parts[count as usize..].iter().all(|part| *part == count));
        let trial = trial(&two, 15).expect("both are held");
        assert_eq!(trial.step_status, "ok", "{trial:?}");
    }

    /// Five nodes: whatever comes out, it is no panic.
    #[test]
    fn the_least_mesh_is_tried_too() {
        let points = vec![
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [1.0, 1.0, 1.0],
        ];
        let mesh = TetMesh::new(points, vec![[0, 1, 2, 3], [1, 2, 3, 4]]).expect("good");
        let trial = trial(&mesh, 30).expect("held");
        assert!(trial.factor_ms > 0.0, "{trial:?}");
    }
}
