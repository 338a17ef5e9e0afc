//! Needles that are put into tissue without a way that led there: nothing is felt of it until they have been out.

use super::bench::*;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::model::Passes;
use sutura_host::needle::{NeedleReport, NeedleSettings, TipPlace};
use sutura_host::step::{Status, StepReport};

/// The slabs are from 4 to 12 mm and from -8 to 0; the needle points straight down, its tip at `tip_m` over the lower top.
fn over_slabs(kind: Kind, length_m: f64, tip_m: f64) -> Bench {
    let end = [0.0013, 0.0007, tip_m + length_m];
    let start = frame(end, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let settings = NeedleSettings::default();
    Bench::new(slabs(), kind, straight(length_m), start, tissue(), settings)
}

/// Puts what tool 0 holds where that is now.
fn put(bench: &mut Bench) -> usize {
    let sample = bench.sample();
    bench.state.put(&sample)
}

/// Nothing acts on anything.
fn touches_nothing(bench: &Bench, (report, needle): (StepReport, NeedleReport)) -> bool {
    let contact = report.contacts()[0];
    contact.wrench == [0.0; 6]
        && contact.tangent == [[0.0; 6]; 6]
        && (report.rows, contact.rows, needle.crossings) == (0, 0, 0)
        && (needle.axial_n, needle.hold_n, needle.limit_n) == (0.0, 0.0, [0.0; 2])
        && bench.largest_displacement_m() == 0.0
}

fn check(kind: fn() -> Kind) {
    let mut bench = over_slabs(kind(), 0.04, 0.014);
    let above = bench.grip;
    bench.go();
    // 6 mm into the upper slab, and 3 mm beside where it was.
    bench.grip.translation.vector += Vector3::new(0.003, 0.0, -0.008);
    assert_eq!(put(&mut bench), 1);
    // On from there: across, deeper, turned, through both slabs, and the tip out between them.
    let ways = [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.002, -0.001, 0.0], 0.0),
        ([0.0, 0.0, -0.001], 0.2),
        ([0.0, 0.0, -0.014], -0.2),
        ([0.0, 0.0, 0.01], 0.0),
    ];
    for (way, turn_rad) in ways {
        for _ in 0..10 {
            bench.grip.translation.vector += 0.1 * Vector3::from(way);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * (0.1 * turn_rad));
            bench.grip.rotation = turn * bench.grip.rotation;
            let went = bench.go();
            assert_eq!(went.1.tip, TipPlace::Waiting, "{way:?}");
            assert!(touches_nothing(&bench, went), "{way:?}: {went:?}");
        }
    }
    // Out, over where it was at first.
    bench.grip = above;
    let went = bench.go();
    assert_eq!((went.1.tip, went.1.punctures), (TipPlace::Outside, 0));
    assert!(touches_nothing(&bench, went), "{went:?}");

    // And in: as a needle that has not been there before, to the bit.
    let mut other = over_slabs(kind(), 0.04, 0.014);
    other.go();
    let mut punctures = 0;
    for step in 0..60 {
        bench.grip.translation.vector.z -= 2e-4;
        other.grip.translation.vector.z -= 2e-4;
        let (own, fresh) = (bench.go(), other.go());
        assert_eq!(own.0.contacts(), fresh.0.contacts(), "{step}");
        assert_eq!(own.1, fresh.1, "{step}");
        punctures = own.1.punctures;
    }
    assert_eq!(punctures, 1);
}

#[test]
fn a_needle_that_is_put_into_tissue_waits_until_it_has_been_out() {
    check(|| Kind::Linear);
}

#[test]
fn in_corotational_tissue_too() {
    check(|| {
        Kind::Corotational(Passes {
            most: 2,
            tolerance: 1e-6,
        })
    });
}

/// What is in tissue may be any part of it: the tip, the middle, the end, or all of it within one cell.
#[test]
fn any_part_of_a_needle_in_tissue_has_it_wait() {
    for (length_m, tip_m, waits) in [
        (0.04, 0.011, true),
        (0.04, 0.002, true),
        (0.004, 0.002, true),
        (0.0005, 0.0053, true),
        (0.003, 0.0005, false),
        (0.04, 0.0122, false),
    ] {
        let mut bench = over_slabs(Kind::Linear, length_m, 0.03);
        bench.go();
        bench.grip.translation.vector.z += tip_m - 0.03;
        assert_eq!(put(&mut bench), 1);
        let went = bench.go();
        let expected = if waits {
            TipPlace::Waiting
        } else {
            TipPlace::Outside
        };
        assert_eq!(went.1.tip, expected, "{length_m} m, tip at {tip_m} m");
        assert!(touches_nothing(&bench, went));
    }
}

/// A needle in its hole is where it is: that nobody looked for a while does not take it out.
#[test]
fn a_needle_in_a_hole_stays_in_it() {
    let mut bench = over_slabs(Kind::Linear, 0.04, 0.014);
    for _ in 0..30 {
        bench.grip.translation.vector.z -= 2e-4;
        bench.go();
    }
    let (before, needle) = bench.go();
    assert_eq!((needle.tip, needle.punctures), (TipPlace::Inside, 1));
    assert_eq!(put(&mut bench), 0);
    let (after, again) = bench.go();
    assert_eq!(
        (again.tip, again.crossings, again.punctures),
        (TipPlace::Inside, needle.crossings, 1)
    );
    let force = |report: &StepReport| {
        let [x, y, z, ..] = report.contacts()[0].wrench;
        Vector3::new(x, y, z)
    };
    let change = (force(&after) - force(&before)).norm();
    assert!(force(&before).norm() > 0.05 && change < 1e-9, "{change}");
    // One that has only pressed on a face is in none.
    let mut bench = over_slabs(Kind::Linear, 0.04, 0.0125);
    for _ in 0..10 {
        bench.grip.translation.vector.z -= 1e-4;
        bench.go();
    }
    let (_, needle) = bench.go();
    assert_eq!((needle.tip, needle.punctures), (TipPlace::Holding, 0));
    bench.grip.translation.vector.z -= 4e-3;
    assert_eq!(put(&mut bench), 1);
    let went = bench.go();
    assert_eq!(went.1.tip, TipPlace::Waiting);
    assert!(touches_nothing(&bench, went));
}

/// Nobody else's needle is put, and no tool that is nowhere puts one.
#[test]
fn only_what_the_tool_holds_is_put() {
    let mut bench = over_slabs(Kind::Linear, 0.04, 0.014);
    bench.go();
    let mut sample = bench.sample();
    sample.position_m[2] = f64::NAN;
    assert_eq!(bench.state.put(&sample), 0);
    assert_eq!(bench.state.put(&bench.sample_of(1)), 0);
    assert!(bench.hold(0, None));
    bench.grip.translation.vector.z -= 0.008;
    assert_eq!(put(&mut bench), 0);
    let (report, needle) = bench.go();
    assert_eq!(report.status, Status::Ok);
    assert_eq!(needle.tip, TipPlace::Outside);
}

/// Being put, waiting, coming out and going in: no step of it allocates.
#[test]
fn waiting_allocates_nothing() {
    let mut bench = over_slabs(Kind::Linear, 0.04, 0.014);
    bench.go();
    let mut punctures = 0;
    let allocated = allocation_counter::measure(|| {
        bench.grip.translation.vector.z -= 0.008;
        put(&mut bench);
        for tick in 0..100 {
            let up = if tick < 45 { 2e-4 } else { -2e-4 };
            bench.grip.translation.vector.z += up;
            let report = bench.step();
            punctures = report.needles()[0].punctures;
        }
    });
    assert_eq!(punctures, 1);
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
