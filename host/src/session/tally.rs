//! Counts and sums over a session, from every state and report of the console and every solver step.
//!
//! Entry points: [`Tally::state`], [`Tally::report`], [`Tally::step`], then [`Tally::summary`].
//! Energy is the passivity observer's of Hannaford & Ryu 2002: E = -sum F . dx, with F the contact force
//! on the hand held over one tick and dx the grip's motion in it; positive when the hand did the work.

use super::Solved;
use super::heard::Fate;
use super::horizon::Horizon;
use super::overload::GivenUp;
use super::summary::{Age, Energy, Force, Frames, Latency, StepTime, Summary};
use crate::link::LinkCounters;
use crate::times::Times;
use std::collections::BTreeMap;
use std::time::Duration;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Mode, Report, State};

/// Everything that a session remembers of itself.
#[derive(Debug)]
pub struct Tally {
    host_hz: f64,
    first: Option<State>,
    last: Option<State>,
    states: u64,
    decays: u64,
    peak_n: f64,
    /// Sum of squares \[N^2\].
    square_n2: f64,
    energy_j: f64,
    energy_min_j: f64,
    /// Delay of the whole loop, and the horizon that follows from it.
    pub horizon: Horizon,
    /// Whether somebody else says what became of each contact, those that came too late included.
    is_told: bool,
    /// Contacts that came when they were too old to be used.
    late: u64,
    /// All that the solver's thread does for a solve \[ns\].
    sessions_ns: Times,
    all_ns: u64,
    sent_ns: u64,
    contact_steps: u64,
    /// Of these: whose force was worth a console's while; those that were withheld, or not balanced.
    forceful_steps: u64,
    spoilt_steps: u64,
    rearmed: u64,
    given_up: GivenUp,
    ages_us: Times,
    steps_ns: Times,
    stages_ns: BTreeMap<&'static str, u64>,
    withheld: BTreeMap<&'static str, u64>,
    first_report: Option<Report>,
    last_report: Option<Report>,
    /// Ticks, and what the console counted, before the link was last lost.
    earlier: (u64, ConsoleCounts),
    /// The next state does not follow the last one.
    gap: bool,
}

/// Word of a session's status whose contact was not felt.
pub const NOT_RENDERED: &str = "not-rendered";
/// A force below this nobody notices \[N\].
const NOTICED_N: f64 = 1e-3;
/// Part of the steps in contact that may be withheld or out of balance.
const MOST_SPOILT: f64 = 0.2;

/// Length of a vector.
fn norm(v: [f32; 3]) -> f64 {
    v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt()
}

/// Stable word for a mode.
pub fn mode_word(mode: Mode) -> &'static str {
    match mode {
        Mode::Boot => "boot",
        Mode::Idle => "idle",
        Mode::Armed => "armed",
        Mode::Decaying => "decaying",
        Mode::Fault => "fault",
    }
}

impl Tally {
    /// Nothing has happened yet.
    pub fn new(host_hz: f64) -> Self {
        Tally {
            host_hz,
            first: None,
            last: None,
            states: 0,
            decays: 0,
            peak_n: 0.0,
            square_n2: 0.0,
            energy_j: 0.0,
            energy_min_j: 0.0,
            horizon: Horizon::new(host_hz),
            is_told: false,
            late: 0,
            sessions_ns: Times::new(100_000_000_000),
            all_ns: 0,
            sent_ns: 0,
            contact_steps: 0,
            forceful_steps: 0,
            spoilt_steps: 0,
            rearmed: 0,
            given_up: GivenUp::default(),
            ages_us: Times::new(u64::from(u32::MAX)),
            steps_ns: Times::new(100_000_000_000),
            stages_ns: BTreeMap::new(),
            withheld: BTreeMap::new(),
            first_report: None,
            last_report: None,
            earlier: Default::default(),
            gap: false,
        }
    }

    /// The link was lost: what comes next is of another session, and maybe of a console that has started anew.
    pub fn lose(&mut self) {
        self.earlier = (self.ticks(), self.counted());
        self.first = None;
        self.first_report = None;
        self.last_report = None;
        self.gap = true;
    }

    /// Takes note of a state of the console.
    pub fn state(&mut self, state: &State) {
        self.horizon.tick(state.tick);
        let force = norm(state.force_n);
        self.peak_n = self.peak_n.max(force);
        self.square_n2 += force * force;
        self.states += 1;
        if matches!(state.mode, Mode::Armed | Mode::Decaying) && state.contact_age_us != u32::MAX {
            self.ages_us.record(u64::from(state.contact_age_us));
        }
        if let Some(before) = self.last.filter(|_| !self.gap) {
            let work = (0..3).map(|i| {
                f64::from(before.force_n[i]) * f64::from(state.position_m[i] - before.position_m[i])
            });
            self.energy_j -= work.sum::<f64>();
            self.energy_min_j = self.energy_min_j.min(self.energy_j);
            let is_new = state.contact_sequence != before.contact_sequence;
            if is_new && state.contact_sequence != 0 && !self.is_told {
                self.horizon.applied(state.applied_age_us);
            }
            if state.mode == Mode::Decaying && before.mode == Mode::Armed {
                self.decays += 1;
            }
        }
        self.gap = false;
        self.first.get_or_insert(*state);
        self.last = Some(*state);
    }

    /// From now on [`Self::fate`] says what became of contacts, and not the states alone.
    pub fn hear_of_fates(&mut self) {
        self.is_told = true;
    }

    /// Takes note of what became of a contact.
    pub fn fate(&mut self, fate: Fate) {
        match fate {
            Fate::Used { age_us } => self.horizon.applied(age_us),
            Fate::TooLate { age_us } => {
                self.late += 1;
                self.horizon.applied(age_us);
            }
            Fate::Lost => {}
        }
    }

    /// Takes note of all that a solve took, sending included.
    pub fn session(&mut self, time: Duration, sending: Duration) {
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.sessions_ns.record(ns(time));
        self.all_ns += ns(time);
        self.sent_ns += ns(sending);
    }

    /// The console was armed again after it had let go.
    pub fn rearm(&mut self) {
        self.rearmed += 1;
    }

    /// What was given up so far.
    pub fn give_up(&mut self, given_up: GivenUp) {
        self.given_up = given_up;
    }

    /// Takes note of the console's counters.
    pub fn report(&mut self, report: &Report) {
        self.first_report.get_or_insert(*report);
        self.last_report = Some(*report);
    }

    /// Takes note of a solver step.
    pub fn step(&mut self, solved: &Solved, time: Duration) {
        self.steps_ns
            .record(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
        for (stage, ns) in solved.stages.named() {
            *self.stages_ns.entry(stage).or_default() += ns;
        }
        let wrench = solved.contact.map_or([0.0; 6], |contact| contact.wrench);
        let [x, y, z, ..] = wrench;
        self.contact_steps += u64::from(solved.touched);
        self.forceful_steps += u64::from((x * x + y * y + z * z).sqrt() > NOTICED_N);
        let is_spoilt = solved.contact.is_none() || solved.unfinished;
        self.spoilt_steps += u64::from(solved.touched && is_spoilt);
        if solved.contact.is_none() {
            *self.withheld.entry(solved.status.name()).or_default() += 1;
        }
    }

    /// The newest state.
    pub fn last(&self) -> Option<&State> {
        self.last.as_ref()
    }

    /// The newest report.
    pub fn last_report(&self) -> Option<&Report> {
        self.last_report.as_ref()
    }

    /// Ticks from the first state to the newest, both counted, without those in which the link was lost.
    pub fn ticks(&self) -> u64 {
        let (earlier, _) = self.earlier;
        match (&self.first, &self.last) {
            (Some(first), Some(last)) => {
                earlier + u64::from(last.tick.wrapping_sub(first.tick)) + 1
            }
            _ => earlier,
        }
    }

    /// What the console counted.
    fn counted(&self) -> ConsoleCounts {
        let (_, earlier) = self.earlier;
        // The first report comes with the answer to `Hello` and tells what was counted before the session.
        let now = since(
            self.first_report.unwrap_or_default(),
            self.last_report.unwrap_or_default(),
        );
        ConsoleCounts {
            overruns: earlier.overruns + now.overruns,
            late: earlier.late + now.late,
            lost: earlier.lost + now.lost,
            rejected: earlier.rejected + now.rejected,
            superseded: earlier.superseded + now.superseded,
        }
    }

    /// Mean time of each stage of a solve, of sending it, and of what no stage names \[us\].
    fn stages_us(&self, steps: u64) -> BTreeMap<&'static str, f64> {
        let named_ns: u64 = self.stages_ns.values().sum::<u64>() + self.sent_ns;
        let mean_us = |ns: u64| ns as f64 / 1e3 / steps.max(1) as f64;
        let stages = self.stages_ns.iter().map(|(name, ns)| (*name, *ns));
        let others = [
            ("send", self.sent_ns),
            ("rest", self.all_ns.saturating_sub(named_ns)),
        ];
        stages
            .chain(others)
            .map(|(name, ns)| (name, mean_us(ns)))
            .collect()
    }

    /// Why what the solver found was not felt, if it was not.
    fn not_rendered(&self) -> Option<String> {
        if self.forceful_steps > 0 && self.peak_n < NOTICED_N {
            return Some(format!(
                "{} steps found a force, and the console rendered none",
                self.forceful_steps
            ));
        }
        let share = self.spoilt_steps as f64 / self.contact_steps.max(1) as f64;
        (share > MOST_SPOILT).then(|| {
            format!(
                "{:.0} % of the steps in contact were withheld or not balanced",
                1e2 * share
            )
        })
    }

    /// The session in numbers; the caller fills in what only it knows.
    pub fn summary(&self, link: &LinkCounters, tick_hz: u16) -> Summary {
        let us = |times: &Times, share, unit: f64| times.quantile(share) as f64 / unit;
        let delays = self.horizon.delays_us();
        let steps = self.steps_ns.count();
        let seconds = self.ticks() as f64 / f64::from(tick_hz);
        let mode = self.last.map_or(Mode::Boot, |state| state.mode);
        let faults: Vec<String> = faults::names(self.last.map_or(0, |s| s.faults))
            .map(str::to_owned)
            .collect();
        let console = self.counted();
        let frames = Frames {
            sent: u64::from(link.frames.frames_sent),
            lost: u64::from(link.frames.frames_lost) + console.lost,
            rejected: u64::from(link.frames.frames_rejected) + console.rejected,
            late: self.late,
            superseded: link.states_superseded + link.contacts_superseded + console.superseded,
        };
        Summary {
            status: match (mode, self.not_rendered()) {
                (Mode::Fault, _) => format!("fault: {}", faults.join(", ")),
                (_, Some(why)) => format!("{NOT_RENDERED}: {why}"),
                (Mode::Idle, _) => "idle: no usable contact for too long".to_owned(),
                _ => "ok".to_owned(),
            },
            contact_steps: self.contact_steps,
            rearmed: self.rearmed,
            overload: self.given_up,
            horizon_ms: Age {
                p50: us(self.horizon.given_us(), 0.5, 1e3),
                max: self.horizon.given_us().max() as f64 / 1e3,
            },
            session_us: StepTime {
                p50: us(&self.sessions_ns, 0.5, 1e3),
                p99: us(&self.sessions_ns, 0.99, 1e3),
                max: self.sessions_ns.max() as f64 / 1e3,
            },
            tick_hz: u32::from(tick_hz),
            ticks: self.ticks(),
            tick_overruns: console.overruns,
            ticks_late: console.late,
            mode: mode_word(mode).to_owned(),
            faults,
            host_hz: self.host_hz,
            host_hz_reached: if seconds > 0.0 {
                steps as f64 / seconds
            } else {
                0.0
            },
            steps_withheld: self.withheld.clone(),
            decays: self.decays,
            frames,
            latency_us: Latency {
                p50: us(delays, 0.5, 1.0),
                p99: us(delays, 0.99, 1.0),
                p999: us(delays, 0.999, 1.0),
                max: delays.max() as f64,
            },
            age_ms: Age {
                p50: us(&self.ages_us, 0.5, 1e3),
                max: self.ages_us.max() as f64 / 1e3,
            },
            step_us: StepTime {
                p50: us(&self.steps_ns, 0.5, 1e3),
                p99: us(&self.steps_ns, 0.99, 1e3),
                max: self.steps_ns.max() as f64 / 1e3,
            },
            stages_us: self.stages_us(steps),
            force_n: Force {
                peak: self.peak_n,
                rms: (self.square_n2 / self.states.max(1) as f64).sqrt(),
            },
            energy_j: Energy {
                min: self.energy_min_j,
            },
            trace_hash: format!("{:016x}", self.last.map_or(0, |state| state.trace_hash)),
            seconds,
            ..Summary::default()
        }
    }
}

/// What the console counted during the session.
#[derive(Clone, Copy, Debug, Default)]
struct ConsoleCounts {
    overruns: u64,
    late: u64,
    lost: u64,
    rejected: u64,
    superseded: u64,
}

/// Difference of two reports: the console counts since its boot, over several sessions.
fn since(first: Report, last: Report) -> ConsoleCounts {
    let grown = |first: u32, last: u32| u64::from(last.wrapping_sub(first));
    ConsoleCounts {
        overruns: grown(first.tick_overruns, last.tick_overruns),
        late: grown(first.ticks_late, last.ticks_late),
        lost: grown(first.frames_lost, last.frames_lost),
        rejected: grown(first.frames_rejected, last.frames_rejected),
        superseded: grown(first.frames_superseded, last.frames_superseded),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::step::{Status, ToolContact};

    fn state(tick: u32, z: f32, force: f32) -> State {
        State {
            tick,
            position_m: [0.0, 0.0, z],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            force_n: [0.0, 0.0, force],
            current_a: [0.0; 3],
            mode: Mode::Armed,
            faults: 0,
            contact_sequence: 1,
            contact_age_us: 4_000,
            applied_age_us: 3_000,
            trace_hash: 0x0123_4567_89ab_cdef,
            encoder_counts: [0; 3],
            inputs: 0,
            heard_sequence: 0,
        }
    }

    /// A spring of 100 N/m: pressed 10 ticks of 1 mm, let go 10 ticks. Held over each tick, its force is late
    /// by half a tick: pressing costs the hand 0.5 k (x^2 - x dx), letting go gives 0.5 k (x^2 + x dx), so that
    /// k x dx = 1 mJ more comes back than went in (Colgate & Schenkel 1997).
    #[test]
    fn the_energy_of_a_held_spring_is_that_of_its_lateness() {
        let mut tally = Tally::new(100.0);
        let depths = (0..=10).chain((0..10).rev());
        for (tick, depth) in (0..).zip(depths) {
            tally.state(&state(tick, -1e-3 * depth as f32, 0.1 * depth as f32));
        }
        let summary = tally.summary(&LinkCounters::default(), 1000);
        let expected = -100.0 * 0.01 * 0.001;
        assert!(
            (summary.energy_j.min - expected).abs() < 1e-8,
            "{:?}",
            summary.energy_j
        );
        assert!(
            (summary.force_n.peak - 1.0).abs() < 1e-6,
            "{:?}",
            summary.force_n
        );
        assert_eq!((summary.ticks, summary.seconds), (21, 0.021));
        assert_eq!(summary.trace_hash, "0123456789abcdef");
    }

    #[test]
    fn counts_are_those_of_the_session() {
        let report = |lost| Report {
            frames_lost: lost,
            ticks_late: 10 * lost,
            ..Report::default()
        };
        let lost = |reports: &[u32]| {
            let mut tally = Tally::new(100.0);
            reports.iter().for_each(|lost| tally.report(&report(*lost)));
            let summary = tally.summary(&LinkCounters::default(), 1000);
            (summary.frames.lost, summary.ticks_late)
        };
        assert_eq!(lost(&[0, 2, 5]), (5, 50), "a console that has just booted");
        assert_eq!(lost(&[2, 5]), (3, 30), "one that had sessions before");
        assert_eq!(lost(&[]), (0, 0));
    }

    /// The console starts anew in between: its ticks and its counts begin at 0 again.
    #[test]
    fn a_lost_link_adds_nothing_of_its_own() {
        let mut tally = Tally::new(100.0);
        let report = |lost| Report {
            frames_lost: lost,
            ..Report::default()
        };
        for tick in 500..510 {
            tally.state(&state(tick, 0.0, 1.0));
        }
        [report(40), report(43)]
            .iter()
            .for_each(|r| tally.report(r));
        tally.lose();
        assert_eq!(tally.ticks(), 10);
        [report(0), report(2)].iter().for_each(|r| tally.report(r));
        // Ten metres away: that is no work.
        for tick in 3..8 {
            tally.state(&state(tick, 10.0, 1.0));
        }
        let summary = tally.summary(&LinkCounters::default(), 1000);
        assert_eq!((summary.ticks, summary.frames.lost), (15, 5));
        assert_eq!(summary.energy_j.min, 0.0);
    }

    #[test]
    fn latency_is_counted_once_a_contact_and_decay_once_a_fall() {
        let mut tally = Tally::new(100.0);
        for (tick, contact, mode) in [
            (0, 1, Mode::Armed),
            (1, 1, Mode::Armed),
            (2, 2, Mode::Armed),
            (3, 2, Mode::Decaying),
            (4, 2, Mode::Decaying),
            (5, 3, Mode::Armed),
        ] {
            tally.state(&State {
                contact_sequence: contact,
                mode,
                ..state(tick, 0.0, 0.0)
            });
        }
        assert_eq!(tally.horizon.delays_us().count(), 2);
        assert_eq!(tally.summary(&LinkCounters::default(), 1000).decays, 1);
    }

    #[test]
    fn steps_that_are_not_sent_are_counted_by_their_reason() {
        let mut tally = Tally::new(100.0);
        let solved = |status, contact| Solved {
            position_m: [0.0; 3],
            contact,
            status,
            ..Solved::default()
        };
        tally.step(
            &solved(Status::Ok, Some(ToolContact::default())),
            Duration::from_micros(200),
        );
        tally.step(&solved(Status::Waiting, None), Duration::from_micros(900));
        let summary = tally.summary(&LinkCounters::default(), 1000);
        assert_eq!(summary.steps_withheld, BTreeMap::from([("waiting", 1)]));
        assert_eq!(summary.step_us.max, 900.0);
    }
}
