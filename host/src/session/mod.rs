//! A session: the console's states in, the solver's contacts out, and the statistics of it all.
//!
//! Entry points: [`run_real_time`] for a console that runs by itself, [`run_lockstep`] for one that
//! advances a tick per exchange. Both set up the same way, solve through [`Solve`], and end with a
//! [`Summary`].

mod budget;
mod chosen;
mod contact_frame;
mod heard;
mod horizon;
#[cfg(test)]
mod late_tests;
mod lockstep;
mod look_ahead;
mod look_budget;
mod machine_lateness;
mod model_solver;
mod needle_frame;
mod overload;
#[cfg(test)]
mod puncture_tests;
mod real_time;
mod rows_frame;
mod schedule;
mod scheduling;
mod setup;
mod sideways;
mod sticking;
mod summary;
mod tally;
mod thread_frame;
mod tissue;

pub use crate::scene::Rendering;
pub use budget::{LINE_BYTES_PER_S, most_rows};
pub use chosen::{Candidate, Chosen, StepUs};
pub use contact_frame::{contact_frame, pack_symmetric};
pub use heard::{Fate, Underway};
pub use horizon::Horizon;
pub use lockstep::run_lockstep;
pub use look_budget::Looked;
pub use machine_lateness::{LatenessProbe, MachineLate, MachineLateness};
pub use model_solver::ModelSolver;
pub use needle_frame::{HeldNeedle, needle_frame};
pub use overload::{Effort, GivenUp, Spared};
pub use real_time::{Arms, Attendant, Line, run_real_time};
pub use rows_frame::rows_frame;
pub use scheduling::Scheduling;
pub use setup::{Plan, SessionError, check_rate, least_hz};
pub use sideways::{Goal, reach_m, sideways};
pub use summary::{
    Age, ConsoleClock, Energy, Force, Frames, Latency, LinkSummary, RoundTrip, StepTime, Summary,
    Throughput,
};
pub use tally::{NOT_RENDERED, Tally, mode_word};
pub use thread_frame::{HeldThread, thread_frame};
pub use tissue::{Moment, TissueSolver};

use crate::link::Felt;
use crate::scene::{Scene, Tissue};
use crate::solve::SolveError;
use crate::step::{Arrival, Stages, Status, ToolContact, ToolRows};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Report, State};

/// What a solver step gave.
#[derive(Clone, Copy, Debug, Default)]
pub struct Solved {
    /// Grip position that was solved for \[m\], (3): a little ahead of the state's.
    pub position_m: [f32; 3],
    /// The contact at the state's pose; none when the result is not good enough to be felt.
    pub contact: Option<ToolContact>,
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
    /// Withheld because the model did not come near enough to balance for its force to mean anything.
    pub unfinished: bool,
    /// Time per stage.
    pub stages: Stages,
    /// Steps made besides the solve's own.
    pub looked: Looked,
}

impl Solved {
    /// What is sent for the state that was solved for, good until `horizon_us` after it, so that the console can
    /// render this way.
    pub fn frames(&self, state: &State, horizon_us: u32, rendering: Rendering) -> Option<Felt> {
        let mut contact = contact_frame(state, self.contact.as_ref()?, horizon_us);
        contact.position_m = self.position_m;
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

    /// What solves from now on are to do: less than all where the host cannot keep its pace. Says what they do without.
    fn spare(&mut self, _effort: Effort) -> Spared {
        Spared::default()
    }

    /// What the scene reports when the session is over.
    fn scene(&self) -> serde_json::Map<String, serde_json::Value>;
}

/// A scene's solver, whose steps can be recorded and run again.
pub trait SceneSolver: Solve {
    /// Hash of its state, to the bit; what that leaves out shows in a later step's.
    fn hash(&self) -> u64;

    /// From now on a thread computes what is newly touched while steps go on with what is there, if the solver has any use
    /// for one. What a step finds in contact is the same to the bit, but not when it finds it, nor from when on the
    /// tangent of a touch to come is there: for sessions in real time.
    fn start_worker(&mut self) {}

    /// From now on it is written down when columns come from their thread, for [`Self::take_arrivals`].
    fn log_arrivals(&mut self) {}

    /// What has come from the thread since this was asked last.
    fn take_arrivals(&mut self) -> Vec<Arrival> {
        Vec::new()
    }

    /// As [`Self::start_worker`] without the thread: columns come in the steps in which [`Self::expect`] says that they
    /// came.
    fn replay_worker(&mut self) {}

    /// What comes in steps to come, and how far the next solve looks ahead.
    fn expect(&mut self, _arrivals: &[Arrival], _looked: Looked) {}

    /// From now on no long work is done beside the steps but columns: as it was when recordings did not say when a
    /// factor came.
    fn renew_in_step(&mut self) {}
}

/// The solver of a scene's tissue, prepared for what a session is to be.
///
/// # Errors
/// What [`TissueSolver::for_session`] and [`ModelSolver::new`] refuse.
pub fn solver(scene: &Scene, plan: &Plan) -> Result<Box<dyn SceneSolver>, SolveError> {
    Ok(match scene.tissue {
        Tissue::Registered(model) if !scene.has_rows() => Box::new(ModelSolver::new(
            scene,
            model,
            plan.rendering,
            plan.host_hz,
        )?),
        _ => Box::new(TissueSolver::for_session(scene, plan)?),
    })
}

/// Builds a scene's solver and brings held tools to their places, to see whether it can be.
///
/// # Errors
/// As [`solver`].
pub fn check(scene: &Scene) -> Result<(), SolveError> {
    match scene.tissue {
        Tissue::Registered(model) if !scene.has_rows() => {
            ModelSolver::new(scene, model, Rendering::Tangent, scene.host.host_hz).map(drop)
        }
        _ => TissueSolver::new(scene).map(drop),
    }
}

/// How far a session is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Console time since the session's first state \[s\].
    pub elapsed_s: f64,
    /// How long the session is to last \[s\].
    pub seconds: f64,
    /// The console's newest state.
    pub state: &'a State,
    /// The console's newest report.
    pub report: Option<&'a Report>,
    /// Whether the needle in the grip is in tissue that it was not seen to go into, and waits to be outside.
    pub needle_waits: bool,
}
