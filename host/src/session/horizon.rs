//! How long the console may use a frame: long enough for the link as it is, short enough to be safe.
//!
//! Entry point: [`Horizon`]. Three host periods, so that two lost frames in a row do not let the force
//! sag, and the 99.9th percentile of the delay that the console itself measured.

use crate::times::Times;

/// Shortest horizon \[us\]: a desktop thread that wakes late now and then must not be felt.
pub const SHORTEST_US: u64 = 20_000;
/// Longest horizon \[us\]; the console caps at the same.
pub const LONGEST_US: u64 = 150_000;

/// Keeps the delays that the console reports.
#[derive(Debug)]
pub struct Horizon {
    period_us: u64,
    /// Age of contact data when they were first applied \[us\].
    delays_us: Times,
}

impl Horizon {
    /// For a host that sends `host_hz` frames a second.
    pub fn new(host_hz: f64) -> Self {
        Horizon {
            period_us: (1e6 / host_hz).ceil() as u64,
            delays_us: Times::new(10_000_000),
        }
    }

    /// Takes note of one applied frame's age \[us\].
    pub fn applied(&mut self, age_us: u32) {
        self.delays_us.record(u64::from(age_us));
    }

    /// The horizon for the next frame \[us\].
    pub fn us(&self) -> u32 {
        let slowest = self.delays_us.quantile(0.999);
        (3 * self.period_us + slowest).clamp(SHORTEST_US, LONGEST_US) as u32
    }

    /// The delays seen so far \[us\].
    pub(super) fn delays_us(&self) -> &Times {
        &self.delays_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_periods_and_the_slowest_thousandth_within_bounds() {
        let mut horizon = Horizon::new(100.0);
        assert_eq!(horizon.us(), 30_000);
        for _ in 0..998 {
            horizon.applied(2_000);
        }
        horizon.applied(12_000);
        horizon.applied(12_000);
        // 30 ms + 12 ms, to three digits.
        assert!(
            (42_000..=42_012).contains(&horizon.us()),
            "{}",
            horizon.us()
        );
        assert_eq!(Horizon::new(1000.0).us(), SHORTEST_US as u32);
        assert_eq!(Horizon::new(10.0).us(), LONGEST_US as u32);
    }
}
