//! What a thread presses on tissue where it turns.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::thread::{ThreadPart, Through};

/// Round a half circle of 8 mm it is T / (R d), so that it presses half as much if it is twice as thick; with the quarter turn from
/// one bite to the next half as much again. Slack it presses on nothing.
#[test]
fn round_a_half_circle_it_is_tension_over_radius_and_thickness() {
    for (times, friction, thickness_m) in [(1, 0.0, 0.3e-3), (1, 0.0, 0.6e-3), (2, 0.1, 0.3e-3)] {
        let with = ThreadPart {
            friction,
            ..part(Through {
                grip_n: 0.2,
                thickness_m,
                ..ELASTIC
            })
        };
        let mut bench = wound_up(times, with);
        let report = bench.step_both();
        assert_eq!(report.threads()[0].pressure_pa, 0.0);
        let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
        let thread = report.threads()[0];
        let each = bench.state.thread_pressures_pa(&bench.model, 7);
        let round = thread.tension_n[1] / (0.008 * thickness_m);
        let expected = if times == 1 { round } else { 1.5 * round };
        println!("{times}, {friction}, {thickness_m} m: {each:?} Pa, {expected} Pa");
        assert_eq!(each.len(), times as usize);
        assert_eq!(thread.pressure_pa, each[each.len() - 1]);
        let ratio = thread.pressure_pa / expected;
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        // There is less tension in the passage before.
        let before = each[0] / thread.pressure_pa;
        assert!(times == 1 || before < 0.8, "{before}");
    }
}

/// A straight thread presses on nothing, however it is pulled.
#[test]
fn a_straight_thread_presses_on_nothing() {
    let mut bench = locked(ELASTIC);
    let report = go(&mut bench, Vector3::new(0.0, 0.0, -0.002));
    let thread = report.threads()[0];
    assert!(thread.tension_n[1] > 1.0);
    assert!(thread.pressure_pa < 1e3, "{} Pa", thread.pressure_pa);
}
