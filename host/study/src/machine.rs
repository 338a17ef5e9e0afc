//! Which machine measured something, and what else ran on it.
//!
//! Entry points: [`Machine::here`], [`load`].

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::read_to_string;

/// A machine with more running processes than that is not idle.
pub const IDLE: f64 = 0.5;

/// What times depend on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Machine {
    /// Its name; empty where the system does not tell.
    pub host: String,
    /// Its processor.
    pub cpu: String,
    /// Threads that run at the same time.
    pub threads: usize,
    /// Operating system.
    pub os: String,
    /// Architecture.
    pub arch: String,
    /// Instructions that linear algebra uses on it.
    pub simd: String,
    /// `release`, or `debug`, whose times mean little.
    pub build: String,
}

impl Machine {
    /// This one.
    pub fn here() -> Machine {
        let host = read_to_string("/proc/sys/kernel/hostname").ok();
        let host = host.or_else(|| std::env::var("COMPUTERNAME").ok());
        Machine {
            host: host.map_or(String::new(), |name| name.trim().to_owned()),
            cpu: cpu(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            os: std::env::consts::OS.to_owned(),
            arch: std::env::consts::ARCH.to_owned(),
            simd: sutura_host::recording::simd_level(),
            build: if cfg!(debug_assertions) {
                "debug".to_owned()
            } else {
                "release".to_owned()
            },
        }
    }
}

/// Name of the processor.
pub fn cpu() -> String {
    let info = read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or("unknown", |(_, name)| name.trim()).to_owned()
}

/// Processes that ran or wanted to in the last minute, in the mean, where the system tells.
pub fn load() -> Option<f64> {
    let text = read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
}
