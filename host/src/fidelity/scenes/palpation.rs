//! The palpation scene with its real solver: a sphere on a slab, a contact whose nodes come and go.
//!
//! Entry point: [`Palpation::load`]. Host and truth each solve for themselves; compliance columns, which are the
//! same for all, are handed on from one run to the next.

use super::{Sample, Scene, Solution, Truth};
use crate::model::Model;
use crate::scene::{Document, Scene as SceneFile, SceneError};
use crate::session::sideways;
use crate::step::{State, Status, Workspace, step};
use crate::tool::ToolSample;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// The scene as it is shipped.
const FILE: &str = include_str!("../../../../scenes/palpation.toml");
/// Solves towards one sample, where the tool has gone farther than one follows.
const SOLVES: u32 = 8;

/// The scene, built.
#[derive(Clone)]
pub struct Palpation {
    shared: Arc<Shared>,
}

struct Shared {
    model: Model,
    untouched: State,
    tool: u8,
    radius_m: f64,
    /// Of runs that are over.
    spare: Mutex<Vec<Workspace>>,
}

impl Palpation {
    /// Builds it.
    ///
    /// # Errors
    /// None unless the shipped scene is not sound.
    pub fn load() -> Result<Self, SceneError> {
        let document = Document::embedded("palpation", Path::new(""), FILE);
        let scene = SceneFile::read(&document, "palpation")?;
        let (model, untouched, workspace) = scene.build()?;
        let tool = scene.tools.first();
        Ok(Palpation {
            shared: Arc::new(Shared {
                tool: tool.map_or(0, |tool| tool.id),
                radius_m: tool.map_or(0.0, |tool| tool.shape.radius_m()),
                model,
                untouched,
                spare: Mutex::new(vec![workspace]),
            }),
        })
    }
}

impl Scene for Palpation {
    fn name(&self) -> &'static str {
        "palpation"
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.shared.radius_m]
    }

    fn start(&self, most_rows: usize, ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        let shared = Arc::clone(&self.shared);
        let mut spare = shared.spare.lock().unwrap_or_else(PoisonError::into_inner);
        let workspace = spare.pop().unwrap_or_else(|| Workspace::new(&shared.model));
        drop(spare);
        let mut solver = Solver {
            state: shared.untouched.clone(),
            workspace: Some(workspace),
            normal: [0.0, 0.0, 1.0],
            ahead_s,
            shared,
        };
        if let Some(work) = &mut solver.workspace {
            // Not in real time: nothing waits for columns.
            work.vertices_per_step = usize::MAX;
            work.most_rows = most_rows;
        }
        Box::new(solver)
    }
}

struct Solver {
    shared: Arc<Shared>,
    state: State,
    /// Of the last contact.
    normal: [f64; 3],
    /// From a state until the end of its frame's use \[s\]; 0 for who is not late.
    ahead_s: f64,
    /// Given back at the end.
    workspace: Option<Workspace>,
}

impl Drop for Solver {
    fn drop(&mut self) {
        let mut spare = self
            .shared
            .spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        spare.extend(self.workspace.take());
    }
}

impl Truth for Solver {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let work = self.workspace.as_mut()?;
        // The truth looks nowhere but where it is.
        let goal = (self.ahead_s > 0.0).then(|| {
            let (here, velocity) = (sample.position_m, sample.velocity_m_per_s);
            let [here, velocity] = [here, velocity].map(|place| place.map(|x| x as f32));
            sideways(here, velocity, &self.normal, sample.lead_s, self.ahead_s)
        });
        work.ahead_m = goal.map_or([0.0; 3], |goal| goal.ahead_m);
        let tool = ToolSample {
            id: self.shared.tool,
            position_m: goal.map_or(sample.position_m, |goal| goal.position_m.map(f64::from)),
            orientation: sample.orientation,
            velocity_m_per_s: sample.velocity_m_per_s,
            console_time_us: (sample.time_s * 1e6).round() as u64,
        };
        for _ in 0..SOLVES {
            let report = step(&self.shared.model, &mut self.state, &[tool], work);
            match report.status {
                Status::Ok => {
                    let contact = report.contacts().first()?;
                    let rows = work.rows(tool.id).filter(|rows| rows.count > 0);
                    self.normal = contact.normal;
                    return Some(Solution {
                        position_m: goal.map(|goal| goal.position_m),
                        wrench: contact.wrench,
                        tangent: contact.tangent,
                        normal: contact.normal,
                        rows: rows.map(|rows| Box::new(*rows)),
                        ..Solution::nothing(contact.gap_m)
                    });
                }
                Status::Behind => {}
                _ => return None,
            }
        }
        None
    }
}
