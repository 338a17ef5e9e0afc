//! Motion of chain elements in time: prediction, velocities, link forces, held elements' reactions.
//!
//! Entry point: [`Motion`]. After zhang-2017, (3.47) and (3.48), with the acceleration from the *change* of velocity
//! and with links as springs within their limits; masses grow where the step is too long for their springs.

use super::awake::Awake;
use super::forces::{Element, Pass, Springs};
use super::links::Links;
use super::quad::Quad;
use crate::BoundaryConditions;
use crate::held::load;
use crate::in_place::clone_in_place;
use crate::rigid::{Rigid, momenta};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

/// Where elements are and how they move.
#[derive(Debug)]
pub(super) struct Motion {
    /// Positions and the links' forces, (n).
    pub at: Vec<Element>,
    /// Positions at the end of the last step \[m\], (n x 3); of what sleeps, the same as in `at`.
    pub previous: Vec<[f64; 3]>,
    /// Velocities \[m/s\], (n).
    pub v: Vec<Quad>,
    /// Masses of this step \[kg\], (n).
    pub mass: Vec<f64>,
    /// Inverses of them, 0 where held \[1/kg\], (n).
    pub inverse_mass: Vec<f64>,
    /// Share of the velocity that drag leaves over a step.
    pub decay: f64,
    /// Elastic energy of all links \[J\].
    pub energy_j: f64,
    /// Elements with a link that was beyond its limits when forces were last computed.
    pub beyond: Vec<u32>,
    /// Energy of the links that an element owns \[J\], (n).
    energy_of: Vec<f64>,
    springs: Springs,
    arch: Arch,
}

clone_in_place!(Motion {
    at,
    previous,
    v,
    mass,
    inverse_mass,
    decay,
    energy_j,
    beyond,
    energy_of,
    springs,
    arch,
});

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
}

impl Motion {
    /// At rest.
    pub fn new(links: &Links, springs: Springs) -> Self {
        let nodes = links.nodes();
        let at_rest = |x: &[f64; 3]| Element {
            x: Quad::of(*x),
            f: Quad::ZERO,
        };
        Self {
            at: links.rest_m.iter().map(at_rest).collect(),
            previous: links.rest_m.clone(),
            v: vec![Quad::ZERO; nodes],
            mass: links.mass_kg.clone(),
            inverse_mass: links.mass_kg.iter().map(|m| 1.0 / m).collect(),
            decay: 1.0,
            energy_j: 0.0,
            beyond: Vec::with_capacity(nodes),
            energy_of: vec![0.0; nodes],
            springs,
            arch: Arch::new(),
        }
    }

    /// Masses and drag for steps of `step_s`: drag lets the slowest motion of the body decay with the time
    /// constant `relaxation_s`. No element may be so light that a step overshoots: the stiffest motion has
    /// at most `omega^2 = 2 s sum(k) / m` with `s` the steepest spring's slope over k.
    pub fn set_step(&mut self, links: &Links, step_s: f64, relaxation_s: f64) {
        let slope = self.springs.slope();
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
    pub fn predict(
        &mut self,
        awake: &Awake,
        drive: &BoundaryConditions<'_>,
        step_s: f64,
        decay: f64,
    ) {
        for i in awake.iter() {
            let w = self.inverse_mass[i];
            if w == 0.0 {
                continue;
            }
            let Element { x, f } = self.at[i];
            let load = Quad::of(load(drive, i));
            let v = decay * self.v[i] + (step_s * w) * (f + load);
            self.at[i].x = x + step_s * v;
        }
    }

    /// Velocities from what has moved, (3.47), and the sums over it. Positions that are not finite show in
    /// [`Sums::kinetic_j`].
    pub fn velocities(&mut self, awake: &Awake, step_s: f64, decay: f64) -> Sums {
        self.arch.dispatch(Velocities {
            motion: self,
            awake,
            step_s,
            decay,
        })
    }

    /// Where nothing is held: drag acts on what is not rigid motion, and the angular momentum is set to
    /// `angular`. Adjustments conserve it about the places where they happen, (3.29), but (3.47) gives the
    /// velocity to the places before them; a rigid turn makes up for the difference.
    pub fn free(&mut self, angular: [f64; 3], sums: &mut Sums) {
        let places = self.at.iter().map(|at| at.x.xyz());
        let points = self.mass.iter().copied().zip(places);
        let target = Vector3::from(angular);
        let missing = target - Vector3::from(sums.angular_momentum);
        let Some(rigid) = Rigid::of(points, sums.momentum, angular) else {
            return;
        };
        let turning = rigid.turning(missing);
        sums.kinetic_j = 0.0;
        for (i, v) in self.v.iter_mut().enumerate() {
            let x = self.at[i].x.xyz();
            let carried = rigid.at(x);
            let own = Vector3::from(v.xyz()) + turning.at(x) - carried;
            *v = Quad::of((carried + self.decay * own).into());
            sums.kinetic_j += 0.5 * self.mass[i] * v.square();
        }
        (sums.momentum, sums.angular_momentum) = self.momenta();
    }

    /// Momenta of all elements.
    pub fn momenta(&self) -> ([f64; 3], [f64; 3]) {
        let all = self.mass.iter().zip(&self.at).zip(&self.v);
        momenta(all.map(|((m, at), v)| (*m, at.x.xyz(), v.xyz())))
    }

    /// Ends a step: `previous` becomes where elements are.
    pub fn settle(&mut self, awake: &Awake) {
        for i in awake.iter() {
            self.previous[i] = self.at[i].x.xyz();
        }
    }

    /// Undoes a step that led nowhere: back to `previous`, at rest.
    pub fn restore(&mut self, awake: &Awake) {
        for i in awake.iter() {
            self.at[i].x = Quad::of(self.previous[i]);
            self.v[i] = Quad::ZERO;
        }
    }

    /// Energy of all links, summed anew.
    pub fn sum_energy(&mut self) {
        self.energy_j = self.energy_of.iter().sum();
    }

    /// Forces and energy of every link of what is awake; finds what is `beyond` limits.
    pub fn link_forces(&mut self, awake: &Awake, links: &Links) {
        self.energy_j += self.arch.dispatch(Pass {
            springs: self.springs,
            links,
            awake,
            at: &mut self.at,
            energy_of: &mut self.energy_of,
            beyond: &mut self.beyond,
        });
    }

    /// Force and energy of one element's links, after a few have moved.
    pub fn renew(&mut self, node: usize, links: &Links) {
        let (at, energy_of) = (&mut self.at[..], &mut self.energy_of[..]);
        self.energy_j += self.springs.renew(links, node, at, energy_of);
    }
}

/// [`Motion::velocities`] in the registers that the processor has.
struct Velocities<'a> {
    motion: &'a mut Motion,
    awake: &'a Awake,
    step_s: f64,
    decay: f64,
}

impl WithSimd for Velocities<'_> {
    type Output = Sums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Sums {
        let Self {
            motion,
            awake,
            step_s,
            decay,
        } = self;
        let mut moved = 0;
        let [mut kinetic, mut unbalanced, mut linear, mut turned] = [Quad::ZERO; 4];
        let rate = 1.0 / step_s;
        for i in awake.iter() {
            let (to, mass) = (motion.at[i].x, motion.mass[i]);
            let gone = to - Quad::of(motion.previous[i]);
            let v = rate * gone;
            let push = mass * v;
            if motion.inverse_mass[i] > 0.0 {
                // Drag counts as inertia here: both vanish at rest.
                let change = rate * (push - (mass * decay) * motion.v[i]);
                unbalanced = unbalanced + change * change;
                kinetic = kinetic + push * v;
            }
            linear = linear + push;
            // The vector product, its components one place on.
            turned = turned + (to * push.turn() - to.turn() * push);
            moved += usize::from(gone.any());
            motion.v[i] = v;
        }
        Sums {
            moved,
            kinetic_j: 0.5 * kinetic.sum(),
            momentum: linear.xyz(),
            angular_momentum: turned.turn().xyz(),
            unbalanced_sq: unbalanced.sum(),
        }
    }
}
