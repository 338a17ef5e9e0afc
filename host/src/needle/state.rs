//! What evolves about needles: poses, grips, histories, tips.
//!
//! Entry points: [`NeedleState`], [`Tip`].

use super::fall::Fall;
use super::model::{NeedlePart, NeedleSettings};
use super::surface::Lie;
use super::{Crossing, Curve, History};
use crate::anchors::AnchorPoint;
use crate::rod::{MOST_TOUCHES, Touch};
use crate::source::tool::Hardest;
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

/// Poses that are kept while the tip holds a boundary face: more are thinned out.
pub(super) const LOG: usize = 64;

/// One needle.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct NeedleState {
    pub pose: Isometry3<f64>,
    pub grip: Option<Grip>,
    pub history: History,
    /// One for each crossing.
    pub holds: Vec<Hold>,
    pub tip: Tip,
    /// Where its body touches the surface, or may come to.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub touches: Vec<Touch>,
    /// Whether its body is within some edges of the surface.
    #[serde(skip)]
    pub is_near: bool,
    /// Largest force on its body on the way in, and its place.
    #[serde(skip)]
    pub hardest: Option<Hardest>,
    /// A boundary face that the tip let go of from outside: it may have been dragged on below it.
    pub left: Option<Crossing>,
    /// Poses since the tip first touched the face that it holds.
    pub log: Vec<Isometry3<f64>>,
    /// Poses since the last one that was kept, and how many are let pass in between.
    pub log_skipped: u32,
    pub log_every: u32,
    pub next_id: u32,
    /// Where the needle was, and the tip's force on the tissue \[N\], when work was booked last.
    pub booked: Isometry3<f64>,
    pub tip_force: Vector3<f64>,
    pub tally: Tally,
    /// Speed of the uniform slide in this step \[m/s\].
    pub speed: f64,
    /// How it fell in the last step.
    #[serde(skip_serializing_if = "Fall::is_none")]
    pub fall: Fall,
}

/// By which tool a needle is held, and how.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Grip {
    pub tool: u8,
    /// The needle's frame in the tool's.
    pub needle: Isometry3<f64>,
}

/// What a crossing needs besides its place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Hold {
    /// Names its rows.
    pub id: u32,
    /// Where on the needle it sticks unless it slides \[m\].
    pub alpha: f64,
    /// Bound of the axial force \[N\].
    pub limit_n: f64,
    /// Force on the tissue at the last balance \[N\].
    pub force: Vector3<f64>,
    /// Whether it slid at the last balance.
    pub slides: bool,
    /// Whether it lies so close to the last crossing before it that has rows, or to the first after it, that it has none and goes
    /// with that.
    pub follows: bool,
    /// Whether that is the one after it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub ahead: bool,
}

/// Where a tip is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) enum Tip {
    /// Outside the tissue.
    Outside,
    /// On a boundary face, which it does not yet go through.
    Holding {
        /// The crossing that it will be.
        face: Crossing,
        id: u32,
        /// How it lies on the face once it has slipped: from then on friction holds it.
        #[serde(skip_serializing_if = "Option::is_none")]
        rubs: Option<Lie>,
    },
    /// In a cell.
    Inside {
        /// How far the tissue is cut, if that takes force.
        cut: Option<Cut>,
    },
    /// Nobody has seen how it came where it is, and some of the needle may be in tissue: it is in no hole, and touches nothing
    /// until all of it has been outside once.
    Waiting,
}

/// The end of a cut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Cut {
    pub at: AnchorPoint,
    pub cell: u32,
    /// Force that cuts on \[N\].
    pub limit_n: f64,
    /// Whether the tip pushes against it.
    pub pressed: bool,
    /// Axial multiplier at the last balance \[N\].
    pub axial_n: f64,
    /// Whether it was cut at the last balance.
    pub cuts: bool,
}

/// What happened so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Tally {
    pub punctures: u32,
    pub friction_j: f64,
    pub cutting_j: f64,
    pub release_j: f64,
    /// Crossings found by the direction alone.
    pub guessed: u32,
    /// Times that the tip found no way on.
    pub lost: u32,
    /// Balances in which crossings would have changed places.
    pub folded: u32,
}

/// Friction at one crossing, as the last balance has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrossingFriction {
    /// Force of the needle on the tissue along the needle \[N\], above zero towards the tip.
    pub axial_n: f64,
    /// The most that it can be \[N\].
    pub limit_n: f64,
    /// By how much the crossing slid in that balance \[m\], above zero towards the tip: against the
    /// needle's own way.
    pub slid_m: f64,
}

impl Grip {
    /// A tool at `pose` takes a needle where that is.
    pub fn new(tool: u8, pose: &Isometry3<f64>, needle: &Isometry3<f64>) -> Self {
        Self {
            tool,
            needle: pose.inverse() * needle,
        }
    }
}

impl NeedleState {
    /// Friction at each crossing of the needle, which is at `curve`.
    pub fn rubbing(&self, curve: Curve) -> impl Iterator<Item = CrossingFriction> {
        let each = self.history.crossings().iter().zip(&self.holds);
        each.map(move |(crossing, hold)| CrossingFriction {
            axial_n: hold.force.dot(&curve.tangent_at(crossing.alpha)),
            limit_n: hold.limit_n,
            slid_m: crossing.alpha - hold.alpha,
        })
    }

    pub fn new(part: &NeedlePart, settings: &NeedleSettings) -> Self {
        Self {
            pose: part.start,
            grip: None,
            history: History::new(settings.most_crossings),
            holds: Vec::with_capacity(settings.most_crossings),
            tip: Tip::Outside,
            touches: Vec::with_capacity(if part.body { MOST_TOUCHES } else { 0 }),
            is_near: true,
            hardest: None,
            left: None,
            log: Vec::with_capacity(LOG),
            log_skipped: 0,
            log_every: 0,
            next_id: 0,
            booked: part.start,
            tip_force: Vector3::zeros(),
            tally: Tally::default(),
            speed: 0.0,
            fall: Fall::default(),
        }
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        let Self {
            pose,
            grip,
            history,
            holds,
            tip,
            touches,
            is_near,
            hardest,
            left,
            log,
            log_skipped,
            log_every,
            next_id,
            booked,
            tip_force,
            tally,
            speed,
            fall,
        } = self;
        *pose = other.pose;
        *grip = other.grip;
        history.clone_from(&other.history);
        holds.clone_from(&other.holds);
        *tip = other.tip;
        touches.clone_from(&other.touches);
        *is_near = other.is_near;
        *hardest = other.hardest;
        *left = other.left;
        log.clone_from(&other.log);
        *log_skipped = other.log_skipped;
        *log_every = other.log_every;
        *next_id = other.next_id;
        *booked = other.booked;
        *tip_force = other.tip_force;
        *tally = other.tally;
        *speed = other.speed;
        *fall = other.fall;
    }

    /// Puts a needle that is in no tissue elsewhere, whatever lies in between; one that is in tissue stays in its holes.
    /// Whether it was put.
    pub fn put(&mut self, pose: Isometry3<f64>) -> bool {
        let holes = !self.history.crossings().is_empty() || self.history.before().is_some();
        if holes || matches!(self.tip, Tip::Inside { .. }) {
            return false;
        }
        self.pose = pose;
        self.booked = pose;
        self.tip = Tip::Waiting;
        self.tip_force = Vector3::zeros();
        self.left = None;
        self.log.clear();
        self.touches.clear();
        self.hardest = None;
        true
    }

    /// A number that no row of this needle had before.
    pub fn new_id(&mut self) -> u32 {
        self.next_id = self.next_id.wrapping_add(1);
        self.next_id
    }

    /// Gives crossings that have just come their [`Hold`]; one that is nearer than `apart_m` to the last that
    /// has rows, in the same tissue, has none.
    pub fn hold_new(&mut self, apart_m: f64) {
        while let Some(crossing) = self.history.crossings().get(self.holds.len()) {
            let (alpha, enters) = (crossing.alpha, crossing.enters);
            let leader = self.holds.iter().rposition(|hold| !hold.follows);
            let leader = leader.and_then(|leader| self.place_of(leader, 0));
            let follows = |(leader, _): &(f64, f64)| !enters && alpha - leader < apart_m;
            let hold = self.hold_of(alpha, leader.filter(follows), false);
            self.holds.push(hold);
        }
    }

    /// The same for crossings that have come at the end: one that is nearer than `apart_m` to the next that has rows goes with
    /// that.
    pub fn hold_front(&mut self, apart_m: f64) {
        loop {
            let crossings = self.history.crossings();
            let new = crossings.len() - self.holds.len();
            let Some(place) = new.checked_sub(1) else {
                return;
            };
            let alpha = crossings[place].alpha;
            let is_same = crossings.get(new).is_some_and(|next| !next.enters);
            let leader = self.holds.iter().position(|hold| !hold.follows);
            let leader = leader.and_then(|leader| self.place_of(leader, new));
            let follows = |(leader, _): &(f64, f64)| is_same && leader - alpha < apart_m;
            let hold = self.hold_of(alpha, leader.filter(follows), true);
            self.holds.insert(0, hold);
        }
    }

    /// Where a crossing is, and by how much it has slid in this balance \[m\]; so many that have no hold yet lie before all others.
    fn place_of(&self, hold: usize, before: usize) -> Option<(f64, f64)> {
        let alpha = self.history.crossings().get(before + hold)?.alpha;
        Some((alpha, alpha - self.holds.get(hold)?.alpha))
    }

    /// Of a crossing that has just come, with the one that it goes with: the next solve moves it by all that this one has slid.
    fn hold_of(&mut self, alpha: f64, leader: Option<(f64, f64)>, ahead: bool) -> Hold {
        Hold {
            id: self.new_id(),
            alpha: alpha - leader.map_or(0.0, |(_, slid)| slid),
            limit_n: 0.0,
            force: Vector3::zeros(),
            slides: false,
            follows: leader.is_some(),
            ahead: ahead && leader.is_some(),
        }
    }

    /// The crossing with rows that one without goes with.
    pub fn leader_of(&self, index: usize) -> Option<usize> {
        let leads = |place: &usize| !self.holds[*place].follows;
        if self.holds.get(index)?.ahead {
            (index + 1..self.holds.len()).find(leads)
        } else {
            (0..index).rev().find(leads)
        }
    }

    /// The crossing next to the tip is gone: where the one before went with that, it has rows.
    pub fn pop_hold(&mut self) {
        self.holds.pop();
        if let Some(last) = self.holds.last_mut().filter(|last| last.ahead) {
            (last.follows, last.ahead) = (false, false);
        }
    }

    /// The first crossings are gone: where the next went with one of them, it has rows.
    pub fn drop_holds(&mut self, count: usize) {
        let is_led = self.leader_of(count).is_some_and(|leader| leader >= count);
        self.holds.drain(..count);
        if let Some(first) = self.holds.first_mut() {
            first.follows &= is_led;
        }
    }

    /// Begins to log poses, from where the tip touched.
    pub fn begin_log(&mut self, first: Isometry3<f64>) {
        self.log.clear();
        self.log_skipped = 0;
        self.log_every = 0;
        self.log.push(first);
    }

    /// Logs the present pose; once there is no room, every other pose goes.
    pub fn log_pose(&mut self) {
        if self.log_skipped < self.log_every {
            self.log_skipped += 1;
            return;
        }
        self.log_skipped = 0;
        if self.log.len() == LOG {
            let mut index = 0;
            self.log.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.log_every = 2 * self.log_every + 1;
        }
        self.log.push(self.pose);
    }
}

/// With the same room, so that a copy does not allocate later either.
impl Clone for NeedleState {
    fn clone(&self) -> Self {
        let mut copy = Self {
            history: self.history.clone(),
            holds: Vec::with_capacity(self.history.most()),
            log: Vec::with_capacity(LOG),
            touches: Vec::with_capacity(self.touches.capacity()),
            ..*self
        };
        copy.copy_from(self);
        copy
    }
}
