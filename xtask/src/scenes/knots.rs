//! A wound between two slabs that is closed by interrupted stitches: each is drawn together by the knot at its tail, and cut with a
//! knot at its other end.
//!
//! Entry point: [`interrupted`]. It differs from [`super::slabs::wound`] in what is done with the thread.

use super::drawn::{AWAY_S, DRAWS, Drawn, STAY_S, stop};
use super::slabs::{self, CENTRE_Z_M, GAP_M, NEEDLE_RADIUS_M, REACH_M};
use super::stitch::{Bite, Sewing};
use super::turn::{Vec3, along};
use super::write;

/// What there is of thread behind the needle at first \[m\].
const THREAD_M: f64 = 0.15;
/// How far the needle is drawn away after each bite \[m\]: until the knot is at the tissue, and the wound is closed there.
const AWAY_M: [f64; 4] = [0.1385, 0.1246, 0.1104, 0.0960];
/// After which bites the console draws.
const CONSOLE: std::ops::Range<usize> = 1..4;
/// How long the way to the next bite takes \[s\].
const WAY_S: f64 = 1.0;
/// Up, and across the gap, as what is drawn the other way opens it.
const AWAY: Vec3 = [-0.6, 0.0, 0.8];
/// How far from where the thread comes out it is cut \[m\].
const CUT_M: f64 = 0.003;

fn sewing() -> Sewing {
    let plain = slabs::sewing();
    Sewing {
        bites: plain
            .bites
            .iter()
            .map(|bite| Bite {
                way_s: WAY_S,
                ..*bite
            })
            .collect(),
        pulls: AWAY_M.iter().map(|far_m| AWAY.map(|v| far_m * v)).collect(),
        pull_s: AWAY_S + STAY_S,
        ..plain
    }
}

/// The scene.
pub fn interrupted() -> String {
    let sewing = sewing();
    let script = sewing.script();
    let hands = Drawn::new(&sewing, CONSOLE);
    // Half a chord of the needle's circle at the slabs' tops.
    let half_m = (NEEDLE_RADIUS_M.powi(2) - CENTRE_Z_M.powi(2)).sqrt();
    let mut scissors = Vec::new();
    let mut cuts = String::new();
    for (bite, there_s) in sewing.bites.iter().zip(&hands.there_s) {
        let out = [half_m, bite.centre[1], 0.0];
        let at = along(out, CUT_M, AWAY);
        let cut_s = there_s + 0.5 * STAY_S;
        scissors.push(stop(cut_s - 0.05, at));
        scissors.push(stop(cut_s + 0.05, at));
        cuts.push_str(&format!(
            "  {{ time_s = {cut_s:.3}, tool = 3, knots = true }},\n"
        ));
    }
    let mut text = format!(
        "# A wound between two slabs is closed by {} interrupted stitches: a knot at the thread's tail draws each together, and it is cut with a
# knot at its other end, at which the next one begins.
#
# World frame: z up. The slabs' tops are at z = 0, the gap of {:.0} mm between them is along y. The needle goes as in wound-slabs.toml; after
# each bite a hand, later the console, draws it away until the wound is closed there.
#
# Written by `cargo xtask scenes`: change it there.

name = \"Interrupted stitches\"
seconds = {:.1}
device = \"cartesian-bench\"

",
        sewing.bites.len(),
        1e3 * GAP_M,
        hands.ends_s,
    );
    slabs::tissue(&mut text, slabs::DIVISIONS);
    write::needle(&mut text, &sewing, &hands.holds);
    text.push_str(&format!(
        "# Frictionless, with a knot at its tail.
[[thread]]
needle = 0
length_m = {THREAD_M:?}
hold = [{{ time_s = 0.0, end = \"tail\", knot = true }}]
cut = [
{cuts}]

"
    ));
    slabs::contact(&mut text);
    text.push_str("# The console's own.\n[[tool]]\nid = 0\nshape = \"grip\"\n\n");
    text.push_str("# Goes round with the needle, which it holds from the circle's centre.\n");
    let [round, carry] = &script.stops;
    write::hand(&mut text, 1, REACH_M, round);
    text.push_str("# Carries the needle to the next bite, held likewise.\n");
    write::hand(&mut text, 2, REACH_M, carry);
    text.push_str("# Cuts the thread.\n");
    write::hand(&mut text, 3, REACH_M, &scissors);
    text.push_str("# Draws the needle away after the first bite.\n");
    write::hand(&mut text, DRAWS, REACH_M, &hands.hand);
    write::console_hand(&mut text, &hands.console);
    text.push_str("[host]\nhost_hz = 200.0\nhorizon_ms = 60.0\n");
    text
}
