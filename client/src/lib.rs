//! A Sutura console for simulators of any kind: open a port, read the pose, send a contact, close.
//!
//! Entry point: [`Console::open`]. The console renders what it was sent last at 1 kHz by itself; a simulator that
//! is late is a force that fades, never one that stays. No solver comes with this crate.
//!
//! ```no_run
//! use std::time::Duration;
//! use sutura_client::{Console, Contact, Error, Options};
//!
//! // A floor of 500 N/m at z = 0.
//! fn floor(port: &str) -> Result<(), Error> {
//!     let console = Console::open(port, Options::default())?;
//!     console.arm()?;
//!     while let Some(pose) = console.pose(Duration::from_millis(500))? {
//!         let z = pose.position_m[2];
//!         let contact = if z > 0.0 {
//!             Contact::apart(z, [0.0, 0.0, 1.0])
//!         } else {
//!             Contact::touching([0.0, 0.0, -500.0 * z], [0.0, 0.0, 1.0])
//!         };
//!         let stiffness = [[0.0; 3], [0.0; 3], [0.0, 0.0, -500.0]];
//!         console.send_contact(&pose, &contact.with_stiffness(stiffness))?;
//!     }
//!     Ok(())
//! }
//! ```
// One system call has its proof beside it: scheduling/slice.rs.
#![deny(unsafe_code)]

pub mod ahead;
mod console;
mod contact;
pub mod link;
mod pose;
pub mod scheduling;
pub mod times;

pub use ahead::Lead;
pub use console::{Console, Options};
pub use contact::Contact;
pub use link::LinkError as Error;
pub use pose::Pose;
pub use sutura_shared::wire::message;
