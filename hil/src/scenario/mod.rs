//! Scenarios: a host, a console, what goes wrong between them, and what must hold all the same.
//!
//! Entry points: [`Scenario::load`], [`run`](run::run) on a [`Peer`](peer::Peer), [`Outcome::checks`](run::Outcome).
//! Everything that goes wrong is a function of the tick, of the bytes and of the scenario's seed.

mod file;
pub mod host;
pub mod judge;
mod line;
pub mod peer;
#[cfg(unix)]
pub mod processes;
mod read;
mod read_fault;
pub mod run;
pub mod suite;
mod tamper;
mod watch;
mod world;

pub use read::{SCENARIOS, built_in};

use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::{Command, HandScript, Mode};

/// Control ticks; one is a millisecond.
pub type Ticks = u64;

/// A checked scenario.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The file's stem.
    pub name: String,
    /// What it shows, in a line.
    pub about: String,
    /// How long it lasts.
    pub ticks: Ticks,
    /// Of everything random in it.
    pub seed: u64,
    /// What a simulated console is told to be.
    pub device: DeviceDescription,
    /// Kinds of consoles that it is for.
    pub consoles: Vec<ConsoleKind>,
    /// The host.
    pub host: HostSpec,
    /// What the hand on a simulated console does; without one the grip stays where it is.
    pub hand: Option<HandScript>,
    /// What the host is made to say besides, by time.
    pub orders: Vec<(Ticks, Command)>,
    /// What goes wrong, by time.
    pub faults: Vec<Fault>,
    /// What must hold.
    pub expect: Expect,
    /// What is switched off in the mutant, by name; empty: there is none.
    pub mutant: Vec<String>,
}

impl Scenario {
    /// Why it cannot run on a console with motors; none if it can.
    pub fn needs_simulation(&self) -> Option<&'static str> {
        let simulated = |fault: &Fault| {
            matches!(
                fault.kind,
                FaultKind::EmergencyStop
                    | FaultKind::EncoderJump(_)
                    | FaultKind::EncoderBurst(_)
                    | FaultKind::ConsoleReset
            )
        };
        if self.hand.is_some() || self.host.world.is_tissue() {
            Some("its hand is scripted")
        } else if self.faults.iter().any(simulated) {
            Some("its fault is simulated")
        } else {
            None
        }
    }
}

/// Which console a scenario runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConsoleKind {
    /// The simulation in this process, in lockstep.
    Native,
    /// The firmware image under QEMU, in lockstep.
    Qemu,
    /// A console in a process of its own behind a pseudo-terminal, by the wall clock.
    Virtual,
    /// At a port, by the wall clock.
    Port,
}

impl ConsoleKind {
    /// As it is written.
    pub const NAMES: [(&str, ConsoleKind); 4] = [
        ("native", ConsoleKind::Native),
        ("qemu", ConsoleKind::Qemu),
        ("virtual", ConsoleKind::Virtual),
        ("port", ConsoleKind::Port),
    ];

    /// As it is written.
    pub fn word(self) -> &'static str {
        let found = Self::NAMES.into_iter().find(|(_, kind)| *kind == self);
        found.map_or("", |(word, _)| word)
    }
}

/// The host of a scenario.
#[derive(Clone, Debug)]
pub struct HostSpec {
    /// What it solves.
    pub world: World,
    /// Solves a second \[Hz\].
    pub hz: f64,
    /// From the state to its contact on the line.
    pub delay: Ticks,
    /// A fixed horizon \[us\]; otherwise as the product chooses it.
    pub horizon_us: Option<u32>,
    /// Whether it arms the console.
    pub arms: bool,
    /// Whether it is a process of its own where the console is one, too: `sutura run` with the scene.
    pub process: bool,
}

/// What a host solves.
#[derive(Clone, Debug)]
pub enum World {
    /// No host at all.
    Nobody,
    /// The same force everywhere \[N\], up.
    Push(f64),
    /// Springs under the plane z = 0 \[N/m\].
    Wall(f64),
    /// Springs around a ball at the origin: stiffness \[N/m\], radius \[m\].
    Ball(f64, f64),
    /// Tissue of a scene file, by its path.
    Tissue(std::path::PathBuf),
}

impl World {
    /// Whether a scene's tissue is solved.
    pub fn is_tissue(&self) -> bool {
        matches!(self, World::Tissue(_))
    }
}

/// Something that goes wrong.
#[derive(Clone, Debug)]
pub struct Fault {
    /// When it begins.
    pub at: Ticks,
    /// When it is over; the scenario's end if it never is.
    pub until: Ticks,
    /// What.
    pub kind: FaultKind,
    /// What must hold of it.
    pub expect: FaultExpect,
}

impl Fault {
    /// Whether it is there.
    pub fn is_on(&self, now: Ticks) -> bool {
        (self.at..self.until).contains(&now)
    }
}

/// Which way bytes go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// To the console.
    Down,
    /// To the host.
    Up,
}

/// Which ways a fault of the line concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ways {
    /// To the console.
    pub down: bool,
    /// To the host.
    pub up: bool,
}

impl Ways {
    /// Whether this way is one of them.
    pub fn has(self, way: Way) -> bool {
        match way {
            Way::Down => self.down,
            Way::Up => self.up,
        }
    }
}

/// What goes wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum FaultKind {
    /// On the line.
    Line(Ways, LineFault),
    /// In what the host says.
    Tamper(Tamper),
    /// All frames of earlier sessions, so many a millisecond.
    Replay(f64),
    /// The line full of something.
    Flood(FloodWith, usize),
    /// Another host that wants the console.
    SecondHost {
        /// Time between two attempts.
        every: Ticks,
        /// Whether its messages have another layout.
        wrong_schema: bool,
    },
    /// Not another byte from the host; a new one after a while, if at all.
    HostKilled {
        /// Whether the new one arms; none: no new one comes.
        back: Option<bool>,
    },
    /// A console that starts anew.
    ConsoleReset,
    /// Pressed.
    EmergencyStop,
    /// So many counts more on every encoder.
    EncoderJump([i32; 3]),
    /// So many counts more on every encoder in every tick; they stay.
    EncoderBurst([i32; 3]),
}

/// What a line does to frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineFault {
    /// This share does not come.
    Loss(f64),
    /// None comes for the first of these times, every second of them.
    Bursts(Ticks, Ticks),
    /// This share comes again, so much later.
    Duplicates(f64, Ticks),
    /// This share comes so much later than its neighbours.
    Reordering(f64, Ticks),
    /// This share has so many bits flipped.
    BitFlips(f64, u32),
    /// This share has no tail.
    Truncation(f64),
    /// All come so much later.
    Delay(Ticks),
    /// All come later by up to this.
    Jitter(Ticks),
    /// None comes until the end, then all.
    Stall,
    /// None comes.
    Pulled,
}

/// What is wrong in frames that are right as such.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tamper {
    /// No more contacts, or the last one again and again.
    Wedged {
        /// The last one again.
        repeats: bool,
    },
    /// Another console time than that of the state \[us\], and what is added to it a second \[us\].
    Clock {
        /// At the beginning \[us\].
        offset_us: f64,
        /// \[us/s\].
        drift_ppm: f64,
    },
    /// This share of contacts has this value.
    Insane {
        /// Which.
        what: Insane,
        /// The value.
        value: f64,
        /// Of all contacts.
        share: f64,
    },
}

/// Values that no host should send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Insane {
    /// Stiffness \[N/m\] along all axes.
    Tangent,
    /// Force \[N\] along z.
    Force,
    /// The same, of the other sign in every second contact.
    Shaking,
    /// \[us\].
    Horizon,
    /// Force that is no number.
    NotFinite,
}

/// What a line is full of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FloodWith {
    /// Random bytes.
    Garbage,
    /// The host's last contact, with right numbers.
    Contacts,
    /// A `Hello` with another nonce each.
    Hellos,
}

/// What must hold of a fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultExpect {
    /// No force from then on until the fault is over \[ticks after it began\].
    pub zero: Option<Ticks>,
    /// Armed, with half of the force from before \[ticks after its end\].
    pub recovers: Option<Ticks>,
    /// A session \[ticks after its end\].
    pub reconnects: Option<Ticks>,
    /// No state any more \[ticks after it began\].
    pub silent: Option<Ticks>,
    /// Never less force while it lasts \[N\].
    pub holds_n: Option<f64>,
}

/// What must hold of a scenario.
#[derive(Clone, Debug, Default)]
pub struct Expect {
    /// Never more force \[N\].
    pub force_n: Option<f64>,
    /// At least so much force at some time \[N\]: without it nothing is shown.
    pub felt_n: Option<f64>,
    /// Largest change of force in a tick \[N\].
    pub step_n: Option<f64>,
    /// Most energy that the hand is given and has not given before \[J\].
    pub given_back_j: Option<f64>,
    /// At the end.
    pub mode: Option<Mode>,
    /// Latched at any time, bits; and no others.
    pub faults: u16,
    /// Frames that the console refuses, least and most.
    pub rejected: Option<[u32; 2]>,
    /// Frames that the console misses, least and most.
    pub lost: Option<[u32; 2]>,
    /// Sessions that are opened, least and most.
    pub sessions: Option<[u32; 2]>,
    /// Sessions that are refused, least and most.
    pub refusals: Option<[u32; 2]>,
}
