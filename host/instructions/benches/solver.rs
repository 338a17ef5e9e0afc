//! Instructions of the solver's parts, counted under valgrind: `cargo xtask bench` compares them with
//! `host/snapshots/solver.json`. Setting up is not counted, nor is dropping what a function returns.

#![allow(
    missing_docs,
    unused_qualifications,
    reason = "in what the macros write"
)]

use gungraun::Callgrind;
use gungraun::prelude::*;
use nalgebra::Vector3;
use std::hint::black_box;
use std::path::Path;
use sutura_host::fem::LinearTissue;
use sutura_host::mesh::{self, HalfFaces};
use sutura_host::model::Model;
use sutura_host::needle::{Curve, Geometry, Hierarchy, History, Joints, Slack, SlideReport, slide};
use sutura_host::picture::{Offer, Offering};
use sutura_host::rows::{self, Method, Outcome, Problem, Row, RowKind};
use sutura_host::scene::{self, Document, Scene};
use sutura_host::session::SceneSolver;
use sutura_host::step::{State, StepOptions, StepReport, Workspace, step};
use sutura_host::tool::ToolSample;

/// A thousand nodes, and a sphere of three edges: large enough for every part to be at work.
const SLAB: &str = r#"
[mesh.slab]
size_m = [0.05, 0.05, 0.02]
divisions = [12, 12, 5]

[tissue]
youngs_modulus_pa = 15e3
poisson_ratio = 0.45

[[fixed]]
plane = { axis = "z", at_m = -0.02 }

[[tool]]
radius_m = 0.014
"#;

fn slab() -> Scene {
    let document = Document::embedded("slab.toml", Path::new(""), SLAB);
    Scene::read(&document, "slab").expect("the scene is good")
}

fn built() -> (Model, State, Workspace) {
    slab().build().expect("the slab is held")
}

/// The sphere pressed in by so much \[m\].
fn pressed(depth_m: f64) -> ToolSample {
    ToolSample {
        id: 0,
        position_m: [0.001, 0.0, 0.014 - depth_m],
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

/// Tissue in contact, with every column that the next step needs.
fn touched() -> (Model, State, Workspace) {
    let (model, mut state, mut work) = built();
    work.prepare(&model, |at| at[2] > -0.001 && at[0].hypot(at[1]) < 0.016);
    for depth_m in [-0.001, 0.001, 0.002, 0.003] {
        step(
            &model,
            &mut state,
            &[pressed(depth_m)],
            &StepOptions::default(),
            &mut work,
        );
    }
    (model, state, work)
}

type Solver = (Model, State, Workspace);

#[library_benchmark]
#[bench::warm(setup = touched)]
fn palpation_step((model, mut state, mut work): Solver) -> (Solver, StepReport) {
    // What one host period of the palpation scene moves the sphere by.
    let report = step(
        &model,
        &mut state,
        &[pressed(0.0031)],
        &StepOptions::default(),
        &mut work,
    );
    ((model, state, work), black_box(report))
}

#[library_benchmark]
#[bench::slab(setup = slab)]
fn tissue_factor(scene: Scene) -> (Scene, LinearTissue) {
    let tissue = LinearTissue::new(&scene.mesh, scene.materials.clone(), &scene.fixed);
    let tissue = tissue.expect("the slab is held");
    (scene, black_box(tissue))
}

#[library_benchmark]
#[bench::vertex(setup = built)]
fn compliance_column((model, state, mut work): Solver) -> (Solver, usize) {
    // The vertex in the middle of the top.
    let count = work.prepare(&model, |at| at.iter().all(|x| x.abs() < 1e-6));
    ((model, state, work), black_box(count))
}

/// Rows of the suture that the suite is about.
const ROWS: usize = 150;

struct Dense {
    rows: Vec<Row>,
    compliance: Vec<f64>,
    delta_free: Vec<f64>,
    state: rows::State,
    work: rows::Workspace,
}

/// Equality rows on a compliance that falls off along a line, as between neighbouring stitches.
fn stitches() -> Dense {
    let near = |i: usize, j: usize| 1e-3 * (-(i.abs_diff(j) as f64) / 10.0).exp();
    let row = |id: usize| Row {
        id: id as u64,
        kind: RowKind::Equality,
    };
    Dense {
        rows: (0..ROWS).map(row).collect(),
        compliance: (0..ROWS * ROWS).map(|k| near(k / ROWS, k % ROWS)).collect(),
        delta_free: (0..ROWS).map(|i| 1e-3 * (i as f64).sin()).collect(),
        state: rows::State::new(ROWS),
        work: rows::Workspace::new(ROWS),
    }
}

#[library_benchmark]
#[bench::stitches(setup = stitches)]
fn dense_factor_150(mut dense: Dense) -> (Dense, Outcome) {
    let problem = Problem {
        rows: &dense.rows,
        compliance: &dense.compliance,
        delta_free: &dense.delta_free,
    };
    let outcome = rows::solve(
        &problem,
        Method::ActiveSet,
        &mut dense.state,
        &mut dense.work,
    );
    (dense, black_box(outcome))
}

/// A needle over tissue, upright but for a little.
struct Driven {
    mesh: HalfFaces,
    at: Vec<Vector3<f64>>,
    hierarchy: Hierarchy,
    history: History,
    /// Depth of the tip \[m\].
    depth: f64,
}

/// The suite's slab, or one of twenty times its size with the same cells in its middle.
fn under_needle(wide: bool, depth: f64) -> Driven {
    let mesh = if wide {
        mesh::slab([0.25, 0.2, 0.02], [60, 48, 5])
    } else {
        mesh::slab([0.05, 0.05, 0.02], [12, 12, 5])
    };
    let mesh = mesh.expect("a slab");
    let at: Vec<_> = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
    let hierarchy = Hierarchy::new(mesh.half_faces(), |node| at[node as usize]);
    let driven = Driven {
        mesh: mesh.half_faces().clone(),
        at,
        hierarchy,
        history: History::new(100),
        depth: -0.01,
    };
    driven.slid(depth + 0.01).0
}

impl Driven {
    fn slid(mut self, by: f64) -> (Self, SlideReport) {
        self.depth += by;
        let tip = Vector3::new(0.001, 0.0005, 0.0);
        let tangent = Vector3::new(0.2, 0.1, -1.0).normalize();
        let needle = Curve {
            start: tip + tangent * (self.depth - 0.04),
            tangent,
            inward: tangent.cross(&Vector3::x()).normalize(),
            curvature: 0.0,
            length: 0.04,
            joints: Joints::default(),
        };
        let geometry = Geometry {
            mesh: &self.mesh,
            hierarchy: &self.hierarchy,
            slack: Slack::Everywhere(1e-3),
            at: |node: u32| self.at[node as usize],
        };
        let report = slide(&geometry, &needle, &mut self.history, by);
        (self, report)
    }
}

// A step of the tip inside, which is a hundred milliseconds of a needle at 20 mm/s.
#[library_benchmark]
#[bench::slab(setup = under_needle, args = (false, 0.005))]
fn needle_inside(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.002))
}

#[library_benchmark]
#[bench::slab(setup = under_needle, args = (true, 0.005))]
fn needle_inside_20(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.002))
}

// A step in which the tip comes in from outside.
#[library_benchmark]
#[bench::slab(setup = under_needle, args = (false, -0.0005))]
fn needle_enters(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.002))
}

#[library_benchmark]
#[bench::slab(setup = under_needle, args = (true, -0.0005))]
fn needle_enters_20(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.002))
}

// A step just over the surface.
#[library_benchmark]
#[bench::slab(setup = under_needle, args = (false, -0.0005))]
fn needle_outside(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.0002))
}

#[library_benchmark]
#[bench::slab(setup = under_needle, args = (true, -0.0005))]
fn needle_outside_20(driven: Driven) -> (Driven, SlideReport) {
    black_box(driven.slid(0.0002))
}

/// Boxed, so that it is not copied to and fro.
type Shown = Box<(SceneSolver, Offering)>;

/// Two tubes with needle and thread, and where their states go; if they are watched, one has gone there already.
fn shown(watched: bool) -> Shown {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/anastomosis-20.toml");
    let scene = scene::read(&Document::read(&path).expect("there")).expect("the scene is good");
    let mut solver = SceneSolver::new(&scene).expect("the tubes are held");
    let grip = ToolSample {
        position_m: [0.03, 0.0, 0.03],
        ..pressed(0.0)
    };
    solver.step(grip);
    let offer = Offer::new(&solver);
    let mut offering = Offering::new(offer.clone(), &solver);
    if watched {
        offer.want(1);
        offering.solved(&solver, 1);
    }
    Box::new((solver, offering))
}

// What the solver's thread does for those who watch, after a step.
#[library_benchmark]
#[bench::tubes(setup = shown, args = (true))]
fn offer(mut shown: Shown) -> Shown {
    let (solver, offering) = &mut *shown;
    offering.solved(black_box(solver), black_box(1000));
    shown
}

#[library_benchmark]
#[bench::tubes(setup = shown, args = (false))]
fn offer_unwatched(mut shown: Shown) -> Shown {
    let (solver, offering) = &mut *shown;
    offering.solved(black_box(solver), black_box(1000));
    shown
}

library_benchmark_group!(
    name = solver,
    benchmarks = [
        palpation_step,
        dense_factor_150,
        tissue_factor,
        compliance_column,
        needle_inside,
        needle_inside_20,
        needle_enters,
        needle_enters_20,
        needle_outside,
        needle_outside_20,
        offer,
        offer_unwatched
    ]
);
main!(
    // Instructions are what is compared; caches would only take time.
    config = LibraryBenchmarkConfig::default().tool(Callgrind::with_args(["--cache-sim=no"])),
    library_benchmark_groups = solver
);
