//! How two features stand to each other: the points that are opposite, the direction that keeps them apart.
//!
//! Entry point: [`stance`]. A vertex and a face are kept apart along the face's normal. Two edges are kept
//! apart along their common perpendicular, which is how their distance changes; the mean of the incident
//! faces' normals (younes-2021, 2.2.6) says which way it points. The latter alone would let edges that slide
//! pass through each other in first order.

use super::body::Pair;
use super::shell::{Shell, normal};
use nalgebra::Vector3;

/// Sine of the angle below which two edges are parallel: their ends meet faces.
const PARALLEL: f64 = 0.05;
/// Least part of the common perpendicular that the edges' mean normals must see: else they lie beside each
/// other, or one is a valley.
const FACING: f64 = 0.1;

/// Most that the normals at a vertex may have, in the mean, along the normal of a face that it meets: with more it comes
/// from within its own body.
const TURNED: f64 = 0.2;

/// Two features that stand opposite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stance {
    /// With these the nodes' positions add up to the difference between the two points, (4).
    pub weights: [f64; 4],
    /// Unit vector along which the first point must stay ahead of the second, (3).
    pub normal: Vector3<f64>,
    /// How far outside the features the points lie, in their barycentric coordinates; below 0 inside.
    pub outside: f64,
}

impl Stance {
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
    shell.node_normal(vertex, at).dot(normal) <= TURNED
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

/// How a pair stands where the nodes are at `at`; nothing if it cannot be said or they do not face each other.
pub(super) fn stance(
    shells: [&Shell; 2],
    pair: &Pair,
    at: impl Fn(u32) -> Vector3<f64>,
) -> Option<Stance> {
    let nodes = pair.nodes();
    let [a, b, c, d] = nodes.map(&at);
    match pair {
        Pair::EdgeEdge(one, other) => {
            let (along, across, from) = (b - a, d - c, a - c);
            let perpendicular = along.cross(&across);
            let squares = along.norm_squared() * across.norm_squared();
            let area = perpendicular.norm_squared();
            // Numbers that are none are not above anything.
            let crossing = area > PARALLEL * PARALLEL * squares;
            if !crossing {
                return None;
            }
            let s = across.cross(&from).dot(&perpendicular) / area;
            let t = along.cross(&from).dot(&perpendicular) / area;
            let [first, second] = [
                shells[0].edge_normal(one, &at),
                shells[1].edge_normal(other, &at),
            ];
            let mut normal = perpendicular / area.sqrt();
            if normal.dot(&(second - first)) < 0.0 {
                normal = -normal;
            }
            if normal.dot(&second) < FACING || -normal.dot(&first) < FACING {
                return None;
            }
            Some(Stance {
                weights: [1.0 - s, s, t - 1.0, -t],
                normal,
                outside: [-s, s - 1.0, -t, t - 1.0]
                    .into_iter()
                    .fold(f64::MIN, f64::max),
            })
        }
        Pair::VertexFace(..) | Pair::FaceVertex(..) => {
            let face = [nodes[1], nodes[2], nodes[3]];
            let whole = normal(&face, &at);
            let square = whole.norm_squared();
            let part = |from: &Vector3<f64>, to: &Vector3<f64>| {
                (from - a).cross(&(to - a)).dot(&whole) / square
            };
            let [u, v, w] = [part(&c, &d), part(&d, &b), part(&b, &c)];
            let normal = whole / square.sqrt();
            (u + v + w).is_finite().then_some(Stance {
                weights: [1.0, -u, -v, -w],
                normal,
                outside: (-u).max(-v).max(-w),
            })
        }
    }
}
