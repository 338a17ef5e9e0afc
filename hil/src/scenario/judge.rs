//! What was expected of a scenario against what its console said.
//!
//! Entry point: `judge`.

use super::watch::{Sample, Watch};
use super::{Fault, FaultKind, Scenario, Ticks};
use sutura_host::session::mode_word;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::Mode;

/// By how much a time may be longer where ticks come by the wall clock \[ticks\]: what the console said lies for a while
/// with the system before the bench hears it.
pub const REAL_TIME_SLACK: Ticks = 10;
/// Time before a fault from which is known what was felt \[ticks\].
const BEFORE: Ticks = 50;
/// States from which the mode at the end is known where ticks come by the wall clock.
const SHORTLY: usize = 100;
/// Less than this is no force \[N\].
const NOTHING_N: f64 = 1e-6;

/// One expectation.
#[derive(Clone, Debug)]
pub struct Check {
    /// Of what, as in the file.
    pub what: String,
    /// What was expected.
    pub limit: String,
    /// What was found.
    pub found: String,
    /// Whether that is right.
    pub met: bool,
}

impl Check {
    fn most(what: impl Into<String>, limit: f64, found: f64, unit: &str) -> Self {
        Check {
            what: what.into(),
            limit: format!("at most {limit} {unit}"),
            found: format!("{found:.4} {unit}"),
            met: found <= limit,
        }
    }

    fn least(what: impl Into<String>, limit: f64, found: f64, unit: &str) -> Self {
        Check {
            what: what.into(),
            limit: format!("at least {limit} {unit}"),
            found: format!("{found:.4} {unit}"),
            met: found >= limit,
        }
    }

    fn within(what: String, limit: Ticks, slack: Ticks, found: Option<Ticks>) -> Self {
        Check {
            what,
            limit: format!("within {limit} ms"),
            found: found.map_or("never".to_owned(), |found| format!("after {found} ms")),
            met: found.is_some_and(|found| found <= limit + slack),
        }
    }

    fn same(what: &str, limit: String, found: String) -> Self {
        Check {
            what: what.to_owned(),
            met: limit == found,
            limit,
            found,
        }
    }

    fn range(what: &str, [least, most]: [u32; 2], found: u32) -> Self {
        Check {
            what: what.to_owned(),
            limit: format!("{least} to {most}"),
            found: found.to_string(),
            met: (least..=most).contains(&found),
        }
    }
}

/// Judges a scenario. `times`: when each fault really began and was over; `exact`: ticks came in lockstep.
pub(super) fn judge(
    scenario: &Scenario,
    watch: &Watch,
    times: &[(Ticks, Ticks)],
    exact: bool,
) -> Vec<Check> {
    let slack = if exact { 0 } else { REAL_TIME_SLACK };
    let judge = Judge {
        scenario,
        watch,
        slack,
    };
    let mut checks = judge.whole();
    for (fault, (began, over)) in scenario.faults.iter().zip(times) {
        let name = format!("at {} ms", fault.at);
        let really = Fault {
            at: *began,
            until: *over,
            ..fault.clone()
        };
        checks.extend(judge.fault(&name, &really));
    }
    checks
}

struct Judge<'a> {
    scenario: &'a Scenario,
    watch: &'a Watch,
    slack: Ticks,
}

fn highest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, f64::max)
}

fn names(bits: u16) -> String {
    let names: Vec<_> = faults::names(bits).collect();
    if names.is_empty() {
        "none".to_owned()
    } else {
        names.join(", ")
    }
}

impl Judge<'_> {
    fn samples(&self, from: Ticks, until: Ticks) -> impl Iterator<Item = &Sample> {
        let samples = self.watch.samples.iter();
        samples.filter(move |sample| (from..until).contains(&sample.at))
    }

    fn whole(&self) -> Vec<Check> {
        let expect = &self.scenario.expect;
        let samples = &self.watch.samples;
        let peak = highest(samples.iter().map(Sample::force_n));
        let mut checks = Vec::new();
        checks.extend(expect.force_n.map(|n| Check::most("force_n", n, peak, "N")));
        checks.extend(expect.felt_n.map(|n| Check::least("felt_n", n, peak, "N")));
        checks.extend(
            expect
                .step_n
                .map(|n| Check::most("step_n", n, self.step_n(), "N")),
        );
        let given = expect.given_back_j;
        checks.extend(given.map(|j| Check::most("given_back_j", j, self.given_back_j(), "J")));
        if let Some(mode) = expect.mode {
            checks.push(self.mode(mode));
        }
        let latched = samples
            .iter()
            .fold(0, |all, sample| all | sample.state.faults);
        checks.push(Check::same("faults", names(expect.faults), names(latched)));
        let rejected = self.watch.counted(|report| report.frames_rejected);
        checks.extend(
            expect
                .rejected
                .map(|range| Check::range("rejected", range, rejected)),
        );
        let lost = self.watch.counted(|report| report.frames_lost);
        checks.extend(expect.lost.map(|range| Check::range("lost", range, lost)));
        let opened = self.watch.opened.len() as u32;
        checks.extend(
            expect
                .sessions
                .map(|range| Check::range("sessions", range, opened)),
        );
        let refused = self.watch.refused;
        checks.extend(
            expect
                .refusals
                .map(|range| Check::range("refusals", range, refused)),
        );
        // Whatever the scenario is: a console says whole frames, and counts.
        checks.push(Check::range(
            "wrong frames of the console",
            [0, 0],
            self.watch.wrong,
        ));
        checks
    }

    /// The mode at the end. By the wall clock a host that this machine holds up just then lets the console decay for a
    /// moment: there it is enough to have been seen shortly before.
    fn mode(&self, mode: Mode) -> Check {
        let late = if self.slack > 0 { SHORTLY } else { 1 };
        let mut newest = self.watch.samples.iter().rev().take(late);
        let last = newest.clone().next();
        let last = last.map_or("silent", |sample| mode_word(sample.state.mode));
        Check {
            met: newest.any(|sample| sample.state.mode == mode),
            ..Check::same("mode", mode_word(mode).to_owned(), last.to_owned())
        }
    }

    /// Pairs of states of one boot, and the ticks between them.
    fn pairs(&self) -> impl Iterator<Item = (&Sample, &Sample, u32)> {
        let pairs = self
            .watch
            .samples
            .iter()
            .zip(self.watch.samples.iter().skip(1));
        pairs.filter_map(|(a, b)| {
            let ticks = b.state.tick.wrapping_sub(a.state.tick);
            (a.boot == b.boot && ticks > 0).then_some((a, b, ticks))
        })
    }

    fn step_n(&self) -> f64 {
        highest(self.pairs().map(|(a, b, ticks)| {
            let change = a.state.force_n.iter().zip(b.state.force_n);
            let square: f64 = change.map(|(a, b)| f64::from(b - a).powi(2)).sum();
            square.sqrt() / f64::from(ticks)
        }))
    }

    /// Most that the hand had been given more than it had put in, at any time.
    fn given_back_j(&self) -> f64 {
        let mut put_in = 0.0_f64;
        highest(self.pairs().map(|(a, b, _)| {
            let ways = b.state.position_m.iter().zip(a.state.position_m);
            let work = ways
                .zip(a.state.force_n)
                .map(|((to, from), force)| f64::from(to - from) * f64::from(force));
            put_in -= work.sum::<f64>();
            -put_in
        }))
    }

    fn fault(&self, name: &str, fault: &Fault) -> Vec<Check> {
        let expect = fault.expect;
        // What a reset does is done at once, and what follows lasts.
        let over = match fault.kind {
            FaultKind::ConsoleReset => fault.at,
            _ => fault.until,
        };
        let mut checks = Vec::new();
        if expect.zero.is_some() || expect.recovers.is_some() {
            let felt = highest(self.before(fault));
            checks.push(Check::least(
                format!("{name}: felt before"),
                0.05,
                felt,
                "N",
            ));
        }
        if let Some(limit) = expect.zero {
            let found = self.zero_after(fault);
            checks.push(Check::within(
                format!("{name}: zero_within_ms"),
                limit,
                self.slack,
                found,
            ));
        }
        if let Some(limit) = expect.recovers {
            let found = self.recovered_after(fault, over);
            let what = format!("{name}: recovers_within_ms");
            checks.push(Check::within(what, limit, self.slack, found));
        }
        if let Some(limit) = expect.reconnects {
            let opened = self.watch.opened.iter().find(|at| **at >= over);
            let found = opened.map(|at| at - over);
            let what = format!("{name}: reconnects_within_ms");
            checks.push(Check::within(what, limit, self.slack, found));
        }
        if let Some(limit) = expect.silent {
            let last = self.samples(fault.at, fault.until).last();
            let found = last.map_or(0, |sample| sample.at - fault.at);
            let what = format!("{name}: silent_within_ms");
            checks.push(Check::within(what, limit, self.slack, Some(found)));
        }
        if let Some(limit) = expect.holds_n {
            let during = self.samples(fault.at, fault.until).map(Sample::force_n);
            let least = during.fold(f64::INFINITY, f64::min);
            // None at all is no force.
            let least = if least.is_finite() { least } else { 0.0 };
            checks.push(Check::least(format!("{name}: holds_n"), limit, least, "N"));
        }
        checks
    }

    fn before(&self, fault: &Fault) -> impl Iterator<Item = f64> {
        let from = fault.at.saturating_sub(BEFORE);
        self.samples(from, fault.at).map(Sample::force_n)
    }

    /// Ticks from a fault's beginning to its first state without force that no state with force follows while it lasts.
    fn zero_after(&self, fault: &Fault) -> Option<Ticks> {
        let mut zero = None;
        for sample in self.samples(fault.at, fault.until) {
            if sample.force_n() > NOTHING_N {
                zero = None;
            } else if zero.is_none() {
                zero = Some(sample.at - fault.at);
            }
        }
        zero
    }

    fn recovered_after(&self, fault: &Fault, over: Ticks) -> Option<Ticks> {
        let felt: Vec<f64> = self.before(fault).collect();
        let half = 0.5 * felt.iter().sum::<f64>() / felt.len().max(1) as f64;
        let mut after = self.samples(over, Ticks::MAX);
        let back = after.find(|s| s.state.mode == Mode::Armed && s.force_n() >= half);
        back.map(|sample| sample.at - over)
    }
}
