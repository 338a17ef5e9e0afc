//! Friction along a thread: what it spends, which way it acts, and that nothing creeps.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::thread::{
    ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadReport, Through,
};

const GRIP_N: f64 = 0.2;
/// Steps of a minute at 200 Hz.
const A_MINUTE: u32 = 60 * 200;

/// Step in tension at each point of a path times what slides over it there, of either sign, from one path to the next \[J\].
fn rubbed_j(before: &[ThreadPoint], after: &[ThreadPoint]) -> f64 {
    assert_eq!(before.len(), after.len());
    let step =
        |path: &[ThreadPoint], place: usize| path[place].tension_n - path[place - 1].tension_n;
    let inner = 1..before.len() - 1;
    let of = |place: usize| {
        let slip = before[place].along_m - after[place].along_m;
        0.5 * (step(before, place) + step(after, place)) * slip
    };
    inner.map(of).map(f64::abs).sum()
}

/// Elastic energy of a path's thread \[J\].
fn stored_j(path: &[ThreadPoint]) -> f64 {
    let pairs = path.windows(2);
    let of = |pair: &[ThreadPoint]| {
        let material_m = pair[1].along_m - pair[0].along_m;
        0.5 * pair[0].tension_n.powi(2) * material_m / EA_N
    };
    pairs.map(of).sum()
}

/// Along a path in tissue that does not move friction spends the steps in tension times what slides over them, and that is what
/// the hand gives less what the tail's grip takes and the thread stores.
#[test]
fn friction_spends_what_slides_over_it() {
    let mut all = Vec::new();
    for friction in [0.0, 0.1, 0.3] {
        let with = ThreadPart {
            friction,
            ..part(Through {
                grip_n: GRIP_N,
                ..ELASTIC
            })
        };
        let mut bench = wound_up(2, with);
        let start = bench.step_both().threads()[0];
        let mut path = bench.path(7);
        let stored = stored_j(&path);
        let (mut rubbed, mut given, mut taken) = (0.0, 0.0, 0.0);
        let mut head_n = start.tension_n[1];
        let mut last = start;
        for _ in 0..300 {
            bench.grip.translation.vector.z += 1e-4;
            let report = bench.step_both();
            assert_eq!(report.status.name(), "ok");
            let thread = report.threads()[0];
            let next = bench.path(7);
            rubbed += rubbed_j(&path, &next);
            let pull_n = -report.contacts()[0].wrench[2];
            given += 0.5 * (head_n + pull_n) * 1e-4;
            let slips_m = thread.slipped_m[0] - last.slipped_m[0];
            taken += 0.5 * (thread.tension_n[0] + last.tension_n[0]) * slips_m;
            (path, last, head_n) = (next, thread, pull_n);
        }
        assert!(last.slipped_m[0] > 5e-3, "{last:?}");
        let spent = last.dissipated_j - start.dissipated_j;
        let books = given - taken - (stored_j(&path) - stored);
        println!(
            "{friction}: {spent} J, steps times slips {rubbed} J, books {books} J of {given} J"
        );
        if friction == 0.0 {
            assert_eq!(spent, 0.0);
            assert!(books.abs() < 0.01 * given, "{books} of {given}");
        } else {
            assert!((spent / rubbed - 1.0).abs() < 0.01, "{spent} {rubbed}");
            assert!((spent / books - 1.0).abs() < 0.01, "{spent} {books}");
        }
        all.push(spent);
    }
    assert!(all[0] < all[1] && all[1] < all[2], "{all:?}");
}

/// Raises the head's hand by 0.1 mm a step until `is_done`.
fn raise_until(bench: &mut Bench, is_done: impl Fn(&ThreadReport) -> bool) {
    while !is_done(&bench.step_both().threads()[0]) {
        bench.grip.translation.vector.z += 1e-4;
    }
}

/// Draws so much from the tail's hand to the head's, in so many steps; each goes along its end of the thread.
fn draw(bench: &mut Bench, steps: u32, length_m: f64) -> ThreadReport {
    let mut thread = bench.step_both().threads()[0];
    for _ in 0..steps {
        let [tail, head] = thread.direction.map(Vector3::from);
        bench.grip.translation.vector -= head * (length_m / f64::from(steps));
        bench.other.translation.vector += tail * (length_m / f64::from(steps));
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        thread = report.threads()[0];
    }
    thread
}

/// Whichever way it slides, friction acts against that, and spends.
#[test]
fn friction_acts_against_either_way() {
    let friction = 0.1;
    let with = ThreadPart {
        friction,
        ..part(ELASTIC)
    };
    for times in [1, 2] {
        let mut bench = wound_up(times, with);
        // Taut, then to and fro with both hands.
        raise_until(&mut bench, |thread| thread.tension_n[1] > 0.5);
        let mut spent = bench.step_both().threads()[0].dissipated_j;
        for way in [1.0, -1.0, 1.0, -1.0] {
            let thread = draw(&mut bench, 40, way * 0.004);
            let [tail, head] = thread.tension_n;
            let theta = turn_rad(&bench.path(7));
            let ratio = (head / tail).ln() / (friction * theta * way);
            println!("{times}: {tail} {head} {theta} {ratio}");
            assert!(tail > 0.05 && head > 0.05, "{tail} {head}");
            assert!((ratio - 1.0).abs() < 0.01, "{tail} {head} {ratio}");
            assert!(thread.dissipated_j > spent + 1e-5, "{thread:?} {spent}");
            spent = thread.dissipated_j;
        }
    }
}

/// How far anything of two paths is apart, in space or along the thread \[m\].
fn apart_m(a: &[ThreadPoint], b: &[ThreadPoint]) -> f64 {
    assert_eq!(a.len(), b.len());
    let apart = a.iter().zip(b).map(|(a, b)| {
        let way = Vector3::from(a.at_m).metric_distance(&Vector3::from(b.at_m));
        way.max((a.along_m - b.along_m).abs())
    });
    apart.fold(0.0, f64::max)
}

/// A minute of stillness: what is held stays as tense and where it is, and so does what has been let go.
#[test]
fn nothing_creeps_for_a_minute() {
    let with = ThreadPart {
        friction: 0.1,
        ..part(Through {
            grip_n: GRIP_N,
            ..ELASTIC
        })
    };
    let still = thick(|at| at[2] > -0.0199);
    let soft = thick(sides);
    for (name, mesh) in [("still", still), ("soft", soft)] {
        let mut bench = wound_up_in(mesh, 1, with);
        raise_until(&mut bench, |thread| thread.slipped_m[0] > 1e-3);
        for is_held in [true, false] {
            if !is_held {
                hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
                assert!(bench.hold(0, None));
            }
            // One step to come to rest.
            bench.step_both();
            let (begin, thread) = (bench.path(7), bench.step_both().threads()[0]);
            let mut worst = 0.0f64;
            for _ in 0..A_MINUTE {
                let now = bench.step_both();
                assert_eq!(now.status.name(), "ok");
                let now = now.threads()[0];
                let more = [0, 1].map(|end| (now.tension_n[end] - thread.tension_n[end]).abs());
                worst = more.into_iter().fold(worst, f64::max);
                assert_eq!(now.punctures, 2);
            }
            let crept_m = apart_m(&begin, &bench.path(7));
            println!(
                "{name}, held {is_held}: {crept_m} m, {worst} N of {:?}",
                thread.tension_n
            );
            assert_eq!(thread.tension_n[0] > 0.1, is_held, "{thread:?}");
            assert!(crept_m < 1e-9 && worst < 1e-6, "{crept_m} {worst}");
        }
    }
}

/// Tensions of a passage's pieces as they are, and as friction at every crossing by itself has them, from that before the passage and
/// the turns on the way; the last is the piece after it \[N\].
fn by_crossing(path: &[ThreadPoint], enters: usize, friction: f64) -> Vec<[f64; 2]> {
    let way =
        |from: usize, to: usize| Vector3::from(path[to].at_m) - Vector3::from(path[from].at_m);
    let leaves = (enters..path.len()).find(|place| path[*place].what == ThreadPlace::Leaves);
    let leaves = leaves.expect("a way out");
    // Faces that share a point share their tension.
    let turns = |place: &usize| path[*place].tension_n != path[*place - 1].tension_n;
    let kept: Vec<usize> = (enters..=leaves)
        .filter(turns)
        .chain([leaves + 1])
        .collect();
    let pieces = kept.windows(2).map(|two| (two[0], two[1]));
    let mut expected = path[enters - 1].tension_n;
    let mut tensions = Vec::new();
    let mut last = way(enters - 1, enters);
    for (begin, end) in pieces {
        expected *= (friction * last.angle(&way(begin, end))).exp();
        last = way(begin, end);
        tensions.push([path[begin].tension_n, expected]);
    }
    tensions
}

/// Two bites beside each other and the turn between them, in tissue that gives way: how far one unknown a passage, spread over its
/// length, is from friction at every crossing. Behind each passage it is the same; within, it is off by a part of what the
/// passage changes.
#[test]
fn one_friction_a_passage_is_near_that_of_every_crossing() {
    for friction in [0.1, 0.3] {
        let with = ThreadPart {
            friction,
            ..part(Through {
                grip_n: GRIP_N,
                ..ELASTIC
            })
        };
        let mut bench = wound_up_in(thick(sides), 2, with);
        go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
        let path = bench.path(7);
        let enters = (0..path.len()).filter(|place| path[*place].what == ThreadPlace::Enters);
        let (mut inner, mut behind) = (0.0f64, 0.0f64);
        let mut worst_part = 0.0f64;
        for enters in enters {
            let tensions = by_crossing(&path, enters, friction);
            assert!(tensions.len() > 3, "{tensions:?}");
            let off = |[is, by]: &[f64; 2]| (is / by - 1.0).abs();
            let (last, inside) = tensions.split_last().expect("pieces");
            behind = behind.max(off(last));
            let worst = inside.iter().map(off).fold(0.0, f64::max);
            // Of what the passage changes.
            let changes = last[1] / path[enters - 1].tension_n - 1.0;
            worst_part = worst_part.max(worst / changes);
            inner = inner.max(worst);
        }
        println!(
            "friction {friction}: off by {behind} behind a passage, {inner} within, {worst_part} of its change"
        );
        assert!(behind < 0.01, "{behind}");
        assert!(worst_part < 0.6, "{worst_part}");
    }
}

/// Round a turn at which friction multiplies the tension by more than e, steps settle at once, and to the same law.
#[test]
fn a_turn_that_multiplies_the_tension_settles() {
    for friction in [0.5, 0.8] {
        let with = ThreadPart {
            friction,
            ..part(ELASTIC)
        };
        let mut bench = wound_up(1, with);
        let (mut most, mut pieces, mut taut) = (0, 0, 0);
        for _ in 0..200 {
            bench.grip.translation.vector.z += 5e-5;
            let report = bench.step_both();
            assert_eq!(report.status.name(), "ok");
            most = most.max(report.solves);
            pieces = pieces.max(report.substeps);
            let [tail, head] = report.threads()[0].tension_n;
            if tail > 0.05 {
                let turn = friction * turn_rad(&bench.path(7));
                assert!(turn > 1.5);
                let ratio = (head / tail).ln() / turn;
                assert!((ratio - 1.0).abs() < 0.01, "{tail} {head} {turn}");
                taut += 1;
            }
        }
        println!("{friction}: {most} solves, {pieces} pieces, {taut} steps taut");
        assert!(taut > 20 && most <= 24, "{most} {taut}");
    }
}

/// Tension at the end of a path whose tail is free: dT/ds = drag + friction |curvature| T, piece by piece as it is drawn \[N\].
fn dragged_n(path: &[ThreadPoint], drag_n_per_m: f64, friction: f64) -> f64 {
    let mut tension_n = 0.0;
    let mut before: Option<Vector3<f64>> = None;
    let mut inside = false;
    for two in path.windows(2) {
        inside = match two[0].what {
            ThreadPlace::Enters => true,
            ThreadPlace::Leaves | ThreadPlace::End => false,
            _ => inside,
        };
        let way = Vector3::from(two[1].at_m) - Vector3::from(two[0].at_m);
        // Faces may share a point.
        if way.norm() < 1e-9 {
            continue;
        }
        if let Some(before) = before.replace(way) {
            tension_n *= (friction * before.angle(&way)).exp();
        }
        if inside {
            tension_n += drag_n_per_m * way.norm();
        }
    }
    tension_n
}

/// A free tail is held back by what its way through tissue is, and turns multiply that.
#[test]
fn a_free_tail_drags_round_turns() {
    let drag_n_per_m = 5.0;
    for friction in [0.0, 0.1] {
        let with = ThreadPart {
            friction,
            ..part(Through {
                drag_n_per_m,
                ..ELASTIC
            })
        };
        let mut seen = Vec::new();
        for times in [1, 2, 4] {
            let mut bench = wound_up(times, with);
            hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
            let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.03));
            let [tail, head] = report.threads()[0].tension_n;
            let expected = dragged_n(&bench.path(7), drag_n_per_m, friction);
            println!("{friction}, {times}: {head} {expected}");
            assert_eq!(tail, 0.0);
            assert!((head / expected - 1.0).abs() < 0.01, "{head} {expected}");
            seen.push(head);
        }
        assert!(seen.windows(2).all(|two| two[1] > 1.9 * two[0]), "{seen:?}");
    }
}
