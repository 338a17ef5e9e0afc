//! A session with a console that runs by itself: the solver has its own thread and its own pace.
//!
//! Entry point: [`run_real_time`]. The solver takes the newest state, steps, and puts the contact out, host_hz
//! times a second; a step whose result is not good sends nothing, and the console lets the force decay.

use super::setup::{Arming, ArmingWatch};
use super::{Plan, Progress, SessionError, Solve, Summary, Tally};
use crate::link::{Link, LinkCounters, LinkOptions, Order, Port};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use sutura_shared::link::HostEvent;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Command, Mode, State};

/// Time between two progress notes, and between two looks at how far the session is.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Shortest of these times: a few ticks.
const TICKS_SOME: Duration = Duration::from_millis(2);
/// A console from which nothing came for so long is dead, or its line is.
const SILENT: Duration = Duration::from_secs(2);
/// How long the console may take to report after it was disarmed; it reports once a second by itself.
const REPORT_WITHIN: Duration = Duration::from_millis(1500);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the link's listener writes down and everybody else reads.
struct Log {
    tally: Tally,
    /// Whether the console has been armed in this session; what was before is not counted.
    armed: bool,
    /// Whether the console has gone to rest, by itself or as it was told; what comes then is not counted.
    over: bool,
    /// The newest state, counted or not.
    newest: Option<(State, Instant)>,
    reports: u64,
    /// Ticks that the session is to last.
    ticks: u64,
}

/// Runs a session of `plan.seconds` of console time on the console behind `port`; `progress` may end it early.
///
/// # Errors
/// See [`SessionError`]. The console is disarmed first, as far as it still listens.
pub fn run_real_time(
    port: Box<dyn Port>,
    options: LinkOptions,
    plan: &Plan,
    solver: &mut dyn Solve,
    mut progress: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> Result<Summary, SessionError> {
    let started = Instant::now();
    let log = Arc::new(Mutex::new(Log {
        tally: Tally::new(plan.host_hz),
        armed: false,
        over: false,
        newest: None,
        reports: 0,
        ticks: plan.ticks(),
    }));
    let written = log.clone();
    let link = Link::open(port, options, move |event| lock(&written).hear(event))?;
    for order in plan.opening_orders(link.console()) {
        link.order(order)?;
    }
    let stop = AtomicBool::new(false);
    let ended = std::thread::scope(|scope| {
        // However this ends, by a panic too: the scope waits for the solver.
        let stopping = Stopping(&stop);
        let solving = std::thread::Builder::new()
            .name("sutura-solve".to_owned())
            .spawn_scoped(scope, || solve_until(&stop, &link, plan, &log, solver));
        let ended = match &solving {
            Ok(solving) => watch(&link, plan, &log, &mut progress, || solving.is_finished()),
            Err(_) => Err(SessionError::Solver),
        };
        drop(stopping);
        match solving.map(std::thread::ScopedJoinHandle::join) {
            Ok(Ok(())) => ended,
            _ => Err(SessionError::Solver),
        }
    });
    ended?;
    let wall_s = started.elapsed().as_secs_f64();
    let device = plan.device_name(link.console());
    let console = link.name().to_owned();
    // What nobody takes while the console goes to rest was not superseded by anything.
    let LinkCounters {
        states_superseded, ..
    } = link.counters();
    lock(&log).over = true;
    disarm(&link, &log);
    let counters = LinkCounters {
        states_superseded,
        ..link.close()
    };
    let summary = lock(&log).tally.summary(&counters, plan.tick_hz);
    Ok(Summary {
        console,
        device,
        wall_s,
        rendering: plan.rendering.word(),
        most_rows: plan.most_rows(),
        scene: solver.scene(),
        ..summary
    })
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
                let state = state.body();
                self.newest = Some((*state, Instant::now()));
                self.armed |= matches!(state.mode, Mode::Armed | Mode::Decaying);
                if self.armed && !self.over && self.tally.ticks() < self.ticks {
                    self.tally.state(state);
                    // Data stayed away for so long that it disarmed itself; only a person arms it again.
                    self.over = state.mode == Mode::Idle;
                }
            }
            HostEvent::Report(report) => {
                self.tally.report(report.body());
                self.reports += 1;
            }
            HostEvent::Opened(_) | HostEvent::Refused(_) => {}
        }
    }
}

/// The solver's thread: newest state, step, contact, at the host's pace.
fn solve_until(
    stop: &AtomicBool,
    link: &Link,
    plan: &Plan,
    log: &Mutex<Log>,
    solver: &mut dyn Solve,
) {
    let period = Duration::from_secs_f64(1.0 / plan.host_hz);
    let mut next = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        let state: Valid<State> = match link.state(Instant::now() + LOOK_EVERY) {
            Ok(Some(state)) => state,
            Ok(None) => continue,
            // The watching thread sees the same and says so.
            Err(_) => return,
        };
        if !matches!(state.body().mode, Mode::Armed | Mode::Decaying) {
            // Nobody feels anything: the pose may be anywhere, even inside the tissue.
            continue;
        }
        let before = Instant::now();
        let solved = solver.solve(&state);
        let time = before.elapsed();
        let horizon_us = {
            let mut log = lock(log);
            if log.armed {
                log.tally.step(&solved, time);
            }
            plan.horizon_us(&log.tally.horizon)
        };
        if let Some(felt) = solved.frames(state.body(), horizon_us, plan.rendering) {
            link.felt(state.console_time_us(), felt);
        }
        next += period;
        let now = Instant::now();
        if next > now {
            std::thread::sleep(next - now);
        } else {
            // Too slow for the pace: steps are left out, not made up for.
            next = now;
        }
    }
}

/// Until the session is over: arms the console, looks after it, and tells how far it is.
fn watch(
    link: &Link,
    plan: &Plan,
    log: &Mutex<Log>,
    progress: &mut impl FnMut(&Progress<'_>) -> ControlFlow<()>,
    solver_ended: impl Fn() -> bool,
) -> Result<(), SessionError> {
    let opened = Instant::now();
    let mut arming = Some(ArmingWatch::new(plan));
    let mut elapsed_s = 0.0;
    loop {
        let left = Duration::try_from_secs_f64(plan.seconds - elapsed_s).unwrap_or_default();
        std::thread::sleep(left.clamp(TICKS_SOME, LOOK_EVERY));
        link.check()?;
        if solver_ended() {
            // It ends before it is told to only if the link broke, or by a panic.
            return link
                .check()
                .map_err(SessionError::from)
                .and(Err(SessionError::Solver));
        }
        let (newest, ticks, report, over) = {
            let log = lock(log);
            (
                log.newest,
                log.tally.ticks(),
                log.tally.last_report().copied(),
                log.over,
            )
        };
        let heard = newest.map_or(opened, |(_, heard)| heard);
        if heard.elapsed() > SILENT {
            return Err(SessionError::Silent {
                waited_s: SILENT.as_secs_f64(),
            });
        }
        let Some((state, _)) = newest else { continue };
        if let Some(watch) = &mut arming {
            match watch.judge(&state)? {
                Arming::Armed => arming = None,
                Arming::Again => link.order(Order::Command(Command::Arm))?,
                Arming::NotYet => {}
            }
        }
        elapsed_s = ticks as f64 / f64::from(plan.tick_hz);
        let note = Progress {
            elapsed_s,
            seconds: plan.seconds,
            state: &state,
            report: report.as_ref(),
        };
        // At rest, or in a latched fault, nothing more is to be felt.
        let over = over || ticks >= plan.ticks() || (arming.is_none() && state.mode == Mode::Fault);
        if progress(&note).is_break() || over {
            return Ok(());
        }
    }
}

/// Sends the console to rest and waits for its counters.
fn disarm(link: &Link, log: &Mutex<Log>) {
    if link.order(Order::Command(Command::Disarm)).is_err() {
        return;
    }
    let before = lock(log).reports;
    let deadline = Instant::now() + REPORT_WITHIN;
    while lock(log).reports == before && link.check().is_ok() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(5));
    }
}
