//! One stall of the host, of any length: the tissue comes back.

use crate::grip::{Hand, Scene, Tick, feel, linear, ramp};

const HANDS: [Hand; 6] = [
    Hand::Rigid,
    Hand::Spring(50.0, 1.0),
    Hand::Spring(100.0, 1.4),
    Hand::Spring(200.0, 2.0),
    Hand::Spring(800.0, 4.0),
    Hand::Spring(2000.0, 5.0),
];

/// What a stall leaves behind.
#[derive(Debug)]
struct After {
    /// Least force over the true one, a second after it.
    share: f64,
    /// Most that is given to the hand until then \[J\].
    given_j: f64,
    /// How far the hand has come out beyond where it rests at last \[m\].
    past_m: f64,
}

/// A press of this force on tissue of a stiffness \[N, N/m\], and a stall of the host.
fn stall(
    hand: Hand,
    (force, stiffness): (f64, f64),
    host_hz: f64,
    at_s: f64,
    length_s: f64,
) -> After {
    // Where hand and tissue balance at that force.
    let deep = match hand {
        Hand::Spring(k, _) => force / stiffness + force / k,
        _ => force / stiffness,
    };
    let path = |t: f64| 2e-3 - (2e-3 + deep) * ramp(t / 0.8);
    let back_s = at_s + length_s;
    let ticks = feel(&Scene {
        path: &path,
        hand,
        law: &linear(stiffness),
        host_hz,
        delay_s: 1.0 / host_hz,
        horizon_us: (4.0 * 1e6 / host_hz) as u32,
        lost: &[(at_s, back_s)],
        seconds: back_s + 1.2,
        ..Scene::BASE
    });
    let back = ((back_s + 1.0 / host_hz) * 1e3) as usize;
    let since = &ticks[back..back + 1000];
    let last = &since[980..];
    let share = |t: &Tick| t.force / t.truth;
    let given = |t: &Tick| since[0].energy - t.energy;
    let rest = ticks[ticks.len() - 1].z;
    After {
        share: last.iter().map(share).fold(f64::INFINITY, f64::min),
        given_j: since.iter().map(given).fold(0.0, f64::max),
        past_m: since.iter().map(|t| t.z).fold(f64::MIN, f64::max) - rest,
    }
}

#[test]
fn a_stall_of_any_length_takes_no_tissue_away() {
    let lengths = (20..150).step_by(6).chain([200, 350, 500]);
    let cases = lengths.flat_map(|ms| [0.7, 1.2].map(|at_s| (ms, at_s)));
    for (ms, at_s) in cases {
        for host_hz in [30.0, 60.0, 200.0] {
            for hand in HANDS {
                for press in [(1.0, 300.0), (2.0, 500.0), (3.0, 800.0), (5.0, 1500.0)] {
                    // What is lent would not be enough.
                    if let Hand::Spring(k, _) = hand
                        && press.0 * press.0 / (2.0 * k) > 14e-3
                    {
                        continue;
                    }
                    let after = stall(hand, press, host_hz, at_s, 1e-3 * f64::from(ms));
                    let what = format!(
                        "{ms} ms at {at_s} s, {host_hz} Hz, {hand:?}, {press:?}: {after:?}"
                    );
                    assert!(after.share > 0.89, "{what}");
                    assert!(after.given_j < 15e-3 && after.past_m < 2e-3, "{what}");
                }
            }
        }
    }
}
