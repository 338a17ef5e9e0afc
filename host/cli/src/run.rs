//! `sutura run`: the main job.

use crate::Global;
use crate::failure::{Cause, Failure};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `sutura run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// Scene file; scenes/palpation.toml (or its copy inside this program) when left out.
    pub scene: Option<PathBuf>,
}

/// Runs the session and prints its summary.
///
/// # Errors
/// Everything that keeps the session from running to its end.
pub fn run(_args: &RunArgs, _global: &Global) -> Result<(), Failure> {
    Err(Failure::say(
        Cause::Failed,
        "`sutura run` is not in this build",
        "use `sutura solve` or `sutura bench`",
    ))
}
