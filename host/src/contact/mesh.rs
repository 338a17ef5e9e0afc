//! Distance from a mesh swept by a ball: that from the mesh, less the ball's radius.
//!
//! Entry points: [`gap`], [`touch`].

use super::shape::{Solid, Touch};
use crate::tool::ClosedMesh;
use nalgebra::{Matrix3, Vector3};

/// The mesh's axes in the world, by column: z against where the front looks, x to the side.
fn axes(solid: &Solid) -> Matrix3<f64> {
    let (up, side) = (-solid.axis, solid.side);
    Matrix3::from_columns(&[side, up.cross(&side), up])
}

/// A place in the world in the mesh's frame \[m\], (3).
fn local(solid: &Solid, at: &Vector3<f64>) -> Vector3<f64> {
    axes(solid).tr_mul(&(at - solid.centre))
}

/// A place in the mesh's frame in the world \[m\], (3).
pub(super) fn world(solid: &Solid, at: &Vector3<f64>) -> Vector3<f64> {
    solid.centre + axes(solid) * at
}

/// Whether a point is farther than this from the box around the mesh \[m\].
pub(super) fn is_out_of_box(
    solid: &Solid,
    mesh: &ClosedMesh,
    far_m: f64,
    at: &Vector3<f64>,
) -> bool {
    let square = mesh.bounds().distance_squared(&local(solid, at));
    // A rounding more is for the triangles to say.
    far_m >= 0.0 && square > far_m * far_m * (1.0 + 1e-9)
}

/// Signed distance of a point from the surface \[m\].
pub(super) fn gap(solid: &Solid, mesh: &ClosedMesh, fillet_m: f64, at: &Vector3<f64>) -> f64 {
    let foot = mesh.nearest(&local(solid, at));
    foot.map_or(f64::MAX, |foot| foot.distance - fillet_m)
}

/// The same with its derivatives; `None` where a number is not finite.
pub(super) fn touch(
    solid: &Solid,
    mesh: &ClosedMesh,
    fillet_m: f64,
    at: &Vector3<f64>,
) -> Option<Touch> {
    let foot = mesh.nearest(&local(solid, at))?;
    let axes = axes(solid);
    Some(Touch {
        gap: foot.distance - fillet_m,
        normal: axes * foot.normal,
        curvature: axes * foot.curvature * axes.transpose(),
    })
}
