//! Mesh files of any kind, told apart by their extension.
//!
//! Entry points: [`read_mesh`], and [`read_raw_mesh`] for a mesh that may be bad.

use super::msh::read_msh_raw;
use super::tetgen::read_tetgen;
use super::vtk::read_vtk;
use super::{MeshError, RawMesh, TetMesh};
use std::io;
use std::path::Path;

/// Reads and checks `.msh` (gmsh 2.2 and 4.1 ASCII), `.node` or `.ele` (tetgen; each finds the other
/// beside it) or `.vtk` (legacy ASCII), in units of `scale_to_m` metres.
///
/// # Errors
/// A [`MeshError`]: with the line for what cannot be read, with the file's number of the element or
/// node for a mesh that fails a check.
pub fn read_mesh(path: &Path, scale_to_m: f64) -> Result<TetMesh, MeshError> {
    read_mesh_with(path, scale_to_m, |path| std::fs::read(path))
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
    read_raw(path, scale_to_m, file)?.check()
}

/// As [`read_mesh`], without a look at the mesh in the file.
///
/// # Errors
/// A [`MeshError`] for what cannot be read, and for cells with nodes that do not exist.
pub fn read_raw_mesh(path: &Path, scale_to_m: f64) -> Result<RawMesh, MeshError> {
    read_raw(path, scale_to_m, |path| std::fs::read(path))
}

fn read_raw(
    path: &Path,
    scale_to_m: f64,
    file: impl Fn(&Path) -> io::Result<Vec<u8>>,
) -> Result<RawMesh, MeshError> {
    let read = |path: &Path| text(path, file(path));
    let extension = path.extension().and_then(|extension| extension.to_str());
    let mesh = match extension {
        Some("msh") => read_msh_raw(&read(path)?)?,
        Some("node" | "ele") => read_tetgen(
            &read(&path.with_extension("node"))?,
            &read(&path.with_extension("ele"))?,
        )?,
        Some("vtk") => read_vtk(&read(path)?)?,
        _ => return Err(MeshError::Extension(path.display().to_string())),
    };
    mesh.scaled(scale_to_m)
}

fn text(path: &Path, bytes: io::Result<Vec<u8>>) -> Result<String, MeshError> {
    let unreadable = |reason: String| MeshError::Unreadable {
        file: path.display().to_string(),
        reason,
    };
    let bytes = bytes.map_err(|error| unreadable(error.to_string()))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = 1 + error.as_bytes()[..at]
            .iter()
            .filter(|b| **b == b'\n')
            .count();
        unreadable(format!("line {line} is not text; save the file as ASCII"))
    })
}
