//! A thread between two hands with no tissue between them.

use super::pull::tangents_are_true;
use super::rig::*;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::event::Event;
use sutura_host::step::StepReport;
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPoint, Through};

const EA_N: f64 = 200.0;
const ELASTIC: Through = Through {
    axial_stiffness_n: EA_N,
    ..INEXTENSIBLE
};
const LENGTH_M: f64 = 0.3;

/// The needle in tool 0 far above the tissue, the thread's tail at a place, and tool 1, which turns with it, somewhere between with a span
/// that is slack on both sides.
fn between(through: Through, strength_n: f64) -> Bench {
    let setup = Setup {
        through: Through {
            strands: 4,
            ..through
        },
        strength_n,
        length_m: LENGTH_M,
        ..SETUP
    };
    let mut bench = bench(setup);
    bench.grip.translation.vector.z += 0.1;
    let tail = bench.grip.translation.vector + Vector3::new(0.02, 0.01, 0.05);
    bench.step_both();
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Place(tail.into()));
    bench.other.translation.vector = bench.grip.translation.vector + Vector3::new(0.05, 0.0, 0.02);
    bench.other.rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    bench
}

fn force_n(report: &StepReport, tool: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&report.contacts()[tool].wrench[..3])
}

/// Where the tail, the hand and the needle's end have it.
fn points(bench: &Bench) -> [ThreadPoint; 3] {
    let path = bench.path(7);
    <[ThreadPoint; 3]>::try_from(path).expect("three that hold it")
}

/// Tool 1 goes to so far from the needle's end \[m\], over what there is of thread between.
fn pull(bench: &mut Bench, over_m: f64) -> StepReport {
    let [_, hand, needle] = points(bench);
    let [held, end] = [hand, needle].map(|point| Vector3::from(point.at_m));
    let way = Vector3::new(0.6, 0.0, 0.8);
    bench.other.translation.vector += end + way * (over_m - hand.along_m) - held;
    bench.step_both()
}

/// Nothing while it is slack, then EA times the strain, up to what the grip holds; as hard on the one hand as on the other one, along the
/// thread.
#[test]
fn hands_pull_a_thread_apart() {
    for (through, grip_n, over_m) in [
        (ELASTIC, f64::INFINITY, 1e-3),
        (ELASTIC, f64::INFINITY, 5e-4),
        (ELASTIC, 0.5, 1e-3),
    ] {
        let through = Through { grip_n, ..through };
        let mut bench = between(through, 20.0);
        let slack = pull(&mut bench, -1e-4);
        assert_eq!(force_n(&slack, 0), Vector3::zeros());
        let before_m = -points(&bench)[1].along_m;
        let strain = over_m / before_m;
        let report = pull(&mut bench, over_m);
        let expected_n = (through.axial_stiffness_n * strain).min(grip_n);
        let [own, other] = [0, 1].map(|tool| force_n(&report, tool));
        println!("{grip_n} {over_m}: {} {expected_n}", own.norm());
        assert!((own.norm() / expected_n - 1.0).abs() < 0.01, "{own}");
        assert!((own + other).norm() < 1e-12, "{own} {other}");
        let [tail, hand, needle] = points(&bench);
        let way = Vector3::from(hand.at_m) - Vector3::from(needle.at_m);
        assert!((own.normalize() - way.normalize()).norm() < 1e-9, "{own}");
        assert_eq!((tail.tension_n, hand.tension_n), (0.0, own.norm()));
        // What the grip lets through comes from the other side, is told, and stays as tense.
        let slipped_m = -hand.along_m - before_m;
        let told_m: f64 = report.events().map(slip_m).sum();
        assert!((slipped_m - told_m).abs() < 1e-12, "{slipped_m} {told_m}");
        assert_eq!(slipped_m > 0.0, grip_n.is_finite(), "{slipped_m}");
        let rest = bench.step_both();
        assert!((force_n(&rest, 0) - own).norm() < 1e-9, "{rest:?}");
    }
}

fn slip_m(event: Event) -> f64 {
    match event {
        Event::Slipped { length_m, .. } => length_m,
        other => panic!("{other:?}"),
    }
}

/// Beyond its strength it breaks, which is told with the tension, and pulls no more.
#[test]
fn what_is_pulled_too_hard_breaks_in_the_air() {
    let mut bench = between(ELASTIC, 0.4);
    let bears = pull(&mut bench, 1e-6);
    assert_eq!(bears.events().count(), 0);
    let report = pull(&mut bench, 1e-3);
    let found = report.events().find_map(|event| match event {
        Event::Broke { tension_n, .. } => Some(tension_n),
        _ => None,
    });
    assert_eq!(found, Some(0.4));
    assert_eq!(force_n(&bench.step_both(), 0), Vector3::zeros());
}

/// Both hands' tangents are those of a taut string; and a hand that takes it where it is taut changes nothing for the others.
#[test]
fn a_taut_thread_in_the_air_is_felt_as_a_string() {
    let mut bench = between(ELASTIC, 20.0);
    let report = pull(&mut bench, 2e-4);
    tangents_are_true(&mut bench, &report);
    let before = [0, 1].map(|tool| force_n(&report, tool));
    let [_, hand, needle] = points(&bench);
    let [end, held] = [needle, hand].map(|point| Vector3::from(point.at_m));
    // It is taken where it is, whoever is beside it.
    let beside = (end + held) / 2.0 + Vector3::new(0.0, 4e-3, 0.0);
    hold(
        &mut bench,
        ThreadEnd::Span,
        ThreadHold::Place(beside.into()),
    );
    let taken = bench.step_both();
    let off_n = [0, 1].map(|tool| (force_n(&taken, tool) - before[tool]).norm());
    assert!(before[0].norm() > 0.1, "{}", before[0]);
    assert!(off_n.iter().all(|off_n| *off_n < 1e-9), "{off_n:?}");
}
