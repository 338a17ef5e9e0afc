//! STL files, binary and ASCII, as closed surfaces.
//!
//! Entry point: [`read_stl`].

use super::closed_mesh::{ClosedMesh, MOST_TRIANGLES, MeshFlaw};
use std::collections::HashMap;
use std::io::Cursor;

/// Bytes of a binary file's title, of what is before its triangles, and of each of these.
const TITLE: usize = 80;
const HEAD: usize = 84;
const TRIANGLE: usize = 50;

/// The surface in a file's `bytes`, whose unit is `scale_to_m` metres. Corners at the very same place are one point,
/// triangles that have but two corners are left out, and the file's normals are not looked at.
///
/// # Errors
/// [`MeshFlaw::Garbled`] for what is no STL, else what keeps its triangles from being one closed surface.
pub fn read_stl(bytes: &[u8], scale_to_m: f64) -> Result<ClosedMesh, MeshFlaw> {
    let garbled = |error: std::io::Error| MeshFlaw::Garbled(error.to_string());
    let mut file = Cursor::new(without_title(bytes));
    let mut points_m: Vec<[f64; 3]> = Vec::new();
    let mut triangles = Vec::new();
    let mut numbers = HashMap::new();
    for triangle in stl_io::create_stl_reader(&mut file).map_err(garbled)? {
        let vertices = triangle.map_err(garbled)?.vertices;
        let corners = vertices.map(|vertex| {
            // Without the sign of zero.
            let at = vertex.0.map(|x| x + 0.0);
            *numbers.entry(at.map(f32::to_bits)).or_insert_with(|| {
                points_m.push(at.map(|x| f64::from(x) * scale_to_m));
                points_m.len() as u32 - 1
            })
        });
        let [a, b, c] = corners;
        if a != b && b != c && c != a {
            triangles.push(corners);
        }
        if triangles.len() > MOST_TRIANGLES {
            return Err(MeshFlaw::TooMany);
        }
    }
    ClosedMesh::new(&points_m, &triangles)
}

/// A binary file without its title, which may begin like an ASCII file's.
fn without_title(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let count = bytes
        .get(TITLE..HEAD)
        .and_then(|count| count.try_into().ok());
    let count = count.map(|count| u32::from_le_bytes(count) as usize);
    if count.is_some_and(|count| bytes.len() == HEAD + TRIANGLE * count) {
        bytes[..TITLE].fill(0);
    }
    bytes
}
