//! Counts and sums over a session, from every state and report of the console and every solver step.
//!
//! Entry points: [`Statistics::state`], [`Statistics::report`], [`Statistics::step`], [`Statistics::frame`], [`Statistics::fate`], then
//! [`Statistics::summary`].
//! Energy is the passivity observer's of Hannaford & Ryu 2002: E = -sum F . dx, with F the contact force
//! on the hand held over one tick and dx the grip's motion in it; positive when the hand did the work.

use super::ending::{Ending, EndingKind};
use super::fault_names;
use super::fault_words::said;
use super::heard::Fate;
use super::horizon::Horizon;
use super::limited::{Cuts, LimitWatch, LimitedTicks};
use super::overload::GivenUp;
use super::summary::{
    Age, Energy, Force, Frames, Latency, Percentiles, SafeStop, StepTime, Stop, Summary,
};
use super::{Plan, Solved};
use crate::link::{Felt, LinkCounters, Order, SentContact};
use crate::step::Status;
use crate::times::Times;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use sutura_shared::control::{TICK_HZ, TicksLimited};
use sutura_shared::wire::inputs;
use sutura_shared::wire::message::{Command, Contact, Fixture, Mode, Report, State};
use sutura_shared::wire::validate::{MAX_TANGENT, MAX_WRENCH};

/// Everything that a session remembers of itself.
#[derive(Debug)]
pub struct Statistics {
    host_hz: f64,
    first: Option<State>,
    last: Option<State>,
    states: u64,
    decays: u64,
    ticks_withheld: u64,
    limits: LimitWatch,
    peak_n: f64,
    /// Largest force that steps found \[N\].
    solved_peak_n: f64,
    /// Whether the console had something to render that no solver knows.
    had_fixture: bool,
    /// Safe stops that a person asked for.
    safe_stops: Vec<SafeStop>,
    /// Why the console rests if that is because of a person.
    rests: Option<(Stop, SafeStop)>,
    /// Whether the console was told to arm, and no state has shown it armed since.
    arming: bool,
    /// Sum of squares \[N^2\].
    square_n2: f64,
    energy_j: f64,
    energy_min_j: f64,
    /// Delay of the whole loop, and the horizon that follows from it.
    pub horizon: Horizon,
    /// Contacts that came when they were too old to be used.
    late: u64,
    /// All that the solver's thread does for a solve \[ns\].
    sessions_ns: Times,
    /// What the solver's thread had of a core in a solve, in lockstep \[ns\].
    cores_ns: Times,
    all_ns: u64,
    sent_ns: u64,
    /// Second of the session that is under way; the largest mean of one so far \[ns\].
    second: Second,
    worst_second_ns: f64,
    contact_steps: u64,
    /// Of these: whose force was worth a console's while; those that were withheld, or not balanced.
    forceful_steps: u64,
    spoilt_steps: u64,
    /// Console time of the states for which contacts with such a force went out \[us\], the newest last.
    forceful_us: VecDeque<u64>,
    /// Of these: that the console used.
    forceful_used: u64,
    /// Why the newest steps were withheld, and how many in a row.
    withheld_last: Option<(&'static str, u64)>,
    /// The same before the newest step.
    withheld_before: Option<(&'static str, u64)>,
    /// Whether the needle waited in the newest step, and in how many it did.
    waits: bool,
    steps_waited: u64,
    /// Steps that lagged behind the hands, how far at most \[m\], and those that lagged by more than they touched.
    steps_behind: u64,
    most_lag_m: f64,
    steps_outrun: u64,
    steps_missed: u64,
    /// Tick of the first state of those in which the console decays.
    decaying_since: Option<u32>,
    /// Steps of a tool on tissue, and of one inside it.
    pressing_steps: u64,
    inside_steps: u64,
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

/// A force below this nobody notices \[N\].
const NOTICED_N: f64 = 1e-3;
/// Largest force of a tool that touches, below which the tissue cannot be meant \[N\].
pub(super) const FAINT_N: f64 = 5e-3;
/// Force that is felt beyond doubt \[N\].
const FELT_N: f64 = 0.05;
/// Safe stops of which a summary tells.
const MOST_STOPS: usize = 100;
/// Steps at the end of a session whose contacts may not have come yet.
const UNDERWAY: u64 = 4;
/// Part of the steps in contact that may be withheld or out of balance.
pub(super) const MOST_SPOILT: f64 = 0.2;
/// Steps in contact of which that part says something \[s of planned steps\].
const LEAST_CONTACT_S: f64 = 0.25;
/// Tools may be late in the tissue for so long \[s\].
const MOST_MISSED_S: f64 = 0.1;
/// Part of an end's frames that a good line has it refuse, and how many in any case.
const MOST_REFUSED: f64 = 0.01;
const FEW_REFUSED: u64 = 10;
/// Contacts that may be on their way, see [`super::Underway`].
const MOST_UNDERWAY: usize = 128;
/// Part of a second that solves must fill for their mean to be that of a second \[ns\].
const LEAST_FILLED_NS: u64 = 500_000_000;
/// Why a step is withheld that was solved well and whose numbers the console would refuse.
pub const UNSENDABLE: &str = "unsendable";

/// Solves of a second of the session.
#[derive(Clone, Copy, Debug, Default)]
struct Second {
    number: u64,
    solves: u64,
    sum_ns: u64,
    /// Their periods, or what they took where that is longer \[ns\]: late solves are few.
    filled_ns: u64,
}

impl Second {
    /// Mean of a solve \[ns\].
    fn mean_ns(&self) -> f64 {
        self.sum_ns as f64 / self.solves.max(1) as f64
    }

    /// Mean of a solve \[ns\]; 0 if too little of the second was planned for one.
    fn full_mean_ns(&self) -> f64 {
        if self.filled_ns >= LEAST_FILLED_NS {
            self.mean_ns()
        } else {
            0.0
        }
    }
}

/// Length of a vector.
fn norm(v: [f32; 3]) -> f64 {
    v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt()
}

/// Whether the console renders.
fn renders(state: &State) -> bool {
    matches!(state.mode, Mode::Armed | Mode::Decaying)
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

impl Statistics {
    /// Nothing has happened yet.
    pub fn new(host_hz: f64) -> Self {
        Statistics {
            host_hz,
            first: None,
            last: None,
            states: 0,
            decays: 0,
            ticks_withheld: 0,
            limits: LimitWatch::default(),
            peak_n: 0.0,
            solved_peak_n: 0.0,
            had_fixture: false,
            safe_stops: Vec::new(),
            rests: None,
            arming: false,
            square_n2: 0.0,
            energy_j: 0.0,
            energy_min_j: 0.0,
            horizon: Horizon::new(host_hz),
            late: 0,
            sessions_ns: Times::new(100_000_000_000),
            cores_ns: Times::new(100_000_000_000),
            all_ns: 0,
            second: Second::default(),
            worst_second_ns: 0.0,
            sent_ns: 0,
            contact_steps: 0,
            forceful_steps: 0,
            spoilt_steps: 0,
            forceful_us: VecDeque::with_capacity(MOST_UNDERWAY),
            forceful_used: 0,
            withheld_last: None,
            withheld_before: None,
            waits: false,
            steps_waited: 0,
            steps_behind: 0,
            most_lag_m: 0.0,
            steps_outrun: 0,
            steps_missed: 0,
            decaying_since: None,
            pressing_steps: 0,
            inside_steps: 0,
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

    /// Statistics of a session by this plan.
    pub fn of(plan: &Plan) -> Self {
        let mut new = Statistics::new(plan.host_hz);
        new.horizon.at_least(plan.horizon_us);
        new.limits.max_force_n = plan.device.max_force_n;
        new.limits.max_power_w = plan.device.max_power_w;
        new.had_fixture = plan.fixture != Fixture::None;
        new
    }

    /// Solves are to come `host_hz` times a second from now on.
    pub fn change(&mut self, host_hz: f64) {
        self.host_hz = host_hz;
        self.horizon.change(host_hz);
    }

    /// The link was lost: what comes next is of another session, and maybe of a console that has started anew.
    pub fn lose(&mut self) {
        self.earlier = (self.ticks(), self.console_counts());
        self.first = None;
        self.first_report = None;
        self.last_report = None;
        (self.gap, self.arming) = (true, false);
    }

    /// Takes note of a state of the console.
    pub fn state(&mut self, state: &State) {
        self.horizon.tick(state.tick);
        let force = norm(state.force_n);
        self.limits.state(force);
        self.peak_n = self.peak_n.max(force);
        self.square_n2 += force * force;
        self.states += 1;
        self.ticks_withheld += u64::from(state.inputs & inputs::WITHHELD != 0);
        if matches!(state.mode, Mode::Armed | Mode::Decaying) && state.contact_age_us != u32::MAX {
            self.ages_us.record(u64::from(state.contact_age_us));
        }
        if let Some(before) = self.last.filter(|_| !self.gap) {
            let work = (0..3).map(|i| {
                f64::from(before.force_n[i]) * f64::from(state.position_m[i] - before.position_m[i])
            });
            self.energy_j -= work.sum::<f64>();
            self.energy_min_j = self.energy_min_j.min(self.energy_j);
            if state.mode == Mode::Decaying && before.mode == Mode::Armed {
                self.decays += 1;
            }
        }
        let decays = state.mode == Mode::Decaying;
        self.decaying_since = decays.then_some(self.decaying_since.unwrap_or(state.tick));
        self.gap = false;
        self.arming &= !renders(state);
        self.first.get_or_insert(*state);
        self.last = Some(*state);
    }

    /// Takes note of a contact that goes out for the state of `console_time_us`.
    pub fn frame(&mut self, console_time_us: u64, contact: &Contact) {
        self.horizon.gave(contact.horizon_us);
        let [x, y, z, ..] = contact.wrench;
        if norm([x, y, z]) <= NOTICED_N {
            return;
        }
        if self.forceful_us.len() >= MOST_UNDERWAY {
            self.forceful_us.pop_front();
        }
        self.forceful_us.push_back(console_time_us);
    }

    /// Takes note of what became of a contact.
    pub fn fate(&mut self, contact: &SentContact, fate: Fate) {
        let us = contact.console_time_us;
        let is_forceful = self.forceful_us.contains(&us);
        match fate {
            Fate::Used { age_us } => {
                self.horizon.applied(age_us);
                self.forceful_used += u64::from(is_forceful);
            }
            Fate::TooLate { age_us } => {
                self.late += 1;
                self.horizon.applied(age_us);
            }
            Fate::Lost => {}
        }
    }

    /// The solver's thread had so much of a core in a solve.
    pub fn core(&mut self, time: Duration) {
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.cores_ns.record(ns);
    }

    /// Takes note of all that a solve took, sending included.
    pub fn session(&mut self, time: Duration, sending: Duration) {
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.sessions_ns.record(ns(time));
        self.all_ns += ns(time);
        let now = (self.ticks() as f64 / f64::from(TICK_HZ)) as u64;
        if self.second.number != now {
            self.worst_second_ns = self.worst_second_ns.max(self.second.full_mean_ns());
            self.second = Second {
                number: now,
                ..Second::default()
            };
        }
        let second = &mut self.second;
        second.solves += 1;
        second.sum_ns += ns(time);
        second.filled_ns += ns(time).max((1e9 / self.host_hz) as u64);
        self.sent_ns += ns(sending);
    }

    /// The console was armed again after it had let go.
    pub fn rearm(&mut self) {
        self.rearmed += 1;
        self.order(&Order::Command(Command::Arm));
    }

    /// Takes note of a request of the person of that name while the session ran.
    pub fn stop(&mut self, stop: Stop, by: String) {
        let at_s = self.ticks() as f64 / f64::from(TICK_HZ);
        let asked = SafeStop { at_s, by };
        if stop == Stop::Safe && self.safe_stops.len() < MOST_STOPS {
            self.safe_stops.push(asked.clone());
        }
        // One that let go before is not at rest because of this, nor because of a second one.
        let is_cause = match &self.rests {
            None => self.arming || self.last.as_ref().is_some_and(renders),
            Some((Stop::TakeOut, _)) => stop == Stop::Safe,
            Some((Stop::Safe, _)) => false,
        };
        if is_cause {
            self.rests = Some((stop, asked));
        }
    }

    /// Takes note of an order that was given while the session ran.
    pub fn order(&mut self, order: &Order) {
        match order {
            Order::Command(Command::Arm) => (self.rests, self.arming) = (None, true),
            Order::Command(Command::Disarm) => self.arming = false,
            Order::Fixture(fixture) => self.had_fixture |= *fixture != Fixture::None,
            _ => {}
        }
    }

    /// Whether the console rests because of a person; who that was, and what was asked for.
    pub fn stopped_by(&self) -> Option<(Stop, &str)> {
        let rests = self.rests.as_ref();
        rests.map(|(stop, asked)| (*stop, asked.by.as_str()))
    }

    /// Takes the console's own counts of what its limits took away in the session.
    pub fn counted(&mut self, limited: TicksLimited) {
        self.limits.counted(limited);
    }

    /// Ticks so far in which a limit of the device took a part of the force away.
    pub fn limited(&self) -> LimitedTicks {
        self.limits.ticks()
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
        let force_n = (x * x + y * y + z * z).sqrt();
        self.contact_steps += u64::from(solved.touched);
        self.pressing_steps += u64::from(solved.presses);
        self.solved_peak_n = self.solved_peak_n.max(force_n).max(solved.step_n);
        self.forceful_steps += u64::from(force_n > NOTICED_N);
        let is_spoilt = solved.contact.is_none() || solved.unfinished;
        self.spoilt_steps += u64::from(solved.touched && is_spoilt);
        self.waits = solved.needle.is_some_and(|needle| needle.waits);
        self.steps_waited += u64::from(self.waits);
        self.steps_behind += u64::from(solved.status == Status::Behind);
        self.most_lag_m = self.most_lag_m.max(solved.lag_m);
        self.steps_outrun += u64::from(solved.outrun);
        self.steps_missed += u64::from(solved.missed);
        self.inside_steps += u64::from(solved.status == Status::Inside);
        self.withheld_before = self.withheld_last.take();
        if solved.contact.is_none() {
            self.withhold(solved.status.name());
        }
    }

    /// Takes note of the newest step's frames, and returns them unless the console would refuse them.
    pub fn sendable(&mut self, solved: &Solved, frames: Option<Felt>) -> Option<Felt> {
        let frames = frames?;
        let Err(reject) = frames.check() else {
            return Some(frames);
        };
        // The console ages out what it has.
        let is_news = self
            .withheld_before
            .is_none_or(|(why, _)| why != UNSENDABLE);
        if is_news {
            tracing::warn!("a step is withheld: the console would refuse it: {reject}");
        }
        self.spoilt_steps += u64::from(solved.touched && !solved.unfinished);
        self.withhold(UNSENDABLE);
        None
    }

    /// Counts the newest step as withheld.
    fn withhold(&mut self, why: &'static str) {
        *self.withheld.entry(why).or_default() += 1;
        let before = self.withheld_before.map_or(0, |(_, steps)| steps);
        self.withheld_last = Some((why, before + 1));
    }

    /// Whether the needle in the grip waits to be outside, as the newest step found.
    pub fn waits(&self) -> bool {
        self.waits
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
    fn console_counts(&self) -> ConsoleCounts {
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

    /// Steps of which a part says something: a quarter of a second of them.
    fn enough_steps(&self) -> f64 {
        LEAST_CONTACT_S * self.host_hz
    }

    /// Why what the solver found was not felt, if it was not.
    fn not_rendered(&self) -> Option<String> {
        // The console's own force says nothing of it: a fixture has one, too.
        if self.forceful_steps > UNDERWAY && self.forceful_used == 0 {
            return Some(format!(
                "{} steps found a force, and the console rendered none{}",
                self.forceful_steps,
                self.beyond_frames()
            ));
        }
        let inside = Status::Inside.name();
        let withheld = self.withheld.iter().filter(|(why, _)| **why != inside);
        let withheld: u64 = withheld.map(|(_, steps)| steps).sum();
        let steps = self.steps_ns.count();
        if withheld as f64 > MOST_SPOILT * steps as f64 && withheld as f64 >= self.enough_steps() {
            return Some(format!(
                "{withheld} of {steps} steps were withheld{}",
                self.beyond_frames()
            ));
        }
        let is_found = self.forceful_steps > UNDERWAY && self.solved_peak_n > FELT_N;
        if is_found && self.peak_n < FAINT_N {
            let words = self.cut_words();
            let words = words.map_or(String::new(), |words| format!(": {words}"));
            return Some(format!(
                "steps found up to {:.3} N, and the largest force on the grip was {:.4} N{words}",
                self.solved_peak_n, self.peak_n
            ));
        }
        let steps = self.contact_steps as f64;
        let share = self.spoilt_steps as f64 / steps.max(1.0);
        (share > MOST_SPOILT && steps >= self.enough_steps()).then(|| {
            format!(
                "{:.0} % of the steps in contact were withheld or not balanced{}",
                1e2 * share,
                self.beyond_frames()
            )
        })
    }

    /// Names the steps whose numbers no frame takes, if there are any.
    fn beyond_frames(&self) -> String {
        match self.withheld.get(UNSENDABLE) {
            Some(steps) => format!(
                ": in {steps} steps force or stiffness was beyond what a frame takes ({MAX_WRENCH:.0e} N, {MAX_TANGENT:.0e} N/m); up to {:.4e} N were found",
                self.solved_peak_n
            ),
            None => String::new(),
        }
    }

    /// Why a force was felt that no step found, if one was.
    fn untouched(&self) -> Option<String> {
        let is_felt = self.peak_n > FELT_N && !self.had_fixture;
        let is_found = self.solved_peak_n > FAINT_N;
        (is_felt && !is_found && self.steps_ns.count() > 0).then(|| match self.contact_steps {
            0 => format!(
                "{:.3} N were felt, and no step found a contact",
                self.peak_n
            ),
            // A contact is no force yet.
            _ => format!(
                "{:.3} N were felt, and steps found {:.4} N at most",
                self.peak_n, self.solved_peak_n
            ),
        })
    }

    /// Why the tissue was not felt where the hand was in it, if tools came too late for that.
    fn never_came(&self) -> Option<String> {
        let (missed, steps) = (self.steps_missed, self.steps_ns.count());
        let is_so = missed > UNDERWAY && missed as f64 > MOST_MISSED_S * self.host_hz;
        is_so.then(|| {
            format!(
                "in {missed} of {steps} steps tools lagged behind the hand, by {:.3} mm at most, and touched nothing where it was in the tissue",
                1e3 * self.most_lag_m
            )
        })
    }

    /// Why most steps say little of where the hand was, if so.
    fn outrun(&self) -> Option<String> {
        let steps = self.contact_steps.max(self.steps_outrun) as f64;
        let share = self.steps_outrun as f64 / steps.max(1.0);
        (share > MOST_SPOILT && steps >= self.enough_steps()).then(|| {
            format!(
                "in {} of {} steps tools lagged behind the hand by more than they touched, by {:.3} mm at most",
                self.steps_outrun,
                self.steps_ns.count(),
                1e3 * self.most_lag_m
            )
        })
    }

    /// Why nobody feels the tissue, if so.
    fn faint(&self) -> Option<String> {
        let largest_n = self.peak_n.max(self.solved_peak_n);
        let touched = self.pressing_steps as f64 >= self.enough_steps();
        (touched && largest_n < FAINT_N).then(|| {
            format!(
                "the tool touched in {} steps, and the largest force was {:.4} mN",
                self.pressing_steps,
                1e3 * largest_n
            )
        })
    }

    /// Names the limits that took a part of the force away.
    fn cuts(&self) -> Cuts {
        Cuts {
            limited: self.limited(),
            withheld: self.ticks_withheld,
            felt_n: self.peak_n,
            solved_n: self.solved_peak_n,
        }
    }

    /// Names the limits that took a part of the force away; none if that was little.
    fn cut_words(&self) -> Option<String> {
        let LimitWatch {
            max_force_n,
            max_power_w,
            ..
        } = self.limits;
        self.cuts().words([max_force_n, max_power_w])
    }

    /// Compares the felt force with the solved one, if it was cut off.
    fn cut_off(&self) -> Option<String> {
        let words = self.cut_words()?;
        let felt_n = self.peak_n;
        // A console's own force is beside what steps find.
        Some(match self.had_fixture {
            true => format!("{words}: {felt_n:.3} N were felt, the fixture's force among them"),
            false => format!(
                "{words}: {felt_n:.3} N were felt of {:.3} N that steps found",
                self.solved_peak_n
            ),
        })
    }

    /// Ticks since the console began to decay, if it does; 0 otherwise.
    fn decayed_for(&self) -> u32 {
        let (last, since) = (self.last.as_ref(), self.decaying_since);
        let passed = last.zip(since);
        passed.map_or(0, |(last, since)| last.tick.wrapping_sub(since))
    }

    /// The session's ending, by the console's mode and faults at its end.
    fn ending(&self, mode: Mode, faults: &[String]) -> Ending {
        let inside = || {
            let steps = self.inside_steps;
            (steps > 0).then(|| format!("a tool was inside the tissue in {steps} steps"))
        };
        let stopped = self.rests.as_ref().map(|(stop, SafeStop { at_s, by })| {
            let what = match stop {
                Stop::Safe => "safe stop",
                Stop::TakeOut => "taken out of the tissue",
            };
            format!("{what} by {by} at {at_s:.2} s")
        });
        use EndingKind::{
            Behind, Faint, Fault, Idle, Inside, Limited, NotRendered, Stopped, Untouched,
        };
        let idle = match mode {
            Mode::Idle => Some("no usable contact for too long"),
            Mode::Boot => Some("the console was reset"),
            Mode::Decaying if self.decayed_for() > u32::from(TICK_HZ) => {
                Some("the console has rendered nothing for longer than it decays")
            }
            _ => None,
        };
        let idle = idle.map(str::to_owned);
        let found = [
            // Faults stay latched until the console is at rest: one that names some is in fault whatever its mode.
            (
                Fault,
                (mode == Mode::Fault || !faults.is_empty()).then(|| said(faults)),
            ),
            (NotRendered, self.not_rendered()),
            (Inside, inside()),
            (Untouched, self.untouched()),
            (Behind, self.outrun().or_else(|| self.never_came())),
            (Faint, self.faint()),
            (Stopped, stopped.filter(|_| mode == Mode::Idle)),
            (Idle, idle),
            (Limited, self.cut_off()),
        ];
        let gravest = found.into_iter().find_map(|(kind, why)| Some((kind, why?)));
        gravest.map_or_else(Ending::default, |(kind, why)| Ending::new(kind, why))
    }

    /// The largest mean of a second \[ns\], the one under way included; a shorter session is one.
    fn worst_second_ns(&self) -> f64 {
        let last_ns = match self.ticks() < u64::from(TICK_HZ) {
            true => self.second.mean_ns(),
            false => self.second.full_mean_ns(),
        };
        self.worst_second_ns.max(last_ns)
    }

    /// Steps of which nothing was sent, by their reason.
    fn withheld(&self, link: &LinkCounters) -> BTreeMap<&'static str, u64> {
        let mut withheld = self.withheld.clone();
        if link.contacts_unsendable > 0 {
            *withheld.entry(UNSENDABLE).or_default() += link.contacts_unsendable;
        }
        withheld
    }

    /// The session in numbers; the caller fills in what only it knows.
    pub fn summary(&self, link: &LinkCounters, tick_hz: u16) -> Summary {
        let us = |times: &Times, share, unit: f64| times.quantile(share) as f64 / unit;
        let delays = self.horizon.delays_us();
        let steps = self.steps_ns.count();
        let seconds = self.ticks() as f64 / f64::from(tick_hz);
        let mode = self.last.map_or(Mode::Boot, |state| state.mode);
        let faults = fault_names(self.last.map_or(0, |state| state.faults));
        let console = self.console_counts();
        let ending = self.ending(mode, &faults);
        let frames = Frames {
            sent: u64::from(link.frames.frames_sent),
            lost: u64::from(link.frames.frames_lost) + console.lost,
            rejected: u64::from(link.frames.frames_rejected) + console.rejected,
            late: self.late,
            superseded: link.states_superseded + link.contacts_superseded + console.superseded,
        };
        Summary {
            status: ending.to_string(),
            ending,
            contact_steps: self.contact_steps,
            rearmed: self.rearmed,
            overload: self.given_up,
            horizon_ms: Age {
                p50: us(self.horizon.given_us(), 0.5, 1e3),
                max: self.horizon.given_us().max() as f64 / 1e3,
            },
            worst_second_us: self.worst_second_ns() / 1e3,
            core_us: (self.cores_ns.count() > 0).then(|| Percentiles {
                p50: us(&self.cores_ns, 0.5, 1e3),
                p99: us(&self.cores_ns, 0.99, 1e3),
            }),
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
            refusals: refusals(link, console.rejected),
            steps_withheld: self.withheld(link),
            withheld_last: self.withheld_last,
            decays: self.decays,
            ticks_withheld: self.ticks_withheld,
            ticks_limited: self.limited(),
            safe_stops: self.safe_stops.clone(),
            needle_waited_steps: self.steps_waited,
            steps_behind: self.steps_behind,
            most_lag_m: self.most_lag_m,
            steps_outrun: self.steps_outrun,
            steps_missed: self.steps_missed,
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
                solved_peak: self.solved_peak_n,
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

/// Says for each end of the link that refused more of its frames than a line that is good makes it.
fn refusals(link: &LinkCounters, by_console: u64) -> Vec<String> {
    let many = |refused: u64, of: u64| {
        refused > FEW_REFUSED && refused as f64 > MOST_REFUSED * of.max(1) as f64
    };
    let mut said = Vec::new();
    let refused = u64::from(link.frames.frames_rejected);
    let came = u64::from(link.frames.frames_received) + refused;
    if many(refused, came) {
        let why = link.refused_most.map_or(String::new(), |(reject, count)| {
            format!(", {count} of them: {reject}")
        });
        said.push(format!(
            "{refused} of {came} frames of the console were refused{why}"
        ));
    }
    let sent = u64::from(link.frames.frames_sent);
    if many(by_console, sent) {
        said.push(format!(
            "the console refused {by_console} of the {sent} frames that it was sent"
        ));
    }
    said
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
    use crate::session::Rendering;
    use crate::step::{Status, ToolContact};
    use sutura_shared::link::Counters;
    use sutura_shared::wire::Reject;

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
        let mut tally = Statistics::new(100.0);
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
    fn ticks_in_which_force_is_withheld_are_counted() {
        let mut tally = Statistics::new(100.0);
        for tick in 0..10 {
            let inputs = inputs::OVERRUN | if tick < 4 { inputs::WITHHELD } else { 0 };
            tally.state(&State {
                inputs,
                ..state(tick, 0.0, 1.0)
            });
        }
        let summary = tally.summary(&LinkCounters::default(), 1000);
        assert_eq!(summary.ticks_withheld, 4);
    }

    /// Latched faults count whatever mode a console says that it is in.
    #[test]
    fn a_console_with_latched_faults_is_in_fault() {
        let ending = |mode, faults| {
            let mut tally = Statistics::new(100.0);
            (0..10).for_each(|tick| tally.state(&state(tick, 0.0, 1.0)));
            tally.state(&State {
                mode,
                faults,
                ..state(10, 0.0, 1.0)
            });
            tally.summary(&LinkCounters::default(), 1000).ending.kind
        };
        for mode in [Mode::Armed, Mode::Decaying, Mode::Idle, Mode::Fault] {
            assert_eq!(ending(mode, 4), EndingKind::Fault, "{mode:?}");
        }
        assert_ne!(ending(Mode::Armed, 0), EndingKind::Fault);
    }

    #[test]
    fn counts_are_those_of_the_session() {
        let report = |lost| Report {
            frames_lost: lost,
            ticks_late: 10 * lost,
            ..Report::default()
        };
        let lost = |reports: &[u32]| {
            let mut tally = Statistics::new(100.0);
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
        let mut tally = Statistics::new(100.0);
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

    fn sent(console_time_us: u64) -> SentContact {
        SentContact {
            sequence: 1,
            console_time_us,
            horizon_us: 40_000,
        }
    }

    /// Ticks of a session up to this one.
    fn go_on(tally: &mut Statistics, until: u32) {
        let from = tally.last().map_or(0, |state| state.tick + 1);
        (from..until).for_each(|tick| tally.state(&state(tick, 0.0, 0.0)));
    }

    #[test]
    fn decay_is_counted_once_a_fall() {
        let mut tally = Statistics::new(100.0);
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
        assert_eq!(tally.summary(&LinkCounters::default(), 1000).decays, 1);
    }

    /// Three quarters of the solves of the middle second are missing because each took 20 ms.
    #[test]
    fn the_worst_second_is_the_one_in_which_solves_were_late() {
        let mut tally = Statistics::new(200.0);
        let solves = |tally: &mut Statistics, second: u32, count: u32, us: u64| {
            for solve in 0..count {
                go_on(tally, 1000 * second + 1 + 999 * solve / count);
                tally.session(Duration::from_micros(us), Duration::ZERO);
            }
        };
        let worst = |tally: &Statistics| {
            tally
                .summary(&LinkCounters::default(), 1000)
                .worst_second_us
        };
        solves(&mut tally, 0, 200, 300);
        solves(&mut tally, 1, 50, 20_000);
        solves(&mut tally, 2, 200, 400);
        assert_eq!(worst(&tally), 20_000.0);
        // The last one counts, too, once half of it was planned.
        solves(&mut tally, 3, 20, 50_000);
        assert_eq!(worst(&tally), 50_000.0);
        solves(&mut tally, 4, 3, 90_000);
        assert_eq!(worst(&tally), 50_000.0);
    }

    #[test]
    fn a_session_of_less_than_a_second_has_a_worst_one() {
        let mut tally = Statistics::new(200.0);
        go_on(&mut tally, 100);
        for _ in 0..20 {
            tally.session(Duration::from_micros(700), Duration::ZERO);
        }
        let summary = tally.summary(&LinkCounters::default(), 1000);
        assert_eq!(summary.worst_second_us, 700.0);
    }

    fn in_contact(force_n: f64) -> Solved {
        let mut contact = ToolContact::default();
        contact.wrench[2] = force_n;
        contact.normal = [0.0, 0.0, 1.0];
        Solved {
            contact: Some(contact),
            status: Status::Ok,
            touched: true,
            ..Solved::default()
        }
    }

    fn status(tally: &Statistics) -> String {
        tally.summary(&LinkCounters::default(), 1000).status
    }

    /// A tool that lags in the air while its hand is in the tissue has missed it, whatever it touches before or after; a fast way in the
    /// air says nothing.
    #[test]
    fn a_tool_that_comes_too_late_is_not_ok() {
        let air = Solved {
            status: Status::Behind,
            lag_m: 3e-3,
            touched: false,
            presses: false,
            ..in_contact(0.0)
        };
        let missed = Solved {
            missed: true,
            ..air
        };
        let ended = |lags: u32, lag: &Solved, others: u32| {
            let mut tally = Statistics::new(200.0);
            tally.state(&state(0, 0.0, 0.0));
            (0..lags).for_each(|_| tally.step(lag, Duration::ZERO));
            (0..others).for_each(|_| tally.step(&in_contact(1.0), Duration::ZERO));
            status(&tally)
        };
        for others in [0, 2] {
            let said = ended(30, &missed, others);
            let words = format!("behind: in 30 of {} steps", 30 + others);
            assert!(
                said.starts_with(&words) && said.contains("3.000 mm"),
                "{said}"
            );
        }
        assert_eq!(ended(15, &missed, 2), "ok");
        assert_eq!(ended(100, &air, 2), "ok");
    }

    /// Each way not to be `ok` has its status word, and a little of each passes.
    #[test]
    fn a_few_steps_of_a_kind_say_nothing_but_inside() {
        let ended = |change: &dyn Fn(&mut Statistics)| {
            let mut tally = Statistics::new(200.0);
            (tally.limits.max_force_n, tally.limits.max_power_w) = (2.0, 3.2);
            tally.state(&state(0, 0.0, 1.0));
            (0..100).for_each(|_| tally.step(&in_contact(1.0), Duration::ZERO));
            let frame = in_contact(1.0).frames(&state(0, 0.0, 0.0), 40_000, Rendering::Hold);
            tally.frame(1, &frame.expect("a contact").contact);
            tally.fate(&sent(1), Fate::Used { age_us: 5_000 });
            change(&mut tally);
            status(&tally)
        };
        let outrun = Solved {
            status: Status::Behind,
            lag_m: 3e-3,
            outrun: true,
            ..in_contact(0.1)
        };
        let inside = Solved {
            status: Status::Inside,
            touched: true,
            ..Solved::default()
        };
        let steps = |tally: &mut Statistics, solved: &Solved, count: u32| {
            (0..count).for_each(|_| tally.step(solved, Duration::ZERO));
        };
        assert_eq!(ended(&|_| {}), "ok");
        assert_eq!(ended(&|tally| steps(tally, &outrun, 20)), "ok");
        let behind = ended(&|tally| steps(tally, &outrun, 60));
        assert!(behind.starts_with("behind: in 60 of 160 steps"), "{behind}");
        assert!(behind.contains("3.000 mm"), "{behind}");
        let inside = ended(&|tally| steps(tally, &inside, 1));
        assert_eq!(inside, "inside: a tool was inside the tissue in 1 steps");
        let cut = |ticks: u32| {
            ended(&|tally| (1..=ticks).for_each(|tick| tally.state(&state(tick, 0.0, 2.0))))
        };
        assert_eq!(cut(10), "ok");
        assert!(
            cut(11).starts_with("limited: the device's largest force, 2 N"),
            "{}",
            cut(11)
        );
        // The console's own counts go before what its states say.
        let own = |force, power| {
            let ticks = TicksLimited {
                force,
                power,
                slew: 999,
                ..TicksLimited::default()
            };
            ended(&|tally| {
                (1..=30).for_each(|tick| tally.state(&state(tick, 0.0, 2.0)));
                tally.counted(ticks);
            })
        };
        assert_eq!(own(10, 10), "ok");
        assert!(own(11, 0).starts_with("limited: the device's largest force, 2 N, cut"));
        assert!(
            own(0, 11)
                .starts_with("limited: the device's largest power, 3.2 W, cut the force off in 11"),
            "{}",
            own(0, 11)
        );
    }

    /// Slew and energy account have a few ticks in most sessions: they count where less than half of the force was felt.
    #[test]
    fn little_of_a_force_is_said_with_what_took_it() {
        let ended = |solved_n: f64, withheld: u32, limited: TicksLimited| {
            let mut tally = Statistics::new(200.0);
            (0..100).for_each(|_| tally.step(&in_contact(solved_n), Duration::ZERO));
            let frame = in_contact(1.0).frames(&state(0, 0.0, 0.0), 40_000, Rendering::Hold);
            tally.frame(1, &frame.expect("a contact").contact);
            tally.fate(&sent(1), Fate::Used { age_us: 5_000 });
            for tick in 0..100 {
                let inputs = if tick < withheld { inputs::WITHHELD } else { 0 };
                tally.state(&State {
                    inputs,
                    ..state(tick, 0.0, 1.0)
                });
            }
            tally.counted(limited);
            status(&tally)
        };
        let none = TicksLimited::default();
        let slew = |slew| TicksLimited { slew, ..none };
        assert_eq!(ended(2.1, 10, slew(10)), "ok");
        assert_eq!(ended(2.0, 99, slew(99)), "ok");
        let felt = "1.000 N were felt of 2.100 N that steps found";
        assert_eq!(
            ended(2.1, 0, slew(11)),
            format!("limited: the largest slew of a joint cut the force off in 11 ticks: {felt}")
        );
        assert_eq!(
            ended(2.1, 11, none),
            format!("limited: force that no motion had paid for was withheld in 11 ticks: {felt}")
        );
        let motors = TicksLimited {
            force: 30,
            current: 30,
            ..none
        };
        assert_eq!(
            ended(2.1, 0, motors),
            format!(
                "limited: the largest current of a motor cut the force off in 30 ticks: {felt}"
            )
        );
    }

    /// More than a hundredth of an end's frames, and not those few that a session begins with.
    #[test]
    fn an_end_that_refuses_many_frames_is_named_with_the_reason() {
        let counters = |received, rejected| LinkCounters {
            frames: Counters {
                frames_sent: 1000,
                frames_received: received,
                frames_rejected: rejected,
                ..Counters::default()
            },
            refused_most: Some((Reject::NotFinite, 290)),
            ..LinkCounters::default()
        };
        assert!(refusals(&counters(2970, 30), 10).is_empty());
        assert!(refusals(&counters(0, 10), 10).is_empty());
        assert_eq!(
            refusals(&counters(2700, 300), 11),
            [
                "300 of 3000 frames of the console were refused, 290 of them: a number is not finite",
                "the console refused 11 of the 1000 frames that it was sent"
            ]
        );
    }

    /// A console that let go by itself is not excused by somebody who stops it then.
    #[test]
    fn a_stop_counts_for_a_console_that_runs() {
        let asks =
            |tally: &mut Statistics, stop, page: u8| tally.stop(stop, format!("page {page}"));
        let rests = State {
            mode: Mode::Idle,
            ..state(2, 0.0, 0.0)
        };
        let mut tally = Statistics::new(200.0);
        tally.state(&state(1, 0.0, 0.0));
        asks(&mut tally, Stop::Safe, 1);
        assert_eq!(tally.stopped_by(), Some((Stop::Safe, "page 1")));
        asks(&mut tally, Stop::Safe, 2);
        tally.state(&rests);
        asks(&mut tally, Stop::TakeOut, 3);
        assert!(status(&tally).starts_with("stopped: safe stop by page 1"));
        tally.order(&Order::Command(Command::Arm));
        assert_eq!(tally.stopped_by(), None);
        let mut tally = Statistics::new(200.0);
        tally.state(&rests);
        asks(&mut tally, Stop::Safe, 1);
        assert!(status(&tally).starts_with("idle: "));
        assert_eq!(
            tally
                .summary(&LinkCounters::default(), 1000)
                .safe_stops
                .len(),
            1
        );
    }

    /// A stop after an order to arm counts before a state shows the console armed; not where the link was lost meanwhile.
    #[test]
    fn a_stop_counts_for_a_console_that_is_told_to_arm() {
        let rests = |tick| State {
            mode: Mode::Idle,
            ..state(tick, 0.0, 0.0)
        };
        let stopped = |prepare: fn(&mut Statistics)| {
            let mut tally = Statistics::new(200.0);
            tally.state(&rests(1));
            prepare(&mut tally);
            tally.stop(Stop::Safe, "page 1".to_owned());
            tally.stopped_by().is_some()
        };
        let [arm, disarm] = [Command::Arm, Command::Disarm].map(Order::Command);
        assert!(stopped(|tally| tally.order(&Order::Command(Command::Arm))));
        assert!(stopped(Statistics::rearm));
        assert!(!stopped(|tally| {
            tally.rearm();
            tally.lose();
        }));
        let mut tally = Statistics::new(200.0);
        tally.state(&rests(1));
        for order in [&arm, &disarm] {
            tally.order(order);
        }
        tally.stop(Stop::Safe, "page 1".to_owned());
        assert_eq!(tally.stopped_by(), None);
        // Once armed it may let go by itself.
        tally.order(&arm);
        tally.state(&state(2, 0.0, 0.0));
        tally.state(&rests(3));
        tally.stop(Stop::Safe, "page 1".to_owned());
        assert!(status(&tally).starts_with("idle: "));
    }

    /// A console that is reset, or that never ends to let go, renders nothing any more.
    #[test]
    fn a_console_that_renders_no_more_is_not_ok() {
        let ended = |mode: Mode, ticks: u32| {
            let mut tally = Statistics::new(200.0);
            tally.state(&state(1, 0.0, 1.0));
            for tick in 2..2 + ticks {
                let base = state(tick, 0.0, 0.0);
                tally.state(&State { mode, ..base });
            }
            status(&tally)
        };
        assert!(ended(Mode::Boot, 10).starts_with("idle: the console was reset"));
        assert_eq!(ended(Mode::Decaying, 500), "ok");
        assert!(ended(Mode::Decaying, 1500).starts_with("idle: "));
        assert_eq!(ended(Mode::Armed, 1500), "ok");
    }

    /// A tool that is taken out rests by no safe stop, until somebody asks for one.
    #[test]
    fn to_be_taken_out_is_no_safe_stop() {
        let mut tally = Statistics::new(200.0);
        tally.state(&state(1, 0.0, 0.0));
        tally.stop(Stop::TakeOut, "page 1".to_owned());
        tally.state(&State {
            mode: Mode::Idle,
            ..state(2, 0.0, 0.0)
        });
        assert!(status(&tally).starts_with("stopped: taken out of the tissue by page 1"));
        let stops = |tally: &Statistics| tally.summary(&LinkCounters::default(), 1000).safe_stops;
        assert!(stops(&tally).is_empty());
        tally.stop(Stop::Safe, "page 2".to_owned());
        assert!(status(&tally).starts_with("stopped: safe stop by page 2"));
        assert_eq!(stops(&tally).len(), 1);
    }

    /// A wall of the console's own is felt all the time.
    #[test]
    fn a_fixtures_force_is_not_that_of_the_scene() {
        let mut tally = Statistics::new(200.0);
        let frame = |force_n: f64| {
            let solved = in_contact(force_n);
            let state = state(0, 0.0, 0.0);
            solved
                .frames(&state, 40_000, Rendering::Hold)
                .expect("a contact")
                .contact
        };
        tally.state(&state(0, 0.0, 3.0));
        for us in 1..=50 {
            tally.step(&in_contact(1.0), Duration::ZERO);
            tally.frame(us, &frame(1.0));
            tally.fate(&sent(us), Fate::TooLate { age_us: 90_000 });
        }
        assert!(status(&tally).starts_with(EndingKind::NotRendered.word()));
        // One without a force, in time, is none that was felt.
        tally.frame(51, &frame(0.0));
        tally.fate(&sent(51), Fate::Used { age_us: 5_000 });
        assert!(status(&tally).starts_with(EndingKind::NotRendered.word()));
        tally.frame(52, &frame(1.0));
        tally.fate(&sent(52), Fate::Used { age_us: 5_000 });
        assert_eq!(status(&tally), "ok");
    }

    #[test]
    fn a_share_of_a_few_steps_says_nothing() {
        let mut tally = Statistics::new(200.0);
        tally.state(&state(0, 0.0, 0.0));
        let waiting = Solved {
            touched: true,
            status: Status::Waiting,
            ..Solved::default()
        };
        let one_of_three = |tally: &mut Statistics| {
            tally.step(&waiting, Duration::ZERO);
            tally.step(&in_contact(0.0), Duration::ZERO);
            tally.step(&in_contact(0.0), Duration::ZERO);
        };
        (0..16).for_each(|_| one_of_three(&mut tally));
        assert_eq!(status(&tally), "ok");
        one_of_three(&mut tally);
        assert!(status(&tally).starts_with("not-rendered: 33 %"));
    }

    #[test]
    fn why_the_newest_steps_were_withheld_is_known() {
        let mut tally = Statistics::new(200.0);
        let last = |tally: &Statistics| tally.summary(&LinkCounters::default(), 1000).withheld_last;
        let withheld = Solved {
            status: Status::Inside,
            ..Solved::default()
        };
        tally.step(&withheld, Duration::ZERO);
        tally.step(&withheld, Duration::ZERO);
        assert_eq!(last(&tally), Some(("inside", 2)));
        tally.step(&in_contact(1.0), Duration::ZERO);
        assert_eq!(last(&tally), None);
    }

    /// Force and stiffness beyond a frame's range are withheld, and named as the cause of the session's ending.
    #[test]
    fn steps_beyond_what_a_frame_takes_are_the_cause_that_is_named() {
        let idle = State {
            mode: Mode::Idle,
            ..state(100, 0.0, 0.0)
        };
        let stiff = Solved {
            contact: Some(ToolContact {
                tangent: [[1e9; 6]; 6],
                ..in_contact(20.0).contact.expect("a contact")
            }),
            ..in_contact(20.0)
        };
        for beyond in [in_contact(2e4), stiff] {
            let mut tally = Statistics::new(200.0);
            let step = |tally: &mut Statistics, solved: &Solved| {
                tally.step(solved, Duration::ZERO);
                let frames = solved.frames(&state(0, 0.0, 0.0), 40_000, Rendering::Tangent);
                let frames = tally.sendable(solved, frames);
                if let Some(frames) = &frames {
                    tally.frame(1, &frames.contact);
                    tally.fate(&sent(1), Fate::Used { age_us: 5_000 });
                }
                frames.is_some()
            };
            tally.state(&state(1, 0.0, 2.0));
            (0..20).for_each(|_| assert!(step(&mut tally, &in_contact(1.0))));
            (0..60).for_each(|_| assert!(!step(&mut tally, &beyond)));
            tally.state(&idle);
            let summary = tally.summary(&LinkCounters::default(), 1000);
            assert_eq!(summary.withheld_last, Some((UNSENDABLE, 60)));
            assert_eq!(summary.steps_withheld, BTreeMap::from([(UNSENDABLE, 60)]));
            assert_eq!(summary.mostly_withheld(), Some(UNSENDABLE));
            let said = &summary.status;
            assert!(
                said.starts_with("not-rendered: 60 of 80") && said.contains("(1e4 N, 1e7 N/m)"),
                "{said}"
            );
        }
    }

    #[test]
    fn steps_that_are_not_sent_are_counted_by_their_reason() {
        let mut tally = Statistics::new(100.0);
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
        let link = LinkCounters {
            contacts_unsendable: 2,
            ..LinkCounters::default()
        };
        let both = BTreeMap::from([("unsendable", 2), ("waiting", 1)]);
        assert_eq!(tally.summary(&link, 1000).steps_withheld, both);
        assert_eq!(summary.step_us.max, 900.0);
    }
}
