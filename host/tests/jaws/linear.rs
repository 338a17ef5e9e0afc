//! On linear tissue: nothing moves when jaws take hold, what they lift, how that follows them, and from hand to hand.

use super::rig::{HELD, Rig, apart, at, jaws, moved, over, place, tangent_of, wrench_of};
use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector6};
use sutura_host::anchors::AnchorPoint;
use sutura_host::event::Event;
use sutura_host::jaws::Pads;

fn force(wrench: &[f64; 6]) -> Vector3<f64> {
    Vector6::from(*wrench).fixed_rows::<3>(0).into()
}

fn far(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let ways = a.iter().zip(b);
    ways.fold(0.0, |most, (a, b)| {
        most.max((Vector3::from(*a) - Vector3::from(*b)).norm())
    })
}

#[test]
fn nothing_moves_when_jaws_take_hold_and_let_go() {
    let mut rig = Rig::new(&[jaws(2.0)]);
    let rest = rig.positions();
    let report = rig.close(1, &[over()]);
    assert_eq!(
        (report.jaws()[0].pads, report.jaws()[0].points),
        (Pads::Closed, HELD)
    );
    let events: Vec<_> = report.events().collect();
    assert_eq!(
        events,
        [Event::Grasped {
            tool: 1,
            points: HELD
        }]
    );
    for _ in 0..3 {
        let report = rig.step(&[over()]);
        assert_eq!(report.contacts()[0].rows, 3 * HELD);
        let force_n = force(&report.contacts()[0].wrench).norm();
        assert!(force_n < 1e-12, "{force_n} N");
        assert!(far(&rig.positions(), &rest) < 1e-15);
    }
    // What was lifted falls back when they open, to the bit of what double precision has.
    let lifted = rig.step(&[moved(&over(), 2, 0.003)]);
    assert!(force(&lifted.contacts()[0].wrench).norm() > 0.1);
    rig.open(1);
    let report = rig.step(&[moved(&over(), 2, 0.003)]);
    assert_eq!(report.contacts()[0].rows, 0);
    assert!(force(&report.contacts()[0].wrench).norm() < 1e-12);
    assert!(far(&rig.positions(), &rest) < 1e-15);
}

/// Points that stick are held where the tool has them: force and moment are those of a dense solve.
#[test]
fn what_jaws_lift_pulls_as_a_dense_solve_has_it() {
    for clamp_n in [1e3, f64::INFINITY] {
        let mut rig = Rig::new(&[jaws(clamp_n)]);
        rig.close(1, &[over()]);
        let points: Vec<AnchorPoint> = rig
            .state
            .grasped(&rig.model, 1)
            .iter()
            .map(|p| p.at)
            .collect();
        assert_eq!(points.len(), HELD as usize);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.05, -0.1, 0.2));
        let lifted = Isometry3::from_parts(Vector3::new(0.003, 0.0005, 0.001).into(), turn);
        let report = rig.step(&[lifted]);
        let by = lifted * over().inverse();
        let held: Vec<_> = points
            .iter()
            .map(|point| (by * nalgebra::Point3::from(place(point, rig.mesh.points_m()))).coords)
            .collect();
        let expected = wrench_of(&rig.mesh, &points, &held, &lifted.translation.vector);
        let found = Vector6::from(report.contacts()[0].wrench);
        let off = (found - expected).norm() / expected.norm();
        assert!(expected.norm() > 0.3 && off < 1e-10, "{off} of {expected}");
        assert_eq!(report.jaws()[0].slipping, 0);
    }
}

#[test]
fn the_tangent_of_jaws_is_that_of_whole_steps() {
    let slip = |clamp_n: f64| {
        let mut rig = Rig::new(&[jaws(clamp_n)]);
        rig.close(1, &[over()]);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.05, 0.2));
        let lifted = Isometry3::from_parts(Vector3::new(0.004, 0.001, -0.002).into(), turn);
        // The last piece of the way: what slipped before it has slipped.
        let by = Isometry3::translation(-0.0004, 0.0002, -0.0005);
        rig.step(&[by * lifted]);
        let before = rig.state.clone();
        let report = rig.step(&[lifted]);
        rig.state = before;
        let slopes = rig.slopes(&lifted, 3e-7);
        (
            report.jaws()[0].slipping,
            apart(&tangent_of(&report), &slopes),
        )
    };
    let (slipping, error) = slip(1e3);
    assert!(slipping == 0 && error < 1e-6, "{error}");
    let mut some_slip = false;
    for clamp_n in [0.2, 0.8, 1.2, 1.6, 2.0] {
        let (slipping, error) = slip(clamp_n);
        println!("{clamp_n} N: {slipping} slip, {error}");
        assert!(error < 1e-6, "{slipping}: {error}");
        some_slip |= (1..HELD).contains(&slipping);
    }
    assert!(some_slip, "some slip, and some stick");
}

/// The other hand takes hold beside what the first one lifts: nothing changes. Then it takes over at the same place.
#[test]
fn the_force_is_continuous_from_hand_to_hand() {
    let mut rig = Rig::new(&[jaws(50.0); 2]);
    let lifted = moved(&over(), 2, 0.004);
    let beside = at(0.017, -0.002, -0.004);
    rig.close(1, &[over(), beside]);
    let before = rig.step(&[lifted, beside]);
    let before_n = force(&before.contacts()[0].wrench);
    let places = rig.positions();
    let report = rig.close(2, &[lifted, beside]);
    assert!(report.jaws()[1].points > 3);
    let report = rig.step(&[lifted, beside]);
    let [first, second] = [0, 1].map(|tool| force(&report.contacts()[tool].wrench));
    assert!(
        (first - before_n).norm() < 1e-9 * before_n.norm(),
        "{first} is not {before_n}"
    );
    assert!(second.norm() < 1e-9 * before_n.norm(), "{second}");
    assert!(far(&rig.positions(), &places) < 1e-12);
    rig.open(2);

    // Beside each other on nearly the same points they pull together as one did.
    rig.step(&[lifted, lifted]);
    rig.close(2, &[lifted, lifted]);
    let report = rig.step(&[lifted, lifted]);
    let both = report.contacts().iter().map(|c| force(&c.wrench));
    let both: Vector3<f64> = both.sum();
    assert!(
        (both - before_n).norm() < 1e-9 * before_n.norm(),
        "{both} is not {before_n}"
    );
}

/// What both hold by the same points passes from one to the other.
#[test]
fn the_second_hand_pulls_what_the_first_one_did() {
    let mut rig = Rig::new(&[jaws(50.0), jaws(50.0)]);
    let lifted = moved(&over(), 2, 0.004);
    rig.close(1, &[over(), over()]);
    let alone = rig.step(&[lifted, over()]);
    let alone_n = force(&alone.contacts()[0].wrench);
    rig.step(&[over(), over()]);
    rig.close(2, &[over(), over()]);
    let report = rig.step(&[lifted, lifted]);
    let forces = || report.contacts().iter().map(|c| force(&c.wrench));
    assert!(forces().all(|force| force.norm() > 0.1 * alone_n.norm()));
    let both: Vector3<f64> = forces().sum();
    let same = |found: &Vector3<f64>| (found - alone_n).norm() < 1e-9 * alone_n.norm();
    assert!(same(&both), "{both} is not {alone_n}");
    rig.open(1);
    let report = rig.step(&[lifted, lifted]);
    let [first, second] = [0, 1].map(|tool| force(&report.contacts()[tool].wrench));
    assert_eq!(first, Vector3::zeros());
    assert!(same(&second), "{second} is not {alone_n}");
}
