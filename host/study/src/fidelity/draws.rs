//! All that differs from session to session at once: a Latin hypercube of it, by a seed.
//!
//! Entry point: [`draws`]. McKay, Beckman and Conover 1979: each factor's range is cut into as many equal parts as there are
//! draws, and each part is drawn from once, so that a few hundred draws see every factor's ends without seeing all
//! corners of the cube.

use super::around::Around;
use super::hand::Grasp;
use super::plant::Off;
use super::random::Random;
use super::scenes::turned::Turn;
use schemars::JsonSchema;
use serde::Serialize;

/// What is drawn: phase, three numbers of a turn, cold start, blocking host, delay, lag, mass, torque, hand.
pub const FACTORS: usize = 11;
/// Of the published draws.
pub const SEED: u64 = 20;
/// How many these are.
pub const DRAWS: usize = 200;

/// So many points of the unit cube: in each coordinate every part of that many has one.
pub fn latin_hypercube(count: usize, seed: u64) -> Vec<[f64; FACTORS]> {
    let mut random = Random::new(seed);
    let mut points = vec![[0.0; FACTORS]; count];
    let mut order: Vec<usize> = (0..count).collect();
    for factor in 0..FACTORS {
        // Fisher and Yates.
        for last in (1..count).rev() {
            order.swap(last, (random.unit() * (last + 1) as f64) as usize);
        }
        for (point, part) in points.iter_mut().zip(&order) {
            point[factor] = (*part as f64 + random.unit()) / count as f64;
        }
    }
    points
}

/// One of them, as it is printed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Draw {
    /// Which.
    pub draw: u16,
    /// As [`Around::phase`].
    pub phase: f64,
    /// Unit quaternion (x, y, z, w) by which the scene is turned.
    pub turn: [f64; 4],
    /// A quarter of all start without any compliance column.
    pub cold: bool,
    /// Half of all hosts block, each as this seed says.
    pub blocks: Option<u64>,
    /// A tick less or more of delay than described, or as described.
    pub ticks: i8,
    /// 0 to 2 \[ms\].
    pub lag_ms: f64,
    /// 0.5 to 2, evenly in its logarithm.
    pub mass: f64,
    /// 0.8 to 1.2.
    pub torque: f64,
    /// Stiffness of the hand \[N/m\]; none for one that goes its way. Two in five are rigid.
    pub hand_n_per_m: Option<f64>,
}

/// The draws of a seed.
pub fn draws(count: usize, seed: u64) -> Vec<Draw> {
    let points = latin_hypercube(count, seed).into_iter();
    let numbered = (0_u16..).zip(points);
    numbered
        .map(|(draw, point)| Draw::of(draw, point))
        .collect()
}

impl Draw {
    fn of(draw: u16, point: [f64; FACTORS]) -> Self {
        let [
            phase,
            one,
            two,
            three,
            cold,
            blocks,
            ticks,
            lag,
            mass,
            torque,
            hand,
        ] = point;
        Draw {
            draw,
            phase,
            turn: Turn::of([one, two, three]).quaternion(),
            cold: cold < 0.25,
            blocks: (blocks < 0.5).then_some(1000 + u64::from(draw)),
            ticks: (3.0 * ticks) as i8 - 1,
            lag_ms: 2.0 * lag,
            mass: 0.5 * 4.0_f64.powf(mass),
            torque: 0.8 + 0.4 * torque,
            hand_n_per_m: match 5.0 * hand {
                h if h < 2.0 => None,
                h if h < 3.0 => Some(50.0),
                h if h < 4.0 => Some(200.0),
                _ => Some(800.0),
            },
        }
    }

    /// What surrounds the console.
    pub fn around(&self) -> Around {
        Around {
            phase: self.phase,
            turn: Turn::by(self.turn),
            cold: self.cold,
            blocks: self.blocks,
        }
    }

    /// The console.
    pub fn off(&self) -> Off {
        Off {
            ticks: self.ticks,
            lag_s: 1e-3 * self.lag_ms,
            mass: self.mass,
            torque: self.torque,
        }
    }

    /// The hand, with the damping ratio of a pen's.
    pub fn grasp(&self) -> Grasp {
        self.hand_n_per_m
            .map_or(Grasp::Rigid, |stiffness_n_per_m| Grasp::Spring {
                stiffness_n_per_m,
                damping_n_s_per_m: 2.0 * (stiffness_n_per_m / 200.0).sqrt(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_of_every_factor_is_drawn_once() {
        for (count, seed) in [(200, SEED), (7, 3), (1, 1)] {
            let points = latin_hypercube(count, seed);
            for factor in 0..FACTORS {
                let mut parts = vec![0; count];
                for point in &points {
                    parts[(point[factor] * count as f64) as usize] += 1;
                }
                assert!(parts.iter().all(|n| *n == 1), "{factor}: {parts:?}");
            }
        }
        assert_eq!(draws(20, 3), draws(20, 3));
        assert_ne!(draws(20, 3), draws(20, 4));
    }

    /// Strata alone would allow two factors that always go together.
    #[test]
    fn factors_do_not_go_together() {
        let points = latin_hypercube(DRAWS, SEED);
        for a in 0..FACTORS {
            for b in 0..a {
                let products = points.iter().map(|p| (p[a] - 0.5) * (p[b] - 0.5));
                let correlation = 12.0 * products.sum::<f64>() / DRAWS as f64;
                // Standard deviation 0.07.
                assert!(correlation.abs() < 0.25, "{a} {b}: {correlation}");
            }
        }
    }

    #[test]
    fn draws_fill_their_ranges() {
        let draws = draws(DRAWS, SEED);
        let count = |is: &dyn Fn(&Draw) -> bool| draws.iter().filter(|draw| is(draw)).count();
        assert_eq!(count(&|d| d.cold), 50);
        assert_eq!(count(&|d| d.blocks.is_some()), 100);
        assert_eq!(count(&|d| d.hand_n_per_m.is_none()), 80);
        // 200 in three parts.
        assert!((66..=67).contains(&count(&|d| d.ticks == 1)));
        assert!((66..=68).contains(&count(&|d| d.ticks == -1)));
        assert!(draws.iter().all(|d| (0.5..=2.0).contains(&d.mass)));
        assert!(draws.iter().all(|d| (0.8..=1.2).contains(&d.torque)));
        assert!(draws.iter().any(|d| d.mass < 0.51) && draws.iter().any(|d| d.mass > 1.96));
    }
}
