//! A NUCLEO-F446ZE with everything on it that there is a driver for: an example to copy from, in an image that only tests run.
//!
//! | pin | what | connector |
//! |---|---|---|
//! | PC10, PC11, PC12 | SPI3: clock, data in and out of joint 3's angle sensor (AS5047), in place of its encoder | CN8 6, 8, 10 |
//! | PD2 | its chip select | CN8 12 |
//! | PD7, PD6 | joint 1's lower and upper end stop, contacts to 3.3 V that are closed between them | CN9 2, 4 |
//! | PC3 | ADC2 channel 13: a motor's thermistor to ground, 10 kOhm to 3.3 V | CN9 5 (A2) |
//!
//! Its SPI waits for each byte: a unit of the chip that is dead holds the tick up until the watchdog resets the chip, and motors are off.
//!
//! A board whose own they are has this in its file, as `Sensors`, and hands in its pins. Pedals, buttons and an encoder's index are not among
//! them: version 1 of the protocol has nothing that would carry them.

use super::super::stm32f4::{Converter, Sampling, Sensed};
use crate::drivers::analog::Thermistor;
use crate::drivers::angle::AngleEncoder;
use crate::drivers::lines::{EndStops, Reached};
use cortex_m::asm;
use embedded_hal::spi::{ErrorType, MODE_1, Operation, SpiBus, SpiDevice};
use stm32f4xx_hal::gpio::{Input, Output, PC3, PC10, PC11, PC12, PD2, PD6, PD7};
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::spi::{self, Spi};
use stm32f4xx_hal::{pac, prelude::*};
use sutura_shared::device::JOINTS;

/// Most counts of the angle sensor in a tick: the axis' 2 m/s.
const MOST_COUNTS: u16 = 400;
/// From here on a motor is too hot \[degrees Celsius\].
const HOTTEST: f32 = 80.0;
/// Readings in a row that say so: one is noise.
const HOT_TICKS: u8 = 3;

/// What is on it.
pub struct Sensors {
    angle: AngleEncoder<Selected>,
    stops: EndStops<PD7<Input>, PD6<Input>>,
    motor: Thermistor<Converter<pac::ADC2>>,
    /// Ticks in a row.
    hot: u8,
}

impl Sensors {
    /// Takes pins. `bus`: SPI3, its clock, data in, data out, and the chip select; `stops`: lower, upper.
    pub fn wire(
        bus: (pac::SPI3, PC10, PC11, PC12, PD2),
        stops: (PD7, PD6),
        thermistor: PC3,
        rcc: &mut Rcc,
    ) -> Self {
        let (bus, clock, data_in, data_out, select) = bus;
        let pins = (Some(clock), Some(data_in), Some(data_out));
        let _pin = thermistor.into_analog();
        let bus = Selected {
            bus: Spi::new(bus, pins, MODE_1, 5.MHz(), rcc),
            select: select.into_push_pull_output_in_state(stm32f4xx_hal::gpio::PinState::High),
        };
        Sensors {
            angle: AngleEncoder::new(bus, MOST_COUNTS),
            stops: EndStops::new(
                stops.0.into_pull_down_input(),
                stops.1.into_pull_down_input(),
            ),
            motor: Thermistor::new(Converter::begin(rcc, 13, Sampling::Longest)),
            hot: 0,
        }
    }

    /// Once a tick, with what the timers have counted.
    pub fn tick(&mut self, counts: [i32; JOINTS]) -> Sensed {
        let [first, second, _] = counts;
        let angle = self.angle.tick();
        let cool = self.motor.tick().is_some_and(|celsius| celsius < HOTTEST);
        self.hot = if cool { 0 } else { self.hot.saturating_add(1) };
        let broken = self.stops.tick() == Reached::Broken;
        Sensed {
            counts: [first, second, angle.counts],
            unfit: angle.broken || broken || self.hot >= HOT_TICKS,
        }
    }
}

/// The bus with one device.
struct Selected {
    bus: Spi<pac::SPI3>,
    select: PD2<Output>,
}

/// Half a microsecond: 350 ns between chip select and clock, and between two frames (AS5047D data sheet, SPI timing).
fn pause() {
    asm::delay(84);
}

impl ErrorType for Selected {
    type Error = spi::Error;
}

impl SpiDevice for Selected {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), spi::Error> {
        self.select.set_low();
        pause();
        let done = operations
            .iter_mut()
            .try_for_each(|operation| match operation {
                Operation::Read(bytes) => SpiBus::read(&mut self.bus, bytes),
                Operation::Write(bytes) => SpiBus::write(&mut self.bus, bytes),
                Operation::Transfer(up, down) => SpiBus::transfer(&mut self.bus, up, down),
                Operation::TransferInPlace(bytes) => {
                    SpiBus::transfer_in_place(&mut self.bus, bytes)
                }
                Operation::DelayNs(ns) => {
                    asm::delay(*ns / 6 + 1);
                    Ok(())
                }
            });
        pause();
        self.select.set_high();
        pause();
        done
    }
}
