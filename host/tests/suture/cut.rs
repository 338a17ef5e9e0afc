//! A thread that is cut outside: what is left of both pieces.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::event::Event;
use sutura_host::thread::{
    FreeThreads, ThreadEnd, ThreadHold, ThreadPlace, ThreadPoint, ThreadReport, ThreadTension,
    Through,
};

/// A thread that has been wound up twice and is pulled, its tail at a place; and where its span between the two bites is.
fn pulled(is_held: fn(&[f64; 3]) -> bool, through: Through) -> (Bench, [f64; 3]) {
    let mut bench = wound_up_in(thick(is_held), 2, part(through));
    let tail = bench.other.translation.vector.into();
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Place(tail));
    let mut report = bench.step_both();
    while report.threads()[0].tension_n[1] < 0.5 {
        report = go(&mut bench, Vector3::new(0.0, 0.0, 2e-5));
    }
    let path = bench.path(7);
    let out = path
        .iter()
        .position(|point| point.what == ThreadPlace::Leaves);
    let out = out.expect("a way out");
    let [from, to] = [out, out + 1].map(|place| Vector3::from(path[place].at_m));
    (bench, ((from + to) / 2.0).into())
}

fn all_but_below(at: &[f64; 3]) -> bool {
    at[2] > -0.0199
}

/// One step; the thread then, and whether it says that it has been cut.
fn after(bench: &mut Bench) -> (ThreadReport, bool) {
    let report = bench.step_both();
    assert_eq!(report.status.name(), "ok");
    let is_cut = |event: Event| matches!(event, Event::Cut { thread: 7, .. });
    (report.threads()[0], report.events().any(is_cut))
}

fn of(path: &[ThreadPoint], what: ThreadPlace) -> usize {
    path.iter().filter(|point| point.what == what).count()
}

/// Nothing pulls any more, and all that was drawn into the tissue is there.
#[test]
fn both_ends_of_a_cut_are_free_at_once() {
    let (mut bench, at) = pulled(sides, ELASTIC);
    assert!(bench.largest_displacement_m() > 1e-4);
    let before = bench.path(7);
    assert!(bench.state.cut_thread(&bench.model, 7, &at, false));
    let (thread, is_cut) = after(&mut bench);
    assert!(is_cut, "{thread:?}");
    assert_eq!(
        (thread.state, thread.tension_n),
        (ThreadTension::Slack, [0.0; 2])
    );
    assert_eq!(thread.punctures, 4);
    assert!(bench.largest_displacement_m() < 1e-12);
    let path = bench.path(7);
    // Two loose ends more, at one place of the thread.
    assert_eq!(of(&path, ThreadPlace::Cut), 2);
    let wraps = of(&before, ThreadPlace::Wraps);
    assert_eq!(path.len(), before.len() - wraps + 2);
    let cut = path.iter().position(|point| point.what == ThreadPlace::Cut);
    let cut = cut.expect("a cut");
    assert_eq!(path[cut].along_m, path[cut + 1].along_m);
    let [behind, ahead] = [cut - 1, cut + 2].map(|place| path[place].along_m);
    assert!(behind < path[cut].along_m && path[cut].along_m < ahead);
    let (_, again) = after(&mut bench);
    assert!(!again);
    // The needle draws its piece out of the tissue, and nothing of the other one.
    go(&mut bench, Vector3::new(0.0, 0.0, 0.2));
    let path = bench.path(7);
    let thread = bench.step_both().threads()[0];
    assert_eq!((thread.punctures, of(&path, ThreadPlace::Enters)), (2, 1));
    // There was room for one cut.
    assert!(!bench.state.cut_thread(&bench.model, 7, &at, false));
}

/// What is sewn stays as taut as it was, and the next stitch is held by a knot of its own.
#[test]
fn knots_keep_what_a_cut_leaves() {
    let through = Through {
        knot_n: 0.8,
        ..ELASTIC
    };
    let (mut bench, at) = pulled(all_but_below, through);
    let before = bench.step_both().threads()[0].tension_n;
    assert!(bench.state.cut_thread(&bench.model, 7, &at, true));
    let (thread, is_cut) = after(&mut bench);
    assert!(is_cut);
    let [tail, head] = thread.tension_n;
    assert!((tail / before[0] - 1.0).abs() < 1e-3, "{tail} {before:?}");
    assert_eq!(head, 0.0);
    // The needle draws the other piece up to its knot, which opens.
    let mut most_n = 0.0f64;
    let mut opened = None;
    for _ in 0..4000 {
        bench.grip.translation.vector.z += 5e-6;
        let report = bench.step_both();
        let thread = report.threads()[0];
        assert!(
            (thread.tension_n[0] / before[0] - 1.0).abs() < 0.1,
            "{thread:?}"
        );
        most_n = most_n.max(thread.tension_n[1]);
        opened = report.events().find_map(|event| match event {
            Event::Opened {
                thread: 7,
                tension_n,
            } => Some(tension_n),
            _ => None,
        });
        if opened.is_some() {
            break;
        }
    }
    let opened = opened.expect("an open knot");
    assert!((opened / 0.8 - 1.0).abs() < 0.01, "{opened}");
    assert!((most_n / 0.8 - 1.0).abs() < 0.01, "{most_n}");
    let thread = bench.step_both().threads()[0];
    assert!(
        thread.tension_n[0] > 0.0 && thread.tension_n[1] == 0.0,
        "{thread:?}"
    );
}

/// The knot at the end of what is sewn holds as much as any other one.
#[test]
fn a_knot_before_a_cut_opens() {
    let through = Through {
        knot_n: 0.6,
        ..ELASTIC
    };
    let (mut bench, at) = pulled(all_but_below, through);
    assert!(bench.state.cut_thread(&bench.model, 7, &at, true));
    after(&mut bench);
    // The place at its tail becomes a hand that pulls.
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    let mut opened = None;
    let mut most_n = 0.0f64;
    for _ in 0..4000 {
        bench.other.translation.vector.z += 5e-6;
        let report = bench.step_both();
        most_n = most_n.max(report.threads()[0].tension_n[0]);
        let mut events = report.events();
        opened = events.find(|event| matches!(event, Event::Opened { thread: 7, .. }));
        if opened.is_some() {
            break;
        }
    }
    assert!(opened.is_some());
    assert!((most_n / 0.6 - 1.0).abs() < 0.01, "{most_n}");
    let thread = bench.step_both().threads()[0];
    assert_eq!(thread.tension_n, [0.0; 2]);
}

/// Both loose ends hang from the tissue as long as there is thread, and end where they are marked.
#[test]
fn both_ends_of_a_cut_hang() {
    let (mut bench, at) = pulled(sides, ELASTIC);
    // Slack, so that there is something to hang.
    go(&mut bench, Vector3::new(0.0, 0.0, -0.004));
    let mut free = FreeThreads::new(&bench.model, [0.0, 0.0, -9.81]).expect("a thread");
    assert!(bench.state.cut_thread(&bench.model, 7, &at, false));
    after(&mut bench);
    let nodes_m = bench.state.positions(&bench.model);
    for _ in 0..20 {
        let report = free.step(0.1, &bench.model, &bench.state, &nodes_m);
        assert!(report.length_error < 1e-9, "{report:?}");
    }
    let path = free.path(7);
    let cuts: Vec<usize> = (0..path.len())
        .filter(|place| path[*place].what == ThreadPlace::Cut)
        .collect();
    let [head, tail] = cuts[..] else {
        panic!("{cuts:?}");
    };
    assert_eq!(head + 1, tail);
    let is_face =
        |place: &usize| matches!(path[*place].what, ThreadPlace::Enters | ThreadPlace::Leaves);
    let before = (0..head).rfind(is_face).expect("a way out");
    let behind = (tail..path.len()).find(is_face).expect("a way in");
    let ends = [(before, head), (tail, behind)];
    for (from, to) in ends {
        let pieces = path[from..=to].windows(2).map(|two| {
            let [a, b] = [two[0], two[1]].map(|point| Vector3::from(point.at_m));
            a.metric_distance(&b)
        });
        let (length_m, there_is) = (pieces.sum::<f64>(), path[to].along_m - path[from].along_m);
        assert!(there_is > 1e-3, "{there_is}");
        assert!(
            (length_m / there_is - 1.0).abs() < 1e-6,
            "{length_m} m of {there_is} m"
        );
        assert!(to - from > 5);
    }
    let apart = Vector3::from(path[head].at_m).metric_distance(&Vector3::from(path[tail].at_m));
    assert!(apart > 1e-3, "{apart}");
}
