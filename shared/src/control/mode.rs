//! What the console may do: orders from the host, latched faults, and the mode that follows.
//!
//! Entry points: [`Orders::command`], [`Faults::latch`], [`next_mode`].

use super::contact::Freshness;
use crate::wire::faults;
use crate::wire::message::{Command, Mode};

/// What the host has asked for since the last tick. Of two orders the later one counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Orders {
    pub clear: bool,
    pub disarm: bool,
    pub arm: bool,
}

impl Orders {
    /// Adds an order.
    pub fn command(&mut self, command: Command) {
        match command {
            Command::Arm => self.arm = true,
            Command::Disarm => (self.disarm, self.arm) = (true, false),
            Command::ClearFault => (self.clear, self.arm) = (true, false),
            // The link's business.
            Command::StateEvery { .. } => {}
        }
    }
}

/// The mode of this tick, from the last tick's.
///
/// `started`: a complete tick has been run; `faults`: latched and not cleared.
pub(super) fn next_mode(
    mode: Mode,
    orders: Orders,
    faults: u16,
    started: bool,
    contact: Freshness,
) -> Mode {
    if faults != 0 {
        return Mode::Fault;
    }
    let mode = match mode {
        Mode::Boot if !started => return Mode::Boot,
        Mode::Boot | Mode::Fault => Mode::Idle,
        _ if orders.disarm => Mode::Idle,
        other => other,
    };
    match (mode, contact) {
        (Mode::Idle, _) if orders.arm => Mode::Armed,
        (Mode::Armed | Mode::Decaying, Freshness::Lost) => Mode::Idle,
        (Mode::Armed | Mode::Decaying, Freshness::Stale) => Mode::Decaying,
        (Mode::Decaying, Freshness::Fresh | Freshness::Missing) => Mode::Armed,
        (other, _) => other,
    }
}

/// Whether the amplifiers are on.
pub(super) fn has_torque(mode: Mode) -> bool {
    matches!(mode, Mode::Armed | Mode::Decaying)
}

/// Faults, from their causes until the host clears them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    latched: u16,
    /// Ticks in a row that took longer than their period.
    overruns: u32,
}

/// So many overruns in a row are a fault: one or two can be a burst on the bus, three are a wrong image.
const MAX_OVERRUNS: u32 = 3;

impl Faults {
    /// Latches the causes of this tick. `clear` first forgets everything that is not present any more.
    pub fn latch(&mut self, causes: u16, overrun: bool, clear: bool) {
        self.overruns = if overrun {
            self.overruns.saturating_add(1)
        } else {
            0
        };
        if clear {
            self.latched = 0;
        }
        self.latched |= causes;
        if self.overruns >= MAX_OVERRUNS {
            self.latched |= faults::OVERRUN;
        }
    }

    /// Latches a fault found later in the same tick.
    pub fn add(&mut self, fault: u16) {
        self.latched |= fault;
    }

    /// Bits of [`faults`].
    pub fn latched(&self) -> u16 {
        self.latched
    }

    /// Ticks in a row that took longer than their period.
    pub fn overruns(&self) -> u32 {
        self.overruns
    }
}
