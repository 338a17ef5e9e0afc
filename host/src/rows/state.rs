//! What lasts between solves: forces and active set, by row id.

use super::{Row, RowKind};
use serde::Serialize;

/// Where a row is on its law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Mode {
    /// `delta = 0`: equality, closed, inside the box, sticking.
    Held,
    /// lambda at its lower bound: an open contact, a box at `-limit`.
    AtLower,
    /// A box at `+limit`.
    AtUpper,
    /// A tangent of a slipping cone.
    Slipping,
}

/// Forces and modes of the rows solved last.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    largest: usize,
    pub(super) ids: Vec<u64>,
    pub(super) lambda: Vec<f64>,
    pub(super) delta: Vec<f64>,
    pub(super) modes: Vec<Mode>,
}

/// What a state knew of the rows of a new problem.
#[derive(Clone, Debug, Default)]
pub(super) struct Warm {
    /// Force and mode of rows that were there before.
    pub rows: Vec<Option<(f64, Mode)>>,
}

impl State {
    /// For sets of up to so many rows.
    pub fn new(largest: usize) -> Self {
        Self {
            largest,
            ids: Vec::with_capacity(largest),
            lambda: Vec::with_capacity(largest),
            delta: Vec::with_capacity(largest),
            modes: Vec::with_capacity(largest),
        }
    }

    /// Names of the last problem's rows, in its order.
    pub(crate) fn ids(&self) -> impl Iterator<Item = u64> + '_ {
        self.ids.iter().copied()
    }

    /// Multipliers \[N\] of the last problem's rows, in its order.
    pub fn lambda(&self) -> &[f64] {
        &self.lambda
    }

    /// delta \[m\] of the last problem's rows at these forces.
    pub fn delta(&self) -> &[f64] {
        &self.delta
    }

    /// Modes of the last problem's rows.
    pub fn modes(&self) -> &[Mode] {
        &self.modes
    }

    /// Adds to a row's multiplier \[N\].
    pub(crate) fn add(&mut self, row: usize, by_n: f64) {
        self.lambda[row] += by_n;
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.ids.clone_from(&other.ids);
        self.lambda.clone_from(&other.lambda);
        self.delta.clone_from(&other.delta);
        self.modes.clone_from(&other.modes);
    }

    /// What is known of `rows`; the others are open.
    pub(crate) fn put_into(&self, rows: &[Row], out: &mut Self) {
        out.clear();
        let mut next = 0;
        for row in rows {
            let known = (next..self.ids.len()).chain(0..next);
            let found = known.into_iter().find(|at| self.ids[*at] == row.id);
            next = found.map_or(next, |at| at + 1);
            out.ids.push(row.id);
            out.lambda.push(found.map_or(0.0, |at| self.lambda[at]));
            out.delta.push(found.map_or(0.0, |at| self.delta[at]));
            out.modes
                .push(found.map_or(Mode::AtLower, |at| self.modes[at]));
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.ids.clear();
        self.lambda.clear();
        self.delta.clear();
        self.modes.clear();
    }

    pub(super) fn largest(&self) -> usize {
        self.largest
    }

    /// Writes into `warm` what is known of `rows`. Rows keep their order from step to step as a rule:
    /// the search for an id starts behind the one found last.
    pub(super) fn recall(&self, rows: &[Row], warm: &mut Warm) {
        warm.rows.clear();
        let known = self.ids.len();
        let mut next = 0;
        for row in rows {
            let found = (next..known)
                .chain(0..next)
                .find(|&at| self.ids[at] == row.id);
            if let Some(at) = found {
                next = (at + 1) % known;
            }
            warm.rows
                .push(found.map(|at| (self.lambda[at], self.modes[at])));
        }
    }

    /// No force on any of `rows`.
    pub(super) fn rest(&mut self, rows: &[Row]) {
        self.clear();
        for row in rows {
            self.ids.push(row.id);
            self.lambda.push(0.0);
            self.delta.push(0.0);
            self.modes.push(match row.kind {
                RowKind::Equality | RowKind::Box { .. } | RowKind::Between { .. } => Mode::Held,
                _ => Mode::AtLower,
            });
        }
    }
}
