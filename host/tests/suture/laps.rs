//! Taut spans on bodies of grips and needles: what they press with, how that follows the hands, and when they lie there.

use super::one_length::*;
use super::pull::tangents_are_true;
use super::rig::*;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::TetMesh;
use sutura_host::needle::{Needle, NeedleSettings};
use sutura_host::rod::{Bar, BarPart};
use sutura_host::scene::{Document, Scene};
use sutura_host::session::SceneSolver;
use sutura_host::step::{State, StepReport, Workspace};
use sutura_host::thread::{ThreadBody, ThreadContact, ThreadEnd, ThreadHold, ThreadPlace, Through};
use sutura_host::tool::ToolSample;

const BAR: Bar = Bar {
    offset_m: [0.0, 0.0, 0.015],
    axis: [0.0, 0.0, 1.0],
    radius_m: 0.002,
    length_m: 0.03,
    friction: 0.0,
};
/// Where the tail is held: the span leads from there over free room to the slab's top.
const TAIL: [f64; 3] = [-0.06, 0.0007, 0.004];
/// From the middle of the bar's axis to the span it is near.
const RADIUS_M: f64 = 0.002 + 0.5 * INEXTENSIBLE.thickness_m;

/// All but the lower side is held.
fn still(at: &[f64; 3]) -> bool {
    at[2] > -0.0199
}

/// Only the side that nothing goes through, and that is away from the bar.
fn beside(at: &[f64; 3]) -> bool {
    at[0] > 0.0149
}

/// A needle with a thread, drawn down through a slab whose place and turn are `place`, with a bar on tool 1, far away; the thread's tail is
/// held, and it is taut.
fn strung(place: &Isometry3<f64>, is_held: fn(&[f64; 3]) -> bool) -> Bench {
    strung_beside(place, is_held, None, (ELASTIC, TAIL))
}

/// The same with another needle in place of the bar, if there is one.
fn strung_beside(
    place: &Isometry3<f64>,
    is_held: fn(&[f64; 3]) -> bool,
    other: Option<Needle>,
    (through, tail): (Through, [f64; 3]),
) -> Bench {
    let (mesh, fixed) = thick(is_held);
    let moved = |at: &[f64; 3]| (place * nalgebra::Point3::from(*at)).coords.into();
    let points = mesh.points_m().iter().map(moved).collect();
    let mesh = TetMesh::new(points, mesh.cells().to_vec()).expect("the same slab");
    let start = frame([0.0013, 0.0007, 0.042], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let away = place * Isometry3::translation(-0.03, 0.05, -0.03);
    let mut needles = vec![(straight(0.04), place * start)];
    needles.extend(other.map(|other| (other, away)));
    let by_cell = vec![smooth(); mesh.cells().len()];
    let mut bench = Bench::built(
        (mesh, fixed),
        Kind::Linear,
        (&needles, other.is_some()),
        (MATERIAL, Loads::default()),
        &by_cell,
        NeedleSettings::default(),
    );
    let bars = [BarPart { tool: 1, bar: BAR }];
    let with = other.map_or(ThreadBody::Grip(1), |_| ThreadBody::Needle(1));
    let contacts = [ThreadContact { thread: 7, with }];
    let model = bench
        .model
        .with_threads(&[part(through)])
        .expect("a thread");
    let bars = &bars[usize::from(other.is_some())..];
    let model = model.with_bars(&bench.mesh, bars).expect("a bar");
    bench.model = model.with_thread_contacts(&contacts).expect("a pair");
    bench.state = State::new(&bench.model);
    bench.work = Workspace::new(&bench.model);
    bench.work.prepare(&bench.model, |_| true);
    bench.other = away;
    assert!(bench.hold(0, Some(0)));
    assert!(other.is_none() || bench.hold(1, Some(1)));
    let down = place.rotation * Vector3::new(0.0, 0.0, -0.08);
    go(&mut bench, down);
    let tail = place * nalgebra::Point3::from(tail);
    hold(
        &mut bench,
        ThreadEnd::Tail,
        ThreadHold::Place(tail.coords.into()),
    );
    bench
}

/// Brings the bar to a pose in steps of 0.5 mm.
fn bring(bench: &mut Bench, to: &Isometry3<f64>) -> StepReport {
    let from = bench.other;
    let way = to.translation.vector - from.translation.vector;
    let steps = (way.norm() / 5e-4).ceil().max(1.0) as usize;
    let mut report = StepReport::default();
    for step in 1..=steps {
        let part = step as f64 / steps as f64;
        bench.other = from.lerp_slerp(to, part);
        report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
    }
    report
}

fn of_bar(report: &StepReport) -> (Vector3<f64>, Vector3<f64>) {
    let [x, y, z, a, b, c] = report.contacts()[1].wrench;
    (Vector3::new(x, y, z), Vector3::new(a, b, c))
}

/// A turn of the bar, which lies along its z, so that it lies along `axis`.
fn lying(axis: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), &axis).expect("a turn")
}

/// Ways to lift the span, across it, and how the bar lies then, across both.
fn lifts() -> [(Vector3<f64>, Vector3<f64>); 4] {
    let chord = Vector3::new(0.0013, 0.0007, 0.0) - Vector3::from(TAIL);
    let ways = [
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.6, 0.8],
    ];
    ways.map(|up| {
        let axis = chord.cross(&Vector3::from(up)).normalize();
        (axis.cross(&chord).normalize(), axis)
    })
}

/// The bar beside the span, at its middle, and then lifted by so much \[m\]: how the span's middle went.
fn lifted(
    bench: &mut Bench,
    place: &Isometry3<f64>,
    (up, axis): (Vector3<f64>, Vector3<f64>),
    by_m: f64,
) -> StepReport {
    let middle = (Vector3::from(TAIL) + Vector3::new(0.0013, 0.0007, 0.0)) / 2.0;
    let beside = middle - up * (RADIUS_M + 5e-4);
    let turn = lying(axis);
    // Round below the span, not through it.
    let far = beside - up * 0.03;
    for low in [
        Vector3::new(-0.03, 0.05, -0.08),
        Vector3::new(far.x, far.y, -0.08),
    ] {
        bring(bench, &(place * Isometry3::from_parts(low.into(), turn)));
    }
    let far = Isometry3::from_parts(far.into(), turn);
    let near = Isometry3::from_parts(beside.into(), turn);
    bring(bench, &(place * far));
    let report = bring(bench, &(place * near));
    assert_eq!(
        (report.threads()[0].laps, of_bar(&report).0),
        (0, Vector3::zeros())
    );
    let to = Isometry3::from_parts((middle + up * (by_m - RADIUS_M)).into(), turn);
    bring(bench, &(place * to))
}

/// From the tail to where the thread comes to the bar, and from there to the tissue, by the path's first points: unit vectors.
fn directions(bench: &Bench) -> [Vector3<f64>; 2] {
    let path = bench.path(7);
    let at = |place: usize| Vector3::from(path[place].at_m);
    let face = path.iter().position(|p| p.what == ThreadPlace::Enters);
    let face = face.expect("a puncture");
    assert!(face > 2 && path[1..face].iter().all(|p| p.what == ThreadPlace::Wraps));
    [at(1) - at(0), at(face) - at(face - 1)].map(|way| way.normalize())
}

/// Lifted by x in its middle by a round bar, a span pulls that back with 2 T sin of the angle that circle and tangents have, whatever
/// the direction.
#[test]
fn a_bar_that_lifts_a_span_feels_its_tension_times_its_turn() {
    let place = Isometry3::identity();
    for way in lifts() {
        for by_m in [1e-3, 4e-3, 8e-3] {
            let mut bench = strung(&place, still);
            let report = lifted(&mut bench, &place, way, by_m);
            let (force, moment) = of_bar(&report);
            let thread = report.threads()[0];
            let tension = thread.tension_n[0];
            // Half of the span, to the circle's centre, which is by its radius lower than the thread there.
            let path = bench.path(7);
            let face = path.iter().find(|p| p.what == ThreadPlace::Enters);
            let face = Vector3::from(face.expect("a puncture").at_m);
            let half_m = 0.5 * (face - Vector3::from(TAIL)).norm();
            let high_m = by_m - RADIUS_M;
            let angle = (high_m / half_m).atan() + (RADIUS_M / half_m.hypot(high_m)).asin();
            let expected = 2.0 * tension * angle.sin();
            println!(
                "{by_m}: {} N of {expected}, T {tension}, {} solves",
                force.norm(),
                report.solves
            );
            assert!(tension > 0.01 && thread.laps == 1, "{thread:?}");
            assert!(
                (force.norm() / expected - 1.0).abs() < 0.01,
                "{force} {expected}"
            );
            assert!(force.dot(&way.0) < -0.999 * force.norm(), "{force}");
            // The bar's axis goes through the grip.
            assert!(moment.norm() < 1e-4 * force.norm(), "{moment}");
            // Both straight pieces pull, by the path that pictures show.
            let [from, to] = directions(&bench);
            assert!((force - (to - from) * tension).norm() < 1e-6 * tension);
            // As long as there is thread, around the bar.
            let stretched = thread.available_m * (1.0 + tension / EA_N);
            assert!((thread.length_m - stretched).abs() < 1e-6, "{thread:?}");
            for point in path.iter().filter(|p| p.what == ThreadPlace::Wraps) {
                let off = bench.other.inverse() * nalgebra::Point3::from(point.at_m);
                assert!((off.x.hypot(off.y) - RADIUS_M).abs() < 1e-9);
            }
        }
    }
}

/// A bar that lies aslant is pushed across itself, not along, and turned about no own axis.
#[test]
fn a_slanting_bar_feels_no_force_along_itself() {
    let place = Isometry3::identity();
    for axis in [Vector3::new(0.5, 1.0, 0.0), Vector3::new(-0.3, 1.0, 0.5)] {
        let axis = axis.normalize();
        let up = (Vector3::z() - axis * axis.z).normalize();
        let mut bench = strung(&place, still);
        let report = lifted(&mut bench, &place, (up, axis), 5e-3);
        let (force, moment) = of_bar(&report);
        let tension = report.threads()[0].tension_n[0];
        assert!(force.norm() > 0.05 * tension && tension > 0.01);
        assert!(force.dot(&axis).abs() < 1e-6 * tension, "{force}");
        assert!(moment.dot(&axis).abs() < 1e-9 * tension, "{moment}");
        let [from, to] = directions(&bench);
        assert!((force - (to - from) * tension).norm() < 1e-5 * tension);
    }
}

/// The tangents of both hands are the derivatives of what they feel, on tissue that gives way, with bars that lie across and aslant.
#[test]
fn the_tangent_is_the_derivative() {
    let place = Isometry3::identity();
    for axis in [Vector3::y(), Vector3::new(0.5, 1.0, 0.2).normalize()] {
        let mut bench = strung(&place, beside);
        let up = (Vector3::z() - axis * axis.z).normalize();
        lifted(&mut bench, &place, (up, axis), 6e-3);
        bench.other.translation.vector += Vector3::new(1e-3, 3e-3, 0.0);
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        let report = bench.step_both();
        assert!(report.threads()[0].laps == 1 && of_bar(&report).0.norm() > 0.01);
        tangents_are_true(&mut bench, &report);
    }
}

/// What bar, needle and tail pull with is what holds the tissue.
#[test]
fn all_forces_are_in_balance() {
    let place = Isometry3::identity();
    let mut bench = strung(&place, beside);
    let report = lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 6e-3);
    let felt: Vector3<f64> = report
        .contacts()
        .iter()
        .map(|contact| Vector3::from_column_slice(&contact.wrench[..3]))
        .sum();
    let thread = report.threads()[0];
    let tail = Vector3::from(thread.direction[0]) * thread.tension_n[0];
    let whole = bench.model.equilibrium(&bench.state).expect("a balance");
    let points = bench.mesh.points_m().iter().zip(&whole.node_force_n);
    let held: Vector3<f64> = points
        .filter(|(at, _)| beside(at))
        .map(|(_, force)| Vector3::from(*force))
        .sum();
    let off = felt + tail - held;
    assert!(thread.tension_n[0] > 0.01 && thread.laps == 1);
    assert!(off.norm() < 1e-6 * thread.tension_n[0], "{off}");
}

/// A scene that is turned and shifted has the same forces, turned.
#[test]
fn a_turned_scene_has_turned_forces() {
    let lift = |place: &Isometry3<f64>| {
        let mut bench = strung(place, beside);
        let report = lifted(&mut bench, place, (Vector3::z(), Vector3::y()), 5e-3);
        let (force, moment) = of_bar(&report);
        [force, moment].map(|vector| place.inverse_transform_vector(&vector))
    };
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -1.1, 0.4));
    let turned = Isometry3::from_parts(Vector3::new(0.1, -0.2, 0.05).into(), turn);
    let [one, other] = [Isometry3::identity(), turned].map(|place| lift(&place));
    assert!(one[0].norm() > 0.01);
    for (one, other) in one.iter().zip(&other) {
        assert!(
            (one - other).norm() < 1e-7 * one.norm().max(1e-3),
            "{one} {other}"
        );
    }
}

/// The hand's work, lifting and lowering, is in tissue and thread, and comes back; what is missing falls with the step.
#[test]
fn the_work_of_a_bar_is_stored() {
    let missing = [4e-4f64, 1e-4].map(|step_m| {
        let place = Isometry3::identity();
        let mut bench = strung(&place, beside);
        let report = lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 1e-3);
        let stored = |bench: &Bench, report: &StepReport| {
            report.stored_energy_j + super::pull::stretched(bench, EA_N).1
        };
        let (mut before, start_j) = (of_bar(&report).0.z, stored(&bench, &report));
        let (mut work_j, mut peak_j, mut worst_j) = (0.0, 0.0f64, 0.0f64);
        let steps = (6e-3 / step_m).round() as usize;
        for k in 0..2 * steps {
            let way = if k < steps { step_m } else { -step_m };
            bench.other.translation.vector.z += way;
            let report = bench.step_both();
            assert_eq!(report.status.name(), "ok");
            let now = of_bar(&report).0.z;
            work_j -= 0.5 * (before + now) * way;
            before = now;
            let stored_j = stored(&bench, &report) - start_j;
            peak_j = peak_j.max(stored_j);
            worst_j = worst_j.max((work_j - stored_j).abs());
        }
        println!("{step_m}: {worst_j} of {peak_j} J");
        worst_j / peak_j
    });
    assert!(
        missing[1] < 0.01 && missing[1] < 0.6 * missing[0] + 1e-4,
        "{missing:?}"
    );
}

/// A bar that is drawn out from under the span along itself holds it up to its end, and no further; then it may come back beside it.
#[test]
fn a_span_slides_off_the_end_of_a_bar() {
    let place = Isometry3::identity();
    let mut bench = strung(&place, still);
    let report = lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 5e-3);
    let before = of_bar(&report).0.norm();
    let mut on = 0;
    for step in 0..80 {
        bench.other.translation.vector.y += 2.5e-4;
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        let force = of_bar(&report).0.norm();
        let is_on = report.threads()[0].laps == 1;
        on += u32::from(is_on);
        // Half of its length is on the other side of the middle.
        assert!(is_on || step > 57, "{step}");
        assert!(!is_on || step < 62, "{step}");
        let expected = if is_on { before } else { 0.0 };
        assert!((force - expected).abs() < 0.02 * before, "{step}: {force}");
    }
    assert!(on > 50);
}

/// What is not named goes through each other.
#[test]
fn a_bar_that_no_thread_is_to_lie_on_feels_none() {
    let place = Isometry3::identity();
    let mut bench = strung(&place, still);
    bench.model = bench.model.with_threads(&[part(ELASTIC)]).expect("threads");
    let report = lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 5e-3);
    assert_eq!(
        (report.threads()[0].laps, of_bar(&report).0),
        (0, Vector3::zeros())
    );
}

/// A bar that comes to be where a span is without a way there lies across it, and is felt once it has been beside it.
#[test]
fn a_bar_that_is_put_into_a_span_waits() {
    let place = Isometry3::identity();
    let mut bench = strung(&place, still);
    // Not yet half of it is above the span.
    lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 1.5e-3);
    let sample = bench.sample_of(1);
    bench.state.put(&sample);
    let report = bench.step_both();
    assert_eq!(
        (report.threads()[0].laps, of_bar(&report).0),
        (0, Vector3::zeros())
    );
    let mut to = bench.other;
    to.translation.vector.z -= 0.012;
    bring(&mut bench, &to);
    to.translation.vector.z += 0.0155;
    let report = bring(&mut bench, &to);
    assert!(report.threads()[0].laps == 1 && of_bar(&report).0.z < -0.01);
}

/// A hand that takes the span beside the bar leaves it on the bar, and it is so still once that lets go.
#[test]
fn a_hand_takes_a_span_that_lies_on_a_bar() {
    let place = Isometry3::identity();
    let mut bench = strung(&place, still);
    let report = lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 5e-3);
    let (before, path) = (of_bar(&report).0, bench.path(7));
    let [from, to] = [0, 1].map(|place| Vector3::from(path[place].at_m));
    let at = ((from + to) / 2.0).into();
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Place(at));
    let report = bench.step_both();
    let force = of_bar(&report).0;
    assert_eq!((report.status.name(), report.hands().len()), ("ok", 1));
    assert!(
        (force - before).norm() < 0.01 * before.norm(),
        "{force} {before}"
    );
    hold(&mut bench, ThreadEnd::Span, ThreadHold::Free);
    let report = bench.step_both();
    let force = of_bar(&report).0;
    assert_eq!((report.status.name(), report.threads()[0].laps), ("ok", 1));
    assert!(
        (force - before).norm() < 0.01 * before.norm(),
        "{force} {before}"
    );
}

/// The same steps have the same bits, and steps with a span on a bar allocate nothing.
#[test]
fn steps_are_the_same_twice_and_allocate_nothing() {
    let walk = |bench: &mut Bench| {
        for step in 0..60u32 {
            let part = f64::from(step) / 60.0;
            bench.other.translation.vector += Vector3::new(1e-5, 2e-5, 3e-4 * (6.3 * part).cos());
            bench.step_both();
        }
    };
    let begin = || {
        let place = Isometry3::identity();
        let mut bench = strung(&place, beside);
        lifted(&mut bench, &place, (Vector3::z(), Vector3::y()), 2e-3);
        bench
    };
    let mut first = begin();
    let allocated = allocation_counter::measure(|| walk(&mut first));
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
    let mut second = begin();
    walk(&mut second);
    assert_eq!(first.state.hash(), second.state.hash());
    assert!(first.step_both().threads()[0].laps == 1);
}

/// A span that a needle's shaft has lifted by so much, to its middle, 18 mm from its end.
fn lifted_by(bench: &mut Bench, needle: &Needle, axis: Vector3<f64>, by_m: f64) -> StepReport {
    let radius_m = 0.5 * (THICKNESS_M + INEXTENSIBLE.thickness_m);
    let middle = (Vector3::from(TAIL) + Vector3::new(0.0013, 0.0007, 0.0)) / 2.0;
    let up = (Vector3::z() - axis * axis.z).normalize();
    // Arcs bend upwards.
    let turned = frame([0.0; 3], axis.into(), up.into()).rotation;
    let own = needle.at(&Isometry3::identity());
    let turn = turned
        * UnitQuaternion::rotation_between(&own.tangent_at(0.018), &Vector3::x()).expect("a turn");
    let pose = |at: Vector3<f64>| Isometry3::from_parts((at - turn * own.at(0.018)).into(), turn);
    let near = middle - up * (radius_m + 5e-4);
    for at in [
        Vector3::new(-0.03, 0.05, -0.08),
        Vector3::new(near.x, near.y, -0.08),
        near - up * 0.01,
    ] {
        bring(bench, &pose(at));
    }
    let report = bring(bench, &pose(near));
    assert_eq!(
        (report.threads()[0].laps, of_bar(&report).0),
        (0, Vector3::zeros())
    );
    bring(bench, &pose(middle + up * (by_m - radius_m)))
}

/// A straight needle and an arc lift a span as a bar does; neither is pulled along itself where the span lies.
#[test]
fn a_needle_lifts_a_span() {
    for needle in [straight(0.04), arc(0.012, 170.0)] {
        for axis in [Vector3::y(), Vector3::new(0.3, 1.0, 0.1).normalize()] {
            let place = Isometry3::identity();
            let mut bench = strung_beside(&place, beside, Some(needle), (ELASTIC, TAIL));
            lifted_by(&mut bench, &needle, axis, 5e-3);
            // It slides to where it rests.
            let mut report = bench.step_both();
            for _ in 0..24 {
                report = bench.step_both();
                assert_eq!(report.status.name(), "ok");
            }
            let (force, thread) = (of_bar(&report).0, report.threads()[0]);
            let tension = thread.tension_n[0];
            let [from, to] = directions(&bench);
            assert!(thread.laps == 1 && tension > 0.01, "{thread:?}");
            assert!((force - (to - from) * tension).norm() < 1e-5 * tension);
            let curve = needle.at(&bench.other);
            let path = bench.path(7);
            let on: Vec<_> = path
                .iter()
                .filter(|p| p.what == ThreadPlace::Wraps)
                .collect();
            let middle = Vector3::from(on[on.len() / 2].at_m);
            let along = curve.tangent_at(curve.project(&middle, 0.018));
            println!("{needle:?}: {force} {}", force.dot(&along));
            assert!(force.dot(&along).abs() < 1e-3 * force.norm(), "{force}");
            let stretched = thread.available_m * (1.0 + tension / EA_N);
            assert!((thread.length_m - stretched).abs() < 1e-6, "{thread:?}");
        }
    }
}

/// The tangents of both hands are the derivatives, of an arc as it lies.
#[test]
fn the_tangent_of_a_needle_is_the_derivative() {
    for needle in [straight(0.04), arc(0.012, 170.0)] {
        let place = Isometry3::identity();
        let mut bench = strung_beside(&place, beside, Some(needle), (ELASTIC, TAIL));
        let axis = Vector3::new(0.3, 1.0, 0.1).normalize();
        lifted_by(&mut bench, &needle, axis, 5e-3);
        // Where it lies on an arc follows from step to step, until it rests.
        for _ in 0..24 {
            bench.step_both();
        }
        let report = bench.step_both();
        assert!(report.threads()[0].laps == 1 && of_bar(&report).0.norm() > 0.01);
        tangents_are_true(&mut bench, &report);
    }
}

/// A needle that nobody holds is no obstacle, and its own thread's end at it does not lie on it.
#[test]
fn a_needle_that_is_let_go_lets_the_span_through() {
    let (needle, place) = (straight(0.04), Isometry3::identity());
    let mut bench = strung_beside(&place, still, Some(needle), (ELASTIC, TAIL));
    lifted_by(&mut bench, &needle, Vector3::y(), 5e-3);
    assert!(bench.hold(1, None));
    let report = bench.step_both();
    assert_eq!((report.status.name(), report.threads()[0].laps), ("ok", 0));
}

/// A span over the slab's rim is lifted off it by a bar beside that, and laid down again: bends over tissue go and come, and what the bar
/// feels is the tension times the turn there.
#[test]
fn a_span_is_lifted_off_a_rim() {
    let place = Isometry3::identity();
    let through = Through {
        body: true,
        ..ELASTIC
    };
    let tail = [-0.045, 0.0007, -0.006];
    let mut bench = strung_beside(&place, still, None, (through, tail));
    let turn = lying(Vector3::y());
    for at in [
        [-0.03, 0.05, -0.08],
        [-0.03, 0.0007, -0.08],
        [-0.03, 0.0007, -0.012],
    ] {
        let at = Vector3::from(at);
        bring(&mut bench, &Isometry3::from_parts(at.into(), turn));
    }
    let report = bench.step_both();
    assert!(report.threads()[0].wraps > 0 && report.threads()[0].laps == 0);
    let mut lain = [0u32; 2];
    for step in 0..56 {
        let way = if step < 28 { 5e-4 } else { -5e-4 };
        bench.other.translation.vector.z += way;
        let report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
        let (force, thread) = (of_bar(&report).0, report.threads()[0]);
        if thread.laps == 0 {
            assert_eq!(force, Vector3::zeros());
            continue;
        }
        lain[usize::from(thread.wraps > 0)] += 1;
        let path = bench.path(7);
        let at = |place: usize| Vector3::from(path[place].at_m);
        let is_on = |place: &usize| {
            let off = bench.other.inverse() * nalgebra::Point3::from(path[*place].at_m);
            (off.x.hypot(off.y) - RADIUS_M).abs() < 1e-6
        };
        let on: Vec<_> = (0..path.len()).filter(is_on).collect();
        let (first, last) = (on[0], on[on.len() - 1]);
        let from = (at(first) - at(first - 1)).normalize();
        let to = (at(last + 1) - at(last)).normalize();
        let tension = thread.tension_n[0];
        let off = force - (to - from) * tension;
        assert!(
            off.norm() <= 1e-3 * tension.max(1e-3),
            "{step}: {force} {off}"
        );
        let stretched = thread.available_m * (1.0 + tension / EA_N);
        assert!(
            tension < 1e-6 || (thread.length_m - stretched).abs() < 1e-6,
            "{thread:?}"
        );
    }
    println!("{lain:?}");
    assert!(lain.iter().all(|steps| *steps > 4), "{lain:?}");
    let report = bench.step_both();
    assert!(report.threads()[0].wraps > 0 && report.threads()[0].laps == 0);
}

/// A scene's session: a scripted hand draws a needle through a slab, the tail is held, and the console's grip lifts the span that it is named
/// with; twice to the same bits.
#[test]
fn a_console_lifts_a_span_of_a_scene() {
    let text = r#"
        device = "cartesian-bench"
        [mesh.slab]
        size_m = [0.03, 0.03, 0.02]
        divisions = [7, 7, 5]
        [tissue]
        youngs_modulus_pa = 50e3
        poisson_ratio = 0.4
        needle = { friction_n_per_m = 0.0, puncture_pa = 1e5 }
        [[fixed]]
        plane = { axis = "x", at_m = 0.015 }
        [[tool]]
        shape = "grip"
        body = { radius_m = 0.002, length_m = 0.03, axis = [0.0, 1.0, 0.0] }
        [[tool]]
        id = 1
        shape = "grip"
        [[tool.way_point]]
        time_s = 0.0
        position_m = [0.0013, 0.0007, 0.045]
        [[tool.way_point]]
        time_s = 1.0
        position_m = [0.0013, 0.0007, -0.04]
        [[needle]]
        shape = "straight"
        length_m = 0.04
        thickness_m = 0.0008
        end_m = [0.0013, 0.0007, 0.045]
        direction = [0.0, 0.0, -1.0]
        [[needle.hold]]
        time_s = 0.0
        tool = 1
        [[thread]]
        needle = 0
        length_m = 0.3
        axial_stiffness_n = 200.0
        [[thread.hold]]
        time_s = 1.2
        end = "tail"
        at_m = [-0.06, 0.0007, 0.004]
        [[body_contact]]
        between = [{ tool = 0 }, { thread = 0 }]
    "#;
    let run = |text: &str| {
        let document = Document::embedded("test.toml", "".as_ref(), text);
        let scene = Scene::read(&document, "test").expect("good");
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let mut felt = Vec::new();
        for tick in 0..220u32 {
            // Below the span, and from 1.3 s on up through it, as the middle of the bar is 15 mm behind the grip.
            let high_m = (f64::from(tick) - 130.0).max(0.0) * 4e-4;
            let sample = ToolSample {
                id: 0,
                position_m: [-0.03, 0.0157, -0.028 + high_m],
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: [0.0; 3],
                console_time_us: 10_000 * u64::from(tick),
            };
            let report = solver.step(sample);
            let mut contacts = report.contacts().iter();
            let own = contacts.find(|contact| contact.id == 0);
            felt.extend(own.map(|own| (report.threads()[0], own.wrench)));
        }
        felt
    };
    let felt = run(text);
    let (thread, wrench) = felt[felt.len() - 1];
    let force = Vector3::new(wrench[0], wrench[1], wrench[2]);
    println!("{force} {thread:?}");
    assert!(thread.laps == 1 && thread.tension_n[0] > 0.1, "{thread:?}");
    assert!(force.z < -0.1 * thread.tension_n[0], "{force}");
    assert_eq!(felt, run(text));
    // Without the section there is nothing to feel.
    let (without, _) = text.split_once("[[body_contact]]").expect("a section");
    let (thread, wrench) = run(without).pop().expect("a step");
    assert_eq!((thread.laps, wrench), (0, [0.0; 6]));
}
