//! What a look costs: `cargo test --release -p sutura-host --test all rims -- --ignored --nocapture`.

use super::rig::{Blocks, Rig, SOFT, moved};
use nalgebra::{Isometry3, Vector3};
use std::time::Instant;
use sutura_host::collide::{TouchSettings, TouchState, TouchWork};
use sutura_host::mesh::tube;

/// Two tubes of 1,674 nodes together, rim over rim, slightly tilted, turned and off centre.
fn tubes(guard: f64) -> (Rig, Vec<u32>) {
    let upper = tube([0.008, 0.011], [0.0, 0.03], [2, 30, 8]).expect("a tube");
    let lower = tube([0.0078, 0.0112], [-0.03, 0.0], [2, 32, 8]).expect("a tube");
    let above = Isometry3::new(
        Vector3::new(0.0004, 0.0003, 0.0006),
        Vector3::new(0.01, 0.0, 0.05),
    );
    let blocks = Blocks::of([(upper, above), (lower, Isometry3::identity())].into_iter());
    let top = blocks.nodes(0, |at| at[2] > 0.03);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0299);
    fixed.extend(&top);
    let settings = TouchSettings {
        guard,
        ..TouchSettings::default()
    };
    (Rig::with(blocks, &fixed, 0.0, SOFT, settings), top)
}

const REPEATS: usize = 7;

#[test]
#[ignore = "times"]
fn rims() {
    for guard in [0.3, 0.15, 0.1] {
        closing(guard);
    }
}

fn closing(guard: f64) {
    let (mut rig, top) = tubes(guard);
    let rest = rig.at.clone();
    let points = rig.blocks.mesh.points_m().to_vec();
    println!(
        "{} nodes, edge {:e}",
        points.len(),
        rig.touching.mean_edge_m()
    );
    let mut steps = Vec::new();
    for step in 0..200 {
        let t = f64::from(step) / 200.0;
        let by = [0.001 * (9.0 * t).sin(), 0.0, -0.003 * t];
        let report = rig.step(&moved(&top, by));
        steps.push((
            report.seen,
            report.lambda,
            rig.state.pairs(),
            rig.state.pressing(),
        ));
    }
    let mut anchors = Vec::with_capacity(rig.touching.most_pairs());
    let mut rows = Vec::with_capacity(rig.touching.most_rows());
    // The least of a few runs: others use the processor, too.
    let mut times = vec![(u128::MAX, u128::MAX); steps.len()];
    for _ in 0..REPEATS {
        let mut state = TouchState::new(&rig.touching, &rest);
        let mut work = TouchWork::new(&rig.touching, rest.len());
        for ((seen, lambda, _, _), times) in steps.iter().zip(&mut times) {
            let (mut look, mut other) = (0, 0);
            for at in seen {
                anchors.clear();
                rows.clear();
                let start = Instant::now();
                state.rows(&rig.touching, &points, &mut anchors, &mut rows);
                other += start.elapsed().as_nanos();
                let start = Instant::now();
                state.look(&rig.touching, &mut work, at);
                look += start.elapsed().as_nanos();
            }
            let start = Instant::now();
            let last = seen.last().expect("a solve");
            state.accept(&rig.touching, &mut work, last, lambda);
            other += start.elapsed().as_nanos();
            times.0 = times.0.min(look / seen.len() as u128);
            times.1 = times.1.min(look + other);
        }
        assert!(state == rig.state);
    }
    let mut looks: Vec<u128> = times[50..].iter().map(|t| t.0).collect();
    let mut all: Vec<u128> = times[50..].iter().map(|t| t.1).collect();
    looks.sort_unstable();
    all.sort_unstable();
    let us = |times: &[u128], share: usize| times[share * times.len() / 100] / 1000;
    let last = steps.last().expect("steps");
    println!(
        "guard {guard}: pairs {} pressing {}, looks {}; a look {} us p50, all of a step {} p50 {} p90 {} p95 {} p99",
        last.2,
        last.3,
        steps.iter().map(|step| step.0.len()).sum::<usize>(),
        us(&looks, 50),
        us(&all, 50),
        us(&all, 90),
        us(&all, 95),
        us(&all, 99)
    );
}
