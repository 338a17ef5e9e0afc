//! A needle in stiff tissue: whatever the tissue's stiffness, it is felt within the friction that holds it, and with all of that while it slides.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{bench, frame, needle, needle_frame, no_contact};
use sutura_shared::control::{Control, TickInput};
use sutura_shared::device::{DeviceDescription, Joint};
use sutura_shared::wire::message::{Command, Contact, Course, Friction, Needle, Tip};

/// Largest friction, either way \[N\]: of a needle, and of one that has just come in.
const FRICTIONS_N: [f64; 2] = [0.51, 0.1];
/// Mass and damping of the grip.
const MASS_KG: f64 = 0.1;
const DAMPING_N_S_PER_M: f64 = 0.5;

/// An elastic-plastic needle along -z.
#[derive(Clone, Copy)]
struct Tissue {
    friction_n: f64,
    stiffness_n_per_m: f64,
    axial_n: f64,
    slide_m: f64,
}

impl Tissue {
    fn new(stiffness_n_per_m: f64, friction_n: f64) -> Self {
        Tissue {
            friction_n,
            stiffness_n_per_m,
            axial_n: 0.0,
            slide_m: 0.0,
        }
    }

    /// Force on the grip along z \[N\] at a height \[m\].
    fn go(&mut self, z: f64) -> f64 {
        let trial_n = self.axial_n - self.stiffness_n_per_m * (-z - self.slide_m);
        self.axial_n = trial_n.clamp(-self.friction_n, self.friction_n);
        self.slide_m = -z;
        -self.axial_n
    }

    fn frames(&self, z: f64) -> (Contact, Needle) {
        let sticks = self.axial_n.abs() < 0.999 * self.friction_n;
        let now = if sticks { self.stiffness_n_per_m } else { 0.0 };
        let mut contact = Contact {
            position_m: [0.0, 0.0, z as f32],
            normal: [0.0, 0.0, 1.0],
            gap_m: 0.0,
            horizon_us: 150_000,
            ..no_contact()
        };
        contact.wrench[2] = -self.axial_n as f32;
        contact.tangent[11] = -now as f32;
        let needle = Needle {
            slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
            tip: Tip::Inside,
            friction: match (sticks, self.axial_n < 0.0) {
                (true, _) => Friction::Sticks,
                (false, true) => Friction::Forward,
                (false, false) => Friction::Backward,
            },
            axial_n: self.axial_n as f32,
            friction_n: [self.friction_n as f32; 2],
            stiffness_n_per_m: [self.stiffness_n_per_m as f32, now as f32],
            hold_n: 0.0,
            puncture_n: 0.0,
            punctured_n: self.axial_n as f32,
            course: Course::default(),
            ..needle()
        };
        (contact, needle)
    }
}

fn light() -> DeviceDescription {
    let joint = Joint {
        inertia: MASS_KG as f32,
        damping: DAMPING_N_S_PER_M as f32,
        coulomb: 0.0,
        ..bench().joints[0]
    };
    DeviceDescription {
        joints: [joint; 3],
        gravity_mass_kg: [0.0; 3],
        ..bench()
    }
}

/// Height at which a hand wants the grip \[m\]: in at 20 mm/s, then to and fro.
fn wanted_m(time_s: f64) -> f64 {
    if time_s < 1.5 {
        -0.02 * time_s
    } else {
        -0.03 + 4e-3 * (1.0 - (9.0 * (time_s - 1.5)).cos())
    }
}

/// Largest force \[N\], and the mean one over the true one while it slides in, of a needle in such tissue with a hand of this stiffness.
fn felt(stiffness_n_per_m: f64, friction_n: f64, hand_n_per_m: f64, period_ms: u32) -> (f64, f64) {
    let counts_per_m = f64::from(light().joints[2].counts_per_unit);
    let mut control = Control::new(light()).unwrap();
    control.command(Command::Arm);
    let (mut truth, mut host) = (
        Tissue::new(stiffness_n_per_m, friction_n),
        Tissue::new(stiffness_n_per_m, friction_n),
    );
    let (mut z, mut velocity, mut acting_n) = (0.0_f64, 0.0_f64, 0.0);
    let mut under_way = None;
    let (mut most_n, mut means) = (0.0_f64, [0.0, 0.0]);
    for ms in 1..=3000_u32 {
        let time_s = f64::from(ms) * 1e-3;
        let true_n = truth.go(z);
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: [0, 0, (z * counts_per_m).floor() as i32],
            ..TickInput::default()
        };
        let mut fresh = None;
        let arrived = under_way.take_if(|_| ms % period_ms == 0);
        if let Some((time_us, contact, needle)) = arrived {
            control.needle(&needle_frame(2 * ms, time_us, needle));
            fresh = Some(frame(2 * ms + 1, time_us, contact).into());
        }
        let output = control.tick(&input, fresh.as_ref());
        if ms % period_ms == 0 {
            let place_m = f64::from(output.state.position_m[2]);
            host.go(place_m);
            let (contact, needle) = host.frames(place_m);
            under_way = Some((input.now_us, contact, needle));
        }
        let commanded_n = f64::from(output.state.force_n[2]);
        most_n = most_n.max(commanded_n.abs());
        let slides = true_n > 0.999 * friction_n;
        if (0.3..1.5).contains(&time_s) && slides {
            means = [means[0] + commanded_n, means[1] + true_n];
        }
        // The command of the tick before acts now.
        for step in 0..20 {
            let at_s = time_s + 5e-5 * f64::from(step);
            if hand_n_per_m.is_infinite() {
                z = wanted_m(at_s + 5e-5);
                continue;
            }
            let pull_n = hand_n_per_m * (wanted_m(at_s) - z) - (2.0 + DAMPING_N_S_PER_M) * velocity;
            velocity += 5e-5 * (acting_n + pull_n) / MASS_KG;
            z += 5e-5 * velocity;
        }
        acting_n = commanded_n;
    }
    (most_n, means[0] / means[1])
}

#[test]
fn a_needle_is_felt_within_its_friction_however_stiff_the_tissue_is() {
    let hands = [50.0, 100.0, 200.0, 800.0, 2000.0, f64::INFINITY];
    for stiffness in [1e3, 3e3, 8e3, 26e3, 78e3, 260e3, 1e6] {
        for friction_n in FRICTIONS_N {
            for (hand, period_ms) in hands
                .iter()
                .flat_map(|h| [1, 2, 5, 10, 17, 33].map(|p| (*h, p)))
            {
                let (most_n, part) = felt(stiffness, friction_n, hand, period_ms);
                let what =
                    format!("{friction_n} N at {stiffness} N/m, hand {hand} N/m, {period_ms} ms");
                assert!(most_n < 1.25 * friction_n, "{what}: {most_n} N");
                assert!(part > 0.8, "{what}: {part} of the true force");
            }
        }
    }
}
