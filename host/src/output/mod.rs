//! Results and meshes as files, written whole or not at all.
//!
//! Entry points: [`Solution::write`] and [`write_mesh`].

mod drawn;
mod mesh_file;
mod outline;
mod solution;
mod vtu;

pub(crate) use drawn::{Beside, centre_line};
pub use drawn::{Drawn, Line, Part};
pub use mesh_file::{MeshFormat, write_mesh};
pub(crate) use solution::tip_word;
pub use solution::{DrivenNeedle, FixedReaction, HeldTool, Reaction, Solution, SolutionFormat};
pub use vtu::vtu;
