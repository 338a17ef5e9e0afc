//! The touch: a console at rest goes into the loader in its ROM, any other stays what it is.

use super::{Bench, DARK, On};
use sutura_hil::board_image::{BoardImageError, LOADER, LoaderStart, reset};
use sutura_shared::wire::message::{Command, Mode};

const BAUD: u32 = 1200;

/// Where a tick ends: in a reset or not.
fn resets(bench: &mut Bench) -> bool {
    match bench.try_tick() {
        Ok(()) => false,
        Err(BoardImageError::Reset) => true,
        Err(error) => panic!("{error}"),
    }
}

on_each_board!(a_console_at_rest_goes_into_the_loader_of_its_rom_with_everything_off);
fn a_console_at_rest_goes_into_the_loader_of_its_rom_with_everything_off(on: On) {
    let mut bench = Bench::start(on);
    bench.board.touch(BAUD).unwrap();
    assert!(resets(&mut bench), "it stays");
    assert_eq!(bench.outputs(), DARK);
    // Of the ROM: its stack, its first instruction, mapped as BOOT0 would map it, and no watchdog has been started on the way.
    let start = bench.board.start_loader().unwrap_or_else(|e| panic!("{e}"));
    let expected = LoaderStart {
        stack: LOADER.stack,
        mapped: true,
        watched: false,
    };
    assert_eq!(start, expected);
    assert!(!bench.outputs().enable && !bench.outputs().pulses);
    // The request is used up: the loader's own reset, or a cut supply, starts the console.
    let mut board = bench.board;
    board.boot_again(reset::SOFTWARE).unwrap();
    let mut bench = Bench::of(on, board);
    bench.open();
    assert_eq!(bench.tick().mode, Mode::Idle);
}

on_each_board!(other_rates_and_terminals_that_stay_are_no_touch);
pub(super) fn other_rates_and_terminals_that_stay_are_no_touch(on: On) {
    let mut bench = Bench::start(on);
    bench.board.touch(9600).unwrap();
    bench.board.set_line(BAUD, true).unwrap();
    bench.board.set_line(BAUD, true).unwrap();
    for _ in 0..5 {
        assert_eq!(bench.tick().mode, Mode::Idle);
    }
    // Only then.
    bench.board.set_line(BAUD, false).unwrap();
    assert!(resets(&mut bench));
}

on_each_board!(a_console_that_is_armed_starting_stopping_or_in_a_fault_is_not_touched);
pub(super) fn a_console_that_is_armed_starting_stopping_or_in_a_fault_is_not_touched(on: On) {
    let mut bench = Bench::start(on);
    // In the tick of arming, while pulses begin.
    bench.say(&Command::Arm);
    bench.board.touch(BAUD).unwrap();
    assert_eq!(bench.tick().mode, Mode::Armed);
    for _ in 0..25 {
        bench.tick();
    }
    assert!(bench.outputs().enable);
    bench.board.touch(BAUD).unwrap();
    assert_eq!(bench.tick().mode, Mode::Armed);
    assert!(bench.outputs().enable, "still on");
    // Disarmed, and pulses go on for 20 ms.
    bench.say(&Command::Disarm);
    assert_eq!(bench.tick().mode, Mode::Idle);
    bench.board.touch(BAUD).unwrap();
    assert_eq!(bench.tick().mode, Mode::Idle);
    assert!(bench.outputs().pulses && !bench.outputs().enable);
    // A latched fault.
    bench.board.chip().open_stop();
    for _ in 0..30 {
        bench.tick();
    }
    bench.board.touch(BAUD).unwrap();
    assert_eq!(bench.tick().mode, Mode::Fault);
    bench.board.chip().close_stop();
    bench.tick();
    // What was refused is forgotten: at rest again, it stays, until it is touched anew.
    bench.say(&Command::ClearFault);
    for _ in 0..30 {
        bench.tick();
    }
    assert_eq!(bench.tick().mode, Mode::Idle);
    bench.board.touch(BAUD).unwrap();
    assert!(resets(&mut bench));
}

on_each_board!(a_watchdog_that_starts_with_the_chip_keeps_it_out_of_the_loader);
/// It would bite there, half way through writing.
pub(super) fn a_watchdog_that_starts_with_the_chip_keeps_it_out_of_the_loader(on: On) {
    let mut board = on.power_up();
    board.chip().watchdog_by_option = true;
    board.boot().unwrap();
    let mut bench = Bench::of(on, board);
    bench.open();
    bench.board.touch(BAUD).unwrap();
    for _ in 0..3 {
        assert_eq!(bench.tick().mode, Mode::Idle);
    }
}
