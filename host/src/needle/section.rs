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

    /// Of the nearest place on the curve \[m\]; for a circle within half a turn of 0.
    pub(super) fn alpha(&self, point: &Vector3<f64>) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::needle::Joints;

    /// Numbers between -1 and 1 that are not regular.
    fn spread(k: usize) -> f64 {
        let k = k as f64;
        2.0 * (1e4 * (12.9898 * k + 78.233).sin()).fract().abs() - 1.0
    }

    fn vector(k: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| spread(11 * k + axis))
    }

    /// Lines, and circles about places near the origin.
    fn curves() -> impl Iterator<Item = Curve> {
        (0..3000).map(|k| {
            let tangent = vector(3 * k).normalize();
            let inward = tangent.cross(&vector(3 * k + 2)).normalize();
            let radius = [0.0, 0.3, 0.6][k % 3];
            Curve {
                start: vector(3 * k + 1) * 0.3 - inward * radius,
                tangent,
                inward,
                curvature: if radius > 0.0 { 1.0 / radius } else { 0.0 },
                length: 1.0,
                joints: Joints::default(),
            }
        })
    }

    /// All orders of a triangle's corners; whether they run around it the same way.
    const ORDERS: [([usize; 3], bool); 6] = [
        ([0, 1, 2], true),
        ([1, 2, 0], true),
        ([2, 0, 1], true),
        ([0, 2, 1], false),
        ([2, 1, 0], false),
        ([1, 0, 2], false),
    ];

    /// To the last bit, or a curve could leave one cell and not enter the next.
    #[test]
    fn every_half_face_of_a_triangle_sees_the_same_passages() {
        let (mut one, mut two) = (0, 0);
        for (number, curve) in curves().enumerate() {
            let section = Section::new(&curve);
            let corners = [0, 1, 2].map(|k| vector(5 * number + k + 7));
            let nodes = [4, 17, 9];
            let seen = ORDERS.map(|(order, same)| {
                let at = order.map(|k| corners[k]);
                let heights = at.map(|at| section.height(&at));
                let roots = section.roots(order.map(|k| nodes[k]), &at, &heights);
                let mut roots: Vec<_> = roots
                    .into_iter()
                    .flatten()
                    .map(|root| {
                        let mut weights = [0.0; 3];
                        for (place, k) in order.into_iter().enumerate() {
                            weights[k] = root.weights[place];
                        }
                        (root.alpha, weights, root.leaves == same)
                    })
                    .collect();
                roots.sort_by(|a, b| a.0.total_cmp(&b.0));
                roots
            });
            assert!(seen.iter().all(|roots| *roots == seen[0]), "{seen:?}");
            for (alpha, weights, out) in &seen[0] {
                let on_face: Vector3<f64> = (0..3).map(|k| corners[k] * weights[k]).sum();
                assert!((on_face - curve.at(*alpha)).norm() < 1e-13);
                let [a, b, c] = corners;
                let normal = (b - a).cross(&(c - a));
                let along = curve.tangent_at(*alpha).dot(&normal);
                assert_eq!(*out, along > 0.0, "{along}");
            }
            one += usize::from(seen[0].len() == 1);
            two += usize::from(seen[0].len() == 2);
        }
        assert!(one > 500 && two > 50, "{one} {two}");
    }

    /// The triangles around an edge have it in either direction; the hardest case is a plane through its middle.
    #[test]
    fn every_triangle_around_an_edge_cuts_it_in_the_same_place() {
        for k in 0..1000 {
            let section = Section::new(&Curve {
                start: Vector3::zeros(),
                tangent: Vector3::x(),
                inward: Vector3::y(),
                curvature: f64::from(k as u32 % 2),
                length: 1.0,
                joints: Joints::default(),
            });
            let mut corners = [3 * k, 3 * k + 1, 3 * k + 2].map(vector);
            if k % 3 == 0 {
                corners[1].z = -corners[0].z;
            }
            let heights = corners.map(|at| section.height(&at));
            let nodes = [8, 3, 5];
            let [forth, back] =
                [[0, 1], [1, 0]].map(|edge| section.cut(nodes, &corners, &heights, edge));
            assert_eq!((forth.corners, forth.at), (back.corners, back.at));
            assert_eq!((forth.part, forth.f), (back.part, back.f));
        }
    }

    /// What lies on the plane is above it, and what lies on the curve to its left: of the triangles around a vertex on
    /// a line, those with a corner below get one passage out and one in.
    #[test]
    fn a_line_through_a_vertex_passes_two_triangles_around_it() {
        let curve = Curve {
            start: Vector3::new(-1.0, 0.0, 0.0),
            tangent: Vector3::x(),
            inward: Vector3::y(),
            curvature: 0.0,
            length: 2.0,
            joints: Joints::default(),
        };
        let section = Section::new(&curve);
        let below = Vector3::new(0.0, 0.0, -1.0);
        for turn in [0.0, 0.3, 1.1] {
            // An umbrella of triangles with the origin at its top, seen from outside.
            let rim = [0, 1, 2, 3, 4, 5].map(|k| {
                let angle = turn + f64::from(k);
                below + Vector3::new(angle.cos(), angle.sin(), 0.0)
            });
            let passages = [0, 1, 2, 3, 4, 5].map(|k| {
                let corners = [Vector3::zeros(), rim[k], rim[(k + 1) % 6]];
                let heights = corners.map(|at| section.height(&at));
                let nodes = [0, k as u32 + 1, (k as u32 + 1) % 6 + 1];
                section.roots(nodes, &corners, &heights)
            });
            // All cuts are the origin itself, which is on the left of the line: nothing is passed.
            assert!(passages.iter().flatten().flatten().next().is_none());

            // The same vertex as one of the rim's plane: a triangle to either side along the line is passed.
            let flat = [(-1.0, 0.5), (-1.0, -2.0), (1.0, -2.0), (1.0, 0.5)];
            let flat = flat.map(|(x, y)| Vector3::new(x, y, if y > 0.0 { 1.0 } else { -1.0 }));
            let mut found = Vec::new();
            for k in 0..4 {
                let corners = [Vector3::zeros(), flat[k], flat[(k + 1) % 4]];
                let heights = corners.map(|at| section.height(&at));
                let nodes = [0, k as u32 + 1, (k as u32 + 1) % 4 + 1];
                let roots = section.roots(nodes, &corners, &heights);
                found.extend(roots.into_iter().flatten());
            }
            assert_eq!(found.len(), 2, "{found:?}");
            assert_eq!(found[0].leaves, !found[1].leaves);
            assert!(
                found
                    .iter()
                    .all(|root| root.weights == [1.0, 0.0, 0.0] && root.alpha == 1.0)
            );
        }
    }
}
