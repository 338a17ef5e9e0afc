//! The order of register writes that takes the torque off the motors.
//!
//! Entry point: [`safe_state`], called first on every fault path. It only writes, so that it works from any
//! context and may run twice; each write alone already moves towards no torque. Orderly stops, and starts, are the driver's:
//! [`crate::drivers::amplifier`].

use sutura_shared::mutant::stands;

/// Motors driven by TIM8.
pub const MOTORS: usize = 3;

/// A register of an STM32F4's timers that decides about torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Register {
    /// First capture/compare mode register of TIM1: the output of channel 1, which is the amplifiers' enable line.
    EnableMode,
    /// Capture/compare register of TIM8 for a motor, from 0.
    Compare(usize),
}

/// Writes a torque register.
pub trait TorqueRegisters {
    /// Writes a whole register.
    fn write(&mut self, register: Register, value: u32);
}

/// Channel 1 forced to its inactive level, which is low: amplifiers off (RM0090, 17.4.7: OC1M = 100).
pub const ENABLE_OFF: u32 = 0b100 << 4;
/// Channel 1 forced to its active level, which is high while the timer's outputs are on: amplifiers on (OC1M = 101).
pub const ENABLE_ON: u32 = 0b101 << 4;

/// Takes the torque off: amplifiers disabled, then no current on every motor. `no_current`: that compare value.
///
/// Enable comes first, because it alone means no torque. The pulses go on: an amplifier's enable input may take 8 ms to act,
/// and a pulse train that ends meanwhile is a set point of 0 % duty.
pub fn safe_state(registers: &mut impl TorqueRegisters, no_current: u32) {
    if stands("enable_falls") {
        registers.write(Register::EnableMode, ENABLE_OFF);
    }
    if stands("no_current") {
        for motor in 0..MOTORS {
            registers.write(Register::Compare(motor), no_current);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const NONE: u32 = 21_000;

    /// Registers that behave like the timer as far as torque goes, and remember every write.
    #[derive(Default)]
    struct Mock {
        writes: Vec<(Register, u32)>,
        enable: bool,
        compare: [u32; MOTORS],
        /// A motor had current commanded while the amplifiers were enabled, after the first write.
        torque: bool,
    }

    impl TorqueRegisters for Mock {
        fn write(&mut self, register: Register, value: u32) {
            self.writes.push((register, value));
            match register {
                Register::EnableMode => {
                    self.enable = match value {
                        0x40 => false,
                        0x50 => true,
                        other => panic!("TIM1_CCMR1 = {other:#x}"),
                    };
                }
                Register::Compare(motor) => self.compare[motor] = value,
            }
            self.torque |= self.enable && self.compare != [NONE; MOTORS];
        }
    }

    #[test]
    fn enable_goes_first_then_the_commands() {
        let mut mock = Mock::default();
        safe_state(&mut mock, NONE);
        assert_eq!(
            mock.writes,
            [
                (Register::EnableMode, 0x40),
                (Register::Compare(0), NONE),
                (Register::Compare(1), NONE),
                (Register::Compare(2), NONE),
            ]
        );
    }

    #[test]
    fn torque_is_off_after_the_first_write_from_any_state() {
        for compare in [0, 4_200, NONE, 37_800, 42_000] {
            let mut mock = Mock {
                enable: true,
                compare: [compare; MOTORS],
                ..Mock::default()
            };
            safe_state(&mut mock, NONE);
            assert!(!mock.torque, "torque between the writes");
            assert!(!mock.enable);
            assert_eq!(mock.compare, [NONE; MOTORS]);
        }
    }

    /// Each of the two ways suffices when the other one does nothing.
    #[test]
    fn no_current_is_commanded_even_if_enable_stays_up() {
        struct Stuck(Mock);
        impl TorqueRegisters for Stuck {
            fn write(&mut self, register: Register, value: u32) {
                if register != Register::EnableMode {
                    self.0.write(register, value);
                }
            }
        }
        let mut stuck = Stuck(Mock {
            enable: true,
            compare: [37_800; MOTORS],
            ..Mock::default()
        });
        safe_state(&mut stuck, NONE);
        assert_eq!(stuck.0.compare, [NONE; MOTORS]);
    }

    #[test]
    fn safe_state_may_run_twice_and_before_anything_was_set_up() {
        let mut mock = Mock::default();
        safe_state(&mut mock, NONE);
        safe_state(&mut mock, NONE);
        assert!(!mock.enable && !mock.torque);
    }
}
