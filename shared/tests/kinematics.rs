//! Kinematics against formulas in double precision and their central differences.

use crate::rig::{arm, bench};
use proptest::prelude::*;
use sutura_shared::device::{DeviceDescription, Kinematics};
use sutura_shared::kinematics::{GRAVITY, forward};
use sutura_shared::math::Vec3;

/// Elbow and grip of an arm, written down from the description of its joints: turn about z after two
/// rotations in the x-z plane.
fn elbow_and_grip(device: &DeviceDescription, q: [f64; 3]) -> [[f64; 3]; 2] {
    let Kinematics::SerialArm {
        shoulder_m,
        upper_m,
        fore_m,
    } = device.kinematics
    else {
        panic!("the test gives an arm");
    };
    let shoulder = shoulder_m.map(f64::from);
    let link = |from: [f64; 3], length: f32, pitch: f64| {
        let length = f64::from(length);
        [
            from[0] + length * pitch.cos() * q[0].cos(),
            from[1] + length * pitch.cos() * q[0].sin(),
            from[2] + length * pitch.sin(),
        ]
    };
    let elbow = link(shoulder, upper_m, q[1]);
    [elbow, link(elbow, fore_m, q[1] + q[2])]
}

/// Central difference by joint `i`; 1e-4 rad leaves an error of 1e-9 relative.
fn difference<const N: usize>(f: impl Fn([f64; 3]) -> [f64; N], q: [f64; 3], i: usize) -> [f64; N] {
    let step = 1e-4;
    let at = |sign: f64| {
        let mut moved = q;
        moved[i] += sign * step;
        f(moved)
    };
    let (ahead, behind) = (at(1.0), at(-1.0));
    core::array::from_fn(|k| (ahead[k] - behind[k]) / (2.0 * step))
}

fn close(found: [f32; 3], expected: [f64; 3], tolerance: f64) -> bool {
    let pairs = found.iter().zip(expected);
    pairs
        .into_iter()
        .all(|(found, expected)| (f64::from(*found) - expected).abs() <= tolerance)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_arm_agrees_with_double_precision(q in prop::array::uniform3(-7.0_f32..7.0)) {
        let device = arm();
        let wide = q.map(f64::from);
        let grip = |q| elbow_and_grip(&device, q)[1];
        let pose = forward(&device, &q);
        // Lengths of 0.44 m in single precision, and 9e-8 from each sine.
        prop_assert!(close(pose.position_m.into(), grip(wide), 2e-7));
        for (i, column) in pose.jacobian.iter().enumerate() {
            prop_assert!(close((*column).into(), difference(grip, wide, i), 2e-7));
        }
        let energy = |q| {
            let [elbow, grip] = elbow_and_grip(&device, q);
            let [_, elbow_kg, grip_kg] = device.gravity_mass_kg.map(f64::from);
            [f64::from(GRAVITY) * (elbow_kg * elbow[2] + grip_kg * grip[2])]
        };
        let gradient = core::array::from_fn(|i| difference(energy, wide, i)[0]);
        prop_assert!(close(pose.weight_effort, gradient, 5e-7));
    }

    #[test]
    fn effort_and_velocity_conserve_power(
        q in prop::array::uniform3(-3.0_f32..3.0),
        dq in prop::array::uniform3(-3.0_f32..3.0),
        force in prop::array::uniform3(-10.0_f32..10.0),
    ) {
        for device in [bench(), arm()] {
            let pose = forward(&device, &q);
            let force = Vec3::from(force);
            let at_grip = pose.velocity(&dq).dot(&force);
            let effort = pose.effort(&force);
            let at_joints: f32 = effort.iter().zip(dq).map(|(effort, dq)| effort * dq).sum();
            prop_assert!((at_grip - at_joints).abs() < 1e-4);
        }
    }
}

#[test]
fn a_stretched_arm_lies_along_x_and_pitches_up() {
    let device = arm();
    let [x, y, z]: [f32; 3] = forward(&device, &[0.0; 3]).position_m.into();
    // Shoulder at (-0.30, 0, 0.12) m, 0.44 m of links.
    assert!((x - 0.14).abs() < 1e-7 && y == 0.0 && (z - 0.12).abs() < 1e-7);
    let up = forward(&device, &[0.0, 0.5, 0.0]).position_m;
    assert!(up.z > 0.3, "{up}");
    let left = forward(&device, &[0.5, 0.0, 0.0]).position_m;
    assert!(left.y > 0.2, "{left}");
}

#[test]
fn a_cartesian_console_carries_what_its_z_stage_lifts() {
    let pose = forward(&bench(), &[0.25, -0.5, 0.125]);
    assert_eq!(pose.position_m, Vec3::new(0.25, -0.5, 0.125));
    assert_eq!(pose.weight_effort, [0.0, 0.0, 0.25 * GRAVITY]);
    assert_eq!(pose.effort(&Vec3::new(1.0, 2.0, 3.0)), [1.0, 2.0, 3.0]);
}
