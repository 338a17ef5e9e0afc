//! The studies' tables. Entry points from Python: `sutura.tradeoff`, `sutura.merge`, `sutura.stability`, `sutura.fidelity`. All return
//! JSON with the keys of the command's, and hand on each line as it is found.

use crate::error::{self, Error, STACK, harmless, interrupted};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::Builder;
use std::time::Duration;
use sutura_host::text::utf8;
use sutura_study::fidelity::case::{Case, Scenes};
use sutura_study::fidelity::report::{Report, chosen};
use sutura_study::fidelity::{mutants, oracles, suite};
use sutura_study::stability::suite as extremes;
use sutura_study::tradeoff::measure::Extent;
use sutura_study::tradeoff::table::{Plan, Share, merge};

/// What a package of this release calls its program.
const PROGRAM: &str = concat!(env!("CARGO_PKG_VERSION"), " (python)");
/// Between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Names of the trade-off's cases: see `sutura.tradeoff_cases`.
#[pyfunction]
pub fn tradeoff_cases(only: &str, full: bool) -> PyResult<Vec<&'static str>> {
    let extent = Extent { full, timed: false };
    let plan = Plan::new(extent, only, Share::ALL);
    let plan = plan.map_err(|error| PyValueError::new_err(error::said(&error)))?;
    Ok(plan.names())
}

/// Error against time: see `sutura.tradeoff`.
#[pyfunction]
pub fn tradeoff(
    py: Python<'_>,
    only: &str,
    full: bool,
    timed: bool,
    cases: Option<&str>,
    each: Option<Py<PyAny>>,
) -> PyResult<String> {
    let share = cases.map_or(Ok(Share::ALL), str::parse);
    let share: Share =
        share.map_err(|error| PyValueError::new_err(harmless(&format!("cases: {error}"))))?;
    let extent = Extent { full, timed };
    let plan = Plan::new(extent, only, share);
    let plan = plan.map_err(|error| PyValueError::new_err(error::said(&error)))?;
    let table = watched(py, each, |lines| {
        plan.measure(PROGRAM, &mut |line| lines.then(&line))
    })?;
    json(&table.map_err(Error::new_err)?)
}

/// One table of shares, each with its name and the bytes of its file: see `sutura.merge`.
#[pyfunction]
pub fn merge_tradeoff(shares: Vec<(String, Vec<u8>)>) -> PyResult<String> {
    let read = |(name, bytes): (String, Vec<u8>)| match utf8(bytes) {
        Ok(text) => Ok((name, text)),
        Err(error) => {
            let message = harmless(&format!("cannot read {name}: {error}"));
            Err(PyValueError::new_err(message))
        }
    };
    let shares: Vec<_> = shares.into_iter().map(read).collect::<PyResult<_>>()?;
    let table = merge(&shares).map_err(|error| PyValueError::new_err(error::said(&error)))?;
    Ok(table.to_string())
}

/// What models, rows and console do at the extremes: see `sutura.stability`.
#[pyfunction]
pub fn stability(
    py: Python<'_>,
    only: &str,
    full: bool,
    each: Option<Py<PyAny>>,
) -> PyResult<String> {
    let words: Vec<_> = only.split_whitespace().collect();
    let cases = watched(py, each, |lines| {
        extremes::measure(full, &words, &mut |line| lines.then(line))
    })?;
    let cases = cases.map_err(|error| error::of_scene(&error))?;
    if cases.is_empty() {
        return Err(PyValueError::new_err(harmless(&format!(
            "no case has all the words `{}`: words are parts of a tissue or of what is extreme, as `corotational`, `turn`, `rows`, \
             `console`",
            words.join(" ")
        ))));
    }
    json(&extremes::Table::of(full, cases))
}

/// How true and how stable the console's force is: see `sutura.fidelity`.
#[pyfunction]
pub fn fidelity(
    py: Python<'_>,
    only: &str,
    full: bool,
    threads: Option<usize>,
    each: Option<Py<PyAny>>,
) -> PyResult<String> {
    let extent = if full {
        suite::Extent::Full
    } else {
        suite::Extent::Short
    };
    let whole = only.split_whitespace().next().is_none();
    let specs = chosen(suite::specs(extent), only);
    if specs.is_empty() {
        return Err(PyValueError::new_err(harmless(&format!(
            "no case has all the words `{only}`: words are whole, as `palpation`, `taps`, `rows`, `60-hz`, `x0.5`; full has more cases"
        ))));
    }
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.unwrap_or_else(all);
    if threads == 0 {
        return Err(PyValueError::new_err("threads is 0: give 1 or more"));
    }
    let scenes = Scenes::load().map_err(|error| error::of_scene(&error))?;
    let measured = watched(py, each, |lines| {
        let cases = suite::measure(&specs, &scenes, threads, &|_, case| lines.then(case))?;
        let oracles = match whole && lines.go_on().is_continue() {
            true => oracles::oracles()?,
            false => Vec::new(),
        };
        let told = |_: usize, _: &Case| lines.go_on();
        let guards = match whole && full && lines.go_on().is_continue() {
            true => mutants::mutants(&scenes, threads, &told)?,
            false => Vec::new(),
        };
        Ok(Report::of(extent, cases, oracles, guards, Vec::new()))
    })?;
    let unsound = |error: sutura_shared::device::DeviceError| {
        Error::new_err(format!("the simulated console is no valid device: {error}"))
    };
    json(&measured.map_err(unsound)?)
}

fn json(result: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(result).map_err(|error| Error::new_err(error.to_string()))
}

/// Where work tells of its lines, and hears whether to go on.
struct Lines<'a> {
    found: Sender<String>,
    stop: &'a AtomicBool,
}

impl Lines<'_> {
    /// Tells of a line.
    fn then(&self, line: &impl Serialize) -> ControlFlow<()> {
        // Nobody to hear it is told by `stop`.
        let _ = serde_json::to_string(line).map(|line| self.found.send(line));
        self.go_on()
    }

    fn go_on(&self) -> ControlFlow<()> {
        match self.stop.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// Works on a thread of its own, while this one looks for Ctrl-C and calls `each` with every line, as JSON. What either raises stops
/// the work after the line at hand.
///
/// # Errors
/// What was raised.
fn watched<T: Send>(
    py: Python<'_>,
    each: Option<Py<PyAny>>,
    work: impl FnOnce(&Lines<'_>) -> T + Send,
) -> PyResult<T> {
    let stop = &AtomicBool::new(false);
    let (found, lines) = channel();
    let told = Lines { found, stop };
    let hand_on = move |line: String| {
        let call = |each: &Py<PyAny>| Python::attach(|py| each.call1(py, (line,)).map(drop));
        each.as_ref().map_or(Ok(()), call)
    };
    py.detach(move || {
        std::thread::scope(|scope| {
            // What tells of lines ends with the work.
            let worker = Builder::new().stack_size(STACK);
            let worker = worker.spawn_scoped(scope, move || work(&told));
            let worker = worker.map_err(|error| Error::new_err(format!("no thread: {error}")))?;
            let (mut raised, mut heard) = (Ok(()), Ok(()));
            loop {
                // After Ctrl-C lines are handed on that are found by then.
                match lines.recv_timeout(LOOK) {
                    Ok(line) if heard.is_ok() => heard = hand_on(line),
                    Err(RecvTimeoutError::Disconnected) => break,
                    _ => {}
                }
                if raised.is_ok() {
                    raised = interrupted();
                }
                stop.store(raised.is_err() || heard.is_err(), Ordering::Relaxed);
            }
            let done = worker.join();
            let done = done.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised.and(heard).map(|()| done)
        })
    })
}
