//! A session: the console's states in, the solver's contacts out, and the statistics of it all.
//!
//! Entry points: [`run_real_time`] for a console that runs by itself, [`run_lockstep`] for one that
//! advances a tick per exchange. Both set up the same way, solve through [`Solve`], and end with a
//! [`Summary`].

mod budget;
mod chosen;
mod contact_frame;
mod ending;
mod error;
mod fault_words;
mod heard;
mod horizon;
#[cfg(test)]
mod late_tests;
mod limited;
mod lockstep;
mod look_ahead;
mod look_budget;
mod machine_lateness;
mod needle_frame;
mod overload;
#[cfg(test)]
mod puncture_tests;
mod real_time;
mod room;
mod rows_frame;
mod schedule;
mod scheduling;
mod setup;
mod sideways;
mod solver;
mod statistics;
mod summary;
mod thread_frame;
mod way_out;

pub use crate::scene::Rendering;
use crate::tool::Act;
pub use budget::{LINE_BYTES_PER_S, most_rows, usb_bytes_per_s};
pub use chosen::{Candidate, Chosen, StepUs};
pub use contact_frame::{contact_frame, pack_symmetric};
pub use ending::{Ending, EndingKind};
pub use error::SolveError;
pub use fault_words::{fault_names, fault_words, needs_restart};
pub use heard::{Fate, Underway};
pub use horizon::Horizon;
pub use limited::{ConsoleLimits, LimitedTicks};
pub use lockstep::{Instruction, Steer, Steered, run_lockstep, run_steered};
pub use look_budget::Looked;
pub use machine_lateness::{LatenessProbe, MachineLate, MachineLateness};
pub use needle_frame::{HeldNeedle, needle_frame};
pub use overload::{Effort, GivenUp, Spared};
pub use real_time::{Arms, Attendant, Line, run_real_time};
pub use room::{Crowd, Overfull, overfull};
pub use rows_frame::rows_frame;
pub use scheduling::Scheduling;
pub use setup::{Plan, PlanError, SessionError, Tuning, check_rate, least_hz};
pub use sideways::{Goal, sideways};
pub use solver::{Happened, Moment, SceneSolver, Snapshot};
pub(crate) use solver::{IN_BALANCE, MOST_PASSES, MOST_STEPS};
pub use statistics::{Statistics, UNSENDABLE, mode_word};
pub use summary::{
    Age, ConsoleClock, Energy, Force, Frames, Latency, LinkSummary, RoundTrip, SafeStop, StepTime,
    Stop, Summary, Throughput, ViewSummary,
};
pub use sutura_client::ahead::reach_m;
pub use thread_frame::{HeldThread, thread_frame};
pub use way_out::WayOut;

use crate::link::Felt;
use crate::step::{Stages, Status, ToolContact, ToolRows};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Report, State};

/// What a solver step gave.
#[derive(Clone, Copy, Debug, Default)]
pub struct Solved {
    /// Grip position that was solved for \[m\], (3): a little ahead of the state's, or as far behind as the hand was too fast.
    pub position_m: [f32; 3],
    /// Grip orientation that was solved for, unit quaternion (x, y, z, w); the state's if it is not said.
    pub orientation: Option<[f32; 4]>,
    /// How far the tools are from where the step was to follow them, the farthest \[m\].
    pub lag_m: f64,
    /// The contact at the state's pose; none when the result is not good enough to be felt.
    pub contact: Option<ToolContact>,
    /// Magnitude of the force on the driven tool where the step itself ended \[N\]: the contact may be of a step tried ahead.
    pub step_n: f64,
    /// The contact's rows; sent with it, never without.
    pub rows: Option<ToolRows>,
    /// The needle in that tool's grip, if it holds one; sent with the contact, never without.
    pub needle: Option<HeldNeedle>,
    /// The thread that pulls at that grip, by itself or by its needle; sent with the contact, never without.
    pub thread: Option<HeldThread>,
    /// How the step ended.
    pub status: Status,
    /// Whether the driven tool was in contact, also where the result is withheld.
    pub touched: bool,
    /// Whether it was on tissue or another body rather than at a thread: where nothing is felt then, tissue is too soft.
    pub presses: bool,
    /// Whether the tool lagged behind its hand by more than it touched: contact, without tangent and gap, is of where it is.
    pub outrun: bool,
    /// Whether the tool lagged behind its hand and touched nothing, where the hand would have it in the tissue.
    pub missed: bool,
    /// Withheld because the model did not come near enough to balance for its force to mean anything.
    pub unfinished: bool,
    /// Time per stage.
    pub stages: Stages,
    /// Steps made besides the solve's own.
    pub looked: Looked,
    /// Whether it read so much memory that the next one is worth a [`Solve::warm`].
    pub warms: bool,
}

impl Solved {
    /// What is sent for the state that was solved for, good until `horizon_us` after it, so that the console can
    /// render this way.
    pub fn frames(&self, state: &State, horizon_us: u32, rendering: Rendering) -> Option<Felt> {
        let mut contact = contact_frame(state, self.contact.as_ref()?, horizon_us);
        contact.position_m = self.position_m;
        contact.orientation = self.orientation.unwrap_or(state.orientation);
        let (needle, thread) = (self.needle.as_ref(), self.thread.as_ref());
        let all = Felt {
            contact,
            rows: self.rows.as_ref().and_then(rows_frame),
            needle: needle.map(needle_frame),
            thread: thread.map(thread_frame),
        };
        if rendering == Rendering::Rows {
            return Some(all);
        }
        if rendering == Rendering::Hold {
            contact.tangent = [0.0; 21];
        }
        Some(Felt {
            contact,
            rows: None,
            needle: None,
            thread: None,
        })
    }
}

/// What turns a state of the console into the contact that it feels.
pub trait Solve: Send {
    /// Steps the scene to the state's pose.
    fn solve(&mut self, state: &Valid<State>) -> Solved;

    /// Brings into the caches what a solve like the last one will read, shortly before that is due. Changes nothing.
    fn warm(&self) {}

    /// What solves from now on are to do: less than all where the host cannot keep its pace. Says what they do without.
    fn spare(&mut self, _effort: Effort) -> Spared {
        Spared::default()
    }

    /// Solves from now on are for a session of this plan, of which only the tuning differs from the one before.
    fn tune(&mut self, _plan: &Plan) {}

    /// What a hand does with a tool before the next solve, besides moving it; whether the tool can.
    fn act(&mut self, _act: Act) -> bool {
        false
    }

    /// What the scene reports when the session is over.
    fn scene(&self) -> serde_json::Map<String, serde_json::Value>;
}

/// How far a session is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Console time since the session's first state \[s\].
    pub elapsed_s: f64,
    /// How long the session is to last \[s\].
    pub seconds: f64,
    /// The console's newest state; none before the first.
    pub state: Option<&'a State>,
    /// The console's newest report.
    pub report: Option<&'a Report>,
    /// The link so far; none in lockstep, which has no line.
    pub link: Option<LinkSummary>,
    /// Whether the needle in the grip is in tissue that it was not seen to go into, and waits to be outside.
    pub needle_waits: bool,
    /// Ticks so far in which a limit of the device took a part of the force away.
    pub limited: LimitedTicks,
}
