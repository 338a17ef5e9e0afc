//! The balance of hyperelastic tissue under loads.
//!
//! Entry points: [`HyperelasticTissue::settle`] by the reference's own solver, [`HyperelasticTissue::book`].

use super::super::error::TissueError;
use super::super::loads::{Equilibrium, Loads};
use super::{HyperelasticState, HyperelasticTissue, HyperelasticWorkspace, Hyperelasticity};
use crate::mesh::TetMesh;
use crate::work;
use nalgebra::Vector3;
use sutura_models::hyperelastic::{Hyperelastic, Settings};
use sutura_models::{BoundaryConditions, Outcome, Tissue};

/// Force out of balance over the forces that act.
const TOLERANCE: f64 = 1e-10;

impl HyperelasticTissue {
    /// Brings `state` from rest into balance under `loads`, their handles apart; `mesh` and `substance` are what the tissue was made of.
    /// Allocates.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist, loads and targets that are not finite, and
    /// [`TissueError::NoEquilibrium`]: the state is as before then.
    pub(crate) fn settle(
        &self,
        state: &mut HyperelasticState,
        mesh: &TetMesh,
        substance: &Hyperelasticity<'_>,
        loads: &Loads,
    ) -> Result<(), TissueError> {
        let fixed = loads.fixed_field(&self.numbering)?;
        loads.handle_targets(&fixed)?;
        let force_n = loads.node_forces(&self.numbering)?;
        if fixed.iter().chain(&force_n).flatten().all(|x| *x == 0.0) {
            return Ok(());
        }
        let settings = Settings {
            cells: substance.cells,
            tolerance: TOLERANCE,
            ..Settings::default()
        };
        let mut whole = Hyperelastic::new(mesh, substance.laws, settings)?;
        let held: Vec<(u32, [f64; 3])> = (0u32..)
            .zip(&fixed)
            .filter(|(node, _)| self.is_fixed(*node))
            .map(|(node, u)| (node, *u))
            .collect();
        let drive = BoundaryConditions {
            held: &held,
            force_n: &force_n,
        };
        work::begin("looking for the tissue's rest under its loads", || {
            format!("{} nodes", self.nodes())
        });
        if work::is_stopped() {
            return Err(TissueError::Stopped);
        }
        let done = whole.step(&drive, 0.0);
        if done.outcome != Outcome::Converged {
            return Err(TissueError::NoEquilibrium {
                share: 0.0,
                residual: done.residual,
            });
        }
        let places = whole.positions_m().iter().zip(mesh.points_m());
        for (node, (at, rest)) in (0u32..).zip(places) {
            let place = self.numbering.place(node) as usize;
            state.u[place] = [0, 1, 2].map(|axis| at[axis] - rest[axis]);
        }
        state.moved = true;
        Ok(())
    }

    /// `state` as it is, under `loads` without handles: the residual says how far from balance. Allocates.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist or are not finite.
    pub(crate) fn book(
        &self,
        state: &HyperelasticState,
        loads: &Loads,
    ) -> Result<Equilibrium, TissueError> {
        let outside = loads.node_forces(&self.numbering)?;
        let mut workspace = self.workspace();
        self.update(state, &mut workspace);
        let displacement = (0..self.nodes() as u32).map(|node| state.displacement_m(self, node));
        let internal = workspace.nodal.iter().map(|force| (*force).into());
        Ok(Equilibrium::new(
            loads,
            &self.numbering,
            displacement.collect(),
            internal.collect(),
            &outside,
            &[],
        ))
    }

    /// Displacement of every node \[m\], (n x 3).
    pub(crate) fn displacement_m(&self, state: &HyperelasticState) -> Vec<[f64; 3]> {
        let nodes = 0..self.nodes() as u32;
        nodes.map(|node| state.displacement_m(self, node)).collect()
    }

    /// Elastic energy of a state \[J\].
    pub(crate) fn energy_j(
        &self,
        state: &HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
    ) -> f64 {
        self.update(state, workspace);
        let x: &[Vector3<f64>] = &workspace.x;
        workspace.elasticity.energy_j(x)
    }
}
