//! What holds a thread's ends: pull, place and rows, for wrenches and tangents.
//!
//! Entry point: [`ThreadState::end`].

use super::model::{ThreadEnd, ThreadPart};
use super::segments::{End, across};
use super::state::ThreadState;
use nalgebra::Vector3;

/// Rows that an end of a thread has a part in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EndRows {
    /// 1 for the head, the second end of its segment, and -1 for the tail.
    sign: f64,
    along: Vector3<f64>,
    /// Rows that bound its length, from one to another.
    bounds: (usize, usize),
    /// Part of it in the last of these.
    last: f64,
    /// The first of its segment's own rows, and how many of these directions they have.
    own: usize,
    directions: [Vector3<f64>; 3],
    count: usize,
}

impl EndRows {
    /// Unit vector along which the end is pulled, or would be.
    pub fn pull(&self) -> Vector3<f64> {
        self.along * -self.sign
    }

    /// Rows, and by how much their target falls as the end moves.
    pub fn visit(&self, mut visit: impl FnMut(usize, Vector3<f64>)) {
        for row in self.bounds.0..self.bounds.1 {
            let is_last = row + 1 == self.bounds.1;
            let part = if is_last { self.last } else { 1.0 };
            visit(row, self.along * (self.sign * part));
        }
        for (axis, direction) in self.directions.iter().enumerate().take(self.count) {
            visit(self.own + axis, direction * self.sign);
        }
    }
}

impl ThreadState {
    /// Pull on an end that is held, the point that it is at, and its rows, if the first of those on several anchors is
    /// `first`; `None` for an end that is not.
    pub fn end(
        &self,
        end: ThreadEnd,
        part: &ThreadPart,
        is_held: bool,
        first: usize,
    ) -> Option<(Vector3<f64>, Vector3<f64>, EndRows)> {
        let (segment, sign) = match end {
            ThreadEnd::Tail => (self.segments.first()?, -1.0),
            ThreadEnd::Head | ThreadEnd::Span => (self.segments.last()?, 1.0),
        };
        let End::Held(at) = segment.ends[usize::from(sign > 0.0)] else {
            return None;
        };
        let mut rows = EndRows {
            sign,
            along: segment.along,
            bounds: (first, first),
            last: 1.0,
            own: 0,
            directions: [Vector3::x(), Vector3::y(), Vector3::z()],
            count: 0,
        };
        if let Some(own) = segment.first_row {
            rows.own = own as usize;
            rows.count = 3;
            if !segment.was_weld {
                let (u, v) = across(&segment.solved_along);
                rows.directions = [u, v, Vector3::zeros()];
                rows.count = 2;
            }
        }
        // Of the portion that it ends.
        let (before, portion) = match end {
            ThreadEnd::Tail => (0, self.portion(0)),
            ThreadEnd::Head | ThreadEnd::Span => {
                let last = self.portion(self.spans.len().saturating_sub(1));
                let before = self.portions().filter(|portion| portion.end < last.end);
                let rows = before.map(|portion| self.length_rows(part, is_held, &portion));
                (rows.sum(), last)
            }
        };
        let is_held = self.is_portion_held(&portion, is_held);
        let beyond = match end {
            ThreadEnd::Tail => 0,
            ThreadEnd::Head | ThreadEnd::Span => self.friction_rows(part, is_held, portion),
        };
        if (is_held || beyond > 0) && !segment.was_weld {
            rows.bounds.0 = first + before;
            rows.bounds.1 = rows.bounds.0 + usize::from(is_held) + beyond;
            rows.along = segment.solved_along;
            // The friction of the passage in which it ends acts before it in part.
            rows.last = match segment.piece {
                Some(piece) if beyond > 0 => piece.share,
                _ => 1.0,
            };
        }
        Some((segment.force * -sign, at, rows))
    }
}
