//! The boundary of a mesh as a compact half-edge structure: level 3 of [`HalfFaces`].
//!
//! Entry point: [`HalfFaces::boundary`]. Source: Younes 2021, section 2.1.3. Half-edge `3 k + i` of
//! triangle k runs opposite its corner i, from corner i + 1 to corner i + 2.

use super::half_face::{HalfEdge, HalfFace};
use super::half_faces::HalfFaces;

/// A side of a boundary triangle, `3 triangle + corner` with the corner that it lies opposite to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Side(u32);

impl Side {
    const fn of(triangle: usize, corner: usize) -> Self {
        Self((3 * triangle + corner % 3) as u32)
    }

    /// The triangle that it belongs to, by its place in [`Boundary::triangles`].
    pub const fn triangle(self) -> usize {
        (self.0 / 3) as usize
    }

    /// The corner of the triangle that it lies opposite to, 0 to 2.
    pub const fn corner(self) -> usize {
        (self.0 % 3) as usize
    }

    /// The side after it, counter-clockwise seen from outside.
    pub const fn next(self) -> Self {
        Self::of(self.triangle(), self.corner() + 1)
    }

    /// The side before it.
    pub const fn previous(self) -> Self {
        Self::of(self.triangle(), self.corner() + 2)
    }
}

/// The closed surface around a mesh.
#[derive(Clone, Debug)]
pub struct Boundary {
    half_faces: Vec<HalfFace>,
    triangles: Vec<[u32; 3]>,
    opposite: Vec<Side>,
    vertices: Vec<u32>,
    /// For each entry of `vertices` a side that starts there.
    leaving: Vec<Side>,
}

impl Boundary {
    pub(super) fn of(mesh: &HalfFaces) -> Self {
        let half_faces: Vec<HalfFace> = mesh
            .half_faces()
            .filter(|face| mesh.opposite(*face).is_none())
            .collect();
        let triangles: Vec<[u32; 3]> = half_faces.iter().map(|f| mesh.vertices(*f)).collect();
        let mut opposite = Vec::with_capacity(3 * half_faces.len());
        for face in &half_faces {
            let [ab, bc, ca] = face.half_edges();
            // A face's half-edges begin with corner 0; side i lies opposite corner i.
            for edge in [bc, ca, ab] {
                opposite.push(across(mesh, &half_faces, edge));
            }
        }
        let mut vertices: Vec<u32> = triangles.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut leaving = vec![Side(0); vertices.len()];
        for (triangle, corners) in triangles.iter().enumerate().rev() {
            for (corner, vertex) in corners.iter().enumerate() {
                if let Ok(place) = vertices.binary_search(vertex) {
                    leaving[place] = Side::of(triangle, corner + 2);
                }
            }
        }
        Self {
            half_faces,
            triangles,
            opposite,
            vertices,
            leaving,
        }
    }

    /// The half-faces of the mesh that are the triangles, ascending, (b).
    pub fn half_faces(&self) -> &[HalfFace] {
        &self.half_faces
    }

    /// Vertices of each triangle, counter-clockwise seen from outside, (b x 3).
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Vertices on the boundary, ascending.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }

    /// The triangle that a half-face is, by its place in [`Boundary::triangles`]; `None` inside.
    pub fn triangle_of(&self, face: HalfFace) -> Option<usize> {
        self.half_faces.binary_search(&face).ok()
    }

    /// One side for each edge of the boundary, ascending.
    pub fn edges(&self) -> impl Iterator<Item = Side> + '_ {
        let sides = (0..self.opposite.len()).map(|side| Side::of(side / 3, side % 3));
        sides.filter(|side| *side < self.opposite(*side))
    }

    /// The same edge in the triangle on its other side, running the other way.
    pub fn opposite(&self, side: Side) -> Side {
        // The fallback is for a side of another mesh.
        self.opposite.get(side.0 as usize).copied().unwrap_or(side)
    }

    /// Vertices that a side starts from and ends in.
    pub fn side_vertices(&self, side: Side) -> [u32; 2] {
        let corners = self.triangles.get(side.triangle());
        [1, 2].map(|step| corners.map_or(u32::MAX, |c| c[(side.corner() + step) % 3]))
    }

    /// Sides that start from a vertex, one for each triangle around it, counter-clockwise seen from
    /// outside; none for a vertex inside.
    pub fn leaving(&self, vertex: u32) -> impl Iterator<Item = Side> + '_ {
        let place = self.vertices.binary_search(&vertex).ok();
        let first = place.map(|place| self.leaving[place]);
        std::iter::successors(first, move |side| {
            let turned = self.opposite(side.previous());
            (Some(turned) != first).then_some(turned)
        })
    }
}

/// The boundary side on the other side of a boundary half-edge: through the fan of cells between.
fn across(mesh: &HalfFaces, half_faces: &[HalfFace], edge: HalfEdge) -> Side {
    // A boundary edge has one fan, which ends at the boundary: its last half-edge is the one.
    let last = mesh.around_edge(edge).last().unwrap_or(edge);
    let triangle = half_faces.binary_search(&last.face()).unwrap_or(0);
    let start = last.face().half_edges().iter().position(|e| *e == last);
    Side::of(triangle, start.unwrap_or(0) + 2)
}
