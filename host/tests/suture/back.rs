//! Needles that are drawn back once their end has gone in: faces go from needle to thread and back again.

use super::rig::*;
use crate::needle::back::{Met, Plane, Track, all_faces, needle_on};
use crate::needle::support::Body;
use nalgebra::Vector3;
use sutura_host::mesh::TetMesh;
use sutura_host::needle::{Crossing, Needle, NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::thread::{ThreadEnd, ThreadHold, Through};
use sutura_testkit::Random;

/// Nothing rubs, and no boundary holds.
fn open() -> NeedleTissue {
    NeedleTissue::default()
}

fn slab_bench(tissue: NeedleTissue, needle: Needle, threaded: bool) -> Bench {
    let (mesh, fixed) = slabs();
    let start = frame([0.0013, 0.0007, 0.054], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let settings = NeedleSettings::default();
    let bench = Bench::new((mesh, fixed), Kind::Linear, needle, start, tissue, settings);
    if threaded {
        bench.with_thread(SETUP.length_m)
    } else {
        bench
    }
}

/// The end goes 5 mm into the upper slab (from 4 to 12 mm), and is drawn out again by the way that it came.
#[test]
fn an_end_that_has_gone_in_comes_out_again() {
    for (tissue, threaded) in [
        (open(), true),
        (smooth(), true),
        (tissue(), true),
        (open(), false),
        (smooth(), false),
        (tissue(), false),
    ] {
        let mut bench = slab_bench(tissue, straight(0.04), threaded);
        let path = |bench: &mut Bench, z: f64| go(bench, Vector3::new(0.0, 0.0, z));
        path(&mut bench, -0.034);
        let mut seen = Vec::new();
        for _ in 0..30 {
            path(&mut bench, -5e-4);
            bench.is_in_order();
            seen.push(bench.both()[1].iter().map(|c| c.face).collect::<Vec<_>>());
        }
        let end_m = bench.grip.translation.vector.z;
        assert!((end_m - 0.005).abs() < 1e-9, "{end_m}");
        let [thread, _] = bench.both();
        assert_eq!(thread.is_empty(), !threaded);
        // Back by the same faces.
        for step in (0..29).rev() {
            path(&mut bench, 5e-4);
            bench.is_in_order();
            if tissue == open() {
                let faces: Vec<_> = bench.both()[1].iter().map(|c| c.face).collect();
                assert_eq!(faces, seen[step], "at {step}");
            }
        }
        // The end is out above the slab, the tip below both: all four boundaries lie on the needle.
        let [thread, needle] = bench.both();
        assert!(thread.is_empty());
        let mesh = bench.mesh.half_faces();
        let boundary = needle.iter().filter(|c| c.enters || c.leaves(mesh));
        assert_eq!(boundary.count(), 4);
        let report = path(&mut bench, 0.0375);
        let needle = report.needles()[0];
        assert_eq!((needle.tip, needle.crossings), (TipPlace::Outside, 0));
        assert_eq!(bench.both(), [vec![], vec![]]);
        if threaded {
            assert_eq!(report.threads()[0].punctures, 0);
        }
        assert_eq!(bench.state.contact_forces(&bench.model).count(), 0);
        assert_eq!(bench.largest_displacement_m(), 0.0);
    }
}

/// All of it through both slabs, and back through the hole that its thread goes through, and no other.
#[test]
fn an_end_goes_back_by_its_threads_hole_alone() {
    for tissue in [open(), tissue()] {
        let mut bench = slab_bench(tissue, straight(0.02), true);
        go(&mut bench, Vector3::new(0.0, 0.0, -0.079));
        let [thread, needle] = bench.both();
        assert!(needle.is_empty() && !thread.is_empty());
        // Beside the hole by more than its thickness.
        let aside = Vector3::new(0.002, 0.0, 0.0);
        let back = Vector3::new(0.0, 0.0, 0.02);
        for way in [aside, back, -back, -aside] {
            go(&mut bench, way);
            let [left, taken] = bench.both();
            assert_eq!((left.len(), taken.len()), (thread.len(), 0));
        }
        go(&mut bench, back);
        bench.is_in_order();
        let [left, taken] = bench.both();
        assert!(left.len() < thread.len() && !taken.is_empty());
        let report = go(&mut bench, Vector3::new(0.0, 0.0, 0.055));
        assert_eq!(bench.both(), [vec![], vec![]]);
        assert_eq!(report.threads()[0].punctures, 0);
        assert_eq!(bench.largest_displacement_m(), 0.0);
    }
}

/// A needle and its thread along a line or circle in tissue that is fixed, to and fro, against all faces: what has passed the end is the
/// thread's, the rest the needle's.
///
/// Tips meet boundaries on the chord of a step: where a circle's needle crosses faces is known to `within_m`.
fn in_fixed_tissue(
    mesh: TetMesh,
    (track, plane, length_m): (Track, Plane, f64),
    (most_m, within_m): (f64, f64),
    (seed, steps): (u64, usize),
) {
    let (needle, start) = needle_on(&track, &plane, 0.0, length_m);
    // One node far off is free, for there to be anything to solve.
    let fixed = (1..mesh.points_m().len() as u32).collect();
    let body = Body::at_rest(&mesh);
    let met = all_faces(&body, &track, &plane);
    let (tissue, settings) = (NeedleTissue::default(), NeedleSettings::default());
    let bench = Bench::new((mesh, fixed), Kind::Linear, needle, start, tissue, settings);
    let mut bench = bench.with_thread(1.0);
    let reach_m = track.iter().map(|(length, _)| length).sum::<f64>() - length_m;
    let random = &mut Random::new(seed);
    let (mut at, mut forward, mut followed) = (0.0, true, 0);
    let mut passes = [0; 2];
    for step in 0..steps {
        forward ^= random.unit() < 50.0 * most_m;
        let by = most_m * random.unit() * if forward { 1.0 } else { -1.0 };
        let to = (at + by).clamp(0.0, reach_m);
        let doubtful =
            |m: &Met| (m.at - to).abs() < within_m || (m.at - to - length_m).abs() < within_m;
        if met.iter().any(doubtful) {
            continue;
        }
        at = to;
        bench.grip = needle_on(&track, &plane, at, length_m).1;
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        bench.is_in_order();
        let own = |from: f64, to: f64| met.iter().filter(move |m| from <= m.at && m.at < to);
        let expected = |from, to| {
            own(from, to)
                .map(|m| (m.half, m.enters))
                .collect::<Vec<_>>()
        };
        let found = bench.both().map(|all| {
            let names = all.iter().map(|crossing| (crossing.face, crossing.enters));
            names.collect::<Vec<_>>()
        });
        let expected = [expected(0.0, at), expected(at, at + length_m)];
        let told = || format!("step {step} at {at} by {by}: {:?} {report:?}", bench.both());
        assert_eq!(found, expected, "{}", told());
        let [_, needle] = bench.both();
        for (found, met) in needle.iter().zip(own(at, at + length_m)) {
            assert!(
                (found.alpha - (met.at - at)).abs() < within_m,
                "{met:?} {}",
                told()
            );
        }
        for (passes, before) in passes
            .iter_mut()
            .zip([followed < found[0].len(), followed > found[0].len()])
        {
            *passes += usize::from(before);
        }
        followed = found[0].len();
    }
    assert!(
        passes[0] > steps / 80 && passes[1] > steps / 80,
        "{passes:?}"
    );
}

#[test]
fn faces_go_to_the_thread_and_back_as_all_faces_have_it() {
    let line = Plane {
        origin: Vector3::new(0.0013, 0.0007, 0.05),
        x: Vector3::new(0.06, 0.02, -1.0).normalize(),
        y: Vector3::new(1.0, 0.0, 0.06).normalize(),
    };
    let along = Vector3::new(1.0, 0.03, 0.02).normalize();
    let circle = Plane {
        origin: Vector3::new(0.0135, -0.009, 0.0151),
        x: along,
        y: Vector3::z().cross(&along).normalize(),
    };
    in_fixed_tissue(
        slabs().0,
        (vec![(0.11, 0.0)], line, 0.02),
        (2e-3, 1e-9),
        (1, 1500),
    );
    let round = std::f64::consts::TAU * 0.009 * 0.93;
    in_fixed_tissue(
        a_tube().0,
        (vec![(round, 0.009f64.recip())], circle, 0.008),
        (4e-4, 1e-5),
        (2, 4000),
    );
}

/// Crossings that share the rows of another go with that, no more and no less, in tissue that is drawn along.
#[test]
fn crossings_without_rows_of_their_own_stay_beside_the_needle() {
    let sticky = NeedleTissue {
        friction_n_per_m: 20.0,
        static_friction_n_per_m: 20.0,
        ..tissue()
    };
    let mut bench = slab_bench(sticky, straight(0.02), true);
    let random = &mut Random::new(3);
    let (mut at, mut forward, mut worst, mut most) = (0.0, true, 0.0f64, 0);
    for _ in 0..600 {
        forward ^= random.unit() < 0.06;
        let by = 1.5e-3 * random.unit() * if forward { 1.0 } else { -1.0 };
        let to = f64::clamp(at + by, 0.0, 0.07);
        bench.grip.translation.vector.z -= to - at;
        at = to;
        assert_eq!(bench.step_both().status.name(), "ok");
        bench.is_in_order();
        let nodes_m = bench.state.positions(&bench.model);
        let pose = bench.state.needle_pose(&bench.model, 0).expect("a needle");
        let curve = straight(0.02).at(&pose);
        let [_, needle] = bench.both();
        for crossing in &needle {
            let nodes = bench.mesh.half_faces().vertices(crossing.face);
            let parts = nodes.into_iter().zip(crossing.weights);
            let point: Vector3<f64> = parts
                .map(|(node, weight)| Vector3::from(nodes_m[node as usize]) * weight)
                .sum();
            let off_m = (point - curve.at(crossing.alpha)).dot(&curve.tangent);
            worst = worst.max(off_m.abs());
        }
        most = most.max(needle.len());
    }
    println!("{worst} m, {most} crossings");
    // As far as tissue is strained within 0.15 mean edges.
    assert!(worst < 1e-4 && most > 10, "{worst} {most}");
}

/// A hand that holds a span between two slabs has the needle take back what lies beyond it, and nothing before it.
#[test]
fn a_hand_on_a_span_keeps_what_lies_before_it() {
    let mut bench = slab_bench(open(), straight(0.02), true);
    // The end is in the lower slab, 3 mm below its top.
    go(&mut bench, Vector3::new(0.0, 0.0, -0.057));
    let [thread, needle] = bench.both();
    let mesh = bench.mesh.half_faces();
    let turns = |all: &[Crossing]| {
        let boundary = all.iter().filter(|c| c.enters || c.leaves(mesh));
        boundary.count()
    };
    assert_eq!((turns(&thread), turns(&needle)), (3, 1));
    let before = 1 + thread
        .iter()
        .position(|c| c.leaves(mesh))
        .expect("a way out");
    bench.other.translation.vector = Vector3::new(0.0013, 0.0007, 0.002);
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Tool(1));
    for step in 0..80 {
        bench.grip.translation.vector.z += 5e-4;
        assert_eq!(bench.step_both().status.name(), "ok", "{step}");
        let [left, _] = bench.both();
        assert!(left.len() >= before, "{step}");
        if left.len() > before {
            bench.is_in_order();
        }
    }
    let [left, needle] = bench.both();
    let faces = |all: &[Crossing]| all.iter().map(|c| (c.face, c.enters)).collect::<Vec<_>>();
    assert_eq!(faces(&left), faces(&thread[..before]));
    assert!(needle.is_empty());
}

/// A thread of one length, its tail held, gives its faces to the needle and takes them again; slack in between, it is as long as before.
#[test]
fn a_thread_that_is_held_at_its_tail_gives_faces_back() {
    let stiff = Through {
        axial_stiffness_n: 200.0,
        ..Through::default()
    };
    for (through, friction) in [
        (INEXTENSIBLE, 0.0),
        (INEXTENSIBLE, 0.2),
        (stiff, 0.0),
        (stiff, 0.2),
    ] {
        let mut bench = drawn(bench(Setup {
            through,
            friction,
            ..SETUP
        }));
        let [all, _] = bench.both();
        for _ in 0..3 {
            // Aside and up to the hole, in by the end up to the upper slab, and out again.
            go(&mut bench, Vector3::new(-0.003, 0.0, 0.003));
            let mut least = all.len();
            for way in [0.05, -0.05] {
                for _ in 0..100 {
                    bench.grip.translation.vector.z += way / 100.0;
                    assert_eq!(bench.step_both().status.name(), "ok");
                    bench.is_in_order();
                    least = least.min(bench.both()[0].len());
                }
            }
            assert!(least < all.len() / 2, "{least}");
            let report = go(&mut bench, Vector3::new(0.003, 0.0, -0.003));
            let faces = bench.both()[0].iter().map(|c| c.face).collect::<Vec<_>>();
            assert_eq!(faces, all.iter().map(|c| c.face).collect::<Vec<_>>());
            assert_eq!(report.threads()[0].punctures, 4);
        }
    }
}
