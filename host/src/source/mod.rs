//! Sources of constraints: each finds what it acts on, appends its rows to the set, takes over what a solve found, and
//! reports.

mod handle;
pub(crate) mod tool;

pub(crate) use handle::{Handles, MOST_NODES};
