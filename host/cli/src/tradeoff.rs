//! `sutura tradeoff`: error against time of every tissue model.
//!
//! Entry point: [`run`]. Cases, models and errors are the library's; here they are chosen, printed and plotted.

use crate::display::{self, progress};
use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use crate::signals::{interrupted, stop_after_a_line, then};
use crate::tables::{Kept, csv, write_pictures};
use crate::{Format, Global};
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use sutura_files::{MOST_TEXT, read_plain, write_whole};
use sutura_host::text::utf8;
use sutura_study::INTERRUPTED;
use sutura_study::idle::{IDLE, load};
use sutura_study::tradeoff::literature::FIGURES;
use sutura_study::tradeoff::measure::{self, Extent};
use sutura_study::tradeoff::suture;
use sutura_study::tradeoff::table::{Line, NoMerge, NoPlan, Plan, Share, merge, words};

/// Measures error against time of every tissue model, over its settings and meshes.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
pub struct TradeoffArgs {
    #[command(subcommand)]
    pub then: Option<TradeoffCommand>,
    /// All cases, settings and meshes; without it a few on coarse meshes, in seconds.
    #[arg(long)]
    pub full: bool,
    /// Writes tables (CSV, JSON) and plots (SVG) into this directory.
    #[arg(long, value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Runs only what has all these words in the name of its case or its tissue: `beam corotational`.
    #[arg(long, value_name = "WORDS")]
    pub only: Option<String>,
    /// Only the Ith of N shares of the cases, as `2/4`: for batch schedulers. `sutura tradeoff merge` makes one table of them.
    #[arg(long, value_name = "I/N")]
    pub cases: Option<Share>,
    /// Errors alone: no times and no front, but the same to the bit on every machine of the same instructions, however busy.
    #[arg(long)]
    pub errors: bool,
    /// One JSON object per line on stdout for every line of the table as it is measured.
    #[arg(long)]
    pub stream: bool,
}

/// What is done with shares.
#[derive(Subcommand, Debug)]
pub enum TradeoffCommand {
    /// One table from the files of all shares; times of two machines, or two programs, are refused.
    Merge(MergeArgs),
}

/// Puts shares together.
#[derive(Args, Debug)]
pub struct MergeArgs {
    /// What `sutura tradeoff --cases I/N --format json` printed, or the tradeoff.json of its `--plot DIR`: one for each share.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Writes tables (CSV, JSON) and plots (SVG) into this directory.
    #[arg(long, value_name = "DIR")]
    pub plot: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  sutura tradeoff                              a few cases on coarse meshes
  sutura tradeoff --full --plot figures        all of them; CSV, JSON, and error against time as SVG
  sutura tradeoff --full --only beam-bending   one case
  sutura tradeoff --only \"cube linear\" --format json
  sutura tradeoff --only beam --errors         errors without times, on a machine that is busy
  sutura tradeoff --only \"beam linear\" --cases 1/2 --plot share-1
  sutura tradeoff --only \"beam linear\" --cases 2/2 --plot share-2
  sutura tradeoff merge share-1/tradeoff.json share-2/tradeoff.json --plot both

Errors are against solutions that the command computes itself: Newton's balance of the same cells and law
(disp_*, force_pct), and quadratic cells on the finest mesh (truth_*; arrival_* before tissue has
come to rest). A suture (`suture-closed`) is a table of its own: gap, tension and steps on linear, corotational and
hyperelastic tissue, against the latter on the finest mesh. Times are this machine's: `made[]` names it and what else
ran on it. Build with --release.";

/// Measures and prints the report.
///
/// # Errors
/// Bad input for words that nothing has; failed if a case has no answer.
pub fn run(args: &TradeoffArgs, global: &Global) -> Result<(), Failure> {
    if let Some(TradeoffCommand::Merge(args)) = &args.then {
        return merged(args, global);
    }
    // Before hours of work that could not be kept.
    if let Some(directory) = &args.plot {
        crate::files::folder("--plot", directory, global)?;
    }
    let extent = Extent {
        full: args.full,
        timed: !args.errors,
    };
    let share = args.cases.unwrap_or(Share::ALL);
    let plan = Plan::new(extent, args.only.as_deref().unwrap_or_default(), share)?;
    if cfg!(debug_assertions) && extent.timed {
        tracing::warn!("a debug build: times mean little");
    }
    if let Some(load) = load().filter(|load| extent.timed && *load > IDLE) {
        tracing::info!("the machine is not idle: {load} processes ran in the last minute");
    }
    let kept = Kept::within(args.plot.as_deref())?;
    let stop = stop_after_a_line()?;
    let bar = progress(plan.lines());
    let mut told = |line: Line<'_>| {
        bar.inc(1);
        kept.line(&line);
        let (case, tissue) = match line {
            Line::Case(row) => (row.case, row.tissue),
            Line::Suture(row) => (row.case, row.tissue),
        };
        bar.set_message(format!("{case} {tissue}"));
        match line {
            _ if args.stream => say!("{}", json!(line)),
            Line::Case(row) => tracing::info!(
                "{} {} {}: {:.0} us, {:.2} %",
                row.case,
                row.tissue,
                row.settings,
                row.step_us,
                row.error_pct
            ),
            Line::Suture(_) => {}
        }
        then(&stop)
    };
    let table = plan.measure(env!("SUTURA_VERSION"), &mut told);
    bar.finish_and_clear();
    let mut table = table.map_err(|why| {
        Failure::say(
            Cause::Failed,
            why,
            "the other cases can be run by their names with --only",
        )
    })?;
    if let Some(disturbed) = table.made[0].disturbed() {
        tracing::warn!("{disturbed}");
    }
    let written = match &args.plot {
        Some(directory) => write_files(&json!(table), directory),
        None => Ok(()),
    };
    let is_whole = table.status != INTERRUPTED;
    if let Err(failure) = &written {
        table.status = failure.cause.word();
    }
    match global.format {
        Format::Json => display::object(&table),
        Format::Text => {
            print_text(&table.report, extent.timed);
            print_sutures(&table.sutures);
            print_literature();
        }
    }
    written.map_err(Failure::after_summary)?;
    match is_whole {
        true => Ok(()),
        false => Err(interrupted(table.report.cases.len() + table.sutures.len())),
    }
}

/// Makes one table of shares.
fn merged(args: &MergeArgs, global: &Global) -> Result<(), Failure> {
    let read = |path: &PathBuf| {
        let name = path.display().to_string();
        let bytes = read_plain(path, MOST_TEXT).map_err(|error| error.to_string());
        let text = bytes.and_then(|bytes| utf8(bytes).map_err(|error| error.to_string()));
        match text {
            Ok(text) => Ok((name, text)),
            Err(why) => Err(Failure::say(
                Cause::BadInput,
                format!("cannot read {name}: {why}"),
                "give what `sutura tradeoff --cases I/N --format json` printed, or the tradeoff.json of its --plot DIR",
            )),
        }
    };
    let shares: Vec<_> = args.files.iter().map(read).collect::<Result<_, _>>()?;
    let mut table = merge(&shares)?;
    let written = match &args.plot {
        Some(directory) => {
            crate::files::folder("--plot", directory, global)?;
            // Pictures have names of their own.
            let is_written = |name: &str| {
                let is_table = LISTS.iter().any(|(list, _)| *list == name);
                name == "tradeoff.json" || is_table || name.ends_with(".svg")
            };
            crate::files::never_into(directory, is_written, &args.files)?;
            write_files(&table, directory)
        }
        None => Ok(()),
    };
    if let Err(failure) = &written {
        table["status"] = failure.cause.word().into();
    }
    match global.format {
        Format::Json => display::object(&table),
        Format::Text => display::lines(&words(&table)),
    }
    written.map_err(Failure::after_summary)
}

impl From<NoPlan> for Failure {
    fn from(error: NoPlan) -> Failure {
        Failure::new(Cause::BadInput, error)
    }
}

impl From<NoMerge> for Failure {
    fn from(error: NoMerge) -> Failure {
        Failure::new(Cause::BadInput, error)
    }
}

fn print_text(report: &measure::Report, timed: bool) {
    for truth in &report.truths {
        say!("{}: {}", truth.case, truth.about);
        say!(
            "  answer: quadratic cells on {} nodes, {:.2} % from those of the next coarser mesh (force {:.2} %); {:.3} mm in the mean",
            truth.nodes,
            truth.change_pct,
            truth.force_change_pct,
            1e3 * truth.mean_m
        );
        say!(
            "  {:27} {:32} {:>6} {:>9} {:>6} | {:>7} {:>7} {:>7} | {:>7} {:>7} {:>7} {:>7}",
            "% of the answer's",
            "",
            "cells",
            "us/step",
            "+- %",
            "rms",
            "line",
            "force",
            "moving",
            "truth",
            "line",
            "force"
        );
        for row in report.cases.iter().filter(|row| row.case == truth.case) {
            let mark = if row.pareto { "*" } else { " " };
            say!(
                "{mark} {:27} {:32} {:6} {:9.1} {:6.0} | {:7.2} {:7.2} {:7.2} | {:7.2} {:7.2} {:7.2} {:7.2} {}",
                row.tissue,
                row.settings,
                row.cells,
                row.step_us,
                row.spread_pct,
                row.disp_rms_pct,
                row.red_line_pct,
                row.force_pct,
                row.arrival_rms_pct,
                row.truth_disp_rms_pct,
                row.truth_red_line_pct,
                row.truth_force_pct,
                if row.note.is_empty() {
                    String::new()
                } else {
                    format!("{}: {}", row.outcome, row.note)
                }
            );
        }
    }
    if !timed {
        return;
    }
    say!(
        "* nothing on the case is both faster and nearer to the truth, by the largest of the errors moving, at rest, and of the force"
    );
    say!("Most accurate within a time:");
    for best in &report.best {
        if best.tissue.is_empty() {
            say!("  {:24} {:5} ms: nothing", best.case, best.budget_ms);
            continue;
        }
        say!(
            "  {:24} {:5} ms: {:7.2} % ({:.2} % moving), line {:7.2} %, force {:7.2} %: {}, {}, {} cells",
            best.case,
            best.budget_ms,
            best.truth_disp_rms_pct,
            best.arrival_rms_pct,
            best.truth_red_line_pct,
            best.truth_force_pct,
            best.tissue,
            best.settings,
            best.cells
        );
    }
}

fn print_sutures(rows: &[suture::Row]) {
    if rows.is_empty() {
        return;
    }
    say!("{}: {}", suture::CASE, suture::ABOUT);
    say!(
        "  {:27} {:>6} {:>9} {:>9} | {:>7} {:>7} {:>8} | {:>7} {:>9}",
        "",
        "cells",
        "p50 us",
        "p99 us",
        "gap",
        "N",
        "mm drawn",
        "gap %",
        "tension %"
    );
    for row in rows {
        say!(
            "  {:27} {:6} {:9.1} {:9.1} | {:7.3} {:7.3} {:8.2} | {:7.2} {:9.2} {}",
            row.tissue,
            row.cells,
            row.step_us,
            row.p99_us,
            row.gap_ratio,
            row.tension_n,
            1e3 * row.pulled_m,
            row.gap_off_pct,
            row.tension_off_pct,
            row.note
        );
    }
}

fn print_literature() {
    say!("Printed by others, on their machines:");
    for figure in FIGURES {
        say!(
            "  {:8} {:8} {} ({}) {}",
            figure.value,
            figure.unit,
            figure.what,
            figure.source,
            figure.case
        );
    }
}

/// Tables, and the lists of a report that are in them.
const LISTS: [(&str, &str); 4] = [
    ("tradeoff.csv", "cases"),
    ("tradeoff-best.csv", "best"),
    ("tradeoff-truths.csv", "truths"),
    ("tradeoff-sutures.csv", "sutures"),
];

fn write_files(report: &Value, directory: &Path) -> Result<(), Failure> {
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        write_whole(&path, text.as_bytes()).map_err(|error| unwritable(&path, &error))
    };
    write("tradeoff.json", report.to_string())?;
    for (name, list) in LISTS {
        let lines = report[list].as_array().map_or(&[][..], Vec::as_slice);
        write(name, csv(lines))?;
    }
    write_pictures(report, directory)
}
