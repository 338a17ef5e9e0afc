//! Where a contact is solved for: across its normal where the grip will be while the console uses the frame, along it
//! where the grip was.
//!
//! Entry points: [`lead_s`], [`sideways`]. A tool that moves along the surface turns its normals and meets other vertices,
//! which rows and tangents have to first order only: an error that grows with the square of the way from the
//! pose that was solved for. Along the normal rows go as far as the tissue is linear, and a hand turns back at once.

use sutura_shared::wire::message::State;

/// As fast as a hand sets out \[m/s^2\]: one that goes 30 cm in half a second, as smoothly as hands do, reaches 7 (Flash and
/// Hogan 1985).
const SETS_OUT_M_PER_S2: f64 = 10.0;
/// Longest time to look ahead \[s\]: beyond that a hand has turned.
const LONGEST_S: f64 = 0.1;

/// From a state to the middle of the time in which the console will use what is solved for it \[s\], with frames every
/// `period_s`: as late as the frame in use was when it came, and half a period. 0 before the first.
pub fn lead_s(state: &State, period_s: f64) -> f64 {
    if state.contact_sequence == 0 {
        return 0.0;
    }
    let delay_s = f64::from(state.applied_age_us) * 1e-6;
    (delay_s + 0.5 * period_s).clamp(0.0, LONGEST_S)
}

/// Way that a hand may go in any direction, besides what its velocity takes it, while a frame is in use that was solved
/// `ahead_s` before \[m\].
pub fn reach_m(ahead_s: f64) -> f64 {
    let ahead_s = ahead_s.clamp(0.0, LONGEST_S);
    0.5 * SETS_OUT_M_PER_S2 * ahead_s * ahead_s
}

/// What a contact is solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Goal {
    /// Place of the grip \[m\], (3).
    pub position_m: [f32; 3],
    /// Way from there to where the grip may get while the frame is in use \[m\], (3).
    pub ahead_m: [f64; 3],
}

/// Of a grip that moves at this velocity \[m/s\], (3): its place after `lead_s` across `normal`, for a frame whose use ends
/// after `ahead_s`. What is not finite moves nothing.
pub fn sideways(
    position_m: [f32; 3],
    velocity_m_per_s: [f32; 3],
    normal: &[f64; 3],
    lead_s: f64,
    ahead_s: f64,
) -> Goal {
    let velocity = velocity_m_per_s.map(f64::from);
    let pairs = velocity.iter().zip(normal);
    let along: f64 = pairs.map(|(v, n)| v * n).sum();
    let mut goal = Goal {
        position_m,
        ahead_m: [0.0; 3],
    };
    let places = goal.position_m.iter_mut().zip(&mut goal.ahead_m);
    for ((at, ahead), (v, n)) in places.zip(velocity.iter().zip(normal)) {
        let across = (v - along * n) * lead_s;
        let way = v * ahead_s - across;
        if way.is_finite() {
            *at += across as f32;
            *ahead = way;
        }
    }
    goal
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_moves_across_the_normal_is_solved_ahead() {
        let normal = [0.0, 0.6, 0.8];
        let here = [0.1, 0.2, 0.3];
        let goal = |velocity| sideways(here, velocity, &normal, 0.02, 0.03);
        let near = |found: f64, expected: f64| {
            assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        };
        // Into the tissue.
        let into = goal([0.0, -0.06, -0.08]);
        assert_eq!(into.position_m, here);
        near(into.ahead_m[1], -0.0018);
        near(into.ahead_m[2], -0.0024);
        // Along it.
        let Goal {
            position_m,
            ahead_m,
        } = goal([0.1, 0.08, -0.06]);
        for ((at, ahead), (from, v)) in position_m
            .iter()
            .zip(ahead_m)
            .zip(here.iter().zip([0.1, 0.08, -0.06]))
        {
            near(f64::from(*at), f64::from(*from) + v * 0.02);
            near(ahead, v * 0.01);
        }
        let nowhere = Goal {
            position_m: here,
            ahead_m: [0.0; 3],
        };
        assert_eq!(goal([f32::NAN, 0.0, 0.0]), nowhere);
    }
}
