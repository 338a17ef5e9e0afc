//! Needles as a source of constraints: rows at their crossings and tips, and how these slide.
//!
//! Entry point: [`NeedleSource`]. Every crossing is a point with two transverse rows (younes-2021, 3.29) and an axial one
//! that is bounded by friction. A row that reaches its bound slides: with w the tangent, `delta = w.(s(alpha) - x)` is by
//! how far the needle runs ahead of the tissue, so that the tissue point is at `alpha - delta` afterwards. Directions turn
//! with alpha on an arc: the axial target is `w.s(alpha_k) + alpha_0 - alpha_k`, whose delta is the whole slide since
//! alpha_0.

use super::model::MAX_NEEDLES;
use super::relax::Relaxation;
use super::state::{NeedleState, Tip};
use super::surface::{Lie, cone};
use super::yielding::{Push, Yielding};
use super::{Crossing, History, NeedleTissue};
use crate::anchors::{AnchorPoint, ConstraintSet, PointConstraint};
use crate::mesh::HalfFaces;
use crate::rod::{MOST_PLACES, MOST_TOUCHES};
use crate::rows::RowKind;
use crate::source::tool::WALL_M_PER_N;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Sources, Status, unloaded};
use crate::tool::ToolSample;
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};

/// A slide is known well enough when it changes by less than this part of the needle \[1\].
const SLIDE_TOLERANCE: f64 = 3e-8;
/// As much of the force across a bent needle may come in along it by what its tangent turns over the rest of a slide \[N\]: a thousandth of
/// what is felt.
const TURNED_N: f64 = 3e-7;
/// Compliance of friction on fixed nodes \[m/N\]: far below any tissue's, so that it slides at once.
const RIGID_M_PER_N: f64 = 1e-6;
/// Least compliance of a row beside fixed nodes \[m/N\]: a hundredth of what an edge of soft tissue has.
pub(crate) const STIFFEST_M_PER_N: f64 = 3e-5;

/// Needles, held by tools or not.
pub(crate) struct NeedleSource;

/// What a row's point is on its needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum What {
    Crossing(usize),
    Holding,
    Cut,
    Touch(usize),
}

/// A point of the present rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub needle: usize,
    pub what: What,
    /// Of its three rows: along the needle, towards the inside of its curve, across both; of what lies on the surface out of
    /// the tissue, and two across.
    pub first_row: usize,
    /// On the needle \[m\].
    pub alpha: f64,
}

/// A force that has been taken away, or tissue that has been taken hold of where the needle is not: until
/// the next solve says how far it moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Release {
    pub needle: usize,
    pub at: AnchorPoint,
    pub force: Vector3<f64>,
    pub from: Vector3<f64>,
    /// The crossing that took hold.
    pub taken: Option<usize>,
}

/// Scratch of all needles.
pub(crate) struct NeedleWork {
    /// Of the present rows, which come first in the set, three for each.
    pub points: Vec<Point>,
    pub releases: Vec<Release>,
    pub(super) path: History,
    pub(super) no_history: History,
    /// Where each needle's tip was at the last balance, or where it came out since.
    pub(super) tips: Vec<Vector3<f64>>,
    /// Where each needle's end was at the last balance.
    pub(super) ends: Vec<Vector3<f64>>,
    /// Whether its end has given crossings away in this balance.
    pub(super) gave: Vec<bool>,
    /// Let go of a face, or was withdrawn from one, in this balance: the tissue that gives way is not to be
    /// gone into at once.
    pub(super) let_go: Vec<bool>,
    /// Took the face that it holds in this balance.
    pub(super) took: Vec<bool>,
    /// Pressing against the end of the cut was tried in this balance.
    pub(super) pressed: Vec<bool>,
    /// Where each point is acted on.
    pub(super) arms: Vec<Vector3<f64>>,
    /// Nodes whose columns will be needed soon.
    pub ahead: Vec<u32>,
    /// Of each needle that bends.
    relaxations: Vec<Relaxation>,
    /// Where each free needle turns about in the last solve, and its drag.
    pub(super) drags: Vec<Option<(Vector3<f64>, Vector6<f64>)>>,
    /// Of each needle that falls, or is pushed.
    pub(super) yielding: Vec<Option<Yielding>>,
    /// Where bodies press on them, or may, in this solve.
    pub pushes: Vec<Push>,
    /// How those on which bodies may press give way but for these, and about which point \[m\], (6 x 6).
    pub responses: Vec<Option<(Vector3<f64>, Matrix6<f64>)>>,
    /// For as long they fall in this step \[s\].
    pub fall_s: f64,
}

impl NeedleWork {
    /// For so many needles.
    pub fn new(count: usize, sources: &Sources) -> Self {
        let most_crossings = sources.settings.most_crossings;
        let points = most_points(sources);
        Self {
            points: Vec::with_capacity(points),
            releases: Vec::with_capacity(points),
            path: History::new(if count == 0 { 0 } else { most_crossings }),
            no_history: History::new(0),
            tips: vec![Vector3::zeros(); count],
            ends: vec![Vector3::zeros(); count],
            gave: vec![false; count],
            let_go: vec![false; count],
            took: vec![false; count],
            pressed: vec![false; count],
            arms: Vec::with_capacity(points),
            // A cell and its neighbours around each tip, and one that lies ahead.
            ahead: Vec::with_capacity(24 * count),
            relaxations: (0..count)
                .map(|_| Relaxation::new(most_crossings))
                .collect(),
            drags: vec![None; count],
            yielding: vec![None; count],
            pushes: Vec::with_capacity(MOST_PLACES * sources.pairs.len()),
            responses: vec![None; count],
            fall_s: 0.0,
        }
    }
}

impl Source for NeedleSource {
    /// At each crossing three rows, at each tip, and where bodies touch.
    fn room(&self, sources: &Sources) -> Room {
        let points = most_points(sources);
        Room::new(points, 3 * points)
    }

    fn prepare(&self, balance: &mut Balance) {
        let sources = balance.sources;
        for (state, part) in balance.state.each.iter_mut().zip(&sources.needles) {
            limits(sources, state, part.needle.shape.length_m());
        }
        let relaxations = &mut balance.work.needles.relaxations;
        relaxations.iter_mut().for_each(Relaxation::begin);
        balance.begin_to_yield();
    }

    /// Rows of every needle at its pose and present slides.
    fn append(&self, balance: &mut Balance) {
        balance.let_yield();
        let BalanceWork { set, needles, .. } = &mut *balance.work;
        needles.points.clear();
        let mesh = &balance.sources.mesh;
        for (index, state) in balance.state.each.iter().enumerate() {
            let curve = balance.sources.needles[index].needle.at(&state.pose);
            let mut add =
                |what, at: AnchorPoint, alpha: f64, slid: f64, id: u32, lie: Option<Lie>, kinds| {
                    let parts = at.nodes.iter().zip(at.weights);
                    let rest: Vector3<f64> = parts
                        .map(|(node, weight)| unloaded(balance.points_m, *node) * weight)
                        .sum();
                    needles.points.push(Point {
                        needle: index,
                        what,
                        first_row: set.rows.len(),
                        alpha,
                    });
                    let id = (index as u64) << 34 | u64::from(id) << 2;
                    let (frame, to) = match lie {
                        Some(lie) => (lie.frame(), curve.at(alpha) + lie.slid_m),
                        None => (curve.frame_at(alpha), curve.at(alpha)),
                    };
                    add_rows(set, at, id, frame, (to - rest, slid), kinds);
                };
            let equal = RowKind::Equality;
            let crossings = state.history.crossings().iter().zip(&state.holds);
            for (place, (crossing, hold)) in crossings.enumerate() {
                if hold.follows {
                    continue;
                }
                let limit_n = hold.limit_n;
                add(
                    What::Crossing(place),
                    anchor(mesh, crossing),
                    crossing.alpha,
                    hold.alpha - crossing.alpha,
                    hold.id,
                    None,
                    [RowKind::Box { limit_n }, equal, equal],
                );
            }
            match state.tip {
                Tip::Holding { face, id, rubs } => {
                    let at = anchor(mesh, &face);
                    let friction = balance.sources.tissue(face.face.cell()).surface_friction;
                    let kinds = rubs.map_or([equal; 3], |_| cone(friction));
                    add(What::Holding, at, curve.length, 0.0, id, rubs, kinds);
                }
                Tip::Inside { cut: Some(cut) } => {
                    let limit_n = if cut.pressed { cut.limit_n } else { 0.0 };
                    let none = RowKind::Box { limit_n: 0.0 };
                    let kinds = [RowKind::Box { limit_n }, none, none];
                    add(What::Cut, cut.at, curve.length, 0.0, 0, None, kinds);
                }
                _ => {}
            }
            for (place, touch) in state.touches.iter().enumerate() {
                let (slid, lie) = (-touch.apart_m, Some(touch.lie));
                let kinds = cone(touch.friction);
                add(
                    What::Touch(place),
                    touch.at,
                    touch.alpha,
                    slid,
                    touch.id,
                    lie,
                    kinds,
                );
            }
        }
    }

    /// Friction on what cannot move needs something that gives way, or it would be none; so does a face of fixed nodes that holds
    /// a tip, or nothing would say how hard that presses.
    fn soften(&self, balance: &mut Balance, _solve: u32) {
        let n = balance.work.count();
        let w = balance.work.system.compliance_mut(n);
        for point in &balance.work.needles.points {
            for row in point.first_row..point.first_row + 3 {
                let own = &mut w[row * (n + 1)];
                // Next to what does not move a way of nothing would be a force of everything.
                if *own == 0.0 && matches!(point.what, What::Touch(_)) {
                    *own = WALL_M_PER_N;
                } else if *own > 0.0 || point.what == What::Holding {
                    *own = own.max(STIFFEST_M_PER_N);
                } else if row == point.first_row {
                    *own = RIGID_M_PER_N;
                }
            }
        }
    }

    /// Slides as the solve says.
    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        let mut settled = balance.give_way();
        settled &= balance.slide_crossings();
        let grasp = &balance.state.grasp;
        let (delta, lambda) = (grasp.delta_m(), grasp.lambda());
        let needles = &mut balance.work.needles;
        for point in &needles.points {
            let state = &mut balance.state.each[point.needle];
            let (What::Cut, Tip::Inside { cut: Some(cut) }) = (point.what, &mut state.tip) else {
                continue;
            };
            // The end of the cut can be pushed, not pulled.
            let pulls = cut.pressed && lambda[point.first_row] > 0.0;
            let goes_in = !cut.pressed && delta[point.first_row] > 0.0;
            let tried = &mut needles.pressed[point.needle];
            if pulls || (goes_in && !*tried) {
                cut.pressed = goes_in;
                *tried |= goes_in;
                settled = false;
            }
        }
        balance.lead_followers();
        settled &= balance.let_slip();
        Ok(settled & balance.touch_bodies(solve)?)
    }

    fn advance(&self, balance: &mut Balance, played: Option<usize>) -> Result<bool, Status> {
        balance.unfold();
        balance.settle_releases();
        balance.follow_tips(played)
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        balance.feel_needles(felt);
    }

    fn report(&self, balance: &mut Balance, samples: &[ToolSample]) {
        balance.report_needles(samples);
    }

    fn accept(&self, balance: &mut Balance) {
        balance.end_to_yield();
        balance.book();
        balance.follow_surface();
        balance.follow_bodies();
        for needle in 0..balance.state.each.len() {
            if matches!(balance.state.each[needle].tip, Tip::Holding { .. }) {
                balance.state.each[needle].log_pose();
            }
            balance.cut(needle);
        }
    }
}

/// Points of all needles at most.
fn most_points(sources: &Sources) -> usize {
    let each = sources.needles.iter().map(|part| {
        let touches = if part.body { MOST_TOUCHES } else { 0 };
        sources.settings.most_crossings + 1 + touches
    });
    each.sum()
}

/// A point with three rows in the directions of `frame`, which bring it `to` its place from where it is unloaded \[m\], but
/// for what it has `slid` along the first \[m\].
fn add_rows(
    set: &mut ConstraintSet,
    at: AnchorPoint,
    id: u64,
    frame: [Vector3<f64>; 3],
    (to, slid): (Vector3<f64>, f64),
    kinds: [RowKind; 3],
) {
    let anchor = set.add(at);
    for (axis, (direction, kind)) in (0u64..).zip(frame.into_iter().zip(kinds)) {
        let slid = if axis == 0 { slid } else { 0.0 };
        set.rows.push(PointConstraint {
            id: id | axis,
            anchor,
            kind,
            direction: direction.into(),
            target_m: direction.dot(&to) + slid,
        });
    }
}

impl NeedleState {
    /// Which crossing a point is, and where on the needle it has slid to in a solve \[m\].
    fn slid_to(&self, point: &Point, delta_m: &[f64]) -> Option<(usize, f64)> {
        match point.what {
            What::Crossing(place) => {
                Some((place, self.holds[place].alpha - delta_m[point.first_row]))
            }
            _ => None,
        }
    }
}

impl Balance<'_> {
    /// Puts the needles where they shall be; while the way of one is played back nothing begins for the others.
    pub(crate) fn begin_needles(&mut self, poses: &[Isometry3<f64>], played: Option<usize>) {
        let mut poses_before = [Isometry3::identity(); MAX_NEEDLES];
        for (before, state) in poses_before.iter_mut().zip(self.state.each.iter()) {
            *before = state.pose;
        }
        let work = &mut self.work.needles;
        for (index, (state, pose)) in self.state.each.iter_mut().zip(poses).enumerate() {
            if played.is_some_and(|played| played != index) {
                continue;
            }
            if played.is_none() {
                let curve = self.sources.needles[index].needle.at(&state.pose);
                work.tips[index] = curve.at(curve.length);
                work.ends[index] = curve.start;
            }
            work.gave[index] = false;
            work.let_go[index] = false;
            work.took[index] = false;
            work.pressed[index] = false;
            state.pose = *pose;
            if let Tip::Inside { cut: Some(cut) } = &mut state.tip {
                cut.pressed = true;
            }
        }
        for (index, pose) in poses.iter().enumerate().take(self.state.each.len()) {
            if played.is_none_or(|played| played == index) {
                let yielding = played.is_none().then(|| self.yielding(index, pose));
                self.work.needles.yielding[index] = yielding.flatten();
            }
        }
        self.stick();
        self.predict(poses_before);
    }

    /// Crossings slide as the last solve says; whether they were there already, or slide along a line.
    fn slide_crossings(&mut self) -> bool {
        let mut settled = true;
        let delta_m = self.state.grasp.delta_m();
        let needles = &mut self.work.needles;
        for (index, state) in self.state.each.iter_mut().enumerate() {
            let shape = &self.sources.needles[index].needle.shape;
            let relaxation = &mut needles.relaxations[index];
            let all = || needles.points.iter().enumerate();
            let points = || all().filter(|(_, point)| point.needle == index);
            let curve = self.sources.needles[index].needle.at(&state.pose);
            let mut at_rest = true;
            for (place, point) in points() {
                if let Some((_, alpha)) = state.slid_to(point, delta_m) {
                    let change_m = alpha - point.alpha;
                    let turns = (curve.curvature_at(alpha) * change_m).abs();
                    at_rest &= change_m.abs() <= SLIDE_TOLERANCE * shape.length_m();
                    at_rest &= turns * self.state.grasp.force_on(place).norm() <= TURNED_N;
                    relaxation.take(change_m);
                }
            }
            at_rest |= !shape.bends();
            let part = relaxation.part();
            let part = if at_rest { 1.0 } else { part };
            for (_, point) in points() {
                if let Some((place, alpha)) = state.slid_to(point, delta_m) {
                    let alpha = point.alpha + part * (alpha - point.alpha);
                    state.history.set_alpha(place, alpha);
                }
            }
            settled &= at_rest;
        }
        settled
    }

    /// What slid will slide on, by about the uniform slide (3.9, 3.17); a line needs no guess.
    pub(super) fn predict(&mut self, before: [Isometry3<f64>; MAX_NEEDLES]) {
        let parts = self.sources.needles.iter().zip(&before);
        for (state, (part, before)) in self.state.each.iter_mut().zip(parts) {
            let (from, to) = (part.needle.at(before), part.needle.at(&state.pose));
            if !from.bends() {
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
        for state in self.state.each.iter_mut() {
            for (hold, crossing) in state.holds.iter_mut().zip(state.history.crossings()) {
                hold.alpha = crossing.alpha;
            }
        }
    }

    /// Tissue that has been folded by more than its own thickness would have crossings change places: what
    /// slides stops at the next one instead. What slides off the tip does not: all beyond it come off, too.
    pub(super) fn unfold(&mut self) {
        for (state, part) in self.state.each.iter_mut().zip(&self.sources.needles) {
            let length_m = part.needle.shape.length_m();
            let count = state.holds.len();
            let mut folded = false;
            let alpha = |state: &NeedleState, index: usize| state.history.crossings()[index].alpha;
            for index in (1..count).rev() {
                let (own, next) = (alpha(state, index - 1), alpha(state, index));
                let slid = own != state.holds[index - 1].alpha;
                if own > next && own <= length_m && slid {
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

    /// Crossings without rows of their own go with one beside them.
    pub(super) fn lead_followers(&mut self) {
        for state in self.state.each.iter_mut() {
            for index in 0..state.holds.len() {
                if !state.holds[index].follows {
                    continue;
                }
                let leader = state.leader_of(index);
                let slide = leader.and_then(|leader| {
                    let crossing = state.history.crossings().get(leader)?;
                    Some(crossing.alpha - state.holds[leader].alpha)
                });
                let alpha = state.holds[index].alpha + slide.unwrap_or(0.0);
                state.history.set_alpha(index, alpha);
            }
        }
    }

    /// How far a crossing is from the last face that a thread goes through \[m\]; 0 if there is none.
    pub(crate) fn apart(&self, thread: usize, crossing: &Crossing) -> f64 {
        let thread = self.state.threads.get(thread);
        let last = thread.and_then(|thread| thread.passed.last());
        last.map_or(0.0, |last| {
            let [a, b] = [&last.crossing, crossing]
                .map(|crossing| self.position_of(&anchor(&self.sources.mesh, crossing)));
            a.metric_distance(&b)
        })
    }
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

/// Bounds of the axial forces: friction per length, half of the length between two crossings to each,
/// and to the one next to the tip, or to the end, all of it.
fn limits(sources: &Sources, state: &mut NeedleState, length: f64) {
    let mesh = &sources.mesh;
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
    for hold in &mut state.holds {
        hold.limit_n = 0.0;
    }
    for (index, crossing) in crossings.iter().enumerate().take(count) {
        let mut own = state.holds[index];
        let mut leader = index;
        if own.follows {
            leader = state.leader_of(index).unwrap_or(index);
            own.slides = state.holds[leader].slides;
        }
        let share = |cell: Option<u32>, from: f64, to: f64, part: f64| match cell {
            Some(cell) => {
                part * (to - from).max(0.0) * per_length(sources.tissue(cell), own.slides, speed)
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
        state.holds[leader].limit_n += behind + ahead;
    }
}
