//! An anastomosis whose thread rubs and is pulled after every bite: at the end its tension would not reach the first
//! ones.
//!
//! Entry point: [`tightened`]. It differs from [`super::tubes::anastomosis`] in its thread and in a third hand.

use super::stitch::{Bite, Sewing, Stop};
use super::turn::{Vec3, along};
use super::{tubes, write};
use std::fmt::Write;

const PUNCTURES: u32 = 50;
const FRICTION: f64 = 0.1;
/// Where the third hand takes the thread, above the last puncture \[m\].
const NEAR_M: f64 = 0.006;
/// How far it pulls it \[m\]: after the first bite there is no slack to take up.
const FIRST_PULL_M: f64 = 0.003;
const PULL_M: f64 = 0.008;
/// When it takes the thread after a bite, and when it lets go \[s\].
const TAKES_S: f64 = 0.02;
const LEAVES_S: f64 = 0.33;

/// The scene.
pub fn tightened() -> String {
    let sewing = tubes::sewing(PUNCTURES);
    let ends_s = sewing.script().ends_s;
    let mut thread = format!(
        "# It rubs, and its tail is fastened beside the first puncture. After every bite the third hand takes it at the last
# puncture, pulls, and lets go; the console does so at the end.
[[thread]]
needle = 0
length_m = 0.6
friction = {FRICTION:?}
hold = [
"
    );
    let mut stops = Vec::new();
    for (index, (bite, end_s)) in sewing.bites.iter().zip(&ends_s).enumerate() {
        let (out, puncture) = (bite.axes[0], leaves_m(&sewing, bite));
        if index == 0 {
            let at = write::position(along(enters_m(&sewing, bite), 0.001, out));
            let time_s = end_s + TAKES_S;
            let _ = writeln!(
                thread,
                "  {{ time_s = {time_s:.3}, end = \"tail\", at_m = {at} }},"
            );
        }
        let (takes_s, leaves_s) = (end_s + TAKES_S, end_s + LEAVES_S);
        let is_last = index + 1 == ends_s.len();
        if is_last {
            let time_s = end_s + 0.05;
            let _ = writeln!(
                thread,
                "  {{ time_s = {time_s:.3}, end = \"head\", tool = 0 }},"
            );
            break;
        }
        let _ = writeln!(
            thread,
            "  {{ time_s = {takes_s:.3}, end = \"head\", tool = 3 }},\n  {{ time_s = {leaves_s:.3}, end = \"head\" }},"
        );
        let pull_m = if index == 0 { FIRST_PULL_M } else { PULL_M };
        let stop = |time_s, out_m| Stop {
            time_s,
            position_m: along(puncture, out_m, out),
            rotation_deg: [0.0; 3],
        };
        stops.push(stop(end_s - 0.1, NEAR_M));
        stops.push(stop(takes_s + 0.01, NEAR_M));
        stops.push(stop(leaves_s - 0.02, NEAR_M + pull_m));
        stops.push(stop(leaves_s + 0.01, NEAR_M + pull_m));
    }
    thread.push_str("]\n\n");
    let mut hand = "# Pulls the thread after every bite.\n".to_owned();
    write::hand(&mut hand, 3, &stops);
    let text = tubes::anastomosis(PUNCTURES);
    let text = between(
        &text,
        "name = ",
        "\n",
        "name = \"Two tubes, tightened bite by bite\"",
    );
    let text = between(
        &text,
        "# Two tubes end to end",
        "\n#\n",
        &format!(
            "# Two tubes end to end are sewn together with one thread: {PUNCTURES} punctures. It rubs, and is pulled after every bite.",
        ),
    );
    let text = between(&text, "# Frictionless", "# What closes.", &thread);
    between(&text, "# The hand is a spring", "", &hand)
}

/// `text` with `new` in place of what begins with `from` and ends before `to`; before `from` without `to`.
fn between(text: &str, from: &str, to: &str, new: &str) -> String {
    let found = text.find(from).and_then(|start| {
        let end = text[start..].find(to)?;
        Some((start, start + end))
    });
    found.map_or_else(String::new, |(start, end)| {
        [&text[..start], new, &text[end..]].concat()
    })
}

/// Where a bite goes into the tissue, and where it leaves it \[m\].
fn enters_m(sewing: &Sewing, bite: &Bite) -> Vec3 {
    on_circle(
        sewing,
        bite,
        bite.tip_deg[0] + tubes::CLEAR_DEG * sense(bite),
    )
}

fn leaves_m(sewing: &Sewing, bite: &Bite) -> Vec3 {
    let end_deg = bite.tip_deg[1] - (tubes::CLEAR_DEG + sewing.angle_deg) * sense(bite);
    on_circle(sewing, bite, end_deg)
}

fn sense(bite: &Bite) -> f64 {
    (bite.tip_deg[1] - bite.tip_deg[0]).signum()
}

fn on_circle(sewing: &Sewing, bite: &Bite, degrees: f64) -> Vec3 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let aside = along(bite.centre, cos * sewing.radius_m, bite.axes[0]);
    along(aside, sin * sewing.radius_m, bite.axes[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the plain scene says something else, this one says its own.
    #[test]
    fn it_has_a_thread_of_its_own_and_a_third_hand() {
        let text = tightened();
        for (what, count) in [
            ("tightened bite by bite", 1),
            ("pulled after every bite", 1),
            ("friction = 0.1", 1),
            ("[[thread]]", 1),
            ("[[tissue_contact]]", 1),
            ("end = \"head\", tool = 3", 12),
            ("end = \"head\", tool = 0", 1),
            ("end = \"tail\"", 1),
            ("id = 3\n", 1),
            ("[hand]", 1),
        ] {
            assert_eq!(text.matches(what).count(), count, "{what}");
        }
    }

    /// On the outer walls.
    #[test]
    fn punctures_are_where_the_bites_begin_and_end() {
        let sewing = tubes::sewing(PUNCTURES);
        let is_on =
            |tube: &tubes::Tube, x: Vec3| (x[0].hypot(x[1]) - tube.radii_m[1]).abs() < 1e-12;
        for (index, bite) in sewing.bites.iter().take(12).enumerate() {
            let [upper, lower] = if index % 2 == 0 {
                [enters_m(&sewing, bite), leaves_m(&sewing, bite)]
            } else {
                [leaves_m(&sewing, bite), enters_m(&sewing, bite)]
            };
            assert!(is_on(&tubes::UPPER, upper) && upper[2] > 0.003, "{upper:?}");
            assert!(
                is_on(&tubes::LOWER, lower) && lower[2] < -0.003,
                "{lower:?}"
            );
        }
    }
}
