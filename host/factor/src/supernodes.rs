//! Triangular solves with a supernodal Cholesky factor, for one or a few right-hand sides.
//!
//! Entry points: [`Supernodes::solve`] for a whole field, [`Supernodes::solve_columns`] for the response
//! to unit loads: its forward sweep follows only the path from their supernodes to the root of
//! the elimination tree (Gilbert & Peierls 1988), its backward sweep leaves out what nobody reads. A
//! solve streams the factor from memory once each way, so the right-hand sides share each load of an
//! entry, and its values lie in the order in which they are read ([`Supernodes::pack`]).
//! Sums run in a fixed order with explicit fused multiply-adds: one set of bits on every processor, whatever
//! else is solved beside it.

use crate::Cholesky;
use crate::fetch::{LINE, fetch_line};
use faer::sparse::linalg::cholesky::SymbolicCholeskyRaw;
use pulp::bytemuck::cast;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Rows that are taken side by side.
const LANES: usize = 4;
/// Most columns of a panel: those of two nodes.
const WIDEST: usize = 6;
/// Values of a factor that are fetched from memory before their turn: what a sweep takes as long for as memory does to answer.
const AHEAD: usize = 1536;

/// Where each supernode's rows and values lie, and which column of the matrix is which.
#[derive(Debug)]
pub struct Supernodes {
    /// First column of each supernode, and the end of the last, (s + 1).
    begin: Vec<u32>,
    /// Where its rows below the diagonal block begin in `rows`, (s + 1).
    row_start: Vec<usize>,
    rows: Vec<u32>,
    /// Where its dense columns begin among the values of a factor, (s), and its panels among those that are packed, (s + 1).
    factor_start: Vec<usize>,
    value_start: Vec<usize>,
    /// The next supernode on the way to the root; the number of supernodes at a root, (s).
    parent: Vec<u32>,
    /// Supernode of each column, (n).
    of_column: Vec<u32>,
    /// Column of the matrix that stands at each place of the factor, and back, (n).
    at_place: Vec<u32>,
    place_of: Vec<u32>,
    most_height: usize,
    arch: Arch,
}

/// Buffers of a solve for K right-hand sides.
#[derive(Clone, Debug)]
pub struct SweepScratch<const K: usize> {
    /// Right-hand sides in the factor's order, one after the other, (K x n).
    x: Vec<f64>,
    /// Rows of one supernode side by side, (K x most height).
    t: Vec<f64>,
    /// Next supernode on each unknown's path to the root.
    heads: [u32; K],
}

impl<const K: usize> SweepScratch<K> {
    /// Some rows of one supernode of each right-hand side, of which there are `most`.
    fn rows(&mut self, most: usize, rows: Range<usize>) -> [&mut [f64]; K] {
        let mut each = self.t.chunks_exact_mut(most);
        std::array::from_fn(|_| match each.next() {
            Some(t) => &mut t[rows.clone()],
            None => &mut [],
        })
    }
}

impl Supernodes {
    /// `None` for a factor that has no supernodes.
    pub fn new(cholesky: &Cholesky) -> Option<Self> {
        let symbolic = &cholesky.symbolic;
        let SymbolicCholeskyRaw::Supernodal(raw) = symbolic.raw() else {
            return None;
        };
        let count = raw.n_supernodes();
        let n = raw.nrows();
        let mut begin: Vec<u32> = raw.supernode_begin().iter().map(|&c| c as u32).collect();
        begin.push(n as u32);
        let mut of_column = vec![0; n];
        for s in 0..count {
            of_column[begin[s] as usize..begin[s + 1] as usize].fill(s as u32);
        }
        let (mut rows, mut row_start) = (Vec::new(), vec![0]);
        let mut parent = Vec::with_capacity(count);
        for s in 0..count {
            let pattern = raw.supernode(s).pattern();
            // Rows ascend: the first is the nearest ancestor.
            let first = pattern.iter().min();
            parent.push(first.map_or(count as u32, |&row| of_column[row]));
            rows.extend(pattern.iter().map(|&row| row as u32));
            row_start.push(rows.len());
        }
        let mut value_start = vec![0];
        for s in 0..count {
            let width = (begin[s + 1] - begin[s]) as usize;
            let height = width + row_start[s + 1] - row_start[s];
            let packed = panels(width).map(|(j, some)| some * (height - j));
            value_start.push(value_start[s] + packed.sum::<usize>());
        }
        let identity = || (0..n as u32).collect();
        let (at_place, place_of) = match symbolic.perm() {
            Some(perm) => {
                let (forward, inverse) = perm.arrays();
                let narrow = |order: &[usize]| order.iter().map(|&i| i as u32).collect();
                (narrow(forward), narrow(inverse))
            }
            None => (identity(), identity()),
        };
        Some(Self {
            most_height: (0..count)
                .map(|s| (begin[s + 1] - begin[s]) as usize + row_start[s + 1] - row_start[s])
                .max()
                .unwrap_or(0),
            begin,
            row_start,
            rows,
            factor_start: raw.col_ptr_for_val()[..count].to_vec(),
            value_start,
            parent,
            of_column,
            at_place,
            place_of,
            arch: Arch::new(),
        })
    }

    fn count(&self) -> usize {
        self.parent.len()
    }

    /// Columns of the matrix.
    pub fn unknowns(&self) -> usize {
        self.at_place.len()
    }

    /// Values that a packed factor has.
    pub fn entries(&self) -> usize {
        self.value_start.last().copied().unwrap_or_default()
    }

    /// Brings the values of a factor to where sweeps read them one after the other, a few columns of a supernode side by side; in place, by
    /// way of `room`, which [`Self::panel_room`] makes. What is beyond [`Self::entries`] has no meaning any more.
    pub fn pack(&self, values: &mut [f64], room: &mut [f64]) {
        for s in 0..self.count() {
            let (width, height) = self.size(s);
            let (start, mut to) = (self.factor_start[s], self.value_start[s]);
            for (j, some) in panels(width) {
                let columns = &values[start + j * height..start + (j + some) * height];
                let packed = &mut room[..some * (height - j)];
                pack_panel(columns, height, j, packed);
                // Never beyond where it comes from.
                values[to..to + packed.len()].copy_from_slice(packed);
                to += packed.len();
            }
        }
    }

    /// Room for the values of any panel.
    pub fn panel_room(&self) -> Vec<f64> {
        vec![0.0; WIDEST * self.most_height]
    }

    /// Columns and rows of a supernode.
    fn size(&self, s: usize) -> (usize, usize) {
        let width = (self.begin[s + 1] - self.begin[s]) as usize;
        (width, width + self.row_start[s + 1] - self.row_start[s])
    }

    /// Buffers for K right-hand sides.
    pub fn scratch<const K: usize>(&self) -> SweepScratch<K> {
        SweepScratch {
            x: vec![0.0; K * self.at_place.len()],
            t: vec![0.0; K * self.most_height],
            heads: [0; K],
        }
    }

    /// Supernodes that a backward sweep must visit to know `unknowns`, descending.
    pub fn needed_for(&self, unknowns: impl Iterator<Item = usize>) -> Vec<u32> {
        let mut needed = vec![false; self.count()];
        for unknown in unknowns {
            let mut s = self.of_column[self.place_of[unknown] as usize] as usize;
            while s < self.count() && !needed[s] {
                needed[s] = true;
                s = self.parent[s] as usize;
            }
        }
        let descending = (0..self.count() as u32).rev();
        descending.filter(|s| needed[*s as usize]).collect()
    }

    /// K^-1 times `rhs` (n), in place, with packed `values`.
    pub fn solve(&self, values: &[f64], rhs: &mut [f64], scratch: &mut SweepScratch<1>) {
        for (x, &column) in scratch.x.iter_mut().zip(&self.at_place) {
            *x = rhs[column as usize];
        }
        self.arch.dispatch(Field {
            supernodes: self,
            values,
            scratch,
        });
        for (x, &column) in scratch.x.iter().zip(&self.at_place) {
            rhs[column as usize] = *x;
        }
    }

    /// Columns of K^-1, with packed `values`, for groups of `unknowns`, one scratch each, of which only what `needed` covers
    /// can be read afterwards, with [`Self::read`]. Groups share the factor's way through the cache and
    /// nothing else: the bits of one do not depend on its company.
    pub fn solve_columns<const K: usize>(
        &self,
        values: &[f64],
        unknowns: &[[usize; K]],
        needed: &[u32],
        scratch: &mut [SweepScratch<K>],
    ) {
        let n = self.at_place.len();
        for (scratch, group) in scratch.iter_mut().zip(unknowns) {
            scratch.x.fill(0.0);
            for (k, unknown) in group.iter().enumerate() {
                let place = self.place_of[*unknown] as usize;
                scratch.x[k * n + place] = 1.0;
                scratch.heads[k] = self.of_column[place];
            }
        }
        self.arch.dispatch(Columns {
            supernodes: self,
            values,
            needed,
            scratch: &mut scratch[..unknowns.len()],
        });
    }

    /// One unknown of every right-hand side after [`Self::solve_columns`].
    pub fn read<const K: usize>(&self, scratch: &SweepScratch<K>, unknown: usize) -> [f64; K] {
        let place = self.place_of[unknown] as usize;
        std::array::from_fn(|k| scratch.x[k * self.at_place.len() + place])
    }

    /// Eliminates the columns of one supernode from those after it. Where it `fetches`, it asks memory for what comes next.
    #[inline(always)]
    fn forward<S: Simd, const K: usize>(
        &self,
        simd: S,
        s: usize,
        values: &[f64],
        scratch: &mut SweepScratch<K>,
        fetches: bool,
    ) {
        let Block {
            first,
            width,
            height,
            rows,
            place,
        } = self.block(s);
        let n = self.at_place.len();
        let most = self.most_height;
        for k in 0..K {
            let t = &mut scratch.t[k * most..k * most + height];
            t[..width].copy_from_slice(&scratch.x[k * n + first..k * n + first + width]);
            t[width..].fill(0.0);
        }
        let mut start = place.start;
        for (j, some) in panels(width) {
            let end = start + some * (height - j);
            let panel = Panel {
                values,
                place: start..end,
                fetches,
            };
            let t = scratch.rows(most, j..height);
            match some {
                1 => panel.eliminate::<S, 1, K>(simd, t),
                2 => panel.eliminate::<S, 2, K>(simd, t),
                3 => panel.eliminate::<S, 3, K>(simd, t),
                4 => panel.eliminate::<S, 4, K>(simd, t),
                5 => panel.eliminate::<S, 5, K>(simd, t),
                _ => panel.eliminate::<S, WIDEST, K>(simd, t),
            }
            start = end;
        }
        for k in 0..K {
            let t = &scratch.t[k * most..k * most + height];
            let x = &mut scratch.x[k * n..(k + 1) * n];
            x[first..first + width].copy_from_slice(&t[..width]);
            for (&row, t) in rows.iter().zip(&t[width..]) {
                x[row as usize] += t;
            }
        }
    }

    /// Whether a right-hand side \[unknowns\] has anything in the columns of a supernode.
    fn acts_on(&self, s: usize, x: &[f64]) -> bool {
        let own = self.begin[s] as usize..self.begin[s + 1] as usize;
        x[own].iter().any(|x| *x != 0.0)
    }

    /// Solves for the columns of one supernode, those after it being known. Where it `fetches`, it asks memory for what comes next.
    #[inline(always)]
    fn backward<S: Simd, const K: usize>(
        &self,
        simd: S,
        s: usize,
        values: &[f64],
        scratch: &mut SweepScratch<K>,
        fetches: bool,
    ) {
        let Block {
            first,
            width,
            height,
            rows,
            place,
        } = self.block(s);
        let n = self.at_place.len();
        let most = self.most_height;
        for k in 0..K {
            let t = &mut scratch.t[k * most..k * most + height];
            let x = &scratch.x[k * n..(k + 1) * n];
            t[..width].copy_from_slice(&x[first..first + width]);
            for (t, &row) in t[width..].iter_mut().zip(rows) {
                *t = x[row as usize];
            }
        }
        let mut end = place.end;
        for (j, some) in panels(width).rev() {
            let start = end - some * (height - j);
            let panel = Panel {
                values,
                place: start..end,
                fetches,
            };
            let t = scratch.rows(most, j..height);
            match some {
                1 => panel.substitute::<S, 1, K>(simd, t),
                2 => panel.substitute::<S, 2, K>(simd, t),
                3 => panel.substitute::<S, 3, K>(simd, t),
                4 => panel.substitute::<S, 4, K>(simd, t),
                5 => panel.substitute::<S, 5, K>(simd, t),
                _ => panel.substitute::<S, WIDEST, K>(simd, t),
            }
            end = start;
        }
        for k in 0..K {
            scratch.x[k * n + first..k * n + first + width]
                .copy_from_slice(&scratch.t[k * most..k * most + width]);
        }
    }

    #[inline(always)]
    fn block(&self, s: usize) -> Block<'_> {
        let (width, height) = self.size(s);
        Block {
            first: self.begin[s] as usize,
            width,
            height,
            rows: &self.rows[self.row_start[s]..self.row_start[s + 1]],
            place: self.value_start[s]..self.value_start[s + 1],
        }
    }
}

/// One supernode: dense columns of the factor, the diagonal block on top.
struct Block<'a> {
    first: usize,
    width: usize,
    height: usize,
    /// Rows below the diagonal block.
    rows: &'a [u32],
    /// Of its values among the packed, see [`Supernodes::pack`].
    place: Range<usize>,
}

/// First columns of a supernode's panels, and how many each has.
fn panels(width: usize) -> impl DoubleEndedIterator<Item = (usize, usize)> + ExactSizeIterator {
    let firsts = (0..width).step_by(WIDEST);
    firsts.map(move |j| (j, WIDEST.min(width - j)))
}

/// Brings `columns` of a supernode, each of so many rows (`height`), to where [`Panel`] has them; the first begins on the diagonal in the
/// row `top`.
fn pack_panel(columns: &[f64], height: usize, top: usize, packed: &mut [f64]) {
    let count = columns.len() / height;
    let below = top + count;
    let left = (height - below) % LANES;
    let (diagonal, rest) = packed.split_at_mut(count * count);
    let (whole, last) = rest.split_at_mut(rest.len() - count * left);
    let (whole, _) = whole.as_chunks_mut::<LANES>();
    for (c, column) in columns.chunks_exact(height).enumerate() {
        let own = &mut diagonal[count * c..count * (c + 1)];
        own[..c].fill(0.0);
        own[c..].copy_from_slice(&column[top + c..below]);
        own[c] = 1.0 / own[c];
        let (lanes, alone) = column[below..].as_chunks::<LANES>();
        for (to, from) in whole.iter_mut().skip(c).step_by(count).zip(lanes) {
            *to = *from;
        }
        for (to, from) in last.iter_mut().skip(c).step_by(count).zip(alone) {
            *to = *from;
        }
    }
}

/// Neighbouring columns of a supernode. Its values: the diagonal block column by column, with the reciprocals of the diagonal and zeros above it;
/// then of [`LANES`] rows below at a time those of the first column, of the second, and so on; then what rows are left, one by one.
struct Panel<'a> {
    /// Of the whole factor, and where its own are.
    values: &'a [f64],
    place: Range<usize>,
    /// Whether memory is asked for what comes next.
    fetches: bool,
}

/// Values of a panel of C columns: of its diagonal block, of rows side by side, and of those that are left.
type Parts<'a, const C: usize> = (&'a [[f64; C]], &'a [[[f64; LANES]; C]], &'a [[f64; C]]);

impl Panel<'_> {
    #[inline(always)]
    fn parts<const C: usize>(&self) -> Parts<'_, C> {
        let (rows, _) = self.values[self.place.clone()].as_chunks::<C>();
        let (diagonal, below) = rows.split_at(C);
        let (whole, left) = below.split_at(below.len() / LANES * LANES);
        let (lanes, _) = whole.as_flattened().as_chunks::<LANES>();
        (diagonal, lanes.as_chunks().0, left)
    }

    /// Asks for what is taken at a time of C columns, from a value on that may be beyond the last.
    #[inline(always)]
    fn fetch<const C: usize>(&self, first: usize) {
        for line in (0..C * LANES).step_by(LINE) {
            if let Some(value) = self.values.get(first + line) {
                fetch_line(value);
            }
        }
    }

    /// Finds the panel's own unknowns and takes them out of the rows below; `t` are all these rows of each right-hand side.
    #[inline(always)]
    fn eliminate<S: Simd, const C: usize, const K: usize>(&self, simd: S, t: [&mut [f64]; K]) {
        let (diagonal, whole, left) = self.parts::<C>();
        for (k, t) in t.into_iter().enumerate() {
            let (own, below) = t.split_at_mut(C);
            let mut x = [0.0; C];
            for c in 0..C {
                let mut value = own[c];
                for before in 0..c {
                    value = diagonal[before][c].mul_add(-x[before], value);
                }
                x[c] = value * diagonal[c][c];
            }
            own.copy_from_slice(&x);
            let factors = x.map(|x| [-x; LANES]);
            let (below, last) = below.as_chunks_mut::<LANES>();
            let mut ahead = self.place.start + AHEAD;
            for (t, columns) in below.iter_mut().zip(whole) {
                // What one right-hand side has asked for serves the others.
                if self.fetches && k == 0 {
                    self.fetch::<C>(ahead);
                    ahead += C * LANES;
                }
                for (column, factor) in columns.iter().zip(&factors) {
                    *t = mul_add(simd, *column, *factor, *t);
                }
            }
            for (t, row) in last.iter_mut().zip(left) {
                for (value, x) in row.iter().zip(&x) {
                    *t = value.mul_add(-x, *t);
                }
            }
        }
    }

    /// Finds the panel's own unknowns from those of the rows below; `t` are all these rows of each right-hand side.
    #[inline(always)]
    fn substitute<S: Simd, const C: usize, const K: usize>(&self, simd: S, t: [&mut [f64]; K]) {
        let (diagonal, whole, left) = self.parts::<C>();
        for (k, t) in t.into_iter().enumerate() {
            let (own, below) = t.split_at_mut(C);
            let (below, last) = below.as_chunks::<LANES>();
            let mut sums = [[0.0; LANES]; C];
            let mut ahead = self.place.end.saturating_sub(AHEAD);
            for (t, columns) in below.iter().zip(whole).rev() {
                if self.fetches && k == 0 {
                    ahead = ahead.saturating_sub(C * LANES);
                    self.fetch::<C>(ahead);
                }
                for (sum, column) in sums.iter_mut().zip(columns) {
                    *sum = mul_add(simd, *column, *t, *sum);
                }
            }
            let mut sums = sums.map(|[a, b, c, d]| (a + b) + (c + d));
            for (t, row) in last.iter().zip(left) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum = value.mul_add(*t, *sum);
                }
            }
            let mut x = [0.0; C];
            for c in (0..C).rev() {
                let mut value = own[c] - sums[c];
                for after in (c + 1..C).rev() {
                    value = diagonal[c][after].mul_add(-x[after], value);
                }
                x[c] = value * diagonal[c][c];
            }
            own.copy_from_slice(&x);
        }
    }
}

/// `a b + c`, lane by lane. Where the processor has registers of so many lanes they are named: what a compiler makes of a loop over them
/// may change with anything else in the crate.
#[inline(always)]
fn mul_add<S: Simd>(simd: S, a: [f64; LANES], b: [f64; LANES], c: [f64; LANES]) -> [f64; LANES] {
    if S::F64_LANES == LANES {
        return cast(simd.mul_add_f64s(cast(a), cast(b), cast(c)));
    }
    let mut sum = c;
    for lane in 0..LANES {
        sum[lane] = a[lane].mul_add(b[lane], c[lane]);
    }
    sum
}

/// Both sweeps over all supernodes.
struct Field<'a> {
    supernodes: &'a Supernodes,
    values: &'a [f64],
    scratch: &'a mut SweepScratch<1>,
}

// Not closures: those are not inlined into the function compiled for the processor at hand.
impl WithSimd for Field<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for s in 0..self.supernodes.count() {
            // Forces act at few nodes: what is below no supernode of theirs stays 0.
            if self.supernodes.acts_on(s, &self.scratch.x) {
                self.supernodes
                    .forward(simd, s, self.values, self.scratch, true);
            }
        }
        for s in (0..self.supernodes.count()).rev() {
            self.supernodes
                .backward(simd, s, self.values, self.scratch, true);
        }
    }
}

/// Forward along the groups' paths to the root, backward over `needed`.
struct Columns<'a, const K: usize> {
    supernodes: &'a Supernodes,
    values: &'a [f64],
    needed: &'a [u32],
    scratch: &'a mut [SweepScratch<K>],
}

impl<const K: usize> WithSimd for Columns<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let count = self.supernodes.count() as u32;
        loop {
            let mut s = count;
            for group in self.scratch.iter() {
                for head in group.heads {
                    s = s.min(head);
                }
            }
            if s == count {
                break;
            }
            // What one group has asked for serves the others.
            let mut fetches = true;
            for group in self.scratch.iter_mut() {
                if group.heads.contains(&s) {
                    self.supernodes
                        .forward(simd, s as usize, self.values, group, fetches);
                    fetches = false;
                    for head in &mut group.heads {
                        if *head == s {
                            *head = self.supernodes.parent[s as usize];
                        }
                    }
                }
            }
        }
        for &s in self.needed {
            for (place, group) in self.scratch.iter_mut().enumerate() {
                self.supernodes
                    .backward(simd, s as usize, self.values, group, place == 0);
            }
        }
    }
}
