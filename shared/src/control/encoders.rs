//! Joint coordinates and velocities from encoder counts, and whether an encoder can be believed.
//!
//! Entry point: [`Encoders::read`].

use super::TICK_S;
use super::tuning::Guards;
use super::velocity::Velocity;
use crate::device::{DeviceDescription, JOINTS, Kinematics};
use crate::math::max;

/// What the encoders say in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Joints {
    /// Coordinates \[m or rad\], (3).
    pub position: [f32; JOINTS],
    /// Filtered velocities \[m/s or rad/s\], (3).
    pub velocity: [f32; JOINTS],
    /// Change of the coordinates since the last tick, (3); 0 after a jump.
    pub moved: [f32; JOINTS],
    /// Whether a joint moved faster than the device can, or changed its pace faster than anything does.
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
    /// Largest believable change of that change from one tick to the next \[counts\].
    max_change: f32,
    /// Change at the last reading \[counts per tick\]; not a number where there was none, which compares with nothing.
    pace: f32,
    velocity: Velocity,
}

/// The encoders of a console.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoders {
    joints: [Encoder; JOINTS],
    /// Counts of the last tick; none at the start.
    previous: Option<[i32; JOINTS]>,
    /// Ticks between the last two readings.
    passed: u32,
}

/// Largest acceleration of the grip that is believed \[m/s^2\]: ten times what a hand or the motors do, and a stage that is
/// stopped at its end from 1 m/s.
const MAX_ACCELERATION: f32 = 1000.0;
/// Smallest bound on a change of pace \[counts\]: quantisation alone makes one of two.
const LEAST_CHANGE: f32 = 2.0;

/// Largest believable acceleration of each joint \[unit/s^2\]: that of the grip over the joint's longest lever.
fn max_accelerations(device: &DeviceDescription) -> [f32; JOINTS] {
    let levers = match device.kinematics {
        Kinematics::Cartesian { .. } => [1.0; JOINTS],
        Kinematics::SerialArm {
            upper_m, fore_m, ..
        } => [upper_m + fore_m, upper_m + fore_m, fore_m],
    };
    levers.map(|lever| MAX_ACCELERATION / lever)
}

impl Encoders {
    pub fn new(device: &DeviceDescription, guards: Guards) -> Self {
        let mut joints = device.joints.map(|joint| Encoder {
            zero_counts: joint.zero_counts,
            unit_per_count: 1.0 / joint.counts_per_unit,
            // One more for the quantisation.
            max_counts: ((joint.max_speed_per_s * TICK_S * joint.counts_per_unit.abs()) as u32)
                .saturating_add(1),
            max_change: TICK_S * TICK_S * joint.counts_per_unit.abs(),
            pace: f32::NAN,
            velocity: Velocity::default(),
        });
        for (joint, most) in joints.iter_mut().zip(max_accelerations(device)) {
            joint.max_change = if guards.encoder_burst {
                max(joint.max_change * most, LEAST_CHANGE)
            } else {
                f32::INFINITY
            };
        }
        Encoders {
            joints,
            previous: None,
            passed: 1,
        }
    }

    /// Forgets where the joints were: the next reading is believed as it is, at velocity 0.
    pub fn restart(&mut self) {
        self.previous = None;
        for joint in &mut self.joints {
            joint.velocity = Velocity::default();
            joint.pace = f32::NAN;
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
        let known = self.previous.is_some();
        let per_tick = 1.0 / ticks as f32;
        // Between the middles of the two spans whose paces are compared.
        let apart = 0.5 * (ticks + self.passed) as f32;
        self.passed = ticks;
        let steps = counts.iter().zip(&previous);
        let outputs = position.iter_mut().zip(&mut velocity).zip(&mut ways);
        for ((joint, (now, before)), ((q, speed), way)) in
            self.joints.iter_mut().zip(steps).zip(outputs)
        {
            *q = now.wrapping_sub(joint.zero_counts) as f32 * joint.unit_per_count;
            let moved = now.wrapping_sub(*before);
            jumped |= moved.unsigned_abs() > joint.max_counts.saturating_mul(ticks);
            if known {
                let pace = moved as f32 * per_tick;
                jumped |= (pace - joint.pace).abs() > joint.max_change * apart;
                joint.pace = pace;
            }
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
    use crate::device::Joint;

    /// 10 um per count, backwards on joint 1; at most 2 m/s: 200 counts in a tick, and one.
    fn encoders() -> Encoders {
        Encoders::new(&device(), Guards::ALL)
    }

    fn device() -> DeviceDescription {
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
        DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint(1e5), joint(-1e5), joint(1e5)],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 1.0,
            max_power_w: 1e3,
            max_grip_speed_m_per_s: 10.0,
            actuation_delay_us: 0,
        }
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
        let mut encoders = Encoders::new(&device, Guards::ALL);
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
            // The first motion after a start has none before it to be compared with.
            let joints = encoders.read(&[0, counts, 0], 1);
            assert_eq!(joints.jumped, jumped, "{counts}");
            assert_eq!(joints.velocity == [0.0; 3], jumped);
            assert_eq!(joints.moved == [0.0; 3], jumped);
            // From there on it is believed again: at its pace.
            let on = if jumped { counts } else { 2 * counts };
            assert!(!encoders.read(&[0, on, 0], 1).jumped);
        }
    }

    /// 1,000 m/s^2 are 100 counts a tick from one tick to the next, either way, and at any speed.
    #[test]
    fn a_change_of_pace_is_a_jump_beyond_a_thousand_metres_per_second_squared() {
        for pace in [0, 50, -90] {
            for (change, jumped) in [(100, false), (101, true), (-100, false), (-101, true)] {
                let mut encoders = encoders();
                let read =
                    |encoders: &mut Encoders, at: i32| encoders.read(&[at, 0, -at], 1).jumped;
                for tick in 0..3 {
                    assert!(!read(&mut encoders, pace * tick));
                }
                let at = 3 * pace + change;
                assert_eq!(read(&mut encoders, at), jumped, "{pace} {change}");
                assert!(!read(
                    &mut encoders,
                    at + if jumped { 0 } else { pace + change }
                ));
            }
        }
    }

    /// A motion whose tick was swallowed is a steady one, and one read a tick late has had longer to change.
    #[test]
    fn paces_are_compared_over_the_ticks_that_passed() {
        // 90 a tick throughout.
        let mut steady = encoders();
        for (at, ticks) in [(0, 1), (90, 1), (450, 4), (540, 1)] {
            assert!(!steady.read(&[at, 0, 0], ticks).jumped, "{at}");
        }
        // Three readings whose middles are two ticks apart: at most 200 counts a tick more.
        for (change, jumped) in [(195, false), (200, false), (201, true)] {
            let mut encoders = encoders();
            encoders.read(&[0; 3], 1);
            encoders.read(&[0; 3], 1);
            let read = encoders.read(&[3 * change, 0, 0], 3);
            assert_eq!(read.jumped, jumped, "{change}");
        }
    }

    /// A turning joint goes by its longest lever, and one whose counts are coarse may go from one to none.
    #[test]
    fn levers_and_coarse_counts_are_allowed_for() {
        let mut device = DeviceDescription {
            kinematics: Kinematics::SerialArm {
                shoulder_m: [0.0; 3],
                upper_m: 0.3,
                fore_m: 0.2,
            },
            ..device()
        };
        let most = Encoders::new(&device, Guards::ALL)
            .joints
            .map(|j| j.max_change);
        for (found, expected) in most.into_iter().zip([200.0, 200.0, 500.0]) {
            assert!((found - expected).abs() < 1e-3, "{most:?}");
        }
        device.joints[2].counts_per_unit = 100.0;
        let mut encoders = Encoders::new(&device, Guards::ALL);
        for at in [0, 1, 1, 2, 1, 2, 2] {
            assert!(!encoders.read(&[0, 0, at], 1).jumped);
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
}
