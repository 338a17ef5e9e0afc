//! The strands of threads: a hand between the ends of a thread divides it, and joins it again when it lets go; so does a cut, for good.
//!
//! Entry points: [`SourcesState::hold_thread`], [`SourcesState::cut_thread`], [`SourcesState::strands`]. Each strand has a length, a tension and friction of its own, and
//! ends of which each is held or free, so that all that is known of a thread with two ends holds for it. What a hand does not hold slips
//! from one strand into the next.

use super::gives::LEFT_M;
use super::model::{MAX_STRANDS, MOST_HANDS, ThreadEnd, ThreadHold};
use super::nearest_outside;
use super::report::place_of;
use super::segments::LENGTH_M;
use super::state::{Hold, ThreadState};
use crate::needle::anchor;
use crate::step::{Sources, SourcesState};
use nalgebra::{Isometry3, Vector3};

/// Where a hand takes a thread.
#[derive(Clone, Copy, Debug)]
struct Place {
    strand: usize,
    /// Faces of the strand before it.
    faces: usize,
    /// Where it is on the thread \[m\].
    along_m: f64,
    /// Where the hand has it \[m\].
    held: Vector3<f64>,
}

/// Some strands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strands {
    places: [usize; MAX_STRANDS],
    count: usize,
}

impl Strands {
    /// From tail to head.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = usize> + use<> {
        let Self { places, count } = *self;
        (0..count).rev().map(move |place| places[place])
    }

    /// The last before the needle of which a hand leaves something: where only the needle is beyond the hand, the hand has the head.
    pub fn head(&self, each: &[ThreadState]) -> usize {
        let [led, before] = [self.places[0], self.places[1]];
        if self.count > 1 && each[led].passed.is_empty() && each[led].is_tail_in_hand() {
            before
        } else {
            led
        }
    }
}

impl ThreadHold {
    /// Whether it is at a place.
    pub(super) fn is_hand(self) -> bool {
        matches!(self, Self::Place(_) | Self::Tool(_))
    }
}

impl ThreadState {
    /// Whether a hand holds its tail.
    pub fn is_tail_in_hand(&self) -> bool {
        self.tail.by.is_hand()
    }

    /// Whether it goes on in the strand before it.
    pub fn goes_on(&self) -> bool {
        self.before.is_some() && self.is_tail_in_hand()
    }

    /// Another hold of its tail, at `at`; `near` is where its first face is.
    fn hold_tail(&mut self, by: ThreadHold, at: Vector3<f64>, near: Option<Vector3<f64>>) {
        let alpha = match (by.is_hand(), self.passed.first(), near) {
            (true, Some(first), Some(near)) => {
                (first.crossing.alpha - (at - near).norm()).max(self.end_m)
            }
            _ => self.end_m,
        };
        self.tail = Hold {
            by,
            alpha,
            at,
            ..Hold::default()
        };
    }

    /// All up to the hand goes to `other`, which was not used; the rest stays.
    fn divide(&mut self, other: &mut Self, faces: usize, hand: Hold) {
        other.is_used = true;
        (other.before, other.tail, other.head) = (self.before, self.tail, hand);
        (other.end_m, other.bound_n) = (self.end_m, self.bound_n);
        (other.tightened, other.welded) = (self.tightened, self.welded);
        other.pulled_m = [self.pulled_m[0], 0.0];
        other.slipped_m = [self.slipped_m[0], 0.0];
        (other.friction_j, other.broken_off_m) = (0.0, None);
        other.compliance = self.compliance;
        other.passed.clear();
        other.passed.extend(self.passed.drain(..faces));
        // What is known of the path.
        let last = other.passed.last().map_or(0, |last| last.id);
        let is_own = |key: u32| key <= last;
        move_over(&mut self.segments, &mut other.segments, |one| {
            is_own(one.key.0)
        });
        move_over(&mut self.former, &mut other.former, |one| is_own(one.key));
        move_over(&mut self.bends, &mut other.bends, |one| is_own(one.0));
        other.bends.retain(|(key, _)| *key < last);
        self.divide_laps(other, last);
        move_over(&mut self.drawn, &mut other.drawn, |one| is_own(one.key));
        self.spans.clear();
        other.spans.clear();
        self.tail = hand;
        (self.pulled_m[0], self.slipped_m[0]) = (0.0, 0.0);
        // A little is left before the next face.
        for passed in &mut self.passed {
            passed.crossing.alpha = passed.crossing.alpha.max(hand.alpha + LEFT_M).min(0.0);
        }
    }

    /// The strand before it, whose head was in the same hand, becomes part of it.
    fn join(&mut self, other: &mut Self) {
        other.is_used = false;
        (self.before, self.tail, self.end_m) = (other.before, other.tail, other.end_m);
        self.pulled_m[0] = other.pulled_m[0];
        self.slipped_m[0] = other.slipped_m[0];
        self.friction_j += other.friction_j;
        if let Some(lost_m) = other.broken_off_m.take() {
            self.broken_off_m = Some(self.broken_off_m.unwrap_or(0.0) + lost_m);
        }
        let last = other.passed.last().map_or(0, |last| last.id);
        prepend(&mut self.passed, &mut other.passed);
        self.former.retain(|span| span.key > 0);
        prepend(&mut self.former, &mut other.former);
        self.segments.retain(|segment| segment.key.0 > 0);
        prepend(&mut self.segments, &mut other.segments);
        self.bends.retain(|(key, _)| *key > 0);
        prepend(&mut self.bends, &mut other.bends);
        self.join_laps(other, last);
        prepend(&mut self.drawn, &mut other.drawn);
        self.spans.clear();
        other.spans.clear();
    }
}

/// Moves some to the place of all others there.
fn move_over<T: Copy>(list: &mut Vec<T>, to: &mut Vec<T>, which: impl Fn(&T) -> bool) {
    to.clear();
    to.extend(list.iter().filter(|one| which(one)));
    list.retain(|one| !which(one));
}

/// Puts all of `before` in front.
fn prepend<T>(list: &mut Vec<T>, before: &mut Vec<T>) {
    before.append(list);
    std::mem::swap(list, before);
}

impl SourcesState {
    /// The strands of a thread.
    pub fn strands(&self, thread: usize) -> Strands {
        let mut strands = Strands {
            places: [0; MAX_STRANDS],
            count: 0,
        };
        let mut next = Some(thread).filter(|thread| *thread < self.threads.len());
        while let (Some(strand), true) = (next, strands.count < MAX_STRANDS) {
            strands.places[strands.count] = strand;
            strands.count += 1;
            next = self.threads[strand].before;
        }
        strands
    }

    /// The strand before another one, beyond the hand that holds its tail.
    fn strand_before(&self, strand: usize) -> Option<usize> {
        let each = &self.threads[strand];
        each.before.filter(|_| each.goes_on())
    }

    /// The strand behind another one, beyond the hand that holds its head.
    fn strand_after(&self, strand: usize) -> Option<usize> {
        let is_next = |each: &ThreadState| each.before == Some(strand) && each.goes_on();
        let mut each = self.threads.iter();
        each.position(|each| each.is_used && is_next(each))
    }

    /// Up to where on the thread a strand could slip out of what holds its ends \[m\]: a little before the faces beyond.
    pub fn reach_m(&self, strand: usize) -> [f64; 2] {
        let end_m = self.threads[strand].end_m;
        let tail_m = self.strand_before(strand).map_or(end_m, |before| {
            let before = &self.threads[before];
            let last = before.passed.last().map(|last| last.crossing.alpha);
            last.unwrap_or(before.tail.alpha) + LEFT_M
        });
        let head_m = self.strand_after(strand).map_or(0.0, |after| {
            let after = &self.threads[after];
            let first = after.passed.first().map(|first| first.crossing.alpha);
            first.map_or(after.head.alpha, |first| first - LEFT_M)
        });
        [tail_m, head_m]
    }

    /// What has slipped out of one end of a strand has come to the next one.
    pub fn share_slips(&mut self, strand: usize) {
        let (tail, head) = (self.threads[strand].tail, self.threads[strand].head);
        if let Some(before) = self.strand_before(strand) {
            self.threads[before].head.alpha = tail.alpha;
        }
        if let Some(after) = self.strand_after(strand) {
            self.threads[after].tail.alpha = head.alpha;
        }
    }

    /// Tells a strand the tensions beyond its ends.
    pub fn look_beyond(&mut self, strand: usize) {
        let before = self.strand_before(strand);
        let before = before.and_then(|before| self.threads[before].segments.last());
        let after = self.strand_after(strand);
        let after = after.and_then(|after| self.threads[after].segments.first());
        let beyond_n = [before, after].map(|end| end.map_or(0.0, |end| end.tension_n));
        self.threads[strand].beyond_n = beyond_n;
    }

    /// See [`crate::step::State::hold_thread`]; `pose` is that of what holds it, if it has a place.
    pub fn hold_thread(
        &mut self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
        end: ThreadEnd,
        by: ThreadHold,
        pose: Option<Isometry3<f64>>,
    ) -> bool {
        if thread >= sources.threads.parts.len() {
            return false;
        }
        let pose = pose.unwrap_or_default();
        let at = pose.translation.vector;
        if end == ThreadEnd::Tail {
            if matches!(by, ThreadHold::Without(_)) {
                return false;
            }
            let first = self.strands(thread).iter().next().unwrap_or(thread);
            let near = self.threads[first].passed.first();
            let near = near.map(|near| place_of(nodes_m, &anchor(&sources.mesh, &near.crossing)));
            self.threads[first].hold_tail(by, at, near);
            return true;
        }
        match by {
            ThreadHold::Knot => return false,
            ThreadHold::Free => {
                self.let_go(thread, |_| true);
                return true;
            }
            ThreadHold::Without(tool) => {
                self.let_go(thread, |held| held == ThreadHold::Tool(tool));
                return true;
            }
            ThreadHold::Tool(_) => self.let_go(thread, |held| held == by),
            ThreadHold::Place(_) => {}
        }
        // The head has one holder.
        let strands = self.strands(thread);
        let head = strands.head(&self.threads);
        if end == ThreadEnd::Head && head != thread {
            let before = self.threads[head].head.by;
            self.let_go(thread, |held| held == before);
        }
        let place = match end {
            ThreadEnd::Span => self.nearest_span(sources, nodes_m, thread, &at),
            _ => self.head_span(sources, nodes_m, thread, &at),
        };
        let hands = self.threads.iter().filter(|strand| strand.goes_on());
        if hands.count() >= MOST_HANDS {
            return false;
        }
        let (Some(place), Some(room)) = (place, self.room(sources, thread)) else {
            return false;
        };
        let hold = Hold {
            by,
            alpha: place.along_m,
            at: place.held,
            on_tool: pose.inverse_transform_point(&place.held.into()).coords,
        };
        self.split(place, room, hold);
        true
    }

    /// Copies of a thread as if no hand held it between its ends, of all that is whole.
    pub fn joined(&self, thread: usize) -> Vec<ThreadState> {
        let mut whole: Vec<ThreadState> = Vec::new();
        for strand in self.strands(thread).iter() {
            let mut each = self.threads[strand].clone();
            if let Some(mut before) = whole.pop_if(|_| each.goes_on()) {
                each.join(&mut before);
            }
            whole.push(each);
        }
        whole
    }

    /// See [`crate::step::State::cut_thread`].
    pub fn cut_thread(
        &mut self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
        at: &Vector3<f64>,
        knots: bool,
    ) -> bool {
        let place = self.nearest_span(sources, nodes_m, thread, at);
        let (Some(place), Some(room)) = (place, self.room(sources, thread)) else {
            return false;
        };
        let loose = |alpha: f64| Hold {
            alpha,
            ..Hold::default()
        };
        self.split(place, room, loose(place.along_m));
        let [before, after] = [room, place.strand];
        self.threads[after].end_m = place.along_m;
        self.threads[after].gave_way.cut(place.along_m);
        if knots {
            // What is between the tissue and the cut is the knot's own.
            if let Some(last) = self.threads[before].passed.last() {
                let alpha = last.crossing.alpha;
                self.threads[before].head = Hold {
                    by: ThreadHold::Knot,
                    ..loose(alpha)
                };
            }
            self.threads[after].tail.by = ThreadHold::Knot;
        }
        true
    }

    /// A strand of a thread that is not used.
    pub fn room(&self, sources: &Sources, thread: usize) -> Option<usize> {
        let mut rooms = sources.threads.parts.len()..self.threads.len();
        rooms.find(|strand| {
            !self.threads[*strand].is_used && sources.threads.thread_of(*strand) == thread
        })
    }

    /// All of a strand up to there becomes another one.
    fn split(&mut self, place: Place, room: usize, hold: Hold) {
        let mut other = std::mem::take(&mut self.threads[room]);
        self.threads[place.strand].divide(&mut other, place.faces, hold);
        self.threads[room] = other;
        self.threads[place.strand].before = Some(room);
    }

    /// Hands between the ends of a thread let go.
    fn let_go(&mut self, thread: usize, whose: impl Fn(ThreadHold) -> bool) {
        let mut strand = thread;
        while let Some(before) = self.threads[strand].before {
            let (hand, goes_on) = (self.threads[before].head.by, self.threads[strand].goes_on());
            if !hand.is_hand() || !whose(hand) {
                strand = before;
                continue;
            }
            if !goes_on {
                // It is torn beyond the hand.
                self.threads[before].head.by = ThreadHold::Free;
                strand = before;
                continue;
            }
            let mut other = std::mem::take(&mut self.threads[before]);
            self.threads[strand].join(&mut other);
            self.threads[before] = other;
        }
    }

    /// Where a hand at `at` takes a span: where that is nearest, with what the way there lacks from the side of the head.
    fn nearest_span(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
        at: &Vector3<f64>,
    ) -> Option<Place> {
        let mut nearest: Option<(f64, Place)> = None;
        for strand in self.strands(thread).iter() {
            let path = self.strand_places(sources, nodes_m, strand);
            let is_held = self.is_end_held(sources, strand);
            let Some(outside) = nearest_outside(&path, at, is_held) else {
                continue;
            };
            let far_m = outside.at.metric_distance(at);
            if nearest.is_none_or(|(least_m, _)| far_m < least_m) {
                let most_m = if outside.faces < self.threads[strand].passed.len() {
                    self.threads[strand].head.alpha - LEFT_M
                } else {
                    self.threads[strand].head.alpha
                };
                let place = Place {
                    strand,
                    faces: outside.faces,
                    along_m: outside.along_m.min(most_m),
                    held: outside.held,
                };
                nearest = Some((far_m, place));
            }
        }
        nearest.map(|(_, place)| place)
    }

    /// Whether the end of a strand on the side of the head withstands a pull.
    fn is_end_held(&self, sources: &Sources, strand: usize) -> bool {
        let needle = &self.each[sources.threads.needle_of(strand)];
        let is_led = sources.threads.is_led(strand);
        self.threads[strand].is_head_held(is_led && needle.grip.is_some())
            || self.threads[strand].head.by.is_hand()
    }

    /// Where a hand at `at` takes the head: without slack behind the last face, or before the needle if there is none; where that is too
    /// far from the needle in another hand as a span.
    fn head_span(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
        at: &Vector3<f64>,
    ) -> Option<Place> {
        let led = self.threads.get(thread)?;
        let path = self.strand_places(sources, nodes_m, thread);
        let is_held = self.is_end_held(sources, thread);
        let end_m = Vector3::from(path.last()?.at_m).metric_distance(at);
        let needed_m = if is_held { end_m } else { 0.0 };
        let along_m = match led.passed.last() {
            Some(last) => {
                let near = place_of(nodes_m, &anchor(&sources.mesh, &last.crossing));
                (last.crossing.alpha + at.metric_distance(&near)).min(0.0)
            }
            None => (-needed_m).max(led.tail.alpha),
        };
        if along_m + needed_m > LENGTH_M {
            return self.nearest_span(sources, nodes_m, thread, at);
        }
        Some(Place {
            strand: thread,
            faces: led.passed.len(),
            along_m,
            held: *at,
        })
    }
}
