//! Friction of a thread at its passages through tissue: how far it turns there, and what that holds back.
//!
//! Entry points: [`ThreadState::pass_through`] before a balance, [`ThreadState::rub`] after each solve.

use super::model::ThreadPart;
use super::segments::NO_TENSION_N;
use super::state::ThreadState;
use crate::anchors::AnchorPoint;
use crate::mesh::HalfFaces;
use crate::needle::anchor;
use nalgebra::Vector3;

/// Bounds follow the tensions to this part of them.
const FRICTION: f64 = 1e-4;

impl ThreadState {
    /// Bounds of friction from the tensions; whether they are as they were.
    pub(super) fn rub(&mut self, part: &ThreadPart, shared: f64) -> bool {
        if part.friction == 0.0 {
            return true;
        }
        self.turn();
        let mut settled = true;
        let mut tension = shared;
        for place in 1..self.spans.len() {
            let span = &mut self.spans[place - 1];
            let next = tension + span.friction_n;
            let least = tension.min(next).max(0.0);
            let limit = ((part.friction * span.turn).exp() - 1.0) * least;
            // Nowhere more than its strength.
            let limit = limit.min(part.strength_n - least).max(0.0);
            settled &=
                (limit - span.limit_n).abs() <= FRICTION * limit.max(1e-3 * shared) + NO_TENSION_N;
            span.limit_n = limit;
            tension = next;
        }
        settled
    }

    /// Finds the ways through tissue, whose points are where `at` says, and how much the thread turns there.
    pub fn pass_through(&mut self, mesh: &HalfFaces, at: impl Fn(&AnchorPoint) -> Vector3<f64>) {
        for place in 1..self.spans.len() {
            let ends = [self.spans[place - 1].to, self.spans[place].from];
            let [Some(enters), Some(leaves)] = ends else {
                continue;
            };
            let point = |place: usize| at(&anchor(mesh, &self.passed[place].crossing));
            self.spans[place - 1].inside = point(leaves) - point(enters);
        }
        self.turn();
    }

    /// Turns at the passages through tissue, as the segments beside them pull now.
    fn turn(&mut self) {
        let angle = |a: &Vector3<f64>, b: &Vector3<f64>| a.cross(b).norm().atan2(a.dot(b));
        for pair in self.segments.windows(2) {
            let [before, after] = pair else {
                continue;
            };
            if before.span != after.span {
                let span = &mut self.spans[before.span];
                let inside = span.inside;
                span.turn = angle(&before.pull(), &inside) + angle(&inside, &after.pull());
            }
        }
    }
}
