//! `sutura view`: a scene or a recording on a live page; and the page that `sutura run --view` has.
//!
//! Entry points: [`run`] for the command, [`Page`] and [`Show`] for a session that is shown.

mod args;
#[cfg(feature = "view")]
mod attendant;
#[cfg(feature = "view")]
mod gauges;
#[cfg(feature = "view")]
mod guide;
#[cfg(feature = "view")]
mod hello;
#[cfg(feature = "view")]
mod helm;
#[cfg(feature = "foxglove")]
mod live;
#[cfg(all(feature = "view", not(feature = "foxglove")))]
#[path = "live_without.rs"]
mod live;
#[cfg(feature = "foxglove")]
mod live_scene;
#[cfg(feature = "view")]
mod page;
#[cfg(feature = "view")]
mod prepare;
#[cfg(feature = "view")]
mod recorded;
#[cfg(feature = "view")]
mod recorded_pictures;
#[cfg(feature = "view")]
mod sandbox;
#[cfg(feature = "view")]
mod saves;
#[cfg(feature = "view")]
pub mod session;
#[cfg(not(feature = "view"))]
#[path = "without.rs"]
pub mod session;
#[cfg(feature = "view")]
mod settings;
#[cfg(feature = "view")]
mod shot;
#[cfg(feature = "view")]
mod show;
#[cfg(feature = "view")]
mod take_out;
#[cfg(feature = "view")]
mod telemetry;

pub use args::PageArgs;

use crate::Global;
use crate::failure::Failure;
use crate::run::host_rate;
use clap::Args;
use std::path::PathBuf;
use sutura_host::scene::Tissue;

/// Shows a scene, or a recording, on a live page in the browser.
///
/// A scene runs with a virtual console until Ctrl-C: drag its tool, pause, step, change tissue and settings. A recording is run
/// again, compared with what was recorded, and played on a time line. The page is served to this machine alone, and to whoever
/// has the key in its address.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct ViewArgs {
    /// Scene file, or a recording (`.mcap`); scenes/palpation.toml (or its copy inside this program) when left out.
    pub file: Option<PathBuf>,
    /// Tissue model, in place of the scene's.
    #[arg(long, value_name = "NAME", value_parser = Tissue::named)]
    pub tissue: Option<Tissue>,
    /// Solver steps a second, 14 to 1000 [Hz]; the scene's when left out.
    #[arg(long, value_name = "HZ", value_parser = host_rate)]
    pub host_hz: Option<f64>,
    /// Writes the session to this file, for `sutura replay` and `sutura view`; sessions after a reset or another scene get a number.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Takes a picture of the page with an installed Chromium, writes it to this file, and ends.
    #[arg(long, value_name = "FILE.png")]
    pub shot: Option<PathBuf>,
    /// Time of the picture by the session's clock [s]; a recording shows its state at that time. 2 when left out, or the end
    /// of a recording that is shorter. Fails if the page draws the picture of another time.
    #[arg(long, value_name = "S", value_parser = from_the_start, requires = "shot")]
    pub at: Option<f64>,
    #[command(flatten)]
    pub page: PageArgs,
}

/// Default time of a picture \[s\].
#[cfg(feature = "view")]
const SHOT_AT_S: f64 = 2.0;
/// Sessions are not longer than this \[s\].
const LATEST_S: f64 = 1e6;

/// A time of a session.
fn from_the_start(text: &str) -> Result<f64, String> {
    let time = text.parse().ok();
    let time = time.filter(|time_s| (0.0..=LATEST_S).contains(time_s));
    time.ok_or_else(|| format!("a time from 0 to {LATEST_S:.0} s"))
}

const EXAMPLES: &str = "\
Examples:
  sutura view                               palpation: open the address that is printed
  sutura view scenes/anastomosis-20.toml --open
  sutura view session.mcap                  what `sutura run --record` wrote, on a time line
  sutura view --record session.mcap         and keep what was done
  sutura view scenes/palpation.toml --shot palpation.png --at 2.5
  sutura view session.mcap --shot forces.png --at 1.2
  sutura run --console /dev/ttyACM0 --view  the same page on a session in real time

Over SSH: `ssh -L 8421:127.0.0.1:8421 HOST`, then open the address on your own machine. Safe stop on the page is software: it is no
emergency stop.";

/// Shows until Ctrl-C.
///
/// # Errors
/// A file that is neither a scene nor a recording; no port.
#[cfg(feature = "view")]
pub fn run(args: &ViewArgs, global: &Global) -> Result<(), Failure> {
    use crate::signals::stop_on_signals;
    for file in [&args.record, &args.shot].into_iter().flatten() {
        crate::files::free(file, global)?;
    }
    let [record, shot] = [&args.record, &args.shot].map(|file| file.as_deref());
    crate::files::apart(&[("--record", record), ("--shot", shot)])?;
    // Refuses bad input before a page says that there is something to see. Ctrl-C ends this at once.
    let what = What::of(args, global.overwrite)?;
    for file in [&args.record, &args.shot].into_iter().flatten() {
        crate::files::never_over(file, what.read())?;
    }
    let stop = stop_on_signals()?;
    if let Some(shot) = &args.shot {
        return shot::take(args, what, shot, &stop);
    }
    let mut page = page::Page::open(&args.page)?;
    let live = live::Live::open(&args.page, page.shared())?;
    if matches!(what, What::Scene(_)) {
        note!("Ctrl-C ends it");
    }
    what.show(&mut page, live.as_ref(), args, None, &stop)
}

/// What is shown.
#[cfg(feature = "view")]
enum What {
    /// A scene with its solver.
    Scene(Box<prepare::Prepared>),
    /// A recording.
    Recording(Box<recorded::Opened>),
}

#[cfg(feature = "view")]
impl What {
    fn of(args: &ViewArgs, overwrite: bool) -> Result<What, Failure> {
        let is_recording = |file: &&PathBuf| file.extension().is_some_and(|end| end == "mcap");
        if let Some(file) = args.file.as_ref().filter(is_recording) {
            return Ok(What::Recording(Box::new(recorded::Opened::read(file)?)));
        }
        let _shown = crate::work::watch();
        Ok(What::Scene(Box::new(prepare::Prepared::of(
            args.wish(overwrite),
        )?)))
    }

    /// Files that are read for it.
    fn read(&self) -> &[PathBuf] {
        match self {
            What::Scene(scene) => &scene.read,
            What::Recording(recording) => std::slice::from_ref(&recording.file),
        }
    }

    /// Time of the picture that is asked for \[s\], if any.
    ///
    /// # Errors
    /// A recording that has no pictures, or none of then.
    fn shot_at(&self, asked_s: Option<f64>) -> Result<f64, Failure> {
        match self {
            What::Scene(_) => Ok(asked_s.unwrap_or(SHOT_AT_S)),
            What::Recording(recording) => recording.shot_at(asked_s),
        }
    }

    /// Until `stop` is set; where a time is given, standing still there.
    fn show(
        self,
        page: &mut page::Page,
        live: Option<&live::Live>,
        args: &ViewArgs,
        at: Option<sandbox::At>,
        stop: &std::sync::Arc<std::sync::atomic::AtomicBool>,
    ) -> Result<(), Failure> {
        match self {
            What::Scene(scene) => {
                sandbox::run(page, live, *scene, args.record.as_deref(), at, stop)
            }
            What::Recording(recording) => {
                let _hasty = crate::signals::Hasty::begin();
                recorded::show(page, *recording, at.as_ref(), stop)
            }
        }
    }
}

#[cfg(feature = "view")]
impl ViewArgs {
    /// What the sandbox is to be.
    fn wish(&self, overwrite: bool) -> prepare::Wish {
        prepare::Wish {
            scene: self.file.clone(),
            tissue: self.tissue,
            host_hz: self.host_hz,
            is_recorded: self.record.is_some(),
            overwrite,
            ..prepare::Wish::default()
        }
    }
}

/// Says why there is no page.
///
/// # Errors
/// Always.
#[cfg(not(feature = "view"))]
pub fn run(_args: &ViewArgs, _global: &Global) -> Result<(), Failure> {
    Err(session::missing())
}
