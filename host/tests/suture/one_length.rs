//! A thread of one length through outside and inside: what a pull on it does.

use super::rig::*;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::needle::{Needle, NeedleSettings};
use sutura_host::step::{State, StepReport, Workspace};
use sutura_host::thread::{
    ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadReport, ThreadTension,
    Through,
};

pub(super) const LENGTH_M: f64 = 0.3;
pub(super) const EA_N: f64 = 200.0;
pub(super) const ELASTIC: Through = Through {
    axial_stiffness_n: EA_N,
    ..INEXTENSIBLE
};

pub(super) fn part(through: Through) -> ThreadPart {
    ThreadPart {
        id: 7,
        needle: 0,
        length_m: LENGTH_M,
        friction: 0.0,
        strength_n: 20.0,
        through,
    }
}

/// A slab of 30 x 30 x 20 mm, its top at z = 0, the nodes held of which `is_held` says so.
pub(super) fn thick(is_held: impl Fn(&[f64; 3]) -> bool) -> (TetMesh, Vec<u32>) {
    let mesh = slab([0.03, 0.03, 0.02], [7, 7, 5]).expect("a slab");
    let nodes = (0u32..).zip(mesh.points_m());
    let held = nodes.filter(|(_, at)| is_held(at));
    let held = held.map(|(node, _)| node).collect();
    (mesh, held)
}

pub(super) fn sides(at: &[f64; 3]) -> bool {
    at[0].abs() > 0.0149
}

pub(super) fn threaded(
    (mesh, held): (TetMesh, Vec<u32>),
    (needle, start): (Needle, nalgebra::Isometry3<f64>),
    part: ThreadPart,
) -> Bench {
    let settings = NeedleSettings::default();
    let mesh = (mesh, held);
    let mut bench = Bench::new(mesh, Kind::Linear, needle, start, smooth(), settings);
    bench.model = bench.model.with_threads(&[part]).expect("a thread");
    bench.state = State::new(&bench.model);
    bench.work = Workspace::new(&bench.model);
    bench.work.prepare(&bench.model, |_| true);
    assert!(bench.hold(0, Some(0)));
    bench
}

/// The needle drawn straight down through the slab, its tail free.
pub(super) fn drawn_through(mesh: (TetMesh, Vec<u32>), part: ThreadPart) -> Bench {
    let at = [0.0013, 0.0007, 0.042];
    let start = frame(at, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let mut bench = threaded(mesh, (straight(0.04), start), part);
    go(&mut bench, Vector3::new(0.0, 0.0, -0.08));
    bench.other.translation.vector = Vector3::new(0.0013, 0.0007, 0.01);
    bench
}

/// The same, with the tail in the hands of tool 1, in line with the path.
pub(super) fn locked(through: Through) -> Bench {
    let mut bench = drawn_through(thick(sides), part(through));
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    bench
}

/// What there is of thread between the holds is what there was, and what has slipped in.
fn balances(thread: &ThreadReport, length_m: f64) {
    let off = thread.available_m - thread.slipped_m[0] - length_m;
    assert!(off.abs() < 1e-6, "{off} {thread:?}");
}

/// Length inside between the two punctures \[m\].
fn inside_m(path: &[ThreadPoint]) -> f64 {
    let of = |what: ThreadPlace| {
        let point = path.iter().find(|point| point.what == what);
        Vector3::from(point.expect("a puncture").at_m)
    };
    of(ThreadPlace::Enters).metric_distance(&of(ThreadPlace::Leaves))
}

fn pull_n(report: &StepReport) -> f64 {
    Vector3::from_column_slice(&report.contacts()[0].wrench[..3]).norm()
}

/// It is as stiff as itself, moves no tissue, and there is as much of it as before.
#[test]
fn a_straight_thread_locks() {
    let mut bench = locked(ELASTIC);
    let start = bench.step_both().threads()[0];
    let before = inside_m(&bench.path(7));
    let length_m = start.available_m;
    for k in 1..=6 {
        let report = go(&mut bench, Vector3::new(0.0, 0.0, -5e-4));
        let thread = report.threads()[0];
        let strain = f64::from(k) * 5e-4 / length_m;
        let expected = EA_N * strain;
        assert_eq!(thread.state, ThreadTension::Taut);
        assert!(
            (pull_n(&report) / expected - 1.0).abs() < 0.01,
            "{expected} {report:?}"
        );
        let stiffness = report.contacts()[0].tangent[2][2];
        let slope = EA_N / length_m;
        assert!(
            (-stiffness / slope - 1.0).abs() < 0.01,
            "{stiffness} {slope}"
        );
        balances(&thread, length_m);
        let stretched = thread.available_m * (1.0 + thread.tension_n[1] / EA_N);
        assert!((thread.length_m - stretched).abs() < 1e-6, "{thread:?}");
        assert!(bench.largest_displacement_m() < 5e-5);
        assert!((inside_m(&bench.path(7)) - before).abs() < 1e-4);
    }
    // And slack again.
    let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.0035));
    assert_eq!(report.threads()[0].state, ThreadTension::Slack);
    assert!(bench.largest_displacement_m() < 1e-12);
}

/// What does not stretch pulls at once with what its grip holds, or breaks.
#[test]
fn a_straight_thread_that_does_not_stretch_locks() {
    for grip_n in [1.5, f64::INFINITY] {
        let mut bench = locked(Through {
            grip_n,
            ..INEXTENSIBLE
        });
        bench.step_both();
        for k in 1..=5 {
            let report = go(&mut bench, Vector3::new(0.0, 0.0, -2e-4));
            let most_n = if k == 1 {
                part(INEXTENSIBLE).strength_n
            } else {
                0.0
            };
            let expected = if grip_n.is_finite() { grip_n } else { most_n };
            assert!((pull_n(&report) - expected).abs() < 1e-9, "{k} {report:?}");
            assert!(bench.largest_displacement_m() < 1e-12);
        }
        let is_broken = bench.step_both().threads()[0].broken_off_m.is_some();
        assert_eq!(is_broken, grip_n.is_infinite());
    }
}

/// The grip lets the thread slip at what it holds, and no further.
#[test]
fn a_grip_holds_so_much() {
    let grip_n = 1.5;
    let mut bench = locked(Through { grip_n, ..ELASTIC });
    let length_m = bench.step_both().threads()[0].available_m;
    let mut slipped = 0.0;
    for k in 1..=30 {
        let report = go(&mut bench, Vector3::new(0.0, 0.0, -2e-4));
        let thread = report.threads()[0];
        let material = length_m + slipped;
        let strain = (f64::from(k) * 2e-4 - slipped) / material;
        let expected = (EA_N * strain).min(grip_n);
        assert!(
            (pull_n(&report) / expected - 1.0).abs() < 0.01,
            "{expected} {report:?}"
        );
        balances(&thread, length_m);
        slipped = thread.slipped_m[0];
    }
    assert!(slipped > 2e-3, "{slipped}");
}

/// At its strength it breaks, and then it holds nothing; what is left and what is gone is all there was.
#[test]
fn a_thread_breaks_at_its_strength() {
    let strength_n = 2.0;
    let with = ThreadPart {
        strength_n,
        ..part(ELASTIC)
    };
    let mut bench = drawn_through(thick(sides), with);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    let length_m = bench.step_both().threads()[0].available_m;
    let (mut most, mut broken) = (0.0f64, None);
    for k in 1..=40 {
        let report = go(&mut bench, Vector3::new(0.0, 0.0, -1e-4));
        let thread = report.threads()[0];
        let expected = (EA_N * f64::from(k) * 1e-4 / length_m).min(strength_n);
        most = most.max(pull_n(&report));
        if broken.is_some() {
            assert_eq!(pull_n(&report), 0.0);
        } else {
            assert!(
                (pull_n(&report) / expected - 1.0).abs() < 0.01,
                "{expected} {report:?}"
            );
        }
        broken = thread.broken_off_m;
    }
    assert!((most / strength_n - 1.0).abs() < 0.01, "{most}");
    let broken = broken.expect("a break");
    assert!(broken > 0.0 && broken < LENGTH_M);
}

/// Without drag a free tail follows for nothing; with drag for that of the length in tissue.
#[test]
fn a_free_tail_drags() {
    for drag_n_per_m in [0.0, 5.0] {
        let mut bench = drawn_through(
            thick(sides),
            part(Through {
                drag_n_per_m,
                ..ELASTIC
            }),
        );
        for _ in 0..20 {
            let report = go(&mut bench, Vector3::new(0.0, 0.0, -4e-4));
            let thread = report.threads()[0];
            assert_eq!(thread.tension_n[0], 0.0);
            let expected = drag_n_per_m * inside_m(&bench.path(7));
            let off = (pull_n(&report) - expected).abs();
            assert!(off <= 0.01 * expected, "{} {expected}", pull_n(&report));
        }
    }
}

/// Angles between the pieces of a path, from its first point inside to its last \[rad\].
pub(super) fn turn_rad(path: &[ThreadPoint]) -> f64 {
    let at = |place: usize| Vector3::from(path[place].at_m);
    let ways: Vec<_> = (1..path.len())
        .map(|place| at(place) - at(place - 1))
        .collect();
    let long = ways.iter().filter(|way| way.norm() > 1e-9);
    let long: Vec<_> = long.collect();
    long.windows(2).map(|two| two[0].angle(two[1])).sum()
}

/// A half-circle needle drawn `times` in at x = 8 mm and out at -8 mm through tissue that does not move, its tail in a grip
/// that slips; both ends leave the tissue upwards.
pub(super) fn wound_up(times: u32, with: ThreadPart) -> Bench {
    // All but the lower side is held.
    wound_up_in(thick(|at| at[2] > -0.0199), times, with)
}

/// The same in other tissue.
pub(super) fn wound_up_in(mesh: (TetMesh, Vec<u32>), times: u32, with: ThreadPart) -> Bench {
    let radius = 0.008;
    let start = frame([-radius, -0.004, 1e-4], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
    let mut bench = threaded(mesh, (arc(radius, 170.0), start), with);
    for _ in 0..times {
        for _ in 0..360 {
            let by = 1f64.to_radians();
            let by = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, by, 0.0));
            let at = bench.grip.translation.vector;
            let centre = Vector3::new(0.0, at.y, 1e-4);
            bench.grip.translation.vector = centre + by * (at - centre);
            bench.grip.rotation = by * bench.grip.rotation;
            assert_eq!(bench.step_both().status.name(), "ok");
        }
        go(&mut bench, Vector3::new(0.0, 0.0015, 0.0));
    }
    go(&mut bench, Vector3::new(0.0, -0.0015, 0.0));
    assert_eq!(bench.step_both().threads()[0].punctures, 2 * times);
    bench.other.translation.vector = Vector3::new(radius, -0.004, 0.02);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    bench
}

/// With a weight on the tail, which a grip is that slips: T e^(mu theta), either way, and it stays so.
#[test]
fn friction_along_a_path_is_that_of_a_capstan() {
    let (friction, grip_n) = (0.1, 0.2);
    let with = ThreadPart {
        friction,
        ..part(Through { grip_n, ..ELASTIC })
    };
    for times in [1, 2, 4] {
        let mut bench = wound_up(times, with);
        let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
        let [tail, head] = report.threads()[0].tension_n;
        let theta = turn_rad(&bench.path(7));
        println!("{times}: {tail} {head} {theta}");
        assert!(theta > f64::from(2 * times - 1) * 3.0);
        assert!((tail / grip_n - 1.0).abs() < 0.01, "{tail}");
        let ratio = head / tail / (friction * theta).exp();
        assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
        let mut still = bench.step_both();
        for _ in 1..60 {
            still = bench.step_both();
        }
        let still = still.threads()[0];
        assert!((still.tension_n[1] - head).abs() < 1e-6, "{still:?}");
        assert!((still.slipped_m[0] - report.threads()[0].slipped_m[0]).abs() < 1e-9);
        // Back by a micrometre at a time, until it slides the other way.
        let mut least = f64::MAX;
        for _ in 0..1000 {
            bench.grip.translation.vector.z -= 1e-6;
            let [tail, head] = bench.step_both().threads()[0].tension_n;
            if tail < 0.01 {
                break;
            }
            least = least.min(head / tail * (friction * theta).exp());
        }
        println!("{least}");
        assert!((least - 1.0).abs() < 0.01, "{least}");
    }
}
