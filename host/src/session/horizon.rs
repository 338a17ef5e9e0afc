//! How long the console may use a frame: long enough for the link and the solver as they are, short enough to be safe.
//!
//! Entry points: [`Horizon::applied`] for every frame that came, [`Horizon::took`] for every solve, [`Horizon::next_us`],
//! [`Horizon::gave`] for every frame that goes out. Three
//! host periods, so that two lost frames in a row do not let the force sag, and what a frame needs to get there: the
//! longest delay of the last seconds, frames that came too late included, and the solve's own time, which is known before
//! the frame goes out. A stall that is over is forgotten after these seconds: a dead host pushes no longer for it.

use crate::times::Times;
use sutura_shared::control::{MAX_HORIZON_US, TICK_HZ};

/// Shortest horizon \[us\]: a desktop thread that wakes late now and then must not be felt.
pub const SHORTEST_US: u64 = 20_000;
/// Longest horizon \[us\]; the console caps at the same.
pub const LONGEST_US: u64 = MAX_HORIZON_US as u64;

/// Ticks whose longest delay is kept in one number, and how many such numbers: 5 s.
const SPAN: u32 = TICK_HZ as u32 / 4;
const SPANS: usize = 20;
/// As long as so many periods may a solve take of which nothing is known yet: a stall in the first seconds, like any first
/// one, would else take the force away, which comes back slowly.
const UNKNOWN: u64 = 5;
/// No span of ticks has this number yet.
const NEVER: u32 = u32::MAX;

/// Keeps the delays that the console reports.
#[derive(Debug)]
pub struct Horizon {
    period_us: u64,
    least_us: u64,
    /// Time that the last solve took \[us\].
    own_us: u64,
    /// Age of contact data when they came \[us\].
    delays_us: Times,
    /// Number of a span of ticks, and the longest delay in it \[us\], (20).
    recent: [(u32, u32); SPANS],
    /// Span of the newest tick, and of the first one.
    now: u32,
    began: Option<u32>,
    given_us: Times,
}

impl Horizon {
    /// For a host that sends `host_hz` frames a second.
    pub fn new(host_hz: f64) -> Self {
        Horizon {
            period_us: (1e6 / host_hz).ceil() as u64,
            least_us: SHORTEST_US,
            own_us: 0,
            delays_us: Times::new(10_000_000),
            recent: [(NEVER, 0); SPANS],
            now: 0,
            began: None,
            given_us: Times::new(LONGEST_US),
        }
    }

    /// Frames come `host_hz` times a second from now on.
    pub fn change(&mut self, host_hz: f64) {
        self.period_us = (1e6 / host_hz).ceil() as u64;
    }

    /// It is never shorter than this \[us\].
    pub fn at_least(&mut self, least_us: Option<u32>) {
        self.least_us = least_us.map_or(SHORTEST_US, u64::from);
    }

    /// Takes note of a tick of the console.
    pub fn tick(&mut self, tick: u32) {
        self.now = tick / SPAN;
        // A console that starts anew counts from 0.
        self.began = Some(self.began.map_or(self.now, |began| began.min(self.now)));
    }

    /// Takes note of one frame's age when it came \[us\], whether it was used or was too old.
    pub fn applied(&mut self, age_us: u32) {
        self.delays_us.record(u64::from(age_us));
        let place = &mut self.recent[self.now as usize % SPANS];
        let before_us = if place.0 == self.now { place.1 } else { 0 };
        *place = (self.now, before_us.max(age_us));
    }

    /// Takes note of the time that the solve took whose frame goes out next \[us\].
    pub fn took(&mut self, own_us: u64) {
        self.own_us = own_us;
    }

    /// The horizon for the next frame \[us\].
    pub fn next_us(&self) -> u32 {
        let is_recent = |span: u32| self.now.wrapping_sub(span) < SPANS as u32;
        let recent = self.recent.iter().filter(|(span, _)| is_recent(*span));
        let slowest_us = recent.map(|(_, us)| u64::from(*us)).max().unwrap_or(0);
        let is_known = self.began.is_some_and(|began| !is_recent(began));
        let slowest_us = if is_known {
            slowest_us
        } else {
            slowest_us.max(UNKNOWN * self.period_us)
        };
        let needed_us = 3 * self.period_us + slowest_us.max(self.own_us);
        needed_us.max(self.least_us).min(LONGEST_US) as u32
    }

    /// Takes note of a frame that goes out with this horizon \[us\].
    pub fn gave(&mut self, horizon_us: u32) {
        self.given_us.record(u64::from(horizon_us));
    }

    /// The delays seen so far \[us\].
    pub(super) fn delays_us(&self) -> &Times {
        &self.delays_us
    }

    /// The horizons of the frames that went out so far \[us\].
    pub(super) fn given_us(&self) -> &Times {
        &self.given_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whose console has told of 5 s in which every frame was 2 ms old when it came, until this tick.
    fn known(host_hz: f64, tick: u32) -> Horizon {
        let mut horizon = Horizon::new(host_hz);
        for tick in tick - 5_500..=tick {
            horizon.tick(tick);
            horizon.applied(2_000);
        }
        horizon
    }

    #[test]
    fn three_periods_and_the_longest_delay_within_bounds() {
        let mut horizon = known(100.0, 6_000);
        assert_eq!(horizon.next_us(), 32_000);
        horizon.applied(12_000);
        assert_eq!(horizon.next_us(), 42_000);
        assert_eq!(known(1000.0, 6_000).next_us(), SHORTEST_US as u32);
        assert_eq!(Horizon::new(10.0).next_us(), LONGEST_US as u32);
        horizon.at_least(Some(60_000));
        assert_eq!(horizon.next_us(), 60_000);
    }

    /// The first stall of a session would else be an outage.
    #[test]
    fn before_five_seconds_a_solve_may_take_five_periods() {
        let mut horizon = Horizon::new(100.0);
        assert_eq!(horizon.next_us(), 80_000);
        for tick in 700..=5_499 {
            horizon.tick(tick);
            horizon.applied(2_000);
            assert_eq!(horizon.next_us(), 80_000, "tick {tick}");
        }
        for tick in 5_500..=5_750 {
            horizon.tick(tick);
            horizon.applied(2_000);
        }
        assert_eq!(horizon.next_us(), 32_000);
        // At its usual rate a host is not given more than scenes ask for.
        assert!(Horizon::new(200.0).next_us() <= 60_000);
    }

    /// A solve of 61 ms: its own frame already has the room, and so have those of the next 5 s.
    #[test]
    fn a_stall_is_learnt_from_its_own_frame_on_and_forgotten_after_five_seconds() {
        let mut horizon = known(200.0, 10_100);
        horizon.took(61_000);
        assert_eq!(horizon.next_us(), 76_000);
        // It came when it was 64 ms old, in time or not.
        horizon.applied(64_000);
        horizon.took(300);
        for tick in 10_101..=14_900 {
            horizon.tick(tick);
            horizon.applied(2_000);
            assert_eq!(horizon.next_us(), 79_000, "tick {tick}");
        }
        for tick in 14_901..=15_400 {
            horizon.tick(tick);
            horizon.applied(2_000);
        }
        assert_eq!(horizon.next_us(), SHORTEST_US as u32);
    }

    #[test]
    fn a_console_that_starts_anew_has_no_past() {
        let mut horizon = Horizon::new(200.0);
        horizon.tick(1_000_000);
        horizon.applied(100_000);
        horizon.tick(3);
        assert_eq!(horizon.next_us(), 40_000);
    }
}
