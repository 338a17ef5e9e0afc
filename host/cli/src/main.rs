//! The `sutura` command: parses the line, starts logging, runs one subcommand, renders its failure.
//!
//! Results go to stdout, logs and progress to stderr. Exit codes: see [`failure::Cause`].

/// A line on stdout, as `println!` but without its panic: whoever reads may have closed the pipe.
macro_rules! say {
    ($($text:tt)*) => {
        $crate::display::say(format_args!($($text)*))
    };
}

/// A line on stderr, as `eprintln!` but without its panic.
macro_rules! note {
    ($($text:tt)*) => {
        $crate::display::note(format_args!($($text)*))
    };
}

mod attendant;
mod bench;
mod choice;
mod console;
mod consoles;
mod device;
mod display;
mod doctor;
mod failure;
mod fidelity;
mod files;
mod fixture;
mod flash;
mod generate;
mod mesh;
mod recording;
mod replay;
mod run;
mod scene;
mod schema;
mod series;
mod signals;
mod solve;
mod stability;
mod tables;
mod top;
mod tradeoff;
mod view;
mod work;

use clap::{Args, CommandFactory, Parser, Subcommand, ValueEnum};
use failure::{Cause, Failure, render};
use schemars::JsonSchema;
use serde::Serialize;
use std::io::IsTerminal;
use std::process::ExitCode;
use sutura_host::text::harmless;
use sutura_host::work::TARGET;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// Feel soft tissue through a haptic console.
///
/// Without a subcommand this is `sutura run`.
#[derive(Parser, Debug)]
#[command(name = "sutura", version = env!("SUTURA_VERSION"), after_help = EXAMPLES)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Option<Command>,
}

const EXAMPLES: &str = "\
Examples:
  sutura                                    5 s palpation with a virtual console
  sutura view                               the same on a live page, until Ctrl-C
  sutura top                                the figures of the session that runs here, in a terminal
  sutura run --console /dev/ttyACM0         the same on a console at a serial port
  sutura replay session.mcap                what `sutura run --record` wrote, run again bit by bit
  sutura solve scene.toml --out field.vtu   the tissue at rest under the scene's handles and loads
  sutura bench                              time per step, by stage
  sutura fidelity                           force error and stability against a 1 kHz solve
  sutura tradeoff                           error against time of every tissue model
  sutura stability                          what tissue models do at the extremes
  sutura scene explain scene.toml           what a scene builds, why, and what it costs
  sutura device list                        port and serial number of every console on USB
  sutura flash image.bin                    writes a firmware image to a board, and reads it back
  sutura doctor /dev/ttyACM0                what is wrong with this machine or that console, and the fix
  sutura mesh info part.msh                 quality of a mesh, and whether scenes take it

Exit codes: 0 ok, 1 failed, 2 bad usage or bad input, 3 no console, 4 protocol mismatch,
5 console in latched fault, 6 replay diverged, 7 stated budget missed, 8 contact not felt, 130 interrupted.";

/// Options that every command takes.
#[derive(Args, Debug)]
pub struct Global {
    /// How results are printed on stdout.
    #[arg(long, value_enum, default_value_t = Format::Text, global = true)]
    pub format: Format,
    /// More logs on stderr: -v what is done, -vv details, -vvv everything. RUST_LOG overrides.
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
    /// Writes over files that are there; otherwise they are kept, and the command ends with code 2.
    #[arg(long, global = true)]
    pub overwrite: bool,
}

/// How results are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// One JSON object.
    Json,
}

#[derive(Subcommand, Debug)]
enum Command {
    Run(run::RunArgs),
    View(view::ViewArgs),
    Top(top::TopArgs),
    Replay(replay::ReplayArgs),
    Console(console::ConsoleArgs),
    Solve(solve::SolveArgs),
    Bench(bench::BenchArgs),
    Fidelity(fidelity::FidelityArgs),
    Tradeoff(tradeoff::TradeoffArgs),
    Stability(stability::StabilityArgs),
    Scene(scene::command::SceneArgs),
    Schema(schema::SchemaArgs),
    Completions(generate::CompletionsArgs),
    Man(generate::ManArgs),
    Mesh(mesh::MeshArgs),
    Doctor(doctor::DoctorArgs),
    Device(consoles::DeviceArgs),
    Flash(flash::FlashArgs),
}

fn main() -> ExitCode {
    let cli = match parse() {
        Ok(cli) => cli,
        Err(error) => return misused(&error),
    };
    start_logging(cli.global.verbose);
    let Some(command) = &cli.command else {
        return ExitCode::SUCCESS;
    };
    let done = match command {
        Command::Run(args) => run::run(args, &cli.global),
        Command::View(args) => view::run(args, &cli.global),
        Command::Top(args) => top::run(args, &cli.global),
        Command::Replay(args) => replay::run(args, &cli.global),
        Command::Console(args) => console::run(args, &cli.global),
        Command::Solve(args) => solve::run(args, &cli.global),
        Command::Bench(args) => bench::run(args, &cli.global),
        Command::Fidelity(args) => fidelity::run(args, &cli.global),
        Command::Tradeoff(args) => tradeoff::run(args, &cli.global),
        Command::Stability(args) => stability::run(args, &cli.global),
        Command::Scene(args) => scene::command::run(args, &cli.global),
        Command::Schema(args) => schema::run(args, &cli.global),
        Command::Completions(args) => generate::completions(args, Cli::command()),
        Command::Man(args) => generate::man(args, Cli::command()),
        Command::Mesh(args) => mesh::run(args, &cli.global),
        Command::Doctor(args) => doctor::run(args, &cli.global),
        Command::Device(args) => consoles::run(args, &cli.global),
        Command::Flash(args) => flash::run(args, &cli.global),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            tell(&failure, cli.global.format);
            ExitCode::from(failure.cause.code())
        }
    }
}

fn parse() -> Result<Cli, clap::Error> {
    let cli = Cli::try_parse()?;
    if cli.command.is_some() {
        return Ok(cli);
    }
    // Parsed again, so that `run` has its defaults in one place.
    Cli::try_parse_from(std::env::args_os().chain(["run".into()]))
}

/// Help and version on stdout; for a line that is wrong, what is wrong on stderr, and an object on stdout if
/// the line asks for JSON.
fn misused(error: &clap::Error) -> ExitCode {
    let plain = error.to_string();
    let text = harmless(&in_words(&plain));
    // A stream that nobody reads is no reason for another failure.
    let _ = match text == plain {
        true => error.print(),
        false => std::io::Write::write_all(&mut std::io::stderr(), text.as_bytes()),
    };
    if !error.use_stderr() {
        return ExitCode::SUCCESS;
    }
    // The line was not understood, so it is only searched for the words.
    let words: Vec<_> = std::env::args_os().collect();
    let json = words.iter().any(|word| word == "--format=json")
        || words
            .windows(2)
            .any(|two| two[0] == "--format" && two[1] == "json");
    if json {
        let mut paragraphs = text
            .split("\n\n")
            .map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
        let message = paragraphs.next().unwrap_or_default();
        let message = message.strip_prefix("error: ").unwrap_or(&message);
        let help = paragraphs
            .filter(|text| !text.is_empty())
            .collect::<Vec<_>>();
        say_failure(Cause::BadInput, message, Some(&help.join("\n")));
    }
    ExitCode::from(Cause::BadInput.code())
}

/// What the language says of a number that is none, in ours.
fn in_words(text: &str) -> String {
    const WORDS: [(&str, &str); 5] = [
        ("invalid digit found in string", "a whole number is needed"),
        (
            "cannot parse integer from empty string",
            "a whole number is needed",
        ),
        (
            "number too large to fit in target type",
            "so large a number is not taken",
        ),
        ("invalid float literal", "a number is needed"),
        ("cannot parse float from empty string", "a number is needed"),
    ];
    let replaced = |text: String, (theirs, ours): &(&str, &str)| text.replace(theirs, ours);
    WORDS.iter().fold(text.to_owned(), replaced)
}

fn start_logging(verbose: u8) {
    let level = match verbose {
        0 => "warn",
        1 => "info",
        2 => "debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let logs = tracing_subscriber::fmt::layer()
        .with_writer(|| display::Log)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        .with_filter(filter);
    // Long work is heard of whatever is logged.
    let of_work = Targets::new().with_target(TARGET, tracing::Level::DEBUG);
    tracing_subscriber::registry()
        .with(logs)
        .with(work::Layer.with_filter(of_work))
        .init();
}

/// Shows a failure on stderr; with `--format json` stdout gets one object too.
fn tell(failure: &Failure, format: Format) {
    render(&failure.report);
    if format == Format::Json && !failure.summarised {
        let help = failure.report.help().map(|help| help.to_string());
        say_failure(failure.cause, &failure.report.to_string(), help.as_deref());
    }
}

/// What `--format json` prints of a failure.
#[derive(Serialize, JsonSchema)]
pub struct Failed<'a> {
    /// The exit code in a word.
    status: &'static str,
    /// The exit code.
    exit_code: u8,
    /// What is wrong.
    message: &'a str,
    /// What to do about it.
    help: Option<&'a str>,
}

fn say_failure(cause: Cause, message: &str, help: Option<&str>) {
    display::object(&Failed {
        status: cause.word(),
        exit_code: cause.code(),
        message: &harmless(message),
        help: help.map(harmless).as_deref(),
    });
}
