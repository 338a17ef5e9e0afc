//! What can be seen of a solver, copied between two steps for whoever draws it.
//!
//! Entry points: [`SceneSolver::snapshot`], [`Snapshot::of`].

use super::SceneSolver;
use super::follower::Follower;
use crate::model::Model;
use crate::step::{State, StepReport};
use crate::thread::{FreeThreads, Hanging};
use crate::tool::ToolSample;
use std::sync::Arc;

/// A solver's state after a step. Made once, and written again and again without new memory.
#[derive(Clone, Debug)]
pub struct Snapshot {
    tissue: Seen,
    samples: Vec<ToolSample>,
    last: StepReport,
    good: StepReport,
    console_time_us: u64,
    time_s: f64,
    /// Solves before it; for whoever counts them.
    pub solves: u32,
}

/// From what follows where nodes are.
#[derive(Clone, Debug)]
enum Seen {
    /// Nodes follow from forces and from what moves by itself.
    Constrained(Arc<Model>, Box<State>),
    /// Nodes are where they are \[m\], (n x 3).
    Prescribed(Vec<[f64; 3]>),
}

impl Snapshot {
    /// Of a solver as it is. Allocates.
    pub fn of(solver: &SceneSolver) -> Self {
        let tissue = match &solver.follower {
            Follower::Constrained(tissue) => {
                Seen::Constrained(tissue.model.clone(), Box::new(State::new(&tissue.model)))
            }
            Follower::Prescribed(tissue) => Seen::Prescribed(tissue.positions_m().to_vec()),
        };
        let mut new = Self {
            tissue,
            samples: solver.samples().to_vec(),
            last: StepReport::default(),
            good: StepReport::default(),
            console_time_us: 0,
            time_s: 0.0,
            solves: 0,
        };
        solver.snapshot(&mut new);
        new
    }

    /// Tissue with constraints, if it is that.
    pub fn constrained(&self) -> Option<(&Model, &State)> {
        match &self.tissue {
            Seen::Constrained(model, state) => Some((model, state)),
            Seen::Prescribed(_) => None,
        }
    }

    /// Where every node is \[m\], (n x 3): allocates, and solves for them where they follow from forces.
    pub fn positions_m(&self) -> Vec<[f64; 3]> {
        match &self.tissue {
            Seen::Constrained(model, state) => state.positions(model),
            Seen::Prescribed(nodes_m) => nodes_m.clone(),
        }
    }

    /// Moves threads that hang on to this instant, which is a beat, with all nodes at `nodes_m` (n x 3).
    pub fn beat(&self, hanging: &mut Hanging, nodes_m: &[[f64; 3]]) {
        if let Some((model, state)) = self.constrained() {
            hanging.beat(self.console_time_us, model, state, nodes_m);
        }
    }

    /// Threads that hang, as they are at this instant after their last beat; `None` before the first.
    pub fn threads<'a>(
        &self,
        hanging: &'a mut Hanging,
        nodes_m: &[[f64; 3]],
    ) -> Option<&'a FreeThreads> {
        let (model, state) = self.constrained()?;
        hanging.seen(self.console_time_us, model, state, nodes_m)
    }

    /// Where the tools are, the driven one first.
    pub fn samples(&self) -> &[ToolSample] {
        &self.samples
    }

    /// Of the newest step.
    pub fn last(&self) -> &StepReport {
        &self.last
    }

    /// Of the newest step that found a balance.
    pub fn good(&self) -> &StepReport {
        &self.good
    }

    /// Console time of the state that was solved for \[us\]; 0 before the first.
    pub fn console_time_us(&self) -> u64 {
        self.console_time_us
    }

    /// The same since the first solve \[s\].
    pub fn time_s(&self) -> f64 {
        self.time_s
    }
}

impl SceneSolver {
    /// Copies what can be seen of it to a snapshot of this solver, or of one of the same scene, without new memory.
    pub fn snapshot(&self, into: &mut Snapshot) {
        match (&mut into.tissue, &self.follower) {
            (Seen::Constrained(_, state), Follower::Constrained(tissue)) => {
                state.see(&tissue.state);
            }
            (Seen::Prescribed(nodes_m), Follower::Prescribed(tissue)) => {
                nodes_m.clear();
                nodes_m.extend_from_slice(tissue.positions_m());
            }
            _ => return,
        }
        into.samples.clear();
        into.samples.extend_from_slice(self.samples());
        into.last = self.past.last;
        into.good = self.past.peaks.last_good;
        let began_us = self.past.began_us.unwrap_or_default();
        let now_us = self.past.last_sample.map(|sample| sample.console_time_us);
        into.console_time_us = now_us.unwrap_or_default();
        into.time_s = 1e-6 * into.console_time_us.saturating_sub(began_us) as f64;
    }

    /// Tissue with constraints, as pictures of it need to know it.
    pub fn model(&self) -> Option<&Arc<Model>> {
        match &self.follower {
            Follower::Constrained(tissue) => Some(&tissue.model),
            Follower::Prescribed(_) => None,
        }
    }

    /// What the newest step did.
    pub fn last(&self) -> &StepReport {
        &self.past.last
    }
}
