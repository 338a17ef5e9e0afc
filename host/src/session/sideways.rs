//! What a contact is solved for: a place ahead across its normal ([`sutura_client::ahead`]), and how far a hand may get from there while
//! the frame is in use.
//!
//! Entry point: [`sideways`].

use sutura_client::ahead;

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
    let place_m = ahead::sideways(position_m, velocity_m_per_s, normal, lead_s);
    let mut goal = Goal {
        position_m: place_m,
        ahead_m: [0.0; 3],
    };
    for (i, ahead) in goal.ahead_m.iter_mut().enumerate() {
        let across = f64::from(place_m[i]) - f64::from(position_m[i]);
        let way = f64::from(velocity_m_per_s[i]) * ahead_s - across;
        if way.is_finite() {
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
