//! Two slabs beside each other, drawn together by a running suture.
//!
//! Entry point: [`wound`]. Every bite goes into the left slab from above, across the gap, and out of the right one;
//! above, the thread goes back over the gap to the next bite.

use super::stitch::{Bite, Sewing, Stop};
use super::turn::{Vec3, along};
use super::write;

/// Along x, y, z \[m\].
const SIZE_M: [f64; 3] = [0.02, 0.03, 0.01];
pub(super) const DIVISIONS: [u32; 3] = [8, 12, 4];
pub(super) const GAP_M: f64 = 0.004;

/// Half a circle, whose centre goes along above the gap.
pub(super) const NEEDLE_RADIUS_M: f64 = 0.008;
const NEEDLE_DEG: f64 = 180.0;
/// From how far scripted hands take it \[m\]: they turn about the circle's centre.
pub(super) const REACH_M: f64 = 0.01;
pub(super) const CENTRE_Z_M: f64 = 0.002;
/// Between the tip and the tissue when a bite begins, and between the needle's end and the tissue when it has ended
/// \[degree\].
const CLEAR_DEG: f64 = 10.0;
/// Where bites are along the gap \[m\]: beside the mesh's lines, which are 2.5 mm apart.
const BITES_M: [f64; 4] = [-0.0091, -0.0029, 0.0033, 0.0094];

const THREAD_M: f64 = 0.3;
const PULL_S: f64 = 3.0;
/// By how much each end of the thread is pulled away \[m\].
const PULL_M: f64 = 0.022;

const X: Vec3 = [1.0, 0.0, 0.0];
const Z: Vec3 = [0.0, 0.0, 1.0];

/// Angle on the needle's circle, from x towards z, where it leaves the right slab's top \[degree\].
fn leaves_deg() -> f64 {
    360.0 - (CENTRE_Z_M / NEEDLE_RADIUS_M).asin().to_degrees()
}

pub(super) fn sewing() -> Sewing {
    let leaves = leaves_deg();
    let bites = BITES_M.map(|y| Bite {
        centre: [0.0, y, CENTRE_Z_M],
        axes: [X, Z],
        // Into the left slab on the other side.
        tip_deg: [540.0 - leaves - CLEAR_DEG, leaves + NEEDLE_DEG + CLEAR_DEG],
        seconds: 1.2,
        aside: [0.0, 0.0, 0.01],
        way_s: 0.5,
    });
    Sewing {
        radius_m: NEEDLE_RADIUS_M,
        angle_deg: NEEDLE_DEG,
        thickness_m: 0.0006,
        begin_s: 0.1,
        bites: bites.to_vec(),
        pulls: Vec::new(),
        pull_s: 0.0,
    }
}

/// Both slabs, what they are made of, and what holds them.
pub(super) fn tissue(text: &mut String, divisions: [u32; 3]) {
    let aside = 0.5 * (SIZE_M[0] + GAP_M);
    for (name, x) in [("left", -aside), ("right", aside)] {
        text.push_str(&format!(
            "[[mesh.part]]
name = \"{name}\"
slab = {{ size_m = {SIZE_M:?}, divisions = {divisions:?} }}
at_m = [{x:.4}, 0.0, 0.0]

"
        ));
    }
    text.push_str(
        "[tissue]
model = \"linear\"
# Like muscle.
youngs_modulus_pa = 30e3
poisson_ratio = 0.45

# 0.14 N to break through with a tip of 0.28 mm^2. The needle does not rub.
[tissue.needle]
friction_n_per_m = 0.0
puncture_pa = 5e5

# Held at the sides that look away from the wound.
",
    );
    let end = 0.5 * GAP_M + SIZE_M[0];
    for x in [-end, end] {
        text.push_str(&format!(
            "[[fixed]]\nplane = {{ axis = \"x\", at_m = {x:.4} }}\n\n"
        ));
    }
}

/// What closes.
pub(super) fn contact(text: &mut String) {
    text.push_str(&format!(
        "# What closes.
[[tissue_contact]]
between = [\"left\", \"right\"]
# As deep as the thread goes.
rims = [
  {{ box = {{ min_m = [-{half:?}, -{y:?}, -{depth:?}], max_m = [-{half:?}, {y:?}, 0.0] }} }},
  {{ box = {{ min_m = [{half:?}, -{y:?}, -{depth:?}], max_m = [{half:?}, {y:?}, 0.0] }} }},
]

",
        half = 0.5 * GAP_M,
        y = 0.5 * SIZE_M[1],
        depth = NEEDLE_RADIUS_M - CENTRE_Z_M,
    ));
}

/// The scene.
pub fn wound() -> String {
    let sewing = sewing();
    let script = sewing.script();
    let [round, mut carry] = script.stops;
    let sewn_s = script.ends_s.last().copied().unwrap_or(0.0);
    let pull_s = sewn_s + 0.1;
    let mut holds: Vec<(f64, u8)> = Vec::new();
    for (time_s, hand) in script.holds {
        holds.push((time_s, [1, 2][hand]));
    }
    holds.push((pull_s - 0.05, 0));
    let last = &sewing.bites[BITES_M.len() - 1];
    let head = sewing.end_after(last);
    // Up and away from the gap.
    let (left, right) = ([-0.6, 0.0, 0.8], [0.6, 0.0, 0.8]);
    let tail = along([-0.008, BITES_M[0], 0.0], 0.008, left);
    let rest = |time_s, position_m| Stop {
        time_s,
        position_m,
        rotation_deg: [0.0; 3],
    };
    carry.push(rest(sewn_s, tail));
    carry.push(rest(pull_s, tail));
    carry.push(rest(pull_s + PULL_S, along(tail, PULL_M, left)));
    let seconds = (10.0 * (pull_s + PULL_S + 0.2)).ceil() / 10.0;
    let punctures = 4 * BITES_M.len();
    let mut text = format!(
        "# A wound between two slabs is sewn with a running suture: {punctures} punctures, then both ends of the thread are
# pulled until the slabs meet.
#
# World frame: z up. The slabs' tops are at z = 0, the gap of {:.0} mm between them is along y. A half-circle needle
# goes round its centre above the gap, into the left slab and out of the right one. Two hands take turns: one goes
# round with the needle, the other one carries it to the next bite. At the end the console takes the needle, and
# the second hand the thread's tail.
#
# Written by `cargo xtask scenes`: change it there.

name = \"A wound between two slabs\"
seconds = {seconds:.1}
device = \"cartesian-bench\"

",
        1e3 * GAP_M
    );
    tissue(&mut text, DIVISIONS);
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
    let pulled = along(head, PULL_M, right);
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

    /// As of the tubes: in the open the needle does not go through tissue.
    #[test]
    fn in_the_open_the_needle_stays_clear_of_the_slabs() {
        let ways = sewing().in_the_open(60, 60);
        assert_eq!(ways.len(), BITES_M.len() - 1);
        for x in ways.into_iter().flatten() {
            let beyond = x[0].abs() - (0.5 * GAP_M + SIZE_M[0]);
            let apart = x[2].max(0.5 * GAP_M - x[0].abs()).max(beyond);
            assert!(apart > 0.4e-3, "{x:?}: {apart} m");
        }
    }
}
