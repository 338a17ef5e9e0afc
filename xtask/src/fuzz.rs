//! `cargo xtask fuzz`: builds the driver in fuzz/ and runs it. Entry point: [`run`].
//!
//! A short form is among the workspace's tests (`fuzz/tests/short.rs`), where overflow is checked too.

use crate::run::Tool;
use anyhow::Result;

/// Runs it; what it counts goes to stdout.
pub fn run(arguments: &[String]) -> Result<()> {
    let tool = Tool::new("cargo run --quiet --release --locked -p sutura-fuzz --");
    let tool = arguments.iter().fold(tool, Tool::arg);
    tool.run_lines(|line| println!("{line}"))
}
