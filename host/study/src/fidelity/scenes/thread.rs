//! A running suture through the two slabs of the shipped scene, whose ends are pulled, with its real solver.
//!
//! Entry point: [`WoundSlabs::load`]. The scene's hands sew, once; every run goes on from there, with the thread's head in
//! the grip and its tail with the scene's second hand, which pulls as well.

use super::needle::{Session, state};
use super::{Sample, Scene, Solution, Truth};
use std::path::Path;
use std::sync::{Arc, OnceLock};
use sutura_host::scene::{Document, Scene as SceneFile, SceneError};
use sutura_host::session::{Moment, SceneSolver, Solve};
use sutura_host::step::Status;

/// The scene as it is shipped.
const FILE: &str = include_str!("../../../../../scenes/wound-slabs.toml");
/// When it has been sewn and both ends begin to be pulled \[s\].
const SEWN_S: f64 = 6.62;
/// Steps while it is sewn \[ms\].
const SEWING_MS: usize = 5;
/// Where the grip is while it is sewn \[m\]: the needle's end is brought there.
const ORIGIN_M: [f64; 3] = [0.007_975_6, 0.009_4, 0.001_375_5];
/// Solves at the start, for what a step may not compute all at once.
const SOLVES: u32 = 50;

/// The scene, read.
#[derive(Clone)]
pub struct WoundSlabs {
    shared: Arc<Shared>,
}

struct Shared {
    scene: SceneFile,
    /// By whoever needs it first; none if a step found no balance.
    sewn: OnceLock<Option<Moment>>,
}

impl WoundSlabs {
    /// Reads it.
    ///
    /// # Errors
    /// None unless the shipped scene is not sound.
    pub fn load() -> Result<Self, SceneError> {
        let document = Document::embedded("wound-slabs", Path::new(""), FILE);
        let scene = SceneFile::read(&document, "wound-slabs")?;
        scene.build()?;
        let sewn = OnceLock::new();
        Ok(WoundSlabs {
            shared: Arc::new(Shared { scene, sewn }),
        })
    }

    /// A solver that goes on where the suture has been sewn.
    fn solver(&self) -> Option<SceneSolver> {
        let Shared { scene, sewn } = &*self.shared;
        let sewn = sewn.get_or_init(|| sew(scene)).as_ref()?;
        let mut solver = SceneSolver::new(scene).ok()?;
        solver.go_on_from(sewn);
        let state = state(&held(SEWN_S))?;
        (0..SOLVES)
            .any(|_| solver.solve(&state).status == Status::Ok)
            .then_some(solver)
    }
}

/// The grip at rest.
fn held(time_s: f64) -> Sample {
    Sample {
        time_s,
        position_m: ORIGIN_M,
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        lead_s: 0.0,
        has_time: true,
    }
}

fn sew(scene: &SceneFile) -> Option<Moment> {
    let mut solver = SceneSolver::new(scene).ok()?;
    for tick in (0..=(SEWN_S * 1e3) as u32).step_by(SEWING_MS) {
        solver.solve(&state(&held(f64::from(tick) * 1e-3))?);
    }
    solver.moment()
}

impl Scene for WoundSlabs {
    fn name(&self) -> &'static str {
        "thread"
    }

    fn origin_m(&self) -> [f64; 3] {
        ORIGIN_M
    }

    /// The way's z is where the scene's own hand pulls to: 3 to the side for 4 up.
    fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [a, b, c] = ORIGIN_M;
        [a + 0.8 * x + 0.6 * z, b + y, c + 0.8 * z - 0.6 * x]
    }

    fn start(&self, _most_rows: usize, _ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        let mut solver = self.solver();
        if let Some(solver) = &mut solver {
            solver.plan_every(period_s);
        }
        Box::new(Late(Session { solver }))
    }
}

/// A session that counts from when the suture was sewn.
struct Late(Session);

impl Truth for Late {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        self.0.solve(&Sample {
            time_s: SEWN_S + sample.time_s,
            ..*sample
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::hand::Motion;
    use super::*;

    /// What runs start from is where the sewing ended, and two of them are the same.
    #[test]
    fn a_run_goes_on_from_the_sewn_suture() {
        let scene = WoundSlabs::load().expect("the shipped scene");
        let mut one = scene.start(0, 0.0, 1e-3);
        let mut other = scene.start(0, 0.0, 1e-3);
        for tick in 0..8 {
            let time_s = 0.025 * f64::from(tick);
            let sample = Sample {
                time_s,
                position_m: scene.place(Motion::Pulls.at(time_s)),
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: [0.0; 3],
                lead_s: 0.0,
                has_time: true,
            };
            let found = one.solve(&sample).expect("a balance");
            assert_eq!(found.punctures, 16);
            assert!(found.thread.is_some());
            assert_eq!(Some(found), other.solve(&sample));
        }
    }
}
