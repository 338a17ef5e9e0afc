//! Equality, inequality and box rows against clarabel's interior point method.

use super::sets::Set;
use super::{PLAIN, cold, difference, sets};
use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::NonnegativeConeT;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus};
use sutura_host::rows::{Method, Mode, RowKind, Status};

/// `min 1/2 lambda' W lambda + delta_free' lambda` over the bounds, by an interior point method.
fn quadratic_programme(set: &Set) -> Vec<f64> {
    let n = set.rows.len();
    // Numbers near 1 for the oracle.
    let w = set.compliance.iter().fold(0.0f64, |m, w| m.max(w.abs()));
    let free = set.delta_free.iter().fold(0.0f64, |m, f| m.max(f.abs()));
    let (mut values, mut rows, mut starts) = (Vec::new(), Vec::new(), vec![0]);
    for j in 0..n {
        for i in 0..=j {
            rows.push(i);
            values.push(set.compliance[j * n + i] / w);
        }
        starts.push(rows.len());
    }
    let hessian = CscMatrix::new(n, n, starts, rows, values);
    let linear: Vec<f64> = set.delta_free.iter().map(|f| f / free).collect();
    let (mut bounds, mut limits) = (vec![Vec::new(); n], Vec::new());
    for (row, kind) in set.rows.iter().map(|row| row.kind).enumerate() {
        match kind {
            RowKind::Inequality => {
                bounds[row].push((limits.len(), -1.0));
                limits.push(0.0);
            }
            RowKind::Box { limit_n } => {
                for side in [1.0, -1.0] {
                    bounds[row].push((limits.len(), side));
                    limits.push(limit_n * w / free);
                }
            }
            RowKind::Between { least_n, most_n } => {
                for (side, limit_n) in [(1.0, most_n), (-1.0, -least_n)] {
                    bounds[row].push((limits.len(), side));
                    limits.push(limit_n * w / free);
                }
            }
            _ => assert_eq!(kind, RowKind::Equality),
        }
    }
    let (mut values, mut rows, mut starts) = (Vec::new(), Vec::new(), vec![0]);
    for (row, value) in bounds.iter().flat_map(|column| {
        column
            .iter()
            .copied()
            .chain(std::iter::once((usize::MAX, 0.0)))
    }) {
        if row == usize::MAX {
            starts.push(rows.len());
        } else {
            rows.push(row);
            values.push(value);
        }
    }
    let cones = [NonnegativeConeT(limits.len())];
    let matrix = CscMatrix::new(limits.len(), n, starts, rows, values);
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-13)
        .tol_gap_rel(1e-13)
        .tol_feas(1e-13)
        .build()
        .expect("settings");
    let mut solver = DefaultSolver::new(&hessian, &linear, &matrix, &limits, &cones, settings)
        .expect("a programme");
    solver.solve();
    assert!(matches!(
        solver.solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved | SolverStatus::InsufficientProgress
    ));
    solver.solution.x.iter().map(|x| x * free / w).collect()
}

#[test]
fn forces_are_those_of_the_quadratic_programme() {
    let mut bounded = 0;
    for set in sets(1, 300, PLAIN) {
        let (outcome, state, _) = cold(&set, Method::ActiveSet);
        assert_eq!(outcome.status, Status::Ok);
        let oracle = quadratic_programme(&set);
        let off = difference(&set, state.lambda(), &oracle);
        assert!(off < 1e-6, "{off} with {} rows", set.rows.len());
        bounded += state
            .modes()
            .iter()
            .filter(|mode| **mode != Mode::Held)
            .count();
    }
    assert!(bounded > 500, "{bounded} rows at a bound");
}
