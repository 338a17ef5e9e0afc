//! All that acts on the tissue of a scene: what is constant about it, what evolves, and scratch.
//!
//! Entry points: [`Sources`], [`SourcesState`], [`SourcesWork`].

use super::balance::BalanceWork;
use super::kept::Kept;
use super::rest::Rest;
use super::tangent::TangentWork;
use super::targets::Targets;
use super::tool_rows::ToolRows;
use crate::anchors::{AnchorPoint, AnchorSettings, ConstraintState, ConstraintSystem};
use crate::body::Motion;
use crate::collide::{TouchState, Touching};
use crate::jaws::{JawsPart, JawsState};
use crate::mesh::{HalfFaces, TetMesh};
use crate::model::Model;
use crate::needle::{
    Geometry, Hierarchy, History, LONGEST_FALL_S, MAX_NEEDLES, NeedleError, NeedlePart,
    NeedleSettings, NeedleState, NeedleTissue, Slack, check, contains, entry,
};
use crate::rod::{BarPart, BarState, PairPart, PairState};
use crate::source::tool::{Cones, ToolContacts, TouchingTools};
use crate::source::{Added, Handles, Kept as Memory, ON_POINTS, ON_WAYS, Room, Source};
use crate::thread::{Obstacle, ThreadBody, ThreadState, Threads};
use crate::tool::{MAX_TOOLS, Tool, ToolSample};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;
use std::sync::Arc;

/// Longest piece of a way between two solves, in mean boundary edges.
const PIECE: f64 = 0.25;
/// Least distance between crossings with rows, in mean boundary edges.
const APART: f64 = 0.15;

/// What acts on the tissue, and how that answers it.
#[derive(Debug)]
pub(crate) struct Sources {
    pub needles: Vec<NeedlePart>,
    pub settings: NeedleSettings,
    pub mesh: HalfFaces,
    pub hierarchy: Hierarchy,
    pub threads: Threads,
    /// Tools that touch.
    pub tools: TouchingTools,
    /// Bodies of tissue that may touch, if there are any.
    pub touching: Option<Touching>,
    /// Points of tissue that are held.
    pub handles: Handles,
    /// Jaws, on tools of their own.
    pub jaws: Vec<JawsPart>,
    /// Bodies of grips.
    pub bars: Vec<BarPart>,
    /// Bodies that press on each other.
    pub pairs: Vec<PairPart>,
    /// What the scene adds by keys of their own.
    pub added: Vec<Arc<dyn Added>>,
    /// What evolves, before the first step, where tissues touch already.
    pub rest: Option<Box<Rest>>,
    /// Displacement under the loads alone, where the hierarchy is \[m\], (n x 3).
    pub resting: Vec<[f64; 3]>,
    /// Where nodes rest under the loads \[m\], (n).
    pub resting_m: Vec<Vector3<f64>>,
    /// Kinds of tissue, and each cell's among them, (m).
    kinds: Vec<NeedleTissue>,
    kind_of_cell: Vec<u32>,
    /// Least distance between crossings that both have rows \[m\]: at vertices and edges they coincide, and what
    /// is nearer than this says the same thing twice, with large forces against each other.
    pub apart_m: f64,
    /// Longest piece of a needle's way between two solves \[m\].
    pub piece_m: f64,
    /// Mean edge of the boundary \[m\].
    pub edge_m: f64,
}

impl Sources {
    /// For `mesh`, whose nodes rest at `resting_m`; `tissue` by cell, or nothing where there are no needles.
    pub fn new(
        parts: &[NeedlePart],
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
        mesh: &TetMesh,
        resting_m: &[[f64; 3]],
    ) -> Result<Self, NeedleError> {
        if parts.len() > MAX_NEEDLES {
            return Err(NeedleError::TooMany(parts.len()));
        }
        for (index, part) in parts.iter().enumerate() {
            if let Some(flaw) = part.flaw() {
                let id = part.id;
                return Err(NeedleError::Flaw { id, flaw });
            }
            if parts[..index].iter().any(|other| other.id == part.id) {
                return Err(NeedleError::SameNeedle(part.id));
            }
        }
        let (given, cells) = (tissue.len(), mesh.cells().len());
        if given != cells && !(parts.is_empty() && given == 0) {
            return Err(NeedleError::Cells { given, cells });
        }
        for (what, value) in [
            ("most_crossings", settings.most_crossings),
            ("vertices_per_step", settings.vertices_per_step),
        ] {
            let least = 1;
            if value < least {
                return Err(NeedleError::Setting { what, value, least });
            }
        }
        let mut kinds: Vec<NeedleTissue> = Vec::new();
        let mut kind_of_cell = Vec::with_capacity(given);
        for of_cell in tissue {
            let known = kinds.iter().position(|kind| kind == of_cell);
            if known.is_none() {
                check(of_cell)?;
                kinds.push(*of_cell);
            }
            kind_of_cell.push(known.unwrap_or(kinds.len() - 1) as u32);
        }
        let half_faces = mesh.half_faces().clone();
        let hierarchy = Hierarchy::new(&half_faces, |node| {
            resting_m
                .get(node as usize)
                .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
        });
        let sources = Self {
            needles: parts.to_vec(),
            settings,
            mesh: half_faces,
            hierarchy,
            threads: Threads::none(),
            tools: TouchingTools::none(),
            touching: None,
            handles: Handles::default(),
            jaws: Vec::new(),
            bars: Vec::new(),
            pairs: Vec::new(),
            added: Vec::new(),
            rest: None,
            resting_m: resting_m.iter().map(|at| Vector3::from(*at)).collect(),
            resting: resting_m
                .iter()
                .zip(mesh.points_m())
                .map(|(at, from)| [at[0] - from[0], at[1] - from[1], at[2] - from[2]])
                .collect(),
            kinds,
            kind_of_cell,
            apart_m: APART * mesh.surface().mean_edge_m,
            piece_m: PIECE * mesh.surface().mean_edge_m,
            edge_m: mesh.surface().mean_edge_m,
        };
        sources.start_outside(&sources.resting_m)?;
        Ok(sources)
    }

    /// Looks whether the needles start outside tissue whose nodes are `at_m` \[m\], (n x 3).
    ///
    /// # Errors
    /// The first one that does not.
    pub fn start_outside(&self, at_m: &[Vector3<f64>]) -> Result<(), NeedleError> {
        let at = |node: u32| at_m.get(node as usize).copied().unwrap_or_default();
        let ways = at_m.iter().zip(&self.resting_m);
        let moved_m = ways.fold(0.0f64, |most, (at, from)| most.max((at - from).norm()));
        let geometry = Geometry {
            mesh: &self.mesh,
            hierarchy: &self.hierarchy,
            slack: Slack::Everywhere(moved_m),
            at,
        };
        for part in &self.needles {
            let curve = part.needle.at(&part.start);
            let found = entry(&geometry, &curve, &History::new(0), 0.0, curve.length);
            let inside = |cell: &[u32; 4]| contains(&cell.map(at), &curve.start);
            if found.crossing.is_some() || self.mesh.cells().iter().any(inside) {
                return Err(NeedleError::Inside { id: part.id });
            }
        }
        Ok(())
    }

    /// Adds tools. Those that touch touch the boundary nodes `nodes`, free and prescribed, which are `at_rest` \[m\] with outward
    /// normals; none is thinner than `least_m`.
    pub fn with_tools(
        mut self,
        tools: &[(u8, Tool)],
        least_m: f64,
        nodes: (&[u32], &[u32]),
        at_rest: (&[Vector3<f64>], &[Vector3<f64>]),
    ) -> Self {
        if tools.iter().all(|(_, tool)| tool.is_grip()) {
            return self;
        }
        let mut group_of = vec![0; self.mesh.nodes()];
        for (group, nodes) in (0..).zip(self.hierarchy.groups()) {
            nodes
                .iter()
                .for_each(|node| group_of[*node as usize] = group);
        }
        let each = nodes.0.iter().chain(nodes.1);
        let groups = each.map(|node| group_of[*node as usize]).collect();
        let surface = self.mesh.boundary();
        let edges = surface.edges().map(|side| surface.side_vertices(side));
        self.tools = TouchingTools::new(tools, least_m, nodes, at_rest, groups, edges);
        self
    }

    /// Whether rows may act inside the tissue: not by tools alone.
    pub fn reach_inside(&self) -> bool {
        let tools_only = self.needles.is_empty() && self.handles.count() == 0;
        !tools_only
            || self.touching.is_some()
            || !self.threads.parts.is_empty()
            || !self.jaws.is_empty()
            || !self.bars.is_empty()
            || !self.added.is_empty()
    }

    /// Whether there are rods that touch the surface.
    pub fn have_rods(&self) -> bool {
        !self.bars.is_empty() || self.needles.iter().any(|part| part.body)
    }

    /// Place of a tool's bar.
    pub fn bar_of(&self, tool: u8) -> Option<usize> {
        self.bars.iter().position(|part| part.tool == tool)
    }

    /// Place of a body of a grip or a needle.
    pub fn place_of_body(&self, body: ThreadBody) -> Option<Obstacle> {
        match body {
            ThreadBody::Grip(tool) => self.bar_of(tool).map(Obstacle::Bar),
            ThreadBody::Needle(id) => {
                let mut needles = self.needles.iter();
                let place = needles.position(|part| part.id == id && part.body);
                place.map(Obstacle::Needle)
            }
        }
    }

    /// Place of a tool's jaws.
    pub fn jaws_of(&self, tool: u8) -> Option<usize> {
        self.jaws.iter().position(|part| part.tool == tool)
    }

    /// Whether forces follow from an energy alone: there are but tools without friction.
    pub fn are_conservative(&self) -> bool {
        self.tools.are_smooth() && !self.reach_inside()
    }

    /// Mean edge of the boundary \[m\].
    pub fn edge_m(&self) -> f64 {
        self.piece_m / PIECE
    }

    /// How a cell answers needles.
    pub fn tissue(&self, cell: u32) -> &NeedleTissue {
        const NONE: NeedleTissue = NeedleTissue {
            friction_n_per_m: 0.0,
            static_friction_n_per_m: 0.0,
            viscous_n_s_per_m2: 0.0,
            cutting_pa: 0.0,
            puncture_pa: 0.0,
            surface_friction: 0.0,
        };
        let kind = self.kind_of_cell.get(cell as usize);
        kind.map_or(&NONE, |kind| &self.kinds[*kind as usize])
    }

    /// What added sources keep before the first step.
    fn begin_added(&self) -> Vec<Memory> {
        let at = |node: u32| {
            self.resting_m
                .get(node as usize)
                .copied()
                .unwrap_or_default()
        };
        let rest = |point: &AnchorPoint| {
            let parts = point.nodes.iter().zip(point.weights);
            parts.map(|(node, weight)| at(*node) * weight).sum()
        };
        let begin = |added: &Arc<dyn Added>| {
            let mut kept = Memory::default();
            added.begin(&rest, &mut kept);
            kept
        };
        self.added.iter().map(begin).collect()
    }

    /// All sources of the scene, in the order of their rows.
    pub fn each(&self) -> impl DoubleEndedIterator<Item = &dyn Source> {
        let added = self.added.iter().map(|added| &**added as &dyn Source);
        ON_POINTS.into_iter().chain(added).chain(ON_WAYS)
    }

    /// What their rows need at most.
    pub fn anchor_settings(&self) -> AnchorSettings {
        let rooms = self.each().map(|source| source.room(self));
        let room = rooms.fold(Room::default(), |sum, room| sum + room);
        AnchorSettings {
            most_rows: room.rows,
            most_anchors: room.anchors,
            most_spread: room.spread,
            most_terms: room.terms,
            memory_bytes: self.settings.memory_bytes,
            ..AnchorSettings::default()
        }
    }
}

/// What evolves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct SourcesState {
    pub grasp: ConstraintState,
    pub each: Vec<NeedleState>,
    pub threads: Vec<ThreadState>,
    pub touch: Option<TouchState>,
    #[serde(skip_serializing_if = "ToolContacts::touch_nothing")]
    pub tools: ToolContacts,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub jaws: Vec<JawsState>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bars: Vec<BarState>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pairs: Vec<PairState>,
    /// When the last balance was sampled, by the console's clock.
    pub time_us: u64,
    /// What added sources keep.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub memory: Vec<Memory>,
}

/// When a step's way begins, and how fast needles slid before it.
pub(crate) struct Moment {
    /// Of its samples, by the console's clock; nothing without samples.
    pub time_us: Option<u64>,
    /// Since the last balance \[s\].
    pub step_s: f64,
    speeds: [f64; MAX_NEEDLES],
    /// Where needles were.
    poses: [Isometry3<f64>; MAX_NEEDLES],
}

impl Moment {
    /// When `samples` were taken, after `state`.
    pub fn of(state: &SourcesState, samples: &[ToolSample]) -> Self {
        let time_us = samples.iter().map(|sample| sample.console_time_us).max();
        let since = |now: u64| 1e-6 * now.saturating_sub(state.time_us) as f64;
        let mut poses = [Isometry3::identity(); MAX_NEEDLES];
        for (pose, each) in poses.iter_mut().zip(&state.each) {
            *pose = each.pose;
        }
        Self {
            time_us,
            step_s: time_us.map_or(0.0, since),
            speeds: [0.0; MAX_NEEDLES],
            poses,
        }
    }

    /// For as long needles fall in it \[s\].
    pub fn fall_s(&self) -> f64 {
        self.step_s.min(LONGEST_FALL_S)
    }
}

/// Scratch.
pub(crate) struct SourcesWork {
    pub balance: BalanceWork,
    pub tangent: TangentWork,
    pub cones: Option<Cones>,
    /// Of tools that touch, at the last step's balance.
    pub rows: Vec<ToolRows>,
    /// How a step on tissue that is not linear began.
    kept: Option<Box<Kept>>,
    /// Before one that is thrown away, and the time then \[us\].
    marked: Option<(Box<Kept>, u64)>,
}

impl SourcesState {
    pub fn new(sources: &Sources, motion: Motion) -> Self {
        let settings = sources.anchor_settings();
        let mut grasp = ConstraintState::new(motion, &settings);
        let mut touch = sources
            .touching
            .as_ref()
            .map(|touching| TouchState::new(touching, &sources.resting_m));
        if let (Some(rest), Some(touch)) = (&sources.rest, &mut touch) {
            grasp.copy_rows(&rest.grasp);
            touch.copy_from(&rest.touch);
        }
        Self {
            grasp,
            each: sources
                .needles
                .iter()
                .map(|part| NeedleState::new(part, &sources.settings))
                .collect(),
            threads: strands(&sources.threads),
            touch,
            tools: ToolContacts::new(&sources.tools),
            jaws: sources.jaws.iter().map(JawsState::new).collect(),
            bars: sources
                .bars
                .iter()
                .map(|part| BarState::new(part.tool))
                .collect(),
            pairs: sources.pairs.iter().map(PairState::new).collect(),
            time_us: 0,
            memory: sources.begin_added(),
        }
    }

    /// See [`crate::step::State::see`]. What keeps tissues apart is only for the step after: nobody sees it.
    pub fn see(&mut self, other: &Self) {
        self.grasp.see(&other.grasp);
        for (own, other) in self.each.iter_mut().zip(&other.each) {
            own.copy_from(other);
        }
        for (own, other) in self.threads.iter_mut().zip(&other.threads) {
            own.copy_from(other);
        }
        self.tools.copy_from(&other.tools);
        for (own, other) in self.jaws.iter_mut().zip(&other.jaws) {
            own.copy_from(other);
        }
        for (own, other) in self.bars.iter_mut().zip(&other.bars) {
            own.copy_from(other);
        }
        self.pairs.copy_from_slice(&other.pairs);
        self.time_us = other.time_us;
        self.memory.copy_from_slice(&other.memory);
    }

    /// Whether a thread passes a body near enough that it may come to lie on it, or another body that it may press on is near.
    pub fn passes(&self, with: Obstacle) -> bool {
        let mut laps = self.threads.iter().flat_map(|thread| &thread.laps);
        let mut pairs = self.pairs.iter();
        laps.any(|lap| lap.with == with) || pairs.any(|pair| pair.is_near && pair.has(with))
    }

    /// Finds how fast needles slide on their way to `targets`.
    pub fn begin_way(&mut self, sources: &Sources, targets: &Targets, moment: &mut Moment) {
        let passed_s = moment.step_s;
        let speeds = &mut moment.speeds;
        let ways = targets.needles.iter().zip(&sources.needles);
        for ((each, before), (target, part)) in self.each.iter_mut().zip(speeds).zip(ways) {
            *before = each.speed;
            let (from, to) = (part.needle.at(&each.pose), part.needle.at(target));
            let middle = 0.5 * from.length;
            let slide = from.project(&to.at(middle), middle) - middle;
            each.speed = if passed_s > 0.0 {
                slide / passed_s
            } else {
                0.0
            };
        }
    }

    /// The way since `moment` is done, by which time is as far on.
    pub fn end_way(&mut self, sources: &Sources, moment: &Moment) {
        self.time_us = moment.time_us.unwrap_or(self.time_us);
        let ways = sources.needles.iter().zip(&moment.poses);
        for (each, (part, from)) in self.each.iter_mut().zip(ways) {
            each.fell(part, from, moment.fall_s());
        }
    }

    /// Needles slide as before the way.
    pub fn take_back_speeds(&mut self, moment: &Moment) {
        for (each, speed) in self.each.iter_mut().zip(&moment.speeds) {
            each.speed = *speed;
        }
    }
}

impl SourcesWork {
    /// Room for all that may act at once.
    pub fn new(model: &Model, sources: &Sources) -> Self {
        let settings = sources.anchor_settings();
        let state = SourcesState::new(sources, model.motion.clone());
        let groups = sources.hierarchy.groups();
        let (body, held) = (&model.body, &model.held);
        let reached = model.reached(sources);
        let system =
            ConstraintSystem::grouped(body, &model.motion, held, &reached, settings, groups);
        let most_rows = settings.most_rows + settings.most_spread;
        let kept = || {
            let mut kept = Box::new(Kept::new(sources, &state, Motion::default()));
            kept.keep_place(&state);
            kept
        };
        Self {
            marked: (!body.is_linear()).then(|| (kept(), 0)),
            kept: (!body.is_linear()).then(kept),
            balance: BalanceWork::new(sources, system, &state),
            tangent: TangentWork::new(most_rows, sources.tools.most_contacts()),
            cones: sources.tools.cones(most_rows),
            rows: Vec::with_capacity(MAX_TOOLS),
        }
    }

    /// Remembers how a step on tissue that is not linear begins.
    pub fn keep(&mut self, state: &SourcesState) {
        if let Some(kept) = &mut self.kept {
            kept.keep_place(state);
        }
    }

    /// Has the next pass over tissue that is not linear follow the whole way; whether it does.
    pub fn begin_again(&self, state: &mut SourcesState) -> bool {
        let kept = self.kept.as_ref();
        kept.map(|kept| kept.put_back(state)).is_some()
    }

    /// Where tissue that is not linear cannot go the state is as before the step.
    pub fn put_back(&mut self, state: &mut SourcesState) {
        if let Some(kept) = &self.kept {
            kept.put_back_place(state);
            // What is asked for places under these needs their columns, and no others are fetched.
            let pushes = &mut self.balance.nodes.pushes;
            pushes.clear();
            pushes.extend_from_slice(state.grasp.motion().pushed());
        }
    }

    /// Remembers a state on tissue that is not linear; whether it is.
    pub fn mark(&mut self, state: &SourcesState) -> bool {
        let marked = self.marked.as_mut();
        let marked = marked.map(|(kept, time_us)| {
            kept.keep_place(state);
            *time_us = state.time_us;
        });
        marked.is_some()
    }

    /// The state is as it was marked, but for a factor that has come meanwhile.
    pub fn go_back(&mut self, state: &mut SourcesState) {
        if let Some((kept, time_us)) = &self.marked {
            kept.put_back_place(state);
            state.time_us = *time_us;
        }
    }

    /// Computes the columns of all nodes whose resting position \[m\] satisfies `near`; how many are there.
    pub fn prepare(
        &mut self,
        model: &Model,
        sources: &Sources,
        near: impl Fn([f64; 3]) -> bool,
    ) -> usize {
        let near = |(node, at): (u32, &[f64; 3])| near(*at).then_some(node);
        let mut nodes: Vec<u32> = (0u32..).zip(&model.resting_m).filter_map(near).collect();
        // What acts before the first step acts in it.
        let rest = sources.rest.as_ref().into_iter();
        let acting = rest.flat_map(|rest| rest.grasp.pushes());
        nodes.extend(acting.filter_map(|(vertex, _)| model.node_of(sources, vertex)));
        nodes.extend(sources.handles.loads().map(|load| load.node));
        let system = &mut self.balance.system;
        system.prepare(&model.body, &model.motion, &nodes)
    }
}

/// One strand in use a thread, and room for others.
fn strands(threads: &Threads) -> Vec<ThreadState> {
    let each = (0..threads.strands()).map(|strand| {
        let part = threads.part_of(strand);
        if threads.is_led(strand) {
            ThreadState::new(part)
        } else {
            ThreadState::unused(part)
        }
    });
    each.collect()
}
