//! Row sets against a QP solver, against the law of friction, and by the hundred thousand.

#[path = "rows/sets.rs"]
mod sets;

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::NonnegativeConeT;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus};
use sets::{ALL, CONVEX, Draw, Random, Set, assert_admissible, draw};
use sutura_host::rows::{
    Method, Mode, Outcome, RowFlag, RowKind, State, Status, TOLERANCE, Workspace, gaps, residuals,
    solve,
};

const MOST: usize = 60;

/// Independent rows of one magnitude.
const PLAIN: Draw = Draw {
    most_rows: MOST,
    kinds: CONVEX,
    dependent: 0.0,
    conflicting: 0.0,
    softest: 1.0,
    friction: 1.0,
    magnitude: (-4.0, -2.0),
    spread: 0.0,
};

/// A cone has one solution while its friction is small (Alart & Curnier 1991).
const GENTLE: Draw = Draw {
    kinds: ALL,
    friction: 0.2,
    ..PLAIN
};

fn buffers() -> (State, Workspace) {
    (State::new(MOST + 2), Workspace::new(MOST + 2))
}

fn cold(set: &Set, method: Method) -> (Outcome, State, Workspace) {
    let (mut state, mut work) = buffers();
    let outcome = solve(&set.problem(), method, &mut state, &mut work);
    assert_admissible(set, &state);
    (outcome, state, work)
}

/// Sets drawn until `count` are not empty and have a force.
fn sets(seed: u64, count: usize, how: Draw) -> impl Iterator<Item = Set> {
    let mut random = Random(seed);
    std::iter::repeat_with(move || draw(&mut random, &how))
        .filter(|set| !set.rows.is_empty() && set.delta_free.iter().any(|free| *free != 0.0))
        .take(count)
}

/// Largest difference of forces, relative to the largest or to what the loads could call for.
fn difference(set: &Set, a: &[f64], b: &[f64]) -> f64 {
    let largest = |values: &[f64]| values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    let size = largest(b) + largest(&set.delta_free) / largest(&set.compliance);
    apart.fold(0.0, f64::max) / size
}

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

/// Forces and gaps from scratch, and the residual that [`solve`] reports.
fn assert_solved(set: &Set, outcome: &Outcome, state: &State) {
    let problem = set.problem();
    let mut delta = vec![0.0; set.rows.len()];
    gaps(&problem, state.lambda(), &mut delta);
    assert_eq!(delta, state.delta());
    let residual = residuals(&problem, state.lambda(), &delta).largest();
    assert!(residual <= TOLERANCE, "{residual}: {outcome:?}");
}

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
    let mut random = Random(4);
    let mut fewer = 0i64;
    for set in sets(4, 300, GENTLE) {
        let (mut state, mut work) = buffers();
        solve(&set.problem(), Method::ActiveSet, &mut state, &mut work);
        let (mut next, _) = set.permuted(&mut random);
        for free in &mut next.delta_free {
            *free *= 1.0 + 0.02 * random.sign();
        }
        let place = random.below(next.rows.len());
        next.rows[place].id = random.next();
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
    let mut random = Random(5);
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
    for (how, tolerance) in draws {
        for set in sets(5, 300, how) {
            let (_, state, _) = cold(&set, Method::ActiveSet);
            let (other, from) = set.permuted(&mut random);
            let (outcome, permuted, _) = cold(&other, Method::ActiveSet);
            assert!(matches!(outcome.status, Status::Ok | Status::Redundant));
            let expected: Vec<f64> = from.iter().map(|&row| state.lambda()[row]).collect();
            let off = difference(&other, permuted.lambda(), &expected);
            assert!(off < tolerance, "{off} with {} rows", set.rows.len());
        }
    }
}

/// Ends of random sets.
#[derive(Debug, Default)]
struct Tally {
    sets: usize,
    ok: usize,
    redundant: usize,
    incompatible: usize,
    not_converged: usize,
}

impl Tally {
    fn run(seed: u64, count: usize, how: &Draw) -> Self {
        let mut random = Random(seed);
        let (mut state, mut work) = buffers();
        let mut tally = Self::default();
        for index in 0..count {
            let set = draw(&mut random, how);
            if !random.chance(0.3) {
                state.clear();
            }
            let outcome = solve(&set.problem(), Method::ActiveSet, &mut state, &mut work);
            assert_admissible(&set, &state);
            assert!(outcome.residual.is_finite() && outcome.conflict_m.is_finite());
            tally.sets += 1;
            let compatible = || assert_solved(&set, &outcome, &state);
            match outcome.status {
                Status::Ok => {
                    compatible();
                    tally.ok += 1;
                }
                Status::Redundant => {
                    compatible();
                    assert!(set.dependent, "set {index} is independent");
                    assert!(work.flags().contains(&RowFlag::Redundant));
                    tally.redundant += 1;
                }
                Status::Incompatible => {
                    assert!(set.conflicting, "set {index} has no conflict");
                    assert!(outcome.conflict_m > 0.0);
                    tally.incompatible += 1;
                }
                Status::NotConverged => tally.not_converged += 1,
                refused => panic!("set {index}: {refused:?}"),
            }
        }
        tally
    }
}

/// 10^5 sets: one half without friction, and rows dependent and at odds far more often than a
/// simulation makes them.
#[test]
fn a_hundred_thousand_sets_are_solved_or_say_so() {
    let wild = Draw {
        dependent: 0.3,
        conflicting: 0.5,
        softest: 1e-4,
        magnitude: (-9.0, 3.0),
        spread: 6.0,
        ..PLAIN
    };
    let convex = Tally::run(6, 50_000, &wild);
    let cones = Tally::run(
        7,
        50_000,
        &Draw {
            kinds: ALL,
            friction: 1.5,
            ..wild
        },
    );
    println!("{convex:?}\n{cones:?}");
    assert_eq!(convex.not_converged, 0);
    assert!(
        convex.redundant > 3000 && convex.incompatible > 500,
        "{convex:?}"
    );
    assert!(
        cones.redundant > 3000 && cones.incompatible > 200,
        "{cones:?}"
    );
    // 1 in 1000 of all.
    assert!(cones.not_converged <= 100, "{cones:?}");
}
