//! Bars as a source of constraints: the rows of a cone at each place where one touches.
//!
//! Entry point: [`BarSource`].

use super::bar::BarPart;
use super::shape::Rod;
use super::touch::{CORRECTED, MOST_TOUCHES, OVERLAP, Swept, Touch};
use crate::anchors::PointConstraint;
use crate::needle::{STIFFEST_M_PER_N, cone};
use crate::source::tool::WALL_M_PER_N;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Sources, Status};
use nalgebra::{Vector3, Vector6};
use std::ops::Range;

/// Bit of a row's id that no other source's rows have.
const ID: u64 = 1 << 54;
/// A bar is near the surface within so many mean edges.
const NEAR_EDGES: f64 = 2.0;
/// In pieces of its way, from how far something may come to touch in the next one.
const NEAR_PIECES: f64 = 2.0;

/// All bars of a scene.
pub(crate) struct BarSource;

/// Scratch of all bars.
pub(crate) struct BarWork {
    /// Rows of the present set, three for each point.
    pub rows: Range<usize>,
    pub points: Vec<BarPoint>,
}

/// A point of the present rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BarPoint {
    /// Which bar, and which of its touches.
    pub bar: usize,
    place: usize,
    /// Its place among the anchors of the set.
    pub anchor: usize,
    pub first_row: usize,
    pub friction: f64,
    /// On the bar's axis \[m\].
    pub on_bar_m: Vector3<f64>,
}

/// A bar where it is.
struct Carried<'a> {
    part: &'a BarPart,
    rod: Rod,
}

impl Swept for Carried<'_> {
    fn rod(&self) -> &Rod {
        &self.rod
    }

    fn is_free(&self, alpha: f64) -> bool {
        (0.0..=self.rod.front_m).contains(&alpha)
    }

    fn friction(&self, _cell: u32) -> f64 {
        self.part.bar.friction
    }
}

impl BarWork {
    /// For the bars of a scene.
    pub fn new(sources: &Sources) -> Self {
        Self {
            rows: 0..0,
            points: Vec::with_capacity(MOST_TOUCHES * sources.bars.len()),
        }
    }
}

impl Source for BarSource {
    fn room(&self, sources: &Sources) -> Room {
        let points = MOST_TOUCHES * sources.bars.len();
        Room::new(points, 3 * points)
    }

    /// One that comes into the tissue without a way there touches nothing until it has been outside.
    fn prepare(&self, balance: &mut Balance) {
        for bar in 0..balance.sources.bars.len() {
            if !balance.state.bars[bar].has_been_outside {
                let is_outside = balance.is_outside(bar);
                let state = &mut balance.state.bars[bar];
                state.has_been_outside = is_outside;
                state.is_sunk &= !is_outside;
            }
        }
    }

    fn append(&self, balance: &mut Balance) {
        let first = balance.work.set.rows.len();
        balance.work.bars.points.clear();
        for (bar, (part, state)) in balance
            .sources
            .bars
            .iter()
            .zip(&balance.state.bars)
            .enumerate()
        {
            let Some(curve) = state.pose.and_then(|pose| part.bar.curve(&pose)) else {
                continue;
            };
            for (place, touch) in state.touches.iter().enumerate() {
                let on_bar_m = curve.at(touch.alpha);
                let to = on_bar_m + touch.lie.slid_m - balance.unloaded(&touch.at);
                let BalanceWork { set, bars, .. } = &mut *balance.work;
                let (first_row, anchor) = (set.rows.len(), set.add(touch.at));
                let id = ID | (bar as u64) << 40 | u64::from(touch.id) << 2;
                let rows = touch.lie.frame().into_iter().zip(cone(touch.friction));
                let apart = [-touch.apart_m, 0.0, 0.0];
                for (axis, ((direction, kind), apart)) in (0u64..).zip(rows.zip(apart)) {
                    set.rows.push(PointConstraint {
                        id: id | axis,
                        anchor,
                        kind,
                        direction: direction.into(),
                        target_m: direction.dot(&to) + apart,
                    });
                }
                bars.points.push(BarPoint {
                    bar,
                    place,
                    anchor: anchor as usize,
                    first_row,
                    friction: touch.friction,
                    on_bar_m,
                });
            }
        }
        balance.work.bars.rows = first..balance.work.set.rows.len();
    }

    /// Next to what does not move a way of nothing would be a force of everything.
    fn soften(&self, balance: &mut Balance, _solve: u32) {
        let n = balance.work.count();
        let BalanceWork { system, bars, .. } = &mut *balance.work;
        let w = system.compliance_mut(n);
        for row in bars.rows.clone() {
            let own = &mut w[row * (n + 1)];
            *own = match *own {
                0.0 => WALL_M_PER_N,
                gives => gives.max(STIFFEST_M_PER_N),
            };
        }
    }

    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        let mut settled = true;
        let overlap_m = OVERLAP.map(|overlap| overlap * balance.sources.edge_m());
        settled &= solve > CORRECTED || balance.correct_bars(overlap_m);
        for bar in 0..balance.sources.bars.len() {
            let added = balance.add_to_bar(bar, -overlap_m[1]);
            settled &= added.ok_or(Status::TooManyRows)? == 0;
        }
        Ok(settled)
    }

    fn accept(&self, balance: &mut Balance) {
        for point in &balance.work.bars.points {
            let force = balance.state.grasp.force_on(point.anchor);
            let touches = &mut balance.state.bars[point.bar].touches;
            if let Some(touch) = touches.get_mut(point.place) {
                touch.force = force;
            }
        }
        for bar in 0..balance.sources.bars.len() {
            balance.follow_bar(bar);
        }
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        let Some(bar) = balance.sources.bar_of(felt.tool) else {
            return;
        };
        let grasp = &balance.state.grasp;
        let points = balance.work.bars.points.iter();
        let pressing =
            |point: &&BarPoint| point.bar == bar && grasp.lambda()[point.first_row] > 0.0;
        for point in points.filter(pressing) {
            let force = -grasp.force_on(point.anchor);
            let arm = balance.position_of(&balance.work.set.anchors[point.anchor]) - felt.grip;
            let moment = arm.cross(&force);
            felt.wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            felt.rows += 3;
            felt.gap_m = 0.0;
        }
    }
}

impl Balance<'_> {
    /// A bar where it is, whether it touches or waits.
    fn bar(&self, bar: usize) -> Option<Carried<'_>> {
        let part = &self.sources.bars[bar];
        let curve = part.bar.curve(&self.state.bars[bar].pose?)?;
        let edge_m = self.sources.edge_m();
        let rod = Rod::new(curve, part.bar.radius_m, curve.length, edge_m).capped();
        Some(Carried { part, rod })
    }

    /// The shape of a bar where it is.
    pub(crate) fn bar_rod(&self, bar: usize) -> Option<Rod> {
        self.bar(bar).map(|carried| carried.rod)
    }

    fn carried(&self, bar: usize) -> Option<Carried<'_>> {
        let has_been_outside = self.state.bars[bar].has_been_outside;
        self.bar(bar).filter(|_| has_been_outside)
    }

    /// Whether no part of a bar is in tissue.
    fn is_outside(&mut self, bar: usize) -> bool {
        let mut work = std::mem::take(&mut self.work.rods);
        work.found.clear();
        let is_outside = self.bar(bar).is_some_and(|bar| {
            self.is_clear(&bar.rod.curve) && self.look_for_touches(&bar, &[], 0.0, &mut work)
        });
        let is_outside = is_outside && work.found.is_empty();
        self.work.rods = work;
        is_outside
    }

    /// Has what presses, or is in a bar, lie where the last solve has it; whether all does, but for `within_m`, both.
    fn correct_bars(&mut self, within_m: [f64; 2]) -> bool {
        let mut right = true;
        for index in 0..self.work.bars.points.len() {
            let point = self.work.bars.points[index];
            let presses = self.state.grasp.lambda()[point.first_row] > 0.0;
            let touch = self.state.bars[point.bar].touches[point.place];
            let force = self.state.grasp.force_on(point.anchor);
            let solved = (presses, force, self.slipped(point.first_row));
            let next = self
                .carried(point.bar)
                .and_then(|carried| self.corrected(&carried, &touch, solved, within_m));
            if let Some(next) = next {
                self.state.bars[point.bar].touches[point.place] = next;
                right = false;
            }
        }
        right
    }

    /// Takes up what is nearer to a bar than `within_m` and not yet touched; how much that is, nothing if there is no room.
    fn add_to_bar(&mut self, bar: usize, within_m: f64) -> Option<usize> {
        let mut work = std::mem::take(&mut self.work.rods);
        work.found.clear();
        let touches = &self.state.bars[bar].touches;
        let has_room = self
            .carried(bar)
            .is_none_or(|carried| self.look_for_touches(&carried, touches, within_m, &mut work));
        let state = &mut self.state.bars[bar];
        for touch in &work.found {
            state.next_id = state.next_id.wrapping_add(1);
            let id = state.next_id;
            state.touches.push(Touch { id, ..*touch });
        }
        let count = work.found.len();
        self.work.rods = work;
        has_room.then_some(count)
    }

    /// A bar touches where the balance has it: what presses goes with its edge, and what is near may touch next.
    fn follow_bar(&mut self, bar: usize) {
        let mut touches = std::mem::take(&mut self.state.bars[bar].touches);
        let carried = self.carried(bar);
        touches.retain_mut(|touch| {
            let pressing = carried.as_ref().filter(|_| touch.presses());
            let next = pressing.and_then(|carried| self.followed(carried, touch));
            *touch = next.unwrap_or(*touch);
            next.is_some()
        });
        self.state.bars[bar].touches = touches;
        let edge_m = self.sources.edge_m();
        let piece_m = self.sources.bars[bar].bar.piece_m(edge_m);
        // Of what finds no room now the next solve sees whether it has to.
        let _ = self.add_to_bar(bar, NEAR_PIECES * piece_m);
        let mut work = std::mem::take(&mut self.work.rods);
        let is_near = self.carried(bar).is_some_and(|carried| {
            self.is_near_surface(carried.rod(), NEAR_EDGES * edge_m, &mut work)
        });
        self.work.rods = work;
        self.state.bars[bar].is_near = is_near;
    }
}
