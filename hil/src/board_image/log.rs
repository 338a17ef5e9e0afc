//! The console's log, as a host reads it over USB, and as a probe reads it from RAM.
//!
//! Entry points: [`BoardImage::take_log`], [`BoardImage::take_probe_log`].

use super::{BoardImage, BoardImageError, usb_host};

/// Where variables are, and how many words are looked at for the mark of the probe's channels (SEGGER UM08001, 16.4).
const VARIABLES: u32 = 0x2001_0000;
const LOOKED_AT: u32 = 4096;
/// `SEGG`, `ER R`.
const MARK: [u32; 2] = [0x4747_4553, 0x5220_5245];
/// Of the first channel from the mark on \[bytes\]: its buffer, size, and the offsets of what is written and read.
const BUFFER: u32 = 28;
const SIZE: u32 = 32;
const WRITTEN: u32 = 36;
const READ: u32 = 40;

impl BoardImage {
    /// Takes what the console gives of its log over USB.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn take_log(&mut self) -> Result<Vec<u8>, BoardImageError> {
        let mut log = Vec::new();
        while let Some(packet) = self.chip.usb.take(usb_host::LOG_UP) {
            log.extend(packet);
            self.serve()?;
        }
        Ok(log)
    }

    /// Takes what a probe finds of its log in RAM, without the console's doing.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn take_probe_log(&mut self) -> Result<Vec<u8>, BoardImageError> {
        let connection = &mut self.processor.connection;
        let mut place = VARIABLES;
        while [connection.word(place)?, connection.word(place + 4)?] != MARK {
            place += 4;
            if place >= VARIABLES + 4 * LOOKED_AT {
                let what = "no channel for a probe in the image's RAM".to_owned();
                return Err(BoardImageError::Usb(what));
            }
        }
        let [buffer, size, written, read] = [
            connection.word(place + BUFFER)?,
            connection.word(place + SIZE)?,
            connection.word(place + WRITTEN)?,
            connection.word(place + READ)?,
        ];
        let mut log = Vec::new();
        let mut at = read;
        while at != written {
            let word = connection.word(buffer + (at & !3))?;
            log.push(word.to_le_bytes()[at as usize % 4]);
            at = (at + 1) % size;
        }
        connection.put_memory(place + READ, 4, at);
        Ok(log)
    }
}
