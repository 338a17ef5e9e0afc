//! A thread between two frames of the host: its tension follows the grip, and it goes slack and taut by itself.
//!
//! Entry point: [`LocalThread::correction`] every tick. The tension is `max(0, T0 + k (way - slack))` with the way of
//! the grip against the direction of pull; there is nothing to remember, so that a new frame takes the old one's
//! place as it is.

use crate::math::{clamp, max, min};
use crate::wire::ValidThread;
use crate::wire::message::Tension;
use crate::wire::validate::MAX_WRENCH;

/// The thread in the grip, as one frame has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalThread {
    solved_us: u64,
    direction: [f32; 3],
    tension_n: f32,
    stiffness_n_per_m: f32,
    slack_m: f32,
    /// Whether the frame's wrench and tangent have it.
    pulls: bool,
}

impl LocalThread {
    /// The thread of a frame.
    pub fn new(frame: &ValidThread) -> Self {
        let body = frame.body();
        LocalThread {
            solved_us: frame.console_time_us(),
            direction: body.direction,
            tension_n: body.tension_n,
            stiffness_n_per_m: body.stiffness_n_per_m,
            slack_m: body.slack_m,
            pulls: body.state != Tension::Slack,
        }
    }

    /// Stiffness along its pull that a thread that becomes taut has, and the frame's tangent has not \[N/m\].
    pub(super) fn lacking_n_per_m(&self) -> f32 {
        if self.pulls {
            0.0
        } else {
            self.stiffness_n_per_m
        }
    }

    /// Console time of the state that was solved for \[us\].
    pub fn solved_us(&self) -> u64 {
        self.solved_us
    }

    /// Tension \[N\] where the grip has moved by `dx` \[m, rad\], (6), from the frame's pose.
    pub fn tension_n(&self, dx: &[f32; 6]) -> f32 {
        min(max(self.linear_n(dx), 0.0), MAX_WRENCH)
    }

    /// What the wrench that is linear in the grip's motion lacks, (6) \[N, N m\]: what would push once the thread is
    /// slack, and the pull of one that becomes taut.
    pub fn correction(&self, dx: &[f32; 6]) -> [f32; 6] {
        let linear = if self.pulls { self.linear_n(dx) } else { 0.0 };
        let lacking = self.tension_n(dx) - linear;
        if !lacking.is_finite() {
            return [0.0; 6];
        }
        let lacking = clamp(lacking, -MAX_LACKING, MAX_LACKING);
        let [x, y, z] = self.direction.map(|part| part * lacking);
        [x, y, z, 0.0, 0.0, 0.0]
    }

    /// Below zero where it is slack.
    fn linear_n(&self, dx: &[f32; 6]) -> f32 {
        let [x, y, z, ..] = *dx;
        let [a, b, c] = self.direction;
        let way = -(a * x + b * y + c * z);
        self.tension_n + self.stiffness_n_per_m * (way - self.slack_m)
    }
}

/// More than any wrench that is linear in a motion of 20 m could lack \[N\].
const MAX_LACKING: f32 = 1e9;
