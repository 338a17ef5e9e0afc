//! Frames of a recording, sorted by the sessions that they belong to.
//!
//! Entry point: [`sessions`]. A session begins with the console's answer to a `Hello`; what is damaged, or of no session, is
//! left out, as either end does.

use super::super::about::{About, Begins};
use super::super::read::Recording;
use super::super::tap::Direction;
use std::collections::HashMap;
use sutura_shared::wire::message::{Hello, Refusal, State};
use sutura_shared::wire::{Accumulator, Checked, HEADER_SIZE, Header, Kind, Valid, decode};

/// A frame of the host.
#[derive(Clone, Debug, PartialEq)]
pub struct DownFrame {
    /// Its header.
    pub header: Header,
    /// When it went, by the host's clock \[ns\].
    pub time_ns: u64,
    /// All of it.
    pub bytes: Vec<u8>,
}

/// What went over the line in one session.
#[derive(Clone, Debug)]
pub struct Session {
    /// The console's description of itself; for a session without an opening, the recording's.
    pub console: Hello,
    /// Whether the recording has the session's opening; a file of the last seconds may begin after it.
    pub is_opened: bool,
    /// The host's `Hello`, if it was recorded.
    pub hello: Option<Vec<u8>>,
    /// Frames of the host, in the order of their sequence.
    pub down: Vec<DownFrame>,
    /// States, with the host's time at which they came \[ns\].
    pub states: Vec<(Valid<State>, u64)>,
}

/// The sessions of a recording, in the order in which they were opened.
pub fn sessions(recording: &Recording) -> Vec<Session> {
    let mut hellos = HashMap::new();
    let mut sessions: Vec<Session> = Vec::new();
    for frame in &recording.frames {
        let Some((header, message)) = parse(frame.direction, &frame.bytes) else {
            continue;
        };
        match (frame.direction, message) {
            (Direction::Down, Some(Checked::Hello(hello))) => {
                hellos.insert(hello.body().nonce, frame.bytes.clone());
            }
            (Direction::Up, Some(Checked::Hello(hello))) if hello.body().session != 0 => {
                sessions.push(Session {
                    console: *hello.body(),
                    is_opened: true,
                    hello: hellos.remove(&hello.body().nonce),
                    down: Vec::new(),
                    states: Vec::new(),
                });
            }
            (direction, message) => {
                let is_first = recording.about.begins == Begins::Later
                    && sessions.is_empty()
                    && direction == Direction::Up
                    && matches!(message, Some(Checked::State(_)));
                if is_first {
                    sessions.push(unopened(header.session, &recording.about));
                }
                let of = |session: &&mut Session| session.console.session == header.session;
                let Some(session) = sessions.iter_mut().rev().find(of) else {
                    continue;
                };
                match (direction, message) {
                    (Direction::Up, Some(Checked::State(state))) => {
                        session.states.push((state, frame.time_ns));
                    }
                    (Direction::Down, _) => session.down.push(DownFrame {
                        header,
                        time_ns: frame.time_ns,
                        bytes: frame.bytes.clone(),
                    }),
                    _ => {}
                }
            }
        }
    }
    sessions
}

/// A session whose opening is not in the recording.
fn unopened(session: u32, about: &About) -> Session {
    Session {
        console: Hello {
            schema_hash: 0,
            nonce: 0,
            session,
            tick_hz: about.plan.tick_hz,
            max_frame: 0,
            simulated: false,
            device_name: about.plan.device.name,
            refusal: Refusal::None,
        },
        is_opened: false,
        hello: None,
        down: Vec::new(),
        states: Vec::new(),
    }
}

/// Header and message of a frame; no message for rows, which only a link unpacks.
pub(super) fn parse(direction: Direction, frame: &[u8]) -> Option<(Header, Option<Checked>)> {
    let mut accumulator = Accumulator::new();
    let packet = packet(&mut accumulator, frame)?;
    let decoded = decode(packet).ok()?;
    let direction = match direction {
        Direction::Down => sutura_shared::wire::Direction::ToConsole,
        Direction::Up => sutura_shared::wire::Direction::ToHost,
    };
    if !decoded.header.kind.travels(direction) {
        return None;
    }
    if decoded.header.kind == Kind::Rows {
        return Some((decoded.header, None));
    }
    let message = decoded.unpack().ok()?.validate(direction).ok()?;
    Some((decoded.header, Some(message)))
}

fn packet<'a>(accumulator: &'a mut Accumulator, frame: &[u8]) -> Option<&'a [u8]> {
    let (last, most) = frame.split_last()?;
    for byte in most {
        // Something that ends within the frame is none.
        if accumulator.push(*byte).is_some() {
            return None;
        }
    }
    accumulator.push(*last)?.ok()
}

/// The frame as a frame of another session, with a right checksum; what is no frame stays as it is.
pub fn frame_with_session(frame: &[u8], session: u32) -> Vec<u8> {
    let mut accumulator = Accumulator::new();
    let Some(content) = packet(&mut accumulator, frame)
        .and_then(|packet| packet.split_last_chunk::<4>())
        .map(|(content, _)| content)
    else {
        return frame.to_vec();
    };
    let mut content = content.to_vec();
    // Behind version and kind: see the header's table in the protocol's page.
    if let Some(place) = content.get_mut(2..6).filter(|_| frame.len() > HEADER_SIZE) {
        place.copy_from_slice(&session.to_le_bytes());
    }
    stuffed(&content)
}

/// A frame around header and body.
pub fn stuffed(content: &[u8]) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(content);
    let packet = [content, &crc.to_le_bytes()].concat();
    let mut frame = vec![0; cobs::max_encoding_length(packet.len())];
    let length = cobs::encode(&packet, &mut frame);
    // Where a block of the greatest length ends the packet the encoder has begun another one behind it.
    frame.truncate(length);
    frame.push(0);
    frame
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::wire::MAX_FRAME;

    /// Fills a part of the content so that neither it nor the checksum has zeros.
    fn without_zeros(content: &mut [u8], run: core::ops::Range<usize>) {
        if run.is_empty() {
            return;
        }
        for filling in 1..=u8::MAX {
            content[run.clone()].fill(filling);
            let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(content);
            if !sum.to_le_bytes().contains(&0) {
                return;
            }
        }
        panic!("a checksum without zeros is common");
    }

    /// The frame ends at its only zero, and the codec and the `cobs` crate read the same from it.
    fn comes_back(content: &[u8]) {
        let frame = stuffed(content);
        let (last, most) = frame.split_last().expect("a frame is not empty");
        assert!(*last == 0 && !most.contains(&0), "{frame:?}");
        let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(content);
        let packet = [content, &sum.to_le_bytes()].concat();
        let mut unstuffed = vec![0; most.len()];
        let length = cobs::decode(most, &mut unstuffed).map(|report| report.frame_size());
        assert_eq!(length.map(|length| &unstuffed[..length]), Ok(&packet[..]));
        let mut accumulator = Accumulator::new();
        assert_eq!(super::packet(&mut accumulator, &frame), Some(&packet[..]));
    }

    /// Content that fits into a frame whatever it is.
    const LONGEST: usize = MAX_FRAME - MAX_FRAME / 254 - 8;

    #[test]
    fn content_of_every_length_comes_back() {
        for length in 0..LONGEST {
            comes_back(&vec![0; length]);
            let mut content = vec![0; length];
            without_zeros(&mut content, 0..length);
            comes_back(&content);
        }
    }

    /// Blocks of 253 to 255 bytes at every place, the packet's end included, where they take the checksum in.
    #[test]
    fn longest_blocks_at_every_place_come_back() {
        for length in [250, 251, 300, 504, 505, 700] {
            for run in 249..=255 {
                for from in 0..=length {
                    let to = (from + run).min(length);
                    let mut content = vec![0; length];
                    without_zeros(&mut content, from..to);
                    comes_back(&content);
                }
            }
        }
    }

    /// A session's number changes nothing but itself and the checksum.
    #[test]
    fn a_frame_of_another_session_is_a_whole_frame() {
        for length in HEADER_SIZE..LONGEST {
            let mut content = vec![0; length];
            without_zeros(&mut content, 0..length);
            let mut expected = content.clone();
            expected[2..6].copy_from_slice(&0x0102_0304_u32.to_le_bytes());
            let found = frame_with_session(&stuffed(&content), 0x0102_0304);
            assert_eq!(found, stuffed(&expected), "{length}");
        }
    }
}
