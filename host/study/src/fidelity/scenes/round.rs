//! A round body: a cylinder along y that pushes back along its radius, without friction. What its tangent does not have is
//! the turning of the normal to second order, which a tangent carries on straight ahead.
//!
//! Entry points: [`Round::THIN`], [`Round::THICK`]. F = k d along the radius, d the depth.

use super::{Sample, Scene, Solution, Truth};
use sutura_host::session::sideways;

/// A cylinder, and how hard it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Round {
    /// \[m\].
    pub radius_m: f64,
    /// \[N/m\].
    pub stiffness_n_per_m: f64,
}

impl Round {
    /// As thick as a small vessel: 8 mm.
    pub const THIN: Round = Round {
        radius_m: 8e-3,
        stiffness_n_per_m: 500.0,
    };
    /// As thick as a gut: 20 mm.
    pub const THICK: Round = Round {
        radius_m: 20e-3,
        ..Round::THIN
    };
}

impl Scene for Round {
    fn name(&self) -> &'static str {
        if self.radius_m == Round::THIN.radius_m {
            "round-8-mm"
        } else {
            "round-20-mm"
        }
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.radius_m]
    }

    fn start(&self, _most_rows: usize, ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        Box::new(Felt {
            round: *self,
            ahead_s,
            normal: [0.0, 0.0, 1.0],
        })
    }
}

struct Felt {
    round: Round,
    /// From a state until the end of its frame's use \[s\]; 0 for who is not late.
    ahead_s: f64,
    /// Of the last contact.
    normal: [f64; 3],
}

impl Truth for Felt {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        // As a session does; the truth looks nowhere but where it is.
        let goal = (self.ahead_s > 0.0).then(|| {
            let (here, velocity) = (sample.position_m, sample.velocity_m_per_s);
            let [here, velocity] = [here, velocity].map(|v| v.map(|x| x as f32));
            sideways(here, velocity, &self.normal, sample.lead_s, self.ahead_s)
        });
        let [x, y, z] = goal.map_or(sample.position_m, |goal| goal.position_m.map(f64::from));
        let away = x.hypot(z).max(1e-9);
        let normal = [x / away, 0.0, z / away];
        let push_n = self.round.stiffness_n_per_m * (self.round.radius_m - away).max(0.0);
        let mut solution = Solution {
            position_m: goal.map(|_| [x, y, z].map(|x| x as f32)),
            normal,
            ..Solution::nothing(away - self.round.radius_m)
        };
        for i in 0..3 {
            solution.wrench[i] = push_n * normal[i];
            for j in 0..3 {
                let along = normal[i] * normal[j];
                let across = if i == j && i != 1 {
                    1.0 - along
                } else {
                    -along
                };
                let across = if i == 1 || j == 1 { 0.0 } else { across };
                solution.tangent[i][j] =
                    push_n / away * across - self.round.stiffness_n_per_m * along;
            }
        }
        self.normal = normal;
        Some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_is_the_derivative() {
        let solve = |position_m: [f64; 3]| {
            let sample = Sample {
                time_s: 0.0,
                position_m,
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: [0.0; 3],
                lead_s: 0.0,
                has_time: true,
            };
            let solution = Round::THIN.start(0, 0.0, 1e-3).solve(&sample);
            solution.expect("always solved")
        };
        let here = [3e-3, 1e-3, 5e-3];
        let solution = solve(here);
        assert!((solution.wrench[2] / solution.wrench[0] - 5.0 / 3.0).abs() < 1e-12);
        for axis in 0..3 {
            let mut beside = here;
            beside[axis] += 1e-9;
            let there = solve(beside);
            for i in 0..3 {
                let slope = (there.wrench[i] - solution.wrench[i]) / 1e-9;
                assert!(
                    (slope - solution.tangent[i][axis]).abs() < 1e-2,
                    "{i} {axis}"
                );
            }
        }
    }
}
