//! What the hand does is stored or spent.

use super::bench::*;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::needle::{NeedleSettings, Playback};
use sutura_host::step::StepReport;

/// Largest |work - change of stored energy - dissipation| over the largest stored energy along a path of grips.
pub struct Ledger {
    work_j: f64,
    pub peak_j: f64,
    pub worst_j: f64,
    last: Option<(Isometry3<f64>, Vector6<f64>, f64)>,
    at_start: f64,
}

impl Ledger {
    pub fn new() -> Self {
        Self {
            work_j: 0.0,
            peak_j: 0.0,
            worst_j: 0.0,
            last: None,
            at_start: 0.0,
        }
    }

    /// Books a step.
    pub fn book(&mut self, grip: &Isometry3<f64>, report: &StepReport) {
        let wrench = Vector6::from(report.contacts()[0].wrench);
        let spent: f64 = report.needles()[0].dissipated_j.iter().sum();
        let stored = report.stored_energy_j;
        if let Some((before, then, _)) = &self.last {
            let shift = grip.translation.vector - before.translation.vector;
            let turn = (grip.rotation * before.rotation.inverse()).scaled_axis();
            let way = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
            self.work_j -= 0.5 * (wrench + then).dot(&way);
        } else {
            self.at_start = stored + spent;
        }
        self.peak_j = self.peak_j.max(stored);
        let signed = self.work_j - (stored + spent - self.at_start);
        let off = signed.abs();
        self.worst_j = self.worst_j.max(off);
        self.last = Some((*grip, wrench, stored));
    }

    pub fn error(&self) -> f64 {
        self.worst_j / self.peak_j
    }
}

fn straight_path(playback: Playback, step_m: f64) -> f64 {
    let start = frame(
        [0.0013, 0.0007, 0.0605],
        [0.05, 0.02, -1.0],
        [1.0, 0.0, 0.0],
    );
    let settings = NeedleSettings {
        playback,
        ..NeedleSettings::default()
    };
    let mut bench = Bench::new(
        slabs(),
        Kind::Linear,
        straight(0.04),
        start,
        tissue(),
        settings,
    );
    let mut ledger = Ledger::new();
    let way = 0.031;
    let steps = (way / step_m).round() as usize;
    let axis = start.rotation * Vector3::x();
    for step in 0..=2 * steps {
        let part = 1.0 - (step as f64 / steps as f64 - 1.0).abs();
        // Sideways as well, and a little turn, while inside.
        let aside = Vector3::new(0.4e-3, -0.3e-3, 0.0) * (3.0 * std::f64::consts::PI * part).sin();
        let turn =
            UnitQuaternion::from_scaled_axis(Vector3::new(0.02, 0.01, 0.03) * (part * 4.0).sin());
        bench.grip = Isometry3::from_parts(
            Translation3::from(start.translation.vector + axis * (way * part) + aside),
            turn * start.rotation,
        );
        let (report, _) = bench.go();
        ledger.book(&bench.grip, &report);
        // The energy once more, from the displacement of all nodes.
        if step % 97 == 0 {
            let whole = bench.model.equilibrium(&bench.state).expect("a balance");
            let twice: f64 = bench
                .state
                .contact_forces(&bench.model)
                .map(|(node, force)| {
                    let u = whole.displacement_m[node as usize];
                    (0..3).map(|axis| force[axis] * u[axis]).sum::<f64>()
                })
                .sum();
            let off = (0.5 * twice - report.stored_energy_j).abs();
            assert!(
                off <= 1e-9 * ledger.peak_j.max(1e-12),
                "stored energy off by {off:e} J"
            );
        }
    }
    let report = bench.go().1;
    println!(
        "{playback:?} {step_m} m: error {:.2e} of {:.3e} J, {:?}",
        ledger.error(),
        ledger.peak_j,
        report.dissipated_j
    );
    ledger.error()
}

/// An arc through a tube's wall and back, steps of so much along its circle.
fn arc_path(step_m: f64) -> f64 {
    let radius = 0.009;
    let centre = Vector3::new(0.0135, 0.0, 0.0151);
    let end = centre + Vector3::new(0.0, -radius, 0.0);
    let start = frame(end.into(), [1.0, 0.0, 0.02], [0.0, 1.0, 0.01]);
    let tissue = sutura_host::needle::NeedleTissue {
        puncture_pa: 0.2 * tissue().puncture_pa,
        cutting_pa: 0.5 * tissue().cutting_pa,
        ..tissue()
    };
    let settings = NeedleSettings::default();
    let mut bench = Bench::new(
        a_tube(),
        Kind::Linear,
        arc(radius, 170.0),
        start,
        tissue,
        settings,
    );
    let mut ledger = Ledger::new();
    let axis = start.rotation * Vector3::z();
    let steps = (1.6 * radius / step_m).round() as usize;
    let mut punctures = 0;
    for step in 0..=2 * steps {
        let part = 1.0 - (step as f64 / steps as f64 - 1.0).abs();
        let turn = UnitQuaternion::from_scaled_axis(axis * (0.9 + 0.9 * part));
        let aside = Vector3::new(0.1e-3, 0.0, 0.2e-3) * (3.0 * std::f64::consts::PI * part).sin();
        bench.grip = Isometry3::from_parts(
            Translation3::from(centre + turn * (start.translation.vector - centre) + aside),
            turn * start.rotation,
        );
        let (report, needle) = bench.go();
        punctures = needle.punctures;
        ledger.book(&bench.grip, &report);
    }
    println!(
        "arc {step_m} m: error {:.2e} of {:.3e} J, {punctures} punctures",
        ledger.error(),
        ledger.peak_j
    );
    ledger.error()
}

#[test]
fn an_arc_in_and_out() {
    let coarse = arc_path(4e-5);
    let fine = arc_path(1e-5);
    assert!(fine <= 0.01, "{fine}");
    assert!(
        fine < 0.6 * coarse,
        "does not go with the step: {coarse} to {fine}"
    );
}

#[test]
fn a_straight_needle_in_and_out() {
    let coarse = straight_path(Playback::OneSolve, 4e-5);
    let fine = straight_path(Playback::OneSolve, 1e-5);
    assert!(fine <= 0.01, "{fine}");
    assert!(
        fine < 0.6 * coarse,
        "does not go with the step: {coarse} to {fine}"
    );
    // Sixteen poses over the way of a puncture are coarse themselves.
    let every = straight_path(Playback::EveryPose, 1e-5);
    assert!(every <= 0.03, "{every}");
}
