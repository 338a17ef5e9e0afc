//! The self-test's application: checks in the tick, their lines over USB and to the log. No amplifier may be connected.
//!
//! | priority | task | bound to | does |
//! |---|---|---|---|
//! | 15 | watchdog | WWDG | a reset with an epitaph |
//! | 12 | control | TIM7 | a tick of the self-test |
//! | 4 | usb | OTG_FS | `t` begins it, `c` goes on after a reset; bytes to be counted |
//! | 2 | report | EXTI0, pended by control | lines to the host |
//! | 0 | idle | | what takes long; feeds the watchdogs when all three ran |

/// For who writes it to a board.
#[used]
#[unsafe(link_section = ".identification")]
static IDENTIFICATION: [u8; 64] = sutura_firmware::board::identification("selftest");

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod selftest {
    use core::fmt::Write;
    use core::sync::atomic::{AtomicBool, Ordering};
    use heapless::spsc::{Producer, Queue};
    use heapless::{Deque, String};
    use stm32f4xx_hal::pac::Interrupt;
    use sutura_firmware::board::{self, BULK, BareRig, Bench, Feeder, Guard, Plant, Port};
    use sutura_firmware::control_side::Plant as _;
    use sutura_firmware::host_side::Bytes;
    use sutura_firmware::selftest::{BEGIN, Found, GO_ON, Left, Line, Seen, SelfTest};
    use sutura_firmware::watch::{Task, Watch};

    static WATCH: Watch = Watch::new();
    /// The host has taken all lines.
    static SAID_ALL: AtomicBool = AtomicBool::new(true);

    #[shared]
    struct Shared {
        port: Port,
        lines: Deque<Line, 24>,
        /// The newest word of the host's.
        word: Option<u8>,
    }

    #[local]
    struct Local {
        plant: Plant,
        rig: BareRig,
        test: SelfTest,
        guard: Guard,
        found: Producer<'static, Found>,
        bench: &'static mut Bench,
        /// Bytes that the host has not taken yet.
        rest: String<128>,
    }

    #[init(local = [results: Queue<Found, 8> = Queue::new(), on: Bench = Bench::EMPTY])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut core = cx.core;
        board::float_environment(&mut core.FPU);
        let (plant, port, guard, boot) = board::start(core, cx.device);
        board::log(board::Event::Started(boot));
        let report = boot.report();
        // The self-test's own lines tell of it.
        board::forget_crash();
        let left = Left {
            reset_cause: report.reset_cause,
            epitaph_kind: report.epitaph_kind,
            epitaph_place: report.epitaph_place,
        };
        let (found, results) = cx.local.results.split();
        let rig = BareRig::of(&plant, results);
        (
            Shared {
                port,
                lines: Deque::new(),
                word: None,
            },
            Local {
                plant,
                rig,
                test: SelfTest::new(left, board::kept()),
                guard,
                found,
                bench: cx.local.on,
                rest: String::new(),
            },
        )
    }

    #[idle(local = [guard, found, bench])]
    fn idle(cx: idle::Context) -> ! {
        let guard = Feeder::new(cx.local.guard, &WATCH);
        board::work(guard, cx.local.found, cx.local.bench)
    }

    #[task(binds = TIM7, priority = 12, local = [plant, rig, test], shared = [lines, word])]
    fn control(mut cx: control::Context) {
        let input = cx.local.plant.read(false);
        match cx.shared.word.lock(Option::take) {
            Some(BEGIN) => cx.local.test.start(),
            Some(_) => cx.local.test.go_on(),
            None => {}
        }
        let seen = Seen {
            counts: input.encoder_counts,
            supply_low: input.supply_low,
            clocks_contradict: input.time_base_fault,
            said_all: SAID_ALL.load(Ordering::Relaxed),
        };
        let found = cx.local.test.tick(cx.local.rig, &seen);
        cx.shared.lines.lock(|lines| {
            for line in found {
                SAID_ALL.store(false, Ordering::Relaxed);
                // A host that does not read loses the newest, and misses the end.
                let _ = lines.push_back(line);
            }
        });
        WATCH.tick(Task::Control);
        rtic::pend(Interrupt::EXTI0);
    }

    #[task(binds = EXTI0, priority = 2, local = [rest], shared = [port, lines])]
    fn report(mut cx: report::Context) {
        let rest = cx.local.rest;
        if rest.is_empty() {
            let next = cx.shared.lines.lock(|lines| {
                let next = lines.pop_front();
                SAID_ALL.store(next.is_none(), Ordering::Relaxed);
                next
            });
            if let Some(line) = next {
                board::log_line(&line);
                // As long as a line may be, and two more.
                let _ = write!(rest, "{line}\r\n");
            }
        }
        let count = cx.shared.port.lock(|port| {
            let count = port.write(rest.as_bytes());
            give(port);
            count
        });
        let mut left = String::new();
        let _ = left.push_str(rest.get(count..).unwrap_or_default());
        *rest = left;
        WATCH.tick(Task::Telemetry);
        rtic::pend(board::LINK);
    }

    /// What goes for its own sake, between lines.
    fn give(port: &mut Port) {
        if SAID_ALL.load(Ordering::Relaxed) {
            BULK.give(|bytes| port.write(bytes));
        }
    }

    #[task(binds = OTG_FS, priority = 4, shared = [port, word])]
    fn usb(mut cx: usb::Context) {
        let mut bytes = [0; 64];
        let count = cx.shared.port.lock(|port| {
            let count = port.read(&mut bytes);
            give(port);
            count
        });
        let bytes = bytes.get(..count).unwrap_or_default();
        if !BULK.take(bytes) {
            let word = bytes.iter().rfind(|byte| [BEGIN, GO_ON].contains(byte));
            if let Some(word) = word {
                cx.shared.word.lock(|newest| *newest = Some(*word));
            }
        }
        WATCH.tick(Task::Link);
    }

    /// The window watchdog is about to bite.
    #[task(binds = WWDG, priority = 15)]
    fn watchdog(_: watchdog::Context) {
        board::watchdog(&WATCH)
    }
}
