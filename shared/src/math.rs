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

/// Rotation vector \[rad\], world frame, that takes the orientation `from` to `to`, unit quaternions (x, y, z, w): the
/// shorter way, right to 1e-4 of itself up to 1 rad, and bounded beyond.
#[inline]
pub fn rotation_between(from: &[f32; 4], to: &[f32; 4]) -> Vec3 {
    // Where it is not sensed, or rests.
    if from == to {
        return Vec3::zeros();
    }
    let [x, y, z, w] = *to;
    let [fx, fy, fz, fw] = *from;
    let (a, b) = (Vec3::new(x, y, z), Vec3::new(fx, fy, fz));
    // to * conjugate(from)
    let half = a * fw - b * w
        + Vec3::new(
            b.y * a.z - b.z * a.y,
            b.z * a.x - b.x * a.z,
            b.x * a.y - b.y * a.x,
        );
    let cosine = w * fw + dot(&a, &b);
    let half = if cosine < 0.0 { -half } else { half };
    // 2 asin(s) / s with s = |half|, the sine of half the angle.
    let z = min(dot(&half, &half), 1.0);
    half * (2.0
        * (1.0 + z * (1.0 / 6.0 + z * (3.0 / 40.0 + z * (15.0 / 336.0 + z * (105.0 / 3456.0))))))
}

/// Scalar product of six numbers, summed in their order.
#[inline]
pub fn dot6(a: &[f32; 6], b: &[f32; 6]) -> f32 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

/// Largest argument of [`sincos`] \[rad\].
pub const SINCOS_LIMIT: f32 = 8192.0;

/// Sine and cosine of an angle \[rad\], in single precision throughout: `libm`'s would compute in double,
/// which the console has only in software.
///
/// The absolute error is at most 8e-8 up to [`SINCOS_LIMIT`], 1.3 units in the last place of 1 (tested against double precision).
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

#[cfg(test)]
mod tests {
    use super::*;

    const NAN: f32 = f32::NAN;

    /// Largest absolute error of sine and cosine against `std` in double precision.
    fn largest_error(arguments: impl Iterator<Item = f32>) -> f64 {
        let errors = arguments.map(|x| {
            let (sine, cosine) = sincos(x);
            let (exact_sine, exact_cosine) = f64::from(x).sin_cos();
            let error = (f64::from(sine) - exact_sine).abs();
            error.max((f64::from(cosine) - exact_cosine).abs())
        });
        errors.fold(0.0, f64::max)
    }

    /// Every 97th number of one sign between two magnitudes, evenly spread over the representable ones.
    fn numbers(from: f32, to: f32) -> impl Iterator<Item = f32> {
        let bits = (from.to_bits()..=to.to_bits()).step_by(97);
        bits.map(f32::from_bits)
            .flat_map(|magnitude| [magnitude, -magnitude])
    }

    #[test]
    fn sincos_is_as_exact_as_it_says() {
        let joints = largest_error(numbers(1e-3, 10.0));
        let large = largest_error(numbers(10.0, SINCOS_LIMIT));
        std::println!("sincos: {joints:e} up to 10 rad, {large:e} up to {SINCOS_LIMIT} rad");
        assert!(joints <= 8e-8, "{joints:e}");
        assert!(large <= 8e-8, "{large:e}");
    }

    #[test]
    fn sincos_of_little_and_of_far_too_much() {
        for tiny in [0.0, f32::from_bits(1), f32::MIN_POSITIVE, 1e-5] {
            assert_eq!(sincos(tiny), (tiny, 1.0));
            assert_eq!(sincos(-tiny), (-tiny, 1.0));
        }
        for far in [SINCOS_LIMIT * 1.001, 1e9, f32::INFINITY, -f32::MAX, NAN] {
            assert_eq!(sincos(far), (0.0, 1.0));
        }
    }

    /// Against the quaternions that nalgebra makes in double precision.
    #[test]
    fn a_rotation_vector_takes_one_orientation_to_the_other() {
        use nalgebra::{Quaternion, UnitQuaternion, Vector3};
        let from = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.9);
        let of = |q: &UnitQuaternion<f64>| {
            let Quaternion { coords } = *q.quaternion();
            [coords.x, coords.y, coords.z, coords.w].map(|x| x as f32)
        };
        for angle in [0.0, 1e-4, 0.01, 0.3, 1.0] {
            let turn = Vector3::new(0.36, -0.48, 0.8) * angle;
            let to = UnitQuaternion::from_scaled_axis(turn) * from;
            for sign in [1.0, -1.0] {
                let found = rotation_between(&of(&from), &of(&to).map(|x| x * sign));
                let error = found.map(f64::from) - turn;
                let most = 1e-4 * angle + 1e-6;
                assert!(error.dot(&error) < most * most, "{angle}: {error}");
            }
        }
        let half = rotation_between(&[0.0, 0.0, 0.0, 1.0], &[0.0, 0.0, 1.0, 0.0]);
        assert!(half.z > 2.0 && half.z < 3.2);
    }

    #[test]
    fn ties_and_nan_are_defined() {
        let bits = |x: f32| x.to_bits();
        assert_eq!(bits(min(0.0, -0.0)), bits(-0.0));
        assert_eq!(bits(min(-0.0, 0.0)), bits(0.0));
        assert_eq!(bits(max(0.0, -0.0)), bits(-0.0));
        assert_eq!(bits(max(-0.0, 0.0)), bits(0.0));
        assert_eq!((min(NAN, 1.0), max(NAN, 1.0)), (1.0, 1.0));
        assert!(min(1.0, NAN).is_nan() && max(1.0, NAN).is_nan());
        assert_eq!((min(1.0, 2.0), max(1.0, 2.0)), (1.0, 2.0));

        assert_eq!(bits(clamp(-0.0, 0.0, 1.0)), bits(-0.0));
        assert_eq!(bits(clamp(0.0, -1.0, -0.0)), bits(0.0));
        assert!(clamp(NAN, -1.0, 1.0).is_nan());
        assert_eq!(clamp(f32::INFINITY, -1.0, 1.0), 1.0);
        assert_eq!(clamp(-5.0, -1.0, 1.0), -1.0);

        assert_eq!((shrink(0.5, 1.0), shrink(-1.0, 1.0)), (0.0, 0.0));
        assert_eq!((shrink(3.0, 1.0), shrink(-3.0, 1.0)), (2.0, -2.0));
        assert!(shrink(NAN, 1.0).is_nan());
    }

    #[test]
    fn one_nan_for_hashes() {
        let nans = [
            NAN,
            -NAN,
            f32::from_bits(0x7f80_0001),
            f32::from_bits(0xffff_ffff),
        ];
        assert!(nans.iter().all(|nan| canonical(*nan) == 0x7fc0_0000));
        for x in [0.0, -0.0, f32::from_bits(1), f32::INFINITY, -1.5] {
            assert_eq!(canonical(x), x.to_bits());
        }
    }

    #[test]
    fn only_what_is_too_long_is_shortened() {
        let v = Vec3::new(3.0, -4.0, 0.0);
        assert_eq!(shortened(v, 5.0), v);
        assert_eq!(shortened(v, 2.5), Vec3::new(1.5, -2.0, 0.0));
        // Squares that vanish are no reason to divide by 0.
        let tiny = Vec3::new(1e-30, -0.0, 0.0);
        assert_eq!(shortened(tiny, 1.0), tiny);
    }
}
