//! `sutura view [SCENE]`: sessions with a virtual console that a page steers, one after the other, until the program is closed.
//!
//! Entry point: [`run`]. They are in lockstep, paced by the wall clock: they can stand still, and on a machine that is too slow
//! they are slow, and lose nothing.

use super::hello::Kind;
use super::helm::{COMMANDS, Ended, Helm, settings};
use super::live::Live;
use super::page::Page;
use super::prepare::Prepared;
use super::show::Show;
use crate::failure::{Cause, Failure};
use crate::recording::{build, failure};
use crate::run::session_failure;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Duration;
use sutura_hil::NativeConsole;
use sutura_host::picture::Showing;
use sutura_host::recording::{About, Recorder, TappedConsole, TappedSolver};
use sutura_host::session::{Progress, run_steered};
use sutura_view::{Request, Shared};

/// Between two looks for a page.
const LOOKS_EVERY: Duration = Duration::from_millis(20);

/// A time at which something is to be seen, and whether it is.
pub struct At {
    /// By the session's clock \[s\].
    pub at_s: f64,
    /// Set when it is.
    pub reached: Arc<AtomicBool>,
}

/// Runs sessions until `stop` is set, the first one as prepared; that stands still at `pause`.
///
/// # Errors
/// A scene cannot be run; a recording cannot be written.
pub fn run(
    page: &mut Page,
    live: Option<&Live>,
    mut prepared: Prepared,
    record: Option<&Path>,
    mut pause: Option<At>,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let Some(asked) = page.take_asked() else {
        return Ok(());
    };
    for number in 1.. {
        let file = record.map(|file| numbered(file, number));
        match session(
            (page, live),
            &asked,
            prepared,
            (file.as_deref(), pause.take()),
            stop,
        )? {
            Ended::Closed => break,
            Ended::Next(next) => prepared = *next,
        }
    }
    Ok(())
}

fn session(
    (page, live): (&Page, Option<&Live>),
    asked: &Receiver<Request>,
    prepared: Prepared,
    (record, pause): (Option<&Path>, Option<At>),
    stop: &AtomicBool,
) -> Result<Ended, Failure> {
    let kind = Kind {
        source: "live",
        pace: "lockstep",
        console: "virtual",
        motors: false,
        commands: COMMANDS.to_vec(),
        has_model: prepared.solver.model().is_some(),
        scenes: prepared.scenes(),
        tissues: Prepared::tissues(),
        settings: settings(&prepared.plan),
    };
    let Prepared {
        wish,
        scene,
        sources,
        plan,
        mut solver,
    } = prepared;
    let show = Show::begin(page, &scene, &plan, &solver, &kind, live.map(Live::tap))?;
    let about = About {
        console: "virtual".to_owned(),
        lockstep: true,
        ..About::here(
            record.map(|_| build()).unwrap_or_default(),
            &plan,
            &scene.tissue.to_string(),
        )
    };
    let recorder = Recorder::start_seen(record, about, sources, show.telemetry().seen());
    let recorder = recorder.map_err(failure)?;
    let console = NativeConsole::new(&plan.device);
    let mut console = console.map_err(|error| {
        let message = format!("the device is unusable: {error}");
        Failure::say(Cause::BadInput, message, "correct its device file")
    })?;
    let mut console = TappedConsole::new(&mut console, recorder.tap());
    let tapped = TappedSolver::new(&mut solver, recorder.tap());
    let mut showing = Showing::new(tapped, Some(show.offer()));
    if pause.is_some() {
        await_page(page.shared(), stop);
    }
    let mut helm = Helm::new(asked, stop, &show, wish, plan);
    if let Some(At { at_s, reached }) = pause {
        helm.pause_at(at_s, reached);
    }
    let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
    let ran = run_steered(&mut console, &plan, &mut showing, go_on, &mut helm);
    let ended = helm.ended();
    let recorded = recorder.finish();
    let shown = show.end(page.place());
    tracing::info!("shown: {shown:?}");
    ran.map_err(|error| session_failure(error, "virtual"))?;
    recorded.map_err(failure)?;
    if let Some(file) = record {
        note!("recorded in {}", file.display());
    }
    Ok(ended)
}

/// Pictures are made for who watches: a page has to be there before time stands still.
fn await_page(shared: &Shared, stop: &AtomicBool) {
    while shared.figures().joined == 0 && !stop.load(Ordering::Relaxed) {
        std::thread::sleep(LOOKS_EVERY);
    }
}

/// The file of a session: the first has the name itself.
fn numbered(file: &Path, number: u32) -> PathBuf {
    if number == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let end = file.extension().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}-{number}.{end}"))
}
