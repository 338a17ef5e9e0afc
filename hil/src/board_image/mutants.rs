//! The image that can go without a guard, and the switch in its RAM that says which.
//!
//! Entry points: [`default_mutants`], [`BoardImage::take_out`]. Guards are named in the sources, `stands("...")`:
//! `sutura_shared::mutant`.

use super::{Board, BoardImage, BoardImageError, provenance};
use crate::qemu::QemuError;
use object::{Object, ObjectSymbol};
use std::path::{Path, PathBuf};
use sutura_shared::mutant::switch;

/// The switch, two words, as the linker knows it.
const SWITCH: &str = "SUTURA_MUTANT";

/// Where `cargo xtask firmware` puts the image of a board that can go without a guard.
pub fn default_mutants(board: Board) -> PathBuf {
    provenance::image(&format!("sutura-mutants-{}", board.name()))
}

impl BoardImage {
    /// Before the first boot: takes a guard out, or with none leaves all in. Resets change nothing about it.
    ///
    /// # Errors
    /// [`BoardImageError::NoSwitch`] for any other image, and others.
    pub fn take_out(&mut self, image: &Path, guard: Option<&str>) -> Result<(), BoardImageError> {
        let address = switch_of(image)?;
        let words = guard.map_or([0; 2], switch);
        for (at, word) in (address..).step_by(4).zip(words) {
            self.processor.connection.put_memory(at, 4, word);
        }
        Ok(())
    }
}

/// Where the switch is.
///
/// # Errors
/// [`BoardImageError::NoSwitch`] if there is none.
pub fn switch_of(image: &Path) -> Result<u32, BoardImageError> {
    let path = image.to_owned();
    let Ok(bytes) = std::fs::read(image) else {
        return Err(QemuError::NoImage { path }.into());
    };
    symbol(&bytes, SWITCH).ok_or(BoardImageError::NoSwitch { path })
}

/// Where an image has what it calls by this name.
pub(super) fn symbol(image: &[u8], name: &str) -> Option<u32> {
    let file = object::File::parse(image).ok()?;
    let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name))?;
    u32::try_from(symbol.address()).ok()
}
