//! Soft-tissue models behind one interface, from the reference to the fastest approximation.
//!
//! Entry points: [`Tissue`], which every model implements, and the models' own modules. A model moves nodes
//! that are held to where a [`BoundaryConditions`] wants them, lets the others follow, and says what that took.

pub mod chainmail;
mod drive_check;
pub mod energy_balance;
mod error;
mod held;
pub mod hyperelastic;
mod in_place;
pub mod law;
mod material;
pub mod memory;
mod rigid;
mod secant;
mod setting;
pub mod shape_matching;
mod tissue;

pub use error::BuildError;
pub use material::{Material, MaterialError, Materials};
pub use tissue::{BoundaryConditions, Diagnostics, Outcome, Tangent, Tissue};
