//! All tests of the simulated and emulated consoles, in one binary.

#[cfg(all(unix, feature = "qemu-tests"))]
mod board_image;
mod identity_trace;
#[cfg(feature = "scenarios")]
mod scenario_files;
#[cfg(feature = "scenarios")]
mod scenarios;
