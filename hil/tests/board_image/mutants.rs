//! Each guard taken out once: the check that is there for it fails then, and passes with all of them.
//!
//! The image is one of its own (`sutura-mutants-BOARD`), with a switch in RAM; the one that is shipped has none.

use super::{On, fitted, guards, link, loader, log, pins, registers, resets, sessions, traffic};
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use sutura_hil::board_image::{Board, BoardImageError, default_image, default_mutants, switch_of};
use sutura_shared::control::Guards;
use sutura_shared::link::Checks;

/// A check fails without this guard.
fn notices(board: Board, check: fn(On), guard: &'static str) {
    let on = On::mutant(board, Some(guard));
    let outcome = catch_unwind(AssertUnwindSafe(|| check(on)));
    let Err(panic) = outcome else {
        panic!("without the guard `{guard}` everything that is checked still holds");
    };
    let said = panic.downcast_ref::<String>().map(String::as_str);
    let said = said.or_else(|| panic.downcast_ref::<&str>().copied());
    eprintln!("without `{guard}`: {}", said.unwrap_or("it fails"));
}

/// For each check on a board, the guards that it fails without.
macro_rules! checks {
    ($($board:ident { $($room:ident :: $check:ident: $($guard:ident)*;)* })*) => {
        $($(mod $check {
            use super::*;

            #[test]
            fn all_guards() {
                $room::$check(On::mutant(Board::$board, None));
            }

            $(#[test]
            fn $guard() {
                notices(Board::$board, $room::$check, stringify!($guard));
            })*
        })*)*

        /// All guards that some check notices.
        fn noticed() -> BTreeSet<&'static str> {
            let all = [$($($((stringify!($guard), stringify!($check)),)*)*)*];
            let count = all.len();
            let pairs = BTreeSet::from(all);
            assert_eq!(pairs.len(), count, "a guard that one check is run without twice");
            pairs.into_iter().map(|(guard, _)| guard).collect()
        }
    };
}

checks! {
    OLIMEX_H405 {
        guards::the_emergency_stop_cuts_enable_at_once_and_is_a_fault:
            break_input emergency_stop stop_at_once stop_once stop_again faults_stay;
        guards::a_stop_shorter_than_a_tick_is_a_fault_as_well: stop_flag;
        guards::a_stop_in_the_middle_of_a_tick_lets_no_current_of_that_tick_out: stop_within_tick;
        guards::amplifiers_that_are_not_ready_any_more_are_a_fault: ready_kept fault_wins;
        guards::amplifiers_that_never_get_ready_are_a_fault_520_ms_after_arming_and_have_had_no_force:
            ready_in_time ready_first;
        guards::a_supply_that_dips_between_two_ticks_takes_the_torque_off_at_once_and_is_a_fault:
            supply_interrupt supply_at_once supply_remembered enable_falls no_current;
        guards::a_supply_that_is_low_is_seen_by_the_tick_alone: supply_level;
        guards::clocks_that_contradict_each_other_are_a_fault_in_the_third_tick: time_base;
        guards::ticks_that_take_longer_than_their_period_are_a_fault_in_the_third: overrun;
        guards::periods_that_an_interrupt_swallowed_are_counted: lost_periods swallowed_ticks;
        guards::an_encoder_that_jumps_is_a_fault: encoder_jump;
        guards::a_burst_of_counts_is_a_fault: encoder_burst;
        guards::lost_counts_are_a_fault_until_a_reset_which_takes_a_new_origin: restart;
        guards::a_grip_that_is_too_fast_is_a_fault: overspeed;
        guards::encoders_out_of_reach_are_a_fault: out_of_reach;
        link::a_flooded_line_costs_no_tick_and_no_watchdog: link_masked room_for_orders;
        link::a_reset_of_the_bus_takes_the_torque_off_and_ends_the_session:
            bus_reset_stops bus_reset_closes;
        link::wrong_hellos_are_answered_ten_times_a_second: refusals_apart;
        link::a_new_session_finds_the_console_disarmed: disarm;
        link::a_session_in_which_nothing_comes_for_a_second_is_over: expiry;
        link::a_host_with_other_messages_gets_no_session: schema;
        link::what_is_not_to_be_believed_changes_nothing: checksum session sequence future ownership companions;
        loader::other_rates_and_terminals_that_stay_are_no_touch: touch_rate touch_goes;
        loader::a_console_that_is_armed_starting_stopping_or_in_a_fault_is_not_touched:
            touch_idle touch_off touch_forgotten;
        loader::a_watchdog_that_starts_with_the_chip_keeps_it_out_of_the_loader: touch_watchdog;
        log::a_chip_without_brown_out_level_3_says_so_at_every_start: brown_out_told;
        pins::pins_are_what_the_boards_table_has_and_encoders_meet_no_resistor: pulls_off;
        pins::the_supply_is_watched_at_the_level_that_the_flash_needs: supply_threshold;
        resets::a_tick_timer_that_stops_ends_in_the_window_watchdog:
            tasks_watched watchdog_warns watchdog_stops last_feed epitaph;
        resets::a_telemetry_task_that_hangs_ends_in_the_window_watchdog: telemetry_watched;
        resets::a_link_task_that_hangs_alone_ends_in_the_window_watchdog: fed_at_rest;
        resets::a_task_that_hangs_with_interrupts_off_ends_in_the_window_watchdog: window_watchdog;
        resets::a_link_task_that_is_called_no_more_ends_in_the_window_watchdog: link_watched;
        resets::a_control_task_that_is_called_no_more_ends_in_the_window_watchdog: control_watched;
        registers::every_rate_time_out_filter_and_priority_is_what_the_book_says:
            tick_period pulse_rate independent_time window_time time_base_clock encoder_filter
            stop_priority supply_priority;
        resets::a_crystal_that_fails_takes_the_torque_off_and_resets_again_and_again:
            clock_security exception_stops record_kept;
        resets::before_a_reset_pulses_go_on_for_20_ms_by_the_clock_that_is_there:
            delay_by_clock;
        resets::without_a_crystal_for_three_boots_it_starts_and_says_so_and_never_arms:
            internal_oscillator;
        resets::a_start_waits_for_the_supply_under_a_watchdog: supply_awaited;
        resets::a_crystal_that_never_swings_is_waited_for_under_a_watchdog: watchdog_first;
        resets::a_program_that_runs_astray_takes_the_torque_off_and_says_where: hard_fault_stops;
        sessions::pulses_come_20_ms_before_enable_and_go_20_ms_after:
            pulses_first pulses_last enable_first;
        traffic::a_tick_takes_no_more_than_its_budget: byte_budget;
        sessions::a_silent_host_is_felt_no_longer_and_then_disarmed: console_time horizon lost;
        sessions::a_cycle_counter_that_races_or_jumps_ages_nothing_and_is_no_fault: console_time;
        sessions::a_contact_that_is_to_be_good_for_ever_is_not: longest_horizon;
        sessions::contacts_are_felt_as_the_shared_code_renders_them:
            contact_ramp blend trust lead tank damping force;
        sessions::a_hard_slope_is_met_at_the_joints_slew_and_in_its_own_direction: slew;
        sessions::a_rough_session_is_felt_as_the_shared_code_renders_it:
            rubs residual swing bend along credit power;
    }
    NUCLEO_F446ZE {
        registers::converters_run_within_their_limit: converter_clock;
        fitted::a_motors_supply_that_is_unfit_under_power_is_a_fault: motor_supply;
        fitted::sensors_that_are_broken_or_hot_are_a_fault: sensors;
    }
}

/// Names in `stands("...")` of a source file, outside of its tests.
fn named(text: &str) -> impl Iterator<Item = &str> {
    let own = text.split("#[cfg(test)]\nmod tests {").next();
    let calls = own.unwrap_or_default().split("stands(\"").skip(1);
    calls.filter_map(|rest| rest.split('"').next())
}

fn sources(folder: &Path, out: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = std::fs::read_to_string(path).unwrap();
            out.extend(named(&text).map(str::to_owned));
        }
    }
}

#[test]
fn every_guard_that_can_be_taken_out_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut guards = BTreeSet::new();
    for folder in ["firmware/src", "shared/src"] {
        sources(&root.join(folder), &mut guards);
    }
    guards.extend(
        Guards::NAMES
            .into_iter()
            .chain(Checks::NAMES)
            .map(str::to_owned),
    );
    let taken_out: BTreeSet<_> = noticed().into_iter().map(str::to_owned).collect();
    assert_eq!(guards, taken_out);
}

/// What is flashed has no switch, and no other image is taken for one that has.
#[test]
fn no_image_for_a_console_has_the_switch() {
    for board in Board::ALL {
        let shipped = switch_of(&default_image(board));
        assert!(
            matches!(shipped, Err(BoardImageError::NoSwitch { .. })),
            "{shipped:?}"
        );
    }
    let switch = switch_of(&default_mutants(Board::OLIMEX_H405)).unwrap();
    assert!((0x2001_0000..0x2002_0000).contains(&switch), "{switch:#x}");
}
