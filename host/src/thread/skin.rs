//! The surface of all tissue of a scene: its faces, their neighbours, and boxes around where they are.
//!
//! Entry points: [`Skin::new`], [`Skin::refit`], [`Skin::along`], [`Skin::near`], [`Skin::across`].

use crate::boxes::{Bounds, Tree};
use nalgebra::Vector3;
use std::collections::HashMap;

/// Boxes are larger than their faces by this part of the mean edge, so that a flat one has some thickness.
const GROWN: f64 = 1e-6;

/// All boundary faces, which the tissue takes along.
#[derive(Clone, Debug)]
pub(crate) struct Skin {
    /// Nodes of each face, counter-clockwise seen from outside, (f x 3).
    faces: Vec<[u32; 3]>,
    /// For the side of each face from a corner to the next the same in the face beyond, (f x 3).
    across: Vec<[Side; 3]>,
    tree: Tree,
    /// By how much boxes are larger \[m\].
    grown_m: f64,
    mean_edge_m: f64,
}

/// A side of a face: from its corner `corner` to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Side {
    /// Which face.
    pub face: u32,
    /// The corner that it starts from.
    pub corner: u32,
}

/// Beyond a rim.
const NOWHERE: Side = Side {
    face: u32::MAX,
    corner: 0,
};

impl Skin {
    /// Of `faces` by their nodes, counter-clockwise seen from outside, with nodes at `at` \[m\].
    pub fn new(faces: &[[u32; 3]], at: &[Vector3<f64>]) -> Self {
        let mut open: HashMap<[u32; 2], Vec<Side>> = HashMap::new();
        let mut across = vec![[NOWHERE; 3]; faces.len()];
        let mut edges_m = 0.0;
        for (face, nodes) in faces.iter().enumerate() {
            for corner in 0..3 {
                let (a, b) = (nodes[corner], nodes[(corner + 1) % 3]);
                edges_m += place(at, a).metric_distance(&place(at, b));
                let here = Side {
                    face: face as u32,
                    corner: corner as u32,
                };
                // A neighbour runs along the side the other way.
                match open.get_mut(&[b, a]).and_then(Vec::pop) {
                    Some(there) => {
                        across[face][corner] = there;
                        across[there.face as usize][there.corner as usize] = here;
                    }
                    None => open.entry([a, b]).or_default().push(here),
                }
            }
        }
        let mean_edge_m = edges_m / (3 * faces.len()).max(1) as f64;
        let grown_m = GROWN * mean_edge_m;
        let tree = Tree::new(faces.len() as u32, |face| {
            around(&faces[face as usize], at).grown(grown_m)
        });
        Self {
            faces: faces.to_vec(),
            across,
            tree,
            grown_m,
            mean_edge_m,
        }
    }

    /// Follows its nodes to `at` \[m\]. Allocates nothing.
    pub fn refit(&mut self, at: &[Vector3<f64>]) {
        let Self {
            faces,
            tree,
            grown_m,
            ..
        } = self;
        tree.refit(|face| around(&faces[face as usize], at).grown(*grown_m));
    }

    /// Nodes of a face, counter-clockwise seen from outside.
    pub fn face(&self, face: u32) -> [u32; 3] {
        self.faces[face as usize]
    }

    /// The same side in the face beyond it; `None` at a rim.
    pub fn across(&self, side: Side) -> Option<Side> {
        let beyond = self.across[side.face as usize][side.corner as usize];
        (beyond != NOWHERE).then_some(beyond)
    }

    /// Visits all faces that a straight line may cut. Allocates nothing.
    pub fn along(&self, from: &Vector3<f64>, to: &Vector3<f64>, visit: impl FnMut(u32)) {
        self.tree.along(from, to, visit);
    }

    /// Visits all faces that may have a point in `bounds`. Allocates nothing.
    pub fn near(&self, bounds: &Bounds, visit: impl FnMut(u32)) {
        self.tree.near(bounds, visit);
    }

    /// How deep in tissue the way out is still looked for \[m\]: half a mean edge.
    pub fn reach_m(&self) -> f64 {
        0.5 * self.mean_edge_m
    }

    /// Whether a straight line cuts a face, with nodes at `at` \[m\]. Allocates nothing.
    pub fn is_cut(&self, at: &[Vector3<f64>], from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let (way, mut cut) = (to - from, false);
        self.tree.along(from, to, |face| {
            let [a, b, c] = self.face(face).map(|node| place(at, node) - from);
            // Signed volumes of what the line and each side span (Segura & Feito 2001), and of the ends.
            let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| way.dot(&p.cross(&q)));
            let through = sides.iter().all(|x| *x >= 0.0) || sides.iter().all(|x| *x <= 0.0);
            let normal = (b - a).cross(&(c - a));
            let (before, whole) = (normal.dot(&a), normal.dot(&way));
            cut |= through && whole != 0.0 && (0.0..=1.0).contains(&(before / whole));
        });
        cut
    }

    /// Whether what moves from one point to another may come into the tissue.
    pub fn may_meet(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let mut met = false;
        self.tree.along(from, to, |_| met = true);
        met
    }
}

/// Where a node is; one that is not there is no number, and meets everything.
fn place(at: &[Vector3<f64>], node: u32) -> Vector3<f64> {
    at.get(node as usize)
        .copied()
        .unwrap_or_else(|| Vector3::repeat(f64::NAN))
}

fn around(nodes: &[u32; 3], at: &[Vector3<f64>]) -> Bounds {
    nodes
        .iter()
        .fold(Bounds::NOTHING, |all, &node| all.with(&place(at, node)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tube;

    #[test]
    fn every_side_of_a_closed_surface_has_one_beyond_which_runs_the_other_way() {
        let mesh = tube([1.0, 2.0], [0.0, 1.0], [1, 7, 2]).expect("a tube");
        let at: Vec<_> = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
        let faces = mesh.surface().triangles;
        let skin = Skin::new(&faces, &at);
        let ends = |side: Side| {
            let nodes = skin.face(side.face);
            let corner = side.corner as usize;
            (nodes[corner], nodes[(corner + 1) % 3])
        };
        for face in 0..faces.len() as u32 {
            for corner in 0..3 {
                let side = Side { face, corner };
                let beyond = skin.across(side).expect("closed");
                let (a, b) = ends(side);
                assert_eq!(ends(beyond), (b, a));
                assert_eq!(skin.across(beyond), Some(side));
            }
        }
        // Without a face it has a rim of three sides.
        let skin = Skin::new(&faces[1..], &at);
        let sides = (0..faces.len() as u32 - 1)
            .flat_map(|face| (0..3).map(move |corner| Side { face, corner }));
        assert_eq!(sides.filter(|side| skin.across(*side).is_none()).count(), 3);
    }
}
