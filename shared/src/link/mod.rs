//! Both ends of a session over the wire: handshake, sequence, loss, and what is refused.
//!
//! Entry points: [`ConsoleLink`] on the console, [`HostLink`] on the host.
//!
//! A session starts with the host's `Hello`. The console's answer carries the session number that every
//! later frame of either side must have, or 0 and what differs. `Hello` itself travels with session 0
//! and sequence 0, outside the count; every other frame of one direction, whatever its kind, takes the
//! next sequence from 1 on. Of two frames that swap places the later one is used, the other refused.
//!
//! A contact that lacks rows, a needle or a thread by a gap in the sequence is not used: see [`Companions`].
//!
//! A session is its host's as long as frames of it keep coming, which is what pings are for besides the clock: a console
//! refuses other hosts for [`OWNED_FOR_US`] after a frame, and closes the session [`EXPIRES_AFTER_US`] after it.

mod companions;
mod console;
mod endpoint;
mod host;

pub use companions::Companions;
pub use console::{
    ConsoleLink, EXPIRES_AFTER_US, Identity, LinkEvent, OWNED_FOR_US, REFUSED_EVERY_US,
};
pub use endpoint::{Checks, Counters};
pub use host::{HostEvent, HostLink, Mismatch, SendError};
