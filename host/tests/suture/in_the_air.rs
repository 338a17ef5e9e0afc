//! A thread between two hands with no tissue between them.

use super::one_length::*;
use super::pull::tangents_are_true;
use super::rig::*;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::rod::{Bar, BarPart};
use sutura_host::step::{State, StepReport, Workspace};
use sutura_host::thread::{
    ThreadBody, ThreadContact, ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadTension,
    Through,
};

/// Of the thread \[m\]: 1667 N/m.
const SHORT_M: f64 = 0.12;
/// At most between two hands \[N/m\].
const STIFFEST_N_PER_M: f64 = 2000.0;

/// A needle above a slab in the hands of tool 0, the tail of its thread in those of tool 1, `apart_m` from the needle's end along
/// `way`.
fn between(with: ThreadPart, way: Vector3<f64>, apart_m: f64) -> Bench {
    let start = frame([0.001, 0.002, 0.03], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let with = ThreadPart {
        length_m: SHORT_M,
        ..with
    };
    let mut bench = threaded(thick(sides), (straight(0.02), start), with);
    bench.step_both();
    bench.other.translation.vector = end_m(&bench) + way.normalize() * apart_m;
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    bench
}

/// Where the thread is fastened to the needle, which points down \[m\].
fn end_m(bench: &Bench) -> Vector3<f64> {
    let above = [0.0, 0.0, 100.0];
    let end = bench.state.nearest_of_needle(&bench.model, 0, &above);
    end.expect("a needle").into()
}

/// Of so much thread between two hands \[N/m\].
fn stiffness_n_per_m(axial_stiffness_n: f64, length_m: f64) -> f64 {
    (axial_stiffness_n / length_m).min(STIFFEST_N_PER_M)
}

fn force_n(report: &StepReport, tool: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&report.contacts()[tool].wrench[..3])
}

/// The hand at the tail, `apart_m` from the needle's end along `way`.
fn apart(bench: &mut Bench, way: Vector3<f64>, apart_m: f64) -> StepReport {
    bench.other.translation.vector = end_m(bench) + way.normalize() * apart_m;
    let report = bench.step_both();
    assert_eq!(report.status.name(), "ok");
    report
}

/// Any way: slack up to its length, and beyond as stiff as itself, along and across, for both hands alike; no tissue moves.
#[test]
fn between_two_hands_it_is_a_spring() {
    let ways = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.3, -0.5, 0.4]];
    for way in ways.map(Vector3::from) {
        let along = way.normalize();
        let mut bench = between(part(ELASTIC), way, 0.9 * SHORT_M);
        let report = apart(&mut bench, way, 0.999 * SHORT_M);
        assert_eq!(report.threads()[0].state, ThreadTension::Slack);
        for tool in [0, 1] {
            assert_eq!(force_n(&report, tool), Vector3::zeros());
        }
        for strain in [0.001, 0.004, 0.002] {
            let report = apart(&mut bench, way, SHORT_M * (1.0 + strain));
            let thread = report.threads()[0];
            let expected = EA_N * strain;
            assert_eq!(thread.state, ThreadTension::Taut);
            for (tool, pull) in [(0, along), (1, -along)] {
                let off = (force_n(&report, tool) - pull * expected).norm();
                assert!(off < 1e-9 * expected.max(1.0), "{off} {report:?}");
            }
            for tension_n in thread.tension_n {
                assert!((tension_n - expected).abs() < 1e-9, "{thread:?}");
            }
            let tangent = nalgebra::Matrix6::from(report.contacts()[1].tangent);
            let block = tangent.fixed_view::<3, 3>(0, 0);
            let stiffness = -along.dot(&(block * along));
            let slope = EA_N / SHORT_M;
            assert!(
                (stiffness / slope - 1.0).abs() < 1e-6,
                "{stiffness} {slope}"
            );
            tangents_are_true(&mut bench, &report);
            assert_eq!(bench.largest_displacement_m(), 0.0);
        }
        let report = apart(&mut bench, way, 0.99 * SHORT_M);
        assert_eq!(report.threads()[0].state, ThreadTension::Slack);
        assert_eq!(report.threads()[0].available_m, SHORT_M);
    }
}

/// What it bears is what the grip and the thread bear, stretching or not; what slips through the grip, or breaks off, is counted.
#[test]
fn between_two_hands_it_gives_way() {
    let way = Vector3::new(0.2, 1.0, 0.4);
    for axial_stiffness_n in [EA_N, f64::INFINITY] {
        let elastic = Through {
            axial_stiffness_n,
            ..INEXTENSIBLE
        };
        let grip_n = 1.5;
        let mut bench = between(part(Through { grip_n, ..elastic }), way, 0.02);
        // A place on it with enough behind it for the grip.
        let held_m = 0.03;
        hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
        apart(&mut bench, way, held_m);
        hold(&mut bench, ThreadEnd::Head, ThreadHold::Tool(1));
        let mut slipped_m = 0.0;
        for step in 0..=40 {
            let over_m = 1e-4 * f64::from(step);
            let report = apart(&mut bench, way, held_m + over_m);
            let there_m = -only_hand(&report).along_m;
            let stiffness = stiffness_n_per_m(axial_stiffness_n, held_m + slipped_m);
            let expected = (stiffness * (over_m - slipped_m)).min(grip_n);
            let found_n = force_n(&report, 1).norm();
            assert!(
                (found_n - expected).abs() < 0.01 * grip_n,
                "{found_n} {expected} {over_m}"
            );
            slipped_m = there_m - held_m;
            let stiffness = stiffness_n_per_m(axial_stiffness_n, there_m);
            let off_m = there_m + found_n / stiffness - held_m - over_m;
            assert!(off_m.abs() < 1e-6, "{off_m} {over_m}");
        }
        assert!(slipped_m > 3e-3, "{slipped_m}");

        let strength_n = 2.0;
        let weak = ThreadPart {
            strength_n,
            ..part(elastic)
        };
        let mut bench = between(weak, way, 0.02);
        let (mut most_n, mut is_broken) = (0.0f64, false);
        for step in 1..=20 {
            let report = apart(&mut bench, way, SHORT_M + 1e-4 * f64::from(step));
            // In the step in which it breaks that is felt by the hand that keeps it.
            let found_n = force_n(&report, 0).norm();
            assert_eq!(found_n == 0.0, is_broken, "{found_n}");
            most_n = most_n.max(found_n);
            is_broken = report.threads()[0].broken_off_m.is_some();
        }
        assert!((most_n - strength_n).abs() < 1e-9, "{most_n}");
        assert!(is_broken);
    }
}

/// Taken anywhere, from the tissue to the needle and beside that, a thread without tension has none from being taken, and locks as soon as the needle goes on.
#[test]
fn what_is_taken_is_no_tauter() {
    let start = drawn_through(thick(sides), part(ELASTIC));
    let path = start.path(7);
    let out = path.iter().rfind(|point| point.what == ThreadPlace::Leaves);
    let [out, end] = [Vector3::from(out.expect("a way out").at_m), end_m(&start)];
    for place in [ThreadEnd::Span, ThreadEnd::Head] {
        for part in [0.1, 0.5, 0.9] {
            for aside in [0.0, 1e-3, 4e-3] {
                let mut bench = drawn_through(thick(sides), self::part(ELASTIC));
                let at = out + (end - out) * part + Vector3::x() * aside;
                bench.other.translation.vector = at;
                hold(&mut bench, place, ThreadHold::Tool(1));
                let report = bench.step_both();
                let hand = only_hand(&report);
                assert!(
                    hand.tension_n.iter().all(|tension_n| *tension_n < 1e-9),
                    "{hand:?}"
                );
                // Up to the needle nothing is slack, and from there on it pulls at both.
                let on = (end_m(&bench) - Vector3::from(hand.at_m)).normalize();
                let by_m = 2e-5;
                bench.grip.translation.vector += on * by_m;
                let report = bench.step_both();
                let expected = stiffness_n_per_m(EA_N, -hand.along_m) * by_m;
                let [tail_n, head_n] = only_hand(&report).tension_n;
                assert!(
                    (head_n / expected - 1.0).abs() < 1e-3,
                    "{head_n} {expected} {place:?} {part} {aside}"
                );
                assert_eq!(tail_n, 0.0);
            }
        }
    }
}

/// Turned by any angle the hands feel the same, turned.
#[test]
fn a_bare_thread_knows_no_direction() {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.9, 0.5));
    let way = Vector3::new(0.5, 0.5, 0.2);
    let felt = [UnitQuaternion::identity(), turn].map(|turn| {
        let way = turn * way;
        let mut bench = between(part(ELASTIC), way, 0.02);
        let report = apart(&mut bench, way, 1.003 * SHORT_M);
        turn.inverse() * force_n(&report, 1)
    });
    assert!((felt[0] - felt[1]).norm() < 1e-9, "{felt:?}");
}

/// Beyond a puncture: the hand that has the head pulls at a needle that is held elsewhere, and not at the tissue between its other side and a
/// free tail.
#[test]
fn a_hand_and_a_needle_pull_at_each_other() {
    let mut bench = drawn_through(thick(sides), part(ELASTIC));
    let before = bench.step_both();
    assert_eq!(before.threads()[0].punctures, 2);
    // The needle's end is below; the hand takes the thread between the two.
    let path = bench.path(7);
    let out = path.iter().rfind(|point| point.what == ThreadPlace::Leaves);
    let out = Vector3::from(out.expect("a way out").at_m);
    let end = end_m(&bench);
    bench.other.translation.vector = out + (end - out) * 0.4;
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    let held = bench.step_both();
    let there_m = -only_hand(&held).along_m;
    let report = go(&mut bench, Vector3::new(0.0, 0.0, -1e-3));
    let far_m = (end_m(&bench) - bench.other.translation.vector).norm();
    let expected = stiffness_n_per_m(EA_N, there_m) * (far_m - there_m);
    assert!(expected > 1.0, "{expected} {there_m}");
    for (tool, pull) in [(0, Vector3::z()), (1, -Vector3::z())] {
        let off = (force_n(&report, tool) - pull * expected).norm();
        assert!(off < 1e-3 * expected, "{expected} {report:?}");
    }
    assert!(bench.largest_displacement_m() < 1e-9);
    tangents_are_true(&mut bench, &report);
}

/// Lifted at its middle by a bar that another hand has: that feels twice the tension times the sine of what the thread turns by, and the needle's
/// hand the tension.
#[test]
fn a_bar_lifts_it() {
    let bar = Bar {
        offset_m: [0.0, 0.0, 0.015],
        axis: [0.0, 0.0, 1.0],
        radius_m: 0.002,
        length_m: 0.03,
        friction: 0.0,
    };
    let with = ThreadBody::Grip(1);
    let mut bench = between(part(ELASTIC), Vector3::x(), 0.5 * SHORT_M);
    let model = bench
        .model
        .with_bars(&bench.mesh, &[BarPart { tool: 1, bar }]);
    let contacts = [ThreadContact { thread: 7, with }];
    let model = model.expect("a bar").with_thread_contacts(&contacts);
    bench.model = model.expect("a pair");
    (bench.state, bench.work) = (State::new(&bench.model), Workspace::new(&bench.model));
    bench.work.prepare(&bench.model, |_| true);
    assert!(bench.hold(0, Some(0)));
    let half_m = 0.4995 * SHORT_M;
    let (end, tail) = (end_m(&bench), end_m(&bench) + Vector3::x() * 2.0 * half_m);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Place(tail.into()));
    // It lies along y, below the middle.
    let radius_m = bar.radius_m + 0.5 * INEXTENSIBLE.thickness_m;
    bench.other.rotation =
        UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y()).expect("a turn");
    let at = |by_m: f64| (end + tail) / 2.0 + Vector3::z() * (by_m - radius_m);
    let mut checked = 0;
    for step in -4..=32 {
        let by_m = 2.5e-4 * f64::from(step);
        bench.other.translation.vector = at(by_m);
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        let tension_n = report.threads()[0].tension_n[1];
        let high_m = by_m - radius_m;
        let angle = (high_m / half_m).atan() + (radius_m / half_m.hypot(high_m)).asin();
        let expected = Vector3::z() * (-2.0 * tension_n * angle.sin());
        assert!(
            (force_n(&report, 1) - expected).norm() <= 1e-3 * tension_n,
            "{by_m} {expected} {report:?}"
        );
        assert!(
            (force_n(&report, 0).norm() - tension_n).abs() < 1e-6,
            "{report:?}"
        );
        if tension_n > 0.1 {
            assert_eq!(report.threads()[0].laps, 1);
            tangents_are_true(&mut bench, &report);
            checked += 1;
        }
    }
    assert!(checked > 5, "{checked}");
}

/// What pulls, slips and is taken anew allocates nothing.
#[test]
fn steps_without_tissue_allocate_nothing() {
    let way = Vector3::new(0.2, 1.0, 0.4);
    let grip_n = 1.5;
    let mut bench = between(part(Through { grip_n, ..ELASTIC }), way, 0.02);
    let allocated = allocation_counter::measure(|| {
        for step in 0..80 {
            let over_m = 1e-4 * f64::from(step % 20);
            bench.other.translation.vector +=
                way.normalize() * (SHORT_M + over_m) * if step == 0 { 0.5 } else { 1e-3 };
            bench.step_both();
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
