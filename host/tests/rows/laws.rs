//! The law of friction, and the same forces by other ways.

use super::sets::{Draw, Kind};
use super::{GENTLE, PLAIN, assert_solved, buffers, cold, difference, sets};
use sutura_host::rows::{Method, Mode, RowFlag, RowKind, Status, solve};
use sutura_testkit::Random;

/// The law of friction as it is written in the documentation of `RowKind`, row by row.
#[test]
fn cones_close_stick_and_slip_by_their_law() {
    let (mut open, mut sticking, mut slipping) = (0, 0, 0);
    for set in sets(
        2,
        1500,
        Draw {
            friction: 1.0,
            ..GENTLE
        },
    ) {
        let (outcome, state, _) = cold(&set, Method::ActiveSet);
        assert_eq!(outcome.status, Status::Ok);
        assert_solved(&set, &outcome, &state);
        let (lambda, delta) = (state.lambda(), state.delta());
        let scale = set.delta_free.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        let most = |values: &[f64]| values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let strongest = most(lambda).max(scale / most(&set.compliance));
        for (row, kind) in set.rows.iter().map(|row| row.kind).enumerate() {
            let RowKind::Normal { friction } = kind else {
                continue;
            };
            assert!(delta[row] >= -1e-7 * scale);
            if lambda[row] < 1e-6 * strongest {
                open += 1;
                continue;
            }
            assert!(delta[row].abs() <= 1e-7 * scale);
            let reach = friction * lambda[row];
            let slide = delta[row + 1].hypot(delta[row + 2]);
            if state.modes()[row + 1] == Mode::Held {
                sticking += 1;
                assert!(slide <= 1e-7 * scale);
            } else {
                slipping += 1;
                for tangent in [row + 1, row + 2] {
                    let opposed = -reach * delta[tangent] / slide;
                    if slide > 1e-4 * scale {
                        assert!((lambda[tangent] - opposed).abs() <= 1e-3 * strongest);
                    }
                }
            }
        }
    }
    assert!(
        open > 200 && sticking > 200 && slipping > 200,
        "{open} {sticking} {slipping}"
    );
}

#[test]
fn gauss_seidel_run_long_finds_the_same_forces() {
    let method = Method::GaussSeidel {
        sweeps: 20_000,
        tolerance: 1e-13,
    };
    let mut cones = 0;
    for how in [PLAIN, GENTLE] {
        for set in sets(
            3,
            150,
            Draw {
                softest: 4.0,
                ..how
            },
        ) {
            let (outcome, swept, _) = cold(&set, method);
            assert_eq!(outcome.status, Status::Ok);
            let (outcome, state, _) = cold(&set, Method::ActiveSet);
            assert_eq!(outcome.status, Status::Ok);
            let off = difference(&set, state.lambda(), swept.lambda());
            assert!(off < 1e-9, "{off} with {} rows", set.rows.len());
            cones += usize::from(set.has_cones());
        }
    }
    assert!(cones > 80, "{cones} sets with cones");
}

/// After a step of the targets, rows that went and rows that came.
#[test]
fn a_warm_start_ends_where_a_cold_one_does() {
    let mut random = Random::new(4);
    let mut fewer = 0i64;
    for set in sets(4, 300, GENTLE) {
        let (mut state, mut work) = buffers();
        solve(&set.problem(), Method::ActiveSet, &mut state, &mut work);
        let (mut next, _) = set.permuted(&mut random);
        for free in &mut next.delta_free {
            *free *= 1.0 + 0.02 * random.signed();
        }
        let place = random.below(next.rows.len());
        next.rows[place].id = random.bits();
        let warm = solve(&next.problem(), Method::ActiveSet, &mut state, &mut work);
        assert_eq!(warm.status, Status::Ok);
        let (outcome, fresh, _) = cold(&next, Method::ActiveSet);
        let off = difference(&next, state.lambda(), fresh.lambda());
        assert!(off < 1e-7, "{off} with {} rows", next.rows.len());
        fewer += i64::from(outcome.iterations) - i64::from(warm.iterations);
    }
    assert!(fewer > 100, "{fewer} iterations saved");
}

#[test]
fn the_order_of_rows_does_not_matter() {
    let mut random = Random::new(5);
    let draws = [
        (GENTLE, 1e-8),
        // The share of each copy of a row is that of least norm, to what the regularisation leaves.
        (
            Draw {
                dependent: 1.0,
                ..PLAIN
            },
            1e-4,
        ),
    ];
    let met = |status| matches!(status, Status::Ok | Status::Redundant);
    for (how, tolerance) in draws {
        let mut compared = 0;
        for set in sets(5, 300, how) {
            let (before, state, _) = cold(&set, Method::ActiveSet);
            let (other, from) = set.permuted(&mut random);
            let (outcome, permuted, _) = cold(&other, Method::ActiveSet);
            // Combinations of combinations may be nearly, not quite, dependent: a compromise.
            if !(met(before.status) && met(outcome.status)) {
                continue;
            }
            compared += 1;
            let expected: Vec<f64> = from.iter().map(|&row| state.lambda()[row]).collect();
            let off = difference(&other, permuted.lambda(), &expected);
            assert!(off < tolerance, "{off} with {} rows", set.rows.len());
        }
        assert!(compared >= 297, "{compared}");
    }
}

/// Equality rows at odds: no force can make the violation smaller, `W~ delta~ = 0`, and none is made
/// against another for nothing.
#[test]
fn targets_at_odds_end_in_least_squares() {
    let how = Draw {
        kinds: &[Kind::Equality],
        dependent: 1.0,
        conflicting: 1.0,
        ..PLAIN
    };
    let mut conflicts = 0;
    for set in sets(6, 300, how) {
        let (outcome, state, work) = cold(&set, Method::ActiveSet);
        if outcome.status != Status::Incompatible {
            continue;
        }
        conflicts += 1;
        assert!(work.flags().contains(&RowFlag::Incompatible));
        let n = set.rows.len();
        let root = |row: usize| set.compliance[row * (n + 1)].sqrt();
        let violation: Vec<f64> = (0..n).map(|row| state.delta()[row] / root(row)).collect();
        let size = violation.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let drive = (0..n).fold(0.0f64, |m, row| {
            m.max(set.delta_free[row].abs() / root(row))
        });
        for i in 0..n {
            let pull: f64 = (0..n)
                .map(|j| set.compliance[j * n + i] / (root(i) * root(j)) * violation[j])
                .sum();
            assert!(pull.abs() <= 1e-6 * drive, "{pull} of {size}");
            // The regularisation alone makes 1e8 times the violation of it.
            let force = state.lambda()[i] * root(i);
            assert!(force.abs() <= 1e5 * drive, "{force} for {drive}");
        }
    }
    assert!(conflicts > 100, "{conflicts}");
}
