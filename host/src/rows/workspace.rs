//! Buffers of a solve, and its end: forces, residual and flags in the problem's own rows.

use super::gauss_seidel;
use super::residual::{gaps, residuals};
use super::scaled::{Law, Scaled};
use super::state::{Mode, State, Warm};
use super::{Outcome, Problem, Status, TOLERANCE};
use sutura_factor::{Dense, Lu, prepare_thread};

/// What is wrong with a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowFlag {
    /// Nothing.
    None,
    /// Other active rows imply it, or nothing can act on it.
    Redundant,
    /// It takes part in a conflict of targets.
    Incompatible,
}

/// Scratch for sets of up to a given number of rows.
pub struct Workspace {
    largest: usize,
    pub(super) scaled: Scaled,
    pub(super) warm: Warm,
    pub(super) flags: Vec<RowFlag>,
    pub(super) vectors: Vectors,
    /// Factor of the equality rows, (e x e).
    pub(super) equality: Vec<f64>,
    /// L_e^-1 W_eo, (e x m).
    pub(super) cross: Vec<f64>,
    /// Schur complement of the other rows, (m x m).
    pub(super) schur: Vec<f64>,
    pub(super) active: Active,
    /// Whether the factors are of the held rows of the last solve.
    pub(super) is_factored: bool,
    /// Right-hand sides of the reduction, (n x n + 6).
    pub(super) columns: Vec<f64>,
    /// The same before they are solved for, and products of both.
    pub(super) loads: Vec<f64>,
    pub(super) answered: Vec<f64>,
}

/// The factor that changes with the active set.
pub(super) struct Active {
    pub matrix: Vec<f64>,
    pub rows: Vec<usize>,
    pub rhs: Vec<f64>,
    /// Laws of a problem with less friction.
    pub laws: Vec<Law>,
    pub dense: Dense,
    pub lu: Lu,
}

impl Active {
    pub fn new(largest: usize) -> Self {
        Self {
            matrix: vec![0.0; largest * largest],
            rows: Vec::with_capacity(largest),
            rhs: vec![0.0; largest],
            laws: Vec::with_capacity(largest),
            // The reduction solves for the rows it keeps and six directions.
            dense: Dense::new(largest + 6),
            lu: Lu::new(largest + 6),
        }
    }
}

/// Vectors by position.
pub(super) struct Vectors {
    pub modes: Vec<Mode>,
    pub lambda: Vec<f64>,
    /// delta~ of the other rows at lambda.
    pub delta: Vec<f64>,
    /// Right-hand side of the other rows with the equality rows eliminated.
    pub condensed: Vec<f64>,
    /// L_e^-1 delta_free~ of the equality rows.
    pub equality: Vec<f64>,
    /// Proximal centre: lambda~ of the step before.
    pub centre: Vec<f64>,
    /// Shift of targets that makes the rows compatible.
    pub shift: Vec<f64>,
    pub trial: Vec<f64>,
    pub trial_delta: Vec<f64>,
    pub best: Vec<f64>,
}

/// How a solver ended.
pub(super) struct Finish {
    pub iterations: u32,
}

impl Workspace {
    /// For sets of up to so many rows, for use on this thread: on another one the first solve
    /// allocates that thread's buffer for products.
    pub fn new(largest: usize) -> Self {
        prepare_thread();
        let square = || vec![0.0; largest * largest];
        let vector = || vec![0.0; largest];
        Self {
            largest,
            scaled: Scaled::new(largest),
            warm: Warm {
                rows: Vec::with_capacity(largest),
            },
            flags: Vec::with_capacity(largest),
            vectors: Vectors {
                modes: vec![Mode::Held; largest],
                lambda: vector(),
                delta: vector(),
                condensed: vector(),
                equality: vector(),
                centre: vector(),
                shift: vector(),
                trial: vector(),
                trial_delta: vector(),
                best: vector(),
            },
            equality: square(),
            cross: square(),
            schur: square(),
            active: Active::new(largest),
            is_factored: false,
            columns: vec![0.0; largest * (largest + 6)],
            loads: square(),
            answered: vec![0.0; largest * (largest + 6)],
        }
    }

    /// Flags of the rows solved last, in the problem's order.
    pub fn flags(&self) -> &[RowFlag] {
        &self.flags
    }

    pub(super) fn largest(&self) -> usize {
        self.largest
    }

    /// Forces and modes into `state`, and the outcome from the residual they leave.
    pub(super) fn conclude(
        &mut self,
        problem: &Problem,
        finish: Finish,
        state: &mut State,
    ) -> Outcome {
        let n = problem.rows.len();
        let (scaled, vectors) = (&self.scaled, &mut self.vectors);
        let mut outcome = Outcome::refused(Status::Ok);
        outcome.iterations = finish.iterations;
        gauss_seidel::project(&scaled.law, &mut vectors.lambda[..n]);
        for (at, &row) in scaled.order.iter().enumerate() {
            let lambda = vectors.lambda[at] * scaled.scale[at];
            if !lambda.is_finite() {
                state.rest(problem.rows);
                outcome.status = Status::NotFinite;
                return outcome;
            }
            state.lambda[row] = lambda;
            state.modes[row] = vectors.modes[at];
            let shift = vectors.shift[at] / scaled.scale[at];
            outcome.conflict_m = outcome.conflict_m.max(shift.abs());
            // The targets that were solved for.
            vectors.trial[row] = problem.delta_free[row] + shift;
        }
        gaps(problem, &state.lambda, &mut state.delta);
        let solved = Problem {
            delta_free: &vectors.trial[..n],
            ..*problem
        };
        let trial_delta = &mut vectors.trial_delta[..n];
        if vectors.shift[..n].iter().any(|shift| *shift != 0.0) {
            gaps(&solved, &state.lambda, trial_delta);
        } else {
            trial_delta.copy_from_slice(&state.delta);
        }
        outcome.residual = residuals(&solved, &state.lambda, &vectors.trial_delta[..n]).largest();
        for (at, &row) in scaled.order.iter().enumerate() {
            let held = scaled.law[at] != Law::NONE && state.modes[row] == Mode::Held;
            outcome.active += usize::from(held);
            outcome.slipping += usize::from(state.modes[row] == Mode::Slipping);
        }
        let flagged = |flag| self.flags.contains(&flag);
        // Not the other way round: a residual that is no number has not converged.
        let solved = outcome.residual <= TOLERANCE;
        outcome.status = if !solved {
            Status::NotConverged
        } else if flagged(RowFlag::Incompatible) {
            Status::Incompatible
        } else if flagged(RowFlag::Redundant) {
            Status::Redundant
        } else {
            Status::Ok
        };
        outcome
    }
}
