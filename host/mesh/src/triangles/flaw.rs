//! What keeps triangles from being the surface of a solid.

use crate::MeshError;
use thiserror::Error;

/// Why triangles are no closed surface; faces count from 0, as in the file.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SurfaceFlaw {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] MeshError),
    /// None at all.
    #[error("it has no triangles")]
    Empty,
    /// More than there may be.
    #[error("it has {triangles} triangles, of {most} at most: make it coarser")]
    TooMany {
        /// How many there are.
        triangles: usize,
        /// How many there may be.
        most: usize,
    },
    /// A place that is nowhere.
    #[error("face {face} has a corner that is not finite")]
    NotFinite {
        /// Which.
        face: usize,
    },
    /// A corner that there is not.
    #[error("face {face} has the corner {corner}, but there are {points} points")]
    NoPoint {
        /// Which.
        face: usize,
        /// The corner that it names.
        corner: u32,
        /// How many there are.
        points: usize,
    },
    /// A triangle without a normal.
    #[error("face {face} at {at_m:?} m has no area: join it to its neighbours")]
    NoArea {
        /// Which.
        face: usize,
        /// Its first corner \[m\], (3).
        at_m: [f64; 3],
    },
    /// Edges with a triangle on one side only.
    #[error(
        "the surface is open: face {face} has no neighbour at its edge from {from_m:?} to {to_m:?} m (of {edges} such edges the first)"
    )]
    Open {
        /// Which.
        face: usize,
        /// Ends of the edge \[m\], (3) each.
        from_m: [f64; 3],
        /// The other end.
        to_m: [f64; 3],
        /// How many such edges there are.
        edges: usize,
    },
    /// An edge that two triangles pass in the same direction.
    #[error(
        "faces {one} and {other} both pass their edge from {from_m:?} to {to_m:?} m in this direction: one is turned over, or more than two meet there"
    )]
    Turned {
        /// One of them.
        one: usize,
        /// The other.
        other: usize,
        /// Ends of the edge \[m\], (3) each.
        from_m: [f64; 3],
        /// The other end.
        to_m: [f64; 3],
    },
    /// An edge of more than two triangles.
    #[error(
        "faces {faces:?} meet in one edge from {from_m:?} to {to_m:?} m, where two may: take away what hangs on there, or part what touches"
    )]
    Crowded {
        /// Three of them.
        faces: [usize; 3],
        /// Ends of the edge \[m\], (3) each.
        from_m: [f64; 3],
        /// The other end.
        to_m: [f64; 3],
    },
    /// A surface with one side only.
    #[error(
        "the surface has no outside: faces {one} and {other} at the edge from {from_m:?} to {to_m:?} m see opposite ways, whichever way round the others are turned"
    )]
    OneSided {
        /// One of them.
        one: usize,
        /// The other.
        other: usize,
        /// Ends of the edge \[m\], (3) each.
        from_m: [f64; 3],
        /// The other end.
        to_m: [f64; 3],
    },
    /// A vertex in which parts of the surface meet that have no edge in common.
    #[error(
        "parts of the surface, of them faces {one} and {other}, meet at {at_m:?} m in nothing but a point"
    )]
    Pinched {
        /// A face of one part.
        one: usize,
        /// A face of another.
        other: usize,
        /// Where \[m\], (3).
        at_m: [f64; 3],
    },
    /// Normals that point inwards.
    #[error(
        "the surface is inside out, or holds nothing: its volume is {volume_m3:e} m^3; turn all triangles over"
    )]
    InsideOut {
        /// By the triangles' orientation \[m^3\].
        volume_m3: f64,
    },
}
