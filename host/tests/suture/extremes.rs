//! What no surgeon does on purpose: bounded forces, a status, and the next good step works.

use super::rig::*;
use nalgebra::Vector3;
use sutura_host::event::Event;
use sutura_host::mesh::TetMesh;
use sutura_host::needle::NeedleSettings;
use sutura_host::step::{State, StepReport, Workspace};
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPart, ThreadTension};

/// Numbers are finite and no pull exceeds the strength.
fn bounded(report: &StepReport, strength_n: f64) {
    assert!(report.stored_energy_j.is_finite());
    for contact in report.contacts() {
        let numbers = contact.wrench.iter().chain(contact.tangent.as_flattened());
        assert!(numbers.into_iter().all(|x| x.is_finite()), "{contact:?}");
    }
    for thread in report.threads() {
        let most = 1.001 * strength_n;
        assert!(
            thread
                .tension_n
                .iter()
                .all(|tension| (0.0..=most).contains(tension)),
            "{thread:?}"
        );
    }
    for contact in report.contacts() {
        let force = Vector3::from_column_slice(&contact.wrench[..3]);
        assert!(force.norm() <= 1.001 * strength_n, "{contact:?}");
    }
}

/// Pulls by `way` at once or in steps of 1 mm; statuses other than `ok` are counted.
fn pull(
    bench: &mut Bench,
    way: Vector3<f64>,
    steps: usize,
    strength_n: f64,
) -> (StepReport, usize) {
    let (mut report, mut others) = (StepReport::default(), 0);
    for _ in 0..steps {
        bench.grip.translation.vector += way / steps as f64;
        report = bench.step_both();
        bounded(&report, strength_n);
        others += usize::from(report.status.name() != "ok");
    }
    (report, others)
}

/// As [`pull`], until the thread breaks, which it has to at its strength.
fn pull_apart(bench: &mut Bench, way: Vector3<f64>, steps: usize, strength_n: f64) {
    for _ in 0..steps {
        let (report, others) = pull(bench, way / steps as f64, 1, strength_n);
        assert_eq!(others, 0, "{report:?}");
        let broke = report.events().find_map(|event| match event {
            Event::Broke { tension_n, .. } => Some(tension_n),
            _ => None,
        });
        if let Some(tension_n) = broke {
            assert!((tension_n / strength_n - 1.0).abs() < 1e-6, "{tension_n}");
            return;
        }
    }
    panic!("it has not broken");
}

#[test]
fn ten_times_too_hard_breaks_the_thread() {
    for touches in [false, true] {
        let strength_n = 2.0;
        let setup = Setup {
            touches,
            strength_n,
            ..SETUP
        };
        let mut bench = drawn(bench(setup));
        pull_apart(&mut bench, Vector3::new(0.0, 0.0, -0.12), 120, strength_n);
        // Nothing is left of it.
        let report = bench.step_both();
        assert!(report.threads()[0].broken_off_m.is_some_and(|m| m > 0.0));
        assert_eq!(report.threads()[0].state, ThreadTension::Slack);
        assert!(bench.largest_displacement_m() < 1e-12);
    }
}

#[test]
fn a_jump_is_followed_or_refused() {
    let mut bench = drawn(bench(Setup {
        touches: true,
        strength_n: 2.0,
        ..SETUP
    }));
    for way in [-0.05, 0.05, -0.02, 0.02, -0.3, 0.3] {
        pull(&mut bench, Vector3::new(0.0, 0.5 * way, way), 1, 2.0);
        for _ in 0..20 {
            let report = bench.step_both();
            bounded(&report, 2.0);
        }
        assert_eq!(bench.step_both().status.name(), "ok");
    }
    // Where it began.
    assert!(bench.step_both().threads()[0].tension_n[0] < 0.05);
}

#[test]
fn hardly_any_thread() {
    // Drawn out of everything at once; with a knot it is as if tied to the first puncture, and too short.
    let mut bench = bench(Setup {
        length_m: 1e-6,
        strength_n: 1.0,
        ..SETUP
    });
    let report = go(&mut bench, Vector3::new(0.0, 0.0, -0.072));
    assert_eq!(report.threads()[0].punctures, 0);
    let mut bench = super::rig::bench(Setup {
        length_m: 1e-6,
        strength_n: 1.0,
        ..SETUP
    });
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Knot);
    pull_apart(&mut bench, Vector3::new(0.0, 0.0, -0.072), 720, 1.0);
}

#[test]
fn slabs_that_touch_from_the_start() {
    let mut bench = drawn(bench(Setup {
        touches: true,
        gap_m: 1e-9,
        ..SETUP
    }));
    let (report, others) = pull(&mut bench, Vector3::new(0.001, 0.0, -0.004), 20, 20.0);
    assert_eq!((report.status.name(), others), ("ok", 0));
    assert_eq!(report.threads()[0].state, ThreadTension::Taut);
    assert!(report.touching > 0);
}

#[test]
fn punctures_beside_and_on_what_does_not_move() {
    // x = 15 mm is held; the mesh has nodes at y = -15 + 30/7 k mm.
    for at_m in [
        [0.01499, 0.0007],
        [0.015 - 1e-12, -0.015 + 0.03 / 7.0 * 4.0],
        [0.0, 0.0149],
    ] {
        let mut bench = drawn(bench(Setup {
            touches: true,
            at_m,
            ..SETUP
        }));
        let (report, others) = pull(&mut bench, Vector3::new(0.0, 0.001, -0.004), 20, 20.0);
        assert_eq!((report.status.name(), others), ("ok", 0), "{at_m:?}");
        let state = report.threads()[0].state;
        assert!(state != ThreadTension::Slack, "{at_m:?}");
    }
}

#[test]
fn any_friction() {
    for friction in [0.0, 1e-6, 1.0, 10.0] {
        let setup = Setup {
            friction,
            touches: true,
            ..SETUP
        };
        let mut bench = drawn(bench(setup));
        let (report, others) = pull(&mut bench, Vector3::new(0.003, 0.0, -0.004), 40, 20.0);
        assert_eq!((report.status.name(), others), ("ok", 0), "{friction}");
        let [tail, head] = report.threads()[0].tension_n;
        assert!(
            head > 0.0 && tail <= head * (1.0 + 1e-9),
            "{friction} {tail} {head}"
        );
        let (report, _) = pull(&mut bench, Vector3::new(-0.003, 0.0, 0.006), 40, 20.0);
        assert_eq!(report.status.name(), "ok", "{friction}");
        assert_eq!(
            report.threads()[0].state,
            ThreadTension::Slack,
            "{friction}"
        );
    }
}

#[test]
fn a_tail_that_is_let_go_lets_the_thread_through() {
    let mut bench = drawn(bench(SETUP));
    let (report, _) = pull(&mut bench, Vector3::new(0.0, 0.0, -0.003), 15, 20.0);
    assert_eq!(report.threads()[0].state, ThreadTension::Taut);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Free);
    let (report, _) = pull(&mut bench, Vector3::new(0.0, 0.0, -0.1), 200, 20.0);
    assert_eq!(report.threads()[0].tension_n, [0.0; 2]);
    let (report, _) = pull(&mut bench, Vector3::new(0.0, 0.0, -0.3), 300, 20.0);
    assert_eq!(report.threads()[0].punctures, 0);
    assert!(bench.largest_displacement_m() < 1e-12);
}

#[test]
fn a_needle_that_is_let_go_lets_the_thread_through_the_other_way() {
    let mut bench = drawn(bench(SETUP));
    assert!(bench.hold(0, None));
    for _ in 0..600 {
        bench.other.translation.vector.z += 1e-3;
        let report = bench.step_both();
        assert_eq!(report.threads()[0].tension_n, [0.0; 2]);
    }
    assert_eq!(bench.step_both().threads()[0].punctures, 0);
}

fn part(id: u8, needle: u8, strength_n: f64) -> ThreadPart {
    ThreadPart {
        id,
        needle,
        length_m: 0.3,
        friction: 0.1,
        strength_n,
        through: SETUP.through,
    }
}

/// Gives a bench's model threads, and begins anew.
fn with_threads(mut bench: Bench, parts: &[ThreadPart]) -> Bench {
    bench.model = bench.model.with_threads(parts).expect("threads");
    bench.state = State::new(&bench.model);
    bench.work = Workspace::new(&bench.model);
    bench.work.prepare(&bench.model, |_| true);
    for part in parts {
        assert!(bench.hold(part.needle, Some(part.needle)));
    }
    bench
}

#[test]
fn all_punctures_in_one_cell() {
    let points = vec![
        [0.0, 0.0, 0.0],
        [0.03, 0.0, 0.0],
        [0.0, 0.03, 0.0],
        [0.008, 0.008, 0.02],
    ];
    let mesh = TetMesh::new(points, vec![[0, 1, 2, 3]]).expect("a cell");
    let start = frame([-0.03, 0.007, 0.008], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let settings = NeedleSettings::default();
    let fixed = (mesh, vec![0, 1, 2]);
    let needle = straight(0.02);
    let bench = Bench::new(fixed, Kind::Linear, needle, start, smooth(), settings);
    let mut bench = with_threads(bench, &[part(7, 0, 1.0)]);
    let (report, others) = pull(&mut bench, Vector3::new(0.08, 0.0, 0.0), 400, 1.0);
    assert_eq!((report.threads()[0].punctures, others), (2, 0));
    bench.other.translation.vector = Vector3::new(-0.02, 0.0, 0.02);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    pull_apart(&mut bench, Vector3::new(0.2, 0.1, 0.1), 500, 1.0);
    let (report, others) = pull(&mut bench, Vector3::new(-0.025, -0.01, -0.01), 50, 1.0);
    assert_eq!(
        (report.threads()[0].state, others),
        (ThreadTension::Slack, 0)
    );
}

/// Each has its own tension, on the tool that holds its needle.
#[test]
fn two_threads_at_once() {
    let at = |x: f64, y: f64| {
        let start = frame([x, y, 0.054], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
        (straight(0.04), start)
    };
    let needles = [at(0.0013, 0.0047), at(-0.0021, -0.0053)];
    let mesh = slabs();
    let tissue = vec![smooth(); mesh.0.cells().len()];
    let settings = NeedleSettings::default();
    let bench = Bench::many(mesh, Kind::Linear, &needles, MATERIAL, &tissue, settings);
    let mut bench = with_threads(bench, &[part(7, 0, 5.0), part(8, 1, 5.0)]);
    let go = |bench: &mut Bench, way: Vector3<f64>, steps: usize| {
        let mut report = StepReport::default();
        for _ in 0..steps {
            bench.grip.translation.vector += way / steps as f64;
            bench.other.translation.vector += 0.5 * way / steps as f64;
            report = bench.step_both();
            bounded(&report, 5.0);
            assert_eq!(report.status.name(), "ok");
        }
        report
    };
    go(&mut bench, Vector3::new(0.0, 0.0, -0.15), 600);
    let samples = [bench.sample_of(0), bench.sample_of(1)];
    for (thread, at) in [(7, [0.001, 0.004, 0.03]), (8, [-0.002, -0.005, 0.03])] {
        let (end, by) = (ThreadEnd::Tail, ThreadHold::Place(at));
        assert!(
            bench
                .state
                .hold_thread(&bench.model, thread, end, by, &samples)
        );
    }
    let report = go(&mut bench, Vector3::new(0.002, 0.0, -0.006), 60);
    let mut pulls = [0.0; 2];
    for (tool, thread) in report.threads().iter().enumerate() {
        assert_eq!((thread.state, thread.punctures), (ThreadTension::Taut, 4));
        // Longer by what it stretches.
        let over = thread.length_m - thread.available_m;
        let [least, most] = thread
            .tension_n
            .map(|tension| tension * thread.available_m / SOFT_EA_N);
        assert!(
            over > least - 1e-6 && over < most + 1e-6,
            "{over} {least} {most}"
        );
        let force = Vector3::from_column_slice(&report.contacts()[tool].wrench[..3]);
        assert!((force.norm() / thread.tension_n[1] - 1.0).abs() < 1e-3);
        pulls[tool] = thread.tension_n[1];
    }
    // Pulled half as far, but half as long.
    assert!(
        (pulls[1] / pulls[0] - 1.0).abs() > 0.05,
        "they share no tension: {pulls:?}"
    );
}
