//! Tetrahedral meshes: from gmsh files, from a built-in structured slab, and their boundary.
//!
//! Entry points: [`read_msh`], [`slab`], [`TetMesh::new`]. A [`TetMesh`] that exists has passed
//! every check in [`MeshError`]; nothing downstream has to look again.

mod check;
mod error;
mod msh;
mod structured;
mod surface;

pub use error::{CellId, MeshError, NodeId};
pub use msh::read_msh;
pub use structured::slab;
pub use surface::Surface;

use check::Tags;
use nalgebra::Vector3;

/// A checked tetrahedral mesh.
///
/// Cells are positively oriented: `(p1 - p0) x (p2 - p0) . (p3 - p0) > 0`.
#[derive(Clone, Debug, PartialEq)]
pub struct TetMesh {
    points_m: Vec<[f64; 3]>,
    cells: Vec<[u32; 4]>,
}

impl TetMesh {
    /// Checks and takes a mesh: points \[m\] (n x 3), cells as node indices (m x 4).
    ///
    /// # Errors
    /// The first [`MeshError`] found, naming the node or cell by its 0-based index.
    pub fn new(points_m: Vec<[f64; 3]>, cells: Vec<[u32; 4]>) -> Result<Self, MeshError> {
        Self::new_tagged(points_m, cells, &Tags::default())
    }

    /// As [`TetMesh::new`], with the file's own numbers for the messages.
    fn new_tagged(
        points_m: Vec<[f64; 3]>,
        cells: Vec<[u32; 4]>,
        tags: &Tags,
    ) -> Result<Self, MeshError> {
        check::check(&points_m, &cells, tags)?;
        Ok(Self { points_m, cells })
    }

    /// Node positions \[m\], (n x 3), world frame.
    pub fn points_m(&self) -> &[[f64; 3]] {
        &self.points_m
    }

    /// Node indices of each cell, (m x 4).
    pub fn cells(&self) -> &[[u32; 4]] {
        &self.cells
    }

    /// Boundary triangles and vertices.
    pub fn surface(&self) -> Surface {
        Surface::of(self)
    }

    /// Corners of one cell \[m\].
    pub(crate) fn corners(&self, cell: [u32; 4]) -> [Vector3<f64>; 4] {
        cell.map(|node| Vector3::from(self.points_m[node as usize]))
    }
}

/// Signed volume of a tetrahedron \[m^3\].
pub(crate) fn signed_volume(corners: &[Vector3<f64>; 4]) -> f64 {
    let [p0, p1, p2, p3] = corners;
    (p1 - p0).cross(&(p2 - p0)).dot(&(p3 - p0)) / 6.0
}
