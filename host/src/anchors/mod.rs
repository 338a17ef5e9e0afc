//! Rows on points of tissue: what holds it at punctures, pins and grips, solved at haptic rate.
//!
//! Entry point: [`AnchorSolver::step`]. A row keeps `direction . u(anchor)` at or below a target. The
//! compliance between anchors is a barycentric sum of cached blocks of K^-1 (younes-2021, 2.2.2, with
//! columns kept instead of solved for), so a step costs a dense solve in the number of rows and nothing
//! that grows with the mesh. The displacement of all nodes costs one sparse solve more, on request.

pub mod circling;
mod compliance;
mod set;
mod solver;
mod system;
#[cfg(test)]
mod tests;

pub(crate) use set::ConstraintSet;
pub use solver::{AnchorSettings, AnchorSolver, AnchorStages, AnchorStatus, AnchorStep};
pub(crate) use system::{ConstraintState, ConstraintSystem, Fetched, MANY_PUSHES, is_solved};

use crate::rows::RowKind;
use serde::Serialize;

/// A point of tissue by barycentric coordinates of a face or cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AnchorPoint {
    /// Mesh nodes; any node where the weight is zero.
    pub nodes: [u32; 4],
    /// Their weights, with sum 1; or 0 for one point less another, whose way apart a row bounds.
    pub weights: [f64; 4],
}

/// A row on several anchors: the sum of `direction . u(anchor)` over its terms, at or below its target or
/// equal to it, by its kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct MultiPointConstraint {
    /// Names the row from step to step, among single rows too.
    pub id: u64,
    /// What it may do.
    pub kind: RowKind,
    /// The sum's target, from the unloaded mesh \[m\].
    pub target_m: f64,
    /// How much it gives way by itself per force \[m/N\]: 0 for a rigid row.
    pub compliance_m_per_n: f64,
    /// Its first term, and how many it has.
    pub terms: (u32, u32),
}

/// A part of a [`MultiPointConstraint`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Term {
    /// Index of the anchor.
    pub anchor: u32,
    /// World frame, of any length, (3).
    pub direction: [f64; 3],
}

/// One row: `direction . u(anchor) <= target` or `=`, by its kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PointConstraint {
    /// Names the row from step to step.
    pub id: u64,
    /// Index of its anchor.
    pub anchor: u32,
    /// What it may do.
    pub kind: RowKind,
    /// Unit vector, world frame, (3).
    pub direction: [f64; 3],
    /// Displacement of the anchor along `direction` from the unloaded mesh \[m\].
    pub target_m: f64,
}
