//! Shape matching as tissue: motion in time, held nodes, recovery of what was let go.
//!
//! Entry point: [`ShapeMatching`]. After qian-2015, algorithm 1; the recovering rate is per second instead of per step,
//! and masses grow where a step would overshoot the goal (a stiffness factor above 1).

use super::clusters::Clusters;
use super::goals::pull;
use crate::drive_check::{failed, refused};
use crate::held::{Held, load, ratio};
use crate::in_place::clone_in_place;
use crate::rigid::{Rigid, momenta};
use crate::secant::{Trials, secant_of_step, secant_to_come};
use crate::setting::within;
use crate::{BoundaryConditions, BuildError, Diagnostics, Materials, Outcome, Tangent, Tissue};
use nalgebra::Vector3;
use sutura_mesh::TetMesh;

/// What [`ShapeMatching`] can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeMatchingSettings {
    /// Edges from a cluster's centre to its rim, from 1 to 1000; 2: enough overlap to bend smoothly, small
    /// enough to be local.
    pub rings: u32,
    /// How fast a node that was let go becomes free to recover its shape \[1/s\]; 5, so that a dent is seen to
    /// fill over a fifth of a second. 0 keeps every dent; `f64::INFINITY` is plain shape matching.
    pub recovery_per_s: f64,
    /// Time in which the slowest motion dies away \[s\]; 0.05, so that tissue follows a hand (up to 5 Hz)
    /// and does not ring.
    pub relaxation_s: f64,
    /// Mass density \[kg/m^3\]; 1060, of liver.
    pub density_kg_per_m3: f64,
}

impl Default for ShapeMatchingSettings {
    fn default() -> Self {
        Self {
            rings: 2,
            recovery_per_s: 5.0,
            relaxation_s: 0.05,
            density_kg_per_m3: 1060.0,
        }
    }
}

/// Tissue by goal-limited shape matching.
#[derive(Clone, Debug)]
pub struct ShapeMatching {
    clusters: Clusters,
    settings: ShapeMatchingSettings,
    rest_m: Vec<[f64; 3]>,
    extent_m: f64,
    state: State,
    trials: Trials<State>,
}

/// Everything that a step changes.
#[derive(Debug)]
struct State {
    x: Vec<[f64; 3]>,
    previous: Vec<[f64; 3]>,
    v: Vec<[f64; 3]>,
    /// Pull of the goals at `x` \[N\], not limited.
    pull: Vec<[f64; 3]>,
    /// Share of the pull that is held back, eta of qian-2015, (n).
    limited: Vec<f64>,
    mass: Vec<f64>,
    is_held: Vec<bool>,
    held: Held,
    energy_j: f64,
    work_j: f64,
    step_s: f64,
    decay: f64,
    moved: usize,
}

clone_in_place!(State {
    x,
    previous,
    v,
    pull,
    limited,
    mass,
    is_held,
    held,
    energy_j,
    work_j,
    step_s,
    decay,
    moved,
});

impl ShapeMatching {
    /// Tissue at rest on the nodes of a mesh. Of a material, Young's modulus sets the weights; Poisson's ratio has
    /// no say: clusters resist each strain on its own, as if it were 0.
    ///
    /// # Errors
    /// A material or a setting out of range.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        settings: ShapeMatchingSettings,
    ) -> Result<Self, BuildError> {
        settings.check()?;
        let materials = materials.into();
        materials.check(mesh.cells().len())?;
        let clusters = Clusters::new(mesh, &materials, settings.rings);
        let rest_m = mesh.points_m().to_vec();
        let extent = |axis: usize| {
            let along = rest_m.iter().map(|p| p[axis]);
            let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (x.min(low), x.max(high))
            });
            high - low
        };
        Ok(Self {
            extent_m: extent(0).max(extent(1)).max(extent(2)),
            state: State::new(&rest_m),
            trials: Trials::new(State::new(&rest_m), rest_m.len()),
            clusters,
            settings,
            rest_m,
        })
    }

    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.clusters.count()
    }

    /// Nodes that changed place in the last step.
    pub fn moved(&self) -> usize {
        self.state.moved
    }

    /// Share of each node's pull that is held back, eta of qian-2015: 1 while held, then down to 0, (n).
    pub fn limited(&self) -> &[f64] {
        &self.state.limited
    }

    /// Mass of all nodes in steps as long as the last over their true mass.
    pub fn mass_factor(&self) -> f64 {
        let true_mass: f64 =
            self.clusters.volume.iter().sum::<f64>() * self.settings.density_kg_per_m3;
        self.state.mass.iter().sum::<f64>() / true_mass
    }

    /// Gives every node a velocity \[m/s\], (n x 3); does nothing if they are not as many or not finite.
    pub fn set_velocities(&mut self, velocities_m_per_s: &[[f64; 3]]) {
        let finite = velocities_m_per_s.iter().flatten().all(|v| v.is_finite());
        if finite && velocities_m_per_s.len() == self.rest_m.len() {
            self.state.v.copy_from_slice(velocities_m_per_s);
        }
    }

    /// Masses and drag for steps of `step_s`: a node pulled by k reaches its goal in no less than a step.
    fn set_step(&mut self, step_s: f64) {
        let state = &mut self.state;
        state.step_s = step_s;
        let mut total = 0.0;
        for (node, mass) in state.mass.iter_mut().enumerate() {
            let true_mass = self.settings.density_kg_per_m3 * self.clusters.volume[node];
            *mass = true_mass.max(step_s * step_s * self.clusters.stiffness[node]);
            total += *mass;
        }
        let wave = std::f64::consts::FRAC_PI_2 / self.extent_m;
        let slowest_sq = wave * wave * self.clusters.modulus_volume / total;
        state.decay = (-slowest_sq * self.settings.relaxation_s * step_s).exp();
    }
}

impl ShapeMatchingSettings {
    fn check(&self) -> Result<(), BuildError> {
        within("rings", f64::from(self.rings), 1.0, 1e3, "from 1 to 1000")?;
        if self.recovery_per_s != f64::INFINITY {
            let limit = "from 0 to 1e6, or infinite";
            within("recovery_per_s", self.recovery_per_s, 0.0, 1e6, limit)?;
        }
        within(
            "relaxation_s",
            self.relaxation_s,
            0.0,
            1e3,
            "from 0 to 1000",
        )?;
        let density = self.density_kg_per_m3;
        within("density_kg_per_m3", density, 1.0, 1e5, "from 1 to 1e5")
    }
}

impl State {
    /// At rest.
    fn new(rest_m: &[[f64; 3]]) -> Self {
        let nodes = rest_m.len();
        Self {
            x: rest_m.to_vec(),
            previous: rest_m.to_vec(),
            v: vec![[0.0; 3]; nodes],
            pull: vec![[0.0; 3]; nodes],
            limited: vec![0.0; nodes],
            mass: vec![0.0; nodes],
            is_held: vec![false; nodes],
            held: Held::new(nodes),
            energy_j: 0.0,
            work_j: 0.0,
            step_s: 0.0,
            decay: 1.0,
            moved: 0,
        }
    }

    /// Holds what the drive holds, and lets the limit of the rest recover.
    fn hold(&mut self, drive: &BoundaryConditions<'_>, rest_m: &[[f64; 3]], recovered: f64) {
        self.held.hold(drive, |i| self.is_held[i] = false);
        for limited in &mut self.limited {
            *limited = (*limited - recovered).max(0.0);
        }
        for &(node, displacement) in drive.held {
            let i = node as usize;
            self.is_held[i] = true;
            self.limited[i] = 1.0;
            self.x[i] = [0, 1, 2].map(|axis| rest_m[i][axis] + displacement[axis]);
        }
    }

    /// Lines 3 to 6: free nodes go where velocity, limited pull and loads take them.
    fn predict(&mut self, drive: &BoundaryConditions<'_>, step_s: f64, decay: f64) {
        for i in 0..self.x.len() {
            if self.is_held[i] {
                continue;
            }
            let (load, part) = (load(drive, i), 1.0 - self.limited[i]);
            for axis in 0..3 {
                let push = part * self.pull[i][axis] + load[axis];
                let v = decay * self.v[i][axis] + step_s / self.mass[i] * push;
                self.x[i][axis] += step_s * v;
            }
        }
    }

    /// Line 24.
    fn velocities(&mut self, step_s: f64) {
        self.moved = 0;
        for i in 0..self.x.len() {
            let (from, to) = (self.previous[i], self.x[i]);
            self.moved += usize::from(from != to);
            for axis in 0..3 {
                self.v[i][axis] = (to[axis] - from[axis]) / step_s;
            }
        }
    }

    /// Squared norm of what pulls free nodes \[N^2\]: none in balance.
    fn unbalanced_sq(&self, drive: &BoundaryConditions<'_>) -> f64 {
        let mut sum = 0.0;
        for i in (0..self.x.len()).filter(|i| !self.is_held[*i]) {
            let (load, part) = (load(drive, i), 1.0 - self.limited[i]);
            for axis in 0..3 {
                sum += (part * self.pull[i][axis] + load[axis]).powi(2);
            }
        }
        sum
    }

    fn momenta(&self) -> ([f64; 3], [f64; 3]) {
        let all = self.mass.iter().zip(&self.x).zip(&self.v);
        momenta(all.map(|((m, x), v)| (*m, *x, *v)))
    }

    /// Where nothing is held, drag acts on what is not rigid motion and leaves both momenta.
    fn drag(&mut self) {
        let (linear, angular) = self.momenta();
        let points = self.mass.iter().copied().zip(self.x.iter().copied());
        let Some(rigid) = Rigid::of(points, linear, angular) else {
            return;
        };
        for (v, x) in self.v.iter_mut().zip(&self.x) {
            let carried = rigid.at(*x);
            *v = (carried + self.decay * (Vector3::from(*v) - carried)).into();
        }
    }

    /// Reactions, work; the squared norm of the forces that act.
    fn react(&mut self, drive: &BoundaryConditions<'_>) -> f64 {
        let mut acting_sq = 0.0;
        for (i, force) in drive.force_n.iter().enumerate() {
            for axis in 0..3 {
                self.work_j += force[axis] * (self.x[i][axis] - self.previous[i][axis]);
                acting_sq += force[axis] * force[axis];
            }
        }
        let (x, previous) = (&self.x, &self.previous);
        let (reactions_sq, work_j) = self.held.react(
            drive,
            |i| {
                let load = load(drive, i);
                [0, 1, 2].map(|axis| -self.pull[i][axis] - load[axis])
            },
            |i| [0, 1, 2].map(|axis| x[i][axis] - previous[i][axis]),
        );
        self.work_j += work_j;
        acting_sq + reactions_sq
    }
}

impl Tissue for ShapeMatching {
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics {
        if let Some(reason) = refused(drive, self.rest_m.len(), step_s) {
            return failed(reason, self.state.energy_j);
        }
        if self.state.step_s != step_s {
            self.set_step(step_s);
        }
        let state = &mut self.state;
        let free = drive.held.is_empty();
        let decay = if free { 1.0 } else { state.decay };
        state.hold(drive, &self.rest_m, self.settings.recovery_per_s * step_s);
        state.predict(drive, step_s, decay);
        state.velocities(step_s);
        if free {
            state.drag();
        }
        let (momentum, angular_momentum) = state.momenta();
        let energies = state.mass.iter().zip(&state.v).zip(&state.is_held);
        let kinetic_j: f64 = energies
            .filter(|(_, held)| !**held)
            .map(|((m, v), _)| 0.5 * m * Vector3::from(*v).norm_squared())
            .sum();
        let finite = momentum
            .iter()
            .chain(&angular_momentum)
            .all(|m| m.is_finite());
        let energy_j = if finite && kinetic_j.is_finite() {
            pull(&self.clusters, &state.x, &mut state.pull)
        } else {
            None
        };
        let Some(energy_j) = energy_j else {
            state.x.copy_from_slice(&state.previous);
            state.v.fill([0.0; 3]);
            pull(&self.clusters, &state.x, &mut state.pull);
            return state.held.give_up(drive, state.energy_j);
        };
        state.energy_j = energy_j;
        let acting_sq = state.react(drive);
        let unbalanced_sq = state.unbalanced_sq(drive);
        state.previous.copy_from_slice(&state.x);
        let kept = energy_j + kinetic_j;
        Diagnostics {
            outcome: Outcome::Converged,
            iterations: 1,
            residual: ratio(unbalanced_sq.sqrt(), acting_sq.sqrt()),
            // What is out of balance is inertia: the goals' pull is known.
            force_error: 0.0,
            energy_j,
            energy_difference: ratio(state.work_j - kept, state.work_j.abs()),
            momentum,
            angular_momentum,
        }
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.state.x
    }

    /// Minus the pull of the goals, not limited, and the load.
    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.state.held.reactions_n
    }

    /// A secant of one step over 0.1 % of the body's extent and half of that: the answer within `step_s`,
    /// before the tissue beyond has followed; stiffer than the balance it relaxes to.
    fn tangent(
        &mut self,
        drive: &BoundaryConditions<'_>,
        moved: &[usize],
        step_s: f64,
    ) -> Option<Tangent> {
        let reach_m = 1e-3 * self.extent_m;
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
        let reach_m = 1e-3 * self.extent_m;
        secant_to_come(
            self,
            |this| (&mut this.state, &mut this.trials),
            |this, node| this.rest_m.get(node).copied(),
            drive,
            touched,
            reach_m,
            step_s,
        )
    }
}
