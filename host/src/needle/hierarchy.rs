//! The boundary's faces by where they are, so that what touches a surface is found without looking at all of it.
//!
//! Entry point: [`Hierarchy::near`]. A query takes boxes grown by how far the tissue has moved since they were made.

use crate::boxes::{Bounds, Tree};
use crate::mesh::{HalfFace, HalfFaces};
use nalgebra::Vector3;

/// So far below the root the tree falls into groups.
const GROUP_DEPTH: u32 = 5;
/// Most groups of a tree.
pub const MOST_GROUPS: usize = 1 << GROUP_DEPTH;

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
        let Bounds { low, high } = bounds;
        let from = self.middle - (low + high) * 0.5;
        let (h, size) = (&self.size, (high - low) * 0.5 + Vector3::repeat(reach));
        if (0..3).any(|k| apart(from[k], size[k] + h[k])) {
            return false;
        }
        let across = from.cross(&self.half);
        !(apart(across.x, size.y * h.z + size.z * h.y)
            || apart(across.y, size.x * h.z + size.z * h.x)
            || apart(across.z, size.x * h.y + size.y * h.x))
    }
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
    tree: Tree,
    /// As the tree counts them.
    faces: Vec<HalfFace>,
    /// Of each node of the tree.
    group: Vec<Option<u32>>,
    /// Nodes of each group's faces, ascending.
    nodes: Vec<Vec<u32>>,
}

impl Hierarchy {
    /// Around the boundary of `mesh` with its vertices at `at`.
    pub fn new(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>) -> Self {
        let faces = mesh.boundary().half_faces().to_vec();
        let tree = Tree::new(faces.len() as u32, |face| {
            around(mesh, &at, faces[face as usize])
        });
        let (group, groups) = tree.groups(GROUP_DEPTH);
        let nodes_of = |group: Vec<u32>| {
            let of_face = |face: u32| mesh.vertices(faces[face as usize]);
            let mut nodes: Vec<u32> = group.into_iter().flat_map(of_face).collect();
            nodes.sort_unstable();
            nodes.dedup();
            nodes
        };
        Self {
            nodes: groups.into_iter().map(nodes_of).collect(),
            tree,
            faces,
            group,
        }
    }

    /// Nodes of each group of faces, ascending; at most [`MOST_GROUPS`]. Faces of several may share a node.
    pub fn groups(&self) -> &[Vec<u32>] {
        &self.nodes
    }

    /// Calls `visit` for the faces whose boxes, and those around them, `meets` takes; says how many boxes it was asked about.
    pub fn near(
        &self,
        mut meets: impl FnMut(&Bounds, Option<usize>) -> bool,
        mut visit: impl FnMut(HalfFace),
    ) -> u32 {
        let mut asked = 0;
        let wanted = |node: u32, bounds: &Bounds| {
            asked += 1;
            meets(
                bounds,
                self.group[node as usize].map(|group| group as usize),
            )
        };
        self.tree
            .where_near(wanted, |face| visit(self.faces[face as usize]));
        asked
    }

    /// Whether a face may be as near to a point \[m\], as far as boxes tell.
    pub fn comes_within(&self, at: &Vector3<f64>, reach_m: f64, slack: Slack) -> bool {
        let mut any = false;
        let within = |bounds: &Bounds, group: Option<usize>| {
            let within_m = reach_m + slack.of(group);
            bounds.distance_squared(at) <= within_m * within_m
        };
        self.near(within, |_| any = true);
        any
    }
}

/// The box around a face.
fn around(mesh: &HalfFaces, at: impl Fn(u32) -> Vector3<f64>, face: HalfFace) -> Bounds {
    let nodes = mesh.vertices(face).into_iter();
    nodes.fold(Bounds::NOTHING, |all, node| all.with(&at(node)))
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
        let hierarchy = Hierarchy::new(mesh, moved);
        // Every face is in a group with all of its nodes.
        let groups = hierarchy.groups();
        let has = |group: &Vec<u32>, node| group.binary_search(&node).is_ok();
        let in_one = |face: &HalfFace| {
            let nodes = mesh.vertices(*face);
            (groups.iter()).any(|group| nodes.into_iter().all(|node| has(group, node)))
        };
        assert!(groups.len() == MOST_GROUPS && all.iter().all(in_one));
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
            let mut all_near = all.iter().map(|face| mesh.vertices(*face).map(moved));
            let near_a = all_near.any(|corners| distance(&corners, &a, &a) <= reach);
            let slack = Slack::Everywhere(0.25 * reach);
            assert!(!near_a || hierarchy.comes_within(&a, 0.75 * reach, slack));
            assert!(!hierarchy.comes_within(&(a + Vector3::x() * 20.0), reach, slack));
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
