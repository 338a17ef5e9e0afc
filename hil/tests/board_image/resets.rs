//! Resets: who makes them, what they find the torque at, and what the next boot says of them.

use super::{Bench, DARK, NO_CURRENT, On};
use sutura_hil::board_image::{ASTRAY, BoardImage, BoardImageError, EXTI0, OTG_FS, reset};
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Mode, Ping};

/// Numbers of `Report::reset_cause` and `Report::epitaph_kind`.
const BY_SOFTWARE: u8 = 3;
const BY_WATCHDOG: u8 = 4;
const BY_FAULT_HANDLER: u8 = 5;
const HARD_FAULT: u8 = 2;
const EXCEPTION: u8 = 3;
const WATCHDOG: u8 = 4;

fn is_reset(result: &Result<(), BoardImageError>) -> bool {
    matches!(result, Err(BoardImageError::Reset))
}

/// The window watchdog's early interrupt, which ends in a reset.
fn warned(board: &mut BoardImage) -> bool {
    match board.window_watchdog() {
        Ok(asked) => {
            assert!(asked, "nobody asked for it");
            false
        }
        Err(error) => is_reset(&Err(error)),
    }
}

/// Cause of the reset, epitaph, and its place, as the host is told after the next boot.
fn told(on: On, board: BoardImage, cause: u32) -> (BoardImage, (u8, u8, u32)) {
    let mut board = board;
    board.boot_again(cause).unwrap_or_else(|e| panic!("{e}"));
    let mut bench = Bench::of(on, board);
    bench.open();
    let report = bench.report.unwrap();
    assert_eq!(bench.outputs(), DARK);
    let place = report.epitaph_place;
    (
        bench.board,
        (report.reset_cause, report.epitaph_kind, place),
    )
}

on_each_board!(a_tick_timer_that_stops_ends_in_the_window_watchdog);
/// When no tick comes nobody feeds the watchdogs, and the window's early interrupt takes the torque off.
pub(super) fn a_tick_timer_that_stops_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    let fed = bench.board.chip().feeds;
    bench.board.serve().unwrap();
    bench.board.idle_steps(300).unwrap();
    assert_eq!(bench.board.chip().feeds, fed, "fed without a tick");
    bench.changes();
    assert!(warned(&mut bench.board));
    // Enable, then the motors, and pulses for no current to the end.
    let changes = bench.changes();
    assert!(
        !changes[0].enable && changes[0].duty[2] != NO_CURRENT,
        "{changes:?}"
    );
    assert!(changes.iter().all(|o| o.pulses && !o.enable), "{changes:?}");
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    // Fed once more: without that the early interrupt would leave 0.8 ms.
    assert_eq!(bench.board.chip().feeds.window, fed.window + 1);
    // The tasks that had ticked: none.
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    assert_eq!(told, (BY_FAULT_HANDLER, WATCHDOG, 0));
    eprintln!("window watchdog: {}", board.speed());
}

on_each_board!(a_crystal_that_fails_takes_the_torque_off_and_resets_again_and_again);
pub(super) fn a_crystal_that_fails_takes_the_torque_off_and_resets_again_and_again(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.changes();
    let lost = bench
        .board
        .lose_crystal()
        .map(|guarded| assert!(guarded, "nobody asked for it"));
    assert!(is_reset(&lost));
    // By the timer first, with no program; pulses go on by the chip's own oscillator.
    let changes = bench.changes();
    assert!(
        !changes[0].enable && changes[0].duty[2] != NO_CURRENT,
        "{changes:?}"
    );
    assert!(changes.iter().all(|o| o.pulses && !o.enable), "{changes:?}");
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    // Without a crystal it waits, off, until the independent watchdog bites.
    let mut board = bench.board;
    assert!(is_reset(&board.boot_again(reset::SOFTWARE)));
    assert!(board.chip().watchdog_runs && !board.chip().outputs().enable);
    assert!(is_reset(&board.boot_again(reset::INDEPENDENT_WATCHDOG)));
    board.chip().lines.crystal = true;
    let (board, first) = told(on, board, reset::INDEPENDENT_WATCHDOG);
    // What the handler left outlives those boots, until a host has been told.
    assert_eq!(first, (BY_WATCHDOG, EXCEPTION, -14_i32 as u32));
    let (board, second) = told(on, board, reset::SOFTWARE);
    assert_eq!(second, (BY_SOFTWARE, 0, 0));
    eprintln!("crystal: {}", board.speed());
}

on_each_board!(before_a_reset_pulses_go_on_for_20_ms_by_the_clock_that_is_there);
/// Longer than an amplifier's enable takes, and shorter than the window watchdog: 168 MHz, and the 16 that a failed crystal leaves. A round
/// of the wait is two instructions and 3 to 5 cycles (ARM 100166, 3.3).
pub(super) fn before_a_reset_pulses_go_on_for_20_ms_by_the_clock_that_is_there(on: On) {
    for (core_hz, crystal) in [(168e6, true), (16e6, false)] {
        let mut board = on.power_up_counting();
        board.boot().unwrap_or_else(|error| panic!("{error}"));
        board.instructions().unwrap();
        let before = board.instructions_so_far().unwrap();
        let ended = if crystal {
            board.run_astray()
        } else {
            board.lose_crystal().map(|_| ())
        };
        assert!(is_reset(&ended));
        let took = board.instructions_so_far().unwrap().wrapping_sub(before);
        let waited_s = [3.0, 5.0].map(|cycles| f64::from(took) / 2.0 * cycles / core_hz);
        assert!(waited_s[0] > 19e-3 && waited_s[1] < 45e-3, "{waited_s:?} s");
    }
}

on_each_board!(without_a_crystal_for_three_boots_it_starts_and_says_so_and_never_arms);
/// On the chip's own oscillator, with the fault that clocks have; the next boot that finds the crystal is as any other.
pub(super) fn without_a_crystal_for_three_boots_it_starts_and_says_so_and_never_arms(on: On) {
    let mut board = on.power_up();
    board.chip().lines.crystal = false;
    assert!(is_reset(&board.boot()));
    for _ in 0..2 {
        assert!(is_reset(&board.boot_again(reset::INDEPENDENT_WATCHDOG)));
    }
    let fourth = board.boot_again(reset::INDEPENDENT_WATCHDOG);
    fourth.unwrap_or_else(|error| panic!("{error}"));
    // The time base's fault is no part of what a state says of its inputs: the twin has no such board.
    let mut bench = Bench::of(on, board);
    bench.compares = false;
    bench.open();
    bench.say(&Command::Arm);
    for _ in 0..40 {
        let state = bench.tick();
        assert_eq!((state.mode, state.faults), (Mode::Fault, faults::TIME_BASE));
    }
    bench.say(&Command::ClearFault);
    assert_eq!(bench.tick().faults, faults::TIME_BASE);
    assert!(!bench.outputs().enable && !bench.outputs().pulses);
    let mut board = bench.board;
    board.chip().lines.crystal = true;
    let (board, told) = told(on, board, reset::SOFTWARE);
    assert_eq!(told, (BY_SOFTWARE, 0, 0));
    eprintln!("own oscillator: {}", board.speed());
}

on_each_board!(a_start_waits_for_the_supply_under_a_watchdog);
pub(super) fn a_start_waits_for_the_supply_under_a_watchdog(on: On) {
    let mut board = on.power_up();
    board.chip().lines.supply_low = true;
    let booted = board.boot();
    assert!(is_reset(&booted), "{booted:?}");
    board.chip().lines.supply_low = false;
    let (board, told) = told(on, board, reset::INDEPENDENT_WATCHDOG);
    assert_eq!(told, (BY_WATCHDOG, 0, 0));
    eprintln!("supply awaited: {}", board.speed());
}

on_each_board!(an_nmi_leaves_its_number);
/// The exception's number is the epitaph's place: -14 is the NMI.
pub(super) fn an_nmi_leaves_its_number(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    assert!(bench.board.lose_crystal().is_err());
    bench.board.chip().lines.crystal = true;
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    assert_eq!(told, (BY_FAULT_HANDLER, EXCEPTION, -14_i32 as u32));
    eprintln!("NMI: {}", board.speed());
}

on_each_board!(a_crystal_that_never_swings_is_waited_for_under_a_watchdog);
pub(super) fn a_crystal_that_never_swings_is_waited_for_under_a_watchdog(on: On) {
    let mut board = on.power_up();
    board.chip().lines.crystal = false;
    let booted = board.boot();
    assert!(is_reset(&booted), "{booted:?}");
    assert!(board.chip().changes.iter().all(|o| !o.enable && !o.pulses));
    board.chip().lines.crystal = true;
    let (board, told) = told(on, board, reset::INDEPENDENT_WATCHDOG);
    assert_eq!(told, (BY_WATCHDOG, 0, 0));
    eprintln!("no crystal: {}", board.speed());
}

on_each_board!(a_control_task_that_hangs_ends_in_the_window_watchdog);
/// In the middle of a tick, at the second highest priority: the watchdog's is higher.
pub(super) fn a_control_task_that_hangs_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.begin_and_stand().unwrap();
    bench.changes();
    assert!(warned(&mut bench.board));
    let changes = bench.changes();
    assert!(!changes[0].enable, "{changes:?}");
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    assert_eq!((told.0, told.1), (BY_FAULT_HANDLER, WATCHDOG));
    eprintln!("a control task that hangs: {}", board.speed());
}

on_each_board!(a_telemetry_task_that_hangs_ends_in_the_window_watchdog);
/// While the two others go on: nobody is fed, and the epitaph names them.
pub(super) fn a_telemetry_task_that_hangs_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.board.mask(EXTI0).unwrap();
    let fed = bench.board.chip().feeds;
    for host_us in 0..50 {
        bench.say(&Ping { host_us });
        let down: Vec<u8> = bench.down.drain(..).collect();
        bench.board.send(&down);
        bench.board.tick_without_idle().unwrap();
    }
    bench.board.idle_steps(300).unwrap();
    assert_eq!(bench.board.chip().feeds, fed, "fed without telemetry");
    assert!(warned(&mut bench.board));
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    // Control and link.
    assert_eq!(told, (BY_FAULT_HANDLER, WATCHDOG, 0b011));
    eprintln!("a telemetry task that hangs: {}", board.speed());
}

on_each_board!(a_link_task_that_hangs_alone_ends_in_the_window_watchdog);
/// In a loop, at its own priority: the control task interrupts it, tick after tick, and goes on to push. Telemetry and idle wait.
pub(super) fn a_link_task_that_hangs_alone_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.hang_link().unwrap();
    let fed = bench.board.chip().feeds;
    bench.changes();
    // The window watchdog warns 49 ms after it was last fed.
    for tick in 0..48 {
        bench.board.chip().lines.encoder_counts[2] += if tick % 2 == 0 { 5 } else { -5 };
        bench.board.tick_alone().unwrap();
        let changes = bench.changes();
        assert!(!changes.is_empty(), "the control task does nothing");
        assert!(
            changes.iter().all(|o| o.enable && o.duty[2] != NO_CURRENT),
            "{changes:?}"
        );
    }
    assert_eq!(bench.board.chip().feeds, fed, "fed without the link");
    assert!(warned(&mut bench.board));
    let changes = bench.changes();
    assert!(
        !changes[0].enable && changes[0].duty[2] != NO_CURRENT,
        "{changes:?}"
    );
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    // Control.
    assert_eq!(told, (BY_FAULT_HANDLER, WATCHDOG, 0b001));
    eprintln!("a link task that hangs: {}", board.speed());
}

on_each_board!(a_task_that_hangs_with_interrupts_off_ends_in_the_window_watchdog);
/// In a critical section of its own: no tick, no warning, no handler, and no epitaph. What was commanded last stands until the window
/// watchdog bites, 49.9 ms after it was last fed.
pub(super) fn a_task_that_hangs_with_interrupts_off_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    let fed = bench.board.chip().feeds;
    bench.board.hang_with_interrupts_off().unwrap();
    bench.changes();
    for _ in 0..48 {
        bench.board.tick_alone().unwrap();
    }
    assert!(!warned(&mut bench.board), "with interrupts off");
    assert_eq!(bench.changes(), [], "somebody lets interrupts in");
    assert_eq!(bench.board.chip().feeds, fed);
    assert!(bench.board.chip().window_runs, "nobody would reset it");
    let (board, told) = told(on, bench.board, reset::WINDOW_WATCHDOG);
    assert_eq!(told, (BY_WATCHDOG, 0, 0));
    eprintln!("interrupts off: {}", board.speed());
}

on_each_board!(a_link_task_that_is_called_no_more_ends_in_the_window_watchdog);
/// Its interrupt stays masked, whatever lets it in again; all others have their rounds, idle among them.
pub(super) fn a_link_task_that_is_called_no_more_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.mask_for_good(OTG_FS).unwrap();
    let fed = bench.board.chip().feeds;
    for _ in 0..48 {
        bench.board.tick_alone().unwrap();
    }
    bench.board.idle_steps(300).unwrap();
    assert_eq!(bench.board.chip().feeds, fed, "fed without the link");
    assert!(bench.outputs().enable);
    assert!(warned(&mut bench.board));
    assert!(!bench.outputs().enable);
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    // Control and telemetry.
    assert_eq!(told, (BY_FAULT_HANDLER, WATCHDOG, 0b101));
    eprintln!("a link task that is called no more: {}", board.speed());
}

on_each_board!(a_control_task_that_is_called_no_more_ends_in_the_window_watchdog);
/// While the others are, by an interrupt that has no business to come.
pub(super) fn a_control_task_that_is_called_no_more_ends_in_the_window_watchdog(on: On) {
    let mut bench = Bench::start(on);
    let fed = bench.board.chip().feeds;
    bench.board.interrupt(EXTI0).unwrap();
    bench.board.idle_steps(300).unwrap();
    assert_eq!(bench.board.chip().feeds, fed, "fed without control");
    assert!(warned(&mut bench.board));
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    // Link and telemetry.
    assert_eq!(told, (BY_FAULT_HANDLER, WATCHDOG, 0b110));
    eprintln!("a control task that is called no more: {}", board.speed());
}

on_each_board!(a_program_that_runs_astray_takes_the_torque_off_and_says_where);
pub(super) fn a_program_that_runs_astray_takes_the_torque_off_and_says_where(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.changes();
    assert!(is_reset(&bench.board.run_astray()));
    let changes = bench.changes();
    assert!(!changes[0].enable && changes[0].pulses, "{changes:?}");
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    let (board, told) = told(on, bench.board, reset::SOFTWARE);
    assert_eq!(told, (BY_FAULT_HANDLER, HARD_FAULT, ASTRAY));
    eprintln!("a program that runs astray: {}", board.speed());
}
