//! `sutura bench`.

use crate::Global;
use crate::failure::{Cause, Failure};
use clap::Args;

/// Arguments of `sutura bench`.
#[derive(Args, Debug)]
pub struct BenchArgs {}

/// Runs the command.
///
/// # Errors
/// Not in this build.
pub fn run(_args: &BenchArgs, _global: &Global) -> Result<(), Failure> {
    Err(Failure::say(
        Cause::Failed,
        "`sutura bench` is not in this build",
        "wait",
    ))
}
