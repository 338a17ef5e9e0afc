//! What an ellipsoid-bounded ChainMail's step changes: what is held, loaded, awake, and what that takes.
//!
//! Entry point: [`State`].

use super::awake::Awake;
use super::forces::Springs;
use super::links::{Links, difference, square};
use super::motion::Motion;
use super::quad::Quad;
use super::queue::Queue;
use super::settings::EllipsoidSettings;
use crate::BoundaryConditions;
use crate::held::{Held, load};
use crate::in_place::clone_in_place;

/// Steps between looks at what may sleep.
pub(super) const SLEEP_EVERY: u32 = 64;

/// Everything that a step changes.
#[derive(Debug)]
pub(super) struct State {
    pub motion: Motion,
    pub awake: Awake,
    pub queue: Queue,
    pub held: Held,
    /// Mass times adjustment that links gave to held elements in a step \[kg m\], (n x 3).
    pub impulse: Vec<[f64; 3]>,
    /// Loads of the last step, to see which change.
    pub loads: Vec<[f64; 3]>,
    pub any_load: bool,
    pub stamp: Vec<u32>,
    /// Elements whose forces are out of date.
    pub stale: Vec<u32>,
    pub now: u32,
    pub step_s: f64,
    pub moved: usize,
    pub adjusted: usize,
    /// Greatest excess of a link over its limits that the last step left, as a share of its rest length; 0 where it left none
    /// beyond the tolerance.
    pub excess: f64,
    pub work_j: f64,
}

clone_in_place!(State {
    motion,
    awake,
    queue,
    held,
    impulse,
    loads,
    any_load,
    stamp,
    stale,
    now,
    step_s,
    moved,
    adjusted,
    excess,
    work_j,
});

impl State {
    /// At rest.
    pub fn new(links: &Links, springs: Springs) -> Self {
        let nodes = links.nodes();
        Self {
            motion: Motion::new(links, springs),
            awake: Awake::new(nodes),
            queue: Queue::new(nodes),
            held: Held::new(nodes),
            impulse: vec![[0.0; 3]; nodes],
            loads: vec![[0.0; 3]; nodes],
            any_load: false,
            stamp: vec![0; nodes],
            // Each may be adjusted and, once, woken.
            stale: Vec::with_capacity(2 * nodes),
            now: 0,
            step_s: 0.0,
            moved: 0,
            adjusted: 0,
            excess: 0.0,
            work_j: 0.0,
        }
    }

    /// Wakes an element. What slept was in balance: its links' force, not kept up, counts as none.
    pub fn wake(&mut self, node: u32, links: &Links) {
        if self.awake.wake(node, links) {
            self.motion.at[node as usize].f = Quad::ZERO;
        }
    }

    /// Wakes the neighbours of an element.
    fn wake_beside(&mut self, node: u32, links: &Links) {
        let at = &mut self.motion.at;
        self.awake.wake_beside(node, links, |woken| {
            at[woken as usize].f = Quad::ZERO;
        });
    }

    /// Wakes every element.
    pub fn wake_all(&mut self, links: &Links) {
        for node in 0..links.nodes() as u32 {
            self.wake(node, links);
        }
        self.motion.link_forces(&self.awake, links);
    }

    /// Holds what the drive holds, lets go of the rest, and queues what is moved.
    pub fn hold(&mut self, drive: &BoundaryConditions<'_>, links: &Links) {
        let Motion {
            inverse_mass,
            mass,
            at,
            ..
        } = &mut self.motion;
        self.held.hold(drive, |i| {
            inverse_mass[i] = 1.0 / mass[i];
            self.awake.wake_beside(i as u32, links, |woken| {
                at[woken as usize].f = Quad::ZERO;
            });
        });
        for &(node, displacement) in drive.held {
            let i = node as usize;
            self.wake(node, links);
            self.motion.inverse_mass[i] = 0.0;
            self.impulse[i] = [0.0; 3];
            let target = Quad::of(links.rest_m[i]) + Quad::of(displacement);
            if self.motion.at[i].x != target {
                self.motion.at[i].x = target;
                self.queue.push(node);
                self.wake_beside(node, links);
            }
        }
    }

    /// Wakes what a load that has changed acts on.
    pub fn load(&mut self, drive: &BoundaryConditions<'_>, links: &Links) {
        if drive.force_n.is_empty() && !self.any_load {
            return;
        }
        for node in 0..links.nodes() {
            let load = drive.force_n.get(node).copied().unwrap_or_default();
            if load != self.loads[node] {
                self.loads[node] = load;
                self.wake(node as u32, links);
            }
        }
        self.any_load = !drive.force_n.is_empty();
    }

    /// Brings forces up to date with the elements that were moved or woken since they were computed.
    pub fn renew(&mut self, links: &Links) {
        // One element has some 14 neighbours and each of them 14 links: beyond a few, all at once is less.
        if 32 * self.stale.len() > self.awake.count() {
            self.motion.link_forces(&self.awake, links);
        } else {
            for &node in &self.stale {
                self.queue.push(node);
                for beside in links.beside(node as usize) {
                    self.queue.push(beside.to);
                }
            }
            while let Some(node) = self.queue.pop() {
                self.motion.renew(node as usize, links);
            }
        }
        self.stale.clear();
    }

    /// Reactions of held elements, and the work of reactions and loads over the step; returns the sum of the
    /// squares of reactions and of the loads on the rest \[N^2\].
    pub fn react(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> f64 {
        let rate_sq = 1.0 / (step_s * step_s);
        let (motion, impulse) = (&self.motion, &self.impulse);
        let gone = |i: usize| difference(&motion.previous[i], &motion.at[i].x.xyz());
        let reaction = |i: usize| {
            let load = Quad::of(load(drive, i));
            (-motion.at[i].f - load - rate_sq * Quad::of(impulse[i])).xyz()
        };
        let (mut acting_sq, work_j) = self.held.react(drive, reaction, gone);
        self.work_j += work_j;
        for (i, load) in drive.force_n.iter().enumerate() {
            let gone = gone(i);
            self.work_j += load[0] * gone[0] + load[1] * gone[1] + load[2] * gone[2];
            if motion.inverse_mass[i] > 0.0 {
                acting_sq += square(*load);
            }
        }
        acting_sq
    }

    /// Wakes what moving elements touch.
    pub fn spread(&mut self, links: &Links, settings: &EllipsoidSettings) {
        let threshold_sq = settings.sleep_m_per_s * settings.sleep_m_per_s;
        for i in self.awake.rim() {
            if self.motion.v[i].square() > threshold_sq {
                self.queue.push(i as u32);
            }
        }
        while let Some(node) = self.queue.pop() {
            self.wake_beside(node, links);
        }
    }

    /// Lets sleep what has come to rest.
    pub fn fall_asleep(&mut self, links: &Links, settings: &EllipsoidSettings) {
        let motion = &self.motion;
        let threshold_sq = settings.sleep_m_per_s * settings.sleep_m_per_s;
        let step_s = self.step_s;
        self.awake.put_to_sleep(links, |i| {
            let w = motion.inverse_mass[i];
            let kick = (w * step_s) * motion.at[i].f;
            w > 0.0 && motion.v[i].square() < threshold_sq && kick.square() < threshold_sq
        });
    }
}
