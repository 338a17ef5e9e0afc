//! How far the host's tangent can be believed: what it foretold from one frame to the next against what came.
//!
//! Entry points: [`Trust::learn`], [`Trust::scale`], [`Trust::confidence`]. Between two frames of one contact the force changes by
//! the mean of their tangents times the way, to third order in the way (the trapezoidal rule): a tangent that is
//! right gives a scale of 1 on non-linear tissue too, one that is wrong by a factor gives its inverse. The scale is
//! the regression of what came on what was foretold, with forgetting and a prior of 1. What the regression does not
//! explain says how little the tangent is worth the older it gets.

use super::TICK_S;
use crate::math::{Vec3, clamp, dot, max};

/// Share of what was learnt that is kept when as much new comes: half is gone after one frame that tells as
/// much as all before it.
const KEPT: f32 = 0.5;
/// Square of the force \[N^2\] whose change tells as much as the prior: the quantum of the encoder times a stiff
/// tissue is below it.
const PRIOR: f32 = 0.02 * 0.02;
/// Bounds of the scale: beyond them the frames are no measurement of one contact.
const SCALES: (f32, f32) = (0.4, 2.5);

/// The running regression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trust {
    /// Sum of foretold . foretold \[N^2\].
    foretold: f32,
    /// Sum of foretold . came \[N^2\].
    came: f32,
    /// Sum of came . came \[N^2\].
    square: f32,
    scale: f32,
    /// Square of what is not explained over what is.
    unexplained: f32,
    /// Frames a second.
    rate_hz: f32,
}

impl Trust {
    /// Nothing is known: the tangent is taken as it comes.
    pub const FULL: Trust = Trust {
        foretold: 0.0,
        came: 0.0,
        square: 0.0,
        scale: 1.0,
        unexplained: 0.0,
        rate_hz: 0.0,
    };

    /// Takes note of one change of force \[N\] in `span_s`, as foretold by the tangents and as it came.
    pub fn learn(&mut self, foretold: &Vec3, came: &Vec3, span_s: f32) {
        let (told, seen) = (dot(foretold, foretold), dot(foretold, came));
        // Frames that tell little do not push out what is known.
        let kept = 1.0 - (1.0 - KEPT) * told / (told + self.foretold + PRIOR);
        self.foretold = self.foretold * kept + told;
        self.came = self.came * kept + seen;
        self.square = self.square * kept + dot(came, came);
        let scale = (self.came + PRIOR) / (self.foretold + PRIOR);
        self.scale = clamp(scale, SCALES.0, SCALES.1);
        let explained = self.scale * self.scale * self.foretold;
        let left = self.square - self.scale * (2.0 * self.came - self.scale * self.foretold);
        self.unexplained = max(0.0, left) / (explained + PRIOR);
        self.rate_hz = 1.0 / max(span_s, TICK_S);
    }

    /// What is left of the tangent's worth at an age, 0 to 1: all of it if it has explained all changes so far, half
    /// of it one frame later if it has explained half of their square.
    pub fn confidence(&self, age_s: f32) -> f32 {
        1.0 / (1.0 + self.unexplained * age_s * self.rate_hz)
    }

    /// What the tangent is to be multiplied by.
    pub fn scale(&self) -> f32 {
        self.scale
    }
}
