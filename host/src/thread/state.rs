//! What evolves about strands of threads: which faces they go through, what holds their ends, how they pulled last.
//!
//! Entry point: [`ThreadState`]. A thread that no hand holds between its ends is one strand. Places on a thread are counted from its head at the needle: at most 0, as
//! alpha behind the needle's end (younes-2021, 3.3).

use super::gives::{GaveWay, LEFT_M};
use super::lap::{Lap, MOST_LAPS};
use super::model::{MOST_BENDS, MOST_SEGMENTS, ThreadHold, ThreadPart, ThreadTension, Tightening};
use super::segments::{Segment, Span};
use super::tighten::Drawn;
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
    /// Where that is \[m\], and in the frame of a tool that holds it.
    pub at: Vector3<f64>,
    pub on_tool: Vector3<f64>,
}

/// A strand: a thread, or what of it lies between two that hold it.
#[derive(Debug, Default, PartialEq, Serialize)]
pub(crate) struct ThreadState {
    /// Whether there is such a strand now.
    pub is_used: bool,
    /// The strand on the tail's side, if a hand is between.
    pub before: Option<usize>,
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
    /// Bodies that its spans lie on, or pass.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub laps: Vec<Lap>,
    /// How short hands make bridging spans, and what these have drawn out.
    pub tightened: Option<Tightening>,
    pub drawn: Vec<Drawn>,
    /// To which part of their length at rest bridging spans are drawn together, without thread.
    pub welded: Option<f64>,
    pub state: ThreadTension,
    /// Typical compliance of a segment \[m/N\]; 0 before the first solve.
    pub compliance: f64,
    /// Drawn out at tail and head so far \[m\].
    pub pulled_m: [f64; 2],
    pub friction_j: f64,
    next_id: u32,
    /// Where on the thread its tail ends \[m\], if no strand is before it.
    pub end_m: f64,
    /// Tension beyond what holds its tail and its head \[N\].
    pub beyond_n: [f64; 2],
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
            laps: Vec::with_capacity(self.laps.capacity()),
            drawn: Vec::with_capacity(self.drawn.capacity()),
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
            alpha,
            ..Hold::default()
        };
        Self {
            passed: Vec::with_capacity(MOST_PASSED),
            tail: hold(-part.length_m),
            head: hold(0.0),
            segments: Vec::with_capacity(MOST_SEGMENTS),
            spans: Vec::with_capacity(MOST_SEGMENTS),
            former: Vec::with_capacity(MOST_SEGMENTS),
            bends: Vec::with_capacity(MOST_BENDS),
            laps: Vec::with_capacity(2 * MOST_LAPS),
            tightened: None,
            drawn: Vec::with_capacity(MOST_SEGMENTS),
            welded: None,
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
            is_used: true,
            before: None,
            beyond_n: [0.0; 2],
        }
    }

    /// Room for another strand of a thread.
    pub fn unused(part: &ThreadPart) -> Self {
        Self {
            is_used: false,
            ..Self::new(part)
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
            laps,
            tightened,
            drawn,
            welded,
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
            is_used,
            before,
            beyond_n,
        } = self;
        *is_used = other.is_used;
        *before = other.before;
        *beyond_n = other.beyond_n;
        passed.clone_from(&other.passed);
        *tail = other.tail;
        *head = other.head;
        segments.clone_from(&other.segments);
        spans.clone_from(&other.spans);
        former.clone_from(&other.former);
        bends.clone_from(&other.bends);
        laps.clone_from(&other.laps);
        *tightened = other.tightened;
        drawn.clone_from(&other.drawn);
        *welded = other.welded;
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

    /// All that is in tissue slides towards the head.
    pub fn draw(&mut self, by: f64) {
        for passed in &mut self.passed {
            passed.crossing.alpha -= by;
        }
    }

    /// What lies between the needle and the tail, or the hand there, slides towards the needle.
    fn draw_in(&mut self, by: f64) {
        // A little is left before the hand, else a face would be on its other side.
        let least_m = match self.before {
            Some(_) => self.tail.alpha + LEFT_M,
            None => f64::NEG_INFINITY,
        };
        for passed in &mut self.passed {
            passed.crossing.alpha = (passed.crossing.alpha - by).max(least_m);
        }
    }

    /// All that is in tissue slides towards the tail, and out of it; up to the end, if a hand between the ends draws.
    pub fn draw_back(&mut self, by: f64) {
        let end = self.head.alpha;
        let is_stopped = self.goes_on();
        for passed in &mut self.passed {
            let alpha = passed.crossing.alpha + by;
            passed.crossing.alpha = if is_stopped { alpha.min(end) } else { alpha };
        }
        while self
            .passed
            .last()
            .is_some_and(|last| last.crossing.alpha > end)
        {
            self.passed.pop();
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

    /// Whether both ends withstand a pull; what holds the head `is_there`, or it is a knot, or the last hand that tightens.
    pub fn is_held(&self, is_there: bool) -> bool {
        self.is_tail_held() && (self.is_head_held(is_there) || self.has_hands())
    }

    /// The same of the head alone.
    pub fn is_head_held(&self, is_there: bool) -> bool {
        is_there || self.head.by == ThreadHold::Knot
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
            assert!(copy.laps.capacity() >= 2 * MOST_LAPS);
        }
    }
}
