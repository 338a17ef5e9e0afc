//! Pressed and let go of.

use super::rig::{Blocks, Rig, moved};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_4;
use sutura_host::collide::penetration_m;
use sutura_host::mesh::{RawMesh, slab};

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

/// A corner over a valley of this slope on both sides, `aside` of its bottom \[m\], that is pressed down and then held: what it still moves in
/// a step \[m\], and by how much it got inside at most, in mean edges.
fn corner_in_a_valley(slope: f64, aside: f64) -> (f64, f64) {
    let tip = [aside, 4e-4, slope * aside.abs() + 3e-4];
    let base = [
        [3e-3, 4e-4, 8e-3],
        [-1.5e-3, 3e-3, 8e-3],
        [-1.5e-3, -2.2e-3, 8e-3],
    ];
    let points = std::iter::once(tip).chain(base).collect();
    let corner = RawMesh::new(points, vec![[0, 1, 2, 3]], Vec::new());
    let flat = slab([0.02, 0.02, 0.01], [4, 4, 2]).expect("a slab");
    let bent = flat.points_m().iter();
    let bent = bent.map(|[x, y, z]| [*x, *y, z + slope * x.abs()]);
    let valley = RawMesh::new(bent.collect(), flat.cells().to_vec(), Vec::new());
    let bodies = [corner, valley].map(|body| body.check().expect("a mesh"));
    let blocks = Blocks::of(bodies.into_iter().map(|body| (body, Isometry3::identity())));
    let top = blocks.nodes(0, |at| at[2] > 0.007);
    let mut fixed = blocks.nodes(1, |at| at[2] < slope * at[0].abs() - 0.0099);
    fixed.extend(&top);
    let mut rig = Rig::new(blocks, &fixed, 0.0);
    let [one, other] = rig.faces();
    let (mut at, mut way_m, mut inside) = (rig.at[0], 0.0, 0.0f64);
    for step in 0..40 {
        let depth = 1e-4 * f64::from(step.min(15));
        rig.step(&moved(&top, [0.0, 0.0, -depth]));
        (at, way_m) = (rig.at[0], (rig.at[0] - at).norm());
        let deep_m = penetration_m([&one, &other], &rig.at);
        inside = inside.max(deep_m / rig.touching.mean_edge_m());
    }
    assert!(rig.state.pressing() > 0, "{slope} {aside}: {at}");
    (way_m, inside)
}

/// A corner that is pressed into a valley comes to rest, held by both sides where it has slid down to the bottom, and gets inside neither.
/// Held by one of them at a time it goes to and fro between the two, by up to 2.7 mm a step.
#[test]
fn a_corner_comes_to_rest_in_a_valley() {
    for slope in [0.0, 0.02, 0.05, 0.1, 0.3, 0.6] {
        for aside in [-3e-4, -1.5e-4, 0.0, 1.5e-4, 3e-4, 6e-4] {
            let (way_m, inside) = corner_in_a_valley(slope, aside);
            println!("{slope} {aside}: {way_m} m, {inside} edges inside");
            assert!(way_m < 1e-9, "{slope} {aside}: still moves by {way_m} m");
            assert!(inside < 1e-3, "{slope} {aside}: {inside} edges inside");
        }
    }
}
