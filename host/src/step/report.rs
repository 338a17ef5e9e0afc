//! What a step reports.
//!
//! Entry points: [`StepReport`], [`Status`].

use crate::event::Event;
use crate::jaws::JawsReport;
use crate::needle::{MAX_NEEDLES, NeedleReport};
use crate::renewal::Renewals;
use crate::thread::{HandReport, MOST_HANDS, ThreadReport};
use crate::tool::MAX_TOOLS;
use schemars::JsonSchema;

/// Most events of a step: of each thread a slip at either end, and a break; of all jaws that they lost what they held, and took hold.
const MAX_EVENTS: usize = 3 * MAX_NEEDLES + 2 * MAX_TOOLS;

/// How a step ended. Without a balance ([`Status::has_balance`]) nothing is sent: the console's data ages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, JsonSchema)]
#[schemars(rename_all = "kebab-case")]
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
    /// The tools moved farther than one step follows. What is reported is the balance where they are by then
    /// ([`super::State::reached`]); the next step goes on from there.
    Behind,
    /// No stable balance found: about a radius deep, where symmetry leaves open to which side the tissue
    /// slips around a sphere, or two tools that press one vertex the same way. The state stays at the last
    /// pose that had a balance.
    NotConverged,
    /// More vertices touched than a step has room for; as `NotConverged`.
    TooManyRows,
    /// A tool has slipped into the tissue: that has closed over it, pulls it in or pushes it out less the deeper it goes. Or no way
    /// in from outside is found for one that appears inside. The tissue is as before, the tool begins anew once it is outside, on a side
    /// where it can have come from: nodes that are held are a wall.
    Inside,
}

impl Status {
    /// Whether a balance was found: at the sampled poses, or as far on the way there as a step goes.
    pub fn has_balance(self) -> bool {
        matches!(self, Self::Ok | Self::Behind)
    }

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
    /// Rate at which the force fades at a held pose \[1/s\].
    pub relaxation_per_s: f64,
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
    /// Rotations, internal forces and factorisation of corotational tissue; taking over a renewed factor.
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
    /// Until a renewed factor was there, and taking it over: steps that are the same on every machine wait for it, others where the one that they
    /// have is of no help any more.
    pub wait_ns: u64,
}

impl Stages {
    /// The stages' names and times \[ns\], in the order in which a step passes them, and last what it waits.
    pub fn named(&self) -> [(&'static str, u64); 9] {
        [
            ("approach", self.approach_ns),
            ("tissue", self.tissue_ns),
            ("detect", self.detect_ns),
            ("columns", self.columns_ns),
            ("solve", self.solve_ns),
            ("field", self.field_ns),
            ("reduce", self.reduce_ns),
            ("look", self.look_ns),
            ("wait", self.wait_ns),
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
    hands: [HandReport; MOST_HANDS],
    hand_count: usize,
    jaws: [JawsReport; MAX_TOOLS],
    jaws_count: usize,
    events: [Option<Event>; MAX_EVENTS],
    /// Pairs of features of touching tissues that press against each other.
    pub touching: u32,
    /// Dissipated by the friction of tools so far \[J\].
    pub friction_j: f64,
}

impl StepReport {
    /// One per needle, in the model's order; empty without a balance.
    pub fn needles(&self) -> &[NeedleReport] {
        &self.needles[..self.needle_count]
    }

    pub(crate) fn needles_mut(&mut self, count: usize) -> &mut [NeedleReport] {
        self.needle_count = count.min(MAX_NEEDLES);
        &mut self.needles[..self.needle_count]
    }

    /// One per thread, in the model's order; empty without a balance.
    pub fn threads(&self) -> &[ThreadReport] {
        &self.threads[..self.thread_count]
    }

    pub(crate) fn threads_mut(&mut self, count: usize) -> &mut [ThreadReport] {
        self.thread_count = count.min(MAX_NEEDLES);
        &mut self.threads[..self.thread_count]
    }

    /// What holds threads between their ends, thread by thread in the model's order, each from the tail on; empty without a
    /// balance.
    pub fn hands(&self) -> &[HandReport] {
        &self.hands[..self.hand_count]
    }

    /// Adds a hand between the ends of a thread; there is room for as many as there may be.
    pub(crate) fn held(&mut self, hand: HandReport) {
        if let Some(free) = self.hands.get_mut(self.hand_count) {
            *free = hand;
            self.hand_count += 1;
        }
    }

    /// Largest tension at an end of a thread or a hand on it \[N\]; 0 for one that is not there.
    pub fn most_tension_n(&self, thread: u8) -> f64 {
        let threads = self.threads().iter().filter(|each| each.id == thread);
        let hands = self.hands().iter().filter(|each| each.thread == thread);
        let ends = threads.flat_map(|each| each.tension_n);
        ends.chain(hands.flat_map(|each| each.tension_n))
            .fold(0.0, f64::max)
    }

    /// One per pair of jaws, in the model's order; empty without a balance.
    pub fn jaws(&self) -> &[JawsReport] {
        &self.jaws[..self.jaws_count]
    }

    pub(crate) fn jaws_mut(&mut self, count: usize) -> &mut [JawsReport] {
        self.jaws_count = count.min(MAX_TOOLS);
        &mut self.jaws[..self.jaws_count]
    }

    /// What has happened since the last step that found a balance, thread by thread; none unless this one has.
    pub fn events(&self) -> impl Iterator<Item = Event> {
        self.events.into_iter().flatten()
    }

    /// Adds an event; one that finds no room is left out.
    pub(crate) fn happened(&mut self, event: Event) {
        if let Some(free) = self.events.iter_mut().find(|event| event.is_none()) {
            *free = Some(event);
        }
    }

    pub(crate) fn contacts_mut(&mut self, count: usize) -> &mut [ToolContact] {
        self.tools = count.min(MAX_TOOLS);
        &mut self.contacts[..self.tools]
    }

    /// One per sample, in the samples' order; empty without a balance.
    pub fn contacts(&self) -> &[ToolContact] {
        &self.contacts[..self.tools]
    }
}
