//! Coulomb's law in the plane of the pads: how much they hold, what slips, what that spends, and what tears off.

use super::rig::{Rig, SOFT, at, jaws, moved, over};
use nalgebra::{Isometry3, Vector3};
use sutura_host::event::{Event, Loss};
use sutura_host::fem::Loads;
use sutura_host::jaws::Jaws;
use sutura_host::mesh::slab;
use sutura_host::model::Model;

/// Pads along x that hold the end of a tongue of 4 mm, 15 mm of it in 40 mm of pads: pushed on there is room for slips.
fn tongue(points: usize, clamp_n: f64) -> (Rig, Isometry3<f64>) {
    let jaws = Jaws {
        axis: [-1.0, 0.0, 0.0],
        side: [0.0, 1.0, 0.0],
        length_m: 0.04,
        width_m: 0.03,
        points,
        ..Jaws::new(clamp_n, 0.4)
    };
    let mesh = slab([0.06, 0.02, 0.004], [20, 8, 2]).expect("a tongue");
    let rig = Rig::on(mesh, &[jaws], |mesh, _, tools| {
        let nodes = (0u32..).zip(mesh.points_m());
        let root: Vec<u32> = nodes
            .filter(|(_, x)| x[0] < -0.0299)
            .map(|(node, _)| node)
            .collect();
        Model::new(mesh, SOFT, &root, Loads::default(), tools).expect("tissue")
    });
    // The hinge is 25 mm before the tongue's end, 15 mm of which are in the pads.
    (rig, at(0.015, 0.0, -0.002))
}

/// Whatever the number of points, what slips as a whole is held by the friction of all of the clamping force, and spends
/// that over its way.
#[test]
fn jaws_slip_at_friction_times_clamp_whatever_the_points() {
    let (clamp_n, limit_n) = (0.003, 0.0012);
    for points in [3, 5, 8, 13, 20] {
        let (mut rig, pose) = tongue(points, clamp_n);
        let report = rig.close(1, &[pose]);
        assert_eq!(report.jaws()[0].points as usize, points);
        // What was across the way when they stuck fades over the way on which the bound bends the tongue: 0.3 mm.
        let step_m = 2.5e-4;
        let mut at_x = |k: f64| {
            let pushed = moved(&pose, 0, -step_m * k);
            rig.step(&[pushed])
        };
        let mut before = at_x(0.1);
        assert!(before.jaws()[0].in_plane_n < limit_n, "it sticks at first");
        let mut k = 0.0;
        while before.jaws()[0].slipping < points as u32 {
            k += 1.0;
            before = at_x(k);
            assert!(k < 40.0, "it never slips");
        }
        for _ in 0..60 {
            k += 1.0;
            before = at_x(k);
        }
        k += 1.0;
        let after = at_x(k);
        let jaws = after.jaws()[0];
        assert_eq!(
            (jaws.points as usize, jaws.slipping as usize),
            (points, points)
        );
        assert!(
            (jaws.in_plane_n - limit_n).abs() < 1e-9 * limit_n,
            "{points}: {} N",
            jaws.in_plane_n
        );
        let [x, y, z, ..] = after.contacts()[0].wrench;
        let (along, across) = (x / limit_n - 1.0, y / limit_n);
        assert!(along.abs() < 1e-9 && across.abs() < 1e-5, "{x} {y} {z}");
        let spent_j = jaws.friction_j - before.jaws()[0].friction_j;
        let expected_j = limit_n * step_m;
        assert!(
            (spent_j / expected_j - 1.0).abs() < 1e-6,
            "{points}: {spent_j} J"
        );
    }
}

/// A pull along the diagonal is held by no more than one along a side: a disc, no box.
#[test]
fn the_bound_is_the_same_in_all_directions() {
    for angle in [0.0f64, 0.4, 0.785, 1.2, 1.57] {
        let (mut rig, pose) = tongue(8, 0.0005);
        rig.close(1, &[pose]);
        let way = Vector3::new(-angle.cos(), angle.sin(), 0.0);
        let mut report = rig.step(&[pose]);
        for k in 1..=40 {
            let mut pulled = pose;
            pulled.translation.vector += way * (1.2e-4 * f64::from(k));
            report = rig.step(&[pulled]);
        }
        let jaws = report.jaws()[0];
        assert_eq!(jaws.slipping, jaws.points);
        assert!(
            (jaws.in_plane_n / 0.0002 - 1.0).abs() < 1e-4,
            "{angle}: {}",
            jaws.in_plane_n
        );
        let [x, y, ..] = jaws.away;
        assert!((x - way.x).abs() < 1e-3 && (y - way.y).abs() < 1e-3);
    }
}

/// What the hand has done is stored or spent: over a pull that sticks, slips and goes back, with no end to end.
#[test]
fn work_is_stored_or_spent_on_slips() {
    let (mut rig, pose) = tongue(8, 0.3);
    rig.close(1, &[pose]);
    let mut before = rig.step(&[pose]);
    let (mut work_j, mut last_x) = (0.0, 0.0);
    for k in 0..=400 {
        let x = -0.006 * (f64::from(k) / 400.0 * std::f64::consts::PI).sin();
        let report = rig.step(&[moved(&pose, 0, x)]);
        let middle_n = 0.5 * (report.contacts()[0].wrench[0] + before.contacts()[0].wrench[0]);
        work_j -= middle_n * (x - last_x);
        (before, last_x) = (report, x);
    }
    let spent_j = before.jaws()[0].friction_j;
    let stored_j = before.stored_energy_j;
    let missing = (work_j - spent_j - stored_j) / work_j;
    assert!(
        spent_j > 1e-4 && missing.abs() < 1e-2,
        "{work_j} {spent_j} {stored_j}"
    );
}

#[test]
fn what_slips_out_of_the_pads_is_lost() {
    let (mut rig, pose) = tongue(8, 0.1);
    rig.close(1, &[pose]);
    let mut lost = Vec::new();
    let mut counts = vec![8];
    for k in 1..=200 {
        let report = rig.step(&[moved(&pose, 0, 5e-4 * f64::from(k))]);
        counts.push(report.jaws()[0].points);
        lost.extend(report.events());
        let jaws = report.jaws()[0];
        if jaws.slipping == jaws.points && jaws.points > 0 {
            assert!(
                jaws.in_plane_n <= 0.04 * (1.0 + 1e-9),
                "fewer points hold no more"
            );
        }
    }
    assert!(
        counts.windows(2).all(|pair| pair[1] <= pair[0]),
        "{counts:?}"
    );
    assert!(counts.iter().any(|count| (1..8).contains(count)));
    let slipped = Event::Lost {
        tool: 1,
        why: Loss::Slipped,
    };
    assert_eq!((counts.last(), &lost[..]), (Some(&0), &[slipped][..]));
    // Shut jaws take nothing until they have been open.
    let report = rig.step(&[pose]);
    assert_eq!(report.jaws()[0].points, 0);
    rig.open(1);
    assert!(rig.close(1, &[pose]).jaws()[0].points > 3);
}

#[test]
fn jaws_tear_off_at_the_strength_of_their_pads() {
    let weak = Jaws {
        strength_pa: 4e3,
        ..jaws(50.0)
    };
    // 20 mm by 6.4 mm: 0.512 N.
    let mut rig = Rig::new(&[weak]);
    let pose = over();
    rig.close(1, &[pose]);
    let (mut most_n, mut torn) = (0.0f64, Vec::new());
    for k in 1..=400 {
        let report = rig.step(&[moved(&pose, 2, 2e-5 * f64::from(k))]);
        torn.extend(report.events());
        let [x, y, z] = report.jaws()[0].force_n;
        most_n = most_n.max(Vector3::new(x, y, z).norm());
    }
    let tore = Event::Lost {
        tool: 1,
        why: Loss::Tore,
    };
    assert_eq!(torn, [tore]);
    assert!(most_n > 0.5 && most_n <= 0.512, "{most_n} N");
    let rest = rig.positions();
    let off = rest.iter().zip(rig.mesh.points_m());
    let off = off.fold(0.0f64, |most, (a, b)| {
        most.max((Vector3::from(*a) - Vector3::from(*b)).norm())
    });
    assert!(off < 1e-14, "{off}");
}
