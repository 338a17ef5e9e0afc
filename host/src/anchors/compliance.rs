//! W = C K^-1 C' by barycentric sums of cached blocks.
//!
//! Entry points: [`Pairs::look`], then [`Pairs::project`]. Blocks between anchors are kept from step to step: what
//! has not moved in the mesh costs nothing again, and a change of direction only the projection.

use super::{MultiPointConstraint, PointConstraint, Term};
use crate::columns::Columns;
use crate::marks::Marks;
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use serde::Serialize;
use sutura_factor::{fetch_line, touch};

/// Most vertices of an anchor: a way between two points of cells has eight.
const MOST_VERTICES: usize = 8;

/// Numbers of a block, and how many are taken at a time: a column and the first of the next.
const BLOCK: usize = 9;
const LANES: usize = 4;

/// Where what the terms of a row move cancels, as where a thread is straight, round-off is left, which may be negative: no row gives way less
/// than so much of what its terms could.
const ROUND_OFF: f64 = 1e-14;

/// Anchors in a row that may have gone since the last time before one is looked for among all.
const SKIPPED: usize = 6;

/// Looks through which [`Pairs::keep_others`] keeps blocks of an anchor that is not among the present ones.
const KEPT: u8 = 16;

/// An anchor with its free nodes counted as the columns count them; fixed nodes are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Reached {
    vertices: [u32; MOST_VERTICES],
    weights: [f64; MOST_VERTICES],
    count: usize,
}

impl Reached {
    pub fn parts(&self) -> impl Iterator<Item = (u32, f64)> {
        let pairs = self.vertices.into_iter().zip(self.weights);
        pairs.take(self.count)
    }

    /// Some order that depends on nothing but the two.
    fn is_lower_than(&self, other: &Self) -> bool {
        let of = |reached: &Self| (reached.vertices, reached.weights.map(f64::to_bits));
        of(self) < of(other)
    }

    /// Adds a vertex; whether there is room.
    pub fn add(&mut self, vertex: u32, weight: f64) -> bool {
        let room = self.count < MOST_VERTICES;
        if room {
            self.vertices[self.count] = vertex;
            self.weights[self.count] = weight;
            self.count += 1;
        }
        room
    }
}

/// Displacement of an anchor per force on another \[m/N\], column-major; the columns of the other's vertices must be there.
struct Moves<'a> {
    at: &'a Reached,
    pushed: &'a Reached,
    columns: &'a Columns,
}

impl WithSimd for Moves<'_> {
    type Output = [f64; BLOCK];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> [f64; BLOCK] {
        let mut sum = [0.0; BLOCK];
        for (pushed, weight) in self.pushed.parts() {
            let column = self.columns.of(pushed);
            for (vertex, share) in self.at.parts() {
                let first = BLOCK * vertex as usize;
                let part = share * weight;
                for (sum, number) in sum.iter_mut().zip(&column[first..first + BLOCK]) {
                    *sum += number * part;
                }
            }
        }
        sum
    }
}

/// Rows on several anchors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Spread {
    pub rows: Vec<MultiPointConstraint>,
    pub terms: Vec<Term>,
}

impl Spread {
    pub fn terms_of(&self, row: &MultiPointConstraint) -> &[Term] {
        let (first, count) = (row.terms.0 as usize, row.terms.1 as usize);
        self.terms.get(first..first + count).unwrap_or_default()
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.rows.clone_from(&other.rows);
        self.terms.clone_from(&other.terms);
    }
}

/// Blocks of compliance between anchors.
pub(super) struct Pairs {
    most: usize,
    /// Number of the factor that they belong to.
    factor: u64,
    /// What each slot holds; `None` if it is free.
    held: Vec<Option<Reached>>,
    /// Slots that are held by present anchors.
    present: Marks,
    /// Of each slot those for which the block between the two has been found since this one was taken, (slots): it is known if that is
    /// so of both.
    known: Vec<Marks>,
    /// Displacement of the second per force on the first \[m/N\], (slots x slots) by the first, each column-major, and what is read
    /// beyond the last.
    blocks: Vec<f64>,
    /// Slot of each present anchor, and those of them that are new.
    slots: Vec<u32>,
    new: Vec<u32>,
    /// Slots of the anchors of the last time, in their order.
    before: Vec<u32>,
    /// Slots that are held by others, and for how many looks.
    others: Vec<u32>,
    idle: Vec<u8>,
    /// Looks through which these are held.
    kept: u8,
    /// What a unit force of a row moves each anchor by, (anchors).
    moved: Vec<[f64; LANES]>,
    /// As `moved`, of the row after that.
    also_moved: Vec<[f64; LANES]>,
    /// Of each row on one anchor that, and its direction.
    directions: Vec<(u32, [f64; LANES])>,
    arch: Arch,
}

impl Pairs {
    /// For so many anchors and rows.
    pub fn new(most: usize, most_rows: usize) -> Self {
        Self {
            most,
            factor: 0,
            held: vec![None; most],
            present: Marks::new(most),
            known: vec![Marks::new(most); most],
            blocks: vec![0.0; BLOCK * most * most + LANES - 3],
            slots: Vec::with_capacity(most),
            new: Vec::with_capacity(most),
            before: Vec::with_capacity(most),
            others: Vec::with_capacity(most),
            idle: vec![0; most],
            kept: 0,
            moved: vec![[0.0; LANES]; most],
            also_moved: vec![[0.0; LANES]; most],
            arch: Arch::new(),
            directions: Vec::with_capacity(most_rows),
        }
    }

    /// From now on keeps blocks of anchors that come and go, such as those of vertices that may soon be touched.
    pub fn keep_others(&mut self) {
        self.kept = KEPT;
    }

    /// Finds the blocks between `anchors`, at most as many as there is room for, whose columns are there if the
    /// anchors are new.
    pub fn look(&mut self, anchors: &[Reached], columns: &Columns, factor: u64) {
        if self.factor != factor {
            self.factor = factor;
            self.held.fill(None);
            self.others.clear();
        }
        std::mem::swap(&mut self.slots, &mut self.before);
        self.slots.clear();
        self.new.clear();
        self.present.clear();
        // Anchors mostly come in the order of the last time, but for a few.
        let mut next = 0;
        for anchor in anchors {
            let is = |slot: u32| self.held[slot as usize].as_ref() == Some(anchor);
            let near = self.before.iter().enumerate().skip(next).take(SKIPPED);
            let known = match near.into_iter().find(|(_, slot)| is(**slot)) {
                Some((place, slot)) => {
                    next = place + 1;
                    Some(*slot)
                }
                None => {
                    let mut all = self.before.iter().chain(&self.others).copied();
                    all.find(|slot| is(*slot))
                }
            };
            if let Some(slot) = known {
                self.present.set(slot);
            }
            self.slots.push(known.unwrap_or(self.most as u32));
        }
        let mut free = 0;
        for (place, anchor) in anchors.iter().enumerate() {
            if (self.slots[place] as usize) < self.most {
                continue;
            }
            // One that came twice has its slot now.
            let twin = self.new.iter().find(|slot| {
                let held = self.held[**slot as usize].as_ref();
                held == Some(anchor)
            });
            if let Some(twin) = twin {
                self.slots[place] = *twin;
                continue;
            }
            while self.held.get(free).is_some_and(Option::is_some) {
                free += 1;
            }
            let slot = if free < self.most {
                free
            } else {
                self.vacate()
            };
            self.slots[place] = slot as u32;
            self.held[slot] = Some(*anchor);
            self.present.set(slot as u32);
            self.new.push(slot as u32);
            self.known[slot].clear();
        }
        self.age(columns);
        self.fill(columns);
    }

    /// A slot that no present anchor holds, where all are held: there are no more anchors than slots.
    fn vacate(&self) -> usize {
        let mut slots = 0..self.most;
        slots
            .find(|slot| !self.present.has(*slot as u32))
            .unwrap_or(0)
    }

    /// Blocks between present anchors that are not known, each from the columns of the lower: the bits of a block do not
    /// depend on which of its anchors came first.
    fn fill(&mut self, columns: &Columns) {
        for one in self.present.each() {
            let mut known = std::mem::take(&mut self.known[one as usize]);
            for other in self.present.each_but(&known) {
                let (one, other) = (one as usize, other as usize);
                let (Some(from), Some(to)) = (&self.held[one], &self.held[other]) else {
                    continue;
                };
                let (low, high, pushed, at) = if from.is_lower_than(to) {
                    (one, other, from, to)
                } else {
                    (other, one, to, from)
                };
                let block = self.arch.dispatch(Moves {
                    at,
                    pushed,
                    columns,
                });
                let place = |from: usize, to: usize| BLOCK * (from * self.most + to);
                let forth = &mut self.blocks[place(low, high)..][..BLOCK];
                forth.copy_from_slice(&block);
                let back = &mut self.blocks[place(high, low)..][..BLOCK];
                let transposed = Matrix3::from_row_slice(&block);
                back.copy_from_slice(transposed.as_slice());
                if other != one {
                    self.known[other].set(one as u32);
                }
            }
            known.set_all(&self.present);
            self.known[one as usize] = known;
        }
    }

    /// Forgets what has not been among the present ones for long, and what has lost its columns.
    fn age(&mut self, columns: &Columns) {
        self.others.clear();
        for (slot, held) in (0u32..).zip(&mut self.held) {
            let idle = &mut self.idle[slot as usize];
            if self.present.has(slot) {
                *idle = 0;
            } else if let Some(other) = held {
                *idle += 1;
                let has_columns = other.parts().all(|(vertex, _)| columns.has(vertex));
                if *idle > self.kept || !has_columns {
                    *held = None;
                } else {
                    self.others.push(slot);
                }
            }
        }
    }

    /// Displacement of a present anchor per force on another \[m/N\].
    pub fn block(&self, at: usize, pushed: usize) -> Matrix3<f64> {
        let first = BLOCK * (self.slots[pushed] as usize * self.most + self.slots[at] as usize);
        Matrix3::from_column_slice(&self.blocks[first..first + BLOCK])
    }

    /// Brings into the caches what [`Self::project`] will read if the anchors stay: of each the blocks with those before it.
    pub fn touch(&self) {
        let blocks = Blocks::new(self.most, &self.blocks, &self.slots);
        for anchor in 0..self.slots.len() {
            blocks.until(anchor, anchor + 1).for_each(touch);
        }
    }

    /// Displacements of all present anchors \[m\] under `forces` on them \[N\], (anchors) each.
    pub fn displace(&self, forces: &[Vector3<f64>], moved_m: &mut [Vector3<f64>]) {
        moved_m.fill(Vector3::zeros());
        let acts = |force: &Vector3<f64>| *force != Vector3::zeros();
        for (b, on_b) in forces.iter().enumerate().filter(|(_, force)| acts(force)) {
            for (a, on_a) in forces.iter().enumerate() {
                // A block between two that act serves both: most of the time goes into reading it.
                let both = acts(on_a);
                if both && a > b {
                    continue;
                }
                let block = self.block(a, b);
                moved_m[a] += block * on_b;
                if both && a < b {
                    moved_m[b] += block.tr_mul(on_a);
                }
            }
        }
    }

    /// Fills `w` (n x n, column-major, both triangles), n the number of `rows` and `spread` rows, with the former
    /// first, which are in the order of their anchors; `first_row` (anchors + 1) says where each anchor's rows
    /// begin.
    pub fn project(
        &mut self,
        rows: &[PointConstraint],
        first_row: &[u32],
        spread: &Spread,
        w: &mut [f64],
    ) {
        let n = rows.len() + spread.rows.len();
        let anchors = self.slots.len();
        let directions = rows.iter().map(|row| {
            let [x, y, z] = row.direction;
            (row.anchor, [x, y, z, 0.0])
        });
        self.directions.clear();
        self.directions.extend(directions);
        self.arch.dispatch(Projection {
            blocks: Blocks::new(self.most, &self.blocks, &self.slots),
            directions: &self.directions,
            first_row,
            spread,
            moved: &mut self.moved[..anchors],
            also_moved: &mut self.also_moved[..anchors],
            w,
        });
        mirror(w, n);
    }
}

/// Blocks between the present anchors.
#[derive(Clone, Copy)]
struct Blocks<'a> {
    /// From the blocks of one slot to those of the next.
    stride: usize,
    numbers: &'a [f64],
    slots: &'a [u32],
}

impl<'a> Blocks<'a> {
    /// Of so many slots, and of those of the present anchors.
    fn new(most: usize, numbers: &'a [f64], slots: &'a [u32]) -> Self {
        let stride = BLOCK * most;
        Self {
            stride,
            numbers,
            slots,
        }
    }

    /// Blocks of an anchor with those up to another.
    #[inline(always)]
    fn until(self, anchor: usize, until: usize) -> impl Iterator<Item = &'a [f64]> {
        let first = self.slots[anchor] as usize * self.stride;
        let blocks = &self.numbers[first..first + self.stride];
        let slots = self.slots[..until].iter();
        slots.map(move |slot| {
            let first = BLOCK * *slot as usize;
            &blocks[first..first + BLOCK]
        })
    }

    /// A row on several anchors gives way no more than this \[m/N\].
    fn most_own(self, terms: &[Term]) -> f64 {
        let each = terms.iter().map(|term| {
            let slot = self.slots[term.anchor as usize] as usize;
            let own = &self.numbers[slot * (self.stride + BLOCK)..][..BLOCK];
            Vector3::from(term.direction).norm_squared() * (own[0] + own[4] + own[8])
        });
        terms.len() as f64 * each.sum::<f64>()
    }

    /// Blocks of an anchor with all, in their order, each with a number of no meaning after it. What will be read for the `next` one is asked
    /// for meanwhile: all at once would be more than a processor remembers.
    #[inline(always)]
    fn of(self, anchor: usize, next: Option<usize>) -> impl Iterator<Item = &'a [f64]> {
        let of_slot = move |anchor: usize| {
            let first = self.slots[anchor] as usize * self.stride;
            &self.numbers[first..first + self.stride + LANES - 3]
        };
        let (blocks, ahead) = (of_slot(anchor), next.map(of_slot));
        self.slots.iter().map(move |slot| {
            let first = BLOCK * *slot as usize;
            if let Some(ahead) = ahead {
                fetch_line(&ahead[first]);
                fetch_line(&ahead[first + BLOCK - 1]);
            }
            &blocks[first..first + BLOCK + LANES - 3]
        })
    }
}

/// What a force moves an anchor by, and a fourth number of no meaning; of one of [`Blocks::of`].
#[inline(always)]
fn moved_by(block: &[f64], force: &[f64; LANES]) -> [f64; LANES] {
    let [fx, fy, fz, _] = *force;
    std::array::from_fn(|lane| {
        let [x, y, z] = [block[lane], block[lane + 3], block[lane + 6]];
        x * fx + y * fy + z * fz
    })
}

/// What [`Pairs::project`] does on the processor at hand.
struct Projection<'a> {
    blocks: Blocks<'a>,
    /// Of each single row its anchor, and its direction.
    directions: &'a [(u32, [f64; LANES])],
    first_row: &'a [u32],
    spread: &'a Spread,
    /// What forces move each anchor by, (anchors).
    moved: &'a mut [[f64; LANES]],
    /// As `moved`, of the row after that.
    also_moved: &'a mut [[f64; LANES]],
    w: &'a mut [f64],
}

// Not closures: those are not inlined into the function compiled for the processor at hand.
impl WithSimd for Projection<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _simd: S) {
        self.fill_single();
        self.fill_spread();
    }
}

impl Projection<'_> {
    fn rows(&self) -> usize {
        self.directions.len() + self.spread.rows.len()
    }

    /// The upper triangle's columns of single rows.
    #[inline(always)]
    fn fill_single(&mut self) {
        let n = self.rows();
        let anchors = self.moved.len();
        for anchor in 0..anchors {
            let [first, end] =
                [self.first_row[anchor], self.first_row[anchor + 1]].map(|row| row as usize);
            let mut next = (anchor + 1 < anchors).then_some(anchor + 1);
            // Two at a time: a block that is read serves both.
            for column in (first..end).step_by(2) {
                let blocks = self.blocks.of(anchor, next.take());
                let columns = &mut self.w[n * column..];
                let one = self.directions[column].1;
                if column + 1 < end {
                    let other = self.directions[column + 1].1;
                    for ((moved, also), block) in self.moved[..=anchor]
                        .iter_mut()
                        .zip(&mut *self.also_moved)
                        .zip(blocks)
                    {
                        *moved = moved_by(block, &one);
                        *also = moved_by(block, &other);
                    }
                    along(self.also_moved, &self.directions[..end], &mut columns[n..]);
                } else {
                    for (moved, block) in self.moved[..=anchor].iter_mut().zip(blocks) {
                        *moved = moved_by(block, &one);
                    }
                }
                along(self.moved, &self.directions[..end], columns);
            }
        }
    }

    /// The upper triangle's columns of rows on several anchors. Backwards: what a thread has beyond one place after the other is
    /// so a sum that grows.
    #[inline(always)]
    fn fill_spread(&mut self) {
        let (n, single) = (self.rows(), self.directions.len());
        self.moved.fill([0.0; LANES]);
        let mut known: &[Term] = &[];
        for (index, row) in self.spread.rows.iter().enumerate().rev() {
            let column = single + index;
            let terms = self.spread.terms_of(row);
            if changes(known, terms).count() > terms.len() {
                known = &[];
                self.moved.fill([0.0; LANES]);
            }
            let mut changes = changes(known, terms).peekable();
            while let Some((anchor, change)) = changes.next() {
                let next = changes.peek().map(|(next, _)| *next as usize);
                let blocks = self.blocks.of(anchor as usize, next);
                let force = [change.x, change.y, change.z, 0.0];
                for (moved, block) in self.moved.iter_mut().zip(blocks) {
                    let more = moved_by(block, &force);
                    *moved = std::array::from_fn(|lane| moved[lane] + more[lane]);
                }
            }
            known = terms;
            let entries = &mut self.w[n * column..n * (column + 1)];
            along(self.moved, self.directions, entries);
            for (entry, before) in entries[single..]
                .iter_mut()
                .zip(&self.spread.rows[..=index])
            {
                let parts = self.spread.terms_of(before).iter().map(|term| {
                    let [x, y, z, _] = self.moved[term.anchor as usize];
                    Vector3::new(x, y, z).dot(&Vector3::from(term.direction))
                });
                *entry = parts.sum();
            }
            let own = &mut self.w[(n + 1) * column];
            // What gives way besides the tissue.
            *own = own.max(ROUND_OFF * self.blocks.most_own(terms)) + row.compliance_m_per_n;
        }
    }
}

/// How far `moved` anchors go along `rows`, into the first of `entries`, (rows).
#[inline(always)]
fn along(moved: &[[f64; LANES]], rows: &[(u32, [f64; LANES])], entries: &mut [f64]) {
    let part = |(anchor, direction): &(u32, [f64; LANES])| -> [f64; LANES] {
        let moved = &moved[*anchor as usize];
        std::array::from_fn(|lane| moved[lane] * direction[lane])
    };
    let (entries, last) = entries[..rows.len()].as_chunks_mut::<LANES>();
    let (rows, last_rows) = rows.as_chunks::<LANES>();
    for (entries, rows) in entries.iter_mut().zip(rows) {
        let parts = rows.each_ref().map(part);
        *entries = std::array::from_fn(|row| parts[row][0] + parts[row][1] + parts[row][2]);
    }
    for (entry, row) in last.iter_mut().zip(last_rows) {
        let [x, y, z, _] = part(row);
        *entry = x + y + z;
    }
}

/// What has to be added to the first of two sums to make it the second: anchors, and by how much their directions change.
fn changes<'a>(
    from: &'a [Term],
    to: &'a [Term],
) -> impl Iterator<Item = (u32, Vector3<f64>)> + use<'a> {
    let (mut from, mut to) = (from.iter().peekable(), to.iter().peekable());
    std::iter::from_fn(move || {
        loop {
            let (gone, come) = match (from.peek(), to.peek()) {
                (None, None) => return None,
                (Some(a), Some(b)) if a.anchor == b.anchor => (from.next(), to.next()),
                (Some(a), Some(b)) if b.anchor < a.anchor => (None, to.next()),
                (Some(_), _) => (from.next(), None),
                (None, Some(_)) => (None, to.next()),
            };
            let direction = |term: Option<&Term>| {
                term.map_or_else(Vector3::zeros, |term| Vector3::from(term.direction))
            };
            let change = direction(come) - direction(gone);
            if let Some(term) = come.or(gone)
                && change != Vector3::zeros()
            {
                return Some((term.anchor, change));
            }
        }
    })
}

/// Side of the squares in which a matrix is mirrored: a line of memory is read and written as a whole.
const SIDE: usize = 16;

/// Copies the upper triangle of `w` (n x n, column-major) to the lower.
fn mirror(w: &mut [f64], n: usize) {
    for first in (0..n).step_by(SIDE) {
        for from in (first..n).step_by(SIDE) {
            for column in from..(from + SIDE).min(n) {
                for row in first..(first + SIDE).min(column) {
                    w[n * row + column] = w[n * column + row];
                }
            }
        }
    }
}
