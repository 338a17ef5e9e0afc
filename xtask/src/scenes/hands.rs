//! An anastomosis that is drawn together by hand while it is sewn: after each bite a hand pulls at the needle, and another one
//! holds the thread where it comes out of the tissue while the needle goes on.
//!
//! Entry point: [`by_hand`]. The thread rubs, so that a pull at its ends would close the last bites only.

use super::drawn::{AWAY_S, DRAWS, Drawn, STAY_S, stop};
use super::stitch::{Bite, REST_S, Sewing, Stop};
use super::tubes::{self, CENTRE_M, LOWER, NEEDLE_RADIUS_M, REACH_M, THREAD_M, UPPER};
use super::turn::{Vec3, along};
use super::write;

const PUNCTURES: u32 = 50;
const FRICTION: f64 = 0.1;
/// How much farther than elsewhere the needle goes round, as the tissue is no more where it was \[degree\].
const MORE_DEG: f64 = 20.0;
/// How long the way to the next bite takes \[s\].
const WAY_S: f64 = 1.0;
/// How far it is drawn after each bite \[m\]: after the first one with all that is to be sewn with, after each of the others that is
/// less by what the one before has taken.
const AWAY_M: [f64; 13] = [
    0.2300, 0.2195, 0.2105, 0.2007, 0.1913, 0.1847, 0.1650, 0.1540, 0.1420, 0.1310, 0.1190, 0.1080,
    0.0960,
];
/// After which bites the console draws, which goes by 12 points at most; after those before a hand of the scene does.
const CONSOLE: std::ops::Range<usize> = 10..13;
/// How much of the first way the tail is still free \[m\].
const FREE_M: f64 = 0.2183;
/// How far from where the thread comes out a hand holds it, and where it goes in the tail \[m\].
const HELD_M: f64 = 0.008;

/// Where the thread goes in before a bite and comes out after it \[m\].
fn punctures(sewing: &Sewing, index: usize) -> [Vec3; 2] {
    let bite = &sewing.bites[index];
    let degrees = [
        tubes::crossing_deg(CENTRE_M, UPPER.radii_m[1], true),
        tubes::crossing_deg(CENTRE_M, LOWER.radii_m[1], false),
    ];
    let at = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let out = along(bite.axes[0].map(|v| cos * v), sin, bite.axes[1]);
        along(bite.centre, NEEDLE_RADIUS_M, out)
    };
    let [upper, lower] = degrees.map(at);
    if index % 2 == 0 {
        [upper, lower]
    } else {
        [lower, upper]
    }
}

/// Unit vector along which thread is drawn after a bite: round the tube towards the next one, and across the gap, as what is drawn the
/// other way opens it.
fn away(sewing: &Sewing, index: usize) -> Vec3 {
    let [x, y, _] = sewing.bites[index].axes[0];
    let across = if index % 2 == 0 { 0.8 } else { -0.8 };
    [-0.6 * y, 0.6 * x, across]
}

/// A bite that goes farther round, and has more time for the way to the next one.
fn farther(bite: &Bite) -> Bite {
    let [from, to] = bite.tip_deg;
    Bite {
        tip_deg: [from, to + MORE_DEG * (to - from).signum()],
        way_s: WAY_S,
        ..*bite
    }
}

/// The needle's way, drawn away after each bite.
fn sewing() -> Sewing {
    let plain = tubes::sewing(PUNCTURES);
    let ways = (0..plain.bites.len()).map(|index| away(&plain, index).map(|v| AWAY_M[index] * v));
    Sewing {
        pulls: ways.collect(),
        pull_s: AWAY_S + STAY_S,
        bites: plain.bites.iter().map(farther).collect(),
        ..plain
    }
}

/// The hand that keeps the thread between the bites, and when it takes it or lets it go \[s\].
fn keeps(sewing: &Sewing, there_s: &[f64]) -> (Vec<Stop>, Vec<(f64, bool)>) {
    let (mut stops, mut holds): (Vec<Stop>, _) = (Vec::new(), Vec::new());
    for (index, there_s) in there_s.iter().enumerate() {
        if let Some(last) = stops.last().copied() {
            // Until the next one pulls.
            stops.push(stop(there_s + 0.1, last.position_m));
            holds.push((there_s + 0.1, false));
        }
        // At the end the console has it.
        if index + 1 < sewing.bites.len() {
            let [_, out] = punctures(sewing, index);
            stops.push(stop(
                there_s + 0.55,
                along(out, HELD_M, away(sewing, index)),
            ));
            holds.push((there_s + 0.6, true));
        }
    }
    (stops, holds)
}

/// The scene.
pub fn by_hand() -> String {
    let sewing = sewing();
    let script = sewing.script();
    let hands = Drawn::new(&sewing, CONSOLE);
    let (keeper, holds) = keeps(&sewing, &hands.there_s);
    let [into, _] = punctures(&sewing, 0);
    let tail = along(into, -HELD_M, away(&sewing, 0));
    let drawn_s = drawn_s(script.ends_s[0] + 2.0 * REST_S);
    let mut text = format!(
        "# Two tubes end to end are sewn together with one thread that rubs, {PUNCTURES} punctures, and drawn together by hand: after each
# bite a hand, later the console, takes the needle and pulls, and another one then keeps the thread where it comes out.
#
# World frame: z up, the tubes' common axis. The needle goes as in anastomosis-{PUNCTURES}.toml. The first pull draws in
# what is to be sewn with, until the tail is held.
#
# Written by `cargo xtask scenes`: change it there.

name = \"Two tubes, by hand\"
seconds = {:.1}
device = \"cartesian-bench\"

",
        hands.ends_s
    );
    tubes::tissue(&mut text);
    write::needle(&mut text, &sewing, &hands.holds);
    text.push_str(&format!(
        "[[thread]]
needle = 0
length_m = {THREAD_M:?}
friction = {FRICTION:?}
hold = [
  {{ time_s = {drawn_s:.3}, end = \"tail\", at_m = {} }},
",
        write::position(tail)
    ));
    for (time_s, takes) in holds {
        let rest = if takes { "" } else { ", lets_go = true" };
        text.push_str(&format!(
            "  {{ time_s = {time_s:.3}, end = \"span\", tool = 3{rest} }},\n"
        ));
    }
    text.push_str("]\n\n");
    tubes::contact(&mut text);
    text.push_str("# The console's own.\n[[tool]]\nid = 0\nshape = \"grip\"\n\n");
    text.push_str("# Goes round with the needle, which it holds from the circle's centre.\n");
    let [round, carry] = &script.stops;
    write::hand(&mut text, 1, REACH_M, round);
    text.push_str("# Carries the needle to the next bite, held likewise.\n");
    write::hand(&mut text, 2, REACH_M, carry);
    text.push_str("# Keeps the thread where it comes out.\n");
    write::hand(&mut text, 3, REACH_M, &keeper);
    text.push_str("# Draws the needle away after the first bites.\n");
    write::hand(&mut text, DRAWS, REACH_M, &hands.hand);
    write::console_hand(&mut text, &hands.console);
    text.push_str("[host]\nhost_hz = 200.0\nhorizon_ms = 60.0\n");
    text
}

/// When the hand, which begins at `from_s`, has drawn in so much that the tail is held \[s\]: it goes there with least jerk.
fn drawn_s(from_s: f64) -> f64 {
    let part = |s: f64| s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
    let wanted = FREE_M / AWAY_M[0];
    let steps = (0..=1000).map(|step| f64::from(step) / 1000.0);
    let found = steps.filter(|s| part(*s) < wanted).last();
    from_s + AWAY_S * found.unwrap_or(1.0)
}
