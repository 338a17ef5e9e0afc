//! The console without the console: three joints with mass, friction, motors and encoders, and a hand.
//!
//! Entry point: [`VirtualDevice::advance`]. Each joint has its own inertia; no joint's motion throws
//! another one about. Velocities come from one implicit Euler step, which stays stable for any stiffness
//! and damping of the hand; friction is Coulomb's with true sticking, as the minimum of a convex function
//! (maximum dissipation; Moreau 1988) that coordinate descent finds.

use crate::device::{DeviceDescription, JOINTS, Joint, MAX_ACTUATION_DELAY_US};
use crate::kinematics::{Pose, forward};
use crate::math::{Vec3, clamp, dot, shrink};
use crate::wire::message::{HandScript, WAY_POINTS, WayPoint};

/// Steps of the simulation in each call of [`VirtualDevice::advance`].
const SUB_STEPS: u32 = 8;

/// Sweeps of coordinate descent. One is exact where no hand couples the joints; a normal hand couples
/// them by less than 1 %, so that four reach round-off.
const SWEEPS: u32 = 4;

/// Commands that may be under way: with the longest delay the one of five ticks ago acts.
const DELAYED: usize = (MAX_ACTUATION_DELAY_US / 1000) as usize + 1;

/// The simulated mechanics.
#[derive(Clone, Copy, Debug)]
pub struct VirtualDevice {
    device: DeviceDescription,
    hand: Option<Hand>,
    /// Joint coordinates \[m or rad\], (3).
    q: [f32; JOINTS],
    /// Joint velocities \[m/s or rad/s\], (3).
    dq: [f32; JOINTS],
    encoder_offset: [i32; JOINTS],
    /// Motor efforts of the last calls, the newest first: the device's delay decides which one acts.
    commanded: [[f32; JOINTS]; DELAYED],
}

/// A hand on its path.
#[derive(Clone, Copy, Debug)]
struct Hand {
    script: HandScript,
    /// Time since the script began \[us\].
    time_us: u32,
}

impl VirtualDevice {
    /// A device at rest at joint coordinates 0, on its stand: it stays there until a hand takes it.
    pub fn new(device: &DeviceDescription) -> Self {
        VirtualDevice {
            device: *device,
            hand: None,
            q: [0.0; JOINTS],
            dq: [0.0; JOINTS],
            encoder_offset: [0; JOINTS],
            commanded: [[0.0; JOINTS]; DELAYED],
        }
    }

    /// Starts a hand's script. A hand without stiffness and damping leaves the device alone, but takes it
    /// off its stand.
    pub fn set_hand(&mut self, script: &HandScript) {
        self.hand = Some(Hand {
            script: *script,
            time_us: 0,
        });
    }

    /// Puts the joints at coordinates `q`, at rest.
    pub fn place(&mut self, q: &[f32; JOINTS]) {
        self.q = *q;
        self.dq = [0.0; JOINTS];
    }

    /// Adds this to every encoder reading from now on \[counts\], instead of what was added before.
    pub fn set_encoder_offset(&mut self, counts: [i32; JOINTS]) {
        self.encoder_offset = counts;
    }

    /// Encoder readings \[counts\], (3).
    pub fn encoder_counts(&self) -> [i32; JOINTS] {
        let mut counts = self.encoder_offset;
        for ((out, joint), q) in counts.iter_mut().zip(&self.device.joints).zip(&self.q) {
            let whole = libm::floorf(q * joint.counts_per_unit) as i32;
            *out = out.wrapping_add(whole).wrapping_add(joint.zero_counts);
        }
        counts
    }

    /// Joint coordinates \[m or rad\] and velocities \[m/s or rad/s\].
    pub fn joints(&self) -> ([f32; JOINTS], [f32; JOINTS]) {
        (self.q, self.dq)
    }

    /// The device that it is.
    pub fn description(&self) -> &DeviceDescription {
        &self.device
    }

    /// Grip position \[m\], world frame.
    pub fn position(&self) -> Vec3 {
        forward(&self.device, &self.q).position_m
    }

    /// Force of the hand on the grip \[N\].
    pub fn hand_force(&self) -> Vec3 {
        let pose = forward(&self.device, &self.q);
        self.hand.map_or(Vec3::zeros(), |hand| {
            let (target, velocity) = hand.target();
            let script = &hand.script;
            (target - pose.position_m) * script.stiffness_n_per_m
                + (velocity - pose.velocity(&self.dq)) * script.damping_n_s_per_m
        })
    }

    /// Lets `dt_us`, one tick, pass under these motor currents \[A\]: each set acts from the device's
    /// actuation delay on. Amplifiers that go off do so at once.
    pub fn advance(&mut self, current_a: &[f32; JOINTS], amplifiers_on: bool, dt_us: u32) {
        let Some(mut hand) = self.hand else {
            return;
        };
        self.commanded.rotate_right(1);
        let newest = self.motor_effort(current_a, amplifiers_on);
        if let Some(slot) = self.commanded.first_mut() {
            *slot = newest;
        }
        if !amplifiers_on {
            self.commanded = [newest; DELAYED];
        }
        let step_us = dt_us / SUB_STEPS;
        for step in 0..SUB_STEPS {
            hand.time_us = hand.time_us.saturating_add(step_us);
            let motor = self.acting(step * step_us, dt_us);
            self.step(&motor, &hand, step_us as f32 * 1e-6);
        }
        self.hand = Some(hand);
    }

    /// The efforts that act `since_us` after the newest command, where `period_us` lies between two.
    fn acting(&self, since_us: u32, period_us: u32) -> [f32; JOINTS] {
        let waiting_us = self.device.actuation_delay_us.saturating_sub(since_us);
        let behind = waiting_us.div_ceil(period_us.max(1)) as usize;
        let oldest = self.commanded.last().copied().unwrap_or_default();
        self.commanded.get(behind).copied().unwrap_or(oldest)
    }

    fn motor_effort(&self, current_a: &[f32; JOINTS], amplifiers_on: bool) -> [f32; JOINTS] {
        let mut effort = [0.0; JOINTS];
        if amplifiers_on {
            let joints = self.device.joints.iter().zip(current_a);
            for (out, (joint, current_a)) in effort.iter_mut().zip(joints) {
                *out = clamp(*current_a, -joint.max_current_a, joint.max_current_a)
                    * joint.effort_per_amp;
            }
        }
        effort
    }

    /// Implicit in the velocity: (M + dt B + J' (dt b + dt^2 k) J) dq = M dq0 + dt (motor - weight + J' f0),
    /// less friction, where f0 is the hand's force if the grip stood still.
    fn step(&mut self, motor: &[f32; JOINTS], hand: &Hand, dt: f32) {
        let pose = forward(&self.device, &self.q);
        let (target, velocity) = hand.target();
        let (k, b) = (hand.script.stiffness_n_per_m, hand.script.damping_n_s_per_m);
        let at_rest = (target - pose.position_m) * k + velocity * b;
        let mut impulse = pose.effort(&at_rest);
        let joints = self.device.joints.iter().zip(&self.dq);
        let efforts = motor.iter().zip(&pose.weight_effort);
        for ((out, (joint, dq)), (motor, weight)) in impulse.iter_mut().zip(joints).zip(efforts) {
            *out = joint.inertia * dq + dt * (motor - weight + *out);
        }
        self.solve_velocity(&pose, &impulse, dt * (b + dt * k), dt);
        for (q, dq) in self.q.iter_mut().zip(&self.dq) {
            *q += dt * dq;
        }
    }

    /// Minimises 1/2 dq' A dq - impulse' dq + sum dt c_i |dq_i| with A = M + dt B + hand J' J, one joint
    /// after the other.
    fn solve_velocity(&mut self, pose: &Pose, impulse: &[f32; JOINTS], hand: f32, dt: f32) {
        // Velocity of the grip, kept up to date.
        let mut grip = pose.velocity(&self.dq);
        for _ in 0..SWEEPS {
            let joints = self.device.joints.iter().zip(&pose.jacobian);
            for ((dq, (joint, column)), impulse) in self.dq.iter_mut().zip(joints).zip(impulse) {
                let own = hand * dot(column, column);
                let from_others = hand * dot(column, &grip) - own * *dq;
                let new = moved(joint, own, impulse - from_others, dt);
                grip += column * (new - *dq);
                *dq = new;
            }
        }
    }
}

/// Velocity of one joint after an impulse, against its damping and friction and what it feels of the hand.
fn moved(joint: &Joint, hand: f32, impulse: f32, dt: f32) -> f32 {
    shrink(impulse, dt * joint.coulomb) / (joint.inertia + dt * joint.damping + hand)
}

impl Hand {
    /// Where the hand wants the grip to be \[m\], and how fast it wants it to go \[m/s\].
    fn target(&self) -> (Vec3, Vec3) {
        path(&self.script, self.time_us)
    }
}

/// The path of a script at a time since its beginning \[us\]: position \[m\] and velocity \[m/s\].
///
/// From each way point to the next with minimum jerk, at rest at both (Flash and Hogan 1985); at rest
/// before the first and after the last.
pub fn path(script: &HandScript, time_us: u32) -> (Vec3, Vec3) {
    let count = usize::from(script.count).clamp(1, WAY_POINTS);
    let [first, ..] = script.way_points;
    let (mut from, mut to) = (first, first);
    for point in script.way_points.iter().take(count) {
        from = to;
        to = *point;
        if micros(to) > time_us {
            break;
        }
        // After the last one that has passed, both ends are the same point.
        from = to;
    }
    let (begin, length) = (micros(from), micros(to).saturating_sub(micros(from)));
    let (start, end) = (Vec3::from(from.position_m), Vec3::from(to.position_m));
    if length == 0 {
        return (end, Vec3::zeros());
    }
    let length_s = length as f32 * 1e-6;
    let s = time_us.saturating_sub(begin) as f32 * 1e-6 / length_s;
    let blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
    let rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) / length_s;
    (start + (end - start) * blend, (end - start) * rate)
}

fn micros(point: WayPoint) -> u32 {
    (point.time_s * 1e6) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Kinematics;

    /// A firm human hand on a light arm: what is left of the equation of one step, against its terms.
    #[test]
    fn a_command_acts_after_its_delay() {
        let joint = Joint {
            counts_per_unit: 1e5,
            zero_counts: 0,
            effort_per_amp: 2.0,
            max_current_a: 10.0,
            max_slew_per_s: 1.0,
            max_speed_per_s: 1.0,
            inertia: 0.5,
            damping: 0.0,
            coulomb: 0.0,
        };
        // 2 A x 2 N/A on 0.5 kg: 8 m/s^2 from the delay on, in steps of 125 us.
        for (delay_us, acting_us) in [(0, 1000), (250, 750), (1000, 0), (1500, 0), (5000, 0)] {
            let mut stage = VirtualDevice::new(&DeviceDescription {
                name: [0; 16],
                kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
                joints: [joint; JOINTS],
                gravity_mass_kg: [0.0; JOINTS],
                max_force_n: 10.0,
                max_power_w: 10.0,
                max_grip_speed_m_per_s: 1.0,
                actuation_delay_us: delay_us,
            });
            stage.set_hand(&HandScript {
                stiffness_n_per_m: 0.0,
                damping_n_s_per_m: 0.0,
                start_joint: [0.0; JOINTS],
                count: 1,
                way_points: [WayPoint::default(); WAY_POINTS],
            });
            let speed = |stage: &VirtualDevice| stage.joints().1[0];
            stage.advance(&[2.0, 0.0, 0.0], true, 1000);
            let expected = 8.0 * acting_us as f32 * 1e-6;
            assert!((speed(&stage) - expected).abs() < 1e-6, "{delay_us}");
            for _ in 0..5 {
                stage.advance(&[0.0; 3], true, 1000);
            }
            // The whole pulse of 1 ms has acted.
            let expected = 8e-3;
            assert!((speed(&stage) - expected).abs() < 1e-6, "{delay_us}");
            // What was under way when the amplifiers went off does not act any more.
            stage.advance(&[2.0, 0.0, 0.0], true, 1000);
            let before = speed(&stage);
            stage.advance(&[2.0, 0.0, 0.0], false, 1000);
            assert_eq!(speed(&stage), before);
        }
    }

    #[test]
    fn the_sweeps_solve_a_step_to_round_off() {
        let joint = |inertia| Joint {
            counts_per_unit: 1e4,
            zero_counts: 0,
            effort_per_amp: 0.3,
            max_current_a: 3.0,
            max_slew_per_s: 300.0,
            max_speed_per_s: 12.0,
            inertia,
            damping: 0.01,
            coulomb: 0.0,
        };
        let device = DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::SerialArm {
                shoulder_m: [0.0; 3],
                upper_m: 0.22,
                fore_m: 0.22,
            },
            joints: [joint(0.006), joint(0.006), joint(0.003)],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 2.0,
            max_power_w: 1e3,
            max_grip_speed_m_per_s: 10.0,
            actuation_delay_us: 0,
        };
        let mut arm = VirtualDevice::new(&device);
        let pose = forward(&device, &[0.3, 0.8, -1.4]);
        let (dt, hand) = (125e-6, 125e-6 * (40.0 + 125e-6 * 2000.0));
        let impulse = [1e-3, -2e-3, 1.5e-3];
        arm.solve_velocity(&pose, &impulse, hand, dt);
        let grip = pose.effort(&(pose.velocity(&arm.dq) * hand));
        for i in 0..JOINTS {
            let own = (device.joints[i].inertia + dt * 0.01) * arm.dq[i];
            let rest = own + grip[i] - impulse[i];
            assert!(rest.abs() < 2e-6 * 1e-3, "{i}: {rest:e}");
        }
    }
}
