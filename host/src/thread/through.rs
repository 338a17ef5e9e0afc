//! The one length of a thread, through outside spans and paths inside tissue: it stretches and drags.
//!
//! Entry points: [`ThreadState::lay_through`], [`ThreadState::soften`] for each solve, [`ThreadState::settle_through`] after it,
//! [`ThreadState::finish`] at the end of a balance. Younes 2021, 3.33, with the pieces between faces inside
//! among its terms: a point inside is pulled by the tension times the turn there, nothing where the path is straight. A span that has
//! m of thread is m (1 + T / EA) long, so that EA enters as the rows' own compliance, m / EA for all that two rows share. Along a passage
//! dT/ds = drag + friction |curvature| T; its integral bounds one unknown F a passage, which is
//! spread evenly over the passage's length.

use super::model::{ThreadHold, ThreadPart, ThreadTension};
use super::segments::{End, Ground, LENGTH_M, NO_TENSION_N, Piece, Segment, Span, Stop};
use super::state::ThreadState;
use crate::anchors::AnchorPoint;
use crate::needle::anchor;
use nalgebra::Vector3;
use std::ops::Range;

/// Bounds follow the tensions to this part of them.
pub(super) const FOLLOWS: f64 = 1e-4;
/// A passage multiplies the tension by no more, which is e^5.7: what is before it then is hardly felt, and solves that go on to tell it from none
/// find no end.
const MOST_GROWN: f64 = 300.0;
/// Least that a strand gives way by between two hands with no tissue between them \[m/N\]: the grips do, by about as much as a finger's pad. What
/// is stiffer than 2000 N/m no hand could hold at a tension that is not that at which it gives way.
const BARE_M_PER_N: f64 = 5e-4;
/// Faces inside of which every one can be a point of the path; of more only some are.
const MOST_FACES: usize = 128;

impl ThreadState {
    /// Spans in the order of the path, outside and inside, from the first face on.
    pub(super) fn lay_through(
        &mut self,
        ground: &Ground,
        head: Option<Vector3<f64>>,
        known: &[Segment],
        at: &impl Fn(&AnchorPoint) -> Vector3<f64>,
    ) {
        let count = self.passed.len();
        let mut index = 0;
        while index < count {
            let own = self.passed[index];
            let stop = |place: usize| {
                (
                    Some(place),
                    Vector3::zeros(),
                    self.passed[place].crossing.alpha,
                )
            };
            let end = head.map(|head| (None, head, self.head.alpha));
            let from = stop(index);
            if own.is_boundary && !own.crossing.enters {
                let next = (index + 1 < count).then(|| stop(index + 1)).or(end);
                if let Some(to) = next {
                    self.add_span(ground, known, from, to, at);
                }
                index += 1;
                continue;
            }
            let leaves = (index + 1..count).find(|place| {
                let passed = &self.passed[*place];
                passed.is_boundary && !passed.crossing.enters
            });
            let last = leaves.unwrap_or(count - 1);
            let to = match (leaves, end) {
                (None, Some(end)) => Some(end),
                _ => (last > index).then(|| stop(last)),
            };
            if let Some(to) = to {
                self.add_passage(ground, known, from, to, at);
            }
            index = leaves.unwrap_or(count);
        }
    }

    /// Adds a way through tissue, with a piece between every two faces that are far enough apart.
    fn add_passage(
        &mut self,
        ground: &Ground,
        known: &[Segment],
        from: Stop,
        to: Stop,
        at: &impl Fn(&AnchorPoint) -> Vector3<f64>,
    ) {
        let [mut last, end] = self.push_span(ground, from, to);
        let place = self.spans.len() - 1;
        let former = self
            .former
            .iter()
            .find(|span| span.key == self.spans[place].key);
        let passage = former.and_then(|span| span.passage).unwrap_or_default();
        self.spans[place].passage = Some(passage);
        // It leads through tissue, not from one piece of it to another.
        self.spans[place].bridges = false;
        let Some(mut begin) = from.0 else {
            return;
        };
        let faces = self.passed.len();
        let stride = 1 + faces / MOST_FACES;
        let upto = to.0.unwrap_or(faces);
        let total = (to.2 - from.2).max(f64::MIN_POSITIVE);
        let apart = |a: &End, b: &End| (ground.unloaded(a) - ground.unloaded(b)).norm();
        let add = |threads: &mut Self, ends: [End; 2], begin: usize, until: Option<usize>| {
            if ground.are_one(&ends[0], &ends[1]) {
                return;
            }
            let alpha = |place: usize| threads.passed[place].crossing.alpha;
            let [start, stop] = [alpha(begin), until.map_or(to.2, alpha)];
            let key = (threads.passed[begin].id, 0);
            let mut segment = Segment::new(key, ends, place, known, at);
            segment.piece = Some(Piece {
                from: begin,
                to: until,
                material_m: stop - start,
                share: (0.5 * (start + stop) - from.2) / total,
            });
            let segment = segment.linearised(threads.compliance);
            threads.segments.push(segment);
        };
        for inner in begin + 1..upto {
            let next = End::Tissue(anchor(ground.mesh, &self.passed[inner].crossing));
            let is_due = (inner - begin).is_multiple_of(stride);
            let far = apart(&last, &next) >= ground.apart_m;
            // A held end may be anywhere.
            let before_end = matches!(end, End::Held(_)) || apart(&next, &end) >= ground.apart_m;
            if is_due && far && before_end {
                add(self, [last, next], begin, Some(inner));
                (last, begin) = (next, inner);
            }
        }
        add(self, [last, end], begin, to.0);
    }

    /// Sum of what there is of thread in the pieces of a passage \[m\], weighted by their shares.
    pub(super) fn own_m(&self, place: usize, weight: impl Fn(f64) -> f64) -> f64 {
        let own = self.segments_of(place).iter();
        let pieces = own.filter_map(|segment| segment.piece);
        pieces
            .map(|piece| weight(piece.share) * piece.material_m)
            .sum()
    }

    /// Adds the stretch to the compliance of `n` rows (n x n), of which the thread's rows on lengths begin at `first`.
    pub fn soften(
        &self,
        part: &ThreadPart,
        is_held: bool,
        first: usize,
        n: usize,
        compliance: &mut [f64],
    ) {
        let soft = part.through.axial_stiffness_n.recip();
        let bare = self.bare_m_per_n(part);
        if self.segments.is_empty() || soft + bare == 0.0 {
            return;
        }
        let mut add = |row: usize, column: usize, by: f64| {
            if let Some(entry) = compliance.get_mut(n * column + row) {
                *entry += by;
            }
        };
        let mut row = first;
        for portion in self.portions() {
            let first = row;
            if self.is_portion_held(&portion, is_held) {
                let spans = self.spans[portion.clone()].iter();
                let all_m: f64 = spans.map(|span| span.material_m).sum();
                add(row, row, all_m * soft + bare);
                row += 1;
            }
            for place in portion {
                if !self.has_friction_row(part, is_held, place) {
                    continue;
                }
                let beyond = self.beyond_m(place);
                for before in first..row {
                    add(row, before, beyond * soft);
                    add(before, row, beyond * soft);
                }
                let own = self.own_m(place, |share| share * share - share);
                add(row, row, (beyond + own) * soft);
                row += 1;
            }
        }
    }

    /// What a strand between two hands gives way by beyond its stretch \[m/N\].
    fn bare_m_per_n(&self, part: &ThreadPart) -> f64 {
        let all_m = self.head.alpha - self.tail.alpha;
        match self.passed.is_empty() {
            true => (BARE_M_PER_N - all_m / part.through.axial_stiffness_n).max(0.0),
            false => 0.0,
        }
    }

    /// After a solve in which the tension at the tail is `shared`: bounds of friction and of what holds the ends, and whether
    /// they are as they were and lengths are held.
    pub(super) fn settle_through(&mut self, part: &ThreadPart, is_held: bool, shared: f64) -> bool {
        self.turn_inside();
        let portions = self.portions();
        let lengths = portions
            .map(|portion| self.lengths_are_held(part, is_held, &portion))
            .fold(true, |held, own| held & own);
        let bounds = self.rub_inside(part);
        self.bind(part, shared) && bounds && lengths
    }

    /// Whether true lengths of a portion are what the rows allow.
    fn lengths_are_held(&self, part: &ThreadPart, is_held: bool, portion: &Range<usize>) -> bool {
        let mut settled = true;
        let mut beyond = 0.0;
        for (place, span) in self.spans.iter().enumerate().rev() {
            if !portion.contains(&place) {
                continue;
            }
            // Pieces have their own; a passage at one point has none.
            let mut own = if span.passage.is_some() && !self.is_point(place) {
                0.0
            } else {
                -span.material_m * self.stretch(part, place)
            };
            let mut before = 0.0;
            for segment in self.segments_of(place) {
                let mut over = segment.path_m();
                if let Some(piece) = segment.piece {
                    over -= piece.material_m * stretch(part, segment.tension_n);
                    before += piece.share * over;
                }
                own += over;
            }
            if self.has_friction_row(part, is_held, place) {
                let over = beyond + before;
                let lessens_n = span.passage.map_or(0.0, |passage| passage.lessens_n);
                let longer = span.friction_n >= span.limit_n - NO_TENSION_N;
                let shorter = span.friction_n <= NO_TENSION_N - lessens_n;
                settled &= (longer || over <= LENGTH_M) && (shorter || over >= -LENGTH_M);
            }
            beyond += own;
        }
        if self.is_portion_held(portion, is_held) {
            let shared = self.spans[portion.start].shared_n;
            let gives_way = shared >= self.most_n(part, portion) - NO_TENSION_N;
            beyond -= self.loose_m([portion.start == 0, portion.end == self.spans.len()]);
            beyond -= self.bare_m_per_n(part) * shared;
            settled &= (gives_way || beyond <= LENGTH_M)
                && (shared <= NO_TENSION_N || beyond >= -LENGTH_M);
        }
        settled
    }

    /// Length of a span outside over what there is of thread for it.
    fn stretch(&self, part: &ThreadPart, place: usize) -> f64 {
        let own = self.segments_of(place).first();
        stretch(part, own.map_or(0.0, |segment| segment.tension_n))
    }

    /// Length of a passage, each piece times e^(friction turn) of what comes after it, and before it \[m\].
    fn turned_lengths_m(&self, place: usize, friction: f64) -> [f64; 2] {
        let total = self.spans[place].turn;
        let (mut gone, mut lengths) = (0.0, [0.0; 2]);
        for index in self.range_of(place) {
            let segment = &self.segments[index];
            let before = index.checked_sub(1).map(|before| &self.segments[before]);
            gone += before.map_or(0.0, |before| before.turn_to(segment));
            let length_m = segment.way.norm();
            let grown = |turn: f64| (friction * turn).exp().min(MOST_GROWN);
            lengths[0] += length_m * grown(total - gone);
            lengths[1] += length_m * grown(gone);
        }
        lengths
    }

    /// Turns along each passage, where the thread goes in and out included, as segments pull now.
    fn turn_inside(&mut self) {
        for span in &mut self.spans {
            span.turn = 0.0;
        }
        for pair in self.segments.windows(2) {
            let [before, after] = pair else {
                continue;
            };
            let inside = [before, after]
                .into_iter()
                .find(|segment| segment.piece.is_some());
            if let Some(inside) = inside {
                self.spans[inside.span].turn += before.turn_to(after);
            }
        }
    }

    /// Bounds of friction along each passage from the tension before it; whether they are as they were.
    fn rub_inside(&mut self, part: &ThreadPart) -> bool {
        let drag = part.through.drag_n_per_m;
        let mut settled = true;
        let mut tension = 0.0;
        for place in 0..self.spans.len() {
            tension = self.tension_before(place, tension);
            let [ahead_m, back_m] = if drag > 0.0 {
                self.turned_lengths_m(place, part.friction)
            } else {
                [0.0; 2]
            };
            let span = &mut self.spans[place];
            let Some(passage) = &mut span.passage else {
                continue;
            };
            let grown = (part.friction * span.turn).exp_m1().min(MOST_GROWN);
            let before = tension.max(0.0);
            let limit_n = grown * before + drag * ahead_m;
            // Lessened to T' it grows to T on the way back; it does not push.
            let lessens_n = ((grown * before + drag * back_m) / (1.0 + grown)).min(before);
            let near = FOLLOWS * limit_n.max(1e-3 * before) + NO_TENSION_N;
            let follows = |now: f64, then: f64, friction: f64| {
                (now - then).abs() <= near || friction < now.min(then) - near
            };
            settled &= follows(limit_n, span.limit_n, span.friction_n);
            settled &= follows(lessens_n, passage.lessens_n, -span.friction_n);
            // What sticks without tension before it follows the first that comes: else bounds of none and of too much take turns.
            let slides = |grown: f64| if tension >= 0.0 { grown } else { 0.0 };
            let lessened = if lessens_n < before || drag == 0.0 {
                grown / (1.0 + grown)
            } else {
                1.0
            };
            passage.rates = [slides(lessened), slides(grown)];
            (passage.lessens_n, span.limit_n) = (lessens_n, limit_n);
        }
        settled
    }

    /// A balance is found: the thread has slid along its path, through its grips, up to the places `ends` on it \[m\], or is broken.
    pub fn finish(&mut self, part: &ThreadPart, is_held: bool, ends: [f64; 2]) {
        let is_taut = |segment: &Segment| segment.tension_n > NO_TENSION_N;
        if !self.segments.iter().any(is_taut) {
            self.state = ThreadTension::Slack;
            if is_held || self.has_hands() {
                // What a span lacks comes from where there is more.
                self.slide(part);
            }
            self.former.clone_from(&self.spans);
            return;
        }
        self.state = ThreadTension::Taut;
        let breaks = is_held && self.give_way(part, ends) || self.is_torn_by_hand(part);
        self.slide(part);
        if breaks {
            self.break_off();
        }
        self.former.clone_from(&self.spans);
    }

    /// What all of the path shares \[N\].
    pub(super) fn tension_at_tail(&self) -> f64 {
        self.segments.first().map_or(0.0, |first| {
            let before = first.piece.map_or(0.0, |piece| piece.share);
            let friction_n = self
                .spans
                .get(first.span)
                .map_or(0.0, |span| span.friction_n);
            first.tension_n - before * friction_n
        })
    }

    /// Thread that the first portion, whose tension at the tail is `shared`, takes beyond what there is of it, unstretched \[m\]; what is slack
    /// keeps what it has.
    pub(super) fn lacking_m(&self, part: &ThreadPart, shared: f64) -> f64 {
        let portion = self.portion(0);
        let taken = |place: usize| self.taken_m(part, place, &self.spans[place], 0.0);
        let taken_m: f64 = portion.clone().map(taken).sum();
        let bare_m = self.bare_m_per_n(part) * shared / stretch(part, shared);
        taken_m - bare_m - self.material_m(&portion)
    }

    /// Whether a span begins and ends at one point of tissue.
    fn is_point(&self, place: usize) -> bool {
        self.segments_of(place).is_empty()
    }

    /// Thread that a span takes, unstretched \[m\], when `gives` is drawn from it if it is slack.
    fn taken_m(&self, part: &ThreadPart, place: usize, span: &Span, gives: f64) -> f64 {
        if self.is_point(place) {
            return 0.0;
        }
        if self.is_taut(place) {
            let own = self.segments_of(place).iter();
            return own.map(|segment| segment.taken_m(part)).sum();
        }
        (span.material_m - gives).max(self.lengths_of(place))
    }

    fn is_taut(&self, place: usize) -> bool {
        let mut own = self.segments_of(place).iter();
        own.any(|segment| segment.tension_n > NO_TENSION_N)
    }

    /// Gives every span from the head, or a hand that tightens, on what it takes; what is left is before the first.
    fn slide(&mut self, part: &ThreadPart) {
        let mut shift = 0.0;
        let count = self.spans.len();
        let mut alpha = self.head.alpha;
        for place in (0..count).rev() {
            let span = self.spans[place];
            if let Some(to) = span.to.filter(|_| span.hand) {
                (shift, alpha) = (0.0, self.passed[to].crossing.alpha);
            }
            let mut taken = self.taken_m(part, place, &span, shift);
            let hand = place
                .checked_sub(1)
                .filter(|before| self.spans[*before].hand);
            if let Some(from) = span.from.filter(|_| hand.is_some()) {
                taken = alpha - self.passed[from].crossing.alpha;
            }
            if span.from.is_none() {
                taken = alpha - self.tail.alpha;
                self.pulled_m[0] += taken - span.material_m;
            }
            if span.to.is_none() {
                self.pulled_m[1] += taken - span.material_m;
            }
            if span.passage.is_some() {
                let slip = shift + self.slide_pieces(part, place, (alpha, taken));
                let before = self.former.iter().find(|former| former.key == span.key);
                let before = before.map_or(span.friction_n, |before| before.friction_n);
                self.friction_j += (0.5 * (span.friction_n + before) * slip).abs();
            }
            if self.head.by == ThreadHold::Knot
                && let Some(last) = self.passed.last_mut().filter(|_| place + 1 == count)
            {
                last.crossing.alpha = alpha;
            }
            alpha -= taken;
            shift += taken - span.material_m;
            self.spans[place].material_m = taken;
            if let Some(from) = span.from {
                self.passed[from].crossing.alpha = alpha;
            }
        }
    }

    /// Gives the pieces of a passage that ends at `alpha` and takes so much what each takes; how much has come over the
    /// friction within it \[m\].
    fn slide_pieces(
        &mut self,
        part: &ThreadPart,
        place: usize,
        (mut alpha, taken): (f64, f64),
    ) -> f64 {
        let mut slip = 0.0;
        let material_m = self.spans[place].material_m;
        let slack = taken / material_m.max(f64::MIN_POSITIVE);
        let is_taut = self.is_taut(place);
        let faces = self.passed.len();
        let own = self.range_of(place);
        for segment in self.segments[own].iter_mut().rev() {
            let own_m = segment.taken_m(part);
            let Some(piece) = &mut segment.piece else {
                continue;
            };
            let own_m = if is_taut {
                own_m
            } else {
                slack * piece.material_m
            };
            let times = own_m / piece.material_m.max(f64::MIN_POSITIVE);
            slip += piece.share * (own_m - piece.material_m);
            let begins = self.passed[piece.from].crossing.alpha;
            let upto = piece.to.unwrap_or(faces);
            for passed in &mut self.passed[piece.from + 1..upto] {
                let beyond = begins + piece.material_m - passed.crossing.alpha;
                passed.crossing.alpha = alpha - times * beyond;
            }
            piece.material_m = own_m;
            alpha -= own_m;
            // The first is its span's; the others begin pieces.
            if let Some(begins) = self.passed.get_mut(piece.from) {
                begins.crossing.alpha = alpha;
            }
        }
        slip
    }
}

impl Segment {
    /// Turn to the next one, as both pull \[rad\].
    fn turn_to(&self, next: &Self) -> f64 {
        let (a, b) = (self.pull(), next.pull());
        a.cross(&b).norm().atan2(a.dot(&b))
    }

    /// Thread that it takes, unstretched \[m\].
    fn taken_m(&self, part: &ThreadPart) -> f64 {
        self.path_m() / stretch(part, self.tension_n)
    }
}

/// Length over unstretched length.
fn stretch(part: &ThreadPart, tension_n: f64) -> f64 {
    1.0 + tension_n / part.through.axial_stiffness_n
}
