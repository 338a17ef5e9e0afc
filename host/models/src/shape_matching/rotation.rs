//! The rotation that fits a cluster best.
//!
//! Entry point: [`best_rotation`]. Horn (1987): the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix, in
//! place of the polar decomposition of qian-2015, (1), with which it agrees wherever that is a rotation.

use nalgebra::{Matrix3, Matrix4, Quaternion, SymmetricEigen, UnitQuaternion};

/// The rotation R with the largest trace of R^T `a`, where `a = sum w x X^T` over a cluster, X its points at rest and
/// x where they are, both from their centre. A rotation also where the cluster is flat, a line, a point or
/// inverted; `None` where `a` is not finite.
///
/// ```
/// use nalgebra::{Matrix3, Rotation3, Vector3};
/// let turn = Rotation3::new(Vector3::new(0.3, -0.2, 0.9)).into_inner();
/// let stretch = Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 0.5));
/// let found = sutura_models::shape_matching::best_rotation(&(turn * stretch)).expect("finite");
/// assert!((found - turn).norm() < 1e-12);
/// ```
pub fn best_rotation(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let size = a.amax();
    if !size.is_finite() || a.iter().any(|entry| !entry.is_finite()) {
        return None;
    }
    if size == 0.0 {
        return Some(Matrix3::identity());
    }
    let a = a / size;
    let (trace, [x, y, z]) = (
        a.trace(),
        [
            a[(2, 1)] - a[(1, 2)],
            a[(0, 2)] - a[(2, 0)],
            a[(1, 0)] - a[(0, 1)],
        ],
    );
    let s = a + a.transpose();
    // tr(R(q)^T a) = q^T m q.
    let m = Matrix4::new(
        trace,
        x,
        y,
        z,
        x,
        s[(0, 0)] - trace,
        s[(0, 1)],
        s[(0, 2)],
        y,
        s[(0, 1)],
        s[(1, 1)] - trace,
        s[(1, 2)],
        z,
        s[(0, 2)],
        s[(1, 2)],
        s[(2, 2)] - trace,
    );
    let eigen = SymmetricEigen::try_new(m, f64::EPSILON, 200)?;
    let mut best = 0;
    for index in 1..4 {
        if eigen.eigenvalues[index] > eigen.eigenvalues[best] {
            best = index;
        }
    }
    let q = eigen.eigenvectors.column(best);
    let q = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
    Some(q.to_rotation_matrix().into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    fn is_rotation(r: &Matrix3<f64>) -> bool {
        (r.transpose() * r - Matrix3::identity()).norm() < 1e-12
            && (r.determinant() - 1.0).abs() < 1e-12
    }

    /// The optimum by singular values: U diag(1, 1, det(U V^T)) V^T.
    fn by_singular_values(a: &Matrix3<f64>) -> Matrix3<f64> {
        let svd = a.svd(true, true);
        let (u, v_t) = (svd.u.expect("u"), svd.v_t.expect("v"));
        let sign = (u * v_t).determinant();
        u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t
    }

    proptest! {
        #[test]
        fn nothing_fits_better(
            entries in proptest::array::uniform9(-1.0..1.0),
            other in proptest::array::uniform3(-3.0..3.0),
        ) {
            let a = Matrix3::from_row_slice(&entries);
            let r = best_rotation(&a).expect("finite");
            prop_assert!(is_rotation(&r));
            let fit = r.dot(&a);
            prop_assert!(fit >= Rotation3::new(Vector3::from(other)).into_inner().dot(&a) - 1e-12);
            prop_assert!((fit - by_singular_values(&a).dot(&a)).abs() < 1e-12);
            // What conserves angular momentum: R^T a is symmetric, whatever the sign of its determinant.
            let s = r.transpose() * a;
            prop_assert!((s - s.transpose()).norm() < 1e-13);
        }

        #[test]
        fn flat_and_inverted_clusters_have_one_too(
            axis in proptest::array::uniform3(-3.0..3.0),
            stretch in proptest::array::uniform2(0.5..2.0),
            squeeze in -0.4..0.4f64,
        ) {
            let turn = Rotation3::new(Vector3::from(axis)).into_inner();
            for thin in [0.0, squeeze] {
                let shape = Matrix3::from_diagonal(&Vector3::new(stretch[0], stretch[1], thin));
                let r = best_rotation(&(turn * shape)).expect("finite");
                // Flat or turned inside out along its thinnest axis: the turn itself fits best.
                prop_assert!((r - turn).norm() < 1e-10, "{}", (r - turn).norm());
            }
        }
    }

    #[test]
    fn lines_points_mirrors_and_what_is_no_number() {
        let line = Vector3::new(1.0, 2.0, 2.0) * Vector3::new(0.0, 1.0, 0.0).transpose();
        let r = best_rotation(&line).expect("finite");
        assert!(is_rotation(&r));
        assert!((r * Vector3::y() - Vector3::new(1.0, 2.0, 2.0) / 3.0).norm() < 1e-12);
        assert_eq!(best_rotation(&Matrix3::zeros()), Some(Matrix3::identity()));
        let mirror = best_rotation(&-Matrix3::identity()).expect("finite");
        assert!(is_rotation(&mirror));
        let tiny = best_rotation(&(1e-300 * Matrix3::identity())).expect("finite");
        assert!((tiny - Matrix3::identity()).norm() < 1e-12);
        assert_eq!(best_rotation(&Matrix3::repeat(f64::NAN)), None);
        assert_eq!(best_rotation(&Matrix3::repeat(f64::INFINITY)), None);
    }
}
