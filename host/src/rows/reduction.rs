//! The solved set as seen from outside: how forces follow the tool, and fewer rows in place of many.
//!
//! Entry points: [`tangent`], [`condense`]. Held rows answer a change of targets with
//! `d lambda = -W_aa^-1 d delta_free`; rows at a bound keep their force; a slipping pair follows its
//! normal and turns with the slip (module `slip`), which makes the
//! operator unsymmetric.

use super::active_set::EPSILON;
use super::bounded;
use super::scaled::{Law, Scaled};
use super::slip::Slip;
use super::workspace::{Active, Workspace};
use super::{Mode, Problem, State};
use sutura_factor::add_product;

/// Derivative of a tool's wrench by its pose through the rows' forces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reduction {
    /// Symmetric part of `-J' W_aa^-1 J`, J = d delta_free / d pose; N/m, N, N m per rad.
    pub tangent: [[f64; 6]; 6],
    /// Largest entry of the skew part, in the units of its place: zero unless rows slip.
    pub skew: f64,
}

/// Where [`condense`] writes, for k kept rows and a axes.
#[derive(Debug)]
pub struct Condensed<'a> {
    /// Symmetric part of W with the other active rows condensed out \[m/N\], (k x k), column-major.
    pub compliance: &'a mut [f64],
    /// delta \[m\] of the kept rows without their own forces, the others answering, (k).
    pub delta_free: &'a mut [f64],
    /// J of the kept rows with the others answering, (k x a), column-major.
    pub jacobian: &'a mut [f64],
}

/// How the forces in `state`, solved for `problem`, follow a tool with `jacobian` J (n x 6,
/// column-major, zero for rows of other tools). None if `state` is not of this problem or J does not
/// fit.
pub fn tangent(
    problem: &Problem,
    state: &State,
    jacobian: &[f64],
    work: &mut Workspace,
) -> Option<Reduction> {
    let n = problem.rows.len();
    if jacobian.len() != 6 * n {
        return None;
    }
    let mut active = linearise(problem, state, &[], work)?;
    for axis in 0..6 {
        active.load(axis, &jacobian[n * axis..n * (axis + 1)]);
    }
    active.solve(6);
    let mut full = [[0.0; 6]; 6];
    for (i, row) in full.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = -active.weigh(&jacobian[n * i..n * (i + 1)], j);
        }
    }
    let mut reduction = Reduction::default();
    for (i, row) in reduction.tangent.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = 0.5 * (full[i][j] + full[j][i]);
            reduction.skew = reduction.skew.max(0.5 * (full[i][j] - full[j][i]).abs());
        }
    }
    Some(reduction)
}

/// Condenses every active row but `keep` (indices of rows; cones whole or not at all) out of
/// `problem`, at the forces in `state`; `jacobian` is J (n x a, column-major, of at most six axes). Returns the
/// largest entry of the skew part of the compliance \[m/N\], which only rows that slip and are not kept cause.
/// None as for [`tangent`].
pub fn condense(
    problem: &Problem,
    state: &State,
    keep: &[usize],
    jacobian: &[f64],
    work: &mut Workspace,
    out: &mut Condensed,
) -> Option<f64> {
    let (n, kept) = (problem.rows.len(), keep.len());
    let axes = jacobian.len() / n.max(1);
    let fits = axes <= 6
        && jacobian.len() == axes * n
        && keep.iter().all(|&row| row < n)
        && kept <= n
        && out.compliance.len() == kept * kept
        && out.delta_free.len() == kept
        && out.jacobian.len() == axes * kept;
    if !fits {
        return None;
    }
    let mut active = linearise(problem, state, keep, work)?;
    let w = |row: usize| &problem.compliance[row * n..(row + 1) * n];
    let sources = keep
        .iter()
        .map(|&row| w(row))
        .chain(jacobian.chunks_exact(n.max(1)));
    for (column, source) in sources.enumerate() {
        active.load(column, source);
    }
    let answered = active.answer(kept, axes);
    for (i, &row) in keep.iter().enumerate() {
        for (j, &column) in keep.iter().enumerate() {
            out.compliance[j * kept + i] = w(column)[row] - answered[j * kept + i];
        }
        for axis in 0..axes {
            out.jacobian[axis * kept + i] =
                jacobian[axis * n + row] - answered[(kept + axis) * kept + i];
        }
    }
    let mut skew = 0.0f64;
    for i in 0..kept {
        for j in 0..i {
            let (a, b) = (out.compliance[j * kept + i], out.compliance[i * kept + j]);
            skew = skew.max(0.5 * (a - b).abs());
            out.compliance[j * kept + i] = 0.5 * (a + b);
            out.compliance[i * kept + j] = 0.5 * (a + b);
        }
    }
    for (i, &row) in keep.iter().enumerate() {
        let own: f64 = keep
            .iter()
            .enumerate()
            .map(|(j, &from)| out.compliance[j * kept + i] * state.lambda[from])
            .sum();
        out.delta_free[i] = state.delta[row] - own;
    }
    Some(skew)
}

/// The factored active rows, and columns of right-hand sides that become forces.
struct Linear<'a> {
    problem: &'a Problem<'a>,
    state: &'a State,
    scaled: &'a Scaled,
    active: &'a mut Active,
    columns: &'a mut [f64],
    /// Right-hand sides once more, and what the kept rows get of the forces.
    loads: &'a mut [f64],
    answered: &'a mut [f64],
    slips: bool,
    epsilon: f64,
}

/// Gathers and factors the active rows but those of `skip`.
fn linearise<'a>(
    problem: &'a Problem,
    state: &'a State,
    skip: &[usize],
    work: &'a mut Workspace,
) -> Option<Linear<'a>> {
    work.forget_factors();
    let n = problem.rows.len();
    let known = state.ids.iter().eq(problem.rows.iter().map(|row| &row.id));
    if !known || n > work.largest() || work.scaled.prepare(problem, false).is_err() {
        return None;
    }
    let modes = &mut work.vectors.modes[..n];
    modes.copy_from_slice(&state.modes);
    for &row in skip {
        modes[row] = Mode::AtLower;
        match work.scaled.law[row] {
            Law::Normal { .. } => modes[row + 1..row + 3].fill(Mode::AtLower),
            Law::Disc { .. } => modes[row + 1] = Mode::AtLower,
            Law::Between { .. } | Law::Tangent => {}
        }
    }
    let active = &mut work.active;
    active.rows.clear();
    let law = &work.scaled.law;
    let answers = |row: &usize| match modes[*row] {
        Mode::Held | Mode::Slipping => law[*row] != Law::NONE,
        Mode::AtLower | Mode::AtUpper => false,
    };
    active.rows.extend((0..n).filter(answers));
    let slips = active.rows.iter().any(|&row| modes[row] == Mode::Slipping);
    let mut linear = Linear {
        problem,
        state,
        scaled: &work.scaled,
        active,
        columns: &mut work.columns,
        loads: &mut work.loads,
        answered: &mut work.answered,
        slips,
        epsilon: 0.0,
    };
    linear.factor().then_some(linear)
}

impl Linear<'_> {
    fn size(&self) -> usize {
        self.active.rows.len()
    }

    /// Factors `W~_aa`, or with the diagonal raised where it is singular.
    fn factor(&mut self) -> bool {
        let k = self.size();
        self.gather();
        if bounded::factor(self.active, k, true).is_err() {
            self.epsilon = EPSILON;
            self.gather();
            if !self.slips && bounded::factor(self.active, k, false).is_err() {
                return false;
            }
        }
        if self.slips {
            self.gather();
            for place in 0..k {
                if let Some(slip) = self.slip(place) {
                    let matrix = &mut self.active.matrix[..k * k];
                    for column in matrix.chunks_exact_mut(k) {
                        slip.replace(column, place);
                    }
                    slip.complete(matrix, k, place);
                }
            }
            self.active.lu.factor(&mut self.active.matrix[..k * k], k);
        }
        true
    }

    fn gather(&mut self) {
        let (k, n, scaled) = (self.size(), self.scaled.n, self.scaled);
        let rows = &self.active.rows;
        let matrix = &mut self.active.matrix[..k * k];
        for (place, (out, &j)) in matrix.chunks_exact_mut(k.max(1)).zip(rows).enumerate() {
            let column = &self.problem.compliance[j * n..(j + 1) * n];
            for (out, &i) in out.iter_mut().zip(rows) {
                *out = scaled.scale[j] * column[i] * scaled.scale[i];
            }
            out[place] += self.epsilon;
        }
    }

    /// The law of the slipping pair whose first tangent is at `place`.
    fn slip(&self, place: usize) -> Option<Slip> {
        let row = self.active.rows[place];
        if self.state.modes[row] != Mode::Slipping {
            return None;
        }
        let aim = |at: usize| {
            let scale = self.scaled.scale[at];
            self.state.lambda[at] / scale - self.state.delta[at] * scale
        };
        if let Law::Disc { radius } = self.scaled.law[row] {
            return Some(Slip::disc(radius, [row, row + 1].map(aim), 1.0));
        }
        let normal = row.checked_sub(1)?;
        let Law::Normal { friction } = self.scaled.law[normal] else {
            return None;
        };
        Some(Slip::new(friction, [normal, row, row + 1].map(aim), 1.0))
    }

    /// Right-hand side `column`: a change of all rows' delta_free.
    fn load(&mut self, column: usize, source: &[f64]) {
        let k = self.size();
        let out = &mut self.columns[column * k..(column + 1) * k];
        for (out, &row) in out.iter_mut().zip(&self.active.rows) {
            *out = self.scaled.scale[row] * source[row];
        }
    }

    /// What the first `count` columns take away from the forces, in their place.
    fn solve(&mut self, count: usize) {
        let k = self.size();
        if k == 0 {
            return;
        }
        if self.slips {
            for place in 0..k {
                if let Some(slip) = self.slip(place) {
                    for column in self.columns[..k * count].chunks_exact_mut(k) {
                        slip.replace(column, place);
                    }
                }
            }
            let columns = &mut self.columns[..k * count];
            let active = &mut *self.active;
            active.lu.solve(&active.matrix[..k * k], k, columns, count);
            return;
        }
        let active = &mut *self.active;
        let factor = &active.matrix[..k * k];
        active
            .dense
            .solve(factor, k, &mut self.columns[..k * count], count);
        if self.epsilon > 0.0 {
            // Dependent rows share what they carry together, and carry nothing against each other:
            // (W + e)^-1 W (W + e)^-1.
            for column in self.columns[..k * count].chunks_exact_mut(k) {
                let again = &mut active.rhs[..k];
                again.copy_from_slice(column);
                active.dense.solve(factor, k, again, 1);
                for (x, again) in column.iter_mut().zip(&*again) {
                    *x -= self.epsilon * again;
                }
            }
        }
    }

    /// Solves for `kept` rows' columns and `axes` more, and holds against each of the former what the forces move them by,
    /// (kept x (kept + axes)).
    fn answer(&mut self, kept: usize, axes: usize) -> &[f64] {
        let (k, count) = (self.size(), kept + axes);
        self.loads[..k * kept].copy_from_slice(&self.columns[..k * kept]);
        self.solve(count);
        let (loads, forces) = (&self.loads[..k * kept], &self.columns[..k * count]);
        let answered = &mut self.answered[..kept * count];
        answered.fill(0.0);
        add_product(1.0, loads, forces, answered, (k, kept, count));
        answered
    }

    /// Sum over the active rows of `weights` (by row) times the forces of `column`.
    fn weigh(&self, weights: &[f64], column: usize) -> f64 {
        let k = self.size();
        let forces = &self.columns[column * k..(column + 1) * k];
        let rows = self.active.rows.iter().zip(forces);
        rows.map(|(&row, force)| weights[row] * self.scaled.scale[row] * force)
            .sum()
    }
}
