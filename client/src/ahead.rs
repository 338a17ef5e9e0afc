//! Where a contact is to be solved for: across its normal where the grip will be while the console uses the frame, along it
//! where the grip was.
//!
//! Entry points: [`Lead::pose`] for a simulator of your own, [`Lead::lead_s`] and [`sideways`] for the parts of it. A tool
//! that moves along a surface turns its normals and meets other parts of it, which a tangent has to first order only: an error that
//! grows with the square of the way from the pose that was solved for, and is a fourth of it in the middle. Along the
//! normal a tangent goes as far as the tissue is linear, and a hand turns back at once.

use crate::Pose;
use std::time::Duration;

/// Longest time to look ahead \[s\]: beyond that a hand has turned.
pub const LONGEST_S: f64 = 0.1;
/// As fast as a hand sets out \[m/s^2\]: one that goes 30 cm in half a second, as smoothly as hands do, reaches 7 (Flash and
/// Hogan 1985).
const SETS_OUT_M_PER_S2: f64 = 10.0;
/// Frames of which the usual delay is told: one that stalled is no use for the next.
const FRAMES: usize = 3;

/// In which time from its state on a frame is usually used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lead {
    /// Until the middle of that time, of the last frames, the newest first \[s\]; how many there are.
    leads_s: [f64; FRAMES],
    count: usize,
    /// Sequence of the newest of them.
    sequence: u32,
}

impl Lead {
    /// Nothing has come into use yet.
    pub const fn new() -> Self {
        Lead {
            leads_s: [0.0; FRAMES],
            count: 0,
            sequence: 0,
        }
    }

    /// From a state to the middle of the time in which the console will use what is solved for it \[s\]: as late as frames
    /// are when they come, and half of the time between two, `period_s`; what is usual of that, and 0 before the first.
    /// `contact_sequence` and `applied_age_us` are the state's.
    pub fn lead_s(&mut self, contact_sequence: u32, applied_age_us: u32, period_s: f64) -> f64 {
        if contact_sequence == 0 {
            *self = Lead::new();
            return 0.0;
        }
        if contact_sequence != self.sequence {
            self.sequence = contact_sequence;
            let lead_s = f64::from(applied_age_us) * 1e-6 + 0.5 * period_s;
            self.leads_s.rotate_right(1);
            self.leads_s[0] = lead_s.clamp(0.0, LONGEST_S);
            self.count = (self.count + 1).min(FRAMES);
        }
        let mut known = self.leads_s;
        let known = known.get_mut(..self.count).unwrap_or_default();
        known.sort_by(f64::total_cmp);
        let middle = known.len().saturating_sub(1) / 2;
        known.get(middle).copied().unwrap_or(0.0)
    }

    /// The pose to solve a contact for, and to send it with: `pose` after the usual delay and half a `period` of your solver, across
    /// the normal of the contact that there was last. Without one, (0, 0, 0), it is `pose`.
    pub fn pose(&mut self, pose: &Pose, normal: [f32; 3], period: Duration) -> Pose {
        let (sequence, age_us) = (pose.contact_sequence, pose.applied_age_us);
        let lead_s = self.lead_s(sequence, age_us, period.as_secs_f64());
        let touches = normal.iter().any(|n| *n != 0.0);
        let lead_s = if touches { lead_s } else { 0.0 };
        let (position, velocity) = (pose.position_m, pose.velocity_m_per_s);
        Pose {
            position_m: sideways(position, velocity, &normal.map(f64::from), lead_s),
            ..*pose
        }
    }
}

/// Place of a grip \[m\], (3), that moves at this velocity \[m/s\], (3), after `lead_s` across `normal`, of length 1. What is not
/// finite moves nothing.
pub fn sideways(
    position_m: [f32; 3],
    velocity_m_per_s: [f32; 3],
    normal: &[f64; 3],
    lead_s: f64,
) -> [f32; 3] {
    let velocity = velocity_m_per_s.map(f64::from);
    let pairs = velocity.iter().zip(normal);
    let along: f64 = pairs.map(|(v, n)| v * n).sum();
    let mut place_m = position_m;
    for (at, (v, n)) in place_m.iter_mut().zip(velocity.iter().zip(normal)) {
        let across = (v - along * n) * lead_s;
        if across.is_finite() {
            *at += across as f32;
        }
    }
    place_m
}

/// Way that a hand may go in any direction, besides what its velocity takes it, while a frame is in use that was solved
/// `ahead_s` before \[m\].
pub fn reach_m(ahead_s: f64) -> f64 {
    let ahead_s = ahead_s.clamp(0.0, LONGEST_S);
    0.5 * SETS_OUT_M_PER_S2 * ahead_s * ahead_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_delay_counts_and_no_single_stall() {
        let mut lead = Lead::new();
        assert_eq!(lead.lead_s(0, u32::MAX, 0.016), 0.0);
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found}");
        near(lead.lead_s(1, 20_000, 0.016), 0.028);
        near(lead.lead_s(2, 18_000, 0.016), 0.026);
        near(lead.lead_s(3, 110_000, 0.12), 0.028);
        // The same frame tells nothing new.
        near(lead.lead_s(3, 110_000, 0.12), 0.028);
        near(lead.lead_s(4, 110_000, 0.12), LONGEST_S);
        // A new session knows nothing.
        assert_eq!(lead.lead_s(0, u32::MAX, 0.016), 0.0);
        near(lead.lead_s(1, 10_000, 0.01), 0.015);
    }

    #[test]
    fn only_what_moves_across_the_normal_is_solved_ahead() {
        let normal = [0.0, 0.6, 0.8];
        let here = [0.1, 0.2, 0.3];
        // Into the tissue, and along it.
        assert_eq!(sideways(here, [0.0, -0.06, -0.08], &normal, 0.02), here);
        let there = sideways(here, [0.1, 0.08, -0.06], &normal, 0.02);
        for (found, expected) in there.iter().zip([0.102, 0.2016, 0.2988]) {
            assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        }
        assert_eq!(sideways(here, [f32::NAN, 0.0, 0.0], &normal, 0.02), here);
    }
}
