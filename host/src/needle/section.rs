//! Where a line or circle goes through a triangle, told in the curve's own plane.
//!
//! Entry point: [`Section::roots`]. The plane cuts the edges of a cell whose ends lie on different sides; a
//! cell's cut edges are the corners of a closed polygon, its cut faces are the sides, and the curve crosses
//! a side where the sign of `f` changes. What lies on the plane counts as above it and what lies on the
//! curve as to its left, each edge's corner is computed from its lower-numbered vertex first, and each
//! side's roots from its lower-numbered edge first: all cells around see the same bits, so that a curve
//! that leaves one cell always enters the next, through edges and vertices too. Younes 2021, 3.2.2.1
//! searches the star of an edge or vertex instead.

use super::Curve;
use nalgebra::Vector3;

/// The plane of a curve, and the curve in it.
pub(super) struct Section {
    start: Vector3<f64>,
    tangent: Vector3<f64>,
    inward: Vector3<f64>,
    normal: Vector3<f64>,
    /// Of a circle: centre and radius.
    circle: Option<(Vector3<f64>, f64)>,
}

/// A passage through a face.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Root {
    /// Out of the cell whose half-face it is; else into it.
    pub(super) leaves: bool,
    /// Barycentric on the face.
    pub(super) weights: [f64; 3],
    /// Where on the curve \[m\]; for a circle within half a turn of 0.
    pub(super) alpha: f64,
}

/// An edge of the mesh that the plane cuts.
struct Cut {
    /// Corners of the face, the one with the lower node first.
    corners: [usize; 2],
    /// The lower and the higher node.
    nodes: [u32; 2],
    at: Vector3<f64>,
    /// Barycentric weight of the second node.
    part: f64,
    /// Positive to the left of the curve.
    f: f64,
}

impl Section {
    pub(super) fn new(curve: &Curve) -> Self {
        let circle = (curve.curvature != 0.0).then(|| {
            let radius = curve.curvature.recip();
            (curve.start + curve.inward * radius, radius)
        });
        Self {
            start: curve.start,
            tangent: curve.tangent,
            inward: curve.inward,
            normal: curve.binormal(),
            circle,
        }
    }

    /// Over the plane \[m\].
    pub(super) fn height(&self, point: &Vector3<f64>) -> f64 {
        self.normal.dot(&(point - self.start))
    }

    /// Once around a circle \[m\]; infinite for a line.
    pub(super) fn turn(&self) -> f64 {
        self.circle
            .map_or(f64::INFINITY, |(_, radius)| std::f64::consts::TAU * radius)
    }

    fn left(&self, point: &Vector3<f64>) -> f64 {
        match self.circle {
            None => self.inward.dot(&(point - self.start)),
            Some((centre, radius)) => radius * radius - (point - centre).norm_squared(),
        }
    }

    fn alpha(&self, point: &Vector3<f64>) -> f64 {
        match self.circle {
            None => self.tangent.dot(&(point - self.start)),
            Some((centre, radius)) => {
                let from = point - centre;
                let (along, out) = (from.dot(&self.tangent), -from.dot(&self.inward));
                radius * along.atan2(out)
            }
        }
    }

    /// Passages through the triangle `nodes`, counter-clockwise seen from outside its cell, with its
    /// corners' positions and heights. A circle can go through twice, as a cell's side is a chord.
    pub(super) fn roots(
        &self,
        nodes: [u32; 3],
        corners: &[Vector3<f64>; 3],
        heights: &[f64; 3],
    ) -> [Option<Root>; 2] {
        let above = heights.map(|height| height >= 0.0);
        let Some(alone) =
            (0..3).find(|&k| above[k] != above[(k + 1) % 3] && above[k] != above[(k + 2) % 3])
        else {
            return [None; 2];
        };
        let cut = |to: usize| self.cut(nodes, corners, heights, [alone, to % 3]);
        // With the cell on the left seen from above: from the left to the right of a lone vertex above
        // as seen from outside, from the right to the left of one below.
        let (first, second) = (cut(alone + 1), cut(alone + 2));
        let (from, to) = if above[alone] {
            (first, second)
        } else {
            (second, first)
        };
        let forward = from.nodes < to.nodes;
        let (low, high) = if forward { (from, to) } else { (to, from) };
        let root = |leaves, s| Some(self.root(&low, &high, leaves, s));
        match (low.f >= 0.0, high.f >= 0.0) {
            (true, true) => [None; 2],
            (false, true) => [root(forward, self.part(&low, &high, false)), None],
            (true, false) => [root(!forward, self.part(&low, &high, true)), None],
            (false, false) if self.dips(&low, &high) => [
                root(forward, self.part(&low, &high, false)),
                root(!forward, self.part(&low, &high, true)),
            ],
            (false, false) => [None; 2],
        }
    }

    fn cut(
        &self,
        nodes: [u32; 3],
        corners: &[Vector3<f64>; 3],
        heights: &[f64; 3],
        [a, b]: [usize; 2],
    ) -> Cut {
        let [a, b] = if nodes[a] < nodes[b] { [a, b] } else { [b, a] };
        let (low, high) = (heights[a], heights[b]);
        // From the nearer end, so that an end on the plane is met exactly.
        let (at, part) = if low.abs() <= high.abs() {
            let part = low / (low - high);
            (corners[a] + (corners[b] - corners[a]) * part, part)
        } else {
            let part = high / (high - low);
            (corners[b] + (corners[a] - corners[b]) * part, 1.0 - part)
        };
        Cut {
            corners: [a, b],
            nodes: [nodes[a], nodes[b]],
            at,
            part,
            f: self.left(&at),
        }
    }

    /// `f(s) = low.f + 2 half s - square s^2` from one cut to another: half and square.
    fn quadratic(&self, low: &Cut, high: &Cut) -> (f64, f64) {
        let Some((centre, _)) = self.circle else {
            return (0.5 * (high.f - low.f), 0.0);
        };
        let way = high.at - low.at;
        (-(low.at - centre).dot(&way), way.norm_squared())
    }

    /// Whether a circle comes through between two cuts that both lie outside it.
    fn dips(&self, low: &Cut, high: &Cut) -> bool {
        let (half, square) = self.quadratic(low, high);
        half > 0.0 && half < square && half * half + square * low.f > 0.0
    }

    /// Where between two cuts `f` rises through 0, or falls.
    fn part(&self, low: &Cut, high: &Cut, falls: bool) -> f64 {
        // A cut on the curve itself is met exactly.
        if low.f == 0.0 || high.f == 0.0 {
            return if low.f == 0.0 { 0.0 } else { 1.0 };
        }
        let (half, square) = self.quadratic(low, high);
        let part = if square == 0.0 {
            low.f / (low.f - high.f)
        } else {
            let root = (half * half + square * low.f).max(0.0).sqrt();
            // Of the two forms of each root the one that does not subtract.
            match (falls, half > 0.0) {
                (true, true) => (half + root) / square,
                (true, false) => -low.f / (half - root),
                (false, true) => -low.f / (half + root),
                (false, false) => (half - root) / square,
            }
        };
        // Not a number becomes 0.
        if part > 0.0 { part.min(1.0) } else { 0.0 }
    }

    fn root(&self, low: &Cut, high: &Cut, leaves: bool, s: f64) -> Root {
        let way = high.at - low.at;
        let at = if s <= 0.5 {
            low.at + way * s
        } else {
            high.at - way * (1.0 - s)
        };
        let mut weights = [0.0; 3];
        for (cut, share) in [(low, 1.0 - s), (high, s)] {
            weights[cut.corners[0]] += share * (1.0 - cut.part);
            weights[cut.corners[1]] += share * cut.part;
        }
        Root {
            leaves,
            weights,
            alpha: self.alpha(&at),
        }
    }
}
