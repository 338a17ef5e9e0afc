//! Needles and threads between two frames: the console's local models beside the solver at 1 kHz on the same path.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests"
)]

mod bench;
mod needle;
mod thread;
