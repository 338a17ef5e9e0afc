//! What the held rows of the last solve answer to other targets, by the factors that it left.
//!
//! Entry points: [`Workspace::answers`], then [`Workspace::answer`]. See the header of [`super`] for the elimination.

use super::bounded::smallest_pivot;
use super::workspace::Workspace;
use sutura_factor::{
    Dense, solve_lower, solve_lower_transposed, subtract_combination, subtract_product,
};

impl Workspace {
    /// Whether [`Self::answer`] is of the rows that are not `free`, (n), none of which is in part what others say: its least
    /// pivot on a unit diagonal is above `least_pivot`.
    pub fn answers(&self, free: &[bool], least_pivot: f64) -> bool {
        let Self {
            scaled,
            equality,
            active,
            ..
        } = self;
        let (e, k) = (scaled.equalities, active.rows.len());
        let is_held = |at: usize| !free[scaled.order[at]];
        self.is_factored
            && scaled.n == free.len()
            && free.iter().filter(|free| !**free).count() == e + k
            && (0..e).all(is_held)
            && active.rows.iter().all(|row| is_held(e + row))
            && smallest_pivot(equality, e).min(smallest_pivot(&active.matrix, k)) > least_pivot
    }

    /// From now on the compliance is not that of the last solve.
    pub fn forget_factors(&mut self) {
        self.is_factored = false;
    }

    /// `W_hh^-1` times the entries of held rows in each column, (n x columns), the others left as they are.
    /// `scratch` has room for twice as many numbers.
    pub fn answer(&self, columns: &mut [f64], dense: &mut Dense, scratch: &mut [f64]) {
        let Self {
            scaled,
            equality,
            cross,
            active,
            ..
        } = self;
        let (n, e, k) = (scaled.n, scaled.equalities, active.rows.len());
        let (m, count) = (n - e, columns.len() / n.max(1));
        let (equality, cross) = (&equality[..e * e], &cross[..e * m]);
        let (own, scratch) = scratch.split_at_mut(count * e);
        let (others, scratch) = scratch.split_at_mut(count * m);
        let held = &mut scratch[..count * k];
        // Place among the held, and among the others.
        let places = || {
            let rows = active.rows.iter().enumerate();
            (0..count).flat_map(move |index| {
                let at = move |(place, row): (usize, &usize)| (index * k + place, index * m + row);
                rows.clone().map(at)
            })
        };
        for (index, column) in columns.chunks_exact(n.max(1)).enumerate() {
            for (at, (row, scale)) in scaled.order.iter().zip(&scaled.scale).enumerate() {
                let value = column[*row] * scale;
                match at.checked_sub(e) {
                    None => own[index * e + at] = value,
                    Some(other) => others[index * m + other] = value,
                }
            }
        }
        if e > 0 {
            solve_lower(equality, e, own, count);
            subtract_product(cross, own, others, (e, m, count));
        }
        if k > 0 {
            places().for_each(|(place, other)| held[place] = others[other]);
            dense.solve(&active.matrix[..k * k], k, held, count);
        }
        others.fill(0.0);
        places().for_each(|(place, other)| others[other] = held[place]);
        if e > 0 {
            subtract_combination(cross, others, own, (m, e, count));
            solve_lower_transposed(equality, e, own, count);
        }
        for (index, column) in columns.chunks_exact_mut(n.max(1)).enumerate() {
            let held = active.rows.iter().map(|row| e + row);
            for at in (0..e).chain(held) {
                let value = match at.checked_sub(e) {
                    None => own[index * e + at],
                    Some(other) => others[index * m + other],
                };
                column[scaled.order[at]] = value * scaled.scale[at];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Method, Mode, Problem, Row, RowKind, State, Status, solve};
    use super::*;

    const N: usize = 9;
    const LEAST: f64 = 1e-9;

    /// What the factors of a solve answer is what the held rows' own compliance does, whichever rows are held.
    #[test]
    fn held_rows_answer_by_their_own_compliance() {
        let mut random = sutura_testkit::Random::new(5);
        let mut random = || random.signed();
        let (mut work, mut dense) = (Workspace::new(N), Dense::new(N));
        let (mut most, mut fewest) = (0, N);
        for round in 0..300 {
            let mut w = [0.0; N * N];
            let root: [f64; N * N] = std::array::from_fn(|_| random());
            for (entry, value) in w.iter_mut().enumerate() {
                let (i, j) = (entry % N, entry / N);
                let product: f64 = (0..N).map(|k| root[k * N + i] * root[k * N + j]).sum();
                *value = product + if i == j { 0.1 } else { 0.0 };
            }
            let kinds = [
                RowKind::Equality,
                RowKind::Inequality,
                RowKind::Box { limit_n: 0.3 },
            ];
            let rows: [Row; N] = std::array::from_fn(|row| Row {
                id: row as u64,
                // From all of one kind to a mixture.
                kind: kinds[match round % 5 {
                    kind @ 0..3 => kind,
                    more => (row * more) % 3,
                }],
            });
            let delta_free: [f64; N] = std::array::from_fn(|_| random());
            let problem = Problem {
                rows: &rows,
                compliance: &w,
                delta_free: &delta_free,
            };
            let mut state = State::new(N);
            let outcome = solve(&problem, Method::ActiveSet, &mut state, &mut work);
            assert_eq!(outcome.status, Status::Ok);
            let mut free = [false; N];
            for (free, mode) in free.iter_mut().zip(state.modes()) {
                *free = *mode != Mode::Held;
            }
            let held = free.iter().filter(|free| !**free).count();
            (most, fewest) = (most.max(held), fewest.min(held));
            assert!(work.answers(&free, LEAST));
            assert!(!work.answers(&free, 1.0 + LEAST));
            assert!(!work.answers(&free[1..], LEAST));
            let source: [f64; 2 * N] = std::array::from_fn(|_| random());
            let (mut columns, mut scratch) = (source, [0.0; 4 * N]);
            work.answer(&mut columns, &mut dense, &mut scratch);
            for (column, source) in columns.chunks_exact(N).zip(source.chunks_exact(N)) {
                for row in 0..N {
                    let own = |other: &usize| !free[*other];
                    let made: f64 = (0..N)
                        .filter(own)
                        .map(|other| w[other * N + row] * column[other])
                        .sum();
                    let found = if free[row] { column[row] } else { made };
                    assert!((found - source[row]).abs() < 1e-9, "{round}: {found}");
                }
            }
            free[round % N] ^= true;
            assert!(!work.answers(&free, LEAST));
            free[round % N] ^= true;
            work.forget_factors();
            assert!(!work.answers(&free, LEAST));
        }
        assert_eq!((most, fewest), (N, 1));
    }
}
