//! One file per board; a cargo feature chooses, and here its module. Boards with motors have what is theirs in that file, and the rest in `stm32f4`. Every board
//! offers the same names:
//!
//! - `start(..)`: clocks, pins, timers; gives [`Plant`], [`Port`], [`Guard`] and what the last boot left,
//! - `Plant`: encoders and flags in, currents out, for the control task,
//! - `Port`: bytes from and to the host, for the link task,
//! - `Guard`: the watchdogs, for the idle task, in `idle(..)`,
//! - `safe_state()`: first on every fault path; `end(crash_record)`: last on it,
//! - `since_tick_us()`: the console's clock between ticks,
//! - `cycles()`, `stack_free()`: what a control tick costs, in the board's unit, and what the stack has left,
//! - `noticed()`: what the control side has noticed and somebody else is to log,
//! - `log(event)`: below control priority only, because a tick has no time for it.

#[cfg(not(any(feature = "motors", feature = "virtual")))]
compile_error!("choose a board: a feature of firmware/Cargo.toml that has `motors`, or virtual");
#[cfg(all(feature = "motors", feature = "virtual"))]
compile_error!("choose one board only");

#[cfg(feature = "motors")]
mod bare;
mod fault;
#[cfg(feature = "motors")]
mod logger;
#[cfg(feature = "mutants")]
mod mutants;
#[cfg(feature = "virtual")]
mod semihosting;
mod stack;
#[cfg(feature = "motors")]
mod stm32f4;
#[cfg(feature = "virtual")]
mod virtual_console;
#[cfg(feature = "nucleo-f446ze")]
#[path = "nucleo_f446ze.rs"]
mod wiring;
#[cfg(feature = "olimex-h405")]
#[path = "olimex_h405.rs"]
mod wiring;

#[cfg(feature = "motors")]
pub use bare::{BULK, BareRig, Bench, Feeder, kept, work};
#[cfg(feature = "motors")]
pub use stm32f4::*;
#[cfg(feature = "virtual")]
pub use virtual_console::*;
#[cfg(feature = "motors")]
use wiring::{CONSOLE, NAME};

/// The console that hangs on this board, as the control loop knows it.
#[cfg(feature = "motors")]
pub const DEVICE: DeviceDescription = {
    assert!(NAME.len() <= CONSOLE.device.name.len());
    if let Err(error) = CONSOLE.check() {
        panic!("{}", error.rule);
    }
    CONSOLE.device
};

/// What the console says of itself.
#[cfg(feature = "motors")]
pub const IDENTITY: Identity = Identity {
    tick_hz: TICK_HZ,
    simulated: false,
    device_name: DEVICE.name,
};

/// What an image says of itself to who writes it to a board: one static in the section `.identification`.
pub const fn identification(image: &str) -> [u8; identification::LENGTH] {
    Identification::new(NAME, image, env!("CARGO_PKG_VERSION")).to_bytes()
}

/// Chip registers, for the RTIC application.
pub use stm32f4xx_hal::pac;

use crate::crash_record::CrashRecord;
#[cfg(feature = "motors")]
use sutura_shared::control::TICK_HZ;
#[cfg(feature = "motors")]
use sutura_shared::device::DeviceDescription;
use sutura_shared::identification::{self, Identification};
#[cfg(feature = "motors")]
use sutura_shared::link::Identity;
#[cfg(any(feature = "virtual", feature = "mutants"))]
use sutura_shared::simulated_console::Without;
use sutura_shared::wire::message::Report;

/// What the last boot left behind.
#[derive(Clone, Copy, Debug)]
pub struct Boot {
    /// As in `Report::reset_cause`.
    pub reset_cause: u8,
    /// Of a fault handler.
    pub crash_record: Option<CrashRecord>,
    /// For session numbers: differs from boot to boot on hardware.
    pub seed: u32,
    /// Guards that are off. Boards with motors have no such thing.
    #[cfg(any(feature = "virtual", feature = "mutants"))]
    pub without: Without,
}

impl Boot {
    /// The part of a report that tells of it.
    pub fn report(&self) -> Report {
        Report {
            reset_cause: self.reset_cause,
            epitaph_kind: self
                .crash_record
                .map_or(0, |crash_record| crash_record.kind as u8),
            epitaph_place: self
                .crash_record
                .map_or(0, |crash_record| crash_record.place),
            ..Report::default()
        }
    }
}

/// Something for the log.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    /// The console is up.
    Started(Boot),
    /// The control mode or the latched faults changed.
    Mode {
        /// As in `State::mode`.
        mode: u8,
        /// As in `State::faults`.
        faults: u16,
    },
    /// Over the last hundred ticks one of the board's clocks gained on the other.
    ClocksApart {
        /// Time by the core's clock over time by the tick timer \[%\].
        percent: u32,
    },
    /// Lines of the log did not fit.
    LogLost {
        /// On the way to a probe, since the start.
        probe: u32,
        /// Over USB, since the start.
        usb: u32,
    },
    /// A host has asked for the ROM's loader, and the console was not at rest.
    LoaderRefused,
}

/// Lets the link task run again, which masks its interrupt when it can go on only after a tick.
pub fn let_link_run() {
    // SAFETY: no critical section is made of this mask; where the task takes a lock, the lock is one of priorities.
    unsafe { cortex_m::peripheral::NVIC::unmask(LINK) };
}

/// Sets the floating-point unit up as the shared code expects it: round to nearest, subnormals kept, NaNs
/// propagated, here and in the context that every interrupt starts with.
pub fn float_environment(fpu: &mut cortex_m::peripheral::FPU) {
    let default = cortex_m::register::fpscr::Fpscr::from_bits(0);
    // SAFETY: both registers hold only modes and flags, here and for new contexts (ARMv7-M, B3.2.23 and
    // A2.5.3); 0 is what IEEE 754 and the compiler take for granted.
    unsafe {
        fpu.fpdscr.write(0);
        cortex_m::register::fpscr::write(default);
    }
}
