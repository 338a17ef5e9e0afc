//! Row sets against a QP solver, against the law of friction, against their own derivatives, and by
//! the hundred thousand.

mod discs;
mod laws;
mod oracle;
mod random;
mod reduction;
mod sets;

use sets::{ALL, CONVEX, Draw, Set, assert_admissible, draw};
use sutura_host::rows::{Method, Outcome, State, TOLERANCE, Workspace, gaps, residuals, solve};
use sutura_testkit::Random;

const MOST: usize = 60;

/// Independent rows of one magnitude.
const PLAIN: Draw = Draw {
    most_rows: MOST,
    kinds: CONVEX,
    dependent: 0.0,
    nearly: 0.0,
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
    let mut random = Random::new(seed);
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

/// Forces and gaps from scratch, and the residual that [`solve`] reports.
fn assert_solved(set: &Set, outcome: &Outcome, state: &State) {
    let problem = set.problem();
    let mut delta = vec![0.0; set.rows.len()];
    gaps(&problem, state.lambda(), &mut delta);
    assert_eq!(delta, state.delta());
    let residual = residuals(&problem, state.lambda(), &delta).largest();
    assert!(residual <= TOLERANCE, "{residual}: {outcome:?}");
}
