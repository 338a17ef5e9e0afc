//! Needles that fall where nobody holds them.

use super::bench::*;
use super::bodies::{a_slab, overlap_of, rubbing};
use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::TetMesh;
use sutura_host::model::Passes;
use sutura_host::needle::{Needle, NeedlePart, NeedleSettings, NeedleWeight};
use sutura_host::step::Status;
use sutura_host::thread::{ThreadEnd, ThreadHold};

const STEP_S: f64 = 5e-3;
const STEEL_KG_PER_M3: f64 = 7900.0;
const GRAVITY_M_PER_S2: f64 = 9.81;
const LENGTH_M: f64 = 0.016;

fn mass_kg() -> f64 {
    STEEL_KG_PER_M3 * straight(LENGTH_M).tip_area_m2() * LENGTH_M
}

/// Over the slab, all of it turned by `turn`, a needle of steel that nobody holds.
fn let_go(needle: Needle, start: &Isometry3<f64>, turn: &UnitQuaternion<f64>) -> (Bench, Vec<u32>) {
    let_go_over(Kind::Linear, needle, start, turn)
}

/// The same over such tissue.
fn let_go_over(
    kind: Kind,
    needle: Needle,
    start: &Isometry3<f64>,
    turn: &UnitQuaternion<f64>,
) -> (Bench, Vec<u32>) {
    let (mesh, fixed) = a_slab();
    let points = mesh.points_m().iter();
    let points = points.map(|at| (turn * Vector3::from(*at)).into());
    let mesh = TetMesh::new(points.collect(), mesh.cells().to_vec()).expect("the same slab");
    let down = turn * Vector3::new(0.0, 0.0, -GRAVITY_M_PER_S2);
    let weight = NeedleWeight {
        density_kg_per_m3: STEEL_KG_PER_M3,
        gravity_m_per_s2: down.into(),
    };
    let part = NeedlePart {
        id: 0,
        needle,
        start: turn * start,
        body: true,
        weight: Some(weight),
    };
    let tissue = vec![rubbing(0.3); mesh.cells().len()];
    let mut bench = Bench::of_parts(
        (mesh, fixed.clone()),
        kind,
        &[part],
        (MATERIAL, Loads::default()),
        &tissue,
        NeedleSettings::default(),
    );
    bench.hold(0, None);
    (bench, fixed)
}

fn pose(bench: &Bench) -> Isometry3<f64> {
    bench.state.needle_pose(&bench.model, 0).expect("a needle")
}

fn fall(bench: &mut Bench, steps: u32) {
    for step in 0..steps {
        let report = bench.step();
        assert_eq!(report.status, Status::Ok, "{step}");
        bench.look(&report);
    }
}

/// Force of what lies on the slab, by what its fixed nodes carry \[N\].
fn force_n(bench: &Bench, fixed: &[u32]) -> Vector3<f64> {
    let whole = bench.model.equilibrium(&bench.state).expect("a balance");
    let carried = fixed.iter().map(|node| whole.node_force_n[*node as usize]);
    -carried.map(Vector3::from).sum::<Vector3<f64>>()
}

/// High above, tilted.
fn high() -> Isometry3<f64> {
    frame([-0.006, 0.001, 0.05], [1.0, 0.1, 0.2], [0.0, 0.0, 1.0])
}

/// 3 mm above the surface, tilted.
fn low() -> Isometry3<f64> {
    frame([-0.0071, 0.0013, 0.003], [1.0, 0.13, 0.15], [0.0, 0.0, 1.0])
}

/// Implicit Euler's fall of n steps of h from rest is g h^2 n (n + 1) / 2, in which it does not turn.
#[test]
fn in_the_air_it_falls_as_all_does() {
    for turn in [
        UnitQuaternion::identity(),
        UnitQuaternion::from_euler_angles(0.7, -0.4, 1.9),
    ] {
        let (mut bench, fixed) = let_go(straight(LENGTH_M), &high(), &turn);
        let start = pose(&bench);
        let steps = 10;
        fall(&mut bench, steps);
        let fell = start.translation.vector - pose(&bench).translation.vector;
        let n = f64::from(steps);
        let way_m = GRAVITY_M_PER_S2 * STEP_S * STEP_S * 0.5 * n * (n + 1.0);
        let down = turn * Vector3::z();
        assert!((fell - down * way_m).norm() < 1e-12, "{fell} {way_m}");
        assert!(pose(&bench).rotation.angle_to(&start.rotation) < 1e-12);
        assert_eq!(force_n(&bench, &fixed).norm(), 0.0);
    }
}

/// Straight or bent it comes to rest on the surface, which carries its weight.
#[test]
fn on_tissue_it_comes_to_rest_with_its_weight() {
    let corotational = || Kind::Corotational(Passes::default());
    for (kind, needle) in [
        (Kind::Linear, straight(LENGTH_M)),
        (Kind::Linear, arc(0.008, 115.0)),
        (corotational(), straight(LENGTH_M)),
    ] {
        let (mut bench, fixed) = let_go_over(kind, needle, &low(), &UnitQuaternion::identity());
        fall(&mut bench, 400);
        let before = pose(&bench);
        fall(&mut bench, 1);
        let after = pose(&bench);
        let moved_m = (after.translation.vector - before.translation.vector).norm();
        let turned = after.rotation.angle_to(&before.rotation);
        println!("{moved_m:e} m, {turned:e} in the last step");
        let weight_n = mass_kg() * GRAVITY_M_PER_S2 * needle.shape.length_m() / LENGTH_M;
        let force = force_n(&bench, &fixed);
        println!("{force} of {weight_n} N");
        assert!(moved_m < 1e-8 && turned < 1e-6, "{moved_m} {turned}");
        let weight = Vector3::new(0.0, 0.0, -weight_n);
        assert!(
            (force - weight).norm() < 1e-3 * weight_n,
            "{force} {weight_n}"
        );
        let nodes = bench.state.positions(&bench.model);
        let curve = needle.at(&after);
        let places = (0..=500).map(|place| curve.at(curve.length * f64::from(place) / 500.0));
        let deep_m = overlap_of(&bench.mesh, &nodes, places, 0.5 * THICKNESS_M);
        println!("{deep_m:e} m deep");
        assert!(deep_m < 1e-3 * 3.3e-3, "{deep_m}");
    }
}

/// However long a step is, it lands, with a few solves in each piece of its way, and lies where it is at rest.
#[test]
fn at_any_rate_it_lands() {
    let needle = arc(0.0095, 170.0);
    let start = frame([-0.0093, 0.0013, 0.02], [0.05, 0.2, -1.0], [1.0, 0.1, 0.2]);
    for step_us in [2000, 8000, 16_000, 50_000] {
        let (mut bench, _) = let_go(needle, &start, &UnitQuaternion::identity());
        let (mut most, mut deepest_m) = (0, 0.0f64);
        let mut step = |bench: &mut Bench| {
            bench.time_us += step_us;
            let (before, sample) = (pose(bench), bench.sample());
            let report = bench.follow(&[sample]);
            assert!(
                report.status.has_balance(),
                "{step_us}: {:?}",
                report.status
            );
            bench.look(&report);
            most = most.max(report.solves);
            let after = pose(bench);
            let nodes = bench.state.positions(&bench.model);
            let curve = needle.at(&after);
            let shaft_m = curve.length - 3.4e-3;
            let places = (0..=200).map(|place| curve.at(shaft_m * f64::from(place) / 200.0));
            deepest_m = deepest_m.max(overlap_of(&bench.mesh, &nodes, places, 0.5 * THICKNESS_M));
            (after.translation.vector - before.translation.vector).norm()
        };
        let steps = (2_000_000 / step_us).max(250);
        let last_m = (0..steps).map(|_| step(&mut bench)).last().expect("some");
        println!("{step_us} us: {most} solves, {deepest_m:e} m deep, {last_m:e} m at last");
        // A fiftieth of an edge while it lands.
        assert!(
            most <= 100 && deepest_m < 0.02 * 3.3e-3,
            "{most} {deepest_m}"
        );
        assert!(last_m < 1e-6, "{last_m}");
    }
}

/// Turned with its gravity all is the same.
#[test]
fn a_turned_fall_is_the_same() {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(0.3, 1.1, -2.0));
    let [straight_down, turned] = [UnitQuaternion::identity(), turn].map(|turn| {
        let (mut bench, _) = let_go(straight(LENGTH_M), &low(), &turn);
        fall(&mut bench, 60);
        pose(&bench)
    });
    let back = turn.inverse() * turned;
    let apart = (back.translation.vector - straight_down.translation.vector).norm();
    let turned = back.rotation.angle_to(&straight_down.rotation);
    assert!(apart < 1e-9 && turned < 1e-7, "{apart} m, {turned}");
}

/// In a hole that rubs it stays, and the tissue carries it.
#[test]
fn in_tissue_it_hangs() {
    let start = frame([0.0013, 0.0007, 0.018], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let (mut bench, fixed) = let_go(straight(LENGTH_M), &start, &UnitQuaternion::identity());
    bench.grip = pose(&bench);
    assert!(bench.hold(0, Some(0)));
    for _ in 0..120 {
        bench.grip.translation.vector.z -= 5e-5;
        assert_eq!(bench.step().status, Status::Ok);
    }
    bench.hold(0, None);
    fall(&mut bench, 200);
    let before = pose(&bench);
    fall(&mut bench, 1);
    let moved_m = (pose(&bench).translation.vector - before.translation.vector).norm();
    let weight_n = mass_kg() * GRAVITY_M_PER_S2;
    let force = force_n(&bench, &fixed);
    println!("{moved_m:e} m in the last step, {force} of {weight_n} N");
    assert!(moved_m < 1e-7, "{moved_m}");
    assert!(
        (force.z + weight_n).abs() < 0.01 * weight_n,
        "{force} {weight_n}"
    );
}

/// Without new columns no step of a fall, or of what lies, allocates; a hand takes it up again.
#[test]
fn nothing_is_allocated_and_it_is_taken_up_again() {
    let (mut bench, _) = let_go(straight(LENGTH_M), &low(), &UnitQuaternion::identity());
    let allocated = allocation_counter::measure(|| {
        for _ in 0..130 {
            bench.step();
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
    bench.grip = pose(&bench);
    assert!(bench.hold(0, Some(0)));
    bench.grip.translation.vector.z += 0.01;
    for _ in 0..3 {
        bench.step();
    }
    let held = pose(&bench);
    assert_eq!(held.translation.vector, bench.grip.translation.vector);
    fall_from_there(&mut bench);
}

/// A needle on a thread that is held falls as far as that is long, swings and comes to hang below.
#[test]
fn on_its_thread_it_hangs() {
    let length_m = 0.03;
    let (bench, _) = let_go(straight(LENGTH_M), &high(), &UnitQuaternion::identity());
    let mut bench = bench.with_thread(length_m);
    bench.hold(0, None);
    let end = |bench: &Bench| pose(bench).translation.vector;
    let at = end(&bench) + Vector3::new(0.012, 0.009, 0.015);
    let by = ThreadHold::Place(at.into());
    assert!(
        bench
            .state
            .hold_thread(&bench.model, THREAD, ThreadEnd::Tail, by, &[])
    );
    let mut lowest: f64 = 0.0;
    for _ in 0..2000 {
        fall(&mut bench, 1);
        let way = end(&bench) - at;
        assert!(way.norm() < length_m + 1e-6, "{}", way.norm());
        lowest = lowest.min(way.z);
    }
    let way = end(&bench) - at;
    println!("hangs {way} m, {lowest} m at its lowest");
    assert!((way.z + length_m).abs() < 1e-3, "{way}");
    let tip = pose(&bench) * nalgebra::Point3::new(LENGTH_M, 0.0, 0.0);
    assert!(tip.z < at.z - length_m - 0.9 * LENGTH_M, "{tip}");
}

/// It falls from where it is let go, from rest.
fn fall_from_there(bench: &mut Bench) {
    let held = pose(bench);
    bench.hold(0, None);
    fall(bench, 1);
    let fell = held.translation.vector - pose(bench).translation.vector;
    let way_m = GRAVITY_M_PER_S2 * STEP_S * STEP_S;
    assert!((fell.z - way_m).abs() < 1e-12, "{fell}");
}
