//! One step of rows on anchors: columns, compliance, forces, field.
//!
//! Entry points: [`AnchorSolver::new`], [`AnchorSolver::step`].

use super::system::{ConstraintState, ConstraintSystem, is_solved};
use super::{AnchorPoint, PointConstraint};
use crate::body::Body;
use crate::clock::Clock;
use crate::fem::{
    CorotationalTissue, Factored, HyperelasticTissue, LinearTissue, Linearisation, Moved,
    SolveScratch, TissueError,
};
use crate::renewal::{Renewals, Rule};
use crate::rows::{self, Method};
use std::sync::Arc;

/// What a solver may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorSettings {
    /// Most rows of a step.
    pub most_rows: usize,
    /// Most anchors of a step.
    pub most_anchors: usize,
    /// Most rows of a step that lie on several anchors.
    pub most_spread: usize,
    /// Most terms of all these rows together.
    pub most_terms: usize,
    /// Vertices whose columns one step may compute.
    pub vertices_per_step: usize,
    /// Most passes over corotational or hyperelastic tissue in one step; linear tissue needs one.
    pub passes: u32,
    /// Passes end when the out-of-balance force has fallen below this share of the forces.
    pub tolerance: f64,
    /// Memory for columns \[bytes\]; what `most_anchors` need is always allowed.
    pub memory_bytes: usize,
    /// How the rows are solved.
    pub method: Method,
}

impl Default for AnchorSettings {
    /// 50 punctures; 512 MB, which is every column of some 3,000 boundary vertices.
    fn default() -> Self {
        Self {
            most_rows: 150,
            most_anchors: 50,
            most_spread: 0,
            most_terms: 0,
            vertices_per_step: 8,
            passes: 1,
            tolerance: 1e-3,
            memory_bytes: 512 << 20,
            method: Method::ActiveSet,
        }
    }
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum AnchorStatus {
    /// Forces found; see the rows' outcome for redundant or incompatible rows.
    #[default]
    Ok,
    /// Columns are still missing: the last forces stay.
    Waiting,
    /// Rows out of the order of their anchors, an anchor or node that does not exist or cannot be
    /// reached, or more of them than the settings allow. The last forces stay.
    Malformed,
    /// The rows' solve failed; its outcome says how. Or cells of hyperelastic tissue let it go no more than a part of its
    /// way in the last pass, and none is inverted.
    NotSolved,
}

/// Time spent in each stage \[ns\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AnchorStages {
    /// Rotations, internal forces, refactorisation; taking over a renewed factor, and waiting for it. Nothing for
    /// linear tissue.
    pub tissue_ns: u64,
    /// New columns.
    pub columns_ns: u64,
    /// Compliance between anchors.
    pub assemble_ns: u64,
    /// Rows.
    pub solve_ns: u64,
    /// Displacement of all nodes.
    pub field_ns: u64,
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnchorStep {
    /// How it ended.
    pub status: AnchorStatus,
    /// What came of the rows; `None` if they were not solved.
    pub outcome: Option<rows::Outcome>,
    /// Vertices whose columns were computed in this step.
    pub vertices_computed: u32,
    /// Passes over corotational or hyperelastic tissue.
    pub passes: u32,
    /// The last linearisation of corotational or hyperelastic tissue.
    pub linearisation: Option<Linearisation>,
    /// Factors made beside the steps.
    pub renewals: Renewals,
    /// Time per stage.
    pub stages: AnchorStages,
}

/// Tissue held by rows on anchors.
pub struct AnchorSolver {
    body: Body,
    grasp: ConstraintState,
    system: ConstraintSystem,
    /// Free nodes that anchors may name, in the columns' order, (b).
    reached: Vec<u32>,
    u: Vec<f64>,
    field: SolveScratch,
}

impl AnchorSolver {
    /// Linear tissue at rest, whose free nodes `reached` anchors may name: the boundary's, or all.
    ///
    /// # Errors
    /// A node in `reached` that does not exist or is fixed.
    pub fn linear(
        tissue: Arc<LinearTissue>,
        reached: &[u32],
        settings: AnchorSettings,
    ) -> Result<Self, TissueError> {
        let resting = vec![0.0; tissue.unknowns()];
        Self::new(Body::Linear { tissue, resting }, reached, settings)
    }

    /// As [`Self::linear`], for corotational tissue.
    ///
    /// # Errors
    /// As [`Self::linear`]; no memory.
    pub fn corotational(
        tissue: Arc<CorotationalTissue>,
        reached: &[u32],
        settings: AnchorSettings,
    ) -> Result<Self, TissueError> {
        let loads = vec![0.0; tissue.unknowns()];
        Self::new(Body::Corotational { tissue, loads }, reached, settings)
    }

    /// As [`Self::linear`], for hyperelastic tissue.
    ///
    /// # Errors
    /// As [`Self::linear`]; no memory.
    pub fn hyperelastic(
        tissue: Arc<HyperelasticTissue>,
        reached: &[u32],
        settings: AnchorSettings,
    ) -> Result<Self, TissueError> {
        let loads = vec![0.0; tissue.unknowns()];
        Self::new(Body::Hyperelastic { tissue, loads }, reached, settings)
    }

    fn new(body: Body, reached: &[u32], settings: AnchorSettings) -> Result<Self, TissueError> {
        let grasp = ConstraintState::new(body.at_rest(), &settings);
        let system = ConstraintSystem::new(&body, grasp.motion(), reached, settings)?;
        let unknowns = body.numbering().unknowns();
        Ok(Self {
            reached: reached.to_vec(),
            u: vec![0.0; unknowns],
            field: body.view(grasp.motion()).factor().scratch(),
            grasp,
            system,
            body,
        })
    }

    /// From now on a thread of its own works while steps go on. For linear tissue it computes columns: a step that
    /// needs one that is not there waits. For corotational tissue it renews the factor and the columns in use, which
    /// the first step that finds them there takes over; steps compute new columns of the factor that they have.
    ///
    /// # Errors
    /// What the system says when it has no thread to give.
    pub fn start_worker(&mut self) -> std::io::Result<()> {
        match &self.body {
            Body::Linear { tissue, .. } => {
                self.system.start_worker(tissue.clone(), &self.reached)?;
            }
            Body::Corotational { .. } | Body::Hyperelastic { .. } => {
                let rule = Rule::WhenThere;
                self.system.renew_beside(&self.body, &self.reached, rule);
            }
        }
        Ok(())
    }

    /// From now on factors of corotational tissue are renewed beside the steps and taken over by `rule`, unless its
    /// policy wants them fresh; nothing happens for linear tissue.
    pub fn renew_beside(&mut self, rule: Rule) {
        self.system.renew_beside(&self.body, &self.reached, rule);
    }

    /// Has the worker compute the columns of a node that anchors will soon name.
    pub fn prefetch(&mut self, node: u32) {
        self.system.prefetch(node);
    }

    /// Finds the forces of `rows`, which are in the order of their `anchors`; with `field` the
    /// displacement of all nodes, too. Allocates only while columns are new and memory is below its limit.
    pub fn step(
        &mut self,
        anchors: &[AnchorPoint],
        rows: &[PointConstraint],
        field: bool,
    ) -> AnchorStep {
        let mut report = AnchorStep::default();
        let mut clock = Clock::start();
        let Self {
            body,
            grasp,
            system,
            ..
        } = self;
        if !system.read(body, anchors, &[], rows) {
            report.status = AnchorStatus::Malformed;
            return report;
        }
        system.begin_step();
        report.renewals = system.take_over(body, grasp);
        clock.lap(&mut report.stages.tissue_ns);
        let settings = *system.settings();
        loop {
            let balance = system.look(body, grasp);
            let balanced = balance.is_some_and(|balance| {
                report.passes > 0 && balance.imbalance <= settings.tolerance
            });
            if balanced {
                break;
            }
            let linearisation = system.linearise(body, grasp);
            report.linearisation = linearisation.or(report.linearisation);
            report.renewals.asked += u32::from(linearisation.is_some_and(|l| l.asked));
            clock.lap(&mut report.stages.tissue_ns);
            let budget = settings
                .vertices_per_step
                .saturating_sub(report.vertices_computed as usize);
            let fetched = system.fetch(body, grasp, budget);
            report.vertices_computed += fetched.computed;
            clock.lap(&mut report.stages.columns_ns);
            if !fetched.all {
                report.status = AnchorStatus::Waiting;
                return report;
            }
            system.assemble(body, grasp, rows);
            clock.lap(&mut report.stages.assemble_ns);
            let outcome = system.solve(rows, None, grasp);
            report.outcome = Some(outcome);
            clock.lap(&mut report.stages.solve_ns);
            if !is_solved(&outcome) {
                report.status = AnchorStatus::NotSolved;
                return report;
            }
            let moved = system.accept(body, grasp);
            report.passes += 1;
            clock.lap(&mut report.stages.tissue_ns);
            let is_last = body.is_linear() || report.passes >= settings.passes;
            if moved == Moved::Not || (is_last && moved == Moved::Part) {
                report.status = AnchorStatus::NotSolved;
                break;
            }
            if is_last {
                break;
            }
        }
        if field {
            body.field(
                grasp.motion(),
                system.columns(),
                grasp.pushes(),
                &mut self.u,
                &mut self.field,
            );
            clock.lap(&mut report.stages.field_ns);
        }
        report
    }

    /// Multipliers of the last step's rows \[N\], in their order: the force on the tissue is
    /// `-lambda direction`.
    pub fn lambda(&self) -> &[f64] {
        self.grasp.lambda()
    }

    /// delta of the last step's rows \[m\] on the linearised tissue.
    pub fn delta_m(&self) -> &[f64] {
        self.grasp.delta_m()
    }

    /// Displacement of a node at the last step with a field \[m\], (3); zero for a fixed node.
    pub fn displacement_m(&self, node: u32) -> [f64; 3] {
        self.body.numbering().at_node(&self.u, node)
    }

    /// Vertices whose columns are there.
    pub fn cached_vertices(&self) -> usize {
        self.system.columns().count()
    }

    /// Memory for the columns of one vertex, and of all that are there \[bytes\].
    pub fn column_bytes(&self) -> (usize, usize) {
        let columns = self.system.columns();
        (columns.bytes_per_vertex(), columns.bytes())
    }
}
