//! A thread that was drawn through two slabs and hangs where nothing pulls it.

use super::rig::*;
use nalgebra::Vector3;
use sutura_host::thread::{FreeThreads, ThreadPlace, ThreadPoint, ThreadTension};

/// Between the faces that it was drawn through straight there is as much of it as they are apart.
#[test]
fn a_thread_that_follows_its_needle_counts_its_length() {
    let mut bench = bench(SETUP);
    go(&mut bench, Vector3::new(0.0, 0.0, -0.072));
    let path = bench.path(7);
    assert!(path.len() > 10);
    for two in path.windows(2) {
        let [from, to] = [two[0], two[1]].map(|point| Vector3::from(point.at_m));
        let (apart, length) = (from.metric_distance(&to), two[1].along_m - two[0].along_m);
        assert!((apart - length).abs() < 1e-9, "{length} m for {apart} m");
    }
}

/// Where it hangs it begins and ends at the points that hold it, is as long as there is thread, stays outside, and comes to rest
/// below what it hangs on; a thread that is not there has no shape.
#[test]
fn a_loose_thread_hangs_from_its_last_puncture_outside_the_tissue() {
    let mut bench = bench(SETUP);
    go(&mut bench, Vector3::new(0.0, 0.0, -0.072));
    let nodes_m = bench.state.positions(&bench.model);
    let free = FreeThreads::new(&bench.model, [0.0, 0.0, -9.81]);
    let mut free = free.expect("a thread");
    for _ in 0..120 {
        let report = free.step(0.1, &bench.model, &bench.state, &nodes_m);
        assert!(report.length_error < 1e-9, "{report:?}");
    }
    assert!(free.path(3).is_empty());
    let path = free.path(7);
    let is_shape = |point: &&ThreadPoint| point.what == ThreadPlace::Hangs;
    let held: Vec<_> = path.iter().filter(|point| !is_shape(point)).collect();
    let fixed = bench.path(7);
    // What holds it is where it was, behind the loose end.
    assert_eq!(held[0].what, ThreadPlace::End);
    assert!(held[1..].iter().zip(&fixed).all(|(a, b)| *a == b));
    assert_eq!(held.len(), fixed.len() + 1);

    let first = path
        .iter()
        .position(|point| point.what == ThreadPlace::Enters);
    let first = first.expect("a puncture");
    let at = |point: &ThreadPoint| Vector3::from(point.at_m);
    let tail = &path[..=first];
    let pieces = tail
        .windows(2)
        .map(|two| at(&two[0]).metric_distance(&at(&two[1])));
    let (length_m, there_is) = (pieces.sum::<f64>(), path[first].along_m + SETUP.length_m);
    assert!(
        (length_m / there_is - 1.0).abs() < 1e-9,
        "{length_m} m of {there_is} m"
    );
    assert!(tail.len() > 50);
    let surface = bench.model.surface();
    let hanging: Vec<_> = path.iter().filter(is_shape).collect();
    assert!(
        hanging
            .iter()
            .all(|point| !surface.contains(&nodes_m, point.at_m))
    );
    // It was straight up at first, and has fallen.
    assert!(path[0].at_m[2] < path[first].at_m[2] - 0.1, "{:?}", path[0]);
}

/// What a hand lets go of between tail and hand hangs from the hand; none of it is where the thread is taut.
#[test]
fn what_is_beyond_a_hand_hangs_from_it() {
    let mut bench = drawn(bench(SETUP));
    let mut free = FreeThreads::new(&bench.model, [0.0, 0.0, -9.81]).expect("a thread");
    let mut spans = Vec::new();
    for way in [Vector3::zeros(), Vector3::new(0.0, 0.0, 0.004)] {
        // Away from the tissue, the hand pulls.
        bench.other.translation.vector += way;
        let report = go(&mut bench, Vector3::new(0.0, 0.0, -2e-4));
        let nodes_m = bench.state.positions(&bench.model);
        let step = free.step(0.1, &bench.model, &bench.state, &nodes_m);
        assert!(step.length_error < 1e-9, "{step:?}");
        let path = free.path(7);
        let hand = path
            .iter()
            .rposition(|point| Vector3::from(point.at_m) == bench.other.translation.vector);
        let hand = hand.expect("the hand is a point of it");
        assert!(
            path[1..hand]
                .iter()
                .all(|point| point.what == ThreadPlace::Hangs)
        );
        let enters = path
            .iter()
            .position(|point| point.what == ThreadPlace::Enters);
        spans.push((
            report.threads()[0].state,
            enters.expect("a puncture") - hand,
        ));
    }
    assert_eq!(spans[1], (ThreadTension::Taut, 1));
}
