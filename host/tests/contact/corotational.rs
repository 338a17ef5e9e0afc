//! Tools on corotational tissue: against whole Newton solves, the linear limit, and itself.

use super::bench::{Bench, RADIUS, SOFT, at, ball, distance, force, pose};
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::{CorotationalTissue, Loads, NodeLoad, Policy};
use sutura_host::mesh::{TetMesh, slab, tube};
use sutura_host::model::{Model, Passes};
use sutura_host::step::{State, Status, StepReport};
use sutura_host::tool::{Shape, Tool, ToolSample};
use sutura_testkit::Random;

/// Factors in every pass.
const FRESH: Policy = Policy {
    refactor_rotation_rad: 0.0,
    refactor_every: 0,
    cg_iterations: 0,
    cg_tolerance: 0.0,
};
/// Factors so seldom that the passes just converge.
const STALE: Policy = Policy {
    refactor_rotation_rad: 0.2,
    refactor_every: u32::MAX,
    cg_iterations: 4,
    cg_tolerance: 0.0,
};
const CONVERGED: Passes = Passes {
    most: 60,
    tolerance: 1e-11,
};

/// A block of 60 x 60 x 30 mm that is held below, under a tool.
fn under(tool: Tool, policy: Policy, passes: Passes) -> Bench {
    let mesh = slab([0.06, 0.06, 0.03], [12, 12, 6]).expect("a slab");
    let bottom: Vec<u32> = (0..169).collect();
    let (loads, tools) = (Loads::default(), [(0, tool)]);
    let model = Model::corotational(&mesh, SOFT, &bottom, loads, &tools, policy, passes);
    let model = model.expect("a model");
    Bench::around(model)
}

fn block(policy: Policy, passes: Passes) -> Bench {
    under(ball([0.0; 3]), policy, passes)
}

/// With friction the passes of a step begin where the step does: what slips slides by the way since then.
#[test]
fn tangents_with_friction_are_those_of_whole_solves_or_say_how_far_they_may_be_off() {
    super::hyperelastic::tangents_are_those_of_whole_solves(under);
}

#[test]
fn a_drag_keeps_its_cones_and_its_books() {
    super::hyperelastic::drags_keep_their_cones_and_books(under);
}

/// Pressed in by `depth`, off the middle, in steps of a millimetre.
fn press(bench: &mut Bench, depth_m: f64) -> (State, StepReport) {
    let mut state = State::new(&bench.model);
    let mut report = StepReport::default();
    let steps = (depth_m / 1e-3).ceil().max(1.0) as u32;
    for number in 0..=steps {
        let depth = depth_m * f64::from(number) / f64::from(steps);
        report = bench.step(&mut state, pressed(depth));
        assert_eq!(report.status, Status::Ok, "{report:?}");
    }
    (state, report)
}

fn pressed(depth_m: f64) -> ToolSample {
    at(0.004, -0.002, RADIUS - depth_m)
}

/// Whatever the policy, the passes end where Newton's method over the whole tissue ends under the
/// same contact forces, with the sphere touched and not entered.
#[test]
fn passes_converge_to_the_whole_solve() {
    let fixed: Vec<u32> = (0..169).collect();
    let mut forces = Vec::new();
    for policy in [FRESH, Policy::default(), STALE] {
        let mut bench = block(policy, CONVERGED);
        let (state, report) = press(&mut bench, 0.006);
        assert!(report.rows > 5, "{report:?}");
        assert!(report.imbalance <= CONVERGED.tolerance, "{report:?}");
        println!(
            "{policy:?}: {} passes, {} refactorisations in the last step",
            report.passes, report.refactorisations
        );
        bench.assert_balanced(&state, &[pressed(0.006)]);

        let mesh = slab([0.06, 0.06, 0.03], [12, 12, 6]).expect("a slab");
        let whole =
            CorotationalTissue::new(&mesh, SOFT, &fixed, Policy::default()).expect("tissue");
        let pushed = state.contact_forces(&bench.model);
        let loads = Loads {
            forces: pushed
                .map(|(node, force_n)| NodeLoad { node, force_n })
                .collect(),
            ..Loads::default()
        };
        let expected = whole.solve(&loads).expect("a balance");
        let found = bench.model.equilibrium(&state).expect("a field");
        assert!(found.residual < 1e-8, "{:e}", found.residual);
        let depth = 0.006;
        for (a, b) in expected.displacement_m.iter().zip(&found.displacement_m) {
            assert!((Vector3::from(*a) - Vector3::from(*b)).norm() < 1e-8 * depth);
        }
        for load in &loads.forces {
            let x = Vector3::from(mesh.points_m()[load.node as usize])
                + Vector3::from(expected.displacement_m[load.node as usize]);
            let (gap, normal) = distance(&ball([0.0; 3]), &pressed(depth), &x);
            let push = Vector3::from(load.force_n);
            assert!(gap.abs() < 1e-8 * RADIUS, "gap {gap:e}");
            assert!((push - normal * push.norm()).norm() < 1e-8 * report.contacts()[0].wrench[2]);
        }
        forces.push(force(&report.contacts()[0]));
    }
    for force in &forces {
        assert!(
            (force - forces[0]).norm() < 1e-8 * forces[0].norm(),
            "{forces:?}"
        );
    }
}

/// Barely pressed, corotational tissue is linear tissue: the difference is of second order in the depth.
#[test]
fn a_small_press_is_linear() {
    let mesh = slab([0.06, 0.06, 0.03], [12, 12, 6]).expect("a slab");
    let bottom: Vec<u32> = (0..169).collect();
    // On one vertex, so that the set of touched ones stays.
    let difference = |depth_m: f64| {
        let over = at(0.0, 0.0, RADIUS - depth_m);
        let mut linear = Bench::new(&mesh, &bottom, Loads::default(), &[(0, ball([0.0; 3]))]);
        let mut turning = block(FRESH, CONVERGED);
        let [linear, turning] = [&mut linear, &mut turning].map(|bench| {
            let (_, report) = bench.afresh(at(0.0, 0.0, 0.05), over);
            assert_eq!((report.status, report.rows), (Status::Ok, 1));
            force(&report.contacts()[0])
        });
        (linear - turning).norm()
    };
    let differences = [4e-4, 2e-4, 1e-4].map(difference);
    println!("{differences:?}");
    for pair in differences.windows(2) {
        assert!((pair[0] / pair[1] - 4.0).abs() < 0.4, "{differences:?}");
    }
}

/// Force on the tool = -d stored energy / d pose.
#[test]
fn the_force_is_the_slope_of_the_stored_energy() {
    let mut bench = block(FRESH, CONVERGED);
    let (start, report) = press(&mut bench, 0.005);
    let (found, rows) = (force(&report.contacts()[0]), report.rows);
    let h = 1e-6;
    for axis in 0..3 {
        let mut energy = [0.0; 2];
        for (energy, sign) in energy.iter_mut().zip([-1.0, 1.0]) {
            let mut sample = pressed(0.005);
            sample.position_m[axis] += sign * h;
            let report = bench.step(&mut start.clone(), sample);
            assert_eq!((report.status, report.rows), (Status::Ok, rows));
            *energy = report.stored_energy_j;
        }
        let slope = (energy[1] - energy[0]) / (2.0 * h);
        assert!(
            (found[axis] + slope).abs() < 1e-5 * found.norm(),
            "axis {axis}: {} {slope}",
            found[axis]
        );
    }
}

/// Same bits twice, and from a copy of the state, even with a new workspace.
#[test]
fn a_path_gives_the_same_bits_twice_and_from_a_snapshot() {
    let path = |tick: u32| {
        let t = f64::from(tick);
        at(
            0.01 * (0.1 * t).sin(),
            0.0,
            RADIUS + 0.002 - 0.008 * (0.08 * t).sin(),
        )
    };
    let policy = Policy {
        refactor_rotation_rad: 0.05,
        ..Policy::default()
    };
    let run = |bench: &mut Bench, state: &mut State, ticks: std::ops::Range<u32>| {
        let reports = ticks.map(|tick| {
            let report = bench.step(state, path(tick));
            assert_eq!(report.status, Status::Ok, "{report:?}");
            (
                report.contacts()[0],
                report.imbalance,
                report.refactorisations,
            )
        });
        reports.collect::<Vec<_>>()
    };
    let [mut bench, mut other] = [(); 2].map(|()| block(policy, Passes::default()));
    let mut state = State::new(&bench.model);
    run(&mut bench, &mut state, 0..15);
    let snapshot = state.clone();
    let first = run(&mut bench, &mut state, 15..35);
    let refactorisations: u32 = first.iter().map(|report| report.2).sum();
    assert!(refactorisations > 0, "nothing was factored");
    let mut again = snapshot.clone();
    assert_eq!(run(&mut bench, &mut again, 15..35), first);
    assert_eq!(again, state);
    let mut again = snapshot;
    assert_eq!(run(&mut other, &mut again, 15..35), first);
    let mut whole = State::new(&other.model);
    assert_eq!(run(&mut other, &mut whole, 0..35)[15..], first);
    assert_eq!(whole, state);
}

/// d force / d position by central differences of converged solves that start at the pose's balance.
fn stiffness_by_differences(bench: &mut Bench, start: &State, sample: ToolSample) -> Matrix3<f64> {
    let h = 1e-6;
    let mut stiffness = Matrix3::zeros();
    for axis in 0..3 {
        let [back, forward] = [-h, h].map(|by| {
            let mut sample = sample;
            sample.position_m[axis] += by;
            let report = bench.step(&mut start.clone(), sample);
            assert_eq!(report.status, Status::Ok);
            assert!(report.imbalance <= 1e-9, "{report:?}");
            force(&report.contacts()[0])
        });
        stiffness.set_column(axis, &((forward - back) / (2.0 * h)));
    }
    stiffness
}

/// With a fresh factor the tangent is exact, with a stale one within what the step says.
#[test]
fn the_tangent_is_exact_or_says_how_far_it_may_be_off() {
    for depth in [0.002, 0.004, 0.006, 0.008] {
        let mut bench = block(FRESH, CONVERGED);
        let (state, report) = press(&mut bench, depth);
        let expected = stiffness_by_differences(&mut bench, &state, pressed(depth));
        let error = |report: &StepReport| {
            let tangent = report.contacts()[0].tangent;
            let found = Matrix3::from_fn(|i, j| tangent[i][j]);
            (found - expected).norm() / expected.norm()
        };
        let fresh = error(&report);
        println!(
            "{depth}: fresh {fresh:.1e}, says {:.1e}",
            report.tangent_error
        );
        assert!(fresh < 1e-5, "{fresh:e}");
        assert!(report.tangent_error < 1e-5, "{:e}", report.tangent_error);
        // Converged, and with what a single pass leaves.
        let once = Passes::default();
        for (policy, passes) in [
            (STALE, CONVERGED),
            (Policy::default(), CONVERGED),
            (STALE, once),
            (Policy::default(), once),
        ] {
            let mut stale = block(policy, passes);
            let (_, report) = press(&mut stale, depth);
            let (off, says) = (error(&report), report.tangent_error);
            println!("{depth}: {off:.3}, says {says:.3}");
            assert!(off <= says, "{off} {says}");
        }
    }
}

/// Outer radius of the tube \[m\].
const OUTSIDE: f64 = 0.03;
/// Radius of the ball that presses it \[m\]: three of its edges.
const BALL: f64 = 0.024;

/// A thick tube along z, held at both ends, its outside jittered by a tenth of an edge; the ball hangs off
/// the grip, so that turning the grip moves it.
fn round(policy: Policy, passes: Passes) -> Bench {
    around(Shape::Sphere { radius_m: BALL }, policy, passes)
}

/// The same under a shape that lies along the tube.
fn around(shape: Shape, policy: Policy, passes: Passes) -> Bench {
    let even = tube([0.012, OUTSIDE], [-0.03, 0.03], [2, 24, 8]).expect("a tube");
    let mut random = Random::new(7);
    let jittered = |p: &[f64; 3]| {
        let free = p[2].abs() < 0.029 && p[0].hypot(p[1]) > 0.99 * OUTSIDE;
        let by = random.vector() * if free { 8e-4 } else { 0.0 };
        (Vector3::from(*p) + by).into()
    };
    let points = even.points_m().iter().map(jittered).collect();
    let mesh = TetMesh::new(points, even.cells().to_vec()).expect("a sound mesh");
    let ends: Vec<u32> = (0u32..)
        .zip(mesh.points_m())
        .filter(|(_, p)| p[2].abs() > 0.0299)
        .map(|(node, _)| node)
        .collect();
    let tool = Tool {
        axis: [0.0, 0.0, 1.0],
        ..Tool::new(shape, [0.01, -0.02, 0.015])
    };
    let loads = Loads::default();
    let model = Model::corotational(&mesh, SOFT, &ends, loads, &[(0, tool)], policy, passes);
    let model = model.expect("a model");
    Bench::around(model)
}

/// The grip with the ball so deep in the tube's side, aslant, moved and turned by `by` \[m, rad\].
fn aside(depth_m: f64, by: Vector6<f64>) -> ToolSample {
    let out = Vector3::new(0.3f64.cos(), 0.3f64.sin(), 0.0);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.5));
    let grip = out * (OUTSIDE + BALL - depth_m) + Vector3::new(0.0, 0.0, 0.004)
        - rotation * Vector3::new(0.01, -0.02, 0.015);
    let (shift, turn) = (by.fixed_rows::<3>(0), by.fixed_rows::<3>(3));
    let turn = UnitQuaternion::from_scaled_axis(turn.into_owned());
    pose(grip + shift, turn * rotation)
}

fn press_round(bench: &mut Bench, depth_m: f64) -> (State, StepReport) {
    let mut state = State::new(&bench.model);
    let mut report = StepReport::default();
    for number in -1..=4 {
        let sample = aside(0.25 * depth_m * f64::from(number), Vector6::zeros());
        report = bench.step(&mut state, sample);
        assert_eq!(report.status, Status::Ok, "{report:?}");
    }
    (state, report)
}

/// d wrench / d pose by central differences of converged solves that start at the pose's balance.
fn whole_by_differences(
    bench: &mut Bench,
    (start, report): (&State, &StepReport),
    depth_m: f64,
) -> Matrix6<f64> {
    let mut expected = Matrix6::zeros();
    for axis in 0..6 {
        let h = if axis < 3 { 1e-6 } else { 1e-6 / BALL };
        let [back, forward] = [-h, h].map(|way| {
            let sample = aside(depth_m, Vector6::ith(axis, way));
            let after = bench.step(&mut start.clone(), sample);
            assert_eq!((after.status, after.rows), (Status::Ok, report.rows));
            assert!(after.imbalance <= 1e-9, "{after:?}");
            Vector6::from(after.contacts()[0].wrench)
        });
        expected.set_column(axis, &((forward - back) / (2.0 * h)));
    }
    expected
}

/// The same on curved and uneven tissue for shapes whose normals turn with them.
#[test]
fn the_tangent_of_bars_on_a_round_surface_is_exact() {
    let scale = Matrix6::from_diagonal(&Vector6::from_fn(
        |i, _| if i < 3 { 1.0 } else { 1.0 / BALL },
    ));
    let capsule = Shape::Capsule {
        radius_m: BALL,
        length_m: 0.02,
    };
    // Its side is as far from its middle as the ball's: [`aside`] knows the depth.
    let cuboid = Shape::RoundedBox {
        size_m: [2.0 * BALL, 2.0 * BALL, 0.03],
        fillet_m: 0.008,
    };
    for (shape, depth) in [(capsule.clone(), 0.003), (capsule, 0.006), (cuboid, 0.003)] {
        let mut bench = around(shape.clone(), FRESH, CONVERGED);
        let (start, report) = press_round(&mut bench, depth);
        assert!(report.rows >= 2, "{report:?}");
        let expected = scale * whole_by_differences(&mut bench, (&start, &report), depth) * scale;
        let tangent = report.contacts()[0].tangent;
        let found = scale * Matrix6::from_fn(|i, j| tangent[i][j]) * scale;
        let error = (found - expected).norm() / expected.norm();
        println!("{shape:?} {depth}, {} rows: {error:.1e}", report.rows);
        assert!(error < 1e-5, "{error:e}");
        assert!(report.tangent_error < 1e-5, "{:e}", report.tangent_error);
    }
}

/// Wrench by force and moment, all six ways to move, on a surface that is curved and uneven: as in the test
/// above.
#[test]
fn the_whole_tangent_on_a_round_surface_is_exact_or_says_how_far_it_may_be_off() {
    // Rotations count as the way of the ball's surface.
    let scale = Matrix6::from_diagonal(&Vector6::from_fn(
        |i, _| if i < 3 { 1.0 } else { 1.0 / BALL },
    ));
    for depth in [0.003, 0.007] {
        let mut bench = round(FRESH, CONVERGED);
        let (start, report) = press_round(&mut bench, depth);
        assert!(report.rows >= 3, "{report:?}");
        let expected = whole_by_differences(&mut bench, (&start, &report), depth);
        let expected = scale * expected * scale;
        let error = |report: &StepReport| {
            let tangent = report.contacts()[0].tangent;
            let found = scale * Matrix6::from_fn(|i, j| tangent[i][j]) * scale;
            (found - expected).norm() / expected.norm()
        };
        let (fresh, rows) = (error(&report), report.rows);
        println!(
            "{depth}, {rows} rows: fresh {fresh:.1e}, says {:.1e}",
            report.tangent_error
        );
        assert!(fresh < 1e-5, "{fresh:e}");
        assert!(report.tangent_error < 1e-5, "{:e}", report.tangent_error);
        for (policy, passes) in [
            (STALE, CONVERGED),
            (Policy::default(), CONVERGED),
            (STALE, Passes::default()),
            (Policy::default(), Passes::default()),
        ] {
            let (_, report) = press_round(&mut round(policy, passes), depth);
            let (off, says) = (error(&report), report.tangent_error);
            println!("{depth}: {off:.3}, says {says:.3}");
            assert!(off <= says, "{off} {says}");
        }
    }
}
