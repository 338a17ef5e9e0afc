//! Shafts outside of the tissue against its surface.

use super::bench::*;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::{Loads, Material};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::needle::{Needle, NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::step::{Status, StepOptions, StepReport, step};

/// A slab of 30 x 20 x 8 mm with its top at 0, held at its bottom.
pub fn a_slab() -> (TetMesh, Vec<u32>) {
    let flat = slab([0.03, 0.02, 0.008], [9, 6, 3]).expect("a slab");
    let top = flat
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MIN, f64::max);
    let low = |p: &[f64; 3]| p[2] < top - 0.008 + 1e-9;
    let all = (0u32..).zip(flat.points_m());
    let fixed = all.filter(|(_, p)| low(p)).map(|(node, _)| node).collect();
    let points = flat.points_m().iter();
    let points = points.map(|p| [p[0], p[1], p[2] - top]);
    let mesh = TetMesh::new(points.collect(), flat.cells().to_vec()).expect("the same slab");
    (mesh, fixed)
}

pub fn rubbing(surface_friction: f64) -> NeedleTissue {
    NeedleTissue {
        surface_friction,
        ..tissue()
    }
}

pub fn build(
    mesh: (TetMesh, Vec<u32>),
    kind: Kind,
    (needle, start): (Needle, Isometry3<f64>),
    youngs_modulus_pa: f64,
    tissue: NeedleTissue,
) -> Bench {
    let by_cell = vec![tissue; mesh.0.cells().len()];
    let material = Material {
        youngs_modulus_pa,
        ..MATERIAL
    };
    let needles = [(needle, start)];
    let settings = NeedleSettings::default();
    let loaded = (material, Loads::default());
    Bench::built(mesh, kind, (&needles, true), loaded, &by_cell, settings)
}

/// A straight needle of 50 mm whose shaft lies over the slab's top, almost across it, `height_m` above.
fn across(height_m: f64) -> (Needle, Isometry3<f64>) {
    let start = frame(
        [0.0013, -0.018, THICKNESS_M * 0.5 + height_m],
        [0.05, 1.0, 0.0004],
        [0.0, 0.0, 1.0],
    );
    (straight(0.05), start)
}

pub fn shift(bench: &mut Bench, by: [f64; 3]) -> StepReport {
    bench.grip.translation.vector += Vector3::from(by);
    let report = bench.step();
    assert_eq!(report.status, Status::Ok);
    bench.look(&report);
    report
}

/// Force on the tissue \[N\].
pub fn force(report: &StepReport) -> Vector3<f64> {
    let [x, y, z, ..] = report.contacts()[0].wrench;
    -Vector3::new(x, y, z)
}

/// How far the tissue, solved for as a whole, reaches into the shaft between its end and `to_m` \[m\].
pub fn overlap_m(bench: &Bench, needle: &Needle, from_m: f64, to_m: f64) -> f64 {
    let nodes = bench.state.positions(&bench.model);
    let curve = needle.at(&bench.grip);
    let places =
        (0..=2000).map(|place| curve.at(from_m + (to_m - from_m) * f64::from(place) / 2000.0));
    overlap_of(&bench.mesh, &nodes, places, 0.5 * needle.thickness_m)
}

/// How far tissue with nodes at `nodes` reaches into balls of this radius at `places` \[m\].
pub fn overlap_of(
    mesh: &TetMesh,
    nodes: &[[f64; 3]],
    places: impl Iterator<Item = Vector3<f64>>,
    radius_m: f64,
) -> f64 {
    let at = |node: u32| Vector3::from(nodes[node as usize]);
    let boundary = mesh.half_faces().boundary();
    let mut deepest = f64::MIN;
    for on in places {
        for corners in boundary.triangles() {
            let [a, b, c] = corners.map(at);
            // Within reach at all?
            let near = |p: &Vector3<f64>| (p - on).norm() < 0.006 + radius_m;
            if !(near(&a) || near(&b) || near(&c)) {
                continue;
            }
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let side = q - p;
                let part = ((on - p).dot(&side) / side.norm_squared()).clamp(0.0, 1.0);
                let apart = (p + side * part - on).norm();
                deepest = deepest.max(radius_m - apart);
            }
            let normal = (b - a).cross(&(c - a)).normalize();
            let foot = on - normal * normal.dot(&(on - a));
            let sides = [(a, b), (b, c), (c, a)];
            let inside = |(p, q): (Vector3<f64>, Vector3<f64>)| {
                (q - p).cross(&(foot - p)).dot(&normal) >= 0.0
            };
            if sides.into_iter().all(inside) {
                let height = normal.dot(&(on - a));
                if height > -0.002 {
                    deepest = deepest.max(radius_m - height);
                }
            }
        }
    }
    deepest
}

/// Pressed down and swept aside, a shaft pushes, and the tissue keeps out of it; without a body it would be nowhere.
#[test]
fn a_shaft_pushes_what_it_is_swept_against() {
    let (needle, start) = across(1e-4);
    let mut bench = build(a_slab(), Kind::Linear, (needle, start), 20e3, rubbing(0.3));
    let edge_m = bench.mesh.surface().mean_edge_m;
    let mut last = shift(&mut bench, [0.0; 3]);
    assert_eq!(force(&last), Vector3::zeros());
    let (mut pressed, mut aside) = (Vector3::zeros(), 0.0f64);
    for place in 0..24 {
        let before = force(&last).norm();
        let by = if place < 10 {
            [0.0, 0.0, -1e-4]
        } else {
            [1e-4, 0.0, 0.0]
        };
        last = shift(&mut bench, by);
        let now = force(&last);
        if place < 2 {
            continue;
        }
        if place < 10 {
            assert!(now.norm() > before && now.z < 0.0, "{place}: {now}");
            pressed = now;
        } else {
            aside = aside.max(now.x - pressed.x);
        }
        assert!(last.needles()[0].touches > 0);
        let front_m = needle.shape.length_m() - edge_m.max(2.0 * THICKNESS_M);
        let overlap = overlap_m(&bench, &needle, 0.0, front_m);
        println!(
            "{place}: {:.1} mN, {} touches, overlap {:.1e} edges, {} solves, {} pieces",
            1e3 * now.norm(),
            last.needles()[0].touches,
            overlap / edge_m,
            last.solves,
            last.substeps
        );
        assert!(overlap <= 1e-3 * edge_m, "{place}: {overlap} m");
    }
    assert!(aside > 0.02, "it drags {aside} N along");
    // Away again nothing is left.
    for _ in 0..20 {
        last = shift(&mut bench, [0.0, 0.0, 2e-4]);
        assert!(force(&last).z <= 1e-12, "it pulls");
    }
    assert_eq!(
        (force(&last), last.needles()[0].touches),
        (Vector3::zeros(), 0)
    );
}

/// Drawn along itself it rubs with friction times what presses.
#[test]
fn a_shaft_rubs() {
    for friction in [0.0, 0.2, 0.6] {
        let (needle, start) = across(1e-5);
        let mut bench = build(
            a_slab(),
            Kind::Linear,
            (needle, start),
            1e6,
            rubbing(friction),
        );
        shift(&mut bench, [0.0, 0.0, -1e-4]);
        let along = start.rotation * Vector3::x();
        for place in 0..40 {
            let report = shift(&mut bench, (along * 5e-5).into());
            if place < 10 {
                continue;
            }
            let found = force(&report);
            let axial = found.dot(&along);
            let ratio = axial / (found - along * axial).norm();
            assert!(
                (ratio - friction).abs() < 0.01 * friction + 1e-3,
                "{place}: {ratio} of {friction}"
            );
        }
    }
}

pub fn moved(grip: &Isometry3<f64>, by: &Vector6<f64>) -> Isometry3<f64> {
    let part = |first| Vector3::new(by[first], by[first + 1], by[first + 2]);
    let rotation = UnitQuaternion::from_scaled_axis(part(3)) * grip.rotation;
    Isometry3::from_parts(
        Translation3::from(grip.translation.vector + part(0)),
        rotation,
    )
}

/// Largest difference of the tangent of a step to `to` from whole steps to its neighbours, over the largest entry of its kind; and
/// the step's solves.
pub fn tangent_off(bench: &mut Bench, to: Isometry3<f64>) -> (f64, u32) {
    let before = bench.state.clone();
    let at = |bench: &mut Bench, grip: Isometry3<f64>| {
        let mut state = before.clone();
        bench.grip = grip;
        let sample = bench.sample();
        let options = StepOptions::default();
        step(
            &bench.model,
            &mut state,
            &[sample],
            &options,
            &mut bench.work,
        )
    };
    let report = at(bench, to);
    assert_eq!((report.status, report.substeps), (Status::Ok, 1));
    assert!(report.needles()[0].touches > 0);
    let tangent = report.contacts()[0].tangent;
    let tangent = Matrix6::from_fn(|i, j| tangent[i][j]);
    let found = Matrix6::from_columns(&[0, 1, 2, 3, 4, 5].map(|axis| {
        let size = if axis < 3 { 2e-8 } else { 1e-6 };
        let [ahead, behind] = [1.0, -1.0].map(|sign| {
            let there = at(bench, moved(&to, &Vector6::ith(axis, sign * size)));
            Vector6::from(there.contacts()[0].wrench)
        });
        (ahead - behind) / (2.0 * size)
    }));
    let mut worst = 0.0f64;
    for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
        let own = tangent.fixed_view::<3, 3>(i, j);
        let there = found.fixed_view::<3, 3>(i, j);
        worst = worst.max((own - there).amax() / there.amax());
    }
    (worst, report.solves)
}

#[test]
fn the_tangent_is_the_derivative() {
    for friction in [0.0, 0.4] {
        let part = across(1e-4);
        let mut bench = build(a_slab(), Kind::Linear, part, 20e3, rubbing(friction));
        for place in 0..14 {
            let by = if place < 10 {
                [0.0, 0.0, -1e-4]
            } else {
                [1e-4, 0.0, 0.0]
            };
            shift(&mut bench, by);
        }
        let by = Vector6::new(3e-5, -2e-5, -2e-5, 1e-3, 5e-4, 1e-3);
        let to = moved(&bench.grip, &by);
        let (worst, _) = tangent_off(&mut bench, to);
        println!("mu {friction}: {worst:.1e}");
        assert!(worst < 1e-6, "mu {friction}: off by {worst:e}");
    }
}

/// Part of the largest energy that the hand's work, pressing, sweeping and lifting in steps of so much \[m\], leaves unexplained.
pub fn missing_of_work(bench: &mut Bench, step_m: f64) -> f64 {
    let (mut work, mut before, mut most, mut off) = (0.0, Vector3::zeros(), 0.0f64, 0.0);
    let legs = [
        ([0.0, 0.0, -1.0], 8e-4),
        ([1.0, 0.2, 0.0], 3e-3),
        ([0.0, 0.0, 1.0], 1e-3),
    ];
    for (way, far_m) in legs {
        for _ in 0..(far_m / step_m).round() as usize {
            let way = Vector3::from(way) * step_m;
            let report = shift(bench, way.into());
            let now = force(&report);
            work += 0.5 * (before + now).dot(&way);
            before = now;
            most = most.max(report.stored_energy_j);
            let spent: f64 = report.needles()[0].dissipated_j.iter().sum();
            off = work - report.stored_energy_j - spent;
        }
    }
    println!("{step_m} m: {off:.2e} J of {most:.2e} J missing");
    off.abs() / most
}

/// The hand's work goes into the tissue and friction; what is missing falls with the step.
#[test]
fn the_hands_work_is_stored_and_rubbed_away() {
    let missing = [5e-5f64, 1.25e-5].map(|step_m| {
        let part = across(1e-6);
        let mut bench = build(a_slab(), Kind::Linear, part, 20e3, rubbing(0.3));
        missing_of_work(&mut bench, step_m)
    });
    assert!(
        missing[1] < 0.02 && missing[1] < 0.6 * missing[0] + 1e-3,
        "{missing:?}"
    );
}

/// A needle in its hole that is laid down on the surface, soft and stiff, smooth and rough: every step has a balance, numbers
/// stay finite, and the shaft bears some of it.
#[test]
fn a_needle_in_a_hole_leans_on_the_surface() {
    for youngs_modulus_pa in [5e2, 2e4, 1e6] {
        for friction in [0.0, 0.5] {
            let start = frame([0.0013, 0.0007, 0.0301], [0.0, 0.02, -1.0], [1.0, 0.0, 0.0]);
            let area = straight(0.03).tip_area_m2();
            let soft = NeedleTissue {
                puncture_pa: 2e-6 * youngs_modulus_pa / area,
                cutting_pa: 0.0,
                friction_n_per_m: 1e-4 * youngs_modulus_pa,
                static_friction_n_per_m: 1e-4 * youngs_modulus_pa,
                ..rubbing(friction)
            };
            let part = (straight(0.03), start);
            let mut bench = build(a_slab(), Kind::Linear, part, youngs_modulus_pa, soft);
            let mut last = shift(&mut bench, [0.0; 3]);
            for _ in 0..40 {
                last = shift(&mut bench, [0.0, 0.0, -1e-4]);
            }
            assert_eq!(last.needles()[0].tip, TipPlace::Inside);
            // Down about the hole.
            let hole = Vector3::new(0.0013, 0.0007, 0.0);
            let mut touched = 0;
            for _ in 0..185 {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * -0.01);
                bench.grip = Isometry3::from_parts(
                    Translation3::from(hole + turn * (bench.grip.translation.vector - hole)),
                    turn * bench.grip.rotation,
                );
                last = bench.step();
                bench.look(&last);
                assert_eq!(
                    last.status,
                    Status::Ok,
                    "{youngs_modulus_pa} Pa, mu {friction}"
                );
                touched = touched.max(last.needles()[0].touches);
            }
            println!(
                "{youngs_modulus_pa} Pa, mu {friction}: {touched} touches, {:?}",
                force(&last)
            );
            assert!(touched > 0);
        }
    }
}

/// Swept sideways into the slab from beside it, a shaft pushes it along; without a body nothing holds it.
#[test]
fn swept_into_a_side_it_pushes() {
    let start = frame(
        [-0.0162, -0.018, -0.0031],
        [0.02, 1.0, 0.01],
        [0.0, 0.0, 1.0],
    );
    let needle = straight(0.05);
    for body in [true, false] {
        let mesh = a_slab();
        let by_cell = vec![rubbing(0.3); mesh.0.cells().len()];
        let loaded = (MATERIAL, Loads::default());
        let needles = [(needle, start)];
        let settings = NeedleSettings::default();
        let mut bench = Bench::built(
            mesh,
            Kind::Linear,
            (&needles, body),
            loaded,
            &by_cell,
            settings,
        );
        let edge_m = bench.mesh.surface().mean_edge_m;
        let mut before = 0.0;
        for place in 0..20 {
            let report = shift(&mut bench, [1e-4, 0.0, 0.0]);
            let now = force(&report);
            if !body {
                assert_eq!(now, Vector3::zeros());
                continue;
            }
            assert!(place < 8 || now.x > before, "{place}: {now}");
            before = now.x;
            let overlap = overlap_m(&bench, &needle, 0.0, 0.046 - 1e-4);
            assert!(overlap <= 1e-3 * edge_m, "{place}: {overlap} m");
        }
        println!("{before} N");
        assert!(!body || before > 0.05, "{before} N");
    }
}
