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
/// So far below the root the tree falls into groups.
const GROUP_DEPTH: u32 = 5;
/// Most groups of a tree.
pub const MOST_GROUPS: usize = 1 << GROUP_DEPTH;

/// An axis-aligned box \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Its middle.
    pub centre: Vector3<f64>,
    /// Half its edges.
    pub half: Vector3<f64>,
}

/// A segment with a ball around each of its points, to hold against boxes.
#[derive(Clone, Copy, Debug)]
pub struct Capsule {
    middle: Vector3<f64>,
    /// Half the way from one end to the other.
    half: Vector3<f64>,
    /// The same without signs.
    size: Vector3<f64>,
}

impl Capsule {
    /// From `a` to `b`.
    pub fn new(a: &Vector3<f64>, b: &Vector3<f64>) -> Self {
        let half = (b - a) * 0.5;
        Self {
            middle: (a + b) * 0.5,
            half,
            size: half.abs(),
        }
    }

    /// Whether a box grown by `reach` \[m\] has a point of the segment: by the directions that can separate the two
    /// (Gottschalk, Lin, Manocha 1996). Never wrong about one that has but for rounding, which the
    /// reach has to be above; not a number has.
    #[inline]
    pub fn meets(&self, bounds: &Bounds, reach: f64) -> bool {
        let apart = |distance: f64, within: f64| distance.abs() > within;
        let from = self.middle - bounds.centre;
        let (h, size) = (&self.size, bounds.half + Vector3::repeat(reach));
        if (0..3).any(|k| apart(from[k], size[k] + h[k])) {
            return false;
        }
        let across = from.cross(&self.half);
        !(apart(across.x, size.y * h.z + size.z * h.y)
            || apart(across.y, size.x * h.z + size.z * h.x)
            || apart(across.z, size.x * h.y + size.y * h.x))
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    /// Of a leaf its first face, else its first child; the second follows.
    first: u32,
    /// Faces of a leaf; else 0.
    faces: u32,
    /// The group that it belongs to; [`MOST_GROUPS`] above the groups.
    group: u32,
}

/// How far the boundary may have moved since the boxes were made \[m\].
#[derive(Clone, Copy, Debug)]
pub enum Slack<'a> {
    /// Nowhere farther than this.
    Everywhere(f64),
    /// No farther than this in each group of the hierarchy.
    ByGroup(&'a [f64]),
}

impl Slack<'_> {
    /// In a group; without one in all of them.
    pub fn of(&self, group: Option<usize>) -> f64 {
        match (self, group) {
            (Self::Everywhere(slack), _) => *slack,
            (Self::ByGroup(each), Some(group)) => each.get(group).copied().unwrap_or(f64::MAX),
            (Self::ByGroup(each), None) => each.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// A tree of boxes over the boundary faces of a mesh.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// Children after their parents.
    nodes: Vec<Node>,
    faces: Vec<HalfFace>,
    groups: usize,
}

impl Hierarchy {
    /// Around the boundary of `mesh` with its vertices at `at`.
    pub fn new(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>) -> Self {
        let mut faces: Vec<(Vector3<f64>, HalfFace)> = mesh
            .boundary()
            .half_faces()
            .iter()
            .map(|face| (Corners::of_face(mesh, &at, *face).bounds().centre, *face))
            .collect();
        let leaf = |first: usize, faces: usize, group: u32| Node {
            bounds: Corners::NONE.bounds(),
            first: first as u32,
            faces: faces as u32,
            group,
        };
        let above = MOST_GROUPS as u32;
        let mut nodes = vec![leaf(0, faces.len(), above)];
        let mut depths = vec![0];
        let (mut place, mut groups) = (0, 0);
        while let Some(&node) = nodes.get(place) {
            let (first, count) = (node.first as usize, node.faces as usize);
            let mut group = node.group;
            if group == above && (depths[place] == GROUP_DEPTH || count <= LEAF) {
                group = groups;
                groups += 1;
                nodes[place].group = group;
            }
            if count > LEAF {
                let part = &mut faces[first..first + count];
                let around = part.iter().fold(Corners::NONE, |all, (at, _)| all.with(at));
                let axis = (around.high - around.low).imax();
                let half = count / 2;
                part.select_nth_unstable_by(half, |a, b| {
                    a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
                });
                nodes[place] = leaf(nodes.len(), 0, group);
                nodes.push(leaf(first, half, group));
                nodes.push(leaf(first + half, count - half, group));
                depths.extend([depths[place] + 1; 2]);
            }
            place += 1;
        }
        let faces = faces.into_iter().map(|(_, face)| face).collect();
        let mut hierarchy = Self {
            nodes,
            faces,
            groups: groups as usize,
        };
        hierarchy.refit(mesh, at);
        hierarchy
    }

    /// Puts the same tree around the boundary where it is now.
    pub fn refit(&mut self, mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>) {
        for place in (0..self.nodes.len()).rev() {
            let Node { first, faces, .. } = self.nodes[place];
            let (first, faces) = (first as usize, faces as usize);
            let corners = if faces == 0 {
                let children = self.nodes.get(first..first + 2).unwrap_or_default();
                let ends = children.iter().flat_map(|child| {
                    let Bounds { centre, half } = child.bounds;
                    [centre - half, centre + half]
                });
                ends.fold(Corners::NONE, |all, at| all.with(&at))
            } else {
                let faces = self.faces[first..first + faces].iter();
                let nodes = faces.flat_map(|face| mesh.vertices(*face));
                nodes.fold(Corners::NONE, |all, node| all.with(&at(node)))
            };
            self.nodes[place].bounds = corners.bounds();
        }
    }

    /// How many groups the faces fall into, at most [`MOST_GROUPS`].
    pub fn groups(&self) -> usize {
        self.groups
    }

    /// Faces with the group of each.
    pub fn grouped_faces(&self) -> impl Iterator<Item = (usize, HalfFace)> + '_ {
        let leaves = self.nodes.iter().filter(|node| node.faces > 0);
        leaves.flat_map(|leaf| {
            let first = leaf.first as usize;
            let faces = self.faces[first..first + leaf.faces as usize].iter();
            faces.map(|face| (leaf.group as usize, *face))
        })
    }

    /// Calls `visit` for the faces in the leaves whose boxes, and those around them, `meets` takes; says how
    /// many boxes it was asked about.
    pub fn near(
        &self,
        mut meets: impl FnMut(&Bounds, Option<usize>) -> bool,
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
            let group = Some(node.group as usize).filter(|group| *group < MOST_GROUPS);
            if !meets(&node.bounds, group) {
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

/// Least and greatest coordinates.
struct Corners {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

impl Corners {
    /// Of nothing.
    const NONE: Self = Self {
        low: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        high: Vector3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    fn with(&self, at: &Vector3<f64>) -> Self {
        Self {
            low: self.low.inf(at),
            high: self.high.sup(at),
        }
    }

    fn of_face(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>, face: HalfFace) -> Self {
        let nodes = mesh.vertices(face).into_iter();
        nodes.fold(Self::NONE, |all, node| all.with(&at(node)))
    }

    fn bounds(&self) -> Bounds {
        Bounds {
            centre: (self.low + self.high) * 0.5,
            half: (self.high - self.low) * 0.5,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::slab;

    /// Numbers between -1 and 1 that are not regular.
    fn spread(k: usize) -> f64 {
        let k = k as f64;
        2.0 * (1e4 * (12.9898 * k + 78.233).sin()).fract().abs() - 1.0
    }

    /// Distance of a triangle from a segment, from points on both.
    fn distance(corners: &[Vector3<f64>; 3], a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let parts = || (0..=8).map(|k| f64::from(k) / 8.0);
        let on_segment = || parts().map(|s| a + (b - a) * s);
        let on_face = parts().flat_map(|s| parts().map(move |t| (s * (1.0 - t), s * t)));
        let [p, q, r] = corners;
        on_face
            .map(|(s, t)| p + (q - p) * s + (r - p) * t)
            .flat_map(|at| on_segment().map(move |on| (on - at).norm()))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn nothing_near_a_segment_is_missed_and_little_else_is_looked_at() {
        let mesh = slab([4.0, 3.0, 2.0], [8, 6, 4]).expect("a slab");
        let rest = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
        let moved = |node: u32| {
            let at = rest(node);
            at + Vector3::new(0.3 * at.y.sin(), 0.2 * at.z, 0.1 * (2.0 * at.x).cos())
        };
        let mesh = mesh.half_faces();
        let all = mesh.boundary().half_faces();
        let mut hierarchy = Hierarchy::new(mesh, rest);
        hierarchy.refit(mesh, moved);
        let (mut asked, mut visited) = (0, 0);
        for k in 0..200 {
            let point =
                |k: usize| Vector3::from_fn(|axis, _| 2.5 * spread(7 * k + axis)) - Vector3::z();
            let (a, b) = (point(2 * k), point(2 * k + 1));
            let (b, reach) = (a + (b - a) * 0.2, 0.2 * spread(k).abs());
            let capsule = Capsule::new(&a, &b);
            let mut near = Vec::new();
            asked += hierarchy.near(
                |bounds, _| capsule.meets(bounds, reach),
                |face| near.push(face),
            );
            visited += near.len();
            near.sort_unstable();
            assert!(near.windows(2).all(|pair| pair[0] < pair[1]));
            for face in all {
                let corners = mesh.vertices(*face).map(moved);
                let close = distance(&corners, &a, &b) <= reach;
                assert!(
                    !close || near.binary_search(face).is_ok(),
                    "{face:?} of {k}"
                );
            }
        }
        assert!(visited < 200 * all.len() / 20, "{visited} of {}", all.len());
        assert!(asked < 200 * 40, "{asked}");
    }
}
