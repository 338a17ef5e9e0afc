//! Spans that hands tighten: what is drawn out of them, where it goes, and what friction makes of their tension.

use super::one_length::*;
use super::rig::*;
use sutura_host::event::Event;
use sutura_host::step::StepReport;
use sutura_host::thread::{
    ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadTension, Through, Tightening,
};

const STEPS: u32 = 100;
const RATIO: f64 = 0.8;
/// Its spans bend over the tissue as that is in every balance.
const CLEAR: Through = Through {
    body: true,
    ..INEXTENSIBLE
};

/// Wound up three times through soft tissue: two spans, and a tail that is held.
fn sewn(friction: f64, through: Through) -> Bench {
    let with = ThreadPart {
        friction,
        ..part(through)
    };
    wound_up_in(thick(sides), 3, with)
}

/// One span after the other, to a part of its length; how much of that is done.
fn tighten(bench: &mut Bench, done: f64) -> StepReport {
    let to = Tightening {
        ratio: [1.0, RATIO],
        done,
        in_turn: true,
        most_n: f64::INFINITY,
    };
    assert!(bench.state.tighten(&bench.model, 7, Some(to)));
    let report = bench.step_both();
    assert_eq!(report.status.name(), "ok");
    report
}

/// The same in steps, all the way.
fn tighten_all(bench: &mut Bench, mut each: impl FnMut(&mut Bench, f64, &StepReport)) {
    for step in 1..=STEPS {
        let done = f64::from(step) / f64::from(STEPS);
        let report = tighten(bench, done);
        each(bench, done, &report);
    }
}

/// Places of a path at which its two spans between punctures begin, and at which they end.
fn spans(path: &[ThreadPoint]) -> [[usize; 2]; 2] {
    let of = |what: ThreadPlace| (0..path.len()).filter(move |place| path[*place].what == what);
    let leaves = of(ThreadPlace::Leaves).zip(of(ThreadPlace::Enters).skip(1));
    let spans: Vec<_> = leaves.map(|(from, to)| [from, to]).collect();
    spans.try_into().expect("two spans")
}

/// Tensions of both spans and at the tail in the course of it \[N\].
fn traced(friction: f64) -> Vec<[f64; 3]> {
    let mut trace = Vec::new();
    tighten_all(&mut sewn(friction, INEXTENSIBLE), |bench, _, report| {
        let path = bench.path(7);
        let [first, second] = spans(&path).map(|[from, _]| path[from].tension_n);
        trace.push([first, second, report.threads()[0].tension_n[0]]);
    });
    trace
}

/// Without friction the tail's hand has all of the first span's tension, with much it has next to none, and all is otherwise.
#[test]
fn friction_tells_what_tightening_does() {
    let traces = [0.0, 0.1, 5.0].map(traced);
    let tails = traces.each_ref().map(|trace| {
        let [first, _, tail] = trace[STEPS as usize / 2];
        assert!(first > 0.1, "{trace:?}");
        tail / first
    });
    println!("{tails:?}");
    assert!((tails[0] - 1.0).abs() < 1e-9, "{tails:?}");
    assert!(tails[1] < 0.7 && tails[2] < 0.01, "{tails:?}");
    for [a, b] in [[0, 1], [1, 2], [0, 2]] {
        let pairs = traces[a].iter().zip(&traces[b]);
        let apart = pairs.flat_map(|(a, b)| (0..3).map(|place| (a[place] - b[place]).abs()));
        let apart = apart.fold(0.0, f64::max);
        println!("{a}, {b}: {apart} N");
        assert!(apart > 0.05, "{a}, {b}: {apart} N");
    }
}

/// As a span is drawn together thread comes to it from before: T e^(mu theta) from the tail's hand on.
#[test]
fn tension_before_a_span_is_that_of_a_capstan() {
    for friction in [0.1, 0.3] {
        let (mut taut, mut worst) = (0, 0.0f64);
        let clear = Through {
            body: true,
            ..ELASTIC
        };
        tighten_all(&mut sewn(friction, clear), |bench, done, report| {
            let path = bench.path(7);
            let [[from, _], _] = spans(&path);
            let (first_n, tail_n) = (path[from].tension_n, report.threads()[0].tension_n[0]);
            if done < 0.5 && tail_n > 0.02 {
                // Where it bends over the surface beyond it does not rub.
                let theta = turn_rad(&turning(bench, &path[..=from + 1]));
                let ratio = first_n / tail_n / (friction * theta).exp();
                worst = worst.max((ratio - 1.0).abs());
                taut += 1;
            }
        });
        println!("{friction}: off by {worst} in {taut} steps");
        assert!(taut > 20 && worst < 0.01, "{worst} {taut}");
    }
}

/// Every metre of it is between the holds or has been drawn out, and there is as much as the path is long.
#[test]
fn what_is_drawn_out_is_counted() {
    for (friction, is_held) in [(0.0, true), (0.1, true), (0.0, false), (0.1, false)] {
        let mut bench = sewn(friction, CLEAR);
        if !is_held {
            assert!(bench.hold(0, None));
        }
        let there_m = bench.step_both().threads()[0].available_m;
        let tail_m = bench.path(7)[0].along_m;
        let (mut before_m, mut taut) = (0.0, 0);
        tighten_all(&mut bench, |bench, done, report| {
            let thread = report.threads()[0];
            assert!(thread.drawn_m > before_m - 1e-6, "{thread:?} {before_m}");
            before_m = thread.drawn_m;
            let came_m = bench.path(7)[0].along_m - tail_m;
            assert!(
                (came_m - thread.drawn_m).abs() < 1e-9,
                "{came_m} {thread:?}"
            );
            let left_m = thread.available_m - thread.length_m;
            assert!(left_m > -1e-6, "{thread:?}");
            if is_held {
                let off_m = thread.available_m + thread.drawn_m - there_m;
                assert!(off_m.abs() < 1e-9, "{off_m} {thread:?}");
            } else if done <= 0.5 && thread.state == ThreadTension::Taut {
                // All that there is, is before the only hand.
                assert!(left_m < 1e-6, "{thread:?}");
                taut += 1;
            }
        });
        assert!(before_m > 8e-3, "{before_m}");
        assert!(is_held || taut > 30, "{taut}");
        // Let go they give it back.
        assert!(bench.state.tighten(&bench.model, 7, None));
        let thread = bench.step_both().threads()[0];
        assert_eq!((thread.drawn_m, thread.state), (0.0, ThreadTension::Slack));
        assert!((bench.path(7)[0].along_m - tail_m).abs() < 1e-9);
    }
}

/// Spans are as short as they are to be, and stay so when all is done: hands hold them, whatever lies between.
#[test]
fn tightened_spans_stay_as_short_as_they_are() {
    for friction in [0.0, 0.1] {
        let mut bench = sewn(friction, CLEAR);
        tighten_all(&mut bench, |_, _, _| {});
        let mut last = [0.0; 2];
        for _ in 0..50 {
            tighten(&mut bench, 1.0);
            let nodes_m = bench.state.positions(&bench.model);
            let bridges = bench.state.bridges(&bench.model, 7, &nodes_m);
            assert_eq!(bridges.len(), 2, "{bridges:?}");
            for (last, bridge) in last.iter_mut().zip(bridges) {
                *last = bridge.now_m / bridge.rest_m;
            }
        }
        println!("{friction}: {last:?}");
        assert!(last.iter().all(|ratio| (ratio / RATIO - 1.0).abs() < 1e-3));
    }
}

/// What is beyond the last hand is slack where nothing holds the head, and feels nothing of it.
#[test]
fn a_free_head_stays_slack() {
    let mut bench = sewn(0.1, INEXTENSIBLE);
    assert!(bench.hold(0, None));
    let before = bench.path(7);
    tighten_all(&mut bench, |_, _, _| {});
    let mut thread = tighten(&mut bench, 1.0).threads()[0];
    for _ in 0..100 {
        thread = tighten(&mut bench, 1.0).threads()[0];
    }
    let path = bench.path(7);
    let [_, [from, to]] = spans(&path);
    assert!(path[from].tension_n > 0.02);
    assert_eq!(thread.tension_n[1], 0.0);
    assert!(path[to..].iter().all(|point| point.tension_n == 0.0));
    // What is before a hand has come nearer to the head by what that has drawn out, what is behind the last one is where it was.
    let came_m = path[0].along_m - before[0].along_m;
    assert!((came_m - thread.drawn_m).abs() < 1e-9, "{came_m}");
    // Bends come and go with what bends.
    let faces = |path: &[ThreadPoint]| {
        let faces = path.iter().filter(|point| point.what != ThreadPlace::Wraps);
        faces.copied().collect::<Vec<_>>()
    };
    let [now, then] = [&path[to..], &before].map(faces);
    for (now, then) in now.iter().rev().zip(then.iter().rev()) {
        assert!(
            (now.along_m - then.along_m).abs() < 1e-9,
            "{now:?} {then:?}"
        );
    }
}

/// Drawn at harder than it bears it breaks, as it does in any other hand.
#[test]
fn hands_break_what_they_draw_at_too_hard() {
    let with = ThreadPart {
        strength_n: 0.15,
        ..part(INEXTENSIBLE)
    };
    let mut bench = wound_up_in(thick(sides), 3, with);
    let mut broke = 0;
    tighten_all(&mut bench, |_, _, report| {
        let events = report.events();
        broke += events
            .filter(|event| matches!(event, Event::Broke { .. }))
            .count();
    });
    assert!(broke > 0);
    assert!(bench.step_both().threads()[0].broken_off_m > Some(0.0));
}

/// A tail that nobody holds is drawn in by hands without any tension.
#[test]
fn a_free_tail_is_drawn_in() {
    let mut bench = sewn(0.1, INEXTENSIBLE);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
    for done in [0.1, 0.2, 0.3] {
        let thread = tighten(&mut bench, done).threads()[0];
        assert_eq!(thread.state, ThreadTension::Slack, "{thread:?}");
    }
    assert!(bench.largest_displacement_m() < 1e-12);
}
