//! Sources of constraints: each finds what it acts on, appends its rows to the set, and reports.
//!
//! Entry points: [`Handles::append`] before a solve, [`Handles::forces_n`] after it.

mod handle;

pub(crate) use handle::{Handles, MOST_NODES};
