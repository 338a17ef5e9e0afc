//! Friction along a thread: what it spends, which way it acts, and that nothing creeps.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPart, ThreadPoint, ThreadReport, Through};

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
    for friction in [0.0, 0.1] {
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
    assert!(all[0] < all[1], "{all:?}");
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
