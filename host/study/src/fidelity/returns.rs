//! How a force comes back in a held press: after an outage of the link, and when a console is armed inside the tissue.
//!
//! Entry points: [`spec`], [`specs`], [`Returned::of`]. The hand has sunk in meanwhile and has paid nothing for it, so that its way
//! back out is a gift. What counts: how soon 90 % of the true force are there, how fast they come, what the motors give for
//! it, and how far the hand is thrown past where it rests with the same console and a host that is never late.

use super::case::{Place, Question, Scenes, Spec};
use super::corners::HANDS;
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::measure::length;
use super::notice::{excess_j, given_back_where_j};
use super::run::{Record, Tick};
use super::switches::Mendings;
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::{Guards, Rendering};
use sutura_shared::device::DeviceError;
use sutura_shared::wire::message::Mode;

/// What has taken the force away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Away {
    /// No frame comes for so long \[ms\], in a press by 10 mm.
    Outage(u16),
    /// The console is not armed until the hand is 6 mm deep.
    Unarmed,
}

/// All of them: shorter than any horizon's decay, and up to where a console disarms.
const AWAYS: [Away; 5] = [
    Away::Outage(100),
    Away::Outage(200),
    Away::Outage(300),
    Away::Outage(500),
    Away::Unarmed,
];
/// When an outage begins, and when a console is armed inside \[s\]: everything is at rest.
const GONE_AT_S: f64 = 1.5;
const ARMED_AT_S: f64 = 1.0;
/// For how long is watched from then on that frames come or the console is armed \[s\].
const WATCHED_S: f64 = 1.5;
/// Rates of the host \[1/s\].
const RATES: [f64; 2] = [30.0, 60.0];

/// A force is back with so much of the true one.
const BACK: f64 = 0.9;
/// It may take so long \[s\]: a second, or a quarter and a rise at this rate \[N/s\].
const ALLOWED_S: (f64, f64) = (1.0, 0.25);
/// Largest rate of a force that comes back \[N/s\].
pub const RISE_N_PER_S: f64 = 5.0;
/// Rises are measured over so many ticks: an encoder's step on a stiff place is 10 mN.
const RISE_TICKS: usize = 20;
/// What is given to the hand counts for so long \[s\], and instead of what is given back in 100 ms.
const GIVEN_S: f64 = 1.0;

impl Away {
    /// As tables print it.
    pub fn word(self) -> String {
        match self {
            Away::Outage(ms) => format!("outage-{ms}-ms"),
            Away::Unarmed => "armed-inside".to_owned(),
        }
    }

    /// From when on the force may come back \[s\].
    fn until_s(self) -> f64 {
        match self {
            Away::Outage(ms) => GONE_AT_S + 1e-3 * f64::from(ms),
            Away::Unarmed => ARMED_AT_S,
        }
    }

    /// When the console is told to arm \[s\].
    pub(super) fn arms_s(self) -> f64 {
        match self {
            Away::Outage(_) => 0.0,
            Away::Unarmed => ARMED_AT_S,
        }
    }
}

/// One case.
pub fn spec(place: Place, grasp: Grasp, away: Away, host_hz: f64) -> Spec {
    let ideal = LinkSpec::ideal(host_hz);
    let (motion, link) = match away {
        Away::Unarmed => (Motion::Inside, ideal),
        Away::Outage(ms) => {
            let burst = LinkSpec {
                burst_every_s: away.until_s(),
                burst_s: 1e-3 * f64::from(ms),
                ..ideal
            };
            (Motion::Hold, burst)
        }
    };
    Spec {
        question: Question::Return(away),
        grasp,
        link,
        seconds: away.until_s() + WATCHED_S,
        ..Spec::errors(place, motion, Rendering::Rows, host_hz)
    }
}

/// The tissues: a point of it and a body.
const PLACES: [Place; 2] = [Place::Point, Place::Palpation];

fn on(place: Place) -> Vec<Spec> {
    let [light, pen, firm, ..] = HANDS;
    let mut specs = Vec::new();
    for grasp in [light, pen, firm, Grasp::Rigid] {
        for away in AWAYS {
            specs.extend(RATES.map(|hz| spec(place, grasp, away, hz)));
        }
    }
    specs
}

/// All of them: on all tissues, with hands of 50, 200 and 800 N/m and a rigid one.
pub fn specs() -> Vec<Spec> {
    PLACES.into_iter().flat_map(on).collect()
}

/// The worst of each kind that is known, for the short form; what is solved by a formula costs nothing.
pub fn known_worst() -> Vec<Spec> {
    let [light, pen, firm, ..] = HANDS;
    let mut specs = on(Place::Point);
    let outage = Away::Outage;
    specs.extend([
        spec(Place::Palpation, Grasp::Rigid, outage(500), 60.0),
        spec(Place::Palpation, light, outage(100), 60.0),
        spec(Place::Palpation, pen, outage(100), 60.0),
        spec(Place::Palpation, firm, outage(300), 30.0),
    ]);
    specs
}

/// Where the hand of a case rests with the same console on a host that solves every millisecond, without delay \[m\].
///
/// # Errors
/// Mechanics that make no valid device.
pub(super) fn rest_m(spec: &Spec, scenes: &Scenes) -> Result<f64, DeviceError> {
    let never_late = Spec {
        question: Question::Errors,
        link: LinkSpec::IMMEDIATE,
        guards: Guards::ALL,
        mendings: Mendings::ALL,
        seconds: GONE_AT_S,
        ..*spec
    };
    let record = never_late.path(scenes)?;
    let last = record.ticks.iter().rev().take(250);
    let (sum, count) = last.fold((0.0, 0.0), |(sum, count), tick| {
        (sum + tick.position_m[2], count + 1.0)
    });
    Ok(sum / f64::max(count, 1.0))
}

/// What came back, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Returned {
    /// Force on the hand before it came back \[N\].
    pub gone_force_n: f64,
    /// True force at the place where it is back \[N\].
    pub returning_n: f64,
    /// From the first frame after an outage, or from arming, until at least 90 % of the true force are commanded, for good \[ms\];
    /// none if they never are.
    pub time_to_90_ms: Option<f64>,
    /// That in what it may take.
    pub time_of_allowed: Option<f64>,
    /// Most that the command rises meanwhile, in 20 ms \[N/s\].
    pub rise_n_per_s: f64,
    /// Most that the motors have given to the hand at any time in the first second beyond what the true tissue gives on
    /// the same way \[mJ\].
    pub beyond_true_mj: f64,
    /// The same without what the tissue gives, less what the motors took \[mJ\].
    pub handed_out_mj: f64,
    /// Most that they gave back in 100 ms beyond the true tissue at all other times \[mJ\].
    pub given_back_else_mj: f64,
    /// How far the hand comes out past where it rests \[mm\].
    pub past_rest_mm: f64,
}

impl Returned {
    /// Of a run of [`spec`], whose hand rests at a height of `rest_m`.
    pub fn of(record: &Record, away: Away, rest_m: f64) -> Self {
        let ticks = &record.ticks;
        let is_back = |tick: &Tick| {
            tick.time_s >= away.until_s() - 1e-9
                && match away {
                    Away::Outage(_) => tick.swapped,
                    Away::Unarmed => tick.mode == Mode::Armed,
                }
        };
        let from = ticks.iter().position(is_back).unwrap_or(ticks.len());
        let (before, after) = ticks.split_at(from);
        let low = after.iter().rposition(|tick| !is_there(tick));
        let back = low.map_or(0, |low| low + 1);
        let time_s = after.get(back).map(|_| 1e-3 * back as f64);
        let returning_n = after
            .get(back)
            .or(after.last())
            .map_or(0.0, |tick| length(tick.truth_n));
        let (least_s, more_s) = ALLOWED_S;
        let allowed_s = f64::max(least_s, more_s + returning_n / RISE_N_PER_S);
        let from_s = after.first().map_or(f64::INFINITY, |tick| tick.time_s);
        let given_until_s = from_s + GIVEN_S;
        let second = &after[..after.len().min((1e3 * GIVEN_S) as usize + 1)];
        let mut beyond_j = 0.0;
        let beyond_j = second.windows(2).fold(0.0, |most: f64, pair| {
            beyond_j += excess_j(pair);
            most.max(beyond_j)
        });
        let given_j = |tick: &Tick| second.first().map_or(0.0, |at| at.energy_j - tick.energy_j);
        let else_j =
            given_back_where_j(record, &|t| t.time_s < from_s || t.time_s >= given_until_s);
        Returned {
            gone_force_n: before.last().map_or(0.0, |tick| length(tick.acting_n)),
            returning_n,
            time_to_90_ms: time_s.map(|time_s| 1e3 * time_s),
            time_of_allowed: time_s.map(|time_s| time_s / allowed_s),
            rise_n_per_s: rise_n_per_s(
                &ticks[from.saturating_sub(1)..(from + back).min(ticks.len())],
            ),
            beyond_true_mj: 1e3 * beyond_j,
            handed_out_mj: 1e3 * second.iter().map(given_j).fold(0.0, f64::max),
            given_back_else_mj: 1e3 * else_j,
            past_rest_mm: after
                .iter()
                .map(|tick| 1e3 * (tick.position_m[2] - rest_m))
                .fold(0.0, f64::max),
        }
    }
}

/// Whether enough of the true force at that place is commanded, along it.
fn is_there(tick: &Tick) -> bool {
    let pairs = tick.command_n.iter().zip(&tick.truth_n);
    let along: f64 = pairs.map(|(command, truth)| command * truth).sum();
    along >= BACK * length(tick.truth_n).powi(2)
}

/// Most that the command rises within these ticks \[N/s\].
fn rise_n_per_s(ticks: &[Tick]) -> f64 {
    let windows = ticks.windows(RISE_TICKS + 1);
    let rises = windows.filter_map(|window| match window {
        [first, .., last] => Some(length(last.command_n) - length(first.command_n)),
        _ => None,
    });
    rises.fold(0.0, f64::max) / (1e-3 * RISE_TICKS as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hold of 2 N that an outage of 300 ms has taken away, whose frames are back 20 ms later; then the command is `of` the
    /// time since, at a height of `at` \[m\] then.
    fn record(of: impl Fn(f64) -> f64, at: impl Fn(f64) -> f64) -> Record {
        let mut energy_j = 0.0;
        let mut before_m = 0.0;
        let tick = |number: u32| {
            let time_s = 1e-3 * f64::from(number);
            let since_s = 1e-3 * (f64::from(number) - 1820.0);
            let command = if time_s < 1.6 { 2.0 } else { of(since_s) };
            let height_m = at(since_s);
            energy_j -= command * (height_m - before_m);
            before_m = height_m;
            Tick {
                time_s,
                position_m: [0.0, 0.0, height_m],
                velocity_m_per_s: [0.0; 3],
                acting_n: [0.0, 0.0, command],
                command_n: [0.0, 0.0, command],
                meant_n: [0.0, 0.0, command],
                truth_n: [0.0, 0.0, 2.0],
                punctures: 0,
                swapped: number.is_multiple_of(20) && !(1500..1820).contains(&number),
                energy_j,
                mode: Mode::Armed,
                faults: 0,
            }
        };
        Record {
            ticks: (0..3300).map(tick).collect(),
            least_energy_j: 0.0,
            sent: 0,
        }
    }

    #[test]
    fn it_counts_from_the_first_frame() {
        let rising = record(|s| (4.0 * s).clamp(0.0, 2.0), |_| 0.0);
        let found = Returned::of(&rising, Away::Outage(300), 0.0);
        // 1.8 N at 4 N/s, of a second.
        assert_eq!(found.time_to_90_ms, Some(450.0));
        assert_eq!(found.time_of_allowed, Some(0.45));
        assert!((found.rise_n_per_s - 4.0).abs() < 1e-6, "{found:?}");
        assert_eq!((found.gone_force_n, found.returning_n), (0.0, 2.0));
        assert_eq!((found.handed_out_mj, found.past_rest_mm), (0.0, 0.0));
    }

    #[test]
    fn what_does_not_stay_is_not_back() {
        let lost = |s: f64| f64::from(u8::from(s > 0.0 && !(1.0..1.1).contains(&s))) * 2.0;
        let found = Returned::of(&record(lost, |_| 0.0), Away::Outage(300), 0.0);
        assert_eq!(found.time_to_90_ms, Some(1100.0));
        assert!(found.time_of_allowed > Some(1.0) && found.rise_n_per_s > 99.0);
        let never = Returned::of(&record(|_| 1.0, |_| 0.0), Away::Outage(300), 0.0);
        assert_eq!((never.time_to_90_ms, never.time_of_allowed), (None, None));
    }

    /// 5 mm in half a second, at 3 N where the tissue has 2 N.
    #[test]
    fn what_pushes_out_is_given() {
        let out = |s: f64| 5e-3 * (2.0 * s).clamp(0.0, 1.0);
        let found = Returned::of(&record(|_| 3.0, out), Away::Outage(300), 4e-3);
        assert!((found.handed_out_mj - 15.0).abs() < 0.1, "{found:?}");
        assert!((found.beyond_true_mj - 5.0).abs() < 0.1, "{found:?}");
        assert!(found.given_back_else_mj < 1e-9);
        assert!((found.past_rest_mm - 1.0).abs() < 1e-9);
    }
}
