//! A firmware image: the bytes of the flash from its first address on.
//!
//! Entry point: [`Image::read`].

use crate::FlashError;
use crate::target::FLASH_START;
use ihex::Record;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use object::{Endianness, elf};
use std::path::Path;
use sutura_files::read_plain;
use sutura_shared::identification::{self, Identification};

/// Most that an image may have, whatever the board \[bytes\]: no STM32F4 has more flash.
const MOST: usize = 2 * 1024 * 1024;

/// Largest file of an image \[bytes\]: an ELF file has what a debugger needs besides.
pub(crate) const MOST_FILE: u64 = 256 << 20;

/// A firmware image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// The flash from its first address on.
    pub bytes: Vec<u8>,
    /// What it says of itself.
    pub identification: Option<Identification>,
}

impl Image {
    /// Reads an ELF file for 32-bit Arm, an Intel HEX file (`.hex`, `.ihex`), or the bare bytes (`.bin`).
    ///
    /// # Errors
    /// [`FlashError::NoImage`], [`FlashError::NotAnImage`].
    pub fn read(path: &Path) -> Result<Image, FlashError> {
        let file = read_plain(path, MOST_FILE).map_err(|source| FlashError::NoImage {
            path: path.to_owned(),
            source,
        })?;
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let parsed = if file.starts_with(&elf::ELFMAG) {
            of_elf(&file)
        } else if extension == "hex" || extension == "ihex" {
            of_hex(&file)
        } else if extension == "bin" {
            Ok(file)
        } else {
            Err("neither an ELF file, nor named .bin or .hex".to_owned())
        };
        let checked = parsed.and_then(|bytes| starts(&bytes).map(|()| bytes));
        let bytes = checked.map_err(|why| FlashError::NotAnImage {
            path: path.to_owned(),
            why,
        })?;
        Ok(Image {
            identification: Identification::find(&bytes[..bytes.len().min(identification::WITHIN)]),
            bytes,
        })
    }
}

/// What the chip looks at: a stack in RAM, and an instruction in this flash (ARMv7-M, B1.5.3).
fn starts(bytes: &[u8]) -> Result<(), String> {
    let word = |at: usize| {
        let word = bytes.get(at..at + 4)?.try_into().ok()?;
        Some(u32::from_le_bytes(word))
    };
    let (Some(stack), Some(reset)) = (word(0), word(4)) else {
        return Err(format!("{} bytes are no vector table", bytes.len()));
    };
    if bytes.len() > MOST {
        return Err(format!("{} bytes are more than any flash has", bytes.len()));
    }
    let end = FLASH_START as usize + bytes.len();
    if stack >> 28 != 0x2
        || reset & 1 == 0
        || !(FLASH_START as usize..end).contains(&(reset as usize))
    {
        return Err(format!(
            "it would begin at {reset:#010x} with its stack at {stack:#010x}, which are not in the flash and RAM of an STM32F4"
        ));
    }
    Ok(())
}

/// Puts pieces together; what lies between them is as erased.
fn joined(pieces: Vec<(u64, Vec<u8>)>) -> Result<Vec<u8>, String> {
    let start = u64::from(FLASH_START);
    let mut bytes = Vec::new();
    for (address, piece) in pieces {
        let end = address.saturating_add(piece.len() as u64);
        if address < start || end > start + MOST as u64 {
            return Err(format!(
                "{} bytes of it belong at {address:#010x}, outside the flash",
                piece.len()
            ));
        }
        let (from, to) = ((address - start) as usize, (end - start) as usize);
        if bytes.len() < to {
            bytes.resize(to, 0xFF);
        }
        bytes[from..to].copy_from_slice(&piece);
    }
    Ok(bytes)
}

/// What a loader would put into the flash: of every segment what the file has, at its physical address.
fn of_elf(file: &[u8]) -> Result<Vec<u8>, String> {
    let broken = |error: object::Error| format!("its ELF is broken: {error}");
    let header = FileHeader32::<Endianness>::parse(file).map_err(broken)?;
    let endian = header.endian().map_err(broken)?;
    if header.e_machine(endian) != elf::EM_ARM {
        return Err("its ELF is for another processor than Arm".to_owned());
    }
    let mut pieces = Vec::new();
    for segment in header.program_headers(endian, file).map_err(broken)? {
        if segment.p_type(endian) == PT_LOAD && segment.p_filesz(endian) > 0 {
            let bytes = segment.data(endian, file);
            let bytes = bytes.map_err(|()| "its ELF ends in the middle of a segment".to_owned())?;
            pieces.push((u64::from(segment.p_paddr(endian)), bytes.to_vec()));
        }
    }
    joined(pieces)
}

fn of_hex(file: &[u8]) -> Result<Vec<u8>, String> {
    let text = std::str::from_utf8(file).map_err(|_| "its Intel HEX is no text".to_owned())?;
    let (mut base, mut pieces) = (0, Vec::new());
    for (record, line) in ihex::Reader::new(text).zip(1..) {
        match record.map_err(|error| format!("its Intel HEX is broken in line {line}: {error}"))? {
            Record::Data { offset, value } => pieces.push((base + u64::from(offset), value)),
            Record::ExtendedLinearAddress(high) => base = u64::from(high) << 16,
            Record::ExtendedSegmentAddress(paragraph) => base = u64::from(paragraph) << 4,
            Record::EndOfFile => return joined(pieces),
            Record::StartLinearAddress(_) | Record::StartSegmentAddress { .. } => {}
        }
    }
    Err("its Intel HEX has no end".to_owned())
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::target::FIRST_SECTOR;
    use std::path::PathBuf;

    /// The bytes of an image that says what it is.
    pub fn bytes(board: &str, length: usize) -> Vec<u8> {
        let mut bytes: Vec<u8> = (0..length).map(|at| (at % 251) as u8).collect();
        // As ours are: the vector table alone in the first sector.
        bytes[0x400..length.min(FIRST_SECTOR)].fill(0xFF);
        bytes[..4].copy_from_slice(&0x2001_0000_u32.to_le_bytes());
        bytes[4..8].copy_from_slice(&(FLASH_START + 0x201).to_le_bytes());
        let own = Identification::new(board, "console", "0.1.0").to_bytes();
        bytes[0x188..0x188 + own.len()].copy_from_slice(&own);
        bytes
    }

    fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    fn why(name: &str, bytes: &[u8]) -> String {
        let (_folder, path) = file(name, bytes);
        let error = Image::read(&path).unwrap_err();
        assert!(matches!(error, FlashError::NotAnImage { .. }), "{error}");
        error.to_string()
    }

    fn hex(bytes: &[u8], start: u32) -> String {
        let mut records = Vec::new();
        for (at, piece) in (start..).step_by(16).zip(bytes.chunks(16)) {
            records.push(Record::ExtendedLinearAddress((at >> 16) as u16));
            let (offset, value) = (at as u16, piece.to_vec());
            records.push(Record::Data { offset, value });
        }
        records.push(Record::EndOfFile);
        ihex::create_object_file_representation(&records).unwrap()
    }

    /// An ELF of two segments with a hole of four bytes; the second one lies in RAM and is loaded behind the first one.
    fn elf(bytes: &[u8]) -> Vec<u8> {
        let (first, second) = bytes.split_at(1024);
        let second = &second[4..];
        let mut file = vec![0x7F, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let half = |file: &mut Vec<u8>, value: u16| file.extend(value.to_le_bytes());
        let word = |file: &mut Vec<u8>, value: u32| file.extend(value.to_le_bytes());
        half(&mut file, 2);
        half(&mut file, 40);
        for value in [1, FLASH_START + 0x201, 52, 0, 0] {
            word(&mut file, value);
        }
        for value in [52, 32, 2, 0, 0, 0] {
            half(&mut file, value);
        }
        let data = 52 + 2 * 32;
        let split = data + first.len() as u32;
        for (at, place, load, piece) in [
            (data, FLASH_START, FLASH_START, first),
            (split, 0x2001_0000, FLASH_START + 1028, second),
        ] {
            let length = piece.len() as u32;
            for value in [1, at, place, load, length, length + 64, 5, 4] {
                word(&mut file, value);
            }
        }
        file.extend_from_slice(first);
        file.extend_from_slice(second);
        file
    }

    #[test]
    fn elf_hex_and_bin_of_an_image_are_the_same_image() {
        let mut bytes = bytes("olimex-h405", 3001);
        bytes[1024..1028].fill(0xFF);
        let own = Identification::new("olimex-h405", "console", "0.1.0");
        for (name, file_bytes) in [
            ("sutura-olimex-h405", elf(&bytes)),
            ("image.BIN", bytes.clone()),
            ("image.hex", hex(&bytes, FLASH_START).into_bytes()),
        ] {
            let (_folder, path) = file(name, &file_bytes);
            let image = Image::read(&path).unwrap();
            assert!(image.bytes == bytes, "{name}");
            assert_eq!(image.identification, Some(own), "{name}");
        }
    }

    #[test]
    fn what_is_no_image_is_refused_with_the_reason() {
        let good = bytes("olimex-h405", 2048);
        assert!(why("notes.txt", b"hello").contains("neither an ELF"));
        assert!(why("short.bin", &[0; 7]).contains("7 bytes are no vector table"));
        assert!(why("zeros.bin", &[0; 2048]).contains("would begin at 0x00000000"));
        let mut even = good.clone();
        even[4] &= !1;
        assert!(why("arm.bin", &even).contains("would begin at 0x08000200"));
        assert!(why("huge.bin", &vec![0; MOST + 1]).contains("more than any flash"));
        let low = hex(&good, 0x0010_0000);
        assert!(why("low.hex", low.as_bytes()).contains("belong at 0x00100000, outside"));
        let whole = hex(&good, FLASH_START);
        let cut = whole.lines().take(9).collect::<Vec<_>>().join("\n");
        assert!(why("cut.hex", cut.as_bytes()).contains("has no end"));
        let garbled = whole.replacen("00", "01", 1);
        assert!(why("garbled.hex", garbled.as_bytes()).contains("broken in line 1"));
        let mut other = elf(&good);
        other[18] = 62;
        assert!(why("x86", &other).contains("another processor"));
        let mut cut = elf(&good);
        cut.truncate(1500);
        assert!(why("cut", &cut).contains("ends in the middle"));
    }

    #[test]
    fn an_image_without_a_block_is_read_and_says_nothing() {
        let mut bytes = bytes("olimex-h405", 2048);
        bytes[0x190] ^= 1;
        let (_folder, path) = file("image.bin", &bytes);
        assert_eq!(Image::read(&path).unwrap().identification, None);
        let missing = Image::read(Path::new("not-there.bin")).unwrap_err();
        assert!(
            missing
                .to_string()
                .contains("cannot read the image `not-there.bin`")
        );
    }
}
