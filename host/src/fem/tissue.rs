//! Linear tissue: assembled and factored once, then any number of loads.
//!
//! Entry points: [`LinearTissue::new`], [`LinearTissue::solve`].

use super::assembly::{self, assemble};
use super::element::Element;
use super::error::TissueError;
use super::factor::{Factor, Need};
use super::handles::{Factored, HeldPoints};
use super::loads::{Equilibrium, Loads};
use super::numbering::Numbering;
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use sutura_models::Materials;

/// Linear-elastic tissue with some nodes fixed.
pub struct LinearTissue {
    elements: Vec<Element>,
    numbering: Numbering,
    factor: Factor,
}

impl LinearTissue {
    /// Assembles and factors the stiffness of `mesh` with the nodes `fixed` held at rest. `materials`
    /// is one [`Material`](super::Material) for all cells, or [`Materials`].
    ///
    /// # Errors
    /// A material or a node out of range; a mesh that is not held against rigid motion, or too large for the memory
    /// that is free.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        fixed: &[u32],
    ) -> Result<Self, TissueError> {
        Self::beside(mesh, &materials.into(), fixed, 0)
    }

    /// As [`Self::new`], where so much memory will be taken besides \[bytes\].
    pub(crate) fn beside(
        mesh: &TetMesh,
        materials: &Materials,
        fixed: &[u32],
        beside_bytes: u64,
    ) -> Result<Self, TissueError> {
        materials.check(mesh.cells().len())?;
        let numbering = Numbering::new(mesh.points_m().len(), fixed)?;
        assembly::begin(mesh.cells().len())?;
        let elements = Element::of_mesh(mesh, materials);
        let placed: Vec<Element> = elements
            .iter()
            .map(|element| element.placed(&numbering))
            .collect();
        let (pattern, stiffness) = assemble(&placed, numbering.free());
        let need = Need {
            copies: 1,
            beside_bytes,
        };
        let factor = Factor::held(&pattern, &stiffness, numbering.fixed(), need)?;
        Ok(Self {
            elements,
            numbering,
            factor,
        })
    }

    /// Number of nodes, fixed ones included.
    pub fn nodes(&self) -> usize {
        self.numbering.nodes()
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.elements.len()
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        self.numbering.unknowns()
    }

    /// Entries of the factor, zeros that pad its dense blocks included.
    pub fn factor_entries(&self) -> usize {
        self.factor.len()
    }

    /// Whether a node is held.
    pub fn is_fixed(&self, node: u32) -> bool {
        self.numbering.is_fixed(node)
    }

    /// Displacement and forces under `loads`.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist, are not finite, or handles that conflict.
    pub fn solve(&self, loads: &Loads) -> Result<Equilibrium, TissueError> {
        let held = HeldPoints::new(self, loads.anchors())?;
        self.solve_held(loads, &held)
    }

    /// As [`Self::solve`], with the handles' rows at hand.
    pub(crate) fn solve_held(
        &self,
        loads: &Loads,
        held: &HeldPoints,
    ) -> Result<Equilibrium, TissueError> {
        let outside = loads.node_forces(&self.numbering)?;
        let (displacement_m, lambda) = self.moved(loads, held, &outside)?;
        let internal = self.apply(&displacement_m);
        Ok(Equilibrium::new(
            loads,
            &self.numbering,
            displacement_m,
            internal,
            &outside,
            &lambda,
        ))
    }

    /// The displacement alone of [`Self::solve_held`] \[m\], (n x 3), to the same bits.
    pub(crate) fn displacement_m(
        &self,
        loads: &Loads,
        held: &HeldPoints,
    ) -> Result<Vec<[f64; 3]>, TissueError> {
        let outside = loads.node_forces(&self.numbering)?;
        self.moved(loads, held, &outside).map(|(moved, _)| moved)
    }

    /// Displacement under forces `outside` (n) and the handles of `loads` \[m\], (n x 3), and the handles' forces.
    fn moved(
        &self,
        loads: &Loads,
        held: &HeldPoints,
        outside: &[[f64; 3]],
    ) -> Result<(Vec<[f64; 3]>, Vec<f64>), TissueError> {
        let mut displacement_m = loads.fixed_field(&self.numbering)?;

        // f - K u_fixed on the free nodes.
        let from_fixed = self.apply(&displacement_m);
        let mut u = vec![0.0; self.unknowns()];
        for (node, (force, carried)) in outside.iter().zip(&from_fixed).enumerate() {
            if let Some(first) = self.first_unknown(node as u32) {
                for axis in 0..3 {
                    u[first + axis] = force[axis] - carried[axis];
                }
            }
        }
        let mut scratch = self.factor.scratch();
        self.factor.solve(&mut u, &mut scratch);

        let mut lambda = loads.handle_targets(&displacement_m)?;
        if !held.is_empty() {
            held.correct(self, &mut u, &mut lambda);
        }

        for (node, displacement) in displacement_m.iter_mut().enumerate() {
            if self.first_unknown(node as u32).is_some() {
                *displacement = self.at_node(&u, node as u32);
            }
        }
        Ok((displacement_m, lambda))
    }

    /// Cauchy stress of each cell \[Pa\], (m x 3 x 3), for a displacement of every node \[m\].
    pub fn stress(&self, displacement_m: &[[f64; 3]]) -> Vec<[[f64; 3]; 3]> {
        self.stress_in(displacement_m, 0..self.elements.len())
    }

    /// The same of some of the cells, in their order.
    pub(crate) fn stress_in(
        &self,
        displacement_m: &[[f64; 3]],
        cells: impl Iterator<Item = usize>,
    ) -> Vec<[[f64; 3]; 3]> {
        cells
            .filter_map(|cell| self.elements.get(cell))
            .map(|element| {
                let u = element
                    .nodes
                    .map(|node| Vector3::from(displacement_m[node as usize]));
                element.stress(&u).into()
            })
            .collect()
    }

    /// K u over all nodes, fixed ones included \[N\], (n x 3).
    fn apply(&self, displacement_m: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut force = vec![[0.0; 3]; displacement_m.len()];
        for element in &self.elements {
            let u = element
                .nodes
                .map(|node| Vector3::from(displacement_m[node as usize]));
            let stress = element.stress(&u) * element.volume_m3;
            for (&node, gradient) in element.nodes.iter().zip(&element.gradients) {
                let share = stress * gradient;
                for axis in 0..3 {
                    force[node as usize][axis] += share[axis];
                }
            }
        }
        force
    }

    /// Index of a node's first unknown; `None` for a fixed node.
    pub(crate) fn first_unknown(&self, node: u32) -> Option<usize> {
        self.numbering.first_unknown(node)
    }

    /// A node's value in a vector of unknowns; zero for a fixed node.
    pub(crate) fn at_node(&self, u: &[f64], node: u32) -> [f64; 3] {
        self.numbering.at_node(u, node)
    }
}

impl Factored for LinearTissue {
    fn numbering(&self) -> &Numbering {
        &self.numbering
    }

    fn factor(&self) -> &Factor {
        &self.factor
    }
}

impl std::fmt::Debug for LinearTissue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LinearTissue")
            .field("nodes", &self.nodes())
            .field("cells", &self.cells())
            .field("unknowns", &self.unknowns())
            .finish_non_exhaustive()
    }
}
