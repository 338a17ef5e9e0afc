//! Tools on hyperelastic tissue: against the reference's own balance, perturbed whole solves, linear tissue, and itself.

use super::bench::{Bench, RADIUS, SOFT, at, ball, distance, force};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::{Hyperelasticity, Loads, Policy};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::model::{Model, Passes};
use sutura_host::step::{MAX_TOOL_ROWS, State, Status, StepReport};
use sutura_host::tool::{Tool, ToolSample};
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Outcome, Tissue};

/// Factors in every pass.
const FRESH: Policy = Policy {
    refactor_rotation_rad: 0.0,
    refactor_every: 0,
    cg_iterations: 0,
    cg_tolerance: 0.0,
};
const CONVERGED: Passes = Passes {
    most: 60,
    tolerance: 1e-11,
};
/// As scenes have it.
const SCENES: Passes = Passes {
    most: 4,
    tolerance: 1e-3,
};

fn mesh() -> TetMesh {
    slab([0.06, 0.06, 0.03], [12, 12, 6]).expect("a slab")
}

fn bottom() -> Vec<u32> {
    (0..169).collect()
}

/// A block of 60 x 60 x 30 mm that is held below.
fn block(tool: Tool, cells: Cells, policy: Policy, passes: Passes) -> Bench {
    let laws = [Law::neo_hookean(SOFT)];
    let substance = Hyperelasticity { laws: &laws, cells };
    let (loads, tools) = (Loads::default(), [(0, tool)]);
    let model = Model::hyperelastic(
        &mesh(),
        &substance,
        &bottom(),
        loads,
        &tools,
        policy,
        passes,
    );
    let model = model.expect("a model");
    Bench::around(model)
}

fn smooth(policy: Policy, passes: Passes) -> Bench {
    block(ball([0.0; 3]), Cells::Linear, policy, passes)
}

fn pressed(depth_m: f64) -> ToolSample {
    at(0.004, -0.002, RADIUS - depth_m)
}

/// Pressed in by `depth`, off the middle, in so many steps.
fn press(bench: &mut Bench, depth_m: f64, steps: u32) -> (State, StepReport) {
    let mut state = State::new(&bench.model);
    let mut report = StepReport::default();
    for number in 0..=steps {
        let depth = depth_m * f64::from(number) / f64::from(steps);
        report = bench.step(&mut state, pressed(depth));
        assert_eq!(report.status, Status::Ok, "{report:?}");
    }
    (state, report)
}

/// The reference's own Newton method, given where the touched vertices are and nothing of forces, holds them with the
/// contact forces, and has all other nodes in the same places.
#[test]
fn contact_forces_are_those_that_hold_the_reference_there() {
    let mesh = mesh();
    for (cells, depth_m) in [(Cells::Linear, 0.008), (Cells::Averaged, 0.005)] {
        let mut bench = block(ball([0.0; 3]), cells, Policy::default(), CONVERGED);
        let (state, report) = press(&mut bench, depth_m, 5);
        assert!(report.rows > 5, "{report:?}");
        bench.assert_balanced(&state, &[pressed(depth_m)]);
        let found = bench.model.equilibrium(&state).expect("a field");
        let mut touched: Vec<(u32, [f64; 3])> = state.contact_forces(&bench.model).collect();
        touched.sort_unstable_by_key(|(node, _)| *node);

        let settings = Settings {
            cells,
            tolerance: 1e-11,
            ..Settings::default()
        };
        let laws = [Law::neo_hookean(SOFT)];
        let mut whole = Hyperelastic::new(&mesh, &laws, settings).expect("the reference");
        let moved = touched
            .iter()
            .map(|(node, _)| (*node, found.displacement_m[*node as usize]));
        let fixed = bottom().into_iter().map(|node| (node, [0.0; 3]));
        let mut held: Vec<(u32, [f64; 3])> = fixed.chain(moved).collect();
        held.sort_unstable_by_key(|(node, _)| *node);
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        assert_eq!(whole.step(&drive, 0.0).outcome, Outcome::Converged);
        let size = force(&report.contacts()[0]).norm();
        let reactions = whole.reactions_n()[169..].iter().map(|r| Vector3::from(*r));
        for ((node, own), held) in touched.iter().zip(reactions) {
            let off = (Vector3::from(*own) - held).norm();
            assert!(off < 1e-6 * size, "{cells:?}, node {node}: {own:?} {held}");
            let at = Vector3::from(mesh.points_m()[*node as usize])
                + Vector3::from(found.displacement_m[*node as usize]);
            let (gap, normal) = distance(&ball([0.0; 3]), &pressed(depth_m), &at);
            assert!(gap.abs() < 1e-8 * RADIUS, "gap {gap:e}");
            assert!((held - normal * held.norm()).norm() < 1e-6 * size, "{held}");
        }
        let places = whole.positions_m().iter().zip(mesh.points_m());
        for ((there, rest), here) in places.zip(&found.displacement_m) {
            let off = Vector3::from(*there) - Vector3::from(*rest) - Vector3::from(*here);
            assert!(off.norm() < 1e-7 * depth_m, "{off}");
        }
    }
}

/// Without friction a press has no memory: in leaps, or fifty times as finely, with whatever factors. And what scenes do
/// in a step is there within their tolerance.
#[test]
fn a_deep_press_is_the_same_however_finely_it_is_followed() {
    let depth_m = 0.009;
    let (_, finely) = press(&mut smooth(FRESH, CONVERGED), depth_m, 100);
    let fine = force(&finely.contacts()[0]);
    let (_, leaps) = press(&mut smooth(Policy::default(), CONVERGED), depth_m, 2);
    let off = (force(&leaps.contacts()[0]) - fine).norm() / fine.norm();
    assert!(off < 1e-8, "{off:e}");
    let (_, scenes) = press(&mut smooth(Policy::default(), SCENES), depth_m, 36);
    let off = (force(&scenes.contacts()[0]) - fine).norm() / fine.norm();
    println!(
        "{fine} N; as in scenes off by {off:.1e}, {} passes, out of balance by {:.1e}",
        scenes.passes, scenes.imbalance
    );
    assert!(off < 2e-3, "{off:e}");
}

/// Barely pressed, hyperelastic tissue is linear tissue: the relative difference falls with the depth.
#[test]
fn a_small_press_is_linear() {
    // On one vertex, so that the set of touched ones stays.
    let difference = |depth_m: f64| {
        let over = at(0.0, 0.0, RADIUS - depth_m);
        let mut linear = Bench::new(&mesh(), &bottom(), Loads::default(), &[(0, ball([0.0; 3]))]);
        let mut straining = smooth(FRESH, CONVERGED);
        let [linear, straining] = [&mut linear, &mut straining].map(|bench| {
            let (_, report) = bench.afresh(at(0.0, 0.0, 0.05), over);
            assert_eq!((report.status, report.rows), (Status::Ok, 1));
            force(&report.contacts()[0])
        });
        (linear - straining).norm() / linear.norm()
    };
    let differences = [4e-4, 2e-4, 1e-4].map(difference);
    println!("{differences:?}");
    for pair in differences.windows(2) {
        assert!((pair[0] / pair[1] - 2.0).abs() < 0.2, "{differences:?}");
    }
    assert!(differences[2] < 0.02, "{differences:?}");
}

/// Force on the tool = -d stored energy / d pose.
#[test]
fn the_force_is_the_slope_of_the_stored_energy() {
    let mut bench = smooth(FRESH, CONVERGED);
    let (start, report) = press(&mut bench, 0.005, 5);
    let (found, rows) = (force(&report.contacts()[0]), report.rows);
    let h = 1e-6;
    for axis in 0..3 {
        let [back, forward] = [-h, h].map(|by| {
            let mut sample = pressed(0.005);
            sample.position_m[axis] += by;
            let report = bench.step(&mut start.clone(), sample);
            assert_eq!((report.status, report.rows), (Status::Ok, rows));
            report.stored_energy_j
        });
        let off = found[axis] + (forward - back) / (2.0 * h);
        assert!(off.abs() < 1e-5 * found.norm(), "axis {axis}: {off}");
    }
}

/// The ball hangs off the grip, so that turning the grip moves it.
const OFFSET: [f64; 3] = [0.01, -0.02, 0.015];

/// The grip with the ball so deep and so far aside, moved and turned by `by` \[m, rad\].
fn aslant((depth_m, aside_m): (f64, f64), by: &Vector6<f64>) -> ToolSample {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.5));
    let aside = Vector3::new(-0.8, 0.6, 0.0) * aside_m;
    let centre = Vector3::from(pressed(depth_m).position_m) + aside;
    let grip = centre - rotation * Vector3::from(OFFSET);
    let (shift, turn) = (by.fixed_rows::<3>(0), by.fixed_rows::<3>(3));
    let turn = UnitQuaternion::from_scaled_axis(turn.into_owned());
    super::bench::pose(grip + shift, turn * rotation)
}

/// Wrench by force and moment, all six ways to move, with friction and without: exact with a fresh factor, else within what
/// the step says.
#[test]
fn the_whole_tangent_is_that_of_whole_solves_or_says_how_far_it_may_be_off() {
    tangents_are_those_of_whole_solves(|tool, policy, passes| {
        block(tool, Cells::Linear, policy, passes)
    });
}

/// The same on tissue in any `block`.
pub(super) fn tangents_are_those_of_whole_solves(block: impl Fn(Tool, Policy, Passes) -> Bench) {
    // Rotations count as the way of the ball's surface.
    let scale = Matrix6::from_diagonal(&Vector6::from_fn(
        |i, _| if i < 3 { 1.0 } else { 1.0 / RADIUS },
    ));
    // Smooth at two depths; what rubs sticks, and slides.
    for (friction, depth_m, aside_m) in [
        (0.0, 0.003, 0.0),
        (0.0, 0.007, 0.0),
        (0.4, 0.003, 2e-4),
        (0.2, 0.004, 6e-3),
    ] {
        let tool = ball(OFFSET).with_friction(friction, friction);
        // To where the step begins whose end is moved: what rubs knows which way it came.
        let follow = |bench: &mut Bench| {
            let mut state = State::new(&bench.model);
            let down = (-1..=6).map(|part| (depth_m * f64::from(part) / 6.0, 0.0));
            let along = (1..=8).map(|part| (depth_m, aside_m * f64::from(part) / 8.0));
            for at in down.chain(along.filter(|_| aside_m > 0.0)) {
                let report = bench.step(&mut state, aslant(at, &Vector6::zeros()));
                assert_eq!(report.status, Status::Ok, "{report:?}");
            }
            state
        };
        let end = |bench: &mut Bench, start: &State, by: &Vector6<f64>| {
            let next_m = aside_m + if aside_m > 0.0 { 1e-4 } else { 0.0 };
            let report = bench.step(&mut start.clone(), aslant((depth_m, next_m), by));
            assert_eq!(report.status, Status::Ok, "{report:?}");
            report
        };
        let mut bench = block(tool.clone(), FRESH, CONVERGED);
        let start = follow(&mut bench);
        let report = end(&mut bench, &start, &Vector6::zeros());
        let mut expected = Matrix6::zeros();
        for axis in 0..6 {
            let h = if axis < 3 { 1e-7 } else { 1e-7 / RADIUS };
            let [back, forward] = [-h, h].map(|way| {
                let after = end(&mut bench, &start, &Vector6::ith(axis, way));
                assert_eq!(after.rows, report.rows);
                assert!(after.imbalance <= 1e-9, "{after:?}");
                Vector6::from(after.contacts()[0].wrench)
            });
            expected.set_column(axis, &((forward - back) / (2.0 * h)));
        }
        let expected = scale * expected * scale;
        let error = |report: &StepReport| {
            let tangent = report.contacts()[0].tangent;
            let found = scale * Matrix6::from_fn(|i, j| tangent[i][j]) * scale;
            (found - expected).norm() / expected.norm()
        };
        let fresh = error(&report);
        println!(
            "friction {friction}, {depth_m} m and {aside_m} m, {} rows: fresh {fresh:.1e}, says {:.1e}",
            report.rows, report.tangent_error
        );
        assert!(fresh < 1e-5, "{fresh:e}");
        for passes in [CONVERGED, SCENES] {
            let mut bench = block(tool.clone(), Policy::default(), passes);
            let start = follow(&mut bench);
            let report = end(&mut bench, &start, &Vector6::zeros());
            let (off, says) = (error(&report), report.tangent_error);
            println!("as in scenes: {off:.1e}, says {says:.1e}");
            assert!(off <= says.max(1e-5), "{off} {says}");
        }
    }
}

/// Dragged aside over the block: no vertex is rubbed by more than its limit, the sphere slips, and what the hand has put in
/// is stored or dissipated.
#[test]
fn a_drag_keeps_its_cones_and_its_books() {
    drags_keep_their_cones_and_books(|tool, policy, passes| {
        block(tool, Cells::Linear, policy, passes)
    });
}

/// The same on tissue in any `block`.
pub(super) fn drags_keep_their_cones_and_books(block: impl Fn(Tool, Policy, Passes) -> Bench) {
    let mu = 0.3;
    let tool = ball([0.0; 3]).with_friction(mu, mu);
    let mut bench = block(tool.clone(), Policy::default(), CONVERGED);
    let mut state = State::new(&bench.model);
    let down = (0..=40).map(|step| [-0.004, 0.001, RADIUS - 1e-4 * f64::from(step)]);
    let aside = (1..=120).map(|step| [-0.004 + 1e-4 * f64::from(step), 0.001, RADIUS - 0.004]);
    let (mut work_j, mut before) = (0.0, None);
    let mut report = StepReport::default();
    for [x, y, z] in down.chain(aside) {
        let sample = at(x, y, z);
        report = bench.step(&mut state, sample);
        assert_eq!(report.status, Status::Ok, "{report:?}");
        let felt = force(&report.contacts()[0]);
        let here = Vector3::new(x, y, z);
        if let Some((place, then)) = before.replace((here, felt)) {
            let mean: Vector3<f64> = (felt + then) * 0.5;
            let way: Vector3<f64> = here - place;
            work_j -= mean.dot(&way);
        }
        let found = bench.model.equilibrium(&state).expect("a field");
        for (node, push) in state.contact_forces(&bench.model) {
            let place = Vector3::from(bench.model.points_m()[node as usize])
                + Vector3::from(found.displacement_m[node as usize]);
            let (_, normal) = distance(&tool, &sample, &place);
            let along = Vector3::from(push).dot(&normal);
            let across = (Vector3::from(push) - normal * along).norm();
            assert!(
                across <= mu * along + 1e-6 * felt.norm(),
                "{across} {along}"
            );
        }
    }
    let felt = force(&report.contacts()[0]);
    assert!(felt.x < -0.2 * felt.z, "{felt}");
    let kept_j = report.stored_energy_j + report.friction_j;
    println!(
        "{work_j} J put in, {} stored, {} dissipated",
        report.stored_energy_j, report.friction_j
    );
    assert!(report.friction_j > 0.1 * work_j, "{report:?}");
    assert!((work_j / kept_j - 1.0).abs() < 0.02, "{work_j} {kept_j}");
}

/// Rows for the console and the slope of a touch to come are made without memory, too, once the buffers are there.
#[test]
fn a_step_allocates_nothing_once_it_has_been_there() {
    let tool = ball([0.0; 3]).with_friction(0.2, 0.3);
    let mut bench = block(tool, Cells::Linear, Policy::default(), SCENES);
    bench.options.most_rows = MAX_TOOL_ROWS;
    bench.work.prepare(&bench.model, |_| true);
    let mut state = State::new(&bench.model);
    let way = (-8..=12).chain((-8..12).rev());
    let way: Vec<ToolSample> = way.map(|step| pressed(5e-4 * f64::from(step))).collect();
    let mut follow = |samples: &[ToolSample]| {
        let (mut factors, mut rows) = (0, 0);
        for sample in samples {
            let report = bench.step(&mut state, *sample);
            assert_eq!(report.status, Status::Ok, "{report:?}");
            factors += report.refactorisations;
            rows += bench.work.rows(0).map_or(0, |rows| rows.count);
        }
        assert!(factors > 0 && rows > 0, "{factors} factors, {rows} rows");
    };
    follow(&way);
    let counted = allocation_counter::measure(|| follow(&way));
    assert_eq!(counted.count_total, 0, "{counted:?}");
}
