//! All tests of the simulated and emulated consoles, in one binary.

mod identity_trace;
mod scenario_files;
mod scenarios;
