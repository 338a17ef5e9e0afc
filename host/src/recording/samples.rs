//! What is written besides frames: the solver's steps, and grip and force in words that any program plots.
//!
//! Entry points: [`SolveSample`], [`ToolSample`]; both are JSON with a JSON Schema in the file.

use crate::session::{Looked, Solved, Tuning};
use crate::step::{Arrival, StepReport};
use crate::tool::Act;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// One solve, in the order in which they were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SolveSample {
    /// Console time of the state that was solved for \[us\].
    pub console_time_us: u64,
    /// How it ended.
    pub status: String,
    /// Hash of everything that the solver's state holds afterwards, 16 hexadecimal digits.
    pub state_hash: String,
    /// Wrench on the tool [N, N m], (6), world frame; none where nothing was sent.
    pub wrench: Option<[f64; 6]>,
    /// Distance to the tissue along the contact's normal \[m\].
    pub gap_m: Option<f64>,
    /// Vertices that the tool touches.
    pub rows: u32,
    /// Rows that the console was sent with the contact; 0: the tangent alone.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub console_rows: u32,
    /// Wall-clock time of the solve \[us\]; 0 in lockstep, where two recordings are to be the same.
    pub step_us: f64,
    /// Compliance columns that came from their thread since the last solve: step and vertex.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub arrivals: Vec<(u64, u32)>,
    /// Steps that it made besides its own.
    #[serde(default, skip_serializing_if = "Looked::is_nothing")]
    pub looked: Looked,
    /// How the session goes on from this solve on, where that is another way than before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuned: Option<Tuning>,
    /// What hands did with tools before it, besides moving them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub acts: Vec<Act>,
    /// Of `step_us`, what each stage took \[us\]: approach, tissue, detect, columns, solve, field, reduce, look. Nothing in lockstep.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages_us: Vec<f64>,
    /// Iterations of the solve's own step.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub iterations: u32,
    /// Elastic energy that the tools have put into the tissue \[J\].
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub energy_j: f64,
    /// Axial force of each needle \[N\].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub axial_n: Vec<f64>,
    /// Tension at the tail and at the head of each thread \[N\].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tension_n: Vec<f64>,
    /// Boundaries that needles have broken through so far.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub punctures: u32,
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

fn is_nothing(value: &f64) -> bool {
    *value == 0.0
}

impl SolveSample {
    /// Of a solve for `state`.
    pub fn new(state: &Valid<State>, solved: &Solved, hash: u64, arrivals: &[Arrival]) -> Self {
        SolveSample {
            console_time_us: state.console_time_us(),
            status: solved.status.name().to_owned(),
            state_hash: format!("{hash:016x}"),
            wrench: solved.contact.map(|contact| contact.wrench),
            gap_m: solved
                .contact
                .map(|contact| contact.gap_m)
                // JSON has no such number for nowhere.
                .filter(|gap_m| *gap_m < 1e3),
            rows: solved.contact.map_or(0, |contact| contact.rows),
            console_rows: solved
                .contact
                .and(solved.rows.as_ref())
                .map_or(0, |rows| rows.count as u32),
            step_us: 0.0,
            arrivals: arrivals
                .iter()
                .map(|arrival| (arrival.step, arrival.vertex))
                .collect(),
            looked: solved.looked,
            tuned: None,
            acts: Vec::new(),
            stages_us: Vec::new(),
            iterations: 0,
            energy_j: 0.0,
            axial_n: Vec::new(),
            tension_n: Vec::new(),
            punctures: 0,
        }
    }

    /// The same with what plots show besides, of the step that the solve ended with.
    pub fn with(self, solved: &Solved, report: &StepReport, punctures: u32) -> Self {
        let stages = solved.stages.named();
        let threads = report.threads().iter();
        SolveSample {
            stages_us: stages.map(|(_, ns)| 1e-3 * ns as f64).to_vec(),
            iterations: report.iterations,
            energy_j: report.stored_energy_j,
            axial_n: report
                .needles()
                .iter()
                .map(|needle| needle.axial_n)
                .collect(),
            tension_n: threads.flat_map(|thread| thread.tension_n).collect(),
            punctures,
            ..self
        }
    }

    /// The same without times on the wall: of a session in lockstep, two recordings of which are to be the same.
    pub fn without_times(self) -> Self {
        SolveSample {
            step_us: 0.0,
            stages_us: Vec::new(),
            ..self
        }
    }

    /// What came from the thread.
    pub fn arrivals(&self) -> impl Iterator<Item = Arrival> {
        let arrivals = self.arrivals.iter();
        arrivals.map(|&(step, vertex)| Arrival { step, vertex })
    }
}

/// A vector in the words that plots know.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Xyz {
    /// Along x.
    pub x: f32,
    /// Along y.
    pub y: f32,
    /// Along z.
    pub z: f32,
}

/// A turn in the words that plots know.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Turn {
    /// Imaginary part along x.
    pub x: f32,
    /// Imaginary part along y.
    pub y: f32,
    /// Imaginary part along z.
    pub z: f32,
    /// Real part.
    pub w: f32,
}

/// Grip and force at one tick.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ToolSample {
    /// Ticks since the console booted.
    pub tick: u32,
    /// Grip position \[m\], world frame.
    pub position_m: Xyz,
    /// Grip orientation, unit quaternion.
    pub orientation: Turn,
    /// Grip velocity \[m/s\].
    pub velocity_m_per_s: Xyz,
    /// Contact force on the grip \[N\].
    pub force_n: Xyz,
    /// Control mode.
    pub mode: &'static str,
    /// Age of the contact in use \[ms\]; none before the first.
    pub contact_age_ms: Option<f64>,
}

impl From<&State> for ToolSample {
    fn from(state: &State) -> Self {
        let xyz = |[x, y, z]: [f32; 3]| Xyz { x, y, z };
        let [x, y, z, w] = state.orientation;
        let age = Some(state.contact_age_us).filter(|age| *age != u32::MAX);
        ToolSample {
            tick: state.tick,
            position_m: xyz(state.position_m),
            orientation: Turn { x, y, z, w },
            velocity_m_per_s: xyz(state.velocity_m_per_s),
            force_n: xyz(state.force_n),
            mode: crate::session::mode_word(state.mode),
            contact_age_ms: age.map(|age| 1e-3 * f64::from(age)),
        }
    }
}
