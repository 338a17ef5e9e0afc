//! STL files, ASCII and binary.
//!
//! Entry point: [`read_stl`]. A binary file's title may begin as an ASCII file does: its size tells. Numbers are of 32 bits in
//! both.

use super::TriangleMesh;
use crate::MeshError;
use crate::read::{Coding, Endian, Kind, Scan};
use std::collections::HashMap;

/// Bytes of a binary file before its triangles, a title and their number, and of each of these.
const HEAD: usize = 84;
const TRIANGLE: usize = 50;
/// Bytes of a title.
const TITLE: usize = 80;

/// Reads a file, in its own unit of length. Corners at the very same place are one point, as the format has no other way to
/// say so. Normals are not looked at.
///
/// # Errors
/// A [`MeshError`] with the line or byte of what cannot be read.
pub(super) fn read_stl(bytes: &[u8]) -> Result<TriangleMesh, MeshError> {
    let count = bytes
        .get(TITLE..HEAD)
        .and_then(|count| count.try_into().ok());
    let count = count.map(u32::from_le_bytes);
    let size = count.map(|count| HEAD as u64 + TRIANGLE as u64 * u64::from(count));
    // No text has a byte that is zero, but after its end.
    let padding = bytes.iter().rev().take_while(|byte| **byte == 0).count();
    let text = &bytes[..bytes.len() - padding];
    let word = text.trim_ascii_start().get(..5);
    let is_text =
        word.is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) && !text.contains(&0);
    match count {
        Some(count) if size == Some(bytes.len() as u64) => binary(bytes, count),
        _ if is_text => ascii(text),
        Some(count) => Err(MeshError::WrongSize {
            count,
            size: size.unwrap_or_default(),
            found: bytes.len() as u64,
        }),
        None => Err(Scan::new(bytes, Coding::Words, None).expected(
            "an STL file: `solid` as the first word, or 84 bytes before the triangles",
            &String::from_utf8_lossy(bytes),
        )),
    }
}

fn binary(bytes: &[u8], count: u32) -> Result<TriangleMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Binary(Endian::Little), None);
    file.take(HEAD, "the number of triangles")?;
    let mut facets = Facets::default();
    let what = format!("50 bytes for each of {count} triangles");
    for _ in 0..count {
        let numbers = file.take(TRIANGLE, &what)?;
        let number = |k: usize| Kind::F32.read(&numbers[4 * k..], Endian::Little).real() as f32;
        facets.push([3, 6, 9].map(|k| [k, k + 1, k + 2].map(number)));
    }
    Ok(facets.surface)
}

fn ascii(bytes: &[u8]) -> Result<TriangleMesh, MeshError> {
    let mut file = Scan::new(bytes, Coding::Words, None);
    let mut facets = Facets::default();
    // Of several solids in a file each has a name, or none.
    while file.next_record() {
        keyword(&mut file, "solid")?;
        file.next_line();
        while is_facet(&mut file)? {
            for word in ["normal", "", "", "", "outer", "loop"] {
                match word {
                    "" => _ = file.word("the normal, three numbers")?,
                    word => keyword(&mut file, word)?,
                }
            }
            let mut corners = [[0.0f32; 3]; 3];
            for corner in &mut corners {
                keyword(&mut file, "vertex")?;
                for x in corner {
                    let word = file.word("three coordinates")?;
                    let what = |_| file.expected("three coordinates", word);
                    *x = word.parse().map_err(what)?;
                }
            }
            keyword(&mut file, "endloop")?;
            keyword(&mut file, "endfacet")?;
            facets.push(corners);
        }
        file.next_line();
    }
    Ok(facets.surface)
}

fn keyword(file: &mut Scan, keyword: &str) -> Result<(), MeshError> {
    match file.word(keyword)? {
        word if word.eq_ignore_ascii_case(keyword) => Ok(()),
        word => Err(file.expected(keyword, word)),
    }
}

/// Whether another facet begins; else the solid has ended.
fn is_facet(file: &mut Scan) -> Result<bool, MeshError> {
    let what = "facet or endsolid";
    match file.word(what)?.to_ascii_lowercase().as_str() {
        "facet" => Ok(true),
        "endsolid" => Ok(false),
        word => Err(file.expected(what, word)),
    }
}

/// Triangles whose corners are found again by their places.
#[derive(Default)]
struct Facets {
    surface: TriangleMesh,
    numbers: HashMap<[u32; 3], u32>,
    count: u32,
}

impl Facets {
    fn push(&mut self, corners: [[f32; 3]; 3]) {
        let points_m = &mut self.surface.points_m;
        let corners = corners.map(|at| {
            // Without the sign of zero.
            let at = at.map(|x| x + 0.0);
            *self.numbers.entry(at.map(f32::to_bits)).or_insert_with(|| {
                points_m.push(at.map(f64::from));
                points_m.len() as u32 - 1
            })
        });
        self.surface.triangles.push(corners);
        self.surface.faces.push(self.count);
        self.count += 1;
    }
}
