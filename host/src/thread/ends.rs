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
            visit(row, self.along * self.sign);
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
            ThreadEnd::Head => (self.segments.last()?, 1.0),
        };
        let End::Held(at) = segment.ends[usize::from(sign > 0.0)] else {
            return None;
        };
        let mut rows = EndRows {
            sign,
            along: segment.along,
            bounds: (first, first),
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
        if is_held && !segment.was_weld {
            let rubbing = part.friction > 0.0 && end == ThreadEnd::Head;
            let beyond = if rubbing { self.spans.len() } else { 1 };
            rows.bounds.1 = first + beyond;
            rows.along = segment.solved_along;
        }
        Some((segment.force * -sign, at, rows))
    }
}
