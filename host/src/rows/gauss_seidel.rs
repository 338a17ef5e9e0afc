//! Projected Gauss-Seidel: one row, or one cone, at a time.
//!
//! Entry points: [`solve`], [`sweep`]. Jourdan, Alart & Jean 1998 for cones, each solved by itself in
//! [`super::coulomb`].

use super::bounded::{Iterate, Reduced};
use super::cone::{classify, natural_residual};
use super::scaled::Law;
use super::workspace::{Finish, Workspace};
use super::{Problem, active_set, coulomb};
use crate::work;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// At most `sweeps` sweeps over the whole problem, from the warm forces.
pub(super) fn solve(
    problem: &Problem,
    sweeps: u32,
    tolerance: f64,
    work: &mut Workspace,
) -> Finish {
    let n = problem.rows.len();
    let (scaled, vectors) = (&work.scaled, &mut work.vectors);
    scaled.block(problem, 0..n, 0..n, &mut work.schur[..n * n]);
    vectors.shift[..n].fill(0.0);
    for (at, &row) in scaled.order.iter().enumerate() {
        let known = work.warm.rows[row].map_or(0.0, |(lambda, _)| lambda);
        vectors.lambda[at] = known / scaled.scale[at];
    }
    let reduced = Reduced {
        n,
        matrix: &work.schur[..n * n],
        target: &scaled.target,
        law: &scaled.law,
        slack: 0.0,
        regular: true,
    };
    let mut iterate = Iterate {
        modes: &mut vectors.modes[..n],
        x: &mut vectors.lambda[..n],
        delta: &mut vectors.delta[..n],
        trial: &mut vectors.trial[..n],
    };
    project(&scaled.law, iterate.x);
    reduced.gaps(iterate.x, iterate.delta);
    let mut iterations = 0;
    while iterations < sweeps && !work::is_stopped() {
        sweep(&reduced, iterate.x, iterate.delta);
        iterations += 1;
        let strongest = iterate.x.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let scale = scaled.drive + 1e-6 * strongest;
        if natural_residual(&scaled.law, iterate.x, iterate.delta) <= tolerance * scale {
            break;
        }
    }
    classify(&reduced, &mut iterate);
    active_set::flag_empty(problem, work);
    Finish { iterations }
}

/// The nearest forces that the rows allow; forces that are no numbers become zero.
pub(super) fn project(laws: &[Law], x: &mut [f64]) {
    let mut radius = 0.0;
    let mut row = 0;
    while row < laws.len() {
        if !x[row].is_finite() {
            x[row] = 0.0;
        }
        match laws[row] {
            Law::Between { low, high } => x[row] = x[row].max(low).min(high),
            Law::Normal { friction } => {
                x[row] = x[row].max(0.0);
                radius = friction * x[row];
            }
            Law::Tangent => {
                into_disc(&mut x[row..row + 2], radius);
                row += 1;
            }
            Law::Disc { radius } => {
                into_disc(&mut x[row..row + 2], radius);
                row += 1;
            }
        }
        row += 1;
    }
}

/// The nearest pair of forces in a disc.
fn into_disc(pair: &mut [f64], radius: f64) {
    let length = pair[0].hypot(pair[1]);
    if !length.is_finite() {
        pair.fill(0.0);
    } else if length > radius {
        let part = radius / length;
        pair.iter_mut().for_each(|x| *x *= part);
    }
}

/// One sweep; `delta` follows `x`.
pub(super) fn sweep(problem: &Reduced, x: &mut [f64], delta: &mut [f64]) {
    let n = problem.n;
    let change = |row: usize, step: f64, delta: &mut [f64]| {
        if step != 0.0 {
            let column = &problem.matrix[row * n..(row + 1) * n];
            for (delta, s) in delta.iter_mut().zip(column) {
                *delta += s * step;
            }
        }
    };
    for row in 0..n {
        match problem.law[row] {
            Law::Between { low, high } if low < high => {
                let own = problem.matrix[row * (n + 1)];
                let next = (x[row] - delta[row] / own).max(low).min(high);
                if next.is_finite() {
                    change(row, next - x[row], delta);
                    x[row] = next;
                }
            }
            Law::Normal { friction } => {
                let a = Matrix3::from_fn(|i, j| problem.matrix[(row + j) * n + row + i]);
                let last = Vector3::new(x[row], x[row + 1], x[row + 2]);
                let gap = Vector3::new(delta[row], delta[row + 1], delta[row + 2]);
                let next = coulomb::solve(&a, &(gap - a * last), friction, &last);
                if next.iter().all(|x| x.is_finite()) {
                    for axis in 0..3 {
                        change(row + axis, next[axis] - last[axis], delta);
                        x[row + axis] = next[axis];
                    }
                }
            }
            Law::Disc { radius } => {
                let a = Matrix2::from_fn(|i, j| problem.matrix[(row + j) * n + row + i]);
                let last = Vector2::new(x[row], x[row + 1]);
                let gap = Vector2::new(delta[row], delta[row + 1]);
                let next = coulomb::solve_disc(&a, &(gap - a * last), radius);
                if next.iter().all(|x| x.is_finite()) {
                    for axis in 0..2 {
                        change(row + axis, next[axis] - last[axis], delta);
                        x[row + axis] = next[axis];
                    }
                }
            }
            Law::Between { .. } | Law::Tangent => {}
        }
    }
}
