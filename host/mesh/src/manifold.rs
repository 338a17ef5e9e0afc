//! Which half-faces lie on each other, and whether cells meet only as those of a manifold do.
//!
//! Entry points: [`match_faces`], [`check_edges`], [`check_nodes`]. A face may have two cells, one on
//! each side; an edge one fan of cells; a node a ball or half a ball of them (Younes 2021, 2.1.1).

use super::check::Tags;
use super::half_face::{CORNERS, HalfFace};
use super::half_faces::HalfFaces;
use super::{MeshError, NodeId};

/// A half-face, after the two larger nodes of its triangle.
pub(super) type OnFace = ([u32; 2], HalfFace);

/// Calls `visit` once for each triangle of the mesh with all the half-faces on it, ascending.
///
/// Linear in the size of the mesh: triangles are sorted only among those with the same least node.
pub(super) fn for_each_face<E>(
    nodes: usize,
    cells: &[[u32; 4]],
    mut visit: impl FnMut(&[OnFace]) -> Result<(), E>,
) -> Result<(), E> {
    let keys = || {
        cells.iter().enumerate().flat_map(|(index, cell)| {
            (0..4).map(move |corner| {
                let mut key = CORNERS[corner].map(|c| cell[c]);
                key.sort_unstable();
                (key, HalfFace::of(index, corner))
            })
        })
    };
    let mut end = vec![0usize; nodes + 1];
    for (key, _) in keys() {
        end[key[0] as usize + 1] += 1;
    }
    for node in 0..nodes {
        end[node + 1] += end[node];
    }
    let start = end.clone();
    let mut faces = vec![([0; 2], HalfFace::of(0, 0)); 4 * cells.len()];
    for ([least, middle, most], face) in keys() {
        let place = &mut end[least as usize];
        faces[*place] = ([middle, most], face);
        *place += 1;
    }
    for node in 0..nodes {
        let bucket = &mut faces[start[node]..start[node + 1]];
        bucket.sort_unstable();
        for group in bucket.chunk_by(|a, b| a.0 == b.0) {
            visit(group)?;
        }
    }
    Ok(())
}

/// The half-face on the other side of each, `None` on the boundary, (4 m).
pub(super) fn match_faces(
    nodes: usize,
    cells: &[[u32; 4]],
    tags: &Tags,
) -> Result<Vec<Option<HalfFace>>, MeshError> {
    let mut opposite = vec![None; 4 * cells.len()];
    let apex = |face: HalfFace| cells[face.cell() as usize][face.corner()];
    let cell = |face: HalfFace| tags.cell(face.cell() as usize);
    for_each_face(nodes, cells, |group| {
        for (place, &(_, first)) in group.iter().enumerate() {
            for &(_, second) in &group[place + 1..] {
                if apex(first) == apex(second) {
                    return Err(MeshError::Duplicate {
                        first: cell(first),
                        second: cell(second),
                    });
                }
            }
        }
        match *group {
            [(_, first), (_, second)] if turns_up(cells, first) == turns_up(cells, second) => {
                Err(MeshError::SameSide {
                    first: cell(first),
                    second: cell(second),
                })
            }
            [(_, first), (_, second)] => {
                opposite[first.index()] = Some(second);
                opposite[second.index()] = Some(first);
                Ok(())
            }
            [(_, first), (_, second), (_, third), ..] => Err(MeshError::CrowdedFace {
                first: cell(first),
                second: cell(second),
                third: cell(third),
            }),
            _ => Ok(()),
        }
    })?;
    Ok(opposite)
}

/// Whether a half-face runs through its nodes in ascending order.
fn turns_up(cells: &[[u32; 4]], face: HalfFace) -> bool {
    let [a, b, c] = CORNERS[face.corner()].map(|corner| cells[face.cell() as usize][corner]);
    // One of the three rotations begins with the least node.
    if a < b && a < c {
        b < c
    } else if b < c {
        c < a
    } else {
        a < b
    }
}

/// Every edge has one fan of cells: sweeping it from one of them reaches all.
pub(super) fn check_edges(mesh: &HalfFaces, tags: &Tags) -> Result<(), MeshError> {
    /// A bit for each pair of corners.
    fn bit([a, b]: [usize; 2]) -> u8 {
        let pair = [[0, 0, 1, 2], [0, 0, 3, 4], [1, 3, 0, 5], [2, 4, 5, 0]][a][b];
        1 << pair
    }
    let mut swept = vec![0u8; mesh.cells().len()];
    for edge in mesh.edges() {
        for half_edge in mesh.around_edge(edge) {
            swept[half_edge.cell() as usize] |= bit(half_edge.corners());
        }
    }
    for (index, (&cell, swept)) in mesh.cells().iter().zip(&swept).enumerate() {
        for corners in [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]] {
            if swept & bit(corners) == 0 {
                let ends = corners.map(|corner| cell[corner]);
                let (from, to) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
                let first = mesh.edge(from, to).map_or(index, |e| e.cell() as usize);
                return Err(MeshError::SplitEdge {
                    from: node(tags, from),
                    to: node(tags, to),
                    first: tags.cell(first),
                    second: tags.cell(index),
                });
            }
        }
    }
    Ok(())
}

/// Around every node the cells hang together by faces, and what they show from the node is a whole
/// sphere inside and a disk on the boundary: vertices - edges + triangles of the link is 2 or 1.
pub(super) fn check_nodes(mesh: &HalfFaces, tags: &Tags) -> Result<(), MeshError> {
    let mut edges_at = vec![0i64; mesh.nodes()];
    for edge in mesh.edges() {
        for end in mesh.edge_vertices(edge) {
            edges_at[end as usize] += 1;
        }
    }
    // The last node for which a cell has been reached, counted from 1.
    let mut reached = vec![0usize; mesh.cells().len()];
    let mut stack = Vec::new();
    for (at, &edges) in edges_at.iter().enumerate() {
        let link = mesh.link_of_vertex(at as u32);
        let Some(&first) = link.first() else { continue };
        let mut boundary_faces = 0;
        reached[first.cell() as usize] = at + 1;
        stack.push(first);
        while let Some(face) = stack.pop() {
            for side in [face.next(), face.middle(), face.previous()] {
                let Some(beyond) = mesh.opposite(side) else {
                    boundary_faces += 1;
                    continue;
                };
                if std::mem::replace(&mut reached[beyond.cell() as usize], at + 1) != at + 1 {
                    let corners = beyond.of_cell();
                    stack.extend(corners.into_iter().find(|f| mesh.apex(*f) == at as u32));
                }
            }
        }
        let apart = link.iter().find(|f| reached[f.cell() as usize] != at + 1);
        let cells = link.len() as i64;
        let sphere_or_disk = if boundary_faces == 0 { 2 } else { 1 };
        let euler = edges - (3 * cells + boundary_faces) / 2 + cells;
        if apart.is_some() || euler != sphere_or_disk {
            return Err(MeshError::PinchedNode {
                node: tags.node(at),
                first: tags.cell(first.cell() as usize),
                second: tags.cell(apart.unwrap_or(&first).cell() as usize),
            });
        }
    }
    Ok(())
}

fn node(tags: &Tags, node: u32) -> NodeId {
    tags.node(node as usize)
}
