//! How an image gets onto a board: in an order in which a cut supply leaves a board that does not start rather than one that runs half of it.
//!
//! Entry point: [`flash`], over a [`Loader`]. The first sector, with the vector table, is erased first and written last: while it is
//! empty the chip finds no stack and no program (ARMv7-M, B1.5.3), stands still with its pins as after a reset, and can be
//! written again. Our images have nothing else in that sector (`firmware/memory.x`), so that its last write takes milliseconds.

use crate::target::{Chip, FIRST_SECTOR, FLASH_START, Target};
use crate::{FlashError, Image};
use sutura_shared::identification::{self, Identification};

/// What speaks to a chip: it erases, writes and reads the flash. Places are bytes from the flash's first address on.
pub trait Loader {
    /// What is known of the chip.
    ///
    /// # Errors
    /// Those of the program.
    fn chip(&mut self) -> Result<Chip, FlashError>;

    /// Reads the flash.
    ///
    /// # Errors
    /// Those of the program.
    fn read(&mut self, offset: usize, length: usize) -> Result<Vec<u8>, FlashError>;

    /// Erases the sectors that these bytes lie in, and writes them.
    ///
    /// # Errors
    /// Those of the program.
    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), FlashError>;

    /// Lets the image in the flash run.
    ///
    /// # Errors
    /// Those of the program.
    fn start(&mut self) -> Result<(), FlashError>;
}

/// What is to be written, and on what.
#[derive(Clone, Debug)]
pub struct Flash {
    image: Image,
    board: Target,
    force: bool,
}

/// What was there before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replaced {
    /// Nothing that would have started.
    Nothing,
    /// An image of ours.
    Image(Identification),
    /// A program of somebody else.
    Foreign,
}

/// An image has been written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Done {
    /// What was there before.
    pub replaced: Replaced,
    /// Bytes that were written and read back.
    pub bytes: usize,
    /// It runs; else the board wants its reset pressed.
    pub started: bool,
}

impl Flash {
    /// An image for the board that it says it is for, which is `board` if that is named.
    ///
    /// # Errors
    /// [`FlashError::Unidentified`] if it does not say, unless `force` and `board` say it; [`FlashError::OtherBoard`],
    /// [`FlashError::UnknownBoard`], [`FlashError::NotForBoards`], [`FlashError::TooLarge`].
    pub fn new(
        image: Image,
        path: &std::path::Path,
        board: Option<&str>,
        force: bool,
    ) -> Result<Flash, FlashError> {
        let board = match (&image.identification, board) {
            (Some(own), Some(board)) if own.board() != board => {
                return Err(FlashError::OtherBoard {
                    image: own.board().to_owned(),
                    board: board.to_owned(),
                });
            }
            // Images that tests alone run are made for boards, too.
            (Some(own), _) if !["console", "selftest"].contains(&own.image()) => {
                return Err(FlashError::NotForBoards {
                    image: own.image().to_owned(),
                    board: own.board().to_owned(),
                });
            }
            (Some(own), _) => Target::named(own.board())?,
            (None, Some(board)) if force => Target::named(board)?,
            (None, _) => {
                return Err(FlashError::Unidentified {
                    path: path.to_owned(),
                });
            }
        };
        let bytes = image.bytes.len();
        if bytes > board.flash_bytes {
            return Err(FlashError::TooLarge { bytes, board });
        }
        Ok(Flash {
            image,
            board,
            force,
        })
    }

    /// The board that it is for.
    pub fn board(&self) -> &Target {
        &self.board
    }

    /// What the image says of itself.
    pub fn identification(&self) -> Option<&Identification> {
        self.image.identification.as_ref()
    }
}

/// Checks chip and what is on it, writes the image, reads it back, and starts it. `say` is told what is being done.
///
/// # Errors
/// [`FlashError::WrongChip`], [`FlashError::WrongBoard`], [`FlashError::Foreign`] before anything is written; those of the loader, and
/// [`FlashError::Mismatch`], after which the board does not start.
pub fn flash(
    what: &Flash,
    loader: &mut dyn Loader,
    mut say: impl FnMut(&str),
) -> Result<Done, FlashError> {
    say("looking at the board");
    let replaced = check(what, loader)?;
    let bytes = &what.image.bytes;
    let (head, rest) = bytes.split_at(bytes.len().min(FIRST_SECTOR));
    say("erasing the first sector");
    erase_head(loader)?;
    if !rest.is_empty() {
        say("writing");
        loader.write(FIRST_SECTOR, rest)?;
    }
    say("writing the first sector");
    let used = head.iter().rposition(|byte| *byte != 0xFF).unwrap_or(0) + 1;
    loader.write(0, &head[..used])?;
    say("reading back");
    let found = loader.read(0, bytes.len())?;
    // What was not read differs from any byte.
    let differs = |at: &usize| found.get(*at) != bytes.get(*at);
    if let Some(at) = (0..bytes.len()).find(differs) {
        // Whether or not that goes well, too: this board must not start.
        erase_head(loader)?;
        return Err(FlashError::Mismatch {
            address: FLASH_START + at as u32,
            is: found.get(at).copied().unwrap_or_default(),
            should: bytes[at],
        });
    }
    say("starting it");
    Ok(Done {
        replaced,
        bytes: bytes.len(),
        // It is written all the same.
        started: loader.start().is_ok(),
    })
}

/// Leaves the first sector as erased.
fn erase_head(loader: &mut dyn Loader) -> Result<(), FlashError> {
    loader.write(0, &[0xFF; identification::WITHIN])
}

/// Whether this board may be written.
fn check(what: &Flash, loader: &mut dyn Loader) -> Result<Replaced, FlashError> {
    let found = loader.chip()?;
    let board = what.board;
    if !found.is_of(&board) {
        // No force: an image for another chip does not run.
        return Err(FlashError::WrongChip { found, board });
    }
    let head = loader.read(0, identification::WITHIN)?;
    let replaced = if head.iter().take(8).all(|byte| *byte == 0xFF) {
        // No stack, no program: whatever else is there does not start.
        Replaced::Nothing
    } else {
        Identification::find(&head).map_or(Replaced::Foreign, Replaced::Image)
    };
    match replaced {
        _ if what.force => Ok(replaced),
        Replaced::Foreign => Err(FlashError::Foreign),
        Replaced::Image(own) if own.board() != board.name => Err(FlashError::WrongBoard {
            found: own.board().to_owned(),
            board: board.name.to_owned(),
        }),
        _ => Ok(replaced),
    }
}

#[cfg(test)]
mod tests;
