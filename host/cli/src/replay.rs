//! `sutura replay`: a recorded session, run again through solver and console code.

use crate::failure::{Cause, Failure};
use crate::recording::{build, failure};
use crate::run::positive;
use crate::series::{self, SERIES_HZ, Series};
use crate::signals::{Stoppable, then, unfinished};
use crate::{Format, Global, display, files};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use sutura_host::recording::replay::{
    ConsoleVerdict, HostVerdict, NativeTicks, Outcome, Replayed, Report, compare_contacts,
    replay_console, replay_host_while,
};
use sutura_host::recording::{About, Begins, End, Recording};
use sutura_host::session::SceneSolver;
use sutura_host::text::one_line;

/// Runs a recorded session again: the console's ticks and the solver's steps, compared bit by bit.
///
/// Ends with code 6 where either takes another course than was recorded, and says at which tick. What cannot be compared,
/// because it is not in the recording, is said too; with code 9 where that is all of the ticks or of the solves, as in a file of
/// the last seconds of a session. A recording that was made with another console code, or before codes
/// had numbers, is not replayed and ends with code 2: the release that made it replays it.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct ReplayArgs {
    /// What `sutura run --record FILE` wrote.
    pub file: PathBuf,
    /// Fails with code 1 unless everything in the recording could be compared.
    #[arg(long)]
    pub verify: bool,
    /// Where the console's ticks are run: in this process, or in the firmware image (simulated consoles only).
    #[arg(long, value_name = "CONSOLE", default_value = "native")]
    pub console: Console,
    /// Firmware image for `--console qemu`, in place of the one built from this checkout.
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Writes the session to this new folder as a row of .vtu files and a .pvd that lists them, for ParaView.
    #[arg(long, value_name = "DIR")]
    pub series: Option<PathBuf>,
    /// Files of `--series` a second of the session; at most one for each solve.
    #[arg(long, value_name = "HZ", value_parser = positive, default_value_t = SERIES_HZ)]
    pub series_hz: f64,
}

const EXAMPLES: &str = "\
Examples:
  sutura run --record session.mcap                 first
  sutura replay session.mcap                       the same bits?
  sutura replay session.mcap --console qemu        the same bits on the ARM image?
  sutura replay session.mcap --verify --format json
  sutura replay session.mcap --series again        then: paraview again/session.pvd

A recording opens in other programs too (MCAP: Foxglove, the mcap command).";

/// What runs the console's ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Console {
    /// The same code in this process.
    Native,
    /// The firmware image under QEMU.
    #[cfg(unix)]
    Qemu,
}

/// Replays and prints what came of it.
///
/// # Errors
/// A file that is no recording; a divergence; with `--verify` anything that could not be compared.
pub fn run(args: &ReplayArgs, global: &Global) -> Result<(), Failure> {
    let recording = Recording::read(&args.file).map_err(failure)?;
    if recording.about.begins == Begins::Later {
        if args.series.is_some() {
            return Err(begins_later(&args.file, "no pictures can be drawn"));
        }
        note!(
            "{}: it begins in the middle of a session, so that its solves cannot be run again; what needs no past is compared",
            args.file.display()
        );
    }
    if let Some(folder) = &args.series {
        files::folder("--series", folder, global)?;
        files::never_into(folder, series::is_file, std::slice::from_ref(&args.file))?;
    }
    let console = console(args, &recording)?;
    let series = args.series.as_deref().map(|dir| (dir, args.series_hz));
    // A signal ends this at once: it has no handler.
    let (host, pictures) = host(&recording, series, &AtomicBool::new(false))?;
    let here = here(&recording);
    let same_bits = recording.about.same_bits(&here);
    let verdict = verdict(args, &recording, &console, &host, same_bits);
    let report = Report::of(&args.file, &recording, &console, &host);
    // `--verify` fails what would be good in part.
    let status = match &verdict {
        Err(failure) if failure.cause == Cause::Failed => failure.cause.word(),
        _ => report.status,
    };
    match global.format {
        Format::Json => display::object(&Report {
            status,
            pictures,
            ..report
        }),
        Format::Text => display::lines(&text(&recording, &console, &host, &here)),
    }
    verdict
}

/// Why something cannot be made of a recording that begins in the middle of a session.
pub fn begins_later(file: &Path, what: &str) -> Failure {
    let message = format!(
        "{} holds the last seconds of a session: what the solver was before is not known, and {what}",
        file.display()
    );
    let help =
        "record whole sessions: --record FILE; `sutura view` shows forces and events of this one";
    Failure::say(Cause::NotReplayed, message, help)
}

/// What this program would write in the recording's place.
fn here(recording: &Recording) -> About {
    About::here(build(), &recording.about.plan, &recording.about.tissue)
}

fn console(args: &ReplayArgs, recording: &Recording) -> Result<ConsoleVerdict, Failure> {
    let replay = |console: &mut dyn Replayed| replay_console(recording, console);
    match args.console {
        Console::Native => Ok(replay(&mut NativeTicks::new(&recording.about.plan.device))),
        #[cfg(unix)]
        Console::Qemu => {
            use crate::run::emulated;
            use std::time::Duration;
            use sutura_host::recording::replay::WholeConsole;
            let image = emulated::image(args.image.as_deref())?;
            // It runs faster than that, but must end some time.
            let states = recording.frames.len() as u64;
            let limit = Duration::from_secs(120) + Duration::from_millis(2 * states);
            let mut console =
                sutura_hil::QemuConsole::start(image, limit).map_err(emulated::failure)?;
            let verdict = replay(&mut WholeConsole::new(&mut console));
            console.quit().map_err(emulated::failure)?;
            Ok(verdict)
        }
    }
}

/// Runs the solver's steps again; with `series`, a folder and how many pictures a second, draws them there, and says how many.
fn host(
    recording: &Recording,
    series: Option<(&Path, f64)>,
    stop: &AtomicBool,
) -> Result<(HostVerdict, Option<usize>), Failure> {
    let about = &recording.about;
    if about.begins == Begins::Later {
        return Ok((compare_contacts(recording), None));
    }
    let shown = crate::work::watch();
    let scene = crate::scene::recorded(recording)?;
    let mut solver = SceneSolver::for_session(&scene, &about.plan)?;
    drop(shown);
    let same_bits = about.same_bits(&here(recording));
    let mut series = series.map(|(folder, hz)| Series::new(folder, &scene, hz));
    let verdict = replay_host_while(recording, &mut solver, same_bits, |solver, here| {
        if let Some(series) = &mut series {
            series.see(solver, here.console_time_us);
        }
        then(stop)
    });
    let Some(series) = series else {
        return Ok((verdict, None));
    };
    let (path, pictures) = series.finish()?;
    note!("{pictures} pictures: open {} in ParaView", path.display());
    Ok((verdict, Some(pictures)))
}

/// Draws a session that has been recorded.
///
/// # Errors
/// A recording that cannot be read, files that cannot be written, `stop` that was set before.
pub fn draw(recording: &Path, series: (&Path, f64), stop: &Arc<AtomicBool>) -> Result<(), Failure> {
    let recording = Recording::read(recording).map_err(failure)?;
    let _ends = Stoppable::by(stop);
    let drawn = host(&recording, Some(series), stop);
    if stop.load(Ordering::Relaxed) {
        let help = "the session is whole, and so is its recording: `sutura replay FILE --series DIR` draws it";
        return Err(unfinished("not all pictures were drawn", help));
    }
    drawn.map(|_| ())
}

fn text(
    recording: &Recording,
    console: &ConsoleVerdict,
    host: &HostVerdict,
    here: &About,
) -> String {
    let about = &recording.about;
    let mut lines = vec![format!(
        "  recorded   by version {} on {} ({}), console {}",
        about.program, about.target, about.simd, about.console
    )];
    if let End::Cut(reason) = &recording.end {
        lines.push(format!("  cut off    {reason}: what is there is replayed"));
    }
    let mut of_console = format!(
        "  console    {} of {} ticks the same, hash {:016x}",
        console.verified_ticks, console.ticks, console.hash
    );
    if console.poses > 0 {
        of_console = format!(
            "  console    poses of {} of {} ticks the same; nothing else can be compared",
            console.poses, console.ticks
        );
    }
    if console.unverified_ticks > 0 {
        of_console += &format!(
            "; {} before could not be compared",
            console.unverified_ticks
        );
    }
    if console.lost_frames > 0 {
        of_console += &format!("; the line lost {} frames", console.lost_frames);
    }
    lines.push(of_console);
    if let Some(limited) = console.ticks_limited.as_ref().and_then(display::limited) {
        lines.push(format!("  limited    {limited}"));
    }
    let of_bits = match (host.identical, about.same_bits(here)) {
        (true, _) => "to the bit".to_owned(),
        (false, true) => "but for bits".to_owned(),
        (false, false) => format!(
            "to {:.1e} of the largest force, by another build or other instructions ({} there, {} here)",
            host.largest_difference, about.simd, here.simd
        ),
    };
    lines.push(match about.begins {
        Begins::Later => format!(
            "  host       {} contacts went down as they were solved; {} solves cannot be run again",
            host.contacts, host.steps
        ),
        Begins::Session => format!(
            "  host       {} of {} solves the same, {of_bits}",
            host.verified_steps, host.steps
        ),
    });
    let lines: Vec<_> = lines.iter().map(|line| one_line(line)).collect();
    lines.join("\n")
}

fn verdict(
    args: &ReplayArgs,
    recording: &Recording,
    console: &ConsoleVerdict,
    host: &HostVerdict,
    same_bits: bool,
) -> Result<(), Failure> {
    let mut diverged = Vec::new();
    if let Some(tick) = console.diverged_at {
        let how = console.why.as_deref().unwrap_or_default();
        diverged.push(format!("the console diverges at tick {tick}: {how}"));
    }
    if let (Some(step), Some(tick)) = (host.diverged_step, host.diverged_at) {
        let how = host.why.as_deref().unwrap_or_default();
        diverged.push(format!(
            "the host diverges at solve {step}, for tick {tick}: {how}"
        ));
    }
    if !diverged.is_empty() {
        let help = if same_bits {
            "the same build recorded it: the file was changed, or something is not deterministic"
        } else {
            "another build recorded it: what changed since, or did the file?"
        };
        return Err(Failure::say(Cause::Diverged, diverged.join("; "), help).after_summary());
    }
    if let End::Cut(reason) = &recording.end {
        let message = format!(
            "the recording is cut off ({reason}): {} ticks and {} solves are there",
            console.ticks, host.steps
        );
        let help = "what is there is as it was recorded, as far as it says above";
        return Err(Failure::say(Cause::BadInput, message, help).after_summary());
    }
    let outcome = Outcome::of(recording, console, host);
    let mut unsure = Vec::new();
    if let (Some(tick), Some(why)) = (console.unverifiable_from, &console.why) {
        unsure.push(format!("the console from tick {tick} on: {why}"));
    }
    if let (Some(step), Some(why)) = (host.unverifiable_from, &host.why) {
        unsure.push(format!("the host from solve {step} on: {why}"));
    }
    if unsure.is_empty() {
        return Ok(());
    }
    let message = format!("cannot be compared: {}", unsure.join("; "));
    if outcome == Outcome::NotReplayed {
        let help = "record whole sessions (--record FILE), on a disk that keeps up; --save-last keeps the last seconds to look at";
        return Err(Failure::say(Cause::NotReplayed, message, help).after_summary());
    }
    if args.verify {
        let help = "record whole sessions, on a disk that keeps up";
        return Err(Failure::say(Cause::Failed, message, help).after_summary());
    }
    note!("{message}");
    Ok(())
}
