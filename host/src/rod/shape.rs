//! What a rod is, and how it is looked at: in stretches, and by points that stand for what bulges.
//!
//! Entry point: [`Rod`].

use crate::needle::Curve;
use nalgebra::Vector3;
use std::ops::Range;

/// A stretch of a circle turns by at most this much \[rad\]: what is near to it is near to its chord, and lines come near it once.
const STRETCH: f64 = 0.08;
/// A curve bulges at most so far, in mean edges, beyond the chord of two points that stand for it over faces.
const BULGE: f64 = 2.5e-4;
/// Points of an arc within this much of where it is lowest over a face may touch that before a balance is found \[rad\]: twice what
/// faces turn by in a piece of its way.
const ROLLS: f64 = 0.06;
/// An arc whose plane has this sine of an angle to a face, or less, does not bulge over it.
const FLAT: f64 = 0.002;
/// Of its radius: as far a rod goes at once near a surface.
pub(crate) const PIECE_RADII: f64 = 0.25;

/// A ball swept along a curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rod {
    pub curve: Curve,
    pub radius_m: f64,
    /// Where on the curve it ends \[m\].
    pub front_m: f64,
    /// Way along it from one point that stands for what bends to the next \[m\].
    bulge_m: f64,
    /// Whether it ends in half a ball at both ends.
    is_capped: bool,
}

impl Rod {
    /// Along `curve` up to `front_m`, over faces with edges of `edge_m` \[m\].
    pub fn new(curve: Curve, radius_m: f64, front_m: f64, edge_m: f64) -> Self {
        Self {
            bulge_m: (8.0 * BULGE * edge_m / curve.most_curvature()).sqrt(),
            curve,
            radius_m,
            front_m,
            is_capped: false,
        }
    }

    /// With half a ball at both ends.
    pub fn capped(self) -> Self {
        Self {
            is_capped: true,
            ..self
        }
    }

    /// A place on it, or on the line beyond \[m\]: if that is beyond an end with half a ball, the end, and whether it is.
    pub fn ended(&self, alpha: f64) -> (f64, bool) {
        let inner = alpha.clamp(0.0, self.front_m);
        if self.is_capped && inner != alpha {
            (inner, true)
        } else {
            (alpha, false)
        }
    }

    /// Its stretches, from its end on \[m\]: what is straight is one.
    pub fn stretches(&self) -> impl Iterator<Item = [f64; 2]> {
        let pieces = (0..self.curve.pieces()).map(|number| self.curve.piece(number));
        pieces.flat_map(|piece| {
            let [from, to] = [piece.span[0], piece.span[1].min(self.front_m)];
            let long_m = (to - from).max(0.0);
            let count = (long_m * piece.curve.curvature / STRETCH).ceil();
            let count = if long_m > 0.0 { count.max(1.0) } else { 0.0 };
            let place = move |part: u32| {
                let along = f64::from(part) / count;
                if along < 1.0 {
                    from + long_m * along
                } else {
                    to
                }
            };
            (0..count as u32).map(move |part| [place(part), place(part + 1)])
        })
    }

    /// Where a point that stands for what bends is \[m\].
    pub fn bulge(&self, number: u32) -> f64 {
        f64::from(number) * self.bulge_m
    }

    /// Numbers of the points of a stretch that may touch a face with this normal as they roll over it.
    pub fn rolling(&self, [from, to]: [f64; 2], normal: &Vector3<f64>) -> Range<u32> {
        let piece = self.curve.piece(self.curve.number_at(0.5 * (from + to)));
        let Some(lowest) = lowest(&piece.curve, normal) else {
            return 0..0;
        };
        let lowest = lowest + piece.span[0];
        let reach_m = ROLLS / piece.curve.curvature;
        let number = |alpha: f64| (alpha / self.bulge_m).ceil().max(0.0) as u32;
        let low = (lowest - reach_m).max(from);
        number(low)..number((lowest + reach_m).min(to).max(low))
    }
}

/// Where a circle is nearest to a plane below it with this normal \[m\], within half a turn of its middle; `None` for lines, and for
/// circles that lie flat on it.
fn lowest(curve: &Curve, normal: &Vector3<f64>) -> Option<f64> {
    let middle = 0.5 * curve.length;
    // Along the normal by -cos: sin and cos of the angle there.
    let [forward, inward, _] = curve.frame_at(middle).map(|axis| normal.dot(&axis));
    let lies_flat = forward.hypot(inward) <= FLAT * normal.norm();
    (curve.curvature != 0.0 && !lies_flat)
        .then(|| middle + (-forward).atan2(inward) / curve.curvature)
}
