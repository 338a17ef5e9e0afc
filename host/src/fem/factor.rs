//! Sparse Cholesky factor of a stiffness matrix, and solves that reuse their buffers.
//!
//! Entry points: [`Factor::new`], [`Factor::solve`]. faer's supernodal LLT with AMD ordering on one
//! thread: two threads are slower below some ten thousand nodes, and one gives the same bits always.

use super::assembly::LowerTriangle;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// `L L' = P K P'`.
#[derive(Debug)]
pub(super) struct Factor {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
}

/// The matrix is not positive definite, or too large for memory.
#[derive(Debug)]
pub(super) struct NotFactored;

/// Memory for solves of up to a given number of right-hand sides.
pub(crate) struct SolveScratch {
    memory: MemBuffer,
    columns: usize,
}

impl Factor {
    pub fn new(matrix: &LowerTriangle) -> Result<Self, NotFactored> {
        let n = matrix.unknowns;
        let pattern =
            SymbolicSparseColMatRef::new_checked(n, n, &matrix.column_start, None, &matrix.row);
        let symbolic = factorize_symbolic_cholesky(
            pattern,
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .map_err(|_| NotFactored)?;
        let mut values = vec![0.0; symbolic.len_val()];
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| NotFactored)?;
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern, &matrix.value),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .map_err(|_| NotFactored)?;
        Ok(Self { symbolic, values })
    }

    pub fn scratch(&self, columns: usize) -> SolveScratch {
        let need = self
            .symbolic
            .solve_in_place_scratch::<f64>(columns, Par::Seq);
        SolveScratch {
            memory: MemBuffer::new(need),
            columns,
        }
    }

    /// Solves for `columns` right-hand sides in place, (columns x unknowns), one after the other in
    /// memory. Allocates only if the scratch was made for fewer.
    pub fn solve(&self, rhs: &mut [f64], columns: usize, scratch: &mut SolveScratch) {
        if columns > scratch.columns {
            *scratch = self.scratch(columns);
        }
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(rhs, self.symbolic.nrows(), columns),
            Par::Seq,
            MemStack::new(&mut scratch.memory),
        );
    }

    /// Non-zeros of the factor, padding included.
    pub fn len(&self) -> usize {
        self.values.len()
    }
}
