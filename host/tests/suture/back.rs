//! Needles that are drawn back once their end has gone in: faces go from needle to thread and back again.

use super::rig::*;
use nalgebra::Vector3;
use sutura_host::needle::{Needle, NeedleSettings, NeedleTissue, TipPlace};

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
