//! Who holds a needle, and nobody.

use super::bench::*;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::model::Passes;
use sutura_host::needle::{Needle, NeedleSettings, NeedleTissue, TipPlace};
use sutura_host::step::{Status, StepReport};

/// Force and moment about `at` of all that pushes the tissue, by its nodes.
fn net(bench: &Bench, at: &Vector3<f64>) -> Vector6<f64> {
    let whole = bench.model.equilibrium(&bench.state).expect("a balance");
    let mut net = Vector6::zeros();
    for (node, force) in bench.state.contact_forces(&bench.model) {
        let place = Vector3::from(bench.mesh.points_m()[node as usize]);
        let moved = Vector3::from(whole.displacement_m[node as usize]);
        let force = Vector3::from(force);
        let moment = (place + moved - at).cross(&force);
        net += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
    }
    net
}

/// Wrench of a tool about a point.
fn about(
    report: &StepReport,
    tool: usize,
    grip: &Isometry3<f64>,
    at: &Vector3<f64>,
) -> Vector6<f64> {
    let mut wrench = Vector6::from(report.contacts()[tool].wrench);
    let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
    let more = (grip.translation.vector - at).cross(&force);
    for axis in 0..3 {
        wrench[3 + axis] += more[axis];
    }
    wrench
}

fn soft() -> NeedleTissue {
    NeedleTissue {
        puncture_pa: 0.2 * tissue().puncture_pa,
        cutting_pa: 0.5 * tissue().cutting_pa,
        ..tissue()
    }
}

/// A straight needle over the slabs and an arc beside the tube, a way through, and how a way goes on.
fn two_kinds(kind: impl Fn() -> Kind, tissue: NeedleTissue) -> [(Bench, Needle, f64); 2] {
    let settings = NeedleSettings::default();
    let line = straight(0.04);
    let start = frame(
        [0.0013, 0.0007, 0.0535],
        [0.05, 0.02, -1.0],
        [1.0, 0.0, 0.0],
    );
    let first = Bench::new(slabs(), kind(), line, start, tissue, settings);
    let bent = arc(0.009, 170.0);
    let end = Vector3::new(0.0135, -0.009, 0.0151);
    let start = frame(end.into(), [1.0, 0.0, 0.02], [0.0, 1.0, 0.01]);
    let second = Bench::new(a_tube(), kind(), bent, start, tissue, settings);
    [(first, line, 0.016), (second, bent, 0.0145)]
}

/// Along itself.
fn drive(bench: &mut Bench, needle: &Needle, way_m: f64) -> StepReport {
    let mut report = StepReport::default();
    let steps = (way_m.abs() / 1e-4).round() as usize;
    for _ in 0..steps {
        let curve = needle.at(&bench.grip);
        let by = 1e-4 * way_m.signum();
        let turn = UnitQuaternion::from_scaled_axis(curve.binormal() * (by * curve.curvature));
        let to = Translation3::from(curve.at(by));
        bench.grip = Isometry3::from_parts(to, turn * bench.grip.rotation);
        report = bench.try_step();
        assert_eq!(report.status, Status::Ok);
    }
    report
}

#[test]
fn the_hand_may_change_anywhere_on_the_needle() {
    for (mut bench, needle, way) in two_kinds(|| Kind::Linear, soft()) {
        bench.go();
        let mut places = 0;
        for part in [0.6, 0.2, 0.2] {
            drive(&mut bench, &needle, part * way);
            // Loaded aside as well.
            let aside = Translation3::from(Vector3::new(1e-4, -5e-5, 8e-5));
            bench.grip = aside * bench.grip;
            // Bounds by the length in the tissue settle in a few steps.
            for _ in 0..12 {
                bench.go();
            }
            let pose = bench.grip;
            for place in [0.0, 0.2, 0.5, 0.9, 1.0] {
                let (before, old) = bench.go();
                let curve = needle.at(&pose);
                let at = curve.at(place * curve.length);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -place, 1.0));
                bench.other = Isometry3::from_parts(Translation3::from(at), turn);
                assert!(bench.hold(0, Some(1)));
                let after = bench.step_both();
                assert_eq!(after.status, Status::Ok);
                bench.look(&after);
                let now = after.needles()[0];
                assert_eq!(now.held_by, Some(1));
                let origin = Vector3::new(0.001, 0.002, 0.003);
                let then = about(&before, 0, &pose, &origin);
                let there = about(&after, 1, &bench.other, &origin);
                let off = (there - then).amax();
                // An arc's slides are known to 3e-8 of its length.
                let close = if curve.curvature == 0.0 { 1e-12 } else { 1e-9 };
                assert!(then.norm() > 1e-3 && off <= close, "{off:e} of {then:?}");
                assert!((now.axial_n - old.axial_n).abs() <= close);
                assert_eq!(after.contacts()[0].wrench, [0.0; 6]);
                assert_eq!(now.crossings, old.crossings);
                // It follows its new hand: the same push from there.
                let by = Vector3::new(2e-5, 1e-5, 0.0);
                bench.other = Translation3::from(by) * bench.other;
                let pushed = bench.step_both();
                bench.other = Translation3::from(-by) * bench.other;
                let force = Vector3::from_row_slice(&pushed.contacts()[1].wrench[..3]);
                let held = Vector3::from_row_slice(&after.contacts()[1].wrench[..3]);
                assert!((force - held).dot(&by) < 0.0, "no resistance");
                bench.step_both();
                assert!(bench.hold(0, Some(0)));
                places += 1;
            }
        }
        assert_eq!(places, 15);
    }
}

/// Steps with nobody at the needle until what it does to the tissue is nothing.
fn let_lie(bench: &mut Bench, needle: &Needle, most: usize) -> (usize, f64) {
    let (first, _) = bench.go();
    let pose = bench.state.needle_pose(&bench.model, 0).expect("a needle");
    let length = needle.shape.length_m();
    let size = |bench: &Bench| {
        let pose = bench.state.needle_pose(&bench.model, 0).expect("a needle");
        let curve = needle.at(&pose);
        let net = net(bench, &curve.at(0.5 * length));
        let moment = net.fixed_rows::<3>(3).norm() / length;
        net.fixed_rows::<3>(0).norm() + moment
    };
    let before = size(bench);
    let total = |report: &StepReport| {
        let spent: f64 = report.needles()[0].dissipated_j.iter().sum();
        report.stored_energy_j + spent
    };
    assert!(bench.hold(0, None));
    let (mut stored, mut steps, mut now) = (first.stored_energy_j, 0, before);
    let mut last = first;
    while now > 1e-9 * before && steps < most {
        bench.time_us += 5000;
        last = bench.follow(&[]);
        assert_eq!(last.status, Status::Ok);
        bench.look(&last);
        assert_eq!(last.needles()[0].held_by, None);
        let rest = last.stored_energy_j;
        assert!(
            rest <= stored * (1.0 + 1e-9) + 1e-18,
            "energy rises {stored:e} {rest:e}"
        );
        stored = rest;
        now = size(bench);
        println!(
            "now {now:e} {:?} {}",
            last.needles()[0].dissipated_j,
            last.iterations
        );
        steps += 1;
    }
    let moved = bench.state.needle_pose(&bench.model, 0).expect("a needle");
    println!(
        "{} crossings, {:?}: {before:.2e} N to {now:.2e} in {steps} steps, moved {:.2e} m, {:.3e} J to {stored:.3e}, unaccounted {:.1e}",
        last.needles()[0].crossings,
        last.needles()[0].tip,
        (moved.translation.vector - pose.translation.vector).norm(),
        first.stored_energy_j,
        total(&last) - total(&first),
    );
    let lost = (total(&last) - total(&first)).abs();
    (steps, lost / first.stored_energy_j)
}

#[test]
fn a_needle_let_go_comes_to_rest_in_the_tissue() {
    let without_friction = NeedleTissue {
        friction_n_per_m: 0.0,
        static_friction_n_per_m: 0.0,
        cutting_pa: 0.0,
        ..soft()
    };
    for (tissue, accounted) in [(soft(), 0.02), (without_friction, 0.02)] {
        for (mut bench, needle, way) in two_kinds(|| Kind::Linear, tissue) {
            bench.go();
            for part in [0.8, 0.2] {
                drive(&mut bench, &needle, part * way);
                let aside = Isometry3::new(
                    Vector3::new(2e-4, -1e-4, 1e-4),
                    Vector3::new(0.01, 0.0, 0.02),
                );
                let curve = needle.at(&bench.grip);
                let middle = Translation3::from(curve.at(0.5 * curve.length));
                bench.grip = middle * aside * middle.inverse() * bench.grip;
                let (_, held) = bench.go();
                assert!(held.crossings > 0);
                let (steps, lost) = let_lie(&mut bench, &needle, 60);
                assert!(steps < 40, "{steps} steps");
                assert!(lost < accounted, "{lost} of the energy");
                // There it stays, once the bounds by its length in the tissue have settled, too.
                let mut lie = |steps: usize| {
                    for _ in 0..steps {
                        bench.time_us += 5000;
                        let report = bench.follow(&[]);
                        assert_eq!(report.status, Status::Ok);
                    }
                    bench.state.needle_pose(&bench.model, 0).expect("a needle")
                };
                let (before, after) = (lie(100), lie(200));
                let drift = (after.translation.vector - before.translation.vector).norm();
                let turned = after.rotation.angle_to(&before.rotation);
                assert!(
                    drift < 1e-10 && turned < 1e-8,
                    "drifts {drift:e} {turned:e}"
                );
                assert!((after.rotation.norm() - 1.0).abs() < 1e-14);
                // Taken where it lies, it pulls at nobody.
                bench.grip = after;
                assert!(bench.hold(0, Some(0)));
                let (report, needle) = bench.go();
                let wrench = Vector6::from(report.contacts()[0].wrench);
                assert!(wrench.amax() < 1e-8, "{wrench:?}");
                assert_eq!(needle.held_by, Some(0));
            }
        }
    }
}

#[test]
fn a_needle_let_go_in_corotational_tissue_comes_to_rest() {
    let kind = || {
        Kind::Corotational(Passes {
            most: 4,
            tolerance: 1e-9,
        })
    };
    for (mut bench, needle, way) in two_kinds(kind, soft()) {
        for _ in 0..3 {
            bench.go();
        }
        drive(&mut bench, &needle, way);
        bench.grip = Translation3::from(Vector3::new(2e-4, -1e-4, 1e-4)) * bench.grip;
        for _ in 0..8 {
            bench.go();
        }
        let (first, _) = bench.go();
        assert!(bench.hold(0, None));
        let mut last = first;
        for _ in 0..40 {
            bench.time_us += 5000;
            last = bench.follow(&[]);
            assert_eq!(last.status, Status::Ok);
            bench.look(&last);
        }
        println!(
            "{:e} J to {:e}",
            first.stored_energy_j, last.stored_energy_j
        );
        assert!(last.stored_energy_j < first.stored_energy_j);
        let pose = bench.state.needle_pose(&bench.model, 0).expect("a needle");
        for _ in 0..40 {
            bench.time_us += 5000;
            bench.follow(&[]);
        }
        let after = bench.state.needle_pose(&bench.model, 0).expect("a needle");
        let drift = (after.translation.vector - pose.translation.vector).norm();
        assert!(drift < 1e-7, "{drift:e}");
        bench.grip = after;
        assert!(bench.hold(0, Some(0)));
        let (report, _) = bench.go();
        let before = Vector6::from(first.contacts()[0].wrench).amax();
        let left = Vector6::from(report.contacts()[0].wrench).amax();
        assert!(left < 1e-2 * before, "{left} of {before}");
    }
}

#[test]
fn a_loose_needle_beside_a_held_one_gives_way() {
    // Two through the lower slab, 6 mm apart; the second one lies loose.
    let start = |x: f64| frame([x, 0.0007, 0.042], [0.02, 0.01, -1.0], [1.0, 0.0, 0.0]);
    let mut mesh = slabs();
    mesh.1.sort_unstable();
    let tissue = vec![soft(); mesh.0.cells().len()];
    let needles = [
        (straight(0.025), start(-0.003)),
        (straight(0.025), start(0.003)),
    ];
    let settings = NeedleSettings::default();
    let mut bench = Bench::many(mesh, Kind::Linear, &needles, MATERIAL, &tissue, settings);
    for _ in 0..140 {
        bench.grip.translation.vector.z -= 1e-4;
        bench.other.translation.vector.z -= 1e-4;
        let report = bench.step_both();
        assert_eq!(report.status, Status::Ok);
        bench.look(&report);
    }
    let both = bench.state.clone();
    assert!(both.crossings(&bench.model, 1).len() > 2);
    // Each tangent, the other hand still.
    for tool in [0, 1] {
        // Past what it met last.
        for _ in 0..3 {
            let grip = if tool == 0 {
                &mut bench.grip
            } else {
                &mut bench.other
            };
            grip.translation.vector.z -= 1e-5;
            bench.step_both();
        }
        let before = bench.state.clone();
        let grips = [bench.grip, bench.other];
        // Deeper, so that what slides goes on sliding.
        let mut base = grips;
        base[tool].translation.vector += Vector3::new(1e-5, 5e-6, -1e-5);
        let mut at = |by: Vector6<f64>| {
            let mut to = base;
            let shift: Vector3<f64> = by.fixed_rows::<3>(0).into();
            let turn: Vector3<f64> = by.fixed_rows::<3>(3).into();
            to[tool] = Isometry3::from_parts(
                Translation3::from(base[tool].translation.vector + shift),
                UnitQuaternion::from_scaled_axis(turn) * base[tool].rotation,
            );
            bench.state = before.clone();
            [bench.grip, bench.other] = to;
            let report = bench.step_both();
            assert_eq!(report.status, Status::Ok);
            report
        };
        let there = at(Vector6::zeros()).contacts()[tool];
        let own = Matrix6::from_fn(|i, j| there.tangent[i][j]);
        let mut found = Matrix6::zeros();
        for axis in 0..6 {
            let h = if axis < 3 { 1e-7 } else { 1e-5 };
            let ends =
                [h, -h].map(|h| Vector6::from(at(Vector6::ith(axis, h)).contacts()[tool].wrench));
            found.set_column(axis, &((ends[0] - ends[1]) / (2.0 * h)));
        }
        for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let off = (own.fixed_view::<3, 3>(i, j) - found.fixed_view::<3, 3>(i, j)).amax();
            let size = found.fixed_view::<3, 3>(i, j).amax();
            assert!(
                off < 1e-6 * size,
                "tool {tool}, block {i} {j}: {off:e} of {size:e}"
            );
        }
        bench.state = before.clone();
        [bench.grip, bench.other] = grips;
    }
    // Aside with the first: the held second one resists it more than the loose one.
    let push = |bench: &mut Bench| {
        for _ in 0..20 {
            bench.grip.translation.vector.x += 5e-5;
            let report = bench.step_both();
            assert_eq!(report.status, Status::Ok);
            bench.look(&report);
        }
        let report = bench.step_both();
        Vector3::from_row_slice(&report.contacts()[0].wrench[..3])
    };
    let grips = [bench.grip, bench.other];
    let held = push(&mut bench);
    bench.state = both;
    [bench.grip, bench.other] = grips;
    assert!(bench.hold(1, None));
    let then = bench.state.needle_pose(&bench.model, 1).expect("it");
    let loose = push(&mut bench);
    let now = bench.state.needle_pose(&bench.model, 1).expect("it");
    assert!(loose.x < 0.0 && loose.x > held.x, "{loose:?} {held:?}");
    assert!(
        now.translation.x > then.translation.x,
        "it does not come along"
    );
}

/// Through both slabs, tip outside below.
fn through(tissue: NeedleTissue) -> Bench {
    let start = frame([0.0013, 0.0007, 0.054], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let settings = NeedleSettings::default();
    let mut bench = Bench::new(
        slabs(),
        Kind::Linear,
        straight(0.04),
        start,
        tissue,
        settings,
    );
    bench.go();
    let report = drive(&mut bench, &straight(0.04), 0.026);
    assert_eq!(report.needles()[0].tip, TipPlace::Outside);
    assert_eq!(report.needles()[0].punctures, 4);
    bench
}

#[test]
fn what_stuck_breaks_away_and_rubs_less() {
    let tissue = NeedleTissue {
        static_friction_n_per_m: 1.5 * tissue().friction_n_per_m,
        ..soft()
    };
    let mut bench = through(tissue);
    let rubs = bench.go().1.axial_n;
    let expected = tissue.friction_n_per_m * 0.016;
    assert!((-rubs / expected - 1.0).abs() < 0.03, "{rubs} {expected}");
    // Back: up to what it takes to break away, then down to what rubs.
    let (mut most, mut trace) = (0.0f64, Vec::new());
    for _ in 0..600 {
        bench.grip.translation.vector.z += 5e-6;
        let (report, needle) = bench.go();
        bench.look(&report);
        most = most.max(needle.axial_n);
        trace.push(needle.axial_n);
    }
    let last = trace[trace.len() - 1];
    println!("breaks away at {most}, then {last}, rubs {expected}");
    assert!((last / expected - 1.0).abs() < 0.05, "{last} {expected}");
    assert!(
        most > 1.05 * expected && most <= 1.5 * expected * 1.05,
        "{most}"
    );
    // It fell, rather than crept.
    let drop = trace
        .windows(2)
        .map(|pair| pair[0] - pair[1])
        .fold(0.0, f64::max);
    assert!(drop > 0.02 * expected, "{drop}");
}

#[test]
fn faster_rubs_more() {
    let viscous_n_s_per_m2 = 50.0;
    let tissue = NeedleTissue {
        viscous_n_s_per_m2,
        ..soft()
    };
    let mut bench = through(tissue);
    let mut forces = Vec::new();
    // 5 ms a step.
    for (step_m, steps) in [(1e-5, 100), (1e-4, 10), (2e-4, 5)] {
        let mut last = 0.0;
        for _ in 0..steps {
            bench.grip.translation.vector.z -= step_m;
            let (report, needle) = bench.go();
            bench.look(&report);
            assert!(needle.slides);
            last = needle.axial_n;
        }
        forces.push(last);
    }
    let length = 0.016;
    for (force, step_m) in forces.iter().zip([1e-5, 1e-4, 2e-4]) {
        let speed = step_m / 5e-3;
        let expected = (5.0 + viscous_n_s_per_m2 * speed) * length;
        assert!(
            (-force / expected - 1.0).abs() < 0.03,
            "{force} {expected} at {speed} m/s"
        );
    }
    // At rest the speed's part is gone.
    let (_, needle) = bench.go();
    assert!(
        (-needle.axial_n / (5.0 * length) - 1.0).abs() < 0.03,
        "{needle:?}"
    );
}
