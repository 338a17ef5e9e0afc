//! `sutura tradeoff`: error against time of every tissue model.
//!
//! Entry point: [`run`]. Cases, models and errors are the library's; here they are chosen, printed and plotted.

use crate::display::progress;
use crate::failure::{Cause, Failure};
use crate::tables::{Kept, csv, unwritable, write_pictures};
use crate::{Format, Global};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use sutura_study::tradeoff::literature::{FIGURES, Figure};
use sutura_study::tradeoff::measure::{self, Extent, Row};
use sutura_study::tradeoff::suture;

/// Measures error against time of every tissue model, over its settings and meshes.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct TradeoffArgs {
    /// All cases, settings and meshes; without it a few on coarse meshes, in seconds.
    #[arg(long)]
    pub full: bool,
    /// Writes tables (CSV, JSON) and plots (SVG) into this directory.
    #[arg(long, value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Runs only what has all these words in the name of its case or its tissue: `beam corotational`.
    #[arg(long, value_name = "WORDS")]
    pub only: Option<String>,
    /// One JSON object per line on stdout for every line of the table as it is measured.
    #[arg(long)]
    pub stream: bool,
}

const EXAMPLES: &str = "\
Examples:
  sutura tradeoff                              a few cases on coarse meshes
  sutura tradeoff --full --plot figures        all of them; CSV, JSON, and error against time as SVG
  sutura tradeoff --full --only beam-bending   one case
  sutura tradeoff --only \"cube linear\" --format json

Errors are against solutions that the command computes itself: Newton's balance of the same cells and law
(disp_*, force_pct), and quadratic cells on the finest mesh (truth_*; arrival_* before tissue has
come to rest). A suture (`suture-closed`) is a table of its own: gap, tension and steps on linear, corotational and
hyperelastic tissue, against the latter on the finest mesh. Times are this machine's. Build with --release.";

#[derive(Serialize, JsonSchema)]
pub struct Output<'a> {
    status: &'static str,
    extent: &'static str,
    #[serde(flatten)]
    report: &'a measure::Report,
    sutures: &'a [suture::Row],
    #[schemars(with = "Vec<Figure>")]
    literature: [Figure; FIGURES.len()],
}

/// Measures and prints the report.
///
/// # Errors
/// Bad input for words that nothing has; failed if a case has no answer.
pub fn run(args: &TradeoffArgs, global: &Global) -> Result<(), Failure> {
    // Before hours of work that could not be kept.
    if let Some(directory) = &args.plot {
        crate::files::folder("--plot", directory, global)?;
    }
    if cfg!(debug_assertions) {
        tracing::warn!("a debug build: times mean little");
    }
    let extent = Extent { full: args.full };
    let words: Vec<_> = args
        .only
        .iter()
        .flat_map(|only| only.split_whitespace())
        .collect();
    let plan = measure::plan(extent, &words);
    let sewn = suture::plan(&words);
    if plan.is_empty() && sewn.is_empty() {
        return Err(Failure::say(
            Cause::BadInput,
            format!(
                "no case and tissue have all the words `{}`",
                words.join(" ")
            ),
            "words are parts of a case's or a tissue's name: `beam`, `cylinder-compressed`, `linear`; --full has more cases",
        ));
    }
    let kept = Kept::within(args.plot.as_deref())?;
    let bar = progress(measure::lines(&plan, extent) + suture::lines(&sewn, extent));
    let mut told = |row: &Row| {
        bar.inc(1);
        bar.set_message(format!("{} {}", row.case, row.tissue));
        kept.line(row);
        if args.stream {
            say!("{}", serde_json::json!(row));
        } else {
            tracing::info!(
                "{} {} {}: {:.0} us, {:.2} %",
                row.case,
                row.tissue,
                row.settings,
                row.step_us,
                row.error_pct
            );
        }
    };
    let report = measure::measure(&plan, extent, &mut told).map_err(|why| {
        Failure::say(
            Cause::Failed,
            why,
            "the other cases can be run by their names with --only",
        )
    })?;
    let sutures = suture::measure(&sewn, extent, &mut |row| {
        bar.inc(1);
        bar.set_message(format!("{} {}", row.case, row.tissue));
        kept.line(row);
        if args.stream {
            say!("{}", serde_json::json!(row));
        }
    });
    bar.finish_and_clear();
    let output = Output {
        status: "ok",
        extent: if args.full { "full" } else { "short" },
        report: &report,
        sutures: &sutures,
        literature: FIGURES,
    };
    if let Some(directory) = &args.plot {
        write_files(&output, directory)?;
    }
    match global.format {
        Format::Json => crate::display::object(&output),
        Format::Text => {
            print_text(&report);
            print_sutures(&sutures);
            print_literature();
        }
    }
    Ok(())
}

fn print_text(report: &measure::Report) {
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

fn write_files(output: &Output, directory: &Path) -> Result<(), Failure> {
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        std::fs::write(&path, text).map_err(|error| unwritable(&path, &error))
    };
    let report = serde_json::json!(output);
    write("tradeoff.json", report.to_string())?;
    write("tradeoff.csv", csv(&output.report.cases))?;
    write("tradeoff-best.csv", csv(&output.report.best))?;
    write("tradeoff-truths.csv", csv(&output.report.truths))?;
    write("tradeoff-sutures.csv", csv(output.sutures))?;
    write_pictures(&report, directory)
}
