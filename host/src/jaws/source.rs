//! Jaws as a source of constraints: three rows at each point that they hold.
//!
//! Entry point: [`JawsSource`]. Across the pads a point stays where it was taken; in their plane it does so by Coulomb's law at
//! a given normal force, of which each of n points has a share: `|f| <= mu P/n`, together `mu P` whatever n is. What is at its
//! bound slides, by an implicit step: its place on the tool follows by as much as the tool has run ahead.

use super::between::Between;
use super::{Gripped, JawsPart};
use crate::anchors::PointConstraint;
use crate::event::{Event, Loss};
use crate::needle::STIFFEST_M_PER_N;
use crate::rows::{Mode, RowKind};
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Sources, Status};
use crate::tool::ToolSample;
use nalgebra::{Vector2, Vector3};
use std::ops::Range;

/// Bit of a row's id that no other source's rows have.
const ID: u64 = 1 << 53;

/// All jaws of a scene.
pub(crate) struct JawsSource;

/// Scratch of all jaws.
pub(crate) struct JawsWork {
    /// Rows of the present set, three for each point.
    pub rows: Range<usize>,
    /// Their points.
    pub points: Vec<Gripped>,
    pub(super) between: Between,
}

impl JawsWork {
    /// For the jaws of a scene.
    pub fn new(sources: &Sources) -> Self {
        Self {
            rows: 0..0,
            points: Vec::with_capacity(most_points(&sources.jaws)),
            between: Between::new(sources),
        }
    }
}

fn most_points(parts: &[JawsPart]) -> usize {
    parts.iter().map(|part| part.jaws.points).sum()
}

impl Source for JawsSource {
    fn room(&self, sources: &Sources) -> Room {
        let points = most_points(&sources.jaws);
        Room::new(points, 3 * points)
    }

    fn append(&self, balance: &mut Balance) {
        balance.work.jaws.points.clear();
        let first = balance.work.set.rows.len();
        for (index, part) in balance.sources.jaws.iter().enumerate() {
            let state = &balance.state.jaws[index];
            let Some(pose) = state.pose else {
                continue;
            };
            let frame = part.jaws.frame(&pose.rotation);
            let limit_n = part.jaws.limit_n() / state.points.len().max(1) as f64;
            let kinds = [
                RowKind::Equality,
                RowKind::Disc { limit_n },
                RowKind::Tangent,
            ];
            for (place, point) in state.points.iter().enumerate() {
                let held = pose * nalgebra::Point3::from(point.local_m);
                let to = held.coords - balance.unloaded(&point.at);
                let BalanceWork { set, jaws, .. } = &mut *balance.work;
                let (row, anchor) = (set.rows.len(), set.add(point.at));
                let id = ID | (index as u64) << 40 | u64::from(point.id) << 2;
                for (axis, (direction, kind)) in (0u64..).zip(frame.iter().zip(kinds)) {
                    set.rows.push(PointConstraint {
                        id: id | axis,
                        anchor,
                        kind,
                        direction: (*direction).into(),
                        target_m: direction.dot(&to),
                    });
                }
                jaws.points.push(Gripped {
                    jaws: index,
                    place,
                    anchor: anchor as usize,
                    row,
                    frame,
                    soft: [0.0; 3],
                    at_m: Vector3::zeros(),
                    force_n: Vector3::zeros(),
                    ahead_m: Vector2::zeros(),
                    slips: false,
                });
            }
        }
        balance.work.jaws.rows = first..balance.work.set.rows.len();
    }

    /// On what cannot move, and beside it, a way of nothing would be a force of everything.
    fn soften(&self, balance: &mut Balance, _solve: u32) {
        let n = balance.work.count();
        let BalanceWork { system, jaws, .. } = &mut *balance.work;
        let w = system.compliance_mut(n);
        for point in &mut jaws.points {
            for axis in 0..3 {
                let own = &mut w[(point.row + axis) * (n + 1)];
                let least = own.max(STIFFEST_M_PER_N);
                point.soft[axis] = least - *own;
                *own = least;
            }
        }
    }

    /// Tears off what is pulled harder than tissue bears.
    fn advance(&self, balance: &mut Balance, _played: Option<usize>) -> Result<bool, Status> {
        let mut has_torn = false;
        for (index, part) in balance.sources.jaws.iter().enumerate() {
            let own = balance
                .work
                .jaws
                .points
                .iter()
                .filter(|point| point.jaws == index);
            let force = own.map(|point| balance.state.grasp.force_on(point.anchor));
            let force_n = force.sum::<Vector3<f64>>().norm();
            let state = &mut balance.state.jaws[index];
            if force_n > part.jaws.strength_n() && !state.points.is_empty() {
                state.lose(Loss::Tore);
                has_torn = true;
            }
        }
        Ok(has_torn)
    }

    /// What slipped is held where it is now; what has slipped out of the pads is let go of.
    fn accept(&self, balance: &mut Balance) {
        let mut points = std::mem::take(&mut balance.work.jaws.points);
        let (delta, modes) = (balance.state.grasp.delta_m(), balance.state.grasp.modes());
        for point in &mut points {
            point.at_m = balance.position_of(&balance.work.set.anchors[point.anchor]);
            point.force_n = balance.state.grasp.force_on(point.anchor);
            point.slips = modes[point.row + 1] != Mode::Held;
            point.ahead_m = Vector2::new(delta[point.row + 1], delta[point.row + 2]);
        }
        for point in points.iter().filter(|point| point.slips) {
            let state = &mut balance.state.jaws[point.jaws];
            let [_, axis, side] = point.frame;
            let way = axis * point.ahead_m.x + side * point.ahead_m.y;
            state.friction_j += way.dot(&point.force_n);
            if let (Some(pose), Some(held)) = (state.pose, state.points.get_mut(point.place)) {
                let local = Vector3::from(held.local_m) - pose.inverse_transform_vector(&way);
                held.local_m = local.into();
            }
        }
        balance.work.jaws.points = points;
        for (state, part) in balance.state.jaws.iter_mut().zip(&balance.sources.jaws) {
            state.drop_what_is_out(part);
        }
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        balance.feel_jaws(felt);
    }

    fn report(&self, balance: &mut Balance, _samples: &[ToolSample]) {
        balance.report_jaws();
        for (index, part) in balance.sources.jaws.iter().enumerate() {
            if let Some(why) = balance.state.jaws[index].lost.take() {
                let tool = part.tool;
                balance.report.happened(Event::Lost { tool, why });
            }
        }
    }
}
