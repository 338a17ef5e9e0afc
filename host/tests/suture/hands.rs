//! A hand between the ends of a thread, and what it keeps apart.

use super::one_length::*;
use super::pull::tangents_are_true;
use super::rig::*;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::step::StepReport;
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadTension, Through};

/// A thread that has been wound up twice, its tail at a place, its head in the needle that tool 0 has.
fn wound(through: Through, friction: f64) -> Bench {
    let with = ThreadPart {
        friction,
        ..part(through)
    };
    // All but the lower side is held.
    let mut bench = wound_up_in(thick(|at| at[2] > -0.0199), 2, with);
    let tail = bench.other.translation.vector.into();
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Place(tail));
    bench
}

/// The same with its span between the two bites in the hand of tool 1.
fn divided(through: Through, friction: f64) -> Bench {
    let mut bench = wound(through, friction);
    let path = bench.path(7);
    let mut faces = path.iter();
    let place = faces.position(|point| point.what == ThreadPlace::Leaves);
    let place = place.expect("a way out");
    let [from, to] = [place, place + 1].map(|place| Vector3::from(path[place].at_m));
    bench.other.translation.vector = (from + to) / 2.0;
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    bench
}

/// Moves the hand by so much, in steps of 0.1 mm.
fn draw(bench: &mut Bench, way: Vector3<f64>) -> StepReport {
    let steps = (way.norm() / 1e-4).ceil() as usize;
    let mut report = StepReport::default();
    for _ in 0..steps {
        bench.other.translation.vector += way / steps as f64;
        report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
    }
    report
}

fn force_n(report: &StepReport, tool: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&report.contacts()[tool].wrench[..3])
}

/// To draw on one side is not felt on the other one; the hand has both pulls, and no thread goes from side to side.
#[test]
fn what_a_hand_holds_apart_has_two_tensions() {
    let mut bench = divided(ELASTIC, 0.1);
    let start = bench.step_both();
    assert_eq!(start.threads()[0].held_by, [None, Some(0)]);
    let there_m = |report: &StepReport| {
        let thread = report.threads()[0];
        [thread.available_m, only_hand(report).along_m]
    };
    let before = there_m(&start);
    // Out, as far as the side of the tail is slack, and a little more.
    let mut report = bench.step_both();
    while only_hand(&report).tension_n[0] < 0.2 {
        report = draw(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
    }
    let first = only_hand(&report);
    // The needle draws on its side.
    let mut now = first;
    while now.tension_n[1] < 0.5 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
        now = only_hand(&report);
    }
    let thread = report.threads()[0];
    println!("{first:?}\n{now:?}");
    assert_eq!(thread.state, ThreadTension::Taut);
    assert_eq!(there_m(&report), before, "{thread:?}");
    // Only by the tissue between the two.
    let change_n = (now.tension_n[0] - first.tension_n[0]).abs();
    assert!(change_n < 0.02, "{change_n}");
    let pulls = [0, 1].map(|side| Vector3::from(now.direction[side]) * now.tension_n[side]);
    let off_n = (force_n(&report, 1) - pulls[0] - pulls[1]).norm();
    assert!(off_n < 1e-3 * now.tension_n[1], "{off_n}");
    let off_n = force_n(&report, 0).norm() - thread.tension_n[1];
    assert!(off_n.abs() < 1e-3 * thread.tension_n[1], "{off_n}");
}

/// A hand takes what is taut where it is, and pulls it nowhere by that; it then goes along with the hand, which feels it at that place.
#[test]
fn what_is_taut_is_taken_where_it_is() {
    let mut bench = wound(ELASTIC, 0.0);
    let mut report = bench.step_both();
    while report.threads()[0].tension_n[1] < 0.5 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
    }
    let before = report.threads()[0];
    let path = bench.path(7);
    let out = path
        .iter()
        .position(|point| point.what == ThreadPlace::Leaves);
    let [from, to] = [0, 1].map(|next| Vector3::from(path[out.expect("a way out") + next].at_m));
    let middle = (from + to) / 2.0;
    let aside = (to - from).cross(&Vector3::x()).normalize() * 3e-3;
    bench.other.translation.vector = middle + aside;
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    report = bench.step_both();
    let hand = only_hand(&report);
    assert!(
        (Vector3::from(hand.at_m) - middle).norm() < 1e-9,
        "{hand:?}"
    );
    for tension_n in hand
        .tension_n
        .into_iter()
        .chain(report.threads()[0].tension_n)
    {
        let off = tension_n / before.tension_n[1] - 1.0;
        assert!(off.abs() < 1e-6, "{tension_n} {before:?}");
    }
    let pulls = [0, 1].map(|side| Vector3::from(hand.direction[side]) * hand.tension_n[side]);
    let moment = -aside.cross(&(pulls[0] + pulls[1]));
    let felt = Vector3::from_column_slice(&report.contacts()[1].wrench[3..]);
    assert!((felt - moment).norm() < 1e-9, "{felt} {moment}");
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.02, -0.01));
    bench.other.rotation = turn * bench.other.rotation;
    report = bench.step_both();
    assert_eq!(report.status.name(), "ok");
    let there = bench.other.translation.vector - turn * aside;
    let hand = only_hand(&report);
    assert!((Vector3::from(hand.at_m) - there).norm() < 1e-9, "{hand:?}");
}

#[test]
fn a_hand_feels_how_both_sides_change() {
    let mut bench = divided(ELASTIC, 0.0);
    let mut report = bench.step_both();
    while only_hand(&report).tension_n[0] < 0.2 {
        report = draw(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
    }
    while report.threads()[0].tension_n[1] < 0.3 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
    }
    let report = bench.step_both();
    tangents_are_true(&mut bench, &report);
}

/// A grip withstands the difference of both sides. Where that is more, thread comes through it from the other side, whose tail is free.
#[test]
fn a_hand_slips_along_the_thread() {
    let grip_n = 0.2;
    let mut bench = divided(Through { grip_n, ..ELASTIC }, 0.1);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
    let mut report = draw(&mut bench, Vector3::new(0.0, 0.0, 1e-4));
    let from_m = bench.path(7)[0].along_m;
    for _ in 0..60 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 4e-4));
    }
    let now = only_hand(&report);
    println!("{now:?}");
    let [before, after] = now.tension_n;
    assert!(
        (after / grip_n - 1.0).abs() < 0.01 && before == 0.0,
        "{now:?}"
    );
    assert!(
        now.slipped_m[1] > 2e-3 && now.slipped_m[0] == 0.0,
        "{now:?}"
    );
    // All of it has come in at the tail.
    let came_m = bench.path(7)[0].along_m - from_m;
    let off_m = came_m + now.slipped_m[1];
    assert!(off_m.abs() < 1e-6, "{came_m} {now:?}");

    // From a side that is held it comes until that is as taut, less what the grip holds.
    let mut bench = divided(Through { grip_n, ..ELASTIC }, 0.1);
    let all_m = bench.step_both().threads()[0].available_m;
    let mut now = only_hand(&report);
    while now.tension_n[0] < 0.5 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 5e-6));
        now = only_hand(&report);
    }
    let [before, after] = now.tension_n;
    println!("{now:?}");
    assert!(now.slipped_m[1] > 1e-4, "{now:?}");
    assert!(((after - before) / grip_n - 1.0).abs() < 0.01, "{now:?}");
    let thread = report.threads()[0];
    assert!((thread.available_m - all_m).abs() < 1e-9, "{thread:?}");
}

/// When it lets go there is one tension, by friction's rules, and as much thread as before.
#[test]
fn a_hand_that_lets_go_makes_one_of_both() {
    for by in [ThreadHold::Free, ThreadHold::Without(1)] {
        let mut bench = divided(ELASTIC, 0.0);
        let mut report = bench.step_both();
        while report.threads()[0].tension_n[1] < 0.5 {
            report = go(&mut bench, Vector3::new(0.0, 0.0, 2e-4));
        }
        let before = report.threads()[0];
        let sides = only_hand(&report).tension_n;
        assert!(sides[0] < 0.1 && sides[1] > 0.4, "{sides:?}");
        hold(&mut bench, ThreadEnd::Span, ThreadHold::Without(5));
        only_hand(&bench.step_both());
        hold(&mut bench, ThreadEnd::Span, by);
        let report = bench.step_both();
        assert!(report.hands().is_empty(), "{:?}", report.hands());
        let after = report.threads()[0];
        assert!((after.available_m - before.available_m).abs() < 1e-9);
        assert_eq!(after.punctures, before.punctures);
        let [tail, head] = after.tension_n;
        assert!((tail - head).abs() < 1e-9 && tail < sides[1], "{after:?}");
    }
}

/// Taken elsewhere by the same hand it is let go where it was; there is no room for more hands than were asked for.
#[test]
fn a_hand_has_one_place() {
    let mut bench = divided(ELASTIC, 0.0);
    let path = bench.path(7);
    let last = path.iter().rfind(|point| point.what == ThreadPlace::Leaves);
    let last = Vector3::from(last.expect("a way out").at_m);
    let between = (last + bench.grip.translation.vector) / 2.0;
    bench.other.translation.vector = between;
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    let report = bench.step_both();
    // Beyond it is the needle alone: it holds the head, from what tool 0 has of it.
    assert_eq!(report.threads()[0].held_by, [None, Some(1)]);
    assert_eq!(only_hand(&report).tool, Some(1));
    // Let go that is nothing.
    assert!(bench.hold(0, None));
    let report = bench.step_both();
    assert_eq!(report.threads()[0].held_by, [None, Some(1)]);
    assert!(report.hands().is_empty(), "{:?}", report.hands());
    let samples = [bench.sample_of(0), bench.sample_of(1)];
    let by = ThreadHold::Place([0.0, 0.0, 0.01]);
    let end = ThreadEnd::Span;
    assert!(!bench.state.hold_thread(&bench.model, 7, end, by, &samples));
}
