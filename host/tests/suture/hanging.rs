//! A thread that was drawn through two slabs and hangs where nothing pulls it.

use super::rig::*;
use nalgebra::Vector3;
use sutura_host::thread::{ChainSettings, ChainStatus, FreeThread, ThreadPlace};

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

/// Its nodes pass the punctures, keep their distances, stay outside where it is outside, and come to rest below what they
/// hang on; a thread that is not there has no shape.
#[test]
fn a_loose_thread_hangs_from_its_last_puncture_outside_the_tissue() {
    let mut bench = bench(SETUP);
    go(&mut bench, Vector3::new(0.0, 0.0, -0.072));
    let settings = |length_m| ChainSettings {
        nodes: 151,
        bending_n_m2: 1e-8,
        drag_per_s: 20.0,
        ..ChainSettings::of_length(length_m)
    };
    assert!(FreeThread::new(&bench.model, &bench.state, 3, settings).is_none());
    let free = FreeThread::new(&bench.model, &bench.state, 7, settings);
    let mut free = free.expect("a thread");
    let mut report = None;
    for _ in 0..300 {
        report = Some(free.step(0.01, &bench.model, &bench.state));
    }
    let report = report.expect("a step");
    assert_eq!(report.status, ChainStatus::Ok);
    assert!(
        report.length_error < 1e-4 && report.touching > 0,
        "{report:?}"
    );

    let (length_m, segment) = (0.3, 0.3 / 150.0);
    let nodes: Vec<Vector3<f64>> = free.nodes_m().map(Vector3::from).collect();
    let path = bench.path(7);
    let punctures: Vec<_> = path
        .iter()
        .filter(|point| matches!(point.what, ThreadPlace::Enters | ThreadPlace::Leaves))
        .collect();
    assert_eq!(punctures.len(), 4);
    for point in &punctures {
        let place = Vector3::from(point.at_m);
        let near = nodes.iter().map(|at| at.metric_distance(&place));
        assert!(near.fold(f64::MAX, f64::min) < 0.6 * segment);
    }
    // From the tail to the first puncture it lies outside.
    let surface = bench.model.surface();
    let places = bench.state.positions(&bench.model);
    let outside = (length_m + punctures[0].along_m) / segment;
    let loose = &nodes[..outside as usize - 1];
    assert!(loose.len() > 50);
    for (index, node) in loose.iter().enumerate() {
        assert!(
            !surface.contains(&places, (*node).into()),
            "node {index} at {node:?}"
        );
    }
    // It was straight up, and has fallen.
    let first = Vector3::from(punctures[0].at_m);
    assert!(loose[0].z < first.z + 0.01, "{:?}", loose[0]);
}
