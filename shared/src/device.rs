//! What the control loop has to know about one console: kinematics, encoders, motors and limits.
//!
//! Entry point: [`DeviceDescription`]. One is compiled into each board's firmware; the host reads
//! the same description from `devices/*.toml`.

use crate::math::min;
use crate::wire::validate::{MAX_CURRENT, MAX_POSITION};
use core::fmt;
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Number of motorised joints of a console.
pub const JOINTS: usize = 3;

/// How joint coordinates become a grip position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub enum Kinematics {
    /// Three orthogonal prismatic joints: grip = origin + q.
    Cartesian {
        /// Grip position at q = 0 \[m\], (3), world frame.
        origin_m: [f32; 3],
    },
    /// Yaw about world z, then shoulder and elbow pitch in the vertical plane (elbow angle relative to
    /// the upper arm). At q = 0 the arm lies stretched along world x.
    SerialArm {
        /// Position of the shoulder \[m\], (3), world frame.
        shoulder_m: [f32; 3],
        /// Shoulder to elbow \[m\].
        upper_m: f32,
        /// Elbow to grip \[m\].
        fore_m: f32,
    },
}

/// One joint: its encoder, its motor, and its mechanics as the virtual console simulates them.
///
/// "Effort" is N on a prismatic joint and N m on a revolute one; a "unit" is m or rad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Joint {
    /// Encoder counts per joint unit, sign included \[1/m or 1/rad\].
    pub counts_per_unit: f32,
    /// Encoder reading at q = 0 \[counts\].
    pub zero_counts: i32,
    /// Effort per motor current, sign included \[N/A or N m/A\].
    pub effort_per_amp: f32,
    /// Largest motor current \[A\].
    pub max_current_a: f32,
    /// Largest change of the motor's effort \[effort/s\].
    pub max_slew_per_s: f32,
    /// Fastest believable motion \[unit/s\]; a faster jump of the encoder is a fault.
    pub max_speed_per_s: f32,
    /// Moving mass or inertia that the motor sees \[kg or kg m^2\].
    pub inertia: f32,
    /// Viscous damping \[effort s/unit\].
    pub damping: f32,
    /// Coulomb friction \[effort\].
    pub coulomb: f32,
}

/// One console.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct DeviceDescription {
    /// Name in UTF-8, padded with zeros.
    pub name: [u8; 16],
    /// Joint to grip.
    pub kinematics: Kinematics,
    /// The joints, from the base out, (3).
    pub joints: [Joint; JOINTS],
    /// Masses that gravity compensation carries \[kg\], (3): for a serial arm lumped at elbow and grip
    /// (entries 1 and 2; entry 0 is unused), for a Cartesian console the mass moved by each joint.
    pub gravity_mass_kg: [f32; JOINTS],
    /// Largest contact force at the grip \[N\].
    pub max_force_n: f32,
    /// Largest mechanical power of the contact force, given to the hand or taken from it \[W\].
    pub max_power_w: f32,
    /// Fastest motion of the grip under power \[m/s\]; a faster one is a fault.
    pub max_grip_speed_m_per_s: f32,
    /// Time from a tick until its currents act on the grip \[us\]: amplifier and winding, and the period
    /// that a drive on a bus adds.
    pub actuation_delay_us: u32,
}

/// Why a description does not make a usable device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceError {
    /// Joint, from 0, if it is about one.
    pub joint: Option<u8>,
    /// Field of [`Joint`], [`Kinematics`] or [`DeviceDescription`].
    pub field: &'static str,
    /// What the field must be.
    pub rule: &'static str,
}

impl fmt::Display for DeviceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(joint) = self.joint {
            write!(f, "joint {joint}: ")?;
        }
        write!(f, "{} must be {}", self.field, self.rule)
    }
}

impl core::error::Error for DeviceError {}

/// Longest time from a tick until its currents act \[us\]: five ticks, beyond which no stiffness worth
/// the name is stable.
pub const MAX_ACTUATION_DELAY_US: u32 = 5000;

/// Least limit on force \[N\], power \[W\] and speed \[m/s\]: less is no use, and the squares of very small ones vanish in f32.
const LEAST: f32 = 1e-3;

/// Longest time in which the slew limit takes the largest force away \[s\]: that after which a console disarms when nobody
/// renews the contact. All joints slew alike, so that the force keeps its direction: one that is slow slows the others.
const LONGEST_SLEW_S: f32 = 0.5;

/// Fastest grip of any device \[m/s\]: half of what a `State` may report.
const MAX_GRIP_SPEED: f32 = 50.0;

/// Stiffness over mass per square of the loop's delay that is rendered stably: four fifths of what the simulated console stands in the hand
/// that holds a pen.
const STABLE: f32 = 0.55;
/// Delay of the loop besides the motors' \[s\]: a tick, and half of one that holds the force.
const LOOP_S: f32 = 1.5e-3;

impl DeviceDescription {
    /// Largest stiffness that this console renders stably in a hand \[N/m\].
    pub fn stable_stiffness_n_per_m(&self) -> f32 {
        // The lightest that the grip can feel: an arm's inertia at its full reach.
        let reach_m = match self.kinematics {
            Kinematics::Cartesian { .. } => 1.0,
            Kinematics::SerialArm {
                upper_m, fore_m, ..
            } => upper_m + fore_m,
        };
        let masses = self.joints.iter().map(|j| j.inertia / (reach_m * reach_m));
        let mass = masses.fold(1e9, |least, mass| min(mass, least));
        let delay_s = self.loop_delay_s();
        STABLE * mass / (delay_s * delay_s)
    }

    /// Delay of the loop from reading the encoders to the middle of the force that answers \[s\].
    pub(crate) fn loop_delay_s(&self) -> f32 {
        self.actuation_delay_us as f32 * 1e-6 + LOOP_S
    }

    /// Checks that the console can compute with these numbers: everything that control derives from them
    /// is then finite, whatever the encoders say, and within what a `State` may report.
    ///
    /// # Errors
    /// [`DeviceError`] names the first field that is not as it must be.
    pub fn validate(&self) -> Result<(), DeviceError> {
        let rule = |ok: bool, field, rule| require(ok, None, field, rule);
        let length = |value: f32| value > 0.0 && value <= MAX_POSITION;
        let reach_m = match self.kinematics {
            Kinematics::Cartesian { origin_m } => {
                rule(is_place(&origin_m), "origin_m", "finite, at most 10 m")?;
                1.0
            }
            Kinematics::SerialArm {
                shoulder_m,
                upper_m,
                fore_m,
            } => {
                rule(is_place(&shoulder_m), "shoulder_m", "finite, at most 10 m")?;
                rule(length(upper_m), "upper_m", "positive, at most 10 m")?;
                rule(length(fore_m), "fore_m", "positive, at most 10 m")?;
                upper_m + fore_m
            }
        };
        let mut grip_speed = 0.0;
        for (joint, index) in self.joints.iter().zip(0..) {
            joint.validate(index)?;
            grip_speed += joint.max_speed_per_s * reach_m;
        }
        rule(
            grip_speed <= MAX_GRIP_SPEED,
            "max_speed_per_s",
            "such that all joints together move the grip by at most 50 m/s",
        )?;
        let carried = |mass: &f32| (0.0..=1e3).contains(mass);
        rule(
            self.gravity_mass_kg.iter().all(carried),
            "gravity_mass_kg",
            "0 to 1000 kg",
        )?;
        rule(
            (LEAST..=1e3).contains(&self.max_force_n),
            "max_force_n",
            "0.001 to 1000 N",
        )?;
        for (joint, index) in self.joints.iter().zip(0..) {
            require(
                joint.max_slew_per_s * LONGEST_SLEW_S >= self.max_force_n * reach_m,
                Some(index),
                "max_slew_per_s",
                "such that max_force_n is gone within 0.5 s",
            )?;
        }
        rule(
            (LEAST..=1e4).contains(&self.max_power_w),
            "max_power_w",
            "0.001 to 10000 W",
        )?;
        rule(
            (LEAST..=MAX_GRIP_SPEED).contains(&self.max_grip_speed_m_per_s),
            "max_grip_speed_m_per_s",
            "0.001 to 50 m/s",
        )?;
        rule(
            self.actuation_delay_us <= MAX_ACTUATION_DELAY_US,
            "actuation_delay_us",
            "at most 5000 us",
        )
    }
}

impl Joint {
    fn validate(&self, index: u8) -> Result<(), DeviceError> {
        let rule = |ok: bool, field, rule| require(ok, Some(index), field, rule);
        let ratio = |value: f32| (1e-6..=1e6).contains(&value.abs());
        let positive = |value: f32| (1e-9..=1e9).contains(&value);
        let not_negative = |value: f32| (0.0..=1e9).contains(&value);
        rule(
            (1.0..=1e9).contains(&self.counts_per_unit.abs()),
            "counts_per_unit",
            "of magnitude 1 to 1e9",
        )?;
        rule(
            ratio(self.effort_per_amp),
            "effort_per_amp",
            "of magnitude 1e-6 to 1e6",
        )?;
        rule(
            self.max_current_a > 0.0 && self.max_current_a <= MAX_CURRENT,
            "max_current_a",
            "positive, at most 1000 A",
        )?;
        rule(
            positive(self.max_slew_per_s),
            "max_slew_per_s",
            "1e-9 to 1e9",
        )?;
        rule(
            positive(self.max_speed_per_s),
            "max_speed_per_s",
            "1e-9 to 1e9",
        )?;
        rule(positive(self.inertia), "inertia", "1e-9 to 1e9")?;
        rule(not_negative(self.damping), "damping", "0 to 1e9")?;
        rule(not_negative(self.coulomb), "coulomb", "0 to 1e9")
    }
}

fn is_place(v: &[f32; 3]) -> bool {
    v.iter().all(|x| x.abs() <= MAX_POSITION)
}

fn require(
    ok: bool,
    joint: Option<u8>,
    field: &'static str,
    rule: &'static str,
) -> Result<(), DeviceError> {
    if ok {
        Ok(())
    } else {
        Err(DeviceError { joint, field, rule })
    }
}
