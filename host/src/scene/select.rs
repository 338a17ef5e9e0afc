//! Node selections: a plane, a box, or a list, as `[[fixed]]` and `[[load]]` write them.
//!
//! Entry point: [`select`].

use super::document::{Document, SceneError};
use crate::mesh::TetMesh;
use sutura_scene_file::scene::Selection;
use toml::Spanned;

/// Node numbers in ascending order, each once, (at least one).
///
/// # Errors
/// A flaw at the selection when it says nothing, says two things, names a node that the mesh does not
/// have, or holds no node at all.
pub(super) fn select(
    document: &Document,
    mesh: &TetMesh,
    selection: &Spanned<Selection>,
) -> Result<Vec<u32>, SceneError> {
    let flaw = |message: String, label: &str, help: String| {
        document.flaw(selection.span(), message, label, Some(&help))
    };
    let Selection {
        plane,
        cuboid,
        nodes,
    } = selection.get_ref();
    let mut chosen = match (plane, cuboid, nodes) {
        (Some(p), None, None) => {
            let axis = p.axis as usize;
            where_point(mesh, |x| (x[axis] - p.at_m).abs() <= p.within_m)
        }
        (None, Some(b), None) => where_point(mesh, |x| b.contains(*x)),
        (None, None, Some(list)) => {
            check_nodes(document, mesh, list)?;
            list.get_ref().clone()
        }
        _ => {
            let help = "give exactly one of `plane`, `box`, `nodes`".to_owned();
            return Err(flaw(
                "a selection of nodes says one thing".to_owned(),
                "here",
                help,
            ));
        }
    };
    chosen.sort_unstable();
    chosen.dedup();
    if chosen.is_empty() {
        let ([x0, y0, z0], [x1, y1, z1]) = bounds(mesh);
        let help = format!(
            "the mesh lies in x {x0:.6}..{x1:.6}, y {y0:.6}..{y1:.6}, z {z0:.6}..{z1:.6} m, after scaling"
        );
        return Err(flaw(
            "this selection holds no node of the mesh".to_owned(),
            "empty",
            help,
        ));
    }
    Ok(chosen)
}

/// Refuses node numbers that the mesh does not have.
pub(super) fn check_nodes(
    document: &Document,
    mesh: &TetMesh,
    nodes: &Spanned<Vec<u32>>,
) -> Result<(), SceneError> {
    let count = mesh.points_m().len();
    let Some(bad) = nodes.get_ref().iter().find(|n| **n as usize >= count) else {
        return Ok(());
    };
    let message = format!("node {bad} is not in the mesh");
    let help = format!(
        "nodes are counted from 0 in the mesh file's order, here up to {}",
        count - 1
    );
    Err(document.flaw(nodes.span(), message, "no such node", Some(&help)))
}

fn where_point(mesh: &TetMesh, inside: impl Fn(&[f64; 3]) -> bool) -> Vec<u32> {
    let numbered = (0u32..).zip(mesh.points_m());
    numbered
        .filter(|(_, point)| inside(point))
        .map(|(node, _)| node)
        .collect()
}

/// Lowest and highest corner of the mesh's bounding box \[m\].
fn bounds(mesh: &TetMesh) -> ([f64; 3], [f64; 3]) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for point in mesh.points_m() {
        for i in 0..3 {
            low[i] = low[i].min(point[i]);
            high[i] = high[i].max(point[i]);
        }
    }
    (low, high)
}
