//! The host's end of the link: ports, handshake, I/O threads with latest-value slots, statistics.
//!
//! Entry points: [`open_serial`] and [`Link::open`] for a console that runs by itself, [`Link::open_with`] for one that
//! may go away and come back, [`LockstepConsole`] for one that advances a tick per exchange.

mod clock;
mod error;
mod felt;
mod handshake;
mod holder;
mod lockstep;
mod pipe;
mod port;
mod sent;
mod silence;
mod slot;
mod threads;
mod unusable;

pub use clock::{Clock, ClockEstimate, Exchange, RoundTrips};
pub use error::{LinkError, Ports, VIRTUAL_HELP, is_virtual};
pub use felt::{Felt, Order, append};
pub use handshake::{drain, knock, nonce};
pub use lockstep::LockstepConsole;
pub use pipe::{PipeEnd, pipe};
pub use port::{ConsolePort, Port, consoles, open_serial, serial_ports, touch};
pub use sent::SentContact;
pub use silence::Silence;
pub use threads::{Connector, Heard, Link, LinkCounters, LinkOptions, Standing};
pub use unusable::{Advance, Unusable};
