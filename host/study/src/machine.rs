//! Which machine measured something, and what else ran on it.
//!
//! Entry points: [`Machine::here`], [`Busy`].

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::read_to_string;
use std::time::Instant;

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

/// Ticks of the kernel's clocks of processor time in a second, in all that it tells programs.
const TICKS_PER_S: f64 = 100.0;

/// How busy other programs have been since.
#[derive(Clone, Copy, Debug)]
pub struct Busy {
    began: Instant,
    others_s: f64,
}

impl Busy {
    /// From now on; none where the system does not tell.
    pub fn begin() -> Option<Busy> {
        Some(Busy {
            began: Instant::now(),
            others_s: others_s()?,
        })
    }

    /// Processors that other programs, or other machines on the same one, have kept busy since, in the mean.
    pub fn others(&self) -> Option<f64> {
        let busy_s = others_s()? - self.others_s;
        // Both clocks go by ticks.
        let passed_s = self.began.elapsed().as_secs_f64().max(1.0 / TICKS_PER_S);
        Some((busy_s / passed_s).max(0.0))
    }
}

/// Processor time of all programs but this one, since the machine was started \[s\].
fn others_s() -> Option<f64> {
    let all = read_to_string("/proc/stat").ok()?;
    let own = read_to_string("/proc/self/stat").ok()?;
    Some(busy_ticks(&all)?.saturating_sub(own_ticks(&own)?) as f64 / TICKS_PER_S)
}

/// Of all processors: user, nice, system, irq, softirq, steal; not idle and iowait (proc_stat(5)).
fn busy_ticks(stat: &str) -> Option<u64> {
    let words = stat.lines().next()?.strip_prefix("cpu ")?;
    let ticks: Vec<u64> = words
        .split_whitespace()
        .map_while(|word| word.parse().ok())
        .collect();
    let [user, nice, system, _idle, _iowait, irq, softirq, steal, ..] = ticks[..] else {
        return None;
    };
    Some(user + nice + system + irq + softirq + steal)
}

/// Of one process, with all its threads: utime and stime, the 14th and 15th words, of which the second is a name in brackets
/// (proc_pid_stat(5)).
fn own_ticks(stat: &str) -> Option<u64> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut words = after_name.split_whitespace().skip(11);
    let mut next = || words.next()?.parse::<u64>().ok();
    Some(next()? + next()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_use_is_all_but_idle_and_ones_own() {
        let stat = "cpu  100 20 30 4000 500 6 7 8 900 90\ncpu0 1 2 3 4 5 6 7 8 9 0\n";
        assert_eq!(busy_ticks(stat), Some(171));
        let own = "12 (a) b (c) R 1 2 3 4 5 6 7 8 9 10 70 5 0 0 20 0 3 0 99";
        assert_eq!(own_ticks(own), Some(75));
        for bad in ["", "cpu  1 2 3", "intr 1 2 3 4 5 6 7 8"] {
            assert_eq!(busy_ticks(bad), None, "{bad}");
        }
        assert_eq!(own_ticks("12 (a) R 1 2"), None);
    }
}
