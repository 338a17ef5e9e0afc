//! Tools that a hand takes deeper than they can be pressed: pushed out, or said to be inside.

use super::bench::*;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use sutura_host::fem::Loads;
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::scene::{Document, Pose, Scene};
use sutura_host::script::at_rest;
use sutura_host::session::SceneSolver;
use sutura_host::step::{State, Status, StepReport};
use sutura_host::tool::{ClosedMesh, Shape, Tool};
use sutura_testkit::full;

const HZ: f64 = 200.0;
const DEEPEST_M: f64 = 0.025;
/// Largest fall of a force on the way in, as a share and \[N\].
const FALL: (f64, f64) = (0.02, 0.03);
/// Over the slab's middle, on a vertex, on an edge, inside a triangle, near a side, near a corner, and two between these \[m\].
const PLACES_M: [[f64; 2]; 8] = [
    [0.0, 0.0],
    [0.0017, 0.0011],
    [0.004, 0.004],
    [0.002, 0.0],
    [0.028, 0.0],
    [0.028, 0.029],
    [-0.0213, 0.0107],
    [0.0113, -0.0309],
];

fn scene(law: &str, tool: &str, divisions: [u32; 3]) -> Scene {
    let text = format!(
        r#"
[mesh.slab]
size_m = [0.08, 0.08, 0.03]
divisions = {divisions:?}
[tissue]
model = "{law}"
youngs_modulus_pa = 15e3
poisson_ratio = 0.45
[[fixed]]
plane = {{ axis = "z", at_m = -0.03 }}
[[tool]]
{tool}
"#
    );
    Scene::read(&Document::embedded("deep.toml", "".as_ref(), &text), "deep").expect("good")
}

fn step_to(solver: &mut SceneSolver, position_m: [f64; 3], time_s: f64) -> StepReport {
    let pose = Pose {
        position_m,
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    let mut sample = at_rest(0, &pose);
    sample.console_time_us = (1e6 * time_s) as u64;
    solver.step(sample)
}

/// Drags the ball down in `seconds`; how often it was said to be inside or without balance.
fn drag(scene: &Scene, [x, y]: [f64; 2], seconds: f64, what: &str) -> u32 {
    let mut solver = SceneSolver::new(scene).expect("a solver");
    let steps = (seconds * HZ) as u32;
    let (mut hardest_n, mut words) = (0.0f64, 0);
    for number in 0..=steps {
        let depth_m = DEEPEST_M * f64::from(number) / f64::from(steps);
        let time_s = f64::from(number) / HZ;
        let report = step_to(&mut solver, [x, y, RADIUS - depth_m], time_s);
        let place = format!("{what}, at {x} {y}, {:.2} mm deep", 1e3 * depth_m);
        match report.status {
            Status::Ok | Status::Behind => {}
            Status::Waiting => continue,
            Status::Inside | Status::NotConverged => {
                (hardest_n, words) = (0.0, words + 1);
                continue;
            }
            other => panic!("{place}: {other:?}"),
        }
        let force_n = report.contacts()[0].wrench[2];
        assert!(force_n >= 0.0, "{place}: it pulls by {force_n} N");
        assert!(
            depth_m < 2e-3 || (report.rows > 0 && force_n > 0.03),
            "{place}: {force_n} N by {} vertices",
            report.rows
        );
        let (share, least_n) = FALL;
        assert!(
            force_n >= hardest_n - f64::max(share * hardest_n, least_n),
            "{place}: {force_n} N after {hardest_n} N"
        );
        hardest_n = hardest_n.max(force_n);
    }
    words
}

/// On a moist surface and without friction, on all tissue with rows. `SUTURA_FULL=1`: everywhere, and as slowly as a hand goes.
#[test]
fn a_ball_that_is_dragged_deep_is_pushed_out_or_said_to_be_inside() {
    let seconds: &[f64] = if full() { &[0.5, 5.0, 50.0] } else { &[0.5] };
    let mut words = 0;
    for (law, divisions) in [
        ("linear", [20, 20, 8]),
        ("corotational", [10, 10, 4]),
        ("hyperelastic", [10, 10, 4]),
    ] {
        let places = if full() || law == "linear" { 8 } else { 2 };
        for friction in [0.0, 0.1] {
            let tool = format!("radius_m = {RADIUS}\nfriction = {friction}");
            let scene = scene(law, &tool, divisions);
            for seconds in seconds {
                for place in &PLACES_M[PLACES_M.len() - places..] {
                    let what = format!("{law} tissue, friction {friction}, in {seconds} s");
                    words += drag(&scene, *place, *seconds, &what);
                }
            }
        }
    }
    assert!(words > 100, "{words}");
}

/// A ball with friction goes in by more than its radius, and nothing is wrong with that.
#[test]
fn a_ball_with_friction_goes_deeper_than_its_radius() {
    let scene = scene("linear", "radius_m = 0.014\nfriction = 0.1", [20, 20, 8]);
    let mut solver = SceneSolver::new(&scene).expect("a solver");
    for number in 0..=150_u32 {
        let z = RADIUS - 1e-4 * f64::from(number);
        let report = step_to(&mut solver, [0.0017, 0.0011, z], f64::from(number) / HZ);
        assert_eq!(report.status, Status::Ok, "{z}");
    }
    // Aside, and up again as fast as a hand is.
    for number in 0..=40_u32 {
        let x = 0.0017 + 5e-4 * f64::from(number);
        let report = step_to(&mut solver, [x, 0.0011, 0.006], 1.0);
        assert_eq!(report.status, Status::Ok, "{x}");
    }
    let report = step_to(&mut solver, [0.0217, 0.0011, 0.05], 1.1);
    assert_eq!((report.status, report.rows), (Status::Ok, 0));
}

/// Shapes that are thicker than the surface's edges.
const SHAPES: [&str; 5] = [
    "radius_m = 0.014",
    "shape = \"capsule\"\nradius_m = 0.009\nlength_m = 0.02\naxis = [1.0, 0.0, 0.0]",
    "shape = \"capsule\"\nradius_m = 0.009\nlength_m = 0.05",
    "shape = \"flat-punch\"\nradius_m = 0.01\nfillet_m = 0.003\nlength_m = 0.05",
    "shape = \"rounded-box\"\nsize_m = [0.02, 0.016, 0.02]\nfillet_m = 0.004",
];

/// In one step from above to below a slab, and into it: nothing goes through as if there was no tissue.
#[test]
fn no_tool_crosses_tissue_in_one_step() {
    for law in ["linear", "corotational", "hyperelastic"] {
        for shape in SHAPES {
            for friction in [0.0, 0.1] {
                let scene = scene(law, &format!("{shape}\nfriction = {friction}"), [10, 10, 4]);
                for z in [-0.2, -0.02] {
                    let what = format!("{law}, {shape}, friction {friction}, to {z}");
                    let mut solver = SceneSolver::new(&scene).expect("a solver");
                    step_to(&mut solver, [0.001, 0.0007, 0.05], 0.0);
                    let mut report = step_to(&mut solver, [0.001, 0.0007, z], 0.005);
                    for _ in 0..8 {
                        if report.status != Status::Waiting {
                            break;
                        }
                        report = step_to(&mut solver, [0.001, 0.0007, z], 0.005);
                    }
                    let felt_n = report.contacts().first().map_or(0.0, |felt| felt.wrench[2]);
                    assert!(
                        !report.status.has_balance() || felt_n > 0.03,
                        "{what}: {:?}, {felt_n} N",
                        report.status
                    );
                    assert!(report.status != Status::Ok || z > -0.1, "{what}");
                }
            }
        }
    }
}

/// The slab that a ball is pressed into, moved and turned as a whole: the same words at the same depths.
#[test]
fn where_up_is_is_of_no_consequence() {
    let flat = slab([0.08, 0.08, 0.03], [16, 16, 6]).expect("a slab");
    let bottom: Vec<u32> = (0..17 * 17).collect();
    let turns = [[0.0; 3], [0.3, -2.1, 0.9]];
    let said = turns.map(|turn| {
        let place = Isometry3::from_parts(
            Translation3::new(0.1, -0.2, 0.3),
            UnitQuaternion::from_scaled_axis(turn.into()),
        );
        let points = flat.points_m().iter();
        let points = points.map(|point| (place * Point3::from(*point)).coords.into());
        let mesh = TetMesh::new(points.collect(), flat.cells().to_vec()).expect("the same slab");
        let tools = [(0, ball([0.0; 3]))];
        let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
        let mut state = State::new(&bench.model);
        let steps = (0..=100_u32).map(|number| {
            let depth_m = DEEPEST_M * f64::from(number) / 100.0;
            let at = place * Point3::new(0.0017, 0.0011, RADIUS - depth_m);
            bench
                .step(&mut state, pose(at.coords, place.rotation))
                .status
        });
        steps.collect::<Vec<_>>()
    });
    let first = |said: &[Status]| said.iter().position(|status| *status != Status::Ok);
    assert_eq!(first(&said[0]), first(&said[1]));
    let word = first(&said[0]).map(|at| said[0][at]);
    assert_eq!(word, Some(Status::Inside), "{said:?}");
}

/// Two blocks, and a ball that is pushed into the gap between them: both push it out, one against the other, and nothing is slipped in.
#[test]
fn between_two_pieces_of_tissue_a_ball_is_not_inside() {
    let one = slab([0.03, 0.06, 0.03], [8, 16, 8]).expect("a slab");
    let moved = |by: f64| {
        let points = one.points_m().iter().map(|p| [p[0] + by, p[1], p[2]]);
        TetMesh::new(points.collect(), one.cells().to_vec()).expect("the same slab")
    };
    let mesh = moved(-0.025).beside(&moved(0.025)).expect("apart");
    let bottom: Vec<u32> = (0u32..)
        .zip(mesh.points_m())
        .filter(|(_, point)| point[2] < -0.0299)
        .map(|(node, _)| node)
        .collect();
    let tool = Tool::sphere(RADIUS, [0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool)]);
    let mut state = State::new(&bench.model);
    let mut touched = 0;
    for number in 0..=60_u32 {
        let z = 0.012 - 3e-4 * f64::from(number);
        let report = bench.step(&mut state, at(0.0, 0.0007, z));
        assert_eq!(report.status, Status::Ok, "{z}");
        touched += u32::from(report.rows > 0);
    }
    assert!(touched > 40, "{touched}");
}

/// From the side, on the slab's edge, and drawn along with friction: contact without a word.
#[test]
fn contact_from_the_side_and_along_is_no_slip() {
    let ball = |friction| Tool {
        friction,
        ..Tool::sphere(RADIUS, [0.0; 3])
    };
    let lying = Tool {
        friction: 0.3,
        axis: [1.0, 0.0, 0.0],
        ..Tool::new(
            Shape::Capsule {
                radius_m: 0.01,
                length_m: 0.02,
            },
            [0.01, 0.0, 0.0],
        )
    };
    let ways: [(Tool, Vector3<f64>, Vector3<f64>); 4] = [
        (
            ball(0.0),
            Vector3::new(0.055, 0.0007, -0.012),
            -Vector3::x(),
        ),
        (
            ball(0.1),
            Vector3::new(0.051, 0.0007, 0.009),
            Vector3::new(-0.7, 0.0, -0.7),
        ),
        (ball(0.3), Vector3::new(-0.012, 0.0007, 0.009), Vector3::x()),
        (lying, Vector3::new(0.0, -0.012, 0.005), Vector3::y()),
    ];
    for (number, (tool, from, along)) in ways.into_iter().enumerate() {
        let mut bench = Bench::slab(tool);
        let mut state = State::new(&bench.model);
        bench.step(
            &mut state,
            pose(
                from + Vector3::new(0.05, 0.0, 0.1),
                UnitQuaternion::identity(),
            ),
        );
        bench.step(
            &mut state,
            pose(from + Vector3::z() * 0.015, UnitQuaternion::identity()),
        );
        let mut touched = 0;
        for step in 0..=80_u32 {
            let to = from + along * (1e-4 * f64::from(step));
            let report = bench.step(&mut state, pose(to, UnitQuaternion::identity()));
            assert_eq!(report.status, Status::Ok, "{number}: {to}");
            touched += u32::from(report.rows > 0);
        }
        assert!(touched > 40, "{number}: {touched}");
    }
}

/// Tools with a flat face that are pressed in and drawn along: tissue draws them down by friction alone, and where it comes
/// through the face that is said. `SUTURA_FULL=1`: more tools, depths and laws.
#[test]
fn a_flat_face_that_is_drawn_along_is_pressed_up_or_said_to_be_inside() {
    let tools = [
        "shape = \"flat-punch\"\nradius_m = 0.008",
        "shape = \"flat-punch\"\nradius_m = 0.008\nlength_m = 0.04\naxis = [0.0, 0.0, 1.0]\noffset_m = [0.0, 0.0, 0.04]",
        "shape = \"rounded-box\"\nsize_m = [0.016, 0.016, 0.02]",
        "shape = \"flat-punch\"\nradius_m = 0.014",
    ];
    let cases = [(0.1, 5.5e-3), (0.0, 5.5e-3), (0.1, 3e-3), (0.3, 4e-3)];
    let (laws, tools, cases): (&[&str], _, _) = if full() {
        (&["linear", "corotational"], &tools[..], &cases[..])
    } else {
        (&["linear"], &tools[..1], &cases[..2])
    };
    let (mut words, mut pressed) = (0, 0);
    for law in laws {
        for tool in tools {
            for (friction, depth_m) in cases {
                let scene = scene(law, &format!("{tool}\nfriction = {friction}"), [20, 20, 8]);
                let what = format!("{law}, {tool}, friction {friction}, {depth_m} m deep");
                let mut solver = SceneSolver::new(&scene).expect("a solver");
                for part in 0..=20_u32 {
                    let z = 5e-4 - depth_m * f64::from(part) / 20.0;
                    go(&mut solver, [-0.02, 0.001, z]);
                }
                for part in 0..=160_u32 {
                    let x = -0.02 + 2.5e-4 * f64::from(part);
                    let report = go(&mut solver, [x, 0.001, 5e-4 - depth_m]);
                    match report.status {
                        Status::Ok => pressed += 1,
                        Status::Inside => {
                            words += 1;
                            continue;
                        }
                        other => panic!("{what}, at {x}: {other:?}"),
                    }
                    let felt = report.contacts()[0].wrench;
                    let least_n = -friction * felt[0].hypot(felt[1]) - 1e-3;
                    assert!(felt[2] >= least_n, "{what}, at {x}: {felt:?}");
                }
            }
        }
    }
    assert!(words > 0 && pressed > 200, "{words}, {pressed}");
}

/// Over a rim and back, and onto the rim from beside: tissue slips from a ball's front to under it, and the ball is still pushed out.
#[test]
fn a_ball_at_a_rim_is_not_inside() {
    let over = [[0.0, 0.0, 0.008], [0.06, 0.0, 0.008], [0.0, 0.0, 0.008]];
    let onto = [[0.06, 0.0, 0.002], [0.0, 0.0, 0.002]];
    for (law, friction, divisions, way) in [
        ("linear", 0.5, [12, 12, 5], &over[..]),
        ("hyperelastic", 0.1, [12, 12, 5], &over[..]),
        ("linear", 0.1, [20, 20, 8], &onto[..]),
    ] {
        let tool = format!("radius_m = {RADIUS}\nfriction = {friction}");
        let scene = scene(law, &tool, divisions);
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let mut from = Vector3::new(way[0][0], 0.0, 0.03);
        for to in way.iter().map(|to| Vector3::from(*to)) {
            for part in 1..=300_u32 {
                let at = from.lerp(&to, f64::from(part) / 300.0);
                let report = step_to(&mut solver, at.into(), 0.0);
                let status = report.status;
                assert_ne!(status, Status::Inside, "{law}, {friction}, {at}");
            }
            from = to;
        }
    }
}

/// A capsule that lies over a side of the slab, said from its one end and from its other: the same words at the same places.
#[test]
fn both_ends_of_a_tool_are_looked_at() {
    for friction in [0.0, 0.1] {
        let said = [-1.0, 1.0].map(|x| {
            let tool = format!(
                "shape = \"capsule\"\nradius_m = 0.012\nlength_m = 0.06\naxis = [{x:?}, 0.0, 0.0]\n\
                 offset_m = [{:?}, 0.0, 0.0]\nfriction = {friction}",
                0.03 * x
            );
            let mut solver =
                SceneSolver::new(&scene("linear", &tool, [20, 20, 8])).expect("a solver");
            let steps = (0..=100_u32).map(|part| {
                let z = 0.014 - 2.9e-4 * f64::from(part);
                step_to(&mut solver, [0.05, 0.001, z], 0.0).status
            });
            steps.collect::<Vec<_>>()
        });
        assert!(said[0].contains(&Status::Inside), "friction {friction}");
        assert_eq!(said[0], said[1], "friction {friction}");
    }
}

/// Balls that are pressed in on slanted ways: the force falls by no more than a tenth before they are said to be inside.
#[test]
fn a_ball_on_a_slanted_way_in_is_looked_at_as_well() {
    let mut words = 0;
    for (degrees, turn, friction) in [
        (36.0f64, 0.0f64, 0.0),
        (45.0, 0.0, 0.0),
        (45.0, 2.1, 0.1),
        (52.0, 1.0, 0.0),
        (52.0, 0.0, 0.1),
    ] {
        let shape = Shape::Sphere { radius_m: RADIUS };
        let tool = Tool {
            friction,
            ..Tool::new(shape, [0.0; 3])
        };
        let mut bench = Bench::slab(tool);
        let mut state = State::new(&bench.model);
        let (slant, mut hardest_n) = (degrees.to_radians().tan(), 0.0f64);
        for part in 0..=90_u32 {
            let z = RADIUS - 2.1e-4 * f64::from(part);
            let aside_m = slant * (0.5 * RADIUS - z);
            let report = bench.step(
                &mut state,
                at(aside_m * turn.cos(), aside_m * turn.sin(), z),
            );
            if report.status != Status::Ok {
                words += u32::from(report.status == Status::Inside);
                hardest_n = 0.0;
                continue;
            }
            let wrench = report.contacts()[0].wrench;
            let force_n = Vector3::new(wrench[0], wrench[1], wrench[2]).norm();
            assert!(
                force_n > 0.87 * hardest_n - 0.1,
                "{degrees} degrees towards {turn}, friction {friction}, {z}: {force_n} N after {hardest_n} N"
            );
            hardest_n = hardest_n.max(force_n);
        }
    }
    assert!(words > 0);
}

/// Presses a tool in from `above_m` to `below_m` while `turned` and `aside_m` tell its rotation \[rad\] and its way aside \[m\] by the
/// part of the way: the force against it falls to no less than this share before it is said to be inside, which it has to be.
fn is_inside_before_its_force_has_fallen(
    scene: &Scene,
    [above_m, below_m]: [f64; 2],
    least: f64,
    turned: impl Fn(f64) -> Vector3<f64>,
    aside_m: impl Fn(f64) -> f64,
    what: &str,
) {
    const STEPS: u32 = 200;
    let mut solver = SceneSolver::new(scene).expect("a solver");
    let mut hardest_n = 0.0f64;
    for step in 0..=STEPS {
        let part = f64::from(step) / f64::from(STEPS);
        let z = above_m + (below_m - above_m) * part;
        let [x, y, z_, w]: [f64; 4] = UnitQuaternion::from_scaled_axis(turned(part))
            .into_inner()
            .coords
            .into();
        let pose = Pose {
            position_m: [0.002 + aside_m(part), 0.0013, z],
            orientation: [x, y, z_, w],
        };
        let report = solver.step(at_rest(0, &pose));
        match report.status {
            Status::Ok | Status::Behind => {}
            Status::Inside => return,
            _ => continue,
        }
        let force_n = report.contacts()[0].wrench[2];
        assert!(
            force_n > least * hardest_n - 0.1,
            "{what}, {z} m: {force_n} N after {hardest_n} N"
        );
        hardest_n = hardest_n.max(force_n);
    }
    panic!("{what}: never inside");
}

/// However a tool turns on its way in, about its axis or with it.
#[test]
fn a_tool_that_turns_on_its_way_in_is_looked_at_as_well() {
    let to_and_fro = |part: f64| (10.0 * PI * part).sin() * 5.0f64.to_radians();
    for friction in [0.0, 0.1] {
        let tool = format!(
            "shape = \"capsule\"\nradius_m = 0.014\nlength_m = 0.05\naxis = [0.0, 0.0, -1.0]\nfriction = {friction}"
        );
        let scene = scene("linear", &tool, [20, 20, 8]);
        let pressed = |turned: &dyn Fn(f64) -> Vector3<f64>, what: &str| {
            let what = format!("{what}, friction {friction}");
            let none = |_| 0.0;
            is_inside_before_its_force_has_fallen(
                &scene,
                [0.016, -0.012],
                0.87,
                turned,
                none,
                &what,
            );
        };
        pressed(&|_| Vector3::zeros(), "still");
        pressed(&|part| Vector3::z() * part, "screwed");
        pressed(&|part| Vector3::z() * to_and_fro(part), "to and fro");
        pressed(&|part| Vector3::y() * to_and_fro(part), "tilted to and fro");
    }
}

/// However a hand trembles that presses a ball in.
#[test]
fn a_ball_in_a_hand_that_trembles_is_looked_at_as_well() {
    for (friction, aside_m, times) in [
        (0.0, 7e-4, 16.0),
        (0.0, 1.5e-3, 8.0),
        (0.1, 7e-4, 16.0),
        (0.1, 1.5e-3, 8.0),
    ] {
        let tool = format!("radius_m = {RADIUS}\nfriction = {friction}");
        let scene = scene("linear", &tool, [20, 20, 8]);
        let aside = |part: f64| aside_m * (2.0 * PI * times * part).sin();
        let still = |_| Vector3::zeros();
        let what = format!("{aside_m} m, {times} times, friction {friction}");
        is_inside_before_its_force_has_fallen(&scene, [0.015, -0.010], 0.75, still, aside, &what);
    }
}

/// A ball that is pressed in by its radius and drawn along, or to and fro, while it sinks or rises a little: nothing closes over it.
#[test]
fn a_ball_that_is_drawn_along_is_not_inside() {
    let along = |part: f64| 0.03 * part;
    let to_and_fro = |part: f64| 0.012 * (2.0 * TAU * part).sin();
    let ways: [(&str, &dyn Fn(f64) -> f64); 2] = [("along", &along), ("to and fro", &to_and_fro)];
    for (friction, z_m, sinks_m) in [
        (0.1, 1e-3, 3e-3),
        (0.1, 5e-4, 1e-3),
        (0.3, 1e-3, 1.5e-3),
        (0.3, 3e-3, 4e-3),
        (0.3, 0.0, -2e-3),
    ] {
        let tool = format!("radius_m = {RADIUS}\nfriction = {friction}");
        let scene = scene("linear", &tool, [20, 20, 8]);
        for (name, way) in ways {
            let mut solver = SceneSolver::new(&scene).expect("a solver");
            for step in 0..=30_u32 {
                let part = f64::from(step) / 30.0;
                let z = RADIUS + 5e-4 + (z_m - RADIUS - 5e-4) * part;
                step_to(&mut solver, [-0.015, 0.0, z], 0.0);
            }
            for step in 0..=160_u32 {
                let part = f64::from(step) / 160.0;
                let at = [way(part) - 0.015, 0.0, z_m - sinks_m * part];
                let status = step_to(&mut solver, at, 0.0).status;
                assert_ne!(
                    status,
                    Status::Inside,
                    "friction {friction}, {name}, {at:?}"
                );
            }
        }
    }
}

/// A ball that is held about its radius deep, or creeps in by less than a finger does, while another tool presses beside it: what its
/// force loses is not lost on its way.
#[test]
fn another_tool_beside_it_does_not_put_a_ball_inside() {
    for (friction, z_m) in [(0.1, 0.0), (0.1, -5e-4), (0.3, -5e-4)] {
        for creep_m in [1e-6, 1e-5] {
            let tools = format!(
                "id = 0\nradius_m = {RADIUS}\nfriction = {friction}\n\
                 [[tool]]\nid = 1\nradius_m = 0.012\nfriction = {friction}\n\
                 way_point = [{{ time_s = 0.5, position_m = [0.01, 0.0, 0.0125] }}, {{ time_s = 1.0, position_m = [0.01, 0.0, -0.0015] }}]\n"
            );
            let scene = scene("linear", &tools, [16, 16, 7]);
            let mut solver = SceneSolver::new(&scene).expect("a solver");
            let (mut pressed_n, mut least_n) = (0.0, f64::MAX);
            for step in 0..=100_u32 {
                let down = f64::from(step.min(40)) / 40.0;
                let creeps = f64::from(step.saturating_sub(40));
                let z = RADIUS + 5e-4 + (z_m - RADIUS - 5e-4) * down - creep_m * creeps;
                let time_s = if step < 40 { 0.0 } else { 0.5 + creeps / 120.0 };
                let report = step_to(&mut solver, [-0.012, 0.0, z], time_s);
                let what =
                    format!("friction {friction}, {z_m} m, creeps by {creep_m} m, step {step}");
                assert_ne!(report.status, Status::Inside, "{what}");
                let force_n = report.contacts()[0].wrench[2];
                if step == 40 {
                    pressed_n = force_n;
                }
                least_n = f64::min(least_n, if step < 40 { f64::MAX } else { force_n });
            }
            // Else there is nothing to be taken for a way in.
            assert!(least_n < 0.985 * pressed_n, "{least_n} of {pressed_n} N");
        }
    }
}

/// A ball of which three vertices press from above has been swallowed, though they are on one side of it.
#[test]
fn a_swallowed_ball_is_never_pulled_in() {
    for place in [[1e-3, 7e-4], [-0.01106, -0.01375]] {
        let tool = format!("radius_m = {RADIUS}");
        let scene = scene("corotational", &tool, [12, 12, 5]);
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let mut is_inside = false;
        for step in 0..140_u32 {
            let z = RADIUS + 1e-3 - 1e-3 * f64::from(step / 5);
            let report = step_to(&mut solver, [place[0], place[1], z], 0.0);
            is_inside |= report.status == Status::Inside;
            if report.status == Status::Ok {
                let force_n = report.contacts()[0].wrench[2];
                assert!(force_n > -0.03, "{place:?}, at {z}: {force_n} N");
            }
        }
        assert!(is_inside, "{place:?}");
    }
}

/// A bar that lies across two blocks presses on two patches, which both bear it.
#[test]
fn a_bar_across_two_blocks_is_looked_at_as_well() {
    let part = |name: &str, x: f64| {
        format!(
            "[[mesh.part]]\nname = \"{name}\"\nslab = {{ size_m = [0.03, 0.08, 0.03], divisions = [8, 20, 8] }}\nat_m = [{x}, 0.0, 0.0]\n"
        )
    };
    let (left, right) = (part("left", -0.027), part("right", 0.027));
    for friction in [0.0, 0.1] {
        let text = format!(
            "{left}{right}[tissue]\nmodel = \"linear\"\nyoungs_modulus_pa = 15e3\npoisson_ratio = 0.45\n\
             [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.03 }}\n[[tool]]\nshape = \"capsule\"\nradius_m = 0.01\nlength_m = 0.07\n\
             axis = [1.0, 0.0, 0.0]\noffset_m = [0.035, 0.0, 0.0]\nfriction = {friction}\n"
        );
        let scene = Scene::read(&Document::embedded("bar.toml", "".as_ref(), &text), "bar");
        let what = format!("friction {friction}");
        let still = |_| Vector3::zeros();
        is_inside_before_its_force_has_fallen(
            &scene.expect("good"),
            [0.012, -0.02],
            0.87,
            still,
            |_| -0.002,
            &what,
        );
    }
}

/// A ball as a mesh of 512 triangles: its force falls by no more than a tenth before it is said to be inside.
#[test]
fn a_ball_that_is_a_mesh_is_looked_at_as_well() {
    let fillet_m = 0.0014;
    let (points, triangles) = octahedron_ball(RADIUS - fillet_m, 3);
    let mesh = Arc::new(ClosedMesh::new(&points, &triangles).expect("closed"));
    for (friction, [x, y]) in [
        (0.0, [0.0021, 0.0013]),
        (0.1, [0.0021, 0.0013]),
        (0.0, [0.01, -0.005]),
    ] {
        let tool = Tool {
            friction,
            ..Tool::new(
                Shape::Mesh {
                    mesh: mesh.clone(),
                    fillet_m,
                },
                [0.0; 3],
            )
        };
        let mut bench = Bench::slab(tool);
        let mut state = State::new(&bench.model);
        let (mut hardest_n, mut words) = (0.0f64, 0);
        for part in 0..=60_u32 {
            let z = RADIUS - 3.5e-4 * f64::from(part);
            let report = bench.step(&mut state, at(x, y, z));
            if report.status == Status::Inside {
                words += 1;
                hardest_n = 0.0;
                continue;
            }
            let force_n = report.contacts()[0].wrench[2];
            assert!(
                force_n > 0.9 * hardest_n - 0.1,
                "friction {friction}, {z}: {force_n} N after {hardest_n} N"
            );
            hardest_n = hardest_n.max(force_n);
        }
        assert!(words > 0, "friction {friction}");
    }
}

/// Points \[m\] and triangles of an octahedron that is halved `times` and blown up to a ball.
fn octahedron_ball(radius_m: f64, times: u32) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let ends = [1.0, -1.0];
    let mut points: Vec<Vector3<f64>> = (0..3)
        .flat_map(|axis| ends.map(|end| Vector3::ith(axis, end)))
        .collect();
    let mut triangles = Vec::new();
    for corner in 0..8_u32 {
        let [x, y, z] = [0, 1, 2].map(|axis| 2 * axis + (corner >> axis & 1));
        let is_even = corner.count_ones() % 2 == 0;
        triangles.push(if is_even { [x, y, z] } else { [x, z, y] });
    }
    for _ in 0..times {
        let mut halves = BTreeMap::new();
        let mut half = |a: u32, b: u32| {
            *halves.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a as usize] + points[b as usize]).normalize());
                points.len() as u32 - 1
            })
        };
        let finer = triangles.iter().flat_map(|&[a, b, c]| {
            let [ab, bc, ca] = [half(a, b), half(b, c), half(c, a)];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        });
        triangles = finer.collect();
    }
    let points = points.iter().map(|point| (point * radius_m).into());
    (points.collect(), triangles)
}

/// Beside the middle of a cut a ball parts its lips: the force falls, and nothing has closed over it. Farther off one lip alone has it, and
/// may slip around it.
#[test]
fn a_ball_that_parts_the_lips_of_a_cut_is_not_inside() {
    let part = |name: &str, x: f64| {
        format!(
            "[[mesh.part]]\nname = \"{name}\"\nslab = {{ size_m = [0.04, 0.06, 0.03], divisions = [12, 16, 9] }}\nat_m = [{x}, 0.0, 0.0]\n"
        )
    };
    let (left, right) = (part("left", -0.02025), part("right", 0.02025));
    for friction in [0.0, 0.1] {
        let text = format!(
            "{left}{right}[tissue]\nmodel = \"linear\"\nyoungs_modulus_pa = 15e3\npoisson_ratio = 0.45\n\
             [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.03 }}\n[[tool]]\nradius_m = 0.008\nfriction = {friction}\n"
        );
        let scene = Scene::read(&Document::embedded("slit.toml", "".as_ref(), &text), "slit");
        let scene = scene.expect("good");
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        for part in 0..=100_u32 {
            let z = 0.012 - 1.5e-4 * f64::from(part);
            let report = step_to(&mut solver, [0.002, 0.001, z], 0.0);
            assert_eq!(report.status, Status::Ok, "friction {friction}, {z}");
        }
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let mut said = (0..=150_u32).map(|part| {
            let z = 0.012 - 1.5e-4 * f64::from(part);
            step_to(&mut solver, [0.007, 0.001, z], 0.0).status
        });
        assert!(
            said.any(|status| status == Status::Inside),
            "friction {friction}"
        );
    }
}

/// A slab with a cut from its upper face, as deep and at the top as wide as this \[m\].
fn cut_slab(depth_m: f64, width_m: f64) -> TetMesh {
    let whole = slab([0.08, 0.06, 0.03], [24, 16, 9]).expect("a slab");
    let mut points = whole.points_m().to_vec();
    let on_cut = |at: &[f64; 3]| at[0].abs() < 1e-9 && at[2] > 1e-9 - depth_m;
    let mut twin = BTreeMap::new();
    for node in 0..whole.points_m().len() {
        let at = points[node];
        if on_cut(&at) {
            let half_m = 0.5 * width_m * (1.0 + at[2] / depth_m);
            points[node][0] = half_m;
            twin.insert(node as u32, points.len() as u32);
            points.push([-half_m, at[1], at[2]]);
        }
    }
    let cells = whole.cells().iter().map(|cell| {
        let middle: f64 = cell
            .iter()
            .map(|node| whole.points_m()[*node as usize][0])
            .sum();
        cell.map(|node| *twin.get(&node).filter(|_| middle < 0.0).unwrap_or(&node))
    });
    TetMesh::new(points, cells.collect()).expect("a slab with a cut")
}

/// The same where the cut ends in the tissue, for balls that stay above its bottom: there the lips are one patch.
#[test]
fn a_ball_that_parts_the_lips_of_an_incision_is_not_inside() {
    for (depth_m, radius_m, friction, aside_m) in [
        (0.02, 0.012, 0.1, 0.003),
        (0.02, 0.012, 0.0, 0.003),
        (0.02, 0.005, 0.1, 0.002),
        (0.01, 0.008, 0.1, 0.002),
        (0.01, 0.012, 0.0, 0.003),
        (0.01, 0.005, 0.1, 0.002),
        (0.01, 0.008, 0.0, 0.002),
    ] {
        let shape = Shape::Sphere { radius_m };
        let tool = Tool {
            friction,
            ..Tool::new(shape, [0.0; 3])
        };
        let mesh = cut_slab(depth_m, 5e-4);
        let bottom = |node: &u32| mesh.points_m()[*node as usize][2] < 1e-9 - 0.03;
        let bottom: Vec<u32> = (0..mesh.points_m().len() as u32).filter(bottom).collect();
        let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool)]);
        let mut state = State::new(&bench.model);
        let (from, to) = (
            radius_m + 0.002,
            f64::max(-0.3 * radius_m, radius_m - 0.9 * depth_m),
        );
        for part in 0..=60_u32 {
            let z = from + (to - from) * f64::from(part) / 60.0;
            let report = bench.step(&mut state, at(aside_m, 0.001, z));
            assert_eq!(
                report.status,
                Status::Ok,
                "{depth_m} m deep, ball of {radius_m} m, friction {friction}, {aside_m} m aside, at {z}"
            );
        }
    }
}

/// Goes there in as many steps as that takes.
fn go(solver: &mut SceneSolver, position_m: [f64; 3]) -> StepReport {
    let mut report = step_to(solver, position_m, 0.0);
    for _ in 0..100 {
        match report.status {
            Status::Waiting | Status::Behind => report = step_to(solver, position_m, 0.0),
            _ => break,
        }
    }
    report
}

/// A ball through a slab and the floor that it is glued to, slowly and at once: inside as long as it has not come back, for held nodes are
/// a wall. Taken out on top it is felt again.
#[test]
fn a_ball_behind_the_floor_is_inside_until_it_is_taken_out() {
    let [x, y] = [0.02, 0.01];
    let behind = [-0.0306, -0.0336, -0.036, -0.0385, -0.046, -0.08];
    for law in ["linear", "corotational", "hyperelastic"] {
        for friction in [0.0, 0.1] {
            let tool = format!("radius_m = {RADIUS}\nfriction = {friction}");
            let scene = scene(law, &tool, [10, 10, 4]);
            let what = format!("{law}, friction {friction}");
            let mut solver = SceneSolver::new(&scene).expect("a solver");
            for part in 0..=30_u32 {
                go(&mut solver, [x, y, 0.016 - 1.5e-3 * f64::from(part)]);
            }
            for z in behind {
                let report = go(&mut solver, [x, y, z]);
                assert_eq!(report.status, Status::Inside, "{what}, at {z}");
                let mut at_once = SceneSolver::new(&scene).expect("a solver");
                go(&mut at_once, [x, y, 0.02]);
                go(&mut at_once, [x, y, z]);
                let report = go(&mut at_once, [x, y, z]);
                // Of tissue that is not linear no way may be found through all of it.
                let is_said = report.status == Status::Inside
                    || (report.status == Status::NotConverged && law != "linear");
                assert!(is_said, "{what}, at once to {z}: {:?}", report.status);
            }
            if law == "hyperelastic" {
                continue;
            }
            // Up through the slab, as a hand does whose motors are off, and pressed in again.
            let half_way = go(&mut solver, [x, y, 0.007]);
            assert_eq!(half_way.status, Status::Inside, "{what}");
            go(&mut solver, [x, y, 0.03]);
            let out = go(&mut solver, [x, y, 0.03]);
            assert_eq!((out.status, out.rows), (Status::Ok, 0), "{what}");
            let again = go(&mut solver, [x, y, 0.01]);
            assert_eq!(again.status, Status::Ok, "{what}");
            assert!(again.contacts()[0].wrench[2] > 0.1, "{what}");
        }
    }
}

/// Out of the side of a slab, which is free, and around it from behind the floor.
#[test]
fn a_ball_that_comes_out_of_a_free_side_is_felt_again() {
    let scene = scene("linear", "radius_m = 0.014", [10, 10, 4]);
    for (way, is_out) in [
        (&[[0.06, 0.0, -0.02]][..], [true].as_slice()),
        (
            &[[0.0, 0.0, -0.05], [0.06, 0.0, -0.05], [0.06, 0.0, -0.01]],
            &[false, false, true],
        ),
    ] {
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let mut last = Status::Ok;
        for part in 0..=20_u32 {
            let z = 0.016 - 1.8e-3 * f64::from(part);
            last = go(&mut solver, [0.0017, 0.0011, z]).status;
        }
        assert_eq!(last, Status::Inside);
        for (place, is_out) in way.iter().zip(is_out) {
            let expected = if *is_out { Status::Ok } else { Status::Inside };
            assert_eq!(go(&mut solver, *place).status, expected, "{place:?}");
        }
        let pressed = go(&mut solver, [0.051, 0.0, -0.012]);
        assert!(pressed.contacts()[0].wrench[0] > 0.0);
    }
}
