//! Legs: the two straight pieces of a span that lies on a body, one that comes to it and one that leaves it.
//!
//! Entry points: [`add_legs`], [`ThreadState::make_axial_rows`], [`ThreadState::linearise_legs`]. What is between their far ends is
//! as long as the shortest line around a cylinder, and so is exact in every solve. As of a straight piece the rows across give way
//! by length over tension: away from the cylinder each leg has its own, along the body one row is of both, since the thread slides
//! there without friction and gives way as a whole.

use super::cylinder::Around;
use super::lap::{Lap, Obstacle};
use super::segments::{ACROSS_M, End, Ground, NO_TENSION_N, STRAIGHT, Segment};
use super::state::ThreadState;
use crate::anchors::{AnchorPoint, ConstraintSet, MultiPointConstraint, Term};
use crate::rows::RowKind;
use nalgebra::Vector3;
use serde::Serialize;

/// Bit of a piece's number of the leg that leaves.
const LEAVES: u32 = 1 << 7;

/// What a straight piece of a path is that leads to a body, or away from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Leg {
    pub with: Obstacle,
    pub leaves: bool,
    /// Unit vectors across it: away from the body, and in the tangent plane there; and those of the last solve.
    pub across: [Vector3<f64>; 2],
    pub solved_across: [Vector3<f64>; 2],
    /// What lies on the body behind it \[m\]: of the one that comes.
    pub arc_m: f64,
    /// The row of both legs along the body, among the thread's rows on several anchors.
    pub axial_row: Option<u32>,
}

/// Adds the legs of a piece between two `ends` that lies on a body.
pub(super) fn add_legs(
    (lap, segments): (&mut Lap, &mut Vec<Segment>),
    key: (u32, u32),
    ends: [End; 2],
    span: usize,
    known: &[Segment],
    at: &impl Fn(&AnchorPoint) -> Vector3<f64>,
) {
    let far = ends.map(|end| match end {
        End::Tissue(anchor) => at(&anchor),
        End::Held(at) => at,
    });
    let around = lap.look(&far);
    let on = around.on.map(End::Held);
    let legs = [
        (key, [ends[0], on[0]]),
        ((key.0, key.1 | LEAVES), [on[1], ends[1]]),
    ];
    for (end, (key, ends)) in legs.into_iter().enumerate() {
        let mut segment = Segment::new(key, ends, span, known, at);
        segment.leg = Some(Leg {
            with: lap.with,
            leaves: end == 1,
            across: around.across[end],
            solved_across: around.across[end],
            arc_m: 0.0,
            axial_row: None,
        });
        segment.aim_n = segment.tension_n;
        segment.lead(&around, end, far[end]);
        segments.push(segment);
    }
}

impl Lap {
    /// The line around the body between two points, which goes on as it turned.
    fn look(&mut self, [from, to]: &[Vector3<f64>; 2]) -> Around {
        let around = self.cylinder.around(from, to, self.side, self.turn);
        (self.turn, self.middle_m) = (around.turn, around.middle_m);
        around
    }
}

impl Segment {
    /// Its length with what lies on a body behind it \[m\].
    pub(super) fn path_m(&self) -> f64 {
        self.way.norm() + self.arc_m()
    }

    /// What lies on a body behind it \[m\].
    pub(super) fn arc_m(&self) -> f64 {
        self.leg.map_or(0.0, |leg| leg.arc_m)
    }

    /// Linearises a leg where a line around the body has it, whose end there is `far`.
    fn lead(&mut self, around: &Around, end: usize, far: Vector3<f64>) {
        let on = End::Held(around.on[end]);
        if end == 0 {
            self.ends[1] = on;
            self.way = around.on[0] - far;
        } else {
            self.ends[0] = on;
            self.way = far - around.on[1];
        }
        self.aim_m = far;
        self.along = around.along[end];
        self.length_m = around.straight_m[end];
        self.is_weld = false;
        if let Some(leg) = &mut self.leg {
            leg.across = around.across[end];
            leg.arc_m = if end == 0 { around.arc_m } else { 0.0 };
        }
    }

    /// Where a leg's end away from the body is, as its way has it \[m\].
    pub(super) fn far_m(&self) -> Option<Vector3<f64>> {
        match (self.leg?.leaves, self.ends) {
            (false, [_, End::Held(on)]) => Some(on - self.way),
            (true, [End::Held(on), _]) => Some(on + self.way),
            _ => None,
        }
    }
}

impl ThreadState {
    /// Rows of tense legs along the bodies that they lie on.
    pub(super) fn make_axial_rows(
        &mut self,
        row_id: impl Fn((u32, u32)) -> u64,
        ground: &Ground,
        first: usize,
        set: &mut ConstraintSet,
    ) {
        for place in 1..self.segments.len() {
            let [coming, leaving] = &mut self.segments[place - 1..=place] else {
                continue;
            };
            let (Some(to), Some(from)) = (&mut coming.leg, &mut leaving.leg) else {
                continue;
            };
            (to.axial_row, from.axial_row) = (None, None);
            if !from.leaves || coming.aim_n <= NO_TENSION_N {
                continue;
            }
            let length_m = coming.length_m + to.arc_m + leaving.length_m;
            let begin = set.terms.len() as u32;
            let mut straight = 0.0;
            for (place, [a, b], along) in [
                (coming.place, coming.ends, to.across[1]),
                (leaving.place, leaving.ends, from.across[1]),
            ] {
                straight += along.dot(&(ground.unloaded(&b) - ground.unloaded(&a)));
                set.terms.push(Term {
                    anchor: place,
                    direction: along.into(),
                });
            }
            let row = (set.spread.len() - first) as u32;
            (to.axial_row, from.axial_row) = (Some(row), Some(row));
            set.spread.push(MultiPointConstraint {
                id: row_id(coming.key),
                kind: RowKind::Equality,
                target_m: -straight,
                compliance_m_per_n: length_m / coming.aim_n,
                terms: (begin, 2),
            });
        }
    }

    /// Linearises legs where a solve has their far ends, or a `part` of the way there; whether their forces are along them.
    pub(super) fn linearise_legs(&mut self, part: f64) -> bool {
        let mut settled = true;
        for place in 1..self.segments.len() {
            let [coming, leaving] = &mut self.segments[place - 1..=place] else {
                continue;
            };
            let (Some(from), Some(to)) = (coming.far_m(), leaving.far_m()) else {
                continue;
            };
            let own = |lap: &&mut Lap| {
                let with = coming.leg.map(|leg| leg.with);
                lap.is_on && lap.key == coming.key.0 && Some(lap.with) == with
            };
            let (true, Some(lap)) = (leaving.is_behind(coming), self.laps.iter_mut().find(own))
            else {
                continue;
            };
            let far = [(coming.aim_m, from), (leaving.aim_m, to)];
            let around = lap.look(&far.map(|(aim, far)| aim + (far - aim) * part));
            for (end, leg) in [coming, leaving].into_iter().enumerate() {
                settled &= leg.has_its_tension();
                leg.aim_n += (leg.tension_n - leg.aim_n) * part;
                leg.lead(&around, end, far[end].0 + (far[end].1 - far[end].0) * part);
                let off_n = (leg.force - leg.along * leg.tension_n).norm();
                settled &= leg.tension_n <= NO_TENSION_N
                    || off_n <= STRAIGHT * leg.tension_n.max(1e-3)
                    || off_n * leg.length_m <= ACROSS_M * leg.tension_n;
            }
        }
        settled
    }
}

impl Segment {
    /// Whether it leaves the body that another one comes to.
    pub(super) fn is_behind(&self, coming: &Self) -> bool {
        let same = |(from, to): (Leg, Leg)| from.leaves && !to.leaves && from.with == to.with;
        self.key.0 == coming.key.0 && self.leg.zip(coming.leg).is_some_and(same)
    }
}
