//! Forces of constraint rows on a dense compliance: a mixed complementarity problem.
//!
//! Entry point: [`solve`]. Rows `C u = b` or `C u <= b` on tissue `K u + C' lambda = f` leave
//! `delta = b - C u = delta_free + W lambda` with `W = C K^-1 C'` (younes-2021 2.2). Without friction
//! it is the optimality condition of `min 1/2 lambda' W lambda + delta_free' lambda` over the bounds
//! of lambda, so a solution is unique in `W lambda`, and the set of rows with `delta = 0` is found by
//! a primal-dual active set (Hintermueller, Ito & Kunisch 2002). With Coulomb cones it is no
//! minimum: a semismooth Newton method (Alart & Curnier 1991) over open, sticking and slipping.
//!
//! # Which set is solved
//! All rows are scaled by `d_i = W_ii^(-1/2)` (both tangents of a cone by the same), so that W has a
//! unit diagonal and metres and newtons become square roots of energy: `delta~ = d delta`,
//! `lambda~ = lambda / d`. Every tolerance here is on scaled rows, relative to
//! `max drive~ + 1e-6 max |lambda~|`, where a row's drive is what makes it act: |delta_free| for
//! equality and box rows (up to the limit), penetration for the others.
//!
//! Equality rows are eliminated first (Cholesky); the search works on the Schur complement of the
//! others. When a pivot falls below 1e-10 the rows are dependent. Then `W~ + 1e-8 I` is solved, whose
//! solution always exists and is unique without friction, and brought to the solution of W by
//! proximal steps `delta_free~ - 1e-8 lambda~` (Rockafellar 1976); of all forces on dependent rows it
//! is the smallest. What a step does not gain is a conflict between targets, the smallest in the
//! sense of least squares of scaled rows. Targets are shifted by it and the then compatible rows
//! solved again, so that no force grows beyond what the rest asks for. Rows that are dependent to
//! some 1e-4 only end between the two: what is left of their targets, which only forces without
//! bound could reach, is reported as a conflict.

mod active_set;
mod answer;
mod bounded;
mod cone;
mod coulomb;
mod gauss_seidel;
mod reduction;
mod residual;
mod scaled;
mod slip;
mod state;
#[cfg(test)]
mod tests;
mod workspace;

pub use reduction::{Condensed, Reduction, condense, tangent};
pub use residual::{Residuals, gaps, residuals};
pub use state::{Mode, State};
pub use workspace::{RowFlag, Workspace};

use scaled::Fault;
use serde::Serialize;

/// Largest scaled residual of a solved set.
pub const TOLERANCE: f64 = 1e-8;

/// What a row may do. `lambda` \[N\] acts on the tissue as `-C' lambda`, `delta` \[m\] is what is left
/// of the target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum RowKind {
    /// `delta = 0`, lambda free.
    Equality,
    /// `0 <= lambda`, `delta >= 0`, `lambda delta = 0`.
    Inequality,
    /// `|lambda| <= limit`: `delta = 0` strictly inside, `delta <= 0` at `+limit`, `delta >= 0` at
    /// `-limit`.
    Box {
        /// Largest force \[N\], not negative; infinite makes an equality row.
        limit_n: f64,
    },
    /// `least <= lambda <= most`: `delta = 0` strictly inside, `delta <= 0` at `most`, `delta >= 0` at `least`.
    Between {
        /// Smallest force \[N\], not positive.
        least_n: f64,
        /// Largest force \[N\], not negative.
        most_n: f64,
    },
    /// An inequality row along a contact normal, followed by its two [`RowKind::Tangent`] rows along
    /// orthogonal unit vectors.
    Normal {
        /// Coulomb's coefficient, not negative, finite.
        friction: f64,
    },
    /// Part of the cone of the [`RowKind::Normal`] row before: `|lambda_t| <= friction lambda_n`,
    /// `delta_t = 0` strictly inside, `lambda_t = -friction lambda_n delta_t / |delta_t|` when it slips.
    /// Behind a [`RowKind::Disc`], the second row of that.
    Tangent,
    /// With the one [`RowKind::Tangent`] row that follows, along orthogonal unit vectors: Coulomb's cone at a given normal
    /// force. `|lambda| <= limit`, `delta = 0` strictly inside, `lambda = -limit delta / |delta|` when it slips.
    Disc {
        /// Largest force of both rows together \[N\], not negative; infinite makes two equality rows.
        limit_n: f64,
    },
}

/// A row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Names the row from one solve to the next; unique in a set.
    pub id: u64,
    /// What it may do.
    pub kind: RowKind,
}

/// A set of rows on a compliance.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// The rows, (n).
    pub rows: &'a [Row],
    /// W \[m/N\], (n x n), column-major, symmetric positive semidefinite, both triangles.
    pub compliance: &'a [f64],
    /// delta at lambda = 0 \[m\], (n).
    pub delta_free: &'a [f64],
}

/// How to solve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Method {
    /// Exact; finds redundant and incompatible rows.
    #[default]
    ActiveSet,
    /// Projected Gauss-Seidel, a cone at a time: cheap for a few sweeps, slow on stiff sets. It does
    /// not look for redundant rows; conflicts end in [`Status::NotConverged`].
    GaussSeidel {
        /// Most sweeps over all rows.
        sweeps: u32,
        /// Scaled residual at which to stop.
        tolerance: f64,
    },
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Solved.
    Ok,
    /// Solved; some rows say what others say already ([`RowFlag::Redundant`]).
    Redundant,
    /// Some rows contradict others ([`RowFlag::Incompatible`]): solved for the compromise, which is
    /// `conflict_m` away from the targets.
    Incompatible,
    /// The forces obey their bounds but the residual is above the tolerance.
    NotConverged,
    /// NaN or infinity among the numbers, or beyond what f64 can scale; all forces are zero.
    NotFinite,
    /// Negative limit, friction or diagonal, `W_ij^2 > W_ii W_jj`, lengths that do not match, tangents
    /// without their normal; all forces are zero.
    Malformed,
    /// More rows than the workspace was made for; there are no forces.
    TooManyRows,
}

/// What came of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// How it ended.
    pub status: Status,
    /// Factorisations of the active set, or sweeps.
    pub iterations: u32,
    /// Largest scaled residual ([`Residuals`]) of the rows with the targets they were solved for.
    pub residual: f64,
    /// Largest violation that is left to incompatible rows \[m\].
    pub conflict_m: f64,
    /// Rows held at delta = 0, slipping normals included.
    pub active: usize,
    /// Tangents that slip.
    pub slipping: usize,
}

impl Outcome {
    fn refused(status: Status) -> Self {
        Self {
            status,
            iterations: 0,
            residual: 0.0,
            conflict_m: 0.0,
            active: 0,
            slipping: 0,
        }
    }
}

/// Finds the forces of `problem`'s rows, starting from what `state` knows of their ids, and leaves
/// them in `state`. Allocates nothing; same input, same bits.
///
/// # Errors
/// None: see [`Status`]. Forces are finite and within their bounds whatever the input.
pub fn solve(
    problem: &Problem,
    method: Method,
    state: &mut State,
    work: &mut Workspace,
) -> Outcome {
    let n = problem.rows.len();
    if n > state.largest().min(work.largest()) {
        state.clear();
        return Outcome::refused(Status::TooManyRows);
    }
    work.forget_factors();
    state.recall(problem.rows, &mut work.warm);
    state.rest(problem.rows);
    work.flags.clear();
    work.flags.resize(n, RowFlag::None);
    let prepared = match method {
        Method::ActiveSet => work.scaled.prepare(problem, true),
        Method::GaussSeidel { .. } => work.scaled.prepare(problem, false),
    };
    if let Err(fault) = prepared {
        return Outcome::refused(match fault {
            Fault::NotFinite => Status::NotFinite,
            Fault::Malformed => Status::Malformed,
        });
    }
    let finish = match method {
        Method::ActiveSet => active_set::solve(problem, work),
        Method::GaussSeidel { sweeps, tolerance } => {
            gauss_seidel::solve(problem, sweeps, tolerance, work)
        }
    };
    work.conclude(problem, finish, state)
}
