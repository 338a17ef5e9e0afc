//! Tissue that moves by itself.

use crate::grip::{Hand, Scene, Tick, beyond_notice, feel, given_back, ramp, withheld};
use core::f64::consts::PI;

const HANDS: [Hand; 5] = [
    Hand::Rigid,
    Hand::Spring(50.0, 1.0),
    Hand::Spring(200.0, 2.0),
    Hand::Spring(800.0, 4.0),
    Hand::Spring(2000.0, 5.0),
];

/// Stiffens from 300 N/m.
fn tissue(deep: f64) -> (f64, f64) {
    if deep > 0.0 {
        (300.0 * deep + 15e3 * deep * deep, 300.0 + 30e3 * deep)
    } else {
        (0.0, 300.0)
    }
}

/// A hand that rests in tissue that breathes by 5 mm at 0.3 Hz, on a console that gets tangents that are wrong by a factor.
fn breathes(hand: Hand, host_hz: f64, deep: f64, tangent: f64) -> Vec<Tick> {
    let path = |t: f64| 2e-3 - (2e-3 + deep) * ramp(t / 0.5);
    let mut ticks = feel(&Scene {
        path: &path,
        hand,
        law: &tissue,
        surface: &|t| 5e-3 * (2.0 * PI * 0.3 * t).sin(),
        host_hz,
        delay_s: 1.0 / host_hz,
        horizon_us: (4e6 / host_hz) as u32,
        phase: 0.3,
        tangent,
        seconds: 10.0,
        ..Scene::BASE
    });
    ticks.split_off(1500)
}

#[test]
fn tissue_that_breathes_is_felt() {
    for (host_hz, rigid, others) in [(60.0, 0.02, 0.15), (100.0, 0.02, 0.15), (500.0, 0.02, 0.02)] {
        for hand in HANDS {
            for deep in [8e-3, 12e-3] {
                let ticks = breathes(hand, host_hz, deep, 1.0);
                let what = format!("{host_hz} Hz, {hand:?}, {deep} m");
                let beyond = beyond_notice(&ticks);
                let bar = if hand == Hand::Rigid { rigid } else { others };
                assert!(beyond < bar, "{what}: {beyond}");
                // A hand of 50 N/m goes along with the surface, as one does that withdraws.
                let kept_back = withheld(&ticks);
                let bar = if hand == Hand::Spring(50.0, 1.0) {
                    0.05
                } else {
                    0.0
                };
                assert!(kept_back <= bar, "{what}: {kept_back}");
                assert!(given_back(&ticks, 100, 1.0) < 0.5e-3, "{what}");
            }
        }
    }
}

#[test]
fn tangents_that_are_wrong_give_nothing_away_for_breath() {
    for tangent in [0.5, 0.75, 1.25, 2.0] {
        for hand in HANDS {
            for host_hz in [30.0, 60.0, 500.0] {
                let ticks = breathes(hand, host_hz, 8e-3, tangent);
                let given = given_back(&ticks, 100, 1.0);
                let what = format!("x{tangent} {hand:?} {host_hz} Hz");
                // 1.47 mJ where nothing of the surface is known.
                assert!(given < 1.2e-3, "{what}: {given}");
            }
        }
    }
}
