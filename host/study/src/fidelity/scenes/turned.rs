//! Any scene, turned in space with the hand and the tool in it: what is felt must be the same, turned.
//!
//! Entry points: [`Turn`], [`Turned`]. The scene itself is solved in its own frame, so that it has the same bits before they
//! are turned; what differs is all that the console makes of it.

use super::{Sample, Scene, Solution, Truth};
use nalgebra::{Quaternion, Rotation3, Unit, UnitQuaternion, Vector3};

/// A rotation of space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn(Rotation3<f64>);

impl Turn {
    /// None.
    pub fn none() -> Self {
        Turn(Rotation3::identity())
    }

    /// The scenes' normal, z, to (1, 1, 1): no axis of the console is along it.
    pub fn diagonal() -> Self {
        let (z, diagonal) = (Vector3::z(), Vector3::new(1.0, 1.0, 1.0));
        Turn(Rotation3::rotation_between(&z, &diagonal).unwrap_or_default())
    }

    /// Evenly spread over all turns for three numbers in 0..1 that are (Shoemake 1992).
    pub fn of([one, two, three]: [f64; 3]) -> Self {
        let (first, second) = ((1.0 - one).sqrt(), one.sqrt());
        let [a, b] = [two, three].map(|part| std::f64::consts::TAU * part);
        let turn = Quaternion::new(
            second * b.cos(),
            first * a.sin(),
            first * a.cos(),
            second * b.sin(),
        );
        Turn(Unit::new_normalize(turn).to_rotation_matrix())
    }

    /// By a unit quaternion (x, y, z, w).
    pub fn by([x, y, z, w]: [f64; 4]) -> Self {
        Turn(Unit::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix())
    }

    /// Whether it turns nothing.
    pub fn is_none(&self) -> bool {
        *self == Turn::none()
    }

    /// As a unit quaternion (x, y, z, w).
    pub fn quaternion(&self) -> [f64; 4] {
        let turn = UnitQuaternion::from_rotation_matrix(&self.0);
        [turn.i, turn.j, turn.k, turn.w]
    }

    /// A vector with the scene.
    pub fn turned(&self, v: [f64; 3]) -> [f64; 3] {
        (self.0 * Vector3::from(v)).into()
    }

    /// The vector that it turns into this one.
    pub fn back(&self, v: [f64; 3]) -> [f64; 3] {
        (self.0.inverse() * Vector3::from(v)).into()
    }

    fn turned_f32<const N: usize>(&self, v: &mut [f32; N]) {
        let (parts, _) = v.as_chunks_mut::<3>();
        for part in parts {
            *part = self.turned(part.map(f64::from)).map(|x| x as f32);
        }
    }

    /// A wrench, or a row of a Jacobian: two vectors.
    fn pair(&self, v: &mut [f64; 6]) {
        let (parts, _) = v.as_chunks_mut::<3>();
        for part in parts {
            *part = self.turned(*part);
        }
    }

    /// A matrix that maps such pairs to such pairs.
    fn square(&self, matrix: &mut [[f64; 6]; 6]) {
        for row in matrix.iter_mut() {
            self.pair(row);
        }
        for column in 0..6 {
            let mut pair = matrix.map(|row| row[column]);
            self.pair(&mut pair);
            for (row, entry) in matrix.iter_mut().zip(pair) {
                row[column] = entry;
            }
        }
    }

    fn solution(&self, solution: &mut Solution) {
        if let Some(position_m) = &mut solution.position_m {
            self.turned_f32(position_m);
        }
        self.pair(&mut solution.wrench);
        self.square(&mut solution.tangent);
        solution.normal = self.turned(solution.normal);
        if let Some(rows) = &mut solution.rows {
            let count = rows.count.min(rows.jacobian.len());
            for row in &mut rows.jacobian[..count] {
                self.pair(row);
            }
            self.square(&mut rows.held);
        }
        if let Some(needle) = &mut solution.needle {
            self.turned_f32(&mut needle.slide);
        }
        if let Some(thread) = &mut solution.thread {
            self.turned_f32(&mut thread.direction);
        }
    }
}

/// A scene that is turned about the world's origin.
pub struct Turned<'a> {
    /// As it stands.
    pub scene: &'a dyn Scene,
    /// By what.
    pub turn: Turn,
}

impl Scene for Turned<'_> {
    fn name(&self) -> &'static str {
        self.scene.name()
    }

    fn origin_m(&self) -> [f64; 3] {
        self.turn.turned(self.scene.origin_m())
    }

    fn place(&self, way_m: [f64; 3]) -> [f64; 3] {
        self.turn.turned(self.scene.place(way_m))
    }

    fn start(&self, most_rows: usize, ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        Box::new(TurnedTruth {
            truth: self.scene.start(most_rows, ahead_s, period_s),
            turn: self.turn,
        })
    }

    fn start_cold(&self, most_rows: usize, ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        Box::new(TurnedTruth {
            truth: self.scene.start_cold(most_rows, ahead_s, period_s),
            turn: self.turn,
        })
    }
}

struct TurnedTruth {
    truth: Box<dyn Truth>,
    turn: Turn,
}

impl Truth for TurnedTruth {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let [x, y, z, w] = sample.orientation;
        let turn = UnitQuaternion::from_rotation_matrix(&self.turn.0);
        let grip = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        // The tool is turned in the grip as the scene is in the world.
        let inner = turn.inverse() * grip * turn;
        let mut solution = self.truth.solve(&Sample {
            position_m: self.turn.back(sample.position_m),
            velocity_m_per_s: self.turn.back(sample.velocity_m_per_s),
            orientation: [inner.i, inner.j, inner.k, inner.w],
            ..*sample
        })?;
        self.turn.solution(&mut solution);
        Some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::hand::Motion;
    use super::super::super::run::truth_along;
    use super::super::palpation::Palpation;
    use super::super::point::Point;
    use super::super::round::Round;
    use super::*;

    fn turns() -> [Turn; 3] {
        [
            Turn::diagonal(),
            Turn::of([0.3, 0.8, 0.1]),
            Turn::of([0.9, 0.2, 0.6]),
        ]
    }

    #[test]
    fn turns_turn() {
        let third = 1.0 / 3.0_f64.sqrt();
        let turned = Turn::diagonal().turned([0.0, 0.0, 2.0]);
        assert!(turned.iter().all(|x| (x - 2.0 * third).abs() < 1e-15));
        for turn in turns() {
            let there = turn.turned([0.1, -0.2, 0.3]);
            let back = turn.back(there);
            assert!((back[1] + 0.2).abs() < 1e-15 && (back[2] - 0.3).abs() < 1e-15);
            assert!((turn.0.matrix().determinant() - 1.0).abs() < 1e-12);
        }
        assert!(Turn::none().is_none() && !Turn::diagonal().is_none());
    }

    /// A host that solves every millisecond feels the same, turned, whatever the turn: the harness itself prefers none.
    #[test]
    fn the_truth_is_the_same_turned() {
        let palpation = Palpation::load(0.0).expect("the shipped scene");
        let scenes: [(&dyn Scene, Motion); 3] = [
            (&Point::TISSUE, Motion::Strokes),
            (&Round::THIN, Motion::RoundThin),
            (&palpation, Motion::Taps),
        ];
        for (scene, motion) in scenes {
            let straight = truth_along(scene, motion, 0.7);
            let largest = straight
                .iter()
                .map(|now| now.force_n[2])
                .fold(0.0, f64::max);
            assert!(largest > 0.5, "{}: {largest}", scene.name());
            for turn in turns() {
                let turned = truth_along(&Turned { scene, turn }, motion, 0.7);
                for (now, then) in straight.iter().zip(&turned) {
                    let back = turn.back(then.force_n);
                    for (turned, straight) in back.iter().zip(now.force_n) {
                        let off = (turned - straight).abs();
                        assert!(off < 1e-9, "{} {off}", scene.name());
                    }
                }
            }
        }
    }

    /// What is sent turns as tensors do: force by a small step, of tangent and rows alike.
    #[test]
    fn what_is_sent_turns_as_the_force_does() {
        let scene = Point::TISSUE;
        let turn = turns()[1];
        let turned = Turned {
            scene: &scene,
            turn,
        };
        let at = |scene: &dyn Scene, way| Sample {
            time_s: 0.0,
            position_m: scene.place(way),
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            lead_s: 0.0,
            has_time: true,
        };
        let way = [1e-3, 2e-3, -4e-3];
        let step = [0.3e-3, -0.1e-3, 0.2e-3];
        let change = |solution: &Solution, step: [f64; 3]| {
            [0, 1, 2].map(|i: usize| {
                (0..3)
                    .map(|j| solution.tangent[i][j] * step[j])
                    .sum::<f64>()
            })
        };
        let mut solve = (scene.start(0, 0.0, 1e-3), turned.start(0, 0.0, 1e-3));
        let straight = solve.0.solve(&at(&scene, way)).expect("solved");
        let there = solve.1.solve(&at(&turned, way)).expect("solved");
        let expected = turn.turned(change(&straight, step));
        let found = change(&there, turn.turned(step));
        for axis in 0..3 {
            assert!((expected[axis] - found[axis]).abs() < 1e-9);
        }
    }
}
