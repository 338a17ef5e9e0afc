//! Consoles that a scenario runs on: in lockstep, or by the wall clock behind a port.
//!
//! Entry points: [`Peer::exchange`], [`native`], [`InLockstep`], [`ByTheClock`].

use super::{ConsoleKind, Ticks};
use crate::NativeConsole;
use std::time::{Duration, Instant};
use sutura_host::link::{LinkError, LockstepConsole, Port};
use sutura_host::scene::{BUILT_IN_DEVICES, Document, SceneError, read_device};
use sutura_shared::device::DeviceError;
use sutura_shared::simulated_console::Without;
use sutura_shared::wire::{Accumulator, Unchecked, decode};

/// Why a console is not there.
#[derive(Debug, thiserror::Error)]
pub enum PeerError {
    /// No link to it.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The image does not run.
    #[cfg(unix)]
    #[error(transparent)]
    Qemu(#[from] crate::QemuError),
    /// Its description is unusable.
    #[error("the device is unusable: {0}")]
    Device(#[from] DeviceError),
    /// Its description cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// The system refused something.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// It cannot be reset from here.
    #[error("a console at a port is reset by hand")]
    NoReset,
}

/// A console.
pub trait Peer {
    /// Delivers bytes, lets a tick pass, or as many as the clock says, and appends what the console says. Returns how many.
    ///
    /// # Errors
    /// When it is gone.
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<Ticks, PeerError>;

    /// Lets the console start anew in the same place.
    ///
    /// # Errors
    /// When it does not come back.
    fn reset(&mut self) -> Result<(), PeerError>;

    /// Which it is.
    fn kind(&self) -> ConsoleKind;

    /// Longest time for which this machine let neither console nor bench go on \[ticks\].
    fn held_up(&self) -> Ticks {
        0
    }
}

type Boot<'a> = dyn FnMut(u32) -> Result<Box<dyn LockstepConsole>, PeerError> + 'a;

/// A console in lockstep: time is the count of exchanges.
pub struct InLockstep<'a> {
    console: Box<dyn LockstepConsole>,
    boot: Box<Boot<'a>>,
    boots: u32,
    kind: ConsoleKind,
}

impl<'a> InLockstep<'a> {
    /// `boot` starts the console; it is given how often it has been started, for session numbers that differ.
    ///
    /// # Errors
    /// Whatever `boot` says.
    pub fn new(
        kind: ConsoleKind,
        mut boot: impl FnMut(u32) -> Result<Box<dyn LockstepConsole>, PeerError> + 'a,
    ) -> Result<Self, PeerError> {
        Ok(InLockstep {
            console: boot(0)?,
            boot: Box::new(boot),
            boots: 0,
            kind,
        })
    }
}

impl Peer for InLockstep<'_> {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<Ticks, PeerError> {
        self.console.exchange(down, up)?;
        Ok(1)
    }

    fn reset(&mut self) -> Result<(), PeerError> {
        self.boots += 1;
        self.console = (self.boot)(self.boots)?;
        Ok(())
    }

    fn kind(&self) -> ConsoleKind {
        self.kind
    }
}

/// The shared simulation in this process.
///
/// # Errors
/// None: the device is built in.
pub fn native(without: Without) -> Result<InLockstep<'static>, PeerError> {
    let (name, text) = BUILT_IN_DEVICES[0];
    // As the image, whatever the scenario has: the host says what it is to be.
    let device = read_device(&Document::embedded(name, "".as_ref(), text))?.description;
    InLockstep::new(ConsoleKind::Native, move |seed| {
        Ok(Box::new(NativeConsole::tuned(&device, seed, without)?))
    })
}

/// Longest wait for a state before time goes on without one: ten ticks.
const WAIT: Duration = Duration::from_millis(10);
/// Time without a state after which the wall clock counts \[ticks\].
const QUIET: Ticks = 20;

type Reopen<'a> = dyn FnMut() -> Result<Box<dyn Port>, PeerError> + 'a;

/// A console that runs by itself. Time is its own tick as its states tell it; while it says nothing, the wall clock's.
pub struct ByTheClock<'a> {
    port: Box<dyn Port>,
    reopen: Option<Box<Reopen<'a>>>,
    kind: ConsoleKind,
    accumulator: Accumulator,
    tick: Option<u32>,
    /// When the last state came.
    heard: Instant,
    /// Ticks counted by the wall clock since then.
    ahead: Ticks,
    held_up: Ticks,
}

impl<'a> ByTheClock<'a> {
    /// A console behind `port`; `reopen` resets it and opens its port again, where that can be done.
    pub fn new(kind: ConsoleKind, port: Box<dyn Port>, reopen: Option<Box<Reopen<'a>>>) -> Self {
        ByTheClock {
            port,
            reopen,
            kind,
            accumulator: Accumulator::new(),
            tick: None,
            heard: Instant::now(),
            ahead: 0,
            held_up: 0,
        }
    }

    /// Newest tick of the states among these bytes.
    fn newest(&mut self, bytes: &[u8]) -> Option<u32> {
        let mut newest = None;
        for byte in bytes {
            if let Some(Ok(packet)) = self.accumulator.push(*byte)
                && let Ok(Unchecked::State(_, state)) = decode(packet).and_then(|d| d.unpack())
            {
                newest = Some(state.tick);
            }
        }
        newest
    }

    fn gone(&self, error: std::io::Error) -> PeerError {
        PeerError::System {
            what: format!("the console at {}", self.port.name()),
            source: error,
        }
    }
}

impl Peer for ByTheClock<'_> {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<Ticks, PeerError> {
        let mut left = down;
        let deadline = Instant::now() + WAIT;
        // What a console does not take is gone, as on a wire.
        while !left.is_empty() && Instant::now() < deadline {
            let count = self.port.write(left).map_err(|error| self.gone(error))?;
            left = left.get(count..).unwrap_or_default();
            if count == 0 {
                std::thread::sleep(Duration::from_micros(200));
            }
        }
        let mut chunk = [0; 4096];
        let start = up.len();
        loop {
            let wait = if self.ahead > 0 {
                Duration::from_millis(1)
            } else {
                WAIT
            };
            let count = self
                .port
                .read(&mut chunk, wait)
                .map_err(|error| self.gone(error))?;
            let (said, _) = chunk.split_at(count.min(chunk.len()));
            up.extend_from_slice(said);
            let newest = self.newest(said);
            let passed = |before: Option<u32>, tick: u32| match before {
                // A clock that goes back is a console that has started anew.
                Some(before) if tick >= before => Ticks::from(tick - before),
                _ => 1,
            };
            if let Some(tick) = newest {
                let ticks = passed(self.tick.replace(tick), tick).saturating_sub(self.ahead);
                self.heard = Instant::now();
                self.ahead = 0;
                if ticks > 0 {
                    // States come every tick: many at once have waited.
                    self.held_up = self.held_up.max(ticks);
                    return Ok(ticks);
                }
                continue;
            }
            let quiet = self.heard.elapsed().as_millis() as Ticks;
            if quiet >= QUIET && quiet > self.ahead {
                let ticks = quiet - self.ahead;
                self.ahead = quiet;
                return Ok(ticks);
            }
            if up.len() > start + chunk.len() {
                return Ok(1);
            }
        }
    }

    fn reset(&mut self) -> Result<(), PeerError> {
        let reopen = self.reopen.as_mut().ok_or(PeerError::NoReset)?;
        self.port = reopen()?;
        self.accumulator = Accumulator::new();
        self.tick = None;
        Ok(())
    }

    fn kind(&self) -> ConsoleKind {
        self.kind
    }

    fn held_up(&self) -> Ticks {
        self.held_up
    }
}
