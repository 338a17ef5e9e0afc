//! Tips on a surface: they stick within friction's cone, and slip beyond it.

use super::bench::*;
use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::Material;
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::needle::{Needle, NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::step::{StepOptions, StepReport, step};

/// Hardly gives way: the surface stays flat.
const STIFF: Material = Material {
    youngs_modulus_pa: 1e6,
    poisson_ratio: 0.4,
};

/// A slab of 40 x 40 x 8 mm with its top at 0, turned about the origin, held at its bottom.
fn turned_slab(turn: &UnitQuaternion<f64>) -> (TetMesh, Vec<u32>) {
    let flat = slab([0.04, 0.04, 0.008], [9, 9, 3]).expect("a slab");
    let top = flat
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MIN, f64::max);
    let low = |p: &[f64; 3]| p[2] < top - 0.008 + 1e-9;
    let all = (0u32..).zip(flat.points_m());
    let fixed = all.filter(|(_, p)| low(p)).map(|(node, _)| node).collect();
    let points = flat.points_m().iter();
    let points = points.map(|p| (turn * Vector3::new(p[0], p[1], p[2] - top)).into());
    let mesh = TetMesh::new(points.collect(), flat.cells().to_vec()).expect("the same slab");
    (mesh, fixed)
}

fn rubbing(surface_friction: f64) -> NeedleTissue {
    NeedleTissue {
        surface_friction,
        puncture_pa: f64::INFINITY,
        ..tissue()
    }
}

fn turns() -> [UnitQuaternion<f64>; 2] {
    let aside = UnitQuaternion::from_euler_angles(0.7, -0.4, 1.1);
    [UnitQuaternion::identity(), aside]
}

/// A needle of 30 mm along `axis` with its tip at `tip_m`, over the turned slab.
fn over_slab(
    turn: &UnitQuaternion<f64>,
    (tip_m, axis): (Vector3<f64>, Vector3<f64>),
    material: Material,
    tissue: NeedleTissue,
) -> Bench {
    let mesh = turned_slab(turn);
    let by_cell = vec![tissue; mesh.0.cells().len()];
    let (tip_m, axis) = (turn * tip_m, turn * axis.normalize());
    let needle: Needle = straight(0.03);
    let aside = Vector3::ith(axis.iamin(), 1.0);
    let start = frame((tip_m - axis * 0.03).into(), axis.into(), aside.into());
    let settings = NeedleSettings::default();
    Bench::many(
        mesh,
        Kind::Linear,
        &[(needle, start)],
        material,
        &by_cell,
        settings,
    )
}

/// Force on the tissue \[N\], in the slab's frame.
fn force(report: &StepReport, turn: &UnitQuaternion<f64>) -> Vector3<f64> {
    let [x, y, z, ..] = report.contacts()[0].wrench;
    turn.inverse() * -Vector3::new(x, y, z)
}

fn shift(bench: &mut Bench, turn: &UnitQuaternion<f64>, by: Vector3<f64>) -> StepReport {
    bench.grip.translation.vector += turn * by;
    let (report, _) = bench.go();
    report
}

/// Pressed on so that a tip that sticks has its force at an angle to the normal, it sticks where `tan(angle) < mu`, and
/// slips with `mu` times the normal force against its way where it is more: in eight directions, and with all turned.
#[test]
fn it_slips_where_the_angle_to_the_normal_is_more_than_frictions() {
    for (turn, friction) in turns().into_iter().zip([0.3, 0.8]) {
        let down = (Vector3::new(0.0013, 0.0007, 1e-6), -Vector3::z());
        let mut bench = over_slab(&turn, down, STIFF, rubbing(friction));
        let touched = shift(&mut bench, &turn, Vector3::new(0.0, 0.0, -1.5e-6));
        assert_eq!(touched.needles()[0].tip, TipPlace::Holding);
        let (state, grip) = (bench.state.clone(), bench.grip);
        for direction in 0..8 {
            let azimuth = 0.3 + f64::from(direction) * std::f64::consts::FRAC_PI_4;
            for (off_deg, slips) in [(-2.0f64, false), (2.0, true)] {
                (bench.state, bench.grip) = (state.clone(), grip);
                // The way that gives a sticking tip 10 mN at the angle.
                let tangent = touched.contacts()[0].tangent;
                let into = turn.to_rotation_matrix();
                let stiffness = into.inverse().matrix()
                    * -Matrix3::from_fn(|i, j| tangent[i][j])
                    * into.matrix();
                let angle = friction.atan() + off_deg.to_radians();
                let aside = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
                let wanted = (aside * angle.sin() - Vector3::z() * angle.cos()) * 0.01;
                let way =
                    stiffness.try_inverse().expect("stiff") * (wanted - force(&touched, &turn));
                let report = shift(&mut bench, &turn, way);
                let found = force(&report, &turn);
                let needle = report.needles()[0];
                assert_eq!(needle.tip, TipPlace::Holding);
                let flat = found - Vector3::z() * found.z;
                let ratio = flat.norm() / -found.z;
                if slips {
                    assert!(
                        (ratio / friction - 1.0).abs() < 0.01,
                        "{ratio} of {friction}"
                    );
                    assert!(flat.normalize().dot(&aside) > 0.99, "{flat} for {aside}");
                    assert!(needle.dissipated_j[0] > 0.0);
                } else {
                    assert!((found - wanted).norm() < 1e-7, "{found} for {wanted}");
                    assert_eq!(needle.dissipated_j[0], 0.0);
                }
            }
        }
    }
}

/// Dragged over several faces, it rubs with `mu N`, against its way, in any direction.
#[test]
fn while_it_slides_the_force_is_friction_times_what_presses() {
    for (turn, friction) in turns().into_iter().zip([0.2, 0.6]) {
        for azimuth in [0.2f64, 1.9, 4.0] {
            let way = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
            let down = (
                Vector3::new(0.0013, 0.0007, 1e-6) - way * 0.006,
                -Vector3::z(),
            );
            let mut bench = over_slab(&turn, down, STIFF, rubbing(friction));
            shift(&mut bench, &turn, Vector3::new(0.0, 0.0, -1.1e-5));
            let mut slid = 0;
            for place in 0..120 {
                let report = shift(&mut bench, &turn, way * 1e-4);
                let found = force(&report, &turn);
                assert_eq!(report.needles()[0].tip, TipPlace::Holding);
                let flat = found - Vector3::z() * found.z;
                let ratio = flat.norm() / -found.z;
                if place > 5 {
                    assert!((ratio / friction - 1.0).abs() < 0.01, "{place}: {ratio}");
                    assert!(flat.normalize().dot(&way) > 0.99, "{place}: {flat}");
                    slid += 1;
                }
            }
            assert!(slid > 100);
        }
    }
}

/// What touches a soft surface at 10 degrees is not to take the surface along: it slides on, and what it drags is what
/// friction can hold.
#[test]
fn a_flat_needle_slides_over_the_surface() {
    let angle = 10f64.to_radians();
    let axis = Vector3::new(angle.cos(), 0.0, -angle.sin());
    let at = (Vector3::new(-0.012, 0.0007, 1e-4), axis);
    for (friction, most_m, most_n) in [(0.2, 3e-3, 0.8), (f64::INFINITY, 0.02, 10.0)] {
        let turn = UnitQuaternion::identity();
        let mut bench = over_slab(&turn, at, MATERIAL, rubbing(friction));
        let mut last = None;
        for _ in 0..120 {
            last = Some(shift(&mut bench, &turn, axis * 1e-4));
        }
        let report = last.expect("steps");
        let (dragged_m, found) = (bench.largest_displacement_m(), force(&report, &turn));
        println!(
            "mu {friction}: {:.2} mm, {:.3} N",
            1e3 * dragged_m,
            found.norm()
        );
        assert!(dragged_m < most_m, "{dragged_m} m");
        assert!(found.norm() < most_n, "{found} N");
        if friction.is_infinite() {
            assert!(
                dragged_m > 0.01 && found.norm() > 0.9,
                "it sticks: {dragged_m} m"
            );
        } else {
            assert!(found.x < 0.5 * -found.z, "it drags: {found}");
        }
    }
}

/// It presses and never pulls, and lets go once it is lifted.
#[test]
fn it_lets_go_where_nothing_presses() {
    let turn = turns()[1];
    let at = (
        Vector3::new(0.0013, 0.0007, 1e-4),
        Vector3::new(0.6, 0.0, -0.8),
    );
    let mut bench = over_slab(&turn, at, MATERIAL, rubbing(0.3));
    for _ in 0..20 {
        shift(&mut bench, &turn, Vector3::new(1e-4, 0.0, -1e-4));
    }
    let mut pressed = true;
    for _ in 0..40 {
        let report = shift(&mut bench, &turn, Vector3::new(0.0, 3e-5, 1e-4));
        let found = force(&report, &turn);
        assert!(found.z <= 1e-12, "{found} pulls");
        pressed = report.needles()[0].tip == TipPlace::Holding;
        assert!(pressed || found == Vector3::zeros());
    }
    assert!(!pressed);
}

/// The load across the surface breaks through it, at any angle at which the tip sticks.
#[test]
fn it_punctures_at_the_normal_load() {
    for lean_deg in [0.0f64, 20.0, 35.0] {
        let (turn, lean) = (turns()[1], lean_deg.to_radians());
        let axis = Vector3::new(lean.sin(), 0.0, -lean.cos());
        let at = (Vector3::new(0.0013, 0.0007, 1e-5), axis);
        let area = straight(0.03).tip_area_m2();
        let tissue = NeedleTissue {
            puncture_pa: 0.2 / area,
            ..rubbing(2.0)
        };
        let mut bench = over_slab(&turn, at, STIFF, tissue);
        let mut before = 0.0;
        for place in 0.. {
            assert!(place < 5000, "never at {lean_deg} degrees");
            let report = shift(&mut bench, &turn, axis * 2e-7);
            if report.needles()[0].punctures > 0 {
                break;
            }
            before = -force(&report, &turn).z;
        }
        assert!(
            (0.195..0.201).contains(&before),
            "{before} N at {lean_deg} degrees"
        );
    }
}

fn moved(grip: &Isometry3<f64>, by: &Vector6<f64>) -> Isometry3<f64> {
    let part = |first| Vector3::new(by[first], by[first + 1], by[first + 2]);
    let rotation = UnitQuaternion::from_scaled_axis(part(3)) * grip.rotation;
    Isometry3::from_parts(
        Translation3::from(grip.translation.vector + part(0)),
        rotation,
    )
}

/// The tangent of a tip that slides, against whole steps to poses nearby from the same state.
#[test]
fn the_tangent_is_that_of_the_sliding_tip() {
    let turn = turns()[1];
    let at = (
        Vector3::new(0.0013, 0.0007, 1e-4),
        Vector3::new(0.3, 0.1, -1.0),
    );
    let mut bench = over_slab(&turn, at, MATERIAL, rubbing(0.3));
    for _ in 0..12 {
        shift(&mut bench, &turn, Vector3::new(1e-4, 0.0, -4e-5));
    }
    let before = bench.state.clone();
    let to = moved(
        &bench.grip,
        &Vector6::new(2e-5, 3e-5, -1e-5, 1e-3, -2e-3, 1e-3),
    );
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
    let report = at(&mut bench, to);
    assert!(report.needles()[0].dissipated_j[0] > 0.0);
    let tangent = report.contacts()[0].tangent;
    let tangent = Matrix6::from_fn(|i, j| tangent[i][j]);
    let found = Matrix6::from_columns(&[0, 1, 2, 3, 4, 5].map(|axis| {
        let size = if axis < 3 { 2e-8 } else { 1e-6 };
        let [ahead, behind] = [1.0, -1.0].map(|sign| {
            let there = at(&mut bench, moved(&to, &Vector6::ith(axis, sign * size)));
            Vector6::from(there.contacts()[0].wrench)
        });
        (ahead - behind) / (2.0 * size)
    }));
    for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
        let own = tangent.fixed_view::<3, 3>(i, j);
        let there = found.fixed_view::<3, 3>(i, j);
        let worst = (own - there).amax() / there.amax();
        assert!(worst < 1e-6, "block {i} {j}: {worst:e}, {own} for {there}");
    }
}

/// The hand's work goes into the tissue and friction; what is missing falls with the step.
#[test]
fn the_hands_work_is_stored_and_rubbed_away() {
    let turn = UnitQuaternion::identity();
    let missing = [4e-5f64, 1e-5].map(|step_m| {
        let at = (Vector3::new(-0.008, 0.0007, 1e-6), -Vector3::z());
        let mut bench = over_slab(&turn, at, MATERIAL, rubbing(0.4));
        let (mut work, mut before, mut most) = (0.0, Vector3::zeros(), 0.0f64);
        let (mut balance, mut rubbed) = (0.0, 0.0);
        let down = (1e-3 / step_m).round() as usize;
        let aside = (8e-3 / step_m).round() as usize;
        for place in 0..down + aside {
            let way = if place < down {
                -Vector3::z()
            } else {
                Vector3::x()
            } * step_m;
            let report = shift(&mut bench, &turn, way);
            let now = force(&report, &turn);
            work += 0.5 * (before + now).dot(&way);
            before = now;
            rubbed = report.needles()[0].dissipated_j[0];
            most = most.max(report.stored_energy_j);
            balance = work
                - report.stored_energy_j
                - report.needles()[0].dissipated_j.iter().sum::<f64>();
        }
        println!(
            "{step_m} m: {:.2e} J of {most:.2e} J missing, {rubbed:.2e} J rubbed",
            balance
        );
        assert!(rubbed > 0.5 * most, "it slid");
        balance.abs() / most
    });
    assert!(
        missing[1] < 0.02 && missing[1] < 0.5 * missing[0] + 1e-3,
        "{missing:?}"
    );
}
