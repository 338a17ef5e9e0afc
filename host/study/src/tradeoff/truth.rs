//! The two answers to a case: Newton's balance of linear cells on the same mesh, and quadratic cells.
//!
//! Entry points: [`solve`], [`Answer::error`]. Both by [`Hyperelastic`], whose own tests compare it with
//! other programs. Stress that fades does so in all directions alike, so that a case that holds its
//! displacement has the elastic answer's places, and its force convolved.

use super::cases::Case;
use super::lattice::Lattice;
use nalgebra::Vector3;
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::{BoundaryConditions, Outcome, Tissue};

/// A drive that grows with the case's ramp.
pub struct Course {
    whole: Vec<(u32, [f64; 3])>,
    force: Vec<[f64; 3]>,
    held: Vec<(u32, [f64; 3])>,
    force_n: Vec<[f64; 3]>,
    /// Rows of the held nodes that move; of all that are held if none does.
    pub moved: Vec<usize>,
}

impl Course {
    /// Of a case on a mesh of its.
    pub fn new(case: &Case, lattice: &Lattice) -> Self {
        let nodes = (0u32..).zip(&lattice.unit);
        let whole: Vec<_> = nodes
            .filter_map(|(node, at)| Some((node, (case.held)(*at)?)))
            .collect();
        let force = case.traction.map_or(Vec::new(), |traction| {
            lattice.spread(&lattice.faces(traction.there), traction.force_n)
        });
        let mut moved: Vec<usize> = (0..whole.len())
            .filter(|row| whole[*row].1 != [0.0; 3])
            .collect();
        if moved.is_empty() {
            moved = (0..whole.len()).collect();
        }
        Self {
            held: whole.clone(),
            force_n: force.clone(),
            whole,
            force,
            moved,
        }
    }

    /// At a share of the whole.
    pub fn at(&mut self, share: f64) -> BoundaryConditions<'_> {
        for (now, whole) in self.held.iter_mut().zip(&self.whole) {
            now.1 = whole.1.map(|u| share * u);
        }
        for (now, whole) in self.force_n.iter_mut().zip(&self.force) {
            *now = whole.map(|f| share * f);
        }
        BoundaryConditions {
            held: &self.held,
            force_n: &self.force_n,
        }
    }
}

/// What tissue does in the end.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Displacement of every node of the mesh \[m\], (n).
    pub u: Vec<Vector3<f64>>,
    /// Summed force of the nodes that move on tissue \[N\].
    pub force_n: Vector3<f64>,
}

/// How far off a displacement field and its force are, % of the answer's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Error {
    /// RMS over all nodes.
    pub rms_pct: f64,
    /// Largest, over the largest displacement.
    pub max_pct: f64,
    /// Largest of one component on the line, over its largest there.
    pub line_pct: f64,
    /// Of the force.
    pub force_pct: f64,
}

/// The answer with some cells on a mesh, at the nodes of each of `on`.
///
/// # Errors
/// Why there is none.
pub fn solve(
    case: &Case,
    lattice: &Lattice,
    cells: Cells,
    on: &[&Lattice],
) -> Result<Vec<Answer>, String> {
    let settings = Settings {
        cells,
        ..Settings::default()
    };
    let law = case.substance.law();
    let mut tissue = Hyperelastic::new(&lattice.mesh, &[law], settings)
        .map_err(|error| format!("{}: {error}", case.name))?;
    let mut course = Course::new(case, lattice);
    // Quadratic cells carry a load in the middle of their edges.
    let own_load = case.traction.filter(|_| cells == Cells::Quadratic);
    let faces = own_load.map(|traction| lattice.faces(traction.there));
    let steps = if case.substance.relaxation.is_some() {
        case.ramp
    } else {
        1
    };
    let (mut force, mut last, mut faded) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    for step in 1..=steps {
        let share = step as f64 / steps as f64;
        if let (Some(traction), Some(faces)) = (own_load, &faces) {
            tissue.clear_loads();
            tissue
                .add_traction(faces, traction.force_n.map(|f| share * f))
                .map_err(|error| format!("{}: {error}", case.name))?;
        }
        let mut drive = course.at(share);
        if own_load.is_some() {
            drive.force_n = &[];
        }
        let done = tissue.step(&drive, case.step_s);
        if done.outcome != Outcome::Converged {
            return Err(format!(
                "{} has no answer at level {:?}: {:?}",
                case.name, lattice.divisions, done.outcome
            ));
        }
        force = summed(&tissue, &course.moved);
        if let Some((share, time_s)) = case.substance.relaxation {
            // The change comes in the middle of its step.
            let left_s = (case.ramp + case.rest - step) as f64 * case.step_s + 0.5 * case.step_s;
            faded += (force - last) * (1.0 - share * (1.0 - (-left_s / time_s).exp()));
            last = force;
        }
    }
    if case.substance.relaxation.is_some() {
        force = faded;
    }
    let there = |at: &[f64; 3]| {
        let (cell, shares) = lattice.locate(*at);
        let found = tissue.deformation(cell, shares);
        found.map_or(Vector3::repeat(f64::NAN), |(u, _)| u.into())
    };
    Ok(on
        .iter()
        .map(|lattice| Answer {
            u: lattice.unit.iter().map(there).collect(),
            force_n: force,
        })
        .collect())
}

/// Summed reaction of some rows of the last drive \[N\].
pub fn summed(tissue: &dyn Tissue, rows: &[usize]) -> Vector3<f64> {
    let reactions = tissue.reactions_n();
    rows.iter()
        .filter_map(|row| reactions.get(*row))
        .map(|force| Vector3::from(*force))
        .sum()
}

/// Where nodes are, from rest \[m\], (n).
pub fn displacements(tissue: &dyn Tissue, lattice: &Lattice) -> Vec<Vector3<f64>> {
    let rest = lattice.mesh.points_m().iter();
    tissue
        .positions_m()
        .iter()
        .zip(rest)
        .map(|(at, rest)| Vector3::from(*at) - Vector3::from(*rest))
        .collect()
}

impl Answer {
    /// How far off `other` is, on the mesh of both.
    pub fn error(&self, other: &Self, case: &Case, lattice: &Lattice) -> Error {
        let (mut square, mut scale) = (0.0, 0.0);
        let (mut most, mut largest) = (0.0f64, 0.0f64);
        let (mut line, mut line_scale) = (0.0f64, 0.0f64);
        let axis = case.red_line.axis;
        for ((true_u, u), at) in self.u.iter().zip(&other.u).zip(&lattice.unit) {
            let off = u - true_u;
            square += off.norm_squared();
            scale += true_u.norm_squared();
            // A maximum would lose what is not a number.
            most = if off.norm() > most || off.norm().is_nan() {
                off.norm()
            } else {
                most
            };
            largest = largest.max(true_u.norm());
            if (case.red_line.there)(*at) {
                line = line.max(off[axis].abs());
                line_scale = line_scale.max(true_u[axis].abs());
            }
        }
        Error {
            rms_pct: 100.0 * (square / scale).sqrt(),
            max_pct: 100.0 * most / largest,
            line_pct: 100.0 * line / line_scale,
            force_pct: 100.0 * (other.force_n - self.force_n).norm() / self.force_n.norm(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::cases;

    fn case(name: &str) -> (Case, Lattice) {
        let all = cases::all();
        let case = *all.iter().find(|case| case.name == name).expect(name);
        (case, case.lattice(1).expect("a lattice"))
    }

    #[test]
    fn errors_are_shares_of_the_answer() {
        let (case, lattice) = case("beam-bending");
        let line = |node: usize| (case.red_line.there)(lattice.unit[node]);
        let nodes = lattice.unit.len();
        // Twice as far on the line as elsewhere.
        let far = |node: usize| if line(node) { 2.0 } else { 1.0 };
        let answer = |by: f64| Answer {
            u: (0..nodes)
                .map(|node| Vector3::repeat(by * far(node)))
                .collect(),
            force_n: Vector3::new(0.0, 0.0, 3.0 * by),
        };
        let truth = answer(1.0);
        let Error {
            rms_pct,
            max_pct,
            line_pct,
            force_pct,
        } = truth.error(&answer(0.9), &case, &lattice);
        for pct in [rms_pct, max_pct, line_pct, force_pct] {
            assert!((pct - 10.0).abs() < 1e-9, "{pct}");
        }
        // One node that is off by a tenth of the largest displacement, not on the line.
        let node = (0..nodes).find(|node| !line(*node)).expect("a node");
        let mut other = truth.clone();
        other.u[node] += Vector3::repeat(0.2);
        let error = truth.error(&other, &case, &lattice);
        assert!((error.max_pct - 10.0).abs() < 1e-9, "{error:?}");
        assert!(error.rms_pct < 10.0 && error.line_pct == 0.0, "{error:?}");
        other.u[node].x = f64::NAN;
        let error = truth.error(&other, &case, &lattice);
        assert!(
            error.rms_pct.is_nan() && error.max_pct.is_nan(),
            "{error:?}"
        );
    }

    #[test]
    fn what_holds_a_loaded_body_bears_the_load() {
        let (case, lattice) = case("beam-bending");
        let load = Vector3::from(case.traction.expect("a load").force_n);
        for cells in [Cells::Linear, Cells::Quadratic] {
            let answers = solve(&case, &lattice, cells, &[&lattice]).expect("an answer");
            let off = (answers[0].force_n + load).norm();
            assert!(off < 1e-3 * load.norm(), "{cells:?}: {off}");
        }
    }

    /// Eight times as long as it takes, of the stress that fades nothing is left; the places are as they were.
    #[test]
    fn half_of_the_force_fades() {
        let (case, lattice) = case("cube-relaxation");
        let mut elastic = case;
        elastic.substance.relaxation = None;
        let [faded, elastic] = [case, elastic].map(|case| {
            let answers = solve(&case, &lattice, Cells::Linear, &[&lattice]);
            answers.expect("an answer").remove(0)
        });
        let left = faded.force_n.norm() / elastic.force_n.norm();
        assert!((0.5..0.51).contains(&left), "{left}");
        let pairs = faded.u.iter().zip(&elastic.u);
        let off = pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{off}");
    }
}
