//! The application: tasks that only wire the parts together, the same for every board.
//!
//! | task | priority | what |
//! |---|---|---|
//! | `emergency_stop`, `watchdog`, `supply` | 15 | torque off |
//! | `control` | 12 | one tick of `sutura_shared::control`; takes contacts and gives samples by swapping references |
//! | `pulse` | 13 | virtual board: SysTick stands in for TIM7 |
//! | link (`usb`, `uart`) | 4 | bytes to validated contacts and orders |
//! | `telemetry` | 2 | samples to frames, and the log |
//! | `idle` | 0 | watchdogs; on the virtual board the other end of lockstep |

/// For who writes it to a board.
#[used]
#[unsafe(link_section = ".identification")]
static IDENTIFICATION: [u8; 64] =
    sutura_firmware::board::identification(if cfg!(feature = "mutants") {
        "mutants"
    } else {
        "console"
    });

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod sutura {
    use rtic::Mutex;
    use stm32f4xx_hal::pac::Interrupt;
    use sutura_firmware::board::{self, Guard, Plant, Port};
    use sutura_firmware::control_side::ControlSide;
    use sutura_firmware::exchange::Exchange;
    use sutura_firmware::host_side::{HostSide, Orders, Slot};
    use sutura_firmware::watch::{Task, Watch};
    use sutura_shared::console_endpoint::Sample;
    use sutura_shared::control::Control;
    use sutura_shared::link::ConsoleLink;
    use sutura_shared::mutant::stands;
    use sutura_shared::simulated_console::Without;
    use sutura_shared::wire::message::Mode;

    /// Tasks that have run, for the watchdogs.
    static WATCH: Watch = Watch::new();

    #[shared]
    struct Shared {
        contacts: Exchange<'static, Slot>,
        samples: Exchange<'static, Sample>,
        /// Console time of the last tick \[us\].
        last_tick: u64,
        host: HostSide<'static, Port>,
    }

    #[local]
    struct Local {
        control: ControlSide<'static, Plant>,
        newest: &'static mut Sample,
        guard: Guard,
    }

    #[init(local = [
        orders: Orders = Orders::new(),
        slots: [Slot; 3] = [None; 3],
        samples: [Sample; 3] = [Sample::BEFORE_THE_FIRST; 3],
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut core = cx.core;
        board::float_environment(&mut core.FPU);
        let (plant, port, guard, boot) = board::start(core, cx.device);
        board::log(board::Event::Started(boot));
        let (orders_in, orders_out) = cx.local.orders.split();
        let [back, middle, front] = cx.local.slots;
        let [written, between, newest] = cx.local.samples;
        // With motors everything watches, whatever anybody says.
        #[cfg(not(any(feature = "virtual", feature = "mutants")))]
        let Without { tuning, checks } = Without::default();
        #[cfg(any(feature = "virtual", feature = "mutants"))]
        let Without { tuning, checks } = boot.without;
        let link = ConsoleLink::with_checks(board::IDENTITY, boot.seed, checks);
        let control =
            Control::tuned(board::DEVICE, tuning).expect("the board's own description is valid");
        (
            Shared {
                contacts: Exchange::new(middle),
                samples: Exchange::new(between),
                last_tick: 0,
                host: HostSide::new(link, port, orders_in, back, boot.report()),
            },
            Local {
                control: ControlSide::new(control, plant, orders_out, front, written),
                newest,
                guard,
            },
        )
    }

    #[idle(local = [guard], shared = [host])]
    fn idle(cx: idle::Context) -> ! {
        board::idle(cx.shared.host, cx.local.guard, &WATCH)
    }

    /// The 1 kHz tick.
    #[task(binds = TIM7, priority = 12, local = [control], shared = [contacts, samples, last_tick])]
    fn control(mut cx: control::Context) {
        let start = board::cycles();
        let control = cx.local.control;
        cx.shared.contacts.lock(|contacts| control.take(contacts));
        let tick_us = control.tick();
        cx.shared.last_tick.lock(|tick| *tick = tick_us);
        control.finish(board::cycles_between(start, board::cycles()));
        cx.shared.samples.lock(|samples| control.give(samples));
        WATCH.tick(Task::Control);
        rtic::pend(Interrupt::EXTI0);
    }

    /// Frames to the host. No line of any board raises EXTI0; the control task pends it.
    #[task(binds = EXTI0, priority = 2, local = [newest, logged: (Mode, u16) = (Mode::Boot, 0)], shared = [samples, last_tick, host])]
    fn telemetry(mut cx: telemetry::Context) {
        let newest = cx.local.newest;
        if cx.shared.samples.lock(|samples| samples.take(newest)) {
            let due = cx.shared.host.lock(|host| host.report_is_due(newest));
            let stack_free = if due { board::stack_free() } else { 0 };
            let clock_us = cx.shared.last_tick.lock(|tick| clock_us(*tick));
            cx.shared.host.lock(|host| {
                if due {
                    host.report().stack_free_bytes = stack_free;
                }
                if host.send(newest, clock_us) {
                    // Reports say how the last program ended.
                    board::forget_crash();
                }
            });
            let state = &newest.state;
            if (state.mode, state.faults) != *cx.local.logged {
                *cx.local.logged = (state.mode, state.faults);
                board::log(board::Event::Mode {
                    mode: state.mode as u8,
                    faults: state.faults,
                });
            }
        }
        if let Some(event) = board::noticed() {
            board::log(event);
        }
        WATCH.tick(Task::Telemetry);
        // The orders have been taken: what an interrupt did not bring, and what did not fit before.
        board::let_link_run();
        rtic::pend(board::LINK);
    }

    /// Bytes from the host, over USB.
    #[cfg(not(feature = "virtual"))]
    #[task(binds = OTG_FS, priority = 4, shared = [contacts, last_tick, host])]
    fn usb(cx: usb::Context) {
        board::before_link();
        receive(cx.shared.contacts, cx.shared.last_tick, cx.shared.host);
    }

    /// Bytes from the host, over the UART; in lockstep `idle` pends it.
    #[cfg(feature = "virtual")]
    #[task(binds = USART1, priority = 4, shared = [contacts, last_tick, host])]
    fn uart(cx: uart::Context) {
        receive(cx.shared.contacts, cx.shared.last_tick, cx.shared.host);
    }

    /// The console's clock \[us\], from the last tick; under the lock that keeps the next one from running.
    fn clock_us(tick_us: u64) -> u64 {
        tick_us + u64::from(board::since_tick_us())
    }

    fn receive(
        mut contacts: impl Mutex<T = Exchange<'static, Slot>>,
        mut last_tick: impl Mutex<T = u64>,
        mut host: impl Mutex<T = HostSide<'static, Port>>,
    ) {
        let now_us = last_tick.lock(|tick| clock_us(*tick));
        let has_all = host.lock(|host| {
            host.receive(now_us, |back| {
                contacts.lock(|contacts| contacts.publish(back))
            })
        });
        if !has_all && stands("link_masked") {
            // Its interrupt would come again at once, and again, while what is left waits for a tick.
            cortex_m::peripheral::NVIC::mask(board::LINK);
        }
        WATCH.tick(Task::Link);
    }

    /// The emulator has no timer of the right period but SysTick.
    #[cfg(feature = "virtual")]
    #[task(binds = SysTick, priority = 13)]
    fn pulse(_: pulse::Context) {
        rtic::pend(Interrupt::TIM7);
    }

    /// The break input: the timer has taken enable already.
    #[cfg(not(feature = "virtual"))]
    #[task(binds = TIM1_BRK_TIM9, priority = 15)]
    fn emergency_stop(_: emergency_stop::Context) {
        board::emergency_stop();
    }

    /// The window watchdog is about to bite.
    #[cfg(not(feature = "virtual"))]
    #[task(binds = WWDG, priority = 15)]
    fn watchdog(_: watchdog::Context) {
        board::watchdog(&WATCH)
    }

    /// The chip's supply is low.
    #[cfg(not(feature = "virtual"))]
    #[task(binds = PVD, priority = 15)]
    fn supply(_: supply::Context) {
        board::supply_low();
    }
}
