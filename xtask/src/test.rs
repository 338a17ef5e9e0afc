//! `cargo xtask test`: everything that the project checks, in steps that name themselves, cheap ones first.
//! Entry point: [`all`].

use crate::run::Tool;
use crate::toolchain::{TARGET, Toolchain, host};
use crate::{Format, bench, firmware, locks, setup};
use anyhow::{Context, Result, anyhow};
use std::time::Instant;

/// Cargo features that only tests need: those that run the firmware's image under QEMU, and the bench's program.
const TEST_FEATURES: &str = "sutura/qemu-tests,sutura-hil/bench";

/// Tests counted over all runners.
#[derive(Default)]
struct Tally {
    passed: u64,
    failed: u64,
    steps: u64,
}

impl Tally {
    /// Reads `test result: ok. 3 passed; 0 failed; ..`.
    fn read(&mut self, line: &str) {
        let Some(result) = line.trim_start().strip_prefix("test result: ") else {
            return;
        };
        let mut before = "";
        for word in result.split_whitespace() {
            let count = before.parse().unwrap_or(0);
            match word {
                "passed;" => self.passed += count,
                "failed;" => self.failed += count,
                _ => {}
            }
            before = word;
        }
    }

    /// Runs one step and counts it.
    fn step(
        &mut self,
        name: &str,
        again: &str,
        run: impl FnOnce(&mut Self) -> Result<()>,
    ) -> Result<()> {
        self.steps += 1;
        eprintln!("\n== {name}");
        let start = Instant::now();
        let result = run(self);
        let seconds = start.elapsed().as_secs_f64();
        match result {
            Ok(()) => {
                eprintln!("== {name}: ok, {seconds:.1} s");
                Ok(())
            }
            Err(error) => {
                eprintln!("== {name}: FAILED, {seconds:.1} s");
                Err(error).with_context(|| {
                    format!("step `{name}` failed; run it again with\n    {again}\n")
                })
            }
        }
    }

    /// Runs programs, one after the other, as one step.
    fn tools(&mut self, name: &str, tools: impl IntoIterator<Item = Tool>) -> Result<()> {
        let tools: Vec<Tool> = tools.into_iter().collect();
        let again: Vec<String> = tools.iter().map(Tool::shown).collect();
        self.step(name, &again.join(" && "), |tally| {
            tools.into_iter().try_for_each(|tool| {
                tool.run_lines(|line| {
                    tally.read(line);
                    eprintln!("{line}");
                })
            })
        })
    }
}

/// Runs all checks; ends at the first step that fails.
pub fn all() -> Result<()> {
    let mut tally = Tally::default();
    let start = Instant::now();
    let result = steps(&mut tally);
    let failed = tally.failed.max(u64::from(result.is_err()));
    let minutes = start.elapsed().as_secs_f64() / 60.0;
    eprintln!("\n{} steps in {minutes:.1} min", tally.steps);
    println!("{} passed, {failed} failed", tally.passed);
    result
}

fn steps(tally: &mut Tally) -> Result<()> {
    tally.step("setup", "cargo xtask setup", |_| setup::all())?;
    let toolchain = Toolchain::ensure()?;
    let host = host()?;

    tally.tools(
        "format",
        [
            Tool::new("cargo fmt --all --check"),
            Tool::new("cargo fmt --check").within("firmware"),
        ],
    )?;
    tally.step("lock files", "cargo xtask test", |_| locks::check())?;
    let deny = |manifest: &str| {
        // Advisories need a database from the network and change by the day: not part of this.
        Tool::new("cargo deny --workspace --config deny.toml --manifest-path")
            .arg(manifest)
            .arg("check")
            .arg("bans")
            .arg("licenses")
            .arg("sources")
    };
    tally.tools(
        "dependencies",
        [deny("Cargo.toml"), deny("firmware/Cargo.toml")],
    )?;

    let native = |words: &str| {
        Tool::new(&format!(
            "cargo {words} --lib --locked --target {host} --target-dir target"
        ))
        .within("firmware")
    };
    let boards = |words: &str| {
        // Debian's compiler has neither lints nor documents of the same version.
        let boards: &[firmware::Board] = match toolchain {
            Toolchain::Target => &firmware::Board::ALL,
            Toolchain::BuildStd { .. } => &[],
        };
        let words = format!("{words} --release --locked --target-dir target --features");
        let tool =
            |board: &firmware::Board| toolchain.cargo(&words).arg(board.name()).within("firmware");
        boards.iter().map(tool).collect::<Vec<_>>()
    };
    // As arguments, because flags in the environment would compile every dependency once more.
    let deny_warnings = |tool: Tool| tool.arg("--").arg("-D").arg("warnings");
    tally.tools(
        "lints",
        [
            Tool::new("cargo clippy --workspace --all-targets --locked --features")
                .arg(TEST_FEATURES),
            native("clippy --all-targets"),
        ]
        .into_iter()
        .chain(boards("clippy --lib --bins"))
        .map(deny_warnings),
    )?;
    tally.step("firmware images", "cargo xtask firmware", |_| {
        firmware::gated(false, Format::Text)
    })?;
    tally.tools("firmware parts", [native("test")])?;
    tally.tools(
        "tests",
        [Tool::new("cargo test --workspace --locked --features").arg(TEST_FEATURES)],
    )?;
    tally.step("solver instructions", "cargo xtask bench", |_| {
        bench::gated(false, Format::Text)
    })?;
    let documents = |tool: Tool| tool.env("RUSTDOCFLAGS", "-D warnings");
    tally.tools(
        "documents",
        [documents(Tool::new(
            "cargo doc --workspace --lib --no-deps --locked",
        ))]
        .into_iter()
        .chain(boards("doc --no-deps --lib").into_iter().map(documents)),
    )?;
    if tally.passed == 0 {
        return Err(anyhow!("no test ran on {host} or for {TARGET}"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_several_runners_add_up() {
        let mut tally = Tally::default();
        tally.read("running 5 tests");
        tally.read("test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s");
        tally.read(
            "test result: FAILED. 12 passed; 2 failed; 0 ignored; 0 measured; 0 filtered out",
        );
        assert_eq!((tally.passed, tally.failed), (15, 2));
    }

    #[test]
    fn a_command_line_is_shown_as_it_is_typed() {
        let tool = Tool::new("cargo clippy")
            .within("firmware")
            .env("A", "b c")
            .arg("--")
            .arg("-D");
        assert_eq!(tool.shown(), "(cd firmware && A='b c' cargo clippy -- -D)");
    }

    #[test]
    fn a_failing_step_says_how_to_run_it_again() {
        let mut tally = Tally::default();
        let error = tally
            .tools("nothing", [Tool::new("false").arg("--x")])
            .expect_err("`false` fails");
        assert!(format!("{error:#}").contains("false --x"), "{error:#}");
    }
}
