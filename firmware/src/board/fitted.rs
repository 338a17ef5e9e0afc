//! A NUCLEO-F446ZE with everything on it that there is a driver for: an example to copy from, in an image that only tests run.
//!
//! | pin | what | connector |
//! |---|---|---|
//! | PC10, PC11, PC12 | SPI3: clock, data in and out of joint 3's angle sensor (AS5047), in place of its encoder | CN8 6, 8, 10 |
//! | PD2 | its chip select | CN8 12 |
//! | PD7, PD6 | joint 1's lower and upper end stop, contacts to 3.3 V that are closed between them | CN9 2, 4 |
//! | PC3 | ADC2 channel 13: a motor's thermistor to ground, 10 kOhm to 3.3 V | CN9 5 (A2) |
//!
//! Its SPI waits for a byte for so many clocks of the bus and no longer: a unit of the chip that is dead costs a tick 10 us, and is a broken
//! sensor in the third.
//!
//! A board whose own they are has this in its file, as `Sensors`, and hands in its pins. Pedals, buttons and an encoder's index are not among
//! them: version 1 of the protocol has nothing that would carry them.

use super::super::stm32f4::{Converter, Sampling, Sensed};
use crate::devices::Console;
use crate::drivers::analog::{MotorSupply, Thermistor};
use crate::drivers::angle::AngleEncoder;
use crate::drivers::lines::{EndStops, Reached};
use crate::drivers::spi::Selected;
use cortex_m::asm;
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::MODE_1;
use stm32f4xx_hal::gpio::{Input, Output, PC3, PC10, PC11, PC12, PD2, PD6, PD7};
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::spi::Spi;
use stm32f4xx_hal::{pac, prelude::*};
use sutura_shared::device::JOINTS;

/// Clock of the angle sensor's bus \[Hz\].
const BUS_HZ: u32 = 5_000_000;
/// Between its chip select and its clock, and between two frames \[ns\]: 350 (AS5047D data sheet, SPI timing), and some.
const SETTLE_NS: u32 = 500;
/// Most counts of the angle sensor in a tick: the axis' 2 m/s.
const MOST_COUNTS: u16 = 400;
/// From here on a motor is too hot \[degrees Celsius\].
const HOTTEST: f32 = 80.0;
/// Readings in a row that say so: one is noise.
const HOT_TICKS: u8 = 3;

/// The console with a motors' supply of 24 V, over 100 and 10 kOhm.
pub const fn fit(console: Console) -> Console {
    Console {
        motor_supply: Some(MotorSupply {
            full_scale_v: 36.3,
            limits_v: [20.0, 22.0, 28.0],
        }),
        ..console
    }
}

/// What is on it.
pub struct Sensors {
    angle: AngleEncoder<Selected<Spi<pac::SPI3>, PD2<Output>, Pause>>,
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
        let bus = Spi::new(bus, pins, MODE_1, BUS_HZ.Hz(), rcc);
        let select = select.into_push_pull_output_in_state(stm32f4xx_hal::gpio::PinState::High);
        let bus = Selected::new(bus, select, Pause, BUS_HZ, SETTLE_NS);
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

/// Waits in a loop of so many cycles.
struct Pause;

impl DelayNs for Pause {
    fn delay_ns(&mut self, ns: u32) {
        // 168 cycles a microsecond.
        asm::delay(ns.div_ceil(125) * 21);
    }
}
