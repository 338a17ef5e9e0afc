//! Columns of the compliance K^-1 for touched vertices, kept once computed.
//!
//! Entry points: [`Columns::compute`] here and now, [`Columns::request`] from a worker thread,
//! [`Columns::block`]. A column holds the displacement of the vertices that can be reached by rows, so
//! that a step costs nothing that grows with the volume of the mesh. The cache stays below a memory
//! limit: the columns that were used longest ago make room. A column's bits do not depend on who
//! computes it, when, or together with which others.

mod bank;
mod solver;
mod worker;

pub(crate) use bank::{Bank, Groups};
pub(crate) use solver::ColumnSolver;

use crate::fem::{CorotationalState, CorotationalTissue, Factored, HeldPoints, LinearTissue};
use crate::renewal::{Renewals, Renewer, Rule};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use worker::Worker;

/// A vertex's columns came from the worker, or a factor that was renewed beside the steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arrival {
    /// At the begin of which step, counted from 1 since the workspace was made; looks ahead are steps too.
    pub step: u64,
    /// Which vertex, as columns count them, or [`Arrival::FACTOR`].
    pub vertex: u32,
}

impl Arrival {
    /// Instead of a vertex: a renewed factor, with its columns.
    pub const FACTOR: u32 = u32::MAX;
}

/// The cache. Vertices are numbered among those that can be reached.
pub(crate) struct Columns {
    bank: Bank,
    /// Which factor the columns are of.
    factor: u64,
    /// Counts steps.
    now: u64,
    solver: ColumnSolver,
    worker: Option<Worker>,
    /// What has come from the worker, if somebody wants to know.
    arrivals: Option<Vec<Arrival>>,
    /// Vertices that the worker has been asked for, (b).
    pending: Vec<bool>,
    groups: Groups,
    /// Renews factor and columns beside the steps.
    renewer: Option<Box<Renewer>>,
}

impl Columns {
    /// An empty cache for forces on the free nodes `reached`, in the order in which they are counted
    /// from then on. It holds at most `limit_bytes`, but always as many columns as `least` vertices need.
    pub fn new(
        tissue: &impl Factored,
        held: &HeldPoints,
        reached: &[u32],
        limit_bytes: usize,
        least: usize,
    ) -> Self {
        let vertices = reached.len();
        Self {
            bank: Bank::new(vertices, limit_bytes, least),
            factor: 0,
            now: 0,
            solver: ColumnSolver::new(tissue, held, reached),
            worker: None,
            arrivals: None,
            pending: vec![false; vertices],
            groups: Groups::default(),
            renewer: None,
        }
    }

    /// Groups of vertices whose largest displacements are to be known, before any column is computed.
    pub fn group(&mut self, groups: &[Vec<u32>]) {
        self.groups.extend(groups);
    }

    /// From now on factors of `tissue` are renewed beside the steps, by a thread of its own where the system has one
    /// to give, and taken over by `rule`; `reached` as in [`Self::new`]. Half of the memory is for the next columns.
    pub fn renew(
        &mut self,
        tissue: &Arc<CorotationalTissue>,
        held: &Arc<HeldPoints>,
        reached: &[u32],
        rule: Rule,
    ) {
        if let Some(renewer) = &mut self.renewer {
            renewer.set_rule(rule);
            return;
        }
        let next = self.bank.halve();
        let solver = ColumnSolver::new(
            &crate::body::View::new(tissue.numbering(), tissue.rest_factor()),
            held,
            reached,
        );
        let groups = self.groups.clone();
        let (tissue, held) = (tissue.clone(), held.clone());
        self.renewer = Some(Box::new(Renewer::new(
            tissue, held, solver, groups, next, rule,
        )));
    }

    /// From now on factors are made in the step that needs them.
    pub fn renew_in_step(&mut self) {
        self.renewer = None;
    }

    /// Whether factors are renewed beside the steps.
    pub fn renews(&self) -> bool {
        self.helpless().is_some()
    }

    /// Where they are, at how many times the turn that makes a factor old a step makes one itself.
    pub fn helpless(&self) -> Option<f64> {
        let renewer = self.renewer.as_ref().filter(|renewer| renewer.works());
        renewer.map(|renewer| renewer.helpless())
    }

    #[cfg(test)]
    pub fn renewer_mut(&mut self) -> Option<&mut Renewer> {
        self.renewer.as_deref_mut()
    }

    /// After [`Self::begin_step`]: takes over a renewed factor with its columns if its step has come.
    pub fn take_over(
        &mut self,
        tissue: &CorotationalTissue,
        state: &mut CorotationalState,
        held: &HeldPoints,
    ) -> Renewals {
        let mut report = Renewals::default();
        let Some(renewer) = &mut self.renewer else {
            return report;
        };
        if !state.count_step() {
            return report;
        }
        renewer.go_on(state, &self.bank, self.now);
        if !renewer.is_due(tissue, state, self.now) {
            return report;
        }
        if !renewer.take(state, &mut self.bank, self.now, &mut report) {
            return report;
        }
        self.factor = state.fingerprint();
        if let Some(arrivals) = &mut self.arrivals {
            arrivals.push(Arrival {
                step: self.now,
                vertex: Arrival::FACTOR,
            });
        }
        // What was touched since the thread had time for it.
        let late = renewer.late();
        let view = crate::body::View::new(tissue.numbering(), state.factor());
        let (bank, solver) = (&mut self.bank, &mut self.solver);
        bank.compute(solver, &view, held, &self.groups, late, |_| false, self.now);
        report.columns_late += late.len() as u32;
        report
    }

    /// Asks for a new factor of the tangent that `state` has asked for.
    pub fn ask(&mut self, state: &CorotationalState) {
        if let Some(renewer) = &mut self.renewer {
            renewer.ask(state, &self.bank, self.now);
        }
    }

    /// Has the columns of a vertex that will soon be in use computed for the next factor, too.
    pub fn wish(&mut self, vertex: u32) {
        if let Some(renewer) = &mut self.renewer {
            renewer.wish(vertex, self.now);
        }
    }

    /// From now on [`Self::request`] goes to a thread of its own; `reached` as in [`Self::new`].
    pub fn start_worker(
        &mut self,
        tissue: Arc<LinearTissue>,
        held: Arc<HeldPoints>,
        reached: &[u32],
    ) -> std::io::Result<()> {
        let solver = ColumnSolver::new(&*tissue, &held, reached);
        self.worker = Some(Worker::start(solver, tissue, held)?);
        Ok(())
    }

    /// As [`Self::start_worker`], but columns come in the steps that [`Self::expect`] says.
    pub fn replay_worker(
        &mut self,
        tissue: Arc<LinearTissue>,
        held: Arc<HeldPoints>,
        reached: &[u32],
    ) {
        let solver = ColumnSolver::new(&*tissue, &held, reached);
        self.worker = Some(Worker::recorded(solver, tissue, held));
    }

    /// What comes from a worker that replays.
    pub fn expect(&mut self, arrivals: &[Arrival]) {
        if let Some(worker) = &mut self.worker {
            worker.expect(arrivals);
        }
        if let Some(renewer) = &mut self.renewer {
            let factors = arrivals.iter().filter(|a| a.vertex == Arrival::FACTOR);
            factors.for_each(|arrival| renewer.expect(arrival.step));
        }
    }

    /// From now on what comes from the worker is written down.
    pub fn log_arrivals(&mut self) {
        self.arrivals.get_or_insert_default();
    }

    /// What has come since this was asked last, if it is written down.
    pub fn take_arrivals(&mut self) -> Vec<Arrival> {
        self.arrivals
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }

    pub fn has_worker(&self) -> bool {
        self.worker.is_some()
    }

    /// A new step: what the worker has finished is there, and nothing is in use yet.
    pub fn begin_step(&mut self) {
        self.now += 1;
        let Some(worker) = &mut self.worker else {
            return;
        };
        while let Some((slot, blocks)) = worker.finished(self.now) {
            let vertex = self.bank.put_back(slot, blocks, &self.groups);
            self.pending[vertex as usize] = false;
            if let Some(arrivals) = &mut self.arrivals {
                arrivals.push(Arrival {
                    step: self.now,
                    vertex,
                });
            }
        }
    }

    /// Keeps a vertex's columns through this step.
    pub fn keep(&mut self, vertex: u32) {
        self.bank.keep(vertex, self.now);
    }

    pub fn has(&self, vertex: u32) -> bool {
        self.bank.has(vertex)
    }

    /// Vertices whose columns are there.
    pub fn count(&self) -> usize {
        self.bank.count()
    }

    /// Memory for one vertex \[bytes\].
    pub fn bytes_per_vertex(&self) -> usize {
        self.bank.bytes_per_vertex()
    }

    pub fn bytes(&self) -> usize {
        self.bank.bytes()
    }

    /// Computes the columns of those `vertices` that have none yet. Allocates until the memory limit is
    /// reached; then the columns used longest ago make room, but none that this step uses: whether all
    /// found room.
    pub fn compute(&mut self, tissue: &impl Factored, held: &HeldPoints, vertices: &[u32]) -> bool {
        let Self {
            bank,
            solver,
            groups,
            pending,
            now,
            ..
        } = self;
        let on_its_way = |vertex: u32| pending[vertex as usize];
        bank.compute(solver, tissue, held, groups, vertices, on_its_way, *now)
    }

    /// Asks the worker for a vertex's columns, unless they are there or on their way. They come with the
    /// begin of some later step.
    pub fn request(&mut self, vertex: u32) {
        if self.has(vertex) || self.pending[vertex as usize] {
            return;
        }
        if !self.worker.as_ref().is_some_and(Worker::has_room) {
            return;
        }
        if let Some((slot, blocks)) = self.bank.take_out(vertex, self.groups.count(), self.now)
            && let Some(worker) = &mut self.worker
        {
            worker.ask(slot, vertex, blocks);
            self.pending[vertex as usize] = true;
        }
    }

    /// First unknown of a vertex.
    pub fn first_unknown(&self, vertex: u32) -> usize {
        self.solver.first_unknown(vertex)
    }

    /// Forgets every column if they are not of the factor with this number; the first has 0.
    pub fn belong_to(&mut self, factor: u64) {
        if self.factor != factor {
            self.factor = factor;
            self.bank.forget();
        }
    }

    /// Blocks of a vertex whose columns are there, (b x 3 x 3), each column-major.
    pub fn of(&self, vertex: u32) -> &[f64] {
        self.bank.of(vertex)
    }

    /// A force on `pushed` displaces no vertex of each group by more than this \[m/N\].
    pub fn largest(&self, pushed: u32) -> &[f64] {
        self.bank.largest(pushed)
    }

    /// Displacement of `at` per force on `pushed`, whose columns must be there \[m/N\].
    #[inline]
    pub fn block(&self, at: u32, pushed: u32) -> Matrix3<f64> {
        let start = 9 * at as usize;
        Matrix3::from_column_slice(&self.of(pushed)[start..start + 9])
    }
}
