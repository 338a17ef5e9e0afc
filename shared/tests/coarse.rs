//! Encoders whose counts are felt: a hand that rests on one must not look as if it took energy.

use crate::grip::{COUNTS_PER_M, Hand, Scene, Tick, feel, given_back, linear, ramp, withheld};

const HANDS: [Hand; 6] = [
    Hand::Rigid,
    Hand::Spring(50.0, 1.0),
    Hand::Spring(200.0, 2.0),
    Hand::Spring(800.0, 4.0),
    Hand::Spring(2000.0, 5.0),
    Hand::Mass(0.06, -1.0),
];

fn held(hand: Hand, stiffness: f64, counts_per_m: f64, offset: f64, presses: bool) -> Vec<Tick> {
    let tremor = |t: f64| 20e-6 * (2.0 * core::f64::consts::PI * 9.0 * t).sin();
    let deep = f64::min(6e-3, 5.0 / stiffness);
    let path = move |t: f64| {
        if presses {
            2e-3 - 0.5 * (2e-3 + deep) * (1.0 - (2.0 * core::f64::consts::PI * t).cos()) + tremor(t)
        } else {
            2e-3 - (2e-3 + deep) * ramp(t / 0.5) + tremor(t)
        }
    };
    feel(&Scene {
        path: &path,
        hand,
        law: &linear(stiffness),
        counts_per_m,
        offset_m: offset / counts_per_m,
        seconds: 4.0,
        ..Scene::BASE
    })
}

#[test]
fn a_count_that_is_felt_takes_nothing_away() {
    for turn in [4096.0, 1024.0, 512.0, 256.0, 128.0, 64.0] {
        let counts_per_m = COUNTS_PER_M * turn / 4096.0;
        for stiffness in [300.0, 600.0, 1000.0, 2000.0] {
            let count_n = stiffness / counts_per_m;
            if !(0.025..0.25).contains(&count_n) {
                continue;
            }
            for hand in HANDS {
                for (offset, presses) in [(0.0, false), (0.3, true), (0.7, false), (0.7, true)] {
                    let ticks = held(hand, stiffness, counts_per_m, offset, presses);
                    let what =
                        format!("{turn} counts, {stiffness} N/m, {hand:?}, {offset} {presses}");
                    assert_eq!(withheld(&ticks[1000..]), 0.0, "{what}");
                    let given = given_back(&ticks[1000..], 100, 1.0);
                    assert!(given < 0.5e-3, "{what}: {given}");
                }
            }
        }
    }
}
