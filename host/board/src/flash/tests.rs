//! A chip whose flash behaves like one: sectors are erased to ones, writing only clears bits, and the supply may go at any byte.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::image::tests::bytes;
use std::path::Path;

const H405: &str = "olimex-h405";
/// Sectors of an STM32F405 \[KiB\] (RM0090, table 5).
const SECTORS: [usize; 12] = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128];

struct Chip405 {
    chip: Chip,
    flash: Vec<u8>,
    /// Bytes, erased or written, until the supply goes.
    left: usize,
    /// A place whose lowest bit cannot be set.
    worn: Option<usize>,
    started: bool,
    starts: bool,
}

impl Chip405 {
    fn new() -> Chip405 {
        Chip405 {
            chip: Chip::Flash(1024 * 1024),
            flash: vec![0xFF; 1024 * 1024],
            left: usize::MAX,
            worn: None,
            started: false,
            starts: true,
        }
    }

    fn with(bytes: &[u8]) -> Chip405 {
        let mut chip = Chip405::new();
        chip.flash[..bytes.len()].copy_from_slice(bytes);
        chip
    }

    fn spend(&mut self) -> Result<(), FlashError> {
        self.left = self.left.checked_sub(1).ok_or_else(cut)?;
        Ok(())
    }

    /// As the chip decides it: a stack and a program.
    fn would_start(&self) -> bool {
        self.flash[..8] != [0xFF; 8]
    }
}

fn cut() -> FlashError {
    FlashError::Program {
        command: "loader".to_owned(),
        said: "the board is gone".to_owned(),
    }
}

impl Loader for Chip405 {
    fn chip(&mut self) -> Result<Chip, FlashError> {
        Ok(self.chip)
    }

    fn read(&mut self, offset: usize, length: usize) -> Result<Vec<u8>, FlashError> {
        Ok(self.flash[offset..offset + length].to_vec())
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), FlashError> {
        let end = offset + bytes.len();
        let mut start = 0;
        for sector in SECTORS.map(|size| size * 1024) {
            if start < end && start + sector > offset {
                for at in start..start + sector {
                    self.spend()?;
                    self.flash[at] = if self.worn == Some(at) { 0xFE } else { 0xFF };
                }
            }
            start += sector;
        }
        for (at, byte) in (offset..).zip(bytes) {
            self.spend()?;
            self.flash[at] &= byte;
        }
        Ok(())
    }

    fn start(&mut self) -> Result<(), FlashError> {
        self.started = self.starts && self.would_start();
        if self.starts { Ok(()) } else { Err(cut()) }
    }
}

fn image(board: &str, length: usize) -> Image {
    let bytes = bytes(board, length);
    Image {
        identification: Identification::find(&bytes),
        bytes,
    }
}

fn order(image: Image, force: bool) -> Flash {
    Flash::new(image, Path::new("image"), None, force).unwrap()
}

fn write(chip: &mut Chip405, board: &str, force: bool) -> Result<Done, FlashError> {
    flash(&order(image(board, 150_001), force), chip, |_| {})
}

#[test]
fn an_image_is_written_read_back_and_started_on_an_empty_board_and_on_its_own() {
    let mut chip = Chip405::new();
    let done = write(&mut chip, H405, false).unwrap();
    assert_eq!(done.replaced, Replaced::Nothing);
    assert!(done.started && chip.started);
    assert!(chip.flash[..150_001] == bytes(H405, 150_001));
    // A smaller one after it, of one sector and of less than that.
    for length in [30_000, 16_384, 2000] {
        let done = flash(&order(image(H405, length), false), &mut chip, |_| {}).unwrap();
        let before = Identification::new(H405, "console", "0.1.0");
        assert_eq!(
            (done.replaced, done.bytes),
            (Replaced::Image(before), length)
        );
        assert!(chip.flash[..length] == bytes(H405, length));
    }
}

/// Cut at places spread over the whole run: what is there does not start, or is whole; and the next run mends it.
#[test]
fn a_cut_supply_leaves_the_old_a_dead_or_the_new_board_and_the_next_run_mends_it() {
    let old = bytes(H405, 140_000);
    let new = bytes(H405, 150_001);
    let mut whole = Chip405::with(&old);
    whole.left = 10_000_000;
    write(&mut whole, H405, false).unwrap();
    let all = 10_000_000 - whole.left;
    let (mut dead, mut lives) = (0, 0);
    let first_and_last = (0..20).chain(all - 20..all);
    for left in (0..all).step_by(997).chain(first_and_last) {
        let mut chip = Chip405::with(&old);
        chip.left = left;
        let error = write(&mut chip, H405, false).unwrap_err();
        assert!(matches!(error, FlashError::Program { .. }), "{error}");
        if chip.would_start() {
            // Before the first sector is gone, or while the last write goes through it: all else is in place by then.
            let is_old = chip.flash[8..old.len()] == old[8..];
            let is_new = chip.flash[FIRST_SECTOR..new.len()] == new[FIRST_SECTOR..];
            assert!(is_old || is_new, "cut after {left} of {all} bytes");
            lives += 1;
        } else {
            dead += 1;
        }
        chip.left = usize::MAX;
        let force = chip.would_start();
        write(&mut chip, H405, force).unwrap();
        assert!(
            chip.flash[..new.len()] == new,
            "cut after {left} of {all} bytes"
        );
    }
    assert!(dead > 100 && lives > 2, "{dead} dead, {lives} alive");
}

#[test]
fn another_chip_is_not_touched_whatever_is_forced() {
    for chip in [Chip::Flash(512 * 1024), Chip::Id(0x421)] {
        let mut there = Chip405::with(&bytes(H405, 5000));
        there.chip = chip;
        let before = there.flash.clone();
        let error = write(&mut there, H405, true).unwrap_err();
        assert!(matches!(error, FlashError::WrongChip { .. }));
        let text = error.to_string();
        assert!(text.contains("another chip than olimex-h405's"), "{text}");
        assert!(
            text.contains("512 KiB") || text.contains("0x421, not chip id 0x413"),
            "{text}"
        );
        assert!(there.flash == before);
    }
}

#[test]
fn another_boards_image_and_a_foreign_one_are_kept_unless_forced() {
    let mut foreign = bytes(H405, 5000);
    foreign[0x190] ^= 0x40;
    for (there, says) in [
        (bytes("nucleo-f446ze", 5000), "an image for `nucleo-f446ze`"),
        (foreign, "not one of Sutura's"),
    ] {
        let mut chip = Chip405::with(&there);
        let before = chip.flash.clone();
        let error = write(&mut chip, H405, false).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
        let help = miette::Diagnostic::help(&error).unwrap().to_string();
        assert!(
            help.contains("nothing was written") && help.contains("--force"),
            "{help}"
        );
        assert!(chip.flash == before && !chip.started);
        write(&mut chip, H405, true).unwrap();
        assert!(chip.flash[..150_001] == bytes(H405, 150_001));
    }
}

#[test]
fn a_byte_that_does_not_stay_is_named_and_the_board_does_not_start() {
    for place in [0x1234, 140_000] {
        let mut chip = Chip405::new();
        // A place whose byte has that bit set.
        let at = (place..)
            .find(|at| at % 251 % 2 == 1 && at % 251 != 255)
            .unwrap();
        chip.worn = Some(at);
        let error = write(&mut chip, H405, false).unwrap_err();
        let FlashError::Mismatch {
            address,
            is,
            should,
        } = error
        else {
            panic!("{error}");
        };
        assert_eq!(address, FLASH_START + at as u32);
        assert_eq!(is, should & 0xFE);
        assert!(!chip.would_start() && !chip.started);
    }
}

#[test]
fn a_board_that_is_written_and_does_not_start_is_not_lost() {
    let mut chip = Chip405::new();
    chip.starts = false;
    let done = write(&mut chip, H405, false).unwrap();
    assert!(!done.started);
}

#[test]
fn images_that_do_not_say_what_they_are_or_are_another_boards_are_refused_before_anything_is_asked()
{
    let new = |image: Image, board: Option<&str>, force: bool| {
        Flash::new(image, Path::new("mine.bin"), board, force)
    };
    let mut bare = image(H405, 5000);
    bare.identification = None;
    for (board, force) in [(None, false), (None, true), (Some(H405), false)] {
        let error = new(bare.clone(), board, force).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("`mine.bin` does not say what it is"),
            "{error}"
        );
    }
    assert_eq!(new(bare, Some(H405), true).unwrap().board().name, H405);
    let error = new(image(H405, 5000), Some("nucleo-f446ze"), true).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the image is for `olimex-h405`, and --board says `nucleo-f446ze`"
    );
    let mut tests_own = image(H405, 5000);
    tests_own.identification = Some(Identification::new(H405, "mutants", "0.1.0"));
    let error = new(tests_own, None, true).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the image is `mutants` for olimex-h405, which no board may have"
    );
    let error = new(image("virtual", 5000), None, true).unwrap_err();
    assert_eq!(error.to_string(), "no board is named `virtual`");
    let error = new(image("nucleo-f446ze", 600_000), None, true).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the image has 600000 bytes, and nucleo-f446ze's flash 524288"
    );
}
