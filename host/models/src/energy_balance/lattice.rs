//! A rough inverse of the stiffness at rest: each node by itself, and a lattice for what is smooth.
//!
//! Entry points: [`Rough::new`], [`Rough::hold`], [`Rough::apply`]. Steps from cell to cell carry a load one
//! cell further each; the lattice, coarse enough for a dense inverse, carries it everywhere at once
//! (additive two-level Schwarz). It only speeds up the way: the point of balance does not depend on it.

use super::cells::{Rest, law_of};
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

/// The rough inverse.
#[derive(Clone, Debug)]
pub(super) struct Rough<T> {
    /// Blocks of the stiffness at rest \[N/m\]: (i, j) with i <= j.
    blocks: Vec<(u32, u32, Matrix3<f64>)>,
    /// Inverse block of each node, by columns; zero where held and after the last, (n + 1).
    own: Vec<[[T; 4]; 3]>,
    places: Vec<Place<T>>,
    points: usize,
    /// Dense inverse on the lattice, (4 points x 4 points): the fourth number of a point is not used.
    inverse: Vec<T>,
    dense: Vec<f64>,
    row: Vec<f64>,
    load: Vec<[T; 4]>,
    answer: Vec<[T; 4]>,
}

impl<T: Float> Rough<T> {
    pub fn new(mesh: &TetMesh, laws: &[Law], most_points: usize) -> Self {
        let (places, points) = lattice(mesh, most_points);
        let zero = [T::default(); 4];
        Self {
            blocks: stiffness(mesh, laws),
            own: vec![[zero; 3]; mesh.points_m().len() + 1],
            places,
            points,
            inverse: vec![T::default(); 16 * points * points],
            dense: vec![0.0; 9 * points * points],
            row: vec![0.0; 3 * points],
            load: vec![zero; points],
            answer: vec![zero; points],
        }
    }

    /// Mean diagonal of each node's own block \[N/m\], (n).
    pub fn own_stiffness(&self) -> Vec<f64> {
        let mut own = vec![0.0; self.own.len() - 1];
        for (i, j, block) in &self.blocks {
            if i == j {
                own[*i as usize] = block.trace() / 3.0;
            }
        }
        own
    }

    /// Makes ready for nodes of which some are `free` (1, the others 0; n + 1), each with a further
    /// `inertia` \[N/m\].
    pub fn hold(&mut self, free: &[T], inertia: &[T]) {
        let is_free = |node: u32| free[node as usize].wide() > 0.0;
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
                block += Matrix3::from_diagonal_element(inertia[*i as usize].wide());
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
        for (k, value) in self.dense.iter().enumerate() {
            let (row, column) = (k / size, k % size);
            let at = (4 * (row / 3) + row % 3) * 4 * self.points + 4 * (column / 3) + column % 3;
            self.inverse[at] = T::of(*value);
        }
    }

    /// The correction `z` that answers residual `g`, both (n + 1); zero at nodes that are not `free`.
    #[inline(always)]
    pub fn apply(&mut self, free: &[T], g: &[[T; 4]], z: &mut [[T; 4]]) {
        for ((z, g), own) in z.iter_mut().zip(g).zip(&self.own) {
            for c in 0..4 {
                z[c] = own[2][c].fma(g[2], own[1][c].fma(g[1], own[0][c] * g[0]));
            }
        }
        if self.points == 0 {
            return;
        }
        self.load.fill([T::default(); 4]);
        for (place, g) in self.places.iter().zip(g) {
            for k in 0..8 {
                let load = &mut self.load[place.points[k] as usize];
                for c in 0..4 {
                    load[c] = place.weights[k].fma(g[c], load[c]);
                }
            }
        }
        self.answer.fill([T::default(); 4]);
        let answer = self.answer.as_flattened_mut();
        let width = answer.len();
        for (load, rows) in self.load.iter().zip(self.inverse.chunks_exact(4 * width)) {
            let (first, rest) = rows.split_at(width);
            let (second, rest) = rest.split_at(width);
            let third = &rest[..width];
            for (((a, x), y), w) in answer.iter_mut().zip(first).zip(second).zip(third) {
                *a = x.fma(load[0], y.fma(load[1], w.fma(load[2], *a)));
            }
        }
        for ((place, z), free) in self.places.iter().zip(z).zip(free) {
            let mut sum = [T::default(); 4];
            for k in 0..8 {
                let answer = &self.answer[place.points[k] as usize];
                for c in 0..4 {
                    sum[c] = place.weights[k].fma(answer[c], sum[c]);
                }
            }
            for c in 0..4 {
                z[c] = free.fma(sum[c], z[c]);
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

/// Trilinear places of all nodes on the finest box lattice with at most `most` points in use.
fn lattice<T: Float>(mesh: &TetMesh, most: usize) -> (Vec<Place<T>>, usize) {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = Vector3::repeat(f64::NEG_INFINITY);
    for point in mesh.points_m() {
        low = low.inf(&Vector3::from(*point));
        high = high.sup(&Vector3::from(*point));
    }
    let extent = high - low;
    let mut edge = extent.max() / 32.0;
    // A lattice as fine as the mesh has motions that no node feels: its inverse would be all rounding.
    let most = most.min(mesh.points_m().len() / 8);
    if most < 8 {
        return (Vec::new(), 0);
    }
    loop {
        let counts = extent.map(|e| (e / edge).round().max(1.0));
        let mut numbers: BTreeMap<[u32; 3], u32> = BTreeMap::new();
        let mut places = Vec::with_capacity(mesh.points_m().len());
        for point in mesh.points_m() {
            let at = (Vector3::from(*point) - low)
                .component_div(&extent)
                .component_mul(&counts);
            let corner = at.zip_map(&counts, |x, n| x.floor().min(n - 1.0).max(0.0));
            let within = at - corner;
            let mut place = Place {
                points: [0; 8],
                weights: [T::default(); 8],
            };
            for k in 0..8 {
                let upper = [k & 1, k >> 1 & 1, k >> 2];
                let mut weight = 1.0;
                let mut key = [0; 3];
                for c in 0..3 {
                    key[c] = corner[c] as u32 + upper[c] as u32;
                    weight *= if upper[c] == 1 {
                        within[c]
                    } else {
                        1.0 - within[c]
                    };
                }
                let next = numbers.len() as u32;
                place.points[k] = *numbers.entry(key).or_insert(next);
                place.weights[k] = T::of(weight);
            }
            places.push(place);
        }
        if numbers.len() <= most {
            return (places, numbers.len());
        }
        edge *= 1.1;
    }
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
