//! A step allocates nothing once the columns of what it touches are there, nor does corotational tissue, nor
//! following a needle.

use nalgebra::Vector3;
use sutura_host::fem::{CorotationalTissue, Loads, Material, Policy};
use sutura_host::mesh::slab;
use sutura_host::model::{Model, Passes};
use sutura_host::needle::{Curve, Geometry, Hierarchy, History, Joints, Slack, SlideStatus, slide};
use sutura_host::step::{MAX_TOOL_ROWS, Rule, State, Status, StepOptions, Workspace, step};
use sutura_host::tool::{Shape, Tool, ToolSample};

/// Down, sideways through the tissue, up, and away, with two poses that are none.
fn path(tick: u32) -> ToolSample {
    let t = f64::from(tick) / 200.0;
    let wave = (std::f64::consts::TAU * t).sin();
    let position_m = match tick {
        50 => [f64::NAN; 3],
        150 => [0.0, 0.0, -0.2],
        _ => [
            0.012 * wave,
            0.008 * (1.0 - t),
            0.016 - 0.01 * (std::f64::consts::PI * t).sin(),
        ],
    };
    ToolSample {
        id: 0,
        position_m,
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

#[test]
fn a_step_allocates_nothing_after_the_first_touch() {
    let mesh = slab([0.08, 0.08, 0.03], [14, 14, 5]).expect("a slab");
    let bottom: Vec<u32> = (0..15 * 15).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    let tool = Tool::sphere(0.015, [0.0; 3]);
    let punch = Tool::new(Shape::flat_punch(0.012, 0.03), [0.008, 0.0, 0.0]);
    let tools = [(0, tool), (3, punch)];
    let model = Model::new(&mesh, material, &bottom, Loads::default(), &tools).expect("a model");
    let mut state = State::new(&model);
    let mut work = Workspace::new(&model);
    let options = StepOptions {
        most_rows: MAX_TOOL_ROWS,
        ..StepOptions::default()
    };
    work.prepare(&model, |_| true);
    let (mut most_rows, mut most_of_a_tool) = (0, 0);
    let mut statuses = Vec::with_capacity(200);
    let allocated = allocation_counter::measure(|| {
        for tick in 0..200 {
            // The punch over the sphere's path, a little higher: some vertices feel both.
            let mut other = ToolSample {
                id: 3,
                ..path(tick / 2)
            };
            other.position_m[2] -= 0.008;
            let report = step(
                &model,
                &mut state,
                &[path(tick), other],
                &options,
                &mut work,
            );
            if report.status == Status::Ok {
                most_of_a_tool = most_of_a_tool.max(work.rows(3).map_or(0, |rows| rows.count));
            }
            most_rows = most_rows.max(report.rows);
            statuses.push(report.status);
        }
    });
    assert!(most_rows >= 10, "the path touches {most_rows} vertices");
    assert!(
        statuses
            .iter()
            .filter(|status| **status == Status::Ok)
            .count()
            > 180,
        "{statuses:?}"
    );
    assert!(
        most_of_a_tool >= 10,
        "{most_of_a_tool} rows for the console"
    );
    assert_eq!(allocated.count_total, 0, "{allocated:?}");

    // The counter does see what a cold cache costs.
    let mut cold = Workspace::new(&model);
    let mut state = State::new(&model);
    let allocated = allocation_counter::measure(|| {
        for tick in 60..120 {
            step(&model, &mut state, &[path(tick)], &options, &mut cold);
        }
    });
    assert!(allocated.count_total > 0);
}

#[test]
fn a_step_on_corotational_tissue_allocates_nothing_once_it_has_columns() {
    let mesh = slab([0.08, 0.08, 0.03], [8, 8, 4]).expect("a slab");
    let bottom: Vec<u32> = (0..9 * 9).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    let policy = Policy {
        refactor_rotation_rad: 0.02,
        ..Policy::default()
    };
    let passes = Passes {
        most: 3,
        tolerance: 1e-6,
    };
    let tools = [(0, Tool::sphere(0.02, [0.0; 3]))];
    let loads = Loads::default();
    let model = Model::corotational(&mesh, material, &bottom, loads, &tools, policy, passes);
    let model = model.expect("a model");
    let mut state = State::new(&model);
    let mut work = Workspace::new(&model);
    let options = StepOptions {
        most_rows: MAX_TOOL_ROWS,
        ..StepOptions::with_vertices(1000)
    };
    // All buffers for columns, at the first factor; new factors reuse them.
    work.prepare(&model, |_| true);
    let (mut most_rows, mut refactorisations, mut passes) = (0, 0, 0);
    let mut statuses = Vec::with_capacity(40);
    let allocated = allocation_counter::measure(|| {
        for tick in 0..40 {
            let mut sample = path(5 * tick);
            sample.position_m[2] += 0.006;
            let report = step(&model, &mut state, &[sample], &options, &mut work);
            most_rows = most_rows.max(report.rows);
            refactorisations += report.refactorisations;
            passes += report.passes;
            statuses.push(report.status);
        }
    });
    // One sample of the path is not a number, and around a ball that is deep tissue may slip.
    let answered = statuses.iter();
    let answered = answered.filter(|status| matches!(status, Status::Ok | Status::Inside));
    assert_eq!(answered.count(), 39, "{statuses:?}");
    assert!(
        most_rows >= 3 && refactorisations >= 5 && passes > 60,
        "{most_rows} {refactorisations} {passes}"
    );
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}

/// The thread has memory of its own, and what it makes changes places with what is there.
#[test]
fn a_step_that_takes_over_a_factor_allocates_nothing() {
    let mesh = slab([0.08, 0.08, 0.03], [8, 8, 4]).expect("a slab");
    let bottom: Vec<u32> = (0..9 * 9).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    let tools = [(0, Tool::sphere(0.02, [0.0; 3]))];
    let (policy, passes) = (Policy::default(), Passes::default());
    let loads = Loads::default();
    let model = Model::corotational(&mesh, material, &bottom, loads, &tools, policy, passes);
    let model = model.expect("a model");
    let mut state = State::new(&model);
    let mut work = Workspace::new(&model);
    let options = StepOptions::with_vertices(1000);
    work.renew_beside(&model, Rule::SAME_EVERYWHERE);
    let mut press = |ticks: std::ops::Range<u32>, work: &mut Workspace| {
        let (mut adopted, mut asked, mut ok) = (0, 0, 0);
        for tick in ticks {
            let mut sample = path(0);
            let wave = (std::f64::consts::TAU * f64::from(tick) / 60.0).cos();
            sample.position_m = [0.0, 0.002 * wave, 0.016 + 0.005 * wave];
            let report = step(&model, &mut state, &[sample], &options, work);
            adopted += report.renewals.adopted;
            asked += report.renewals.asked;
            ok += u32::from(report.status == Status::Ok);
        }
        (adopted, asked, ok)
    };
    // Once down and up, so that both sets of columns have grown.
    press(0..120, &mut work);
    let mut found = (0, 0, 0);
    let allocated = allocation_counter::measure(|| found = press(120..240, &mut work));
    let (adopted, asked, ok) = found;
    assert!(adopted >= 3 && asked >= 3, "{adopted} {asked}");
    assert_eq!(ok, 120);
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}

#[test]
fn corotational_tissue_allocates_nothing_refactorisations_included() {
    let mesh = slab([0.08, 0.08, 0.03], [8, 8, 4]).expect("a slab");
    let bottom: Vec<u32> = (0..9 * 9).collect();
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    let policy = Policy {
        refactor_every: 4,
        ..Policy::default()
    };
    let tissue = CorotationalTissue::new(&mesh, material, &bottom, policy).expect("tissue");
    let mut state = tissue.state();
    let mut workspace = tissue.workspace();
    let mut external = vec![0.0; tissue.unknowns()];
    let first = tissue.first_unknown(4 * 81 + 40).expect("a free node");
    let mut iterations = 0;
    let allocated = allocation_counter::measure(|| {
        for step in 0..20 {
            external[first] = 0.1 * f64::from(step);
            let report = tissue.linearise(&mut state, &mut workspace, &external);
            iterations += report.cg_iterations;
            state.unknowns_mut().copy_from_slice(workspace.predicted());
        }
    });
    assert!(state.generation() >= 4 && iterations >= 20);
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}

#[test]
fn following_a_needle_allocates_nothing() {
    let mesh = slab([0.08, 0.08, 0.03], [8, 8, 4]).expect("a slab");
    let at = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
    let hierarchy = Hierarchy::new(mesh.half_faces(), at);
    let base = Curve {
        start: Vector3::new(-0.05, 0.001, 0.005),
        tangent: Vector3::new(0.6, 0.0, -0.8),
        inward: Vector3::new(0.8, 0.0, 0.6),
        curvature: 25.0,
        length: 0.05,
        joints: Joints::default(),
    };
    let needle = |along: f64| Curve {
        start: base.at(along),
        tangent: base.tangent_at(along),
        inward: base.inward_at(along),
        ..base
    };
    let [mut history, mut copy] = [History::new(16), History::new(0)];
    copy.clone_from(&history);
    let (mut pushed, mut popped, mut entered, mut full) = (0, 0, 0, 0);
    let mut along = -0.06;
    let allocated = allocation_counter::measure(|| {
        for step in 0..200 {
            let geometry = Geometry {
                mesh: mesh.half_faces(),
                hierarchy: &hierarchy,
                slack: Slack::Everywhere(1e-3),
                at,
            };
            // Through and out, back, and on until there is no room.
            let sigma = if (80..140).contains(&step) {
                -0.0013
            } else {
                0.0012
            };
            along += sigma;
            let report = slide(&geometry, &needle(along), &mut history, sigma);
            copy.clone_from(&history);
            pushed += report.pushed;
            popped += report.popped;
            entered += report.entered;
            full += u32::from(report.status == SlideStatus::Full);
            history.drop_behind(mesh.half_faces(), -0.01);
        }
    });
    assert!(pushed > 20 && popped > 10, "{pushed} {popped}");
    assert!(entered > 0 && full > 5, "{entered} {full}");
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
