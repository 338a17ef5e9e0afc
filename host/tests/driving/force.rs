//! Axial force over an insertion and a withdrawal.

use super::bench::*;
use nalgebra::Vector3;
use sutura_host::needle::NeedleSettings;

#[test]
fn trace() {
    let start = frame([0.0013, 0.0007, 0.065], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let mut bench = Bench::new(
        slabs(),
        Kind::Linear,
        straight(0.04),
        start,
        tissue(),
        NeedleSettings::default(),
    );
    let steps = 400;
    let deep = 0.035;
    for step in 0..=2 * steps {
        let part = 1.0 - (f64::from(step) / f64::from(steps) - 1.0).abs();
        bench.grip.translation.vector = start.translation.vector - Vector3::z() * (deep * part);
        let report = bench.step();
        if step % 10 == 0 || report.status != sutura_host::step::Status::Ok {
            let needle = report.needles().first().copied().unwrap_or_default();
            println!(
                "{step:4} {:?} tip {:8.3} mm {:?} crossings {} punctures {} axial {:8.4} limit {:.3} {:.3} hold {:.4}/{:.4} k {:.1} {:.1} E {:.3e} diss {:?} rows {} sub {} guess {}",
                report.status,
                1e3 * (bench.grip.translation.vector.z - 0.04),
                needle.tip,
                needle.crossings,
                needle.punctures,
                needle.axial_n,
                needle.limit_n[0],
                needle.limit_n[1],
                needle.hold_n,
                needle.puncture_n,
                needle.stiffness_n_per_m[0],
                needle.stiffness_n_per_m[1],
                report.stored_energy_j,
                needle.dissipated_j,
                report.rows,
                report.substeps,
                needle.guessed,
            );
        }
    }
}
