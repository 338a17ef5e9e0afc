//! All tests of the simulated and emulated consoles, in one binary.

#[cfg(all(unix, feature = "qemu-tests"))]
mod board_image;
mod identity_trace;
mod scenario_files;
mod scenarios;
