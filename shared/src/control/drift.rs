//! Tissue that moves by itself, as with breath: how fast its surface comes towards the tool, told from successive frames.
//!
//! Entry points: [`Drift::learn`] for every frame, [`Drift::tick`] every tick, [`Drift::speed`]. Between two frames the tangents foretell the
//! force by the hand's way. A surface that moves changes it by more than any tangent that is wrong by a factor, and on the same side frame after
//! frame. Its work, force times speed, is no gift of the console's: the ledger takes it for paid.

use super::TICK_S;
use crate::math::{Vec3, clamp, dot, max, min};

/// Parts of what the tangents tell between which a change is the hand's own: tangents are wrong by factors.
const WRONG: (f32, f32) = (0.5, 2.5);
/// Part of it beyond these within which a change becomes the surface's.
const BEYOND: f32 = 0.05;
/// Fastest surface that is believed \[m/s\]: breath and pulse are below it.
const FASTEST: f32 = 0.05;
/// Stiffness below which a change of force tells nothing of a surface \[N/m\].
const SOFTEST: f32 = 100.0;
/// Time within which a motion that goes on is believed \[s\]: what swings or trembles turns before.
const BELIEVED_S: f32 = 0.1;
/// Time for which the last frame tells, in times between frames.
const LASTS: f32 = 2.0;

/// Change between two frames in succession.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    /// Out of the tissue, of length 1.
    pub normal: Vec3,
    /// Change of force as the tangents tell it, and as it came \[N\].
    pub told: Vec3,
    pub came: Vec3,
    /// Stiffness along the normal \[N/m\].
    pub stiffness: f32,
    /// Way of the grip across the normal \[m\].
    pub aside_m: f32,
    /// Time between them \[s\].
    pub span_s: f32,
}

/// Motion of the surface, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Drift {
    /// Speed along the normal that has been seen for a while, and by the last frame \[m/s\].
    speed: f32,
    newest: f32,
    /// Time for which the last frame tells \[s\].
    left_s: f32,
}

impl Drift {
    /// Nothing moves by itself.
    pub const NONE: Drift = Drift {
        speed: 0.0,
        newest: 0.0,
        left_s: 0.0,
    };

    /// Takes note of what came between two frames that touch the same tissue.
    pub fn learn(&mut self, change: &Change) {
        let new = speed_of(change);
        let before = core::mem::replace(&mut self.newest, new);
        // One frame alone is a change of the tissue.
        let seen = if new * before <= 0.0 {
            0.0
        } else if new.abs() < before.abs() {
            new
        } else {
            before
        };
        self.speed += (seen - self.speed) * min(change.span_s * (1.0 / BELIEVED_S), 1.0);
        self.left_s = LASTS * change.span_s;
    }

    /// A tick has gone by.
    pub fn tick(&mut self) {
        self.left_s = max(self.left_s - TICK_S, 0.0);
    }

    /// Speed of the surface out of the tissue \[m/s\].
    pub fn speed(&self) -> f32 {
        if self.left_s > 0.0 { self.speed } else { 0.0 }
    }
}

/// Speed of the surface along the normal between two frames \[m/s\], as far as neither the hand's way nor what lies beside explains the
/// change.
fn speed_of(change: &Change) -> f32 {
    let told = dot(&change.normal, &change.told);
    let came = dot(&change.normal, &change.came);
    if change.stiffness < SOFTEST || change.span_s <= 0.0 {
        return 0.0;
    }
    let (a, b) = (told * WRONG.0, told * WRONG.1);
    let beyond = (came - clamp(came, min(a, b), max(a, b))).abs();
    if beyond <= 0.0 {
        return 0.0;
    }
    let part = min(beyond / (BEYOND * told.abs() + f32::MIN_POSITIVE), 1.0);
    let beside = change.stiffness * change.aside_m;
    let unexplained = came - told;
    let unexplained = unexplained - clamp(unexplained, -beside, beside);
    let speed = part * unexplained / (change.stiffness * change.span_s);
    clamp(speed, -FASTEST, FASTEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grip that goes by `way` \[m\] along the normal between two frames, on tissue of 500 N/m whose surface goes by `surface` \[m\].
    fn change(way: f32, surface: f32, told: f32) -> Change {
        let normal = Vec3::z();
        Change {
            normal,
            told: normal * (-500.0 * told * way),
            came: normal * (500.0 * (surface - way)),
            stiffness: 500.0 * told,
            aside_m: 0.0,
            span_s: 0.02,
        }
    }

    fn after(changes: &[Change]) -> f32 {
        let mut drift = Drift::NONE;
        changes.iter().for_each(|change| drift.learn(change));
        drift.speed()
    }

    #[test]
    fn a_surface_that_moves_is_seen_at_a_hand_that_rests_or_is_pushed() {
        for surface in [0.2e-3, -0.2e-3] {
            let moves = change(0.0, surface, 1.0);
            assert!((after(&[moves; 40]) - 50.0 * surface).abs() < 1e-5);
            // A hand that it takes along.
            let pushed = change(0.9 * surface, surface, 1.0);
            assert!((after(&[pushed; 40]) - 50.0 * surface).abs() < 1e-5);
            // One frame alone, and a surface that shakes.
            assert_eq!(after(&[moves]), 0.0);
            let shakes: [Change; 40] = core::array::from_fn(|i| {
                change(0.0, if i % 2 == 0 { surface } else { -surface }, 1.0)
            });
            assert_eq!(after(&shakes), 0.0);
        }
        assert!(after(&[change(0.0, 5e-3, 1.0); 60]) <= FASTEST);
    }

    #[test]
    fn a_hand_that_moves_is_no_surface() {
        for told in [0.4, 0.75, 1.0, 1.25, 2.0] {
            for way in [-1e-3, 1e-3] {
                assert_eq!(after(&[change(way, 0.0, told); 9]), 0.0, "{told}");
            }
        }
        let rubs = Change {
            aside_m: 0.5e-3,
            ..change(0.0, 0.3e-3, 1.0)
        };
        assert_eq!(after(&[rubs; 9]), 0.0);
    }

    #[test]
    fn what_no_frame_says_any_more_is_over() {
        let mut drift = Drift::NONE;
        (0..9).for_each(|_| drift.learn(&change(0.0, 0.2e-3, 1.0)));
        (0..39).for_each(|_| drift.tick());
        assert!(drift.speed() > 0.0);
        (0..2).for_each(|_| drift.tick());
        assert_eq!(drift.speed(), 0.0);
    }
}
