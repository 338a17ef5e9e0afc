//! From one step to the next: what an implicit method makes of masses and velocities.
//!
//! Entry points: [`Motion`], [`Course::plan`], [`Course::arrive`]. Both methods solve a step of backward Euler,
//! whose solution is the least of `W(x) + m / (2 h^2) |x - x0 - h v0|^2 - f x`; the midpoint rule does so for half
//! the step and goes on as far again.

use super::newton::Balance;
use nalgebra::Vector3;

/// Whether masses count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// No masses: every step ends in balance.
    Static,
    /// Masses, lumped at nodes, and implicit steps.
    Implicit {
        /// Density at rest \[kg/m^3\].
        density_kg_per_m3: f64,
        /// Drag in proportion to mass and velocity \[1/s\]; it slows a free body by exp(-rate t).
        drag_per_s: f64,
        /// The method.
        scheme: Scheme,
    },
}

/// How time goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// First order; takes energy out of fast motion, and always has an end state.
    BackwardEuler,
    /// Second order; keeps linear and angular momentum to round-off and energy nearly, and rings where the
    /// drive jumps. A step fails if going on from its middle turns a cell inside out.
    Midpoint,
}

/// One step of an implicit method.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    step_s: f64,
    /// Where balance is sought, as a share of the step.
    pub share: f64,
    /// Weight of a mass \[1/s^2\]; zero in statics.
    pub inertia: f64,
}

impl Course {
    /// Statics: the end of the step.
    pub const STATIC: Self = Self {
        step_s: f64::INFINITY,
        share: 1.0,
        inertia: 0.0,
    };

    /// Sets the inertia of a step from `x` \[m\] with `velocity` \[m/s\].
    pub fn plan(
        scheme: Scheme,
        step_s: f64,
        drag_per_s: f64,
        x: &[Vector3<f64>],
        velocity: &[Vector3<f64>],
        balance: &mut Balance,
    ) -> Self {
        let share = match scheme {
            Scheme::BackwardEuler => 1.0,
            Scheme::Midpoint => 0.5,
        };
        let h = share * step_s;
        let drag = drag_per_s * h;
        let inertia = (1.0 + drag) / (h * h);
        balance.inertia = inertia;
        for (node, anchor) in balance.anchor.iter_mut().enumerate() {
            *anchor = x[node] + velocity[node] * (h / (1.0 + drag));
        }
        Self {
            step_s,
            share,
            inertia,
        }
    }

    /// Takes `x` and `velocity` to the end of the step, given the balance `at` its share.
    pub fn arrive(
        self,
        at: &[Vector3<f64>],
        held: &[bool],
        x: &mut [Vector3<f64>],
        velocity: &mut [Vector3<f64>],
    ) {
        for (node, at) in at.iter().enumerate() {
            let moved = (at - x[node]) / self.share;
            let mean = moved / self.step_s;
            // A held node has the velocity of its way: it must not ring.
            velocity[node] = if held[node] {
                mean
            } else {
                velocity[node] + (mean - velocity[node]) / self.share
            };
            x[node] = if self.share == 1.0 {
                *at
            } else {
                x[node] + moved
            };
        }
    }
}
