//! A straight needle that is pushed into the slabs of the shipped scene, with its real solver.
//!
//! Entry point: [`NeedleSlabs::load`]. Presses and taps go along the needle: through the upper slab's top, and out
//! again, a puncture every time.

use super::{Sample, Scene, Solution, Truth};
use std::path::Path;
use std::sync::Arc;
use sutura_host::scene::{Document, Scene as SceneFile, SceneError};
use sutura_host::session::{Rendering, SceneSolver, Solve};
use sutura_host::step::Status;
use sutura_shared::wire::message::{Mode, State};
use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, Valid};

/// The scene as it is shipped.
const FILE: &str = include_str!("../../../../../scenes/needle-slabs.toml");
/// Tissue that sticks better than it slides jerks along the needle, and when it does depends on the steps by which it
/// came there: host and truth would feel different tissues. Here it sticks as it slides.
const STICKS: [&str; 2] = [
    "static_friction_n_per_m = 30.0",
    "static_friction_n_per_m = 25.0",
];
/// Where the grip is when the tip touches the upper slab \[m\].
const ORIGIN_M: [f64; 3] = [0.0011, 0.0007, 0.052];

/// Where it holds the needle's end before the first step \[m\].
const HELD_M: [f64; 3] = [0.0011, 0.0007, 0.06];

/// The scene, read.
#[derive(Clone)]
pub struct NeedleSlabs {
    scene: Arc<SceneFile>,
}

impl NeedleSlabs {
    /// Reads it.
    ///
    /// # Errors
    /// None unless the shipped scene is not sound.
    pub fn load() -> Result<Self, SceneError> {
        let [shipped, here] = STICKS;
        let text = FILE.replace(shipped, here);
        let document = Document::embedded("needle-slabs", Path::new(""), &text);
        let scene = SceneFile::read(&document, "needle-slabs")?;
        scene.build()?;
        Ok(NeedleSlabs {
            scene: Arc::new(scene),
        })
    }
}

impl Scene for NeedleSlabs {
    fn name(&self) -> &'static str {
        "needle"
    }

    fn origin_m(&self) -> [f64; 3] {
        ORIGIN_M
    }

    fn start(&self, _most_rows: usize, _ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        let mut solver = SceneSolver::new(&self.scene).ok();
        // The tool takes the needle where both are at first, wherever the hand begins then.
        let begin = Sample {
            time_s: 0.0,
            position_m: HELD_M,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            lead_s: 0.0,
            has_time: true,
        };
        if let (Some(solver), Some(state)) = (&mut solver, state(&begin)) {
            solver.plan_every(period_s);
            solver.solve(&state);
        }
        Box::new(Session { solver })
    }
}

/// A scene behind the session's own solver, with what that sends of needles and threads.
pub(super) struct Session {
    pub(super) solver: Option<SceneSolver>,
}

impl Truth for Session {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        let solver = self.solver.as_mut()?;
        let state = state(sample)?;
        let solved = solver.solve(&state);
        if solved.status != Status::Ok {
            return None;
        }
        let contact = solved.contact?;
        let sent = solved.frames(state.body(), HORIZON_US, Rendering::Rows)?;
        Some(Solution {
            wrench: contact.wrench,
            tangent: contact.tangent,
            normal: contact.normal,
            needle: sent.needle,
            thread: sent.thread,
            punctures: solver.punctures(),
            ..Solution::nothing(contact.gap_m)
        })
    }
}

/// As long as the console uses a frame \[us\]; the contact's own horizon is what counts.
const HORIZON_US: u32 = 150_000;

/// What a console would have sent.
pub(super) fn state(sample: &Sample) -> Option<Valid<State>> {
    state_late(sample, f64::INFINITY)
}

/// What a console would have sent to a host that solves every `period_s`, with the delay that the sample's lead says.
pub(super) fn state_late(sample: &Sample, period_s: f64) -> Option<Valid<State>> {
    let delay_s = (sample.lead_s - 0.5 * period_s).max(0.0);
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::State,
        session: 1,
        sequence: 1,
        console_time_us: (sample.time_s * 1e6).round() as u64,
    };
    let body = State {
        tick: 0,
        position_m: sample.position_m.map(|x| x as f32),
        orientation: sample.orientation.map(|x| x as f32),
        velocity_m_per_s: sample.velocity_m_per_s.map(|x| x as f32),
        force_n: [0.0; 3],
        current_a: [0.0; 3],
        mode: Mode::Armed,
        faults: 0,
        contact_sequence: u32::from(delay_s > 0.0),
        contact_age_us: 0,
        applied_age_us: (1e6 * delay_s).round() as u32,
        trace_hash: 0,
        encoder_counts: [0; 3],
        inputs: 0,
        heard_sequence: 0,
    };
    Valid::new(header, body).ok()
}
