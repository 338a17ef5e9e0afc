//! How the tangent itself changes along the way: what a body's curvature does to a force that is foretold by a plane.
//!
//! Entry points: [`Bend::learn`], [`Bend::onward`]. Between two frames the tangent changes by dK along the way d; a way x onward adds
//! (x . d) / (d . d) dK x / 2 to the force, the second term of its Taylor series (on the way back it is the trapezoidal rule). How much of it is
//! true is learnt from what came: the regression of what the last tangent did not foretell on what this term would have.
//!
//! Across d nothing came yet. But a force that turns with the way, as on a ball, says how round the body is: with the curvature
//! t . K t / |f| along a way across it the tangent turns with the force.

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
/// The same as an angle \[rad\].
const ROUND: f32 = 0.8;
/// A force that is lighter says nothing of the body \[N\].
const LIGHT_N: f32 = 0.05;
/// Square of a way across what is known on which nothing turns that is felt \[m^2\]. Of a hand that has come to rest there is next to nothing left,
/// whose square is 0 before it is: the curvature along it would be any number.
const NOTHING: f32 = 1e-6 * 1e-6;

/// A frame, as what comes next is compared with it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Known {
    place_m: Vec3,
    tangent: [f32; 6],
    force_n: Vec3,
}

/// Of the frame in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// The last one that was somewhere else.
    last: Option<Known>,
    /// Direction of the newest one's force, if that may turn as on a convex body, over its size \[1/N\]; its tangent, and that
    /// times the direction \[N/m\].
    normal: Vec3,
    per_n: f32,
    tangent: [f32; 6],
    steep: Vec3,
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
        normal: Vec3::new(0.0, 0.0, 0.0),
        per_n: 0.0,
        tangent: [0.0; 6],
        steep: Vec3::new(0.0, 0.0, 0.0),
        change: [0.0; 6],
        per_way: Vec3::new(0.0, 0.0, 0.0),
        foretold: 0.0,
        came: 0.0,
        worth: 0.0,
        scale: 1.0,
        farthest: f32::INFINITY,
    };

    /// Takes note of a new frame: its place \[m\], tangent \[N/m\] and force \[N\], and of what the tangents have turned out to be wrong by.
    /// What is as good as where the last one was tells nothing: a tool that rests goes back on the way on which it came.
    pub fn learn(&mut self, place_m: &Vec3, tangent: &[f32; 6], force: &Vec3, scale: f32) {
        self.scale = scale;
        self.lie(tangent, force);
        let new = Known {
            place_m: *place_m,
            tangent: *tangent,
            force_n: *force,
        };
        let Some(last) = self.last else {
            self.last = Some(new);
            return;
        };
        let way = place_m - last.place_m;
        let square = dot(&way, &way);
        if square < TOLD {
            return;
        }
        self.last = Some(new);
        let told = self.whole(&way, dot(&way, &self.per_way));
        let unforetold = force - last.force_n - product(&last.tangent, &way) * scale;
        let told_square = dot(&told, &told);
        let kept = 1.0 - (1.0 - KEPT) * told_square / (told_square + self.foretold + PRIOR);
        self.foretold = self.foretold * kept + told_square;
        self.came = self.came * kept + dot(&told, &unforetold);
        self.worth = clamp((self.came + PRIOR) / (self.foretold + PRIOR), 0.0, 1.0);
        self.per_way = way * (1.0 / square);
        self.change = core::array::from_fn(|i| tangent[i] - last.tangent[i]);
        let most = TURNED * TURNED * square_of(tangent);
        let turned = square_of(&self.change);
        self.farthest = if turned > 0.0 {
            libm::sqrtf(most / turned)
        } else {
            f32::INFINITY
        };
    }

    /// How the newest force lies, and whether it turns as on a convex body along any way across it.
    fn lie(&mut self, tangent: &[f32; 6], force: &Vec3) {
        let size_n = libm::sqrtf(dot(force, force));
        self.per_n = 0.0;
        if size_n < LIGHT_N {
            return;
        }
        let per_n = 1.0 / size_n;
        (self.normal, self.tangent) = (force * per_n, *tangent);
        self.steep = product(tangent, &self.normal);
        let [xx, _, _, yy, _, zz] = *tangent;
        if xx + yy + zz > dot(&self.steep, &self.normal) {
            self.per_n = per_n;
        }
    }

    /// After a way \[m\] from the pose that was solved for: the part of it up to which the tangent says anything, and what this adds to the
    /// force there \[N\]: on the way back all of it, for that way is known, onward what has been true of it so far, and across that
    /// what the tangent says of the body.
    pub fn onward(&self, way: &Vec3) -> (f32, Vec3) {
        let ways = dot(way, &self.per_way);
        let mut reach = if ways > self.farthest {
            self.farthest / ways
        } else {
            1.0
        };
        let mut round = Vec3::zeros();
        if let Some((turn, turned)) = self.around(way, ways) {
            if turn * reach > ROUND {
                reach = ROUND / turn;
            }
            round = turned * (0.5 * self.scale * reach * reach);
        }
        let (way, ways) = (way * reach, ways * reach);
        let worth = if ways < 0.0 { 1.0 } else { self.worth };
        (reach, self.whole(&way, ways) * worth + round)
    }

    /// By how much the force turns on a way, on the part of it that is across what is known and across the force \[rad\], and
    /// by how much the tangent that turns with it makes another force of the way \[N\]; nothing where the body is not convex along it.
    ///
    /// With the turn w = n x k a along a, of curvature k: w x (K x) - K (w x x).
    fn around(&self, way: &Vec3, ways: f32) -> Option<(f32, Vec3)> {
        if self.per_n == 0.0 {
            return None;
        }
        let known = dot(&self.per_way, &self.per_way);
        let new = if known > 0.0 {
            way - self.per_way * (ways / known)
        } else {
            *way
        };
        let across = new - self.normal * dot(&new, &self.normal);
        let (square, pulled) = (dot(&across, &across), product(&self.tangent, &across));
        let slope = dot(&across, &pulled);
        if slope <= 0.0 || square < NOTHING {
            return None;
        }
        let curvature = slope * self.per_n / square;
        let turned = across * dot(&self.steep, way) + self.steep * dot(&across, way)
            - self.normal * dot(&pulled, way)
            - pulled * dot(&self.normal, way);
        Some((curvature * libm::sqrtf(square), turned * curvature))
    }

    fn whole(&self, way: &Vec3, ways: f32) -> Vec3 {
        let (back, onward) = HOLDS;
        product(&self.change, way) * (0.5 * self.scale * clamp(ways, back, onward))
    }
}

/// A symmetric 3 x 3 matrix, packed upper triangle by rows, times a vector.
fn product(packed: &[f32; 6], v: &Vec3) -> Vec3 {
    let [xx, xy, xz, yy, yz, zz] = *packed;
    let [x, y, z]: [f32; 3] = (*v).into();
    Vec3::new(
        xx * x + xy * y + xz * z,
        xy * x + yy * y + yz * z,
        xz * x + yz * y + zz * z,
    )
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
            bend.learn(&at, &slope, &force, 1.0);
        }
        (bend, at)
    }

    fn off(bend: &Bend, at: &Vec3, way: &Vec3) -> (f32, f32) {
        let (force, slope) = tissue(at);
        let (true_n, _) = tissue(&(at + way));
        let plane = force + product(&slope, way);
        let size = |v: Vec3| libm::sqrtf(dot(&v, &v));
        (
            size(plane - true_n),
            size(plane + bend.onward(way).1 - true_n),
        )
    }

    /// A hand that comes to rest on a ball: the shorter the way, the less there is to add, down to what has no square.
    #[test]
    fn the_shortest_ways_add_next_to_nothing() {
        let mut bend = Bend::NONE;
        let (push, round) = (1.25, 500.0);
        let tangent = [round, 0.0, 0.0, round, 0.0, -300.0];
        bend.learn(&Vec3::zeros(), &tangent, &Vec3::new(0.0, 0.0, push), 1.0);
        let mut way_m = 1e-3;
        while way_m > 0.0 {
            for way in [Vec3::new(way_m, 0.0, 0.0), Vec3::new(way_m, -way_m, way_m)] {
                let (reach, more) = bend.onward(&way);
                assert!((0.0..=1.0).contains(&reach), "{way_m:e}: {reach}");
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
                plane > 2e-3 * ways * ways && bent < 0.01 * plane,
                "{ways}: {plane} {bent}"
            );
        }
        // Hardly anything is known before the second frame, and across the way.
        let (first, _) = along(&step, 1);
        assert!(length(&first.onward(&step).1) < 1e-3);
        let across = Vec3::new(0.4e-3, 0.0, -0.7e-3);
        assert!(length(&bend.onward(&across).1) < 2e-3);
    }

    #[test]
    fn a_tool_that_rests_keeps_what_is_known_of_the_way_back() {
        let step = Vec3::new(0.0, 0.0, 1e-3);
        let (mut bend, at) = along(&step, 3);
        let (force, slope) = tissue(&at);
        for _ in 0..10 {
            bend.learn(&at, &slope, &force, 1.0);
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

    #[test]
    fn one_frame_says_how_round_a_body_is() {
        let foretold = |scale: f32, toward: Vec3| {
            let at = toward * 6e-3;
            let mut bend = Bend::NONE;
            let (force, slope) = ball(&at);
            // It came straight down, and rests.
            let (before, before_slope) = ball(&(toward * 7e-3));
            bend.learn(&(toward * 7e-3), &before_slope, &before, 1.0);
            bend.learn(&at, &slope, &force, 1.0);
            let along = toward.cross(&Vec3::new(0.3, 0.9, -0.2));
            let along = along * (1.0 / length(&along));
            let (s, c) = (libm::sinf(scale), libm::cosf(scale));
            let way = (toward * c + along * s) * 6e-3 - at;
            let (truth, _) = ball(&(at + way));
            let plane = force + product(&slope, &way);
            (
                length(&(plane - truth)),
                length(&(plane + bend.onward(&way).1 - truth)),
                bend.onward(&way).0,
            )
        };
        for toward in [Vec3::z(), Vec3::new(0.6, -0.48, 0.64)] {
            for angle in [0.1, 0.3, 0.5] {
                let (plane, bent, reach) = foretold(angle, toward);
                assert!(plane > 1.5 * angle * angle, "{plane}");
                assert!(bent < angle * plane, "{angle}: {bent} of {plane}");
                assert_eq!(reach, 1.0);
            }
            let (_, _, reach) = foretold(1.2, toward);
            assert!(reach < 0.9, "{reach}");
        }
        // What is stuck to a spring is pulled back along the way: that is no shape.
        let mut bend = Bend::NONE;
        let slope = [-500.0, 0.0, 0.0, -500.0, 0.0, -500.0];
        bend.learn(&Vec3::zeros(), &slope, &Vec3::z(), 1.0);
        assert_eq!(bend.onward(&Vec3::new(3e-3, 0.0, 0.0)).1, Vec3::zeros());
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
            bend.learn(
                &(step * f32::from(frame)),
                &[slope, 0.0, 0.0, 0.0, 0.0, 0.0],
                &force,
                1.0,
            );
        }
        let believed = bend.onward(&(step * 2.0)).1;
        assert!(length(&believed) < 0.1, "{believed:?}");
    }

    #[test]
    fn a_normal_that_turns_ends_the_plane_and_a_wall_does_not() {
        let mut bend = Bend::NONE;
        for turn in [0.0_f32, 0.3] {
            let (s, c) = (libm::sinf(turn), libm::cosf(turn));
            let slope = [s * s, 0.0, s * c, 0.0, 0.0, c * c].map(|x| -500.0 * x);
            bend.learn(
                &(Vec3::new(s, 0.0, c) * 8e-3),
                &slope,
                &Vec3::new(s, 0.0, c),
                1.0,
            );
        }
        let onward = Vec3::new(1.0, 0.0, -0.15) * 2.4e-3;
        assert_eq!(bend.onward(&onward).0, 1.0);
        let far = bend.onward(&(onward * 4.0)).0;
        assert!((0.2..0.9).contains(&far), "{far}");
        let mut wall = Bend::NONE;
        for x in [0.0_f32, 1e-3] {
            let slope = [0.0, 0.0, 0.0, 0.0, 0.0, -2000.0];
            wall.learn(
                &Vec3::new(x, 0.0, -1e-3),
                &slope,
                &Vec3::new(0.0, 0.0, 2.0),
                1.0,
            );
        }
        assert_eq!(wall.onward(&Vec3::new(0.1, 0.0, -0.1)).0, 1.0);
    }
}
