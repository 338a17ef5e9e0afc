//! Sparse Cholesky factor of the tangent, with the rows of held nodes taken out.
//!
//! Entry points: [`Factor::new`], [`Factor::factor`], [`Factor::solve`]. faer's supernodal LLT with AMD
//! ordering on one thread. A held unknown keeps its row, with nothing but a diagonal: one analysis serves
//! every set of held nodes.

use super::pattern::Pattern;
use crate::BuildError;
use crate::memory::{self, Shortage};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// Right-hand sides that are solved for together at most.
const COLUMNS: usize = 3;
/// First shift of a matrix that is not positive definite, as a share of its mean diagonal entry; each
/// further one is ten times as large.
const FIRST_SHIFT: f64 = 1e-5;
const MOST_SHIFTS: i32 = 10;

/// Said of a mesh that is too large.
const FACTOR: &str = "the factor of its tangent";

pub(super) struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    /// The matrix without held rows, (entries of the pattern).
    reduced: Vec<f64>,
    scratch: MemBuffer,
}

impl Factor {
    pub fn new(pattern: &Pattern) -> Result<Self, BuildError> {
        let too_large = |bytes: usize| Shortage {
            what: FACTOR,
            needed_bytes: bytes as u64,
            available_bytes: memory::available_bytes().unwrap_or_default(),
        };
        let symbolic = factorize_symbolic_cholesky(
            symbolic_matrix(pattern),
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .map_err(|_| too_large(4 * size_of::<usize>() * pattern.entries()))?;
        let need = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(COLUMNS, Par::Seq));
        let bytes = size_of::<f64>() * (symbolic.len_val() + pattern.entries())
            + need.unaligned_bytes_required();
        memory::require(FACTOR, bytes as u64)?;
        Ok(Self {
            values: memory::zeros(FACTOR, symbolic.len_val())?,
            reduced: memory::zeros(FACTOR, pattern.entries())?,
            scratch: MemBuffer::try_new(need).map_err(|_| too_large(bytes))?,
            symbolic,
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
        self.symbolic
            .factorize_numeric_llt(
                &mut self.values,
                SparseColMatRef::new(symbolic_matrix(pattern), &self.reduced),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.scratch),
                Default::default(),
            )
            .is_ok()
    }

    /// Solves in place for right-hand sides one after the other, (columns x unknowns), three at most.
    pub fn solve(&mut self, rhs: &mut [f64]) {
        let n = self.symbolic.nrows();
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(rhs, n, rhs.len() / n),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
    }
}

fn symbolic_matrix(pattern: &Pattern) -> SymbolicSparseColMatRef<'_, usize> {
    let n = pattern.unknowns;
    SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_start, None, &pattern.row)
}
