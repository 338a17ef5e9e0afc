//! Columns of the compliance K^-1 for touched vertices, kept once computed.
//!
//! Entry points: [`Columns::compute`] here and now, [`Columns::request`] from a worker thread,
//! [`Columns::block`]. A column holds the displacement of the vertices that can be reached by rows, so
//! that a step costs nothing that grows with the volume of the mesh. The cache stays below a memory
//! limit: the columns that were used longest ago make room. A column's bits do not depend on who
//! computes it, when, or together with which others.

mod solver;
mod worker;

use crate::fem::{Factored, HeldPoints, LinearTissue};
use crate::work;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use solver::ColumnSolver;
use std::sync::Arc;
use sutura_models::memory;
use worker::Worker;

const MISSING: u32 = u32::MAX;
/// More vertices than these at once are told as work: a step computes a few batches at most.
const LONG: usize = 64;

/// A vertex's columns came from the worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arrival {
    /// At the begin of which step, counted from 1 since the workspace was made; looks ahead are steps too.
    pub step: u64,
    /// Which vertex, as columns count them.
    pub vertex: u32,
}

/// The cache. Vertices are numbered among those that can be reached.
pub(crate) struct Columns {
    /// Slot of each vertex's columns, or [`MISSING`], (b).
    place: Vec<u32>,
    slots: Vec<Slot>,
    /// Slots that the memory limit allows.
    most_slots: usize,
    /// Slots that no vertex has.
    empty: Vec<u32>,
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
    /// Groups of vertices and where each begins, for [`Self::largest`].
    grouped: Vec<u32>,
    group_start: Vec<usize>,
}

/// Columns of one vertex.
struct Slot {
    vertex: u32,
    /// Step that used it last.
    used: u64,
    /// For each vertex that can be reached the block that maps a force on this slot's vertex to its
    /// displacement \[m/N\], column-major, (b x 3 x 3). Empty while the worker has it.
    blocks: Vec<f64>,
    /// Largest Frobenius norm of a block in each group \[m/N\].
    largest: Vec<f64>,
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
        let bytes = size_of::<f64>() * 9 * vertices;
        Self {
            place: vec![MISSING; vertices],
            slots: Vec::new(),
            most_slots: (limit_bytes / bytes.max(1)).max(least).min(vertices),
            empty: Vec::new(),
            factor: 0,
            now: 0,
            solver: ColumnSolver::new(tissue, held, reached),
            worker: None,
            arrivals: None,
            pending: vec![false; vertices],
            grouped: Vec::new(),
            group_start: vec![0],
        }
    }

    /// Groups of vertices whose largest displacements are to be known, before any column is computed.
    pub fn group(&mut self, groups: &[Vec<u32>]) {
        for group in groups {
            self.grouped.extend(group);
            self.group_start.push(self.grouped.len());
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
            let home = &mut self.slots[slot as usize];
            largest(&blocks, &self.grouped, &self.group_start, &mut home.largest);
            home.blocks = blocks;
            self.place[home.vertex as usize] = slot;
            self.pending[home.vertex as usize] = false;
            if let Some(arrivals) = &mut self.arrivals {
                arrivals.push(Arrival {
                    step: self.now,
                    vertex: home.vertex,
                });
            }
        }
    }

    /// Keeps a vertex's columns through this step.
    pub fn keep(&mut self, vertex: u32) {
        let slot = self.place[vertex as usize];
        if slot != MISSING {
            self.slots[slot as usize].used = self.now;
        }
    }

    pub fn has(&self, vertex: u32) -> bool {
        self.place[vertex as usize] != MISSING
    }

    /// Vertices whose columns are there.
    pub fn count(&self) -> usize {
        self.place.iter().filter(|slot| **slot != MISSING).count()
    }

    /// Memory for one vertex \[bytes\].
    pub fn bytes_per_vertex(&self) -> usize {
        size_of::<f64>() * 9 * self.place.len()
    }

    pub fn bytes(&self) -> usize {
        self.slots.len() * self.bytes_per_vertex()
    }

    /// Computes the columns of those `vertices` that have none yet. Allocates until the memory limit is
    /// reached; then the columns used longest ago make room, but none that this step uses: whether all
    /// found room.
    pub fn compute(&mut self, tissue: &impl Factored, held: &HeldPoints, vertices: &[u32]) -> bool {
        let mut slots = [MISSING; ColumnSolver::BATCH];
        let mut batch = [MISSING; ColumnSolver::BATCH];
        let mut count = 0;
        let mut room = true;
        // What is computed in a step is not worth a word.
        let is_long = vertices.len() > LONG;
        if is_long {
            let bytes = vertices.len() as f64 * self.bytes_per_vertex() as f64;
            work::begin("computing how the tissue gives way", || {
                format!("{} places, {:.2} GB", vertices.len(), 1e-9 * bytes)
            });
        }
        for (index, &vertex) in vertices.iter().enumerate() {
            if !self.has(vertex)
                && !self.pending[vertex as usize]
                && !batch[..count].contains(&vertex)
            {
                match self.slot_for(vertex) {
                    Some(slot) => {
                        (slots[count], batch[count]) = (slot, vertex);
                        count += 1;
                    }
                    None => room = false,
                }
            }
            if count == batch.len() || (index + 1 == vertices.len() && count > 0) {
                self.solver.solve(tissue, &batch[..count]);
                for (which, (&slot, &vertex)) in slots.iter().zip(&batch[..count]).enumerate() {
                    let home = &mut self.slots[slot as usize];
                    self.solver.read(tissue, held, which, &mut home.blocks);
                    let (grouped, start) = (&self.grouped, &self.group_start);
                    largest(&home.blocks, grouped, start, &mut home.largest);
                    self.place[vertex as usize] = slot;
                }
                if is_long {
                    work::part(index + 1, vertices.len());
                }
                count = 0;
            }
        }
        room
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
        if let Some(slot) = self.slot_for(vertex) {
            let blocks = std::mem::take(&mut self.slots[slot as usize].blocks);
            if let Some(worker) = &mut self.worker {
                worker.ask(slot, vertex, blocks);
                self.pending[vertex as usize] = true;
            }
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
            self.place.fill(MISSING);
            self.empty.clear();
            self.empty.extend((0..self.slots.len() as u32).rev());
        }
    }

    /// One more slot, below the limit; none where the system has no memory for it, which then is the limit.
    fn new_slot(&mut self, vertex: u32) -> Option<usize> {
        if self.slots.len() >= self.most_slots {
            return None;
        }
        let Ok(blocks) = memory::zeros("a column", 9 * self.place.len()) else {
            self.most_slots = self.slots.len();
            return None;
        };
        // Room to forget them all.
        self.empty.reserve(self.slots.len() + 1);
        self.slots.push(Slot {
            vertex,
            used: 0,
            blocks,
            largest: vec![0.0; self.group_start.len() - 1],
        });
        Some(self.slots.len() - 1)
    }

    /// A slot for `vertex`: a new one below the limit, else the one used longest ago.
    fn slot_for(&mut self, vertex: u32) -> Option<u32> {
        let slot = if let Some(empty) = self.empty.pop() {
            empty as usize
        } else if let Some(new) = self.new_slot(vertex) {
            new
        } else {
            let idle = |slot: &Slot| slot.used < self.now && !slot.blocks.is_empty();
            let (oldest, _) = self
                .slots
                .iter()
                .enumerate()
                .filter(|(_, slot)| idle(slot))
                .min_by_key(|(index, slot)| (slot.used, *index))?;
            oldest
        };
        let home = &mut self.slots[slot];
        if self.place[home.vertex as usize] == slot as u32 {
            self.place[home.vertex as usize] = MISSING;
        }
        home.vertex = vertex;
        home.used = self.now;
        Some(slot as u32)
    }

    /// Blocks of a vertex whose columns are there, (b x 3 x 3), each column-major.
    pub fn of(&self, vertex: u32) -> &[f64] {
        &self.slots[self.place[vertex as usize] as usize].blocks
    }

    /// A force on `pushed` displaces no vertex of each group by more than this \[m/N\].
    pub fn largest(&self, pushed: u32) -> &[f64] {
        &self.slots[self.place[pushed as usize] as usize].largest
    }

    /// Displacement of `at` per force on `pushed`, whose columns must be there \[m/N\].
    #[inline]
    pub fn block(&self, at: u32, pushed: u32) -> Matrix3<f64> {
        let start = 9 * at as usize;
        Matrix3::from_column_slice(&self.of(pushed)[start..start + 9])
    }

    /// Adds the displacement of every vertex for a force on `pushed` to `u` (3 b).
    pub fn add(&self, pushed: u32, force: &Vector3<f64>, u: &mut [f64]) {
        for (u, block) in u.chunks_exact_mut(3).zip(self.of(pushed).chunks_exact(9)) {
            for axis in 0..3 {
                u[axis] +=
                    block[axis] * force.x + block[3 + axis] * force.y + block[6 + axis] * force.z;
            }
        }
    }
}

/// Largest Frobenius norm of the blocks of each group's vertices.
fn largest(blocks: &[f64], grouped: &[u32], start: &[usize], out: &mut [f64]) {
    for (out, ends) in out.iter_mut().zip(start.windows(2)) {
        let squares = grouped[ends[0]..ends[1]].iter().map(|vertex| {
            let block = &blocks[9 * *vertex as usize..9 * *vertex as usize + 9];
            block.iter().map(|entry| entry * entry).sum::<f64>()
        });
        *out = squares.fold(0.0, f64::max).sqrt();
    }
}
