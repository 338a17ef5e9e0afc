//! VTK's XML unstructured grid, as ASCII: opens in ParaView (there: Warp By Vector).
//!
//! Entry points: [`vtu`], [`grid`]. Format: VTK File Formats, version 4.2, "UnstructuredGrid".

use super::Drawn;
use crate::fem::von_mises_pa;
use std::fmt::Write;

/// VTK's numbers for cells.
const POLY_LINE: u8 = 4;
const TETRA: u8 = 10;

/// What a file holds: points, tetrahedra, lines, named arrays at the points and in the cells, of which lines are the last.
#[derive(Default)]
pub(super) struct Grid<'a> {
    /// Positions \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    /// Nodes of each tetrahedron, (m x 4).
    pub cells: &'a [[u32; 4]],
    /// How many points each line has, (l). Lines have the last points, in their order.
    pub lines: &'a [usize],
    /// Vectors at the points, (n x 3) each; the first is what ParaView takes for Warp By Vector.
    pub point_vectors: &'a [(&'a str, &'a [[f64; 3]])],
    /// Numbers at the points, (n) each.
    pub point_numbers: &'a [(&'a str, &'a [f64])],
    /// Whole numbers in the cells, (m + l) each.
    pub cell_integers: &'a [(&'a str, &'a [i64])],
    /// Three numbers in each cell, (m + l x 3).
    pub cell_vectors: &'a [(&'a str, &'a [[f64; 3]])],
    /// Numbers in the cells, (m + l) each.
    pub cell_numbers: &'a [(&'a str, &'a [f64])],
}

/// The whole file of a scene: points at rest, those of lines where they are; at them `displacement_m`, which lines have
/// none of, `fixed` (0 or 1), `radius_m` and `tension_n` of lines; in the cells `part` (0 tissue, 1 needle, 2 thread, 3 tool),
/// `id`, `region`, and where the model says it `principal_stress_pa` and `von_mises_pa`, which are 0 in lines.
pub fn vtu(drawn: &Drawn) -> String {
    let (nodes, cells) = (drawn.points_m.len(), drawn.cells.len());
    let of_lines = || drawn.lines.iter().flat_map(|line| &line.points_m);
    let points = nodes + of_lines().count();
    let points_m: Vec<_> = drawn.points_m.iter().chain(of_lines()).copied().collect();
    let mut displacement_m = drawn.displacement_m.clone();
    displacement_m.resize(points, [0.0; 3]);
    let mut fixed: Vec<f64> = drawn
        .fixed
        .iter()
        .map(|is| f64::from(u8::from(*is)))
        .collect();
    fixed.resize(points, 0.0);
    let (mut radius_m, mut tension_n) = (vec![0.0; nodes], vec![0.0; nodes]);
    let mut part = vec![0; cells];
    let mut id = vec![0; cells];
    for line in &drawn.lines {
        let end = radius_m.len() + line.points_m.len();
        radius_m.resize(end, line.radius_m);
        tension_n.extend(&line.tension_n);
        tension_n.resize(end, 0.0);
        part.push(line.part as i64);
        id.push(line.id.into());
    }
    let mut region = drawn.regions.clone();
    region.resize(part.len(), 0);
    let mut principal = drawn.principal_stress_pa.clone();
    let has_stress = principal.len() == cells;
    principal.resize(part.len(), [0.0; 3]);
    let von_mises: Vec<f64> = principal.iter().map(von_mises_pa).collect();
    let vectors = [("principal_stress_pa", principal.as_slice())];
    let numbers = [("von_mises_pa", von_mises.as_slice())];
    let stresses = usize::from(has_stress);
    grid(&Grid {
        points_m: &points_m,
        cells: &drawn.cells,
        lines: &drawn
            .lines
            .iter()
            .map(|line| line.points_m.len())
            .collect::<Vec<_>>(),
        point_vectors: &[("displacement_m", &displacement_m)],
        point_numbers: &[
            ("fixed", &fixed),
            ("radius_m", &radius_m),
            ("tension_n", &tension_n),
        ],
        cell_integers: &[("part", &part), ("id", &id), ("region", &region)],
        cell_vectors: &vectors[..stresses],
        cell_numbers: &numbers[..stresses],
    })
}

/// The whole file. Numbers are the shortest that read back to the same bits.
pub(super) fn grid(grid: &Grid<'_>) -> String {
    let (points, cells) = (grid.points_m, grid.cells);
    let mut xml = String::with_capacity(200 * points.len() + 150 * cells.len() + 1000);
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
            cells.len() + grid.lines.len()
        ),
    );
    if let Some((first, _)) = grid.point_vectors.first() {
        push(&mut xml, format_args!("<PointData Vectors=\"{first}\">\n"));
        for (name, rows) in grid.point_vectors {
            vectors(&mut xml, name, rows);
        }
        for (name, values) in grid.point_numbers {
            array(&mut xml, "Float64", name, values.iter());
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
    let on_lines = points.len() - grid.lines.iter().sum::<usize>();
    let of_cells = cells.iter().flatten().map(|node| *node as usize);
    let connectivity = of_cells.chain(on_lines..points.len());
    array(&mut xml, "Int64", "connectivity", connectivity);
    let counts = cells.iter().map(|_| 4).chain(grid.lines.iter().copied());
    let offsets = counts.scan(0, |end, count| {
        *end += count;
        Some(*end)
    });
    array(&mut xml, "Int64", "offsets", offsets);
    let types = cells.iter().map(|_| TETRA);
    let types = types.chain(grid.lines.iter().map(|_| POLY_LINE));
    array(&mut xml, "UInt8", "types", types);
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
    use crate::output::{Line, Part};

    /// Two tetrahedra, and a thread over them.
    fn two_cells() -> Drawn {
        Drawn {
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
            fixed: vec![true, false, false, false, false],
            cells: vec![[0, 1, 2, 3], [1, 2, 3, 4]],
            regions: vec![7, -3],
            principal_stress_pa: vec![[1e3 / 3.0, 0.0, -2e-5], [7.0, 4.0, 4.0]],
            lines: vec![Line {
                part: Part::Thread,
                id: 5,
                radius_m: 0.25e-3,
                points_m: vec![[0.0, 0.0, 0.2], [0.1, 0.0, 0.2], [0.2, 0.0, 1.0 / 9.0]],
                tension_n: vec![0.3, 1.0 / 7.0, 0.0],
            }],
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
        let drawn = two_cells();
        let text = vtu(&drawn);
        let document = roxmltree::Document::parse(&text).expect("well-formed XML");
        let root = document.root_element();
        assert_eq!(root.attribute("type"), Some("UnstructuredGrid"));
        let piece = document
            .descendants()
            .find(|n| n.has_tag_name("Piece"))
            .expect("a piece");
        assert_eq!(piece.attribute("NumberOfPoints"), Some("8"));
        assert_eq!(piece.attribute("NumberOfCells"), Some("3"));
        let thread = &drawn.lines[0];
        assert_eq!(
            numbers::<f64>(&document, "points_m"),
            [drawn.points_m.concat(), thread.points_m.concat()].concat()
        );
        assert_eq!(
            numbers::<f64>(&document, "displacement_m"),
            [drawn.displacement_m.concat(), vec![0.0; 9]].concat()
        );
        assert_eq!(
            numbers::<f64>(&document, "tension_n"),
            [vec![0.0; 5], thread.tension_n.clone()].concat()
        );
        assert_eq!(
            numbers::<f64>(&document, "radius_m"),
            [vec![0.0; 5], vec![0.25e-3; 3]].concat()
        );
        assert_eq!(
            numbers::<f64>(&document, "fixed"),
            [vec![1.0], vec![0.0; 7]].concat()
        );
        assert_eq!(
            numbers::<u32>(&document, "connectivity"),
            [drawn.cells.concat(), vec![5, 6, 7]].concat()
        );
        assert_eq!(numbers::<u32>(&document, "offsets"), [4, 8, 11]);
        assert_eq!(numbers::<u8>(&document, "types"), [TETRA, TETRA, POLY_LINE]);
        assert_eq!(numbers::<i64>(&document, "part"), [0, 0, 2]);
        assert_eq!(numbers::<i64>(&document, "id"), [0, 0, 5]);
        assert_eq!(numbers::<i64>(&document, "region"), [7, -3, 0]);
        let names = |of: &str| -> Vec<String> {
            let data = document.descendants().find(|n| n.has_tag_name(of));
            let arrays = data.into_iter().flat_map(|n| n.children());
            let names = arrays.filter_map(|n| n.attribute("Name"));
            names.map(str::to_owned).collect()
        };
        assert_eq!(
            names("CellData"),
            [
                "part",
                "id",
                "region",
                "principal_stress_pa",
                "von_mises_pa"
            ]
        );
        assert_eq!(
            numbers::<f64>(&document, "principal_stress_pa"),
            [drawn.principal_stress_pa.concat(), vec![0.0; 3]].concat()
        );
        let von_mises = numbers::<f64>(&document, "von_mises_pa");
        assert!(von_mises.len() == 3 && (von_mises[1] - 3.0).abs() < 1e-15);

        // A model without stresses has no arrays of them.
        let without = Drawn {
            principal_stress_pa: Vec::new(),
            ..drawn
        };
        assert!(!vtu(&without).contains("stress"));
    }
}
