//! Laps: where a thread's spans lie on the bodies that a scene names with it, bars of grips and shafts of needles.
//!
//! Entry points: [`Balance::place_laps`] before a round, [`Balance::find_laps`] after it, [`Balance::follow_laps`] once a balance
//! is found. A span that passes a body remembers on which side of it that is. Where its straight line would lead through the body
//! it lies on that, as the shortest line around the cylinder that the body is there, until that line is free of it or has slid off
//! the body's end. A needle counts as straight where the span lies on it, and that place stays while a balance is found, and
//! follows once it is.

use super::cylinder::Cylinder;
use super::model::{ThreadHold, ThreadPlace, ThreadPoint};
use super::segments::{End, Span};
use super::state::ThreadState;
use crate::rod::Rod;
use crate::step::Balance;
use nalgebra::Vector3;
use serde::Serialize;

/// Most laps of one strand, those beside included.
pub(super) const MOST_LAPS: usize = 32;
/// A span is remembered beside a body within so many mean edges: farther than a body goes in a piece of its way.
const NEAR_EDGES: f64 = 2.0;
/// In mean edges: what is cut less deeply is not cut.
const CUT_EDGES: f64 = 1e-4;
/// Least sine between a span and a body that it passes: what lies along it passes nothing.
const ACROSS: f64 = 0.05;
/// Of its radius: a needle's next place that is farther along it is another one.
const STRAYS: f64 = 0.5;

/// A body by its place among its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) enum Obstacle {
    Bar(usize),
    Needle(usize),
}

/// A thread and a body that it may lie on, by their places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Contact {
    pub thread: usize,
    pub with: Obstacle,
}

/// A span beside a body, or on it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Lap {
    /// Face that its span begins at, 0 for the tail.
    pub key: u32,
    pub with: Obstacle,
    /// Which way it leads past the body: 1 counterclockwise about its axis, -1 clockwise.
    pub side: f64,
    pub is_on: bool,
    /// By which it turns around it \[rad\].
    pub turn: f64,
    /// How many bends over tissue its span has before it.
    pub bends: u32,
    /// Where it is on the body \[m\].
    pub alpha: f64,
    /// What the body is there, with half of the thread's thickness.
    pub cylinder: Cylinder,
    /// Middle of what lies on it, along the axis from there \[m\].
    pub middle_m: f64,
}

/// How a straight line passes a body where it is nearest to it.
#[derive(Clone, Copy)]
struct Passing {
    /// Signed distance from the body's axis \[m\]: positive where the line leads counterclockwise about that.
    apart_m: f64,
    alpha: f64,
}

impl Lap {
    /// Whether it is that of a span behind so many of its `count` bends.
    pub(super) fn is_behind(&self, key: u32, bends: u32, count: u32) -> bool {
        self.is_on && self.key == key && self.bends.min(count) == bends
    }
}

impl ThreadState {
    /// Adds to the points of its path, each with the id of the face that it is or lies behind, what lies on bodies. Allocates.
    pub(super) fn draw_laps(&self, path: &mut Vec<(u32, ThreadPoint)>) {
        for lap in self.laps.iter().filter(|lap| lap.is_on) {
            let face = path.iter().position(|(id, _)| *id == lap.key);
            let Some(place) = face.map(|face| face + lap.bends as usize) else {
                continue;
            };
            let Some([(_, from), (_, to)]) = path.get(place..place + 2) else {
                continue;
            };
            let ends = [from.at_m, to.at_m].map(Vector3::from);
            let around = lap.cylinder.around(&ends[0], &ends[1], lap.side, lap.turn);
            let (along_m, tension_n) = (from.along_m, from.tension_n);
            let points = lap.cylinder.drawn(&around, lap.side).map(|at| {
                let what = ThreadPlace::Wraps;
                let at_m = at.into();
                (
                    lap.key,
                    ThreadPoint {
                        at_m,
                        along_m,
                        what,
                        tension_n,
                    },
                )
            });
            let points: Vec<_> = points.collect();
            path.splice(place + 1..place + 1, points);
        }
    }

    /// A hand takes the span behind the face `last`, and all up to that goes to `other`: both parts of the span are beside what it was
    /// on, until they are found to lie on it.
    pub(super) fn divide_laps(&mut self, other: &mut Self, last: u32) {
        other.laps.clear();
        for lap in self.laps.iter().filter(|lap| lap.key <= last) {
            let is_on = lap.is_on && lap.key < last;
            other.laps.push(Lap { is_on, ..*lap });
        }
        self.laps.retain_mut(|lap| {
            let is_own = lap.key >= last;
            if lap.key == last {
                (lap.key, lap.is_on) = (0, false);
            }
            is_own
        });
    }

    /// A hand lets go of the span behind the face `last`, the last of `other`, which comes before: that is beside what its parts were on.
    pub(super) fn join_laps(&mut self, other: &mut Self, last: u32) {
        for lap in &mut self.laps {
            if lap.key == 0 {
                (lap.key, lap.is_on) = (last, false);
            }
        }
        for mut lap in other.laps.drain(..) {
            lap.is_on &= lap.key != last;
            let same = |own: &Lap| (own.key, own.with) == (lap.key, lap.with);
            if !self.laps.iter().any(same) && self.laps.len() < MOST_LAPS {
                self.laps.push(lap);
            }
        }
    }

    /// Forgets laps on a body that is elsewhere now.
    pub(crate) fn forget_laps(&mut self, with: Obstacle) {
        self.laps.retain(|lap| lap.with != with);
    }
}

impl Balance<'_> {
    /// A body where it is; nothing for one that has not been anywhere, and for a needle that nobody holds.
    pub(crate) fn obstacle(&self, with: Obstacle) -> Option<Rod> {
        self.carrier(with).and_then(|_| self.body(with))
    }

    /// A body where it is, whoever has it there; nothing for one that has not been anywhere.
    pub(crate) fn body(&self, of: Obstacle) -> Option<Rod> {
        match of {
            Obstacle::Bar(bar) => self.bar_rod(bar),
            Obstacle::Needle(needle) => self.shaft_rod(needle),
        }
    }

    /// The tool that carries a body.
    pub(crate) fn carrier(&self, with: Obstacle) -> Option<u8> {
        match with {
            Obstacle::Bar(bar) => Some(self.sources.bars[bar].tool),
            Obstacle::Needle(needle) => self.state.each[needle].grip.map(|grip| grip.tool),
        }
    }

    /// Whether a place on a body can be touched.
    fn is_bare(&self, with: Obstacle, rod: &Rod, alpha: f64) -> bool {
        let is_within = (0.0..=rod.front_m).contains(&alpha);
        is_within
            && match with {
                Obstacle::Bar(_) => true,
                Obstacle::Needle(needle) => self.is_shaft_free(needle, alpha),
            }
    }

    /// Whether a span of a strand may lie on a body: not on the one that has its end.
    fn may_lap(&self, strand: usize, span: &Span, with: Obstacle) -> bool {
        let thread = &self.state.threads[strand];
        let carrier = self.carrier(with);
        let has = |by: ThreadHold| matches!(by, ThreadHold::Tool(tool) if carrier == Some(tool));
        let is_led = self.sources.threads.is_led(strand) && !thread.head.by.is_hand();
        let needle = Obstacle::Needle(self.sources.threads.needle_of(strand));
        let at_tail = span.from.is_none() && has(thread.tail.by);
        let at_head = span.to.is_none() && (has(thread.head.by) || is_led && with == needle);
        span.passage.is_none() && !at_tail && !at_head
    }

    fn end_m(&self, end: &End) -> Vector3<f64> {
        match end {
            End::Tissue(anchor) => self.position_of(anchor),
            End::Held(at) => *at,
        }
    }

    /// How the straight pieces of a span pass a body: the nearest of them, by the bends before it.
    fn passing(
        &self,
        strand: usize,
        span: usize,
        (with, rod): (Obstacle, &Rod),
    ) -> Option<(u32, Passing)> {
        let segments = self.state.threads[strand].segments_of(span).iter();
        let straight = segments.filter(|each| each.leg.is_none());
        let mut nearest: Option<(u32, Passing)> = None;
        for segment in straight {
            let [from, to] = segment.ends.map(|end| self.end_m(&end));
            let Some(found) = pass(rod, &from, &to) else {
                continue;
            };
            let is_nearer =
                nearest.is_none_or(|(_, near)| found.apart_m.abs() < near.apart_m.abs());
            if is_nearer && self.is_bare(with, rod, found.alpha) {
                nearest = Some((segment.key.1, found));
            }
        }
        nearest
    }

    /// Brings what laps lie on to where that is.
    pub(super) fn place_laps(&mut self) {
        if self.sources.threads.contacts.is_empty() {
            return;
        }
        for strand in 0..self.state.threads.len() {
            let mut laps = std::mem::take(&mut self.state.threads[strand].laps);
            let half_m = self.sources.threads.part_of(strand).radius_m();
            laps.retain_mut(|lap| {
                let rod = self.obstacle(lap.with);
                if let Some(rod) = &rod {
                    lap.cylinder = cylinder(rod, lap.alpha, half_m);
                }
                rod.is_some()
            });
            self.state.threads[strand].laps = laps;
        }
    }

    /// After a round: spans that lead through a body come to lie on it, and others off it; whether there are any.
    pub(super) fn find_laps(&mut self) -> bool {
        let mut changed = false;
        let cut_m = CUT_EDGES * self.sources.edge_m();
        for strand in 0..self.state.threads.len() {
            let mut laps = std::mem::take(&mut self.state.threads[strand].laps);
            for place in 0..laps.len() {
                let mut lap = laps[place];
                let place_of = |span: &Span| span.key == lap.key && span.passage.is_none();
                let span = self.state.threads[strand].spans.iter().position(place_of);
                let (Some(span), Some(rod)) = (span, self.obstacle(lap.with)) else {
                    continue;
                };
                if lap.is_on {
                    let is_there = self.is_bare(lap.with, &rod, lap.alpha + lap.middle_m);
                    lap.is_on = is_there && lap.turn > 0.0;
                    // Off its end it is beside nothing.
                    lap.side = if is_there { lap.side } else { 0.0 };
                } else if let Some((bends, found)) = self.passing(strand, span, (lap.with, &rod)) {
                    let radius_m = lap.cylinder.radius_m;
                    let is_through = lap.side * found.apart_m < radius_m - cut_m;
                    let is_free = |other: &Lap| {
                        !(other.is_on && (other.key, other.bends) == (lap.key, bends))
                    };
                    lap.is_on = is_through && laps.iter().all(is_free);
                    (lap.turn, lap.bends, lap.alpha) = (0.0, bends, found.alpha);
                }
                changed |= lap.is_on != laps[place].is_on;
                laps[place] = lap;
            }
            laps.retain(|lap| lap.side != 0.0);
            self.state.threads[strand].laps = laps;
        }
        changed
    }

    /// A balance is found: which spans are beside which bodies, and on which side, and where on a body they lie.
    pub(super) fn follow_laps(&mut self) {
        if self.sources.threads.contacts.is_empty() {
            return;
        }
        let near_m = NEAR_EDGES * self.sources.edge_m();
        for strand in 0..self.state.threads.len() {
            let mut laps = std::mem::take(&mut self.state.threads[strand].laps);
            // What goes on is found again, and all else forgotten.
            let known = laps.len();
            let thread = self.sources.threads.thread_of(strand);
            let contacts = self.sources.threads.contacts.iter();
            for contact in contacts.filter(|contact| contact.thread == thread) {
                let with = contact.with;
                let Some(rod) = self.obstacle(with) else {
                    continue;
                };
                for span in 0..self.state.threads[strand].spans.len() {
                    let key = self.state.threads[strand].spans[span].key;
                    let own = |lap: &&Lap| lap.key == key && lap.with == with;
                    let former = laps[..known].iter().find(own).copied();
                    let next = self.followed_lap(strand, span, (with, &rod), former, near_m);
                    let has_room = laps.len() < known + MOST_LAPS;
                    laps.extend(next.filter(|_| has_room));
                }
            }
            laps.drain(..known);
            self.state.threads[strand].laps = laps;
        }
    }

    /// The lap of a span on a body as a balance has it, if there is one; `former` is that of before.
    fn followed_lap(
        &self,
        strand: usize,
        span: usize,
        (with, rod): (Obstacle, &Rod),
        former: Option<Lap>,
        near_m: f64,
    ) -> Option<Lap> {
        let own = &self.state.threads[strand].spans[span];
        if !self.may_lap(strand, own, with) {
            return None;
        }
        if let Some(lap) = former.filter(|lap| lap.is_on) {
            return Some(Lap {
                alpha: lap.alpha + lap.middle_m,
                middle_m: 0.0,
                ..lap
            });
        }
        let (bends, found) = self.passing(strand, span, (with, rod))?;
        let half_m = self.sources.threads.part_of(strand).radius_m();
        let radius_m = rod.radius_m + half_m;
        let apart_m = found.apart_m.abs();
        let strays = |lap: &Lap| {
            (lap.alpha - found.alpha).abs() * rod.curve.curvature_at(found.alpha) > STRAYS
        };
        let side = match former.filter(|lap| !strays(lap)) {
            Some(lap) => lap.side,
            None if apart_m >= radius_m => found.apart_m.signum(),
            // It has come from nowhere, or over the body's end.
            None => return None,
        };
        (apart_m < radius_m + near_m).then(|| Lap {
            key: own.key,
            with,
            side,
            is_on: false,
            turn: 0.0,
            bends,
            alpha: found.alpha,
            cylinder: cylinder(rod, found.alpha, half_m),
            middle_m: 0.0,
        })
    }
}

/// What a body is at a place on it, for a thread half as thick as that.
fn cylinder(rod: &Rod, alpha: f64, half_m: f64) -> Cylinder {
    Cylinder {
        origin: rod.curve.at(alpha),
        axis: rod.curve.tangent_at(alpha),
        radius_m: rod.radius_m + half_m,
    }
}

/// How a straight line passes a body between the ends of both; nothing if it does not.
fn pass(rod: &Rod, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Passing> {
    let chord = to - from;
    let square = chord.norm_squared();
    let mut nearest: Option<Passing> = None;
    for [begin, end] in rod.stretches() {
        let origin = rod.curve.at(begin);
        let way = rod.curve.at(end) - origin;
        let long_m = way.norm();
        let axis = way / long_m;
        let across = axis.cross(&chord);
        let slant = axis.dot(&chord);
        let left = square - slant * slant;
        // Not a number is none.
        if left.is_nan() || left <= ACROSS * ACROSS * square {
            continue;
        }
        let apart = from - origin;
        let part = (slant * apart.dot(&axis) - apart.dot(&chord)) / left;
        let along_m = apart.dot(&axis) + part * slant;
        if !((0.0..=1.0).contains(&part) && (0.0..=long_m).contains(&along_m)) {
            continue;
        }
        let apart_m = -apart.dot(&across) / across.norm();
        if nearest.is_none_or(|near| apart_m.abs() < near.apart_m.abs()) {
            let alpha = begin + along_m / long_m * (end - begin);
            nearest = Some(Passing { apart_m, alpha });
        }
    }
    nearest
}
