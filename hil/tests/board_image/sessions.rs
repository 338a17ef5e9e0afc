//! Sessions: what the image renders is what the shared code renders here, to the bit, as pulses of the right width.

use super::{Bench, Board, DARK, NO_CURRENT, duty};
use sutura_shared::wire::List;
use sutura_shared::wire::message::{Command, Mode, Row, RowKind, Rows, State};

/// A hand that moves: counts of the three encoders in a tick, of which the second goes through the ends of its counter.
fn hand(tick: u32) -> [i32; 3] {
    let t = f64::from(tick) * 1e-3;
    let swing =
        |amplitude: f64, hz: f64| (amplitude * (std::f64::consts::TAU * hz * t).sin()) as i32;
    [swing(2000.0, 2.0), 120 * tick as i32, swing(-1500.0, 3.0)]
}

/// A session of `ticks` ticks with what `say` sends every 16.
fn session(bench: &mut Bench, ticks: u32, mut say: impl FnMut(&mut Bench)) -> Vec<State> {
    bench.arm();
    let mut states = Vec::new();
    for tick in 0..ticks {
        if tick % 16 == 0 {
            say(bench);
        }
        bench.board.chip().lines.encoder_counts = hand(tick);
        states.push(bench.tick());
    }
    states
}

on_each_board!(contacts_are_felt_as_the_shared_code_renders_them);
fn contacts_are_felt_as_the_shared_code_renders_them(on: Board) {
    let mut bench = Bench::start(on);
    let states = session(&mut bench, 500, |bench| {
        let contact = bench.floor();
        bench.say(&contact);
    });
    bench.say_speed("contacts at 62 Hz");
    assert!(bench.compared > 500, "{}", bench.compared);
    // Up, out of the floor, is a longer pulse of motor 3: 4 N of force are 1 A, and 1 A is 8 % of the period.
    let most = states
        .iter()
        .max_by(|a, b| a.force_n[2].total_cmp(&b.force_n[2]));
    let most = most.unwrap();
    assert!(most.force_n[2] > 2.0, "{most:?}");
    assert!((most.current_a[2] - most.force_n[2] / 4.0).abs() < 1e-6);
    let counts = duty(most.current_a[2]) - NO_CURRENT;
    assert!((counts as f32 - 840.0 * most.force_n[2]).abs() <= 1.0);
    // Out of the floor nothing is felt.
    assert!(states.iter().any(|state| state.force_n == [0.0; 3]));
    let second = states.last().unwrap().encoder_counts[1];
    assert!(
        second > i32::from(u16::MAX) / 2 * 120 / 100,
        "{second}: not past its counter's end"
    );
    assert!(states.iter().all(|state| state.mode == Mode::Armed));
}

on_each_board!(rows_are_felt_as_the_shared_code_solves_them);
fn rows_are_felt_as_the_shared_code_solves_them(on: Board) {
    const COUNT: usize = 24;
    let mut bench = Bench::start(on);
    let states = session(&mut bench, 500, |bench| {
        let height = bench.state.unwrap().1.position_m[2];
        let row = |at: usize| Row {
            kind: RowKind::Smooth { id: at as u32 },
            delta_free_m: height + 1e-5 * at as f32,
            lambda_n: 0.0,
            jacobian: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        };
        // Vertices that do not feel each other: W is diagonal.
        let entry = |row: usize, column: usize| if row == column { 0.01 } else { 0.0 };
        let upper = (0..COUNT).flat_map(|row| (row..COUNT).map(move |column| entry(row, column)));
        bench.say(&Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of((0..COUNT).map(row)),
            compliance: List::of(upper),
        });
        let contact = bench.floor();
        bench.say(&contact);
    });
    bench.say_speed("24 rows at 62 Hz");
    assert!(bench.compared > 500, "{}", bench.compared);
    let most = states
        .iter()
        .map(|state| state.force_n[2])
        .fold(0.0, f32::max);
    assert!(most > 2.0, "{most}");
    assert!(states.iter().all(|state| state.mode == Mode::Armed));
}

on_each_board!(pulses_come_20_ms_before_enable_and_go_20_ms_after);
fn pulses_come_20_ms_before_enable_and_go_20_ms_after(on: Board) {
    let mut bench = Bench::start(on);
    assert_eq!(bench.outputs(), DARK);
    bench.say(&Command::Arm);
    let mut shown = Vec::new();
    for _ in 0..24 {
        bench.tick();
        shown.push((bench.outputs().pulses, bench.outputs().enable));
    }
    let enabled = shown.iter().position(|(_, enable)| *enable).unwrap();
    assert_eq!(enabled, 20, "{shown:?}");
    assert!(
        shown[..enabled].iter().all(|(pulses, _)| *pulses),
        "{shown:?}"
    );
    bench.push();
    bench.changes();
    bench.say(&Command::Disarm);
    let mut after = 0;
    assert_eq!(bench.tick().mode, Mode::Idle);
    // Enable before the widths.
    let first = bench.changes()[0];
    assert!(!first.enable && first.pulses && first.duty[2] != NO_CURRENT);
    while bench.outputs().pulses {
        assert_eq!(
            (bench.outputs().enable, bench.outputs().duty),
            (false, [NO_CURRENT; 3])
        );
        bench.tick();
        after += 1;
        assert!(after < 100, "pulses for ever");
    }
    assert_eq!(after, 20);
    bench.say_speed("arming and stopping");
}

on_each_board!(a_silent_host_is_felt_no_longer_and_then_disarmed);
/// The core's cycle counter stands still in all of this: QEMU has none.
fn a_silent_host_is_felt_no_longer_and_then_disarmed(on: Board) {
    let mut bench = Bench::start(on);
    bench.push();
    let sent_us = bench
        .state
        .map(|(time, state)| time - u64::from(state.contact_age_us))
        .unwrap();
    let (mut none_after, mut off_after) = (None, None);
    for _ in 0..700 {
        let state = bench.tick();
        let age_us = bench.state.unwrap().0 - sent_us;
        if state.current_a == [0.0; 3] {
            none_after.get_or_insert(age_us);
            assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
        } else {
            assert_eq!(none_after, None, "a force that comes back");
        }
        if !bench.outputs().enable {
            off_after.get_or_insert(age_us);
        }
    }
    // Horizon and 30 ms of decay; horizon and 500 ms.
    assert!(none_after.unwrap() <= 131_000, "{none_after:?}");
    assert!(off_after.unwrap() <= 601_000, "{off_after:?}");
    assert_eq!(bench.outputs(), DARK);
    bench.say_speed("a silent host");
}
