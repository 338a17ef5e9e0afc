//! Bounding regions of a link: where the other element may be.
//!
//! Entry points: [`Region`] with [`Ball`] and [`Ellipsoid`] (zhang-2017, 3.33 to 3.39), and [`Box3`]
//! (zhang-2017, 3.3, with the sign of the rest offset that the printed form leaves out).

use super::links::square;

/// A region that bounds the length of a link.
pub(super) trait Region {
    /// Least and greatest length \[m\] of link `link` of rest length squared `rest_sq` along `d`.
    fn lengths(&self, link: usize, rest_sq: f64, d: [f64; 3]) -> (f64, f64);

    /// Whether the link is beyond them by more than the share `slack` of its rest length.
    #[inline]
    fn violated(&self, link: usize, rest_sq: f64, d: [f64; 3], slack: f64) -> bool {
        let length = square(d).sqrt();
        let (least, greatest) = self.lengths(link, rest_sq, d);
        let slack = slack * rest_sq.sqrt();
        length < least - slack || length > greatest + slack
    }
}

/// The same strain limit for all links and directions: the ellipsoid is a ball.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    /// The strain limit.
    pub limit: f64,
}

impl Region for Ball {
    #[inline]
    fn lengths(&self, _link: usize, rest_sq: f64, _d: [f64; 3]) -> (f64, f64) {
        let rest = rest_sq.sqrt();
        ((1.0 - self.limit) * rest, (1.0 + self.limit) * rest)
    }

    #[inline]
    fn violated(&self, _link: usize, rest_sq: f64, d: [f64; 3], slack: f64) -> bool {
        // Without a root: this is asked of every link in every step.
        let (low, high) = (1.0 - self.limit - slack, 1.0 + self.limit + slack);
        let length_sq = square(d);
        (length_sq < low * low.abs() * rest_sq) | (length_sq > high * high * rest_sq)
    }
}

/// A strain limit by axis for each link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ellipsoid<'a> {
    /// Strain limits along x, y, z of each link, (m x 3).
    pub limits: &'a [[f64; 3]],
}

impl Region for Ellipsoid<'_> {
    #[inline]
    fn lengths(&self, link: usize, rest_sq: f64, d: [f64; 3]) -> (f64, f64) {
        let limit = self.limits[link];
        let shrunk = [d[0] / limit[0], d[1] / limit[1], d[2] / limit[2]];
        // (3.37): lambda = l0 / |u / epsilon|, with u = d / |d|.
        let rest = rest_sq.sqrt();
        let lambda = rest * (square(d) / square(shrunk)).sqrt();
        if lambda.is_finite() {
            ((rest - lambda).abs(), rest + lambda)
        } else {
            (rest, rest)
        }
    }
}

/// The box of the classical ChainMail.
#[derive(Clone, Copy, Debug)]
pub(super) struct Box3 {
    /// Least share of the rest offset along an axis.
    pub least: f64,
    /// Greatest share of it.
    pub greatest: f64,
    /// Share of the offsets along the other two axes that is allowed as shear.
    pub shear: f64,
}

impl Box3 {
    /// Interval of the other element's offset along each axis \[m\], from the offset at rest.
    #[inline]
    pub fn intervals(&self, offset: [f64; 3]) -> [(f64, f64); 3] {
        let size = offset.map(f64::abs);
        let all = size[0] + size[1] + size[2];
        [0, 1, 2].map(|axis| {
            let shear = self.shear * (all - size[axis]);
            let (a, b) = (self.least * offset[axis], self.greatest * offset[axis]);
            (a.min(b) - shear, a.max(b) + shear)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ellipsoid_of_equal_limits_is_the_ball() {
        let limits = [[0.2; 3]];
        for d in [[3e-3, 0.0, 0.0], [1e-3, -2e-3, 2e-3], [0.1e-3, 4e-3, 0.0]] {
            let ball = Ball { limit: 0.2 }.lengths(0, 9e-6, d);
            let ellipsoid = Ellipsoid { limits: &limits }.lengths(0, 9e-6, d);
            assert!((ball.0 - ellipsoid.0).abs() < 1e-15 && (ball.1 - ellipsoid.1).abs() < 1e-15);
            for slack in [0.0, 0.1] {
                assert_eq!(
                    Ball { limit: 0.2 }.violated(0, 9e-6, d, slack),
                    Ellipsoid { limits: &limits }.violated(0, 9e-6, d, slack)
                );
            }
        }
    }

    #[test]
    fn limit_points_lie_on_the_ellipsoid() {
        let limit = [0.1, 0.3, 0.5];
        let limits = [limit];
        let (rest, d) = (2.0, [0.6, -1.1, 0.4]);
        let (least, greatest) = Ellipsoid { limits: &limits }.lengths(0, rest * rest, d);
        // (3.32) with the centre at the rest length along the link (3.40).
        for length in [least, greatest] {
            let size = square(d).sqrt();
            let from_centre = d.map(|x| x / size * (length - rest));
            let sum: f64 = (0..3)
                .map(|axis| (from_centre[axis] / (rest * limit[axis])).powi(2))
                .sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_box_is_the_same_from_both_ends() {
        let region = Box3 {
            least: 0.7,
            greatest: 1.4,
            shear: 0.1,
        };
        let offset = [2.0, -1.0, 0.5];
        let there = region.intervals(offset);
        let back = region.intervals(offset.map(|x| -x));
        for axis in 0..3 {
            assert_eq!(there[axis].0, -back[axis].1);
            assert_eq!(there[axis].1, -back[axis].0);
            assert!(there[axis].0 <= offset[axis] && offset[axis] <= there[axis].1);
        }
        // (3.3) by hand: 0.7 * 2 - 0.1 * 1.5 and 1.4 * 2 + 0.1 * 1.5.
        assert!((there[0].0 - 1.25).abs() < 1e-12 && (there[0].1 - 2.95).abs() < 1e-12);
    }
}
