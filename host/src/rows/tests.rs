//! Small sets with answers by hand.

use super::*;

fn row(id: u64, kind: RowKind) -> Row {
    Row { id, kind }
}

fn solved(rows: &[Row], compliance: &[f64], delta_free: &[f64]) -> (Outcome, State, Workspace) {
    let problem = Problem {
        rows,
        compliance,
        delta_free,
    };
    let (mut state, mut work) = (State::new(8), Workspace::new(8));
    let outcome = solve(&problem, Method::ActiveSet, &mut state, &mut work);
    (outcome, state, work)
}

/// Every branch of the law of one row on W = 2 m/N: sign convention included.
#[test]
fn one_row_obeys_its_law() {
    let limited = RowKind::Box { limit_n: 0.25 };
    let between = RowKind::Between {
        least_n: -0.125,
        most_n: 0.375,
    };
    let cases = [
        (RowKind::Equality, 1.0, -0.5, 0.0),
        (RowKind::Equality, -1.0, 0.5, 0.0),
        (RowKind::Inequality, -1.0, 0.5, 0.0),
        (RowKind::Inequality, 1.0, 0.0, 1.0),
        (limited, 0.1, -0.05, 0.0),
        (limited, 1.0, -0.25, 0.5),
        (limited, -1.0, 0.25, -0.5),
        (between, 0.1, -0.05, 0.0),
        (between, 1.0, -0.125, 0.75),
        (between, -0.5, 0.25, 0.0),
        (between, -1.0, 0.375, -0.25),
    ];
    for (kind, free, lambda, delta) in cases {
        let (outcome, state, _) = solved(&[row(1, kind)], &[2.0], &[free]);
        assert_eq!(outcome.status, Status::Ok, "{kind:?} {free}");
        assert!(
            (state.lambda()[0] - lambda).abs() < 1e-15,
            "{kind:?} {free}"
        );
        assert!((state.delta()[0] - delta).abs() < 1e-15, "{kind:?} {free}");
    }
}

/// Pressed by 1 N and pulled sideways: held below mu lambda_n, else slipping against the pull.
#[test]
fn a_cone_sticks_opens_and_slips_against_the_slide() {
    let rows = [
        row(1, RowKind::Normal { friction: 0.5 }),
        row(2, RowKind::Tangent),
        row(3, RowKind::Tangent),
    ];
    let w = [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0];
    let sticks = solved(&rows, &w, &[-1.0, 0.4, -0.6]).1;
    assert_eq!(sticks.modes(), [Mode::Held; 3]);
    assert!((sticks.lambda()[1] + 0.2).abs() < 1e-15 && (sticks.lambda()[2] - 0.3).abs() < 1e-15);

    let (outcome, slips, _) = solved(&rows, &w, &[-1.0, 3.0, -4.0]);
    assert_eq!(slips.modes()[1..], [Mode::Slipping; 2]);
    assert_eq!((outcome.active, outcome.slipping), (1, 2));
    // 0.5 N along (-3, 4) / 5: against delta_t = (3, -4) - 2 * 0.5 (3, -4) / 5.
    assert!((slips.lambda()[1] + 0.3).abs() < 1e-12 && (slips.lambda()[2] - 0.4).abs() < 1e-12);
    assert!((slips.delta()[1] - 2.4).abs() < 1e-12 && (slips.delta()[2] + 3.2).abs() < 1e-12);

    let open = solved(&rows, &w, &[1.0, 3.0, -4.0]).1;
    assert_eq!(open.lambda(), [0.0; 3]);
}

#[test]
fn copies_of_a_row_share_its_force() {
    let rows = [row(1, RowKind::Equality), row(2, RowKind::Equality)];
    let (outcome, state, work) = solved(&rows, &[2.0; 4], &[-1.0, -1.0]);
    assert_eq!(outcome.status, Status::Redundant);
    assert_eq!(work.flags(), [RowFlag::None, RowFlag::Redundant]);
    assert!(outcome.residual <= TOLERANCE && outcome.conflict_m == 0.0);
    for lambda in state.lambda() {
        assert!((lambda - 0.25).abs() < 1e-7);
    }
}

/// Two targets for one place: the middle, and forces of that order.
#[test]
fn contradicting_rows_meet_in_the_middle() {
    let rows = [row(1, RowKind::Equality), row(2, RowKind::Equality)];
    let (outcome, state, work) = solved(&rows, &[2.0; 4], &[-1.0, -2.0]);
    assert_eq!(outcome.status, Status::Incompatible);
    assert_eq!(work.flags(), [RowFlag::Incompatible; 2]);
    assert!((outcome.conflict_m - 0.5).abs() < 1e-6);
    let total: f64 = state.lambda().iter().sum();
    assert!((total - 0.75).abs() < 1e-6, "{:?}", state.lambda());
    assert!(state.lambda().iter().all(|lambda| lambda.abs() < 10.0));
}

#[test]
fn rows_that_nothing_can_act_on_are_flagged() {
    let rows = [
        row(1, RowKind::Equality),
        row(2, RowKind::Equality),
        row(3, RowKind::Inequality),
    ];
    let w = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    let (outcome, state, work) = solved(&rows, &w, &[0.1, -1.0, 2.0]);
    assert_eq!(outcome.status, Status::Incompatible);
    assert!((outcome.conflict_m - 0.1).abs() < 1e-15);
    assert_eq!(
        work.flags(),
        [RowFlag::Incompatible, RowFlag::None, RowFlag::Redundant]
    );
    assert_eq!(state.lambda(), [0.0, 1.0, 0.0]);
}

#[test]
fn bad_input_gives_a_status_and_no_force() {
    let one = |kind, w, free| {
        let (outcome, state, _) = solved(&[row(1, kind)], &[w], &[free]);
        assert_eq!(state.lambda(), [0.0]);
        outcome.status
    };
    let equality = RowKind::Equality;
    assert_eq!(one(equality, f64::NAN, 1.0), Status::NotFinite);
    assert_eq!(one(equality, f64::INFINITY, 1.0), Status::NotFinite);
    assert_eq!(one(equality, 1.0, f64::NAN), Status::NotFinite);
    assert_eq!(one(equality, -1.0, 1.0), Status::Malformed);
    assert_eq!(one(RowKind::Tangent, 1.0, 1.0), Status::Malformed);
    assert_eq!(
        one(RowKind::Normal { friction: 0.1 }, 1.0, 1.0),
        Status::Malformed
    );
    assert_eq!(
        one(RowKind::Box { limit_n: -1.0 }, 1.0, 1.0),
        Status::Malformed
    );
    assert_eq!(
        one(RowKind::Box { limit_n: f64::NAN }, 1.0, 1.0),
        Status::NotFinite
    );
    for (least_n, most_n, status) in [
        (0.5, 1.0, Status::Malformed),
        (-1.0, -0.5, Status::Malformed),
        (f64::NAN, 1.0, Status::NotFinite),
    ] {
        let kind = RowKind::Between { least_n, most_n };
        assert_eq!(one(kind, 1.0, 1.0), status);
    }

    let cone = |friction| {
        [
            row(1, RowKind::Normal { friction }),
            row(2, RowKind::Tangent),
            row(3, RowKind::Tangent),
        ]
    };
    let w = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let status = |friction| solved(&cone(friction), &w, &[-1.0; 3]).0.status;
    assert_eq!(status(-0.1), Status::Malformed);
    assert_eq!(status(f64::NAN), Status::NotFinite);
    assert_eq!(status(f64::INFINITY), Status::NotFinite);

    // Not semidefinite, lengths that do not match, too many rows.
    let two = [row(1, equality), row(2, equality)];
    assert_eq!(
        solved(&two, &[1.0, 2.0, 2.0, 1.0], &[1.0; 2]).0.status,
        Status::Malformed
    );
    assert_eq!(
        solved(&two, &[1.0; 3], &[1.0; 2]).0.status,
        Status::Malformed
    );
    let nine = [row(1, equality); 9];
    let (outcome, state, _) = solved(&nine, &[1.0; 81], &[1.0; 9]);
    assert_eq!(outcome.status, Status::TooManyRows);
    assert!(state.lambda().is_empty());
}

#[test]
fn no_rows_are_solved() {
    let (outcome, state, _) = solved(&[], &[], &[]);
    assert_eq!((outcome.status, outcome.residual), (Status::Ok, 0.0));
    assert!(state.lambda().is_empty());
}

/// Forces follow ids when rows move; a Gauss-Seidel of no sweeps shows what a solve starts from.
#[test]
fn a_warm_start_follows_ids() {
    let ids = |ids: [u64; 3]| ids.map(|id| row(id, RowKind::Equality));
    let w = [2.0, 0.5, 0.1, 0.5, 2.0, 0.3, 0.1, 0.3, 2.0];
    let (mut state, mut work) = (State::new(3), Workspace::new(3));
    let mut forces = |rows: &[Row], method| {
        let problem = Problem {
            rows,
            compliance: &w,
            delta_free: &[-1.0, -2.0, 3.0],
        };
        solve(&problem, method, &mut state, &mut work);
        state.lambda().to_vec()
    };
    let before = forces(&ids([7, 8, 9]), Method::ActiveSet);
    let none = Method::GaussSeidel {
        sweeps: 0,
        tolerance: 0.0,
    };
    let after = forces(&ids([9, 4, 7]), none);
    assert_eq!(after[1], 0.0);
    for (after, before) in [(after[0], before[2]), (after[2], before[0])] {
        assert!((after - before).abs() < 1e-15);
    }
}

/// A tool that holds one place by two equal rows feels it once.
#[test]
fn copies_of_a_row_do_not_stiffen_the_tangent() {
    let one = [row(1, RowKind::Equality)];
    let two = [row(1, RowKind::Equality), row(2, RowKind::Equality)];
    let j: Vec<f64> = (1..=6).map(f64::from).collect();
    let twice: Vec<f64> = j.iter().flat_map(|j| [*j, *j]).collect();
    let entries = [(&one[..], &j), (&two[..], &twice)].map(|(rows, j)| {
        let n = rows.len();
        let problem = Problem {
            rows,
            compliance: &[2.0; 4][..n * n],
            delta_free: &[-1.0; 2][..n],
        };
        let (mut state, mut work) = (State::new(2), Workspace::new(2));
        solve(&problem, Method::ActiveSet, &mut state, &mut work);
        tangent(&problem, &state, j, &mut work).expect("its own state")
    });
    for (i, (a, b)) in entries[0]
        .tangent
        .iter()
        .zip(&entries[1].tangent)
        .enumerate()
    {
        for (k, (a, b)) in a.iter().zip(b).enumerate() {
            // -J' W^-1 J by hand.
            let expected = -(j[i] * j[k]) / 2.0;
            assert!((a - expected).abs() < 1e-12 && (b - expected).abs() < 1e-6 * expected.abs());
        }
    }
}
