//! The tangent against steps from the same state to poses nearby, slides included.

use super::bench::*;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::Policy;
use sutura_host::model::Passes;
use sutura_host::needle::{NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::step::{StepOptions, StepReport, step};

/// A left increment about the grip.
fn moved(grip: &Isometry3<f64>, by: &Vector6<f64>) -> Isometry3<f64> {
    let shift: Vector3<f64> = by.fixed_rows::<3>(0).into();
    let turn: Vector3<f64> = by.fixed_rows::<3>(3).into();
    let rotation = UnitQuaternion::from_scaled_axis(turn) * grip.rotation;
    Isometry3::from_parts(
        Translation3::from(grip.translation.vector + shift),
        rotation,
    )
}

fn wrench(report: &StepReport) -> Vector6<f64> {
    Vector6::from(report.contacts()[0].wrench)
}

/// Steps to `to` and compares the tangent there with steps from the same state to its neighbours. Returns the
/// largest difference over the largest entry of its kind.
fn check(bench: &mut Bench, to: Isometry3<f64>) -> (f64, StepReport) {
    let before = bench.state.clone();
    bench.grip = to;
    let (report, _) = bench.go();
    assert_eq!(report.substeps, 1, "a step within one piece");
    let tangent = report.contacts()[0].tangent;
    let tangent = Matrix6::from_fn(|i, j| tangent[i][j]);
    let mut found = Matrix6::zeros();
    let h = 1e-7;
    for axis in 0..6 {
        let mut ends = [Vector6::zeros(); 2];
        for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
            // A turn of 1 rad is worth some 10 mm.
            let size = if axis < 3 { h } else { 100.0 * h };
            let by = Vector6::ith(axis, sign * size);
            let mut state = before.clone();
            bench.grip = moved(&to, &by);
            let sample = bench.sample();
            let there = step(
                &bench.model,
                &mut state,
                &[sample],
                &StepOptions::default(),
                &mut bench.work,
            );
            *end = wrench(&there) / (2.0 * size);
        }
        found.set_column(axis, &(ends[0] - ends[1]));
    }
    bench.grip = to;
    // Forces and moments, shifts and turns have units of their own: block by block.
    let mut worst = 0.0f64;
    for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
        let own = tangent.fixed_view::<3, 3>(i, j);
        let there = found.fixed_view::<3, 3>(i, j);
        worst = worst.max((own - there).amax() / there.amax().max(1e-9));
    }
    if worst > 1e-5 {
        println!("tangent {tangent:.6} found {found:.6}");
    }
    (worst, report)
}

fn bench(
    needle: sutura_host::needle::Needle,
    start: Isometry3<f64>,
    tissue: NeedleTissue,
) -> Bench {
    let mesh = if needle.shape.curvature_per_m() > 0.0 {
        a_tube()
    } else {
        slabs()
    };
    Bench::new(
        mesh,
        Kind::Linear,
        needle,
        start,
        tissue,
        NeedleSettings::default(),
    )
}

/// Drives straight down in steps of 0.1 mm.
fn drive_down(bench: &mut Bench, way_m: f64) {
    let steps = (way_m / 1e-4).round() as usize;
    for _ in 0..steps {
        bench.grip.translation.vector.z -= 1e-4;
        bench.go();
    }
}

#[test]
fn a_straight_needle() {
    let start = frame(
        [0.0013, 0.0007, 0.0605],
        [0.05, 0.02, -1.0],
        [1.0, 0.0, 0.0],
    );
    for (name, tissue) in [
        ("rubbing", tissue()),
        (
            "without friction",
            NeedleTissue {
                friction_n_per_m: 0.0,
                static_friction_n_per_m: 0.0,
                cutting_pa: 0.0,
                ..tissue()
            },
        ),
        (
            "hardly sliding",
            NeedleTissue {
                friction_n_per_m: 500.0,
                static_friction_n_per_m: 500.0,
                ..tissue()
            },
        ),
    ] {
        let mut bench = bench(straight(0.04), start, tissue);
        for (way, tip) in [
            (0.0095, TipPlace::Holding),
            (0.004, TipPlace::Inside),
            (0.006, TipPlace::Holding),
            (0.003, TipPlace::Outside),
        ] {
            drive_down(&mut bench, way);
            // Aside and turned, so that transverse forces act; then a little deeper, or back.
            for by in [
                Vector6::new(3e-5, -2e-5, -5e-5, 2e-3, 1e-3, 3e-3),
                Vector6::new(1e-5, 2e-5, 3e-5, 1e-3, -2e-3, 1e-3),
            ] {
                let to = moved(&bench.grip, &by);
                let (worst, report) = check(&mut bench, to);
                let needle = report.needles()[0];
                println!(
                    "{name}, {:?} ({tip:?} expected), {} crossings, slides {}: {worst:.1e}",
                    needle.tip, needle.crossings, needle.slides
                );
                assert!(worst < 1e-6, "{name}: off by {worst:e}");
            }
        }
    }
}

#[test]
fn an_arc() {
    // About a point outside the tube's wall, through it from outside.
    let (radius, length) = (0.009, 170.0);
    let centre = Vector3::new(0.0135, 0.0, 0.0151);
    let soft = NeedleTissue {
        puncture_pa: 0.2 * tissue().puncture_pa,
        cutting_pa: 0.5 * tissue().cutting_pa,
        ..tissue()
    };
    for tissue in [
        soft,
        NeedleTissue {
            friction_n_per_m: 200.0,
            static_friction_n_per_m: 200.0,
            ..soft
        },
    ] {
        // The tip at first beside the tube, the needle in a plane across the tube's axis, a little tilted.
        let end = centre + Vector3::new(0.0, -radius, 0.0);
        let start = frame(end.into(), [1.0, 0.0, 0.02], [0.0, 1.0, 0.01]);
        let needle = arc(radius, length);
        let mut bench = bench(needle, start, tissue);
        let axis = start.rotation * Vector3::z();
        for step in 0..150 {
            let turn = UnitQuaternion::from_scaled_axis(axis * 0.01);
            bench.grip = Isometry3::from_parts(
                Translation3::from(centre + turn * (bench.grip.translation.vector - centre)),
                turn * bench.grip.rotation,
            );
            if step % 10 == 9 {
                // With a pull aside.
                let by = Vector6::new(2e-5, 3e-5, -4e-5, 1e-3, 2e-3, -1e-3);
                let to = moved(&bench.grip, &by);
                let (worst, report) = check(&mut bench, to);
                let needle = report.needles()[0];
                println!(
                    "{step}: {:?} {} crossings, {} punctures, slides {}: {worst:.1e}",
                    needle.tip, needle.crossings, needle.punctures, needle.slides
                );
                assert!(worst < 1e-6, "{step}: off by {worst:e}");
            } else {
                let report = bench.step();
                if report.status != sutura_host::step::Status::Ok {
                    println!("{step} {:?}", report.status);
                }
            }
        }
    }
}

/// Every neighbour is a whole balance of hyperelastic tissue. With a factor that is always fresh the tangent is its
/// derivative; with one that lasts it is off by what the report says at most.
#[test]
fn a_straight_needle_in_hyperelastic_tissue() {
    let start = frame(
        [0.0013, 0.0007, 0.0605],
        [0.05, 0.02, -1.0],
        [1.0, 0.0, 0.0],
    );
    let fresh = Policy {
        refactor_rotation_rad: 0.0,
        refactor_every: 0,
        cg_iterations: 0,
        cg_tolerance: 0.0,
    };
    let passes = Passes {
        most: 60,
        tolerance: 1e-12,
    };
    for policy in [fresh, Policy::default()] {
        let kind = Kind::Hyperelastic(passes, policy);
        let settings = NeedleSettings::default();
        let mut bench = Bench::new(slabs(), kind, straight(0.04), start, tissue(), settings);
        for (way, tip) in [
            (0.0095, TipPlace::Holding),
            (0.004, TipPlace::Inside),
            (0.006, TipPlace::Holding),
            (0.003, TipPlace::Outside),
        ] {
            drive_down(&mut bench, way);
            for by in [
                Vector6::new(3e-5, -2e-5, -5e-5, 2e-3, 1e-3, 3e-3),
                Vector6::new(1e-5, 2e-5, 3e-5, 1e-3, -2e-3, 1e-3),
            ] {
                let to = moved(&bench.grip, &by);
                let (worst, report) = check(&mut bench, to);
                let needle = report.needles()[0];
                println!(
                    "{:?} ({tip:?} expected), {} crossings, slides {}, {} passes, out of balance {:.0e}: {worst:.1e}, \
                     said {:.1e}",
                    needle.tip,
                    needle.crossings,
                    needle.slides,
                    report.passes,
                    report.imbalance,
                    report.tangent_error
                );
                let most = if policy == fresh {
                    1e-4
                } else {
                    report.tangent_error.max(1e-4)
                };
                assert!(worst < most, "off by {worst:e}, said {most:e}");
            }
        }
    }
}
