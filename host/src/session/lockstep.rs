//! A session in lockstep: one thread, one control tick per exchange, time from the tick count alone.
//!
//! Entry point: [`run_lockstep`]. A solve takes one host period of virtual time, whatever it takes on this
//! machine: the contact for the state of solve k is delivered when solve k + 1 starts. Two runs give one hash.

use super::schedule::Schedule;
use super::setup::{Arming, ArmingWatch};
use super::{
    LinkSummary, Plan, Progress, SessionError, Solve, Statistics, Stop, Summary, Throughput,
    Tuning, Underway,
};
use crate::core_time::core_time;
use crate::link::{Felt, LinkCounters, LinkError, LockstepConsole, Order, Unusable, append};
use crate::tool::Act;
use crate::work;
use std::ops::ControlFlow;
use std::time::Instant;
use sutura_shared::link::{HostEvent, HostLink, SendError};
use sutura_shared::wire::message::{Command, Hello, Mode, Ping, Report, State};
use sutura_shared::wire::{MAX_FRAME, Valid};

/// Exchanges within which the console must answer a `Hello`.
const ANSWER_WITHIN: u32 = 100;
/// Exchanges after `Disarm`: long enough for a report to come, which is due once a second.
const AFTER: u32 = 1100;
/// Exchanges between two pings, which keep the session this host's.
const PING_EVERY: u32 = 100;
/// Ticks between two progress notes.
const PROGRESS_EVERY: u64 = 100;

/// The host's end of a lockstep console.
struct Line<'a> {
    console: &'a mut dyn LockstepConsole,
    end: HostLink,
    /// Frames for the next exchange.
    down: Vec<u8>,
    up: Vec<u8>,
    newest_us: u64,
    exchanges: u32,
    /// States since the last one that could be used.
    unusable: Unusable,
    /// Down and up.
    bytes: (u64, u64),
}

impl Line<'_> {
    fn order(&mut self, order: &Order) -> Result<(), LinkError> {
        let sent = order.append(&mut self.end, self.newest_us, &mut self.down);
        sent.map_err(|source| self.unsendable(source))
    }

    /// The console's counts of limited ticks, if it can be asked.
    fn count_limits(&self, tally: &mut Statistics) {
        if let Some(limited) = self.console.ticks_limited() {
            tally.counted(limited);
        }
    }

    fn unsendable(&self, source: SendError) -> LinkError {
        LinkError::Unsendable {
            name: self.console.name().to_owned(),
            source,
        }
    }

    /// One tick: what waits goes down, what comes up is told to the tally.
    fn exchange(&mut self, tally: &mut Statistics) -> Result<Heard, LinkError> {
        if self.exchanges.is_multiple_of(PING_EVERY) && self.end.is_open() {
            // The host's clock is the console's here, to the tick.
            let host_us = self.newest_us;
            let sent = append(&mut self.end, host_us, &Ping { host_us }, &mut self.down);
            sent.map_err(|source| self.unsendable(source))?;
        }
        self.exchanges += 1;
        self.up.clear();
        self.console.exchange(&self.down, &mut self.up)?;
        self.bytes.0 += self.down.len() as u64;
        self.bytes.1 += self.up.len() as u64;
        self.down.clear();
        let mut heard = Heard::default();
        self.unusable.bytes(self.up.len());
        for byte in &self.up {
            let event = self.end.receive(*byte);
            self.unusable.look(&self.end.counters());
            match event {
                Some(HostEvent::Opened(console)) => heard.opened = Some(console),
                Some(HostEvent::Refused(mismatch)) => {
                    return Err(LinkError::Mismatch {
                        name: self.console.name().to_owned(),
                        mismatch,
                    });
                }
                Some(HostEvent::State(state)) => {
                    self.newest_us = state.console_time_us();
                    heard.state = Some(state);
                }
                Some(HostEvent::Owned) => {
                    return Err(LinkError::Owned {
                        name: self.console.name().to_owned(),
                    });
                }
                Some(HostEvent::Report(report)) => tally.report(report.body()),
                Some(HostEvent::Pong(_)) => {}
                None => {}
            }
        }
        Ok(heard)
    }

    fn open(&mut self, tally: &mut Statistics) -> Result<Hello, LinkError> {
        // Any number will do: nobody else is on this line, and the trace must not depend on it.
        const NONCE: u32 = 1;
        let mut frame = [0; MAX_FRAME];
        let length = self.end.hello(NONCE, &mut frame).unwrap_or_default();
        self.down.extend_from_slice(&frame[..length]);
        for _ in 0..ANSWER_WITHIN {
            if let Some(console) = self.exchange(tally)?.opened {
                return Ok(console);
            }
        }
        let name = self.console.name().to_owned();
        Err(match self.end.unusable_answer() {
            Some(mismatch) => LinkError::Mismatch { name, mismatch },
            None => {
                let what = format!("did not answer within {ANSWER_WITHIN} exchanges");
                LinkError::Console { name, what }
            }
        })
    }
}

#[derive(Default)]
struct Heard {
    opened: Option<Hello>,
    state: Option<Valid<State>>,
}

/// Instruction before a tick. Of one list each counts in its place.
#[derive(Clone, Debug, PartialEq)]
pub enum Instruction {
    /// Order to the console.
    Order(Order),
    /// Request for rest, with the name of the person.
    Stop(Stop, String),
}

impl From<Order> for Instruction {
    fn from(order: Order) -> Self {
        Self::Order(order)
    }
}

/// What steers a session between its ticks.
pub trait Steer {
    /// Whether the session begins at rest. Asked once, before the console is armed. The first instructions then say who
    /// stopped it, and the first [`Command::Arm`] among them arms it.
    fn begins_at_rest(&mut self) -> bool {
        false
    }

    /// Before each tick from the session's first state on: adds `instructions` for that tick. May wait, as time stands still
    /// meanwhile; may end the session.
    fn steer(&mut self, now: &Steered<'_>, instructions: &mut Vec<Instruction>) -> ControlFlow<()>;

    /// What hands do with tools before the next solve.
    fn acts(&mut self) -> Vec<Act> {
        Vec::new()
    }

    /// Another tuning, from the tick on that was steered last.
    fn tuned(&mut self) -> Option<Tuning> {
        None
    }
}

/// Where a session is that is steered.
#[derive(Clone, Copy, Debug)]
pub struct Steered<'a> {
    /// Ticks since the session's first state.
    pub ticks: u64,
    /// Solves so far.
    pub solves: u64,
    /// The console's newest state.
    pub state: &'a State,
    /// The console's newest report.
    pub report: Option<&'a Report>,
}

/// Nobody steers.
struct Straight;

impl Steer for Straight {
    fn steer(&mut self, _: &Steered<'_>, _: &mut Vec<Instruction>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// Runs a session of `plan.seconds` of console time; `progress` may end it early, and so may
/// [`work::stop_with`](crate::work::stop_with), in the midst of a solver step.
///
/// # Errors
/// See [`SessionError`].
pub fn run_lockstep(
    console: &mut dyn LockstepConsole,
    plan: &Plan,
    solver: &mut dyn Solve,
    progress: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> Result<Summary, SessionError> {
    run_steered(console, plan, solver, progress, &mut Straight)
}

/// As [`run_lockstep`], with somebody who steers it: pauses, orders to the console, an end. The same orders before the same
/// ticks give the same session, to the bit.
///
/// # Errors
/// See [`SessionError`].
pub fn run_steered(
    console: &mut dyn LockstepConsole,
    plan: &Plan,
    solver: &mut dyn Solve,
    mut progress: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
    steer: &mut dyn Steer,
) -> Result<Summary, SessionError> {
    let started = Instant::now();
    let mut plan = *plan;
    let mut tally = Statistics::of(&plan);
    let end = HostLink::new(plan.tick_hz);
    let mut line = Line {
        console,
        end,
        down: Vec::new(),
        up: Vec::new(),
        newest_us: 0,
        exchanges: 0,
        unusable: Unusable::default(),
        bytes: (0, 0),
    };
    let hello = line.open(&mut tally)?;
    let rests = steer.begins_at_rest();
    for order in plan.opening_orders(&hello)? {
        // Noted even where it is withheld: a stop in the first instructions is the cause of the rest.
        tally.order(&order);
        if !(rests && order == Order::Command(Command::Arm)) {
            line.order(&order)?;
        }
    }
    let mut arming = (!rests).then(|| ArmingWatch::new(&plan));
    let mut schedule: Option<Schedule> = None;
    let mut pending: Option<(u64, Felt)> = None;
    let mut underway = Underway::default();
    let mut counters = LinkCounters::default();
    let (mut silent, mut solves, mut last_tick) = (0, 0, None);
    let mut instructions = Vec::new();
    while tally.ticks() < plan.ticks() {
        if let Some(state) = tally.last() {
            let now = Steered {
                ticks: tally.ticks(),
                solves,
                state,
                report: tally.last_report(),
            };
            let ends = steer.steer(&now, &mut instructions).is_break();
            for instruction in instructions.drain(..) {
                match instruction {
                    Instruction::Stop(stop, by) => tally.stop(stop, by),
                    Instruction::Order(order) => {
                        tally.order(&order);
                        line.order(&order)?;
                    }
                }
            }
            if ends {
                break;
            }
            for act in steer.acts() {
                solver.act(act);
            }
            if let Some(tuning) = steer.tuned() {
                plan = plan.tuned(&tuning);
                solver.tune(&plan);
                tally.change(plan.host_hz);
                if let Some(schedule) = &mut schedule {
                    schedule.change(plan.host_hz);
                }
            }
        }
        // The contact of the last solve leaves just before the tick that starts the next one.
        let next_tick = tally.last().map(|state| state.tick.wrapping_add(1));
        let starts = match (&mut schedule, next_tick) {
            (Some(schedule), Some(tick)) => schedule.is_due(tick),
            _ => false,
        };
        if let Some((time_us, felt)) = pending.take_if(|_| starts) {
            match felt.append(&mut line.end, time_us, &mut line.down) {
                Ok(sent) => {
                    tally.frame(time_us, &felt.contact);
                    underway.sent(sent, |contact, fate| tally.fate(contact, fate));
                    counters.contacts_sent += 1;
                }
                Err(error) => {
                    // Nothing is sent that the console would refuse: it ages out what it has.
                    tracing::warn!("a message to the console was not sent: {error}");
                    counters.contacts_unsendable += 1;
                }
            }
        }
        let state = line.exchange(&mut tally)?.state;
        let tick = state.as_ref().map(|state| state.body().tick);
        if tick.is_none() || tick == last_tick {
            silent += 1;
            if let Some(tick) = tick {
                line.unusable.stood(tick);
            }
            if silent > u32::from(plan.state_every) + ANSWER_WITHIN {
                return Err(SessionError::Silent {
                    waited_s: f64::from(silent) / f64::from(plan.tick_hz),
                    heard: line.unusable.to_string(),
                });
            }
        }
        let Some(state) = state else { continue };
        if tick != last_tick {
            silent = 0;
            last_tick = tick;
            line.unusable.counted(state.body().tick);
        }
        if schedule.is_none() {
            let begins = match &mut arming {
                Some(watch) => match watch.judge(state.body())? {
                    Arming::Armed => true,
                    Arming::NotYet => false,
                    Arming::Again => {
                        line.order(&Order::Command(Command::Arm))?;
                        false
                    }
                },
                // An order to arm is obeyed from here on.
                None => state.body().mode != Mode::Boot,
            };
            if !begins {
                continue;
            }
            let first = state.body().tick;
            schedule = Some(Schedule::new(first, plan.tick_hz, plan.host_hz));
        }
        let first = tally.last().is_none();
        tally.state(state.body());
        underway.state(state.console_time_us(), state.body(), |contact, fate| {
            tally.fate(contact, fate);
        });
        // One that disarmed itself, because contacts stayed away for so long, feels nothing until the end.
        if (starts || first) && state.body().mode != Mode::Idle {
            let before = Instant::now();
            let core = core_time();
            let solved = solver.solve(&state);
            // The step was given up on the way: nothing is known by it.
            if work::is_stopped() {
                break;
            }
            tally.core(core_time().saturating_sub(core));
            let solve_time = before.elapsed();
            tally.step(&solved, solve_time);
            solves += 1;
            let horizon_us = tally.horizon.next_us();
            let frames = solved.frames(state.body(), horizon_us, plan.rendering);
            let frames = tally.sendable(&solved, frames);
            pending = frames.map(|felt| (state.console_time_us(), felt));
            let time = before.elapsed();
            tally.session(time, time.saturating_sub(solve_time));
        }
        if tally.ticks().is_multiple_of(PROGRESS_EVERY) {
            let elapsed_s = tally.ticks() as f64 / f64::from(plan.tick_hz);
            line.count_limits(&mut tally);
            let note = Progress {
                elapsed_s,
                seconds: plan.seconds,
                state: Some(state.body()),
                report: tally.last_report(),
                link: None,
                needle_waits: tally.waits(),
                limited: tally.limited(),
            };
            if progress(&note).is_break() {
                break;
            }
        }
    }
    line.count_limits(&mut tally);
    // The console goes to rest, and its counters come in. The tally's last state stays the session's.
    line.order(&Order::Command(Command::Disarm))?;
    let reports = tally.last_report().copied();
    for _ in 0..AFTER {
        line.exchange(&mut tally)?;
        if tally.last_report().copied() != reports {
            break;
        }
    }
    counters.frames = line.end.counters();
    counters.refused_most = line.unusable.refused_most();
    let per_s =
        |bytes: u64| bytes as f64 * f64::from(plan.tick_hz) / f64::from(line.exchanges.max(1));
    let link = LinkSummary {
        bytes_per_s: Throughput {
            down: per_s(line.bytes.0),
            up: per_s(line.bytes.1),
        },
        sessions: 1,
        ..LinkSummary::default()
    };
    let summary = Summary {
        console: line.console.name().to_owned(),
        device: plan.device_name(&hello),
        wall_s: started.elapsed().as_secs_f64(),
        link,
        rendering: plan.rendering.word(),
        most_rows: plan.most_rows(),
        ..tally.summary(&counters, plan.tick_hz)
    };
    Ok(summary.with_scene(solver.scene()))
}
