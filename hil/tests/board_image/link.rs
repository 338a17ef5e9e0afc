//! The cable: enumeration, `Hello`, and a line that is flooded.

use super::{Bench, Board, DARK, TIME_LIMIT, image};
use sutura_hil::board_image::{BoardImage, ID, reset};
use sutura_shared::wire::message::{Command, Mode, Ping};

/// Pin modes and functions of the port that the timer drives.
const GPIOC_MODER: u32 = 0x4002_0800;
const GPIOC_AFRL: u32 = 0x4002_0820;
const GPIOC_AFRH: u32 = 0x4002_0824;

on_each_board!(the_image_boots_enumerates_and_answers_with_its_names);
fn the_image_boots_enumerates_and_answers_with_its_names(on: Board) {
    let mut board = BoardImage::start(on, image(on), TIME_LIMIT).unwrap_or_else(|e| panic!("{e}"));
    // The amplifiers have never been touched, and both watchdogs run and are fed.
    let chip = board.chip();
    assert!(
        chip.changes.iter().all(|o| !o.enable && !o.pulses),
        "{:?}",
        chip.changes
    );
    assert_eq!(chip.outputs(), DARK);
    assert!(chip.watchdog_runs && chip.feeds.independent > 0 && chip.feeds.window > 0);
    // PC6 to PC9 are the timer's: alternate function 3.
    assert_eq!(chip.stored(GPIOC_MODER) >> 12 & 0xFF, 0b1010_1010);
    assert_eq!(chip.stored(GPIOC_AFRL) >> 24, 0x33);
    assert_eq!(chip.stored(GPIOC_AFRH) & 0xFF, 0x33);

    let said = board.enumerate().unwrap_or_else(|error| panic!("{error}"));
    // Of several functions, each with its interfaces.
    assert_eq!(
        (said.vendor, said.product, said.class),
        (0x16C0, 0x27DD, 0xEF)
    );
    // Communications, data, and the log; notification up, data down and up, log up: with the control endpoint all four to the host that
    // the F405 has.
    assert_eq!(said.interfaces, [2, 10, 0xFF]);
    assert_eq!(said.endpoints, [0x81, 0x82, 0x01, 0x83]);
    assert_eq!(said.manufacturer, "github.com/sutura");
    assert_eq!(said.name, "Sutura console");
    let [a, b, c] = ID;
    assert_eq!(said.serial_number, format!("{a:08X}{b:08X}{c:08X}"));

    let mut bench = Bench::of(on, board);
    bench.hello();
    bench.tick();
    let hello = bench.hello.unwrap();
    assert!(hello.device_name.starts_with(on.name().as_bytes()));
    assert!(!hello.simulated && hello.tick_hz == 1000 && hello.session != 0);
    let report = bench.report.unwrap();
    // Power-up, and nothing left behind.
    assert_eq!((report.reset_cause, report.epitaph_kind), (1, 0));
    assert!(
        report.stack_free_bytes > 16 * 1024,
        "{}",
        report.stack_free_bytes
    );
    assert_eq!((report.tick_overruns, report.ticks_late), (0, 0));
    bench.say_speed("boot, enumeration, hello");
}

on_each_board!(a_flooded_line_costs_no_tick_and_no_watchdog);
/// Everything that a line can bring, more of it than a tick takes: ticks come, are told of, and all tasks run.
fn a_flooded_line_costs_no_tick_and_no_watchdog(on: Board) {
    let mut bench = Bench::start(on);
    bench.arm();
    bench.compares = false;
    let first = bench.state.unwrap().1.tick;
    let mut random = fastrand::Rng::with_seed(5);
    for tick in 1..=100 {
        let fed = bench.board.chip().feeds;
        // 40 orders at once are more than wait for a tick; then contacts, and noise that is no frame.
        if bench.board.waiting() < 100 {
            for order in 0..40 {
                let ticks = if order == 39 { 1 } else { 2 };
                bench.say(&Command::StateEvery { ticks });
            }
            for _ in 0..4 {
                let contact = bench.floor();
                bench.say(&contact);
            }
            bench.say(&Ping { host_us: tick });
            bench.down.extend((0..256).map(|_| random.u8(1..)));
            bench.down.push(0);
        }
        bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
        let feeds = bench.board.chip().feeds;
        assert!(
            feeds.window > fed.window && feeds.independent > fed.independent,
            "{tick}"
        );
        assert!(bench.board.waiting() > 0, "the line is not flooded");
    }
    bench.say(&Command::StateEvery { ticks: 1 });
    while bench.board.waiting() > 0 {
        bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
    }
    let ticks = bench.board.ticks() - bench.booted;
    let state = bench.tick();
    assert_eq!(u64::from(state.tick), ticks + 1, "from {first}");
    assert_eq!((state.mode, state.faults), (Mode::Armed, 0));
    bench.say_speed("a flooded line");
}

on_each_board!(two_boots_in_a_row_draw_numbers_of_their_own);
/// Without a random generator, and with a converter that gives the same for ever: what RAM keeps makes the difference. The stand-in's
/// generator draws the same every time, and is no chip's.
fn two_boots_in_a_row_draw_numbers_of_their_own(on: Board) {
    let mut bench = Bench::start(on);
    let mut seeds = vec![bench.seed];
    for _ in 0..3 {
        let mut board = bench.board;
        let again = board.boot_again(reset::SOFTWARE);
        again.unwrap_or_else(|error| panic!("{error}"));
        bench = Bench::of(on, board);
        bench.open();
        seeds.push(bench.seed);
    }
    eprintln!("{seeds:08x?}");
    let mut different = seeds.clone();
    different.sort_unstable();
    different.dedup();
    let expected = if on == Board::OlimexH405 {
        1
    } else {
        seeds.len()
    };
    assert_eq!(different.len(), expected, "{seeds:08x?}");
}
