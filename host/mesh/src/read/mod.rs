//! Mesh files of any kind, told apart by their extension.
//!
//! Entry points: [`read_mesh`], and [`read_raw_mesh`] for a mesh that may be bad. Each format has a file of its own;
//! they share [`scan`], which goes through a file, and [`gather`], which takes nodes and cells.

mod abaqus;
mod gather;
mod medit;
mod msh;
mod regions;
mod scan;
mod tetgen;
mod vtk;
mod vtu;

pub use msh::{read_msh, read_msh_raw};

pub(crate) use gather::keep_nodes;
pub(crate) use scan::{Coding, Endian, Kind, Number, Scan};

use super::{MeshError, RawMesh, TetMesh};
use std::io;
use std::path::Path;
use sutura_files::read_plain;

/// Largest mesh or surface that is read \[bytes\].
pub const MOST_BYTES: u64 = 1 << 30;

/// Reads and checks `.msh` (gmsh 2.2 and 4.1), `.node` or `.ele` (tetgen; each finds the other beside it), `.vtk`
/// (legacy), `.vtu`, `.mesh` (medit) or `.inp` (abaqus), in units of `scale_to_m` metres.
///
/// # Errors
/// A [`MeshError`]: with the line or byte for what cannot be read, with the file's number of the element or
/// node for a mesh that fails a check.
pub fn read_mesh(path: &Path, scale_to_m: f64) -> Result<TetMesh, MeshError> {
    read_mesh_with(path, scale_to_m, |path| read_plain(path, MOST_BYTES))
}

/// As [`read_mesh`], with the bytes of each file from `file`.
///
/// # Errors
/// As there.
pub fn read_mesh_with(
    path: &Path,
    scale_to_m: f64,
    file: impl Fn(&Path) -> io::Result<Vec<u8>>,
) -> Result<TetMesh, MeshError> {
    read_raw_mesh_with(path, scale_to_m, None, file)?.check()
}

/// As [`read_mesh`], without a look at the mesh in the file.
///
/// # Errors
/// A [`MeshError`] for what cannot be read, and for cells with nodes that do not exist.
pub fn read_raw_mesh(path: &Path, scale_to_m: f64) -> Result<RawMesh, MeshError> {
    read_raw_mesh_with(path, scale_to_m, None, |path| read_plain(path, MOST_BYTES))
}

/// Reads as [`read_raw_mesh`] does, with the bytes of each file from `file`, and the regions from the cell array of the name
/// `region_array`, if one is given.
///
/// # Errors
/// The same, and [`MeshError::NoCellArray`].
pub fn read_raw_mesh_with(
    path: &Path,
    scale_to_m: f64,
    region_array: Option<&str>,
    file: impl Fn(&Path) -> io::Result<Vec<u8>>,
) -> Result<RawMesh, MeshError> {
    let read = |path: &Path| {
        file(path).map_err(|error| MeshError::Unreadable {
            file: path.display().to_string(),
            reason: error.to_string(),
        })
    };
    let extension = path.extension().and_then(|extension| extension.to_str());
    if let (Some(name), Some("msh" | "node" | "ele" | "mesh" | "inp")) = (region_array, extension) {
        return Err(regions::no_array(name, &[]));
    }
    let mesh = match extension {
        Some("msh") => read_msh_raw(&read(path)?)?,
        Some("node" | "ele") => tetgen::read_tetgen(
            &read(&path.with_extension("node"))?,
            &read(&path.with_extension("ele"))?,
        )?,
        Some("vtk") => vtk::read_vtk(&read(path)?, region_array)?,
        Some("vtu") => vtu::read_vtu(&read(path)?, region_array)?,
        Some("mesh") => medit::read_medit(&read(path)?)?,
        Some("inp") => abaqus::read_abaqus(&read(path)?)?,
        _ => return Err(MeshError::Extension(path.display().to_string())),
    };
    mesh.scaled(scale_to_m)
}
