//! Polar decomposition F = R S of a 3 x 3 matrix, safe for inverted and collapsed cells.
//!
//! Entry point: [`polar`]. R is the rotation nearest to F, the maximiser of tr(R'F): Newton's method on
//! the rotation group from the last R (third order, because an odd derivative vanishes at a symmetric
//! S), with the largest eigenvector of Davenport's 4 x 4 matrix (Horn 1987) where Newton's matrix
//! tr(S) I - S is not positive definite. Where it is, the maximiser is the global one.

use nalgebra::{Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3};

/// Newton takes two or three steps from a rotation within a radian; what takes more is odd.
const MOST_STEPS: usize = 8;

/// Below this turn \[rad\] its square, which the last stretch neglects, is below round-off; the next turn
/// all the more, as the order is three.
const LAST_TURN: f64 = 1e-7;

/// Determinant over the cube of the trace below which a symmetric matrix counts as singular.
const SINGULAR: f64 = 1e-12;

/// Symmetric S of F = R S, with R as a matrix. For an inverted F the smallest eigenvalue is negative.
#[derive(Clone, Copy, Debug)]
pub(super) struct Polar {
    pub rotation: Matrix3<f64>,
    pub stretch: Matrix3<f64>,
}

/// Decomposes a finite `f`, starting from `rotation` and leaving the result there. A zero matrix keeps
/// the rotation it had.
pub(super) fn polar(f: &Matrix3<f64>, rotation: &mut UnitQuaternion<f64>) -> Polar {
    if let Some(polar) = newton(f, rotation) {
        return polar;
    }
    nearest_rotation(f, rotation);
    newton(f, rotation).unwrap_or_else(|| {
        // Nearly flat: the rotation is hardly determined.
        let rotation = matrix(rotation);
        Polar {
            rotation,
            stretch: symmetric(&rotation.tr_mul(f)),
        }
    })
}

/// Newton's method; `None`, and the rotation as before, where it does not converge to the nearest.
fn newton(f: &Matrix3<f64>, rotation: &mut UnitQuaternion<f64>) -> Option<Polar> {
    let mut last = *rotation;
    for _ in 0..MOST_STEPS {
        let m = matrix(&last).tr_mul(f);
        let stretch = symmetric(&m);
        let turn = inverse(&twist_matrix(&stretch))? * twice_axial(&m);
        last = turned(&last, &turn);
        if turn.norm_squared() < LAST_TURN * LAST_TURN {
            *rotation = last;
            return Some(Polar {
                rotation: matrix(&last),
                // R'F becomes (I - [turn]) R'F to first order.
                stretch: symmetric(&(m - turn.cross_matrix() * stretch)),
            });
        }
    }
    None
}

/// tr(S) I - S: takes w to the axial vector of \[w\] S + S \[w\], so its inverse turns a spin of R'F
/// into the spin of R.
pub(super) fn twist_matrix(stretch: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal_element(stretch.trace()) - stretch
}

/// Axial vector of A - A'.
pub(super) fn twice_axial(a: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(
        a[(2, 1)] - a[(1, 2)],
        a[(0, 2)] - a[(2, 0)],
        a[(1, 0)] - a[(0, 1)],
    )
}

/// Inverse of a symmetric matrix; `None` unless it is positive definite with something to spare.
pub(super) fn inverse(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let (xx, yy, zz) = (a[(0, 0)], a[(1, 1)], a[(2, 2)]);
    let (xy, yz, zx) = (a[(1, 0)], a[(2, 1)], a[(2, 0)]);
    let c_xx = yy * zz - yz * yz;
    let c_xy = yz * zx - xy * zz;
    let c_zx = xy * yz - yy * zx;
    let c_zz = xx * yy - xy * xy;
    let determinant = xx * c_xx + xy * c_xy + zx * c_zx;
    let trace = xx + yy + zz;
    if !(xx > 0.0 && c_zz > 0.0 && determinant > SINGULAR * trace * trace * trace) {
        return None;
    }
    let c_yy = xx * zz - zx * zx;
    let c_yz = xy * zx - xx * yz;
    let adjugate = Matrix3::new(c_xx, c_xy, c_zx, c_xy, c_yy, c_yz, c_zx, c_yz, c_zz);
    Some(adjugate * determinant.recip())
}

fn symmetric(a: &Matrix3<f64>) -> Matrix3<f64> {
    let xy = 0.5 * (a[(1, 0)] + a[(0, 1)]);
    let yz = 0.5 * (a[(2, 1)] + a[(1, 2)]);
    let zx = 0.5 * (a[(2, 0)] + a[(0, 2)]);
    Matrix3::new(a[(0, 0)], xy, zx, xy, a[(1, 1)], yz, zx, yz, a[(2, 2)])
}

pub(super) fn matrix(rotation: &UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}

/// `rotation` times a turn, by Cayley's map: right to second order, and a rotation whatever the turn.
fn turned(rotation: &UnitQuaternion<f64>, turn: &Vector3<f64>) -> UnitQuaternion<f64> {
    let turn = Quaternion::from_parts(1.0, turn * 0.5);
    UnitQuaternion::new_normalize(rotation.into_inner() * turn)
}

/// tr(R'F) is a quadratic form in the quaternion of R; its largest eigenvector is the answer.
fn nearest_rotation(f: &Matrix3<f64>, rotation: &mut UnitQuaternion<f64>) {
    let largest = f.amax();
    if !(largest > 0.0 && largest.is_finite()) {
        return;
    }
    let f = f / largest;
    let (xx, yy, zz) = (f[(0, 0)], f[(1, 1)], f[(2, 2)]);
    let (xy, yz, zx) = (
        f[(0, 1)] + f[(1, 0)],
        f[(1, 2)] + f[(2, 1)],
        f[(2, 0)] + f[(0, 2)],
    );
    let spin = twice_axial(&f);
    #[rustfmt::skip]
    let form = Matrix4::new(
        xx + yy + zz, spin.x,       spin.y,       spin.z,
        spin.x,       xx - yy - zz, xy,           zx,
        spin.y,       xy,           yy - zz - xx, yz,
        spin.z,       zx,           yz,           zz - xx - yy,
    );
    let Some(eigen) = form.try_symmetric_eigen(f64::EPSILON, 100) else {
        return;
    };
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    *rotation = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
        // Four numbers in a box, not all tiny; half turns and no turn among them.
        let generic = prop::array::uniform4(-1.0..1.0f64)
            .prop_filter("not zero", |q| q.iter().any(|x| x.abs() > 0.1))
            .prop_map(|[w, x, y, z]| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)));
        let near_half_turn = (prop::array::uniform3(-1.0..1.0f64), -1e-6..1e-6f64)
            .prop_filter("an axis", |(axis, _)| axis.iter().any(|x| x.abs() > 0.1))
            .prop_map(|([x, y, z], off)| {
                UnitQuaternion::new_normalize(Quaternion::new(off, x, y, z))
            });
        prop_oneof![generic, near_half_turn, Just(UnitQuaternion::identity())]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// F = R S with S of known eigenvalues comes back, from any start, to round-off.
        #[test]
        fn factors_are_found_from_any_start(
            truth in any_rotation(),
            axes in any_rotation(),
            start in any_rotation(),
            values in prop::array::uniform3(0.2..3.0f64),
            inverted in any::<bool>(),
        ) {
            let mut values = values;
            if inverted {
                // The nearest rotation leaves the sign with the smallest.
                values.sort_by(f64::total_cmp);
                values[0] = -values[0];
                values[1] += 0.1;
                values[2] += 0.1;
            }
            let v = matrix(&axes);
            let stretch = v * Matrix3::from_diagonal(&values.into()) * v.transpose();
            let f = matrix(&truth) * stretch;
            let mut rotation = start;
            let found = polar(&f, &mut rotation);
            let off = (found.rotation - matrix(&truth)).amax();
            prop_assert!(off < 2e-13, "{off}");
            prop_assert!((found.stretch - stretch).amax() < 2e-13);
            prop_assert_eq!(found.rotation, matrix(&rotation));
            // Again from the result: nothing moves.
            let again = polar(&f, &mut rotation);
            prop_assert!((again.rotation - found.rotation).amax() < 2e-13);
        }

        /// Whatever the matrix, a rotation comes out, and none is nearer.
        #[test]
        fn no_rotation_is_nearer(
            columns in prop::array::uniform9(-1.0..1.0f64),
            scale in prop::sample::select(vec![1e-150, 1e-8, 1.0, 1e8, 1e150]),
            flat in 0..4usize,
            start in any_rotation(),
            other in any_rotation(),
        ) {
            let mut f = Matrix3::from_column_slice(&columns);
            for column in 0..flat {
                f.set_column(column, &Vector3::zeros());
            }
            f *= scale;
            let mut rotation = start;
            let found = polar(&f, &mut rotation);
            let r = found.rotation;
            prop_assert!((r.tr_mul(&r) - Matrix3::identity()).amax() < 1e-14);
            prop_assert!(r.determinant() > 0.0);
            let near = |r: &Matrix3<f64>| r.dot(&f) / scale;
            prop_assert!(near(&r) >= near(&matrix(&other)) - 1e-13);
            prop_assert!((r * found.stretch - f).amax() < 1e-12 * scale);
        }
    }

    #[test]
    fn what_has_no_rotation_keeps_the_last() {
        let last = UnitQuaternion::from_euler_angles(0.3, -0.2, 2.0);
        for f in [
            Matrix3::zeros(),
            Matrix3::from_element(f64::NAN),
            Matrix3::from_element(f64::INFINITY),
        ] {
            let mut rotation = last;
            polar(&f, &mut rotation);
            assert_eq!(rotation, last, "{f}");
        }
    }
}
