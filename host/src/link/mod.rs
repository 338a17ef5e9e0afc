//! The host's end of the link: ports, handshake, I/O threads with latest-value slots, statistics.
//!
//! Entry points: [`open_serial`] and [`Link::open`] for a console that runs by itself,
//! [`LockstepConsole`] for one that advances a tick per exchange.

mod error;
mod lockstep;
mod pipe;
mod port;
mod slot;
mod threads;

pub use error::{LinkError, Ports};
pub use lockstep::LockstepConsole;
pub use pipe::{PipeEnd, pipe};
pub use port::{Port, open_serial, serial_ports};
pub use threads::{Felt, Link, LinkCounters, LinkOptions, Order, nonce};
