//! Hyperelastic tissue for rows: finite strain, linearised about where it is.
//!
//! Entry points: [`HyperelasticTissue::new`], [`HyperelasticTissue::linearise`] for one step of an outer loop,
//! [`HyperelasticTissue::accept`] for the move. Energy, forces and tangent stiffness are those of
//! [`sutura_models::hyperelastic`], the reference; what is added is a factor of the tangent that lasts for many steps,
//! and a line search that no cell inverts in.

mod accept;
mod equilibrium;
mod linearise;
mod state;
#[cfg(test)]
mod tests;

pub(crate) use accept::Moved;
pub use state::{HyperelasticState, HyperelasticWorkspace};

use super::assembly;
use super::error::TissueError;
use super::factor::{Factor, Need, SolveScratch};
use super::numbering::Numbering;
use super::pattern::Pattern;
use super::{Policy, TangentKind};
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use sutura_models::BuildError;
use sutura_models::hyperelastic::{Cells, Elasticity};
use sutura_models::law::Law;
use sutura_models::memory;

/// Copies of a factor: at rest, of the model and of a state, and the one being made in a step.
const COPIES: usize = 4;
/// And with needles: of their own state, and of the one that was kept of it.
const COPIES_FOR_NEEDLES: usize = 2;
/// Frobenius norm of what a small turn adds to the identity, over the turn.
const CHANGE_OF_TURN: f64 = std::f64::consts::SQRT_2;

/// What hyperelastic tissue is made of.
#[derive(Clone, Copy, Debug)]
pub struct Hyperelasticity<'a> {
    /// One law for all cells, or one for each, (m).
    pub laws: &'a [Law],
    /// Linear or averaged: others have nodes that the mesh does not have.
    pub cells: Cells,
}

/// What is constant: cells, the order of unknowns, the pattern of the tangent and its factor at rest.
pub struct HyperelasticTissue {
    elasticity: Elasticity,
    numbering: Numbering,
    /// Mesh node of each place, (n), free ones first.
    node: Vec<u32>,
    /// Of free nodes.
    pattern: Pattern,
    /// Which entry of the whole triangle each entry of the pattern is.
    kept: Vec<usize>,
    /// Of the undeformed tissue.
    rest_factor: Factor,
    policy: Policy,
    round_off_n_per_m: f64,
    round_off_j: f64,
    stiffness_ratio: f64,
}

impl HyperelasticTissue {
    /// Tissue of `mesh` with the nodes `fixed` held. Of the `policy` the turn after which the tangent is factored anew
    /// counts for a change of stretch, too.
    ///
    /// # Errors
    /// As [`CorotationalTissue::new`](super::CorotationalTissue::new); [`TissueError::Elasticity`] for laws that are too
    /// many or few, out of range, or quadratic cells.
    pub fn new(
        mesh: &TetMesh,
        substance: &Hyperelasticity<'_>,
        fixed: &[u32],
        policy: Policy,
    ) -> Result<Self, TissueError> {
        Self::beside(mesh, substance, fixed, policy, 0)
    }

    /// As [`Self::new`], where so much memory will be taken besides \[bytes\].
    pub(crate) fn beside(
        mesh: &TetMesh,
        substance: &Hyperelasticity<'_>,
        fixed: &[u32],
        policy: Policy,
        beside_bytes: u64,
    ) -> Result<Self, TissueError> {
        policy.check()?;
        let numbering = Numbering::new(mesh.points_m().len(), fixed)?;
        assembly::begin(mesh.cells().len())?;
        let mut elasticity = Elasticity::new(mesh, substance.laws, substance.cells)?;
        let (pattern, kept) = free_part(&elasticity, &numbering);
        let rest = elasticity.rest_m().to_vec();
        let mut whole = vec![0.0; elasticity.triangle().1.len()];
        elasticity.tangent(&rest, &mut whole);
        let stiffness: Vec<f64> = kept.iter().map(|&entry| whole[entry]).collect();
        let need = Need {
            copies: COPIES,
            beside_bytes,
        };
        let rest_factor = Factor::held(&pattern, &stiffness, numbering.fixed(), need)?;
        let mut node = vec![0; numbering.nodes()];
        for index in 0..numbering.nodes() as u32 {
            node[numbering.place(index) as usize] = index;
        }
        Ok(Self {
            round_off_n_per_m: elasticity.round_off_n_per_m(),
            round_off_j: elasticity.round_off_j(),
            stiffness_ratio: elasticity.stiffness_ratio(),
            elasticity,
            numbering,
            node,
            pattern,
            kept,
            rest_factor,
            policy,
        })
    }

    /// Whether there is memory for needles, too.
    ///
    /// # Errors
    /// [`TissueError::TooLarge`].
    pub(crate) fn has_room_for_needles(&self) -> Result<(), TissueError> {
        let bytes = size_of::<f64>() * self.rest_factor.len() * COPIES_FOR_NEEDLES;
        Ok(memory::require(
            "the factor of its stiffness",
            bytes as u64,
        )?)
    }

    /// Number of nodes, fixed ones included.
    pub fn nodes(&self) -> usize {
        self.numbering.nodes()
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.elasticity.cells()
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        self.numbering.unknowns()
    }

    /// Entries of the tangent's factor, zeros that pad its dense blocks included.
    pub fn factor_entries(&self) -> usize {
        self.rest_factor.len()
    }

    /// Whether a node is held.
    pub fn is_fixed(&self, node: u32) -> bool {
        self.numbering.is_fixed(node)
    }

    /// The speed-accuracy knob.
    pub fn policy(&self) -> Policy {
        self.policy
    }

    /// Where the nodes are among the unknowns.
    pub(crate) fn numbering(&self) -> &Numbering {
        &self.numbering
    }

    /// Of the undeformed tissue.
    pub(crate) fn rest_factor(&self) -> &Factor {
        &self.rest_factor
    }

    pub(crate) fn stiffness_ratio(&self) -> f64 {
        self.stiffness_ratio
    }

    /// Tissue at rest.
    pub fn state(&self) -> HyperelasticState {
        HyperelasticState::at_rest(self)
    }

    /// Scratch for any number of states, one at a time.
    pub fn workspace(&self) -> HyperelasticWorkspace {
        HyperelasticWorkspace::new(self)
    }

    /// Memory for solves with the factor.
    pub(crate) fn scratch(&self) -> SolveScratch {
        self.rest_factor.scratch()
    }

    /// Cauchy stress of each cell \[Pa\], (m x 3 x 3), for a displacement of every node \[m\].
    pub fn stress(&self, displacement_m: &[[f64; 3]]) -> Vec<[[f64; 3]; 3]> {
        let rest = self.elasticity.rest_m().iter();
        let moved = rest.zip(displacement_m);
        let x: Vec<_> = moved.map(|(x, u)| x + Vector3::from(*u)).collect();
        self.elasticity.clone().cauchy_stress(&x)
    }
}

/// The part of the triangle that belongs to free nodes, which keep their order among themselves, and where it is in the
/// whole.
fn free_part(elasticity: &Elasticity, numbering: &Numbering) -> (Pattern, Vec<usize>) {
    let (starts, rows) = elasticity.triangle();
    let unknown = |index: usize| {
        let first = numbering.first_unknown((index / 3) as u32);
        first.map(|first| first + index % 3)
    };
    let (mut column_start, mut row, mut kept) = (vec![0], Vec::new(), Vec::new());
    for (column, ends) in starts.windows(2).enumerate() {
        if unknown(column).is_none() {
            continue;
        }
        let entries = ends[0]..ends[1];
        for (entry, &index) in entries.clone().zip(&rows[entries]) {
            if let Some(unknown) = unknown(index) {
                row.push(unknown);
                kept.push(entry);
            }
        }
        column_start.push(row.len());
    }
    (Pattern::of_columns(column_start, row), kept)
}

impl From<BuildError> for TissueError {
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::Memory(shortage) => TissueError::TooLarge(shortage),
            BuildError::Material(error) => TissueError::Material(error),
            error => TissueError::Elasticity(error),
        }
    }
}

impl std::fmt::Debug for HyperelasticTissue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("HyperelasticTissue")
            .field("nodes", &self.nodes())
            .field("cells", &self.cells())
            .field("unknowns", &self.unknowns())
            .field("policy", &self.policy)
            .finish_non_exhaustive()
    }
}
