//! Nodes that are held by the drive of a step, any of them: their rows of a stiffness become diagonal.
//!
//! Entry points: [`Held::take`], [`Held::leaves_rigid_motion`], [`Held::mask`]. The pattern stays that of all nodes, and so does its
//! analysis: another set of held nodes costs a factorisation and allocates nothing.

use super::pattern::Pattern;
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use sutura_models::BoundaryConditions;

/// So far from a line through others, in units of their distance, a point counts as on it.
const ON_A_LINE: f64 = 1e-9;

/// Which nodes are held.
#[derive(Clone, Debug)]
pub(super) struct Held {
    is_held: Vec<bool>,
    held: usize,
    /// Piece of tissue that each node belongs to, (n), and how many there are.
    piece: Vec<u32>,
    pieces: u32,
    /// Whether a step has said so.
    known: bool,
}

impl Held {
    /// None of the nodes of a mesh.
    pub fn none(mesh: &TetMesh) -> Self {
        let (piece, pieces) = mesh.half_faces().bodies();
        Self {
            is_held: vec![false; mesh.points_m().len()],
            held: 0,
            piece,
            pieces,
            known: false,
        }
    }

    /// Takes the held nodes of a checked drive; whether they are others than before.
    pub fn take(&mut self, drive: &BoundaryConditions<'_>) -> bool {
        if self.are_of(drive) {
            return false;
        }
        self.is_held.fill(false);
        for (node, _) in drive.held {
            self.is_held[*node as usize] = true;
        }
        (self.held, self.known) = (drive.held.len(), true);
        true
    }

    /// Whether these are the held nodes of a checked drive.
    pub fn are_of(&self, drive: &BoundaryConditions<'_>) -> bool {
        self.known
            && self.held == drive.held.len()
            && drive.held.iter().all(|(node, _)| self.is(*node))
    }

    /// Whether a piece of tissue with these nodes at rest, (n x 3), can float or turn: it can unless three of its held nodes are not on a line.
    /// A factorisation does not always say so: round-off can hide a rigid motion, and where tissue is under stress it is none.
    pub fn leaves_rigid_motion(&self, rest_m: &[[f64; 3]], drive: &BoundaryConditions<'_>) -> bool {
        (0..self.pieces).any(|piece| {
            let own = |(node, _): &&(u32, [f64; 3])| self.piece[*node as usize] == piece;
            let mut held = drive.held.iter().filter(own);
            let mut ways = held.next().into_iter().flat_map(|(first, _)| {
                let from = Vector3::from(rest_m[*first as usize]);
                held.clone()
                    .map(move |(node, _)| Vector3::from(rest_m[*node as usize]) - from)
            });
            let longest = ways.clone().max_by(|a, b| a.norm().total_cmp(&b.norm()));
            !longest.is_some_and(|longest| {
                let least = ON_A_LINE * longest.norm_squared();
                ways.any(|way| way.cross(&longest).norm() > least)
            })
        })
    }

    /// The next [`Self::take`] finds others in any case.
    pub fn forget(&mut self) {
        self.known = false;
    }

    /// Whether a node is held.
    pub fn is(&self, node: u32) -> bool {
        self.is_held[node as usize]
    }

    /// Sets held nodes' entries of a vector to zero.
    pub fn clear(&self, vector: &mut [f64]) {
        for (values, held) in vector.chunks_exact_mut(3).zip(&self.is_held) {
            if *held {
                values.fill(0.0);
            }
        }
    }

    /// Cuts held nodes off the lower triangle of a stiffness: their rows and columns are those of the
    /// largest entry times the identity.
    pub fn mask(&self, pattern: &Pattern, stiffness: &mut [f64]) {
        let pivot = largest(stiffness).max(f64::MIN_POSITIVE);
        for column in 0..pattern.unknowns {
            let own = self.is_held[column / 3];
            let range = pattern.column_start[column]..pattern.column_start[column + 1];
            for (&row, value) in pattern.row[range.clone()].iter().zip(&mut stiffness[range]) {
                if own || self.is_held[row / 3] {
                    *value = if row == column { pivot } else { 0.0 };
                }
            }
        }
    }
}

/// What is wrong with a drive for tissue of so many nodes.
pub(super) fn fault_of(drive: &BoundaryConditions<'_>, nodes: usize) -> Option<&'static str> {
    let ascending = drive.held.windows(2).all(|two| two[0].0 < two[1].0);
    let last = drive.held.last().map_or(0, |(node, _)| *node as usize);
    let finite = |vector: &[f64; 3]| vector.iter().all(|x| x.is_finite());
    if !ascending {
        Some("held nodes are not in ascending order")
    } else if last >= nodes {
        Some("a held node is not in the mesh")
    } else if !drive.force_n.is_empty() && drive.force_n.len() != nodes {
        Some("there is not one force for each node")
    } else if !drive.held.iter().all(|(_, target)| finite(target)) {
        Some("a held node's displacement is not finite")
    } else if !drive.force_n.iter().all(finite) {
        Some("a force is not finite")
    } else if drive.held.len() == nodes {
        Some("all nodes are held: nothing can move")
    } else {
        None
    }
}

/// Largest magnitude.
pub(super) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

#[cfg(test)]
mod tests {
    use super::Held;
    use crate::mesh::{TetMesh, slab};
    use sutura_models::BoundaryConditions;

    /// Three nodes that are not on a line keep a piece of tissue, whatever its size and however it is turned; those of one piece do not keep another.
    #[test]
    fn every_piece_is_kept_by_three_nodes_of_its_own() {
        let one = slab([0.02, 0.01, 0.01], [3, 2, 2]).expect("a slab");
        let nodes = one.points_m().len() as u32;
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.7, 1.1);
        for scale in [1e-6, 1.0, 1e3] {
            let turned = one.points_m().iter().map(|at| {
                let at: [f64; 3] = (turn * nalgebra::Vector3::from(*at) * scale).into();
                at
            });
            let points: Vec<_> = turned
                .clone()
                .chain(turned.map(|[x, y, z]| [x + scale, y, z]))
                .collect();
            let cells = one.cells().iter().copied();
            let others = cells.clone().map(|cell| cell.map(|node| node + nodes));
            let mesh = TetMesh::new(points, cells.chain(others).collect()).expect("two slabs");
            let held = Held::none(&mesh);
            let leaves = |held_nodes: &[u32]| {
                let conditions: Vec<_> = held_nodes.iter().map(|node| (*node, [0.0; 3])).collect();
                let drive = BoundaryConditions {
                    held: &conditions,
                    force_n: &[],
                };
                held.leaves_rigid_motion(mesh.points_m(), &drive)
            };
            // The first four nodes are on an edge, the fifth is not.
            assert!(leaves(&[]) && leaves(&[0, 1, 2, 3]) && leaves(&[0, 1, 4]));
            assert!(leaves(&[0, 1, 4, nodes, nodes + 1, nodes + 3]));
            assert!(!leaves(&[0, 1, 4, nodes, nodes + 1, nodes + 4]));
        }
    }
}
