//! The suite: rows on anchors that circle, on meshes of several sizes, with either tissue.
//!
//! Entry point: [`run`]. In every step all row directions turn, a tenth of the anchors changes its face,
//! and the compliance between them is assembled and factored anew.

use super::sliding::{self, Slide};
use super::{Case, PASSES, Rows, Spread, StagesUs, Turning, micros, quantile};
use crate::failure::{Cause, Failure};
use indicatif::ProgressBar;
use std::sync::Arc;
use std::time::{Duration, Instant};
use sutura_host::anchors::circling::Circling;
use sutura_host::anchors::{
    AnchorPoint, AnchorSettings, AnchorSolver, AnchorStatus, AnchorStep, PointConstraint,
};
use sutura_host::fem::{
    Anchor, CorotationalTissue, Handle, LinearTissue, Loads, Material, Policy, TissueError,
};
use sutura_host::mesh::{MeshError, TetMesh, read_msh, tube};
use sutura_host::step::Renewals;

/// Steps a second: the host keeps up with the console.
pub const RATE_HZ: f64 = 1000.0;
/// Steps before the first that counts: the circles have grown, and every column is there.
const GROWING: u64 = 250;
/// Steps of corotational tissue between two comparisons with the converged solution.
const COMPARED_EVERY: usize = 50;
pub const MATERIAL: Material = Material {
    youngs_modulus_pa: 50e3,
    poisson_ratio: 0.45,
};

/// A mesh with both ends held.
pub struct Bench {
    pub name: &'static str,
    pub mesh: TetMesh,
    pub fixed: Vec<u32>,
    /// Free nodes of the boundary.
    pub reached: Vec<u32>,
}

/// One line of the suite.
#[derive(Clone, Copy)]
struct Task {
    bench: usize,
    rows: usize,
    corotational: bool,
    /// Displacement of all nodes in every step.
    field: bool,
    /// Steps a second, with long work beside them.
    paced: Option<f64>,
}

/// Runs the suite with so many steps a pass, on corotational tissue `paced` \[Hz\], or that of it whose name contains `only`.
///
/// # Errors
/// None that the shipped meshes could cause.
pub fn run(
    steps: usize,
    paced: Option<f64>,
    only: Option<&str>,
    progress: &ProgressBar,
) -> Result<(Vec<Case>, Vec<Slide>), Failure> {
    let benches = benches().map_err(|error| unexpected(error.to_string()))?;
    let mut tasks = Vec::new();
    for bench in 0..2 {
        for rows in [60, 150] {
            for (corotational, field) in [(false, false), (false, true), (true, true)] {
                tasks.push(Task {
                    bench,
                    rows,
                    corotational,
                    field,
                    paced: paced.filter(|_| corotational),
                });
            }
        }
    }
    for bench in 2..benches.len() {
        for field in [false, true] {
            tasks.push(Task {
                bench,
                rows: 60,
                corotational: false,
                field,
                paced: None,
            });
        }
    }
    let wanted = |name: String| only.is_none_or(|only| name.contains(only));
    tasks.retain(|task| wanted(name(&benches[task.bench])));
    progress.set_length(tasks.len() as u64);
    let cases = tasks
        .iter()
        .map(|task| {
            let bench = &benches[task.bench];
            progress.set_message(format!("{} {} rows", bench.name, task.rows));
            let case = measure(bench, *task, steps)?;
            progress.inc(1);
            Ok(case)
        })
        .collect::<Result<_, Failure>>()?;
    let slid = &benches[FIVE_THOUSAND];
    let slides = if wanted(sliding::name(slid)) {
        progress.set_message("sliding");
        sliding::run(slid)?
    } else {
        Vec::new()
    };
    Ok((cases, slides))
}

/// What the rows on a mesh's circling anchors are called.
fn name(bench: &Bench) -> String {
    format!("circling on {}", bench.name)
}

/// Which of [`benches`] has 5,000 nodes.
const FIVE_THOUSAND: usize = 3;

fn benches() -> Result<Vec<Bench>, MeshError> {
    // The meshes that other systems were measured on.
    let tubes = read_msh(
        include_str!("../../../../tests/data/tubes_younes.msh"),
        1e-3,
    )?;
    // 60 mm long, 30 mm thick: the size of the tubes.
    let cylinder = read_msh(
        include_str!("../../../../tests/data/cylinder_1650.msh"),
        0.03,
    )?;
    Ok(vec![
        Bench::new("tubes 1,650", tubes),
        Bench::new("cylinder 1,650", cylinder),
        Bench::new("tubes 1.7 k", two_tubes([2, 28, 9])?),
        Bench::new("tubes 5 k", two_tubes([2, 56, 14])?),
        Bench::new("tubes 20 k", two_tubes([4, 84, 23])?),
    ])
}

/// The two tubes of younes-2021 in structured meshes.
fn two_tubes(divisions: [usize; 3]) -> Result<TetMesh, MeshError> {
    let upper = tube([0.008, 0.011], [0.003, 0.033], divisions)?;
    let lower = tube([0.012, 0.015], [-0.031, -0.003], divisions)?;
    upper.beside(&lower)
}

impl Bench {
    fn new(name: &'static str, mesh: TetMesh) -> Self {
        let heights = mesh.points_m().iter().map(|point| point[2]);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| {
            (low.min(z), high.max(z))
        });
        let held = |z: f64| z < low + 1e-7 || z > high - 1e-7;
        let numbered = (0u32..).zip(mesh.points_m());
        let fixed = numbered
            .filter(|(_, point)| held(point[2]))
            .map(|(node, _)| node)
            .collect();
        let reached = mesh
            .surface()
            .vertices
            .into_iter()
            .filter(|node| !held(mesh.points_m()[*node as usize][2]))
            .collect();
        Self {
            name,
            mesh,
            fixed,
            reached,
        }
    }
}

fn measure(bench: &Bench, task: Task, steps: usize) -> Result<Case, Failure> {
    let anchors = task.rows / 3;
    let Some(circling) = Circling::new(&bench.mesh, &bench.fixed, anchors, 1.0) else {
        let message = format!("{} has no room for {anchors} anchors", bench.name);
        return Err(unexpected(message));
    };
    let settings = AnchorSettings {
        most_rows: task.rows,
        most_anchors: anchors,
        vertices_per_step: usize::MAX,
        ..AnchorSettings::default()
    };
    let tissue_error = |error: TissueError| unexpected(error.to_string());
    let started = Instant::now();
    let linear =
        Arc::new(LinearTissue::new(&bench.mesh, MATERIAL, &bench.fixed).map_err(tissue_error)?);
    let factor_ms = 1e3 * started.elapsed().as_secs_f64();
    let factor_entries = linear.factor_entries();
    let turning = if task.corotational {
        let tissue =
            CorotationalTissue::new(&bench.mesh, MATERIAL, &bench.fixed, Policy::default());
        Some(Arc::new(tissue.map_err(tissue_error)?))
    } else {
        None
    };
    let mut walk = Walk::default();
    let mut medians = Vec::new();
    let (mut cached, mut bytes) = (0, 0);
    for pass in 0..PASSES {
        let mut solver = match &turning {
            Some(tissue) => AnchorSolver::corotational(tissue.clone(), &bench.reached, settings),
            None => AnchorSolver::linear(linear.clone(), &bench.reached, settings),
        }
        .map_err(tissue_error)?;
        if task.paced.is_some() {
            let started = solver.start_worker();
            started.map_err(|error| unexpected(error.to_string()))?;
        }
        let truth = turning.as_deref().filter(|_| pass == 0);
        let before = walk.took.len();
        walk.pass(&mut solver, circling.clone(), task, steps, truth);
        medians.push(quantile(&mut walk.took[before..].to_vec(), 0.5));
        cached = solver.cached_vertices();
        bytes = solver.column_bytes().1;
    }
    medians.sort_by(f64::total_cmp);

    let stage = |ns: fn(&AnchorStep) -> u64| {
        let mut all = micros(&walk.reports, |report| Duration::from_nanos(ns(report)));
        quantile(&mut all, 0.5)
    };
    let mean = walk.took.iter().sum::<f64>() / walk.took.len().max(1) as f64;
    let computed: u32 = walk
        .reports
        .iter()
        .map(|report| report.vertices_computed)
        .sum();
    let columns_ns: u64 = walk
        .cold
        .iter()
        .map(|report| report.stages.columns_ns)
        .sum();
    let cold: u32 = walk
        .cold
        .iter()
        .map(|report| report.vertices_computed)
        .sum();
    let not_ok = |report: &&AnchorStep| report.status != AnchorStatus::Ok;
    let mut took = walk.took.clone();
    Ok(Case {
        scene: name(bench),
        tissue: if task.corotational {
            "corotational"
        } else {
            "linear"
        },
        nodes: bench.mesh.points_m().len(),
        cells: bench.mesh.cells().len(),
        rows: task.rows as u32,
        steps: walk.reports.len() / PASSES,
        steps_not_ok: walk.reports.iter().filter(not_ok).count(),
        step_us: Spread {
            p50: quantile(&mut took, 0.5),
            mean,
            p99: quantile(&mut took, 0.99),
            max: quantile(&mut took, 1.0),
            p50_range: [medians[0], medians[PASSES - 1]],
        },
        field_us: task.field.then(|| stage(|report| report.stages.field_ns)),
        of_session: None,
        stages_us: StagesUs(vec![
            ("tissue", stage(|report| report.stages.tissue_ns)),
            ("columns", stage(|report| report.stages.columns_ns)),
            ("assemble", stage(|report| report.stages.assemble_ns)),
            ("solve", stage(|report| report.stages.solve_ns)),
        ]),
        factor_ms,
        first_touch_us: walk
            .cold
            .iter()
            .map(|report| report.stages.columns_ns)
            .max()
            .map_or(0.0, |ns| 1e-3 * ns as f64),
        memory_mb: 1e-6 * (8 * factor_entries + bytes) as f64,
        of_rows: Some(Rows {
            columns_per_step: 3.0 * f64::from(computed) / walk.reports.len().max(1) as f64,
            column_us: 1e-3 * columns_ns as f64 / f64::from(3 * cold.max(1)),
            vertex_kb: 1e-3 * bytes as f64 / cached.max(1) as f64,
            cached_vertices: cached,
        }),
        turning: turning.map(|_| walk.turning(steps, task)),
    })
}

/// What passes left behind.
#[derive(Default)]
struct Walk {
    /// Warm steps \[us\].
    took: Vec<f64>,
    reports: Vec<AnchorStep>,
    /// Steps of growing circles.
    cold: Vec<AnchorStep>,
    /// Largest rotation of a cell \[rad\], and difference from the converged displacement, over its
    /// largest entry.
    largest_rotation: f64,
    difference: f64,
    /// CPU time of all threads during warm steps \[us\], without comparisons.
    cpu_us: f64,
}

impl Walk {
    fn pass(
        &mut self,
        solver: &mut AnchorSolver,
        mut circling: Circling,
        task: Task,
        steps: usize,
        truth: Option<&CorotationalTissue>,
    ) {
        let mut converged = truth.map(CorotationalTissue::state);
        let every = Duration::from_secs_f64(task.paced.map_or(0.0, f64::recip));
        for step in 0..GROWING + steps as u64 {
            let (points, rows) = circling.at(step, RATE_HZ);
            let cpu_us = cpu_time_us();
            let started = Instant::now();
            let report = solver.step(points, rows, task.field);
            let took = started.elapsed();
            std::thread::sleep(every.saturating_sub(took));
            let spent_us = cpu_time_us() - cpu_us;
            if step < GROWING {
                self.cold.push(report);
                continue;
            }
            self.took.push(1e6 * took.as_secs_f64());
            self.reports.push(report);
            self.cpu_us += spent_us;
            if let (Some(tissue), Some(state)) = (truth, &mut converged)
                && ((step - GROWING) as usize).is_multiple_of(COMPARED_EVERY)
            {
                let loads = Loads {
                    handles: handles(points, rows),
                    ..Loads::default()
                };
                if tissue.settle(state, &loads).is_ok() {
                    self.largest_rotation = self.largest_rotation.max(state.largest_rotation_rad());
                    self.difference =
                        self.difference
                            .max(difference(tissue, state.unknowns(), solver));
                }
            }
        }
    }

    fn turning(&self, steps: usize, task: Task) -> Turning {
        let of_tissue = |report: &AnchorStep| report.linearisation;
        let refactored = self
            .reports
            .iter()
            .filter_map(of_tissue)
            .filter(|l| l.refactored);
        let per_step = |count: f64| count / (PASSES * steps.max(1)) as f64;
        let renewals = self.reports.iter().map(|report| report.renewals);
        let renewals = renewals.fold(Renewals::default(), Renewals::plus);
        let renewals = [renewals.adopted, renewals.waited].map(|count| per_step(f64::from(count)));
        let paced = |_: &f64| task.paced.is_some();
        Turning {
            refactors_per_step: per_step(refactored.count() as f64),
            renewals_per_step: task.paced.map(|_| renewals),
            cpu_us_per_step: Some(per_step(self.cpu_us)).filter(paced),
            largest_rotation_deg: self.largest_rotation.to_degrees(),
            displacement_difference_pct: 100.0 * self.difference,
        }
    }
}

/// CPU time of all threads of this process so far \[us\]; 0 where the system does not say.
fn cpu_time_us() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        1e6 * time.tv_sec as f64 + 1e-3 * time.tv_nsec as f64
    }
    #[cfg(not(unix))]
    {
        0.0
    }
}

/// Largest difference between the solver's field and `converged` (unknowns), over the largest entry.
fn difference(tissue: &CorotationalTissue, converged: &[f64], solver: &AnchorSolver) -> f64 {
    let (mut worst, mut scale) = (0.0f64, 0.0f64);
    for node in 0..tissue.nodes() as u32 {
        let expected = tissue.at_node(converged, node);
        let found = solver.displacement_m(node);
        for axis in 0..3 {
            worst = worst.max((expected[axis] - found[axis]).abs());
            scale = scale.max(expected[axis].abs());
        }
    }
    worst / scale
}

/// What three orthonormal rows an anchor ask for, as handles of a whole solve.
fn handles(points: &[AnchorPoint], rows: &[PointConstraint]) -> Vec<Handle> {
    let target = |rows: &[PointConstraint]| {
        let mut target = [0.0; 3];
        for row in rows {
            for (target, direction) in target.iter_mut().zip(row.direction) {
                *target += direction * row.target_m;
            }
        }
        target
    };
    points
        .iter()
        .zip(rows.chunks_exact(3))
        .map(|(point, rows)| Handle {
            anchor: Anchor {
                vertices: point.nodes[..3].to_vec(),
                weights: point.weights[..3].to_vec(),
            },
            target_displacement_m: target(rows),
        })
        .collect()
}

/// The suite's own meshes fit its own tasks.
pub fn unexpected(message: String) -> Failure {
    Failure::say(
        Cause::Failed,
        format!("the suite cannot run: {message}"),
        "please report this: the suite's meshes come with the program",
    )
}
