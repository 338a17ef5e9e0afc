//! A point of tissue that stiffens: the scene of the stability literature, with what real tissue adds.
//!
//! F = k d (1 + (d / h)^2) along the skin's normal, with d the depth. Along the skin the point sticks to where it touched, with a fifth of
//! the spring, up to a friction of 0.5. It does not relax, since no tissue of a session does.

use super::{Sample, Scene, Solution, Truth};

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Stiffness just after touching \[N/m\].
    pub stiffness_n_per_m: f64,
    /// Depth at which the force is twice that of a spring \[m\].
    pub hardening_m: f64,
}

/// Stiffness along the skin in that of the spring.
const ALONG: f64 = 0.2;
/// Coefficient of friction along the skin.
const FRICTION: f64 = 0.5;

impl Point {
    /// 4.6 N at 10 mm, as tissue between liver and muscle under a fingertip.
    pub const TISSUE: Point = Point {
        stiffness_n_per_m: 250.0,
        hardening_m: 12e-3,
    };

    /// Six times as stiff, and as much thinner.
    pub const GRISTLE: Point = Point {
        stiffness_n_per_m: 1500.0,
        hardening_m: 2e-3,
    };

    /// Tissue that is so many times stiffer and as many times thinner: the same forces at as many times
    /// less depth.
    pub fn stiffer(self, times: f64) -> Self {
        Point {
            stiffness_n_per_m: self.stiffness_n_per_m * times,
            hardening_m: self.hardening_m / times,
        }
    }

    /// Force \[N\], and its derivative \[N/m\], at a depth \[m\].
    fn push(&self, depth_m: f64) -> (f64, f64) {
        let ratio = (depth_m / self.hardening_m).powi(2);
        let k = self.stiffness_n_per_m;
        (k * depth_m * (1.0 + ratio), k * (1.0 + 3.0 * ratio))
    }

    /// Stiffness that a fast motion feels \[N/m\] where a hand's push \[N\] by depth \[m\] rests, which is none any more
    /// at `pressed_m`.
    pub fn stiffness_held_by(&self, push_n: impl Fn(f64) -> f64, pressed_m: f64) -> f64 {
        let (mut low, mut high) = (0.0, pressed_m.max(0.0));
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.push(middle).0 < push_n(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.push(low).1
    }
}

impl Scene for Point {
    fn name(&self) -> &'static str {
        if *self == Point::GRISTLE {
            "gristle"
        } else {
            "point"
        }
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn start(&self, _most_rows: usize, _ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        Box::new(Touched {
            point: *self,
            anchor_m: None,
        })
    }
}

/// The tissue at work.
struct Touched {
    point: Point,
    /// Where the point sticks \[m\], (2).
    anchor_m: Option<[f64; 2]>,
}

impl Touched {
    /// Friction along the skin \[N\], (2), and its tangent \[N/m\], (2 x 2), under a push \[N\].
    fn drag(&mut self, at: [f64; 2], push_n: f64) -> ([f64; 2], [[f64; 2]; 2]) {
        let stiffness = ALONG * self.point.stiffness_n_per_m;
        let anchor = self.anchor_m.get_or_insert(at);
        let moved = [at[0] - anchor[0], at[1] - anchor[1]];
        let length = moved[0].hypot(moved[1]);
        let held = (FRICTION * push_n / stiffness).min(length);
        if held == length {
            let tangent = [[-stiffness, 0.0], [0.0, -stiffness]];
            return (moved.map(|x| -stiffness * x), tangent);
        }
        // The point slips after the tool and holds it back by as much as the push allows; only across
        // its way does it stick.
        let way = moved.map(|x| x / length);
        *anchor = [at[0] - held * way[0], at[1] - held * way[1]];
        let across = [0, 1].map(|i: usize| {
            [0, 1].map(|j: usize| stiffness * (way[i] * way[j] - if i == j { 1.0 } else { 0.0 }))
        });
        (way.map(|x| -stiffness * held * x), across)
    }
}

impl Truth for Touched {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let [x, y, z] = sample.position_m;
        let depth_m = (-z).max(0.0);
        let (push_n, slope) = self.point.push(depth_m);
        let mut solution = Solution::nothing(z);
        solution.tangent[2][2] = -slope;
        if depth_m > 0.0 {
            let (drag_n, along) = self.drag([x, y], push_n);
            for i in 0..2 {
                solution.wrench[i] = drag_n[i];
                solution.tangent[i][..2].copy_from_slice(&along[i]);
            }
            solution.wrench[2] = push_n;
        } else {
            self.anchor_m = None;
        }
        Some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_s: f64, position_m: [f64; 3]) -> Sample {
        Sample {
            time_s,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            lead_s: 0.0,
            has_time: true,
        }
    }

    /// The tangent against a solve next to it, sticking and across the slip.
    #[test]
    fn the_tangent_is_the_derivative() {
        let start = |path: &[[f64; 3]]| {
            let mut tissue = Point::TISSUE.start(0, 0.0, 1e-3);
            let mut last = None;
            for (position, tick) in path.iter().zip(0..) {
                last = tissue.solve(&at(f64::from(tick) * 1e-3, *position));
            }
            (tissue, last.expect("always solved"))
        };
        let stick: &[[f64; 3]] = &[[0.0, 0.0, -4e-3], [1e-3, 0.5e-3, -5e-3]];
        let slip: &[[f64; 3]] = &[[0.0, 0.0, -4e-3], [0.08, 0.0, -5e-3]];
        for (path, axes) in [(stick, &[0, 1, 2][..]), (slip, &[1][..])] {
            let time = path.len() as f64 * 1e-3 - 1e-3;
            for &axis in axes {
                let (mut tissue, here) = start(path);
                let mut beside = path[path.len() - 1];
                beside[axis] += 1e-8;
                let there = tissue.solve(&at(time, beside)).expect("always solved");
                for i in 0..3 {
                    // Friction's limit grows with the push: not symmetric, and not sent.
                    let slope = (there.wrench[i] - here.wrench[i]) / 1e-8;
                    let sent = here.tangent[i][axis];
                    assert!((slope - sent).abs() < 0.01, "{i} {axis}: {slope} {sent}");
                }
            }
        }
    }

    /// Nothing that the tool does gets energy out of the tissue.
    #[test]
    fn the_tissue_is_passive() {
        let mut random = crate::fidelity::random::Random::new(3);
        for _ in 0..50 {
            let mut tissue = Point::TISSUE.start(0, 0.0, 1e-3);
            let (mut energy, mut z, mut pace) = (0.0, 0.0, 0.0);
            for tick in 0..3000 {
                let before = tissue.solve(&at(f64::from(tick) * 1e-3, [0.0, 0.0, z]));
                pace += 0.02 * (random.unit() - 0.5) - 0.05 * pace - 2.0 * (z + 3e-3);
                z += pace * 1e-3;
                let after = tissue.solve(&at(f64::from(tick + 1) * 1e-3, [0.0, 0.0, z]));
                let force = |s: Option<Solution>| s.map_or(0.0, |s| s.wrench[2]);
                energy -= 0.5 * (force(before) + force(after)) * pace * 1e-3;
                assert!(energy > -2e-6, "{tick}: {energy}");
            }
        }
    }
}
