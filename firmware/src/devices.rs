//! The console with motors that images are built for, and those that images without a hardware of their own start as.
//!
//! Entry point: [`CONSOLE`].

use crate::drivers::analog::MotorSupply;
use crate::signals::SetPoint;
use sutura_shared::device::{DeviceDescription, DeviceError, JOINTS, Joint, Kinematics};

/// The console of `devices/cartesian-bench.toml`: three orthogonal stages. The host may send another one in its place.
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

/// A console with motors: all that an image has to know of it, and no board. The device file of a session has its first part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Console {
    /// Kinematics, encoders, motors and limits, as the host knows them, too.
    pub device: DeviceDescription,
    /// How its amplifiers read what the motors are to do.
    pub set_point: SetPoint,
    /// Its motors' supply, where a divider brings it to the board. None: nobody looks at it.
    pub motor_supply: Option<MotorSupply>,
}

impl Console {
    /// The same under a name of at most 16 bytes: what is beyond them is left out.
    pub const fn named(mut self, name: &str) -> Console {
        self.device.name = [0; 16];
        let (bytes, mut at) = (name.as_bytes(), 0);
        while at < bytes.len() && at < self.device.name.len() {
            self.device.name[at] = bytes[at];
            at += 1;
        }
        self
    }

    /// Checks what amplifiers and motors have to do with each other. Boards ask at compile time.
    ///
    /// # Errors
    /// [`DeviceError`] names the first field that is not as it must be.
    pub const fn check(&self) -> Result<(), DeviceError> {
        if let Err(error) = self.set_point.check() {
            return Err(error);
        }
        let mut joint = 0;
        while joint < JOINTS {
            // What the amplifier clamps the console would take for given.
            if self.device.joints[joint].max_current_a > self.set_point.full_scale_a {
                return Err(DeviceError {
                    joint: Some(joint as u8),
                    field: "max_current_a",
                    rule: "at most the amplifier's full scale",
                });
            }
            joint += 1;
        }
        if self.device.actuation_delay_us < self.set_point.delay_us() {
            return Err(DeviceError {
                joint: None,
                field: "actuation_delay_us",
                rule: "at least as long as a set point is on its way",
            });
        }
        Ok(())
    }
}

/// **The console that hangs on a board with motors, under the board's name: put yours here**, and its first part into
/// `devices/BOARD.toml`. Three orthogonal axes with capstan drives; encoders count from where the console stood at power-up, which
/// is taken as the origin. With 100 and 10 kOhm a supply of 24 V is `MotorSupply { full_scale_v: 36.3, limits_v: [20.0, 22.0, 28.0] }`.
pub const CONSOLE: Console = {
    let set_point = SetPoint::escon(5.0);
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
    Console {
        device: DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [axis; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 8.0,
            max_power_w: 8.0,
            max_grip_speed_m_per_s: 1.5,
            // 1 ms for the winding, 0.025 for the amplifier's own control.
            actuation_delay_us: 1025 + set_point.delay_us(),
        },
        set_point,
        motor_supply: None,
    }
};

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_console_is_one_and_goes_with_its_amplifiers() {
        let console = CONSOLE.named("olimex-h405");
        assert_eq!(console.device.name, *b"olimex-h405\0\0\0\0\0");
        assert_eq!(console.check(), Ok(()));
        assert_eq!(console.device.validate(), Ok(()));
        assert_eq!(
            CONSOLE.named("a-name-that-is-too-long").device.name,
            *b"a-name-that-is-t"
        );
    }

    /// As the amplifier would clamp what is commanded, or act later than the ledger of energy believes.
    #[test]
    fn amplifiers_and_motors_that_do_not_go_together_are_refused() {
        let mut weak = CONSOLE;
        weak.set_point.full_scale_a = 2.9;
        let error = weak.check().expect_err("3 A of 2.9");
        assert_eq!((error.joint, error.field), (Some(0), "max_current_a"));
        let mut slow = CONSOLE;
        slow.set_point = slow.set_point.at(1000);
        let error = slow.check().expect_err("1.5 ms of pulses in 1.4 ms");
        assert_eq!(error.field, "actuation_delay_us");
        slow.device.actuation_delay_us = 2525;
        assert_eq!(slow.check(), Ok(()));
        let mut odd = CONSOLE;
        odd.set_point.backwards = 0.0;
        assert_eq!(odd.check().expect_err("0 %").field, "backwards");
    }
}
