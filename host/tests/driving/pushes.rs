//! Bars that push needles which nobody holds: hanging in tissue, lying on it, and in the air.

use super::bench::{Bench, Kind, MATERIAL, THICKNESS_M, arc, frame, straight};
use super::bodies::{a_slab, moved, rubbing};
use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::Loads;
use sutura_host::mesh::TetMesh;
use sutura_host::model::Passes;
use sutura_host::needle::{Needle, NeedlePart, NeedleSettings, NeedleTissue, NeedleWeight};
use sutura_host::rod::{Bar, BarPart, BodyContact};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::thread::ThreadBody;

const STIFF: f64 = 1000.0;
const BAR_M: f64 = 0.002;
const SUM_M: f64 = BAR_M + 0.5 * THICKNESS_M;
/// What draws the places to the middle of their rods makes of a distance at an end, a thousandth of the radii, times the stiffness.
const EVEN_N: f64 = 1e-3 * SUM_M * STIFF;
const STEEL_KG_PER_M3: f64 = 7900.0;
const GRAVITY_M_PER_S2: f64 = 9.81;

/// A scene of these tests, all of it turned.
struct Scene {
    kind: Kind,
    needle: Needle,
    start: Isometry3<f64>,
    /// Of the tissue along the needle \[N/m\].
    grips_n_per_m: f64,
    density_kg_per_m3: Option<f64>,
    turn: UnitQuaternion<f64>,
}

impl Scene {
    /// Above the slab a straight needle that points down into it, from 18 mm.
    fn upright() -> Self {
        Self {
            kind: Kind::Linear,
            needle: straight(0.024),
            start: frame([0.0013, 0.0007, 0.026], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]),
            grips_n_per_m: 50.0,
            density_kg_per_m3: None,
            turn: UnitQuaternion::identity(),
        }
    }

    /// It, held by tool 0, and tool 1 with a bar along z of its frame, far away.
    fn build(self) -> (Bench, Vec<u32>) {
        let (mesh, fixed) = a_slab();
        let points = mesh.points_m().iter();
        let points = points.map(|at| (self.turn * Vector3::from(*at)).into());
        let mesh = TetMesh::new(points.collect(), mesh.cells().to_vec()).expect("the same slab");
        let down = self.turn * Vector3::new(0.0, 0.0, -GRAVITY_M_PER_S2);
        let weight = self.density_kg_per_m3.map(|density| NeedleWeight {
            density_kg_per_m3: density,
            gravity_m_per_s2: down.into(),
        });
        let part = NeedlePart {
            id: 0,
            needle: self.needle,
            start: self.turn * self.start,
            body: true,
            weight,
        };
        let tissue = NeedleTissue {
            friction_n_per_m: self.grips_n_per_m,
            static_friction_n_per_m: self.grips_n_per_m,
            ..rubbing(0.3)
        };
        let tissue = vec![tissue; mesh.cells().len()];
        let mut bench = Bench::of_parts(
            (mesh, fixed.clone()),
            self.kind,
            &[part],
            (MATERIAL, Loads::default()),
            &tissue,
            NeedleSettings::default(),
        );
        let bar = BarPart {
            tool: 1,
            bar: Bar {
                offset_m: [0.0, 0.0, 0.02],
                axis: [0.0, 0.0, 1.0],
                radius_m: BAR_M,
                length_m: 0.04,
                friction: 0.0,
            },
        };
        let contact = BodyContact {
            between: [ThreadBody::Needle(0), ThreadBody::Grip(1)],
            stiffness_n_per_m: STIFF,
            // Between hands' bodies only.
            friction: 0.4,
        };
        let model = bench.model.with_bars(&bench.mesh, &[bar]).expect("bars");
        bench.model = model.with_body_contacts(&[contact]).expect("a pair");
        bench.state = State::new(&bench.model);
        bench.work = Workspace::new(&bench.model);
        bench.work.prepare(&bench.model, |_| true);
        assert!(bench.hold(0, Some(0)));
        bench.other = self.turn * Isometry3::translation(0.0, 0.0, 0.3);
        (bench, fixed)
    }
}

/// Both tools all the way.
fn both(bench: &mut Bench) -> StepReport {
    bench.time_us += 5000;
    for _ in 0..1000 {
        let samples = [bench.sample_of(0), bench.sample_of(1)];
        let report = bench.follow(&samples);
        bench.look(&report);
        if report.status == Status::Ok {
            return report;
        }
        assert!(matches!(report.status, Status::Behind | Status::Waiting));
    }
    panic!("no way there")
}

/// Moves the bar by so much in each of some steps.
fn push(bench: &mut Bench, by: Vector3<f64>, steps: u32) -> StepReport {
    let mut last = both(bench);
    for _ in 0..steps {
        bench.other.translation.vector += by;
        last = both(bench);
    }
    last
}

fn pose(bench: &Bench) -> Isometry3<f64> {
    bench.state.needle_pose(&bench.model, 0).expect("a needle")
}

fn felt(report: &StepReport) -> Vector3<f64> {
    let [x, y, z, ..] = report.contacts()[1].wrench;
    Vector3::new(x, y, z)
}

/// What acts on the slab, by what its fixed nodes carry \[N\].
fn on_slab_n(bench: &Bench, fixed: &[u32]) -> Vector3<f64> {
    let whole = bench.model.equilibrium(&bench.state).expect("a balance");
    let carried = fixed.iter().map(|node| whole.node_force_n[*node as usize]);
    -carried.map(Vector3::from).sum::<Vector3<f64>>()
}

/// How deep bar and needle are in each other, by the nearest of many points of the needle \[m\].
fn overlap_m(bench: &Bench, needle: &Needle) -> f64 {
    let along = bench.other.rotation * Vector3::z();
    let middle = bench.other.translation.vector;
    let curve = needle.at(&pose(bench));
    let far = |part: f64| {
        let way = curve.at(part * curve.length) - middle;
        (way - along * along.dot(&way).clamp(-0.02, 0.02)).norm()
    };
    let places = (0..=20_000).map(|place| far(f64::from(place) / 20_000.0));
    SUM_M - places.fold(f64::MAX, f64::min)
}

/// Largest difference of the bar's tangent from steps to poses nearby, over its largest entry, and that \[N/m\]: to the one side or the
/// other, as what has slipped goes on to one, and sticks to the other.
fn tangent_error(bench: &mut Bench) -> (f64, f64) {
    let before = bench.state.clone();
    bench.time_us += 5000;
    let at = |bench: &mut Bench, pose: Isometry3<f64>| {
        let mut state = before.clone();
        let there = std::mem::replace(&mut bench.other, pose);
        let samples = [bench.sample_of(0), bench.sample_of(1)];
        bench.other = there;
        let options = StepOptions::default();
        let report = step(
            &bench.model,
            &mut state,
            &samples,
            &options,
            &mut bench.work,
        );
        assert_eq!(report.status, Status::Ok);
        report.contacts()[1]
    };
    let here = bench.other;
    let felt = at(bench, here);
    let exact = Matrix6::from(felt.tangent).transpose();
    let mut worst = 0.0f64;
    for axis in 0..6 {
        let h = if axis < 3 { 1e-7 } else { 1e-5 };
        let [back, ahead] = [-h, h].map(|by| {
            let mut step = Vector6::zeros();
            step[axis] = by;
            let there = Vector6::from(at(bench, moved(&here, &step)).wrench);
            ((there - Vector6::from(felt.wrench)) / by - exact.column(axis)).amax()
        });
        worst = worst.max(back.min(ahead));
    }
    let largest = exact.amax();
    (worst / largest, largest)
}

/// 6 mm deep in the slab, let go, and the bar beside its shaft, 10 mm above the slab, along y but for a tilt.
fn stuck(scene: Scene) -> (Bench, Vec<u32>) {
    let turn = scene.turn;
    let (mut bench, fixed) = scene.build();
    both(&mut bench);
    for _ in 0..80 {
        bench.grip.translation.vector -= turn * Vector3::new(0.0, 0.0, 1e-4);
        both(&mut bench);
    }
    assert!(bench.hold(0, None));
    let lies = UnitQuaternion::from_scaled_axis(Vector3::new(1.5, 0.1, 0.0));
    let beside = Vector3::new(0.0013 - SUM_M - 2e-4, 0.002, 0.01);
    bench.other = turn * Isometry3::from_parts(beside.into(), lies);
    let report = both(&mut bench);
    assert_eq!(felt(&report), Vector3::zeros());
    (bench, fixed)
}

/// What the bar presses with goes through the needle into the tissue, whose stiffness the hand feels.
#[test]
fn a_needle_in_tissue_is_pushed() {
    let corotational = || Kind::Corotational(Passes::default());
    for (kind, grips_n_per_m, density) in [
        (Kind::Linear, 50.0, None),
        (Kind::Linear, 5.0, None),
        (Kind::Linear, 50.0, Some(STEEL_KG_PER_M3)),
        (corotational(), 50.0, None),
    ] {
        let scene = Scene {
            kind,
            grips_n_per_m,
            density_kg_per_m3: density,
            ..Scene::upright()
        };
        let needle = scene.needle;
        let (mut bench, fixed) = stuck(scene);
        let before = pose(&bench);
        push(&mut bench, Vector3::new(1e-4, 2e-5, 0.0), 4);
        push(&mut bench, Vector3::zeros(), 10);
        let (error, largest) = tangent_error(&mut bench);
        println!("tangent off by {error:e} of {largest} at first");
        // Of much that slips some goes on to the one side, and some to the other.
        let most = if grips_n_per_m < 50.0 { 5e-3 } else { 1e-4 };
        assert!(error < most, "{error}");
        push(&mut bench, Vector3::new(1e-4, 2e-5, 0.0), 16);
        let report = push(&mut bench, Vector3::zeros(), 30);
        let (force, deep_m) = (felt(&report), overlap_m(&bench, &needle));
        let weight_n = density.map_or(0.0, |density| {
            density * needle.tip_area_m2() * 0.024 * GRAVITY_M_PER_S2
        });
        let on_slab = on_slab_n(&bench, &fixed) + Vector3::new(0.0, 0.0, weight_n);
        let tilted = pose(&bench).rotation.angle_to(&before.rotation);
        println!("{force} N at {deep_m} m, slab {on_slab}, tilted by {tilted}");
        assert!(force.x < -0.01 && tilted > 0.01, "{force} {tilted}");
        assert!((force.norm() - STIFF * deep_m).abs() < EVEN_N, "{deep_m}");
        assert!(
            (force + on_slab).norm() < 1e-3 * force.norm(),
            "{force} {on_slab}"
        );
        let (error, largest) = tangent_error(&mut bench);
        println!("tangent off by {error:e} of {largest}");
        assert!(error < most, "{error}");
        // Softer than the pair by itself: the tissue gives way, too.
        let of_x = report.contacts()[1].tangent[0][0];
        assert!(-of_x < 0.5 * STIFF && of_x < -1.0, "{of_x}");
        // Drawn back, it is felt no more.
        let report = push(&mut bench, Vector3::new(-2e-4, 0.0, 0.0), 30);
        assert_eq!(felt(&report), Vector3::zeros());
    }
}

/// Turned it is the same.
#[test]
fn a_turned_push_is_the_same() {
    let turn = UnitQuaternion::from_euler_angles(0.3, 1.1, -2.0);
    let forces = [UnitQuaternion::identity(), turn].map(|turn| {
        let scene = Scene {
            turn,
            ..Scene::upright()
        };
        let (mut bench, _) = stuck(scene);
        let report = push(&mut bench, turn * Vector3::new(1e-4, 2e-5, 0.0), 20);
        turn.inverse() * felt(&report)
    });
    assert!(forces[0].norm() > 0.01);
    assert!((forces[1] - forces[0]).norm() < 1e-6, "{forces:?}");
}

/// In the air nothing but its mass withstands: it goes where the bar does, and that feels next to nothing.
#[test]
fn in_the_air_it_goes_along() {
    for needle in [straight(0.024), arc(0.008, 170.0)] {
        let scene = Scene {
            needle,
            start: frame([0.0, 0.0, 0.08], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]),
            ..Scene::upright()
        };
        let (mut bench, fixed) = scene.build();
        both(&mut bench);
        assert!(bench.hold(0, None));
        let lies = UnitQuaternion::from_scaled_axis(Vector3::new(1.5, 0.1, 0.0));
        let centre_m = {
            let curve = needle.at(&pose(&bench));
            let at =
                (0..1000).map(|part| curve.at(curve.length * (f64::from(part) + 0.5) / 1000.0));
            at.sum::<Vector3<f64>>() / 1000.0
        };
        let beside = Vector3::new(-SUM_M - 2e-4, centre_m.y, centre_m.z);
        bench.other = Isometry3::from_parts(beside.into(), lies);
        both(&mut bench);
        let before = pose(&bench);
        let mut most_n = 0.0f64;
        for _ in 0..50 {
            let report = push(&mut bench, Vector3::new(2e-4, 0.0, 0.0), 1);
            most_n = most_n.max(felt(&report).norm());
        }
        let went = pose(&bench).translation.vector - before.translation.vector;
        let deep_m = overlap_m(&bench, &needle);
        println!("{went} m, {most_n} N, {deep_m} m deep");
        assert!((went.x - (0.01 - 2e-4)).abs() < 1e-3, "{went}");
        assert!(most_n < 1e-3 && deep_m < 1e-5, "{most_n} {deep_m}");
        assert_eq!(on_slab_n(&bench, &fixed).norm(), 0.0);
    }
}

/// One that lies on the slab is pressed into it from above, and bears the bar.
#[test]
fn one_that_lies_is_pressed_into_the_slab() {
    let scene = Scene {
        needle: straight(0.016),
        start: frame([-0.008, 0.001, 0.001], [1.0, 0.1, 0.0], [0.0, 0.0, 1.0]),
        density_kg_per_m3: Some(STEEL_KG_PER_M3),
        ..Scene::upright()
    };
    let needle = scene.needle;
    let (mut bench, fixed) = scene.build();
    both(&mut bench);
    assert!(bench.hold(0, None));
    push(&mut bench, Vector3::zeros(), 100);
    let curve = needle.at(&pose(&bench));
    let middle = curve.at(0.5 * curve.length);
    let lies = UnitQuaternion::from_scaled_axis(Vector3::new(1.57, 0.0, 0.0));
    let above = middle + Vector3::new(0.0, 0.0, SUM_M + 1e-4);
    bench.other = Isometry3::from_parts(above.into(), lies);
    both(&mut bench);
    push(&mut bench, Vector3::new(0.0, 0.0, -5e-5), 12);
    let report = push(&mut bench, Vector3::zeros(), 30);
    let weight_n = STEEL_KG_PER_M3 * needle.tip_area_m2() * 0.016 * GRAVITY_M_PER_S2;
    let (force, on_slab) = (felt(&report), on_slab_n(&bench, &fixed));
    let deep_m = overlap_m(&bench, &needle);
    println!("{force} N at {deep_m} m, slab {on_slab}");
    assert!(force.z > 0.05, "{force}");
    assert!((force.norm() - STIFF * deep_m).abs() < EVEN_N, "{deep_m}");
    assert!(
        (on_slab + force + Vector3::new(0.0, 0.0, weight_n)).norm() < 2e-3 * force.norm(),
        "{force} {on_slab}"
    );
    let (error, largest) = tangent_error(&mut bench);
    println!("tangent off by {error:e} of {largest}");
    assert!(error < 1e-3, "{error}");
}

/// A hand that lets a needle go within its own bar presses on it once the two have been apart.
#[test]
fn what_the_bars_own_hand_lets_go_is_not_thrown() {
    let (mut bench, _) = Scene::upright().build();
    let curve = straight(0.024).at(&bench.grip);
    let beside = curve.at(0.5 * curve.length) - Vector3::new(SUM_M + 2e-4, 0.0, 0.0);
    let lies = UnitQuaternion::from_scaled_axis(Vector3::new(1.57, 0.0, 0.0));
    bench.other = Isometry3::from_parts(beside.into(), lies);
    both(&mut bench);
    let report = push(&mut bench, Vector3::new(1e-4, 0.0, 0.0), 12);
    assert!(felt(&report).x < -0.9);
    let sample = bench.sample_of(1);
    assert!(bench.state.hold(&bench.model, 0, Some(&sample)));
    let report = push(&mut bench, Vector3::new(1e-4, 0.0, 0.0), 3);
    assert_eq!(felt(&report), Vector3::zeros());
    assert!(bench.hold(0, None));
    let before = pose(&bench);
    let report = push(&mut bench, Vector3::new(-1e-4, 0.0, 0.0), 5);
    assert_eq!(felt(&report), Vector3::zeros());
    let stays = |now: Isometry3<f64>| {
        let moved = now.translation.vector - before.translation.vector;
        moved.norm() < 1e-12 && now.rotation.angle_to(&before.rotation) < 1e-12
    };
    assert!(stays(pose(&bench)));
    // Apart, and back.
    push(&mut bench, Vector3::new(-1e-4, 0.0, 0.0), 20);
    push(&mut bench, Vector3::new(1e-4, 0.0, 0.0), 40);
    assert!(!stays(pose(&bench)));
}

/// A bar that is poked about a needle that hangs in tissue, or lies on it, fast, stiff and deep: all stays finite, all but a few steps have
/// a balance, nothing is felt that bodies of these radii cannot press with, and nothing once it is away.
#[test]
fn a_bar_that_pokes_about_does_no_harm() {
    let bent = frame([0.008, 0.0007, 0.012], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]);
    let lying = frame([-0.008, 0.001, 0.001], [1.0, 0.1, 0.0], [0.0, 0.0, 1.0]);
    let (mut steps, mut without) = (0, 0);
    for (seed, (needle, start, density)) in [
        (straight(0.024), Scene::upright().start, None),
        (
            straight(0.024),
            Scene::upright().start,
            Some(STEEL_KG_PER_M3),
        ),
        (arc(0.008, 170.0), bent, None),
        (arc(0.008, 170.0), bent, Some(30_000.0)),
        (straight(0.016), lying, Some(1.0)),
    ]
    .into_iter()
    .enumerate()
    {
        let scene = Scene {
            needle,
            start,
            density_kg_per_m3: density,
            grips_n_per_m: 5.0,
            ..Scene::upright()
        };
        let (mut bench, _) = if start == lying {
            let mut built = scene.build();
            both(&mut built.0);
            built
        } else {
            stuck(scene)
        };
        bench.hold(0, None);
        let mut rng = fastrand::Rng::with_seed(seed as u64);
        let mut part = || 2.0 * rng.f64() - 1.0;
        for _ in 0..60 {
            let by = Vector3::new(part(), part(), part()) * 1.5e-3;
            let at = bench.other.translation.vector;
            let back = Vector3::new(0.0, 0.0, 0.008) - at;
            let mut to = at + by + back * 0.05;
            // The needle, rather than the slab.
            to.z = to.z.max(2.4e-3);
            let turn = Vector3::new(1.57 + 0.01 * part(), 0.01 * part(), 0.5 * part());
            bench.other = Isometry3::from_parts(to.into(), UnitQuaternion::from_scaled_axis(turn));
            bench.time_us += 5000;
            let samples = [bench.sample_of(0), bench.sample_of(1)];
            let report = bench.follow(&samples);
            bench.look(&report);
            steps += 1;
            without += u32::from(!report.status.has_balance());
        }
        bench.other = Isometry3::translation(0.0, 0.0, 0.3);
        let report = both(&mut bench);
        assert_eq!(felt(&report), Vector3::zeros());
    }
    println!("{without} of {steps} without a balance");
    assert!(without * 100 <= steps, "{without} of {steps}");
}

/// Without new columns no step of a push allocates.
#[test]
fn nothing_is_allocated() {
    let (mut bench, _) = stuck(Scene::upright());
    let allocated = allocation_counter::measure(|| {
        for _ in 0..20 {
            bench.other.translation.vector.x += 1e-4;
            let samples = [bench.sample_of(0), bench.sample_of(1)];
            bench.follow(&samples);
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
