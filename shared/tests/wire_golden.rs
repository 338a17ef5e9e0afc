//! What is on the wire, bit by bit: a change here is a change of the protocol.

use crate::common;
use crate::common::{encode_again, golden, hex_of, unpack_one, validate_either};
use sutura_shared::wire::message::{
    Command, Contact, End, Fixture, Friction, Hello, Mode, Needle, Ping, Pong, Refusal, Report,
    Rows, Simulate, State, Tension, Thread, Tip, WAY_POINTS,
};
use sutura_shared::wire::{
    HEADER_SIZE, Kind, MAX_FRAME, MAX_REAL_TIME_FRAME, PROTOCOL_VERSION, Reject, SCHEMA_HASH,
    faults, frame_size, inputs,
};

use postcard::experimental::max_size::MaxSize;

/// The golden frames come from `tests/golden/frames.py`, which shares no code with this crate.
#[test]
fn frames_are_those_of_the_independent_encoder() {
    for golden in golden() {
        let ours = hex_of(&encode_again(&golden.message));
        assert_eq!(ours, hex_of(&golden.bytes), "encoding of {}", golden.name);
        let read = unpack_one(&golden.bytes).expect(golden.name);
        assert_eq!(read, golden.message, "decoding of {}", golden.name);
        // -0.0 == 0.0, so compare the bits too.
        assert_eq!(encode_again(&read), golden.bytes, "{}", golden.name);
        validate_either(read).expect(golden.name);
    }
}

#[test]
fn numbers_on_the_wire_are_pinned() {
    let kinds = [
        (Kind::Hello, 1),
        (Kind::State, 2),
        (Kind::Contact, 3),
        (Kind::Command, 4),
        (Kind::Report, 5),
        (Kind::Simulate, 6),
        (Kind::Ping, 7),
        (Kind::Pong, 8),
        (Kind::Rows, 16),
        (Kind::Needle, 17),
        (Kind::Thread, 18),
        (Kind::Tools, 19),
    ];
    for (kind, number) in kinds {
        assert_eq!(kind as u8, number, "{kind:?}");
    }
    let modes = [
        Mode::Boot,
        Mode::Idle,
        Mode::Armed,
        Mode::Decaying,
        Mode::Fault,
    ];
    for (number, mode) in modes.into_iter().enumerate() {
        // postcard writes the position in the enum, `as` gives the discriminant: both are pinned.
        assert_eq!(mode as usize, number, "{mode:?}");
        assert_eq!(first_byte(&mode), number as u8, "{mode:?}");
    }
    let commands = [
        Command::Arm,
        Command::Disarm,
        Command::ClearFault,
        Command::StateEvery { ticks: 1 },
    ];
    for (number, command) in commands.into_iter().enumerate() {
        assert_eq!(first_byte(&command), number as u8, "{command:?}");
    }
    let orders = [
        Simulate::Device(common::sample::cartesian()),
        Simulate::Hand(common::sample::hand()),
        Simulate::EmergencyStop(true),
        Simulate::EncoderOffset([0; 3]),
    ];
    for (number, order) in orders.into_iter().enumerate() {
        assert_eq!(first_byte(&order), number as u8, "{order:?}");
    }
}

#[test]
fn refusals_and_inputs_are_pinned() {
    let refusals = [
        Refusal::None,
        Refusal::Schema,
        Refusal::TickRate,
        Refusal::FrameSize,
        Refusal::Owned,
    ];
    for (number, refusal) in refusals.into_iter().enumerate() {
        assert_eq!(refusal as usize, number, "{refusal:?}");
        assert_eq!(first_byte(&refusal), number as u8, "{refusal:?}");
    }
    let bits = [
        inputs::EMERGENCY_STOP,
        inputs::BOARD_FAULT,
        inputs::OVERRUN,
        inputs::ORIENTATION,
        inputs::NO_ROTATION,
        inputs::AMPLIFIER,
        inputs::SUPPLY,
        inputs::WITHHELD,
    ];
    assert_eq!(bits, [1, 2, 4, 8, 16, 32, 64, 128]);
}

#[test]
fn words_for_a_needle_are_pinned() {
    for (number, tip) in [Tip::Outside, Tip::Holding, Tip::Inside].iter().enumerate() {
        assert_eq!(*tip as usize, number, "{tip:?}");
        assert_eq!(first_byte(tip), number as u8, "{tip:?}");
    }
    let frictions = [Friction::Sticks, Friction::Forward, Friction::Backward];
    for (number, friction) in frictions.iter().enumerate() {
        assert_eq!(*friction as usize, number, "{friction:?}");
        assert_eq!(first_byte(friction), number as u8, "{friction:?}");
    }
}

#[test]
fn words_for_a_thread_are_pinned() {
    for (number, end) in [End::Tail, End::Head].iter().enumerate() {
        assert_eq!(*end as usize, number, "{end:?}");
        assert_eq!(first_byte(end), number as u8, "{end:?}");
    }
    let states = [Tension::Slack, Tension::Taut, Tension::Strained];
    for (number, state) in states.iter().enumerate() {
        assert_eq!(*state as usize, number, "{state:?}");
        assert_eq!(first_byte(state), number as u8, "{state:?}");
    }
}

fn first_byte<T: serde::Serialize>(value: &T) -> u8 {
    let mut buffer = [0; MAX_FRAME];
    postcard::to_slice(value, &mut buffer).expect("fits")[0]
}

#[test]
fn reasons_for_refusal_are_pinned() {
    let pinned = [
        (Reject::Overlong, 1),
        (Reject::Cobs, 2),
        (Reject::Short, 3),
        (Reject::Crc, 4),
        (Reject::Version, 5),
        (Reject::Kind, 6),
        (Reject::ReservedKind, 7),
        (Reject::Body, 8),
        (Reject::Trailing, 9),
        (Reject::Session, 10),
        (Reject::Sequence, 11),
        (Reject::NotFinite, 12),
        (Reject::Range, 13),
        (Reject::Direction, 14),
        (Reject::Schema, 15),
        (Reject::NotSimulated, 16),
        (Reject::FromTheFuture, 17),
        (Reject::TickRate, 18),
        (Reject::FrameSize, 19),
        (Reject::Name, 20),
        (Reject::Nonce, 21),
        (Reject::Owned, 22),
        (Reject::Clock, 23),
    ];
    assert_eq!(Reject::ALL.len(), pinned.len());
    for (reject, number) in pinned {
        assert_eq!(reject as u8, number, "{reject:?}");
        assert_eq!(Reject::from_number(number), Some(reject));
        assert!(!reject.to_string().is_empty());
    }
    assert_eq!(Reject::from_number(0), None);
    assert_eq!(Reject::from_number(24), None);
}

#[test]
fn fault_bits_are_pinned() {
    let pinned = [
        (faults::E_STOP, 1, "e_stop"),
        (faults::NOT_FINITE, 2, "not_finite"),
        (faults::ENCODER_JUMP, 4, "encoder_jump"),
        (faults::OVERRUN, 8, "overrun"),
        (faults::BOARD, 16, "board"),
        (faults::OUT_OF_REACH, 32, "out_of_reach"),
        (faults::OVERSPEED, 64, "overspeed"),
        (faults::TIME_BASE, 128, "time_base"),
        (faults::AMPLIFIER, 256, "amplifier"),
        (faults::SUPPLY, 512, "supply"),
    ];
    assert_eq!(faults::NAMES.len(), pinned.len());
    for (bit, number, name) in pinned {
        assert_eq!(bit, number, "{name}");
        assert!(faults::names(bit).eq([name]));
    }
    assert!(faults::names(0).next().is_none());
    assert!(faults::names(0x8002).eq(["not_finite"]));
}

/// A different hash means that old and new cannot work together: change this number knowingly, together
/// with the golden frames, and say so in the changelog.
#[test]
fn schema_is_pinned() {
    assert_eq!(PROTOCOL_VERSION, 1);
    assert_eq!(SCHEMA_HASH, 0x994d_e167_f567_5d53, "{SCHEMA_HASH:#018x}");
}

/// Counted by hand from the layouts: varints of 3 (u16), 5 (u32, i32) and 10 (u64) bytes, f32 of 4.
#[test]
fn sizes_are_those_counted_by_hand() {
    let joint = 8 * 4 + 5;
    let device = 16 + (1 + 5 * 4) + 3 * joint + 3 * 4 + 3 * 4 + 5;
    let hand = 5 * 4 + 1 + WAY_POINTS * 16;
    assert_eq!(Hello::POSTCARD_MAX_SIZE, 10 + 5 + 5 + 3 + 3 + 1 + 16 + 1);
    assert_eq!(
        State::POSTCARD_MAX_SIZE,
        5 + 16 * 4 + 1 + 3 + 5 + 5 + 5 + 10 + 3 * 5 + 1 + 5
    );
    assert_eq!(Ping::POSTCARD_MAX_SIZE, 10);
    assert_eq!(Pong::POSTCARD_MAX_SIZE, 3 * 10);
    assert_eq!(
        Contact::POSTCARD_MAX_SIZE,
        1 + (3 + 4 + 6 + 21 + 1 + 3 + 1) * 4 + 5
    );
    let numbers = 6 + 1 + 2 + 2 + 1 + 1 + 1;
    let course = 2 + 12 * 2 * 4;
    assert_eq!(
        Needle::POSTCARD_MAX_SIZE,
        1 + 1 + numbers * 4 + 1 + 1 + course
    );
    assert_eq!(Thread::POSTCARD_MAX_SIZE, 4 + (3 + 3) * 4);
    assert_eq!(Fixture::POSTCARD_MAX_SIZE, 1 + (3 + 3 + 1 + 1) * 4);
    assert_eq!(Command::POSTCARD_MAX_SIZE, 1 + 3);
    assert_eq!(Report::POSTCARD_MAX_SIZE, 7 * 5 + 3 + 3 * 5);
    assert_eq!(Simulate::POSTCARD_MAX_SIZE, 1 + hand);
    assert!(device <= hand);
    assert_eq!(HEADER_SIZE, 1 + 1 + 4 + 4 + 8);
    // Header, body, CRC, first stuffing byte, delimiter.
    let packet = 18 + Rows::POSTCARD_MAX_SIZE + 4;
    assert_eq!(MAX_FRAME, packet + packet / 254 + 1 + 1);
    let row = (1 + 5 + 4) + (2 + 6) * 4;
    let entries = 24 * 25 / 2;
    assert_eq!(
        Rows::POSTCARD_MAX_SIZE,
        1 + 21 * 4 + 4 + (1 + 24 * row) + (2 + entries * 4)
    );
    assert_eq!(frame_size(Contact::POSTCARD_MAX_SIZE), 186);
    assert_eq!(frame_size(Needle::POSTCARD_MAX_SIZE), 182);
    assert_eq!(frame_size(Thread::POSTCARD_MAX_SIZE), 52);
    assert_eq!(frame_size(Fixture::POSTCARD_MAX_SIZE), 57);
    assert_eq!(frame_size(State::POSTCARD_MAX_SIZE), 143);
    assert_eq!(frame_size(Hello::POSTCARD_MAX_SIZE), 68);
    assert_eq!(frame_size(Ping::POSTCARD_MAX_SIZE), 34);
    assert_eq!(frame_size(Pong::POSTCARD_MAX_SIZE), 54);
    assert_eq!(MAX_REAL_TIME_FRAME, 220);
}
