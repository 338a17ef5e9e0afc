//! `sutura console`: a virtual console as a process of its own.

use crate::Global;
use crate::failure::{Cause, Failure};
use clap::Args;

/// Arguments of `sutura console`.
#[derive(Args, Debug)]
pub struct ConsoleArgs {}

/// Runs the console until it is told to stop.
///
/// # Errors
/// When no pseudo-terminal can be had.
pub fn run(_args: &ConsoleArgs, _global: &Global) -> Result<(), Failure> {
    Err(Failure::say(
        Cause::Failed,
        "`sutura console` is not in this build",
        "use `sutura run`",
    ))
}
