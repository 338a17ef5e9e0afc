//! Why tissue is refused.
//!
//! Entry point: [`TissueError`].

use super::corotational::Policy;
use sutura_models::memory::Shortage;
use sutura_models::{BuildError, MaterialError};
use thiserror::Error;

/// Why tissue cannot be built or loaded.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TissueError {
    /// The material.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Somebody no longer waits for it: see [`stop_with`](crate::work::stop_with).
    #[error("stopped before it was done")]
    Stopped,
    /// More than there is memory for.
    #[error("the mesh is too large for this machine: {0}")]
    TooLarge(#[from] Shortage),
    /// A node number beyond the mesh.
    #[error("{what} names node {node}, but the mesh has {nodes} nodes, 0 to {last}", last = nodes.saturating_sub(1))]
    NoSuchNode {
        /// Who names it.
        what: &'static str,
        /// The number.
        node: u32,
        /// Nodes of the mesh.
        nodes: usize,
    },
    /// The tissue can float away or turn.
    #[error(
        "the stiffness matrix is singular: {fixed} nodes are fixed, and at least three that are not on one line must be, in every connected part"
    )]
    Floating {
        /// How many nodes are fixed.
        fixed: usize,
    },
    /// Nothing is left to solve for.
    #[error("all {0} nodes are fixed: nothing can move")]
    AllFixed(usize),
    /// Anchor without vertices, with too few weights, or weights that are not finite.
    #[error("handle {handle} needs one finite weight per vertex and at least one vertex")]
    AnchorWeights {
        /// 0-based index of the handle.
        handle: usize,
    },
    /// A handle that the handles before it, or fixed nodes, already determine.
    #[error(
        "handle {handle} cannot move by itself: its vertices are fixed or held by handles before it"
    )]
    HandlesConflict {
        /// 0-based index of the handle.
        handle: usize,
    },
    /// A fixed node where rows are to act.
    #[error("node {0} is fixed: no row can move it")]
    Fixed(u32),
    /// A displacement for a node that is not fixed.
    #[error("node {0} is given a displacement but is not fixed")]
    NotFixed(u32),
    /// A limit below zero or not a number.
    #[error("the limits of {0:?} must not be below zero")]
    Policy(Policy),
    /// Newton's method did not get all the way.
    #[error(
        "no equilibrium was found beyond {:.3} % of the loads: the forces stay out of balance by {residual:.1e} of the largest; smaller loads, or stiffer or better shaped cells where they act, may help", 100.0 * share
    )]
    NoEquilibrium {
        /// Share of loads and displacements that was reached.
        share: f64,
        /// What is left there at the next attempt, relative to the largest force.
        residual: f64,
    },
    /// Laws and cells of hyperelastic tissue.
    #[error("hyperelastic tissue: {0}")]
    Elasticity(BuildError),
    /// A load or target that is not a number.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
}
