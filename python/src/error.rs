//! The package's exceptions. Texts about a scene are those of the command `sutura`, with its lines and its help.

use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use std::ops::ControlFlow;
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

/// A link that is not there, or broke.
pub fn of_link(error: &LinkError) -> PyErr {
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

/// Looks for Ctrl-C for work that asks whether to go on.
#[derive(Default)]
pub struct Watch(Option<PyErr>);

impl Watch {
    /// Whether to go on.
    pub fn then(&mut self) -> ControlFlow<()> {
        match interrupted() {
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
