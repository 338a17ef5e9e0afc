//! The way that is gone once more after a puncture: at once, or a solve at each of its poses.

use super::bench::*;
use nalgebra::Vector3;
use sutura_host::mesh::HalfFace;
use sutura_host::needle::{NeedleReport, NeedleSettings, NeedleTissue, Playback};

/// Straight down with a threshold of so much \[N\]: faces that the needle goes through at the end, punctures,
/// and what was felt.
fn down(
    playback: Playback,
    puncture_n: f64,
    step_m: f64,
) -> (Vec<(HalfFace, bool)>, Vec<NeedleReport>) {
    let scale = puncture_n / 0.2;
    let tissue = NeedleTissue {
        puncture_pa: scale * tissue().puncture_pa,
        cutting_pa: 0.05 * tissue().cutting_pa,
        ..tissue()
    };
    let start = frame(
        [0.0013, 0.0007, 0.0535],
        [0.03, 0.01, -1.0],
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
        tissue,
        settings,
    );
    let axis = start.rotation * Vector3::x();
    let steps = (0.027 / step_m).round() as u32;
    let mut reports = Vec::new();
    for step in 0..=steps {
        let way = 0.027 * f64::from(step) / f64::from(steps);
        bench.grip.translation.vector = start.translation.vector + axis * way;
        let (report, needle) = bench.go();
        bench.look(&report);
        reports.push(needle);
    }
    let crossings = bench.state.crossings(&bench.model, 0).iter();
    (crossings.map(|c| (c.face, c.enters)).collect(), reports)
}

#[test]
fn both_ways_end_in_the_same_faces() {
    let mut apart = Vec::new();
    for puncture_n in [0.2, 0.05, 0.0125] {
        let step_m = 1e-4;
        let (faces, one) = down(Playback::OneSolve, puncture_n, step_m);
        let (also, every) = down(Playback::EveryPose, puncture_n, step_m);
        assert_eq!(faces, also);
        assert!(faces.len() > 8);
        let [last, other] = [&one, &every].map(|all| all[all.len() - 1]);
        assert_eq!((last.punctures, other.punctures), (4, 4));
        assert_eq!((last.tip, last.guessed, other.guessed), (other.tip, 0, 0));
        // Both break through in the same step, for the first time at least.
        let first = |all: &[NeedleReport]| all.iter().position(|needle| needle.punctures > 0);
        assert_eq!(first(&one), first(&every));
        // The mean of how far they are apart, by what rubs.
        let sum: f64 = one
            .iter()
            .zip(&every)
            .map(|(a, b)| (a.axial_n - b.axial_n).abs())
            .sum();
        apart.push(sum / one.len() as f64 / 0.08);
    }
    println!("apart by {apart:?} of what rubs");
    assert!(
        apart[1] < 0.6 * apart[0] && apart[2] < 0.6 * apart[1],
        "{apart:?}"
    );
    assert!(apart[2] < 0.02, "{apart:?}");
}
