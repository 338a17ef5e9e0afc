//! From joint coordinates to the grip: position, Jacobian, and the effort that carries the weight.
//!
//! Entry point: [`forward`]. Frames and signs are those of [`Kinematics`]; world z is up.

use crate::device::{DeviceDescription, JOINTS, Kinematics};
use crate::math::{Vec3, dot, rotation_between, sincos};

/// Standard gravity \[m/s^2\].
pub const GRAVITY: f32 = 9.806_65;

/// Pose of the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// \[m\], world frame.
    pub position_m: Vec3,
    /// Unit quaternion (x, y, z, w); identity where it is not sensed.
    pub orientation: [f32; 4],
}

impl Grip {
    /// Motion from `before`: linear \[m\], then rotation vector \[rad\], both in the world frame, (6).
    pub fn moved_from(&self, before: &Grip) -> [f32; 6] {
        let [x, y, z]: [f32; 3] = (self.position_m - before.position_m).into();
        let [a, b, c]: [f32; 3] = rotation_between(&before.orientation, &self.orientation).into();
        [x, y, z, a, b, c]
    }
}

/// Where the joints put the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Grip position \[m\], world frame.
    pub position_m: Vec3,
    /// Derivative of the grip position by each joint \[m per joint unit\], (3 columns).
    pub jacobian: [Vec3; JOINTS],
    /// Effort of each joint that carries the masses of the description: the gradient of their potential
    /// energy, (3).
    pub weight_effort: [f32; JOINTS],
}

/// Pose at joint coordinates `q` \[m or rad\], (3).
pub fn forward(device: &DeviceDescription, q: &[f32; JOINTS]) -> Pose {
    let [_, second_kg, third_kg] = device.gravity_mass_kg;
    match device.kinematics {
        Kinematics::Cartesian { origin_m } => Pose {
            position_m: Vec3::from(origin_m) + Vec3::from(*q),
            jacobian: [
                Vec3::new(1.0, 0.0, 0.0),
                Vec3::new(0.0, 1.0, 0.0),
                Vec3::new(0.0, 0.0, 1.0),
            ],
            // x and y are level: only z lifts.
            weight_effort: [0.0, 0.0, third_kg * GRAVITY],
        },
        Kinematics::SerialArm {
            shoulder_m,
            upper_m,
            fore_m,
        } => {
            let [yaw, shoulder, elbow] = *q;
            let (sin_yaw, cos_yaw) = sincos(yaw);
            let (sin_upper, cos_upper) = sincos(shoulder);
            let (sin_fore, cos_fore) = sincos(shoulder + elbow);
            // In the arm's vertical plane: out from the axis, and up.
            let (fore_out, fore_up) = (fore_m * cos_fore, fore_m * sin_fore);
            let upper_out = upper_m * cos_upper;
            let (out, up) = (upper_out + fore_out, upper_m * sin_upper + fore_up);
            Pose {
                position_m: Vec3::from(shoulder_m) + Vec3::new(out * cos_yaw, out * sin_yaw, up),
                jacobian: [
                    Vec3::new(-out * sin_yaw, out * cos_yaw, 0.0),
                    Vec3::new(-up * cos_yaw, -up * sin_yaw, out),
                    Vec3::new(-fore_up * cos_yaw, -fore_up * sin_yaw, fore_out),
                ],
                weight_effort: [
                    0.0,
                    (second_kg * upper_out + third_kg * out) * GRAVITY,
                    third_kg * fore_out * GRAVITY,
                ],
            }
        }
    }
}

impl Pose {
    /// Grip velocity \[m/s\] from joint velocities \[unit/s\].
    pub fn velocity(&self, joint: &[f32; JOINTS]) -> Vec3 {
        let [a, b, c] = self.jacobian;
        let [qa, qb, qc] = *joint;
        a * qa + b * qb + c * qc
    }

    /// Joint efforts of a force on the grip \[N\]: J' F.
    pub fn effort(&self, force: &Vec3) -> [f32; JOINTS] {
        self.jacobian.map(|column| dot(&column, force))
    }
}
