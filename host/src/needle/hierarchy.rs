//! Boxes around the boundary's faces, so that what touches a surface is found without looking at all of it.
//!
//! Entry point: [`Hierarchy::near`]. Our own rather than a crate's: a query takes boxes grown by how far the
//! tissue has moved since the boxes were made, allocates nothing, and leaves the test of a box to the caller.
//! Binary, halved at the median of the longest side.

use crate::mesh::{HalfFace, HalfFaces};
use nalgebra::Vector3;

/// Faces in a leaf.
const LEAF: usize = 4;
/// A binary tree halved at the median of 2^32 faces at most is no deeper.
const DEPTH: usize = 34;

/// An axis-aligned box \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates.
    pub low: Vector3<f64>,
    /// Greatest coordinates.
    pub high: Vector3<f64>,
}

impl Bounds {
    /// Around nothing.
    const NONE: Self = Self {
        low: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        high: Vector3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    fn with(&self, other: &Self) -> Self {
        Self {
            low: self.low.inf(&other.low),
            high: self.high.sup(&other.high),
        }
    }

    /// Whether a segment, given by its middle and half its way, comes within `reach` of the box in every
    /// direction that could separate them; never wrong about one that does. Not a number: it does.
    pub fn meets(&self, middle: &Vector3<f64>, half: &Vector3<f64>, reach: f64) -> bool {
        let centre = (self.low + self.high) * 0.5;
        let size = (self.high - self.low) * 0.5 + Vector3::repeat(reach);
        let from = middle - centre;
        let apart = |distance: f64, within: f64| distance.abs() > within;
        let along = |k: usize| apart(from[k], size[k] + half[k].abs());
        if along(0) || along(1) || along(2) {
            return false;
        }
        let across = from.cross(half);
        let (h, rounding) = (half.abs(), 1e-15 * from.amax() * half.amax());
        let within = |i: usize, j: usize| size[i] * h[j] + size[j] * h[i] + rounding;
        !(apart(across.x, within(1, 2))
            || apart(across.y, within(0, 2))
            || apart(across.z, within(0, 1)))
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    /// Of a leaf its first face, else its first child; the second follows.
    first: u32,
    /// Faces of a leaf; else 0.
    faces: u32,
}

/// A tree of boxes over the boundary faces of a mesh.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// Children after their parents.
    nodes: Vec<Node>,
    faces: Vec<HalfFace>,
}

impl Hierarchy {
    /// Around the boundary of `mesh` with its vertices at `at`.
    pub fn new(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>) -> Self {
        let mut faces: Vec<(Vector3<f64>, HalfFace)> = mesh
            .boundary()
            .half_faces()
            .iter()
            .map(|face| {
                let bounds = bounds_of(mesh, &at, *face);
                (bounds.low + bounds.high, *face)
            })
            .collect();
        let leaf = |first: usize, faces: usize| Node {
            bounds: Bounds::NONE,
            first: first as u32,
            faces: faces as u32,
        };
        let mut nodes = vec![leaf(0, faces.len())];
        let mut place = 0;
        while let Some(&node) = nodes.get(place) {
            let (first, count) = (node.first as usize, node.faces as usize);
            if count > LEAF {
                let part = &mut faces[first..first + count];
                let middles = part.iter().map(|(middle, _)| Bounds {
                    low: *middle,
                    high: *middle,
                });
                let around = middles.fold(Bounds::NONE, |a, b| a.with(&b));
                let axis = (around.high - around.low).imax();
                // Whole leaves on the left, so that a tree of as few leaves as can be is balanced.
                let half = count / 2;
                part.select_nth_unstable_by(half, |a, b| {
                    a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
                });
                nodes[place] = leaf(nodes.len(), 0);
                nodes.push(leaf(first, half));
                nodes.push(leaf(first + half, count - half));
            }
            place += 1;
        }
        let faces = faces.into_iter().map(|(_, face)| face).collect();
        let mut hierarchy = Self { nodes, faces };
        hierarchy.refit(mesh, at);
        hierarchy
    }

    /// Puts the same tree around the boundary where it is now.
    pub fn refit(&mut self, mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>) {
        for place in (0..self.nodes.len()).rev() {
            let Node { first, faces, .. } = self.nodes[place];
            let (first, faces) = (first as usize, faces as usize);
            self.nodes[place].bounds = if faces == 0 {
                let children = self.nodes.get(first..first + 2).unwrap_or_default();
                children.iter().fold(Bounds::NONE, |a, b| a.with(&b.bounds))
            } else {
                let faces = &self.faces[first..first + faces];
                let each = faces.iter().map(|face| bounds_of(mesh, &at, *face));
                each.fold(Bounds::NONE, |a, b| a.with(&b))
            };
        }
    }

    /// Calls `visit` for the faces in the leaves whose boxes, and those around them, `meets` takes; says how
    /// many boxes it was asked about.
    pub fn near(
        &self,
        mut meets: impl FnMut(&Bounds) -> bool,
        mut visit: impl FnMut(HalfFace),
    ) -> u32 {
        let mut stack = [0u32; DEPTH + 1];
        let (mut depth, mut asked) = (1, 0);
        while depth > 0 {
            depth -= 1;
            let Some(node) = self.nodes.get(stack[depth] as usize) else {
                continue;
            };
            asked += 1;
            if !meets(&node.bounds) {
                continue;
            }
            let first = node.first as usize;
            if node.faces > 0 {
                let faces = self.faces.get(first..first + node.faces as usize);
                faces
                    .unwrap_or_default()
                    .iter()
                    .copied()
                    .for_each(&mut visit);
            } else if depth + 2 <= stack.len() && !self.faces.is_empty() {
                stack[depth] = node.first + 1;
                stack[depth + 1] = node.first;
                depth += 2;
            }
        }
        asked
    }
}

fn bounds_of(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>, face: HalfFace) -> Bounds {
    mesh.vertices(face).iter().fold(Bounds::NONE, |bounds, v| {
        let at = at(*v);
        bounds.with(&Bounds { low: at, high: at })
    })
}
