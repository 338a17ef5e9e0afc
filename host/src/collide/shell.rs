//! What lies beside what on a boundary, and normals where its nodes are.
//!
//! Entry points: [`Shell::new`], [`Shell::across`], [`Shell::edge_normal`].

use nalgebra::Vector3;
use std::collections::HashMap;

/// The faces of one body and their neighbours.
#[derive(Clone, Debug)]
pub(super) struct Shell {
    faces: Vec<[u32; 3]>,
    /// The faces at each edge, lower node first; twice the same at the rim of a boundary that is open.
    beside: HashMap<[u32; 2], [u32; 2]>,
    /// The faces at each node.
    around: HashMap<u32, Vec<u32>>,
}

/// An edge by its nodes, the lower one first.
pub(super) fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// A face's normal, as long as its area is twice \[m^2\].
fn normal(face: &[u32; 3], at: impl Fn(u32) -> Vector3<f64>) -> Vector3<f64> {
    let [a, b, c] = face.map(at);
    (b - a).cross(&(c - a))
}

impl Shell {
    pub fn new(faces: &[[u32; 3]]) -> Self {
        let mut beside = HashMap::with_capacity(2 * faces.len());
        let mut around: HashMap<u32, Vec<u32>> = HashMap::with_capacity(faces.len());
        for (index, &[a, b, c]) in (0u32..).zip(faces) {
            for node in [a, b, c] {
                around.entry(node).or_default().push(index);
            }
            for edge in [edge(a, b), edge(b, c), edge(c, a)] {
                beside
                    .entry(edge)
                    .and_modify(|faces: &mut [u32; 2]| faces[1] = index)
                    .or_insert([index; 2]);
            }
        }
        Self {
            faces: faces.to_vec(),
            beside,
            around,
        }
    }

    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The face across the side of `face` that lies opposite to one of its corners.
    pub fn across(&self, face: &[u32; 3], corner: usize) -> Option<[u32; 3]> {
        let side = edge(face[(corner + 1) % 3], face[(corner + 2) % 3]);
        let faces = self.beside.get(&side)?;
        let [one, other] = faces.map(|face| self.faces[face as usize]);
        let next = if one == *face { other } else { one };
        (next != *face).then_some(next)
    }

    /// Mean of the unit normals of the two faces at an edge; zero if there are none.
    pub fn edge_normal(&self, edge: &[u32; 2], at: impl Fn(u32) -> Vector3<f64>) -> Vector3<f64> {
        let faces = self.beside.get(edge);
        self.mean_normal(faces.map_or(&[], |faces| faces), at)
    }

    /// Mean of the unit normals of the faces at a node; zero if there are none.
    pub fn node_normal(&self, node: u32, at: impl Fn(u32) -> Vector3<f64>) -> Vector3<f64> {
        let faces = self.around.get(&node);
        self.mean_normal(faces.map_or(&[], Vec::as_slice), at)
    }

    fn mean_normal(&self, faces: &[u32], at: impl Fn(u32) -> Vector3<f64>) -> Vector3<f64> {
        let units = faces.iter().map(|face| {
            let normal = normal(&self.faces[*face as usize], &at);
            normal.try_normalize(0.0).unwrap_or_default()
        });
        units.sum::<Vector3<f64>>() / faces.len().max(1) as f64
    }

    /// Every node, ascending.
    pub fn nodes(&self) -> Vec<u32> {
        let mut nodes: Vec<u32> = self.faces.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes
    }

    /// Every edge's nodes, in no order that matters.
    pub fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.faces
            .iter()
            .enumerate()
            .flat_map(move |(index, &[a, b, c])| {
                let own = move |edge: &[u32; 2]| {
                    self.beside
                        .get(edge)
                        .is_some_and(|faces| faces[0] as usize == index)
                };
                [edge(a, b), edge(b, c), edge(c, a)].into_iter().filter(own)
            })
    }
}
