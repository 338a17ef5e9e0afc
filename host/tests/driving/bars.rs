//! Bodies of grips against the tissue's surface.

use super::bench::{MATERIAL, frame};
use super::bodies::{a_slab, moved, overlap_of};
use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};
use sutura_host::fem::{Loads, Material};
use sutura_host::mesh::TetMesh;
use sutura_host::model::Model;
use sutura_host::rod::{Bar, BarPart};
use sutura_host::scene::{Document, Scene};
use sutura_host::session::SceneSolver;
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::tool::{Shape, Tool, ToolSample};

struct Held {
    mesh: TetMesh,
    model: Model,
    state: State,
    work: Workspace,
    bar: Bar,
    grip: Isometry3<f64>,
}

impl Held {
    fn new((mesh, fixed): (TetMesh, Vec<u32>), bar: Bar, grip: Isometry3<f64>) -> Self {
        let tools = [(4, Tool::new(Shape::Grip, [0.0; 3]))];
        let material = Material {
            youngs_modulus_pa: 20e3,
            ..MATERIAL
        };
        let model = Model::new(&mesh, material, &fixed, Loads::default(), &tools);
        let model = model.and_then(|model| model.with_bars(&mesh, &[BarPart { tool: 4, bar }]));
        let model = model.expect("a bar");
        let mut work = Workspace::new(&model);
        work.prepare(&model, |_| true);
        let mut held = Self {
            state: State::new(&model),
            work,
            model,
            mesh,
            bar,
            grip,
        };
        // It has to be seen outside.
        held.try_step();
        held
    }

    fn sample(grip: &Isometry3<f64>) -> ToolSample {
        let turn = grip.rotation.coords;
        ToolSample {
            id: 4,
            position_m: grip.translation.vector.into(),
            orientation: [turn.x, turn.y, turn.z, turn.w],
            velocity_m_per_s: [0.0; 3],
            console_time_us: 0,
        }
    }

    fn step(&mut self) -> StepReport {
        let report = self.try_step();
        assert_eq!(report.status, Status::Ok);
        report
    }

    fn try_step(&mut self) -> StepReport {
        let Self {
            model, state, work, ..
        } = self;
        step(
            model,
            state,
            &[Self::sample(&self.grip)],
            &StepOptions::default(),
            work,
        )
    }

    fn shift(&mut self, by: Vector3<f64>) -> StepReport {
        self.grip.translation.vector += by;
        self.step()
    }

    fn overlap_m(&self) -> f64 {
        let front = (self.grip * Point3::from(self.bar.offset_m)).coords;
        let way = self.grip.rotation * Vector3::from(self.bar.axis) * -self.bar.length_m;
        let places = (0..=1000).map(|place| front + way * (f64::from(place) / 1000.0));
        let nodes = self.state.positions(&self.model);
        overlap_of(&self.mesh, &nodes, places, self.bar.radius_m)
    }
}

/// Force on the tissue \[N\].
fn force(report: &StepReport) -> Vector3<f64> {
    let [x, y, z, ..] = report.contacts()[0].wrench;
    -Vector3::new(x, y, z)
}

fn bar(radius_m: f64, friction: f64) -> Bar {
    Bar {
        offset_m: [0.001, 0.0, -0.002],
        axis: [0.0, 0.0, -1.0],
        radius_m,
        length_m: 0.02,
        friction,
    }
}

/// With its axis, from its back to its front, in this direction, and its lowest point `height_m` above the slab's top.
fn over(bar: &Bar, axis: [f64; 3], height_m: f64) -> Isometry3<f64> {
    let turn = frame([0.0; 3], axis, [0.3, 0.5, 0.2]);
    // From x to the axis.
    let own = frame([0.0; 3], bar.axis, [1.0, 0.0, 0.0]);
    let turn = turn.rotation * own.rotation.inverse();
    let front = turn * Vector3::from(bar.offset_m);
    let back = front - turn * Vector3::from(bar.axis) * bar.length_m;
    let middle = (front + back) * 0.5;
    // What stands ends in the middle, what lies has that there.
    let to = if (front.z - back.z).abs() > 0.9 * bar.length_m {
        front
    } else {
        middle
    };
    let lift = height_m + bar.radius_m - front.z.min(back.z);
    let shift = Vector3::new(0.0013 - to.x, -0.0007 - to.y, lift);
    Isometry3::from_parts(shift.into(), turn)
}

const AXES: [[f64; 3]; 4] = [
    // Across, along the mesh, leaning, and standing.
    [1.0, 0.6, 0.0],
    [0.0, 1.0, 0.0],
    [1.0, 0.3, -0.6],
    [0.05, 0.02, -1.0],
];

#[test]
fn a_bar_pushes_what_it_is_swept_against() {
    for radius_m in [0.0006, 0.0025] {
        for axis in AXES {
            let bar = bar(radius_m, 0.3);
            let mut held = Held::new(a_slab(), bar, over(&bar, axis, 1e-4));
            let edge_m = held.mesh.surface().mean_edge_m;
            assert_eq!(force(&held.step()), Vector3::zeros());
            let (mut pressed, mut aside, mut worst) = (0.0f64, 0.0f64, f64::MIN);
            for place in 0..24 {
                let by = match place {
                    0..10 => Vector3::new(0.0, 0.0, -1e-4),
                    _ => Vector3::new(1e-4, 3e-5, 0.0),
                };
                let report = held.shift(by);
                let now = force(&report);
                match place {
                    0..2 => {}
                    2..10 => {
                        assert!(now.z < pressed, "{axis:?} {place}: {now}");
                        pressed = now.z;
                    }
                    _ => aside = aside.max(now.x),
                }
                worst = worst.max(held.overlap_m());
                println!(
                    "{radius_m} {axis:?} {place}: {:.1} mN, overlap {:.1e} edges, {} rows, {} solves, {} pieces",
                    1e3 * now.norm(),
                    held.overlap_m() / edge_m,
                    report.rows,
                    report.solves,
                    report.substeps
                );
            }
            println!(
                "bar {radius_m} {axis:?}: {pressed} N, {aside} N aside, {:.1e} edges",
                worst / edge_m
            );
            assert!(worst <= 1e-3 * edge_m, "{axis:?}: {worst} m");
            assert!(aside > 0.005, "{axis:?}: {aside} N aside");
            for _ in 0..20 {
                let report = held.shift(Vector3::new(0.0, 0.0, 2e-4));
                assert!(force(&report).z <= 1e-12, "it pulls");
            }
            let report = held.step();
            assert_eq!(
                (force(&report), report.contacts()[0].rows),
                (Vector3::zeros(), 0)
            );
        }
    }
}

#[test]
fn the_tangent_of_a_bar_is_the_derivative() {
    for axis in AXES {
        for friction in [0.0, 0.4] {
            let bar = bar(0.0025, friction);
            let mut held = Held::new(a_slab(), bar, over(&bar, axis, 1e-4));
            for place in 0..14 {
                held.shift(match place {
                    0..10 => Vector3::new(0.0, 0.0, -1e-4),
                    _ => Vector3::new(1e-4, 3e-5, 0.0),
                });
            }
            let (mut share, mut found) = (1.0, (f64::NAN, 2));
            while found.1 > 1 {
                share *= 0.25;
                let by = Vector6::new(3e-5, -2e-5, -2e-5, 1e-3, 5e-4, 1e-3) * share;
                let to = moved(&held.grip, &by);
                found = tangent_off(&mut held, to);
                println!("bar {axis:?}, mu {friction}, {share} of the way: {found:?}");
                assert!(share > 1e-3);
            }
            assert!(found.0 < 1e-6, "{axis:?}, mu {friction}: {found:?}");
        }
    }
}

/// As of needles' bodies.
fn tangent_off(held: &mut Held, to: Isometry3<f64>) -> (f64, u32) {
    let before = held.state.clone();
    let mut at = |grip: Isometry3<f64>| {
        let mut state = before.clone();
        let (options, sample) = (StepOptions::default(), Held::sample(&grip));
        step(&held.model, &mut state, &[sample], &options, &mut held.work)
    };
    let report = at(to);
    assert_eq!((report.status, report.substeps), (Status::Ok, 1));
    assert!(report.contacts()[0].rows > 0);
    let tangent = report.contacts()[0].tangent;
    let tangent = Matrix6::from_fn(|i, j| tangent[i][j]);
    let found = Matrix6::from_columns(&[0, 1, 2, 3, 4, 5].map(|axis| {
        let size = if axis < 3 { 2e-8 } else { 1e-6 };
        let [ahead, behind] = [1.0, -1.0].map(|sign| {
            let there = at(moved(&to, &Vector6::ith(axis, sign * size)));
            Vector6::from(there.contacts()[0].wrench)
        });
        (ahead - behind) / (2.0 * size)
    }));
    let mut worst = 0.0f64;
    for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
        let own = tangent.fixed_view::<3, 3>(i, j);
        let there = found.fixed_view::<3, 3>(i, j);
        worst = worst.max((own - there).amax() / there.amax());
    }
    (worst, report.solves)
}

/// What the hand feels is what the tissue gets, and what that is held with; turned and shifted it is the same.
#[test]
fn a_bar_presses_as_the_tissue_is_held_anywhere() {
    let turn = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.4, -1.1, 0.7));
    for axis in AXES {
        let bar = bar(0.0025, 0.3);
        let start = over(&bar, axis, 1e-4);
        let [mut here, mut there] = [Isometry3::identity(), turn].map(|turn| {
            let (mesh, fixed) = a_slab();
            let points = mesh.points_m().iter();
            let points = points.map(|p| (turn * Point3::from(*p)).coords.into());
            let cells = mesh.cells().to_vec();
            let mesh = TetMesh::new(points.collect(), cells).expect("the same slab");
            Held::new((mesh, fixed), bar, turn * start)
        });
        let mut felt = Vector3::zeros();
        for place in 0..20 {
            let by = match place {
                0..10 => Vector3::new(0.0, 0.0, -9e-5),
                _ => Vector3::new(9e-5, 3e-5, 0.0),
            };
            felt = force(&here.shift(by));
            let other = force(&there.shift(turn.rotation * by));
            let off = (turn.rotation * felt - other).norm();
            assert!(
                off <= 1e-9 * felt.norm(),
                "{axis:?} {place}: {off} of {felt}"
            );
        }
        let whole = here.model.equilibrium(&here.state).expect("a balance");
        let (mut pushed, mut kept) = (Vector3::zeros(), Vector3::zeros());
        for (at, force) in here.mesh.points_m().iter().zip(&whole.node_force_n) {
            let force = Vector3::from(*force);
            if at[2] < -0.008 + 1e-9 {
                kept += force;
            } else {
                pushed += force;
            }
        }
        assert!(felt.norm() > 0.05 && (felt - pushed).norm() < 1e-9 * felt.norm());
        assert!((felt + kept).norm() < 1e-9 * felt.norm(), "{axis:?}");
    }
}

/// Nothing is made of nothing: without friction the work is stored, with it some of it is lost.
#[test]
fn a_bars_work_is_stored_or_rubbed_away() {
    for friction in [0.0, 0.4] {
        let missing = [5e-5f64, 1.25e-5].map(|step_m| {
            let bar = bar(0.0025, friction);
            let mut held = Held::new(a_slab(), bar, over(&bar, AXES[0], 1e-6));
            let (mut work, mut before, mut most, mut off) = (0.0, Vector3::zeros(), 0.0f64, 0.0f64);
            for (way, far_m) in [
                (Vector3::new(0.0, 0.0, -1.0), 8e-4),
                (Vector3::new(1.0, 0.2, 0.0), 2e-3),
                (Vector3::new(0.0, 0.0, 1.0), 1e-3),
            ] {
                for _ in 0..(far_m / step_m).round() as usize {
                    let report = held.shift(way * step_m);
                    let now = force(&report);
                    work += 0.5 * (before + now).dot(&(way * step_m));
                    before = now;
                    most = most.max(report.stored_energy_j);
                    off = work - report.stored_energy_j;
                }
            }
            println!("mu {friction}, {step_m} m: {off:.2e} J of {most:.2e} J");
            off / most
        });
        if friction > 0.0 {
            assert!(missing[1] > 0.1, "{missing:?}");
        } else {
            let [long, short] = missing.map(f64::abs);
            assert!(short < 0.02 && short < 0.6 * long + 1e-3, "{missing:?}");
        }
    }
}

/// One that comes into the tissue without a way there is inside, and touches nothing until it has been outside.
#[test]
fn a_bar_that_begins_in_the_tissue_waits() {
    let bar = bar(0.0025, 0.3);
    let mut held = Held::new(a_slab(), bar, over(&bar, AXES[0], -0.005));
    let mut inside = 0;
    for _ in 0..20 {
        held.grip.translation.vector.z += 5e-4;
        let report = held.try_step();
        if report.status == Status::Inside {
            inside += 1;
            continue;
        }
        assert_eq!(report.status, Status::Ok);
        assert_eq!(
            (force(&report), report.contacts()[0].rows),
            (Vector3::zeros(), 0)
        );
    }
    // From its lowest point 5 mm below the surface until that is above it.
    assert!((8..12).contains(&inside), "{inside}");
    let mut last = Vector3::zeros();
    for _ in 0..20 {
        last = force(&held.shift(Vector3::new(0.0, 0.0, -3e-4)));
    }
    assert!(last.z < -0.01, "{last}");
}

#[test]
fn bars_without_a_shape_are_refused() {
    let (mesh, fixed) = a_slab();
    let good = bar(0.0025, 0.3);
    let refused = |parts: &[BarPart]| {
        let tools = [
            (4, Tool::new(Shape::Grip, [0.0; 3])),
            (5, Tool::sphere(0.01, [0.0; 3])),
        ];
        let model = Model::new(&mesh, MATERIAL, &fixed, Loads::default(), &tools);
        let model = model.expect("tissue").with_bars(&mesh, parts);
        model.map(|_| ()).expect_err("refused").to_string()
    };
    let of = |tool: u8, bar: Bar| BarPart { tool, bar };
    assert!(refused(&[of(5, good)]).contains("tool 5: a tool that is a grip"));
    assert!(refused(&[of(4, good), of(4, good)]).contains("a tool has one"));
    assert!(
        refused(&[of(
            4,
            Bar {
                radius_m: 0.0,
                ..good
            }
        )])
        .contains("radius is 0 m")
    );
    assert!(
        refused(&[of(
            4,
            Bar {
                length_m: f64::NAN,
                ..good
            }
        )])
        .contains("length is NaN m")
    );
    assert!(
        refused(&[of(
            4,
            Bar {
                friction: -0.1,
                ..good
            }
        )])
        .contains("friction is -0.1")
    );
    assert!(
        refused(&[of(
            4,
            Bar {
                axis: [2.0, 0.0, 0.0],
                ..good
            }
        )])
        .contains("unit vector")
    );
}

/// A scene's session: the console's grip has a body, another one is held beside it.
#[test]
fn a_session_feels_the_body_of_its_grip() {
    let text = r#"
        device = "cartesian-bench"
        [mesh.slab]
        size_m = [0.04, 0.04, 0.02]
        divisions = [8, 8, 4]
        [tissue]
        youngs_modulus_pa = 10e3
        poisson_ratio = 0.4
        [[fixed]]
        plane = { axis = "z", at_m = -0.02 }
        [[tool]]
        shape = "grip"
        body = { radius_m = 0.003, length_m = 0.02, axis = [1.0, 0.3, 0.0], friction = 0.2 }
        [[tool]]
        id = 3
        shape = "grip"
        position_m = [0.0, 0.0, 0.1]
        body = { radius_m = 0.003, length_m = 0.02 }
    "#;
    let document = Document::embedded("test.toml", "".as_ref(), text);
    let scene = Scene::read(&document, "test").expect("good");
    let mut solver = SceneSolver::new(&scene).expect("a solver");
    let mut last = Vector3::zeros();
    for place in 0..60u32 {
        let height_m = 0.0045 - 5e-5 * f64::from(place);
        let sample = ToolSample {
            id: 0,
            console_time_us: 10_000 * u64::from(place),
            ..Held::sample(&Isometry3::translation(0.01, 0.0, height_m))
        };
        let report = solver.step(sample);
        if report.status == Status::Waiting {
            continue;
        }
        assert_eq!(report.status, Status::Ok);
        let [x, y, z, ..] = report.contacts()[0].wrench;
        last = Vector3::new(x, y, z);
        assert!(
            height_m < 0.00301 || last == Vector3::zeros(),
            "{height_m}: {last}"
        );
    }
    assert!(last.z > 0.05, "{last}");
}
