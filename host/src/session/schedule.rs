//! Which ticks of the console the solver works on.
//!
//! Entry point: [`Schedule::is_due`]. Steps are paced by the console's ticks and not by a clock of the host's, so that
//! each begins with a state that has just been sent.

/// Solver steps, so many a second of the console's time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Schedule {
    first_tick: u32,
    tick_hz: f64,
    host_hz: f64,
    /// Number of the next step.
    next: u64,
    /// Steps left out before the one that was due last.
    left_out: u64,
    /// Another rate \[Hz\], and steps until it holds.
    then: Option<(f64, u8)>,
}

/// Steps at the old rate before another one holds: the frame of the first, the last that the old rate brings in time, is good
/// for as long as the new one needs.
const STEPS_TO_CHANGE: u8 = 2;

impl Schedule {
    /// Steps from `first_tick` on; that tick's own is not asked for.
    pub(super) fn new(first_tick: u32, tick_hz: u16, host_hz: f64) -> Self {
        Schedule {
            first_tick,
            tick_hz: f64::from(tick_hz),
            host_hz,
            next: 1,
            left_out: 0,
            then: None,
        }
    }

    /// Steps come `host_hz` times a second from the next but one on.
    pub(super) fn change(&mut self, host_hz: f64) {
        self.then = Some((host_hz, STEPS_TO_CHANGE));
    }

    /// Whether a step starts with the state of this tick. Steps whose ticks have passed are left out, not made up for.
    pub(super) fn is_due(&mut self, tick: u32) -> bool {
        let due = self.ticks_left(tick) == 0;
        if due {
            let since = f64::from(tick.wrapping_sub(self.first_tick));
            let passed = ((since + 1.0) * self.host_hz / self.tick_hz).ceil() as u64;
            self.left_out = passed.saturating_sub(self.next + 1);
            self.next = passed.max(self.next + 1);
            self.then = match self.then {
                Some((host_hz, 0 | 1)) => {
                    (self.first_tick, self.host_hz, self.next) = (tick, host_hz, 1);
                    None
                }
                later => later.map(|(host_hz, steps)| (host_hz, steps - 1)),
            };
        }
        due
    }

    /// Steps that were left out just before the one that was due last.
    pub(super) fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Ticks from this one until the next step is due.
    pub(super) fn ticks_left(&self, tick: u32) -> u32 {
        let due = (self.next as f64 * self.tick_hz / self.host_hz).floor();
        let since = f64::from(tick.wrapping_sub(self.first_tick));
        (due - since).max(0.0) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn due(host_hz: f64, ticks: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut schedule = Schedule::new(u32::MAX - 1, 1000, host_hz);
        ticks
            .filter(|tick| schedule.is_due((u32::MAX - 1).wrapping_add(*tick)))
            .collect()
    }

    #[test]
    fn steps_are_spread_evenly_at_any_rate() {
        assert_eq!(due(200.0, 1..=20), [5, 10, 15, 20]);
        assert_eq!(due(1000.0, 1..=5), [1, 2, 3, 4, 5]);
        assert_eq!(due(30.0, 1..=101), [33, 66, 100]);
        for hz in 1..=1000 {
            let steps = due(f64::from(hz), 1..=10_000).len();
            assert_eq!(steps, 10 * hz as usize, "{hz} Hz");
        }
    }

    #[test]
    fn another_rate_holds_from_the_next_but_one_on() {
        let mut schedule = Schedule::new(0, 1000, 200.0);
        let mut due = Vec::new();
        for tick in 1..=150 {
            if tick == 12 {
                schedule.change(40.0);
            }
            if tick == 100 {
                schedule.change(500.0);
            }
            if schedule.is_due(tick) {
                due.push(tick);
            }
        }
        assert_eq!(due[..7], [5, 10, 15, 20, 45, 70, 95]);
        assert_eq!(due[7..11], [120, 145, 147, 149]);
    }

    #[test]
    fn steps_that_were_missed_are_left_out() {
        let late = (1..=12).chain(31..=45);
        assert_eq!(due(200.0, late), [5, 10, 31, 35, 40, 45]);
        let mut schedule = Schedule::new(0, 1000, 200.0);
        assert!(schedule.is_due(5) && schedule.left_out() == 0);
        assert!(schedule.is_due(26) && schedule.left_out() == 3);
        let schedule = Schedule::new(0, 1000, 200.0);
        assert_eq!(
            [1, 4, 5, 9].map(|tick| schedule.ticks_left(tick)),
            [4, 1, 0, 0]
        );
    }
}
