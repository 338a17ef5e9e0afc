//! Reads tetgen's `.node` and `.ele` files: tetrahedra of four or ten nodes and their region attribute.
//!
//! Entry point: [`read_tetgen`]. Format: Si 2015, TetGen user's manual, chapter 5.

use super::super::{MeshError, RawMesh, signed_volume};
use super::gather::{Gather, Shape};
use super::scan::{Coding, Kind, Scan};
use nalgebra::Vector3;

/// Reads a `.node` and an `.ele` file, in the file's own unit of length. Nodes and cells
/// are in the files' order, whatever their numbers. Of several attributes the last is the region: tetgen appends it.
///
/// A mesh of which *every* cell is inverted is written the other way round: its cells are turned.
///
/// # Errors
/// [`MeshError::InFile`], with the extension and the line of what cannot be read.
pub(super) fn read_tetgen(node: &[u8], ele: &[u8]) -> Result<RawMesh, MeshError> {
    let within = |file: &str| {
        let file = file.to_owned();
        move |error| MeshError::InFile {
            file,
            error: Box::new(error),
        }
    };
    let mut gather = Gather::numbered();
    read_nodes(node, &mut gather).map_err(within(".node"))?;
    read_cells(ele, &mut gather).map_err(within(".ele"))?;
    let mut mesh = gather.into_mesh().map_err(within(".ele"))?;
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

/// The first row of a file.
fn head<const N: usize>(file: &mut Scan, what: &str) -> Result<[u64; N], MeshError> {
    file.record(what)?;
    let mut values = [0; N];
    for value in &mut values {
        *value = file.index(Kind::U64, what)?;
    }
    file.end_record(what)?;
    Ok(values)
}

fn read_nodes(bytes: &[u8], gather: &mut Gather) -> Result<(), MeshError> {
    let what = "number of nodes, dimension 3, number of attributes, 0 or 1 marker";
    let mut file = Scan::new(bytes, Coding::Lines, Some(b'#'));
    let [count, dimension, attributes, markers] = head::<4>(&mut file, what)?;
    if dimension != 3 {
        return Err(file.expected(what, &dimension.to_string()));
    }
    let what = "a node: number x y z, then its attributes and marker";
    for _ in 0..count {
        file.record(what)?;
        let at = file.place();
        let tag = file.index(Kind::U64, what)?;
        let point = file.point(Kind::F64)?;
        for _ in 0..attributes.saturating_add(markers) {
            file.real(Kind::F64, what)?;
        }
        file.end_record(what)?;
        gather.node(at, tag, point)?;
    }
    no_more(&mut file)
}

fn read_cells(bytes: &[u8], gather: &mut Gather) -> Result<(), MeshError> {
    let what = "number of tetrahedra, 4 or 10 nodes each, number of attributes";
    let mut file = Scan::new(bytes, Coding::Lines, Some(b'#'));
    let [count, corners, attributes] = head::<3>(&mut file, what)?;
    let shape = match corners {
        4 => Shape::Tetrahedron,
        10 => Shape::Tetrahedron10,
        other => return Err(file.expected(what, &other.to_string())),
    };
    let what = "a tetrahedron: number, its nodes, then its attributes";
    let mut nodes = [0; 10];
    let nodes = &mut nodes[..corners as usize];
    for _ in 0..count {
        file.record(what)?;
        let at = file.place();
        let tag = file.index(Kind::U64, what)?;
        for node in &mut *nodes {
            *node = file.index(Kind::U64, what)?;
        }
        let mut region = 0;
        for attribute in 1..=attributes {
            region = match attribute == attributes {
                true => file.region(Kind::F64, "the region of a tetrahedron")?,
                false => file.real(Kind::F64, what).map(|_| 0)?,
            };
        }
        file.end_record(what)?;
        gather.cell(at, tag, (shape, "tetrahedron"), region, nodes)?;
    }
    no_more(&mut file)
}

fn no_more(file: &mut Scan) -> Result<(), MeshError> {
    if !file.next_record() {
        return Ok(());
    }
    let word = file.word("the end of the file")?;
    Err(file.expected("the end of the file, as the count says", word))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: &str = "# made by hand\n5 3 0 1\n1 0 0 0 1\n2 1 0 0 1 # a comment\n\n3 0 1 0 1\n4 0 0 1 1\n5 1 1 1 0\n";
    const ELE: &str = "2 4 1\n1 1 2 3 4 7\n2 2 3 4 5 -8.0\n# end\n";

    #[test]
    fn nodes_cells_and_regions_are_read() {
        let mesh = read_tetgen(NODE.as_bytes(), ELE.as_bytes()).expect("a sound mesh");
        assert_eq!(mesh.points_m[4], [1.0, 1.0, 1.0]);
        assert_eq!(mesh.cells, [[0, 1, 2, 3], [1, 2, 3, 4]]);
        assert_eq!(mesh.regions, [7, -8]);
        let from_zero = read_tetgen(
            b"4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n",
            b"1 4 0\n0 0 1 3 2\n",
        );
        let mesh = from_zero.expect("counted from 0");
        assert_eq!(mesh.regions, [0]);
        assert!(mesh.check().is_ok(), "all inverted: turned");
    }

    #[test]
    fn errors_name_the_file_and_the_line() {
        let refused = |node: &str, ele: &str, said: &[&str]| {
            let error = read_tetgen(node.as_bytes(), ele.as_bytes())
                .expect_err("bad files")
                .to_string();
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
        refused(NODE, &ELE.replace("2 4 1", "2 8 1"), &[".ele", "line 1"]);
        refused(
            NODE,
            &ELE.replace("-8.0", "8.5"),
            &["line 3", "whole number"],
        );
    }
}
