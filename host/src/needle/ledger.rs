//! Where the energy goes: what slides, cuts, is let go and taken hold of.
//!
//! Entry points: [`Balance::book`], [`Balance::settle_releases`]. Between two balances of linear tissue its energy changes by the sum of
//! `(f + f').(x' - x) / 2` over all anchors; each share is booked where it belongs.

use super::Crossing;
use super::source::{Point, Release, What, anchor};
use super::state::Tip;
use super::surface::friction_of;
use crate::rows::Mode;
use crate::step::{Balance, Status};
use nalgebra::{Vector3, Vector6};

impl Balance<'_> {
    /// The energy that went, or came, with what was let go and taken hold of before the last solve. Between
    /// two balances of linear tissue it changes by the sum of (f + f').(x' - x) / 2 over all anchors; the
    /// others' share is the hand's work and their slides.
    pub(super) fn settle_releases(&mut self) {
        for index in 0..self.work.needles.releases.len() {
            let release = self.work.needles.releases[index];
            let moved = self.position_of(&release.at) - release.from;
            let point = release.taken.and_then(|taken| {
                let what = What::Crossing(taken);
                let is = |point: &Point| point.needle == release.needle && point.what == what;
                self.work.needles.points.iter().position(is)
            });
            let now = point.map_or_else(Vector3::zeros, |point| self.state.grasp.force_on(point));
            // Its slide is booked with the others'.
            let slid = release
                .taken
                .map_or_else(Vector3::zeros, |taken| self.slid(release.needle, taken));
            let done = 0.5 * (release.force + now).dot(&(moved - slid));
            self.state.each[release.needle].tally.release_j -= done;
        }
        self.work.needles.releases.clear();
    }

    /// By how much a crossing has slid in this balance \[m\].
    pub(super) fn slid(&self, needle: usize, crossing: usize) -> Vector3<f64> {
        let state = &self.state.each[needle];
        let crossings = state.history.crossings();
        let (Some(now), Some(hold)) = (crossings.get(crossing), state.holds.get(crossing)) else {
            return Vector3::zeros();
        };
        let curve = self.sources.needles[needle].needle.at(&state.pose);
        curve.at(now.alpha) - curve.at(hold.alpha)
    }

    /// Takes the rows of a point of needle `needle` away: remembers their force.
    pub(super) fn release(&mut self, needle: usize, what: What) {
        let found = self
            .work
            .needles
            .points
            .iter()
            .position(|point| point.needle == needle && point.what == what);
        // One that came after the last solve has no force.
        let Some(index) = found else {
            return;
        };
        let force = self.state.grasp.force_on(index);
        if force != Vector3::zeros()
            && self.work.needles.releases.len() < self.work.needles.releases.capacity()
        {
            let at = self.work.set.anchors[index];
            let from = self.position_of(&at);
            self.work.needles.releases.push(Release {
                needle,
                at,
                force,
                from,
                taken: None,
            });
        }
    }

    /// The needle takes hold of a crossing that may be beside it.
    pub(super) fn take_hold(&mut self, needle: usize, crossing: Crossing) -> Result<(), Status> {
        let at = anchor(&self.sources.mesh, &crossing);
        let from = self.position_of(&at);
        let state = &mut self.state.each[needle];
        let taken = state.holds.len();
        if !state.history.push(crossing) {
            return Err(Status::TooManyRows);
        }
        state.hold_new(self.sources.apart_m);
        if self.work.needles.releases.len() < self.work.needles.releases.capacity() {
            self.work.needles.releases.push(Release {
                needle,
                at,
                force: Vector3::zeros(),
                from,
                taken: Some(taken),
            });
        }
        Ok(())
    }

    /// Wrench on a needle: force, then moment about `centre`.
    pub(super) fn wrench_on(&self, needle: usize, centre: &Vector3<f64>) -> Vector6<f64> {
        let mut wrench = Vector6::zeros();
        for (index, point) in self.work.needles.points.iter().enumerate() {
            if point.needle != needle {
                continue;
            }
            let force = -self.state.grasp.force_on(index);
            let arm = self.position_of(&self.work.set.anchors[index]) - centre;
            let moment = arm.cross(&force);
            wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        }
        wrench
    }

    /// Where nobody holds the needle nobody gets the work that the way of one of its points is worth.
    fn book_loose(&mut self, place: usize) {
        let point = self.work.needles.points[place];
        let force = self.state.grasp.force_on(place);
        let needle = &self.sources.needles[point.needle].needle;
        let state = &mut self.state.each[point.needle];
        let [from, to] = [&state.booked, &state.pose].map(|pose| needle.at(pose));
        let known = match point.what {
            What::Crossing(index) => state.holds.get(index).map(|hold| (hold.alpha, hold.force)),
            What::Touch(index) => {
                let touch = state.touches.get(index);
                touch.map(|touch| (touch.alpha, touch.force))
            }
            What::Cut | What::Holding => Some((to.length, state.tip_force)),
        };
        if let Some((alpha, before)) = known {
            let mean = 0.5 * (before + force);
            state.tally.release_j -= mean.dot(&(to.at(alpha) - from.at(alpha)));
        }
    }

    /// Books slides and cuts under the mean of the forces before and after, as [`Self::settle_releases`] says.
    pub(super) fn book(&mut self) {
        for place in 0..self.work.needles.points.len() {
            let needle = self.work.needles.points[place].needle;
            if self.state.each[needle].grip.is_none() {
                self.book_loose(place);
            }
        }
        let lambda = self.state.grasp.lambda();
        let (delta, modes) = (self.state.grasp.delta_m(), self.state.grasp.modes());
        for (index_of_point, point) in self.work.needles.points.iter().enumerate() {
            let slid = match point.what {
                What::Crossing(index) => self.slid(point.needle, index),
                _ => Vector3::zeros(),
            };
            let rubs = friction_of(self.work, point).map(|_| self.slipped(point.first_row));
            let state = &mut self.state.each[point.needle];
            let (force, slide) = (lambda[point.first_row], delta[point.first_row]);
            if matches!(point.what, What::Cut | What::Holding) {
                let force = self.state.grasp.force_on(index_of_point);
                if let (
                    Some(slipped),
                    Tip::Holding {
                        rubs: Some(lie), ..
                    },
                ) = (rubs, state.tip)
                {
                    let way = slipped + lie.off_m;
                    state.tally.friction_j += 0.5 * (state.tip_force + force).dot(&way);
                }
                state.tip_force = force;
            }
            let bound = modes[point.first_row] != Mode::Held;
            match point.what {
                What::Crossing(index) => {
                    let Some(hold) = state.holds.get_mut(index) else {
                        continue;
                    };
                    let force = self.state.grasp.force_on(index_of_point);
                    state.tally.friction_j -= 0.5 * (hold.force + force).dot(&slid);
                    hold.slides = bound && hold.limit_n > 0.0;
                    hold.force = force;
                }
                What::Cut => {
                    let Tip::Inside { cut: Some(cut) } = &mut state.tip else {
                        continue;
                    };
                    let cuts = cut.pressed && bound && slide > 0.0;
                    if cuts {
                        state.tally.cutting_j -= 0.5 * (cut.axial_n + force) * slide;
                    }
                    cut.cuts = cuts;
                    cut.axial_n = force;
                }
                What::Touch(index) => {
                    let force = self.state.grasp.force_on(index_of_point);
                    if let (Some(touch), Some(slipped)) = (state.touches.get_mut(index), rubs) {
                        state.tally.friction_j += 0.5 * (touch.force + force).dot(&slipped);
                        touch.force = force;
                    }
                }
                What::Holding => {}
            }
        }
        for (needle, state) in self.state.each.iter_mut().enumerate() {
            state.booked = state.pose;
            let at_tip = |point: &Point| {
                point.needle == needle && matches!(point.what, What::Cut | What::Holding)
            };
            if !self.work.needles.points.iter().any(at_tip) {
                state.tip_force = Vector3::zeros();
            }
        }
    }
}
