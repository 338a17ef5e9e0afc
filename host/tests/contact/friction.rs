//! Coulomb friction of tools, by rows of vertices that the balance of needles and threads solves with all others.

use super::bench::{RADIUS, SOFT, at, ball, contact, force, pose, slab_mesh};
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::model::Model;
use sutura_host::needle::NeedleSettings;
use sutura_host::step::{
    MAX_TOOL_ROWS, State, Status, StepOptions, StepReport, ToolContact, ToolRowKind, Workspace,
    step,
};
use sutura_host::tool::{Shape, Tool, ToolSample};

/// A model whose tools are constraints among others.
struct Rig {
    model: Model,
    work: Workspace,
}

/// Places along straight ways, so far apart, with the number of the way.
fn ways(places: &[Vector3<f64>], apart_m: f64) -> Vec<(usize, Vector3<f64>)> {
    let mut all = Vec::new();
    for (number, way) in places.windows(2).enumerate() {
        let count = ((way[1] - way[0]).norm() / apart_m).ceil() as u32;
        all.extend((1..=count).map(|part| {
            let part = f64::from(part) / f64::from(count);
            (number, way[0].lerp(&way[1], part))
        }));
    }
    all
}

fn settings() -> NeedleSettings {
    NeedleSettings {
        vertices_per_step: 1000,
        ..NeedleSettings::default()
    }
}

impl Rig {
    fn new(mesh: &TetMesh, fixed: &[u32], tool: Tool) -> Self {
        let model = Model::new(mesh, SOFT, fixed, Loads::default(), &[(0, tool)]);
        let model = model.expect("a model");
        let model = model
            .with_needles(mesh, &[], &[], settings())
            .expect("no needles");
        let work = Workspace::new(&model);
        Self { model, work }
    }

    fn slab(tool: Tool) -> Self {
        let (mesh, bottom) = slab_mesh();
        Self::new(&mesh, &bottom, tool)
    }

    fn step(&mut self, state: &mut State, sample: ToolSample) -> StepReport {
        let report = step(
            &self.model,
            state,
            &[sample],
            &StepOptions::default(),
            &mut self.work,
        );
        assert_eq!(report.status, Status::Ok);
        report
    }

    /// Along straight ways from place to place, 0.25 mm at a time.
    fn along(&mut self, state: &mut State, places: &[Vector3<f64>]) -> Vec<ToolContact> {
        let mut found = Vec::new();
        for way in places.windows(2) {
            let count = ((way[1] - way[0]).norm() / 2.5e-4).ceil().max(1.0) as usize;
            for part in 1..=count {
                let place = way[0].lerp(&way[1], part as f64 / count as f64);
                let report = self.step(state, at(place.x, place.y, place.z));
                found.push(report.contacts()[0]);
            }
        }
        found
    }
}

/// A block of 40 x 40 x 30 mm on a table, and a plate that covers its top: what it touches it touches with its flat face.
fn block() -> (TetMesh, Vec<u32>) {
    let mesh = slab([0.04, 0.04, 0.03], [8, 8, 6]).expect("a block");
    (mesh, (0..9 * 9).collect())
}

fn plate() -> Tool {
    Tool::new(Shape::flat_punch(0.045, 0.04), [0.0; 3])
}

/// Turned with the block or not: pressed by 1 mm and dragged along, in eight directions.
#[test]
fn a_plate_slides_at_mu_times_its_normal_force_in_every_direction() {
    let (mesh, bottom) = block();
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.7, -0.4, 1.1));
    let points = mesh
        .points_m()
        .iter()
        .map(|at| (turn * Vector3::from(*at)).into());
    let turned = TetMesh::new(points.collect(), mesh.cells().to_vec()).expect("the block");
    let mu = 0.3;
    let mut plain = Vec::new();
    for (mesh, turn) in [(&mesh, UnitQuaternion::identity()), (&turned, turn)] {
        let mut rig = Rig::new(mesh, &bottom, plate().with_friction(mu, mu));
        for direction in 0..8 {
            let angle = f64::from(direction) * std::f64::consts::FRAC_PI_4;
            let along = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let mut state = State::new(&rig.model);
            let down = Vector3::new(0.0, 0.0, -0.001);
            let mut ratios = Vec::new();
            let mut slid = Vector3::zeros();
            let places = [Vector3::new(0.0, 0.0, 0.004), down, down + along * 0.004];
            for (part, at) in ways(&places, 1.25e-4) {
                let report = rig.step(&mut state, pose(turn * at, turn));
                let felt = turn.inverse() * force(&report.contacts()[0]);
                if part == 1 {
                    slid = Vector3::new(felt.x, felt.y, 0.0);
                    ratios.push(slid.norm() / felt.z);
                }
            }
            let off = slid.angle(&-along).to_degrees();
            let (first, last) = (ratios[0], ratios[ratios.len() - 1]);
            println!("{direction}: {first:.4}, then slides at {last:.6}, {off:.3} degrees off");
            // It sticks at first; its force grows to the limit, and never beyond.
            assert!(first < 0.5 * mu && ratios.iter().all(|ratio| *ratio < mu * (1.0 + 1e-6)));
            assert!((last / mu - 1.0).abs() < 1e-3 && off < 0.1);
            if plain.len() < 8 {
                plain.push(last);
            } else {
                assert!((last - plain[direction as usize]).abs() < 1e-6);
            }
        }
    }
}

/// A single vertex under a wide sphere, driven aside in eight directions: it is torn off when its force across reaches the
/// static coefficient's part of that along the normal, and slides at the kinetic one's.
#[test]
fn a_vertex_is_torn_off_at_the_static_limit() {
    for (mu, rest) in [(0.3, 0.3), (0.2, 0.4)] {
        for direction in 0..8 {
            let angle = f64::from(direction) * std::f64::consts::FRAC_PI_4;
            let along = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let mut rig = Rig::slab(ball([0.0; 3]).with_friction(mu, rest));
            let mut state = State::new(&rig.model);
            let down = Vector3::new(0.0, 0.0, RADIUS - 2e-4);
            let mut places = ways(&[down + Vector3::z() * 0.004, down], 1e-4);
            let aside = ways(&[down, down + along * 2.4e-4], 1.3e-6);
            places.extend(aside.into_iter().map(|(_, at)| (1, at)));
            let (mut torn, mut slides) = (None, 0.0);
            let mut before = 0.0;
            for (part, at) in places {
                let report = rig.step(&mut state, pose(at, UnitQuaternion::identity()));
                if part == 0 {
                    continue;
                }
                let contact = &report.contacts()[0];
                assert_eq!(contact.rows, 1);
                // Across the normal where the vertex is: it has gone along with the tool.
                let felt = force(contact);
                slides = ratio(&rig, &state, &at, &felt);
                if torn.is_none() && slides < before {
                    torn = Some(before);
                }
                before = slides;
            }
            let torn = torn.unwrap_or(before);
            println!("{mu} {rest} {direction}: torn off at {torn:.5}, slides at {slides:.5}");
            assert!((torn / rest - 1.0).abs() < 0.01 && (slides / mu - 1.0).abs() < 0.01);
        }
    }
}

/// Force across over force along the normal of the only vertex that a ball at `centre` touches.
fn ratio(rig: &Rig, state: &State, centre: &Vector3<f64>, felt: &Vector3<f64>) -> f64 {
    let mut touched = state.contact_forces(&rig.model);
    let (node, _) = touched.next().expect("a vertex");
    let at = Vector3::from(state.positions(&rig.model)[node as usize]);
    let normal = (at - centre).normalize();
    let along = -felt.dot(&normal);
    (felt + normal * along).norm() / along
}

/// What the hand puts in is stored or rubbed away, under a ball and under a punch whose rim ploughs.
#[test]
fn the_energy_of_a_drag_is_stored_or_dissipated() {
    let punch = Tool::new(Shape::flat_punch(0.012, 0.03), [0.0; 3]);
    for (tool, height_m, depth_m) in [(ball([0.0; 3]), RADIUS, 0.003), (punch, 0.0, 0.001)] {
        let tool = tool.with_friction(0.3, 0.3);
        let mut rig = Rig::slab(tool);
        let mut state = State::new(&rig.model);
        let down = Vector3::new(-0.006, 0.0, height_m - depth_m);
        let places = [
            down + Vector3::z() * 0.005,
            down,
            down + Vector3::x() * 0.01,
            down + Vector3::new(0.01, 0.004, 0.0),
            down + Vector3::new(0.0, 0.004, 0.001),
        ];
        let (mut work_j, mut before) = (0.0, Vector3::zeros());
        let mut last = None;
        for way in places.windows(2) {
            let count = ((way[1] - way[0]).norm() / 2.5e-5).ceil() as u32;
            for part in 1..=count {
                let at = way[0].lerp(&way[1], f64::from(part) / f64::from(count));
                let report = rig.step(&mut state, pose(at, UnitQuaternion::identity()));
                let felt = force(&report.contacts()[0]);
                work_j -= 0.5 * (before + felt).dot(&((way[1] - way[0]) / f64::from(count)));
                before = felt;
                last = Some(report);
            }
        }
        let report = last.expect("steps");
        let (stored, rubbed) = (report.stored_energy_j, report.friction_j);
        println!("{work_j:.3e} J in, {stored:.3e} J stored, {rubbed:.3e} J rubbed");
        assert!(rubbed > 0.2 * work_j);
        assert!((stored + rubbed - work_j).abs() < 0.01 * work_j);
    }
}

#[test]
fn tangents_with_friction_are_those_of_whole_solves() {
    let mu = 0.3;
    let offset = [0.004, 0.0, -0.012];
    let mut rig = Rig::slab(ball(offset).with_friction(mu, mu));
    let top = Vector3::new(-0.004, 0.0, RADIUS + 0.012);
    let down = top - Vector3::z() * 0.003;
    for (name, last) in [
        ("sticks", down + Vector3::new(0.0002, 0.0001, -0.0001)),
        ("slides", down + Vector3::new(0.006, 0.002, 0.0)),
    ] {
        let mut state = State::new(&rig.model);
        rig.along(&mut state, &[top + Vector3::z() * 0.005, down, last]);
        let next = last + (last - down).normalize() * 1e-4;
        let sample = |dx: Vector3<f64>, turn: Vector3<f64>| {
            pose(next + dx, UnitQuaternion::from_scaled_axis(turn))
        };
        let mut solve = |sample| {
            let mut state = state.clone();
            contact(&rig.step(&mut state, sample))
        };
        let here = solve(sample(Vector3::zeros(), Vector3::zeros()));
        let mut worst = 0.0f64;
        for axis in 0..6 {
            let h = [1e-7, 1e-5][axis / 3];
            let mut by = Vector3::zeros();
            by[axis % 3] = h;
            let at = |way: f64, solve: &mut dyn FnMut(ToolSample) -> ToolContact| {
                let (dx, turn) = if axis < 3 {
                    (by * way, Vector3::zeros())
                } else {
                    (Vector3::zeros(), by * way)
                };
                solve(sample(dx, turn)).wrench
            };
            let wrenches = [-2.0, -1.0, 1.0, 2.0].map(|way| at(way, &mut solve));
            let [mm, m, p, pp] = wrenches;
            for row in 0..6 {
                let expected = (8.0 * (p[row] - m[row]) - (pp[row] - mm[row])) / (12.0 * h);
                let size = here.tangent[2][2].abs() * 0.02f64.powi((row / 3 + axis / 3) as i32);
                let error = (here.tangent[row][axis] - expected).abs() / size;
                if error > 1e-5 {
                    println!(
                        "{name} {row} {axis}: {} not {expected}",
                        here.tangent[row][axis]
                    );
                }
                worst = worst.max(error);
            }
        }
        println!("{name}: {} touches, largest error {worst:.1e}", here.rows);
        assert!(worst < 1e-6);
    }
}

/// Where more is touched than the console has cones for, those that stand for many keep the normal force, the limit of
/// friction, and the moment at which what is touched would spin: all within 5 %.
#[test]
fn merged_cones_keep_normal_force_friction_and_torsion() {
    let mu = 0.3;
    let options = StepOptions {
        most_rows: MAX_TOOL_ROWS,
        ..StepOptions::with_vertices(1000)
    };
    let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(0.05, -0.03, 0.0));
    for (name, tool, depth_m, turn) in [
        ("ball", ball([0.0; 3]), 0.005, tilted),
        (
            "punch",
            Tool::new(Shape::flat_punch(0.012, 0.04), [0.0; 3]),
            0.0015,
            tilted,
        ),
        (
            "wide punch",
            Tool::new(Shape::flat_punch(0.02, 0.04), [0.0; 3]),
            0.0015,
            UnitQuaternion::identity(),
        ),
    ] {
        let mut rig = Rig::slab(tool.clone().with_friction(mu, mu));
        let height_m = if name == "ball" { RADIUS } else { 0.0 };
        let mut state = State::new(&rig.model);
        let mut contact = None;
        let mut grip = Vector3::zeros();
        for part in -2..=10 {
            grip = Vector3::new(0.0013, -0.0021, height_m - depth_m * f64::from(part) / 10.0);
            let report = step(
                &rig.model,
                &mut state,
                &[pose(grip, turn)],
                &options,
                &mut rig.work,
            );
            assert_eq!(report.status, Status::Ok);
            contact = Some(report.contacts()[0]);
        }
        let axis = -force(&contact.expect("a contact")).normalize();
        let found = rig.model.equilibrium(&state).expect("a field");
        let all: Vec<(Vector3<f64>, f64)> = state
            .contact_forces(&rig.model)
            .map(|(node, force_n)| {
                let at = Vector3::from(rig.model.points_m()[node as usize])
                    + Vector3::from(found.displacement_m[node as usize]);
                let (_, normal) = super::bench::distance(&tool, &pose(grip, turn), &at);
                (at, normal.dot(&Vector3::from(force_n)))
            })
            .collect();
        let whole_n: f64 = all.iter().map(|(_, n)| n).sum();
        let centre = all.iter().map(|(at, n)| at * *n).sum::<Vector3<f64>>() / whole_n;
        let spin: f64 = all
            .iter()
            .map(|(at, n)| mu * n * axis.cross(&(at - centre)).norm())
            .sum();
        let rows = rig.work.rows(0).expect("rows");
        // A unit spin about the centre moves the grip, too.
        let twist = [-axis.cross(&(centre - grip)), axis];
        let moved = |row: usize| -> f64 {
            (0..6)
                .map(|i| rows.jacobian[row][i] * twist[i / 3][i % 3])
                .sum()
        };
        // Those with a row of their own rub by the nearest cone's coefficient, which is the larger for it.
        let (mut normal_n, mut limit_n, mut torsion) = (0.0, 0.0, 0.0);
        for row in 0..rows.count {
            match rows.kind[row] {
                ToolRowKind::Normal { friction } => {
                    normal_n += rows.lambda_n[row];
                    limit_n += friction * rows.lambda_n[row];
                    let turned = moved(row + 1).hypot(moved(row + 2));
                    torsion += friction * rows.lambda_n[row] * turned;
                }
                ToolRowKind::Smooth => normal_n += rows.lambda_n[row],
                ToolRowKind::Tangent => {}
            }
        }
        println!(
            "{name}: {} vertices in {} rows; normal force {:.4}, friction {:.4}, torsion {:.4} of what they have",
            all.len(),
            rows.count,
            normal_n / whole_n,
            limit_n / (mu * whole_n),
            torsion / spin
        );
        assert!(3 * all.len() > rows.count);
        assert!((normal_n / whole_n - 1.0).abs() < 1e-6);
        assert!((limit_n / (mu * whole_n) - 1.0).abs() < 0.05);
        assert!(
            (torsion / spin - 1.0).abs() < 0.05,
            "{name} {}",
            torsion / spin
        );
    }
}
