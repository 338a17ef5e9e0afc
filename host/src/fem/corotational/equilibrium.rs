//! The balance of corotational tissue under loads.
//!
//! Entry points: [`CorotationalTissue::solve`] from rest, [`CorotationalTissue::settle`]. Newton's method with the consistent tangent: the first
//! step of a load increment moves handles and fixed nodes, the next ones go down the potential energy
//! by backtracking (Nocedal & Wright 2006, 3.1). An increment that fails is halved.

use super::super::handles::HeldPoints;
use super::super::loads::{Equilibrium, Loads};
use super::super::rotation::polar;
use super::cell::{gradient, rotated_stress};
use super::linearise::{add, dot};
use super::{
    CorotationalState, CorotationalTissue, CorotationalWorkspace, Linearised, TissueError,
};
use crate::work;
use nalgebra::{Matrix3, UnitQuaternion};

/// Largest out-of-balance force on a free node, over the largest force on any node.
const TOLERANCE: f64 = 1e-10;

/// Newton's method is quadratic once it is near, and linear, about 0.7 a step, with a tangent that
/// had to be projected; what needs more steps needs a smaller increment.
const MOST_STEPS: usize = 100;

/// Smallest share of the loads that is tried by itself.
const LEAST_INCREMENT: f64 = 1.0 / 1024.0;

/// Backtracking stops here, with what it has.
const LEAST_LENGTH: f64 = 1.0 / 1024.0;

/// Loads in the order of places.
struct Target {
    /// Force on each node \[N\], (n x 3).
    outside: Vec<[f64; 3]>,
    /// Displacement of fixed nodes \[m\], (n x 3), zero for free ones.
    fixed: Vec<[f64; 3]>,
    /// Displacement of the handles' anchors \[m\], less what fixed nodes do to them, (3 h).
    handles: Vec<f64>,
}

/// Where the search is.
struct Search<'a> {
    tissue: &'a CorotationalTissue,
    loads: &'a Loads,
    target: Target,
    state: CorotationalState,
    workspace: CorotationalWorkspace,
    /// Multipliers of the handles' rows \[N\], (3 h).
    lambda: Vec<f64>,
}

impl CorotationalTissue {
    /// Displacement and forces under `loads`, from rest. Allocates.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist, are not finite, handles that conflict;
    /// [`TissueError::NoEquilibrium`].
    pub fn solve(&self, loads: &Loads) -> Result<Equilibrium, TissueError> {
        self.settle(&mut self.state(), loads)
    }

    /// As [`Self::solve`], from any state, which is left in balance, or as it was on failure.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn settle(
        &self,
        state: &mut CorotationalState,
        loads: &Loads,
    ) -> Result<Equilibrium, TissueError> {
        let fixed = loads.fixed_field(&self.numbering)?;
        let target = Target {
            outside: self.placed(&loads.node_forces(&self.numbering)?),
            handles: loads.handle_targets(&fixed)?,
            fixed: self.placed(&fixed),
        };
        let mut search = Search {
            tissue: self,
            loads,
            lambda: vec![0.0; target.handles.len()],
            target,
            state: state.clone(),
            workspace: self.workspace(),
        };
        search.run()?;
        let Search {
            target,
            workspace,
            lambda,
            ..
        } = search;
        *state = search.state;
        Ok(Equilibrium::new(
            loads,
            &self.numbering,
            self.by_node(&state.u),
            self.by_node(&workspace.force),
            &self.by_node(&target.outside),
            &lambda,
        ))
    }

    /// `state` as it is, under `loads` without handles: the residual says how far from balance. Allocates.
    ///
    /// # Errors
    /// Loads that name nodes that do not exist or are not finite.
    pub(crate) fn book(
        &self,
        state: &CorotationalState,
        loads: &Loads,
    ) -> Result<Equilibrium, TissueError> {
        let outside = loads.node_forces(&self.numbering)?;
        let mut workspace = self.workspace();
        self.update(&mut state.clone(), &mut workspace);
        Ok(Equilibrium::new(
            loads,
            &self.numbering,
            self.by_node(&state.u),
            self.by_node(&workspace.force),
            &outside,
            &[],
        ))
    }

    /// Stress of each cell \[Pa\], (m x 3 x 3), for a displacement of every node \[m\]: that of small
    /// strain in the frame that turns with the cell, turned into the world's. It is the Cauchy stress to
    /// first order in the strain, and finite for cells that are inverted.
    pub fn stress(&self, displacement_m: &[[f64; 3]]) -> Vec<[[f64; 3]; 3]> {
        self.stress_in(displacement_m, 0..self.elements.len())
    }

    /// The same of some of the cells, in their order.
    pub(crate) fn stress_in(
        &self,
        displacement_m: &[[f64; 3]],
        cells: impl Iterator<Item = usize>,
    ) -> Vec<[[f64; 3]; 3]> {
        let u = self.placed(displacement_m);
        cells
            .filter_map(|cell| self.elements.get(cell))
            .map(|element| {
                let f = Matrix3::identity() + gradient(element, &u);
                let polar = polar(&f, &mut UnitQuaternion::identity());
                rotated_stress(element, &polar).into()
            })
            .collect()
    }

    fn placed(&self, by_node: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut placed = vec![[0.0; 3]; by_node.len()];
        for (node, value) in (0u32..).zip(by_node) {
            placed[self.numbering.place(node) as usize] = *value;
        }
        placed
    }

    /// Displacement of every node \[m\], (n x 3).
    pub(crate) fn displacement_m(&self, state: &CorotationalState) -> Vec<[f64; 3]> {
        self.by_node(&state.u)
    }

    fn by_node(&self, placed: &[[f64; 3]]) -> Vec<[f64; 3]> {
        (0..self.nodes() as u32)
            .map(|node| placed[self.numbering.place(node) as usize])
            .collect()
    }
}

impl Search<'_> {
    /// Goes from rest to the whole load, in one increment if it can.
    fn run(&mut self) -> Result<(), TissueError> {
        let (mut share, mut increment) = (0.0f64, 1.0f64);
        work::begin("looking for the tissue's rest under its loads", || {
            format!("{} nodes", self.tissue.nodes())
        });
        while share < 1.0 {
            work::part((1e3 * share) as usize, 1000);
            let next = (share + increment).min(1.0);
            let before = (self.state.clone(), self.lambda.clone());
            let residual = self.balance(next)?;
            if residual <= TOLERANCE {
                share = next;
                increment *= 2.0;
                continue;
            }
            (self.state, self.lambda) = before;
            increment *= 0.5;
            if increment < LEAST_INCREMENT {
                return Err(TissueError::NoEquilibrium { share, residual });
            }
        }
        Ok(())
    }

    /// Newton's method at a share of the loads; the relative residual it ends with.
    fn balance(&mut self, share: f64) -> Result<f64, TissueError> {
        let mut left = f64::INFINITY;
        for step in 0..MOST_STEPS {
            if work::is_stopped() {
                return Err(TissueError::Stopped);
            }
            self.tissue.update(&mut self.state, &mut self.workspace);
            left = self.residual(share);
            if step > 0 && (left <= TOLERANCE || !left.is_finite()) {
                break;
            }
            if !self.tissue.refactor(&mut self.state, &mut self.workspace) {
                return Ok(f64::INFINITY);
            }
            let mut du = self.out_of_balance(share);
            if step == 0 {
                self.move_fixed(share, &mut du);
            }
            let out_of_balance = du.clone();
            self.state.factor.solve(&mut du, &mut self.workspace.solve);
            self.hold(share, &mut du)?;
            // The first step moves handles and fixed nodes; the energy may rise.
            if step == 0 {
                add(1.0, &du, self.state.unknowns_mut());
            } else {
                let slope = dot(&out_of_balance, &du);
                self.descend(share, &du, slope);
            }
        }
        Ok(left)
    }

    /// Moves fixed nodes to a share of where they go, and takes what that pulls with from `force`.
    fn move_fixed(&mut self, share: f64, force: &mut [f64]) {
        let free = self.tissue.unknowns() / 3;
        let (tissue, workspace) = (self.tissue, &mut self.workspace);
        workspace.direction.fill([0.0; 3]);
        for place in free..tissue.nodes() {
            let target = self.target.fixed[place].map(|u| share * u);
            self.state.moved = true;
            let u = &mut self.state.u[place];
            workspace.direction[place] = [0, 1, 2].map(|axis| target[axis] - u[axis]);
            *u = target;
        }
        tissue.find_twist(workspace, self.state.tangent);
        tissue.multiply(workspace);
        workspace.direction.fill([0.0; 3]);
        add(-1.0, workspace.product.as_flattened(), force);
    }

    /// Corrects `du` so that the handles get to a share of where they go; finds their multipliers.
    fn hold(&mut self, share: f64, du: &mut [f64]) -> Result<(), TissueError> {
        if self.loads.handles.is_empty() {
            return Ok(());
        }
        let linearised = Linearised {
            tissue: self.tissue,
            state: &self.state,
        };
        let held = HeldPoints::new(&linearised, self.loads.anchors())?;
        let u = self.state.unknowns();
        for ((handle, target), lambda) in self
            .loads
            .handles
            .iter()
            .zip(self.target.handles.chunks_exact(3))
            .zip(self.lambda.chunks_exact_mut(3))
        {
            let at = handle.anchor.sum(|node| self.tissue.at_node(u, node));
            for axis in 0..3 {
                lambda[axis] = share * target[axis] - at[axis];
            }
        }
        held.correct(&linearised, du, &mut self.lambda);
        Ok(())
    }

    /// Moves along `du` as far as the potential energy falls enough; `slope` is its fall per length.
    fn descend(&mut self, share: f64, du: &[f64], slope: f64) {
        let start = self.state.unknowns().to_vec();
        let energy = self.potential(share);
        // Near balance the fall drowns in the energy's round-off: the tangent is trusted.
        let drowned = slope <= 1e-9 * self.tissue.energy_j(&self.workspace);
        let mut length = 1.0;
        loop {
            self.state.unknowns_mut().copy_from_slice(&start);
            add(length, du, self.state.unknowns_mut());
            self.tissue.update(&mut self.state, &mut self.workspace);
            if drowned
                || self.potential(share) <= energy - 1e-4 * length * slope
                || length <= LEAST_LENGTH
            {
                return;
            }
            length *= 0.5;
        }
    }

    /// Energy of tissue and loads \[J\].
    fn potential(&self, share: f64) -> f64 {
        let work = dot(self.target.outside.as_flattened(), self.state.unknowns());
        self.tissue.energy_j(&self.workspace) - share * work
    }

    /// Loads less internal forces on the unknowns, without the handles' \[N\].
    fn out_of_balance(&self, share: f64) -> Vec<f64> {
        let outside = self.target.outside.as_flattened();
        self.workspace
            .internal_force()
            .iter()
            .zip(outside)
            .map(|(internal, outside)| share * outside - internal)
            .collect()
    }

    /// Largest out-of-balance force over the largest force on any node.
    fn residual(&self, share: f64) -> f64 {
        let mut left = self.out_of_balance(share);
        for (handle, lambda) in self.loads.handles.iter().zip(self.lambda.chunks_exact(3)) {
            for (&node, &weight) in handle.anchor.vertices.iter().zip(&handle.anchor.weights) {
                if let Some(first) = self.tissue.first_unknown(node) {
                    for axis in 0..3 {
                        left[first + axis] -= weight * lambda[axis];
                    }
                }
            }
        }
        // NaN would get lost in a maximum.
        if !left.iter().all(|x| x.is_finite()) {
            return f64::INFINITY;
        }
        let largest = |values: &[f64]| values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let scale = largest(self.workspace.force.as_flattened());
        let left = largest(&left);
        if left <= self.tissue.round_off_n {
            0.0
        } else {
            left / scale
        }
    }
}
