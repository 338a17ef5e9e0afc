//! Open edges closed where there is one way to do it: at points that lie on them, and around holes that are small or flat.
//!
//! Entry point: [`TriangleMesh::close`]. Triangles that fill a hole look as the one at its first edge does.

use super::check::edges;
use super::{MOST_CORNERS, TriangleMesh, polygon};
use nalgebra::Vector3;
use std::collections::{BTreeMap, HashSet};

/// Edges of a hole that is filled however it is bent: what a lost point and its triangles leave.
const FEW: usize = 12;
/// A hole of more edges is filled where its corners are this near to one plane, in parts of its size.
const FLAT: f64 = 1e-3;
/// A surface with more open edges is none with small holes: to look for points on each grows with their square.
const MOST_OPEN: usize = 10_000;

/// What was closed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Closing {
    /// Edges that were split at a point on them.
    pub split_edges: usize,
    /// Holes that were filled.
    pub holes: usize,
}

impl TriangleMesh {
    /// Splits triangles at points within `same_m` of their open edges, and fills holes of few edges and flat ones.
    pub(super) fn close(&mut self, same_m: f64) -> Closing {
        let split_edges = self.split_open(same_m);
        let mut holes = 0;
        for (face, hole) in self.holes() {
            let is_sound = hole.len() <= FEW || hole.len() <= MOST_CORNERS && self.is_flat(&hole);
            if !is_sound {
                continue;
            }
            holes += 1;
            for triangle in polygon::split(&self.points_m, &hole) {
                self.triangles.push(triangle);
                self.faces.push(face);
            }
        }
        Closing { split_edges, holes }
    }

    /// Triangles and their sides at edges that no other triangle has, in the order of the edges' points.
    fn open_edges(&self) -> Vec<(usize, usize)> {
        let sides = self.sides();
        let at_edges = sides.chunk_by(|one, other| one.0 == other.0);
        at_edges
            .filter(|at_edge| at_edge.len() == 1)
            .map(|at_edge| (at_edge[0].1, at_edge[0].2))
            .collect()
    }

    /// Splits triangles until no end of an open edge lies on another one (a T-vertex); how many edges.
    fn split_open(&mut self, same_m: f64) -> usize {
        let mut split = 0;
        loop {
            let open = self.open_edges();
            if open.len() > MOST_OPEN {
                return split;
            }
            let end = |&(triangle, side): &(usize, usize)| self.triangles[triangle][side];
            let mut points: Vec<u32> = open.iter().map(end).collect();
            points.extend(
                open.iter()
                    .map(|&(triangle, side)| self.triangles[triangle][(side + 1) % 3]),
            );
            points.sort_unstable();
            points.dedup();
            let (before, mut changed) = (split, HashSet::new());
            for (triangle, side) in open {
                // Its other sides are others by then.
                if changed.contains(&triangle) {
                    continue;
                }
                if let Some(point) = self.on_edge(triangle, side, &points, same_m) {
                    changed.insert(triangle);
                    self.split_edge(triangle, side, point);
                    split += 1;
                }
            }
            if split == before {
                return split;
            }
        }
    }

    /// Which of `points` lies on an edge between its ends, the nearest to its middle: each half has as few of the others as can be.
    fn on_edge(&self, triangle: usize, side: usize, points: &[u32], same_m: f64) -> Option<u32> {
        let (from, to) = edges(&self.triangles[triangle])[side];
        let at = |point: u32| Vector3::from(self.points_m[point as usize]);
        let (start, way) = (at(from), at(to) - at(from));
        let off_middle = |point: u32| {
            let along = (at(point) - start).dot(&way) / way.norm_squared();
            let off_m = (at(point) - start - along * way).norm();
            let is_on =
                point != from && point != to && 0.0 < along && along < 1.0 && off_m <= same_m;
            is_on.then_some(((along - 0.5).abs(), point))
        };
        let on = points.iter().filter_map(|point| off_middle(*point));
        let nearest = on.min_by(|one, other| one.0.total_cmp(&other.0));
        nearest.map(|(_, point)| point)
    }

    /// Two triangles in place of one, from a point on its side to the corner across.
    fn split_edge(&mut self, triangle: usize, side: usize, point: u32) {
        let mut other = self.triangles[triangle];
        self.triangles[triangle][(side + 1) % 3] = point;
        other[side] = point;
        self.triangles.push(other);
        self.faces.push(self.faces[triangle]);
    }

    /// Rings of open edges that meet no other ring, each with the number of a face beside it.
    fn holes(&self) -> Vec<(u32, Vec<u32>)> {
        let open = self.open_edges();
        if open.len() > MOST_OPEN {
            return Vec::new();
        }
        let mut beside: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for &(triangle, side) in &open {
            let (from, to) = edges(&self.triangles[triangle])[side];
            beside.entry(from).or_default().push(to);
            beside.entry(to).or_default().push(from);
        }
        let mut seen = HashSet::new();
        let mut holes = Vec::new();
        for (triangle, side) in open {
            let (first, second) = edges(&self.triangles[triangle])[side];
            if !seen.insert(first) {
                continue;
            }
            let (mut ring, mut before, mut here) = (vec![first], first, second);
            while here != first && seen.insert(here) {
                ring.push(here);
                let next = beside[&here].iter().find(|next| **next != before);
                (before, here) = (here, next.copied().unwrap_or(before));
            }
            let is_ring = here == first && ring.iter().all(|point| beside[point].len() == 2);
            if is_ring && ring.len() > 2 {
                // The triangle passes its edge from the first point to the second: what is to fill the hole goes the other way.
                ring.reverse();
                holes.push((self.faces[triangle], ring));
            }
        }
        holes
    }

    /// Whether points are near to one plane.
    fn is_flat(&self, ring: &[u32]) -> bool {
        let at = |point: &u32| Vector3::from(self.points_m[*point as usize]);
        let Some(normal) = polygon::normal(&self.points_m, ring).try_normalize(0.0) else {
            return false;
        };
        let origin = at(&ring[0]);
        let size_m = ring.iter().map(|point| (at(point) - origin).norm());
        let off_m = ring
            .iter()
            .map(|point| (at(point) - origin).dot(&normal).abs());
        off_m.fold(0.0, f64::max) <= FLAT * size_m.fold(0.0, f64::max)
    }
}
