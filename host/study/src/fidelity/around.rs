//! What is around a console and is never twice the same: when the host's turns come, how the scene lies, whether the host
//! has seen the scene before, and how long its solves take.
//!
//! Entry points: [`Around`], [`Blocking`]. Hands that do the same every so many periods of the host meet it at one phase,
//! and a host that always takes its period never blocks.

use super::random::Random;
use super::run::True;
use super::scenes::turned::Turn;
use std::sync::OnceLock;

/// What is around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Around {
    /// By what part of its period the host's turns come later, 0 to 1.
    pub phase: f64,
    /// By what the scene is turned, with hand and tool.
    pub turn: Turn,
    /// Whether the host starts without compliance columns.
    pub cold: bool,
    /// Seed of a host that blocks while it solves, for recorded times; none for one whose frames are always a period late.
    pub blocks: Option<u64>,
}

impl Around {
    /// As planned: phase 0, not turned, warm, and never blocking.
    pub fn planned() -> Self {
        Around {
            phase: 0.0,
            turn: Turn::none(),
            cold: false,
            blocks: None,
        }
    }
}

/// Times of solves in a session \[us\]; how they were recorded is in the file.
const RECORDED: &str = include_str!("solve-times.csv");
/// A solve within a period at 60 Hz is none, one of more than two is a stall \[us\].
const QUICK_US: u32 = 16_700;
/// The longest stall \[us\]: what is longer no frame may be used for, with the periods around it, and is an outage.
const STALLS_US: std::ops::RangeInclusive<u32> = 33_400..=110_000;
/// From the end of a solve until its frame is there \[s\]: a fast serial line.
pub const TRANSIT_S: f64 = 2e-3;
/// Of all solves so many stall: a little more than one in a hundred, so that their 99th percentile is a stall.
const STALLS: f64 = 0.012;

/// The recorded solves \[us\]: those within a period, and stalls.
pub fn recorded_us() -> &'static (Vec<u32>, Vec<u32>) {
    static TIMES: OnceLock<(Vec<u32>, Vec<u32>)> = OnceLock::new();
    TIMES.get_or_init(|| {
        let lines = RECORDED.lines().filter(|line| !line.starts_with('#'));
        let times = lines.filter_map(|line| line.trim().parse().ok());
        let times: Vec<u32> = times.collect();
        let quick = times.iter().copied().filter(|us| *us <= QUICK_US);
        let stalls = times.iter().copied().filter(|us| STALLS_US.contains(us));
        (quick.collect(), stalls.collect())
    })
}

/// A host that blocks: how long each of its solves takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Blocking {
    /// Where in the recording it begins.
    from: usize,
    /// When it stalls \[s\], ascending, and for how long \[s\].
    stalls: Vec<(f64, f64)>,
}

impl Blocking {
    /// By a seed, for a run whose truth is known, of a host that would solve so many times a second. Stalls come in pairs:
    /// one somewhere, one while there is contact.
    pub fn new(seed: u64, truth: &[True], host_hz: f64) -> Self {
        let (quick, slow) = recorded_us();
        let mut random = Random::new(seed);
        let mut pick = |count: usize| (random.unit() * count as f64) as usize;
        let from = pick(quick.len());
        let touched: Vec<usize> = (0..truth.len())
            .filter(|tick| truth[*tick].force_n != [0.0; 3])
            .collect();
        let solves = host_hz * 1e-3 * truth.len() as f64;
        let pairs = (0.5 * STALLS * solves).ceil() as usize;
        let mut stalls = Vec::new();
        for _ in 0..pairs {
            let anywhere = pick(truth.len());
            let inside = touched.get(pick(touched.len())).copied();
            for tick in [anywhere, inside.unwrap_or(anywhere)] {
                let us = slow.get(pick(slow.len())).copied().unwrap_or(0);
                stalls.push((1e-3 * tick as f64, 1e-6 * f64::from(us)));
            }
        }
        stalls.sort_by(|a, b| a.0.total_cmp(&b.0));
        Blocking { from, stalls }
    }

    /// How long the solve of this number takes that begins now \[s\], and how many stalls are over then; `over` were
    /// before. A stall is met by the first solve from its time on.
    pub fn takes_s(&self, solve: u32, over: usize, now_s: f64) -> (f64, usize) {
        let (quick, _) = recorded_us();
        let index = (self.from + solve as usize) % quick.len().max(1);
        let own_s = 1e-6 * f64::from(quick.get(index).copied().unwrap_or(0));
        match self.stalls.get(over) {
            Some((at_s, length_s)) if *at_s <= now_s => (own_s.max(*length_s), over + 1),
            _ => (own_s, over),
        }
    }

    /// The longest stall \[s\].
    pub fn longest_s(&self) -> f64 {
        let lengths = self.stalls.iter().map(|(_, length_s)| *length_s);
        lengths.fold(0.0, f64::max)
    }

    /// Part of a time \[s\] that is spent in stalls.
    pub fn stalled_part(&self, seconds: f64) -> f64 {
        self.stalls
            .iter()
            .map(|(_, length_s)| length_s)
            .sum::<f64>()
            / seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two seconds of which the third quarter is in contact.
    fn truth() -> Vec<True> {
        let at = |tick: u32| True {
            force_n: [0.0, 0.0, f64::from(u8::from((1000..1500).contains(&tick)))],
            punctures: 0,
        };
        (0..2000).map(at).collect()
    }

    #[test]
    fn stalls_are_recorded_ones_and_half_of_them_in_contact() {
        let (quick, slow) = recorded_us();
        assert!(
            quick.len() > 500 && slow.len() > 5,
            "{} {}",
            quick.len(),
            slow.len()
        );
        let mut inside = 0;
        let mut count = 0;
        for seed in 0..100 {
            let blocking = Blocking::new(seed, &truth(), 60.0);
            assert_eq!(blocking, Blocking::new(seed, &truth(), 60.0));
            assert_eq!(blocking.stalls.len(), 2);
            for (at_s, length_s) in &blocking.stalls {
                inside += usize::from((1.0..1.5).contains(at_s));
                count += 1;
                assert!(slow.iter().any(|us| 1e-6 * f64::from(*us) == *length_s));
            }
        }
        // Half of them, and a quarter of the others.
        assert!((110..=140).contains(&inside) && count == 200, "{inside}");
    }

    #[test]
    fn a_stall_is_met_once_by_the_next_solve() {
        let blocking = Blocking {
            from: 0,
            stalls: vec![(0.1, 0.08), (0.11, 0.05)],
        };
        let (_, slow) = recorded_us();
        assert!(!slow.is_empty());
        let (first_s, over) = blocking.takes_s(0, 0, 0.099);
        assert!(first_s < 0.017 && over == 0);
        assert_eq!(blocking.takes_s(1, 0, 0.105), (0.08, 1));
        // The next began before that one ended.
        assert_eq!(blocking.takes_s(2, 1, 0.186), (0.05, 2));
        assert!(blocking.takes_s(3, 2, 0.24).0 < 0.017);
        assert!((blocking.stalled_part(2.0) - 0.065).abs() < 1e-12);
    }
}
