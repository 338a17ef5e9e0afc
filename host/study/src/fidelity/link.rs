//! A link that delays, loses and reorders frames, by a seed.
//!
//! Entry points: [`Link::send`], [`Link::arrived`].

use super::random::Random;
use std::collections::VecDeque;

/// By how many periods a frame is late that comes after its successor.
const LATE: f64 = 1.25;

/// What a link does to the frames of the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkSpec {
    /// Host solves a second \[1/s\].
    pub host_hz: f64,
    /// From the console time that was solved for until a frame arrives \[s\].
    pub delay_s: f64,
    /// Largest addition to the delay, evenly spread \[s\].
    pub jitter_s: f64,
    /// Part of all frames that never arrives, 0 to 1.
    pub loss: f64,
    /// Every so often \[s\] nothing arrives for a while; 0 for never.
    pub burst_every_s: f64,
    /// For how long \[s\].
    pub burst_s: f64,
    /// Part of all frames that comes more than a period late, after its successor, 0 to 1.
    pub reordered: f64,
    /// Of the random numbers.
    pub seed: u64,
}

impl LinkSpec {
    /// Without loss or jitter; the delay is one host period.
    pub fn ideal(host_hz: f64) -> Self {
        LinkSpec {
            host_hz,
            delay_s: 1.0 / host_hz,
            jitter_s: 0.0,
            loss: 0.0,
            burst_every_s: 0.0,
            burst_s: 0.0,
            reordered: 0.0,
            seed: 1,
        }
    }

    /// A host that solves every millisecond and whose frames are there at once: what a late one is measured against on
    /// the same console.
    pub const IMMEDIATE: LinkSpec = LinkSpec {
        host_hz: 1000.0,
        delay_s: 0.0,
        jitter_s: 0.0,
        loss: 0.0,
        burst_every_s: 0.0,
        burst_s: 0.0,
        reordered: 0.0,
        seed: 1,
    };

    /// Longest delay that is not a loss \[s\].
    pub fn longest_delay_s(&self) -> f64 {
        let late = if self.reordered > 0.0 {
            LATE / self.host_hz
        } else {
            0.0
        };
        self.delay_s + self.jitter_s + late
    }
}

/// Frames under way.
#[derive(Debug)]
pub struct Link<T> {
    spec: LinkSpec,
    random: Random,
    /// Time of arrival \[s\] and frame, in the order of arrival.
    under_way: VecDeque<(f64, T)>,
}

impl<T> Link<T> {
    /// With nothing under way.
    pub fn new(spec: LinkSpec) -> Self {
        Link {
            spec,
            random: Random::new(spec.seed),
            under_way: VecDeque::new(),
        }
    }

    /// Takes the frames of one solve at `now_s`: they come together, but each may be lost by itself.
    pub fn send(&mut self, now_s: f64, frames: impl IntoIterator<Item = T>) {
        // Always as many draws: what is lost does not change what becomes of the others.
        let [late, jitter] = [(); 2].map(|()| self.random.unit());
        let late_s = if late < self.spec.reordered {
            LATE / self.spec.host_hz
        } else {
            0.0
        };
        let at = now_s + self.spec.delay_s + jitter * self.spec.jitter_s + late_s;
        for frame in frames {
            let lost = self.random.unit() < self.spec.loss;
            if !lost && !self.in_burst(at) {
                let place = self.under_way.partition_point(|(other, _)| *other <= at);
                self.under_way.insert(place, (at, frame));
            }
        }
    }

    /// Whether the link is dead at this time.
    pub fn in_burst(&self, at_s: f64) -> bool {
        let (every, length) = (self.spec.burst_every_s, self.spec.burst_s);
        every > 0.0 && at_s % every > every - length
    }

    /// The next frame that has come by `now_s`, in the order of arrival.
    pub fn arrived(&mut self, now_s: f64) -> Option<T> {
        // A nanosecond for the rounding of times.
        let is_due = |(at, _): &mut (f64, T)| *at <= now_s + 1e-9;
        self.under_way.pop_front_if(is_due).map(|(_, frame)| frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What arrives of 1000 frames sent at 100 Hz, polled every millisecond.
    fn pass(spec: LinkSpec) -> Vec<(usize, usize)> {
        let mut link = Link::new(spec);
        let mut seen = Vec::new();
        for tick in 0..11_000_usize {
            let now = tick as f64 * 1e-3;
            if tick % 10 == 0 && tick < 10_000 {
                link.send(now, [tick / 10]);
            }
            while let Some(frame) = link.arrived(now) {
                seen.push((tick, frame));
            }
        }
        seen
    }

    #[test]
    fn an_ideal_link_delays_by_a_period_and_no_more() {
        let seen = pass(LinkSpec::ideal(100.0));
        assert_eq!(seen.len(), 1000);
        assert!(seen.iter().all(|(tick, frame)| *tick == 10 * frame + 10));
    }

    #[test]
    fn it_loses_what_it_says() {
        let spec = LinkSpec {
            loss: 0.2,
            ..LinkSpec::ideal(100.0)
        };
        let lost = 1000 - pass(spec).len();
        // Standard deviation 13.
        assert!((150..=250).contains(&lost), "{lost}");
    }

    #[test]
    fn a_burst_takes_all_and_ends() {
        let spec = LinkSpec {
            burst_every_s: 0.5,
            burst_s: 0.05,
            ..LinkSpec::ideal(100.0)
        };
        let seen = pass(spec);
        assert!(seen.iter().all(|(tick, _)| tick % 500 <= 450));
        assert!((880..=920).contains(&seen.len()), "{}", seen.len());
    }

    #[test]
    fn some_frames_come_after_their_successors() {
        let spec = LinkSpec {
            reordered: 0.1,
            ..LinkSpec::ideal(100.0)
        };
        let seen = pass(spec);
        let back = seen.windows(2).filter(|pair| pair[1].1 < pair[0].1).count();
        assert!((50..=150).contains(&back), "{back}");
        assert_eq!(seen.len(), 1000);
    }
}
