//! Numbers the element kernels are written in: one f64, or a register of f32.
//!
//! Entry points: [`Float`], what is stored; [`Number`], what is computed with. Only sums, products and
//! explicit fused multiply-adds are used, so a kernel gives one set of bits on every processor.

use pulp::Simd;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// What is stored for each node and cell.
pub(super) trait Float:
    Copy
    + Debug
    + Default
    + PartialOrd
    + AddAssign
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Send
    + Sync
    + 'static
{
    /// What kernels compute with.
    type Number<S: Simd>: Number<S, Float = Self>;
    /// Nearest to `value`.
    fn of(value: f64) -> Self;
    /// The same number.
    fn wide(self) -> f64;
    /// `self * times + plus`, rounded once.
    fn fma(self, times: Self, plus: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
}

macro_rules! float {
    ($float:ident, $number:ty) => {
        impl Float for $float {
            type Number<S: Simd> = $number;
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn fma(self, times: Self, plus: Self) -> Self {
                self.mul_add(times, plus)
            }
            #[inline(always)]
            fn root(self) -> Self {
                self.sqrt()
            }
        }
    };
}
float!(f64, f64);
float!(f32, Wide<S>);

/// One or several values of a kernel's variable.
pub(super) trait Number<S: Simd>:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    type Float: Float;
    /// Values in one.
    const LANES: usize;
    /// Newton steps that make an inverse cube root exact to rounding.
    const ROOT_STEPS: usize;
    /// The first [`Self::LANES`] of `from`.
    fn load(simd: S, from: &[Self::Float]) -> Self;
    /// Into the first [`Self::LANES`] of `to`.
    fn store(self, to: &mut [Self::Float]);
    /// `value` in every lane.
    fn like(self, value: f64) -> Self;
    /// `self * times + plus`, rounded once.
    fn fma(self, times: Self, plus: Self) -> Self;
    /// Smaller of two.
    fn least(self, other: Self) -> Self;
    /// Larger of two.
    fn most(self, other: Self) -> Self;

    /// `self^(-1/3)` for [`LOW`] to [`HIGH`]: a polynomial good to 4.4 %, then steps of third order.
    #[inline(always)]
    fn inverse_cube_root(self) -> Self {
        let c = |value| self.like(value);
        let mut r = c(0.014_734_672_026_251_373);
        for coefficient in [
            -0.182_034_420_527_439_5,
            0.802_658_609_318_312_8,
            -1.565_941_068_732_209_7,
            1.918_485_550_154_117_6,
        ] {
            r = r.fma(self, c(coefficient));
        }
        for _ in 0..Self::ROOT_STEPS {
            let miss = (-(self * r)).fma(r * r, c(1.0));
            r = (r * miss).fma(miss.fma(c(2.0 / 9.0), c(1.0 / 3.0)), r);
        }
        r
    }
}

/// Range of [`Number::inverse_cube_root`].
pub(super) const LOW: f64 = 0.2;
pub(super) const HIGH: f64 = 5.0;

impl<S: Simd> Number<S> for f64 {
    type Float = f64;
    const LANES: usize = 1;
    const ROOT_STEPS: usize = 3;
    #[inline(always)]
    fn load(_: S, from: &[f64]) -> Self {
        from[0]
    }
    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        to[0] = self;
    }
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn fma(self, times: Self, plus: Self) -> Self {
        self.mul_add(times, plus)
    }
    #[inline(always)]
    fn least(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn most(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

/// A register of f32.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    simd: S,
    values: S::f32s,
}

impl<S: Simd> Wide<S> {
    #[inline(always)]
    fn with(self, values: S::f32s) -> Self {
        Self {
            simd: self.simd,
            values,
        }
    }
}

macro_rules! operator {
    ($name:ident, $method:ident, $of_simd:ident) => {
        impl<S: Simd> $name for Wide<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(self.simd.$of_simd(self.values, other.values))
            }
        }
    };
}
operator!(Add, add, add_f32s);
operator!(Sub, sub, sub_f32s);
operator!(Mul, mul, mul_f32s);
operator!(Div, div, div_f32s);

impl<S: Simd> Neg for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self.simd.neg_f32s(self.values))
    }
}

impl<S: Simd> Number<S> for Wide<S> {
    type Float = f32;
    const LANES: usize = S::F32_LANES;
    const ROOT_STEPS: usize = 2;
    #[inline(always)]
    fn load(simd: S, from: &[f32]) -> Self {
        let (whole, _) = S::as_simd_f32s(from);
        Self {
            simd,
            values: whole[0],
        }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let (whole, _) = S::as_mut_simd_f32s(to);
        whole[0] = self.values;
    }
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        self.with(self.simd.splat_f32s(value as f32))
    }
    #[inline(always)]
    fn fma(self, times: Self, plus: Self) -> Self {
        self.with(
            self.simd
                .mul_add_f32s(self.values, times.values, plus.values),
        )
    }
    #[inline(always)]
    fn least(self, other: Self) -> Self {
        self.with(self.simd.min_f32s(self.values, other.values))
    }
    #[inline(always)]
    fn most(self, other: Self) -> Self {
        self.with(self.simd.max_f32s(self.values, other.values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    struct Roots;
    impl WithSimd for Roots {
        type Output = ();
        fn with_simd<S: Simd>(self, simd: S) {
            for k in 0..=10_000 {
                let x = LOW * (HIGH / LOW).powf(f64::from(k) / 1e4);
                let exact = x.powf(-1.0 / 3.0);
                let double = Number::<S>::inverse_cube_root(x);
                assert!((double / exact - 1.0).abs() < 1e-15, "{x}: {double}");
                let mut lanes = [0f32; 16];
                Wide::load(simd, &[x as f32; 16])
                    .inverse_cube_root()
                    .store(&mut lanes);
                assert!((f64::from(lanes[0]) / exact - 1.0).abs() < 3e-7, "{x}");
            }
        }
    }

    #[test]
    fn cube_roots_are_exact_to_rounding() {
        Arch::new().dispatch(Roots);
    }
}
