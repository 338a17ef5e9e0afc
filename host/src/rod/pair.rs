//! Bodies that press on each other: those of grips, and needles.
//!
//! Entry points: [`BodyContact`] for a pair that a scene names, [`PairSource`]. What a pair does is a function of both poses and of where
//! it stuck before ([`Press`]). A needle that nobody holds gives way to that: it has a row wherever it is pressed on, as soft as the pair
//! (`needle/yielding.rs`). All other sides are where hands have them.

use super::press::{Nearest, Press};
use crate::anchors::{AnchorPoint, PointConstraint};
use crate::needle::Push;
use crate::rows::RowKind;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Sources};
use crate::thread::{Obstacle, ThreadBody};
use crate::tool::MOST_FRICTION;
use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};
use serde::Serialize;

/// Bit of a row's id that no other source's rows have.
const ID: u64 = 1 << 55;
/// Places at which one of a pair has rows at most.
pub(crate) const MOST_PLACES: usize = 4;
/// Within so many mean edges of each other two bodies go in small pieces: twice what one goes at once where nothing is near.
const NEAR_EDGES: f64 = 2.0;

/// Two bodies that press on each other, one of a grip at least.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyContact {
    /// Which, (2).
    pub between: [ThreadBody; 2],
    /// Normal force per overlap \[N/m\]; across the normal, before it slips, likewise.
    pub stiffness_n_per_m: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
}

/// Most of the stiffness of a pair \[N/m\]: some times what consoles render, which clamp it.
pub const STIFFEST_PAIR_N_PER_M: f64 = 1e4;

impl BodyContact {
    /// What is wrong with it beside those `before` it.
    pub(crate) fn flaw(&self, before: &[Self]) -> Option<String> {
        let [one, other] = self.between;
        let is_needle = |body| matches!(body, ThreadBody::Needle(_));
        let (stiff, friction) = (self.stiffness_n_per_m, self.friction);
        if one == other {
            return Some("they are the same body".to_owned());
        }
        if is_needle(one) && is_needle(other) {
            return Some("one has to be the body of a grip".to_owned());
        }
        if before
            .iter()
            .any(|pair| pair.between.contains(&one) && pair.between.contains(&other))
        {
            return Some("that is said twice".to_owned());
        }
        if !(stiff > 0.0 && stiff <= STIFFEST_PAIR_N_PER_M) {
            return Some(format!(
                "the stiffness is {stiff} N/m; it must be above 0 and at most {STIFFEST_PAIR_N_PER_M}"
            ));
        }
        let is_sound = (0.0..=MOST_FRICTION).contains(&friction);
        (!is_sound)
            .then(|| format!("the friction is {friction}; it must be from 0 to {MOST_FRICTION}"))
    }
}

/// The same by places.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairPart {
    pub between: [Obstacle; 2],
    pub stiffness_n_per_m: f64,
    pub friction: f64,
}

/// What a pair keeps from step to step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct PairState {
    between: [Obstacle; 2],
    /// Whether the two have been apart: before that they do nothing.
    has_been_apart: bool,
    /// Whether they are within some edges of each other.
    pub is_near: bool,
    /// Points in the frames of both that are at one place but for how the touch is stretched \[m\]: since the last balance, and before it.
    sticks: Option<[Vector3<f64>; 2]>,
    stuck: Option<[Vector3<f64>; 2]>,
}

impl PairState {
    /// Of bodies that have not been anywhere.
    pub fn new(part: &PairPart) -> Self {
        Self {
            between: part.between,
            has_been_apart: false,
            is_near: true,
            sticks: None,
            stuck: None,
        }
    }

    /// Whether a body is one of the two.
    pub fn has(&self, body: Obstacle) -> bool {
        self.between.contains(&body)
    }

    /// One of the two was put elsewhere, whatever lies in between.
    pub fn forget(&mut self) {
        (self.has_been_apart, self.sticks, self.stuck) = (false, None, None);
    }
}

/// Pairs of bodies: they have no rows.
pub(crate) struct PairSource;

impl Source for PairSource {
    /// A row for each place at which a needle may be pressed on, on a point of its own that does not move.
    fn room(&self, sources: &Sources) -> Room {
        let places = MOST_PLACES * sources.pairs.len();
        Room::new(places, places)
    }

    fn append(&self, balance: &mut Balance) {
        let BalanceWork { set, needles, .. } = &mut *balance.work;
        for (place, push) in (0u64..).zip(&mut needles.pushes) {
            let anchor = set.add(AnchorPoint {
                nodes: [0; 4],
                weights: [0.0; 4],
            });
            push.row = set.rows.len();
            set.soft.push((push.row as u32, push.gives_m_per_n));
            set.rows.push(PointConstraint {
                id: ID | place,
                anchor,
                kind: RowKind::Inequality,
                direction: push.direction.into(),
                target_m: push.apart_m,
            });
        }
    }

    fn accept(&self, balance: &mut Balance) {
        for pair in 0..balance.sources.pairs.len() {
            balance.follow_pair(pair);
        }
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        for pair in 0..balance.sources.pairs.len() {
            balance.feel_pair(pair, felt);
        }
    }
}

impl Balance<'_> {
    /// Both bodies of a pair where they are, if not the same hand has them there.
    fn pair(&self, pair: usize, sticks: Option<[Vector3<f64>; 2]>) -> Option<Press> {
        let part = &self.sources.pairs[pair];
        let [one, other] = part.between;
        if self.carrier(one) == self.carrier(other) {
            return None;
        }
        let rods = [self.body(one)?, self.body(other)?];
        let frames = [self.frame_of(one)?, self.frame_of(other)?];
        let place =
            |own: usize, at: [Vector3<f64>; 2]| (frames[own] * Point3::from(at[own])).coords;
        // What nobody holds would roll, or slip, and withstand next to nothing.
        let rubs = part.friction > 0.0 && part.between.iter().all(|of| self.carrier(*of).is_some());
        Some(Press {
            near: Nearest::find([&rods[0], &rods[1]]),
            stiffness_n_per_m: part.stiffness_n_per_m,
            friction: part.friction,
            sticks: sticks
                .filter(|_| rubs)
                .map(|at| [place(0, at), place(1, at)]),
        })
    }

    fn frame_of(&self, body: Obstacle) -> Option<Isometry3<f64>> {
        match body {
            Obstacle::Bar(bar) => self.state.bars[bar].pose,
            Obstacle::Needle(needle) => Some(self.state.each[needle].pose),
        }
    }

    /// A pair as the balance felt it: nothing for one that has not been apart.
    fn pressed(&self, pair: usize) -> Option<Press> {
        let state = &self.state.pairs[pair];
        let press = self.pair(pair, state.stuck);
        press.filter(|_| state.has_been_apart)
    }

    /// A pair sticks where the balance has it, as far as its friction goes.
    fn follow_pair(&mut self, pair: usize) {
        let before = self.state.pairs[pair];
        let mut next = PairState {
            is_near: false,
            sticks: None,
            stuck: before.sticks,
            ..before
        };
        // A hand that has had both may let one go within the other.
        let [one, other] = self.sources.pairs[pair].between;
        next.has_been_apart &= self.carrier(one) != self.carrier(other);
        if let Some(press) = self.pair(pair, before.sticks) {
            let depth_m = press.near.depth_m();
            next.has_been_apart |= depth_m <= 0.0;
            next.is_near = -depth_m < NEAR_EDGES * self.sources.edge_m();
            let frames = self.sources.pairs[pair]
                .between
                .map(|body| self.frame_of(body));
            if let (true, [Some(one), Some(other)]) = (depth_m > 0.0, frames) {
                let (place, half) = (press.place_m(), press.stretch_m().0 * 0.5);
                let on = |frame: Isometry3<f64>, at: Vector3<f64>| {
                    frame.inverse_transform_point(&at.into()).coords
                };
                next.sticks = Some([on(one, place + half), on(other, place - half)]);
            }
        }
        self.state.pairs[pair] = next;
    }

    fn feel_pair(&self, pair: usize, felt: &mut Felt) {
        let bodies = self.sources.pairs[pair].between;
        let own = bodies.map(|body| self.carrier(body) == Some(felt.tool));
        let Some(own) = own.iter().position(|own| *own) else {
            return;
        };
        let Some(press) = self.pressed(pair) else {
            return;
        };
        let (mut wrench, mut tangent) = press.felt(own, &felt.grip);
        self.pressed_beside(pair, &press, |other| {
            let (force, turns) = other.felt(own, &felt.grip);
            wrench += force;
            tangent += turns;
        });
        if let Some(gives) = self.given(pair, &press, own, (&felt.grip, &wrench, &tangent)) {
            tangent += gives;
        }
        let gap_m = -press.near.depth_m();
        if gap_m < 0.0 {
            felt.wrench += wrench;
            felt.tangent = Some(felt.tangent.map_or(tangent, |sum| sum + tangent));
            felt.rows += 3;
            felt.gap_m = 0.0;
        } else if gap_m < felt.coming.map_or(f64::MAX, |(nearest_m, ..)| nearest_m) {
            let way = press.near.way() * if own == 0 { 1.0 } else { -1.0 };
            felt.coming = Some((gap_m, way.normalize(), tangent));
        }
    }

    /// Every close place but the nearest at which a needle that nobody holds is nearer to the other body than beside that: it would rock from
    /// one to the other.
    fn beside(&self, pair: usize, nearest: &Press, mut visit: impl FnMut(&Press)) {
        let between = self.sources.pairs[pair].between;
        if between.iter().all(|body| self.carrier(*body).is_some()) {
            return;
        }
        let [Some(one), Some(other)] = between.map(|body| self.body(body)) else {
            return;
        };
        let at = |near: &Nearest| near.sides[0].at;
        let mut left = MOST_PLACES - 1;
        Nearest::visit([&one, &other], |near| {
            if left > 0 && near.is_close() && at(near) != at(&nearest.near) {
                left -= 1;
                visit(&Press {
                    near: *near,
                    ..*nearest
                });
            }
        });
    }

    /// As [`Self::beside`], where they press.
    fn pressed_beside(&self, pair: usize, nearest: &Press, mut visit: impl FnMut(&Press)) {
        self.beside(pair, nearest, |other| {
            if other.near.depth_m() > 0.0 {
                visit(other);
            }
        });
    }

    /// What presses on a needle that nobody holds, about `centre`, at all places of a pair of which the nearest is given, and how that
    /// follows a motion of the needle.
    fn pressed_on(
        &self,
        (pair, side): (usize, usize),
        nearest: &Press,
        centre: &Vector3<f64>,
    ) -> (Vector6<f64>, Matrix6<f64>) {
        let mut sum = nearest.felt(side, centre);
        self.pressed_beside(pair, nearest, |other| {
            let (wrench, turns) = other.felt(side, centre);
            sum.0 += wrench;
            sum.1 += turns;
        });
        sum
    }

    /// By what the tangent of a tool is other than with the other body at rest, which gives way: nothing for what hands hold. With f on
    /// the needle, T how that follows its motion, R as in [`rotated`] and x that motion, one d of the tool does `df = (R - T) d`,
    /// hence `x = (1 / X + K)^-1 df` for a needle that gives way by X without the bodies, which are K stiff, and on the tool
    /// `(R - T) x` more, with its own R and T: a motion of both turns what is between them, and does nothing else to it.
    fn given(
        &self,
        pair: usize,
        press: &Press,
        own: usize,
        (grip, on_tool, at_rest): (&Vector3<f64>, &Vector6<f64>, &Matrix6<f64>),
    ) -> Option<Matrix6<f64>> {
        let Obstacle::Needle(needle) = self.sources.pairs[pair].between[1 - own] else {
            return None;
        };
        let (centre, gives) = self.work.needles.responses[needle]?;
        let mut stiffness = Matrix6::zeros();
        for of in self.pushers(needle) {
            let pressed = self.pressed(of.0);
            if let Some(pressed) = pressed.filter(|pressed| pressed.near.depth_m() > 0.0) {
                stiffness -= self.pressed_on(of, &pressed, &centre).1;
            }
        }
        let (on_it, turns) = self.pressed_on((pair, 1 - own), press, &centre);
        if press.near.depth_m() <= 0.0 {
            // What it will be just after they touch.
            stiffness -= turns;
        }
        let gives = (Matrix6::identity() + gives * stiffness).try_inverse()? * gives;
        let to_needle = (rotated(&on_it) - turns) * carried(grip, &centre);
        let to_tool = (rotated(on_tool) - at_rest) * carried(&centre, grip);
        Some(to_tool * gives * to_needle)
    }

    /// Pairs that press on a needle, and which side of them it is.
    fn pushers(&self, needle: usize) -> impl Iterator<Item = (usize, usize)> {
        let body = Obstacle::Needle(needle);
        let pairs = self.sources.pairs.iter().enumerate();
        pairs.filter_map(move |(pair, part)| {
            let side = part.between.iter().position(|of| *of == body)?;
            Some((pair, side))
        })
    }

    /// Stiffness of all pairs that press on a needle \[N/m\]; none where nothing may.
    pub(crate) fn pushed_by(&self, needle: usize) -> f64 {
        let pairs = self.pushers(needle);
        pairs
            .map(|(pair, _)| self.sources.pairs[pair].stiffness_n_per_m)
            .sum()
    }

    /// Where bodies press on a needle where it is, or nearly do; `add` is handed each.
    pub(crate) fn find_pushes(&self, needle: usize, mut add: impl FnMut(Push)) {
        for (pair, side) in self.pushers(needle) {
            let state = &self.state.pairs[pair];
            let press = self.pair(pair, None);
            let Some(press) = press.filter(|_| state.has_been_apart) else {
                continue;
            };
            let mut add = |press: &Press| {
                let (at_m, direction) = press.pushes(side);
                add(Push {
                    needle,
                    row: 0,
                    at_m,
                    direction,
                    apart_m: -press.near.depth_m(),
                    gives_m_per_n: press.stiffness_n_per_m.recip(),
                });
            };
            if press.near.is_close() {
                add(&press);
            }
            self.beside(pair, &press, add);
        }
    }

    /// Stored where bodies press on each other \[J\].
    pub(crate) fn stored_in_pairs_j(&self) -> f64 {
        let pairs = 0..self.sources.pairs.len();
        let mut stored_j = 0.0;
        for pair in pairs {
            if let Some(press) = self.pressed(pair) {
                stored_j += press.stored_j();
                self.pressed_beside(pair, &press, |other| stored_j += other.stored_j());
            }
        }
        stored_j
    }
}

/// What a force and its moment change by as they turn with a left increment of a pose.
fn rotated(wrench: &Vector6<f64>) -> Matrix6<f64> {
    let [force, moment] = [0, 3].map(|first| wrench.fixed_rows::<3>(first).into_owned());
    let mut change = Matrix6::zeros();
    let by_turn = |of: Vector3<f64>| -of.cross_matrix();
    change
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&by_turn(force));
    change
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&by_turn(moment));
    change
}

/// The increment about `to` that is one about `from`.
fn carried(from: &Vector3<f64>, to: &Vector3<f64>) -> Matrix6<f64> {
    let mut carried = Matrix6::identity();
    carried
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-(to - from).cross_matrix());
    carried
}
