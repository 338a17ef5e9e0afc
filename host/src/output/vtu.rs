//! VTK's XML unstructured grid, as ASCII: opens in ParaView (there: Warp By Vector).
//!
//! Entry points: [`vtu`], [`grid`]. Format: VTK File Formats, version 4.2, "UnstructuredGrid".

use super::Solution;
use crate::fem::von_mises_pa;
use std::fmt::Write;

/// VTK's number for a linear tetrahedron.
const VTK_TETRA: u8 = 10;

/// What a file holds: points, tetrahedra, named arrays at the points and in the cells.
pub(super) struct Grid<'a> {
    /// Positions \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    /// Nodes of each cell, (m x 4).
    pub cells: &'a [[u32; 4]],
    /// Vectors at the points, (n x 3) each; the first is what ParaView takes for Warp By Vector.
    pub point_vectors: &'a [(&'a str, &'a [[f64; 3]])],
    /// Whole numbers in the cells, (m) each.
    pub cell_integers: &'a [(&'a str, &'a [i64])],
    /// Three numbers in each cell, (m x 3).
    pub cell_vectors: &'a [(&'a str, &'a [[f64; 3]])],
    /// Numbers in the cells, (m) each.
    pub cell_numbers: &'a [(&'a str, &'a [f64])],
}

/// The whole file of a result: points at rest, cells, `displacement_m` at the points, `principal_stress_pa` and
/// `von_mises_pa` in the cells.
pub fn vtu(solution: &Solution) -> String {
    let principal = &solution.principal_stress_pa;
    let von_mises: Vec<f64> = principal.iter().map(von_mises_pa).collect();
    grid(&Grid {
        points_m: &solution.points_m,
        cells: &solution.cells,
        point_vectors: &[("displacement_m", &solution.displacement_m)],
        cell_integers: &[],
        cell_vectors: &[("principal_stress_pa", principal)],
        cell_numbers: &[("von_mises_pa", &von_mises)],
    })
}

/// The whole file. Numbers are the shortest that read back to the same bits.
pub(super) fn grid(grid: &Grid<'_>) -> String {
    let (points, cells) = (grid.points_m, grid.cells);
    let mut xml = String::with_capacity(150 * points.len() + 60 * cells.len() + 1000);
    xml.push_str("<?xml version=\"1.0\"?>\n");
    xml.push_str(
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\">\n",
    );
    xml.push_str("<UnstructuredGrid>\n");
    push(
        &mut xml,
        format_args!(
            "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
            points.len(),
            cells.len()
        ),
    );
    if let Some((first, _)) = grid.point_vectors.first() {
        push(&mut xml, format_args!("<PointData Vectors=\"{first}\">\n"));
        for (name, rows) in grid.point_vectors {
            vectors(&mut xml, name, rows);
        }
        xml.push_str("</PointData>\n");
    }
    let in_cells = grid.cell_integers.len() + grid.cell_vectors.len() + grid.cell_numbers.len();
    if in_cells > 0 {
        xml.push_str("<CellData>\n");
        for (name, values) in grid.cell_integers {
            array(&mut xml, "Int64", name, values.iter());
        }
        for (name, rows) in grid.cell_vectors {
            vectors(&mut xml, name, rows);
        }
        for (name, values) in grid.cell_numbers {
            array(&mut xml, "Float64", name, values.iter());
        }
        xml.push_str("</CellData>\n");
    }
    xml.push_str("<Points>\n");
    vectors(&mut xml, "points_m", points);
    xml.push_str("</Points>\n<Cells>\n");
    array(&mut xml, "Int64", "connectivity", cells.iter().flatten());
    array(
        &mut xml,
        "Int64",
        "offsets",
        (1..=cells.len()).map(|n| 4 * n),
    );
    array(&mut xml, "UInt8", "types", cells.iter().map(|_| VTK_TETRA));
    xml.push_str("</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n");
    xml
}

fn vectors(xml: &mut String, name: &str, rows: &[[f64; 3]]) {
    push(
        xml,
        format_args!(
            "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"3\" format=\"ascii\">\n"
        ),
    );
    for [x, y, z] in rows {
        push(xml, format_args!("{x:e} {y:e} {z:e}\n"));
    }
    xml.push_str("</DataArray>\n");
}

fn array(
    xml: &mut String,
    kind: &str,
    name: &str,
    values: impl Iterator<Item = impl std::fmt::Display>,
) {
    push(
        xml,
        format_args!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">\n"),
    );
    for value in values {
        push(xml, format_args!("{value}\n"));
    }
    xml.push_str("</DataArray>\n");
}

fn push(xml: &mut String, text: std::fmt::Arguments<'_>) {
    // Formatting into a String cannot fail.
    let _ = xml.write_fmt(text);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_cells() -> Solution {
        Solution {
            scene: "two".to_owned(),
            tissue: "linear",
            forces_act_on: "tissue",
            points_m: vec![
                [0.0, 0.0, 0.0],
                [0.1, 0.0, 0.0],
                [0.0, 0.1, 0.0],
                [0.0, 0.0, 1.0 / 3.0],
                [0.1, 0.1, 0.1],
            ],
            displacement_m: (0..5)
                .map(|i| [f64::from(i) * 0.1, -1e-300, 1.0 / 7.0])
                .collect(),
            reactions: Vec::new(),
            tools: Vec::new(),
            needles: Vec::new(),
            wound: None,
            residual: 0.0,
            cells: vec![[0, 1, 2, 3], [1, 2, 3, 4]],
            principal_stress_pa: vec![[1e3 / 3.0, 0.0, -2e-5], [7.0, 4.0, 4.0]],
        }
    }

    fn numbers<T: std::str::FromStr>(document: &roxmltree::Document<'_>, name: &str) -> Vec<T> {
        let array = document
            .descendants()
            .find(|n| n.attribute("Name") == Some(name));
        let text = array.and_then(|n| n.text()).expect("the array is there");
        let number = |word: &str| word.parse().ok().expect("a number of its type");
        text.split_ascii_whitespace().map(number).collect()
    }

    /// Read back by an XML parser: same counts, same bits.
    #[test]
    fn the_file_reads_back_bit_by_bit() {
        let solution = two_cells();
        let text = vtu(&solution);
        let document = roxmltree::Document::parse(&text).expect("well-formed XML");
        let root = document.root_element();
        assert_eq!(root.attribute("type"), Some("UnstructuredGrid"));
        let piece = document
            .descendants()
            .find(|n| n.has_tag_name("Piece"))
            .expect("a piece");
        assert_eq!(piece.attribute("NumberOfPoints"), Some("5"));
        assert_eq!(piece.attribute("NumberOfCells"), Some("2"));
        assert_eq!(
            numbers::<f64>(&document, "points_m"),
            solution.points_m.concat()
        );
        assert_eq!(
            numbers::<f64>(&document, "displacement_m"),
            solution.displacement_m.concat()
        );
        assert_eq!(
            numbers::<u32>(&document, "connectivity"),
            solution.cells.concat()
        );
        assert_eq!(numbers::<u32>(&document, "offsets"), [4, 8]);
        assert_eq!(numbers::<u8>(&document, "types"), [VTK_TETRA; 2]);
        let cells = document.descendants().find(|n| n.has_tag_name("CellData"));
        let names: Vec<_> = cells
            .into_iter()
            .flat_map(|n| n.children().filter_map(|n| n.attribute("Name")))
            .collect();
        assert_eq!(names, ["principal_stress_pa", "von_mises_pa"]);
        assert_eq!(
            numbers::<f64>(&document, "principal_stress_pa"),
            solution.principal_stress_pa.concat()
        );
        let von_mises = numbers::<f64>(&document, "von_mises_pa");
        assert!(von_mises.len() == 2 && (von_mises[1] - 3.0).abs() < 1e-15);
    }
}
