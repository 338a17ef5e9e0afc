//! Reads medit's `.mesh` files: text, one-based, a reference after each vertex and cell.
//!
//! Entry point: [`read_medit`]. Format: Frey 2001, MEDIT, INRIA RT-0253; second-order cells as libMeshb has them.

use super::super::{MeshError, RawMesh};
use super::gather::{Gather, Shape};
use super::scan::{Coding, Kind, Scan};

/// Reads a file, in its own unit of length. A cell's region is its reference.
///
/// # Errors
/// A [`MeshError`] with the line of what cannot be read.
pub(super) fn read_medit(bytes: &[u8]) -> Result<RawMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Words, Some(b'#'));
    let mut gather = Gather::counted_from(1);
    let what = "MeshVersionFormatted as the first word; of a .meshb write the text form, .mesh";
    match file.word(what)? {
        "MeshVersionFormatted" => file.index(Kind::U64, "the version, a number")?,
        other => return Err(file.expected(what, other)),
    };
    let (mut has_vertices, mut has_cells) = (false, false);
    while let Some(keyword) = file.next_word() {
        match keyword {
            "Dimension" => {
                let dimension = file.index(Kind::U64, "the dimension, 3")?;
                if dimension != 3 {
                    return Err(file.expected("the dimension 3", &dimension.to_string()));
                }
            }
            "Vertices" => {
                once(&file, &mut has_vertices, "Vertices")?;
                for tag in 0..file.index(Kind::U64, "the number of vertices")? {
                    let point = file.point(Kind::F64)?;
                    file.region(Kind::I64, "the reference of a vertex")?;
                    gather.node(file.place(), tag, point)?;
                }
            }
            "Tetrahedra" => {
                once(&file, &mut has_cells, "Tetrahedra")?;
                cells(&mut file, &mut gather, Shape::Tetrahedron, 4)?;
            }
            "TetrahedraP2" => {
                once(&file, &mut has_cells, "Tetrahedra")?;
                cells(&mut file, &mut gather, Shape::Tetrahedron10, 10)?;
            }
            "Hexahedra" => cells(&mut file, &mut gather, Shape::Other("8-node hexahedron"), 0)?,
            "Prisms" => cells(&mut file, &mut gather, Shape::Other("6-node prism"), 0)?,
            "Pyramids" => cells(&mut file, &mut gather, Shape::Other("5-node pyramid"), 0)?,
            "Triangles" | "Quadrilaterals" | "Edges" => {
                let count = file.index(Kind::U64, "the number of faces or edges")?;
                gather.left_out = gather
                    .left_out
                    .saturating_add(usize::try_from(count).unwrap_or(usize::MAX));
                skip_numbers(&mut file);
            }
            "End" => break,
            other if other.starts_with(|c: char| c.is_ascii_alphabetic()) => {
                skip_numbers(&mut file);
            }
            other => return Err(file.expected("a keyword such as Vertices or Tetrahedra", other)),
        }
    }
    if !has_vertices {
        return Err(MeshError::NoSection("Vertices"));
    }
    if !has_cells {
        return Err(MeshError::NoSection("Tetrahedra"));
    }
    gather.into_mesh()
}

fn once(file: &Scan, has: &mut bool, section: &'static str) -> Result<(), MeshError> {
    match std::mem::replace(has, true) {
        true => Err(MeshError::SecondSection {
            at: file.place(),
            section,
        }),
        false => Ok(()),
    }
}

fn cells(
    file: &mut Scan,
    gather: &mut Gather,
    shape: Shape,
    corners: usize,
) -> Result<(), MeshError> {
    let mut nodes = [0; 10];
    let nodes = &mut nodes[..corners];
    for tag in 0..file.index(Kind::U64, "the number of cells")? {
        for node in &mut *nodes {
            *node = file.index(Kind::U64, "a node of a cell")?;
        }
        let region = match corners {
            0 => 0,
            _ => file.region(Kind::I64, "the reference of a cell")?,
        };
        gather.cell(file.place(), tag + 1, (shape, "of medit"), region, nodes)?;
    }
    Ok(())
}

/// Goes on to the next keyword.
fn skip_numbers(file: &mut Scan) {
    loop {
        let before = file.clone();
        match file.next_word() {
            Some(word) if word.starts_with(|c: char| c.is_ascii_alphabetic()) => {
                *file = before;
                return;
            }
            Some(_) => {}
            None => return,
        }
    }
}
