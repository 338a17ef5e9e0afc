//! How late this machine wakes a thread that only sleeps: what no session can be better than.
//!
//! Entry points: [`LatenessProbe::start`] beside a session, [`MachineLateness`] for what it found.

use crate::scheduling::{Duty, Role};
use crate::times::Times;
use schemars::JsonSchema;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long the probe sleeps each time: a tick.
const SLEEP: Duration = Duration::from_millis(1);
/// A wake-up later than this is counted by itself: that of a machine that was somewhere else.
const VERY_LATE: Duration = Duration::from_millis(5);
/// Longest lateness that is told from longer ones \[us\].
const LONGEST_US: u64 = 60_000_000;

/// Percentiles of how late wake-ups were \[us\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct MachineLate {
    /// Median.
    pub p50: f64,
    /// 99 of 100 were less late.
    pub p99: f64,
    /// Latest.
    pub max: f64,
}

/// How late wake-ups were.
#[derive(Debug)]
pub struct MachineLateness {
    times_us: Times,
    over_5ms: u64,
}

impl Default for MachineLateness {
    fn default() -> Self {
        MachineLateness {
            times_us: Times::new(LONGEST_US),
            over_5ms: 0,
        }
    }
}

impl MachineLateness {
    /// A sleep that was to last `asked` lasted `slept`.
    pub fn note(&mut self, asked: Duration, slept: Duration) {
        let late = slept.saturating_sub(asked);
        self.over_5ms += u64::from(late > VERY_LATE);
        let late_us = u64::try_from(late.as_micros()).unwrap_or(u64::MAX);
        self.times_us.record(late_us);
    }

    /// Percentiles; zeros if there was no wake-up.
    pub fn late_us(&self) -> MachineLate {
        MachineLate {
            p50: self.times_us.quantile(0.5) as f64,
            p99: self.times_us.quantile(0.99) as f64,
            max: self.times_us.max() as f64,
        }
    }

    /// Wake-ups that were more than 5 ms late.
    pub fn over_5ms(&self) -> u64 {
        self.over_5ms
    }

    /// Wake-ups.
    pub fn count(&self) -> u64 {
        self.times_us.count()
    }
}

/// A thread that only sleeps. Dropping it ends it.
#[derive(Debug)]
pub struct LatenessProbe {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<MachineLateness>>,
}

impl LatenessProbe {
    /// Starts it; if `real_time`, it asks for what a virtual console's thread asks for, so that it waits for the machine and
    /// not for other programs.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(real_time: bool) -> std::io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let body = move || {
            let mut duty = real_time.then(|| Duty::begin(Role::Console));
            let mut lateness = MachineLateness::default();
            // One at least: a thread that comes into being too late for any says so, too.
            loop {
                let began = Instant::now();
                std::thread::sleep(SLEEP);
                lateness.note(SLEEP, began.elapsed());
                duty.as_mut().map(Duty::look);
                if stopped.load(Ordering::Relaxed) {
                    return lateness;
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("sutura-late".to_owned())
            .spawn(body)?;
        Ok(LatenessProbe {
            stop,
            thread: Some(thread),
        })
    }

    /// Ends it; what it found.
    pub fn end(mut self) -> MachineLateness {
        self.join().unwrap_or_default()
    }

    fn join(&mut self) -> Option<MachineLateness> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take()?.join().ok()
    }
}

impl Drop for LatenessProbe {
    fn drop(&mut self) {
        self.join();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lateness_is_what_a_sleep_took_longer_than_it_was_to() {
        let mut lateness = MachineLateness::default();
        assert_eq!(lateness.late_us(), MachineLate::default());
        let ms = Duration::from_millis(1);
        // 98 to the point, one 5 ms late, one 7 ms; one that ended early is not late.
        for _ in 0..97 {
            lateness.note(ms, ms + Duration::from_micros(60));
        }
        lateness.note(ms, Duration::from_micros(990));
        lateness.note(ms, 6 * ms);
        lateness.note(ms, 8 * ms);
        let late = lateness.late_us();
        assert_eq!((late.p50, late.max), (60.0, 7000.0));
        assert!((late.p99 - 5000.0).abs() <= 5.0, "{late:?}");
        assert_eq!((lateness.over_5ms(), lateness.count()), (1, 100));
    }

    #[test]
    fn the_longest_stall_is_told_to_the_microsecond_and_nothing_overflows() {
        let mut lateness = MachineLateness::default();
        lateness.note(Duration::ZERO, Duration::from_micros(1_234_567));
        assert_eq!(lateness.late_us().max, 1_234_567.0);
        lateness.note(Duration::ZERO, Duration::MAX);
        assert_eq!(lateness.over_5ms(), 2);
    }

    #[test]
    fn a_probe_counts_its_sleeps_until_it_is_ended() {
        let probe = LatenessProbe::start(false).expect("a thread");
        let lateness = probe.end();
        assert!(lateness.count() > 0);
        drop(LatenessProbe::start(true).expect("a thread"));
    }
}
