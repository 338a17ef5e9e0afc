//! Distance from a capsule: that from its segment, less its radius.
//!
//! Entry points: [`Foot::distance`], [`Foot::touch`].

use super::shape::{Solid, Touch, ball};
use nalgebra::Vector3;

/// The point of a capsule's segment that is nearest to a point.
pub(super) struct Foot {
    /// From it to the point \[m\].
    arm: Vector3<f64>,
    /// Whether it is an end of the segment, which a ball is around.
    is_end: bool,
    radius: f64,
    /// Along the segment, unit vector.
    axis: Vector3<f64>,
}

impl Foot {
    /// On the segment that ends in front at the centre of `solid`, `length_m` long.
    pub fn new(solid: &Solid, radius_m: f64, length_m: f64, at: &Vector3<f64>) -> Self {
        let arm = at - solid.centre;
        let ahead = arm.dot(&solid.axis);
        let on = ahead.clamp(-length_m, 0.0);
        Self {
            arm: arm - solid.axis * on,
            is_end: ahead >= 0.0 || ahead <= -length_m,
            radius: radius_m,
            axis: solid.axis,
        }
    }

    /// Signed distance of the point from the surface \[m\].
    pub fn distance(&self) -> f64 {
        self.arm.norm() - self.radius
    }

    /// The same with its derivatives; `None` near the segment, where there is no normal.
    pub fn touch(&self) -> Option<Touch> {
        let mut touch = ball(&self.arm, self.radius)?;
        if !self.is_end {
            // A cylinder: not curved along its axis.
            touch.curvature -= self.axis * self.axis.transpose() / self.arm.norm();
        }
        Some(touch)
    }
}
