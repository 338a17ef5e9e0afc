//! Ticks in which limits of the device took a part of the force away, as a session counts them.
//!
//! Entry points: [`LimitWatch::state`] for a console behind a port, [`LimitWatch::counted`] for one in this process, then
//! [`LimitWatch::ticks`].

use schemars::JsonSchema;
use serde::Serialize;
use std::ops::Add;
use sutura_shared::control::TicksLimited;

/// Asks a console in this process for its counts.
pub type ConsoleLimits = Box<dyn Fn() -> TicksLimited + Send>;

/// Part of the largest force from which on a state's force is one that was cut: a console says the force after the limit.
const CUT_FROM: f64 = 1.0 - 1e-4;
/// Ticks cut by force or power that a session may have and still be `ok`.
pub(super) const FEW: u64 = 10;

/// Ticks in which a limit of the device took a part of the force away, by limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct LimitedTicks {
    /// By the largest force of the grip, or the largest current of a motor; over a port, states whose force is the largest.
    pub force: u64,
    /// By the largest power; none over a port.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power: Option<u64>,
    /// By the fade towards the largest speed; none over a port.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<u64>,
    /// By the largest slew of a joint, as at every knock; none over a port.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slew: Option<u64>,
}

impl From<TicksLimited> for LimitedTicks {
    fn from(ticks: TicksLimited) -> Self {
        let some = |count: u32| Some(u64::from(count));
        LimitedTicks {
            force: ticks.force.into(),
            power: some(ticks.power),
            speed: some(ticks.speed),
            slew: some(ticks.slew),
        }
    }
}

impl Add for LimitedTicks {
    type Output = Self;

    /// Counts of two sessions together; what only one of them knows is that one's.
    fn add(self, other: Self) -> Self {
        let both = |a: Option<u64>, b: Option<u64>| match (a, b) {
            (Some(a), Some(b)) => Some(a + b),
            (a, b) => a.or(b),
        };
        LimitedTicks {
            force: self.force + other.force,
            power: both(self.power, other.power),
            speed: both(self.speed, other.speed),
            slew: both(self.slew, other.slew),
        }
    }
}

impl LimitedTicks {
    /// Whether force or power took away more than a session that is `ok` may have.
    pub fn are_many(&self) -> bool {
        self.force.max(self.power.unwrap_or(0)) > FEW
    }
}

/// Counts of a session: the console's own where it can be asked, else what its states say.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LimitWatch {
    /// Largest force of the device \[N\]; 0 where none is known.
    pub max_force_n: f64,
    /// States whose force is the largest.
    at_most: u64,
    own: Option<TicksLimited>,
}

impl LimitWatch {
    /// Counts a state whose force has this magnitude \[N\].
    pub fn state(&mut self, force_n: f64) {
        let is_cut = self.max_force_n > 0.0 && force_n >= CUT_FROM * self.max_force_n;
        self.at_most += u64::from(is_cut);
    }

    /// Takes the console's own counts of the session.
    pub fn counted(&mut self, own: TicksLimited) {
        self.own = Some(own);
    }

    /// Ticks so far.
    pub fn ticks(&self) -> LimitedTicks {
        let judged = LimitedTicks {
            force: self.at_most,
            ..LimitedTicks::default()
        };
        self.own.map_or(judged, LimitedTicks::from)
    }
}
