//! Elastic energy of a state, its gradient and its second derivative.
//!
//! Entry points: [`Elastic::energy`], [`Elastic::gradient`], [`Elastic::tangent`], all of one energy:
//! the law's at every quadrature point, or with averaged cells what is left of it without the energy of
//! pure dilation, which [`super::averaged`] adds node by node.

use super::Cells;
use super::averaged::{self, Averaged};
use super::discrete::Discrete;
use super::pattern::{Groups, Pattern};
use crate::law::Law;
use nalgebra::{Cholesky, Matrix3, SMatrix, SymmetricEigen, Vector3};

/// Change of stress with each entry F_jl \[Pa m^3\], at \[j\]\[l\].
type Moduli = [[Matrix3<f64>; 3]; 3];

/// Iterations for the eigenvalues of such, of which there are nine: some two for each are enough.
const MOST_SWEEPS: usize = 200;

#[derive(Clone)]
pub(super) struct Elastic {
    pub discrete: Discrete,
    /// One for all cells or one for each.
    laws: Vec<Law>,
    pub pattern: Pattern,
    averaged: Option<Averaged>,
}

impl Elastic {
    pub fn new(discrete: Discrete, laws: &[Law]) -> Self {
        let mut groups = Groups::default();
        for cell in 0..discrete.volume.len() {
            groups.push(discrete.cell_nodes(cell).iter().copied());
        }
        let averaged =
            (discrete.cells == Cells::Averaged).then(|| Averaged::new(&discrete, &mut groups));
        Self {
            pattern: Pattern::new(discrete.rest.len(), &groups),
            discrete,
            laws: laws.to_vec(),
            averaged,
        }
    }

    pub fn law(&self, cell: usize) -> &Law {
        &self.laws[cell.min(self.laws.len() - 1)]
    }

    /// Nodes and shape gradients at each point of a cell, and the weight of a point \[m^3\].
    fn points(&self, cell: usize) -> (&[u32], std::slice::ChunksExact<'_, Vector3<f64>>, f64) {
        let d = &self.discrete;
        let per_cell = d.per_cell * d.per_point;
        (
            d.cell_nodes(cell),
            d.gradients[cell * per_cell..(cell + 1) * per_cell].chunks_exact(d.per_cell),
            d.volume[cell] / d.per_point as f64,
        )
    }

    /// Energy \[J\] with nodes at `x` \[m\]; not finite where a law has none.
    pub fn energy(&mut self, x: &[Vector3<f64>]) -> f64 {
        let mut sum = match &mut self.averaged {
            Some(averaged) => averaged.update(&self.discrete, &self.laws, x),
            None => 0.0,
        };
        for cell in 0..self.discrete.volume.len() {
            let (nodes, points, weight) = self.points(cell);
            for gradients in points {
                let f = Discrete::deformation(nodes, gradients, x);
                sum += weight
                    * match &self.averaged {
                        Some(_) => averaged::energy(self.law(cell), &f),
                        None => self.law(cell).energy(&f),
                    };
            }
        }
        sum
    }

    /// What [`Self::stress`] takes from other cells.
    pub fn update(&mut self, x: &[Vector3<f64>]) {
        if let Some(averaged) = &mut self.averaged {
            averaged.update(&self.discrete, &self.laws, x);
        }
    }

    /// First Piola-Kirchhoff stress of a cell \[Pa\], after [`Self::update`].
    pub fn stress(&self, cell: usize, f: &Matrix3<f64>) -> Matrix3<f64> {
        match &self.averaged {
            Some(averaged) => {
                averaged::stress(self.law(cell), f)
                    + averaged.mean_pressure(self.discrete.cell_nodes(cell))
                        * crate::law::cofactor(f)
            }
            None => self.law(cell).stress(f),
        }
    }

    /// Adds dW/dx \[N\] to `out`.
    pub fn gradient(&mut self, x: &[Vector3<f64>], out: &mut [Vector3<f64>]) {
        self.update(x);
        for cell in 0..self.discrete.volume.len() {
            let (nodes, points, weight) = self.points(cell);
            for gradients in points {
                let f = Discrete::deformation(nodes, gradients, x);
                let stress = self.stress(cell, &f);
                for (&node, gradient) in nodes.iter().zip(gradients) {
                    out[node as usize] += weight * (stress * gradient);
                }
            }
        }
    }

    /// Adds d2W/dx2 u \[N\] for a displacement `u` \[m\] of the nodes to `out`.
    pub fn product(&mut self, x: &[Vector3<f64>], u: &[Vector3<f64>], out: &mut [Vector3<f64>]) {
        self.update(x);
        if let Some(averaged) = &mut self.averaged {
            averaged.differentiate(&self.discrete, x, u);
        }
        for cell in 0..self.discrete.volume.len() {
            let (nodes, points, weight) = self.points(cell);
            let law = self.law(cell);
            for gradients in points {
                let f = Discrete::deformation(nodes, gradients, x);
                let df = Discrete::deformation(nodes, gradients, u);
                let change = match &self.averaged {
                    Some(averaged) => {
                        averaged::stress_change(law, &f, &df)
                            + averaged.mean_pressure(nodes) * averaged::cofactor_change(&f, &df)
                            + averaged.mean_change(nodes) * crate::law::cofactor(&f)
                    }
                    None => law.stress_change(&f, &df),
                };
                for (&node, gradient) in nodes.iter().zip(gradients) {
                    out[node as usize] += weight * (change * gradient);
                }
            }
        }
    }

    /// Fills `values` with d2W/dx2 \[N/m\], (entries of the pattern); with `projected` each point's part without its negative
    /// curvatures (Teran et al. 2005): the sum has none then.
    pub fn tangent(&mut self, x: &[Vector3<f64>], projected: bool, values: &mut [f64]) {
        values.fill(0.0);
        if let Some(averaged) = &mut self.averaged {
            averaged.update(&self.discrete, &self.laws, x);
            averaged.add_tangent(&self.discrete, x, &self.pattern, values);
        }
        for cell in 0..self.discrete.volume.len() {
            match self.discrete.per_cell {
                4 => self.cell_tangent::<4>(cell, x, projected, values),
                _ => self.cell_tangent::<10>(cell, x, projected, values),
            }
        }
    }

    fn cell_tangent<const K: usize>(
        &self,
        cell: usize,
        x: &[Vector3<f64>],
        projected: bool,
        values: &mut [f64],
    ) {
        let law = self.law(cell);
        let (nodes, points, weight) = self.points(cell);
        let mut blocks = [[Matrix3::<f64>::zeros(); K]; K];
        for gradients in points {
            let f = Discrete::deformation(nodes, gradients, x);
            // moduli[j][l]: change of stress with F_jl.
            let mut moduli: Moduli = std::array::from_fn(|j| {
                std::array::from_fn(|l| {
                    let mut df = Matrix3::zeros();
                    df[(j, l)] = weight;
                    match &self.averaged {
                        Some(averaged) => {
                            averaged::stress_change(law, &f, &df)
                                + averaged.mean_pressure(nodes) * averaged::cofactor_change(&f, &df)
                        }
                        None => law.stress_change(&f, &df),
                    }
                })
            });
            if projected {
                project(&mut moduli);
            }
            for (b, g) in gradients.iter().enumerate() {
                for (j, moduli) in moduli.iter().enumerate() {
                    let change = moduli[0] * g.x + moduli[1] * g.y + moduli[2] * g.z;
                    for (a, gradient) in gradients.iter().enumerate().skip(b) {
                        let mut column = blocks[a][b].column_mut(j);
                        column += change * gradient;
                    }
                }
            }
        }
        for (a, row) in blocks.iter().enumerate() {
            for (b, block) in row[..=a].iter().enumerate() {
                self.pattern.add(values, cell, (a, b), block);
            }
        }
    }

    /// Size of the round-off in the nodal forces per metre of coordinates \[N/m\], 2-norm.
    pub fn grain(&self) -> f64 {
        let mut sum = 0.0;
        for cell in 0..self.discrete.volume.len() {
            let modulus = modulus(self.law(cell));
            let (_, points, weight) = self.points(cell);
            for gradients in points {
                let steep = gradients.iter().fold(0.0f64, |most, g| most.max(g.norm()));
                let share = |g: &Vector3<f64>| (weight * modulus * steep * g.norm()).powi(2);
                sum += gradients.iter().map(share).sum::<f64>();
            }
        }
        f64::EPSILON * sum.sqrt()
    }

    /// Modulus times volume, all together \[J\]: the scale of the round-off in the energy.
    pub fn stiffness_volume(&self) -> f64 {
        let of = |(cell, volume): (usize, &f64)| modulus(self.law(cell)) * volume;
        self.discrete.volume.iter().enumerate().map(of).sum()
    }
}

/// Takes the negative curvatures out of the second derivative of an energy by F: `moduli[j][l]` is the change of stress with F_jl.
fn project(moduli: &mut Moduli) {
    // Entry F_jl is number 3 l + j, as matrices are stored.
    let mut whole = SMatrix::<f64, 9, 9>::zeros();
    for (j, row) in moduli.iter().enumerate() {
        for (l, change) in row.iter().enumerate() {
            whole
                .column_mut(3 * l + j)
                .copy_from_slice(change.as_slice());
        }
    }
    if Cholesky::new(whole).is_some() || !whole.iter().all(|x| x.is_finite()) {
        return;
    }
    // What is finite may overflow in between: then it stays as it is, and has no factor.
    let Some(mut eigen) = SymmetricEigen::try_new(whole, f64::EPSILON, MOST_SWEEPS) else {
        return;
    };
    for value in eigen.eigenvalues.iter_mut() {
        *value = value.max(0.0);
    }
    let whole = eigen.recompose();
    for (j, row) in moduli.iter_mut().enumerate() {
        for (l, change) in row.iter_mut().enumerate() {
            change.copy_from_slice(whole.column(3 * l + j).as_slice());
        }
    }
}

/// Largest modulus of a law at rest, about \[Pa\].
fn modulus(law: &Law) -> f64 {
    match *law {
        Law::StVenantKirchhoff { lambda, mu } => lambda.abs() + 2.0 * mu,
        Law::NeoHookean { mu, kappa, eta, .. } => kappa + 2.0 * mu + 4.0 * eta.abs(),
    }
}

/// sqrt((lambda + 2 mu) / mu) of a law at rest.
pub(super) fn stiffness_ratio(law: &Law) -> f64 {
    match *law {
        Law::StVenantKirchhoff { lambda, mu } => (lambda / mu + 2.0).sqrt(),
        Law::NeoHookean { mu, kappa, eta, .. } => ((kappa + 4.0 * eta) / mu + 4.0 / 3.0).sqrt(),
    }
}
