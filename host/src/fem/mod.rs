//! Linear-elastic finite elements on four-node tetrahedra, quasi-static.
//!
//! Entry points: [`LinearTissue::new`] assembles and factors once, [`LinearTissue::solve`] answers
//! loads and moved points. Rows follow one convention (younes-2021, 2.2): `K u + C' lambda = f`,
//! `C u = b`; the force of a row on the tissue is `-C' lambda`.

mod assembly;
mod element;
mod factor;
mod handles;
mod material;
mod tissue;

pub use handles::{Anchor, Handle};
pub use material::{Material, MaterialError, Materials};
pub use tissue::{Equilibrium, LinearTissue, Loads, NodeLoad, TissueError};

pub(crate) use factor::SolveScratch;
pub(crate) use handles::HeldPoints;
