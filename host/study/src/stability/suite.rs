//! All extremes of all models in one table.
//!
//! Entry points: [`measure`], [`Table::of`].

use super::extremes::trials;
use super::judge::{self, Verdict, guarded};
use super::{console, rows};
use crate::fidelity::case::Scenes;
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::ControlFlow;
use sutura_host::registry;
use sutura_host::scene::SceneError;
use sutura_shared::control::Rendering;

/// One line of the table.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Case {
    /// Model, `rows` for the row solver, or `console` and how it renders.
    pub tissue: String,
    /// What is extreme, and its unit.
    pub what: &'static str,
    /// How much.
    pub value: f64,
    /// `stable`, `degraded`, `refused`; `defect` for anything else.
    pub outcome: &'static str,
    /// Largest value that is stable, where it was looked for; not a number if none is.
    pub largest_stable: Option<f64>,
    /// How it is degraded, why it refused, or what the defect is.
    pub note: String,
}

/// What was found, and what `stable` means in it.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Table {
    /// `ok`, `failed` with a defect, or `interrupted`.
    pub status: &'static str,
    extent: &'static str,
    limits: Limits,
    /// The lines.
    pub cases: Vec<Case>,
}

/// What `stable` means.
#[derive(Clone, Debug, Serialize, JsonSchema)]
struct Limits {
    residual: f64,
    difference: f64,
    left_after_release: f64,
    away: f64,
}

impl Table {
    /// Of all lines.
    pub fn of(full: bool, cases: Vec<Case>) -> Table {
        let has_defect = cases.iter().any(|case| case.outcome == "defect");
        Table {
            status: if has_defect { "failed" } else { "ok" },
            extent: if full { "full" } else { "short" },
            limits: Limits {
                residual: judge::MOST_RESIDUAL,
                difference: judge::MOST_DIFFERENCE,
                left_after_release: judge::MOST_LEFT,
                away: judge::MOST_AWAY,
            },
            cases,
        }
    }
}

/// Runs everything whose tissue and extreme have all of `words`. `told` is called with every line as it is found, and says
/// whether to go on: else there are the lines by then.
///
/// # Errors
/// None unless a shipped scene is not sound.
pub fn measure(
    full: bool,
    words: &[&str],
    told: &mut dyn FnMut(&Case) -> ControlFlow<()>,
) -> Result<Vec<Case>, SceneError> {
    let (mut table, mut stopped) = (Vec::new(), false);
    let mut add = |tissue: &str,
                   what: &'static str,
                   value: f64,
                   found: &dyn Fn() -> (Verdict, Option<f64>)| {
        let wanted = |word: &&str| tissue.contains(*word) || what.contains(*word);
        if stopped || !words.iter().all(wanted) {
            return;
        }
        let (verdict, largest_stable) = found();
        let case = Case {
            tissue: tissue.to_owned(),
            what,
            value,
            outcome: verdict.word(),
            largest_stable,
            note: verdict.note().to_owned(),
        };
        stopped = told(&case).is_break();
        table.push(case);
    };
    for entry in registry::entries() {
        for trial in trials(&entry, full) {
            add(entry.tissue, trial.what, trial.value, &|| {
                let largest = trial.largest.as_ref().filter(|_| full);
                (trial.run(), largest.map(|largest| largest()))
            });
        }
    }
    let scales: &[f64] = if full {
        &[1e-12, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9, 1e12]
    } else {
        &[1e12]
    };
    for &scale in scales {
        add("rows", "unit of every other row", scale, &|| {
            (guarded(|| rows::scaled(scale)), None)
        });
    }
    let periods: &[f64] = if full {
        &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
    } else {
        &[1000.0]
    };
    let wanted = words
        .iter()
        .all(|word| "console-tangent console-rows console-hold host period [ms]".contains(*word));
    if wanted {
        let scenes = Scenes::load()?;
        for (name, rendering) in [
            ("console-rows", Rendering::Rows),
            ("console-tangent", Rendering::Tangent),
            ("console-hold", Rendering::Hold),
        ] {
            for &period in periods {
                add(name, "host period [ms]", period, &|| {
                    (
                        guarded(|| console::slow_host(&scenes, rendering, period)),
                        None,
                    )
                });
            }
        }
    }
    Ok(table)
}
