//! Why an image was not written, and what to do about it.

use crate::target::{BOARDS, Chip, Target};
use miette::Diagnostic;
use std::path::PathBuf;

/// How a board gets into the loader in its ROM by hand.
pub const BOOT_PINS: &str = "\
by hand: 1. the motors' supply off; 2. BOOT0 to 3.3 V (H405: its jumper B0; NUCLEO-F446ZE: CN11, pin 7 to pin 5); 3. the console's USB connector in \
(the NUCLEO's probe, too: it gives the clock), and press reset; 4. `sutura flash IMAGE` again; 5. BOOT0 back to ground, and reset. The wiring page has a picture";

fn boards() -> String {
    BOARDS.map(|board| board.name).join(", ")
}

/// Why an image was not written.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum FlashError {
    /// The file cannot be read.
    #[error("cannot read the image `{}`: {source}", path.display())]
    #[diagnostic(help(
        "`cargo xtask firmware --board NAME` builds one; NAME is one of {}",
        boards()
    ))]
    NoImage {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is none.
    #[error("`{}` is no firmware image: {why}", path.display())]
    #[diagnostic(help(
        "give the ELF of `cargo xtask firmware`, or a .bin or .hex made of it, which begins at 0x08000000"
    ))]
    NotAnImage {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The image has no identification block.
    #[error("`{}` does not say what it is: no identification block in its first 1024 bytes", path.display())]
    #[diagnostic(help(
        "build it again with `cargo xtask firmware`; to write it all the same: --board NAME --force, with NAME one of {}",
        boards()
    ))]
    Unidentified {
        /// The file.
        path: PathBuf,
    },
    /// Nobody knows this board.
    #[error("no board is named `{name}`")]
    #[diagnostic(help("boards with a flash that can be written: {}", boards()))]
    UnknownBoard {
        /// The name.
        name: String,
    },
    /// The image is for another board than the one that was named.
    #[error("the image is for `{image}`, and --board says `{board}`")]
    #[diagnostic(help("build the other one: `cargo xtask firmware --board {board}`"))]
    OtherBoard {
        /// The image's.
        image: String,
        /// What was asked for.
        board: String,
    },
    /// The image is one that no console may have.
    #[error("the image is `{image}` for {board}, which no board may have")]
    #[diagnostic(help(
        "boards take the images `console` and `selftest`: `cargo xtask firmware --board {board}` makes both"
    ))]
    NotForBoards {
        /// What it says it is.
        image: String,
        /// Its board.
        board: String,
    },
    /// The image is larger than the flash.
    #[error("the image has {bytes} bytes, and {}'s flash {}", board.name, board.flash_bytes)]
    #[diagnostic(help("look at `cargo xtask firmware` for what it is made of"))]
    TooLarge {
        /// The image's length.
        bytes: usize,
        /// The board.
        board: Target,
    },
    /// The chip is another board's.
    #[error("the board has another chip than {}'s: {found}, not {}", board.name, match found {
        Chip::Id(_) => Chip::Id(board.device_id),
        Chip::Flash(_) => Chip::Flash(board.flash_bytes),
    })]
    #[diagnostic(help(
        "nothing was written. Plug the right board in, or build for this one: `cargo xtask firmware --board NAME`"
    ))]
    WrongChip {
        /// What was found.
        found: Chip,
        /// Whose image it is.
        board: Target,
    },
    /// The board has the image of another board.
    #[error("the board has an image for `{found}`, and this one is for `{board}`")]
    #[diagnostic(help("nothing was written. If the board is a {board} all the same: --force"))]
    WrongBoard {
        /// What the image there says.
        found: String,
        /// The new image's board.
        board: String,
    },
    /// The board has somebody else's image.
    #[error("the board has a program that is not one of Sutura's")]
    #[diagnostic(help(
        "nothing was written, and it would be lost: keep it (`dfu-util -a 0 -s 0x08000000 -U old.bin`), then --force. A board whose supply went in the last moment of writing looks the same"
    ))]
    Foreign,
    /// What was written is not what is there.
    #[error(
        "written, and read back otherwise: at {address:#010x} there is {is:#04x}, not {should:#04x}"
    )]
    #[diagnostic(help(
        "the board will not start: its vector table was erased again. Write once more; the same again is a worn or protected flash"
    ))]
    Mismatch {
        /// First address.
        address: u32,
        /// What is there.
        is: u8,
        /// What belongs there.
        should: u8,
    },
    /// The program is not there.
    #[error("`{program}` is not there, which writes {what}")]
    #[diagnostic(help("{install}"))]
    NoProgram {
        /// Its name.
        program: &'static str,
        /// What it is for.
        what: &'static str,
        /// How to get it.
        install: &'static str,
    },
    /// The program failed.
    #[error("`{command}` failed: {said}")]
    #[diagnostic(help(
        "what it did not finish is harmless: a board whose first sector is empty does not start. Write once more; {BOOT_PINS}"
    ))]
    Program {
        /// As it was called.
        command: String,
        /// The last that it said.
        said: String,
    },
    /// A file for a program could not be made.
    #[error("no file for `{program}`: {source}")]
    #[diagnostic(help("is the folder for temporary files full, or not writable?"))]
    File {
        /// The program.
        program: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// No board is in its ROM's loader.
    #[error("no board is in the loader of its ROM")]
    #[diagnostic(help("{BOOT_PINS}"))]
    NoLoader,
    /// A board is in its ROM's loader, and the system keeps this user from it.
    #[error("a board is in the loader of its ROM, and may not be opened: {said}")]
    #[diagnostic(help(
        "on Linux: `SUBSYSTEM==\"usb\", ATTRS{{idVendor}}==\"0483\", ATTRS{{idProduct}}==\"df11\", TAG+=\"uaccess\"` in /etc/udev/rules.d/60-sutura-loader.rules, then plug it in again; \
on Windows: its driver is WinUSB, by Zadig"
    ))]
    NoAccess {
        /// What the program said.
        said: String,
    },
    /// Several could be meant.
    #[error("several are there: {}", found.join(", "))]
    #[diagnostic(help("say which: --device {}", found.first().map_or("", String::as_str)))]
    Several {
        /// What --device takes.
        found: Vec<String>,
    },
    /// The one that was named is not there.
    #[error("`{device}` is not there; there {}", if found.is_empty() { "is none".to_owned() } else { format!("are: {}", found.join(", ")) })]
    #[diagnostic(help(
        "plug it in; a loader's number is not the console's: `dfu-util -l` shows it"
    ))]
    NotThere {
        /// What was asked for.
        device: String,
        /// What --device takes.
        found: Vec<String>,
    },
    /// No probe is there.
    #[error("no probe is there that `probe-rs` knows")]
    #[diagnostic(help(
        "plug one in (the NUCLEO's is its upper USB connector), and see `probe-rs list`; without one: {BOOT_PINS}"
    ))]
    NoProbe,
}
