//! Goal-limited shape matching: overlapping clusters of nodes, each drawn to its rest shape, turned as fits best.
//!
//! Entry point: [`ShapeMatching`]. After qian-2015, 3.1, with weights from the material instead of a share of the way to
//! the goal; [`best_rotation`] takes the place of the polar decomposition and is a rotation of any cluster.

mod clusters;
mod goals;
mod rotation;
mod tissue;

pub use rotation::best_rotation;
pub use tissue::{ShapeMatching, ShapeMatchingSettings};

/// Why a scene with needles or thread refuses shape matching: their rows hold tissue at points inside cells
/// and need the compliance between any two of them, while shape matching has the reaction of held nodes and a
/// secant of it.
pub const REFUSAL: &str = "shape matching has reactions and a secant tangent of held nodes only; needles and thread \
     need the compliance between points inside cells: use linear or corotational tissue";
