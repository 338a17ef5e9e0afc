//! A step with needles allocates nothing once the columns are there, punctures included.

use super::bench::*;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use sutura_host::fem::Policy;
use sutura_host::model::Passes;
use sutura_host::needle::{Needle, NeedleSettings, NeedleTissue, Playback};
use sutura_host::step::Status;

/// In and out along itself with some shaking, a sample that is none, and the last third with nobody at the
/// needle. Steps that went well, punctures, most crossings.
fn in_and_out(bench: &mut Bench, needle: &Needle, way_m: f64) -> (u32, u32, u32) {
    let start = bench.grip;
    let (mut well, mut punctures, mut most) = (0, 0, 0);
    for tick in 0..300 {
        let part = 1.0 - (f64::from(tick) / 100.0 - 1.0).abs().min(1.0);
        let curve = needle.at(&start);
        let by = part * way_m;
        let turn = UnitQuaternion::from_scaled_axis(curve.binormal() * (by * curve.curvature));
        let shake = Vector3::new(1e-4, 5e-5, 0.0) * f64::from(tick).sin();
        bench.grip = Isometry3::from_parts(
            Translation3::from(curve.at(by) + shake),
            turn * start.rotation,
        );
        bench.time_us += 5000;
        let mut sample = bench.sample();
        if tick == 50 {
            sample.position_m[0] = f64::NAN;
        }
        if tick == 120 {
            bench.state.hold(&bench.model, 0, None);
        }
        if tick == 130 {
            let pose = bench.state.needle_pose(&bench.model, 0);
            bench.grip = pose.unwrap_or(bench.grip);
            let sample = bench.sample();
            bench.state.hold(&bench.model, 0, Some(&sample));
        }
        let report = bench.follow(&[sample]);
        well += u32::from(report.status == Status::Ok);
        if let Some(needle) = report.needles().first() {
            punctures = needle.punctures;
            most = most.max(needle.crossings);
        }
    }
    (well, punctures, most)
}

fn check(mut bench: Bench, needle: &Needle, way_m: f64, all_well: bool) {
    bench.step();
    let mut found = (0, 0, 0);
    let allocated = allocation_counter::measure(|| {
        found = in_and_out(&mut bench, needle, way_m);
    });
    let (well, punctures, most) = found;
    assert!(punctures >= 2 && most >= 3, "{found:?}");
    assert!(well == 299 || (!all_well && well > 200), "{well}");
    assert_eq!(allocated.count_total, 0, "{allocated:?}");

    // The counter sees what columns that are not there cost.
    let mut cold = sutura_host::step::Workspace::new(&bench.model);
    std::mem::swap(&mut bench.work, &mut cold);
    let allocated = allocation_counter::measure(|| {
        in_and_out(&mut bench, needle, way_m);
    });
    assert!(allocated.count_total > 0);
}

fn soft() -> NeedleTissue {
    NeedleTissue {
        puncture_pa: 0.2 * tissue().puncture_pa,
        cutting_pa: 0.5 * tissue().cutting_pa,
        ..tissue()
    }
}

fn line(kind: Kind, playback: Playback) -> (Bench, Needle) {
    let needle = straight(0.04);
    let start = frame([0.0013, 0.0007, 0.0535], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let settings = NeedleSettings {
        playback,
        ..NeedleSettings::default()
    };
    (
        Bench::new(slabs(), kind, needle, start, soft(), settings),
        needle,
    )
}

fn bent(kind: Kind) -> (Bench, Needle) {
    let needle = arc(0.009, 170.0);
    let start = frame([0.0135, -0.009, 0.0151], [1.0, 0.0, 0.02], [0.0, 1.0, 0.01]);
    let settings = NeedleSettings::default();
    (
        Bench::new(a_tube(), kind, needle, start, soft(), settings),
        needle,
    )
}

#[test]
fn straight_needles_in_linear_tissue() {
    for playback in [Playback::OneSolve, Playback::EveryPose] {
        let (bench, needle) = line(Kind::Linear, playback);
        check(bench, &needle, 0.027, true);
    }
}

/// Needles that are shorter than their way: the end goes in, gives faces to the thread, if there is one, and comes out again.
#[test]
fn ends_that_go_in_and_out() {
    let halves = of_segments(&[(0.007, f64::INFINITY); 2]);
    let start = frame([0.0013, 0.0007, 0.0275], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    for (needle, threaded) in [(halves, true), (straight(0.014), false)] {
        let settings = NeedleSettings::default();
        let mut bench = Bench::new(slabs(), Kind::Linear, needle, start, soft(), settings);
        if threaded {
            bench = bench.with_thread(0.2);
        }
        check(bench, &needle, 0.022, true);
    }
}

#[test]
fn arcs_in_linear_tissue() {
    let (bench, needle) = bent(Kind::Linear);
    check(bench, &needle, 0.016, true);
}

#[test]
fn needles_in_corotational_tissue() {
    let kind = || {
        Kind::Corotational(Passes {
            most: 2,
            tolerance: 1e-6,
        })
    };
    let (bench, needle) = line(kind(), Playback::OneSolve);
    check(bench, &needle, 0.027, false);
    let (bench, needle) = bent(kind());
    check(bench, &needle, 0.016, false);
}

#[test]
fn needles_in_hyperelastic_tissue() {
    let kind = || {
        let passes = Passes {
            most: 3,
            tolerance: 1e-6,
        };
        Kind::Hyperelastic(passes, Policy::default())
    };
    let (bench, needle) = line(kind(), Playback::OneSolve);
    check(bench, &needle, 0.027, false);
    let (bench, needle) = bent(kind());
    check(bench, &needle, 0.016, false);
}
