//! A grip in one direction: console, hand, motors and a late host around the real control loop, on tissue in closed form.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test uses its part of it"
)]

use crate::rig::{frame, thread, thread_frame, wall};
use sutura_shared::control::{Control, Guards, Rendering, TickInput, Tuning};
use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics};
use sutura_shared::wire::inputs;
use sutura_shared::wire::message::{Command, Contact, Mode, Tension, Thread};

/// Steps of the mechanics in a tick.
const STEPS: u32 = 20;
const STEP_S: f64 = 1e-3 / STEPS as f64;
/// 4096 counts on a turn of a pulley of 8 mm \[1/m\].
pub const COUNTS_PER_M: f64 = 81_487.0;

/// Who holds the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hand {
    /// Goes where it wants.
    Rigid,
    /// Spring \[N/m\] and damper \[N s/m\] to where it wants.
    Spring(f64, f64),
    /// A mass \[kg\] one with the grip, pushed by a force \[N\], negative into the tissue. No spring holds it.
    Mass(f64, f64),
}

/// What the grip works against: force \[N\] and stiffness \[N/m\] at a depth \[m\].
pub type Law = dyn Fn(f64) -> (f64, f64);

/// One run.
pub struct Scene<'a> {
    /// Where the hand wants the grip at a time \[s\] \[m\].
    pub path: &'a dyn Fn(f64) -> f64,
    pub hand: Hand,
    pub law: &'a Law,
    /// Height of the surface at a time \[s\] \[m\].
    pub surface: &'a dyn Fn(f64) -> f64,
    /// The force is that of a thread that pulls up, and goes out as one.
    pub is_thread: bool,
    pub host_hz: f64,
    /// From a state until its frame is there \[s\].
    pub delay_s: f64,
    /// Part of a period by which the host's turns come later.
    pub phase: f64,
    /// Frames that arrive within these times are lost \[s\].
    pub lost: &'a [(f64, f64)],
    pub horizon_us: u32,
    pub counts_per_m: f64,
    /// Place of the counts' edges \[m\].
    pub offset_m: f64,
    /// Lag of the motors beyond the description \[s\], and their force over the described one.
    pub lag_s: f64,
    pub torque: f64,
    /// Factor on the tangent that is sent.
    pub tangent: f64,
    pub seconds: f64,
    pub tuning: Tuning,
}

impl Scene<'_> {
    pub const BASE: Scene<'static> = Scene {
        path: &|_| 0.0,
        hand: Hand::Rigid,
        law: &|_| (0.0, 0.0),
        surface: &|_| 0.0,
        is_thread: false,
        host_hz: 60.0,
        delay_s: 1.0 / 60.0,
        phase: 0.0,
        lost: &[],
        horizon_us: 67_000,
        counts_per_m: COUNTS_PER_M,
        offset_m: 0.0,
        lag_s: 0.0,
        torque: 1.0,
        tangent: 1.0,
        seconds: 2.0,
        tuning: Tuning {
            rendering: Rendering::Rows,
            guards: Guards::ALL,
        },
    };
}

/// One tick.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// Place of the grip when the encoders were read \[m\], and its velocity \[m/s\].
    pub z: f64,
    pub v: f64,
    /// Commanded \[N\].
    pub force: f64,
    /// True at the same place and time, and its mean over the tick in which the command acts \[N\].
    pub truth: f64,
    pub meant: f64,
    /// What the motors have taken from the grip so far \[J\], and what the true tissue would have on the same way.
    pub energy: f64,
    pub true_energy: f64,
    pub withheld: bool,
    pub mode: Mode,
}

/// A spring of this stiffness \[N/m\].
pub fn linear(stiffness: f64) -> impl Fn(f64) -> (f64, f64) {
    move |deep: f64| {
        if deep > 0.0 {
            (stiffness * deep, stiffness)
        } else {
            (0.0, stiffness)
        }
    }
}

/// The light bench device: 0.1 kg a stage, no Coulomb friction.
pub fn device(counts_per_m: f64) -> DeviceDescription {
    let joint = Joint {
        counts_per_unit: counts_per_m as f32,
        zero_counts: 0,
        effort_per_amp: 3.75,
        max_current_a: 4.0,
        max_slew_per_s: 2000.0,
        max_speed_per_s: 2.0,
        inertia: MASS as f32,
        damping: DAMPING as f32,
        coulomb: 0.0,
    };
    DeviceDescription {
        name: [0; 16],
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [joint; JOINTS],
        gravity_mass_kg: [0.0; JOINTS],
        max_force_n: 10.0,
        max_power_w: 10.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
}

/// Mass of a stage \[kg\], and its damping \[N s/m\].
pub const MASS: f64 = 0.1;
/// See [`MASS`].
pub const DAMPING: f64 = 0.5;

/// From `from` to `to` with the least jerk within a time, 0 to 1 of it.
pub fn ramp(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

/// Runs a scene: one entry a millisecond.
pub fn feel(scene: &Scene) -> Vec<Tick> {
    let mut control = Control::tuned(device(scene.counts_per_m), scene.tuning).unwrap();
    control.command(Command::Arm);
    let path = scene.path;
    let truth = |z: f64, t: f64| (scene.law)((scene.surface)(t) - z);
    let (mut z, mut v) = (path(0.0), 0.0);
    let (mut commanded, mut motors) = (0.0, 0.0);
    let (mut energy, mut true_energy) = (0.0, 0.0);
    let mut on_the_way: Vec<(f64, u64, Contact, Option<Thread>)> = Vec::new();
    let mut solves = 0.0;
    let count = (scene.seconds * 1e3) as u32;
    let mut ticks: Vec<Tick> = Vec::with_capacity(count as usize);
    for ms in 1..=count {
        let now_s = 1e-3 * f64::from(ms);
        let counts = ((z + scene.offset_m) * scene.counts_per_m).floor() as i32;
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: [0, 0, counts],
            ..TickInput::default()
        };
        let arrived = on_the_way.extract_if(.., |(at, ..)| *at <= now_s + 1e-9);
        let arrived = arrived.last().map(|(_, time_us, contact, held)| {
            if let Some(held) = held {
                control.thread(&thread_frame(2 * ms, time_us, held));
            }
            frame(2 * ms + 1, time_us, contact).into()
        });
        let state = control.tick(&input, arrived.as_ref()).state;
        assert_eq!(state.faults, 0, "at {ms} ms");
        if (solves + scene.phase) / scene.host_hz < now_s + 1e-3 - 1e-9 {
            let sent_s = f64::max((solves + scene.phase) / scene.host_hz, now_s);
            solves += 1.0;
            let at = f64::from(state.position_m[2]);
            let (force, stiffness) = truth(at, now_s);
            let stiffness = stiffness * scene.tangent;
            let gap = f64::max(at - (scene.surface)(now_s), 0.0);
            let arrives_s = sent_s + scene.delay_s;
            let is_lost = |(from, until): &(f64, f64)| (*from..*until).contains(&arrives_s);
            let mut contact = Contact {
                horizon_us: scene.horizon_us,
                ..wall(0.0, state.position_m)
            };
            contact.gap_m = gap as f32;
            contact.wrench[2] = force as f32;
            let mut held = None;
            if scene.is_thread {
                // Threads have no gap: they pull, or are slack by so much.
                contact.gap_m = 1.0;
                let pulls = force > 0.0;
                contact.tangent[11] = if pulls { -stiffness as f32 } else { 0.0 };
                held = Some(Thread {
                    state: if pulls { Tension::Taut } else { Tension::Slack },
                    direction: [0.0, 0.0, 1.0],
                    tension_n: force as f32,
                    stiffness_n_per_m: stiffness as f32,
                    slack_m: if pulls { 0.0 } else { gap as f32 },
                    ..thread()
                });
            } else {
                contact.tangent[11] = -stiffness as f32;
            }
            if !scene.lost.iter().any(is_lost) {
                on_the_way.push((arrives_s, input.now_us, contact, held));
            }
        }
        let acting = core::mem::replace(&mut commanded, f64::from(state.force_n[2]));
        let (z_read, v_read) = (z, v);
        let (here, _) = truth(z, now_s);
        let mut mean = 0.0;
        for step in 0..STEPS {
            let t = now_s + f64::from(step) * STEP_S;
            let goal = acting * scene.torque;
            motors = if scene.lag_s > 0.0 {
                goal + (motors - goal) * (-STEP_S / scene.lag_s).exp()
            } else {
                goal
            };
            let tissue = truth(z, t).0;
            mean += tissue / f64::from(STEPS);
            let before = z;
            match scene.hand {
                Hand::Rigid => {
                    v = (path(t + STEP_S) - path(t)) / STEP_S;
                    z = path(t + STEP_S);
                }
                Hand::Spring(stiffness, damping) => {
                    let pace = (path(t + STEP_S) - path(t)) / STEP_S;
                    let hand = stiffness * (path(t) - z) + damping * (pace - v);
                    v += STEP_S * (motors + hand - DAMPING * v) / MASS;
                    z += STEP_S * v;
                }
                Hand::Mass(mass, push) => {
                    let push = push * ramp(t / 0.5);
                    v += STEP_S * (motors + push - DAMPING * v) / (MASS + mass);
                    z += STEP_S * v;
                }
            }
            energy -= motors * (z - before);
            true_energy -= tissue * (z - before);
        }
        if let Some(last) = ticks.last_mut() {
            // The command of the tick before acts in this one.
            last.meant = mean;
        }
        ticks.push(Tick {
            z: z_read,
            v: v_read,
            force: commanded,
            truth: here,
            meant: here,
            energy,
            true_energy,
            withheld: state.inputs & inputs::WITHHELD != 0,
            mode: state.mode,
        });
    }
    ticks
}

/// How far the force is off in these ticks, as parts of the largest true force: RMS and peak.
pub fn errors(ticks: &[Tick]) -> (f64, f64) {
    let largest = ticks.iter().map(|t| t.meant.abs()).fold(0.0, f64::max);
    let off = |t: &Tick| (t.force - t.meant) / largest;
    let square: f64 = ticks.iter().map(|t| off(t).powi(2)).sum();
    let peak = ticks.iter().map(|t| off(t).abs()).fold(0.0, f64::max);
    ((square / ticks.len() as f64).sqrt(), peak)
}

/// Part of the contact in which the force is off by more than a finger notices: 10 % and 30 mN.
pub fn beyond_notice(ticks: &[Tick]) -> f64 {
    let touches = |t: &&Tick| t.meant > 0.0 || t.force > 0.0;
    let is_off = |t: &&Tick| (t.force - t.meant).abs() > 0.1 * t.meant.abs() + 0.03;
    let contact = ticks.iter().filter(touches).count();
    ticks.iter().filter(touches).filter(is_off).count() as f64 / contact.max(1) as f64
}

/// Part of these ticks in which force was withheld.
pub fn withheld(ticks: &[Tick]) -> f64 {
    ticks.iter().filter(|t| t.withheld).count() as f64 / ticks.len() as f64
}

/// Most that the motors give in `window` ticks beyond what true tissue gives on the same way \[J\].
pub fn given_back(ticks: &[Tick], window: usize, torque: f64) -> f64 {
    let beyond: Vec<f64> = ticks
        .iter()
        .map(|t| torque * t.true_energy - t.energy)
        .collect();
    let mut most: f64 = 0.0;
    for (end, now) in beyond.iter().enumerate() {
        let start = end.saturating_sub(window);
        let least = beyond[start..=end]
            .iter()
            .fold(f64::INFINITY, |a, b| a.min(*b));
        most = most.max(now - least);
    }
    most
}
