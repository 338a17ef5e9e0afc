//! Why the image of a board does not run, or no longer. Entry point: [`BoardImageError`].

use crate::qemu::QemuError;
use std::io;
use std::path::PathBuf;

/// Why the image of a board does not run, or no longer, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum BoardImageError {
    /// The emulator.
    #[error(transparent)]
    Qemu(#[from] QemuError),
    /// An emulator whose log says other things of what it lacks.
    #[error(
        "this stand-in for registers reads the log of QEMU 7.2 to 8, and `{program}` is {found}; install one of those \
         (Debian 12: 7.2, Ubuntu 24.04: 8.2), or teach hil/src/board_image what the other one lacks"
    )]
    Version {
        /// The program.
        program: &'static str,
        /// What it says of itself.
        found: String,
    },
    /// The image was not built from these sources, or has been changed since.
    #[error(
        "`{path}` is not what these sources make ({why}); build it again with `cargo xtask firmware --board {board}`"
    )]
    Stale {
        /// The image.
        path: PathBuf,
        /// Its board.
        board: String,
        /// What differs.
        why: String,
    },
    /// An image whose guards all stand.
    #[error(
        "`{path}` has no switch that takes a guard out: only the images `sutura-mutants-BOARD` of `cargo xtask firmware` have one"
    )]
    NoSwitch {
        /// The image.
        path: PathBuf,
    },
    /// An image whose symbols are gone.
    #[error("`{path}` has no symbol `{name}`: it was stripped, or is no console's")]
    NoSymbol {
        /// The image.
        path: PathBuf,
        /// What is looked for.
        name: &'static str,
    },
    /// The line to the emulator's gdb stub.
    #[error("{what}: {source}")]
    Line {
        /// What was tried.
        what: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// The stub does not do as it is told.
    #[error("QEMU's gdb stub answers `{answer}` to `{packet}`")]
    Refused {
        /// What it was told.
        packet: String,
        /// What it said.
        answer: String,
    },
    /// The image uses a register in a way that the stand-in cannot read.
    #[error(
        "the image touches a watched register at {pc:#010x} with the instruction {code:04x?}, which hil/src/board_image/thumb.rs \
         does not know"
    )]
    Instruction {
        /// Where.
        pc: u32,
        /// Its two halfwords.
        code: [u16; 2],
    },
    /// A register was read while nobody watched it, and is not 0.
    #[error(
        "the image has read 0 from {address:#010x}, which is {value:#x}: `Chip::watched` has to name it"
    )]
    Unwatched {
        /// The register.
        address: u32,
        /// What it should have read.
        value: u32,
    },
    /// The image neither comes to rest nor touches a register that would stop it.
    #[error("the image runs in circles at {pc:#010x}; the last registers that it used: {last}")]
    Circles {
        /// Where it was found.
        pc: u32,
        /// What it touched before.
        last: String,
    },
    /// The processor stopped where nothing was to stop it.
    #[error(
        "the processor has stopped unexpectedly ({at}); the last registers that the image used: {last}"
    )]
    Stopped {
        /// How.
        at: String,
        /// What it touched before.
        last: String,
    },
    /// The image resets the chip, or a watchdog does: [`BoardImage::boot_again`](super::BoardImage::boot_again) lets it happen.
    #[error("the image, or a watchdog, has reset the chip")]
    Reset,
    /// The image waits for the crystal for ever, and no watchdog runs.
    #[error("the image waits for the crystal with no watchdog running")]
    Unguarded,
    /// An interrupt that its handler does not serve, and that nobody masks: a chip would do nothing else any more.
    #[error("interrupt {number} comes again and again: its handler neither serves nor masks it")]
    Storm {
        /// Its number.
        number: u8,
    },
    /// What the device does on the USB cable.
    #[error("USB: {0}")]
    Usb(String),
}
