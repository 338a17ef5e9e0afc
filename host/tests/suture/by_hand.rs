//! A span outside that a hand takes and pulls: what comes from which side, and what it feels.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::mesh::TetMesh;
use sutura_host::step::StepReport;
use sutura_host::thread::{
    ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadTension, Through,
};

const GRIP_N: f64 = 0.2;

/// A thread that has been wound up `times`; its span behind the first bite is in the hand that had the needle.
fn taken(times: u32, friction: f64) -> Bench {
    // All but the lower side is held.
    let still = thick(|at| at[2] > -0.0199);
    let through = Through {
        grip_n: GRIP_N,
        ..ELASTIC
    };
    taken_in(still, times, friction, through)
}

/// The same in other tissue.
fn taken_in(mesh: (TetMesh, Vec<u32>), times: u32, friction: f64, through: Through) -> Bench {
    let with = ThreadPart {
        friction,
        through,
        ..part(Through::default())
    };
    let mut bench = wound_up_in(mesh, times, with);
    // Thread on the needle's side, for what the hand draws from there.
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
    go(&mut bench, Vector3::new(0.0, 0.0, 0.05));
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    assert!(bench.hold(0, None));
    let path = bench.path(7);
    let place = path
        .iter()
        .position(|point| point.what == ThreadPlace::Leaves);
    let place = place.expect("a way out");
    let [from, to] = [place, place + 1].map(|place| Vector3::from(path[place].at_m));
    bench.grip.translation.vector = (from + to) / 2.0 + Vector3::new(0.0, 0.0, 1e-3);
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(0));
    bench
}

fn pull_n(report: &StepReport) -> f64 {
    Vector3::from_column_slice(&report.contacts()[0].wrench[..3]).norm()
}

/// Where the hand is on the path.
fn place_of_hand(path: &[ThreadPoint]) -> usize {
    let place = path
        .iter()
        .rposition(|point| point.what == ThreadPlace::End && point.along_m < 0.0);
    place.expect("a hand")
}

/// Nowhere outside is there less thread than way, but to the needle, which nobody holds.
fn lasts(path: &[ThreadPoint]) {
    for two in path[..path.len() - 1].windows(2) {
        if matches!(two[0].what, ThreadPlace::End | ThreadPlace::Leaves) {
            let way_m = Vector3::from(two[0].at_m).metric_distance(&Vector3::from(two[1].at_m));
            let there_m = (two[1].along_m - two[0].along_m) * (1.0 + two[0].tension_n / EA_N);
            assert!(way_m <= there_m + 1e-6, "{way_m} {there_m} {two:?}");
        }
    }
}

/// Pulled until it slips through the hand, it has what friction leaves of that at the tail, and comes from the needle's side for nothing.
#[test]
fn a_span_is_pulled_from_the_tail() {
    for times in [2, 3] {
        let mut bench = taken(times, 0.1);
        let before = bench.path(7);
        let slack = bench.step_both();
        assert_eq!(slack.threads()[0].state, ThreadTension::Slack);
        assert_eq!(pull_n(&slack), 0.0);
        let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
        let thread = report.threads()[0];
        let path = bench.path(7);
        let place = place_of_hand(&path);
        let theta = turn_rad(&path[..=place]);
        let (tail, hand) = (thread.tension_n[0], only_hand(&report));
        let head = hand.tension_n[0];
        println!("{times}: {tail} {head} {theta}");
        assert!((head / GRIP_N - 1.0).abs() < 0.01, "{head}");
        assert!(hand.slipped_m[0] > 5e-3, "{thread:?}");
        let ratio = head / tail / (0.1 * theta).exp();
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
        assert!((pull_n(&report) / head - 1.0).abs() < 1e-6, "{report:?}");
        assert_eq!((thread.held_by, hand.tool), ([Some(1), None], Some(0)));
        assert!(path[place..].iter().all(|point| point.tension_n == 0.0));
        // As many faces as there were, and what came from the needle's side went along them.
        assert_eq!(path.len(), before.len());
        let came_m = path[place + 1].along_m - before[place + 1].along_m;
        assert!(came_m > 0.01, "{came_m}");
        lasts(&path);
    }
}

/// What the hand does to the path before it is the same whatever lies beyond.
#[test]
fn what_lies_beyond_does_not_matter() {
    let pulled = |times| {
        let mut bench = taken(times, 0.2);
        let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.02));
        let thread = report.threads()[0];
        [thread.tension_n[0], only_hand(&report).tension_n[0]]
    };
    let [two, three] = [2, 3].map(pulled);
    for (a, b) in two.into_iter().zip(three) {
        assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
    }
}

/// Let go it is slack; taken up by the needle's hand it is whole again, and no thread is lost.
#[test]
fn let_go_it_is_one_length_again() {
    let mut bench = taken(2, 0.1);
    go(&mut bench, Vector3::new(0.0, 0.0, 0.01));
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Free);
    let thread = bench.step_both().threads()[0];
    assert_eq!(
        (thread.state, thread.tension_n),
        (ThreadTension::Slack, [0.0; 2])
    );
    let path = bench.path(7);
    assert!(path.iter().all(|point| point.tension_n == 0.0));
    assert_eq!(path.last().map(|last| last.along_m), Some(0.0));
    lasts(&path);
    // Somewhere else, by the other end of the same hold.
    bench.grip.translation.vector.z = 0.02;
    hold(&mut bench, ThreadEnd::Head, ThreadHold::Tool(0));
    let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
    let thread = report.threads()[0];
    assert_eq!(thread.state, ThreadTension::Taut);
    assert!(thread.tension_n[1] > thread.tension_n[0], "{thread:?}");
}
