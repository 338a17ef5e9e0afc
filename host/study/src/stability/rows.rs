//! Rows whose units are far apart: metres beside micrometres, to twelve decades.
//!
//! Entry point: [`scaled`].

use super::judge::Verdict;
use sutura_host::rows::{Method, Problem, Row, RowKind, State, Status, Workspace, solve};

/// Every other row's unit is `scale` times as small; forces must be those of equal units.
pub fn scaled(scale: f64) -> Verdict {
    const N: usize = 12;
    let kind = |row: usize| match row % 3 {
        0 => RowKind::Equality,
        1 => RowKind::Inequality,
        _ => RowKind::Box { limit_n: 0.4 },
    };
    let unit = |row: usize| if row % 2 == 1 { scale } else { 1.0 };
    let solved = |unit: &dyn Fn(usize) -> f64| {
        let rows: Vec<_> = (0..N)
            .map(|row| Row {
                id: row as u64,
                kind: match kind(row) {
                    RowKind::Box { limit_n } => RowKind::Box {
                        limit_n: limit_n / unit(row),
                    },
                    other => other,
                },
            })
            .collect();
        // A compliance that falls with the distance of two rows.
        let entry = |i: usize, j: usize| 0.5f64.powi((i as i32 - j as i32).abs());
        let compliance: Vec<f64> = (0..N * N)
            .map(|at| unit(at / N) * unit(at % N) * entry(at / N, at % N))
            .collect();
        let delta: Vec<f64> = (0..N)
            .map(|row| unit(row) * (1.7 * row as f64).sin())
            .collect();
        let (mut state, mut work) = (State::new(N), Workspace::new(N));
        let problem = Problem {
            rows: &rows,
            compliance: &compliance,
            delta_free: &delta,
        };
        let outcome = solve(&problem, Method::ActiveSet, &mut state, &mut work);
        let forces: Vec<f64> = (0..N).map(|row| state.lambda()[row] * unit(row)).collect();
        (outcome.status, forces)
    };
    let (status, found) = solved(&unit);
    let (_, expected) = solved(&|_| 1.0);
    if !found.iter().all(|force| force.is_finite()) {
        return Verdict::Defect("a force is not a number".to_owned());
    }
    let off = found
        .iter()
        .zip(&expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    match status {
        Status::Ok if off < 1e-6 => Verdict::Stable,
        Status::NotFinite | Status::Malformed => Verdict::Refused(format!("{status:?}")),
        _ => Verdict::Degraded(format!("{status:?}, forces off by {off:.1e} of about 1")),
    }
}
