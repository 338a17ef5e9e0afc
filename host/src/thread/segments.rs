//! A thread's path as rows: one length, whatever it takes to keep its pieces straight.
//!
//! Entry points: [`ThreadState::lay`], [`ThreadState::make_rows`], [`ThreadState::settle`] after each solve,
//! [`ThreadState::finish`] at the end of a balance. Younes 2021, 3.33, with both end segments and what lies in tissue:
//! `sum |y_j| <= available` for the ways y_j of all segments, whose multiplier is the tension T. Newton's method on it has,
//! for every segment of length l along d, its part d.y in one shared row and two rows across d that give way by l / T: the
//! stiffness of a taut string. A segment that vanishes has no direction; it becomes a weld, three rows y = 0,
//! until their force exceeds T. Both come out of one formula, the projection of z = y + c f on the segments
//! that are c T shorter (Moreau), with c a typical compliance.
//!
//! Friction: the tension changes by F along a passage through tissue, and F is the multiplier of the length of all that lies
//! beyond, between bounds (module `through`).

use super::follow::FollowWork;
use super::legs::{Leg, add_legs};
use super::model::{ThreadHold, ThreadPart};
use super::state::ThreadState;
use crate::anchors::{
    AnchorPoint, ConstraintSet, ConstraintState, ConstraintSystem, MultiPointConstraint,
    PointConstraint, Term,
};
use crate::mesh::HalfFaces;
use crate::needle::{Crossing, anchor};
use crate::rows::RowKind;
use nalgebra::Vector3;
use serde::Serialize;
use std::ops::Range;

/// A segment's direction is known when forces follow it to this part of the tension.
pub(super) const STRAIGHT: f64 = 1e-3;
/// Or when the piece leads so near to where they point \[m\]: bodies in contact turn a span of a few hundredths of a millimetre by
/// more than that part of it in every step.
pub(super) const ACROSS_M: f64 = 0.2 * LENGTH_M;
/// The true length is held this well \[m\].
pub(super) const LENGTH_M: f64 = 5e-7;
/// Points of tissue that are no farther apart are one \[m\]: a thread that grazes an edge of a body goes in and out at one point.
const SAME_M: f64 = 1e-9;
/// Tension below this is none \[N\].
pub(super) const NO_TENSION_N: f64 = 1e-9;

/// An end of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) enum End {
    /// A point of tissue.
    Tissue(AnchorPoint),
    /// Held there \[m\].
    Held(Vector3<f64>),
}

/// A straight piece of the path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Segment {
    /// Face that its span begins at (0 for the tail), and which piece of the span it is.
    pub key: (u32, u32),
    pub ends: [End; 2],
    pub span: usize,
    /// From its first end to the second \[m\].
    pub way: Vector3<f64>,
    /// Pull on its first end \[N\].
    pub force: Vector3<f64>,
    pub tension_n: f64,
    /// Where it was linearised: what its direction and length are found from, see the module, or the far end of a leg, \[m\], and
    /// \[N\]; its direction, a unit vector, and length \[m\], 0 for a weld.
    pub(super) aim_m: Vector3<f64>,
    pub(super) aim_n: f64,
    pub along: Vector3<f64>,
    pub length_m: f64,
    pub is_weld: bool,
    /// As it was in the last solve: its direction, whether it was a weld, and its first row, if it had any.
    pub solved_along: Vector3<f64>,
    pub was_weld: bool,
    pub first_row: Option<u32>,
    /// Its place among the ways.
    pub place: u32,
    /// Of a piece inside tissue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub piece: Option<Piece>,
    /// Of one that leads to a body that its span lies on, or away from it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leg: Option<Leg>,
}

/// A piece of a path inside tissue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Piece {
    /// Places of its ends among the faces passed; `None` for the head.
    pub from: usize,
    pub to: Option<usize>,
    /// What there is of thread for it \[m\].
    pub material_m: f64,
    /// Part of its passage's friction that acts before its middle: of the passage's length.
    pub share: f64,
}

/// What lies between two faces, or a face and an end, outside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Span {
    /// Id of the face that it begins at, 0 for the tail.
    pub key: u32,
    /// Places among the faces passed; `None` for an end.
    pub from: Option<usize>,
    pub to: Option<usize>,
    /// What there is of thread for it \[m\].
    pub material_m: f64,
    /// Straight distance of its ends in the unloaded mesh \[m\].
    pub rest_m: f64,
    /// Whether it leads from one body of tissue to another, or between punctures of the only one.
    pub bridges: bool,
    /// Most that friction can change the tension by at its end, and what it does \[N\].
    pub limit_n: f64,
    pub friction_n: f64,
    /// Turn along a passage, where the thread goes in and out included \[rad\].
    pub turn: f64,
    /// Multiplier of a bound of its own \[N\].
    pub own_n: f64,
    /// Tension at the hand before it, if there is one \[N\].
    pub shared_n: f64,
    /// Whether a hand that tightens holds the thread at its end.
    pub hand: bool,
    /// Of a way through tissue, whose friction acts along it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub passage: Option<Passage>,
}

/// A way through tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Passage {
    /// Most that friction can lessen the tension by, while `limit_n` is the most that it can raise it by \[N\].
    pub lessens_n: f64,
    /// How `lessens_n` and the span's `limit_n` grow with the tension before it \[1\].
    pub rates: [f64; 2],
}

/// A place among the faces or where it is held \[m\], and where on the thread that is \[m\].
pub(super) type Stop = (Option<usize>, Vector3<f64>, f64);

/// What threads go through.
#[derive(Clone, Copy)]
pub(crate) struct Ground<'a> {
    pub mesh: &'a HalfFaces,
    /// Unloaded nodes \[m\], (n x 3).
    pub points_m: &'a [[f64; 3]],
    /// Number of each node's connected body of tissue, (n), and how many there are.
    pub bodies: &'a [u32],
    pub count: u32,
    /// Least distance of faces inside between which the path has a direction of its own \[m\].
    pub apart_m: f64,
}

impl Ground<'_> {
    /// Whether two faces are of different bodies, or there is only one.
    fn bridges(&self, a: &Crossing, b: &Crossing) -> bool {
        let body = |crossing: &Crossing| {
            let [node, ..] = self.mesh.vertices(crossing.face);
            self.bodies.get(node as usize)
        };
        self.count < 2 || body(a) != body(b)
    }

    /// Whether two ends are the same point of tissue, between which nothing can act.
    pub(super) fn are_one(&self, a: &End, b: &End) -> bool {
        let in_tissue = |end: &End| matches!(end, End::Tissue(_));
        let apart_m = (self.unloaded(a) - self.unloaded(b)).norm();
        in_tissue(a) && in_tissue(b) && apart_m <= SAME_M
    }

    pub(super) fn unloaded(&self, end: &End) -> Vector3<f64> {
        match end {
            End::Tissue(anchor) => {
                let parts = anchor.nodes.iter().zip(anchor.weights);
                let places = parts.filter_map(|(node, weight)| {
                    Some(Vector3::from(*self.points_m.get(*node as usize)?) * weight)
                });
                places.sum()
            }
            End::Held(at) => *at,
        }
    }
}

/// Classes of rows, for their ids.
const PIECE: u64 = 0;
const SHARED: u64 = 1;
const FRICTION_ROW: u64 = 2;
const OWN: u64 = 3;
/// Of a piece's rows, the one of legs along a body.
const AXIAL: u64 = 3;

fn row_id(thread: usize, class: u64, key: (u32, u32), axis: u64) -> u64 {
    let key = u64::from(key.0) << 8 | u64::from(key.1 & 0xff);
    1 << 48 | (thread as u64) << 44 | class << 42 | key << 2 | axis
}

impl ThreadState {
    /// Whether anything but the thread's own slide withstands a pull.
    pub fn pulls(&self, part: &ThreadPart, head_held: bool) -> bool {
        if self.passed.is_empty() {
            return head_held && self.is_tail_in_hand();
        }
        let held = self.is_head_held(head_held) && (self.is_tail_held() || part.drags());
        let draws = self.tightened.is_some() || self.welded.is_some();
        held || draws
    }

    /// Whether the friction of a span, which is then a passage, has a row.
    pub fn has_friction_row(&self, part: &ThreadPart, is_held: bool, place: usize) -> bool {
        let rubs = part.rubs() && (is_held || part.drags() || self.has_hands());
        let span = self.spans.get(place);
        rubs && span.is_some_and(|span| span.passage.is_some())
    }

    /// Rows of friction of a portion.
    pub fn friction_rows(&self, part: &ThreadPart, is_held: bool, portion: Range<usize>) -> usize {
        let mut places = portion;
        let has_row = |place: &usize| self.has_friction_row(part, is_held, *place);
        places.by_ref().filter(has_row).count()
    }

    /// Rows on lengths of a portion.
    pub(super) fn length_rows(
        &self,
        part: &ThreadPart,
        is_held: bool,
        portion: &Range<usize>,
    ) -> usize {
        let shared = usize::from(self.is_portion_held(portion, is_held));
        shared + self.friction_rows(part, is_held, portion.clone())
    }

    /// Finds the path and linearises it; what is known of its segments stays, where others are `at` says. `head` is
    /// where that is, if it is held.
    pub fn lay(
        &mut self,
        ground: &Ground,
        head: Option<Vector3<f64>>,
        known: &mut Vec<Segment>,
        at: impl Fn(&AnchorPoint) -> Vector3<f64>,
    ) {
        known.clone_from(&self.segments);
        self.segments.clear();
        self.spans.clear();
        let in_hand = self.is_tail_in_hand();
        let tail = (None, self.tail.at, self.tail.alpha);
        let first = self.passed.first().map(|first| first.crossing);
        let next = match (first, head) {
            (Some(first), _) if first.enters => Some((Some(0), Vector3::zeros(), first.alpha)),
            // No tissue between two hands.
            (None, Some(head)) => Some((None, head, self.head.alpha)),
            _ => None,
        };
        if let Some(to) = next.filter(|_| in_hand) {
            self.add_span(ground, known, tail, to, &at);
        }
        self.lay_through(ground, head, known, &at);
    }

    /// Adds what lies between two faces or ends: place among the faces or where it is held, and where on the thread.
    pub(super) fn add_span(
        &mut self,
        ground: &Ground,
        known: &[Segment],
        from: Stop,
        to: Stop,
        at: &impl Fn(&AnchorPoint) -> Vector3<f64>,
    ) {
        let [first, second] = self.push_span(ground, from, to);
        let (place, key) = (self.spans.len() - 1, self.spans[self.spans.len() - 1].key);
        let (mut piece, mut last) = (0, first);
        let bends = self.bends.iter().filter(|(of, _)| *of == key);
        let count = bends.clone().count() as u32;
        let stops = bends.map(|(_, bend)| End::Tissue(*bend));
        for stop in stops.chain([second]) {
            let lap = self.laps.iter_mut();
            if let Some(lap) = lap.into_iter().find(|lap| lap.is_behind(key, piece, count)) {
                let segments = (lap, &mut self.segments);
                add_legs(segments, (key, piece), [last, stop], place, known, at);
            } else if !ground.are_one(&last, &stop) {
                let segment = Segment::new((key, piece), [last, stop], place, known, at);
                self.segments.push(segment.linearised(self.compliance));
            }
            piece += 1;
            last = stop;
        }
    }

    /// Adds a span without its segments; its ends.
    pub(super) fn push_span(&mut self, ground: &Ground, from: Stop, to: Stop) -> [End; 2] {
        let passed = |place: Option<usize>| Some(self.passed.get(place?)?.crossing);
        let end = |(place, held, _): Stop| match passed(place) {
            Some(crossing) => End::Tissue(anchor(ground.mesh, &crossing)),
            None => End::Held(held),
        };
        let (first, second) = (end(from), end(to));
        let key = from.0.map_or(0, |place| self.passed[place].id);
        let bridges = match (passed(from.0), passed(to.0)) {
            (Some(a), Some(b)) => ground.bridges(&a, &b),
            _ => false,
        };
        let before = self.former.iter().find(|span| span.key == key);
        self.spans.push(Span {
            key,
            from: from.0,
            to: to.0,
            material_m: to.2 - from.2,
            rest_m: (ground.unloaded(&second) - ground.unloaded(&first)).norm(),
            bridges,
            limit_n: before.map_or(0.0, |span| span.limit_n),
            friction_n: before.map_or(0.0, |span| span.friction_n),
            turn: before.map_or(0.0, |span| span.turn),
            own_n: before.map_or(0.0, |span| span.own_n),
            shared_n: before.map_or(0.0, |span| span.shared_n),
            hand: false,
            passage: None,
        });
        [first, second]
    }

    /// Appends the rows of the path.
    pub fn make_rows(
        &mut self,
        index: usize,
        part: &ThreadPart,
        is_held: bool,
        ground: &Ground,
        set: &mut ConstraintSet,
    ) {
        let first = set.spread.len();
        self.make_segment_rows(index, ground, set);
        if !self.segments.is_empty() {
            self.make_length_rows(index, part, is_held, ground, set);
            let id = |key| row_id(index, PIECE, key, AXIAL);
            self.make_axial_rows(id, ground, first, set);
        }
    }

    /// Ways of all segments, and the rows that keep a weld together, or a tense segment straight.
    fn make_segment_rows(&mut self, index: usize, ground: &Ground, set: &mut ConstraintSet) {
        let rest = |end: &End| ground.unloaded(end);
        for segment in &mut self.segments {
            let tissue = |end: &End| match end {
                End::Tissue(anchor) => Some(*anchor),
                End::Held(_) => None,
            };
            let [a, b] = &segment.ends;
            segment.place = set.add_way([tissue(a), tissue(b)]);
            segment.first_row = None;
            segment.was_weld = segment.is_weld;
            segment.solved_along = segment.along;
            if let Some(leg) = &mut segment.leg {
                leg.solved_across = leg.across;
            }
            let from = rest(b) - rest(a);
            let first = set.rows.len() as u32;
            let mut add = |axis: u64, direction: Vector3<f64>| {
                set.rows.push(PointConstraint {
                    id: row_id(index, PIECE, segment.key, axis),
                    anchor: segment.place,
                    kind: RowKind::Equality,
                    direction: direction.into(),
                    target_m: -direction.dot(&from),
                });
            };
            if segment.is_weld {
                (0..3).for_each(|axis| add(axis, Vector3::ith(axis as usize, 1.0)));
                segment.first_row = Some(first);
            } else if segment.aim_n > NO_TENSION_N {
                let soft = segment.length_m / segment.aim_n;
                segment.first_row = Some(first);
                if let Some(leg) = segment.leg {
                    add(0, leg.across[0]);
                    set.soft.push((first, soft));
                    continue;
                }
                let (u, v) = across(&segment.along);
                add(0, u);
                add(1, v);
                set.soft.extend([(first, soft), (first + 1, soft)]);
            }
        }
    }

    /// Rows on lengths: of every portion, beyond each span that rubs, and of spans that are welded.
    fn make_length_rows(
        &self,
        index: usize,
        part: &ThreadPart,
        is_held: bool,
        ground: &Ground,
        set: &mut ConstraintSet,
    ) {
        let rest = |end: &End| ground.unloaded(end);
        let along = |weight: &dyn Fn(&Segment) -> f64, terms: &mut Vec<Term>| {
            let first = terms.len() as u32;
            let mut straight = 0.0;
            for segment in &self.segments {
                let weight = weight(segment);
                if weight > 0.0 && !segment.is_weld {
                    let [a, b] = &segment.ends;
                    straight += weight * segment.along.dot(&(rest(b) - rest(a)));
                    straight += weight * segment.arc_m();
                    terms.push(Term {
                        anchor: segment.place,
                        direction: (segment.along * weight).into(),
                    });
                }
            }
            ((first, terms.len() as u32 - first), straight)
        };
        let count = self.spans.len();
        let mut add =
            |class: u64, key: u32, kind: RowKind, weight: &dyn Fn(&Segment) -> f64, length: f64| {
                let (terms, straight) = along(weight, &mut set.terms);
                set.spread.push(MultiPointConstraint {
                    id: row_id(index, class, (key, 0), 0),
                    kind,
                    target_m: length - straight,
                    compliance_m_per_n: 0.0,
                    terms,
                });
            };
        for portion in self.portions() {
            let own = |segment: &Segment| portion.contains(&segment.span);
            if self.is_portion_held(&portion, is_held) {
                let kind = RowKind::Between {
                    least_n: 0.0,
                    most_n: self.most_n(part, &portion),
                };
                let key = self.spans[portion.start].key;
                let weight = |segment: &Segment| f64::from(u8::from(own(segment)));
                let key = if portion.start == 0 { 0 } else { key };
                add(SHARED, key, kind, &weight, self.material_m(&portion));
            }
            for place in portion.clone() {
                if self.has_friction_row(part, is_held, place) {
                    let span = self.spans[place];
                    let passage = span.passage.unwrap_or_default();
                    let kind = RowKind::Between {
                        least_n: -passage.lessens_n,
                        most_n: span.limit_n,
                    };
                    let weight = |segment: &Segment| match own(segment) {
                        true => segment.beyond(place),
                        false => 0.0,
                    };
                    add(FRICTION_ROW, span.key, kind, &weight, self.beyond_m(place));
                }
            }
        }
        if self.welded.is_some() {
            for place in 0..count {
                let span = self.spans[place];
                if let Some(length) = self.bound_m(place) {
                    let own = |segment: &Segment| f64::from(u8::from(segment.span == place));
                    add(OWN, span.key, RowKind::Inequality, &own, length);
                }
            }
        }
    }

    /// What there is of thread beyond the friction of a span \[m\].
    pub(super) fn beyond_m(&self, place: usize) -> f64 {
        let end = self.portion(place).end;
        let after = self.spans[place + 1..end].iter();
        after.map(|span| span.material_m).sum::<f64>() + self.own_m(place, |share| share)
    }

    /// What there is of thread for a portion \[m\].
    pub(super) fn material_m(&self, portion: &Range<usize>) -> f64 {
        let spans = self.spans[portion.clone()].iter();
        let spans: f64 = spans.map(|span| span.material_m).sum();
        let ends = [portion.start == 0, portion.end == self.spans.len()];
        spans + self.loose_m(ends)
    }

    /// What there is of thread for the path \[m\].
    pub fn available_m(&self) -> f64 {
        self.material_m(&(0..self.spans.len()))
    }

    /// What is left before knots come to the tissue at the ends that `has_ends` \[m\].
    pub(super) fn loose_m(&self, has_ends: [bool; 2]) -> f64 {
        let ends = self.passed.first().zip(self.passed.last());
        ends.map_or(0.0, |(first, last)| {
            let tail_m = first.crossing.alpha - self.tail.alpha;
            let head_m = self.head.alpha - last.crossing.alpha;
            let knots = [&self.tail, &self.head].map(|hold| hold.by == ThreadHold::Knot);
            let is_there = |end: usize| f64::from(u8::from(has_ends[end] && knots[end]));
            tail_m * is_there(0) + head_m * is_there(1)
        })
    }

    /// After a solve whose single rows were `single` in number, and the first of those on several anchors that are this thread's
    /// `first`: linearises anew; whether that was not needed. `c` is a typical compliance \[m/N\].
    pub fn settle(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        (single, first): (usize, usize),
        ground: &Ground,
        (system, grasp): (&ConstraintSystem, &ConstraintState),
        follow: &mut FollowWork,
    ) -> bool {
        let mut multipliers = grasp
            .lambda()
            .get(single + first..)
            .unwrap_or_default()
            .iter();
        self.take_tensions(part, is_held, &mut multipliers);
        let shared = self.spans.first().map_or(0.0, |first| first.shared_n);
        self.compliance = self.typical_compliance(system);
        let of_solve = (system, grasp, single + first);
        let mut settled = self.linearise_segments(ground, of_solve, follow.part);
        settled &= self.linearise_legs(follow.part);
        for place in 0..self.spans.len() {
            let span = self.spans[place];
            if let Some(bound_m) = self.bound_m(place) {
                let over = self.lengths_of(place) - bound_m;
                settled &= over <= LENGTH_M && (span.own_n == 0.0 || over >= -LENGTH_M);
            }
        }
        settled &= self.settle_through(part, is_held, shared);
        self.foresee(part, is_held, (single, first), (system, grasp), follow);
        settled
    }

    /// Takes the tensions of a solve: those at the tail and behind hands, friction, and what spans have of their own.
    fn take_tensions<'a>(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        multipliers: &mut impl Iterator<Item = &'a f64>,
    ) {
        let mut take = || multipliers.next().copied().unwrap_or(0.0);
        let mut next = 0;
        for place in 0..self.spans.len() {
            if place == next {
                let portion = self.portion(place);
                let is_held = self.is_portion_held(&portion, is_held);
                self.spans[place].shared_n = if is_held { take().max(0.0) } else { 0.0 };
                next = portion.end;
            }
            if self.has_friction_row(part, is_held, place) {
                self.spans[place].friction_n = take();
            }
        }
        if self.welded.is_some() {
            for place in 0..self.spans.len() {
                let bound = self.spans[place].bridges;
                self.spans[place].own_n = if bound { take().max(0.0) } else { 0.0 };
            }
        }
    }

    /// The tension before a span, if that before the one before it is `tension_n` \[N\].
    pub(super) fn tension_before(&self, place: usize, tension_n: f64) -> f64 {
        match place.checked_sub(1).map(|before| self.spans[before]) {
            Some(before) if !before.hand => tension_n + before.friction_n,
            _ => self.spans[place].shared_n,
        }
    }

    /// Linearises all segments but legs where a solve has them, or a `part` of the way there; whether their forces are along them.
    /// The thread's rows on several anchors begin at `first`.
    fn linearise_segments(
        &mut self,
        ground: &Ground,
        (system, grasp, first): (&ConstraintSystem, &ConstraintState, usize),
        part: f64,
    ) -> bool {
        let lambda = grasp.lambda();
        let c = self.compliance;
        let mut settled = true;
        let mut tension = 0.0;
        let mut next = 0;
        for index in 0..self.segments.len() {
            while next <= self.segments[index].span {
                tension = self.tension_before(next, tension);
                next += 1;
            }
            let segment = &mut self.segments[index];
            let own = self.spans[segment.span].own_n;
            let before = segment.piece.map_or(0.0, |piece| {
                piece.share * self.spans[segment.span].friction_n
            });
            segment.tension_n = (tension + before + own).max(0.0);
            let [a, b] = &segment.ends;
            segment.way = ground.unloaded(b) - ground.unloaded(a)
                + system.anchor_displacement(segment.place as usize);
            segment.force = Vector3::zeros();
            if !segment.is_weld {
                segment.force = segment.along * segment.tension_n;
            }
            if let Some(leg) = segment.leg {
                let rows = [
                    segment.first_row.map(|row| row as usize),
                    leg.axial_row.map(|row| first + row as usize),
                ];
                for (row, along) in rows.into_iter().zip(&leg.across) {
                    let of_row = row.and_then(|row| lambda.get(row));
                    segment.force += along * of_row.copied().unwrap_or(0.0);
                }
                continue;
            }
            if let Some(row) = segment.first_row {
                let row = row as usize;
                let of_row = |axis: usize| lambda.get(row + axis).copied().unwrap_or(0.0);
                if segment.is_weld {
                    segment.force = Vector3::new(of_row(0), of_row(1), of_row(2));
                } else {
                    let (u, v) = across(&segment.along);
                    segment.force += u * of_row(0) + v * of_row(1);
                }
            }
            let length = segment.way.norm();
            let pull = segment.tension_n;
            settled &= if segment.is_weld {
                segment.force.norm() <= pull * (1.0 + STRAIGHT) + NO_TENSION_N
            } else if pull > NO_TENSION_N {
                let straight = segment.way * (pull / length.max(f64::MIN_POSITIVE));
                let off_n = (segment.force - straight).norm();
                let is_along =
                    off_n <= STRAIGHT * pull.max(1e-3) || off_n * length <= ACROSS_M * pull;
                is_along && segment.has_its_tension()
            } else {
                true
            };
            segment.linearise(c, part);
        }
        settled
    }

    /// Rows on several anchors that [`Self::make_rows`] makes.
    pub fn spread_rows(&self, part: &ThreadPart, is_held: bool) -> usize {
        if self.segments.is_empty() {
            return 0;
        }
        let own = self.spans.iter().filter(|span| span.bridges).count();
        let portions = self.portions();
        let lengths = portions.map(|portion| self.length_rows(part, is_held, &portion));
        let welded = if self.welded.is_some() { own } else { 0 };
        let leaving = |leg: &Leg| leg.leaves && leg.axial_row.is_some();
        let legs = self.segments.iter().filter_map(|segment| segment.leg);
        lengths.sum::<usize>() + welded + legs.filter(leaving).count()
    }

    /// A span's own bound of its length \[m\], if it has one.
    fn bound_m(&self, place: usize) -> Option<f64> {
        let span = self.spans.get(place).filter(|span| span.bridges)?;
        Some(self.welded? * span.rest_m)
    }

    /// True length of its path \[m\].
    pub fn length_m(&self) -> f64 {
        let spans = 0..self.spans.len();
        // Not -0, which a sum of nothing is.
        spans.map(|span| self.lengths_of(span)).sum::<f64>() + 0.0
    }

    /// True length of a span \[m\].
    pub fn lengths_of(&self, span: usize) -> f64 {
        self.segments_of(span).iter().map(Segment::path_m).sum()
    }

    /// Places of a span's segments: they are in the order of spans.
    pub(super) fn range_of(&self, span: usize) -> Range<usize> {
        let first = self.segments.partition_point(|segment| segment.span < span);
        let own = self.segments[first..].partition_point(|segment| segment.span == span);
        first..first + own
    }

    pub(super) fn segments_of(&self, span: usize) -> &[Segment] {
        &self.segments[self.range_of(span)]
    }

    /// Tension behind the face of that name, towards the head \[N\]; in tissue as before it.
    pub fn tension_after(&self, id: u32) -> f64 {
        // Beyond the last hand there is none where that holds the end.
        let last = self.spans.last().filter(|last| last.hand);
        let end = last.and_then(|last| self.passed.get(last.to?));
        if end.is_some_and(|end| id >= end.id) {
            return 0.0;
        }
        let before = self.segments.iter().rfind(|segment| segment.key.0 <= id);
        before.map_or(0.0, |segment| segment.tension_n)
    }

    /// Typical compliance of a segment \[m/N\].
    fn typical_compliance(&self, system: &ConstraintSystem) -> f64 {
        let own = |segment: &Segment| {
            let place = segment.place as usize;
            system.between(place, place).trace() / 3.0
        };
        let sum: f64 = self.segments.iter().map(own).sum();
        let mean = sum / self.segments.len().max(1) as f64;
        if mean > 0.0 && mean.is_finite() {
            mean
        } else {
            1.0
        }
    }
}

impl Segment {
    /// Between `ends`, as far as it is `known`.
    pub(super) fn new(
        key: (u32, u32),
        ends: [End; 2],
        span: usize,
        known: &[Segment],
        at: &impl Fn(&AnchorPoint) -> Vector3<f64>,
    ) -> Self {
        let same = known.iter().find(|segment| segment.key == key);
        let point = |end: &End| match end {
            End::Tissue(anchor) => at(anchor),
            End::Held(at) => *at,
        };
        let way = match (same, ends) {
            (Some(same), [End::Tissue(_), End::Tissue(_)]) if same.ends == ends => same.way,
            // What is held has moved, the tissue has not.
            (Some(same), [End::Tissue(a), End::Held(b)]) => match same.ends {
                [End::Tissue(before), End::Held(held)] if before == a => same.way + b - held,
                _ => b - at(&a),
            },
            (Some(same), [End::Held(a), End::Tissue(b)]) => match same.ends {
                [End::Held(held), End::Tissue(before)] if before == b => same.way + held - a,
                _ => at(&b) - a,
            },
            _ => point(&ends[1]) - point(&ends[0]),
        };
        let goes_on = same.is_some_and(|same| have_same_points(&ends, &same.ends));
        let before = known.iter().find(|segment| segment.key.0 == key.0);
        let (force, tension_n) = match (same, before) {
            (Some(same), _) if goes_on => (same.force, same.tension_n),
            // Beside a bend that has come or gone: what the span pulled with, straight on.
            (_, Some(before)) => {
                let along = way.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
                (along * before.tension_n, before.tension_n)
            }
            _ => (Vector3::zeros(), 0.0),
        };
        Self {
            key,
            ends,
            span,
            way,
            force,
            tension_n,
            aim_m: Vector3::zeros(),
            aim_n: 0.0,
            along: Vector3::zeros(),
            length_m: 0.0,
            is_weld: false,
            solved_along: Vector3::zeros(),
            was_weld: false,
            first_row: None,
            place: 0,
            piece: None,
            leg: None,
        }
    }

    /// The same, linearised.
    pub(super) fn linearised(mut self, c: f64) -> Self {
        self.linearise(c, 1.0);
        self
    }

    /// Part of the friction of the span at `place` that acts on its tension.
    pub(super) fn beyond(&self, place: usize) -> f64 {
        match self.piece {
            Some(piece) if self.span == place => piece.share,
            _ => f64::from(u8::from(self.span > place)),
        }
    }

    /// Direction, length, and whether it is a weld, from its way and force, or from a `part` of the change to them: see the module.
    fn linearise(&mut self, c: f64, part: f64) {
        let (aim_m, aim_n) = (self.way + self.force * c, self.tension_n);
        if part < 1.0 {
            self.aim_m += (aim_m - self.aim_m) * part;
            self.aim_n += (aim_n - self.aim_n) * part;
        } else {
            (self.aim_m, self.aim_n) = (aim_m, aim_n);
        }
        let (size, short) = (self.aim_m.norm(), c * self.aim_n);
        self.is_weld = size <= short && self.aim_n > NO_TENSION_N;
        if self.is_weld || size == 0.0 {
            self.length_m = 0.0;
            self.is_weld = true;
            return;
        }
        self.along = self.aim_m / size;
        self.length_m = size - short;
    }

    /// Whether it was solved with the tension that was found, if it leads to no tissue: its direction is then known without, how stiff it is across
    /// is not.
    pub(super) fn has_its_tension(&self) -> bool {
        let is_bare = matches!(self.ends, [End::Held(_), End::Held(_)]);
        !is_bare || (self.aim_n - self.tension_n).abs() <= STRAIGHT * self.tension_n
    }

    /// The pull on its first end, or its way if it does not pull.
    pub(super) fn pull(&self) -> Vector3<f64> {
        if self.tension_n > NO_TENSION_N {
            self.force
        } else {
            self.way
        }
    }
}

/// Whether ends are the same points of tissue, wherever what is held is.
fn have_same_points(ends: &[End; 2], others: &[End; 2]) -> bool {
    let is_same = |(one, other): (&End, &End)| match (one, other) {
        (End::Held(_), End::Held(_)) => true,
        _ => one == other,
    };
    ends.iter().zip(others).all(is_same)
}

/// Two unit vectors across another.
pub(super) fn across(along: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let u = along.cross(&Vector3::ith(along.iamin(), 1.0)).normalize();
    (u, along.cross(&u))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(node: u32) -> End {
        End::Tissue(AnchorPoint {
            nodes: [node; 4],
            weights: [1.0, 0.0, 0.0, 0.0],
        })
    }

    /// A piece beside a bend that has come pulls as its span did, along what is seen; one that was there goes on as it was.
    #[test]
    fn a_new_piece_pulls_as_its_span_did() {
        let at = |point: &AnchorPoint| Vector3::new(0.002 * f64::from(point.nodes[0]), 0.0, 0.0);
        let new = |piece: u32, ends: [End; 2], known: &[Segment]| {
            Segment::new((5, piece), ends, 0, known, &at)
        };
        let slack = new(0, [node(1), node(2)], &[]);
        assert_eq!((slack.tension_n, slack.force), (0.0, Vector3::zeros()));
        let force = Vector3::new(0.2, 0.1, 0.0);
        let known = [Segment {
            tension_n: 0.3,
            force,
            ..slack
        }];
        let same = new(0, [node(1), node(2)], &known);
        assert_eq!((same.tension_n, same.force), (0.3, force));
        for (piece, ends) in [(0, [node(1), node(3)]), (1, [node(3), node(2)])] {
            let beside = new(piece, ends, &known);
            let along = beside.way / beside.way.norm();
            assert_eq!((beside.tension_n, beside.force), (0.3, along * 0.3));
        }
        // What is held is the same thread wherever it is.
        let [there, here] = [0.01, 0.02].map(|x| End::Held(Vector3::new(x, 0.0, 0.0)));
        let known = [Segment {
            ends: [node(1), there],
            ..known[0]
        }];
        assert_eq!(new(0, [node(1), here], &known).force, force);
    }

    /// A segment that solves leave to and fro, at two tensions and two ways, is linearised between them where half of each change is
    /// made, and where each solve has it otherwise.
    #[test]
    fn what_goes_to_and_fro_ends_between() {
        let at = |point: &AnchorPoint| Vector3::new(0.002 * f64::from(point.nodes[0]), 0.0, 0.0);
        let fresh = Segment::new((5, 0), [node(1), node(2)], 0, &[], &at);
        let ends = [(1.0, 0.3), (-1.0, 0.1)].map(|(side, tension_n)| {
            let way = Vector3::new(2e-3, 1e-3 * side, 0.0);
            (way, way.normalize() * tension_n, tension_n)
        });
        let swung = |part: f64| {
            let mut segment = fresh;
            segment.linearise(1e-3, 1.0);
            let mut slopes = [0.0; 2];
            for solve in 0..40 {
                let (way, force, tension_n) = ends[solve % 2];
                (segment.way, segment.force, segment.tension_n) = (way, force, tension_n);
                segment.linearise(1e-3, part);
                slopes[solve % 2] = segment.along.y / segment.along.x;
            }
            slopes
        };
        let slope = |end: usize| ends[end].0.y / ends[end].0.x;
        for end in [0, 1] {
            assert!((swung(1.0)[end] - slope(end)).abs() < 1e-12);
            assert!(swung(0.5)[end].abs() < 0.6 * slope(end).abs());
        }
    }
}
