//! What a pulled thread does at every step.

use super::rig::*;
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use sutura_host::step::{StepReport, step};
use sutura_host::thread::ThreadTension;

/// Work of both hands against what is stored and spent, over the largest stored energy.
struct Ledger {
    last: Option<(
        [Vector3<f64>; 2],
        [UnitQuaternion<f64>; 2],
        [Vector6<f64>; 2],
    )>,
    work_j: f64,
    start_j: f64,
    peak_j: f64,
    worst_j: f64,
}

impl Ledger {
    fn book(&mut self, bench: &Bench, report: &StepReport) {
        let poses = [bench.grip, bench.other];
        let at = poses.map(|pose| pose.translation.vector);
        let turned = poses.map(|pose| pose.rotation);
        let wrench = [0, 1].map(|tool| Vector6::from(report.contacts()[tool].wrench));
        let spent: f64 = report.needles()[0].dissipated_j.iter().sum();
        let stored = report.stored_energy_j + spent + report.threads()[0].dissipated_j;
        match &self.last {
            None => self.start_j = stored,
            Some((from, before, then)) => {
                for tool in 0..2 {
                    let way = at[tool] - from[tool];
                    let turn = (turned[tool] * before[tool].inverse()).scaled_axis();
                    let twist = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
                    self.work_j -= 0.5 * (wrench[tool] + then[tool]).dot(&twist);
                }
            }
        }
        self.peak_j = self.peak_j.max(report.stored_energy_j);
        self.worst_j = self
            .worst_j
            .max((self.work_j - (stored - self.start_j)).abs());
        self.last = Some((at, turned, wrench));
    }
}

/// Pulls, lets go again and pulls once more with both hands; the energy's error over its peak.
fn cycle(mut bench: Bench, pull_m: f64, step_m: f64) -> f64 {
    let mut ledger = Ledger {
        last: None,
        work_j: 0.0,
        start_j: 0.0,
        peak_j: 0.0,
        worst_j: 0.0,
    };
    let mut start = [bench.grip, bench.other];
    // Half a millimetre of slack.
    start[1].translation.vector.z -= 5e-4;
    let steps = (pull_m / step_m).round() as i32;
    let (mut slack, mut taut) = (0, 0);
    for k in 0..=3 * steps {
        let part = 1.0 - (f64::from((k + steps) % (2 * steps)) / f64::from(steps) - 1.0).abs();
        let part = 1.0 - part;
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.0) * part);
        bench.grip = start[0];
        bench.grip.rotation = turn * start[0].rotation;
        bench.grip.translation.vector += Vector3::new(0.3, 0.1, -1.0) * (part * pull_m);
        bench.other = start[1];
        bench.other.translation.vector += Vector3::new(-0.2, 0.3, 0.6) * (part * pull_m);
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        bench.look(&report);
        let thread = report.threads()[0];
        let over = thread.length_m - thread.available_m;
        match thread.state {
            ThreadTension::Slack => {
                slack += 1;
                assert_eq!(thread.tension_n, [0.0; 2]);
                assert!(over <= 1e-6, "{thread:?}");
            }
            ThreadTension::Taut => {
                taut += 1;
                assert!(thread.tension_n.iter().all(|tension| *tension > 0.0));
                assert!(over.abs() <= 1e-6, "{thread:?}");
            }
            ThreadTension::Strained => panic!("{thread:?}"),
        }
        ledger.book(&bench, &report);
    }
    assert!(slack > 0 && taut > steps, "{slack} {taut}");
    println!("{step_m}: {} of {} J", ledger.worst_j, ledger.peak_j);
    ledger.worst_j / ledger.peak_j
}

#[test]
fn what_the_hands_do_is_stored() {
    let error = cycle(drawn(bench(0.0, 20.0, false)), 0.004, 4e-5);
    assert!(error < 0.01, "{error}");
}

#[test]
fn what_the_hands_do_is_stored_when_the_slabs_touch() {
    let error = cycle(drawn(bench(0.0, 20.0, true)), 0.008, 4e-5);
    assert!(error < 0.01, "{error}");
}

/// Both tools' tangents against steps from the same state with a tool moved a little.
#[test]
fn both_hands_feel_how_the_tension_changes() {
    let mut bench = drawn(bench(0.0, 20.0, false));
    go(&mut bench, Vector3::new(0.001, 0.0005, -0.002));
    let report = bench.step_both();
    assert_eq!(report.threads()[0].state, ThreadTension::Taut);
    let mut worst = 0.0f64;
    for tool in 0..2usize {
        let exact = report.contacts()[tool].tangent;
        let largest = exact
            .as_flattened()
            .iter()
            .fold(0.0f64, |a, b| a.max(b.abs()));
        let translation = exact[..3].iter().flat_map(|row| &row[..3]);
        assert!(translation.fold(0.0f64, |a, b| a.max(b.abs())) > 10.0);
        for axis in 0..6 {
            let h = if axis < 3 { 1e-6 } else { 1e-4 };
            let moved = [-h, h].map(|by| {
                let mut state = bench.state.clone();
                let mut samples = [bench.sample_of(0), bench.sample_of(1)];
                if axis < 3 {
                    samples[tool].position_m[axis] += by;
                } else {
                    let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis - 3, by));
                    let pose = if tool == 0 { bench.grip } else { bench.other };
                    let coords = (turn * pose.rotation).coords;
                    samples[tool].orientation = [coords.x, coords.y, coords.z, coords.w];
                }
                let report = step(&bench.model, &mut state, &samples, &mut bench.work);
                assert_eq!(report.status.name(), "ok");
                report.contacts()[tool].wrench
            });
            for row in 0..6 {
                let found = (moved[1][row] - moved[0][row]) / (2.0 * h);
                let off = (found - exact[row][axis]).abs();
                worst = worst.max(off / largest);
                assert!(
                    off <= 1e-3 * largest,
                    "tool {tool} row {row} axis {axis}: {found} {}",
                    exact[row][axis]
                );
            }
        }
    }
    println!("{worst:e}");
}
