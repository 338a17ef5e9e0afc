//! Whole frames from parts, with anything in the header and a checksum that fits.

use crc::{CRC_32_ISO_HDLC, Crc};

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// First part of a frame, as its sender would have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Protocol version.
    pub version: u8,
    /// Kind of the message.
    pub kind: u8,
    /// Session.
    pub session: u32,
    /// Place in the session's frames.
    pub sequence: u32,
    /// Console time \[us\].
    pub console_time_us: u64,
}

/// The frame, delimiter included.
pub fn frame(stamp: &Stamp, body: &[u8]) -> Vec<u8> {
    let mut packet = vec![stamp.version, stamp.kind];
    packet.extend(stamp.session.to_le_bytes());
    packet.extend(stamp.sequence.to_le_bytes());
    packet.extend(stamp.console_time_us.to_le_bytes());
    packet.extend(body);
    packet.extend(CRC.checksum(&packet).to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(packet.len())];
    let len = cobs::encode(&packet, &mut frame);
    frame.truncate(len);
    frame.push(0);
    frame
}
