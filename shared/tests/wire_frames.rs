//! From bytes to messages: nothing broken gets through, nothing whole is lost but next to damage.

#![allow(clippy::unwrap_used)]

use crate::common::{
    Golden, encode_again, forge, frame, golden, header_bytes, sample, unpack_all, unpack_one,
    validate_either,
};
use proptest::prelude::*;
use sutura_shared::wire::message::{Command, Hello};
use sutura_shared::wire::{
    Accumulator, Decoded, Direction, Kind, MAX_FRAME, PROTOCOL_VERSION, Reject, SCHEMA_HASH,
    Unchecked, decode,
};

/// Every single byte of every golden frame, changed to every other value: this includes every
/// single-bit error. The frame is refused, and the frame after the next delimiter is read.
#[test]
fn any_changed_byte_is_refused() {
    let after = frame(1, 1, 0, &Command::Arm);
    let after_read = unpack_one(&after).unwrap();
    for Golden { name, bytes, .. } in golden() {
        for place in 0..bytes.len() {
            for flip in 1..=255 {
                let mut stream = bytes.clone();
                stream[place] ^= flip;
                stream.push(0);
                stream.extend(&after);
                let read = unpack_all(&stream);
                let (last, damaged) = read.split_last().unwrap();
                assert_eq!(*last, Ok(after_read), "{name}[{place}] ^ {flip}: lost more");
                assert!(
                    damaged.iter().all(Result::is_err),
                    "{name}[{place}] ^ {flip}: accepted"
                );
            }
        }
    }
}

#[test]
fn any_missing_or_doubled_byte_is_refused() {
    for Golden { name, bytes, .. } in golden() {
        for place in 0..bytes.len() - 1 {
            let missing = [&bytes[..place], &bytes[place + 1..]].concat();
            // Of a run of equal bytes it is all the same which is missing, but never the same frame.
            assert_ne!(missing, bytes);
            let read = unpack_all(&missing);
            assert!(read.iter().all(Result::is_err), "{name} without {place}");
            let doubled = [&bytes[..=place], &bytes[place..]].concat();
            let read = unpack_all(&doubled);
            assert!(read.iter().all(Result::is_err), "{name} with two {place}");
        }
    }
}

/// The frame appears exactly with its delimiter, whatever pieces the bytes come in.
#[test]
fn a_frame_is_complete_at_its_delimiter_and_not_before() {
    let mut accumulator = Accumulator::new();
    for Golden { name, bytes, .. } in golden() {
        let (delimiter, rest) = bytes.split_last().unwrap();
        assert!(rest.iter().all(|byte| accumulator.push(*byte).is_none()));
        let packet = accumulator.push(*delimiter).expect(name);
        assert!(decode(packet.unwrap()).is_ok(), "{name}");
    }
}

#[test]
fn delimiters_in_a_row_are_no_errors() {
    let arm = frame(1, 1, 0, &Command::Arm);
    let stream = [&[0; 5][..], &arm, &[0; 3], &arm, &[0; 300]].concat();
    let read = unpack_all(&stream);
    assert_eq!(read.len(), 2);
    assert!(read.iter().all(Result::is_ok));
}

/// The trap: an accumulator that starts afresh in the middle of an overlong frame takes its tail, here
/// a whole valid frame, for a frame of its own. Every length of the filler is tried, so that the buffer
/// runs over at every place of the tail and just before it.
#[test]
fn the_tail_of_an_overlong_frame_is_not_a_frame() {
    let tail = frame(1, 1, 0, &sample::contact());
    let good = frame(1, 2, 0, &Command::Arm);
    for filler in [0x01, 0x02, 0x7f, 0xff] {
        for length in 1..3 * MAX_FRAME {
            let stream = [&vec![filler; length][..], &tail, &good].concat();
            let read = unpack_all(&stream);
            // Short fillers give one frame that is not overlong but wrong.
            assert_eq!(read.len(), 2, "{length} bytes {filler:#x}: {read:?}");
            let reject = read[0].unwrap_err();
            assert!(
                matches!(reject, Reject::Overlong | Reject::Crc | Reject::Cobs),
                "{reject:?}"
            );
            if length > MAX_FRAME {
                assert_eq!(reject, Reject::Overlong);
            }
            assert!(read[1].is_ok(), "the next frame is read");
        }
    }
}

#[test]
fn an_overlong_frame_is_refused_once_however_long() {
    let mut accumulator = Accumulator::new();
    let mut rejects = 0;
    for _ in 0..100_000 {
        if let Some(packet) = accumulator.push(0x55) {
            assert_eq!(packet, Err(Reject::Overlong));
            rejects += 1;
        }
    }
    assert_eq!(rejects, 1);
}

/// The largest frame there can be: every varint at its longest.
#[test]
fn the_largest_frame_fits_exactly() {
    // Stuffing takes a byte after every 254.
    let packet = (0..MAX_FRAME).find(|packet| packet + packet / 254 + 2 == MAX_FRAME);
    let packet = packet.unwrap();
    let content = vec![0xaa; packet - 4];
    assert_eq!(forge(&content).len(), MAX_FRAME);
    assert_eq!(
        unpack_one(&forge(&content)),
        Err(Reject::Version),
        "taken in whole"
    );
    let content = vec![0xaa; packet - 4 + 1];
    assert_eq!(unpack_all(&forge(&content))[0], Err(Reject::Overlong));
}

#[test]
fn each_part_of_the_packet_has_its_reject() {
    let content = |version, kind, body: &[u8]| {
        forge(&[&header_bytes(version, kind, 1, 1, 0)[..], body].concat())
    };
    assert_eq!(unpack_one(&[1, 0]), Err(Reject::Short), "nothing");
    assert_eq!(
        unpack_one(&forge(&[PROTOCOL_VERSION; 17])),
        Err(Reject::Short)
    );
    assert_eq!(unpack_one(&[5, 1, 0]), Err(Reject::Cobs), "cut short");
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION, 4, &[0])).map(|_| ()),
        Ok(())
    );
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION + 1, 4, &[0])),
        Err(Reject::Version)
    );
    // Another version's kinds are its own business.
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION + 1, 99, &[0])),
        Err(Reject::Version)
    );
    for kind in [0, 9, 15, 21, 255] {
        assert_eq!(
            unpack_one(&content(PROTOCOL_VERSION, kind, &[0])),
            Err(Reject::Kind)
        );
    }
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION, 19, &[0])),
        Err(Reject::ReservedKind)
    );
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION, 4, &[])),
        Err(Reject::Body)
    );
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION, 4, &[4])),
        Err(Reject::Body)
    );
    assert_eq!(
        unpack_one(&content(PROTOCOL_VERSION, 4, &[0, 0])),
        Err(Reject::Trailing)
    );
    let bool_of_two = content(PROTOCOL_VERSION, 6, &[2, 2]);
    assert_eq!(unpack_one(&bool_of_two), Err(Reject::Body));
    let endless_varint = content(PROTOCOL_VERSION, 4, &[3, 0xff, 0xff, 0xff]);
    assert_eq!(unpack_one(&endless_varint), Err(Reject::Body));
}

#[test]
fn every_body_refuses_trailing_and_missing_bytes() {
    for Golden { name, bytes, .. } in golden() {
        let mut accumulator = Accumulator::new();
        let packet = bytes.iter().find_map(|byte| {
            let packet = accumulator.push(*byte)?;
            Some(packet.unwrap().to_vec())
        });
        let packet = packet.unwrap();
        let content = &packet[..packet.len() - 4];
        let longer = forge(&[content, &[0]].concat());
        let short = forge(&content[..content.len() - 1]);
        let reject = if bytes.len() == MAX_FRAME {
            Reject::Overlong
        } else {
            Reject::Trailing
        };
        assert_eq!(unpack_one(&longer), Err(reject), "{name}");
        assert_eq!(unpack_one(&short), Err(Reject::Body), "{name}");
    }
}

#[test]
fn direction_is_checked() {
    for Golden { name, message, .. } in golden() {
        let to_console = message.validate(Direction::ToConsole).err();
        let to_host = message.validate(Direction::ToHost).err();
        let wrong = Some(Reject::Direction);
        let from_host = match message {
            Unchecked::Hello(_, hello) => hello.device_name == [0; 16],
            Unchecked::Contact(..)
            | Unchecked::Command(..)
            | Unchecked::Simulate(..)
            | Unchecked::Needle(..)
            | Unchecked::Thread(..)
            | Unchecked::Ping(..)
            | Unchecked::Fixture(..) => true,
            Unchecked::State(..) | Unchecked::Report(..) | Unchecked::Pong(..) => false,
        };
        if from_host {
            assert_eq!((to_console, to_host), (None, wrong), "{name}");
        } else {
            assert_eq!((to_console, to_host), (wrong, None), "{name}");
        }
    }
    assert!(!Kind::Tools.travels(Direction::ToConsole));
    assert!(!Kind::Tools.travels(Direction::ToHost));
}

/// Frames of any message with any header.
fn any_frame() -> impl Strategy<Value = Vec<u8>> {
    let count = golden().len();
    (0..count, any::<u32>(), any::<u32>(), any::<u64>()).prop_map(
        |(which, session, sequence, time)| match golden()[which].message {
            Unchecked::Hello(_, body) => frame(session, sequence, time, &body),
            Unchecked::State(_, body) => frame(session, sequence, time, &body),
            Unchecked::Contact(_, body) => frame(session, sequence, time, &body),
            Unchecked::Command(_, body) => frame(session, sequence, time, &body),
            Unchecked::Report(_, body) => frame(session, sequence, time, &body),
            Unchecked::Simulate(_, body) => frame(session, sequence, time, &body),
            Unchecked::Needle(_, body) => frame(session, sequence, time, &body),
            Unchecked::Thread(_, body) => frame(session, sequence, time, &body),
            Unchecked::Fixture(_, body) => frame(session, sequence, time, &body),
            Unchecked::Ping(_, body) => frame(session, sequence, time, &body),
            Unchecked::Pong(_, body) => frame(session, sequence, time, &body),
        },
    )
}

/// Bytes as noise, as stuffing would have them, and with many delimiters.
fn any_bytes(max: usize) -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![any::<u8>(), 0u8..4, Just(0xff), Just(0)];
    prop::collection::vec(byte, 0..max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Any bytes: no panic, and no message (the chance that noise has a right CRC is 2^-32 a frame).
    #[test]
    fn noise_gives_no_message(bytes in any_bytes(2000)) {
        for read in unpack_all(&bytes) {
            prop_assert!(read.is_err());
        }
    }

    /// A right checksum around any content: no panic; what validates is canonical, so that it encodes
    /// to a frame that reads as the same.
    #[test]
    fn any_content_is_handled(
        kind in prop_oneof![0u8..8, Just(16), Just(17), any::<u8>()],
        body in any_bytes(230),
    ) {
        let content = [&header_bytes(PROTOCOL_VERSION, kind, 1, 1, 0)[..], &body].concat();
        for read in unpack_all(&forge(&content)) {
            let Ok(message) = read else { continue };
            if validate_either(message).is_ok() {
                prop_assert_eq!(unpack_one(&encode_again(&message)), Ok(message));
            }
        }
    }

    /// Noise before a frame costs at most that frame; the next one is read, and so is the first if the
    /// noise ends with a delimiter.
    #[test]
    fn noise_costs_at_most_the_next_frame(
        noise in any_bytes(600),
        first in any_frame(),
        second in any_frame(),
    ) {
        let wanted_first = unpack_one(&first).unwrap();
        let wanted_second = unpack_one(&second).unwrap();
        let read: Vec<_> = unpack_all(&[&noise[..], &first, &second].concat())
            .into_iter()
            .flatten()
            .collect();
        prop_assert_eq!(read.last(), Some(&wanted_second));
        prop_assert!(read.len() <= 2);
        if noise.last().is_none_or(|byte| *byte == 0) {
            prop_assert_eq!(read, vec![wanted_first, wanted_second]);
        }
    }

    /// What is left of a frame that is cut anywhere costs at most the frame after it.
    #[test]
    fn a_cut_costs_at_most_two_frames(
        first in any_frame(),
        second in any_frame(),
        third in any_frame(),
        from in 0usize..MAX_FRAME,
        to in 0usize..MAX_FRAME,
    ) {
        let (from, to) = (from % first.len(), to % second.len());
        let stream = [&first[..from], &second[to..], &third].concat();
        let read = unpack_all(&stream);
        prop_assert_eq!(read.last(), Some(&unpack_one(&third)));
    }
}

/// `Decoded` is what stands between an unchecked packet and a body; its header is already right.
#[test]
fn the_header_is_read_as_written() {
    let bytes = frame(0x0102_0304, 0x0506_0708, 0x090a_0b0c_0d0e_0f10, &hello());
    let mut accumulator = Accumulator::new();
    let mut seen = false;
    for byte in bytes {
        let Some(packet) = accumulator.push(byte) else {
            continue;
        };
        let Decoded { header, .. } = decode(packet.unwrap()).unwrap();
        assert_eq!(header.kind, Kind::Hello);
        assert_eq!(header.session, 0x0102_0304);
        assert_eq!(header.sequence, 0x0506_0708);
        assert_eq!(header.console_time_us, 0x090a_0b0c_0d0e_0f10);
        seen = true;
    }
    assert!(seen);
}

fn hello() -> Hello {
    Hello {
        schema_hash: SCHEMA_HASH,
        ..sample::hello_host()
    }
}
