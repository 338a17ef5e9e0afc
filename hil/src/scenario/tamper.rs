//! A frame taken apart, changed, and put together again with the checksum that it then has.
//!
//! Entry point: [`Frame::take_apart`]. By the description of the wire protocol, without the product's own encoder: what is
//! made here may be what that would refuse to make.

use crc::{CRC_32_ISO_HDLC, Crc};
use sutura_shared::wire::message::Contact;
use sutura_shared::wire::{HEADER_SIZE, Kind, MAX_FRAME, Unchecked, decode, encode};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
const CRC_SIZE: usize = 4;

/// Header and body, without byte stuffing and checksum.
#[derive(Clone, Debug)]
pub(super) struct Frame(Vec<u8>);

impl Frame {
    /// Of the bytes up to and with the delimiter; none if they are no right frame.
    pub fn take_apart(bytes: &[u8]) -> Option<Frame> {
        let stuffed = bytes.strip_suffix(&[0])?;
        let mut packet = vec![0; stuffed.len()];
        let report = cobs::decode(stuffed, &mut packet).ok()?;
        packet.truncate(report.frame_size());
        let (content, sum) = packet.split_last_chunk::<CRC_SIZE>()?;
        let right = CRC.checksum(content).to_le_bytes() == *sum;
        let content = content.to_vec();
        (right && content.len() >= HEADER_SIZE).then_some(Frame(content))
    }

    /// With checksum, byte stuffing and delimiter.
    pub fn put_together(&self) -> Vec<u8> {
        let mut packet = self.0.clone();
        packet.extend(CRC.checksum(&self.0).to_le_bytes());
        let mut bytes = vec![0; cobs::max_encoding_length(packet.len())];
        let length = cobs::encode(&packet, &mut bytes);
        bytes.truncate(length);
        bytes.push(0);
        bytes
    }

    pub fn is(&self, kind: Kind) -> bool {
        self.0.get(1) == Some(&(kind as u8))
    }

    /// Whether it carries what was solved for a state.
    pub fn is_solved(&self) -> bool {
        let solved = [Kind::Contact, Kind::Rows, Kind::Needle, Kind::Thread];
        solved.into_iter().any(|kind| self.is(kind))
    }

    fn number<const N: usize>(&self, at: usize) -> [u8; N] {
        let bytes = self.0.get(at..at + N);
        bytes
            .and_then(|bytes| bytes.try_into().ok())
            .unwrap_or([0; N])
    }

    fn put(&mut self, at: usize, number: &[u8]) {
        if let Some(place) = self.0.get_mut(at..at + number.len()) {
            place.copy_from_slice(number);
        }
    }

    pub fn session(&self) -> u32 {
        u32::from_le_bytes(self.number(2))
    }

    pub fn set_session(&mut self, session: u32) {
        self.put(2, &session.to_le_bytes());
    }

    pub fn sequence(&self) -> u32 {
        u32::from_le_bytes(self.number(6))
    }

    pub fn set_sequence(&mut self, sequence: u32) {
        self.put(6, &sequence.to_le_bytes());
    }

    pub fn time_us(&self) -> u64 {
        u64::from_le_bytes(self.number(10))
    }

    pub fn set_time_us(&mut self, time_us: u64) {
        self.put(10, &time_us.to_le_bytes());
    }

    /// Changes the contact that it carries; what carries none is left alone.
    pub fn change_contact(&mut self, change: impl FnOnce(&mut Contact)) {
        let mut packet = self.0.clone();
        packet.extend(CRC.checksum(&self.0).to_le_bytes());
        let unpacked = decode(&packet).and_then(|decoded| decoded.unpack());
        let Ok(Unchecked::Contact(header, mut contact)) = unpacked else {
            return;
        };
        change(&mut contact);
        let mut out = [0; MAX_FRAME];
        let length = encode(
            header.session,
            header.sequence,
            header.console_time_us,
            &contact,
            &mut out,
        );
        let changed = length.ok().and_then(|length| out.get(..length));
        if let Some(frame) = changed.and_then(Frame::take_apart) {
            *self = frame;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::wire::message::Command;

    #[test]
    fn a_frame_survives_being_taken_apart_and_carries_what_was_changed() {
        let mut out = [0; MAX_FRAME];
        let length = encode(7, 8, 9, &Command::Arm, &mut out).expect("fits");
        let bytes = out[..length].to_vec();
        let mut frame = Frame::take_apart(&bytes).expect("right");
        assert_eq!(frame.put_together(), bytes);
        assert_eq!(
            (frame.session(), frame.sequence(), frame.time_us()),
            (7, 8, 9)
        );
        frame.set_session(70);
        frame.set_sequence(80);
        frame.set_time_us(90);
        let length = encode(70, 80, 90, &Command::Arm, &mut out).expect("fits");
        assert_eq!(frame.put_together(), &out[..length]);
        let mut wrong = bytes;
        wrong[4] ^= 1;
        assert!(Frame::take_apart(&wrong).is_none());
    }
}
