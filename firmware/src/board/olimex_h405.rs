//! Olimex STM32-H405: STM32F405RG with 64 pins, 8 MHz crystal, 168 MHz, USB full speed.
//!
//! Not yet run on hardware. What it shares with other boards, how it starts and how it stops is [`super::stm32f4`]'s.
//!
//! | pin | what | note |
//! |---|---|---|
//! | PC6, PC7, PC8 | TIM8 CH1 to CH3: current command of motor 1 to 3 | pulses as the console's `set_point` says: 4 kHz, 10 to 90 % duty, 50 % = no current |
//! | PA8 | TIM1 CH1: amplifier enable, high = on | **external 10 kOhm to ground**: the pin floats in reset |
//! | PA6 | TIM1 BKIN: emergency stop, 3.3 V = run | normally closed contact to 3.3 V; open, or a broken wire, stops |
//! | PB9 | amplifiers ready, 3.3 V = ready | pull-down inside; open = not ready |
//! | PB4, PA7 | TIM3: encoder 1 A, B | PB4 is JTAG's NJTRST: debug by SWD only |
//! | PB6, PB7 | TIM4: encoder 2 A, B | |
//! | PA15, PB3 | TIM2: encoder 3 A, B | JTAG's JTDI and JTDO (and SWO) |
//! | PA0, PA1 | TIM5: grip A, B | the only pins TIM5 has; PA0 is also the button: pressing it holds A high |
//! | PA11, PA12 | USB D-, D+ | |
//! | PC0 | ADC1 channel 10: the motors' supply over a divider | if the console's `motor_supply` says so |
//! | PC12 | LED, low = lit | lit while the amplifiers are enabled |
//! | PA13, PA14 | SWD | a JTAG probe would drive PA15, PB3, PB4 |
//! | PC4 | USB supply sense of the board | left alone |
//! | PA9, PA10, PB5, PB10, PB11, PB13, PC10, PC11 | nothing | the ROM's loader listens there, or drives them (ST AN2606, table 73) |
//! | PA6, PA7, PA8, PB6, PB7 | as above | so does its version 9.1, which newer chips have (table 75): see the wiring page |
//! | PA4, PA5 | nothing | the two pins that do not stand 5 V (data sheet DS8626, pin table: TTa) |
//!
//! All pins with an encoder stand 5 V (FT), with the chip under supply and their pull resistors off, which they are.
//!
//! Its clock is its crystal; random numbers are the chip's.

use super::stm32f4::{NoSensors, Ports, Wired, encoder_pull};
use crate::devices::{self, Console};
use crate::drivers::lamp::{Lamp, Show};
use embedded_hal::digital::PinState;
use stm32f4xx_hal::gpio::{self, Input, Output, PA8, PB9, PC12};
use stm32f4xx_hal::rcc::{Config, Enable, Rcc};
use stm32f4xx_hal::{pac, prelude::*, qei::Qei};
use sutura_shared::wire::message::Mode;

/// The board's name: that of its feature, its images and its device.
pub const NAME: &str = "olimex-h405";

/// The console that hangs on this board.
pub const CONSOLE: Console = devices::CONSOLE.named(NAME);

/// The amplifiers' enable line.
pub type EnablePin = PA8<Input>;

/// Name of the enable line's pin.
pub const ENABLE_PIN: &str = "PA8";

/// Level of the enable line, as the pin has it.
pub fn enable_is_high() -> bool {
    // SAFETY: a read without side effects.
    unsafe { (*pac::GPIOA::ptr()).idr().read().idr8().bit_is_set() }
}

/// The amplifiers' ready line.
pub type Ready = PB9<Input>;

/// Encoders that count, and nothing else.
pub type Sensors = NoSensors;

/// The one on the board.
pub struct Lamps(Lamp<PC12<Output>>);

impl Lamps {
    /// Once a tick: lit while the amplifiers are enabled.
    pub fn tick(&mut self, enabled: bool, _: Mode) {
        self.0.tick(if enabled { Show::Lit } else { Show::Dark });
    }
}

/// The crystal.
pub fn clocks() -> Config {
    Config::hse(8.MHz())
}

/// Starts it.
pub fn start_crystal(clocks: &pac::RCC) {
    clocks.cr().modify(|_, w| w.hseon().set_bit());
}

/// A number that differs from boot to boot; none if the chip's generator gives none.
pub fn session_seed(rcc: &mut Rcc) -> Option<u32> {
    pac::RNG::enable(rcc);
    // SAFETY: nobody else uses the generator.
    let generator = unsafe { &*pac::RNG::ptr() };
    generator.cr().write(|w| w.rngen().set_bit());
    let drawn = (0..10_000).find(|_| generator.sr().read().drdy().bit_is_set());
    drawn.map(|_| generator.dr().read().bits())
}

/// Takes the board's pins. Encoders are without pull resistors, which JTAG's pins have after a reset: 5 V may not meet one.
pub fn wire(
    ports: Ports,
    timers: (pac::TIM3, pac::TIM4, pac::TIM2),
    _: pac::SPI3,
    rcc: &mut Rcc,
) -> Wired {
    let Ports { a, b, c, .. } = ports;
    let encoder_1 = (
        b.pb4
            .into_alternate::<2>()
            .internal_resistor(encoder_pull()),
        a.pa7,
    );
    let encoder_3 = (
        a.pa15
            .into_alternate::<1>()
            .internal_resistor(encoder_pull()),
        b.pb3
            .into_alternate::<1>()
            .internal_resistor(encoder_pull()),
    );
    Wired {
        stop: a.pa6,
        motors: (c.pc6, c.pc7, c.pc8),
        enable: a.pa8,
        usb: (a.pa11, a.pa12),
        encoders: (
            Qei::new(timers.0, encoder_1, rcc).release().0,
            Qei::new(timers.1, (b.pb6, b.pb7), rcc).release().0,
            Qei::new(timers.2, encoder_3, rcc).release().0,
        ),
        ready: b.pb9.into_pull_down_input(),
        motor_supply: c.pc0,
        sensors: NoSensors,
        lamps: Lamps(Lamp::new(
            c.pc12.into_push_pull_output_in_state(gpio::PinState::High),
            PinState::Low,
        )),
    }
}
