//! Wavefront OBJ files: vertices, and faces of them; what else there is, such as normals and materials, is passed.
//!
//! Entry point: [`read_obj`]. Format: Wavefront, Advanced Visualizer manual, appendix B1.

use super::TriangleMesh;
use crate::MeshError;
use crate::read::{Coding, Kind, Scan};

/// Reads a file, in its own unit of length.
///
/// # Errors
/// A [`MeshError`] with the line of what cannot be read.
pub(super) fn read_obj(bytes: &[u8]) -> Result<TriangleMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Lines, Some(b'#'));
    let mut surface = TriangleMesh::default();
    let (mut faces, mut corners) = (0, Vec::new());
    while file.next_record() {
        match file.word("a keyword such as v or f")? {
            // A weight or a colour may follow.
            "v" => surface.points_m.push(file.point(Kind::F64)?),
            "f" => {
                corners.clear();
                while let Some(word) = file.next_word() {
                    match word {
                        // The line goes on in the next.
                        "\\" => file.next_line(),
                        word => corners.push(point(&file, word, surface.points_m.len())?),
                    }
                }
                surface.push_face(&file, faces, &corners)?;
                faces += 1;
            }
            word if word.starts_with(|c: char| c.is_ascii_alphabetic()) => {}
            word => return Err(file.expected("a keyword such as v or f", word)),
        }
        file.next_line();
    }
    Ok(surface)
}

/// The point of a corner, such as `7/2/3`: from 1, or back from the last so far, which is -1.
fn point(file: &Scan, word: &str, points: usize) -> Result<u32, MeshError> {
    let number = word
        .split('/')
        .next()
        .and_then(|number| number.parse::<i64>().ok());
    let index = match number {
        Some(number) if number > 0 => usize::try_from(number - 1).ok(),
        Some(number) => usize::try_from(number.unsigned_abs())
            .ok()
            .and_then(|back| points.checked_sub(back)),
        None => None,
    };
    let index = index
        .filter(|index| *index < points)
        .and_then(|index| u32::try_from(index).ok());
    index.ok_or_else(|| {
        file.expected(
            &format!("one of the {points} vertices so far, from 1"),
            word,
        )
    })
}
