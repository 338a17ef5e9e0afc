//! The log of a console: what its image logs (defmt), in words.
//!
//! Entry points: [`LogImage::read`], [`LogImage::lines`]; [`follow`] for one that goes on. [`UsbLog`](crate::UsbLog) is where a console on
//! USB gives it.

use crate::FlashError;
use crate::image::MOST_FILE;
use defmt_decoder::{DecodeError, StreamDecoder, Table};
use std::path::{Path, PathBuf};
use std::time::Duration;
use sutura_files::read_plain;

/// Why there is no log.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum LogError {
    /// The image cannot be read.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Image(#[from] FlashError),
    /// The file has none of what the log's words are in.
    #[error("`{}` has no words for a log: {why}", path.display())]
    #[diagnostic(help(
        "give the ELF file that is on the console, as `cargo xtask firmware` makes it, with --elf; a .bin or .hex has no words"
    ))]
    NoWords {
        /// The file.
        path: PathBuf,
        /// What is missing.
        why: String,
    },
    /// Nothing that comes is a line of it.
    #[error("the console does not log in the words of this image")]
    #[diagnostic(help(
        "name the ELF file that is on it with --elf, or write this one to it: `sutura flash`"
    ))]
    OtherImage,
    /// Nothing of that number is on USB.
    #[error("no console {serial} is on USB")]
    #[diagnostic(help("`sutura device list` shows those that are"))]
    NoConsole {
        /// The number.
        serial: String,
    },
    /// It is there and has no log.
    #[error("the console {serial} has no log on USB")]
    #[diagnostic(help(
        "its image is older than that: write a newer one with `sutura flash`, or read it through a probe, with `probe-rs attach`"
    ))]
    NoLog {
        /// The number.
        serial: String,
    },
    /// It has been pulled out, or reset.
    #[error("the console's log broke off: {source}")]
    #[diagnostic(help(
        "plug it in again; one that resets comes back by itself and says why in its first line"
    ))]
    Gone {
        /// What the system says.
        source: std::io::Error,
    },
    /// The system says no.
    #[error("the console's log cannot be opened: {source}")]
    #[diagnostic(help(
        "only one program may read it. On Linux this user needs write access to the USB device: a udev rule with ATTRS{{idVendor}}==\"16c0\", ATTRS{{idProduct}}==\"27dd\", TAG+=\"uaccess\". \
On Windows the interface needs the driver WinUSB (by Zadig)"
    ))]
    Usb {
        /// What it says.
        source: std::io::Error,
    },
}

/// The words of an image's log.
pub struct LogImage(Table);

impl LogImage {
    /// Reads them from an image's ELF file.
    ///
    /// # Errors
    /// [`LogError::Image`], [`LogError::NoWords`].
    pub fn read(path: &Path) -> Result<LogImage, LogError> {
        let elf = read_plain(path, MOST_FILE).map_err(|source| FlashError::NoImage {
            path: path.to_owned(),
            source,
        })?;
        let none = |why: String| LogError::NoWords {
            path: path.to_owned(),
            why,
        };
        match Table::parse(&elf) {
            Ok(Some(table)) => Ok(LogImage(table)),
            Ok(None) => Err(none("no section .defmt".to_owned())),
            Err(error) => Err(none(error.to_string())),
        }
    }

    /// Makes lines of bytes as they come.
    pub fn lines(&self) -> Lines<'_> {
        Lines {
            decoder: self.0.new_stream_decoder(),
        }
    }
}

/// A line of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Console time; empty if the image has none.
    pub time: String,
    /// `error`, `warn`, `info`, `debug` or `trace`; empty if it has none.
    pub level: &'static str,
    /// What it says; nothing if no line of this image is like that.
    pub text: Option<String>,
}

/// A log that is being read.
pub struct Lines<'a> {
    decoder: Box<dyn StreamDecoder + Send + Sync + 'a>,
}

impl Lines<'_> {
    /// The lines that end in these bytes.
    pub fn of(&mut self, bytes: &[u8]) -> Vec<Line> {
        self.decoder.received(bytes);
        let mut lines = Vec::new();
        loop {
            match self.decoder.decode() {
                Ok(frame) => lines.push(Line {
                    time: frame
                        .display_timestamp()
                        .map_or(String::new(), |time| time.to_string()),
                    level: frame.level().map_or("", |level| level.as_str()),
                    text: Some(frame.display_message().to_string()),
                }),
                Err(DecodeError::UnexpectedEof) => return lines,
                Err(DecodeError::Malformed) => lines.push(Line {
                    time: String::new(),
                    level: "",
                    text: None,
                }),
            }
        }
    }
}

/// Where a log's bytes come from.
pub trait LogBytes {
    /// The next bytes, or none when none have come for so long.
    ///
    /// # Errors
    /// [`LogError::Gone`].
    fn read(&mut self, wait: Duration) -> Result<Vec<u8>, LogError>;
}

/// Time after which [`follow`] asks whether that is enough.
const LOOK: Duration = Duration::from_millis(200);
/// So many lines in a row that no line of the image is like, before any other, are another image's.
const UNKNOWN: u32 = 3;

/// Shows a log's lines as they come, until `enough`.
///
/// # Errors
/// [`LogError::OtherImage`], and those of the bytes.
pub fn follow(
    bytes: &mut dyn LogBytes,
    image: &LogImage,
    mut enough: impl FnMut() -> bool,
    mut show: impl FnMut(&Line),
) -> Result<(), LogError> {
    let mut lines = image.lines();
    let (mut known, mut unknown) = (false, 0);
    while !enough() {
        for line in lines.of(&bytes.read(LOOK)?) {
            known |= line.text.is_some();
            unknown += u32::from(line.text.is_none());
            if !known && unknown >= UNKNOWN {
                return Err(LogError::OtherImage);
            }
            show(&line);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of a real image are read, and followed, in `hil/tests/board_image/log.rs`.
    #[test]
    fn a_file_without_words_is_named_with_what_to_give() {
        let error = |path: &str| match LogImage::read(Path::new(path)) {
            Ok(_) => String::new(),
            Err(error) => format!(
                "{error} ({:?})",
                miette::Diagnostic::help(&error).map(|h| h.to_string())
            ),
        };
        let text = error("Cargo.toml");
        assert!(
            text.contains("`Cargo.toml` has no words for a log") && text.contains("--elf"),
            "{text}"
        );
        let text = error("not-there");
        assert!(
            text.contains("cannot read the image `not-there`")
                && text.contains("cargo xtask firmware"),
            "{text}"
        );
    }
}
