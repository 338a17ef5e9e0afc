//! Sets with Coulomb cones and discs: semismooth Newton over open, sticking and slipping.
//!
//! Entry point: [`solve`]. With `q = x - r delta`, r the inverse of the diagonal, a solution is
//! `x = P(q)`, P the projection to bounds, half-lines and discs of radius `mu q_n` (Alart & Curnier
//! 1991). Newton's matrix is that of the active rows, with the law of [`Slip`] for slipping pairs:
//! unsymmetric, so LU. Steps are shortened until `|x - P(q)|` falls; where it does not, Gauss-Seidel
//! sweeps or a ramp of friction make the next start.

use super::bounded::{self, Dependent, Found, Iterate, Reduced};
use super::gauss_seidel;
use super::scaled::Law;
use super::slip::Slip;
use super::state::Mode;
use super::workspace::Active;
use crate::work;

/// Newton steps from one start.
const STEPS: u32 = 30;
/// Where Newton starts from, one after the other until it converges.
const STARTS: [Start; 6] = [
    Start::Sweeps(0),
    Start::Sweeps(5),
    Start::Ramp,
    Start::Sweeps(20),
    Start::Sweeps(80),
    Start::Sweeps(320),
];
/// Steps in which a ramp raises friction.
const RAMP: u32 = 8;
/// Merits to which a step may climb back: the map has kinks, which a strict descent sticks to.
const MEMORY: usize = 4;

/// A start for Newton.
#[derive(Clone, Copy, PartialEq)]
enum Start {
    /// The best forces so far after Gauss-Seidel sweeps.
    Sweeps(u32),
    /// Friction raised in steps from none, whose problem is always solved.
    Ramp,
}

/// Solves from the forces in `at.x`, which obeys all bounds and cones whether or not it converges.
/// Iterations are Newton steps and sweeps.
pub(super) fn solve(
    problem: &Reduced,
    at: &mut Iterate,
    best: &mut [f64],
    active: &mut Active,
) -> Result<Found, Dependent> {
    if problem.regular {
        independent(problem, active)?;
    }
    let mut iterations = 0;
    if at.x.iter().all(|x| *x == 0.0) {
        iterations += bounded::solve(problem, at, active)?.iterations;
    }
    let mut least = f64::INFINITY;
    let mut converged = false;
    best.copy_from_slice(at.x);
    for start in STARTS {
        if work::is_stopped() {
            break;
        }
        if start == Start::Ramp {
            iterations += ramp(problem, at, active)?;
        }
        gauss_seidel::project(problem.law, at.x);
        problem.gaps(at.x, at.delta);
        if let Start::Sweeps(sweeps) = start {
            for _ in 0..sweeps {
                if work::is_stopped() {
                    break;
                }
                gauss_seidel::sweep(problem, at.x, at.delta);
                iterations += 1;
            }
        }
        iterations += newton(problem, at, active);
        gauss_seidel::project(problem.law, at.x);
        problem.gaps(at.x, at.delta);
        let residual = natural_residual(problem.law, at.x, at.delta);
        if residual < least {
            least = residual;
            best.copy_from_slice(at.x);
        } else {
            // Sweeps have their own way to go: from the best so far.
            at.x.copy_from_slice(best);
        }
        converged = least <= 90.0 * problem.slack + 10.0 * problem.rounding(best);
        if converged {
            break;
        }
    }
    at.x.copy_from_slice(best);
    problem.gaps(at.x, at.delta);
    classify(problem, at);
    Ok(Found {
        iterations,
        converged,
    })
}

/// Solves without friction, then raises it.
fn ramp(problem: &Reduced, at: &mut Iterate, active: &mut Active) -> Result<u32, Dependent> {
    let mut iterations = bounded::solve(problem, at, active)?.iterations;
    let mut laws = std::mem::take(&mut active.laws);
    for step in 1..RAMP {
        let part = f64::from(step) / f64::from(RAMP);
        laws.clear();
        laws.extend(problem.law.iter().map(|law| match *law {
            Law::Normal { friction } => Law::Normal {
                friction: part * friction,
            },
            same => same,
        }));
        let eased = Reduced {
            law: &laws,
            ..*problem
        };
        gauss_seidel::project(&laws, at.x);
        eased.gaps(at.x, at.delta);
        iterations += newton(&eased, at, active);
    }
    active.laws = laws;
    Ok(iterations)
}

/// Whether all rows together are independent.
fn independent(problem: &Reduced, active: &mut Active) -> Result<(), Dependent> {
    let n = problem.n;
    active.matrix[..n * n].copy_from_slice(&problem.matrix[..n * n]);
    bounded::factor(active, n, true)
}

/// Newton steps from `at.x` and its gaps until the residual is rounding, or no step helps.
fn newton(problem: &Reduced, at: &mut Iterate, active: &mut Active) -> u32 {
    let mut merits = [f64::INFINITY; MEMORY];
    let mut smallest = f64::INFINITY;
    for step in 0..STEPS {
        if work::is_stopped() {
            return step;
        }
        let residual = natural_residual(problem.law, at.x, at.delta);
        let rounding = problem.rounding(at.x);
        if residual <= rounding || (residual <= 10.0 * rounding && residual >= smallest) {
            return step;
        }
        smallest = smallest.min(residual);
        classify(problem, at);
        linear_step(problem, at, active);
        problem.gaps(at.trial, &mut active.rhs[..problem.n]);
        let gaps = &active.rhs[..problem.n];
        merits[step as usize % MEMORY] = merit(problem, at, gaps, 0.0);
        let reference = merits
            .iter()
            .filter(|merit| merit.is_finite())
            .fold(0.0, |most: f64, merit| most.max(*merit));
        let mut part = 1.0;
        let found = loop {
            let merit = merit(problem, at, gaps, part);
            if merit < reference * (1.0 - 1e-4 * part) {
                break true;
            }
            part *= 0.5;
            if part < 1e-2 {
                break false;
            }
        };
        if !found {
            return step + 1;
        }
        for (x, trial) in at.x.iter_mut().zip(&*at.trial) {
            *x += part * (trial - *x);
        }
        for (delta, gap) in at.delta.iter_mut().zip(gaps) {
            *delta += part * (gap - *delta);
        }
    }
    STEPS
}

/// The solution of the set linearised in the modes of `at`, into `at.trial`.
fn linear_step(problem: &Reduced, at: &mut Iterate, active: &mut Active) {
    let n = problem.n;
    active.rows.clear();
    for (row, law) in problem.law.iter().enumerate() {
        let (low, high) = law.bounds();
        at.trial[row] = match at.modes[row] {
            Mode::Held | Mode::Slipping => {
                active.rows.push(row);
                0.0
            }
            Mode::AtUpper => high,
            Mode::AtLower => low,
        };
    }
    let k = active.rows.len();
    let rhs = &mut active.rhs[..k];
    for (rhs, &row) in rhs.iter_mut().zip(&active.rows) {
        *rhs = -problem.target[row];
    }
    for (column, &x) in problem.matrix.chunks_exact(n.max(1)).zip(&*at.trial) {
        if x != 0.0 {
            for (rhs, &row) in rhs.iter_mut().zip(&active.rows) {
                *rhs -= column[row] * x;
            }
        }
    }
    let matrix = &mut active.matrix[..k * k];
    for (out, &column) in matrix.chunks_exact_mut(k.max(1)).zip(&active.rows) {
        let column = &problem.matrix[column * n..(column + 1) * n];
        for (out, &row) in out.iter_mut().zip(&active.rows) {
            *out = column[row];
        }
    }
    let mut place = 0;
    while place < k {
        let row = active.rows[place];
        if at.modes[row] == Mode::Slipping {
            let slip = slip_at(problem, at, row);
            for column in matrix.chunks_exact_mut(k) {
                slip.replace(column, place);
            }
            slip.complete(matrix, k, place);
            slip.replace(rhs, place);
            slip.aim(rhs, place);
            place += 1;
        }
        place += 1;
    }
    active.lu.factor(matrix, k);
    active.lu.solve(matrix, k, rhs, 1);
    for (&row, &value) in active.rows.iter().zip(&*rhs) {
        at.trial[row] = value;
    }
}

/// Linearisation of the slipping pair whose first tangent is `row`.
fn slip_at(problem: &Reduced, at: &Iterate, row: usize) -> Slip {
    if let Law::Disc { radius } = problem.law[row] {
        let r = step_of_disc(problem, row);
        return Slip::disc(radius, [row, row + 1].map(|t| at.x[t] - r * at.delta[t]), r);
    }
    let before = row.checked_sub(1).map(|normal| problem.law[normal]);
    let Some(Law::Normal { friction }) = before else {
        return Slip::disc(0.0, [1.0, 0.0], 1.0);
    };
    let (normal, sideways) = steps(problem, row - 1);
    let q = [
        at.x[row - 1] - normal * at.delta[row - 1],
        at.x[row] - sideways * at.delta[row],
        at.x[row + 1] - sideways * at.delta[row + 1],
    ];
    Slip::new(friction, q, sideways)
}

/// r of a disc's rows.
fn step_of_disc(problem: &Reduced, row: usize) -> f64 {
    2.0 / (own(problem, row) + own(problem, row + 1))
}

/// r of a cone's normal and tangents.
fn steps(problem: &Reduced, row: usize) -> (f64, f64) {
    let sideways = own(problem, row + 1) + own(problem, row + 2);
    (own(problem, row).recip(), 2.0 / sideways)
}

/// The row's own compliance.
fn own(problem: &Reduced, row: usize) -> f64 {
    problem.matrix[row * (problem.n + 1)].max(bounded::PIVOT)
}

/// Calls `with` with every entry of `x - P(x - r delta)` and its r, which `steps_of` gives for a row, or
/// for a normal and its tangents, or for a disc.
fn natural_map(
    laws: &[Law],
    steps_of: impl Fn(usize, Law) -> (f64, f64),
    at: impl Fn(usize) -> (f64, f64),
    mut with: impl FnMut(f64, f64),
) {
    for (row, law) in laws.iter().enumerate() {
        match *law {
            Law::Between { low, high } if low < high => {
                let (x, gap) = at(row);
                let (r, _) = steps_of(row, *law);
                with(x - (x - r * gap).max(low).min(high), r);
            }
            Law::Normal { friction } => {
                let (r, sideways) = steps_of(row, *law);
                let [(x, gap), first, second] = [row, row + 1, row + 2].map(&at);
                let q = (x - r * gap).max(0.0);
                with(x - q, r);
                for off in off_disc([first, second], sideways, friction * q) {
                    with(off, sideways);
                }
            }
            Law::Disc { radius } => {
                let (r, _) = steps_of(row, *law);
                for off in off_disc([row, row + 1].map(&at), r, radius) {
                    with(off, r);
                }
            }
            Law::Between { .. } | Law::Tangent => {}
        }
    }
}

/// `x - P(x - r delta)` of a pair of rows, P the projection to a disc.
fn off_disc(pair: [(f64, f64); 2], r: f64, radius: f64) -> [f64; 2] {
    let aim = pair.map(|(x, gap)| x - r * gap);
    let length = aim[0].hypot(aim[1]);
    let part = if length > radius {
        radius / length
    } else {
        1.0
    };
    [pair[0].0 - part * aim[0], pair[1].0 - part * aim[1]]
}

/// Largest entry of the natural map with r = 1, as [`super::residuals`] measures it.
pub(super) fn natural_residual(laws: &[Law], x: &[f64], delta: &[f64]) -> f64 {
    let mut most = 0.0;
    natural_map(
        laws,
        |_, _| (1.0, 1.0),
        |row| (x[row], delta[row]),
        |off, _| most = if off.abs() <= most { most } else { off.abs() },
    );
    most
}

/// Sum of the map's squares, as energies, at `part` of the way from `at.x` to `at.trial` with `gaps`.
fn merit(problem: &Reduced, at: &Iterate, gaps: &[f64], part: f64) -> f64 {
    let mut sum = 0.0;
    let between = |from: f64, to: f64| from + part * (to - from);
    natural_map(
        problem.law,
        |row, law| match law {
            Law::Normal { .. } => steps(problem, row),
            Law::Disc { .. } => (step_of_disc(problem, row), 1.0),
            Law::Between { .. } | Law::Tangent => (own(problem, row).recip(), 1.0),
        },
        |row| {
            (
                between(at.x[row], at.trial[row]),
                between(at.delta[row], gaps[row]),
            )
        },
        |off, r| sum += off * off / r,
    );
    sum
}

/// Modes at the present forces and gaps.
pub(super) fn classify(problem: &Reduced, at: &mut Iterate) {
    for (row, law) in problem.law.iter().enumerate() {
        match *law {
            Law::Between { low, high } => {
                let q = at.x[row] - at.delta[row] / own(problem, row);
                at.modes[row] = if low == high || q < low {
                    Mode::AtLower
                } else if q > high {
                    Mode::AtUpper
                } else {
                    Mode::Held
                };
            }
            Law::Normal { friction } => {
                let (normal, sideways) = steps(problem, row);
                let q = at.x[row] - normal * at.delta[row];
                let aim = [row + 1, row + 2].map(|t| at.x[t] - sideways * at.delta[t]);
                let (own, pair) = if q <= 0.0 {
                    (Mode::AtLower, Mode::AtLower)
                } else if aim[0].hypot(aim[1]) <= friction * q {
                    (Mode::Held, Mode::Held)
                } else {
                    (Mode::Held, Mode::Slipping)
                };
                at.modes[row] = own;
                at.modes[row + 1..row + 3].fill(pair);
            }
            Law::Disc { radius } => {
                let r = step_of_disc(problem, row);
                let aim = [row, row + 1].map(|t| at.x[t] - r * at.delta[t]);
                let sticks = aim[0].hypot(aim[1]) <= radius;
                let mode = if sticks { Mode::Held } else { Mode::Slipping };
                at.modes[row..row + 2].fill(mode);
            }
            Law::Tangent => {}
        }
    }
}
