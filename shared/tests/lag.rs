//! Motors that lag behind their description.

use crate::grip::{Hand, Scene, Tick, feel, given_back, linear, ramp};

/// A mass of 60 g one with the grip, pushed by 1 N, that falls into a thread or onto tissue.
fn falls(stiffness: f64, lag_s: f64, torque: f64, is_thread: bool, host_hz: f64) -> Vec<Tick> {
    feel(&Scene {
        path: &|_| 3e-3,
        hand: Hand::Mass(0.06, -1.0),
        law: &linear(stiffness),
        is_thread,
        lag_s,
        torque,
        host_hz,
        delay_s: 1.0 / host_hz,
        horizon_us: (4e6 / host_hz) as u32,
        seconds: 4.0,
        ..Scene::BASE
    })
}

#[test]
fn a_mass_that_bounces_is_not_driven_by_a_lag() {
    for lag_s in [0.0, 0.5e-3, 1e-3] {
        for stiffness in [120.0, 300.0, 800.0, 1500.0, 3000.0] {
            for torque in [0.75, 1.0, 1.25] {
                for (is_thread, host_hz) in
                    [(false, 60.0), (false, 250.0), (true, 60.0), (true, 250.0)]
                {
                    let ticks = falls(stiffness, lag_s, torque, is_thread, host_hz);
                    let given = given_back(&ticks, 100, torque);
                    let what =
                        format!("{lag_s} s, {stiffness} N/m, x{torque}, {is_thread} {host_hz} Hz");
                    assert!(given < 2.1e-3, "{what}: {given}");
                }
            }
        }
    }
}

/// What fades is zero at last, and no number that a plot would scale to.
#[test]
fn a_force_in_the_air_is_zero() {
    let ticks = feel(&Scene {
        path: &|t| 2e-3 - 6e-3 * ramp(t / 0.3) + 12e-3 * ramp((t - 0.6) / 0.1),
        law: &linear(800.0),
        ..Scene::BASE
    });
    assert!(ticks[500].force > 3.0);
    for tick in &ticks {
        assert!(tick.force == 0.0 || tick.force.abs() > 0.9e-9, "{tick:?}");
    }
    assert!(ticks[1100..].iter().all(|tick| tick.force == 0.0));
}
