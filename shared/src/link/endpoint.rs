//! What both ends of the link have in common: the way from bytes to a checked message of the open
//! session, and the counting. Entry points: [`Endpoint::take_in`], [`Endpoint::send`].

use crate::control::ContactRows;
use crate::wire::{
    Accumulator, Checked, Decoded, Direction, EncodeError, Header, Kind, MAX_FRAME, Message,
    Reject, decode, decode_unsound, encode, hello_version,
};

/// What happened on one end of the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames sent.
    pub frames_sent: u32,
    /// Frames received and accepted.
    pub frames_received: u32,
    /// Frames that never came, by gaps in the sequence. A frame that noise destroyed counts here, and
    /// what is left of it counts as refused.
    pub frames_lost: u32,
    /// Frames refused.
    pub frames_rejected: u32,
    /// Why the last frame was refused.
    pub last_reject: Option<Reject>,
}

/// What is looked at before a frame is used, each on or off.
///
/// A link that is used has all of them; anything else is for finding out whether a test would notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checks {
    /// The checksum is right.
    pub checksum: bool,
    /// The frame is of the open session.
    pub session: bool,
    /// It is newer than the last one.
    pub sequence: bool,
    /// What it was solved for has been.
    pub future: bool,
    /// `Hello`: both ends have the same messages.
    pub schema: bool,
    /// `Hello`: no other host uses the console.
    pub ownership: bool,
    /// A session in which nothing comes is closed.
    pub expiry: bool,
    /// A contact has come with its rows, needle and thread.
    pub companions: bool,
}

impl Checks {
    /// All of them.
    pub const ALL: Checks = Checks {
        checksum: true,
        session: true,
        sequence: true,
        future: true,
        schema: true,
        ownership: true,
        expiry: true,
        companions: true,
    };

    /// Their names.
    pub const NAMES: [&str; 8] = [
        "checksum",
        "session",
        "sequence",
        "future",
        "schema",
        "ownership",
        "expiry",
        "companions",
    ];

    /// Switches off the check of this name, that of its field; false if there is none.
    pub fn switch_off(&mut self, name: &str) -> bool {
        let check = match name {
            "checksum" => &mut self.checksum,
            "session" => &mut self.session,
            "sequence" => &mut self.sequence,
            "future" => &mut self.future,
            "schema" => &mut self.schema,
            "ownership" => &mut self.ownership,
            "expiry" => &mut self.expiry,
            "companions" => &mut self.companions,
            _ => return false,
        };
        *check = false;
        true
    }
}

impl Default for Checks {
    fn default() -> Self {
        Checks::ALL
    }
}

/// What a byte completed.
#[allow(
    clippy::large_enum_variant,
    reason = "lives on the stack for one frame"
)]
pub(super) enum Received {
    /// A message that is right as such; the owner still has to [`Endpoint::settle`] it.
    Message(Checked),
    /// Rows of this sequence, which are unpacked; already counted.
    Rows(u32),
    /// A `Hello` in another version of the protocol; already counted as refused.
    OtherVersion(u8),
}

/// One end of the link.
#[derive(Clone, Debug)]
pub(super) struct Endpoint {
    /// Direction of what this end receives.
    receives: Direction,
    accumulator: Accumulator,
    incoming: Incoming,
    sent_sequence: u32,
    pub(super) checks: Checks,
    pub(super) counters: Counters,
}

impl Endpoint {
    pub(super) fn new(receives: Direction, checks: Checks) -> Self {
        Endpoint {
            receives,
            accumulator: Accumulator::new(),
            incoming: Incoming {
                session: 0,
                sequence: 0,
            },
            sent_sequence: 0,
            checks,
            counters: Counters::default(),
        }
    }

    /// Starts a session, or with 0 ends it.
    pub(super) fn open(&mut self, session: u32) {
        self.incoming = Incoming {
            session,
            sequence: 0,
        };
        self.sent_sequence = 0;
    }

    /// Session that is open; 0: none.
    pub(super) fn session(&self) -> u32 {
        self.incoming.session
    }

    /// Sequence of the last frame sent in this session.
    pub(super) fn sent_sequence(&self) -> u32 {
        self.sent_sequence
    }

    /// Takes bytes up to the first that completes a frame, which then has to be [examined](Self::examine); false if none does.
    pub(super) fn take_in(&mut self, bytes: &mut &[u8]) -> bool {
        self.accumulator.take_in(bytes)
    }

    /// Looks at the frame that is complete. What is refused is counted here. Rows go to where `rows` says, if they are
    /// not of a later console time than the one given there.
    pub(super) fn examine(&mut self, rows: Option<(&mut ContactRows, u64)>) -> Option<Received> {
        let checks = self.checks;
        let read = if checks.checksum {
            decode
        } else {
            decode_unsound
        };
        let outcome = self
            .accumulator
            .packet()
            .and_then(|packet| match read(packet) {
                Ok(decoded) => {
                    if !decoded.header.kind.travels(self.receives) {
                        return Err(Reject::Direction);
                    }
                    let lost = self.incoming.admit(&decoded.header, checks)?;
                    count(&mut self.counters.frames_lost, lost);
                    if decoded.header.kind == Kind::Rows {
                        take_rows(&decoded, self.receives, rows, checks)?;
                        return Ok(Received::Rows(decoded.header.sequence));
                    }
                    let checked = decoded.unpack()?.validate(self.receives)?;
                    Ok(Received::Message(checked))
                }
                Err(Reject::Version) => hello_version(packet)
                    .map(Received::OtherVersion)
                    .ok_or(Reject::Version),
                Err(reject) => Err(reject),
            });
        if let Ok(Received::OtherVersion(_)) = outcome {
            self.reject(Reject::Version);
        }
        if let Ok(Received::Rows(_)) = outcome {
            count(&mut self.counters.frames_received, 1);
        }
        outcome.map_err(|reject| self.reject(reject)).ok()
    }

    /// Why the frame that was examined last was refused, if it is a `Hello` of the other end: a line that echoes gives back one's own.
    pub(super) fn refused_hello(&self) -> Option<Reject> {
        let packet = self.accumulator.packet().ok()?;
        let reject = hello_version(packet).and(self.counters.last_reject)?;
        (reject != Reject::Direction).then_some(reject)
    }

    /// Counts the owner's verdict on a message.
    pub(super) fn settle<T>(&mut self, verdict: Result<T, Reject>) -> Option<T> {
        match verdict {
            Ok(value) => {
                count(&mut self.counters.frames_received, 1);
                Some(value)
            }
            Err(reject) => {
                self.reject(reject);
                None
            }
        }
    }

    fn reject(&mut self, reject: Reject) {
        count(&mut self.counters.frames_rejected, 1);
        self.counters.last_reject = Some(reject);
    }

    /// Writes a frame of the open session (`Hello`: of none) and returns its length.
    pub(super) fn send<M: Message>(
        &mut self,
        console_time_us: u64,
        body: &M,
        out: &mut [u8; MAX_FRAME],
    ) -> Result<usize, EncodeError> {
        let hello = M::KIND == Kind::Hello;
        let sequence = self.sent_sequence.wrapping_add(1);
        let (session, sequence) = if hello {
            (0, 0)
        } else {
            (self.session(), sequence)
        };
        let len = encode(session, sequence, console_time_us, body, out)?;
        if !hello {
            self.sent_sequence = sequence;
        }
        count(&mut self.counters.frames_sent, 1);
        Ok(len)
    }
}

/// Session and sequence of what comes in.
#[derive(Clone, Debug)]
struct Incoming {
    /// 0: none is open.
    session: u32,
    /// Of the newest frame.
    sequence: u32,
}

impl Incoming {
    /// Takes a header if it is next in the open session. Returns how many frames are missing before it.
    fn admit(&mut self, header: &Header, checks: Checks) -> Result<u32, Reject> {
        if header.kind == Kind::Hello {
            return match (header.session, header.sequence) {
                (0, 0) => Ok(0),
                _ => Err(Reject::Session),
            };
        }
        if checks.session && (self.session == 0 || header.session != self.session) {
            return Err(Reject::Session);
        }
        // Serial number arithmetic (RFC 1982): half of the circle is newer, half is older.
        match header.sequence.wrapping_sub(self.sequence) {
            ahead @ 1..=0x7fff_ffff => {
                self.sequence = header.sequence;
                Ok(ahead - 1)
            }
            _ if checks.sequence => Err(Reject::Sequence),
            _ => {
                self.sequence = header.sequence;
                Ok(0)
            }
        }
    }
}

/// Apart, so that other messages do not pay for the stack that these need.
#[inline(never)]
fn take_rows(
    decoded: &Decoded<'_>,
    direction: Direction,
    rows: Option<(&mut ContactRows, u64)>,
    checks: Checks,
) -> Result<(), Reject> {
    let frame = decoded.rows(direction)?;
    let (rows, now_us) = rows.ok_or(Reject::Direction)?;
    if checks.future && frame.console_time_us() > now_us {
        return Err(Reject::FromTheFuture);
    }
    rows.unpack_from(&frame);
    Ok(())
}

/// Counters stop at the top instead of starting over.
fn count(counter: &mut u32, by: u32) {
    *counter = counter.saturating_add(by);
}
