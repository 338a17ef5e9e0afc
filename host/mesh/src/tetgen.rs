//! Reads tetgen's `.node` and `.ele` files: first-order tetrahedra and their region attribute.
//!
//! Entry point: [`read_tetgen`]. Format: Si 2015, TetGen user's manual, chapter 5.

use super::lines::Lines;
use super::{CellId, MeshError, RawMesh, signed_volume};
use nalgebra::Vector3;
use std::collections::HashMap;

/// Reads the texts of a `.node` and an `.ele` file, in the file's own unit of length. Nodes and cells
/// are in the files' order, whatever their numbers.
///
/// A mesh of which *every* cell is inverted is written the other way round: its cells are turned.
///
/// # Errors
/// [`MeshError::InFile`], with the extension and the line of what cannot be read.
pub fn read_tetgen(node: &str, ele: &str) -> Result<RawMesh, MeshError> {
    let within = |file: &str| {
        let file = file.to_owned();
        move |error| MeshError::InFile {
            file,
            error: Box::new(error),
        }
    };
    let mut mesh = RawMesh::default();
    let mut index_of = HashMap::new();
    read_nodes(node, &mut mesh, &mut index_of).map_err(within(".node"))?;
    read_cells(ele, &mut mesh, &index_of).map_err(within(".ele"))?;
    let volume = |cell: &[u32; 4]| {
        signed_volume(&cell.map(|node| Vector3::from(mesh.points_m[node as usize])))
    };
    if mesh.cells.iter().all(|cell| volume(cell) < 0.0) {
        for cell in &mut mesh.cells {
            cell.swap(2, 3);
        }
    }
    Ok(mesh)
}

fn read_nodes(
    text: &str,
    mesh: &mut RawMesh,
    index_of: &mut HashMap<u64, u32>,
) -> Result<(), MeshError> {
    let what = "number of nodes, dimension 3, number of attributes, 0 or 1 marker";
    let mut lines = Lines::new(text);
    let head = lines.next_row(what)?;
    let [count, 3, attributes, markers] = lines.row::<4>(head, what)? else {
        return Err(lines.expected(what, head));
    };
    let what = "a node: number x y z, then its attributes and marker";
    for index in 0..count {
        let line = lines.next_row(what)?;
        let mut words = words(line);
        let tag = lines.integer(words.next(), line, what)?;
        let at = lines.point(&mut words, line)?;
        if words.count() as u64 != attributes.saturating_add(markers) {
            return Err(lines.expected(what, line));
        }
        let index = u32::try_from(index).map_err(|_| MeshError::TooManyNodes(count as usize))?;
        if index_of.insert(tag, index).is_some() {
            return Err(MeshError::NodeTagTwice {
                line: lines.number,
                tag,
            });
        }
        mesh.points_m.push(at);
        mesh.tags.nodes.push(tag);
    }
    lines.no_more_rows()
}

fn read_cells(
    text: &str,
    mesh: &mut RawMesh,
    index_of: &HashMap<u64, u32>,
) -> Result<(), MeshError> {
    let what = "number of tetrahedra, 4 nodes each, 0 or 1 attribute";
    let mut lines = Lines::new(text);
    let head = lines.next_row(what)?;
    let [count, 4, attributes @ 0..=1] = lines.row::<3>(head, what)? else {
        return Err(lines.expected(what, head));
    };
    let what = "a tetrahedron: number, four nodes, then its attribute";
    for index in 0..count as usize {
        let line = lines.next_row(what)?;
        let mut words = words(line);
        let tag = lines.integer(words.next(), line, what)?;
        let mut cell = [0; 4];
        for place in &mut cell {
            let node = lines.integer(words.next(), line, what)?;
            *place = *index_of.get(&node).ok_or(MeshError::NoSuchNode {
                cell: CellId {
                    index,
                    tag: Some(tag),
                },
                node,
                nodes: mesh.points_m.len(),
            })?;
        }
        let region = match (attributes, words.next()) {
            (0, None) => 0,
            (1, Some(word)) => lines.region(word, line)?,
            _ => return Err(lines.expected(what, line)),
        };
        if words.next().is_some() {
            return Err(lines.expected(what, line));
        }
        mesh.cells.push(cell);
        mesh.regions.push(region);
        mesh.tags.cells.push(tag);
    }
    lines.no_more_rows()
}

/// The words of a line before its comment.
fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split('#').next().unwrap_or("").split_whitespace()
}

impl<'a> Lines<'a> {
    /// The next line that has more than a comment.
    fn next_row(&mut self, what: &str) -> Result<&'a str, MeshError> {
        loop {
            let line = self.next(what)?;
            if !line.starts_with('#') {
                return Ok(line);
            }
        }
    }

    fn row<const N: usize>(&self, line: &str, what: &str) -> Result<[u64; N], MeshError> {
        let mut words = words(line);
        let mut values = [0; N];
        for value in &mut values {
            *value = self.integer(words.next(), line, what)?;
        }
        match words.next() {
            None => Ok(values),
            Some(_) => Err(self.expected(what, line)),
        }
    }

    fn no_more_rows(&mut self) -> Result<(), MeshError> {
        while let Some(line) = self.next_filled() {
            if !line.starts_with('#') {
                return Err(self.expected("the end of the file, as the count says", line));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: &str = "# made by hand\n5 3 0 1\n1 0 0 0 1\n2 1 0 0 1 # a comment\n\n3 0 1 0 1\n4 0 0 1 1\n5 1 1 1 0\n";
    const ELE: &str = "2 4 1\n1 1 2 3 4 7\n2 2 3 4 5 -8.0\n# end\n";

    #[test]
    fn nodes_cells_and_regions_are_read() {
        let mesh = read_tetgen(NODE, ELE).expect("a sound mesh");
        assert_eq!(mesh.points_m[4], [1.0, 1.0, 1.0]);
        assert_eq!(mesh.cells, [[0, 1, 2, 3], [1, 2, 3, 4]]);
        assert_eq!(mesh.regions, [7, -8]);
        let from_zero = read_tetgen(
            "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n",
            "1 4 0\n0 0 1 3 2\n",
        );
        let mesh = from_zero.expect("counted from 0");
        assert_eq!(mesh.regions, [0]);
        assert!(mesh.check().is_ok(), "all inverted: turned");
    }

    #[test]
    fn errors_name_the_file_and_the_line() {
        let refused = |node: &str, ele: &str, said: &[&str]| {
            let error = read_tetgen(node, ele).expect_err("bad files").to_string();
            for words in said {
                assert!(error.contains(words), "no {words} in: {error}");
            }
        };
        refused("2 2 0 0\n", ELE, &[".node", "line 1", "dimension 3"]);
        refused(
            &NODE.replace("1 0 0 1 #", "1 0 x 1 #"),
            ELE,
            &[".node", "line 4"],
        );
        refused(&NODE.replace("5 3", "6 3"), ELE, &["line 9", "cut off"]);
        refused(
            &NODE.replace("5 3", "4 3"),
            ELE,
            &["line 8", "end of the file"],
        );
        refused(
            &NODE.replace("5 1 1", "4 1 1"),
            ELE,
            &["node 4 is given twice"],
        );
        refused(
            NODE,
            &ELE.replace("4 5 -8", "4 6 -8"),
            &["element 2", "node 6"],
        );
        refused(NODE, &ELE.replace("2 4 1", "2 10 1"), &[".ele", "line 1"]);
        refused(
            NODE,
            &ELE.replace("-8.0", "8.5"),
            &["line 3", "whole number"],
        );
    }
}
