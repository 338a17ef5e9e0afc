//! Olimex STM32-H405: STM32F405RG with 64 pins, 8 MHz crystal, 168 MHz, USB full speed.
//!
//! Not yet run on hardware.
//!
//! | pin | what | note |
//! |---|---|---|
//! | PC6, PC7, PC8 | TIM8 CH1 to CH3: current command of motor 1 to 3 | 20 kHz, 10 to 90 % duty, 50 % = no current |
//! | PA6 | TIM8 BKIN: emergency stop, 3.3 V = run | normally closed contact to 3.3 V; open, or a broken wire, stops |
//! | PB12 | amplifier enable, high = on | **external 10 kOhm to ground**: the pin floats in reset |
//! | PB13 | amplifiers ready, 3.3 V = ready | pull-down inside; open = board fault |
//! | PB4, PB5 | TIM3: encoder 1 A, B | PB4 is JTAG's NJTRST: debug by SWD only |
//! | PB6, PB7 | TIM4: encoder 2 A, B | |
//! | PA5, PB3 | TIM2: encoder 3 A, B | PB3 is JTAG's JTDO (and SWO) |
//! | PA0, PA1 | TIM5: grip A, B | the only pins TIM5 has; PA0 is also the button: pressing it holds A high |
//! | PA11, PA12 | USB D-, D+ | |
//! | PC12 | LED, low = lit | lit while the amplifiers are on |
//! | PA13, PA14 | SWD | PA15 stays free; a JTAG probe would drive PB3, PB4 |
//! | PC4 | USB supply sense of the board | left alone |
//!
//! The amplifiers must take 10 to 90 % duty as minus to plus full scale and do nothing without enable: 0 %
//! duty, which is what a stopped timer gives, is then a command out of range and not full current.
//!
//! Watchdogs: the independent one bites after 100 ms on its own oscillator. The window watchdog's early
//! interrupt comes after 49 ms, above the control task's priority, and takes the torque off. Both are fed
//! only when every monitored task ticked. Neither stops in a debugger: halting the core resets the chip.

use super::{Boot, Event, fault};
use crate::crash_record::{CrashRecord, Kind, reset_cause};
use crate::safe_state::{self, Register, TorqueLayout, TorqueRegisters};
use crate::signals::{Clock, Counter16, StopLine, duty};
use crate::watch::Watch;
use defmt_rtt as _;
use stm32f4xx_hal::gpio::Pull;
use stm32f4xx_hal::otg_fs::{USB, UsbBus};
use stm32f4xx_hal::pac::Interrupt;
use stm32f4xx_hal::rcc::{Config, Enable, Reset};
use stm32f4xx_hal::watchdog::IndependentWatchdog;
use stm32f4xx_hal::{pac, prelude::*, qei::Qei};
use sutura_shared::control::{Control, TickInput, TickOutput};
use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics};
use sutura_shared::link::Identity;
use sutura_shared::wire::message::Simulate;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{
    StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid,
};
use usbd_serial::{SerialPort, USB_CLASS_CDC};

/// Core clock \[Hz\].
const CORE_HZ: u32 = 168_000_000;
/// Cycles of the core in a microsecond.
pub const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;
/// TIM8 counts per pulse: 20 kHz, above hearing and what usual servo amplifiers sample.
const PULSE: u32 = CORE_HZ / 20_000;
/// Current of the amplifiers at 90 % duty \[A\].
const FULL_SCALE_A: f32 = 5.0;

/// TIM8 break and dead-time register: break input on, active low; outputs driven low while disabled;
/// these bits locked until the next reset (RM0090, 17.4.18).
const BREAK_DEAD_TIME: u32 = 1 << 12 | 1 << 11 | 1 << 10 | 1 << 8;

const LAYOUT: TorqueLayout = TorqueLayout {
    enable_pin: 12,
    break_dead_time: BREAK_DEAD_TIME,
    zero_compare: PULSE / 2,
};

/// The console that hangs on this board: three orthogonal axes with capstan drives. Encoders count from
/// where the console stood at power-up, which is taken as the origin.
pub const DEVICE: DeviceDescription = {
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
        name: *b"olimex-h405\0\0\0\0\0",
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [axis; JOINTS],
        gravity_mass_kg: [0.0; 3],
        max_force_n: 8.0,
        max_power_w: 8.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
};

/// What the console says of itself.
pub const IDENTITY: Identity = Identity {
    tick_hz: 1000,
    simulated: false,
    device_name: DEVICE.name,
};

/// The interrupt of the link task.
pub const LINK: Interrupt = Interrupt::OTG_FS;

/// The real torque registers, from any context.
struct Registers;

impl TorqueRegisters for Registers {
    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: whole-word writes, which cannot tear or be interleaved. Every caller only ever moves
        // torque off, except `Plant::write`, which runs at one priority and looks at the break input after
        // it. Before the clocks are on the writes are ignored by the chip.
        unsafe {
            match register {
                Register::EnableSetReset => (*pac::GPIOB::ptr()).bsrr().write(|w| w.bits(value)),
                Register::BreakDeadTime => (*pac::TIM8::ptr()).bdtr().write(|w| w.bits(value)),
                Register::Compare(motor) => (*pac::TIM8::ptr())
                    .ccr(motor % safe_state::MOTORS)
                    .write(|w| w.bits(value)),
            };
        }
    }
}

/// Takes the torque off. From any context, any number of times.
pub fn safe_state() {
    safe_state::safe_state(&mut Registers, &LAYOUT);
}

/// Last act of a fault handler.
pub fn end(_: CrashRecord) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// The emergency stop's interrupt: torque off, and no further interrupt until the stop is released.
pub fn emergency_stop() {
    safe_state();
    // SAFETY: the control task, below this priority, is the only other user of this register.
    unsafe {
        (*pac::TIM8::ptr())
            .dier()
            .modify(|_, w| w.bie().clear_bit())
    };
}

/// The window watchdog's early interrupt: some task hangs.
pub fn watchdog(watch: &Watch) -> ! {
    safe_state();
    fault::bury(CrashRecord {
        kind: Kind::Watchdog,
        place: watch.bits(),
    })
}

/// Cycle counter of the core.
pub fn cycles() -> u32 {
    cortex_m::peripheral::DWT::cycle_count()
}

/// Cycles between two readings of [`cycles`].
pub fn cycles_between(start: u32, end: u32) -> u32 {
    end.wrapping_sub(start)
}

pub use super::stack::unused_bytes as stack_free;

/// Writes to the log. Takes a critical section: never from the control task.
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
        Event::Mode { mode, faults } => defmt::warn!("mode {}, faults {:#06b}", mode, faults),
    }
}

/// Encoders, motors and the amplifiers' lines.
pub struct Plant {
    clock: Clock<CYCLES_PER_US>,
    encoders: (pac::TIM3, pac::TIM4, pac::TIM2),
    counters: [Counter16; 2],
    tick: pac::TIM7,
    amplifiers_on: bool,
}

impl crate::control_side::Plant for Plant {
    /// Acknowledges the tick and reads everything that it needs.
    fn read(&mut self, overrun: bool) -> TickInput {
        self.tick.sr().write(|w| w.uif().clear_bit());
        // SAFETY: only the break interrupt shares these registers, and only its enable bit. Where it comes
        // in between, the bit is set once more and the interrupt, above this priority, clears it again.
        let pwm = unsafe { &*pac::TIM8::ptr() };
        let stop = StopLine {
            open: stopped(),
            tripped: pwm.sr().read().bif().bit_is_set(),
        };
        if stop.clears_flag() {
            // Cleared by writing 0; the other flags are not used. An opening from here on sets it again.
            pwm.sr().write(|w| w.bif().clear_bit());
        }
        if !stop.open {
            pwm.dier().write(|w| w.bie().set_bit());
        }
        // SAFETY: a read without side effects.
        let ready = unsafe { (*pac::GPIOB::ptr()).idr().read().idr13().bit_is_set() };
        let [first, second] = &mut self.counters;
        TickInput {
            now_us: self.clock.now_us(cycles()),
            encoder_counts: [
                first.widen(self.encoders.0.cnt().read().cnt().bits()),
                second.widen(self.encoders.1.cnt().read().cnt().bits()),
                self.encoders.2.cnt().read().cnt().bits() as i32,
            ],
            // No wrist.
            orientation: None,
            emergency_stop: stop.pressed(),
            board_fault: !ready,
            overrun,
            ..TickInput::default()
        }
    }

    fn write(&mut self, output: &TickOutput) {
        if !output.amplifiers_on {
            safe_state();
        } else if stopped() {
            // The stop came during this tick; the next one latches it.
            safe_state();
        } else {
            if !self.amplifiers_on {
                safe_state::torque_on(&mut Registers, &LAYOUT);
            }
            for (motor, current_a) in output.current_a.into_iter().enumerate() {
                Registers.write(
                    Register::Compare(motor),
                    duty(current_a, FULL_SCALE_A, PULSE),
                );
            }
            if stopped() {
                safe_state();
            }
        }
        if output.amplifiers_on != self.amplifiers_on {
            self.amplifiers_on = output.amplifiers_on;
            let led = if output.amplifiers_on {
                1 << (16 + 12)
            } else {
                1 << 12
            };
            // SAFETY: one whole-word write of the set/reset register; nobody else drives this port's pin 12.
            unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(led)) };
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

/// USB CDC-ACM.
pub struct Port {
    device: UsbDevice<'static, UsbBus<USB>>,
    serial: SerialPort<'static, UsbBus<USB>>,
}

impl crate::host_side::Bytes for Port {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        self.device.poll(&mut [&mut self.serial]);
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
        self.independent.feed();
        self.window.cr().write(|w| w.wdga().set_bit().t().set(0x7F));
    }
}

/// The lowest priority: feeds the watchdogs. Spins, because the cycle counter stands still in sleep.
pub fn idle<T>(_: T, guard: &mut Guard, watch: &Watch) -> ! {
    loop {
        if watch.all_ticked() {
            guard.feed();
        }
    }
}

/// Sets the board up. Called once, with interrupts off; the first tick is due 1 ms later.
pub fn start(
    mut core: cortex_m::Peripherals,
    device: pac::Peripherals,
) -> (Plant, Port, Guard, Boot) {
    let crash_record = fault::exhume();
    let csr = device.RCC.csr().read().bits();
    device.RCC.csr().modify(|_, w| w.rmvf().set_bit());
    let clocks = Config::hse(8.MHz())
        .sysclk(CORE_HZ.Hz())
        .pclk1(42.MHz())
        .pclk2(84.MHz())
        .require_pll48clk();
    let mut rcc = device.RCC.freeze(clocks);
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();

    let gpioa = device.GPIOA.split(&mut rcc);
    let gpiob = device.GPIOB.split(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);

    // Enable low before anything else drives a motor.
    let _enable = gpiob
        .pb12
        .into_push_pull_output_in_state(stm32f4xx_hal::gpio::PinState::Low);
    let _ready = gpiob.pb13.into_pull_down_input();
    let _led = gpioc
        .pc12
        .into_push_pull_output_in_state(stm32f4xx_hal::gpio::PinState::High);
    let _stop = gpioa
        .pa6
        .into_alternate::<3>()
        .internal_resistor(Pull::Down);

    // Motor outputs: PWM mode 1, all three channels, preloaded.
    pac::TIM8::enable(&mut rcc);
    pac::TIM8::reset(&mut rcc);
    let pwm = device.TIM8;
    pwm.arr().write(|w| w.arr().set((PULSE - 1) as u16));
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
    pwm.ccer()
        .write(|w| w.cc1e().set_bit().cc2e().set_bit().cc3e().set_bit());
    safe_state();
    pwm.egr().write(|w| w.ug().set_bit());
    pwm.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
    let _pwm_pins = (
        gpioc.pc6.into_alternate::<3>(),
        gpioc.pc7.into_alternate::<3>(),
        gpioc.pc8.into_alternate::<3>(),
    );

    // Encoders, with an input filter of 8 samples at 84 MHz, which swallows spikes up to 95 ns.
    let encoder_1 = Qei::new(
        device.TIM3,
        (gpiob.pb4.into_alternate(), gpiob.pb5),
        &mut rcc,
    )
    .release()
    .0;
    let encoder_2 = Qei::new(device.TIM4, (gpiob.pb6, gpiob.pb7), &mut rcc)
        .release()
        .0;
    let encoder_3 = Qei::new(
        device.TIM2,
        (gpioa.pa5, gpiob.pb3.into_alternate()),
        &mut rcc,
    )
    .release()
    .0;
    // SAFETY: 3 = eight samples of the timer's clock, a documented value of both fields (RM0090, 18.4.7).
    unsafe {
        encoder_1
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(3).ic2f().bits(3));
        encoder_2
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(3).ic2f().bits(3));
        encoder_3
            .ccmr1_input()
            .modify(|_, w| w.ic1f().bits(3).ic2f().bits(3));
    }

    // Session numbers; without random numbers the host's nonce alone has to do.
    pac::RNG::enable(&mut rcc);
    device.RNG.cr().write(|w| w.rngen().set_bit());
    let drawn = (0..10_000).find(|_| device.RNG.sr().read().drdy().bit_is_set());
    let seed = drawn.map_or(0, |_| device.RNG.dr().read().bits());

    let (port, guard) = {
        let memory = cortex_m::singleton!(: [u32; 1024] = [0; 1024]).expect("start runs once");
        let usb = USB::new(
            (
                device.OTG_FS_GLOBAL,
                device.OTG_FS_DEVICE,
                device.OTG_FS_PWRCLK,
            ),
            (gpioa.pa11, gpioa.pa12),
            &rcc.clocks,
        );
        let bus = cortex_m::singleton!(: Option<UsbBusAllocator<UsbBus<USB>>> = None)
            .expect("start runs once");
        let bus = &*bus.insert(UsbBus::new(usb, memory));
        let serial = SerialPort::new(bus);
        let strings = StringDescriptors::default()
            .manufacturer("Sutura")
            .product("Sutura console")
            .serial_number("olimex-h405");
        // The vendor and product number that V-USB lends to CDC-ACM devices.
        let usb_device = UsbDeviceBuilder::new(bus, UsbVidPid(0x16C0, 0x27DD))
            .strings(&[strings])
            .expect("one language fits")
            .device_class(USB_CLASS_CDC)
            .build();

        let mut independent = IndependentWatchdog::new(device.IWDG);
        independent.start(100.millis());
        rcc.apb1enr().modify(|_, w| w.wwdgen().set_bit());
        let window = device.WWDG;
        // 42 MHz / 4096 / 8: 64 steps are 49.9 ms; the early interrupt comes one step before.
        window
            .cfr()
            .write(|w| w.ewi().set_bit().wdgtb().div8().w().set(0x7F));
        window.cr().write(|w| w.wdga().set_bit().t().set(0x7F));
        (
            Port {
                device: usb_device,
                serial,
            },
            Guard {
                independent,
                window,
            },
        )
    };

    // Setting up may have tripped the stop's flag; with an open line it comes back by itself.
    pwm.sr().write(|w| w.bif().clear_bit());

    // The tick: 1 MHz / 1000.
    pac::TIM7::enable(&mut rcc);
    pac::TIM7::reset(&mut rcc);
    let tick = device.TIM7;
    tick.psc().write(|w| w.psc().set(83));
    tick.arr().write(|w| w.arr().set(999));
    tick.egr().write(|w| w.ug().set_bit());
    tick.sr().write(|w| w.uif().clear_bit());
    tick.dier().write(|w| w.uie().set_bit());
    tick.cr1().write(|w| w.cen().set_bit());

    let plant = Plant {
        clock: Clock::new(cycles()),
        encoders: (encoder_1, encoder_2, encoder_3),
        counters: [Counter16::default(); 2],
        tick,
        amplifiers_on: false,
    };
    (
        plant,
        port,
        guard,
        Boot {
            reset_cause: reset_cause(csr, crash_record),
            crash_record,
            seed,
        },
    )
}
