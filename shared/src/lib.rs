//! Everything that must be the same on the console and on the host.
//!
//! The console's firmware, the host, the virtual console inside an emulated image and the one in
//! the host's own process all run this code, and all get the same bits from it. Nothing here allocates, and nothing
//! that comes over a line makes it panic.
//!
//! Entry points: [`link`] for both ends of a session, [`control::Control::tick`] for the control loop,
//! [`simulated_console::SimulatedConsole`] for a console without hardware. A simulator wants the crate `sutura-client`.
//!
//! ```
//! use sutura_shared::link::{ConsoleLink, HostEvent, HostLink, Identity};
//! use sutura_shared::wire::MAX_FRAME;
//!
//! let identity = Identity {
//!     tick_hz: 1000,
//!     simulated: true,
//!     device_name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
//! };
//! let (mut host, mut console) = (HostLink::new(1000), ConsoleLink::new(identity, 7));
//! let mut frame = [0; MAX_FRAME];
//!
//! // The host asks for a session, over whatever carries bytes ...
//! let length = host.hello(42, &mut frame)?;
//! console.receive(&mut &frame[..length], 0);
//! // ... and the console gives one.
//! let length = console.take_reply(0, &mut frame).unwrap_or(0);
//! let answer = frame[..length].iter().find_map(|byte| host.receive(*byte));
//! assert!(matches!(answer, Some(HostEvent::Opened(_))));
//! assert!(host.is_open() && console.is_open());
//! # Ok::<(), sutura_shared::wire::EncodeError>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod console_endpoint;
pub mod control;
pub mod device;
pub mod hash;
pub mod identification;
pub mod identity_trace;
pub mod kinematics;
pub mod link;
pub mod math;
pub mod mutant;
pub mod simulated_console;
pub mod usb;
pub mod virtual_console;
pub mod wire;
