//! Hands that tighten spans: what `[[thread.tighten]]` stands for.
//!
//! Entry points: [`ThreadState::take_in`] before a balance, [`SourcesState::tighten_thread`] for the script. A hand holds the thread where a span
//! ends, seen from the tail, and draws out of that what there is of thread in it beyond a length. So the path comes in portions, from one hand to the next,
//! of which each has one length, a tension and friction of its own. What a hand has drawn out is no part of the path, and is counted.

use super::model::{ThreadPart, Tightening};
use super::segments::{LENGTH_M, Span};
use super::state::ThreadState;
use crate::step::SourcesState;
use serde::Serialize;
use std::ops::Range;

/// A hand draws so much of what is taut in one balance, at most \[m\]: 40 mm/s at 200 Hz.
const DRAWS_M: f64 = 2e-4;

/// What a hand has drawn out of its span.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Drawn {
    /// The face that its span begins at.
    pub key: u32,
    pub length_m: f64,
}

impl ThreadState {
    /// Whether hands have spans of it.
    pub fn has_hands(&self) -> bool {
        self.spans.iter().any(|span| span.hand)
    }

    /// The spans from one hand to the next, or to an end of the path, of which `place` is one.
    pub(super) fn portion(&self, place: usize) -> Range<usize> {
        let hand = |span: &Span| span.hand;
        let (before, after) = self.spans.split_at(place);
        let begin = before.iter().rposition(hand).map_or(0, |hand| hand + 1);
        let end = after.iter().position(hand);
        begin..end.map_or(self.spans.len(), |hand| place + hand + 1)
    }

    /// All portions, from the tail on.
    pub(super) fn portions(&self) -> impl Iterator<Item = Range<usize>> + use<'_> {
        let mut next = 0;
        std::iter::from_fn(move || {
            let portion = (next < self.spans.len()).then(|| self.portion(next))?;
            next = portion.end;
            Some(portion)
        })
    }

    /// Most tension at the beginning of a portion with which nothing gives way \[N\]: a hand that tightens holds the thread until that breaks.
    pub(super) fn most_n(&self, part: &ThreadPart, portion: &Range<usize>) -> f64 {
        match portion.start {
            0 => self.bound_n,
            _ => part.strength_n,
        }
    }

    /// Whether both ends of a portion withstand a pull, if those of the whole do, or not.
    pub(super) fn is_portion_held(&self, portion: &Range<usize>, is_held: bool) -> bool {
        is_held || portion.start > 0
    }

    /// Whether its path ends at a hand that tightens, as nothing holds its head.
    pub fn ends_at_hand(&self) -> bool {
        let last = self.spans.last();
        last.is_some_and(|last| last.hand && last.to.is_some())
    }

    /// Drawn in by all hands \[m\].
    pub fn drawn_m(&self) -> f64 {
        // Not -0, which a sum of nothing is.
        self.drawn.iter().map(|drawn| drawn.length_m).sum::<f64>() + 0.0
    }

    /// Whether hands draw at it harder than it bears.
    pub(super) fn is_torn_by_hand(&self, part: &ThreadPart) -> bool {
        let mut tensions = self.segments.iter().map(|segment| segment.tension_n);
        self.has_hands() && tensions.any(|tension_n| tension_n > part.strength_n)
    }

    /// Hands take, or have, the spans of a path that has just been laid, and take in what is too much of those; how much that is \[m\]. Beyond the last of
    /// them a thread whose head nothing holds is slack, and has no path.
    pub(super) fn take_in(&mut self, is_head_held: bool) -> f64 {
        let Some(tightened) = self.tightened else {
            return 0.0;
        };
        let count = self.spans.iter().filter(|span| span.bridges).count();
        let (mut place, mut last, mut all_m) = (0, None, 0.0);
        for index in 0..self.spans.len() {
            let span = self.spans[index];
            if !span.bridges {
                continue;
            }
            if tightened.has_begun(place, count) {
                self.spans[index].hand = true;
                let length_m = tightened.of(place, count) * span.rest_m;
                all_m += self.take_from(index, length_m, tightened.most_n);
                last = Some(index);
            }
            place += 1;
        }
        if let Some(last) = last.filter(|_| !is_head_held) {
            self.spans.truncate(last + 1);
            self.segments.retain(|segment| segment.span <= last);
        }
        all_m
    }

    /// A hand takes in what a span has beyond `length_m`, as long as that has no more tension than `most_n`, or gives of what it has what that
    /// lacks; how much \[m\].
    fn take_from(&mut self, index: usize, length_m: f64, most_n: f64) -> f64 {
        let own = self.segments_of(index).first();
        let tension_n = own.map_or(0.0, |segment| segment.tension_n);
        let slack_m = (self.spans[index].material_m - self.lengths_of(index)).max(0.0);
        let most_m = slack_m + if tension_n < most_n { DRAWS_M } else { 0.0 };
        let Span {
            key,
            from,
            material_m,
            ..
        } = self.spans[index];
        let place = self.drawn.iter().position(|drawn| drawn.key == key);
        let place = place.unwrap_or_else(|| {
            let length_m = 0.0;
            self.drawn.push(Drawn { key, length_m });
            self.drawn.len() - 1
        });
        let drawn = &mut self.drawn[place].length_m;
        let more_m = (material_m - length_m).min(most_m).max(-*drawn);
        // True lengths are held this well.
        if more_m.abs() <= LENGTH_M {
            return 0.0;
        }
        *drawn += more_m;
        self.spans[index].material_m -= more_m;
        let upto = from.map_or(0, |from| from + 1);
        self.move_tail(upto, more_m);
        more_m
    }

    /// What is before the face at that place, and the tail, comes nearer to the head along the thread.
    fn move_tail(&mut self, upto: usize, by_m: f64) {
        for passed in &mut self.passed[..upto] {
            passed.crossing.alpha += by_m;
        }
        self.tail.alpha += by_m;
        self.end_m += by_m;
    }

    /// Hands give back what they have drawn out of it; how much \[m\].
    fn give_back(&mut self) -> f64 {
        let given_m = self.drawn_m();
        while let Some(Drawn { key, length_m }) = self.drawn.pop() {
            let upto = self.passed.iter().take_while(|passed| passed.id <= key);
            let upto = upto.count();
            self.move_tail(upto, -length_m);
        }
        given_m
    }
}

impl SourcesState {
    /// See [`crate::step::State::tighten`].
    pub fn tighten_thread(&mut self, thread: usize, to: Option<Tightening>) {
        for strand in self.strands(thread).iter() {
            self.threads[strand].tightened = to;
            if to.is_none() {
                let given_m = self.threads[strand].give_back();
                self.move_before(strand, -given_m);
            }
        }
    }

    /// All strands before another one come nearer to the head along the thread.
    pub(super) fn move_before(&mut self, strand: usize, by_m: f64) {
        if by_m == 0.0 {
            return;
        }
        let mut next = self.threads[strand].before;
        while let Some(strand) = next {
            let before = &mut self.threads[strand];
            before.move_tail(before.passed.len(), by_m);
            before.head.alpha += by_m;
            next = before.before;
        }
    }
}
