//! A touch of the console's serial port, and the start of the loader in the chip's ROM, which is where the image is left alone.
//!
//! Entry points: [`BoardImage::touch`], [`BoardImage::start_loader`].

use super::chip::{LOADER, reset};
use super::connection::PC;
use super::processor::Stop;
use super::{BoardImage, BoardImageError};

/// What the loader finds where it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoaderStart {
    /// Its stack.
    pub stack: u32,
    /// Whether the ROM is mapped to address 0.
    pub mapped: bool,
    /// Whether a watchdog runs.
    pub watched: bool,
}

impl BoardImage {
    /// The host sets the serial port to a line rate, then says that its terminal is gone.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip at once, and others.
    pub fn touch(&mut self, baud: u32) -> Result<(), BoardImageError> {
        self.set_line(baud, true)?;
        self.set_line(baud, false)
    }

    /// After [`BoardImageError::Reset`]: lets the reset happen, by software, and runs until the first instruction of the loader in ROM.
    ///
    /// # Errors
    /// Those of a run that does not come there.
    pub fn start_loader(&mut self) -> Result<LoaderStart, BoardImageError> {
        self.chip().reset(reset::SOFTWARE);
        let feeds = self.chip().feeds;
        self.processor.reset()?;
        self.processor.connection.break_at(LOADER.entry, true)?;
        self.processor.connection.watch_writes(LOADER.map, true)?;
        let mut stop = self.processor.run(&mut self.chip, Some(LOADER.map))?;
        if stop == Stop::Write(LOADER.map) {
            let after = self.processor.access(&mut self.chip)?;
            let after = (PC, after.get(PC).copied().unwrap_or_default());
            self.processor.put_registers(&[after]);
            stop = self.processor.run(&mut self.chip, None)?;
        }
        self.processor.connection.watch_writes(LOADER.map, false)?;
        if stop != Stop::Loader {
            return Err(self.processor.unexpected(stop));
        }
        let registers = self.processor.connection.registers()?;
        Ok(LoaderStart {
            stack: registers[13],
            mapped: self.chip.stored(LOADER.map) & 0b111 == 1,
            watched: self.chip.watchdog_runs || self.chip.feeds != feeds,
        })
    }
}
