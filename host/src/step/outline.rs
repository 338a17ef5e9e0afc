//! One step, from the samples of tools to what the console is sent.
//!
//! Entry points: [`step`], [`try_step`].

use super::balance::{Balance, MOST_EFFORT};
use super::console::reduce_tools;
use super::options::StepOptions;
use super::prefetch;
use super::reduce::reduce;
use super::report::{Status, StepReport, ToolContact};
use super::sources::{Moment, Sources, SourcesState, SourcesWork};
use super::state::State;
use super::substeps::follow;
use super::targets::Targets;
use super::workspace::Workspace;
use crate::clock::Clock;
use crate::fem::Moved;
use crate::jaws::between;
use crate::model::Model;
use crate::source::tool::{Placements, Slipped};
use crate::tool::{MAX_TOOLS, ToolSample};

/// Follows the tools from where they were to where `samples` says, balances the tissue, and reduces
/// the balance to one contact per sample. A tool that is not sampled is lifted off.
///
/// Deterministic for one binary and one SIMD level. Allocates only for new columns.
///
/// ```
/// use sutura_host::scene::{Document, Pose, read};
/// use sutura_host::script::at_rest;
/// use sutura_host::step::{Status, StepOptions, step};
///
/// let scene = read(&Document::embedded("slab.toml", "".as_ref(), r#"
///     name = "slab"
///     [mesh.slab]
///     size_m = [0.08, 0.08, 0.03]
///     divisions = [8, 8, 3]
///     [tissue]
///     model = "linear"
///     youngs_modulus_pa = 15e3
///     poisson_ratio = 0.45
///     [[fixed]]
///     plane = { axis = "z", at_m = -0.03 }
///     [[tool]]
///     radius_m = 0.014
/// "#))?;
/// let (model, mut state, mut work) = scene.build()?;
/// let mut press = |height_m: f64| {
///     let pose = Pose { position_m: [0.0, 0.0, height_m], orientation: [0.0, 0.0, 0.0, 1.0] };
///     let sample = at_rest(scene.tools[0].id, &pose);
///     loop {
///         // A step goes only so far, and computes only so many columns.
///         let report = step(&model, &mut state, &[sample], &StepOptions::default(), &mut work);
///         match report.status {
///             Status::Ok => break report.contacts()[0],
///             Status::Waiting | Status::Behind => {}
///             other => panic!("{other:?}"),
///         }
///     }
/// };
/// // 4 mm above the slab a ball of 14 mm touches nothing; 1 mm into it is pushed upwards.
/// let apart = press(0.018);
/// assert_eq!(apart.wrench[2], 0.0);
/// assert!((apart.gap_m - 0.004).abs() < 1e-9);
/// let held = press(0.013);
/// assert!(held.wrench[2] > 0.0 && held.rows > 0);
/// // The tangent says what a little more gives.
/// let deeper = press(0.013 - 1e-7);
/// let said = held.wrench[2] - 1e-7 * held.tangent[2][2];
/// assert!((deeper.wrench[2] - said).abs() < 1e-3 * (said - held.wrench[2]));
/// # Ok::<(), sutura_host::scene::SceneError>(())
/// ```
pub fn step(
    model: &Model,
    state: &mut State,
    samples: &[ToolSample],
    options: &StepOptions,
    work: &mut Workspace,
) -> StepReport {
    let mut report = StepReport::default();
    let placements = match read_samples(model, samples) {
        Ok(placements) => placements,
        Err(status) => {
            report.status = status;
            return report;
        }
    };
    let (Some(sources), Some(state), Some(own)) =
        (&model.sources, &mut state.sources, &mut work.sources)
    else {
        for (contact, sample) in report.contacts_mut(samples.len()).iter_mut().zip(samples) {
            *contact = ToolContact::nowhere(sample.id);
        }
        return report;
    };
    let mut step = Step {
        model,
        sources,
        options,
        state,
        work: own,
        report: &mut report,
        clock: &mut Clock::start(),
    };
    report.status = step.take(samples, &placements);
    report
}

/// A step that is thrown away: what tools would feel at `samples`. The state is as before, but for a factor that comes
/// meanwhile; that the workspace has rows it forgets. Of tissue that is not linear, where nothing is inside it.
pub fn try_step(
    model: &Model,
    state: &mut State,
    samples: &[ToolSample],
    options: &StepOptions,
    work: &mut Workspace,
) -> Option<StepReport> {
    let (own, before) = (work.sources.as_mut()?, state.sources.as_ref()?);
    if !own.mark(before) {
        return None;
    }
    let report = step(model, state, samples, options, work);
    let (own, after) = (work.sources.as_mut()?, state.sources.as_mut()?);
    own.go_back(after);
    own.rows.clear();
    Some(report)
}

/// Where each tool has to go.
fn read_samples(model: &Model, samples: &[ToolSample]) -> Result<Placements, Status> {
    let mut targets = [None; MAX_TOOLS];
    for sample in samples {
        let (index, tool) = model.tool(sample.id).ok_or(Status::UnknownTool)?;
        let placement = tool.place(sample).ok_or(Status::NotFinite)?;
        if targets[index].replace(placement).is_some() {
            return Err(Status::UnknownTool);
        }
    }
    Ok(targets)
}

/// All that a step works on.
struct Step<'a> {
    model: &'a Model,
    sources: &'a Sources,
    options: &'a StepOptions,
    state: &'a mut SourcesState,
    work: &'a mut SourcesWork,
    report: &'a mut StepReport,
    clock: &'a mut Clock,
}

impl Step<'_> {
    /// The whole of it. `samples` are known, finite, once each, and have the tools at `placements`.
    fn take(&mut self, samples: &[ToolSample], placements: &Placements) -> Status {
        let (model, sources) = (self.model, self.sources);
        self.work.rows.clear();
        let mut moment = Moment::of(self.state, samples);
        let targets = Targets::read(sources, self.state, samples, placements, moment.fall_s());
        let tools = &mut self.state.tools;
        if !tools.bring_in(model, &sources.tools, &targets.tools) {
            return Status::Inside;
        }
        self.take_over_tissue();
        self.state.begin_way(sources, &targets, &mut moment);
        self.work.balance.needles.fall_s = moment.fall_s();
        self.work.balance.effort_left = self.options.most_effort.unwrap_or(MOST_EFFORT);
        self.work.keep(self.state);
        let mut status = self.take_passes(&targets);
        // Nothing is said of rows that the forces do not belong to.
        if status.has_balance() && !self.state.grasp.is_of(&self.work.balance.set) {
            status = Status::NotConverged;
        }
        self.end_way(status, &moment);
        match self.work.balance.tools.slipped {
            Some(Slipped::Tool(tool)) if status == Status::Inside => {
                self.state.tools.forget(&sources.tools, tool);
            }
            Some(Slipped::Body(body)) if status == Status::Inside => {
                self.state.forget_body(body);
            }
            _ => {}
        }
        self.count_rows();
        match status {
            Status::Ok => self.say(samples),
            Status::Behind => self.say_on_the_way(samples),
            _ => {}
        }
        status
    }

    /// Columns and factors that came from beside the steps.
    fn take_over_tissue(&mut self) {
        let system = &mut self.work.balance.system;
        system.begin_step();
        self.report.renewals = system.take_over(&self.model.body, &mut self.state.grasp);
        let stages = &mut self.report.stages;
        self.clock.lap(match self.report.renewals.waited {
            0 => &mut stages.tissue_ns,
            _ => &mut stages.wait_ns,
        });
    }

    /// Newton's passes: each linearises the tissue where it is and follows the way, until little is left out of balance.
    /// Linear tissue is done after one.
    fn take_passes(&mut self, targets: &Targets) -> Status {
        loop {
            if self.is_balanced() {
                return Status::Ok;
            }
            if !self.linearise() {
                return Status::NotConverged;
            }
            if self.report.passes > 0 && self.work.begin_again(self.state) {
                self.report.substeps = 0;
            }
            let status = follow(self.model, &mut self.balance(), targets);
            if !status.has_balance() || self.model.body.is_linear() {
                return status;
            }
            let moved = self.move_tissue();
            let most = self.options.passes.unwrap_or(self.model.passes.most);
            let is_last = self.report.passes >= most;
            if is_last {
                let motion = self.state.grasp.motion();
                self.report.tangent_error += self.model.body.tangent_error_of_pass(motion);
            }
            match moved {
                Moved::Not => return Status::NotConverged,
                // Half way there is no balance.
                Moved::Part if is_last || status == Status::Behind => return Status::NotConverged,
                _ if is_last || status == Status::Behind => return status,
                _ => {}
            }
        }
    }

    /// Whether tissue that is not linear is in balance after a pass.
    fn is_balanced(&mut self) -> bool {
        let body = &self.model.body;
        let Some(balance) = self.work.balance.system.look(body, &mut self.state.grasp) else {
            return false;
        };
        self.report.imbalance = balance.imbalance;
        self.report.tangent_error = body.tangent_error(&balance);
        self.report.passes > 0 && balance.imbalance <= self.model.passes.tolerance
    }

    /// Linearises tissue that is not linear; whether that could be done.
    fn linearise(&mut self) -> bool {
        let system = &mut self.work.balance.system;
        let linearised = system.linearise(&self.model.body, &mut self.state.grasp);
        self.clock.lap(&mut self.report.stages.tissue_ns);
        let Some(linearised) = linearised else {
            return true;
        };
        self.report.renewals.asked += u32::from(linearised.asked);
        if linearised.refactored {
            self.report.refactorisations += 1;
            self.report.tangent_error = 0.0;
        }
        linearised.sound
    }

    /// Moves tissue that is not linear by what a pass found.
    fn move_tissue(&mut self) -> Moved {
        let system = &mut self.work.balance.system;
        let moved = system.accept(&self.model.body, &mut self.state.grasp);
        self.clock.lap(&mut self.report.stages.tissue_ns);
        self.report.passes += u32::from(moved != Moved::Not);
        moved
    }

    /// What failed is taken back.
    fn end_way(&mut self, status: Status, moment: &Moment) {
        if status.has_balance() {
            self.state.end_way(self.sources, moment);
            return;
        }
        // While columns are awaited the tissue stays where their factor is of.
        if status != Status::Waiting {
            self.work.put_back(self.state);
        }
        self.state.take_back_speeds(moment);
    }

    /// Of a touch of a tool one row counts for all.
    fn count_rows(&mut self) {
        let work = &self.work.balance;
        let rows = work.count() - work.tools.rows.len();
        self.report.rows = (rows + self.state.tools.contacts.len()) as u32;
    }

    /// As [`Self::say`], where tools are that have not come all the way.
    fn say_on_the_way(&mut self, samples: &[ToolSample]) {
        let Some(first) = samples.first() else {
            return self.say(samples);
        };
        let mut reached = [*first; MAX_TOOLS];
        for (reached, sample) in reached.iter_mut().zip(samples) {
            *reached = self.state.reached(self.model, self.sources, sample);
        }
        self.say(reached.get(..samples.len()).unwrap_or(samples));
    }

    /// Columns for what comes, and what tools, needles and threads feel.
    fn say(&mut self, samples: &[ToolSample]) {
        let (model, options) = (self.model, self.options);
        let SourcesWork {
            balance,
            tangent,
            cones,
            rows,
            ..
        } = &mut *self.work;
        let (report, clock) = (&mut *self.report, &mut *self.clock);
        let balance = &mut Balance::new(
            model,
            self.sources,
            options,
            self.state,
            balance,
            report,
            clock,
        );
        prefetch::near_tools(balance, options);
        reduce(model, balance, samples, options, tangent);
        if let Some(cones) = cones.as_mut().filter(|_| !options.without_tools) {
            reduce_tools(model, balance, samples, options, cones, rows);
        }
        balance.clock.lap(&mut balance.report.stages.reduce_ns);
        between(balance);
        prefetch::near_tips(balance);
    }

    /// Its tissue and all that acts on it.
    fn balance(&mut self) -> Balance<'_> {
        let work = &mut self.work.balance;
        Balance::new(
            self.model,
            self.sources,
            self.options,
            self.state,
            work,
            self.report,
            self.clock,
        )
    }
}
