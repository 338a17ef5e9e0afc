//! One step towards balance: rotations, forces, and what the tangent says to do about them.
//!
//! Entry point: [`CorotationalTissue::linearise`]. Between refactorisations the stale factor
//! preconditions conjugate gradients on the present tangent, applied cell by cell.

use super::super::element::Element;
use super::super::rotation::{Polar, polar};
use super::cell::{self, add_force, gradient, tangent_blocks, tangent_stress};
use super::{Beside, CorotationalState, CorotationalTissue, CorotationalWorkspace};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::Serialize;

/// Which tangent a factor is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum TangentKind {
    /// The derivative of the forces, dR/du included.
    Consistent,
    /// The derivative was not positive definite: cells whose own is not have one that is. Of corotational tissue the rotated
    /// stiffness R K R', of hyperelastic tissue the derivative without its negative curvatures.
    Projected,
}

/// How far from balance the tissue is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Balance {
    /// Norm of the out-of-balance force over the larger of those of external and internal forces; 0
    /// within round-off.
    pub imbalance: f64,
    /// Largest turn \[rad\] plus change of stretch (Frobenius norm) of a cell since the factor was made.
    pub change_since_refactor: f64,
}

/// What one linearisation did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearisation {
    /// Norm of the out-of-balance force r on the unknowns \[N\]. It can rise while the tissue gets nearer
    /// to balance: a little error in a stiff direction is a large force.
    pub residual_n: f64,
    /// r'K^-1 r with the factored K \[J\], twice the energy that is still to be released.
    pub residual_j: f64,
    /// What the last step left, in the energy norm, over the step itself: sqrt(r'K^-1 r / r0'du), r0
    /// the old internal force under the present external one. 0 for a tangent without error, before the
    /// first step and in balance; 1 for a step that did nothing; above 1 it did harm. Meant for steps
    /// between which only the rows' forces change, with the step: loads that changed since and
    /// fixed nodes that were moved count as left (steady motion by loads alone reads 0.71). Of hyperelastic tissue it
    /// is not kept: 0.
    pub contraction: f64,
    /// Largest turn of a cell since the last refactorisation, before this one \[rad\]; of hyperelastic tissue a change
    /// of stretch counts, too.
    pub rotation_since_refactor_rad: f64,
    /// Whether the factor is new: columns computed with the last one are void.
    pub refactored: bool,
    /// Whether a factor of this tangent was asked for, to be made beside the steps.
    pub asked: bool,
    /// Which tangent the factor is of.
    pub tangent: TangentKind,
    /// Iterations of conjugate gradients; 0 where the factor alone was used.
    pub cg_iterations: u32,
    /// What was left of the energy norm before the last iteration, 1 at the first; 0 where the factor
    /// alone was used.
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
        self.look(state, workspace, external);
        self.answer(state, workspace, external, None)
    }

    /// The first half of [`Self::linearise`]: rotations at `state.u` and the out-of-balance force.
    pub(crate) fn look(
        &self,
        state: &mut CorotationalState,
        workspace: &mut CorotationalWorkspace,
        external: &[f64],
    ) -> Balance {
        self.update(state, workspace);
        let internal = workspace.internal_force();
        let scale_n = dot(external, external).max(dot(internal, internal)).sqrt();
        for ((residual, external), internal) in workspace
            .residual
            .iter_mut()
            .zip(external)
            .zip(workspace.force.as_flattened())
        {
            *residual = external - internal;
        }
        let residual_n = dot(&workspace.residual, &workspace.residual).sqrt();
        Balance {
            imbalance: if self.is_round_off(residual_n) {
                0.0
            } else {
                residual_n / scale_n
            },
            change_since_refactor: state.change_since_refactor(&workspace.polar),
        }
    }

    /// The second half: what the tangent answers to the last [`Self::look`]. With `beside` a factor that gets old is
    /// asked for, and made here only where it is of no help any more.
    pub(crate) fn answer(
        &self,
        state: &mut CorotationalState,
        workspace: &mut CorotationalWorkspace,
        external: &[f64],
        beside: Option<Beside>,
    ) -> Linearisation {
        workspace.predicted.copy_from_slice(state.unknowns());
        let internal = workspace.force.as_flattened();
        let residual_n = dot(&workspace.residual, &workspace.residual).sqrt();
        let mut report = Linearisation {
            residual_n,
            residual_j: 0.0,
            contraction: 0.0,
            rotation_since_refactor_rad: state.rotation_since_refactor(),
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
        let step_j = state.work_of_step(external);
        state.last_u.copy_from_slice(&workspace.predicted);
        state
            .last_force
            .copy_from_slice(&internal[..external.len()]);
        state.linearised = true;

        state.age = state.age.saturating_add(1);
        let turn_rad = report.rotation_since_refactor_rad;
        let is_old = match beside {
            Some(beside) => self.is_helpless(turn_rad, beside.helpless),
            None => {
                turn_rad > self.policy.refactor_rotation_rad
                    || state.age > self.policy.refactor_every
            }
        };
        let is_ageing = |beside: Beside| self.is_ageing(state, turn_rad, beside.idle);
        if !is_old && state.moved && beside.is_some_and(is_ageing) {
            report.asked = state.ask(workspace);
        }
        if is_old && state.moved {
            report.sound = self.refactor(state, workspace);
            report.refactored = report.sound;
            report.tangent = state.tangent;
            if !report.sound {
                return report;
            }
        }
        if self.is_round_off(residual_n) {
            return report;
        }
        precondition(state, workspace);
        report.residual_j = dot(&workspace.residual, &workspace.preconditioned);
        report.contraction = match step_j {
            Some(step) if step > 0.0 => (report.residual_j / step).max(0.0).sqrt(),
            Some(_) => 1.0,
            None => 0.0,
        };
        if report.refactored || self.policy.cg_iterations == 0 {
            add(1.0, &workspace.preconditioned, &mut workspace.predicted);
        } else {
            (report.cg_iterations, report.cg_residual) =
                self.iterate(state, workspace, report.residual_j);
        }
        report
    }

    pub(super) fn is_round_off(&self, residual_n: f64) -> bool {
        residual_n <= self.round_off_n * (self.unknowns() as f64).sqrt()
    }

    /// Largest change of a cell's deformation gradient (Frobenius norm) since the last linearisation.
    pub(crate) fn change_since_linearised(&self, state: &CorotationalState) -> f64 {
        let u = state.unknowns();
        let moved = |place: u32| {
            let first = 3 * place as usize;
            match (u.get(first..first + 3), state.last_u.get(first..first + 3)) {
                (Some(now), Some(then)) => {
                    Vector3::new(now[0] - then[0], now[1] - then[1], now[2] - then[2])
                }
                _ => Vector3::zeros(), // fixed
            }
        };
        let change = |element: &Element| {
            let corners = element.nodes.iter().zip(&element.gradients);
            let sum: Matrix3<f64> = corners.map(|(a, g)| moved(*a) * g.transpose()).sum();
            sum.norm()
        };
        self.elements.iter().map(change).fold(0.0, f64::max)
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
                for (factored, polar) in state.factored_stretches.iter_mut().zip(&workspace.polar) {
                    *factored = polar.stretch;
                }
                state.generation += 1;
                state.fingerprint = fingerprint(values);
                state.age = 0;
                state.moved = false;
                state.asked.forgo();
                return true;
            }
        }
        false
    }

    /// Lower triangle of the tangent at the last update.
    pub(super) fn assemble(&self, workspace: &mut CorotationalWorkspace, kind: TangentKind) {
        let cells = workspace.polar.iter().copied();
        self.assemble_of(cells, &mut workspace.stiffness, kind);
    }

    /// Lower triangle of the tangent of cells that are turned and stretched so.
    pub(super) fn assemble_of(
        &self,
        cells: impl Iterator<Item = Polar>,
        values: &mut [f64],
        kind: TangentKind,
    ) {
        values.fill(0.0);
        for (index, (element, polar)) in self.elements.iter().zip(cells).enumerate() {
            let twist = cell::twist(element, &polar.stretch, kind);
            let blocks = tangent_blocks(element, &polar.rotation, &twist);
            self.pattern.add_cell(values, index, &blocks);
        }
    }

    /// Conjugate gradients for K du = residual with the stale factor, added to `predicted`; the
    /// residual has been preconditioned, `first` is its square. Ends early where the tangent has no
    /// positive curvature. Iterations, and the residual before the last in units of the first.
    fn iterate(
        &self,
        state: &CorotationalState,
        workspace: &mut CorotationalWorkspace,
        first: f64,
    ) -> (u32, f64) {
        self.find_twist(workspace, state.tangent);
        let unknowns = self.unknowns();
        let enough = self.policy.cg_tolerance.powi(2) * first;
        workspace.direction.as_flattened_mut()[..unknowns]
            .copy_from_slice(&workspace.preconditioned);
        let mut square = first;
        let mut iterations = 0;
        while square > 0.0 {
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
            iterations += 1;
            if iterations == self.policy.cg_iterations {
                break;
            }
            precondition(state, workspace);
            let next = dot(&workspace.residual, &workspace.preconditioned);
            if next <= enough {
                break;
            }
            let direction = &mut workspace.direction.as_flattened_mut()[..unknowns];
            for (direction, z) in direction.iter_mut().zip(&workspace.preconditioned) {
                *direction = z + next / square * *direction;
            }
            square = next;
        }
        let left = if first > 0.0 { square / first } else { 0.0 };
        (iterations, left.sqrt())
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
    /// r0'du of the step since the last linearisation \[J\], r0 what was out of balance before it under
    /// the present external force; `None` before the first.
    fn work_of_step(&self, external: &[f64]) -> Option<f64> {
        let forces = external.iter().zip(&self.last_force);
        let steps = self.unknowns().iter().zip(&self.last_u);
        let work = forces.zip(steps).map(|((f, g), (u, v))| (f - g) * (u - v));
        self.linearised.then(|| work.sum())
    }

    /// Largest turn plus change of stretch of a cell since its tangent was factored.
    fn change_since_refactor(&self, polar: &[Polar]) -> f64 {
        let turns = self.rotations.iter().zip(&self.factored_rotations);
        let stretches = polar.iter().zip(&self.factored_stretches);
        turns
            .zip(stretches)
            .map(|((now, then), (polar, stretch))| {
                // Chord for angle: exact to third order, without the arc cosine's loss near 1.
                let sign = now.coords.dot(&then.coords).signum();
                let turn = 2.0 * (now.coords - then.coords * sign).norm();
                turn + (polar.stretch - stretch).norm()
            })
            .fold(0.0, f64::max)
    }

    /// Largest turn of a cell since its tangent was factored \[rad\].
    pub(super) fn rotation_since_refactor(&self) -> f64 {
        self.rotation_since(&self.factored_rotations)
    }

    /// Largest turn of a cell from `then`, (m) \[rad\].
    pub(super) fn rotation_since(&self, then: &[UnitQuaternion<f64>]) -> f64 {
        let cosine = self
            .rotations
            .iter()
            .zip(then)
            .map(|(now, then)| now.coords.dot(&then.coords).abs())
            .fold(1.0, f64::min);
        2.0 * cosine.acos()
    }
}

/// FNV-1a over the bits (Fowler, Noll & Vo 1991): equal for equal tangents, and as good as never
/// otherwise. Odd, because 0 stands for the factor at rest.
pub(in super::super) fn fingerprint(values: &[f64]) -> u64 {
    let mix = |hash: u64, value: &f64| (hash ^ value.to_bits()).wrapping_mul(0x0100_0000_01b3);
    values.iter().fold(0xcbf2_9ce4_8422_2325, mix) | 1
}

fn precondition(state: &CorotationalState, workspace: &mut CorotationalWorkspace) {
    let z = &mut workspace.preconditioned;
    z.copy_from_slice(&workspace.residual);
    state.factor.solve(z, &mut workspace.solve);
}

pub(in super::super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// to += factor x
pub(in super::super) fn add(factor: f64, x: &[f64], to: &mut [f64]) {
    for (to, x) in to.iter_mut().zip(x) {
        *to += factor * x;
    }
}
