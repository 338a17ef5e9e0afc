//! The boards with motors whose images can be run.
//!
//! Entry point: [`Board`].

/// A board, and the chip on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Board {
    /// Olimex STM32-H405: STM32F405.
    OlimexH405,
    /// ST NUCLEO-F446ZE: STM32F446, which has another USB core and no random numbers.
    NucleoF446ze,
}

impl Board {
    /// Its name, which its image and its device have, too.
    pub fn name(self) -> &'static str {
        match self {
            Board::OlimexH405 => "olimex-h405",
            Board::NucleoF446ze => "nucleo-f446ze",
        }
    }

    /// What the USB core says it is (RM0090, 34.16.2, and RM0390, 31.15: OTG_CID).
    pub(super) fn usb_core(self) -> u32 {
        match self {
            Board::OlimexH405 => 0x1200,
            Board::NucleoF446ze => 0x2000,
        }
    }

    /// Whether there is a random generator.
    pub(super) fn draws(self) -> bool {
        self == Board::OlimexH405
    }
}
