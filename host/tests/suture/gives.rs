//! What slips and what breaks: events tell it, and with them alone there is as much thread as there was.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::event::Event;
use sutura_host::step::StepReport;
use sutura_host::thread::{
    ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadTension, Through,
};

/// What events have told so far.
#[derive(Debug, Default)]
struct Told {
    /// Slipped in at tail and head \[m\].
    slipped_m: [f64; 2],
    /// How often an end came through its grip.
    outs: u32,
    /// Of each break: tension \[N\], and what was lost \[m\].
    breaks: Vec<(f64, f64)>,
}

impl Told {
    fn hear(&mut self, report: &StepReport) {
        for event in report.events() {
            match event {
                Event::Slipped {
                    thread: 7,
                    end,
                    tool: 1,
                    length_m,
                    is_out,
                } => {
                    assert!(length_m > 0.0);
                    self.slipped_m[usize::from(end == ThreadEnd::Head)] += length_m;
                    self.outs += u32::from(is_out);
                }
                Event::Broke {
                    thread: 7,
                    tension_n,
                    lost_m,
                } => self.breaks.push((tension_n, lost_m)),
                other => panic!("{other:?}"),
            }
        }
    }
}

/// Moves a tool in steps of 0.2 mm, and hears every one.
fn pull(bench: &mut Bench, tool: u8, way: [f64; 3], told: &mut Told) -> StepReport {
    let way = Vector3::from(way);
    let steps = (way.norm() / 2e-4).ceil();
    let mut report = StepReport::default();
    for _ in 0..steps as usize {
        let moved = if tool == 0 {
            &mut bench.grip
        } else {
            &mut bench.other
        };
        moved.translation.vector += way / steps;
        report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        told.hear(&report);
    }
    report
}

/// Unstretched thread of a path outside tissue and inside \[m\], from where its points are and the tensions between them alone.
fn material_m(path: &[ThreadPoint], ea_n: f64) -> [f64; 2] {
    let mut material = [0.0; 2];
    for pair in path.windows(2) {
        let length = Vector3::from(pair[0].at_m).metric_distance(&Vector3::from(pair[1].at_m));
        let is_inside = matches!(pair[0].what, ThreadPlace::Inside | ThreadPlace::Enters);
        material[usize::from(is_inside)] += length / (1.0 + pair[0].tension_n / ea_n);
    }
    material
}

fn held_m(path: &[ThreadPoint]) -> f64 {
    path[path.len() - 1].along_m - path[0].along_m
}

/// Round a path of two and a half turns with friction: outside and inside less what events say has slipped in is what there was.
#[test]
fn slips_alone_change_what_there_is_of_thread() {
    for friction in [0.0, 0.1] {
        let with = ThreadPart {
            friction,
            ..part(Through {
                grip_n: 0.2,
                ..ELASTIC
            })
        };
        let mut bench = wound_up(2, with);
        let mut told = Told::default();
        let length_m = held_m(&bench.path(7));
        let (mut worst, mut taut) = (0.0f64, 0);
        for _ in 0..60 {
            let report = pull(&mut bench, 0, [0.0, 0.0, 5e-4], &mut told);
            let path = bench.path(7);
            let there = length_m + told.slipped_m[0];
            assert!((held_m(&path) - there).abs() < 1e-9);
            let thread = report.threads()[0];
            assert_eq!(thread.slipped_m, told.slipped_m);
            if thread.state == ThreadTension::Taut {
                let [outside, inside] = material_m(&turning(&bench, &path), EA_N);
                worst = worst.max((outside + inside - there).abs());
                taut += 1;
            }
        }
        println!("{friction}: {told:?}, {worst} m");
        assert!(taut > 30 && told.slipped_m[0] > 5e-3, "{told:?}");
        assert_eq!((told.slipped_m[1], told.outs), (0.0, 0));
        assert!(worst < 1e-6, "{worst}");
    }
}

/// The grip of a head slips as well, and the end of a short tail comes through.
#[test]
fn a_head_slips_and_a_tail_comes_out() {
    let grip_n = 0.5;
    let through = Through { grip_n, ..ELASTIC };
    // The tail at a place, the head beyond the last puncture in the grip of tool 1.
    let mut bench = drawn_through(thick(sides), part(through));
    hold(
        &mut bench,
        ThreadEnd::Tail,
        ThreadHold::Place([0.0013, 0.0007, 0.01]),
    );
    bench.other.translation.vector = Vector3::new(0.0013, 0.0007, -0.025);
    hold(&mut bench, ThreadEnd::Head, ThreadHold::Tool(1));
    let mut told = Told::default();
    let length_m = held_m(&bench.path(7));
    pull(&mut bench, 1, [0.0, 0.0, -0.004], &mut told);
    assert!(told.slipped_m[1] > 2e-3, "{told:?}");
    assert!((held_m(&bench.path(7)) - length_m - told.slipped_m[1]).abs() < 1e-9);

    let short = ThreadPart {
        length_m: 0.075,
        ..part(through)
    };
    let mut bench = drawn_through(thick(sides), short);
    bench.other.translation.vector.z = 0.002;
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    let mut told = Told::default();
    let tail_m = bench.path(7)[0].along_m + short.length_m;
    assert!(tail_m > 5e-3, "{tail_m}");
    let report = pull(&mut bench, 0, [0.0, 0.0, -tail_m - 0.002], &mut told);
    assert_eq!(told.outs, 1, "{told:?}");
    // All that was behind the grip, and no more.
    assert!(
        (told.slipped_m[0] - tail_m).abs() < 1e-6,
        "{told:?} {tail_m}"
    );
    assert_eq!(report.threads()[0].held_by, [None, Some(0)]);
}

/// A break is told once, with the tension and what is gone: from where the thread was tensest to its tail.
#[test]
fn a_break_is_told_with_what_it_takes() {
    let strength_n = 0.5;
    for friction in [0.0, 0.1] {
        let with = ThreadPart {
            friction,
            strength_n,
            ..part(ELASTIC)
        };
        let mut bench = wound_up(1, with);
        let mut told = Told::default();
        let mut before = bench.path(7);
        for _ in 0..2000 {
            before = bench.path(7);
            pull(&mut bench, 0, [0.0, 0.0, 2e-5], &mut told);
            if !told.breaks.is_empty() {
                break;
            }
        }
        for _ in 0..20 {
            pull(&mut bench, 0, [0.0, 0.0, 2e-4], &mut told);
        }
        let [(tension_n, lost_m)] = told.breaks[..] else {
            panic!("{told:?}");
        };
        assert!((tension_n / strength_n - 1.0).abs() < 1e-3, "{tension_n}");
        // Frictionless it is the tail's end that is let go; with friction the thread is tensest behind the last puncture.
        let place = if friction == 0.0 {
            0
        } else {
            let leaves = |point: &ThreadPoint| point.what == ThreadPlace::Leaves;
            before.iter().rposition(leaves).expect("a puncture")
        };
        let gone_m = before[place].along_m + LENGTH_M;
        println!("{friction}: {lost_m} {gone_m}");
        // It stretches a little more in the last step.
        assert!((lost_m - gone_m).abs() < 2e-5, "{lost_m} {gone_m}");
        assert_eq!(told.slipped_m, [0.0; 2]);
        let report = bench.step_both();
        assert_eq!(report.threads()[0].broken_off_m, Some(lost_m));
    }
}

/// A knot holds to its strength, and then nothing: what comes after it is a free tail.
#[test]
fn a_knot_opens_at_its_strength() {
    let knot_n = 0.2;
    let mut bench = drawn_through(thick(sides), part(Through { knot_n, ..ELASTIC }));
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Knot);
    let (mut most, mut opened) = (0.0f64, None);
    for _ in 0..4000 {
        bench.grip.translation.vector.z -= 1e-4;
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        let tension_n = report.threads()[0].tension_n[1];
        for event in report.events() {
            let Event::Opened {
                thread: 7,
                tension_n,
            } = event
            else {
                panic!("{event:?}")
            };
            assert_eq!(opened, None);
            opened = Some(tension_n);
            most = most.max(tension_n);
        }
        if opened.is_some() {
            break;
        }
        assert!(tension_n <= knot_n * 1.0001, "{tension_n}");
        most = most.max(tension_n);
    }
    assert!((most / knot_n - 1.0).abs() < 0.01, "{most}");
    assert!((opened.expect("it opens") / knot_n - 1.0).abs() < 1e-6);
    let after = bench.step_both().threads()[0];
    assert_eq!(after.tension_n, [0.0; 2], "{after:?}");
    let report = go(&mut bench, Vector3::new(0.0, 0.0, -2e-3));
    assert_eq!(report.threads()[0].tension_n, [0.0; 2]);
}
