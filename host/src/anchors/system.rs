//! Columns, compliance and forces of rows on anchors, for whoever makes the rows.
//!
//! Entry points: [`ConstraintState`] is what evolves, [`ConstraintSystem`] scratch and the cache of columns. In order:
//! [`ConstraintSystem::read`], [`ConstraintSystem::look`] and [`ConstraintSystem::linearise`] for tissue that turns, [`ConstraintSystem::fetch`],
//! [`ConstraintSystem::assemble`], [`ConstraintSystem::solve`], [`ConstraintSystem::accept`].

use super::compliance::{Pairs, Reached, Spread};
use super::{
    AnchorPoint, AnchorSettings, ConstraintSet, MultiPointConstraint, PointConstraint, Term,
};
use crate::body::{Body, BodyWork, Motion, Place, Push};
use crate::columns::Columns;
use crate::fem::{
    Balance, Factored, HeldPoints, LinearTissue, Linearisation, Moved, SolveScratch, TissueError,
};
use crate::renewal::{Renewals, Rule};
use crate::rows::{self, Condensed, Problem, Row, RowKind};
use crate::source::tool::Turning;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::sync::Arc;

/// What evolves: the tissue's motion and the forces of the rows on it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ConstraintState {
    motion: Motion,
    forces: rows::State,
    anchors: Vec<Reached>,
    /// Rows of the last solve, and after them those on several anchors.
    acting: Vec<PointConstraint>,
    spread: Spread,
    /// Force on the tissue at each anchor \[N\], (anchors).
    on_anchors: Vec<Vector3<f64>>,
    #[serde(skip)]
    prescribed: Vec<PrescribedPart>,
}

/// Part of an anchor on a prescribed node: the anchor, the node, and its weight.
type PrescribedPart = (u32, u32, f64);

impl ConstraintState {
    /// No rows yet.
    pub fn new(motion: Motion, settings: &AnchorSettings) -> Self {
        Self {
            motion: motion.with_room(8 * settings.most_anchors),
            forces: rows::State::new(settings.most_rows + settings.most_spread),
            anchors: Vec::with_capacity(settings.most_anchors),
            acting: Vec::with_capacity(settings.most_rows),
            spread: Spread {
                rows: Vec::with_capacity(settings.most_spread),
                terms: Vec::with_capacity(settings.most_terms),
            },
            on_anchors: Vec::with_capacity(settings.most_anchors),
            prescribed: Vec::with_capacity(8 * settings.most_anchors),
        }
    }

    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Rows of the last solve, but those on several anchors; their multipliers come first.
    pub fn acting(&self) -> &[PointConstraint] {
        &self.acting
    }

    /// Multipliers of the last solve's rows \[N\].
    pub fn lambda(&self) -> &[f64] {
        self.forces.lambda()
    }

    /// delta of the last solve's rows \[m\].
    pub fn delta_m(&self) -> &[f64] {
        self.forces.delta()
    }

    /// Whether the last solve was of these rows, in their order.
    pub fn is_of(&self, set: &ConstraintSet) -> bool {
        let (rows, spread) = (set.rows.iter(), set.spread.iter());
        let ids = rows.map(|row| row.id).chain(spread.map(|row| row.id));
        ids.eq(self.forces.ids())
    }

    /// Modes of the last solve's rows.
    pub fn modes(&self) -> &[rows::Mode] {
        self.forces.modes()
    }

    /// Forces on vertices: -C' lambda.
    pub fn pushes(&self) -> impl Iterator<Item = Push> + '_ {
        pushes(&self.anchors, &self.on_anchors)
    }

    /// Forces on prescribed nodes \[N\]: those of anchors that have a part of their weight there.
    pub fn on_prescribed(&self) -> impl Iterator<Item = (u32, Vector3<f64>)> + '_ {
        let parts = self.prescribed.iter();
        parts.map(|(anchor, node, weight)| (*node, self.on_anchors[*anchor as usize] * *weight))
    }

    /// Force on the tissue at an anchor of the last solve \[N\].
    pub fn force_on(&self, anchor: usize) -> Vector3<f64> {
        let force = self.on_anchors.get(anchor).copied();
        force.unwrap_or_else(Vector3::zeros)
    }

    /// After a solve: forces on anchors from multipliers.
    fn gather(&mut self) {
        let lambda = self.forces.lambda();
        self.on_anchors.clear();
        self.on_anchors.resize(self.anchors.len(), Vector3::zeros());
        for (row, lambda) in self.acting.iter().zip(lambda) {
            self.on_anchors[row.anchor as usize] -= Vector3::from(row.direction) * *lambda;
        }
        let of_spread = lambda.get(self.acting.len()..).unwrap_or_default();
        for (row, lambda) in self.spread.rows.iter().zip(of_spread) {
            for term in self.spread.terms_of(row) {
                self.on_anchors[term.anchor as usize] -= Vector3::from(term.direction) * *lambda;
            }
        }
    }

    /// After [`Self::gather`]: adds forces across normals, each with the row of its normal, as far as that presses.
    fn turn(&mut self, forces: impl Iterator<Item = (usize, Vector3<f64>)>) {
        let Self {
            forces: of_rows,
            acting,
            on_anchors,
            ..
        } = self;
        for (row, force) in forces {
            if of_rows.lambda()[row] <= 0.0 {
                continue;
            }
            on_anchors[acting[row].anchor as usize] += force;
            // Where there are rows across the normal it is theirs.
            let across = acting[row + 1..].iter().take(2).enumerate();
            for (axis, own) in across.take_while(|(_, own)| own.kind == RowKind::Tangent) {
                let along = Vector3::from(own.direction).dot(&force);
                of_rows.add(row + 1 + axis, -along);
            }
        }
    }

    /// Takes hyperelastic tissue back to where it was.
    pub fn go_back(&mut self, place: &Place) {
        self.motion.go_back(place);
    }

    /// See [`crate::step::State::see`].
    pub fn see(&mut self, other: &Self) {
        self.motion.see(&other.motion);
        self.copy_rows(other);
    }

    /// The rows and forces of `other`, without new memory; the tissue's motion stays.
    pub fn copy_rows(&mut self, other: &Self) {
        self.forces.copy_from(&other.forces);
        self.anchors.clone_from(&other.anchors);
        self.acting.clone_from(&other.acting);
        self.spread.copy_from(&other.spread);
        self.on_anchors.clone_from(&other.on_anchors);
        self.prescribed.clone_from(&other.prescribed);
    }
}

/// What [`ConstraintSystem::fetch`] did.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fetched {
    /// Vertices whose columns were computed.
    pub computed: u32,
    /// Whether every column that the anchors need is there.
    pub all: bool,
}

/// Scratch and the cache of columns.
pub(crate) struct ConstraintSystem {
    settings: AnchorSettings,
    held: Arc<HeldPoints>,
    columns: Columns,
    body_work: BodyWork,
    /// Whether the tissue has moved since it was linearised.
    accepted: bool,
    /// Displacement without row forces, by the linearisation \[m\], (unknowns); empty where few vertices are pushed: then
    /// sums of columns cost less.
    resting: Vec<f64>,
    /// Place of each mesh node among the reached, (n).
    reached_of_node: Vec<u32>,
    vertices: Vec<u32>,
    missing: Vec<u32>,
    next_anchors: Vec<Reached>,
    next_prescribed: Vec<PrescribedPart>,
    first_row: Vec<u32>,
    free: Vec<Vector3<f64>>,
    /// What the forces of the last solve move each anchor by, beyond `free` \[m\].
    moved: Vec<Vector3<f64>>,
    /// Whether these are of the forces of the last solve.
    is_displaced: bool,
    pairs: Pairs,
    spread: Spread,
    w: Vec<f64>,
    delta_free: Vec<f64>,
    kinds: Vec<Row>,
    rows_work: rows::Workspace,
    /// Forces of the last solve among rows of which some are new.
    open: rows::State,
    field: Vec<f64>,
    field_work: SolveScratch,
}

const UNREACHED: u32 = u32::MAX;
/// Numbers of a factor that stay in a cache until they are read: 8 MB.
const MOST_WARMED: usize = 1 << 20;
/// Where more vertices than this are pushed, one solve for all nodes costs less than a sum for each that is asked for.
pub(crate) const MANY_PUSHES: usize = 150;

/// Whether a solve gave forces to go on with.
pub(crate) fn is_solved(outcome: &rows::Outcome) -> bool {
    use rows::Status::{Incompatible, NotConverged, Ok, Redundant};
    matches!(outcome.status, Ok | Redundant | Incompatible | NotConverged)
}

impl ConstraintSystem {
    /// For anchors on the free nodes `reached`.
    ///
    /// # Errors
    /// A node in `reached` that does not exist or is fixed.
    pub fn new(
        body: &Body,
        motion: &Motion,
        reached: &[u32],
        settings: AnchorSettings,
    ) -> Result<Self, TissueError> {
        let held = Arc::new(HeldPoints::none());
        let numbering = body.numbering();
        let nodes = numbering.nodes();
        let mut reached_of_node = vec![UNREACHED; nodes];
        for (place, &node) in (0u32..).zip(reached) {
            let slot = reached_of_node
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "the list of reached nodes",
                    node,
                    nodes,
                })?;
            if numbering.is_fixed(node) {
                return Err(TissueError::Fixed(node));
            }
            *slot = place;
        }
        Ok(Self::reaching(
            body,
            motion,
            &held,
            (reached, reached_of_node),
            settings,
        ))
    }

    /// For anchors on the nodes `reached`, of which all are free, where `held` points do not move; `groups` of nodes are
    /// those of [`Self::slack`].
    pub fn grouped(
        body: &Body,
        motion: &Motion,
        held: &Arc<HeldPoints>,
        reached: &[u32],
        settings: AnchorSettings,
        groups: &[Vec<u32>],
    ) -> Self {
        let mut reached_of_node = vec![UNREACHED; body.numbering().nodes()];
        for (place, &node) in (0u32..).zip(reached) {
            reached_of_node[node as usize] = place;
        }
        let reached = (reached, reached_of_node);
        let mut system = Self::reaching(body, motion, held, reached, settings);
        let free = |node: &u32| system.vertex(*node);
        let groups: Vec<Vec<u32>> = groups
            .iter()
            .map(|group| group.iter().filter_map(free).collect())
            .collect();
        system.columns.group(&groups);
        system.pairs.keep_others();
        system
    }

    fn reaching(
        body: &Body,
        motion: &Motion,
        held: &Arc<HeldPoints>,
        (reached, reached_of_node): (&[u32], Vec<u32>),
        settings: AnchorSettings,
    ) -> Self {
        let AnchorSettings {
            most_rows,
            most_anchors,
            memory_bytes,
            ..
        } = settings;
        // Rows on several anchors come on top.
        let most_rows = most_rows + settings.most_spread;
        // Corotational tissue reads the anchors of the step before, too.
        let least = 8 * most_anchors;
        let mut columns = Columns::new(&body.view(motion), held, reached, memory_bytes, least);
        columns.belong_to(motion.factor());
        Self {
            held: held.clone(),
            columns,
            body_work: body.work(),
            accepted: false,
            resting: Vec::with_capacity(if body.is_linear() {
                0
            } else {
                body.numbering().unknowns()
            }),
            reached_of_node,
            vertices: Vec::with_capacity(8 * most_anchors),
            missing: Vec::with_capacity(8 * most_anchors),
            next_anchors: Vec::with_capacity(most_anchors),
            next_prescribed: Vec::with_capacity(8 * most_anchors),
            first_row: Vec::with_capacity(most_anchors + 1),
            free: vec![Vector3::zeros(); most_anchors],
            moved: Vec::with_capacity(most_anchors),
            is_displaced: false,
            pairs: Pairs::new(most_anchors, most_rows),
            spread: Spread {
                rows: Vec::with_capacity(settings.most_spread),
                terms: Vec::with_capacity(settings.most_terms),
            },
            w: vec![0.0; most_rows * most_rows],
            delta_free: vec![0.0; most_rows],
            kinds: Vec::with_capacity(most_rows),
            rows_work: rows::Workspace::new(most_rows),
            open: rows::State::new(most_rows),
            field: vec![0.0; body.numbering().unknowns()],
            field_work: body.view(motion).factor().scratch(),
            settings,
        }
    }

    pub fn start_worker(
        &mut self,
        tissue: Arc<LinearTissue>,
        reached: &[u32],
    ) -> std::io::Result<()> {
        self.columns
            .start_worker(tissue, self.held.clone(), reached)
    }

    /// As [`Self::start_worker`], for a replay.
    pub fn replay_worker(&mut self, tissue: Arc<LinearTissue>, reached: &[u32]) {
        self.columns
            .replay_worker(tissue, self.held.clone(), reached);
    }

    pub fn settings(&self) -> &AnchorSettings {
        &self.settings
    }

    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    pub fn columns_mut(&mut self) -> &mut Columns {
        &mut self.columns
    }

    /// Has the worker compute the columns of a node that anchors will soon name.
    pub fn prefetch(&mut self, node: u32) {
        if let Some(vertex) = self.vertex(node) {
            self.columns.request(vertex);
        }
    }

    /// Whether the columns of a node are there.
    pub fn has(&self, node: u32) -> bool {
        self.vertex(node)
            .is_some_and(|vertex| self.columns.has(vertex))
    }

    /// Displacement of a node by the linearisation \[m\] under `pushes`, whose columns must be there.
    pub fn displacement(
        &self,
        body: &Body,
        grasp: &ConstraintState,
        pushes: &[Push],
        node: u32,
    ) -> Vector3<f64> {
        let Some(vertex) = self.vertex(node) else {
            return Vector3::zeros();
        };
        if let Some(unknowns) = grasp.motion.unknowns().filter(|_| self.accepted) {
            return body.numbering().at_node(unknowns, node).into();
        }
        let free = self.free_of(body, grasp, vertex);
        let moved = pushes
            .iter()
            .map(|(pushed, force)| self.columns.block(vertex, *pushed) * force);
        free + moved.sum::<Vector3<f64>>()
    }

    /// Displacement of a vertex without row forces, by the linearisation \[m\].
    fn free_of(&self, body: &Body, grasp: &ConstraintState, vertex: u32) -> Vector3<f64> {
        let first = self.columns.first_unknown(vertex);
        match self.resting.get(first..first + 3) {
            Some(at) => Vector3::from_column_slice(at),
            None => body.free(&grasp.motion, &self.body_work, &self.columns, vertex),
        }
    }

    /// As [`Self::compliance`], for what gives way besides the tissue.
    pub fn compliance_mut(&mut self, rows: usize) -> &mut [f64] {
        self.rows_work.forget_factors();
        &mut self.w[..rows * rows]
    }

    pub fn body_work(&self) -> &BodyWork {
        &self.body_work
    }

    /// How far no node of each group is farther than from where it is displaced to by `resting` (n x 3) \[m\],
    /// under `pushes`. The groups are those of [`Self::everywhere`].
    pub fn slack(
        &self,
        body: &Body,
        grasp: &ConstraintState,
        pushes: &[Push],
        resting: &[[f64; 3]],
        out: &mut [f64],
    ) {
        out.fill(0.0);
        let mut add = |(vertex, force): &Push| {
            let force = force.norm();
            for (out, largest) in out.iter_mut().zip(self.columns.largest(*vertex)) {
                *out += force * largest;
            }
        };
        pushes.iter().for_each(&mut add);
        // Of corotational tissue the displacement of the last pass is at hand, at the cost of a look at all of it.
        let Some(unknowns) = grasp.motion.unknowns() else {
            return;
        };
        grasp.motion.pushed().iter().for_each(&mut add);
        let moved = (0u32..).zip(resting).map(|(node, from)| {
            let now = body.numbering().at_node(unknowns, node);
            (Vector3::from(now) - Vector3::from(*from)).norm()
        });
        let last = moved.fold(0.0, f64::max);
        out.iter_mut().for_each(|out| *out += last);
    }

    /// Computes columns of nodes that will soon be named, of at most `most` that are missing.
    pub fn compute_ahead(
        &mut self,
        body: &Body,
        grasp: &ConstraintState,
        nodes: &[u32],
        most: usize,
    ) -> u32 {
        if self.columns.has_worker() {
            nodes.iter().for_each(|node| self.prefetch(*node));
            return 0;
        }
        self.missing.clear();
        for &node in nodes {
            if let Some(vertex) = self.vertex(node)
                && self.missing.len() < most
                && !self.columns.has(vertex)
                && !self.missing.contains(&vertex)
            {
                self.missing.push(vertex);
            }
        }
        let view = body.view(&grasp.motion);
        self.columns.compute(&view, &self.held, &self.missing);
        self.missing.len() as u32
    }

    /// Has the columns of nodes that will soon be named computed for the next factor, too.
    pub fn wish(&mut self, nodes: &[u32]) {
        for node in nodes {
            if let Some(vertex) = self.vertex(*node) {
                self.columns.wish(vertex);
            }
        }
    }

    /// Computes the columns of all `nodes`; how many are there then.
    pub fn prepare(&mut self, body: &Body, motion: &Motion, nodes: &[u32]) -> usize {
        let vertices: Vec<u32> = nodes.iter().filter_map(|node| self.vertex(*node)).collect();
        self.columns.belong_to(motion.factor());
        self.columns
            .compute(&body.view(motion), &self.held, &vertices);
        self.columns.count()
    }

    /// Compliance of the rows of the last solve, (n x n).
    pub fn compliance(&self, rows: usize) -> &[f64] {
        &self.w[..rows * rows]
    }

    /// delta at no forces of the rows of the last [`Self::assemble`] \[m\], (n).
    pub fn delta_free_m(&self, rows: usize) -> &[f64] {
        &self.delta_free[..rows]
    }

    /// Displacement of an anchor of the last [`Self::assemble`] without forces \[m\], (3).
    pub fn free_m(&self, anchor: usize) -> &Vector3<f64> {
        &self.free[anchor]
    }

    /// Elastic energy that the forces of the last solve have put into linear tissue \[J\].
    pub fn stored_j(&mut self, grasp: &ConstraintState) -> f64 {
        self.displace(grasp);
        let each = grasp.on_anchors.iter().zip(&self.moved);
        each.map(|(force, moved)| 0.5 * force.dot(moved)).sum()
    }

    /// Displacement of an anchor of the last [`Self::assemble`] per force on another \[m/N\].
    pub fn between(&self, at: usize, pushed: usize) -> Matrix3<f64> {
        self.pairs.block(at, pushed)
    }

    /// Brings into the caches what a step that is like the last one reads most of: the factor, unless it is more than stays in a
    /// cache, and the blocks of present anchors.
    pub fn warm(&self, body: &Body, grasp: &ConstraintState) {
        let tissue = body.view(&grasp.motion);
        let factor = tissue.factor();
        if factor.len() <= MOST_WARMED {
            factor.touch();
        }
        self.pairs.touch();
    }

    /// Where all nodes are displaced to under the forces of the last solve, by the linearisation \[m\], (unknowns).
    pub fn field<'a>(&'a mut self, body: &Body, grasp: &ConstraintState) -> &'a [f64] {
        let Self {
            field,
            field_work,
            columns,
            body_work,
            ..
        } = self;
        body.displaced(
            &grasp.motion,
            body_work,
            columns,
            grasp.pushes(),
            field,
            field_work,
        );
        field
    }

    /// Place of a node among the reached.
    fn vertex(&self, node: u32) -> Option<u32> {
        let vertex = self.reached_of_node.get(node as usize).copied();
        vertex.filter(|vertex| *vertex != UNREACHED)
    }

    pub fn begin_step(&mut self) {
        self.columns.begin_step();
    }

    /// After [`Self::begin_step`]: takes over a factor that was renewed beside the steps if its time has come.
    pub fn take_over(&mut self, body: &Body, grasp: &mut ConstraintState) -> Renewals {
        body.begin_step(&mut grasp.motion, &mut self.columns, &self.held)
    }

    /// From now on factors of turning tissue are renewed beside the steps and taken over by `rule`, unless its policy
    /// wants them fresh; whether they are.
    pub fn renew_beside(&mut self, body: &Body, reached: &[u32], rule: Rule) -> bool {
        body.renew_beside(&mut self.columns, &self.held, reached, rule)
    }

    /// Reads anchors and rows; whether they make sense: no more than the settings allow, rows in the
    /// order of their anchors, anchors on nodes that are reached or fixed. After the anchors, rows count the
    /// `ways`, whose displacement is that of their second end less that of their first.
    pub fn read(
        &mut self,
        body: &Body,
        anchors: &[AnchorPoint],
        ways: &[[Option<AnchorPoint>; 2]],
        rows: &[PointConstraint],
    ) -> bool {
        self.is_displaced = false;
        let count = anchors.len() + ways.len();
        if count > self.settings.most_anchors || rows.len() > self.settings.most_rows {
            return false;
        }
        self.next_anchors.clear();
        self.next_prescribed.clear();
        let ends = anchors.iter().map(|anchor| [None, Some(*anchor)]);
        for [from, to] in ends.chain(ways.iter().copied()) {
            let mut reached = Reached::default();
            for (end, sign) in [(from, -1.0), (to, 1.0)] {
                if !end.is_none_or(|end| self.reach(body, &end, sign, &mut reached)) {
                    return false;
                }
            }
            self.next_anchors.push(reached);
        }
        self.first_row.clear();
        let mut next = 0;
        for anchor in 0..count {
            self.first_row.push(next as u32);
            next += rows[next..]
                .iter()
                .take_while(|row| row.anchor as usize == anchor)
                .count();
        }
        self.first_row.push(next as u32);
        self.kinds.clear();
        self.kinds.extend(rows.iter().map(|row| Row {
            id: row.id,
            kind: row.kind,
        }));
        self.spread.rows.clear();
        self.spread.terms.clear();
        next == rows.len()
    }

    /// Adds an anchor's free nodes; whether all others are fixed.
    fn reach(
        &mut self,
        body: &Body,
        anchor: &AnchorPoint,
        sign: f64,
        reached: &mut Reached,
    ) -> bool {
        for (&node, &weight) in anchor.nodes.iter().zip(&anchor.weights) {
            if weight == 0.0 {
                continue;
            }
            let Some(&vertex) = self.reached_of_node.get(node as usize) else {
                return false;
            };
            let sound = if vertex == UNREACHED {
                let place = self.next_anchors.len() as u32;
                self.next_prescribed.push((place, node, sign * weight));
                body.numbering().is_fixed(node)
            } else {
                reached.add(vertex, sign * weight)
            };
            if !sound {
                return false;
            }
        }
        true
    }

    /// After [`Self::read`]: rows on several of its anchors; whether they make sense.
    pub fn read_spread(&mut self, rows: &[MultiPointConstraint], terms: &[Term]) -> bool {
        let anchors = self.next_anchors.len();
        let sound = rows.len() <= self.settings.most_spread
            && terms.len() <= self.settings.most_terms
            && terms.iter().all(|term| (term.anchor as usize) < anchors)
            && rows
                .iter()
                .all(|row| row.terms.0 as usize + row.terms.1 as usize <= terms.len());
        if sound {
            self.spread.rows.extend_from_slice(rows);
            self.spread.terms.extend_from_slice(terms);
            self.kinds.extend(rows.iter().map(|row| Row {
                id: row.id,
                kind: row.kind,
            }));
        }
        sound
    }

    /// How far from balance the tissue is; `None` for linear tissue.
    pub fn look(&mut self, body: &Body, grasp: &mut ConstraintState) -> Option<Balance> {
        body.look(&mut grasp.motion, &mut self.body_work, &self.columns)
    }

    /// After [`Self::look`]: linearises there; columns of another factor are forgotten.
    pub fn linearise(&mut self, body: &Body, grasp: &mut ConstraintState) -> Option<Linearisation> {
        self.accepted = false;
        self.resting.clear();
        let done = body.linearise(&mut grasp.motion, &mut self.body_work, &mut self.columns);
        if grasp.motion.pushed().len() > MANY_PUSHES {
            self.resting.resize(body.numbering().unknowns(), 0.0);
            body.displaced(
                &grasp.motion,
                &self.body_work,
                &self.columns,
                std::iter::empty(),
                &mut self.resting,
                &mut self.field_work,
            );
        }
        done
    }

    /// Computes missing columns of what [`Self::read`] read, of at most `budget` vertices.
    pub fn fetch(&mut self, body: &Body, grasp: &ConstraintState, budget: usize) -> Fetched {
        self.vertices.clear();
        for anchor in &self.next_anchors {
            self.vertices
                .extend(anchor.parts().map(|(vertex, _)| vertex));
        }
        self.fetch_vertices(body, grasp, budget)
    }

    /// As [`Self::fetch`], for what forces of the last solve act on.
    pub fn fetch_acting(&mut self, body: &Body, grasp: &ConstraintState, budget: usize) -> Fetched {
        self.vertices.clear();
        self.vertices
            .extend(grasp.pushes().map(|(vertex, _)| vertex));
        self.fetch_vertices(body, grasp, budget)
    }

    fn fetch_vertices(&mut self, body: &Body, grasp: &ConstraintState, budget: usize) -> Fetched {
        self.vertices
            .extend(grasp.motion.pushed().iter().map(|(vertex, _)| *vertex));
        self.missing.clear();
        for &vertex in &self.vertices {
            if self.columns.has(vertex) {
                self.columns.keep(vertex);
            } else if !self.missing.contains(&vertex) {
                self.missing.push(vertex);
            }
        }
        if self.missing.is_empty() {
            return Fetched {
                computed: 0,
                all: true,
            };
        }
        if self.columns.has_worker() {
            for &vertex in &self.missing {
                self.columns.request(vertex);
            }
            return Fetched {
                computed: 0,
                all: false,
            };
        }
        let now = self.missing.len().min(budget);
        let found_room =
            self.columns
                .compute(&body.view(&grasp.motion), &self.held, &self.missing[..now]);
        Fetched {
            computed: now as u32,
            all: found_room && now == self.missing.len(),
        }
    }

    /// Compliance and free delta of the rows.
    pub fn assemble(&mut self, body: &Body, grasp: &ConstraintState, rows: &[PointConstraint]) {
        let n = rows.len() + self.spread.rows.len();
        for at in 0..self.next_anchors.len() {
            let parts = self.next_anchors[at].parts();
            let free = parts.map(|(vertex, weight)| self.free_of(body, grasp, vertex) * weight);
            self.free[at] = free.sum();
        }
        for (delta, row) in self.delta_free.iter_mut().zip(rows) {
            let along = Vector3::from(row.direction).dot(&self.free[row.anchor as usize]);
            *delta = row.target_m - along;
        }
        for (delta, row) in self.delta_free[rows.len()..]
            .iter_mut()
            .zip(&self.spread.rows)
        {
            let along =
                self.spread.terms_of(row).iter().map(|term| {
                    Vector3::from(term.direction).dot(&self.free[term.anchor as usize])
                });
            *delta = row.target_m - along.sum::<f64>();
        }
        self.rows_work.forget_factors();
        let factor = grasp.motion.factor();
        self.pairs.look(&self.next_anchors, &self.columns, factor);
        let w = &mut self.w[..n * n];
        self.pairs.project(rows, &self.first_row, &self.spread, w);
    }

    /// Finds where the forces of the last solve move the anchors of the last [`Self::assemble`], by the linearisation.
    pub fn displace(&mut self, grasp: &ConstraintState) {
        if std::mem::replace(&mut self.is_displaced, true) {
            return;
        }
        let forces = &grasp.on_anchors;
        self.moved.resize(forces.len(), Vector3::zeros());
        self.pairs.displace(forces, &mut self.moved);
    }

    /// As [`Self::displace`], from the [`Self::field`] of the last solve.
    pub fn displace_by_field(&mut self) {
        if std::mem::replace(&mut self.is_displaced, true) {
            return;
        }
        let anchors = self.next_anchors.iter().zip(&self.free);
        self.moved.clear();
        self.moved.extend(anchors.map(|(anchor, free)| {
            let parts = anchor.parts().filter_map(|(vertex, weight)| {
                let first = self.columns.first_unknown(vertex);
                let at = self.field.get(first..first + 3)?;
                Some(Vector3::from_column_slice(at) * weight)
            });
            parts.sum::<Vector3<f64>>() - free
        }));
    }

    /// After [`Self::displace`]: displacement of an anchor \[m\].
    pub fn anchor_displacement(&self, anchor: usize) -> Vector3<f64> {
        self.free[anchor] + self.moved[anchor]
    }

    /// After [`Self::read`] and [`Self::assemble`] of the rows of the last solve and others that are open: the rows `keep`
    /// with all others that act condensed out. Whether that could be done. See [`rows::condense`].
    pub fn condense(
        &mut self,
        rows: usize,
        turning: Option<&Turning>,
        grasp: &ConstraintState,
        (keep, jacobian): (&[usize], &[f64]),
        out: &mut Condensed,
    ) -> bool {
        let n = rows + self.spread.rows.len();
        grasp.forces.put_into(&self.kinds, &mut self.open);
        let w = turning.map_or(&self.w, |turning| &turning.compliance);
        let problem = Problem {
            rows: &self.kinds,
            compliance: &w[..n * n],
            delta_free: &self.delta_free[..n],
        };
        let work = &mut self.rows_work;
        rows::condense(&problem, &self.open, keep, jacobian, work, out).is_some()
    }

    /// How the rows of the last solve answer other targets, where that left its factors and its compliance is as it was.
    pub fn solved_rows(&self) -> &rows::Workspace {
        &self.rows_work
    }

    /// Finds the forces, with the compliance in which normals turn if some do.
    pub fn solve(
        &mut self,
        rows: &[PointConstraint],
        turning: Option<&mut Turning>,
        grasp: &mut ConstraintState,
    ) -> rows::Outcome {
        self.is_displaced = false;
        let n = rows.len() + self.spread.rows.len();
        let (w, delta_free) = match &turning {
            Some(turning) => (&turning.compliance, &turning.delta_free),
            None => (&self.w, &self.delta_free),
        };
        let problem = Problem {
            rows: &self.kinds,
            compliance: &w[..n * n],
            delta_free: &delta_free[..n],
        };
        let outcome = rows::solve(
            &problem,
            self.settings.method,
            &mut grasp.forces,
            &mut self.rows_work,
        );
        if turning.is_some() {
            self.rows_work.forget_factors();
        }
        if turning.is_some() && !is_solved(&outcome) {
            // Far from balance there may be none with normals that turn: slower without, but downhill.
            return self.solve(rows, None, grasp);
        }
        grasp.anchors.clone_from(&self.next_anchors);
        grasp.prescribed.clone_from(&self.next_prescribed);
        grasp.acting.clear();
        grasp.acting.extend_from_slice(rows);
        grasp.spread.copy_from(&self.spread);
        grasp.gather();
        if let Some(turning) = turning {
            let turned = turning.forces(grasp.forces.lambda());
            grasp.turn(turned);
        }
        outcome
    }

    /// Moves the tissue under the forces found, as far as it can go.
    pub fn accept(&mut self, body: &Body, grasp: &mut ConstraintState) -> Moved {
        let ConstraintState {
            motion,
            anchors,
            on_anchors,
            ..
        } = grasp;
        let pushes = pushes(anchors, on_anchors);
        let moved = body.accept(motion, &mut self.body_work, &self.columns, pushes);
        self.accepted = true;
        self.resting.clear();
        moved
    }
}

fn pushes<'a>(
    anchors: &'a [Reached],
    forces: &'a [Vector3<f64>],
) -> impl Iterator<Item = Push> + 'a {
    anchors.iter().zip(forces).flat_map(|(anchor, force)| {
        let parts = anchor.parts();
        parts.map(move |(vertex, weight)| (vertex, force * weight))
    })
}
