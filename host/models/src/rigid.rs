//! Momenta of points, and the rigid motion that has them.
//!
//! Entry points: [`momenta`], [`Rigid::of`].

use nalgebra::{Matrix3, Vector3};

/// Linear \[kg m/s\] and angular momentum about the origin \[kg m^2/s\] of (mass, position, velocity).
pub(crate) fn momenta(
    points: impl Iterator<Item = (f64, [f64; 3], [f64; 3])>,
) -> ([f64; 3], [f64; 3]) {
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    for (mass, position, velocity) in points {
        let push = mass * Vector3::from(velocity);
        linear += push;
        angular += Vector3::from(position).cross(&push);
    }
    (linear.into(), angular.into())
}

/// The rigid motion of a body with given momenta.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rigid {
    centre: Vector3<f64>,
    velocity: Vector3<f64>,
    inverse_inertia: Matrix3<f64>,
    spin: Vector3<f64>,
}

impl Rigid {
    /// Of points (mass, position) with linear and angular momentum about the origin; `None` where they lie
    /// on a line.
    pub fn of(
        points: impl Iterator<Item = (f64, [f64; 3])> + Clone,
        linear: [f64; 3],
        angular: [f64; 3],
    ) -> Option<Self> {
        let (mut mass, mut first) = (0.0, Vector3::zeros());
        for (m, position) in points.clone() {
            mass += m;
            first += m * Vector3::from(position);
        }
        let centre = first / mass;
        let mut inertia = Matrix3::zeros();
        for (m, position) in points {
            let r = Vector3::from(position) - centre;
            inertia += m * (Matrix3::from_diagonal_element(r.norm_squared()) - r * r.transpose());
        }
        let linear = Vector3::from(linear);
        let inverse_inertia = inertia.try_inverse()?;
        Some(Self {
            centre,
            velocity: linear / mass,
            inverse_inertia,
            spin: inverse_inertia * (Vector3::from(angular) - centre.cross(&linear)),
        })
    }

    /// Velocity at a place.
    pub fn at(&self, position: [f64; 3]) -> Vector3<f64> {
        self.velocity + self.spin.cross(&(Vector3::from(position) - self.centre))
    }

    /// The same body with no linear momentum and with this angular momentum.
    pub fn turning(&self, angular: Vector3<f64>) -> Self {
        Self {
            velocity: Vector3::zeros(),
            spin: self.inverse_inertia * angular,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rigid_motion_is_found_again() {
        let points = [
            (1.0, [0.0, 0.0, 0.0]),
            (2.0, [1.0, 0.2, 0.0]),
            (0.5, [0.0, 1.0, -0.5]),
            (1.5, [0.3, -0.4, 1.0]),
        ];
        let (velocity, spin) = (Vector3::new(0.3, -1.0, 2.0), Vector3::new(0.5, 0.1, -0.7));
        let moving = points.map(|(mass, position)| {
            let v: [f64; 3] = (velocity + spin.cross(&Vector3::from(position))).into();
            (mass, position, v)
        });
        let (linear, angular) = momenta(moving.into_iter());
        let rigid = Rigid::of(points.into_iter(), linear, angular).expect("not on a line");
        for (_, position, v) in moving {
            assert!((rigid.at(position) - Vector3::from(v)).norm() < 1e-12);
        }
        let line = [(1.0, [0.0; 3]), (1.0, [1.0, 0.0, 0.0])];
        assert!(Rigid::of(line.into_iter(), [0.0; 3], [0.0; 3]).is_none());
    }
}
