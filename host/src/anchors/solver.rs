//! One step of rows on anchors: columns, compliance, forces, field.
//!
//! Entry points: [`AnchorSolver::new`], [`AnchorSolver::step`].

use super::compliance::{Reached, assemble};
use super::{AnchorPoint, AnchorRow};
use crate::body::{Body, BodyWork, Motion, Push};
use crate::clock::Clock;
use crate::columns::Columns;
use crate::fem::{
    CorotationalTissue, Factored, HeldPoints, LinearTissue, Linearisation, SolveScratch,
    TissueError,
};
use crate::rows::{self, Method, Problem, Row};
use nalgebra::{Matrix3, Vector3};
use std::sync::Arc;

/// What a solver may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorSettings {
    /// Most rows of a step.
    pub most_rows: usize,
    /// Most anchors of a step.
    pub most_anchors: usize,
    /// Vertices whose columns one step may compute.
    pub vertices_per_step: usize,
    /// Most passes over corotational tissue in one step; linear tissue needs one.
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
    /// The rows' solve failed; its outcome says how.
    NotSolved,
}

/// Time spent in each stage \[ns\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AnchorStages {
    /// Rotations, internal forces, refactorisation; nothing for linear tissue.
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
    /// Passes over corotational tissue.
    pub passes: u32,
    /// The last linearisation of corotational tissue.
    pub linearisation: Option<Linearisation>,
    /// Time per stage.
    pub stages: AnchorStages,
}

/// Tissue held by rows on anchors.
pub struct AnchorSolver {
    body: Body,
    body_work: BodyWork,
    held: HeldPoints,
    settings: AnchorSettings,
    columns: Columns,
    /// Free nodes that anchors may name, in the columns' order, (b).
    reached: Vec<u32>,
    /// Place of each mesh node among the reached, (n).
    reached_of_node: Vec<u32>,

    // What evolves.
    motion: Motion,
    forces: rows::State,
    anchors: Vec<Reached>,
    /// Direction and anchor of each row of the last solve.
    acting: Vec<AnchorRow>,
    u: Vec<f64>,

    // Scratch.
    vertices: Vec<u32>,
    missing: Vec<u32>,
    next_anchors: Vec<Reached>,
    first_row: Vec<u32>,
    free: Vec<Vector3<f64>>,
    pairs: Vec<Matrix3<f64>>,
    w: Vec<f64>,
    delta_free: Vec<f64>,
    kinds: Vec<Row>,
    rows_work: rows::Workspace,
    field: SolveScratch,
}

const UNREACHED: u32 = u32::MAX;

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

    fn new(body: Body, reached: &[u32], settings: AnchorSettings) -> Result<Self, TissueError> {
        let numbering = body.numbering();
        let mut reached_of_node = vec![UNREACHED; numbering.nodes()];
        for (place, &node) in (0u32..).zip(reached) {
            let nodes = numbering.nodes();
            let slot = reached_of_node
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "the list of reached nodes",
                    node,
                    nodes,
                })?;
            if numbering.is_fixed(node) {
                return Err(TissueError::Fixed(node));
            }
            *slot = place;
        }
        let held = HeldPoints::none();
        let AnchorSettings {
            most_rows,
            most_anchors,
            memory_bytes,
            ..
        } = settings;
        // Corotational tissue reads the anchors of the step before, too.
        let least = 8 * most_anchors;
        let motion = body.at_rest().with_room(4 * most_anchors);
        let view = body.view(&motion);
        let columns = Columns::new(&view, &held, reached, memory_bytes, least);
        let unknowns = numbering.unknowns();
        Ok(Self {
            held,
            columns,
            reached: reached.to_vec(),
            reached_of_node,
            forces: rows::State::new(most_rows),
            anchors: Vec::with_capacity(most_anchors),
            acting: Vec::with_capacity(most_rows),
            u: vec![0.0; unknowns],
            vertices: Vec::with_capacity(8 * most_anchors),
            missing: Vec::with_capacity(8 * most_anchors),
            next_anchors: Vec::with_capacity(most_anchors),
            first_row: Vec::with_capacity(most_anchors + 1),
            free: vec![Vector3::zeros(); most_anchors],
            pairs: vec![Matrix3::zeros(); most_anchors],
            w: vec![0.0; most_rows * most_rows],
            delta_free: vec![0.0; most_rows],
            kinds: Vec::with_capacity(most_rows),
            rows_work: rows::Workspace::new(most_rows),
            field: view.factor().scratch(1),
            settings,
            body_work: body.work(),
            motion,
            body,
        })
    }

    /// From now on a thread of its own computes columns: a step that needs one that is not there waits.
    /// Only linear tissue keeps its columns long enough for that; nothing happens for other tissue.
    ///
    /// # Errors
    /// What the system says when it has no thread to give.
    pub fn start_worker(&mut self) -> std::io::Result<()> {
        if let Body::Linear { tissue, .. } = &self.body {
            let none = Arc::new(HeldPoints::none());
            self.columns
                .start_worker(tissue.clone(), none, &self.reached)?;
        }
        Ok(())
    }

    /// Has the worker compute the columns of a node that anchors will soon name.
    pub fn prefetch(&mut self, node: u32) {
        let vertex = self.reached_of_node.get(node as usize);
        if let Some(&vertex) = vertex.filter(|vertex| **vertex != UNREACHED) {
            self.columns.request(vertex);
        }
    }

    /// Finds the forces of `rows`, which are in the order of their `anchors`; with `field` the
    /// displacement of all nodes, too. Allocates only while columns are new and memory is below its limit.
    pub fn step(&mut self, anchors: &[AnchorPoint], rows: &[AnchorRow], field: bool) -> AnchorStep {
        let mut report = AnchorStep::default();
        let mut clock = Clock::start();
        if !self.reach(anchors, rows) {
            report.status = AnchorStatus::Malformed;
            return report;
        }
        self.columns.begin_step();
        self.kinds.clear();
        self.kinds.extend(rows.iter().map(|row| Row {
            id: row.id,
            kind: row.kind,
        }));
        loop {
            let Self {
                body,
                motion,
                body_work,
                columns,
                ..
            } = self;
            let balance = body.look(motion, body_work, columns);
            let balanced = balance.is_some_and(|balance| {
                report.passes > 0 && balance.imbalance <= self.settings.tolerance
            });
            if balanced {
                break;
            }
            let linearisation = body.linearise(motion, body_work, columns);
            report.linearisation = linearisation.or(report.linearisation);
            clock.lap(&mut report.stages.tissue_ns);
            let ready = self.fetch(&mut report);
            clock.lap(&mut report.stages.columns_ns);
            if !ready {
                report.status = AnchorStatus::Waiting;
                return report;
            }
            self.assemble(rows);
            clock.lap(&mut report.stages.assemble_ns);
            let outcome = self.solve(rows);
            report.outcome = Some(outcome);
            clock.lap(&mut report.stages.solve_ns);
            use rows::Status::{Incompatible, NotConverged, Ok, Redundant};
            if !matches!(outcome.status, Ok | Redundant | Incompatible | NotConverged) {
                report.status = AnchorStatus::NotSolved;
                return report;
            }
            self.body.accept(
                &mut self.motion,
                &mut self.body_work,
                &self.columns,
                pushes(&self.anchors, &self.acting, self.forces.lambda()),
            );
            report.passes += 1;
            clock.lap(&mut report.stages.tissue_ns);
            if self.body.is_linear() || report.passes >= self.settings.passes {
                break;
            }
        }
        if field {
            self.body.field(
                &self.motion,
                &self.columns,
                pushes(&self.anchors, &self.acting, self.forces.lambda()),
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
        self.forces.lambda()
    }

    /// delta of the last step's rows \[m\] on the linearised tissue.
    pub fn delta_m(&self) -> &[f64] {
        self.forces.delta()
    }

    /// Displacement of a node at the last step with a field \[m\], (3); zero for a fixed node.
    pub fn displacement_m(&self, node: u32) -> [f64; 3] {
        self.body.numbering().at_node(&self.u, node)
    }

    /// Vertices whose columns are there.
    pub fn cached_vertices(&self) -> usize {
        self.columns.count()
    }

    /// Memory for the columns of one vertex, and of all that are there \[bytes\].
    pub fn column_bytes(&self) -> (usize, usize) {
        (self.columns.bytes_per_vertex(), self.columns.bytes())
    }

    /// Reads anchors and rows; whether they make sense.
    fn reach(&mut self, anchors: &[AnchorPoint], rows: &[AnchorRow]) -> bool {
        if anchors.len() > self.settings.most_anchors || rows.len() > self.settings.most_rows {
            return false;
        }
        self.next_anchors.clear();
        for anchor in anchors {
            let mut reached = Reached::default();
            for (&node, &weight) in anchor.nodes.iter().zip(&anchor.weights) {
                if weight == 0.0 {
                    continue;
                }
                let Some(&vertex) = self.reached_of_node.get(node as usize) else {
                    return false;
                };
                if vertex == UNREACHED {
                    if self.body.numbering().is_fixed(node) {
                        continue;
                    }
                    return false;
                }
                reached.vertices[reached.count] = vertex;
                reached.weights[reached.count] = weight;
                reached.count += 1;
            }
            self.next_anchors.push(reached);
        }
        self.first_row.clear();
        let mut next = 0;
        for anchor in 0..anchors.len() {
            self.first_row.push(next as u32);
            next += rows[next..]
                .iter()
                .take_while(|row| row.anchor as usize == anchor)
                .count();
        }
        self.first_row.push(next as u32);
        next == rows.len()
    }

    /// Computes missing columns as far as this step may; whether all are there.
    fn fetch(&mut self, report: &mut AnchorStep) -> bool {
        self.vertices.clear();
        for anchor in &self.next_anchors {
            self.vertices
                .extend(anchor.parts().map(|(vertex, _)| vertex));
        }
        self.vertices
            .extend(self.motion.pushed().iter().map(|(vertex, _)| *vertex));
        self.missing.clear();
        for &vertex in &self.vertices {
            if self.columns.has(vertex) {
                self.columns.keep(vertex);
            } else if !self.missing.contains(&vertex) {
                self.missing.push(vertex);
            }
        }
        if self.missing.is_empty() {
            return true;
        }
        if self.columns.has_worker() {
            for &vertex in &self.missing {
                self.columns.request(vertex);
            }
            return false;
        }
        let budget = self
            .settings
            .vertices_per_step
            .saturating_sub(report.vertices_computed as usize);
        let now = self.missing.len().min(budget);
        report.vertices_computed += now as u32;
        self.columns.compute(
            &self.body.view(&self.motion),
            &self.held,
            &self.missing[..now],
        ) && now == self.missing.len()
    }

    /// Compliance and free delta of the rows.
    fn assemble(&mut self, rows: &[AnchorRow]) {
        let n = rows.len();
        for (free, anchor) in self.free.iter_mut().zip(&self.next_anchors) {
            *free = anchor
                .parts()
                .map(|(vertex, weight)| {
                    let (motion, work) = (&self.motion, &self.body_work);
                    self.body.free(motion, work, &self.columns, vertex) * weight
                })
                .sum();
        }
        for (delta, row) in self.delta_free.iter_mut().zip(rows) {
            let along = Vector3::from(row.direction).dot(&self.free[row.anchor as usize]);
            *delta = row.target_m - along;
        }
        assemble(
            &self.next_anchors,
            rows,
            &self.first_row,
            &self.columns,
            &mut self.pairs,
            &mut self.w[..n * n],
        );
    }

    fn solve(&mut self, rows: &[AnchorRow]) -> rows::Outcome {
        let n = rows.len();
        let problem = Problem {
            rows: &self.kinds,
            compliance: &self.w[..n * n],
            delta_free: &self.delta_free[..n],
        };
        let outcome = rows::solve(
            &problem,
            self.settings.method,
            &mut self.forces,
            &mut self.rows_work,
        );
        self.anchors.clone_from(&self.next_anchors);
        self.acting.clear();
        self.acting.extend_from_slice(rows);
        outcome
    }
}

/// Forces on vertices: -C' lambda.
fn pushes<'a>(
    anchors: &'a [Reached],
    rows: &'a [AnchorRow],
    lambda: &'a [f64],
) -> impl Iterator<Item = Push> + 'a {
    anchors.iter().enumerate().flat_map(move |(index, anchor)| {
        let force: Vector3<f64> = rows
            .iter()
            .zip(lambda)
            .filter(|(row, _)| row.anchor as usize == index)
            .map(|(row, lambda)| -Vector3::from(row.direction) * *lambda)
            .sum();
        anchor
            .parts()
            .map(move |(vertex, weight)| (vertex, force * weight))
    })
}
