//! Sources of constraints: each finds what it acts on, appends its rows to the set, takes over what a solve found, and
//! reports.

pub(crate) mod tool;
