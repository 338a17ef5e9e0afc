//! For how long nothing came, of the time in which somebody listened.
//!
//! Entry point: [`Silence`]. A program that is stopped (Ctrl-Z, a virtual machine that is put aside, a machine that sleeps) finds a
//! clock that has gone on, and what was sent to it meanwhile not yet read: that is no console that is dead.

use std::time::{Duration, Instant};

/// Most of the time between two looks that counts: twice what threads of a link and of a session leave between them.
const MOST: Duration = Duration::from_millis(100);

/// For how long nothing came.
#[derive(Clone, Copy, Debug)]
pub struct Silence {
    looked: Instant,
    quiet: Duration,
}

impl Silence {
    /// From now on.
    pub fn from(now: Instant) -> Self {
        Silence {
            looked: now,
            quiet: Duration::ZERO,
        }
    }

    /// Whether something `came` since the last look; for how long nothing did, without what passed while nobody looked.
    pub fn look(&mut self, now: Instant, came: bool) -> Duration {
        let passed = now.saturating_duration_since(self.looked).min(MOST);
        self.looked = now;
        self.quiet = if came {
            Duration::ZERO
        } else {
            self.quiet.saturating_add(passed)
        };
        self.quiet
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_passes_between_looks_adds_up_until_something_comes() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut silence = Silence::from(start);
        for look in 1..=40 {
            let quiet = silence.look(at(50 * look), false);
            assert_eq!(quiet, Duration::from_millis(50 * look));
        }
        assert_eq!(silence.look(at(2050), true), Duration::ZERO);
        assert_eq!(silence.look(at(2100), false), Duration::from_millis(50));
    }

    /// Stopped for a minute, with a second's worth of states that wait to be read.
    #[test]
    fn a_program_that_was_stopped_has_not_listened() {
        let start = Instant::now();
        let mut silence = Silence::from(start);
        let on = start + Duration::from_secs(60);
        assert_eq!(silence.look(on, false), MOST);
        assert_eq!(silence.look(on, true), Duration::ZERO);
    }
}
