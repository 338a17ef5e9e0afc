//! Tools: what the hand holds, and one sample of where it is.

mod closed_mesh;
mod crossing;
#[cfg(test)]
mod mesh_tests;

pub use closed_mesh::{ClosedMesh, MOST_TRIANGLES};
pub use crossing::{Crossing, crossing};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Most tools in one model: two hands, each with a tool and a needle.
pub const MAX_TOOLS: usize = 8;

/// Rounding of a punch's rim in its radii, or of a box's edges in its least half size, unless said otherwise: a sharp
/// edge would cut real tissue, and has no normal.
pub const DEFAULT_FILLET: f64 = 0.1;

/// Largest coefficient of friction: nothing has more.
pub const MOST_FRICTION: f64 = 10.0;

/// Where a tool is at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
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

/// What a hand does with a tool besides moving it: by a script, a page, or a pedal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Act {
    /// Closes the jaws of the tool with this id.
    Close(u8),
    /// Opens them.
    Open(u8),
}

impl Act {
    /// Closes or opens the jaws of a tool.
    pub fn of_jaws(tool: u8, closed: bool) -> Self {
        if closed {
            Self::Close(tool)
        } else {
            Self::Open(tool)
        }
    }
}

/// What a rigid tool touches with; convex, but for a mesh.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Radius \[m\]; 0 for a bare point.
        radius_m: f64,
    },
    /// A round bar that ends in a flat face.
    FlatPunch {
        /// Radius of the bar \[m\]; the flat part of its face ends a fillet before.
        radius_m: f64,
        /// Radius of the rounded rim, at both ends of the bar \[m\]; above 0.
        fillet_m: f64,
        /// Length of the bar behind its face \[m\]; at least two fillets.
        length_m: f64,
    },
    /// A round bar with half a ball at both ends: what is no farther than a radius from a segment.
    Capsule {
        /// Radius of the bar and of its ends \[m\]; above 0.
        radius_m: f64,
        /// From the centre of the ball in front to that behind \[m\]; a sphere if it is 0.
        length_m: f64,
    },
    /// A box with rounded edges and corners.
    RoundedBox {
        /// From face to face along the tool's side, across side and axis, and along its axis \[m\], (3); each at least
        /// two fillets.
        size_m: [f64; 3],
        /// Radius of its edges and corners \[m\]; above 0.
        fillet_m: f64,
    },
    /// What is no farther than a fillet from a closed mesh, or inside: its edges are round, and it is larger by the fillet
    /// all around.
    Mesh {
        /// In a frame of its own, whose x is along the tool's side, and z against its axis.
        mesh: Arc<ClosedMesh>,
        /// Radius of the ball that sweeps it \[m\]; above 0.
        fillet_m: f64,
    },
    /// A grip that holds needles and touches nothing.
    Grip,
}

impl Shape {
    /// A punch with the [`DEFAULT_FILLET`].
    pub fn flat_punch(radius_m: f64, length_m: f64) -> Self {
        Self::FlatPunch {
            radius_m,
            fillet_m: DEFAULT_FILLET * radius_m,
            length_m,
        }
    }

    /// A box with the [`DEFAULT_FILLET`].
    pub fn rounded_box(size_m: [f64; 3]) -> Self {
        Self::RoundedBox {
            size_m,
            fillet_m: DEFAULT_FILLET * half_least(&size_m),
        }
    }

    /// A mesh, swept by a ball of so many radii of the largest that it holds: see [`DEFAULT_FILLET`].
    pub fn mesh(mesh: ClosedMesh) -> Self {
        let (_, deep_m) = mesh.deepest_m();
        Self::Mesh {
            fillet_m: DEFAULT_FILLET * deep_m,
            mesh: Arc::new(mesh),
        }
    }

    /// Radius of the ball or of the bar, half the least size of a box, or radius of the largest ball in a mesh \[m\].
    pub fn radius_m(&self) -> f64 {
        match self {
            Self::Sphere { radius_m }
            | Self::FlatPunch { radius_m, .. }
            | Self::Capsule { radius_m, .. } => *radius_m,
            Self::RoundedBox { size_m, .. } => half_least(size_m),
            Self::Mesh { mesh, fillet_m } => mesh.deepest_m().1 + fillet_m,
            Self::Grip => 0.0,
        }
    }

    /// The same shape, its [radius](Self::radius_m) not less than `least_m`; its end or face in front stays where it is. A
    /// mesh is what it is.
    pub(crate) fn at_least(&self, least_m: f64) -> Self {
        match *self {
            Self::Sphere { radius_m } => Self::Sphere {
                radius_m: radius_m.max(least_m),
            },
            Self::FlatPunch {
                radius_m,
                fillet_m,
                length_m,
            } => Self::FlatPunch {
                radius_m: radius_m.max(least_m),
                fillet_m,
                length_m,
            },
            Self::Capsule { radius_m, length_m } => Self::Capsule {
                radius_m: radius_m.max(least_m),
                length_m,
            },
            Self::RoundedBox { size_m, fillet_m } => Self::RoundedBox {
                size_m: size_m.map(|size| size.max(2.0 * least_m)),
                fillet_m,
            },
            Self::Mesh { .. } | Self::Grip => self.clone(),
        }
    }

    /// Whether it is not the same all around its axis.
    fn has_side(&self) -> bool {
        match self {
            Self::RoundedBox { .. } | Self::Mesh { .. } => true,
            Self::Sphere { .. } | Self::FlatPunch { .. } | Self::Capsule { .. } | Self::Grip => {
                false
            }
        }
    }

    /// Why nothing can be touched with it, if so.
    fn flaw(&self) -> Option<String> {
        match *self {
            Self::Grip => None,
            Self::Sphere { radius_m } if radius_m.is_finite() && radius_m >= 0.0 => None,
            Self::Sphere { radius_m } => Some(format!(
                "the radius is {radius_m} m; it must be finite and not below zero"
            )),
            Self::FlatPunch {
                radius_m,
                fillet_m,
                length_m,
            } => {
                if !(radius_m.is_finite() && radius_m > 0.0) {
                    Some(format!(
                        "a punch's radius is {radius_m} m; it must be above zero"
                    ))
                } else if !(fillet_m > 0.0 && fillet_m <= radius_m) {
                    Some(format!(
                        "the fillet is {fillet_m} m; it must be above zero and at most the radius of {radius_m} m"
                    ))
                } else if !(length_m.is_finite() && length_m >= 2.0 * fillet_m) {
                    Some(format!(
                        "a punch is {length_m} m long; it must have room for two fillets of {fillet_m} m"
                    ))
                } else {
                    None
                }
            }
            Self::Capsule { radius_m, length_m } => {
                if !(radius_m.is_finite() && radius_m > 0.0) {
                    Some(format!(
                        "a capsule's radius is {radius_m} m; it must be above zero"
                    ))
                } else if !(length_m.is_finite() && length_m >= 0.0) {
                    Some(format!(
                        "a capsule is {length_m} m long from centre to centre of its ends; it must be finite and not below zero"
                    ))
                } else {
                    None
                }
            }
            Self::Mesh { fillet_m, .. } => {
                let is_sound = fillet_m.is_finite() && fillet_m > 0.0;
                (!is_sound)
                    .then(|| format!("a mesh's fillet is {fillet_m} m; it must be above zero"))
            }
            Self::RoundedBox { size_m, fillet_m } => {
                if !(fillet_m.is_finite() && fillet_m > 0.0) {
                    Some(format!(
                        "a box's fillet is {fillet_m} m; it must be above zero"
                    ))
                } else if !size_m
                    .iter()
                    .all(|size| size.is_finite() && *size >= 2.0 * fillet_m)
                {
                    Some(format!(
                        "a box has the size {size_m:?} m; every side must have room for two fillets of {fillet_m} m"
                    ))
                } else {
                    None
                }
            }
        }
    }
}

/// Half the least size of a box \[m\].
fn half_least(size_m: &[f64; 3]) -> f64 {
    0.5 * size_m.iter().copied().fold(f64::INFINITY, f64::min)
}

/// A shape fixed to the grip.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    /// What touches.
    pub shape: Shape,
    /// Centre of the ball, of that at a capsule's front end, or of the front face of a punch or a box, or origin of a mesh, in
    /// the frame of the grip \[m\], (3).
    pub offset_m: [f64; 3],
    /// Where the front of a punch, a capsule or a box looks, or -z of a mesh, unit vector in the frame of the grip, (3). A
    /// ball ignores it.
    pub axis: [f64; 3],
    /// Where the first side of a box looks, or x of a mesh, unit vector across the axis in the frame of the grip, (3). What
    /// is round ignores it.
    pub side: [f64; 3],
    /// Coulomb's coefficient while it slides over tissue; 0 for none.
    pub friction: f64,
    /// The same while it sticks; not above `friction`: as that.
    pub static_friction: f64,
}

impl Tool {
    /// Where a shape looks unless said otherwise: down.
    pub const DEFAULT_AXIS: [f64; 3] = [0.0, 0.0, -1.0];
    /// Where the side of a box looks unless said otherwise: the sizes of one that looks down are those along x, y and z.
    pub const DEFAULT_SIDE: [f64; 3] = [1.0, 0.0, 0.0];

    /// A shape at `offset_m` from the grip that looks down.
    pub fn new(shape: Shape, offset_m: [f64; 3]) -> Self {
        Self {
            shape,
            offset_m,
            axis: Self::DEFAULT_AXIS,
            side: Self::DEFAULT_SIDE,
            friction: 0.0,
            static_friction: 0.0,
        }
    }

    /// The same with Coulomb friction, sliding and sticking.
    pub fn with_friction(self, friction: f64, static_friction: f64) -> Self {
        Self {
            friction,
            static_friction,
            ..self
        }
    }

    /// Whether it rubs nothing.
    pub fn is_smooth(&self) -> bool {
        self.friction.max(self.static_friction) == 0.0
    }

    /// Whether it touches nothing.
    pub fn is_grip(&self) -> bool {
        matches!(self.shape, Shape::Grip)
    }

    /// A ball at `offset_m` from the grip.
    pub fn sphere(radius_m: f64, offset_m: [f64; 3]) -> Self {
        Self::new(Shape::Sphere { radius_m }, offset_m)
    }

    /// A unit vector across the axis in the frame of the grip: the side as far as that lies across it, for pictures, which need one
    /// of what is round, too.
    pub(crate) fn side_across(&self) -> Vector3<f64> {
        let (axis, side) = (Vector3::from(self.axis), Vector3::from(self.side));
        let rest = side - axis * axis.dot(&side);
        let other = || axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
        rest.try_normalize(1e-6).unwrap_or_else(other)
    }

    /// See [`Shape::radius_m`].
    pub fn radius_m(&self) -> f64 {
        self.shape.radius_m()
    }

    /// Where the shape is while the grip is at `sample`; `None` if that is no pose: a number that is
    /// not finite, or a quaternion without length.
    pub(crate) fn place(&self, sample: &ToolSample) -> Option<Placement> {
        let [x, y, z, w] = sample.orientation;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
        let centre = Vector3::from(sample.position_m) + rotation * Vector3::from(self.offset_m);
        // Squared as well: beyond that no distance can be computed.
        let finite =
            centre.norm_squared().is_finite() && rotation.coords.iter().all(|x| x.is_finite());
        finite.then_some(Placement { centre, rotation })
    }

    /// A sample of it, with its grip where the tool is at a placement.
    pub(crate) fn sample_at(&self, placement: &Placement, sample: &ToolSample) -> ToolSample {
        let Placement { centre, rotation } = placement;
        ToolSample {
            position_m: (centre - rotation * Vector3::from(self.offset_m)).into(),
            orientation: rotation.coords.into(),
            ..*sample
        }
    }

    /// Why it cannot be used, if so.
    pub(crate) fn flaw(&self) -> Option<String> {
        if let Some(flaw) = self.shape.flaw() {
            return Some(flaw);
        }
        if !self.offset_m.iter().all(|x| x.is_finite()) {
            return Some(format!(
                "the offset is {:?} m; it must be finite",
                self.offset_m
            ));
        }
        for (what, value) in [
            ("friction", self.friction),
            ("static friction", self.static_friction),
        ] {
            if !(0.0..=MOST_FRICTION).contains(&value) {
                return Some(format!(
                    "the {what} is {value}; it must be between 0 and {MOST_FRICTION}"
                ));
            }
        }
        let directions = [("axis", self.axis), ("side", self.side)];
        for (what, direction) in directions {
            let length = Vector3::from(direction).norm();
            if length.is_nan() || (length - 1.0).abs() > 1e-6 {
                return Some(format!(
                    "the {what} {direction:?} has the length {length}, not 1"
                ));
            }
        }
        let along = Vector3::from(self.axis).dot(&Vector3::from(self.side));
        (self.shape.has_side() && along.abs() > 1e-6).then(|| {
            format!(
                "the side {:?} is not across the axis {:?}: their product is {along}, not 0",
                self.side, self.axis
            )
        })
    }
}

/// Where a tool's shape is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Placement {
    /// Where the tool's offset is \[m\], world frame.
    pub centre: Vector3<f64>,
    /// Grip to world.
    pub rotation: UnitQuaternion<f64>,
}

impl Placement {
    /// How far the angle to `other` turns \[rad\], 0 to pi.
    pub fn angle_to(&self, other: &Self) -> f64 {
        (other.rotation * self.rotation.inverse()).angle()
    }

    /// A part of the way to `other`: straight, and about one axis; all of it is exactly `other`.
    pub fn towards(&self, other: &Self, part: f64) -> Self {
        if part >= 1.0 {
            return *other;
        }
        let turn = (other.rotation * self.rotation.inverse()).scaled_axis() * part;
        Self {
            centre: self.centre.lerp(&other.centre, part),
            rotation: UnitQuaternion::from_scaled_axis(turn) * self.rotation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_without_an_inside_or_a_normal_are_refused() {
        let punch = |radius_m, fillet_m, length_m| {
            let shape = Shape::FlatPunch {
                radius_m,
                fillet_m,
                length_m,
            };
            Tool::new(shape, [0.0; 3]).flaw()
        };
        assert_eq!(punch(0.01, 0.001, 0.03), None);
        for (radius, fillet, length, word) in [
            (0.0, 0.001, 0.03, "radius"),
            (f64::NAN, 0.001, 0.03, "radius"),
            (0.01, 0.0, 0.03, "fillet"),
            (0.01, 0.02, 0.03, "fillet"),
            (0.01, 0.001, 0.001, "long"),
        ] {
            let flaw = punch(radius, fillet, length).expect("a flaw");
            assert!(flaw.contains(word), "{flaw}");
        }
        let mut tool = Tool::sphere(0.01, [0.0; 3]);
        tool.axis = [0.0, 0.0, -2.0];
        assert!(tool.flaw().expect("a flaw").contains("axis"));
    }

    #[test]
    fn capsules_and_boxes_without_room_are_refused() {
        let capsule = |radius_m, length_m| Shape::Capsule { radius_m, length_m }.flaw();
        assert_eq!(capsule(0.01, 0.0), None);
        let cuboid = |size_m, fillet_m| Shape::RoundedBox { size_m, fillet_m }.flaw();
        assert_eq!(cuboid([0.01, 0.02, 0.03], 0.005), None);
        for (flaw, words) in [
            (capsule(0.0, 0.01), "radius is 0 m"),
            (capsule(f64::INFINITY, 0.01), "radius is inf m"),
            (capsule(0.01, -0.01), "-0.01 m long"),
            (capsule(0.01, f64::NAN), "NaN m long"),
            (cuboid([0.01, 0.02, 0.03], 0.0), "fillet is 0 m"),
            (cuboid([0.01, 0.02, 0.03], 0.006), "two fillets of 0.006 m"),
            (cuboid([0.01, f64::NAN, 0.03], 0.001), "NaN"),
            (cuboid([0.01, f64::INFINITY, 0.03], 0.001), "inf"),
        ] {
            let flaw = flaw.expect("a flaw");
            assert!(flaw.contains(words), "{flaw}");
        }
        let mut tool = Tool::new(Shape::rounded_box([0.01; 3]), [0.0; 3]);
        assert_eq!(tool.flaw(), None);
        tool.side = [0.0, 0.6, 0.8];
        assert!(tool.flaw().expect("a flaw").contains("not across the axis"));
        tool.side = [0.0, 0.5, 0.0];
        assert!(tool.flaw().expect("a flaw").contains("the length 0.5"));
        // What is round has no side.
        tool.shape = Shape::Capsule {
            radius_m: 0.01,
            length_m: 0.01,
        };
        tool.side = tool.axis;
        assert_eq!(tool.flaw(), None);
    }

    #[test]
    fn a_thin_box_grows_to_what_vertices_can_feel() {
        let thin = Shape::RoundedBox {
            size_m: [0.02, 0.001, 0.03],
            fillet_m: 0.0005,
        };
        let expected = Shape::RoundedBox {
            size_m: [0.02, 0.006, 0.03],
            fillet_m: 0.0005,
        };
        assert_eq!(thin.at_least(0.003), expected);
        assert_eq!((thin.radius_m(), expected.radius_m()), (0.0005, 0.003));
    }

    #[test]
    fn a_path_in_pieces_ends_where_it_should() {
        let from = Placement {
            centre: Vector3::new(1.0, 2.0, 3.0),
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -2.0, 0.5)),
        };
        // The same rotation with the other sign of the quaternion is no way at all.
        let flipped = UnitQuaternion::new_unchecked(-from.rotation.into_inner());
        let same = Placement {
            rotation: flipped,
            ..from
        };
        assert!(from.angle_to(&same) < 1e-7);
        let to = Placement {
            centre: Vector3::zeros(),
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.7, 0.0)) * flipped,
        };
        let half = from.towards(&to, 0.5);
        assert!((from.angle_to(&half) - 0.35).abs() < 1e-12);
        assert!((half.angle_to(&to) - 0.35).abs() < 1e-12);
        assert_eq!(from.towards(&to, 1.0), to);
    }
}
