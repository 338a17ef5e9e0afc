//! The law of a slipping pair of rows, linearised.
//!
//! Entry points: [`Slip::new`] for the tangents of a cone, [`Slip::disc`]. With `q = x - r delta` a pair slips by
//! `x_t - mu x_n d - beta T (x_t - r delta_t) = 0`, `d = q_t / |q_t|`, `beta = mu q_n / |q_t|`,
//! `T = I - d d'` (Alart & Curnier 1991): at a solution the derivative of Coulomb's law. A disc of radius R has R in the place
//! of `mu x_n`, and of `mu q_n`.

/// A slipping pair.
pub(super) struct Slip {
    d: [f64; 2],
    beta: f64,
    r: f64,
    /// Of a cone; 0 of a disc.
    friction: f64,
    /// Of a disc; 0 of a cone.
    radius: f64,
}

impl Slip {
    /// For `q_n > 0` and `|q_t| > mu q_n`.
    pub fn new(friction: f64, q: [f64; 3], r: f64) -> Self {
        let length = q[1].hypot(q[2]);
        Self {
            d: [q[1] / length, q[2] / length],
            beta: friction * q[0] / length,
            r,
            friction,
            radius: 0.0,
        }
    }

    /// Of a disc, for `|q| > radius`.
    pub fn disc(radius: f64, q: [f64; 2], r: f64) -> Self {
        let length = q[0].hypot(q[1]);
        Self {
            d: q.map(|q| q / length),
            beta: radius / length,
            r,
            friction: 0.0,
            radius,
        }
    }

    /// `beta r T v`.
    fn turn(&self, v: [f64; 2]) -> [f64; 2] {
        let along = v[0] * self.d[0] + v[1] * self.d[1];
        let size = self.beta * self.r;
        [
            size * (v[0] - along * self.d[0]),
            size * (v[1] - along * self.d[1]),
        ]
    }

    /// Makes the rows of `delta_t` in a column, at `at` and behind it, rows of the slip law.
    pub fn replace(&self, column: &mut [f64], at: usize) {
        let turned = self.turn([column[at], column[at + 1]]);
        column[at..at + 2].copy_from_slice(&turned);
    }

    /// Adds to the right-hand side, at `at` and behind it, the force that does not follow any row.
    pub fn aim(&self, rhs: &mut [f64], at: usize) {
        for i in 0..2 {
            rhs[at + i] += self.radius * self.d[i];
        }
    }

    /// Adds what the slip law says of x itself; the normal of a cone is the row before `at`.
    pub fn complete(&self, matrix: &mut [f64], k: usize, at: usize) {
        for i in 0..2 {
            if self.friction > 0.0 {
                matrix[(at - 1) * k + at + i] -= self.friction * self.d[i];
            }
            for j in 0..2 {
                let identity = if i == j { 1.0 - self.beta } else { 0.0 };
                matrix[(at + j) * k + at + i] += identity + self.beta * self.d[i] * self.d[j];
            }
        }
    }
}
