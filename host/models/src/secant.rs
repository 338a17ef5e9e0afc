//! Tangent of held nodes as a secant, for models whose reactions have no derivative.
//!
//! Entry points: [`secant_of_step`], [`secant_to_come`]. The step is taken again with the nodes moved both ways along each axis, over one
//! distance and over half of it; the difference of the two is the stated error. Nothing is allocated: [`Trials`] has the
//! memory.

use crate::{BoundaryConditions, Outcome, Tangent, Tissue};

/// Held nodes, ascending, and their displacements from rest \[m\].
type Holds = Vec<(u32, [f64; 3])>;

/// What trial steps are made with.
#[derive(Clone, Debug)]
pub(crate) struct Trials<S> {
    /// Everything that a step changes, as it is before them.
    before: S,
    /// Of a trial, and of what its nodes are moved from.
    held: Holds,
    from: Holds,
    /// Which of these are moved, by index, and by what part of the common displacement.
    moved: Vec<(usize, f64)>,
}

impl<S> Trials<S> {
    /// Of tissue with so many nodes, whose state this is at rest.
    pub fn new(rest: S, nodes: usize) -> Self {
        Self {
            before: rest,
            held: Vec::with_capacity(nodes),
            from: Vec::with_capacity(nodes),
            moved: Vec::with_capacity(nodes),
        }
    }
}

/// Everything of a tissue that a step changes, and what trials are made with.
pub(crate) type Parts<T, S> = fn(&mut T) -> (&mut S, &mut Trials<S>);

/// The secant of one step of `tissue` over +-`reach_m` and half of it, of held nodes that are moved alike.
pub(crate) fn secant_of_step<T: Tissue, S: Clone>(
    tissue: &mut T,
    parts: Parts<T, S>,
    drive: &BoundaryConditions<'_>,
    moved: &[usize],
    reach_m: f64,
    step_s: f64,
) -> Option<Tangent> {
    let trials = parts(tissue).1;
    trials.from.clear();
    trials.from.extend_from_slice(drive.held);
    trials.moved.clear();
    trials.moved.extend(moved.iter().map(|index| (*index, 1.0)));
    around(tissue, parts, drive.force_n, reach_m, step_s)
}

/// The same of nodes that nothing holds yet, from where they are, each moved by its part of the displacement.
pub(crate) fn secant_to_come<T: Tissue, S: Clone>(
    tissue: &mut T,
    parts: Parts<T, S>,
    rest_m: fn(&T, usize) -> Option<[f64; 3]>,
    drive: &BoundaryConditions<'_>,
    touched: &[(u32, f64)],
    reach_m: f64,
    step_s: f64,
) -> Option<Tangent> {
    let trials = parts(tissue).1;
    let mut from = std::mem::take(&mut trials.from);
    let mut moved = std::mem::take(&mut trials.moved);
    from.clear();
    from.extend_from_slice(drive.held);
    moved.clear();
    for (node, _) in touched {
        let place = *node as usize;
        let (now, rest) = (tissue.positions_m().get(place), rest_m(tissue, place));
        let (Some(now), Some(rest)) = (now, rest) else {
            continue;
        };
        if drive
            .held
            .binary_search_by_key(node, |held| held.0)
            .is_err()
        {
            from.push((*node, [0, 1, 2].map(|axis| now[axis] - rest[axis])));
        }
    }
    from.sort_unstable_by_key(|held| held.0);
    for (index, (node, _)) in from.iter().enumerate() {
        let part = touched.iter().find(|(touched, _)| touched == node);
        let is_held = drive.held.binary_search_by_key(node, |held| held.0).is_ok();
        moved.extend(part.filter(|_| !is_held).map(|(_, part)| (index, *part)));
    }
    let trials = parts(tissue).1;
    (trials.from, trials.moved) = (from, moved);
    around(tissue, parts, drive.force_n, reach_m, step_s)
}

/// Of what the trials say is moved.
fn around<T: Tissue, S: Clone>(
    tissue: &mut T,
    parts: Parts<T, S>,
    force_n: &[[f64; 3]],
    reach_m: f64,
    step_s: f64,
) -> Option<Tangent> {
    let (state, trials) = parts(tissue);
    trials.before.clone_from(state);
    let mut held = std::mem::take(&mut trials.held);
    let from = std::mem::take(&mut trials.from);
    let moved = std::mem::take(&mut trials.moved);
    let drive = BoundaryConditions {
        held: &from,
        force_n,
    };
    let tangent = secant(&drive, &mut held, &moved, reach_m, |trial| {
        let summed = match tissue.step(trial, step_s).outcome {
            Outcome::Failed(_) => None,
            _ => {
                let reactions_n = tissue.reactions_n();
                let of = |axis: usize| {
                    let parts = moved.iter().map(|(at, part)| part * reactions_n[*at][axis]);
                    parts.sum()
                };
                Some([of(0), of(1), of(2)])
            }
        };
        let (state, trials) = parts(tissue);
        state.clone_from(&trials.before);
        summed
    });
    let trials = parts(tissue).1;
    (trials.held, trials.from, trials.moved) = (held, from, moved);
    tangent
}

/// The tangent of `reactions` of `moved` over +-`reach_m` and +-`reach_m / 2`. `reactions` takes the held
/// nodes of a trial, which are written to `held`, and gives the summed reaction of `moved` \[N\] after one step from where
/// the model stands, or nothing where that step fails.
// A column of the tangent for each axis, by rows.
#[allow(clippy::needless_range_loop)]
fn secant(
    drive: &BoundaryConditions<'_>,
    held: &mut Holds,
    moved: &[(usize, f64)],
    reach_m: f64,
    mut reactions: impl FnMut(&BoundaryConditions<'_>) -> Option<[f64; 3]>,
) -> Option<Tangent> {
    if moved.is_empty() || moved.iter().any(|(index, _)| *index >= drive.held.len()) {
        return None;
    }
    let mut over = |reach: f64| -> Option<[[f64; 3]; 3]> {
        let mut stiffness = [[0.0; 3]; 3];
        for axis in 0..3 {
            let mut ends = [[0.0; 3]; 2];
            for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
                held.clear();
                held.extend_from_slice(drive.held);
                for (index, part) in moved {
                    held[*index].1[axis] += sign * reach * part;
                }
                let trial = BoundaryConditions {
                    held,
                    force_n: drive.force_n,
                };
                *end = reactions(&trial)?;
            }
            for row in 0..3 {
                stiffness[row][axis] = (ends[0][row] - ends[1][row]) / (2.0 * reach);
            }
        }
        Some(stiffness)
    };
    let (far, near) = (over(reach_m)?, over(0.5 * reach_m)?);
    let norm = |of: &dyn Fn(usize, usize) -> f64| {
        let entries = (0..9).map(|entry| of(entry / 3, entry % 3).powi(2));
        entries.sum::<f64>().sqrt()
    };
    let size = norm(&|row, column| near[row][column]);
    let difference = norm(&|row, column| far[row][column] - near[row][column]);
    Some(Tangent {
        stiffness_n_per_m: near,
        error: if difference == 0.0 {
            0.0
        } else {
            difference / size
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HELD: [(u32, [f64; 3]); 2] = [(0, [0.0; 3]), (3, [0.1, 0.0, 0.0])];

    #[test]
    fn a_linear_force_is_exact_and_a_curved_one_says_its_error() {
        let drive = BoundaryConditions {
            held: &HELD,
            force_n: &[],
        };
        let linear = |trial: &BoundaryConditions<'_>| {
            let [x, y, z] = trial.held[1].1;
            Some([3.0 * x + y, 2.0 * y, x - z])
        };
        let tangent =
            secant(&drive, &mut Vec::new(), &[(1, 1.0)], 1e-3, linear).expect("a tangent");
        let expected = [[3.0, 1.0, 0.0], [0.0, 2.0, 0.0], [1.0, 0.0, -1.0]];
        for (row, expected) in tangent.stiffness_n_per_m.iter().zip(expected) {
            for (value, expected) in row.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-9);
            }
        }
        assert!(tangent.error < 1e-9);
        // x^3 at 0.1: the secant over h is 3 x^2 + h^2.
        let cubic = |trial: &BoundaryConditions<'_>| Some([trial.held[1].1[0].powi(3), 0.0, 0.0]);
        let tangent = secant(&drive, &mut Vec::new(), &[(1, 1.0)], 0.02, cubic).expect("a tangent");
        assert!((tangent.stiffness_n_per_m[0][0] - 0.0301).abs() < 1e-12);
        assert!((tangent.error - 0.0003 / 0.0301).abs() < 1e-9);
    }

    #[test]
    fn no_nodes_no_tangent() {
        let drive = BoundaryConditions {
            held: &HELD,
            force_n: &[],
        };
        assert_eq!(
            secant(&drive, &mut Vec::new(), &[], 1e-3, |_| Some([0.0; 3])),
            None
        );
        assert_eq!(
            secant(&drive, &mut Vec::new(), &[(2, 1.0)], 1e-3, |_| Some(
                [0.0; 3]
            )),
            None
        );
        assert_eq!(
            secant(&drive, &mut Vec::new(), &[(0, 1.0)], 1e-3, |_| None),
            None
        );
    }
}
