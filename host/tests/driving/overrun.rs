//! Tissue that comes to a needle's tip, instead of the tip to it.

use super::bench::*;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::model::Passes;
use sutura_host::needle::{NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::step::StepReport;

/// Most steps in the tissue's direction that these tests take \[m\].
const STEPS_M: [f64; 4] = [2e-6, 5e-5, 3e-4, 1e-3];
/// Of the needles \[m\].
const LENGTHS_M: [f64; 2] = [0.04, 0.02];
/// Where the second needle points at the surface \[m\]: beside the mesh's own lines.
const AT: [f64; 2] = [0.0011, 0.0007];

/// A needle through a slab, 5 mm below its top, in the hands of tool 0, and one that points down at the top from `above_m`, in those of
/// tool 1; all turned.
fn lifted(kind: Kind, place: &Isometry3<f64>, above_m: f64) -> Bench {
    let mesh = slab([0.03, 0.03, 0.02], [7, 7, 5]).expect("a slab");
    let nodes = (0u32..).zip(mesh.points_m());
    let sides = nodes.filter(|(_, at)| at[0].abs() > 0.0149);
    let held = sides.map(|(node, _)| node).collect();
    let moved = |at: &[f64; 3]| (place * Point3::from(*at)).coords.into();
    let points = mesh.points_m().iter().map(moved).collect();
    let mesh = TetMesh::new(points, mesh.cells().to_vec()).expect("the same slab");
    let [x, y] = AT;
    let through = frame([0.0003, -0.056, -0.005], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]);
    let down = frame([x, y, 0.05], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let needles = [
        (straight(LENGTHS_M[0]), place * through),
        (straight(LENGTHS_M[1]), place * down),
    ];
    let tissue = NeedleTissue {
        friction_n_per_m: 50.0,
        puncture_pa: 2e6,
        ..tissue()
    };
    let by_cell = vec![tissue; mesh.cells().len()];
    let loaded = (MATERIAL, Loads::default());
    let settings = NeedleSettings::default();
    let mut bench = Bench::built(
        (mesh, held),
        kind,
        (&needles, false),
        loaded,
        &by_cell,
        settings,
    );
    bench.work.prepare(&bench.model, |_| true);
    for (needle, tool) in [(0, 0), (1, 1)] {
        bench.grip = needles[0].1;
        bench.other = needles[1].1;
        assert!(bench.hold(needle, Some(tool)));
    }
    by(
        &mut bench,
        place,
        [Vector3::y() * 0.04, Vector3::zeros()],
        5e-4,
    );
    // Its tip is 20 mm from its end.
    let tip = 0.05 - 0.02;
    by(
        &mut bench,
        place,
        [Vector3::zeros(), Vector3::z() * (above_m - tip)],
        5e-4,
    );
    bench
}

/// Moves both tools in steps of at most `step_m`; what is looked at after each.
fn by(
    bench: &mut Bench,
    place: &Isometry3<f64>,
    ways: [Vector3<f64>; 2],
    step_m: f64,
) -> StepReport {
    let far_m = ways[0].norm().max(ways[1].norm());
    let steps = (far_m / step_m).ceil() as usize;
    let mut report = StepReport::default();
    for _ in 0..steps {
        bench.grip.translation.vector += place * ways[0] / steps as f64;
        bench.other.translation.vector += place * ways[1] / steps as f64;
        report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        is_as_it_says(bench, &report);
    }
    report
}

/// A tip that is said to be outside is in no cell.
fn is_as_it_says(bench: &Bench, report: &StepReport) {
    let at = bench.state.positions(&bench.model);
    let corner = |node: u32| Vector3::from(at[node as usize]);
    for (needle, length_m) in report.needles().iter().zip(LENGTHS_M) {
        let pose = bench.state.needle_pose(&bench.model, needle.id);
        let tip = straight(length_m).at(&pose.expect("a needle")).at(length_m);
        let is_in = |cell: &[u32; 4]| {
            let [a, b, c, d] = cell.map(corner);
            let all = Matrix3::from_columns(&[b - a, c - a, d - a]);
            let parts = all.try_inverse().expect("a cell") * (tip - a);
            // As far as the balance is known.
            parts.min() > 1e-6 && parts.sum() < 1.0 - 1e-6
        };
        let is_in = bench.mesh.cells().iter().any(is_in);
        assert!(
            !is_in || needle.tip != TipPlace::Outside,
            "{needle:?} {tip}"
        );
    }
}

/// Lifted by the one needle, tissue comes to the tip of another one that does not move, which holds it and then goes in; lowered again it comes
/// off that.
#[test]
fn tissue_that_is_lifted_to_a_tip_meets_it() {
    let places = [
        Isometry3::identity(),
        Isometry3::new(
            Vector3::new(0.02, -0.01, 0.03),
            Vector3::new(0.7, -1.1, 0.4),
        ),
    ];
    let kinds = [|| Kind::Linear, || Kind::Corotational(Passes::default())];
    for kind in kinds {
        for place in &places {
            for step_m in STEPS_M {
                let mut bench = lifted(kind(), place, 3e-4);
                let up = Vector3::z() * 3.5e-3;
                let still = Vector3::zeros();
                // The finest steps only near the surface.
                let fine = step_m < 1e-5;
                let parts = if fine { [2.5e-4, 4e-4] } else { [0.0, 0.0] };
                by(&mut bench, place, [Vector3::z() * parts[0], still], 5e-5);
                by(&mut bench, place, [Vector3::z() * parts[1], still], step_m);
                let left = up - Vector3::z() * (parts[0] + parts[1]);
                let mut report = by(
                    &mut bench,
                    place,
                    [left, still],
                    if fine { 5e-5 } else { step_m },
                );
                let [_, other] = report.needles() else {
                    panic!("{report:?}")
                };
                assert_ne!(other.tip, TipPlace::Outside, "{step_m} {other:?}");
                // It is pushed away, upwards, until it is through.
                let force = Vector3::from_column_slice(&report.contacts()[1].wrench[..3]);
                let pushed = (place.inverse() * force).z;
                let holds = other.tip == TipPlace::Holding && pushed > 1e-3;
                assert!(holds || other.punctures == 1, "{step_m} {pushed} {other:?}");
                report = by(&mut bench, place, [-up * 1.5, still], 5e-4);
                assert_eq!(report.needles()[1].tip, TipPlace::Outside, "{step_m}");
                assert_eq!(report.needles()[1].crossings, 0);
            }
        }
    }
}
