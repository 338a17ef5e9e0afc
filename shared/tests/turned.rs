//! The force does not depend on where the axes point: a device that is the same in all directions, and a scene that is turned
//! under it.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{arm, frame, no_contact};
use nalgebra::{Rotation3, Vector3};
use sutura_shared::control::{Control, Guards, TickInput, Tuning};
use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics};
use sutura_shared::wire::message::{Command, Contact};

type Vec = Vector3<f64>;
type Turn = Rotation3<f64>;

/// Fine encoders: a step is a hundredth of a micrometre.
const COUNTS_PER_M: f64 = 1e8;
/// Stiffness along the skin's normal \[N/m\], and of what holds the tool sideways.
const STIFFNESS: f64 = 1500.0;
const SIDEWAYS: f64 = 250.0;
/// Period of the host, and how late its frames are.
const PERIOD_MS: u32 = 17;

fn device() -> DeviceDescription {
    let joint = Joint {
        counts_per_unit: COUNTS_PER_M as f32,
        zero_counts: 0,
        effort_per_amp: 1.0,
        max_current_a: 40.0,
        max_slew_per_s: 8000.0,
        max_speed_per_s: 5.0,
        inertia: 0.1,
        damping: 0.5,
        coulomb: 0.0,
    };
    DeviceDescription {
        name: [0; 16],
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [joint; JOINTS],
        gravity_mass_kg: [0.0; JOINTS],
        max_force_n: 30.0,
        max_power_w: 30.0,
        max_grip_speed_m_per_s: 3.0,
        actuation_delay_us: 1000,
    }
}

/// Presses at 1 Hz from 2 mm above the skin to 6 mm into it, and meanwhile 4 mm to either side \[m\].
fn presses(time_s: f64) -> Vec {
    let phase = 2.0 * core::f64::consts::PI * time_s;
    let side = 4e-3 * (0.7 * phase).sin();
    Vec::new(side, 0.5 * side, 4e-3 * phase.cos() - 2e-3)
}

/// 5 mm deep, then to either side at 0.1 m/s.
fn strokes(time_s: f64) -> Vec {
    let deep = 2e-3 - 7e-3 * f64::min(time_s / 0.5, 1.0);
    let side = if time_s > 0.6 {
        10e-3 * (10.0 * (time_s - 0.6)).sin()
    } else {
        0.0
    };
    Vec::new(side, 0.0, deep)
}

/// Tissue under the plane z = 0, which `bonded` holds the tool sideways too, as solved with the grip at `place`, the scene
/// being turned by `turn`.
fn solved(turn: &Turn, bonded: bool, place: [f32; 3]) -> Contact {
    let own = turn.inverse() * Vec::from(place.map(f64::from));
    let normal = turn * Vec::z();
    let side = if bonded { SIDEWAYS } else { 0.0 };
    let stiffness = nalgebra::Matrix3::from_diagonal(&Vec::new(side, side, STIFFNESS));
    let tangent = -(turn.matrix() * stiffness * turn.matrix().transpose());
    let force = if own.z < 0.0 {
        turn * Vec::new(-side * own.x, -side * own.y, -STIFFNESS * own.z)
    } else {
        Vec::zeros()
    };
    let mut contact = Contact {
        position_m: place,
        gap_m: f64::max(own.z, 0.0) as f32,
        normal: normal.map(|x| x as f32).into(),
        ..no_contact()
    };
    let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    for (packed, (i, j)) in [0, 1, 2, 6, 7, 11].into_iter().zip(places) {
        contact.tangent[packed] = tangent[(i, j)] as f32;
    }
    for (wrench, force) in contact.wrench.iter_mut().zip(force.iter()) {
        *wrench = *force as f32;
    }
    contact
}

/// A hand that keeps to its path, in a scene that is turned.
struct Scene {
    path: fn(f64) -> Vec,
    bonded: bool,
    guards: Guards,
    /// Frames of this time are lost \[ms\].
    lost: core::ops::Range<u32>,
}

/// The force of every tick \[N\], turned back into the scene's own axes.
fn forces(scene: &Scene, turn: &Turn) -> std::vec::Vec<Vec> {
    let tuning = Tuning {
        guards: scene.guards,
        ..Tuning::default()
    };
    let mut control = Control::tuned(device(), tuning).unwrap();
    control.command(Command::Arm);
    let mut on_the_way: std::vec::Vec<(u32, u64, Contact)> = std::vec::Vec::new();
    let ticks = 1..=3000_u32;
    let felt = ticks.map(|ms| {
        let place = turn * (scene.path)(f64::from(ms) * 1e-3);
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: place.map(|x| (x * COUNTS_PER_M).round() as i32).into(),
            ..TickInput::default()
        };
        let arrived = on_the_way.extract_if(.., |(at, ..)| *at <= ms).last();
        let fresh = arrived.map(|(_, time_us, body)| frame(ms, time_us, body).into());
        let state = control.tick(&input, fresh.as_ref()).state;
        assert_eq!(state.faults, 0);
        if ms.is_multiple_of(PERIOD_MS) && !scene.lost.contains(&ms) {
            let contact = solved(turn, scene.bonded, state.position_m);
            on_the_way.push((ms + PERIOD_MS, input.now_us, contact));
        }
        turn.inverse() * Vec::from(state.force_n.map(f64::from))
    });
    felt.collect()
}

fn length(v: &Vec) -> f64 {
    v.dot(v).sqrt()
}

/// Largest difference of two courses of the force, and the largest force of the first \[N\].
fn apart(first: &[Vec], second: &[Vec]) -> (f64, f64) {
    let pairs = first.iter().zip(second);
    let off = pairs.map(|(a, b)| length(&(a - b))).fold(0.0, f64::max);
    (off, first.iter().map(length).fold(0.0, f64::max))
}

/// 45 degrees, z to (1, 1, 1), and seeded ones.
fn turns() -> std::vec::Vec<Turn> {
    let onto =
        |x: f64, y: f64, z: f64| Turn::rotation_between(&Vec::z(), &Vec::new(x, y, z)).unwrap();
    let mut seed = 18_u32;
    let mut any = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(seed >> 8) / f64::from(1 << 23) - 1.0
    };
    let mut turns = vec![onto(0.0, 1.0, 1.0), onto(1.0, 1.0, 1.0)];
    turns.extend((0..8).map(|_| Turn::from_scaled_axis(Vec::new(any(), any(), any()) * 3.0)));
    turns
}

/// Largest difference over all turns, as a part of the largest force.
fn worst(scene: &Scene) -> f64 {
    let straight = forces(scene, &Turn::identity());
    let parts = turns().into_iter().map(|turn| {
        let (off, largest) = apart(&straight, &forces(scene, &turn));
        off / largest
    });
    parts.fold(0.0, f64::max)
}

/// Whatever bounds the force, a tank that is short as well: with an outage, nothing but its own way pays for it.
#[test]
fn a_turned_scene_is_felt_turned() {
    for path in [presses as fn(f64) -> Vec, strokes] {
        for bonded in [false, true] {
            for lost in [0..0, 900..1200] {
                let scene = |guards| Scene {
                    path,
                    bonded,
                    guards,
                    lost: lost.clone(),
                };
                let found = worst(&scene(Guards::ALL));
                assert!(found < 1e-4, "bonded {bonded}, lost {lost:?}: {found}");
            }
        }
    }
    // Way and stiffness of the axes: a third of the force and more.
    let by_axes = worst(&Scene {
        path: presses,
        bonded: false,
        guards: Guards {
            along: false,
            ..Guards::ALL
        },
        lost: 0..0,
    });
    assert!(by_axes > 0.1, "{by_axes}");
}

/// An arm that is turned about its first joint together with the scene.
#[test]
fn a_device_that_is_turned_with_its_scene_feels_the_same() {
    let Kinematics::SerialArm {
        shoulder_m,
        upper_m,
        fore_m,
    } = arm().kinematics
    else {
        panic!("an arm");
    };
    let mut device = arm();
    for joint in &mut device.joints {
        joint.counts_per_unit = 1e7;
    }
    // The scene's origin is the shoulder's axis; the skin lies where the arm reaches with its elbow bent.
    let (shoulder, elbow) = (-0.5_f64, 1.1_f64);
    let felt = |yaw: f64| -> std::vec::Vec<Vec> {
        let mut control = Control::new(device).unwrap();
        control.command(Command::Arm);
        let turn = Turn::from_axis_angle(&Vec::z_axis(), yaw);
        let foot = Vec::from(shoulder_m.map(f64::from));
        let reach = |up: f64, down: f64| {
            let (a, b) = (f64::from(upper_m), f64::from(fore_m));
            Vec::new(
                a * up.cos() + b * (up + down).cos(),
                0.0,
                a * up.sin() + b * (up + down).sin(),
            )
        };
        let skin = reach(shoulder, elbow);
        let mut on_the_way: std::vec::Vec<(u32, u64, Contact)> = std::vec::Vec::new();
        let ticks = 1..=2000_u32;
        let felt = ticks.map(|ms| {
            let phase = 2e-3 * core::f64::consts::PI * f64::from(ms);
            // Some millimetres about that place, by all joints.
            let q = [
                yaw + 0.01 * (0.7 * phase).sin(),
                shoulder + 0.008 - 0.03 * (1.0 - phase.cos()),
                elbow - 0.01 * (1.0 - phase.cos()),
            ];
            let input = TickInput {
                now_us: u64::from(ms) * 1000,
                encoder_counts: q.map(|q| (q * 1e7).round() as i32),
                ..TickInput::default()
            };
            let arrived = on_the_way.extract_if(.., |(at, ..)| *at <= ms).last();
            let fresh = arrived.map(|(_, time_us, body)| frame(ms, time_us, body).into());
            let state = control.tick(&input, fresh.as_ref()).state;
            assert_eq!(state.faults, 0);
            if ms.is_multiple_of(PERIOD_MS) {
                let place = Vec::from(state.position_m.map(f64::from)) - foot - turn * skin;
                let mut contact = solved(&turn, true, place.map(|x| x as f32).into());
                for entry in contact.tangent.iter_mut().chain(&mut contact.wrench) {
                    *entry *= 0.2;
                }
                contact.position_m = state.position_m;
                on_the_way.push((ms + PERIOD_MS, input.now_us, contact));
            }
            turn.inverse() * Vec::from(state.force_n.map(f64::from))
        });
        felt.collect()
    };
    let straight = felt(0.0);
    for yaw in [0.4, -1.1, 2.5] {
        let (off, largest) = apart(&straight, &felt(yaw));
        assert!(
            largest > 0.5 && off < 1e-4 * largest,
            "{yaw}: {off} {largest}"
        );
    }
}
