//! `cargo xtask test`: everything that the project checks, in steps that name themselves, cheap ones first. A failed step
//! does not keep the others from running; all failures are listed at the end. Entry point: [`all`].

#[cfg(test)]
mod files;
mod junit;
mod report;
mod seeds;

pub use seeds::Cases;

use crate::run::{Beside, Tool, root, target};
use crate::toolchain::{Toolchain, host};
use crate::{aarch64, book, firmware, locks, python, setup};
use anyhow::{Context, Result, bail};
use report::{Kind, Report};

/// Cargo features of a build that is tested: all that is optional, what runs the firmware's image under QEMU, and the
/// bench's program.
pub const TEST_FEATURES: &str =
    "sutura/full,sutura/qemu-tests,sutura-hil/qemu-tests,sutura-hil/bench";

/// What the test runner calls its report: see `.config/nextest.toml`.
const TEST_REPORT: &str = "junit.xml";

/// Manifests whose dependencies are looked at.
const MANIFESTS: [&str; 2] = ["Cargo.toml", "firmware/Cargo.toml"];

/// Fetches the database of advisories.
const ADVISORIES: &str = "cargo deny --config deny.toml --manifest-path Cargo.toml fetch db";

/// Runs all checks, whatever fails, and lists the failures.
///
/// # Errors
/// If anything failed.
pub fn all(cases: Cases) -> Result<()> {
    eprintln!("{}", cases.describe());
    let mut report = Report::default();
    steps(&mut report, cases);
    eprintln!("\n{}", report.print());
    let (passed, failed) = report.counts();
    println!("{passed} passed, {failed} failed");
    if !report.is_good() {
        bail!("see the list above");
    }
    if passed == 0 {
        bail!("no test ran");
    }
    Ok(())
}

fn steps(report: &mut Report, cases: Cases) {
    let mut machine = None;
    report.step(Kind::Tools, "build machine", "rustc -vV", |_| {
        machine = Some(host()?);
        Ok(())
    });
    let again = if cases.full {
        "cargo xtask setup --full"
    } else {
        "cargo xtask setup"
    };
    report.step(Kind::Tools, "setup", again, |_| setup::all(cases.full));
    // Where it cannot be had, `setup` has said so.
    let toolchain = Toolchain::ensure().ok();

    report.tools(
        Kind::Checks,
        "format",
        [
            Tool::new("cargo fmt --all --check"),
            Tool::new("cargo fmt --check").within("firmware"),
        ],
    );
    report.step(Kind::Checks, "lock files", "cargo xtask test", |_| {
        locks::check()
    });
    // On a fresh machine its program is built first, for a minute.
    if cases.full {
        report.step(Kind::Checks, "book", "cargo xtask book", |_| {
            book::build(false)
        });
    }
    let deny = |check: &str| {
        MANIFESTS.map(|manifest| {
            let tool = Tool::new("cargo deny --workspace --config deny.toml --manifest-path");
            let words = check.split(' ');
            words.fold(tool.arg(manifest).arg("check"), Tool::arg)
        })
    };
    report.tools(Kind::Checks, "dependencies", deny("bans licenses sources"));
    // The list of what is known of them is on the network, and longer by the day.
    match Tool::new(ADVISORIES).both() {
        Ok(_) => {
            let known = deny("--disable-fetch advisories");
            report.tools(Kind::Checks, "advisories", known);
        }
        Err(error) => eprintln!(
            "\n== advisories: left out, as their database cannot be had here: {error:#}; `{ADVISORIES}` fetches it"
        ),
    }

    // Where nobody says what machine this is, that has failed above.
    let native = |words: &str| {
        machine.as_ref().map(|host| {
            Tool::new(&format!(
                "cargo {words} --lib --locked --target {host} --target-dir target"
            ))
            .within("firmware")
        })
    };
    // Where they cannot be read the images below do not build, and that is said there.
    let all = firmware::Board::all().unwrap_or_default();
    let boards = |words: &str| {
        // Debian's compiler has neither lints nor documents of the same version.
        let words = format!("{words} --release --locked --target-dir target --features");
        let tool = |board: &firmware::Board| {
            let toolchain = toolchain.as_ref().unwrap_or(&Toolchain::Target);
            toolchain.cargo(&words).arg(board.name()).within("firmware")
        };
        match toolchain {
            Some(Toolchain::Target) => all.iter().map(tool).collect(),
            _ => Vec::new(),
        }
    };
    // The command without what is optional, and with each of it alone; and the C library, whose crates need no more features
    // than they say.
    let alone = || {
        let command = "cargo clippy -p sutura --bins --locked --no-default-features";
        ["top", "foxglove", "log"]
            .map(|feature| Tool::new(command).arg("--features").arg(feature))
            .into_iter()
            .chain([
                Tool::new(command),
                Tool::new("cargo clippy -p sutura-capi --lib --locked"),
            ])
    };
    // Optimised at link time and run in an emulator they keep one core busy, in a folder of their own: beside the lints.
    let images = Tool::own().map(|own| own.arg("firmware").beside());
    // As arguments, because flags in the environment would compile every dependency once more.
    let deny_warnings = |tool: Tool| tool.arg("--").arg("-D").arg("warnings");
    report.tools(
        Kind::Build,
        "lints",
        [
            Tool::new("cargo clippy --workspace --all-targets --locked --features")
                .arg(TEST_FEATURES),
        ]
        .into_iter()
        .chain(cases.full.then(alone).into_iter().flatten())
        .chain(native("clippy --all-targets"))
        .chain(boards("clippy --lib --bins"))
        .map(deny_warnings),
    );
    report.step(
        Kind::Build,
        "firmware images",
        "cargo xtask firmware",
        |_| images?.wait(),
    );
    report.tools(
        Kind::Build,
        "firmware parts, built",
        native("test --no-run"),
    );
    let parts = native("test").map(|tool| cases.of(tool));
    report.tools(Kind::Tests, "firmware parts", parts);
    report.tools(Kind::Build, "tests, built", [workspace("test --no-run")]);
    // What the page's tests wait for leaves time: all that does not build the command runs beside them.
    let page = page(cases).map(Tool::beside);
    tests(report, cases);
    // On one core each, and of figures that do not depend on what else runs: beside what leaves the other one.
    let sweep = Tool::own().map(|own| {
        let own = own.arg("sweep");
        match cases.seed {
            Some(seed) => own.arg("--seed").arg(seed.to_string()).beside(),
            None => own.beside(),
        }
    });
    let counts = Tool::own().map(|own| own.arg("bench").beside());
    let again = if cases.full {
        "cargo xtask python --full"
    } else {
        "cargo xtask python"
    };
    report.step(Kind::Tests, "python package", again, |_| {
        python::test(cases.full)
    });
    if cases.full {
        report.step(
            Kind::Tests,
            "64-bit ARM, emulated",
            "cargo xtask aarch64",
            |_| aarch64::compare(),
        );
    }
    let documents = |tool: Tool| tool.env("RUSTDOCFLAGS", "-D warnings");
    report.tools(
        Kind::Build,
        "documents",
        // With the examples, of which there are few, dependencies have the features that the lints checked them with.
        [documents(workspace("doc --lib --examples --no-deps"))]
            .into_iter()
            .chain(boards("doc --no-deps --lib").into_iter().map(documents)),
    );
    report.step(
        Kind::Tests,
        "numbers of scenes",
        "cargo xtask sweep",
        |_| sweep?.wait(),
    );
    report.step(
        Kind::Tests,
        "solver instructions",
        "cargo xtask bench",
        |_| counts?.wait(),
    );
    let again = page.as_ref().map(Beside::shown).unwrap_or_default();
    report.step(Kind::Tests, "page in a browser", &again, |_| page?.wait());
    // Last of all: it takes the command's place until that is built again.
    let plain = cases.full.then(|| {
        Tool::new(
            "cargo run -p sutura --locked --no-default-features -- run --lockstep --seconds 0.2",
        )
    });
    report.tools(Kind::Tests, "the command without a page", plain);
}

/// A command for the workspace with all that its tests need.
fn workspace(words: &str) -> Tool {
    Tool::new(&format!("cargo {words} --workspace --locked --features")).arg(TEST_FEATURES)
}

/// The workspace's tests, and the examples in its documents.
fn tests(report: &mut Report, cases: Cases) {
    if !setup::has_test_runner() {
        // Names and verdicts, but no times.
        let test = workspace("test --no-fail-fast");
        report.tools(Kind::Tests, "tests", [cases.of(test)]);
        return;
    }
    report.tools(Kind::Build, "tests, built", [workspace("test --no-run")]);
    let profile = cases.profile();
    // Two for a core, and one for a test that leaves its core most of the time: see the runner's configuration.
    let threads = 2 * std::thread::available_parallelism().map_or(1, usize::from) + 1;
    let words = format!("nextest run --no-fail-fast --profile {profile} --test-threads {threads}");
    let run = cases.of(workspace(&words));
    let again = run.shown();
    report.step(Kind::Tests, "tests", &again, |report| {
        // The runner keeps it there wherever cargo builds.
        let reports = root().join("target/nextest");
        let path = reports.join(profile).join(TEST_REPORT);
        // That of an earlier run, if there is one.
        let _ = std::fs::remove_file(&path);
        let ran = run.run();
        // If nothing compiled there is no report: then that is what is wrong.
        match (junit::read(&path), ran) {
            (Ok(cases), ran) => {
                report.take(cases);
                ran
            }
            (Err(_), Err(error)) => Err(error),
            (Err(error), Ok(())) => Err(error).context("the tests ran without a report"),
        }
    });
    let examples = workspace("test --no-fail-fast --doc");
    report.tools(
        Kind::Tests,
        "examples in the documents",
        [cases.of(examples)],
    );
}

/// The page's modules, types and looks; pictures of all of that are kept.
fn page(cases: Cases) -> Result<Tool> {
    let target = target()?;
    let tool = Tool::new("node tests/browser/run.mjs --sutura")
        .arg(target.join("debug/sutura"))
        .arg("--out")
        .arg(target.join("browser"));
    Ok(if cases.full { tool.arg("--full") } else { tool })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::root;

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
    fn the_runner_writes_its_report_where_it_is_read() {
        let path = root().join(".config/nextest.toml");
        let text = std::fs::read_to_string(path).expect("readable");
        let config: toml::Table = toml::from_str(&text).expect("TOML");
        for full in [false, true] {
            let profile = Cases::new(full, None).profile();
            let file = config["profile"][profile]["junit"]["path"].as_str();
            assert_eq!(file, Some(TEST_REPORT), "{profile}");
        }
    }
}
