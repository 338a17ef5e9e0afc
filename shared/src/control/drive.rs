//! From joint efforts to motor currents that cannot hurt anybody: effort limits, then slew limits.
//!
//! Entry points: [`Drive::command`], [`Drive::off`].

use super::TICK_S;
use crate::device::{DeviceDescription, JOINTS};
use crate::math::{clamp, min};

/// What goes to the motors in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Command {
    /// Currents \[A\], (3).
    pub current_a: [f32; JOINTS],
    /// Part of the contact effort that the motors have room for, 0 to 1.
    pub share: f32,
}

/// One motor, in terms of its current.
#[derive(Clone, Copy, Debug)]
struct Motor {
    amp_per_effort: f32,
    /// Largest effort.
    max_effort: f32,
    /// \[A\].
    max_current_a: f32,
    /// Largest change in one tick \[A\].
    max_step_a: f32,
    /// Last command \[A\].
    current_a: f32,
}

/// The motors of a console.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    motors: [Motor; JOINTS],
}

impl Drive {
    pub fn new(device: &DeviceDescription) -> Self {
        let motors = device.joints.map(|joint| {
            let amp_per_effort = 1.0 / joint.effort_per_amp;
            Motor {
                amp_per_effort,
                max_effort: joint.effort_per_amp.abs() * joint.max_current_a,
                max_current_a: joint.max_current_a,
                max_step_a: joint.max_slew_per_s * amp_per_effort.abs() * TICK_S,
                current_a: 0.0,
            }
        });
        Drive { motors }
    }

    /// No current, at once.
    pub fn off(&mut self) {
        for motor in &mut self.motors {
            motor.current_a = 0.0;
        }
    }

    /// Currents for carrying the weight, and for as much of the contact as the motors have room for:
    /// all joints alike, so that the force keeps its direction. None if a number is not finite.
    pub fn command(&mut self, weight: &[f32; JOINTS], contact: &[f32; JOINTS]) -> Option<Command> {
        let room = || self.motors.iter().zip(weight);
        let carried = room().fold(1.0, |share, (motor, &weight)| {
            min(share_within(weight, 0.0, motor.max_effort), share)
        });
        let share = room()
            .zip(contact)
            .fold(1.0, |share, ((motor, weight), &contact)| {
                min(
                    share_within(contact, weight * carried, motor.max_effort),
                    share,
                )
            });
        let mut current_a = [0.0; JOINTS];
        let efforts = weight.iter().zip(contact);
        for ((motor, (weight, contact)), out) in
            self.motors.iter_mut().zip(efforts).zip(&mut current_a)
        {
            let wanted_a = (weight * carried + contact * share) * motor.amp_per_effort;
            if !wanted_a.is_finite() {
                return None;
            }
            let step_a = clamp(
                wanted_a - motor.current_a,
                -motor.max_step_a,
                motor.max_step_a,
            );
            let next_a = motor.current_a + step_a;
            motor.current_a = clamp(next_a, -motor.max_current_a, motor.max_current_a);
            *out = motor.current_a;
        }
        Some(Command { current_a, share })
    }
}

/// Largest part of `effort`, up to all of it, that added to `base` stays within `limit`; none if `base`
/// is beyond it already.
fn share_within(effort: f32, base: f32, limit: f32) -> f32 {
    let room = if effort < 0.0 {
        limit + base
    } else {
        limit - base
    };
    if effort.abs() > room {
        clamp(room / effort.abs(), 0.0, 1.0)
    } else {
        1.0
    }
}
