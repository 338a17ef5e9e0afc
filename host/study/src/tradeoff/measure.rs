//! The table: every model with every setting on every case, its errors and its time.
//!
//! Entry points: [`plan`] for what there is to do, [`measure`]. A load grows over the case's ramp and stays for its
//! rest, at least twenty seconds for models that need time; the time is the median step of the ramp, so that models that
//! stop when nothing moves gain nothing by it; errors are those at the end, and on arrival.

use super::cases::{self, Case};
use super::front;
use super::lattice::Lattice;
use super::truth::{Answer, Course, displacements, solve, summed};
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;
use sutura_host::registry::{self, Body, Entry, Setting};
use sutura_models::hyperelastic::Cells;
use sutura_models::{Outcome, Tissue};

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// All cases, settings and levels; otherwise some, at level 1.
    pub full: bool,
    /// Whether steps are timed. Else each setting is run once and none is stopped for being slow, so that errors depend
    /// on nothing but the program and the instructions of the machine; times are not numbers, and there is no front.
    pub timed: bool,
}

/// Runs of one setting beyond which there are no more.
const REPEATS: usize = 5;
/// A run that takes longer than this \[s\] is not repeated.
const LONG_S: f64 = 1.0;
/// Last level on which every setting is measured; the finest has those of the short table.
const EVERY_SETTING: usize = 2;
/// A run whose steps take longer than this \[s\] in the mean is stopped: far beyond what one can feel with.
const SLOW_S: f64 = 1.0;
/// How long models that need time are given to come to rest \[s\].
const SETTLE_S: f64 = 20.0;

/// One line of the table. Errors of what has failed are not numbers, and times that were not taken.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
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
    #[schemars(with = "Option<f64>")]
    pub step_us: f64,
    /// Slowest step of the median run \[us\].
    #[schemars(with = "Option<f64>")]
    pub worst_us: f64,
    /// Largest less least median over the runs, % of their median.
    #[schemars(with = "Option<f64>")]
    pub spread_pct: f64,
    /// Runs that were timed.
    pub runs: usize,
    /// RMS error of all nodes against Newton's balance of the same cells \[%\].
    #[schemars(with = "Option<f64>")]
    pub disp_rms_pct: f64,
    /// Largest error of a node, over the largest displacement \[%\].
    #[schemars(with = "Option<f64>")]
    pub disp_max_pct: f64,
    /// Largest error on the case's line \[%\].
    #[schemars(with = "Option<f64>")]
    pub red_line_pct: f64,
    /// Error of the reaction \[%\].
    #[schemars(with = "Option<f64>")]
    pub force_pct: f64,
    /// As above, against quadratic cells, at the end of the ramp: with what it lags behind.
    #[schemars(with = "Option<f64>")]
    pub arrival_rms_pct: f64,
    /// As above, against quadratic cells, at the end.
    #[schemars(with = "Option<f64>")]
    pub truth_disp_rms_pct: f64,
    /// See above.
    #[schemars(with = "Option<f64>")]
    pub truth_disp_max_pct: f64,
    /// See above.
    #[schemars(with = "Option<f64>")]
    pub truth_red_line_pct: f64,
    /// See above.
    #[schemars(with = "Option<f64>")]
    pub truth_force_pct: f64,
    /// The largest of what matters to a hand, all against quadratic cells: `arrival_rms_pct`,
    /// `truth_disp_rms_pct`, `truth_force_pct` \[%\].
    #[schemars(with = "Option<f64>")]
    pub error_pct: f64,
    /// Nothing on this case is both faster and nearer to the truth by `error_pct`.
    pub pareto: bool,
    /// `converged`, `unfinished`, `failed`, `refused`, `stopped`.
    pub outcome: &'static str,
    /// Why it failed or refused.
    pub note: String,
}

/// The answer by quadratic cells, and how sure it is.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Truth {
    /// Name of the case.
    pub case: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Level of its mesh.
    pub level: usize,
    /// Nodes of the mesh, those between corners not counted.
    pub nodes: usize,
    /// RMS change from quadratic cells one level coarser \[%\].
    pub change_pct: f64,
    /// Change of the reaction \[%\].
    pub force_change_pct: f64,
    /// Mean displacement of the mesh's nodes \[m\].
    pub mean_m: f64,
    /// Reaction of the nodes that move \[N\].
    pub force_n: [f64; 3],
}

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
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

/// Lines that a plan has.
pub fn lines(plan: &[(Case, Vec<Entry>)], extent: Extent) -> usize {
    let of_case = |(case, entries): &(Case, Vec<Entry>)| {
        let finest = case.truth_level(extent.full);
        let levels = case.levels_of(extent.full).iter();
        let settings = |level: &usize| {
            let all = entries.iter().flat_map(|entry| &entry.settings);
            let level = *level;
            all.filter(|setting| is_measured(setting, extent, level, finest))
                .count()
        };
        levels.map(settings).sum::<usize>()
    };
    plan.iter().map(of_case).sum()
}

fn is_measured(setting: &Setting, extent: Extent, level: usize, finest: usize) -> bool {
    let every = extent.full && level <= EVERY_SETTING;
    (every || setting.short) && !(setting.of_truth && level == finest)
}

/// Measures a plan. `told` is called with every line as it is found, and says whether to go on: else the report has what there is by
/// then, and fronts of the cases that are whole.
///
/// # Errors
/// A case without an answer, which is a defect.
pub fn measure(
    plan: &[(Case, Vec<Entry>)],
    extent: Extent,
    told: &mut dyn FnMut(&Row) -> ControlFlow<()>,
) -> Result<Report, String> {
    let (mut rows, mut truths) = (Vec::new(), Vec::new());
    // Lines of cases that have all of theirs.
    let mut whole = 0;
    'cases: for (case, entries) in plan {
        let levels = case.levels_of(extent.full);
        let finest = case.truth_level(extent.full);
        let lattice = |level: usize| {
            case.lattice(level)
                .map_err(|error| format!("{}: {error}", case.name))
        };
        let fine = lattice(finest)?;
        let lattices: Vec<_> = levels
            .iter()
            .map(|l| lattice(*l))
            .collect::<Result<_, _>>()?;
        let on: Vec<_> = lattices.iter().chain([&fine]).collect();
        let answers = solve(case, &fine, Cells::Quadratic, &on)?;
        let coarser = solve(case, &lattice(finest - 1)?, Cells::Quadratic, &[&fine])?;
        truths.push(sureness(
            case,
            finest,
            &fine,
            &answers[levels.len()],
            &coarser[0],
        ));
        for ((lattice, level), truth) in lattices.iter().zip(levels).zip(&answers) {
            let newton = solve(case, lattice, Cells::Linear, &[lattice])?;
            let about = About {
                case,
                level: *level,
                lattice,
                newton: &newton[0],
                truth,
                timed: extent.timed,
            };
            for entry in entries {
                let settings = entry.settings.iter();
                for setting in settings.filter(|own| is_measured(own, extent, *level, finest)) {
                    let row = about.run(entry, setting);
                    let then = told(&row);
                    rows.push(row);
                    if then.is_break() {
                        break 'cases;
                    }
                }
            }
        }
        whole = rows.len();
    }
    let mut best = Vec::new();
    if extent.timed {
        front::mark(&mut rows[..whole]);
        best = front::best(&rows[..whole]);
    }
    Ok(Report {
        best,
        cases: rows,
        truths,
    })
}

fn sureness(case: &Case, level: usize, fine: &Lattice, truth: &Answer, coarser: &Answer) -> Truth {
    let change = truth.error(coarser, case, fine);
    let sum: f64 = truth.u.iter().map(nalgebra::Vector3::norm).sum();
    Truth {
        case: case.name,
        about: case.about,
        level,
        nodes: fine.unit.len(),
        change_pct: change.rms_pct,
        force_change_pct: change.force_pct,
        mean_m: sum / truth.u.len() as f64,
        force_n: truth.force_n.into(),
    }
}

/// What all settings of a case and level share.
struct About<'a> {
    case: &'a Case,
    level: usize,
    lattice: &'a Lattice,
    newton: &'a Answer,
    truth: &'a Answer,
    timed: bool,
}

/// One run.
struct Run {
    median_us: f64,
    worst_us: f64,
    seconds: f64,
    arrival: Answer,
    answer: Answer,
    /// `None`: stopped for being slow.
    outcome: Option<Outcome>,
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
            arrival_rms_pct: f64::NAN,
            truth_disp_rms_pct: f64::NAN,
            truth_disp_max_pct: f64::NAN,
            truth_red_line_pct: f64::NAN,
            truth_force_pct: f64::NAN,
            error_pct: f64::NAN,
            pareto: false,
            outcome: "refused",
            note: String::new(),
        };
        let mut runs: Vec<Run> = Vec::new();
        let repeats = if self.timed { REPEATS } else { 1 };
        while runs.len() < repeats && runs.last().is_none_or(|run| run.seconds < LONG_S) {
            match self.once(entry, setting) {
                Ok(run) => runs.push(run),
                Err(refused) => {
                    row.note = refused;
                    return row;
                }
            }
            if matches!(runs.last(), Some(run) if matches!(run.outcome, Some(Outcome::Failed(_)) | None))
            {
                break;
            }
        }
        runs.sort_by(|a, b| a.median_us.total_cmp(&b.median_us));
        let (Some(first), Some(last)) = (runs.first(), runs.last()) else {
            return row;
        };
        let middle = &runs[runs.len() / 2];
        if self.timed {
            row.runs = runs.len();
            row.step_us = middle.median_us;
            row.worst_us = middle.worst_us;
            row.spread_pct = 100.0 * (last.median_us - first.median_us) / middle.median_us;
        }
        row.outcome = match middle.outcome {
            Some(Outcome::Converged) => "converged",
            Some(Outcome::Unfinished) => "unfinished",
            None => {
                row.note = format!("more than {SLOW_S} s a step");
                row.outcome = "stopped";
                return row;
            }
            Some(Outcome::Failed(why)) => {
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
        row.arrival_rms_pct = self
            .truth
            .error(&middle.arrival, self.case, self.lattice)
            .rms_pct;
        row.truth_disp_rms_pct = total.rms_pct;
        row.truth_disp_max_pct = total.max_pct;
        row.truth_red_line_pct = total.line_pct;
        row.truth_force_pct = total.force_pct;
        if !entry.has_forces {
            (row.force_pct, row.truth_force_pct) = (f64::NAN, f64::NAN);
        }
        let places = row.arrival_rms_pct.max(row.truth_disp_rms_pct);
        let known = !row.arrival_rms_pct.is_nan() && !row.truth_disp_rms_pct.is_nan();
        if known {
            // Without a force the places decide.
            row.error_pct = places.max(row.truth_force_pct);
        }
        row
    }

    fn once(&self, entry: &Entry, setting: &Setting) -> Result<Run, String> {
        let case = self.case;
        let mut tissue = (setting.build)(&Body::of(case.substance), &self.lattice.mesh)?;
        let mut course = Course::new(case, self.lattice);
        let rest = if entry.has_step && case.substance.relaxation.is_none() {
            case.rest.max((SETTLE_S / case.step_s) as usize)
        } else {
            case.rest
        };
        let begin = Instant::now();
        let mut times_us = Vec::with_capacity(case.ramp);
        let mut outcome = Some(Outcome::Unfinished);
        let now = |tissue: &dyn Tissue, moved: &[usize]| Answer {
            u: displacements(tissue, self.lattice),
            force_n: summed(tissue, moved),
        };
        let mut arrival = None;
        for step in 1..=case.ramp + rest {
            let share = (step as f64 / case.ramp as f64).min(1.0);
            let drive = course.at(share);
            let start = Instant::now();
            let done = tissue.step(&drive, case.step_s);
            if step <= case.ramp {
                times_us.push(1e6 * start.elapsed().as_secs_f64());
            }
            outcome = Some(done.outcome);
            if step == case.ramp {
                arrival = Some(now(&*tissue, &course.moved));
            }
            if matches!(done.outcome, Outcome::Failed(_)) {
                break;
            }
            if self.timed
                && step <= case.ramp
                && begin.elapsed().as_secs_f64() > SLOW_S * (step + 1) as f64
            {
                outcome = None;
                break;
            }
        }
        times_us.sort_by(f64::total_cmp);
        let answer = now(&*tissue, &course.moved);
        Ok(Run {
            median_us: times_us[times_us.len() / 2],
            worst_us: times_us[times_us.len() - 1],
            seconds: begin.elapsed().as_secs_f64(),
            arrival: arrival.unwrap_or_else(|| answer.clone()),
            answer,
            outcome,
        })
    }
}
