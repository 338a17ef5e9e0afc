//! The log of a console: what its image logs (defmt), in words.
//!
//! Entry points: [`LogImage::read`], [`LogImage::lines`]; [`UsbLog`] for a console on USB.

use crate::FlashError;
use defmt_decoder::{DecodeError, StreamDecoder, Table};
use nusb::transfer::{Bulk, In};
use nusb::{Endpoint, MaybeFuture};
use std::path::{Path, PathBuf};
use std::time::Duration;
use sutura_shared::usb::{LOG_INTERFACE, PRODUCT, VENDOR};

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
        let elf = std::fs::read(path).map_err(|source| FlashError::NoImage {
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

/// The log of a console on USB.
pub struct UsbLog {
    endpoint: Endpoint<Bulk, In>,
    /// The board that the console says it is.
    pub board: String,
}

/// Bytes that are asked for at a time: as long a packet as the bus has.
const ASKED: usize = 64;

impl UsbLog {
    /// Opens the log of the console with this number.
    ///
    /// # Errors
    /// [`LogError::NoConsole`], [`LogError::NoLog`], [`LogError::Usb`].
    pub fn open(serial: &str) -> Result<UsbLog, LogError> {
        let usb = |error: nusb::Error| LogError::Usb {
            source: error.into(),
        };
        let is_it = |device: &nusb::DeviceInfo| {
            let own = device.serial_number().unwrap_or_default();
            (device.vendor_id(), device.product_id()) == (VENDOR, PRODUCT)
                && own.eq_ignore_ascii_case(serial)
        };
        let mut devices = nusb::list_devices().wait().map_err(usb)?;
        let serial = serial.to_owned();
        let Some(info) = devices.find(is_it) else {
            return Err(LogError::NoConsole { serial });
        };
        let device = info.open().wait().map_err(usb)?;
        let configuration = device
            .active_configuration()
            .map_err(|error| LogError::Usb {
                source: std::io::Error::other(error),
            })?;
        let mut settings = configuration.interface_alt_settings();
        let is_log = |class: [u8; 3]| class == LOG_INTERFACE;
        let found = settings.find(|one| is_log([one.class(), one.subclass(), one.protocol()]));
        let address = |one: &nusb::descriptors::InterfaceDescriptor<'_>| {
            one.endpoints().next().map(|endpoint| endpoint.address())
        };
        let Some((number, name, address)) = found
            .and_then(|one| Some((one.interface_number(), one.string_index(), address(&one)?)))
        else {
            return Err(LogError::NoLog { serial });
        };
        let name = name.and_then(|index| {
            let english = nusb::descriptors::language_id::US_ENGLISH;
            device
                .get_string_descriptor(index, english, Duration::from_secs(1))
                .wait()
                .ok()
        });
        let interface = device.claim_interface(number).wait().map_err(usb)?;
        let endpoint = interface.endpoint(address).map_err(usb)?;
        Ok(UsbLog {
            endpoint,
            board: name.unwrap_or_default(),
        })
    }

    /// The next bytes, or none when none have come for a while.
    ///
    /// # Errors
    /// [`LogError::Usb`] if the console is gone.
    pub fn read(&mut self, wait: Duration) -> Result<Vec<u8>, LogError> {
        if self.endpoint.pending() == 0 {
            let buffer = self.endpoint.allocate(ASKED);
            self.endpoint.submit(buffer);
        }
        match self.endpoint.wait_next_complete(wait) {
            None => Ok(Vec::new()),
            Some(done) => {
                done.status.map_err(|error| LogError::Usb {
                    source: error.into(),
                })?;
                Ok(done.buffer.into_vec())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of a real image are read in `hil/tests/board_image/log.rs`.
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
