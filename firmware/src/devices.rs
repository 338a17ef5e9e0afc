//! Consoles that images without a hardware of their own start as; the host may send another one.

use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics};

/// The console of `devices/cartesian-bench.toml`: three orthogonal stages.
pub const CARTESIAN_BENCH: DeviceDescription = {
    const fn stage(inertia: f32, damping: f32, coulomb: f32) -> Joint {
        Joint {
            counts_per_unit: 81_487.0,
            zero_counts: 0,
            effort_per_amp: 3.75,
            max_current_a: 4.0,
            max_slew_per_s: 2000.0,
            max_speed_per_s: 2.0,
            inertia,
            damping,
            coulomb,
        }
    }
    DeviceDescription {
        name: *b"cartesian-bench\0",
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [
            stage(0.45, 1.5, 0.25),
            stage(0.35, 1.2, 0.2),
            stage(0.25, 1.0, 0.15),
        ],
        gravity_mass_kg: [0.0, 0.0, 0.25],
        max_force_n: 10.0,
        max_power_w: 10.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
};

/// Three orthogonal axes with capstan drives, under a name: what hangs on a board with motors until it has a description of its own.
/// Encoders count from where the console stood at power-up, which is taken as the origin.
pub const fn capstan_stages(name: [u8; 16]) -> DeviceDescription {
    let axis = Joint {
        counts_per_unit: 200_000.0,
        zero_counts: 0,
        effort_per_amp: 4.0,
        max_current_a: 3.0,
        max_slew_per_s: 4_000.0,
        max_speed_per_s: 2.0,
        inertia: 0.12,
        damping: 0.5,
        coulomb: 0.2,
    };
    DeviceDescription {
        name,
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [axis; JOINTS],
        gravity_mass_kg: [0.0; JOINTS],
        max_force_n: 8.0,
        max_power_w: 8.0,
        max_grip_speed_m_per_s: 1.5,
        // 1 ms for the winding, 0.4 ms for pulse and amplifier.
        actuation_delay_us: 1400,
    }
}

/// A serial arm like that of `devices/serial-arm.toml`, for counting what its kinematics cost.
pub const SERIAL_ARM: DeviceDescription = {
    let joint = Joint {
        counts_per_unit: 12_732.0,
        zero_counts: 0,
        effort_per_amp: 0.30,
        max_current_a: 3.0,
        max_slew_per_s: 300.0,
        max_speed_per_s: 12.0,
        inertia: 0.006,
        damping: 0.010,
        coulomb: 0.012,
    };
    DeviceDescription {
        name: *b"serial-arm\0\0\0\0\0\0",
        kinematics: Kinematics::SerialArm {
            shoulder_m: [-0.30, 0.0, 0.12],
            upper_m: 0.22,
            fore_m: 0.22,
        },
        joints: [joint; JOINTS],
        gravity_mass_kg: [0.0, 0.06, 0.04],
        max_force_n: 2.3,
        max_power_w: 3.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
};
