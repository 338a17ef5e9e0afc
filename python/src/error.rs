//! The package's exceptions. Texts about a scene are those of the command `sutura`, with its lines and its help.

use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread::Builder;
use std::time::Duration;
use sutura_host::link::LinkError;
use sutura_host::session;

/// A text for messages as the command prints them: see `sutura_host::text`.
#[pyfunction]
pub fn harmless(text: &str) -> String {
    sutura_host::text::harmless(text)
}

pyo3::create_exception!(
    sutura,
    Error,
    PyException,
    "What this package raises besides ValueError and TypeError."
);
pyo3::create_exception!(
    sutura,
    SceneError,
    Error,
    "A scene that cannot be used: what is wrong, where, and what to do."
);
pyo3::create_exception!(
    sutura,
    SolveError,
    Error,
    "Work on a good scene that could not be finished."
);
pyo3::create_exception!(
    sutura,
    BusyError,
    Error,
    "A solver that another thread is using."
);

pyo3::create_exception!(
    sutura,
    ConsoleError,
    Error,
    "A console that is not there, went away, or refuses: what is wrong, and the next step."
);

/// A diagnostic as the command shows it off a terminal: no colours, no wrapping, nothing that steers, lines that end.
pub fn text(diagnostic: &dyn Diagnostic) -> String {
    let plain = GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor());
    // Messages say what they come from themselves: a chain of causes would say it twice.
    let plain = plain.with_wrap_lines(false).without_cause_chain();
    let mut text = String::new();
    match plain.render_report(&mut text, diagnostic) {
        Ok(()) => harmless(text.trim_end()),
        Err(_) => harmless(&diagnostic.to_string()),
    }
}

/// A scene that was refused.
pub fn of_scene(error: &sutura_host::scene::SceneError) -> PyErr {
    SceneError::new_err(text(error))
}

/// A scene without a solver, or without a balance where its tools are held.
pub fn of_solve(error: &session::SolveError) -> PyErr {
    match error {
        session::SolveError::NoRest(_) | session::SolveError::NoWay { .. } => {
            SolveError::new_err(text(error))
        }
        _ => SceneError::new_err(text(error)),
    }
}

thread_local! {
    /// Exception for which this thread gives up what it waits for, until somebody is told.
    static GIVEN_UP: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Whether Ctrl-C came: for waits that end with an error of the link, which [`of_link`] makes Python's. Asked again it still came.
pub fn gives_up() -> bool {
    if GIVEN_UP.with_borrow(Option::is_some) {
        return true;
    }
    match interrupted() {
        Ok(()) => false,
        Err(error) => {
            GIVEN_UP.set(Some(error));
            true
        }
    }
}

/// A link that is not there, or broke, or was given up.
pub fn of_link(error: &LinkError) -> PyErr {
    if let Some(interrupt) = GIVEN_UP.take() {
        return interrupt;
    }
    ConsoleError::new_err(harmless(&format!("{error}: {}", error.help())))
}

/// A session that did not run to its end.
pub fn of_session(error: &session::SessionError) -> PyErr {
    match error {
        session::SessionError::Link(error) => of_link(error),
        other => ConsoleError::new_err(harmless(&other.to_string())),
    }
}

/// A scene that asks for no session.
pub fn of_plan(error: &session::PlanError) -> PyErr {
    match error {
        session::PlanError::Device(error) => of_scene(error),
        session::PlanError::NoHand { .. } => Error::new_err(said(error)),
    }
}

/// What is wrong, and what to do about it, in a line.
pub fn said(error: &dyn Diagnostic) -> String {
    harmless(&match error.help() {
        Some(help) => format!("{error}: {help}"),
        None => error.to_string(),
    })
}

/// What Python wants to do about Ctrl-C.
pub fn interrupted() -> PyResult<()> {
    Python::attach(|py| py.check_signals())
}

/// Between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// Stack of a thread that works \[bytes\]: as the system gives a program's first.
pub const STACK: usize = 8 << 20;

/// Works on a thread of its own, without Python's lock, while this one looks for Ctrl-C. After that nobody waits for the work, which
/// ends at its next [stage](sutura_host::work::stop_with).
///
/// # Errors
/// Runs until Ctrl-C without a thread.
pub fn apart<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let stops = stop.clone();
    // Disconnected once the work is done.
    let (working, done) = channel::<()>();
    let worker = Builder::new().stack_size(STACK).spawn(move || {
        let _working = working;
        sutura_host::work::stop_with(Some(stops));
        work()
    });
    let worker = worker.map_err(|error| Error::new_err(format!("no thread: {error}")))?;
    py.detach(move || {
        while let Err(RecvTimeoutError::Timeout) = done.recv_timeout(LOOK) {
            if let Err(raised) = interrupted() {
                stop.store(true, Ordering::Relaxed);
                return Err(raised);
            }
        }
        let done = worker.join();
        Ok(done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Looks for Ctrl-C for work that asks whether to go on.
#[derive(Default)]
pub struct Watch(Option<PyErr>);

impl Watch {
    /// Whether to go on.
    pub fn then(&mut self) -> ControlFlow<()> {
        match GIVEN_UP.take().map_or_else(interrupted, Err) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.0 = Some(error);
                ControlFlow::Break(())
            }
        }
    }

    /// # Errors
    /// What has stopped the work.
    pub fn end(self) -> PyResult<()> {
        self.0.map_or(Ok(()), Err)
    }
}
