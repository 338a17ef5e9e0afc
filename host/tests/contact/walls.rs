//! Prescribed nodes of the surface are a wall: to tools of every shape, bodies of grips and needles, on every tissue.

use super::bench::{Bench, RADIUS, at, ball, contact, force, pose, slab_mesh};
use super::jacobian::compare_jacobians;
use nalgebra::{Matrix3x6, UnitQuaternion, Vector3};
use std::path::PathBuf;
use sutura_host::fem::Loads;
use sutura_host::scene::{Document, Registered, Scene, models};
use sutura_host::session::{Rendering, SceneSolver};
use sutura_host::solve::solve;
use sutura_host::step::{State, Status, StepReport};
use sutura_host::tool::{Shape, Tool, ToolSample};

/// Nodes of the slab's top as far as x < `end`, and all of its bottom.
fn clamped(end: f64) -> (sutura_host::mesh::TetMesh, Vec<u32>) {
    let (mesh, mut fixed) = slab_mesh();
    let nodes = (0u32..).zip(mesh.points_m());
    let top = nodes.filter(|(_, at)| at[2] > -1e-9 && at[0] < end);
    fixed.extend(top.map(|(node, _)| node));
    (mesh, fixed)
}

fn bench(end: f64, tool: Tool) -> Bench {
    let (mesh, fixed) = clamped(end);
    Bench::new(&mesh, &fixed, Loads::default(), &[(0, tool)])
}

#[test]
fn the_jacobian_of_a_ball_on_a_wall_is_exact() {
    compare_jacobians(
        bench(1.0, ball([0.0; 3])),
        at(0.0, 0.0, 0.05),
        4,
        |random| {
            let [x, y, z] = random.vector().into();
            let centre = Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.0015 + 0.0005 * z);
            (centre, UnitQuaternion::identity())
        },
    );
}

/// Beside the edge of a clamp a tool touches what moves and what does not.
#[test]
fn the_jacobian_of_a_ball_beside_a_clamp_is_exact() {
    compare_jacobians(
        bench(1e-4, ball([0.0, 0.01, 0.03])),
        at(0.0, 0.0, 0.1),
        6,
        |random| {
            let [x, y, z] = random.vector().into();
            let centre = Vector3::new(0.004 + 0.003 * x, 0.012 * y, RADIUS - 0.0015 + 0.001 * z);
            let turn = UnitQuaternion::from_scaled_axis(random.vector() * 0.3);
            (centre, turn)
        },
    );
}

/// Pressed and drawn over a wall a plate that rubs has mu times its normal force against its way, and what the hand puts in is stored
/// or rubbed off. Held still it keeps its force.
#[test]
fn a_plate_slides_over_a_wall_at_mu_times_its_normal_force() {
    let mu = 0.3;
    let plate = Tool::new(Shape::flat_punch(0.02, 0.04), [0.0; 3]).with_friction(mu, mu);
    let mut bench = bench(1.0, plate);
    let mut state = State::new(&bench.model);
    let (mut work_j, mut before) = (0.0, (Vector3::zeros(), Vector3::zeros()));
    let mut go = |bench: &mut Bench, state: &mut State, place: Vector3<f64>| -> StepReport {
        let report = bench.step(state, at(place.x, place.y, place.z));
        assert_eq!(report.status, Status::Ok);
        let felt = force(&report.contacts()[0]);
        work_j -= 0.5 * (felt + before.1).dot(&(place - before.0));
        before = (place, felt);
        assert!(
            (work_j - report.stored_energy_j - report.friction_j).abs() < 0.01 * (work_j + 1e-6),
            "{work_j} J in, {} J stored, {} J rubbed off",
            report.stored_energy_j,
            report.friction_j
        );
        report
    };
    go(&mut bench, &mut state, Vector3::new(0.0, 0.0, 0.004));
    for part in 0..=20 {
        let place = Vector3::new(0.0, 0.0, 0.0001 - 1e-5 * f64::from(part));
        go(&mut bench, &mut state, place);
    }
    let mut last = Vector3::zeros();
    for part in 1..=40 {
        let way = Vector3::new(0.8, 0.6, 0.0) * (2e-6 * f64::from(part));
        let report = go(&mut bench, &mut state, way + Vector3::z() * -1e-4);
        last = force(&report.contacts()[0]);
    }
    assert!(last.z > 10.0, "{last}");
    let across = last.xy();
    // Vertices at the rim have come to touch on the way, and do not slip yet.
    assert!((across.norm() / (mu * last.z) - 1.0).abs() < 0.02, "{last}");
    assert!((across.normalize() + nalgebra::Vector2::new(0.8, 0.6)).norm() < 0.02);
    for _ in 0..5 {
        let place = Vector3::new(0.8, 0.6, 0.0) * 8e-5 + Vector3::z() * -1e-4;
        let report = go(&mut bench, &mut state, place);
        let felt = force(&report.contacts()[0]);
        assert!((felt - last).norm() < 1e-6 * last.norm(), "{felt} {last}");
    }
}

/// Compares the tangent of a ball that rubs, sticking and slipping, with steps from the same state.
#[test]
fn the_tangent_of_a_ball_that_rubs_on_a_wall_is_that_of_whole_steps() {
    for (way_m, slips) in [(2e-6, false), (3e-4, true)] {
        let mut bench = bench(1e-4, ball([0.0, 0.0, 0.02]).with_friction(0.4, 0.4));
        let mut state = State::new(&bench.model);
        let grip = |x: f64, z: f64| at(x, 0.0011, z - 0.02);
        bench.step(&mut state, grip(0.001, 0.05));
        bench.step(&mut state, grip(0.001, RADIUS - 0.0012));
        let [x, z] = [0.001 + way_m, RADIUS - 0.0013];
        let mut here = state.clone();
        let found = contact(&bench.step(&mut here, grip(x, z)));
        let ratio = force(&found).xy().norm() / force(&found).z;
        assert!(found.wrench[2] > 1.0 && (ratio > 0.2) == slips, "{ratio}");
        let mut by_steps = Matrix3x6::zeros();
        let mut said = Matrix3x6::zeros();
        for axis in 0..6 {
            let step = [1e-9, 1e-7][axis / 3];
            let mut ends = [Vector3::zeros(); 2];
            for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
                let mut by = Vector3::zeros();
                by[axis % 3] = sign * step;
                let base = Vector3::new(x, 0.0011, z - 0.02);
                let sample = match axis {
                    0..3 => pose(base + by, UnitQuaternion::identity()),
                    _ => pose(base, UnitQuaternion::from_scaled_axis(by)),
                };
                *end = force(&contact(&bench.step(&mut state.clone(), sample)));
            }
            by_steps.set_column(axis, &((ends[0] - ends[1]) / (2.0 * step)));
            said.set_column(axis, &Vector3::from_fn(|i, _| found.tangent[i][axis]));
        }
        let error = (said - by_steps).norm() / by_steps.norm();
        println!("slips {slips}: tangent off by {error:.1e}");
        let most = if slips { 0.03 } else { 2e-3 };
        assert!(error < most, "slips {slips}: {said} {by_steps}");
    }
}

const TISSUES: [&str; 3] = ["linear", "corotational", "hyperelastic"];

/// A slab held as a whole on top, or on half of it, with a tool.
fn scene(tissue: &str, fixed: &str, tool: &str) -> Scene {
    let text = format!(
        "[mesh.slab]\nsize_m = [0.06, 0.06, 0.02]\ndivisions = [8, 8, 3]\n\
         [tissue]\nmodel = \"{tissue}\"\nyoungs_modulus_pa = 10e3\npoisson_ratio = 0.4\n\
         [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.02 }}\n\
         [[fixed]]\n{fixed}\n{tool}\n"
    );
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    Scene::read(&Document::embedded("walls.toml", &folder, &text), "walls").expect("good")
}

const TOP: &str = "plane = { axis = \"z\", at_m = 0.0 }";
const LEFT: &str = "box = { min_m = [-1.0, -1.0, -0.001], max_m = [0.001, 1.0, 1.0] }";

/// Tools whose lowest point is where the grip is, or nearly.
const SHAPES: [&str; 8] = [
    "radius_m = 0.012\noffset_m = [0.0, 0.0, 0.012]",
    "radius_m = 0.012\noffset_m = [0.0, 0.0, 0.012]\nfriction = 0.3",
    "shape = \"capsule\"\nradius_m = 0.008\nlength_m = 0.02\naxis = [1.0, 0.0, 0.0]\noffset_m = [0.01, 0.0, 0.008]",
    "shape = \"flat-punch\"\nradius_m = 0.011\nlength_m = 0.03\nfillet_m = 0.002",
    "shape = \"rounded-box\"\nsize_m = [0.02, 0.02, 0.02]\nfillet_m = 0.003\nfriction = 0.2",
    "shape = \"mesh\"\nmesh = \"bracket.stl\"\nscale_to_m = 0.001\nfillet_m = 0.001",
    "shape = \"grip\"\nbody = { radius_m = 0.004, length_m = 0.02, axis = [1.0, 0.0, 0.0], offset_m = [0.01, 0.0, 0.004] }",
    "shape = \"grip\"\nbody = { radius_m = 0.004, length_m = 0.02, offset_m = [0.0, 0.0, 0.004], friction = 0.2 }",
];

struct Hand {
    solver: SceneSolver,
    time_us: u64,
}

impl Hand {
    fn new(solver: SceneSolver) -> Self {
        Self { solver, time_us: 0 }
    }

    fn step(&mut self, at: [f64; 3]) -> StepReport {
        self.time_us += 10_000;
        let sample = ToolSample {
            id: 0,
            position_m: at,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: self.time_us,
        };
        let mut report = self.solver.step(sample);
        for _ in 0..100 {
            match report.status {
                Status::Waiting | Status::Behind => report = self.solver.step(sample),
                _ => break,
            }
        }
        report
    }

    /// Force up \[N\] at depths of up to a millimetre, from above at a place; whatever is held stays.
    fn press(&mut self, [x, y]: [f64; 2], above_m: f64) -> Vec<f64> {
        let start = self.step([x, y, above_m + 0.004]);
        assert_eq!((start.status, start.rows), (Status::Ok, 0));
        let heights = (0..=10).map(|part| above_m - 1e-4 * f64::from(part));
        let found = heights.map(|height_m| {
            let report = self.step([x, y, height_m]);
            assert_eq!(report.status, Status::Ok, "at {height_m}");
            report.contacts()[0].wrench[2]
        });
        found.collect()
    }
}

fn assert_grows(forces_n: &[f64], what: &str) {
    let last = forces_n.last().copied().unwrap_or_default();
    assert!(last > 1.0, "{what}: {forces_n:?}");
    let mut pairs = forces_n.windows(2);
    assert!(
        pairs.all(|pair| pair[1] >= pair[0] - 1e-9),
        "{what}: {forces_n:?}"
    );
}

/// Height of the grip at which a tool touches a plane at z = 0 \[m\].
fn touches_at(tool: &str) -> f64 {
    if tool.contains("mesh") { 0.0 } else { 0.0005 }
}

#[test]
fn what_is_held_as_a_whole_stops_every_shape_on_every_tissue() {
    for tissue in TISSUES {
        for shape in SHAPES {
            let scene = scene(tissue, TOP, &format!("[[tool]]\n{shape}"));
            let mut hand = Hand::new(SceneSolver::new(&scene).expect("a solver"));
            let forces_n = hand.press([0.0013, 0.0021], touches_at(shape));
            assert_grows(&forces_n, &format!("{tissue}, {shape}"));
            let nodes_m = hand.solver.positions_m();
            let moved = scene
                .mesh
                .points_m()
                .iter()
                .zip(nodes_m.iter())
                .map(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm());
            // The sides alone are free, and nothing presses on them.
            assert!(moved.fold(0.0, f64::max) < 1e-9, "{tissue}, {shape}");
        }
    }
}

/// Half of the top is held: what stands on its edge is borne by both parts.
#[test]
fn a_tool_beside_a_clamp_is_borne_by_it() {
    for tissue in TISSUES {
        for shape in [SHAPES[0], SHAPES[3], SHAPES[4]] {
            let scene = scene(tissue, LEFT, &format!("[[tool]]\n{shape}"));
            let mut hand = Hand::new(SceneSolver::new(&scene).expect("a solver"));
            let forces_n = hand.press([-0.001, 0.0021], touches_at(shape));
            assert_grows(&forces_n, &format!("{tissue}, {shape}"));
        }
    }
}

/// Through a wall nothing comes out on the other side: pressed in beyond its middle a ball is inside, and says so.
#[test]
fn a_ball_is_never_drawn_through_a_wall() {
    for tissue in TISSUES {
        let scene = scene(tissue, TOP, &format!("[[tool]]\n{}", SHAPES[0]));
        let mut hand = Hand::new(SceneSolver::new(&scene).expect("a solver"));
        hand.step([0.001, 0.0, 0.003]);
        let mut inside = false;
        for part in 0..40 {
            let report = hand.step([0.001, 0.0, -5e-4 * f64::from(part)]);
            match report.status {
                Status::Ok => {
                    let up_n = report.contacts()[0].wrench[2];
                    assert!(up_n >= 0.0 && !inside, "{tissue}: {up_n} N in step {part}");
                    assert!(part < 2 || up_n > 1.0, "{tissue}: {up_n} N in step {part}");
                }
                Status::Inside => inside = true,
                other => panic!("{tissue}: {other:?}"),
            }
        }
        assert!(inside, "{tissue}");
    }
}

#[test]
fn what_is_held_stops_the_body_of_a_needle() {
    for tissue in TISSUES {
        let needle = "[tissue.needle]\nfriction_n_per_m = 5.0\npuncture_pa = 2e5\nsurface_friction = 0.2\n\
                      [[tool]]\nshape = \"grip\"\n\
                      [[needle]]\nshape = \"straight\"\nlength_m = 0.03\nthickness_m = 0.001\nbody = true\n\
                      end_m = [-0.015, 0.002, 0.004]\ndirection = [1.0, 0.0, 0.0]\n\
                      hold = [{ time_s = 0.0, tool = 0 }]";
        let scene = scene(tissue, TOP, needle);
        let mut hand = Hand::new(SceneSolver::new(&scene).expect("a solver"));
        let mut forces_n = Vec::new();
        for part in 0..=20 {
            // The grip is where the needle's frame says; lowered by 0.2 mm at a time until the shaft lies on the top.
            let report = hand.step([0.0, 0.0, -2e-4 * f64::from(part)]);
            assert_eq!(report.status, Status::Ok);
            forces_n.push(report.contacts()[0].wrench[2]);
        }
        assert_grows(&forces_n, tissue);
    }
}

/// Models that tools stick to have walls as well.
#[test]
fn what_is_held_stops_tools_on_models_that_they_stick_to() {
    for entry in models() {
        let model = Registered::new(entry.tissue, None).expect("it is there");
        if model.has_rows() {
            continue;
        }
        let scene = scene("linear", TOP, &format!("[[tool]]\n{}", SHAPES[0]));
        let solver = SceneSolver::sticking(&scene, model, Rendering::Tangent, 100.0);
        let mut hand = Hand::new(solver.expect("a solver"));
        let forces_n = hand.press([0.0013, 0.0021], 0.0005);
        assert_grows(&forces_n, model.name());
        let here = hand.step([0.0013, 0.0021, -0.0004]).contacts()[0];
        let there = hand.step([0.0013, 0.0021, -0.0004 - 1e-8]).contacts()[0];
        let slope = (here.wrench[2] - there.wrench[2]) / 1e-8;
        assert!(
            (slope / here.tangent[2][2] - 1.0).abs() < 1e-3,
            "{}: {slope} {}",
            model.name(),
            here.tangent[2][2]
        );
    }
}

/// Reactions and tool forces sum to zero, also if constraints act on nodes that are
/// fixed.
#[test]
fn forces_on_tissue_sum_to_zero_with_what_is_fixed() {
    let spring = "[[spring]]\nfrom_m = [-0.03, 0.0, 0.0]\nto_m = [0.0, 0.0, 0.03]\nto_is_fixed = true\n\
                  stiffness_n_per_m = 40.0\nlength_m = 0.02\n";
    let across = "[[spring]]\nfrom_m = [0.01, 0.0, 0.0]\nto_m = [-0.01, 0.01, 0.0]\n\
                  stiffness_n_per_m = 40.0\nlength_m = 0.01\n";
    for tissue in TISSUES {
        for (shape, more) in [
            (SHAPES[0], ""),
            (SHAPES[1], across),
            (SHAPES[3], ""),
            (SHAPES[2], ""),
            (SHAPES[0], spring),
        ] {
            let tool = format!("{more}[[tool]]\n{shape}\nposition_m = [-0.001, 0.0011, -0.0004]");
            let solution = solve(&scene(tissue, LEFT, &tool)).expect("a rest");
            let tool_n = Vector3::from(solution.tools[0].force_n);
            assert!(tool_n.z < -0.1, "{tissue}, {shape}: {tool_n}");
            let mut sum = tool_n + Vector3::from(solution.fixed_force_n);
            if more == spring {
                // The end that is fixed in the room holds against what is left.
                assert!(sum.norm() > 0.1);
                let from = Vector3::new(-0.03, 0.0, 0.0);
                let way = Vector3::new(0.0, 0.0, 0.03) - from;
                sum += way.normalize() * 40.0 * (way.norm() - 0.02);
            }
            let error = sum.norm() / tool_n.norm();
            assert!(error < 1e-9, "{tissue}, {shape}, {more}: {error:e}");
        }
    }
}

/// Without a hand `solve` and steps find the same of a tool on a wall; with friction the force depends on the way there.
#[test]
fn solve_and_steps_say_the_same_of_a_wall() {
    for shape in SHAPES.iter().filter(|shape| !shape.contains("friction")) {
        let text = format!("[[tool]]\n{shape}\nposition_m = [0.001, 0.002, -0.0003]");
        let scene = scene("linear", TOP, &text);
        let solution = solve(&scene).expect("a rest");
        let mut hand = Hand::new(SceneSolver::new(&scene).expect("a solver"));
        hand.step([0.001, 0.002, 0.004]);
        let report = hand.step([0.001, 0.002, -0.0003]);
        let felt = force(&report.contacts()[0]);
        let solved = -Vector3::from(solution.tools[0].force_n);
        // A bar that touches along its length slips along a path, and both do not end alike.
        let most = if shape.contains("body") { 0.01 } else { 1e-3 };
        assert!(felt.z > 0.5, "{shape}: {felt}");
        assert!(
            (felt - solved).norm() < most * felt.norm(),
            "{shape}: {felt} {solved}"
        );
    }
}
