//! The classical ChainMail: quasi-static, box-shaped bounds, only the dragged element moves.
//!
//! Entry point: [`ClassicalChainMail`]. After zhang-2017, 3.1, with the sign of (3.3) corrected, and with the
//! relaxation towards shorter springs that Gibson (1997) has between moves; `relaxations` 0 is as printed.

use super::links::{Links, difference, square};
use super::propagate::Propagation;
use super::region::Box3;
use crate::drive_check::{failed, refused};
use crate::held::{Held, load, ratio};
use crate::in_place::clone_in_place;
use crate::rigid::momenta;
use crate::secant::{Trials, secant_of_step, secant_to_come};
use crate::setting::within;
use crate::{BoundaryConditions, BuildError, Diagnostics, Material, Outcome, Tangent, Tissue};
use sutura_mesh::TetMesh;

/// Drags of a step that are remembered, for each node.
const DRAGS: usize = 32;

/// Share of the way to where springs pull that a relaxation goes: 1 would be the limit of stability.
const RELAXATION: f64 = 0.8;

/// What a [`ClassicalChainMail`] can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassicalSettings {
    /// Least length of a link along an axis as a share of that at rest, from 0 to 1; 0.7.
    pub least: f64,
    /// Greatest length of a link along an axis as a share of that at rest, from 1 to 10; 1.3.
    pub greatest: f64,
    /// Shear that is allowed, as a share of the link's lengths along the other axes, from 0 to 10; 0.15, so
    /// that a square may become a lozenge of 10 degrees.
    pub shear: f64,
    /// Sweeps of relaxation in a step; 4, for a quarter of a millisecond on 10,000 nodes.
    pub relaxations: u32,
    /// How far beyond a bound an element may stay, as a share of the mean edge; 1e-6, beyond notice and
    /// above round-off.
    pub tolerance: f64,
    /// Visits of elements in a step, for each node; 20, twice what a poke of a third of the body takes.
    pub visits: u32,
    /// Mass density \[kg/m^3\], for the momenta that are reported and nothing else; 1060, of liver.
    pub density_kg_per_m3: f64,
}

impl Default for ClassicalSettings {
    fn default() -> Self {
        Self {
            least: 0.7,
            greatest: 1.3,
            shear: 0.15,
            relaxations: 4,
            tolerance: 1e-6,
            visits: 20,
            density_kg_per_m3: 1060.0,
        }
    }
}

/// Tissue as a classical ChainMail.
#[derive(Clone, Debug)]
pub struct ClassicalChainMail {
    links: Links,
    settings: ClassicalSettings,
    region: Box3,
    state: State,
    trials: Trials<State>,
}

/// Everything that a step changes.
#[derive(Debug)]
struct State {
    x: Vec<[f64; 3]>,
    previous: Vec<[f64; 3]>,
    force: Vec<[f64; 3]>,
    is_held: Vec<bool>,
    held: Held,
    propagation: Propagation,
    energy_j: f64,
    /// Whether links may be out of bounds from an earlier step.
    left_over: bool,
}

clone_in_place!(State {
    x,
    previous,
    force,
    is_held,
    held,
    propagation,
    energy_j,
    left_over,
});

impl ClassicalChainMail {
    /// Tissue at rest on the nodes and edges of a mesh, of one material and one box for all. Of the material,
    /// Young's modulus sets the springs' stiffness; Poisson's ratio has no say.
    ///
    /// # Errors
    /// A material or a setting out of range.
    pub fn new(
        mesh: &TetMesh,
        material: Material,
        settings: ClassicalSettings,
    ) -> Result<Self, BuildError> {
        settings.check()?;
        let links = Links::new(mesh, &material.into(), settings.density_kg_per_m3, 1.0)?;
        Ok(Self {
            region: Box3 {
                least: settings.least,
                greatest: settings.greatest,
                shear: settings.shear,
            },
            state: State::new(&links),
            trials: Trials::new(State::new(&links), links.nodes()),
            links,
            settings,
        })
    }

    /// Nodes that others dragged along in the last step.
    pub fn moved(&self) -> usize {
        self.state.propagation.moved
    }

    /// Greatest excess of a node over the bounds its neighbours set \[m\]; links between two held nodes do not
    /// count.
    pub fn greatest_excess_m(&self) -> f64 {
        let (state, links) = (&self.state, &self.links);
        let mut most = 0.0f64;
        for i in 0..links.nodes() {
            for link in links.owned.of(i) {
                let j = link.to as usize;
                if state.is_held[i] && state.is_held[j] {
                    continue;
                }
                let d = difference(&state.x[i], &state.x[j]);
                let offset = difference(&links.rest_m[i], &links.rest_m[j]);
                for (at, (least, greatest)) in d.into_iter().zip(self.region.intervals(offset)) {
                    most = most.max(at - greatest).max(least - at);
                }
            }
        }
        most
    }
}

impl ClassicalSettings {
    fn check(&self) -> Result<(), BuildError> {
        within("least", self.least, 0.0, 1.0, "from 0 to 1")?;
        within("greatest", self.greatest, 1.0, 10.0, "from 1 to 10")?;
        within("shear", self.shear, 0.0, 10.0, "from 0 to 10")?;
        let relaxations = f64::from(self.relaxations);
        within("relaxations", relaxations, 0.0, 1e6, "from 0 to 1e6")?;
        within("tolerance", self.tolerance, 1e-9, 0.1, "from 1e-9 to 0.1")?;
        within("visits", f64::from(self.visits), 1.0, 1e6, "from 1 to 1e6")?;
        let density = self.density_kg_per_m3;
        within("density_kg_per_m3", density, 1.0, 1e5, "from 1 to 1e5")
    }
}

impl State {
    /// At rest.
    fn new(links: &Links) -> Self {
        let nodes = links.nodes();
        Self {
            x: links.rest_m.clone(),
            previous: links.rest_m.clone(),
            force: vec![[0.0; 3]; nodes],
            is_held: vec![false; nodes],
            held: Held::new(nodes),
            propagation: Propagation::new(nodes, DRAGS * nodes),
            energy_j: 0.0,
            left_over: false,
        }
    }

    /// Forces \[N\] and energy \[J\] of the springs where elements are.
    fn springs(&mut self, links: &Links) {
        self.force.fill([0.0; 3]);
        self.energy_j = 0.0;
        for i in 0..links.nodes() {
            for link in links.owned.of(i) {
                let j = link.to as usize;
                let d = difference(&self.x[i], &self.x[j]);
                let length = square(d).sqrt();
                let rest = link.rest_sq.sqrt();
                // Straight in the length: it may shrink to nothing, where Green's strain gives way.
                let k = 2.0 * link.spring * link.rest_sq;
                let pull = if length > 0.0 {
                    k * (length - rest) / length
                } else {
                    0.0
                };
                for axis in 0..3 {
                    self.force[i][axis] += pull * d[axis];
                    self.force[j][axis] -= pull * d[axis];
                }
                self.energy_j += 0.5 * k * (length - rest) * (length - rest);
            }
        }
    }

    /// One sweep towards balance: each free element goes as far as its springs' stiffness says.
    fn relax(&mut self, links: &Links, drive: &BoundaryConditions<'_>) {
        self.springs(links);
        for i in 0..links.nodes() {
            if self.is_held[i] {
                continue;
            }
            let load = load(drive, i);
            for axis in 0..3 {
                let pull = self.force[i][axis] + load[axis];
                self.x[i][axis] += RELAXATION * pull / links.stiffness[i];
            }
        }
    }

    /// Share of the forces that is out of balance; writes the reactions.
    fn react(&mut self, drive: &BoundaryConditions<'_>) -> f64 {
        for (force, load) in self.force.iter_mut().zip(drive.force_n) {
            for axis in 0..3 {
                force[axis] += load[axis];
            }
        }
        self.propagation.hand_back(&mut self.force);
        let (force, is_held) = (&self.force, &self.is_held);
        let reaction = |i: usize| force[i].map(|force| -force);
        let (mut acting, _) = self.held.react(drive, reaction, |_| [0.0; 3]);
        let mut unbalanced = 0.0;
        for (i, force) in force.iter().enumerate() {
            if !is_held[i] {
                unbalanced += square(*force);
                acting += square(load(drive, i));
            }
        }
        ratio(unbalanced, acting).sqrt()
    }
}

impl Tissue for ClassicalChainMail {
    /// Quasi-static: `step_s` only scales the momenta. Loads act through the relaxation.
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics {
        let links = &self.links;
        let state = &mut self.state;
        if let Some(reason) = refused(drive, links.nodes(), step_s) {
            return failed(reason, state.energy_j);
        }
        state.previous.copy_from_slice(&state.x);
        state.propagation.begin();
        let State {
            held,
            is_held,
            propagation,
            x,
            ..
        } = state;
        held.hold(drive, |i| {
            is_held[i] = false;
            // Links to it may have been out of bounds at both ends' wish.
            propagation.push(i as u32);
        });
        for &(node, displacement) in drive.held {
            let i = node as usize;
            is_held[i] = true;
            let rest = links.rest_m[i];
            let target = [0, 1, 2].map(|axis| rest[axis] + displacement[axis]);
            if x[i] != target {
                x[i] = target;
                propagation.push(node);
            }
        }
        let slack_m = self.settings.tolerance * links.edge_m;
        let most = u64::from(self.settings.visits) * links.nodes() as u64;
        if self.settings.relaxations > 0 || state.left_over {
            for _ in 0..self.settings.relaxations {
                state.relax(links, drive);
            }
            // Any element may be out of bounds now, but what was moved from outside spreads first.
            for &(node, _) in drive.held {
                state.propagation.push(node);
            }
            (0..links.nodes() as u32).for_each(|node| state.propagation.push(node));
        }
        let within = state.propagation.spread(
            links,
            &self.region,
            slack_m,
            &state.is_held,
            &mut state.x,
            most,
        );
        state.left_over = !within;
        state.springs(links);
        let residual = state.react(drive);
        let moving = |i: usize| difference(&state.previous[i], &state.x[i]).map(|d| d / step_s);
        let all = (0..links.nodes()).map(|i| (links.mass_kg[i], state.x[i], moving(i)));
        let (momentum, angular_momentum) = momenta(all);
        let size = square(momentum) + square(angular_momentum) + state.energy_j;
        if !(size.is_finite() && residual.is_finite()) {
            state.x.copy_from_slice(&state.previous);
            state.propagation.begin();
            state.springs(links);
            state.left_over = true;
            return state.held.give_up(drive, state.energy_j);
        }
        let outcome = if within {
            Outcome::Converged
        } else {
            Outcome::Unfinished
        };
        Diagnostics {
            outcome,
            iterations: state.propagation.visits.div_ceil(links.nodes() as u64) as u32
                + self.settings.relaxations,
            residual,
            // Within the limits what is out of balance is what relaxation has not reached yet: it is asked for some, not for
            // balance. Beyond them springs pull as they do anywhere: nothing is jammed.
            force_error: outcome.force_error(residual),
            energy_j: state.energy_j,
            energy_difference: f64::NAN,
            momentum,
            angular_momentum,
        }
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.state.x
    }

    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.state.held.reactions_n
    }

    /// A secant of one step over a hundredth of the mean edge and half of that.
    fn tangent(
        &mut self,
        drive: &BoundaryConditions<'_>,
        moved: &[usize],
        step_s: f64,
    ) -> Option<Tangent> {
        let reach_m = 0.01 * self.links.edge_m;
        secant_of_step(
            self,
            |this| (&mut this.state, &mut this.trials),
            drive,
            moved,
            reach_m,
            step_s,
        )
    }

    /// As [`tangent`](Self::tangent) is.
    fn tangent_to_come(
        &mut self,
        drive: &BoundaryConditions<'_>,
        touched: &[(u32, f64)],
        step_s: f64,
    ) -> Option<Tangent> {
        let reach_m = 0.01 * self.links.edge_m;
        secant_to_come(
            self,
            |this| (&mut this.state, &mut this.trials),
            |this, node| this.links.rest_m.get(node).copied(),
            drive,
            touched,
            reach_m,
            step_s,
        )
    }
}
