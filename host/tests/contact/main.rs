//! Spheres on tissue: balance, exact Jacobian, bad poses, same bits.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;
use std::path::PathBuf;
use sutura_host::fem::{Anchor, Handle, Loads, Material, NodeLoad};
use sutura_host::mesh::{TetMesh, read_msh, slab};
use sutura_host::model::{Model, ModelError, Warning};
use sutura_host::step::{State, Status, StepReport, ToolContact, Workspace, step};
use sutura_host::tool::{Tool, ToolSample};

const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};
const RADIUS: f64 = 0.014;
/// Radius of the arch's top \[m\].
const ARCH: f64 = 0.06;

/// A model with what it takes to step it.
struct Bench {
    model: Model,
    work: Workspace,
}

impl Bench {
    fn new(mesh: &TetMesh, fixed: &[u32], loads: Loads, tools: &[(u8, Tool)]) -> Self {
        let model = Model::new(mesh, SOFT, fixed, loads, tools).expect("a model");
        let mut work = Workspace::new(&model);
        work.vertices_per_step = 1000;
        Self { model, work }
    }

    /// The slab that the tests press: 80 x 80 x 30 mm on a table, one sphere.
    fn slab(offset_m: [f64; 3]) -> Self {
        let (mesh, bottom) = slab_mesh();
        let tool = Tool::sphere(RADIUS, offset_m);
        Self::new(&mesh, &bottom, Loads::default(), &[(0, tool)])
    }

    /// The same slab bent over a cylinder of 60 mm radius along y: a curved top.
    fn arch(offset_m: [f64; 3]) -> Self {
        let (flat, bottom) = slab_mesh();
        let bend = |p: &[f64; 3]| {
            let angle = p[0] / ARCH;
            [
                (ARCH + p[2]) * angle.sin(),
                p[1],
                (ARCH + p[2]) * angle.cos() - ARCH,
            ]
        };
        let points = flat.points_m().iter().map(bend).collect();
        let mesh = TetMesh::new(points, flat.cells().to_vec()).expect("a sound mesh");
        let tool = Tool::sphere(0.018, offset_m);
        Self::new(&mesh, &bottom, Loads::default(), &[(0, tool)])
    }

    /// A cylinder of 60 mm diameter lying along z, held at its ends, and a sphere on its side.
    fn cylinder(offset_m: [f64; 3]) -> Self {
        let path =
            PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data/cylinder_1650.msh");
        let text = std::fs::read_to_string(path).expect("the cylinder");
        let mesh = read_msh(&text, 0.06).expect("a sound mesh");
        let ends: Vec<u32> = (0u32..)
            .zip(mesh.points_m())
            .filter(|(_, p)| p[2] < 1e-9 || p[2] > 0.12 - 1e-9)
            .map(|(node, _)| node)
            .collect();
        let tool = Tool::sphere(0.02, offset_m);
        Self::new(&mesh, &ends, Loads::default(), &[(0, tool)])
    }

    fn step(&mut self, state: &mut State, sample: ToolSample) -> StepReport {
        step(&self.model, state, &[sample], &mut self.work)
    }

    /// A new state comes in from `from` to `to`: contact detected afresh.
    fn afresh(&mut self, from: ToolSample, to: ToolSample) -> (State, StepReport) {
        let mut state = State::new(&self.model);
        let start = self.step(&mut state, from);
        assert_eq!(
            (start.status, start.rows),
            (Status::Ok, 0),
            "starts in the air"
        );
        let report = self.step(&mut state, to);
        (state, report)
    }

    /// No vertex inside a sphere, no force that pulls, forces only where vertices touch and along
    /// their normals.
    fn assert_balanced(&self, state: &State, centre: Vector3<f64>, radius: f64) {
        let at = self
            .model
            .equilibrium(state)
            .expect("a balance")
            .displacement_m;
        let place = |node: u32| {
            Vector3::from(self.model.points_m()[node as usize]) + Vector3::from(at[node as usize])
        };
        for &node in &self.model.surface().vertices {
            if !self.model.tissue().is_fixed(node) {
                let gap = (place(node) - centre).norm() - radius;
                assert!(gap > -1e-9 * radius, "node {node} is {:e} m inside", -gap);
            }
        }
        let largest = state
            .contact_forces(&self.model)
            .map(|(_, force)| Vector3::from(force).norm())
            .fold(0.0, f64::max);
        for (node, force) in state.contact_forces(&self.model) {
            let force = Vector3::from(force);
            let normal = (place(node) - centre).normalize();
            let lambda = force.dot(&normal);
            let gap = (place(node) - centre).norm() - radius;
            assert!(
                lambda >= -1e-9 * largest,
                "node {node} is pulled by {lambda} N"
            );
            assert!(
                (force - normal * lambda).norm() < 1e-9 * largest,
                "friction at {node}"
            );
            assert!(
                (lambda * gap).abs() < 1e-9 * largest * radius,
                "a force across a gap"
            );
        }
    }
}

fn slab_mesh() -> (TetMesh, Vec<u32>) {
    let mesh = slab([0.08, 0.08, 0.03], [16, 16, 6]).expect("a slab");
    (mesh, (0..17 * 17).collect())
}

fn pose(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> ToolSample {
    let q = rotation.coords;
    ToolSample {
        id: 0,
        position_m: position.into(),
        orientation: [q.x, q.y, q.z, q.w],
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

fn at(x: f64, y: f64, z: f64) -> ToolSample {
    pose(Vector3::new(x, y, z), UnitQuaternion::identity())
}

fn centre_of(sample: &ToolSample, offset_m: [f64; 3]) -> Vector3<f64> {
    let [x, y, z, w] = sample.orientation;
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    Vector3::from(sample.position_m) + rotation * Vector3::from(offset_m)
}

fn contact(report: &StepReport) -> ToolContact {
    assert_eq!(report.status, Status::Ok);
    assert!(report.residual < 1e-10, "residual {:e}", report.residual);
    *report.contacts().first().expect("one tool")
}

fn force(contact: &ToolContact) -> Vector3<f64> {
    Vector3::from_column_slice(&contact.wrench[..3])
}

/// The same numbers on every machine, in -1 to 1 (a linear congruential generator, Knuth's constants).
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next())
    }
}

#[test]
fn pushing_in_pushes_the_hand_out() {
    let mut bench = Bench::slab([0.0; 3]);
    let mut last = 0.0;
    for depth in 1..=9 {
        let sample = at(0.0, 0.0, RADIUS - 1e-3 * f64::from(depth));
        let (state, report) = bench.afresh(at(0.0, 0.0, 0.05), sample);
        let contact = contact(&report);
        let push = force(&contact).z;
        assert!(push > last, "{push} N at {depth} mm, {last} N before");
        assert!(contact.tangent[2][2] < 0.0 && contact.normal[2] > 0.99 && contact.gap_m == 0.0);
        bench.assert_balanced(&state, centre_of(&sample, [0.0; 3]), RADIUS);
        last = push;
    }
    // An infinite half space gives 4/3 E/(1 - nu^2) sqrt(R) d^1.5 = 2.5 N (Hertz 1882); a slab of
    // finite depth on a table is stiffer, one with free sides softer.
    let hertz = 4.0 / 3.0 * 15e3 / (1.0 - 0.45f64.powi(2)) * RADIUS.sqrt() * 0.009f64.powf(1.5);
    println!("9 mm: {last} N, Hertz {hertz} N");
    assert!(
        last > hertz && last < 3.0 * hertz,
        "{last} N against Hertz's {hertz} N"
    );
}

#[test]
fn the_force_is_the_slope_of_the_stored_energy() {
    let mut bench = Bench::slab([0.0; 3]);
    let mut chance = Chance(7);
    for _ in 0..6 {
        let centre = Vector3::new(0.0, 0.0, RADIUS - 0.006) + chance.vector() * 0.003;
        let mut solve = |centre: Vector3<f64>| {
            let (_, report) =
                bench.afresh(at(0.0, 0.0, 0.05), pose(centre, UnitQuaternion::identity()));
            let energy = report.stored_energy_j;
            (force(&contact(&report)), energy)
        };
        let (found, energy) = solve(centre);
        assert!(energy > 0.0);
        let h = 1e-6;
        let slope = Vector3::from_fn(|axis, _| {
            let mut step = Vector3::zeros();
            step[axis] = h;
            (solve(centre + step).1 - solve(centre - step).1) / (2.0 * h)
        });
        let error = (found + slope).norm() / found.norm();
        assert!(
            error < 1e-6,
            "force {found} against -dE/dc {slope}: {error:e}"
        );
    }
}

#[test]
fn the_tangent_under_the_middle_is_symmetric() {
    let mut bench = Bench::slab([0.0; 3]);
    let (_, report) = bench.afresh(at(0.0, 0.0, 0.05), at(0.0, 0.0, RADIUS - 0.008));
    let contact = contact(&report);
    let k = contact.tangent;
    let normal = k[2][2];
    assert!(normal < 0.0);
    println!("lateral over normal stiffness {}", k[0][0] / normal);
    // The mesh is its own mirror image in x and in y, and x and y can be swapped.
    assert!((k[0][0] - k[1][1]).abs() < 1e-8 * normal.abs(), "{k:?}");
    for (i, j) in [(0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1)] {
        assert!(
            k[i][j].abs() < 1e-8 * normal.abs(),
            "{i} {j}: {:?}",
            k[i][j]
        );
    }
    assert!(force(&contact).xy().norm() < 1e-10 * force(&contact).z);
}

/// Turns a pose by a small left (world-frame) increment.
fn turned(position: Vector3<f64>, rotation: UnitQuaternion<f64>, by: Vector3<f64>) -> ToolSample {
    pose(position, UnitQuaternion::from_scaled_axis(by) * rotation)
}

/// The Jacobian by central differences of fourth order over full solves, each from a new state; `None`
/// where one of them touches other vertices than the pose itself.
fn by_differences(
    bench: &mut Bench,
    from: ToolSample,
    position: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
) -> Option<Matrix6<f64>> {
    let mut touched_by = |sample: ToolSample| {
        let (state, report) = bench.afresh(from, sample);
        let mut touched: Vec<u32> = state
            .contact_forces(&bench.model)
            .map(|(node, _)| node)
            .collect();
        touched.sort_unstable();
        (touched, contact(&report).wrench)
    };
    let (touched, _) = touched_by(pose(position, rotation));
    let mut jacobian = Matrix6::zeros();
    // Step of each difference: [m] and [rad]. The third derivative costs h^2, round-off 1/h.
    let h = [2e-6, 1e-4];
    for axis in 0..6 {
        let step = h[axis / 3];
        let mut wrenches = [[0.0; 6]; 4];
        for (wrench, way) in wrenches.iter_mut().zip([-2.0, -1.0, 1.0, 2.0]) {
            let mut by = Vector3::zeros();
            by[axis % 3] = way * step;
            let sample = if axis < 3 {
                pose(position + by, rotation)
            } else {
                turned(position, rotation, by)
            };
            let (others, found) = touched_by(sample);
            if others != touched {
                return None; // the set of touched vertices switches here
            }
            *wrench = found;
        }
        let [mm, m, p, pp] = wrenches;
        for row in 0..6 {
            jacobian[(row, axis)] = (8.0 * (p[row] - m[row]) - (pp[row] - mm[row])) / (12.0 * step);
        }
    }
    Some(jacobian)
}

/// Compares the Jacobian with differences at 24 poses that `draw` gives as the sphere's centre and the
/// grip's rotation; somewhere at least `expected_rows` vertices must be touched.
fn compare_jacobians(
    mut bench: Bench,
    from: ToolSample,
    offset_m: [f64; 3],
    expected_rows: u32,
    mut draw: impl FnMut(&mut Chance) -> (Vector3<f64>, UnitQuaternion<f64>),
) {
    let mut chance = Chance(42);
    let (mut poses, mut worst, mut fewest, mut most, mut switches) = (0, 0.0f64, u32::MAX, 0, 0);
    while poses < 24 {
        // The drawn position is the sphere's centre; the grip is where the offset puts it.
        let (centre, rotation) = draw(&mut chance);
        let arm = rotation * Vector3::from(offset_m);
        let position = centre - arm;
        let Some(expected) = by_differences(&mut bench, from, position, rotation) else {
            switches += 1;
            assert!(switches < 100, "no pose is away from a switch");
            continue;
        };
        let (state, report) = bench.afresh(from, pose(position, rotation));
        bench.assert_balanced(&state, centre, bench.model.tools()[0].1.radius_m());
        let found = contact(&report);
        let tangent = Matrix6::from_fn(|i, j| found.tangent[i][j]);
        // Translations and rotations have different units: each block against its own size.
        for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let scale = expected.fixed_view::<3, 3>(i, j).norm();
            let difference = tangent.fixed_view::<3, 3>(i, j) - expected.fixed_view::<3, 3>(i, j);
            // A block that is zero but for round-off is judged by the others.
            let size = tangent.fixed_view::<3, 3>(0, 0).norm()
                * bench.model.tools()[0].1.radius_m().powi((i + j) as i32 / 3);
            if scale > 1e-9 * size {
                worst = worst.max(difference.norm() / scale);
                assert!(
                    difference.norm() <= 1e-6 * scale,
                    "{:e} in block {i} {j} at {position} with {} rows",
                    difference.norm() / scale,
                    found.rows
                );
            } else {
                assert!(difference.norm() < 1e-9 * size);
            }
        }
        // Skew part: -1/2 [m]x in the rotations, nothing elsewhere.
        let skew = (tangent - tangent.transpose()) * 0.5;
        let moment = Vector3::from_column_slice(&found.wrench[3..]);
        let rest = skew.fixed_view::<3, 3>(3, 3) + moment.cross_matrix() * 0.5;
        assert!(
            rest.norm() < 1e-12 * (1.0 + moment.norm()),
            "skew part off by {rest}"
        );
        assert!(skew.fixed_view::<6, 3>(0, 0).norm() < 1e-9 * tangent.norm());
        poses += 1;
        fewest = fewest.min(found.rows);
        most = most.max(found.rows);
    }
    println!(
        "{poses} poses, {fewest} to {most} rows, {switches} drawn at a switch; largest error {worst:.1e}"
    );
    assert!(most >= expected_rows, "at most {most} vertices are touched");
}

#[test]
fn the_jacobian_is_exact_on_a_slab() {
    compare_jacobians(
        Bench::slab([0.0; 3]),
        at(0.0, 0.0, 0.05),
        [0.0; 3],
        14,
        |chance| {
            let [x, y, z] = chance.vector().into();
            (
                Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.006 + 0.003 * z),
                UnitQuaternion::identity(),
            )
        },
    );
}

#[test]
fn the_jacobian_is_exact_with_the_sphere_off_the_grip() {
    let offset = [0.02, -0.01, -0.05];
    compare_jacobians(
        Bench::slab(offset),
        at(0.0, 0.0, 0.2),
        offset,
        14,
        |chance| {
            let [x, y, z] = chance.vector().into();
            let centre = Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.006 + 0.003 * z);
            (
                centre,
                UnitQuaternion::from_scaled_axis(chance.vector() * 0.8),
            )
        },
    );
}

#[test]
fn the_jacobian_is_exact_on_an_arch() {
    let offset = [0.0, 0.03, 0.05];
    compare_jacobians(
        Bench::arch(offset),
        at(0.0, 0.0, 0.2),
        offset,
        12,
        |chance| {
            let [angle, y, depth] = chance.vector().into();
            let out = Vector3::new((0.3 * angle).sin(), 0.0, (0.3 * angle).cos());
            let height = ARCH + 0.018 - 0.006 + 0.003 * depth;
            let centre = out * height + Vector3::new(0.0, 0.012 * y, -ARCH);
            (
                centre,
                UnitQuaternion::from_scaled_axis(chance.vector() * 0.4),
            )
        },
    );
}

#[test]
fn the_jacobian_is_exact_on_an_unstructured_cylinder() {
    let offset = [0.0, 0.01, 0.04];
    compare_jacobians(
        Bench::cylinder(offset),
        at(0.2, 0.0, 0.06),
        offset,
        8,
        |chance| {
            let [angle, z, depth] = chance.vector().into();
            let out = Vector3::new((0.5 * angle).cos(), (0.5 * angle).sin(), 0.0);
            let centre =
                out * (0.03 + 0.02 - 0.005 + 0.002 * depth) + Vector3::z() * (0.06 + 0.015 * z);
            (
                centre,
                UnitQuaternion::from_scaled_axis(chance.vector() * 0.4),
            )
        },
    );
}

#[test]
fn apart_the_gap_and_the_coming_stiffness_are_known() {
    let mut bench = Bench::slab([0.0; 3]);
    let mut state = State::new(&bench.model);
    let report = bench.step(&mut state, at(0.0, 0.0, RADIUS + 0.003));
    let before = contact(&report);
    assert_eq!((before.rows, before.wrench), (0, [0.0; 6]));
    assert!(
        (before.gap_m - 0.003).abs() < 1e-12,
        "the vertex below is {} m away",
        before.gap_m
    );
    assert!((before.normal[2] - 1.0).abs() < 1e-12);
    // Just after touching, with the one vertex below in contact.
    let report = bench.step(&mut state, at(0.0, 0.0, RADIUS - 1e-6));
    let after = contact(&report);
    assert_eq!(after.rows, 1);
    assert!((before.tangent[2][2] / after.tangent[2][2] - 1.0).abs() < 1e-4);
    let far = contact(&bench.step(&mut state, at(0.0, 0.0, 10.0)));
    assert!((far.gap_m - 10.0 + RADIUS).abs() < 1e-9 && far.wrench == [0.0; 6]);
    assert_eq!(state.contact_forces(&bench.model).count(), 0);
}

fn all_finite(report: &StepReport) -> bool {
    report.stored_energy_j.is_finite()
        && report.residual.is_finite()
        && report.contacts().iter().all(|contact| {
            contact
                .wrench
                .iter()
                .chain(contact.tangent.iter().flatten())
                .all(|x| x.is_finite())
                && contact
                    .normal
                    .iter()
                    .chain([&contact.gap_m])
                    .all(|x| x.is_finite())
        })
}

#[test]
fn bad_poses_get_a_status_and_the_state_recovers() {
    let mut bench = Bench::slab([0.0; 3]);
    let press = at(0.003, 0.001, RADIUS - 0.006);
    let (_, undisturbed) = bench.afresh(at(0.0, 0.0, 0.05), press);
    let expected = contact(&undisturbed);

    let quaternion = |orientation| ToolSample {
        orientation,
        ..press
    };
    let bad = [
        ("nan", at(f64::NAN, 0.0, 0.0), Some(Status::NotFinite)),
        (
            "infinite",
            at(0.0, f64::INFINITY, 0.0),
            Some(Status::NotFinite),
        ),
        ("huge", at(0.0, 0.0, 1e300), Some(Status::NotFinite)),
        (
            "no quaternion",
            quaternion([0.0; 4]),
            Some(Status::NotFinite),
        ),
        (
            "nan quaternion",
            quaternion([f64::NAN; 4]),
            Some(Status::NotFinite),
        ),
        (
            "unknown id",
            ToolSample { id: 9, ..press },
            Some(Status::UnknownTool),
        ),
        ("far away", at(50.0, -20.0, 9.0), Some(Status::Ok)),
        ("other side", at(0.0, 0.0, -0.2), Some(Status::Ok)),
        ("deep", at(0.0, 0.0, -0.002), None),
        ("through the table", at(0.0, 0.0, -0.03), None),
        ("into the side", at(0.03, 0.01, -0.01), None),
    ];
    for start in [at(0.0, 0.0, 0.05), press] {
        for (name, sample, status) in bad {
            let mut state = State::new(&bench.model);
            bench.step(&mut state, at(0.0, 0.0, 0.05));
            bench.step(&mut state, start);
            let kept = state.clone();
            let report = bench.step(&mut state, sample);
            println!(
                "{name}: {:?}, {} substeps, {} rows",
                report.status, report.substeps, report.rows
            );
            assert!(all_finite(&report), "{name}");
            if let Some(status) = status {
                assert_eq!(report.status, status, "{name}");
            }
            if matches!(report.status, Status::NotFinite | Status::UnknownTool) {
                assert_eq!(state, kept, "{name} leaves the state as it was");
            }
            if report.status != Status::Ok {
                assert!(
                    report.contacts().is_empty(),
                    "{name}: no contact without a balance"
                );
            }
            // Back into the air and down again: as if nothing had been.
            let air = bench.step(&mut state, at(0.0, 0.0, 0.05));
            assert_eq!((air.status, air.rows), (Status::Ok, 0), "{name}");
            let again = contact(&bench.step(&mut state, press));
            let error = (force(&again) - force(&expected)).norm() / force(&expected).norm();
            assert!(
                error < 1e-9,
                "{name}: the force afterwards is off by {error:e}"
            );
        }
    }
}

#[test]
fn wild_motion_never_breaks_the_solver() {
    let mut bench = Bench::slab([0.0, 0.0, -0.02]);
    bench.work.vertices_per_step = 40;
    let mut chance = Chance(3);
    let mut state = State::new(&bench.model);
    let mut seen = std::collections::BTreeMap::new();
    for tick in 0..600 {
        let position = chance.vector() * 0.05 + Vector3::z() * 0.03;
        let rotation = UnitQuaternion::from_scaled_axis(chance.vector());
        let sample = pose(position, rotation);
        let report = bench.step(&mut state, sample);
        assert!(all_finite(&report), "tick {tick}");
        *seen.entry(report.status.name()).or_insert(0) += 1;
        if report.status == Status::Ok && tick % 5 == 0 {
            bench.assert_balanced(&state, centre_of(&sample, [0.0, 0.0, -0.02]), RADIUS);
        }
    }
    println!("{seen:?}");
    assert!(seen["ok"] > 300, "{seen:?}");
    let air = bench.step(&mut state, at(0.0, 0.0, 0.1));
    assert_eq!((air.status, air.rows), (Status::Ok, 0));
}

#[test]
fn a_sphere_that_touches_too_much_says_so() {
    let (mesh, bottom) = slab_mesh();
    let tool = Tool::sphere(0.4, [0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool)]);
    let mut state = State::new(&bench.model);
    assert_eq!(bench.step(&mut state, at(0.0, 0.0, 0.41)).rows, 0);
    let light = bench.step(&mut state, at(0.0, 0.0, 0.4 - 2e-4));
    assert_eq!(light.status, Status::Ok);
    let deep = bench.step(&mut state, at(0.0, 0.0, 0.4 - 8e-3));
    assert_eq!(
        (deep.status, deep.contacts().len()),
        (Status::TooManyRows, 0)
    );
    let again = bench.step(&mut state, at(0.0, 0.0, 0.4 - 2e-4));
    let (before, after) = (force(&contact(&light)), force(&contact(&again)));
    assert!(
        (before - after).norm() < 1e-9 * before.norm(),
        "{before} and {after}"
    );
}

#[test]
fn a_first_sample_may_touch_but_not_be_inside() {
    let mut bench = Bench::slab([0.0; 3]);
    let press = at(0.003, 0.001, RADIUS - 0.006);
    let (_, path) = bench.afresh(at(0.003, 0.001, 0.05), press);
    let mut state = State::new(&bench.model);
    let cold = bench.step(&mut state, press);
    let (cold, path) = (force(&contact(&cold)), force(&contact(&path)));
    assert!(
        (cold - path).norm() < 1e-9 * path.norm(),
        "{cold} and {path}"
    );

    let mut state = State::new(&bench.model);
    assert_eq!(
        bench.step(&mut state, at(0.0, 0.0, -0.015)).status,
        Status::Inside
    );
    assert_eq!(
        bench.step(&mut state, at(0.0, 0.0, 0.05)).status,
        Status::Ok
    );
}

#[test]
fn a_teleport_in_contact_ends_where_a_walk_ends() {
    let mut bench = Bench::slab([0.0; 3]);
    let (from, to) = (
        at(-0.02, -0.015, RADIUS - 0.004),
        at(0.02, 0.01, RADIUS - 0.007),
    );
    let (_, fresh) = bench.afresh(at(0.02, 0.01, 0.05), to);
    let (mut state, _) = bench.afresh(at(-0.02, -0.015, 0.05), from);
    let mut report = bench.step(&mut state, to);
    assert!(report.substeps > 1);
    for _ in 0..10 {
        if report.status != Status::Behind {
            break;
        }
        report = bench.step(&mut state, to);
    }
    let (jumped, fresh) = (force(&contact(&report)), force(&contact(&fresh)));
    assert!(
        (jumped - fresh).norm() < 1e-8 * fresh.norm(),
        "{jumped} and {fresh}"
    );
}

#[test]
fn missing_columns_are_waited_for() {
    let mut bench = Bench::slab([0.0; 3]);
    bench.work.vertices_per_step = 3;
    let press = at(0.0, 0.0, RADIUS - 0.006);
    let mut state = State::new(&bench.model);
    bench.step(&mut state, at(0.0, 0.0, 0.05));
    let mut waited = 0;
    let report = loop {
        let report = bench.step(&mut state, press);
        assert!(report.columns_computed <= 9);
        if report.status != Status::Waiting {
            break report;
        }
        waited += 1;
        assert!(waited < 100);
    };
    assert!(waited > 3, "{} rows in steps of 3 columns", report.rows);
    let mut prepared = Bench::slab([0.0; 3]);
    prepared.work.vertices_per_step = 0;
    assert!(prepared.work.prepare(&prepared.model, |p| p[2] > -1e-9) == 17 * 17);
    let (_, ready) = prepared.afresh(at(0.0, 0.0, 0.05), press);
    assert_eq!(ready.columns_computed, 0);
    let difference = force(&contact(&ready)) - force(&contact(&report));
    assert!(difference.norm() < 1e-9 * force(&contact(&ready)).norm());
}

#[test]
fn small_tools_warn_and_impossible_ones_are_refused() {
    let (mesh, bottom) = slab_mesh();
    let build = |tools: &[(u8, Tool)]| Model::new(&mesh, SOFT, &bottom, Loads::default(), tools);
    let sphere = |radius_m| Tool::sphere(radius_m, [0.0; 3]);
    let model = build(&[(0, sphere(0.0)), (1, sphere(0.02))]).expect("a model");
    let warnings = model.warnings();
    assert!(
        matches!(warnings[..], [Warning::SmallTool { id: 0, radius_m: 0.0, mean_edge_m }] if mean_edge_m > 0.005)
    );
    let text = warnings[0].to_string();
    assert!(
        text.contains("tool 0") && text.contains("0.00 mm") && text.contains("artefact"),
        "{text}"
    );
    assert!(matches!(
        build(&[(3, sphere(-1.0))]),
        Err(ModelError::Tool { id: 3, .. })
    ));
    assert!(matches!(
        build(&[(3, sphere(f64::NAN))]),
        Err(ModelError::Tool { .. })
    ));
    assert!(matches!(
        build(&[(3, sphere(0.01)); 2]),
        Err(ModelError::SameTool(3))
    ));
    // A bare point still feels something and never a number that is none.
    let mut work = Workspace::new(&model);
    let mut state = State::new(&model);
    for step_mm in 0..20 {
        let report = step(
            &model,
            &mut state,
            &[at(0.0, 0.0, 0.01 - 1e-3 * f64::from(step_mm))],
            &mut work,
        );
        assert!(all_finite(&report));
        if (8..12).contains(&step_mm) {
            assert!(force(&contact(&report)).z > 0.0, "at step {step_mm}");
        }
    }
}

#[test]
fn two_tools_feel_each_other_through_the_tissue() {
    let (mesh, bottom) = slab_mesh();
    let tool = Tool::sphere(RADIUS, [0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool), (5, tool)]);
    let left = at(-0.018, 0.0, RADIUS - 0.005);
    let right = ToolSample {
        id: 5,
        ..at(0.018, 0.0, RADIUS - 0.005)
    };
    let mut state = State::new(&bench.model);
    let both = step(&bench.model, &mut state, &[right, left], &mut bench.work);
    assert_eq!((both.status, both.contacts().len()), (Status::Ok, 2));
    let [first, second] = both.contacts() else {
        panic!("two contacts")
    };
    assert_eq!((first.id, second.id), (5, 0));
    let mirrored = Vector3::new(-1.0, 1.0, 1.0).component_mul(&force(second));
    assert!((force(first) - mirrored).norm() < 1e-9 * force(first).norm());
    // The right one lifts off: the left one is alone and feels something else.
    let one = step(&bench.model, &mut state, &[left], &mut bench.work);
    let alone = force(&contact(&one));
    assert!((alone - force(second)).norm() > 1e-3 * alone.norm());
    let mut fresh = State::new(&bench.model);
    let fresh = step(&bench.model, &mut fresh, &[left], &mut bench.work);
    assert!((alone - force(&contact(&fresh))).norm() < 1e-9 * alone.norm());
}

#[test]
fn loads_and_handles_stay_while_a_tool_presses() {
    let (mesh, bottom) = slab_mesh();
    let top = |x: u32, y: u32| 17 * 17 * 6 + 17 * y + x;
    let anchor = Anchor {
        vertices: vec![top(11, 8), top(12, 8)],
        weights: vec![0.3, 0.7],
    };
    let target = [0.0, 0.0, 3e-3];
    let loads = Loads {
        forces: vec![NodeLoad {
            node: top(3, 8),
            force_n: [0.0, 0.0, 0.1],
        }],
        handles: vec![Handle {
            anchor: anchor.clone(),
            target_displacement_m: target,
        }],
        ..Loads::default()
    };
    let tool = Tool::sphere(RADIUS, [0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, loads, &[(0, tool)]);
    let sample = at(0.0, 0.0, RADIUS - 0.005);
    let (state, report) = bench.afresh(at(0.0, 0.0, 0.05), sample);
    bench.assert_balanced(&state, centre_of(&sample, [0.0; 3]), RADIUS);
    let solution = bench.model.equilibrium(&state).expect("a balance");
    for (axis, target) in target.into_iter().enumerate() {
        let nodes = anchor.vertices.iter().zip(&anchor.weights);
        let held: f64 = nodes
            .map(|(&node, weight)| weight * solution.displacement_m[node as usize][axis])
            .sum();
        assert!((held - target).abs() < 1e-12);
    }
    assert!(solution.residual < 1e-10);
    let mut plain = Bench::slab([0.0; 3]);
    let (_, plain) = plain.afresh(at(0.0, 0.0, 0.05), sample);
    assert!((force(&contact(&plain)) - force(&contact(&report))).norm() > 1e-2);
}

#[test]
fn a_path_gives_the_same_bits_twice() {
    let run = || {
        let mut bench = Bench::slab([0.0, 0.0, -0.01]);
        bench.work.vertices_per_step = 4;
        let mut state = State::new(&bench.model);
        let mut hasher = DefaultHasher::new();
        let mut rows = 0;
        for tick in 0..300 {
            let t = f64::from(tick) / 300.0;
            let turn = std::f64::consts::TAU * t;
            let position = Vector3::new(
                0.015 * turn.cos(),
                0.012 * (2.0 * turn).sin(),
                RADIUS + 0.01 + 0.004 - 0.012 * (0.5 * turn).sin(),
            );
            let rotation =
                UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * turn.sin(), 0.2, 0.0));
            let report = bench.step(&mut state, pose(position, rotation));
            rows = rows.max(report.rows);
            hasher.write_u8(report.status as u8);
            for contact in report.contacts() {
                for x in contact
                    .wrench
                    .iter()
                    .chain(contact.tangent.iter().flatten())
                {
                    hasher.write_u64(x.to_bits());
                }
            }
            for (node, force) in state.contact_forces(&bench.model) {
                hasher.write_u32(node);
                force.iter().for_each(|x| hasher.write_u64(x.to_bits()));
            }
        }
        let field = bench
            .model
            .equilibrium(&state)
            .expect("a balance")
            .displacement_m;
        field
            .iter()
            .flatten()
            .for_each(|x| hasher.write_u64(x.to_bits()));
        (hasher.finish(), rows)
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    assert!(first.1 >= 10, "the path presses {} vertices", first.1);
}
