//! Results as files: JSON and VTK's unstructured grid, written whole or not at all.
//!
//! Entry points: [`Solution::write`] and [`write_whole`].

mod solution;
mod vtu;
mod whole;

pub use solution::{HeldTool, Reaction, Solution, SolutionFormat};
pub use vtu::vtu;
pub use whole::write_whole;
