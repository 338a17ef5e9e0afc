//! The local shape of a round body: how its normal turns along a way, and how deep a place is against the turned normal.
//!
//! Entry points: [`Shape::of_contact`], [`Shape::of_normals`], then [`Shape::turn`]. With the curvature k of the skin under the force,
//! t . K t / |f| along a tangential direction t, the centre of the turn is 1/k below it. A way with the part h along the normal n and the
//! part a across it ends at the distance `r = ((1 + k h)^2 + k^2 a^2)^(1/2) / k` from that centre: the normal there is
//! `((1 + k h) n + k a) / (k r)`, and the place is `r - 1/k` higher. Both are exact on balls and cylinders.

use super::bend::product;
use crate::math::{Vec3, dot, max};

/// Force below which a contact's own tangent does not tell its curvature \[N\].
const LIGHT_N: f32 = 0.05;
/// Square of the shortest way on which a normal turns noticeably \[m^2\]; squares of shorter ways underflow.
const NOTHING: f32 = 1e-6 * 1e-6;
/// Closest place to the centre of a turn, as a part of the radius: a direction from nearer ones means nothing, and is shortened.
const CENTRE: f32 = 0.1;
/// Sine of the least angle between two normals that tells a curvature, and cosine of the largest.
const APART: (f32, f32) = (0.03, -0.5);
/// Difference between the heights that two normals foretell and that came, as a part of the radius, from which on they are not of
/// one round body.
const ANOTHER: f32 = 0.25;

/// A place beside the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Skin {
    /// \[m\].
    pub place_m: Vec3,
    /// Out of the tissue, unit vector.
    pub normal: Vec3,
    /// Height over the skin \[m\], negative inside.
    pub height_m: f32,
}

impl Skin {
    /// Sine of the angle between the normals here and at another place, and its part of this direction; none where they are too near or too
    /// far from one another to tell a curvature.
    fn turned_since(&self, other: &Skin) -> Option<(f32, Vec3)> {
        let cosine = dot(&other.normal, &self.normal);
        let across = self.normal * cosine - other.normal;
        let sine = libm::sqrtf(dot(&across, &across));
        (sine >= APART.0 && cosine >= APART.1).then_some((sine, across))
    }

    /// Whether both places together tell a curvature, or their normals are too far apart for that.
    pub fn is_elsewhere(&self, other: &Skin) -> bool {
        let cosine = dot(&other.normal, &self.normal);
        cosine < APART.1 || self.turned_since(other).is_some()
    }
}

/// The skin at one place: its normal, and in which direction it is curved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    /// Direction of the force, or out of the tissue, unit vector.
    normal: Vec3,
    /// d force / d position \[N/m\], packed, and that times the normal.
    tangent: [f32; 6],
    steep: Vec3,
    curved: Curved,
}

/// Source of the curvature.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Curved {
    /// The tangent of a force of one over this \[1/N\].
    Force(f32),
    /// Two successive normals: the direction in which they turn, unit vector, and the curvature \[1/m\].
    Normals(Vec3, f32),
}

/// A turn of the normal along a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Turn {
    normal: Vec3,
    /// Part of the way that turns the normal \[m\].
    along: Vec3,
    /// Change of height against the turned normal less the way along the normal itself \[m\].
    raised_m: f32,
    /// Along the turn: entries of the rotation, and the tangent's part that the turn itself makes \[N/m\].
    less_cosine: f32,
    sine_per_m: f32,
    less_per_m2: f32,
    turns_n_per_m: f32,
}

impl Shape {
    /// The shape under a contact's force \[N\] by its tangent; none where the force is light or the body is nowhere convex.
    pub fn of_contact(tangent: &[f32; 6], force: &Vec3) -> Option<Shape> {
        let size_n = libm::sqrtf(dot(force, force));
        if size_n < LIGHT_N {
            return None;
        }
        let per_n = 1.0 / size_n;
        let normal = force * per_n;
        let steep = product(tangent, &normal);
        let [xx, _, _, yy, _, zz] = *tangent;
        (xx + yy + zz > dot(&steep, &normal)).then_some(Shape {
            normal,
            tangent: *tangent,
            steep,
            curved: Curved::Force(per_n),
        })
    }

    /// The shape at one place by the normals there and at another one; none where they do not turn as on one convex body.
    pub fn of_normals(tangent: &[f32; 6], other: &Skin, here: &Skin) -> Option<Shape> {
        let (sine, across) = here.turned_since(other)?;
        let cosine = dot(&other.normal, &here.normal);
        let direction = across * (1.0 / sine);
        // Both places lie on rays from one centre.
        let way = here.place_m - other.place_m;
        let radius_m = dot(&way, &direction) / sine;
        let away_m = dot(&way, &here.normal) + radius_m * cosine;
        let higher_m = here.height_m - other.height_m;
        let wrong_m = (away_m - radius_m - higher_m).abs();
        let is_one = radius_m > 0.0 && away_m > 0.0 && wrong_m < ANOTHER * away_m;
        is_one.then(|| Shape {
            normal: here.normal,
            tangent: *tangent,
            steep: product(tangent, &here.normal),
            curved: Curved::Normals(direction, 1.0 / away_m),
        })
    }

    /// The turn of the normal along a way \[m\]; none where the body is not convex along it.
    pub fn turn(&self, way: &Vec3) -> Option<Turn> {
        let high_m = dot(&self.normal, way);
        let across = way - self.normal * high_m;
        let (along, square, curvature, turns_n_per_m) = match self.curved {
            Curved::Force(per_n) => {
                let pulled = product(&self.tangent, &across);
                let pulled = pulled - self.normal * dot(&self.normal, &pulled);
                let (size, part) = (dot(&pulled, &pulled), dot(&pulled, &across));
                // As steep as the turn is: the largest curvature that the way has a part in.
                let slope = dot(&pulled, &product(&self.tangent, &pulled));
                if part <= 0.0 || slope <= 0.0 || part * part <= NOTHING * size {
                    return None;
                }
                let turns = slope / size;
                let along = pulled * (part / size);
                (along, part * part / size, turns * per_n, turns)
            }
            Curved::Normals(direction, curvature) => {
                let part = dot(&direction, &across);
                if part * part <= NOTHING {
                    return None;
                }
                (direction * part, part * part, curvature, 0.0)
            }
        };
        let up = 1.0 + curvature * high_m;
        let aside = curvature * curvature * square;
        let far = max(libm::sqrtf(up * up + aside), CENTRE);
        let raised_m = (high_m * (1.0 + up) + curvature * square) / (far + 1.0);
        let less_cosine = up / far - 1.0;
        Some(Turn {
            normal: self.normal,
            along,
            raised_m: raised_m - high_m,
            less_cosine,
            sine_per_m: curvature / far,
            less_per_m2: if up > 0.0 {
                -curvature * curvature / (far * (far + up))
            } else {
                less_cosine / square
            },
            turns_n_per_m,
        })
    }

    /// A symmetric matrix, packed, without its part across the normal.
    pub fn along_normal(&self, packed: &[f32; 6]) -> [f32; 6] {
        let steep = product(packed, &self.normal);
        let [x, y, z]: [f32; 3] = self.normal.into();
        let half = steep - self.normal * (0.5 * dot(&steep, &self.normal));
        let [a, b, c]: [f32; 3] = half.into();
        [
            2.0 * x * a,
            x * b + y * a,
            x * c + z * a,
            2.0 * y * b,
            y * c + z * b,
            2.0 * z * c,
        ]
    }

    /// Change of the force that the tangent does not foretell along a turn, before it turns \[N\].
    pub fn lacks(&self, turn: &Turn) -> Vec3 {
        self.steep * turn.raised_m - turn.along * turn.turns_n_per_m
    }
}

impl Turn {
    /// A vector, turned with the normal.
    pub fn turned(&self, v: &Vec3) -> Vec3 {
        let (high, along) = (dot(&self.normal, v), dot(&self.along, v));
        v + self.normal * (self.less_cosine * high - self.sine_per_m * along)
            + self.along * (self.sine_per_m * high + self.less_per_m2 * along)
    }

    /// The vector that it turns into this one.
    pub fn back(&self, v: &Vec3) -> Vec3 {
        let (high, along) = (dot(&self.normal, v), dot(&self.along, v));
        v + self.normal * (self.less_cosine * high + self.sine_per_m * along)
            + self.along * (self.less_per_m2 * along - self.sine_per_m * high)
    }

    /// The way on the skin in the unturned frame: as high as against the turned normal.
    pub fn on_skin(&self, way: &Vec3) -> Vec3 {
        way + self.normal * self.raised_m
    }
}
