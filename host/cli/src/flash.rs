//! `sutura flash`: writes a firmware image to a board.

use crate::failure::{Cause, Failure};
use crate::run::link_failure;
use crate::{Format, Global};
use clap::{Args, ValueEnum};
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use sutura_board::{
    BOOT_PINS, DfuUtil, Done, Flash, FlashError, Image, Loader, ProbeRs, Replaced, flash,
};
use sutura_host::link::{consoles, touch};

/// Time in which a console that was touched has to show up as the loader of its ROM: that measures the crystal, and the bus takes a second.
const LOADER_WAIT: Duration = Duration::from_secs(6);
/// Time between two looks.
const LOOK: Duration = Duration::from_millis(300);

const EXAMPLES: &str = "\
Examples:
  sutura flash image.elf                              the board that is there: in its loader, running, or on a probe
  sutura flash image.bin --method dfu                 the board is in the loader of its ROM, by its BOOT0
  sutura flash image.hex --method probe               through a debug probe
  sutura flash image.bin --port /dev/ttyACM0          a running console, at rest: it goes into that loader by itself

Without --method: a board in its ROM's loader, else a console on USB, else a probe.
The loader is written by dfu-util, a probe by probe-rs. Chip, board and what is there are checked first, all is read back after.
The motors' supply stays off meanwhile.

Exit codes: 0 written and read back, 1 the program failed or another byte came back, 2 image or board is not what it has to be,
3 nothing to write to, or no program for it.";

/// Writes a firmware image to a board.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct FlashArgs {
    /// ELF of `cargo xtask firmware`, or .bin or .hex made of it.
    image: PathBuf,
    /// Which board: a console's serial number, or what `dfu-util -l` or `probe-rs list` show.
    #[arg(long, value_name = "SERIAL", conflicts_with = "port")]
    device: Option<String>,
    /// Which board: the serial port of a running console.
    #[arg(long)]
    port: Option<String>,
    /// How it gets there.
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// The board that you mean: an image for another one is refused.
    #[arg(long, value_name = "NAME")]
    board: Option<String>,
    /// Also over another board's image or somebody else's program; with --board an image that does not say what it is.
    #[arg(long)]
    force: bool,
}

/// How an image gets onto a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// The loader in the chip's ROM, over USB: BOOT0 high at reset.
    Dfu,
    /// A debug probe.
    Probe,
    /// A running console, which goes into that loader when it is asked to, at rest only.
    Touch,
}

/// Runs the command.
///
/// # Errors
/// See the exit codes above.
pub fn run(args: &FlashArgs, global: &Global) -> Result<(), Failure> {
    let image = Image::read(&args.image).map_err(failure)?;
    let what = Flash::new(image, &args.image, args.board.as_deref(), args.force);
    let what = what.map_err(failure)?;
    let method = match args.method {
        Some(method) => method,
        None => choose(args)?,
    };
    let device = args.device.as_deref();
    let say = |step: &str| note!("{step}");
    let done = match method {
        Method::Dfu => write(&what, &mut DfuUtil::one(device).map_err(failure)?, say),
        Method::Probe => {
            let probe = ProbeRs::one(device, what.board()).map_err(failure)?;
            write(&what, &mut { probe }, say)
        }
        Method::Touch => {
            let mut loader = touched(args)?;
            write(&what, &mut loader, say).inspect_err(|failure| {
                // What is on it is as it was: let it run again.
                if failure.cause == Cause::BadInput {
                    let _ = loader.start();
                }
            })
        }
    }?;
    tell(&what, method, &done, global);
    Ok(())
}

fn write(what: &Flash, loader: &mut dyn Loader, say: impl FnMut(&str)) -> Result<Done, Failure> {
    flash(what, loader, say).map_err(failure)
}

/// How, if nobody has said it.
fn choose(args: &FlashArgs) -> Result<Method, Failure> {
    if args.port.is_some() {
        return Ok(Method::Touch);
    }
    if let Some(device) = &args.device {
        return Ok(match device {
            probe if probe.contains(':') => Method::Probe,
            console if console.len() == 24 => Method::Touch,
            _ => Method::Dfu,
        });
    }
    // A program that is not there finds nothing; if nothing else does either, it is named.
    let loaders = DfuUtil::all();
    if loaders.as_ref().is_ok_and(|all| !all.is_empty()) {
        return Ok(Method::Dfu);
    }
    if !consoles().is_empty() {
        return Ok(Method::Touch);
    }
    let probes = ProbeRs::all();
    if probes.as_ref().is_ok_and(|all| !all.is_empty()) {
        return Ok(Method::Probe);
    }
    let why = |error: Option<FlashError>, none: &str| match error {
        Some(error @ FlashError::NoProgram { .. }) => {
            let help = miette::Diagnostic::help(&error).map(|help| help.to_string());
            format!("{error}: {}", help.unwrap_or_default())
        }
        Some(error) => error.to_string(),
        None => none.to_owned(),
    };
    Err(Failure::say(
        Cause::NoConsole,
        "no board to write to: none in the loader of its ROM, no console on USB, no probe",
        format!(
            "{}\n{}\n{BOOT_PINS}",
            why(
                loaders.err(),
                "plug a board in, in the USB connector of its own"
            ),
            why(probes.err(), "or a probe"),
        ),
    ))
}

/// The loader that a running console has gone into.
fn touched(args: &FlashArgs) -> Result<DfuUtil, Failure> {
    // Before the console is gone: who cannot write it leaves it alone.
    let before = DfuUtil::all().map_err(failure)?;
    let port = match args.port.as_ref().or(args.device.as_ref()) {
        Some(name) => name.clone(),
        None => the_console()?,
    };
    touch(&port).map_err(link_failure)?;
    note!("asked the console on `{port}` to go into the loader of its ROM");
    let asked = Instant::now();
    while asked.elapsed() < LOADER_WAIT {
        std::thread::sleep(LOOK);
        let mut now = DfuUtil::all().map_err(failure)?;
        now.retain(|one| !before.contains(one));
        if let Some(new) = now.pop() {
            return Ok(new);
        }
    }
    Err(Failure::say(
        Cause::NoConsole,
        format!("the console on `{port}` has not gone into the loader of its ROM"),
        format!(
            "it does so at rest only, with its amplifiers off and no fault: end its session, see `sutura top {port}`. The self-test's image never does. {BOOT_PINS}"
        ),
    ))
}

/// The only console on USB.
fn the_console() -> Result<String, Failure> {
    let found: Vec<_> = consoles()
        .into_iter()
        .map(|one| one.serial_number)
        .collect();
    match found.as_slice() {
        [] => Err(Failure::say(
            Cause::NoConsole,
            "no console is on USB that could be asked to go into the loader of its ROM",
            BOOT_PINS,
        )),
        [only] => Ok(only.clone()),
        _ => Err(failure(FlashError::Several { found })),
    }
}

/// A failure with its exit code.
fn failure(error: FlashError) -> Failure {
    let cause = match error {
        FlashError::Mismatch { .. } | FlashError::Program { .. } | FlashError::File { .. } => {
            Cause::Failed
        }
        FlashError::NoProgram { .. }
        | FlashError::NoLoader
        | FlashError::NoAccess { .. }
        | FlashError::NoProbe
        | FlashError::Several { .. }
        | FlashError::NotThere { .. } => Cause::NoConsole,
        _ => Cause::BadInput,
    };
    Failure::new(cause, error)
}

/// What `--format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Flashed<'a> {
    /// `ok`.
    status: &'static str,
    /// The board, as the image says.
    board: &'a str,
    /// Name of the image, as it says itself.
    image: &'a str,
    /// Its version.
    version: &'a str,
    /// `dfu`, `probe` or `touch`.
    method: Option<String>,
    /// How many were written.
    bytes: usize,
    /// Whether all were read back the same.
    verified: bool,
    /// What was there before: `nothing`, `foreign`, or which image of which board.
    replaced: String,
    /// Whether it runs; if not, press reset.
    started: bool,
}

fn tell(what: &Flash, method: Method, done: &Done, global: &Global) {
    let own = what.identification();
    let (image, version) = own.map_or(("", ""), |own| (own.image(), own.version()));
    let board = what.board().name;
    let replaced = match done.replaced {
        Replaced::Nothing => "nothing".to_owned(),
        Replaced::Foreign => "foreign".to_owned(),
        Replaced::Image(old) => format!("{} {} of {}", old.image(), old.version(), old.board()),
    };
    match global.format {
        Format::Json => crate::display::object(&Flashed {
            status: "ok",
            board,
            image,
            version,
            method: method
                .to_possible_value()
                .map(|value| value.get_name().to_owned()),
            bytes: done.bytes,
            verified: true,
            replaced,
            started: done.started,
        }),
        Format::Text => {
            let after = if done.started {
                "it runs"
            } else {
                "press its reset"
            };
            say!(
                "{board}: {image} {version}, {} bytes written and read back, in place of {replaced}; {after}",
                done.bytes
            );
            if method == Method::Dfu {
                say!("BOOT0 back to ground, if it is not, or the next reset ends in the loader");
            }
        }
    }
}
