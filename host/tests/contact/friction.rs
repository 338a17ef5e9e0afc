//! Coulomb friction of tools, by rows of vertices that the balance of needles and threads solves with all others.

use super::bench::{RADIUS, SOFT, at, ball, contact, force, slab_mesh};
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::TetMesh;
use sutura_host::model::Model;
use sutura_host::needle::NeedleSettings;
use sutura_host::step::{State, Status, StepReport, ToolContact, Workspace, step};
use sutura_host::tool::{Shape, Tool, ToolSample};

/// A model whose tools are constraints among others.
struct Rig {
    model: Model,
    work: Workspace,
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
        let report = step(&self.model, state, &[sample], &mut self.work);
        assert_eq!(report.status, Status::Ok, "{report:?}");
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
                found.push(contact(&report));
            }
        }
        found
    }
}

#[test]
fn without_friction_the_rows_of_tools_find_what_their_own_newton_finds() {
    let punch = Tool::new(Shape::flat_punch(RADIUS, 0.04), [0.0; 3]);
    for (name, tool) in [("sphere", ball([0.0, 0.0, -0.01])), ("punch", punch)] {
        let (mesh, bottom) = slab_mesh();
        let mut rig = Rig::slab(tool);
        let plain = Model::new(&mesh, SOFT, &bottom, Loads::default(), &[(0, tool)]);
        let plain = plain.expect("a model");
        let mut work = Workspace::new(&plain);
        work.vertices_per_step = 1000;
        let (mut a, mut b) = (State::new(&rig.model), State::new(&plain));
        let bottom_m = if name == "sphere" { 0.01 + RADIUS } else { 0.0 };
        for (x, depth, turn) in [
            (0.0, -0.02, 0.0),
            (0.0, 0.001, 0.0),
            (0.0012, 0.004, 0.02),
            (0.0031, 0.006, 0.05),
            (0.0005, 0.002, -0.03),
        ] {
            let sample = super::bench::pose(
                Vector3::new(x, 0.0004, bottom_m - depth),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.2 * turn, turn, 0.0)),
            );
            let ours = rig.step(&mut a, sample);
            let theirs = step(&plain, &mut b, &[sample], &mut work);
            let (ours, theirs, solves) = (ours.contacts()[0], contact(&theirs), ours.solves);
            let off = (0..6).fold(0.0f64, |worst, k| {
                worst.max((ours.wrench[k] - theirs.wrench[k]).abs())
            });
            let size = force(&theirs).norm().max(1e-6);
            let mut tangent = 0.0f64;
            let stiff = theirs.tangent[2][2].abs().max(1.0);
            for (i, j) in (0..36).map(|entry| (entry / 6, entry % 6)) {
                let unit = stiff * 0.02f64.powi((i / 3 + j / 3) as i32);
                tangent = tangent.max((ours.tangent[i][j] - theirs.tangent[i][j]).abs() / unit);
            }
            println!(
                "{name} {depth:.3} m: {:.3} N, {} touches, {solves} solves, off by {:.1e}, tangent {tangent:.1e}",
                force(&theirs).norm(),
                ours.rows,
                off / size
            );
            assert!(off < 1e-8 * size);
            if depth > 0.0 && tangent > 1e-6 {
                println!("{:.3?}\n{:.3?}", ours.tangent, theirs.tangent);
            }
            if depth > 0.0 {
                assert!(tangent < 1e-6);
            }
        }
    }
}

#[test]
fn a_dragged_sphere_sticks_then_slides_at_mu_times_its_normal_force() {
    let mu = 0.3;
    let mut rig = Rig::slab(ball([0.0; 3]).with_friction(mu, mu));
    let mut state = State::new(&rig.model);
    let top = RADIUS;
    let (down, far) = (
        Vector3::new(-0.01, 0.0, top - 0.003),
        Vector3::new(0.012, 0.0, top - 0.003),
    );
    let found = rig.along(&mut state, &[down + Vector3::z() * 0.01, down, far]);
    for contact in &found {
        let force = force(contact);
        println!(
            "{:.4} N normal, {:.4} N along, ratio {:.4}, aside {:.1e}, {} touches",
            force.z,
            -force.x,
            -force.x / force.z,
            force.y,
            contact.rows
        );
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
            super::bench::pose(next + dx, UnitQuaternion::from_scaled_axis(turn))
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
