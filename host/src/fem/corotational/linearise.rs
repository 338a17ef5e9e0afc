//! One step towards balance: rotations, forces, and what the tangent says to do about them.
//!
//! Entry point: [`CorotationalTissue::linearise`]. Between refactorisations the stale factor
//! preconditions conjugate gradients on the present tangent, applied cell by cell.

use super::super::rotation::polar;
use super::cell::{self, add_force, gradient, tangent_blocks, tangent_stress};
use super::{CorotationalState, CorotationalTissue, CorotationalWorkspace};
use nalgebra::Matrix3;

/// Which tangent a factor is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TangentKind {
    /// The derivative of the forces, dR/du included.
    Consistent,
    /// The derivative was not positive definite: cells whose own is not have the rotated stiffness
    /// R K R'.
    Projected,
}

/// What one linearisation did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearisation {
    /// Norm of the out-of-balance force on the unknowns \[N\].
    pub residual_n: f64,
    /// Share of the out-of-balance force that the last step left, when measured under the present
    /// external forces: 0 for a tangent without error, 1 for a step that did nothing. 0 before the
    /// first step and in perfect balance.
    pub contraction: f64,
    /// Largest turn of a cell since the last refactorisation, before this one \[rad\].
    pub rotation_since_refactor_rad: f64,
    /// Whether the factor is new: columns computed with the last one are void.
    pub refactored: bool,
    /// Which tangent the factor is of.
    pub tangent: TangentKind,
    /// Iterations of conjugate gradients; 0 where the factor alone was used.
    pub cg_iterations: u32,
    /// Share of the residual that they left in the linear system; 0 where the factor alone was used.
    pub cg_residual: f64,
    /// False if displacement or external force are not finite, or the tangent could not be factored at
    /// all: the factor is the last good one, and nothing is predicted to move.
    pub sound: bool,
}

impl CorotationalTissue {
    /// Rotations at `state.u`, the out-of-balance force `external - internal` \[N\] (unknowns), and
    /// the u + du that the tangent answers with, in [`CorotationalWorkspace::predicted`]. Leaves `u`
    /// alone. Allocates nothing.
    pub fn linearise(
        &self,
        state: &mut CorotationalState,
        workspace: &mut CorotationalWorkspace,
        external: &[f64],
    ) -> Linearisation {
        self.update(state, workspace);
        let unbalanced = |force: &[[f64; 3]]| difference_norm(external, force.as_flattened());
        let residual_n = unbalanced(&workspace.force);
        let without_step = unbalanced(&state.force);
        let round_off = self.round_off_n * (self.unknowns() as f64).sqrt();
        let contraction = if state.linearised && without_step > round_off {
            residual_n / without_step
        } else {
            0.0
        };
        let rotation_since_refactor_rad = state.rotation_since_refactor();
        let mut report = Linearisation {
            residual_n,
            contraction,
            rotation_since_refactor_rad,
            refactored: false,
            tangent: state.tangent,
            cg_iterations: 0,
            cg_residual: 0.0,
            sound: residual_n.is_finite(),
        };
        workspace.predicted.copy_from_slice(state.unknowns());
        if !report.sound {
            return report;
        }
        state.force.copy_from_slice(&workspace.force);
        state.linearised = true;

        state.age = state.age.saturating_add(1);
        if rotation_since_refactor_rad > self.policy.refactor_rotation_rad
            || state.age > self.policy.refactor_every
        {
            report.sound = self.refactor(state, workspace);
            report.refactored = report.sound;
            report.tangent = state.tangent;
            if !report.sound {
                return report;
            }
        }
        let residual = workspace.residual.iter_mut();
        let internal = workspace.force.as_flattened();
        for ((residual, external), internal) in residual.zip(external).zip(internal) {
            *residual = external - internal;
        }
        if report.refactored || self.policy.cg_iterations == 0 {
            let du = &mut workspace.residual;
            state.factor.solve(du, 1, &mut workspace.solve);
            add(1.0, du, &mut workspace.predicted);
        } else {
            (report.cg_iterations, report.cg_residual) = self.iterate(state, workspace);
        }
        report
    }

    /// Rotations, stretches and internal forces at `state.u`. Allocates nothing.
    pub fn update(&self, state: &mut CorotationalState, workspace: &mut CorotationalWorkspace) {
        workspace.force.fill([0.0; 3]);
        for ((element, rotation), out) in self
            .elements
            .iter()
            .zip(&mut state.rotations)
            .zip(&mut workspace.polar)
        {
            let f = Matrix3::identity() + gradient(element, &state.u);
            *out = polar(&f, rotation);
            let stress = cell::stress(element, &f, out);
            add_force(element, &stress, &mut workspace.force);
        }
    }

    /// Elastic energy at the last update \[J\].
    pub fn energy_j(&self, workspace: &CorotationalWorkspace) -> f64 {
        let cells = self.elements.iter().zip(&workspace.polar);
        cells
            .map(|(element, polar)| cell::energy(element, &polar.stretch))
            .sum()
    }

    /// out = K v \[N\] with the consistent tangent at the last update, for `v` \[m\], (unknowns).
    pub fn tangent_product(
        &self,
        workspace: &mut CorotationalWorkspace,
        v: &[f64],
        out: &mut [f64],
    ) {
        self.find_twist(workspace, TangentKind::Consistent);
        workspace.direction.as_flattened_mut()[..v.len()].copy_from_slice(v);
        self.multiply(workspace);
        out.copy_from_slice(&workspace.product.as_flattened()[..v.len()]);
    }

    /// Factors the tangent at the last update: the consistent one, or else the projected one. `false` if
    /// neither is positive definite; the factor is then as before.
    pub(super) fn refactor(
        &self,
        state: &mut CorotationalState,
        workspace: &mut CorotationalWorkspace,
    ) -> bool {
        for kind in [TangentKind::Consistent, TangentKind::Projected] {
            self.assemble(workspace, kind);
            let (values, scratch) = (&workspace.stiffness, &mut workspace.refactor);
            if state
                .factor
                .refactor(&self.pattern, values, scratch)
                .is_ok()
            {
                state.tangent = kind;
                state.factored_rotations.copy_from_slice(&state.rotations);
                state.generation += 1;
                state.age = 0;
                return true;
            }
        }
        false
    }

    /// Lower triangle of the tangent at the last update.
    pub(super) fn assemble(&self, workspace: &mut CorotationalWorkspace, kind: TangentKind) {
        let values = &mut workspace.stiffness[..];
        values.fill(0.0);
        for (index, (element, polar)) in self.elements.iter().zip(&workspace.polar).enumerate() {
            let twist = cell::twist(element, &polar.stretch, kind);
            let blocks = tangent_blocks(element, &polar.rotation, &twist);
            self.pattern.add_cell(values, index, &blocks);
        }
    }

    /// Conjugate gradients for K du = residual with the stale factor, added to `predicted`. Ends early
    /// where the tangent has no positive curvature. Iterations, and the share of the residual left.
    fn iterate(
        &self,
        state: &CorotationalState,
        workspace: &mut CorotationalWorkspace,
    ) -> (u32, f64) {
        self.find_twist(workspace, state.tangent);
        let unknowns = self.unknowns();
        let start = dot(&workspace.residual, &workspace.residual).sqrt();
        let (mut left, mut last_square) = (start, f64::INFINITY);
        let mut iterations = 0;
        while iterations < self.policy.cg_iterations && left > self.policy.cg_tolerance * start {
            let z = &mut workspace.preconditioned;
            z.copy_from_slice(&workspace.residual);
            state.factor.solve(z, 1, &mut workspace.solve);
            let square = dot(&workspace.residual, z);
            let direction = &mut workspace.direction.as_flattened_mut()[..unknowns];
            let keep = square / last_square;
            for (direction, z) in direction.iter_mut().zip(z.iter()) {
                *direction = if iterations == 0 {
                    *z
                } else {
                    z + keep * *direction
                };
            }
            last_square = square;
            self.multiply(workspace);
            let direction = &workspace.direction.as_flattened()[..unknowns];
            let product = &workspace.product.as_flattened()[..unknowns];
            let curvature = dot(direction, product);
            if curvature <= 0.0 {
                if iterations == 0 {
                    add(1.0, direction, &mut workspace.predicted);
                }
                break;
            }
            let step = square / curvature;
            add(step, direction, &mut workspace.predicted);
            add(-step, product, &mut workspace.residual);
            left = dot(&workspace.residual, &workspace.residual).sqrt();
            iterations += 1;
        }
        (iterations, if start > 0.0 { left / start } else { 0.0 })
    }

    /// Twist of every cell at the last update.
    pub(super) fn find_twist(&self, workspace: &mut CorotationalWorkspace, kind: TangentKind) {
        let cells = self.elements.iter().zip(&workspace.polar);
        for ((element, polar), twist) in cells.zip(&mut workspace.twist) {
            *twist = cell::twist(element, &polar.stretch, kind);
        }
    }

    /// product = K direction, cell by cell; the twist has been found.
    pub(super) fn multiply(&self, workspace: &mut CorotationalWorkspace) {
        workspace.product.fill([0.0; 3]);
        let cells = self.elements.iter().zip(&workspace.polar);
        for ((element, polar), twist) in cells.zip(&workspace.twist) {
            let df = gradient(element, &workspace.direction);
            let dp = tangent_stress(element, &polar.rotation, twist, &df);
            add_force(element, &dp, &mut workspace.product);
        }
    }
}

impl CorotationalState {
    /// Largest turn of a cell since its tangent was factored \[rad\].
    fn rotation_since_refactor(&self) -> f64 {
        let cosine = self
            .rotations
            .iter()
            .zip(&self.factored_rotations)
            .map(|(now, then)| now.coords.dot(&then.coords).abs())
            .fold(1.0, f64::min);
        2.0 * cosine.acos()
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// to += factor x
pub(super) fn add(factor: f64, x: &[f64], to: &mut [f64]) {
    for (to, x) in to.iter_mut().zip(x) {
        *to += factor * x;
    }
}

/// Norm of a - b over the length of a.
fn difference_norm(a: &[f64], b: &[f64]) -> f64 {
    let squared = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squared.sum::<f64>().sqrt()
}
