//! A session with a console that runs by itself: the solver has its own thread and its own pace.
//!
//! Entry point: [`run_real_time`]. The solver takes the newest state, steps, and puts the contact out, host_hz
//! times a second; a step whose result is not good sends nothing, and the console lets the force decay. A console that
//! goes away may come back into the same session, at rest until somebody arms it again; so may one that has let go.

use super::heard::Underway;
use super::overload::Overload;
use super::schedule::Schedule;
use super::setup::{Arming, ArmingWatch};
use super::summary::{ConsoleClock, LinkSummary, RoundTrip, Throughput};
use super::{
    ConsoleLimits, Ending, EndingKind, LatenessProbe, LimitedTicks, Plan, Progress, Scheduling,
    SessionError, Solve, Statistics, Stop, Summary,
};
use crate::link::{
    Advance, Connector, Heard, Link, LinkCounters, LinkError, LinkOptions, Order, Port, RoundTrips,
    SentContact, Silence, Standing,
};
use crate::scheduling::{Duty, Granted, LockedMemory, Role};
use crate::tool::Act;
use crate::work;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use sutura_shared::link::HostEvent;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Command, Mode, Report, State};

/// Time between two progress notes, and between two looks at how far the session is.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// So long before its state should come a solver brings what it will read into the caches: that takes up to a third of a millisecond,
/// and what is there earlier may be gone again.
const WARM_BEFORE: Duration = Duration::from_micros(400);
/// Shortest of these times: a few ticks.
const TICKS_SOME: Duration = Duration::from_millis(2);
/// A console from which nothing came for so long is dead, or its line is; longer if the link waits longer.
const SILENT: Duration = Duration::from_secs(2);
/// By how much a console's clock may differ from the host's over a loss of the link \[s\], and for every second of it: if
/// it differs by more, the console has started anew.
const SAME_CLOCK_S: f64 = 0.25;
/// See [`SAME_CLOCK_S`].
const SAME_CLOCK: f64 = 0.02;
/// So often in [`REARMS_IN`] is a console that let go armed again by itself.
const REARMS: usize = 3;
/// See [`REARMS`].
const REARMS_IN: Duration = Duration::from_secs(60);
/// How long the console may take to report after it was disarmed; it reports once a second by itself.
const REPORT_WITHIN: Duration = Duration::from_millis(1500);
/// What is said of the present is said of so long: of ten pings.
const NOW: Duration = Duration::from_secs(1);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Who looks after a console that goes away. Force returns only when it is armed again.
pub trait Attendant {
    /// The console went away.
    fn lost(&mut self, why: &LinkError);

    /// It is back, at rest.
    fn back(&mut self);

    /// It has let go by itself, since no contact that it could use came for too long. It is not armed by itself within
    /// `wait`.
    fn let_go(&mut self, _wait: Duration) {}

    /// It rests, since `person` asked for that.
    fn stopped(&mut self, _stop: Stop, _person: &str) {}

    /// Requests for rest since the last call, with the names of the persons.
    fn stops(&mut self) -> Vec<(Stop, String)> {
        Vec::new()
    }

    /// Whether to arm it now. Asked again and again while it rests.
    fn arms(&mut self) -> Arms;

    /// Waits for so long, or until somebody has an order for the console: it goes out at once.
    fn wait(&mut self, most: Duration) -> Option<Order> {
        std::thread::sleep(most);
        None
    }

    /// What hands do with tools before the next solve; asked whenever a wait is over.
    fn acts(&mut self) -> Vec<Act> {
        Vec::new()
    }

    /// Whether a session goes on in a latched fault, since somebody may clear it.
    fn stays(&self) -> bool {
        false
    }
}

/// Whether an [`Attendant`] arms the console.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arms {
    /// Not now.
    No,
    /// By itself; one that let go no more than three times a minute.
    ByItself,
    /// Somebody has asked for it.
    ByHand,
}

/// What leads to a console.
pub enum Line {
    /// A port. When the console goes away the session ends.
    Once {
        /// Open.
        port: Box<dyn Port>,
        /// Looks after a console that lets go; without, it rests until the end.
        attendant: Option<Box<dyn Attendant>>,
        /// Asks a console in this process what its limits took away.
        limits: Option<ConsoleLimits>,
    },
    /// A port that can be opened again.
    Again {
        /// Opens it.
        connect: Connector,
        /// Looks after the console.
        attendant: Box<dyn Attendant>,
    },
}

impl From<Box<dyn Port>> for Line {
    fn from(port: Box<dyn Port>) -> Self {
        Line::Once {
            port,
            attendant: None,
            limits: None,
        }
    }
}

/// What the link's listener writes down and everybody else reads.
struct Log {
    tally: Statistics,
    /// Whether states count: from the first armed one on, or from a stop on that came before it.
    counts: bool,
    /// Whether the console has gone to rest as it was told; what comes then is not counted.
    over: bool,
    /// What became of the contacts that were sent.
    underway: Underway,
    /// The newest state of the open link's session, counted or not.
    newest: Option<(State, Instant)>,
    reports: u64,
    /// Ticks that the session is to last.
    ticks: u64,
    /// What the solver's thread got of the system, and how often it gave way.
    solver: (Granted, u64),
    /// What hands do with tools before the next solve.
    acts: Vec<Act>,
}

/// What the watching thread needs of the log. It is an ordinary one, and whoever waited for it would wait for all other
/// programs: the others write here only while it does not read.
#[derive(Default)]
struct View {
    newest: Option<(State, Instant)>,
    ticks: u64,
    report: Option<Report>,
    needle_waits: bool,
    limited: LimitedTicks,
    /// Why the link was lost, until the console is told what it needs to know again.
    lost: Option<LinkError>,
}

/// Runs a session of `plan.seconds` of console time on the console that `line` leads to; `progress` may end it early.
///
/// # Errors
/// See [`SessionError`]. The console is disarmed first, as far as it still listens.
pub fn run_real_time(
    line: impl Into<Line>,
    options: LinkOptions,
    plan: &Plan,
    solver: &mut dyn Solve,
    mut progress: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> Result<Summary, SessionError> {
    let started = Instant::now();
    let silent = SILENT.max(options.silent_after);
    let log = Arc::new(Mutex::new(Log {
        tally: Statistics::of(plan),
        underway: Underway::default(),
        counts: false,
        over: false,
        newest: None,
        reports: 0,
        ticks: plan.ticks(),
        solver: (Granted::NotAsked, 0),
        acts: Vec::new(),
    }));
    let memory = options.real_time.then(LockedMemory::ask).flatten();
    let view = Arc::new(Mutex::new(View::default()));
    let (written, shown) = (log.clone(), view.clone());
    let hear = move |heard: Heard<'_>| match heard {
        Heard::Event(event) => {
            let mut log = lock(&written);
            log.hear(event);
            log.show(&shown);
        }
        Heard::Lost(why) => {
            lock(&written).lose();
            // A loss must not be missed; there is nobody now who would wait.
            let mut view = lock(&shown);
            (view.newest, view.lost) = (None, Some(why.clone()));
        }
        Heard::Sent(contact) => lock(&written).sent(contact),
        Heard::Reopened(_) => {}
    };
    let (link, attendant, limits, returns) = match line.into() {
        Line::Once {
            port,
            attendant,
            limits,
        } => {
            let link = Link::open_heard(port, options, hear)?;
            (link, attendant, limits, false)
        }
        Line::Again { connect, attendant } => {
            let link = Link::open_with(connect, options, hear)?;
            (link, Some(attendant), None, true)
        }
    };
    for order in plan.opening_orders(&link.console())? {
        lock(&log).tally.order(&order);
        link.order(order)?;
    }
    let probe = LatenessProbe::start(options.real_time);
    let duty = options.real_time.then_some(Role::Solver);
    let stop = Arc::new(AtomicBool::new(false));
    let ended = std::thread::scope(|scope| {
        // However this ends, by a panic too: the scope waits for the solver.
        let stopping = Stopping(&stop);
        let solving = std::thread::Builder::new()
            .name("sutura-solve".to_owned())
            .spawn_scoped(scope, || {
                // In the midst of a step, too.
                work::stop_with(Some(stop.clone()));
                solve_until(&stop, &link, plan, &log, solver, duty)
            });
        let ended = match &solving {
            Ok(solving) => {
                let watch = Watch {
                    link: &link,
                    plan,
                    log: &log,
                    view: &view,
                    attendant,
                    limits: limits.as_ref(),
                    returns,
                    arming: Some(ArmingWatch::new(plan)),
                    rest: None,
                    has_let_go: false,
                    rearms: Rearms::default(),
                    end: None,
                    silent,
                };
                watch.run(&mut progress, || solving.is_finished())
            }
            Err(_) => Err(SessionError::Solver),
        };
        drop(stopping);
        match solving.map(std::thread::ScopedJoinHandle::join) {
            Ok(Ok(())) => ended,
            _ => Err(SessionError::Solver),
        }
    });
    let lateness = probe.ok().map(LatenessProbe::end);
    let ended = ended?;
    let wall_s = started.elapsed().as_secs_f64();
    let device = plan.device_name(&link.console());
    let console = link.name().to_owned();
    // What nobody takes while the console goes to rest was not superseded by anything.
    let LinkCounters {
        states_superseded, ..
    } = link.counters();
    {
        let mut log = lock(&log);
        log.over = true;
        if let Some(limits) = limits {
            log.tally.counted(limits());
        }
    }
    let link_summary = link_summary(&link);
    let (solving, gave_way) = lock(&log).solver;
    let scheduling = Scheduling::new(solving, gave_way, link.granted(), memory.is_some());
    disarm(&link, &log);
    let counters = LinkCounters {
        states_superseded,
        ..link.close()
    };
    let mut summary = lock(&log).tally.summary(&counters, plan.tick_hz);
    if ended == Ended::AtRest {
        summary.mode = "idle".to_owned();
        let why = "the link was lost, and nobody armed the console again";
        summary.ending = Ending::new(EndingKind::Idle, why);
        summary.status = summary.ending.to_string();
    }
    let summary = Summary {
        console,
        device,
        wall_s,
        rendering: plan.rendering.word(),
        most_rows: plan.most_rows(),
        link: link_summary,
        scheduling: Some(scheduling),
        machine_late_us: lateness.as_ref().map(|lateness| lateness.late_us()),
        machine_late_over_5ms: lateness.as_ref().map(|lateness| lateness.over_5ms()),
        ..summary
    };
    Ok(summary.with_scene(solver.scene()))
}

/// The link so far.
fn link_summary(link: &Link) -> LinkSummary {
    let counters = link.counters();
    let seconds = 1e-6 * link.host_us().max(1) as f64;
    let trips = |trips: RoundTrips| RoundTrip {
        min: trips.min,
        p50: trips.p50,
        p99: trips.p99,
        max: trips.max,
    };
    LinkSummary {
        rtt_us: trips(link.round_trips()),
        rtt_now_us: trips(link.round_trips_within(NOW)),
        clock: link.clock().map(|clock| ConsoleClock {
            offset_us: clock.offset_us,
            drift_ppm: clock.drift_ppm,
            uncertainty_us: clock.uncertainty_us,
        }),
        bytes_per_s: Throughput {
            down: counters.bytes_down as f64 / seconds,
            up: counters.bytes_up as f64 / seconds,
        },
        sessions: counters.sessions,
    }
}

/// Tells the solver's thread to end when dropped.
struct Stopping<'a>(&'a AtomicBool);

impl Drop for Stopping<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Log {
    fn hear(&mut self, event: &HostEvent) {
        match event {
            HostEvent::State(state) => {
                let console_time_us = state.console_time_us();
                let state = state.body();
                self.newest = Some((*state, Instant::now()));
                self.counts |= matches!(state.mode, Mode::Armed | Mode::Decaying);
                if self.counts && !self.over && self.tally.ticks() < self.ticks {
                    self.tally.state(state);
                    let tally = &mut self.tally;
                    self.underway
                        .state(console_time_us, state, |contact, fate| {
                            tally.fate(contact, fate)
                        });
                }
            }
            HostEvent::Report(report) => {
                self.tally.report(report.body());
                self.reports += 1;
            }
            HostEvent::Opened(_)
            | HostEvent::Refused(_)
            | HostEvent::Owned
            | HostEvent::Pong(_) => {}
        }
    }

    fn sent(&mut self, contact: SentContact) {
        let tally = &mut self.tally;
        self.underway
            .sent(contact, |contact, fate| tally.fate(contact, fate));
    }

    /// For the watching thread; if it reads just now, the next state comes in time.
    fn show(&self, view: &Mutex<View>) {
        if let Ok(mut view) = view.try_lock() {
            view.newest = self.newest;
            view.ticks = self.tally.ticks();
            view.report = self.tally.last_report().copied();
            view.needle_waits = self.tally.waits();
            view.limited = self.tally.limited();
        }
    }

    fn lose(&mut self) {
        self.tally.lose();
        self.underway.lose(|_, _| {});
        self.counts = false;
        self.newest = None;
    }
}

/// The solver's thread: newest state, step, contact, at the host's pace.
fn solve_until(
    stop: &AtomicBool,
    link: &Link,
    plan: &Plan,
    log: &Mutex<Log>,
    solver: &mut dyn Solve,
    asks: Option<Role>,
) {
    let mut duty = asks.map(Duty::begin);
    let mut next: Option<Due> = None;
    // Whether the solve before read much memory.
    let mut warms = false;
    let tick = Duration::from_secs(1) / u32::from(plan.tick_hz.max(1));
    let period = Duration::from_secs_f64(1.0 / plan.host_hz);
    let mut schedule: Option<Schedule> = None;
    let mut overload = Overload::new(plan.host_hz);
    // Whether the solve before took longer than it had.
    let mut was_late = false;
    while !stop.load(Ordering::Relaxed) {
        if let Some(duty) = &mut duty {
            duty.look();
            lock(log).solver = (duty.granted(), duty.gave_way());
        }
        let take = |tick, deadline| link.state_from(tick, deadline);
        let state: Valid<State> = match due_state(next.take(), take, || solver.warm()) {
            Ok(Some(state)) => state,
            Ok(None) => continue,
            // The watching thread sees the same and says so.
            Err(_) => return,
        };
        if !matches!(state.body().mode, Mode::Armed | Mode::Decaying) {
            // Nobody feels anything: the pose may be anywhere, even inside the tissue.
            schedule = None;
            continue;
        }
        let heard = Instant::now();
        let now = state.body().tick;
        let due = match &mut schedule {
            Some(schedule) => schedule.is_due(now),
            None => true,
        };
        let schedule =
            schedule.get_or_insert_with(|| Schedule::new(now, plan.tick_hz, plan.host_hz));
        if due {
            let missed = if was_late { schedule.left_out() } else { 0 };
            let acts = std::mem::take(&mut lock(log).acts);
            for act in acts {
                solver.act(act);
            }
            let spared = solver.spare(overload.effort());
            let solved = solver.solve(&state);
            if work::is_stopped() {
                return;
            }
            let solve_time = heard.elapsed();
            warms = solved.warms;
            let felt = {
                let mut log = lock(log);
                let counts = log.counts;
                let tally = &mut log.tally;
                if counts {
                    tally.step(&solved, solve_time);
                }
                tally.horizon.took(solve_time.as_micros() as u64);
                let horizon_us = tally.horizon.next_us();
                let felt = solved.frames(state.body(), horizon_us, plan.rendering);
                match counts {
                    true => {
                        let felt = tally.sendable(&solved, felt);
                        if let Some(felt) = &felt {
                            tally.frame(state.console_time_us(), &felt.contact);
                        }
                        felt
                    }
                    false => felt,
                }
            };
            if let Some(felt) = felt {
                link.felt(state.console_time_us(), felt);
            }
            let time = heard.elapsed();
            was_late = time > period;
            if let Some(words) = overload.note(time, missed, spared) {
                tracing::warn!("{words}");
            }
            let mut log = lock(log);
            if log.counts {
                log.tally.session(time, time.saturating_sub(solve_time));
                log.tally.give_up(overload.given_up());
            }
        }
        let left = schedule.ticks_left(now);
        next = Some(Due {
            tick: now.wrapping_add(left),
            at: heard + tick * left,
            warms,
        });
    }
}

/// The next solve.
#[derive(Clone, Copy, Debug)]
struct Due {
    /// For the state of that tick.
    tick: u32,
    /// When that should come.
    at: Instant,
    /// Whether the solver warms up just before.
    warms: bool,
}

/// The state that is due, or after a while the newest. Only this state wakes the thread, or the time to warm up: whoever
/// sleeps until just before it may be woken late twice. `take` is [`Link::state_from`].
///
/// # Errors
/// Those of `take`.
fn due_state<E>(
    due: Option<Due>,
    take: impl Fn(Option<u32>, Instant) -> Result<Option<Valid<State>>, E>,
    warm: impl FnOnce(),
) -> Result<Option<Valid<State>>, E> {
    let Some(due) = due else {
        return take(None, Instant::now() + LOOK_EVERY);
    };
    // What was read just now needs no warming.
    let early = due.at.checked_sub(WARM_BEFORE);
    let early = early.filter(|early| due.warms && *early > Instant::now());
    if let Some(early) = early {
        let newest = take(Some(due.tick), early)?;
        let is_due = |state: &Valid<State>| state.body().tick.wrapping_sub(due.tick) as i32 >= 0;
        if newest.as_ref().is_some_and(is_due) {
            return Ok(newest);
        }
        warm();
    }
    take(Some(due.tick), due.at + LOOK_EVERY)
}

/// How a session ended that ran as long as it was to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ended {
    /// As it ran.
    Running,
    /// With a console that came back and was not armed again.
    AtRest,
}

/// Looks after the session: arms the console, tells how far it is, and gets it going again.
struct Watch<'a> {
    link: &'a Link,
    plan: &'a Plan,
    log: &'a Mutex<Log>,
    view: &'a Mutex<View>,
    attendant: Option<Box<dyn Attendant>>,
    limits: Option<&'a ConsoleLimits>,
    /// Whether a console that goes away may come back.
    returns: bool,
    /// While the console should arm.
    arming: Option<ArmingWatch>,
    /// While the console is away, or back and not armed.
    rest: Option<Rest>,
    /// While the console rests because it has let go.
    has_let_go: bool,
    rearms: Rearms,
    /// When a session ends whose link was lost: a console that is away has no ticks to count.
    end: Option<Instant>,
    /// See [`SILENT`].
    silent: Duration,
}

/// When a console that let go was armed by itself, the newest last.
#[derive(Clone, Copy, Debug, Default)]
struct Rearms([Option<Instant>; REARMS]);

impl Rearms {
    /// How long it is not armed by itself again.
    fn wait(&self, now: Instant) -> Duration {
        let oldest = self.0[0].map(|oldest| now.saturating_duration_since(oldest));
        oldest.map_or(Duration::ZERO, |since| REARMS_IN.saturating_sub(since))
    }

    /// It has been.
    fn note(&mut self, now: Instant) {
        self.0.rotate_left(1);
        self.0[REARMS - 1] = Some(now);
    }
}

/// A console that went away.
#[derive(Clone, Debug)]
enum Rest {
    /// It is away, for this reason.
    Away(LinkError),
    /// It is back, and has been told what it needs to know.
    Back,
}

impl Watch<'_> {
    /// Until the session is over.
    fn run(
        mut self,
        progress: &mut impl FnMut(&Progress<'_>) -> ControlFlow<()>,
        solver_ended: impl Fn() -> bool,
    ) -> Result<Ended, SessionError> {
        let mut silence = Silence::from(Instant::now());
        let mut advance = Advance::new(self.plan.tick_hz, self.silent);
        let mut elapsed_s = 0.0;
        let mut last: Option<(State, Instant)> = None;
        loop {
            let left_s = self.plan.seconds - elapsed_s;
            let left = Duration::try_from_secs_f64(left_s).unwrap_or_default();
            let wait = left.clamp(TICKS_SOME, LOOK_EVERY);
            match &mut self.attendant {
                Some(attendant) => {
                    let order = attendant.wait(wait);
                    for (stop, by) in attendant.stops() {
                        lock(self.log).tally.stop(stop, by);
                    }
                    if let Some(order) = order {
                        let mut log = lock(self.log);
                        log.tally.order(&order);
                        // One that is not armed yet is not told to arm again.
                        let disarms = order == Order::Command(Command::Disarm);
                        if disarms && self.arming.take().is_some() {
                            (log.counts, self.has_let_go) = (true, false);
                        }
                        drop(log);
                        self.link.order(order)?;
                    }
                    let acts = attendant.acts();
                    if !acts.is_empty() {
                        lock(self.log).acts.extend(acts);
                    }
                }
                None => std::thread::sleep(wait),
            }
            self.link.check()?;
            if solver_ended() {
                // It ends before it is told to only if the link broke, or by a panic.
                return self
                    .link
                    .check()
                    .map_err(SessionError::from)
                    .and(Err(SessionError::Solver));
            }
            let View {
                newest,
                ticks,
                report,
                needle_waits,
                limited,
                lost,
            } = {
                let mut view = lock(self.view);
                let lost = view.lost.take();
                View { lost, ..*view }
            };
            if let Some(why) = lost {
                self.end.get_or_insert(Instant::now() + left);
                self.arming = None;
                // One that comes back without a state that can be used has not been back.
                let is_away = matches!(self.rest, Some(Rest::Away(_)));
                if let Some(attendant) = self.attendant.as_mut().filter(|_| !is_away) {
                    attendant.lost(&why);
                }
                self.rest = Some(Rest::Away(why));
            }
            let heard = |state: Option<(State, Instant)>| state.map(|(_, heard)| heard);
            let new = newest.filter(|_| heard(newest) != heard(last));
            let goes_on = new.is_some_and(|(state, _)| advance.counts(state.tick));
            let quiet = silence.look(Instant::now(), goes_on);
            if self.rest.is_none() && quiet > self.silent && !self.returns {
                return Err(SessionError::Silent {
                    waited_s: self.silent.as_secs_f64(),
                    heard: self.link.why_no_state(),
                });
            }
            self.look_after(newest, last)?;
            last = newest.or(last);
            elapsed_s = ticks as f64 / f64::from(self.plan.tick_hz);
            let note = Progress {
                elapsed_s,
                seconds: self.plan.seconds,
                state: last.as_ref().map(|(state, _)| state),
                report: report.as_ref(),
                link: Some(link_summary(self.link)),
                needle_waits,
                limited: self
                    .limits
                    .map_or(limited, |limits| LimitedTicks::from(limits())),
            };
            let stopped = progress(&note).is_break();
            let in_time = self.end.is_none_or(|end| Instant::now() < end);
            match (&self.rest, stopped || !in_time) {
                (None, true) if last.is_none() => {
                    let name = self.link.name().to_owned();
                    return Err(LinkError::GivenUp { name }.into());
                }
                (None, true) => return Ok(Ended::Running),
                (Some(Rest::Back), true) => return Ok(Ended::AtRest),
                (Some(Rest::Away(why)), true) => return Err(why.clone().into()),
                (Some(_), false) => continue,
                (None, false) => {}
            }
            let Some((state, _)) = &last else { continue };
            // At rest, or in a latched fault, nothing more is to be felt.
            let stays = self.attendant.as_ref().is_some_and(|other| other.stays());
            let fault = self.arming.is_none() && state.mode == Mode::Fault && !stays;
            if ticks >= self.plan.ticks() || fault {
                return Ok(Ended::Running);
            }
        }
    }

    /// Arms the console, the first time by itself. `before`: the newest state when this was asked last.
    fn look_after(
        &mut self,
        newest: Option<(State, Instant)>,
        before: Option<(State, Instant)>,
    ) -> Result<(), SessionError> {
        let Some((state, heard)) = newest else {
            return Ok(());
        };
        if let Some(watch) = &mut self.arming {
            match watch.judge(&state)? {
                Arming::Armed => self.arming = None,
                Arming::Again => self.link.order(Order::Command(Command::Arm))?,
                Arming::NotYet => {}
            }
        }
        if state.mode != Mode::Idle {
            self.has_let_go = false;
        }
        let Some(attendant) = &mut self.attendant else {
            return Ok(());
        };
        let Some(rest) = &self.rest else {
            let rests = state.mode == Mode::Idle && self.arming.is_none();
            if !rests {
                return Ok(());
            }
            let now = Instant::now();
            let wait = self.rearms.wait(now);
            if !self.has_let_go {
                self.has_let_go = true;
                let log = lock(self.log);
                let stop = log.tally.stopped_by();
                let stop = stop.map(|(stop, by)| (stop, by.to_owned()));
                drop(log);
                match stop {
                    Some((stop, by)) => attendant.stopped(stop, &by),
                    None => attendant.let_go(wait),
                }
            }
            match attendant.arms() {
                Arms::ByHand => {}
                Arms::ByItself if wait.is_zero() => self.rearms.note(now),
                Arms::ByItself | Arms::No => return Ok(()),
            }
            self.link.order(Order::Command(Command::Arm))?;
            self.arming = Some(ArmingWatch::new(self.plan));
            lock(self.log).tally.rearm();
            return Ok(());
        };
        if let Rest::Away(_) = rest
            && matches!(self.link.standing(), Standing::Open(_))
        {
            let anew = before.is_none_or(|(before, then)| {
                let ticks = state.tick.wrapping_sub(before.tick);
                let passed_s = heard.saturating_duration_since(then).as_secs_f64();
                let ticked_s = f64::from(ticks) / f64::from(self.plan.tick_hz);
                (ticked_s - passed_s).abs() > SAME_CLOCK_S + SAME_CLOCK * passed_s
            });
            for order in self.plan.orders_again(&self.link.console(), anew)? {
                self.link.order(order)?;
            }
            attendant.back();
            self.rest = Some(Rest::Back);
        }
        if matches!(self.rest, Some(Rest::Back)) && attendant.arms() != Arms::No {
            let arm = Order::Command(Command::Arm);
            lock(self.log).tally.order(&arm);
            self.link.order(arm)?;
            self.arming = Some(ArmingWatch::new(self.plan));
            self.rest = None;
        }
        Ok(())
    }
}

/// Sends the console to rest and waits for its counters.
fn disarm(link: &Link, log: &Mutex<Log>) {
    if link.standing() == Standing::Lost {
        return;
    }
    if link.order(Order::Command(Command::Disarm)).is_err() {
        return;
    }
    let before = lock(log).reports;
    let deadline = Instant::now() + REPORT_WITHIN;
    while lock(log).reports == before && link.check().is_ok() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(test)]
mod tests {
    use super::super::late_tests::valid;
    use super::*;
    use std::cell::RefCell;
    use std::convert::Infallible;
    use sutura_shared::control::{Control, TickInput};

    fn state(tick: u32) -> Valid<State> {
        let mut control =
            Control::new(sutura_study::fidelity::plant::Mechanics::LIGHT.description())
                .expect("a device");
        let state = State {
            tick,
            ..control.tick(&TickInput::default(), None).state
        };
        valid(tick, 0, state)
    }

    /// A state that is due is taken at once; before one that is not there yet the solver warms up, and what came till then is not it.
    #[test]
    fn solvers_warm_up_while_they_wait() {
        let now = Instant::now();
        // Waits are told, not waited.
        let at = now + Duration::from_secs(100);
        // Of the waits in turn which state ends each.
        let wait_until = |at: Instant, warms: bool, ends: [Option<u32>; 2]| {
            let due = Due { tick: 1, at, warms };
            let log = RefCell::new(Vec::new());
            let take = |tick, deadline| {
                let mut log = log.borrow_mut();
                let end = ends[log.len().min(1)];
                log.push(Some((tick, deadline)));
                Ok::<_, Infallible>(end.map(state))
            };
            let warm = || log.borrow_mut().push(None);
            let Ok(found) = due_state(Some(due), take, warm);
            (found.map(|state| state.body().tick), log.into_inner())
        };
        let wait = |warms, ends| wait_until(at, warms, ends);
        let (early, last) = (
            Some((Some(1), at - WARM_BEFORE)),
            Some((Some(1), at + LOOK_EVERY)),
        );
        assert_eq!(wait(false, [Some(1), None]), (Some(1), vec![last]));
        assert_eq!(wait(true, [Some(1), None]), (Some(1), vec![early]));
        assert_eq!(wait(true, [Some(2), None]), (Some(2), vec![early]));
        let warmed = vec![early, None, last];
        for ends in [
            [Some(0), Some(1)],
            [None, Some(1)],
            [Some(u32::MAX), Some(1)],
        ] {
            assert_eq!(wait(true, ends), (Some(1), warmed.clone()));
        }
        assert_eq!(wait(true, [None, None]), (None, warmed));
        let soon = vec![Some((Some(1), now + LOOK_EVERY))];
        assert_eq!(wait_until(now, true, [Some(1), None]), (Some(1), soon));
    }

    #[test]
    fn a_console_is_armed_by_itself_three_times_a_minute() {
        let begin = Instant::now();
        let at = |s: u64| begin + Duration::from_secs(s);
        let mut rearms = Rearms::default();
        for s in [0, 10, 20] {
            assert_eq!(rearms.wait(at(s)), Duration::ZERO);
            rearms.note(at(s));
        }
        assert_eq!(rearms.wait(at(25)), Duration::from_secs(35));
        assert_eq!(rearms.wait(at(60)), Duration::ZERO);
        rearms.note(at(60));
        assert_eq!(rearms.wait(at(61)), Duration::from_secs(9));
    }
}
