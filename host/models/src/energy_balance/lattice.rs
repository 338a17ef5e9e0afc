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
    /// Inverse block of each node, by columns; zero where held and after the last, (n + 1).
    own: Vec<[[T; 4]; 3]>,
    places: Vec<Place<T>>,
    cuboids: Vec<Cuboid<T>>,
    points: usize,
    /// Dense inverse on the lattice, (3 points x 3 points).
    inverse: Vec<T>,
    dense: Vec<f64>,
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
        Self {
            blocks: stiffness(mesh, laws),
            own: vec![[zero; 3]; rows_for(mesh.points_m().len())],
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
    /// `inertia` \[N/m\].
    pub fn hold(&mut self, free: &[[T; 4]], inertia: &[[T; 4]]) {
        let is_free = |node: u32| free[node as usize][0].wide() > 0.0;
        for own in &mut self.own {
            *own = [[T::default(); 4]; 3];
        }
        let size = 3 * self.points;
        self.dense.fill(0.0);
        for (i, j, block) in &self.blocks {
            if !(is_free(*i) && is_free(*j)) {
                continue;
            }
            let mut block = *block;
            if i == j {
                block += Matrix3::from_diagonal_element(inertia[*i as usize][0].wide());
                if let Some(inverse) = block.try_inverse() {
                    for c in 0..3 {
                        for r in 0..3 {
                            self.own[*i as usize][c][r] = T::of(inverse[(r, c)]);
                        }
                    }
                }
            }
            if self.points == 0 {
                continue;
            }
            let (a, b) = (&self.places[*i as usize], &self.places[*j as usize]);
            for (p, wp) in a.points.iter().zip(a.weights) {
                for (q, wq) in b.points.iter().zip(b.weights) {
                    let weight = wp.wide() * wq.wide();
                    for r in 0..3 {
                        for c in 0..3 {
                            let (row, column) = (3 * *p as usize + r, 3 * *q as usize + c);
                            self.dense[row * size + column] += weight * block[(r, c)];
                            if i != j {
                                self.dense[column * size + row] += weight * block[(r, c)];
                            }
                        }
                    }
                }
            }
        }
        invert(&mut self.dense, &mut self.row);
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

/// Inverse of a symmetric matrix without negative eigenvalues, in place, by Gauss-Jordan; directions that nothing
/// holds get none. `pivot_row` is as long as a row.
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
