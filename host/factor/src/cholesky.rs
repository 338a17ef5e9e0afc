//! Sparse Cholesky factors: faer's supernodal LLT with AMD ordering on one thread.

use crate::Indefinite;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// Where a symmetric matrix (n x n) has entries: its lower triangle, column by column.
#[derive(Clone, Copy, Debug)]
pub struct Lower<'a> {
    /// Where each column begins among the entries, and the end of the last, (n + 1).
    pub column_start: &'a [usize],
    /// Rows of the entries, ascending in each column, (entries).
    pub row: &'a [usize],
}

/// What a factor `L L' = P K P'` has of the pattern alone: the order of elimination and where its entries lie.
#[derive(Debug)]
pub struct Cholesky {
    pub(crate) symbolic: SymbolicCholesky<usize>,
}

/// Memory for a factorisation or for solves.
pub struct Scratch {
    memory: MemBuffer,
}

/// The allocator had no such piece.
#[derive(Debug)]
pub struct NoMemory;

impl Lower<'_> {
    fn matrix(&self) -> SymbolicSparseColMatRef<'_, usize> {
        let n = self.column_start.len() - 1;
        SymbolicSparseColMatRef::new_checked(n, n, self.column_start, None, self.row)
    }
}

impl Cholesky {
    /// Finds the order of elimination.
    ///
    /// # Errors
    /// If the allocator has no memory for it.
    pub fn analyse(pattern: Lower<'_>) -> Result<Self, NoMemory> {
        let symbolic = factorize_symbolic_cholesky(
            pattern.matrix(),
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        );
        symbolic
            .map(|symbolic| Self { symbolic })
            .map_err(|_| NoMemory)
    }

    /// Non-zeros of the factor, padding included.
    pub fn entries(&self) -> usize {
        self.symbolic.len_val()
    }

    /// Factors `values` (entries of the pattern) into `factor` (entries of the factor).
    ///
    /// # Errors
    /// If the matrix is not positive definite.
    pub fn factor(
        &self,
        pattern: Lower<'_>,
        values: &[f64],
        factor: &mut [f64],
        scratch: &mut Scratch,
    ) -> Result<(), Indefinite> {
        self.symbolic
            .factorize_numeric_llt(
                factor,
                SparseColMatRef::new(pattern.matrix(), values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut scratch.memory),
                Default::default(),
            )
            .map(|_| ())
            .map_err(|_| Indefinite)
    }

    /// Solves in place for right-hand sides one after the other, (columns x n), at most as many as `scratch` was made for.
    pub fn solve(&self, factor: &[f64], rhs: &mut [f64], scratch: &mut Scratch) {
        let n = self.symbolic.nrows();
        LltRef::new(&self.symbolic, factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(rhs, n, rhs.len().checked_div(n).unwrap_or(0)),
            Par::Seq,
            MemStack::new(&mut scratch.memory),
        );
    }

    /// Memory for [`Self::factor`].
    ///
    /// # Errors
    /// If the allocator has none.
    pub fn try_factor_scratch(&self) -> Result<Scratch, NoMemory> {
        match MemBuffer::try_new(self.factor_need()) {
            Ok(memory) => Ok(Scratch { memory }),
            Err(_) => Err(NoMemory),
        }
    }

    /// As [`Self::try_factor_scratch`] where there has been as much memory before.
    pub fn factor_scratch(&self) -> Scratch {
        Scratch {
            memory: MemBuffer::new(self.factor_need()),
        }
    }

    /// Bytes of [`Self::factor_scratch`].
    pub fn factor_bytes(&self) -> usize {
        self.factor_need().unaligned_bytes_required()
    }

    /// Memory for [`Self::solve`] of up to so many `columns`.
    pub fn solve_scratch(&self, columns: usize) -> Scratch {
        let need = (self.symbolic).solve_in_place_scratch::<f64>(columns, Par::Seq);
        Scratch {
            memory: MemBuffer::new(need),
        }
    }

    fn factor_need(&self) -> StackReq {
        (self.symbolic).factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
    }
}
