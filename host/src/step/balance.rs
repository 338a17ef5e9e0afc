//! One balance of tissue with all that acts on it: rounds of solves, and what happens between them.
//!
//! Entry point: [`Balance::to`]. In each solve every source appends its rows at where the last one left the tissue, and takes
//! the solve over: directions of needles turn with their slides, normals of tools with the vertices, hence Newton's
//! method. Between balances nothing of this is kept but where things have slid to, which makes friction's law implicit:
//! it is plastic flow, integrated backwards (Simo & Hughes 1998, 1.4).

use super::kept::Kept;
use super::options::StepOptions;
use super::report::{Status, StepReport};
use super::sources::{Sources, SourcesState};
use super::targets::Targets;
use crate::anchors::{
    AnchorPoint, ConstraintSet, ConstraintSystem, Fetched, MANY_PUSHES, is_solved,
};
use crate::body::{Body, Push};
use crate::clock::Clock;
use crate::collide::TouchWork;
use crate::jaws::JawsWork;
use crate::marks::Marks;
use crate::model::Model;
use crate::needle::{MOST_GROUPS, NeedleWork};
use crate::rod::{BarWork, TouchWork as RodWork};
use crate::source::tool::ToolWork;
use crate::thread::ThreadWork;
use crate::work;
use nalgebra::Vector3;
use std::cell::Cell;

/// Most effort of one step, some seconds of a core: iterations of its solves, each at a price of `n (n + CONE_EFFORT)` for n rows.
/// Steps of usual scenes take less than a hundredth of it; one that has taken it is given up.
pub(super) const MOST_EFFORT: f64 = 4e9;
/// Price of a row by itself, over that of an entry of the compliance: cones that slip are searched for their direction.
const CONE_EFFORT: f64 = 1000.0;
/// Most solves of one balance.
const MOST_SOLVES: u32 = 64;

/// The present constraints, where they have the tissue, and scratch of each source.
pub(crate) struct BalanceWork {
    pub system: ConstraintSystem,
    /// Three rows for every point of a needle, then others.
    pub set: ConstraintSet,
    pub nodes: Nodes,
    pub needles: NeedleWork,
    pub threads: ThreadWork,
    pub tools: ToolWork,
    pub jaws: JawsWork,
    pub touch: Option<TouchWork>,
    pub rods: RodWork,
    pub bars: BarWork,
    /// Effort that is left to the step; without an end outside of steps. See [`MOST_EFFORT`].
    pub effort_left: f64,
    saved: Kept,
}

/// Where the last solve left the tissue.
pub(crate) struct Nodes {
    /// Forces on vertices, ascending.
    pub pushes: Vec<Push>,
    sums: PushSums,
    /// Solves so far, and where each node was found to be in which of them \[m\], (n).
    pub solves: u64,
    known: Vec<Cell<(u64, Vector3<f64>)>>,
    /// Where all nodes are \[m\], (n), by which solve, and whether that is where they rest without forces.
    pub at: Vec<Vector3<f64>>,
    pub at_solve: u64,
    pub at_rest: bool,
    /// [`Balance::slack`] where all nodes are known, and by which solve.
    slack: Cell<(u64, [f64; MOST_GROUPS])>,
}

impl BalanceWork {
    /// Room for `state`.
    pub fn new(sources: &Sources, system: ConstraintSystem, state: &SourcesState) -> Self {
        let settings = sources.anchor_settings();
        Self {
            system,
            set: ConstraintSet::new(&settings),
            nodes: Nodes {
                pushes: Vec::with_capacity(sources.mesh.nodes().min(8 * settings.most_anchors)),
                sums: PushSums::new(sources.mesh.nodes()),
                solves: 0,
                known: vec![Cell::new((u64::MAX, Vector3::zeros())); sources.mesh.nodes()],
                at: sources.resting_m.clone(),
                at_solve: u64::MAX,
                at_rest: false,
                slack: Cell::new((u64::MAX, [0.0; MOST_GROUPS])),
            },
            needles: NeedleWork::new(state.each.len(), sources),
            threads: ThreadWork::new(sources),
            tools: ToolWork::new(&sources.tools, settings.most_rows + settings.most_spread),
            jaws: JawsWork::new(sources),
            touch: sources
                .touching
                .as_ref()
                .map(|touching| TouchWork::new(touching, sources.mesh.nodes())),
            rods: RodWork::new(sources),
            bars: BarWork::new(sources),
            effort_left: f64::INFINITY,
            saved: Kept::new(sources, state, state.grasp.motion().clone()),
        }
    }

    /// Rows of the present balance, those on several anchors included.
    pub fn count(&self) -> usize {
        self.set.count()
    }
}

/// Everything that a balance works on.
pub(crate) struct Balance<'a> {
    pub body: &'a Body,
    /// Unloaded nodes \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    pub sources: &'a Sources,
    /// Vertices whose columns the step may compute.
    pub most_vertices: usize,
    /// So far around tips outside surfaces are looked for \[m\].
    pub tip_reach_m: f64,
    pub state: &'a mut SourcesState,
    pub work: &'a mut BalanceWork,
    pub report: &'a mut StepReport,
    pub clock: &'a mut Clock,
}

impl<'a> Balance<'a> {
    /// Of a model's tissue.
    pub fn new(
        model: &'a Model,
        sources: &'a Sources,
        options: &StepOptions,
        state: &'a mut SourcesState,
        work: &'a mut BalanceWork,
        report: &'a mut StepReport,
        clock: &'a mut Clock,
    ) -> Self {
        Self {
            body: &model.body,
            points_m: model.points_m(),
            sources,
            most_vertices: options
                .vertices_per_step
                .unwrap_or(sources.settings.vertices_per_step),
            tip_reach_m: options.tip_reach_m,
            state,
            work,
            report,
            clock,
        }
    }

    /// Takes the tissue for where the forces of the state have it.
    ///
    /// # Errors
    /// Columns that are awaited.
    pub fn begin(&mut self) -> Result<(), Status> {
        self.work.nodes.solved(self.state.grasp.pushes());
        let vertices = self.vertices_left();
        let system = &mut self.work.system;
        let fetched = system.fetch_acting(self.body, &self.state.grasp, vertices);
        self.take_columns(fetched)
    }

    /// Balances the tissue with everything at `targets`; if that fails all is as before. Where threads bend since the last balance
    /// may leave none near it: then they go on as they were bent in that.
    ///
    /// # Errors
    /// Why there is no balance.
    pub fn to(&mut self, targets: &Targets) -> Result<(), Status> {
        self.work.saved.keep(self.state);
        match self.at(targets) {
            Err(Status::NotConverged) if self.bend_as_before() => self.at(targets),
            done => done,
        }
    }

    /// As [`Self::to`], from what is kept.
    fn at(&mut self, targets: &Targets) -> Result<(), Status> {
        self.state.tools.place(&self.sources.tools, &targets.tools);
        for (thread, [tail, head]) in self.state.threads.iter_mut().zip(&targets.threads) {
            thread.tail.at = *tail;
            thread.head.at = *head;
        }
        for (each, target) in self.state.jaws.iter_mut().zip(&targets.jaws) {
            each.pose = *target;
        }
        for (each, target) in self.state.bars.iter_mut().zip(&targets.bars) {
            each.pose = *target;
        }
        self.work.needles.releases.clear();
        self.work.threads.begin();
        let done = self.round_by_round(&targets.needles, None);
        if done.is_err() {
            self.work.saved.put_back(self.state);
            self.work.nodes.solved(self.state.grasp.pushes());
        }
        done
    }

    /// Balances with the needles at `poses`, while the way of the needle `played` is played back, if there is one.
    ///
    /// # Errors
    /// Why there is no balance.
    pub fn round_by_round(
        &mut self,
        poses: &[nalgebra::Isometry3<f64>],
        played: Option<usize>,
    ) -> Result<(), Status> {
        let sources = self.sources;
        self.begin_needles(poses, played);
        let mut solves = 0;
        loop {
            self.settle(&mut solves)?;
            let mut changed = false;
            for source in sources.each() {
                changed |= source.advance(self, played)?;
            }
            self.clock.lap(&mut self.report.stages.detect_ns);
            if !changed {
                break;
            }
        }
        for source in sources.each().rev() {
            source.accept(self);
        }
        Ok(())
    }

    /// Solves until every source has settled and nothing is met any more.
    pub fn settle(&mut self, solves: &mut u32) -> Result<(), Status> {
        let sources = self.sources;
        for source in sources.each() {
            source.prepare(self);
        }
        loop {
            *solves += 1;
            if *solves > MOST_SOLVES {
                return Err(Status::NotConverged);
            }
            self.solve(*solves)?;
            let mut settled = true;
            for source in sources.each() {
                settled &= source.settle(self, *solves)?;
            }
            if settled && !sources.each().any(|source| source.meets(self)) {
                if self.work.touch.as_ref().is_some_and(TouchWork::is_full) {
                    return Err(Status::TooManyRows);
                }
                // Whoever asks where nodes are now asks for many.
                if self.pushes_many() {
                    self.find_all_nodes();
                }
                return Ok(());
            }
        }
    }

    /// Every source's rows, where the last solve left the tissue.
    pub fn append(&mut self) {
        let sources = self.sources;
        self.work.set.clear();
        for source in sources.each() {
            source.append(self);
        }
    }

    /// The compliance of these rows, for which at most `vertices` may have their columns computed.
    ///
    /// # Errors
    /// Too many rows, or columns that are awaited.
    pub fn assemble(&mut self, solve: u32, vertices: usize) -> Result<(), Status> {
        let BalanceWork { system, set, .. } = &mut *self.work;
        let singles = system.read(self.body, &set.anchors, &set.ways, &set.rows);
        if !(singles && system.read_spread(&set.spread, &set.terms)) {
            return Err(Status::TooManyRows);
        }
        let fetched = system.fetch(self.body, &self.state.grasp, vertices);
        self.take_columns(fetched)?;
        let BalanceWork { system, set, .. } = &mut *self.work;
        system.assemble(self.body, &self.state.grasp, &set.rows);
        let (n, sources) = (set.count(), self.sources);
        for (row, by) in &set.soft {
            system.compliance_mut(n)[*row as usize * (n + 1)] += *by;
        }
        for source in sources.each() {
            source.soften(self, solve);
        }
        Ok(())
    }

    fn take_columns(&mut self, fetched: Fetched) -> Result<(), Status> {
        self.report.columns_computed += 3 * fetched.computed;
        self.clock.lap(&mut self.report.stages.columns_ns);
        fetched.all.then_some(()).ok_or(Status::Waiting)
    }

    /// The `solve`th solve of a balance.
    fn solve(&mut self, solve: u32) -> Result<(), Status> {
        if self.work.effort_left < 0.0 || work::is_stopped() {
            return Err(Status::NotConverged);
        }
        self.append();
        self.assemble(solve, self.vertices_left())?;
        let BalanceWork {
            system,
            set,
            tools,
            nodes,
            effort_left,
            ..
        } = &mut *self.work;
        let mut turning = tools.turning_mut();
        if let Some(turning) = &mut turning {
            turning.aim(&self.state.tools, system, set.count(), self.points_m);
        }
        let outcome = system.solve(&set.rows, turning, &mut self.state.grasp);
        self.report.iterations += outcome.iterations;
        let rows = set.count() as f64;
        *effort_left -= f64::from(outcome.iterations) * rows * (rows + CONE_EFFORT);
        self.report.solves += 1;
        self.report.residual = outcome.residual;
        self.clock.lap(&mut self.report.stages.solve_ns);
        nodes.solved(self.state.grasp.pushes());
        if is_solved(&outcome) {
            Ok(())
        } else {
            Err(Status::NotConverged)
        }
    }

    /// Where a node is under the forces of the last solve \[m\].
    pub fn position(&self, node: u32) -> Vector3<f64> {
        self.work.nodes.position(
            node,
            self.body,
            self.points_m,
            &self.state.grasp,
            &self.work.system,
        )
    }

    /// Where a point of the tissue is under the forces of the last solve \[m\].
    pub fn position_of(&self, at: &AnchorPoint) -> Vector3<f64> {
        let parts = at.nodes.iter().zip(at.weights);
        parts
            .filter(|(_, weight)| *weight != 0.0)
            .map(|(node, weight)| self.position(*node) * weight)
            .sum()
    }

    /// Where a point of the tissue is without loads \[m\].
    pub fn unloaded(&self, at: &AnchorPoint) -> Vector3<f64> {
        let parts = at.nodes.iter().zip(at.weights);
        parts
            .map(|(node, weight)| unloaded(self.points_m, *node) * weight)
            .sum()
    }

    /// Vertices whose columns this step may still compute.
    pub fn vertices_left(&self) -> usize {
        self.most_vertices
            .saturating_sub(self.report.columns_computed as usize / 3)
    }

    /// Finds where all nodes are after the last solve.
    pub fn find_all_nodes(&mut self) {
        let BalanceWork { system, nodes, .. } = &mut *self.work;
        if nodes.at_solve == nodes.solves {
            return;
        }
        nodes.at_solve = nodes.solves;
        if nodes.pushes.is_empty() && self.body.is_linear() {
            // Nothing acts: all nodes rest.
            if !nodes.at_rest {
                nodes.at.copy_from_slice(&self.sources.resting_m);
                nodes.at_rest = true;
            }
            return;
        }
        nodes.at_rest = false;
        self.clock.lap(&mut self.report.stages.solve_ns);
        let numbering = self.body.numbering();
        let u = system.field(self.body, &self.state.grasp);
        for ((node, at), from) in (0u32..).zip(&mut nodes.at).zip(self.points_m) {
            *at = Vector3::from(*from) + Vector3::from(numbering.at_node(u, node));
        }
        self.report.fields += 1;
        self.clock.lap(&mut self.report.stages.field_ns);
    }

    /// Whether a field costs less than the sums that are asked for without one.
    fn pushes_many(&self) -> bool {
        self.work.nodes.pushes.len() > MANY_PUSHES
    }

    /// Finds where the forces of the last solve move its anchors.
    pub fn displace_anchors(&mut self) {
        // All nodes are to be found as soon as this solve is the last.
        if self.pushes_many() {
            self.find_all_nodes();
            self.work.system.displace_by_field();
        } else {
            self.work.system.displace(&self.state.grasp);
        }
    }

    /// As far as nodes of each group may be from where they rest \[m\], (groups).
    pub fn slack<'s>(&self, out: &'s mut [f64; MOST_GROUPS]) -> &'s [f64] {
        let Sources {
            hierarchy,
            resting,
            resting_m,
            ..
        } = self.sources;
        let groups = hierarchy.groups();
        let out = &mut out[..groups.len()];
        let BalanceWork { system, nodes, .. } = &*self.work;
        if nodes.at_solve == nodes.solves {
            // All are known: no bound is needed. Every needle asks, and more than once.
            let (solve, mut found) = nodes.slack.get();
            if solve != nodes.solves {
                let moved = |node: &u32| {
                    (nodes.at[*node as usize] - resting_m[*node as usize]).norm_squared()
                };
                for (slack, nodes) in found.iter_mut().zip(groups) {
                    *slack = nodes.iter().map(moved).fold(0.0, f64::max).sqrt();
                }
                nodes.slack.set((nodes.solves, found));
            }
            out.copy_from_slice(&found[..out.len()]);
            return out;
        }
        system.slack(self.body, &self.state.grasp, &nodes.pushes, resting, out);
        out
    }
}

/// Sums of forces on the same vertex: crossings share vertices.
struct PushSums {
    /// Force on each vertex that is pushed \[N\], and which are.
    force: Vec<Vector3<f64>>,
    pushed: Marks,
}

impl PushSums {
    /// For so many vertices.
    fn new(vertices: usize) -> Self {
        Self {
            force: vec![Vector3::zeros(); vertices],
            pushed: Marks::new(vertices),
        }
    }

    /// Into `out`, by ascending vertex.
    fn sum(&mut self, pushes: impl Iterator<Item = Push>, out: &mut Vec<Push>) {
        for (vertex, force) in pushes {
            let sum = &mut self.force[vertex as usize];
            if self.pushed.set(vertex) {
                *sum = force;
            } else {
                *sum += force;
            }
        }
        out.clear();
        let force = &self.force;
        self.pushed
            .take(|vertex| out.push((vertex, force[vertex as usize])));
    }
}

impl Nodes {
    /// Forgets where nodes rest: the loads have changed.
    pub fn rest_moved(&mut self) {
        self.at_rest = false;
    }

    /// Takes over the forces of a solve.
    fn solved(&mut self, pushes: impl Iterator<Item = Push>) {
        self.solves += 1;
        // A slack thread has anchors that nothing acts on.
        let acting = pushes.filter(|(_, force)| *force != Vector3::zeros());
        self.sums.sum(acting, &mut self.pushes);
    }

    /// See [`Balance::position`].
    pub fn position(
        &self,
        node: u32,
        body: &Body,
        points_m: &[[f64; 3]],
        grasp: &crate::anchors::ConstraintState,
        system: &ConstraintSystem,
    ) -> Vector3<f64> {
        if self.at_solve == self.solves {
            return self.at.get(node as usize).copied().unwrap_or_default();
        }
        let find =
            || unloaded(points_m, node) + system.displacement(body, grasp, &self.pushes, node);
        let Some(known) = self.known.get(node as usize) else {
            return find();
        };
        let (solve, at) = known.get();
        if solve == self.solves {
            return at;
        }
        let at = find();
        known.set((self.solves, at));
        at
    }
}

/// Where an unloaded node is \[m\].
pub(crate) fn unloaded(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    points_m
        .get(node as usize)
        .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
}
