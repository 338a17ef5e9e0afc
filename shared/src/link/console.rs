//! The console's end of the link. Entry points: [`ConsoleLink::receive`] for every byte that comes in,
//! [`ConsoleLink::take_reply`] and then [`ConsoleLink::encode_state`] for what goes out, [`ConsoleLink::expire`] every tick.

use super::companions::Companions;
use super::endpoint::{Checks, Counters, Endpoint, Received};
use crate::control::ContactRows;
use crate::mutant::stands;
use crate::wire::message::{Command, Hello, Ping, Pong, Refusal, Report, State};
use crate::wire::{
    Checked, Direction, Kind, MAX_FRAME, Message, Reject, SCHEMA_HASH, ValidCommand, ValidContact,
    ValidFixture, ValidNeedle, ValidSimulate, ValidThread,
};

/// How long after a frame of its host a session is out of reach of other hosts \[us\]: three pings.
pub const OWNED_FOR_US: u64 = 300_000;
/// How long after the last frame of its host a session is closed \[us\].
pub const EXPIRES_AFTER_US: u64 = 1_000_000;
/// Least time between two answers to a `Hello` that opens nothing \[us\]: a host that floods the line with them is left without.
pub const REFUSED_EVERY_US: u64 = 100_000;

/// What a console says of itself in its `Hello`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Control rate \[Hz\].
    pub tick_hz: u16,
    /// Whether motors and hand are simulated.
    pub simulated: bool,
    /// Name in UTF-8, padded with zeros. An empty one is sent as "console".
    pub device_name: [u8; 16],
}

/// What a byte brought.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives on the stack until it is applied"
)]
pub enum LinkEvent {
    /// A new session: disarm and forget the contact.
    SessionOpened,
    /// Nothing came for so long that the session is over: disarm and forget the contact.
    SessionClosed,
    /// The newest contact.
    Contact(ValidContact),
    /// Rows: see [`ConsoleLink::rows`].
    Rows,
    /// The newest state of a needle.
    Needle(ValidNeedle),
    /// The newest state of a thread.
    Thread(ValidThread),
    /// What the console renders by itself from now on.
    Fixture(ValidFixture),
    /// An order; [`Command::StateEvery`] is already obeyed.
    Command(ValidCommand),
    /// An order to the simulation; never on a console with motors.
    Simulate(ValidSimulate),
}

/// The console's end of the link.
#[derive(Clone, Debug)]
pub struct ConsoleLink {
    endpoint: Endpoint,
    identity: Identity,
    seed: u32,
    hellos: u32,
    reply: Option<Hello>,
    /// Console time of the last refusal \[us\].
    refused_us: Option<u64>,
    state_every: u16,
    rows: ContactRows,
    companions: Companions,
    /// Console time of the last frame of the session, or of its opening \[us\].
    heard_us: u64,
    /// Console time until which the session is its host's \[us\].
    owned_until_us: u64,
    /// The newest ping, and when it was taken in \[us\].
    ping: Option<(Ping, u64)>,
}

impl ConsoleLink {
    /// A link without a session.
    ///
    /// `seed` should differ from boot to boot (entropy, or a boot counter); it makes session numbers
    /// that were given before a reset useless after it.
    pub fn new(identity: Identity, seed: u32) -> Self {
        ConsoleLink::with_checks(identity, seed, Checks::ALL)
    }

    /// Like [`new`](Self::new), with some checks off: to find out whether a test would notice. Nothing on the wire
    /// reaches this.
    pub fn with_checks(mut identity: Identity, seed: u32, checks: Checks) -> Self {
        if identity.device_name == [0; 16] {
            // The name also tells a console's Hello from a host's.
            identity.device_name = *b"console\0\0\0\0\0\0\0\0\0";
        }
        ConsoleLink {
            endpoint: Endpoint::new(Direction::ToConsole, checks),
            identity,
            seed,
            hellos: 0,
            reply: None,
            refused_us: None,
            state_every: 1,
            rows: ContactRows::NONE,
            companions: Companions::NONE,
            heard_us: 0,
            owned_until_us: 0,
            ping: None,
        }
    }

    /// Takes bytes that came at console time `now_us`, up to the frame that brings something: `bytes` is what is left of them then, and
    /// empty if none does. What is refused is only counted.
    pub fn receive(&mut self, bytes: &mut &[u8], now_us: u64) -> Option<LinkEvent> {
        while self.endpoint.take_in(bytes) {
            let event = self.frame(now_us);
            if event.is_some() {
                return event;
            }
        }
        None
    }

    /// Apart, so that the many bytes within a frame do not pay for the registers and the stack that the
    /// one at its end needs.
    #[inline(never)]
    fn frame(&mut self, now_us: u64) -> Option<LinkEvent> {
        match self.endpoint.examine(Some((&mut self.rows, now_us)))? {
            Received::Rows(sequence) => {
                self.hear(now_us);
                let (tool, time_us) = (self.rows.tool(), self.rows.console_time_us());
                self.companions.note(Kind::Rows, sequence, tool, time_us);
                Some(LinkEvent::Rows)
            }
            Received::OtherVersion(_) => {
                // Its nonce may stand anywhere. The answer's first byte says what differs.
                self.refuse(0, Refusal::None, now_us);
                None
            }
            Received::Message(message) => {
                let verdict = self.judge(message, now_us);
                self.endpoint.settle(verdict)?
            }
        }
    }

    /// A frame of the session has been accepted.
    fn hear(&mut self, now_us: u64) {
        self.heard_us = now_us;
        self.owned_until_us = now_us.saturating_add(OWNED_FOR_US);
    }

    /// Closes a session in which nothing has come for [`EXPIRES_AFTER_US`]. To be asked every tick.
    pub fn expire(&mut self, now_us: u64) -> Option<LinkEvent> {
        let quiet_us = now_us.saturating_sub(self.heard_us);
        if quiet_us < EXPIRES_AFTER_US || !self.endpoint.checks.expiry {
            return None;
        }
        self.close(now_us)
    }

    /// Closes the session whose line has ended.
    pub fn close(&mut self, now_us: u64) -> Option<LinkEvent> {
        if !self.is_open() {
            return None;
        }
        self.begin(0, now_us);
        Some(LinkEvent::SessionClosed)
    }

    /// Has the session that another console has opened, by its number: for replays of what went over that one's line.
    pub fn adopt(&mut self, session: u32, now_us: u64) {
        self.begin(session, now_us);
    }

    /// From here on, this session; with 0 none.
    fn begin(&mut self, session: u32, now_us: u64) {
        self.endpoint.open(session);
        self.state_every = 1;
        self.rows = ContactRows::NONE;
        self.companions = Companions::NONE;
        self.heard_us = now_us;
        self.owned_until_us = 0;
        self.ping = None;
    }

    /// What a frame brought, if it is for others than the link itself.
    fn judge(&mut self, message: Checked, now_us: u64) -> Result<Option<LinkEvent>, Reject> {
        let (header, tool) = (*message.header(), message.tool());
        let event = self.open_or_use(message, now_us)?;
        if matches!(event, Some(LinkEvent::SessionOpened)) {
            return Ok(event);
        }
        self.hear(now_us);
        let is_whole =
            self.companions
                .note(header.kind, header.sequence, tool, header.console_time_us);
        let can_be_used = is_whole || !self.endpoint.checks.companions;
        Ok(event.filter(|_| can_be_used))
    }

    fn open_or_use(&mut self, message: Checked, now_us: u64) -> Result<Option<LinkEvent>, Reject> {
        match message {
            Checked::Hello(hello) => {
                let nonce = hello.body().nonce;
                if let Err(reject) = self.agree(hello.body(), now_us) {
                    self.refuse(nonce, refusal(reject), now_us);
                    return Err(reject);
                }
                let session = self.next_session(nonce);
                self.reply = Some(self.hello(nonce, session, Refusal::None));
                self.begin(session, now_us);
                Ok(Some(LinkEvent::SessionOpened))
            }
            Checked::Contact(contact) => {
                self.past(contact.console_time_us(), now_us)?;
                Ok(Some(LinkEvent::Contact(contact)))
            }
            Checked::Needle(needle) => {
                self.past(needle.console_time_us(), now_us)?;
                Ok(Some(LinkEvent::Needle(needle)))
            }
            Checked::Thread(thread) => {
                self.past(thread.console_time_us(), now_us)?;
                Ok(Some(LinkEvent::Thread(thread)))
            }
            Checked::Fixture(fixture) => Ok(Some(LinkEvent::Fixture(fixture))),
            Checked::Command(command) => {
                if let Command::StateEvery { ticks } = *command.body() {
                    self.state_every = ticks;
                }
                Ok(Some(LinkEvent::Command(command)))
            }
            Checked::Ping(ping) => {
                self.ping = Some((*ping.body(), now_us));
                Ok(None)
            }
            Checked::Simulate(_) if !self.identity.simulated => Err(Reject::NotSimulated),
            Checked::Simulate(simulate) => Ok(Some(LinkEvent::Simulate(simulate))),
            Checked::State(_) | Checked::Report(_) | Checked::Pong(_) => Err(Reject::Direction),
        }
    }

    /// Answers a `Hello` that opens nothing, unless another one was answered so within [`REFUSED_EVERY_US`].
    fn refuse(&mut self, nonce: u32, refusal: Refusal, now_us: u64) {
        let is_early = |before: u64| now_us.saturating_sub(before) < REFUSED_EVERY_US;
        if self.refused_us.is_some_and(is_early) && stands("refusals_apart") {
            return;
        }
        self.refused_us = Some(now_us);
        self.reply = Some(self.hello(nonce, 0, refusal));
    }

    /// Whether a state of that console time has been.
    fn past(&self, console_time_us: u64, now_us: u64) -> Result<(), Reject> {
        if self.endpoint.checks.future && console_time_us > now_us {
            Err(Reject::FromTheFuture)
        } else {
            Ok(())
        }
    }

    fn agree(&self, host: &Hello, now_us: u64) -> Result<(), Reject> {
        let checks = self.endpoint.checks;
        if checks.schema && host.schema_hash != SCHEMA_HASH {
            Err(Reject::Schema)
        } else if host.tick_hz != self.identity.tick_hz {
            Err(Reject::TickRate)
        } else if usize::from(host.max_frame) < MAX_FRAME {
            Err(Reject::FrameSize)
        } else if checks.ownership && self.is_open() && now_us < self.owned_until_us {
            Err(Reject::Owned)
        } else {
            Ok(())
        }
    }

    /// A number that no earlier session is likely to have had: the finalizer of MurmurHash3 (Appleby
    /// 2011) over the host's nonce, this boot's seed and a count.
    fn next_session(&mut self, nonce: u32) -> u32 {
        loop {
            self.hellos = self.hellos.wrapping_add(1);
            let mut x = nonce ^ self.seed.rotate_left(16);
            x = x.wrapping_add(self.hellos.wrapping_mul(0x9e37_79b9));
            x = (x ^ (x >> 16)).wrapping_mul(0x85eb_ca6b);
            x = (x ^ (x >> 13)).wrapping_mul(0xc2b2_ae35);
            x ^= x >> 16;
            // Two of 2^32 counts at most are passed over: each gives another number.
            if x != 0 && x != self.endpoint.session() {
                return x;
            }
        }
    }

    fn hello(&self, nonce: u32, session: u32, refusal: Refusal) -> Hello {
        Hello {
            schema_hash: SCHEMA_HASH,
            nonce,
            session,
            tick_hz: self.identity.tick_hz,
            max_frame: MAX_FRAME as u16,
            simulated: self.identity.simulated,
            device_name: self.identity.device_name,
            refusal,
        }
    }

    /// The newest rows of this session, unpacked: those of a contact of the same console time, which comes after them.
    pub fn rows(&self) -> &ContactRows {
        &self.rows
    }

    /// Whether an answer to a `Hello` waits for [`take_reply`](Self::take_reply).
    pub fn reply_waits(&self) -> bool {
        self.reply.is_some()
    }

    /// Writes the answer to the last `Hello`, if one waits, and returns its length.
    pub fn take_reply(&mut self, now_us: u64, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        let hello = self.reply.take()?;
        self.endpoint.send(now_us, &hello, out).ok()
    }

    /// Writes a `State` frame and returns its length \[bytes\]; 0 while there is nobody to send it to:
    /// no session is open, or the answer that opens it has not been taken yet.
    pub fn encode_state(&mut self, now_us: u64, state: &State, out: &mut [u8; MAX_FRAME]) -> usize {
        self.encode(now_us, state, out)
    }

    /// Like [`encode_state`](Self::encode_state) for a `Report`, whose four counts of received frames
    /// are filled in here.
    pub fn encode_report(
        &mut self,
        now_us: u64,
        report: &Report,
        out: &mut [u8; MAX_FRAME],
    ) -> usize {
        let counters = self.endpoint.counters;
        let report = Report {
            frames_received: counters.frames_received,
            frames_lost: counters.frames_lost,
            frames_rejected: counters.frames_rejected,
            last_reject: counters.last_reject.map_or(0, |reject| reject as u8),
            ..*report
        };
        self.encode(now_us, &report, out)
    }

    /// Writes the answer to the newest ping, if one waits; like [`encode_state`](Self::encode_state). `now_us` is the
    /// console's clock when the frame leaves.
    pub fn encode_pong(&mut self, now_us: u64, out: &mut [u8; MAX_FRAME]) -> usize {
        let Some((ping, received_us)) = self.ping.take() else {
            return 0;
        };
        let pong = Pong {
            host_us: ping.host_us,
            received_us,
            sent_us: now_us,
        };
        self.encode(now_us, &pong, out)
    }

    fn encode<M: Message>(&mut self, now_us: u64, body: &M, out: &mut [u8; MAX_FRAME]) -> usize {
        if !self.is_open() || self.reply.is_some() {
            return 0;
        }
        self.endpoint.send(now_us, body, out).unwrap_or(0)
    }

    /// Whether a session is open.
    pub fn is_open(&self) -> bool {
        self.endpoint.session() != 0
    }

    /// Ticks between two `State` frames, from [`Command::StateEvery`]; 1 at the start of a session.
    pub fn state_every(&self) -> u16 {
        self.state_every
    }

    /// Counts since boot.
    pub fn counters(&self) -> Counters {
        self.endpoint.counters
    }
}

/// What a host that is turned away is told.
fn refusal(reject: Reject) -> Refusal {
    match reject {
        Reject::Schema => Refusal::Schema,
        Reject::TickRate => Refusal::TickRate,
        Reject::FrameSize => Refusal::FrameSize,
        Reject::Owned => Refusal::Owned,
        _ => Refusal::None,
    }
}
