//! One step of the solver, and what it reports.
//!
//! Entry point: [`step`]. Three lifetimes: [`Model`] is constant, [`State`] evolves and can be kept
//! and compared, [`Workspace`] is scratch and a cache that could be dropped between any two steps.

mod tool_rows;

use crate::anchors::{Grasp, System};
use crate::body::{Body, Motion};
use crate::clock::Clock;
pub use crate::columns::Arrival;
use crate::columns::Columns;
use crate::hash::hash_of;
use crate::model::Model;
use crate::needle::{self, MAX_NEEDLES, NeedleReport, NeedlesState, NeedlesWork};
pub use crate::renewal::{Renewals, Rule};
use crate::source::tool::Placements;
use crate::thread::{Bridge, ThreadEnd, ThreadHold, ThreadPoint, ThreadReport, Tightening};
use crate::tool::{MAX_TOOLS, ToolSample};
use nalgebra::Vector3;
use serde::Serialize;
pub use tool_rows::{MAX_TOOL_ROWS, ToolRowKind, ToolRows};

/// How a step ended. Anything but `Ok` means: send nothing, let the console's data age.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Status {
    /// Balance found at the sampled poses.
    #[default]
    Ok,
    /// A pose is not finite, or a quaternion has no length. The state is as before.
    NotFinite,
    /// A sample's id is not in the model, or is there twice. The state is as before.
    UnknownTool,
    /// Columns of the compliance are still missing for newly touched vertices; the next step goes on.
    Waiting,
    /// The tool moved farther than one step follows; the next step goes on from where this one ended.
    Behind,
    /// No stable balance found: about a radius deep, where symmetry leaves open to which side the tissue
    /// slips around a sphere, or two tools that press one vertex the same way. The state stays at the last
    /// pose that had a balance.
    NotConverged,
    /// More vertices touched than a step has room for; as `NotConverged`.
    TooManyRows,
    /// A tool has slipped into the tissue between its vertices, or no way in from outside is found for one that appears inside.
    Inside,
}

impl Status {
    /// As reports print it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::NotFinite => "not-finite",
            Self::UnknownTool => "unknown-tool",
            Self::Waiting => "waiting",
            Self::Behind => "behind",
            Self::NotConverged => "not-converged",
            Self::TooManyRows => "too-many-rows",
            Self::Inside => "inside",
        }
    }
}

/// One tool's contact, ready for the console.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ToolContact {
    /// Which tool.
    pub id: u8,
    /// Wrench on the tool: force \[N\], then moment about the grip \[N m\], (6), world frame.
    pub wrench: [f64; 6],
    /// d wrench / d pose for left (world-frame) increments, (6 x 6) by rows \[N/m, N, N m/rad\]. Its skew
    /// part is -1/2 \[moment\]x in the rotations. Apart: as it will be just after touching, zero while
    /// that is too far to matter.
    pub tangent: [[f64; 6]; 6],
    /// Distance along `normal` to the nearest vertex \[m\]; 0 in contact.
    pub gap_m: f64,
    /// Unit vector out of the tissue, (3).
    pub normal: [f64; 3],
    /// Vertices that it touches.
    pub rows: u32,
}

impl ToolContact {
    /// Of a tool that touches nothing, and is near nothing.
    pub(crate) fn nowhere(id: u8) -> Self {
        Self {
            id,
            gap_m: f64::MAX,
            normal: [0.0, 0.0, 1.0],
            ..Self::default()
        }
    }
}

/// Time spent in each stage \[ns\].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Stages {
    /// Rotations, internal forces and factorisation of corotational tissue; taking over a renewed factor, and
    /// waiting for it.
    pub tissue_ns: u64,
    /// Where the boundary is and which vertices are near a tool.
    pub detect_ns: u64,
    /// New columns of the compliance.
    pub columns_ns: u64,
    /// Active set and Newton.
    pub solve_ns: u64,
    /// Displacement of all nodes, where tissues may touch or threads bend.
    pub field_ns: u64,
    /// Wrenches and tangents.
    pub reduce_ns: u64,
    /// Steps between two samples that are far apart, all their stages together; by a session's solver.
    pub approach_ns: u64,
    /// Steps ahead on a copy of the state, all their stages together; by a session's solver.
    pub look_ns: u64,
}

impl Stages {
    /// The stages' names and times \[ns\], in the order in which a step passes them.
    pub fn named(&self) -> [(&'static str, u64); 8] {
        [
            ("approach", self.approach_ns),
            ("tissue", self.tissue_ns),
            ("detect", self.detect_ns),
            ("columns", self.columns_ns),
            ("solve", self.solve_ns),
            ("field", self.field_ns),
            ("reduce", self.reduce_ns),
            ("look", self.look_ns),
        ]
    }
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct StepReport {
    /// How it ended.
    pub status: Status,
    contacts: [ToolContact; MAX_TOOLS],
    tools: usize,
    /// Touches: one for every vertex and tool.
    pub rows: u32,
    /// Newton iterations, all sub-steps together.
    pub iterations: u32,
    /// Solves of the rows in a scene with needles, all sub-steps together.
    pub solves: u32,
    /// Pieces into which the tools' path was cut.
    pub substeps: u32,
    /// Solves for the displacement of all nodes, all sub-steps together.
    pub fields: u32,
    /// Columns of the compliance computed, three per vertex.
    pub columns_computed: u32,
    /// Largest of gap over radius and of tangential force over largest force.
    pub residual: f64,
    /// Passes over corotational tissue; 0 for linear tissue, which is solved exactly.
    pub passes: u32,
    /// Out-of-balance force of corotational tissue over the forces on it, when it was looked at last:
    /// before the last pass, or after it if that was enough. 0 for linear tissue.
    pub imbalance: f64,
    /// Estimate of the tangents' relative error. 0 for linear tissue.
    pub tangent_error: f64,
    /// Times the stiffness was factored in the step.
    pub refactorisations: u32,
    /// Factors made beside the steps.
    pub renewals: Renewals,
    /// Elastic energy that the tools have put into the tissue \[J\].
    pub stored_energy_j: f64,
    /// Time per stage.
    pub stages: Stages,
    needles: [NeedleReport; MAX_NEEDLES],
    needle_count: usize,
    threads: [ThreadReport; MAX_NEEDLES],
    thread_count: usize,
    /// Pairs of features of touching tissues that press against each other.
    pub touching: u32,
    /// Dissipated by the friction of tools so far \[J\].
    pub friction_j: f64,
}

impl StepReport {
    /// One per needle, in the model's order; empty unless the status is `Ok`.
    pub fn needles(&self) -> &[NeedleReport] {
        &self.needles[..self.needle_count]
    }

    pub(crate) fn needles_mut(&mut self, count: usize) -> &mut [NeedleReport] {
        self.needle_count = count.min(MAX_NEEDLES);
        &mut self.needles[..self.needle_count]
    }

    /// One per thread, in the model's order; empty unless the status is `Ok`.
    pub fn threads(&self) -> &[ThreadReport] {
        &self.threads[..self.thread_count]
    }

    pub(crate) fn threads_mut(&mut self, count: usize) -> &mut [ThreadReport] {
        self.thread_count = count.min(MAX_NEEDLES);
        &mut self.threads[..self.thread_count]
    }

    pub(crate) fn contacts_mut(&mut self, count: usize) -> &mut [ToolContact] {
        self.tools = count.min(MAX_TOOLS);
        &mut self.contacts[..self.tools]
    }

    /// One per sample, in the samples' order; empty unless the status is `Ok`.
    pub fn contacts(&self) -> &[ToolContact] {
        &self.contacts[..self.tools]
    }
}

/// What evolves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// What evolves in the tissue itself, if nothing acts on it but loads and handles.
    motion: Motion,
    needles: Option<Box<NeedlesState>>,
}

impl State {
    /// Hash of everything that it holds, to the bit.
    pub fn hash(&self) -> u64 {
        hash_of(self)
    }

    /// No tool anywhere yet, tissue at rest under its loads.
    pub fn new(model: &Model) -> Self {
        Self {
            motion: model.motion.clone(),
            needles: model
                .needles
                .as_ref()
                .map(|needles| Box::new(NeedlesState::new(needles, model.motion.clone()))),
        }
    }

    /// Rows of needles, threads, handles and tissues that touch, and their forces.
    pub(crate) fn grasp(&self) -> Option<&Grasp> {
        self.needles.as_ref().map(|needles| &needles.grasp)
    }

    pub(crate) fn motion(&self) -> &Motion {
        let needles = self.needles.as_ref();
        needles.map_or(&self.motion, |needles| needles.grasp.motion())
    }

    /// Has a tool take a needle where it is, with the tool at `sample`; or nobody. Nothing moves and no force
    /// changes by that; a needle that nobody holds goes where the tissue takes it in later steps. Says
    /// whether there are such a needle and tool, and the sample is a pose.
    pub fn hold(&mut self, model: &Model, needle: u8, sample: Option<&ToolSample>) -> bool {
        let (Some(needles), Some(state)) = (&model.needles, &mut self.needles) else {
            return false;
        };
        let index = needles.parts.iter().position(|part| part.id == needle);
        let Some(each) = index.and_then(|index| state.each.get_mut(index)) else {
            return false;
        };
        let Some(sample) = sample else {
            each.grip = None;
            return true;
        };
        match needle::pose_of(sample).filter(|_| model.tool(sample.id).is_some()) {
            Some(pose) => {
                each.grip = Some(needle::grip(sample.id, &pose, &each.pose));
                true
            }
            None => false,
        }
    }

    /// Puts the needles that a tool holds to where they are with it at `sample`, without the way there: for a tool that was
    /// moved while nobody looked. One that is then in tissue is in no hole and touches nothing until all of it has been
    /// outside once ([`needle::TipPlace::Waiting`]). One that was in tissue before stays in its holes, and follows in the next
    /// step as always. Says how many were put.
    pub fn put(&mut self, sample: &ToolSample) -> usize {
        let Some(pose) = needle::pose_of(sample) else {
            return 0;
        };
        let needles = self
            .needles
            .iter_mut()
            .flat_map(|needles| &mut needles.each);
        let mut put = 0;
        for each in needles {
            let grip = each.grip.filter(|grip| grip.tool == sample.id);
            put += usize::from(grip.is_some_and(|grip| each.put(pose * grip.needle)));
        }
        put
    }

    /// Where a needle is: its frame, as [`crate::needle::NeedleShape`] has it.
    pub fn needle_pose(&self, model: &Model, needle: u8) -> Option<nalgebra::Isometry3<f64>> {
        let parts = &model.needles.as_ref()?.parts;
        let index = parts.iter().position(|part| part.id == needle)?;
        Some(self.needles.as_ref()?.each.get(index)?.pose)
    }

    /// The faces that a needle goes through, from its end to its tip.
    pub fn crossings(&self, model: &Model, needle: u8) -> &[needle::Crossing] {
        let history = self.needle_history(model, needle);
        history.map_or(&[], needle::History::crossings)
    }

    /// The way of a needle through the mesh.
    pub fn needle_history(&self, model: &Model, needle: u8) -> Option<&needle::History> {
        let parts = &model.needles.as_ref()?.parts;
        let index = parts.iter().position(|part| part.id == needle)?;
        Some(&self.needles.as_ref()?.each.get(index)?.history)
    }

    /// Has an end of a thread held by something else from now on, where it is. Says whether there is such a thread
    /// and such a tool among `samples`.
    pub fn hold_thread(
        &mut self,
        model: &Model,
        thread: u8,
        end: ThreadEnd,
        hold: ThreadHold,
        samples: &[ToolSample],
    ) -> bool {
        let nodes_m = self.positions(model);
        let (Some(needles), Some(state)) = (&model.needles, &mut self.needles) else {
            return false;
        };
        let Some(thread) = model.thread(thread) else {
            return false;
        };
        let tool = |id: u8| samples.iter().find(|sample| sample.id == id);
        let at = match hold {
            ThreadHold::Free | ThreadHold::Knot => None,
            ThreadHold::Place(at) => Some(at),
            ThreadHold::Tool(id) => match tool(id) {
                Some(sample) => Some(sample.position_m),
                None => return false,
            },
        };
        let is_sound = at.is_none_or(|at| at.iter().all(|x| x.is_finite()));
        is_sound && state.hold_thread(needles, &nodes_m, thread, end, hold, at)
    }

    /// Bounds every span of a thread that bridges two bodies of tissue (every one between punctures, if there is only one
    /// body) to a part of its length in the unloaded mesh (younes-2021, 3.37), whatever its ends do; `None` gives them
    /// free again. Says whether there is such a thread and the numbers make sense.
    pub fn tighten(&mut self, model: &Model, thread: u8, to: Option<Tightening>) -> bool {
        let index = model.thread(thread);
        let each = self.needles.as_mut().zip(index);
        let each = each.and_then(|(state, index)| state.threads.get_mut(index));
        let is_sound = to.is_none_or(|to| to.is_sound());
        match each.filter(|_| is_sound) {
            Some(each) => {
                each.tightened = to;
                true
            }
            None => false,
        }
    }

    /// The path of a thread, from tail to head; for viewers and files.
    pub fn thread_path(&self, model: &Model, thread: u8) -> Vec<ThreadPoint> {
        let index = model.thread(thread);
        let found = self.needles.as_ref().zip(model.needles.as_ref()).zip(index);
        found.map_or_else(Vec::new, |((state, needles), index)| {
            state.thread_path(needles, &self.positions(model), index)
        })
    }

    /// What a thread closes, or not: its spans between two bodies of tissue.
    pub fn bridges(&self, model: &Model, thread: u8) -> Vec<Bridge> {
        let index = model.thread(thread);
        let found = self.needles.as_ref().zip(model.needles.as_ref()).zip(index);
        found.map_or_else(Vec::new, |((state, needles), index)| {
            state.bridges(needles, model, &self.positions(model), index)
        })
    }

    /// Where all nodes are \[m\], (n x 3): allocates, for files and viewers.
    pub fn positions(&self, model: &Model) -> Vec<[f64; 3]> {
        let moved = model.equilibrium(self).map(|found| found.displacement_m);
        let moved = moved.unwrap_or_else(|_| vec![[0.0; 3]; model.points_m().len()]);
        let nodes = model.points_m().iter().zip(&moved);
        nodes
            .map(|(x, u)| [x[0] + u[0], x[1] + u[1], x[2] + u[2]])
            .collect()
    }

    /// What rubs at each of [`State::crossings`], in their order.
    pub fn rubbing(&self, model: &Model, needle: u8) -> impl Iterator<Item = needle::Rubbing> {
        let found = || {
            let parts = &model.needles.as_ref()?.parts;
            let index = parts.iter().position(|part| part.id == needle)?;
            let curve = |each: &needle::NeedleState| parts[index].needle.at(&each.pose);
            let each = self.needles.as_ref()?.each.get(index)?;
            Some((each, curve(each)))
        };
        found()
            .into_iter()
            .flat_map(|(each, curve)| each.rubbing(curve))
    }

    /// Nodes that are touched and the force on the tissue there \[N\]; a node touched by two tools comes
    /// twice.
    pub fn contact_forces(&self, model: &Model) -> impl Iterator<Item = (u32, [f64; 3])> {
        let found = self.needles.iter().zip(&model.needles);
        found.flat_map(|(state, needles)| {
            let pushes = state.grasp.pushes();
            let pushes = pushes.filter(|(_, force)| *force != Vector3::zeros());
            pushes
                .filter_map(|(vertex, force)| Some((model.node_of(needles, vertex)?, force.into())))
        })
    }
}

/// Memory for columns if nothing else is said \[bytes\].
pub(crate) const DEFAULT_CACHE_BYTES: usize = 512 << 20;

/// Scratch and the cache of compliance columns.
pub struct Workspace {
    needles: Option<Box<NeedlesWork>>,
    /// Vertices whose columns one step may compute before it says [`Status::Waiting`].
    pub vertices_per_step: usize,
    /// To how many rows at most steps reduce each tool's contact, for [`Workspace::rows`]; 0: they do not. More than
    /// [`MAX_TOOL_ROWS`] are never given.
    pub most_rows: usize,
    /// Whether these rows are not made after all, for want of time. Nothing else of a step is another for that.
    pub spares_rows: bool,
    /// Way that a tool may go from the step's pose while its rows are in use \[m\], (3): those that would switch on it are
    /// chosen first.
    pub ahead_m: [f64; 3],
    /// Way in any direction that it may go besides \[m\]: what is so near is said while the tool is apart, and its columns
    /// are asked for.
    pub reach_m: f64,
}

impl Workspace {
    /// Empty cache; all other buffers at their largest size.
    pub fn new(model: &Model) -> Self {
        Self {
            needles: model
                .needles
                .as_ref()
                .map(|needles| Box::new(NeedlesWork::new(model, needles))),
            vertices_per_step: model
                .needles
                .as_ref()
                .map_or(0, |needles| needles.settings.vertices_per_step),
            most_rows: 0,
            spares_rows: false,
            ahead_m: [0.0; 3],
            reach_m: 0.0,
        }
    }

    /// From now on a thread of its own computes columns, ahead of the tools where it can; a step that
    /// needs one that is not there says [`Status::Waiting`]. The bits of what a step finds in contact are the
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

    /// What finds forces on the tissue, and the nodes that it reaches; nothing if nothing touches it.
    fn system(&mut self, model: &Model) -> Option<(&mut System, Vec<u32>)> {
        let reached = model.reached(model.needles.as_ref()?);
        let needles = self.needles.as_mut()?;
        Some((&mut needles.drive.system, reached))
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
        let needles = self.needles.as_mut()?;
        Some(needles.drive.system.columns_mut())
    }

    /// Computes the columns of all nodes that can be acted on whose resting position \[m\] satisfies `near`, so
    /// that touching them later costs nothing. Returns how many are there now.
    pub fn prepare(&mut self, model: &Model, near: impl Fn([f64; 3]) -> bool) -> usize {
        match (&mut self.needles, &model.needles) {
            (Some(work), Some(needles)) => work.prepare(model, needles, near),
            _ => 0,
        }
    }

    /// The rows of a tool at the last step's balance, if [`Workspace::most_rows`] asked for any.
    pub fn rows(&self, tool: u8) -> Option<&ToolRows> {
        let rows = self.needles.iter().flat_map(|needles| &needles.rows);
        rows.into_iter().find(|rows| rows.tool == tool)
    }

    /// Memory held by the cache \[bytes\].
    pub fn cache_bytes(&self) -> usize {
        let needles = self.needles.as_ref();
        needles.map_or(0, |needles| needles.drive.system.columns().bytes())
    }
}

/// Follows the tools from where they were to where `samples` says, balances the tissue, and reduces
/// the balance to one contact per sample. A tool that is not sampled is lifted off.
///
/// Deterministic for one binary and one SIMD level. Allocates only for new columns.
pub fn step(
    model: &Model,
    state: &mut State,
    samples: &[ToolSample],
    work: &mut Workspace,
) -> StepReport {
    let mut report = StepReport::default();
    let mut clock = Clock::start();
    let targets = match read_samples(model, samples) {
        Ok(targets) => targets,
        Err(status) => return StepReport { status, ..report },
    };
    let (Some(needles), Some(needles_state), Some(needles_work)) =
        (&model.needles, &mut state.needles, &mut work.needles)
    else {
        for (contact, sample) in report.contacts_mut(samples.len()).iter_mut().zip(samples) {
            *contact = ToolContact::nowhere(sample.id);
        }
        return report;
    };
    let wanted = needle::Wanted {
        most_rows: if work.spares_rows { 0 } else { work.most_rows },
        ahead_m: Vector3::from(work.ahead_m),
        reach_m: work.reach_m,
    };
    needles_work.drive.system.set_budget(work.vertices_per_step);
    report.status = needle::step(
        model,
        needles,
        needles_state,
        (samples, &targets),
        &wanted,
        needles_work,
        &mut report,
        &mut clock,
    );
    report
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
