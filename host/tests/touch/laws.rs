//! What contact must do whatever presses: pass pressure on, stick and slip, start where it is told to, let out what is
//! inside.

use super::rig::{Blocks, Rig, moved};
use nalgebra::{Isometry3, Vector3};
use sutura_host::collide::{TouchSettings, TouchState, TouchWork, penetration_m};
use sutura_host::fem::Material;

/// A column of two blocks whose interface does not match, `above` over each other; top and bottom are fixed.
fn column(above: f64, friction: f64, material: Material) -> (Rig, Vec<u32>) {
    let blocks = Blocks::new(&[
        (
            [0.03, 0.03, 0.02],
            [5, 5, 4],
            Isometry3::translation(0.0, 0.0, 0.02 + above),
        ),
        ([0.03, 0.03, 0.02], [7, 7, 4], Isometry3::identity()),
    ]);
    let top = blocks.nodes(0, |at| at[2] > 0.0199 + above);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0199);
    fixed.extend(&top);
    (
        Rig::with(blocks, &fixed, friction, material, TouchSettings::default()),
        top,
    )
}

/// Patch test: without Poisson's effect a column is pressed evenly, interface or not. Pressure goes over at nodes, and which of
/// the two sides' nodes share it is not said: 8 % in the cells at the interface, 2 % a layer away, 0.04 % of the whole.
#[test]
fn pressure_goes_through_an_interface_that_does_not_match() {
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.0,
    };
    let (mut rig, top) = column(0.0005, 0.0, material);
    let depth = 0.002;
    let mut report = Default::default();
    for step in 1..=10 {
        report = rig.step(&moved(&top, [0.0, 0.0, -depth * f64::from(step) / 10.0]));
    }
    let closed = depth - 0.0005 + rig.touching.separation_m();
    let strain = closed / 0.04;
    let even = 15e3 * strain;
    let push = report.force_on(0..rig.blocks.first[1]);
    assert!((push.z / (even * 9e-4) - 1.0).abs() < 0.002, "{push}");
    assert!(push.xy().norm() < 1e-3 * push.z, "{push}");
    let mesh = &rig.blocks.mesh;
    let displaced: Vec<[f64; 3]> = rig
        .at
        .iter()
        .zip(mesh.points_m())
        .map(|(at, from)| (at - Vector3::from(*from)).into())
        .collect();
    let stress = rig.tissue.stress(&displaced);
    let mut worst = [0.0f64; 2];
    for (cell, stress) in mesh.cells().iter().zip(stress) {
        let height = cell
            .iter()
            .map(|node| mesh.points_m()[*node as usize][2])
            .sum::<f64>()
            / 4.0;
        let far = usize::from((height - 0.00025).abs() > 0.005);
        worst[far] = worst[far].max((stress[2][2] / -even - 1.0).abs());
    }
    assert!(worst[1] < 0.03 && worst[0] < 0.12, "{worst:?}");
}

#[test]
fn friction_sticks_and_then_slips_at_its_limit() {
    let soft = super::rig::SOFT;
    for (friction, way) in [(0.2, [1.0, 0.0]), (0.6, [-0.6, 0.8])] {
        let (mut rig, top) = column(0.0005, friction, soft);
        let along = Vector3::new(way[0], way[1], 0.0);
        let own = 0..rig.blocks.first[1];
        for step in 1..=5 {
            rig.step(&moved(&top, [0.0, 0.0, -4e-4 * f64::from(step)]));
        }
        let mut shares = Vec::new();
        // Aside, and back by a little.
        for step in (1..=30).chain((20..30).rev()) {
            let aside = 2e-4 * f64::from(step);
            let report = rig.step(&moved(&top, [aside * way[0], aside * way[1], -0.002]));
            let (mut limit, mut force) = (0.0, Vector3::zeros());
            for (rows, lambda) in report.rows.chunks(3).zip(report.lambda.chunks(3)) {
                let across = lambda[1].hypot(lambda[2]);
                assert!(
                    across <= friction * lambda[0] * (1.0 + 1e-9),
                    "{across} {}",
                    lambda[0]
                );
                limit += friction * lambda[0];
                // On the upper block, whose points are the second ones if their face is met.
                let first = report.anchors[rows[0].anchor as usize].nodes[0];
                let weight = report.anchors[rows[0].anchor as usize].weights[0];
                let side = if own.contains(&first) {
                    weight.signum()
                } else {
                    -weight.signum()
                };
                for axis in 1..3 {
                    force -= Vector3::from(rows[axis].direction) * (lambda[axis] * side);
                }
            }
            shares.push(-force.dot(&along) / limit);
        }
        // In the beginning it sticks: the force grows with the way; far slid every pair slips against it.
        let growth = (shares[2] - shares[1]) / (shares[1] - shares[0]);
        assert!((growth - 1.0).abs() < 0.02, "{shares:?}");
        // On the way back it sticks again where it is, and is pushed the other way in the end.
        let back = (shares[29] - shares[30]) / (shares[1] - shares[0]);
        assert!((back - 1.0).abs() < 0.2, "{shares:?}");
        assert!(shares[39] < 0.0 || friction > 0.5, "{shares:?}");
        assert!(shares[0] < 0.2 && shares[29] > 0.995, "{shares:?}");
    }
}

/// Faces that lie on each other, or overlap by less than bodies are held apart. What overlaps by more is let out, and not
/// in again.
#[test]
fn bodies_may_start_in_contact() {
    let soft = super::rig::SOFT;
    for above in [0.0, 1e-5, -1e-5, -4e-4] {
        let (mut rig, top) = column(above, 0.0, soft);
        let faces = rig.faces();
        let own = 0..rig.blocks.first[1];
        let start = penetration_m([&faces[0], &faces[1]], &rig.at);
        assert!((start - (-above).max(0.0)).abs() < 1e-12);
        // Nothing happens before something moves.
        let still = rig.step(&[]);
        assert_eq!(still.force_on(own.clone()).norm(), 0.0);
        assert_eq!(
            rig.at,
            rig.blocks
                .mesh
                .points_m()
                .iter()
                .map(|at| Vector3::from(*at))
                .collect::<Vec<_>>()
        );
        let mut before = 0.0;
        // What overlaps by more than half a separation is not held before it has come out.
        let presses = if above > -1e-4 { 10 } else { 0 };
        for step in 1..=presses {
            let down = 5e-5 * f64::from(step);
            let report = rig.step(&moved(&top, [0.0, 0.0, -down]));
            let push = report.force_on(own.clone()).z;
            let depth = penetration_m([&faces[0], &faces[1]], &rig.at);
            assert!(push > before, "{above} {step}: {push}");
            assert!(depth < start + 1e-3 * rig.touching.mean_edge_m(), "{depth}");
            before = push;
        }
        // Out, and in again: now they are kept apart like all others.
        for down in [-0.0005, -0.001, -0.0005, 0.0, 0.0005] {
            rig.step(&moved(&top, [0.0, 0.0, -down]));
        }
        let depth = penetration_m([&faces[0], &faces[1]], &rig.at);
        assert!(
            depth < 1e-3 * rig.touching.mean_edge_m(),
            "{above}: {depth}"
        );
    }
}

/// Deep inside one cannot say which face it came through: what is there may go anywhere, and is not held from within.
#[test]
fn what_is_deep_inside_is_not_held_there() {
    let blocks = Blocks::new(&[
        (
            [0.02, 0.02, 0.02],
            [4, 4, 4],
            Isometry3::translation(0.0003, 0.0007, 0.0175),
        ),
        ([0.03, 0.03, 0.02], [7, 7, 4], Isometry3::identity()),
    ]);
    let low = blocks.nodes(0, |at| at[2] < 0.0);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0199);
    fixed.extend(blocks.nodes(0, |at| at[2] > 0.017));
    let rig = Rig::new(blocks, &fixed, 0.0);
    let shifted = |by: [f64; 3]| -> Vec<Vector3<f64>> {
        let mut at = rig.at.clone();
        for at in &mut at[..rig.blocks.first[1] as usize] {
            *at += Vector3::from(by);
        }
        at
    };
    // Out at the top, the bottom and a side; deeper.
    let ways = [
        [0.0, 0.0, 0.006],
        [0.0, 0.0, -0.021],
        [0.012, 0.0, 0.0],
        [0.0, 0.0, -0.002],
    ];
    for by in ways {
        let mut state = TouchState::new(&rig.touching, &rig.at);
        let mut work = TouchWork::new(&rig.touching, rig.at.len());
        while state.look(&rig.touching, &mut work, &shifted(by)) {}
        let (mut anchors, mut rows) = (Vec::new(), Vec::new());
        state.rows(
            &rig.touching,
            rig.blocks.mesh.points_m(),
            &mut anchors,
            &mut rows,
        );
        for anchor in &anchors {
            // An edge that goes through a face may go over from one to the next on the way.
            let edges = anchor.weights[0] != 1.0;
            let deep = |node: &u32| low.contains(node);
            assert!(
                edges || !anchor.nodes.iter().any(deep),
                "{by:?}: {anchor:?}"
            );
        }
    }
}
