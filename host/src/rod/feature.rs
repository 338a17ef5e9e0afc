//! What of the surface a rod comes near to, and how near: an edge of the boundary, a vertex that stands out, and a face under one of its
//! ends or where its curve bulges.
//!
//! Entry point: [`Balance::find`]. Edges count by the distance of their line from the curve where both are nearest, which does not turn
//! with the thickness of the rod. What bulges over a face is a row of points that are fixed on the curve, so dense that it is not seen
//! between them: as an arc rolls, or a face turns, the solve finds by itself which of them touches.

use super::shape::Rod;
use super::touch::Swept;
use crate::anchors::AnchorPoint;
use crate::mesh::{HalfFace, Side};
use crate::step::Balance;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Least part of an edge across the rod that it crosses.
const ACROSS: f64 = 1e-3;
/// A vertex stands out when no neighbour lies higher by this part of the way there.
const STANDS_OUT: f64 = 0.02;
/// Least cosine between the direction in which something is touched and the surface's normal.
const FACING: f64 = 0.3;
/// Steps in which the place on a circle nearest to an edge is looked for.
const LOOKS: u32 = 8;
/// Least of the distance over the radius of a circle that an edge lies inside of: near the centre all of it is as near.
const LEAST_BEND: f64 = -0.9;

/// What of the surface is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) enum Feature {
    /// By its vertices, the lower one first.
    Edge([u32; 2]),
    Vertex(u32),
    Face(HalfFace, Part),
}

/// Which point of a rod is over a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) enum Part {
    End,
    Front,
    /// One of those that stand for what bends, by its number.
    Bulge(u32),
}

/// A feature as a rod sees it.
pub(super) struct Found {
    pub at: AnchorPoint,
    pub alpha: f64,
    pub normal: Vector3<f64>,
    /// From the rod's surface \[m\]; negative inside.
    pub gap_m: f64,
    /// Whether the feature and the rod end beyond this place.
    pub is_within: bool,
    /// Of a cell at it.
    pub cell: u32,
}

impl Balance<'_> {
    /// A feature beside the place `near` on a rod.
    pub(super) fn find(&self, swept: &impl Swept, feature: Feature, near: f64) -> Option<Found> {
        let rod = swept.rod();
        let found = match feature {
            Feature::Edge(nodes) => self.find_edge(rod, nodes, near),
            Feature::Vertex(node) => self.find_vertex(rod, node, near),
            Feature::Face(face, part) => self.find_face(rod, face, part),
        };
        found.map(|found| Found {
            is_within: found.is_within && swept.is_free(found.alpha),
            ..found
        })
    }

    /// A side of the boundary by its vertices.
    fn side(&self, [a, b]: [u32; 2]) -> Option<Side> {
        let boundary = self.sources.mesh.boundary();
        let mut leaving = boundary.leaving(a);
        leaving.find(|side| boundary.side_vertices(*side)[1] == b)
    }

    /// An edge against the rod where that is nearest to it.
    fn find_edge(&self, rod: &Rod, nodes: [u32; 2], near: f64) -> Option<Found> {
        let boundary = self.sources.mesh.boundary();
        let side = self.side(nodes)?;
        let [from, to] = nodes.map(|node| self.position(node));
        let (alpha, part, is_end) = nearest(rod, &from, &to, near)?;
        let [one, other] = [side, boundary.opposite(side)].map(|side| {
            let area = self.area(side.triangle());
            area.try_normalize(0.0).unwrap_or_default()
        });
        let out = (one + other).try_normalize(0.0)?;
        let edge = to - from;
        let apart = rod.curve.at(alpha) - from - edge * part;
        let across = edge.cross(&rod.curve.tangent_at(alpha));
        // What bulges along an edge, or ends beside it, looks at it straight.
        let is_crossed = !is_end && across.norm_squared() > ACROSS * edge.norm_squared();
        let way = if is_crossed { across } else { apart };
        let normal = way.try_normalize(0.0)?;
        let facing = normal.dot(&out);
        let normal = normal * facing.signum();
        let face = boundary.half_faces().get(side.triangle())?;
        (facing.abs() > FACING).then(|| Found {
            at: AnchorPoint {
                nodes: [nodes[0], nodes[1], nodes[0], nodes[0]],
                weights: [1.0 - part, part, 0.0, 0.0],
            },
            alpha,
            normal,
            gap_m: normal.dot(&apart) - rod.radius_m,
            is_within: (0.0..=1.0).contains(&part),
            cell: face.cell(),
        })
    }

    /// A vertex that stands out towards the rod.
    fn find_vertex(&self, rod: &Rod, node: u32, near: f64) -> Option<Found> {
        let boundary = self.sources.mesh.boundary();
        let (at, out) = (self.position(node), self.node_normal(node));
        let (alpha, is_end) = rod.ended(rod.curve.project(&at, near));
        let along = rod.curve.tangent_at(alpha);
        let apart = rod.curve.at(alpha) - at;
        let apart = match is_end {
            true => apart,
            false => apart - along * along.dot(&apart),
        };
        let distance = apart.norm();
        let normal = apart.try_normalize(1e-3 * rod.radius_m)?;
        let facing = normal.dot(&out);
        let normal = normal * facing.signum();
        let face = boundary.leaving(node).next()?;
        let face = boundary.half_faces().get(face.triangle())?;
        let is_within = boundary.leaving(node).all(|side| {
            let way = self.position(boundary.side_vertices(side)[1]) - at;
            normal.dot(&way) <= STANDS_OUT * way.norm()
        });
        (facing.abs() > FACING).then(|| Found {
            at: AnchorPoint {
                nodes: [node; 4],
                weights: [1.0, 0.0, 0.0, 0.0],
            },
            alpha,
            normal,
            gap_m: distance * facing.signum() - rod.radius_m,
            is_within,
            cell: face.cell(),
        })
    }

    /// A face under an end of the rod, or where that bulges.
    fn find_face(&self, rod: &Rod, face: HalfFace, part: Part) -> Option<Found> {
        let nodes = self.sources.mesh.vertices(face);
        let [a, b, c] = nodes.map(|node| self.position(node));
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let alpha = match part {
            Part::End => 0.0,
            Part::Front => rod.front_m,
            Part::Bulge(number) => rod.bulge(number),
        };
        let at = rod.curve.at(alpha);
        let inner = Matrix3::from_columns(&[b - a, c - a, normal]).try_inverse()? * (at - a);
        let weights = [1.0 - inner.x - inner.y, inner.x, inner.y];
        Some(Found {
            at: AnchorPoint {
                nodes: [nodes[0], nodes[1], nodes[2], nodes[0]],
                weights: [weights[0], weights[1], weights[2], 0.0],
            },
            alpha,
            normal,
            gap_m: inner.z - rod.radius_m,
            is_within: weights.iter().all(|weight| *weight >= 0.0),
            cell: face.cell(),
        })
    }
}

/// Where a rod and the line from one point to another are nearest, beside the place `near` on the rod: on it \[m\], in parts of the line,
/// and whether that is an end of the rod. By Newton's method on their distance; `None` where they run side by side.
fn nearest(
    rod: &Rod,
    from: &Vector3<f64>,
    to: &Vector3<f64>,
    near: f64,
) -> Option<(f64, f64, bool)> {
    let (curve, edge) = (&rod.curve, to - from);
    let square = edge.norm_squared();
    let mut alpha = curve.project(&((from + to) * 0.5), near);
    let mut part = 0.5;
    for _ in 0..LOOKS {
        let [along, inward, _] = curve.frame_at(alpha);
        let apart = curve.at(alpha) - from;
        let bend = curve.curvature_at(alpha) * inward.dot(&(apart - edge * part));
        let slant = along.dot(&edge);
        let across = square * (1.0 + bend) - slant * slant;
        if across <= ACROSS * square || bend <= LEAST_BEND {
            return None;
        }
        part = (apart.dot(&edge) * (1.0 + bend) - slant * apart.dot(&along)) / across;
        let ahead = (part * slant - apart.dot(&along)) / (1.0 + bend);
        alpha += ahead;
        if ahead.abs() <= 1e-14 * curve.length {
            break;
        }
    }
    let (alpha, is_end) = rod.ended(alpha);
    if is_end {
        part = (curve.at(alpha) - from).dot(&edge) / square;
    }
    Some((alpha, part, is_end))
}
