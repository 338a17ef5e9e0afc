//! Linear tissue as a tissue model: any nodes may be held, and others in every step.
//!
//! Entry point: [`LinearModel::new`]. One solve a step while the held nodes stay the same; a factorisation
//! when they change. Reactions and tangent are exact.

use super::assembly::{self, assemble};
use super::element::Element;
use super::error::TissueError;
use super::factor::{Factor, Need, RefactorScratch, SolveScratch};
use super::held::{Held, fault_of};
use super::numbering::Numbering;
use super::pattern::Pattern;
use crate::mesh::TetMesh;
use sutura_models::{BoundaryConditions, Diagnostics, Materials, Outcome, Tangent, Tissue};

/// Said where held nodes leave a rigid motion.
pub(super) const FLOATING: &str =
    "the held nodes do not keep tissue from floating or turning: hold three that are not on a line";

/// Linear-elastic tissue behind [`Tissue`].
pub struct LinearModel {
    rest_m: Vec<[f64; 3]>,
    pattern: Pattern,
    /// Lower triangle over all nodes \[N/m\].
    stiffness: Vec<f64>,
    /// Of the stiffness with the held nodes cut off.
    factor: Factor,
    held: Held,
    masked: Vec<f64>,
    refactor: RefactorScratch,
    solve: SolveScratch,
    /// Displacement \[m\] and what it takes \[N\], (3 n).
    u: Vec<f64>,
    internal: Vec<f64>,
    rhs: Vec<f64>,
    next: Vec<f64>,
    positions_m: Vec<[f64; 3]>,
    reactions_n: Vec<[f64; 3]>,
    energy_j: f64,
}

impl LinearModel {
    /// Assembles the stiffness of `mesh`; `materials` is one [`Material`](super::Material) for all cells,
    /// or [`Materials`].
    ///
    /// # Errors
    /// A material out of range; a mesh too large for memory.
    pub fn new(mesh: &TetMesh, materials: impl Into<Materials>) -> Result<Self, TissueError> {
        let materials = materials.into();
        materials.check(mesh.cells().len())?;
        let nodes = mesh.points_m().len();
        let numbering = Numbering::new(nodes, &[])?;
        assembly::begin(mesh.cells().len())?;
        let elements: Vec<Element> = Element::of_mesh(mesh, &materials)
            .iter()
            .map(|element| element.placed(&numbering))
            .collect();
        let (pattern, stiffness) = assemble(&elements, numbering.free());
        // The factor, and the next one while it is made.
        let need = Need {
            copies: 2,
            beside_bytes: 0,
        };
        let factor = Factor::of_identity(&pattern, need)?;
        Ok(Self {
            rest_m: mesh.points_m().to_vec(),
            held: Held::none(mesh),
            masked: vec![0.0; stiffness.len()],
            refactor: factor.refactor_scratch(),
            solve: factor.scratch(),
            u: vec![0.0; 3 * nodes],
            internal: vec![0.0; 3 * nodes],
            rhs: vec![0.0; 3 * nodes],
            next: vec![0.0; 3 * nodes],
            positions_m: mesh.points_m().to_vec(),
            reactions_n: Vec::new(),
            energy_j: 0.0,
            pattern,
            stiffness,
            factor,
        })
    }

    /// Factors for the held nodes of the drive if they are others; `false` if tissue can float.
    fn hold(&mut self, drive: &BoundaryConditions<'_>) -> bool {
        if !self.held.take(drive) {
            return true;
        }
        self.masked.copy_from_slice(&self.stiffness);
        self.held.mask(&self.pattern, &mut self.masked);
        let held = !self.held.leaves_rigid_motion(&self.rest_m, drive)
            && self
                .factor
                .refactor(&self.pattern, &self.masked, &mut self.refactor)
                .is_ok()
            && self
                .factor
                .keeps(&self.masked, &mut self.rhs, &mut self.solve);
        if !held {
            self.held.forget();
        }
        held
    }

    fn diagnostics(&self, outcome: Outcome, residual: f64) -> Diagnostics {
        Diagnostics {
            outcome,
            iterations: 1,
            residual,
            force_error: outcome.force_error(residual),
            energy_j: self.energy_j,
            energy_difference: f64::NAN,
            momentum: [0.0; 3],
            angular_momentum: [0.0; 3],
        }
    }

    /// Displacements in `next` for what free nodes shall carry, from held ones' displacements in `next`.
    fn solve_free(&mut self, force_n: &[[f64; 3]]) {
        self.pattern
            .multiply(&self.stiffness, &self.next, &mut self.rhs);
        let forces = force_n.as_flattened();
        for (index, carried) in self.rhs.iter_mut().enumerate() {
            *carried = forces.get(index).unwrap_or(&0.0) - *carried;
        }
        self.held.clear(&mut self.rhs);
        self.factor.solve(&mut self.rhs, &mut self.solve);
        for (u, found) in self.next.iter_mut().zip(&self.rhs) {
            *u += found;
        }
    }
}

impl Tissue for LinearModel {
    fn step(&mut self, drive: &BoundaryConditions<'_>, _step_s: f64) -> Diagnostics {
        if let Some(fault) = fault_of(drive, self.rest_m.len()) {
            return self.diagnostics(Outcome::Failed(fault), f64::NAN);
        }
        if !self.hold(drive) {
            return self.diagnostics(Outcome::Failed(FLOATING), f64::NAN);
        }
        self.next.fill(0.0);
        for (node, target) in drive.held {
            self.next[3 * *node as usize..][..3].copy_from_slice(target);
        }
        self.solve_free(drive.force_n);
        self.pattern
            .multiply(&self.stiffness, &self.next, &mut self.rhs);
        let energy: f64 = self.next.iter().zip(&self.rhs).map(|(u, f)| u * f).sum();
        if !(energy.is_finite() && self.next.iter().all(|u| u.is_finite())) {
            return self.diagnostics(Outcome::Failed("the displacement is not finite"), f64::NAN);
        }
        std::mem::swap(&mut self.u, &mut self.next);
        std::mem::swap(&mut self.internal, &mut self.rhs);
        self.energy_j = 0.5 * energy;
        place(&self.rest_m, &self.u, &mut self.positions_m);
        react(drive, &self.internal, &mut self.reactions_n);
        let left = left_over(drive, &self.internal, &self.held);
        self.diagnostics(Outcome::Converged, left)
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.positions_m
    }

    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.reactions_n
    }

    fn tangent(
        &mut self,
        drive: &BoundaryConditions<'_>,
        moved: &[usize],
        _step_s: f64,
    ) -> Option<Tangent> {
        let known = fault_of(drive, self.rest_m.len()).is_none()
            && moved.iter().all(|index| *index < drive.held.len());
        if !known || !self.hold(drive) {
            return None;
        }
        let mut stiffness = [[0.0; 3]; 3];
        for axis in 0..3 {
            self.next.fill(0.0);
            for index in moved {
                self.next[3 * drive.held[*index].0 as usize + axis] = 1.0;
            }
            self.solve_free(&[]);
            self.pattern
                .multiply(&self.stiffness, &self.next, &mut self.rhs);
            for index in moved {
                let force = &self.rhs[3 * drive.held[*index].0 as usize..][..3];
                for (row, force) in stiffness.iter_mut().zip(force) {
                    row[axis] += force;
                }
            }
        }
        Some(Tangent {
            stiffness_n_per_m: stiffness,
            error: 0.0,
        })
    }
}

/// Rest plus displacement.
pub(super) fn place(rest_m: &[[f64; 3]], u: &[f64], positions_m: &mut [[f64; 3]]) {
    for ((at, rest), u) in positions_m.iter_mut().zip(rest_m).zip(u.chunks_exact(3)) {
        *at = [rest[0] + u[0], rest[1] + u[1], rest[2] + u[2]];
    }
}

/// Force of held nodes on tissue: what it takes less what the loads give.
pub(super) fn react(
    drive: &BoundaryConditions<'_>,
    internal: &[f64],
    reactions_n: &mut Vec<[f64; 3]>,
) {
    reactions_n.clear();
    reactions_n.extend(drive.held.iter().map(|(node, _)| {
        let node = *node as usize;
        let load = drive.force_n.get(node).copied().unwrap_or_default();
        [0, 1, 2].map(|axis| internal[3 * node + axis] - load[axis])
    }));
}

/// Force out of balance at free nodes over the larger of the forces that act, 2-norms.
pub(super) fn left_over(drive: &BoundaryConditions<'_>, internal: &[f64], held: &Held) -> f64 {
    let (mut left, mut inside, mut outside) = (0.0, 0.0, 0.0);
    for (node, inner) in (0u32..).zip(internal.chunks_exact(3)) {
        let load = drive
            .force_n
            .get(node as usize)
            .copied()
            .unwrap_or_default();
        for (inner, load) in inner.iter().zip(load) {
            inside += inner * inner;
            outside += load * load;
            if !held.is(node) {
                left += (load - inner) * (load - inner);
            }
        }
    }
    let scale = f64::max(inside, outside);
    if scale > 0.0 {
        (left / scale).sqrt()
    } else {
        left
    }
}

impl std::fmt::Debug for LinearModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LinearModel")
            .field("nodes", &self.rest_m.len())
            .finish_non_exhaustive()
    }
}
