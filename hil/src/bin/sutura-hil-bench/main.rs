//! Runs scenarios on one kind of console and says what became of them. `cargo xtask hil` builds what this needs.

mod report;

use clap::{Parser, ValueEnum};
use report::{Sums, junit, lines, object};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use sutura_hil::scenario::peer::PeerError;
use sutura_hil::scenario::suite::{Bench, Case, Extent, Native};
use sutura_hil::scenario::{ConsoleKind, Scenario, built_in};
use sutura_host::text::{escaped, escaped_json};

/// Runs fault scenarios on a console, and their mutants.
#[derive(Parser)]
#[command(name = "cargo xtask hil", bin_name = "cargo xtask hil", after_help = EXAMPLES)]
struct Arguments {
    /// Scenario files or folders; the project's own when left out.
    scenario: Vec<PathBuf>,
    /// `native` (simulated in this process, lockstep), `qemu` (the firmware image, lockstep), `virtual` (a process of its own
    /// behind a pseudo-terminal, wall clock), or a serial port.
    #[arg(long, value_name = "CONSOLE", default_value = "native")]
    console: String,
    /// How the result is printed on stdout.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// Writes the result as JUnit XML, too.
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Only the scenario of this name, or those whose name contains it; several with commas.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    only: Vec<String>,
    /// Only as they are, not without their guards.
    #[arg(long)]
    no_mutants: bool,
    /// How many scenarios run at a time.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    jobs: Option<u16>,
    /// A simulated console at PATH for a host of your own, with the faults of the scenario that `--only` names.
    #[arg(long, value_name = "PATH")]
    relay: Option<PathBuf>,
    /// The `sutura` command for `virtual` and `--relay`.
    #[arg(long, value_name = "FILE", hide = true)]
    sutura: Option<PathBuf>,
    /// The firmware's image for `qemu`.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
}

const EXAMPLES: &str = "\
Examples:
  cargo xtask hil                                       every scenario on the simulation, in a second
  cargo xtask hil --console qemu                        the same bits from the firmware's image
  cargo xtask hil --console virtual --junit hil.xml     processes and pseudo-terminals, by the wall clock
  cargo xtask hil --console /dev/ttyACM0                your own firmware
  cargo xtask hil --only host-killed,cable my/scenarios
  cargo xtask hil --relay /tmp/console --only loss      your own host, on a line that loses frames

Exit codes: 0 all met and all mutants caught, 1 not so, 2 bad usage or a bad scenario, 3 no console.";

const FAILED: u8 = 1;
const BAD_INPUT: u8 = 2;
const NO_CONSOLE: u8 = 3;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(FAILED),
        Err((code, report)) => {
            eprintln!("{report:?}");
            ExitCode::from(code)
        }
    }
}

type Failure = (u8, miette::Report);

fn no_console(error: &PeerError) -> Failure {
    (NO_CONSOLE, miette::miette!("{error}"))
}

fn run(arguments: &Arguments) -> Result<bool, Failure> {
    let scenarios = chosen(arguments)?;
    let bench = bench(arguments, &scenarios)?;
    let extent = Extent {
        mutants: !arguments.no_mutants,
        twice: true,
    };
    // By the wall clock a scenario mostly sleeps.
    let usual = match bench.kind() {
        ConsoleKind::Virtual if arguments.relay.is_none() => 2,
        ConsoleKind::Qemu => 2,
        _ => 1,
    };
    let jobs = usize::from(arguments.jobs.unwrap_or(usual)).min(scenarios.len());
    let cases = run_all(&scenarios, bench.as_ref(), extent, jobs);
    let sums = Sums::of(&cases);
    if let Some(path) = &arguments.junit {
        let written = std::fs::File::create(path)
            .map_err(|error| error.to_string())
            .and_then(|file| {
                junit(&cases, bench.kind())
                    .serialize(file)
                    .map_err(|e| e.to_string())
            });
        written.map_err(|error| {
            (
                BAD_INPUT,
                miette::miette!("cannot write {}: {error}", path.display()),
            )
        })?;
    }
    match arguments.format {
        Format::Json => {
            let object = object(&cases, &sums, bench.kind()).to_string();
            println!("{}", escaped_json(&object));
        }
        Format::Text => println!("{}", sums.sentence(bench.kind())),
    }
    Ok(cases.iter().all(Case::is_met))
}

/// The scenarios that were asked for.
fn chosen(arguments: &Arguments) -> Result<Vec<Scenario>, Failure> {
    let bad = |error: sutura_host::scene::SceneError| (BAD_INPUT, miette::Report::new(error));
    let mut all = Vec::new();
    for path in &arguments.scenario {
        all.extend(Scenario::load(path).map_err(bad)?);
    }
    if arguments.scenario.is_empty() {
        all = built_in().map_err(bad)?;
    }
    let only = &arguments.only;
    let names: Vec<String> = all.iter().map(|scenario| scenario.name.clone()).collect();
    // A whole name is that one only.
    let fits = |name: &str, part: &String| {
        name == part || (name.contains(part.as_str()) && !names.contains(part))
    };
    all.retain(|s| only.is_empty() || only.iter().any(|part| fits(&s.name, part)));
    if all.is_empty() {
        let message = miette::miette!(
            help = format!("there are: {}", names.join(", ")),
            "no scenario has `{}` in its name",
            only.join("` or `")
        );
        return Err((BAD_INPUT, message));
    }
    Ok(all)
}

#[cfg(unix)]
fn bench(arguments: &Arguments, scenarios: &[Scenario]) -> Result<Box<dyn Bench>, Failure> {
    use sutura_hil::scenario::processes::{AtPort, Emulated, Processes, Relay};
    let sutura = || arguments.sutura.clone().unwrap_or_else(|| "sutura".into());
    if let Some(link) = &arguments.relay {
        if scenarios.len() != 1 {
            let message = miette::miette!(
                help = "name one with --only",
                "--relay goes with one scenario, not with {}",
                scenarios.len()
            );
            return Err((BAD_INPUT, message));
        }
        let relay = Relay::new(sutura(), link.clone()).map_err(|error| no_console(&error))?;
        eprintln!(
            "the console is at {}; the scenario begins when it is armed",
            link.display()
        );
        return Ok(Box::new(relay));
    }
    Ok(match arguments.console.as_str() {
        "native" => Box::new(Native),
        "qemu" => {
            let image = arguments.image.clone();
            let image = image.unwrap_or_else(sutura_hil::qemu::default_image);
            Box::new(Emulated { image })
        }
        "virtual" => Box::new(Processes::new(sutura()).map_err(|error| no_console(&error))?),
        port => Box::new(AtPort::new(port).map_err(|error| no_console(&error))?),
    })
}

#[cfg(not(unix))]
fn bench(arguments: &Arguments, _: &[Scenario]) -> Result<Box<dyn Bench>, Failure> {
    if arguments.console == "native" && arguments.relay.is_none() {
        return Ok(Box::new(Native));
    }
    Err((
        NO_CONSOLE,
        miette::miette!("this system has only `--console native`"),
    ))
}

/// Runs all, several at a time, and says each one as soon as it is its turn.
fn run_all(scenarios: &[Scenario], bench: &dyn Bench, extent: Extent, jobs: usize) -> Vec<Case> {
    let next = AtomicUsize::new(0);
    let cases: Mutex<Vec<Option<Case>>> = Mutex::new(scenarios.iter().map(|_| None).collect());
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(scenario) = scenarios.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let case = Case::run(scenario, bench, extent);
                    eprint!("{}", escaped(&lines(&case)));
                    let index = scenarios.iter().position(|s| s.name == scenario.name);
                    let mut cases = cases
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner);
                    if let Some(place) = index.and_then(|index| cases.get_mut(index)) {
                        *place = Some(case);
                    }
                }
            });
        }
    });
    let cases = cases
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    cases.into_iter().flatten().collect()
}
