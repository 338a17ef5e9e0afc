//! A point of tissue that stiffens and relaxes: the scene of the stability literature, with what real tissue adds.
//!
//! F = k d (1 + (d / h)^2) + r k (d - q) along the skin's normal, with d the depth and q that of the Maxwell
//! branch, dq/dt = (d - q) / tau; the skin comes back late. Along the skin the point sticks to where it
//! touched, with a fifth of the spring, up to a friction of 0.5.

use super::{Sample, Scene, Solution, Truth};

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Stiffness just after touching, without the Maxwell branch \[N/m\].
    pub stiffness_n_per_m: f64,
    /// Depth at which the force is twice that of a spring \[m\].
    pub hardening_m: f64,
    /// Stiffness of the Maxwell branch in that of the spring.
    pub branch: f64,
    /// Its time constant \[s\].
    pub relaxation_s: f64,
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
        branch: 0.5,
        relaxation_s: 0.15,
    };

    /// The same without the Maxwell branch: what sessions have, whose tissue does not relax.
    pub const ELASTIC: Point = Point {
        branch: 0.0,
        ..Point::TISSUE
    };

    /// Six times as stiff, and as much thinner.
    pub const GRISTLE: Point = Point {
        stiffness_n_per_m: 1500.0,
        hardening_m: 2e-3,
        ..Point::TISSUE
    };

    /// Tissue that is so many times stiffer and as many times thinner: the same forces at as many times
    /// less depth.
    pub fn stiffer(self, times: f64) -> Self {
        Point {
            stiffness_n_per_m: self.stiffness_n_per_m * times,
            hardening_m: self.hardening_m / times,
            ..self
        }
    }

    /// Force without the branch \[N\], and its derivative \[N/m\], at a depth \[m\].
    fn spring(&self, depth_m: f64) -> (f64, f64) {
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
            if self.spring(middle).0 < push_n(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.spring(low).1 + self.branch * self.stiffness_n_per_m
    }
}

impl Scene for Point {
    fn name(&self) -> &'static str {
        if *self == Point::GRISTLE {
            "gristle"
        } else if *self == Point::ELASTIC {
            "elastic"
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
            before: None,
            crept_m: 0.0,
            anchor_m: None,
        })
    }
}

/// The tissue at work.
struct Touched {
    point: Point,
    /// Time \[s\] and depth of the tool \[m\], below 0 in the air, at the last solve.
    before: Option<(f64, f64)>,
    /// Depth at which the Maxwell branch would be at rest \[m\].
    crept_m: f64,
    /// Where the point sticks \[m\], (2).
    anchor_m: Option<[f64; 2]>,
}

/// Longest step of the Maxwell branch \[s\].
const STEP_S: f64 = 1e-3;

impl Touched {
    /// Force at a depth of the skin \[N\], and its derivative \[N/m\].
    fn push(&self, depth_m: f64) -> (f64, f64) {
        let branch = self.point.branch * self.point.stiffness_n_per_m;
        let (force, slope) = self.point.spring(depth_m);
        (force + branch * (depth_m - self.crept_m), slope + branch)
    }

    /// Depth of the skin while nothing touches it \[m\]: it comes back late.
    fn free_m(&self) -> f64 {
        let mut depth = self.crept_m;
        // Newton on a convex rising function, from above.
        for _ in 0..20 {
            let (force, slope) = self.push(depth);
            depth -= force / slope;
        }
        depth.max(0.0)
    }

    /// Lets the time between two solves pass; the tool goes evenly.
    fn creep(&mut self, time_s: f64, depth_m: f64) {
        let (then_s, then_m) = self.before.unwrap_or((time_s, depth_m));
        self.before = Some((time_s, depth_m));
        let steps = ((time_s - then_s) / STEP_S - 1e-6).ceil().max(0.0);
        for step in 0..steps as u32 {
            let part = (f64::from(step) + 0.5) / steps;
            let tool_m = then_m + (depth_m - then_m) * part;
            let skin_m = tool_m.max(self.free_m());
            let fade = (-(time_s - then_s) / steps / self.point.relaxation_s).exp();
            self.crept_m = skin_m + (self.crept_m - skin_m) * fade;
        }
    }

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
        self.creep(sample.time_s, -z);
        let free_m = self.free_m();
        let touches = -z > free_m;
        let depth_m = (-z).max(free_m);
        let (push_n, slope) = self.push(depth_m);
        let mut solution = Solution::nothing(free_m + z);
        solution.tangent[2][2] = -slope;
        if touches {
            let (drag_n, along) = self.drag([x, y], push_n);
            for i in 0..2 {
                solution.wrench[i] = drag_n[i];
                solution.tangent[i][..2].copy_from_slice(&along[i]);
            }
            solution.wrench[2] = push_n;
            let branch = self.point.branch * self.point.stiffness_n_per_m;
            let fades = branch * (depth_m - self.crept_m) / self.point.relaxation_s;
            // The wire knows no force that grows.
            solution.relaxation_per_s = (fades / push_n.max(1e-9)).clamp(0.0, 100.0);
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

    /// After a step the force fades to that of the spring, at first at the rate that is sent.
    #[test]
    fn a_held_point_relaxes() {
        let mut tissue = Point::TISSUE.start(0, 0.0, 1e-3);
        tissue.solve(&at(0.0, [0.0; 3]));
        let first = tissue.solve(&at(1e-3, [0.0, 0.0, -5e-3])).expect("solved");
        let next = tissue.solve(&at(2e-3, [0.0, 0.0, -5e-3])).expect("solved");
        let rate = (1.0 - next.wrench[2] / first.wrench[2]) / 1e-3;
        assert!((rate / first.relaxation_per_s - 1.0).abs() < 0.01);
        let last = tissue.solve(&at(3.0, [0.0, 0.0, -5e-3])).expect("solved");
        let spring = Point::TISSUE.spring(5e-3).0;
        assert!((last.wrench[2] - spring).abs() < 1e-6);
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
