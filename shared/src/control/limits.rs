//! Limits on force, power, speed and slew at the grip.
//!
//! Entry points: [`Limits::bound`] for a force that is wanted, [`Limits::slewed`] for one that is about to be
//! commanded, [`Limits::too_fast`] for the fault, [`Limits::count`] for the ticks in which a limit took something away. The
//! limits of single joints are the drive's.

use super::TICK_S;
use super::tuning::Guards;
use crate::device::{DeviceDescription, JOINTS};
use crate::kinematics::Pose;
use crate::math::{Vec3, clamp, dot, min, shortened};

/// Part of the largest speed from which on the contact force fades.
const FADE_FROM: f32 = 0.7;
/// Ticks in a row beyond the largest speed that are a fault: longer than one wrong count of an encoder shows.
const TOO_FAST_TICKS: u8 = 5;
/// Part of the largest force from which on a force counts as cut: rendering has shortened it to that, but for rounding.
const CUT_FROM: f32 = 1.0 - 1e-4;

/// Ticks of a session in which a limit of the device took a part of the force away, by limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TicksLimited {
    /// By the largest force of the grip, or by the largest current of a motor.
    pub force: u32,
    /// Those of them that were cut by the largest current of a motor.
    pub current: u32,
    /// By the largest power.
    pub power: u32,
    /// By the fade towards the largest speed.
    pub speed: u32,
    /// By the largest slew of a joint.
    pub slew: u32,
}

/// Limits that took a part of one tick's force away, as bits.
mod cuts {
    pub const FORCE: u8 = 1;
    pub const POWER: u8 = 2;
    pub const SPEED: u8 = 4;
    pub const SLEW: u8 = 8;
    pub const CURRENT: u8 = 16;
}

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
    /// Square of the force from which on one counts as cut \[N^2\].
    cut_square: f32,
    /// Bits of [`cuts`] of the tick under way.
    cuts: u8,
    ticks: TicksLimited,
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
            cut_square: if guards.force {
                let from_n = device.max_force_n * CUT_FROM;
                from_n * from_n
            } else {
                f32::INFINITY
            },
            cuts: 0,
            ticks: TicksLimited::default(),
        }
    }

    /// Ticks of the session in which a part of the force was taken away.
    pub fn ticks(&self) -> TicksLimited {
        self.ticks
    }

    /// Counts from nothing: a session begins.
    pub fn count_anew(&mut self) {
        self.ticks = TicksLimited::default();
    }

    /// Counts a tick under power. `saturated`: a motor had no room for all of its force.
    pub fn count(&mut self, saturated: bool) {
        let by_current = cuts::FORCE | cuts::CURRENT;
        let cuts = self.cuts | if saturated { by_current } else { 0 };
        // Most ticks have none.
        if cuts == 0 {
            return;
        }
        let add = |ticks: &mut u32, cut: u8| {
            *ticks = ticks.wrapping_add(u32::from(cuts & cut != 0));
        };
        add(&mut self.ticks.force, cuts::FORCE);
        add(&mut self.ticks.current, cuts::CURRENT);
        add(&mut self.ticks.power, cuts::POWER);
        add(&mut self.ticks.speed, cuts::SPEED);
        add(&mut self.ticks.slew, cuts::SLEW);
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

    /// A force \[N\] as a part of the largest.
    pub fn part_of(&self, force: &Vec3) -> f32 {
        let square = dot(force, force);
        // Most ticks have none, and a root in software costs.
        if square > 0.0 {
            libm::sqrtf(square) / self.max_force_n
        } else {
            0.0
        }
    }

    /// A force \[N\] within force and power, faded where the grip is too fast.
    pub fn bound(&mut self, force: &Vec3, velocity: &Vec3) -> Vec3 {
        let mut bounded = self.shortened(force, 1.0);
        self.cuts = if dot(force, force) >= self.cut_square {
            cuts::FORCE
        } else {
            0
        };
        if self.guards.power {
            let power = dot(&bounded, velocity).abs();
            if power > self.max_power_w {
                bounded *= self.max_power_w / power;
                self.cuts |= cuts::POWER;
            }
        }
        if self.guards.overspeed {
            let [newest, before] = self.speed;
            let over = min(newest, before) - FADE_FROM;
            if over > 0.0 && dot(force, force) > 0.0 {
                self.cuts |= cuts::SPEED;
            }
            bounded *= 1.0 - clamp(over * (1.0 / (1.0 - FADE_FROM)), 0.0, 1.0);
        }
        bounded
    }

    fn shortened(&self, force: &Vec3, part: f32) -> Vec3 {
        if self.guards.force {
            shortened(*force, self.max_force_n * part)
        } else {
            *force
        }
    }

    /// The force of the last tick, changed towards `force` as fast as all joints can: it keeps the direction of
    /// the change. `left`: part of the largest force that may still be wanted, 0 to 1.
    ///
    /// Where the slew limit takes the largest force away within 8 ticks, a `left` that falls to 0 in 30 ticks, and a
    /// `force` of 0 then, leave nothing at that tick, whatever was wanted before.
    pub fn slewed(&mut self, force: &Vec3, pose: &Pose, left: f32) -> Vec3 {
        // Damping has been added since it was bounded, and goes with what it damps.
        let force = &self.shortened(force, left);
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
            self.cuts |= cuts::SLEW;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Joint, Kinematics};
    use crate::kinematics::forward;

    /// 10 N, 5 W, 2 m/s; 2000, 4000 and 8000 N/s.
    fn device() -> DeviceDescription {
        let joint = |max_slew_per_s| Joint {
            counts_per_unit: 1e5,
            zero_counts: 0,
            effort_per_amp: 1.0,
            max_current_a: 100.0,
            max_slew_per_s,
            max_speed_per_s: 10.0,
            inertia: 0.1,
            damping: 0.0,
            coulomb: 0.0,
        };
        DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint(2000.0), joint(4000.0), joint(8000.0)],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 10.0,
            max_power_w: 5.0,
            max_grip_speed_m_per_s: 2.0,
            actuation_delay_us: 0,
        }
    }

    fn off(switch: fn(&mut Guards)) -> Limits {
        let mut guards = Guards::ALL;
        switch(&mut guards);
        Limits::new(&device(), guards)
    }

    fn close(a: &Vec3, b: [f32; 3]) -> bool {
        (a - Vec3::from(b)).iter().all(|x| x.abs() < 1e-5)
    }

    #[test]
    fn force_and_power_are_bounded_in_both_directions() {
        let mut limits = off(|_| {});
        let still = Vec3::zeros();
        let long = Vec3::new(12.0, -16.0, 0.0);
        assert!(close(&limits.bound(&long, &still), [6.0, -8.0, 0.0]));
        // 8 N along or against 1 m/s are 8 W.
        for speed in [1.0, -1.0] {
            let force = limits.bound(&Vec3::new(0.0, 0.0, 8.0), &Vec3::new(0.5, 0.0, speed));
            assert!(close(&force, [0.0, 0.0, 5.0]), "{force}");
        }
        let across = limits.bound(&Vec3::new(0.0, 0.0, 8.0), &Vec3::new(1.3, 0.0, 0.0));
        assert!(close(&across, [0.0, 0.0, 8.0]));
        let strong = off(|guards| guards.force = false).bound(&long, &still);
        assert!(close(&strong, [12.0, -16.0, 0.0]));
        let mut mighty = off(|guards| guards.power = false);
        let force = mighty.bound(&Vec3::new(0.0, 0.0, 8.0), &Vec3::new(0.0, 0.0, 1.0));
        assert!(close(&force, [0.0, 0.0, 8.0]));
    }

    #[test]
    fn a_change_keeps_its_direction_within_every_joints_slew() {
        let pose = forward(&device(), &[0.0; JOINTS]);
        let mut limits = off(|_| {});
        // 2, 4 and 8 N in a tick: the first joint lets a quarter of this through.
        let wanted = Vec3::new(8.0, 4.0, 4.0);
        let force = limits.slewed(&wanted, &pose, 1.0);
        assert!(close(&force, [2.0, 1.0, 1.0]), "{force}");
        limits.commit(&force);
        assert!(close(&limits.slewed(&wanted, &pose, 1.0), [4.0, 2.0, 2.0]));
        // What is within the slew comes as it is.
        let near = Vec3::new(1.0, 0.5, 0.25);
        assert_eq!(limits.slewed(&near, &pose, 1.0), near);
        let mut free = off(|guards| guards.slew = false);
        assert_eq!(free.slewed(&wanted, &pose, 1.0), wanted);
    }

    #[test]
    fn the_force_fades_with_the_grips_speed_and_too_fast_is_told() {
        let mut limits = off(|_| {});
        let push = Vec3::new(0.0, 2.0, 0.0);
        let fast = |speed: f32| Vec3::new(speed, 0.0, 0.0);
        // A single tick is an encoder's matter.
        assert!(!limits.too_fast(&fast(1.7), true));
        assert!(close(&limits.bound(&push, &fast(1.7)), [0.0, 2.0, 0.0]));
        assert!(!limits.too_fast(&fast(1.7), true));
        // Half way from 70 to 100 %.
        assert!(close(&limits.bound(&push, &fast(1.7)), [0.0, 1.0, 0.0]));
        let told: [bool; 6] = core::array::from_fn(|_| limits.too_fast(&fast(2.1), true));
        assert_eq!(told, [false, false, false, false, true, true]);
        assert!(close(&limits.bound(&push, &fast(2.1)), [0.0; 3]));
        assert!(!limits.too_fast(&fast(2.1), false));
        let mut careless = off(|guards| guards.overspeed = false);
        let told: [bool; 6] = core::array::from_fn(|_| careless.too_fast(&fast(9.0), true));
        assert_eq!(told, [false; 6]);
        assert!(close(&careless.bound(&push, &fast(9.0)), [0.0, 2.0, 0.0]));
    }

    /// Every limit counts the ticks in which it took something away, and none else.
    #[test]
    fn ticks_are_counted_by_the_limit_that_cut_them() {
        let pose = forward(&device(), &[0.0; JOINTS]);
        let (still, fast) = (Vec3::zeros(), Vec3::new(0.0, 0.0, 1.0));
        let push = |n: f32| Vec3::new(0.0, 0.0, n);
        // Wanted force, velocity, and whether a motor has no room.
        let count = |force: f32, velocity: &Vec3, saturated| {
            let mut limits = off(|_| {});
            limits.commit(&push(force));
            let bounded = limits.bound(&push(force), velocity);
            limits.slewed(&bounded, &pose, 1.0);
            limits.count(saturated);
            let TicksLimited {
                force,
                current,
                power,
                speed,
                slew,
            } = limits.ticks();
            [force, current, power, speed, slew]
        };
        assert_eq!(count(0.0, &still, false), [0; 5]);
        assert_eq!(count(9.9, &still, false), [0; 5]);
        assert_eq!(count(12.0, &still, false), [1, 0, 0, 0, 0]);
        assert_eq!(count(9.9, &still, true), [1, 1, 0, 0, 0]);
        // 6 N along 1 m/s are 6 W; the change to 5 N is within 8 N in a tick.
        assert_eq!(count(6.0, &fast, false), [0, 0, 1, 0, 0]);
        // Rendering shortens what it gives by the same limit: in single precision it is the largest force only about.
        let rounded = shortened(Vec3::new(7.3, -11.9, 3.1), 10.0);
        let mut limits = off(|_| {});
        limits.bound(&rounded, &still);
        limits.count(false);
        assert_eq!(limits.ticks().force, 1);
        // From nothing to 9 N in a tick, of which a joint takes 8.
        let mut limits = off(|_| {});
        let bounded = limits.bound(&push(9.0), &still);
        limits.slewed(&bounded, &pose, 1.0);
        limits.count(false);
        assert_eq!((limits.ticks().force, limits.ticks().slew), (0, 1));
        // 1.7 m/s of 2 are beyond 70 %, in two ticks.
        let quick = Vec3::new(1.7, 0.0, 0.0);
        (0..2).for_each(|_| assert!(!limits.too_fast(&quick, true)));
        limits.bound(&push(1.0), &quick);
        limits.count(false);
        limits.bound(&push(0.0), &quick);
        limits.count(false);
        assert_eq!(limits.ticks().speed, 1);
        limits.count_anew();
        assert_eq!(limits.ticks(), TicksLimited::default());
    }

    /// 10 N in 8 ticks, the slowest slew for which it is promised, and forces that are as wild as they may be.
    #[test]
    fn what_is_stale_is_gone_in_time_whatever_was_wanted() {
        let mut slow = device();
        slow.joints
            .iter_mut()
            .for_each(|joint| joint.max_slew_per_s = 1250.0);
        let pose = forward(&slow, &[0.0; JOINTS]);
        let mut seed = 1_u32;
        let mut any = || {
            let mut part = || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (seed >> 8) as f32 * (1.0 / (1 << 23) as f32) - 1.0
            };
            Vec3::new(part(), part(), part()) * 100.0
        };
        for _ in 0..20_000 {
            let mut limits = Limits::new(&slow, Guards::ALL);
            limits.commit(&shortened(any(), 10.0));
            for left in (1..30_u8).rev() {
                let left = f32::from(left) / 30.0;
                let force = limits.slewed(&any(), &pose, left);
                limits.commit(&force);
            }
            let last = limits.slewed(&Vec3::zeros(), &pose, 0.0);
            assert_eq!(last, Vec3::zeros());
        }
    }
}
