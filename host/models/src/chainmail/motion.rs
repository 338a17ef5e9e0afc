//! Motion of chain elements in time: prediction, velocities, link forces, held elements' reactions.
//!
//! Entry point: [`Motion`]. After zhang-2017, (3.47) and (3.48), with the acceleration from the *change* of velocity
//! and with links as springs within their limits; masses grow where the step is too long for their springs.

use super::awake::Awake;
use super::links::{Links, difference, square};
use crate::Drive;
use crate::rigid::{Rigid, momenta};
use nalgebra::Vector3;

/// Where elements are and how they move.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    /// Positions \[m\], (n x 3).
    pub x: Vec<[f64; 3]>,
    /// Positions at the end of the last step \[m\], (n x 3); of what sleeps, the same as `x`.
    pub previous: Vec<[f64; 3]>,
    /// Velocities \[m/s\], (n x 3).
    pub v: Vec<[f64; 3]>,
    /// Force of the links at `x` \[N\], (n x 3); of what sleeps, meaningless.
    pub f: Vec<[f64; 3]>,
    /// Masses of this step \[kg\], (n).
    pub mass: Vec<f64>,
    /// Inverses of them, 0 where held \[1/kg\], (n).
    pub inverse_mass: Vec<f64>,
    /// Share of the velocity that drag leaves over a step.
    pub decay: f64,
    /// Elastic energy of all links \[J\].
    pub energy_j: f64,
    /// Energy of the links to higher elements \[J\], (n).
    energy_of: Vec<f64>,
    /// Least and greatest of (l / l0)^2 - 1 that a spring feels.
    strain: (f64, f64),
}

/// Sums over what is awake after a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Elements that changed place.
    pub moved: usize,
    /// Kinetic energy of free elements \[J\].
    pub kinetic_j: f64,
    /// Linear momentum \[kg m/s\].
    pub momentum: [f64; 3],
    /// Angular momentum about the origin \[kg m^2/s\].
    pub angular_momentum: [f64; 3],
    /// Squared norm of m a at free elements \[N^2\].
    pub unbalanced_sq: f64,
    /// Work of the loads \[J\].
    pub work_j: f64,
    /// Squared norm of the loads \[N^2\].
    pub load_sq: f64,
}

impl Motion {
    /// At rest; springs feel strain up to `limit` in both directions.
    pub fn new(links: &Links, limit: f64) -> Self {
        let nodes = links.nodes();
        Self {
            x: links.rest_m.clone(),
            previous: links.rest_m.clone(),
            v: vec![[0.0; 3]; nodes],
            f: vec![[0.0; 3]; nodes],
            mass: links.mass_kg.clone(),
            inverse_mass: links.mass_kg.iter().map(|m| 1.0 / m).collect(),
            decay: 1.0,
            energy_j: 0.0,
            energy_of: vec![0.0; nodes],
            strain: (
                (1.0 - limit) * (1.0 - limit) - 1.0,
                (1.0 + limit) * (1.0 + limit) - 1.0,
            ),
        }
    }

    /// Masses and drag for steps of `step_s`: drag lets the slowest motion of the body decay with the time
    /// constant `relaxation_s`. No element may be so light that a step overshoots: the stiffest motion has
    /// at most `omega^2 = 2 s sum(k) / m` with `s` the steepest spring's slope over k.
    pub fn set_step(&mut self, links: &Links, step_s: f64, relaxation_s: f64) {
        let slope = 1.0 + 1.5 * self.strain.1;
        let mut total = 0.0;
        for (node, mass) in self.mass.iter_mut().enumerate() {
            *mass = links.mass_kg[node].max(step_s * step_s * slope * links.stiffness[node]);
            total += *mass;
        }
        let wave = std::f64::consts::FRAC_PI_2 / links.extent_m;
        let slowest_sq = wave * wave * links.modulus_volume / total;
        self.decay = (-slowest_sq * relaxation_s * step_s).exp();
    }

    /// Starts a step: free elements go where velocity, links and loads take them.
    pub fn predict(&mut self, awake: &Awake, drive: &Drive<'_>, step_s: f64, decay: f64) {
        for i in awake.iter() {
            let w = self.inverse_mass[i];
            if w == 0.0 {
                continue;
            }
            let load = drive.force_n.get(i).copied().unwrap_or_default();
            for axis in 0..3 {
                let v = decay * self.v[i][axis] + step_s * w * (self.f[i][axis] + load[axis]);
                self.x[i][axis] += step_s * v;
            }
        }
    }

    /// Velocities from what has moved, (3.47), and the sums over it. Positions that are not finite show in
    /// [`Sums::kinetic_j`].
    pub fn velocities(
        &mut self,
        awake: &Awake,
        drive: &Drive<'_>,
        step_s: f64,
        decay: f64,
    ) -> Sums {
        let mut sums = Sums::default();
        let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
        let rate = 1.0 / step_s;
        for i in awake.iter() {
            let (from, to, old) = (self.previous[i], self.x[i], self.v[i]);
            let load = drive.force_n.get(i).copied().unwrap_or_default();
            let free = self.inverse_mass[i] > 0.0;
            let v = difference(&from, &to).map(|d| d * rate);
            let mass = self.mass[i];
            if free {
                // Drag counts as inertia here: both vanish at rest.
                let change = [0, 1, 2].map(|axis| mass * rate * (v[axis] - decay * old[axis]));
                sums.unbalanced_sq += square(change);
                sums.kinetic_j += 0.5 * mass * square(v);
                sums.load_sq += square(load);
            }
            for axis in 0..3 {
                sums.work_j += load[axis] * (to[axis] - from[axis]);
            }
            let push = mass * Vector3::from(v);
            linear += push;
            angular += Vector3::from(to).cross(&push);
            sums.moved += usize::from(from != to);
            self.v[i] = v;
        }
        (sums.momentum, sums.angular_momentum) = (linear.into(), angular.into());
        sums
    }

    /// Where nothing is held: drag acts on what is not rigid motion, and the angular momentum is set to
    /// `angular`. Adjustments conserve it about the places where they happen, (3.29), but (3.47) gives the
    /// velocity to the places before them; a rigid turn makes up for the difference.
    pub fn free(&mut self, angular: [f64; 3], sums: &mut Sums) {
        let points = self.mass.iter().copied().zip(self.x.iter().copied());
        let target = Vector3::from(angular);
        let missing = target - Vector3::from(sums.angular_momentum);
        let Some(rigid) = Rigid::of(points, sums.momentum, angular) else {
            return;
        };
        let turning = rigid.turning(missing);
        sums.kinetic_j = 0.0;
        for (i, v) in self.v.iter_mut().enumerate() {
            let carried = rigid.at(self.x[i]);
            let own = Vector3::from(*v) + turning.at(self.x[i]) - carried;
            *v = (carried + self.decay * own).into();
            sums.kinetic_j += 0.5 * self.mass[i] * square(*v);
        }
        (sums.momentum, sums.angular_momentum) = self.momenta();
    }

    /// Momenta of all elements.
    pub fn momenta(&self) -> ([f64; 3], [f64; 3]) {
        let all = self.mass.iter().zip(&self.x).zip(&self.v);
        momenta(all.map(|((m, x), v)| (*m, *x, *v)))
    }

    /// Ends a step: `previous` becomes where elements are.
    pub fn settle(&mut self, awake: &Awake) {
        for i in awake.iter() {
            self.previous[i] = self.x[i];
        }
    }

    /// Undoes a step that led nowhere: back to `previous`, at rest.
    pub fn restore(&mut self, awake: &Awake) {
        for i in awake.iter() {
            self.x[i] = self.previous[i];
            self.v[i] = [0.0; 3];
        }
    }

    /// Energy of all links, summed anew.
    pub fn sum_energy(&mut self) {
        self.energy_j = self.energy_of.iter().sum();
    }

    /// Forces and energy of every link of what is awake. A spring's energy is k l0^2 e^2 / 2 with Green's
    /// strain e = (l^2 / l0^2 - 1) / 2, which needs no root; beyond the limits its e stays, so that a link
    /// on its way back does not explode.
    pub fn link_forces(&mut self, awake: &Awake, links: &Links) {
        for i in awake.near() {
            self.f[i] = [0.0; 3];
        }
        let (low, high) = self.strain;
        let mut gained = 0.0;
        for i in awake.near() {
            let xi = self.x[i];
            let (mut own, mut energy) = ([0.0; 3], 0.0);
            for link in links.upper(i).1 {
                let d = difference(&xi, &self.x[link.to as usize]);
                let change = square(d) - link.rest_sq;
                let felt = change.min(high * link.rest_sq).max(low * link.rest_sq);
                let spring = f64::from(link.spring);
                let pull = spring * felt;
                let other = &mut self.f[link.to as usize];
                for axis in 0..3 {
                    let force = pull * d[axis];
                    own[axis] += force;
                    other[axis] -= force;
                }
                energy += pull * (2.0 * change - felt);
            }
            for axis in 0..3 {
                self.f[i][axis] += own[axis];
            }
            gained += 0.25 * energy - self.energy_of[i];
            self.energy_of[i] = 0.25 * energy;
        }
        self.energy_j += gained;
    }
}
