//! `sutura fidelity`: how true and how stable the console's force is, by simulation.
//!
//! Entry point: [`run`]. The cases and the bars are the library's; here they are chosen, printed and plotted.

use crate::display::progress;
use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use crate::signals::{interrupted, stop_after_a_line, then};
use crate::tables::{Kept, csv, write_pictures};
use crate::{Format, Global};
use clap::Args;
use std::path::{Path, PathBuf};
use sutura_files::write_whole;
use sutura_shared::device::DeviceError;
use sutura_study::INTERRUPTED;
use sutura_study::fidelity::case::{Case, Scenes};
use sutura_study::fidelity::corners;
use sutura_study::fidelity::mutants::{self, Mutant};
use sutura_study::fidelity::oracles::oracles;
use sutura_study::fidelity::report::{Report, chosen};
use sutura_study::fidelity::suite::{self, Extent};
use sutura_study::fidelity::switches::Switch;
use sutura_study::fidelity::targets::{self, Tighten};
use sutura_study::fidelity::traces;
use sutura_study::fidelity::trials::{Spread, Three};

/// Measures the console's force against a solve every millisecond: errors, stable stiffness, energy.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct FidelityArgs {
    /// All tables, and each guard switched off in turn; without it what the bars need, in a minute.
    #[arg(long)]
    pub full: bool,
    /// Only each guard switched off in turn, in the short form: which bars fail without it.
    #[arg(long, conflicts_with_all = ["full", "only"])]
    pub guards: bool,
    /// Writes tables (CSV, JSON) and plots (SVG) into this directory.
    #[arg(long, value_name = "DIR")]
    pub plot: Option<PathBuf>,
    /// Runs only cases whose name has all these words, as the tables print it: `palpation taps`.
    #[arg(long, value_name = "WORDS")]
    pub only: Option<String>,
    /// Exits with 7 if a bar is missed.
    #[arg(long)]
    pub check: bool,
    /// Cases at the same time; all of the machine's processors if it is left out.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

const EXAMPLES: &str = "\
Examples:
  sutura fidelity                            what the bars need
  sutura fidelity --full --plot figures      all tables, CSV, JSON and SVG
  sutura fidelity --guards --check           exit code 7 if a guard's absence fails no bar
  sutura fidelity --full --only \"palpation taps rows\"
  sutura fidelity --full --only corner       consoles that are not as described
  sutura fidelity --full --only \"trial needle phase\"
  sutura fidelity --full --only \"trial draw-17\"   one of 200 draws of everything
  sutura fidelity --check --format json      for scripts: exit code 7 if a bar is missed

Everything is simulated, by seeds: the figures do not depend on the machine. Build with --release.";

/// Runs the cases and prints the report.
///
/// # Errors
/// Bad input for words that no case has; the stated budget missed with `--check`.
pub fn run(args: &FidelityArgs, global: &Global) -> Result<(), Failure> {
    // Before hours of work that could not be kept.
    if let Some(directory) = &args.plot {
        crate::files::folder("--plot", directory, global)?;
    }
    if cfg!(debug_assertions) {
        tracing::warn!("a debug build: this takes many times longer");
    }
    let extent = if args.full {
        Extent::Full
    } else {
        Extent::Short
    };
    let threads = args
        .threads
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get));
    let mut specs = if args.guards {
        mutants::specs()
    } else {
        suite::specs(extent)
    };
    if let Some(only) = &args.only {
        specs = chosen(specs, only);
        if specs.is_empty() {
            return Err(Failure::say(
                Cause::BadInput,
                format!("no case has all the words `{only}`"),
                "words are whole: `palpation`, `taps`, `rows`, `60-hz`, `x0.5`; --full has more cases",
            ));
        }
    }
    let scenes = Scenes::load()?;
    let stop = stop_after_a_line()?;
    let bar = progress(specs.len());
    let told = |done: usize, case: &Case| {
        bar.set_position(done as u64);
        bar.set_message(case.case.clone());
        then(&stop)
    };
    let kept = Kept::within(args.plot.as_deref())?;
    let measured = |done: usize, case: &Case| {
        kept.line(case);
        told(done, case)
    };
    let cases = suite::measure(&specs, &scenes, threads, &measured).map_err(unsound)?;
    let whole = args.only.is_none();
    let oracles = if whole && !args.guards && then(&stop).is_continue() {
        oracles().map_err(unsound)?
    } else {
        Vec::new()
    };
    let guards = if (args.guards || args.full && whole) && then(&stop).is_continue() {
        let runs = (1 + Switch::all().len()) * mutants::specs().len();
        bar.set_length(runs as u64);
        mutants::mutants(&scenes, threads, &told).map_err(unsound)?
    } else {
        Vec::new()
    };
    bar.finish_and_clear();
    let is_whole = then(&stop).is_continue();
    let traces = if args.plot.is_some() && is_whole {
        traces::of(&cases, &scenes)
    } else {
        Vec::new()
    };
    let mut report = Report::of(extent, cases, oracles, guards, traces);
    let missed = report.misses();
    if !is_whole {
        report.status = INTERRUPTED;
    }
    let written = match &args.plot {
        Some(directory) => write_files(&report, directory),
        None => Ok(()),
    };
    if let Err(failure) = &written {
        report.status = failure.cause.word();
    }
    match global.format {
        Format::Json => crate::display::object(&report),
        Format::Text => print_text(&report),
    }
    written.map_err(Failure::after_summary)?;
    if !is_whole {
        return Err(interrupted(report.cases.len()));
    }
    if missed && args.check {
        let missed = report.bars.iter().filter(|bar| !bar.ok && !bar.open);
        let missed = missed.count();
        let useless = report.guards.iter().filter(|guard| guard.fails.is_empty());
        let useless: Vec<_> = useless.map(|guard| guard.guard).collect();
        return Err(Failure::say(
            Cause::Budget,
            if useless.is_empty() {
                format!("{missed} of {} bars are missed", report.bars.len())
            } else {
                format!("no bar fails without {}", useless.join(", "))
            },
            "the table names the worst case of each; run it alone with --full --only",
        )
        .after_summary());
    }
    Ok(())
}

fn unsound(error: DeviceError) -> Failure {
    Failure::say(
        Cause::Failed,
        format!("the simulated console is not a valid device: {error}"),
        "this is a defect of the command",
    )
}

/// With more cases trials are printed in groups only; files have them all.
const LISTED: usize = 300;

fn print_text(report: &Report) {
    let is_listed =
        |c: &&Case| c.errors.is_some() && (c.trial.is_none() || report.cases.len() <= LISTED);
    let with_errors: Vec<_> = report.cases.iter().filter(is_listed).collect();
    if !with_errors.is_empty() {
        say!(
            "Force error, % of the largest true force: RMS, peak, excess step at an update; least energy"
        );
        for case in with_errors {
            let Some(e) = case.errors else { continue };
            say!(
                "  {:58} {:7.2} {:7.2} {:7.2} {:9.3} mJ",
                case.case,
                e.rms_pct,
                e.peak_pct,
                e.step_pct,
                1e3 * case.energy_min_j
            );
        }
    }
    let stiff: Vec<_> = report
        .cases
        .iter()
        .filter(|c| c.k_max_n_per_m.is_some() && c.corner.is_none())
        .collect();
    if !stiff.is_empty() {
        say!(
            "Largest stable stiffness, that over the full 1 kHz loop's, least force over true; least energy"
        );
        for case in stiff {
            say!(
                "  {:58} {:6.0} N/m {:6.2} {:6.3} {:9.3} mJ",
                case.case,
                case.k_max_n_per_m.unwrap_or_default(),
                case.k_ratio.unwrap_or(f64::NAN),
                case.force_ratio.unwrap_or(f64::NAN),
                1e3 * case.energy_min_j
            );
        }
    }
    print_spreads(&report.spreads);
    let corners = corners::table(&report.cases);
    if !corners.is_empty() {
        say!(
            "Corners of the device: largest stable stiffness, its own reference (1 kHz, no delay), the first over the second; most given back in 100 ms, of both; what ends it"
        );
    }
    for line in &corners {
        say!(
            "  {:12} {:13} {:6.0} N/m {:6.0} N/m {:6.2} {:9.3} mJ {:9.3} mJ  {}",
            line.hand,
            line.device,
            line.k_max_n_per_m,
            line.k_reference_n_per_m,
            line.k_of_reference,
            line.given_back_mj,
            line.reference_given_back_mj,
            line.ends_by
        );
    }
    print_returns(&report.cases);
    for case in &report.cases {
        if let Some(slips) = case.slips.filter(|_| is_listed(&case)) {
            say!(
                "{}: {} turns, slips felt within {:.0} ms (p95), {:.0} ms at most",
                case.case,
                slips.onsets,
                slips.onset_p95_ms,
                slips.onset_max_ms
            );
        }
    }
    for case in &report.cases {
        if let Some(p) = case.punctures.filter(|_| is_listed(&case)) {
            say!(
                "{}: {} punctures, {} missed, felt within {:.0} ms (p95), {:.0} ms at most, falls off by {:.0} % at most",
                case.case,
                p.punctures,
                p.punctures_missed,
                p.puncture_p95_ms,
                p.puncture_max_ms,
                p.puncture_fall_off_pct
            );
        }
    }
    for case in &report.cases {
        if let Some(p) = case.peaks {
            say!(
                "{}: {:.2} N, {:.2} N across, {:.0} N/s, {:.2} W, {:.2} m/s, {} ticks too fast, faults {:#06x}",
                case.case,
                p.force_peak_n,
                p.across_peak_n,
                p.slew_peak_n_per_s,
                p.power_peak_w,
                p.speed_peak_m_per_s,
                p.ticks_too_fast,
                p.faults
            );
        }
    }
    for links in &report.bad_links {
        say!(
            "Bad links, {}: {} of {} cases give back more than {} mJ, {:.2} mJ at most in 100 ms, {:.2} mJ beyond all that was taken; a bar on energy fails for {} of these",
            if links.is_unguarded {
                "without tank and damping"
            } else {
                "with all guards"
            },
            links.over,
            links.cases,
            targets::GIVEN_BACK_MJ,
            links.most_mj,
            links.most_beyond_taken_mj,
            links.failing
        );
    }
    for oracle in &report.oracles {
        say!(
            "{} {:60} {:10.3} expected {:10.3} {}",
            if oracle.ok { "ok    " } else { "MISSED" },
            oracle.name,
            oracle.value,
            oracle.expected,
            oracle.unit
        );
    }
    for bar in &report.bars {
        say!(
            "{} {:52} {:9.3} {} {:8.3}   {}",
            match (bar.ok, bar.open) {
                (true, _) => "ok    ",
                (false, true) => "open  ",
                (false, false) => "MISSED",
            },
            bar.name,
            bar.value,
            bar.must_be,
            bar.bar,
            bar.worst
        );
    }
    for mutant in &report.guards {
        let sign = if mutant.fails.is_empty() {
            "MISSED"
        } else {
            "ok    "
        };
        say!("{sign} without {}: {}", mutant.guard, failures(mutant));
    }
    let met = report.bars.iter().filter(|bar| bar.ok).count();
    let open = report.bars.iter().filter(|bar| bar.open).count();
    let all = report.bars.len() - open;
    say!("{met} of {all} bars met, {open} open");
    print_tighten(&report.tighten);
}

fn print_tighten(tighten: &[Tighten]) {
    for better in tighten {
        say!(
            "tighten {}: {:.3} in this run, listed as open at {:.3}, bar {:.3}{}",
            better.name,
            better.value,
            better.known,
            better.bar,
            if better.met { ", met" } else { "" }
        );
    }
}

fn print_spreads(spreads: &[Spread]) {
    if spreads.is_empty() {
        return;
    }
    say!(
        "Trials, median / p95 / worst: RMS of the command, %; contact beyond notice, %; given back in 100 ms, mJ; dropouts a minute, punctures missed, %"
    );
    for spread in spreads {
        let three =
            |three: Three| format!("{:.2}/{:.2}/{:.2}", three.median, three.p95, three.worst);
        say!(
            "  {:36} {:4} {:20} {:20} {:16} {:6.1} {:5.1}  {}",
            spread.group,
            spread.runs,
            three(spread.rms_pct),
            three(spread.beyond_pct),
            three(spread.given_back_mj),
            spread.dropouts_per_min,
            spread.missed_pct,
            spread.worst
        );
    }
}

fn print_returns(cases: &[Case]) {
    if cases.iter().any(|case| case.returned.is_some()) {
        say!(
            "Forces that come back: left of them before, 90 % of the true force after, of the time allowed, rise, given beyond the true tissue, given at all, hand past its rest"
        );
    }
    for case in cases {
        let Some(r) = case.returned else { continue };
        let time = |ms: f64| format!("{ms:.0} ms");
        let part = |part: f64| format!("{part:.2}");
        let never = || "never".to_owned();
        say!(
            "  {:52} {:5.2} N of {:5.2} N {:>8} {:>5} {:6.2} N/s {:7.3} mJ {:7.3} mJ {:6.2} mm",
            case.case,
            r.gone_force_n,
            r.returning_n,
            r.time_to_90_ms.map_or_else(never, time),
            r.time_of_allowed.map_or_else(never, part),
            r.rise_n_per_s,
            r.beyond_true_mj,
            r.handed_out_mj,
            r.past_rest_mm
        );
    }
    for case in cases {
        if let Some(force_n) = case.force_after_stop_n {
            say!("{}: {force_n:.2} N after it", case.case);
        }
    }
}

fn failures(mutant: &Mutant) -> String {
    if mutant.fails.is_empty() {
        return "NO BAR FAILS: nothing shows what it is for".to_owned();
    }
    let fails: Vec<_> = mutant
        .fails
        .iter()
        .map(|bar| format!("{} {:.3}", bar.name, bar.value))
        .collect();
    fails.join("; ")
}

fn write_files(report: &Report, directory: &Path) -> Result<(), Failure> {
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        write_whole(&path, text.as_bytes()).map_err(|error| unwritable(&path, &error))
    };
    let json = serde_json::json!(report);
    write("fidelity.json", json.to_string())?;
    write("cases.csv", csv(&report.cases))?;
    let corners = corners::table(&report.cases);
    if !corners.is_empty() {
        write("corners.csv", csv(&corners))?;
    }
    write(
        "spreads.json",
        serde_json::json!(report.spreads).to_string(),
    )?;
    write("bars.csv", csv(&report.bars))?;
    write("oracles.csv", csv(&report.oracles))?;
    write_pictures(&json, directory)
}
