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
        while let Some((byte, rest)) = bytes.split_first() {
            match (self.part, byte) {
                (Part::Frame, _) => return self.frame(bytes),
                (_, 0) => self.part = Part::Delimiter,
                (Part::OverlongFrame, _) => {}
                (Part::Delimiter, _) => {
                    self.part = Part::Frame;
                    self.len = 0;
                    self.unstuffing = Unstuffing::START;
                    continue;
                }
            }
            *bytes = rest;
        }
        false
    }

    /// The same within a frame. Its state is in registers meanwhile: in memory a byte would cost three times as much.
    fn frame(&mut self, bytes: &mut &[u8]) -> bool {
        let (mut len, mut unstuffing, mut rest) = (self.len, self.unstuffing, *bytes);
        let end = loop {
            let Some((byte, after)) = rest.split_first() else {
                break None;
            };
            rest = after;
            if *byte == 0 {
                let cut = unstuffing.block_left > 0;
                break Some((Part::Delimiter, cut.then_some(Reject::Cobs)));
            }
            let Some(data) = unstuffing.next(*byte) else {
                continue;
            };
            let Some(place) = self.packet.get_mut(len) else {
                break Some((Part::OverlongFrame, Some(Reject::Overlong)));
            };
            *place = data;
            len += 1;
        };
        (self.len, self.unstuffing, *bytes) = (len, unstuffing, rest);
        if let Some((part, reject)) = end {
            (self.part, self.reject) = (part, reject);
        }
        end.is_some()
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
#[derive(Clone, Copy, Debug)]
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
    #[inline(always)]
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

    use super::{Accumulator, MAX_PACKET, Unstuffing};
    use crate::wire::Reject;
    use proptest::prelude::*;
    use std::vec::Vec;

    type Packet = Result<Vec<u8>, Reject>;

    fn in_pieces(bytes: &[u8], length: usize) -> Vec<Packet> {
        let (mut accumulator, mut packets) = (Accumulator::new(), Vec::new());
        for mut piece in bytes.chunks(length) {
            while accumulator.take_in(&mut piece) {
                packets.push(accumulator.packet().map(<[u8]>::to_vec));
            }
        }
        packets
    }

    /// What is between zeros, each for itself.
    fn between_zeros(bytes: &[u8]) -> Vec<Packet> {
        let mut frames: Vec<_> = bytes.split(|byte| *byte == 0).collect();
        let unended = frames.pop();
        let packet = |frame: &&[u8], has_ended: bool| {
            let mut unstuffing = Unstuffing::START;
            let packet: Vec<_> = frame.iter().filter_map(|b| unstuffing.next(*b)).collect();
            match unstuffing.block_left {
                _ if packet.len() > MAX_PACKET => Some(Err(Reject::Overlong)),
                _ if !has_ended || frame.is_empty() => None,
                0 => Some(Ok(packet)),
                _ => Some(Err(Reject::Cobs)),
            }
        };
        let ended = frames.iter().filter_map(|frame| packet(frame, true));
        let unended = unended.iter().filter_map(|frame| packet(frame, false));
        ended.chain(unended).collect()
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
        fn pieces_give_the_packets_that_are_between_zeros(
            bytes in prop_oneof![
                prop::collection::vec(prop_oneof![900 => 1u8..=255, 1 => Just(0)], 0..9000),
                prop::collection::vec(any::<u8>(), 0..600),
                prop::collection::vec(prop_oneof![9 => 1u8..6, 1 => Just(0)], 0..600),
            ],
            length in 1usize..400,
        ) {
            prop_assert_eq!(in_pieces(&bytes, length), between_zeros(&bytes));
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
