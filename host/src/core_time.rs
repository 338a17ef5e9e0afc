//! What a thread has had of a core. Entry point: [`core_time`].

use std::time::Duration;

/// What this thread has had of a core, where the system says; else the time on the wall.
#[cfg(target_os = "linux")]
pub fn core_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec.max(0) as u64, now.tv_nsec as u32)
}

/// What this thread has had of a core, where the system says; else the time on the wall.
#[cfg(not(target_os = "linux"))]
pub fn core_time() -> Duration {
    use std::sync::OnceLock;
    use std::time::Instant;
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    BEGAN.get_or_init(Instant::now).elapsed()
}
