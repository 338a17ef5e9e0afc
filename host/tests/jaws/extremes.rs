//! Jaws where they are not meant to be: none fails, and forces stay finite.

use super::rig::{HELD, Rig, SOFT, at, jaws, moved, over};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use sutura_host::event::{Event, Loss};
use sutura_host::fem::Loads;
use sutura_host::jaws::{Jaws, Pads};
use sutura_host::mesh::slab;
use sutura_host::model::{Model, ModelError};
use sutura_host::step::{State, Workspace};
use sutura_host::tool::{Act, Shape, Tool};

/// Takes hold, then lifts and turns; the largest force \[N\] and the points held.
fn worked(rig: &mut Rig, pose: &Isometry3<f64>) -> (f64, u32) {
    let points = rig.close(1, &[*pose]).jaws()[0].points;
    let mut most_n = 0.0f64;
    for k in 1..=20 {
        let part = f64::from(k) / 20.0;
        let mut there = *pose;
        there.translation.vector += Vector3::new(0.001, -0.0005, 0.002) * part;
        there.rotation =
            UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, -0.3) * part) * there.rotation;
        let report = rig.step(&[there]);
        let contact = report.contacts()[0];
        let all = contact
            .wrench
            .iter()
            .chain(contact.tangent.iter().flatten());
        assert!(all.clone().all(|x| x.is_finite()));
        let [x, y, z, ..] = contact.wrench;
        most_n = most_n.max(Vector3::new(x, y, z).norm());
    }
    // And back to rest without them.
    rig.open(1);
    let report = rig.step(&[*pose]);
    assert_eq!(report.contacts()[0].rows, 0);
    let off = rig.positions().into_iter().zip(rig.mesh.points_m());
    for (found, rest) in off {
        assert!((Vector3::from(found) - Vector3::from(*rest)).norm() < 1e-12);
    }
    (most_n, points)
}

#[test]
fn an_edge_and_a_corner_are_held() {
    for (x, y) in [(0.03, 0.0), (0.0, 0.02), (0.03, 0.02), (-0.03, -0.02)] {
        let mut rig = Rig::new(&[jaws(2.0)]);
        let (most_n, points) = worked(&mut rig, &at(x, y, -0.004));
        assert!(
            points >= 3 && most_n > 0.01 && most_n < 5.0,
            "{x} {y}: {points}, {most_n} N"
        );
    }
}

/// Pads much smaller than a face hold that by its corners.
#[test]
fn a_single_face_is_held() {
    let small = Jaws {
        length_m: 0.002,
        width_m: 0.0005,
        ..jaws(2.0)
    };
    let mut rig = Rig::new(&[small]);
    let (most_n, points) = worked(&mut rig, &at(0.0041, 0.0022, -0.0002));
    assert!(
        points == 3 && most_n > 0.01 && most_n < 5.0,
        "{points}, {most_n} N"
    );
}

/// What cannot move is held by what cannot give way but a little.
#[test]
fn fixed_nodes_are_held_without_a_force_of_everything() {
    let mut rig = Rig::on(
        slab([0.06, 0.04, 0.02], [10, 8, 4]).expect("a block"),
        &[jaws(2.0)],
        |mesh, _, tools| {
            let nodes = (0u32..).zip(mesh.points_m());
            let top: Vec<u32> = nodes
                .filter(|(_, x)| x[2] > -1e-9)
                .map(|(node, _)| node)
                .collect();
            Model::new(mesh, SOFT, &top, Loads::default(), tools).expect("tissue")
        },
    );
    let pose = over();
    rig.close(1, &[pose]);
    let report = rig.step(&[moved(&pose, 2, 0.001)]);
    // In the plane friction is all that holds.
    assert!(
        (report.jaws()[0].in_plane_n - 1.0).abs() < 1e-9,
        "{:?}",
        report.jaws()[0]
    );
    let (most_n, points) = worked(&mut rig, &pose);
    assert!(points == HELD && most_n < 1e3, "{points}, {most_n} N");
}

#[test]
fn both_jaws_hold_one_node() {
    let mut rig = Rig::new(&[jaws(2.0); 2]);
    let pose = over();
    rig.close(1, &[pose, pose]);
    rig.close(2, &[pose, pose]);
    let nodes = |tool: u8| -> Vec<u32> {
        let points = rig.state.grasped(&rig.model, tool).iter();
        points.map(|point| point.at.nodes[0]).collect()
    };
    assert_eq!(nodes(1), nodes(2));
    for k in 1..=20 {
        let by = 1e-4 * f64::from(k);
        let report = rig.step(&[moved(&pose, 2, by), moved(&pose, 1, by)]);
        for contact in report.contacts() {
            assert!(
                contact.wrench.iter().all(|x| x.abs() < 1e3),
                "{:?}",
                contact.wrench
            );
        }
    }
}

#[test]
fn jaws_that_close_in_air_hold_nothing() {
    let mut rig = Rig::new(&[jaws(2.0)]);
    let report = rig.close(1, &[at(0.0, 0.0, 0.05)]);
    let nothing = Event::Lost {
        tool: 1,
        why: Loss::Nothing,
    };
    assert_eq!(report.events().collect::<Vec<_>>(), [nothing]);
    assert_eq!(
        (report.jaws()[0].pads, report.jaws()[0].points),
        (Pads::Closed, 0)
    );
    // Shut, they take nothing on their way either.
    let report = rig.step(&[at(0.0, 0.0, -0.005)]);
    assert_eq!((report.jaws()[0].points, report.contacts()[0].rows), (0, 0));
    assert_eq!(rig.step(&[at(0.0, 0.0, -0.005)]).events().count(), 0);
}

#[test]
fn jaws_open_while_they_slip() {
    let mut rig = Rig::new(&[jaws(0.1)]);
    let pose = over();
    rig.close(1, &[pose]);
    let report = rig.step(&[moved(&pose, 2, 0.003)]);
    assert!(report.jaws()[0].slipping > 0);
    rig.open(1);
    let report = rig.step(&[moved(&pose, 2, 0.0031)]);
    assert_eq!(
        (report.jaws()[0].pads, report.contacts()[0].rows),
        (Pads::Open, 0)
    );
    assert_eq!(report.contacts()[0].wrench, [0.0; 6]);
}

/// Without a clamping force nothing is held in the plane of the pads; with one that is not finite nothing slips.
#[test]
fn clamps_of_nothing_and_of_everything() {
    let pose = over();
    let lifted = |clamp_n: f64| {
        let mut rig = Rig::new(&[jaws(clamp_n)]);
        rig.close(1, &[pose]);
        let report = rig.step(&[moved(&pose, 2, 0.004)]);
        report.jaws()[0]
    };
    let none = lifted(0.0);
    assert!(none.in_plane_n < 1e-12 && none.limit_n == 0.0, "{none:?}");
    let (all, much) = (lifted(f64::INFINITY), lifted(1e4));
    assert!(all.in_plane_n > 0.1 && all.slipping == 0 && all.limit_n == f64::INFINITY);
    assert!((all.in_plane_n - much.in_plane_n).abs() < 1e-9 * much.in_plane_n);
}

/// A step that fails, and tools that are nowhere, leave what is held as it was.
#[test]
fn what_cannot_be_followed_changes_nothing() {
    let mut rig = Rig::new(&[jaws(2.0)]);
    let pose = over();
    rig.close(1, &[pose]);
    rig.step(&[moved(&pose, 2, 0.001)]);
    let before = rig.state.clone();
    let nowhere = at(f64::NAN, 0.0, 0.0);
    assert_eq!(rig.try_step(&[nowhere]).status.name(), "not-finite");
    assert_eq!(rig.state, before);
    // Without a sample the jaws stay where they were.
    let report = rig.try_step(&[]);
    assert_eq!(
        (report.status.name(), report.jaws()[0].points),
        ("ok", HELD)
    );
    // A way of metres is followed as far as a step goes.
    for _ in 0..3 {
        let report = rig.try_step(&[at(2.0, 0.0, 0.0)]);
        assert!(
            ["ok", "behind"].contains(&report.status.name()),
            "{:?}",
            report.status
        );
    }
}

#[test]
fn a_step_with_jaws_allocates_nothing() {
    let mut rig = Rig::new(&[jaws(0.3)]);
    let pose = over();
    rig.work.prepare(&rig.model, |_| true);
    rig.close(1, &[pose]);
    rig.step(&[moved(&pose, 2, 0.003)]);
    rig.open(1);
    rig.step(&[pose]);
    let sample = |by: f64| super::rig::sample(1, &moved(&pose, 2, by));
    let allocated = allocation_counter::measure(|| {
        for k in 0..60 {
            if k % 20 == 0 {
                let act = if k == 40 { Act::Open(1) } else { Act::Close(1) };
                rig.state.act(&rig.model, act);
            }
            let samples = [sample(1e-4 * f64::from(k % 30))];
            let (model, options) = (&rig.model, &rig.options);
            let report =
                sutura_host::step::step(model, &mut rig.state, &samples, options, &mut rig.work);
            assert_eq!(report.status.name(), "ok");
        }
    });
    assert_eq!(allocated.count_total, 0);
}

#[test]
fn jaws_that_make_no_sense_are_refused() {
    let mesh = slab([0.02, 0.02, 0.01], [2, 2, 1]).expect("a block");
    let model = |tools: &[(u8, Tool)]| {
        let fixed: Vec<u32> = (0..9).collect();
        Model::new(&mesh, SOFT, &fixed, Loads::default(), tools).expect("tissue")
    };
    let grip = (1, Tool::new(Shape::Grip, [0.0; 3]));
    let refused = |tools: &[(u8, Tool)], wrong: &[Jaws]| {
        let parts: Vec<_> = wrong
            .iter()
            .map(|jaws| sutura_host::jaws::JawsPart {
                tool: 1,
                jaws: *jaws,
            })
            .collect();
        match model(tools).with_jaws(&mesh, &parts) {
            Err(ModelError::Jaws { tool: 1, flaw }) => flaw,
            Ok(_) => panic!("taken"),
            Err(other) => panic!("{other}"),
        }
    };
    let good = jaws(1.0);
    let ball = (1, Tool::sphere(0.01, [0.0; 3]));
    assert!(refused(&[ball], &[good]).contains("grip"));
    assert!(refused(std::slice::from_ref(&grip), &[good, good]).contains("one pair"));
    let wrong = [
        Jaws {
            length_m: 0.0,
            ..good
        },
        Jaws {
            width_m: f64::NAN,
            ..good
        },
        Jaws {
            opening_rad: 4.0,
            ..good
        },
        Jaws {
            clamp_n: -1.0,
            ..good
        },
        Jaws {
            clamp_n: f64::NAN,
            ..good
        },
        Jaws {
            friction: f64::INFINITY,
            ..good
        },
        Jaws { points: 2, ..good },
        Jaws { points: 33, ..good },
        Jaws {
            strength_pa: 0.0,
            ..good
        },
        Jaws {
            side: [0.0, 0.0, 1.0],
            ..good
        },
        Jaws {
            offset_m: [f64::NAN; 3],
            ..good
        },
    ];
    for jaws in wrong {
        assert!(!refused(std::slice::from_ref(&grip), &[jaws]).is_empty());
    }
    let found = model(&[grip]).with_jaws(&mesh, &[]).expect("without jaws");
    let (_, _) = (State::new(&found), Workspace::new(&found));
}
