//! The host's end of the USB cable: enumeration as a serial port with a log (USB 2.0, 9; USB CDC 1.2, PSTN 6.3).
//!
//! Entry point: [`BoardImage::enumerate`].

use super::otg::Down;
use super::{BoardImage, BoardImageError};

/// Endpoints of the serial port: from the host, and to it.
pub const SERIAL_DOWN: usize = 1;
pub const SERIAL_UP: usize = 2;
/// Endpoint of the log.
pub const LOG_UP: usize = 3;

/// Address that the device is given.
const ADDRESS: u16 = 7;
/// 115200 baud, 8 bits, no parity, which nobody looks at.
const LINE_CODING: [u8; 7] = [0x00, 0xC2, 0x01, 0x00, 0, 0, 8];

/// Smallest packet of a control endpoint \[bytes\]: its own size is in the first as many bytes of the device's descriptor.
const SMALLEST: usize = 8;
/// Rounds in which an answer on the control endpoint has to come.
const ROUNDS: usize = 64;

/// What a device says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Descriptors {
    /// Vendor number.
    pub vendor: u16,
    /// Product number.
    pub product: u16,
    /// Class of the device: 2 = communications.
    pub class: u8,
    /// Classes of its interfaces, in order.
    pub interfaces: Vec<u8>,
    /// Addresses of its endpoints, in order; above 0x80 = to the host.
    pub endpoints: Vec<u8>,
    /// Who made it.
    pub manufacturer: String,
    /// What it is.
    pub name: String,
    /// Which one it is.
    pub serial_number: String,
    /// The configuration with its interfaces and endpoints, as it came.
    pub configuration: Vec<u8>,
}

impl BoardImage {
    /// Plugs the cable in: resets the bus, reads the descriptors, gives an address, chooses the configuration, and opens the serial port.
    ///
    /// # Errors
    /// [`BoardImageError::Usb`] if the device does not answer as it must, and others.
    pub fn enumerate(&mut self) -> Result<Descriptors, BoardImageError> {
        if !self.chip().usb.is_connected() {
            return Err(wrong("the device does not show itself on the cable"));
        }
        self.chip().usb.signal_reset();
        self.serve()?;
        self.chip().usb.signal_speed();
        self.serve()?;
        self.control_size = SMALLEST;
        let head = self.control_in(0x80, 6, 0x0100, 0, SMALLEST as u16)?;
        self.control_size = usize::from(byte(&head, 7)?);
        let device = self.control_in(0x80, 6, 0x0100, 0, 18)?;
        self.control_out(0, 5, ADDRESS, 0, &[])?;
        let head = self.control_in(0x80, 6, 0x0200, 0, 9)?;
        let length = half(&head, 2)?;
        let configuration = self.control_in(0x80, 6, 0x0200, 0, length)?;
        let descriptors = Descriptors {
            vendor: half(&device, 8)?,
            product: half(&device, 10)?,
            class: byte(&device, 4)?,
            interfaces: of_type(&configuration, 4, 5),
            endpoints: of_type(&configuration, 5, 2),
            manufacturer: self.string(byte(&device, 14)?)?,
            name: self.string(byte(&device, 15)?)?,
            serial_number: self.string(byte(&device, 16)?)?,
            configuration: configuration.clone(),
        };
        self.control_out(0, 9, u16::from(byte(&configuration, 5)?), 0, &[])?;
        // SET_LINE_CODING, SET_CONTROL_LINE_STATE: terminal ready.
        self.control_out(0x21, 0x20, 0, 0, &LINE_CODING)?;
        self.control_out(0x21, 0x22, 3, 0, &[])?;
        self.chip().usb.sets_up = false;
        Ok(descriptors)
    }

    /// The host sets the serial port to a line rate and says whether its terminal is ready.
    ///
    /// # Errors
    /// See [`BoardImage::enumerate`].
    pub fn set_line(&mut self, baud: u32, terminal_ready: bool) -> Result<(), BoardImageError> {
        let mut coding = LINE_CODING;
        coding[..4].copy_from_slice(&baud.to_le_bytes());
        self.control_out(0x21, 0x20, 0, 0, &coding)?;
        self.control_out(0x21, 0x22, 2 | u16::from(terminal_ready), 0, &[])
    }

    /// A string descriptor, in US English.
    ///
    /// # Errors
    /// See [`BoardImage::enumerate`].
    pub fn string(&mut self, index: u8) -> Result<String, BoardImageError> {
        let descriptor = self.control_in(0x80, 6, 0x0300 | u16::from(index), 0x0409, 255)?;
        let units = descriptor.get(2..).unwrap_or_default().chunks_exact(2);
        let units: Vec<u16> = units.map(|c| u16::from_le_bytes([c[0], c[1]])).collect();
        String::from_utf16(&units).map_err(|_| wrong("a string that is not UTF-16"))
    }

    /// A control transfer to the host of at most `length` bytes.
    fn control_in(
        &mut self,
        kind: u8,
        request: u8,
        value: u16,
        index: u16,
        length: u16,
    ) -> Result<Vec<u8>, BoardImageError> {
        self.setup(kind, request, value, index, length)?;
        let mut bytes = Vec::new();
        loop {
            let packet = self.control_packet(request)?;
            bytes.extend_from_slice(&packet);
            if packet.len() < self.control_size || bytes.len() >= usize::from(length) {
                break;
            }
        }
        // The host's empty packet says that all has come.
        self.give_control(&[], request)?;
        self.serve()?;
        Ok(bytes)
    }

    /// A control transfer to the device.
    fn control_out(
        &mut self,
        kind: u8,
        request: u8,
        value: u16,
        index: u16,
        data: &[u8],
    ) -> Result<(), BoardImageError> {
        self.setup(kind, request, value, index, data.len() as u16)?;
        for packet in data.chunks(self.control_size.max(1)) {
            self.give_control(packet, request)?;
        }
        match self.control_packet(request)? {
            packet if packet.is_empty() => self.serve(),
            _ => Err(wrong("data where an empty packet had to come")),
        }
    }

    fn setup(
        &mut self,
        kind: u8,
        request: u8,
        value: u16,
        index: u16,
        length: u16,
    ) -> Result<(), BoardImageError> {
        let mut packet = vec![kind, request];
        for half in [value, index, length] {
            packet.extend(half.to_le_bytes());
        }
        self.chip().usb.give(0, Down::Setup, &packet);
        self.serve()
    }

    fn give_control(&mut self, bytes: &[u8], request: u8) -> Result<(), BoardImageError> {
        for _ in 0..ROUNDS {
            if self.chip().usb.give(0, Down::Data, bytes) {
                return self.serve();
            }
            self.serve()?;
        }
        Err(wrong(&format!(
            "the control endpoint takes nothing, in request {request}"
        )))
    }

    fn control_packet(&mut self, request: u8) -> Result<Vec<u8>, BoardImageError> {
        for _ in 0..ROUNDS {
            if let Some(packet) = self.chip().usb.take(0) {
                self.serve()?;
                return Ok(packet);
            }
            if self.chip().usb.stalls() {
                return Err(wrong(&format!("the device refuses request {request}")));
            }
            self.serve()?;
        }
        Err(wrong(&format!("no answer to request {request}")))
    }
}

fn wrong(what: &str) -> BoardImageError {
    BoardImageError::Usb(what.to_owned())
}

fn byte(bytes: &[u8], at: usize) -> Result<u8, BoardImageError> {
    let byte = bytes.get(at).copied();
    byte.ok_or_else(|| wrong(&format!("a descriptor of {} bytes", bytes.len())))
}

fn half(bytes: &[u8], at: usize) -> Result<u16, BoardImageError> {
    Ok(u16::from_le_bytes([byte(bytes, at)?, byte(bytes, at + 1)?]))
}

/// The byte at `at` of every descriptor of a type.
fn of_type(mut descriptors: &[u8], kind: u8, at: usize) -> Vec<u8> {
    let mut found = Vec::new();
    while let [length, this, ..] = *descriptors
        && (2..=descriptors.len()).contains(&usize::from(length))
    {
        let (descriptor, rest) = descriptors.split_at(usize::from(length));
        if this == kind {
            found.extend(descriptor.get(at));
        }
        descriptors = rest;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptors_are_found_by_type_and_nonsense_ends_them() {
        let bytes = [3, 4, 9, 2, 5, 3, 4, 8];
        assert_eq!(of_type(&bytes, 4, 2), [9, 8]);
        assert_eq!(
            of_type(&[3, 4, 9, 9, 4, 1], 4, 2),
            [9],
            "longer than what is there"
        );
        assert!(of_type(&[0, 4, 9], 4, 2).is_empty());
    }
}
