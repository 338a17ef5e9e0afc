//! Distance from a box with rounded edges: that from its core, a box smaller by the fillet, less the fillet.
//!
//! Entry points: [`Beyond::distance`], [`Beyond::touch`]. Outside the core it is once continuously differentiable, its
//! Hessian that of a plane before faces, of a cylinder around edges and of a ball around corners.

use super::shape::{Solid, Touch};
use nalgebra::{Matrix3, Vector3};

/// How far a point is beyond those three faces of a box's core that are on its side.
pub(super) struct Beyond {
    /// Along side, across, and along the axis \[m\], (3); negative inside.
    by: Vector3<f64>,
    /// Out of these faces, unit vectors in the world frame by column.
    outward: Matrix3<f64>,
    fillet: f64,
}

impl Beyond {
    pub fn new(solid: &Solid, size_m: &[f64; 3], fillet_m: f64, at: &Vector3<f64>) -> Self {
        let frame = [solid.side, solid.axis.cross(&solid.side), solid.axis];
        let arm = at - solid.middle();
        let along = frame.map(|direction| direction.dot(&arm));
        let outward = [0, 1, 2].map(|i| frame[i] * 1f64.copysign(along[i]));
        Self {
            by: Vector3::from_fn(|i, _| along[i].abs() - (0.5 * size_m[i] - fillet_m)),
            outward: Matrix3::from_columns(&outward),
            fillet: fillet_m,
        }
    }

    /// Signed distance of the point from the surface \[m\].
    pub fn distance(&self) -> f64 {
        let outside = self.by.map(|x| x.max(0.0)).norm();
        outside + self.by.max().min(0.0) - self.fillet
    }

    /// The same with its derivatives; `None` where a number is not finite.
    pub fn touch(&self) -> Option<Touch> {
        let gap = self.distance();
        if !gap.is_finite() {
            return None;
        }
        let beyond = self.by.map(|x| x.max(0.0));
        let outside = beyond.norm();
        if outside == 0.0 {
            // In the core, the nearest face is the way out.
            let nearest = self.by.imax();
            return Some(Touch {
                gap,
                normal: self.outward.column(nearest).into_owned(),
                curvature: Matrix3::zeros(),
            });
        }
        let normal = beyond / outside;
        let across = Matrix3::from_diagonal(&self.by.map(|x| f64::from(u8::from(x > 0.0))));
        let bend = (across - normal * normal.transpose()) / outside;
        Some(Touch {
            gap,
            normal: self.outward * normal,
            curvature: self.outward * bend * self.outward.transpose(),
        })
    }
}
