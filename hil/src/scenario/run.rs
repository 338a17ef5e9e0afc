//! One scenario on one console, from boot to judgement.
//!
//! Entry point: [`run`].

use super::host::{Host, HostError, Silence};
use super::judge::{self, Check};
use super::line::Line;
use super::peer::{Peer, PeerError};
use super::watch::Watch;
use super::{ConsoleKind, Fault, FaultKind, Scenario, Ticks, Way, World};
use sutura_shared::control::TICK_HZ;
use sutura_shared::link::HostLink;
use sutura_shared::wire::message::{Command, Contact, Hello, Mode, Refusal, Simulate};
use sutura_shared::wire::{Accumulator, MAX_FRAME, SCHEMA_HASH, Unchecked, decode, encode};

/// Longest wait for a host that is a process to arm the console: it factors its scene first \[ticks\].
const STARTS_WITHIN: Ticks = 60_000;
/// Time that a session is owned after its host has fallen silent, with some to spare \[ticks\].
const OWNED: Ticks = 400;
/// Time for the last answer \[ticks\].
const ANSWERS: Ticks = 200;

/// What came of a scenario.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What was expected, and what was found.
    pub checks: Vec<Check>,
    /// Over all states, in order: the same from run to run in lockstep.
    pub hash: u64,
    /// How long it lasted.
    pub ticks: Ticks,
    /// How long that took on this machine \[s\].
    pub wall_s: f64,
    /// Longest time for which this machine let neither console nor bench go on \[ticks\].
    pub held_up: Ticks,
}

impl Outcome {
    /// Whether everything was as expected.
    pub fn is_met(&self) -> bool {
        self.checks.iter().all(|check| check.met)
    }
}

/// Why a scenario did not run to its end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The console.
    #[error(transparent)]
    Peer(#[from] PeerError),
    /// The host.
    #[error(transparent)]
    Host(#[from] HostError),
    /// The host never got so far.
    #[error("the host did not arm the console within {} s", STARTS_WITHIN / 1000)]
    NotArmed,
}

/// Makes hosts: the first, and those that come after it.
pub type Hosts<'a> = dyn FnMut(&Scenario, u32, bool) -> Result<Box<dyn Host>, HostError> + 'a;

/// Everything between console and host.
struct Bench<'a> {
    scenario: &'a Scenario,
    peer: &'a mut dyn Peer,
    hosts: &'a mut Hosts<'a>,
    host: Box<dyn Host>,
    generation: u32,
    stranger: Option<Stranger>,
    line: Line<'a>,
    watch: Watch,
    now: Ticks,
    /// When each fault really began and was really over: by the wall clock a bench that this machine holds up is late.
    times: Vec<(Ticks, Ticks)>,
    /// What the host has not heard yet, and what goes down next.
    heard: Vec<u8>,
    down: Vec<u8>,
    up: Vec<u8>,
}

/// Runs a scenario.
///
/// # Errors
/// [`RunError`] when console or host fail; an expectation that is not met is no error.
pub fn run<'a>(
    scenario: &'a Scenario,
    peer: &'a mut dyn Peer,
    hosts: &'a mut Hosts<'a>,
) -> Result<Outcome, RunError> {
    let started = std::time::Instant::now();
    let host = match scenario.host.world {
        World::Nobody => Box::new(Silence) as Box<dyn Host>,
        _ => hosts(scenario, 0, scenario.host.arms)?,
    };
    let mut bench = Bench {
        line: Line::new(&[], scenario.seed),
        scenario,
        peer,
        hosts,
        host,
        generation: 0,
        stranger: None,
        watch: Watch::default(),
        now: 0,
        times: scenario
            .faults
            .iter()
            .map(|fault| (fault.at, fault.until))
            .collect(),
        heard: Vec::new(),
        down: Vec::new(),
        up: Vec::new(),
    };
    if bench.host.takes_its_time() {
        bench.until_armed()?;
    }
    bench.line.begin(&scenario.faults);
    let mut before = None;
    while bench.now < scenario.ticks {
        bench.turn(before)?;
        before = Some(bench.now);
        bench.exchange()?;
    }
    let ticks = bench.now;
    let samples = bench.watch.samples.len();
    bench.ask_for_counters()?;
    bench.watch.samples.truncate(samples);
    let exact = matches!(bench.peer.kind(), ConsoleKind::Native | ConsoleKind::Qemu);
    Ok(Outcome {
        checks: judge::judge(scenario, &bench.watch, &bench.times, exact),
        hash: bench.watch.hash(),
        ticks,
        wall_s: started.elapsed().as_secs_f64(),
        held_up: bench.peer.held_up(),
    })
}

impl Bench<'_> {
    /// Lets a host that takes its time get ready; the scenario begins when the console is armed.
    fn until_armed(&mut self) -> Result<(), RunError> {
        loop {
            self.exchange()?;
            let newest = self.watch.samples.last();
            if newest.is_some_and(|sample| sample.state.mode == Mode::Armed) {
                break;
            }
            if self.now > STARTS_WITHIN {
                return Err(RunError::NotArmed);
            }
        }
        self.now = 0;
        self.watch.samples.clear();
        self.watch.opened.iter_mut().for_each(|at| *at = 0);
        Ok(())
    }

    /// What begins and what ends by now and has not before.
    fn turn(&mut self, before: Option<Ticks>) -> Result<(), RunError> {
        let scenario = self.scenario;
        let now = self.now;
        let comes = |at: Ticks| at <= now && before.is_none_or(|before| at > before);
        for (at, command) in &scenario.orders {
            if comes(*at) {
                self.line.inject(now, command);
            }
        }
        for (index, fault) in scenario.faults.iter().enumerate() {
            if comes(fault.at) {
                self.begin(fault)?;
                if let Some((began, _)) = self.times.get_mut(index) {
                    *began = now;
                }
            }
            if comes(fault.until) && fault.until < scenario.ticks {
                self.end(fault)?;
                if let Some((_, over)) = self.times.get_mut(index) {
                    *over = now;
                }
            }
            if let FaultKind::EncoderBurst(counts) = fault.kind
                && (fault.at..fault.until).contains(&now)
            {
                let ticks = i32::try_from(now - fault.at + 1).unwrap_or(i32::MAX);
                let off = counts.map(|counts| counts.saturating_mul(ticks));
                self.line.inject(now, &Simulate::EncoderOffset(off));
            }
        }
        Ok(())
    }

    fn begin(&mut self, fault: &Fault) -> Result<(), RunError> {
        match fault.kind {
            FaultKind::HostKilled { .. } => {
                self.host = Box::new(Silence);
                self.line.cut(Way::Down, self.now);
            }
            FaultKind::ConsoleReset => {
                self.peer.reset()?;
                self.watch.reset();
                self.line.cut(Way::Up, self.now);
            }
            FaultKind::EmergencyStop => self.line.inject(self.now, &Simulate::EmergencyStop(true)),
            FaultKind::EncoderJump(counts) => {
                self.line.inject(self.now, &Simulate::EncoderOffset(counts));
            }
            FaultKind::SecondHost {
                every,
                wrong_schema,
            } => self.stranger = Some(Stranger::new(every, wrong_schema, self.now)),
            FaultKind::EncoderBurst(_)
            | FaultKind::Line(..)
            | FaultKind::Tamper(_)
            | FaultKind::Replay(_)
            | FaultKind::Flood(..) => {}
        }
        Ok(())
    }

    fn end(&mut self, fault: &Fault) -> Result<(), RunError> {
        match fault.kind {
            FaultKind::HostKilled { back: Some(arms) } => {
                self.generation += 1;
                self.host = (self.hosts)(self.scenario, self.generation, arms)?;
                self.heard.clear();
            }
            FaultKind::EmergencyStop => self.line.inject(self.now, &Simulate::EmergencyStop(false)),
            FaultKind::EncoderJump(_) => {
                self.line.inject(self.now, &Simulate::EncoderOffset([0; 3]));
            }
            FaultKind::SecondHost { .. } => self.stranger = None,
            _ => {}
        }
        Ok(())
    }

    /// Both ways once.
    fn exchange(&mut self) -> Result<(), RunError> {
        let mut said = Vec::new();
        self.host.step(self.now, &self.heard, &mut said)?;
        self.heard.clear();
        self.line.carry(Way::Down, self.now, &said);
        self.line.deliver(Way::Down, self.now, &mut self.down);
        if let Some(stranger) = &mut self.stranger {
            stranger.speak(self.now, &mut self.down);
        }
        self.up.clear();
        let ticks = self.peer.exchange(&self.down, &mut self.up)?;
        self.down.clear();
        self.now += ticks;
        self.watch.hear(self.now, &self.up);
        if let Some(stranger) = &mut self.stranger {
            stranger.hear(&self.up);
        }
        self.line.carry(Way::Up, self.now, &self.up);
        self.line.deliver(Way::Up, self.now, &mut self.heard);
        self.line.disturb(self.now, ticks, &mut self.down);
        Ok(())
    }

    /// What the console has counted comes with the answer to a `Hello`: of a host that does nothing else, once nobody
    /// owns the console any more.
    fn ask_for_counters(&mut self) -> Result<(), RunError> {
        self.host = Box::new(Silence);
        self.stranger = None;
        self.line = Line::new(&[], 0);
        self.down.clear();
        let quiet = self.now + OWNED;
        while self.now < quiet {
            self.exchange()?;
        }
        let opened = self.watch.opened.len();
        let mut link = HostLink::new(TICK_HZ);
        let mut frame = [0; MAX_FRAME];
        let length = link.hello(u32::MAX, &mut frame).unwrap_or_default();
        self.down.push(0);
        self.down.extend(frame.iter().take(length));
        while self.now < quiet + ANSWERS && self.watch.opened.len() == opened {
            self.exchange()?;
        }
        self.watch.opened.truncate(opened);
        Ok(())
    }
}

/// A host that wants a console that is somebody else's, and pushes once it has it.
struct Stranger {
    every: Ticks,
    next: Ticks,
    schema_hash: u64,
    nonce: u32,
    /// Its session and the number of its last frame.
    session: Option<(u32, u32)>,
    accumulator: Accumulator,
    newest_us: u64,
}

impl Stranger {
    fn new(every: Ticks, wrong_schema: bool, now: Ticks) -> Self {
        Stranger {
            every,
            next: now,
            schema_hash: SCHEMA_HASH ^ u64::from(wrong_schema),
            nonce: 0x5700_0000,
            session: None,
            accumulator: Accumulator::new(),
            newest_us: 0,
        }
    }

    fn hear(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // Its own end of the link would not open a session with another schema: it reads the frames by itself.
            let Some(Ok(packet)) = self.accumulator.push(*byte) else {
                continue;
            };
            match decode(packet).and_then(|decoded| decoded.unpack()) {
                Ok(Unchecked::Hello(_, hello))
                    if hello.nonce == self.nonce && hello.session != 0 =>
                {
                    self.session = Some((hello.session, 0));
                }
                Ok(Unchecked::State(header, _)) => self.newest_us = header.console_time_us,
                _ => {}
            }
        }
    }

    fn speak(&mut self, now: Ticks, down: &mut Vec<u8>) {
        if now < self.next {
            return;
        }
        self.next = now + self.every;
        let mut frame = [0; MAX_FRAME];
        match &mut self.session {
            None => {
                self.nonce += 1;
                let hello = Hello {
                    schema_hash: self.schema_hash,
                    nonce: self.nonce,
                    session: 0,
                    tick_hz: TICK_HZ,
                    max_frame: MAX_FRAME as u16,
                    simulated: false,
                    device_name: [0; 16],
                    refusal: Refusal::None,
                };
                let length = encode(0, 0, 0, &hello, &mut frame);
                down.extend(frame.iter().take(length.unwrap_or_default()));
            }
            Some((session, sequence)) => {
                let push = Contact {
                    tool: 0,
                    position_m: [0.0; 3],
                    orientation: [0.0, 0.0, 0.0, 1.0],
                    wrench: [0.0, 0.0, 5.0, 0.0, 0.0, 0.0],
                    tangent: [0.0; 21],
                    gap_m: 0.0,
                    normal: [0.0, 0.0, 1.0],
                    relaxation_per_s: 0.0,
                    horizon_us: 150_000,
                };
                let length = encode(*session, *sequence + 1, 0, &Command::Arm, &mut frame);
                down.extend(frame.iter().take(length.unwrap_or_default()));
                let length = encode(*session, *sequence + 2, self.newest_us, &push, &mut frame);
                down.extend(frame.iter().take(length.unwrap_or_default()));
                *sequence += 2;
            }
        }
    }
}
