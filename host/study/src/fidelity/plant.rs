//! A console in numbers: three independent axes with mass and friction, encoders, motors that act a tick
//! later, and the ledger of what they do to the hand.
//!
//! Entry points: [`Plant::advance`], [`Plant::counts`]. Time steps of 50 us, so that motion and ledger are
//! those of continuous time; motors hold their force for a whole tick, so the work of each step is the
//! force times the way, without any error of quadrature.

use super::hand::{Grasp, Motion, ramp};
use super::scenes::Scene;
use sutura_shared::control::TICK_S;
use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics};

/// Steps in a tick.
pub const STEPS: u32 = 20;

/// How a console differs from its description: what its control cannot know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Off {
    /// Ticks that a command acts later than described.
    pub ticks: i8,
    /// Time constant of a first-order lag between command and force, as of a current loop \[s\].
    pub lag_s: f64,
    /// Mass in the described one.
    pub mass: f64,
    /// Force of the motors in the described one.
    pub torque: f64,
}

impl Off {
    /// As it is described.
    pub const NONE: Off = Off {
        ticks: 0,
        lag_s: 0.0,
        mass: 1.0,
        torque: 1.0,
    };

    /// As tables print it.
    pub fn word(&self) -> String {
        let mut words = Vec::new();
        if self.ticks != 0 {
            words.push(format!("{:+}-tick", self.ticks));
        }
        if self.lag_s > 0.0 {
            words.push(format!("lag-{}-ms", 1e3 * self.lag_s));
        }
        for (name, times) in [("mass", self.mass), ("torque", self.torque)] {
            if times != 1.0 {
                words.push(format!("{name}-x{times}"));
            }
        }
        if words.is_empty() {
            return "nominal".to_owned();
        }
        words.join(" ")
    }
}

/// Mechanics of every axis of the console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mechanics {
    /// \[kg\].
    pub mass_kg: f64,
    /// \[N s/m\].
    pub damping_n_s_per_m: f64,
    /// Coulomb friction \[N\].
    pub coulomb_n: f64,
    /// \[1/m\].
    pub counts_per_m: f64,
    /// Whole ticks from a command until it acts.
    pub actuation_ticks: usize,
    /// Most mechanical power that it may give or take \[W\].
    pub max_power_w: f64,
    /// What of all this is not so.
    pub off: Off,
}

impl Mechanics {
    /// The light bench device of the stability literature's size: 0.1 kg, 0.5 N s/m, 4096 counts on a turn of
    /// an 8 mm pulley (12.3 um), one tick of delay in amplifier and winding.
    pub const LIGHT: Mechanics = Mechanics {
        mass_kg: 0.1,
        damping_n_s_per_m: 0.5,
        coulomb_n: 0.0,
        counts_per_m: 81_487.0,
        actuation_ticks: 1,
        max_power_w: 10.0,
        off: Off::NONE,
    };
    /// The same with encoders of 0.2 um.
    pub const ISOTROPIC: Mechanics = Mechanics {
        counts_per_m: 64.0 * Mechanics::LIGHT.counts_per_m,
        ..Mechanics::LIGHT
    };
    /// The same with an amplifier that takes back less.
    pub const WEAK: Mechanics = Mechanics {
        max_power_w: 5.0,
        ..Mechanics::LIGHT
    };

    /// Whole ticks from a command until it does act.
    pub fn ticks_late(&self) -> usize {
        self.actuation_ticks
            .saturating_add_signed(isize::from(self.off.ticks))
    }

    /// The description that the console's control gets. Motors of 15 N; forces, slew and speed limited as on
    /// the bench consoles.
    pub fn description(&self) -> DeviceDescription {
        let joint = Joint {
            counts_per_unit: self.counts_per_m as f32,
            zero_counts: 0,
            effort_per_amp: 3.75,
            max_current_a: 4.0,
            max_slew_per_s: 2000.0,
            max_speed_per_s: 2.0,
            inertia: self.mass_kg as f32,
            damping: self.damping_n_s_per_m as f32,
            coulomb: self.coulomb_n as f32,
        };
        DeviceDescription {
            name: *b"simulated\0\0\0\0\0\0\0",
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 10.0,
            actuation_delay_us: self.actuation_ticks as u32 * 1000,
            max_power_w: self.max_power_w as f32,
            max_grip_speed_m_per_s: 1.5,
        }
    }
}

/// What evolves.
#[derive(Clone, Copy)]
pub struct Plant<'a> {
    mechanics: Mechanics,
    grasp: Grasp,
    motion: Motion,
    /// Where the motion takes place.
    scene: &'a dyn Scene,
    /// Time \[s\].
    time_s: f64,
    /// Place of the grip \[m\], (3), and velocity \[m/s\], (3).
    pub position_m: [f64; 3],
    /// \[m/s\], (3).
    pub velocity_m_per_s: [f64; 3],
    /// Force on the grip besides hand and motors \[N\], (3): a knock.
    pub knock_n: [f64; 3],
    /// Force that the motors make now \[N\], (3).
    motors_n: [f64; 3],
    /// What the motors have taken from the motion so far, less what they have given \[J\].
    pub energy_j: f64,
    /// The least of it so far \[J\].
    pub least_energy_j: f64,
}

impl<'a> Plant<'a> {
    /// The hand at the start of its way.
    pub fn new(mechanics: Mechanics, motion: Motion, grasp: Grasp, scene: &'a dyn Scene) -> Self {
        Plant {
            mechanics,
            motion,
            grasp,
            scene,
            time_s: 0.0,
            position_m: scene.place(motion.at(0.0)),
            velocity_m_per_s: pace(scene, motion, 0.0),
            knock_n: [0.0; 3],
            motors_n: [0.0; 3],
            energy_j: 0.0,
            least_energy_j: 0.0,
        }
    }

    /// Encoder readings \[counts\], (3).
    pub fn counts(&self) -> [i32; JOINTS] {
        self.position_m
            .map(|x| (x * self.mechanics.counts_per_m).floor() as i32)
    }

    /// One tick under a force that is asked of the motors \[N\], (3). Gives the mean of what they made of it \[N\], (3).
    pub fn advance(&mut self, asked_n: &[f64; 3]) -> [f64; 3] {
        let step_s = f64::from(TICK_S) / f64::from(STEPS);
        let start_s = self.time_s;
        let goal_n = asked_n.map(|force| force * self.mechanics.off.torque);
        let lag_s = self.mechanics.off.lag_s;
        let kept = (-step_s / lag_s.max(1e-9)).exp();
        let mut mean_n = [0.0; 3];
        if lag_s == 0.0 {
            self.motors_n = goal_n;
            mean_n = goal_n;
        }
        for step in 1..=STEPS {
            if lag_s > 0.0 {
                for axis in 0..3 {
                    self.motors_n[axis] =
                        goal_n[axis] + (self.motors_n[axis] - goal_n[axis]) * kept;
                    mean_n[axis] += self.motors_n[axis] / f64::from(STEPS);
                }
            }
            let motors_n = self.motors_n;
            let end_s = start_s + step_s * f64::from(step);
            let before = self.position_m;
            match self.grasp {
                Grasp::Rigid => {
                    self.position_m = self.scene.place(self.motion.at(end_s));
                    self.velocity_m_per_s = pace(self.scene, self.motion, end_s);
                }
                Grasp::Spring {
                    stiffness_n_per_m,
                    damping_n_s_per_m,
                } => {
                    let (goal, pace) = (
                        self.scene.place(self.motion.at(end_s)),
                        pace(self.scene, self.motion, end_s),
                    );
                    for axis in 0..3 {
                        let push = motors_n[axis]
                            + self.knock_n[axis]
                            + stiffness_n_per_m * (goal[axis] - self.position_m[axis])
                            + damping_n_s_per_m * pace[axis];
                        self.move_axis(axis, push, stiffness_n_per_m, damping_n_s_per_m, step_s);
                    }
                }
                Grasp::Weight { force_n, .. } => {
                    let down = direction(self.scene, [0.0, 0.0, -1.0]);
                    let weight_n = force_n * ramp(end_s / 0.5);
                    for axis in 0..3 {
                        let push = motors_n[axis] + self.knock_n[axis] + weight_n * down[axis];
                        self.move_axis(axis, push, 0.0, 0.0, step_s);
                    }
                }
            }
            for axis in 0..3 {
                self.energy_j -= motors_n[axis] * (self.position_m[axis] - before[axis]);
            }
            self.least_energy_j = self.least_energy_j.min(self.energy_j);
            self.time_s = end_s;
        }
        mean_n
    }

    /// Implicit in the hand's spring and all damping, by the trapezoidal rule: neither adds nor takes energy.
    fn move_axis(&mut self, axis: usize, push: f64, k: f64, b: f64, h: f64) {
        let Mechanics {
            mass_kg,
            damping_n_s_per_m,
            coulomb_n,
            off,
            ..
        } = self.mechanics;
        let carried_kg = match self.grasp {
            Grasp::Weight { mass_kg, .. } => mass_kg,
            Grasp::Rigid | Grasp::Spring { .. } => 0.0,
        };
        let m = mass_kg * off.mass + carried_kg;
        let v0 = self.velocity_m_per_s[axis];
        let b = b + damping_n_s_per_m;
        // m (v1 - v0) = h (push - b (v0 + v1) / 2 - k h (v0 + v1) / 4)
        let resist = 0.5 * h * (b + 0.5 * h * k);
        let free = m * v0 + h * push - resist * v0;
        let rubs = h * coulomb_n;
        let kept = free.abs() - rubs;
        let v1 = if kept > 0.0 {
            kept.copysign(free) / (m + resist)
        } else {
            0.0
        };
        self.position_m[axis] += 0.5 * h * (v0 + v1);
        self.velocity_m_per_s[axis] = v1;
    }
}

/// A direction of the hands' frame in the world's, (3).
fn direction(scene: &dyn Scene, way: [f64; 3]) -> [f64; 3] {
    let (from, to) = (scene.place([0.0; 3]), scene.place(way));
    [0, 1, 2].map(|axis: usize| to[axis] - from[axis])
}

/// Velocity of a hand \[m/s\], (3), world frame.
pub(super) fn pace(scene: &dyn Scene, motion: Motion, time_s: f64) -> [f64; 3] {
    let (way, velocity) = (motion.at(time_s), motion.velocity(time_s));
    let ahead = [0, 1, 2].map(|axis: usize| way[axis] + velocity[axis]);
    let (from, to) = (scene.place(way), scene.place(ahead));
    [0, 1, 2].map(|axis: usize| to[axis] - from[axis])
}

#[cfg(test)]
mod tests {
    use super::super::scenes::point::Point;
    use super::*;

    const SCENE: Point = Point::TISSUE;

    fn held(k: f64, b: f64) -> Plant<'static> {
        let grasp = Grasp::Spring {
            stiffness_n_per_m: k,
            damping_n_s_per_m: b,
        };
        let mechanics = Mechanics {
            damping_n_s_per_m: 0.0,
            ..Mechanics::LIGHT
        };
        // Taps begin with 96 ms of rest.
        Plant::new(mechanics, Motion::Taps, grasp, &SCENE)
    }

    /// A mass on the hand's spring swings as it must, and keeps its energy.
    #[test]
    fn a_mass_on_a_spring_swings() {
        let mut plant = held(200.0, 0.0);
        let rest = plant.position_m[2];
        plant.position_m[2] += 1e-3;
        let omega = (200.0_f64 / 0.1).sqrt();
        for tick in 1..=90 {
            plant.advance(&[0.0; 3]);
            let expected = 1e-3 * (omega * f64::from(tick) * 1e-3).cos();
            let found = plant.position_m[2] - rest;
            assert!(
                (found - expected).abs() < 1e-6,
                "{tick}: {found} {expected}"
            );
        }
        assert_eq!(plant.energy_j, 0.0);
    }

    /// The motors' work is what the mass has gained.
    #[test]
    fn the_ledger_is_the_work() {
        let mut plant = held(0.0, 0.0);
        for _ in 0..50 {
            plant.advance(&[0.0, 0.7, 0.0]);
        }
        let speed = plant.velocity_m_per_s[1];
        // A tick is a millisecond in single precision.
        assert!((speed - 0.35).abs() < 1e-7, "{speed}");
        assert!((plant.energy_j + 0.5 * 0.1 * speed * speed).abs() < 1e-9);
        for _ in 0..50 {
            plant.advance(&[0.0, -0.7, 0.0]);
        }
        assert!(plant.energy_j.abs() < 1e-9, "{}", plant.energy_j);
        assert!((plant.least_energy_j + 0.5 * 0.1 * 0.35 * 0.35).abs() < 1e-9);
    }

    /// A lag of 2 ms makes 1 - 1/e of the force in that time, and takes nothing of its impulse but what is still to come.
    #[test]
    fn motors_lag() {
        let mut plant = held(0.0, 0.0);
        plant.mechanics.off = Off {
            lag_s: 2e-3,
            torque: 0.5,
            mass: 2.0,
            ticks: 0,
        };
        let means = [(); 2].map(|()| plant.advance(&[2.0, 0.0, 0.0])[0]);
        let part = 1.0 - (-1.0_f64).exp();
        assert!((plant.motors_n[0] - part).abs() < 1e-4);
        // Impulse: t - tau (1 - exp(-t / tau)), to the length of a step.
        let impulse = 2e-3 - 2e-3 * part;
        assert!((1e-3 * (means[0] + means[1]) - impulse).abs() < 2.5e-5);
        let speed = plant.velocity_m_per_s[0];
        assert!((speed - 1e-3 * (means[0] + means[1]) / 0.2).abs() < 1e-8);
    }

    #[test]
    fn a_weight_falls_with_what_it_carries() {
        let mechanics = Mechanics {
            damping_n_s_per_m: 0.0,
            ..Mechanics::LIGHT
        };
        let grasp = Grasp::Weight {
            mass_kg: 0.1,
            force_n: 1.0,
        };
        let mut plant = Plant::new(mechanics, Motion::Taps, grasp, &SCENE);
        for _ in 0..500 {
            plant.advance(&[0.0; 3]);
        }
        // The ramp's mean is a half.
        let speed = plant.velocity_m_per_s[2];
        assert!((speed + 0.5 * 0.5 * 1.0 / 0.2).abs() < 1e-3, "{speed}");
    }

    #[test]
    fn coulomb_friction_holds_and_then_brakes() {
        let mut plant = held(0.0, 0.0);
        plant.mechanics.coulomb_n = 0.2;
        plant.advance(&[0.19, 0.0, 0.0]);
        assert_eq!(plant.velocity_m_per_s[0], 0.0);
        plant.advance(&[0.3, 0.0, 0.0]);
        assert!((plant.velocity_m_per_s[0] - 1e-3).abs() < 1e-9);
    }
}
