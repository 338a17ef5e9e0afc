//! What was measured, as text. Entry points: [`group`], [`verdicts`].

use super::Group;
use super::judge::{LATE_US, Verdict};
use super::measured::Measured;
use std::fmt::Write;

/// A column: its head, its figure, and how many decimals it has.
type Column = (&'static str, fn(&Measured) -> Option<f64>, usize);

const COLUMNS: [Column; 15] = [
    ("seconds", |run| run.seconds, 2),
    ("decays", |run| run.decays, 0),
    ("overload", |run| run.overload, 0),
    ("peak_n", |run| run.peak_n, 3),
    ("rms_n", |run| run.rms_n, 3),
    ("punctures", |run| run.punctures, 0),
    ("gap", |run| run.gap_ratio, 4),
    ("solves", |run| run.solves_ratio, 3),
    ("contact", |run| run.contact_steps, 0),
    ("lat_p50", |run| run.latency_p50_us, 0),
    ("horizon", |run| run.horizon_ms, 0),
    ("ses_p99", |run| run.session_p99_us, 0),
    ("ses_max", |run| run.session_max_us, 0),
    ("ses_sec", |run| run.session_second_us, 0),
    ("late_us", |run| Some(run.machine_late_us), 0),
];

const WIDTH: usize = 10;

fn cell(value: Option<f64>, decimals: usize) -> String {
    match value {
        Some(value) => format!("{value:>WIDTH$.decimals$}"),
        None => format!("{:>WIDTH$}", "-"),
    }
}

fn line(label: &str, figure: impl Fn(&Column) -> Option<f64>) -> String {
    let cells: String = COLUMNS
        .iter()
        .map(|column| cell(figure(column), column.2))
        .collect();
    format!("{label:<9}{cells}")
}

fn sorted(runs: &[Measured], figure: fn(&Measured) -> Option<f64>) -> Vec<f64> {
    let mut values: Vec<f64> = runs.iter().filter_map(figure).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The figure farthest from lockstep's; where lockstep says nothing of a machine's pace, the largest.
fn worst(group: &Group, column: &Column) -> Option<f64> {
    let values = sorted(&group.runs, column.1);
    let from = match column.0 {
        "peak_n" | "rms_n" | "punctures" | "gap" | "seconds" | "contact" => {
            column.1(&group.lockstep)?
        }
        "solves" => 1.0,
        _ => 0.0,
    };
    values
        .into_iter()
        .max_by(|a, b| (a - from).abs().total_cmp(&(b - from).abs()))
}

/// All runs of a scene under a load, their median, the worst of each figure, and the bars.
pub fn group(group: &Group) -> String {
    let heads: String = COLUMNS
        .iter()
        .map(|column| format!("{:>WIDTH$}", column.0))
        .collect();
    let mut text = format!("\n{}, {}\n{:<9}{heads}\n", group.scene, group.load, "");
    let lockstep = line("lockstep", |column| match column.0 {
        "late_us" | "ses_p99" | "ses_max" | "ses_sec" => None,
        _ => column.1(&group.lockstep),
    });
    // Writing into a string cannot fail.
    let _ = writeln!(text, "{lockstep}");
    for (index, run) in group.runs.iter().enumerate() {
        let mark = if run.machine_late_us > LATE_US {
            "  machine late"
        } else {
            ""
        };
        let row = line(&format!("run {}", index + 1), |column| column.1(run));
        let how = if run.is_ok() {
            String::new()
        } else {
            let code = run.code.map_or("none".to_owned(), |code| code.to_string());
            format!("  exit {code}: {}", run.status)
        };
        let _ = writeln!(text, "{row}{mark}{how}");
    }
    let median = line("median", |column| {
        let values = sorted(&group.runs, column.1);
        values.get(values.len() / 2).copied()
    });
    let _ = writeln!(
        text,
        "{median}\n{}",
        line("worst", |column| worst(group, column))
    );
    for bar in &group.bars {
        let word = match bar.verdict {
            Verdict::Met => "met   ",
            Verdict::Missed => "MISSED",
        };
        let _ = writeln!(text, "  {word}  {} of {}  {}", bar.held, bar.of, bar.name);
    }
    text
}

/// The tables of all groups, then each bar over all scenes of a load.
pub fn verdicts(groups: &[Group], unmeasured: &[String]) -> String {
    let mut text: String = groups.iter().map(group).collect();
    for load in super::Load::ALL {
        let of_load = || groups.iter().filter(move |group| group.load == load);
        let mut names: Vec<&str> = Vec::new();
        for bar in of_load().flat_map(|group| &group.bars) {
            if !names.contains(&bar.name.as_str()) {
                names.push(&bar.name);
            }
        }
        if names.is_empty() {
            continue;
        }
        let _ = writeln!(text, "\nall scenes, {load}");
        for name in names {
            let bars = || {
                of_load()
                    .flat_map(|group| &group.bars)
                    .filter(|bar| bar.name == name)
            };
            let (held, of) = bars().fold((0, 0), |sum, bar| (sum.0 + bar.held, sum.1 + bar.of));
            let word = if held < of { "MISSED" } else { "met   " };
            let _ = writeln!(text, "  {word}  {held} of {of}  {name}");
        }
    }
    for line in unmeasured {
        let _ = writeln!(text, "\nnot measured: {line}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::{Load, judge};
    use super::*;

    #[test]
    fn a_table_has_every_run_the_median_the_worst_and_the_bars() {
        let run = |peak: f64, late: f64| Measured {
            code: Some(0),
            status: "ok".into(),
            peak_n: Some(peak),
            machine_late_us: late,
            ..Measured::default()
        };
        let lockstep = run(4.0, 0.0);
        let mut failed = run(3.0, 10.0);
        (failed.code, failed.status) = (Some(1), "idle: nothing came".into());
        let runs = vec![run(4.1, 9000.0), failed, run(4.0, 10.0)];
        let one = Group {
            scene: "palpation".into(),
            load: Load::BusyPlain,
            bars: judge::bars("palpation", Load::BusyPlain, &lockstep, &runs),
            lockstep,
            runs,
        };
        let text = group(&one);
        let row = |label: &str| {
            let found = text.lines().find(|line| line.starts_with(label));
            found.unwrap_or_else(|| panic!("no {label} in {text}"))
        };
        assert!(row("run 1").contains("4.100") && row("run 1").contains("machine late"));
        assert!(row("run 2").contains("exit 1: idle: nothing came"));
        assert!(!row("run 3").contains("late"));
        assert!(row("median").contains("4.000"));
        assert!(row("worst").contains("3.000") && row("worst").contains("9000"));
        assert!(text.contains("MISSED  2 of 3  ends ok"), "{text}");
        let all = verdicts(&[one], &["busy: no rights".to_owned()]);
        assert!(all.contains("all scenes, busy") && all.contains("not measured: busy: no rights"));
    }
}
