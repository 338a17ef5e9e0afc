//! Who steers a sandbox: what pages ask for between two ticks, and the pace of the wall clock.
//!
//! Entry points: [`Helm`], [`Helm::ended`].

use super::guide::{Guide, NO_WAY, NO_WAY_HELP, NOT_HELD};
use super::prepare::{Prepared, Wish};
use super::saves::Saves;
use super::settings::{Change, Setting};
use super::show::Show;
use super::take_out::{IS_CLEAR, MORE_WAYS, NoWay, RESTS_S, STILL_INSIDE, Start, TakeOut, grip};
use crate::failure::Failure;
use crate::signals::Stoppable;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::link::Order;
use sutura_host::scene::Tissue;
use sutura_host::session::{Instruction, Plan, Steer, Steered, Stop, Tuning};
use sutura_host::tool::Act;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command as ToConsole, Mode, Simulate};
use sutura_view::{Command, Hand, Reply, Request, SetTo};

/// Between two looks at signals while time stands still.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Pictures a second that a page asks for \[Hz\].
const PICTURE_HZ: f64 = 30.0;
/// Shorter than this it is not slept.
const WORTH_SLEEPING: Duration = Duration::from_millis(2);
/// A session that is later than this does not hurry after.
const LATE: Duration = Duration::from_millis(100);
/// Ticks that run while time stands still so that an order is obeyed and seen.
const TICKS_TO_OBEY: u64 = 3;

/// Commands that a sandbox obeys.
pub const COMMANDS: [&str; 18] = [
    "scalar",
    "safe_stop",
    "arm",
    "clear_fault",
    "take_out",
    "drag",
    "hand",
    "jaws",
    "pause",
    "resume",
    "step",
    "speed",
    "reset",
    "scene",
    "tissue",
    "set",
    "record",
    "save_last",
];

/// Why jaws cannot be closed, and what helps.
pub const NO_JAWS: &str = "the console's tool has no jaws";
/// See [`NO_JAWS`].
pub const NO_JAWS_HELP: &str = "take a scene whose driven tool has `[[jaws]]`";

/// Why a session of a sandbox is over.
pub enum Ended {
    /// The program is to end.
    Closed,
    /// Another one begins; at rest after a safe stop.
    Next(Box<Prepared>, Option<Stopper>),
}

/// Person who asked for a safe stop.
#[derive(Clone, Debug)]
pub struct Stopper {
    /// Name for summaries.
    person: String,
    /// Words for pages.
    asker: &'static str,
}

impl Stopper {
    fn of(reply: &Reply) -> Self {
        Self {
            person: reply.person(),
            asker: reply.asker(),
        }
    }
}

/// Next step for a simulated console that has lost counts.
const RESTART: &str = "`Start again` begins with counts that are right";

/// How far time goes before it stands still again.
#[derive(Clone, Copy, Debug)]
enum Until {
    Tick(u64),
    Solve(u64),
}

/// Sessions in the making that nobody waits for any more, at most.
const MOST_LEFT: usize = 3;

/// A session that is made beside this one.
struct Making {
    thread: JoinHandle<Result<Prepared, Failure>>,
    /// Ends it at its next stage.
    stop: Arc<AtomicBool>,
    reply: Reply,
}

/// Who steers.
pub struct Helm<'a> {
    asked: &'a Receiver<Request>,
    stop: &'a AtomicBool,
    show: &'a Show,
    wish: Wish,
    plan: Plan,
    settings: Vec<Setting>,
    saves: Saves,
    guide: Guide,
    /// Of the session from the next tick on, where it is another.
    tuned: Option<Tuning>,
    speed: f64,
    paused: bool,
    until: Option<Until>,
    /// From when and from which tick the pace counts.
    from: (Instant, u64),
    /// The console's tool, if that has jaws, and what is done with it before the next solve.
    jaws: Option<u8>,
    acts: Vec<Act>,
    /// Ways out of the tissue for the console's tool.
    out: Option<TakeOut>,
    /// Tick at which the way out that it is on ends, and the number of further ones; then the console is armed.
    leaving: Option<(u64, u8)>,
    /// Somebody has asked to arm a console that decays.
    arms: bool,
    making: Option<Making>,
    /// Person who asked for the safe stop with which the session begins.
    held: Option<Stopper>,
    /// Requests from before the session's first state.
    waiting: VecDeque<Request>,
    /// Person who asked for a safe stop since another session is being made, unless somebody asked to arm after it.
    holds_next: Option<Stopper>,
    /// Sessions in the making in whose place another one was asked for.
    left: Vec<JoinHandle<Result<Prepared, Failure>>>,
    ended: Option<Ended>,
    /// Set when time stands still, to the time from one picture to the next \[s\].
    stands: Option<Arc<OnceLock<f64>>>,
}

impl<'a> Helm<'a> {
    /// At the helm of a session of this plan and these settings, that a wish has led to.
    pub fn new(
        (asked, stop): (&'a Receiver<Request>, &'a AtomicBool),
        show: &'a Show,
        wish: Wish,
        (plan, settings): (Plan, Vec<Setting>),
        saves: Saves,
    ) -> Self {
        let helm = Self {
            guide: Guide::new(plan.hand, plan.device.kinematics),
            asked,
            stop,
            show,
            wish,
            plan,
            settings,
            saves,
            tuned: None,
            speed: 1.0,
            paused: false,
            until: None,
            from: (Instant::now(), 0),
            jaws: None,
            acts: Vec::new(),
            out: None,
            leaving: None,
            arms: false,
            making: None,
            held: None,
            waiting: VecDeque::new(),
            holds_next: None,
            left: Vec::new(),
            ended: None,
            stands: None,
        };
        helm.tell();
        helm
    }

    /// The console's tool has jaws, if it is one.
    pub fn close_jaws_of(&mut self, tool: Option<u8>) {
        self.jaws = tool;
    }

    /// The console's tool can be taken out of the tissue.
    pub fn take_out_by(&mut self, out: Option<TakeOut>) {
        self.out = out;
    }

    /// The session begins at rest, if somebody asked for a safe stop while it was made.
    pub fn held_by(&mut self, stopper: Option<Stopper>) {
        self.held = stopper;
    }

    /// Time stands still from so long after the start on \[s\]; `reached` is set then.
    pub fn pause_at(&mut self, at_s: f64, reached: Arc<OnceLock<f64>>) {
        let ticks = (at_s * f64::from(self.plan.tick_hz)).round() as u64;
        (self.paused, self.until) = (true, Some(Until::Tick(ticks)));
        self.stands = Some(reached);
        // Every solve is shown on the way there, and so is the last one.
        self.tell();
    }

    /// Why the session is over, and the file that all of it is in, if one is.
    pub fn ended(self) -> (Ended, Option<PathBuf>) {
        let file = self.saves.file().map(Path::to_owned);
        (self.ended.unwrap_or(Ended::Closed), file)
    }

    fn tell(&self) {
        self.show.going(|going| {
            going.paused = self.paused;
            going.wanted_speed = Some(self.speed);
            going.recording = Some(self.saves.file().is_some());
        });
    }

    fn go_on(&mut self, ticks: u64) {
        self.from = (Instant::now(), ticks);
    }

    fn obey(&mut self, request: Request, now: &Steered<'_>, instructions: &mut Vec<Instruction>) {
        let Request { command, reply } = request;
        let moves = self.moves(now);
        let now_s = self.time_s(now);
        match command {
            Command::SafeStop => self.safe_stop(Stopper::of(&reply), now, instructions),
            Command::Arm | Command::TakeOut if now.state.mode == Mode::Fault => {
                let restarts = now.state.faults & faults::UNTIL_RESTART != 0;
                let help = if restarts {
                    RESTART
                } else {
                    "clear the fault first"
                };
                return reply.refuse("the console is in a latched fault", help);
            }
            Command::Arm => {
                self.leaving = None;
                self.note_arm();
                self.guide.arm();
                self.arms = now.state.mode == Mode::Decaying;
                self.order(ToConsole::Arm, now, instructions);
            }
            Command::TakeOut => {
                let mut way = Vec::new();
                match self.leave(Start::Grip, MORE_WAYS, now, &mut way) {
                    Ok(true) => {
                        self.arms = false;
                        self.show.telemetry().take_out();
                        instructions.push(Instruction::Stop(Stop::TakeOut, reply.person()));
                        self.order(ToConsole::Disarm, now, instructions);
                        instructions.append(&mut way);
                    }
                    Ok(false) => {
                        let (message, help) = IS_CLEAR;
                        return reply.refuse(message, help);
                    }
                    Err((message, help)) => return reply.refuse(&message, help),
                }
                if self.paused {
                    self.until = self
                        .leaving
                        .map(|(ends, _)| Until::Tick(ends + TICKS_TO_OBEY));
                }
            }
            Command::ClearFault if now.state.faults & faults::UNTIL_RESTART != 0 => {
                return reply.refuse(
                    "an encoder has lost its place, and clearing does not bring it back",
                    RESTART,
                );
            }
            Command::ClearFault => self.order(ToConsole::ClearFault, now, instructions),
            Command::Drag(Some(_)) | Command::Hand(_) if !moves => {
                let (message, help) = NOT_HELD;
                return reply.refuse(message, help);
            }
            Command::Drag(to_m) => self.guide.drag(now_s, to_m),
            Command::Hand(Hand::Recorded) if !self.guide.has_way() => {
                return reply.refuse(NO_WAY, NO_WAY_HELP);
            }
            Command::Hand(hand) => {
                let script = self.guide.go(now_s, hand);
                instructions.push(Order::Simulate(Simulate::Hand(script)).into());
            }
            Command::Jaws(closed) => match self.jaws {
                Some(tool) => self.acts.push(Act::of_jaws(tool, closed)),
                None => return reply.refuse(NO_JAWS, NO_JAWS_HELP),
            },
            Command::Pause => (self.paused, self.until) = (true, None),
            Command::Resume => {
                (self.paused, self.until) = (false, None);
                self.go_on(now.ticks);
            }
            Command::StepTicks(ticks) => {
                self.step(Until::Tick(now.ticks + u64::from(ticks)), now);
            }
            Command::StepSolves(solves) => {
                self.step(Until::Solve(now.solves + u64::from(solves)), now);
            }
            Command::Speed(factor) => {
                self.speed = factor;
                self.go_on(now.ticks);
            }
            Command::Reset => return self.make(self.wish.clone(), reply),
            Command::Scene(name) => {
                return match self.wish.of_scene(&name) {
                    Some(wish) => self.make(wish, reply),
                    None => reply.refuse(
                        &format!("there is no scene `{name}` beside this one"),
                        "`scenes` of `hello` lists what there is",
                    ),
                };
            }
            Command::Tissue(name) => {
                return match Tissue::named(&name) {
                    Ok(tissue) => {
                        let wish = Wish {
                            tissue: Some(tissue),
                            rendering: None,
                            ..self.wish.clone()
                        };
                        self.make(wish, reply);
                    }
                    Err(message) => {
                        reply.refuse(&message, "`tissues` of `hello` lists what there is")
                    }
                };
            }
            Command::Set { name, value } => {
                return self.set((&name, &value), now, instructions, reply);
            }
            Command::SaveLast => return self.saves.last(reply),
            Command::Record(true) if self.saves.file().is_some() => {
                return reply.refuse("this session is recorded", "say `record` with `on`: false");
            }
            Command::Record(true) => {
                // What the solver was before is not known to a file that begins now.
                let wish = Wish {
                    is_recorded: true,
                    ..self.wish.clone()
                };
                return self.make(wish, reply);
            }
            Command::Record(false) => {
                self.wish.is_recorded = false;
                self.saves.end(reply);
                return self.tell();
            }
            // The server's own.
            Command::Ack(_)
            | Command::PictureHz(_)
            | Command::Scalar(_)
            | Command::TakeControl
            | Command::Seek(_) => {}
        }
        self.tell();
        reply.done();
    }

    fn safe_stop(
        &mut self,
        stopper: Stopper,
        now: &Steered<'_>,
        instructions: &mut Vec<Instruction>,
    ) {
        let is_led = self.leaving.take().is_some();
        self.arms = false;
        // A drag or a way out is over: a grip that is armed again stays where it was stopped.
        if is_led {
            let script = self
                .guide
                .stay(self.time_s(now), grip(now.state).position_m);
            instructions.push(Order::Simulate(Simulate::Hand(script)).into());
        }
        self.guide.stop();
        self.show.telemetry().safe_stop(stopper.asker);
        instructions.push(Instruction::Stop(Stop::Safe, stopper.person.clone()));
        self.order(ToConsole::Disarm, now, instructions);
        if self.making.is_some() {
            self.holds_next.get_or_insert(stopper);
        }
    }

    /// Whether the page may move the grip.
    fn moves(&mut self, now: &Steered<'_>) -> bool {
        let renders = matches!(now.state.mode, Mode::Armed | Mode::Decaying);
        self.guide.moves(renders)
    }

    /// Takes note that somebody has asked to arm the console.
    fn note_arm(&mut self) {
        self.show.telemetry().arm();
        self.holds_next = None;
    }

    fn step(&mut self, until: Until, now: &Steered<'_>) {
        (self.paused, self.until) = (true, Some(until));
        self.go_on(now.ticks);
    }

    /// An order that is obeyed even while time stands still.
    fn order(&mut self, order: ToConsole, now: &Steered<'_>, instructions: &mut Vec<Instruction>) {
        instructions.push(Order::Command(order).into());
        if self.paused && self.until.is_none() {
            self.until = Some(Until::Tick(now.ticks + TICKS_TO_OBEY));
            self.go_on(now.ticks);
        }
    }

    /// Begins a way out of the tissue, with at most `more` after it. Returns whether there is one: none for a tool that is clear.
    fn leave(
        &mut self,
        start: Start,
        more: u8,
        now: &Steered<'_>,
        instructions: &mut Vec<Instruction>,
    ) -> Result<bool, NoWay> {
        let now_s = self.time_s(now);
        let grip = grip(now.state);
        // The last solve was before the first way.
        let slipped = matches!(start, Start::Grip) && self.show.telemetry().has_slipped();
        let Some(out) = &self.out else {
            let message = "the console's grip carries nothing that could be in the tissue";
            return Err((message.to_owned(), "arm the console"));
        };
        let Some((script, way_s)) = out.way(&mut self.guide, now_s, &grip, start, slipped)? else {
            return Ok(false);
        };
        instructions.push(Order::Simulate(Simulate::Hand(script)).into());
        let ticks = ((way_s + RESTS_S) * f64::from(self.plan.tick_hz)).ceil() as u64;
        self.leaving = Some((now.ticks + ticks, more));
        Ok(true)
    }

    /// Arms the console at the end of a way out of the tissue, or goes on to the next one.
    fn look_whether_out(&mut self, now: &Steered<'_>, instructions: &mut Vec<Instruction>) {
        let Some((_, more)) = self.leaving.take_if(|(ends, _)| now.ticks >= *ends) else {
            return;
        };
        match self.leave(Start::Hand, more.saturating_sub(1), now, instructions) {
            Ok(false) => {
                self.note_arm();
                instructions.push(Order::Command(ToConsole::Arm).into());
            }
            Ok(true) if more > 0 => {
                if self.paused {
                    self.until = self
                        .leaving
                        .map(|(ends, _)| Until::Tick(ends + TICKS_TO_OBEY));
                }
            }
            Ok(true) | Err(_) => {
                self.leaving = None;
                note!("{STILL_INSIDE}");
            }
        }
    }

    fn set(
        &mut self,
        (name, to): (&str, &SetTo),
        now: &Steered<'_>,
        instructions: &mut Vec<Instruction>,
        reply: Reply,
    ) {
        let mut named = self.settings.iter_mut();
        let Some(setting) = named.find(|each| each.name() == name) else {
            let message = format!("there is no setting `{name}`");
            return reply.refuse(&message, "`settings` of `hello` lists what there is");
        };
        if let Some((message, help)) = setting.flaw(to) {
            return reply.refuse(&message, &help);
        }
        let wish = self.wish.with(setting, to);
        let Some(change) = setting.change(&wish, &self.plan) else {
            return self.make(wish, reply);
        };
        setting.take(to);
        self.wish = wish;
        reply.done();
        self.change(change, now, instructions);
    }

    /// Changes what needs no other solver.
    fn change(&mut self, change: Change, now: &Steered<'_>, instructions: &mut Vec<Instruction>) {
        match change {
            Change::Tuning(tuning) => {
                self.plan = self.plan.tuned(&tuning);
                self.tuned = Some(tuning);
            }
            // On a way out the hand holds the grip as that needs.
            Change::Grasp(grasp) if self.leaving.is_some() => self.guide.take(grasp),
            Change::Grasp(grasp) => {
                let now_s = self.time_s(now);
                let script = if self.moves(now) {
                    self.guide.hold(now_s, grasp)
                } else {
                    // At rest a simulated console begins at the script's start: the grip stays where it is.
                    let here = grip(now.state).position_m;
                    self.guide.hold_at_rest(now_s, grasp, here)
                };
                instructions.push(Order::Simulate(Simulate::Hand(script)).into());
            }
            Change::Standing(standing) => {
                instructions.push(Order::Fixture(standing.fixture(now.state.position_m)).into());
            }
        }
        let settings: Vec<_> = self.settings.iter().map(Setting::said).collect();
        self.show.changed(&[
            ("settings", settings.into()),
            ("rendering", self.plan.rendering.word().into()),
            ("host_hz", self.plan.host_hz.into()),
        ]);
    }

    /// Makes another session beside this one, in place of one that is not made yet: a scene that takes for ever keeps nobody
    /// from the next.
    fn make(&mut self, wish: Wish, reply: Reply) {
        if self.making.is_none() {
            self.holds_next = None;
        }
        self.left.retain(|thread| !thread.is_finished());
        if self.making.is_some() && self.left.len() >= MOST_LEFT {
            let message = format!("{} other sessions are being made already", MOST_LEFT + 1);
            return reply.refuse(&message, "wait until one begins, or begin the program anew");
        }
        if let Some(Making {
            thread,
            stop,
            reply,
        }) = self.making.take()
        {
            stop.store(true, Ordering::Relaxed);
            self.left.push(thread);
            reply.refuse(
                "another session was asked for before this one was made",
                "ask for it again, and wait until it begins",
            );
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stops = stop.clone();
        let thread = std::thread::Builder::new()
            .name("sutura-prepare".to_owned())
            .spawn(move || {
                let _ends = Stoppable::by(&stops);
                Prepared::of(wish)
            });
        match thread {
            Ok(thread) => {
                self.making = Some(Making {
                    thread,
                    stop,
                    reply,
                });
            }
            Err(error) => reply.refuse(
                &format!("there is no thread to make it: {error}"),
                "end other programs",
            ),
        }
    }

    /// Whether the next session is ready.
    fn is_made(&mut self) -> bool {
        let Some(making) = self.making.take_if(|making| making.thread.is_finished()) else {
            return false;
        };
        match making.thread.join() {
            Ok(Ok(prepared)) => {
                making.reply.done();
                self.ended = Some(Ended::Next(Box::new(prepared), self.holds_next.take()));
                return true;
            }
            Ok(Err(failure)) => {
                let [message, help] = failure.in_words();
                making.reply.refuse(&message, &help);
            }
            Err(_) => making.reply.refuse(
                "it could not be made",
                "this is a defect: please report it with the scene",
            ),
        }
        false
    }

    /// Time of the console's hand: it began with the session's first tick, as good as.
    fn time_s(&self, now: &Steered<'_>) -> f64 {
        now.ticks as f64 / f64::from(self.plan.tick_hz)
    }

    /// How long until the next tick is due.
    fn ahead(&mut self, ticks: u64) -> Duration {
        let (since, first) = self.from;
        let due_s = ticks.saturating_sub(first) as f64 / f64::from(self.plan.tick_hz) / self.speed;
        let passed = since.elapsed();
        let due = Duration::try_from_secs_f64(due_s).unwrap_or(passed);
        if passed > due + LATE {
            self.go_on(ticks);
        }
        due.saturating_sub(passed)
    }
}

impl Steer for Helm<'_> {
    fn begins_at_rest(&mut self) -> bool {
        // Requests from between two sessions count, too.
        self.waiting.extend(self.asked.try_iter());
        let mut stopper = self.held.clone();
        for Request { command, reply } in &self.waiting {
            match command {
                Command::SafeStop => stopper = stopper.or_else(|| Some(Stopper::of(reply))),
                Command::Arm => stopper = None,
                _ => {}
            }
        }
        let Some(stopper) = stopper else {
            self.held = None;
            return false;
        };
        self.show.telemetry().safe_stop(stopper.asker);
        // Nothing is solved at rest, and the scene is seen all the same.
        self.show.offer().offer_first();
        true
    }

    fn acts(&mut self) -> Vec<Act> {
        std::mem::take(&mut self.acts)
    }

    fn tuned(&mut self) -> Option<Tuning> {
        self.tuned.take()
    }

    fn steer(&mut self, now: &Steered<'_>, instructions: &mut Vec<Instruction>) -> ControlFlow<()> {
        if let Some(report) = now.report {
            self.show.going(|going| going.report = Some(*report));
        }
        let is_there = |until: Until| match until {
            Until::Tick(tick) => now.ticks >= tick,
            Until::Solve(solve) => now.solves >= solve,
        };
        if self.until.is_some_and(is_there) {
            self.until = None;
            if let Some(stands) = &self.stands {
                // While time stands still again, whoever waits for it has it already.
                let _ = stands.set(1.0 / PICTURE_HZ + 1.0 / self.plan.host_hz);
            }
        }
        if let Some(stopper) = self.held.take() {
            self.safe_stop(stopper, now, instructions);
        }
        while let Some(request) = self.waiting.pop_front() {
            self.obey(request, now, instructions);
        }
        loop {
            if self.stop.load(Ordering::Relaxed) || self.is_made() {
                return ControlFlow::Break(());
            }
            let wait = if self.paused && self.until.is_none() {
                LOOK_EVERY
            } else {
                self.ahead(now.ticks).min(LOOK_EVERY)
            };
            let request = if wait < WORTH_SLEEPING {
                self.asked.try_recv().ok()
            } else {
                match self.asked.recv_timeout(wait) {
                    Ok(request) => Some(request),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) => return ControlFlow::Break(()),
                }
            };
            match request {
                Some(request) => self.obey(request, now, instructions),
                None if wait < WORTH_SLEEPING => break,
                None => {}
            }
        }
        self.look_whether_out(now, instructions);
        if self.arms && now.state.mode != Mode::Decaying {
            self.arms = false;
            if now.state.mode == Mode::Idle {
                self.order(ToConsole::Arm, now, instructions);
            }
        }
        let now_s = self.time_s(now);
        if self.moves(now)
            && let Some(script) = self.guide.order(now_s)
        {
            instructions.push(Order::Simulate(Simulate::Hand(script)).into());
        }
        ControlFlow::Continue(())
    }
}
