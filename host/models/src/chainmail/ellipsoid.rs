//! The ellipsoid-bounded ChainMail with motion in time.
//!
//! Entry point: [`EllipsoidChainMail`]. After zhang-2017, 3.3.2 to 3.3.4; it deviates in the links, which are springs
//! within their limits, so that forces have a material and loads a balance; `stiffness` 0 is as printed.

use super::adjust::{Adjusted, Enforced, enforce};
use super::forces::{Springs, between};
use super::links::{Links, square};
use super::motion::Sums;
use super::quad::Quad;
use super::region::{Ball, Ellipsoid, Region};
use super::settings::{EllipsoidSettings, JAMMED, check_limit};
use super::state::{SLEEP_EVERY, State};
use crate::drive_check::{failed, refused};
use crate::held::ratio;
use crate::secant::{Trials, secant_of_step, secant_to_come};
use crate::{BoundaryConditions, BuildError, Diagnostics, Materials, Outcome, Tangent, Tissue};
use nalgebra::Vector3;
use sutura_mesh::TetMesh;

/// Tissue as an ellipsoid-bounded ChainMail.
#[derive(Clone, Debug)]
pub struct EllipsoidChainMail {
    links: Links,
    settings: EllipsoidSettings,
    /// Strain limits by link where they differ, (m x 3).
    limits: Option<Vec<[f64; 3]>>,
    state: State,
    trials: Trials<State>,
}

impl EllipsoidChainMail {
    /// Tissue at rest on the nodes and edges of a mesh. Of a material, Young's modulus sets the links' stiffness;
    /// Poisson's ratio has no say: a network of springs has about 1/4, and more under its limits.
    ///
    /// # Errors
    /// A material or a setting out of range.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        settings: EllipsoidSettings,
    ) -> Result<Self, BuildError> {
        settings.check()?;
        let links = Links::new(
            mesh,
            &materials.into(),
            settings.density_kg_per_m3,
            settings.stiffness,
        )?;
        let limit = settings.strain_limit;
        let ball = limit == [limit[0]; 3];
        let rest = || State::new(&links, springs(&[limit], settings.tolerance));
        Ok(Self {
            state: rest(),
            trials: Trials::new(rest(), links.nodes()),
            limits: (!ball).then(|| vec![limit; links.owned.places()]),
            links,
            settings,
        })
    }

    /// Gives each link strain limits along x, y, z of its own: `of` is asked with its two nodes, the lower one
    /// first. For regions and layers; the body goes back to rest.
    ///
    /// # Errors
    /// A limit out of range.
    pub fn set_limits(
        &mut self,
        mut of: impl FnMut(u32, u32) -> [f64; 3],
    ) -> Result<(), BuildError> {
        // Places without a link have the ellipsoid of the settings, which nothing asks for.
        let mut limits = vec![self.settings.strain_limit; self.links.owned.places()];
        let mut asked = Vec::with_capacity(limits.len());
        for node in 0..self.links.nodes() as u32 {
            for link in self.links.owned.of(node as usize) {
                let limit = of(node.min(link.to), node.max(link.to));
                check_limit(limit)?;
                limits[link.place] = limit;
                asked.push(limit);
            }
        }
        self.state = State::new(&self.links, springs(&asked, self.settings.tolerance));
        self.limits = Some(limits);
        Ok(())
    }

    /// Nodes that changed place in the last step.
    pub fn moved(&self) -> usize {
        self.state.moved
    }

    /// Free nodes that a link at its limit moved in the last step.
    pub fn adjusted(&self) -> usize {
        self.state.adjusted
    }

    /// Nodes that take part in the next step; the others rest.
    pub fn awake(&self) -> usize {
        self.state.awake.count()
    }

    /// Mass of all nodes in steps as long as the last over their true mass: above 1 where the step is too
    /// long for the links. Balance does not depend on mass; how fast it is reached does.
    pub fn mass_factor(&self) -> f64 {
        let sum = |masses: &[f64]| masses.iter().sum::<f64>();
        sum(&self.state.motion.mass) / sum(&self.links.mass_kg)
    }

    /// Gives every node a velocity \[m/s\], (n x 3); does nothing if they are not as many or not finite.
    pub fn set_velocities(&mut self, velocities_m_per_s: &[[f64; 3]]) {
        let finite = velocities_m_per_s.iter().flatten().all(|v| v.is_finite());
        if finite && velocities_m_per_s.len() == self.links.nodes() {
            for (v, given) in self.state.motion.v.iter_mut().zip(velocities_m_per_s) {
                *v = Quad::of(*given);
            }
            self.state.wake_all(&self.links);
        }
    }

    /// Greatest excess of a link over its limits as a share of its rest length; links between two held nodes
    /// do not count.
    pub fn greatest_excess(&self) -> f64 {
        let mut most = 0.0f64;
        let motion = &self.state.motion;
        for i in 0..self.links.nodes() {
            for link in self.links.owned.of(i) {
                let j = link.to as usize;
                if motion.inverse_mass[i] + motion.inverse_mass[j] == 0.0 {
                    continue;
                }
                let d = between(&motion.at[i], &motion.at[j]);
                let (least, greatest) = self.lengths(link.place, link.rest_sq, d);
                let length = square(d).sqrt();
                let excess = (length - greatest).max(least - length);
                most = most.max(excess / link.rest_sq.sqrt());
            }
        }
        most
    }

    fn lengths(&self, place: usize, rest_sq: f64, d: [f64; 3]) -> (f64, f64) {
        match &self.limits {
            Some(limits) => Ellipsoid { limits }.lengths(place, rest_sq, d),
            None => Ball {
                limit: self.settings.strain_limit[0],
            }
            .lengths(place, rest_sq, d),
        }
    }

    /// Brings links within their limits.
    fn enforce(&mut self) -> Enforced {
        let state = &mut self.state;
        let most = u64::from(self.settings.visits) * state.awake.count().max(64) as u64;
        let mut adjusted = Adjusted {
            rest_m: &self.links.rest_m,
            at: &mut state.motion.at,
            inverse_mass: &state.motion.inverse_mass,
            impulse: &mut state.impulse,
            stamp: &mut state.stamp,
            now: state.now,
            adjusted: 0,
            stale: &mut state.stale,
        };
        let tolerance = self.settings.tolerance;
        let (links, beyond) = (&self.links, &state.motion.beyond[..]);
        let (awake, queue) = (&mut state.awake, &mut state.queue);
        let enforced = match &self.limits {
            Some(limits) => {
                let region = Ellipsoid { limits };
                enforce(
                    links,
                    &region,
                    tolerance,
                    beyond,
                    awake,
                    queue,
                    &mut adjusted,
                    most,
                )
            }
            None => {
                let limit = self.settings.strain_limit[0];
                let region = Ball { limit };
                enforce(
                    links,
                    &region,
                    tolerance,
                    beyond,
                    awake,
                    queue,
                    &mut adjusted,
                    most,
                )
            }
        };
        state.adjusted = adjusted.adjusted;
        enforced
    }
}

impl Tissue for EllipsoidChainMail {
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics {
        if let Some(reason) = refused(drive, self.links.nodes(), step_s) {
            return failed(reason, self.state.motion.energy_j);
        }
        let (links, settings) = (&self.links, &self.settings);
        let state = &mut self.state;
        state.now = state.now.wrapping_add(1);
        if state.step_s != step_s {
            state.step_s = step_s;
            state.motion.set_step(links, step_s, settings.relaxation_s);
            for (w, m) in state.motion.inverse_mass.iter_mut().zip(&state.motion.mass) {
                *w = 1.0 / m;
            }
        }
        state.hold(drive, links);
        state.load(drive, links);
        let free = drive.held.is_empty();
        let mut angular = [0.0; 3];
        if free {
            // Of a body that is free nothing sleeps, or its momentum would not last.
            if state.awake.count() > 0 && !state.awake.all() {
                state.wake_all(links);
            }
            angular = state.motion.momenta().1;
            for (at, load) in state.motion.at.iter().zip(drive.force_n) {
                let torque = Vector3::from(at.x.xyz()).cross(&Vector3::from(*load));
                for axis in 0..3 {
                    angular[axis] += step_s * torque[axis];
                }
            }
        }
        let decay = if free { 1.0 } else { state.motion.decay };
        state.motion.predict(&state.awake, drive, step_s, decay);
        state.motion.link_forces(&state.awake, links);
        let enforced = self.enforce();
        let (links, settings) = (&self.links, &self.settings);
        let state = &mut self.state;
        state.renew(links);
        let mut sums = state.motion.velocities(&state.awake, step_s, decay);
        if !good(&sums, state.motion.energy_j) {
            state.motion.restore(&state.awake);
            state.motion.link_forces(&state.awake, links);
            state.motion.sum_energy();
            return state.held.give_up(drive, state.motion.energy_j);
        }
        if free && state.awake.all() {
            state.motion.free(angular, &mut sums);
        }
        state.moved = sums.moved;
        let acting_sq = state.react(drive, step_s);
        state.motion.settle(&state.awake);
        if !free {
            state.spread(links, settings);
            if state.now.is_multiple_of(SLEEP_EVERY) {
                state.fall_asleep(links, settings);
            }
        }
        let kept = state.motion.energy_j + sums.kinetic_j;
        let residual = ratio(sums.unbalanced_sq.sqrt(), acting_sq.sqrt());
        let excess = if enforced.within {
            0.0
        } else {
            self.greatest_excess()
        };
        let before = std::mem::replace(&mut self.state.excess, excess);
        // What links lack, and what they lacked before and have been brought back by: a mass over a step squared.
        let lacking = excess.max(before) / (JAMMED * self.settings.tolerance);
        let state = &self.state;
        Diagnostics {
            outcome: if enforced.within {
                Outcome::Converged
            } else {
                Outcome::Unfinished
            },
            iterations: enforced.visits.div_ceil(state.awake.count().max(1) as u64) as u32,
            residual,
            // What is out of balance besides is inertia, and the equations of motion hold.
            force_error: if lacking > 1.0 {
                f64::INFINITY
            } else {
                lacking
            },
            energy_j: state.motion.energy_j,
            energy_difference: ratio(state.work_j - kept, state.work_j.abs()),
            momentum: sums.momentum,
            angular_momentum: sums.angular_momentum,
        }
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.state.motion.previous
    }

    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.state.held.reactions_n
    }

    /// A secant of one step over a hundredth of the mean edge and half of that: the answer within `step_s`,
    /// before the tissue beyond has followed; stiffer than the balance it relaxes to.
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

/// Springs of links with such limits.
fn springs(limits: &[[f64; 3]], tolerance: f64) -> Springs {
    let each = limits.iter().flatten().copied();
    let (least, greatest) = each.fold((f64::INFINITY, 0.0f64), |(least, greatest), limit| {
        (least.min(limit), greatest.max(limit))
    });
    Springs::new(least, greatest, tolerance)
}

/// Whether a step led to finite positions.
fn good(sums: &Sums, energy_j: f64) -> bool {
    (sums.kinetic_j + square(sums.momentum) + square(sums.angular_momentum) + energy_j).is_finite()
}
