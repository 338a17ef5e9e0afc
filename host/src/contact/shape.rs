//! Signed distance of a tool's shape with its first two derivatives.
//!
//! Entry points: [`Solid::touch`], [`Solid::gap`]. A shape is a core swept by a ball: a sphere's is a point, a capsule's a
//! segment, those of a punch and a box are smaller by the fillet, a mesh is one itself. Outside its core the distance from
//! what is convex is once continuously differentiable, its Hessian that of a plane, a cylinder, a torus or a ball (do Carmo 1976, 3-3).

use super::capsule::Foot;
use super::mesh;
use super::rounded_box::Beyond;
use crate::tool::{Placement, Shape, Tool};
use nalgebra::{Matrix3, Vector3};

/// Depth of a place well behind a flat face, in radii of the shape.
const BEHIND_FACE: f64 = 0.25;

/// A tool's shape where it is now.
#[derive(Clone, Debug)]
pub(crate) struct Solid {
    shape: Shape,
    /// Centre of the ball, of that at a capsule's front end, or of the front face, or origin of a mesh \[m\], world
    /// frame.
    pub centre: Vector3<f64>,
    /// Where the front looks, unit vector, world frame.
    pub(super) axis: Vector3<f64>,
    /// Where a box's side looks, unit vector across the axis, world frame.
    pub(super) side: Vector3<f64>,
}

/// A point as a shape sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Touch {
    /// Signed distance to the surface \[m\]; negative inside.
    pub gap: f64,
    /// Its gradient: a unit vector out of the shape.
    pub normal: Vector3<f64>,
    /// Its Hessian \[1/m\]; the normal is in its kernel.
    pub curvature: Matrix3<f64>,
}

impl Solid {
    /// The shape of `tool`, not thinner than `least_m`, at `placement`.
    pub fn new(tool: &Tool, least_m: f64, placement: &Placement) -> Self {
        Self {
            shape: tool.shape.at_least(least_m),
            centre: placement.centre,
            axis: placement.rotation * Vector3::from(tool.axis),
            side: placement.rotation * Vector3::from(tool.side),
        }
    }

    /// Largest way of the surface \[m\] that turns from `before`, the same shape, have caused. A turn of a round shape about its axis
    /// counts for nothing.
    pub fn turned_m(&self, before: &Self) -> f64 {
        let tilt = (self.axis - before.axis).norm();
        let roll = match self.shape {
            Shape::RoundedBox { .. } | Shape::Mesh { .. } => (self.side - before.side).norm(),
            Shape::Sphere { .. }
            | Shape::Capsule { .. }
            | Shape::FlatPunch { .. }
            | Shape::Grip => 0.0,
        };
        self.reach() * (tilt + roll)
    }

    /// The same, somewhere else.
    pub fn moved(&self, by: &Vector3<f64>) -> Self {
        Self {
            centre: self.centre + by,
            ..self.clone()
        }
    }

    /// On the way from here to where `other` is the same shape, at this part of it, 0 to 1; turns on it are short.
    pub fn towards(&self, other: &Self, part: f64) -> Self {
        let axis = self
            .axis
            .lerp(&other.axis, part)
            .try_normalize(0.0)
            .unwrap_or(other.axis);
        let side = self.side.lerp(&other.side, part);
        Self {
            centre: self.centre.lerp(&other.centre, part),
            axis,
            side: (side - axis * axis.dot(&side))
                .try_normalize(0.0)
                .unwrap_or(other.side),
            ..other.clone()
        }
    }

    /// Size against which gaps are judged \[m\].
    pub fn radius(&self) -> f64 {
        self.shape.radius_m()
    }

    /// Curvature where it is the same everywhere \[1/m\], else 0.
    pub fn curvature_per_m(&self) -> f64 {
        match self.shape {
            Shape::Sphere { radius_m }
            | Shape::Capsule {
                radius_m,
                length_m: 0.0,
            } => radius_m.recip(),
            Shape::FlatPunch { .. }
            | Shape::Capsule { .. }
            | Shape::RoundedBox { .. }
            | Shape::Mesh { .. }
            | Shape::Grip => 0.0,
        }
    }

    /// Longest piece of a path \[m\], short against the curvature that turns the normals: a vertex that
    /// a shape has run over in one piece is not in its core yet, where another side may be nearer.
    pub fn piece(&self) -> f64 {
        match self.shape {
            Shape::Sphere { radius_m } | Shape::Capsule { radius_m, .. } => 0.25 * radius_m,
            Shape::FlatPunch { fillet_m, .. }
            | Shape::RoundedBox { fillet_m, .. }
            | Shape::Mesh { fillet_m, .. } => 0.5 * fillet_m,
            Shape::Grip => f64::MAX,
        }
    }

    /// How far a turn about `centre` moves the surface, per radian \[m\]; nothing for a ball.
    pub fn reach(&self) -> f64 {
        match self.shape {
            Shape::Sphere { .. } | Shape::Grip => 0.0,
            Shape::FlatPunch {
                radius_m, length_m, ..
            } => radius_m.hypot(length_m),
            // Its core is a segment, which a turn about that moves nowhere.
            Shape::Capsule { length_m, .. } => length_m,
            Shape::RoundedBox {
                size_m: [side, across, along],
                ..
            } => (0.5 * side).hypot(0.5 * across).hypot(along),
            Shape::Mesh { ref mesh, .. } => mesh.reach_m(),
        }
    }

    /// No point of it is farther from `centre` \[m\].
    pub fn bound(&self) -> f64 {
        match self.shape {
            Shape::Capsule { radius_m, length_m } => radius_m + length_m,
            Shape::Mesh { fillet_m, .. } => fillet_m + self.reach(),
            Shape::Sphere { .. }
            | Shape::FlatPunch { .. }
            | Shape::RoundedBox { .. }
            | Shape::Grip => self.radius().max(self.reach()),
        }
    }

    /// A point well inside: in the tissue only if the whole shape is.
    pub fn middle(&self) -> Vector3<f64> {
        match self.shape {
            Shape::Sphere { .. } | Shape::Grip => self.centre,
            Shape::FlatPunch { length_m, .. }
            | Shape::Capsule { length_m, .. }
            | Shape::RoundedBox {
                size_m: [_, _, length_m],
                ..
            } => self.centre - self.axis * (0.5 * length_m),
            Shape::Mesh { ref mesh, .. } => mesh::world(self, &mesh.deepest_m().0),
        }
    }

    /// Points well inside: the middle, and one as far behind each end as the shape is thick; of a ball and a mesh the same three
    /// times.
    pub fn cores(&self) -> [Vector3<f64>; 3] {
        let behind = |way_m: f64| self.centre - self.axis * way_m;
        match self.shape {
            Shape::FlatPunch { length_m, .. }
            | Shape::RoundedBox {
                size_m: [_, _, length_m],
                ..
            } => {
                let thick_m = self.radius().min(0.5 * length_m);
                [self.middle(), behind(thick_m), behind(length_m - thick_m)]
            }
            Shape::Capsule { length_m, .. } => [self.middle(), self.centre, behind(length_m)],
            Shape::Sphere { .. } | Shape::Mesh { .. } | Shape::Grip => [self.middle(); 3],
        }
    }

    /// Point of the core that is nearest to a place: the core is the middle, or the segment about which the shape is thick.
    pub fn core_next_to(&self, place: &Vector3<f64>) -> Vector3<f64> {
        match self.shape {
            Shape::FlatPunch { length_m, .. }
            | Shape::Capsule { length_m, .. }
            | Shape::RoundedBox {
                size_m: [_, _, length_m],
                ..
            } => {
                let behind_m = (self.centre - place).dot(&self.axis).clamp(0.0, length_m);
                self.centre - self.axis * behind_m
            }
            Shape::Sphere { .. } | Shape::Mesh { .. } | Shape::Grip => self.middle(),
        }
    }

    /// Points behind the flat faces at both ends, by [`BEHIND_FACE`] of the shape's radius: behind their middles, and halfway to their rims;
    /// none of a shape without faces.
    pub fn behind_faces(&self) -> impl Iterator<Item = Vector3<f64>> + use<> {
        let faces = match self.shape {
            Shape::FlatPunch {
                radius_m, length_m, ..
            } => Some(([radius_m; 2], length_m)),
            Shape::RoundedBox {
                size_m: [side, across, along],
                ..
            } => Some(([0.5 * side, 0.5 * across], along)),
            Shape::Sphere { .. } | Shape::Capsule { .. } | Shape::Mesh { .. } | Shape::Grip => None,
        };
        let (centre, axis, side) = (self.centre, self.axis, self.side);
        let across = axis.cross(&side);
        let radius_m = self.radius();
        faces
            .into_iter()
            .flat_map(move |([half_m, half_across_m], length_m)| {
                let depth_m = (BEHIND_FACE * radius_m).min(0.5 * length_m);
                [depth_m, length_m - depth_m]
                    .into_iter()
                    .flat_map(move |behind_m| {
                        (0..9).map(move |place| {
                            let [x, y] =
                                [place % 3, place / 3].map(|part| 0.5 * (f64::from(part) - 1.0));
                            centre - axis * behind_m
                                + side * (x * half_m)
                                + across * (y * half_across_m)
                        })
                    })
            })
    }

    /// Whether `point` is plainly farther than this \[m\]: out of the box around a mesh, whose distance takes a look at its
    /// triangles. Of other shapes the distance itself is as soon known.
    pub fn is_beyond(&self, point: &Vector3<f64>, far_m: f64) -> bool {
        match &self.shape {
            Shape::Mesh { mesh, fillet_m } => {
                mesh::is_out_of_box(self, mesh, fillet_m + far_m, point)
            }
            _ => false,
        }
    }

    /// Signed distance of `point` \[m\].
    pub fn gap(&self, point: &Vector3<f64>) -> f64 {
        match self.shape {
            Shape::Grip => f64::MAX,
            Shape::Sphere { radius_m } => (point - self.centre).norm() - radius_m,
            Shape::FlatPunch {
                radius_m,
                fillet_m,
                length_m,
            } => {
                let section = Section::new(self, radius_m, fillet_m, length_m, point);
                section.distance() - fillet_m
            }
            Shape::Capsule { radius_m, length_m } => {
                Foot::new(self, radius_m, length_m, point).distance()
            }
            Shape::RoundedBox { size_m, fillet_m } => {
                Beyond::new(self, &size_m, fillet_m, point).distance()
            }
            Shape::Mesh { ref mesh, fillet_m } => mesh::gap(self, mesh, fillet_m, point),
        }
    }

    /// Distance, normal and curvature at `point`; `None` where there is no normal: near the centre of
    /// a ball or the segment of a capsule, and where a number is not finite.
    pub fn touch(&self, point: &Vector3<f64>) -> Option<Touch> {
        match self.shape {
            Shape::Grip => None,
            Shape::Sphere { radius_m } => ball(&(point - self.centre), radius_m),
            Shape::FlatPunch {
                radius_m,
                fillet_m,
                length_m,
            } => Section::new(self, radius_m, fillet_m, length_m, point).touch(),
            Shape::Capsule { radius_m, length_m } => {
                Foot::new(self, radius_m, length_m, point).touch()
            }
            Shape::RoundedBox { size_m, fillet_m } => {
                Beyond::new(self, &size_m, fillet_m, point).touch()
            }
            Shape::Mesh { ref mesh, fillet_m } => mesh::touch(self, mesh, fillet_m, point),
        }
    }
}

/// What a ball is to a point that is `arm` from its centre \[m\], (3).
pub(super) fn ball(arm: &Vector3<f64>, radius_m: f64) -> Option<Touch> {
    let distance = arm.norm();
    // Far less than that is never a balance.
    if !(distance > 1e-3 * radius_m && distance.is_finite()) {
        return None;
    }
    let normal = arm / distance;
    Some(Touch {
        gap: distance - radius_m,
        normal,
        curvature: (Matrix3::identity() - normal * normal.transpose()) / distance,
    })
}

/// A point in the plane through it and the axis of a punch; lengths from the core's surfaces.
struct Section {
    /// Beyond the nearer end of the core \[m\]; negative inside.
    beyond_end: f64,
    /// Beyond the side of the core \[m\]; negative inside.
    beyond_side: f64,
    /// From the axis \[m\].
    radius: f64,
    fillet: f64,
    /// Unit vector out of the nearer end.
    end: Vector3<f64>,
    /// From the axis to the point \[m\].
    aside: Vector3<f64>,
}

impl Section {
    fn new(solid: &Solid, radius_m: f64, fillet_m: f64, length_m: f64, at: &Vector3<f64>) -> Self {
        let arm = at - solid.middle();
        let height = arm.dot(&solid.axis);
        let aside = arm - solid.axis * height;
        let radius = aside.norm();
        Self {
            beyond_end: height.abs() - (0.5 * length_m - fillet_m),
            beyond_side: radius - (radius_m - fillet_m),
            radius,
            fillet: fillet_m,
            end: solid.axis * 1f64.copysign(height),
            aside,
        }
    }

    /// Signed distance from the core \[m\].
    fn distance(&self) -> f64 {
        let outside = self.beyond_end.max(0.0).hypot(self.beyond_side.max(0.0));
        outside + self.beyond_end.max(self.beyond_side).min(0.0)
    }

    fn touch(&self) -> Option<Touch> {
        let distance = self.distance();
        if !(self.radius + self.beyond_end).is_finite() {
            return None;
        }
        let gap = distance - self.fillet;
        // On the axis nothing is aside; there the end is as good a way out as any.
        if self.radius == 0.0 || (self.beyond_side <= 0.0 && self.beyond_end >= self.beyond_side) {
            return Some(Touch {
                gap,
                normal: self.end,
                curvature: Matrix3::zeros(),
            });
        }
        let out = self.aside / self.radius;
        let around = out.cross(&self.end);
        let hoop = around * around.transpose() / self.radius;
        if self.beyond_end <= 0.0 {
            return Some(Touch {
                gap,
                normal: out,
                curvature: hoop,
            });
        }
        // The rim: a torus.
        let (end, side) = (self.beyond_end / distance, self.beyond_side / distance);
        let normal = self.end * end + out * side;
        let along = self.end * side - out * end;
        Some(Touch {
            gap,
            normal,
            curvature: along * along.transpose() / distance + hoop * side,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn punch() -> Solid {
        let shape = Shape::FlatPunch {
            radius_m: 1.0,
            fillet_m: 0.2,
            length_m: 3.0,
        };
        let placement = Placement {
            centre: Vector3::new(0.3, -0.2, 0.1),
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(0.4, 0.7, -0.2)),
        };
        Solid::new(&Tool::new(shape, [0.0; 3]), 0.0, &placement)
    }

    fn ball() -> Solid {
        let placement = Placement {
            centre: Vector3::new(0.3, -0.2, 0.1),
            rotation: UnitQuaternion::identity(),
        };
        Solid::new(&Tool::sphere(1.0, [0.0; 3]), 0.0, &placement)
    }

    /// `forward` along the axis from the face, `out` from the axis, turned by `angle` about it.
    fn beside(solid: &Solid, forward: f64, out: f64, angle: f64) -> Vector3<f64> {
        let across = solid.axis.cross(&Vector3::x()).normalize();
        let other = solid.axis.cross(&across);
        solid.centre + solid.axis * forward + (across * angle.cos() + other * angle.sin()) * out
    }

    #[test]
    fn the_derivatives_are_those_of_the_distance() {
        // Places in front of the face, beside the bar, around both rims, and inside.
        let punch = punch();
        let places = [
            (0.05, 0.3),
            (-0.1, 0.5),
            (0.1, 0.79),
            (0.02, 0.95),
            (-0.05, 0.9),
            (-0.15, 1.05),
            (-0.5, 0.95),
            (-2.0, 1.3),
            (-2.95, 0.95),
            (-3.2, 0.2),
            (-0.6, 0.1),
            (-1.0, 0.7),
        ];
        for (angle, (forward, out)) in (0u32..).zip(places) {
            let at = beside(&punch, forward, out, f64::from(angle));
            for solid in [punch.clone(), ball()] {
                let touch = solid.touch(&at).expect("a normal");
                assert!((touch.gap - solid.gap(&at)).abs() < 1e-15);
                assert!((touch.normal.norm() - 1.0).abs() < 1e-14);
                assert!((touch.curvature * touch.normal).norm() < 1e-14);
                let h = 1e-5;
                for axis in 0..3 {
                    let mut step = Vector3::zeros();
                    step[axis] = h;
                    let (plus, minus) = (at + step, at - step);
                    let slope = (solid.gap(&plus) - solid.gap(&minus)) / (2.0 * h);
                    assert!(
                        (slope - touch.normal[axis]).abs() < 1e-9,
                        "at {forward} {out}"
                    );
                    let normal = |point| solid.touch(&point).expect("a normal").normal;
                    let turn = (normal(plus) - normal(minus)) / (2.0 * h);
                    let error = (turn - touch.curvature.column(axis)).norm();
                    assert!(error < 1e-8, "at {forward} {out}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn distances_are_those_of_a_rounded_bar() {
        let punch = punch();
        // In front of the flat face and beside the bar, plainly; from the rim's circle, Pythagoras.
        for (forward, out, expected) in [
            (0.25, 0.5, 0.25),
            (0.0, 0.8, 0.0),
            (-1.0, 1.5, 0.5),
            (0.1, 1.2, 0.5 - 0.2),
            (-3.3, 1.2, (0.5f64 * 0.5 + 0.4 * 0.4).sqrt() - 0.2),
            (-0.1, 0.0, -0.1),
            (-0.5, 0.7, -0.3),
        ] {
            let gap = punch.gap(&beside(&punch, forward, out, 1.0));
            assert!((gap - expected).abs() < 1e-14, "{gap}, not {expected}");
        }
    }

    #[test]
    fn there_is_a_normal_everywhere_inside_but_at_the_centre_of_a_ball() {
        let punch = punch();
        for forward in [0.0, -0.1, -0.3, -1.5, -2.9] {
            let touch = punch.touch(&beside(&punch, forward, 0.0, 0.0));
            assert!((touch.expect("a normal").normal.norm() - 1.0).abs() < 1e-14);
        }
        assert!(ball().touch(&ball().centre).is_none());
        assert!(punch.touch(&Vector3::new(f64::NAN, 0.0, 0.0)).is_none());
    }
}
