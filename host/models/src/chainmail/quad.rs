//! Four numbers at once: a vector with a fourth component of zero, or one number for each of four links.
//!
//! Entry point: [`Quad`]. Plain arrays, which the compiler keeps in one register where the processor has such; sums and
//! products only, never fused, so that every processor gives the same bits.

use std::ops::{Add, Mul, Neg, Sub};

/// Four numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(32))]
pub(super) struct Quad(pub [f64; 4]);

impl Quad {
    /// None.
    pub const ZERO: Self = Self([0.0; 4]);

    /// A vector.
    #[inline(always)]
    pub fn of([x, y, z]: [f64; 3]) -> Self {
        Self([x, y, z, 0.0])
    }

    /// A vector's components.
    #[inline(always)]
    pub fn xyz(self) -> [f64; 3] {
        [self.0[0], self.0[1], self.0[2]]
    }

    /// Sum of the first three components' squares.
    #[inline(always)]
    pub fn square(self) -> f64 {
        self.0[0] * self.0[0] + self.0[1] * self.0[1] + self.0[2] * self.0[2]
    }

    /// The components one place on: (y, z, x).
    #[inline(always)]
    pub fn turn(self) -> Self {
        let [x, y, z, rest] = self.0;
        Self([y, z, x, rest])
    }

    /// Whether any is not 0.
    #[inline(always)]
    pub fn any(self) -> bool {
        self.0.iter().any(|a| *a != 0.0)
    }

    /// Sum of all four.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        (self.0[0] + self.0[1]) + (self.0[2] + self.0[3])
    }

    /// Squares of four vectors' lengths.
    #[inline(always)]
    pub fn squares(d: [Self; 4]) -> Self {
        let of = |axis: usize| Self(d.map(|d| d.0[axis] * d.0[axis]));
        of(0) + of(1) + of(2)
    }

    /// Smaller of each pair; `other`'s where one is not a number.
    #[inline(always)]
    pub fn least(self, other: Self) -> Self {
        self.each(other, |a, b| if a < b { a } else { b })
    }

    /// Larger of each pair; `other`'s where one is not a number.
    #[inline(always)]
    pub fn most(self, other: Self) -> Self {
        self.each(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn each(self, other: Self, of: impl Fn(f64, f64) -> f64) -> Self {
        let (a, b) = (self.0, other.0);
        Self([
            of(a[0], b[0]),
            of(a[1], b[1]),
            of(a[2], b[2]),
            of(a[3], b[3]),
        ])
    }
}

impl Add for Quad {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
    }
}

impl Sub for Quad {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.each(other, |a, b| a - b)
    }
}

impl Mul for Quad {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.each(other, |a, b| a * b)
    }
}

impl Mul<Quad> for f64 {
    type Output = Quad;
    #[inline(always)]
    fn mul(self, of: Quad) -> Quad {
        Quad([self; 4]) * of
    }
}

impl Neg for Quad {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|a| -a))
    }
}
