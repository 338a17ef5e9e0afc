//! Averaged nodal pressure: cells of four nodes that do not lock when volume is nearly kept.
//!
//! Entry points: [`Averaged`], [`energy`], [`stress`], [`stress_change`]. After Bonet & Burton (1998): the
//! ratio of volumes is that of all cells about a node, a quarter of each. Deviates in form: one energy,
//! the sum over nodes of the law's energy of pure dilation U(J) = Psi(J^(1/3) I) there, plus Psi(F) - U(det F)
//! of each cell; forces and tangent are its exact derivatives, which couple neighbours of neighbours.

use super::discrete::Discrete;
use super::pattern::{Groups, Pattern};
use crate::law::{Law, cofactor};
use nalgebra::{Matrix3, Vector3};

/// What there is per node, and buffers.
#[derive(Clone)]
pub(super) struct Averaged {
    /// Cells about each node.
    around: Vec<Vec<u32>>,
    /// A quarter of their volume \[m^3\].
    volume: Vec<f64>,
    /// Nodes of those cells, ascending.
    patches: Groups,
    /// The first of the pattern's groups that is a patch.
    first_group: usize,
    /// dU/dJ \[Pa\], mean over the node's cells, and dU2/dJ2.
    pressure: Vec<f64>,
    stiffening: Vec<f64>,
    /// Change of the pressure with a displacement \[Pa\].
    change: Vec<f64>,
    /// Place of a node in the patch at hand.
    place: Vec<u32>,
    /// Gradient of a patch's volume \[m^2\].
    slope: Vec<Vector3<f64>>,
}

impl Averaged {
    /// Adds its groups of nodes to those of the pattern.
    pub fn new(discrete: &Discrete, groups: &mut Groups) -> Self {
        let around = discrete.cells_at_corners();
        let first_group = groups.len();
        let mut patches = Groups::default();
        let mut longest = 0;
        for cells in &around {
            let mut patch: Vec<u32> = cells
                .iter()
                .flat_map(|&cell| discrete.cell_nodes(cell as usize))
                .copied()
                .collect();
            patch.sort_unstable();
            patch.dedup();
            longest = longest.max(patch.len());
            groups.push(patch.iter().copied());
            patches.push(patch);
        }
        let nodes = around.len();
        Self {
            volume: around
                .iter()
                .map(|cells| {
                    cells
                        .iter()
                        .map(|&c| 0.25 * discrete.volume[c as usize])
                        .sum()
                })
                .collect(),
            around,
            patches,
            first_group,
            pressure: vec![0.0; nodes],
            stiffening: vec![0.0; nodes],
            change: vec![0.0; nodes],
            place: vec![0; nodes],
            slope: vec![Vector3::zeros(); longest],
        }
    }

    /// Pressures of all nodes at `x`; returns the energy \[J\].
    pub fn update(&mut self, discrete: &Discrete, laws: &[Law], x: &[Vector3<f64>]) -> f64 {
        let mut energy = 0.0;
        for node in 0..self.around.len() {
            let now: f64 = self.around[node]
                .iter()
                .map(|&cell| 0.25 * discrete.volume[cell as usize] * ratio(discrete, cell, x))
                .sum();
            let j = now / self.volume[node];
            let mut mean = [0.0; 3];
            for &cell in &self.around[node] {
                let law = &laws[(cell as usize).min(laws.len() - 1)];
                let share = 0.25 * discrete.volume[cell as usize];
                for (mean, value) in mean.iter_mut().zip(dilation(law, j)) {
                    *mean += share * value;
                }
            }
            energy += mean[0];
            self.pressure[node] = mean[1] / self.volume[node];
            self.stiffening[node] = mean[2] / self.volume[node];
        }
        energy
    }

    /// Mean pressure of a cell's nodes \[Pa\].
    pub fn mean_pressure(&self, nodes: &[u32]) -> f64 {
        0.25 * nodes
            .iter()
            .map(|&node| self.pressure[node as usize])
            .sum::<f64>()
    }

    /// After [`Self::update`]: changes of all pressures with a displacement of the nodes, for [`Self::mean_change`].
    pub fn differentiate(&mut self, discrete: &Discrete, x: &[Vector3<f64>], u: &[Vector3<f64>]) {
        for node in 0..self.around.len() {
            let cells = self.around[node].iter().map(|&cell| {
                let (nodes, gradients) = corner_gradients(discrete, cell);
                let turn = cofactor(&Discrete::deformation(nodes, gradients, x));
                let df = Discrete::deformation(nodes, gradients, u);
                0.25 * discrete.volume[cell as usize] * turn.dot(&df)
            });
            let swelling = cells.sum::<f64>() / self.volume[node];
            self.change[node] = self.stiffening[node] * swelling;
        }
    }

    /// Mean change of the pressure of a cell's nodes \[Pa\].
    pub fn mean_change(&self, nodes: &[u32]) -> f64 {
        0.25 * nodes
            .iter()
            .map(|&node| self.change[node as usize])
            .sum::<f64>()
    }

    /// Adds what couples the nodes of every patch, after [`Self::update`].
    pub fn add_tangent(
        &mut self,
        discrete: &Discrete,
        x: &[Vector3<f64>],
        pattern: &Pattern,
        values: &mut [f64],
    ) {
        for node in 0..self.around.len() {
            let patch = self.patches.get(node);
            for (place, &other) in patch.iter().enumerate() {
                self.place[other as usize] = place as u32;
            }
            self.slope[..patch.len()].fill(Vector3::zeros());
            for &cell in &self.around[node] {
                let (nodes, gradients) = corner_gradients(discrete, cell);
                let turn = cofactor(&Discrete::deformation(nodes, gradients, x));
                let share = 0.25 * discrete.volume[cell as usize];
                for (&other, gradient) in nodes.iter().zip(gradients) {
                    self.slope[self.place[other as usize] as usize] += share * (turn * gradient);
                }
            }
            let weight = self.stiffening[node] / self.volume[node];
            for i in 0..patch.len() {
                for j in 0..=i {
                    let block = weight * self.slope[i] * self.slope[j].transpose();
                    pattern.add(values, self.first_group + node, (i, j), &block);
                }
            }
        }
    }
}

fn corner_gradients(discrete: &Discrete, cell: u32) -> (&[u32], &[Vector3<f64>]) {
    let cell = cell as usize;
    (
        discrete.cell_nodes(cell),
        &discrete.gradients[4 * cell..4 * cell + 4],
    )
}

fn ratio(discrete: &Discrete, cell: u32, x: &[Vector3<f64>]) -> f64 {
    let (nodes, gradients) = corner_gradients(discrete, cell);
    Discrete::deformation(nodes, gradients, x).determinant()
}

/// U(J) = Psi(J^(1/3) I) \[Pa\] and its two derivatives. J is above zero where the energy is finite.
fn dilation(law: &Law, j: f64) -> [f64; 3] {
    match *law {
        Law::NeoHookean { kappa, .. } => [
            0.5 * kappa * (j - 1.0) * (j - 1.0),
            kappa * (j - 1.0),
            kappa,
        ],
        Law::StVenantKirchhoff { lambda, mu } => {
            let c = 9.0 / 8.0 * lambda + 0.75 * mu;
            let root = j.cbrt();
            [
                c * (root * root - 1.0).powi(2),
                4.0 / 3.0 * c * (root - 1.0 / root),
                4.0 / 9.0 * c * (1.0 / (root * root) + 1.0 / (root * j)),
            ]
        }
    }
}

/// The law without its energy of pure dilation, where that can be said in a law.
fn shape_law(law: &Law) -> Option<Law> {
    match *law {
        Law::NeoHookean { mu, eta, fibre, .. } => Some(Law::NeoHookean {
            mu,
            kappa: 0.0,
            eta,
            fibre,
        }),
        Law::StVenantKirchhoff { .. } => None,
    }
}

/// Psi(F) - U(det F) \[Pa\]; infinite in a cell that is flat or inverted, whatever the law.
pub(super) fn energy(law: &Law, f: &Matrix3<f64>) -> f64 {
    if let Some(shape) = shape_law(law) {
        return shape.energy(f);
    }
    let j = f.determinant();
    if j <= 0.0 {
        return f64::INFINITY;
    }
    law.energy(f) - dilation(law, j)[0]
}

/// Its derivative \[Pa\].
pub(super) fn stress(law: &Law, f: &Matrix3<f64>) -> Matrix3<f64> {
    match shape_law(law) {
        Some(shape) => shape.stress(f),
        None => law.stress(f) - dilation(law, f.determinant())[1] * cofactor(f),
    }
}

/// Change of [`stress`] with a small change of F \[Pa\].
pub(super) fn stress_change(law: &Law, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    if let Some(shape) = shape_law(law) {
        return shape.stress_change(f, df);
    }
    let turn = cofactor(f);
    let [_, pressure, stiffening] = dilation(law, f.determinant());
    law.stress_change(f, df)
        - (stiffening * turn.dot(df)) * turn
        - pressure * cofactor_change(f, df)
}

/// Change of the cofactor with a small change of F.
pub(super) fn cofactor_change(f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c] = [0, 1, 2].map(|column| f.column(column).into_owned());
    let [da, db, dc] = [0, 1, 2].map(|column| df.column(column).into_owned());
    Matrix3::from_columns(&[
        db.cross(&c) + b.cross(&dc),
        dc.cross(&a) + c.cross(&da),
        da.cross(&b) + a.cross(&db),
    ])
}
