//! Scratch of a step, and the cache of compliance columns.
//!
//! Entry point: [`Workspace`].

use super::sources::SourcesWork;
use super::tool_rows::ToolRows;
use crate::anchors::ConstraintSystem;
use crate::body::Body;
use crate::columns::{Arrival, Columns};
use crate::model::Model;
use crate::renewal::Rule;

/// Memory for columns if nothing else is said \[bytes\].
pub(crate) const DEFAULT_CACHE_BYTES: usize = 512 << 20;

/// Scratch and the cache of compliance columns.
pub struct Workspace {
    pub(super) sources: Option<Box<SourcesWork>>,
}

impl Workspace {
    /// Empty cache; all other buffers at their largest size.
    pub fn new(model: &Model) -> Self {
        Self {
            sources: model
                .sources
                .as_ref()
                .map(|sources| Box::new(SourcesWork::new(model, sources))),
        }
    }

    /// From now on a thread of its own computes columns, ahead of the tools where it can; a step that
    /// needs one that is not there says [`Status::Waiting`](super::Status::Waiting). The bits of what a step finds in contact are the
    /// same, but not when it finds it, nor from when on it knows the tangent of a touch to come: for live
    /// sessions, whose [arrivals](Self::take_arrivals) a replay needs. For corotational tissue as
    /// [`Self::renew_beside`] in the steps in which factors are there; columns of newly touched vertices are
    /// computed in the step.
    ///
    /// # Errors
    /// What the system says when it has no thread to give.
    pub fn start_worker(&mut self, model: &Model) -> std::io::Result<()> {
        let Body::Linear { tissue, .. } = &model.body else {
            self.renew_beside(model, Rule::WhenThere);
            return Ok(());
        };
        let tissue = tissue.clone();
        match self.system(model) {
            Some((system, reached)) => system.start_worker(tissue, &reached),
            None => Ok(()),
        }
    }

    /// As [`Self::start_worker`] without the thread: columns come in the steps in which [`Self::expect`] says that they
    /// came.
    pub fn replay_worker(&mut self, model: &Model) {
        let Body::Linear { tissue, .. } = &model.body else {
            self.renew_beside(model, Rule::AsRecorded);
            return;
        };
        let tissue = tissue.clone();
        if let Some((system, reached)) = self.system(model) {
            system.replay_worker(tissue, &reached);
        }
    }

    /// From now on factors of corotational tissue are renewed, with the columns in use, by a thread beside the steps,
    /// and taken over by `rule`. A state's bits depend on the steps in which that happens and on nothing else. Nothing
    /// happens for linear or hyperelastic tissue, nor for a policy that wants factors fresh.
    pub fn renew_beside(&mut self, model: &Model, rule: Rule) {
        if let Some((system, reached)) = self.system(model) {
            system.renew_beside(&model.body, &reached, rule);
        }
    }

    /// Brings into the caches what a step like the last one reads most of, shortly before it: what was not used for milliseconds is in no
    /// cache any more where others use that, too. Changes nothing.
    pub fn warm(&self, model: &Model, state: &super::State) {
        if let (Some(work), Some(state)) = (&self.sources, &state.sources) {
            work.balance.system.warm(&model.body, &state.grasp);
        }
    }

    /// What finds forces on the tissue, and the nodes that it reaches; nothing if nothing touches it.
    fn system(&mut self, model: &Model) -> Option<(&mut ConstraintSystem, Vec<u32>)> {
        let reached = model.reached(model.sources.as_ref()?);
        let needles = self.sources.as_mut()?;
        Some((&mut needles.balance.system, reached))
    }

    /// From now on factors of corotational tissue are made in the step that needs them, as they are at first.
    pub fn renew_in_step(&mut self) {
        self.served().into_iter().for_each(Columns::renew_in_step);
    }

    /// What comes from the worker of a replay in steps to come.
    pub fn expect(&mut self, arrivals: &[Arrival]) {
        if let Some(columns) = self.served() {
            columns.expect(arrivals);
        }
    }

    /// From now on what comes from the worker is written down, for [`Self::take_arrivals`].
    pub fn log_arrivals(&mut self) {
        self.served().into_iter().for_each(Columns::log_arrivals);
    }

    /// What has come from the worker since this was asked last.
    pub fn take_arrivals(&mut self) -> Vec<Arrival> {
        let columns = self.served();
        columns.map(Columns::take_arrivals).unwrap_or_default()
    }

    /// The columns that a worker computes.
    pub(crate) fn served(&mut self) -> Option<&mut Columns> {
        let needles = self.sources.as_mut()?;
        Some(needles.balance.system.columns_mut())
    }

    /// Computes the columns of all nodes that can be acted on whose resting position \[m\] satisfies `near`, so
    /// that touching them later costs nothing. Returns how many are there now.
    pub fn prepare(&mut self, model: &Model, near: impl Fn([f64; 3]) -> bool) -> usize {
        match (&mut self.sources, &model.sources) {
            (Some(work), Some(needles)) => work.prepare(model, needles, near),
            _ => 0,
        }
    }

    /// The rows of a tool at the last step's balance, if [`StepOptions::most_rows`](super::StepOptions) asked for any.
    pub fn rows(&self, tool: u8) -> Option<&ToolRows> {
        let rows = self.sources.iter().flat_map(|needles| &needles.rows);
        rows.into_iter().find(|rows| rows.tool == tool)
    }

    /// Memory held by the cache \[bytes\].
    pub fn cache_bytes(&self) -> usize {
        let needles = self.sources.as_ref();
        needles.map_or(0, |needles| needles.balance.system.columns().bytes())
    }
}
