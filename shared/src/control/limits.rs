//! Limits on force, power, speed and slew at the grip.
//!
//! Entry points: [`Limits::bound`] for a force that is wanted, [`Limits::slewed`] for one that is about to be
//! commanded, [`Limits::too_fast`] for the fault. The limits of single joints are the drive's.

use super::TICK_S;
use super::tuning::Guards;
use crate::device::{DeviceDescription, JOINTS};
use crate::kinematics::Pose;
use crate::math::{Vec3, clamp, dot, min, shortened};

/// Part of the largest speed from which on the contact force fades.
const FADE_FROM: f32 = 0.7;
/// Ticks in a row beyond the largest speed that are a fault: longer than one wrong count of an encoder shows.
const TOO_FAST_TICKS: u8 = 5;

/// The limits of one console, and what they remember.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    guards: Guards,
    max_force_n: f32,
    max_power_w: f32,
    max_speed: f32,
    /// Largest change of effort in a tick.
    max_step: [f32; JOINTS],
    /// Commanded at the last tick \[N\].
    before: Vec3,
    /// Ticks in a row that were too fast.
    fast_ticks: u8,
    /// Smallest part of the largest speed within the last two ticks: a single wrong count fades nothing.
    speed: [f32; 2],
}

impl Limits {
    pub fn new(device: &DeviceDescription, guards: Guards) -> Self {
        Limits {
            guards,
            max_force_n: device.max_force_n,
            max_power_w: device.max_power_w,
            max_speed: device.max_grip_speed_m_per_s,
            max_step: device.joints.map(|joint| joint.max_slew_per_s * TICK_S),
            before: Vec3::zeros(),
            fast_ticks: 0,
            speed: [0.0; 2],
        }
    }

    /// Whether the grip has been too fast for too long. To be asked once a tick; `armed`: it is under power.
    pub fn too_fast(&mut self, velocity: &Vec3, armed: bool) -> bool {
        let [newest, _] = self.speed;
        let speed = libm::sqrtf(dot(velocity, velocity)) / self.max_speed;
        self.speed = [speed, newest];
        self.fast_ticks = if armed && self.guards.overspeed && speed > 1.0 {
            self.fast_ticks.saturating_add(1)
        } else {
            0
        };
        self.fast_ticks >= TOO_FAST_TICKS
    }

    /// A force \[N\] within force and power, faded where the grip is too fast.
    pub fn bound(&self, force: &Vec3, velocity: &Vec3) -> Vec3 {
        let mut bounded = self.shortened(force);
        if self.guards.power {
            let power = dot(&bounded, velocity).abs();
            if power > self.max_power_w {
                bounded *= self.max_power_w / power;
            }
        }
        if self.guards.overspeed {
            let [newest, before] = self.speed;
            let over = min(newest, before) - FADE_FROM;
            bounded *= 1.0 - clamp(over * (1.0 / (1.0 - FADE_FROM)), 0.0, 1.0);
        }
        bounded
    }

    fn shortened(&self, force: &Vec3) -> Vec3 {
        if self.guards.force {
            shortened(*force, self.max_force_n)
        } else {
            *force
        }
    }

    /// The force of the last tick, changed towards `force` as fast as all joints can: it keeps the direction of
    /// the change.
    pub fn slewed(&self, force: &Vec3, pose: &Pose) -> Vec3 {
        // Damping has been added since it was bounded.
        let force = &self.shortened(force);
        if !self.guards.slew {
            return *force;
        }
        let change = force - self.before;
        let joints = pose.effort(&change);
        let share = joints
            .iter()
            .zip(&self.max_step)
            .fold(1.0, |share, (effort, step)| {
                let size = effort.abs();
                if size * share > *step {
                    step / size
                } else {
                    share
                }
            });
        // All of it without rounding.
        if share < 1.0 {
            self.before + change * share
        } else {
            *force
        }
    }

    /// Takes note of the force that was commanded \[N\].
    pub fn commit(&mut self, force: &Vec3) {
        self.before = *force;
    }
}
