//! What evolves in hyperelastic tissue, and the scratch that a step needs.
//!
//! Entry points: [`HyperelasticState`], which can be copied and put back, and [`HyperelasticWorkspace`].

use super::super::factor::{Factor, RefactorScratch, SolveScratch};
use super::{HyperelasticTissue, TangentKind};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use sutura_models::hyperelastic::Elasticity;

/// Displacements, and the tangent that was factored last.
#[derive(Clone, Debug, Serialize)]
pub struct HyperelasticState {
    /// Displacement of every node \[m\], free nodes first: the unknowns, then fixed nodes'.
    pub(super) u: Vec<[f64; 3]>,
    unknowns: usize,
    /// Linearisations since the factor was made.
    pub(super) age: u32,
    /// Largest strain and turn of a cell in the last move (Frobenius norm).
    pub(super) change_of_move: f64,
    /// Whether the factor has turned out to be of no help: the next linearisation makes another.
    pub(super) is_poor: bool,

    // Written by a refactorisation.
    /// Written nowhere: it follows from what was factored, see `fingerprint`.
    #[serde(skip)]
    pub(super) factor: Factor,
    pub(super) tangent: TangentKind,
    /// Inverse deformation gradients in the factor, (m).
    pub(super) factored: Vec<Matrix3<f64>>,
    /// Of the tangent's entries; 0 at rest.
    pub(super) fingerprint: u64,
    /// Whether the displacement may have changed since.
    pub(super) moved: bool,
}

impl HyperelasticState {
    pub(super) fn at_rest(tissue: &HyperelasticTissue) -> Self {
        Self {
            u: vec![[0.0; 3]; tissue.nodes()],
            unknowns: tissue.unknowns(),
            age: 0,
            change_of_move: 0.0,
            is_poor: false,
            factor: tissue.rest_factor.clone(),
            tangent: TangentKind::Consistent,
            factored: vec![Matrix3::identity(); tissue.cells()],
            fingerprint: 0,
            moved: false,
        }
    }

    /// Displacement of free nodes \[m\], (unknowns).
    pub fn unknowns(&self) -> &[f64] {
        &self.u.as_flattened()[..self.unknowns]
    }

    /// Displacement of free nodes, to be moved from outside.
    pub fn unknowns_mut(&mut self) -> &mut [f64] {
        self.moved = true;
        &mut self.u.as_flattened_mut()[..self.unknowns]
    }

    /// Puts all nodes where `other`, of the same tissue, has them; for what looks at it.
    pub(crate) fn see(&mut self, other: &Self) {
        self.u.copy_from_slice(&other.u);
    }

    /// Displacement of any node \[m\].
    pub fn displacement_m(&self, tissue: &HyperelasticTissue, node: u32) -> [f64; 3] {
        self.u[tissue.numbering.place(node) as usize]
    }

    /// Tangent that was factored last.
    pub(crate) fn factor(&self) -> &Factor {
        &self.factor
    }

    /// The same for equal tangents.
    pub(crate) fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Largest strain and turn of a cell in the last move (Frobenius norm).
    pub(crate) fn change_of_move(&self) -> f64 {
        self.change_of_move
    }
}

/// Equal states go on equally: the factor by its fingerprint.
impl PartialEq for HyperelasticState {
    fn eq(&self, other: &Self) -> bool {
        self.u == other.u
            && self.factored == other.factored
            && self.change_of_move == other.change_of_move
            && (self.age, self.moved, self.is_poor) == (other.age, other.moved, other.is_poor)
            && (self.tangent, self.fingerprint) == (other.tangent, other.fingerprint)
    }
}

/// Scratch: nothing in it outlives a step. Fields with (n) are in the order of the mesh's nodes.
pub struct HyperelasticWorkspace {
    pub(super) elasticity: Elasticity,
    /// Nodes at the last look \[m\], (n), and where they are tried.
    pub(super) x: Vec<Vector3<f64>>,
    pub(super) trial: Vec<Vector3<f64>>,
    /// A displacement \[m\], (n), zero at fixed nodes.
    pub(super) direction: Vec<Vector3<f64>>,
    /// Forces \[N\], (n).
    pub(super) nodal: Vec<Vector3<f64>>,
    /// Deformation gradients at the last look, (m).
    pub(super) deformed: Vec<Matrix3<f64>>,
    /// Elastic energy \[J\] at the last look or move.
    pub(super) energy_j: f64,
    /// Norm of external or internal forces at the last look, whichever is larger \[N\].
    pub(super) scale_n: f64,
    /// What round-off leaves of the out-of-balance force \[N\].
    pub(super) round_off_n: f64,
    /// Internal force \[N\] and u + du \[m\], (unknowns).
    pub(super) internal: Vec<f64>,
    pub(super) predicted: Vec<f64>,
    /// Of conjugate gradients, (unknowns).
    pub(super) residual: Vec<f64>,
    pub(super) preconditioned: Vec<f64>,
    pub(super) search: Vec<f64>,
    pub(super) product: Vec<f64>,
    /// Tangent of all nodes, and of free ones \[N/m\].
    pub(super) whole: Vec<f64>,
    pub(super) stiffness: Vec<f64>,
    pub(super) refactor: RefactorScratch,
    pub(super) solve: SolveScratch,
}

impl HyperelasticWorkspace {
    pub(super) fn new(tissue: &HyperelasticTissue) -> Self {
        let rest = tissue.elasticity.rest_m().to_vec();
        let zeros = vec![Vector3::zeros(); tissue.nodes()];
        let empty = vec![0.0; tissue.unknowns()];
        Self {
            elasticity: tissue.elasticity.clone(),
            trial: rest.clone(),
            x: rest,
            direction: zeros.clone(),
            nodal: zeros,
            deformed: vec![Matrix3::identity(); tissue.cells()],
            energy_j: 0.0,
            scale_n: 0.0,
            round_off_n: 0.0,
            internal: empty.clone(),
            predicted: empty.clone(),
            residual: empty.clone(),
            preconditioned: empty.clone(),
            search: empty.clone(),
            product: empty,
            whole: vec![0.0; tissue.elasticity.triangle().1.len()],
            stiffness: vec![0.0; tissue.pattern.entries()],
            refactor: tissue.rest_factor.refactor_scratch(),
            solve: tissue.rest_factor.scratch(),
        }
    }

    /// u + du of the last linearisation \[m\], (unknowns): where the tissue goes if no row holds it.
    pub fn predicted(&self) -> &[f64] {
        &self.predicted
    }

    /// Internal force on free nodes at the last look \[N\], (unknowns).
    pub fn internal_force(&self) -> &[f64] {
        &self.internal
    }

    /// Elastic energy \[J\] at the last look or move.
    pub fn energy_j(&self) -> f64 {
        self.energy_j
    }
}
