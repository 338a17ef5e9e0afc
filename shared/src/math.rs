//! The few functions of real numbers that the console needs, with the same bits on every machine.
//!
//! Basic arithmetic and the square root are rounded correctly everywhere; everything else that `std`,
//! `libm` or nalgebra's wrappers offer is not, or not by contract, and is banned by `clippy.toml`.
//! Sources: Cody and Waite 1980 (range reduction), Moshier's Cephes library (minimax coefficients).

/// A vector in the world frame, (3).
pub type Vec3 = nalgebra::Vector3<f32>;

/// The smaller one; `b` if they compare equal (zeros of different sign) or if either is NaN.
#[inline]
pub fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger one; `b` if they compare equal (zeros of different sign) or if either is NaN.
#[inline]
pub fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `x` moved into `low..=high`. Values inside, zeros of either sign at a limit of zero, and NaN pass
/// unchanged.
#[inline]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    if x < low {
        low
    } else if x > high {
        high
    } else {
        x
    }
}

/// `x` without its part in `-width..=width`: what friction of that size leaves of a push. The result is
/// zero inside the band, and NaN for NaN.
#[inline]
pub fn shrink(x: f32, width: f32) -> f32 {
    x - clamp(x, -width, width)
}

/// Bits of `x` with only one NaN, for hashes: machines differ in the sign and payload of a NaN that they
/// produce.
#[inline]
pub fn canonical(x: f32) -> u32 {
    if x.is_nan() { 0x7fc0_0000 } else { x.to_bits() }
}

/// Scalar product, summed from x to z.
#[inline]
pub fn dot(a: &Vec3, b: &Vec3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

/// Whether no component is infinite or NaN.
#[inline]
pub fn is_finite(v: &Vec3) -> bool {
    v.x.is_finite() && v.y.is_finite() && v.z.is_finite()
}

/// `v`, shortened to `length` if it is longer. The components must be below 1e18 in magnitude.
///
/// The square root is `libm`'s, by name: correctly rounded like the instructions of x86 and ARM, so that
/// it does not matter which of them it becomes. In software it costs more than the rest of this
/// function, hence the comparison of squares first.
#[inline]
pub fn shortened(v: Vec3, length: f32) -> Vec3 {
    let square = dot(&v, &v);
    if square > length * length {
        v * (length / libm::sqrtf(square))
    } else {
        v
    }
}

/// Largest argument of [`sincos`] \[rad\].
pub const SINCOS_LIMIT: f32 = 8192.0;

/// Sine and cosine of an angle \[rad\], in single precision throughout: `libm`'s would compute in double,
/// which the console has only in software.
///
/// The absolute error is at most 9e-8 up to [`SINCOS_LIMIT`] (1.5 units in the last place of 1; tested).
/// Beyond it, where the reduction to an eighth of a turn would fail, and for NaN the result is that of 0.
#[inline]
pub fn sincos(x: f32) -> (f32, f32) {
    // Adding 1.5 * 2^23 pushes the fraction out of the mantissa: rounds to the nearest integer.
    const ROUND: f32 = 12_582_912.0;
    // A quarter turn in three parts. The first two have so few bits that their products with up to
    // 8192 / (pi / 2) = 5215 quarter turns are exact.
    const QUARTER_1: f32 = 1.570_312_5;
    const QUARTER_2: f32 = 4.837_513e-4;
    const QUARTER_3: f32 = 7.549_79e-8;

    let x = if x.abs() <= SINCOS_LIMIT { x } else { 0.0 };
    let quarters = (x * core::f32::consts::FRAC_2_PI + ROUND) - ROUND;
    let r = ((x - quarters * QUARTER_1) - quarters * QUARTER_2) - quarters * QUARTER_3;
    let z = r * r;
    let sine = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * r + r;
    let cosine =
        ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
    match quarters as i32 & 3 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}
