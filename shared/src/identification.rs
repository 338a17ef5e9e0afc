//! What a firmware image says of itself: a block right behind its vector table, in the ELF file and in the bytes that are flashed.
//!
//! Entry points: [`Identification::to_bytes`] in the image, [`Identification::find`] for who looks for it.
//!
//! | bytes | what |
//! |---|---|
//! | 0 to 7 | `SUTURAFW` |
//! | 8 to 11 | edition of this layout, 1, little end first |
//! | 12 to 27 | board, filled up with zeros |
//! | 28 to 43 | which image: `console` or `selftest` |
//! | 44 to 59 | version |
//! | 60 to 63 | CRC-32 (ISO-HDLC) of the rest |

use crc::{CRC_32_ISO_HDLC, Crc};

/// Length of the block \[bytes\].
pub const LENGTH: usize = 64;
/// The block lies within so many bytes from the image's first one: vector tables of this family have up to 113 words.
pub const WITHIN: usize = 1024;

const MARK: [u8; 8] = *b"SUTURAFW";
const EDITION: u8 = 1;
const NAME: usize = 16;
const CRC_32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// What an image is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Identification {
    names: [[u8; NAME]; 3],
}

impl Identification {
    /// Of an image for a board; names are cut off after 16 bytes.
    pub const fn new(board: &str, image: &str, version: &str) -> Identification {
        Identification {
            names: [padded(board), padded(image), padded(version)],
        }
    }

    /// The board that the image is for.
    pub fn board(&self) -> &str {
        text(&self.names[0])
    }

    /// Which of the board's images it is.
    pub fn image(&self) -> &str {
        text(&self.names[1])
    }

    /// Its version.
    pub fn version(&self) -> &str {
        text(&self.names[2])
    }

    /// The block.
    pub const fn to_bytes(&self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        let mut at = 0;
        while at < LENGTH - 4 {
            bytes[at] = match at {
                0..8 => MARK[at],
                8 => EDITION,
                9..12 => 0,
                _ => self.names[(at - 12) / NAME][(at - 12) % NAME],
            };
            at += 1;
        }
        let (content, _) = bytes.split_at(LENGTH - 4);
        let crc = CRC_32.checksum(content).to_le_bytes();
        while at < LENGTH {
            bytes[at] = crc[at + 4 - LENGTH];
            at += 1;
        }
        bytes
    }

    /// The block among the first bytes of an image, if there is one: it begins at a whole word.
    pub fn find(bytes: &[u8]) -> Option<Identification> {
        let mut places = (0..bytes.len()).step_by(4);
        places.find_map(|at| Self::of(bytes.get(at..at + LENGTH)?))
    }

    fn of(block: &[u8]) -> Option<Identification> {
        if !block.starts_with(&MARK) {
            return None;
        }
        let name = |at| block.get(at..at + NAME)?.try_into().ok();
        let found = Identification {
            names: [name(12)?, name(28)?, name(44)?],
        };
        // Also the mark, the edition and the CRC.
        let readable = found
            .names
            .iter()
            .all(|name| core::str::from_utf8(name).is_ok());
        (readable && block == found.to_bytes()).then_some(found)
    }
}

impl core::fmt::Debug for Identification {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} {} for {}",
            self.image(),
            self.version(),
            self.board()
        )
    }
}

const fn padded(name: &str) -> [u8; NAME] {
    let (bytes, mut padded, mut at) = (name.as_bytes(), [0; NAME], 0);
    while at < NAME && at < bytes.len() {
        padded[at] = bytes[at];
        at += 1;
    }
    padded
}

/// A name without what fills it up.
fn text(name: &[u8; NAME]) -> &str {
    let text = core::str::from_utf8(name).unwrap_or_default();
    text.trim_end_matches('\0')
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::vec;

    const OWN: Identification = Identification::new("olimex-h405", "console", "0.1.0");

    #[test]
    fn a_block_is_found_behind_a_vector_table_and_says_what_it_said() {
        for at in [0, 4, 0x188, WITHIN - LENGTH] {
            let mut bytes = vec![0xA5; WITHIN];
            bytes[at..at + LENGTH].copy_from_slice(&OWN.to_bytes());
            let found = Identification::find(&bytes).expect("it is there");
            assert_eq!(
                (found.board(), found.image(), found.version()),
                ("olimex-h405", "console", "0.1.0")
            );
            assert_eq!(format!("{found:?}"), "console 0.1.0 for olimex-h405");
        }
    }

    #[test]
    fn a_block_with_one_wrong_bit_is_none_nor_is_half_of_one() {
        let block = OWN.to_bytes();
        for bit in 0..8 * LENGTH {
            let mut wrong = block;
            wrong[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Identification::find(&wrong), None, "bit {bit}");
        }
        assert_eq!(Identification::find(&block[..LENGTH - 1]), None);
        for nothing in [0x00, 0xFF] {
            assert_eq!(Identification::find(&[nothing; WITHIN]), None);
        }
        assert_eq!(Identification::find(&[]), None);
    }

    /// Of the layout as it stands in every image that has been made: images of other versions are read.
    #[test]
    fn the_layout_is_pinned() {
        let block = Identification::new("b", "i", "v").to_bytes();
        assert_eq!(&block[..13], b"SUTURAFW\x01\0\0\0b");
        assert_eq!((block[28], block[44], block[59]), (b'i', b'v', 0));
        // By Python's `binascii.crc32` over the first 60 bytes.
        assert_eq!(
            u32::from_le_bytes([block[60], block[61], block[62], block[63]]),
            CRC_BIV
        );
    }

    const CRC_BIV: u32 = 0xD494_EBD6;

    #[test]
    fn names_that_are_too_long_are_cut() {
        let own = Identification::new("a-board-with-a-long-name", "", "1");
        assert_eq!((own.board(), own.image()), ("a-board-with-a-l", ""));
    }
}
