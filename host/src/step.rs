//! One step of the solver, and what it reports.
//!
//! Entry point: [`step`]. Three lifetimes: [`Model`] is constant, [`State`] evolves and can be kept
//! and compared, [`Workspace`] is scratch and a cache that could be dropped between any two steps.

use crate::model::Model;
use crate::tool::{MAX_TOOLS, ToolSample};
use nalgebra::Vector3;

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
    /// No balance within the iterations allowed; the state stays at the last pose that had one.
    NotConverged,
    /// More vertices touched than a step has room for; as `NotConverged`.
    TooManyRows,
    /// A tool's centre is inside the tissue and did not come in through the surface.
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
    /// part is -1/2 \[moment\]x in the rotations. Apart: as it will be just after touching.
    pub tangent: [[f64; 6]; 6],
    /// Distance along `normal` to the nearest vertex \[m\]; 0 in contact.
    pub gap_m: f64,
    /// Unit vector out of the tissue, (3).
    pub normal: [f64; 3],
    /// Touched vertices.
    pub rows: u32,
}

/// Time spent in each stage \[ns\].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Stages {
    /// Where the boundary is and which vertices are near a tool.
    pub detect_ns: u64,
    /// New columns of the compliance.
    pub columns_ns: u64,
    /// Active set and Newton.
    pub solve_ns: u64,
    /// Wrenches and tangents.
    pub reduce_ns: u64,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct StepReport {
    /// How it ended.
    pub status: Status,
    contacts: [ToolContact; MAX_TOOLS],
    tools: usize,
    /// Touched vertices of all tools.
    pub rows: u32,
    /// Newton iterations, all sub-steps together.
    pub iterations: u32,
    /// Pieces into which the tools' path was cut.
    pub substeps: u32,
    /// Columns of the compliance computed, three per vertex.
    pub columns_computed: u32,
    /// Largest of gap over radius and of tangential force over largest force.
    pub residual: f64,
    /// Elastic energy that the tools have put into the tissue \[J\].
    pub stored_energy_j: f64,
    /// Time per stage.
    pub stages: Stages,
}

impl StepReport {
    /// One per sample, in the samples' order; empty unless the status is `Ok`.
    pub fn contacts(&self) -> &[ToolContact] {
        &self.contacts[..self.tools]
    }
}

/// What evolves: where the tools are and which vertices they push how.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub(crate) centres: [Option<Vector3<f64>>; MAX_TOOLS],
}

impl State {
    /// No tool anywhere yet, tissue at rest under its loads.
    pub fn new(_model: &Model) -> Self {
        Self { centres: [None; MAX_TOOLS] }
    }

    /// Nodes that are touched and the force on the tissue there \[N\].
    pub fn contact_forces(&self, _model: &Model) -> impl Iterator<Item = (u32, [f64; 3])> {
        std::iter::empty()
    }
}

/// Scratch and the cache of compliance columns.
pub struct Workspace {}

impl Workspace {
    /// Empty cache; all buffers at their largest size.
    pub fn new(_model: &Model) -> Self {
        Self {}
    }

    /// Computes the columns of all boundary vertices whose resting position satisfies `near`, so that
    /// touching them later costs nothing. Returns how many vertices that were.
    pub fn prepare(&mut self, _model: &Model, _near: impl Fn([f64; 3]) -> bool) -> usize {
        0
    }

    /// Memory held by the cache \[bytes\].
    pub fn cache_bytes(&self) -> usize {
        0
    }
}

/// Follows the tools from where they were to where `tools` says, and balances the tissue.
pub fn step(
    _model: &Model,
    _state: &mut State,
    _tools: &[ToolSample],
    _work: &mut Workspace,
) -> StepReport {
    StepReport { status: Status::NotConverged, ..Default::default() }
}
