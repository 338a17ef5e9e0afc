//! A workload for measurements: anchors that circle together while their rows turn and some slide across
//! an edge to the next face, so that nothing about the compliance between them stays the same from step
//! to step.
//!
//! Entry points: [`Circling::new`], [`Circling::at`].

use super::{AnchorPoint, PointConstraint};
use crate::mesh::TetMesh;
use crate::rows::RowKind;
use nalgebra::{Rotation3, Unit, Vector3};

/// Radius of the circles \[m\].
pub const RADIUS_M: f64 = 0.005;
/// Circles a second \[Hz\].
pub const RATE_HZ: f64 = 1.0;
/// Share of the anchors that change their face in every step.
pub const CHANGING: f64 = 0.1;
/// How far on either side of the edge that they cross anchors lie, as a part of the face's height.
const BESIDE: f64 = 0.02;
/// Time in which the circles grow to their radius \[s\].
const GROWING_S: f64 = 0.25;

/// Anchors on the boundary, away from what is fixed, three equality rows each.
#[derive(Clone, Debug)]
pub struct Circling {
    /// The two faces at the edge that each anchor crosses, the edge's nodes first.
    faces: Vec<[[u32; 3]; 2]>,
    /// Axis about which each anchor's directions turn.
    axes: Vec<Unit<Vector3<f64>>>,
    radius_m: f64,
    points: Vec<AnchorPoint>,
    rows: Vec<PointConstraint>,
}

/// A face and the one across its first edge, that edge's nodes first: itself where there is none, as beside a fixed node.
fn neighbours(faces: &[[u32; 3]], home: usize) -> [[u32; 3]; 2] {
    let [a, b, c] = faces[home];
    let opposite = |face: &[u32; 3]| {
        let on_edge = |node: &u32| [a, b].contains(node);
        let count = face.iter().filter(|node| on_edge(node)).count();
        face.iter()
            .copied()
            .find(|node| count == 2 && !on_edge(node))
    };
    let others = faces.iter().enumerate().filter(|(index, _)| *index != home);
    let across = others.map(|(_, face)| face).find_map(opposite);
    [[a, b, c], [a, b, across.unwrap_or(c)]]
}

impl Circling {
    /// `count` anchors on `mesh`, spread over the half of its boundary that is farthest from the nodes
    /// `fixed`, on circles of `scale` times [`RADIUS_M`]. `None` if it has not so many faces without
    /// fixed nodes.
    pub fn new(mesh: &TetMesh, fixed: &[u32], count: usize, scale: f64) -> Option<Self> {
        let points = mesh.points_m();
        let point = |node: u32| Vector3::from(points[node as usize]);
        let mut is_fixed = vec![false; points.len()];
        for &node in fixed {
            is_fixed[node as usize] = true;
        }
        let surface = mesh.surface();
        let free: Vec<[u32; 3]> = surface
            .triangles
            .iter()
            .copied()
            .filter(|face| face.iter().all(|node| !is_fixed[*node as usize]))
            .collect();
        let middle = |face: &[u32; 3]| (point(face[0]) + point(face[1]) + point(face[2])) / 3.0;
        let clearance = |face: &[u32; 3]| {
            let at = middle(face);
            fixed
                .iter()
                .map(|node| (point(*node) - at).norm_squared())
                .fold(f64::INFINITY, f64::min)
        };
        let mut order: Vec<(f64, usize)> = (0..free.len())
            .map(|face| (clearance(&free[face]), face))
            .collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.truncate(free.len().div_ceil(2));
        if order.len() < count || count == 0 {
            return None;
        }
        // Each next home is the face farthest from all homes before it.
        let mut homes: Vec<usize> = vec![order[0].1];
        let mut distance = vec![f64::INFINITY; order.len()];
        while homes.len() < count {
            let last = middle(&free[*homes.last()?]);
            for (distance, (_, face)) in distance.iter_mut().zip(&order) {
                *distance = distance.min((middle(&free[*face]) - last).norm_squared());
            }
            let farthest = (0..order.len()).max_by(|a, b| distance[*a].total_cmp(&distance[*b]))?;
            homes.push(order[farthest].1);
        }
        let faces = homes.iter().map(|home| neighbours(&free, *home)).collect();
        let axes = (0..count)
            .map(|index| {
                let angle = 2.4 * index as f64;
                Unit::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.5))
            })
            .collect();
        let no_point = AnchorPoint {
            nodes: [0; 4],
            weights: [0.0; 4],
        };
        let no_row = PointConstraint {
            id: 0,
            anchor: 0,
            kind: RowKind::Equality,
            direction: [0.0; 3],
            target_m: 0.0,
        };
        Some(Self {
            faces,
            axes,
            radius_m: scale * RADIUS_M,
            points: vec![no_point; count],
            rows: vec![no_row; 3 * count],
        })
    }

    /// Anchors and rows of one step at so many steps a second.
    pub fn at(&mut self, step: u64, rate_hz: f64) -> (&[AnchorPoint], &[PointConstraint]) {
        let time_s = step as f64 / rate_hz;
        let grown = (time_s / GROWING_S).min(1.0);
        let radius = self.radius_m * grown * grown * (3.0 - 2.0 * grown);
        let angle = std::f64::consts::TAU * RATE_HZ * time_s;
        let moved = Vector3::new(radius * angle.cos(), 0.0, radius * angle.sin());
        let every = (1.0 / CHANGING) as u64;
        for (index, faces) in self.faces.iter().enumerate() {
            let crossings = (step + index as u64) / every;
            let [a, b, c] = faces[crossings as usize % 2];
            self.points[index] = AnchorPoint {
                nodes: [a, b, c, a],
                weights: [0.5 - 0.5 * BESIDE, 0.5 - 0.5 * BESIDE, BESIDE, 0.0],
            };
            let turned = Rotation3::from_axis_angle(&self.axes[index], angle + index as f64);
            for axis in 0..3 {
                let direction: Vector3<f64> = turned.matrix().column(axis).into();
                self.rows[3 * index + axis] = PointConstraint {
                    id: (3 * index + axis) as u64,
                    anchor: index as u32,
                    kind: RowKind::Equality,
                    direction: direction.into(),
                    target_m: direction.dot(&moved),
                };
            }
        }
        (&self.points, &self.rows)
    }
}
