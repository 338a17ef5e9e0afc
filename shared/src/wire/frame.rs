//! Frame on the wire: COBS(header | postcard body | CRC-32) 0x00, all integers little endian.
//!
//! Entry points: [`encode`] on one end, [`Accumulator`](super::Accumulator) and then [`decode`] on the
//! other. COBS is that
//! of Cheshire & Baker 1999 (the `cobs` crate's state machines), the CRC is CRC-32/ISO-HDLC.
//!
//! In every version of the protocol byte 0 is the version, byte 1 the kind, kind 1 is `Hello`, and the
//! last four bytes are the CRC, so that peers of two versions can at least tell each other theirs.

use super::message::{
    Command, Contact, Hello, Needle, Ping, Pong, Report, Rows, Simulate, State, Thread,
};
use super::{PROTOCOL_VERSION, Reject, validate::Message};
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc, Digest, Table};
use postcard::experimental::max_size::MaxSize;

/// Bytes of a [`Header`] on the wire.
pub const HEADER_SIZE: usize = 18;
/// Bytes of the checksum.
const CRC_SIZE: usize = 4;

/// Bytes of the largest body.
const MAX_BODY: usize = largest(&[
    Hello::POSTCARD_MAX_SIZE,
    State::POSTCARD_MAX_SIZE,
    Contact::POSTCARD_MAX_SIZE,
    Command::POSTCARD_MAX_SIZE,
    Report::POSTCARD_MAX_SIZE,
    Simulate::POSTCARD_MAX_SIZE,
    Ping::POSTCARD_MAX_SIZE,
    Pong::POSTCARD_MAX_SIZE,
    Needle::POSTCARD_MAX_SIZE,
    Thread::POSTCARD_MAX_SIZE,
    Rows::POSTCARD_MAX_SIZE,
]);
/// Bytes of the largest packet (header, body and CRC, before byte stuffing).
pub(super) const MAX_PACKET: usize = HEADER_SIZE + MAX_BODY + CRC_SIZE;
/// Bytes of the largest frame, byte stuffing and delimiter included.
pub const MAX_FRAME: usize = frame_size(MAX_BODY);
/// Bytes that a frame of the 1 kHz traffic may have: a 12 kB/s line then carries 54 of them a second.
pub const MAX_REAL_TIME_FRAME: usize = 220;

/// Bytes of the largest `State`, and of the largest `Contact`.
pub const MAX_STATE_FRAME: usize = frame_size(State::POSTCARD_MAX_SIZE);
/// See [`MAX_STATE_FRAME`].
pub const MAX_CONTACT_FRAME: usize = frame_size(Contact::POSTCARD_MAX_SIZE);

const _: () = assert!(MAX_STATE_FRAME <= MAX_REAL_TIME_FRAME);
const _: () = assert!(MAX_CONTACT_FRAME <= MAX_REAL_TIME_FRAME);
const _: () = assert!(frame_size(Needle::POSTCARD_MAX_SIZE) <= MAX_REAL_TIME_FRAME);
const _: () = assert!(frame_size(Thread::POSTCARD_MAX_SIZE) <= MAX_REAL_TIME_FRAME);
// `Hello::max_frame` is a u16.
const _: () = assert!(MAX_FRAME <= u16::MAX as usize);

/// Bytes of the whole frame around a body of at most `body` bytes: one stuffing byte to begin with and
/// one after every 254 bytes, and the delimiter.
pub const fn frame_size(body: usize) -> usize {
    let packet = HEADER_SIZE + body + CRC_SIZE;
    packet + packet / 254 + 1 + 1
}

const fn largest(sizes: &[usize]) -> usize {
    let mut max = 0;
    let mut i = 0;
    while i < sizes.len() {
        if sizes[i] > max {
            max = sizes[i];
        }
        i += 1;
    }
    max
}

/// One table of 256 words: 1 KiB of flash. Without a table a byte costs 35 instructions more on a
/// Cortex-M4, a `State` 7400 instead of 3500 of the 168000 in a tick; 16 tables would take 16 KiB of
/// flash and gain little on frames of 200 bytes.
static CRC_32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// What a frame carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Kind {
    /// [`Hello`], both ways, outside any session.
    Hello = 1,
    /// [`State`], from the console.
    State = 2,
    /// [`Contact`], from the host.
    Contact = 3,
    /// [`Command`], from the host.
    Command = 4,
    /// [`Report`], from the console.
    Report = 5,
    /// [`Simulate`], from the host.
    Simulate = 6,
    /// [`Ping`], from the host.
    Ping = 7,
    /// [`Pong`], from the console.
    Pong = 8,
    /// [`Rows`], from the host.
    Rows = 16,
    /// [`Needle`], from the host.
    Needle = 17,
    /// [`Thread`], from the host.
    Thread = 18,
    /// Reserved: several tools at once.
    Tools = 19,
    /// [`Fixture`](super::message::Fixture), from the host.
    Fixture = 20,
}

impl Kind {
    /// The kind with this number, if it exists and this version uses it.
    fn from_number(number: u8) -> Result<Kind, Reject> {
        Ok(match number {
            1 => Kind::Hello,
            2 => Kind::State,
            3 => Kind::Contact,
            4 => Kind::Command,
            5 => Kind::Report,
            6 => Kind::Simulate,
            7 => Kind::Ping,
            8 => Kind::Pong,
            16 => Kind::Rows,
            17 => Kind::Needle,
            18 => Kind::Thread,
            19 => return Err(Reject::ReservedKind),
            20 => Kind::Fixture,
            _ => return Err(Reject::Kind),
        })
    }
}

/// First part of every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Protocol version of the sender.
    pub version: u8,
    /// What the body is.
    pub kind: Kind,
    /// Session that the console gave in its `Hello`; 0 for `Hello` itself.
    pub session: u32,
    /// Counts the frames of one direction in one session, whatever their kind, from 1; 0 for `Hello`.
    pub sequence: u32,
    /// Console time \[us since boot\]: when the encoders were read (`State`), of the `State` that was
    /// solved for (`Contact`, `Needle`, `Thread`), when sent (other frames from the console), 0 in `Hello` from the host.
    pub console_time_us: u64,
}

impl Header {
    fn to_bytes(self) -> [u8; HEADER_SIZE] {
        let [s0, s1, s2, s3] = self.session.to_le_bytes();
        let [n0, n1, n2, n3] = self.sequence.to_le_bytes();
        let [t0, t1, t2, t3, t4, t5, t6, t7] = self.console_time_us.to_le_bytes();
        let (version, kind) = (self.version, self.kind as u8);
        [
            version, kind, s0, s1, s2, s3, n0, n1, n2, n3, t0, t1, t2, t3, t4, t5, t6, t7,
        ]
    }

    fn from_bytes(bytes: &[u8; HEADER_SIZE]) -> Result<Self, Reject> {
        let [
            version,
            kind,
            s0,
            s1,
            s2,
            s3,
            n0,
            n1,
            n2,
            n3,
            t0,
            t1,
            t2,
            t3,
            t4,
            t5,
            t6,
            t7,
        ] = *bytes;
        Ok(Header {
            version,
            kind: Kind::from_number(kind)?,
            session: u32::from_le_bytes([s0, s1, s2, s3]),
            sequence: u32::from_le_bytes([n0, n1, n2, n3]),
            console_time_us: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
        })
    }
}

/// The frame did not fit into its buffer. Cannot happen for this crate's messages, whose sizes are
/// checked at compile time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "message does not fit into a frame of {MAX_FRAME} bytes")
    }
}

impl core::error::Error for EncodeError {}

/// Writes one whole frame into `out`, delimiter included, and returns its length \[bytes\].
///
/// Does not check the body: see [`Message::check`].
///
/// # Errors
/// [`EncodeError`] if the frame does not fit; never for this crate's messages.
pub fn encode<M: Message>(
    session: u32,
    sequence: u32,
    console_time_us: u64,
    body: &M,
    out: &mut [u8; MAX_FRAME],
) -> Result<usize, EncodeError> {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: M::KIND,
        session,
        sequence,
        console_time_us,
    };
    let mut writer = Writer::new(out);
    writer
        .write(&header.to_bytes())
        .and_then(|()| postcard::serialize_with_flavor(body, writer))
        .map_err(|_| EncodeError)
}

/// Stuffs and sums what postcard writes, byte by byte, straight into the frame.
struct Writer<'a> {
    out: &'a mut [u8; MAX_FRAME],
    len: usize,
    stuffing: cobs::EncoderState,
    crc: Digest<'static, u32, Table<1>>,
}

impl<'a> Writer<'a> {
    fn new(out: &'a mut [u8; MAX_FRAME]) -> Self {
        Writer {
            out,
            // The first byte becomes the first block's length.
            len: 1,
            stuffing: cobs::EncoderState::default(),
            crc: CRC_32.digest(),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        self.crc.update(bytes);
        bytes.iter().try_for_each(|byte| self.stuff(*byte))
    }

    fn stuff(&mut self, byte: u8) -> postcard::Result<()> {
        match self.stuffing.push(byte) {
            cobs::PushResult::AddSingle(byte) => self.put(byte),
            cobs::PushResult::ModifyFromStartAndSkip((index, value)) => {
                self.set(index, value)?;
                self.put(0)
            }
            cobs::PushResult::ModifyFromStartAndPushAndSkip((index, value, byte)) => {
                self.set(index, value)?;
                self.put(byte)?;
                self.put(0)
            }
        }
    }

    fn put(&mut self, byte: u8) -> postcard::Result<()> {
        self.set(self.len, byte)?;
        self.len += 1;
        Ok(())
    }

    fn set(&mut self, index: usize, byte: u8) -> postcard::Result<()> {
        let place = self.out.get_mut(index);
        *place.ok_or(postcard::Error::SerializeBufferFull)? = byte;
        Ok(())
    }
}

impl postcard::ser_flavors::Flavor for Writer<'_> {
    type Output = usize;

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        self.write(data)
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.write(&[data])
    }

    fn finalize(mut self) -> postcard::Result<usize> {
        let crc = self.crc.clone().finalize();
        for byte in crc.to_le_bytes() {
            self.stuff(byte)?;
        }
        let (index, value) = self.stuffing.clone().finalize();
        self.set(index, value)?;
        self.put(0)?;
        Ok(self.len)
    }
}

/// A packet whose checksum, version and kind are right; nothing is known about its body.
#[derive(Clone, Copy, Debug)]
pub struct Decoded<'a> {
    /// The header.
    pub header: Header,
    pub(super) body: &'a [u8],
}

/// Checks a packet from [`Accumulator::push`](super::Accumulator::push): CRC, version, length, kind.
///
/// # Errors
/// [`Reject::Crc`]; then [`Reject::Version`], as all else may differ in another version; then
/// [`Reject::Short`], [`Reject::ReservedKind`] or [`Reject::Kind`].
pub fn decode(packet: &[u8]) -> Result<Decoded<'_>, Reject> {
    take_apart(sound_content(packet)?)
}

/// Like [`decode`], whatever the checksum says: see [`Checks`](crate::link::Checks).
pub(crate) fn decode_unsound(packet: &[u8]) -> Result<Decoded<'_>, Reject> {
    let (content, _) = packet.split_last_chunk::<CRC_SIZE>().ok_or(Reject::Short)?;
    take_apart(content)
}

fn take_apart(content: &[u8]) -> Result<Decoded<'_>, Reject> {
    if content
        .first()
        .is_some_and(|version| *version != PROTOCOL_VERSION)
    {
        return Err(Reject::Version);
    }
    let (header, body) = content.split_first_chunk().ok_or(Reject::Short)?;
    Ok(Decoded {
        header: Header::from_bytes(header)?,
        body,
    })
}

/// The packet without its checksum, which is right.
fn sound_content(packet: &[u8]) -> Result<&[u8], Reject> {
    let (content, crc) = packet.split_last_chunk().ok_or(Reject::Short)?;
    if CRC_32.checksum(content) != u32::from_le_bytes(*crc) {
        return Err(Reject::Crc);
    }
    Ok(content)
}

/// Version of the peer, if `packet` is a sound `Hello` of any version.
pub(crate) fn hello_version(packet: &[u8]) -> Option<u8> {
    match sound_content(packet) {
        Ok([version, kind, ..]) if *kind == Kind::Hello as u8 => Some(*version),
        _ => None,
    }
}
