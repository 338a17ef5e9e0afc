//! Sessions, tick by tick on the virtual console or in real time on any, and recordings run again. Entry points from Python: `sutura.run`,
//! `sutura.replay`. Both return JSON with the keys of the command's.

use crate::error::{self, Error, Watch};
use crate::scene::Scene;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sutura_files::{is_same, may_write};
use sutura_hil::{NativeConsole, VirtualConsole};
use sutura_host::link::{LinkOptions, Port, drain, knock, open_serial};
use sutura_host::recording::replay::{
    HostVerdict, NativeTicks, Report, compare_contacts, replay_console, replay_host_while,
};
use sutura_host::recording::{
    About, Begins, Recorder, Recording, RecordingError, Tap, TappedConsole, TappedPort,
    TappedSolver,
};
use sutura_host::scene::{self, LONGEST_S, Tissue};
use sutura_host::session::{
    Line, Plan, Progress, Rendering, SceneSolver, Solve, Summary, check_rate, run_lockstep,
    run_real_time,
};
use sutura_shared::control::TICK_HZ;

/// Runs a scene on a console: see `sutura.run`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "by name, in Python")]
pub fn run_session(
    py: Python<'_>,
    scene: &Scene,
    seconds: Option<f64>,
    host_hz: Option<f64>,
    rendering: Option<&str>,
    record: Option<PathBuf>,
    build: String,
    console: &str,
    lockstep: bool,
    overwrite: bool,
) -> PyResult<String> {
    let plan = plan(&scene.inner, seconds, host_hz, rendering)?;
    if let Some(file) = &record {
        may_record(file, scene, overwrite)?;
    }
    let (inner, sources) = (scene.inner.clone(), scene.sources.clone());
    let built = inner.clone();
    let solver = error::apart(py, move || SceneSolver::for_session(&built, &plan))?;
    py.detach(|| {
        let mut solver = solver.map_err(|error| error::of_solve(&error))?;
        // In lockstep columns are computed in step: when they are there must not depend on this machine's pace.
        if !lockstep {
            solver.start_worker();
        }
        let about = About {
            console: console.to_owned(),
            lockstep,
            worker: !lockstep,
            ..About::here(build, &plan, &inner.tissue.to_string())
        };
        let recorder = Recorder::start(record.as_deref(), about, sources);
        let recorder = recorder.map_err(|error| of_recording(&error))?;
        let mut solver = TappedSolver::new(&mut solver, recorder.tap()).sketched(&inner);
        let mut watch = Watch::default();
        let watched = |_: &Progress<'_>| watch.then();
        let summary = match lockstep {
            true => in_lockstep(&plan, &mut solver, &recorder.tap(), watched),
            false => in_real_time(console, &plan, &mut solver, &recorder.tap(), watched),
        };
        recorder.finish().map_err(|error| of_recording(&error))?;
        watch.end()?;
        serde_json::to_string(&summary?).map_err(|error| Error::new_err(error.to_string()))
    })
}

/// Whether a recording may be written there: nothing that is read is written over, and what is there only if that is asked.
fn may_record(file: &Path, scene: &Scene, overwrite: bool) -> PyResult<()> {
    let said = |why: String| Err(Error::new_err(error::harmless(&why)));
    let shown = file.display();
    if let Some(read) = scene.read.iter().find(|read| is_same(read, file)) {
        return said(format!(
            "record is {shown}, the same file as {}, which the scene is read from: name another file",
            read.display()
        ));
    }
    if let Err(error) = may_write(file) {
        return said(format!("record is {shown}: {error}"));
    }
    let found = file.metadata();
    if !overwrite && found.is_ok_and(|found| found.is_file() && found.len() > 0) {
        return said(format!(
            "record is {shown}, which is there already: name another file, or write over it with overwrite=True"
        ));
    }
    Ok(())
}

/// With the virtual console, a tick at a time.
fn in_lockstep(
    plan: &Plan,
    solver: &mut dyn Solve,
    tap: &Tap,
    watch: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> PyResult<Summary> {
    let mut console = NativeConsole::new(&plan.device)
        .map_err(|error| Error::new_err(format!("the device is unusable: {error}")))?;
    let mut console = TappedConsole::new(&mut console, tap.clone());
    run_lockstep(&mut console, plan, solver, watch).map_err(|error| error::of_session(&error))
}

/// With a console that runs by its own clock: the virtual one in this process, or one at a port. One that goes away ends the
/// session.
fn in_real_time(
    name: &str,
    plan: &Plan,
    solver: &mut dyn Solve,
    tap: &Tap,
    watch: impl FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> PyResult<Summary> {
    let link = |error| error::of_link(&error);
    let options = LinkOptions {
        real_time: true,
        at_once: true,
        give_up: error::gives_up,
        ..LinkOptions::default()
    };
    let mut simulated = None;
    let mut limits = None;
    let port = if name == "virtual" {
        let console = VirtualConsole::start_in_memory(&plan.device).map_err(link)?;
        limits = Some(console.limits());
        simulated.insert(console).host_port().map_err(link)?
    } else {
        let mut port = open_serial(name).map_err(link)?;
        // A session that nobody uses is nobody's: the next one is opened as if this had not been.
        knock(port.as_mut(), &options).map_err(link)?;
        drain(port.as_mut(), &options).map_err(link)?;
        port
    };
    let port: Box<dyn Port> = Box::new(TappedPort::new(port, tap.clone()));
    let line = Line::Once {
        port,
        attendant: None,
        limits,
    };
    run_real_time(line, options, plan, solver, watch).map_err(|error| error::of_session(&error))
}

/// The session that a scene asks for, but for what is given.
fn plan(
    scene: &Arc<scene::Scene>,
    seconds: Option<f64>,
    host_hz: Option<f64>,
    rendering: Option<&str>,
) -> PyResult<Plan> {
    if scene.tissue == Tissue::Auto {
        return Err(Error::new_err(error::harmless(&format!(
            "the scene {:?} has `auto` tissue, which depends on what this machine can do: name a model in [tissue]",
            scene.name
        ))));
    }
    let plan = Plan::of_scene(scene).map_err(|error| error::of_plan(&error))?;
    let seconds = seconds.unwrap_or(plan.seconds);
    if !(seconds > 0.0 && seconds <= LONGEST_S) {
        return Err(PyValueError::new_err(format!(
            "seconds is {seconds}: give a length above 0 and at most {LONGEST_S}, a day"
        )));
    }
    let host_hz = host_hz.unwrap_or(plan.host_hz);
    if !(host_hz > 0.0 && host_hz <= f64::from(TICK_HZ)) {
        return Err(PyValueError::new_err(format!(
            "host_hz is {host_hz}: give a rate above 0 and at most {TICK_HZ}"
        )));
    }
    check_rate(host_hz, TICK_HZ)
        .map_err(|error| PyValueError::new_err(format!("host_hz: {error}")))?;
    let rendering = match rendering {
        None => plan.rendering,
        Some("hold") => Rendering::Hold,
        Some("tangent") => Rendering::Tangent,
        Some("rows") => Rendering::Rows,
        Some(other) => {
            return Err(PyValueError::new_err(error::harmless(&format!(
                "rendering is {other:?}: give \"hold\", \"tangent\" or \"rows\""
            ))));
        }
    };
    Ok(Plan {
        host_hz,
        seconds,
        rendering,
        ..plan
    })
}

/// Runs a recording again: see `sutura.replay`.
#[pyfunction]
pub fn replay_session(py: Python<'_>, path: PathBuf, build: String) -> PyResult<String> {
    py.detach(|| {
        let recording = Recording::read(&path).map_err(|error| of_recording(&error))?;
        let about = &recording.about;
        let here = About::here(build, &about.plan, &about.tissue);
        let console = replay_console(&recording, &mut NativeTicks::new(&about.plan.device));
        let host = match about.begins {
            Begins::Later => compare_contacts(&recording),
            Begins::Session => replay_solves(&recording, about.same_bits(&here))?,
        };
        let report = Report::of(&path, &recording, &console, &host);
        serde_json::to_string(&report).map_err(|error| Error::new_err(error.to_string()))
    })
}

/// Runs the solver's steps of a recording again.
fn replay_solves(recording: &Recording, same_bits: bool) -> PyResult<HostVerdict> {
    let scene = recording.scene().map_err(|error| error::of_scene(&error))?;
    let plan = recording.about.plan;
    let solver =
        Python::attach(|py| error::apart(py, move || SceneSolver::for_session(&scene, &plan)))?;
    let mut solver = solver.map_err(|error| error::of_solve(&error))?;
    let mut watch = Watch::default();
    let verdict = replay_host_while(recording, &mut solver, same_bits, |_, _| watch.then());
    watch.end()?;
    Ok(verdict)
}

fn of_recording(error: &RecordingError) -> PyErr {
    Error::new_err(error::harmless(&format!("{error}: {}", error.help())))
}
