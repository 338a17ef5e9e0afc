//! `sutura solve`.

use crate::Global;
use crate::failure::{Cause, Failure};
use clap::Args;

/// Arguments of `sutura solve`.
#[derive(Args, Debug)]
pub struct SolveArgs {}

/// Runs the command.
///
/// # Errors
/// Not in this build.
pub fn run(_args: &SolveArgs, _global: &Global) -> Result<(), Failure> {
    Err(Failure::say(
        Cause::Failed,
        "`sutura solve` is not in this build",
        "wait",
    ))
}
