//! What a console is on USB.

/// Vendor and product number, which V-USB lends to serial ports of anybody; a console's serial number is its chip's own.
pub const VENDOR: u16 = 0x16C0;
/// See [`VENDOR`].
pub const PRODUCT: u16 = 0x27DD;

/// Class, subclass and protocol of the interface with the log: a vendor's own, made up here. It has one endpoint, to the host, with
/// what defmt has encoded, and is named after the board.
pub const LOG_INTERFACE: [u8; 3] = [0xFF, 0x53, 0x01];
