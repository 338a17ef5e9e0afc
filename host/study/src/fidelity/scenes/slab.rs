//! The palpation scene without friction on tissue that is not linear, on a mesh that such tissue is solved on 60 times a second, with the
//! solver that a session would have.
//!
//! Entry point: [`Slab::load`]. Both have rows, and a contact without friction.

use super::needle::state_late;
use super::{Sample, Scene, Solution, Truth};
use std::path::Path;
use std::sync::Arc;
use sutura_host::scene::{Document, Scene as SceneFile, SceneError};
use sutura_host::session::{Effort, LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, Solve};
use sutura_host::step::Status;
use sutura_shared::control::TICK_HZ;
use sutura_shared::wire::message::Fixture;

use super::super::plant::Mechanics;

/// The scene as it is shipped.
const FILE: &str = include_str!("../../../../../scenes/palpation-frictionless.toml");
/// Half as many edges along each axis: an eighth of the cells.
const DIVISIONS: [&str; 2] = ["divisions = [20, 20, 8]", "divisions = [10, 10, 4]"];

/// Which tissue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Law {
    /// Linear, turning with each element.
    Corotational,
    /// Neo-Hookean.
    Hyperelastic,
}

impl Law {
    /// As tables print it.
    pub fn word(self) -> &'static str {
        match self {
            Law::Corotational => "corotational",
            Law::Hyperelastic => "hyperelastic",
        }
    }
}

/// The scene, read.
#[derive(Clone)]
pub struct Slab {
    law: Law,
    scene: Arc<SceneFile>,
    radius_m: f64,
}

impl Slab {
    /// Reads it.
    ///
    /// # Errors
    /// None unless the shipped scene is not sound.
    pub fn load(law: Law) -> Result<Self, SceneError> {
        let [shipped, here] = DIVISIONS;
        let model = format!("model = \"{}\"", law.word());
        let text = FILE.replace(shipped, here);
        let text = text.replace("model = \"linear\"", &model);
        let document = Document::embedded(law.word(), Path::new(""), &text);
        let scene = SceneFile::read(&document, law.word())?;
        let tool = scene.tools.first();
        Ok(Slab {
            law,
            radius_m: tool.map_or(0.0, |tool| tool.shape.radius_m()),
            scene: Arc::new(scene),
        })
    }

    /// The solver of a host, or of the truth, which needs nothing but the force.
    fn solver(&self, is_late: bool, period_s: f64) -> Option<SceneSolver> {
        let rendering = if is_late {
            Rendering::Rows
        } else {
            Rendering::Hold
        };
        let plan = Plan {
            device: Mechanics::LIGHT.description(),
            hand: self.scene.hand?,
            host_hz: 1.0 / period_s,
            seconds: self.scene.seconds,
            tick_hz: TICK_HZ,
            state_every: 1,
            rendering,
            line_bytes_per_s: LINE_BYTES_PER_S,
            horizon_us: None,
            clear_fault: false,
            fixture: Fixture::None,
        };
        SceneSolver::for_session(&self.scene, &plan).ok()
    }
}

impl Scene for Slab {
    fn name(&self) -> &'static str {
        self.law.word()
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.radius_m]
    }

    fn start(&self, _most_rows: usize, ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        Box::new(Session {
            solver: self.solver(ahead_s > 0.0, period_s),
            period_s,
        })
    }
}

struct Session {
    solver: Option<SceneSolver>,
    period_s: f64,
}

impl Truth for Session {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let solver = self.solver.as_mut()?;
        solver.spare(if sample.has_time {
            Effort::Full
        } else {
            Effort::NoLooks
        });
        let solved = solver.solve(&state_late(sample, self.period_s)?);
        if solved.status != Status::Ok {
            return None;
        }
        let contact = solved.contact?;
        Some(Solution {
            position_m: Some(solved.position_m),
            wrench: contact.wrench,
            tangent: contact.tangent,
            normal: contact.normal,
            rows: solved.rows.map(Box::new),
            ..Solution::nothing(contact.gap_m)
        })
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    /// A tool that comes down is told of the tissue before it is there, and one that is far is not.
    #[test]
    fn what_a_tool_comes_down_to_is_foretold() {
        for law in [Law::Corotational, Law::Hyperelastic] {
            let slab = Slab::load(law).expect("the shipped scene");
            let [_, _, radius_m] = slab.origin_m();
            let at = |height_m: f64, down_m_per_s: f64| {
                let mut host = slab.start(16, 2.0 / 60.0, 1.0 / 60.0);
                let sample = Sample {
                    time_s: 0.0,
                    position_m: [0.0, 0.0, radius_m + height_m],
                    orientation: [0.0, 0.0, 0.0, 1.0],
                    velocity_m_per_s: [0.0, 0.0, -down_m_per_s],
                    lead_s: 0.0,
                    has_time: true,
                };
                let found = host.solve(&sample).expect("a solution");
                let rows = found.rows.map_or(0, |rows| rows.count);
                (-found.tangent[2][2], rows)
            };
            assert_eq!(at(0.06, 0.0), (0.0, 0), "{law:?}");
            let (slope, rows) = at(2e-3, 0.25);
            assert!(slope > 20.0, "{law:?}: {slope} N/m");
            assert!(rows > 0, "{law:?}");
        }
    }
}
