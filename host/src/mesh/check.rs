//! Every check that a mesh has to pass, in the order in which one failure would hide the next.
//!
//! Entry point: [`check`]; linear in the size of the mesh.

use super::{CellId, MeshError, NodeId, signed_volume};
use nalgebra::Vector3;
use std::collections::HashMap;

/// A cell counts as flat below this volume over its longest edge cubed. A regular tetrahedron has
/// 0.118; at 1e-9 the stiffness matrix loses nine of its sixteen digits.
const FLAT: f64 = 1e-9;

/// The file's own numbers, by index; empty where there was no file.
#[derive(Default)]
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

/// Nodes of the face opposite each corner, oriented outwards for a positive cell.
pub(super) const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// A face without its orientation, as a key.
pub(super) fn face_key(cell: [u32; 4], face: [usize; 3]) -> [u32; 3] {
    let mut key = face.map(|corner| cell[corner]);
    key.sort_unstable();
    key
}

pub(super) fn check(points: &[[f64; 3]], cells: &[[u32; 4]], tags: &Tags) -> Result<(), MeshError> {
    if points.len() > 1_000_000_000 {
        return Err(MeshError::TooManyNodes(points.len()));
    }
    for (index, at) in points.iter().enumerate() {
        if !at.iter().all(|x| x.is_finite()) {
            return Err(MeshError::NotFinite {
                node: tags.node(index),
                at: *at,
            });
        }
    }
    if cells.is_empty() {
        return Err(MeshError::NoCells);
    }
    for (index, &cell) in cells.iter().enumerate() {
        check_nodes(index, cell, points.len(), tags)?;
        check_volume(index, cell, points, tags)?;
    }
    check_neighbours(cells, tags)?;
    check_used(points.len(), cells, tags)
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
    let volume_m3 = signed_volume(&corners);
    let mut edge_m = 0.0f64;
    for a in 0..4 {
        for b in a + 1..4 {
            edge_m = edge_m.max((corners[a] - corners[b]).norm());
        }
    }
    let flat = FLAT * edge_m.powi(3);
    // Written so that a volume that overflowed is refused too.
    if !(volume_m3.abs() > flat && volume_m3.is_finite()) {
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

fn check_neighbours(cells: &[[u32; 4]], tags: &Tags) -> Result<(), MeshError> {
    let mut seen = HashMap::with_capacity(cells.len());
    for (index, &cell) in cells.iter().enumerate() {
        let mut key = cell;
        key.sort_unstable();
        if let Some(first) = seen.insert(key, index) {
            return Err(MeshError::Duplicate {
                first: tags.cell(first),
                second: tags.cell(index),
            });
        }
    }
    let mut faces: HashMap<[u32; 3], [Option<usize>; 2]> = HashMap::with_capacity(2 * cells.len());
    for (index, &cell) in cells.iter().enumerate() {
        for face in FACES {
            match faces.entry(face_key(cell, face)).or_default() {
                [first @ None, _] => *first = Some(index),
                [_, second @ None] => *second = Some(index),
                [Some(first), Some(second)] => {
                    return Err(MeshError::CrowdedFace {
                        first: tags.cell(*first),
                        second: tags.cell(*second),
                        third: tags.cell(index),
                    });
                }
            }
        }
    }
    Ok(())
}

fn check_used(nodes: usize, cells: &[[u32; 4]], tags: &Tags) -> Result<(), MeshError> {
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
    use crate::mesh::TetMesh;

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
