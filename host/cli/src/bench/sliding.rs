//! Waiting: one anchor slides over a tube at the speed of a needle, where no column has been computed yet.
//!
//! Entry point: [`run`]. A thread computes columns; how far ahead it is told decides how many steps wait.
//! Each slide is done twice, for the haptic step alone and with the displacement of all nodes: the latter
//! streams the factor while the thread does.

use super::quantile;
use super::suite::{Bench, MATERIAL, RATE_HZ, unexpected};
use crate::failure::Failure;
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};
use sutura_host::anchors::{
    AnchorPoint, AnchorSettings, AnchorSolver, AnchorStatus, PointConstraint,
};
use sutura_host::fem::LinearTissue;
use sutura_host::rows::RowKind;

/// Speed of a needle [m/s].
const SPEED_M_PER_S: f64 = 0.05;
/// Steps by which columns are asked for ahead: 100 ms, the least that a hand gives notice; and none.
const AHEAD: [usize; 2] = [100, 0];
/// How far the tissue is pressed in [m].
const DEPTH_M: f64 = 0.001;

/// Steps of one slide.
#[derive(Serialize, JsonSchema)]
pub struct Slide {
    scene: String,
    nodes: usize,
    speed_m_per_s: f64,
    /// How long before its use a column is asked for.
    ahead_ms: f64,
    steps: usize,
    /// Whether a step ends with the displacement of all nodes, or with the forces that the hand feels.
    field: bool,
    /// Steps that found a column missing.
    waiting_pct: f64,
    /// Of the steps that do not wait; those that do end at once.
    step_us: SlideTimes,
}

#[derive(Serialize, JsonSchema)]
struct SlideTimes {
    p50: f64,
    p99: f64,
    max: f64,
}

impl std::fmt::Display for Slide {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let SlideTimes { p50, p99, max } = self.step_us;
        write!(
            f,
            "{} at {:.0} mm/s, {:.0} ms of notice: {:.1} % of {} steps wait; {} p50 {p50:.0}, p99 {p99:.0}, max {max:.0}",
            self.scene,
            1e3 * self.speed_m_per_s,
            self.ahead_ms,
            self.waiting_pct,
            self.steps,
            if self.field {
                "with the field of all nodes"
            } else {
                "haptic step alone"
            },
        )
    }
}

/// What the slide over a mesh is called.
pub fn name(bench: &Bench) -> String {
    format!("sliding on {}", bench.name)
}

/// Slides along the outside of the upper tube.
///
/// # Errors
/// None that the suite's meshes could cause.
pub fn run(bench: &Bench) -> Result<Vec<Slide>, Failure> {
    let path = path(bench);
    let tissue = LinearTissue::new(&bench.mesh, MATERIAL, &bench.fixed)
        .map_err(|error| unexpected(error.to_string()))?;
    let tissue = Arc::new(tissue);
    let slides = AHEAD
        .iter()
        .flat_map(|&ahead| [(ahead, false), (ahead, true)]);
    slides
        .map(|(ahead, field)| slide(bench, tissue.clone(), &path, ahead, field))
        .collect()
}

fn slide(
    bench: &Bench,
    tissue: Arc<LinearTissue>,
    path: &[(AnchorPoint, Vector3<f64>)],
    ahead: usize,
    field: bool,
) -> Result<Slide, Failure> {
    let mut solver = AnchorSolver::linear(tissue, &bench.reached, AnchorSettings::default())
        .map_err(|error| unexpected(error.to_string()))?;
    solver
        .start_worker()
        .map_err(|error| unexpected(error.to_string()))?;
    let period = Duration::from_secs_f64(1.0 / RATE_HZ);
    let mut due = Instant::now();
    let mut took = Vec::with_capacity(path.len());
    let mut waited = 0usize;
    // The approach: nothing is touched yet.
    for step in 0..path.len() + ahead {
        if ahead > 0
            && let Some((soon, _)) = path.get(step)
        {
            soon.nodes.iter().for_each(|node| solver.prefetch(*node));
        }
        if let Some((point, inward)) = step.checked_sub(ahead).and_then(|at| path.get(at)) {
            let rows = pressing(inward);
            let started = Instant::now();
            let report = solver.step(&[*point], &rows, field);
            let us = 1e6 * started.elapsed().as_secs_f64();
            if report.status == AnchorStatus::Waiting {
                waited += 1;
            } else {
                took.push(us);
            }
        }
        due += period;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    let steps = path.len();
    Ok(Slide {
        scene: name(bench),
        nodes: bench.mesh.points_m().len(),
        speed_m_per_s: SPEED_M_PER_S,
        ahead_ms: 1e3 * ahead as f64 / RATE_HZ,
        steps,
        field,
        waiting_pct: 100.0 * waited as f64 / steps.max(1) as f64,
        step_us: SlideTimes {
            p50: quantile(&mut took, 0.5),
            p99: quantile(&mut took, 0.99),
            max: quantile(&mut took, 1.0),
        },
    })
}

/// Pressed in along the normal, held sideways.
fn pressing(inward: &Vector3<f64>) -> [PointConstraint; 3] {
    let side = inward.cross(&Vector3::z());
    let directions = [*inward, side, inward.cross(&side)];
    let mut id = 0;
    directions.map(|direction| {
        id += 1;
        PointConstraint {
            id,
            anchor: 0,
            kind: RowKind::Equality,
            direction: direction.into(),
            target_m: if id == 1 { DEPTH_M } else { 0.0 },
        }
    })
}

/// The anchor at each step, and the direction into the tissue.
fn path(bench: &Bench) -> Vec<(AnchorPoint, Vector3<f64>)> {
    let point = |node: u32| Vector3::from(bench.mesh.points_m()[node as usize]);
    let surface = bench.mesh.surface();
    let is_free = |face: &&[u32; 3]| face.iter().all(|node| bench.reached.contains(node));
    let faces: Vec<[u32; 3]> = surface.triangles.iter().filter(is_free).copied().collect();
    let (radius, low, high) = (0.011, 0.007, 0.029);
    let steps = ((high - low) / SPEED_M_PER_S * RATE_HZ) as usize;
    let outward = Vector3::new(0.1f64.cos(), 0.1f64.sin(), 0.0);
    (0..steps)
        .filter_map(|step| {
            let z = low + SPEED_M_PER_S * step as f64 / RATE_HZ;
            let at = outward * radius + Vector3::new(0.0, 0.0, z);
            // The face in which the line from outside comes through.
            faces.iter().find_map(|face| {
                let [a, b, c] = face.map(point);
                let normal = (b - a).cross(&(c - a));
                let weights = Matrix3::from_columns(&[a, b, c]).try_inverse()?;
                let shift = (a - at).dot(&normal) / outward.dot(&normal);
                let weights = weights * (at + outward * shift);
                let inside = normal.dot(&outward) > 0.0
                    && shift.abs() < 0.1 * radius
                    && weights.iter().all(|weight| *weight >= 0.0);
                inside.then(|| {
                    let anchor = AnchorPoint {
                        nodes: [face[0], face[1], face[2], face[0]],
                        weights: [weights.x, weights.y, weights.z, 0.0],
                    };
                    (anchor, -outward)
                })
            })
        })
        .collect()
}
