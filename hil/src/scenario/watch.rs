//! What the console says, kept for judgement: every state, every session, the counters.
//!
//! Entry point: [`Watch::hear`]. It listens at the console's own mouth, before anything goes wrong on the way to the host.

use super::Ticks;
use sutura_shared::hash::TraceHash;
use sutura_shared::wire::message::{Report, State};
use sutura_shared::wire::{Accumulator, Unchecked, decode};

/// A state and when it was said.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// By the bench's count.
    pub at: Ticks,
    /// Counts the console's resets.
    pub boot: u32,
    pub state: State,
}

impl Sample {
    /// \[N\]
    pub fn force_n(&self) -> f64 {
        self.state
            .force_n
            .iter()
            .map(|f| f64::from(*f).powi(2))
            .sum::<f64>()
            .sqrt()
    }
}

/// Everything that a console has said.
#[derive(Default)]
pub(super) struct Watch {
    accumulator: Accumulator,
    boot: u32,
    pub samples: Vec<Sample>,
    /// Sessions that were opened, and when.
    pub opened: Vec<Ticks>,
    pub refused: u32,
    /// First and newest report of each boot.
    reports: Vec<[Report; 2]>,
    /// Frames that were no right ones: a console says none.
    pub wrong: u32,
}

impl Watch {
    /// The console has started anew.
    pub fn reset(&mut self) {
        self.accumulator = Accumulator::new();
        self.boot += 1;
    }

    /// Takes bytes of the exchange that ended at a tick.
    pub fn hear(&mut self, now: Ticks, bytes: &[u8]) {
        let from = self.samples.len();
        for byte in bytes {
            let Some(packet) = self.accumulator.push(*byte) else {
                continue;
            };
            match packet.and_then(decode).and_then(|decoded| decoded.unpack()) {
                Ok(Unchecked::State(_, state)) => self.samples.push(Sample {
                    at: now,
                    boot: self.boot,
                    state,
                }),
                Ok(Unchecked::Hello(_, hello)) if hello.session != 0 => self.opened.push(now),
                Ok(Unchecked::Hello(..)) => self.refused += 1,
                Ok(Unchecked::Report(_, report)) => self.report(report),
                Ok(_) => {}
                Err(_) => self.wrong += 1,
            }
        }
        // By the wall clock several may come at once.
        let newest = self.samples.last().map_or(0, |sample| sample.state.tick);
        for sample in self.samples.iter_mut().skip(from) {
            let before = newest.wrapping_sub(sample.state.tick);
            sample.at = now.saturating_sub(Ticks::from(before));
        }
    }

    fn report(&mut self, report: Report) {
        let boot = self.boot as usize;
        match self.reports.get_mut(boot) {
            Some([_, newest]) => *newest = report,
            None => {
                // A console that booted for this scenario has counted nothing before it; one at a port may have.
                self.reports.resize(boot, [Report::default(); 2]);
                let first = if boot == 0 { report } else { Report::default() };
                self.reports.push([first, report]);
            }
        }
    }

    /// A sum over all boots of what a report counts.
    pub fn counted(&self, count: impl Fn(&Report) -> u32) -> u32 {
        let grown = |[first, last]: &[Report; 2]| count(last).saturating_sub(count(first));
        self.reports.iter().map(grown).sum()
    }

    /// Over every state, in order.
    pub fn hash(&self) -> u64 {
        let mut trace = TraceHash::new();
        for sample in &self.samples {
            trace.word(sample.state.tick);
            trace.double(sample.state.trace_hash);
        }
        trace.value()
    }
}
