//! One step towards balance: forces, and what the tangent says to do about them.
//!
//! Entry point: [`HyperelasticTissue::linearise`]. Between refactorisations the stale factor preconditions conjugate
//! gradients on the present tangent, applied cell by cell.

use super::super::corotational::{add, dot, fingerprint};
use super::super::{Balance, Linearisation};
use super::{
    CHANGE_OF_TURN, HyperelasticState, HyperelasticTissue, HyperelasticWorkspace, TangentKind,
};
use nalgebra::{Matrix3, Vector3};

/// First shift of a tangent that is not positive definite, as a share of its mean diagonal entry; each further one is
/// ten times as large.
const FIRST_SHIFT: f64 = 1e-5;
const MOST_SHIFTS: u32 = 6;
/// A factor with which an iteration of conjugate gradients leaves more than this in the energy norm is not worth keeping.
const POOR: f64 = 0.5;
/// Share of the forces out of balance below which that is not asked.
const LEAST_JUDGED: f64 = 1e-6;

impl HyperelasticTissue {
    /// The out-of-balance force `external - internal` \[N\] (unknowns) at the state's displacement, and the u + du that
    /// the tangent answers with, in [`HyperelasticWorkspace::predicted`]. Leaves the displacement alone. Allocates
    /// nothing.
    pub fn linearise(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        external: &[f64],
    ) -> Linearisation {
        self.look(state, workspace, external);
        self.answer(state, workspace)
    }

    /// The first half of [`Self::linearise`]: the out-of-balance force.
    pub(crate) fn look(
        &self,
        state: &HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        external: &[f64],
    ) -> Balance {
        self.update(state, workspace);
        let internal = &workspace.internal;
        let scale_n = dot(external, external).max(dot(internal, internal)).sqrt();
        workspace.scale_n = scale_n;
        for ((residual, external), internal) in
            workspace.residual.iter_mut().zip(external).zip(internal)
        {
            *residual = external - internal;
        }
        let residual_n = dot(&workspace.residual, &workspace.residual).sqrt();
        Balance {
            imbalance: if residual_n <= workspace.round_off_n {
                0.0
            } else {
                residual_n / scale_n
            },
            change_since_refactor: change_since_refactor(state, workspace),
        }
    }

    /// The second half: what the tangent answers to the last [`Self::look`].
    pub(crate) fn answer(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
    ) -> Linearisation {
        workspace.predicted.copy_from_slice(state.unknowns());
        let residual_n = dot(&workspace.residual, &workspace.residual).sqrt();
        let turn_rad = change_since_refactor(state, workspace) / CHANGE_OF_TURN;
        let mut report = Linearisation {
            residual_n,
            residual_j: 0.0,
            contraction: 0.0,
            rotation_since_refactor_rad: turn_rad,
            refactored: false,
            asked: false,
            tangent: state.tangent,
            cg_iterations: 0,
            cg_residual: 0.0,
            sound: residual_n.is_finite(),
        };
        if !report.sound {
            return report;
        }
        state.age = state.age.saturating_add(1);
        let is_old = turn_rad > self.policy.refactor_rotation_rad
            || state.age > self.policy.refactor_every
            || state.is_poor;
        if is_old && state.moved {
            report.sound = self.refactor(state, workspace);
            report.refactored = report.sound;
            report.tangent = state.tangent;
        }
        if !report.sound || residual_n <= workspace.round_off_n {
            return report;
        }
        precondition(state, workspace);
        report.residual_j = dot(&workspace.residual, &workspace.preconditioned);
        if report.refactored || self.policy.cg_iterations == 0 {
            add(1.0, &workspace.preconditioned, &mut workspace.predicted);
        } else {
            (report.cg_iterations, report.cg_residual) =
                self.iterate(state, workspace, report.residual_j);
            // Of what is next to nothing round-off would judge; and one iteration says nothing.
            let is_judged = residual_n > LEAST_JUDGED * workspace.scale_n;
            state.is_poor = is_judged && report.cg_iterations > 1 && report.cg_residual > POOR;
        }
        report
    }

    /// Nodes, deformation gradients and internal forces at the state's displacement.
    pub(super) fn update(&self, state: &HyperelasticState, workspace: &mut HyperelasticWorkspace) {
        let HyperelasticWorkspace {
            elasticity,
            x,
            nodal,
            deformed,
            ..
        } = workspace;
        for (&node, u) in self.node.iter().zip(&state.u) {
            x[node as usize] = elasticity.rest_m()[node as usize] + Vector3::from(*u);
        }
        for (out, f) in deformed.iter_mut().zip(elasticity.deformations(x)) {
            *out = f;
        }
        elasticity.internal_force(x, nodal);
        let far = x.iter().map(|x| x.amax()).fold(0.0, f64::max);
        workspace.round_off_n = far * self.round_off_n_per_m;
        self.gather(&workspace.nodal, &mut workspace.internal);
    }

    /// What a field of all nodes is at free ones, into `out` (unknowns).
    pub(super) fn gather(&self, field: &[Vector3<f64>], out: &mut [f64]) {
        for (out, &node) in out.chunks_exact_mut(3).zip(&self.node) {
            out.copy_from_slice(field[node as usize].as_slice());
        }
    }

    /// The other way round, zero at fixed nodes.
    pub(super) fn scatter(&self, values: &[f64], out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        for (value, &node) in values.chunks_exact(3).zip(&self.node) {
            out[node as usize] = Vector3::from_column_slice(value);
        }
    }

    /// Factors the tangent at the last look; one that is not positive definite without the negative curvatures of its cells, so
    /// that only what is pressed hard answers otherwise than it would. If that is singular, with a share of its mean diagonal entry
    /// added to the diagonal, which all of the tissue feels. `false` if that did not help: the factor is then as before.
    pub(super) fn refactor(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
    ) -> bool {
        self.assemble(workspace, TangentKind::Consistent);
        if self.factor(state, workspace, TangentKind::Consistent) {
            return true;
        }
        self.assemble(workspace, TangentKind::Projected);
        let starts = &self.pattern.column_start[..self.pattern.unknowns];
        let diagonal = starts.iter().map(|&at| workspace.stiffness[at].abs());
        let mean = diagonal.sum::<f64>() / starts.len() as f64;
        let mut shift = 0.0;
        for attempt in 0..=MOST_SHIFTS {
            if self.factor(state, workspace, TangentKind::Projected) {
                return true;
            }
            let next = FIRST_SHIFT * 10f64.powi(attempt as i32);
            for &at in starts {
                workspace.stiffness[at] += (next - shift) * mean;
            }
            shift = next;
        }
        false
    }

    /// Factors what has been assembled, if it is positive definite.
    fn factor(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        kind: TangentKind,
    ) -> bool {
        let HyperelasticWorkspace {
            stiffness,
            refactor,
            deformed,
            ..
        } = workspace;
        if state
            .factor
            .refactor(&self.pattern, stiffness, refactor)
            .is_err()
        {
            return false;
        }
        state.tangent = kind;
        for (inverse, f) in state.factored.iter_mut().zip(deformed.iter()) {
            // Only of a flat cell there is none, which has no energy.
            *inverse = f.try_inverse().unwrap_or_default();
        }
        state.fingerprint = fingerprint(stiffness);
        state.age = 0;
        state.is_poor = false;
        state.moved = false;
        true
    }

    /// Lower triangle of the tangent of free nodes at the last look, into the workspace.
    pub(super) fn assemble(&self, workspace: &mut HyperelasticWorkspace, kind: TangentKind) {
        let HyperelasticWorkspace {
            elasticity,
            x,
            whole,
            stiffness,
            ..
        } = workspace;
        match kind {
            TangentKind::Consistent => elasticity.tangent(x, whole),
            TangentKind::Projected => elasticity.projected_tangent(x, whole),
        }
        for (out, &entry) in stiffness.iter_mut().zip(&self.kept) {
            *out = whole[entry];
        }
    }

    /// Conjugate gradients for K du = residual with the stale factor, added to `predicted`; the residual has been
    /// preconditioned, `first` is its square. Ends early where the tangent has no positive curvature. Iterations, and
    /// the residual before the last in units of the first.
    fn iterate(
        &self,
        state: &HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        first: f64,
    ) -> (u32, f64) {
        let enough = self.policy.cg_tolerance.powi(2) * first;
        workspace.search.copy_from_slice(&workspace.preconditioned);
        let (mut square, mut iterations) = (first, 0);
        while square > 0.0 {
            self.multiply(workspace);
            let curvature = dot(&workspace.search, &workspace.product);
            if curvature.is_nan() || curvature <= 0.0 {
                if iterations == 0 {
                    add(1.0, &workspace.search, &mut workspace.predicted);
                }
                break;
            }
            let step = square / curvature;
            add(step, &workspace.search, &mut workspace.predicted);
            add(-step, &workspace.product, &mut workspace.residual);
            iterations += 1;
            if iterations == self.policy.cg_iterations {
                break;
            }
            precondition(state, workspace);
            let next = dot(&workspace.residual, &workspace.preconditioned);
            if next <= enough {
                break;
            }
            for (search, z) in workspace.search.iter_mut().zip(&workspace.preconditioned) {
                *search = z + next / square * *search;
            }
            square = next;
        }
        let left = if first > 0.0 { square / first } else { 0.0 };
        (iterations, left.sqrt())
    }

    /// product = K search, cell by cell, K the tangent at the last look.
    pub(super) fn multiply(&self, workspace: &mut HyperelasticWorkspace) {
        self.scatter(&workspace.search, &mut workspace.direction);
        let HyperelasticWorkspace {
            elasticity,
            x,
            direction,
            nodal,
            ..
        } = workspace;
        elasticity.tangent_product(x, direction, nodal);
        self.gather(&workspace.nodal, &mut workspace.product);
    }
}

/// Largest strain and turn of a cell between the factor and the last look: F F_0^-1 - I (Frobenius norm), which counts from
/// how the cell was then, however flat.
fn change_since_refactor(state: &HyperelasticState, workspace: &HyperelasticWorkspace) -> f64 {
    let cells = workspace.deformed.iter().zip(&state.factored);
    let changes = cells.map(|(now, inverse)| (now * inverse - Matrix3::identity()).norm());
    changes.fold(0.0, f64::max)
}

fn precondition(state: &HyperelasticState, workspace: &mut HyperelasticWorkspace) {
    let z = &mut workspace.preconditioned;
    z.copy_from_slice(&workspace.residual);
    state.factor.solve(z, &mut workspace.solve);
}
