//! What counts as stable.
//!
//! Entry points: [`Course::run`], [`Verdict`]. A run is a defect if numbers are none, if nodes fly off, or if the
//! code panics; no other outcome is one.

use nalgebra::Vector3;
use std::panic::{AssertUnwindSafe, catch_unwind};
use sutura_host::mesh::TetMesh;
use sutura_models::{BoundaryConditions, Outcome, Tissue};

/// Largest force out of balance in the end that is stable, as a share of the forces that act. A twentieth, because
/// models that iterate a fixed number of times in a step are meant to be a little behind.
pub const MOST_RESIDUAL: f64 = 0.05;
/// Largest difference from the answer that is stable, RMS over RMS; 10 %, what a hand can just tell.
pub const MOST_DIFFERENCE: f64 = 0.1;
/// Largest difference that single precision may make, RMS over RMS; 0.1 %, below what is measured elsewhere.
pub const MOST_ROUNDING: f64 = 1e-3;
/// Farthest that a free node may be from where held ones are, as a multiple of the body's size: beyond, it has
/// flown off.
pub const MOST_AWAY: f64 = 10.0;
/// How far from rest tissue may stay when it is let go, as a share of the body's size.
pub const MOST_LEFT: f64 = 0.02;

/// Where the search for the largest stable time step ends \[s\].
pub const LONGEST_STEP_S: f64 = 10.0;

/// How a case ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Within all the limits above.
    Stable,
    /// Finite and near, but beyond a limit: which.
    Degraded(String),
    /// It said no, why, and stayed where it was.
    Refused(String),
    /// Anything else.
    Defect(String),
}

impl Verdict {
    /// The word for tables.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Degraded(_) => "degraded",
            Self::Refused(_) => "refused",
            Self::Defect(_) => "defect",
        }
    }

    /// What else there is to say.
    pub fn note(&self) -> &str {
        match self {
            Self::Stable => "",
            Self::Degraded(note) | Self::Refused(note) | Self::Defect(note) => note,
        }
    }
}

/// Runs `trial`; a panic is a defect.
pub fn guarded(trial: impl FnOnce() -> Verdict) -> Verdict {
    // What a panic leaves half done is thrown away with the trial.
    catch_unwind(AssertUnwindSafe(trial)).unwrap_or_else(|_| Verdict::Defect("panicked".to_owned()))
}

/// Where a held node is to be \[m from rest\], by its place at rest and the share of the way; `None`: free.
pub type Path<'a> = &'a dyn Fn([f64; 3], f64) -> Option<[f64; 3]>;

/// Held nodes that go along a path and perhaps back.
pub struct Course<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Where held nodes go.
    pub path: Path<'a>,
    /// Steps there.
    pub steps: usize,
    /// Steps in which they stay there.
    pub rest: usize,
    /// Whether they then come back, in as many steps.
    pub back: bool,
    /// Of a step \[s\].
    pub step_s: f64,
}

/// What a run left behind.
pub struct Seen {
    /// The first limit that was passed.
    pub verdict: Verdict,
    /// Displacements at the end of the way there \[m\].
    pub u: Vec<Vector3<f64>>,
}

impl Course<'_> {
    /// Size of the body: the diagonal of its box \[m\].
    pub fn size_m(&self) -> f64 {
        let points = self.mesh.points_m();
        let span = |axis: usize| {
            let values = points.iter().map(|point| point[axis]);
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            });
            high - low
        };
        Vector3::new(span(0), span(1), span(2)).norm()
    }

    /// Runs tissue along the path.
    pub fn run(&self, tissue: &mut dyn Tissue) -> Seen {
        let mut residual = f64::NAN;
        let mut seen = Seen {
            verdict: Verdict::Stable,
            u: Vec::new(),
        };
        let there = self.steps + self.rest;
        let all = if self.back { 2 * there } else { there };
        for step in 1..=all {
            let share = if step <= there {
                (step as f64 / self.steps as f64).min(1.0)
            } else {
                1.0 - ((step - there) as f64 / self.steps as f64).min(1.0)
            };
            let held = self.held(share);
            let drive = BoundaryConditions {
                held: &held,
                force_n: &[],
            };
            let before = tissue.positions_m().to_vec();
            let done = tissue.step(&drive, self.step_s);
            if let Some(defect) = self.defect(tissue, &held) {
                seen.verdict = Verdict::Defect(format!("step {step} of {all}: {defect}"));
                return seen;
            }
            if let Outcome::Failed(why) = done.outcome {
                seen.verdict = if tissue.positions_m() == before {
                    Verdict::Refused(format!("step {step} of {all}: {why}"))
                } else {
                    Verdict::Defect(format!(
                        "step {step} of {all} failed and left its place: {why}"
                    ))
                };
                return seen;
            }
            if step == there {
                residual = done.residual;
                seen.u = self.displacements(tissue);
            }
        }
        if residual > MOST_RESIDUAL {
            seen.verdict = Verdict::Degraded(format!(
                "{:.0} % of the forces are out of balance",
                100.0 * residual
            ));
        } else if self.back {
            let left = self.displacements(tissue);
            let most = left.iter().map(Vector3::norm).fold(0.0, f64::max) / self.size_m();
            if most > MOST_LEFT {
                seen.verdict = Verdict::Degraded(format!(
                    "let go, it stays {:.0} % of its size from rest",
                    100.0 * most
                ));
            }
        }
        seen
    }

    /// As [`Self::run`], and near an answer as well.
    pub fn run_near(&self, tissue: &mut dyn Tissue, answer: &[Vector3<f64>]) -> Verdict {
        let seen = self.run(tissue);
        if seen.verdict != Verdict::Stable {
            return seen.verdict;
        }
        let difference = difference(&seen.u, answer);
        if difference > MOST_DIFFERENCE {
            return Verdict::Degraded(format!("{:.0} % from the answer", 100.0 * difference));
        }
        Verdict::Stable
    }

    fn held(&self, share: f64) -> Vec<(u32, [f64; 3])> {
        (0u32..)
            .zip(self.mesh.points_m())
            .filter_map(|(node, rest)| Some((node, (self.path)(*rest, share)?)))
            .collect()
    }

    fn displacements(&self, tissue: &dyn Tissue) -> Vec<Vector3<f64>> {
        let nodes = tissue.positions_m().iter().zip(self.mesh.points_m());
        nodes
            .map(|(at, rest)| Vector3::from(*at) - Vector3::from(*rest))
            .collect()
    }

    fn defect(&self, tissue: &dyn Tissue, held: &[(u32, [f64; 3])]) -> Option<String> {
        let finite = |all: &[[f64; 3]]| all.iter().flatten().all(|x| x.is_finite());
        if !finite(tissue.positions_m()) {
            return Some("a position is not a number".to_owned());
        }
        if !finite(tissue.reactions_n()) {
            return Some("a reaction is not a number".to_owned());
        }
        let farthest = held
            .iter()
            .map(|(_, u)| Vector3::from(*u).norm())
            .fold(0.0, f64::max);
        let most = farthest + MOST_AWAY * self.size_m();
        let away = self
            .displacements(tissue)
            .iter()
            .map(Vector3::norm)
            .fold(0.0, f64::max);
        (away > most).then(|| format!("a node is {away:.2e} m away"))
    }
}

/// RMS of the difference over that of the answer.
pub fn difference(u: &[Vector3<f64>], answer: &[Vector3<f64>]) -> f64 {
    let off: f64 = u
        .iter()
        .zip(answer)
        .map(|(a, b)| (a - b).norm_squared())
        .sum();
    let scale: f64 = answer.iter().map(Vector3::norm_squared).sum();
    (off / scale).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_host::mesh::slab;
    use sutura_models::{Diagnostics, Tangent};

    /// Tissue that does as it is told.
    struct Puppet {
        at: Vec<[f64; 3]>,
        outcome: Outcome,
        residual: f64,
        moves_by: f64,
    }

    impl Tissue for Puppet {
        fn step(&mut self, _: &BoundaryConditions<'_>, _: f64) -> Diagnostics {
            self.at[0][0] += self.moves_by;
            Diagnostics {
                outcome: self.outcome,
                iterations: 0,
                residual: self.residual,
                force_error: 0.0,
                energy_j: 0.0,
                energy_difference: 0.0,
                momentum: [0.0; 3],
                angular_momentum: [0.0; 3],
            }
        }

        fn positions_m(&self) -> &[[f64; 3]] {
            &self.at
        }

        fn reactions_n(&self) -> &[[f64; 3]] {
            &[]
        }

        fn tangent(&mut self, _: &BoundaryConditions<'_>, _: &[usize], _: f64) -> Option<Tangent> {
            None
        }
    }

    fn verdict(outcome: Outcome, residual: f64, moves_by: f64) -> &'static str {
        let mesh = slab([0.1; 3], [1, 1, 1]).expect("a slab");
        let course = Course {
            mesh: &mesh,
            path: &|_, _| None,
            steps: 2,
            rest: 0,
            back: true,
            step_s: 0.01,
        };
        let mut puppet = Puppet {
            at: mesh.points_m().to_vec(),
            outcome,
            residual,
            moves_by,
        };
        course.run(&mut puppet).verdict.word()
    }

    #[test]
    fn each_outcome_is_told_from_the_others() {
        let good = Outcome::Converged;
        assert_eq!(verdict(good, 0.01, 0.0), "stable");
        assert_eq!(verdict(good, f64::NAN, 0.0), "stable");
        assert_eq!(verdict(good, 0.2, 0.0), "degraded");
        assert_eq!(verdict(good, 0.0, 0.01), "degraded");
        assert_eq!(verdict(good, 0.0, 1.0), "defect");
        assert_eq!(verdict(good, 0.0, f64::NAN), "defect");
        assert_eq!(verdict(Outcome::Failed("no"), 0.0, 0.0), "refused");
        assert_eq!(verdict(Outcome::Failed("no"), 0.0, 0.01), "defect");
        let panics = guarded(|| std::panic::panic_any("for the test"));
        assert_eq!(panics.word(), "defect");
    }

    /// Tissue that is only what is held, and rests or not.
    struct Follower {
        mesh: TetMesh,
        at: Vec<[f64; 3]>,
        reactions: Vec<[f64; 3]>,
        comes_back: bool,
    }

    impl Tissue for Follower {
        fn step(&mut self, drive: &BoundaryConditions<'_>, _: f64) -> Diagnostics {
            for (node, u) in drive.held {
                let rest = Vector3::from(self.mesh.points_m()[*node as usize]);
                let there: [f64; 3] = (rest + Vector3::from(*u)).into();
                let at = &mut self.at[*node as usize];
                if self.comes_back || there[2].abs() > at[2].abs() {
                    *at = there;
                }
            }
            Diagnostics {
                outcome: Outcome::Converged,
                iterations: 0,
                residual: 0.0,
                force_error: 0.0,
                energy_j: 0.0,
                energy_difference: 0.0,
                momentum: [0.0; 3],
                angular_momentum: [0.0; 3],
            }
        }

        fn positions_m(&self) -> &[[f64; 3]] {
            &self.at
        }

        fn reactions_n(&self) -> &[[f64; 3]] {
            &self.reactions
        }

        fn tangent(&mut self, _: &BoundaryConditions<'_>, _: &[usize], _: f64) -> Option<Tangent> {
            None
        }
    }

    /// A body of 0.1 m goes up and down again; the verdict, and against `answer` if there is one.
    fn lifted(by_m: f64, change: fn(&mut Follower), answer_m: Option<f64>) -> &'static str {
        let mesh = slab([0.1; 3], [1, 1, 1]).expect("a slab");
        let path = |_, share: f64| Some([0.0, 0.0, share * by_m]);
        let course = Course {
            mesh: &mesh,
            path: &path,
            steps: 5,
            rest: 1,
            back: true,
            step_s: 0.01,
        };
        let mut tissue = Follower {
            mesh: mesh.clone(),
            at: mesh.points_m().to_vec(),
            reactions: Vec::new(),
            comes_back: true,
        };
        change(&mut tissue);
        match answer_m {
            None => course.run(&mut tissue).verdict.word(),
            Some(z) => {
                let answer = vec![Vector3::new(0.0, 0.0, z); mesh.points_m().len()];
                course.run_near(&mut tissue, &answer).word()
            }
        }
    }

    #[test]
    fn what_is_held_goes_all_the_way_and_comes_back() {
        assert_eq!(lifted(0.05, |_| (), None), "stable");
        assert_eq!(
            lifted(0.05, |tissue| tissue.comes_back = false, None),
            "degraded"
        );
        // As far as that only because it is held there.
        assert_eq!(lifted(50.0, |_| (), None), "stable");
        let no_number = |tissue: &mut Follower| tissue.reactions = vec![[f64::NAN; 3]];
        assert_eq!(lifted(0.05, no_number, None), "defect");
        // Judged where the way there ends: a tenth off is the limit.
        assert_eq!(lifted(0.05, |_| (), Some(0.05)), "stable");
        assert_eq!(lifted(0.05, |_| (), Some(0.052)), "stable");
        assert_eq!(lifted(0.05, |_| (), Some(0.06)), "degraded");
    }
}
