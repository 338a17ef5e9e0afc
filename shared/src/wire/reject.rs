//! Why a received frame was refused. Nothing of a refused frame is used.

use core::fmt;

/// Why a frame was refused; the numbers are pinned and go into [`Report`](super::message::Report).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Reject {
    /// Longer than the largest frame.
    Overlong = 1,
    /// A delimiter inside a COBS block: bytes are missing.
    Cobs = 2,
    /// Too short for a header and a CRC.
    Short = 3,
    /// The CRC differs.
    Crc = 4,
    /// Another protocol version.
    Version = 5,
    /// A kind that does not exist.
    Kind = 6,
    /// A kind that is reserved for a later version.
    ReservedKind = 7,
    /// The body does not decode.
    Body = 8,
    /// Bytes are left after the body.
    Trailing = 9,
    /// No session is open, or the frame belongs to another one.
    Session = 10,
    /// A duplicate, or older than one already received.
    Sequence = 11,
    /// A number is not finite.
    NotFinite = 12,
    /// A value is outside its range, or a direction or rotation is not of unit length.
    Range = 13,
    /// A message that this end only ever sends.
    Direction = 14,
    /// `Hello`: the peer's messages have another layout.
    Schema = 15,
    /// Orders for a simulation, sent to a console that has motors.
    NotSimulated = 16,
    /// Solved for a console time that has not come yet.
    FromTheFuture = 17,
    /// `Hello`: the peer expects another control rate.
    TickRate = 18,
    /// `Hello`: the peer cannot take the largest frame.
    FrameSize = 19,
    /// A name is not UTF-8 padded with zeros, or has control characters.
    Name = 20,
    /// `Hello`: an answer to a question that was not asked, or no longer is.
    Nonce = 21,
    /// `Hello`: another host has a session and uses it.
    Owned = 22,
    /// `State`: its tick or its console time does not go on from the last one's.
    Clock = 23,
}

impl Reject {
    /// All reasons, in the order of their numbers.
    pub const ALL: [Reject; 23] = [
        Reject::Overlong,
        Reject::Cobs,
        Reject::Short,
        Reject::Crc,
        Reject::Version,
        Reject::Kind,
        Reject::ReservedKind,
        Reject::Body,
        Reject::Trailing,
        Reject::Session,
        Reject::Sequence,
        Reject::NotFinite,
        Reject::Range,
        Reject::Direction,
        Reject::Schema,
        Reject::NotSimulated,
        Reject::FromTheFuture,
        Reject::TickRate,
        Reject::FrameSize,
        Reject::Name,
        Reject::Nonce,
        Reject::Owned,
        Reject::Clock,
    ];

    /// The reason with this number, as found in [`Report::last_reject`](super::message::Report::last_reject).
    pub fn from_number(number: u8) -> Option<Reject> {
        Self::ALL.into_iter().find(|reject| *reject as u8 == number)
    }
}

impl fmt::Display for Reject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Reject::Overlong => "longer than the largest frame",
            Reject::Cobs => "cut short (broken byte stuffing)",
            Reject::Short => "too short for header and checksum",
            Reject::Crc => "wrong checksum",
            Reject::Version => "another protocol version",
            Reject::Kind => "unknown kind of message",
            Reject::ReservedKind => "kind of message that this version only reserves",
            Reject::Body => "body does not decode",
            Reject::Trailing => "bytes left after the body",
            Reject::Session => "not of the open session",
            Reject::Sequence => "duplicate or out of order",
            Reject::NotFinite => "a number is not finite",
            Reject::Range => "a value is out of range",
            Reject::Direction => "message in the wrong direction",
            Reject::Schema => "another message schema",
            Reject::NotSimulated => "order for a simulation, but the console has motors",
            Reject::FromTheFuture => "solved for a console time that has not come yet",
            Reject::TickRate => "another control rate",
            Reject::FrameSize => "peer cannot take the largest frame",
            Reject::Name => "a name is not plain UTF-8 padded with zeros",
            Reject::Nonce => "answer to a handshake that is not under way",
            Reject::Owned => "the console is in use by another host",
            Reject::Clock => {
                "its clock does not go on: ticks or times that go back, stand still or jump"
            }
        })
    }
}

impl core::error::Error for Reject {}
