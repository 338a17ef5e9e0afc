//! What the contact tests press, and how balances are checked.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use std::path::PathBuf;
use sutura_host::fem::{Loads, Material};
use sutura_host::mesh::{TetMesh, read_msh, slab};
use sutura_host::model::Model;
use sutura_host::step::{State, Status, StepOptions, StepReport, ToolContact, Workspace, step};
use sutura_host::tool::{ClosedMesh, Shape, Tool, ToolSample};

pub const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};
pub const RADIUS: f64 = 0.014;
/// Radius of the arch's top \[m\].
pub const ARCH: f64 = 0.06;

/// A model with what it takes to step it.
pub struct Bench {
    pub model: Model,
    pub work: Workspace,
    pub options: StepOptions,
}

impl Bench {
    pub fn new(mesh: &TetMesh, fixed: &[u32], loads: Loads, tools: &[(u8, Tool)]) -> Self {
        let model = Model::new(mesh, SOFT, fixed, loads, tools).expect("a model");
        Self::around(model)
    }

    /// Steps of it compute all columns that they need.
    pub fn around(model: Model) -> Self {
        Self {
            work: Workspace::new(&model),
            model,
            options: StepOptions::with_vertices(1000),
        }
    }

    /// The slab that the tests press: 80 x 80 x 30 mm on a table.
    pub fn slab(tool: Tool) -> Self {
        let (mesh, bottom) = slab_mesh();
        Self::new(&mesh, &bottom, Loads::default(), &[(0, tool)])
    }

    /// The same slab bent over a cylinder of 60 mm radius along y: a curved top.
    pub fn arch(tool: Tool) -> Self {
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
        Self::new(&mesh, &bottom, Loads::default(), &[(0, tool)])
    }

    /// A cylinder of 60 mm diameter lying along z, held at its ends.
    pub fn cylinder(tool: Tool) -> Self {
        let path =
            PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data/cylinder_1650.msh");
        let text = std::fs::read_to_string(path).expect("the cylinder");
        let mesh = read_msh(&text, 0.06).expect("a sound mesh");
        let ends: Vec<u32> = (0u32..)
            .zip(mesh.points_m())
            .filter(|(_, p)| p[2] < 1e-9 || p[2] > 0.12 - 1e-9)
            .map(|(node, _)| node)
            .collect();
        Self::new(&mesh, &ends, Loads::default(), &[(0, tool)])
    }

    /// One step with the tools there.
    pub fn follow(&mut self, state: &mut State, samples: &[ToolSample]) -> StepReport {
        step(&self.model, state, samples, &self.options, &mut self.work)
    }

    pub fn step(&mut self, state: &mut State, sample: ToolSample) -> StepReport {
        self.follow(state, &[sample])
    }

    /// A new state comes in from `from` to `to`: contact detected afresh.
    pub fn afresh(&mut self, from: ToolSample, to: ToolSample) -> (State, StepReport) {
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

    /// No vertex inside a tool, no force that pulls, forces only where vertices touch and along their
    /// normals. `samples` say where the tools are.
    pub fn assert_balanced(&self, state: &State, samples: &[ToolSample]) {
        let at = self
            .model
            .equilibrium(state)
            .expect("a balance")
            .displacement_m;
        let place = |node: u32| {
            Vector3::from(self.model.points_m()[node as usize]) + Vector3::from(at[node as usize])
        };
        let tools = samples.iter().map(|sample| {
            let of = |(id, _): &&(u8, Tool)| *id == sample.id;
            let (_, tool) = self.model.tools().iter().find(of).expect("a tool");
            (tool.clone(), *sample)
        });
        let tools: Vec<(Tool, ToolSample)> = tools.collect();
        for &node in &self.model.surface().vertices {
            if !self.model.is_fixed(node) {
                for (tool, sample) in &tools {
                    let (gap, _) = distance(tool, sample, &place(node));
                    let limit = -1e-9 * tool.radius_m();
                    assert!(gap > limit, "node {node} is {:e} m inside", -gap);
                }
            }
        }
        let largest = state
            .contact_forces(&self.model)
            .map(|(_, force)| Vector3::from(force).norm())
            .fold(0.0, f64::max);
        for (node, force) in state.contact_forces(&self.model) {
            let force = Vector3::from(force);
            // A force belongs to one of the tools: it fits its normal, and its gap is closed.
            let fits = tools.iter().any(|(tool, sample)| {
                let (gap, normal) = distance(tool, sample, &place(node));
                let lambda = force.dot(&normal);
                lambda >= -1e-9 * largest
                    && (force - normal * lambda).norm() < 1e-9 * largest
                    && (lambda * gap).abs() < 1e-9 * largest * tool.radius_m()
            });
            assert!(fits, "no tool can push node {node} with {force} N");
        }
    }
}

/// Signed distance and outward normal, outside a tool's core: from the nearest point of a sphere's centre, of a capsule's
/// segment, or of a punch or a box shrunk by its fillet.
pub fn distance(tool: &Tool, sample: &ToolSample, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let turn = rotation_of(sample);
    let centre = Vector3::from(sample.position_m) + turn * Vector3::from(tool.offset_m);
    let (nearest, swell) = match tool.shape {
        Shape::Grip => return (f64::MAX, Vector3::z()),
        Shape::Sphere { radius_m } => (centre, radius_m),
        Shape::FlatPunch {
            radius_m,
            fillet_m,
            length_m,
        } => {
            let axis = turn * Vector3::from(tool.axis);
            let arm = point - centre;
            let ahead = arm.dot(&axis);
            let aside = arm - axis * ahead;
            let shrink = ((radius_m - fillet_m) / aside.norm()).min(1.0);
            let ahead = ahead.clamp(fillet_m - length_m, -fillet_m);
            (centre + axis * ahead + aside * shrink, fillet_m)
        }
        Shape::Capsule { radius_m, length_m } => {
            let end = centre - turn * Vector3::from(tool.axis) * length_m;
            let way = end - centre;
            let part = (point - centre).dot(&way) / way.norm_squared();
            (centre.lerp(&end, part.clamp(0.0, 1.0)), radius_m)
        }
        Shape::RoundedBox { size_m, fillet_m } => {
            let (axis, side) = (Vector3::from(tool.axis), Vector3::from(tool.side));
            let frame = [side, axis.cross(&side), axis].map(|direction| turn * direction);
            let frame = Matrix3::from_columns(&frame);
            let mut at = frame.transpose() * (point - centre);
            let [x, y, z] = size_m;
            at.x = at.x.clamp(fillet_m - 0.5 * x, 0.5 * x - fillet_m);
            at.y = at.y.clamp(fillet_m - 0.5 * y, 0.5 * y - fillet_m);
            at.z = at.z.clamp(fillet_m - z, -fillet_m);
            (centre + frame * at, fillet_m)
        }
        Shape::Mesh { ref mesh, fillet_m } => {
            let (up, side) = (-Vector3::from(tool.axis), Vector3::from(tool.side));
            let frame = [side, up.cross(&side), up].map(|direction| turn * direction);
            let frame = Matrix3::from_columns(&frame);
            let (nearest, is_inside) = on_mesh(mesh, &(frame.transpose() * (point - centre)));
            let nearest = centre + frame * nearest;
            if is_inside {
                let arm = nearest - point;
                return (-arm.norm() - fillet_m, arm.normalize());
            }
            (nearest, fillet_m)
        }
    };
    let arm = point - nearest;
    (arm.norm() - swell, arm.normalize())
}

/// The point of a mesh nearest to `at`, by a look at all its triangles, and whether that is inside, by the solid angle
/// under which it sees them (van Oosterom & Strackee 1983).
fn on_mesh(mesh: &ClosedMesh, at: &Vector3<f64>) -> (Vector3<f64>, bool) {
    let (mut nearest, mut angle) = (Vector3::repeat(f64::MAX), 0.0);
    let mut take = |place: Vector3<f64>| {
        if (place - at).norm() < (nearest - at).norm() {
            nearest = place;
        }
    };
    for triangle in mesh.triangles() {
        let corners = triangle.map(|point| mesh.points_m()[point as usize]);
        let [a, b, c] = corners;
        let weights = Matrix3::from_columns(&[b - a, c - a, (b - a).cross(&(c - a))]);
        let weights = weights.try_inverse().expect("an area") * (at - a);
        if weights.x >= 0.0 && weights.y >= 0.0 && weights.x + weights.y <= 1.0 {
            take(a + (b - a) * weights.x + (c - a) * weights.y);
        }
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let part = (at - from).dot(&(to - from)) / (to - from).norm_squared();
            take(from.lerp(&to, part.clamp(0.0, 1.0)));
        }
        let [u, v, w] = corners.map(|corner| (corner - at).normalize());
        let over = 1.0 + u.dot(&v) + v.dot(&w) + w.dot(&u);
        angle += 2.0 * u.dot(&v.cross(&w)).atan2(over);
    }
    (nearest, angle > std::f64::consts::TAU)
}

pub fn slab_mesh() -> (TetMesh, Vec<u32>) {
    let mesh = slab([0.08, 0.08, 0.03], [16, 16, 6]).expect("a slab");
    (mesh, (0..17 * 17).collect())
}

pub fn pose(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> ToolSample {
    let q = rotation.coords;
    ToolSample {
        id: 0,
        position_m: position.into(),
        orientation: [q.x, q.y, q.z, q.w],
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

pub fn at(x: f64, y: f64, z: f64) -> ToolSample {
    pose(Vector3::new(x, y, z), UnitQuaternion::identity())
}

pub fn rotation_of(sample: &ToolSample) -> UnitQuaternion<f64> {
    let [x, y, z, w] = sample.orientation;
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// The ball that most tests press with.
pub fn ball(offset_m: [f64; 3]) -> Tool {
    Tool::sphere(RADIUS, offset_m)
}

pub fn contact(report: &StepReport) -> ToolContact {
    assert_eq!(report.status, Status::Ok);
    assert!(report.residual < 1e-10, "residual {:e}", report.residual);
    *report.contacts().first().expect("one tool")
}

pub fn force(contact: &ToolContact) -> Vector3<f64> {
    Vector3::from_column_slice(&contact.wrench[..3])
}

pub fn all_finite(report: &StepReport) -> bool {
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
