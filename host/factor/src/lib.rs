//! Factors of sparse and dense matrices, and solves that allocate nothing.
//!
//! Entry points: [`Cholesky`] analyses and factors a sparse symmetric matrix, [`Supernodes`] solves with its factor for one or
//! a few right-hand sides; [`Dense`] and [`Lu`] are for small matrices. On one thread: two are slower below some ten thousand
//! nodes, and one gives the same bits always. All of faer is behind this crate, and none of that generic: its kernels are compiled
//! once, not again with every crate that factors something.

mod cholesky;
mod dense;
mod fetch;
mod supernodes;

pub use cholesky::{Cholesky, Lower, NoMemory, Scratch};
pub use dense::{
    Dense, Lu, add_product, prepare_thread, solve_lower, solve_lower_transposed,
    subtract_combination, subtract_product,
};
pub use fetch::{fetch_line, touch};
pub use supernodes::{Supernodes, SweepScratch};

/// The matrix is not positive definite.
#[derive(Debug)]
pub struct Indefinite;
