//! Bodies of tools that press on each other: those of grips, and needles that tools hold.
//!
//! Entry points: [`BodyContact`] for a pair that a scene names, [`PairSource`]. Both sides are where hands have them, so they have no
//! rows: what a pair does is a function of both poses and of where it stuck before ([`Press`]).

use super::press::{Nearest, Press};
use crate::source::{Room, Source};
use crate::step::{Balance, Felt, Sources};
use crate::thread::{Obstacle, ThreadBody};
use crate::tool::MOST_FRICTION;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Serialize;

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
    fn room(&self, _sources: &Sources) -> Room {
        Room::default()
    }

    fn append(&self, _balance: &mut Balance) {}

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
    /// Both bodies of a pair where they are, if hands have them there that are not the same.
    fn pair(&self, pair: usize, sticks: Option<[Vector3<f64>; 2]>) -> Option<Press> {
        let part = &self.sources.pairs[pair];
        let [one, other] = part.between;
        if self.carrier(one)? == self.carrier(other)? {
            return None;
        }
        let rods = [self.obstacle(one)?, self.obstacle(other)?];
        let frames = [self.frame_of(one)?, self.frame_of(other)?];
        let place =
            |own: usize, at: [Vector3<f64>; 2]| (frames[own] * Point3::from(at[own])).coords;
        Some(Press {
            near: Nearest::find([&rods[0], &rods[1]]),
            stiffness_n_per_m: part.stiffness_n_per_m,
            friction: part.friction,
            sticks: sticks
                .filter(|_| part.friction > 0.0)
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
        let (wrench, tangent) = press.felt(own, &felt.grip);
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

    /// Stored where bodies press on each other \[J\].
    pub(crate) fn stored_in_pairs_j(&self) -> f64 {
        let pairs = 0..self.sources.pairs.len();
        let each = pairs.filter_map(|pair| self.pressed(pair));
        each.map(|press| press.stored_j()).sum()
    }
}
