//! What the control loop has to know about one console: kinematics, encoders, motors and limits.
//!
//! Entry point: [`DeviceDescription`]. One is compiled into each board's firmware; the host reads
//! the same description from `devices/*.toml`.

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
}
