//! Balances: forces, energy, loads that stay, tools that are apart.

use super::bench::{Bench, RADIUS, at, ball, contact, force, pose, slab_mesh};
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::{Anchor, Handle, Loads, NodeLoad};
use sutura_host::step::State;
use sutura_host::tool::{Shape, Tool};
use sutura_testkit::Random;

#[test]
fn pushing_in_pushes_the_hand_out() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let mut last = 0.0;
    for depth in 1..=9 {
        let sample = at(0.0, 0.0, RADIUS - 1e-3 * f64::from(depth));
        let (state, report) = bench.afresh(at(0.0, 0.0, 0.05), sample);
        let contact = contact(&report);
        let push = force(&contact).z;
        assert!(push > last, "{push} N at {depth} mm, {last} N before");
        assert!(contact.tangent[2][2] < 0.0 && contact.normal[2] > 0.99 && contact.gap_m == 0.0);
        bench.assert_balanced(&state, &[sample]);
        last = push;
    }
    // An infinite half space gives 4/3 E/(1 - nu^2) sqrt(R) d^1.5 = 2.5 N (Hertz 1882); a slab of
    // finite depth on a table is stiffer, one with free sides softer.
    let hertz = 4.0 / 3.0 * 15e3 / (1.0 - 0.45f64.powi(2)) * RADIUS.sqrt() * 0.009f64.powf(1.5);
    println!("9 mm: {last} N, Hertz {hertz} N");
    assert!(
        last > hertz && last < 3.0 * hertz,
        "{last} N against Hertz's {hertz} N"
    );
}

#[test]
fn the_force_is_the_slope_of_the_stored_energy() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let mut random = Random::new(7);
    for _ in 0..6 {
        let centre = Vector3::new(0.0, 0.0, RADIUS - 0.006) + random.vector() * 0.003;
        let mut solve = |centre: Vector3<f64>| {
            let (_, report) =
                bench.afresh(at(0.0, 0.0, 0.05), pose(centre, UnitQuaternion::identity()));
            let energy = report.stored_energy_j;
            (force(&contact(&report)), energy)
        };
        let (found, energy) = solve(centre);
        assert!(energy > 0.0);
        let h = 1e-6;
        let slope = Vector3::from_fn(|axis, _| {
            let mut step = Vector3::zeros();
            step[axis] = h;
            (solve(centre + step).1 - solve(centre - step).1) / (2.0 * h)
        });
        let error = (found + slope).norm() / found.norm();
        assert!(
            error < 1e-6,
            "force {found} against -dE/dc {slope}: {error:e}"
        );
    }
}

#[test]
fn apart_the_gap_and_the_coming_stiffness_are_known() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let mut state = State::new(&bench.model);
    let report = bench.step(&mut state, at(0.0, 0.0, RADIUS + 0.003));
    let before = contact(&report);
    assert_eq!((before.rows, before.wrench), (0, [0.0; 6]));
    assert!(
        (before.gap_m - 0.003).abs() < 1e-12,
        "the vertex below is {} m away",
        before.gap_m
    );
    assert!((before.normal[2] - 1.0).abs() < 1e-12);
    // Just after touching, with the one vertex below in contact.
    let report = bench.step(&mut state, at(0.0, 0.0, RADIUS - 1e-6));
    let after = contact(&report);
    assert_eq!(after.rows, 1);
    assert!((before.tangent[2][2] / after.tangent[2][2] - 1.0).abs() < 1e-4);
    let far = contact(&bench.step(&mut state, at(0.0, 0.0, 10.0)));
    assert!((far.gap_m - 10.0 + RADIUS).abs() < 1e-9 && far.wrench == [0.0; 6]);
    assert_eq!(state.contact_forces(&bench.model).count(), 0);
}

#[test]
fn loads_and_handles_stay_while_a_tool_presses() {
    let (mesh, bottom) = slab_mesh();
    let top = |x: u32, y: u32| 17 * 17 * 6 + 17 * y + x;
    let anchor = Anchor {
        vertices: vec![top(11, 8), top(12, 8)],
        weights: vec![0.3, 0.7],
    };
    let target = [0.0, 0.0, 3e-3];
    let loads = Loads {
        forces: vec![NodeLoad {
            node: top(3, 8),
            force_n: [0.0, 0.0, 0.1],
        }],
        handles: vec![Handle {
            anchor: anchor.clone(),
            target_displacement_m: target,
        }],
        ..Loads::default()
    };
    let tool = ball([0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, loads, &[(0, tool)]);
    let sample = at(0.0, 0.0, RADIUS - 0.005);
    let (state, report) = bench.afresh(at(0.0, 0.0, 0.05), sample);
    bench.assert_balanced(&state, &[sample]);
    let solution = bench.model.equilibrium(&state).expect("a balance");
    for (axis, target) in target.into_iter().enumerate() {
        let nodes = anchor.vertices.iter().zip(&anchor.weights);
        let held: f64 = nodes
            .map(|(&node, weight)| weight * solution.displacement_m[node as usize][axis])
            .sum();
        assert!((held - target).abs() < 1e-12);
    }
    assert!(solution.residual < 1e-10);
    let mut plain = Bench::slab(ball([0.0; 3]));
    let (_, plain) = plain.afresh(at(0.0, 0.0, 0.05), sample);
    assert!((force(&contact(&plain)) - force(&contact(&report))).norm() > 1e-2);
}

/// Deeper than a radius the tissue slips up around a sphere (`deep.rs`); a punch has no such end.
/// Exactly above a mesh's plane of symmetry the slip is a bifurcation that nothing decides, and the status
/// says so: here the tool is off it.
#[test]
fn a_punch_presses_deeper_than_its_radius() {
    let punch = Tool::new(Shape::flat_punch(RADIUS, 0.04), [0.0, 0.0, -RADIUS]);
    let mut bench = Bench::slab(punch);
    let mut state = State::new(&bench.model);
    bench.step(&mut state, at(0.0013, 0.0007, 0.05));
    let mut forces = Vec::new();
    for tenths in (0..=160).step_by(2) {
        let sample = at(0.0013, 0.0007, RADIUS - 1e-4 * f64::from(tenths));
        let report = bench.step(&mut state, sample);
        forces.push(force(&contact(&report)).z);
        if tenths % 40 == 0 {
            bench.assert_balanced(&state, &[sample]);
        }
    }
    let most = forces.iter().copied().fold(0.0, f64::max);
    let last = forces[forces.len() - 1];
    assert!(last > 0.99 * most, "{last} N after {most} N");
}
