//! One frame of the host as a local model: the wrench at another pose, a little later.
//!
//! Entry point: [`LocalContact::force`]. Hold and a line in time (Picinbono and Lombardo 1999) as baselines, a tangent
//! with a gap and relaxation (Otaduy and Lin 2006), exact for a plane spring, to which contact rows, a needle and a
//! thread add what a tangent does not know.

use super::bend::{AXES, Onward, in_axes, product};
use super::round::{Shape, Skin, Turn};
use super::tuning::Rendering;
use super::{MAX_HORIZON_US, STALE_DECAY_US};
use crate::kinematics::Grip;
use crate::math::{Vec3, clamp, dot, max, min, shortened};
use crate::mutant::stands;
use crate::wire::ValidContact;

/// Longest force of a tangent on its own \[N\]: squares stay finite whatever is added to it.
pub(super) const STRONGEST_N: f32 = 1e9;

/// Stiffness below which a force does not tell a depth \[N/m\].
const SOFTEST_N_PER_M: f32 = 1.0;

/// How old a contact may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// There is none.
    Missing,
    /// Within its horizon.
    Fresh,
    /// Beyond its horizon.
    Stale,
    /// So far beyond that the console should no longer wait for another one.
    Lost,
}

/// A frame as the console uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalContact {
    /// Where it was solved for.
    grip: Grip,
    /// Wrench on the tool there \[N, N m\].
    wrench: [f32; 6],
    /// Packed upper triangle of d wrench / d pose, symmetric part.
    tangent: [f32; 21],
    /// Way along `-normal` until the tool touches \[m\].
    gap_m: f32,
    /// Out of the tissue.
    pub normal: Vec3,
    relaxation_per_s: f32,
    horizon_us: u32,
    /// Console time of the state that was solved for \[us\].
    pub console_time_us: u64,
    pub sequence: u32,
    /// Age when it was first applied \[us\].
    pub applied_age_us: u32,
    /// Change of force per second from the frame before this one to this one \[N/s\].
    rate: Vec3,
    /// Largest force \[N\].
    max_force_n: f32,
    /// Spectral norm of d force / d position \[N/m\].
    stiffness: f32,
    /// Stiffness along its normal \[N/m\].
    pub stiffness_out: f32,
}

impl LocalContact {
    /// The model of a frame that arrives at `now_us`.
    pub fn new(frame: &ValidContact, now_us: u64, max_force_n: f32) -> Self {
        let body = frame.body();
        let mut contact = LocalContact {
            grip: Grip {
                position_m: Vec3::from(body.position_m),
                orientation: body.orientation,
            },
            wrench: body.wrench,
            tangent: body.tangent,
            gap_m: body.gap_m,
            normal: Vec3::from(body.normal),
            relaxation_per_s: body.relaxation_per_s,
            horizon_us: if stands("longest_horizon") {
                body.horizon_us.min(MAX_HORIZON_US)
            } else {
                body.horizon_us
            },
            console_time_us: frame.console_time_us(),
            sequence: frame.sequence(),
            applied_age_us: 0,
            rate: Vec3::zeros(),
            max_force_n,
            stiffness: spectral_norm(&translational(&body.tangent)),
            stiffness_out: 0.0,
        };
        contact.stiffness_out = contact.stiffness_along(&contact.normal);
        contact.applied_age_us = contact.age_us(now_us);
        contact
    }

    /// Limits the stiffness along every direction \[N/m\].
    pub fn limit(&mut self, most_n_per_m: f32) {
        if self.stiffness <= most_n_per_m {
            return;
        }
        let told = translational(&self.tangent);
        let limited = softened(told, most_n_per_m);
        let places = [0, 1, 2, 6, 7, 11].into_iter().zip(limited);
        for (place, entry) in places {
            if let Some(packed) = self.tangent.get_mut(place) {
                *packed = entry;
            }
        }
        self.stiffness = min(spectral_norm(&limited), most_n_per_m);
    }

    /// Age of the data \[us\], counted from the console time that was solved for.
    pub fn age_us(&self, now_us: u64) -> u32 {
        let age = now_us.saturating_sub(self.console_time_us);
        // The largest value means "none" on the wire.
        u32::try_from(age).map_or(u32::MAX - 1, |age| age.min(u32::MAX - 1))
    }

    /// For how long it is good \[s\].
    pub fn horizon_s(&self) -> f32 {
        self.horizon_us as f32 * 1e-6
    }

    /// How old the data is, in what it means.
    pub fn freshness(&self, now_us: u64) -> Freshness {
        match self.age_us(now_us).saturating_sub(self.horizon_us) {
            0 => Freshness::Fresh,
            1..=super::LOST_AFTER_US => Freshness::Stale,
            _ if stands("lost") => Freshness::Lost,
            _ => Freshness::Stale,
        }
    }

    /// Whether this was solved for an earlier state than `other`.
    pub fn is_older_than(&self, other: &LocalContact) -> bool {
        self.console_time_us < other.console_time_us
    }

    /// Goes on from the frame before: its force gives the slope of a line in time.
    pub fn follow(&mut self, before: &LocalContact) {
        let span_us = self.console_time_us.saturating_sub(before.console_time_us);
        if span_us > 0 {
            self.rate = (self.own_force() - before.own_force()) * (1e6 / span_us as f32);
        }
    }

    /// Change of force from `before` to this frame \[N\]: as the mean of both tangents tells it, and as it came,
    /// without what had relaxed meanwhile; and the time between them \[s\]. None unless both touch. `shapes`: of this frame and
    /// of `before`, each by its tangent.
    pub fn change_since(
        &self,
        before: &LocalContact,
        shapes: [&Option<Shape>; 2],
    ) -> Option<(Vec3, Vec3, f32)> {
        let touches = |contact: &LocalContact| {
            contact.gap_m <= 0.0 && dot(&contact.normal, &contact.own_force()) > 0.0
        };
        if !touches(self) || !touches(before) {
            return None;
        }
        let moved = self.grip.moved_from(&before.grip);
        let way = self.way_since(before);
        // Only where the tangent tells none are normals asked for.
        let beyond =
            |of: &LocalContact, shape: &Option<Shape>, other: &LocalContact, way: &Vec3| {
                let by_normals = || Shape::of_normals(&of.slope(), &other.skin(), &of.skin());
                match shape {
                    Some(shape) => of.beyond_tangent(shape, way),
                    None => by_normals()
                        .map_or_else(Vec3::zeros, |shape| of.beyond_tangent(&shape, way)),
                }
            };
        let [own, others] = shapes;
        let onward = beyond(before, others, self, &way);
        let back = beyond(self, own, before, &-way);
        let plane = force_of(&self.tangent, &moved) + force_of(&before.tangent, &moved);
        let told = (plane + onward - back) * 0.5;
        let span_us = self.console_time_us.saturating_sub(before.console_time_us);
        let span_us = u32::try_from(span_us).unwrap_or(u32::MAX);
        let came = self.own_force() - before.own_force() * before.relaxed(span_us);
        Some((told, came, span_us as f32 * 1e-6))
    }

    /// Way of the grip from `before` to this frame \[m\].
    pub fn way_since(&self, before: &LocalContact) -> Vec3 {
        self.grip.position_m - before.grip.position_m
    }

    /// The part of a way that is across the normal.
    pub fn across(&self, way: &Vec3) -> Vec3 {
        way - self.normal * dot(&self.normal, way)
    }

    /// Shape of the body here by the tangent.
    pub fn shape(&self) -> Option<Shape> {
        Shape::of_contact(&self.slope(), &self.own_force())
    }

    /// Shape of the body here: `own`, by the tangent, else by the normals here and at another place.
    pub fn shape_beside(
        &self,
        own: &Option<Shape>,
        skin: &Skin,
        others: &[Option<Skin>],
    ) -> Option<Shape> {
        others.first()?.as_ref()?;
        if own.is_some() {
            return *own;
        }
        let slope = self.slope();
        let mut others = others.iter().flatten();
        others.find_map(|other| Shape::of_normals(&slope, other, skin))
    }

    /// The skin as this frame has it.
    pub fn skin(&self) -> Skin {
        Skin {
            place_m: self.grip.position_m,
            normal: self.normal,
            height_m: self.height_m(),
        }
    }

    /// Change of the force along a way \[m\] that the tangent does not foretell, on a body of this shape \[N\].
    fn beyond_tangent(&self, shape: &Shape, way: &Vec3) -> Vec3 {
        shape.turn(way).map_or_else(Vec3::zeros, |turn| {
            let plane = self.own_force() + product(&self.slope(), way);
            turn.turned(&(plane + shape.lacks(&turn))) - plane
        })
    }

    /// Height over the skin \[m\]; as deep as its own stiffness makes of its force where it touches.
    fn height_m(&self) -> f32 {
        let push_n = dot(&self.normal, &self.own_force());
        if self.gap_m > 0.0 || push_n <= 0.0 {
            return self.gap_m;
        }
        -push_n / max(self.stiffness_out, SOFTEST_N_PER_M)
    }

    /// Place at which the tool of this frame began to touch \[m\], and the tangent there \[N/m\], by the frame before, in which it did not yet, on a
    /// body of this shape.
    pub fn touched_at(
        &self,
        before: &LocalContact,
        shape: Option<&Shape>,
    ) -> Option<(Vec3, [f32; 6])> {
        if before.gap_m <= 0.0 || self.gap_m > 0.0 {
            return None;
        }
        let way = before.grip.position_m - self.grip.position_m;
        let turn = shape.and_then(|shape| shape.turn(&way));
        let on_skin = turn.map_or(way, |turn| turn.on_skin(&way));
        let deep_m = dot(&self.normal, &on_skin) - before.gap_m;
        if deep_m <= 0.0 {
            return None;
        }
        let slope = before.slope();
        let slope = turn.map_or(slope, |turn| {
            in_axes(&slope, AXES.map(|axis| turn.turned(&axis)))
        });
        Some((self.grip.position_m + self.normal * deep_m, slope))
    }

    /// Where it was solved for \[m\].
    pub fn place_m(&self) -> &Vec3 {
        &self.grip.position_m
    }

    /// d force / d position \[N/m\], packed upper triangle by rows.
    pub fn slope(&self) -> [f32; 6] {
        translational(&self.tangent)
    }

    /// Motion of the grip since the pose that was solved for.
    pub fn moved_to(&self, grip: &Grip) -> [f32; 6] {
        grip.moved_from(&self.grip)
    }

    /// 1 up to the horizon, then down to 0 in a straight line.
    pub fn staleness(&self, now_us: u64) -> f32 {
        let over_us = self.age_us(now_us).saturating_sub(self.horizon_us);
        let left_us = STALE_DECAY_US.saturating_sub(over_us);
        left_us as f32 * (1.0 / STALE_DECAY_US as f32)
    }

    /// Force after the grip has moved by `dx` on a way `onward`, with the tangent times `scale` \[N\].
    pub fn force(
        &self,
        rendering: Rendering,
        dx: &[f32; 6],
        (scale, onward): (f32, &Onward),
        now_us: u64,
    ) -> Vec3 {
        let age_us = self.age_us(now_us);
        let force = match rendering {
            Rendering::Hold => self.own_force(),
            Rendering::LinearTime => self.own_force() + self.rate * (age_us as f32 * 1e-6),
            Rendering::Tangent | Rendering::Rows if self.gap_m > 0.0 => {
                let force = self.force_across_gap(dx, onward.turn.as_ref());
                return self.pushing(&onward.turned(&self.normal), onward.turned(&force));
            }
            Rendering::Tangent | Rendering::Rows => {
                let plane = self.own_force() * self.relaxed(age_us);
                let force = plane + force_of(&self.tangent, dx) * scale + onward.more;
                return self.pushing(&onward.turned(&self.normal), onward.turned(&force));
            }
        };
        self.pushing(&self.normal, force)
    }

    /// Tissue with this normal pushes and never pulls.
    pub fn pushing(&self, normal: &Vec3, force: Vec3) -> Vec3 {
        if dot(normal, &force) > 0.0 {
            shortened(force, self.max_force_n)
        } else {
            Vec3::zeros()
        }
    }

    /// The same for what pulls as well as it pushes, needles and threads: without gap and scale.
    pub fn bilateral(&self, rendering: Rendering, dx: &[f32; 6], now_us: u64) -> Vec3 {
        let force = match rendering {
            Rendering::Hold => self.own_force(),
            Rendering::LinearTime => {
                self.own_force() + self.rate * (self.age_us(now_us) as f32 * 1e-6)
            }
            Rendering::Tangent | Rendering::Rows => {
                self.relaxed_force(now_us) + force_of(&self.tangent, dx)
            }
        };
        shortened(force, STRONGEST_N)
    }

    /// Wrench at the pose that was solved for, (6) \[N, N m\].
    pub fn wrench(&self) -> &[f32; 6] {
        &self.wrench
    }

    /// Packed upper triangle of d wrench / d pose, symmetric part, (21).
    pub fn tangent(&self) -> &[f32; 21] {
        &self.tangent
    }

    /// Largest stiffness along any direction \[N/m\]: the same wherever the axes point and whichever point of the grip is
    /// its reference, for moments and turns have no part in it.
    pub fn stiffness(&self) -> f32 {
        self.stiffness
    }

    /// Stiffness along a direction of any length, n'Kn with n of length 1 \[N/m\]; 0 for none.
    pub fn stiffness_along(&self, direction: &Vec3) -> f32 {
        let square = dot(direction, direction);
        if square > 0.0 {
            let [x, y, z]: [f32; 3] = (*direction).into();
            let change = force_of(&self.tangent, &[x, y, z, 0.0, 0.0, 0.0]);
            (dot(direction, &change) / square).abs()
        } else {
            0.0
        }
    }

    /// The largest entry of the tangent's diagonal \[N/m\]: other axes, another stiffness. What
    /// [`Guards::along`](super::Guards::along) is measured against.
    pub fn stiffness_of_axes(&self) -> f32 {
        let [xx, _, _, yy, _, zz] = translational(&self.tangent);
        max(xx.abs(), max(yy.abs(), zz.abs()))
    }

    /// Force at the pose that was solved for, as much as is left of it by now \[N\].
    pub fn relaxed_force(&self, now_us: u64) -> Vec3 {
        self.own_force() * self.relaxed(self.age_us(now_us))
    }

    /// Force at the pose that was solved for \[N\].
    pub fn own_force(&self) -> Vec3 {
        let [x, y, z, ..] = self.wrench;
        Vec3::new(x, y, z)
    }

    /// What lies behind the gap acts only on the part of the way that is left after it.
    fn force_across_gap(&self, dx: &[f32; 6], turn: Option<&Turn>) -> Vec3 {
        let [x, y, z, a, b, c] = *dx;
        let way = Vec3::new(x, y, z);
        let way = turn.map_or(way, |turn| turn.on_skin(&way));
        let closed_m = -dot(&self.normal, &way);
        if closed_m > self.gap_m {
            let [x, y, z]: [f32; 3] = way.into();
            force_of(&self.tangent, &[x, y, z, a, b, c]) * (1.0 - self.gap_m / closed_m)
        } else {
            Vec3::zeros()
        }
    }

    fn relaxed(&self, age_us: u32) -> f32 {
        max(0.0, 1.0 - self.relaxation_per_s * (age_us as f32 * 1e-6))
    }
}

/// The first three rows of a symmetric 6 x 6 matrix, packed upper triangle by rows, times a vector.
fn force_of(packed: &[f32; 21], v: &[f32; 6]) -> Vec3 {
    let [
        xx,
        xy,
        xz,
        xa,
        xb,
        xc,
        yy,
        yz,
        ya,
        yb,
        yc,
        zz,
        za,
        zb,
        zc,
        ..,
    ] = *packed;
    let [x, y, z, a, b, c] = *v;
    Vec3::new(
        xx * x + xy * y + xz * z + (xa * a + xb * b + xc * c),
        xy * x + yy * y + yz * z + (ya * a + yb * b + yc * c),
        xz * x + yz * y + zz * z + (za * a + zb * b + zc * c),
    )
}

/// d force / d position of a packed tangent: xx, xy, xz, yy, yz, zz.
fn translational(packed: &[f32; 21]) -> [f32; 6] {
    let [xx, xy, xz, _, _, _, yy, yz, _, _, _, zz, ..] = *packed;
    [xx, xy, xz, yy, yz, zz]
}

/// A symmetric 3 x 3 matrix, packed, whose eigenvalues are no larger in magnitude than `most`; the others stay.
fn softened(told: [f32; 6], most: f32) -> [f32; 6] {
    let mut packed = told;
    for _ in 0..3 {
        let largest = spectral_norm(&packed);
        if largest <= most * SOFT_ENOUGH {
            return packed;
        }
        let [xx, _, _, yy, _, zz] = packed;
        // Stiffness is negative: what pushes back.
        let value = if xx + yy + zz > 0.0 {
            largest
        } else {
            -largest
        };
        let Some([x, y, z]) = direction_of(&packed, value) else {
            break;
        };
        let less = if value > 0.0 {
            most - value
        } else {
            -most - value
        };
        let squares = [x * x, x * y, x * z, y * y, y * z, z * z];
        for (entry, square) in packed.iter_mut().zip(squares) {
            *entry += less * square;
        }
    }
    // Along no direction alone: all alike.
    let part = min(most / max(spectral_norm(&packed), most), 1.0);
    packed.map(|entry| entry * part)
}

/// Eigenvalue over the limit that counts as within: the spectral norm is right to 1e-3.
const SOFT_ENOUGH: f32 = 1.003;

/// Direction of a single eigenvalue of a symmetric 3 x 3 matrix, packed; none where others are about as large.
fn direction_of(packed: &[f32; 6], value: f32) -> Option<[f32; 3]> {
    let [xx, xy, xz, yy, yz, zz] = packed.map(|entry| entry / value);
    let rows = [
        Vec3::new(xx - 1.0, xy, xz),
        Vec3::new(xy, yy - 1.0, yz),
        Vec3::new(xz, yz, zz - 1.0),
    ];
    let [a, b, c] = rows;
    let across = [a.cross(&b), b.cross(&c), c.cross(&a)];
    let squares = across.map(|v| dot(&v, &v));
    let most = squares.iter().fold(0.0, |most, square| max(most, *square));
    let longest = across
        .into_iter()
        .zip(squares)
        .find(|(_, square)| *square >= most);
    let (v, square) = longest.filter(|(_, square)| *square > DISTINCT * DISTINCT)?;
    Some((v * (1.0 / libm::sqrtf(square))).into())
}

/// Product of the differences to the other eigenvalues, in eigenvalues, from which on one is distinct.
const DISTINCT: f32 = 0.02;

/// Largest magnitude of an eigenvalue of a symmetric 3 x 3 matrix, packed upper triangle by rows: to 1e-3 of itself, and
/// 1e-6 where no two of its eigenvalues are about equal.
///
/// With its mean eigenvalue q and its deviation p = (tr(B^2) / 6)^(1/2) of B = A - q I the largest eigenvalue is
/// q + 2 p c, where c is the largest root of 4 c^3 - 3 c = det(B / p) / 2 (Smith 1961); Newton's method comes to it from
/// above.
fn spectral_norm(packed: &[f32; 6]) -> f32 {
    let [xx, xy, xz, yy, yz, zz] = *packed;
    let mean = (xx + yy + zz) * (1.0 / 3.0);
    let (x, y, z) = (xx - mean, yy - mean, zz - mean);
    let squares = x * x + y * y + z * z + 2.0 * (xy * xy + xz * xz + yz * yz);
    let deviation = libm::sqrtf(squares * (1.0 / 6.0));
    if deviation <= 0.0 {
        return mean.abs();
    }
    let part = 1.0 / deviation;
    let [x, y, z, xy, xz, yz] = [x, y, z, xy, xz, yz].map(|entry| entry * part);
    let det = x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz);
    let half = clamp(0.5 * det, -1.0, 1.0);
    let highest = mean + 2.0 * deviation * largest_root(half);
    let lowest = mean - 2.0 * deviation * largest_root(-half);
    max(highest.abs(), lowest.abs())
}

/// Largest c with 4 c^3 - 3 c = r, from 1/2 to 1, for r from -1 to 1.
fn largest_root(r: f32) -> f32 {
    // In e = c - 1/2 it is 6 e^2 + 4 e^3 = 1 + r: without the cube e is too large.
    let right = 1.0 + r;
    let mut e = libm::sqrtf(right * (1.0 / 6.0));
    for _ in 0..3 {
        let over = e * e * (6.0 + 4.0 * e) - right;
        let slope = 12.0 * e * (1.0 + e);
        if slope > 0.0 {
            e -= over / slope;
        }
    }
    0.5 + e
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::message::Contact;
    use crate::wire::{Header, Kind, PROTOCOL_VERSION};

    /// Solved for this console time \[us\].
    const SOLVED: u64 = 1_000_000;
    /// A limit that nothing here reaches \[N\].
    const STRONG: f32 = 1e3;

    fn frame(body: Contact) -> LocalContact {
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Contact,
            session: 1,
            sequence: 7,
            console_time_us: SOLVED,
        };
        let frame = ValidContact::new(header, body).expect("the test gives a valid contact");
        LocalContact::new(&frame, SOLVED, STRONG)
    }

    /// Force of a model with the grip at `position`.
    fn at(model: &LocalContact, position: &Vec3, now_us: u64) -> Vec3 {
        let grip = Grip {
            position_m: *position,
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        model.force(
            Rendering::Tangent,
            &model.moved_to(&grip),
            (1.0, &Onward::PLANE),
            now_us,
        )
    }

    /// A spring of `stiffness` \[N/m\] behind the plane through the origin, as solved at `position`.
    fn wall(stiffness: f32, normal: Vec3, position: Vec3) -> Contact {
        let height = dot(&normal, &position);
        let [x, y, z]: [f32; 3] = normal.into();
        let mut tangent = [0.0; 21];
        for (index, product) in
            [0, 1, 2, 6, 7, 11]
                .into_iter()
                .zip([x * x, x * y, x * z, y * y, y * z, z * z])
        {
            tangent[index] = -stiffness * product;
        }
        let push = stiffness * max(0.0, -height);
        Contact {
            tool: 0,
            position_m: position.into(),
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [push * x, push * y, push * z, 0.0, 0.0, 0.0],
            tangent,
            gap_m: max(0.0, height),
            normal: normal.into(),
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        }
    }

    /// A linear wall is what the tangent model is exact for, touching or not, towards it or away.
    #[test]
    fn a_linear_wall_is_rendered_exactly() {
        let normal = Vec3::new(0.36, -0.48, 0.8);
        let along = Vec3::new(0.8, 0.6, 0.0);
        for solved in [-8e-3, -1e-3, 0.0, 2e-3, 9e-3] {
            let model = frame(wall(800.0, normal, normal * solved + along * 0.02));
            for height in [-9e-3, -8e-3, -2e-3, -1e-6, 0.0, 1e-6, 3e-3, 0.1] {
                let force = at(&model, &(normal * height - along * 0.01), SOLVED);
                let expected = normal * (800.0 * max(0.0, -height));
                // Rounding of 9 mm times 800 N/m.
                let error = force - expected;
                assert!(
                    dot(&error, &error) < 2e-5 * 2e-5,
                    "{solved} {height}: {force} {expected}"
                );
            }
        }
    }

    /// Against the eigenvalues that nalgebra finds in double precision; and whatever the axes, the same.
    #[test]
    fn the_stiffness_is_the_largest_along_any_direction() {
        use nalgebra::{Matrix3, Rotation3, Vector3};
        let mut seed = 1_u32;
        let mut any = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8) / f64::from(1 << 23) - 1.0
        };
        let kinds: [[f64; 3]; 9] = [
            [0.0, 0.0, 0.0],
            [0.0, 0.0, -1500.0],
            [-300.0, -300.0, -1500.0],
            [-1500.0, -1500.0, -300.0],
            [-800.0, -800.0, -800.0],
            [-1e7, -1.0, 0.0],
            [900.0, -1000.0, 50.0],
            [1e-20, -1e-20, 0.0],
            [-500.0, -499.9, -499.8],
        ];
        for own in kinds {
            let largest = own.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            for _ in 0..200 {
                let turn = Rotation3::new(Vector3::new(any(), any(), any()) * 3.0);
                let turned = turn.matrix()
                    * Matrix3::from_diagonal(&Vector3::from(own))
                    * turn.matrix().transpose();
                let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
                let packed = places.map(|place| turned[place] as f32);
                let found = f64::from(spectral_norm(&packed));
                assert!(
                    (found - largest).abs() <= 1e-3 * largest,
                    "{own:?}: {found}"
                );
            }
        }
    }

    #[test]
    fn a_gap_closes_where_it_says() {
        let mut contact = wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, 4e-3));
        contact.gap_m = 3e-3;
        let model = frame(contact);
        let push = |z: f32| at(&model, &Vec3::new(0.0, 0.0, z), SOLVED).z;
        assert_eq!(push(1.001e-3), 0.0);
        assert!((push(0.5e-3) - 0.5).abs() < 1e-5, "{}", push(0.5e-3));
        // Sideways is no way in.
        let sideways = at(&model, &Vec3::new(0.1, 0.1, 4e-3), SOLVED);
        assert_eq!(sideways, Vec3::zeros());
    }

    #[test]
    fn tissue_never_pulls() {
        let mut contact = wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, -1e-3));
        // A tangent of the wrong sign: pressing in would pull.
        contact.tangent[11] = 5000.0;
        let model = frame(contact);
        let force = at(&model, &Vec3::new(0.0, 0.0, -2e-3), SOLVED);
        assert_eq!(force, Vec3::zeros());
    }

    #[test]
    fn the_console_caps_the_horizon() {
        let contact = Contact {
            horizon_us: u32::MAX,
            ..wall(1000.0, Vec3::z(), Vec3::zeros())
        };
        assert_eq!(frame(contact).horizon_us, 150_000);
    }

    #[test]
    fn force_relaxes_at_the_given_rate_and_not_below_nothing() {
        let contact = Contact {
            relaxation_per_s: 20.0,
            ..wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, -1e-3))
        };
        let model = frame(contact);
        let push = |age_us: u64| at(&model, &Vec3::new(0.0, 0.0, -1e-3), SOLVED + age_us).z;
        assert!((push(10_000) - 0.8).abs() < 1e-6);
        assert_eq!(push(51_000), 0.0);
    }
}
