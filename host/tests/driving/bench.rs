//! Tissue, a needle, and a tool that holds it.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use sutura_host::fem::{Hyperelasticity, Loads, Material, Policy};
use sutura_host::mesh::{TetMesh, slab, tube};
use sutura_host::model::{Model, Passes};
use sutura_host::needle::{
    Crossing, CrossingFriction, History, Needle, NeedlePart, NeedleReport, NeedleSegment,
    NeedleSegments, NeedleSettings, NeedleShape, NeedleTissue,
};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::thread::{ThreadPart, ThreadPoint, Through};
use sutura_host::tool::{Shape, Tool, ToolSample};
use sutura_models::hyperelastic::Cells;
use sutura_models::law::Law;

pub const MATERIAL: Material = Material {
    youngs_modulus_pa: 20e3,
    poisson_ratio: 0.4,
};

pub const THICKNESS_M: f64 = 0.8e-3;

/// Id of the first needle's thread.
pub const THREAD: u8 = 7;

/// 0.2 N to break through, 0.05 N to cut, 5 N/m of friction: 0.1 N for 20 mm.
pub fn tissue() -> NeedleTissue {
    let area = 0.25 * std::f64::consts::PI * THICKNESS_M * THICKNESS_M;
    NeedleTissue {
        friction_n_per_m: 5.0,
        static_friction_n_per_m: 5.0,
        viscous_n_s_per_m2: 0.0,
        cutting_pa: 0.05 / area,
        puncture_pa: 0.2 / area,
        surface_friction: f64::INFINITY,
    }
}

/// Two slabs of 30 x 30 x 8 mm one above the other, 4 mm apart, the lower top at z = 0, fixed at their sides in x.
pub fn slabs() -> (TetMesh, Vec<u32>) {
    slabs_apart(0.004)
}

/// The same so far apart.
pub fn slabs_apart(gap_m: f64) -> (TetMesh, Vec<u32>) {
    let one = slab([0.03, 0.03, 0.008], [7, 7, 3]).expect("a slab");
    let lift = |by: f64| {
        let points = one.points_m().iter().map(|p| [p[0], p[1], p[2] + by]);
        TetMesh::new(points.collect(), one.cells().to_vec()).expect("the same slab")
    };
    let both = lift(0.008 + gap_m).beside(&lift(0.0)).expect("apart");
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
    pub mesh: TetMesh,
    pub model: Model,
    pub state: State,
    pub work: Workspace,
    /// Where tool 0 is.
    pub grip: Isometry3<f64>,
    /// Where tool 1 is.
    pub other: Isometry3<f64>,
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

/// Of lengths with radii, infinite where it is straight.
pub fn of_segments(segments: &[(f64, f64)]) -> Needle {
    let each = segments.iter().map(|(length_m, radius_m)| NeedleSegment {
        length_m: *length_m,
        radius_m: *radius_m,
    });
    let each: Vec<_> = each.collect();
    let segments = NeedleSegments::new(&each).expect("a few");
    Needle {
        shape: NeedleShape::Segments(segments),
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
    Hyperelastic(Passes, Policy),
}

impl Bench {
    /// The path of a thread.
    pub fn path(&self, thread: u8) -> Vec<ThreadPoint> {
        let nodes_m = self.state.positions(&self.model);
        self.state.thread_path(&self.model, thread, &nodes_m)
    }

    pub fn new(
        mesh: (TetMesh, Vec<u32>),
        kind: Kind,
        needle: Needle,
        start: Isometry3<f64>,
        tissue: NeedleTissue,
        settings: NeedleSettings,
    ) -> Self {
        let tissue = vec![tissue; mesh.0.cells().len()];
        Self::of(mesh, kind, needle, start, &tissue, settings)
    }

    pub fn of(
        mesh: (TetMesh, Vec<u32>),
        kind: Kind,
        needle: Needle,
        start: Isometry3<f64>,
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Self {
        Self::many(mesh, kind, &[(needle, start)], MATERIAL, tissue, settings)
    }

    /// Tool 0 holds the first needle, tool 1 the second, both at their frames.
    pub fn many(
        mesh: (TetMesh, Vec<u32>),
        kind: Kind,
        needles: &[(Needle, Isometry3<f64>)],
        material: Material,
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Self {
        let loads = Loads::default();
        Self::loaded(mesh, kind, needles, (material, loads), tissue, settings)
    }

    /// The same under loads and handles.
    pub fn loaded(
        mesh: (TetMesh, Vec<u32>),
        kind: Kind,
        needles: &[(Needle, Isometry3<f64>)],
        loaded: (Material, Loads),
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Self {
        Self::built(mesh, kind, (needles, false), loaded, tissue, settings)
    }

    /// The same with needles that have bodies, or not.
    pub fn built(
        mesh: (TetMesh, Vec<u32>),
        kind: Kind,
        (needles, body): (&[(Needle, Isometry3<f64>)], bool),
        loaded: (Material, Loads),
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Self {
        let parts = (0u8..)
            .zip(needles)
            .map(|(id, &(needle, start))| NeedlePart {
                id,
                needle,
                start,
                body,
                weight: None,
            });
        let parts: Vec<_> = parts.collect();
        Self::of_parts(mesh, kind, &parts, loaded, tissue, settings)
    }

    /// The same of whole needles.
    pub fn of_parts(
        (mesh, fixed): (TetMesh, Vec<u32>),
        kind: Kind,
        parts: &[NeedlePart],
        (material, loads): (Material, Loads),
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Self {
        let tools = [0, 1].map(|id| (id, Tool::new(Shape::Grip, [0.0; 3])));
        let model = match kind {
            Kind::Linear => Model::new(&mesh, material, &fixed, loads, &tools),
            Kind::Corotational(passes) => {
                let policy = Policy::default();
                Model::corotational(&mesh, material, &fixed, loads, &tools, policy, passes)
            }
            Kind::Hyperelastic(passes, policy) => {
                let substance = Hyperelasticity {
                    laws: &[Law::neo_hookean(material)],
                    cells: Cells::Linear,
                };
                Model::hyperelastic(&mesh, &substance, &fixed, loads, &tools, policy, passes)
            }
        }
        .expect("tissue");
        let model = model
            .with_needles(&mesh, parts, tissue, settings)
            .expect("needles");
        let mut work = Workspace::new(&model);
        work.prepare(&model, |_| true);
        let grips = [0, 1].map(|tool| parts.get(tool).unwrap_or(&parts[0]).start);
        let mut bench = Self {
            grip: grips[0],
            other: grips[1],
            time_us: 0,
            state: State::new(&model),
            work,
            model,
            mesh,
        };
        for part in parts {
            assert!(bench.hold(part.id, Some(part.id)));
        }
        bench
    }

    /// The same with a thread on the first needle, begun anew.
    pub fn with_thread(mut self, length_m: f64) -> Self {
        let part = ThreadPart {
            id: THREAD,
            needle: 0,
            length_m,
            friction: 0.0,
            strength_n: 20.0,
            through: Through::default(),
        };
        self.model = self.model.with_threads(&[part]).expect("a thread");
        self.state = State::new(&self.model);
        self.work = Workspace::new(&self.model);
        self.work.prepare(&self.model, |_| true);
        assert!(self.hold(0, Some(0)));
        self
    }

    /// What the first needle's thread goes through, and the needle.
    pub fn both(&self) -> [Vec<Crossing>; 2] {
        let thread = self.state.thread_crossings(&self.model, THREAD).copied();
        let needle = self.state.crossings(&self.model, 0);
        [thread.collect(), needle.to_vec()]
    }

    /// The list goes from the tail, or the end of a needle without a thread, to the tip from cell to cell, alpha never falls, and
    /// ways into and out of tissue alternate.
    pub fn is_in_order(&self) {
        let mesh = self.mesh.half_faces();
        let history = self.state.needle_history(&self.model, 0);
        let history = history.expect("a needle");
        let [thread, needle] = self.both();
        let mut whole = History::new(thread.len() + needle.len());
        if thread.is_empty() {
            whole.restart(history.before(), None);
        } else {
            let last = thread.last().and_then(|last| last.to(mesh));
            assert_eq!(last, history.before(), "{thread:?} {needle:?}");
        }
        let all = || thread.iter().chain(&needle);
        assert!(all().all(|crossing| whole.push(*crossing)));
        assert_eq!(whole.check(mesh, f64::INFINITY), Ok(()), "{whole:?}");
        let turns = all().filter(|c| c.enters || c.leaves(mesh));
        let turns: Vec<bool> = turns.map(|c| c.enters).collect();
        let alternate = turns.windows(2).all(|pair| pair[0] != pair[1]);
        assert!(alternate, "{turns:?}");
        assert_eq!(whole.tip_cell(mesh), history.tip_cell(mesh));
    }

    /// Has a tool take a needle where both are.
    pub fn hold(&mut self, needle: u8, tool: Option<u8>) -> bool {
        let sample = tool.map(|tool| self.sample_of(tool));
        self.state.hold(&self.model, needle, sample.as_ref())
    }

    pub fn sample(&self) -> ToolSample {
        self.sample_of(0)
    }

    pub fn sample_of(&self, tool: u8) -> ToolSample {
        let grip = if tool == 0 { &self.grip } else { &self.other };
        let turn = grip.rotation.coords;
        ToolSample {
            id: tool,
            position_m: grip.translation.vector.into(),
            orientation: [turn.x, turn.y, turn.z, turn.w],
            velocity_m_per_s: [0.0; 3],
            console_time_us: self.time_us,
        }
    }

    /// Of all nodes.
    pub fn largest_displacement_m(&self) -> f64 {
        let whole = self.model.equilibrium(&self.state).expect("a balance");
        let lengths = whole
            .displacement_m
            .iter()
            .map(|u| Vector3::from(*u).norm());
        lengths.fold(0.0, f64::max)
    }

    /// One step with the tools there.
    pub fn follow(&mut self, samples: &[ToolSample]) -> StepReport {
        let options = StepOptions::default();
        step(
            &self.model,
            &mut self.state,
            samples,
            &options,
            &mut self.work,
        )
    }

    /// One step with the grip at `self.grip`.
    pub fn step(&mut self) -> StepReport {
        self.time_us += 5000;
        let sample = self.sample();
        self.follow(&[sample])
    }

    /// One step with both tools.
    pub fn step_both(&mut self) -> StepReport {
        self.time_us += 5000;
        let samples = [self.sample_of(0), self.sample_of(1)];
        self.follow(&samples)
    }

    /// What must be so after any step: numbers finite, histories in order, friction within its bounds and
    /// no slide without all of it.
    pub fn look(&self, report: &StepReport) {
        for contact in report.contacts() {
            let numbers = contact.wrench.iter().chain(contact.tangent.as_flattened());
            assert!(numbers.into_iter().all(|x| x.is_finite()), "{contact:?}");
        }
        for needle in report.needles() {
            let spent: f64 = needle.dissipated_j.iter().sum();
            let all = [needle.axial_n, needle.hold_n, spent, report.stored_energy_j];
            assert!(all.iter().all(|x| x.is_finite()), "{needle:?}");
        }
        for needle in 0..4 {
            let Some(pose) = self.state.needle_pose(&self.model, needle) else {
                return;
            };
            let coords = pose.to_homogeneous();
            assert!(coords.iter().all(|x| x.is_finite()), "{pose:?}");
            let history = self.state.needle_history(&self.model, needle);
            let history = history.expect("the needle's");
            // Its own length is checked by the crossings' places.
            let checked = history.check(self.mesh.half_faces(), 1.0);
            let alphas = || history.crossings().iter().map(|crossing| crossing.alpha);
            assert_eq!(checked, Ok(()), "{:?}", alphas().collect::<Vec<f64>>());
            // One that lies loose goes on moving after its last solve.
            let held = report
                .needles()
                .iter()
                .any(|own| own.id == needle && own.held_by.is_some());
            if !held {
                continue;
            }
            // What has been folded is kept in order, away from where its forces hold.
            if report.needles().iter().any(|own| own.guessed > 0) {
                continue;
            }
            for (place, rubbing) in self.state.rubbing(&self.model, needle).enumerate() {
                let CrossingFriction {
                    axial_n,
                    limit_n,
                    slid_m,
                } = rubbing;
                // Known to 1e-8 of the needle, an arc's tangent lets so much of the force across it in.
                let slack = 1e-6;
                assert!(axial_n.abs() <= limit_n + slack, "{place}: {rubbing:?}");
                let inside = axial_n.abs() < limit_n - slack;
                assert!(!inside || slid_m.abs() < 1e-9, "{place}: {rubbing:?}");
                // The needle runs ahead of what it drags.
                let slides = slid_m.abs() > 1e-9;
                assert!(
                    !slides || axial_n * slid_m <= slack * slid_m.abs(),
                    "{place}: {rubbing:?}"
                );
            }
        }
    }

    /// As [`Self::step`], looked at.
    pub fn try_step(&mut self) -> StepReport {
        let report = self.step();
        self.look(&report);
        report
    }

    /// As [`Self::step`], which must go well.
    pub fn go(&mut self) -> (StepReport, NeedleReport) {
        let report = self.step();
        assert_eq!(report.status, Status::Ok);
        (report, report.needles()[0])
    }
}
