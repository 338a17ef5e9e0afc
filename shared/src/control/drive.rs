//! From joint efforts to motor currents that cannot hurt anybody: effort limits, then slew limits.
//!
//! Entry points: [`Drive::command`], [`Drive::let_down`], [`Drive::off`].

use super::TICK_S;
use crate::device::{DeviceDescription, JOINTS};
use crate::math::{clamp, max, min};

/// What goes to the motors in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Command {
    /// Currents \[A\], (3).
    pub current_a: [f32; JOINTS],
    /// Part of the contact effort that the motors have room for, 0 to 1.
    pub share: f32,
    /// Efforts of the contact in these currents, after the slew limit, (3).
    pub contact: [f32; JOINTS],
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
    /// What of it carries the weight \[A\].
    weight_a: f32,
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
                weight_a: 0.0,
            }
        });
        Drive { motors }
    }

    /// No current, at once.
    pub fn off(&mut self) {
        for motor in &mut self.motors {
            (motor.current_a, motor.weight_a) = (0.0, 0.0);
        }
    }

    /// Whether any motor carries a part of the weight.
    pub fn carries(&self) -> bool {
        self.motors.iter().any(|motor| motor.weight_a != 0.0)
    }

    /// Currents without any contact, at once, and with so much of the weight that was carried last, whatever the pose is now.
    pub fn let_down(&mut self, part: f32) -> [f32; JOINTS] {
        for motor in &mut self.motors {
            motor.weight_a *= part;
            motor.current_a = motor.weight_a;
        }
        self.motors.map(|motor| motor.current_a)
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
        let mut given = [0.0; JOINTS];
        let efforts = weight.iter().zip(contact);
        let outputs = current_a.iter_mut().zip(&mut given);
        for ((motor, (weight, contact)), (out, given)) in
            self.motors.iter_mut().zip(efforts).zip(outputs)
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
            // What the slew limit keeps back is the contact's before it is the weight's.
            let effort = motor.current_a / motor.amp_per_effort - weight * carried;
            let whole = contact * share;
            *given = clamp(effort, min(whole, 0.0), max(whole, 0.0));
            let whole_a = weight * carried * motor.amp_per_effort;
            let rest_a = motor.current_a - *given * motor.amp_per_effort;
            motor.weight_a = clamp(rest_a, min(whole_a, 0.0), max(whole_a, 0.0));
        }
        Some(Command {
            current_a,
            share,
            contact: given,
        })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Joint, Kinematics};

    /// Three equal motors of 2 N/A, 3 A: 6 N each; the slew limit lets everything through in one tick.
    fn drive(effort_per_amp: f32, max_slew_per_s: f32) -> Drive {
        let joint = Joint {
            counts_per_unit: 1e5,
            zero_counts: 0,
            effort_per_amp,
            max_current_a: 3.0,
            max_slew_per_s,
            max_speed_per_s: 1.0,
            inertia: 0.1,
            damping: 0.0,
            coulomb: 0.0,
        };
        Drive::new(&DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 100.0,
            max_power_w: 1e3,
            max_grip_speed_m_per_s: 10.0,
            actuation_delay_us: 0,
        })
    }

    const AT_ONCE: f32 = 1e6;

    #[test]
    fn the_contact_gives_way_to_the_weight_and_keeps_its_direction() {
        // Of 6 N on joint 2, the weight takes 4 N: 2 N of the wanted 8 N remain, a quarter, of all joints.
        let command = drive(2.0, AT_ONCE).command(&[0.0, 0.0, 4.0], &[4.0, -2.0, 8.0]);
        let expected = Command {
            current_a: [0.5, -0.25, 3.0],
            share: 0.25,
            contact: [1.0, -0.5, 2.0],
        };
        assert_eq!(command, Some(expected));
        // Against the weight there is room for 10 N.
        let command = drive(2.0, AT_ONCE).command(&[0.0, 0.0, 4.0], &[0.0, 0.0, -8.0]);
        let expected = Command {
            current_a: [0.0, 0.0, -2.0],
            share: 1.0,
            contact: [0.0, 0.0, -8.0],
        };
        assert_eq!(command, Some(expected));
    }

    #[test]
    fn a_weight_beyond_the_motors_leaves_nothing_for_the_contact() {
        let command = drive(2.0, AT_ONCE).command(&[0.0, 6.0, 12.0], &[1.0, 0.0, 1.0]);
        let expected = Command {
            current_a: [0.0, 1.5, 3.0],
            share: 0.0,
            contact: [0.0; 3],
        };
        assert_eq!(command, Some(expected));
    }

    #[test]
    fn current_grows_at_most_at_the_slew_limit_and_stops_at_once() {
        // 2000 N/s and -2 N/A: 1 A in 1 ms, of the other sign.
        let mut drive = drive(-2.0, 2000.0);
        for expected in [-1.0, -2.0, -2.5, -2.5] {
            let command = drive.command(&[0.0; 3], &[5.0, 0.0, 0.0]);
            assert_eq!(command.map(|c| c.current_a), Some([expected, 0.0, 0.0]));
        }
        drive.off();
        let command = drive.command(&[0.0; 3], &[0.0; 3]);
        assert_eq!(command.map(|c| c.current_a), Some([0.0; 3]));
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
            let mut drive = drive(2.0, AT_ONCE);
            assert_eq!(drive.command(&[0.0, bad, 0.0], &[0.0; 3]), None);
            assert_eq!(drive.command(&[0.0; 3], &[bad, 0.0, 0.0]), None);
        }
    }
}
