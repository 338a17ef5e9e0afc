//! Whether a machine is idle enough to take times on: the one limit of studies, of the command and of `cargo xtask bars`, which
//! has this file as a module of its own because it is built before all else.

/// A machine with more running processes, or more busy processors, than that is not idle.
pub const IDLE: f64 = 0.5;

/// Processes that ran or wanted to in the last minute, in the mean, where the system tells.
pub fn load() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
}
