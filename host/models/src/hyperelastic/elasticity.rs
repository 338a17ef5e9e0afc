//! Elastic energy of tissue, its forces and its tangent stiffness, for solvers of their own.
//!
//! Entry point: [`Elasticity`]. The same laws and cells as [`Hyperelastic`](super::Hyperelastic), without what holds
//! nodes, loads them or factors anything.

use super::discrete::Discrete;
use super::elastic::{Elastic, stiffness_ratio};
use super::settings::check_law;
use super::{Cells, check_count};
use crate::BuildError;
use crate::law::Law;
use nalgebra::{Matrix3, Vector3};
use sutura_mesh::TetMesh;

/// Cells, their laws, and buffers. Nodes are the mesh's, in its order.
///
/// ```
/// use nalgebra::Vector3;
/// use sutura_mesh::slab;
/// use sutura_models::hyperelastic::{Cells, Elasticity};
/// use sutura_models::{Material, law::Law};
/// let mesh = slab([0.04, 0.04, 0.02], [4, 4, 2])?;
/// let liver = Material { youngs_modulus_pa: 3_500.0, poisson_ratio: 0.45 };
/// let mut tissue = Elasticity::new(&mesh, &[Law::neo_hookean(liver)], Cells::Linear)?;
/// // Pulled by a tenth along x.
/// let x: Vec<_> = mesh.points_m().iter().map(|p| Vector3::new(1.1 * p[0], p[1], p[2])).collect();
/// assert!(tissue.energy_j(&x) > 0.0);
/// let mut force = vec![Vector3::zeros(); x.len()];
/// tissue.internal_force(&x, &mut force);
/// assert!(force.iter().sum::<Vector3<f64>>().norm() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Elasticity {
    elastic: Elastic,
}

impl Elasticity {
    /// Tissue of `mesh`, with one law for all cells or one for each.
    ///
    /// # Errors
    /// [`BuildError::Count`] of laws, [`BuildError::Setting`] for a modulus out of range, or for quadratic cells: their
    /// mid-edge nodes are not the mesh's.
    pub fn new(mesh: &TetMesh, laws: &[Law], cells: Cells) -> Result<Self, BuildError> {
        check_count(mesh, laws)?;
        laws.iter().try_for_each(check_law)?;
        if cells == Cells::Quadratic {
            return Err(BuildError::Setting {
                name: "number of nodes of a cell",
                value: 10.0,
                limit: "4, the mesh's own: linear or averaged cells",
            });
        }
        Ok(Self {
            elastic: Elastic::new(Discrete::new(mesh, cells), laws),
        })
    }

    /// Nodes, where they are at rest \[m\].
    pub fn rest_m(&self) -> &[Vector3<f64>] {
        &self.elastic.discrete.rest
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.elastic.discrete.volume.len()
    }

    /// Energy \[J\] with nodes at `x` \[m\], (n); not finite where a cell is flat or inverted and its law has none.
    pub fn energy_j(&mut self, x: &[Vector3<f64>]) -> f64 {
        self.elastic.energy(x)
    }

    /// dW/dx with nodes at `x` \[m\]: what it takes to hold each node there \[N\], into `out` (n).
    pub fn internal_force(&mut self, x: &[Vector3<f64>], out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        self.elastic.gradient(x, out);
    }

    /// The lower triangle that [`Self::tangent`] fills: where each column of 3 n begins, and the rows of its entries,
    /// ascending.
    pub fn triangle(&self) -> (&[usize], &[usize]) {
        let pattern = &self.elastic.pattern;
        (&pattern.column_start, &pattern.row)
    }

    /// d2W/dx2 with nodes at `x` \[m\], into `values` \[N/m\], (entries of [`Self::triangle`]).
    pub fn tangent(&mut self, x: &[Vector3<f64>], values: &mut [f64]) {
        self.elastic.tangent(x, false, values);
    }

    /// [`Self::tangent`] without the negative curvatures of each cell (Teran et al. 2005, "Robust quasistatic finite elements and flesh
    /// simulation"), positive semi-definite: where cells are pressed hard the tangent itself is not.
    pub fn projected_tangent(&mut self, x: &[Vector3<f64>], values: &mut [f64]) {
        self.elastic.tangent(x, true, values);
    }

    /// d2W/dx2 times `change` \[m\] (n) with nodes at `x` \[m\], into `out` \[N\] (n): cell by cell, nothing is assembled.
    pub fn tangent_product(
        &mut self,
        x: &[Vector3<f64>],
        change: &[Vector3<f64>],
        out: &mut [Vector3<f64>],
    ) {
        out.fill(Vector3::zeros());
        self.elastic.product(x, change, out);
    }

    /// Deformation gradient of each cell with nodes at `x` \[m\], (m).
    pub fn deformations<'a>(
        &'a self,
        x: &'a [Vector3<f64>],
    ) -> impl Iterator<Item = Matrix3<f64>> + 'a {
        let discrete = &self.elastic.discrete;
        let cells = discrete.nodes.chunks_exact(4);
        let gradients = discrete.gradients.chunks_exact(4);
        cells
            .zip(gradients)
            .map(|(nodes, gradients)| Discrete::deformation(nodes, gradients, x))
    }

    /// Cauchy stress of each cell with nodes at `x` \[m\] \[Pa\], (m x 3 x 3).
    pub fn cauchy_stress(&mut self, x: &[Vector3<f64>]) -> Vec<[[f64; 3]; 3]> {
        self.elastic.update(x);
        self.deformations(x)
            .enumerate()
            .map(|(cell, f)| {
                let stress = self.elastic.stress(cell, &f) * f.transpose() / f.determinant();
                stress.into()
            })
            .collect()
    }

    /// Size of the round-off in the nodal forces per metre of coordinates \[N/m\], 2-norm.
    pub fn round_off_n_per_m(&self) -> f64 {
        self.elastic.grain()
    }

    /// Round-off in the energy \[J\].
    pub fn round_off_j(&self) -> f64 {
        4.0 * f64::EPSILON * self.elastic.stiffness_volume()
    }

    /// Largest sqrt((lambda + 2 mu) / mu) of a cell at rest: how much stiffer against being pressed than against being
    /// sheared.
    pub fn stiffness_ratio(&self) -> f64 {
        let ratios = (0..self.cells()).map(|cell| stiffness_ratio(self.elastic.law(cell)));
        ratios.fold(0.0, f64::max)
    }
}

impl std::fmt::Debug for Elasticity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Elasticity")
            .field("nodes", &self.rest_m().len())
            .field("cells", &self.cells())
            .finish_non_exhaustive()
    }
}
