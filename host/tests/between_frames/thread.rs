//! A running suture through two slabs whose ends are pulled, let go and pulled again.

use super::bench::*;
use nalgebra::Vector3;

/// When the ends are first pulled \[ticks\].
const SEWN: u64 = 6620;

/// As the scene's hand, and on, with 3 mm to and fro at 1 Hz once the slack is out.
fn pulls(time_s: f64) -> Vector3<f64> {
    let since_s = (time_s - 1e-3 * SEWN as f64).max(0.0);
    let along = Vector3::new(0.0132, 0.0, 0.0176);
    let shake = 0.0015 * (1.0 - (std::f64::consts::TAU * since_s).cos());
    Vector3::new(0.0079756, 0.0094, 0.0013755) + along * (since_s / 3.0) - along.normalize() * shake
}

#[test]
#[ignore = "a table"]
fn figures() {
    let scene = scene("wound-slabs.toml", "", "");
    table(&scene, &[("thread", &pulls, SEWN, SEWN + 3000)]);
}
