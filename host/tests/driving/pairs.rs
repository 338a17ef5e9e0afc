//! Bodies that press on each other: bars of two grips, and a bar on a needle that another grip holds.

use super::bench::{Bench, Kind, MATERIAL, arc, frame, of_segments, straight, tissue};
use super::bodies::a_slab;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::Loads;
use sutura_host::needle::{Needle, NeedleSettings};
use sutura_host::rod::{Bar, BarPart, BodyContact};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::thread::ThreadBody;

const STIFF: f64 = 1000.0;
const SUM_M: f64 = 0.0045;

/// Of tool 0 and tool 1: thick and thin, along z and along -z from the front.
const BARS: [Bar; 2] = [
    Bar {
        offset_m: [0.0, 0.0, 0.015],
        axis: [0.0, 0.0, 1.0],
        radius_m: 0.0025,
        length_m: 0.03,
        friction: 0.0,
    },
    Bar {
        offset_m: [0.001, 0.0, -0.012],
        axis: [0.0, 0.0, -1.0],
        radius_m: 0.002,
        length_m: 0.024,
        friction: 0.0,
    },
];
/// High above the tissue.
const AWAY: Vector3<f64> = Vector3::new(0.01, 0.02, 0.1);

/// Tissue that nothing touches, and two grips with bars, of which the first has a needle in place of one, if there is one.
fn two(needle: Option<Needle>, friction: f64) -> Bench {
    let far = frame([0.0, 0.0, 0.3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let own = needle.unwrap_or(straight(0.02));
    let mesh = a_slab();
    let by_cell = vec![tissue(); mesh.0.cells().len()];
    let mut bench = Bench::built(
        mesh,
        Kind::Linear,
        (&[(own, far)], needle.is_some()),
        (MATERIAL, Loads::default()),
        &by_cell,
        NeedleSettings::default(),
    );
    let bars = [0, 1].map(|tool| BarPart {
        tool,
        bar: BARS[usize::from(tool)],
    });
    let bars = &bars[usize::from(needle.is_some())..];
    let first = needle.map_or(ThreadBody::Grip(0), |_| ThreadBody::Needle(0));
    let contact = BodyContact {
        between: [first, ThreadBody::Grip(1)],
        stiffness_n_per_m: STIFF,
        friction,
    };
    let model = bench.model.with_bars(&bench.mesh, bars).expect("bars");
    bench.model = model.with_body_contacts(&[contact]).expect("a pair");
    bench.state = State::new(&bench.model);
    bench.work = Workspace::new(&bench.model);
    if needle.is_some() {
        assert!(bench.hold(0, Some(0)));
    }
    bench.grip = Isometry3::from_parts(AWAY.into(), UnitQuaternion::identity());
    bench.other = Isometry3::translation(0.0, 0.0, 0.5);
    both(&mut bench);
    bench
}

/// One step of both, all the way.
fn both(bench: &mut Bench) -> StepReport {
    for _ in 0..1000 {
        let samples = [bench.sample_of(0), bench.sample_of(1)];
        let report = bench.follow(&samples);
        if report.status == Status::Ok {
            return report;
        }
        assert!(matches!(report.status, Status::Behind | Status::Waiting));
    }
    panic!("no way there")
}

/// A pose of the second bar: its middle `off` of the middle of the first, and turned.
fn placed(off: Vector3<f64>, turn: UnitQuaternion<f64>) -> Isometry3<f64> {
    let middle = turn * Vector3::new(0.001, 0.0, 0.0);
    Isometry3::from_parts(Translation3::from(AWAY + off - middle), turn)
}

fn crossing() -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(0.0, std::f64::consts::FRAC_PI_2, 0.0))
}

fn wrench(report: &StepReport, tool: usize) -> (Vector3<f64>, Vector3<f64>) {
    let [x, y, z, a, b, c] = report.contacts()[tool].wrench;
    (Vector3::new(x, y, z), Vector3::new(a, b, c))
}

/// Largest difference of a tool's tangent from steps to poses nearby, over its largest entry.
fn tangent_error(bench: &mut Bench, tool: usize) -> f64 {
    // From where both are to where both are: what slipped in the last step has slipped.
    let before = bench.state.clone();
    let samples = [bench.sample_of(0), bench.sample_of(1)];
    let report = bench.follow(&samples);
    let exact = Matrix6::from(report.contacts()[tool].tangent).transpose();
    assert!(exact.amax() > 1.0);
    let mut worst = 0.0f64;
    for axis in 0..6 {
        let h = if axis < 3 { 1e-8 } else { 1e-6 };
        let felt = [-h, h].map(|by| {
            let mut state = before.clone();
            let mut samples = samples;
            let pose = if tool == 0 { bench.grip } else { bench.other };
            if axis < 3 {
                samples[tool].position_m[axis] += by;
            } else {
                let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis - 3, by));
                let coords = (turn * pose.rotation).coords;
                samples[tool].orientation = [coords.x, coords.y, coords.z, coords.w];
            }
            let options = StepOptions::default();
            let report = step(
                &bench.model,
                &mut state,
                &samples,
                &options,
                &mut bench.work,
            );
            assert_eq!(report.status, Status::Ok);
            Vector6::from(report.contacts()[tool].wrench)
        });
        let found = (felt[1] - felt[0]) / (2.0 * h);
        worst = worst.max((found - exact.column(axis)).amax() / exact.amax());
    }
    // What has slipped is at the edge of its cone, where there are two derivatives.
    bench.state = before;
    worst
}

/// Ways that bars lie on each other: across, along, almost along, end on side, end on end; how far the second one is aside and turned.
fn lies() -> [(Vector3<f64>, UnitQuaternion<f64>); 6] {
    let turn = |x: f64, y: f64| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, 0.0));
    let aside = SUM_M - 4e-4;
    [
        (Vector3::new(0.004, aside, 0.003), crossing()),
        (Vector3::new(0.0, aside, 0.002), turn(0.0, 0.0)),
        (Vector3::new(0.0, aside, 0.002), turn(2e-4, 3e-3)),
        // Its end is on the side of the first.
        (Vector3::new(0.0, aside + 0.012, 0.002), turn(1.57, 0.02)),
        // Both ends.
        (Vector3::new(6e-4, 2e-4, 0.027 + aside), turn(0.05, 0.0)),
        (Vector3::new(6e-4, 1e-3, 0.027 + aside), turn(0.0, 3.1)),
    ]
}

/// What both bars have in each other, by the nearest of many points of the one \[m\].
fn overlap_m(bench: &Bench) -> f64 {
    let ends = [(0, bench.grip), (1, bench.other)].map(|(tool, pose): (usize, _)| {
        let bar = BARS[tool];
        let front = pose.transform_point(&bar.offset_m.into()).coords;
        let back = front - pose.rotation * Vector3::from(bar.axis) * bar.length_m;
        [front, back]
    });
    let [from, to] = ends[1];
    let far = |part: f64| {
        let at = ends[0][0] + (ends[0][1] - ends[0][0]) * part;
        let along = (at - from).dot(&(to - from)) / (to - from).norm_squared();
        (at - from - (to - from) * along.clamp(0.0, 1.0)).norm()
    };
    let places = (0..=20000).map(|place| far(f64::from(place) / 20000.0));
    SUM_M - places.fold(f64::MAX, f64::min)
}

/// Brings the second to where it lies, through free room.
fn lie(bench: &mut Bench, (off, turn): (Vector3<f64>, UnitQuaternion<f64>)) -> StepReport {
    let out = Vector3::new(0.0, 0.03, 0.0) + off * 2.0;
    bench.other = placed(out, turn);
    let report = both(bench);
    assert_eq!(wrench(&report, 1).0, Vector3::zeros());
    bench.other = placed(off, turn);
    both(bench)
}

/// Across each other they press with what they overlap times the stiffness, along the normal, on both alike, about one point.
#[test]
fn bars_press_on_each_other_alike() {
    for place in lies() {
        let mut bench = two(None, 0.0);
        let report = lie(&mut bench, place);
        let [one, other] = [wrench(&report, 0), wrench(&report, 1)];
        let at = [bench.grip, bench.other].map(|pose| pose.translation.vector);
        let moment = one.1 + other.1 + at[0].cross(&one.0) + at[1].cross(&other.0);
        println!("{} N", other.0.norm());
        // What is drawn to the middle comes 2e-3 of the radii later at most.
        let expected = STIFF * overlap_m(&bench);
        assert!(
            expected > 0.1 && (other.0.norm() - expected).abs() < 0.012,
            "{expected} {}",
            other.0
        );
        assert!((one.0 + other.0).norm() < 1e-12 && moment.norm() < 1e-12);
        let away = other.0.dot(&place.0);
        assert!(away > 0.0, "{}", other.0);
    }
    let mut bench = two(None, 0.0);
    let report = lie(
        &mut bench,
        (Vector3::new(0.0, SUM_M - 4e-4, 0.0), crossing()),
    );
    let (force, _) = wrench(&report, 1);
    assert!(
        (force - Vector3::new(0.0, 0.4, 0.0)).norm() < 1e-9,
        "{force}"
    );
}

#[test]
fn their_tangents_are_derivatives() {
    for (friction, shift) in [(0.0, 0.0), (0.5, 2e-5), (0.2, 3e-4)] {
        for place in lies() {
            let mut bench = two(None, friction);
            lie(&mut bench, place);
            // Sticks, or slips.
            bench.other.translation.vector += Vector3::new(1.0, 0.3, -0.7) * shift;
            both(&mut bench);
            bench.grip.translation.vector += Vector3::new(-0.2, 0.1, 0.3) * shift;
            let errors = [0, 1].map(|tool| tangent_error(&mut bench, tool));
            println!("{friction} {shift}: {errors:?}");
            assert!(errors.iter().all(|error| *error < 1e-6), "{errors:?}");
        }
    }
}

/// As the second passes ends of the first, and turns through lying along it, force and moment follow without a jump: half the step, half
/// the change.
#[test]
fn nothing_jumps_past_ends_and_through_parallel() {
    let passing = |part: f64| {
        let aside = Vector3::new(0.0, SUM_M - 4e-4, 0.05 * (part - 0.5));
        placed(
            aside,
            UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.2, 0.0)),
        )
    };
    let turning = |part: f64| {
        let turn = Vector3::new(0.02 * (part - 0.5), 0.04 * (part - 0.5), 0.0);
        let off = Vector3::new(0.0, SUM_M - 4e-4, 0.003);
        placed(off, UnitQuaternion::from_scaled_axis(turn))
    };
    let ways: [&dyn Fn(f64) -> Isometry3<f64>; 2] = [&passing, &turning];
    for (number, way) in ways.into_iter().enumerate() {
        let largest = [400, 1600].map(|steps| {
            let mut bench = two(None, 0.0);
            bench.other = way(0.0);
            bench.other.translation.vector.y += 0.03;
            both(&mut bench);
            let (mut before, mut most, mut peak) = (None, 0.0f64, 0.0f64);
            for k in 0..=steps {
                bench.other = way(f64::from(k) / f64::from(steps));
                let report = both(&mut bench);
                let now = Vector6::from(report.contacts()[1].wrench);
                // A moment counts with 10 mm.
                let size = |w: Vector6<f64>| {
                    w.fixed_rows::<3>(0).norm() + 100.0 * w.fixed_rows::<3>(3).norm()
                };
                peak = peak.max(size(now));
                if let Some(before) = before {
                    most = most.max(size(now - before));
                }
                before = Some(now);
            }
            println!("way {number}, {steps} steps: {most} of {peak}");
            assert!(peak > 0.2);
            most
        });
        assert!(largest[1] < 0.35 * largest[0], "{largest:?}");
    }
}

/// Pressed, swept over the end, turned and let go again: the work of both hands is stored, and comes back.
#[test]
fn work_without_friction_is_stored() {
    let missing = [400, 1600].map(|steps| {
        let mut bench = two(None, 0.0);
        let way = |part: f64| {
            let angle = part * std::f64::consts::TAU;
            let off = Vector3::new(
                0.002 * angle.sin(),
                SUM_M + 3e-4 - 8e-4 * (1.0 - angle.cos()) / 2.0,
                0.014 * angle.sin(),
            );
            let turn = Vector3::new(
                0.1 * angle.sin(),
                0.5 * (2.0 * angle).sin(),
                0.2 * angle.sin(),
            );
            placed(off, UnitQuaternion::from_scaled_axis(turn))
        };
        bench.other = way(0.0);
        bench.other.translation.vector.y += 0.03;
        both(&mut bench);
        bench.other = way(0.0);
        let mut before = Vector6::from(both(&mut bench).contacts()[1].wrench);
        assert_eq!(before, Vector6::zeros());
        let (mut work_j, mut worst_j, mut peak_j) = (0.0, 0.0f64, 0.0f64);
        for k in 1..=steps {
            let from = bench.other;
            bench.other = way(f64::from(k) / f64::from(steps));
            let shift = bench.other.translation.vector - from.translation.vector;
            let turn = (bench.other.rotation * from.rotation.inverse()).scaled_axis();
            let report = both(&mut bench);
            let now = Vector6::from(report.contacts()[1].wrench);
            let twist = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
            work_j -= 0.5 * (now + before).dot(&twist);
            before = now;
            peak_j = peak_j.max(report.stored_energy_j);
            worst_j = worst_j.max((work_j - report.stored_energy_j).abs());
        }
        println!("{steps}: {worst_j} of {peak_j}");
        assert!(peak_j > 5e-5 && before == Vector6::zeros());
        worst_j / peak_j
    });
    assert!(
        missing[0] < 0.01 && missing[1] < 0.1 * missing[0],
        "{missing:?}"
    );
}

/// Shifted along itself across the other: sticks by the stiffness, then slips with the friction times the normal force, against the way.
#[test]
fn friction_is_a_cone() {
    let mut bench = two(None, 0.3);
    lie(
        &mut bench,
        (Vector3::new(0.0, SUM_M - 4e-4, 0.0), crossing()),
    );
    let mut felt = Vec::new();
    for _ in 0..40 {
        bench.other.translation.vector.x += 1e-5;
        let (force, _) = wrench(&both(&mut bench), 1);
        felt.push(force);
    }
    // 0.12 N after 0.12 mm.
    assert!((felt[4].x + 5e-5 * STIFF).abs() < 1e-4, "{}", felt[4]);
    for force in &felt[13..] {
        assert!((force.x + 0.3 * force.y).abs() < 1e-4, "{force}");
    }
    bench.other.translation.vector.x -= 6e-5;
    let (force, _) = wrench(&both(&mut bench), 1);
    assert!((force.x + 0.12 - 0.06).abs() < 1e-3, "{force}");
    bench.other.translation.vector.y += 1e-3;
    assert_eq!(wrench(&both(&mut bench), 1).0, Vector3::zeros());
}

/// Turned, shifted, and named the other way round it is the same.
#[test]
fn a_turned_scene_has_turned_forces() {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -1.1, 0.4));
    let places = [
        Isometry3::identity(),
        Isometry3::from_parts(Vector3::new(0.1, -0.2, 0.25).into(), turn),
    ];
    for place in lies() {
        let found = places.map(|whole| {
            let mut bench = two(None, 0.2);
            bench.grip = whole * bench.grip;
            for (off, aside) in [
                (place.0 * 2.0 + Vector3::y() * 0.03, 0.0),
                (place.0, 0.0),
                (place.0, 1e-4),
            ] {
                bench.other = whole * placed(off + Vector3::new(aside, 0.0, -aside), place.1);
                both(&mut bench);
            }
            let (force, moment) = wrench(&both(&mut bench), 1);
            [force, moment * 100.0].map(|vector| whole.inverse_transform_vector(&vector))
        });
        assert!(found[0][0].norm() > 0.02);
        for (one, other) in found[0].iter().zip(&found[1]) {
            assert!((one - other).norm() < 1e-9, "{one} {other}");
        }
    }
}

/// A needle that the other hand holds, bent or not, is pressed on, and gives its hand the force; the tangents of both are derivatives.
#[test]
fn a_bar_presses_on_a_held_needle() {
    let compound = of_segments(&[(0.006, f64::INFINITY), (0.012, 0.008)]);
    for needle in [arc(0.009, 150.0), straight(0.02), compound] {
        for friction in [0.0, 0.4] {
            let mut bench = two(Some(needle), friction);
            // From outside onto the bend, a third along it.
            let hold = bench.state.needle_pose(&bench.model, 0).expect("a needle");
            bench.grip = hold;
            let curve = needle.at(&hold);
            let alpha = 0.35 * curve.length;
            let out = -curve.inward_at(alpha) + curve.binormal() * 0.4;
            let out = out.normalize();
            let at = curve.at(alpha);
            let turn =
                UnitQuaternion::rotation_between(&Vector3::z(), &curve.binormal()).expect("a turn");
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.1, 0.05)) * turn;
            let put = |far_m: f64| {
                let middle = turn * Vector3::new(0.001, 0.0, 0.0);
                Isometry3::from_parts((at + out * far_m - middle).into(), turn)
            };
            bench.other = put(0.03);
            both(&mut bench);
            bench.other = put(0.0020);
            let report = both(&mut bench);
            let [one, other] = [wrench(&report, 0).0, wrench(&report, 1).0];
            assert!(
                other.norm() > 0.05 && (one + other).norm() < 1e-12,
                "{one} {other}"
            );
            bench.other.translation.vector += Vector3::new(2e-5, -3e-5, 1e-5);
            let errors = [0, 1].map(|tool| tangent_error(&mut bench, tool));
            println!("{friction}: {errors:?}, {} N", other.norm());
            assert!(errors.iter().all(|error| *error < 1e-6), "{errors:?}");
        }
    }
}

/// What is apart tells how far, and what it will feel just after touching.
#[test]
fn what_is_near_is_told() {
    let mut bench = two(None, 0.0);
    let off = Vector3::new(0.0, SUM_M + 5e-4, 0.0);
    let report = lie(&mut bench, (off, crossing()));
    let contact = report.contacts()[1];
    assert!((contact.gap_m - 5e-4).abs() < 1e-9 && contact.rows == 0);
    assert!((Vector3::from(contact.normal) - Vector3::y()).norm() < 1e-9);
    assert!((contact.tangent[1][1] + STIFF).abs() < 1e-6);
    assert_eq!(contact.wrench, [0.0; 6]);
}

/// Put into each other they do nothing until they have been apart.
#[test]
fn what_was_put_into_the_other_waits() {
    let mut bench = two(None, 0.0);
    bench.other = placed(Vector3::new(0.0, SUM_M - 1e-3, 0.0), crossing());
    let sample = bench.sample_of(1);
    bench.state.put(&sample);
    let report = both(&mut bench);
    assert_eq!(wrench(&report, 1).0, Vector3::zeros());
    bench.other.translation.vector.y += 2e-3;
    both(&mut bench);
    bench.other.translation.vector.y -= 2e-3;
    assert!(wrench(&both(&mut bench), 1).0.y > 0.9);
}

/// A hand that presses by more than the stiffness times both radii goes through: the force grows to that and no further, and from the middle
/// on drives the body out on the other side, where it lets go. Across the way nothing comes along.
#[test]
fn what_presses_too_hard_goes_through() {
    let mut bench = two(None, 0.0);
    let far = SUM_M + 3e-4;
    lie(&mut bench, (Vector3::new(0.0, far, 0.0), crossing()));
    let mut most_n = 0.0f64;
    // Past the middle, where there is no normal.
    for step in 1..=128 {
        let y = far * (1.0 - f64::from(step) / 64.5);
        bench.other = placed(Vector3::new(0.0, y, 0.0), crossing());
        let report = both(&mut bench);
        let [one, other] = [wrench(&report, 0).0, wrench(&report, 1).0];
        let expected = STIFF * (SUM_M - y.abs()).max(0.0) * y.signum();
        assert!(
            (other - Vector3::y() * expected).norm() < 1e-9,
            "{y}: {other}"
        );
        assert!((one + other).norm() < 1e-12);
        most_n = most_n.max(other.norm());
    }
    assert!(
        most_n > 0.95 * STIFF * SUM_M && most_n <= STIFF * SUM_M,
        "{most_n}"
    );
    assert_eq!(wrench(&both(&mut bench), 1).0, Vector3::zeros());
}

#[test]
fn pairs_allocate_nothing() {
    let mut bench = two(None, 0.3);
    lie(
        &mut bench,
        (Vector3::new(0.0, SUM_M - 4e-4, 0.0), crossing()),
    );
    let allocated = allocation_counter::measure(|| {
        for k in 0..50 {
            bench.other.translation.vector.x += 1e-4;
            bench.other.translation.vector.y += 4e-5 * f64::from(k).sin();
            both(&mut bench);
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}

#[test]
fn pairs_that_cannot_be_are_refused() {
    let pair = |one, other| BodyContact {
        between: [one, other],
        stiffness_n_per_m: STIFF,
        friction: 0.0,
    };
    let [grip, needle] = [ThreadBody::Grip, ThreadBody::Needle];
    let good = pair(grip(0), grip(1));
    let tries = [
        (vec![pair(grip(0), grip(0))], "the same body"),
        (vec![pair(grip(0), grip(5))], "one of them has no body"),
        (
            vec![pair(needle(0), needle(1))],
            "one has to be the body of a grip",
        ),
        (vec![good, pair(grip(1), grip(0))], "that is said twice"),
        (
            vec![BodyContact {
                stiffness_n_per_m: 0.0,
                ..good
            }],
            "the stiffness is 0 N/m; it must be above 0",
        ),
        (
            vec![BodyContact {
                friction: -0.1,
                ..good
            }],
            "the friction is -0.1; it must be from 0 to 10",
        ),
    ];
    for (pairs, said) in tries {
        let bench = two(None, 0.0);
        // Of the bench's pair, too, there is one already.
        let pairs: Vec<_> = pairs.into_iter().collect();
        let error = bench.model.with_body_contacts(&pairs).expect_err(said);
        assert!(error.to_string().contains(said), "{error}");
    }
}
