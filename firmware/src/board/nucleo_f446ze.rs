//! ST NUCLEO-F446ZE (MB1137): STM32F446ZE with 144 pins, a probe of its own, 168 MHz, USB full speed.
//!
//! Not yet run on hardware. What it shares with other boards, how it starts and how it stops is [`super::stm32f4`]'s. The first board for a
//! builder without a probe: its upper USB connector (CN1) is the probe, with power; the lower one (CN13) is the console's.
//!
//! | pin | what | connector | on the board, as it is delivered | checked against |
//! |---|---|---|---|---|
//! | PC6, PC7, PC8 | TIM8 CH1 to CH3: current command of motor 1 to 3 | CN7 1, CN7 11, CN8 2 | the loader in ROM pulls PC7 down | F Z M |
//! | PE9 | TIM1 CH1: amplifier enable, high = on | CN10 4 (D6) | **external 10 kOhm to ground**; the loader leaves it alone | F Z |
//! | PA6 | TIM1 BKIN: emergency stop, 3.3 V = run | CN7 12 (D12) | the loader may drive it: 1 kOhm in between | F Z M |
//! | PB9 | amplifiers ready, 3.3 V = ready | CN7 4 (D14) | pull-down inside; goes to A4 (CN9 9) by SB138, which is open | Z M |
//! | PB4, PB5 | TIM3: encoder 1 A, B | CN7 19, CN7 13 | PB4 is JTAG's NJTRST; PB5 goes to D11 (CN7 14) by SB122, which is open | F Z M, bridge: D |
//! | PD12, PD13 | TIM4: encoder 2 A, B | CN10 21, CN10 19 | not PB6 and PB7: PB7 has LD2, by SB139 | F Z M |
//! | PA15, PA1 | TIM2: encoder 3 A, B | CN7 9, CN11 30 | not PB3, which the probe listens to as SWO; PA1: see E | F Z M |
//! | PA11, PA12 | USB D-, D+ | CN13 | | F C, connector: U |
//! | PB0 | LD1, green: the amplifiers are enabled | | SB120 closed; SB119, to PA5, open | C, bridges: L |
//! | PB7 | LD2, blue: armed or decaying | | SB139 | C, bridge: L |
//! | PB14 | LD3, red, blinking: a fault | | SB118; the loader may drive it | C, bridge: L |
//! | PG6 | USB power switch: held low | CN12 70 | as the host of a stick the board would give 5 V; high = on | C M |
//! | PC13 | button B1 | | SB173 closed; SB180, to PA0, open; nothing yet | C, bridges: L |
//! | PH0 | 8 MHz from the probe (its MCO) | | SB112 and SB149 closed, SB8 and SB9 open: no crystal, the probe must have power | C, bridges: L |
//! | PC0 | ADC1 channel 10: the motors' supply over a divider, if the console's `motor_supply` says so | CN9 3 (A1) | | F Z M |
//! | PC5 | ADC1 channel 15: noise, left open | CN12 6 | nothing may be there; see E | F M |
//! | PA8, PA9, PA10 | USB start of frame (test point TP1), VBUS, **ID** | CN13 | taken by the connector: left alone | F C |
//! | PG7 | USB over-current, low = over | CN12 67 | left alone | C M |
//! | PD8, PD9 | the probe's serial port (USART3) | CN12 10, CN11 69 | left alone | F C M |
//! | PA13, PA14, PB3 | SWD and SWO, from the probe | CN11 13, CN11 15, CN7 15 | left alone | C M, but PB3: M alone |
//! | PC14, PC15 | crystal of 32 kHz | | left alone | C |
//! | PB6, PB12, PB15, PA7, PA8 | nothing | | the loader's, too (AN2606, table 93) | |
//! | PA4, PA5 | nothing | | the two pins that do not stand 5 V | data sheet |
//!
//! The manual (UM1974) was not at hand; what each row was checked against, all of it on GitHub:
//!
//! - F: ST's list of the chip's functions, in `STMicroelectronics/STM32_open_pin_data` (STM32CubeMX 6.15), `mcu`: the number of every alternate
//!   function, and both channels of the converter.
//! - C: ST's own project for this board, there, `boards/A45_Nucleo_NUCLEO-F446ZE`: LEDs, button, USB, clock, serial port, crystal.
//! - Z: CN7 to CN10 from the manual's table 18 (rev. 11) in Zephyr's `st_zio_connector.dtsi` of this board; and ST's names D0 to D70 in
//!   mbed's `PinNames.h` of it. They agree.
//! - M: CN11 and CN12 in a drawing of the MB1137 (`casten/Nucleo-144-gpio`) and in a symbol of its F429 and F746 (`rusefi/kicad-libraries`). They agree with each
//!   other, and with the six pins of ours in what a user of an F767 has read off table 21.
//! - L: sections 7.5, 7.6 and 7.8.1, as NuttX and a project for the F429 quote them: the same bridges on all boards of the MB1137.
//! - D: D11 is PA7 in Z. ST's author of mbed's boards with Ethernet opens SB121 and closes SB122 to have PB5 there (`ARMmbed/mbed-os`, pull request 4272);
//!   `foldedtoad/dwm3000` says it of the two the other way round. Either way PB5 is not on D11 as the board comes.
//! - U: Zephyr's page of the F767 on the same MB1137.
//! - E: boards with Ethernet have its chip at PA1 (SB13) and PC5 (SB181). This one has neither the unit (F, C) nor the chip; **whether the two
//!   bridges are closed, to an empty place, nobody says.** It would lengthen the noise's aerial, and the encoder's line by a few centimetres.
//!
//! **Not checked by anybody here: the bridges of an F446ZE itself, and any of it with a meter. Do that before it is wired.** The example
//! in `fitted.rs` was checked against F, Z and M as well.
//!
//! The chip has no random generator: [`session_seed`] takes noise, the chip's number and a count in RAM.

use super::stm32f4::{Converter, Ports, Sampling, Wired, chip_id, encoder_pull};
use crate::devices::{self, Console};
use crate::drivers::analog::Channel;
use crate::drivers::lamp::{Lamp, Show};
use crate::seed::{Seeds, WORDS};
use core::mem::MaybeUninit;
use embedded_hal::digital::PinState;
use stm32f4xx_hal::gpio::{Input, Output, PB0, PB7, PB9, PB14, PE9, PG6};
use stm32f4xx_hal::rcc::{Config, Rcc};
use stm32f4xx_hal::{pac, prelude::*, qei::Qei};
use sutura_shared::wire::message::Mode;

/// Of the image that only tests run: everything that there is a driver for.
#[cfg(feature = "mutants")]
#[path = "fitted.rs"]
mod fitted;
/// What else is on it: nothing, but in the image that only tests run.
#[cfg(not(feature = "mutants"))]
pub use super::stm32f4::NoSensors as Sensors;
#[cfg(feature = "mutants")]
pub use fitted::Sensors;

/// The board's name: that of its feature, its images and its device.
pub const NAME: &str = "nucleo-f446ze";

/// The console that hangs on this board.
#[cfg(not(feature = "mutants"))]
pub const CONSOLE: Console = devices::CONSOLE.named(NAME);
#[cfg(feature = "mutants")]
pub const CONSOLE: Console = fitted::fit(devices::CONSOLE.named(NAME));

/// The amplifiers' enable line.
pub type EnablePin = PE9<Input>;

/// Name of the enable line's pin.
pub const ENABLE_PIN: &str = "PE9";

/// Level of the enable line, as the pin has it.
pub fn enable_is_high() -> bool {
    // SAFETY: a read without side effects.
    unsafe { (*pac::GPIOE::ptr()).idr().read().idr9().bit_is_set() }
}

/// The amplifiers' ready line.
pub type Ready = PB9<Input>;

/// Green, blue and red, and the USB power switch, which stays off.
pub struct Lamps {
    enabled: Lamp<PB0<Output>>,
    armed: Lamp<PB7<Output>>,
    fault: Lamp<PB14<Output>>,
    _usb_power: PG6<Output>,
}

impl Lamps {
    /// Once a tick.
    pub fn tick(&mut self, enabled: bool, mode: Mode) {
        let lit = |on| if on { Show::Lit } else { Show::Dark };
        self.enabled.tick(lit(enabled));
        self.armed
            .tick(lit(matches!(mode, Mode::Armed | Mode::Decaying)));
        self.fault.tick(match mode {
            Mode::Fault => Show::Blinking,
            _ => Show::Dark,
        });
    }
}

/// The probe's clock.
pub fn clocks() -> Config {
    Config::hse(8.MHz()).bypass_hse_oscillator()
}

/// Starts it.
pub fn start_crystal(clocks: &pac::RCC) {
    clocks
        .cr()
        .modify(|_, w| w.hsebyp().set_bit().hseon().set_bit());
}

#[unsafe(link_section = ".uninit.SEEDS")]
static mut SEEDS: MaybeUninit<[u32; WORDS]> = MaybeUninit::uninit();

/// A number that differs from boot to boot.
pub fn session_seed(rcc: &mut Rcc) -> Option<u32> {
    let place = (&raw mut SEEDS).cast::<[u32; WORDS]>();
    // SAFETY: called once, before interrupts are enabled; any bits make an array of integers, and volatile accesses take what the
    // RAM holds and leave it there.
    unsafe {
        let mut seeds = Seeds::from_words(place.read_volatile());
        let seed = seeds.draw(chip_id(), noise(rcc));
        place.write_volatile(seeds.to_words());
        Some(seed)
    }
}

/// What an open pin picks up: the lowest bits of 64 conversions, as short as they can be (RM0390, 13.3).
fn noise(rcc: &mut Rcc) -> u64 {
    let mut converter = Converter::<pac::ADC1>::begin(rcc, 15, Sampling::Shortest);
    (0..64).fold(0, |bits: u64, _| {
        // A conversion takes 15 of the converter's cycles; one that does not end gives nothing.
        let reading = (0..1000).find_map(|_| converter.read().ok());
        bits.rotate_left(1) ^ u64::from(reading.unwrap_or_default() & 3)
    })
}

/// Takes the board's pins. Encoders are without pull resistors, which JTAG's pins have after a reset: 5 V may not meet one.
pub fn wire(
    ports: Ports,
    timers: (pac::TIM3, pac::TIM4, pac::TIM2),
    bus: pac::SPI3,
    rcc: &mut Rcc,
) -> Wired {
    let Ports { a, b, c, d, e, g } = ports;
    let encoder_1 = (
        b.pb4
            .into_alternate::<2>()
            .internal_resistor(encoder_pull()),
        b.pb5,
    );
    let encoder_3 = (
        a.pa15
            .into_alternate::<1>()
            .internal_resistor(encoder_pull()),
        a.pa1,
    );
    let _open = c.pc5.into_analog();
    #[cfg(feature = "mutants")]
    let sensors = {
        let bus = (bus, c.pc10, c.pc11, c.pc12, d.pd2);
        Sensors::wire(bus, (d.pd7, d.pd6), c.pc3, rcc)
    };
    #[cfg(not(feature = "mutants"))]
    let (sensors, _) = (Sensors, bus);
    Wired {
        stop: a.pa6,
        motors: (c.pc6, c.pc7, c.pc8),
        enable: e.pe9,
        usb: (a.pa11, a.pa12),
        encoders: (
            Qei::new(timers.0, encoder_1, rcc).release().0,
            Qei::new(timers.1, (d.pd12, d.pd13), rcc).release().0,
            Qei::new(timers.2, encoder_3, rcc).release().0,
        ),
        ready: b.pb9.into_pull_down_input(),
        motor_supply: c.pc0,
        sensors,
        lamps: Lamps {
            enabled: Lamp::new(b.pb0.into_push_pull_output(), PinState::High),
            armed: Lamp::new(b.pb7.into_push_pull_output(), PinState::High),
            fault: Lamp::new(b.pb14.into_push_pull_output(), PinState::High),
            _usb_power: g.pg6.into_push_pull_output(),
        },
    }
}
