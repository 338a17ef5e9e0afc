//! How the tangent itself changes along the way: what a body's curvature does to a force that is foretold by a plane.
//!
//! Entry points: [`Bend::learn`], [`Bend::force`]. Between two frames the tangent changes by dK along the way d; a way x onward adds
//! (x . d) / (d . d) dK x / 2 to the force, the second term of its Taylor series (on the way back it is the trapezoidal rule). How much of it is
//! true is learnt from what came: the regression of what the last tangent did not foretell on what this term would have.

use crate::math::{Vec3, clamp, dot, max};

/// Share of what was learnt that is kept when as much new comes.
const KEPT: f32 = 0.5;
/// Square of the force \[N^2\] whose change tells as much as the prior, which is that it goes on.
const PRIOR: f32 = 0.02 * 0.02;
/// Square of the shortest way between two frames that tells how the tangent changes \[m^2\].
const TOLD: f32 = 0.3e-3 * 0.3e-3;
/// Ways back and onward, in ways between frames, for which it holds.
const HOLDS: (f32, f32) = (-1.0, 6.0);
/// Change of the tangent, in tangents, beyond which it says nothing: a normal that has turned by about a right angle.
const TURNED: f32 = 1.0;

/// Of the frame in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Change of d force / d position \[N/m\], packed upper triangle by rows: xx, xy, xz, yy, yz, zz.
    change: [f32; 6],
    /// The way on which it changed over its square \[1/m\].
    per_way: Vec3,
    /// Sums of foretold . foretold and foretold . came \[N^2\].
    foretold: f32,
    came: f32,
    /// Part of it that is believed, 0 to 1.
    worth: f32,
    /// Ways onward, in ways between frames, until the tangent says nothing any more.
    farthest: f32,
}

impl Bend {
    /// Nothing is known: a plane.
    pub const NONE: Bend = Bend {
        change: [0.0; 6],
        per_way: Vec3::new(0.0, 0.0, 0.0),
        foretold: 0.0,
        came: 0.0,
        worth: 0.0,
        farthest: f32::INFINITY,
    };

    /// Takes note of a new frame: its tangent and the one before \[N/m\], the way between them \[m\], and the change of force that the
    /// one before did not foretell \[N\].
    pub fn learn(&mut self, tangent: &[f32; 6], before: &[f32; 6], way: &Vec3, unforetold: &Vec3) {
        let told = self.whole(way);
        let square = dot(&told, &told);
        let kept = 1.0 - (1.0 - KEPT) * square / (square + self.foretold + PRIOR);
        self.foretold = self.foretold * kept + square;
        self.came = self.came * kept + dot(&told, unforetold);
        self.worth = clamp((self.came + PRIOR) / (self.foretold + PRIOR), 0.0, 1.0);
        let square = dot(way, way);
        self.per_way = if square > TOLD {
            way * (1.0 / square)
        } else {
            Vec3::zeros()
        };
        self.change = core::array::from_fn(|i| tangent[i] - before[i]);
        let most = TURNED * TURNED * square_of(tangent);
        let turned = square_of(&self.change);
        self.farthest = if turned > 0.0 {
            libm::sqrtf(most / turned)
        } else {
            f32::INFINITY
        };
    }

    /// Part of a way \[m\] from the pose that was solved for up to which the tangent says anything.
    pub fn reach(&self, way: &Vec3) -> f32 {
        let ways = dot(way, &self.per_way);
        if ways > self.farthest {
            self.farthest / ways
        } else {
            1.0
        }
    }

    /// What it adds to the force after a way \[m\] from the pose that was solved for \[N\].
    pub fn force(&self, way: &Vec3) -> Vec3 {
        self.whole(way) * self.worth
    }

    fn whole(&self, way: &Vec3) -> Vec3 {
        let [xx, xy, xz, yy, yz, zz] = self.change;
        let (back, onward) = HOLDS;
        let ways = max(back, dot(way, &self.per_way)).min(onward);
        let [x, y, z]: [f32; 3] = (*way).into();
        Vec3::new(
            xx * x + xy * y + xz * z,
            xy * x + yy * y + yz * z,
            xz * x + yz * y + zz * z,
        ) * (0.5 * ways)
    }
}

/// Square of the Frobenius norm of a symmetric 3 x 3 matrix, packed.
fn square_of(packed: &[f32; 6]) -> f32 {
    let [xx, xy, xz, yy, yz, zz] = *packed;
    xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)
}
