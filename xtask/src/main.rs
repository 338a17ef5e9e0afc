//! What the project needs besides `cargo build`: tools, firmware images with their gates, all checks.

mod aarch64;
mod bars;
mod bench;
mod book;
mod calls;
mod cycles;
mod firmware;
mod fuzz;
mod gates;
mod hil;
mod image;
mod locks;
mod made_of;
mod mesher;
mod notes;
mod plots;
mod python;
mod run;
mod scenes;
mod setup;
mod sweep;
mod test;
mod toolchain;
mod vendor;

use clap::{Parser, Subcommand, ValueEnum};
use std::process::ExitCode;

/// Builds, checks and installs what the project needs.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Installs what is missing: the chip's Rust target, QEMU, valgrind, gungraun-runner, cargo-deny, cargo-nextest, mdBook.
    Setup {
        /// What the long tests need, too: gmsh and scikit-image, in an environment of their own under the target folder; a linker and
        /// an emulator for 64-bit ARM.
        #[arg(long)]
        full: bool,
    },
    /// Builds the firmware, prints sizes and instruction counts, and compares them with the snapshots.
    #[command(after_help = "Examples:
  cargo xtask firmware                    all boards, all gates
  cargo xtask firmware --board virtual    build one image, nothing else
  cargo xtask firmware --bless            accept the present figures as snapshots
  cargo xtask firmware --format json      one JSON object on stdout")]
    Firmware {
        /// Only build this board's image: no figures, no gates.
        #[arg(long, value_parser = firmware::Board::of_name, conflicts_with_all = ["bless"])]
        board: Option<firmware::Board>,
        /// Write the figures to firmware/snapshots instead of comparing them.
        #[arg(long)]
        bless: bool,
        /// How to print the figures.
        #[arg(long, value_enum, default_value = "text")]
        format: Format,
    },
    /// Counts the instructions of the solver's parts under valgrind and compares them with the snapshot.
    #[command(after_help = "Examples:
  cargo xtask bench                    fails if a part takes 3 % and 100 instructions more than its snapshot
  cargo xtask bench --bless            accept the present counts as snapshot
  cargo xtask bench --format json      one JSON object on stdout

Times on this machine: cargo run --release -- bench")]
    Bench {
        /// Write the counts to host/snapshots instead of comparing them.
        #[arg(long)]
        bless: bool,
        /// How to print the counts.
        #[arg(long, value_enum, default_value = "text")]
        format: Format,
    },
    /// Runs fault scenarios on a console: simulated, in the firmware's image, in a process, or at a port.
    #[command(disable_help_flag = true)]
    Hil {
        /// See `cargo xtask hil --help`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Writes the scenes that have generated scripts.
    #[command(after_help = "Examples:
  cargo xtask scenes            write scenes/anastomosis-20.toml and others
  cargo xtask scenes --check    fails if they are not what would be written")]
    Scenes {
        /// Write nothing.
        #[arg(long)]
        check: bool,
    },
    /// Draws the book's pictures from the reports in docs/data, and its wiring drawings from docs/wiring.
    #[command(after_help = "Examples:
  cargo xtask plots                       draw all of them; names those that changed
  cargo xtask plots --check               fails and names them if they are not what would be drawn
  cargo xtask plots --from FILE.json      put a report in the place of the book's first
  cargo xtask plots --sheet               all of them on one PNG, docs/src/sheet.png, with date and commit

A report is what `sutura tradeoff --full` or `sutura fidelity --full` prints with --format json, or writes with --plot.")]
    Plots {
        /// Write nothing.
        #[arg(long)]
        check: bool,
        /// A report that takes the place of the book's.
        #[arg(long, value_name = "FILE.json", conflicts_with = "check")]
        from: Option<std::path::PathBuf>,
        /// The sheet, too; needs rsvg-convert or chromium.
        #[arg(long, conflicts_with = "check")]
        sheet: bool,
    },
    /// Builds the book into target/book and looks up every link, anchor, formula and path in it.
    #[command(after_help = "Examples:
  cargo xtask book              fails and lists what is wrong; installs mdBook into target/tools
  cargo xtask book --tables     writes first what `sutura schema` prints into the pages' tables")]
    Book {
        /// Write the tables that are made of the command's types.
        #[arg(long)]
        tables: bool,
    },
    /// Tests the Python package, in an environment of its own under the target folder.
    #[command(after_help = "Examples:
  cargo xtask python           its short tests, beside the library that the workspace's tests are built with
  cargo xtask python --full    installs it as a release into a fresh environment, with all extras, and runs all its tests
  cargo xtask python --cost    what a step costs from Python beyond the same from Rust; fails above 10 us

pip fetches numpy and pytest once; with --full what python/pyproject.toml names as extras.")]
    Python {
        /// As a release in a fresh environment, with the long forms of tests (SUTURA_FULL=1).
        #[arg(long)]
        full: bool,
        /// No tests, but what a step costs, in pairs: times are for machines with nothing else to do.
        #[arg(long, conflicts_with = "full")]
        cost: bool,
    },
    /// Builds the command for Linux on 64-bit ARM, runs it under an emulator, and compares its console's bits with this machine's.
    #[command(after_help = "Examples:
  cargo xtask aarch64    part of `cargo xtask test --full`; installs a linker and qemu-user on Debian")]
    Aarch64,
    /// Prints what a release brings: its section of CHANGELOG.md.
    #[command(after_help = "Examples:
  cargo xtask notes             of the version that Cargo.toml has, released or not
  cargo xtask notes v0.1.0      of a tag; fails while its section says Unreleased")]
    Notes {
        /// The tag, with or without its `v`.
        tag: Option<String>,
    },
    /// Fetches what the page of `sutura view` uses of others from npm, as host/view/vendor/vendor.toml says.
    #[command(after_help = "Examples:
  cargo xtask vendor            write the files into host/view/vendor
  cargo xtask vendor --check    fails if they are not the packages', byte for byte

npm is needed. For another version change version and integrity, which `npm view NAME@VERSION dist.integrity` prints.")]
    Vendor {
        /// Write nothing.
        #[arg(long)]
        check: bool,
    },
    /// Mutates frames, scenes and meshes and looks what reads them; `cargo xtask fuzz --help` has its arguments.
    #[command(disable_help_flag = true)]
    Fuzz {
        /// Passed on.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Measures in seconds what sessions in real time must hold: idle and beside busy loops, against lockstep.
    #[command(after_help = "Examples:
  cargo xtask bars                                     all scenes, five runs each: idle, busy without and with rights
  cargo xtask bars --idle --runs 1                     a first look
  cargo xtask bars --busy --scene palpation            one scene beside busy loops
  cargo xtask bars --page                              what a page costs the solver, and how fast it stops the console
  cargo xtask bars --format json > bars.json           all figures of all runs

Builds the release first. An idle machine is needed, and root for both kinds of rights: without real-time rights a session
runs as nobody (prlimit and setpriv of util-linux); a user who is not root gets the limit with
  sudo prlimit --pid $$ --rtprio=80
Runs during which a thread that only sleeps 1 ms was late by over 5 ms are marked. The exit code is 1 if a bar is missed; a figure
that a summary lacks misses its bar. Not measured here: how far looks ahead reach beside lockstep's, a solver that stalls, and
a cable that is pulled.")]
    Bars(bars::Arguments),
    /// Changes numbers of the shipped scenes beyond what can be meant, one at a time, and looks what the command says.
    #[command(after_help = "Examples:
  cargo xtask sweep                                a drawn hundred in short sessions; part of `cargo xtask test`
  cargo xtask sweep --seed 7                       what a run that printed this seed drew
  cargo xtask sweep --full                         every key of every scene, in sessions of full length: hours
  cargo xtask sweep --full --scene palpation --sutura target/release/sutura

Every key's number, in lists of sections the first, the middle and the last, is taken times 0.001 and 1000, as zero, and negated. Each has to be refused at a place in the scene, to be warned of, to end
with another word than ok, or to end well: felt where the solver was touched, and not where it was not. None may compute for 20 s
without a word. What is felt is printed beside the largest force that was solved.")]
    Sweep(sweep::Arguments),
    /// A client of a page that prints the time of what it is shown; `bars` stops it.
    #[command(hide = true)]
    WatchPage { url: String },
    /// Runs everything that the project checks, goes on after a failure, and lists all that failed at the end.
    #[command(after_help = "Examples:
  cargo xtask test                    all checks; property tests draw the same cases every time
  cargo xtask test --full             fresh cases, and the long forms of tests (SUTURA_FULL=1)
  cargo xtask test --full --seed 7    what a run that printed this seed drew

What went into tools, builds and suites, and the slowest tests, is printed at the end; the last line on stdout is
\"N passed, M failed\". Bars in seconds, on an idle machine: cargo xtask bars")]
    Test {
        /// Fresh cases for the property tests, and tests in their long forms.
        #[arg(long)]
        full: bool,
        /// Of the property tests' generator.
        #[arg(long)]
        seed: Option<u64>,
    },
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Hil { arguments } => match hil::run(&arguments) {
            Ok(code) => return code,
            Err(error) => Err(error),
        },
        Command::Setup { full } => setup::all(full),
        Command::Firmware {
            board: Some(board),
            format,
            ..
        } => firmware::build_one(&board, format),
        Command::Firmware {
            board: None,
            bless,
            format,
        } => firmware::gated(bless, format),
        Command::Bench { bless, format } => bench::gated(bless, format),
        Command::Scenes { check } => scenes::gated(check),
        Command::Plots { check, from, sheet } => plots::all(check, from.as_deref(), sheet),
        Command::Book { tables } => book::build(tables),
        Command::Python { cost: true, .. } => python::step_cost(),
        Command::Python { full, .. } => python::all(full),
        Command::Aarch64 => aarch64::all(),
        Command::Notes { tag } => notes::print(tag.as_deref()),
        Command::Vendor { check } => vendor::gated(check),
        Command::Fuzz { arguments } => fuzz::run(&arguments),
        Command::Bars(arguments) => bars::all(&arguments),
        Command::Sweep(arguments) => sweep::all(&arguments),
        Command::WatchPage { url } => bars::client::follow(&url),
        Command::Test { full, seed } => test::all(test::Cases::new(full, seed)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Command lines of README, the book and its neighbours.
    #[test]
    fn what_is_written_of_this_command_is_understood() {
        let root = run::root();
        let book = std::fs::read_dir(root.join("docs/src")).expect("readable");
        let pages = book.map(|entry| entry.expect("readable").path());
        let others = ["README.md", "firmware/README.md", "CONTRIBUTING.md"];
        let mut lines = 0;
        for path in pages.chain(others.map(|name| root.join(name))) {
            let Ok(text) = std::fs::read_to_string(&path) else {
                continue;
            };
            for line in text.lines().map(str::trim_start) {
                if !line.starts_with("cargo xtask ") {
                    continue;
                }
                // Before what is said of it, and what takes its output.
                let line = line.split("  ").next().unwrap_or_default();
                let line = line.split(" | ").next().unwrap_or_default();
                let words = line.split_whitespace().skip(1);
                let parsed = Arguments::try_parse_from(words);
                assert!(parsed.is_ok(), "{}: `{line}`", path.display());
                lines += 1;
            }
        }
        assert!(lines > 5, "{lines}");
    }
}
