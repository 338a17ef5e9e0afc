//! Corotational tissue as a tissue model: any nodes may be held, and others in every step.
//!
//! Entry point: [`CorotationalModel::new`]. Each step iterates towards balance with the policy's stale or
//! fresh tangent; the first iteration moves the held nodes and what follows them to first order, the
//! next ones go down the potential energy by backtracking. The tangent is that of the forces at the
//! present place.

use super::super::held::{Held, fault_of};
use super::super::linear_model::{FLOATING, left_over, place, react};
use super::linearise::{add, dot};
use super::{
    CorotationalState, CorotationalTissue, CorotationalWorkspace, Policy, TangentKind, TissueError,
};
use crate::mesh::TetMesh;
use sutura_models::{BoundaryConditions, Diagnostics, Materials, Outcome, Tangent, Tissue};

/// Iterations of conjugate gradients for a tangent, and what they shall leave.
const TANGENT_ITERATIONS: u32 = 500;
const TANGENT_TOLERANCE: f64 = 1e-10;

/// Shortest part of a step that backtracking tries.
const LEAST_LENGTH: f64 = 1.0 / 16.0;

/// How far a step goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelSettings {
    /// When the tangent is factored anew, and what is done in between.
    pub policy: Policy,
    /// Most solves of a step, at least one.
    pub iterations: u32,
    /// Share of the forces that may be left out of balance, 2-norms.
    pub tolerance: f64,
}

impl Default for ModelSettings {
    /// Four solves, because a step of interactive motion is small and the next step goes on where this
    /// one ends; 1e-4, far below what a hand feels.
    fn default() -> Self {
        Self {
            policy: Policy::default(),
            iterations: 4,
            tolerance: 1e-4,
        }
    }
}

impl ModelSettings {
    /// To the balance itself.
    pub const CONVERGED: Self = Self {
        policy: Policy {
            refactor_rotation_rad: 0.0,
            refactor_every: 0,
            cg_iterations: 0,
            cg_tolerance: 0.0,
        },
        iterations: 200,
        tolerance: 1e-10,
    };
}

/// Corotational tissue behind [`Tissue`].
pub struct CorotationalModel {
    tissue: CorotationalTissue,
    state: CorotationalState,
    workspace: CorotationalWorkspace,
    settings: ModelSettings,
    rest_m: Vec<[f64; 3]>,
    held: Held,
    /// Loads \[N\], du and places to go back to \[m\], (3 n).
    loads: Vec<f64>,
    du: Vec<f64>,
    start: Vec<f64>,
    before: Vec<f64>,
    positions_m: Vec<[f64; 3]>,
    reactions_n: Vec<[f64; 3]>,
}

impl CorotationalModel {
    /// Tissue of `mesh`; `materials` is one [`Material`](super::super::Material) for all cells, or
    /// [`Materials`].
    ///
    /// # Errors
    /// A material or setting out of range; a mesh too large for memory.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        settings: ModelSettings,
    ) -> Result<Self, TissueError> {
        if settings.iterations == 0 || settings.tolerance.is_nan() || settings.tolerance < 0.0 {
            return Err(TissueError::Policy(settings.policy));
        }
        let tissue = CorotationalTissue::unheld(mesh, materials, settings.policy)?;
        let nodes = tissue.nodes();
        let empty = vec![0.0; 3 * nodes];
        Ok(Self {
            state: tissue.state(),
            workspace: tissue.workspace(),
            settings,
            rest_m: mesh.points_m().to_vec(),
            held: Held::none(mesh),
            loads: empty.clone(),
            du: empty.clone(),
            start: empty.clone(),
            before: empty,
            positions_m: mesh.points_m().to_vec(),
            reactions_n: Vec::new(),
            tissue,
        })
    }

    /// Factors the tangent at the last update without the held nodes.
    fn refactor(&mut self) -> bool {
        let (tissue, workspace) = (&self.tissue, &mut self.workspace);
        for kind in [TangentKind::Consistent, TangentKind::Projected] {
            tissue.assemble(workspace, kind);
            self.held.mask(&tissue.pattern, &mut workspace.stiffness);
            let (values, scratch) = (&workspace.stiffness, &mut workspace.refactor);
            let factor = &mut self.state.factor;
            if factor.refactor(&tissue.pattern, values, scratch).is_ok() {
                self.state.tangent = kind;
                self.state
                    .factored_rotations
                    .copy_from_slice(&self.state.rotations);
                self.state.age = 0;
                return true;
            }
        }
        false
    }

    /// Whether the policy wants the tangent anew.
    fn is_old(&self) -> bool {
        let policy = self.settings.policy;
        self.state.age >= policy.refactor_every
            || self.state.rotation_since_refactor() > policy.refactor_rotation_rad
    }

    /// out = K x on free nodes.
    fn product(&mut self, x: &[f64]) {
        self.workspace
            .direction
            .as_flattened_mut()
            .copy_from_slice(x);
        self.tissue.multiply(&mut self.workspace);
        self.held.clear(self.workspace.product.as_flattened_mut());
    }

    /// K x = residual by conjugate gradients with the factor before them, x in `du`; what is left in the
    /// energy norm. Without iterations the factor alone. The twist has been found.
    fn answer(&mut self, iterations: u32, tolerance: f64) -> f64 {
        let n = self.du.len();
        let precondition = |model: &mut Self| {
            let z = &mut model.workspace.preconditioned;
            z.copy_from_slice(&model.workspace.residual);
            model.state.factor.solve(z, &mut model.workspace.solve);
        };
        precondition(self);
        if iterations == 0 {
            self.du.copy_from_slice(&self.workspace.preconditioned);
            return f64::NAN;
        }
        self.du.fill(0.0);
        // The loop's own direction, because a product overwrites the workspace's.
        let first = dot(&self.workspace.residual, &self.workspace.preconditioned);
        let mut square = first;
        self.start.copy_from_slice(&self.workspace.preconditioned);
        for _ in 0..iterations {
            if square.is_nan() || square <= tolerance * tolerance * first {
                break;
            }
            let direction = std::mem::take(&mut self.start);
            self.product(&direction);
            let product = self.workspace.product.as_flattened();
            let curvature = dot(&direction, product);
            if curvature.is_nan() || curvature <= 0.0 {
                if self.du.iter().all(|u| *u == 0.0) {
                    self.du.copy_from_slice(&direction);
                }
                self.start = direction;
                break;
            }
            let step = square / curvature;
            add(step, &direction, &mut self.du);
            add(-step, product, &mut self.workspace.residual[..n]);
            self.start = direction;
            precondition(self);
            let next = dot(&self.workspace.residual, &self.workspace.preconditioned);
            for (direction, z) in self.start.iter_mut().zip(&self.workspace.preconditioned) {
                *direction = z + next / square * *direction;
            }
            square = next;
        }
        if first > 0.0 {
            (square / first).max(0.0).sqrt()
        } else {
            0.0
        }
    }

    /// Energy of tissue and loads at the last update \[J\].
    fn potential(&self) -> f64 {
        self.tissue.energy_j(&self.workspace) - dot(&self.loads, self.state.unknowns())
    }

    /// Moves held nodes to their targets, free ones not at all; takes what that pulls with from the residual.
    fn move_held(&mut self, drive: &BoundaryConditions<'_>) -> bool {
        self.workspace.direction.fill([0.0; 3]);
        let mut moved = false;
        for (node, target) in drive.held {
            let at = &mut self.state.u[*node as usize];
            let way = [0, 1, 2].map(|axis| target[axis] - at[axis]);
            moved |= way != [0.0; 3];
            self.workspace.direction[*node as usize] = way;
            *at = *target;
        }
        if moved {
            self.tissue
                .find_twist(&mut self.workspace, self.state.tangent);
            self.tissue.multiply(&mut self.workspace);
            let product = self.workspace.product.as_flattened();
            add(-1.0, product, &mut self.workspace.residual);
            self.held.clear(&mut self.workspace.residual);
        }
        moved
    }

    fn find_residual(&mut self) {
        let internal = self.workspace.force.as_flattened();
        let forces = self.loads.iter().zip(internal);
        for (residual, (load, internal)) in self.workspace.residual.iter_mut().zip(forces) {
            *residual = load - internal;
        }
        self.held.clear(&mut self.workspace.residual);
    }

    /// Goes towards balance: iterations, and how it ended.
    fn balance(&mut self, drive: &BoundaryConditions<'_>) -> (u32, Outcome) {
        self.tissue.update(&mut self.state, &mut self.workspace);
        for iteration in 0..self.settings.iterations {
            self.find_residual();
            if self.is_old() {
                if !self.refactor() {
                    return (
                        iteration,
                        Outcome::Failed("the stiffness cannot be factored"),
                    );
                }
            } else {
                self.state.age += 1;
            }
            let exact = self.state.age == 0;
            let moved = iteration == 0 && self.move_held(drive);
            if !moved {
                let internal = self.workspace.force.as_flattened();
                if left_over(drive, internal, &self.held) <= self.settings.tolerance
                    || self.tissue.is_round_off(
                        dot(&self.workspace.residual, &self.workspace.residual).sqrt(),
                    )
                {
                    return (iteration, Outcome::Converged);
                }
            }
            let potential = self.potential();
            let energy = self.tissue.energy_j(&self.workspace);
            // Kept for its slope along du: conjugate gradients use it up.
            self.workspace
                .predicted
                .copy_from_slice(&self.workspace.residual);
            let iterations = if exact {
                0
            } else {
                self.settings.policy.cg_iterations
            };
            if iterations > 0 {
                self.tissue
                    .find_twist(&mut self.workspace, self.state.tangent);
            }
            self.answer(iterations, self.settings.policy.cg_tolerance);
            let slope = dot(&self.workspace.predicted, &self.du);
            self.start.copy_from_slice(self.state.unknowns());
            // Near balance the fall drowns in the energy's round-off; held nodes may raise it.
            let trusted = moved || slope <= 1e-9 * energy;
            let mut length = 1.0;
            loop {
                let u = self.state.u.as_flattened_mut();
                u.copy_from_slice(&self.start);
                add(length, &self.du, u);
                self.tissue.update(&mut self.state, &mut self.workspace);
                if trusted
                    || self.potential() <= potential - 1e-4 * length * slope
                    || length <= LEAST_LENGTH
                {
                    break;
                }
                length *= 0.5;
            }
            if !self.state.unknowns().iter().all(|u| u.is_finite()) {
                return (
                    iteration + 1,
                    Outcome::Failed("the displacement is not finite"),
                );
            }
        }
        let internal = self.workspace.force.as_flattened();
        let left = left_over(drive, internal, &self.held);
        let outcome = if !left.is_finite() {
            Outcome::Failed("the forces are not finite")
        } else if left <= self.settings.tolerance {
            Outcome::Converged
        } else {
            Outcome::Unfinished
        };
        (self.settings.iterations, outcome)
    }

    fn diagnostics(&self, outcome: Outcome, iterations: u32, residual: f64) -> Diagnostics {
        Diagnostics {
            outcome,
            iterations,
            residual,
            force_error: outcome.force_error(residual),
            energy_j: self.tissue.energy_j(&self.workspace),
            energy_difference: f64::NAN,
            momentum: [0.0; 3],
            angular_momentum: [0.0; 3],
        }
    }
}

impl Tissue for CorotationalModel {
    fn step(&mut self, drive: &BoundaryConditions<'_>, _step_s: f64) -> Diagnostics {
        if let Some(fault) = fault_of(drive, self.rest_m.len()) {
            return self.diagnostics(Outcome::Failed(fault), 0, f64::NAN);
        }
        self.before.copy_from_slice(self.state.unknowns());
        self.loads.fill(0.0);
        for (to, from) in self.loads.iter_mut().zip(drive.force_n.as_flattened()) {
            *to = *from;
        }
        let others = self.held.take(drive);
        if others {
            self.tissue.update(&mut self.state, &mut self.workspace);
            let held = !self.held.leaves_rigid_motion(&self.rest_m, drive)
                && self.refactor()
                && self.state.factor.keeps(
                    &self.workspace.stiffness,
                    &mut self.du,
                    &mut self.workspace.solve,
                );
            if !held {
                self.held.forget();
                return self.diagnostics(Outcome::Failed(FLOATING), 0, f64::NAN);
            }
        }
        let (iterations, outcome) = self.balance(drive);
        if let Outcome::Failed(_) = outcome {
            self.state
                .u
                .as_flattened_mut()
                .copy_from_slice(&self.before);
            self.tissue.update(&mut self.state, &mut self.workspace);
            self.held.forget();
            return self.diagnostics(outcome, iterations, f64::NAN);
        }
        place(&self.rest_m, self.state.unknowns(), &mut self.positions_m);
        let internal = self.workspace.force.as_flattened();
        react(drive, internal, &mut self.reactions_n);
        let left = left_over(drive, internal, &self.held);
        self.diagnostics(outcome, iterations, left)
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.positions_m
    }

    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.reactions_n
    }

    fn tangent(
        &mut self,
        drive: &BoundaryConditions<'_>,
        moved: &[usize],
        _step_s: f64,
    ) -> Option<Tangent> {
        let known = fault_of(drive, self.rest_m.len()).is_none()
            && moved.iter().all(|index| *index < drive.held.len());
        if !known || !self.held.are_of(drive) {
            return None;
        }
        self.tissue.update(&mut self.state, &mut self.workspace);
        self.tissue
            .find_twist(&mut self.workspace, TangentKind::Consistent);
        let mut stiffness = [[0.0; 3]; 3];
        let mut error = 0.0f64;
        for axis in 0..3 {
            let unit = |direction: &mut [[f64; 3]]| {
                for index in moved {
                    direction[drive.held[*index].0 as usize][axis] = 1.0;
                }
            };
            self.workspace.direction.fill([0.0; 3]);
            unit(&mut self.workspace.direction);
            self.tissue.multiply(&mut self.workspace);
            self.workspace.residual.fill(0.0);
            let product = self.workspace.product.as_flattened();
            add(-1.0, product, &mut self.workspace.residual);
            self.held.clear(&mut self.workspace.residual);
            error = error.max(self.answer(TANGENT_ITERATIONS, TANGENT_TOLERANCE));
            self.workspace
                .direction
                .as_flattened_mut()
                .copy_from_slice(&self.du);
            unit(&mut self.workspace.direction);
            self.tissue.multiply(&mut self.workspace);
            for index in moved {
                let force = self.workspace.product[drive.held[*index].0 as usize];
                for (row, force) in stiffness.iter_mut().zip(force) {
                    row[axis] += force;
                }
            }
        }
        let converged = error <= 1e3 * TANGENT_TOLERANCE;
        Some(Tangent {
            stiffness_n_per_m: stiffness,
            error: if converged { 0.0 } else { error },
        })
    }
}

impl std::fmt::Debug for CorotationalModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CorotationalModel")
            .field("nodes", &self.rest_m.len())
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}
