//! Axial force over an insertion and a withdrawal.

use super::bench::*;
use nalgebra::Vector3;
use sutura_host::model::Passes;
use sutura_host::needle::{NeedleReport, NeedleSettings, NeedleTissue, TipPlace};

/// Depth of the tip below the lower slab's top \[m\] and what the step said.
struct Sample {
    tip_m: f64,
    needle: NeedleReport,
    largest_m: f64,
}

const STEP_M: f64 = 1e-4;
/// Straight down; the upper slab lies from 4 to 12 mm, the lower one from -8 to 0 mm.
const FROM_M: f64 = 0.014;
const TO_M: f64 = -0.013;

/// In and out again, a sample for each step.
fn trace(kind: Kind, lower: NeedleTissue) -> (Bench, Vec<Sample>) {
    let start = frame(
        [0.0013, 0.0007, FROM_M + 0.04],
        [0.0, 0.0, -1.0],
        [1.0, 0.0, 0.0],
    );
    let mesh = slabs();
    let by_cell: Vec<NeedleTissue> = mesh
        .0
        .cells()
        .iter()
        .map(|cell| {
            let low = mesh.0.points_m()[cell[0] as usize][2] < 0.002;
            if low { lower } else { tissue() }
        })
        .collect();
    let settings = NeedleSettings::default();
    let mut bench = Bench::of(mesh, kind, straight(0.04), start, &by_cell, settings);
    let steps = ((FROM_M - TO_M) / STEP_M).round() as i32;
    let mut samples = Vec::new();
    for step in 0..=2 * steps {
        let down = f64::from(steps - (step - steps).abs()) * STEP_M;
        bench.grip.translation.vector = start.translation.vector - Vector3::z() * down;
        let (_, needle) = bench.go();
        let largest_m = if step % 20 == 0 {
            bench.largest_displacement_m()
        } else {
            0.0
        };
        samples.push(Sample {
            tip_m: FROM_M - down,
            needle,
            largest_m,
        });
    }
    (bench, samples)
}

fn check(kind: Kind, exact: bool) {
    let lower = NeedleTissue {
        friction_n_per_m: 15.0,
        static_friction_n_per_m: 15.0,
        ..tissue()
    };
    let (mut bench, samples) = trace(kind, lower);
    let turn = samples.len() / 2;
    let (down, up) = samples.split_at(turn);

    // Held until the threshold, within what one step adds; then it drops to what rubs and cuts.
    let mut seen = 0;
    for pair in down.windows(2) {
        let [before, after] = [&pair[0].needle, &pair[1].needle];
        if after.punctures == before.punctures {
            continue;
        }
        seen += 1;
        assert_eq!(after.punctures, before.punctures + 1);
        assert_eq!(before.tip, TipPlace::Holding);
        let step_n = 1.1 * before.stiffness_n_per_m[0] * STEP_M;
        let short = before.puncture_n - before.hold_n;
        assert!(
            short >= 0.0 && short <= step_n,
            "broke {short} N short of the threshold, a step is {step_n} N"
        );
        let rest = after.limit_n[0] + 1e-9;
        assert!(
            -after.axial_n <= rest,
            "{} N are left, {rest} N rub and cut",
            after.axial_n
        );
        assert!(-after.axial_n < -before.axial_n - 0.1, "no drop");
    }
    assert_eq!(seen, 4, "both faces of both slabs");
    for pair in down.windows(2) {
        let [before, after] = [&pair[0].needle, &pair[1].needle];
        if before.tip == TipPlace::Holding && after.tip == TipPlace::Holding {
            assert!(after.hold_n > before.hold_n, "does not rise");
        }
    }

    // Through both layers, nothing holds: what rubs in a layer is its friction by its thickness.
    let plateau = |samples: &[Sample], crossed: u32, tip: TipPlace| -> Vec<f64> {
        samples
            .iter()
            .filter(|sample| sample.needle.punctures == crossed && sample.needle.tip == tip)
            .map(|sample| sample.needle.axial_n)
            .collect()
    };
    let one = plateau(down, 2, TipPlace::Outside);
    assert!(one.len() > 3);
    let expected = 5.0 * 0.008;
    // The layer is a little stretched by the friction itself; corotational tissue lags by a pass.
    let slack = if exact { 0.03 } else { 0.06 };
    for force in one {
        assert!(
            (-force / expected - 1.0).abs() < slack,
            "{force} N for {expected} N"
        );
    }
    let both = down.last().expect("samples").needle;
    assert_eq!((both.punctures, both.tip), (4, TipPlace::Outside));
    let expected = (5.0 + 15.0) * 0.008;
    assert!(
        (-both.axial_n / expected - 1.0).abs() < slack,
        "{} N for {expected} N",
        both.axial_n
    );

    // Hysteresis: on the way back it rubs the other way, without cutting or holding.
    let back = up
        .iter()
        .filter(|sample| sample.needle.crossings > 0 && sample.tip_m > TO_M + 0.008)
        .map(|sample| (sample.needle.axial_n, sample.needle.limit_n[1]));
    for (force, limit) in back {
        assert!(
            force > 0.0 && force <= limit * (1.0 + 1e-9),
            "{force} N of {limit} N"
        );
    }

    // Out again: no rows; the tissue is back.
    let largest = samples
        .iter()
        .map(|sample| sample.largest_m)
        .fold(0.0, f64::max);
    assert!(largest > 1e-4);
    let end = samples.last().expect("samples").needle;
    assert_eq!((end.crossings, end.tip), (0, TipPlace::Outside));
    let rest = if exact { 0 } else { 40 };
    for _ in 0..rest {
        bench.go();
    }
    assert!(bench.state.crossings(&bench.model, 0).is_empty());
    assert_eq!(bench.state.contact_forces(&bench.model).count(), 0);
    let left = bench.largest_displacement_m();
    assert!(left <= 1e-9 * largest, "{left} m of {largest} m are left");
}

#[test]
fn force_on_linear_tissue() {
    check(Kind::Linear, true);
}

#[test]
fn force_on_corotational_tissue() {
    check(Kind::Corotational(Passes::default()), false);
}
