//! Bytes -> packets. Entry point: [`Accumulator::push`]; COBS is that of Cheshire & Baker 1999.

use super::Reject;
use super::frame::MAX_PACKET;

/// Collects bytes into packets: finds the delimiters and undoes the byte stuffing as the bytes come, at
/// a bounded cost per byte.
///
/// An overlong frame is dropped up to the next delimiter, so that its tail is never taken for a frame.
#[derive(Clone, Debug)]
pub struct Accumulator {
    packet: [u8; MAX_PACKET],
    len: usize,
    part: Part,
    unstuffing: Unstuffing,
    /// Why the last frame gave no packet.
    reject: Option<Reject>,
}

/// What the last byte belonged to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Delimiter,
    Frame,
    OverlongFrame,
}

impl Default for Accumulator {
    fn default() -> Self {
        Self::new()
    }
}

impl Accumulator {
    /// An empty accumulator.
    pub const fn new() -> Self {
        Accumulator {
            packet: [0; MAX_PACKET],
            len: 0,
            part: Part::Delimiter,
            unstuffing: Unstuffing::START,
            reject: None,
        }
    }

    /// Takes one byte; returns a packet when the byte completes one, ready for [`decode`](super::decode).
    ///
    /// Delimiters in a row are not errors.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], Reject>> {
        self.take_in(&mut &[byte][..]).then(|| self.packet())
    }

    /// Takes bytes, up to the one that ends a frame, good or bad, which is then in [`packet`](Self::packet); false if none does, and all
    /// are taken.
    pub(crate) fn take_in(&mut self, bytes: &mut &[u8]) -> bool {
        loop {
            self.copy(bytes);
            let Some((byte, rest)) = bytes.split_first() else {
                return false;
            };
            *bytes = rest;
            if self.step(*byte) {
                return true;
            }
        }
    }

    /// Takes what stuffing has left as it was: most bytes, and one by one they would cost five times as much.
    fn copy(&mut self, bytes: &mut &[u8]) {
        if self.part != Part::Frame {
            return;
        }
        let most = usize::from(self.unstuffing.block_left);
        let room = self.packet.get_mut(self.len..).unwrap_or_default();
        let mut count = 0;
        for (place, byte) in room.iter_mut().zip(*bytes).take(most) {
            if *byte == 0 {
                break;
            }
            *place = *byte;
            count += 1;
        }
        self.len += usize::from(count);
        self.unstuffing.block_left -= count;
        *bytes = bytes.get(usize::from(count)..).unwrap_or_default();
    }

    /// Takes one byte; whether it ends a frame. Some 40 instructions on a Cortex-M4.
    fn step(&mut self, byte: u8) -> bool {
        match (byte, self.part) {
            (0, Part::Frame) => {
                self.part = Part::Delimiter;
                self.reject = (self.unstuffing.block_left > 0).then_some(Reject::Cobs);
                return true;
            }
            (0, _) => {
                self.part = Part::Delimiter;
                return false;
            }
            (_, Part::OverlongFrame) => return false,
            (_, Part::Frame) => {}
            (_, Part::Delimiter) => {
                self.part = Part::Frame;
                self.len = 0;
                self.unstuffing = Unstuffing::START;
            }
        }
        let Some(data) = self.unstuffing.next(byte) else {
            return false;
        };
        match self.packet.get_mut(self.len) {
            Some(place) => {
                *place = data;
                self.len += 1;
                false
            }
            None => {
                self.part = Part::OverlongFrame;
                self.reject = Some(Reject::Overlong);
                true
            }
        }
    }

    /// What the frame that ended last holds.
    pub(crate) fn packet(&self) -> Result<&[u8], Reject> {
        match self.reject {
            Some(reject) => Err(reject),
            None => self.packet.get(..self.len).ok_or(Reject::Overlong),
        }
    }
}

/// Undoes COBS within one frame. (`cobs::DecoderState` would do, but could not be cloned with a console.)
#[derive(Clone, Debug)]
struct Unstuffing {
    /// Bytes that the current block still has.
    block_left: u8,
    /// Whether a zero follows the current block, unless the frame ends with it.
    zero_after: bool,
}

impl Unstuffing {
    const START: Self = Unstuffing {
        block_left: 0,
        zero_after: false,
    };

    /// The byte of the packet that `byte`, which is not 0, stands for, if any.
    fn next(&mut self, byte: u8) -> Option<u8> {
        if self.block_left > 0 {
            self.block_left -= 1;
            return Some(byte);
        }
        let zero = self.zero_after;
        // A block's length counts itself; the longest block is the one without a zero after it.
        self.block_left = byte.saturating_sub(1);
        self.zero_after = byte != 0xff;
        zero.then_some(0)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{Accumulator, Unstuffing};
    use crate::wire::Reject;
    use proptest::prelude::*;
    use std::vec::Vec;

    type Packet = Result<Vec<u8>, Reject>;

    fn own(accumulator: &Accumulator) -> Packet {
        accumulator.packet().map(<[u8]>::to_vec)
    }

    fn in_pieces(bytes: &[u8], length: usize) -> Vec<Packet> {
        let (mut accumulator, mut packets) = (Accumulator::new(), Vec::new());
        for mut piece in bytes.chunks(length) {
            while accumulator.take_in(&mut piece) {
                packets.push(own(&accumulator));
            }
        }
        packets
    }

    fn one_by_one(bytes: &[u8]) -> Vec<Packet> {
        let mut accumulator = Accumulator::new();
        let packet = |byte: &u8| accumulator.step(*byte).then(|| own(&accumulator));
        bytes.iter().filter_map(packet).collect()
    }

    fn unstuff(stuffed: &[u8]) -> Option<Vec<u8>> {
        let mut unstuffing = Unstuffing::START;
        let data = stuffed.iter().filter_map(|byte| unstuffing.next(*byte));
        let data = data.collect();
        (unstuffing.block_left == 0).then_some(data)
    }

    proptest! {
        /// Packets longer than today's, so that blocks of the greatest length occur too.
        #[test]
        fn stuffed_by_the_cobs_crate_comes_back(
            packet in prop_oneof![
                prop::collection::vec(any::<u8>(), 0..1200),
                prop::collection::vec(1u8..=255, 250..260),
                prop::collection::vec(1u8..=255, 504..514),
                prop::collection::vec(prop_oneof![600 => 1u8..=255, 1 => Just(0)], 0..1200),
            ],
        ) {
            let mut stuffed = std::vec![0; cobs::max_encoding_length(packet.len())];
            let length = cobs::try_encode(&packet, &mut stuffed).expect("fits");
            prop_assert_eq!(unstuff(&stuffed[..length]), Some(packet));
        }

        /// However the bytes come: overlong frames, zeros within a block, several frames at once.
        #[test]
        fn pieces_give_the_packets_that_single_bytes_give(
            bytes in prop_oneof![
                prop::collection::vec(prop_oneof![900 => 1u8..=255, 1 => Just(0)], 0..9000),
                prop::collection::vec(any::<u8>(), 0..600),
                prop::collection::vec(prop_oneof![9 => 1u8..6, 1 => Just(0)], 0..600),
            ],
            length in 1usize..400,
        ) {
            prop_assert_eq!(in_pieces(&bytes, length), one_by_one(&bytes));
        }

        /// Anything between two delimiters: the same bytes as the `cobs` crate, or refused by both.
        #[test]
        fn anything_comes_out_as_from_the_cobs_crate(
            stuffed in prop::collection::vec(prop_oneof![1u8..=255, 1u8..6, Just(255)], 1..1200),
        ) {
            let mut reference = [0; 1200];
            let reference = cobs::decode(&stuffed, &mut reference)
                .ok()
                .map(|report| reference[..report.frame_size()].to_vec());
            prop_assert_eq!(unstuff(&stuffed), reference);
        }
    }
}
