//! A board's pins as its self-test uses them, with jumpers and without amplifiers: see [`crate::selftest`].
//!
//! Entry point: [`BareRig::of`].

use super::stm32f4::{EnableLine, Outputs, Plant, cycles};
use super::wiring::DEVICE;
use crate::selftest::Rig;
use embedded_hal::digital::OutputPin;
use stm32f4xx_hal::pac;
use sutura_shared::control::{Control, TickInput};
use sutura_shared::wire::message::{Command, Contact};
use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, ValidContact};

/// Cycles that a level is held: three times as long as the encoders' input filter of eight samples at 84 MHz takes.
const HOLD: u32 = 48;
/// Reads of a pin after which it has not changed.
const PATIENCE: u32 = 1000;
/// Ticks whose cost is counted.
const TICKS: u32 = 8;

/// The pins. PC6 to PC8 are outputs from here on, and no pulses.
pub struct BareRig(());

impl BareRig {
    /// Takes the pulses' pins from the timer of a board that has been started. Before that the stop's line is told to be closed.
    pub fn of(_: &Plant) -> Self {
        let mut rig = BareRig(());
        rig.write(1 << 8 | 1 << 22 | 1 << 23);
        // SAFETY: the mode bits of three pins, which nobody else changes: outputs (RM0090, 8.4.1; RM0390, 7.4.1).
        unsafe {
            let port = &*pac::GPIOC::ptr();
            port.moder()
                .modify(|r, w| w.bits(r.bits() & !(0b11_1111 << 12) | 0b01_0101 << 12));
        }
        rig
    }

    /// Sets and resets levels of port C (RM0090, 8.4.7).
    fn write(&mut self, levels: u32) {
        // SAFETY: a whole-word write that changes nothing but what its bits name.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(levels)) };
        cortex_m::asm::delay(HOLD);
    }
}

/// A level bit of a pin, high or low.
fn level(pin: u32, high: bool) -> u32 {
    if high { 1 << pin } else { 1 << (16 + pin) }
}

impl Rig for BareRig {
    fn encoder_lines(&mut self, a: bool, b: bool) {
        self.write(level(6, a) | level(7, b));
    }

    fn close_stop(&mut self, closed: bool) {
        self.write(level(8, closed));
    }

    fn enable(&mut self, on: bool) {
        // Neither can refuse.
        let _ = if on {
            Outputs.set_high().and(EnableLine.set_high())
        } else {
            EnableLine.set_low().and(Outputs.set_low())
        };
        cortex_m::asm::delay(HOLD);
    }

    fn enable_is_high(&self) -> bool {
        // SAFETY: a read without side effects.
        unsafe { (*pac::GPIOC::ptr()).idr().read().idr9().bit_is_set() }
    }

    fn ready_is_high(&self) -> bool {
        // SAFETY: a read without side effects.
        unsafe { (*pac::GPIOB::ptr()).idr().read().idr9().bit_is_set() }
    }

    fn stop_is_closed(&self) -> bool {
        // SAFETY: a read without side effects.
        unsafe { (*pac::GPIOA::ptr()).idr().read().idr6().bit_is_set() }
    }

    fn cut(&mut self) -> Option<u32> {
        let start = cycles();
        // SAFETY: as in `write`, without its wait.
        unsafe {
            (*pac::GPIOC::ptr())
                .bsrr()
                .write(|w| w.bits(level(8, false)))
        };
        (0..PATIENCE).find(|_| !self.enable_is_high())?;
        Some(cycles().wrapping_sub(start))
    }

    fn cycles(&self) -> u32 {
        cycles()
    }

    /// Of the board's own console, touching, with a new frame in every tick.
    fn tick_cost(&mut self) -> u32 {
        let Ok(mut control) = Control::new(DEVICE) else {
            return 0;
        };
        control.command(Command::Arm);
        let mut most = 0;
        for sequence in 1..=TICKS {
            let input = TickInput {
                now_us: 1000 * u64::from(sequence),
                ..TickInput::default()
            };
            let header = Header {
                version: PROTOCOL_VERSION,
                kind: Kind::Contact,
                session: 1,
                sequence,
                console_time_us: input.now_us,
            };
            let Ok(contact) = ValidContact::new(header, touching()) else {
                return 0;
            };
            let fresh = contact.into();
            let start = cycles();
            let output = control.tick(&input, Some(&fresh));
            let end = cycles();
            core::hint::black_box(output);
            most = most.max(end.wrapping_sub(start));
        }
        most
    }
}

/// A floor of 1 kN/m, 1 mm deep.
fn touching() -> Contact {
    let mut tangent = [0.0; 21];
    tangent[11] = -1000.0;
    Contact {
        tool: 0,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        tangent,
        gap_m: 0.0,
        normal: [0.0, 0.0, 1.0],
        relaxation_per_s: 0.0,
        horizon_us: 100_000,
    }
}
