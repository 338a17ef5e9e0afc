//! A boundary that moves: which vertices, edges and faces of two of them, or of one, may meet in a step.
//!
//! Entry points: [`Body::new`], [`Body::sweep`], then [`Body::against`] or [`Body::with_itself`]. Every vertex and
//! every edge belongs to one of its faces, so that a pair of features comes up for one pair of faces only.

use super::pairs::{Path, edge_edge, vertex_face};
use super::sweep::{Margin, Sweep};
use crate::boxes::{Bounds, Tree};
use serde::Serialize;
use std::collections::HashSet;

/// Two features that may meet in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Pair {
    /// A vertex of the first boundary and a face of the second, by their nodes.
    VertexFace(u32, [u32; 3]),
    /// A face of the first boundary and a vertex of the second.
    FaceVertex([u32; 3], u32),
    /// An edge of either, lower node first.
    EdgeEdge([u32; 2], [u32; 2]),
}

impl Pair {
    /// Nodes in the order of an impact's weights.
    pub fn nodes(&self) -> [u32; 4] {
        match *self {
            Self::VertexFace(vertex, [a, b, c]) | Self::FaceVertex([a, b, c], vertex) => {
                [vertex, a, b, c]
            }
            Self::EdgeEdge([a, b], [c, d]) => [a, b, c, d],
        }
    }

    /// Whether they meet, and when first.
    pub fn sweep(&self, path: impl Fn(u32) -> Path, margin: &Margin) -> Sweep {
        let [a, b, c, d] = &self.nodes().map(path);
        match self {
            Self::EdgeEdge(..) => edge_edge([a, b], [c, d], margin),
            _ => vertex_face(a, [b, c, d], margin),
        }
    }
}

/// A face and what belongs to it.
#[derive(Clone, Copy, Debug)]
struct Face {
    nodes: [u32; 3],
    /// Which of its vertices are its own.
    own_vertices: [bool; 3],
    /// Which of its edges, from each vertex to the next.
    own_edges: [bool; 3],
}

/// The boundary of a tissue, with boxes around how its faces move.
#[derive(Clone, Debug)]
pub struct Body {
    faces: Vec<Face>,
    tree: Tree,
    /// By how much boxes are larger \[m\].
    grown_m: f64,
}

impl Body {
    /// Of `faces` by their nodes, at most 2^32 - 1; `path` says how nodes move.
    pub fn new(faces: &[[u32; 3]], path: impl Fn(u32) -> Path, margin: &Margin) -> Self {
        let (mut vertices, mut edges) = (HashSet::new(), HashSet::new());
        let faces: Vec<Face> = faces
            .iter()
            .map(|&nodes| Face {
                nodes,
                own_vertices: nodes.map(|node| vertices.insert(node)),
                own_edges: edges_of(nodes).map(|edge| edges.insert(edge)),
            })
            .collect();
        let grown_m = grown_m(margin);
        let tree = Tree::new(faces.len() as u32, |face| {
            around(&faces[face as usize].nodes, &path).grown(grown_m)
        });
        Self {
            faces,
            tree,
            grown_m,
        }
    }

    /// A new step: boxes around how nodes move now, with room for what the margin takes for touching.
    /// Allocates nothing.
    pub fn sweep(&mut self, path: impl Fn(u32) -> Path, margin: &Margin) {
        let Self {
            faces,
            tree,
            grown_m: grown,
        } = self;
        *grown = grown_m(margin);
        tree.refit(|face| around(&faces[face as usize].nodes, &path).grown(*grown));
    }

    /// Visits every pair of features, of this boundary and `other`, that may meet while nodes move as they
    /// did when both were swept, each once. Allocates nothing.
    pub fn against(&self, other: &Self, path: impl Fn(u32) -> Path, mut visit: impl FnMut(Pair)) {
        self.tree.pairs(&other.tree, |a, b| {
            let (a, b) = (&self.faces[a as usize], &other.faces[b as usize]);
            features(a, b, &path, self.grown_m + other.grown_m, &mut visit);
        });
    }

    /// No feature of this boundary comes nearer than this to one of `other`, the room for a margin not counted
    /// \[m\]; 0 if they may touch. Allocates nothing.
    pub fn apart_m(&self, other: &Self) -> f64 {
        self.tree.apart(&other.tree)
    }

    /// As [`Self::against`], for a boundary that may fold onto itself: without features that share a node,
    /// which always touch.
    pub fn with_itself(&self, path: impl Fn(u32) -> Path, mut visit: impl FnMut(Pair)) {
        let mut apart = |pair: Pair| {
            let [a, b, c, d] = pair.nodes();
            let shares = match pair {
                Pair::EdgeEdge(..) => [a, b].iter().any(|node| [c, d].contains(node)),
                _ => [b, c, d].contains(&a),
            };
            if !shares {
                visit(pair);
            }
        };
        self.tree.own_pairs(|a, b| {
            let (a, b) = (&self.faces[a as usize], &self.faces[b as usize]);
            features(a, b, &path, 2.0 * self.grown_m, &mut apart);
        });
    }
}

/// Half of the distance within which things may be said to meet, for either of them, and more than rounding.
fn grown_m(margin: &Margin) -> f64 {
    0.5 * (margin.separation_m + margin.tolerance_m)
}

fn around(nodes: &[u32], path: &impl Fn(u32) -> Path) -> Bounds {
    nodes.iter().fold(Bounds::NOTHING, |all, &node| {
        let Path { from, to } = path(node);
        all.with(&from).with(&to)
    })
}

fn edges_of([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)])
}

/// The pairs of features of two faces that belong to them and whose boxes are within `grown_m`.
fn features(
    a: &Face,
    b: &Face,
    path: &impl Fn(u32) -> Path,
    grown_m: f64,
    visit: &mut impl FnMut(Pair),
) {
    let [whole_a, whole_b] = [a, b].map(|face| around(&face.nodes, path).grown(grown_m));
    for (&node, _) in a.nodes.iter().zip(a.own_vertices).filter(|(_, own)| *own) {
        if around(&[node], path).meets(&whole_b) {
            visit(Pair::VertexFace(node, b.nodes));
        }
    }
    for (&node, _) in b.nodes.iter().zip(b.own_vertices).filter(|(_, own)| *own) {
        if around(&[node], path).meets(&whole_a) {
            visit(Pair::FaceVertex(a.nodes, node));
        }
    }
    for (one, own) in edges_of(a.nodes).into_iter().zip(a.own_edges) {
        if !own {
            continue;
        }
        let bounds = around(&one, path).grown(grown_m);
        if !bounds.meets(&whole_b) {
            continue;
        }
        for (other, own) in edges_of(b.nodes).into_iter().zip(b.own_edges) {
            if own && around(&other, path).meets(&bounds) {
                visit(Pair::EdgeEdge(one, other));
            }
        }
    }
}
