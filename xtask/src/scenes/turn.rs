//! Turns and vectors, as much of them as a needle's way needs.
//!
//! Entry points: [`rotation_vector`] of the turn between two frames, [`rotated`].

/// A vector or a point \[m\], (3).
pub type Vec3 = [f64; 3];

/// a + s b.
pub fn along(a: Vec3, s: f64, b: Vec3) -> Vec3 {
    [0, 1, 2].map(|i: usize| a[i] + s * b[i])
}

pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub fn norm(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// `x` turned about `turn`, axis times angle \[rad\] (Rodrigues).
#[cfg(test)]
pub fn rotated(turn: Vec3, x: Vec3) -> Vec3 {
    let angle = norm(turn);
    if angle == 0.0 {
        return x;
    }
    let axis = turn.map(|v| v / angle);
    let (sin, cos) = angle.sin_cos();
    let aside = along([0.0; 3], sin, cross(axis, x));
    let kept = along(aside, cos, x);
    along(kept, (1.0 - cos) * dot(axis, x), axis)
}

/// The shortest turn, axis times angle \[rad\], that brings the unit vectors `from` onto `to`; both
/// right-handed.
pub fn rotation_vector(from: [Vec3; 3], to: [Vec3; 3]) -> Vec3 {
    // R = to from'.
    let entry = |i: usize, j: usize| (0..3).map(|k| to[k][i] * from[k][j]).sum::<f64>();
    let m: [[f64; 3]; 3] = [0, 1, 2].map(|i| [0, 1, 2].map(|j| entry(i, j)));
    // The largest of the four components of the quaternion is found first (Shepperd 1978).
    let trace = m[0][0] + m[1][1] + m[2][2];
    let squares = [
        trace,
        2.0 * m[0][0] - trace,
        2.0 * m[1][1] - trace,
        2.0 * m[2][2] - trace,
    ];
    let largest = (1..4).fold(
        0,
        |best, i| {
            if squares[i] > squares[best] { i } else { best }
        },
    );
    let mut q = [0.0; 4];
    q[largest] = 1.0 + squares[largest];
    if largest == 0 {
        q[1] = m[2][1] - m[1][2];
        q[2] = m[0][2] - m[2][0];
        q[3] = m[1][0] - m[0][1];
    } else {
        let i = largest - 1;
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        q[0] = m[k][j] - m[j][k];
        q[1 + j] = m[i][j] + m[j][i];
        q[1 + k] = m[i][k] + m[k][i];
    }
    if q[0] < 0.0 {
        q = q.map(|v| -v);
    }
    let axis = [q[1], q[2], q[3]];
    let length = norm(axis);
    if length == 0.0 {
        return [0.0; 3];
    }
    axis.map(|v| v * 2.0 * length.atan2(q[0]) / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_turned_onto_the_other() {
        let base = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for turn in [
            [0.0; 3],
            [0.3, -0.2, 0.1],
            [3.0, 0.5, 0.0],
            [0.1, 3.1, 0.2],
            [0.0, -0.3, 3.1],
            [-2.0, 1.0, -1.5],
        ] {
            let start = base.map(|x| rotated([0.4, 1.0, -0.3], x));
            let end = start.map(|x| rotated(turn, x));
            let found = rotation_vector(start, end);
            assert!(norm(found) <= norm(turn) + 1e-12);
            for (x, y) in start.into_iter().zip(end) {
                let off = norm(along(rotated(found, x), -1.0, y));
                assert!(off < 1e-12, "{turn:?}: {found:?} is off by {off}");
            }
        }
        // A quarter turn from x to y is about z.
        let quarter = rotation_vector(base, [base[1], [-1.0, 0.0, 0.0], base[2]]);
        assert!(norm(along(quarter, -std::f64::consts::FRAC_PI_2, base[2])) < 1e-12);
    }
}
