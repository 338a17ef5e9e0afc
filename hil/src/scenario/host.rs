//! Hosts: one that steps with the bench's ticks, and what every host of a scenario can do.
//!
//! Entry points: [`Host::step`], [`ModelHost::new`]. The model speaks through the product's own end of the link and asks
//! the product's own solvers; it has no threads and no clock, so that a scenario gives the same bytes at every run.

use super::{HostSpec, Scenario, Ticks, World, world};
use std::collections::VecDeque;
use sutura_host::link::{Felt, SentContact};
use sutura_host::scene::{self, SceneError};
use sutura_host::session::{Fate, Horizon, Rendering, SceneSolver, Solve, Underway};
use sutura_host::solve::SolveError;
use sutura_shared::control::TICK_HZ;
use sutura_shared::link::{HostEvent, HostLink, SendError};
use sutura_shared::wire::message::{Command, HandScript, Hello, Mode, Ping, Simulate, State};
use sutura_shared::wire::{MAX_FRAME, Message, Valid};

/// Time after which a host asks again for a session \[ticks\].
const ASK_EVERY: Ticks = 100;
/// Time between two pings \[ticks\].
const PING_EVERY: Ticks = 100;
/// Time without a state after which a host asks for a new session \[ticks\].
const SILENT: Ticks = 500;

/// Why a host cannot work.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// Its scene is wrong.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Its scene cannot be solved.
    #[error("the host's scene cannot be solved: {0}")]
    Solve(#[from] SolveError),
    /// The process does not start.
    #[error("{what}: {source}")]
    Process {
        /// What was tried.
        what: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// The host's end of a scenario's line. Dropping it is its death.
pub trait Host {
    /// Takes what the console has said and gives what is said to the console, at this tick of the bench.
    ///
    /// # Errors
    /// When the system fails it.
    fn step(&mut self, now: Ticks, heard: &[u8], said: &mut Vec<u8>) -> Result<(), HostError>;

    /// Whether the scenario has to wait until it has armed the console.
    fn takes_its_time(&self) -> bool {
        false
    }
}

/// Nobody.
pub struct Silence;

impl Host for Silence {
    fn step(&mut self, _: Ticks, _: &[u8], _: &mut Vec<u8>) -> Result<(), HostError> {
        Ok(())
    }
}

/// A host that steps with the bench.
pub struct ModelHost {
    link: HostLink,
    spec: HostSpec,
    solver: Box<dyn Solve>,
    device: Simulate,
    hand: Option<HandScript>,
    /// Whether it arms the console in its next session.
    arms: bool,
    /// Whether nobody was there before in this scenario.
    first: bool,
    horizon: Horizon,
    underway: Underway,
    nonce: u32,
    asked: Option<Ticks>,
    heard: Ticks,
    /// When the next ping is due.
    ping: Ticks,
    newest: Option<Valid<State>>,
    /// When solving began, and how many solves there were.
    began: Option<(Ticks, u64)>,
    /// Sent at a tick: what was solved, and its console time \[us\].
    pending: VecDeque<(Ticks, u64, Felt)>,
}

impl ModelHost {
    /// The host of a scenario; `generation` counts them.
    ///
    /// # Errors
    /// [`HostError`] for a scene that cannot be solved.
    pub fn new(scenario: &Scenario, generation: u32, arms: bool) -> Result<ModelHost, HostError> {
        let spec = scenario.host.clone();
        let mut hand = scenario.hand;
        let mut device = scenario.device;
        let solver: Box<dyn Solve> = match &spec.world {
            World::Tissue(path) => {
                let scene = scene::load(path)?;
                hand = hand.or(scene.hand);
                device = scene.device.map_or(device, |own| own.description);
                Box::new(SceneSolver::new(&scene)?)
            }
            analytic => world::solver(analytic),
        };
        Ok(ModelHost {
            link: HostLink::new(TICK_HZ),
            horizon: Horizon::new(spec.hz),
            underway: Underway::default(),
            solver,
            device: Simulate::Device(device),
            // The hand goes on whoever comes.
            hand: hand.filter(|_| generation == 0),
            arms,
            first: generation == 0,
            // Different ones, and the same from run to run.
            nonce: (generation + 1) << 16,
            asked: None,
            heard: 0,
            ping: 0,
            newest: None,
            began: None,
            pending: VecDeque::new(),
            spec,
        })
    }

    fn ask(&mut self, now: Ticks, said: &mut Vec<u8>) {
        self.nonce += 1;
        self.asked = Some(now);
        self.newest = None;
        self.pending.clear();
        self.underway.lose(|_, _| {});
        let mut frame = [0; MAX_FRAME];
        // A delimiter first: it ends whatever half a frame an earlier host left on the line.
        said.push(0);
        let length = self.link.hello(self.nonce, &mut frame).unwrap_or_default();
        said.extend(frame.iter().take(length));
    }

    fn send<M: Message>(&mut self, time_us: u64, body: &M, said: &mut Vec<u8>) {
        let mut frame = [0; MAX_FRAME];
        match self.link.send(time_us, body, &mut frame) {
            Ok(length) => said.extend(frame.iter().take(length)),
            Err(SendError::NoSession) => {}
            Err(error) => tracing::warn!("the bench's host cannot say this: {error}"),
        }
    }

    fn opened(&mut self, console: &Hello, said: &mut Vec<u8>) {
        if self.first {
            // Of whoever was there before.
            self.send(0, &Command::ClearFault, said);
        }
        self.first = false;
        if console.simulated {
            // The grip stays on its stand where no hand takes it.
            if let Some(hand) = self.hand.take() {
                let device = self.device;
                self.send(0, &device, said);
                self.send(0, &Simulate::Hand(hand), said);
            }
        }
        if self.arms {
            self.send(0, &Command::Arm, said);
        }
        // Whoever comes back feels nothing until somebody arms again.
        self.arms = false;
    }

    fn take(&mut self, state: Valid<State>) {
        let body = state.body();
        self.horizon.tick(body.tick);
        let horizon = &mut self.horizon;
        self.underway
            .state(state.console_time_us(), body, |_, fate| match fate {
                Fate::Used { age_us } | Fate::TooLate { age_us } => horizon.applied(age_us),
                Fate::Lost => {}
            });
        self.newest = Some(state);
    }

    fn solve(&mut self, now: Ticks) {
        let Some(state) = &self.newest else { return };
        if !matches!(state.body().mode, Mode::Armed | Mode::Decaying) {
            // Nobody feels anything.
            self.began = None;
            return;
        }
        let (began, count) = *self.began.get_or_insert((now, 0));
        let due = began + (count as f64 * 1e3 / self.spec.hz).floor() as Ticks;
        if now < due {
            return;
        }
        // A bench that runs by the wall clock may be late: solves are left out, not made up for.
        let count = ((now - began) as f64 * self.spec.hz / 1e3).floor() as u64 + 1;
        self.began = Some((began, count));
        let solved = self.solver.solve(state);
        // A solve takes as long as its contact is held back.
        self.horizon.took(1000 * self.spec.delay);
        let horizon_us = self
            .spec
            .horizon_us
            .unwrap_or_else(|| self.horizon.next_us());
        if let Some(felt) = solved.frames(state.body(), horizon_us, Rendering::Rows) {
            let when = now + self.spec.delay;
            self.pending
                .push_back((when, state.console_time_us(), felt));
        }
    }

    fn deliver(&mut self, now: Ticks, said: &mut Vec<u8>) {
        while self.pending.front().is_some_and(|(when, ..)| *when <= now) {
            let Some((_, time_us, felt)) = self.pending.pop_front() else {
                return;
            };
            if let Some(rows) = &felt.rows {
                self.send(time_us, rows, said);
            }
            if let Some(needle) = &felt.needle {
                self.send(time_us, needle, said);
            }
            if let Some(thread) = &felt.thread {
                self.send(time_us, thread, said);
            }
            self.send(time_us, &felt.contact, said);
            let sent = SentContact {
                sequence: self.link.sent_sequence(),
                console_time_us: time_us,
                horizon_us: felt.contact.horizon_us,
            };
            if self.link.is_open() {
                self.underway.sent(sent, |_, _| {});
            }
        }
    }
}

impl Host for ModelHost {
    fn step(&mut self, now: Ticks, heard: &[u8], said: &mut Vec<u8>) -> Result<(), HostError> {
        for byte in heard {
            match self.link.receive(*byte) {
                Some(HostEvent::Opened(console)) => {
                    self.heard = now;
                    self.opened(&console, said);
                }
                Some(HostEvent::State(state)) => {
                    self.heard = now;
                    self.take(state);
                }
                _ => {}
            }
        }
        let asks = match self.asked {
            None => true,
            Some(asked) if !self.link.is_open() => now >= asked + ASK_EVERY,
            Some(_) => now >= self.heard + SILENT,
        };
        if asks {
            self.heard = now;
            self.ask(now, said);
        }
        if self.link.is_open() && now >= self.ping {
            self.ping = now + PING_EVERY;
            let host_us = 1000 * now;
            self.send(0, &Ping { host_us }, said);
        }
        self.deliver(now, said);
        self.solve(now);
        // Without a delay it goes at once.
        self.deliver(now, said);
        Ok(())
    }
}
