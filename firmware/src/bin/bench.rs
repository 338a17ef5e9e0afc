//! Counts instructions under QEMU. One JSON line each on the emulator's stdout, in instructions: the most
//! that any of the repetitions took.
//!
//! `-icount shift=3` makes every instruction last 8 ns of virtual time, so SysTick's count at 168 MHz is
//! 1.344 times the number of instructions. That is a budget, not cycles: the chip has wait states, and
//! divisions and square roots of 14 cycles.
#![no_std]
#![no_main]

use core::fmt::Write;
use core::hint::black_box;
use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::SYST;
use cortex_m_semihosting::hio;
use sutura_firmware::measure::{Meter, REPEAT};

/// What is counted begins here. `cargo xtask firmware` follows the instructions from here on, up to the other mark.
#[inline(never)]
fn mark_begin() {
    cortex_m::asm::nop();
}

/// What is counted ends here.
#[inline(never)]
fn mark_end() {
    // Two, or the compiler would make one function of both.
    cortex_m::asm::nop();
    cortex_m::asm::nop();
}

/// Counts instructions.
struct Stopwatch {
    /// SysTick counts of measuring nothing.
    overhead: u32,
    /// The only case that is wanted, if not all are.
    only: Option<heapless::String<64>>,
}

impl Stopwatch {
    /// SysTick must be running at the core clock over its full 24 bits.
    fn new(only: Option<heapless::String<64>>) -> Self {
        let mut stopwatch = Self { overhead: 0, only };
        stopwatch.overhead = (0..REPEAT)
            .map(|_| stopwatch.counts(&mut || ()))
            .min()
            .unwrap_or(0);
        stopwatch
    }

    fn counts(&self, work: &mut impl FnMut()) -> u32 {
        // Fences, or the compiler would move parts of the work out of the count.
        let start = SYST::get_current();
        compiler_fence(Ordering::SeqCst);
        mark_begin();
        work();
        mark_end();
        compiler_fence(Ordering::SeqCst);
        let end = SYST::get_current();
        (start.wrapping_sub(end) & 0x00FF_FFFF).saturating_sub(self.overhead)
    }
}

impl Meter for Stopwatch {
    fn wants(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|only| *only == name)
    }

    fn once(&mut self, mut work: impl FnMut()) -> u32 {
        // 8 ns at 168 MHz: 1.344 counts an instruction.
        (self.counts(&mut work) * 1000 + 672) / 1344
    }

    fn line(&mut self, name: &'static str, instructions: u32) {
        if let Ok(mut stdout) = hio::hstdout() {
            let written = writeln!(
                stdout,
                "{{\"name\":\"{name}\",\"instructions\":{instructions}}}"
            );
            black_box(written.is_ok());
        }
    }
}

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod bench {
    use crate::Stopwatch;
    use core::hint::black_box;
    use cortex_m::peripheral::SYST;
    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m_semihosting::debug;
    use sutura_firmware::board;
    use sutura_firmware::exchange::Exchange;
    use sutura_firmware::host_side::Slot;
    use sutura_firmware::measure::{self, Meter, Wire};
    use sutura_shared::console_endpoint::Sample;

    #[shared]
    struct Shared {
        contacts: Exchange<'static, Slot>,
        samples: Exchange<'static, Sample>,
    }

    #[local]
    struct Local {
        ends: [&'static mut Slot; 2],
        sample_ends: [&'static mut Sample; 2],
        syst: SYST,
    }

    #[init(local = [
        slots: [Slot; 3] = [None; 3],
        samples: [Sample; 3] = [Sample::BEFORE_THE_FIRST; 3],
    ])]
    fn init(mut cx: init::Context) -> (Shared, Local) {
        board::float_environment(&mut cx.core.FPU);
        let [back, middle, front] = cx.local.slots;
        let [written, between, newest] = cx.local.samples;
        (
            Shared {
                contacts: Exchange::new(middle),
                samples: Exchange::new(between),
            },
            Local {
                ends: [back, front],
                sample_ends: [written, newest],
                syst: cx.core.SYST,
            },
        )
    }

    /// Gives the exchanges the ceiling that they have in the application.
    #[task(binds = TIM7, priority = 12, shared = [contacts, samples])]
    fn control(_: control::Context) {}

    #[idle(local = [ends, sample_ends, syst], shared = [contacts, samples])]
    fn idle(cx: idle::Context) -> ! {
        let syst = cx.local.syst;
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(0x00FF_FFFF);
        syst.clear_current();
        syst.enable_counter();
        let mut contacts = cx.shared.contacts;
        let mut samples = cx.shared.samples;
        let [back, front] = cx.local.ends;
        let [written, newest] = cx.local.sample_ends;
        crash_if_told();
        let mut stopwatch = Stopwatch::new(only());

        stopwatch.most("contact_swap", || {
            contacts.lock(|contacts| contacts.publish(back));
        });
        // Swaps once, then finds nothing new: the most counts.
        stopwatch.most("contact_take", || {
            contacts.lock(|contacts| contacts.take(front));
        });
        stopwatch.most("state_swap", || {
            samples.lock(|samples| samples.publish(written));
        });
        stopwatch.most("state_take", || {
            samples.lock(|samples| samples.take(newest));
        });
        measure::all(&mut stopwatch, &mut Wire::new());
        loop {
            debug::exit(debug::EXIT_SUCCESS);
        }
    }

    /// The case after the word `only` on the emulator's command line.
    fn only() -> Option<heapless::String<64>> {
        let mut buffer = [0; 512];
        let mut words = board::command_line(&mut buffer).split_whitespace();
        words.find(|word| *word == "only")?;
        heapless::String::try_from(words.next()?).ok()
    }

    /// Goes wrong as the emulator's command line says: `crash panic`, `crash overflow`, `crash exception`.
    fn crash_if_told() {
        let mut buffer = [0; 512];
        let mut words = board::command_line(&mut buffer).split_whitespace();
        if words.find(|word| *word == "crash").is_none() {
            return;
        }
        match words.next() {
            Some("overflow") => {
                black_box(overflow(0));
            }
            // Nothing handles it.
            Some("exception") => cortex_m::peripheral::SCB::set_pendsv(),
            _ => panic!("told to"),
        }
    }

    #[expect(unconditional_recursion, reason = "that is the point")]
    fn overflow(depth: u32) -> u32 {
        let frame = black_box([depth; 64]);
        overflow(depth + 1) + black_box(frame)[0]
    }
}
