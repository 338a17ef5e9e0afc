//! Straight needles, circular arcs, and what is made of several of both, in one arc-length parametrisation.
//!
//! Entry points: [`Needle`], [`Needle::at`], [`Curve`]. Source: Younes 2021, 3.1.1. In the needle's own
//! frame the end is the origin, the tangent there is +x, and an arc bends towards +y:
//! `s(alpha) = (r sin(alpha / r), r (1 - cos(alpha / r)), 0)`, a straight needle being its limit. Segments go on from each
//! other with the same tangent, in one plane.

use nalgebra::{Isometry3, Point3, Vector3};

/// Most segments of a needle.
pub const MOST_SEGMENTS: usize = 6;

/// A straight or circular part of a needle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeedleSegment {
    /// Arc length \[m\].
    pub length_m: f64,
    /// Of the circle \[m\]; infinite if it is straight.
    pub radius_m: f64,
}

/// Segments of a needle, from its end to its tip: at least one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleSegments {
    each: [NeedleSegment; MOST_SEGMENTS],
    count: usize,
}

impl NeedleSegments {
    /// So many of them, from end to tip; `None` for none, or more than [`MOST_SEGMENTS`].
    pub fn new(segments: &[NeedleSegment]) -> Option<Self> {
        let mut each = [NeedleSegment::default(); MOST_SEGMENTS];
        let count = segments.len();
        each.get_mut(..count)?.copy_from_slice(segments);
        (count > 0).then_some(Self { each, count })
    }

    /// From end to tip.
    pub fn each(&self) -> &[NeedleSegment] {
        &self.each[..self.count]
    }
}

/// Centre line of a needle, from the end (alpha = 0) to the tip (alpha = length).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NeedleShape {
    /// A straight needle.
    Straight {
        /// From end to tip \[m\].
        length_m: f64,
    },
    /// A part of a circle.
    Arc {
        /// Of the circle \[m\].
        radius_m: f64,
        /// From end to tip \[rad\], less than a whole turn.
        angle_rad: f64,
    },
    /// Straight and circular parts, each with the tangent of the one before it where they meet, all bending to one side:
    /// together by less than a whole turn.
    Segments(NeedleSegments),
}

impl NeedleShape {
    /// Arc length from end to tip \[m\].
    pub fn length_m(&self) -> f64 {
        match *self {
            Self::Straight { length_m } => length_m,
            Self::Arc {
                radius_m,
                angle_rad,
            } => radius_m * angle_rad,
            Self::Segments(segments) => {
                let lengths = segments.each().iter().map(|segment| segment.length_m);
                lengths.sum()
            }
        }
    }

    /// 1 / radius at the end \[1/m\]; 0 where it is straight.
    pub fn curvature_per_m(&self) -> f64 {
        match *self {
            Self::Straight { .. } => 0.0,
            Self::Arc { radius_m, .. } => radius_m.recip(),
            Self::Segments(segments) => {
                let first = segments.each().first();
                first.map_or(0.0, |first| first.radius_m.recip())
            }
        }
    }

    /// Whether any of it is not straight.
    pub fn bends(&self) -> bool {
        match self {
            Self::Segments(segments) => {
                let mut each = segments.each().iter();
                each.any(|segment| segment.radius_m.is_finite())
            }
            _ => self.curvature_per_m() > 0.0,
        }
    }

    /// Where segments meet.
    fn joints(&self) -> Joints {
        let mut joints = Joints::default();
        if let Self::Segments(segments) = self {
            let mut alpha = 0.0;
            let pairs = segments.each().windows(2);
            for (joint, pair) in joints.each.iter_mut().zip(pairs) {
                let [before, after] = pair else { continue };
                alpha += before.length_m;
                *joint = (alpha, after.radius_m.recip());
                joints.count += 1;
            }
        }
        joints
    }
}

/// A needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needle {
    /// Its centre line.
    pub shape: NeedleShape,
    /// Diameter \[m\]; the tip's area follows from it.
    pub thickness_m: f64,
}

impl Needle {
    /// Area that cuts and punctures \[m^2\].
    pub fn tip_area_m2(&self) -> f64 {
        0.25 * std::f64::consts::PI * self.thickness_m * self.thickness_m
    }

    /// The needle with its frame at `pose`.
    pub fn at(&self, pose: &Isometry3<f64>) -> Curve {
        let along = |v: Vector3<f64>| pose.rotation * v;
        Curve {
            start: pose.translation.vector,
            tangent: along(Vector3::x()),
            inward: along(Vector3::y()),
            curvature: self.shape.curvature_per_m(),
            length: self.shape.length_m(),
            joints: self.shape.joints(),
        }
    }

    /// Why it cannot be used, if so.
    pub fn flaw(&self) -> Option<String> {
        let positive = |what: &str, value: f64| {
            (!(value.is_finite() && value > 0.0)).then(|| {
                format!("the needle's {what} is {value}; it must be above zero and finite")
            })
        };
        let shape = match self.shape {
            NeedleShape::Straight { length_m } => positive("length [m]", length_m),
            NeedleShape::Arc {
                radius_m,
                angle_rad,
            } => positive("radius [m]", radius_m)
                .or_else(|| positive("angle [rad]", angle_rad))
                .or_else(|| {
                    (angle_rad >= std::f64::consts::TAU).then(|| {
                        format!(
                            "the needle's arc is {} degrees; a whole turn, 360, is too much",
                            angle_rad.to_degrees()
                        )
                    })
                }),
            NeedleShape::Segments(segments) => {
                let flaw = |segment: &NeedleSegment| {
                    let radius_m = segment.radius_m;
                    let is_straight = radius_m == f64::INFINITY;
                    positive("segment's length [m]", segment.length_m).or_else(|| {
                        let radius = || positive("segment's radius [m]", radius_m);
                        if is_straight { None } else { radius() }
                    })
                };
                let each = segments.each();
                let turn: f64 = each.iter().map(|one| one.length_m / one.radius_m).sum();
                each.iter().find_map(flaw).or_else(|| {
                    (turn >= std::f64::consts::TAU).then(|| {
                        format!(
                            "the needle's segments turn by {} degrees; a whole turn, 360, is too much",
                            turn.to_degrees()
                        )
                    })
                })
            }
        };
        shape.or_else(|| positive("thickness [m]", self.thickness_m))
    }
}

/// How tissue answers a needle. Zero everywhere: it slides as if there were nothing but its way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeedleTissue {
    /// Axial force per length of needle in tissue while it slides \[N/m\].
    pub friction_n_per_m: f64,
    /// The same before it begins to slide \[N/m\], at least `friction_n_per_m`.
    pub static_friction_n_per_m: f64,
    /// Added to the sliding friction per speed \[N s/m^2\].
    pub viscous_n_s_per_m2: f64,
    /// Force on the tip that cuts on \[N/m^2\], per area of the tip.
    pub cutting_pa: f64,
    /// Axial force on the tip that breaks through a boundary face \[N/m^2\], per area of the tip;
    /// infinite: never. Where the surface's friction is finite it is the force across the face that counts, from outside.
    pub puncture_pa: f64,
    /// Coulomb's coefficient of the needle on the surface, from outside \[1\]; infinite: it never slips.
    pub surface_friction: f64,
}

/// Where the curvature of a curve changes, and to what.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joints {
    /// alpha \[m\], ascending, and 1 / radius from there on \[1/m\].
    each: [(f64, f64); MOST_SEGMENTS - 1],
    count: usize,
}

impl Joints {
    fn all(&self) -> &[(f64, f64)] {
        &self.each[..self.count]
    }
}

/// A part of a curve that is one line or arc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    /// By itself: its own alpha is 0 where it begins.
    pub curve: Curve,
    /// Where it begins and ends on the whole \[m\].
    pub span: [f64; 2],
}

/// Where a needle, or any line or arc, is: s(alpha), arc length \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// s(0) \[m\].
    pub start: Vector3<f64>,
    /// Unit tangent at alpha = 0.
    pub tangent: Vector3<f64>,
    /// Unit vector from s(0) to the circle's centre; any unit vector across a line's tangent.
    pub inward: Vector3<f64>,
    /// 1 / radius \[1/m\], up to the first joint; 0 for a line.
    pub curvature: f64,
    /// Largest alpha \[m\].
    pub length: f64,
    /// Where it changes from one line or circle to another: nowhere for most.
    pub joints: Joints,
}

impl Curve {
    /// From one point straight to another; `None` if they are the same.
    pub fn segment(from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Self> {
        let way = to - from;
        let length = way.norm();
        let tangent = way.try_normalize(f64::MIN_POSITIVE)?;
        // Across the tangent, away from its largest entry.
        let aside = Vector3::ith(tangent.iamin(), 1.0);
        let inward = (aside - tangent * tangent.dot(&aside)).normalize();
        Some(Self {
            start: *from,
            tangent,
            inward,
            curvature: 0.0,
            length,
            joints: Joints::default(),
        })
    }

    /// How many lines and arcs it is made of.
    pub(crate) fn pieces(&self) -> usize {
        1 + self.joints.count
    }

    /// The number of the piece that has alpha; beyond both ends the first and the last go on.
    pub(crate) fn number_at(&self, alpha: f64) -> usize {
        let joints = self.joints.all();
        joints.partition_point(|(joint, _)| *joint <= alpha)
    }

    /// One of its pieces.
    pub(crate) fn piece(&self, number: usize) -> Piece {
        let joints = self.joints.all();
        let end = |place: usize| joints.get(place).map_or(self.length, |(alpha, _)| *alpha);
        let mut piece = Piece {
            curve: Self {
                length: end(0),
                joints: Joints::default(),
                ..*self
            },
            span: [0.0, end(0)],
        };
        for (place, (alpha, curvature)) in joints.iter().enumerate().take(number) {
            let before = piece.curve;
            let length = before.length;
            piece.span = [*alpha, end(place + 1)];
            piece.curve = Self {
                start: before.at(length),
                tangent: before.tangent_at(length),
                inward: before.inward_at(length),
                curvature: *curvature,
                length: piece.span[1] - alpha,
                ..before
            };
        }
        piece
    }

    /// The line or circle that has alpha, and alpha on that.
    fn part(&self, alpha: f64) -> (Self, f64) {
        let piece = self.piece(self.number_at(alpha));
        (piece.curve, alpha - piece.span[0])
    }

    /// The line or circle that its middle is on: all of it, for most.
    pub(crate) fn middle_piece(&self) -> Self {
        self.piece(self.number_at(0.5 * self.length)).curve
    }

    /// Whether any of it is not straight.
    pub fn bends(&self) -> bool {
        let mut beyond = self.joints.all().iter();
        self.curvature != 0.0 || beyond.any(|(_, curvature)| *curvature != 0.0)
    }

    /// 1 / radius at alpha \[1/m\].
    pub fn curvature_at(&self, alpha: f64) -> f64 {
        match self.number_at(alpha).checked_sub(1) {
            Some(joint) => self.joints.each[joint].1,
            None => self.curvature,
        }
    }

    /// Largest 1 / radius on it \[1/m\].
    pub(crate) fn most_curvature(&self) -> f64 {
        let joints = self.joints.all().iter().map(|(_, curvature)| *curvature);
        joints.fold(self.curvature, f64::max)
    }

    /// s(alpha) \[m\], also beyond both ends.
    pub fn at(&self, alpha: f64) -> Vector3<f64> {
        if self.joints.count > 0 {
            let (part, alpha) = self.part(alpha);
            return part.at(alpha);
        }
        if self.curvature == 0.0 {
            return self.start + self.tangent * alpha;
        }
        let (sin, cos) = (alpha * self.curvature).sin_cos();
        self.start + (self.tangent * sin + self.inward * (1.0 - cos)) / self.curvature
    }

    /// Unit tangent at alpha, towards the tip: d s / d alpha.
    pub fn tangent_at(&self, alpha: f64) -> Vector3<f64> {
        if self.joints.count > 0 {
            let (part, alpha) = self.part(alpha);
            return part.tangent_at(alpha);
        }
        if self.curvature == 0.0 {
            return self.tangent;
        }
        let (sin, cos) = (alpha * self.curvature).sin_cos();
        self.tangent * cos + self.inward * sin
    }

    /// Unit vector at alpha across the tangent in the curve's plane, towards the centre of an arc.
    pub fn inward_at(&self, alpha: f64) -> Vector3<f64> {
        if self.joints.count > 0 {
            let (part, alpha) = self.part(alpha);
            return part.inward_at(alpha);
        }
        if self.curvature == 0.0 {
            return self.inward;
        }
        let (sin, cos) = (alpha * self.curvature).sin_cos();
        self.inward * cos - self.tangent * sin
    }

    /// Unit normal of the curve's plane.
    pub fn binormal(&self) -> Vector3<f64> {
        self.tangent.cross(&self.inward)
    }

    /// Tangent, inward and binormal at alpha: orthonormal, right-handed.
    pub fn frame_at(&self, alpha: f64) -> [Vector3<f64>; 3] {
        [
            self.tangent_at(alpha),
            self.inward_at(alpha),
            self.binormal(),
        ]
    }

    /// alpha of the nearest point on the whole line, or on the circle within half a turn of `near`
    /// (3.9; 3.12 to 3.17): the uniform slide of a grip is the difference to where it was. Of several pieces on that of
    /// `near`, or, where that has its foot beyond a joint, on the next.
    pub fn project(&self, point: &Vector3<f64>, near: f64) -> f64 {
        if self.joints.count > 0 {
            return self.project_on_pieces(point, near);
        }
        let from = point - self.start;
        if self.curvature == 0.0 {
            return from.dot(&self.tangent);
        }
        let radius = self.curvature.recip();
        let centre = self.at(near) + self.inward_at(near) * radius;
        let from = point - centre;
        let (along, out) = (
            from.dot(&self.tangent_at(near)),
            -from.dot(&self.inward_at(near)),
        );
        near + radius * along.atan2(out)
    }

    fn project_on_pieces(&self, point: &Vector3<f64>, near: f64) -> f64 {
        let first = self.number_at(near);
        let (mut number, last) = (first, self.pieces() - 1);
        let mut near = near;
        loop {
            let Piece { curve, span } = self.piece(number);
            let alpha = span[0] + curve.project(point, near - span[0]);
            // Between two pieces that both have it beyond the other it is in their joint.
            if alpha < span[0] && number > 0 {
                if number > first {
                    return span[0];
                }
                (number, near) = (number - 1, span[0]);
            } else if alpha > span[1] && number < last {
                if number < first {
                    return span[1];
                }
                (number, near) = (number + 1, span[1]);
            } else {
                return alpha;
            }
        }
    }

    /// The point between end and tip that is nearest to a place \[m\].
    pub fn nearest(&self, to: &Vector3<f64>) -> Vector3<f64> {
        if self.joints.count > 0 {
            let each = (0..self.pieces()).map(|number| self.piece(number).curve.nearest(to));
            let distance = |at: &Vector3<f64>| (at - to).norm_squared();
            let nearest = each.min_by(|a, b| distance(a).total_cmp(&distance(b)));
            return nearest.unwrap_or(self.start);
        }
        let half = 0.5 * self.length;
        let inner = self.project(to, half).clamp(0.0, self.length);
        let places = [0.0, inner, self.length].map(|alpha| self.at(alpha));
        let [first, ..] = places;
        places.into_iter().fold(first, |best, next| {
            let is_nearer = (next - to).norm_squared() < (best - to).norm_squared();
            if is_nearer { next } else { best }
        })
    }
}

/// A point with a frame, as an isometry.
impl From<&Curve> for Isometry3<f64> {
    fn from(curve: &Curve) -> Self {
        let axes =
            nalgebra::Matrix3::from_columns(&[curve.tangent, curve.inward, curve.binormal()]);
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(axes);
        Self::from_parts(Point3::from(curve.start).into(), rotation.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segments(each: &[(f64, f64)]) -> Option<NeedleSegments> {
        let each = each.iter();
        let each = each.map(|&(length_m, radius_m)| NeedleSegment { length_m, radius_m });
        NeedleSegments::new(&each.collect::<Vec<_>>())
    }

    fn needles() -> [Needle; 3] {
        let thickness_m = 0.8e-3;
        let ski = [
            (0.007, f64::INFINITY),
            (0.004, 0.02),
            (0.005, f64::INFINITY),
            (0.006, 0.008),
        ];
        [
            NeedleShape::Segments(segments(&ski).expect("four")),
            NeedleShape::Straight { length_m: 0.04 },
            NeedleShape::Arc {
                radius_m: 0.012,
                angle_rad: 3.0,
            },
        ]
        .map(|shape| Needle { shape, thickness_m })
    }

    fn pose() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.3, -0.1, 0.2), Vector3::new(0.4, 1.1, -0.7))
    }

    #[test]
    fn frames_are_the_derivatives_of_the_curve() {
        let h = 1e-6;
        for needle in needles() {
            let curve = needle.at(&pose());
            for part in [0.0, 0.3, 1.0, 1.2] {
                let alpha = part * curve.length;
                let slope = (curve.at(alpha + h) - curve.at(alpha - h)) / (2.0 * h);
                let bend = (curve.tangent_at(alpha + h) - curve.tangent_at(alpha - h)) / (2.0 * h);
                let [tangent, inward, binormal] = curve.frame_at(alpha);
                assert!((slope - tangent).norm() < 5e-9);
                let curvature = curve.curvature_at(alpha);
                // What a difference over 2 h leaves out.
                let within = (h * curvature).powi(2) * curvature / 5.0 + 1e-9;
                assert!((bend - inward * curvature).norm() < within);
                assert!((tangent.cross(&inward) - binormal).norm() < 1e-14);
            }
        }
    }

    #[test]
    fn a_point_beside_the_curve_projects_to_its_foot() {
        for needle in needles() {
            let curve = needle.at(&pose());
            for part in [0.0, 0.4, 1.0] {
                let alpha = part * curve.length;
                let [_, inward, binormal] = curve.frame_at(alpha);
                let beside = curve.at(alpha) + inward * 1e-3 + binormal * 2e-3;
                let found = curve.project(&beside, alpha + 1e-3);
                assert!((found - alpha).abs() < 1e-15, "{found} for {alpha}");
            }
        }
    }

    #[test]
    fn a_pose_is_the_frame_of_its_curve() {
        for needle in needles() {
            let back = Isometry3::from(&needle.at(&pose()));
            assert!((back.to_homogeneous() - pose().to_homogeneous()).norm() < 1e-14);
        }
    }

    #[test]
    fn needles_without_a_shape_are_refused() {
        let [ski, straight, arc] = needles();
        assert_eq!(ski.flaw(), None);
        assert_eq!(straight.flaw(), None);
        assert_eq!(arc.flaw(), None);
        let flaw = |shape, thickness_m| Needle { shape, thickness_m }.flaw().expect("a flaw");
        assert!(flaw(NeedleShape::Straight { length_m: -1.0 }, 1e-3).contains("length"));
        assert!(flaw(straight.shape, f64::NAN).contains("thickness"));
        let arc = |radius_m, angle_rad| NeedleShape::Arc {
            radius_m,
            angle_rad,
        };
        assert!(flaw(arc(0.0, 1.0), 1e-3).contains("radius"));
        assert!(flaw(arc(0.01, 6.3), 1e-3).contains("360"));
        let of = |each: &[(f64, f64)]| NeedleShape::Segments(segments(each).expect("some"));
        assert!(flaw(of(&[(0.01, 0.01), (0.0, 0.01)]), 1e-3).contains("length"));
        assert!(flaw(of(&[(0.01, 0.01), (0.01, -0.01)]), 1e-3).contains("radius"));
        assert!(flaw(of(&[(0.04, 0.01), (0.03, 0.01)]), 1e-3).contains("360"));
        assert_eq!((segments(&[]), segments(&[(1.0, 1.0); 7])), (None, None));
    }

    /// Two halves of a line or an arc are the whole.
    #[test]
    fn segments_that_are_alike_are_one() {
        for (whole, radius_m) in needles().into_iter().skip(1).zip([f64::INFINITY, 0.012]) {
            let half = 0.5 * whole.shape.length_m();
            let both = segments(&[(half, radius_m), (half, radius_m)]).expect("two");
            let shape = NeedleShape::Segments(both);
            let [one, two] = [whole, Needle { shape, ..whole }].map(|needle| needle.at(&pose()));
            for part in [-0.2, 0.0, 0.3, 0.5, 0.7, 1.0, 1.2] {
                let alpha = part * one.length;
                let [a, b] = [one, two].map(|curve| (curve.at(alpha), curve.frame_at(alpha)));
                assert!((a.0 - b.0).norm() < 1e-15 && (a.1[0] - b.1[0]).norm() < 1e-14);
                let beside = a.0 + a.1[1] * 1e-3;
                for near in [0.2, 0.5, 0.8] {
                    let found = two.project(&beside, near * two.length);
                    assert!((found - alpha).abs() < 1e-15, "{found} for {alpha}");
                }
                assert!((one.nearest(&beside) - two.nearest(&beside)).norm() < 1e-15);
            }
        }
    }
}
