//! The palpation scene without friction with its real solver: a sphere on a slab, a contact whose nodes come and go.
//!
//! Entry point: [`Palpation::load`]. Host and truth each solve for themselves. Compliance columns are the same for all:
//! those of every vertex that a hand comes near are computed before any run, as sessions do, so that no run finds others
//! than the next; a workspace that has them is handed on.

use super::{Sample, Scene, Solution, Truth};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use sutura_host::model::Model;
use sutura_host::scene::{Document, Scene as SceneFile, SceneError};
use sutura_host::session::{reach_m, sideways};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::tool::ToolSample;

/// The scene as it is shipped.
const FILE: &str = include_str!("../../../../../scenes/palpation-frictionless.toml");
/// How far from the way of a hand vertices are prepared: in radii, and \[m\]. As far as sessions do.
const PREPARED_RADII: f64 = 1.5;
const PREPARED_MARGIN_M: f64 = 0.003;
/// The hands are at most so far to the side of where they begin, and so deep \[m\].
const STROKE_M: f64 = 0.02;
const DEEPEST_M: f64 = 0.01;
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
    /// Whether the tool rubs: then tissue remembers which way it came, and what lies ahead is solved on a copy.
    rubs: bool,
    /// Of runs that are over, prepared.
    spare: Mutex<Vec<Workspace>>,
}

impl Shared {
    /// A workspace with the columns of all vertices that a hand comes near.
    fn prepared(&self) -> Workspace {
        let mut work = Workspace::new(&self.model);
        let reach_m = PREPARED_RADII * self.radius_m + PREPARED_MARGIN_M;
        work.prepare(&self.model, |[x, y, z]| {
            let aside = (x.abs() - STROKE_M).max(0.0);
            let below = (self.radius_m - DEEPEST_M - z).max(0.0);
            aside * aside + y * y + below * below <= reach_m * reach_m
        });
        work
    }
}

impl Palpation {
    /// Builds it, with a tool of this coefficient of friction.
    ///
    /// # Errors
    /// None unless the shipped scene is not sound.
    pub fn load(friction: f64) -> Result<Self, SceneError> {
        let tool = format!("[[tool]]\nfriction = {friction}\n");
        let text = FILE.replacen("[[tool]]\n", &tool, 1);
        let document = Document::embedded("palpation", Path::new(""), &text);
        let scene = SceneFile::read(&document, "palpation")?;
        let (model, untouched, _) = scene.build()?;
        let tool = scene.tools.first();
        Ok(Palpation {
            shared: Arc::new(Shared {
                tool: tool.map_or(0, |tool| tool.id),
                radius_m: tool.map_or(0.0, |tool| tool.shape.radius_m()),
                rubs: friction > 0.0,
                model,
                untouched,
                spare: Mutex::default(),
            }),
        })
    }
}

impl Scene for Palpation {
    fn name(&self) -> &'static str {
        if self.shared.rubs {
            "rubbing"
        } else {
            "palpation"
        }
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.shared.radius_m]
    }

    fn start(&self, most_rows: usize, ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        let mut spare = self
            .shared
            .spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let spare_one = spare.pop();
        drop(spare);
        let work = spare_one.unwrap_or_else(|| self.shared.prepared());
        Box::new(self.solver(work, most_rows, ahead_s, true))
    }

    /// Columns are computed in the steps that need them, a few in each; a step that needs more gives nothing.
    fn start_cold(&self, most_rows: usize, ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        let work = Workspace::new(&self.shared.model);
        Box::new(self.solver(work, most_rows, ahead_s, false))
    }
}

impl Palpation {
    fn solver(&self, work: Workspace, most_rows: usize, ahead_s: f64, is_prepared: bool) -> Solver {
        Solver {
            shared: Arc::clone(&self.shared),
            state: self.shared.untouched.clone(),
            trial: self.shared.untouched.clone(),
            normal: [0.0, 0.0, 1.0],
            ahead_s,
            options: StepOptions {
                // Nothing is left to wait for.
                vertices_per_step: is_prepared.then_some(usize::MAX),
                most_rows,
                reach_m: reach_m(ahead_s),
                ..StepOptions::default()
            },
            workspace: Some(work),
            is_prepared,
        }
    }
}

struct Solver {
    shared: Arc<Shared>,
    state: State,
    /// Of a tool that rubs, where it will be.
    trial: State,
    /// Of the last contact.
    normal: [f64; 3],
    /// From a state until the end of its frame's use \[s\]; 0 for who is not late.
    ahead_s: f64,
    options: StepOptions,
    /// Given back at the end if it was prepared.
    workspace: Option<Workspace>,
    is_prepared: bool,
}

impl Drop for Solver {
    fn drop(&mut self) {
        let spare = self.shared.spare.lock();
        let mut spare = spare.unwrap_or_else(PoisonError::into_inner);
        spare.extend(self.workspace.take().filter(|_| self.is_prepared));
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
        self.options.ahead_m = goal.map_or([0.0; 3], |goal| goal.ahead_m);
        let options = &self.options;
        let here = ToolSample {
            id: self.shared.tool,
            position_m: sample.position_m,
            orientation: sample.orientation,
            velocity_m_per_s: sample.velocity_m_per_s,
            console_time_us: (sample.time_s * 1e6).round() as u64,
        };
        let there = ToolSample {
            position_m: goal.map_or(here.position_m, |goal| goal.position_m.map(f64::from)),
            ..here
        };
        let report = if self.shared.rubs && goal.is_some() {
            self.shared.go(&mut self.state, options, work, &here)?;
            self.trial.clone_from(&self.state);
            self.shared.go(&mut self.trial, options, work, &there)?
        } else {
            self.shared.go(&mut self.state, options, work, &there)?
        };
        let contact = report.contacts().first()?;
        let rows = work.rows(here.id).filter(|rows| rows.count > 0);
        self.normal = contact.normal;
        Some(Solution {
            position_m: goal.map(|goal| goal.position_m),
            wrench: contact.wrench,
            tangent: contact.tangent,
            normal: contact.normal,
            rows: rows.map(|rows| Box::new(*rows)),
            ..Solution::nothing(contact.gap_m)
        })
    }
}

impl Shared {
    /// Takes the tool to a sample, if that can be done.
    fn go(
        &self,
        state: &mut State,
        options: &StepOptions,
        work: &mut Workspace,
        to: &ToolSample,
    ) -> Option<StepReport> {
        for _ in 0..SOLVES {
            let report = step(&self.model, state, &[*to], options, work);
            match report.status {
                Status::Ok => return Some(report),
                Status::Behind => {}
                _ => return None,
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_host::session::rows_frame;
    use sutura_shared::control::ContactRows;
    use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, Valid};

    /// A tool that was pressed in, and sticks, is drawn aside by more than it can stick: the console's rows hold it by no more than
    /// friction and the slope of its dent do.
    #[test]
    fn what_sticks_lets_go_whatever_way_it_is_drawn() {
        const FRICTION: f64 = 0.1;
        let scene = Palpation::load(FRICTION).expect("the shipped scene");
        let mut host = scene.start(24, 0.03, 0.016);
        let mut solution = None;
        for step in 0..=30 {
            let [x, y, z] = scene.origin_m();
            let deep_m = 5e-3 * f64::from(step) / 30.0;
            solution = host.solve(&Sample {
                time_s: 0.016 * f64::from(step),
                position_m: [x, y, z - deep_m],
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: [0.0; 3],
                lead_s: 0.0,
                has_time: true,
            });
        }
        let solution = solution.expect("solved");
        let rows = solution.rows.expect("rows");
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Rows,
            session: 1,
            sequence: 1,
            console_time_us: 1,
        };
        let frame = Valid::new(header, rows_frame(&rows).expect("a frame")).expect("valid");
        for eighth in 0..8 {
            let (sin, cos) = (f64::from(eighth) * std::f64::consts::FRAC_PI_4).sin_cos();
            let mut console = ContactRows::unpack(&frame);
            let (mut across_n, mut along_n) = (0.0, 0.0);
            for step in 1..=30 {
                let way = 3e-3 * f64::from(step) / 30.0;
                let dx = [(way * cos) as f32, (way * sin) as f32, 0.0, 0.0, 0.0, 0.0];
                let change = console.solve(&dx).change.map(f64::from);
                along_n = solution.wrench[2] + change[2];
                across_n = (solution.wrench[0] + change[0]).hypot(solution.wrench[1] + change[1]);
            }
            let bound_n = 1.5 * FRICTION * along_n + 0.03;
            assert!(across_n < bound_n, "{eighth}: {across_n} N of {bound_n}");
        }
    }
}
