//! Needles that fall where nobody holds them: rigid bodies with the scene's gravity.
//!
//! Entry points: [`NeedleState::fall`] before a step's way, [`NeedleState::fell`] once a step is done; in between they
//! [give way](super::Yielding). A step is one of implicit Euler: with the pose that the needle would have without forces, `x* = x + h v + h^2 g`, and its mass
//! m, forces F take it to `x* + h^2 F / m`; the same of its turn about the centre of mass, with a bar's m L^2 / 12 about every axis. In the
//! compliance it gives way by h^2 / m, beside which tissue is stiff: what lies on it or hangs in it does so in the first step, and bounces
//! are not rendered.

use super::model::NeedlePart;
use super::state::{NeedleState, Tip};
use crate::step::{Balance, about};
use nalgebra::{Isometry3, Vector3, Vector6};
use serde::Serialize;

/// Longest step in which one falls \[s\]: while a host stands still, a needle does, too.
pub(crate) const LONGEST_FALL_S: f64 = 0.05;
/// Pieces of its way, and of its body's near what that may meet, that one falls in a step at most. More would have hands fall behind.
const MOST_PIECES: f64 = 4.0;
const MOST_BODY_PIECES: f64 = 8.0;
/// Furthest turn in a step \[rad\].
const MOST_TURN: f64 = 0.4;
/// Times that a thread draws a needle back, each of which leaves the square of what it turns.
const PULLS: u32 = 4;
/// Places on its curve whose mean is its centre.
const PLACES: u32 = 16;

/// How a needle that nobody holds moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Fall {
    /// Of its centre of mass \[m/s\].
    velocity: Vector3<f64>,
    /// About that \[rad/s\].
    spin: Vector3<f64>,
}

impl Fall {
    /// Whether it rests.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl NeedlePart {
    /// Where its centre of mass is at `pose` \[m\].
    pub(super) fn centre(&self, pose: &Isometry3<f64>) -> Vector3<f64> {
        let curve = self.needle.at(pose);
        let place = |index: u32| (f64::from(index) + 0.5) / f64::from(PLACES) * curve.length;
        (0..PLACES)
            .map(|index| curve.at(place(index)))
            .sum::<Vector3<f64>>()
            / f64::from(PLACES)
    }

    /// What takes it along and about each axis by one in a step \[N/m, N m/rad\]; nothing of one that does not fall.
    pub(super) fn inertia(&self, step_s: f64) -> Option<Vector6<f64>> {
        let length_m = self.needle.shape.length_m();
        let mass_kg = self.weight?.density_kg_per_m3 * self.needle.tip_area_m2() * length_m;
        let along = mass_kg / (step_s * step_s);
        let about = along * length_m * length_m / 12.0;
        Some(Vector6::new(along, along, along, about, about, about))
    }
}

impl NeedleState {
    /// Whether it falls in this step: it has a weight, and nobody holds it.
    pub fn falls(&self, part: &NeedlePart) -> bool {
        part.weight.is_some() && self.grip.is_none()
    }

    /// Whether something bears it, so that its way is not that of its fall.
    fn is_borne(&self) -> bool {
        let is_out = matches!(self.tip, Tip::Outside | Tip::Waiting);
        !(self.holds.is_empty() && is_out) || self.touches.iter().any(|touch| touch.presses())
    }

    /// Where it is after a step of `step_s`, without forces, if it falls. What is let go falls from rest.
    /// Near what its body may meet it goes by smaller pieces.
    pub fn fall(
        &self,
        part: &NeedlePart,
        step_s: f64,
        (piece_m, is_near): (f64, bool),
    ) -> Option<Isometry3<f64>> {
        let weight = part.weight.filter(|_| self.falls(part) && step_s > 0.0)?;
        let gained = Vector3::from(weight.gravity_m_per_s2) * step_s;
        let shift = (self.fall.velocity + gained) * step_s;
        let turn = self.fall.spin * step_s;
        let most_m = match part.body && is_near {
            true => MOST_BODY_PIECES * part.body_piece_m(),
            false => MOST_PIECES * piece_m,
        };
        let arm = 0.5 * turn.norm() * part.needle.shape.length_m();
        let far = (shift.norm() + arm) / most_m;
        let slower = far.max(turn.norm() / MOST_TURN).max(1.0).recip();
        let centre = part.centre(&self.pose);
        let mut pose = about(&centre, &(shift * slower), &(turn * slower)) * self.pose;
        // Products of rotations drift.
        pose.rotation.renormalize();
        Some(pose)
    }

    /// The longest way of any of its parts in a step of `step_s`, by which its pieces go \[m\]: what bears it has it stay.
    pub fn falls_by(&self, part: &NeedlePart, to: &Isometry3<f64>, step_s: f64) -> f64 {
        let length_m = part.needle.shape.length_m();
        if self.is_borne() {
            let speed = self.fall.velocity.norm() + 0.5 * self.fall.spin.norm() * length_m;
            return speed * step_s;
        }
        let (from, to) = (part.needle.at(&self.pose), part.needle.at(to));
        let ways = [0.0, 0.5, 1.0]
            .map(|along| (to.at(along * length_m) - from.at(along * length_m)).norm());
        ways.into_iter().fold(0.0, f64::max)
    }

    /// It has fallen from `from` in `step_s`, or is held.
    pub fn fell(&mut self, part: &NeedlePart, from: &Isometry3<f64>, step_s: f64) {
        if !self.falls(part) {
            self.fall = Fall::default();
        } else if step_s > 0.0 {
            let [before, after] = [from, &self.pose].map(|pose| part.centre(pose));
            let turn = (self.pose.rotation * from.rotation.inverse()).scaled_axis();
            self.fall = Fall {
                velocity: (after - before) / step_s,
                spin: turn / step_s,
            };
        }
    }
}

impl Balance<'_> {
    /// Where a needle that falls to `free` comes to when its thread is too short for that: it is drawn back along the thread, which
    /// bears it and hands on nothing of its weight, and swings.
    pub(crate) fn on_leash(&self, needle: usize, free: &Isometry3<f64>) -> Isometry3<f64> {
        let Some((at, length_m)) = self.leash(needle) else {
            return *free;
        };
        let part = &self.sources.needles[needle];
        let size_m = part.needle.shape.length_m();
        let turns_by = 12.0 / (size_m * size_m);
        let mut pose = *free;
        for _ in 0..PULLS {
            let (centre, end) = (part.centre(&pose), part.needle.at(&pose).start);
            let far_m = (end - at).norm();
            if far_m <= length_m || far_m == 0.0 {
                break;
            }
            let along = (end - at) / far_m;
            let arm = (end - centre).cross(&along);
            let pull = (far_m - length_m) / (1.0 + turns_by * arm.norm_squared());
            pose = about(&centre, &(along * -pull), &(arm * (-pull * turns_by))) * pose;
        }
        pose.rotation.renormalize();
        pose
    }
}
