//! Sources that nobody holds: six unknowns of their own, which the tissue settles.
//!
//! Entry point: [`FreeNeedleSource`].

use super::source::What;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Sources, Status, about};
use nalgebra::{Vector3, Vector6};

/// Solves of one balance in which they settle: one that is not at rest by then lies still, and goes on in the next
/// balance.
const SOLVES: u32 = 4;

/// Stiffness with which a needle that nobody holds is held back in each solve, in parts of the
/// tissue's: it settles by a factor of about this in every one.
const DRAG: f64 = 1e-5;
/// As far a needle that nobody holds turns between two solves \[rad\].
const MOST_LOOSE_TURN: f64 = 0.1;

/// Needles that nobody holds: they have no rows but those of [`NeedleSource`](super::NeedleSource).
pub(crate) struct FreeNeedleSource;

impl Source for FreeNeedleSource {
    fn room(&self, _sources: &Sources) -> Room {
        Room::default()
    }

    fn append(&self, _balance: &mut Balance) {}

    fn soften(&self, balance: &mut Balance, solve: u32) {
        if solve <= SOLVES || balance.work.needles.falling.iter().any(Option::is_some) {
            balance.loosen(solve <= SOLVES);
        }
    }

    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        Ok(solve > SOLVES || balance.settle_loose())
    }
}

impl Balance<'_> {
    /// Sources that nobody holds move as far as their wrench takes them against [`DRAG`]: whether all
    /// are at rest.
    fn settle_loose(&mut self) -> bool {
        let mut settled = true;
        for needle in 0..self.state.each.len() {
            let is_loose = self.state.each[needle].grip.is_none();
            if !is_loose || self.work.needles.falling[needle].is_some() {
                continue;
            }
            // The compliance has it in it by now.
            if let Some((centre, drag)) = self.work.needles.drags[needle] {
                settled &= self.push_loose(needle, &centre, &drag);
            }
        }
        settled
    }

    /// Moves a needle that nobody holds as the wrench of the last solve does against `drag`, about `centre`; whether it is at rest.
    pub(super) fn push_loose(
        &mut self,
        needle: usize,
        centre: &Vector3<f64>,
        drag: &Vector6<f64>,
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
        let step = wrench.component_div(drag);
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

    /// Lets loose needles give way in the compliance: what falls, and others if `loosens`.
    fn loosen(&mut self, loosens: bool) {
        let mut arms = std::mem::take(&mut self.work.needles.arms);
        arms.clear();
        arms.extend(
            self.work
                .needles
                .points
                .iter()
                .zip(&self.work.set.anchors)
                .map(|(point, at)| {
                    if point.what == What::Cut {
                        // It holds along the needle only, and may lie beside it.
                        return self.position_of(at);
                    }
                    let pose = &self.state.each[point.needle].pose;
                    self.sources.needles[point.needle]
                        .needle
                        .at(pose)
                        .at(point.alpha)
                }),
        );
        self.work.needles.arms = arms;
        for needle in 0..self.state.each.len() {
            if self.state.each[needle].grip.is_some() {
                continue;
            }
            self.work.needles.drags[needle] = match self.work.needles.falling[needle] {
                Some(_) => self.withstands(needle),
                None if loosens => self.drag(needle),
                None => None,
            };
            let Some((centre, drag)) = self.work.needles.drags[needle] else {
                continue;
            };
            let n = self.work.count();
            let BalanceWork {
                system,
                set,
                needles,
                ..
            } = &mut *self.work;
            let (points, arms) = (&needles.points, &needles.arms);
            let jacobian = |row: usize| {
                let along = Vector3::from(set.rows[row].direction);
                let turn = (arms[row / 3] - centre).cross(&along);
                Vector6::new(along.x, along.y, along.z, turn.x, turn.y, turn.z)
            };
            let own = 3 * points.len();
            let w = system.compliance_mut(n);
            for j in (0..own).filter(|row| points[row / 3].needle == needle) {
                let given = jacobian(j).component_div(&drag);
                for i in (0..own).filter(|row| points[row / 3].needle == needle) {
                    w[n * j + i] += jacobian(i).dot(&given);
                }
            }
        }
    }
}
