//! Names of the half-faces and half-edges of a cell, and the operators that stay inside one cell.
//!
//! Entry points: [`HalfFace`], [`HalfEdge`]. Source: Younes 2021, tables 2.1 and 2.2, equations 2.9
//! to 2.17. A half-face here is the thesis' half-facet: a triangle as seen from one of its cells.

use serde::Serialize;

/// Corners of the half-face opposite each corner of a positive cell, counter-clockwise from outside
/// (table 2.1).
pub(super) const CORNERS: [[usize; 3]; 4] = [[1, 2, 3], [2, 0, 3], [3, 0, 1], [0, 2, 1]];

/// P of equation 2.17; nothing asks for its diagonal.
const TURN: [[usize; 4]; 4] = [[0, 3, 1, 2], [2, 1, 3, 0], [3, 0, 2, 1], [1, 2, 0, 3]];

/// A triangle of a cell, named by the corner that it does not have: `4 cell + corner`.
///
/// A name belongs to the mesh that gave it. Another mesh gives a meaningless answer for it, no panic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct HalfFace(u32);

impl HalfFace {
    /// The half-face opposite `corner` of `cell`; the caller has checked that the number fits.
    pub(super) const fn of(cell: usize, corner: usize) -> Self {
        Self((4 * cell + corner % 4) as u32)
    }

    /// Its number, 0 to 4 m - 1 for m cells.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// The cell that it belongs to.
    pub const fn cell(self) -> u32 {
        self.0 / 4
    }

    /// The corner of its cell that it lies opposite to, 0 to 3.
    pub const fn corner(self) -> usize {
        (self.0 % 4) as usize
    }

    /// The half-face of the same cell opposite another corner.
    const fn beside(self, corner: usize) -> Self {
        Self::of(self.cell() as usize, corner)
    }

    /// The next half-face of the same cell (2.9).
    pub const fn next(self) -> Self {
        self.beside(self.corner() + 1)
    }

    /// The middle half-face of the same cell (2.10).
    pub const fn middle(self) -> Self {
        self.beside(self.corner() + 2)
    }

    /// The previous half-face of the same cell (2.11).
    pub const fn previous(self) -> Self {
        self.beside(self.corner() + 3)
    }

    /// The four half-faces of its cell.
    pub fn of_cell(self) -> [HalfFace; 4] {
        [0, 1, 2, 3].map(|corner| self.beside(corner))
    }

    /// Its half-edges in the order in which they run around it (table 2.2, up to its beginning).
    pub fn half_edges(self) -> [HalfEdge; 3] {
        CORNERS[self.corner()].map(|corner| HalfEdge {
            face: self,
            start: self.beside(corner),
        })
    }
}

/// A side of a half-face with its direction: the pair `(e0, e1)` of the thesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct HalfEdge {
    face: HalfFace,
    start: HalfFace,
}

impl HalfEdge {
    /// The half-face that it runs around, e0.
    pub const fn face(self) -> HalfFace {
        self.face
    }

    /// The half-face of the same cell opposite the vertex that it starts from, e1.
    pub const fn across_start(self) -> HalfFace {
        self.start
    }

    /// The cell that it belongs to.
    pub const fn cell(self) -> u32 {
        self.face.cell()
    }

    /// Corners of its cell that it starts from and ends in.
    pub const fn corners(self) -> [usize; 2] {
        [self.start.corner(), self.next().start.corner()]
    }

    /// The half-edge after it in the same half-face (2.13).
    pub const fn next(self) -> Self {
        let turn = TURN[self.start.corner()][self.face.corner()];
        Self {
            face: self.face,
            start: self.face.beside(turn),
        }
    }

    /// The half-edge before it in the same half-face (2.14).
    pub const fn previous(self) -> Self {
        let turn = TURN[self.face.corner()][self.start.corner()];
        Self {
            face: self.face,
            start: self.face.beside(turn),
        }
    }

    /// The same edge the other way, in the other half-face of the cell that has it (2.15).
    pub const fn mate(self) -> Self {
        Self {
            face: self.previous().start,
            start: self.next().start,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_edges_are_those_of_table_2_2() {
        // Second numbers of the pairs as printed; the rows run around the faces of table 2.1.
        let printed = [[1, 2, 3], [2, 0, 3], [3, 0, 1], [0, 2, 1]];
        for (corner, starts) in printed.into_iter().enumerate() {
            let face = HalfFace::of(5, corner);
            let edges = face.half_edges();
            assert_eq!(edges.map(|e| e.across_start().corner()), starts);
            for k in 0..3 {
                assert_eq!(edges[k].next(), edges[(k + 1) % 3]);
                assert_eq!(edges[k].previous(), edges[(k + 2) % 3]);
                assert_eq!(edges[k].cell(), 5);
            }
        }
    }

    #[test]
    fn a_mate_runs_the_other_way_in_another_face() {
        for face in HalfFace::of(7, 0).of_cell() {
            for edge in face.half_edges() {
                let [from, to] = edge.corners();
                let mate = edge.mate();
                assert_eq!(mate.corners(), [to, from]);
                assert_ne!(mate.face(), face);
                assert_eq!(mate.mate(), edge);
            }
        }
    }

    #[test]
    fn next_middle_and_previous_are_the_other_three() {
        for face in HalfFace::of(2, 0).of_cell() {
            let mut all = [face, face.next(), face.middle(), face.previous()];
            all.sort_unstable();
            assert_eq!(all, face.of_cell());
            assert_eq!(face.next().previous(), face);
            assert_eq!(face.middle().middle(), face);
        }
    }
}
