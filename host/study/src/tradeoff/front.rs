//! Which lines of the table are worth choosing.
//!
//! Entry points: [`mark`], [`best`]. Accuracy is [`Row::error_pct`], against quadratic cells, so that a fine mesh with a
//! poor model and a coarse one with a good model compare, and nothing wins that is late or feels wrong.

use super::measure::Row;
use schemars::JsonSchema;
use serde::Serialize;

/// Times that a step may take \[us\].
pub const BUDGETS_US: [f64; 4] = [500.0, 1_000.0, 5_000.0, 30_000.0];

/// The most accurate line of a case within a time.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Best {
    /// Name of the case.
    pub case: &'static str,
    /// What a step may take \[ms\].
    pub budget_ms: f64,
    /// Name of the model; empty if none is fast enough.
    pub tissue: &'static str,
    /// Its knobs.
    pub settings: String,
    /// Its mesh.
    pub level: usize,
    /// Cells of the mesh.
    pub cells: usize,
    /// What a step takes \[us\].
    #[schemars(with = "Option<f64>")]
    pub step_us: f64,
    /// What it was chosen by \[%\].
    #[schemars(with = "Option<f64>")]
    pub error_pct: f64,
    /// RMS error of all nodes against the truth as the load has just come \[%\].
    #[schemars(with = "Option<f64>")]
    pub arrival_rms_pct: f64,
    /// RMS error of all nodes against the truth \[%\].
    #[schemars(with = "Option<f64>")]
    pub truth_disp_rms_pct: f64,
    /// Largest error on the line \[%\].
    #[schemars(with = "Option<f64>")]
    pub truth_red_line_pct: f64,
    /// Error of the reaction \[%\].
    #[schemars(with = "Option<f64>")]
    pub truth_force_pct: f64,
}

/// Marks lines of which no other of their case is at least as fast and as accurate, and better in one.
pub fn mark(rows: &mut [Row]) {
    let points: Vec<_> = rows
        .iter()
        .map(|row| (row.case, row.step_us, row.error_pct))
        .collect();
    for (row, (case, time, error)) in rows.iter_mut().zip(&points) {
        let finite = time.is_finite() && error.is_finite();
        row.pareto = finite
            && !points.iter().any(|(other, other_time, other_error)| {
                other == case
                    && other_time <= time
                    && other_error <= error
                    && (other_time < time || other_error < error)
            });
    }
}

/// The most accurate of each case within each of the times.
pub fn best(rows: &[Row]) -> Vec<Best> {
    let mut cases: Vec<&'static str> = rows.iter().map(|row| row.case).collect();
    cases.dedup();
    let mut table = Vec::new();
    for case in cases {
        for budget_us in BUDGETS_US {
            let fast = rows.iter().filter(|row| {
                row.case == case && row.step_us <= budget_us && row.error_pct.is_finite()
            });
            let found = fast.min_by(|a, b| a.error_pct.total_cmp(&b.error_pct));
            table.push(Best {
                case,
                budget_ms: 1e-3 * budget_us,
                tissue: found.map_or("", |row| row.tissue),
                settings: found.map_or(String::new(), |row| row.settings.clone()),
                level: found.map_or(0, |row| row.level),
                cells: found.map_or(0, |row| row.cells),
                step_us: found.map_or(f64::NAN, |row| row.step_us),
                error_pct: found.map_or(f64::NAN, |row| row.error_pct),
                arrival_rms_pct: found.map_or(f64::NAN, |row| row.arrival_rms_pct),
                truth_disp_rms_pct: found.map_or(f64::NAN, |row| row.truth_disp_rms_pct),
                truth_red_line_pct: found.map_or(f64::NAN, |row| row.truth_red_line_pct),
                truth_force_pct: found.map_or(f64::NAN, |row| row.truth_force_pct),
            });
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(case: &'static str, step_us: f64, error: f64) -> Row {
        Row {
            case,
            tissue: "t",
            settings: String::new(),
            level: 1,
            nodes: 1,
            cells: 1,
            step_us,
            worst_us: step_us,
            spread_pct: 0.0,
            runs: 1,
            disp_rms_pct: error,
            disp_max_pct: error,
            red_line_pct: error,
            force_pct: error,
            arrival_rms_pct: error,
            truth_disp_rms_pct: error,
            truth_disp_max_pct: error,
            truth_red_line_pct: error,
            truth_force_pct: error,
            error_pct: error,
            pareto: false,
            outcome: "converged",
            note: String::new(),
        }
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let mut rows = [
            row("a", 100.0, 9.0),
            row("a", 200.0, 10.0),
            row("a", 800.0, 2.0),
            row("a", 40_000.0, 1.0),
            row("a", 50.0, f64::NAN),
            row("b", 900.0, 50.0),
        ];
        mark(&mut rows);
        let marked: Vec<_> = rows.iter().map(|row| row.pareto).collect();
        assert_eq!(marked, [true, false, true, true, false, true]);
        let best = best(&rows);
        let errors: Vec<_> = best.iter().map(|best| best.truth_disp_rms_pct).collect();
        assert_eq!(errors[..4], [9.0, 2.0, 2.0, 2.0]);
        assert!(best[4].tissue.is_empty() && best[5].truth_disp_rms_pct == 50.0);
    }
}
