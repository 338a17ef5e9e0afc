//! Tissue whose nodes move until the energy of its cells balances the loads.
//!
//! Entry point: [`EnergyBalance`]. After zhang-2017, chapter 5: cells move their nodes along the gradients of their
//! strain energy. As printed (5.8) that leads towards W = 0 ([`Form::Printed`]); [`Form::Compliant`] and
//! [`Form::Balanced`] lead to where the gradients balance the loads.

// Indices run over nodes, axes and lanes of several fields at once, as in the equations.
#![allow(clippy::needless_range_loop)]

mod balanced;
mod cells;
mod compliant;
mod density;
mod lattice;
mod nodes;
mod number;
mod printed;
mod relaxation;
mod settings;
mod solver;
mod tangent;
#[cfg(test)]
mod tests;
mod visit;

pub use settings::{Form, Lanes, Motion, Prony, Settings};

use crate::drive_check::{refused, wrong};
use crate::law::Law;
use crate::{BoundaryConditions, BuildError, Diagnostics, Outcome, Tangent, Tissue};
use nalgebra::Vector3;
use solver::{Core, Solve};
use sutura_mesh::TetMesh;

/// Way of a held node in one load step, as a share of a cell's edge.
const BEARABLE: f64 = 1.0 / 3.0;
/// Most load steps that a step is divided into for that.
const MOST_PARTS: u32 = 64;

/// Tissue by energy balance; see [`Settings`] for its forms.
///
/// In quasi-static motion `step_s` only matters to relaxation and may be zero; velocities and momenta are zero. Held nodes
/// may change from step to step: [`Form::Balanced`] then inverts its lattice anew, which takes some
/// milliseconds. In the printed forms loads act as in (5.13), by `step_s^2 / m`.
pub struct EnergyBalance {
    solver: Box<dyn Solve + Send>,
    settings: Settings,
    rest_m: Vec<[f64; 3]>,
    positions_m: Vec<[f64; 3]>,
    /// Edge of a typical cell \[m\].
    edge_m: f64,
    /// Nodes held in the last step, and which are not (n).
    held: Vec<u32>,
    free: Vec<bool>,
    /// Time step for which the solver is ready \[s\], none without inertia; before the first step not at all.
    ready_for_s: Option<Option<f64>>,
    reactions_n: Vec<[f64; 3]>,
    /// Loads of the last step \[N\], (n).
    loads_n: Vec<[f64; 3]>,
    velocity: Vec<[f64; 3]>,
    before: Before,
    /// Gradient of the elastic energy, then with inertia \[N\], (n).
    gradient_n: Vec<[f64; 3]>,
    /// Square of the forces of inertia at free nodes \[N^2\].
    inertia_n2: f64,
    energy_j: f64,
    work_j: f64,
}

/// What a step began with, and a load step of it.
struct Before {
    displacement_m: Vec<[f64; 3]>,
    loads_n: Vec<[f64; 3]>,
    velocity: Vec<[f64; 3]>,
    gradient_n: Vec<[f64; 3]>,
    energy_j: f64,
    work_j: f64,
    part_m: Vec<[f64; 3]>,
    part_n: Vec<[f64; 3]>,
    part_gradient_n: Vec<[f64; 3]>,
}

/// Some held nodes moved by a little more than the drive says.
#[derive(Clone, Copy)]
struct Trial<'a> {
    moved: &'a [usize],
    by_m: [f64; 3],
}

impl EnergyBalance {
    /// Tissue at rest, of one law for all cells or one for each.
    ///
    /// # Errors
    /// A number of laws that does not fit the mesh, a modulus or setting out of range.
    pub fn new(mesh: &TetMesh, laws: &[Law], settings: Settings) -> Result<Self, BuildError> {
        settings.check()?;
        cells::check(laws, mesh.cells().len())?;
        let solver: Box<dyn Solve + Send> = match settings.lanes {
            Lanes::Scalar => Box::new(Core::<f64, 1>::new(mesh, laws, &settings)?),
            Lanes::Wide => Box::new(Core::<f32, 16>::new(mesh, laws, &settings)?),
        };
        let rest_m = mesh.points_m().to_vec();
        let nodes = rest_m.len();
        let none = || vec![[0.0; 3]; nodes];
        Ok(Self {
            solver,
            settings,
            positions_m: rest_m.clone(),
            rest_m,
            edge_m: cells::edge_m(mesh),
            held: Vec::with_capacity(nodes),
            free: vec![true; nodes],
            ready_for_s: None,
            reactions_n: Vec::with_capacity(nodes),
            loads_n: none(),
            velocity: none(),
            before: Before {
                displacement_m: none(),
                loads_n: none(),
                velocity: none(),
                gradient_n: none(),
                energy_j: 0.0,
                work_j: 0.0,
                part_m: none(),
                part_n: none(),
                part_gradient_n: none(),
            },
            gradient_n: none(),
            inertia_n2: 0.0,
            energy_j: 0.0,
            work_j: 0.0,
        })
    }

    /// Settings it was built with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Work of loads and held nodes since rest \[J\].
    pub fn work_j(&self) -> f64 {
        self.work_j
    }

    /// Gives every node a velocity \[m/s\], (n x 3). Without effect on quasi-static motion.
    pub fn set_velocities(&mut self, velocities: &[[f64; 3]]) {
        for (to, from) in self.velocity.iter_mut().zip(velocities) {
            *to = *from;
        }
    }

    /// Why a drive cannot be followed.
    fn objection(&self, drive: &BoundaryConditions<'_>, step_s: f64) -> Option<&'static str> {
        let nodes = self.rest_m.len();
        let printed = matches!(self.settings.form, Form::Printed | Form::Averaged);
        let timeless = self.settings.motion == Motion::QuasiStatic && !printed;
        if timeless && step_s == 0.0 {
            wrong(drive, nodes)
        } else {
            refused(drive, nodes, step_s)
        }
    }

    /// Makes the solver ready for the drive's held nodes.
    fn hold(&mut self, drive: &BoundaryConditions<'_>, part_s: f64) {
        let step_s = (self.settings.motion == Motion::Dynamic).then_some(part_s);
        let known = self.held.len() == drive.held.len()
            && self.held.iter().zip(drive.held).all(|(a, b)| *a == b.0);
        if known && self.ready_for_s == Some(step_s) {
            return;
        }
        self.free.fill(true);
        self.held.clear();
        for (node, _) in drive.held {
            self.free[*node as usize] = false;
            self.held.push(*node);
        }
        self.ready_for_s = Some(step_s);
        self.solver.hold(&self.free, step_s);
    }

    /// Load steps of the way to the drive: as many as are set, and more where held nodes go further than cells
    /// between them bear.
    fn parts(&self, drive: &BoundaryConditions<'_>) -> u32 {
        let printed = matches!(self.settings.form, Form::Printed | Form::Averaged);
        if printed || self.settings.motion == Motion::Dynamic {
            return self.settings.load_steps;
        }
        let way = |(node, to): &(u32, [f64; 3])| {
            let from = self.before.displacement_m[*node as usize];
            (Vector3::from(*to) - Vector3::from(from)).norm()
        };
        let most = drive.held.iter().map(way).fold(0.0, f64::max);
        let needed = (most / (BEARABLE * self.edge_m)).ceil();
        self.settings
            .load_steps
            .max(needed.min(f64::from(MOST_PARTS)) as u32)
    }

    /// Goes to the drive in load steps, as long as all numbers are finite; says how many visits that took and whether they
    /// still are.
    fn advance(
        &mut self,
        drive: &BoundaryConditions<'_>,
        step_s: f64,
        trial: Option<Trial<'_>>,
    ) -> (u32, bool) {
        let parts = self.parts(drive);
        let part_s = step_s / f64::from(parts);
        self.hold(drive, part_s);
        let mut visits = 0;
        for part in 1..=parts {
            let share = f64::from(part) / f64::from(parts);
            for node in 0..self.rest_m.len() {
                self.before.part_m[node] = self.solver.displacement(node);
            }
            self.before.part_n.copy_from_slice(&self.loads_n);
            self.before
                .part_gradient_n
                .copy_from_slice(&self.gradient_n);
            self.aim(drive, share, part_s, trial);
            self.solver.begin(part_s);
            visits += self.solver.iterate();
            self.energy_j = self.solver.energy(&mut self.gradient_n);
            self.account(part_s);
            let numbers = self.gradient_n.as_flattened().iter().sum::<f64>();
            if !(self.energy_j.is_finite() && numbers.is_finite()) {
                return (visits, false);
            }
            if trial.is_none() {
                self.solver.end();
            }
        }
        (visits, true)
    }

    /// Places held nodes, loads, and where inertia leads, for a `share` of the way.
    fn aim(
        &mut self,
        drive: &BoundaryConditions<'_>,
        share: f64,
        part_s: f64,
        trial: Option<Trial<'_>>,
    ) {
        let way = |from: [f64; 3], to: [f64; 3]| {
            [0, 1, 2].map(|c| {
                if share < 1.0 {
                    from[c] + share * (to[c] - from[c])
                } else {
                    to[c]
                }
            })
        };
        let printed = matches!(self.settings.form, Form::Printed | Form::Averaged);
        for node in 0..self.rest_m.len() {
            let load = drive.force_n.get(node).copied().unwrap_or([0.0; 3]);
            let load = way(self.before.loads_n[node], load);
            self.loads_n[node] = load;
            self.solver.load(node, load);
            if !self.free[node] {
                continue;
            }
            let mut at = self.before.part_m[node];
            for c in 0..3 {
                at[c] += part_s * self.velocity[node][c];
                if printed {
                    at[c] += part_s * part_s * load[c] / self.solver.mass()[node];
                }
            }
            self.solver.aim(node, at);
            if printed || self.settings.motion == Motion::Dynamic {
                self.solver.place(node, at);
            }
        }
        for (index, (node, to)) in drive.held.iter().enumerate() {
            let node = *node as usize;
            let mut to = way(self.before.displacement_m[node], *to);
            if let Some(trial) = trial
                && trial.moved.contains(&index)
            {
                for c in 0..3 {
                    to[c] += trial.by_m[c];
                }
            }
            let mut ahead = self.before.part_m[node];
            for c in 0..3 {
                ahead[c] += part_s * self.velocity[node][c];
            }
            self.solver.aim(node, ahead);
            self.solver.place(node, to);
        }
    }

    /// Velocities, the forces of inertia, and work, after a load step.
    fn account(&mut self, part_s: f64) {
        let dynamic = self.settings.motion == Motion::Dynamic;
        self.inertia_n2 = 0.0;
        for node in 0..self.rest_m.len() {
            let now = self.solver.displacement(node);
            let moved = [0, 1, 2].map(|c| now[c] - self.before.part_m[node][c]);
            if dynamic {
                let velocity = moved.map(|x| x / part_s);
                let mass = self.solver.mass()[node];
                for c in 0..3 {
                    let slow = mass * (velocity[c] - self.velocity[node][c]) / part_s;
                    self.gradient_n[node][c] += slow;
                    if self.free[node] {
                        self.inertia_n2 += slow * slow;
                    }
                }
                self.velocity[node] = velocity;
            }
            for c in 0..3 {
                let load = 0.5 * (self.before.part_n[node][c] + self.loads_n[node][c]);
                self.work_j += load * moved[c];
                if !self.free[node] {
                    let gradient =
                        0.5 * (self.before.part_gradient_n[node][c] + self.gradient_n[node][c]);
                    self.work_j += (gradient - load) * moved[c];
                }
            }
        }
    }

    /// Keeps what the next steps depend on.
    fn remember(&mut self) {
        for node in 0..self.rest_m.len() {
            self.before.displacement_m[node] = self.solver.displacement(node);
        }
        self.before.loads_n.copy_from_slice(&self.loads_n);
        self.before.velocity.copy_from_slice(&self.velocity);
        self.before.gradient_n.copy_from_slice(&self.gradient_n);
        self.before.energy_j = self.energy_j;
        self.before.work_j = self.work_j;
        self.solver.save();
    }

    /// As it was when it last remembered.
    fn go_back(&mut self) {
        self.solver.restore();
        self.loads_n.copy_from_slice(&self.before.loads_n);
        self.velocity.copy_from_slice(&self.before.velocity);
        self.gradient_n.copy_from_slice(&self.before.gradient_n);
        self.energy_j = self.before.energy_j;
        self.work_j = self.before.work_j;
    }

    /// Reactions; the share of force out of balance.
    fn weigh(&mut self) -> f64 {
        let (mut lack, mut acting) = (0.0, self.inertia_n2);
        self.reactions_n.clear();
        for node in 0..self.rest_m.len() {
            let (gradient, load) = (self.gradient_n[node], self.loads_n[node]);
            let sum = Vector3::from(gradient) - Vector3::from(load);
            acting += Vector3::from(load).norm_squared();
            if self.free[node] {
                lack += sum.norm_squared();
            } else {
                acting += sum.norm_squared();
                self.reactions_n.push(sum.into());
            }
        }
        if lack == 0.0 {
            0.0
        } else {
            (lack / acting.max(lack * 1e-30)).sqrt()
        }
    }

    fn report(&self, outcome: Outcome, iterations: u32, residual: f64) -> Diagnostics {
        let mut momentum = Vector3::zeros();
        let mut angular_momentum = Vector3::zeros();
        let mut kinetic = 0.0;
        let nodes = self.velocity.iter().zip(&self.positions_m);
        for ((velocity, position), mass) in nodes.zip(self.solver.mass()) {
            let velocity = Vector3::from(*velocity);
            momentum += *mass * velocity;
            angular_momentum += *mass * Vector3::from(*position).cross(&velocity);
            kinetic += 0.5 * mass * velocity.norm_squared();
        }
        let elastic = self.settings.relaxation.is_empty();
        Diagnostics {
            outcome,
            iterations,
            residual,
            force_error: outcome.force_error(residual),
            energy_j: self.energy_j,
            energy_difference: if elastic && self.work_j != 0.0 {
                (self.work_j - self.energy_j - kinetic) / self.work_j
            } else {
                f64::NAN
            },
            momentum: momentum.into(),
            angular_momentum: angular_momentum.into(),
        }
    }
}

impl Tissue for EnergyBalance {
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics {
        if let Some(objection) = self.objection(drive, step_s) {
            return self.report(Outcome::Failed(objection), 0, f64::NAN);
        }
        self.remember();
        let (visits, finite) = self.advance(drive, step_s, None);
        if !finite {
            self.go_back();
            return self.report(Outcome::Failed("numbers are not finite"), visits, f64::NAN);
        }
        for (node, position) in self.positions_m.iter_mut().enumerate() {
            let moved = self.solver.displacement(node);
            *position = [0, 1, 2].map(|c| self.rest_m[node][c] + moved[c]);
        }
        let residual = self.weigh();
        let outcome = if residual <= self.settings.tolerance {
            Outcome::Converged
        } else {
            Outcome::Unfinished
        };
        self.report(outcome, visits, residual)
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
        step_s: f64,
    ) -> Option<Tangent> {
        tangent::secant(self, drive, moved, step_s)
    }
}
