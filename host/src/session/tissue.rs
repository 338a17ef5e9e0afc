//! The scene's tissue and tool behind [`Solve`]: a state becomes a sample, a step, a contact.
//!
//! Entry point: [`TissueSolver::new`]. The console's one grip carries the scene's first tool.

use super::{Solve, Solved};
use crate::model::Model;
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
    deepest: Deepest,
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
    /// The scene of this name.
    pub fn new(name: &str, model: Model, state: step::State, work: Workspace) -> Self {
        TissueSolver {
            name: name.to_owned(),
            model,
            state,
            work,
            deepest: Deepest::default(),
        }
    }

    /// Computes beforehand what steps along `path` will need, so that the first touch costs no more than
    /// any other: `path` are places of the grip \[m\], not turned.
    pub fn prepare(&mut self, path: &[[f64; 3]]) {
        let Some((_, tool)) = self.model.tools().first() else {
            return;
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
    }

    /// Steps to where the sample is.
    pub fn step(&mut self, sample: ToolSample) -> StepReport {
        step::step(&self.model, &mut self.state, &[sample], &mut self.work)
    }

    fn sample(&self, state: &Valid<State>) -> Option<ToolSample> {
        let (id, _) = self.model.tools().first()?;
        let body = state.body();
        Some(ToolSample {
            id: *id,
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
                let (rows, stored_energy_j) = (report.rows, report.stored_energy_j);
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
        let report = json!({
            "name": self.name,
            "nodes": self.model.points_m().len(),
            "peak": {
                "force_n": force_n,
                "position_m": position_m,
                "rows": rows,
                "stored_energy_j": stored_energy_j,
            },
        });
        if let Value::Object(report) = report {
            report
        } else {
            Map::new()
        }
    }
}
