//! What a tool feels as it comes down on tissue.

use crate::grip::{Scene, errors, feel, linear};

/// Comes down at 0.5 m/s on 900 N/m, from 15 mm above it to 5 mm deep, at every phase of hosts of every rate: the force sets in with the
/// tissue, and not when the next frame says so.
#[test]
fn a_force_sets_in_with_the_touch_however_quick_the_host_is() {
    let peak = |host_hz: f64| {
        let phases = (0..64).map(|phase| f64::from(phase) / 64.0);
        phases.fold(0.0, |most, phase| {
            let path = |t: f64| 15e-3 - 0.5 * f64::max(t - 0.3 - 1e-3 * (7.0 * phase).fract(), 0.0);
            let scene = Scene {
                path: &path,
                law: &linear(900.0),
                host_hz,
                delay_s: 1.0 / host_hz,
                phase,
                horizon_us: (4e6 / host_hz) as u32,
                seconds: 0.341,
                ..Scene::BASE
            };
            let ticks = feel(&scene);
            f64::max(most, errors(&ticks[320..340]).1)
        })
    };
    for host_hz in [60.0, 100.0, 144.0, 250.0, 500.0, 1000.0] {
        let peak = peak(host_hz);
        assert!(peak < 0.02, "{host_hz} Hz: {peak}");
    }
}
