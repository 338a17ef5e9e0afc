//! `sutura console`: a virtual console as a process of its own, which outlives any host.

use crate::Global;
use crate::failure::{Cause, Failure};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;
use sutura_shared::simulated_console::Without;

/// Runs a virtual console behind a pseudo-terminal until it is told to stop.
///
/// It prints the port that `sutura run --console PORT` opens. Hosts may come, go, and be killed; the
/// console lets its force decay by itself and waits for the next one.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct ConsoleArgs {
    /// Device file that the console is until a host sends another; the built-in bench when left out.
    #[arg(long, value_name = "FILE")]
    pub device: Option<PathBuf>,
    /// A symbolic link to the port, which keeps its name from run to run.
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    /// Guards that the console goes without, by name, e.g. `horizon,checksum`: for tests of tests.
    ///
    /// Whoever tests a host against this console can see whether the test would notice a console that does not watch.
    #[arg(long, value_name = "GUARD,..", value_parser = without)]
    pub without: Option<Without>,
}

/// What `--format json` prints once it runs.
#[derive(Serialize, JsonSchema)]
pub struct Started {
    /// What `sutura run --console` opens: the link, if there is one.
    port: String,
    /// The pseudo-terminal.
    terminal: String,
}

fn without(names: &str) -> Result<Without, String> {
    let mut without = Without::default();
    for name in names.split(',').filter(|name| !name.is_empty()) {
        if !without.switch_off(name) {
            return Err(format!(
                "there is no guard `{name}`; their names are in the book, under Hardware in the loop"
            ));
        }
    }
    Ok(without)
}

const EXAMPLES: &str = "\
Examples:
  sutura console                                    prints the port, runs until Ctrl-C
  sutura console --link /tmp/bench                  then, elsewhere: sutura run --console /tmp/bench
  sutura console --device devices/serial-arm.toml";

/// Runs the console until it is told to stop.
///
/// # Errors
/// A device file that cannot be used; no pseudo-terminal; a link that cannot be made.
#[cfg(unix)]
pub fn run(args: &ConsoleArgs, global: &Global) -> Result<(), Failure> {
    use crate::Format;
    use crate::run::link_failure;
    use crate::signals::stop_on_signals;
    use std::io::Write;
    use std::sync::atomic::{AtomicBool, Ordering};
    use sutura_hil::{PtyLink, VirtualConsole};

    let device = crate::device::open(args.device.as_deref())?;
    let stop = stop_on_signals()?;
    let console = VirtualConsole::start_without(&device, args.without.unwrap_or_default())
        .map_err(link_failure)?;
    let path = console.path().unwrap_or_default().to_owned();
    let make = |link: &PathBuf| {
        PtyLink::make(link, &path).map_err(|error| {
            let message = format!("cannot make the link {}: {error}", link.display());
            let help = "name a place that is yours and where no file is; a link that no console uses any more may be removed";
            Failure::say(Cause::BadInput, message, help)
        })
    };
    let link = args.link.as_ref();
    let port = link.map_or(path.clone(), |link| link.display().to_string());
    let _link = link.map(make).transpose()?;
    match global.format {
        Format::Json => crate::display::object(&Started {
            port,
            terminal: path,
        }),
        Format::Text => say!("{port}"),
    }
    // Whoever started this as a child waits for the line.
    let _ = std::io::stdout().flush();
    let stopped: &AtomicBool = &stop;
    while !stopped.load(Ordering::Relaxed) {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    Ok(())
}

/// Runs the console until it is told to stop.
///
/// # Errors
/// Always: a process of its own needs a pseudo-terminal.
#[cfg(not(unix))]
pub fn run(_args: &ConsoleArgs, _global: &Global) -> Result<(), Failure> {
    let message = "this system has no pseudo-terminals for a console in a process of its own";
    Err(Failure::say(
        Cause::NoConsole,
        message,
        "use `sutura run --console virtual`",
    ))
}
