//! The boards with motors whose images can be run.
//!
//! Entry point: [`Board`]. They are those of the features of `firmware/Cargo.toml` that have `motors`; a test compares.

/// A board: its name, which its image and its device have, too, and the chip on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    name: &'static str,
    model: Model,
}

/// A chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Model {
    Stm32F405,
    /// Another USB core, and no random numbers.
    Stm32F446,
}

impl Board {
    /// Olimex STM32-H405.
    pub const OLIMEX_H405: Board = Board::new("olimex-h405", Model::Stm32F405);
    /// ST NUCLEO-F446ZE.
    pub const NUCLEO_F446ZE: Board = Board::new("nucleo-f446ze", Model::Stm32F446);

    /// All of them.
    pub const ALL: [Board; 2] = [Board::NUCLEO_F446ZE, Board::OLIMEX_H405];

    const fn new(name: &'static str, model: Model) -> Board {
        Board { name, model }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// What the USB core says it is (RM0090, 34.16.2, and RM0390, 31.15: OTG_CID).
    pub(super) fn usb_core(self) -> u32 {
        match self.model {
            Model::Stm32F405 => 0x1200,
            Model::Stm32F446 => 0x2000,
        }
    }

    /// Levels of the port that has the amplifiers' enable line: PA8, PE9.
    pub(super) fn enable_port(self) -> u32 {
        match self.model {
            Model::Stm32F405 => 0x4002_0010,
            Model::Stm32F446 => 0x4002_1010,
        }
    }

    /// Whether there is a random generator.
    pub fn draws(self) -> bool {
        self.model == Model::Stm32F405
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line is `NAME = ["motors", "stm32f4xx-hal/CHIP"]`.
    #[test]
    fn every_board_with_motors_can_be_run() {
        let manifest = include_str!("../../../firmware/Cargo.toml");
        let features = manifest
            .lines()
            .filter_map(|line| line.split_once(" = [\"motors\", \"stm32f4xx-hal/"));
        let built: Vec<_> = features
            .map(|(name, rest)| (name, rest.trim_end_matches("\"]").to_owned()))
            .collect();
        let chip = |board: Board| format!("{:?}", board.model).to_lowercase();
        let run = Board::ALL.map(|board| (board.name, chip(board)));
        assert_eq!(built, run);
        // Whoever writes one knows it by its name and its chip's, and a session by its device.
        let mut written = sutura_board::BOARDS.map(|target| {
            let letters = "stm32f405".len();
            (target.name, target.chip[..letters].to_lowercase())
        });
        written.sort_unstable();
        assert_eq!(written, run);
        for (name, _) in run {
            let device = format!("{}/../devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            assert!(std::path::Path::new(&device).exists(), "{device}");
        }
    }
}
