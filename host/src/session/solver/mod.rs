//! The solver of a scene: a console's state becomes a sample, a step, a contact.
//!
//! Entry points: [`SceneSolver::for_session`], [`SceneSolver::new`]. The console's one grip carries the scene's driven tool; the
//! others stay where the scene holds them, or follow their scripts. What follows them all is a [`Follower`].

mod ahead;
mod constrained;
mod events;
mod follower;
mod lag;
mod peaks;
mod secant;
mod snapshot;

use super::look_budget::{LookBudget, Looked};
use super::{
    Effort, HeldNeedle, HeldThread, Plan, Rendering, Solve, SolveError, Solved, Spared, reach_m,
};
use crate::clock::Clock;
use crate::event::Event;
use crate::model::Model;
use crate::prescribed::Prescribed;
use crate::scene::{Pose, RELAXES, Registered, Scene, Thread};
use crate::script::{Path, Script, path};
use crate::step::{
    self, Arrival, Rule, Stages, Status, StepOptions, StepReport, ToolRows, Workspace,
};
use crate::tool::{Act, Tool, ToolSample};
use crate::wound::{Overlap, WoundReport};
use constrained::Constrained;
pub(crate) use constrained::{IN_BALANCE, MOST_PASSES, MOST_STEPS};
use events::EventLog;
pub use events::Happened;
use follower::Follower;
use lag::{Lag, without_course};
use nalgebra::Vector3;
use peaks::Peaks;
use serde_json::{Map, Value, json};
pub use snapshot::Snapshot;
use std::borrow::Cow;
use sutura_client::Lead;
use sutura_shared::control::LOST_AFTER_US;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{State, Tension, Tip};

/// Seconds between two places of the hand that the solver is prepared for.
const PREPARED_EVERY_S: f64 = 0.02;

/// Force \[N\] and torque \[N m\] that are none.
const NO_FORCE_N: f64 = 1e-9;

/// A scene's solver, whose steps can be recorded and run again.
pub struct SceneSolver {
    name: String,
    /// Of the tissue, as files write it.
    tissue: &'static str,
    has_needles: bool,
    has_threads: bool,
    has_jaws: bool,
    follower: Follower,
    options: StepOptions,
    /// Rows of a step for which there is time.
    most_rows: usize,
    /// How long a frame is in use at most \[s\], from its state on.
    ahead_s: f64,
    /// When frames usually are in use.
    lead: Lead,
    /// Whether frames carry the states of needle and thread, which are what is looked ahead for.
    looks_ahead: bool,
    /// Whether its steps may take more passes than the model says, where there is time: the scene leaves it open, and no pass
    /// follows a needle's way once more.
    settles: bool,
    effort: Effort,
    past: Past,
}

/// What a solver remembers of its steps, besides the tissue's state.
#[derive(Clone)]
struct Past {
    script: Script,
    /// Console time of the first step \[us\], from which scripts count.
    began_us: Option<u64>,
    budget: LookBudget,
    peaks: Peaks,
    events: EventLog,
    /// Of the state before.
    last_sample: Option<ToolSample>,
    last: StepReport,
}

/// A solver's state between two steps, for others of the same scene to go on from.
pub struct Moment {
    state: step::State,
    past: Past,
}

impl SceneSolver {
    /// Builds the scene's solver and brings the tools that are held to their places.
    ///
    /// # Errors
    /// What [`Scene::build`] refuses, or a model for its own reasons; tools that are held too deep.
    pub fn new(scene: &Scene) -> Result<Self, SolveError> {
        if let Some(model) = scene.tissue.sticking() {
            return Self::sticking(scene, model, Rendering::Tangent, scene.host.host_hz);
        }
        let mut solver = Self::apart(scene)?;
        if let Some(tissue) = solver.follower.constrained().filter(|_| !scene.settle) {
            tissue.state = step::State::unloaded(&tissue.model);
        }
        // Grips touch nothing on their way.
        let held: Vec<_> = scene
            .held()
            .filter(|(tool, _)| {
                let others = scene.needles.is_empty() && scene.jaws.is_empty();
                let carries = tool.body.is_some() || !others;
                !(carries && tool.shape.is_grip())
            })
            .map(|(tool, pose)| (tool.id, tool.shape.clone(), pose))
            .collect();
        solver.bring_in(&held)?;
        Ok(solver)
    }

    /// As [`Self::new`], with a model to which tools stick, whatever tissue the scene has; steps come `host_hz` times a
    /// second, and have a tangent if the console renders from that.
    ///
    /// # Errors
    /// What the model refuses; tools that are too many, have no shape, or are held too deep.
    pub fn sticking(
        scene: &Scene,
        model: Registered,
        rendering: Rendering,
        host_hz: f64,
    ) -> Result<Self, SolveError> {
        let tissue = Prescribed::new(scene, model, rendering, host_hz)?;
        let follower = Follower::Prescribed(Box::new(tissue));
        Ok(Self::around(scene, model.name(), follower))
    }

    /// Tissue with constraints, before any tool comes.
    pub(crate) fn apart(scene: &Scene) -> Result<Self, SolveError> {
        let follower = Follower::Constrained(Box::new(Constrained::new(scene)?));
        Ok(Self::around(scene, scene.tissue.word(), follower))
    }

    fn around(scene: &Scene, tissue: &'static str, follower: Follower) -> Self {
        if scene.relaxation.is_some() && tissue != RELAXES {
            tracing::warn!(
                "{tissue} tissue does not fade: `relaxation` of the scene changes nothing"
            );
        }
        Self {
            name: scene.name.clone(),
            tissue,
            has_needles: !scene.needles.is_empty(),
            has_threads: !scene.threads.is_empty(),
            has_jaws: !scene.jaws.is_empty(),
            past: Past {
                script: Script::new(scene),
                began_us: None,
                budget: LookBudget::new(1e6 / scene.host.host_hz, follower.nodes()),
                peaks: Peaks::new(scene),
                events: EventLog::new(scene.threads.iter().map(Thread::tear_pa)),
                last_sample: None,
                last: StepReport::default(),
            },
            follower,
            options: StepOptions::default(),
            most_rows: 0,
            ahead_s: 0.0,
            lead: Lead::new(),
            looks_ahead: true,
            settles: scene.tissue.leaves_passes_open()
                && scene.needles.is_empty()
                && scene.threads.is_empty(),
            effort: Effort::Full,
        }
    }

    /// As [`Self::new`], prepared for what a session is to be: what the hand will come by is computed, and rows
    /// are reduced to what its line carries.
    ///
    /// # Errors
    /// As there.
    pub fn for_session(scene: &Scene, plan: &Plan) -> Result<Self, SolveError> {
        if let Some(model) = scene.tissue.sticking() {
            return Self::sticking(scene, model, plan.rendering, plan.host_hz);
        }
        let mut solver = Self::new(scene)?;
        // A frame carries that of the tool that the hand drives.
        solver.options.tangents = Some(1);
        solver.get_ready(scene, plan);
        Ok(solver)
    }

    fn get_ready(&mut self, scene: &Scene, plan: &Plan) {
        if let Some(tissue) = self.follower.constrained() {
            // The same on every machine; a session in real time has them when they are there.
            let rule = Rule::SAME_EVERYWHERE;
            tissue.work.renew_beside(&tissue.model, rule);
        }
        let used = plan.hand.way_points.get(..usize::from(plan.hand.count));
        let hand_s = used
            .and_then(<[_]>::last)
            .map_or(0.0, |point| f64::from(point.time_s));
        let ways = scene.tools.iter().filter_map(|tool| tool.way.as_ref());
        let ends = ways.filter_map(|way| way.stops().last());
        let holds = scene.needles.iter().flat_map(|needle| &needle.holds);
        let times = ends
            .map(|stop| stop.time_s)
            .chain(holds.map(|hold| hold.time_s));
        // Afterwards everything rests.
        let end_s = times.fold(hand_s, f64::max);
        let (end_s, apart_m) = (end_s.min(plan.seconds), Self::apart_m(scene));
        let path = path(scene, end_s, PREPARED_EVERY_S, apart_m);
        self.prepare(&path);
        self.tune(plan);
    }

    /// Brings tools to where they are held, if there are any.
    fn bring_in(&mut self, held: &[(u8, Tool, Pose)]) -> Result<(), SolveError> {
        if !held.is_empty() {
            self.come_to_rest(held)?;
        }
        Ok(())
    }

    /// Brings tools to where they are held, and tissue to rest with all that acts on it.
    pub(crate) fn come_to_rest(
        &mut self,
        held: &[(u8, Tool, Pose)],
    ) -> Result<StepReport, SolveError> {
        let Some(tissue) = self.follower.constrained() else {
            return Ok(self.past.last);
        };
        self.past.last = tissue.come_to_rest(held)?;
        self.past.peaks.last_good = self.past.last;
        Ok(self.past.last)
    }

    /// Computes beforehand what steps along `path` will need, so that the first touch costs no more than
    /// any other. Returns how many vertices are prepared.
    pub fn prepare(&mut self, path: &Path) -> usize {
        let driven = self.driven();
        let tissue = self.follower.constrained();
        tissue.map_or(0, |tissue| tissue.prepare(path, driven))
    }

    /// From now on steps reduce the driven tool's contact to so many rows at most (0: to none), those that matter
    /// within `ahead_s` first.
    pub fn reduce_to(&mut self, most_rows: usize, ahead_s: f64) {
        self.most_rows = most_rows;
        self.options.most_rows = most_rows;
        self.options.reach_m = reach_m(ahead_s);
        self.ahead_s = ahead_s;
    }

    /// Solves are planned every `period_s` from now on: what is looked at ahead is paid from that.
    pub fn plan_every(&mut self, period_s: f64) {
        self.past.budget.plan(1e6 * period_s);
    }

    /// The driven tool's rows at the last step, if there are any.
    fn rows(&self) -> Option<ToolRows> {
        let (_, _, work) = self.parts()?;
        let rows = work.rows(self.driven()?)?;
        (self.past.last.status.has_balance() && rows.count > 0).then_some(*rows)
    }

    /// Distance between the points of a needle that [`Self::prepare`] needs at most \[m\].
    pub fn apart_m(scene: &Scene) -> f64 {
        0.5 * scene.mesh.surface().mean_edge_m
    }

    /// Id of the tool that the console's grip carries.
    pub fn driven(&self) -> Option<u8> {
        self.past.script.driven()
    }

    /// Steps with the driven tool where `sample` is, and all else where the scripts have it at its time, counted from
    /// the first step's. Where there is a balance ([`Status::has_balance`]) there is a contact for each tool, the driven one's first.
    ///
    /// ```
    /// use sutura_host::scene::{Document, Pose, read};
    /// use sutura_host::script::at_rest;
    /// use sutura_host::session::SceneSolver;
    /// use sutura_host::step::Status;
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
    /// let mut solver = SceneSolver::new(&scene)?;
    /// let lowest = |solver: &SceneSolver| {
    ///     let top = scene.mesh.points_m().iter().map(|point| point[2] == 0.0);
    ///     let moved = solver.positions_m().into_owned();
    ///     let heights = moved.into_iter().zip(top).filter(|(_, top)| *top);
    ///     heights.map(|(at, _)| at[2]).fold(f64::INFINITY, f64::min)
    /// };
    /// assert_eq!(lowest(&solver), 0.0);
    /// // The hand goes down at 50 mm/s, and the console says every 20 ms where it is.
    /// let id = solver.driven().unwrap_or_default();
    /// let mut forces_n = Vec::new();
    /// for turn in 0..=8 {
    ///     let height_m = 0.016 - 1e-3 * f64::from(turn);
    ///     let pose = Pose { position_m: [0.0, 0.0, height_m], orientation: [0.0, 0.0, 0.0, 1.0] };
    ///     let mut sample = at_rest(id, &pose);
    ///     sample.console_time_us = 20_000 * u64::try_from(turn)?;
    ///     let mut report = solver.step(sample);
    ///     while matches!(report.status, Status::Waiting | Status::Behind) {
    ///         report = solver.step(sample);
    ///     }
    ///     assert_eq!(report.status, Status::Ok);
    ///     forces_n.push(report.contacts()[0].wrench[2]);
    /// }
    /// // The deeper, the more; and the top gives way as far as the ball has gone in.
    /// assert_eq!(forces_n[0], 0.0);
    /// assert!(forces_n[3..].windows(2).all(|pair| pair[1] > pair[0]));
    /// assert!((lowest(&solver) + 0.006).abs() < 1e-4);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn step(&mut self, sample: ToolSample) -> StepReport {
        let report = self.step_with(sample, false);
        self.past
            .peaks
            .press(&report, self.reached(&report, &sample).position_m);
        report
    }

    /// Where a step has a tool that was sampled at `sample`: on the way there, if that was too long for it.
    fn reached(&self, report: &StepReport, sample: &ToolSample) -> ToolSample {
        match report.status {
            Status::Behind => self.follower.reached(sample),
            _ => *sample,
        }
    }

    /// How far the tools are from where the last step was to follow them, the farthest \[m\].
    fn lag_m(&self) -> f64 {
        let report = &self.past.last;
        let lags = self.past.script.samples().iter().map(|sample| {
            let [there, here] = [*sample, self.reached(report, sample)];
            Vector3::from(there.position_m).metric_distance(&Vector3::from(here.position_m))
        });
        lags.fold(0.0, f64::max)
    }

    /// As [`Self::step`]; of a console that is `armed_anew` nobody knows by which way its grip came where it is.
    fn step_with(&mut self, sample: ToolSample, armed_anew: bool) -> StepReport {
        let now_us = sample.console_time_us;
        let began_us = *self.past.began_us.get_or_insert(now_us);
        let time_s = 1e-6 * now_us.saturating_sub(began_us) as f64;
        self.go(time_s, sample, armed_anew)
    }

    /// Steps with everything where the scripts have it so long after the start \[s\], the hand's included.
    pub(crate) fn step_by_script(&mut self, time_s: f64) -> StepReport {
        let sample = self.past.script.in_hand(time_s);
        self.go(time_s, sample, false)
    }

    fn go(&mut self, time_s: f64, sample: ToolSample, armed_anew: bool) -> StepReport {
        let Past {
            script,
            peaks,
            events,
            last,
            ..
        } = &mut self.past;
        let mut tissue = self.follower.constrained();
        let parts = tissue
            .as_mut()
            .map(|tissue| (&*tissue.model, &mut tissue.state));
        script.step_to(time_s, sample, parts);
        for missed in script.take_missed() {
            events.note(time_s, missed);
            warn_of(&missed);
        }
        let samples = script.samples();
        if let (Some(tissue), Some(driven)) = (tissue, samples.first().filter(|_| armed_anew)) {
            tissue.state.put(driven);
        }
        *last = self.follower.follow(samples, &self.options);
        peaks.step(last);
        events.step(time_s, last);
        *last
    }

    /// What a hand does with a tool between two steps; whether the tool can.
    pub fn act(&mut self, act: Act) -> bool {
        let tissue = self.follower.constrained();
        tissue.is_some_and(|tissue| tissue.state.act(&tissue.model, act))
    }

    /// Where a tool that the grip does not carry is from the next step on, whatever its script says; whether there is such a tool.
    pub fn place(&mut self, tool: u8, pose: &Pose) -> bool {
        self.past.script.place(tool, pose)
    }

    /// Boundaries that needles have broken through so far.
    pub fn punctures(&self) -> u32 {
        self.past.peaks.punctures()
    }

    /// What has happened to threads, and which holds were out of reach, so far.
    pub fn events(&self) -> &[Happened] {
        self.past.events.all()
    }

    /// Where it is now; nothing of a model to which tools stick, of which there is no copy.
    pub fn moment(&self) -> Option<Moment> {
        let (_, state, _) = self.parts()?;
        Some(Moment {
            state: state.clone(),
            past: self.past.clone(),
        })
    }

    /// Goes on where another solver of the same scene was.
    pub fn go_on_from(&mut self, moment: &Moment) {
        if let Some(tissue) = self.follower.constrained() {
            tissue.state.clone_from(&moment.state);
            self.past.clone_from(&moment.past);
        }
    }

    /// The parts of tissue with constraints, for what looks at them between steps.
    pub fn parts(&self) -> Option<(&Model, &step::State, &Workspace)> {
        match &self.follower {
            Follower::Constrained(tissue) => Some((&*tissue.model, &tissue.state, &tissue.work)),
            Follower::Prescribed(_) => None,
        }
    }

    /// Where the tools were in the last step.
    pub fn samples(&self) -> &[ToolSample] {
        self.past.script.samples()
    }

    /// Where every node is \[m\], (n x 3).
    pub fn positions_m(&self) -> Cow<'_, [[f64; 3]]> {
        self.follower.positions_m()
    }

    /// What there is to say of threads and of what they close.
    pub(crate) fn wound(&self) -> Option<WoundReport> {
        let Follower::Constrained(tissue) = &self.follower else {
            return None;
        };
        let last = &self.past.peaks.last_good;
        let wound = tissue.wound.as_ref()?;
        Some(wound.report(&tissue.model, &tissue.state, last))
    }

    /// Returns the overlap of parts that may touch, if it is deeper than contact leaves them.
    pub fn overlap(&self) -> Option<Overlap> {
        match &self.follower {
            Follower::Constrained(tissue) => tissue.overlap(),
            Follower::Prescribed(_) => None,
        }
    }

    /// [`Self::wound`] for the summary.
    fn wound_said(&self) -> Map<String, Value> {
        let Some(Ok(Value::Object(mut map))) = self.wound().map(serde_json::to_value) else {
            return Map::new();
        };
        let threads = map.get_mut("threads").and_then(Value::as_array_mut);
        let peaks_n = &self.past.peaks.tension_n;
        for (thread, peak) in threads.into_iter().flatten().zip(peaks_n) {
            thread["peak_tension_n"] = json!(peak);
        }
        let threads = map.get_mut("threads").and_then(Value::as_array_mut);
        let peaks_pa = self.past.events.peaks_pa();
        for (thread, peak) in threads.into_iter().flatten().zip(peaks_pa) {
            if peak > 0.0 {
                thread["peak_thread_pressure_pa"] = json!(peak);
            }
        }
        map
    }

    fn sample(&self, state: &Valid<State>) -> Option<ToolSample> {
        let body = state.body();
        Some(ToolSample {
            id: self.driven()?,
            position_m: body.position_m.map(f64::from),
            orientation: body.orientation.map(f64::from),
            velocity_m_per_s: body.velocity_m_per_s.map(f64::from),
            console_time_us: state.console_time_us(),
        })
    }

    /// Whether the driven tool was on tissue or another body in the last step, rather than at a thread, or withheld. Jaws hold
    /// tissue without any force until they draw at it.
    fn presses(&self, needle: Option<&HeldNeedle>) -> bool {
        if let Follower::Prescribed(tissue) = &self.follower {
            return tissue.touched();
        }
        !self.drives_jaws()
            && (self.pushes()
                || needle.is_some_and(|needle| matches!(needle.tip, Tip::Holding | Tip::Inside)))
    }

    /// Whether the driven tool is jaws.
    fn drives_jaws(&self) -> bool {
        let jaws = self.past.last.jaws();
        jaws.iter().any(|jaws| Some(jaws.tool) == self.driven())
    }

    /// Whether the last step's contact has rows and a force.
    fn pushes(&self) -> bool {
        let contact = self.past.last.contacts().first();
        contact.is_some_and(|contact| {
            let has_force = contact.wrench.iter().any(|along| along.abs() > NO_FORCE_N);
            contact.rows > 0 && has_force
        })
    }

    /// Whether the driven tool was in contact in the last step, also where the result is withheld. A slack thread has rows, and jaws
    /// close, without any force.
    fn touched(&self, needle: Option<&HeldNeedle>, thread: Option<&HeldThread>) -> bool {
        if let Follower::Prescribed(tissue) = &self.follower {
            return tissue.touched();
        }
        let report = &self.past.last;
        match report.status {
            Status::Ok | Status::Behind => {
                let contact = report.contacts().first();
                self.pushes()
                    || (self.drives_jaws() && contact.is_some_and(|contact| contact.rows > 0))
                    || needle.is_some_and(|needle| needle.tip != Tip::Outside)
                    || thread.is_some_and(|thread| thread.state != Tension::Slack)
            }
            Status::Waiting | Status::NotConverged | Status::TooManyRows | Status::Inside => true,
            Status::NotFinite | Status::UnknownTool => false,
        }
    }

    /// Hash of its state, to the bit; what that leaves out shows in a later step's.
    pub fn hash(&self) -> u64 {
        self.follower.hash()
    }

    /// From now on a thread computes what is newly touched while steps go on with what is there, if the solver has any use
    /// for one; without a thread steps compute it. What a step finds in contact is the same to the bit, but not when it
    /// finds it, nor from when on the tangent of a touch to come is there: for sessions in real time.
    pub fn start_worker(&mut self) {
        self.past.budget.measure();
        let Some(tissue) = self.follower.constrained() else {
            return;
        };
        if let Err(error) = tissue.work.start_worker(&tissue.model) {
            tracing::warn!("no thread for compliance columns, steps compute them: {error}");
        }
    }

    /// From now on it is written down when columns come from their thread, for [`Self::take_arrivals`].
    pub fn log_arrivals(&mut self) {
        if let Some(tissue) = self.follower.constrained() {
            tissue.work.log_arrivals();
        }
    }

    /// What has come from the thread since this was asked last.
    pub fn take_arrivals(&mut self) -> Vec<Arrival> {
        let tissue = self.follower.constrained();
        tissue.map_or_else(Vec::new, |tissue| tissue.work.take_arrivals())
    }

    /// As [`Self::start_worker`] without the thread: columns come in the steps in which [`Self::expect`] says that they
    /// came.
    pub fn replay_worker(&mut self) {
        self.past.budget.replay();
        if let Some(tissue) = self.follower.constrained() {
            tissue.work.replay_worker(&tissue.model);
        }
    }

    /// What comes in steps to come, and how far the next solve looks ahead.
    pub fn expect(&mut self, arrivals: &[Arrival], looked: Looked) {
        self.past.budget.expect(looked);
        // Rows that were given up change nothing in the tissue.
        self.effort = if looked.hurried {
            Effort::NoLooks
        } else {
            Effort::Full
        };
        if let Some(tissue) = self.follower.constrained() {
            tissue.work.expect(arrivals);
        }
    }

    /// From now on no long work is done beside the steps but columns: as it was when recordings did not say when a
    /// factor came.
    pub fn renew_in_step(&mut self) {
        if let Some(tissue) = self.follower.constrained() {
            tissue.work.renew_in_step();
        }
    }
}

/// Says where a hand has to go that has missed what it was to hold.
fn warn_of(missed: &Event) {
    if let Event::Missed {
        tool,
        what,
        distance_m,
        nearest_m: [x, y, z],
    } = missed
    {
        tracing::warn!(
            "tool {tool} was to take {}, {:.1} mm away: bring its grip to ({:.1}, {:.1}, {:.1}) mm",
            events::name(what),
            1e3 * distance_m,
            1e3 * x,
            1e3 * y,
            1e3 * z
        );
    }
}

/// Whether a console has let go between two states, by when they are: an armed one is not without contacts for so long. One that
/// has started anew may have an earlier time.
fn is_armed_anew(before_us: u64, sample: &ToolSample) -> bool {
    let passed_us = sample.console_time_us.checked_sub(before_us);
    passed_us.is_none_or(|passed_us| passed_us > u64::from(LOST_AFTER_US))
}

impl Solve for SceneSolver {
    fn act(&mut self, act: Act) -> bool {
        Self::act(self, act)
    }

    fn tune(&mut self, plan: &Plan) {
        // The console has them a period later, and uses them for another.
        self.reduce_to(plan.most_rows(), 2.0 / plan.host_hz);
        self.plan_every(1.0 / plan.host_hz);
        self.looks_ahead = plan.rendering == Rendering::Rows;
        if let Follower::Prescribed(tissue) = &mut self.follower {
            tissue.tune(plan.rendering, plan.host_hz);
        }
    }

    fn spare(&mut self, effort: Effort) -> Spared {
        self.effort = effort;
        self.options.most_rows = match effort {
            Effort::NoRows => 0,
            Effort::Full | Effort::NoLooks => self.most_rows,
        };
        let looks =
            self.has_needles || (self.looks_ahead && self.has_threads) || self.would_try_ahead();
        let looks = self.settles || self.would_seek_secant() || looks && self.follower.is_linear();
        Spared {
            looks: effort >= Effort::NoLooks && looks,
            rows: effort >= Effort::NoRows && self.most_rows > 0,
        }
    }

    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let Some(mut sample) = self.sample(state) else {
            // A scene without a tool is felt as free space, but nothing needs to be sent for that.
            return Solved {
                position_m: state.body().position_m,
                status: Status::UnknownTool,
                ..Solved::default()
            };
        };
        self.past.budget.begin(&self.past.last);
        self.past.budget.hurry(self.effort != Effort::Full);
        let mut stages = Stages::default();
        let mut clock = Clock::start();
        let before = self.past.last_sample.replace(sample);
        if let Some(before) = before.filter(|_| self.effort == Effort::Full) {
            self.come_closer(&before, &sample);
        }
        clock.lap(&mut stages.approach_ns);
        let before_us = before.map(|before| before.console_time_us);
        let period_us = before_us.map_or(0, |before| sample.console_time_us.saturating_sub(before));
        let mut goal = self.goal(state.body(), period_us);
        let tries = self.tries_ahead();
        if !tries {
            sample.position_m = goal.position_m.map(f64::from);
        }
        self.options.ahead_m = goal.ahead_m;
        // Only where a needle's way would be looked along.
        self.options.tip_reach_m = match self.has_needles && self.looks_ahead {
            true => ahead::tip_reach_m(&sample, period_us),
            false => 0.0,
        };
        let settles = self.settles && self.effort == Effort::Full;
        self.options.passes = settles.then(|| self.past.budget.passes(&self.past.last));
        let armed_anew = before_us.is_some_and(|before| is_armed_anew(before, &sample));
        let report = self.step_with(sample, armed_anew);
        let reached = self.reached(&report, &sample);
        let step_n = self.past.peaks.press(&report, reached.position_m);
        let (mut felt, mut rows) = (report.contacts().first().copied(), self.rows());
        clock.lap(&mut 0);
        self.past.budget.stepped(&report);
        if tries {
            match self.try_ahead(&goal) {
                Some(ahead) => (felt, rows) = (ahead.contacts().first().copied(), self.rows()),
                None => goal.position_m = state.body().position_m,
            }
        }
        if report.status == Status::Ok
            && let (Some(felt), Some(rows)) = (&mut felt, &mut rows)
            && let Some(times) = self.secant(&goal, felt, rows)
        {
            secant::stiffen(felt, rows, times);
        }
        let (mut needle, mut thread) = self.in_grip(&report, period_us);
        clock.lap(&mut stages.look_ns);
        let touched = self.touched(needle.as_ref(), thread.as_ref());
        let presses = touched && self.presses(needle.as_ref());
        let is_behind = report.status == Status::Behind;
        let misses = is_behind && !touched;
        let missed = misses
            && self
                .parts()
                .is_some_and(|(model, ..)| model.has_in_it(&sample));
        let mut outrun = false;
        if is_behind {
            goal.position_m = reached.position_m.map(|x| x as f32);
            let lag = Lag::between(&reached, &sample);
            let holds = needle.is_some() || thread.is_some();
            if let Some(contact) = felt.filter(|contact| lag.outruns(contact, holds)) {
                // Needle, thread and rows go on from where the tool is as well.
                (felt, rows) = (Some(without_course(&contact)), None);
                (needle, thread, outrun) = (None, None, true);
            }
        }
        Solved {
            position_m: goal.position_m,
            orientation: is_behind.then(|| reached.orientation.map(|x| x as f32)),
            lag_m: if is_behind { self.lag_m() } else { 0.0 },
            contact: felt,
            step_n,
            rows,
            touched,
            presses,
            outrun,
            missed,
            needle,
            thread,
            status: report.status,
            unfinished: self.follower.is_unfinished(),
            stages: Stages {
                approach_ns: stages.approach_ns,
                look_ns: stages.look_ns,
                ..report.stages
            },
            looked: self.past.budget.looked(),
            warms: report.fields > 0,
        }
    }

    fn warm(&self) {
        if let Some((model, state, work)) = self.parts() {
            work.warm(model, state);
        }
    }

    fn scene(&self) -> Map<String, Value> {
        let report = json!({
            "name": self.name,
            "tissue": self.tissue,
            "nodes": self.follower.nodes(),
        });
        let Value::Object(mut report) = report else {
            return Map::new();
        };
        report.extend(self.past.peaks.said(self.driven().is_some()));
        report.extend(self.follower.said(&self.past.peaks.last_good));
        report.extend(self.wound_said());
        if self.has_needles || self.has_jaws {
            let (events, more) = self.past.events.said();
            report.insert("events".to_owned(), events);
            if more > 0 {
                report.insert("more_events".to_owned(), more.into());
            }
        }
        report
    }
}
