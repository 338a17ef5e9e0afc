//! Capsules and boxes: exact tangents, balances, and what they feel against spheres and punches.

use super::bench::{ARCH, Bench, RADIUS, at, ball, contact, force, pose, slab_mesh};
use super::jacobian::compare_jacobians;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::step::{State, Status};
use sutura_host::tool::{Shape, Tool};

const TIPPED: Shape = Shape::Capsule {
    radius_m: RADIUS,
    length_m: 0.03,
};
/// A bar that lies along x when its axis does.
const LYING: Shape = Shape::Capsule {
    radius_m: 0.01,
    length_m: 0.025,
};
const BOX: Shape = Shape::RoundedBox {
    size_m: [0.024, 0.03, 0.04],
    fillet_m: 0.004,
};

/// `shape` on a stick, looking along `axis`.
fn on_stick(shape: Shape, axis: [f64; 3]) -> Tool {
    Tool {
        axis,
        side: [0.0, 1.0, 0.0],
        ..Tool::new(shape, [0.02, -0.01, -0.05])
    }
}

#[test]
fn the_jacobian_of_a_capsule_is_exact_on_a_slab() {
    let bench = Bench::slab(on_stick(TIPPED, [0.0, 0.0, -1.0]));
    compare_jacobians(bench, at(0.0, 0.0, 0.2), 12, |chance| {
        let [x, y, z] = chance.vector().into();
        let centre = Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.005 + 0.002 * z);
        let turn = UnitQuaternion::from_scaled_axis(chance.vector() * 0.5);
        (centre, turn)
    });
}

#[test]
fn the_jacobian_of_a_lying_capsule_is_exact_on_a_slab() {
    let bench = Bench::slab(on_stick(LYING, [1.0, 0.0, 0.0]));
    compare_jacobians(bench, at(0.0, 0.0, 0.2), 15, |chance| {
        let [x, y, z] = chance.vector().into();
        let centre = Vector3::new(0.012 + 0.008 * x, 0.012 * y, 0.01 - 0.003 + 0.001 * z);
        let turn = UnitQuaternion::from_scaled_axis(chance.vector() * 0.1);
        (centre, turn)
    });
}

#[test]
fn the_jacobian_of_a_box_is_exact_on_a_slab() {
    let bench = Bench::slab(on_stick(BOX, [0.0, 0.0, -1.0]));
    compare_jacobians(bench, at(0.0, 0.0, 0.2), 12, |chance| {
        let [x, y, z] = chance.vector().into();
        let centre = Vector3::new(0.01 * x, 0.01 * y, -0.0015 + 0.001 * z);
        let turn = UnitQuaternion::from_scaled_axis(chance.vector() * 0.3);
        (centre, turn)
    });
}

/// Rather by its edges: the box lies aslant on a curved top.
#[test]
fn the_jacobian_of_a_box_is_exact_on_an_arch() {
    let bench = Bench::arch(on_stick(BOX, [0.0, 0.0, -1.0]));
    compare_jacobians(bench, at(0.0, 0.0, 0.2), 6, |chance| {
        let [angle, y, depth] = chance.vector().into();
        let out = Vector3::new((0.3 * angle).sin(), 0.0, (0.3 * angle).cos());
        let height = ARCH - 0.001 + 0.001 * depth;
        let centre = out * height + Vector3::new(0.0, 0.012 * y, -ARCH);
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.4, 0.7) * angle);
        let turn = UnitQuaternion::from_scaled_axis(chance.vector() * 0.3) * lean;
        (centre, turn)
    });
}

/// Deep in the tissue and slowly turned there, nothing is inside, and forces are normal and where it touches.
#[test]
fn balances_under_what_turns_in_the_tissue() {
    for (shape, axis, height) in [
        (TIPPED, [0.0, 0.0, -1.0], RADIUS),
        (LYING, [1.0, 0.0, 0.0], 0.01),
        (BOX, [0.0, 0.0, -1.0], 0.0),
    ] {
        let tool = Tool {
            axis,
            side: [0.0, 1.0, 0.0],
            ..Tool::new(shape.clone(), [0.0; 3])
        };
        let mut bench = Bench::slab(tool);
        let mut state = State::new(&bench.model);
        bench.step(&mut state, at(0.0013, 0.0007, 0.05));
        let mut missed = 0;
        for tick in 0..=40u32 {
            let part = f64::from(tick) / 40.0;
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.08, 0.6) * part);
            let place = Vector3::new(0.0013, 0.0007, height - 0.009 * part);
            let sample = pose(place, turn);
            let report = bench.step(&mut state, sample);
            // A vertex that slips over an edge may leave a pose without a balance that Newton's method finds.
            if report.status == Status::NotConverged {
                missed += 1;
                continue;
            }
            assert_eq!(report.status, Status::Ok, "{shape:?} at {tick}");
            bench.assert_balanced(&state, &[sample]);
            // Force and moment are those of the vertices, about the grip.
            let felt = contact(&report);
            let moved = bench.model.equilibrium(&state).expect("a balance");
            let (mut sum, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for (node, on_tissue) in state.contact_forces(&bench.model) {
                let node = node as usize;
                let at = Vector3::from(bench.model.points_m()[node])
                    + Vector3::from(moved.displacement_m[node]);
                sum -= Vector3::from(on_tissue);
                moment -= (at - place).cross(&Vector3::from(on_tissue));
            }
            let felt_moment = Vector3::from_column_slice(&felt.wrench[3..]);
            assert!((sum - force(&felt)).norm() <= 1e-9 * sum.norm());
            assert!((moment - felt_moment).norm() <= 1e-9 * sum.norm() * RADIUS);
        }
        assert!(missed <= 1, "{shape:?}: {missed} poses");
    }
}

/// One step of a capsule without length is one of a sphere, bit by bit.
#[test]
fn a_capsule_without_length_feels_what_a_sphere_feels() {
    let shape = Shape::Capsule {
        radius_m: RADIUS,
        length_m: 0.0,
    };
    let offset = [0.02, -0.01, -0.05];
    let sample = pose(
        Vector3::new(-0.018, 0.012, 0.05 + RADIUS - 0.006),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.02)),
    );
    let felt = [Tool::new(shape, offset), ball(offset)].map(|tool| {
        let (_, report) = Bench::slab(tool).afresh(at(0.0, 0.0, 0.2), sample);
        contact(&report)
    });
    assert!(felt[0].rows > 8);
    assert_eq!(felt[0], felt[1]);
}

/// Force at the same depth: a ball, a bar of its radius that lies, and the box around that, each within the next; the bar,
/// twice as long, feels about as much more by each length.
#[test]
fn a_lying_bar_feels_more_than_a_ball_and_less_than_a_box() {
    let (mesh, bottom) = slab_mesh();
    let radius_m = 0.012;
    let bar = |length_m| Shape::Capsule { radius_m, length_m };
    let lying = |shape, half: f64| Tool {
        axis: [1.0, 0.0, 0.0],
        ..Tool::new(shape, [half, 0.0, 0.0])
    };
    let size_m = [0.044, 0.024, 0.024];
    let tools = [
        Tool::sphere(radius_m, [0.0; 3]),
        lying(bar(0.01), 0.005),
        lying(bar(0.02), 0.01),
        Tool::new(Shape::rounded_box(size_m), [0.0, 0.0, -0.012]),
    ];
    let press = |tool: Tool| {
        let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool)]);
        let sample = at(0.0, 0.0, radius_m - 0.003);
        let (state, report) = bench.afresh(at(0.0, 0.0, 0.05), sample);
        bench.assert_balanced(&state, &[sample]);
        force(&contact(&report))
    };
    let forces = tools.map(press);
    println!("{forces:?}");
    for pair in forces.windows(2) {
        assert!(pair[1].z > 1.1 * pair[0].z, "{forces:?}");
    }
    let [ball, short, long, _] = forces;
    let each = (long.z - short.z) / (short.z - ball.z);
    assert!((0.7..1.3).contains(&each), "{each}");
    // The slab is its own mirror image.
    for force in forces {
        assert!(force.xy().norm() < 1e-9 * force.z, "{force}");
    }
}

/// Slowly or at once, a box that turns about its own axis ends in the same balance.
#[test]
fn a_box_that_turns_at_once_ends_where_it_turns_slowly() {
    let mut bench = Bench::slab(Tool::new(BOX, [0.0; 3]));
    let turn = |part: f64| {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.05, 0.08, 0.5) * part);
        pose(Vector3::new(0.002, 0.001, -0.001), rotation)
    };
    let (mut state, _) = bench.afresh(at(0.0, 0.0, 0.1), turn(0.0));
    for tick in 1..=100 {
        let report = bench.step(&mut state, turn(f64::from(tick) / 100.0));
        assert_eq!(report.status, Status::Ok, "tick {tick}");
    }
    let slowly = contact(&bench.step(&mut state, turn(1.0)));
    let (mut state, _) = bench.afresh(at(0.0, 0.0, 0.1), turn(0.0));
    let mut report = bench.step(&mut state, turn(1.0));
    assert!(report.substeps > 1, "{} pieces", report.substeps);
    for _ in 0..20 {
        if report.status != Status::Behind {
            break;
        }
        report = bench.step(&mut state, turn(1.0));
    }
    let error = (force(&contact(&report)) - force(&slowly)).norm() / force(&slowly).norm();
    assert!(error < 1e-8, "off by {error:e}");
}
