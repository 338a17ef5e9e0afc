//! The studies' tables. Entry points from Python: `sutura.tradeoff`, `sutura.merge`, `sutura.stability`, `sutura.fidelity`. All return
//! JSON with the keys of the command's.

use crate::error::{self, Error, interrupted};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use std::ops::ControlFlow;
use sutura_study::fidelity::case::Scenes;
use sutura_study::fidelity::report::{Report, chosen};
use sutura_study::fidelity::{mutants, oracles, suite};
use sutura_study::stability::suite as extremes;
use sutura_study::tradeoff::measure::Extent;
use sutura_study::tradeoff::table::{Plan, Share, merge};

/// What a package of this release calls its program.
const PROGRAM: &str = concat!(env!("CARGO_PKG_VERSION"), " (python)");
/// Cases between two looks for Ctrl-C, for every thread.
const AT_ONCE: usize = 8;

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
) -> PyResult<String> {
    let share = cases.map_or(Ok(Share::ALL), str::parse);
    let share: Share = share.map_err(|error| PyValueError::new_err(format!("cases: {error}")))?;
    let extent = Extent { full, timed };
    let plan = Plan::new(extent, only, share);
    let plan = plan.map_err(|error| PyValueError::new_err(error::said(&error)))?;
    py.detach(|| {
        let mut stopped = None;
        let table = plan.measure(PROGRAM, &mut |_| match interrupted() {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                stopped = Some(error);
                ControlFlow::Break(())
            }
        });
        match stopped {
            Some(error) => Err(error),
            None => json(&table.map_err(Error::new_err)?),
        }
    })
}

/// One table of shares, each with its name: see `sutura.merge`.
#[pyfunction]
pub fn merge_tradeoff(shares: Vec<(String, String)>) -> PyResult<String> {
    let table = merge(&shares).map_err(|error| PyValueError::new_err(error::said(&error)))?;
    Ok(table.to_string())
}

/// What models, rows and console do at the extremes: see `sutura.stability`.
#[pyfunction]
pub fn stability(py: Python<'_>, only: &str, full: bool) -> PyResult<String> {
    let words: Vec<_> = only.split_whitespace().collect();
    py.detach(|| {
        let mut stopped = None;
        let cases = extremes::measure(full, &words, &mut |_| match interrupted() {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                stopped = Some(error);
                ControlFlow::Break(())
            }
        });
        if let Some(error) = stopped {
            return Err(error);
        }
        let cases = cases.map_err(|error| error::of_scene(&error))?;
        if cases.is_empty() {
            return Err(PyValueError::new_err(format!(
                "no case has all the words `{}`: words are parts of a tissue or of what is extreme, as `corotational`, `turn`, `rows`, \
                 `console`",
                words.join(" ")
            )));
        }
        json(&extremes::Table::of(full, cases))
    })
}

/// How true and how stable the console's force is: see `sutura.fidelity`.
#[pyfunction]
pub fn fidelity(
    py: Python<'_>,
    only: &str,
    full: bool,
    threads: Option<usize>,
) -> PyResult<String> {
    let extent = if full {
        suite::Extent::Full
    } else {
        suite::Extent::Short
    };
    let whole = only.split_whitespace().next().is_none();
    let specs = chosen(suite::specs(extent), only);
    if specs.is_empty() {
        return Err(PyValueError::new_err(format!(
            "no case has all the words `{only}`: words are whole, as `palpation`, `taps`, `rows`, `60-hz`, `x0.5`; full has more cases"
        )));
    }
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.unwrap_or_else(all);
    if threads == 0 {
        return Err(PyValueError::new_err("threads is 0: give 1 or more"));
    }
    py.detach(|| {
        let scenes = Scenes::load().map_err(|error| error::of_scene(&error))?;
        let unsound =
            |error| Error::new_err(format!("the simulated console is no valid device: {error}"));
        let mut cases = Vec::with_capacity(specs.len());
        for some in specs.chunks(AT_ONCE * threads) {
            cases.extend(suite::measure(some, &scenes, threads, &|_, _| {}).map_err(unsound)?);
            interrupted()?;
        }
        let oracles = match whole {
            true => oracles::oracles().map_err(unsound)?,
            false => Vec::new(),
        };
        let guards = match whole && full {
            true => mutants::mutants(&scenes, threads, &|_, _| {}).map_err(unsound)?,
            false => Vec::new(),
        };
        json(&Report::of(extent, cases, oracles, guards, Vec::new()))
    })
}

fn json(result: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(result).map_err(|error| Error::new_err(error.to_string()))
}
