//! The exact method: equality rows eliminated, the others searched, dependent rows dealt with.
//!
//! Entry point: [`solve`]. See the header of [`super`] for the mathematics.

use super::bounded::{self, Dependent, Found, Iterate, PIVOT, Reduced};
use super::cone;
use super::residual::gaps;
use super::scaled::{Law, Scaled};
use super::state::Mode;
use super::workspace::{Finish, RowFlag, Vectors, Workspace};
use super::{Problem, RowKind, TOLERANCE};
use sutura_factor::{solve_lower, solve_lower_transposed, subtract_product};

/// Added to the unit diagonal of dependent rows: half the digits for the solution, half for what
/// makes it unique.
pub(super) const EPSILON: f64 = 1e-8;
/// Proximal steps: each gains the factor epsilon over an eigenvalue of W~.
const PROXIMAL_STEPS: u32 = 8;
/// Searches among cones that may fail before a dependent set is given up.
const MOST_FAILURES: u32 = 3;
/// Rounds of proximal steps: the first finds the conflict, the second forces without it.
const ROUNDS: u32 = 2;

/// Solves the problem that `work.scaled` was prepared from.
pub(super) fn solve(problem: &Problem, work: &mut Workspace) -> Finish {
    let n = work.scaled.n;
    work.vectors.shift[..n].fill(0.0);
    if work.scaled.drive == 0.0 {
        // Nothing acts: no forces, whatever W.
        work.vectors.lambda[..n].fill(0.0);
        flag_empty(problem, work);
        settle(work);
        return Finish { iterations: 0 };
    }
    start(work);
    work.vectors.centre[..n].fill(0.0);
    if reduce(problem, work, 0.0).is_ok()
        && let Ok(found) = search(work, true)
    {
        let Found {
            iterations,
            converged,
        } = found;
        work.is_factored = converged && !work.scaled.cones;
        flag_empty(problem, work);
        return Finish { iterations };
    }
    let iterations = dependent(problem, work);
    flag_empty(problem, work);
    Finish { iterations }
}

/// Modes and forces to start from: what the state remembers, else the sign of the target.
fn start(work: &mut Workspace) {
    let (scaled, vectors) = (&work.scaled, &mut work.vectors);
    for (at, &row) in scaled.order.iter().enumerate() {
        let cold = match scaled.law[at] {
            Law::Between { low, .. } if low == 0.0 && scaled.target[at] >= 0.0 => Mode::AtLower,
            _ => Mode::Held,
        };
        let (lambda, mode) = work.warm.rows[row].unwrap_or((0.0, cold));
        vectors.lambda[at] = lambda / scaled.scale[at];
        vectors.modes[at] = mode;
    }
}

/// Modes of rows that carry no force.
fn settle(work: &mut Workspace) {
    let (scaled, vectors) = (&work.scaled, &mut work.vectors);
    let mut before = Law::NONE;
    for (mode, law) in vectors.modes.iter_mut().zip(&scaled.law) {
        *mode = match (law, before) {
            (Law::Between { low, high }, _) if *low < 0.0 && *high > 0.0 => Mode::Held,
            (Law::Disc { .. }, _) | (Law::Tangent, Law::Disc { .. }) => Mode::Held,
            _ => Mode::AtLower,
        };
        before = *law;
    }
}

/// Factors the equality rows of `W~ + epsilon` and condenses the others on them.
fn reduce(problem: &Problem, work: &mut Workspace, epsilon: f64) -> Result<(), Dependent> {
    let scaled = &work.scaled;
    let (n, e) = (scaled.n, scaled.equalities);
    let m = n - e;
    let equality = &mut work.equality[..e * e];
    scaled.lower_block(problem, 0..e, equality);
    equality
        .iter_mut()
        .step_by(e + 1)
        .for_each(|diagonal| *diagonal += epsilon);
    work.active
        .dense
        .factor(equality, e)
        .map_err(|_| Dependent)?;
    if epsilon == 0.0 && bounded::smallest_pivot(equality, e) < PIVOT {
        return Err(Dependent);
    }
    if m == 0 {
        return Ok(());
    }
    let schur = &mut work.schur[..m * m];
    scaled.block(problem, e..n, e..n, schur);
    schur
        .iter_mut()
        .step_by(m + 1)
        .for_each(|diagonal| *diagonal += epsilon);
    if e > 0 {
        let cross = &mut work.cross[..e * m];
        scaled.block(problem, 0..e, e..n, cross);
        solve_lower(equality, e, cross, m);
        subtract_product(cross, cross, schur, (e, m, m));
    }
    Ok(())
}

/// Right-hand side of the condensed rows, for shifted targets and the proximal centre.
fn condense_targets(scaled: &Scaled, epsilon: f64, factor: &[f64], cross: &[f64], v: &mut Vectors) {
    let (n, e) = (scaled.n, scaled.equalities);
    for at in 0..n {
        let target = scaled.target[at] + v.shift[at] - epsilon * v.centre[at];
        if at < e {
            v.equality[at] = target;
        } else {
            v.condensed[at - e] = target;
        }
    }
    if e == 0 {
        return;
    }
    solve_lower(factor, e, &mut v.equality[..e], 1);
    for (target, column) in v.condensed[..n - e].iter_mut().zip(cross.chunks_exact(e)) {
        *target -= dot(column, &v.equality[..e]);
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Forces of all rows for the matrices of [`reduce`].
fn search(work: &mut Workspace, regular: bool) -> Result<Found, Dependent> {
    let scaled = &work.scaled;
    let (n, e) = (scaled.n, scaled.equalities);
    let m = n - e;
    let epsilon = if regular { 0.0 } else { EPSILON };
    let factor = &work.equality[..e * e];
    let cross = &work.cross[..e * m];
    let v = &mut work.vectors;
    work.active.rows.clear();
    condense_targets(scaled, epsilon, factor, cross, v);
    let mut found = Found {
        iterations: 1,
        converged: true,
    };
    if m > 0 {
        let reduced = Reduced {
            n: m,
            matrix: &work.schur[..m * m],
            target: &v.condensed[..m],
            law: &scaled.law[e..],
            slack: 1e-3 * TOLERANCE * scaled.drive,
            regular,
        };
        let mut iterate = Iterate {
            modes: &mut v.modes[e..n],
            x: &mut v.lambda[e..n],
            delta: &mut v.delta[..m],
            trial: &mut v.trial[..m],
        };
        found = if scaled.cones {
            cone::solve(&reduced, &mut iterate, &mut v.best[..m], &mut work.active)?
        } else {
            bounded::solve(&reduced, &mut iterate, &mut work.active)?
        };
    }
    if e > 0 {
        v.modes[..e].fill(Mode::Held);
        let (equality, others) = v.lambda[..n].split_at_mut(e);
        equality.copy_from_slice(&v.equality[..e]);
        for (column, &x) in cross.chunks_exact(e).zip(&*others) {
            if x != 0.0 {
                for (equality, c) in equality.iter_mut().zip(column) {
                    *equality += c * x;
                }
            }
        }
        equality.iter_mut().for_each(|lambda| *lambda = -*lambda);
        solve_lower_transposed(factor, e, equality, 1);
    }
    Ok(found)
}

/// Dependent rows: proximal steps on `W~ + epsilon`, targets shifted where they contradict.
fn dependent(problem: &Problem, work: &mut Workspace) -> u32 {
    let n = work.scaled.n;
    let mut iterations = 0;
    if reduce(problem, work, EPSILON).is_err() {
        work.vectors.lambda[..n].fill(0.0);
        return 0;
    }
    let mut failures = 0;
    'rounds: for _ in 0..ROUNDS {
        start(work);
        let mut before = f64::INFINITY;
        for step in 0..PROXIMAL_STEPS {
            let v = &mut work.vectors;
            if step == 0 {
                v.centre[..n].fill(0.0);
            } else {
                v.centre[..n].copy_from_slice(&v.lambda[..n]);
            }
            let Ok(found) = search(work, false) else {
                break 'rounds;
            };
            iterations += found.iterations;
            // One may still lead to the next step's solution; a failed search is expensive.
            failures += u32::from(!found.converged);
            if failures > MOST_FAILURES {
                break 'rounds;
            }
            let residual = scaled_residual(problem, work);
            if residual <= 0.1 * TOLERANCE {
                break 'rounds;
            }
            if residual > 0.5 * before {
                break;
            }
            before = residual;
        }
        // What the last step did not gain is a conflict. The forces are exact for targets without it,
        // but in the first round they are as large as the regularisation lets them be.
        let v = &mut work.vectors;
        for at in 0..n {
            v.shift[at] += EPSILON * (v.lambda[at] - v.centre[at]);
        }
    }
    flag_dependent(problem, work);
    iterations
}

/// Natural residual of all rows with W~ itself and the shifted targets, on the scale of the set.
fn scaled_residual(problem: &Problem, work: &mut Workspace) -> f64 {
    let (scaled, v) = (&work.scaled, &mut work.vectors);
    let n = scaled.n;
    let mut strongest = 0.0f64;
    for (at, &row) in scaled.order.iter().enumerate() {
        v.trial[row] = v.lambda[at] * scaled.scale[at];
        strongest = strongest.max(v.lambda[at].abs());
    }
    gaps(problem, &v.trial[..n], &mut v.trial_delta[..n]);
    for (at, &row) in scaled.order.iter().enumerate() {
        v.best[at] = v.trial_delta[row] * scaled.scale[at] + v.shift[at];
    }
    cone::natural_residual(&scaled.law, &v.lambda[..n], &v.best[..n])
        / (scaled.drive + 1e-6 * strongest)
}

/// Flags active rows that depend on active rows before them, and rows whose targets were shifted.
fn flag_dependent(problem: &Problem, work: &mut Workspace) {
    let (scaled, v, active) = (&work.scaled, &work.vectors, &mut work.active);
    active.rows.clear();
    let held = |at: &usize| v.modes[*at] == Mode::Held && scaled.law[*at] != Law::NONE;
    active.rows.extend((0..scaled.n).filter(held));
    // In the problem's order: of two equal rows the later one is redundant.
    active.rows.sort_unstable_by_key(|&at| scaled.order[at]);
    let k = active.rows.len();
    for (column, &j) in active.matrix.chunks_exact_mut(k.max(1)).zip(&active.rows) {
        for (entry, &i) in column.iter_mut().zip(&active.rows) {
            let w = problem.compliance[scaled.order[j] * scaled.n + scaled.order[i]];
            *entry = scaled.scale[j] * w * scaled.scale[i];
        }
    }
    let (flags, rows) = (&mut work.flags, &active.rows);
    dependent_pivots(&mut active.matrix[..k * k], k, |at| {
        flags[scaled.order[rows[at]]] = RowFlag::Redundant;
    });
    let largest = v.shift[..scaled.n]
        .iter()
        .fold(0.0f64, |most, shift| most.max(shift.abs()));
    if largest > 0.1 * TOLERANCE * scaled.drive {
        for (&row, shift) in scaled.order.iter().zip(&v.shift) {
            if shift.abs() > 1e-3 * largest {
                flags[row] = RowFlag::Incompatible;
            }
        }
    }
}

/// Cholesky without the rows whose pivot vanishes, in place on `a` (k x k); calls `found` with each.
fn dependent_pivots(a: &mut [f64], k: usize, mut found: impl FnMut(usize)) {
    for j in 0..k {
        let (before, rest) = a.split_at_mut((j + 1) * k);
        let column = &mut before[j * k..];
        if column[j] <= PIVOT {
            found(j);
            continue;
        }
        let pivot = column[j].sqrt().recip();
        column[j..].iter_mut().for_each(|entry| *entry *= pivot);
        for (c, later) in rest.chunks_exact_mut(k).enumerate() {
            let factor = column[j + 1 + c];
            for (later, own) in later[j + 1 + c..].iter_mut().zip(&column[j + 1 + c..]) {
                *later -= factor * own;
            }
        }
    }
}

/// Flags rows that nothing can act on; what they miss of their target counts as shifted.
pub(super) fn flag_empty(problem: &Problem, work: &mut Workspace) {
    let (scaled, shift) = (&work.scaled, &mut work.vectors.shift);
    for (at, &row) in scaled.order.iter().enumerate() {
        if problem.compliance[row * (scaled.n + 1)] >= f64::MIN_POSITIVE {
            continue;
        }
        let target = scaled.target[at];
        let missed = match problem.rows[row].kind {
            RowKind::Equality | RowKind::Box { .. } | RowKind::Between { .. } => target,
            RowKind::Inequality | RowKind::Normal { .. } => target.min(0.0),
            RowKind::Tangent | RowKind::Disc { .. } => 0.0,
        };
        shift[at] = -missed;
        work.flags[row] = if missed == 0.0 {
            RowFlag::Redundant
        } else {
            RowFlag::Incompatible
        };
    }
}
