//! An anastomosis that is drawn together by hand while it is sewn: after each bite a hand pulls at the needle, and another one
//! holds the thread where it comes out of the tissue while the needle goes on.
//!
//! Entry point: [`by_hand`]. The thread rubs, so that a pull at its ends would close the last bites only.

use super::stitch::{Bite, REST_S, Sewing, Stop};
use super::tubes::{self, CENTRE_M, LOWER, NEEDLE_RADIUS_M, REACH_M, THREAD_M, UPPER};
use super::turn::{Vec3, along};
use super::write;

const PUNCTURES: u32 = 50;
const FRICTION: f64 = 0.1;
/// How long the needle is drawn away after a bite, and held there \[s\].
const AWAY_S: f64 = 1.2;
const STAY_S: f64 = 0.9;
/// How long the way to the next bite takes \[s\].
const WAY_S: f64 = 1.0;
/// How far it is drawn after each bite \[m\]: after the first one with all that is to be sewn with, after each of the others that is
/// less by what the one before has taken.
const AWAY_M: [f64; 13] = [
    0.2300, 0.2181, 0.2083, 0.1805, 0.1640, 0.1475, 0.1310, 0.1145, 0.0980, 0.0815, 0.0650, 0.0485,
    0.0320,
];
/// After which bites the console draws, which goes by 12 points at most; after those before a hand of the scene does.
const CONSOLE: std::ops::Range<usize> = 10..13;
/// How much of the first way the tail is still free \[m\].
const FREE_M: f64 = 0.2217;
/// How far from where the thread comes out a hand holds it, and where it goes in the tail \[m\].
const HELD_M: f64 = 0.008;

/// Where a hand is, from when on.
fn stop(time_s: f64, position_m: Vec3) -> Stop {
    Stop {
        time_s,
        position_m,
        rotation_deg: [0.0; 3],
    }
}

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

/// The needle's way, drawn away after each bite.
fn sewing() -> Sewing {
    let plain = tubes::sewing(PUNCTURES);
    let ways = (0..plain.bites.len()).map(|index| away(&plain, index).map(|v| AWAY_M[index] * v));
    Sewing {
        pulls: ways.collect(),
        pull_s: AWAY_S + STAY_S,
        bites: plain
            .bites
            .iter()
            .map(|bite| Bite {
                way_s: WAY_S,
                ..*bite
            })
            .collect(),
        ..plain
    }
}

/// What hands do between the bites.
#[derive(Default)]
struct Between {
    /// Of the hand that draws first, and of the console.
    draws: Vec<Stop>,
    console: Vec<(f64, Vec3)>,
    /// Of the hand that keeps the thread, and when it takes it or lets it go \[s\].
    keeps: Vec<Stop>,
    holds: Vec<(f64, bool)>,
    ends_s: f64,
}

fn between(sewing: &Sewing, ends_s: &[f64]) -> Between {
    let mut all = Between::default();
    for (index, (bite, sewn_s)) in sewing.bites.iter().zip(ends_s).enumerate() {
        let (from_s, at) = (sewn_s + 2.0 * REST_S, sewing.end_after(bite));
        let there_s = from_s + AWAY_S;
        let far = along(at, 1.0, sewing.pulls[index]);
        all.ends_s = there_s + STAY_S;
        for (time_s, at) in [
            (*sewn_s, at),
            (from_s, at),
            (there_s, far),
            (all.ends_s + 2.0 * REST_S, far),
        ] {
            if CONSOLE.contains(&index) {
                all.console.push((time_s, at));
            } else {
                all.draws.push(stop(time_s, at));
            }
        }
        let [_, out] = punctures(sewing, index);
        if let Some(last) = all.keeps.last().copied() {
            // Until the console pulls.
            all.keeps.push(stop(there_s + 0.1, last.position_m));
            all.holds.push((there_s + 0.1, false));
        }
        // At the end the console has it.
        if index + 1 < sewing.bites.len() {
            all.keeps.push(stop(
                there_s + 0.55,
                along(out, HELD_M, away(sewing, index)),
            ));
            all.holds.push((there_s + 0.6, true));
        }
    }
    all
}

/// The scene.
pub fn by_hand() -> String {
    let sewing = sewing();
    let script = sewing.script();
    let puller = |index: usize| if CONSOLE.contains(&index) { 0 } else { 4 };
    let mut drawn = 0..;
    let needle_holds = script.holds.iter().map(|(time_s, hand)| {
        let tool = match hand {
            0 => 1,
            1 => 2,
            _ => puller(drawn.next().unwrap_or_default()),
        };
        (*time_s, tool)
    });
    let needle_holds: Vec<_> = needle_holds.collect();
    let hands = between(&sewing, &script.ends_s);
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
    write::needle(&mut text, &sewing, &needle_holds);
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
    for (time_s, takes) in hands.holds {
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
    write::hand(&mut text, 3, REACH_M, &hands.keeps);
    text.push_str("# Draws the needle away after the first bites.\n");
    write::hand(&mut text, 4, REACH_M, &hands.draws);
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
