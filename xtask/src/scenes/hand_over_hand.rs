//! Two tubes that are sewn end to end with a thread that rubs, and then drawn together by hand, span by span from the needle on: one
//! hand draws a span, another one then keeps it where it goes in, until the next span is drawn.
//!
//! Entry point: [`by_hand`]. What rubs is not closed by a pull at the ends; nor does a bite at an end close best where it is pulled
//! hardest: what pulls outside turns its edges out. So both ends are given back a little, as surgeons do.

use super::drawn::stop;
use super::stitch::{Bite, Stop};
use super::tubes::{self, CENTRE_M, LOWER, NEEDLE_RADIUS_M, REACH_M, THREAD_M, UPPER};
use super::turn::{Vec3, along, norm};
use super::write;

const PUNCTURES: u32 = 20;
const FRICTION: f64 = 0.1;

/// A span that is drawn.
struct Draw {
    /// Before which bite: of the first one it is the tail.
    bite: usize,
    /// How far from where it is taken \[m\].
    far_m: f64,
    /// After that, by how much the console draws it farther, near the tissue.
    near_m: Option<f64>,
    /// And then, once what was kept has come to it.
    later_m: f64,
}

/// In their order. Each has more to draw than the one before, as what that drew comes with it; pulled to 1.3 to 1.5 N.
const DRAWS: [Draw; 4] = [
    Draw {
        bite: 3,
        far_m: 0.03553,
        near_m: None,
        later_m: 0.0,
    },
    Draw {
        bite: 2,
        far_m: 0.07623,
        near_m: None,
        later_m: 0.00192,
    },
    Draw {
        bite: 1,
        far_m: 0.14870,
        near_m: Some(0.01083),
        later_m: 0.00151,
    },
    Draw {
        bite: 0,
        far_m: 0.29355,
        near_m: Some(0.01133),
        later_m: 0.00243,
    },
];
/// How far the tail is given back at the end \[m\].
const TAIL_BACK_M: f64 = 0.0015;
/// The needle: how far from the tissue it is drawn first, how far at the end, and how far of that it is given back \[m\].
const NEEDLE_M: [f64; 3] = [0.020, 0.0095, 0.003];

/// How far from where they go in, or come out, spans are taken by who draws, by the console, and by who keeps them \[m\].
const TAKEN_M: f64 = 0.006;
const NEAR_M: f64 = 0.010;
const KEPT_M: f64 = 0.005;
/// How long a pull takes, and one near the tissue \[s\].
const PULL_S: f64 = 4.0;
const NEAR_S: f64 = 5.0;
/// Who draws first, and who keeps.
const HAND: u8 = 4;
const KEEPER: u8 = 3;

/// Where the thread goes in before a bite, or comes out after it, and which way it is pulled there.
struct Side {
    at: Vec3,
    out: Vec3,
    round: Vec3,
    pulled: Vec3,
}

/// Outwards, so that it stays clear of the tubes, round them away from the bite, and across the gap, as what is drawn the other way
/// opens it.
const PULLED: Vec3 = [0.36, 0.48, 0.8];

fn side(bites: &[Bite], index: usize, leaves: bool) -> Side {
    let bite = &bites[index];
    // Bites go down and up in turn.
    let upper = index.is_multiple_of(2) != leaves;
    let tube = if upper { &UPPER } else { &LOWER };
    let degrees = tubes::crossing_deg(CENTRE_M, tube.radii_m[1], upper);
    let (sin, cos) = degrees.to_radians().sin_cos();
    let [out, up] = bite.axes;
    let on_circle = along(out.map(|v| cos * v), sin, up);
    let sense = if leaves { 1.0 } else { -1.0 };
    let round = [-out[1], out[0], 0.0].map(|v| sense * v);
    let across = if upper { -PULLED[2] } else { PULLED[2] };
    let level = along(out.map(|v| PULLED[0] * v), PULLED[1], round);
    Side {
        at: along(bite.centre, NEEDLE_RADIUS_M, on_circle),
        out,
        round,
        pulled: along(level, across, up),
    }
}

/// What all hands do.
#[derive(Default)]
struct Hands {
    draws: Vec<Stop>,
    console: Vec<(f64, Vec3)>,
    keeps: Vec<Stop>,
    /// Lines of the thread's `hold`.
    holds: String,
}

impl Hands {
    fn hold(&mut self, time_s: f64, end: &str, tool: Option<u8>, lets_go: bool) {
        let tool = tool.map_or(String::new(), |tool| format!(", tool = {tool}"));
        let lets_go = if lets_go { ", lets_go = true" } else { "" };
        let line = format!("  {{ time_s = {time_s:.3}, end = \"{end}\"{tool}{lets_go} }},\n");
        self.holds.push_str(&line);
    }

    /// The hand that draws, or the console, is somewhere.
    fn is_at(&mut self, who: u8, time_s: f64, at: Vec3) {
        match who {
            HAND => self.draws.push(stop(time_s, at)),
            _ => self.console.push((time_s, at)),
        }
    }

    /// Draws a span from a time on; when it is done.
    fn draw(&mut self, draw: &Draw, bites: &[Bite], from_s: f64) -> f64 {
        let side = side(bites, draw.bite, false);
        let end = if draw.bite == 0 { "tail" } else { "span" };
        let taken = match draw.bite {
            0 => along(side.at, NEAR_M - TAKEN_M, side.pulled),
            _ => along(along(side.at, TAKEN_M, side.round), 0.001, side.out),
        };
        let mut far = along(taken, draw.far_m, side.pulled);
        self.is_at(HAND, from_s, taken);
        self.hold(from_s + 0.05, end, Some(HAND), false);
        self.is_at(HAND, from_s + 0.1, taken);
        let mut there_s = from_s + 0.1 + PULL_S;
        self.is_at(HAND, there_s, far);
        let (mut who, mut way) = (HAND, side.pulled);
        if let Some(near_m) = draw.near_m {
            let line = along(far, -1.0, side.at);
            way = line.map(|v| v / norm(line));
            let near = along(side.at, NEAR_M, way);
            if !self.console.is_empty() {
                self.is_at(0, there_s + 0.05, near);
            }
            self.is_at(0, there_s + 0.25, near);
            self.hold(there_s + 0.2, "span", Some(0), false);
            let (tool, lets_go) = if draw.bite == 0 {
                (None, false)
            } else {
                (Some(HAND), true)
            };
            self.hold(there_s + 0.24, end, tool, lets_go);
            self.is_at(HAND, there_s + 0.25, far);
            there_s += 0.25 + NEAR_S;
            far = along(near, near_m, way);
            self.is_at(0, there_s, far);
            who = 0;
        }
        if let Some(kept) = self.keeps.last().copied() {
            self.hold(there_s + 0.1, "span", Some(KEEPER), true);
            self.keeps.push(stop(there_s + 0.1, kept.position_m));
        }
        self.is_at(who, there_s + 0.2, far);
        there_s += 0.6;
        far = along(far, draw.later_m, way);
        self.is_at(who, there_s, far);
        if draw.bite == 0 {
            self.is_at(0, there_s + 0.1, far);
            self.is_at(0, there_s + 0.4, along(far, -TAIL_BACK_M, way));
            return there_s + 0.5;
        }
        let line = along(far, -1.0, side.at);
        let kept = along(side.at, KEPT_M / norm(line), line);
        self.keeps.push(stop(there_s + 0.15, kept));
        self.hold(there_s + 0.2, "span", Some(KEEPER), false);
        self.hold(there_s + 0.25, "span", Some(who), true);
        self.keeps.push(stop(there_s + 0.3, kept));
        self.is_at(who, there_s + 0.3, far);
        there_s + 0.7
    }
}

/// The scene.
pub fn by_hand() -> String {
    let sewing = tubes::sewing(PUNCTURES);
    let script = sewing.script();
    let [mut round, carry] = script.stops;
    let sewn_s = script.ends_s.last().copied().unwrap_or(0.0);
    let mut hands = Hands::default();
    let draw = |from_s, draw| hands.draw(draw, &sewing.bites, from_s);
    let drawn_s = DRAWS.iter().fold(sewn_s + 0.9, draw);
    // The hand that went round with the needle holds it on, and draws the last bite together by it.
    if let Some(rests) = round.last().copied() {
        let side = side(&sewing.bites, sewing.bites.len() - 1, true);
        let [away_m, drawn_m, back_m] = NEEDLE_M;
        let clear = along(rests.position_m, 0.004, side.out);
        let away = along(clear, away_m, side.pulled);
        let drawn = along(away, drawn_m, side.pulled);
        for (time_s, position_m) in [
            (sewn_s + 0.19, clear),
            (sewn_s + 0.79, away),
            (drawn_s, away),
            (drawn_s + 0.6, drawn),
            (drawn_s + 0.7, drawn),
            (drawn_s + 1.0, along(drawn, -back_m, side.pulled)),
        ] {
            round.push(Stop {
                time_s,
                position_m,
                ..rests
            });
        }
    }
    let holds: Vec<(f64, u8)> = script
        .holds
        .iter()
        .map(|(time_s, hand)| (*time_s, [1, 2][*hand]))
        .collect();
    let mut text = format!(
        "# Two tubes end to end are sewn together with one thread that rubs, {PUNCTURES} punctures, and then drawn together by hand, span by span
# from the needle on: a hand, later the console, draws a span, and another one keeps it until the next one is drawn.
#
# World frame: z up, the tubes' common axis. The needle goes as in anastomosis-{PUNCTURES}.toml; the first hand keeps it at the end.
#
# Written by `cargo xtask scenes`: change it there.

name = \"Two tubes, by hand\"
seconds = {:.1}
device = \"cartesian-bench\"

",
        (10.0 * (drawn_s + 1.8)).ceil() / 10.0,
    );
    tubes::tissue(&mut text);
    write::needle(&mut text, &sewing, &holds);
    text.push_str(&format!(
        "# Around a turn tension falls by e^(0.1 turn), so that each span is drawn by itself.
[[thread]]
needle = 0
length_m = {THREAD_M:?}
friction = {FRICTION:?}
hold = [
{}]

",
        hands.holds
    ));
    tubes::contact(&mut text);
    text.push_str(&format!(
        "# The console's own.\n[[tool]]\nid = 0\nshape = \"grip\"\nreach_m = {REACH_M}\n\n"
    ));
    text.push_str(
        "# Goes round with the needle, which it holds from the circle's centre, and keeps it.\n",
    );
    write::hand(&mut text, 1, REACH_M, &round);
    text.push_str("# Carries the needle to the next bite, held likewise.\n");
    write::hand(&mut text, 2, REACH_M, &carry);
    text.push_str("# Keeps what is drawn.\n");
    write::hand(&mut text, KEEPER, REACH_M, &hands.keeps);
    text.push_str("# Draws.\n");
    write::hand(&mut text, HAND, REACH_M, &hands.draws);
    write::console_hand(&mut text, &hands.console);
    text.push_str("[host]\nhost_hz = 250.0\nhorizon_ms = 60.0\n");
    text
}
