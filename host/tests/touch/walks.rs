//! Random ways: whatever is pressed, turned, slid over a rim and pulled off, nothing gets inside.

use super::rig::{Blocks, Rig};
use nalgebra::{Isometry3, Point3, Vector3};
use sutura_host::collide::penetration_m;
use sutura_testkit::Random;

/// What a walk came to.
#[derive(Debug)]
pub struct Walk {
    pub deepest: f64,
    pub most_n: f64,
    pub most_solves: usize,
    pub solves: usize,
    pub steps: usize,
    pub most_pairs: usize,
}

/// A block over the rim of another goes to random places in steps of up to `step` edges.
fn walk(seed: u64, step: f64, places: usize, friction: f64) -> Walk {
    let mut random = Random::new(seed);
    let mut vector = |size: [f64; 3]| Vector3::from(size).component_mul(&random.vector());
    let above = Isometry3::new(
        Vector3::new(0.018, 0.002, 0.0218),
        vector([0.03, 0.03, 0.8]),
    );
    let blocks = Blocks::new(&[
        ([0.03, 0.03, 0.02], [5, 5, 4], above),
        ([0.05, 0.05, 0.02], [8, 8, 4], Isometry3::identity()),
    ]);
    let count = blocks.first[1];
    let top: Vec<u32> = (count - 36..count).collect();
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0199);
    fixed.extend(&top);
    let mut rig = Rig::new(blocks, &fixed, friction);
    let faces = rig.faces();
    let edge = rig.touching.mean_edge_m();
    let rest = rig.at.clone();
    let middle = top
        .iter()
        .map(|node| rest[*node as usize])
        .sum::<Vector3<f64>>()
        / top.len() as f64;
    let mut found = Walk {
        deepest: 0.0,
        most_n: 0.0,
        most_solves: 0,
        solves: 0,
        steps: 0,
        most_pairs: 0,
    };
    let (mut from, mut turned) = (Vector3::zeros(), Vector3::zeros());
    for _ in 0..places {
        let to = vector([0.012, 0.012, 0.0025]) - Vector3::new(0.0, 0.0, 0.002);
        let turn = vector([0.05, 0.05, 0.2]);
        let count = ((to - from).norm() / (step * edge)).ceil().max(1.0);
        for number in 1..=count as u32 {
            let along = f64::from(number) / count;
            let place = Isometry3::new(
                middle + from * (1.0 - along) + to * along,
                turned * (1.0 - along) + turn * along,
            );
            let way = top.iter().map(|node| {
                let own = rest[*node as usize];
                (
                    *node,
                    (place * Point3::from(own - middle) - Point3::from(own)).into(),
                )
            });
            let report = rig.step(&way.collect::<Vec<_>>());
            let depth = penetration_m([&faces[0], &faces[1]], &rig.at);
            found.deepest = found.deepest.max(depth / edge);
            found.most_n = found
                .most_n
                .max(report.force_on(0..rig.blocks.first[1]).norm());
            found.most_solves = found.most_solves.max(report.solves);
            found.solves += report.solves;
            found.steps += 1;
            found.most_pairs = found.most_pairs.max(rig.state.pairs());
        }
        (from, turned) = (to, turn);
    }
    found
}

#[test]
fn nothing_gets_inside_on_random_ways() {
    // In steps of a third of an edge directions turn within a step: without looking again 0.01 edges get lost.
    let ways = [
        (0, 0.05, 0.0),
        (1, 0.05, 0.0),
        (7, 0.05, 0.3),
        (29, 0.3, 0.0),
        (51, 0.3, 0.0),
    ];
    let mut most_n = 0.0f64;
    for (seed, step, friction) in ways {
        let found = walk(seed, step, 5, friction);
        assert!(found.deepest <= 1e-3, "{seed}: {found:?}");
        most_n = most_n.max(found.most_n);
    }
    // Some of them press.
    assert!(most_n > 0.1, "{most_n} N");
}

/// `cargo test --release -p sutura-host --test all many_random_ways -- --ignored --nocapture`
#[test]
#[ignore = "minutes"]
fn many_random_ways() {
    let (mut worst, mut bad) = (0.0f64, 0);
    for seed in 0..60 {
        for step in [0.02, 0.1, 0.3] {
            let found = walk(seed, step, 5, 0.0);
            worst = worst.max(found.deepest);
            if found.deepest > 1e-3 || found.most_solves > 6 {
                bad += 1;
                println!("{seed} {step}: {found:?}");
            }
        }
    }
    println!("deepest {worst:e} edges, {bad} above");
}
