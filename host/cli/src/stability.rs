//! `sutura stability`: what tissue models, rows and console do at the extremes.
//!
//! Entry point: [`run`]. Trials and criteria are the library's; here they are chosen and printed.

use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use crate::signals::{interrupted, stop_after_a_line, then};
use crate::tables::{Kept, csv};
use crate::{Format, Global};
use clap::Args;
use indicatif::ProgressBar;
use std::path::{Path, PathBuf};
use sutura_files::write_whole;
use sutura_study::INTERRUPTED;
use sutura_study::stability::judge;
use sutura_study::stability::suite::{self, Case, Table};

/// Drives every tissue model, the row solver and the console to the extremes, and says what came of it.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct StabilityArgs {
    /// All values, and the largest stable step; without it the worst value of each kind.
    #[arg(long)]
    pub full: bool,
    /// Writes the table (CSV, JSON) into this directory.
    #[arg(long, value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Runs only what has all these words in its tissue or in what is extreme: `linear sliver`.
    #[arg(long, value_name = "WORDS")]
    pub only: Option<String>,
    /// One JSON object per line on stdout for every case as it is found.
    #[arg(long)]
    pub stream: bool,
}

const EXAMPLES: &str = "\
Examples:
  sutura stability                       the worst value of each kind
  sutura stability --full --plot tables  all values; CSV and JSON
  sutura stability --full --only \"corotational turn\"

An outcome is `stable`, `degraded` (the note says how) or `refused` (the note says why).
Anything else is a defect: it is named, and the exit code is 1.";

/// Runs the cases and prints the table.
///
/// # Errors
/// Bad input for words that nothing has; failed for a defect.
pub fn run(args: &StabilityArgs, global: &Global) -> Result<(), Failure> {
    // Before hours of work that could not be kept.
    if let Some(directory) = &args.plot {
        crate::files::folder("--plot", directory, global)?;
    }
    let words: Vec<_> = args
        .only
        .iter()
        .flat_map(|only| only.split_whitespace())
        .collect();
    let kept = Kept::within(args.plot.as_deref())?;
    let stop = stop_after_a_line()?;
    // How many there are is known only when they have been run.
    let bar = ProgressBar::new_spinner();
    let mut told = |case: &Case| {
        bar.inc(1);
        bar.set_message(format!(
            "{} cases, {} {}",
            bar.position(),
            case.tissue,
            case.what
        ));
        kept.line(case);
        if args.stream {
            say!("{}", serde_json::json!(case));
        } else {
            tracing::info!(
                "{} {} {}: {}",
                case.tissue,
                case.what,
                case.value,
                case.outcome
            );
        }
        then(&stop)
    };
    let cases = suite::measure(args.full, &words, &mut told)?;
    bar.finish_and_clear();
    if cases.is_empty() {
        return Err(Failure::say(
            Cause::BadInput,
            format!("no case has all the words `{}`", words.join(" ")),
            "words are parts of a tissue or of what is extreme: `corotational`, `turn`, `rows`, `console`",
        ));
    }
    let mut output = Table::of(args.full, cases);
    let is_whole = then(&stop).is_continue();
    if !is_whole {
        output.status = INTERRUPTED;
    }
    let cases = &output.cases;
    let defects: Vec<_> = cases
        .iter()
        .filter(|case| case.outcome == "defect")
        .collect();
    let written = match &args.plot {
        Some(directory) => write_files(&output, directory),
        None => Ok(()),
    };
    if let Err(failure) = &written {
        output.status = failure.cause.word();
    }
    match global.format {
        Format::Json => crate::display::object(&output),
        Format::Text => print_text(&output.cases),
    }
    written.map_err(Failure::after_summary)?;
    if !is_whole {
        return Err(interrupted(cases.len()));
    }
    if let Some(first) = defects.first() {
        return Err(Failure::say(
            Cause::Failed,
            format!(
                "{} of {} cases are defects, the first: {}, {} {}: {}",
                defects.len(),
                cases.len(),
                first.tissue,
                first.what,
                first.value,
                first.note
            ),
            "run it alone with --full --only",
        )
        .after_summary());
    }
    Ok(())
}

fn write_files(table: &Table, directory: &Path) -> Result<(), Failure> {
    for (name, text) in [
        ("stability.json", serde_json::json!(table).to_string()),
        ("stability.csv", csv(&table.cases)),
    ] {
        let path = directory.join(name);
        write_whole(&path, text.as_bytes()).map_err(|error| unwritable(&path, &error))?;
    }
    Ok(())
}

fn print_text(cases: &[Case]) {
    for case in cases {
        let largest = case.largest_stable.map_or(String::new(), |largest| {
            let least = if largest >= judge::LONGEST_STEP_S {
                "at least "
            } else {
                ""
            };
            format!("  largest stable {least}{largest:.1e}")
        });
        say!(
            "{:9} {:27} {:38} {:9}{largest}  {}",
            case.outcome,
            case.tissue,
            case.what,
            short(case.value),
            case.note
        );
    }
    let count = |word: &str| cases.iter().filter(|case| case.outcome == word).count();
    say!(
        "{} cases: {} stable, {} degraded, {} refused, {} defects",
        cases.len(),
        count("stable"),
        count("degraded"),
        count("refused"),
        count("defect")
    );
}

fn short(value: f64) -> String {
    if value == 0.0 || (1e-3..1e5).contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}
