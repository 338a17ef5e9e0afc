//! Small dense symmetric positive definite matrices, column-major, on one thread.
//!
//! Entry point: [`Dense`], which owns the scratch of faer's Cholesky so that nothing allocates.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::{factor, inverse, solve};
use faer::{MatMut, MatRef, Par};

/// The matrix is not positive definite.
pub(crate) struct Indefinite;

/// Scratch for matrices of up to a given size.
pub(crate) struct Dense {
    memory: MemBuffer,
}

impl Dense {
    pub fn new(largest: usize) -> Self {
        let need = StackReq::any_of(&[
            factor::cholesky_in_place_scratch::<f64>(largest, Par::Seq, Default::default()),
            inverse::inverse_scratch::<f64>(largest, Par::Seq),
            solve::solve_in_place_scratch::<f64>(largest, largest, Par::Seq),
        ]);
        Self {
            memory: MemBuffer::new(need),
        }
    }

    /// Replaces the lower triangle of `a` (n x n) by its Cholesky factor.
    pub fn factor(&mut self, a: &mut [f64], n: usize) -> Result<(), Indefinite> {
        let regularization = factor::LltRegularization::default();
        let stack = MemStack::new(&mut self.memory);
        let a = MatMut::from_column_major_slice_mut(a, n, n);
        factor::cholesky_in_place(a, regularization, Par::Seq, stack, Default::default())
            .map(|_| ())
            .map_err(|_| Indefinite)
    }

    /// Inverse (n x n), both triangles, of the matrix whose factor is `factor`.
    pub fn invert(&mut self, factor: &[f64], out: &mut [f64], n: usize) {
        inverse::inverse(
            MatMut::from_column_major_slice_mut(out, n, n),
            MatRef::from_column_major_slice(factor, n, n),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        for column in 0..n {
            for row in 0..column {
                out[row + n * column] = out[column + n * row];
            }
        }
    }

    /// Solves in place for `columns` right-hand sides (n x columns).
    pub fn solve(&mut self, factor: &[f64], n: usize, rhs: &mut [f64], columns: usize) {
        solve::solve_in_place(
            MatRef::from_column_major_slice(factor, n, n),
            MatMut::from_column_major_slice_mut(rhs, n, columns),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}
