//! The image for QEMU's `netduinoplus2`, an STM32F405: the same tasks, around a simulated console.
//!
//! The emulator's command line chooses how bytes come and what makes time pass:
//!
//! - `lockstep DOWN UP [seed=N] [off=GUARD,..]`: two named pipes. One message down, a u16 length and that many bytes, makes one tick;
//!   one message up answers it. The highest bit of the length down says that the tick before overran, as recordings of
//!   consoles that keep time do; 0xFFFF ends the emulator with exit code 0. Virtual time is the tick count, so that runs are identical to the bit, and to `SimulatedConsole` on any other machine.
//!   Reports say nothing of cost and stack, which another machine could not repeat. `seed` is for session numbers, 0 if it
//!   is left out; `off` names guards and checks to go without, to see whether a test notices.
//! - `uart`: USART1, and 1 kHz from SysTick. A smoke test: QEMU moves 8 to 12 kB/s towards the image.
//!
//! Nothing is logged here: the emulator's console has no reader that knows defmt, and a fault writes one
//! plain line before it ends the emulator with exit code 1. QEMU models no clock tree, timers of the right
//! period, watchdogs or pins; none of them is touched.

use super::semihosting::{self, Access, File};
use super::{Boot, Event, fault};
use crate::crash_record::CrashRecord;
use crate::devices::CARTESIAN_BENCH;
use crate::host_side::{Bytes, HostSide};
use crate::watch::Watch;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use heapless::{Deque, Vec};
use rtic::Mutex;
use stm32f4xx_hal::pac::{self, Interrupt};
use sutura_shared::control::{Control, TICK_HZ, TickInput, TickOutput};
use sutura_shared::device::DeviceDescription;
use sutura_shared::link::Identity;
use sutura_shared::simulated_console::{SimulatedBoard, Without};
use sutura_shared::wire::message::Simulate;

/// The board's name: that of its feature and its image.
pub const NAME: &str = "virtual";

/// The console until the host sends another.
pub const DEVICE: DeviceDescription = CARTESIAN_BENCH;

/// What the console says of itself.
pub const IDENTITY: Identity = Identity {
    tick_hz: TICK_HZ,
    simulated: true,
    device_name: DEVICE.name,
};

pub use super::semihosting::command_line;

/// The interrupt of the link task.
pub const LINK: Interrupt = Interrupt::USART1;

/// Counts of SysTick in a tick.
const TICK: u32 = 168_000;
/// ... and in a microsecond.
const CYCLES_PER_US: u32 = TICK / 1000;

/// Bytes that lockstep hands to the link task at a time.
const DOWN: usize = 1024;
/// Most bytes of one answer.
const UP: usize = 4096;
/// Length of the message that ends the emulator.
const QUIT: u16 = 0xFFFF;
/// Beside the length of a message down: the tick before took longer than its period.
const OVERRAN: u16 = 0x8000;

/// Nothing here can hurt anybody.
pub fn safe_state() {}

pub use super::fault::forget as forget_crash;

/// Last act of a fault handler: one line, exit code 1.
pub fn end(crash_record: CrashRecord) -> ! {
    let mut line = *b"fault 0 at 0x00000000, see board/fault.rs";
    line[6] += crash_record.kind as u8;
    for digit in 0..8 {
        let value = (crash_record.place >> (28 - 4 * digit) & 0xF) as u8;
        line[13 + digit] = if value < 10 {
            b'0' + value
        } else {
            b'a' - 10 + value
        };
    }
    fail(core::str::from_utf8(&line).unwrap_or_default())
}

/// SysTick, which counts down; stands still in lockstep.
pub fn cycles() -> u32 {
    SYST::get_current()
}

/// Time since the last tick was due \[us\]; 0 in lockstep, where no clock runs between ticks.
pub fn since_tick_us() -> u32 {
    if LOCKSTEP.load(Ordering::Relaxed) {
        return 0;
    }
    (TICK - SYST::get_current()) / CYCLES_PER_US
}

/// Counts between two readings of [`cycles`], less than a tick apart.
pub fn cycles_between(start: u32, end: u32) -> u32 {
    if start >= end {
        start - end
    } else {
        start + TICK - end
    }
}

/// Whether ticks come from the pipe: then nothing is reported that another machine could not repeat.
static LOCKSTEP: AtomicBool = AtomicBool::new(false);

/// Stack never used \[bytes\]; 0 in lockstep.
pub fn stack_free() -> u32 {
    if LOCKSTEP.load(Ordering::Relaxed) {
        0
    } else {
        super::stack::unused_bytes()
    }
}

/// Nobody reads a log here.
pub fn log(_: Event) {}

/// Its only clock is that of the ticks.
pub fn noticed() -> Option<Event> {
    None
}

/// Whether the next tick is to find that the one before overran.
static OVERRUN: AtomicBool = AtomicBool::new(false);

/// The simulated console, whose ticks are late when lockstep says so.
pub struct Plant(SimulatedBoard);

impl crate::control_side::Plant for Plant {
    fn read(&mut self, _: bool) -> TickInput {
        let overrun = OVERRUN.load(Ordering::Relaxed);
        OVERRUN.store(false, Ordering::Relaxed);
        self.0.read(overrun)
    }

    fn write(&mut self, output: &TickOutput) {
        self.0.write(output);
    }

    /// Its time is made by the ticks themselves.
    fn overrun(&self) -> bool {
        false
    }

    fn simulate(&mut self, order: &Simulate, control: &mut Control) {
        self.0.simulate(order, control);
    }
}

/// Sets the board up. Called once, with interrupts off.
pub fn start(
    mut core: cortex_m::Peripherals,
    device: pac::Peripherals,
) -> (Plant, Port, Guard, Boot) {
    let mut buffer = [0; 512];
    let mut words = command_line(&mut buffer).split_whitespace();
    // The name of the program may stand first, whatever it is.
    let mode = words.find(|word| matches!(*word, "lockstep" | "uart"));
    let mut open = |access| words.next().and_then(|path| File::open(path, access));
    let pipes = match mode {
        Some("lockstep") => match (open(Access::Read), open(Access::Write)) {
            (Some(down), Some(up)) => Some((down, up)),
            _ => fail("lockstep needs two named pipes: lockstep DOWN UP"),
        },
        Some(_) => None,
        None => fail("what makes time pass? lockstep DOWN UP, or uart"),
    };
    LOCKSTEP.store(pipes.is_some(), Ordering::Relaxed);
    let (mut seed, mut without) = (0, Without::default());
    for word in words {
        let known = match word.split_once('=') {
            Some(("seed", number)) => number.parse().map(|number| seed = number).is_ok(),
            Some(("off", names)) => names.split(',').all(|name| without.switch_off(name)),
            _ => false,
        };
        if !known {
            fail("unknown word behind the pipes: seed=NUMBER, or off=GUARD,..");
        }
    }
    let uart = pipes.is_none().then(|| {
        let uart = device.USART1;
        uart.cr1().write(|w| {
            w.ue()
                .set_bit()
                .te()
                .set_bit()
                .re()
                .set_bit()
                .rxneie()
                .set_bit()
        });
        core.SYST.set_clock_source(SystClkSource::Core);
        core.SYST.set_reload(TICK - 1);
        core.SYST.clear_current();
        core.SYST.enable_interrupt();
        core.SYST.enable_counter();
        uart
    });
    let port = Port {
        uart,
        down: Deque::new(),
        up: Vec::new(),
    };
    // Nothing here is random: two runs must give the same bits.
    let boot = Boot {
        reset_cause: 0,
        crash_record: fault::exhume().map(|(crash_record, _)| crash_record),
        seed,
        without,
    };
    let plant = Plant(SimulatedBoard::new(&DEVICE));
    (plant, port, Guard { pipes }, boot)
}

/// The UART, or the bytes of lockstep.
pub struct Port {
    uart: Option<pac::USART1>,
    down: Deque<u8, DOWN>,
    up: Vec<u8, UP>,
}

impl Bytes for Port {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        let mut count = 0;
        for place in bytes {
            let byte = match &self.uart {
                Some(uart) if uart.sr().read().rxne().bit_is_set() => {
                    Some(uart.dr().read().dr().bits() as u8)
                }
                Some(_) => None,
                None => self.down.pop_front(),
            };
            let Some(byte) = byte else { break };
            *place = byte;
            count += 1;
        }
        count
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        if let Some(uart) = &self.uart {
            // The emulated transmitter is never full.
            for &byte in bytes {
                uart.dr().write(|w| w.dr().set(u16::from(byte)));
            }
            return bytes.len();
        }
        let count = bytes.len().min(self.up.capacity() - self.up.len());
        let fits = bytes
            .get(..count)
            .is_some_and(|bytes| self.up.extend_from_slice(bytes).is_ok());
        if fits { count } else { 0 }
    }
}

/// What `idle` needs: the pipes of lockstep.
pub struct Guard {
    pipes: Option<(File, File)>,
}

/// The lowest priority: the other end of lockstep, or nothing. Spins: QEMU without sleep must not wait.
pub fn idle(mut host: impl Mutex<T = HostSide<'static, Port>>, guard: &mut Guard, _: &Watch) -> ! {
    while let Some((down, up)) = &guard.pipes {
        let mut length = [0; 2];
        if !down.read_exact(&mut length) {
            fail("the pipe down has ended");
        }
        let length = u16::from_le_bytes(length);
        if length == QUIT {
            semihosting::exit(true);
        }
        OVERRUN.store(length & OVERRAN != 0, Ordering::Relaxed);
        let mut left = usize::from(length & !OVERRAN);
        while left > 0 {
            let mut bytes = [0; DOWN];
            let bytes = &mut bytes[..left.min(DOWN)];
            if !down.read_exact(bytes) {
                fail("the pipe down has ended");
            }
            left -= bytes.len();
            if !host.lock(|host| host.port().deliver(bytes)) {
                fail("too many orders in one message");
            }
            run(Interrupt::USART1);
        }
        // Control, telemetry and link preempt this one after the other, until nothing is pending.
        run(Interrupt::TIM7);
        let sent = host.lock(|host| {
            let bytes = &mut host.port().up;
            let length = (bytes.len() as u16).to_le_bytes();
            let sent = up.write_all(&length) && up.write_all(bytes);
            bytes.clear();
            sent
        });
        if !sent {
            fail("the pipe up has ended");
        }
    }
    loop {
        cortex_m::asm::nop();
    }
}

impl Port {
    fn deliver(&mut self, bytes: &[u8]) -> bool {
        bytes.iter().all(|&byte| self.down.push_back(byte).is_ok())
    }
}

/// Pends an interrupt and returns when it, and what it pends in turn, has run.
fn run(interrupt: Interrupt) {
    rtic::pend(interrupt);
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

fn fail(why: &str) -> ! {
    semihosting::say(why);
    semihosting::exit(false)
}
