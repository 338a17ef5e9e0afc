//! Small dense matrices, column-major, on one thread.
//!
//! Entry points: [`Dense`] for symmetric positive definite matrices and [`Lu`] for any; each owns the
//! scratch of faer's factorisation, so that nothing allocates.

use crate::Indefinite;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::{factor, solve};
use faer::linalg::lu::partial_pivoting as lu;
use faer::linalg::{matmul::matmul, triangular_solve};
use faer::perm::PermRef;
use faer::{Accum, MatMut, MatRef, Par};

/// Scratch for matrices of up to a given size.
pub struct Dense {
    memory: MemBuffer,
}

impl Dense {
    /// For matrices of up to `largest` x `largest`.
    pub fn new(largest: usize) -> Self {
        let need = StackReq::any_of(&[
            factor::cholesky_in_place_scratch::<f64>(largest, Par::Seq, Default::default()),
            solve::solve_in_place_scratch::<f64>(largest, largest, Par::Seq),
        ]);
        Self {
            memory: MemBuffer::new(need),
        }
    }

    /// Replaces the lower triangle of `a` (n x n) by its Cholesky factor.
    ///
    /// # Errors
    /// If it is not positive definite.
    pub fn factor(&mut self, a: &mut [f64], n: usize) -> Result<(), Indefinite> {
        let regularization = factor::LltRegularization::default();
        let stack = MemStack::new(&mut self.memory);
        let a = MatMut::from_column_major_slice_mut(a, n, n);
        factor::cholesky_in_place(a, regularization, Par::Seq, stack, Default::default())
            .map(|_| ())
            .map_err(|_| Indefinite)
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

/// `x = L^-1 x` for the factor L (n x n) of [`Dense::factor`] and x (n x columns).
pub fn solve_lower(factor: &[f64], n: usize, x: &mut [f64], columns: usize) {
    triangular_solve::solve_lower_triangular_in_place(
        MatRef::from_column_major_slice(factor, n, n),
        MatMut::from_column_major_slice_mut(x, n, columns),
        Par::Seq,
    );
}

/// `x = L^-T x` for the factor L (n x n) of [`Dense::factor`] and x (n x columns).
pub fn solve_lower_transposed(factor: &[f64], n: usize, x: &mut [f64], columns: usize) {
    triangular_solve::solve_upper_triangular_in_place(
        MatRef::from_column_major_slice(factor, n, n).transpose(),
        MatMut::from_column_major_slice_mut(x, n, columns),
        Par::Seq,
    );
}

/// `c -= a' b` for a (k x m), b (k x n) and c (m x n).
pub fn subtract_product(a: &[f64], b: &[f64], c: &mut [f64], (k, m, n): (usize, usize, usize)) {
    add_product(-1.0, a, b, c, (k, m, n));
}

/// `c += scale a' b` for a (k x m), b (k x n) and c (m x n).
pub fn add_product(
    scale: f64,
    a: &[f64],
    b: &[f64],
    c: &mut [f64],
    (k, m, n): (usize, usize, usize),
) {
    matmul(
        MatMut::from_column_major_slice_mut(c, m, n),
        Accum::Add,
        MatRef::from_column_major_slice(a, k, m).transpose(),
        MatRef::from_column_major_slice(b, k, n),
        scale,
        Par::Seq,
    );
}

/// `c -= a b` for a (m x k), b (k x n) and c (m x n).
pub fn subtract_combination(a: &[f64], b: &[f64], c: &mut [f64], (k, m, n): (usize, usize, usize)) {
    matmul(
        MatMut::from_column_major_slice_mut(c, m, n),
        Accum::Add,
        MatRef::from_column_major_slice(a, m, k),
        MatRef::from_column_major_slice(b, k, n),
        -1.0,
        Par::Seq,
    );
}

/// Scratch and pivots for LU factors of matrices of up to a given size.
pub struct Lu {
    memory: MemBuffer,
    forward: Vec<usize>,
    inverse: Vec<usize>,
}

impl Lu {
    /// For matrices of up to `largest` x `largest`.
    pub fn new(largest: usize) -> Self {
        let need = StackReq::any_of(&[
            lu::factor::lu_in_place_scratch::<usize, f64>(
                largest,
                largest,
                Par::Seq,
                Default::default(),
            ),
            lu::solve::solve_in_place_scratch::<usize, f64>(largest, largest, Par::Seq),
        ]);
        Self {
            memory: MemBuffer::new(need),
            forward: vec![0; largest],
            inverse: vec![0; largest],
        }
    }

    /// Replaces `a` (n x n) by its factors, pivoted by rows.
    pub fn factor(&mut self, a: &mut [f64], n: usize) {
        lu::factor::lu_in_place(
            MatMut::from_column_major_slice_mut(a, n, n),
            &mut self.forward[..n],
            &mut self.inverse[..n],
            Par::Seq,
            MemStack::new(&mut self.memory),
            Default::default(),
        );
    }

    /// Solves in place for `columns` right-hand sides (n x columns) with the factors that
    /// [`Lu::factor`] made last.
    pub fn solve(&mut self, factors: &[f64], n: usize, rhs: &mut [f64], columns: usize) {
        let factors = MatRef::from_column_major_slice(factors, n, n);
        lu::solve::solve_in_place(
            factors,
            factors,
            PermRef::new_checked(&self.forward[..n], &self.inverse[..n], n),
            MatMut::from_column_major_slice_mut(rhs, n, columns),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

/// Makes faer's packing buffer of this thread, which its first large product would allocate.
pub fn prepare_thread() {
    const SIZE: usize = 64;
    let (a, mut c) = (vec![0.0; SIZE * SIZE], vec![0.0; SIZE * SIZE]);
    subtract_product(&a, &a, &mut c, (SIZE, SIZE, SIZE));
}
