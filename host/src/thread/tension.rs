//! Tension of a thread whose pieces outside the tissue have a total length: a convex problem of their forces.
//!
//! Entry point: [`Tension::solve`]. Pieces y_s (3) give way by `y = y_free - G f`, and a thread of tension
//! T pulls each by f_s in the subdifferential of `T |y_s|`: along y_s, or any |f_s| <= T where y_s = 0 (a weld).
//! With `sum |y_s| <= a`, T >= 0, complementary, this is the minimum of `1/2 f'Gf - y_free'f + a T` over
//! `|f_s| <= T <= limit`: a unique y whatever G is, and forces that the limit bounds whatever is asked for.
//!
//! In one equation, for any c > 0 \[m/N\]: `y = P(y + c f)`, P(z) shortening all z_s by the same tau, not
//! beyond zero, so that they fit in a; then T = tau / c. Newton's method on it (P is semismooth, welds come and
//! go by its derivative; with its second derivatives across the pieces, without which nothing converges
//! once T/|y_s| exceeds the tissue's stiffness) takes a few solves but may cycle. When its residual does not
//! fall, a proximal step on the forces is made (augmented Lagrangian, Rockafellar 1976), whose convex,
//! differentiable problem Newton's method solves with a line search from anywhere; then Newton again.
//! Proximal steps converge from anywhere and Newton's is only kept where it halves the least residual, so
//! there is no cycle.

use crate::dense::{Lu, subtract_product};
use nalgebra::Vector3;

/// Residual of a solution, of the lengths involved: as far as rounding lets Newton's method go.
const TIGHT: f64 = 1e-13;
/// Residual that is still a solution when rounding stops earlier.
const LOOSE: f64 = 1e-9;
/// Lengths are not told apart to less than that share of this \[m\].
const SHORTEST_M: f64 = 1e-3;
/// Most solves.
const MOST_SOLVES: u32 = 200;
/// Newton's steps between two proximal ones.
const NEWTON_STEPS: u32 = 12;
/// Newton's steps within a proximal one.
const PROXIMAL_STEPS: u32 = 20;
/// Newton goes on while no step makes the residual larger by more than this: the first ones may.
const FALLING: f64 = 30.0;
/// Share of the proximal term in Newton's matrix: forces on welds that say the same twice would have no solution.
const REGULARISATION: f64 = 1e-10;
/// Halvings of a line search.
const HALVINGS: u32 = 30;

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// Solved.
    Solved,
    /// Solved, with the tension at its limit and more length than there is.
    Limit,
    /// Neither within the solves allowed; forces obey their bounds.
    NotConverged,
    /// NaN, infinity, beyond what f64 can hold, or lengths that do not match; no forces.
    Malformed,
}

/// What a piece does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Piece {
    /// Slack.
    #[default]
    Loose,
    /// Taut along a direction; the second derivative of its length times tension, in units of 1/c.
    Taut { along: Vector3<f64>, across: f64 },
    /// Of no length.
    Weld,
}

/// Forces, and scratch for so many pieces.
pub(crate) struct Tension {
    most: usize,
    /// f \[N\], (3 pieces).
    force: Vec<f64>,
    /// y \[m\], (3 pieces).
    way: Vec<f64>,
    /// y + c f, then what P leaves of it.
    left: Vec<f64>,
    pieces: Vec<Piece>,
    /// 1 / (number of taut pieces) while their total length is held, else 0.
    shared: f64,
    tension_n: f64,
    /// Whether that is the limit.
    limited: bool,
    c: f64,
    lengths: Vec<f64>,
    best: Vec<f64>,
    centre: Vec<f64>,
    trial: Vec<f64>,
    step: Vec<f64>,
    /// Moved by what is wanted: G (f - w), G step.
    given: Vec<f64>,
    matrix: Vec<f64>,
    columns: Vec<f64>,
    lu: Lu,
}

/// Derivatives that [`Tension::change`] can take at once.
pub(crate) const MOST_CHANGES: usize = 7;

impl Tension {
    pub fn new(most: usize) -> Self {
        let n = 3 * most;
        let vector = || vec![0.0; n];
        crate::dense::prepare_thread();
        Self {
            most,
            force: Vec::with_capacity(n),
            way: Vec::with_capacity(n),
            left: vector(),
            pieces: Vec::with_capacity(most),
            shared: 0.0,
            tension_n: 0.0,
            limited: false,
            c: 0.0,
            lengths: Vec::with_capacity(most),
            best: vector(),
            centre: vector(),
            trial: vector(),
            step: vector(),
            given: vector(),
            matrix: vec![0.0; n * n],
            columns: vec![0.0; n * MOST_CHANGES],
            lu: Lu::new(n),
        }
    }

    /// Forces that shorten the pieces \[N\], (3 pieces).
    pub fn force_n(&self) -> &[f64] {
        &self.force
    }

    /// The pieces \[m\], (3 pieces).
    pub fn way_m(&self) -> &[f64] {
        &self.way
    }

    pub fn tension_n(&self) -> f64 {
        self.tension_n
    }

    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// Their total length \[m\].
    pub fn length_m(&self) -> f64 {
        total(&self.way)
    }

    /// Forgets all forces.
    pub fn clear(&mut self) {
        self.force.clear();
        self.way.clear();
        self.pieces.clear();
        self.tension_n = 0.0;
        self.limited = false;
        self.shared = 0.0;
    }

    /// Finds the forces for `compliance` G \[m/N\] (n x n, symmetric positive semidefinite) and `free` y_free \[m\] (n),
    /// starting from those it has if there are as many; and how many solves that took.
    pub fn solve(
        &mut self,
        compliance: &[f64],
        free: &[f64],
        available_m: f64,
        limit_n: f64,
    ) -> (End, u32) {
        let n = free.len();
        let extent = (total(free) + available_m).max(SHORTEST_M);
        let sound = n.is_multiple_of(3)
            && n <= 3 * self.most
            && compliance.len() == n * n
            && compliance.iter().all(|g| g.is_finite())
            && available_m >= 0.0
            && extent.is_finite()
            && limit_n >= 0.0
            && limit_n.is_finite();
        if !sound {
            self.clear();
            return (End::Malformed, 0);
        }
        if self.force.len() != n {
            self.force.clear();
            self.force.resize(n, 0.0);
        }
        self.way.resize(n, 0.0);
        self.pieces.clear();
        self.pieces.resize(n / 3, Piece::Loose);
        let problem = Problem {
            compliance,
            free,
            available_m,
            limit_n,
        };
        self.c = scale(compliance, free);
        let (c, tight, loose) = (self.c, TIGHT * extent, LOOSE * extent);
        if total(free) <= available_m {
            self.force.fill(0.0);
            self.look(&problem, c);
            return (End::Solved, 0);
        }
        let mut solves = 0;
        let mut least = self.look(&problem, c);
        let mut proximal = 0.1 * c;
        self.best[..n].copy_from_slice(&self.force);
        'search: loop {
            let mut before = least;
            for _ in 0..NEWTON_STEPS {
                if least <= tight || solves >= MOST_SOLVES {
                    break 'search;
                }
                solves += 1;
                self.newton(&problem);
                let residual = self.look(&problem, c);
                let goes_on = residual <= FALLING * before;
                before = residual;
                if residual <= 0.5 * least || residual < least && residual <= tight {
                    least = residual;
                    self.best[..n].copy_from_slice(&self.force);
                }
                if !goes_on {
                    break;
                }
            }
            self.force.copy_from_slice(&self.best[..n]);
            if least <= loose {
                break;
            }
            solves += self.proximal(&problem, proximal);
            // Smaller ones go further, for a harder problem.
            proximal = (0.1 * proximal).max(1e-9 * c);
            least = self.look(&problem, c);
            self.best[..n].copy_from_slice(&self.force);
        }
        self.force.copy_from_slice(&self.best[..n]);
        let residual = self.look(&problem, c);
        // Exactly within their bounds, whatever the numbers were.
        for ((force, left), way) in self.force.iter_mut().zip(&self.left).zip(&self.way) {
            *force += (way - left) / c;
        }
        self.look(&problem, c);
        for force in self.force.chunks_exact_mut(3) {
            let size = norm(force);
            if size > self.tension_n {
                let share = self.tension_n / size;
                force.iter_mut().for_each(|force| *force *= share);
            }
        }
        if !(residual.is_finite() && self.force.iter().all(|force| force.is_finite())) {
            self.clear();
            return (End::Malformed, solves);
        }
        let end = if residual > loose {
            End::NotConverged
        } else if self.limited {
            End::Limit
        } else {
            End::Solved
        };
        (end, solves)
    }

    /// What forces change by, (n x columns), with `free` (n x columns), left in place, and the available length, at
    /// the last solution; none if there are too many columns.
    pub fn change(&mut self, compliance: &[f64], free: &[f64], available: &[f64]) -> &[f64] {
        let n = self.force.len();
        let count = available.len();
        if count > MOST_CHANGES || free.len() != n * count || compliance.len() != n * n {
            return &[];
        }
        self.build(compliance, n, REGULARISATION);
        self.columns[..n * count].copy_from_slice(free);
        for (column, available) in self.columns.chunks_exact_mut(n.max(1)).zip(available) {
            turned(&self.pieces, self.shared, column);
            for (column, piece) in column.chunks_exact_mut(3).zip(&self.pieces) {
                if let Piece::Taut { along, .. } = piece {
                    for (column, along) in column.iter_mut().zip(along.iter()) {
                        *column -= along * self.shared * available;
                    }
                }
            }
        }
        if n > 0 {
            self.lu.factor(&mut self.matrix[..n * n], n);
            let columns = &mut self.columns[..n * count];
            self.lu.solve(&self.matrix[..n * n], n, columns, count);
        }
        &self.columns[..n * count]
    }

    /// What the tension changes by \[N\] when forces do by `change`, (3 pieces).
    pub fn tension_change_n(&self, change: &[f64]) -> f64 {
        let changes = change.chunks_exact(3).zip(&self.pieces);
        let taut: f64 = changes
            .map(|(change, piece)| match piece {
                Piece::Taut { along, .. } => along.dot(&Vector3::from_column_slice(change)),
                _ => 0.0,
            })
            .sum();
        taut * self.shared
    }

    /// `f += M^-1 (y - P)`, the linearisation of `y = P(y + c f)`, where [`Self::look`] looked.
    fn newton(&mut self, problem: &Problem) {
        let n = self.force.len();
        self.build(problem.compliance, n, REGULARISATION);
        for ((step, way), left) in self.step.iter_mut().zip(&self.way).zip(&self.left) {
            *step = way - left;
        }
        self.lu.factor(&mut self.matrix[..n * n], n);
        self.lu
            .solve(&self.matrix[..n * n], n, &mut self.step[..n], 1);
        if self.step[..n].iter().all(|step| step.is_finite()) {
            for (force, step) in self.force.iter_mut().zip(&self.step) {
                *force += step;
            }
        }
    }

    /// Forces that minimise the problem's function and `c/2 |f - f_0|^2`, roughly; how many solves that took.
    fn proximal(&mut self, problem: &Problem, c: f64) -> u32 {
        let n = self.force.len();
        self.centre[..n].copy_from_slice(&self.force);
        // w, whose own forces (z - P) / c follow from it: the same at the minimum.
        let mut value = self.value(problem, c);
        let mut solves = 0;
        while solves < PROXIMAL_STEPS {
            solves += 1;
            self.build_proximal(problem.compliance, n, c);
            for index in 0..n {
                let own = (self.way[index] - self.left[index]) / c + self.centre[index]
                    - self.force[index];
                self.step[index] = own;
                self.trial[index] = own;
            }
            self.lu.factor(&mut self.matrix[..n * n], n);
            self.lu
                .solve(&self.matrix[..n * n], n, &mut self.step[..n], 1);
            if !self.step[..n].iter().all(|step| step.is_finite()) {
                break;
            }
            // The gradient is G (w - own).
            minus_product(problem.compliance, &self.trial[..n], &mut self.given[..n]);
            let slope = dot(&self.given[..n], &self.step[..n]);
            let missed = norm(&self.given[..n]);
            self.trial[..n].copy_from_slice(&self.force);
            let mut share = 1.0;
            for halving in 0..=HALVINGS {
                for ((force, from), step) in self.force.iter_mut().zip(&self.trial).zip(&self.step)
                {
                    *force = from + share * step;
                }
                let next = self.value(problem, c);
                let enough = value + 1e-4 * share * slope + 1e-14 * value.abs();
                if next <= enough || halving == HALVINGS {
                    value = next;
                    break;
                }
                share *= 0.5;
            }
            // Rockafellar's criterion, before the step: the next one is better still.
            let gone: f64 = (0..n)
                .map(|index| (self.way[index] - self.left[index]).powi(2))
                .sum();
            if missed <= 0.1 * gone.sqrt() {
                break;
            }
        }
        for index in 0..n {
            self.force[index] = (self.way[index] - self.left[index]) / c + self.centre[index];
        }
        solves
    }

    /// `1/2 w'Gw` and the Moreau envelope of the length's bound at `y(w) + c f_0`.
    fn value(&mut self, problem: &Problem, c: f64) -> f64 {
        let n = self.force.len();
        self.give(problem);
        let stored: f64 = (0..n)
            .map(|index| 0.5 * self.force[index] * (problem.free[index] - self.way[index]))
            .sum();
        for index in 0..n {
            self.left[index] = self.way[index] + c * self.centre[index];
        }
        self.shorten(problem, c);
        let far: f64 = (0..n)
            .map(|index| {
                let z = self.way[index] + c * self.centre[index];
                (z - self.left[index]).powi(2)
            })
            .sum();
        let over = total(&self.left[..n]) - problem.available_m;
        let limited = if self.limited {
            problem.limit_n * over
        } else {
            0.0
        };
        stored + far / (2.0 * c) + limited
    }

    /// Takes y, P and what the pieces do from the forces; |y - P|.
    fn look(&mut self, problem: &Problem, c: f64) -> f64 {
        let n = self.force.len();
        self.give(problem);
        for index in 0..n {
            self.left[index] = self.way[index] + c * self.force[index];
        }
        self.shorten(problem, c);
        let off: f64 = self
            .way
            .iter()
            .zip(&self.left)
            .map(|(y, p)| (y - p).powi(2))
            .sum();
        let off = off.sqrt();
        if off.is_nan() { f64::INFINITY } else { off }
    }

    /// y = y_free - G f.
    fn give(&mut self, problem: &Problem) {
        let n = self.force.len();
        minus_product(problem.compliance, &self.force, &mut self.way);
        for (way, free) in self.way[..n].iter_mut().zip(problem.free) {
            *way += free;
        }
    }

    /// P in place.
    fn shorten(&mut self, problem: &Problem, c: f64) {
        let n = self.force.len();
        let z = &mut self.left[..n];
        self.lengths.clear();
        self.lengths.extend(z.chunks_exact(3).map(norm));
        self.lengths.sort_unstable_by(|a, b| b.total_cmp(a));
        let sum: f64 = self.lengths.iter().sum();
        self.tension_n = 0.0;
        self.limited = false;
        self.shared = 0.0;
        if sum <= problem.available_m {
            self.pieces.fill(Piece::Loose);
            return;
        }
        let mut tau = self.lengths.first().copied().unwrap_or(0.0);
        let (mut sum, mut taut) = (0.0, 0.0);
        for length in &self.lengths {
            sum += length;
            let next = (sum - problem.available_m) / (taut + 1.0);
            if *length <= next {
                break;
            }
            taut += 1.0;
            tau = next;
        }
        if taut > 0.0 {
            self.shared = 1.0 / taut;
        }
        self.limited = tau >= c * problem.limit_n;
        self.tension_n = tau / c;
        if self.limited {
            tau = c * problem.limit_n;
            self.tension_n = problem.limit_n;
            self.shared = 0.0;
        }
        for (z, piece) in z.chunks_exact_mut(3).zip(&mut self.pieces) {
            let length = norm(z);
            if length > tau {
                *piece = Piece::Taut {
                    along: Vector3::from_column_slice(z) / length,
                    across: tau / length,
                };
                z.iter_mut().for_each(|z| *z *= 1.0 - tau / length);
            } else {
                *piece = Piece::Weld;
                z.fill(0.0);
            }
        }
    }

    /// `H G + c (1 - H) + share c H` with H = 1 - P'.
    fn build(&mut self, compliance: &[f64], n: usize, share: f64) {
        let c = self.c;
        let columns = self.matrix.chunks_exact_mut(n.max(1));
        let given = compliance.chunks_exact(n.max(1));
        for (index, (column, given)) in columns.zip(given).enumerate() {
            column.copy_from_slice(given);
            column[index] -= c * (1.0 - share);
            turned(&self.pieces, self.shared, column);
            column[index] += c;
        }
    }

    /// `c + H G`.
    fn build_proximal(&mut self, compliance: &[f64], n: usize, c: f64) {
        let columns = self.matrix.chunks_exact_mut(n.max(1));
        let given = compliance.chunks_exact(n.max(1));
        for (index, (column, given)) in columns.zip(given).enumerate() {
            column.copy_from_slice(given);
            turned(&self.pieces, self.shared, column);
            column[index] += c;
            column.iter_mut().for_each(|entry| *entry /= c);
        }
    }
}

struct Problem<'a> {
    compliance: &'a [f64],
    free: &'a [f64],
    available_m: f64,
    limit_n: f64,
}

/// `H v` in place.
fn turned(pieces: &[Piece], shared: f64, v: &mut [f64]) {
    let mean: f64 = v
        .chunks_exact(3)
        .zip(pieces)
        .map(|(v, piece)| match piece {
            Piece::Taut { along, .. } => along.dot(&Vector3::from_column_slice(v)) * shared,
            _ => 0.0,
        })
        .sum();
    for (v, piece) in v.chunks_exact_mut(3).zip(pieces) {
        match piece {
            Piece::Loose => v.fill(0.0),
            Piece::Taut { along, across } => {
                let own = Vector3::from_column_slice(v);
                let turned = (own - along * along.dot(&own)) * *across + along * mean;
                v.copy_from_slice(turned.as_slice());
            }
            Piece::Weld => {}
        }
    }
}

/// How much a piece gives way along itself per tension, which makes lengths and forces comparable; 1 if none does.
fn scale(compliance: &[f64], free: &[f64]) -> f64 {
    let n = free.len();
    let direction = |index: usize| {
        let length = norm(&free[index / 3 * 3..index / 3 * 3 + 3]);
        if length > 0.0 {
            free[index] / length
        } else {
            0.0
        }
    };
    let mut sum = 0.0;
    let mut largest = 0.0f64;
    for (j, column) in compliance.chunks_exact(n.max(1)).enumerate() {
        let along: f64 = column
            .iter()
            .enumerate()
            .map(|(i, g)| g * direction(i))
            .sum();
        sum += along * direction(j);
        largest = largest.max(column[j]);
    }
    let mean = sum / (n as f64 / 3.0);
    // One that stays its length as a whole can still be turned.
    let c = mean.max(1e-3 * largest);
    if c > 0.0 && c.is_finite() { c } else { 1.0 }
}

/// `out = -G v`.
fn minus_product(compliance: &[f64], v: &[f64], out: &mut [f64]) {
    let n = v.len();
    out.fill(0.0);
    if n > 0 {
        subtract_product(compliance, v, out, (n, n, 1));
    }
}

fn total(pieces: &[f64]) -> f64 {
    pieces.chunks_exact(3).map(norm).sum()
}

fn norm(v: &[f64]) -> f64 {
    dot(v, v).sqrt()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests;
