//! Serves the page that shows a session: files, a WebSocket, a guard before both, and a pace that never makes the session wait.
//!
//! Entry points: [`Server::start`], and [`Shared`] for what is shown. It knows nothing of tissue: pictures and telemetry are
//! bytes to it, see the book's page "The page's format".

mod client;
mod command;
mod files;
mod guard;
mod notes;
mod server;
mod shared;
mod waiting;

pub use client::{MOST_A_SECOND, MOST_BYTES};
pub use command::{Command, First, Hand, Refused, SetTo};
pub use files::{FILES, File};
pub use notes::{Noted, Redirect, noted};
pub use server::{Options, PORT, Server, ViewError};
pub use shared::{Beginning, Figures, Next, Reply, Request, Shared, Wants};
pub use waiting::MOST_WAITING;
