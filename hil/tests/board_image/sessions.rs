//! Sessions: what the image renders is what the shared code renders here, to the bit, as pulses of the right width.

use super::{Bench, DARK, NO_CURRENT, On, duty};
use sutura_hil::board_image::CycleCounter;
use sutura_shared::wire::List;
use sutura_shared::wire::message::{
    Command, Contact, Course, Friction, Mode, Needle, Row, RowKind, Rows, State, Tip,
};

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
pub(super) fn contacts_are_felt_as_the_shared_code_renders_them(on: On) {
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
pub(super) fn rows_are_felt_as_the_shared_code_solves_them(on: On) {
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
pub(super) fn pulses_come_20_ms_before_enable_and_go_20_ms_after(on: On) {
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
pub(super) fn a_silent_host_is_felt_no_longer_and_then_disarmed(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    fall_silent(&mut bench);
    bench.say_speed("a silent host");
}

/// The last contact has come: nothing but age follows.
fn fall_silent(bench: &mut Bench) {
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
        assert_eq!(state.faults, 0, "{state:?}");
    }
    // Horizon and 30 ms of decay; horizon and 500 ms.
    assert!(none_after.unwrap() <= 131_000, "{none_after:?}");
    assert!(off_after.unwrap() <= 601_000, "{off_after:?}");
    assert_eq!(bench.outputs(), DARK);
}

on_each_board!(a_cycle_counter_that_races_or_jumps_ages_nothing_and_is_no_fault);
/// With a host and then without one, every state is what the shared code gives here, which has no such counter.
pub(super) fn a_cycle_counter_that_races_or_jumps_ages_nothing_and_is_no_fault(on: On) {
    // A hundred ticks on at every reading, of which a tick has two; and any number, as often back as on.
    for counter in [CycleCounter::Moves(100 * 168_000), CycleCounter::Jumps] {
        let mut bench = Bench::start(on);
        bench.board.chip().lines.cycle_counter = counter;
        bench.push();
        assert_ne!(bench.board.chip().cycles, 0, "nobody reads it");
        fall_silent(&mut bench);
        bench.say_speed("a cycle counter that races or jumps");
    }
}

on_each_board!(a_contact_that_is_to_be_good_for_ever_is_not);
pub(super) fn a_contact_that_is_to_be_good_for_ever_is_not(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    let contact = Contact {
        horizon_us: u32::MAX,
        ..bench.floor()
    };
    bench.say(&contact);
    let solved_us = bench.state.unwrap().0;
    let gone_us = (0..200).find_map(|_| {
        let state = bench.tick();
        (state.current_a == [0.0; 3]).then(|| bench.state.unwrap().0 - solved_us)
    });
    // The longest horizon, and 30 ms of decay.
    assert!(gone_us.is_some_and(|us| us <= 181_000), "{gone_us:?}");
    bench.say_speed("a contact for ever");
}

on_each_board!(a_hard_slope_is_met_at_the_joints_slew_and_in_its_own_direction);
/// 4 N of each motor in a tick: 4000 N/s. A wall of 30 kN/m across two of them, half a millimetre ahead, met at 0.6 m/s, wants 8 N at once.
pub(super) fn a_hard_slope_is_met_at_the_joints_slew_and_in_its_own_direction(on: On) {
    const OUT: [f32; 3] = [0.8, 0.6, 0.0];
    const STIFFNESS: f32 = 30_000.0;
    let mut bench = Bench::start(on);
    bench.arm();
    // The force may be all there 50 ms after arming.
    for _ in 0..60 {
        bench.tick();
    }
    let mut tangent = [0.0; 21];
    for (place, share) in [
        (0, OUT[0] * OUT[0]),
        (1, OUT[0] * OUT[1]),
        (6, OUT[1] * OUT[1]),
    ] {
        tangent[place] = -STIFFNESS * share;
    }
    let ahead = Contact {
        wrench: [0.0; 6],
        tangent,
        gap_m: 5e-4,
        normal: OUT,
        ..bench.floor()
    };
    bench.say(&ahead);
    bench.tick();
    let mut before = [0.0; 3];
    let mut most = 0.0_f32;
    for tick in 1..=12 {
        // 120 counts are 0.6 mm.
        let way = -120.0 * tick.min(4) as f32;
        bench.board.chip().lines.encoder_counts = OUT.map(|part| (part * way) as i32);
        let state = bench.tick();
        let change = (state.current_a[0] - before[0]).abs();
        assert!(change <= 1.0 + 1e-6, "{change} A in a tick");
        // Currents are as the slope lies: 4 to 3.
        let across = OUT[0] * state.current_a[1] - OUT[1] * state.current_a[0];
        assert!(across.abs() < 1e-3, "{:?}", state.current_a);
        most = most.max(change);
        before = state.current_a;
    }
    assert!(most > 0.999, "{most} A: nothing was limited");
    bench.say_speed("a hard slope");
}

on_each_board!(a_rough_session_is_felt_as_the_shared_code_renders_it);
/// What ordinary sessions leave out: a needle that comes back, rows that do not converge, a hand that swings, an outage, and forces that no
/// tissue has, with a grip as fast as it may be.
pub(super) fn a_rough_session_is_felt_as_the_shared_code_renders_it(on: On) {
    let mut bench = Bench::start(on);
    bench.arm();
    needle_and_back(&mut bench);
    stubborn_rows(&mut bench);
    swing(&mut bench);
    forces_that_no_tissue_has(&mut bench);
    bench.say_speed("a rough session");
    let (_, state) = bench.state.unwrap();
    assert_eq!((state.mode, state.faults), (Mode::Armed, 0));
}

/// 7 mm in and out again, with one frame.
fn needle_and_back(bench: &mut Bench) {
    let mut course = Course {
        forward: 4,
        ..Course::default()
    };
    let points = [[2e-3, 0.0], [3.6e-3, -0.24], [3.6e-3, 0.0], [12e-3, -0.4]];
    course.points[..4].copy_from_slice(&points);
    bench.say(&Needle {
        tool: 0,
        needle: 0,
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Outside,
        friction: Friction::Sticks,
        axial_n: 0.0,
        friction_n: [0.0; 2],
        stiffness_n_per_m: [150.0; 2],
        hold_n: 0.0,
        puncture_n: 0.24,
        punctured_n: 0.0,
        course,
    });
    let contact = Contact {
        wrench: [0.0; 6],
        tangent: [0.0; 21],
        horizon_us: 150_000,
        ..bench.floor()
    };
    bench.say(&contact);
    for tick in 0..140 {
        bench.board.chip().lines.encoder_counts[2] -= if tick < 70 { 20 } else { -20 };
        bench.tick();
    }
}

/// Twelve pairs that press each other on, almost as far as themselves.
fn stubborn_rows(bench: &mut Bench) {
    for tick in 0..64 {
        if tick % 16 == 0 {
            let height = bench.state.unwrap().1.position_m[2];
            let row = |at: usize| Row {
                kind: RowKind::Smooth { id: at as u32 },
                delta_free_m: height - 1e-4 * (at % 5) as f32,
                lambda_n: 0.0,
                jacobian: [0.02 * at as f32, 0.0, 1.0, 0.0, 0.0, 0.0],
            };
            let entry = |row: usize, column: usize| match (row, column) {
                _ if row == column => 0.01,
                _ if row / 2 == column / 2 => -0.0099,
                _ => 0.0,
            };
            let upper = (0..24).flat_map(|row| (row..24).map(move |column| entry(row, column)));
            let rows = Rows {
                tool: 0,
                held: [0.0; 21],
                curvature_per_m: 0.0,
                rows: List::of((0..24).map(row)),
                compliance: List::of(upper),
            };
            bench.say(&rows);
            let contact = bench.floor();
            bench.say(&contact);
        }
        bench.board.chip().lines.encoder_counts[2] += if tick < 32 { -8 } else { 8 };
        bench.tick();
    }
}

/// 2 mm at 20 Hz about 2 mm deep, as a grip on a contact does whose delay is told wrong; then no host for 0.16 s.
fn swing(bench: &mut Bench) {
    for tick in 0..400 {
        let silent = (200..360).contains(&tick);
        if tick % 16 == 0 && !silent {
            let contact = bench.floor();
            bench.say(&contact);
        }
        let phase = std::f64::consts::TAU * 0.02 * f64::from(tick);
        let z = match tick {
            ..200 => -400.0 * phase.sin() - 4.0 * f64::from(tick.min(100)),
            _ => -400.0,
        };
        bench.board.chip().lines.encoder_counts[2] = z as i32;
        bench.tick();
    }
}

/// A new one every other tick, in any direction, with a grip that goes to and fro at 1 m/s.
fn forces_that_no_tissue_has(bench: &mut Bench) {
    let mut random = fastrand::Rng::with_seed(11);
    let mut number = |most: f32| most * (2.0 * random.f32() - 1.0);
    let mut pace = 0_i32;
    for tick in 0..160 {
        if tick % 2 == 0 {
            let push = [9.0, number(6.0), number(6.0)];
            let stiffness = 500.0 + number(400.0);
            let mut tangent = [0.0; 21];
            for (place, share) in [(0, 1.0), (6, 0.5), (11, 0.8), (1, 0.2)] {
                tangent[place] = -stiffness * (share + number(0.1));
            }
            let contact = Contact {
                wrench: [push[0], push[1], push[2], 0.0, 0.0, 0.0],
                tangent,
                normal: [1.0, 0.0, 0.0],
                gap_m: 0.0,
                ..bench.floor()
            };
            bench.say(&contact);
        }
        let [x, y, _] = &mut bench.board.chip().lines.encoder_counts;
        // It turns in three ticks: more at once is no motion.
        let meant = if tick / 40 % 2 == 1 { -205 } else { 205 };
        pace += (meant - pace).clamp(-150, 150);
        *x += pace;
        *y += if tick / 20 % 2 == 1 { -30 } else { 30 };
        bench.tick();
    }
}
