//! One balance of tissue and needles: rows, slides, and what happens on the way.
//!
//! Entry point: [`Drive::to`]. Every crossing is an anchor with two transverse rows (3.29) and an axial
//! one that is bounded by friction. A row that reaches its bound slides: with w the tangent,
//! `delta = w.(s(alpha) - x)` is by how far the needle runs ahead of the tissue, so that the tissue
//! point is at `alpha - delta` afterwards. Directions turn with alpha on an arc, hence Newton's
//! method: the axial target is `w.s(alpha_k) + alpha_0 - alpha_k`, whose delta is the whole slide since
//! alpha_0. Between balances nothing of this is kept but alpha, which makes friction's law implicit:
//! it is plastic flow, integrated backwards (Simo & Hughes 1998, 1.4).

use super::hierarchy::MOST_GROUPS;
use super::model::{MAX_NEEDLES, Needles};
use super::sewing::head_at;
use super::state::{NeedleState, Tip};
use super::touching::turn;
use super::{Crossing, History, NeedleTissue};
use crate::anchors::{AnchorPoint, AnchorRow, ConstraintSet, Grasp, System, is_solved};
use crate::body::{Body, Push};
use crate::clock::Clock;
use crate::collide::{TouchState, TouchWork};
use crate::mesh::HalfFaces;
use crate::rows::RowKind;
use crate::source::tool::{Placements, ToolContacts, Turning, Turns};
use crate::step::{Status, StepReport};
use crate::thread::{BendWork, MOST_SEGMENTS, Segment, Skin, ThreadState, Wrap};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use std::cell::Cell;
use std::ops::Range;

/// Most solves of one balance.
const MOST_SOLVES: u32 = 64;
/// A slide is known well enough when it changes by less than this part of the needle \[1\].
const SLIDE_TOLERANCE: f64 = 3e-8;
/// Compliance of friction on fixed nodes \[m/N\]: far below any tissue's, so that it slides at once.
const RIGID_M_PER_N: f64 = 1e-6;
/// Least compliance of a row beside fixed nodes \[m/N\]: a hundredth of what an edge of soft tissue has.
const STIFFEST_M_PER_N: f64 = 3e-5;
/// Solves of one balance in which needles that nobody holds settle.
const LOOSE_SOLVES: u32 = 4;
/// Where more vertices than this are pushed, one solve for all nodes costs less than a sum for each that is asked for.
const MANY_PUSHES: usize = 150;

/// What a row's anchor is on its needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum What {
    Crossing(usize),
    Holding,
    Cut,
}

/// An anchor of the present rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub needle: usize,
    pub what: What,
    /// Of its three rows: along the needle, towards the inside of its curve, across both.
    pub first_row: usize,
    /// On the needle \[m\].
    pub alpha: f64,
}

/// A force that has been taken away, or tissue that has been taken hold of where the needle is not: until
/// the next solve says how far it moved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Release {
    pub(super) needle: usize,
    pub(super) at: AnchorPoint,
    pub(super) force: Vector3<f64>,
    pub(super) from: Vector3<f64>,
    /// The crossing that took hold.
    pub(super) taken: Option<usize>,
}

/// Rows of the present balance and scratch.
pub(crate) struct NeedleWork {
    pub system: System,
    /// Three rows for every point of a needle, then others.
    pub(super) set: ConstraintSet,
    pub(super) points: Vec<Point>,
    /// Rows of tools that touch, three for each contact.
    pub(super) tool_rows: Range<usize>,
    /// Vertices near these, and how far those of each group are from where they rest at most \[m\].
    pub(super) near_tools: Vec<(u32, u32)>,
    /// Their nodes, the nearest first.
    pub(super) next_nodes: Vec<u32>,
    pub(super) next_gaps: Vec<(f64, u32)>,
    pub(super) slack_m: [f64; MOST_GROUPS],
    pub(super) turning: Option<Turning>,
    pub(super) saved_tools: ToolContacts,
    pub(super) known_segments: Vec<Segment>,
    pub(super) saved_threads: Vec<ThreadState>,
    pub(super) saved_touch: Option<TouchState>,
    pub(super) touch: Option<TouchWork>,
    pub(super) skin: Option<Skin>,
    /// Where all nodes are \[m\], (n), by which solve.
    pub(super) at: Vec<Vector3<f64>>,
    pub(super) at_solve: u64,
    /// Whether that is where they rest without forces, and whether the skin was brought there last.
    pub(super) at_rest: bool,
    pub(super) skin_at_rest: bool,
    pub(super) bends: BendWork,
    pub(super) wraps: Vec<Wrap>,
    pub(super) pushes: Vec<Push>,
    /// Solves so far, and where each node was found to be in which of them, (n).
    pub(super) solves: u64,
    pub(super) known: Vec<Cell<(u64, Vector3<f64>)>>,
    pub(super) releases: Vec<Release>,
    pub(super) path: History,
    pub(super) no_history: History,
    pub(super) saved: Vec<NeedleState>,
    pub(super) saved_grasp: Grasp,
    /// Where each needle's tip was at the last balance, or where it came out since.
    pub(super) tips: Vec<Vector3<f64>>,
    /// Let go of a face, or was withdrawn from one, in this balance: the tissue that gives way is not to be
    /// gone into at once.
    pub(super) let_go: Vec<bool>,
    /// Where each point of the needles is acted on.
    pub(super) arms: Vec<Vector3<f64>>,
    /// Where each loose needle turns about in the last solve, and its drag.
    pub(super) drags: Vec<Option<(Vector3<f64>, Vector6<f64>)>>,
    /// Took the face that it holds in this balance.
    pub(super) took: Vec<bool>,
    /// Pressing against the end of the cut was tried in this balance.
    pub(super) pressed: Vec<bool>,
}

impl NeedleWork {
    pub fn new(
        needles: &Needles,
        system: System,
        states: &[NeedleState],
        threads: &[ThreadState],
        touch: Option<&TouchState>,
        grasp: &Grasp,
    ) -> Self {
        let nodes = needles.mesh.nodes();
        let settings = needles.anchor_settings();
        let anchors = settings.most_anchors;
        let count = states.len();
        Self {
            system,
            set: ConstraintSet::new(&settings),
            tool_rows: 0..0,
            near_tools: Vec::with_capacity(needles.tools.most_pairs()),
            next_nodes: Vec::with_capacity(needles.tools.most_pairs()),
            next_gaps: Vec::with_capacity(needles.tools.most_pairs()),
            slack_m: [0.0; MOST_GROUPS],
            turning: needles
                .tools
                .turning(settings.most_rows + settings.most_spread),
            saved_tools: ToolContacts::new(&needles.tools),
            known_segments: Vec::with_capacity(anchors),
            saved_threads: threads.to_vec(),
            saved_touch: touch.cloned(),
            touch: needles
                .touching
                .as_ref()
                .map(|touching| TouchWork::new(touching, nodes)),
            skin: (!threads.is_empty())
                .then(|| Skin::new(needles.mesh.boundary().triangles(), &needles.resting_m)),
            at: needles.resting_m.clone(),
            bends: BendWork::new(MOST_SEGMENTS),
            at_solve: u64::MAX,
            at_rest: false,
            skin_at_rest: false,
            wraps: Vec::with_capacity(MOST_SEGMENTS),
            points: Vec::with_capacity(anchors),
            pushes: Vec::with_capacity(4 * anchors),
            solves: 0,
            known: vec![Cell::new((0, Vector3::zeros())); needles.mesh.nodes()],
            releases: Vec::with_capacity(anchors),
            path: History::new(needles.settings.most_crossings),
            no_history: History::new(0),
            saved: states.to_vec(),
            saved_grasp: Grasp::new(grasp.motion().clone(), &settings),
            tips: vec![Vector3::zeros(); count],
            let_go: vec![false; count],
            arms: Vec::with_capacity(anchors),
            drags: vec![None; count],
            took: vec![false; count],
            pressed: vec![false; count],
        }
    }

    /// Rows of the present balance, those on several anchors included.
    pub(super) fn count(&self) -> usize {
        self.set.count()
    }
}

/// Everything that a balance works on.
pub(super) struct Drive<'a> {
    pub body: &'a Body,
    pub needles: &'a Needles,
    /// Unloaded nodes \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    pub states: &'a mut [NeedleState],
    pub threads: &'a mut [ThreadState],
    pub touch: Option<&'a mut TouchState>,
    pub tools: &'a mut ToolContacts,
    pub grasp: &'a mut Grasp,
    pub work: &'a mut NeedleWork,
    pub report: &'a mut StepReport,
    pub clock: &'a mut Clock,
}
impl Drive<'_> {
    /// Balances the tissue with the needles at `poses` and what else holds threads at `ends`; if that fails everything
    /// is as before.
    pub fn to(
        &mut self,
        poses: &[Isometry3<f64>],
        ends: &[[Vector3<f64>; 2]],
        tools: &Placements,
    ) -> Result<(), Status> {
        self.work.saved_tools.copy_from(self.tools);
        self.tools.place(&self.needles.tools, tools);
        for (saved, state) in self.work.saved.iter_mut().zip(self.states.iter()) {
            saved.copy_from(state);
        }
        let threads = self
            .work
            .saved_threads
            .iter_mut()
            .zip(self.threads.iter_mut());
        for ((saved, thread), [tail, head]) in threads.zip(ends) {
            saved.copy_from(thread);
            thread.tail.at = *tail;
            thread.head.at = *head;
        }
        if let (Some(saved), Some(touch)) = (&mut self.work.saved_touch, &self.touch) {
            saved.copy_from(touch);
        }
        self.work.saved_grasp.copy_rows(self.grasp);
        self.work.releases.clear();
        let done = self.balance(poses, None);
        if done.is_err() {
            for (state, saved) in self.states.iter_mut().zip(&self.work.saved) {
                state.copy_from(saved);
            }
            for (state, saved) in self.threads.iter_mut().zip(&self.work.saved_threads) {
                state.copy_from(saved);
            }
            if let (Some(saved), Some(touch)) = (&self.work.saved_touch, &mut self.touch) {
                touch.copy_from(saved);
            }
            self.tools.copy_from(&self.work.saved_tools);
            self.grasp.copy_rows(&self.work.saved_grasp);
        }
        done
    }

    /// As [`Self::to`], at the end of a way that was not followed.
    pub fn jump(
        &mut self,
        poses: &[Isometry3<f64>],
        ends: &[[Vector3<f64>; 2]],
        tools: &Placements,
    ) -> Status {
        match self.to(poses, ends, tools) {
            Ok(()) => Status::Ok,
            Err(status) => status,
        }
    }

    /// Balances; a tip that is `free` goes through faces without effort.
    pub(super) fn balance(
        &mut self,
        poses: &[Isometry3<f64>],
        free: Option<usize>,
    ) -> Result<(), Status> {
        self.begin(poses, free);
        let mut solves = 0;
        loop {
            self.slide(&mut solves)?;
            self.unfold();
            if self.work.pushes.len() > MANY_PUSHES {
                self.look_at_all();
            }
            self.settle_releases();
            if !self.follow(free)? {
                break;
            }
        }
        self.finish();
        Ok(())
    }

    /// Puts the needles where they shall be; while the way of one is played back nothing begins for the others.
    pub(super) fn begin(&mut self, poses: &[Isometry3<f64>], free: Option<usize>) {
        let mut poses_before = [Isometry3::identity(); MAX_NEEDLES];
        for (before, state) in poses_before.iter_mut().zip(self.states.iter()) {
            *before = state.pose;
        }
        for (index, (state, pose)) in self.states.iter_mut().zip(poses).enumerate() {
            if free.is_some_and(|free| free != index) {
                continue;
            }
            if free.is_none() {
                let curve = self.needles.parts[index].needle.at(&state.pose);
                self.work.tips[index] = curve.at(curve.length);
            }
            self.work.let_go[index] = false;
            self.work.took[index] = false;
            self.work.pressed[index] = false;
            state.pose = *pose;
            if let Tip::Inside { cut: Some(cut) } = &mut state.tip {
                cut.pressed = true;
            }
        }
        self.stick();
        self.predict(poses_before);
    }

    /// What slid will slide on, by about the uniform slide (3.9, 3.17); a line needs no guess.
    pub(super) fn predict(&mut self, before: [Isometry3<f64>; MAX_NEEDLES]) {
        let parts = self.needles.parts.iter().zip(&before);
        for (state, (part, before)) in self.states.iter_mut().zip(parts) {
            let (from, to) = (part.needle.at(before), part.needle.at(&state.pose));
            if from.curvature == 0.0 {
                continue;
            }
            let middle = 0.5 * from.length;
            let slide = from.project(&to.at(middle), middle) - middle;
            for index in 0..state.holds.len() {
                let hold = state.holds[index];
                if hold.slides && slide.abs() < from.length {
                    state.history.set_alpha(index, hold.alpha - slide);
                }
            }
        }
    }

    /// From now on crossings stick where they are.
    pub(super) fn stick(&mut self) {
        for state in self.states.iter_mut() {
            for (hold, crossing) in state.holds.iter_mut().zip(state.history.crossings()) {
                hold.alpha = crossing.alpha;
            }
        }
    }

    /// Solves until the slides are known.
    pub(super) fn slide(&mut self, solves: &mut u32) -> Result<(), Status> {
        for (state, part) in self.states.iter_mut().zip(&self.needles.parts) {
            limits(self.needles, state, part.needle.shape.length_m());
        }
        self.lay_threads();
        loop {
            *solves += 1;
            if *solves > MOST_SOLVES {
                return Err(Status::NotConverged);
            }
            self.solve(*solves)?;
            let mut settled = true;
            let (delta, lambda) = (self.grasp.delta_m(), self.grasp.lambda());
            for point in &self.work.points {
                let state = &mut self.states[point.needle];
                let needle = &self.needles.parts[point.needle].needle;
                if let What::Crossing(index) = point.what {
                    let alpha = state.holds[index].alpha - delta[point.first_row];
                    let bends = needle.shape.curvature_per_m() > 0.0;
                    let change = (alpha - point.alpha).abs();
                    settled &= !bends || change <= SLIDE_TOLERANCE * needle.shape.length_m();
                    state.history.set_alpha(index, alpha);
                    continue;
                }
                let (What::Cut, Tip::Inside { cut: Some(cut) }) = (point.what, &mut state.tip)
                else {
                    continue;
                };
                // The end of the cut can be pushed, not pulled.
                let pulls = cut.pressed && lambda[point.first_row] > 0.0;
                let goes_in = !cut.pressed && delta[point.first_row] > 0.0;
                let tried = &mut self.work.pressed[point.needle];
                if pulls || (goes_in && !*tried) {
                    cut.pressed = goes_in;
                    *tried |= goes_in;
                    settled = false;
                }
            }
            self.lead_followers();
            settled &= self.settle_threads();
            settled &= self.settle_tools(*solves)?;
            // One that is not at rest by then lies still, and goes on in the next balance.
            settled &= *solves > LOOSE_SOLVES || self.settle_loose();
            if settled && !self.meets() {
                return Ok(());
            }
        }
    }

    /// Tissue that has been folded by more than its own thickness would have crossings change places: what
    /// slides stops at the next one instead.
    pub(super) fn unfold(&mut self) {
        for state in self.states.iter_mut() {
            let count = state.holds.len();
            let mut folded = false;
            let alpha = |state: &NeedleState, index: usize| state.history.crossings()[index].alpha;
            for index in (1..count).rev() {
                let (own, next) = (alpha(state, index - 1), alpha(state, index));
                let slid = own != state.holds[index - 1].alpha;
                if own > next && slid {
                    state.history.set_alpha(index - 1, next);
                    folded = true;
                }
            }
            for index in 1..count {
                let (before, own) = (alpha(state, index - 1), alpha(state, index));
                if own < before {
                    state.history.set_alpha(index, before);
                    folded = true;
                }
            }
            state.tally.folded += u32::from(folded);
        }
    }

    /// Crossings without rows of their own go with the one before them.
    pub(super) fn lead_followers(&mut self) {
        for state in self.states.iter_mut() {
            let mut slide = 0.0;
            for index in 0..state.holds.len() {
                let hold = state.holds[index];
                if hold.follows {
                    state.history.set_alpha(index, hold.alpha + slide);
                } else if let Some(crossing) = state.history.crossings().get(index) {
                    slide = crossing.alpha - hold.alpha;
                }
            }
        }
    }

    /// One solve of the rows at the present poses and slides, the `solve`th of the balance.
    pub(super) fn solve(&mut self, solve: u32) -> Result<(), Status> {
        self.make_rows();
        let Self {
            body,
            grasp,
            work,
            report,
            clock,
            ..
        } = self;
        let NeedleWork { system, set, .. } = &mut **work;
        let ConstraintSet {
            anchors,
            ways,
            rows,
            ..
        } = &*set;
        let singles = system.read(body, anchors, ways, rows);
        if !(singles && system.read_spread(&set.spread, &set.terms)) {
            return Err(Status::TooManyRows);
        }
        let most = system.settings().vertices_per_step;
        let fetched = system.fetch(
            body,
            grasp,
            most.saturating_sub(report.columns_computed as usize / 3),
        );
        report.columns_computed += 3 * fetched.computed;
        clock.lap(&mut report.stages.columns_ns);
        if !fetched.all {
            return Err(Status::Waiting);
        }
        system.assemble(body, grasp, &set.rows);
        self.soften();
        if solve <= LOOSE_SOLVES {
            self.loosen();
        }
        let Self {
            needles,
            points_m,
            tools,
            grasp,
            work,
            report,
            clock,
            ..
        } = self;
        let turns = turn(needles, tools, work, Turns::Sliding);
        let NeedleWork {
            system,
            set,
            turning,
            ..
        } = &mut **work;
        let mut turning = turning.as_mut().filter(|_| turns);
        if let Some(turning) = &mut turning {
            turning.aim(tools, system, set.count(), points_m);
        }
        let outcome = system.solve(&set.rows, turning, grasp);
        report.iterations += outcome.iterations;
        report.solves += 1;
        report.residual = outcome.residual;
        clock.lap(&mut report.stages.solve_ns);
        work.solves += 1;
        work.pushes.clear();
        // A slack thread has anchors that nothing acts on.
        work.pushes.extend(
            grasp
                .pushes()
                .filter(|(_, force)| *force != Vector3::zeros()),
        );
        // Crossings share vertices.
        work.pushes.sort_unstable_by_key(|(vertex, _)| *vertex);
        work.pushes.dedup_by(|(vertex, force), (kept, sum)| {
            let same = vertex == kept;
            if same {
                *sum += *force;
            }
            same
        });
        if !is_solved(&outcome) {
            return Err(Status::NotConverged);
        }
        Ok(())
    }

    /// Friction on what cannot move needs something that gives way, or it would be none.
    pub(super) fn soften(&mut self) {
        let n = self.work.count();
        let NeedleWork {
            system,
            points,
            set,
            ..
        } = &mut *self.work;
        let w = system.compliance_mut(n);
        for (row, by) in &set.soft {
            w[*row as usize * (n + 1)] += *by;
        }
        for point in points.iter() {
            for row in point.first_row..point.first_row + 3 {
                let own = &mut w[row * (n + 1)];
                // Next to what does not move a way of nothing would be a force of everything.
                if *own > 0.0 {
                    *own = own.max(STIFFEST_M_PER_N);
                } else if row == point.first_row && point.what != What::Holding {
                    *own = RIGID_M_PER_N;
                }
            }
        }
    }

    /// Rows of every needle at its pose and present alphas.
    pub(super) fn make_rows(&mut self) {
        let NeedleWork {
            set,
            points,
            tool_rows,
            ..
        } = &mut *self.work;
        set.clear();
        points.clear();
        for (index, state) in self.states.iter().enumerate() {
            let curve = self.needles.parts[index].needle.at(&state.pose);
            let mut add =
                |what, at: AnchorPoint, alpha: f64, slid: f64, id: u32, kinds: [RowKind; 3]| {
                    let rest: Vector3<f64> = at
                        .nodes
                        .iter()
                        .zip(at.weights)
                        .map(|(node, weight)| place(self.points_m, *node) * weight)
                        .sum();
                    let to = curve.at(alpha) - rest;
                    points.push(Point {
                        needle: index,
                        what,
                        first_row: set.rows.len(),
                        alpha,
                    });
                    let anchor = set.add(at);
                    for (axis, (direction, kind)) in
                        (0u64..).zip(curve.frame_at(alpha).into_iter().zip(kinds))
                    {
                        let slid = if axis == 0 { slid } else { 0.0 };
                        set.rows.push(AnchorRow {
                            id: (index as u64) << 34 | u64::from(id) << 2 | axis,
                            anchor,
                            kind,
                            direction: direction.into(),
                            target_m: direction.dot(&to) + slid,
                        });
                    }
                };
            let equal = RowKind::Equality;
            for (place, (crossing, hold)) in state
                .history
                .crossings()
                .iter()
                .zip(&state.holds)
                .enumerate()
                .filter(|(_, (_, hold))| !hold.follows)
            {
                let limit_n = hold.limit_n;
                add(
                    What::Crossing(place),
                    anchor(&self.needles.mesh, crossing),
                    crossing.alpha,
                    hold.alpha - crossing.alpha,
                    hold.id,
                    [RowKind::Box { limit_n }, equal, equal],
                );
            }
            match state.tip {
                Tip::Holding { face, id } => add(
                    What::Holding,
                    anchor(&self.needles.mesh, &face),
                    curve.length,
                    0.0,
                    id,
                    [equal; 3],
                ),
                Tip::Inside { cut: Some(cut) } => {
                    let limit_n = if cut.pressed { cut.limit_n } else { 0.0 };
                    let none = RowKind::Box { limit_n: 0.0 };
                    let kinds = [RowKind::Box { limit_n }, none, none];
                    add(What::Cut, cut.at, curve.length, 0.0, 0, kinds);
                }
                _ => {}
            }
        }
        if let (Some(touching), Some(touch)) = (&self.needles.touching, &self.touch) {
            touch.rows(touching, self.points_m, &mut set.anchors, &mut set.rows);
        }
        let first = set.rows.len();
        self.tools.append(&self.needles.tools, self.points_m, set);
        *tool_rows = first..set.rows.len();
        self.needles.handles.append(set);
        let held = &self.needles.threads;
        let ground = held.ground(&self.needles.mesh, self.points_m);
        for (index, thread) in self.threads.iter_mut().enumerate() {
            let needle = &self.states[held.needles[index]];
            let is_held =
                thread.is_tail_held() && head_at(self.needles, needle, thread, index).is_some();
            thread.make_rows(index, &held.parts[index], is_held, &ground, set);
        }
    }

    /// Where a node is under the forces of the last solve.
    pub(super) fn position(&self, node: u32) -> Vector3<f64> {
        position(self.body, self.points_m, self.grasp, self.work, node)
    }

    pub(super) fn position_of(&self, at: &AnchorPoint) -> Vector3<f64> {
        at.nodes
            .iter()
            .zip(at.weights)
            .filter(|(_, weight)| *weight != 0.0)
            .map(|(node, weight)| self.position(*node) * weight)
            .sum()
    }

    /// How far a crossing is from the last face that a thread goes through; 0 if there is none.
    pub(super) fn apart(&self, thread: usize, crossing: &Crossing) -> f64 {
        let last = self
            .threads
            .get(thread)
            .and_then(|thread| thread.passed.last());
        last.map_or(0.0, |last| {
            let [a, b] = [&last.crossing, crossing]
                .map(|crossing| self.position_of(&anchor(&self.needles.mesh, crossing)));
            a.metric_distance(&b)
        })
    }

    /// Takes over what the balance found.
    pub(super) fn finish(&mut self) {
        self.book();
        self.finish_sewing();
        self.finish_tools();
        for needle in 0..self.states.len() {
            if matches!(self.states[needle].tip, Tip::Holding { .. }) {
                self.states[needle].log_pose();
            }
            self.cut(needle);
        }
    }
}

/// Where an unloaded node is.
pub(super) fn place(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    points_m
        .get(node as usize)
        .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
}

/// Where a node is under the forces of the last solve.
pub(super) fn position(
    body: &Body,
    points_m: &[[f64; 3]],
    grasp: &Grasp,
    work: &NeedleWork,
    node: u32,
) -> Vector3<f64> {
    if work.at_solve == work.solves {
        return work.at.get(node as usize).copied().unwrap_or_default();
    }
    let find = || place(points_m, node) + work.system.displacement(body, grasp, &work.pushes, node);
    let Some(known) = work.known.get(node as usize) else {
        return find();
    };
    let (solve, at) = known.get();
    if solve == work.solves {
        return at;
    }
    let at = find();
    known.set((work.solves, at));
    at
}

/// The tissue point of a crossing.
pub(crate) fn anchor(mesh: &HalfFaces, crossing: &Crossing) -> AnchorPoint {
    let [a, b, c] = mesh.vertices(crossing.face);
    let [x, y, z] = crossing.weights;
    AnchorPoint {
        nodes: [a, b, c, a],
        weights: [x, y, z, 0.0],
    }
}

/// A shift and a turn about a point.
pub(super) fn about(
    centre: &Vector3<f64>,
    shift: &Vector3<f64>,
    turn: &Vector3<f64>,
) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(*turn);
    let to = centre + shift - rotation * centre;
    Isometry3::from_parts(Translation3::from(to), rotation)
}

/// Bounds of the axial forces: friction per length, half of the length between two crossings to each,
/// and to the one next to the tip, or to the end, all of it.
pub(super) fn limits(needles: &Needles, state: &mut NeedleState, length: f64) {
    let mesh = &needles.mesh;
    let per_length = |tissue: &NeedleTissue, slides: bool, speed: f64| {
        if slides {
            tissue.friction_n_per_m + tissue.viscous_n_s_per_m2 * speed
        } else {
            tissue.static_friction_n_per_m.max(tissue.friction_n_per_m)
                + tissue.viscous_n_s_per_m2 * speed
        }
    };
    let speed = state.speed.abs();
    let crossings = state.history.crossings();
    let count = state.holds.len();
    let mut leader = 0;
    for (index, crossing) in crossings.iter().enumerate().take(count) {
        let mut own = state.holds[index];
        if own.follows {
            own.slides = state.holds[leader].slides;
        } else {
            leader = index;
        }
        let share = |cell: Option<u32>, from: f64, to: f64, part: f64| match cell {
            Some(cell) => {
                part * (to - from).max(0.0) * per_length(needles.tissue(cell), own.slides, speed)
            }
            None => 0.0,
        };
        let behind = match index.checked_sub(1) {
            Some(other) => share(crossing.from(), state.holds[other].alpha, own.alpha, 0.5),
            None => share(crossing.from(), 0.0, own.alpha, 1.0),
        };
        let ahead = match state.holds.get(index + 1) {
            Some(next) => share(crossing.to(mesh), own.alpha, next.alpha, 0.5),
            None => share(crossing.to(mesh), own.alpha, length, 1.0),
        };
        state.holds[index].limit_n = 0.0;
        state.holds[leader].limit_n += behind + ahead;
    }
}
