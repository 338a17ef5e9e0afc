//! Finite elements on four-node tetrahedra, quasi-static: linear-elastic, corotational and hyperelastic.
//!
//! Entry points: [`LinearTissue::new`] assembles and factors once, [`LinearTissue::solve`] answers
//! loads and moved points; [`CorotationalTissue`] does so for large rotations, [`HyperelasticTissue`] for rows at finite strain. Rows follow one
//! convention (younes-2021, 2.2): `K u + C' lambda = f`, `C u = b`; the force of a row on the tissue is
//! `-C' lambda`.

mod assembly;
mod corotational;
mod element;
mod error;
mod factor;
mod handles;
mod held;
mod hyperelastic;
mod linear_model;
mod loads;
mod numbering;
mod pattern;
mod principal;
mod rotation;
mod tissue;

pub use corotational::{
    CorotationalModel, CorotationalState, CorotationalTissue, CorotationalWorkspace, Linearisation,
    ModelSettings, Policy, TangentKind,
};
pub use error::TissueError;
pub use factor::SolveScratch;
pub use handles::{Anchor, Handle};
pub use hyperelastic::{
    HyperelasticState, HyperelasticTissue, HyperelasticWorkspace, Hyperelasticity,
};
pub use linear_model::LinearModel;
pub use loads::{Equilibrium, Loads, NodeLoad, weight};
pub use principal::{principal_stress_pa, von_mises_pa};
pub use sutura_models::{Material, MaterialError, Materials};
pub use tissue::LinearTissue;

pub(crate) use corotational::{Balance, Beside, RenewScratch, Renewed};
pub(crate) use factor::{ColumnScratch, Factor};
pub(crate) use handles::{Factored, HeldPoints};
pub(crate) use hyperelastic::Moved;
pub(crate) use numbering::Numbering;
