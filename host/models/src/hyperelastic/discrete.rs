//! The mesh as a set of nodes, cells and quadrature points.
//!
//! Entry point: [`Discrete::new`]. Linear and averaged cells have four nodes and one point; quadratic
//! cells have ten nodes, with straight edges, and the four-point rule of degree two.

use super::Cells;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use sutura_mesh::{TetMesh, signed_volume};

/// Ends of a cell's edges, in the order of its mid-edge nodes.
pub(super) const EDGES: [(usize, usize); 6] = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)];

/// Barycentric coordinates of the four-point rule: `MANY` at one corner, `FEW` at the others.
const MANY: f64 = 0.585_410_196_624_968_5;
const FEW: f64 = 0.138_196_601_125_010_5;

#[derive(Clone)]
pub(super) struct Discrete {
    pub cells: Cells,
    /// Rest position of every node \[m\], corners first.
    pub rest: Vec<Vector3<f64>>,
    /// Nodes of the mesh; those beyond are mid-edge nodes.
    pub corners: usize,
    /// Ends of each mid-edge node.
    pub ends: Vec<[u32; 2]>,
    /// Mid-edge nodes on the boundary, as indices into `ends`.
    pub boundary_ends: Vec<u32>,
    /// Nodes of a cell: 4 or 10.
    pub per_cell: usize,
    /// Points of a cell: 1 or 4, of the same weight.
    pub per_point: usize,
    /// Nodes of all cells, (m x `per_cell`).
    pub nodes: Vec<u32>,
    /// Volume of each cell \[m^3\].
    pub volume: Vec<f64>,
    /// Gradients of the barycentric coordinates of each cell \[1/m\], (m x 4).
    pub barycentric: Vec<[Vector3<f64>; 4]>,
    /// Gradients of the shape functions at each point \[1/m\], (m x `per_point` x `per_cell`).
    pub gradients: Vec<Vector3<f64>>,
}

impl Discrete {
    pub fn new(mesh: &TetMesh, cells: Cells) -> Self {
        let mut rest: Vec<Vector3<f64>> =
            mesh.points_m().iter().map(|&p| Vector3::from(p)).collect();
        let corners = rest.len();
        let mut edge_node: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        if cells == Cells::Quadratic {
            for cell in mesh.cells() {
                for (a, b) in EDGES {
                    edge_node.insert(edge(cell[a], cell[b]), 0);
                }
            }
        }
        for (index, node) in edge_node.values_mut().enumerate() {
            *node = (corners + index) as u32;
        }
        let ends: Vec<[u32; 2]> = edge_node.keys().copied().collect();
        rest.extend(
            ends.iter()
                .map(|&[a, b]| {
                    0.5 * (Vector3::from(mesh.points_m()[a as usize])
                        + Vector3::from(mesh.points_m()[b as usize]))
                })
                .collect::<Vec<_>>(),
        );
        let mut boundary_ends: Vec<u32> = mesh
            .surface()
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)])
            .filter_map(|edge| edge_node.get(&edge))
            .map(|node| node - corners as u32)
            .collect();
        boundary_ends.sort_unstable();
        boundary_ends.dedup();

        let (per_cell, points): (usize, Vec<[f64; 4]>) = match cells {
            Cells::Linear | Cells::Averaged => (4, vec![[0.25; 4]]),
            Cells::Quadratic => (
                10,
                (0..4)
                    .map(|point| std::array::from_fn(|c| if c == point { MANY } else { FEW }))
                    .collect(),
            ),
        };
        let mut this = Self {
            cells,
            rest,
            corners,
            ends,
            boundary_ends,
            per_cell,
            per_point: points.len(),
            nodes: Vec::with_capacity(per_cell * mesh.cells().len()),
            volume: Vec::with_capacity(mesh.cells().len()),
            barycentric: Vec::with_capacity(mesh.cells().len()),
            gradients: Vec::with_capacity(per_cell * points.len() * mesh.cells().len()),
        };
        for &cell in mesh.cells() {
            this.nodes.extend(cell);
            if cells == Cells::Quadratic {
                let node = |(a, b): (usize, usize)| edge_node[&edge(cell[a], cell[b])];
                this.nodes.extend(EDGES.map(node));
            }
            let p = mesh.corners(cell);
            let volume = signed_volume(&p);
            this.volume.push(volume);
            // The gradient at a corner points from the opposite face to it.
            let normal =
                |a: usize, b: usize, c: usize| (p[b] - p[a]).cross(&(p[c] - p[a])) / (6.0 * volume);
            let slopes = [
                normal(1, 3, 2),
                normal(0, 2, 3),
                normal(0, 3, 1),
                normal(0, 1, 2),
            ];
            this.barycentric.push(slopes);
            for &point in &points {
                let (_, gradients) = this.shape(this.volume.len() - 1, point);
                this.gradients.extend(&gradients[..per_cell]);
            }
        }
        this
    }

    /// Values and gradients \[1/m\] of a cell's shape functions at barycentric coordinates; the first
    /// `per_cell` count.
    pub fn shape(&self, cell: usize, at: [f64; 4]) -> ([f64; 10], [Vector3<f64>; 10]) {
        let slopes = &self.barycentric[cell];
        let (mut values, mut gradients) = ([0.0; 10], [Vector3::zeros(); 10]);
        for corner in 0..4 {
            (values[corner], gradients[corner]) = if self.per_cell == 4 {
                (at[corner], slopes[corner])
            } else {
                (
                    at[corner] * (2.0 * at[corner] - 1.0),
                    slopes[corner] * (4.0 * at[corner] - 1.0),
                )
            };
        }
        if self.per_cell == 10 {
            for (index, (a, b)) in EDGES.into_iter().enumerate() {
                values[4 + index] = 4.0 * at[a] * at[b];
                gradients[4 + index] = 4.0 * (at[a] * slopes[b] + at[b] * slopes[a]);
            }
        }
        (values, gradients)
    }

    pub fn cell_nodes(&self, cell: usize) -> &[u32] {
        &self.nodes[cell * self.per_cell..(cell + 1) * self.per_cell]
    }

    /// Deformation gradient where the shape functions have these gradients.
    #[inline]
    pub fn deformation(
        nodes: &[u32],
        gradients: &[Vector3<f64>],
        x: &[Vector3<f64>],
    ) -> Matrix3<f64> {
        let mut f = Matrix3::zeros();
        // Differences to the first node keep digits when the tissue is far from the origin.
        let origin = x[nodes[0] as usize];
        for (&node, gradient) in nodes.iter().zip(gradients).skip(1) {
            f += (x[node as usize] - origin) * gradient.transpose();
        }
        f
    }

    /// Nodes about each node of the mesh: cells that have it as a corner, ascending.
    pub fn cells_at_corners(&self) -> Vec<Vec<u32>> {
        let mut at = vec![Vec::new(); self.corners];
        for cell in 0..self.volume.len() {
            for &node in &self.cell_nodes(cell)[..4] {
                at[node as usize].push(cell as u32);
            }
        }
        at
    }

    /// Lumped masses \[kg\] at a density \[kg/m^3\]: a quarter of a linear cell each; in a quadratic cell
    /// in proportion to the diagonal of the consistent mass (Hinton, Rock & Zienkiewicz 1976), as row
    /// sums would be negative at corners.
    pub fn masses(&self, density: f64) -> Vec<f64> {
        let mut masses = vec![0.0; self.rest.len()];
        for (cell, volume) in self.volume.iter().enumerate() {
            for (index, &node) in self.cell_nodes(cell).iter().enumerate() {
                let share = match (self.per_cell, index) {
                    (4, _) => 0.25,
                    (_, 0..4) => 1.0 / 36.0,
                    _ => 4.0 / 27.0,
                };
                masses[node as usize] += share * volume * density;
            }
        }
        masses
    }
}

fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_mesh::slab;

    /// Shape functions and gradients reproduce a quadratic field (a linear one on linear cells).
    #[test]
    fn shape_functions_reproduce_polynomials() {
        let mesh = slab([0.3, 0.2, 0.1], [2, 2, 1]).expect("a slab");
        for cells in [Cells::Linear, Cells::Quadratic] {
            let curved = if cells == Cells::Linear { 0.0 } else { 1.0 };
            let field =
                |p: &Vector3<f64>| 1.0 + 2.0 * p.x - p.y + curved * (p.x * p.y + 3.0 * p.z * p.z);
            let slope = |p: &Vector3<f64>| {
                Vector3::new(2.0 + curved * p.y, -1.0 + curved * p.x, curved * 6.0 * p.z)
            };
            let discrete = Discrete::new(&mesh, cells);
            let at = [0.1, 0.2, 0.3, 0.4];
            for (cell, corners) in mesh.cells().iter().enumerate() {
                let p = mesh.corners(*corners);
                let point: Vector3<f64> = (0..4).map(|c| p[c] * at[c]).sum();
                let (values, gradients) = discrete.shape(cell, at);
                let nodes = discrete.cell_nodes(cell);
                let of = |index: usize| field(&discrete.rest[nodes[index] as usize]);
                let value: f64 = (0..nodes.len()).map(|i| values[i] * of(i)).sum();
                let gradient: Vector3<f64> = (0..nodes.len()).map(|i| gradients[i] * of(i)).sum();
                assert!((value - field(&point)).abs() < 1e-13);
                assert!((gradient - slope(&point)).norm() < 1e-12);
            }
            let total: f64 = discrete.masses(10.0).iter().sum();
            assert!((total - 10.0 * 0.006).abs() < 1e-15);
            assert!(discrete.masses(1.0).iter().all(|mass| *mass > 0.0));
        }
    }
}
