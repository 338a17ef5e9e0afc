//! The order of register writes that takes the torque off the motors.
//!
//! Entry point: [`safe_state`], called first on every fault path. It only writes, so that it works from any
//! context and may run twice; each write alone already moves towards no torque.

/// Motors driven by TIM8.
pub const MOTORS: usize = 3;

/// A register of an STM32F4 that decides about torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Register {
    /// Bit set/reset register of the port with the amplifiers' enable pin.
    EnableSetReset,
    /// TIM8 break and dead-time register.
    BreakDeadTime,
    /// TIM8 capture/compare register of a motor, from 0.
    Compare(usize),
}

/// Writes a torque register.
pub trait TorqueRegisters {
    /// Writes a whole register.
    fn write(&mut self, register: Register, value: u32);
}

/// What is written where; fixed when the board is laid out.
#[derive(Clone, Copy, Debug)]
pub struct TorqueLayout {
    /// Number of the enable pin in its port; high = amplifiers on.
    pub enable_pin: u8,
    /// TIM8 break and dead-time register while running, without the main output enable.
    pub break_dead_time: u32,
    /// Compare value for no current.
    pub zero_compare: u32,
}

/// Main output enable bit of the break and dead-time register.
pub const MAIN_OUTPUT_ENABLE: u32 = 1 << 15;

/// Takes the torque off: amplifiers disabled, then the timer's outputs, then zero current on every motor.
///
/// The enable pin comes first, because it alone means no torque: to an amplifier that takes 10 to 90 % duty
/// a pulse train that stops is a command out of range, and 0 % may be full current backwards.
pub fn safe_state(registers: &mut impl TorqueRegisters, layout: &TorqueLayout) {
    registers.write(Register::EnableSetReset, 1 << (16 + layout.enable_pin));
    registers.write(
        Register::BreakDeadTime,
        layout.break_dead_time & !MAIN_OUTPUT_ENABLE,
    );
    for motor in 0..MOTORS {
        registers.write(Register::Compare(motor), layout.zero_compare);
    }
}

/// Puts torque on: the exact reverse order, so that an amplifier wakes up to a pulse train for zero current.
pub fn torque_on(registers: &mut impl TorqueRegisters, layout: &TorqueLayout) {
    for motor in 0..MOTORS {
        registers.write(Register::Compare(motor), layout.zero_compare);
    }
    registers.write(
        Register::BreakDeadTime,
        layout.break_dead_time | MAIN_OUTPUT_ENABLE,
    );
    registers.write(Register::EnableSetReset, 1 << layout.enable_pin);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const LAYOUT: TorqueLayout = TorqueLayout {
        enable_pin: 12,
        break_dead_time: 0x1C00,
        zero_compare: 4200,
    };

    /// Registers that behave like the timer and port as far as torque goes, and remember every write.
    #[derive(Default)]
    struct Mock {
        writes: Vec<(Register, u32)>,
        enable: bool,
        main_output: bool,
        compare: [u32; MOTORS],
        /// A motor had current commanded, or the pulses were off, while the amplifiers were enabled.
        enabled_without_zero: bool,
    }

    impl TorqueRegisters for Mock {
        fn write(&mut self, register: Register, value: u32) {
            self.writes.push((register, value));
            match register {
                Register::EnableSetReset => {
                    // Reference manual RM0090, 8.4.7: set wins over reset.
                    let pin = u32::from(LAYOUT.enable_pin);
                    if value >> pin & 1 == 1 {
                        self.enable = true;
                    } else if value >> (16 + pin) & 1 == 1 {
                        self.enable = false;
                    }
                }
                Register::BreakDeadTime => self.main_output = value & MAIN_OUTPUT_ENABLE != 0,
                Register::Compare(motor) => self.compare[motor] = value,
            }
            let zero = self.main_output && self.compare == [LAYOUT.zero_compare; MOTORS];
            self.enabled_without_zero |= self.enable && !zero;
        }
    }

    #[test]
    fn the_enable_pin_goes_first_then_the_outputs_then_the_commands() {
        let mut mock = Mock::default();
        safe_state(&mut mock, &LAYOUT);
        assert_eq!(
            mock.writes,
            [
                (Register::EnableSetReset, 1 << 28),
                (Register::BreakDeadTime, 0x1C00),
                (Register::Compare(0), 4200),
                (Register::Compare(1), 4200),
                (Register::Compare(2), 4200),
            ]
        );
    }

    #[test]
    fn torque_is_off_after_the_first_write_from_any_state() {
        for main_output in [false, true] {
            for compare in [0, 840, 4200, 7560, 8400] {
                let mut mock = Mock {
                    enable: true,
                    main_output,
                    compare: [compare; MOTORS],
                    ..Mock::default()
                };
                safe_state(&mut mock, &LAYOUT);
                assert!(!mock.enabled_without_zero, "torque between the writes");
                assert!(!mock.enable && !mock.main_output);
                assert_eq!(mock.compare, [4200; MOTORS]);
            }
        }
    }

    #[test]
    fn safe_state_may_run_twice_and_before_anything_was_set_up() {
        let mut mock = Mock::default();
        safe_state(&mut mock, &LAYOUT);
        safe_state(&mut mock, &LAYOUT);
        assert!(!mock.enable && !mock.main_output && !mock.enabled_without_zero);
    }

    #[test]
    fn amplifiers_wake_up_to_zero_current() {
        let mut mock = Mock {
            compare: [840, 4200, 7560],
            ..Mock::default()
        };
        torque_on(&mut mock, &LAYOUT);
        assert!(mock.enable && mock.main_output && !mock.enabled_without_zero);
    }
}
