//! The log of a console on USB, over nusb.
//!
//! Entry points: [`UsbLog::open`]; [`LogPlace::find`] for where the log is among a console's interfaces.

use crate::{LogBytes, LogError};
use nusb::descriptors::{ConfigurationDescriptor, TransferType, language_id};
use nusb::transfer::{Bulk, Direction, In};
use nusb::{Endpoint, MaybeFuture};
use std::num::NonZeroU8;
use std::time::Duration;
use sutura_shared::usb::{LOG_INTERFACE, PRODUCT, VENDOR};

/// Where a console's log is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogPlace {
    /// Number of its interface.
    pub interface: u8,
    /// Address of its endpoint to the host.
    pub endpoint: u8,
    /// Index of its name, which is the board's, among the device's strings.
    pub name: Option<NonZeroU8>,
}

impl LogPlace {
    /// The log in a configuration, as the device describes it: an interface of [`LOG_INTERFACE`] with a bulk endpoint to the host. None if
    /// there is no such, or these bytes are no configuration.
    pub fn find(configuration: &[u8]) -> Option<LogPlace> {
        let configuration = ConfigurationDescriptor::new(configuration)?;
        configuration.interface_alt_settings().find_map(|one| {
            let class = [one.class(), one.subclass(), one.protocol()];
            let mut endpoints = one.endpoints().filter(|endpoint| {
                (endpoint.direction(), endpoint.transfer_type())
                    == (Direction::In, TransferType::Bulk)
            });
            let endpoint = endpoints.next().filter(|_| class == LOG_INTERFACE)?;
            Some(LogPlace {
                interface: one.interface_number(),
                endpoint: endpoint.address(),
                name: one.string_index(),
            })
        })
    }
}

/// Whether a device, by what it says of itself, is the console of this serial number.
fn is_console(vendor: u16, product: u16, own: Option<&str>, serial: &str) -> bool {
    (vendor, product) == (VENDOR, PRODUCT)
        && own.is_some_and(|own| own.eq_ignore_ascii_case(serial))
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
        let mut devices = nusb::list_devices().wait().map_err(usb)?;
        let found = devices.find(|device| {
            let (vendor, product) = (device.vendor_id(), device.product_id());
            is_console(vendor, product, device.serial_number(), serial)
        });
        let serial = serial.to_owned();
        let Some(info) = found else {
            return Err(LogError::NoConsole { serial });
        };
        let device = info.open().wait().map_err(usb)?;
        let configuration = device
            .active_configuration()
            .map_err(|error| LogError::Usb {
                source: std::io::Error::other(error),
            })?;
        let Some(place) = LogPlace::find(configuration.as_bytes()) else {
            return Err(LogError::NoLog { serial });
        };
        let name = place.name.and_then(|index| {
            let english = language_id::US_ENGLISH;
            let text = device.get_string_descriptor(index, english, Duration::from_secs(1));
            text.wait().ok()
        });
        let interface = device.claim_interface(place.interface).wait();
        let interface = interface.map_err(usb)?;
        Ok(UsbLog {
            endpoint: interface.endpoint(place.endpoint).map_err(usb)?,
            board: name.unwrap_or_default(),
        })
    }
}

impl LogBytes for UsbLog {
    fn read(&mut self, wait: Duration) -> Result<Vec<u8>, LogError> {
        if self.endpoint.pending() == 0 {
            let buffer = self.endpoint.allocate(ASKED);
            self.endpoint.submit(buffer);
        }
        match self.endpoint.wait_next_complete(wait) {
            None => Ok(Vec::new()),
            Some(done) => {
                done.status.map_err(|error| LogError::Gone {
                    source: error.into(),
                })?;
                Ok(done.buffer.into_vec())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    /// Class, subclass and protocol, the name's index, and of each endpoint its address and attributes.
    type Interface<'a> = ([u8; 3], u8, &'a [[u8; 2]]);

    /// A configuration of interfaces: class, subclass, protocol, name, and endpoints by address and attributes (USB 2.0, 9.6).
    fn configuration(interfaces: &[Interface<'_>]) -> Vec<u8> {
        let mut bytes = vec![9, 2, 0, 0, interfaces.len() as u8, 1, 0, 0x80, 250];
        for (number, ([class, subclass, protocol], name, endpoints)) in
            interfaces.iter().enumerate()
        {
            let (number, count) = (number as u8, endpoints.len() as u8);
            bytes.extend([9, 4, number, 0, count, *class, *subclass, *protocol, *name]);
            for [address, attributes] in *endpoints {
                bytes.extend([7, 5, *address, *attributes, 64, 0, 1]);
            }
        }
        let length = bytes.len() as u16;
        bytes[2..4].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    const BULK: u8 = 2;
    const INTERRUPT: u8 = 3;

    /// That of an image is found in `hil/tests/board_image/log.rs`.
    #[test]
    fn the_log_is_the_bulk_endpoint_to_the_host_of_its_own_interface() {
        let serial = ([10, 0, 0], 0, &[[0x82, BULK], [0x01, BULK]][..]);
        let log = (
            LOG_INTERFACE,
            4,
            &[[0x03, BULK], [0x84, INTERRUPT], [0x83, BULK]][..],
        );
        let found = LogPlace::find(&configuration(&[serial, log]));
        let expected = LogPlace {
            interface: 1,
            endpoint: 0x83,
            name: NonZeroU8::new(4),
        };
        assert_eq!(found, Some(expected));
        // Another vendor's interface, another version of the log, and one that has no way to the host.
        let other = ([0xFF, 0, 0], 0, &[[0x83, BULK]][..]);
        let [class, subclass, protocol] = LOG_INTERFACE;
        let newer = ([class, subclass, protocol + 1], 0, &[[0x83, BULK]][..]);
        let deaf = (LOG_INTERFACE, 0, &[[0x03, BULK], [0x83, INTERRUPT]][..]);
        assert_eq!(
            LogPlace::find(&configuration(&[serial, other, newer, deaf])),
            None
        );
    }

    #[test]
    fn no_bytes_are_taken_for_a_configuration_that_are_none() {
        let log = (LOG_INTERFACE, 4, &[[0x83, BULK]][..]);
        let whole = configuration(&[log]);
        for length in 0..whole.len() {
            assert_eq!(LogPlace::find(&whole[..length]), None, "{length}");
        }
        let mut lies = whole.clone();
        lies[2..4].fill(0xFF);
        assert_eq!(LogPlace::find(&lies), None);
    }

    #[test]
    fn a_console_is_known_by_its_numbers_in_any_case() {
        let number = "0043002B3438510B32363530";
        let lower = number.to_lowercase();
        assert!(is_console(VENDOR, PRODUCT, Some(&lower), number));
        assert!(!is_console(VENDOR, PRODUCT, Some(&number[1..]), number));
        assert!(!is_console(VENDOR, PRODUCT, None, number));
        assert!(!is_console(VENDOR, PRODUCT, None, ""));
        assert!(!is_console(VENDOR, PRODUCT ^ 1, Some(number), number));
        assert!(!is_console(VENDOR ^ 1, PRODUCT, Some(number), number));
    }
}
