//! What gives way where a thread is pulled harder than its grips and knots hold or it bears: it slips, its knot opens, or it breaks.
//!
//! Entry points: [`ThreadState::bind`] after each solve, [`ThreadState::give_way`] and [`ThreadState::break_off`] when a balance is
//! found, [`ThreadState::take_events`] for the report. Every length that comes or goes is an event: what there is of thread
//! between the holds is what there was and what has slipped in.

use super::model::{ThreadEnd, ThreadHold, ThreadPart, Through};
use super::segments::{LENGTH_M, NO_TENSION_N, Segment};
use super::state::{ThreadState, Weakest};
use super::through::FOLLOWS;
use crate::event::Event;
use serde::Serialize;

/// What is always left of a thread between a hand that it slips through and the next face \[m\].
pub(super) const LEFT_M: f64 = 4.0 * LENGTH_M;

/// What has given way since it was reported last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct GaveWay {
    /// At tail and head.
    slips: [Option<Slip>; 2],
    breaks: Option<Break>,
    /// Tension at which a knot opened \[N\].
    opens: Option<f64>,
    /// Where on the thread it was cut \[m\].
    cut_m: Option<f64>,
}

/// Through a grip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Slip {
    tool: u8,
    length_m: f64,
    /// Whether its end has come through.
    is_out: bool,
}

/// Of the thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Break {
    tension_n: f64,
    lost_m: f64,
}

impl GaveWay {
    /// So much has slipped through the grip that holds an end.
    fn slip(&mut self, end: usize, by: ThreadHold, length_m: f64, is_out: bool) {
        let ThreadHold::Tool(tool) = by else {
            return;
        };
        let before = self.slips[end].map_or(0.0, |slip| slip.length_m);
        self.slips[end] = Some(Slip {
            tool,
            length_m: before + length_m,
            is_out,
        });
    }

    /// It has been cut, there on the thread \[m\].
    pub(super) fn cut(&mut self, along_m: f64) {
        self.cut_m = Some(along_m);
    }

    /// A strand's events, which ends at `ends` of its thread.
    fn events(self, thread: u8, ends: [ThreadEnd; 2]) -> impl Iterator<Item = Event> {
        let slips = ends
            .into_iter()
            .zip(self.slips)
            .filter_map(move |(end, slip)| {
                let slip = slip?;
                Some(Event::Slipped {
                    thread,
                    end,
                    tool: slip.tool,
                    length_m: slip.length_m,
                    is_out: slip.is_out,
                })
            });
        let breaks = self.breaks.map(|torn| Event::Broke {
            thread,
            tension_n: torn.tension_n,
            lost_m: torn.lost_m,
        });
        let opens = self.opens;
        let opens = opens.map(|tension_n| Event::Opened { thread, tension_n });
        let cut = self.cut_m.map(|along_m| Event::Cut { thread, along_m });
        slips.chain(breaks).chain(opens).chain(cut)
    }
}

impl ThreadState {
    /// Most tension at the tail with which grips and knots hold and nothing breaks; whether it is as it was, or does not matter.
    pub(super) fn bind(&mut self, part: &ThreadPart, shared: f64) -> bool {
        let Through { grip_n, knot_n, .. } = part.through;
        // Up to the first hand that tightens, which holds what comes.
        let end = self.portion(0).end;
        let segments = self.segments.iter().filter(|segment| segment.span < end);
        // A grip withstands the difference of the tensions at both sides.
        let holds = |end: usize, hold: ThreadHold| match hold {
            ThreadHold::Tool(_) => grip_n + self.beyond_n[end],
            ThreadHold::Knot => knot_n,
            _ => f64::INFINITY,
        };
        let more = |segment: &Segment| segment.tension_n - shared;
        let most = segments.map(more).fold(0.0, f64::max);
        let at_head = self.segments.last().map_or(0.0, more);
        // The needle is too thick for a grip that holds the thread.
        let head_n = if self.head.alpha < 0.0 && !self.has_hands() {
            holds(1, self.head.by)
        } else {
            f64::INFINITY
        };
        let mut bound = (part.strength_n - most, Weakest::Thread);
        for (bound_n, weakest) in [
            (head_n - at_head, Weakest::Head),
            (holds(0, self.tail.by), Weakest::Tail),
        ] {
            if bound_n < bound.0 {
                bound = (bound_n, weakest);
            }
        }
        let bound_n = bound.0.max(0.0);
        let matters = shared >= bound_n.min(self.bound_n) - NO_TENSION_N;
        let follows = (bound_n - self.bound_n).abs() <= FOLLOWS * bound_n + NO_TENSION_N;
        (self.bound_n, self.weakest) = (bound_n, bound.1);
        follows || !matters
    }

    /// Lets the thread slip through a grip that does not hold it, of which there is as much as up to the places `ends` on the thread
    /// \[m\]; whether it is the thread that gives way.
    pub(super) fn give_way(&mut self, part: &ThreadPart, ends: [f64; 2]) -> bool {
        let shared = self.tension_at_tail();
        let lacking = self.lacking_m(part, shared);
        if lacking <= LENGTH_M || shared < self.bound_n - NO_TENSION_N {
            return false;
        }
        match self.weakest {
            Weakest::Thread => return true,
            Weakest::Tail if self.tail.by == ThreadHold::Knot => {
                self.tail.by = ThreadHold::Free;
                self.gave_way.opens = Some(shared);
            }
            Weakest::Head if self.head.by == ThreadHold::Knot => {
                self.head.by = ThreadHold::Free;
                let last = self.segments.last();
                self.gave_way.opens = last.map(|last| last.tension_n);
            }
            Weakest::Tail => {
                let slips = lacking.min(self.tail.alpha - ends[0]).max(0.0);
                self.tail.alpha -= slips;
                self.slipped_m[0] += slips;
                let is_out = slips < lacking && self.before.is_none();
                self.gave_way.slip(0, self.tail.by, slips, is_out);
                if is_out {
                    // Its end has come through.
                    self.tail.by = ThreadHold::Free;
                    self.tail.alpha = self.end_m;
                }
            }
            Weakest::Head => {
                let slips = lacking.min(ends[1] - self.head.alpha).max(0.0);
                self.head.alpha += slips;
                self.slipped_m[1] += slips;
                self.gave_way.slip(1, self.head.by, slips, false);
            }
        }
        false
    }

    /// The thread breaks where it is tensest. What is behind that is gone.
    pub(super) fn break_off(&mut self) {
        let mut tensest: Option<&Segment> = None;
        for segment in &self.segments {
            if tensest.is_none_or(|most| segment.tension_n > most.tension_n + NO_TENSION_N) {
                tensest = Some(segment);
            }
        }
        let from = tensest.and_then(|segment| match segment.piece {
            Some(piece) => Some(piece.from),
            None => self.spans.get(segment.span)?.from,
        });
        let tension_n = tensest.map_or(0.0, |most| most.tension_n);
        let at_m = from.map_or(self.tail.alpha, |from| self.passed[from].crossing.alpha);
        let begins_m = self.before.map_or(self.end_m, |_| self.tail.alpha);
        let lost_m = at_m - begins_m;
        self.broken_off_m = Some(self.broken_off_m.unwrap_or(0.0) + lost_m);
        self.gave_way.breaks = Some(Break { tension_n, lost_m });
        self.end_m = at_m;
        self.tail.by = ThreadHold::Free;
        self.tail.alpha = at_m;
    }

    /// What has given way since this was asked last; of the strand that is at the head, or another one.
    pub(super) fn take_events(
        &mut self,
        thread: u8,
        is_head: bool,
    ) -> impl Iterator<Item = Event> + use<> {
        let tail = self.before.map_or(ThreadEnd::Tail, |_| ThreadEnd::Span);
        let head = if is_head {
            ThreadEnd::Head
        } else {
            ThreadEnd::Span
        };
        std::mem::take(&mut self.gave_way).events(thread, [tail, head])
    }
}
