//! Everything that takes the torque off: on the pins at once, in the state of the next tick with the right fault.

use super::{Bench, DARK, NO_CURRENT, On};
use sutura_hil::board_image::reset;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Mode};

/// TIM1's interrupt enable register, and the break's bit.
const TIM1_DIER: u32 = 0x4001_000C;
const BREAK: u32 = 1 << 7;

/// The next tick is in fault, with these faults and no torque; and stays off until somebody clears it.
pub(super) fn fault(bench: &mut Bench, expected: u16) {
    let state = bench.tick();
    assert_eq!((state.mode, state.faults), (Mode::Fault, expected));
    assert!(!bench.outputs().enable);
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    for _ in 0..40 {
        assert_eq!(bench.tick().mode, Mode::Fault);
    }
    assert_eq!(bench.outputs(), DARK);
}

/// With the cause gone the console can be armed again, and not before it is told.
pub(super) fn recover(bench: &mut Bench) {
    bench.say(&Command::Arm);
    assert_eq!(
        bench.tick().mode,
        Mode::Fault,
        "armed without being cleared"
    );
    bench.say(&Command::ClearFault);
    let state = bench.tick();
    assert_eq!((state.mode, state.faults), (Mode::Idle, 0));
    bench.arm();
}

on_each_board!(the_emergency_stop_cuts_enable_at_once_and_is_a_fault);
pub(super) fn the_emergency_stop_cuts_enable_at_once_and_is_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.changes();
    bench.board.chip().open_stop();
    // By the timer alone, with the program not having run: pulses keep their current until it does.
    let cut = bench.outputs();
    assert!(
        !cut.enable && cut.pulses && cut.duty[2] != NO_CURRENT,
        "{cut:?}"
    );
    assert_eq!(bench.changes(), [cut]);
    // The interrupt: no current, in pulses that go on, and no further interrupt while the line is open.
    bench.board.serve().unwrap();
    let off = bench.outputs();
    assert!(
        !off.enable && off.pulses && off.duty == [NO_CURRENT; 3],
        "{off:?}"
    );
    assert_eq!(bench.board.chip().stored(TIM1_DIER) & BREAK, 0);
    fault(&mut bench, faults::E_STOP);
    // Cleared while it is open: it comes back.
    bench.say(&Command::ClearFault);
    assert_eq!(bench.tick().faults, faults::E_STOP);
    bench.board.chip().close_stop();
    bench.tick();
    assert_eq!(bench.board.chip().stored(TIM1_DIER) & BREAK, BREAK);
    recover(&mut bench);
    bench.say_speed("emergency stop, held");
}

on_each_board!(a_stop_shorter_than_a_tick_is_a_fault_as_well);
pub(super) fn a_stop_shorter_than_a_tick_is_a_fault_as_well(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().open_stop();
    bench.board.chip().close_stop();
    fault(&mut bench, faults::E_STOP);
    recover(&mut bench);
    bench.say_speed("emergency stop, a glitch");
}

on_each_board!(amplifiers_that_are_not_ready_any_more_are_a_fault);
pub(super) fn amplifiers_that_are_not_ready_any_more_are_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().lines.ready = false;
    fault(&mut bench, faults::AMPLIFIER | faults::BOARD);
    bench.board.chip().lines.ready = true;
    recover(&mut bench);
    bench.say_speed("ready lost");
}

on_each_board!(
    amplifiers_that_never_get_ready_are_a_fault_520_ms_after_arming_and_have_had_no_force
);
pub(super) fn amplifiers_that_never_get_ready_are_a_fault_520_ms_after_arming_and_have_had_no_force(
    on: On,
) {
    let mut bench = Bench::start(on);
    bench.board.chip().lines.ready = false;
    // In the floor, which would push.
    bench.board.chip().lines.encoder_counts[2] = -200;
    bench.say(&Command::Arm);
    let mut armed = 0;
    loop {
        if armed % 16 == 0 && bench.state.unwrap().1.mode == Mode::Armed {
            let contact = bench.floor();
            bench.say(&contact);
        }
        let state = bench.tick();
        assert_eq!(
            (state.force_n, bench.outputs().duty),
            ([0.0; 3], [NO_CURRENT; 3])
        );
        if state.mode == Mode::Fault {
            break;
        }
        armed += 1;
        assert!(armed < 1000, "armed for ever");
    }
    assert_eq!(
        bench.state.unwrap().1.faults,
        faults::AMPLIFIER | faults::BOARD
    );
    // The tick that arms, and those up to 520 ms after it.
    assert_eq!(armed, 520);
    assert!(!bench.outputs().enable);
    bench.say_speed("never ready");
}

on_each_board!(a_supply_that_dips_between_two_ticks_takes_the_torque_off_at_once_and_is_a_fault);
pub(super) fn a_supply_that_dips_between_two_ticks_takes_the_torque_off_at_once_and_is_a_fault(
    on: On,
) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.changes();
    bench.board.chip().lines.supply_low = true;
    assert!(
        bench.board.supply_interrupt().unwrap(),
        "nobody asked for it"
    );
    bench.board.chip().lines.supply_low = false;
    // Enable, then the motors; the pulses go on.
    let changes = bench.changes();
    assert!(
        !changes[0].enable && changes[0].duty[2] != NO_CURRENT,
        "{changes:?}"
    );
    let off = bench.outputs();
    assert!(!off.enable && off.pulses && off.duty == [NO_CURRENT; 3]);
    fault(&mut bench, faults::SUPPLY | faults::BOARD);
    recover(&mut bench);
    bench.say_speed("supply");
}

on_each_board!(a_supply_that_is_low_is_seen_by_the_tick_alone);
pub(super) fn a_supply_that_is_low_is_seen_by_the_tick_alone(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().lines.supply_low = true;
    fault(&mut bench, faults::SUPPLY | faults::BOARD);
    bench.say_speed("supply, without its interrupt");
}

on_each_board!(clocks_that_contradict_each_other_are_a_fault_in_the_third_tick);
/// SysTick that stands, and one that runs at eleven times its rate.
pub(super) fn clocks_that_contradict_each_other_are_a_fault_in_the_third_tick(on: On) {
    for counts in [0, 231_000] {
        let mut bench = Bench::start(on);
        bench.push();
        bench.board.chip().lines.systick_per_tick = counts;
        for _ in 0..2 {
            assert_eq!(bench.tick().faults, 0);
        }
        fault(&mut bench, faults::TIME_BASE);
        bench.say_speed("clocks");
    }
}

on_each_board!(ticks_that_take_longer_than_their_period_are_a_fault_in_the_third);
pub(super) fn ticks_that_take_longer_than_their_period_are_a_fault_in_the_third(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().lines.ticks_late = true;
    // The first one is told that the one before was in time.
    for _ in 0..3 {
        assert_eq!(bench.tick().faults, 0);
    }
    fault(&mut bench, faults::OVERRUN);
    bench.say_speed("late ticks");
}

on_each_board!(a_stop_in_the_middle_of_a_tick_lets_no_current_of_that_tick_out);
/// What the tick has read says nothing of it yet; before it writes it looks once more.
pub(super) fn a_stop_in_the_middle_of_a_tick_lets_no_current_of_that_tick_out(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.compares = false;
    bench.board.begin_and_stand().unwrap();
    bench.board.chip().open_stop();
    bench.board.go_on().unwrap();
    // The interrupt has not come yet.
    let off = bench.outputs();
    assert!(!off.enable && off.pulses, "{off:?}");
    assert_eq!(off.duty, [NO_CURRENT; 3]);
    bench.board.serve().unwrap();
    fault(&mut bench, faults::E_STOP);
    bench.say_speed("emergency stop, within a tick");
}

on_each_board!(an_encoder_that_jumps_is_a_fault);
pub(super) fn an_encoder_that_jumps_is_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    // 2.5 m/s, of a joint that can do 2.
    bench.board.chip().lines.encoder_counts[0] += 500;
    fault(&mut bench, faults::ENCODER_JUMP);
    bench.say_speed("an encoder that jumps");
}

on_each_board!(a_burst_of_counts_is_a_fault);
/// 300 counts in each of five ticks, 1.5 m/s: no faster than the joint, and the place would be off by 7.5 mm.
pub(super) fn a_burst_of_counts_is_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().lines.encoder_counts[2] -= 300;
    fault(&mut bench, faults::ENCODER_JUMP);
    bench.say_speed("a burst of counts");
}

on_each_board!(lost_counts_are_a_fault_until_a_reset_which_takes_a_new_origin);
/// Neither orders nor a new session arm it; after a reset the grip is at the origin, where it stands.
pub(super) fn lost_counts_are_a_fault_until_a_reset_which_takes_a_new_origin(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.board.chip().lines.encoder_counts[0] += 500;
    fault(&mut bench, faults::ENCODER_JUMP);
    for order in [Command::ClearFault, Command::Arm] {
        bench.say(&order);
        let state = bench.tick();
        let expected = (Mode::Fault, faults::ENCODER_JUMP);
        assert_eq!((state.mode, state.faults), expected, "{order:?}");
    }
    let mut board = bench.board;
    board
        .boot_again(reset::PIN)
        .unwrap_or_else(|e| panic!("{e}"));
    let mut bench = Bench::of(on, board);
    bench.open();
    bench.arm();
    assert_eq!(bench.tick().position_m, [0.0; 3]);
    bench.say_speed("lost counts");
}

on_each_board!(a_grip_that_is_too_fast_is_a_fault);
pub(super) fn a_grip_that_is_too_fast_is_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    // 1.75 m/s, of 1.5 that a grip may do, for five ticks.
    let fault = (0..20).find_map(|tick| {
        bench.board.chip().lines.encoder_counts[0] += if tick == 0 { 175 } else { 350 };
        let state = bench.tick();
        (state.mode == Mode::Fault).then_some(state.faults)
    });
    assert_eq!(fault, Some(faults::OVERSPEED));
    assert!(!bench.outputs().enable);
    bench.say_speed("a grip that is too fast");
}

on_each_board!(encoders_out_of_reach_are_a_fault);
/// A count that no console of a metre can have: what it stands at when the console boots is believed as it is.
pub(super) fn encoders_out_of_reach_are_a_fault(on: On) {
    let mut board = on.power_up();
    board.chip().lines.encoder_counts[2] = 4_000_000;
    board.boot().unwrap();
    let mut bench = Bench::of(on, board);
    bench.compares = false;
    bench.open();
    bench.say(&Command::Arm);
    let state = bench.tick();
    assert_eq!(
        (state.mode, state.faults),
        (Mode::Fault, faults::OUT_OF_REACH)
    );
    assert_eq!(bench.outputs(), DARK);
    bench.say_speed("out of reach");
}

on_each_board!(periods_that_an_interrupt_swallowed_are_counted);
pub(super) fn periods_that_an_interrupt_swallowed_are_counted(on: On) {
    let mut bench = Bench::start(on);
    let (mut times, mut speeds) = (Vec::new(), Vec::new());
    // 40 counts a period, along z.
    for periods in [1; 100].into_iter().chain([3, 1]) {
        bench.board.chip().lines.systick_per_tick = 21_000 * periods;
        bench.board.chip().lines.encoder_counts[2] += 40 * periods as i32;
        let state = bench.tick();
        speeds.push(state.velocity_m_per_s[2]);
        times.push(bench.state.unwrap().0);
    }
    assert_eq!(
        [times[100] - times[99], times[101] - times[100]],
        [3000, 1000]
    );
    // A period that nobody has seen is no speed.
    let steady = speeds[99];
    assert!(steady != 0.0);
    for speed in &speeds[100..] {
        assert!(
            (speed - steady).abs() < 0.01 * steady.abs(),
            "{speed} m/s of {steady}"
        );
    }
    bench.say_speed("swallowed periods");
}
