//! A rough inverse of the stiffness at rest: each node by itself, and a lattice for what is smooth.
//!
//! Entry points: [`Rough::new`], [`Rough::hold`], [`Rough::own`], [`Rough::add_smooth`]. Steps from cell to cell carry a load one
//! cell further each; the lattice, coarse enough for a dense inverse, carries it everywhere at once
//! (additive two-level Schwarz). It only speeds up the way: the point of balance does not depend on it.

use super::cells::{Rest, law_of};
use super::nodes::{Field, Rows, rows_for};
use super::number::Float;
use crate::law::Law;
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use std::collections::BTreeMap;
use sutura_mesh::TetMesh;

/// Lattice points around a node and their trilinear weights.
#[derive(Clone, Copy, Debug)]
struct Place<T> {
    points: [u32; 8],
    weights: [T; 8],
}

/// A box of the lattice and the nodes in it.
#[derive(Clone, Debug)]
struct Cuboid<T> {
    /// Points at which its four edges along x begin.
    edges: [usize; 4],
    members: Vec<Member<T>>,
}

/// A node in a box: its weights of the sides x = 0 and x = 1, zero where it is held, and of the four edges.
#[derive(Clone, Debug)]
struct Member<T> {
    node: u16,
    sides: [T; 2],
    edges: [T; 4],
}

/// The rough inverse.
#[derive(Clone, Debug)]
pub(super) struct Rough<T> {
    /// Blocks of the stiffness at rest \[N/m\]: (i, j) with i <= j.
    blocks: Vec<(u32, u32, Matrix3<f64>)>,
    /// Blocks that a node is in, node by node, and where each node's begin, (n + 1).
    blocks_of: Vec<u32>,
    begin: Vec<u32>,
    /// What the inverse is for: inertia of each free node \[N/m\], none where held, (n).
    free: Vec<Option<f64>>,
    /// Inverse block of each node, by columns; zero where held and after the last, (n + 1).
    own: Vec<[[T; 4]; 3]>,
    places: Vec<Place<T>>,
    cuboids: Vec<Cuboid<T>>,
    points: usize,
    /// Stiffness of the free nodes between points \[N/m\], its inverse, and that as visits read it, (3 points x 3 points).
    stiffness: Vec<f64>,
    dense: Vec<f64>,
    inverse: Vec<T>,
    row: Vec<f64>,
    /// At the points: (points), and packed, (3 points).
    smooth: Vec<[T; 4]>,
    load: Vec<T>,
    answer: Vec<T>,
}

impl<T: Float> Rough<T> {
    pub fn new(mesh: &TetMesh, laws: &[Law], most_points: usize) -> Self {
        let (places, cuboids) = lattice(mesh, most_points);
        let used = places.iter().flat_map(|place| place.points);
        let points = used.max().map_or(0, |last| last as usize + 1);
        let zero = [T::default(); 4];
        let nodes = mesh.points_m().len();
        let blocks = stiffness(mesh, laws);
        let (begin, blocks_of) = by_node(&blocks, nodes);
        Self {
            blocks,
            blocks_of,
            begin,
            // Nothing is in the stiffness yet.
            free: vec![None; nodes],
            stiffness: vec![0.0; 9 * points * points],
            own: vec![[zero; 3]; rows_for(nodes)],
            places,
            cuboids,
            points,
            inverse: vec![T::default(); 9 * points * points],
            dense: vec![0.0; 9 * points * points],
            row: vec![0.0; 3 * points],
            smooth: vec![zero; points],
            load: vec![T::default(); 3 * points],
            answer: vec![T::default(); 3 * points],
        }
    }

    /// Mean diagonal of each node's own block \[N/m\], (n).
    pub fn own_stiffness(&self) -> Vec<f64> {
        let mut own = vec![0.0; self.own.len()];
        for (i, j, block) in &self.blocks {
            if i == j {
                own[*i as usize] = block.trace() / 3.0;
            }
        }
        own
    }

    /// Makes ready for nodes of which some are `free` (1, the others 0; n + 1), each with a further
    /// `inertia` \[N/m\]. Costs what has changed, and the inverse: tools take and leave a few nodes at a time.
    pub fn hold(&mut self, arch: Arch, free: &[[T; 4]], inertia: &[[T; 4]]) {
        let mut has_changed = false;
        for node in 0..self.free.len() {
            let before = self.free[node];
            let is_free = free[node][0].wide() > 0.0;
            let now = is_free.then(|| inertia[node][0].wide());
            if now == before {
                continue;
            }
            has_changed = true;
            if now.is_none() {
                self.weigh(node, -1.0);
            }
            self.free[node] = now;
            if before.is_none() {
                self.weigh(node, 1.0);
            }
            self.weigh_inertia(node, now.unwrap_or(0.0) - before.unwrap_or(0.0));
            self.own[node] = self.own_inverse(node);
        }
        if !has_changed {
            return;
        }
        self.dense.copy_from_slice(&self.stiffness);
        arch.dispatch(Invert {
            matrix: &mut self.dense,
            row: &mut self.row,
        });
        for (to, from) in self.inverse.iter_mut().zip(&self.dense) {
            *to = T::of(*from);
        }
        for cuboid in &mut self.cuboids {
            for member in &mut cuboid.members {
                let node = member.node as usize;
                let free = free[node][0];
                member.sides = self.places[node].sides().map(|side| side * free);
            }
        }
    }

    fn blocks_of(&self, node: usize) -> &[u32] {
        &self.blocks_of[self.begin[node] as usize..self.begin[node + 1] as usize]
    }

    /// Adds the stiffness of a free node and between it and its free neighbours to that of the points, `sign` times.
    fn weigh(&mut self, node: usize, sign: f64) {
        let size = 3 * self.points;
        if size == 0 {
            return;
        }
        for index in self.begin[node]..self.begin[node + 1] {
            let (i, j, block) = self.blocks[self.blocks_of[index as usize] as usize];
            let (i, j) = (i as usize, j as usize);
            if self.free[i].is_none() || self.free[j].is_none() {
                continue;
            }
            let (a, b) = (&self.places[i], &self.places[j]);
            for (p, wp) in a.points.iter().zip(a.weights) {
                for (q, wq) in b.points.iter().zip(b.weights) {
                    let weight = sign * wp.wide() * wq.wide();
                    for r in 0..3 {
                        for c in 0..3 {
                            let (row, column) = (3 * *p as usize + r, 3 * *q as usize + c);
                            self.stiffness[row * size + column] += weight * block[(r, c)];
                            if i != j {
                                self.stiffness[column * size + row] += weight * block[(r, c)];
                            }
                        }
                    }
                }
            }
        }
    }

    /// Adds a node's inertia \[N/m\] to the stiffness of the points.
    fn weigh_inertia(&mut self, node: usize, inertia: f64) {
        let size = 3 * self.points;
        if size == 0 || inertia == 0.0 {
            return;
        }
        let place = &self.places[node];
        for (p, wp) in place.points.iter().zip(place.weights) {
            for (q, wq) in place.points.iter().zip(place.weights) {
                for c in 0..3 {
                    let (row, column) = (3 * *p as usize + c, 3 * *q as usize + c);
                    self.stiffness[row * size + column] += wp.wide() * wq.wide() * inertia;
                }
            }
        }
    }

    /// Inverse of a node's own stiffness and inertia \[m/N\], by columns; zero where it is held.
    fn own_inverse(&self, node: usize) -> [[T; 4]; 3] {
        let mut own = [[T::default(); 4]; 3];
        let Some(inertia) = self.free[node] else {
            return own;
        };
        let blocks = self.blocks_of(node).iter();
        let mut blocks = blocks.map(|index| &self.blocks[*index as usize]);
        let block = blocks.find(|(i, j, _)| i == j).map(|(_, _, block)| block);
        let whole = block.map(|block| block + Matrix3::from_diagonal_element(inertia));
        if let Some(inverse) = whole.and_then(|whole| whole.try_inverse()) {
            for c in 0..3 {
                for r in 0..3 {
                    own[c][r] = T::of(inverse[(r, c)]);
                }
            }
        }
        own
    }

    /// Inverse block of each node, by columns; zero where held, (n + 1).
    #[inline(always)]
    pub fn own(&self) -> &[[[T; 4]; 3]] {
        &self.own
    }

    /// Adds the smooth part of the answer to residual `g` to `z`, both (n + 1); none at held nodes.
    #[inline(always)]
    pub fn add_smooth(&mut self, g: &Field<T>, z: &mut Field<T>) {
        if self.points > 0 {
            self.restrict(g.rows());
            self.answer();
            self.interpolate(z.rows_mut());
        }
    }

    /// Residual of the nodes to the points.
    #[inline(always)]
    fn restrict(&mut self, g: &Rows<T>) {
        self.smooth.fill([T::default(); 4]);
        for cuboid in &self.cuboids {
            // Both ends of an edge side by side.
            let mut sums = [[T::default(); 8]; 4];
            for member in &cuboid.members {
                let g = &g[member.node as usize];
                let mut ends = [T::default(); 8];
                for c in 0..4 {
                    ends[c] = member.sides[0] * g[c];
                    ends[4 + c] = member.sides[1] * g[c];
                }
                for (sum, weight) in sums.iter_mut().zip(member.edges) {
                    for c in 0..8 {
                        sum[c] = weight.fma(ends[c], sum[c]);
                    }
                }
            }
            for (edge, sum) in cuboid.edges.iter().zip(sums) {
                let points = &mut self.smooth.as_flattened_mut()[4 * edge..4 * edge + 8];
                for (point, sum) in points.iter_mut().zip(sum) {
                    *point += sum;
                }
            }
        }
    }

    /// Answer of the points to their load.
    #[inline(always)]
    fn answer(&mut self) {
        for (load, smooth) in self.load.chunks_exact_mut(3).zip(&self.smooth) {
            load.copy_from_slice(&smooth[..3]);
        }
        self.answer.fill(T::default());
        let width = self.answer.len();
        let rows = self.inverse.chunks_exact(3 * width);
        for (load, rows) in self.load.chunks_exact(3).zip(rows) {
            let (first, rest) = rows.split_at(width);
            let (second, third) = rest.split_at(width);
            let rows = first.iter().zip(second).zip(third);
            for (a, ((x, y), z)) in self.answer.iter_mut().zip(rows) {
                *a = x.fma(load[0], y.fma(load[1], z.fma(load[2], *a)));
            }
        }
        for (smooth, answer) in self.smooth.iter_mut().zip(self.answer.chunks_exact(3)) {
            smooth[..3].copy_from_slice(answer);
        }
    }

    /// Answer of the points to the nodes.
    #[inline(always)]
    fn interpolate(&self, z: &mut Rows<T>) {
        for cuboid in &self.cuboids {
            let mut edges = [[T::default(); 8]; 4];
            for (points, edge) in edges.iter_mut().zip(cuboid.edges) {
                points.copy_from_slice(&self.smooth.as_flattened()[4 * edge..4 * edge + 8]);
            }
            for member in &cuboid.members {
                let mut ends = [T::default(); 8];
                for (edge, weight) in edges.iter().zip(member.edges) {
                    for c in 0..8 {
                        ends[c] = weight.fma(edge[c], ends[c]);
                    }
                }
                let z = &mut z[member.node as usize];
                for c in 0..4 {
                    let sum = member.sides[0].fma(ends[c], z[c]);
                    z[c] = member.sides[1].fma(ends[4 + c], sum);
                }
            }
        }
    }
}

/// Stiffness of every pair of nodes at rest.
fn stiffness(mesh: &TetMesh, laws: &[Law]) -> Vec<(u32, u32, Matrix3<f64>)> {
    let mut blocks: BTreeMap<(u32, u32), Matrix3<f64>> = BTreeMap::new();
    for (index, cell) in mesh.cells().iter().enumerate() {
        let rest = Rest::of(mesh, *cell);
        let law = law_of(laws, index);
        for (node_j, gradient_j) in cell.iter().zip(&rest.gradients) {
            for axis in 0..3 {
                let df = Vector3::ith(axis, 1.0) * gradient_j.transpose();
                let dp = law.stress_change(&Matrix3::identity(), &df) * rest.volume;
                for (node_i, gradient_i) in cell.iter().zip(&rest.gradients) {
                    if node_i <= node_j {
                        let block = blocks.entry((*node_i, *node_j)).or_default();
                        let column = block.column(axis) + dp * gradient_i;
                        block.set_column(axis, &column);
                    }
                }
            }
        }
    }
    blocks.into_iter().map(|((i, j), k)| (i, j, k)).collect()
}

impl<T: Float> Place<T> {
    /// Weights of the sides x = 0 and x = 1.
    fn sides(&self) -> [T; 2] {
        let sum = |first: usize| {
            let weights = [0, 2, 4, 6].map(|k| self.weights[first + k].wide());
            T::of(weights.iter().sum())
        };
        [sum(0), sum(1)]
    }

    /// Weights of the edges along x.
    fn edges(&self) -> [T; 4] {
        let w = &self.weights;
        [0, 2, 4, 6].map(|k| T::of(w[k].wide() + w[k + 1].wide()))
    }
}

/// Trilinear places of all nodes on the finest box lattice with at most `most` points, and its boxes.
fn lattice<T: Float>(mesh: &TetMesh, most: usize) -> (Vec<Place<T>>, Vec<Cuboid<T>>) {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = Vector3::repeat(f64::NEG_INFINITY);
    for point in mesh.points_m() {
        low = low.inf(&Vector3::from(*point));
        high = high.sup(&Vector3::from(*point));
    }
    let extent = high - low;
    // A lattice as fine as the mesh has motions that no node feels: its inverse would be all rounding.
    let most = most.min(mesh.points_m().len() / 8);
    if most < 8 {
        return (Vec::new(), Vec::new());
    }
    let mut edge = extent.max() / 32.0;
    let boxes = loop {
        let boxes = extent.map(|e| (e / edge).round().max(1.0));
        if boxes.map(|n| n + 1.0).product() <= most as f64 {
            break boxes;
        }
        edge *= 1.02;
    };
    let [nx, ny, _] = [0, 1, 2].map(|c| boxes[c] as usize + 1);
    let mut cuboids: BTreeMap<usize, Cuboid<T>> = BTreeMap::new();
    let mut places = Vec::with_capacity(mesh.points_m().len());
    for (node, point) in mesh.points_m().iter().enumerate() {
        let at = (Vector3::from(*point) - low)
            .component_div(&extent)
            .component_mul(&boxes);
        let corner = at.zip_map(&boxes, |x, n| x.floor().min(n - 1.0).max(0.0));
        let within = at - corner;
        let [x, y, z] = [0, 1, 2].map(|c| corner[c] as usize);
        let first = x + nx * (y + ny * z);
        let edges = [first, first + nx, first + nx * ny, first + nx * ny + nx];
        let mut place = Place {
            points: [0; 8],
            weights: [T::default(); 8],
        };
        for k in 0..8 {
            let upper = [k & 1, k >> 1 & 1, k >> 2];
            let weights = [0, 1, 2].map(|c| {
                if upper[c] == 1 {
                    within[c]
                } else {
                    1.0 - within[c]
                }
            });
            place.points[k] = (edges[k / 2] + upper[0]) as u32;
            place.weights[k] = T::of(weights.iter().product());
        }
        let cuboid = cuboids.entry(first).or_insert_with(|| Cuboid {
            edges,
            members: Vec::new(),
        });
        cuboid.members.push(Member {
            node: node as u16,
            sides: place.sides(),
            edges: place.edges(),
        });
        places.push(place);
    }
    (places, cuboids.into_values().collect())
}

/// Blocks that each node is in: where a node's begin, (n + 1), and their places.
fn by_node(blocks: &[(u32, u32, Matrix3<f64>)], nodes: usize) -> (Vec<u32>, Vec<u32>) {
    let mut of = vec![Vec::new(); nodes];
    for (place, (i, j, _)) in (0u32..).zip(blocks) {
        of[*i as usize].push(place);
        if i != j {
            of[*j as usize].push(place);
        }
    }
    let mut begin = vec![0];
    begin.extend(of.iter().scan(0, |sum, own| {
        *sum += own.len() as u32;
        Some(*sum)
    }));
    (begin, of.concat())
}

/// [`invert`] in the registers that there are; without fused operations, so that its bits are those of any.
struct Invert<'a> {
    matrix: &'a mut [f64],
    row: &'a mut [f64],
}

impl WithSimd for Invert<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        invert(self.matrix, self.row);
    }
}

/// Inverse of a symmetric matrix without negative eigenvalues, in place, by Gauss-Jordan; directions that nothing
/// holds get none. `pivot_row` is as long as a row.
#[inline(always)]
fn invert(a: &mut [f64], pivot_row: &mut [f64]) {
    let n = pivot_row.len();
    let largest = (0..n).fold(0.0, |most: f64, k| most.max(a[k * n + k]));
    for k in 0..n {
        a[k * n + k] += 1e-6 * largest;
        if a[k * n + k] < 1e-5 * largest {
            a[k * n + k] = largest;
        }
    }
    for k in 0..n {
        let pivot = a[k * n + k];
        pivot_row.copy_from_slice(&a[k * n..(k + 1) * n]);
        for (i, row) in a.chunks_exact_mut(n).enumerate() {
            if i == k {
                continue;
            }
            let share = row[k] / pivot;
            for (x, p) in row.iter_mut().zip(pivot_row.iter()) {
                *x -= share * p;
            }
            row[k] = -share;
        }
        for x in &mut a[k * n..(k + 1) * n] {
            *x /= pivot;
        }
        a[k * n + k] = 1.0 / pivot;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use sutura_mesh::slab;

    /// Nodes that come and go leave the inverse that all at once would have had, whatever has changed before.
    #[test]
    fn what_is_held_in_turn_is_as_if_held_at_once() {
        let mesh = slab([0.06, 0.05, 0.04], [6, 5, 4]).expect("a slab");
        let law = Law::neo_hookean(Material {
            youngs_modulus_pa: 3e3,
            poisson_ratio: 0.45,
        });
        let nodes = mesh.points_m().len();
        let new = || Rough::<f64>::new(&mesh, &[law], 20);
        let mut walked = new();
        let state = |step: usize| {
            let mut free = vec![[0.0; 4]; rows_for(nodes)];
            let mut inertia = free.clone();
            for node in 0..nodes {
                // Ever other pieces of the slab, and another inertia for some.
                let is_free = node > 20 && !(node / 7 + step).is_multiple_of(5);
                free[node] = [f64::from(u8::from(is_free)); 4];
                inertia[node] = [if node % 3 == 0 { step as f64 } else { 0.5 }; 4];
            }
            (free, inertia)
        };
        for step in 0..12 {
            let (free, inertia) = state(step);
            walked.hold(Arch::Scalar, &free, &inertia);
            let mut fresh = new();
            fresh.hold(Arch::new(), &free, &inertia);
            assert_eq!(walked.own, fresh.own);
            let largest = fresh
                .inverse
                .iter()
                .fold(0.0f64, |most, x| most.max(x.abs()));
            assert!(largest > 0.0);
            for (a, b) in walked.inverse.iter().zip(&fresh.inverse) {
                assert!((a - b).abs() < 1e-9 * largest, "step {step}: {a} {b}");
            }
        }
        // Against P' K P of the free nodes, point by point.
        let (free, inertia) = state(11);
        let size = 3 * walked.points;
        let mut expected = vec![0.0; size * size];
        for (i, j, block) in &walked.blocks {
            let pairs = if i == j {
                vec![(*i, *j)]
            } else {
                vec![(*i, *j), (*j, *i)]
            };
            for (from, to) in pairs {
                let [from, to] = [from as usize, to as usize];
                if free[from][0] == 0.0 || free[to][0] == 0.0 {
                    continue;
                }
                let mut block = if from == *i as usize {
                    *block
                } else {
                    block.transpose()
                };
                if from == to {
                    block += Matrix3::identity() * inertia[from][0];
                }
                let (a, b) = (&walked.places[from], &walked.places[to]);
                for k in 0..64 {
                    let (p, q) = (a.points[k / 8] as usize, b.points[k % 8] as usize);
                    let weight = a.weights[k / 8] * b.weights[k % 8];
                    for r in 0..9 {
                        expected[(3 * p + r / 3) * size + 3 * q + r % 3] +=
                            weight * block[(r / 3, r % 3)];
                    }
                }
            }
        }
        let largest = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        for (a, b) in walked.stiffness.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-12 * largest, "{a} {b}");
        }
    }

    #[test]
    fn the_inverse_is_one() {
        let n = 7;
        let mut state = 1u64;
        let b = nalgebra::SMatrix::<f64, 7, 7>::from_fn(|_, _| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f64 / f64::from(1 << 24)
        });
        let a = b * b.transpose() + nalgebra::SMatrix::identity();
        let mut inverse: Vec<f64> = a.as_slice().to_vec();
        invert(&mut inverse, &mut vec![0.0; n]);
        let product = a * nalgebra::SMatrix::<f64, 7, 7>::from_column_slice(&inverse);
        assert!((product - nalgebra::SMatrix::identity()).norm() < 1e-3);
    }
}
