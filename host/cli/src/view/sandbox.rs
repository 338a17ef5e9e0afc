//! `sutura view [SCENE]`: sessions with a virtual console that a page steers, one after the other, until the program is closed.
//!
//! Entry point: [`run`]. They are in lockstep, paced by the wall clock: they can stand still, and on a machine that is too slow
//! they are slow, and lose nothing.

use super::hello::Kind;
use super::helm::{COMMANDS, Ended, Helm, Stopper};
use super::live::Live;
use super::page::Page;
use super::prepare::Prepared;
use super::saves::{Saves, named, unused};
use super::settings::Setting;
use super::show::Show;
use super::take_out::TakeOut;
use crate::failure::{Cause, Failure};
use crate::recording::{LAST, build, failure};
use crate::run::session_failure;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use sutura_hil::NativeConsole;
use sutura_host::picture::{Offer, Showing};
use sutura_host::recording::{About, Recorder, TappedConsole, TappedSolver};
use sutura_host::session::{EndingKind, Progress, run_steered};
use sutura_view::Request;

/// Where a session is recorded that a page wants recorded, if no file was named.
const RECORDED: &str = "sutura-view.mcap";
/// Between two looks for a page.
const LOOKS_EVERY: Duration = Duration::from_millis(20);

/// A time at which something is to be seen, and whether it is.
pub struct At {
    /// By the session's clock \[s\].
    pub at_s: f64,
    /// Set when it is, to the time from one picture to the next there \[s\].
    pub reached: Arc<OnceLock<f64>>,
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
    let mut held = None;
    for number in 1.. {
        let file = match record {
            Some(file) => named(file, number, (&prepared.read, prepared.wish.overwrite)),
            None => unused(Path::new(RECORDED)),
        };
        let file = Some(file).filter(|_| prepared.wish.is_recorded);
        match session(
            (page, live),
            &asked,
            prepared,
            (file, record),
            (pause.take(), held.take()),
            stop,
        )? {
            Ended::Closed => break,
            Ended::Next(next, stopper) => (prepared, held) = (*next, stopper),
        }
    }
    Ok(())
}

fn session(
    (page, live): (&Page, Option<&Live>),
    asked: &Receiver<Request>,
    prepared: Prepared,
    (file, named): (Option<PathBuf>, Option<&Path>),
    (pause, held): (Option<At>, Option<Stopper>),
    stop: &AtomicBool,
) -> Result<Ended, Failure> {
    let jaws = prepared.scene.driven_jaws();
    let out = TakeOut::of(&prepared.scene, &prepared.solver, &prepared.plan);
    let commands = COMMANDS.into_iter().filter(|name| match *name {
        "jaws" => jaws.is_some(),
        "take_out" => out.is_some(),
        _ => true,
    });
    let kind = Kind {
        source: "live",
        pace: "lockstep",
        console: "virtual",
        motors: false,
        commands: commands.collect(),
        has_model: prepared.solver.model().is_some(),
        scenes: prepared.scenes(),
        tissues: Prepared::tissues(),
        settings: prepared.settings.iter().map(Setting::said).collect(),
    };
    let Prepared {
        wish,
        scene,
        sources,
        plan,
        settings,
        mut solver,
        ..
    } = prepared;
    let show = Show::begin(page, &scene, &plan, &solver, &kind, live.map(Live::tap))?;
    let about = About {
        console: "virtual".to_owned(),
        lockstep: true,
        ..About::here(
            file.as_ref().map(|_| build()).unwrap_or_default(),
            &plan,
            &scene.tissue.to_string(),
        )
    };
    let recorder = Recorder::start_seen(file.as_deref(), about, sources, show.telemetry().seen());
    let recorder = recorder.map_err(failure)?;
    // Beside what was asked for.
    let last = named.map_or(LAST.into(), |file| file.with_file_name(LAST));
    let saves = Saves::new(recorder.saver(), show.telemetry().clone(), last, file);
    let console = NativeConsole::new(&plan.device);
    let mut console = console.map_err(|error| {
        let message = format!("the device is unusable: {error}");
        Failure::say(Cause::BadInput, message, "correct its device file")
    })?;
    let mut console = TappedConsole::new(&mut console, recorder.tap());
    let tapped = TappedSolver::new(&mut solver, recorder.tap()).sketched(&scene);
    let mut showing = Showing::new(tapped, Some(show.offer()));
    if pause.is_some() {
        await_page(&show.offer(), stop);
    }
    let mut helm = Helm::new((asked, stop), &show, wish, (plan, settings), saves);
    helm.close_jaws_of(jaws);
    helm.take_out_by(out);
    helm.held_by(held);
    if let Some(At { at_s, reached }) = pause {
        helm.pause_at(at_s, reached);
    }
    let go_on = |note: &Progress<'_>| {
        show.going(|going| going.limited = Some(note.limited));
        ControlFlow::Continue(())
    };
    let ran = run_steered(&mut console, &plan, &mut showing, go_on, &mut helm);
    let (ended, file) = helm.ended();
    let recorded = recorder.finish();
    let shown = show.end(page.place());
    tracing::info!("shown: {shown:?}");
    let summary = ran.map_err(|error| session_failure(error, "virtual"))?;
    if summary.ending.kind != EndingKind::Ok {
        note!("the session ended as {}", summary.status);
    }
    recorded.map_err(failure)?;
    if let Some(file) = file {
        note!("recorded in {}", file.display());
    }
    Ok(ended)
}

/// Pictures are made for who watches: a page has to be there, and to be noticed, before time stands still.
fn await_page(offer: &Offer, stop: &AtomicBool) {
    while !offer.is_wanted() && !stop.load(Ordering::Relaxed) {
        std::thread::sleep(LOOKS_EVERY);
    }
}
