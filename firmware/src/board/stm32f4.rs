//! What boards with an STM32F4 and motors have in common: an F405 or F446 at 168 MHz with USB full speed.
//!
//! Not yet run on hardware. A board's own file has its pins, its clock, where its random numbers come from, and its console.
//!
//! | pin | what | note |
//! |---|---|---|
//! | PC6, PC7, PC8 | TIM8 CH1 to CH3: current command of motor 1 to 3 | pulses as the console's `set_point` says: 4 kHz, 10 to 90 % duty, 50 % = no current |
//! | PA8 or PE9 | TIM1 CH1: amplifier enable, high = on | on a pin of the board; **external 10 kOhm to ground**: the pin floats in reset |
//! | PA6 | TIM1 BKIN: emergency stop, 3.3 V = run | normally closed contact to 3.3 V; open, or a broken wire, stops |
//! | TIM3, TIM4, TIM2 CH1 and CH2 | encoder 1, 2, 3 A and B | on pins of the board |
//! | PA11, PA12 | USB D-, D+ | |
//! | PC0 | ADC1 channel 10: the motors' supply, over a divider | where the console's `motor_supply` says that there is one |
//! | PA13, PA14 | SWD | |
//! | PA4, PA5 | | the two pins that do not stand 5 V (data sheets DS8626 and DS10693, pin tables: TTa) |
//!
//! The amplifiers must take 10 to 90 % duty as minus to plus full scale and do nothing without enable: 0 %
//! duty, which is what a stopped timer gives, is then a command out of range and not full current. When they are enabled and
//! when pulses run is [`crate::drivers::amplifier`]'s. The break input takes enable, with the core dead or the clock stopped: it needs
//! neither (RM0090, 17.3.12). Pulses are another timer's, which has no break: its interrupt sets them to no current. An amplifier whose
//! enable takes up to 8 ms to act never sees them end.
//!
//! Clocks: the tick is TIM7's, and console time is the count of its ticks. SysTick, at an eighth of the core's clock, checks it.
//! The core's cycle counter, which debuggers switch off when they leave, says what a tick costs and decides nothing.
//! If the crystal fails, the chip goes on with its own oscillator, trips the break input and raises an NMI (RM0090, 7.2.7).
//!
//! Watchdogs: the independent one runs from the first instruction of `start`, on its own oscillator of 17 to 47 kHz
//! (DS8626, LSI), and bites after 71 to 196 ms. The window watchdog's early
//! interrupt comes after 49 ms, above the control task's priority, and takes the torque off. Both are fed
//! only when every monitored task ticked, and by idle, below all of them. Neither stops in a debugger: halting the core resets the chip.
//!
//! Loader: a host that touches the serial port of a console at rest sends it to the loader in the chip's ROM ([`crate::loader`]), by two
//! words in RAM and a reset. The reset ends both watchdogs (RM0090, 21.3 and 22.3), and all that `start` has set up.
//!
//! Supply: below 2.76 to 2.90 V (DS8626, PVD level 5, falling) an interrupt takes the torque off. At 168 MHz with five wait
//! states the flash needs 2.7 V (RM0090, 3.5.1); brown-out level 3 resets the chip there, and the log says if it is not set.

use super::logger::{self, LogClass};
use super::wiring::{self, CONSOLE, EnablePin, Lamps, Ready, Sensors};
use super::{Boot, Event, fault};
use crate::crash_record::{CrashRecord, Kind, reset_cause};
use crate::drivers::amplifier::Amplifiers;
use crate::drivers::analog::{Channel, Supply};
use crate::loader::{self, Touch};
use crate::safe_state::{self, ENABLE_OFF, ENABLE_ON, MOTORS, Register, TorqueRegisters};
use crate::serial_number::{DIGITS, serial_number};
use crate::signals::{Counter16, PulseTimer, StopLine, TickClock};
use crate::watch::Watch;
use core::convert::Infallible;
use core::marker::PhantomData;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SYST};
use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use stm32f4xx_hal::gpio::{self, Input, Pull};
use stm32f4xx_hal::otg_fs::{USB, UsbBus};
use stm32f4xx_hal::pac::Interrupt;
use stm32f4xx_hal::rcc::{Config, Enable, Rcc, Reset};
use stm32f4xx_hal::watchdog::IndependentWatchdog;
use stm32f4xx_hal::{pac, prelude::*};
use sutura_shared::control::{Control, TickInput, TickOutput};
use sutura_shared::device::JOINTS;
use sutura_shared::mutant::stands;
use sutura_shared::usb::{PRODUCT, VENDOR};
use sutura_shared::wire::message::Simulate;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{
    StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid,
};
use usbd_serial::SerialPort;

/// Core clock \[Hz\].
const CORE_HZ: u32 = 168_000_000;
/// Frequency of the chip's own oscillator \[Hz\].
const INTERNAL_HZ: u32 = 16_000_000;
/// Counts of SysTick in a microsecond: an eighth of the core's clock, so that it goes round in 0.8 s, after both watchdogs.
const SYSTICK_PER_US: u32 = CORE_HZ / 8 / 1_000_000;

/// TIM8, which has the core's clock.
const TIMER: PulseTimer = match PulseTimer::new(CORE_HZ, CONSOLE.set_point.frequency_hz) {
    Ok(timer) => timer,
    Err(error) => panic!("{}", error.rule),
};
/// Compare value of no current.
const NO_CURRENT: u32 = CONSOLE.set_point.none(TIMER.period) as u32;

/// Break and dead-time register of either timer: outputs driven low while disabled. Lock level 2, until the next reset: nothing can
/// change these bits, the break input's, nor what the outputs' idle level and polarity are (RM0090, 17.4.18).
const BREAK_DEAD_TIME: u32 = 1 << 11 | 1 << 10 | 0b10 << 8;
/// Bit of TIM1's register alone: break input on, active low.
const BREAK_INPUT: u32 = 1 << 12;
/// Bit of main output enable, which the break input takes away.
const MAIN_OUTPUT_ENABLE: u32 = 1 << 15;

/// The interrupt of the link task.
pub const LINK: Interrupt = Interrupt::OTG_FS;

/// The real torque registers, from any context.
struct Registers;

impl TorqueRegisters for Registers {
    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: whole-word writes, which cannot tear or be interleaved. Every caller only ever moves
        // torque off, except the amplifiers' driver in `Plant::write`, which runs at one priority and looks at the break input
        // after it. Before the clocks are on the writes are ignored by the chip.
        unsafe {
            match register {
                Register::EnableMode => (*pac::TIM1::ptr()).ccmr1_output().write(|w| w.bits(value)),
                Register::Compare(motor) => (*pac::TIM8::ptr())
                    .ccr(motor % MOTORS)
                    .write(|w| w.bits(value)),
            };
        }
    }
}

/// The pulses of a motor.
struct Pulses(usize);

impl pwm::ErrorType for Pulses {
    type Error = Infallible;
}

impl SetDutyCycle for Pulses {
    fn max_duty_cycle(&self) -> u16 {
        TIMER.period
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        Registers.write(Register::Compare(self.0), u32::from(duty));
        Ok(())
    }
}

/// A converter of the chip's. All of them have the registers of the first.
pub(super) trait Adc: Enable {
    fn registers() -> &'static pac::adc1::RegisterBlock;
}

impl Adc for pac::ADC1 {
    fn registers() -> &'static pac::adc1::RegisterBlock {
        // SAFETY: nobody but its one `Converter` uses it.
        unsafe { &*pac::ADC1::ptr() }
    }
}

impl Adc for pac::ADC2 {
    fn registers() -> &'static pac::adc1::RegisterBlock {
        // SAFETY: as above.
        unsafe { &*pac::ADC2::ptr() }
    }
}

/// A channel of a converter, which converts all the time: a reading is of the tick before.
pub(super) struct Converter<A = pac::ADC1>(PhantomData<A>);

/// No conversion has ended since the last reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotYet;

impl<A: Adc> Converter<A> {
    /// Switches the converter on and begins with a channel, 10 to 18, whose pin is analog. The only one of it: the next one takes its place.
    pub(super) fn begin(rcc: &mut Rcc, channel: u32, sampling: Sampling) -> Self {
        A::enable(rcc);
        let converter = A::registers();
        if stands("converter_clock") {
            // SAFETY: a field of its own in a register that all converters share; all of them ask for the same.
            let common = unsafe { &*pac::ADC_COMMON::ptr() };
            // 84 MHz / 4: at most 36 (DS8626 and DS10693, f_ADC).
            common.ccr().modify(|_, w| w.adcpre().div4());
        }
        // SAFETY: documented values of the sampling time of channels 10 to 18, three bits each, and of the sequence's only
        // channel (RM0090, 13.13.4 and 13.13.11).
        unsafe {
            let bits = (sampling as u32) << (3 * channel.saturating_sub(10).min(8));
            converter.smpr1().write(|w| w.bits(bits));
            converter.sqr3().write(|w| w.bits(channel));
        }
        converter.cr2().write(|w| w.adon().set_bit());
        // 3 us to start (DS8626 and DS10693, t_STAB).
        cortex_m::asm::delay(3 * CORE_HZ / 1_000_000);
        converter.cr2().modify(|_, w| w.swstart().set_bit());
        Converter(PhantomData)
    }
}

/// Cycles of the converter in which it looks at the pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code, reason = "each is some board's")]
pub(super) enum Sampling {
    /// 3: of noise.
    Shortest = 0,
    /// 480: from dividers of up to 50 kOhm.
    Longest = 7,
}

impl<A: Adc> Channel for Converter<A> {
    const FULL_SCALE: u16 = 4095;
    type Error = NotYet;

    fn read(&mut self) -> Result<u16, NotYet> {
        let converter = A::registers();
        if converter.sr().read().eoc().bit_is_clear() {
            return Err(NotYet);
        }
        let reading = converter.dr().read().bits() as u16;
        converter.cr2().modify(|_, w| w.swstart().set_bit());
        Ok(reading)
    }
}

/// The amplifiers' enable line, which TIM1 drives.
pub(super) struct EnableLine;

impl digital::ErrorType for EnableLine {
    type Error = Infallible;
}

impl OutputPin for EnableLine {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Registers.write(Register::EnableMode, ENABLE_OFF);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Registers.write(Register::EnableMode, ENABLE_ON);
        Ok(())
    }
}

/// All outputs of both timers: low, or what their channels say.
pub(super) struct Outputs;

impl Outputs {
    fn write(&mut self, value: u32) -> Result<(), Infallible> {
        let guarded = if stands("break_input") {
            value | BREAK_INPUT
        } else {
            value
        };
        // SAFETY: whole-word writes of documented bits; nobody else writes these registers. With the break input active the
        // chip keeps TIM1's output off whatever is written (RM0090, 17.4.18, MOE).
        unsafe {
            (*pac::TIM1::ptr()).bdtr().write(|w| w.bits(guarded));
            (*pac::TIM8::ptr()).bdtr().write(|w| w.bits(value));
        }
        Ok(())
    }
}

impl digital::ErrorType for Outputs {
    type Error = Infallible;
}

impl OutputPin for Outputs {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.write(BREAK_DEAD_TIME)
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.write(BREAK_DEAD_TIME | MAIN_OUTPUT_ENABLE)
    }
}

/// Takes the torque off. From any context, any number of times.
pub fn safe_state() {
    safe_state::safe_state(&mut Registers, NO_CURRENT);
}

/// Frequency of the core's clock now \[Hz\]: without its crystal the chip has gone on with its own oscillator (RM0090, 7.2.7).
fn core_hz() -> u32 {
    // SAFETY: a read without side effects.
    let clocks = unsafe { (*pac::RCC::ptr()).cfgr().read() };
    if clocks.sws().is_pll() || !stands("delay_by_clock") {
        CORE_HZ
    } else {
        INTERNAL_HZ
    }
}

/// Least cycles of a round of `cortex_m::asm::delay`: a subtraction, and a branch that is taken, of 2 to 4 (ARM 100166, 3.3).
const DELAY_CYCLES: u32 = 3;

/// Last act of a fault handler: pulses of no current go on for 20 to 33 ms, until no amplifier is on any more, then a reset. No longer: the
/// window watchdog bites after 49.9 ms.
pub fn end(_: CrashRecord) -> ! {
    if stands("last_feed") {
        // SAFETY: a whole-word write; nothing else runs any more. It is the last time that the watchdog is fed, or its early
        // interrupt would leave 0.8 ms. The independent one bites if this does not come to its end.
        unsafe {
            (*pac::WWDG::ptr())
                .cr()
                .write(|w| w.wdga().set_bit().t().set(0x7F))
        };
    }
    cortex_m::asm::delay(core_hz() / 50 / DELAY_CYCLES);
    cortex_m::peripheral::SCB::sys_reset()
}

/// The emergency stop's interrupt: torque off, and no further interrupt until the stop is released.
pub fn emergency_stop() {
    if stands("stop_at_once") {
        safe_state();
    }
    // SAFETY: the control task, below this priority, is the only other user of this register.
    unsafe {
        (*pac::TIM1::ptr())
            .dier()
            .modify(|_, w| w.bie().bit(!stands("stop_once")))
    };
}

/// The window watchdog's early interrupt: some task hangs.
pub fn watchdog(watch: &Watch) -> ! {
    if stands("watchdog_stops") {
        safe_state();
    }
    fault::bury(CrashRecord {
        kind: Kind::Watchdog,
        place: watch.bits(),
    })
}

/// The supply has been low since a tick last looked.
static SUPPLY_DIPPED: AtomicBool = AtomicBool::new(false);

/// The supply's interrupt: torque off. The next tick makes it a fault.
pub fn supply_low() {
    if stands("supply_at_once") {
        safe_state();
    }
    SUPPLY_DIPPED.store(stands("supply_remembered"), Ordering::Relaxed);
    // SAFETY: writing 1 clears this line's flag and no other (RM0090, 12.3.6).
    unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(SUPPLY_LINE)) };
}

/// A host has touched the serial port since a tick last looked.
static TOUCHED: AtomicBool = AtomicBool::new(false);
/// A touch was not taken.
static LOADER_REFUSED: AtomicBool = AtomicBool::new(false);

/// What a reset keeps of a touch.
#[unsafe(link_section = ".uninit.LOADER_REQUEST")]
static mut LOADER_REQUEST: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// The motors are off, and have been: resets the chip, whose next start goes to the loader in its ROM.
fn leave_for_loader() -> ! {
    cortex_m::interrupt::disable();
    safe_state();
    // SAFETY: interrupts are off and this never returns: nobody else reads or writes the static.
    unsafe {
        (&raw mut LOADER_REQUEST)
            .cast::<[u32; 2]>()
            .write_volatile(loader::REQUEST)
    };
    cortex_m::peripheral::SCB::sys_reset()
}

/// First of all code after a reset, before RAM has its values: goes to the loader in the chip's ROM if the program before asked
/// for it, once. The ROM lies at 0x1FFF_0000 (ST AN2606) and is mapped to 0, as BOOT0 would have it (RM0090, 2.4 and 9.2.1).
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn __pre_init() {
    core::arch::naked_asm!(
        "ldr r0, ={request}",
        "ldrd r1, r2, [r0]",
        "movs r3, #0",
        "strd r3, r3, [r0]",
        "ldr r3, ={word}",
        "cmp r1, r3",
        "bne 1f",
        "mvns r3, r3",
        "cmp r2, r3",
        "bne 1f",
        // The clock of SYSCFG (RCC_APB2ENR, SYSCFGEN), and a read that waits for it.
        "ldr r0, =0x40023844",
        "ldr r1, [r0]",
        "orr r1, r1, #0x4000",
        "str r1, [r0]",
        "ldr r1, [r0]",
        // SYSCFG_MEMRMP = 1: system memory at 0.
        "ldr r0, =0x40013800",
        "movs r1, #1",
        "str r1, [r0]",
        "dsb",
        "isb",
        "ldr r0, =0x1fff0000",
        "ldr r1, [r0]",
        "ldr r2, [r0, #4]",
        "msr msp, r1",
        "bx r2",
        "1:",
        "bx lr",
        request = sym LOADER_REQUEST,
        word = const loader::REQUEST[0],
    )
}

/// Time since the last tick was due \[us\]. While that tick cannot have been interrupted.
pub fn since_tick_us() -> u32 {
    // SAFETY: reads without side effects.
    let timer = unsafe { &*pac::TIM7::ptr() };
    let before = timer.cnt().read().bits();
    if timer.sr().read().uif().bit_is_set() {
        // The next tick is due, and waits for who asks here.
        1000 + timer.cnt().read().bits()
    } else {
        before
    }
}

/// Time by SysTick over time by the tick timer \[%\] where they were apart; 0 = nothing to tell.
static CLOCKS_APART: AtomicU32 = AtomicU32::new(0);

/// What the control side has noticed since this was last asked.
pub fn noticed() -> Option<Event> {
    if LOADER_REFUSED.load(Ordering::Relaxed) {
        LOADER_REFUSED.store(false, Ordering::Relaxed);
        return Some(Event::LoaderRefused);
    }
    if let Some([probe, usb]) = logger::lost() {
        return Some(Event::LogLost { probe, usb });
    }
    let percent = CLOCKS_APART.load(Ordering::Relaxed);
    if percent == 0 {
        return None;
    }
    CLOCKS_APART.store(0, Ordering::Relaxed);
    Some(Event::ClocksApart { percent })
}

pub use super::fault::forget as forget_crash;

/// Before the link's round: torque off if the host resets the bus, which ends its session. The driver then waits for the USB core, with
/// interrupts masked.
pub fn before_link() {
    // SAFETY: a read without side effects.
    let is_reset = unsafe {
        (*pac::OTG_FS_GLOBAL::ptr())
            .gintsts()
            .read()
            .usbrst()
            .bit_is_set()
    };
    if is_reset {
        if stands("bus_reset_stops") {
            safe_state();
        }
        BUS_RESET.store(stands("bus_reset_closes"), Ordering::Relaxed);
    }
}

/// The host has reset the bus since the link task last looked.
static BUS_RESET: AtomicBool = AtomicBool::new(false);

/// Cycle counter of the core.
pub fn cycles() -> u32 {
    cortex_m::peripheral::DWT::cycle_count()
}

/// Cycles between two readings of [`cycles`].
pub fn cycles_between(start: u32, end: u32) -> u32 {
    end.wrapping_sub(start)
}

pub use super::stack::unused_bytes as stack_free;

/// Writes to the log. Never from the control task, which has no time for it.
pub fn log(event: Event) {
    match event {
        Event::Started(boot) => match boot.crash_record {
            None => defmt::info!("started, reset cause {}", boot.reset_cause),
            Some(crash_record) => defmt::error!(
                "started, reset cause {}, crash_record {} at {:#x}",
                boot.reset_cause,
                crash_record.kind as u8,
                crash_record.place
            ),
        },
        Event::Mode { mode, faults: 0 } => defmt::info!("mode {}", mode),
        Event::Mode { mode, faults } => defmt::warn!("mode {}, faults {:#012b}", mode, faults),
        Event::ClocksApart { percent } => {
            defmt::warn!("SysTick has run at {} % of the tick timer", percent)
        }
        Event::LogLost { probe, usb } => {
            defmt::warn!("lines lost so far: {} to a probe, {} over USB", probe, usb)
        }
        Event::LoaderRefused => defmt::warn!("not at rest: not going into the loader"),
    }
}

/// The pins of the chip, for a board to take its own.
pub struct Ports {
    /// Port A, and so on.
    pub a: gpio::gpioa::Parts,
    /// Port B.
    pub b: gpio::gpiob::Parts,
    /// Port C.
    pub c: gpio::gpioc::Parts,
    /// Port D.
    pub d: gpio::gpiod::Parts,
    /// Port E.
    pub e: gpio::gpioe::Parts,
    /// Port G.
    pub g: gpio::gpiog::Parts,
}

/// Pins and timers that a board has taken. The first four are set up here, when it is safe.
pub struct Wired {
    /// The emergency stop's line.
    pub stop: gpio::PA6<Input>,
    /// Current commands of the motors.
    pub motors: (gpio::PC6, gpio::PC7, gpio::PC8),
    /// The amplifiers' enable, TIM1's first channel.
    pub enable: EnablePin,
    /// D-, D+.
    pub usb: (gpio::PA11, gpio::PA12),
    /// Encoder timers of joint 1, 2, 3, which count.
    pub encoders: (pac::TIM3, pac::TIM4, pac::TIM2),
    /// The amplifiers' ready line, high = ready.
    pub ready: Ready,
    /// The motors' supply, over a divider.
    pub motor_supply: gpio::PC0,
    /// What else the control task reads.
    pub sensors: Sensors,
    /// What people see.
    pub lamps: Lamps,
}

/// What a board's sensors say in a tick, beside the encoders that its timers count.
#[derive(Clone, Copy, Debug)]
pub struct Sensed {
    /// Encoder counts, (3): those of the timers, or of sensors in their place.
    pub counts: [i32; JOINTS],
    /// Something is broken, too hot, or where it must not be: the fault `board`.
    pub unfit: bool,
}

/// Of a board that has none.
pub struct NoSensors;

impl NoSensors {
    /// Once a tick, with what the timers have counted.
    pub fn tick(&mut self, counts: [i32; JOINTS]) -> Sensed {
        Sensed {
            counts,
            unfit: false,
        }
    }
}

/// Of a pin with an encoder, which 5 V may reach: JTAG's have a resistor after a reset, and it may not stay.
pub(super) fn encoder_pull() -> Pull {
    if stands("pulls_off") {
        Pull::None
    } else {
        Pull::Up
    }
}

/// Writes a line of a self-test to the log; see [`log`].
pub fn log_line(line: &str) {
    defmt::info!("{=str}", line);
}

/// Encoders, motors and the amplifiers' lines.
pub struct Plant {
    clock: TickClock<SYSTICK_PER_US>,
    has_crystal: bool,
    encoders: (pac::TIM3, pac::TIM4, pac::TIM2),
    counters: [Counter16; 2],
    tick: pac::TIM7,
    amplifiers: Amplifiers<Pulses, Outputs, EnableLine, Ready, MOTORS>,
    motor_supply: Option<Supply<Converter>>,
    sensors: Sensors,
    lamps: Lamps,
    /// The chip's option bits (RM0090, 3.9.10).
    flash_options: u32,
}

impl crate::control_side::Plant for Plant {
    /// Acknowledges the tick and reads everything that it needs.
    fn read(&mut self, overrun: bool) -> TickInput {
        if !stands("fed_at_rest") {
            feed_now();
        }
        self.tick.sr().write(|w| w.uif().clear_bit());
        let beat = self.clock.tick(SYST::get_current());
        logger::set_time(beat.now_us);
        if let Some(percent) = beat.apart_percent {
            CLOCKS_APART.store(percent.max(1), Ordering::Relaxed);
        }
        // SAFETY: only the break interrupt shares these registers, and only its enable bit. Where it comes
        // in between, the bit is set once more and the interrupt, above this priority, clears it again.
        let switch = unsafe { &*pac::TIM1::ptr() };
        let stop = StopLine {
            open: stopped(),
            tripped: switch.sr().read().bif().bit_is_set(),
        };
        if stop.clears_flag() {
            // Cleared by writing 0; the other flags are not used. An opening from here on sets it again.
            switch.sr().write(|w| w.bif().clear_bit());
        }
        if !stop.open && stands("stop_again") {
            switch.dier().write(|w| w.bie().set_bit());
        }
        // A dip that comes between the two is seen by the next tick.
        let supply_low = SUPPLY_DIPPED.load(Ordering::Relaxed) || supply_is_low();
        SUPPLY_DIPPED.store(false, Ordering::Relaxed);
        let wanted = self.amplifiers.are_wanted();
        let unfit = |supply: &mut Supply<_>| supply.is_unfit(wanted);
        let unfit = self.motor_supply.as_mut().is_some_and(unfit) && stands("motor_supply");
        let supply_low = unfit || supply_low;
        let [first, second] = &mut self.counters;
        let sensed = self.sensors.tick([
            first.widen(self.encoders.0.cnt().read().cnt().bits()),
            second.widen(self.encoders.1.cnt().read().cnt().bits()),
            self.encoders.2.cnt().read().cnt().bits() as i32,
        ]);
        TickInput {
            now_us: if stands("console_time") {
                beat.now_us
            } else {
                u64::from(cycles() / 168)
            },
            encoder_counts: sensed.counts,
            // No wrist.
            orientation: None,
            emergency_stop: stop.pressed(),
            board_fault: sensed.unfit && stands("sensors"),
            amplifiers_unready: !self.amplifiers.take_currents(),
            supply_low,
            time_base_fault: beat.contradicts || !self.has_crystal,
            overrun,
        }
    }

    fn write(&mut self, output: &TickOutput) {
        // What comes during this tick the next one latches.
        let wanted = output.amplifiers_on && !must_stop();
        let current_a = wanted.then_some(&output.current_a);
        let obeyed = self.amplifiers.drive(current_a).is_ok();
        if !obeyed || must_stop() {
            safe_state();
        }
        let enabled = self.amplifiers.are_enabled();
        self.lamps.tick(enabled, output.state.mode);
        // A touch counts in the tick after it, or never.
        if TOUCHED.swap(false, Ordering::Relaxed) {
            if loader::may_leave(
                output.state.mode,
                self.amplifiers.are_off(),
                self.flash_options,
            ) {
                leave_for_loader();
            }
            LOADER_REFUSED.store(true, Ordering::Relaxed);
            if !stands("touch_forgotten") {
                TOUCHED.store(true, Ordering::Relaxed);
            }
        }
    }

    /// The next tick is due already.
    fn overrun(&self) -> bool {
        self.tick.sr().read().uif().bit_is_set()
    }

    fn simulate(&mut self, _: &Simulate, _: &mut Control) {}
}

/// Whether the emergency stop's line is open.
fn stopped() -> bool {
    // SAFETY: a read without side effects; the pin can be read in its alternate function too.
    unsafe { (*pac::GPIOA::ptr()).idr().read().idr6().bit_is_clear() }
}

/// Whether something has happened since the tick began that allows no torque.
fn must_stop() -> bool {
    (stopped() || SUPPLY_DIPPED.load(Ordering::Relaxed)) && stands("stop_within_tick")
}

/// The supply detector's line among the external interrupts (RM0090, 12.2.5).
const SUPPLY_LINE: u32 = 1 << 16;

/// Whether the supply is below the detector's threshold.
fn supply_is_low() -> bool {
    // SAFETY: a read without side effects.
    unsafe { (*pac::PWR::ptr()).csr().read().pvdo().bit_is_set() && stands("supply_level") }
}

/// The chip's own number (RM0090, 39.1; RM0390, 33.1).
pub fn chip_id() -> [u32; 3] {
    let place = 0x1FFF_7A10 as *const u32;
    // SAFETY: three aligned words of read-only memory, on every chip of this family; any bits make integers.
    [0, 1, 2].map(|word| unsafe { place.add(word).read_volatile() })
}

/// USB: a serial port (CDC-ACM), and the log.
pub struct Port {
    device: UsbDevice<'static, UsbBus<USB>>,
    serial: SerialPort<'static, UsbBus<USB>>,
    log: LogClass<'static, UsbBus<USB>>,
    touch: Touch,
}

impl crate::host_side::Bytes for Port {
    /// Twelve packets: 768 kB/s, more than 24 rows and their contacts 300 times a second, and about 54,000 instructions of the
    /// 168,000 cycles of a tick.
    const PER_TICK: usize = 768;

    fn has_begun_anew(&mut self) -> bool {
        let was_reset = BUS_RESET.load(Ordering::Relaxed);
        BUS_RESET.store(false, Ordering::Relaxed);
        was_reset
    }

    fn read(&mut self, bytes: &mut [u8]) -> usize {
        self.device.poll(&mut [&mut self.serial, &mut self.log]);
        if self.device.state() == UsbDeviceState::Configured {
            self.log.give();
        }
        let baud = self.serial.line_coding().data_rate();
        if self.touch.saw(baud, self.serial.dtr()) {
            TOUCHED.store(true, Ordering::Relaxed);
        }
        self.serial.read(bytes).unwrap_or(0)
    }

    /// Splitting into packets and the zero-length packet after a last full one are `usbd-serial`'s.
    fn write(&mut self, bytes: &[u8]) -> usize {
        if self.device.state() != UsbDeviceState::Configured {
            // Nobody listens: let go of it, so that a host that comes later gets fresh frames.
            return bytes.len();
        }
        self.serial.write(bytes).unwrap_or(0)
    }
}

/// Both watchdogs.
pub struct Guard {
    independent: IndependentWatchdog,
    window: pac::WWDG,
}

impl Guard {
    fn feed(&mut self) {
        self.feed_but(false, false);
    }

    /// For the self-test: all but the independent one, or all but the window watchdog.
    pub(super) fn feed_but(&mut self, independent: bool, window: bool) {
        if !independent {
            self.independent.feed();
        }
        if !window {
            let on = stands("window_watchdog");
            self.window.cr().write(|w| w.wdga().bit(on).t().set(0x7F));
        }
    }
}

/// Feeds both watchdogs, which is idle's alone: a task that did so would keep them quiet whatever hangs below it.
fn feed_now() {
    // SAFETY: whole-word writes of the keys that feed (RM0090, 21.4.1 and 22.6.1).
    unsafe {
        (*pac::IWDG::ptr()).kr().write(|w| w.bits(0xAAAA));
        (*pac::WWDG::ptr()).cr().write(|w| w.bits(0xFF));
    }
}

/// The lowest priority: feeds the watchdogs, so that no task can hang, alone or in a loop, and have them fed. Spins: in sleep the cycle counter, which counts what ticks cost, stands still.
pub fn idle<T>(_: T, guard: &mut Guard, watch: &Watch) -> ! {
    loop {
        if watch.all_ticked() {
            guard.feed();
        }
    }
}

/// Switches the supply detector on, at its level 5, waits until the supply is above, and switches its interrupt on. An edge on the way
/// there is forgotten. The independent watchdog ends a wait that is too long.
fn watch_supply(rcc: &mut Rcc, power: &pac::PWR, lines: &pac::EXTI) {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    let level = if stands("supply_threshold") { 5 } else { 0 };
    // SAFETY: a level of 0 to 7 (RM0090, 5.4.1); only the detector's own bits change.
    power
        .cr()
        .modify(|_, w| unsafe { w.pls().bits(level).pvde().set_bit() });
    // SAFETY: one line's bits among those of all; nobody else uses an external interrupt.
    unsafe {
        lines.rtsr().modify(|r, w| w.bits(r.bits() | SUPPLY_LINE));
    }
    while supply_is_low() && stands("supply_awaited") {}
    // SAFETY: as above; writing 1 clears this line's flag and no other (RM0090, 12.3.6).
    unsafe {
        lines.pr().write(|w| w.bits(SUPPLY_LINE));
        if stands("supply_interrupt") {
            lines.imr().modify(|r, w| w.bits(r.bits() | SUPPLY_LINE));
        }
    }
}

/// Boots in a row that ended in the wait for the crystal, and the same inverted.
#[unsafe(link_section = ".uninit.CRYSTAL_AWAITED")]
static mut CRYSTAL_AWAITED: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();
/// Such boots after which the chip starts on its own oscillator.
const MOST_AWAITED: u32 = 3;

/// Waits for the crystal, under the independent watchdog: false once it has bitten for that three times in a row. USB says then what is wrong,
/// as far as its clock of one percent allows.
fn await_crystal(clocks: &pac::RCC) -> bool {
    let place = (&raw mut CRYSTAL_AWAITED).cast::<[u32; 2]>();
    // SAFETY: called once, before interrupts are enabled; any bits make an array of integers, and volatile accesses take what the
    // RAM holds and leave it there.
    let remember = |count: u32| unsafe { place.write_volatile([count, !count]) };
    // SAFETY: as above.
    let [count, inverted] = unsafe { place.read_volatile() };
    let awaited = if count == !inverted { count } else { 0 };
    if awaited >= MOST_AWAITED && stands("internal_oscillator") {
        remember(0);
        return false;
    }
    remember(awaited.saturating_add(1));
    wiring::start_crystal(clocks);
    while clocks.cr().read().hserdy().bit_is_clear() {}
    remember(0);
    true
}

/// Sets the board up. Called once, with interrupts off; the first tick is due 1 ms later.
pub fn start(
    mut core: cortex_m::Peripherals,
    device: pac::Peripherals,
) -> (Plant, Port, Guard, Boot) {
    #[cfg(feature = "mutants")]
    let without = super::mutants::without();
    // Before anything that may wait for ever, such as a crystal.
    let mut independent = IndependentWatchdog::new(device.IWDG);
    if stands("watchdog_first") {
        let limit = if stands("independent_time") {
            100
        } else {
            30_000
        };
        independent.start(limit.millis());
    }
    // The interrupts of all boards' tasks are unmasked.
    NVIC::mask(Interrupt::USART1);
    // Priorities are the framework's.
    if !stands("stop_priority") {
        // SAFETY: no task runs yet; only an image that shows that a test notices comes here.
        unsafe { core.NVIC.set_priority(Interrupt::TIM1_BRK_TIM9, 0xF0) };
    }
    if !stands("supply_priority") {
        // SAFETY: as above.
        unsafe { core.NVIC.set_priority(Interrupt::PVD, 0xF0) };
    }

    let found = fault::exhume();
    let csr = device.RCC.csr().read().bits();
    device.RCC.csr().modify(|_, w| w.rmvf().set_bit());
    let has_crystal = await_crystal(&device.RCC);
    let clocks = if has_crystal {
        wiring::clocks()
    } else {
        Config::hsi()
    };
    let clocks = clocks
        .sysclk(CORE_HZ.Hz())
        .pclk1(42.MHz())
        .pclk2(84.MHz())
        .require_pll48clk();
    let mut rcc = device.RCC.freeze(clocks);
    if has_crystal && stands("clock_security") {
        rcc.cr().modify(|_, w| w.csson().set_bit());
    }
    if !has_crystal {
        defmt::error!(
            "no crystal: on the internal oscillator, and motors stay off until a reset finds one"
        );
    }
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    core.SYST.set_clock_source(if stands("time_base_clock") {
        SystClkSource::External
    } else {
        SystClkSource::Core
    });
    core.SYST.set_reload(0x00FF_FFFF);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    watch_supply(&mut rcc, &device.PWR, &device.EXTI);
    // Option bits BOR_LEV, 0 = level 3.
    let flash_options = device.FLASH.optcr().read().bits();
    let brown_out = flash_options >> 2 & 0b11;
    if brown_out != 0 && stands("brown_out_told") {
        defmt::warn!(
            "brown-out level 3 is not set (BOR_LEV = {}, not 0): see the wiring page",
            brown_out
        );
    }

    let ports = Ports {
        a: device.GPIOA.split(&mut rcc),
        b: device.GPIOB.split(&mut rcc),
        c: device.GPIOC.split(&mut rcc),
        d: device.GPIOD.split(&mut rcc),
        e: device.GPIOE.split(&mut rcc),
        g: device.GPIOG.split(&mut rcc),
    };
    let timers = (device.TIM3, device.TIM4, device.TIM2);
    let wired = wiring::wire(ports, timers, device.SPI3, &mut rcc);
    let _stop = wired
        .stop
        .into_alternate::<1>()
        .internal_resistor(Pull::Down);

    // Enable: a level, off before the pin is connected. Its timer does not count.
    pac::TIM1::enable(&mut rcc);
    pac::TIM1::reset(&mut rcc);
    let switch = device.TIM1;
    // Motor outputs: PWM mode 1, preloaded. All off before a pin is connected.
    pac::TIM8::enable(&mut rcc);
    pac::TIM8::reset(&mut rcc);
    let pwm = device.TIM8;
    pwm.psc().write(|w| w.psc().set(TIMER.prescaler));
    let halved = if stands("pulse_rate") { 1 } else { 2 };
    pwm.arr().write(|w| w.arr().set(TIMER.period / halved - 1));
    pwm.ccmr1_output().write(|w| {
        w.oc1m()
            .pwm_mode1()
            .oc1pe()
            .enabled()
            .oc2m()
            .pwm_mode1()
            .oc2pe()
            .enabled()
    });
    pwm.ccmr2_output()
        .write(|w| w.oc3m().pwm_mode1().oc3pe().enabled());
    safe_state();
    switch.ccer().write(|w| w.cc1e().set_bit());
    pwm.ccer()
        .write(|w| w.cc1e().set_bit().cc2e().set_bit().cc3e().set_bit());
    let mut amplifiers = Amplifiers::new(
        [Pulses(0), Pulses(1), Pulses(2)],
        Outputs,
        EnableLine,
        wired.ready,
        CONSOLE.set_point,
    );
    if amplifiers.drive(None).is_err() {
        safe_state();
    }
    pwm.egr().write(|w| w.ug().set_bit());
    let (motor_1, motor_2, motor_3) = wired.motors;
    let _pwm_pins = (
        motor_1.into_alternate::<3>(),
        motor_2.into_alternate::<3>(),
        motor_3.into_alternate::<3>(),
    );
    let _enable_pin = wired.enable.into_alternate::<1>();

    // Encoders, with an input filter of 8 samples at 84 MHz, which swallows spikes up to 95 ns.
    let (encoder_1, encoder_2, encoder_3) = wired.encoders;
    let filter = if stands("encoder_filter") { 3 } else { 0 };
    // SAFETY: 3 = eight samples of the timer's clock, a documented value of both fields (RM0090, 18.4.7).
    unsafe {
        encoder_1
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(filter).ic2f().bits(filter));
        encoder_2
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(filter).ic2f().bits(filter));
        encoder_3
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(filter).ic2f().bits(filter));
    }

    // Without one the host's nonce alone has to do.
    let seed = wiring::session_seed(&mut rcc).unwrap_or(0);

    let motor_supply = CONSOLE.motor_supply.map(|own| {
        let _pin = wired.motor_supply.into_analog();
        Supply::new(Converter::begin(&mut rcc, 10, Sampling::Longest), own)
    });

    let (port, guard) = {
        let memory = cortex_m::singleton!(: [u32; 1024] = [0; 1024]).expect("start runs once");
        let usb = USB::new(
            (
                device.OTG_FS_GLOBAL,
                device.OTG_FS_DEVICE,
                device.OTG_FS_PWRCLK,
            ),
            wired.usb,
            &rcc.clocks,
        );
        let bus = cortex_m::singleton!(: Option<UsbBusAllocator<UsbBus<USB>>> = None)
            .expect("start runs once");
        let bus = &*bus.insert(UsbBus::new(usb, memory));
        // Endpoints to the host: 0, the port's two, and the log's, of the four that the F405 has, and the F446 with six
        // (RM0090, 34.1; RM0390, 31.1); FIFOs of 16 words each, of 320.
        let serial = SerialPort::new(bus);
        let log = LogClass::new(bus);
        let serial_number = cortex_m::singleton!(: [u8; DIGITS] = serial_number(chip_id()))
            .expect("start runs once");
        // The vendor and product number that V-USB lends to CDC-ACM devices, on the condition that the manufacturer's name
        // has a domain in it.
        let strings = StringDescriptors::default()
            .manufacturer("github.com/sutura")
            .product("Sutura console")
            .serial_number(core::str::from_utf8(serial_number).unwrap_or_default());
        let usb_device = UsbDeviceBuilder::new(bus, UsbVidPid(VENDOR, PRODUCT))
            .strings(&[strings])
            .expect("one language fits")
            .composite_with_iads()
            .build();

        rcc.apb1enr().modify(|_, w| w.wwdgen().set_bit());
        let window = device.WWDG;
        // 42 MHz / 4096 / 8: 64 steps are 49.9 ms; the early interrupt comes one step before.
        window.cfr().write(|w| {
            let w = w.ewi().bit(stands("watchdog_warns")).w().set(0x7F);
            if stands("window_time") {
                w.wdgtb().div8()
            } else {
                w.wdgtb().div1()
            }
        });
        if stands("window_watchdog") {
            window.cr().write(|w| w.wdga().set_bit().t().set(0x7F));
        }
        (
            Port {
                device: usb_device,
                serial,
                log,
                touch: Touch::default(),
            },
            Guard {
                independent,
                window,
            },
        )
    };

    // Setting up may have tripped the stop's flag; with an open line it comes back by itself.
    switch.sr().write(|w| w.bif().clear_bit());

    // The tick: 1 MHz / 1000.
    pac::TIM7::enable(&mut rcc);
    pac::TIM7::reset(&mut rcc);
    let tick = device.TIM7;
    tick.psc().write(|w| w.psc().set(83));
    let period = if stands("tick_period") { 1000 } else { 2000 };
    tick.arr().write(|w| w.arr().set(period - 1));
    tick.egr().write(|w| w.ug().set_bit());
    tick.sr().write(|w| w.uif().clear_bit());
    tick.dier().write(|w| w.uie().set_bit());
    // One after the other, with interrupts off: a tick comes at the same place of a pulse in every boot.
    pwm.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
    tick.cr1().write(|w| w.cen().set_bit());

    let plant = Plant {
        clock: TickClock::new(SYST::get_current()),
        has_crystal,
        encoders: (encoder_1, encoder_2, encoder_3),
        counters: [Counter16::default(); 2],
        tick,
        amplifiers,
        motor_supply,
        sensors: wired.sensors,
        lamps: wired.lamps,
        flash_options,
    };
    (
        plant,
        port,
        guard,
        Boot {
            reset_cause: reset_cause(csr, found.map(|(_, age)| age)),
            crash_record: found.map(|(crash_record, _)| crash_record),
            seed,
            #[cfg(feature = "mutants")]
            without,
        },
    )
}
