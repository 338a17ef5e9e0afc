//! How far forces are from solving their rows.
//!
//! Entry points: [`gaps`], [`residuals`]. In scaled rows (module [`super`]) a row's residual is that
//! of its natural map, `|lambda~ - P(lambda~ - delta~)|` with P the projection to what lambda~ may
//! be: zero exactly at solutions (Facchinei & Pang 2003, 1.5.8; for cones De Saxce's bipotential
//! without its coupling term, so P is the disc of radius `friction lambda_n`).

use super::scaled::check_kinds;
use super::{Problem, RowKind};

/// Largest scaled residual of every kind of row, as part of the scale of the set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residuals {
    /// |delta~| of equality rows.
    pub equality: f64,
    /// |min(lambda~, delta~)| of inequality and normal rows, its like for boxes.
    pub complementarity: f64,
    /// Tangents against the disc of their cone, and discs.
    pub cone: f64,
}

impl Residuals {
    /// The largest of the three; NaN if any is.
    pub fn largest(&self) -> f64 {
        let all = [self.equality, self.complementarity, self.cone];
        all.into_iter()
            .fold(0.0, |most, x| if x <= most { most } else { x })
    }
}

/// `delta = delta_free + W lambda` \[m\] into `out`, (n).
pub fn gaps(problem: &Problem, lambda: &[f64], out: &mut [f64]) {
    for (out, free) in out.iter_mut().zip(problem.delta_free) {
        *out = *free;
    }
    let n = problem.rows.len().max(1);
    for (column, &lambda) in problem.compliance.chunks_exact(n).zip(lambda) {
        if lambda != 0.0 {
            for (out, w) in out.iter_mut().zip(column) {
                *out += w * lambda;
            }
        }
    }
}

/// Residuals of `lambda` \[N\] that leaves `delta` \[m\], both (n). Rows without compliance, and the
/// tangents of a normal or pair without it, carry no force and count for nothing. NaN for a problem
/// that is malformed.
pub fn residuals(problem: &Problem, lambda: &[f64], delta: &[f64]) -> Residuals {
    let n = problem.rows.len();
    let lengths = [lambda.len(), delta.len(), problem.delta_free.len()];
    if lengths != [n; 3] || problem.compliance.len() != n * n || check_kinds(problem).is_err() {
        return Residuals {
            equality: f64::NAN,
            complementarity: f64::NAN,
            cone: f64::NAN,
        };
    }
    let diagonal = |row: usize| problem.compliance[row * (n + 1)];
    let empty = |row: usize| diagonal(row) < f64::MIN_POSITIVE;
    let mut found = Residuals::default();
    let (mut drive, mut strongest) = (0.0f64, 0.0f64);
    for (row, kind) in problem.rows.iter().map(|row| row.kind).enumerate() {
        if empty(row) {
            continue;
        }
        let scale = diagonal(row).sqrt().recip();
        let (lambda_, delta_) = (lambda[row] / scale, delta[row] * scale);
        let free = problem.delta_free[row] * scale;
        match kind {
            RowKind::Equality => {
                found.equality = larger(found.equality, delta_.abs());
                drive = drive.max(free.abs());
            }
            RowKind::Inequality | RowKind::Normal { .. } => {
                let projected = (lambda_ - delta_).max(0.0);
                found.complementarity = larger(found.complementarity, (lambda_ - projected).abs());
                drive = drive.max(-free);
            }
            RowKind::Box { limit_n } => {
                let limit = limit_n / scale;
                let projected = (lambda_ - delta_).max(-limit).min(limit);
                found.complementarity = larger(found.complementarity, (lambda_ - projected).abs());
                drive = drive.max(free.abs().min(limit));
            }
            RowKind::Between { least_n, most_n } => {
                let projected = (lambda_ - delta_).max(least_n / scale).min(most_n / scale);
                found.complementarity = larger(found.complementarity, (lambda_ - projected).abs());
                let pull = (-free).max(0.0).min(most_n / scale);
                let push = free.max(0.0).min(-least_n / scale);
                drive = drive.max(pull).max(push);
            }
            RowKind::Disc { limit_n } if !empty(row + 1) => {
                let (off, most, driven) = disc(problem, lambda, delta, (row, limit_n));
                found.cone = larger(found.cone, off);
                strongest = strongest.max(most);
                drive = drive.max(driven);
            }
            RowKind::Tangent | RowKind::Disc { .. } => {}
        }
        if !matches!(kind, RowKind::Tangent | RowKind::Disc { .. }) {
            strongest = strongest.max(lambda_.abs());
        }
        if let RowKind::Normal { friction } = kind
            && !empty(row + 1)
            && !empty(row + 2)
        {
            let (off, force) = cone(problem, lambda, delta, (row, friction));
            found.cone = larger(found.cone, off);
            strongest = strongest.max(force);
        }
    }
    let scale = drive + 1e-6 * strongest;
    for part in [
        &mut found.equality,
        &mut found.complementarity,
        &mut found.cone,
    ] {
        // Nothing to do and nothing done: zero, not 0/0.
        if *part != 0.0 {
            *part /= scale;
        }
    }
    found
}

/// Residual of the tangents of a cone whose normal row this is, and their force, both scaled.
fn cone(
    problem: &Problem,
    lambda: &[f64],
    delta: &[f64],
    (row, friction): (usize, f64),
) -> (f64, f64) {
    let diagonal = |row: usize| problem.compliance[row * (problem.rows.len() + 1)];
    let scale = diagonal(row + 1).max(diagonal(row + 2)).sqrt().recip();
    let force = [lambda[row + 1] / scale, lambda[row + 2] / scale];
    let radius = friction * lambda[row].max(0.0) / scale;
    let aim = [
        force[0] - delta[row + 1] * scale,
        force[1] - delta[row + 2] * scale,
    ];
    let part = (radius / aim[0].hypot(aim[1])).min(1.0);
    let part = if radius == 0.0 { 0.0 } else { part };
    let off = (force[0] - part * aim[0]).hypot(force[1] - part * aim[1]);
    (off, force[0].hypot(force[1]))
}

/// Residual of a disc whose first row this is, its force, and its drive, all scaled.
fn disc(
    problem: &Problem,
    lambda: &[f64],
    delta: &[f64],
    (row, limit_n): (usize, f64),
) -> (f64, f64, f64) {
    let diagonal = |row: usize| problem.compliance[row * (problem.rows.len() + 1)];
    let scale = diagonal(row).max(diagonal(row + 1)).sqrt().recip();
    let radius = limit_n / scale;
    let of = |from: &[f64], by: f64| [from[row] * by, from[row + 1] * by];
    let (force, gap) = (of(lambda, scale.recip()), of(delta, scale));
    let aim = [force[0] - gap[0], force[1] - gap[1]];
    let length = aim[0].hypot(aim[1]);
    let part = if length > radius {
        radius / length
    } else {
        1.0
    };
    let off = (force[0] - part * aim[0]).hypot(force[1] - part * aim[1]);
    let free = of(problem.delta_free, scale);
    (
        off,
        force[0].hypot(force[1]),
        free[0].hypot(free[1]).min(radius),
    )
}

/// The larger of the two, NaN if `x` is.
fn larger(most: f64, x: f64) -> f64 {
    if x <= most { most } else { x }
}
