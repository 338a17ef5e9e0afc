//! Runs a recording again: the console's ticks, the solver's steps, and compares bit by bit.
//!
//! Entry points: [`replay_console`] and [`replay_host`]. Each knows only what went over the line and what the recording holds
//! besides; the one does not depend on the other.

mod console;
mod host;
mod native;
mod report;
mod sessions;
mod whole;

pub use console::{ConsoleVerdict, Ran, Replayed, replay_console};
pub use host::{HostVerdict, compare_contacts, replay_host, replay_host_while};
pub use native::NativeTicks;
pub use report::{OfConsole, OfHost, Outcome, Report};
pub use sessions::{DownFrame, Session, frame_with_session, sessions, stuffed};
pub use whole::WholeConsole;
