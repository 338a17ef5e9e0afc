//! What holds a thread's ends: pull, place and rows, for wrenches and tangents.
//!
//! Entry points: [`ThreadState::end`], [`ThreadState::pulls_on`] for bodies that spans lie on.

use super::lap::Obstacle;
use super::model::{ThreadEnd, ThreadPart};
use super::segments::{End, Segment, across};
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
    /// Its segment's own rows, so many of them, with their directions.
    own: [(usize, Vector3<f64>); 3],
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
        for (row, direction) in self.own.iter().take(self.count) {
            visit(*row, direction * self.sign);
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
        let rows = self.rows_of(segment, sign, part, is_held, first);
        Some((segment.force * -sign, at, rows))
    }

    /// Rows that an end of a segment has a part in, the second one if `sign` is 1, the first one if it is -1.
    fn rows_of(
        &self,
        segment: &Segment,
        sign: f64,
        part: &ThreadPart,
        is_held: bool,
        first: usize,
    ) -> EndRows {
        let mut rows = EndRows {
            sign,
            along: segment.along,
            bounds: (first, first),
            last: 1.0,
            own: [(0, Vector3::zeros()); 3],
            count: 0,
        };
        if let Some(own) = segment.first_row {
            let own = own as usize;
            (rows.own, rows.count) = match segment.leg {
                _ if segment.was_weld => {
                    let row = |axis: usize| (own + axis, Vector3::ith(axis, 1.0));
                    ([row(0), row(1), row(2)], 3)
                }
                None => {
                    let (u, v) = across(&segment.solved_along);
                    ([(own, u), (own + 1, v), (0, Vector3::zeros())], 2)
                }
                Some(leg) => {
                    let [away, beside] = leg.solved_across;
                    let axial = leg.axial_row.map_or(0, |row| first + row as usize);
                    let count = 1 + usize::from(leg.axial_row.is_some());
                    ([(own, away), (axial, beside), (0, Vector3::zeros())], count)
                }
            };
        }
        // Of its portion: its length, and the friction of passages before it, and in part of that in which it is.
        let portion = self.portion(segment.span);
        let before = self.portions().filter(|other| other.end <= portion.start);
        let before = before.map(|other| self.length_rows(part, is_held, &other));
        let before: usize = before.sum();
        let is_held = self.is_portion_held(&portion, is_held);
        let beyond = self.friction_rows(part, is_held, portion.start..segment.span + 1);
        if (is_held || beyond > 0) && !segment.was_weld {
            rows.bounds.0 = first + before;
            rows.bounds.1 = rows.bounds.0 + usize::from(is_held) + beyond;
            rows.along = segment.solved_along;
            rows.last = match segment.piece {
                Some(piece) if beyond > 0 => piece.share,
                _ => 1.0,
            };
        }
        rows
    }

    /// Pulls of spans on bodies that they lie on, with each the body, the straight piece at it, and where that has its other end \[m\].
    pub(super) fn pulls_on(
        &self,
        part: &ThreadPart,
        is_held: bool,
        first: usize,
    ) -> impl Iterator<Item = LegPull> {
        self.segments.iter().filter_map(move |segment| {
            let leg = segment.leg?;
            let sign = if leg.leaves { -1.0 } else { 1.0 };
            let far = segment.ends[usize::from(leg.leaves)];
            Some(LegPull {
                with: leg.with,
                force: segment.force * -sign,
                far_m: segment.far_m()?,
                rows: self.rows_of(segment, sign, part, is_held, first),
                way: match far {
                    End::Tissue(_) => Some((segment.place as usize, -sign)),
                    End::Held(_) => None,
                },
            })
        })
    }
}

/// The pull of a straight piece on a body that its span lies on.
pub(crate) struct LegPull {
    pub with: Obstacle,
    /// On the body \[N\].
    pub force: Vector3<f64>,
    /// Its other end \[m\]; of tissue the way that moves with it, and 1 or -1 for with or against.
    pub far_m: Vector3<f64>,
    pub way: Option<(usize, f64)>,
    pub rows: EndRows,
}
