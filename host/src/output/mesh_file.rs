//! Meshes as files: gmsh 2.2, tetgen, legacy VTK, VTK's XML.
//!
//! Entry point: [`write_mesh`]. Numbers are the shortest that read back to the same bits.

use super::vtu::{Grid, grid};
use crate::mesh::RawMesh;
use std::fmt::Write;
use std::io;
use std::path::Path;
use sutura_files::write_whole;

/// File formats of meshes, by extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// `.msh`: gmsh 2.2 ASCII, regions as physical groups.
    Msh,
    /// `.node` and `.ele`: tetgen, both are written, regions as the attribute.
    Tetgen,
    /// `.vtk`: legacy ASCII, regions as the cell array `region`.
    Vtk,
    /// `.vtu`: for ParaView, with the cell arrays `region` and `mean_ratio`.
    Vtu,
}

impl MeshFormat {
    /// The format that a path's extension stands for.
    pub fn of(path: &Path) -> Option<MeshFormat> {
        match path.extension()?.to_str()? {
            "msh" => Some(MeshFormat::Msh),
            "node" | "ele" => Some(MeshFormat::Tetgen),
            "vtk" => Some(MeshFormat::Vtk),
            "vtu" => Some(MeshFormat::Vtu),
            _ => None,
        }
    }
}

/// Writes the mesh, each file whole or not at all.
///
/// # Errors
/// What the system says.
pub fn write_mesh(mesh: &RawMesh, path: &Path, format: MeshFormat) -> io::Result<()> {
    match format {
        MeshFormat::Msh => write_whole(path, msh(mesh).as_bytes()),
        MeshFormat::Tetgen => {
            write_whole(&path.with_extension("node"), node(mesh).as_bytes())?;
            write_whole(&path.with_extension("ele"), ele(mesh).as_bytes())
        }
        MeshFormat::Vtk => write_whole(path, vtk(mesh).as_bytes()),
        MeshFormat::Vtu => {
            let file = grid(&Grid {
                points_m: &mesh.points_m,
                cells: &mesh.cells,
                cell_integers: &[("region", &regions(mesh))],
                cell_numbers: &[("mean_ratio", &mesh.qualities())],
                ..Grid::default()
            });
            write_whole(path, file.as_bytes())
        }
    }
}

/// One for each cell.
fn regions(mesh: &RawMesh) -> Vec<i64> {
    let mut regions = mesh.regions.clone();
    regions.resize(mesh.cells.len(), 0);
    regions
}

fn msh(mesh: &RawMesh) -> String {
    let mut text = String::from("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n");
    if !mesh.region_names.is_empty() {
        push(
            &mut text,
            format_args!("$PhysicalNames\n{}\n", mesh.region_names.len()),
        );
        for (region, name) in &mesh.region_names {
            push(&mut text, format_args!("3 {region} \"{name}\"\n"));
        }
        text.push_str("$EndPhysicalNames\n");
    }
    push(&mut text, format_args!("$Nodes\n{}\n", mesh.points_m.len()));
    for (index, [x, y, z]) in mesh.points_m.iter().enumerate() {
        push(&mut text, format_args!("{} {x:e} {y:e} {z:e}\n", index + 1));
    }
    push(
        &mut text,
        format_args!("$EndNodes\n$Elements\n{}\n", mesh.cells.len()),
    );
    for (index, (cell, region)) in mesh.cells.iter().zip(regions(mesh)).enumerate() {
        let [a, b, c, d] = cell.map(|node| node + 1);
        let number = index + 1;
        push(
            &mut text,
            format_args!("{number} 4 2 {region} {region} {a} {b} {c} {d}\n"),
        );
    }
    text.push_str("$EndElements\n");
    text
}

fn node(mesh: &RawMesh) -> String {
    let mut text = format!("{} 3 0 0\n", mesh.points_m.len());
    for (index, [x, y, z]) in mesh.points_m.iter().enumerate() {
        push(&mut text, format_args!("{} {x:e} {y:e} {z:e}\n", index + 1));
    }
    text
}

fn ele(mesh: &RawMesh) -> String {
    let mut text = format!("{} 4 1\n", mesh.cells.len());
    for (index, (cell, region)) in mesh.cells.iter().zip(regions(mesh)).enumerate() {
        let [a, b, c, d] = cell.map(|node| node + 1);
        push(
            &mut text,
            format_args!("{} {a} {b} {c} {d} {region}\n", index + 1),
        );
    }
    text
}

fn vtk(mesh: &RawMesh) -> String {
    let (points, cells) = (&mesh.points_m, &mesh.cells);
    let mut text = String::from(
        "# vtk DataFile Version 3.0\ntetrahedra, metres\nASCII\nDATASET UNSTRUCTURED_GRID\n",
    );
    push(&mut text, format_args!("POINTS {} double\n", points.len()));
    for [x, y, z] in points {
        push(&mut text, format_args!("{x:e} {y:e} {z:e}\n"));
    }
    push(
        &mut text,
        format_args!("CELLS {} {}\n", cells.len(), 5 * cells.len()),
    );
    for [a, b, c, d] in cells {
        push(&mut text, format_args!("4 {a} {b} {c} {d}\n"));
    }
    push(&mut text, format_args!("CELL_TYPES {}\n", cells.len()));
    text.push_str(&"10\n".repeat(cells.len()));
    push(&mut text, format_args!("CELL_DATA {}\n", cells.len()));
    text.push_str("SCALARS region int 1\nLOOKUP_TABLE default\n");
    for region in regions(mesh) {
        push(&mut text, format_args!("{region}\n"));
    }
    text
}

fn push(text: &mut String, line: std::fmt::Arguments<'_>) {
    // Formatting into a String cannot fail.
    let _ = text.write_fmt(line);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{read_raw_mesh, slab};

    /// Each format through its own reader: same bits, same regions.
    #[test]
    fn what_is_written_reads_back() {
        let mesh = slab([0.3, 0.2, 0.1], [2, 1, 1]).expect("a slab");
        let regions = (0..12).map(|k| k % 3).collect();
        let raw = RawMesh::new(mesh.points_m().to_vec(), mesh.cells().to_vec(), regions);
        let directory = tempfile::tempdir().expect("a directory");
        for name in ["a.msh", "b.node", "c.ele", "d.vtk"] {
            let path = directory.path().join(name);
            let format = MeshFormat::of(&path).expect("a format");
            write_mesh(&raw, &path, format).expect("written");
            let back = read_raw_mesh(&path, 1.0).expect(name);
            assert_eq!(back.points_m, raw.points_m, "{name}");
            assert_eq!(
                (&back.cells, &back.regions),
                (&raw.cells, &raw.regions),
                "{name}"
            );
        }
    }
}
