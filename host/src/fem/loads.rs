//! What acts on tissue, and the balance that it finds.
//!
//! Entry points: [`Loads`], [`Equilibrium`].

use super::error::TissueError;
use super::handles::{Anchor, Handle};
use super::numbering::Numbering;
use crate::mesh::TetMesh;

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

/// Balance of tissue under [`Loads`].
#[derive(Clone, Debug, PartialEq)]
pub struct Equilibrium {
    /// Displacement of every node \[m\], (n x 3).
    pub displacement_m: Vec<[f64; 3]>,
    /// Force of each handle on the tissue \[N\], (h x 3).
    pub handle_force_n: Vec<[f64; 3]>,
    /// Force that every node gets from outside: loads, handles, and what fixed nodes carry
    /// \[N\], (n x 3).
    pub node_force_n: Vec<[f64; 3]>,
    /// Largest unbalanced force on a free node over the largest force on any node.
    pub residual: f64,
}

/// Mass of a mesh \[kg\], and the weight of each of its nodes: a quarter of that of each of its cells, which is what
/// gravity does on linear shape functions. `density_kg_per_m3` is that of each cell, (m).
pub fn weight(
    mesh: &TetMesh,
    density_kg_per_m3: &[f64],
    gravity_m_per_s2: [f64; 3],
) -> (f64, Vec<NodeLoad>) {
    let mut masses = vec![0.0; mesh.points_m().len()];
    for (cell, density) in mesh.cells().iter().zip(density_kg_per_m3) {
        let [p0, p1, p2, p3] = mesh.corners(*cell);
        let volume_m3 = (p1 - p0).dot(&(p2 - p0).cross(&(p3 - p0))) / 6.0;
        for node in cell {
            masses[*node as usize] += 0.25 * density * volume_m3;
        }
    }
    let on_nodes = (0u32..).zip(&masses).map(|(node, mass)| NodeLoad {
        node,
        force_n: gravity_m_per_s2.map(|g| mass * g),
    });
    (masses.iter().sum(), on_nodes.collect())
}

impl Loads {
    /// Force on every node \[N\], (n x 3).
    pub(super) fn node_forces(&self, numbering: &Numbering) -> Result<Vec<[f64; 3]>, TissueError> {
        let nodes = numbering.nodes();
        let mut forces = vec![[0.0; 3]; nodes];
        for load in &self.forces {
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

    /// Displacement of every fixed node \[m\], zero for free ones, (n x 3).
    pub(super) fn fixed_field(&self, numbering: &Numbering) -> Result<Vec<[f64; 3]>, TissueError> {
        let nodes = numbering.nodes();
        let mut field = vec![[0.0; 3]; nodes];
        for &(node, displacement) in &self.fixed_displacement_m {
            let at = field
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "a prescribed displacement",
                    node,
                    nodes,
                })?;
            if !numbering.is_fixed(node) {
                return Err(TissueError::NotFixed(node));
            }
            if !displacement.iter().all(|u| u.is_finite()) {
                return Err(TissueError::NotFinite("a prescribed displacement"));
            }
            *at = displacement;
        }
        Ok(field)
    }

    /// Targets of the handles less what their fixed nodes, displaced by `fixed_field`, do to them
    /// \[m\], (3 h).
    pub(super) fn handle_targets(&self, fixed_field: &[[f64; 3]]) -> Result<Vec<f64>, TissueError> {
        let mut targets = Vec::with_capacity(3 * self.handles.len());
        for handle in &self.handles {
            let fixed_part = handle.anchor.sum(|node| fixed_field[node as usize]);
            for (target, fixed) in handle.target_displacement_m.iter().zip(fixed_part) {
                if !target.is_finite() {
                    return Err(TissueError::NotFinite("a handle's target"));
                }
                targets.push(target - fixed);
            }
        }
        Ok(targets)
    }

    /// Force on the unknowns \[N\].
    pub(crate) fn on_unknowns(&self, numbering: &Numbering) -> Result<Vec<f64>, TissueError> {
        let mut forces = vec![0.0; numbering.unknowns()];
        for (node, force) in (0u32..).zip(self.node_forces(numbering)?) {
            if let Some(first) = numbering.first_unknown(node) {
                forces[first..first + 3].copy_from_slice(&force);
            }
        }
        Ok(forces)
    }

    /// These loads with the handles' forces `force_n` (h x 3) \[N\] in place of the handles.
    pub(crate) fn held_by(&self, force_n: &[[f64; 3]]) -> Self {
        let held = self.handles.iter().zip(force_n);
        let on_nodes = held.flat_map(|(handle, force)| {
            let parts = handle.anchor.vertices.iter().zip(&handle.anchor.weights);
            parts.map(move |(&node, &weight)| NodeLoad {
                node,
                force_n: force.map(|f| f * weight),
            })
        });
        let given = self.forces.iter().copied();
        Self {
            forces: given.chain(on_nodes).collect(),
            handles: Vec::new(),
            fixed_displacement_m: self.fixed_displacement_m.clone(),
        }
    }

    /// Points of the handles, (h).
    pub(crate) fn anchors(&self) -> Vec<Anchor> {
        let anchors = self.handles.iter().map(|handle| handle.anchor.clone());
        anchors.collect()
    }
}

impl Equilibrium {
    /// Books what was found: `internal` forces balance `outside` forces and the handles' multipliers
    /// `lambda` on free nodes, or nearly.
    pub(super) fn new(
        loads: &Loads,
        numbering: &Numbering,
        displacement_m: Vec<[f64; 3]>,
        internal: Vec<[f64; 3]>,
        outside: &[[f64; 3]],
        lambda: &[f64],
    ) -> Self {
        let mut unbalanced: Vec<[f64; 3]> = internal
            .iter()
            .zip(outside)
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
        let scale = largest(&mut internal.iter());
        let left = largest(
            &mut (0u32..)
                .zip(&unbalanced)
                .filter(|(node, _)| !numbering.is_fixed(*node))
                .map(|(_, force)| force),
        );
        Self {
            displacement_m,
            handle_force_n: lambda
                .chunks_exact(3)
                .map(|l| [-l[0], -l[1], -l[2]])
                .collect(),
            node_force_n: internal,
            residual: if scale > 0.0 { left / scale } else { left },
        }
    }
}
