//! The host's end of the link. Entry points: [`HostLink::hello`], then [`HostLink::receive`] for every
//! byte that comes in and [`HostLink::send`] for what goes out.

use super::endpoint::{Checks, Counters, Endpoint, Received};
use crate::wire::message::{Hello, Pong, Refusal, Report, State};
use crate::wire::{
    Checked, Direction, EncodeError, MAX_FRAME, Message, PROTOCOL_VERSION, Reject, SCHEMA_HASH,
    Valid,
};
use core::fmt;

/// Why the two ends do not work together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mismatch {
    /// Another protocol version.
    Version {
        /// The console's.
        console: u8,
    },
    /// Messages of another layout under the same version.
    Schema {
        /// The console's.
        console: u64,
    },
    /// Another control rate.
    TickRate {
        /// The console's \[Hz\].
        console: u16,
        /// The host's \[Hz\].
        host: u16,
    },
    /// The console cannot take the host's largest frame.
    FrameSize {
        /// The console's limit \[bytes\].
        console: u16,
    },
    /// The console gave no session although this end finds no difference.
    Refused {
        /// Its reason.
        refusal: Refusal,
        /// Its control rate \[Hz\].
        tick_hz: u16,
        /// Its largest frame \[bytes\].
        max_frame: u16,
    },
    /// The console's answer breaks the protocol's rules.
    Unusable(Reject),
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Mismatch::Version { console } => write!(
                f,
                "the console speaks protocol version {console}, this program version \
                 {PROTOCOL_VERSION}: use firmware and program of one release"
            ),
            Mismatch::Schema { console } => write!(
                f,
                "the console's messages have schema {console:016x}, this program's {SCHEMA_HASH:016x}: \
                 use firmware and program of one release"
            ),
            Mismatch::TickRate { console, host } => write!(
                f,
                "the console's control rate is {console} Hz, this program expects {host} Hz"
            ),
            Mismatch::FrameSize { console } => write!(
                f,
                "the console takes frames of at most {console} bytes, this program's have up to {MAX_FRAME}"
            ),
            Mismatch::Refused {
                refusal,
                tick_hz,
                max_frame,
            } => {
                f.write_str("the console refused the session")?;
                match refusal {
                    Refusal::None => f.write_str(" without a reason"),
                    Refusal::Schema => f.write_str(
                        ": it takes messages of another layout; use firmware and program of one release",
                    ),
                    Refusal::TickRate => {
                        write!(f, ": it takes another control rate, and says that its own is {tick_hz} Hz")
                    }
                    Refusal::FrameSize => write!(
                        f,
                        ": it needs larger frames than this program's of {MAX_FRAME} bytes, and takes up to {max_frame}"
                    ),
                    Refusal::Owned => f.write_str(": another host uses it"),
                }
            }
            Mismatch::Unusable(reject) => {
                write!(
                    f,
                    "what the console says of itself cannot be used: {reject}"
                )
            }
        }
    }
}

impl core::error::Error for Mismatch {}

/// Why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    /// No session is open.
    NoSession,
    /// The console would refuse it for this reason.
    Invalid(Reject),
    /// It does not fit into a frame.
    Encode(EncodeError),
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SendError::NoSession => f.write_str("no session with the console is open"),
            SendError::Invalid(reject) => write!(f, "the console would refuse it: {reject}"),
            SendError::Encode(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for SendError {}

/// What a byte brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HostEvent {
    /// The console answered and opened a session.
    Opened(Hello),
    /// The console answered, but the two ends do not work together.
    Refused(Mismatch),
    /// The console answered that another host uses it: it may be asked again.
    Owned,
    /// A state of the console.
    State(Valid<State>),
    /// The console's counters.
    Report(Valid<Report>),
    /// The answer to a ping.
    Pong(Valid<Pong>),
}

/// The host's end of the link.
#[derive(Clone, Debug)]
pub struct HostLink {
    endpoint: Endpoint,
    tick_hz: u16,
    /// Nonce of the `Hello` that waits for its answer.
    asked: Option<u32>,
    /// Why an answer to it was not taken.
    refused: Option<Reject>,
    /// Tick and console time of the newest state in this session \[us\].
    newest: Option<(u32, u64)>,
}

impl HostLink {
    /// A link without a session, to a console that runs at `tick_hz`.
    pub fn new(tick_hz: u16) -> Self {
        HostLink {
            endpoint: Endpoint::new(Direction::ToHost, Checks::ALL),
            tick_hz,
            asked: None,
            refused: None,
            newest: None,
        }
    }

    /// Ends the session and writes a `Hello` that asks for a new one; returns its length \[bytes\].
    ///
    /// `nonce` should be random, and another one at every attempt: an answer to an earlier attempt that
    /// comes late is then not mistaken for this one's.
    ///
    /// # Errors
    /// [`EncodeError`]: never, see there.
    pub fn hello(&mut self, nonce: u32, out: &mut [u8; MAX_FRAME]) -> Result<usize, EncodeError> {
        self.endpoint.open(0);
        (self.asked, self.refused) = (Some(nonce), None);
        let hello = Hello {
            schema_hash: SCHEMA_HASH,
            nonce,
            session: 0,
            tick_hz: self.tick_hz,
            max_frame: MAX_FRAME as u16,
            simulated: false,
            device_name: [0; 16],
            refusal: Refusal::None,
        };
        self.endpoint.send(0, &hello, out)
    }

    /// Takes one byte. What is refused is only counted.
    pub fn receive(&mut self, byte: u8) -> Option<HostEvent> {
        if !self.endpoint.take_in(&mut &[byte][..]) {
            return None;
        }
        let Some(received) = self.endpoint.examine(None) else {
            if self.asked.is_some() {
                self.refused = self.endpoint.refused_hello().or(self.refused);
            }
            return None;
        };
        match received {
            Received::OtherVersion(console) => {
                self.asked.take()?;
                Some(HostEvent::Refused(Mismatch::Version { console }))
            }
            Received::Rows(_) => None,
            Received::Message(message) => {
                let verdict = self.judge(message);
                self.endpoint.settle(verdict)
            }
        }
    }

    fn judge(&mut self, message: Checked) -> Result<HostEvent, Reject> {
        match message {
            Checked::Hello(hello) => {
                let hello = *hello.body();
                if self.asked != Some(hello.nonce) {
                    return Err(Reject::Nonce);
                }
                self.asked = None;
                if let Err(mismatch) = self.agree(&hello) {
                    return Ok(HostEvent::Refused(mismatch));
                }
                // One that says why it gives none gives none, whatever number stands beside that.
                if hello.session == 0 || hello.refusal != Refusal::None {
                    return Ok(match hello.refusal {
                        Refusal::Owned => HostEvent::Owned,
                        refusal => HostEvent::Refused(Mismatch::Refused {
                            refusal,
                            tick_hz: hello.tick_hz,
                            max_frame: hello.max_frame,
                        }),
                    });
                }
                self.endpoint.open(hello.session);
                self.newest = None;
                // What came before belonged to somebody else's session.
                self.endpoint.counters = Counters {
                    frames_sent: 1,
                    ..Counters::default()
                };
                Ok(HostEvent::Opened(hello))
            }
            Checked::State(state) => {
                let now = (state.body().tick, state.console_time_us());
                if self
                    .newest
                    .is_some_and(|before| !goes_on(before, now, self.tick_hz))
                {
                    return Err(Reject::Clock);
                }
                self.newest = Some(now);
                Ok(HostEvent::State(state))
            }
            Checked::Report(report) => Ok(HostEvent::Report(report)),
            Checked::Pong(pong) => Ok(HostEvent::Pong(pong)),
            Checked::Contact(_)
            | Checked::Command(_)
            | Checked::Simulate(_)
            | Checked::Needle(_)
            | Checked::Thread(_)
            | Checked::Ping(_)
            | Checked::Fixture(_) => Err(Reject::Direction),
        }
    }

    fn agree(&self, console: &Hello) -> Result<(), Mismatch> {
        if console.schema_hash != SCHEMA_HASH {
            Err(Mismatch::Schema {
                console: console.schema_hash,
            })
        } else if console.tick_hz != self.tick_hz {
            Err(Mismatch::TickRate {
                console: console.tick_hz,
                host: self.tick_hz,
            })
        } else if usize::from(console.max_frame) < MAX_FRAME {
            Err(Mismatch::FrameSize {
                console: console.max_frame,
            })
        } else {
            Ok(())
        }
    }

    /// Writes one frame and returns its length \[bytes\]; its sequence is then
    /// [`sent_sequence`](Self::sent_sequence).
    ///
    /// `console_time_us` is that of the `State` that a contact, a needle or a thread was solved for; for other messages that
    /// of the newest `State` (0 before the first).
    ///
    /// # Errors
    /// [`SendError`]; nothing is sent then.
    pub fn send<M: Message>(
        &mut self,
        console_time_us: u64,
        body: &M,
        out: &mut [u8; MAX_FRAME],
    ) -> Result<usize, SendError> {
        if !self.is_open() {
            return Err(SendError::NoSession);
        }
        if !M::KIND.travels(Direction::ToConsole) {
            return Err(SendError::Invalid(Reject::Direction));
        }
        body.check().map_err(SendError::Invalid)?;
        self.endpoint
            .send(console_time_us, body, out)
            .map_err(SendError::Encode)
    }

    /// Whether a session is open.
    pub fn is_open(&self) -> bool {
        self.endpoint.session() != 0
    }

    /// Sequence of the last frame sent; [`State::contact_sequence`] echoes a contact's.
    pub fn sent_sequence(&self) -> u32 {
        self.endpoint.sent_sequence()
    }

    /// Why an answer to the `Hello` that still waits for one could not be used, if one came.
    pub fn unusable_answer(&self) -> Option<Mismatch> {
        self.refused.map(Mismatch::Unusable)
    }

    /// Counts since this session's `Hello`; before the first session, since the link was made.
    pub fn counters(&self) -> Counters {
        self.endpoint.counters
    }
}
/// Most time that ticks may be ahead of the console's clock: ticks that were due are run late \[us\].
const AHEAD_US: u64 = 1_000_000;

/// Whether a state's tick and console time \[us\] follow those of one before. A console in lockstep may send a state twice.
fn goes_on((tick, time_us): (u32, u64), now: (u32, u64), tick_hz: u16) -> bool {
    let ticks = now.0.wrapping_sub(tick);
    let Some(passed_us) = now.1.checked_sub(time_us) else {
        return false;
    };
    if ticks == 0 {
        return true;
    }
    let due_us = u64::from(ticks) * 1_000_000 / u64::from(tick_hz.max(1));
    ticks <= u32::MAX / 2
        && passed_us > 0
        && due_us <= passed_us.saturating_mul(2).saturating_add(AHEAD_US)
}
