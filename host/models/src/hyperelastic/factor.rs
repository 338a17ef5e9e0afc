//! Sparse Cholesky factor of the tangent, with the rows of held nodes taken out.
//!
//! Entry points: [`Factor::new`], [`Factor::factor`], [`Factor::solve`]. A held unknown keeps its row,
//! with nothing but a diagonal: one analysis serves every set of held nodes.

use super::pattern::Pattern;
use crate::BuildError;
use crate::memory::{self, Shortage};
use sutura_factor::{Cholesky, Scratch};

/// Right-hand sides that are solved for together at most.
const COLUMNS: usize = 3;
/// First shift of a matrix that is not positive definite, as a share of its mean diagonal entry; each
/// further one is ten times as large.
const FIRST_SHIFT: f64 = 1e-5;
const MOST_SHIFTS: i32 = 10;

/// Said of a mesh that is too large.
const FACTOR: &str = "the factor of its tangent";

pub(super) struct Factor {
    cholesky: Cholesky,
    values: Vec<f64>,
    /// The matrix without held rows, (entries of the pattern).
    reduced: Vec<f64>,
    to_factor: Scratch,
    to_solve: Scratch,
}

impl Factor {
    pub fn new(pattern: &Pattern) -> Result<Self, BuildError> {
        let too_large = |bytes: usize| Shortage {
            what: FACTOR,
            needed_bytes: bytes as u64,
            available_bytes: memory::available_bytes().unwrap_or_default(),
        };
        let cholesky = Cholesky::analyse(pattern.lower())
            .map_err(|_| too_large(4 * size_of::<usize>() * pattern.entries()))?;
        let bytes =
            size_of::<f64>() * (cholesky.entries() + pattern.entries()) + cholesky.factor_bytes();
        memory::require(FACTOR, bytes as u64)?;
        Ok(Self {
            values: memory::zeros(FACTOR, cholesky.entries())?,
            reduced: memory::zeros(FACTOR, pattern.entries())?,
            to_factor: cholesky
                .try_factor_scratch()
                .map_err(|_| too_large(bytes))?,
            to_solve: cholesky.solve_scratch(COLUMNS),
            cholesky,
        })
    }

    /// Factors `values` without the rows and columns of `held` nodes. A matrix that is not positive
    /// definite has a share of its mean diagonal entry added to its diagonal, tenfold until it is: the
    /// share is returned, zero for none; `None`: it is not a number.
    pub fn factor(&mut self, pattern: &Pattern, values: &[f64], held: &[bool]) -> Option<f64> {
        let n = pattern.unknowns;
        let mean = (0..n)
            .map(|unknown| values[pattern.diagonal(unknown)].abs())
            .sum::<f64>()
            / n as f64;
        if !(mean.is_finite() && mean > 0.0) {
            return None;
        }
        for column in 0..n {
            let column_held = held[column / 3];
            let range = pattern.column_start[column]..pattern.column_start[column + 1];
            let entries = pattern.row[range.clone()]
                .iter()
                .zip(&values[range.clone()]);
            for (reduced, (&row, &value)) in self.reduced[range].iter_mut().zip(entries) {
                *reduced = match (column_held || held[row / 3], row == column) {
                    (false, _) => value,
                    (true, true) => mean,
                    (true, false) => 0.0,
                };
            }
        }
        let mut shift = 0.0;
        for attempt in 0..=MOST_SHIFTS {
            if self.numeric(pattern) {
                return Some(shift);
            }
            let next = FIRST_SHIFT * 10f64.powi(attempt);
            for unknown in 0..n {
                self.reduced[pattern.diagonal(unknown)] += (next - shift) * mean;
            }
            shift = next;
        }
        None
    }

    fn numeric(&mut self, pattern: &Pattern) -> bool {
        self.cholesky
            .factor(
                pattern.lower(),
                &self.reduced,
                &mut self.values,
                &mut self.to_factor,
            )
            .is_ok()
    }

    /// Solves in place for right-hand sides one after the other, (columns x unknowns), three at most.
    pub fn solve(&mut self, rhs: &mut [f64]) {
        self.cholesky.solve(&self.values, rhs, &mut self.to_solve);
    }
}
