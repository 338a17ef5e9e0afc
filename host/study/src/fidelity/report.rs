//! All that the cases say, in one.
//!
//! Entry points: [`chosen`] for the cases, [`Report::of`] for what came of them.

use super::bars::{Bar, bars};
use super::case::{Case, Spec};
use super::mutants::Mutant;
use super::oracles::Oracle;
use super::suite::Extent;
use super::targets::{self, BadLinks, Tighten};
use super::traces::Trace;
use super::trials::{Spread, spreads};
use schemars::JsonSchema;
use serde::Serialize;

/// The report.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Report {
    /// `ok`, `bars-missed`, or `interrupted`.
    pub status: &'static str,
    extent: &'static str,
    /// Every case.
    pub cases: Vec<Case>,
    /// Groups of trials.
    pub spreads: Vec<Spread>,
    /// What must be met.
    pub bars: Vec<Bar>,
    /// Bad links, with and without guards.
    pub bad_links: Vec<BadLinks>,
    /// Known answers.
    pub oracles: Vec<Oracle>,
    /// Guards that were switched off in turn.
    pub guards: Vec<Mutant>,
    /// What the pictures need beside the cases, with `--plot`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub traces: Vec<Trace>,
    /// Open bars that are better in this run than they are listed.
    pub tighten: Vec<Tighten>,
}

/// The cases of which the name has all these words, each whole.
pub fn chosen(mut specs: Vec<Spec>, words: &str) -> Vec<Spec> {
    specs.retain(|spec| {
        let name = spec.case().case;
        let own: Vec<_> = name.split(' ').collect();
        words.split_whitespace().all(|word| own.contains(&word))
    });
    specs
}

impl Report {
    /// Of cases, and of what was measured besides.
    pub fn of(
        extent: Extent,
        cases: Vec<Case>,
        oracles: Vec<Oracle>,
        guards: Vec<Mutant>,
        traces: Vec<Trace>,
    ) -> Report {
        let bars = bars(&cases);
        let mut report = Report {
            status: "ok",
            extent: match extent {
                Extent::Full => "full",
                Extent::Short => "short",
            },
            spreads: spreads(&cases),
            bad_links: targets::bad_links(&cases),
            cases,
            tighten: targets::tighten(&bars),
            bars,
            oracles,
            guards,
            traces,
        };
        if report.misses() {
            report.status = "bars-missed";
        }
        report
    }

    /// Whether a bar is missed that is not open, or an answer, or a guard is not seen to be of use: a bar is missing then.
    pub fn misses(&self) -> bool {
        self.bars.iter().any(|bar| !bar.ok && !bar.open)
            || self.oracles.iter().any(|oracle| !oracle.ok)
            || self.guards.iter().any(|guard| guard.fails.is_empty())
    }
}
