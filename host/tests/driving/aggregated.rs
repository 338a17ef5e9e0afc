//! What it would cost to solve only every few steps and follow the last tangent in between.

use super::bench::*;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::needle::NeedleSettings;
use sutura_host::step::StepReport;

fn bench() -> (Bench, Isometry3<f64>) {
    let start = frame(
        [0.0013, 0.0007, 0.0535],
        [0.03, 0.01, -1.0],
        [1.0, 0.0, 0.0],
    );
    let settings = NeedleSettings::default();
    (
        Bench::new(
            slabs(),
            Kind::Linear,
            straight(0.04),
            start,
            tissue(),
            settings,
        ),
        start,
    )
}

fn pose(start: &Isometry3<f64>, part: f64) -> Isometry3<f64> {
    let axis = start.rotation * Vector3::x();
    // In, and half out; aside and turned on the way.
    let way = 0.027
        * if part < 0.7 {
            part / 0.7
        } else {
            1.0 - (part - 0.7)
        };
    let wave = (40.0 * part).sin();
    let aside = Vector3::new(3e-4, -2e-4, 0.0) * wave;
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.005, 0.02) * wave);
    let to = Translation3::from(start.translation.vector + axis * way + aside);
    Isometry3::from_parts(to, turn * start.rotation)
}

fn twist(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
    let way = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}

#[test]
fn following_the_tangent_in_between() {
    // 100 mm/s at 200 Hz would be 0.5 mm; a slow hand does 20 mm/s.
    let steps = 400;
    let (mut all, start) = bench();
    let full: Vec<StepReport> = (0..=steps)
        .map(|step| {
            all.grip = pose(&start, f64::from(step) / f64::from(steps));
            all.go().0
        })
        .collect();
    let peak = full
        .iter()
        .map(|report| {
            Vector6::from(report.contacts()[0].wrench)
                .fixed_rows::<3>(0)
                .norm()
        })
        .fold(0.0, f64::max);
    let event = |step: usize| {
        let [a, b] = [step - 1, step].map(|at| full[at].needles()[0]);
        (a.tip, a.crossings, a.punctures, a.slides) != (b.tip, b.crossings, b.punctures, b.slides)
    };
    // In how many steps does everything that rubs stick?
    let sticks = full.iter().filter(|report| {
        let needle = report.needles()[0];
        needle.crossings > 0 && !needle.slides
    });
    let held = full
        .iter()
        .filter(|report| report.needles()[0].crossings > 0);
    println!(
        "{} steps with crossings, {} of them stick",
        held.count(),
        sticks.count()
    );
    for wait_for_events in [false, true] {
        for every in [1usize, 2, 4, 8] {
            let (mut bench, _) = bench();
            let mut last: Option<(Isometry3<f64>, StepReport)> = None;
            let (mut worst, mut square, mut solves, mut since, mut work, mut exact) =
                (0.0f64, 0.0, 0, 0, 0.0, 0.0);
            let mut before: Option<(Isometry3<f64>, Vector6<f64>, Vector6<f64>)> = None;
            for (step, truth) in full.iter().enumerate() {
                bench.grip = pose(&start, step as f64 / f64::from(steps));
                let due = since + 1 >= every || last.is_none() || (wait_for_events && event(step));
                let wrench = match &last {
                    Some((at, report)) if !due => {
                        bench.time_us += 5000;
                        since += 1;
                        let contact = report.contacts()[0];
                        let tangent = Matrix6::from_fn(|i, j| contact.tangent[i][j]);
                        Vector6::from(contact.wrench) + tangent * twist(at, &bench.grip)
                    }
                    _ => {
                        since = 0;
                        solves += 1;
                        let (report, _) = bench.go();
                        last = Some((bench.grip, report));
                        Vector6::from(report.contacts()[0].wrench)
                    }
                };
                let truth = Vector6::from(truth.contacts()[0].wrench);
                let off = (wrench - truth).fixed_rows::<3>(0).norm() / peak;
                worst = worst.max(off);
                square += off * off;
                if let Some((at, own, right)) = &before {
                    let by = twist(at, &bench.grip);
                    work -= 0.5 * (wrench + own).dot(&by);
                    exact -= 0.5 * (truth + right).dot(&by);
                }
                before = Some((bench.grip, wrench, truth));
            }
            let rms = (square / full.len() as f64).sqrt();
            println!(
                "events {wait_for_events}, every {every}: {solves} solves, worst {:.1} %, rms {:.1} % of {peak:.3} N, work off by {:.1} %",
                100.0 * worst,
                100.0 * rms,
                100.0 * (work / exact - 1.0)
            );
            if every == 1 {
                assert!(worst < 1e-12);
            }
        }
    }
}
