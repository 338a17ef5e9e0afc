//! Joint coordinates and velocities from encoder counts, and whether an encoder can be believed.
//!
//! Entry point: [`Encoders::read`].

use super::TICK_S;
use super::velocity::Velocity;
use crate::device::{DeviceDescription, JOINTS};

/// What the encoders say in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Joints {
    /// Coordinates \[m or rad\], (3).
    pub position: [f32; JOINTS],
    /// Filtered velocities \[m/s or rad/s\], (3).
    pub velocity: [f32; JOINTS],
    /// Change of the coordinates since the last tick, (3); 0 after a jump.
    pub moved: [f32; JOINTS],
    /// Whether a joint moved faster than the device can.
    pub jumped: bool,
}

/// One joint: constants from the description, then what evolves.
#[derive(Clone, Copy, Debug)]
struct Encoder {
    /// Reading at coordinate 0 \[counts\].
    zero_counts: i32,
    /// \[unit per count\].
    unit_per_count: f32,
    /// Largest believable change in one tick \[counts\].
    max_counts: u32,
    velocity: Velocity,
}

/// The encoders of a console.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoders {
    joints: [Encoder; JOINTS],
    /// Counts of the last tick; none at the start.
    previous: Option<[i32; JOINTS]>,
}

impl Encoders {
    pub fn new(device: &DeviceDescription) -> Self {
        let joints = device.joints.map(|joint| Encoder {
            zero_counts: joint.zero_counts,
            unit_per_count: 1.0 / joint.counts_per_unit,
            // One more for the quantisation.
            max_counts: ((joint.max_speed_per_s * TICK_S * joint.counts_per_unit.abs()) as u32)
                .saturating_add(1),
            velocity: Velocity::default(),
        });
        Encoders {
            joints,
            previous: None,
        }
    }

    /// Forgets where the joints were: the next reading is believed as it is, at velocity 0.
    pub fn restart(&mut self) {
        self.previous = None;
        for joint in &mut self.joints {
            joint.velocity = Velocity::default();
        }
    }

    /// Whether there has been a reading since the start.
    pub fn have_started(&self) -> bool {
        self.previous.is_some()
    }

    /// Takes this tick's counts, so many `ticks` after the last ones. After a jump the velocity starts again from 0.
    pub fn read(&mut self, counts: &[i32; JOINTS], ticks: u32) -> Joints {
        let previous = self.previous.unwrap_or(*counts);
        let mut position = [0.0; JOINTS];
        let mut velocity = [0.0; JOINTS];
        let mut ways = [0.0; JOINTS];
        let mut jumped = false;
        let steps = counts.iter().zip(&previous);
        let outputs = position.iter_mut().zip(&mut velocity).zip(&mut ways);
        for ((joint, (now, before)), ((q, speed), way)) in
            self.joints.iter_mut().zip(steps).zip(outputs)
        {
            *q = now.wrapping_sub(joint.zero_counts) as f32 * joint.unit_per_count;
            let moved = now.wrapping_sub(*before);
            jumped |= moved.unsigned_abs() > joint.max_counts.saturating_mul(ticks);
            for _ in 1..ticks {
                joint.velocity.coast();
            }
            *way = moved as f32 * joint.unit_per_count;
            let per_tick = joint.velocity.update(moved as f32);
            *speed = per_tick * joint.unit_per_count * (1.0 / TICK_S);
        }
        if jumped {
            self.restart();
            (velocity, ways) = ([0.0; JOINTS], [0.0; JOINTS]);
        }
        self.previous = Some(*counts);
        Joints {
            position,
            velocity,
            moved: ways,
            jumped,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Joint, Kinematics};

    /// 10 um per count, backwards on joint 1; at most 2 m/s: 200 counts in a tick, and one.
    fn encoders() -> Encoders {
        let joint = |counts_per_unit| Joint {
            counts_per_unit,
            zero_counts: 50,
            effort_per_amp: 1.0,
            max_current_a: 1.0,
            max_slew_per_s: 1.0,
            max_speed_per_s: 2.0,
            inertia: 1.0,
            damping: 0.0,
            coulomb: 0.0,
        };
        Encoders::new(&DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint(1e5), joint(-1e5), joint(1e5)],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 1.0,
            max_power_w: 1e3,
            max_grip_speed_m_per_s: 10.0,
            actuation_delay_us: 0,
        })
    }

    /// A valid description of a tiny, very fast arm: its limit is beyond what counts can tell.
    #[test]
    fn the_fastest_device_that_is_valid_has_a_limit() {
        let joint = Joint {
            counts_per_unit: 1e9,
            zero_counts: 0,
            effort_per_amp: 1.0,
            max_current_a: 1.0,
            max_slew_per_s: 1.0,
            max_speed_per_s: 1e9,
            inertia: 1.0,
            damping: 0.0,
            coulomb: 0.0,
        };
        let device = DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::SerialArm {
                shoulder_m: [0.0; 3],
                upper_m: 5e-9,
                fore_m: 5e-9,
            },
            joints: [joint; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 1.0,
            max_power_w: 1e3,
            max_grip_speed_m_per_s: 10.0,
            actuation_delay_us: 0,
        };
        assert_eq!(device.validate(), Ok(()));
        let mut encoders = Encoders::new(&device);
        encoders.read(&[0; JOINTS], 1);
        assert!(!encoders.read(&[1_000_000; JOINTS], 1).jumped);
    }

    #[test]
    fn counts_become_coordinates_from_zero_and_with_sign() {
        let joints = encoders().read(&[150, 150, 50], 1);
        assert!((joints.position[0] - 1e-3).abs() < 1e-9);
        assert!((joints.position[1] + 1e-3).abs() < 1e-9);
        assert_eq!(joints.position[2], 0.0);
        assert_eq!(joints.velocity, [0.0; 3]);
    }

    /// 0.2345 m/s is 23.45 counts a tick, read as 23 or 24: off by less than half a count a tick, which is 5 mm/s.
    #[test]
    fn a_ramp_is_measured_to_a_share_of_one_count() {
        let mut encoders = encoders();
        let mut worst = 0.0_f32;
        for tick in 0..1000 {
            let counts = (f64::from(tick) * 23.45).floor() as i32;
            let joints = encoders.read(&[counts, counts, 0], 1);
            if tick > 40 {
                worst = max(worst, (joints.velocity[0] - 0.2345).abs());
                worst = max(worst, (joints.velocity[1] + 0.2345).abs());
                assert!((joints.moved[0] * 1e5).abs() > 22.9);
            }
        }
        assert!(worst < 0.5 * 1e-5 / TICK_S, "{worst}");
        assert!(worst > 0.05 * 1e-5 / TICK_S, "{worst}");
    }

    #[test]
    fn a_jump_is_one_count_more_than_the_fastest_motion() {
        for (counts, jumped) in [(201, false), (202, true), (-201, false), (-202, true)] {
            let mut encoders = encoders();
            encoders.read(&[0; 3], 1);
            let joints = encoders.read(&[0, counts, 0], 1);
            assert_eq!(joints.jumped, jumped, "{counts}");
            assert_eq!(joints.velocity == [0.0; 3], jumped);
            assert_eq!(joints.moved == [0.0; 3], jumped);
            // From there on it is believed again.
            assert!(!encoders.read(&[0, counts, 0], 1).jumped);
        }
    }

    #[test]
    fn counters_may_wrap_around() {
        let mut encoders = encoders();
        encoders.read(&[i32::MAX - 50, 0, 0], 1);
        let joints = encoders.read(&[i32::MIN + 49, 0, 0], 1);
        assert!(!joints.jumped);
        assert!((joints.moved[0] - 1e-3).abs() < 1e-8 && joints.velocity[0] > 0.4);
        // The greatest jump there is.
        assert!(encoders.read(&[i32::MIN + 49, i32::MIN, 0], 1).jumped);
    }

    fn max(a: f32, b: f32) -> f32 {
        crate::math::max(a, b)
    }
}
