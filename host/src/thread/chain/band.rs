//! A symmetric matrix with few diagonals, factored as L D L' without pivoting.
//!
//! Entry points: [`Band::factor`], [`Band::solve`]. The equations of a chain, unknowns and multipliers in their order along
//! it, have such a factor: each leading block is a chain's, too, which is regular.

/// Diagonals below the main one: two points of three coordinates and two multipliers, and what couples them.
const WIDTH: usize = 10;

/// The lower half of a symmetric matrix, by rows; after [`Self::factor`] L and D.
#[derive(Clone, Debug)]
pub(super) struct Band {
    rows: Vec<[f64; WIDTH + 1]>,
}

impl Band {
    /// With room for `most` unknowns.
    pub fn new(most: usize) -> Self {
        Self {
            rows: Vec::with_capacity(most),
        }
    }

    /// A zero matrix of n x n.
    pub fn clear(&mut self, n: usize) {
        self.rows.clear();
        self.rows.resize(n, [0.0; WIDTH + 1]);
    }

    /// Adds to an entry and its mirror image, given once; what is above the diagonal is left to the image.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        if column <= row && row - column <= WIDTH {
            self.rows[row][WIDTH + column - row] += value;
        }
    }

    /// Whether it has a factor, which takes its place.
    pub fn factor(&mut self) -> bool {
        for row in 0..self.rows.len() {
            let first = row.saturating_sub(WIDTH);
            let (above, rest) = self.rows.split_at_mut(row);
            let entries = &mut rest[0];
            // First L D, then L: D is needed once all of the row is there.
            for column in first..row {
                let other = &above[column];
                let mut sum = entries[WIDTH + column - row];
                for k in first.max(column.saturating_sub(WIDTH))..column {
                    sum -= entries[WIDTH + k - row] * other[WIDTH + k - column];
                }
                entries[WIDTH + column - row] = sum;
            }
            for column in first..row {
                let scaled = entries[WIDTH + column - row];
                let lower = scaled / above[column][WIDTH];
                entries[WIDTH] -= scaled * lower;
                entries[WIDTH + column - row] = lower;
            }
            let pivot = entries[WIDTH];
            if pivot == 0.0 || !pivot.is_finite() {
                return false;
            }
        }
        true
    }

    /// Solves in place with the factor.
    pub fn solve(&self, x: &mut [f64]) {
        for (row, entries) in self.rows.iter().enumerate() {
            let first = row.saturating_sub(WIDTH);
            for k in first..row {
                x[row] -= entries[WIDTH + k - row] * x[k];
            }
        }
        for (x, entries) in x.iter_mut().zip(&self.rows) {
            *x /= entries[WIDTH];
        }
        for (row, entries) in self.rows.iter().enumerate().rev() {
            let first = row.saturating_sub(WIDTH);
            for k in first..row {
                x[k] -= entries[WIDTH + k - row] * x[row];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_solves_what_it_was_given() {
        for n in [1, 5, 40] {
            let entry = |i: usize, j: usize| {
                let (i, j) = (i.max(j), i.min(j));
                if i == j {
                    // Of either sign.
                    if i % 4 == 3 { -9.0 } else { 8.0 + i as f64 }
                } else if i - j <= WIDTH {
                    ((i * 31 + j * 17) as f64).sin()
                } else {
                    0.0
                }
            };
            let mut band = Band::new(n);
            band.clear(n);
            for i in 0..n {
                for j in 0..n {
                    band.add(i, j, entry(i, j));
                }
            }
            let truth: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
            let product = |x: &[f64], i: usize| (0..n).map(|j| entry(i, j) * x[j]).sum::<f64>();
            let mut x: Vec<f64> = (0..n).map(|i| product(&truth, i)).collect();
            assert!(band.factor());
            band.solve(&mut x);
            for (x, truth) in x.iter().zip(&truth) {
                assert!((x - truth).abs() < 1e-10, "{x} {truth}");
            }
        }
        let mut band = Band::new(2);
        band.clear(2);
        band.add(0, 0, 1.0);
        assert!(!band.factor(), "nothing holds the second");
    }
}
