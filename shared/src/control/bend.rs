//! How the tangent itself changes along the way: what a body's curvature does to a force that is foretold by a plane.
//!
//! Entry points: [`Bend::learn`], [`Bend::onward`]. On a convex body the force turns with the normal and grows with the depth against the
//! turned normal ([`super::round`]). Besides, between two frames the tangent changes by dK along the way d, seen from the normal; a way x
//! onward adds (x . d) / (d . d) dK x / 2 to the force, the second term of its Taylor series (on the way back it is the trapezoidal rule).
//! How much of it is true is learnt from what came: the regression of what the last tangent did not foretell on what this term would have.

use super::round::{Shape, Turn};
use crate::math::{Vec3, clamp, dot};

/// Share of what was learnt that is kept when as much new comes.
const KEPT: f32 = 0.5;
/// Square of the force \[N^2\] whose change tells as much as the prior, which is that it goes on.
const PRIOR: f32 = 0.02 * 0.02;
/// Square of the shortest way between two frames that tells how the tangent changes \[m^2\].
const TOLD: f32 = 0.3e-3 * 0.3e-3;
/// Ways back and onward, in ways between frames, for which it holds.
const HOLDS: (f32, f32) = (-1.0, 6.0);
/// Change of the tangent, in tangents, beyond which it says nothing: a normal that has turned by some 45 degrees.
const TURNED: f32 = 1.0;

/// A frame, as what comes next is compared with it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Known {
    place_m: Vec3,
    tangent: [f32; 6],
    force_n: Vec3,
    shape: Option<Shape>,
}

impl Known {
    /// Force after a way \[m\] with the tangent times `scale` \[N\], before it turns, and that turn.
    fn after(&self, way: &Vec3, scale: f32) -> (Vec3, Option<Turn>) {
        let plane = self.force_n + product(&self.tangent, way) * scale;
        let turn = self.shape.and_then(|shape| shape.turn(way));
        match (&self.shape, &turn) {
            (Some(shape), Some(turn)) => (plane + shape.lacks(turn) * scale, Some(*turn)),
            _ => (plane, None),
        }
    }

    /// Its tangent as a frame at the end of such a turn sees it.
    fn seen_after(&self, turn: Option<&Turn>) -> [f32; 6] {
        turn.map_or(self.tangent, |turn| {
            in_axes(&self.tangent, AXES.map(|axis| turn.back(&axis)))
        })
    }
}

/// A way from the pose that was solved for, as a force follows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Onward {
    /// Part of the way up to which the tangent says anything.
    pub reach: f32,
    /// Addition to the force at the end of that part, before it turns \[N\].
    pub more: Vec3,
    /// Turn of the normal.
    pub turn: Option<Turn>,
}

impl Onward {
    /// A plane.
    #[cfg(test)]
    pub const PLANE: Onward = Onward {
        reach: 1.0,
        more: Vec3::new(0.0, 0.0, 0.0),
        turn: None,
    };

    /// A vector, turned with the normal.
    pub fn turned(&self, v: &Vec3) -> Vec3 {
        self.turn.map_or(*v, |turn| turn.turned(v))
    }
}

/// Of the frame in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// The last one that was somewhere else.
    last: Option<Known>,
    /// Shape under the newest one.
    shape: Option<Shape>,
    /// Change of d force / d position \[N/m\], packed upper triangle by rows: xx, xy, xz, yy, yz, zz.
    change: [f32; 6],
    /// The way on which it changed over its square \[1/m\].
    per_way: Vec3,
    /// Sums of foretold . foretold and foretold . came \[N^2\].
    foretold: f32,
    came: f32,
    /// Part of it that is believed, 0 to 1.
    worth: f32,
    /// What the tangents are to be multiplied by.
    scale: f32,
    /// Ways onward, in ways between frames, until the tangent says nothing any more.
    farthest: f32,
}

impl Bend {
    /// Nothing is known: a plane.
    pub const NONE: Bend = Bend {
        last: None,
        shape: None,
        change: [0.0; 6],
        per_way: Vec3::new(0.0, 0.0, 0.0),
        foretold: 0.0,
        came: 0.0,
        worth: 0.0,
        scale: 1.0,
        farthest: f32::INFINITY,
    };

    /// Takes note of the shape under the newest frame.
    pub fn lie(&mut self, shape: &Option<Shape>) {
        self.shape = *shape;
    }

    /// Takes note of a new frame: its place \[m\], tangent \[N/m\] and force \[N\], and of what the tangents have turned out to be wrong by.
    /// What is as good as where the last one was tells nothing: a tool that rests goes back on the way on which it came.
    pub fn learn(
        &mut self,
        place_m: &Vec3,
        tangent: &[f32; 6],
        (force, shape): (&Vec3, &Option<Shape>),
        scale: f32,
    ) {
        self.scale = scale;
        self.shape = *shape;
        let new = || Known {
            place_m: *place_m,
            tangent: *tangent,
            force_n: *force,
            shape: *shape,
        };
        let Some(last) = &self.last else {
            self.last = Some(new());
            return;
        };
        let way = place_m - last.place_m;
        let square = dot(&way, &way);
        if square < TOLD {
            return;
        }
        let (expected, turn) = last.after(&way, scale);
        let turned = |v: Vec3| turn.map_or(v, |turn| turn.turned(&v));
        let told = turned(self.whole(&way, dot(&way, &self.per_way)));
        let unforetold = force - turned(expected);
        let told_square = dot(&told, &told);
        let kept = 1.0 - (1.0 - KEPT) * told_square / (told_square + self.foretold + PRIOR);
        self.foretold = self.foretold * kept + told_square;
        self.came = self.came * kept + dot(&told, &unforetold);
        self.worth = clamp((self.came + PRIOR) / (self.foretold + PRIOR), 0.0, 1.0);
        self.per_way = way * (1.0 / square);
        let before = last.seen_after(turn.as_ref());
        let change = core::array::from_fn(|i| tangent[i] - before[i]);
        self.change = match (&last.shape, shape) {
            // What is left of it across the normal is the turn's.
            (Some(_), Some(shape)) => shape.along_normal(&change),
            _ => change,
        };
        self.last = Some(new());
        let most = TURNED * TURNED * square_of(tangent);
        let turned = square_of(&self.change);
        self.farthest = if turned > 0.0 {
            libm::sqrtf(most / turned)
        } else {
            f32::INFINITY
        };
    }

    /// After a way \[m\] from the pose that was solved for: the part of it up to which the tangent says anything, and what this adds to the
    /// force there: on the way back all of it, for that way is known, onward what has been true of it so far, and the turn of the normal.
    pub fn onward(&self, way: &Vec3) -> Onward {
        let ways = dot(way, &self.per_way);
        let reach = if ways > self.farthest {
            self.farthest / ways
        } else {
            1.0
        };
        let (way, ways) = (way * reach, ways * reach);
        let worth = if ways < 0.0 { 1.0 } else { self.worth };
        let turn = self.shape.and_then(|shape| shape.turn(&way));
        let more = match (&self.shape, &turn) {
            (Some(shape), Some(turn)) => {
                self.whole(&turn.on_skin(&way), ways) * worth + shape.lacks(turn) * self.scale
            }
            _ => self.whole(&way, ways) * worth,
        };
        Onward { reach, more, turn }
    }

    fn whole(&self, way: &Vec3, ways: f32) -> Vec3 {
        let (back, onward) = HOLDS;
        product(&self.change, way) * (0.5 * self.scale * clamp(ways, back, onward))
    }
}

/// A symmetric 3 x 3 matrix, packed upper triangle by rows, times a vector.
pub(super) fn product(packed: &[f32; 6], v: &Vec3) -> Vec3 {
    let [xx, xy, xz, yy, yz, zz] = *packed;
    let [x, y, z]: [f32; 3] = (*v).into();
    Vec3::new(
        xx * x + xy * y + xz * z,
        xy * x + yy * y + yz * z,
        xz * x + yz * y + zz * z,
    )
}

/// Axes of the world.
pub(super) const AXES: [Vec3; 3] = [
    Vec3::new(1.0, 0.0, 0.0),
    Vec3::new(0.0, 1.0, 0.0),
    Vec3::new(0.0, 0.0, 1.0),
];

/// A symmetric 3 x 3 matrix, packed, in other axes: unit vectors, each across the others.
pub(super) fn in_axes(packed: &[f32; 6], axes: [Vec3; 3]) -> [f32; 6] {
    let [x, y, z] = axes;
    let [a, b, c] = axes.map(|axis| product(packed, &axis));
    [
        dot(&x, &a),
        dot(&x, &b),
        dot(&x, &c),
        dot(&y, &b),
        dot(&y, &c),
        dot(&z, &c),
    ]
}

/// Square of the Frobenius norm of a symmetric 3 x 3 matrix, packed.
fn square_of(packed: &[f32; 6]) -> f32 {
    let [xx, xy, xz, yy, yz, zz] = *packed;
    xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tissue that stiffens along z and turns along x: force \[N\] and slope \[N/m\] of the potential -(a z^2 / 2 + b z^3 / 6 + c x z^2 / 2).
    fn tissue(at: &Vec3) -> (Vec3, [f32; 6]) {
        let (a, b, c) = (300.0, 40e3, 20e3);
        let [x, _, z]: [f32; 3] = (*at).into();
        let force = Vec3::new(
            -0.5 * c * z * z,
            0.0,
            -(a * z + 0.5 * b * z * z + c * x * z),
        );
        (force, [0.0, 0.0, -c * z, 0.0, 0.0, -(a + b * z + c * x)])
    }

    fn length(v: &Vec3) -> f32 {
        libm::sqrtf(dot(v, v))
    }

    fn along(way: &Vec3, frames: u8) -> (Bend, Vec3) {
        let mut bend = Bend::NONE;
        let mut at = Vec3::new(0.0, 0.0, 2e-3);
        for frame in 0..frames {
            if frame > 0 {
                at += way;
            }
            let (force, slope) = tissue(&at);
            learn(&mut bend, &at, (force, slope));
        }
        (bend, at)
    }

    fn learn(bend: &mut Bend, at: &Vec3, (force, slope): (Vec3, [f32; 6])) {
        let shape = Shape::of_contact(&slope, &force);
        bend.learn(at, &slope, (&force, &shape), 1.0);
    }

    /// The force after a way, and by how much the tangent is off it.
    fn foretold(bend: &Bend, (force, slope): (Vec3, [f32; 6]), way: &Vec3) -> Vec3 {
        let onward = bend.onward(way);
        onward.turned(&(force + product(&slope, way) * onward.reach + onward.more))
    }

    fn off(bend: &Bend, at: &Vec3, way: &Vec3) -> (f32, f32) {
        let (force, slope) = tissue(at);
        let (true_n, _) = tissue(&(at + way));
        let plane = force + product(&slope, way);
        let size = |v: Vec3| libm::sqrtf(dot(&v, &v));
        (
            size(plane - true_n),
            size(foretold(bend, tissue(at), way) - true_n),
        )
    }

    /// A hand that comes to rest on a ball: the shorter the way, the less there is to add, down to what has no square.
    #[test]
    fn the_shortest_ways_add_next_to_nothing() {
        let mut bend = Bend::NONE;
        let (push, round) = (1.25, 500.0);
        let tangent = [round, 0.0, 0.0, round, 0.0, -300.0];
        learn(
            &mut bend,
            &Vec3::zeros(),
            (Vec3::new(0.0, 0.0, push), tangent),
        );
        let mut way_m = 1e-3;
        while way_m > 0.0 {
            for way in [Vec3::new(way_m, 0.0, 0.0), Vec3::new(way_m, -way_m, way_m)] {
                let onward = bend.onward(&way);
                assert_eq!(onward.reach, 1.0, "{way_m:e}");
                let plane = Vec3::new(0.0, 0.0, push) + product(&tangent, &way);
                let more = onward.turned(&(plane + onward.more)) - plane;
                assert!(length(&more) <= 2.0 * round * way_m, "{way_m:e}: {more}");
            }
            way_m *= 0.3;
        }
    }

    #[test]
    fn a_force_of_second_degree_is_foretold() {
        let step = Vec3::new(0.7e-3, 0.0, 0.4e-3);
        let (bend, at) = along(&step, 5);
        for ways in [-1.0, -0.5, 0.5, 2.0, 4.0] {
            let (plane, bent) = off(&bend, &at, &(step * ways));
            assert!(
                plane > 2e-3 * ways * ways && bent < 0.05 * plane,
                "{ways}: {plane} {bent}"
            );
        }
        // Hardly anything is known before the second frame, and across the way.
        let (first, start) = along(&step, 1);
        let across = Vec3::new(0.4e-3, 0.0, -0.7e-3);
        for (bend, at, way) in [(first, start, step), (bend, at, across)] {
            let (plane, bent) = off(&bend, &at, &way);
            assert!((bent - plane).abs() < 2e-3, "{plane} {bent}");
        }
    }

    #[test]
    fn a_tool_that_rests_keeps_what_is_known_of_the_way_back() {
        let step = Vec3::new(0.0, 0.0, 1e-3);
        let (mut bend, at) = along(&step, 3);
        let (force, slope) = tissue(&at);
        for _ in 0..10 {
            learn(&mut bend, &at, (force, slope));
        }
        let (plane, bent) = off(&bend, &at, &-step);
        assert!(bent < 0.01 * plane, "{plane} {bent}");
    }

    /// A ball that pushes back along its radius: force \[N\] and slope \[N/m\] at a place in it.
    fn ball(at: &Vec3) -> (Vec3, [f32; 6]) {
        let (stiffness, radius_m) = (500.0, 8e-3);
        let far_m = length(at);
        let (n, size_n) = (at * (1.0 / far_m), stiffness * (radius_m - far_m));
        let (round, steep) = (size_n / far_m, -stiffness - size_n / far_m);
        let [x, y, z]: [f32; 3] = n.into();
        let squares = [x * x, x * y, x * z, y * y, y * z, z * z];
        let mut slope = squares.map(|square| steep * square);
        for diagonal in [0, 3, 5] {
            slope[diagonal] += round;
        }
        (n * size_n, slope)
    }

    /// One frame tells all of a ball: any way around it, up to its far side, ends at the force that is there.
    #[test]
    fn one_frame_says_how_round_a_body_is() {
        for toward in [Vec3::z(), Vec3::new(0.6, -0.48, 0.64)] {
            let mut bend = Bend::NONE;
            // It came straight down, and rests.
            learn(&mut bend, &(toward * 7e-3), ball(&(toward * 7e-3)));
            learn(&mut bend, &(toward * 6e-3), ball(&(toward * 6e-3)));
            let along = toward.cross(&Vec3::new(0.3, 0.9, -0.2));
            let along = along * (1.0 / length(&along));
            for angle in [0.1, 0.5, 1.2, 2.5_f32] {
                let (s, c) = (libm::sinf(angle), libm::cosf(angle));
                for far_m in [5e-3, 6e-3, 7e-3] {
                    let there = (toward * c + along * s) * far_m;
                    let way = there - toward * 6e-3;
                    let (truth, _) = ball(&there);
                    let (force, slope) = ball(&(toward * 6e-3));
                    let plane = length(&(force + product(&slope, &way) - truth));
                    let round = length(&(foretold(&bend, (force, slope), &way) - truth));
                    assert!(round < 0.01 * plane + 1e-4, "{angle}: {round} of {plane}");
                }
            }
        }
        // What is stuck to a spring is pulled back along the way: that is no shape.
        let mut bend = Bend::NONE;
        let slope = [-500.0, 0.0, 0.0, -500.0, 0.0, -500.0];
        learn(&mut bend, &Vec3::zeros(), (Vec3::z(), slope));
        assert_eq!(bend.onward(&Vec3::new(3e-3, 0.0, 0.0)), Onward::PLANE);
    }

    #[test]
    fn what_does_not_come_true_is_not_believed_onward() {
        let mut bend = Bend::NONE;
        let step = Vec3::new(1e-3, 0.0, 0.0);
        // The slope jumps to and fro, the force goes straight on.
        for frame in 0..8_u8 {
            let slope = -300.0 - if frame % 2 == 0 { 200.0 } else { 0.0 };
            let x = f32::from(frame) * 1e-3;
            let force = Vec3::new(-400.0 * x, 0.0, 0.0);
            let slope = [slope, 0.0, 0.0, 0.0, 0.0, 0.0];
            learn(&mut bend, &(step * f32::from(frame)), (force, slope));
        }
        let believed = bend.onward(&(step * 2.0)).more;
        assert!(length(&believed) < 0.1, "{believed:?}");
    }

    #[test]
    fn a_normal_that_turns_ends_the_plane_and_a_wall_does_not() {
        let mut bend = Bend::NONE;
        for turn in [0.0_f32, 0.3] {
            let (s, c) = (libm::sinf(turn), libm::cosf(turn));
            let slope = [s * s, 0.0, s * c, 0.0, 0.0, c * c].map(|x| -500.0 * x);
            let there = Vec3::new(s, 0.0, c);
            learn(&mut bend, &(there * 8e-3), (there, slope));
        }
        let onward = Vec3::new(1.0, 0.0, -0.15) * 2.4e-3;
        assert_eq!(bend.onward(&onward).reach, 1.0);
        let far = bend.onward(&(onward * 4.0)).reach;
        assert!((0.2..0.9).contains(&far), "{far}");
        let mut wall = Bend::NONE;
        for x in [0.0_f32, 1e-3] {
            let slope = [0.0, 0.0, 0.0, 0.0, 0.0, -2000.0];
            let push = Vec3::new(0.0, 0.0, 2.0);
            learn(&mut wall, &Vec3::new(x, 0.0, -1e-3), (push, slope));
        }
        assert_eq!(wall.onward(&Vec3::new(0.1, 0.0, -0.1)).reach, 1.0);
    }
}
