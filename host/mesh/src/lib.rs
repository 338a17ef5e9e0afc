//! Tetrahedral meshes: from files, from a built-in structured slab, their boundary and connectivity.
//!
//! Entry points: [`read_mesh`], [`slab`], [`TetMesh::new`], [`HalfFaces`], [`MeshReport`], [`TriangleMesh`]. A [`TetMesh`] that exists has
//! passed every check in [`MeshError`]; nothing downstream has to look again.

mod boundary;
mod check;
mod error;
mod half_face;
mod half_faces;
mod manifold;
mod read;
mod report;
mod structured;
mod surface;
mod triangles;

pub use boundary::{Boundary, Side};
pub use error::{CellId, MeshError, NodeId, Place};
pub use half_face::{HalfEdge, HalfFace};
pub use half_faces::{AroundEdge, HalfFaces};
pub use read::{
    MOST_BYTES, read_mesh, read_mesh_with, read_msh, read_msh_raw, read_raw_mesh,
    read_raw_mesh_with,
};
pub use report::{EdgeLengths, MeshReport, Quality, RegionReport, mean_ratio};
pub use structured::{slab, tube};
pub use surface::Surface;
pub use triangles::{Closed, Repaired, SurfaceFlaw, SurfaceFormat, TriangleMesh};

use check::Tags;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// A mesh as a file has it: nothing in it has been checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawMesh {
    /// Node positions \[m\], (n x 3), world frame.
    pub points_m: Vec<[f64; 3]>,
    /// Node indices of each cell, (m x 4).
    pub cells: Vec<[u32; 4]>,
    /// Number of the region that each cell lies in, 0 where the file gives none, (m).
    pub regions: Vec<i64>,
    /// Names of regions, where the file gives them.
    pub region_names: BTreeMap<i64, String>,
    /// What the reader left out of the file or made of it.
    pub notes: Vec<String>,
    /// The file's own numbers, for messages.
    tags: Tags,
}

impl RawMesh {
    /// Points \[m\] (n x 3), cells as node indices (m x 4), a region for each cell (m) or none at all.
    pub fn new(points_m: Vec<[f64; 3]>, cells: Vec<[u32; 4]>, regions: Vec<i64>) -> Self {
        Self {
            points_m,
            cells,
            regions,
            ..Self::default()
        }
    }

    /// Takes another mesh in beside what is there. The numbers that files gave are forgotten.
    pub fn append(&mut self, other: Self) {
        let first = self.points_m.len() as u32;
        self.points_m.extend(other.points_m);
        let cells = other.cells.into_iter();
        self.cells
            .extend(cells.map(|cell| cell.map(|node| node + first)));
        self.regions.extend(other.regions);
        self.region_names.extend(other.region_names);
        for note in other.notes {
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
        self.tags = Tags::default();
    }

    /// The mesh with its coordinates times `scale_to_m`.
    ///
    /// # Errors
    /// [`MeshError::Scale`].
    pub fn scaled(mut self, scale_to_m: f64) -> Result<Self, MeshError> {
        if !(scale_to_m.is_finite() && scale_to_m > 0.0) {
            return Err(MeshError::Scale(scale_to_m));
        }
        for x in self.points_m.iter_mut().flatten() {
            *x *= scale_to_m;
        }
        Ok(self)
    }

    /// [`mean_ratio`] of each cell, (m).
    pub fn qualities(&self) -> Vec<f64> {
        let corners = self.cells.iter().map(|cell| self.corners(*cell));
        corners.map(|corners| mean_ratio(&corners)).collect()
    }

    /// Drops the nodes that no cell uses and turns inverted cells, two of whose nodes change places. Regions, and the order
    /// of what is left, stay.
    pub fn clean(&mut self) -> Cleaned {
        let nodes = self.points_m.len();
        let mut used = vec![false; nodes];
        for &node in self.cells.iter().flatten() {
            if let Some(used) = used.get_mut(node as usize) {
                *used = true;
            }
        }
        read::keep_nodes(
            |node| used[node],
            &mut self.points_m,
            &mut self.tags.nodes,
            &mut self.cells,
        );
        let mut turned = 0;
        for index in 0..self.cells.len() {
            if signed_volume(&self.corners(self.cells[index])) < 0.0 {
                self.cells[index].swap(2, 3);
                turned += 1;
            }
        }
        Cleaned {
            dropped_nodes: nodes - self.points_m.len(),
            turned_cells: turned,
        }
    }

    /// Corners of one cell \[m\]; not a number where a node does not exist.
    fn corners(&self, cell: [u32; 4]) -> [Vector3<f64>; 4] {
        cell.map(|node| {
            let at = self.points_m.get(node as usize);
            Vector3::from(at.copied().unwrap_or([f64::NAN; 3]))
        })
    }

    /// Checks and takes the mesh.
    ///
    /// # Errors
    /// The first [`MeshError`] found, naming the node or cell by its index and by the file's number.
    pub fn check(self) -> Result<TetMesh, MeshError> {
        let (nodes, tags) = (self.points_m.len(), &self.tags);
        check::check_points(&self.points_m, tags)?;
        check::check_cells(nodes, &self.cells, tags)?;
        check::check_volumes(&self.points_m, &self.cells, tags)?;
        let mut regions = self.regions;
        regions.resize(self.cells.len(), 0);
        let half_faces = HalfFaces::of_checked_cells(nodes, self.cells, tags)?;
        check::check_used(nodes, half_faces.cells(), tags)?;
        Ok(TetMesh {
            half_faces,
            points_m: self.points_m,
            regions,
            region_names: self.region_names,
        })
    }
}

/// What [`RawMesh::clean`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, schemars::JsonSchema)]
pub struct Cleaned {
    /// Nodes without a cell that were dropped.
    pub dropped_nodes: usize,
    /// Inverted cells that were turned.
    pub turned_cells: usize,
}

/// A checked tetrahedral mesh.
///
/// Cells are positively oriented: `(p1 - p0) x (p2 - p0) . (p3 - p0) > 0`.
#[derive(Clone, Debug, PartialEq)]
pub struct TetMesh {
    points_m: Vec<[f64; 3]>,
    half_faces: HalfFaces,
    regions: Vec<i64>,
    region_names: BTreeMap<i64, String>,
}

impl TetMesh {
    /// Checks and takes a mesh: points \[m\] (n x 3), cells as node indices (m x 4).
    ///
    /// # Errors
    /// The first [`MeshError`] found, naming the node or cell by its 0-based index.
    pub fn new(points_m: Vec<[f64; 3]>, cells: Vec<[u32; 4]>) -> Result<Self, MeshError> {
        RawMesh::new(points_m, cells, Vec::new()).check()
    }

    /// This mesh and another, not connected: its nodes and cells come first.
    ///
    /// # Errors
    /// As [`Self::new`]; regions are not kept.
    pub fn beside(&self, other: &Self) -> Result<Self, MeshError> {
        let first = self.points_m.len() as u32;
        let points_m = [self.points_m(), other.points_m()].concat();
        let others = other
            .cells()
            .iter()
            .map(|cell| cell.map(|node| node + first));
        Self::new(
            points_m,
            self.cells().iter().copied().chain(others).collect(),
        )
    }

    /// Node positions \[m\], (n x 3), world frame.
    pub fn points_m(&self) -> &[[f64; 3]] {
        &self.points_m
    }

    /// Node indices of each cell, (m x 4).
    pub fn cells(&self) -> &[[u32; 4]] {
        self.half_faces.cells()
    }

    /// Who is next to whom.
    pub fn half_faces(&self) -> &HalfFaces {
        &self.half_faces
    }

    /// Number of the region that each cell lies in, 0 where none was given, (m): gmsh's physical group,
    /// tetgen's attribute.
    pub fn regions(&self) -> &[i64] {
        &self.regions
    }

    /// Names of regions, where the file gave them.
    pub fn region_names(&self) -> &BTreeMap<i64, String> {
        &self.region_names
    }

    /// Boundary triangles and vertices.
    pub fn surface(&self) -> Surface {
        Surface::of(self)
    }

    /// Corners of one cell \[m\].
    pub fn corners(&self, cell: [u32; 4]) -> [Vector3<f64>; 4] {
        cell.map(|node| Vector3::from(self.points_m[node as usize]))
    }
}

/// Signed volume of a tetrahedron \[m^3\].
pub fn signed_volume(corners: &[Vector3<f64>; 4]) -> f64 {
    let [p0, p1, p2, p3] = corners;
    (p1 - p0).cross(&(p2 - p0)).dot(&(p3 - p0)) / 6.0
}
