//! A block with jaws over it, and what its compliance says.

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};
use sutura_host::anchors::AnchorPoint;
use sutura_host::fem::{LinearTissue, Loads, Material, NodeLoad, Policy};
use sutura_host::jaws::{Jaws, JawsPart};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::model::{Model, Passes};
use sutura_host::step::{State, StepOptions, StepReport, Workspace, step};
use sutura_host::tool::{Act, Shape, Tool, ToolSample};

pub const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.4,
};

/// Points that [`jaws`] hold at [`over`]: two rows of three vertices, as what is nearest to the pads' corners follows from these.
pub const HELD: u32 = 6;

/// Pads that reach a little beyond two rows of vertices of [`block`].
pub fn jaws(clamp_n: f64) -> Jaws {
    Jaws {
        width_m: 0.0064,
        ..Jaws::new(clamp_n, 0.5)
    }
}

/// Where they do so: the pads' fronts are 5 mm below the top.
pub fn over() -> Isometry3<f64> {
    at(0.003, 0.001, -0.005)
}

pub const ALL: StepOptions = StepOptions::with_vertices(usize::MAX);

/// A block whose top is z = 0.
pub fn block() -> TetMesh {
    slab([0.06, 0.04, 0.02], [10, 8, 4]).expect("a block")
}

/// Its bottom's nodes.
pub fn bottom(mesh: &TetMesh) -> Vec<u32> {
    let low = mesh.points_m().iter().fold(0.0f64, |low, x| low.min(x[2]));
    let nodes = (0u32..).zip(mesh.points_m());
    nodes
        .filter(|(_, x)| x[2] < low + 1e-9)
        .map(|(node, _)| node)
        .collect()
}

/// Tissue, jaws on the tools 1, 2 and so on, and what they did last.
pub struct Rig {
    pub mesh: TetMesh,
    pub model: Model,
    pub state: State,
    pub work: Workspace,
    pub options: StepOptions,
}

impl Rig {
    pub fn new(jaws: &[Jaws]) -> Self {
        Self::on(block(), jaws, |mesh, fixed, tools| {
            Model::new(mesh, SOFT, fixed, Loads::default(), tools).expect("tissue")
        })
    }

    pub fn turning(jaws: &[Jaws]) -> Self {
        let passes = Passes {
            most: 30,
            tolerance: 1e-11,
        };
        Self::on(block(), jaws, |mesh, fixed, tools| {
            // A fresh factor in every pass: the tangent is that of the balance.
            let policy = Policy {
                refactor_every: 0,
                ..Policy::default()
            };
            let loads = Loads::default();
            Model::corotational(mesh, SOFT, fixed, loads, tools, policy, passes).expect("tissue")
        })
    }

    pub fn on(
        mesh: TetMesh,
        jaws: &[Jaws],
        tissue: impl Fn(&TetMesh, &[u32], &[(u8, Tool)]) -> Model,
    ) -> Self {
        let ids = 1..=jaws.len() as u8;
        let tools: Vec<_> = ids
            .clone()
            .map(|id| (id, Tool::new(Shape::Grip, [0.0; 3])))
            .collect();
        let parts: Vec<_> = ids
            .zip(jaws)
            .map(|(tool, jaws)| JawsPart { tool, jaws: *jaws })
            .collect();
        let model = tissue(&mesh, &bottom(&mesh), &tools);
        let model = model.with_jaws(&mesh, &parts).expect("jaws");
        let (state, work) = (State::new(&model), Workspace::new(&model));
        Self {
            mesh,
            model,
            state,
            work,
            options: ALL,
        }
    }

    /// A step with the tools at these poses, in order.
    pub fn step(&mut self, poses: &[Isometry3<f64>]) -> StepReport {
        let report = self.try_step(poses);
        assert_eq!(report.status.name(), "ok");
        report
    }

    pub fn try_step(&mut self, poses: &[Isometry3<f64>]) -> StepReport {
        let samples: Vec<ToolSample> = (1u8..)
            .zip(poses)
            .map(|(id, pose)| sample(id, pose))
            .collect();
        step(
            &self.model,
            &mut self.state,
            &samples,
            &self.options,
            &mut self.work,
        )
    }

    /// Has the jaws of a tool take hold with all tools at these poses.
    pub fn close(&mut self, tool: u8, poses: &[Isometry3<f64>]) -> StepReport {
        self.step(poses);
        assert!(self.state.act(&self.model, Act::Close(tool)));
        self.step(poses)
    }

    pub fn open(&mut self, tool: u8) {
        assert!(self.state.act(&self.model, Act::Open(tool)));
    }

    pub fn positions(&self) -> Vec<[f64; 3]> {
        self.state.positions(&self.model)
    }

    /// The tangent of the first tool's wrench at a pose by central differences of whole steps from here, (6 x 6).
    pub fn slopes(&mut self, pose: &Isometry3<f64>, by: f64) -> Matrix6<f64> {
        let start = self.state.clone();
        let mut slopes = Matrix6::zeros();
        for axis in 0..6 {
            let [ahead, behind] = [by, -by].map(|by| {
                self.state = start.clone();
                let report = self.step(&[moved(pose, axis, by)]);
                Vector6::from(report.contacts()[0].wrench)
            });
            slopes.set_column(axis, &((ahead - behind) / (2.0 * by)));
        }
        self.state = start;
        slopes
    }
}

pub fn sample(id: u8, pose: &Isometry3<f64>) -> ToolSample {
    ToolSample {
        id,
        position_m: pose.translation.vector.into(),
        orientation: pose.rotation.coords.into(),
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

pub fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

/// Moved along an axis, or turned about the grip.
pub fn moved(pose: &Isometry3<f64>, axis: usize, by: f64) -> Isometry3<f64> {
    let mut moved = *pose;
    if axis < 3 {
        moved.translation.vector[axis] += by;
    } else {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis - 3, by));
        moved.rotation = turn * moved.rotation;
    }
    moved
}

pub fn place(of: &AnchorPoint, at_m: &[[f64; 3]]) -> Vector3<f64> {
    let parts = of.nodes.iter().zip(of.weights);
    parts
        .map(|(node, weight)| Vector3::from(at_m[*node as usize]) * weight)
        .sum()
}

/// Compliance between points of linear tissue, (3p x 3p) \[m/N\], column by column from a solve of all of it.
pub fn compliance(mesh: &TetMesh, points: &[AnchorPoint]) -> Vec<Vec<f64>> {
    let tissue = LinearTissue::new(mesh, SOFT, &bottom(mesh)).expect("tissue");
    let columns = (0..3 * points.len()).map(|column| {
        let point = &points[column / 3];
        let axis = Vector3::ith(column % 3, 1.0);
        let loaded = point.nodes.iter().zip(point.weights);
        let loads = Loads {
            forces: loaded
                .map(|(node, weight)| NodeLoad {
                    node: *node,
                    force_n: (axis * weight).into(),
                })
                .collect(),
            ..Loads::default()
        };
        let found = tissue.solve(&loads).expect("a balance").displacement_m;
        let moved = points.iter().map(|point| place(point, &found));
        moved.flat_map(|at| [at.x, at.y, at.z]).collect()
    });
    columns.collect()
}

/// Solves `a x = b` by elimination with pivots; `a` by columns.
fn eliminate(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for step in 0..n {
        let size = |row: &usize| a[step][*row].abs();
        let pivot = (step..n).max_by(|i, j| size(i).total_cmp(&size(j)));
        let pivot = pivot.expect("a row");
        a.iter_mut().for_each(|column| column.swap(step, pivot));
        b.swap(step, pivot);
        for row in step + 1..n {
            let part = a[step][row] / a[step][step];
            for column in a[step..].iter_mut() {
                column[row] -= part * column[step];
            }
            b[row] -= part * b[step];
        }
    }
    for row in (0..n).rev() {
        let known: f64 = (row + 1..n).map(|column| a[column][row] * b[column]).sum();
        b[row] = (b[row] - known) / a[row][row];
    }
    b
}

/// Force and moment about a place \[N\], \[N m\] on what holds points of linear tissue, that moved by `ways` from where they
/// rest.
pub fn wrench_of(
    mesh: &TetMesh,
    points: &[AnchorPoint],
    held: &[Vector3<f64>],
    about: &Vector3<f64>,
) -> Vector6<f64> {
    let ways = points.iter().zip(held).flat_map(|(point, held)| {
        let way = held - place(point, mesh.points_m());
        [way.x, way.y, way.z]
    });
    let forces = eliminate(compliance(mesh, points), ways.collect());
    let mut wrench = Vector6::zeros();
    for (place, held) in held.iter().enumerate() {
        let force = -Vector3::from_column_slice(&forces[3 * place..3 * place + 3]);
        let moment = (held - about).cross(&force);
        wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
    }
    wrench
}

/// How far two tangents are from each other, over the largest entry; a radian counts as much as 1 cm.
pub fn apart(a: &Matrix6<f64>, b: &Matrix6<f64>) -> f64 {
    let scale = |i: usize| if i < 3 { 1.0 } else { 0.01 };
    let scaled = |m: &Matrix6<f64>| Matrix6::from_fn(|i, j| m[(i, j)] / (scale(i) * scale(j)));
    (scaled(a) - scaled(b)).amax() / scaled(b).amax()
}

pub fn tangent_of(report: &StepReport) -> Matrix6<f64> {
    Matrix6::from_fn(|i, j| report.contacts()[0].tangent[i][j])
}
