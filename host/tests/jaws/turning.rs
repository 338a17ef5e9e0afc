//! On tissue that turns with its cells.

use super::rig::{HELD, Rig, SOFT, apart, bottom, jaws, over, place, tangent_of};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3, Vector6};
use sutura_host::anchors::AnchorPoint;
use sutura_host::fem::{Anchor, CorotationalTissue, Handle, Loads, Policy};

/// In pieces, as a hand would.
fn twist(rig: &mut Rig, degrees: f64) -> Isometry3<f64> {
    let mut pose = over();
    for k in 1..=10 {
        let turn = (degrees * f64::from(k) / 10.0).to_radians();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * turn);
        pose = Isometry3::from_parts(over().translation, turn);
        rig.step(&[pose]);
    }
    pose
}

/// A twist by 30 degrees against tissue whose same points are moved there without any jaws.
#[test]
fn a_twist_by_30_degrees_is_that_of_a_solve_with_finite_rotations() {
    let mut rig = Rig::turning(&[jaws(1e3)]);
    rig.close(1, &[over()]);
    let points: Vec<AnchorPoint> = rig
        .state
        .grasped(&rig.model, 1)
        .iter()
        .map(|p| p.at)
        .collect();
    let pose = twist(&mut rig, 30.0);
    let report = rig.step(&[pose]);
    let by = pose * over().inverse();
    let way = |point: &AnchorPoint, part: f64| {
        let at = place(point, rig.mesh.points_m());
        let turn = UnitQuaternion::identity().slerp(&by.rotation, part);
        let there = over().translation.vector + turn * (at - over().translation.vector);
        there - at
    };
    let fixed = bottom(&rig.mesh);
    let tissue =
        CorotationalTissue::new(&rig.mesh, SOFT, &fixed, Policy::default()).expect("tissue");
    let mut state = tissue.state();
    let mut forces = Vec::new();
    for k in 1..=6 {
        let part = f64::from(k) / 6.0;
        let handles = points.iter().map(|point| {
            let used: Vec<_> = (0..4).filter(|k| point.weights[*k] != 0.0).collect();
            Handle {
                anchor: Anchor {
                    vertices: used.iter().map(|k| point.nodes[*k]).collect(),
                    weights: used.iter().map(|k| point.weights[*k]).collect(),
                },
                target_displacement_m: way(point, part).into(),
            }
        });
        let loads = Loads {
            handles: handles.collect(),
            ..Loads::default()
        };
        let found = tissue.settle(&mut state, &loads).expect("a balance");
        forces = found.handle_force_n;
    }
    let mut expected = Vector6::zeros();
    for (point, force) in points.iter().zip(&forces) {
        let at = by * Point3::from(place(point, rig.mesh.points_m()));
        let (force, arm) = (-Vector3::from(*force), at.coords - pose.translation.vector);
        let moment = arm.cross(&force);
        expected += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
    }
    let found = Vector6::from(report.contacts()[0].wrench);
    let (moment, exact) = (found[5], expected[5]);
    println!("{moment} {exact} N m; {found} {expected}");
    assert!(exact.abs() > 1e-3 && (moment / exact - 1.0).abs() < 0.01);
    // Far better than the bar: both are in balance.
    assert!((found - expected).norm() < 1e-4 * expected.norm());
}

#[test]
fn the_tangent_on_tissue_that_turns_is_that_of_whole_steps() {
    for (clamp_n, degrees, slips) in [(1e3, 12.0, false), (1.2, 3.0, true)] {
        let mut rig = Rig::turning(&[jaws(clamp_n)]);
        rig.close(1, &[over()]);
        let pose = twist(&mut rig, degrees);
        let by = |x: f64, z: f64| Isometry3::translation(x, 0.0, z) * pose;
        rig.step(&[by(0.0004, 0.0012)]);
        rig.step(&[by(0.0008, 0.0024)]);
        // One piece of the way: what slipped before it has slipped.
        let lifted = by(0.0012, 0.0034);
        let before = rig.state.clone();
        let report = rig.step(&[lifted]);
        rig.state = before;
        let slopes = rig.slopes(&lifted, 1e-6);
        let error = apart(&tangent_of(&report), &slopes);
        let jaws = report.jaws()[0];
        println!(
            "{} of {} slip: {error}, said {}",
            jaws.slipping, jaws.points, report.tangent_error
        );
        assert_eq!(jaws.slipping > 0, slips);
        assert!(error < 1e-5, "{error}");
    }
}

#[test]
fn nothing_moves_when_jaws_take_hold_of_tissue_that_turns() {
    let mut rig = Rig::turning(&[jaws(5.0)]);
    rig.close(1, &[over()]);
    let report = rig.step(&[over()]);
    let force = Vector6::from(report.contacts()[0].wrench).norm();
    assert!(report.jaws()[0].points == HELD && force < 1e-12, "{force}");
}
