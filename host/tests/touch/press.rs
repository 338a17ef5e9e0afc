//! Pressed and let go of.

use super::rig::{Blocks, Rig, moved};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_4;

/// A small block over a large one, 0.5 mm above; its top and the other's bottom are fixed.
fn block_on_block(friction: f64) -> (Rig, Vec<u32>) {
    let above = Isometry3::translation(0.0021, 0.0013, 0.0205);
    let blocks = Blocks::new(&[
        ([0.03, 0.03, 0.02], [5, 5, 3], above),
        ([0.06, 0.06, 0.03], [8, 8, 4], Isometry3::identity()),
    ]);
    let top = blocks.nodes(0, |at| at[2] > 0.0204);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0299);
    fixed.extend(&top);
    (Rig::new(blocks, &fixed, friction), top)
}

#[test]
fn what_presses_is_pressed_back_and_let_go_of() {
    let (mut rig, top) = block_on_block(0.0);
    let halves = [
        rig.blocks.first[0]..rig.blocks.first[1],
        rig.blocks.first[1]..rig.blocks.first[2],
    ];
    let mut most = 0.0f64;
    for step in 0..=30 {
        // Down by 1.5 mm, up again by more.
        let depth = if step <= 15 {
            1e-4 * f64::from(step)
        } else {
            1e-4 * f64::from(33 - 2 * (step - 7))
        };
        let report = rig.step(&moved(&top, [0.0, 0.0, -depth]));
        let [up, down] = halves.clone().map(|half| report.force_on(half));
        assert!(
            (up + down).norm() <= 1e-12 * up.norm(),
            "{step}: {up} {down}"
        );
        let pressed = depth > 0.0005 - rig.touching.separation_m();
        assert_eq!(up.z > 0.0, pressed, "{step} {depth}: {up}");
        assert_eq!(rig.state.pressing() > 0, pressed);
        assert!(report.lambda.iter().all(|lambda| *lambda >= 0.0));
        most = most.max(up.z);
    }
    assert!(most > 0.1, "{most}");
    assert_eq!(rig.state.pairs(), 0);
    assert!(rig.state.is_clear(1e-5));
}

/// Nodes over nodes: each has one row, though it meets up to six faces and as many edges, and its opposite does.
#[test]
fn what_says_the_same_is_said_once() {
    let above = Isometry3::translation(0.0, 0.0, 0.0205);
    let blocks = Blocks::new(&[
        ([0.03, 0.03, 0.02], [5, 5, 3], above),
        ([0.054, 0.054, 0.03], [9, 9, 4], Isometry3::identity()),
    ]);
    let top = blocks.nodes(0, |at| at[2] > 0.0204);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0299);
    fixed.extend(&top);
    let mut rig = Rig::new(blocks, &fixed, 0.0);
    for step in 1..=4 {
        rig.step(&moved(&top, [0.0, 0.0, -2e-4 * f64::from(step)]));
    }
    assert!(rig.state.pressing() >= 30, "{}", rig.state.pressing());
    assert_eq!(rig.state.pairs(), 36);
}

/// Two ridges across each other: one pair of edges.
#[test]
fn ridges_across_each_other_press_at_one_point() {
    let turned = |axis: Vector3<f64>, z: f64| {
        let turn = UnitQuaternion::from_scaled_axis(axis * FRAC_PI_4);
        // About the middle of the block.
        let middle = Translation3::new(0.0, 0.0, 0.01);
        let to = Translation3::new(0.0007, 0.0004, z);
        to * turn * middle
    };
    // Half a diagonal is 14.14 mm.
    let blocks = Blocks::new(&[
        ([0.05, 0.02, 0.02], [5, 2, 2], turned(Vector3::x(), 0.0145)),
        ([0.02, 0.05, 0.02], [2, 5, 2], turned(Vector3::y(), -0.0145)),
    ]);
    let top = blocks.nodes(0, |at| at[2] > 0.02);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.02);
    fixed.extend(&top);
    let mut rig = Rig::new(blocks, &fixed, 0.0);
    for step in 0..=20 {
        let depth = 1e-4 * f64::from(step);
        let report = rig.step(&moved(&top, [0.0, 0.0, -depth]));
        let up = report.force_on(0..rig.blocks.first[1]);
        let apart = 2.0 * (0.0145 - 0.01 * 2f64.sqrt());
        assert_eq!(
            up.z > 0.0,
            depth > apart - rig.touching.separation_m(),
            "{step}"
        );
        if up.z > 0.0 {
            assert!(up.xy().norm() < 0.2 * up.z, "{up}");
            assert_eq!(rig.state.pressing(), 1);
        }
    }
}
