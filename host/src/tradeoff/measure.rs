//! The table: every model with every setting on every case, its errors and its time.
//!
//! Entry points: [`plan`] for what there is to do, [`measure`]. A load grows over the case's ramp and stays for its
//! rest; the time is the median step of the ramp, so that models that stop when nothing moves gain nothing
//! by it; errors are those at the end.

use super::cases::{self, Case};
use super::front;
use super::lattice::Lattice;
use super::registry::{self, Body, Entry, Setting};
use super::truth::{Answer, Course, displacements, solve, summed};
use serde::Serialize;
use std::time::Instant;
use sutura_models::Outcome;
use sutura_models::hyperelastic::Cells;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// All cases, settings and levels; otherwise some, at level 1.
    pub full: bool,
}

/// Runs of one setting beyond which there are no more.
const REPEATS: usize = 5;
/// A run that takes longer than this \[s\] is not repeated.
const LONG_S: f64 = 2.0;

/// One line of the table. Errors of what has failed are not numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the case.
    pub case: &'static str,
    /// Name of the model.
    pub tissue: &'static str,
    /// Its knobs in words.
    pub settings: String,
    /// Multiple of the case's divisions.
    pub level: usize,
    /// Nodes of the mesh.
    pub nodes: usize,
    /// Cells of the mesh.
    pub cells: usize,
    /// Median step of the ramp, median over the runs \[us\].
    pub step_us: f64,
    /// Slowest step of the median run \[us\].
    pub worst_us: f64,
    /// Largest less least median over the runs, % of their median.
    pub spread_pct: f64,
    /// Runs.
    pub runs: usize,
    /// RMS error of all nodes against Newton's balance of the same cells \[%\].
    pub disp_rms_pct: f64,
    /// Largest error of a node, over the largest displacement \[%\].
    pub disp_max_pct: f64,
    /// Largest error on the case's line \[%\].
    pub red_line_pct: f64,
    /// Error of the reaction \[%\].
    pub force_pct: f64,
    /// As above, against quadratic cells.
    pub truth_disp_rms_pct: f64,
    /// See above.
    pub truth_disp_max_pct: f64,
    /// See above.
    pub truth_red_line_pct: f64,
    /// See above.
    pub truth_force_pct: f64,
    /// Nothing on this case is both faster and nearer to the truth (RMS).
    pub pareto: bool,
    /// `converged`, `unfinished`, `failed`, `refused`.
    pub outcome: &'static str,
    /// Why it failed or refused.
    pub note: String,
}

/// The answer by quadratic cells, and how sure it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    /// Name of the case.
    pub case: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Level of its mesh.
    pub level: usize,
    /// Nodes of the mesh, those between corners not counted.
    pub nodes: usize,
    /// RMS change from quadratic cells of half the level \[%\]; not a number at level 1.
    pub change_pct: f64,
    /// Change of the reaction \[%\].
    pub force_change_pct: f64,
    /// Mean displacement of the mesh's nodes \[m\].
    pub mean_m: f64,
    /// Reaction of the nodes that move \[N\].
    pub force_n: [f64; 3],
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The lines.
    pub cases: Vec<Row>,
    /// The answers.
    pub truths: Vec<Truth>,
    /// Who is best within a time.
    pub best: Vec<front::Best>,
}

/// What is measured, chosen by names: each of `words` must be a case, a tissue, or part of such a name.
pub fn plan(extent: Extent, words: &[&str]) -> Vec<(Case, Vec<Entry>)> {
    let mut plan = Vec::new();
    let cases = cases::all();
    let named = cases.iter().any(|case| words.contains(&case.name));
    for case in cases {
        let offered = extent.full || case.short || named;
        let mut entries = registry::entries();
        entries.retain(|entry| {
            let wanted = |word: &&str| case.name.contains(*word) || entry.tissue.contains(*word);
            (entry.fits)(&case.substance) && words.iter().all(wanted)
        });
        if offered && !entries.is_empty() {
            plan.push((case, entries));
        }
    }
    plan
}

/// Measures a plan. `told` is called with every line as it is found.
///
/// # Errors
/// A case without an answer, which is a defect.
pub fn measure(
    plan: &[(Case, Vec<Entry>)],
    extent: Extent,
    told: &mut dyn FnMut(&Row),
) -> Result<Report, String> {
    let (mut rows, mut truths) = (Vec::new(), Vec::new());
    for (case, entries) in plan {
        let levels = if extent.full { case.levels } else { &[1] };
        let lattices = levels
            .iter()
            .map(|level| case.lattice(*level))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|error| format!("{}: {error}", case.name))?;
        let Some(finest) = lattices.last() else {
            continue;
        };
        let truth = solve(case, finest, Cells::Quadratic)?;
        truths.push(sureness(case, levels, &lattices, &truth)?);
        for (lattice, level) in lattices.iter().zip(levels) {
            let newton = solve(case, lattice, Cells::Linear)?;
            let truth = truth.on(finest, lattice);
            for entry in entries {
                for setting in &entry.settings {
                    if extent.full || setting.short {
                        let about = About {
                            case,
                            level: *level,
                            lattice,
                            newton: &newton,
                            truth: &truth,
                        };
                        let row = about.run(entry, setting);
                        told(&row);
                        rows.push(row);
                    }
                }
            }
        }
    }
    front::mark(&mut rows);
    Ok(Report {
        best: front::best(&rows),
        cases: rows,
        truths,
    })
}

fn sureness(
    case: &Case,
    levels: &[usize],
    lattices: &[Lattice],
    truth: &Answer,
) -> Result<Truth, String> {
    let (last, level) = (lattices.len() - 1, levels[levels.len() - 1]);
    let finest = &lattices[last];
    let (mut change_pct, mut force_change_pct) = (f64::NAN, f64::NAN);
    if last > 0 {
        let coarse = &lattices[last - 1];
        let other = solve(case, coarse, Cells::Quadratic)?;
        let error = truth.on(finest, coarse).error(&other, case, coarse);
        (change_pct, force_change_pct) = (error.rms_pct, error.force_pct);
    }
    let sum: f64 = truth.u.iter().map(nalgebra::Vector3::norm).sum();
    Ok(Truth {
        case: case.name,
        about: case.about,
        level,
        nodes: finest.unit.len(),
        change_pct,
        force_change_pct,
        mean_m: sum / truth.u.len() as f64,
        force_n: truth.force_n.into(),
    })
}

/// What all settings of a case and level share.
struct About<'a> {
    case: &'a Case,
    level: usize,
    lattice: &'a Lattice,
    newton: &'a Answer,
    truth: &'a Answer,
}

/// One run.
struct Run {
    median_us: f64,
    worst_us: f64,
    seconds: f64,
    answer: Answer,
    outcome: Outcome,
}

impl About<'_> {
    fn run(&self, entry: &Entry, setting: &Setting) -> Row {
        let mut row = Row {
            case: self.case.name,
            tissue: entry.tissue,
            settings: setting.name.clone(),
            level: self.level,
            nodes: self.lattice.unit.len(),
            cells: self.lattice.mesh.cells().len(),
            step_us: f64::NAN,
            worst_us: f64::NAN,
            spread_pct: f64::NAN,
            runs: 0,
            disp_rms_pct: f64::NAN,
            disp_max_pct: f64::NAN,
            red_line_pct: f64::NAN,
            force_pct: f64::NAN,
            truth_disp_rms_pct: f64::NAN,
            truth_disp_max_pct: f64::NAN,
            truth_red_line_pct: f64::NAN,
            truth_force_pct: f64::NAN,
            pareto: false,
            outcome: "refused",
            note: String::new(),
        };
        let mut runs: Vec<Run> = Vec::new();
        while runs.len() < REPEATS && runs.last().is_none_or(|run| run.seconds < LONG_S) {
            match self.once(setting) {
                Ok(run) => runs.push(run),
                Err(refused) => {
                    row.note = refused;
                    return row;
                }
            }
            if matches!(runs.last(), Some(run) if matches!(run.outcome, Outcome::Failed(_))) {
                break;
            }
        }
        row.runs = runs.len();
        runs.sort_by(|a, b| a.median_us.total_cmp(&b.median_us));
        let (Some(first), Some(last)) = (runs.first(), runs.last()) else {
            return row;
        };
        let middle = &runs[runs.len() / 2];
        row.step_us = middle.median_us;
        row.worst_us = middle.worst_us;
        row.spread_pct = 100.0 * (last.median_us - first.median_us) / middle.median_us;
        row.outcome = match middle.outcome {
            Outcome::Converged => "converged",
            Outcome::Unfinished => "unfinished",
            Outcome::Failed(why) => {
                row.note = why.to_owned();
                row.outcome = "failed";
                return row;
            }
        };
        let model = self.newton.error(&middle.answer, self.case, self.lattice);
        let total = self.truth.error(&middle.answer, self.case, self.lattice);
        row.disp_rms_pct = model.rms_pct;
        row.disp_max_pct = model.max_pct;
        row.red_line_pct = model.line_pct;
        row.force_pct = model.force_pct;
        row.truth_disp_rms_pct = total.rms_pct;
        row.truth_disp_max_pct = total.max_pct;
        row.truth_red_line_pct = total.line_pct;
        row.truth_force_pct = total.force_pct;
        if !entry.has_forces {
            (row.force_pct, row.truth_force_pct) = (f64::NAN, f64::NAN);
        }
        row
    }

    fn once(&self, setting: &Setting) -> Result<Run, String> {
        let case = self.case;
        let mut tissue = (setting.build)(&Body::of(case.substance), &self.lattice.mesh)?;
        let mut course = Course::new(case, self.lattice);
        let begin = Instant::now();
        let mut times_us = Vec::with_capacity(case.ramp);
        let mut outcome = Outcome::Unfinished;
        for step in 1..=case.ramp + case.rest {
            let share = (step as f64 / case.ramp as f64).min(1.0);
            let drive = course.at(share);
            let start = Instant::now();
            let done = tissue.step(&drive, case.step_s);
            if step <= case.ramp {
                times_us.push(1e6 * start.elapsed().as_secs_f64());
            }
            outcome = done.outcome;
            if matches!(outcome, Outcome::Failed(_)) {
                break;
            }
        }
        times_us.sort_by(f64::total_cmp);
        let answer = Answer {
            u: displacements(&*tissue, self.lattice),
            force_n: summed(&*tissue, &course.moved),
        };
        Ok(Run {
            median_us: times_us[times_us.len() / 2],
            worst_us: times_us[times_us.len() - 1],
            seconds: begin.elapsed().as_secs_f64(),
            answer,
            outcome,
        })
    }
}
