//! `[[tissue_contact]]`: which parts of the tissue may touch, and where their gap is measured.
//!
//! Entry point: [`read_touching`].

use super::document::{Document, SceneError};
use super::region::tagged;
use super::select::select;
use super::threads::read_friction;
use crate::mesh::TetMesh;
use sutura_scene_file::wound::TissueContactSection;
use toml::Spanned;

/// Two parts of the tissue that may touch.
#[derive(Clone, Debug, PartialEq)]
pub struct TissueContact {
    /// What the scene calls them.
    pub between: [String; 2],
    /// Boundary triangles of each, counter-clockwise seen from outside, (f x 3); the same twice for a part that may
    /// touch itself.
    pub faces: [Vec<[u32; 3]>; 2],
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Nodes of each whose distance to the other is the gap; empty if the scene names none.
    pub rims: [Vec<u32>; 2],
}

impl TissueContact {
    /// Whether one part may touch itself.
    pub fn is_within_one(&self) -> bool {
        self.faces[0] == self.faces[1]
    }
}

/// What may touch, in the order of the sections.
///
/// # Errors
/// A flaw at a region that the mesh does not have or without a free face, at regions that share a node, at a rim that is
/// not on its part.
pub(super) fn read_touching(
    document: &Document,
    sections: &[Spanned<TissueContactSection>],
    mesh: &TetMesh,
) -> Result<Vec<TissueContact>, SceneError> {
    let read = |section: &Spanned<TissueContactSection>| {
        let TissueContactSection {
            between,
            friction,
            rims,
        } = section.get_ref();
        let [first, second] = between;
        let faces = [
            boundary(document, mesh, first)?,
            boundary(document, mesh, second)?,
        ];
        let touched = [nodes(&faces[0]), nodes(&faces[1])];
        let shared = touched[0]
            .iter()
            .find(|node| touched[1].binary_search(node).is_ok());
        if let Some(node) = shared.filter(|_| faces[0] != faces[1]) {
            let message = format!("these parts have node {node} in common: they are connected");
            let help = "name two parts that are not connected, or one part twice";
            return Err(document.flaw(second.span(), message, "connected", Some(help)));
        }
        let mut chosen = [Vec::new(), Vec::new()];
        for (index, rim) in rims.iter().flatten().enumerate() {
            let mut all = select(document, mesh, rim)?;
            all.retain(|node| touched[index].binary_search(node).is_ok());
            if all.is_empty() {
                let message = format!(
                    "this rim has no node on the boundary of {}",
                    between[index].get_ref()
                );
                let help = "`rims` are in the order of `between`";
                return Err(document.flaw(rim.span(), message, "not on it", Some(help)));
            }
            chosen[index] = all;
        }
        Ok(TissueContact {
            between: [first, second].map(|tag| tag.get_ref().to_string().replace('"', "")),
            faces,
            friction: read_friction(document, friction.as_ref(), f64::INFINITY)?,
            rims: chosen,
        })
    };
    sections.iter().map(read).collect()
}

/// Boundary triangles of the mesh that belong to a region's cells.
fn boundary(
    document: &Document,
    mesh: &TetMesh,
    tag: &Spanned<sutura_scene_file::scene::RegionTag>,
) -> Result<Vec<[u32; 3]>, SceneError> {
    let cells = tagged(document, mesh, tag)?;
    let boundary = mesh.half_faces().boundary();
    let of_region = |cell: usize| cells.binary_search(&cell).is_ok();
    let faces: Vec<[u32; 3]> = boundary
        .half_faces()
        .iter()
        .zip(boundary.triangles())
        .filter(|(face, _)| of_region(face.cell() as usize))
        .map(|(_, triangle)| *triangle)
        .collect();
    if faces.is_empty() {
        let message = format!("region {} has no face on the boundary", tag.get_ref());
        let help = "what lies inside other tissue touches nothing";
        return Err(document.flaw(tag.span(), message, "all inside", Some(help)));
    }
    Ok(faces)
}

fn nodes(faces: &[[u32; 3]]) -> Vec<u32> {
    let mut nodes: Vec<u32> = faces.iter().flatten().copied().collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}
