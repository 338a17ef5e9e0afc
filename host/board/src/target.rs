//! The boards with motors, as a program that writes their flash sees them.
//!
//! Entry points: [`BOARDS`], [`Target::named`].

use crate::FlashError;

/// First address of the flash, where the chip starts from (RM0090 and RM0390, memory map).
pub const FLASH_START: u32 = 0x0800_0000;
/// First sector \[bytes\]: the vector table is in it (RM0090, table 5).
pub const FIRST_SECTOR: usize = 16 * 1024;

/// A board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// Its name, which its image has, too.
    pub name: &'static str,
    /// Its chip as `probe-rs` names it.
    pub chip: &'static str,
    /// What that says it is (DBGMCU_IDCODE, bits 11 to 0; RM0090, 38.6.1; RM0390, 32.6.1).
    pub device_id: u32,
    /// Its flash \[bytes\]: all that the loader in ROM tells of the chip.
    pub flash_bytes: usize,
}

/// Boards that images are made for.
pub const BOARDS: [Target; 2] = [
    Target {
        name: "olimex-h405",
        chip: "STM32F405RGTx",
        device_id: 0x413,
        flash_bytes: 1024 * 1024,
    },
    Target {
        name: "nucleo-f446ze",
        chip: "STM32F446ZETx",
        device_id: 0x421,
        flash_bytes: 512 * 1024,
    },
];

impl Target {
    /// The board of a name.
    ///
    /// # Errors
    /// [`FlashError::UnknownBoard`].
    pub fn named(name: &str) -> Result<Target, FlashError> {
        let found = BOARDS.iter().find(|board| board.name == name).copied();
        found.ok_or_else(|| FlashError::UnknownBoard {
            name: name.to_owned(),
        })
    }
}

/// What is known of the chip that is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chip {
    /// What it says it is, to a probe.
    Id(u32),
    /// How large its flash is \[bytes\], by the loader in its ROM.
    Flash(usize),
}

impl Chip {
    /// Whether it can be this board's.
    pub fn is_of(self, board: &Target) -> bool {
        match self {
            Chip::Id(id) => id == board.device_id,
            Chip::Flash(bytes) => bytes == board.flash_bytes,
        }
    }
}

impl std::fmt::Display for Chip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Chip::Id(id) => write!(f, "chip id {id:#x}"),
            Chip::Flash(bytes) => write!(f, "{} KiB of flash", bytes / 1024),
        }
    }
}
