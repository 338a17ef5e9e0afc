//! Needle and thread between two frames, against what can be computed by hand.
#![allow(clippy::expect_used, clippy::indexing_slicing, reason = "tests")]

use crate::common::sample;
use proptest::prelude::*;
use sutura_shared::control::{LocalNeedle, LocalThread};
use sutura_shared::math::{max, min};
use sutura_shared::wire::message::{Course, Friction, Needle, Tension, Thread, Tip};
use sutura_shared::wire::{Header, Message, PROTOCOL_VERSION, Valid};

/// Solved for this console time \[us\].
const SOLVED: u64 = 5_000_000_000;

fn valid<M: Message>(body: M, console_time_us: u64) -> Valid<M> {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: M::KIND,
        session: 1,
        sequence: 1,
        console_time_us,
    };
    Valid::new(header, body).expect("a valid body")
}

/// Straight down; 100 N/m until 0.5 N forward, 0.25 N backward.
const RUBBING: Needle = Needle {
    tool: 0,
    needle: 1,
    slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
    tip: Tip::Inside,
    friction: Friction::Sticks,
    axial_n: 0.0,
    friction_n: [0.5, 0.25],
    stiffness_n_per_m: [100.0, 100.0],
    hold_n: 0.0,
    puncture_n: 0.0,
    punctured_n: 0.0,
    course: Course {
        forward: 0,
        backward: 0,
        points: [[0.0; 2]; 12],
    },
};

/// Held by a boundary that bears 0.1 N more, at 50 N/m: 2 mm.
const HOLDING: Needle = Needle {
    tip: Tip::Holding,
    axial_n: -0.15,
    friction_n: [0.05, 0.05],
    stiffness_n_per_m: [100.0, 50.0],
    hold_n: 0.1,
    puncture_n: 0.2,
    punctured_n: -0.05,
    ..RUBBING
};

/// The grip moved along the needle by `slide_m`.
fn down(slide_m: f32) -> [f32; 6] {
    [0.0, 0.0, -slide_m, 0.0, 0.0, 0.0]
}

/// The axial force with what the frame's tangent makes of the motion: what the console feels \[N\].
fn felt(local: &mut LocalNeedle, body: &Needle, slide_m: f32, now_us: u64) -> f32 {
    let [x, y, z, ..] = local.correction(&down(slide_m), now_us);
    assert_eq!((x, y), (0.0, 0.0));
    body.axial_n - body.stiffness_n_per_m[1] * slide_m - z
}

#[test]
fn a_cycle_of_stick_and_slip_is_that_of_an_elastic_plastic_rod() {
    let mut needle = LocalNeedle::new(&valid(RUBBING, SOLVED));
    // 10 mm forward, back to -10 mm, forward to 10 mm again, in steps of 0.01 mm.
    let way = |step: i32| match step {
        0..=1000 => step,
        1001..=3000 => 2000 - step,
        _ => step - 4000,
    };
    let (mut spent, mut before) = (0.0, None);
    for step in 0..=5000 {
        let slide = way(step) as f32 * 1e-5;
        let force = felt(&mut needle, &RUBBING, slide, SOLVED);
        let expected = match step {
            0..=1000 => max(-100.0 * slide, -0.5),
            1001..=3000 => min(-0.5 + 100.0 * (0.01 - slide), 0.25),
            _ => max(0.25 - 100.0 * (slide + 0.01), -0.5),
        };
        assert!(
            (force - expected).abs() < 2e-4,
            "{step}: {force} {expected}"
        );
        // A closed cycle: from 10 mm to -10 mm and back.
        if let Some((last_slide, last_force)) = before.filter(|_| step > 1000) {
            spent -= f64::from(0.5 * (force + last_force) * (slide - last_slide));
        }
        before = Some((slide, force));
    }
    // Of two ways of 20 mm, 7.5 mm each go into turning the force round.
    let expected = (0.5 + 0.25) * (0.02 - 0.75 / 100.0);
    assert!(
        (spent - expected).abs() < 1e-3 * expected,
        "{spent} {expected}"
    );
}

#[test]
fn turns_and_ways_across_leave_it_alone() {
    let mut needle = LocalNeedle::new(&valid(RUBBING, SOLVED));
    let wrench = needle.correction(&[1e-2, -5e-3, 0.0, 0.1, 0.2, 0.3], SOLVED);
    assert_eq!(wrench, [0.0; 6]);
}

/// A round needle turns about its middle: the moment has its share, and what the slide takes is the axial force.
#[test]
fn the_force_of_a_round_needle_is_along_its_twist() {
    let slide = [0.0, 0.0, -1.0, 0.0, 100.0, 0.0];
    let body = Needle { slide, ..RUBBING };
    let mut needle = LocalNeedle::new(&valid(body, SOLVED));
    // 8 mm along the circle: 0.5 N of the 0.8 N that the tangent has.
    let wrench = needle.correction(&slide.map(|part| part * 8e-3), SOLVED);
    let axial: f32 = wrench.iter().zip(slide).map(|(w, s)| w * s).sum();
    assert!((axial - 0.3).abs() < 1e-5, "{wrench:?}");
    assert!((needle.axial_n() + 0.5).abs() < 1e-6);
}

#[test]
fn a_boundary_gives_way_on_the_console_and_does_so_once() {
    let mut needle = LocalNeedle::new(&valid(HOLDING, SOLVED));
    let mut at = |slide: f32, now_us| felt(&mut needle, &HOLDING, slide, now_us);
    assert!((at(1e-3, SOLVED) + 0.2).abs() < 1e-6);
    // Back and there again: what holds is elastic.
    assert!((at(0.5e-3, SOLVED) + 0.15).abs() < 1e-4);
    assert!((at(1.99e-3, SOLVED) + 0.2495).abs() < 1e-4);
    assert!((at(2.01e-3, SOLVED + 7000) + 0.05).abs() < 1e-6);
    for slide in [2.5e-3, 3e-3, 3e-3] {
        assert!((at(slide, SOLVED + 8000) + 0.05).abs() < 1e-6);
    }
    // Drawn back through the hole it rubs the other way; where the boundary was is nothing any more.
    assert!((at(0.0, SOLVED) - 0.05).abs() < 1e-6);
    assert!((at(2.5e-3, SOLVED) + 0.05).abs() < 1e-6);
    assert_eq!(needle.punctured_us(), Some(SOLVED + 7000));
}

#[test]
fn what_the_host_has_found_ahead_is_gone_through() {
    let mut course = Course {
        forward: 4,
        backward: 2,
        ..Course::default()
    };
    let points = [
        [1e-3, -0.2],
        [2e-3, -0.4],
        [2e-3, -0.1],
        [4e-3, -0.2],
        [1e-3, 0.1],
        [2e-3, 0.15],
    ];
    course.points[..6].copy_from_slice(&points);
    let body = Needle {
        course,
        puncture_n: 0.3,
        axial_n: -0.15,
        ..RUBBING
    };
    let expected = |slide: f32| match slide {
        s if s <= -2e-3 => 0.15,
        s if s <= -1e-3 => 0.05 - 50.0 * s,
        s if s <= 0.0 => -0.15 - 250.0 * s,
        s if s <= 1e-3 => -0.15 - 50.0 * s,
        s if s <= 2e-3 => -200.0 * s,
        s if s <= 4e-3 => -50.0 * s,
        _ => -0.2,
    };
    for (way, _) in [(1.0, "forward"), (-1.0, "backward")] {
        let mut needle = LocalNeedle::new(&valid(body, SOLVED));
        for step in 0..500_u16 {
            let slide = way * f32::from(step) * 1e-5;
            let force = felt(&mut needle, &body, slide, SOLVED);
            assert!((force - expected(slide)).abs() < 1e-5, "{slide}: {force}");
        }
        assert_eq!(needle.punctured_us().is_some(), way > 0.0);
    }
}

/// What went in behind a boundary that gave way on the console is held by friction on the way back, as much as of it is
/// still inside; a course says how friction grows.
#[test]
fn what_has_gone_in_since_a_puncture_rubs_on_the_way_back() {
    const STICK_N_PER_M: f32 = 150.0;
    const RUBS_N_PER_M: f32 = 25.0;
    // The tip comes to the boundary after 2 mm, which bears 0.24 N; it cuts with 0.05 N, and friction comes in with what
    // tissue springs back by.
    let (touch_m, hold_n, cut_n) = (2e-3, 0.24, 0.05);
    let jump_m = touch_m + hold_n / STICK_N_PER_M;
    let inside_m = hold_n / STICK_N_PER_M;
    let first_n = cut_n + RUBS_N_PER_M * inside_m;
    let slides_m = jump_m + first_n / STICK_N_PER_M;
    // As friction grows tissue goes along, and slides back as it gets less.
    let forward_n_per_m = RUBS_N_PER_M / (1.0 + RUBS_N_PER_M / STICK_N_PER_M);
    let backward_n_per_m = RUBS_N_PER_M / (1.0 - RUBS_N_PER_M / STICK_N_PER_M);
    let points = [
        [touch_m, 0.0],
        [jump_m, -hold_n],
        [jump_m, 0.0],
        [slides_m, -first_n],
        [slides_m + 6e-3, -first_n - forward_n_per_m * 6e-3],
        [
            slides_m + 7e-3,
            -first_n - forward_n_per_m * 6e-3 - STICK_N_PER_M * 1e-3,
        ],
        [12e-3, 0.0],
    ];
    let mut course = Course {
        forward: 6,
        backward: 1,
        ..Course::default()
    };
    course.points[..7].copy_from_slice(&points);
    let body = Needle {
        tip: Tip::Outside,
        friction_n: [0.0; 2],
        stiffness_n_per_m: [0.0; 2],
        course,
        ..RUBBING
    };
    let mut needle = LocalNeedle::new(&valid(body, SOLVED));
    let mut at = |slide: f32| felt(&mut needle, &body, slide, SOLVED + 1);
    let deep_m = slides_m + 2e-3;
    let steps =
        |from: f32, to: f32| (1..=200_u16).map(move |n| from + (to - from) * f32::from(n) / 200.0);
    let gone_in_m = inside_m + 2e-3 * (1.0 - forward_n_per_m / STICK_N_PER_M);
    let most_n = RUBS_N_PER_M * gone_in_m;
    let turned_m = (first_n + forward_n_per_m * 2e-3 + most_n) / STICK_N_PER_M;
    let pushed = steps(0.0, deep_m).map(&mut at).last().expect("steps");
    assert!(
        (pushed + first_n + forward_n_per_m * 2e-3).abs() < 1e-3,
        "{pushed}"
    );
    let mut most = 0.0_f32;
    for slide in steps(deep_m, 0.0) {
        let force = at(slide);
        most = max(most, force);
        // First it turns round, then what is still inside rubs.
        if deep_m - slide > 1.1 * turned_m {
            let back_m = deep_m - turned_m - slide;
            let expected = max(most_n - backward_n_per_m * back_m, 0.0);
            let off_n = (force - expected).abs();
            assert!(off_n < 0.003, "{slide}: {force}, {expected}");
        }
    }
    assert!((most - most_n).abs() < 0.003, "{most}");
}

/// Pushes on at 50 mm/s; frames are 16 ms old when they come.
#[test]
fn a_puncture_that_the_host_does_not_know_of_stays_had() {
    let slide = |ms: u64| 5e-5 * ms as f32;
    let mut needle = LocalNeedle::new(&valid(HOLDING, SOLVED));
    // 2 mm after 40 ms.
    for ms in 0..50 {
        felt(&mut needle, &HOLDING, slide(ms), SOLVED + 1000 * ms);
    }
    let had = needle.punctured_us().expect("after 40 ms");
    assert!((SOLVED + 40_000..=SOLVED + 41_000).contains(&had), "{had}");
    // Solved for 34 ms: to this host the boundary would give way 4 ms later.
    let late = Needle {
        axial_n: -0.225,
        hold_n: 0.175,
        ..HOLDING
    };
    let frame = valid(late, SOLVED + 34_000);
    let from = |ms| slide(ms) - slide(34);
    let mut forgetful = LocalNeedle::new(&frame);
    let force = felt(&mut forgetful, &late, from(42), SOLVED + 42_000);
    assert!(
        force < -0.2,
        "without the old one it would hold again: {force}"
    );
    let mut new = LocalNeedle::new(&frame);
    new.adopt(&needle);
    for ms in 50..60 {
        let force = felt(&mut new, &late, from(ms), SOLVED + 1000 * ms);
        assert!((force + 0.05).abs() < 1e-6, "{ms}: {force}");
    }
    assert_eq!(new.punctured_us(), Some(had));
    // And once more; then one that knows, and holds the next boundary.
    let again = valid(late, SOLVED + 34_000);
    let mut third = LocalNeedle::new(&again);
    third.adopt(&new);
    assert!((felt(&mut third, &late, from(60), SOLVED + 60_000) + 0.05).abs() < 1e-6);
    let knows = valid(HOLDING, SOLVED + 50_000);
    let mut fourth = LocalNeedle::new(&knows);
    fourth.adopt(&third);
    let force = felt(
        &mut fourth,
        &HOLDING,
        slide(60) - slide(50),
        SOLVED + 60_000,
    );
    assert_eq!(fourth.punctured_us(), None);
    assert!((force + 0.175).abs() < 1e-4, "{force}");
}

/// A frame for an earlier pose of the same way is the same model: nothing changes when it is adopted.
#[test]
fn slips_since_a_frames_time_are_had_again() {
    // 8 mm forward in 40 ms, of which 3 mm slide; then back.
    let slide = |ms: u64| {
        2e-4 * if ms <= 40 {
            ms as f32
        } else {
            80.0 - ms as f32
        }
    };
    let first = RUBBING;
    let mut needle = LocalNeedle::new(&valid(first, SOLVED));
    for ms in 0..=46 {
        felt(&mut needle, &first, slide(ms), SOLVED + 1000 * ms);
    }
    // The host's own, 16 ms old: 6 mm, where it slides at -0.5 N.
    let later = Needle {
        axial_n: -0.5,
        stiffness_n_per_m: [100.0, 0.0],
        friction: Friction::Forward,
        ..RUBBING
    };
    let frame = valid(later, SOLVED + 30_000);
    let mut new = LocalNeedle::new(&frame);
    new.adopt(&needle);
    let mut forgetful = LocalNeedle::new(&frame);
    for ms in 47..=120 {
        let now_us = SOLVED + 1000 * ms;
        let old = felt(&mut needle, &first, slide(ms), now_us);
        let force = felt(&mut new, &later, slide(ms) - slide(30), now_us);
        // Places are kept every 2 ms: the turn is known to one of 0.2 mm.
        assert!((force - old).abs() < 0.021, "{ms}: {force} {old}");
        if ms == 47 {
            let without = felt(&mut forgetful, &later, slide(ms) - slide(30), now_us);
            assert!((without - old).abs() > 0.1, "{without} {old}");
        }
    }
}

const TAUT: Thread = Thread {
    tool: 0,
    thread: 1,
    end: sutura_shared::wire::message::End::Head,
    state: Tension::Taut,
    direction: [0.6, 0.0, 0.8],
    tension_n: 0.5,
    stiffness_n_per_m: 250.0,
    slack_m: 0.0,
};

const SLACK: Thread = Thread {
    state: Tension::Slack,
    tension_n: 0.0,
    slack_m: 3e-3,
    ..TAUT
};

/// The pull along the thread with what the frame's tangent makes of the motion, the grip `way_m` against it.
fn pull(body: &Thread, way_m: f32) -> f32 {
    let local = LocalThread::new(&valid(*body, SOLVED));
    let [a, b, c] = body.direction.map(|part| -part * way_m);
    let [x, y, z, ..] = local.correction(&[a, b, c, 0.1, 0.2, 0.3]);
    let [u, v, w] = body.direction;
    let linear = match body.state {
        Tension::Slack => 0.0,
        _ => body.tension_n + body.stiffness_n_per_m * way_m,
    };
    linear + x * u + y * v + z * w
}

#[test]
fn a_thread_pulls_and_never_pushes_and_is_the_same_from_either_side() {
    for step in -500..500_i16 {
        let way = f32::from(step) * 1e-5;
        let taut = pull(&TAUT, way);
        let expected = max(0.5 + 250.0 * way, 0.0);
        assert!((taut - expected).abs() < 1e-5, "{way}: {taut}");
        let slack = pull(&SLACK, way);
        let expected = max(250.0 * (way - 3e-3), 0.0);
        assert!((slack - expected).abs() < 1e-5, "{way}: {slack}");
        // A frame that is 3 mm slack, and one that is just taut there.
        let there = Thread {
            tension_n: 0.0,
            ..TAUT
        };
        assert!((pull(&there, way - 3e-3) - slack).abs() < 1e-5);
    }
}

/// Numbers of any size within the wire's limits, the limits themselves more often than chance would have them.
fn number(most: f32) -> impl Strategy<Value = f32> {
    prop_oneof![
        Just(0.0),
        Just(most),
        Just(1e-38),
        0.0..=most,
        (0.0..=1.0_f32).prop_map(move |x| x * 1e-3 * most),
        (0.0..=1.0_f32).prop_map(move |x| x * x * x * 1e-6),
    ]
}

fn signed(most: f32) -> impl Strategy<Value = f32> {
    (number(most), any::<bool>()).prop_map(|(x, minus)| if minus { -x } else { x })
}

prop_compose! {
    fn course()(
        forward in 0..=12_u8,
        share in 0.0..=1.0_f32,
        mut ways in proptest::array::uniform12(number(10.0)),
        forces in proptest::array::uniform12(signed(1e4)),
    ) -> Course {
        let (head, tail) = ways.split_at_mut(usize::from(forward));
        head.sort_by(f32::total_cmp);
        tail.sort_by(f32::total_cmp);
        let mut points = [[0.0; 2]; 12];
        for (point, pair) in points.iter_mut().zip(ways.iter().zip(forces)) {
            *point = [*pair.0, pair.1];
        }
        let backward = (share * f32::from(12 - forward)) as u8;
        Course { forward, backward, points }
    }
}

prop_compose! {
    fn any_needle()(
        turns in proptest::array::uniform3(signed(1e4)),
        shifts in proptest::array::uniform3(signed(100.0)),
        straight in any::<bool>(),
        axial_n in signed(1e4),
        friction_n in proptest::array::uniform2(number(1e4)),
        stiffness_n_per_m in proptest::array::uniform2(number(1e7)),
        hold_n in number(1e4),
        puncture_n in number(1e4),
        punctured_n in signed(1e4),
        course in course(),
    ) -> Needle {
        let [a, b, c] = turns;
        let [x, y, z] = shifts;
        let round = turns.iter().any(|turn| *turn != 0.0);
        let slide = if straight || !round { [0.6, 0.0, -0.8, 0.0, 0.0, 0.0] } else { [x, y, z, a, b, c] };
        Needle {
            slide, axial_n, friction_n, stiffness_n_per_m, hold_n, puncture_n, punctured_n, course,
            ..sample::needle()
        }
    }
}

/// Motions of a grip, sound ones and any others.
fn motion() -> impl Strategy<Value = [f32; 6]> {
    prop_oneof![
        proptest::array::uniform6(signed(0.01)),
        proptest::array::uniform6(signed(20.0)),
        proptest::array::uniform6(any::<f32>()),
    ]
}

proptest! {
    #[test]
    fn any_valid_needle_on_any_way_gives_finite_wrenches(
        frames in proptest::collection::vec((any_needle(), 0..60_000_u64), 1..4),
        motions in proptest::collection::vec(motion(), 1..60),
    ) {
        let mut local: Option<LocalNeedle> = None;
        let mut now_us = SOLVED;
        for (body, late_us) in frames {
            let mut new = LocalNeedle::new(&valid(body, now_us.saturating_sub(late_us)));
            if let Some(old) = &local {
                new.adopt(old);
            }
            for dx in &motions {
                now_us += 1000;
                let wrench = new.correction(dx, now_us);
                prop_assert!(wrench.iter().all(|part| part.is_finite()), "{wrench:?} {dx:?}");
                prop_assert!(new.axial_n().abs() <= 1e4);
                // Asking twice changes nothing.
                prop_assert_eq!(new.correction(dx, now_us), wrench);
            }
            local = Some(new);
        }
    }

    #[test]
    fn any_valid_thread_gives_finite_wrenches(
        tension_n in number(1e4),
        stiffness_n_per_m in number(1e7),
        slack_m in number(10.0),
        slack in any::<bool>(),
        dx in motion(),
    ) {
        let state = if slack { Tension::Slack } else { Tension::Taut };
        let body = Thread {
            state,
            tension_n: if slack { 0.0 } else { tension_n },
            slack_m: if slack { slack_m } else { 0.0 },
            stiffness_n_per_m,
            ..TAUT
        };
        let local = LocalThread::new(&valid(body, SOLVED));
        let wrench = local.correction(&dx);
        prop_assert!(wrench.iter().all(|part| part.is_finite()), "{wrench:?}");
    }
}
