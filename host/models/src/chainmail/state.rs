//! What an ellipsoid-bounded ChainMail's step changes: what is held, loaded, awake, and what that takes.
//!
//! Entry point: [`State`].

use super::awake::Awake;
use super::links::{Links, square};
use super::motion::Motion;
use super::queue::Queue;
use super::settings::EllipsoidSettings;
use crate::Drive;

/// Steps between looks at what may sleep.
pub(super) const SLEEP_EVERY: u32 = 64;

/// Everything that a step changes.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub motion: Motion,
    pub awake: Awake,
    pub queue: Queue,
    /// Held elements of the last step.
    pub held: Vec<u32>,
    pub reactions_n: Vec<[f64; 3]>,
    /// Mass times adjustment that links gave to held elements in a step \[kg m\], (n x 3).
    pub impulse: Vec<[f64; 3]>,
    /// Loads of the last step, to see which change.
    pub loads: Vec<[f64; 3]>,
    pub any_load: bool,
    pub stamp: Vec<u32>,
    pub now: u32,
    pub step_s: f64,
    pub moved: usize,
    pub adjusted: usize,
    pub work_j: f64,
}

impl State {
    /// At rest; springs feel strain up to `limit` in both directions.
    pub fn new(links: &Links, limit: f64) -> Self {
        let nodes = links.nodes();
        Self {
            motion: Motion::new(links, limit),
            awake: Awake::new(nodes),
            queue: Queue::new(nodes),
            held: Vec::new(),
            reactions_n: Vec::new(),
            impulse: vec![[0.0; 3]; nodes],
            loads: vec![[0.0; 3]; nodes],
            any_load: false,
            stamp: vec![0; nodes],
            now: 0,
            step_s: 0.0,
            moved: 0,
            adjusted: 0,
            work_j: 0.0,
        }
    }

    /// Wakes an element. What slept was in balance: its links' force, not kept up, counts as none.
    pub fn wake(&mut self, node: u32, links: &Links) {
        if self.awake.wake(node, links) {
            self.motion.f[node as usize] = [0.0; 3];
        }
    }

    /// Wakes every element.
    pub fn wake_all(&mut self, links: &Links) {
        for node in 0..links.nodes() as u32 {
            self.wake(node, links);
        }
        self.motion.link_forces(&self.awake, links);
    }

    /// Holds what the drive holds, lets go of the rest, and queues what is moved.
    pub fn hold(&mut self, drive: &Drive<'_>, links: &Links) {
        for index in 0..self.held.len() {
            let node = self.held[index];
            self.motion.inverse_mass[node as usize] = 1.0 / self.motion.mass[node as usize];
            let still = drive
                .held
                .binary_search_by_key(&node, |held| held.0)
                .is_ok();
            if !still {
                self.awake.wake_beside(node, links, |woken| {
                    self.motion.f[woken as usize] = [0.0; 3];
                });
            }
        }
        self.held.clear();
        for &(node, displacement) in drive.held {
            let i = node as usize;
            self.held.push(node);
            self.wake(node, links);
            self.motion.inverse_mass[i] = 0.0;
            self.impulse[i] = [0.0; 3];
            let rest = links.rest_m[i];
            let target = [0, 1, 2].map(|axis| rest[axis] + displacement[axis]);
            if self.motion.x[i] != target {
                self.motion.x[i] = target;
                self.queue.push(node);
                self.awake.wake_beside(node, links, |woken| {
                    self.motion.f[woken as usize] = [0.0; 3];
                });
            }
        }
    }

    /// Wakes what a load that has changed acts on.
    pub fn load(&mut self, drive: &Drive<'_>, links: &Links) {
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

    /// Reactions of held elements, and their work over the step.
    pub fn react(&mut self, drive: &Drive<'_>, step_s: f64) {
        let rate_sq = 1.0 / (step_s * step_s);
        self.reactions_n.clear();
        for &(node, _) in drive.held {
            let i = node as usize;
            let load = drive.force_n.get(i).copied().unwrap_or_default();
            let (force, impulse) = (self.motion.f[i], self.impulse[i]);
            let of = |axis: usize| -force[axis] - load[axis] - rate_sq * impulse[axis];
            let reaction: [f64; 3] = [of(0), of(1), of(2)];
            for axis in 0..3 {
                let step_m = self.motion.x[i][axis] - self.motion.previous[i][axis];
                self.work_j += reaction[axis] * step_m;
            }
            self.reactions_n.push(reaction);
        }
    }

    /// Wakes what moving elements touch.
    pub fn spread(&mut self, links: &Links, settings: &EllipsoidSettings) {
        if self.awake.all() {
            return;
        }
        let threshold_sq = settings.sleep_m_per_s * settings.sleep_m_per_s;
        for i in self.awake.iter() {
            if square(self.motion.v[i]) > threshold_sq {
                self.queue.push(i as u32);
            }
        }
        while let Some(node) = self.queue.pop() {
            self.awake.wake_beside(node, links, |_| {});
        }
    }

    /// Lets sleep what has come to rest.
    pub fn fall_asleep(&mut self, links: &Links, settings: &EllipsoidSettings) {
        let motion = &self.motion;
        let threshold_sq = settings.sleep_m_per_s * settings.sleep_m_per_s;
        let step_s = self.step_s;
        self.awake.put_to_sleep(links, |i| {
            let w = motion.inverse_mass[i];
            let kick = motion.f[i].map(|f| w * step_s * f);
            w > 0.0 && square(motion.v[i]) < threshold_sq && square(kick) < threshold_sq
        });
    }
}
