//! Ticks in which limits of the device, or its energy account, took a part of the force away, as a session counts them.
//!
//! Entry points: [`LimitWatch::state`] for a console behind a port, [`LimitWatch::counted`] for one in this process, then
//! [`LimitWatch::ticks`]; [`Cuts`] judges them.

use schemars::JsonSchema;
use serde::Serialize;
use std::cmp::Reverse;
use std::ops::Add;
use sutura_shared::control::TicksLimited;

/// Asks a console in this process for its counts.
pub type ConsoleLimits = Box<dyn Fn() -> TicksLimited + Send>;

/// Part of the largest force from which on a state's force is one that was cut: a console says the force after the limit.
const CUT_FROM: f64 = 1.0 - 1e-4;
/// Ticks cut by a limit that a session may have and still be `ok`.
const FEW: u64 = 10;
/// Felt peak over the solved one, below which slew and energy account took more than a session that is `ok` may lose.
const LEAST_FELT: f64 = 0.5;

/// Ticks in which a limit of the device took a part of the force away, by limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct LimitedTicks {
    /// By the largest force of the grip, or the largest current of a motor; over a port, states whose force is the largest.
    pub force: u64,
    /// Those of `force` that were cut by the largest current of a motor; none over a port.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current: Option<u64>,
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
            current: some(ticks.current),
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
            current: both(self.current, other.current),
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

/// Ticks in which a part of the force was taken away, with the largest forces of the session.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cuts {
    /// By limits of the device.
    pub limited: LimitedTicks,
    /// By the console's energy account.
    pub withheld: u64,
    /// Largest force on the grip \[N\].
    pub felt_n: f64,
    /// Largest force that steps found \[N\].
    pub solved_n: f64,
}

impl Cuts {
    /// Whether they took away more than a session that is `ok` may lose.
    pub fn are_many(&self) -> bool {
        self.limited.are_many() || self.slew() > 0 || self.withheld() > 0
    }

    /// Ticks cut by slew that count: a knock alone has some.
    fn slew(&self) -> u64 {
        self.counting(self.limited.slew.unwrap_or(0))
    }

    /// Ticks cut by the energy account that count: an outage alone has some.
    fn withheld(&self) -> u64 {
        self.counting(self.withheld)
    }

    /// That many if they are not few, and less than half of the force was felt; else none.
    fn counting(&self, ticks: u64) -> u64 {
        let is_little = self.felt_n < LEAST_FELT * self.solved_n;
        if is_little && ticks > FEW { ticks } else { 0 }
    }

    /// Names what took the force away, what did it most often first; none if that was little. `largest`: force \[N\] and power \[W\] of the device.
    pub fn words(&self, largest: [f32; 2]) -> Option<String> {
        let [force_n, power_w] = largest;
        let LimitedTicks {
            force,
            current,
            power,
            ..
        } = self.limited;
        let current = current.unwrap_or(0);
        let mut limits = [
            (
                format!("the device's largest force, {force_n} N,"),
                force.saturating_sub(current),
            ),
            ("the largest current of a motor".to_owned(), current),
            (
                format!("the device's largest power, {power_w} W,"),
                power.unwrap_or(0),
            ),
            ("the largest slew of a joint".to_owned(), self.slew()),
        ];
        limits.sort_by_key(|(_, ticks)| Reverse(*ticks));
        let mut said = String::new();
        for (limit, ticks) in limits.iter().filter(|(_, ticks)| *ticks > 0) {
            said += &match said.is_empty() {
                true => format!("{limit} cut the force off in {ticks} ticks"),
                false => format!(", {limit} in {ticks}"),
            };
        }
        let withheld = self.withheld();
        if withheld > 0 {
            let and = if said.is_empty() { "" } else { ", and " };
            said +=
                &format!("{and}force that no motion had paid for was withheld in {withheld} ticks");
        }
        self.are_many().then_some(said)
    }
}

/// Counts of a session: the console's own where it can be asked, else what its states say.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LimitWatch {
    /// Largest force of the device \[N\]; 0 where none is known.
    pub max_force_n: f32,
    /// Largest power of the device \[W\].
    pub max_power_w: f32,
    /// States whose force is the largest.
    at_most: u64,
    own: Option<TicksLimited>,
}

impl LimitWatch {
    /// Counts a state whose force has this magnitude \[N\].
    pub fn state(&mut self, force_n: f64) {
        let max_force_n = f64::from(self.max_force_n);
        let is_cut = max_force_n > 0.0 && force_n >= CUT_FROM * max_force_n;
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
