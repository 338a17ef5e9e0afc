//! Linear tissue: assembled and factored once, then any number of loads.
//!
//! Entry points: [`LinearTissue::new`], [`LinearTissue::solve`].

use super::assembly::{FIXED, assemble};
use super::element::Element;
use super::factor::{Factor, SolveScratch};
use super::handles::{Anchor, Handle, HeldPoints};
use super::material::{MaterialError, Materials};
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use thiserror::Error;

/// A force on one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeLoad {
    /// Mesh node.
    pub node: u32,
    /// Force on the tissue \[N\], (3), world frame.
    pub force_n: [f64; 3],
}

/// What acts on tissue besides its fixed nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loads {
    /// Forces; a node may be named more than once.
    pub forces: Vec<NodeLoad>,
    /// Points that are moved.
    pub handles: Vec<Handle>,
    /// Displacement \[m\] of fixed nodes that do not stay where they are.
    pub fixed_displacement_m: Vec<(u32, [f64; 3])>,
}

/// Balance of linear tissue under [`Loads`].
#[derive(Clone, Debug, PartialEq)]
pub struct Equilibrium {
    /// Displacement of every node \[m\], (n x 3).
    pub displacement_m: Vec<[f64; 3]>,
    /// Force of each handle on the tissue \[N\], (h x 3).
    pub handle_force_n: Vec<[f64; 3]>,
    /// Force that every node gets from outside, K u: loads, handles, and what fixed nodes carry
    /// \[N\], (n x 3).
    pub node_force_n: Vec<[f64; 3]>,
    /// Largest unbalanced force on a free node over the largest force on any node.
    pub residual: f64,
}

/// Why tissue cannot be built or loaded.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TissueError {
    /// The material.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// A node number beyond the mesh.
    #[error("{what} names node {node}, but the mesh has {nodes} nodes, 0 to {last}", last = nodes.saturating_sub(1))]
    NoSuchNode {
        /// Who names it.
        what: &'static str,
        /// The number.
        node: u32,
        /// Nodes of the mesh.
        nodes: usize,
    },
    /// The tissue can float away or turn.
    #[error(
        "the stiffness matrix is singular: {fixed} nodes are fixed, and at least three that are not on one line must be, in every connected part"
    )]
    Floating {
        /// How many nodes are fixed.
        fixed: usize,
    },
    /// Nothing is left to solve for.
    #[error("all {0} nodes are fixed: nothing can move")]
    AllFixed(usize),
    /// Anchor without vertices, with too few weights, or weights that are not finite.
    #[error("handle {handle} needs one finite weight per vertex and at least one vertex")]
    AnchorWeights {
        /// 0-based index of the handle.
        handle: usize,
    },
    /// A handle that the handles before it, or fixed nodes, already determine.
    #[error(
        "handle {handle} cannot move by itself: its vertices are fixed or held by handles before it"
    )]
    HandlesConflict {
        /// 0-based index of the handle.
        handle: usize,
    },
    /// A displacement for a node that is not fixed.
    #[error("node {0} is given a displacement but is not fixed")]
    NotFixed(u32),
    /// A load or target that is not a number.
    #[error("{0} is not finite")]
    NotFinite(&'static str),
}

/// Linear-elastic tissue with some nodes fixed.
pub struct LinearTissue {
    elements: Vec<Element>,
    /// Number among the free nodes, or [`FIXED`], (n).
    free_of_node: Vec<u32>,
    unknowns: usize,
    factor: Factor,
}

impl LinearTissue {
    /// Assembles and factors the stiffness of `mesh` with the nodes `fixed` held at rest. `materials`
    /// is one [`Material`](super::Material) for all cells, or [`Materials`].
    ///
    /// # Errors
    /// A material or a node out of range; a mesh that is not held against rigid motion.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        fixed: &[u32],
    ) -> Result<Self, TissueError> {
        let materials = materials.into();
        materials.check(mesh.cells().len())?;
        let nodes = mesh.points_m().len();
        let mut free_of_node = vec![0; nodes];
        for &node in fixed {
            *free_of_node
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "the list of fixed nodes",
                    node,
                    nodes,
                })? = FIXED;
        }
        let mut free_nodes = 0u32;
        for free in free_of_node.iter_mut().filter(|free| **free != FIXED) {
            *free = free_nodes;
            free_nodes += 1;
        }
        if free_nodes == 0 {
            return Err(TissueError::AllFixed(nodes));
        }
        let elements: Vec<Element> = mesh
            .cells()
            .iter()
            .enumerate()
            .map(|(index, &cell)| {
                Element::new(cell, &mesh.corners(cell), materials.of(index).lame())
            })
            .collect();
        let matrix = assemble(&elements, &free_of_node, free_nodes as usize);
        let floating = TissueError::Floating {
            fixed: nodes - free_nodes as usize,
        };
        let factor = Factor::new(&matrix).map_err(|_| floating.clone())?;
        let tissue = Self {
            elements,
            free_of_node,
            unknowns: matrix.unknowns,
            factor,
        };
        // Round-off can hide a rigid motion from the factorisation; a solve cannot hide it.
        if tissue.is_held(&matrix.value) {
            Ok(tissue)
        } else {
            Err(floating)
        }
    }

    /// Number of nodes, fixed ones included.
    pub fn nodes(&self) -> usize {
        self.free_of_node.len()
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.elements.len()
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Entries of the factor, zeros that pad its dense blocks included.
    pub fn factor_entries(&self) -> usize {
        self.factor.len()
    }

    /// Whether a node is held.
    pub fn is_fixed(&self, node: u32) -> bool {
        self.free_of_node[node as usize] == FIXED
    }

    /// Displacement and forces under `loads`.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist, are not finite, or handles that conflict.
    pub fn solve(&self, loads: &Loads) -> Result<Equilibrium, TissueError> {
        let anchors: Vec<Anchor> = loads
            .handles
            .iter()
            .map(|handle| handle.anchor.clone())
            .collect();
        let held = HeldPoints::new(self, anchors)?;
        self.solve_held(loads, &held)
    }

    /// As [`Self::solve`], with the handles' rows at hand.
    pub(crate) fn solve_held(
        &self,
        loads: &Loads,
        held: &HeldPoints,
    ) -> Result<Equilibrium, TissueError> {
        let outside = self.node_forces(loads)?;
        let mut displacement_m = self.fixed_field(loads)?;

        // f - K u_fixed on the free nodes.
        let from_fixed = self.apply(&displacement_m);
        let mut u = vec![0.0; self.unknowns];
        for (node, (force, carried)) in outside.iter().zip(&from_fixed).enumerate() {
            if let Some(first) = self.first_unknown(node as u32) {
                for axis in 0..3 {
                    u[first + axis] = force[axis] - carried[axis];
                }
            }
        }
        let mut scratch = self.scratch(1);
        self.solve_unknowns(&mut u, 1, &mut scratch);

        let mut lambda = Vec::with_capacity(3 * loads.handles.len());
        for handle in &loads.handles {
            let fixed_part = handle.anchor.sum(|node| displacement_m[node as usize]);
            for (target, fixed) in handle.target_displacement_m.iter().zip(fixed_part) {
                if !target.is_finite() {
                    return Err(TissueError::NotFinite("a handle's target"));
                }
                lambda.push(target - fixed);
            }
        }
        if !held.is_empty() {
            held.correct(self, &mut u, &mut lambda);
        }

        for (node, displacement) in displacement_m.iter_mut().enumerate() {
            if self.first_unknown(node as u32).is_some() {
                *displacement = self.at_node(&u, node as u32);
            }
        }
        let node_force_n = self.apply(&displacement_m);
        let mut unbalanced: Vec<[f64; 3]> = node_force_n
            .iter()
            .zip(&outside)
            .map(|(k_u, f)| [k_u[0] - f[0], k_u[1] - f[1], k_u[2] - f[2]])
            .collect();
        for (handle, lambda) in loads.handles.iter().zip(lambda.chunks_exact(3)) {
            for (&node, &weight) in handle.anchor.vertices.iter().zip(&handle.anchor.weights) {
                for axis in 0..3 {
                    unbalanced[node as usize][axis] += weight * lambda[axis];
                }
            }
        }
        let largest = |forces: &mut dyn Iterator<Item = &[f64; 3]>| {
            forces
                .flatten()
                .fold(0.0f64, |largest, force| largest.max(force.abs()))
        };
        let scale = largest(&mut node_force_n.iter());
        let left = largest(
            &mut (0u32..)
                .zip(&unbalanced)
                .filter(|(node, _)| !self.is_fixed(*node))
                .map(|(_, force)| force),
        );
        Ok(Equilibrium {
            displacement_m,
            handle_force_n: lambda
                .chunks_exact(3)
                .map(|l| [-l[0], -l[1], -l[2]])
                .collect(),
            node_force_n,
            residual: if scale > 0.0 { left / scale } else { left },
        })
    }

    /// Cauchy stress of each cell \[Pa\], (m x 3 x 3), for a displacement of every node \[m\].
    pub fn stress(&self, displacement_m: &[[f64; 3]]) -> Vec<[[f64; 3]; 3]> {
        self.elements
            .iter()
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

    fn node_forces(&self, loads: &Loads) -> Result<Vec<[f64; 3]>, TissueError> {
        let nodes = self.nodes();
        let mut forces = vec![[0.0; 3]; nodes];
        for load in &loads.forces {
            let node = load.node;
            let sum = forces
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "a load",
                    node,
                    nodes,
                })?;
            for (sum, force) in sum.iter_mut().zip(load.force_n) {
                *sum += force;
            }
            if !sum.iter().all(|force| force.is_finite()) {
                return Err(TissueError::NotFinite("a load"));
            }
        }
        Ok(forces)
    }

    fn fixed_field(&self, loads: &Loads) -> Result<Vec<[f64; 3]>, TissueError> {
        let nodes = self.nodes();
        let mut field = vec![[0.0; 3]; nodes];
        for &(node, displacement) in &loads.fixed_displacement_m {
            let at = field
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "a prescribed displacement",
                    node,
                    nodes,
                })?;
            if !self.is_fixed(node) {
                return Err(TissueError::NotFixed(node));
            }
            if !displacement.iter().all(|u| u.is_finite()) {
                return Err(TissueError::NotFinite("a prescribed displacement"));
            }
            *at = displacement;
        }
        Ok(field)
    }

    /// Solves once for forces without symmetry: a factor that is singular but for round-off answers
    /// with a rigid motion many orders beyond what the tissue's stiffness explains.
    fn is_held(&self, stiffness: &[f64]) -> bool {
        let mut u: Vec<f64> = (0..self.unknowns)
            .map(|index| (index as f64).sin())
            .collect();
        let mut scratch = self.scratch(1);
        self.solve_unknowns(&mut u, 1, &mut scratch);
        let largest = u.iter().fold(0.0f64, |largest, u| largest.max(u.abs()));
        let stiffest = stiffness
            .iter()
            .fold(0.0f64, |largest, k| largest.max(k.abs()));
        u.iter().all(|u| u.is_finite()) && largest * stiffest < 1e12 * self.unknowns as f64
    }

    /// Index of a node's first unknown; `None` for a fixed node.
    pub(crate) fn first_unknown(&self, node: u32) -> Option<usize> {
        let free = self.free_of_node[node as usize];
        (free != FIXED).then_some(3 * free as usize)
    }

    /// A node's value in a vector of unknowns; zero for a fixed node.
    pub(crate) fn at_node(&self, u: &[f64], node: u32) -> [f64; 3] {
        match self.first_unknown(node) {
            Some(first) => [u[first], u[first + 1], u[first + 2]],
            None => [0.0; 3],
        }
    }

    /// Memory for [`Self::solve_unknowns`] with up to `columns` right-hand sides.
    pub(crate) fn scratch(&self, columns: usize) -> SolveScratch {
        self.factor.scratch(columns)
    }

    /// K^-1 on `columns` vectors of unknowns, one after the other in memory, in place.
    pub(crate) fn solve_unknowns(
        &self,
        rhs: &mut [f64],
        columns: usize,
        scratch: &mut SolveScratch,
    ) {
        self.factor.solve(rhs, columns, scratch);
    }
}

impl std::fmt::Debug for LinearTissue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LinearTissue")
            .field("nodes", &self.nodes())
            .field("cells", &self.cells())
            .field("unknowns", &self.unknowns)
            .finish_non_exhaustive()
    }
}
