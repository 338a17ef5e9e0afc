//! Coulomb's law at a given normal force: discs among other rows.

use super::sets::{Draw, WITH_DISCS};
use super::{GENTLE, assert_solved, cold, difference, sets};
use sutura_host::rows::{
    Method, Mode, Problem, Row, RowKind, State, Status, Workspace, solve, tangent,
};

const DISCS: Draw = Draw {
    kinds: WITH_DISCS,
    ..GENTLE
};

/// The law as it is written in the documentation of `RowKind`.
#[test]
fn discs_stick_and_slip_by_their_law() {
    let (mut sticking, mut slipping) = (0, 0);
    for set in sets(12, 1500, DISCS) {
        let (outcome, state, _) = cold(&set, Method::ActiveSet);
        assert_eq!(outcome.status, Status::Ok);
        assert_solved(&set, &outcome, &state);
        let (lambda, delta) = (state.lambda(), state.delta());
        let scale = set.delta_free.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        for (row, kind) in set.rows.iter().map(|row| row.kind).enumerate() {
            let RowKind::Disc { limit_n } = kind else {
                continue;
            };
            let slide = delta[row].hypot(delta[row + 1]);
            if state.modes()[row] == Mode::Held {
                sticking += u32::from(limit_n > 0.0);
                assert!(slide <= 1e-7 * scale);
                continue;
            }
            slipping += 1;
            for at in [row, row + 1] {
                let opposed = -limit_n * delta[at] / slide;
                if slide > 1e-4 * scale {
                    assert!((lambda[at] - opposed).abs() <= 1e-3 * limit_n);
                }
            }
        }
    }
    assert!(sticking > 200 && slipping > 200, "{sticking} {slipping}");
}

#[test]
fn gauss_seidel_run_long_finds_the_forces_of_discs() {
    let method = Method::GaussSeidel {
        sweeps: 20_000,
        tolerance: 1e-13,
    };
    let mut discs = 0;
    for set in sets(
        13,
        150,
        Draw {
            softest: 4.0,
            ..DISCS
        },
    ) {
        let (outcome, swept, _) = cold(&set, method);
        assert_eq!(outcome.status, Status::Ok);
        let (_, state, _) = cold(&set, Method::ActiveSet);
        let off = difference(&set, state.lambda(), swept.lambda());
        assert!(off < 1e-9, "{off} with {} rows", set.rows.len());
        discs += u32::from(
            set.rows
                .iter()
                .any(|row| matches!(row.kind, RowKind::Disc { .. })),
        );
    }
    assert!(discs > 30, "{discs}");
}

fn rows(limit_n: f64) -> [Row; 2] {
    [
        Row {
            id: 1,
            kind: RowKind::Disc { limit_n },
        },
        Row {
            id: 2,
            kind: RowKind::Tangent,
        },
    ]
}

/// A pull of 5 on compliances of 2: all of it sticks below 2.5, and any direction slips at the same force.
#[test]
fn a_disc_is_round() {
    for (limit_n, held_n) in [
        (0.0, 0.0),
        (0.5, 0.5),
        (2.4, 2.4),
        (2.6, 2.5),
        (f64::INFINITY, 2.5),
    ] {
        for angle in [0.0f64, 0.3, 0.785, 1.9, -2.5] {
            let free = [-5.0 * angle.cos(), -5.0 * angle.sin()];
            let problem = Problem {
                rows: &rows(limit_n),
                compliance: &[2.0, 0.0, 0.0, 2.0],
                delta_free: &free,
            };
            let (mut state, mut work) = (State::new(2), Workspace::new(2));
            let outcome = solve(&problem, Method::ActiveSet, &mut state, &mut work);
            assert!(matches!(outcome.status, Status::Ok), "{outcome:?}");
            let [x, y] = [state.lambda()[0], state.lambda()[1]];
            assert!((x - held_n * angle.cos()).abs() < 1e-12);
            assert!((y - held_n * angle.sin()).abs() < 1e-12);
        }
    }
}

#[test]
fn discs_that_make_no_sense_are_refused() {
    let status = |kinds: &[RowKind]| {
        let n = kinds.len();
        let rows: Vec<Row> = (0..)
            .zip(kinds)
            .map(|(id, kind)| Row { id, kind: *kind })
            .collect();
        let mut w = vec![0.0; n * n];
        (0..n).for_each(|i| w[i * (n + 1)] = 1.0);
        let problem = Problem {
            rows: &rows,
            compliance: &w,
            delta_free: &vec![-1.0; n],
        };
        let (mut state, mut work) = (State::new(4), Workspace::new(4));
        solve(&problem, Method::ActiveSet, &mut state, &mut work).status
    };
    let disc = |limit_n| RowKind::Disc { limit_n };
    assert_eq!(status(&[disc(1.0)]), Status::Malformed);
    assert_eq!(status(&[disc(-1.0), RowKind::Tangent]), Status::Malformed);
    assert_eq!(
        status(&[disc(f64::NAN), RowKind::Tangent]),
        Status::NotFinite
    );
    assert_eq!(
        status(&[disc(1.0), RowKind::Tangent, RowKind::Tangent]),
        Status::Malformed
    );
    assert_eq!(status(&[disc(1.0), RowKind::Tangent]), Status::Ok);
}

/// How forces at the bound follow the pull: turned with it, no larger.
#[test]
fn the_tangent_of_a_slipping_disc_is_that_of_solves() {
    let w = [2.0, 0.3, 0.3, 1.5];
    let solved = |free: [f64; 2]| {
        let problem = Problem {
            rows: &rows(0.7),
            compliance: &w,
            delta_free: &free,
        };
        let (mut state, mut work) = (State::new(2), Workspace::new(2));
        solve(&problem, Method::ActiveSet, &mut state, &mut work);
        let jacobian = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let reduction = tangent(&problem, &state, &jacobian, &mut work).expect("its own state");
        ([state.lambda()[0], state.lambda()[1]], reduction)
    };
    let free = [-3.0, 2.0];
    let (_, reduction) = solved(free);
    for axis in 0..2 {
        let [ahead, behind] = [1e-6, -1e-6].map(|by| {
            let mut moved = free;
            moved[axis] += by;
            solved(moved).0
        });
        for row in 0..2 {
            let slope = (ahead[row] - behind[row]) / 2e-6;
            let found = reduction.tangent[row][axis];
            assert!((found - slope).abs() < 1e-7, "{found} is not {slope}");
        }
    }
}
