//! A board's pins as its self-test uses them, with jumpers and without amplifiers: see [`crate::selftest`].
//!
//! Entry points: [`BareRig::of`] for the control task, [`work`] for idle.

use super::stm32f4::{EnableLine, Guard, Outputs, Plant, cycles};
use super::wiring::{ENABLE_PIN, enable_is_high};
use crate::devices::CARTESIAN_BENCH;
use crate::measure::{self, Meter, Wire};
use crate::selftest::{Bulk, Found, Job, NO_PROGRESS, PROGRESS_WORDS, Rig, Watchdog};
use crate::watch::Watch;
use core::convert::Infallible;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU8, Ordering, compiler_fence};
use cortex_m::peripheral::SCB;
use embedded_hal::digital::OutputPin;
use heapless::spsc::{Consumer, Producer};
use stm32f4xx_hal::pac;
use sutura_shared::identity_trace::{self, Lockstep};
use sutura_shared::simulated_console::{Pace, SimulatedConsole};

/// Cycles that a level is held: three times as long as the encoders' input filter of eight samples at 84 MHz takes.
const HOLD: u32 = 48;
/// Reads of a pin after which it has not changed.
const PATIENCE: u32 = 1000;

/// The pins. PC6 to PC8 are outputs from here on, and no pulses.
pub struct BareRig {
    found: Consumer<'static, Found>,
}

impl BareRig {
    /// Takes the pulses' pins from the timer of a board that has been started. Before that the stop's line is told to be closed.
    ///
    /// `found`: what comes of jobs.
    pub fn of(_: &Plant, found: Consumer<'static, Found>) -> Self {
        let mut rig = BareRig { found };
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
        enable_is_high()
    }

    fn ready_is_high(&self) -> bool {
        // SAFETY: a read without side effects.
        unsafe { (*pac::GPIOB::ptr()).idr().read().idr9().bit_is_set() }
    }

    fn stop_is_closed(&self) -> bool {
        // SAFETY: a read without side effects.
        unsafe { (*pac::GPIOA::ptr()).idr().read().idr6().bit_is_set() }
    }

    fn enable_pin(&self) -> &'static str {
        ENABLE_PIN
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

    fn begin(&mut self, job: Job) {
        JOB.store(job as u8, Ordering::Relaxed);
    }

    fn found(&mut self) -> Option<Found> {
        self.found.dequeue()
    }

    fn bulk(&self) -> &Bulk {
        &BULK
    }

    fn starve(&mut self, watchdog: Option<Watchdog>) {
        STARVED.store(watchdog.map_or(0, |dog| dog as u8), Ordering::Relaxed);
    }

    fn fail_crystal(&mut self) -> bool {
        // SAFETY: a read without side effects, and a bit that pends the NMI, of a register whose other bits do nothing when they
        // are written as 0 (ARMv7-M, B3.2.4).
        unsafe {
            let asked = (*pac::RCC::ptr()).cr().read().csson().bit_is_set();
            (*SCB::PTR).icsr.write(1 << 31);
            cortex_m::asm::isb();
            asked
        }
    }

    fn keep(&mut self, words: [u32; PROGRESS_WORDS]) {
        // SAFETY: the control task alone uses it, once the board has started.
        unsafe {
            (&raw mut KEPT)
                .cast::<[u32; PROGRESS_WORDS]>()
                .write_volatile(words)
        };
    }
}

/// Bytes over USB for their own sake.
pub static BULK: Bulk = Bulk::new();
/// A [`Job`] that nobody has begun; 0 = none.
static JOB: AtomicU8 = AtomicU8::new(0);
/// The [`Watchdog`] that is not fed; 0 = none.
static STARVED: AtomicU8 = AtomicU8::new(0);

#[unsafe(link_section = ".uninit.SELFTEST")]
static mut KEPT: MaybeUninit<[u32; PROGRESS_WORDS]> = MaybeUninit::uninit();

/// Takes what the boot before has kept. In the initialisation, once.
pub fn kept() -> [u32; PROGRESS_WORDS] {
    let place = (&raw mut KEPT).cast::<[u32; PROGRESS_WORDS]>();
    // SAFETY: only called before interrupts are enabled; any bits make integers, and a volatile read takes what the RAM holds.
    unsafe {
        let kept = place.read_volatile();
        place.write_volatile(NO_PROGRESS);
        kept
    }
}

/// What jobs work with: together with what they need besides it does not fit the stack.
pub struct Bench {
    wire: Option<Wire>,
    console: Option<SimulatedConsole>,
}

impl Bench {
    /// Nothing is on it yet.
    pub const EMPTY: Bench = Bench {
        wire: None,
        console: None,
    };

    // Each in a function of its own, whose stack is free again after it.
    #[inline(never)]
    fn wire(&mut self) -> &mut Wire {
        self.wire.insert(Wire::new())
    }

    #[inline(never)]
    fn console(&mut self) -> Option<&mut SimulatedConsole> {
        self.console = SimulatedConsole::new(&CARTESIAN_BENCH, 0).ok();
        self.console.as_mut()
    }
}

/// The lowest priority: jobs, and between their parts the watchdogs.
pub fn work(mut guard: Feeder<'_>, found: &mut Producer<'static, Found>, bench: &mut Bench) -> ! {
    loop {
        let job = JOB.swap(0, Ordering::Relaxed);
        if job == Job::Costs as u8 {
            costs(&mut guard, found, bench.wire());
        } else if job == Job::Trace as u8 {
            let console = bench.console();
            let hash = console.and_then(|console| trace(&mut guard, console));
            put(Found::Trace(hash), found, &mut guard);
        } else {
            guard.feed();
            continue;
        }
        put(Found::Done, found, &mut guard);
    }
}

#[inline(never)]
fn costs(guard: &mut Feeder<'_>, found: &mut Producer<'static, Found>, wire: &mut Wire) {
    measure::all(&mut Cycles { guard, found }, wire);
}

fn put(what: Found, found: &mut Producer<'static, Found>, guard: &mut Feeder<'_>) {
    while found.enqueue(what).is_err() {
        guard.feed();
    }
}

/// Feeds the watchdogs when all tasks have ticked.
pub struct Feeder<'a> {
    guard: &'a mut Guard,
    watch: &'a Watch,
    parts: u32,
}

impl<'a> Feeder<'a> {
    /// One for these tasks.
    pub fn new(guard: &'a mut Guard, watch: &'a Watch) -> Self {
        Feeder {
            guard,
            watch,
            parts: 0,
        }
    }

    fn feed(&mut self) {
        if self.watch.all_ticked() {
            let starved = STARVED.load(Ordering::Relaxed);
            self.guard.feed_but(
                starved == Watchdog::Independent as u8,
                starved == Watchdog::Window as u8,
            );
        }
    }

    /// Now and then, of parts that take up to 2 ms.
    fn part(&mut self) {
        self.parts += 1;
        if self.parts.is_multiple_of(16) {
            self.feed();
        }
    }
}

/// Counts cycles, undisturbed.
struct Cycles<'a, 'b> {
    guard: &'a mut Feeder<'b>,
    found: &'a mut Producer<'static, Found>,
}

impl Meter for Cycles<'_, '_> {
    fn once(&mut self, mut work: impl FnMut()) -> u32 {
        self.guard.part();
        cortex_m::interrupt::free(|_| {
            let start = cycles();
            compiler_fence(Ordering::SeqCst);
            work();
            compiler_fence(Ordering::SeqCst);
            cycles().wrapping_sub(start)
        })
    }

    fn line(&mut self, name: &'static str, figure: u32) {
        if !name.ends_with("_bytes") {
            put(Found::Cost(name, figure), self.found, self.guard);
        }
    }
}

/// The identity trace of a simulated console on this board.
#[inline(never)]
fn trace(guard: &mut Feeder<'_>, console: &mut SimulatedConsole) -> Option<u64> {
    let trace = identity_trace::run(&mut Simulated { console, guard }).ok()?;
    Some(trace.hash)
}

struct Simulated<'a, 'b> {
    console: &'a mut SimulatedConsole,
    guard: &'a mut Feeder<'b>,
}

impl Lockstep for Simulated<'_, '_> {
    type Error = Infallible;

    fn exchange(&mut self, down: &[u8], up: &mut dyn FnMut(u8)) -> Result<(), Infallible> {
        self.guard.part();
        self.console.feed(down);
        self.console.tick(Pace::default());
        self.console.drain(&mut Push(up));
        Ok(())
    }
}

/// Where bytes go one by one.
struct Push<'a>(&'a mut dyn FnMut(u8));

impl Extend<u8> for Push<'_> {
    fn extend<T: IntoIterator<Item = u8>>(&mut self, bytes: T) {
        bytes.into_iter().for_each(&mut self.0);
    }
}
