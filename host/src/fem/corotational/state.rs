//! What evolves in corotational tissue, and the scratch that a step needs.
//!
//! Entry points: [`CorotationalState`], which can be copied and put back, and [`CorotationalWorkspace`].

use super::super::error::TissueError;
use super::super::factor::{Factor, RefactorScratch, SolveScratch};
use super::super::rotation::Polar;
use super::renewed::Asked;
use super::{CorotationalTissue, TangentKind};
use nalgebra::{Matrix3, UnitQuaternion};
use serde::Serialize;

/// Displacements, rotations, and the tangent that was factored last.
#[derive(Clone, Debug, Serialize)]
pub struct CorotationalState {
    /// Displacement of every node \[m\], free nodes first: the unknowns, then what fixed nodes do.
    pub(super) u: Vec<[f64; 3]>,
    unknowns: usize,

    // Written by a linearisation.
    /// Rotation of each cell, (m).
    pub(super) rotations: Vec<UnitQuaternion<f64>>,
    /// Displacement \[m\] and internal force \[N\] at the last linearisation, if there was one, (unknowns).
    pub(super) last_u: Vec<f64>,
    pub(super) last_force: Vec<f64>,
    pub(super) linearised: bool,
    /// Steps since the factor was made.
    pub(super) age: u32,

    // Written by a refactorisation.
    /// Written nowhere: it follows from what was factored, see `fingerprint`.
    #[serde(skip)]
    pub(super) factor: Factor,
    pub(super) tangent: TangentKind,
    /// Rotations in the factor, (m).
    pub(super) factored_rotations: Vec<UnitQuaternion<f64>>,
    /// Stretches in the factor, (m).
    pub(super) factored_stretches: Vec<Matrix3<f64>>,
    /// Counts, and decides nothing.
    #[serde(skip)]
    pub(super) generation: u64,
    /// Of the tangent's entries; 0 at rest.
    pub(super) fingerprint: u64,
    /// Whether the displacement may have changed since.
    pub(super) moved: bool,
    /// The next factor: what it is of follows from the states before, as the factor does.
    #[serde(skip)]
    pub(super) asked: Asked,
}

impl CorotationalState {
    pub(super) fn at_rest(tissue: &CorotationalTissue) -> Self {
        let rotations = vec![UnitQuaternion::identity(); tissue.cells()];
        Self {
            u: vec![[0.0; 3]; tissue.nodes()],
            unknowns: tissue.unknowns(),
            factored_rotations: rotations.clone(),
            rotations,
            last_u: vec![0.0; tissue.unknowns()],
            last_force: vec![0.0; tissue.unknowns()],
            linearised: false,
            age: 0,
            factor: tissue.rest_factor.clone(),
            tangent: TangentKind::Consistent,
            factored_stretches: vec![Matrix3::identity(); tissue.cells()],
            generation: 0,
            fingerprint: 0,
            moved: false,
            asked: Asked::nothing(tissue.cells()),
        }
    }

    /// Displacement of free nodes \[m\], (unknowns).
    pub fn unknowns(&self) -> &[f64] {
        &self.u.as_flattened()[..self.unknowns]
    }

    /// Displacement of free nodes, to be moved by rows or by
    /// [`CorotationalWorkspace::predicted`].
    pub fn unknowns_mut(&mut self) -> &mut [f64] {
        self.moved = true;
        &mut self.u.as_flattened_mut()[..self.unknowns]
    }

    /// Puts all nodes where `other`, of the same tissue, has them; for what looks at it.
    pub(crate) fn see(&mut self, other: &Self) {
        self.u.copy_from_slice(&other.u);
    }

    /// Largest rotation of a cell \[rad\].
    pub fn largest_rotation_rad(&self) -> f64 {
        let angles = self.rotations.iter().map(|rotation| rotation.angle());
        angles.fold(0.0, f64::max)
    }

    /// Tangent that was factored last.
    pub(crate) fn factor(&self) -> &Factor {
        &self.factor
    }

    /// Number of refactorisations so far: what was computed with the factor is void when it changes.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The same for equal tangents: what was computed with one factor holds for another with the same
    /// number.
    pub(crate) fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Displacement of any node \[m\].
    pub fn displacement_m(&self, tissue: &CorotationalTissue, node: u32) -> [f64; 3] {
        self.u[tissue.numbering.place(node) as usize]
    }

    /// Moves a fixed node \[m\].
    ///
    /// # Errors
    /// [`TissueError::NotFixed`], [`TissueError::NotFinite`], [`TissueError::NoSuchNode`].
    pub fn move_fixed(
        &mut self,
        tissue: &CorotationalTissue,
        node: u32,
        displacement_m: [f64; 3],
    ) -> Result<(), TissueError> {
        if node as usize >= tissue.nodes() {
            return Err(TissueError::NoSuchNode {
                what: "a prescribed displacement",
                node,
                nodes: tissue.nodes(),
            });
        }
        if !tissue.is_fixed(node) {
            return Err(TissueError::NotFixed(node));
        }
        if !displacement_m.iter().all(|u| u.is_finite()) {
            return Err(TissueError::NotFinite("a prescribed displacement"));
        }
        self.u[tissue.numbering.place(node) as usize] = displacement_m;
        self.moved = true;
        Ok(())
    }
}

/// Equal states go on equally.
impl PartialEq for CorotationalState {
    fn eq(&self, other: &Self) -> bool {
        // The factor by its fingerprint; `generation` counts and decides nothing.
        self.u == other.u
            && self.rotations == other.rotations
            && self.factored_rotations == other.factored_rotations
            && self.last_u == other.last_u
            && self.last_force == other.last_force
            && (self.linearised, self.age, self.moved, self.tangent)
                == (other.linearised, other.age, other.moved, other.tangent)
            && self.fingerprint == other.fingerprint
            && self.asked == other.asked
    }
}

/// Scratch: nothing in it outlives a step.
pub struct CorotationalWorkspace {
    /// Of each cell at the last update, (m).
    pub(super) polar: Vec<Polar>,
    /// Of each cell \[Pa\], (m).
    pub(super) twist: Vec<Matrix3<f64>>,
    /// Internal force \[N\], (n x 3), free nodes first.
    pub(super) force: Vec<[f64; 3]>,
    /// u + du \[m\], (unknowns).
    pub(super) predicted: Vec<f64>,
    /// Lower triangle of the tangent \[N/m\], (entries of the pattern).
    pub(super) stiffness: Vec<f64>,
    pub(super) refactor: RefactorScratch,
    pub(super) solve: SolveScratch,
    // Of conjugate gradients. Those with (n x 3) are zero on fixed nodes.
    pub(super) residual: Vec<f64>,
    pub(super) preconditioned: Vec<f64>,
    pub(super) direction: Vec<[f64; 3]>,
    pub(super) product: Vec<[f64; 3]>,
}

impl CorotationalWorkspace {
    pub(super) fn new(tissue: &CorotationalTissue) -> Self {
        let (unknowns, nodes, cells) = (tissue.unknowns(), tissue.nodes(), tissue.cells());
        let at_rest = Polar {
            rotation: Matrix3::identity(),
            stretch: Matrix3::identity(),
        };
        Self {
            polar: vec![at_rest; cells],
            twist: vec![Matrix3::zeros(); cells],
            force: vec![[0.0; 3]; nodes],
            predicted: vec![0.0; unknowns],
            stiffness: vec![0.0; tissue.pattern.entries()],
            refactor: tissue.rest_factor.refactor_scratch(),
            solve: tissue.rest_factor.scratch(),
            residual: vec![0.0; unknowns],
            preconditioned: vec![0.0; unknowns],
            direction: vec![[0.0; 3]; nodes],
            product: vec![[0.0; 3]; nodes],
        }
    }

    /// u + du of the last linearisation \[m\], (unknowns): where the tissue goes if no row holds it.
    pub fn predicted(&self) -> &[f64] {
        &self.predicted
    }

    /// Internal force on free nodes at the last update \[N\], (unknowns).
    pub fn internal_force(&self) -> &[f64] {
        &self.force.as_flattened()[..self.predicted.len()]
    }
}
