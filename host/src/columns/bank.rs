//! Columns of one factor, each in a slot.
//!
//! Entry points: [`Bank::compute`], [`Bank::of`]. There is one for the factor in use, and one for the next.

use super::ColumnSolver;
use crate::fem::{Factored, HeldPoints};
use crate::work;
use sutura_models::memory;

const MISSING: u32 = u32::MAX;
/// More vertices than these at once are told as work: a step computes a few batches at most.
const LONG: usize = 64;
/// Part of the free memory that columns may take which are computed beforehand.
const SHARE: f64 = 0.5;

/// Groups of vertices and where each begins, for [`Bank::largest`].
#[derive(Clone, Debug)]
pub(crate) struct Groups {
    vertices: Vec<u32>,
    start: Vec<usize>,
}

/// Slots, and which vertex has which.
pub(crate) struct Bank {
    /// Slot of each vertex's columns, or [`MISSING`], (b).
    place: Vec<u32>,
    slots: Vec<Slot>,
    /// Slots that the memory limit allows.
    most_slots: usize,
    /// What is always allowed.
    least: usize,
    /// Slots that no vertex has.
    empty: Vec<u32>,
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

impl Default for Groups {
    fn default() -> Self {
        Self {
            vertices: Vec::new(),
            start: vec![0],
        }
    }
}

impl Groups {
    pub fn extend(&mut self, groups: &[Vec<u32>]) {
        for group in groups {
            self.vertices.extend(group);
            self.start.push(self.vertices.len());
        }
    }

    pub fn count(&self) -> usize {
        self.start.len() - 1
    }

    /// Largest Frobenius norm of the blocks of each group's vertices.
    fn largest(&self, blocks: &[f64], out: &mut [f64]) {
        for (out, ends) in out.iter_mut().zip(self.start.windows(2)) {
            let squares = self.vertices[ends[0]..ends[1]].iter().map(|vertex| {
                let block = &blocks[9 * *vertex as usize..9 * *vertex as usize + 9];
                block.iter().map(|entry| entry * entry).sum::<f64>()
            });
            *out = squares.fold(0.0, f64::max).sqrt();
        }
    }
}

impl Bank {
    /// An empty one for so many vertices. It holds at most `limit_bytes`, but always as many columns as `least`
    /// vertices need.
    pub fn new(vertices: usize, limit_bytes: usize, least: usize) -> Self {
        let bytes = size_of::<f64>() * 9 * vertices;
        Self {
            place: vec![MISSING; vertices],
            slots: Vec::new(),
            most_slots: (limit_bytes / bytes.max(1)).max(least).min(vertices),
            least,
            empty: Vec::new(),
        }
    }

    /// Another one for half of the memory, and the rest stays.
    pub fn halve(&mut self) -> Self {
        let most = self.most_slots.div_ceil(2);
        self.most_slots = most.max(self.least).min(self.place.len());
        Self {
            place: vec![MISSING; self.place.len()],
            slots: Vec::new(),
            most_slots: self.most_slots,
            least: self.least,
            empty: Vec::new(),
        }
    }

    /// Keeps a vertex's columns through a step.
    pub fn keep(&mut self, vertex: u32, now: u64) {
        let slot = self.place[vertex as usize];
        if slot != MISSING {
            self.slots[slot as usize].used = now;
        }
    }

    pub fn has(&self, vertex: u32) -> bool {
        self.place[vertex as usize] != MISSING
    }

    /// Vertices that can be reached.
    pub fn vertices(&self) -> usize {
        self.place.len()
    }

    /// Vertices whose columns are there.
    pub fn count(&self) -> usize {
        self.place.iter().filter(|slot| **slot != MISSING).count()
    }

    /// Vertices whose columns are there and were used in a step from `since` on, and when they were last.
    pub fn used_since(&self, since: u64) -> impl Iterator<Item = (u32, u64)> + '_ {
        let slots = (0u32..).zip(&self.slots);
        let there = slots.filter(|(index, slot)| self.place[slot.vertex as usize] == *index);
        let used = there.map(|(_, slot)| (slot.vertex, slot.used));
        used.filter(move |(_, used)| *used >= since)
    }

    /// Memory for one vertex \[bytes\].
    pub fn bytes_per_vertex(&self) -> usize {
        size_of::<f64>() * 9 * self.place.len()
    }

    pub fn bytes(&self) -> usize {
        self.slots.len() * self.bytes_per_vertex()
    }

    /// Forgets every column.
    pub fn forget(&mut self) {
        self.place.fill(MISSING);
        self.empty.clear();
        self.empty.extend((0..self.slots.len() as u32).rev());
    }

    /// Computes the columns of those `vertices` that have none yet nor are on their way; they count as used in the
    /// step `now`. Whether all found room, and the work was not stopped. Many at once leave [half](SHARE) of the memory that is free.
    #[expect(clippy::too_many_arguments, reason = "who solves, for what, when")]
    pub fn compute(
        &mut self,
        solver: &mut ColumnSolver,
        tissue: &impl Factored,
        held: &HeldPoints,
        groups: &Groups,
        vertices: &[u32],
        on_its_way: impl Fn(u32) -> bool,
        now: u64,
    ) -> bool {
        let mut slots = [MISSING; ColumnSolver::BATCH];
        let mut batch = [MISSING; ColumnSolver::BATCH];
        let mut count = 0;
        let mut room = true;
        // What is computed in a step is not worth a word.
        let missing = if vertices.len() > LONG {
            let new = vertices.iter().filter(|vertex| !self.has(**vertex));
            let new = new.count();
            self.fit(new, memory::available_bytes());
            new.min(self.most_slots)
        } else {
            0
        };
        let is_long = missing > LONG;
        let mut made = 0;
        if is_long {
            let bytes = missing as f64 * self.bytes_per_vertex() as f64;
            work::begin("computing how the tissue gives way", || {
                format!("{missing} boundary nodes, {:.2} GB", 1e-9 * bytes)
            });
        }
        for (index, &vertex) in vertices.iter().enumerate() {
            if !self.has(vertex) && !on_its_way(vertex) && !batch[..count].contains(&vertex) {
                match self.slot_for(vertex, groups.count(), now) {
                    Some(slot) => {
                        (slots[count], batch[count]) = (slot, vertex);
                        count += 1;
                    }
                    None => room = false,
                }
            }
            if count == batch.len() || (index + 1 == vertices.len() && count > 0) {
                if is_long && work::is_stopped() {
                    return false;
                }
                solver.solve(tissue, &batch[..count]);
                for (which, (&slot, &vertex)) in slots.iter().zip(&batch[..count]).enumerate() {
                    let home = &mut self.slots[slot as usize];
                    solver.read(tissue, held, which, &mut home.blocks);
                    groups.largest(&home.blocks, &mut home.largest);
                    self.place[vertex as usize] = slot;
                }
                made += count;
                if is_long {
                    work::part(made, missing);
                }
                count = 0;
            }
        }
        if is_long {
            work::end();
        }
        room
    }

    /// Limits the slots so that so many `new` ones leave enough of the memory that is free \[bytes\].
    fn fit(&mut self, new: usize, free_bytes: Option<u64>) {
        let bytes = self.bytes_per_vertex().max(1);
        let fits = free_bytes.map_or(usize::MAX, |free| (SHARE * free as f64) as usize / bytes);
        let most = self.slots.len().saturating_add(fits.max(LONG));
        let wanted = (self.slots.len() + new).min(self.most_slots);
        if most < wanted {
            tracing::warn!(
                "there is memory for the compliance of {most} of {wanted} vertices; that of the others is computed as they are touched"
            );
            self.most_slots = most;
        }
    }

    /// Makes slots until so many are empty, if the memory limit allows them.
    pub fn spare(&mut self, empty: usize, groups: usize) {
        while self.empty.len() < empty {
            let Some(slot) = self.new_slot(0, groups) else {
                return;
            };
            self.empty.push(slot);
        }
    }

    /// A slot for a vertex without its buffer, which [`Self::put_back`] has back once it is filled.
    pub fn take_out(&mut self, vertex: u32, groups: usize, now: u64) -> Option<(u32, Vec<f64>)> {
        let slot = self.slot_for(vertex, groups, now)?;
        let blocks = std::mem::take(&mut self.slots[slot as usize].blocks);
        Some((slot, blocks))
    }

    /// The vertex whose columns have come.
    pub fn put_back(&mut self, slot: u32, blocks: Vec<f64>, groups: &Groups) -> u32 {
        let home = &mut self.slots[slot as usize];
        groups.largest(&blocks, &mut home.largest);
        home.blocks = blocks;
        self.place[home.vertex as usize] = slot;
        home.vertex
    }

    /// A slot for `vertex`: a new one below the limit, else the one used longest ago.
    fn slot_for(&mut self, vertex: u32, groups: usize, now: u64) -> Option<u32> {
        let slot = if let Some(empty) = self.empty.pop() {
            empty as usize
        } else if let Some(new) = self.new_slot(vertex, groups) {
            new as usize
        } else {
            let idle = |slot: &Slot| slot.used < now && !slot.blocks.is_empty();
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
        home.used = now;
        Some(slot as u32)
    }

    /// One more slot, below the limit; none where the system has no memory for it, which then is the limit.
    fn new_slot(&mut self, vertex: u32, groups: usize) -> Option<u32> {
        if self.slots.len() >= self.most_slots {
            return None;
        }
        let Ok(blocks) = memory::zeros("a column", 9 * self.place.len()) else {
            self.most_slots = self.slots.len();
            return None;
        };
        // Room to forget them all.
        self.empty
            .reserve(self.slots.len() + 1 - self.empty.len().min(self.slots.len()));
        self.slots.push(Slot {
            vertex,
            used: 0,
            blocks,
            largest: vec![0.0; groups],
        });
        Some(self.slots.len() as u32 - 1)
    }

    /// Blocks of a vertex whose columns are there, (b x 3 x 3), each column-major.
    pub fn of(&self, vertex: u32) -> &[f64] {
        &self.slots[self.place[vertex as usize] as usize].blocks
    }

    /// A force on `pushed` displaces no vertex of each group by more than this \[m/N\].
    pub fn largest(&self, pushed: u32) -> &[f64] {
        &self.slots[self.place[pushed as usize] as usize].largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns that are computed beforehand leave half of the free memory; without a figure for that they take what their limit says.
    #[test]
    fn columns_beforehand_leave_memory_for_others() {
        const VERTICES: usize = 10_000;
        let slots_with = |free: Option<usize>| {
            // 3,000 columns are always allowed: 2.16 GB.
            let mut bank = Bank::new(VERTICES, 512 << 20, 3000);
            assert_eq!(bank.most_slots, 3000);
            bank.fit(
                2000,
                free.map(|slots| (slots * bank.bytes_per_vertex()) as u64),
            );
            bank.most_slots
        };
        assert_eq!(slots_with(None), 3000);
        assert_eq!(slots_with(Some(4001)), 3000, "there is room for all");
        assert_eq!(slots_with(Some(2000)), 1000);
        assert_eq!(slots_with(Some(0)), LONG);
    }
}
