//! In the place of the figures in a build without them.

use super::TopArgs;
use crate::Global;
use crate::failure::{Cause, Failure};
use crate::view::session::Viewed;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Nothing: there are none.
pub enum Top {}

fn missing() -> Failure {
    let message = "this program was built without its figures in a terminal";
    Failure::say(
        Cause::BadInput,
        message,
        "build it with the Cargo feature `top`: cargo run --release --features top",
    )
}

/// Says why there are none.
///
/// # Errors
/// Always.
pub fn run(_: &TopArgs, _: &Global) -> Result<(), Failure> {
    Err(missing())
}

impl Top {
    /// Says why there are none.
    ///
    /// # Errors
    /// Always.
    pub fn start(_: &Viewed, _: Arc<AtomicBool>) -> Result<Top, Failure> {
        Err(missing())
    }

    /// Never.
    pub fn end(self) {
        match self {}
    }
}
