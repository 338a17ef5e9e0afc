//! Two tubes end to end, sewn together by one thread: an anastomosis.
//!
//! Entry point: [`anastomosis`]. The thread zigzags: into the upper tube from outside, out of its cut end, into that of
//! the lower one and out of its side, into that at the next angle, and back. Between the cut ends it bridges the
//! gap, outside it runs along one tube.

use super::stitch::{Bite, Sewing, Stop};
use super::turn::{Vec3, along};
use super::write;

/// Inner and outer radius, lower and upper end \[m\].
pub(super) struct Tube {
    pub radii_m: [f64; 2],
    ends_m: [f64; 2],
    divisions: [u32; 3],
}

pub(super) const UPPER: Tube = Tube {
    radii_m: [0.008, 0.011],
    ends_m: [0.002, 0.032],
    divisions: [2, 30, 8],
};
pub(super) const LOWER: Tube = Tube {
    radii_m: [0.009, 0.012],
    ends_m: [-0.030, -0.002],
    divisions: [2, 32, 8],
};

/// Half a circle.
pub(super) const NEEDLE_RADIUS_M: f64 = 0.0061;
const NEEDLE_DEG: f64 = 180.0;
/// From how far scripted hands take it \[m\]: they turn about the circle's centre.
pub(super) const REACH_M: f64 = 0.008;
/// Distance of its circle's centre from the tubes' axis, and height \[m\]: it goes into a tube's outside 2 mm from its
/// end and comes out of the cut, and half a circle fits outside both tubes.
pub(super) const CENTRE_M: [f64; 2] = [0.0155, 0.0001];
/// The same for a bite into the outer half of the upper tube's wall.
const SHALLOW_CENTRE_M: [f64; 2] = [0.01585, 0.014];
/// Between the tip and the tissue when a bite begins, and between the needle's end and the tissue when it has ended
/// \[degree\].
const CLEAR_DEG: f64 = 7.0;
/// The thread's length \[m\].
pub(super) const THREAD_M: f64 = 0.6;
/// Punctures of a bite through both tubes.
const BITE: u32 = 4;

/// When the needle's end is pulled away \[s\], and for how long.
const BEGIN_S: f64 = 0.1;
pub(super) const PULL_S: f64 = 3.6;
/// By how much the thread's ends are pulled away \[m\].
const PULL_M: f64 = 0.0556;
const LONG_PULL_M: f64 = 0.0942;

/// Angle on the needle's circle \[degree\], from radially outwards towards +z, of its crossing with a cylinder about
/// the tubes' axis.
pub(super) fn crossing_deg(centre_m: [f64; 2], radius_m: f64, above: bool) -> f64 {
    let cos = (radius_m - centre_m[0]) / NEEDLE_RADIUS_M;
    let degrees = cos.acos().to_degrees();
    if above { degrees } else { 360.0 - degrees }
}

fn outwards(angle: f64) -> Vec3 {
    [angle.cos(), angle.sin(), 0.0]
}

/// Round the tube, and along it away from the gap: a pull outwards would dent it where the thread goes in.
fn aside(out: Vec3, sense: f64) -> Vec3 {
    let round = [-out[1], out[0], 0.0].map(|v| sense * v);
    along(round.map(|v| 0.6 * v), -0.8 * sense, [0.0, 0.0, 1.0])
}

/// Across the gap, as for a knot: what pulls an end that comes out of one tube towards the other closes the bite beside it.
fn across(out: Vec3, sense: f64) -> Vec3 {
    let round = [-out[1], out[0], 0.0];
    let parts = [0.10, sense * 0.40, sense * 0.91];
    let outwards = along(round.map(|v| parts[1] * v), parts[0], out);
    along(outwards, parts[2], [0.0, 0.0, 1.0])
}

/// How far the thread's ends are pulled away \[m\], and in which direction.
fn pull(punctures: u32) -> (f64, fn(Vec3, f64) -> Vec3) {
    // After an odd number of bites through both tubes the ends come out of different ones.
    let whole = punctures / BITE;
    if punctures.is_multiple_of(BITE) && !whole.is_multiple_of(2) {
        (PULL_M, across)
    } else {
        (LONG_PULL_M, aside)
    }
}

/// The needle's way for so many punctures: an even number.
pub(super) fn sewing(punctures: u32) -> Sewing {
    let whole = punctures / BITE;
    let count = punctures.div_ceil(BITE);
    // Beside the mesh's lines, which are at multiples of 12 and of 11.25 degrees.
    let angle = |bite: u32| std::f64::consts::TAU * f64::from(bite) / f64::from(count) + 0.06;
    let above = crossing_deg(CENTRE_M, UPPER.radii_m[1], true);
    let below = crossing_deg(CENTRE_M, LOWER.radii_m[1], false);
    let shallow = |above| crossing_deg(SHALLOW_CENTRE_M, UPPER.radii_m[1], above);
    let bites = (0..count).map(|index| {
        let (centre_m, tip_deg, seconds) = if index == whole {
            // What is left is two punctures: in and out of one wall from outside.
            let after = shallow(false) + NEEDLE_DEG + CLEAR_DEG;
            (SHALLOW_CENTRE_M, [shallow(true) - CLEAR_DEG, after], 0.8)
        } else if index % 2 == 0 {
            let after = below + NEEDLE_DEG + CLEAR_DEG;
            (CENTRE_M, [above - CLEAR_DEG, after], 0.85)
        } else {
            let after = above - NEEDLE_DEG - CLEAR_DEG;
            (CENTRE_M, [below + CLEAR_DEG, after], 0.85)
        };
        let out = outwards(angle(index));
        let aside = outwards(angle(index) + 0.5 * (angle(1) - angle(0)));
        let (far_m, way_s) = if count > 8 {
            (0.008, 0.34)
        } else {
            (0.02, 0.6)
        };
        Bite {
            centre: along(out.map(|v| centre_m[0] * v), centre_m[1], [0.0, 0.0, 1.0]),
            axes: [out, [0.0, 0.0, 1.0]],
            tip_deg,
            seconds,
            aside: aside.map(|v| far_m * v),
            way_s,
        }
    });
    Sewing {
        radius_m: NEEDLE_RADIUS_M,
        angle_deg: NEEDLE_DEG,
        thickness_m: 0.0006,
        begin_s: BEGIN_S,
        bites: bites.collect(),
        pulls: Vec::new(),
        pull_s: 0.0,
    }
}

/// Both tubes, what they are made of, and what holds them.
pub(super) fn tissue(text: &mut String) {
    for (name, tube) in [("upper", &UPPER), ("lower", &LOWER)] {
        let [low, high] = tube.ends_m;
        text.push_str(&format!(
            "[[mesh.part]]
name = \"{name}\"
tube = {{ radii_m = {:?}, length_m = {:.4}, divisions = {:?} }}
at_m = [0.0, 0.0, {:.4}]

",
            tube.radii_m,
            high - low,
            tube.divisions,
            0.5 * (low + high),
        ));
    }
    text.push_str(
        "[tissue]
model = \"linear\"
# Like the wall of the gut.
youngs_modulus_pa = 150e3
poisson_ratio = 0.45

# 0.28 N to break through with a tip of 0.28 mm^2. The needle does not rub.
[tissue.needle]
friction_n_per_m = 0.0
puncture_pa = 1e6

",
    );
    text.push_str("# Their far ends are held.\n");
    for end in [UPPER.ends_m[1], LOWER.ends_m[0]] {
        text.push_str(&format!(
            "[[fixed]]\nplane = {{ axis = \"z\", at_m = {end:.4} }}\n\n"
        ));
    }
}

/// What closes.
pub(super) fn contact(text: &mut String) {
    text.push_str(&format!(
        "# What closes.
[[tissue_contact]]
between = [\"upper\", \"lower\"]
rims = [
  {{ plane = {{ axis = \"z\", at_m = {:.4} }} }},
  {{ plane = {{ axis = \"z\", at_m = {:.4} }} }},
]

",
        UPPER.ends_m[0], LOWER.ends_m[1],
    ));
}

/// A scene with so many punctures.
pub fn anastomosis(punctures: u32) -> String {
    drawn(punctures, pull(punctures).0)
}

/// The same, of which the console draws the head out by so much \[m\].
pub(super) fn drawn(punctures: u32, head_m: f64) -> String {
    let sewing = sewing(punctures);
    let script = sewing.script();
    let [round, mut carry] = script.stops;
    let sewn_s = script.ends_s.last().copied().unwrap_or(0.0);
    // The console takes the needle at its end, the hand that carried it the thread's tail.
    let pull_s = sewn_s + 0.1;
    let mut holds: Vec<(f64, u8)> = Vec::new();
    for (time_s, hand) in script.holds {
        holds.push((time_s, [1, 2][hand]));
    }
    holds.push((pull_s - 0.05, 0));
    let last = sewing.bites.last();
    let head = last.map_or([0.0; 3], |bite| sewing.end_after(bite));
    let head_out = last.map_or([0.0; 3], |bite| bite.axes[0]);
    let tail_out = sewing.bites[0].axes[0];
    let (pull_m, way) = pull(punctures);
    let tail = along(tail_out.map(|v| 0.016 * v), 0.009, [0.0, 0.0, 1.0]);
    let rest = |time_s, position_m| Stop {
        time_s,
        position_m,
        rotation_deg: [0.0; 3],
    };
    carry.push(rest(sewn_s, tail));
    carry.push(rest(pull_s, tail));
    carry.push(rest(
        pull_s + PULL_S,
        along(tail, pull_m, way(tail_out, -1.0)),
    ));

    let seconds = (10.0 * (pull_s + PULL_S + 0.2)).ceil() / 10.0;
    let mut text = format!(
        "# Two tubes end to end are sewn together with one thread: {punctures} punctures, then both ends of the thread are
# pulled.
#
# World frame: z up, the tubes' common axis. A half-circle needle goes round its centre, 15.5 mm from the axis: into the
# upper tube's side, out of its cut end, into the lower one's and out of its side; at the next angle the other way
# round. Two hands take turns: one goes round with the needle, the other one carries it to the next bite. At the end the
# console takes the needle, and the second hand the thread's tail.
#
# Written by `cargo xtask scenes`: change it there.

name = \"Two tubes, {punctures} punctures\"
seconds = {seconds:.1}
device = \"cartesian-bench\"

"
    );
    tissue(&mut text);
    write::needle(&mut text, &sewing, &holds);
    text.push_str(&format!(
        "# Frictionless, and held at both ends once it has been sewn.
[[thread]]
needle = 0
length_m = {THREAD_M:?}
hold = [
  {{ time_s = {:.3}, end = \"tail\", tool = 2 }},
]
",
        pull_s - 0.05,
    ));
    contact(&mut text);
    text.push_str("# The console's own.\n[[tool]]\nid = 0\nshape = \"grip\"\n\n");
    text.push_str("# Goes round with the needle, which it holds from the circle's centre.\n");
    write::hand(&mut text, 1, REACH_M, &round);
    text.push_str("# Carries the needle to the next bite, held likewise, and pulls the tail.\n");
    write::hand(&mut text, 2, REACH_M, &carry);
    let pulled = along(head, head_m, way(head_out, 1.0));
    write::console_hand(
        &mut text,
        &[(0.0, head), (pull_s, head), (pull_s + PULL_S, pulled)],
    );
    text.push_str("[host]\nhost_hz = 200.0\nhorizon_ms = 60.0\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Signed distance from a tube's wall \[m\].
    fn apart_m(tube: &Tube, x: Vec3) -> f64 {
        let radius = x[0].hypot(x[1]);
        let aside = (tube.radii_m[0] - radius).max(radius - tube.radii_m[1]);
        let beyond = (tube.ends_m[0] - x[2]).max(x[2] - tube.ends_m[1]);
        aside.max(beyond)
    }

    /// A needle's side is nobody's business: only the tip gets into tissue. It must not go through it in the open.
    #[test]
    fn in_the_open_the_needle_stays_clear_of_the_tubes() {
        for punctures in [20, 50] {
            let ways = sewing(punctures).in_the_open(60, 60);
            assert_eq!(ways.len() as u32, punctures.div_ceil(BITE) - 1);
            for (bite, way) in ways.into_iter().enumerate() {
                let apart = |x: Vec3| apart_m(&UPPER, x).min(apart_m(&LOWER, x));
                let least = way.into_iter().map(apart).fold(f64::INFINITY, f64::min);
                assert!(least > 0.4e-3, "{punctures}, after bite {bite}: {least} m");
            }
        }
    }

    #[test]
    fn the_needle_is_not_hurried() {
        for punctures in [20, 50] {
            let [tissue, open] = sewing(punctures).speeds_m_per_s();
            assert!(tissue < 0.1 && open < 0.25, "{tissue} {open} m/s");
        }
    }
}
