//! Corotational tissue: small strain in a frame that turns with every cell (younes-2021, 2.2.3).
//!
//! Entry points: [`CorotationalTissue::new`], [`CorotationalTissue::linearise`] for one step of an outer
//! loop, [`CorotationalTissue::solve`] for a whole equilibrium. The energy mu |S - I|^2 + lambda/2
//! tr(S - I)^2 with F = R S gives the forces sum R K (R'x - X); (Y 2.43) prints R' for R, (Y 2.46) turns
//! the load. The tangent has dR/du in it.

mod cell;
mod equilibrium;
mod linearise;
mod model;
mod renewed;
mod state;
#[cfg(test)]
mod tests;

pub(crate) use linearise::Balance;
pub use linearise::{Linearisation, TangentKind};
pub(super) use linearise::{add, dot, fingerprint};
pub use model::{CorotationalModel, ModelSettings};
pub(crate) use renewed::{Beside, RenewScratch, Renewed};
pub use state::{CorotationalState, CorotationalWorkspace};

use super::assembly::{self, assemble};
use super::element::Element;
use super::error::TissueError;
use super::factor::{Factor, Need, SolveScratch};
use super::handles::Factored;
use super::numbering::Numbering;
use super::pattern::Pattern;
use crate::mesh::TetMesh;
use sutura_models::{Materials, memory};

/// How much work goes into following the tangent: speed against accuracy of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// The tangent is factored anew once a cell has turned by more than this since the last time \[rad\]. Beside the
    /// steps it is asked for at half of that, and in the step factored only at a multiple of it.
    pub refactor_rotation_rad: f64,
    /// ... and after this many steps, for what changes without turning.
    pub refactor_every: u32,
    /// Iterations of conjugate gradients on the present tangent, preconditioned with the stale factor;
    /// zero: the stale factor alone. Each costs a solve and a product.
    pub cg_iterations: u32,
    /// The iteration ends when the residual has fallen to this share, in the energy norm.
    pub cg_tolerance: f64,
}

/// Copies of a factor: at rest, of the model and of a state, the one being made in a step, and two for the one being made
/// beside it.
const COPIES: usize = 6;
/// And with needles: of their own state, of the one that was kept of it and while it is built, and the one being made in their
/// steps.
const COPIES_FOR_NEEDLES: usize = 4;

impl Default for Policy {
    /// 0.1 rad, because a stale solve then leaves a third of the energy norm in a bent block (nu = 0.45:
    /// turned, its stiff directions are felt as soft ones) and two iterations leave 7 %, of one step's
    /// motion. Beyond 0.2 rad a stale solve alone does harm. 256 steps are a quarter of a second at
    /// 1 kHz.
    fn default() -> Self {
        Self {
            refactor_rotation_rad: 0.1,
            refactor_every: 256,
            cg_iterations: 2,
            cg_tolerance: 1e-3,
        }
    }
}

impl Policy {
    /// Whether its limits are numbers, and not below zero.
    pub(super) fn check(self) -> Result<(), TissueError> {
        let limits = [self.refactor_rotation_rad, self.cg_tolerance];
        if limits.iter().all(|limit| *limit >= 0.0) {
            Ok(())
        } else {
            Err(TissueError::Policy(self))
        }
    }
}

/// What is constant: cells, the order of unknowns, the pattern of the stiffness and its factor at rest.
pub struct CorotationalTissue {
    /// With places instead of nodes, ascending in each cell.
    elements: Vec<Element>,
    numbering: Numbering,
    pattern: Pattern,
    /// Of the undeformed tissue.
    rest_factor: Factor,
    policy: Policy,
    /// Forces below this are round-off \[N\].
    round_off_n: f64,
    /// Largest sqrt((lambda + 2 mu) / mu) of a cell: how much stiffer against being pressed than against
    /// being sheared.
    stiffness_ratio: f64,
}

impl CorotationalTissue {
    /// Tissue of `mesh` with the nodes `fixed` held; `materials` is one
    /// [`Material`](super::Material) for all cells, or [`Materials`].
    ///
    /// # Errors
    /// As [`LinearTissue::new`](super::LinearTissue::new); a policy that is not finite or negative.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        fixed: &[u32],
        policy: Policy,
    ) -> Result<Self, TissueError> {
        Self::beside(mesh, &materials.into(), fixed, policy, 0)
    }

    /// As [`Self::new`], where so much memory will be taken besides \[bytes\].
    pub(crate) fn beside(
        mesh: &TetMesh,
        materials: &Materials,
        fixed: &[u32],
        policy: Policy,
        beside_bytes: u64,
    ) -> Result<Self, TissueError> {
        let need = Need {
            copies: COPIES,
            beside_bytes,
        };
        let factor = |pattern: &Pattern, stiffness: &[f64], numbering: &Numbering| {
            Factor::held(pattern, stiffness, numbering.fixed(), need)
        };
        Self::build(mesh, materials, fixed, policy, factor)
    }

    /// As [`Self::new`] for whoever holds nodes in another way: none is fixed, and there is no factor of
    /// the stiffness yet.
    pub(super) fn unheld(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        policy: Policy,
    ) -> Result<Self, TissueError> {
        let need = Need {
            copies: COPIES,
            beside_bytes: 0,
        };
        let factor =
            |pattern: &Pattern, _: &[f64], _: &Numbering| Factor::of_identity(pattern, need);
        Self::build(mesh, &materials.into(), &[], policy, factor)
    }

    fn build(
        mesh: &TetMesh,
        materials: &Materials,
        fixed: &[u32],
        policy: Policy,
        factor: impl FnOnce(&Pattern, &[f64], &Numbering) -> Result<Factor, TissueError>,
    ) -> Result<Self, TissueError> {
        policy.check()?;
        materials.check(mesh.cells().len())?;
        let numbering = Numbering::new(mesh.points_m().len(), fixed)?;
        assembly::begin(mesh.cells().len())?;
        let elements: Vec<Element> = Element::of_mesh(mesh, materials)
            .iter()
            .map(|element| element.placed(&numbering))
            .collect();
        let (pattern, stiffness) = assemble(&elements, numbering.free());
        let rest_factor = factor(&pattern, &stiffness, &numbering)?;
        let round_off_n = elements
            .iter()
            .map(Element::force_of_unit_strain)
            .fold(0.0, f64::max)
            * 16.0
            * f64::EPSILON;
        let ratio = |element: &Element| (element.lame.0 / element.lame.1 + 2.0).sqrt();
        let stiffness_ratio = elements.iter().map(ratio).fold(0.0, f64::max);
        Ok(Self {
            elements,
            numbering,
            pattern,
            rest_factor,
            policy,
            round_off_n,
            stiffness_ratio,
        })
    }

    /// Whether there is memory for needles, too.
    ///
    /// # Errors
    /// [`TissueError::TooLarge`].
    pub(crate) fn has_room_for_needles(&self) -> Result<(), TissueError> {
        let bytes = size_of::<f64>() * self.factor_entries() * COPIES_FOR_NEEDLES;
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
        self.elements.len()
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        self.numbering.unknowns()
    }

    /// Entries of the stiffness's factor, zeros that pad its dense blocks included.
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

    /// Index of a node's first unknown; `None` for a fixed node.
    pub fn first_unknown(&self, node: u32) -> Option<usize> {
        self.numbering.first_unknown(node)
    }

    /// A node's value in a vector of unknowns; zero for a fixed node.
    pub fn at_node(&self, u: &[f64], node: u32) -> [f64; 3] {
        self.numbering.at_node(u, node)
    }

    /// Where the nodes are among the unknowns.
    pub(crate) fn numbering(&self) -> &Numbering {
        &self.numbering
    }

    /// Tissue at rest.
    pub fn state(&self) -> CorotationalState {
        CorotationalState::at_rest(self)
    }

    /// Scratch for any number of states, one at a time.
    pub fn workspace(&self) -> CorotationalWorkspace {
        CorotationalWorkspace::new(self)
    }

    /// Of the undeformed tissue.
    pub(crate) fn rest_factor(&self) -> &Factor {
        &self.rest_factor
    }

    pub(crate) fn stiffness_ratio(&self) -> f64 {
        self.stiffness_ratio
    }

    /// Memory for solves with the factor.
    pub(crate) fn scratch(&self) -> SolveScratch {
        self.rest_factor.scratch()
    }
}

/// Corotational tissue with the tangent that a state holds, for rows.
pub(crate) struct Linearised<'a> {
    pub tissue: &'a CorotationalTissue,
    pub state: &'a CorotationalState,
}

impl Factored for Linearised<'_> {
    fn numbering(&self) -> &Numbering {
        &self.tissue.numbering
    }

    fn factor(&self) -> &Factor {
        &self.state.factor
    }
}

impl std::fmt::Debug for CorotationalTissue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CorotationalTissue")
            .field("nodes", &self.nodes())
            .field("cells", &self.cells())
            .field("unknowns", &self.unknowns())
            .field("policy", &self.policy)
            .finish_non_exhaustive()
    }
}
