//! Sources that nobody holds: six unknowns of their own, which the tissue settles.
//!
//! Entry point: [`FreeNeedleSource`].

use super::source::{NeedleWork, What};
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Sources, Status, about};
use nalgebra::{Vector3, Vector6};

/// Solves of one balance in which they settle: one that is not at rest by then lies still, and goes on in the next
/// balance.
const SOLVES: u32 = 4;

/// Stiffness with which a needle that nobody holds is held back in each solve, in parts of the
/// tissue's: it settles by a factor of about this in every one.
pub(super) const DRAG: f64 = 1e-5;
/// As far a needle that nobody holds turns between two solves \[rad\].
const MOST_LOOSE_TURN: f64 = 0.1;

/// Needles that nobody holds: they have no rows but those of [`NeedleSource`](super::NeedleSource).
pub(crate) struct FreeNeedleSource;

impl Source for FreeNeedleSource {
    fn room(&self, _sources: &Sources) -> Room {
        Room::default()
    }

    /// Its rows are where it is, and see it where it would be without them.
    fn append(&self, balance: &mut Balance) {
        if balance.state.each.iter().any(|each| each.grip.is_none()) {
            balance.find_arms();
        }
        for needle in 0..balance.state.each.len() {
            balance.aim_loose(needle);
        }
    }

    fn soften(&self, balance: &mut Balance, solve: u32) {
        if solve <= SOLVES || balance.work.needles.yielding.iter().any(Option::is_some) {
            balance.loosen(solve <= SOLVES);
        }
    }

    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        Ok(solve > SOLVES || balance.settle_loose())
    }
}

/// A row of a needle that nobody holds, and where that is acted on \[m\].
#[derive(Clone, Copy)]
struct LooseRow {
    row: usize,
    at: Vector3<f64>,
}

impl LooseRow {
    /// What a row along `direction` has its target go by, by a motion of the needle about `centre`.
    fn jacobian(&self, direction: &Vector3<f64>, centre: &Vector3<f64>) -> Vector6<f64> {
        let turn = (self.at - centre).cross(direction);
        let [along, turn] = [direction, &turn];
        Vector6::new(along.x, along.y, along.z, turn.x, turn.y, turn.z)
    }
}

impl Balance<'_> {
    /// Sources that nobody holds move as far as their wrench takes them against [`DRAG`]: whether all
    /// are at rest.
    fn settle_loose(&mut self) -> bool {
        let mut settled = true;
        for needle in 0..self.state.each.len() {
            let is_loose = self.state.each[needle].grip.is_none();
            if !is_loose || self.work.needles.yielding[needle].is_some() {
                continue;
            }
            // The compliance has it in it by now.
            if let Some(drag) = self.work.needles.drags[needle] {
                settled &= self.push_loose(needle, &drag, &Vector6::zeros());
            }
        }
        settled
    }

    /// Moves a needle that nobody holds by `ahead`, and as the wrench of the last solve does against a drag about a point; whether it
    /// is at rest.
    pub(super) fn push_loose(
        &mut self,
        needle: usize,
        (centre, drag): &(Vector3<f64>, Vector6<f64>),
        ahead: &Vector6<f64>,
    ) -> bool {
        let part = &self.sources.needles[needle].needle;
        let length = part.shape.length_m();
        // Where the solve has it: with the arms that the compliance has.
        let mut wrench = Vector6::zeros();
        for (index, point) in self.work.needles.points.iter().enumerate() {
            if point.needle == needle {
                let force = -self.state.grasp.force_on(index);
                let moment = (self.work.needles.arms[index] - centre).cross(&force);
                wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            }
        }
        for push in &self.work.needles.pushes {
            if push.needle == needle {
                let force = push.direction * self.state.grasp.lambda()[push.row];
                let moment = (push.at_m - centre).cross(&force);
                wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            }
        }
        // A whole step of Newton's: what falls, and what holds it up, may each be far more.
        let step = ahead + wrench.component_div(drag);
        let shift: Vector3<f64> = step.fixed_rows::<3>(0).into();
        let turn: Vector3<f64> = step.fixed_rows::<3>(3).into();
        let size = shift.norm() / self.sources.piece_m + turn.norm() / MOST_LOOSE_TURN;
        let part = size.max(1.0).recip();
        let (shift, turn) = (shift * part, turn * part);
        let state = &mut self.state.each[needle];
        state.pose = about(centre, &shift, &turn) * state.pose;
        // Products of rotations drift.
        state.pose.rotation.renormalize();
        shift.norm() + turn.norm() * length <= 1e-9 * length
    }

    /// Where a loose needle turns about, and its drag \[N/m, N m/rad\]; `None` if no row holds it.
    fn drag(&self, needle: usize) -> Option<(Vector3<f64>, Vector6<f64>)> {
        let n = self.work.count();
        let w = self.work.system.compliance(n);
        let curve = self.sources.needles[needle]
            .needle
            .at(&self.state.each[needle].pose);
        let (mut sum, mut count, mut centre) = (0.0, 0, Vector3::zeros());
        for point in self
            .work
            .needles
            .points
            .iter()
            .filter(|at| at.needle == needle)
        {
            sum += (0..3)
                .map(|axis| w[(point.first_row + axis) * (n + 1)])
                .sum::<f64>()
                / 3.0;
            centre += curve.at(point.alpha);
            count += 1;
        }
        if count == 0 || sum <= 0.0 {
            return None;
        }
        let push = DRAG * f64::from(count) * f64::from(count) / sum;
        let turn = push * curve.length * curve.length / 12.0;
        let drag = Vector6::new(push, push, push, turn, turn, turn);
        Some((centre / f64::from(count), drag))
    }

    /// Where points of needles are pressed on.
    fn find_arms(&mut self) {
        let mut arms = std::mem::take(&mut self.work.needles.arms);
        arms.clear();
        let points = self.work.needles.points.iter();
        arms.extend(points.zip(&self.work.set.anchors).map(|(point, at)| {
            if point.what == What::Cut {
                // It holds along the needle only, and may lie beside it.
                return self.position_of(at);
            }
            let pose = &self.state.each[point.needle].pose;
            let needle = &self.sources.needles[point.needle].needle;
            needle.at(pose).at(point.alpha)
        }));
        self.work.needles.arms = arms;
    }

    /// Rows of a needle, each with where it acts.
    fn loose_rows(needles: &NeedleWork, needle: usize) -> impl Iterator<Item = LooseRow> + Clone {
        let points = needles.points.iter().zip(&needles.arms);
        let own = points.filter(move |(point, _)| point.needle == needle);
        let of_points = own.flat_map(|(point, arm)| {
            let rows = point.first_row..point.first_row + 3;
            rows.map(|row| LooseRow { row, at: *arm })
        });
        let pushes = needles.pushes.iter();
        let pushes = pushes.filter(move |push| push.needle == needle);
        of_points.chain(pushes.map(|push| LooseRow {
            row: push.row,
            at: push.at_m,
        }))
    }

    /// Targets of the rows of a needle that gives way go on to where it would be without them.
    fn aim_loose(&mut self, needle: usize) {
        let (Some((centre, _)), Some(by)) = (self.yields(needle), self.free_by(needle)) else {
            return;
        };
        let BalanceWork { set, needles, .. } = &mut *self.work;
        for own in Self::loose_rows(needles, needle) {
            let row = &mut set.rows[own.row];
            row.target_m += own.jacobian(&row.direction.into(), &centre).dot(&by);
        }
    }

    /// Lets loose needles give way in the compliance: what yields, and others if `loosens`.
    fn loosen(&mut self, loosens: bool) {
        for needle in 0..self.state.each.len() {
            if self.state.each[needle].grip.is_some() {
                continue;
            }
            self.work.needles.drags[needle] = match self.work.needles.yielding[needle] {
                Some(_) => self.yields(needle),
                None if loosens => self.drag(needle),
                None => None,
            };
            self.add_loose(needle, 1.0);
        }
    }

    /// Adds what a needle that nobody holds gives way by in this solve to the compliance, `part` times.
    fn add_loose(&mut self, needle: usize, part: f64) {
        let Some((centre, drag)) = self.work.needles.drags[needle] else {
            return;
        };
        let n = self.work.count();
        let BalanceWork {
            system,
            set,
            needles,
            ..
        } = &mut *self.work;
        let own = Self::loose_rows(needles, needle);
        let jacobian = |own: &LooseRow| own.jacobian(&set.rows[own.row].direction.into(), &centre);
        let w = system.compliance_mut(n);
        for j in own.clone() {
            let given = jacobian(&j).component_div(&drag) * part;
            for i in own.clone() {
                w[n * j.row + i.row] += jacobian(&i).dot(&given);
            }
        }
    }

    /// Has needles that nobody holds give way in the compliance of the last solve, or not.
    pub(crate) fn hold_loose(&mut self, holds: bool) {
        for needle in 0..self.state.each.len() {
            if self.state.each[needle].grip.is_none() {
                self.add_loose(needle, if holds { -1.0 } else { 1.0 });
            }
        }
    }
}
