//! `sutura view [SCENE]`: sessions with a virtual console that a page steers, one after the other, until the program is closed.
//!
//! Entry point: [`run`]. They are in lockstep, paced by the wall clock: they can stand still, and on a machine that is too slow
//! they are slow, and lose nothing.

use super::hello::Kind;
use super::helm::{COMMANDS, Ended, Helm, settings};
use super::page::Page;
use super::prepare::{Prepared, Wish};
use super::show::Show;
use crate::failure::{Cause, Failure};
use crate::recording::{build, failure};
use crate::run::session_failure;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::Receiver;
use sutura_hil::NativeConsole;
use sutura_host::picture::Showing;
use sutura_host::recording::{About, Recorder, TappedConsole, TappedSolver};
use sutura_host::session::{Progress, run_steered};
use sutura_view::Request;

/// A session that stands still at a time.
pub struct PauseAt {
    at_s: f64,
    reached: Arc<AtomicBool>,
}

impl PauseAt {
    /// So long after its start \[s\].
    pub fn new(at_s: f64) -> Self {
        Self {
            at_s,
            reached: Arc::default(),
        }
    }

    /// Set when it stands still there.
    pub fn reached(&self) -> Arc<AtomicBool> {
        self.reached.clone()
    }
}

/// Runs sessions until `stop` is set; the first one stands still at `pause`.
///
/// # Errors
/// The first scene cannot be run; a recording cannot be written.
pub fn run(
    page: &mut Page,
    wish: Wish,
    record: Option<&Path>,
    mut pause: Option<PauseAt>,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let mut prepared = {
        let _shown = crate::work::watch();
        Prepared::of(wish)?
    };
    let Some(asked) = page.take_asked() else {
        return Ok(());
    };
    for number in 1.. {
        let file = record.map(|file| numbered(file, number));
        match session(
            page,
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
    page: &Page,
    asked: &Receiver<Request>,
    prepared: Prepared,
    (record, pause): (Option<&Path>, Option<PauseAt>),
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
    let show = Show::begin(page, &scene, &plan, &solver, &kind)?;
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
    let mut helm = Helm::new(asked, stop, &show, wish, plan);
    if let Some(PauseAt { at_s, reached }) = pause {
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

/// The file of a session: the first has the name itself.
fn numbered(file: &Path, number: u32) -> PathBuf {
    if number == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let end = file.extension().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}-{number}.{end}"))
}
