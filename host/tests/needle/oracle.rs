//! Every face of the mesh against the whole curve, with none of the product's machinery: barycentric
//! coordinates of where the line or circle meets the face's plane.
//!
//! A tie is broken here by moving the curve, not by rules for signs. The product has what lies on the curve's
//! plane above it and what lies on the curve to its left: that is the curve a little to the right and, by much
//! less, below.

use nalgebra::Vector3;
use std::f64::consts::TAU;
use sutura_host::mesh::{HalfFace, HalfFaces};
use sutura_host::needle::Curve;

/// How far the curve is moved to decide what is crossed: to the right, and down.
#[derive(Clone, Copy)]
pub struct Aside(pub f64, pub f64);

/// For meshes that the curve meets in nothing but the inside of faces.
pub const NOT: Aside = Aside(0.0, 0.0);

/// A passage through a face.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub face: HalfFace,
    pub enters: bool,
    pub from: Option<u32>,
    pub to: Option<u32>,
    /// Of the curve where it is.
    pub alpha: f64,
    /// Of the curve moved aside: what the order follows.
    order: f64,
    /// Sine of the angle between curve and face.
    pub steepness: f64,
}

/// Where a line or circle meets the plane through `on` across `normal`, within half a turn of 0. A circle whose
/// farthest point is within `touch` radii of the plane has that one point there.
fn meets(curve: &Curve, normal: &Vector3<f64>, on: &Vector3<f64>, touch: f64) -> [Option<f64>; 2] {
    let distance = normal.dot(&(on - curve.start));
    let (along, across) = (normal.dot(&curve.tangent), normal.dot(&curve.inward));
    if curve.curvature == 0.0 {
        let alpha = distance / along;
        return [alpha.is_finite().then_some(alpha), None];
    }
    // along sin(t) + across (1 - cos(t)) = distance / r.
    let reach = along.hypot(across);
    let level = (across - distance * curve.curvature) / reach;
    if level.is_nan() || level.abs() >= 1.0 + touch {
        return [None; 2];
    }
    let level = if level.abs() > 1.0 - touch {
        level.signum()
    } else {
        level
    };
    // along sin(t) - across cos(t) = -level reach is sin(t - phase) = -level.
    let phase = across.atan2(along);
    let first = (-level).asin();
    [first, TAU / 2.0 - first].map(|angle| {
        let angle = angle + phase;
        Some((angle - (angle / TAU).round() * TAU) / curve.curvature)
    })
}

/// Barycentric coordinates of a point of a triangle's plane.
fn weights(corners: &[Vector3<f64>; 3], normal: &Vector3<f64>, at: &Vector3<f64>) -> [f64; 3] {
    let [a, b, c] = corners.map(|corner| corner - at);
    let area = normal.norm_squared();
    [b.cross(&c), c.cross(&a), a.cross(&b)].map(|part| part.dot(normal) / area)
}

fn moved(curve: &Curve, Aside(right, down): Aside) -> Curve {
    let mut moved = *curve;
    moved.start -= curve.binormal() * down + curve.inward * right;
    if curve.curvature != 0.0 {
        // About the same centre.
        moved.curvature = (curve.curvature.recip() + right).recip();
    }
    moved
}

/// Distance of a point from the whole line or circle.
fn distance(curve: &Curve, point: &Vector3<f64>) -> f64 {
    let from = point - curve.start;
    let (along, across) = (from.dot(&curve.tangent), from.dot(&curve.inward));
    let height = from.dot(&curve.binormal());
    if curve.curvature == 0.0 {
        return across.hypot(height);
    }
    let radius = curve.curvature.recip();
    (along.hypot(across - radius) - radius).hypot(height)
}

/// The faces of tissue that does not move.
pub struct Oracle<'a> {
    mesh: &'a HalfFaces,
    faces: Vec<Face>,
}

struct Face {
    half: HalfFace,
    corners: [Vector3<f64>; 3],
    normal: Vector3<f64>,
    /// Nothing of it is farther from its first corner.
    reach: f64,
}

impl<'a> Oracle<'a> {
    pub fn new(mesh: &'a HalfFaces, at: &[Vector3<f64>]) -> Self {
        let face = |half: &HalfFace| {
            let corners = mesh.vertices(*half).map(|node| at[node as usize]);
            let [a, b, c] = corners;
            Face {
                half: *half,
                corners,
                normal: (b - a).cross(&(c - a)),
                reach: (b - a).norm().max((c - a).norm()),
            }
        };
        let faces = mesh.faces().iter().map(face).collect();
        Self { mesh, faces }
    }

    /// All that the curve passes from `first` on, alpha in order, to `last`; chained from the outside.
    ///
    /// # Panics
    /// If passages do not follow each other through the cells.
    pub fn crossings(&self, curve: &Curve, [first, last]: [f64; 2], aside: Aside) -> Vec<Found> {
        let curve_moved = moved(curve, aside);
        // Lengths of a circle grow with its radius.
        let stretch = match curve.curvature {
            0.0 => 1.0,
            curvature => curve_moved.curvature / curvature,
        };
        let turn = TAU / curve.curvature;
        let branch = |alpha: f64| match curve.curvature {
            0.0 => alpha,
            _ => first + (alpha - first).rem_euclid(turn),
        };
        let mut found = Vec::new();
        for face in &self.faces {
            let Face {
                half,
                corners,
                normal,
                reach,
            } = face;
            let a = corners[0];
            if distance(&curve_moved, &a) > 1.001 * reach {
                continue;
            }
            for alpha in meets(&curve_moved, normal, &a, 0.0).into_iter().flatten() {
                let hit = weights(corners, normal, &curve_moved.at(alpha));
                if !hit.iter().all(|w| *w > 0.0) {
                    continue;
                }
                let order = branch(alpha * stretch);
                let near = |alpha: &f64| (alpha - order).abs();
                let exact = meets(curve, normal, &a, 1e-13)
                    .into_iter()
                    .flatten()
                    .map(branch);
                let exact = exact
                    .min_by(|a, b| near(a).total_cmp(&near(b)))
                    .unwrap_or(order);
                let steepness = curve.tangent_at(exact).dot(normal) / normal.norm();
                let (inside, outside) = (Some(half.cell()), self.mesh.opposite(*half));
                // The half-face's normal points out of its cell.
                let outwards = curve_moved.tangent_at(alpha).dot(normal) > 0.0;
                let behind = outside.map(HalfFace::cell);
                let (from, to) = if outwards {
                    (inside, behind)
                } else {
                    (behind, inside)
                };
                let side = if outwards { Some(*half) } else { outside };
                found.push(Found {
                    face: side.unwrap_or(*half),
                    enters: side.is_none(),
                    from,
                    to,
                    alpha: exact,
                    order,
                    steepness: steepness.abs(),
                });
            }
        }
        found.sort_by(|a, b| a.order.total_cmp(&b.order));
        let mut chain: Vec<Found> = Vec::new();
        let mut cell = None;
        while !found.is_empty() {
            // Bodies that touch have two faces in one place.
            let next = found
                .iter()
                .take_while(|next| next.order < found[0].order + 1e-12 * curve.length)
                .position(|next| next.from == cell);
            let mut next = found.remove(next.unwrap_or_else(|| {
                panic!("nothing goes on from {cell:?} after {chain:?}: {found:?}")
            }));
            cell = next.to;
            if let Some(before) = chain.last() {
                next.alpha = next.alpha.max(before.alpha);
            }
            chain.push(next);
        }
        chain.retain(|c| c.alpha <= last);
        chain
    }
}
