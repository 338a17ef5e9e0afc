//! A round body: a cylinder along y that pushes back along its radius. What its tangent does not have is the turning of the
//! normal to second order, which a tangent carries on straight ahead. One that rubs sticks to where it was touched, too, with a
//! fifth of the spring, as far as friction can: around it that place turns with the normal.
//!
//! Entry points: [`Round::THIN`], [`Round::THICK`], [`Round::rubbed`]. F = k d along the radius, d the depth.

use super::{Sample, Scene, Solution, Truth};
use std::f64::consts::TAU;
use sutura_host::session::sideways;
use sutura_host::step::{ToolRowKind, ToolRows};

/// A cylinder, and how hard it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Round {
    /// \[m\].
    pub radius_m: f64,
    /// \[N/m\].
    pub stiffness_n_per_m: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
}

/// Stiffness along the skin in that of the spring.
const ALONG: f64 = 0.2;

impl Round {
    /// As thick as a small vessel: 8 mm.
    pub const THIN: Round = Round {
        radius_m: 8e-3,
        stiffness_n_per_m: 500.0,
        friction: 0.0,
    };
    /// As thick as a gut: 20 mm.
    pub const THICK: Round = Round {
        radius_m: 20e-3,
        ..Round::THIN
    };

    /// The same, rubbed with this coefficient.
    pub const fn rubbed(self, friction: f64) -> Round {
        Round { friction, ..self }
    }

    fn along_n_per_m(&self) -> f64 {
        ALONG * self.stiffness_n_per_m
    }
}

impl Scene for Round {
    fn name(&self) -> &'static str {
        let is_thin = self.radius_m == Round::THIN.radius_m;
        match (is_thin, self.friction > 0.0) {
            (true, false) => "round-8-mm",
            (false, false) => "round-20-mm",
            (true, true) => "rubbing-round-8-mm",
            (false, true) => "rubbing-round-20-mm",
        }
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.radius_m]
    }

    fn start(&self, most_rows: usize, ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        Box::new(Felt {
            round: *self,
            most_rows,
            ahead_s,
            normal: [0.0, 0.0, 1.0],
            anchor_m: None,
        })
    }
}

/// Where it is touched.
struct Place {
    /// From the axis \[m\].
    away_m: f64,
    /// Out of the body, along the skin around it, and along its axis: (3 x 3), the force's directions.
    frame: [[f64; 3]; 3],
    /// Along the skin: around and along the axis \[m\], (2).
    at_m: [f64; 2],
}

impl Place {
    fn of(round: &Round, [x, y, z]: [f64; 3]) -> Self {
        let away_m = x.hypot(z).max(1e-9);
        let (sin, cos) = (x / away_m, z / away_m);
        Place {
            away_m,
            frame: [[sin, 0.0, cos], [cos, 0.0, -sin], [0.0, 1.0, 0.0]],
            at_m: [round.radius_m * x.atan2(z), y],
        }
    }
}

/// How it sticks.
#[derive(Clone, Copy, Default)]
struct Stuck {
    /// From where it sticks, after what slipped \[m\], (2).
    stretched_m: [f64; 2],
    /// How far that slipped \[m\], (2).
    slip_m: [f64; 2],
    /// Whether it did.
    slips: bool,
}

struct Felt {
    round: Round,
    most_rows: usize,
    /// From a state until the end of its frame's use \[s\]; 0 for who is not late.
    ahead_s: f64,
    /// Of the last contact.
    normal: [f64; 3],
    /// Where it sticks \[m\], (2).
    anchor_m: Option<[f64; 2]>,
}

impl Felt {
    fn push_n(&self, place: &Place) -> f64 {
        let depth_m = (self.round.radius_m - place.away_m).max(0.0);
        self.round.stiffness_n_per_m * depth_m
    }

    /// Takes the place where it sticks along, as far as friction lets go.
    fn stick(&mut self, place: &Place) -> Stuck {
        let push_n = self.push_n(place);
        if self.round.friction == 0.0 || push_n == 0.0 {
            self.anchor_m = None;
            return Stuck::default();
        }
        let anchor = self.anchor_m.get_or_insert(place.at_m);
        // Around the body there are two ways.
        let whole_m = TAU * self.round.radius_m;
        let around = place.at_m[0] - anchor[0];
        let around = around - whole_m * (around / whole_m).round();
        let moved = [around, place.at_m[1] - anchor[1]];
        let length = moved[0].hypot(moved[1]);
        let held = self.round.friction * push_n / self.round.along_n_per_m();
        if length <= held {
            return Stuck {
                stretched_m: moved,
                ..Stuck::default()
            };
        }
        let stretched_m = moved.map(|x| x * held / length);
        let slip_m = [0, 1].map(|i: usize| moved[i] - stretched_m[i]);
        *anchor = [0, 1].map(|i: usize| anchor[i] + slip_m[i]);
        Stuck {
            stretched_m,
            slip_m,
            slips: true,
        }
    }

    /// One cone, as a solver sends it.
    fn rows(&self, place: &Place, lambda_n: [f64; 3], stuck: &Stuck) -> Option<Box<ToolRows>> {
        if self.round.friction == 0.0 || self.most_rows < 3 {
            return None;
        }
        let mut rows = Box::new(ToolRows::NONE);
        rows.count = 3;
        rows.turning = true;
        rows.kind[..3].copy_from_slice(&[
            ToolRowKind::Normal {
                friction: self.round.friction,
            },
            ToolRowKind::Tangent,
            ToolRowKind::Tangent,
        ]);
        rows.delta_m[0] = (place.away_m - self.round.radius_m).max(0.0);
        rows.slip_m[1..3].copy_from_slice(&stuck.slip_m);
        rows.lambda_n[..3].copy_from_slice(&lambda_n);
        for (row, direction) in rows.jacobian.iter_mut().zip(place.frame) {
            row[..3].copy_from_slice(&direction);
        }
        let along = 1.0 / self.round.along_n_per_m();
        // Upper triangle by rows.
        let compliance = [
            1.0 / self.round.stiffness_n_per_m,
            0.0,
            0.0,
            along,
            0.0,
            along,
        ];
        rows.compliance[..6].copy_from_slice(&compliance);
        for (i, row) in held(place, lambda_n).into_iter().enumerate() {
            rows.held[i][..3].copy_from_slice(&row);
        }
        Some(rows)
    }
}

/// What the turning of the directions alone does to the force \[N/m\], (3 x 3): the symmetric part.
fn held(place: &Place, lambda_n: [f64; 3]) -> [[f64; 3]; 3] {
    let [normal, around, _] = place.frame;
    [0, 1, 2].map(|i: usize| {
        [0, 1, 2].map(|j: usize| {
            let turned = around[i] * around[j] * lambda_n[0];
            let across = 0.5 * (normal[i] * around[j] + around[i] * normal[j]) * lambda_n[1];
            (turned - across) / place.away_m
        })
    })
}

impl Truth for Felt {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let round = self.round;
        // As a session does; the truth looks nowhere but where it is.
        let goal = (self.ahead_s > 0.0).then(|| {
            let (here, velocity) = (sample.position_m, sample.velocity_m_per_s);
            let [here, velocity] = [here, velocity].map(|v| v.map(|x| x as f32));
            sideways(here, velocity, &self.normal, sample.lead_s, self.ahead_s)
        });
        // Where it sticks is a matter of where the grip was, not of where it may go.
        let here = Place::of(&round, sample.position_m);
        let mut stuck = self.stick(&here);
        let mut place = here;
        if let Some(goal) = goal {
            place = Place::of(&round, goal.position_m.map(f64::from));
            let kept = self.anchor_m;
            stuck = self.stick(&place);
            self.anchor_m = kept;
        }
        let push_n = self.push_n(&place);
        let drag_n = stuck.stretched_m.map(|x| -round.along_n_per_m() * x);
        let lambda_n = [push_n, drag_n[0], drag_n[1]];
        let [normal, around, axis] = place.frame;
        let mut solution = Solution {
            position_m: goal.map(|goal| goal.position_m),
            normal,
            rows: self.rows(&place, lambda_n, &stuck),
            ..Solution::nothing(place.away_m - round.radius_m)
        };
        let turning = held(&place, lambda_n);
        let sticks = if round.friction > 0.0 && push_n > 0.0 && !stuck.slips {
            round.along_n_per_m()
        } else {
            0.0
        };
        for i in 0..3 {
            let directions = place.frame.iter().zip(lambda_n);
            solution.wrench[i] = directions.map(|(d, lambda)| d[i] * lambda).sum();
            for j in 0..3 {
                // On the skin the same turn is a longer way.
                let longer = round.radius_m / place.away_m;
                let along = longer * around[i] * around[j] + axis[i] * axis[j];
                solution.tangent[i][j] = turning[i][j]
                    - round.stiffness_n_per_m * normal[i] * normal[j]
                    - sticks * along;
            }
        }
        self.normal = normal;
        Some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(position_m: [f64; 3]) -> Sample {
        Sample {
            time_s: 0.0,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            lead_s: 0.0,
            has_time: true,
        }
    }

    /// Where it sticks: the symmetric part, which is what is sent.
    #[test]
    fn the_tangent_is_the_derivative_where_it_sticks() {
        let round = Round::THIN.rubbed(0.3);
        let solve = |position_m: [f64; 3]| {
            let mut felt = round.start(24, 0.0, 1e-3);
            felt.solve(&at([2.9e-3, 0.9e-3, 5e-3]));
            felt.solve(&at(position_m)).expect("always solved")
        };
        let here = [3e-3, 1e-3, 5e-3];
        let solution = solve(here);
        let mut slope = [[0.0; 3]; 3];
        for axis in 0..3 {
            let mut beside = here;
            beside[axis] += 1e-9;
            let there = solve(beside);
            for (i, row) in slope.iter_mut().enumerate() {
                row[axis] = (there.wrench[i] - solution.wrench[i]) / 1e-9;
            }
        }
        for (i, row) in slope.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                let symmetric = 0.5 * (entry + slope[j][i]);
                let own = 0.5 * (solution.tangent[i][j] + solution.tangent[j][i]);
                assert!((symmetric - own).abs() < 1e-2, "{i} {j}: {symmetric} {own}");
            }
        }
    }

    /// Dragged all the way around it slides with mu N against its way, and lies on its cone.
    #[test]
    fn what_is_dragged_around_slides() {
        let round = Round::THIN.rubbed(0.3);
        let mut felt = round.start(24, 0.0, 1e-3);
        let mut slipped = 0.0;
        for step in 0..=2000 {
            let angle = TAU * f64::from(step) / 1000.0;
            let (sin, cos) = angle.sin_cos();
            let solution = felt.solve(&at([7e-3 * sin, 0.0, 7e-3 * cos]));
            let solution = solution.expect("always solved");
            let rows = solution.rows.expect("it rubs");
            let [push, drag] = [rows.lambda_n[0], rows.lambda_n[1]];
            assert!((push - 0.5).abs() < 1e-9);
            let along = solution.wrench[0] * cos - solution.wrench[2] * sin;
            assert!((along - drag).abs() < 1e-12);
            slipped += rows.slip_m[1];
            if step > 100 {
                assert!((drag + 0.15).abs() < 1e-9, "{step}: {drag}");
            }
        }
        // Twice around, but for what stretches.
        let way = 2.0 * TAU * 8e-3 - 0.15 / 100.0;
        assert!((slipped - way).abs() < 1e-9, "{slipped} {way}");
    }

    #[test]
    fn the_tangent_is_the_derivative() {
        let solve = |position_m: [f64; 3]| {
            let solution = Round::THIN.start(0, 0.0, 1e-3).solve(&at(position_m));
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
