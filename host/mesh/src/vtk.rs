//! Reads legacy `.vtk` files: ASCII unstructured grids, of whose cells the tetrahedra are taken.
//!
//! Entry point: [`read_vtk`]. Format: VTK File Formats 4.2, "Simple Legacy Formats", and the
//! `OFFSETS`/`CONNECTIVITY` cells of version 5.

use super::lines::Lines;
use super::{CellId, MeshError, RawMesh};

/// VTK's number for a linear tetrahedron.
const TETRA: u64 = 10;

/// Names under which programs write the region of a cell: this one's, gmsh's, meshio's, pyvista's.
const REGION_NAMES: [&str; 6] = [
    "region",
    "regions",
    "CellEntityIds",
    "gmsh:physical",
    "medit:ref",
    "material",
];

/// Reads the text of a file, in the file's own unit of length.
///
/// Points, lines and faces are left out; a cell array named `region`, `CellEntityIds`, `gmsh:physical`,
/// `medit:ref` or `material` gives the regions.
///
/// # Errors
/// A [`MeshError`] with the line; volume cells other than tetrahedra are refused.
pub fn read_vtk(text: &str) -> Result<RawMesh, MeshError> {
    let mut lines = Lines::new(text);
    let head = lines.next("# vtk DataFile Version")?;
    if !head.starts_with("# vtk DataFile Version") {
        return Err(lines.expected("# vtk DataFile Version", head));
    }
    lines.skip_one();
    let encoding = lines.next("ASCII")?;
    if encoding != "ASCII" {
        return Err(lines.expected("ASCII; write the file again without binary", encoding));
    }
    let mut words = Words {
        lines,
        line: "",
        rest: "".split_whitespace(),
    };
    words.keyword("DATASET")?;
    words.keyword("UNSTRUCTURED_GRID")?;
    let mut grid = Grid::default();
    while let Some(word) = words.next_word() {
        match word {
            "POINTS" => {
                let count = words.count()?;
                words.next("a type such as double")?;
                for _ in 0..count {
                    let mut at = [0.0; 3];
                    for x in &mut at {
                        *x = words.number("a coordinate")?;
                    }
                    grid.points.push(at);
                }
            }
            "CELLS" => grid.read_cells(&mut words)?,
            "CELL_TYPES" => {
                for _ in 0..words.count()? {
                    let kind = words.count()?;
                    grid.kinds.push((kind, words.lines.number));
                }
            }
            "CELL_DATA" => {
                grid.read_regions(&mut words)?;
                break;
            }
            "POINT_DATA" => {
                if words.skip_to("CELL_DATA") {
                    grid.read_regions(&mut words)?;
                }
                break;
            }
            // A paragraph about the arrays before it, up to a blank line.
            "METADATA" => words.skip_paragraph(),
            // `FIELD` of the whole data set: names, counts and values, nothing that is needed here.
            "FIELD" => {
                if !words.skip_to("POINTS") {
                    break;
                }
                words.unread("POINTS");
            }
            other => {
                return Err(words
                    .lines
                    .expected("POINTS, CELLS, CELL_TYPES, CELL_DATA or POINT_DATA", other));
            }
        }
    }
    grid.into_mesh(words.lines.number)
}

#[derive(Default)]
struct Grid {
    points: Vec<[f64; 3]>,
    /// Nodes of every cell one after another, and where each ends.
    nodes: Vec<u64>,
    ends: Vec<usize>,
    kinds: Vec<(u64, usize)>,
    regions: Vec<i64>,
}

impl Grid {
    fn read_cells(&mut self, words: &mut Words<'_>) -> Result<(), MeshError> {
        let (count, size) = (words.count()?, words.count()?);
        let first = words.next("a cell, or OFFSETS")?;
        if first == "OFFSETS" {
            words.next("a type such as vtktypeint64")?;
            for index in 0..count {
                let end = words.count()? as usize;
                if end < self.ends.last().copied().unwrap_or(0) {
                    return Err(words.lines.expected("offsets that ascend", words.line));
                }
                if index > 0 {
                    self.ends.push(end);
                }
            }
            words.keyword("CONNECTIVITY")?;
            words.next("a type such as vtktypeint64")?;
            for _ in 0..size {
                let node = words.count()?;
                self.nodes.push(node);
            }
        } else {
            let mut length = words.integer(first)?;
            for index in 0..count {
                if index > 0 {
                    length = words.count()?;
                }
                for _ in 0..length {
                    let node = words.count()?;
                    self.nodes.push(node);
                }
                self.ends.push(self.nodes.len());
            }
        }
        Ok(())
    }

    /// Looks for an array of [`REGION_NAMES`] in what is left of the file: `SCALARS name type`, then
    /// `LOOKUP_TABLE name`; or in a `FIELD` the line `name 1 count type`.
    fn read_regions(&mut self, words: &mut Words<'_>) -> Result<(), MeshError> {
        words.rest = "".split_whitespace(); // the count of cells, known already
        while let Some(line) = words.lines.next_filled() {
            let head: Vec<&str> = line.split_whitespace().collect();
            match head[..] {
                ["POINT_DATA", ..] => break,
                ["SCALARS", name, _, ..] if REGION_NAMES.contains(&name) => {
                    words.keyword("LOOKUP_TABLE")?;
                    words.next("the table's name")?;
                }
                [name, "1", _, _] if REGION_NAMES.contains(&name) => {}
                _ => continue,
            }
            for _ in 0..self.kinds.len() {
                let word = words.next("a cell's region")?;
                let region = words.lines.region(word, words.line)?;
                self.regions.push(region);
            }
            break;
        }
        Ok(())
    }

    fn into_mesh(self, last_line: usize) -> Result<RawMesh, MeshError> {
        if self.kinds.len() != self.ends.len() {
            return Err(MeshError::Syntax {
                line: last_line,
                expected: format!("a type for each of {} cells", self.ends.len()),
                found: format!("{} types", self.kinds.len()),
            });
        }
        let mut mesh = RawMesh::default();
        let mut start = 0;
        for (index, (&(kind, line), &end)) in self.kinds.iter().zip(&self.ends).enumerate() {
            let nodes = self.nodes.get(start..end).unwrap_or(&[]);
            start = end;
            if kind != TETRA {
                // Points, lines, polygons, and their curved kinds.
                if !matches!(kind, 0..=9 | 21..=23 | 28 | 30 | 34 | 35 | 68..=70) {
                    return Err(MeshError::VtkCell { line, index, kind });
                }
                continue;
            }
            let &[a, b, c, d] = nodes else {
                return Err(MeshError::Syntax {
                    line,
                    expected: format!("four nodes for cell {index}, a tetrahedron"),
                    found: format!("{} nodes", nodes.len()),
                });
            };
            let mut cell = [0; 4];
            for (place, node) in cell.iter_mut().zip([a, b, c, d]) {
                *place = u32::try_from(node)
                    .ok()
                    .filter(|node| (*node as usize) < self.points.len())
                    .ok_or(MeshError::NoSuchNode {
                        cell: CellId {
                            index: mesh.cells.len(),
                            tag: Some(index as u64),
                        },
                        node,
                        nodes: self.points.len(),
                    })?;
            }
            mesh.cells.push(cell);
            mesh.tags.cells.push(index as u64);
            mesh.regions
                .push(self.regions.get(index).copied().unwrap_or(0));
        }
        mesh.points_m = self.points;
        Ok(mesh)
    }
}

/// Words of a file, across its lines.
struct Words<'a> {
    lines: Lines<'a>,
    line: &'a str,
    rest: std::str::SplitWhitespace<'a>,
}

impl<'a> Words<'a> {
    fn next_word(&mut self) -> Option<&'a str> {
        loop {
            if let Some(word) = self.rest.next() {
                return Some(word);
            }
            self.line = self.lines.next_filled()?;
            self.rest = self.line.split_whitespace();
        }
    }

    /// Makes `word`, the first of the current line, the next one again.
    fn unread(&mut self, word: &str) {
        self.rest = self.line.split_whitespace();
        debug_assert!(self.line.starts_with(word));
    }

    fn next(&mut self, what: &str) -> Result<&'a str, MeshError> {
        self.next_word().ok_or_else(|| MeshError::Truncated {
            line: self.lines.number,
            expected: what.into(),
        })
    }

    fn keyword(&mut self, keyword: &str) -> Result<(), MeshError> {
        match self.next(keyword)? {
            word if word == keyword => Ok(()),
            word => Err(self.lines.expected(keyword, word)),
        }
    }

    fn integer(&self, word: &str) -> Result<u64, MeshError> {
        self.lines.integer(Some(word), word, "a number from 0 up")
    }

    fn count(&mut self) -> Result<u64, MeshError> {
        let word = self.next("a number from 0 up")?;
        self.integer(word)
    }

    fn number(&mut self, what: &str) -> Result<f64, MeshError> {
        let word = self.next(what)?;
        word.parse().map_err(|_| self.lines.expected(what, word))
    }

    /// Goes on to the line that begins with `keyword`, after which it stands; `false` at the end.
    fn skip_to(&mut self, keyword: &str) -> bool {
        while let Some(line) = self.lines.next_filled() {
            self.line = line;
            self.rest = line.split_whitespace();
            if self.rest.next() == Some(keyword) {
                return true;
            }
        }
        false
    }

    fn skip_paragraph(&mut self) {
        self.rest = "".split_whitespace();
        self.lines.skip_past_blank();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: &str = "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n0 0 0 1 0 0\n0 1 0 0 0 1\n1 1 1\n\
        CELLS 3 14\n3 0 1 2\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 3\n5\n10\n10\n";
    const NEW: &str = "# vtk DataFile Version 5.1\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0\n0 0 1 1 1 1\n\nMETADATA\nINFORMATION 0\n\n\
        CELLS 4 11\nOFFSETS vtktypeint64\n0 3 7 11\nCONNECTIVITY vtktypeint64\n0 1 2 0 1 2 3\n1 2 3 4\nCELL_TYPES 3\n5\n10\n10\n";

    #[test]
    fn both_kinds_of_cells_are_read() {
        for text in [OLD, NEW] {
            let mesh = read_vtk(text).expect("a sound mesh");
            assert_eq!(mesh.points_m[3], [0.0, 0.0, 1.0]);
            assert_eq!(
                mesh.cells,
                [[0, 1, 2, 3], [1, 2, 3, 4]],
                "the triangle is left out"
            );
            assert_eq!(mesh.regions, [0, 0]);
            assert!(mesh.check().is_ok());
        }
    }

    #[test]
    fn regions_are_found_in_scalars_and_fields() {
        let scalars = "CELL_DATA 3\nSCALARS pressure float 1\nLOOKUP_TABLE default\n1 2 3\nSCALARS CellEntityIds int 1\nLOOKUP_TABLE default\n9\n7 8\n";
        let field = "POINT_DATA 5\nSCALARS region int\nLOOKUP_TABLE default\n1 1 1 1 1\nCELL_DATA 3\nFIELD FieldData 2\nid 1 3 int\n4 5 6\nregion 1 3 double\n9 7.0 8\n";
        for data in [scalars, field] {
            let mesh = read_vtk(&format!("{OLD}{data}")).expect("a sound mesh");
            assert_eq!(mesh.regions, [7, 8]);
        }
    }

    #[test]
    fn errors_name_the_line() {
        let refused = |text: &str, said: &[&str]| {
            let error = read_vtk(text).expect_err("a bad file").to_string();
            for words in said {
                assert!(error.contains(words), "no {words} in: {error}");
            }
        };
        refused("solid\n", &["line 1", "# vtk DataFile Version"]);
        refused(&OLD.replace("ASCII", "BINARY"), &["line 3", "ASCII"]);
        refused(&OLD.replace("1 1 1\n", "1 x 1\n"), &["line 8", "`x`"]);
        refused(
            &OLD.replace("5\n10\n10\n", "5\n10\n12\n"),
            &["line 16", "type 12"],
        );
        refused(
            &OLD.replace("5\n10\n10\n", "5\n10\n"),
            &["line 16", "cut off"],
        );
        refused(
            &OLD.replace("4 1 2 3 4\n", "4 1 2 3 9\n"),
            &["node 9", "5 nodes"],
        );
        refused(&OLD.replace("UNSTRUCTURED_GRID", "POLYDATA"), &["line 4"]);
        refused(&NEW.replace("0 3 7 11", "0 7 3 11"), &["line 14", "ascend"]);
        let data = "CELL_DATA 3\nSCALARS region int\nLOOKUP_TABLE default\n1 2\n";
        refused(&format!("{OLD}{data}"), &["a cell's region", "cut off"]);
    }
}
