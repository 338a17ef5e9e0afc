//! How two features stand to each other: the points that are opposite, the direction that keeps them apart.
//!
//! Entry point: [`stance`]. A vertex and a face are kept apart along the face's normal. Two edges are kept
//! apart along their common perpendicular, which is how their distance changes; the mean of the incident
//! faces' normals (younes-2021, 2.2.6) says which way it points. The latter alone would let edges that slide
//! pass through each other in first order.

use super::body::Pair;
use super::shell::Shell;
use nalgebra::Vector3;

/// Sine of the angle below which two edges are parallel: their ends meet faces.
const PARALLEL: f64 = 0.05;
/// By how much the common perpendicular of two edges may lie outside the normals of the faces at either: cosine and sine
/// of 35 degrees. Farther out the edges lie beside each other.
const TILTED: [f64; 2] = [0.819, 0.574];
/// Cosine of the angle that the normal at a vertex must at least have to the opposite of the normal of a face that it meets:
/// with less the vertex comes from within its own body or goes along the face.
const OPPOSITE: f64 = 0.1;

/// Two features that stand opposite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FeaturePair {
    /// With these the nodes' positions add up to the difference between the two points, (4).
    pub weights: [f64; 4],
    /// Unit vector along which the first point must stay ahead of the second, (3).
    pub normal: Vector3<f64>,
    /// How far outside the features the points lie, in their barycentric coordinates; below 0 inside.
    pub outside: f64,
}

impl FeaturePair {
    /// The distance along the normal where the nodes are at `at` \[m\].
    pub fn gap_m(&self, nodes: &[u32; 4], at: impl Fn(u32) -> Vector3<f64>) -> f64 {
        self.normal.dot(&weighted(nodes, &self.weights, at))
    }
}

/// Whether the vertex of a pair turns its outside towards the face. Edges are looked at by [`stance`].
pub(super) fn faces_each_other(
    shells: [&Shell; 2],
    pair: &Pair,
    normal: &Vector3<f64>,
    at: impl Fn(u32) -> Vector3<f64>,
) -> bool {
    let (shell, vertex) = match pair {
        Pair::VertexFace(vertex, _) => (shells[0], *vertex),
        Pair::FaceVertex(_, vertex) => (shells[1], *vertex),
        Pair::EdgeEdge(..) => return true,
    };
    let own = shell.node_normal(vertex, at);
    own.dot(normal) <= -OPPOSITE * own.norm()
}

/// How far a face beside another one rises above that one's plane \[m\], as in a valley; below 0 if it falls away.
pub(super) fn rise_m(face: &[u32; 3], next: &[u32; 3], at: impl Fn(u32) -> Vector3<f64>) -> f64 {
    let [a, b, c] = face.map(&at);
    let normal = (b - a).cross(&(c - a)).try_normalize(0.0);
    let beyond = next.iter().filter(|node| !face.contains(node));
    let heights = beyond.map(|node| normal.unwrap_or_default().dot(&(at(*node) - a)));
    heights.fold(f64::NEG_INFINITY, f64::max)
}

/// Sum of the nodes' positions times weights.
pub(super) fn weighted(
    nodes: &[u32; 4],
    weights: &[f64; 4],
    at: impl Fn(u32) -> Vector3<f64>,
) -> Vector3<f64> {
    let parts = nodes.iter().zip(weights);
    parts.map(|(node, weight)| at(*node) * *weight).sum()
}

/// Whether a direction across an edge lies between the normals of its faces, or nearly so; `mean` is theirs, whose length
/// is the cosine of half of the angle between them.
fn sees(mean: &Vector3<f64>, direction: &Vector3<f64>) -> bool {
    let cosine = mean.norm();
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let along = mean.dot(direction);
    along > 0.0 && along >= cosine * (cosine * TILTED[0] - sine * TILTED[1])
}

/// How a pair stands where the nodes are at `at`; nothing if it cannot be said or they do not face each other.
pub(super) fn stance(
    shells: [&Shell; 2],
    pair: &Pair,
    at: impl Fn(u32) -> Vector3<f64>,
) -> Option<FeaturePair> {
    let mut found = opposite(pair, &at)?;
    if let Pair::EdgeEdge(one, other) = pair {
        let first = shells[0].edge_normal(one, &at);
        let second = shells[1].edge_normal(other, &at);
        found.turn(&(second - first));
        if !sees(&second, &found.normal) || !sees(&first, &-found.normal) {
            return None;
        }
    }
    Some(found)
}

/// As [`stance`], for a pair whose normal is about `normal`: of edges no faces are looked at.
pub(super) fn stance_along(
    normal: &Vector3<f64>,
    pair: &Pair,
    at: impl Fn(u32) -> Vector3<f64>,
) -> Option<FeaturePair> {
    let mut found = opposite(pair, at)?;
    if let Pair::EdgeEdge(..) = pair {
        found.turn(normal);
    }
    Some(found)
}

impl FeaturePair {
    /// Turns the normal to the side of `along`.
    fn turn(&mut self, along: &Vector3<f64>) {
        if self.normal.dot(along) < 0.0 {
            self.normal = -self.normal;
        }
    }
}

/// The points opposite each other, and the face's normal or, either way round, the common perpendicular.
fn opposite(pair: &Pair, at: impl Fn(u32) -> Vector3<f64>) -> Option<FeaturePair> {
    let [a, b, c, d] = pair.nodes().map(&at);
    if let Pair::EdgeEdge(..) = pair {
        let (along, across, from) = (b - a, d - c, a - c);
        let perpendicular = along.cross(&across);
        let squares = along.norm_squared() * across.norm_squared();
        let area = perpendicular.norm_squared();
        let s = across.cross(&from).dot(&perpendicular) / area;
        let t = along.cross(&from).dot(&perpendicular) / area;
        // Numbers that are none are not above anything.
        (area > PARALLEL * PARALLEL * squares).then_some(FeaturePair {
            weights: [1.0 - s, s, t - 1.0, -t],
            normal: perpendicular / area.sqrt(),
            outside: (-s).max(s - 1.0).max(-t).max(t - 1.0),
        })
    } else {
        let whole = (c - b).cross(&(d - b));
        let square = whole.norm_squared();
        let part = |from: &Vector3<f64>, to: &Vector3<f64>| {
            (from - a).cross(&(to - a)).dot(&whole) / square
        };
        let [u, v, w] = [part(&c, &d), part(&d, &b), part(&b, &c)];
        (u + v + w).is_finite().then_some(FeaturePair {
            weights: [1.0, -u, -v, -w],
            normal: whole / square.sqrt(),
            outside: (-u).max(-v).max(-w),
        })
    }
}
