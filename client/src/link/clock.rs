//! The console's clock as the host sees it, from the four times of a ping and its answer.
//!
//! Entry points: [`Clock::note`], [`Clock::estimate`]. As in NTP (Mills 1991) an exchange with round trip r and fastest
//! round trip r0 is off by at most d = (r - r0) / 2 more than the fastest one; the offset is therefore a line in
//! time, fitted to all exchanges with weights that fall with the fourth power of d. A lasting difference between the ways there and back
//! does not show: half of the fastest round trip bounds it.

use crate::times::Times;
use std::collections::VecDeque;

/// Exchanges that are kept: a minute of pings. Quartz drifts by less than 0.1 ppm in that time.
const KEPT: usize = 600;
/// Deviation of the fastest exchanges \[us\]: what clocks, interrupts and wake-ups leave.
const FLOOR_US: f64 = 10.0;
/// Time from the first exchange to the last from which on a drift means anything \[us\]: 10 us in 2 s are 5 ppm.
const LEAST_SPAN_US: f64 = 2e6;
/// Longest round trip that is told from longer ones \[us\].
const LONGEST_US: u64 = 10_000_000;

/// A ping and its answer: when it left the host, came to the console, left that, and came to the host \[us\]. The first
/// and the last are by the host's clock, the others by the console's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Host clock when the ping left.
    pub asked_us: u64,
    /// Console clock when it was taken in.
    pub received_us: u64,
    /// Console clock when the answer left.
    pub sent_us: u64,
    /// Host clock when the answer came.
    pub heard_us: u64,
}

impl Exchange {
    /// Time on the way, there and back \[us\]; none if the times contradict each other.
    fn round_trip_us(&self) -> Option<u64> {
        let away = self.heard_us.checked_sub(self.asked_us)?;
        away.checked_sub(self.sent_us.checked_sub(self.received_us)?)
    }

    /// Console clock less host clock, if the ways there and back took the same time \[us\].
    fn offset_us(&self) -> f64 {
        let there = self.received_us as f64 - self.asked_us as f64;
        let back = self.sent_us as f64 - self.heard_us as f64;
        0.5 * (there + back)
    }
}

/// What is known of the console's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockEstimate {
    /// Console clock less host clock at `host_us` \[us\].
    pub offset_us: f64,
    /// How much faster the console's clock runs \[ppm\]; 0 until two seconds have shown it.
    pub drift_ppm: f64,
    /// Half of the fastest round trip: by how much `offset_us` may be wrong \[us\].
    pub uncertainty_us: f64,
    /// Host clock of the newest exchange \[us\].
    pub host_us: f64,
}

impl ClockEstimate {
    /// The console's clock when the host's shows `host_us` \[us\].
    pub fn console_us(&self, host_us: f64) -> f64 {
        host_us + self.offset_us + 1e-6 * self.drift_ppm * (host_us - self.host_us)
    }
}

/// Round trips \[us\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundTrips {
    /// How many there were.
    pub count: u64,
    /// Fastest.
    pub min: f64,
    /// Median.
    pub p50: f64,
    /// 99 of 100 are faster.
    pub p99: f64,
    /// Slowest.
    pub max: f64,
}

/// The exchanges of a link.
#[derive(Debug)]
pub struct Clock {
    /// The newest of the present session: host time in their middle, offset and round trip \[us\].
    kept: VecDeque<(f64, f64, f64)>,
    /// Of all sessions.
    round_trips: Times,
    fastest_us: u64,
}

impl Default for Clock {
    fn default() -> Self {
        Clock {
            kept: VecDeque::with_capacity(KEPT),
            round_trips: Times::new(LONGEST_US),
            fastest_us: u64::MAX,
        }
    }
}

impl Clock {
    /// Takes note of an exchange. One whose times contradict each other is left out.
    pub fn note(&mut self, exchange: &Exchange) {
        let Some(round_trip) = exchange.round_trip_us() else {
            return;
        };
        self.round_trips.record(round_trip);
        self.fastest_us = self.fastest_us.min(round_trip);
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        let middle = 0.5 * (exchange.asked_us as f64 + exchange.heard_us as f64);
        let sample = (middle, exchange.offset_us(), round_trip as f64);
        self.kept.push_back(sample);
    }

    /// Another session may be with a console that has started anew: its clock is not known yet.
    pub fn forget(&mut self) {
        self.kept.clear();
    }

    /// All round trips so far.
    pub fn round_trips(&self) -> RoundTrips {
        let times = &self.round_trips;
        if times.count() == 0 {
            return RoundTrips::default();
        }
        RoundTrips {
            count: times.count(),
            min: self.fastest_us as f64,
            p50: times.quantile(0.5) as f64,
            p99: times.quantile(0.99) as f64,
            max: times.max() as f64,
        }
    }

    /// Round trips of the present session whose middle is not before this time of the host's clock \[us\].
    pub fn round_trips_since(&self, host_us: u64) -> RoundTrips {
        let newest = self.kept.iter().rev();
        let newest = newest.take_while(|(middle_us, ..)| *middle_us >= host_us as f64);
        let mut trips: Vec<f64> = newest.map(|(_, _, trip_us)| *trip_us).collect();
        trips.sort_by(f64::total_cmp);
        let (Some(min), Some(max)) = (trips.first(), trips.last()) else {
            return RoundTrips::default();
        };
        // The one that this share of all does not exceed.
        let quantile = |share: f64| {
            let place = (share * trips.len() as f64).ceil() as usize;
            *trips.get(place.saturating_sub(1)).unwrap_or(max)
        };
        RoundTrips {
            count: trips.len() as u64,
            min: *min,
            p50: quantile(0.5),
            p99: quantile(0.99),
            max: *max,
        }
    }

    /// The console's clock; none before the first exchange of a session.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        let (newest_us, ..) = *self.kept.back()?;
        let (oldest_us, ..) = *self.kept.front()?;
        let fastest = |best: f64, sample: &(f64, f64, f64)| best.min(sample.2);
        let fastest = self.kept.iter().fold(f64::INFINITY, fastest);
        // A weighted line through (time before the newest, offset), about their weighted means.
        let weighted = self.kept.iter().map(|(middle, offset, round_trip)| {
            let deviation = FLOOR_US + 0.5 * (round_trip - fastest);
            (deviation.powi(-4), middle - newest_us, *offset)
        });
        let sums = weighted.clone().fold([0.0; 3], |[w0, t0, x0], (w, t, x)| {
            [w0 + w, t0 + w * t, x0 + w * x]
        });
        let [weight, time, offset] = sums;
        let (time, offset) = (time / weight, offset / weight);
        let (square, product) = weighted.fold((0.0, 0.0), |(square, product), (w, t, x)| {
            let t = t - time;
            (square + w * t * t, product + w * t * (x - offset))
        });
        let drift = if newest_us - oldest_us >= LEAST_SPAN_US && square > 0.0 {
            product / square
        } else {
            0.0
        };
        Some(ClockEstimate {
            offset_us: offset - drift * time,
            drift_ppm: 1e6 * drift,
            uncertainty_us: 0.5 * fastest,
            host_us: newest_us,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exchanges with a console whose clock is `offset_us + (1 + drift) t`: the way there takes 40 us and waits up to a
    /// tick, the way back 60 us and now and then much longer.
    fn simulate(
        clock: &mut Clock,
        offset_us: f64,
        drift_ppm: f64,
        pings: u32,
    ) -> impl Fn(f64) -> f64 + use<> {
        let console = move |t: f64| offset_us + t * (1.0 + 1e-6 * drift_ppm);
        let mut random = sutura_testkit::Random::new(7);
        for k in 0..pings {
            let asked = 1e6 + 99_382.0 * f64::from(k);
            let received = asked + 40.0 + 1000.0 * random.unit();
            let sent = received + 150.0;
            let late = if random.unit() < 0.1 { 20_000.0 } else { 30.0 };
            let heard = sent + 60.0 + late * random.unit();
            clock.note(&Exchange {
                asked_us: asked as u64,
                received_us: console(received) as u64,
                sent_us: console(sent) as u64,
                heard_us: heard as u64,
            });
        }
        console
    }

    #[test]
    fn a_drifting_clock_is_known_within_its_uncertainty_whatever_the_jitter() {
        for (offset_us, drift_ppm) in [(5e9, 80.0), (-2e5, -35.0), (0.0, 0.0)] {
            let mut clock = Clock::default();
            let console = simulate(&mut clock, offset_us, drift_ppm, 200);
            let estimate = clock.estimate().expect("exchanges");
            let now = estimate.host_us;
            let error = estimate.offset_us - (console(now) - now);
            assert!(
                error.abs() <= estimate.uncertainty_us,
                "{error} us, {estimate:?}"
            );
            assert!(estimate.uncertainty_us < 100.0, "{estimate:?}");
            assert!((estimate.drift_ppm - drift_ppm).abs() < 3.0, "{estimate:?}");
            // Ten seconds on.
            let error = estimate.console_us(now + 1e7) - console(now + 1e7);
            assert!(error.abs() < estimate.uncertainty_us + 30.0, "{error} us");
        }
    }

    /// The mean of all exchanges would be off by a quarter of a tick.
    #[test]
    fn slow_exchanges_count_less_than_fast_ones() {
        let mut clock = Clock::default();
        let exchange = |asked_us, there, back| Exchange {
            asked_us,
            received_us: asked_us + there,
            sent_us: asked_us + there,
            heard_us: asked_us + there + back,
        };
        for k in 0..50 {
            clock.note(&exchange(
                100_000 * k,
                if k % 10 == 3 { 50 } else { 900 },
                50,
            ));
        }
        let estimate = clock.estimate().expect("exchanges");
        assert!(estimate.offset_us.abs() < 5.0, "{estimate:?}");
        assert_eq!(estimate.uncertainty_us, 50.0);
        let RoundTrips {
            count, min, p50, ..
        } = clock.round_trips();
        assert_eq!((count, min), (50, 100.0));
        assert!((p50 - 950.0).abs() < 2.0, "{p50}");
    }

    #[test]
    fn round_trips_of_the_last_while_are_told_from_those_before() {
        let mut clock = Clock::default();
        // Every 100 ms, each 10 us longer than the one before.
        for k in 0..50 {
            clock.note(&Exchange {
                asked_us: 100_000 * k,
                received_us: 0,
                sent_us: 0,
                heard_us: 100_000 * k + 500 + 10 * k,
            });
        }
        let newest = clock.round_trips_since(4_000_000);
        assert_eq!(
            newest,
            RoundTrips {
                count: 10,
                min: 900.0,
                p50: 940.0,
                p99: 990.0,
                max: 990.0,
            }
        );
        assert_eq!(clock.round_trips_since(0).count, 50);
        assert_eq!(clock.round_trips_since(5_000_000), RoundTrips::default());
    }

    #[test]
    fn times_that_contradict_each_other_are_left_out_and_a_new_session_begins_anew() {
        let mut clock = Clock::default();
        clock.note(&Exchange {
            asked_us: 10,
            received_us: 100,
            sent_us: 200,
            heard_us: 20,
        });
        assert_eq!((clock.estimate(), clock.round_trips().count), (None, 0));
        let _ = simulate(&mut clock, 1e6, 0.0, 30);
        clock.forget();
        assert_eq!((clock.estimate(), clock.round_trips().count), (None, 30));
    }
}
