//! What evolves about threads: which faces they go through, what holds their ends, how they pulled last.
//!
//! Entry point: [`ThreadState`]. Places on a thread are counted from its head at the needle: at most 0, as
//! alpha behind the needle's end (younes-2021, 3.3).

use super::Outside;
use super::gives::{GaveWay, LEFT_M};
use super::model::{
    MOST_BENDS, MOST_SEGMENTS, ThreadEnd, ThreadHold, ThreadPart, ThreadTension, Tightening,
};
use super::segments::{LENGTH_M, Segment, Span};
use crate::anchors::AnchorPoint;
use crate::mesh::HalfFaces;
use crate::needle::Crossing;
use nalgebra::Vector3;
use serde::Serialize;

/// Most faces that a thread goes through.
pub(crate) const MOST_PASSED: usize = 1024;

/// A face that the thread goes through.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Passed {
    pub crossing: Crossing,
    /// Whether there is tissue on one side only.
    pub is_boundary: bool,
    /// Names it.
    pub id: u32,
}

/// An end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Hold {
    pub by: ThreadHold,
    /// Where on the thread it is held \[m\].
    pub alpha: f64,
    /// Where that is \[m\].
    pub at: Vector3<f64>,
}

/// One thread.
#[derive(Debug, Default, PartialEq, Serialize)]
pub(crate) struct ThreadState {
    /// From tail to head.
    pub passed: Vec<Passed>,
    pub tail: Hold,
    pub head: Hold,
    /// Its path outside, from tail to head, as the last solve has it: straight segments, and what lies between
    /// two faces.
    pub segments: Vec<Segment>,
    pub spans: Vec<Span>,
    /// Spans as the last balance left them.
    pub former: Vec<Span>,
    /// Points of tissue that a span bends around, by the face that it begins at.
    pub bends: Vec<(u32, AnchorPoint)>,
    /// How short bridging spans have to be.
    pub tightened: Option<Tightening>,
    pub state: ThreadTension,
    /// Typical compliance of a segment \[m/N\]; 0 before the first solve.
    pub compliance: f64,
    /// Drawn out at tail and head so far \[m\].
    pub pulled_m: [f64; 2],
    pub friction_j: f64,
    next_id: u32,
    /// Where on the thread its tail ends \[m\].
    pub end_m: f64,
    /// Most tension at the tail with which grips hold and nothing breaks \[N\].
    pub bound_n: f64,
    /// What gives way at that.
    pub weakest: Weakest,
    /// Slipped through the grips at tail and head so far \[m\].
    pub slipped_m: [f64; 2],
    /// What has been broken off \[m\], if it has broken.
    pub broken_off_m: Option<f64>,
    pub gave_way: GaveWay,
}

/// What of a held thread gives way first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) enum Weakest {
    /// The grip at the tail.
    Tail,
    /// The grip at the head.
    Head,
    /// The thread itself.
    #[default]
    Thread,
}

/// With the same room, so that a step on a copy does not allocate either.
impl Clone for ThreadState {
    fn clone(&self) -> Self {
        let mut copy = Self {
            passed: Vec::with_capacity(self.passed.capacity()),
            segments: Vec::with_capacity(self.segments.capacity()),
            spans: Vec::with_capacity(self.spans.capacity()),
            former: Vec::with_capacity(self.former.capacity()),
            bends: Vec::with_capacity(self.bends.capacity()),
            ..Self::default()
        };
        copy.copy_from(self);
        copy
    }
}

impl ThreadState {
    /// A thread that nothing has drawn anywhere yet.
    pub fn new(part: &ThreadPart) -> Self {
        let hold = |alpha| Hold {
            by: ThreadHold::Free,
            alpha,
            at: Vector3::zeros(),
        };
        Self {
            passed: Vec::with_capacity(MOST_PASSED),
            tail: hold(-part.length_m),
            head: hold(0.0),
            segments: Vec::with_capacity(MOST_SEGMENTS),
            spans: Vec::with_capacity(MOST_SEGMENTS),
            former: Vec::with_capacity(MOST_SEGMENTS),
            bends: Vec::with_capacity(MOST_BENDS),
            tightened: None,
            state: ThreadTension::Slack,
            compliance: 0.0,
            pulled_m: [0.0; 2],
            friction_j: 0.0,
            next_id: 0,
            end_m: -part.length_m,
            bound_n: part.strength_n,
            weakest: Weakest::Thread,
            slipped_m: [0.0; 2],
            broken_off_m: None,
            gave_way: GaveWay::default(),
        }
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        let Self {
            passed,
            tail,
            head,
            segments,
            spans,
            former,
            bends,
            tightened,
            state,
            compliance,
            pulled_m,
            friction_j,
            next_id,
            end_m,
            bound_n,
            weakest,
            slipped_m,
            broken_off_m,
            gave_way,
        } = self;
        passed.clone_from(&other.passed);
        *tail = other.tail;
        *head = other.head;
        segments.clone_from(&other.segments);
        spans.clone_from(&other.spans);
        former.clone_from(&other.former);
        bends.clone_from(&other.bends);
        *tightened = other.tightened;
        *state = other.state;
        *compliance = other.compliance;
        *pulled_m = other.pulled_m;
        *friction_j = other.friction_j;
        *next_id = other.next_id;
        *end_m = other.end_m;
        *bound_n = other.bound_n;
        *weakest = other.weakest;
        *slipped_m = other.slipped_m;
        *broken_off_m = other.broken_off_m;
        *gave_way = other.gave_way;
    }

    /// The needle's end has gone through a face, `apart_m` from the one before: whether there is room. What lies
    /// between the two has been drawn in by the needle, up to this face.
    pub fn pass(&mut self, mesh: &HalfFaces, crossing: Crossing, apart_m: f64) -> bool {
        if self.passed.len() >= MOST_PASSED {
            return false;
        }
        self.next_id += 1;
        let is_boundary = crossing.from().is_none() || crossing.to(mesh).is_none();
        let alpha = crossing.alpha.min(0.0);
        if let Some(last) = self.passed.last() {
            let lacking = last.crossing.alpha + apart_m - alpha;
            if lacking > 0.0 {
                self.draw_in(lacking);
            }
        }
        self.passed.push(Passed {
            crossing: Crossing { alpha, ..crossing },
            is_boundary,
            id: self.next_id,
        });
        true
    }

    /// The needle's end has gone back through the last face.
    pub fn drop_last(&mut self) {
        self.passed.pop();
    }

    /// All that is in tissue slides towards the head, up to the hand on a span.
    pub fn draw(&mut self, by: f64) {
        let count = self.faces_of_path();
        for passed in &mut self.passed[..count] {
            passed.crossing.alpha -= by;
        }
    }

    /// What lies between the needle and a span that is held, or the tail, slides towards the needle.
    fn draw_in(&mut self, by: f64) {
        // A little is left before the hand, else a face would be on its other side.
        let held_m = self.head.alpha + LEFT_M;
        let beyond = match self.faces_of_path() {
            all if all == self.passed.len() => 0,
            beyond => beyond,
        };
        for passed in &mut self.passed[beyond..] {
            let least_m = if beyond > 0 {
                held_m
            } else {
                f64::NEG_INFINITY
            };
            passed.crossing.alpha = (passed.crossing.alpha - by).max(least_m);
        }
    }

    /// Faces that the tail has been drawn out of are forgotten.
    pub fn drop_behind(&mut self) {
        if self.tail.by != ThreadHold::Free {
            return;
        }
        let end = self.tail.alpha;
        let gone = self
            .passed
            .iter()
            .take_while(|passed| passed.crossing.alpha < end);
        let gone = gone.count();
        self.passed.drain(..gone);
    }

    /// Faces that the head has been drawn back out of are forgotten.
    pub fn drop_ahead(&mut self) {
        let end = self.head.alpha;
        while self
            .passed
            .last()
            .is_some_and(|last| last.crossing.alpha > end)
        {
            self.passed.pop();
        }
    }

    /// How many of the faces lie before what holds the head: others lie between a span that is held and the needle.
    pub fn faces_of_path(&self) -> usize {
        match self.head.by {
            ThreadHold::Place(_) | ThreadHold::Tool(_) => {
                let upto = self.head.alpha + LENGTH_M;
                let is_before = |passed: &Passed| passed.crossing.alpha <= upto;
                self.passed.partition_point(is_before)
            }
            _ => self.passed.len(),
        }
    }

    /// What lies between a span that is held and the needle slides towards the hand, if it has to: `way_m` from there to the next face.
    pub fn follow_hand(&mut self, way_m: f64) {
        let beyond = self.faces_of_path();
        let Some(next) = self.passed.get(beyond) else {
            return;
        };
        let lacking = way_m - (next.crossing.alpha - self.head.alpha);
        if lacking > 0.0 {
            for passed in &mut self.passed[beyond..] {
                passed.crossing.alpha = (passed.crossing.alpha + lacking).min(0.0);
            }
        }
    }

    /// Whether a hand holds the head beyond all faces, so that the path does not go on to the needle.
    pub fn is_apart(&self) -> bool {
        let is_held = matches!(self.head.by, ThreadHold::Place(_) | ThreadHold::Tool(_));
        is_held && self.faces_of_path() == self.passed.len()
    }

    /// Whether the tail withstands a pull.
    pub fn is_tail_held(&self) -> bool {
        self.tail.by != ThreadHold::Free
    }

    /// Faces with tissue on one side only.
    pub fn punctures(&self) -> u32 {
        self.passed
            .iter()
            .filter(|passed| passed.is_boundary)
            .count() as u32
    }

    /// Where on the thread a hand takes a span, which draws what it lacks from beyond \[m\].
    fn make_room(&mut self, outside: Option<Outside>) -> f64 {
        let Some(outside) = outside else {
            return 0.0;
        };
        let beyond = self.passed.get_mut(outside.faces..).unwrap_or_default();
        let alpha = if beyond.is_empty() {
            outside.along_m.min(0.0)
        } else {
            outside.along_m.min(-LEFT_M)
        };
        for passed in beyond {
            passed.crossing.alpha = passed.crossing.alpha.max(alpha + LEFT_M).min(0.0);
        }
        alpha
    }

    /// Gives an end another hold, at `at`; `near` is where the nearest face is, and `outside` where of a span, if that is held.
    pub fn hold(
        &mut self,
        end: ThreadEnd,
        by: ThreadHold,
        at: Vector3<f64>,
        (near, outside): (Vector3<f64>, Option<Outside>),
    ) {
        let alpha = match (end, by, self.passed.first(), self.passed.last()) {
            (ThreadEnd::Tail, ThreadHold::Place(_) | ThreadHold::Tool(_), Some(first), _) => {
                (first.crossing.alpha - (at - near).norm()).max(self.end_m)
            }
            (ThreadEnd::Tail, ..) => self.end_m,
            (ThreadEnd::Head, ThreadHold::Place(_) | ThreadHold::Tool(_), _, Some(last)) => {
                (last.crossing.alpha + (at - near).norm()).min(0.0)
            }
            (ThreadEnd::Span, ThreadHold::Place(_) | ThreadHold::Tool(_), ..) => {
                self.make_room(outside)
            }
            (ThreadEnd::Head | ThreadEnd::Span, ..) => 0.0,
        };
        let hold = Hold { by, alpha, at };
        match end {
            ThreadEnd::Tail => self.tail = hold,
            ThreadEnd::Head | ThreadEnd::Span => self.head = hold,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thread::Through;

    #[test]
    fn a_copy_has_the_room_of_what_it_copies() {
        let part = ThreadPart {
            id: 0,
            needle: 0,
            length_m: 0.1,
            friction: 0.0,
            strength_n: 1.0,
            through: Through::default(),
        };
        let state = ThreadState::new(&part);
        // Also in the place of one without.
        let mut other = ThreadState::default();
        other.clone_from(&state);
        for copy in [state.clone(), other] {
            assert_eq!(copy, state);
            assert!(copy.passed.capacity() >= MOST_PASSED);
            for room in [
                copy.segments.capacity(),
                copy.spans.capacity(),
                copy.former.capacity(),
            ] {
                assert!(room >= MOST_SEGMENTS, "{room}");
            }
            assert!(copy.bends.capacity() >= MOST_BENDS);
        }
    }
}
