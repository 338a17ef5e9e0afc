//! Nanoseconds per stage.
//!
//! Entry point: [`Clock::lap`].

use std::time::Instant;

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
