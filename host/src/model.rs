//! What is constant once a scene is loaded: tissue, its boundary, its loads, and the tools' shapes.
//!
//! Entry point: [`Model::new`].

use crate::body::{Body, Motion};
use crate::collide::{TouchError, TouchPart, TouchSettings, Touching};
use crate::contact::shape::Solid;
use crate::fem::{
    CorotationalTissue, Equilibrium, Factored, HeldPoints, HyperelasticState, HyperelasticTissue,
    Hyperelasticity, LinearTissue, Loads, Materials, NodeLoad, Policy, TissueError,
    principal_stress_pa,
};
use crate::jaws::JawsPart;
use crate::mesh::{Surface, TetMesh};
use crate::needle::{NeedleError, NeedlePart, NeedleSettings, NeedleTissue};
use crate::rod::{BarPart, BodyContact, PairPart};
use crate::source::{Added, Handles, MOST_NODES};
use crate::step::{self, DEFAULT_CACHE_BYTES, NoRest, Sources, State, Status};
use crate::thread::{Contact, ThreadContact, ThreadError, ThreadPart, Threads};
use crate::tool::{MAX_TOOLS, Shape, Tool, ToolSample};
use nalgebra::Vector3;
use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// Radius of a tool in mean boundary edges below which the measured error of its force is said: above it that is below 5 %.
pub const LEAST_RADIUS_IN_EDGES: f64 = 3.0;
/// Radius in mean boundary edges with which the mesh hardly matters.
pub const ACCURATE_RADIUS_IN_EDGES: f64 = 4.0;

/// Least radius in mean boundary edges of which the error is measured.
pub const LEAST_MEASURED_IN_EDGES: f64 = 0.5;

/// Error of the force of a ball against an independent value \[%\], by its radius in mean boundary edges: over 20 places of
/// a cell, pressed in by a sixth and by a half of the radius, the root of the mean square and the largest, each the
/// larger of both depths. A ball of less than an edge counts as one of an edge. Measured by
/// `host/tests/contact/small.rs`.
const MEASURED: [(f64, [f64; 2]); 4] = [
    (LEAST_MEASURED_IN_EDGES, [2840.0, 3050.0]),
    (1.0, [44.0, 100.0]),
    (2.0, [7.5, 16.0]),
    (ACCURATE_RADIUS_IN_EDGES, [2.0, 3.5]),
];

/// Measured error of a tool's force \[%\] for a radius of so many mean boundary edges: the root of the mean square over
/// places on a mesh, and the largest. Straight between what was measured, by logarithms, and the same above; none below
/// [`LEAST_MEASURED_IN_EDGES`], of which nothing was measured.
pub fn measured_error_percent(radius_in_edges: f64) -> Option<[f64; 2]> {
    if radius_in_edges.is_nan() || radius_in_edges < LEAST_MEASURED_IN_EDGES {
        return None;
    }
    let (mut below, mut above) = (MEASURED[0], MEASURED[0]);
    for next in MEASURED {
        (below, above) = (above, next);
        if radius_in_edges < next.0 {
            break;
        }
    }
    let way = (above.0 / below.0).ln();
    let part = if way > 0.0 {
        ((radius_in_edges / below.0).ln() / way).clamp(0.0, 1.0)
    } else {
        1.0
    };
    Some([0, 1].map(|place| {
        let (from, to) = (below.1[place].ln(), above.1[place].ln());
        (from + part * (to - from)).exp()
    }))
}

/// Everything that does not change while a scene runs.
#[derive(Debug)]
pub struct Model {
    pub(crate) body: Body,
    /// How the tissue is before the first step.
    pub(crate) motion: Motion,
    /// Passes over corotational or hyperelastic tissue.
    pub(crate) passes: Passes,
    /// Elastic energy without tools less the work of the loads \[J\]; of corotational or hyperelastic tissue.
    pub(crate) resting_potential_j: f64,
    pub(crate) surface: Surface,
    pub(crate) tools: Vec<(u8, Tool)>,
    pub(crate) held: Arc<HeldPoints>,
    loads: Loads,
    /// What hanging threads fall with \[m/s^2\], (3), if a scene says so.
    pub(crate) gravity_m_per_s2: Option<[f64; 3]>,
    /// Forces of the handles at rest \[N\], (h x 3).
    handle_force_n: Vec<[f64; 3]>,
    /// Nodes of the mesh as given \[m\], (n x 3).
    unloaded_m: Vec<[f64; 3]>,
    /// Every node under the loads, without tools \[m\], (n x 3).
    pub(crate) resting_m: Vec<[f64; 3]>,
    /// Boundary nodes that can be moved, ascending, (b).
    pub(crate) touchable: Vec<u32>,
    /// Prescribed boundary nodes, ascending, (p): a wall to tools.
    prescribed: Vec<u32>,
    /// Positions of all boundary nodes under the loads, without tools \[m\], and their outward normals, (b + p).
    boundary_m: Vec<Vector3<f64>>,
    boundary_normal: Vec<Vector3<f64>>,
    /// Sources, if there are any.
    pub(crate) sources: Option<Sources>,
}

/// When a step over corotational or hyperelastic tissue ends: each pass linearises it anew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passes {
    /// Most passes of one step, at least 1.
    pub most: u32,
    /// They end when the out-of-balance force has fallen below this share of the forces.
    pub tolerance: f64,
}

impl Default for Passes {
    /// One: what a step leaves out of balance the next one answers, a few milliseconds later. A
    /// thousandth of the force is below what fingers tell apart, some 10 %.
    fn default() -> Self {
        Self {
            most: 1,
            tolerance: 1e-3,
        }
    }
}

/// Next step for loads under which touching tissues find no rest.
fn way_to_rest(status: Status) -> &'static str {
    match status {
        Status::TooManyRows => {
            "more features touch than there is room for: make the mesh coarser where it touches, or the loads smaller"
        }
        _ => "make the loads smaller, the tissue stiffer, or the mesh finer where it touches",
    }
}

/// Why a model cannot be built.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The tissue or its loads.
    #[error(transparent)]
    Tissue(#[from] TissueError),
    /// A tool without a sound shape.
    #[error("tool {id}: {flaw}")]
    Tool {
        /// Which tool.
        id: u8,
        /// What is wrong with it.
        flaw: String,
    },
    /// One id for two tools.
    #[error("two tools have the id {0}")]
    SameTool(u8),
    /// A handle on more nodes than a row's point may have.
    #[error(
        "handle {0} is on more than {MOST_NODES} nodes: beside needles and tissues that touch, and on hyperelastic tissue, \
         it is a point of one face or cell"
    )]
    WideHandle(usize),
    /// A needle.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// A thread.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// Tissues that touch.
    #[error(transparent)]
    Touch(#[from] TouchError),
    /// Tissues that are pressed together and find no balance.
    #[error(
        "the loads and handles press tissues together, which find no rest beyond {:.1} % of these: {}; {}",
        100.0 * share,
        status.name(),
        way_to_rest(*status)
    )]
    NoRest {
        /// The part of loads and handles' ways that has a balance.
        share: f64,
        /// How the next one ended.
        status: Status,
    },
    /// Handles that find no balance.
    #[error(
        "the handles find no rest beyond {:.1} % of their ways: {}; make these smaller, the tissue stiffer, or the mesh \
         finer around them",
        100.0 * share,
        status.name()
    )]
    NotHeld {
        /// The part of their ways that has a balance.
        share: f64,
        /// How the next one ended.
        status: Status,
    },
    /// Jaws without a sound shape, on no grip, or on one that has some.
    #[error("the jaws of tool {tool}: {flaw}")]
    Jaws {
        /// The tool that is to carry them.
        tool: u8,
        /// What is wrong.
        flaw: String,
    },
    /// A bar without a sound shape, on no grip, or on one that has some.
    #[error("the body of tool {tool}: {flaw}")]
    Bar {
        /// The tool that is to carry it.
        tool: u8,
        /// What is wrong.
        flaw: String,
    },
    /// Two bodies that are to press on each other and cannot.
    #[error("{} and {} are to press on each other, but {flaw}", contact.between[0], contact.between[1])]
    BodyContact {
        /// Which, and how.
        contact: BodyContact,
        /// What is wrong.
        flaw: String,
    },
    /// More tools than a step has room for.
    #[error("{0} tools; at most {MAX_TOOLS} are possible")]
    TooManyTools(usize),
}

/// Something that works but probably not as meant.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// A tool too small for the mesh.
    SmallTool {
        /// Which tool.
        id: u8,
        /// Its radius \[m\].
        radius_m: f64,
        /// Mean edge of the boundary \[m\].
        mean_edge_m: f64,
    },
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::SmallTool {
            id,
            radius_m,
            mean_edge_m,
        } = *self;
        let in_edges = radius_m / mean_edge_m;
        write!(
            f,
            "tool {id} has a radius of {:.2} mm, {in_edges:.1} mean edges of the mesh of {:.2} mm: ",
            1e3 * radius_m,
            1e3 * mean_edge_m,
        )?;
        match measured_error_percent(in_edges) {
            Some([error, largest]) => write!(
                f,
                "the force of a ball like that has a measured error of {error:.0} %, {largest:.0} % where it is largest"
            )?,
            None => write!(
                f,
                "of less than {LEAST_MEASURED_IN_EDGES} edges nobody has measured how wrong the force is"
            )?,
        }
        if in_edges < 1.0 {
            f.write_str(", and below one edge it is as if it had one")?;
        }
        let [accurate, _] = measured_error_percent(ACCURATE_RADIUS_IN_EDGES).unwrap_or_default();
        write!(
            f,
            "; with {:.2} mm or a finer mesh the measured error is {accurate:.0} %",
            1e3 * ACCURATE_RADIUS_IN_EDGES * mean_edge_m,
        )
    }
}

impl Model {
    /// Tissue made of `materials` with the nodes `fixed` held, under `loads`, and tools by id.
    ///
    /// # Errors
    /// What [`LinearTissue::new`] and [`LinearTissue::solve`] refuse; tools without a shape.
    pub fn new(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        fixed: &[u32],
        loads: Loads,
        tools: &[(u8, Tool)],
    ) -> Result<Self, ModelError> {
        check_tools(tools)?;
        let beside_bytes = cache_bytes(mesh, tools);
        let tissue = LinearTissue::beside(mesh, &materials.into(), fixed, beside_bytes)?;
        let held = HeldPoints::new(&tissue, loads.anchors())?;
        let rest = tissue.solve_held(&loads, &held)?;
        let displacement = rest.displacement_m;
        let mut resting = vec![0.0; tissue.unknowns()];
        for (node, u) in (0u32..).zip(&displacement) {
            if let Some(first) = tissue.first_unknown(node) {
                resting[first..first + 3].copy_from_slice(u);
            }
        }
        let body = Body::Linear {
            tissue: Arc::new(tissue),
            resting,
        };
        Self {
            held: Arc::new(held),
            handle_force_n: rest.handle_force_n,
            ..Self::around(mesh, body, Motion::default(), loads, tools, &displacement)
        }
        .with_tools(mesh)
    }

    /// As [`Self::new`], for tissue whose stiffness turns with its cells.
    ///
    /// # Errors
    /// As [`Self::new`]; a policy out of range; loads under which there is no balance.
    pub fn corotational(
        mesh: &TetMesh,
        materials: impl Into<Materials>,
        fixed: &[u32],
        loads: Loads,
        tools: &[(u8, Tool)],
        policy: Policy,
        passes: Passes,
    ) -> Result<Self, ModelError> {
        check_tools(tools)?;
        let (materials, beside_bytes) = (materials.into(), cache_bytes(mesh, tools));
        let tissue = CorotationalTissue::beside(mesh, &materials, fixed, policy, beside_bytes)?;
        let mut state = tissue.state();
        let rest = tissue.settle(&mut state, &loads)?;
        let displacement = rest.displacement_m;
        let mut work = tissue.workspace();
        tissue.update(&mut state, &mut work);
        let on_unknowns = loads
            .held_by(&rest.handle_force_n)
            .on_unknowns(tissue.numbering())?;
        let done = on_unknowns.iter().zip(state.unknowns()).map(|(f, u)| f * u);
        let resting_potential_j = tissue.energy_j(&work) - done.sum::<f64>();
        let motion = Motion::turning(state);
        let body = Body::Corotational {
            loads: on_unknowns,
            tissue: Arc::new(tissue),
        };
        Self {
            passes,
            resting_potential_j,
            handle_force_n: rest.handle_force_n,
            ..Self::around(mesh, body, motion, loads, tools, &displacement)
        }
        .with_tools(mesh)
    }

    /// Has the tools that touch find their balance. Handles of linear tissue stay in its compliance.
    fn with_tools(mut self, mesh: &TetMesh) -> Result<Self, ModelError> {
        if self.tools.iter().all(|(_, tool)| tool.is_grip()) {
            return Ok(self);
        }
        let settings = NeedleSettings {
            // Where a new factor makes all columns void, a step that computes a few of them and waits is withheld again
            // and again: what a contact touches is computed at once.
            vertices_per_step: if self.body.is_linear() { 8 } else { 64 },
            ..NeedleSettings::default()
        };
        if !self.body.is_linear() {
            return self.with_needles(mesh, &[], &[], settings);
        }
        self.sources = Some(self.sources_of(mesh, &[], &[], settings)?);
        Ok(self)
    }

    /// Sources and tools that touch.
    fn sources_of(
        &self,
        mesh: &TetMesh,
        needles: &[NeedlePart],
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Result<Sources, NeedleError> {
        let at_rest = (&self.boundary_m[..], &self.boundary_normal[..]);
        let nodes = (&self.touchable[..], &self.prescribed[..]);
        let sources = Sources::new(needles, tissue, settings, mesh, &self.resting_m)?;
        let least_m = self.surface.mean_edge_m;
        Ok(sources.with_tools(&self.tools, least_m, nodes, at_rest))
    }

    /// As [`Self::corotational`], for tissue that is hyperelastic.
    ///
    /// # Errors
    /// As there; handles on more than four nodes, or where there is no balance; [`TissueError::Elasticity`] for laws out of
    /// range or not as many as cells, and for quadratic cells.
    pub fn hyperelastic(
        mesh: &TetMesh,
        substance: &Hyperelasticity<'_>,
        fixed: &[u32],
        loads: Loads,
        tools: &[(u8, Tool)],
        policy: Policy,
        passes: Passes,
    ) -> Result<Self, ModelError> {
        check_tools(tools)?;
        let beside_bytes = cache_bytes(mesh, tools);
        let tissue = HyperelasticTissue::beside(mesh, substance, fixed, policy, beside_bytes)?;
        let mut state = tissue.state();
        tissue.settle(&mut state, mesh, substance, &loads)?;
        let tissue = Arc::new(tissue);
        let (state, handle_force_n) = Self::held(mesh, &tissue, state, &loads)?;
        let displacement = tissue.displacement_m(&state);
        let held_loads = loads.held_by(&handle_force_n);
        let on_unknowns = held_loads.on_unknowns(tissue.numbering())?;
        let done = on_unknowns.iter().zip(state.unknowns()).map(|(f, u)| f * u);
        let energy_j = tissue.energy_j(&state, &mut tissue.workspace());
        let resting_potential_j = energy_j - done.sum::<f64>();
        let motion = Motion::straining(state);
        let body = Body::Hyperelastic {
            loads: on_unknowns,
            tissue,
        };
        Self {
            passes,
            resting_potential_j,
            handle_force_n,
            ..Self::around(mesh, body, motion, loads, tools, &displacement)
        }
        .with_tools(mesh)
    }

    /// Hyperelastic tissue from its balance under the forces of `loads` to that where their handles hold it, with the
    /// force of each \[N\], (h x 3).
    fn held(
        mesh: &TetMesh,
        tissue: &Arc<HyperelasticTissue>,
        state: HyperelasticState,
        loads: &Loads,
    ) -> Result<(HyperelasticState, Vec<[f64; 3]>), ModelError> {
        if loads.handles.is_empty() {
            return Ok((state, Vec::new()));
        }
        tissue.has_room_for_needles()?;
        let handles = Handles::new(&loads.handles, &[]).map_err(ModelError::WideHandle)?;
        let displacement = tissue.displacement_m(&state);
        let body = Body::Hyperelastic {
            loads: loads.held_by(&[]).on_unknowns(tissue.numbering())?,
            tissue: Arc::clone(tissue),
        };
        let motion = Motion::straining(state.clone());
        // Only to see that there are such points, and that they do not conflict.
        HeldPoints::new(&body.view(&motion), loads.anchors())?;
        let apart = Self::around(mesh, body, motion, loads.clone(), &[], &displacement);
        let sources = apart.sources_of(mesh, &[], &[], NeedleSettings::default())?;
        let (motion, forces_n) = step::hold(&apart, sources, &handles)
            .map_err(|NoRest { share, status }| ModelError::NotHeld { share, status })?;
        Ok((motion.strained().cloned().unwrap_or(state), forces_n))
    }

    /// What follows from the tissue, moved by its loads as `displacement` says.
    fn around(
        mesh: &TetMesh,
        body: Body,
        motion: Motion,
        loads: Loads,
        tools: &[(u8, Tool)],
        displacement: &[[f64; 3]],
    ) -> Self {
        let resting_m: Vec<[f64; 3]> = mesh
            .points_m()
            .iter()
            .zip(displacement)
            .map(|(x, u)| [x[0] + u[0], x[1] + u[1], x[2] + u[2]])
            .collect();

        let surface = mesh.surface();
        let vertices = surface.vertices.iter().copied().zip(&surface.normals);
        let (held, free): (Vec<_>, Vec<_>) =
            vertices.partition(|(node, _)| body.numbering().is_fixed(*node));
        let nodes = |of: &[(u32, &[f64; 3])]| of.iter().map(|(node, _)| *node).collect();
        let (touchable, prescribed) = (nodes(&free), nodes(&held));
        let (boundary_m, boundary_normal) = free
            .iter()
            .chain(&held)
            .map(|(node, normal)| {
                let at = Vector3::from(resting_m[*node as usize]);
                (at, Vector3::from(**normal))
            })
            .unzip();
        Self {
            body,
            motion,
            passes: Passes::default(),
            resting_potential_j: 0.0,
            surface,
            tools: tools.to_vec(),
            held: Arc::new(HeldPoints::none()),
            loads,
            gravity_m_per_s2: None,
            handle_force_n: Vec::new(),
            unloaded_m: mesh.points_m().to_vec(),
            resting_m,
            touchable,
            prescribed,
            boundary_m,
            boundary_normal,
            sources: None,
        }
    }

    /// Has threads that hang fall with this \[m/s^2\], (3). What the tissue weighs is among its loads.
    pub fn with_gravity(mut self, gravity_m_per_s2: [f64; 3]) -> Self {
        self.gravity_m_per_s2 = Some(gravity_m_per_s2);
        self
    }

    /// Farthest way of a node from the unloaded mesh to where its loads and handles bring it \[m\].
    pub fn sag_m(&self) -> f64 {
        let ways = self.unloaded_m.iter().zip(&self.resting_m);
        let ways = ways.map(|(from, to)| (Vector3::from(*to) - Vector3::from(*from)).norm());
        ways.fold(0.0, f64::max)
    }

    /// Adds needles to a model of `mesh`; `tissue` says how each cell answers them, or nothing if there are no needles.
    /// Its handles are rows beside theirs then.
    ///
    /// # Errors
    /// Needles without a shape, tissue of another mesh or with properties that are none; tools that touch; handles on
    /// more than four nodes.
    pub fn with_needles(
        mut self,
        mesh: &TetMesh,
        needles: &[NeedlePart],
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
    ) -> Result<Self, ModelError> {
        let handles = Handles::new(&self.loads.handles, &self.handle_force_n)
            .map_err(ModelError::WideHandle)?;
        match &self.body {
            _ if needles.is_empty() => {}
            Body::Linear { .. } => {}
            Body::Corotational { tissue, .. } => tissue.has_room_for_needles()?,
            Body::Hyperelastic { tissue, .. } => tissue.has_room_for_needles()?,
        }
        let mut sources = self.sources_of(mesh, needles, tissue, settings)?;
        // From now on rows hold these points, and columns are of tissue that nobody holds there.
        self.loads.forces.extend(handles.loads());
        self.loads.handles.clear();
        self.held = Arc::new(HeldPoints::none());
        sources.handles = handles;
        self.sources = Some(sources);
        Ok(self)
    }

    /// Adds threads to a model with needles.
    ///
    /// # Errors
    /// Threads on needles that are not there, or with numbers that make none.
    pub fn with_threads(mut self, threads: &[ThreadPart]) -> Result<Self, ModelError> {
        let Some(sources) = &mut self.sources else {
            return threads.first().map_or(Ok(self), |part| {
                let flaw = "does not exist";
                Err(ThreadError::Needle {
                    id: part.id,
                    needle: part.needle,
                    flaw,
                }
                .into())
            });
        };
        let ids: Vec<u8> = sources.needles.iter().map(|part| part.id).collect();
        sources.threads = Threads::new(threads, &ids, &sources.mesh, sources.apart_m)?;
        Ok(self)
    }

    /// Has bodies of tissue touch each other, in a model of `mesh` with needles or without. Where loads or handles would
    /// have them overlap they are pressed together instead before the first step.
    ///
    /// # Errors
    /// Bodies without faces, numbers out of range; what [`Self::with_needles`] refuses; bodies that find no balance.
    pub fn with_touching(
        mut self,
        mesh: &TetMesh,
        parts: &[TouchPart],
        settings: TouchSettings,
    ) -> Result<Self, ModelError> {
        let reaches = self.sources.as_ref().is_some_and(Sources::reach_inside);
        if !reaches {
            self = self.with_needles(mesh, &[], &[], NeedleSettings::default())?;
        }
        if let Some(sources) = &mut self.sources {
            let at: Vec<_> = mesh.points_m().iter().map(|x| Vector3::from(*x)).collect();
            sources.touching = Some(Touching::new(parts, &at, settings)?);
        }
        step::settle(&mut self)
            .map_err(|NoRest { share, status }| ModelError::NoRest { share, status })?;
        if let Some(sources) = &self.sources
            && let Some(rest) = &sources.rest
        {
            sources.start_outside(rest.touch.at_m())?;
        }
        Ok(self)
    }

    /// Adds jaws to tools of a model of `mesh`.
    ///
    /// # Errors
    /// Jaws without a sound shape, on a tool that is no grip, or two on one; too little memory; handles beside them on more than
    /// four nodes.
    pub fn with_jaws(mut self, mesh: &TetMesh, parts: &[JawsPart]) -> Result<Self, ModelError> {
        if parts.is_empty() {
            return Ok(self);
        }
        for (index, JawsPart { tool, jaws }) in parts.iter().enumerate() {
            let flaw = if !self.tool(*tool).is_some_and(|(_, tool)| tool.is_grip()) {
                Some("a tool that is a grip carries jaws".to_owned())
            } else if parts[..index].iter().any(|other| other.tool == *tool) {
                Some("a tool carries one pair".to_owned())
            } else {
                jaws.flaw()
            };
            if let Some(flaw) = flaw {
                return Err(ModelError::Jaws { tool: *tool, flaw });
            }
        }
        self = self.reaching_inside(mesh)?;
        if let Some(sources) = &mut self.sources {
            sources.jaws = parts.to_vec();
        }
        Ok(self)
    }

    /// Adds bodies of grips, which touch the surface, to tools of a model of `mesh`.
    ///
    /// # Errors
    /// Bars without a sound shape, on a tool that is no grip, or two on one; too little memory; handles beside them on more than
    /// four nodes.
    pub fn with_bars(mut self, mesh: &TetMesh, parts: &[BarPart]) -> Result<Self, ModelError> {
        if parts.is_empty() {
            return Ok(self);
        }
        for (index, BarPart { tool, bar }) in parts.iter().enumerate() {
            let flaw = if !self.tool(*tool).is_some_and(|(_, tool)| tool.is_grip()) {
                Some("a tool that is a grip has one beside its shape".to_owned())
            } else if parts[..index].iter().any(|other| other.tool == *tool) {
                Some("a tool has one".to_owned())
            } else {
                bar.flaw()
            };
            if let Some(flaw) = flaw {
                return Err(ModelError::Bar { tool: *tool, flaw });
            }
        }
        self = self.reaching_inside(mesh)?;
        if let Some(sources) = &mut self.sources {
            sources.bars = parts.to_vec();
        }
        Ok(self)
    }

    /// Has taut spans of threads lie on bodies of grips and needles, which the model has by now.
    ///
    /// # Errors
    /// A thread or a body that is not there; a pair that is there already.
    pub fn with_thread_contacts(mut self, contacts: &[ThreadContact]) -> Result<Self, ModelError> {
        for (index, contact) in contacts.iter().enumerate() {
            let flaw = |flaw| ThreadError::Contact {
                contact: *contact,
                flaw,
            };
            let sources = self.sources.as_mut();
            let sources = sources.ok_or_else(|| flaw("there is no such thread"))?;
            if contacts[..index].contains(contact) {
                return Err(flaw("that is said twice").into());
            }
            let with = sources.place_of_body(contact.with);
            let with = with.ok_or_else(|| flaw("that has no body"))?;
            let mut threads = sources.threads.parts.iter();
            let thread = threads.position(|part| part.id == contact.thread);
            let thread = thread.ok_or_else(|| flaw("there is no such thread"))?;
            sources.threads.contacts.push(Contact { thread, with });
        }
        Ok(self)
    }

    /// Has bodies of grips and needles, which the model has by now, press on each other.
    ///
    /// # Errors
    /// A body that is not there, two needles, the same body or pair twice; a number out of range.
    pub fn with_body_contacts(mut self, contacts: &[BodyContact]) -> Result<Self, ModelError> {
        for (index, contact) in contacts.iter().enumerate() {
            let flaw = |flaw: String| ModelError::BodyContact {
                contact: *contact,
                flaw,
            };
            if let Some(wrong) = contact.flaw(&contacts[..index]) {
                return Err(flaw(wrong));
            }
            let places = self.sources.as_ref().and_then(|sources| {
                let [one, other] = contact.between.map(|body| sources.place_of_body(body));
                Some([one?, other?])
            });
            let between = places.ok_or_else(|| flaw("one of them has no body".to_owned()))?;
            if let Some(sources) = &mut self.sources {
                sources.pairs.push(PairPart {
                    between,
                    stiffness_n_per_m: contact.stiffness_n_per_m,
                    friction: contact.friction,
                });
            }
        }
        Ok(self)
    }

    /// With sources whose rows may act on any node of `mesh`.
    fn reaching_inside(mut self, mesh: &TetMesh) -> Result<Self, ModelError> {
        match &self.body {
            Body::Linear { .. } => {}
            Body::Corotational { tissue, .. } => tissue.has_room_for_needles()?,
            Body::Hyperelastic { tissue, .. } => tissue.has_room_for_needles()?,
        }
        let reaches = self.sources.as_ref().is_some_and(Sources::reach_inside);
        if !reaches {
            self = self.with_needles(mesh, &[], &[], NeedleSettings::default())?;
        }
        Ok(self)
    }

    /// Adds sources that a scene names by keys of their own.
    ///
    /// # Errors
    /// Handles beside them on more than four nodes.
    pub(crate) fn with_added(
        mut self,
        mesh: &TetMesh,
        added: &[Arc<dyn Added>],
    ) -> Result<Self, ModelError> {
        if added.is_empty() {
            return Ok(self);
        }
        let reaches = self.sources.as_ref().is_some_and(Sources::reach_inside);
        if !reaches {
            self = self.with_needles(mesh, &[], &[], NeedleSettings::default())?;
        }
        if let Some(sources) = &mut self.sources {
            sources.added = added.to_vec();
        }
        Ok(self)
    }

    /// Nodes that rows of `needles` may act on, as the columns of the compliance count them: of tools alone, the boundary's.
    pub(crate) fn reached(&self, sources: &Sources) -> Vec<u32> {
        if sources.reach_inside() {
            let numbering = self.body.numbering();
            let nodes = 0..numbering.nodes() as u32;
            return nodes.filter(|node| !numbering.is_fixed(*node)).collect();
        }
        self.touchable.clone()
    }

    /// The node that is such a vertex.
    pub(crate) fn node_of(&self, sources: &Sources, vertex: u32) -> Option<u32> {
        if sources.reach_inside() {
            return self.body.numbering().node_at(vertex);
        }
        self.touchable.get(vertex as usize).copied()
    }

    /// The body that a grip carries, as a tool.
    pub(crate) fn body_of(&self, tool: u8) -> Option<Tool> {
        let sources = self.sources.as_ref()?;
        let bar = sources.bars.get(sources.bar_of(tool)?)?;
        Some(bar.bar.capsule())
    }

    /// Radius of the thickest body of a grip \[m\], where bodies press on each other; else 0.
    pub(crate) fn thickest_pair_m(&self) -> f64 {
        let sources = self
            .sources
            .iter()
            .filter(|sources| !sources.pairs.is_empty());
        let bars = sources.flat_map(|sources| &sources.bars);
        bars.fold(0.0, |most, part| most.max(part.bar.radius_m))
    }

    /// Whether a tool carries jaws.
    pub(crate) fn has_jaws(&self) -> bool {
        self.sources
            .as_ref()
            .is_some_and(|sources| !sources.jaws.is_empty())
    }

    /// Index of a thread.
    pub(crate) fn thread(&self, id: u8) -> Option<usize> {
        let parts = &self.sources.as_ref()?.threads.parts;
        parts.iter().position(|part| part.id == id)
    }

    /// Whether there is a thread.
    pub fn has_thread(&self) -> bool {
        let sources = self.sources.as_ref();
        sources.is_some_and(|sources| !sources.threads.parts.is_empty())
    }

    /// Whether a node is held.
    pub fn is_fixed(&self, node: u32) -> bool {
        self.body.numbering().is_fixed(node)
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        self.body.numbering().unknowns()
    }

    /// Entries of the stiffness's factor, zeros that pad its dense blocks included.
    pub fn factor_entries(&self) -> usize {
        Factored::factor(&self.body.view(&self.motion)).len()
    }

    /// Boundary of the tissue, in its unloaded shape.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Tools by id.
    pub fn tools(&self) -> &[(u8, Tool)] {
        &self.tools
    }

    /// Node positions of the unloaded mesh \[m\], (n x 3).
    pub fn points_m(&self) -> &[[f64; 3]] {
        &self.unloaded_m
    }

    /// Index and shape of a tool.
    pub(crate) fn tool(&self, id: u8) -> Option<(usize, &Tool)> {
        let index = self.tools.iter().position(|(other, _)| *other == id)?;
        Some((index, &self.tools[index].1))
    }

    /// Whether a point lies inside the tissue as it rests under its loads.
    pub(crate) fn contains(&self, point: &Vector3<f64>) -> bool {
        self.surface.contains(&self.resting_m, (*point).into())
    }

    /// Whether the middle or an end of a tool that touches, or of its body, would be inside the tissue at rest there.
    pub(crate) fn has_in_it(&self, sample: &ToolSample) -> bool {
        let own = self.tool(sample.id).map(|(_, tool)| tool.clone());
        let shapes = own.into_iter().chain(self.body_of(sample.id));
        let mut shapes = shapes.filter(|tool| tool.shape != Shape::Grip);
        shapes.any(|tool| {
            let placement = tool.place(sample);
            placement.is_some_and(|placement| {
                let cores = Solid::new(&tool, 0.0, &placement).cores();
                cores.iter().any(|core| self.contains(core))
            })
        })
    }

    /// Whether a place outside of the tissue at rest is behind what is held, which is a wall. A held face is between it and the `last`
    /// place that was not, and tissue between it and the one that was `clear`, if there was any.
    pub(crate) fn is_behind_wall(
        &self,
        last: &Vector3<f64>,
        clear: Option<&Vector3<f64>>,
        place: &Vector3<f64>,
    ) -> bool {
        let at = |node: u32| Vector3::from(self.resting_m[node as usize]);
        let is_held = |triangle: [u32; 3]| triangle.iter().all(|node| self.is_fixed(*node));
        clear.is_some_and(|clear| {
            self.surface.crossed(at, last, place).any(is_held)
                && self.surface.crossed(at, clear, place).next().is_some()
        })
    }

    /// Whether a point is behind the tangent plane of the boundary node that rests nearest to it.
    pub(crate) fn is_behind_nearest(&self, point: &Vector3<f64>) -> bool {
        let nodes = self.boundary_m.iter().zip(&self.boundary_normal);
        let far = |at: &Vector3<f64>| (at - point).norm_squared();
        let nearest = nodes.min_by(|a, b| far(a.0).total_cmp(&far(b.0)));
        nearest.is_some_and(|(at, normal)| (point - at).dot(normal) < 0.0)
    }

    /// What works but probably not as meant.
    pub fn warnings(&self) -> Vec<Warning> {
        let mean_edge_m = self.surface.mean_edge_m;
        self.tools
            .iter()
            .filter(|(_, tool)| tool.shape != Shape::Grip)
            .filter(|(_, tool)| tool.radius_m() < LEAST_RADIUS_IN_EDGES * mean_edge_m)
            .map(|(id, tool)| Warning::SmallTool {
                id: *id,
                radius_m: tool.radius_m(),
                mean_edge_m,
            })
            .collect()
    }

    /// The whole tissue under its loads and the contact forces of `state`: in balance if it is linear;
    /// other tissue as the last step left it, how far from balance the residual says. Allocates:
    /// for files and viewers, not for the loop.
    ///
    /// # Errors
    /// None that building the model has not refused already, unless the state is not finite.
    pub fn equilibrium(&self, state: &State) -> Result<Equilibrium, TissueError> {
        let loads = self.loads_of(state);
        let mut found = match (&self.body, state.motion()) {
            (Body::Linear { tissue, .. }, _) => tissue.solve_held(&loads, &self.held),
            (Body::Corotational { tissue, .. }, motion) => match motion.state() {
                Some(turning) if loads.handles.is_empty() => tissue.book(turning, &loads),
                _ => tissue.solve(&loads),
            },
            (Body::Hyperelastic { tissue, .. }, motion) => {
                // Handles that no rows hold act with the forces that they rest with.
                let held = loads.held_by(&self.handle_force_n);
                match motion.strained() {
                    Some(strained) => tissue.book(strained, &held),
                    None => tissue.book(&tissue.state(), &held),
                }
                .map(|found| Equilibrium {
                    handle_force_n: self.handle_force_n.clone(),
                    ..found
                })
            }
        }?;
        if let (Some(sources), Some(grasp)) = (&self.sources, state.grasp())
            && sources.handles.count() > 0
        {
            found.handle_force_n = sources.handles.forces_n(grasp);
        }
        Ok(found)
    }

    /// Displacement of every node \[m\], (n x 3): that of [`Self::equilibrium`], to the same bits. Allocates.
    ///
    /// # Errors
    /// As there.
    pub fn displacement_m(&self, state: &State) -> Result<Vec<[f64; 3]>, TissueError> {
        match (&self.body, state.motion()) {
            (Body::Linear { tissue, .. }, _) => {
                tissue.displacement_m(&self.loads_of(state), &self.held)
            }
            (Body::Corotational { tissue, .. }, motion) => match motion.state() {
                Some(turning) if self.loads.handles.is_empty() => {
                    Ok(tissue.displacement_m(turning))
                }
                _ => Ok(self.equilibrium(state)?.displacement_m),
            },
            (Body::Hyperelastic { tissue, .. }, motion) => match motion.strained() {
                Some(strained) => Ok(tissue.displacement_m(strained)),
                None => Ok(tissue.displacement_m(&tissue.state())),
            },
        }
    }

    /// Loads, and the forces of contact and constraints in `state`.
    fn loads_of(&self, state: &State) -> Loads {
        let mut loads = self.loads.clone();
        let pushed = state.contact_forces(self);
        loads
            .forces
            .extend(pushed.map(|(node, force_n)| NodeLoad { node, force_n }));
        loads
    }

    /// Principal stresses of each cell \[Pa\], descending, tension positive, (m x 3), for a displacement of every
    /// node \[m\]: from small strain on linear tissue, from strain in the frame that turns with the cell on
    /// corotational tissue, Cauchy's on hyperelastic tissue. None for a displacement of another mesh.
    pub fn principal_stress_pa(&self, displacement_m: &[[f64; 3]]) -> Vec<[f64; 3]> {
        if displacement_m.len() != self.unloaded_m.len() {
            return Vec::new();
        }
        let stress = match &self.body {
            Body::Linear { tissue, .. } => tissue.stress(displacement_m),
            Body::Corotational { tissue, .. } => tissue.stress(displacement_m),
            Body::Hyperelastic { tissue, .. } => tissue.stress(displacement_m),
        };
        stress.iter().map(principal_stress_pa).collect()
    }

    /// The same of some of the cells, in their order.
    pub fn principal_stress_in_pa(
        &self,
        displacement_m: &[[f64; 3]],
        cells: &[u32],
    ) -> Vec<[f64; 3]> {
        if displacement_m.len() != self.unloaded_m.len() {
            return Vec::new();
        }
        let indices = cells.iter().map(|cell| *cell as usize);
        let stress = match &self.body {
            Body::Linear { tissue, .. } => tissue.stress_in(displacement_m, indices),
            Body::Corotational { tissue, .. } => tissue.stress_in(displacement_m, indices),
            // Its invariants are made for all cells at once.
            Body::Hyperelastic { tissue, .. } => {
                let all = tissue.stress(displacement_m);
                indices.filter_map(|cell| all.get(cell).copied()).collect()
            }
        };
        stress.iter().map(principal_stress_pa).collect()
    }
}

/// What columns of the compliance may take beside the factor \[bytes\]: those of the whole boundary, as far as the cache
/// holds them.
fn cache_bytes(mesh: &TetMesh, tools: &[(u8, Tool)]) -> u64 {
    if tools.is_empty() {
        return 0;
    }
    let vertices = mesh.surface().vertices.len() as u64;
    (size_of::<[f64; 9]>() as u64 * vertices * vertices).min(DEFAULT_CACHE_BYTES as u64)
}

/// Whether there is room for all tools, each has a shape, and their ids differ.
pub(crate) fn check_tools(tools: &[(u8, Tool)]) -> Result<(), ModelError> {
    if tools.len() > MAX_TOOLS {
        return Err(ModelError::TooManyTools(tools.len()));
    }
    for (index, (id, tool)) in tools.iter().enumerate() {
        if let Some(flaw) = tool.flaw() {
            return Err(ModelError::Tool { id: *id, flaw });
        }
        if tools[..index].iter().any(|(other, _)| other == id) {
            return Err(ModelError::SameTool(*id));
        }
    }
    Ok(())
}
