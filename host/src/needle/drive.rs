//! One balance of tissue and needles: rows, slides, and what happens on the way.
//!
//! Entry point: [`Drive::to`]. Every crossing is an anchor with two transverse rows (3.29) and an axial
//! one that is bounded by friction. A row that reaches its bound slides: with w the tangent,
//! `delta = w.(s(alpha) - x)` is by how far the needle runs ahead of the tissue, so that the tissue
//! point is at `alpha - delta` afterwards. Directions turn with alpha on an arc, hence Newton's
//! method: the axial target is `w.s(alpha_k) + alpha_0 - alpha_k`, whose delta is the whole slide since
//! alpha_0. Between balances nothing of this is kept but alpha, which makes friction's law implicit:
//! it is plastic flow, integrated backwards (Simo & Hughes 1998, 1.4).

use super::model::{MAX_NEEDLES, Needles, Playback};
use super::state::{Cut, NeedleState, Tip};
use super::{
    Crossing, Curve, Geometry, History, MOST_GROUPS, NeedleTissue, Slack, Stop, entry, walk,
};
use crate::anchors::{AnchorPoint, AnchorRow, Grasp, System, is_solved};
use crate::body::{Body, Push};
use crate::clock::Clock;
use crate::mesh::HalfFaces;
use crate::rows::{Mode, RowKind};
use crate::step::{Status, StepReport};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3, Vector6};
use std::cell::Cell;

/// Most solves of one balance.
const MOST_SOLVES: u32 = 64;
/// A slide is known well enough when it changes by less than this part of the needle \[1\].
const SLIDE_TOLERANCE: f64 = 3e-8;
/// Where a tip comes from is looked for from this part of the needle behind it \[1\]: it may have come to
/// lie in the face that it left.
const BACK: f64 = 1e-6;
/// Poses that are played back after a puncture.
const PLAYED: usize = 16;
/// Stiffness with which a needle that nobody holds is held back in each solve, in parts of the
/// tissue's: it settles by a factor of about this in every one.
const DRAG: f64 = 1e-5;

/// Compliance of friction on fixed nodes \[m/N\]: far below any tissue's, so that it slides at once.
const RIGID_M_PER_N: f64 = 1e-6;

/// As far a needle that nobody holds turns between two solves \[rad\].
const MOST_LOOSE_TURN: f64 = 0.1;
/// Solves of one balance in which needles that nobody holds settle.
const LOOSE_SOLVES: u32 = 4;

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
    needle: usize,
    at: AnchorPoint,
    force: Vector3<f64>,
    from: Vector3<f64>,
    /// The crossing that took hold.
    taken: Option<usize>,
}

/// Rows of the present balance and scratch.
pub(crate) struct NeedleWork {
    pub system: System,
    pub(super) anchors: Vec<AnchorPoint>,
    pub(super) rows: Vec<AnchorRow>,
    pub(super) points: Vec<Point>,
    pushes: Vec<Push>,
    /// Solves so far, and where each node was found to be in which of them, (n).
    solves: u64,
    known: Vec<Cell<(u64, Vector3<f64>)>>,
    releases: Vec<Release>,
    path: History,
    no_history: History,
    saved: Vec<NeedleState>,
    saved_grasp: Grasp,
    /// Where each needle's tip was at the last balance, or where it came out since.
    tips: Vec<Vector3<f64>>,
    /// Let go of a face, or was withdrawn from one, in this balance: the tissue that gives way is not to be
    /// gone into at once.
    let_go: Vec<bool>,
    /// Where each point of the needles is acted on.
    arms: Vec<Vector3<f64>>,
    /// Where each loose needle turns about in the last solve, and its drag.
    drags: Vec<Option<(Vector3<f64>, Vector6<f64>)>>,
    /// Took the face that it holds in this balance.
    took: Vec<bool>,
    /// Pressing against the end of the cut was tried in this balance.
    pressed: Vec<bool>,
}

impl NeedleWork {
    pub fn new(needles: &Needles, system: System, states: &[NeedleState], grasp: &Grasp) -> Self {
        let settings = needles.anchor_settings();
        let (rows, anchors) = (settings.most_rows, settings.most_anchors);
        let count = states.len();
        Self {
            system,
            anchors: Vec::with_capacity(anchors),
            rows: Vec::with_capacity(rows),
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
}

/// Everything that a balance works on.
pub(super) struct Drive<'a> {
    pub body: &'a Body,
    pub needles: &'a Needles,
    /// Unloaded nodes \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    pub states: &'a mut [NeedleState],
    pub grasp: &'a mut Grasp,
    pub work: &'a mut NeedleWork,
    pub report: &'a mut StepReport,
    pub clock: &'a mut Clock,
}

impl Drive<'_> {
    /// Balances the tissue with the needles at `poses`; if that fails everything is as before.
    pub fn to(&mut self, poses: &[Isometry3<f64>]) -> Result<(), Status> {
        for (saved, state) in self.work.saved.iter_mut().zip(self.states.iter()) {
            saved.copy_from(state);
        }
        self.work.saved_grasp.copy_rows(self.grasp);
        self.work.releases.clear();
        let done = self.balance(poses, None);
        if done.is_err() {
            for (state, saved) in self.states.iter_mut().zip(&self.work.saved) {
                state.copy_from(saved);
            }
            self.grasp.copy_rows(&self.work.saved_grasp);
        }
        done
    }

    /// Balances; a tip that is `free` goes through faces without effort.
    fn balance(&mut self, poses: &[Isometry3<f64>], free: Option<usize>) -> Result<(), Status> {
        self.begin(poses, free);
        let mut solves = 0;
        loop {
            self.slide(&mut solves)?;
            self.unfold();
            self.settle_releases();
            if !self.follow(free)? {
                break;
            }
        }
        self.finish();
        Ok(())
    }

    /// Puts the needles where they shall be; while the way of one is played back nothing begins for the others.
    fn begin(&mut self, poses: &[Isometry3<f64>], free: Option<usize>) {
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
    fn predict(&mut self, before: [Isometry3<f64>; MAX_NEEDLES]) {
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
    fn stick(&mut self) {
        for state in self.states.iter_mut() {
            for (hold, crossing) in state.holds.iter_mut().zip(state.history.crossings()) {
                hold.alpha = crossing.alpha;
            }
        }
    }

    /// Solves until the slides are known.
    fn slide(&mut self, solves: &mut u32) -> Result<(), Status> {
        for (state, part) in self.states.iter_mut().zip(&self.needles.parts) {
            limits(self.needles, state, part.needle.shape.length_m());
        }
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
            // One that is not at rest by then lies still, and goes on in the next balance.
            settled &= *solves > LOOSE_SOLVES || self.settle_loose();
            if settled {
                return Ok(());
            }
        }
    }

    /// Tissue that has been folded by more than its own thickness would have crossings change places: what
    /// slides stops at the next one instead.
    fn unfold(&mut self) {
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
    fn lead_followers(&mut self) {
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
    fn solve(&mut self, solve: u32) -> Result<(), Status> {
        self.make_rows();
        let Self {
            body,
            grasp,
            work,
            report,
            clock,
            ..
        } = self;
        let NeedleWork {
            system,
            anchors,
            rows,
            ..
        } = &mut **work;
        if !system.read(body, anchors, rows) {
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
        system.assemble(body, grasp, rows);
        self.soften();
        if solve <= LOOSE_SOLVES {
            self.loosen();
        }
        let Self {
            grasp,
            work,
            report,
            clock,
            ..
        } = self;
        let outcome = work.system.solve(&work.rows, grasp);
        report.iterations += outcome.iterations;
        report.residual = outcome.residual;
        clock.lap(&mut report.stages.solve_ns);
        work.solves += 1;
        work.pushes.clear();
        work.pushes.extend(grasp.pushes());
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
    fn soften(&mut self) {
        let n = self.work.rows.len();
        let NeedleWork { system, points, .. } = &mut *self.work;
        let w = system.compliance_mut(n);
        for point in points.iter().filter(|point| point.what != What::Holding) {
            let own = &mut w[point.first_row * (n + 1)];
            if *own == 0.0 {
                *own = RIGID_M_PER_N;
            }
        }
    }

    /// Rows of every needle at its pose and present alphas.
    fn make_rows(&mut self) {
        let NeedleWork {
            anchors,
            rows,
            points,
            ..
        } = &mut *self.work;
        anchors.clear();
        rows.clear();
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
                        first_row: rows.len(),
                        alpha,
                    });
                    let anchor = anchors.len() as u32;
                    anchors.push(at);
                    for (axis, (direction, kind)) in
                        (0u64..).zip(curve.frame_at(alpha).into_iter().zip(kinds))
                    {
                        let slid = if axis == 0 { slid } else { 0.0 };
                        rows.push(AnchorRow {
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

    /// The energy that went, or came, with what was let go and taken hold of before the last solve. Between
    /// two balances of linear tissue it changes by the sum of (f + f').(x' - x) / 2 over all anchors; the
    /// others' share is the hand's work and their slides.
    fn settle_releases(&mut self) {
        for index in 0..self.work.releases.len() {
            let release = self.work.releases[index];
            let moved = self.position_of(&release.at) - release.from;
            let point = release.taken.and_then(|taken| {
                let what = What::Crossing(taken);
                let is = |point: &Point| point.needle == release.needle && point.what == what;
                self.work.points.iter().position(is)
            });
            let now = point.map_or_else(Vector3::zeros, |point| self.grasp.force_on(point));
            // Its slide is booked with the others'.
            let slid = release
                .taken
                .map_or_else(Vector3::zeros, |taken| self.slid(release.needle, taken));
            let done = 0.5 * (release.force + now).dot(&(moved - slid));
            self.states[release.needle].tally.release_j -= done;
        }
        self.work.releases.clear();
    }

    /// By how much a crossing has slid in this balance \[m\].
    fn slid(&self, needle: usize, crossing: usize) -> Vector3<f64> {
        let state = &self.states[needle];
        let crossings = state.history.crossings();
        let (Some(now), Some(hold)) = (crossings.get(crossing), state.holds.get(crossing)) else {
            return Vector3::zeros();
        };
        let curve = self.needles.parts[needle].needle.at(&state.pose);
        curve.at(now.alpha) - curve.at(hold.alpha)
    }

    /// Takes the rows of a point of needle `needle` away: remembers their force.
    fn release(&mut self, needle: usize, what: What) {
        let found = self
            .work
            .points
            .iter()
            .position(|point| point.needle == needle && point.what == what);
        // One that came after the last solve has no force.
        let Some(index) = found else {
            return;
        };
        let force = self.grasp.force_on(index);
        if force != Vector3::zeros() && self.work.releases.len() < self.work.releases.capacity() {
            let at = self.work.anchors[index];
            let from = self.position_of(&at);
            self.work.releases.push(Release {
                needle,
                at,
                force,
                from,
                taken: None,
            });
        }
    }

    /// The needle takes hold of a crossing that may be beside it.
    fn take_hold(&mut self, needle: usize, crossing: Crossing) -> Result<(), Status> {
        let at = anchor(&self.needles.mesh, &crossing);
        let from = self.position_of(&at);
        let state = &mut self.states[needle];
        let taken = state.holds.len();
        if !state.history.push(crossing) {
            return Err(Status::TooManyRows);
        }
        state.hold_new(self.needles.apart_m);
        if self.work.releases.len() < self.work.releases.capacity() {
            self.work.releases.push(Release {
                needle,
                at,
                force: Vector3::zeros(),
                from,
                taken: Some(taken),
            });
        }
        Ok(())
    }

    /// Moves tips and histories to the solved tissue; whether rows came or went that change the balance.
    fn follow(&mut self, free: Option<usize>) -> Result<bool, Status> {
        let mut changed = false;
        for needle in 0..self.states.len() {
            changed |= self.follow_hold(needle, free)?;
            changed |= self.withdraw(needle);
            changed |= self.advance(needle)?;
        }
        self.clock.lap(&mut self.report.stages.detect_ns);
        Ok(changed)
    }

    /// A tip that holds a face: it may let go, or go through.
    fn follow_hold(&mut self, needle: usize, free: Option<usize>) -> Result<bool, Status> {
        let Tip::Holding { face, .. } = self.states[needle].tip else {
            return Ok(false);
        };
        let found = self
            .work
            .points
            .iter()
            .find(|point| point.needle == needle && point.what == What::Holding);
        let Some(point) = found else {
            return Ok(false);
        };
        let push = -self.grasp.lambda()[point.first_row];
        // A face that cannot give way holds nothing back.
        let rigid = self.grasp.delta_m()[point.first_row] > 0.0
            && self.work.system.compliance(self.work.rows.len())
                [point.first_row * (self.work.rows.len() + 1)]
                == 0.0;
        let area = self.needles.parts[needle].needle.tip_area_m2();
        let limit = self.needles.tissue(face.face.cell()).puncture_pa * area;
        if push < 0.0 {
            // Nobody has done work on what was taken only now.
            if !self.work.took[needle] {
                self.release(needle, What::Holding);
            }
            self.work.let_go[needle] = true;
            let state = &mut self.states[needle];
            state.log.clear();
            state.tip = if face.enters {
                state.left = Some(face);
                Tip::Outside
            } else {
                Tip::Inside { cut: None }
            };
            return Ok(true);
        }
        let free = free == Some(needle);
        if push > limit || free || (rigid && limit.is_finite()) {
            self.puncture(needle, face, free)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Crossings that have slid off the tip, and off the end.
    fn withdraw(&mut self, needle: usize) -> bool {
        let length = self.needles.parts[needle].needle.shape.length_m();
        let mut changed = false;
        while let Some(last) = self.states[needle].history.crossings().last().copied() {
            if last.alpha <= length {
                break;
            }
            let index = self.states[needle].holds.len() - 1;
            self.release(needle, What::Crossing(index));
            self.release(needle, What::Cut);
            self.release(needle, What::Holding);
            self.work.let_go[needle] = true;
            let state = &mut self.states[needle];
            state.history.pop();
            state.holds.truncate(index);
            // What it held lay beyond this face.
            state.log.clear();
            state.tip = match state.history.tip_cell(&self.needles.mesh) {
                Some(_) => Tip::Inside { cut: None },
                None => Tip::Outside,
            };
            changed = true;
        }
        let crossings = self.states[needle].history.crossings();
        let behind = crossings
            .iter()
            .take_while(|first| first.alpha < 0.0)
            .count();
        for index in 0..behind {
            self.release(needle, What::Crossing(index));
        }
        if behind > 0 {
            let state = &mut self.states[needle];
            state.history.drop_behind(&self.needles.mesh, 0.0);
            state.holds.drain(..behind);
            if let Some(first) = state.holds.first_mut() {
                first.follows = false;
            }
            changed = true;
        }
        changed
    }

    /// The tip goes on through the cells, or from outside to the boundary.
    fn advance(&mut self, needle: usize) -> Result<bool, Status> {
        let curve = self.needles.parts[needle]
            .needle
            .at(&self.states[needle].pose);
        match self.states[needle].tip {
            Tip::Holding { .. } => Ok(false),
            _ if self.work.let_go[needle] => Ok(false),
            Tip::Inside { .. } => self.advance_inside(needle, &curve),
            Tip::Outside => Ok(self.advance_outside(needle, &curve)),
        }
    }

    fn advance_inside(&mut self, needle: usize, curve: &Curve) -> Result<bool, Status> {
        let geometry = Geometry {
            mesh: &self.needles.mesh,
            hierarchy: &self.needles.hierarchy,
            slack: Slack::Everywhere(0.0),
            at: |node| position(self.body, self.points_m, self.grasp, self.work, node),
        };
        let history = &mut self.states[needle].history;
        let walked = walk(&geometry, curve, history, curve.length);
        let stop = walked.stop;
        let state = &mut self.states[needle];
        state.tally.guessed += walked.guessed;
        state.hold_new(self.needles.apart_m);
        if state.holds.is_empty() && matches!(stop, Stop::Reached | Stop::Lost) {
            return Ok(self.find_again(needle, curve));
        }
        match stop {
            Stop::Reached => Ok(false),
            Stop::Full => Err(Status::TooManyRows),
            Stop::Lost => {
                state.tally.lost += 1;
                Ok(false)
            }
            Stop::Boundary(face) => {
                self.take(needle, face);
                Ok(true)
            }
        }
    }

    /// A needle that goes through no face, as it is shorter than a cell: its tip is where a straight way
    /// from the middle of the cell that it was in leads. Whether it is out.
    fn find_again(&mut self, needle: usize, curve: &Curve) -> bool {
        let mesh = &self.needles.mesh;
        let before = self.states[needle].history.tip_cell(mesh);
        let nodes = before.and_then(|cell| mesh.cells().get(cell as usize));
        let Some(nodes) = nodes.copied() else {
            return false;
        };
        let corners = nodes.map(|node| self.position(node));
        let middle = corners.iter().sum::<Vector3<f64>>() / 4.0;
        let Some(path) = Curve::segment(&middle, &curve.at(curve.length)) else {
            return false;
        };
        let mut walked = std::mem::take(&mut self.work.path);
        walked.restart(before, None);
        let geometry = Geometry {
            mesh,
            hierarchy: &self.needles.hierarchy,
            slack: Slack::Everywhere(0.0),
            at: |node| position(self.body, self.points_m, self.grasp, self.work, node),
        };
        let stop = walk(&geometry, &path, &mut walked, path.length).stop;
        let now = walked.tip_cell(mesh);
        self.work.path = walked;
        match stop {
            Stop::Reached => {
                self.states[needle].history.restart(now, None);
                false
            }
            Stop::Boundary(_) => {
                self.release(needle, What::Cut);
                let state = &mut self.states[needle];
                state.history.clear();
                state.tip = Tip::Outside;
                true
            }
            Stop::Full | Stop::Lost => {
                self.states[needle].tally.lost += 1;
                false
            }
        }
    }

    fn advance_outside(&mut self, needle: usize, curve: &Curve) -> bool {
        let tip = curve.at(curve.length);
        let back = BACK * curve.length;
        let left = self.states[needle].left.take();
        let hit = left
            .and_then(|face| self.above(&face, &tip, back))
            .and_then(|from| self.covers(&from, &tip))
            .or_else(|| {
                let from = self.work.tips[needle] - curve.tangent_at(curve.length) * back;
                self.first_face(&Curve::segment(&from, &tip)?)
            });
        let Some(hit) = hit else {
            return false;
        };
        self.take(needle, hit);
        true
    }

    /// A tip that let go of a face without having left the tissue, as it was dragged along it, comes in from
    /// straight above.
    fn above(&self, face: &Crossing, tip: &Vector3<f64>, by: f64) -> Option<Vector3<f64>> {
        let [a, b, c] = self
            .needles
            .mesh
            .vertices(face.face)
            .map(|node| self.position(node));
        let out = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let depth = out.dot(&(a - tip));
        (depth > 0.0).then(|| tip + out * (depth + by))
    }

    /// The boundary face that a point in the tissue is under, seen from a point outside; `None` if there is no
    /// tissue at it.
    fn covers(&mut self, from: &Vector3<f64>, at: &Vector3<f64>) -> Option<Crossing> {
        let path = Curve::segment(from, at)?;
        let face = self.first_face(&path)?;
        let mut walked = std::mem::take(&mut self.work.path);
        walked.restart(None, Some(face));
        let geometry = Geometry {
            mesh: &self.needles.mesh,
            hierarchy: &self.needles.hierarchy,
            slack: Slack::Everywhere(0.0),
            at: |node| position(self.body, self.points_m, self.grasp, self.work, node),
        };
        let stop = walk(&geometry, &path, &mut walked, path.length).stop;
        self.work.path = walked;
        (stop == Stop::Reached).then_some(face)
    }

    /// The first boundary face that a path from outside goes in through.
    pub(super) fn first_face(&self, path: &Curve) -> Option<Crossing> {
        let NeedleWork { system, pushes, .. } = &*self.work;
        let groups = self.needles.hierarchy.groups();
        let mut slack = [0.0; MOST_GROUPS];
        let resting = &self.needles.resting;
        system.slack(self.body, self.grasp, pushes, resting, &mut slack[..groups]);
        let geometry = Geometry {
            mesh: &self.needles.mesh,
            hierarchy: &self.needles.hierarchy,
            slack: Slack::ByGroup(&slack[..groups]),
            at: |node| position(self.body, self.points_m, self.grasp, self.work, node),
        };
        entry(&geometry, path, &self.work.no_history, 0.0, path.length).crossing
    }

    /// The tip comes to hold a boundary face; a free one goes on through it.
    fn take(&mut self, needle: usize, face: Crossing) {
        self.release(needle, What::Cut);
        let state = &mut self.states[needle];
        state.tip_force = Vector3::zeros();
        self.work.took[needle] = true;
        let id = state.new_id();
        state.tip = Tip::Holding { face, id };
        let pose = state.pose;
        state.begin_log(pose);
    }

    /// The tip breaks through the face that it holds: the tissue snaps back, and the way since the first
    /// contact is gone once more (3.2.3).
    fn puncture(&mut self, needle: usize, face: Crossing, free: bool) -> Result<(), Status> {
        self.release(needle, What::Holding);
        let length = self.needles.parts[needle].needle.shape.length_m();
        let state = &mut self.states[needle];
        state.tally.punctures += 1;
        state.tip = if face.enters {
            Tip::Inside { cut: None }
        } else {
            Tip::Outside
        };
        // Without the tip's force; the face itself is not yet held either.
        let mut solves = 0;
        self.slide(&mut solves)?;
        self.unfold();
        self.settle_releases();
        // Tissue has slid far, and what rubs changes now: that slide is over.
        self.book();
        self.stick();
        let pose = self.states[needle].pose;
        let curve = self.needles.parts[needle].needle.at(&pose);
        let point = self.position_of(&anchor(&self.needles.mesh, &face));
        let last = self.states[needle].history.crossings().last();
        let least = last.map_or(f64::NEG_INFINITY, |crossing| crossing.alpha);
        let alpha = curve
            .project(&point, length)
            .clamp(least.min(length), length);
        self.take_hold(needle, Crossing { alpha, ..face })?;
        // What lies close behind is met from here.
        self.work.tips[needle] = point;
        if self.needles.settings.playback == Playback::EveryPose && !free {
            self.replay(needle)?;
        } else {
            self.play_back(needle, &face, &point, &curve)?;
        }
        self.states[needle].log.clear();
        Ok(())
    }

    /// The way since the tip touched, a balance at each of its poses.
    fn replay(&mut self, needle: usize) -> Result<(), Status> {
        let mut poses = [Isometry3::identity(); MAX_NEEDLES];
        for (pose, state) in poses.iter_mut().zip(self.states.iter()) {
            *pose = state.pose;
        }
        let count = self.states.len();
        // What is met on the way begins a log of its own.
        let log = &self.states[needle].log;
        let logged = log.len();
        let played = PLAYED.min(logged.max(1));
        let mut way = [poses[needle]; PLAYED];
        for (index, pose) in (1..played).zip(&mut way) {
            *pose = *log.get(index * logged / played).unwrap_or(pose);
        }
        for pose in &way[..played] {
            poses[needle] = *pose;
            // Nobody's hand does this work.
            let from = self.states[needle].pose;
            let centre = from.translation.vector;
            let before = self.wrench_on(needle, &centre);
            self.balance(&poses[..count], Some(needle))?;
            let curve = self.needles.parts[needle].needle.at(&poses[needle]);
            self.work.tips[needle] = curve.at(curve.length);
            let way = poses[needle].translation.vector - centre;
            let turn = (poses[needle].rotation * from.rotation.inverse()).scaled_axis();
            let after = self.wrench_on(needle, &poses[needle].translation.vector);
            let twist = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
            self.states[needle].tally.release_j += 0.5 * (before + after).dot(&twist);
        }
        Ok(())
    }

    /// The tip's way since it touched, through the tissue as it is now.
    fn play_back(
        &mut self,
        needle: usize,
        face: &Crossing,
        from: &Vector3<f64>,
        curve: &Curve,
    ) -> Result<(), Status> {
        let part = &self.needles.parts[needle].needle;
        let mut first = Some(*face);
        let length = curve.length;
        let logged = self.states[needle].log.len();
        let mut here = *from;
        let tip = curve.at(length);
        let forward = curve.tangent_at(length);
        for index in 1..=PLAYED.min(logged.max(1)) {
            let played = PLAYED.min(logged.max(1));
            let next = if index == played {
                tip
            } else {
                let pose = &self.states[needle].log[(index * logged / played).min(logged - 1)];
                let then = part.at(pose);
                then.at(length)
            };
            // The tip cuts where it comes for the first time.
            if (next - here).dot(&forward) <= 0.0 && index < played {
                continue;
            }
            let Some(path) = Curve::segment(&here, &next) else {
                continue;
            };
            let inside = self.states[needle].history.tip_cell(&self.needles.mesh);
            if inside.is_none() {
                // Out on the other side: what lies beyond is met like anything else.
                break;
            }
            let mut walked = std::mem::take(&mut self.work.path);
            match first.take() {
                Some(face) => walked.restart(face.from(), Some(Crossing { alpha: 0.0, ..face })),
                None => walked.restart(inside, None),
            }
            let known = walked.crossings().len();
            let geometry = Geometry {
                mesh: &self.needles.mesh,
                hierarchy: &self.needles.hierarchy,
                slack: Slack::Everywhere(0.0),
                at: |node| position(self.body, self.points_m, self.grasp, self.work, node),
            };
            let stop = walk(&geometry, &path, &mut walked, path.length).stop;
            self.work.path = walked;
            let out = match stop {
                Stop::Boundary(face) => Some(face),
                Stop::Full => return Err(Status::TooManyRows),
                Stop::Lost => {
                    self.states[needle].tally.lost += 1;
                    None
                }
                Stop::Reached => None,
            };
            let found = self.work.path.crossings().len();
            for index in known..found + usize::from(out.is_some()) {
                let crossing = match out {
                    Some(out) if index == found => out,
                    _ => self.work.path.crossings()[index],
                };
                let point = self.position_of(&anchor(&self.needles.mesh, &crossing));
                let last = self.states[needle].history.crossings().last();
                let least = last.map_or(0.0, |last| last.alpha);
                let alpha = curve
                    .project(&point, length)
                    .clamp(least.min(length), length);
                self.take_hold(needle, Crossing { alpha, ..crossing })?;
            }
            if let Some(out) = out {
                let state = &mut self.states[needle];
                state.tip = Tip::Outside;
                state.tally.punctures += 1;
                self.work.tips[needle] = self.position_of(&anchor(&self.needles.mesh, &out));
                break;
            }
            here = next;
        }
        Ok(())
    }

    /// Needles that nobody holds move as far as their wrench takes them against [`DRAG`]: whether all
    /// are at rest.
    fn settle_loose(&mut self) -> bool {
        let mut settled = true;
        for needle in 0..self.states.len() {
            if self.states[needle].grip.is_some() {
                continue;
            }
            // The compliance has it in it by now.
            let Some((centre, drag)) = self.work.drags[needle] else {
                continue;
            };
            let part = &self.needles.parts[needle].needle;
            let length = part.shape.length_m();
            // Where the solve has it: with the arms that the compliance has.
            let mut wrench = Vector6::zeros();
            for (index, point) in self.work.points.iter().enumerate() {
                if point.needle == needle {
                    let force = -self.grasp.force_on(index);
                    let moment = (self.work.arms[index] - centre).cross(&force);
                    wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
                }
            }
            let step = wrench.component_div(&drag);
            let shift: Vector3<f64> = step.fixed_rows::<3>(0).into();
            let turn: Vector3<f64> = step.fixed_rows::<3>(3).into();
            let size = shift.norm() / self.needles.piece_m + turn.norm() / MOST_LOOSE_TURN;
            let part = size.max(1.0).recip();
            let (shift, turn) = (shift * part, turn * part);
            let state = &mut self.states[needle];
            state.pose = about(&centre, &shift, &turn) * state.pose;
            // Products of rotations drift.
            state.pose.rotation.renormalize();
            settled &= shift.norm() + turn.norm() * length <= 1e-9 * length;
        }
        settled
    }

    /// Where a loose needle turns about, and its drag \[N/m, N m/rad\]; `None` if no row holds it.
    fn drag(&self, needle: usize) -> Option<(Vector3<f64>, Vector6<f64>)> {
        let n = self.work.rows.len();
        let w = self.work.system.compliance(n);
        let curve = self.needles.parts[needle]
            .needle
            .at(&self.states[needle].pose);
        let (mut sum, mut count, mut centre) = (0.0, 0, Vector3::zeros());
        for point in self.work.points.iter().filter(|at| at.needle == needle) {
            sum += (0..3)
                .map(|axis| w[(point.first_row + axis) * (n + 1)])
                .sum::<f64>()
                / 3.0;
            centre += curve.at(point.alpha);
            count += 1;
        }
        if count == 0 || sum <= 0.0 {
            return None;
        }
        let push = DRAG * f64::from(count) * f64::from(count) / sum;
        let turn = push * curve.length * curve.length / 12.0;
        let drag = Vector6::new(push, push, push, turn, turn, turn);
        Some((centre / f64::from(count), drag))
    }

    /// Lets loose needles give way in the compliance.
    fn loosen(&mut self) {
        let mut arms = std::mem::take(&mut self.work.arms);
        arms.clear();
        arms.extend(
            self.work
                .points
                .iter()
                .zip(&self.work.anchors)
                .map(|(point, at)| {
                    if point.what == What::Cut {
                        // It holds along the needle only, and may lie beside it.
                        return self.position_of(at);
                    }
                    let pose = &self.states[point.needle].pose;
                    self.needles.parts[point.needle]
                        .needle
                        .at(pose)
                        .at(point.alpha)
                }),
        );
        self.work.arms = arms;
        for needle in 0..self.states.len() {
            if self.states[needle].grip.is_some() {
                continue;
            }
            self.work.drags[needle] = self.drag(needle);
            let Some((centre, drag)) = self.work.drags[needle] else {
                continue;
            };
            let n = self.work.rows.len();
            let NeedleWork {
                system,
                points,
                rows,
                arms,
                ..
            } = &mut *self.work;
            let jacobian = |row: usize| {
                let along = Vector3::from(rows[row].direction);
                let turn = (arms[row / 3] - centre).cross(&along);
                Vector6::new(along.x, along.y, along.z, turn.x, turn.y, turn.z)
            };
            let w = system.compliance_mut(n);
            for j in (0..n).filter(|row| points[row / 3].needle == needle) {
                let given = jacobian(j).component_div(&drag);
                for i in (0..n).filter(|row| points[row / 3].needle == needle) {
                    w[n * j + i] += jacobian(i).dot(&given);
                }
            }
        }
    }

    /// Wrench on a needle: force, then moment about `centre`.
    pub(super) fn wrench_on(&self, needle: usize, centre: &Vector3<f64>) -> Vector6<f64> {
        let mut wrench = Vector6::zeros();
        for (index, point) in self.work.points.iter().enumerate() {
            if point.needle != needle {
                continue;
            }
            let force = -self.grasp.force_on(index);
            let arm = self.position_of(&self.work.anchors[index]) - centre;
            let moment = arm.cross(&force);
            wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        }
        wrench
    }

    /// Takes over what the balance found.
    fn finish(&mut self) {
        self.book();
        for needle in 0..self.states.len() {
            if matches!(self.states[needle].tip, Tip::Holding { .. }) {
                self.states[needle].log_pose();
            }
            self.cut(needle);
        }
    }

    /// Books slides and cuts under the mean of the forces before and after, as [`Self::settle_releases`] says.
    fn book(&mut self) {
        let lambda = self.grasp.lambda();
        let (delta, modes) = (self.grasp.delta_m(), self.grasp.modes());
        for (index_of_point, point) in self.work.points.iter().enumerate() {
            let slid = match point.what {
                What::Crossing(index) => self.slid(point.needle, index),
                _ => Vector3::zeros(),
            };
            let state = &mut self.states[point.needle];
            let (force, slide) = (lambda[point.first_row], delta[point.first_row]);
            if state.grip.is_none() {
                // Where nobody holds the needle nobody gets the work that its way is worth.
                let needle = &self.needles.parts[point.needle].needle;
                let [from, to] = [&state.booked, &state.pose].map(|pose| needle.at(pose));
                let (alpha, before) = match point.what {
                    What::Crossing(index) => match state.holds.get(index) {
                        Some(hold) => (hold.alpha, hold.force),
                        None => continue,
                    },
                    What::Cut | What::Holding => (to.length, state.tip_force),
                };
                let mean = 0.5 * (before + self.grasp.force_on(index_of_point));
                state.tally.release_j -= mean.dot(&(to.at(alpha) - from.at(alpha)));
            }
            if !matches!(point.what, What::Crossing(_)) {
                state.tip_force = self.grasp.force_on(index_of_point);
            }
            let bound = modes[point.first_row] != Mode::Held;
            match point.what {
                What::Crossing(index) => {
                    let Some(hold) = state.holds.get_mut(index) else {
                        continue;
                    };
                    let force = self.grasp.force_on(index_of_point);
                    state.tally.friction_j -= 0.5 * (hold.force + force).dot(&slid);
                    hold.slides = bound && hold.limit_n > 0.0;
                    hold.force = force;
                }
                What::Cut => {
                    let Tip::Inside { cut: Some(cut) } = &mut state.tip else {
                        continue;
                    };
                    let cuts = cut.pressed && bound && slide > 0.0;
                    if cuts {
                        state.tally.cutting_j -= 0.5 * (cut.axial_n + force) * slide;
                    }
                    cut.cuts = cuts;
                    cut.axial_n = force;
                }
                What::Holding => {}
            }
        }
        for (needle, state) in self.states.iter_mut().enumerate() {
            state.booked = state.pose;
            let at_tip =
                |point: &Point| point.needle == needle && !matches!(point.what, What::Crossing(_));
            if !self.work.points.iter().any(at_tip) {
                state.tip_force = Vector3::zeros();
            }
        }
    }

    /// Brings the end of the cut to where the tip is now, if it went further.
    fn cut(&mut self, needle: usize) {
        let Tip::Inside { cut } = self.states[needle].tip else {
            return;
        };
        let Some(cell) = self.states[needle].history.tip_cell(&self.needles.mesh) else {
            return;
        };
        let part = &self.needles.parts[needle].needle;
        let limit_n = self.needles.tissue(cell).cutting_pa * part.tip_area_m2();
        if limit_n == 0.0 {
            self.states[needle].tip = Tip::Inside { cut: None };
            return;
        }
        if cut.is_some_and(|cut| cut.cell == cell && !cut.cuts) {
            return;
        }
        let curve = part.at(&self.states[needle].pose);
        let Some(nodes) = self.needles.mesh.cells().get(cell as usize).copied() else {
            return;
        };
        let corners = nodes.map(|node| self.position(node));
        let weights = barycentric(&corners, &curve.at(curve.length));
        self.states[needle].tip = Tip::Inside {
            cut: Some(Cut {
                at: AnchorPoint { nodes, weights },
                cell,
                limit_n,
                pressed: true,
                axial_n: cut.map_or(0.0, |cut| cut.axial_n),
                cuts: cut.is_some_and(|cut| cut.cuts),
            }),
        };
    }
}

/// Where an unloaded node is.
fn place(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    points_m
        .get(node as usize)
        .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
}

/// Where a node is under the forces of the last solve.
fn position(
    body: &Body,
    points_m: &[[f64; 3]],
    grasp: &Grasp,
    work: &NeedleWork,
    node: u32,
) -> Vector3<f64> {
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
pub(super) fn anchor(mesh: &HalfFaces, crossing: &Crossing) -> AnchorPoint {
    let [a, b, c] = mesh.vertices(crossing.face);
    let [x, y, z] = crossing.weights;
    AnchorPoint {
        nodes: [a, b, c, a],
        weights: [x, y, z, 0.0],
    }
}

/// Weights of a point in a cell, none below zero, with sum 1; all alike in a flat cell.
fn barycentric(corners: &[Vector3<f64>; 4], at: &Vector3<f64>) -> [f64; 4] {
    let [a, b, c, d] = corners;
    let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
    let Some(inverse) = edges.try_inverse() else {
        return [0.25; 4];
    };
    let inner = inverse * (at - a);
    let weights = [1.0 - inner.sum(), inner.x, inner.y, inner.z].map(|w| w.clamp(0.0, 1.0));
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 && sum.is_finite() {
        weights.map(|weight| weight / sum)
    } else {
        [0.25; 4]
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
fn limits(needles: &Needles, state: &mut NeedleState, length: f64) {
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
