//! Tools: what the hand holds, and one sample of where it is.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Most tools in one model: two hands, each with a tool and a needle.
pub const MAX_TOOLS: usize = 4;

/// Where a tool is at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolSample {
    /// Which tool.
    pub id: u8,
    /// Position of the grip \[m\], (3), world frame.
    pub position_m: [f64; 3],
    /// Orientation of the grip, unit quaternion (x, y, z, w).
    pub orientation: [f64; 4],
    /// Velocity of the grip \[m/s\], (3), world frame.
    pub velocity_m_per_s: [f64; 3],
    /// Console time at which it was there \[us\].
    pub console_time_us: u64,
}

/// A rigid, frictionless sphere on the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereTool {
    /// Radius \[m\]; 0 for a bare point.
    pub radius_m: f64,
    /// Centre in the frame of the grip \[m\], (3).
    pub offset_m: [f64; 3],
}

impl SphereTool {
    /// From the grip to the sphere's centre, in the world frame \[m\]; `None` if the sample is not
    /// a pose: a number that is not finite, or a quaternion without length.
    pub(crate) fn arm(&self, sample: &ToolSample) -> Option<Vector3<f64>> {
        let [x, y, z, w] = sample.orientation;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
        let arm = rotation * Vector3::from(self.offset_m);
        let finite = sample
            .position_m
            .iter()
            .chain(arm.iter())
            .all(|x| x.is_finite());
        finite.then_some(arm)
    }
}
