//! The simulated mechanics against laws that they must obey.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{arm, bench, hand};
use sutura_shared::device::DeviceDescription;
use sutura_shared::kinematics::{GRAVITY, forward};
use sutura_shared::math::Vec3;
use sutura_shared::virtual_console::{VirtualDevice, path};

const TICK_US: u32 = 1000;
const OFF: [f32; 3] = [0.0; 3];

/// Off its stand, with a hand that does nothing.
fn free(device: &DeviceDescription) -> VirtualDevice {
    let mut virtual_device = VirtualDevice::new(device);
    virtual_device.set_hand(&hand(0.0, 0.0, &[(0.0, [0.0; 3])]));
    virtual_device
}

fn without_delay(mut device: DeviceDescription) -> DeviceDescription {
    device.actuation_delay_us = 0;
    device
}

fn without_gravity(mut device: DeviceDescription) -> DeviceDescription {
    device.gravity_mass_kg = [0.0; 3];
    device
}

fn without_friction(mut device: DeviceDescription) -> DeviceDescription {
    for joint in &mut device.joints {
        (joint.damping, joint.coulomb) = (0.0, 0.0);
    }
    device
}

/// Kinetic energy of the joints and potential energy of the masses \[J\].
fn energy(device: &DeviceDescription, virtual_device: &VirtualDevice) -> f64 {
    let (q, dq) = virtual_device.joints();
    let joints = device.joints.iter().zip(dq);
    let kinetic: f64 = joints
        .map(|(joint, dq)| 0.5 * f64::from(joint.inertia) * f64::from(dq).powi(2))
        .sum();
    let [_, second, third] = device.gravity_mass_kg.map(f64::from);
    let [_, shoulder, elbow] = q.map(f64::from);
    let g = f64::from(GRAVITY);
    let potential = match device.kinematics {
        sutura_shared::device::Kinematics::Cartesian { .. } => third * g * elbow,
        sutura_shared::device::Kinematics::SerialArm {
            upper_m, fore_m, ..
        } => {
            let elbow_height = f64::from(upper_m) * shoulder.sin();
            let grip_height = elbow_height + f64::from(fore_m) * (shoulder + elbow).sin();
            g * (second * elbow_height + third * grip_height)
        }
    };
    kinetic + potential
}

#[test]
fn without_a_hand_it_stays_on_its_stand() {
    let mut device = VirtualDevice::new(&bench());
    device.advance(&[1.0, 1.0, 1.0], true, TICK_US);
    assert_eq!(device.joints(), ([0.0; 3], [0.0; 3]));
}

#[test]
fn motors_put_in_the_energy_that_comes_out() {
    for device in [bench(), arm()].map(without_delay) {
        let mut moving = free(&device);
        let start = energy(&device, &moving);
        let (mut work, mut last) = (0.0, start);
        let drive: [f32; 3] = [0.5, -0.3, 0.9];
        for tick in 0..400 {
            let on = tick < 100;
            let before = moving.joints().0;
            moving.advance(&drive, on, TICK_US);
            let after = moving.joints().0;
            for i in 0..3 {
                let effort = if on {
                    drive[i] * device.joints[i].effort_per_amp
                } else {
                    0.0
                };
                work += f64::from(effort) * (f64::from(after[i]) - f64::from(before[i]));
            }
            let now = energy(&device, &moving);
            // The weight does not change along a step of 1/8 ms as the step takes it: 1e-6 J.
            assert!(now <= start + work + 2e-6, "{tick}: {now} {work}");
            assert!(on || now <= last + 1e-6, "{tick}: energy came from nowhere");
            last = now;
        }
        assert!(work > 0.01, "{work}");
    }
}

/// The only losses that the integration itself makes: an arm that swings without friction keeps its
/// energy to 1 % over 5 s.
#[test]
fn a_swing_without_friction_keeps_its_energy() {
    let device = without_friction(arm());
    let mut swinging = free(&device);
    let start = energy(&device, &swinging);
    swinging.place(&[0.0, -1.0, -0.5]);
    let placed = energy(&device, &swinging);
    for tick in 0..5000 {
        swinging.advance(&OFF, false, TICK_US);
        let now = energy(&device, &swinging);
        assert!(
            (now - placed).abs() < 0.01 * (start - placed),
            "{tick}: {now} {placed}"
        );
    }
    let (_, dq) = swinging.joints();
    assert!(dq.iter().any(|dq| dq.abs() > 0.1), "{dq:?}");
}

/// Coulomb friction of 0.25 N on x: what is below holds for ever, what is above accelerates by the rest.
#[test]
fn friction_sticks_below_its_limit_and_slips_above() {
    let device = without_delay(without_gravity(bench()));
    let mut sticking = free(&device);
    for _ in 0..1000 {
        sticking.advance(&[0.249 / 3.75, 0.0, 0.0], true, TICK_US);
    }
    assert_eq!(sticking.joints(), ([0.0; 3], [0.0; 3]));
    for _ in 0..20 {
        sticking.advance(&[0.35 / 3.75, 0.0, 0.0], true, TICK_US);
    }
    // 0.1 N on 0.45 kg for 20 ms; damping of 1.5 N s/m takes 3 % of it.
    let speed = sticking.joints().1[0];
    assert!(
        (speed / (0.1 / 0.45 * 0.020) - 0.97).abs() < 0.01,
        "{speed}"
    );
    // Without the push it comes to rest for good.
    for _ in 0..200 {
        sticking.advance(&OFF, true, TICK_US);
    }
    assert_eq!(sticking.joints().1, [0.0; 3]);
}

#[test]
fn a_steady_push_ends_at_the_speed_that_damping_allows() {
    let device = without_gravity(bench());
    let mut pushed = free(&device);
    for _ in 0..3000 {
        pushed.advance(&[2.0 / 3.75, 0.0, 0.0], true, TICK_US);
    }
    // (2 N - 0.25 N) / 1.5 N s/m
    let speed = pushed.joints().1[0];
    assert!((speed - 1.75 / 1.5).abs() < 1e-3, "{speed}");
}

/// A mass on the hand's spring: 2 pi sqrt(m / k).
#[test]
fn a_mass_on_a_spring_swings_at_its_frequency() {
    let device = without_friction(without_gravity(bench()));
    let mut swinging = VirtualDevice::new(&device);
    swinging.set_hand(&hand(1000.0, 0.0, &[(0.0, [0.0; 3])]));
    swinging.place(&[0.01, 0.0, 0.0]);
    let mut crossings = Vec::new();
    let mut before = 0.01;
    for tick in 0..2000 {
        swinging.advance(&OFF, false, TICK_US);
        let now = swinging.joints().0[0];
        if before > 0.0 && now <= 0.0 {
            crossings.push(tick as f32 + before / (before - now));
        }
        before = now;
    }
    let (first, last) = (crossings[0], crossings[crossings.len() - 1]);
    let period_ms = (last - first) / (crossings.len() - 1) as f32;
    let expected = 2e3 * core::f64::consts::PI * (0.45_f64 / 1000.0).sqrt();
    assert!(
        (f64::from(period_ms) / expected - 1.0).abs() < 2e-3,
        "{period_ms} {expected}"
    );
}

#[test]
fn at_rest_the_hand_balances_weight_and_motors_to_friction() {
    for (device, target) in [(bench(), [0.01, -0.02, 0.03]), (arm(), [0.1, 0.05, 0.15])] {
        let mut held = VirtualDevice::new(&device);
        held.set_hand(&hand(800.0, 20.0, &[(0.0, target)]));
        held.place(&[0.05, 0.1, -0.2]);
        let current = [0.1, -0.2, 0.3];
        for _ in 0..3000 {
            held.advance(&current, true, TICK_US);
        }
        let (q, dq) = held.joints();
        assert!(dq.iter().all(|dq| dq.abs() < 1e-4), "{dq:?}");
        let pose = forward(&device, &q);
        let by_hand = pose.effort(&held.hand_force());
        for i in 0..3 {
            let joint = &device.joints[i];
            let rest = by_hand[i] + current[i] * joint.effort_per_amp - pose.weight_effort[i];
            assert!(rest.abs() <= joint.coulomb * 1.01, "{i}: {rest}");
        }
    }
}

/// The stiffest hand that the wire allows, on the lightest joints: no swing grows.
#[test]
fn any_hand_is_stable() {
    let mut light = without_friction(bench());
    for joint in &mut light.joints {
        joint.inertia = 1e-4;
    }
    for device in [without_friction(bench()), light, without_friction(arm())] {
        for (stiffness, damping) in [(1e5, 0.0), (0.0, 1e4), (1e5, 1e4), (1e5, 1.0)] {
            let mut held = VirtualDevice::new(&device);
            held.place(&[0.0, 0.5, -1.0]);
            let target: [f32; 3] = held.position().into();
            held.place(&[0.02, 0.52, -1.03]);
            held.set_hand(&hand(stiffness, damping, &[(0.0, target)]));
            for _ in 0..2000 {
                held.advance(&OFF, false, TICK_US);
                let distance = held.position() - Vec3::from(target);
                // Without a spring it falls, slowly, through the damping alone.
                assert!(
                    distance.iter().all(|x| x.abs() < 0.05),
                    "{stiffness} {damping}: {distance}"
                );
            }
        }
    }
}

#[test]
fn encoders_count_whole_steps_down_from_zero_and_wrap() {
    let mut description = bench();
    description.joints[1].counts_per_unit = -1000.0;
    description.joints[2].zero_counts = i32::MAX;
    let mut device = VirtualDevice::new(&description);
    device.place(&[-0.5 / 81_487.0, 0.0025, 1.5 / 81_487.0]);
    assert_eq!(device.encoder_counts(), [-1, -3, i32::MIN]);
    device.set_encoder_offset([10, -10, -1]);
    assert_eq!(device.encoder_counts(), [9, -13, i32::MAX]);
}

/// Position without steps, velocity as its derivative, rest at every way point, the last one held.
#[test]
fn a_path_is_smooth_and_rests_at_its_way_points() {
    let script = hand(
        1.0,
        1.0,
        &[
            (0.1, [0.0; 3]),
            (0.4, [0.03, 0.0, -0.02]),
            (0.4, [0.03, 0.0, -0.02]),
            (1.0, [0.0, 0.01, 0.0]),
        ],
    );
    // Peak speed of minimum jerk: 15/8 of the mean (Flash and Hogan 1985); 0.03 m in 0.3 s is the fastest.
    let fastest = 15.0 / 8.0 * 0.1;
    let step_us = 250;
    let mut peak = 0.0_f32;
    for time_us in (0..1_200_000).step_by(step_us as usize) {
        let ((here, speed), (ahead, next)) =
            (path(&script, time_us), path(&script, time_us + step_us));
        let mean = (ahead - here) / (step_us as f32 * 1e-6);
        // Positions are rounded to 2e-9 m; the speed changes by at most 60/sqrt(108) * 0.03 m / (0.3 s)^2.
        assert!(
            largest(&(mean - (speed + next) * 0.5)) < 1e-3,
            "{time_us} us: {mean} {speed}"
        );
        assert!(
            largest(&(next - speed)) < 2.0 * step_us as f32 * 1e-6,
            "{time_us} us"
        );
        for x in speed.iter() {
            peak = if x.abs() > peak { x.abs() } else { peak };
        }
    }
    assert!((peak - fastest).abs() < 1e-3 * fastest, "{peak}");
    for (time_us, place) in [(0, 0.0), (100_000, 0.0), (400_000, 0.03), (5_000_000, 0.0)] {
        let (position, speed) = path(&script, time_us);
        assert!(
            (position.x - place).abs() < 1e-9 && largest(&speed) < 1e-6,
            "{time_us} us"
        );
    }
}

fn largest(v: &Vec3) -> f32 {
    v.iter()
        .fold(0.0, |most, x| sutura_shared::math::max(x.abs(), most))
}
