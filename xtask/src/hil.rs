//! `cargo xtask hil`: builds what a kind of console needs and runs the bench. Entry point: [`run`].

use crate::run::{Tool, target};
use crate::{Format, firmware, setup};
use anyhow::{Context, Result};
use std::process::{Command, ExitCode};

/// The bench's own exit code when there is none.
const FAILED: u8 = 1;

/// Runs the bench with these arguments, which are its own.
pub fn run(arguments: &[String]) -> Result<ExitCode> {
    let has = |flag: &str| {
        let with_value = format!("{flag}=");
        arguments
            .iter()
            .any(|a| a == flag || a.starts_with(&with_value))
    };
    let asks_only = has("--help") || has("-h");
    let console = value(arguments, "--console").unwrap_or_default();
    let processes = (console == "virtual" || has("--relay")) && !asks_only;
    if console == "qemu" && !has("--image") && !asks_only {
        setup::qemu()?;
        firmware::build_one(&firmware::Board::simulated(), Format::Text)?;
    }
    let build = "cargo build --quiet --locked -p sutura-hil --features sutura-hil/bench";
    let build = Tool::new(build).arg("--bin").arg("sutura-hil-bench");
    if processes {
        build.arg("-p").arg("sutura").arg("--bin").arg("sutura")
    } else {
        build
    }
    .run()?;
    let built = target()?.join("debug");
    let program = built
        .join("sutura-hil-bench")
        .with_extension(std::env::consts::EXE_EXTENSION);
    let mut bench = Command::new(&program);
    bench.args(arguments);
    if processes && !has("--sutura") {
        let sutura = built
            .join("sutura")
            .with_extension(std::env::consts::EXE_EXTENSION);
        bench.arg("--sutura").arg(sutura);
    }
    let status = bench.status();
    let status = status.with_context(|| format!("cannot start {}", program.display()))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(FAILED)))
}

/// The value of a flag, behind it or behind an `=`.
fn value<'a>(arguments: &'a [String], flag: &str) -> Option<&'a str> {
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        if word == flag {
            return words.next().map(String::as_str);
        }
        let value = word
            .strip_prefix(flag)
            .and_then(|rest| rest.strip_prefix('='));
        if value.is_some() {
            return value;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flags_value_is_found_however_it_is_written() {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let console = |text: &str| value(&words(text), "--console").map(str::to_owned);
        assert_eq!(console("--only a --console qemu"), Some("qemu".to_owned()));
        assert_eq!(console("--console=virtual x"), Some("virtual".to_owned()));
        assert_eq!(console("--console"), None);
        assert_eq!(console("--consoles qemu"), None);
    }
}
