//! Four numbers for each node, found by a 16-bit number without a check.
//!
//! Entry point: [`Field`]. It has a row for every number there is, of which the system gives memory to those that
//! are written. Looking up nodes is a good part of what a visit costs.

use super::number::Float;
use crate::BuildError;
use std::ops::{Deref, DerefMut};

/// All rows that a node's number can mean.
pub(super) type Rows<T> = [[T; 4]; 1 << 16];

/// Rows for so many nodes and one for places without a cell, in whole groups of four.
pub(super) fn rows_for(nodes: usize) -> usize {
    (nodes + 1).next_multiple_of(4)
}

/// Rows in groups of four: sums over nodes keep a partial sum for each number of a group, or every addition would
/// wait for the last.
#[inline(always)]
pub(super) fn groups<R>(rows: &[R]) -> &[[R; 4]] {
    rows.as_chunks().0
}

/// Rows in groups of four.
#[inline(always)]
pub(super) fn groups_mut<R>(rows: &mut [R]) -> &mut [[R; 4]] {
    rows.as_chunks_mut().0
}

/// Sum of partial sums.
#[inline(always)]
pub(super) fn total<T: Float>(sums: [[T; 4]; 4]) -> f64 {
    sums.as_flattened().iter().map(|sum| sum.wide()).sum()
}

/// Rows of [`rows_for`] the nodes.
#[derive(Clone, Debug)]
pub(super) struct Field<T> {
    rows: Box<Rows<T>>,
    used: usize,
}

impl<T: Float> Field<T> {
    /// Zeros.
    ///
    /// # Errors
    /// More nodes than numbers.
    pub fn new(nodes: usize) -> Result<Self, BuildError> {
        let none = vec![[T::default(); 4]; 1 << 16].into_boxed_slice();
        match none.try_into() {
            Ok(rows) if nodes < 1 << 16 => Ok(Self {
                rows,
                used: rows_for(nodes),
            }),
            _ => Err(BuildError::Setting {
                name: "number of nodes",
                value: nodes as f64,
                limit: "at most 65535 for this model; take a coarser mesh or another model",
            }),
        }
    }

    /// Every row.
    #[inline(always)]
    pub fn rows(&self) -> &Rows<T> {
        &self.rows
    }

    /// Every row.
    #[inline(always)]
    pub fn rows_mut(&mut self) -> &mut Rows<T> {
        &mut self.rows
    }
}

impl<T> Deref for Field<T> {
    type Target = [[T; 4]];
    #[inline(always)]
    fn deref(&self) -> &[[T; 4]] {
        &self.rows[..self.used]
    }
}

impl<T> DerefMut for Field<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [[T; 4]] {
        &mut self.rows[..self.used]
    }
}
