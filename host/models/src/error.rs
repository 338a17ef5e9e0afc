//! Why a model cannot be built.

use crate::MaterialError;
use crate::memory::Shortage;
use thiserror::Error;

/// Why a model cannot be built.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A material out of range.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Neither one for all cells nor one for each.
    #[error("{given} {what} for {cells} cells; give one for all or one for each")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        given: usize,
        /// Cells of the mesh.
        cells: usize,
    },
    /// A mesh that is too large.
    #[error("the mesh is too large for this machine: {0}")]
    Memory(#[from] Shortage),
    /// A setting out of range.
    #[error("{name} is {value}; it must be {limit}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it was given.
        value: f64,
        /// What is possible.
        limit: &'static str,
    },
}
