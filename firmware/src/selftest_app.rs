//! The self-test's application: checks in the tick, their lines over USB and to the log. No amplifier may be connected.
//!
//! | priority | task | bound to | does |
//! |---|---|---|---|
//! | 12 | control | TIM7 | a tick of the self-test |
//! | 4 | usb | OTG_FS | `t` begins it |
//! | 2 | report | EXTI0, pended by control | lines to the host |
//! | 0 | idle | | feeds the watchdogs when all three ran |

/// For who writes it to a board.
#[used]
#[unsafe(link_section = ".identification")]
static IDENTIFICATION: [u8; 64] = sutura_firmware::board::identification("selftest");

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod selftest {
    use core::fmt::Write;
    use heapless::{Deque, String};
    use stm32f4xx_hal::pac::Interrupt;
    use sutura_firmware::board::{self, BareRig, Guard, Plant, Port};
    use sutura_firmware::control_side::Plant as _;
    use sutura_firmware::host_side::Bytes;
    use sutura_firmware::selftest::{Left, Line, Seen, SelfTest};
    use sutura_firmware::watch::{Task, Watch};

    static WATCH: Watch = Watch::new();

    #[shared]
    struct Shared {
        port: Port,
        lines: Deque<Line, 24>,
        asked: bool,
    }

    #[local]
    struct Local {
        plant: Plant,
        rig: BareRig,
        test: SelfTest,
        guard: Guard,
        /// Bytes that the host has not taken yet.
        rest: String<128>,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut core = cx.core;
        board::float_environment(&mut core.FPU);
        let (plant, port, guard, boot) = board::start(core, cx.device);
        board::log(board::Event::Started(boot));
        let report = boot.report();
        let left = Left {
            reset_cause: report.reset_cause,
            epitaph_kind: report.epitaph_kind,
        };
        let rig = BareRig::of(&plant);
        (
            Shared {
                port,
                lines: Deque::new(),
                asked: false,
            },
            Local {
                plant,
                rig,
                test: SelfTest::new(left),
                guard,
                rest: String::new(),
            },
        )
    }

    #[idle(local = [guard], shared = [port])]
    fn idle(cx: idle::Context) -> ! {
        board::idle(cx.shared.port, cx.local.guard, &WATCH)
    }

    #[task(binds = TIM7, priority = 12, local = [plant, rig, test], shared = [lines, asked])]
    fn control(mut cx: control::Context) {
        let input = cx.local.plant.read(false);
        if cx.shared.asked.lock(core::mem::take) {
            cx.local.test.start();
        }
        let seen = Seen {
            counts: input.encoder_counts,
            supply_low: input.supply_low,
            clocks_contradict: input.time_base_fault,
        };
        let found = cx.local.test.tick(cx.local.rig, &seen);
        cx.shared.lines.lock(|lines| {
            for line in found.into_iter().flatten() {
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
        if rest.is_empty()
            && let Some(line) = cx.shared.lines.lock(Deque::pop_front)
        {
            board::log_line(&line);
            // As long as a line may be, and two more.
            let _ = write!(rest, "{line}\r\n");
        }
        let count = cx.shared.port.lock(|port| port.write(rest.as_bytes()));
        let mut left = String::new();
        let _ = left.push_str(rest.get(count..).unwrap_or_default());
        *rest = left;
        WATCH.tick(Task::Telemetry);
        rtic::pend(board::LINK);
    }

    #[task(binds = OTG_FS, priority = 4, shared = [port, asked])]
    fn usb(mut cx: usb::Context) {
        let mut bytes = [0; 64];
        let count = cx.shared.port.lock(|port| port.read(&mut bytes));
        if bytes.iter().take(count).any(|byte| *byte == b't') {
            cx.shared.asked.lock(|asked| *asked = true);
        }
        WATCH.tick(Task::Link);
    }
}
