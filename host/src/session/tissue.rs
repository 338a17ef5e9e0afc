//! The scene's tissue and tools behind [`Solve`]: a state becomes a sample, a step, a contact.
//!
//! Entry point: [`TissueSolver::new`]. The console's one grip carries the scene's driven tool; the others
//! stay where the scene holds them.

use super::{Solve, Solved};
use crate::model::Model;
use crate::scene::{Pose, Scene};
use crate::solve::{SolveError, bring_in, sample};
use crate::step::{self, Status, StepReport, Workspace};
use crate::tool::ToolSample;
use serde_json::{Map, Value, json};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// How far from the tool's centre vertices are prepared, in radii: as far as a step looks ahead.
const PREPARED_RADII: f64 = 1.5;
/// And so much further \[m\]: the hand strays from its path, and tissue moves along.
const PREPARED_MARGIN_M: f64 = 0.003;

/// A model with its state and scratch.
pub struct TissueSolver {
    name: String,
    model: Model,
    state: step::State,
    work: Workspace,
    /// The driven tool, if there is one, then those that are held.
    samples: Vec<ToolSample>,
    is_driven: bool,
    deepest: Deepest,
    last: StepReport,
}

/// What the session's hardest press looked like.
#[derive(Clone, Copy, Debug, Default)]
struct Deepest {
    force_n: f64,
    position_m: [f64; 3],
    rows: u32,
    stored_energy_j: f64,
}

impl TissueSolver {
    /// Builds the scene's solver and brings the tools that are held to their places.
    ///
    /// # Errors
    /// What [`Scene::build`] refuses; tools that are held too deep.
    pub fn new(scene: &Scene) -> Result<Self, SolveError> {
        let (model, mut state, mut work) = scene.build()?;
        let held: Vec<_> = scene
            .held()
            .map(|(tool, pose)| (tool.id, tool.shape, pose))
            .collect();
        let last = bring_in(&model, &mut state, &held, &mut work)?;
        // The console says where; it is not stepped before that.
        let somewhere = Pose {
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let driven = scene.driven().map(|tool| sample(tool.id, &somewhere));
        let held = held.iter().map(|(id, _, pose)| sample(*id, pose));
        Ok(TissueSolver {
            name: scene.name.clone(),
            model,
            state,
            work,
            is_driven: driven.is_some(),
            samples: driven.into_iter().chain(held).collect(),
            deepest: Deepest::default(),
            last,
        })
    }

    /// Computes beforehand what steps along `path` will need, so that the first touch costs no more than
    /// any other: `path` are places of the grip \[m\], not turned. Returns how many vertices are prepared.
    pub fn prepare(&mut self, path: &[[f64; 3]]) -> usize {
        let Some((_, tool)) = self.driven().and_then(|id| self.model.tool(id)) else {
            return 0;
        };
        let radius_m = tool.radius_m().max(self.model.surface().mean_edge_m);
        let reach_m = PREPARED_RADII * radius_m + PREPARED_MARGIN_M;
        let offset = tool.offset_m;
        let near = |vertex: [f64; 3]| {
            path.iter().any(|grip| {
                let square = (0..3).map(|i| (grip[i] + offset[i] - vertex[i]).powi(2));
                square.sum::<f64>() <= reach_m * reach_m
            })
        };
        let count = self.work.prepare(&self.model, near);
        tracing::info!("compliance of {count} vertices computed beforehand");
        count
    }

    /// Id of the tool that the console's grip carries.
    pub fn driven(&self) -> Option<u8> {
        let first = self.samples.first().filter(|_| self.is_driven);
        first.map(|sample| sample.id)
    }

    /// Steps with the driven tool where `sample` is; without a driven tool nothing moves.
    pub fn step(&mut self, sample: ToolSample) -> StepReport {
        if let Some(driven) = self.samples.first_mut().filter(|_| self.is_driven) {
            *driven = sample;
        }
        self.last = step::step(&self.model, &mut self.state, &self.samples, &mut self.work);
        self.last
    }

    /// The solver's parts, for what looks at them between steps.
    pub fn parts(&self) -> (&Model, &step::State, &Workspace) {
        (&self.model, &self.state, &self.work)
    }

    fn sample(&self, state: &Valid<State>) -> Option<ToolSample> {
        let body = state.body();
        Some(ToolSample {
            id: self.driven()?,
            position_m: body.position_m.map(f64::from),
            orientation: body.orientation.map(f64::from),
            velocity_m_per_s: body.velocity_m_per_s.map(f64::from),
            console_time_us: state.console_time_us(),
        })
    }
}

impl Solve for TissueSolver {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let Some(sample) = self.sample(state) else {
            // A scene without a tool is felt as free space, but nothing needs to be sent for that.
            return Solved {
                contact: None,
                needle: None,
                status: Status::UnknownTool,
                stages: step::Stages::default(),
            };
        };
        let report = self.step(sample);
        let contact = report.contacts().first().copied();
        if let Some(contact) = contact {
            let [x, y, z, ..] = contact.wrench;
            let force_n = (x * x + y * y + z * z).sqrt();
            if force_n > self.deepest.force_n {
                let (rows, stored_energy_j) = (contact.rows, report.stored_energy_j);
                self.deepest = Deepest {
                    force_n,
                    position_m: sample.position_m,
                    rows,
                    stored_energy_j,
                };
            }
        }
        Solved {
            contact,
            needle: None,
            status: report.status,
            stages: report.stages,
        }
    }

    fn scene(&self) -> Map<String, Value> {
        let Deepest {
            force_n,
            position_m,
            rows,
            stored_energy_j,
        } = self.deepest;
        let held = self
            .last
            .contacts()
            .iter()
            .skip(usize::from(self.is_driven));
        let held: Vec<Value> = held
            .map(|contact| {
                let [x, y, z, ..] = contact.wrench;
                json!({ "tool": contact.id, "force_n": [-x, -y, -z], "rows": contact.rows })
            })
            .collect();
        let report = json!({
            "name": self.name,
            "nodes": self.model.points_m().len(),
            "peak": {
                "force_n": force_n,
                "position_m": position_m,
                "rows": rows,
                "stored_energy_j": stored_energy_j,
            },
            "held": held,
        });
        if let Value::Object(report) = report {
            report
        } else {
            Map::new()
        }
    }
}
