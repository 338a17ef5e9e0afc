//! Numbers the element kernels are written in: one f64, or a register of f32.
//!
//! Entry points: [`Float`], what is stored; [`Number`], what is computed with. Only sums, products and
//! explicit fused multiply-adds are used, so a kernel gives one set of bits on every processor.

use super::nodes::Rows;
use pulp::{Arch, Simd};
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
    /// Distance from 1 to the next.
    const EPSILON: f64;
    /// Nearest to `value`.
    fn of(value: f64) -> Self;
    /// The same number.
    fn wide(self) -> f64;
    /// `self * times + plus`, rounded once.
    fn fma(self, times: Self, plus: Self) -> Self;
}

macro_rules! float {
    ($float:ident, $number:ty) => {
        impl Float for $float {
            type Number<S: Simd> = $number;
            const EPSILON: f64 = $float::EPSILON as f64;
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
        }
    };
}
float!(f64, f64);
float!(f32, Wide<S>);

/// One or several values of a kernel's variable.
///
/// Kernels call methods in plain loops: what a closure or `array::map` does is compiled for the least processor and
/// called from there, register by register.
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
    /// The four numbers of each of the first [`Self::LANES`] of `nodes`, number by number.
    fn gather(simd: S, field: &Rows<Self::Float>, nodes: &[u16]) -> [Self; 4];
    /// Back to the nodes in place of what was there; no two nodes may be the same.
    fn put(numbers: [Self; 4], field: &mut Rows<Self::Float>, nodes: &[u16]);
    /// Adds to the nodes, one after another.
    fn add_to(numbers: [Self; 4], field: &mut Rows<Self::Float>, nodes: &[u16]);
    /// `value` in every lane.
    fn like(self, value: f64) -> Self;
    /// `self * times + plus`, rounded once.
    fn fma(self, times: Self, plus: Self) -> Self;
    /// `from - self * times`, rounded once.
    fn fnma(self, times: Self, from: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// Smaller of two.
    fn least(self, other: Self) -> Self;
    /// Larger of two.
    fn most(self, other: Self) -> Self;

    /// `self^(-1/3)` for [`LOW`] to [`HIGH`]: a polynomial good to 4.4 %, then steps of third order.
    #[inline(always)]
    fn inverse_cube_root(self) -> Self {
        let mut r = self.like(0.014_734_672_026_251_373);
        for coefficient in [
            -0.182_034_420_527_439_5,
            0.802_658_609_318_312_8,
            -1.565_941_068_732_209_7,
            1.918_485_550_154_117_6,
        ] {
            r = r.fma(self, self.like(coefficient));
        }
        for _ in 0..Self::ROOT_STEPS {
            let miss = (self * r).fnma(r * r, self.like(1.0));
            let by = miss.fma(self.like(2.0 / 9.0), self.like(1.0 / 3.0));
            r = (r * miss).fma(by, r);
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
    fn gather(_: S, field: &Rows<f64>, nodes: &[u16]) -> [Self; 4] {
        field[nodes[0] as usize]
    }
    #[inline(always)]
    fn put(numbers: [Self; 4], field: &mut Rows<f64>, nodes: &[u16]) {
        field[nodes[0] as usize] = numbers;
    }
    #[inline(always)]
    fn add_to(numbers: [Self; 4], field: &mut Rows<f64>, nodes: &[u16]) {
        let to = &mut field[nodes[0] as usize];
        for c in 0..4 {
            to[c] += numbers[c];
        }
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
    fn fnma(self, times: Self, from: Self) -> Self {
        (-self).mul_add(times, from)
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
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

/// Two registers of f32: while one waits for a result, the processor works on the other.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    simd: S,
    values: [S::f32s; 2],
}

/// Most lanes of f32 a register has: two registers are a batch.
const MOST_LANES: usize = 8;

/// The widest registers of up to [`MOST_LANES`]; not AVX-512, also where another crate asks `pulp` for it.
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
pub(super) fn arch() -> Arch {
    pulp::x86::V3::try_new().map_or(Arch::Scalar, Arch::V3)
}

/// The widest registers there are.
#[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
pub(super) fn arch() -> Arch {
    Arch::new()
}

/// Lane to which pulp's transposition brings the row in a `slot`: the rows in a quarter of a register are
/// transposed among themselves.
#[inline(always)]
fn lane_of<S: Simd>(slot: usize) -> usize {
    let parts = S::F32_LANES.div_ceil(4);
    slot % parts * 4 + slot / parts
}

/// Nodes of the first register, and of the second.
#[inline(always)]
fn halves<S: Simd>(nodes: &[u16]) -> [&[u16]; 2] {
    let (first, second) = nodes.split_at(S::F32_LANES);
    [first, second]
}

/// The nodes' rows of four numbers, number by number.
#[inline(always)]
fn columns<S: Simd>(simd: S, field: &Rows<f32>, nodes: &[u16]) -> [S::f32s; 4] {
    let mut rows = [[0f32; 4]; MOST_LANES];
    for slot in 0..S::F32_LANES {
        rows[slot] = field[nodes[lane_of::<S>(slot)] as usize];
    }
    let (whole, _) = S::as_simd_f32s(rows.as_flattened());
    simd.deinterleave_shfl_f32s([whole[0], whole[1], whole[2], whole[3]])
}

/// One row of four numbers for each slot.
#[inline(always)]
fn rows<S: Simd>(simd: S, columns: [S::f32s; 4]) -> [[f32; 4]; MOST_LANES] {
    let mut rows = [[0f32; 4]; MOST_LANES];
    let (whole, _) = S::as_mut_simd_f32s(rows.as_flattened_mut());
    whole[..4].copy_from_slice(&simd.interleave_shfl_f32s(columns));
    rows
}

impl<S: Simd> Wide<S> {
    /// Number by number of each register.
    #[inline(always)]
    fn registers(numbers: [Self; 4]) -> [[S::f32s; 4]; 2] {
        let [a, b, c, d] = numbers;
        [
            [a.values[0], b.values[0], c.values[0], d.values[0]],
            [a.values[1], b.values[1], c.values[1], d.values[1]],
        ]
    }
}

macro_rules! operator {
    ($name:ident, $method:ident, $of_simd:ident) => {
        impl<S: Simd> $name for Wide<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                let Self { simd, values: a } = self;
                let b = other.values;
                let values = [simd.$of_simd(a[0], b[0]), simd.$of_simd(a[1], b[1])];
                Self { simd, values }
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
        let Self { simd, values: a } = self;
        let zero = simd.splat_f32s(-0.0);
        let values = [simd.sub_f32s(zero, a[0]), simd.sub_f32s(zero, a[1])];
        Self { simd, values }
    }
}

impl<S: Simd> Number<S> for Wide<S> {
    type Float = f32;
    const LANES: usize = 2 * S::F32_LANES;
    const ROOT_STEPS: usize = 2;
    #[inline(always)]
    fn load(simd: S, from: &[f32]) -> Self {
        let (whole, _) = S::as_simd_f32s(from);
        let values = [whole[0], whole[1]];
        Self { simd, values }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let (whole, _) = S::as_mut_simd_f32s(to);
        whole[0] = self.values[0];
        whole[1] = self.values[1];
    }
    #[inline(always)]
    fn gather(simd: S, field: &Rows<f32>, nodes: &[u16]) -> [Self; 4] {
        let nodes = halves::<S>(nodes);
        let a = columns(simd, field, nodes[0]);
        let b = columns(simd, field, nodes[1]);
        let both = |values: [S::f32s; 2]| Self { simd, values };
        [
            both([a[0], b[0]]),
            both([a[1], b[1]]),
            both([a[2], b[2]]),
            both([a[3], b[3]]),
        ]
    }
    #[inline(always)]
    fn put(numbers: [Self; 4], field: &mut Rows<f32>, nodes: &[u16]) {
        let nodes = halves::<S>(nodes);
        let registers = Self::registers(numbers);
        for half in 0..2 {
            let rows = rows(numbers[0].simd, registers[half]);
            for slot in 0..S::F32_LANES {
                field[nodes[half][lane_of::<S>(slot)] as usize] = rows[slot];
            }
        }
    }
    #[inline(always)]
    fn add_to(numbers: [Self; 4], field: &mut Rows<f32>, nodes: &[u16]) {
        let nodes = halves::<S>(nodes);
        let registers = Self::registers(numbers);
        for half in 0..2 {
            let rows = rows(numbers[0].simd, registers[half]);
            for slot in 0..S::F32_LANES {
                let to = &mut field[nodes[half][lane_of::<S>(slot)] as usize];
                for c in 0..4 {
                    to[c] += rows[slot][c];
                }
            }
        }
    }
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        let one = self.simd.splat_f32s(value as f32);
        Self {
            simd: self.simd,
            values: [one, one],
        }
    }
    #[inline(always)]
    fn fma(self, times: Self, plus: Self) -> Self {
        let Self { simd, values: a } = self;
        let (b, c) = (times.values, plus.values);
        let values = [
            simd.mul_add_f32s(a[0], b[0], c[0]),
            simd.mul_add_f32s(a[1], b[1], c[1]),
        ];
        Self { simd, values }
    }
    #[inline(always)]
    fn fnma(self, times: Self, from: Self) -> Self {
        let Self { simd, values: a } = self;
        let (b, c) = (times.values, from.values);
        let values = [
            simd.negate_mul_add_f32s(a[0], b[0], c[0]),
            simd.negate_mul_add_f32s(a[1], b[1], c[1]),
        ];
        Self { simd, values }
    }
    #[inline(always)]
    fn root(self) -> Self {
        let Self { simd, values: a } = self;
        let values = [simd.sqrt_f32s(a[0]), simd.sqrt_f32s(a[1])];
        Self { simd, values }
    }
    #[inline(always)]
    fn least(self, other: Self) -> Self {
        let Self { simd, values: a } = self;
        let b = other.values;
        let values = [simd.min_f32s(a[0], b[0]), simd.min_f32s(a[1], b[1])];
        Self { simd, values }
    }
    #[inline(always)]
    fn most(self, other: Self) -> Self {
        let Self { simd, values: a } = self;
        let b = other.values;
        let values = [simd.max_f32s(a[0], b[0]), simd.max_f32s(a[1], b[1])];
        Self { simd, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::WithSimd;

    struct Lanes;
    impl WithSimd for Lanes {
        type Output = [usize; 2];
        fn with_simd<S: Simd>(self, _: S) -> [usize; 2] {
            [<f32 as Float>::Number::<S>::LANES, S::F32_LANES]
        }
    }

    #[test]
    fn two_registers_are_no_more_than_a_batch() {
        let [both, one] = arch().dispatch(Lanes);
        assert!(one <= MOST_LANES && 16 % both == 0, "{both} {one}");
    }

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
        arch().dispatch(Roots);
    }

    struct Transposed;
    impl WithSimd for Transposed {
        type Output = ();
        fn with_simd<S: Simd>(self, simd: S) {
            let mut field = crate::energy_balance::nodes::Field::<f32>::new(99).expect("a field");
            for (node, row) in field.iter_mut().enumerate() {
                *row = [0.0, 0.25, 0.5, 0.75].map(|part| node as f32 + part);
            }
            let before = field.clone();
            let mut nodes = [0u16; 16];
            for (lane, node) in nodes.iter_mut().enumerate() {
                *node = (7 * lane as u16 + 3) % 97;
            }
            let numbers = Wide::gather(simd, field.rows(), &nodes);
            for (c, number) in numbers.iter().enumerate() {
                let mut lanes = [0f32; 16];
                number.store(&mut lanes);
                for lane in 0..<Wide<S> as Number<S>>::LANES {
                    assert_eq!(lanes[lane], before[nodes[lane] as usize][c]);
                }
            }
            Wide::put(numbers, field.rows_mut(), &nodes);
            assert_eq!(field[..], before[..]);
            Wide::add_to(numbers, field.rows_mut(), &nodes);
            for lane in 0..<Wide<S> as Number<S>>::LANES {
                let node = nodes[lane] as usize;
                assert_eq!(field[node], before[node].map(|x| x + x));
            }
        }
    }

    #[test]
    fn lanes_are_the_nodes_in_order() {
        arch().dispatch(Transposed);
        Arch::Scalar.dispatch(Transposed);
    }
}
