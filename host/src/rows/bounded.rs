//! `min 1/2 x' S x + g' x` over `low <= x <= high`, S symmetric positive definite.
//!
//! Entry point: [`solve`]. A primal-dual active set first (Hintermueller, Ito & Kunisch 2002), which
//! from a warm start takes one or two factorisations; it can go round in circles, so when its count
//! of wrong rows has not fallen for a few rounds a primal active set takes over (Nocedal & Wright
//! 2006, algorithm 16.3): every release of a bound lowers the objective strictly, so no set comes
//! back and it ends.

use super::scaled::Law;
use super::state::Mode;
use super::workspace::Active;

/// Rounds without a smaller count of wrong rows before the primal method takes over.
const PATIENCE: u32 = 4;
/// Least pivot of independent rows; the diagonal is 1.
pub(super) const PIVOT: f64 = 1e-10;

/// The rows are dependent: S of the active set has a pivot below [`PIVOT`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Dependent;

/// How a search ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// Factorisations.
    pub iterations: u32,
    pub converged: bool,
}

/// The problem.
#[derive(Clone, Copy)]
pub(super) struct Reduced<'a> {
    pub n: usize,
    /// S, (n x n), both triangles.
    pub matrix: &'a [f64],
    /// g, (n).
    pub target: &'a [f64],
    pub law: &'a [Law],
    /// Violations of signs and bounds to overlook.
    pub slack: f64,
    /// Whether small pivots are an error.
    pub regular: bool,
}

impl Reduced<'_> {
    /// Violations that rounding may cause at `x`.
    pub fn rounding(&self, x: &[f64]) -> f64 {
        let strongest = x.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        self.slack + 1e-15 * strongest
    }

    /// `delta = g + S x`.
    pub fn gaps(&self, x: &[f64], delta: &mut [f64]) {
        delta.copy_from_slice(self.target);
        for (column, &x) in self.matrix.chunks_exact(self.n.max(1)).zip(x) {
            if x != 0.0 {
                for (delta, s) in delta.iter_mut().zip(column) {
                    *delta += s * x;
                }
            }
        }
    }
}

/// Iterates, (n) each.
pub(super) struct Iterate<'a> {
    pub modes: &'a mut [Mode],
    /// Solution; what it holds before is where the primal method starts.
    pub x: &'a mut [f64],
    pub delta: &'a mut [f64],
    pub trial: &'a mut [f64],
}

/// Solves from the set in `modes`.
pub(super) fn solve(
    problem: &Reduced,
    at: &mut Iterate,
    active: &mut Active,
) -> Result<Found, Dependent> {
    for (mode, law) in at.modes.iter_mut().zip(problem.law) {
        let (low, high) = law.bounds();
        *mode = match *mode {
            _ if low == high => Mode::AtLower,
            Mode::AtLower if low.is_finite() => Mode::AtLower,
            Mode::AtUpper if high.is_finite() => Mode::AtUpper,
            _ => Mode::Held,
        };
    }
    let mut fewest = usize::MAX;
    let mut patience = PATIENCE;
    let mut rounds = 0;
    while patience > 0 {
        rounds += 1;
        minimise(problem, at.modes, at.trial, active)?;
        problem.gaps(at.trial, at.delta);
        let wrong = update(problem, at);
        if wrong == 0 {
            at.x.copy_from_slice(at.trial);
            clamp(problem, at);
            return Ok(Found {
                iterations: rounds,
                converged: true,
            });
        }
        if wrong < fewest {
            fewest = wrong;
            patience = PATIENCE;
        } else {
            patience -= 1;
        }
    }
    at.x.copy_from_slice(at.trial);
    let found = primal(problem, at, active)?;
    Ok(Found {
        iterations: rounds + found.iterations,
        ..found
    })
}

/// Minimiser in the subspace of the held rows, the others at their bounds.
fn minimise(
    problem: &Reduced,
    modes: &[Mode],
    x: &mut [f64],
    active: &mut Active,
) -> Result<(), Dependent> {
    let n = problem.n;
    active.rows.clear();
    for (row, ((mode, law), x)) in modes.iter().zip(problem.law).zip(x.iter_mut()).enumerate() {
        let (low, high) = law.bounds();
        *x = match mode {
            Mode::Held => {
                active.rows.push(row);
                0.0
            }
            Mode::AtUpper => high,
            _ => low,
        };
    }
    let k = active.rows.len();
    let rhs = &mut active.rhs[..k];
    for (rhs, &row) in rhs.iter_mut().zip(&active.rows) {
        *rhs = -problem.target[row];
    }
    for (column, &x) in problem.matrix.chunks_exact(n.max(1)).zip(&*x) {
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
    factor(active, k, problem.regular)?;
    active
        .dense
        .solve(&active.matrix[..k * k], k, &mut active.rhs[..k], 1);
    for (&row, &value) in active.rows.iter().zip(&active.rhs) {
        x[row] = value;
    }
    Ok(())
}

/// Cholesky factor of the active matrix (k x k) in place.
pub(super) fn factor(active: &mut Active, k: usize, regular: bool) -> Result<(), Dependent> {
    let matrix = &mut active.matrix[..k * k];
    active.dense.factor(matrix, k).map_err(|_| Dependent)?;
    if regular && smallest_pivot(matrix, k) < PIVOT {
        return Err(Dependent);
    }
    Ok(())
}

/// Square of the smallest diagonal entry of a Cholesky factor (k x k).
pub(super) fn smallest_pivot(factor: &[f64], k: usize) -> f64 {
    (0..k)
        .map(|i| factor[i * (k + 1)])
        .fold(f64::INFINITY, |least, x| if x >= least { least } else { x })
        .powi(2)
}

/// Moves rows that break their sign or bound to where they belong; how many there were.
fn update(problem: &Reduced, at: &mut Iterate) -> usize {
    let mut wrong = 0;
    let slack = 4.0 * problem.rounding(at.trial);
    for (((mode, law), &x), &delta) in at
        .modes
        .iter_mut()
        .zip(problem.law)
        .zip(&*at.trial)
        .zip(&*at.delta)
    {
        let (low, high) = law.bounds();
        let next = match *mode {
            Mode::Held if x < low - slack => Mode::AtLower,
            Mode::Held if x > high + slack => Mode::AtUpper,
            Mode::AtLower if low < high && delta < -slack => Mode::Held,
            Mode::AtUpper if low < high && delta > slack => Mode::Held,
            same => same,
        };
        wrong += usize::from(next != *mode);
        *mode = next;
    }
    wrong
}

/// Bounds to the last bit.
fn clamp(problem: &Reduced, at: &mut Iterate) {
    for (x, law) in at.x.iter_mut().zip(problem.law) {
        let (low, high) = law.bounds();
        *x = x.max(low).min(high);
    }
}

/// Primal active set from the projection of `at.x`.
fn primal(problem: &Reduced, at: &mut Iterate, active: &mut Active) -> Result<Found, Dependent> {
    for ((x, law), mode) in at.x.iter_mut().zip(problem.law).zip(at.modes.iter_mut()) {
        let (low, high) = law.bounds();
        *mode = if *x <= low {
            Mode::AtLower
        } else if *x >= high {
            Mode::AtUpper
        } else {
            Mode::Held
        };
        *x = x.max(low).min(high);
    }
    // A set of n rows has seldom needed more than 3 n; only rounding could go on for ever.
    let limit = 100 + 20 * problem.n as u32;
    for round in 1..=limit {
        minimise(problem, at.modes, at.trial, active)?;
        if let Some((row, part, mode)) = first_bound(problem, at) {
            for (x, trial) in at.x.iter_mut().zip(&*at.trial) {
                *x += part * (trial - *x);
            }
            let (low, high) = problem.law[row].bounds();
            at.x[row] = if mode == Mode::AtLower { low } else { high };
            at.modes[row] = mode;
            continue;
        }
        at.x.copy_from_slice(at.trial);
        problem.gaps(at.x, at.delta);
        let Some(row) = most_wrong(problem, at) else {
            clamp(problem, at);
            return Ok(Found {
                iterations: round,
                converged: true,
            });
        };
        at.modes[row] = Mode::Held;
    }
    Ok(Found {
        iterations: limit,
        converged: false,
    })
}

/// The bound that is met first on the way from `x` to `trial`: row, part of the way, bound.
fn first_bound(problem: &Reduced, at: &Iterate) -> Option<(usize, f64, Mode)> {
    let mut first: Option<(usize, f64, Mode)> = None;
    for (row, law) in problem.law.iter().enumerate() {
        let (low, high) = law.bounds();
        let (x, trial) = (at.x[row], at.trial[row]);
        let (bound, mode) = if trial < low {
            (low, Mode::AtLower)
        } else if trial > high {
            (high, Mode::AtUpper)
        } else {
            continue;
        };
        let part = ((bound - x) / (trial - x)).clamp(0.0, 1.0);
        if first.is_none_or(|(_, least, _)| part < least) {
            first = Some((row, part, mode));
        }
    }
    first
}

/// The bounded row whose gap has the wrong sign by most.
fn most_wrong(problem: &Reduced, at: &Iterate) -> Option<usize> {
    let mut worst = None;
    let mut most = 4.0 * problem.rounding(at.x);
    for (row, law) in problem.law.iter().enumerate() {
        let (low, high) = law.bounds();
        let wrong = match at.modes[row] {
            Mode::AtLower if low < high => -at.delta[row],
            Mode::AtUpper if low < high => at.delta[row],
            _ => 0.0,
        };
        if wrong > most {
            most = wrong;
            worst = Some(row);
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The primal method alone finds what the primal-dual one finds.
    #[test]
    fn both_methods_agree() {
        let mut random = sutura_testkit::Random::new(3);
        let mut random = || random.signed();
        const N: usize = 12;
        let mut active = Active::new(N);
        for _ in 0..500 {
            let root: Vec<f64> = (0..N * N).map(|_| random()).collect();
            let mut matrix = vec![0.0; N * N];
            for i in 0..N {
                for j in 0..N {
                    let product: f64 = (0..N).map(|k| root[k * N + i] * root[k * N + j]).sum();
                    matrix[j * N + i] = product / N as f64 + if i == j { 1e-3 } else { 0.0 };
                }
            }
            let target: Vec<f64> = (0..N).map(|_| random()).collect();
            let law: Vec<Law> = (0..N)
                .map(|row| match row % 3 {
                    0 => Law::FREE,
                    1 => Law::Between {
                        low: 0.0,
                        high: f64::INFINITY,
                    },
                    _ => Law::Between {
                        low: -random().abs(),
                        high: random().abs(),
                    },
                })
                .collect();
            let problem = Reduced {
                n: N,
                matrix: &matrix,
                target: &target,
                law: &law,
                slack: 1e-12,
                regular: true,
            };
            let answers = [true, false].map(|both| {
                let (mut modes, mut x) = ([Mode::Held; N], [0.0; N]);
                let (mut delta, mut trial) = ([0.0; N], [0.0; N]);
                let mut at = Iterate {
                    modes: &mut modes,
                    x: &mut x,
                    delta: &mut delta,
                    trial: &mut trial,
                };
                let found = if both {
                    solve(&problem, &mut at, &mut active)
                } else {
                    primal(&problem, &mut at, &mut active)
                };
                assert!(found.expect("independent rows").converged);
                x
            });
            for (a, b) in answers[0].iter().zip(&answers[1]) {
                assert!((a - b).abs() <= 1e-8, "{answers:?}");
            }
        }
    }
}
