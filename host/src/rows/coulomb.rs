//! One Coulomb cone, or disc, by itself: normal and two tangents on a 3 x 3 compliance, or two rows on a 2 x 2 one.
//!
//! Entry points: [`solve`], [`solve_disc`]. Open and sticking are linear; slipping is one equation in the angle of the
//! slip: with `delta_t` along `d`, `lambda_t = -mu lambda_n d` and `delta_n = 0` give `lambda_n`, and
//! `d x delta_t = 0` the angle (Bonnefon & Daviet 2011 write it as a quartic). Newton from the last
//! direction, else all angles.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Directions tried when Newton from the last one fails, and when two solutions hide between those.
const DIRECTIONS: [usize; 2] = [32, 256];

/// Force of a cone with gap `free + a lambda`, starting from the force `last`.
pub(super) fn solve(
    a: &Matrix3<f64>,
    free: &Vector3<f64>,
    mu: f64,
    last: &Vector3<f64>,
) -> Vector3<f64> {
    if free.x >= 0.0 {
        return Vector3::zeros();
    }
    let stick = a.cholesky().map(|factor| -factor.solve(free));
    if let Some(stick) = stick
        && stick.x > 0.0
        && stick.y.hypot(stick.z) <= mu * stick.x
    {
        return stick;
    }
    let slip = Slip { a, free, mu };
    let start = if last.y != 0.0 || last.z != 0.0 {
        (-last.z).atan2(-last.y)
    } else {
        free.z.atan2(free.y)
    };
    slip.newton(start)
        .or_else(|| DIRECTIONS.into_iter().find_map(|count| slip.search(count)))
        .unwrap_or_else(|| slip.project(last))
}

/// Newton steps for the force of a disc: they converge from below, quadratically.
const DISC_STEPS: u32 = 30;

/// Force in a disc with gap `free + a lambda`: sticks inside, and slips by `delta = -nu lambda` at its rim, where
/// `|(a + nu)^-1 free|` is the radius (the secular equation of a trust region: More & Sorensen 1983).
pub(super) fn solve_disc(a: &Matrix2<f64>, free: &Vector2<f64>, radius: f64) -> Vector2<f64> {
    let mut nu = 0.0;
    let mut force = Vector2::zeros();
    for _ in 0..DISC_STEPS {
        let Some(factor) = (a + Matrix2::identity() * nu).cholesky() else {
            nu += 1e-12 * a.trace();
            continue;
        };
        force = -factor.solve(free);
        let length = force.norm();
        if length <= radius * (1.0 + 1e-15) {
            break;
        }
        let slope = force.dot(&factor.solve(&force)) / (length * length);
        nu += (length - radius) / (radius * slope);
    }
    let length = force.norm();
    force * (radius / length).min(1.0)
}

/// A slipping cone.
struct Slip<'a> {
    a: &'a Matrix3<f64>,
    free: &'a Vector3<f64>,
    mu: f64,
}

impl Slip<'_> {
    /// Normal compliance along the slipping force, and `delta_t` times it, for slip along (c, s).
    fn slide(&self, (c, s): (f64, f64)) -> (f64, [f64; 2]) {
        let (a, b, mu) = (self.a, self.free, self.mu);
        let normal = a.m11 - mu * (a.m12 * c + a.m13 * s);
        let slide = [
            b.y * normal - b.x * (a.m21 - mu * (a.m22 * c + a.m23 * s)),
            b.z * normal - b.x * (a.m31 - mu * (a.m32 * c + a.m33 * s)),
        ];
        (normal, slide)
    }

    /// The force for slip at `angle`, if the tissue does slip that way.
    fn force(&self, angle: f64) -> Option<Vector3<f64>> {
        let (s, c) = angle.sin_cos();
        let (normal, slide) = self.slide((c, s));
        if normal <= 0.0 || slide[0] * c + slide[1] * s < 0.0 {
            return None;
        }
        let lambda = -self.free.x / normal;
        let lateral = -self.mu * lambda;
        lambda
            .is_finite()
            .then(|| Vector3::new(lambda, lateral * c, lateral * s))
    }

    fn newton(&self, mut angle: f64) -> Option<Vector3<f64>> {
        let (a, b, mu) = (self.a, self.free, self.mu);
        for _ in 0..10 {
            let (s, c) = angle.sin_cos();
            let (_, v) = self.slide((c, s));
            let off = c * v[1] - s * v[0];
            let size = v[0].abs() + v[1].abs();
            if off.abs() <= 1e-14 * size {
                return self.force(angle);
            }
            // The derivative of `slide` by the angle.
            let normal = -mu * (a.m13 * c - a.m12 * s);
            let turned = [
                b.y * normal + b.x * mu * (a.m23 * c - a.m22 * s),
                b.z * normal + b.x * mu * (a.m33 * c - a.m32 * s),
            ];
            let slope = c * turned[1] - s * turned[0] - s * v[1] - c * v[0];
            let step = -off / slope;
            if !step.is_finite() {
                return None;
            }
            angle += step.clamp(-0.5, 0.5);
        }
        None
    }

    /// Bisection between all pairs of neighbouring directions.
    fn search(&self, directions: usize) -> Option<Vector3<f64>> {
        let off = |angle: f64| {
            let (s, c) = angle.sin_cos();
            let (_, v) = self.slide((c, s));
            c * v[1] - s * v[0]
        };
        let step = std::f64::consts::TAU / directions as f64;
        for direction in 0..directions {
            let (mut low, mut high) = (direction as f64 * step, (direction + 1) as f64 * step);
            let side = off(low) > 0.0;
            if side == (off(high) > 0.0) {
                continue;
            }
            for _ in 0..52 {
                let middle = 0.5 * (low + high);
                if (off(middle) > 0.0) == side {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            if let Some(force) = self.force(0.5 * (low + high)) {
                return Some(force);
            }
        }
        None
    }

    /// A projected step, where rounding hides the solution.
    fn project(&self, last: &Vector3<f64>) -> Vector3<f64> {
        let gap = self.free + self.a * last;
        let normal = (last.x - gap.x / self.a.m11).max(0.0);
        let slack = 0.5 * (self.a.m22 + self.a.m33);
        let aim = [last.y - gap.y / slack, last.z - gap.z / slack];
        let length = aim[0].hypot(aim[1]);
        let part = if length > self.mu * normal {
            self.mu * normal / length
        } else {
            1.0
        };
        Vector3::new(normal, aim[0] * part, aim[1] * part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The law, not the method: complementarity, the disc, slip against the force.
    fn assert_solves(a: &Matrix3<f64>, free: &Vector3<f64>, mu: f64, force: &Vector3<f64>) {
        let gap = free + a * force;
        // Rounding is that of the products.
        let size = free.norm() + a.norm() * force.norm();
        assert!(force.x >= 0.0 && gap.x >= -1e-12 * size, "{force} {gap}");
        assert!(
            force.x.min(gap.x).abs() <= 1e-12 * size,
            "{a} {free} {mu} {force} {gap}"
        );
        let (lateral, slide) = (force.yz(), gap.yz());
        assert!(lateral.norm() <= mu * force.x * (1.0 + 1e-12));
        if slide.norm() > 1e-9 * size && force.x > 0.0 {
            let opposed = lateral + slide * (mu * force.x / slide.norm());
            assert!(opposed.norm() <= 1e-6 * force.norm(), "{lateral} {slide}");
        }
    }

    #[test]
    fn every_cone_is_solved() {
        let mut random = sutura_testkit::Random::new(7);
        let mut random = || random.signed();
        let mut modes = [0; 3];
        for _ in 0..4000 {
            let root = Matrix3::from_fn(|_, _| random());
            let a = root * root.transpose() + Matrix3::identity() * 0.05;
            let free = Vector3::from_fn(|_, _| random());
            let mu = random().abs() * 1.5;
            let last = Vector3::new(1.0, random(), random());
            let force = solve(&a, &free, mu, &last);
            assert_solves(&a, &free, mu, &force);
            let lateral = force.yz().norm();
            modes[if force.x == 0.0 {
                0
            } else if lateral < mu * force.x * (1.0 - 1e-9) {
                1
            } else {
                2
            }] += 1;
        }
        assert!(modes.iter().all(|count| *count > 100), "{modes:?}");
    }
}
