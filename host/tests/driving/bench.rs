//! Tissue, a needle, and a tool that holds it.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use sutura_host::fem::{Loads, Material, Policy};
use sutura_host::mesh::{TetMesh, slab, tube};
use sutura_host::model::{Model, Passes};
use sutura_host::needle::{
    Needle, NeedlePart, NeedleReport, NeedleSettings, NeedleShape, NeedleTissue,
};
use sutura_host::step::{State, Status, StepReport, Workspace, step};
use sutura_host::tool::{Shape, Tool, ToolSample};

pub const MATERIAL: Material = Material {
    youngs_modulus_pa: 20e3,
    poisson_ratio: 0.4,
};

pub const THICKNESS_M: f64 = 0.8e-3;

/// 0.2 N to break through, 0.05 N to cut, 5 N/m of friction: 0.1 N for 20 mm.
pub fn tissue() -> NeedleTissue {
    let area = 0.25 * std::f64::consts::PI * THICKNESS_M * THICKNESS_M;
    NeedleTissue {
        friction_n_per_m: 5.0,
        static_friction_n_per_m: 5.0,
        viscous_n_s_per_m2: 0.0,
        cutting_pa: 0.05 / area,
        puncture_pa: 0.2 / area,
    }
}

/// Two slabs of 30 x 30 x 8 mm one above the other, 4 mm apart, the lower top at z = 0, fixed at their sides in x.
pub fn slabs() -> (TetMesh, Vec<u32>) {
    let one = slab([0.03, 0.03, 0.008], [7, 7, 3]).expect("a slab");
    let lift = |by: f64| {
        let points = one.points_m().iter().map(|p| [p[0], p[1], p[2] + by]);
        TetMesh::new(points.collect(), one.cells().to_vec()).expect("the same slab")
    };
    let both = lift(0.012).beside(&lift(0.0)).expect("apart");
    let fixed = (0u32..)
        .zip(both.points_m())
        .filter(|(_, p)| p[0].abs() > 0.0149)
        .map(|(node, _)| node)
        .collect();
    (both, fixed)
}

/// A tube, its lower end held.
pub fn a_tube() -> (TetMesh, Vec<u32>) {
    let mesh = tube([0.006, 0.01], [0.0, 0.03], [3, 24, 9]).expect("a tube");
    let low = mesh
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MAX, f64::min);
    let fixed = (0u32..)
        .zip(mesh.points_m())
        .filter(|(_, p)| p[2] < low + 1e-9)
        .map(|(node, _)| node)
        .collect();
    (mesh, fixed)
}

pub struct Bench {
    pub model: Model,
    pub state: State,
    pub work: Workspace,
    pub grip: Isometry3<f64>,
    pub time_us: u64,
}

pub fn straight(length_m: f64) -> Needle {
    Needle {
        shape: NeedleShape::Straight { length_m },
        thickness_m: THICKNESS_M,
    }
}

pub fn arc(radius_m: f64, angle_deg: f64) -> Needle {
    Needle {
        shape: NeedleShape::Arc {
            radius_m,
            angle_rad: angle_deg.to_radians(),
        },
        thickness_m: THICKNESS_M,
    }
}

/// A needle's frame with its end at `end`, its tangent there along `direction`.
pub fn frame(end: [f64; 3], direction: [f64; 3], towards: [f64; 3]) -> Isometry3<f64> {
    let along = Vector3::from(direction).normalize();
    let towards = Vector3::from(towards);
    let inward = (towards - along * along.dot(&towards)).normalize();
    let axes = nalgebra::Matrix3::from_columns(&[along, inward, along.cross(&inward)]);
    let turn = UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix(&axes));
    Isometry3::from_parts(Translation3::from(end), turn)
}

pub enum Kind {
    Linear,
    Corotational(Passes),
}

impl Bench {
    pub fn new(
        (mesh, fixed): (TetMesh, Vec<u32>),
        kind: Kind,
        needle: Needle,
        start: Isometry3<f64>,
        tissue: NeedleTissue,
        settings: NeedleSettings,
    ) -> Self {
        let tools = [
            (0, Tool::new(Shape::Grip, [0.0; 3])),
            (1, Tool::new(Shape::Grip, [0.0; 3])),
        ];
        let loads = Loads::default();
        let model = match kind {
            Kind::Linear => Model::new(&mesh, MATERIAL, &fixed, loads, &tools),
            Kind::Corotational(passes) => {
                let policy = Policy::default();
                Model::corotational(&mesh, MATERIAL, &fixed, loads, &tools, policy, passes)
            }
        }
        .expect("tissue");
        let part = NeedlePart {
            id: 0,
            needle,
            start,
        };
        let tissue = vec![tissue; mesh.cells().len()];
        let model = model
            .with_needles(&mesh, &[part], &tissue, settings)
            .expect("a needle");
        let mut state = State::new(&model);
        let mut work = Workspace::new(&model);
        work.prepare(&model, |_| true);
        let mut bench = Self {
            grip: start,
            time_us: 0,
            state: state.clone(),
            work,
            model,
        };
        assert!(state.hold(&bench.model, 0, Some(&bench.sample())));
        bench.state = state;
        bench
    }

    pub fn sample(&self) -> ToolSample {
        let turn = self.grip.rotation.coords;
        ToolSample {
            id: 0,
            position_m: self.grip.translation.vector.into(),
            orientation: [turn.x, turn.y, turn.z, turn.w],
            velocity_m_per_s: [0.0; 3],
            console_time_us: self.time_us,
        }
    }

    /// One step with the grip at `self.grip`.
    pub fn step(&mut self) -> StepReport {
        self.time_us += 5000;
        let sample = self.sample();
        step(&self.model, &mut self.state, &[sample], &mut self.work)
    }

    /// As [`Self::step`], which must go well.
    pub fn go(&mut self) -> (StepReport, NeedleReport) {
        let report = self.step();
        assert_eq!(report.status, Status::Ok);
        (report, report.needles()[0])
    }
}
