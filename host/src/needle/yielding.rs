//! Needles that give way in a solve, as rigid bodies: those that fall, and those on which bodies of grips press while nobody holds them.
//!
//! Entry points: [`Yielding`]; [`Balance::let_yield`] before a solve, [`Balance::give_way`] after it. With x* where it would be without
//! forces and D what takes it from there (a mass over the square of a step, or next to nothing), a needle is at x with
//! `D (x - x*) = J' lambda`. Its rows are linearised where the last solve had it, x0: their targets go on by `J (x* - x0)`, and the
//! compliance has `J / D J'` in it, so that nothing but J is off, and that not at x0.

use super::loose::DRAG;
use crate::step::Balance;
use crate::thread::Obstacle;
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};

/// Solves of a round to which a needle gives way: what has not settled by then stays where it is.
const SOLVES: u32 = 16;
/// It is known well enough where it changes by less than this part of its length \[1\], and where a hand feels it by a body. One that slides
/// on a surface comes nearer by a tenth in each solve, and goes on in the next balance.
const SETTLED: f64 = 1e-5;
const FELT: f64 = 1e-9;

/// A needle that gives way, in one balance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Yielding {
    /// Where it would be without forces, and where the last solve had it.
    free: Isometry3<f64>,
    last: Isometry3<f64>,
    /// What takes it along and about each axis by one \[N/m, N m/rad\].
    inertia: Vector6<f64>,
    /// Solves to which it gives way.
    solves_left: u32,
    /// What it turns about in this solve \[m\], and what takes it from there to where it would be without forces; nothing if it does not
    /// give way to that.
    free_by: Option<(Vector3<f64>, Vector6<f64>)>,
}

/// Where a body may press on a needle that gives way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Push {
    pub needle: usize,
    /// Of the present rows.
    pub row: usize,
    /// On the needle \[m\].
    pub at_m: Vector3<f64>,
    /// What the force on it is per force of the row.
    pub direction: Vector3<f64>,
    /// As far both are apart \[m\].
    pub apart_m: f64,
    /// Compliance of the two \[m/N\].
    pub gives_m_per_n: f64,
}

impl Yielding {
    /// One that would be at `free`.
    fn to(free: Isometry3<f64>, inertia: Vector6<f64>) -> Self {
        Self {
            free,
            last: free,
            inertia,
            solves_left: 0,
            free_by: None,
        }
    }
}

impl Balance<'_> {
    /// How a needle gives way in the balance to come, without forces at `free`, if it does.
    pub(super) fn yielding(&self, needle: usize, free: &Isometry3<f64>) -> Option<Yielding> {
        let (part, state) = (&self.sources.needles[needle], &self.state.each[needle]);
        if state.grip.is_some() {
            return None;
        }
        let fall_s = self.work.needles.fall_s;
        let falls = fall_s > 0.0 && state.falls(part);
        let pushed_n_per_m = self.pushed_by(needle);
        if !falls && pushed_n_per_m == 0.0 {
            return None;
        }
        let (along, length_m) = (DRAG * pushed_n_per_m, part.needle.shape.length_m());
        let about = along * length_m * length_m / 12.0;
        let drag = Vector6::new(along, along, along, about, about, about);
        let inertia = part.inertia(fall_s).filter(|_| falls).unwrap_or(drag);
        Some(Yielding::to(*free, inertia))
    }

    /// Before the solves of a round.
    pub(super) fn begin_to_yield(&mut self) {
        for yielding in self.work.needles.yielding.iter_mut().flatten() {
            yielding.solves_left = SOLVES;
        }
    }

    /// Before a solve: where it has what gives way to it.
    pub(super) fn let_yield(&mut self) {
        let mut pushes = std::mem::take(&mut self.work.needles.pushes);
        pushes.clear();
        for needle in 0..self.state.each.len() {
            let Some(mut yielding) = self.work.needles.yielding[needle] else {
                continue;
            };
            yielding.free_by = None;
            if yielding.solves_left > 0 {
                let (part, pose) = (&self.sources.needles[needle], self.state.each[needle].pose);
                let [centre, free] = [&pose, &yielding.free].map(|pose| part.centre(pose));
                let turn = yielding.free.rotation * pose.rotation.inverse();
                let (way, turn) = (free - centre, turn.scaled_axis());
                let by = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
                yielding.last = pose;
                yielding.free_by = Some((centre, by));
                self.find_pushes(needle, |push| pushes.push(push));
            }
            self.work.needles.yielding[needle] = Some(yielding);
        }
        self.work.needles.pushes = pushes;
    }

    /// What takes a needle in this solve to where it would be without forces, if it gives way to that.
    pub(super) fn free_by(&self, needle: usize) -> Option<Vector6<f64>> {
        Some(self.work.needles.yielding[needle]?.free_by?.1)
    }

    /// What a needle that gives way in this solve turns about, and what it withstands.
    pub(super) fn yields(&self, needle: usize) -> Option<(Vector3<f64>, Vector6<f64>)> {
        let yielding = self.work.needles.yielding[needle]?;
        Some((yielding.free_by?.0, yielding.inertia))
    }

    /// After a solve: what yields gives way to it; whether all is where it was before.
    pub(super) fn give_way(&mut self) -> bool {
        let mut settled = true;
        for needle in 0..self.state.each.len() {
            let Some(yielding) = &mut self.work.needles.yielding[needle] else {
                continue;
            };
            if yielding.solves_left == 0 {
                continue;
            }
            yielding.solves_left -= 1;
            let (last, is_last) = (yielding.last, yielding.solves_left == 0);
            let free_by = yielding.free_by;
            if let (Some(drag), Some((_, by))) = (self.work.needles.drags[needle], free_by) {
                self.push_loose(needle, &drag, &by);
            }
            let needle_of = &self.sources.needles[needle].needle;
            let [before, after] =
                [&last, &self.state.each[needle].pose].map(|pose| needle_of.at(pose));
            let length_m = before.length;
            let moved =
                |along: f64| (after.at(along * length_m) - before.at(along * length_m)).norm();
            let mut pushes = self.work.needles.pushes.iter();
            let within = match pushes.any(|push| push.needle == needle) {
                true => FELT,
                false => SETTLED,
            };
            settled &= is_last
                || [0.0, 0.5, 1.0]
                    .into_iter()
                    .all(|along| moved(along) <= within * length_m);
        }
        settled
    }

    /// The balance is found: everything is where it is.
    pub(super) fn end_to_yield(&mut self) {
        for yielding in self.work.needles.yielding.iter_mut().flatten() {
            yielding.solves_left = 0;
        }
    }

    /// Whether a needle gave way in the last solve that a body may press on from where it is.
    pub(crate) fn responds(&self, needle: usize) -> bool {
        let yielding = self.work.needles.yielding[needle];
        yielding.is_some_and(|yielding| yielding.free_by.is_some())
            && self.state.passes(Obstacle::Needle(needle))
    }

    /// Where a needle that gave way in the last solve turns about, and how it gives way to forces but for bodies, (6 x 6): `rows` says how
    /// stiff its rows are.
    pub(crate) fn response(
        &self,
        needle: usize,
        rows: impl FnOnce(&Vector3<f64>) -> Matrix6<f64>,
    ) -> Option<(Vector3<f64>, Matrix6<f64>)> {
        let yielding = self.work.needles.yielding[needle]?;
        let (centre, _) = yielding.free_by?;
        let whole = Matrix6::from_diagonal(&yielding.inertia) + rows(&centre);
        Some((centre, whole.try_inverse()?))
    }
}
