//! Nanoseconds per stage, and what the processor spent.
//!
//! Entry points: [`Clock::lap`], [`Stopwatch`].

use std::time::{Duration, Instant};

/// Time since the last look.
pub(crate) struct Clock(Instant);

impl Clock {
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Adds the time since the last lap to `into` \[ns\].
    pub fn lap(&mut self, into: &mut u64) {
        let now = Instant::now();
        *into += (now - self.0).as_nanos() as u64;
        self.0 = now;
    }
}

/// Time on the wall, and of this thread on a processor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stopwatch {
    wall: Instant,
    cpu: Duration,
}

impl Stopwatch {
    pub fn start() -> Self {
        Self {
            wall: Instant::now(),
            cpu: thread_time(),
        }
    }

    /// Since the start \[us\].
    pub fn wall_us(&self) -> f64 {
        self.wall.elapsed().as_secs_f64() * 1e6
    }

    /// Of this thread on a processor since the start or the last lap \[us\]: what others took in between is not in it.
    pub fn cpu_lap_us(&mut self) -> f64 {
        let now = thread_time();
        let spent = now.saturating_sub(self.cpu);
        self.cpu = now;
        spent.as_secs_f64() * 1e6
    }
}

/// This thread's time on a processor.
#[cfg(target_os = "linux")]
fn thread_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let (seconds, ns) = (time.tv_sec, time.tv_nsec);
    Duration::new(
        u64::try_from(seconds).unwrap_or_default(),
        u32::try_from(ns).unwrap_or_default(),
    )
}

/// Where a thread's own time cannot be asked for without `unsafe`, the wall's.
#[cfg(not(target_os = "linux"))]
fn thread_time() -> Duration {
    use std::sync::OnceLock;
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    BEGAN.get_or_init(Instant::now).elapsed()
}
