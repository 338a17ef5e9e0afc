//! Percentiles to three digits, and an exact maximum.
//!
//! Entry point: [`Times`].

use hdrhistogram::Histogram;

/// A distribution of times in whatever unit the owner records.
#[derive(Debug)]
pub struct Times {
    histogram: Histogram<u64>,
    max: u64,
}

impl Times {
    /// For times up to `largest`; longer ones count as that long.
    pub fn new(largest: u64) -> Self {
        // Three digits, and a range above 1, are always accepted.
        let histogram = Histogram::new_with_max(largest.max(2), 3);
        Times {
            histogram: histogram.unwrap_or_else(|_| unreachable!("fixed bounds")),
            max: 0,
        }
    }

    /// Takes note of one time.
    pub fn record(&mut self, time: u64) {
        self.histogram.saturating_record(time);
        self.max = self.max.max(time);
    }

    /// The time that this share of all does not exceed; 0 when there are none.
    pub fn quantile(&self, share: f64) -> u64 {
        if self.histogram.is_empty() {
            return 0;
        }
        // A bucket's upper end may lie above anything that was recorded.
        self.histogram.value_at_quantile(share).min(self.max)
    }

    /// The longest time.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.histogram.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_three_digits_and_the_maximum_exactly() {
        let mut times = Times::new(1_000_000);
        assert_eq!((times.quantile(0.5), times.max(), times.count()), (0, 0, 0));
        for time in 1..=10_000 {
            times.record(10 * time);
        }
        for (share, exact) in [(0.5, 50_000), (0.99, 99_000), (0.999, 99_900)] {
            let found = times.quantile(share);
            assert!(found.abs_diff(exact) <= exact / 1000, "{found} for {exact}");
        }
        assert_eq!(
            (times.quantile(1.0), times.max(), times.count()),
            (100_000, 100_000, 10_000)
        );
    }

    #[test]
    fn a_single_time_is_all_its_quantiles() {
        let mut times = Times::new(1_000_000);
        // Not a bucket's boundary.
        times.record(5_001);
        assert_eq!(
            [0.01, 0.5, 1.0].map(|share| times.quantile(share)),
            [5_001; 3]
        );
    }
}
