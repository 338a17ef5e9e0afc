//! What points and single cells have to pass; how cells meet is the half-faces' to look at.
//!
//! Entry points: [`check_points`], [`check_cells`], [`check_volumes`], [`check_used`].

use super::{CellId, MeshError, NodeId, signed_volume};
use nalgebra::Vector3;

/// A cell counts as flat below this volume over its longest edge cubed. A regular tetrahedron has
/// 0.118; at 1e-9 the stiffness matrix loses nine of its sixteen digits.
const FLAT: f64 = 1e-9;

const MOST_NODES: usize = 1_000_000_000;

/// The file's own numbers, by index; empty where there was no file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Tags {
    pub nodes: Vec<u64>,
    pub cells: Vec<u64>,
}

impl Tags {
    pub fn node(&self, index: usize) -> NodeId {
        NodeId {
            index,
            tag: self.nodes.get(index).copied(),
        }
    }

    pub fn cell(&self, index: usize) -> CellId {
        CellId {
            index,
            tag: self.cells.get(index).copied(),
        }
    }
}

pub(super) fn check_points(points: &[[f64; 3]], tags: &Tags) -> Result<(), MeshError> {
    if points.len() > MOST_NODES {
        return Err(MeshError::TooManyNodes(points.len()));
    }
    match points
        .iter()
        .position(|at| !at.iter().all(|x| x.is_finite()))
    {
        Some(index) => Err(MeshError::NotFinite {
            node: tags.node(index),
            at: points[index],
        }),
        None => Ok(()),
    }
}

/// Four different nodes each, all of which exist.
pub(super) fn check_cells(nodes: usize, cells: &[[u32; 4]], tags: &Tags) -> Result<(), MeshError> {
    if nodes > MOST_NODES {
        return Err(MeshError::TooManyNodes(nodes));
    }
    if cells.is_empty() {
        return Err(MeshError::NoCells);
    }
    for (index, &cell) in cells.iter().enumerate() {
        check_nodes(index, cell, nodes, tags)?;
    }
    Ok(())
}

/// Neither inverted nor flat; the nodes have to exist.
pub(super) fn check_volumes(
    points: &[[f64; 3]],
    cells: &[[u32; 4]],
    tags: &Tags,
) -> Result<(), MeshError> {
    for (index, &cell) in cells.iter().enumerate() {
        check_volume(index, cell, points, tags)?;
    }
    Ok(())
}

fn check_nodes(index: usize, cell: [u32; 4], nodes: usize, tags: &Tags) -> Result<(), MeshError> {
    for (corner, &node) in cell.iter().enumerate() {
        if node as usize >= nodes {
            return Err(MeshError::NoSuchNode {
                cell: tags.cell(index),
                node: node.into(),
                nodes,
            });
        }
        if cell[..corner].contains(&node) {
            return Err(MeshError::NodeTwice {
                cell: tags.cell(index),
                node: tags.node(node as usize),
            });
        }
    }
    Ok(())
}

fn check_volume(
    index: usize,
    cell: [u32; 4],
    points: &[[f64; 3]],
    tags: &Tags,
) -> Result<(), MeshError> {
    let corners = cell.map(|node| Vector3::from(points[node as usize]));
    let (volume_m3, edge_m) = (signed_volume(&corners), longest_edge(&corners));
    if is_flat(volume_m3, edge_m) {
        return Err(MeshError::Degenerate {
            cell: tags.cell(index),
            volume_m3,
            edge_m,
        });
    }
    if volume_m3 < 0.0 {
        return Err(MeshError::Inverted {
            cell: tags.cell(index),
            volume_m3,
        });
    }
    Ok(())
}

/// Whether a cell has next to no volume for the length of its edges.
pub(super) fn is_flat(volume_m3: f64, longest_edge_m: f64) -> bool {
    // Written so that a volume that overflowed is refused too.
    !(volume_m3.abs() > FLAT * longest_edge_m.powi(3) && volume_m3.is_finite())
}

/// Longest of the six edges \[m\].
pub(super) fn longest_edge(corners: &[Vector3<f64>; 4]) -> f64 {
    let mut edge_m = 0.0f64;
    for a in 0..4 {
        for b in a + 1..4 {
            edge_m = edge_m.max((corners[a] - corners[b]).norm());
        }
    }
    edge_m
}

/// Every node belongs to a cell.
pub(super) fn check_used(nodes: usize, cells: &[[u32; 4]], tags: &Tags) -> Result<(), MeshError> {
    let mut used = vec![false; nodes];
    for &node in cells.iter().flatten() {
        used[node as usize] = true;
    }
    let count = used.iter().filter(|used| !**used).count();
    match used.iter().position(|used| !used) {
        Some(first) => Err(MeshError::Unreferenced {
            node: tags.node(first),
            count,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TetMesh;

    const UNIT: [[f64; 3]; 5] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
    ];

    fn refusal(points: &[[f64; 3]], cells: &[[u32; 4]]) -> MeshError {
        TetMesh::new(points.to_vec(), cells.to_vec()).expect_err("a bad mesh")
    }

    #[test]
    fn a_sound_mesh_passes() {
        assert!(TetMesh::new(UNIT.to_vec(), vec![[0, 1, 2, 3], [1, 2, 3, 4]]).is_ok());
    }

    #[test]
    fn an_inverted_cell_is_named() {
        let error = refusal(&UNIT, &[[0, 1, 2, 3], [2, 1, 3, 4]]);
        assert!(matches!(
            error,
            MeshError::Inverted {
                cell: CellId {
                    index: 1,
                    tag: None
                },
                ..
            }
        ));
        assert!(error.to_string().contains("cell 1 is inverted"), "{error}");
    }

    #[test]
    fn a_flat_cell_is_named() {
        let mut points = UNIT;
        points[3] = [0.3, 0.3, 1e-12];
        let error = refusal(&points[..4], &[[0, 1, 2, 3]]);
        assert!(matches!(
            error,
            MeshError::Degenerate {
                cell: CellId { index: 0, .. },
                ..
            }
        ));
    }

    #[test]
    fn a_repeated_cell_is_named_in_any_order_of_its_nodes() {
        let error = refusal(&UNIT, &[[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 0, 3]]);
        let MeshError::Duplicate { first, second } = error else {
            panic!("{error}")
        };
        assert_eq!((first.index, second.index), (0, 2));
    }

    #[test]
    fn a_third_cell_on_a_face_is_named() {
        let mut points = UNIT.to_vec();
        points.push([2.0, 2.0, 2.0]);
        let error = refusal(&points, &[[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 5]]);
        assert!(
            matches!(
                error,
                MeshError::CrowdedFace {
                    third: CellId { index: 2, .. },
                    ..
                }
            ),
            "{error}"
        );
    }

    #[test]
    fn cells_on_one_side_of_a_face_are_named() {
        let mut points = UNIT;
        points[4] = [-1.0, 0.1, 0.2];
        let error = refusal(&points, &[[0, 1, 2, 3], [4, 1, 2, 3]]);
        let MeshError::SameSide { first, second } = error else {
            panic!("{error}")
        };
        assert_eq!((first.index, second.index), (0, 1));
    }

    #[test]
    fn nodes_are_counted_and_finite() {
        let error = refusal(&UNIT, &[[0, 1, 2, 3]]);
        assert!(matches!(
            error,
            MeshError::Unreferenced {
                node: NodeId { index: 4, .. },
                count: 1
            }
        ));
        let error = refusal(&UNIT, &[[0, 1, 2, 3], [1, 2, 3, 9]]);
        assert!(matches!(
            error,
            MeshError::NoSuchNode {
                node: 9,
                nodes: 5,
                ..
            }
        ));
        let error = refusal(&UNIT, &[[0, 1, 2, 3], [1, 2, 2, 4]]);
        assert!(matches!(error, MeshError::NodeTwice { .. }));
        let mut points = UNIT;
        points[2][1] = f64::NAN;
        assert!(matches!(
            refusal(&points, &[[0, 1, 2, 3], [1, 2, 3, 4]]),
            MeshError::NotFinite {
                node: NodeId { index: 2, .. },
                ..
            }
        ));
        assert_eq!(refusal(&UNIT, &[]), MeshError::NoCells);
    }
}
