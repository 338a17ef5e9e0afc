//! Systems other than Linux are asked for nothing.

use std::time::Duration;

pub(super) fn sharpen_timers() {}

pub(super) fn real_time(_priority: u8) -> bool {
    false
}

pub(super) fn ordinary() {}

/// Nobody goes first: it is never asked.
pub(super) fn computing_time() -> Duration {
    Duration::ZERO
}

pub(super) fn lock_memory() -> bool {
    false
}

pub(super) fn unlock_memory() {}
