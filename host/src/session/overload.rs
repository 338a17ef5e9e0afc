//! What a host gives up that cannot keep its pace, in this order: looking ahead, contact rows, solves.
//!
//! Entry points: [`Overload::note`] after every solve, [`Overload::effort`] before the next. In real time only: in lockstep a
//! solve takes what it takes. What is given up comes back once solves are in time again.

use schemars::JsonSchema;
use serde::Serialize;
use std::time::Duration;

/// Solves in a row that are longer than their period before something is given up: one that was interrupted says little.
const LATE: u32 = 3;
/// Seconds in which every solve was in time before something comes back.
const CALM_S: f64 = 1.0;
/// Part of the period within which a solve must be for that.
const IN_TIME: f64 = 0.8;

/// What solves are to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effort {
    /// All of it.
    #[default]
    Full,
    /// Nothing is looked at ahead of the hand, and its way between two states that are far apart is not followed closer.
    NoLooks,
    /// Nor is the contact reduced to rows: the console renders from the tangent.
    NoRows,
}

/// What a solver does without at an [`Effort`]: only what it would do at a full one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spared {
    /// It does not look ahead.
    pub looks: bool,
    /// It reduces no contact to rows.
    pub rows: bool,
}

/// `overload` in a session's summary: solves that gave something up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct GivenUp {
    /// That did not look ahead.
    pub looks: u64,
    /// That had no rows either.
    pub rows: u64,
    /// That were not made because one before was still under way.
    pub solves: u64,
}

/// Watches solves.
#[derive(Clone, Debug)]
pub(super) struct Overload {
    period: Duration,
    effort: Effort,
    /// What has been said: that looks are given up, rows, the rate.
    said: [bool; 3],
    late: u32,
    in_time: u32,
    calm: u32,
    given_up: GivenUp,
}

impl Overload {
    /// Of solves that are planned `host_hz` times a second.
    pub fn new(host_hz: f64) -> Self {
        Overload {
            period: Duration::try_from_secs_f64(1.0 / host_hz).unwrap_or(Duration::MAX),
            effort: Effort::Full,
            said: [false; 3],
            late: 0,
            in_time: 0,
            calm: (CALM_S * host_hz).ceil().max(1.0) as u32,
            given_up: GivenUp::default(),
        }
    }

    /// What the next solve is to do.
    pub fn effort(&self) -> Effort {
        self.effort
    }

    /// Takes note of a solve and all that belongs to it, which took `time` and was done without what is `spared`, and of the
    /// solves that were due in it. Words for what is given up, the first time that it is.
    pub fn note(&mut self, time: Duration, missed: u64, spared: Spared) -> Option<&'static str> {
        self.given_up.looks += u64::from(spared.looks);
        self.given_up.rows += u64::from(spared.rows);
        self.given_up.solves += missed;
        let is_late = time > self.period;
        self.late = if is_late { self.late + 1 } else { 0 };
        self.in_time = if time <= self.period.mul_f64(IN_TIME) {
            self.in_time + 1
        } else {
            0
        };
        if self.in_time >= self.calm && self.effort > Effort::Full {
            self.in_time = 0;
            self.effort = match self.effort {
                Effort::NoRows => Effort::NoLooks,
                _ => Effort::Full,
            };
        }
        let is_all = self.effort == Effort::NoRows && self.late >= LATE;
        if self.late >= LATE && !is_all {
            self.late = 0;
            self.effort = match self.effort {
                Effort::Full => Effort::NoLooks,
                _ => Effort::NoRows,
            };
        }
        self.words([spared.looks, spared.rows, is_all])
    }

    /// Words for the last of these that has not been said yet.
    fn words(&mut self, is_given_up: [bool; 3]) -> Option<&'static str> {
        const WORDS: [&str; 3] = [
            "solves take longer than their period: looking ahead is given up first",
            "solves still take longer than their period: contact rows are given up, the console renders from tangents",
            "solves take longer than their period, and nothing else can be given up: the rate falls",
        ];
        let mut news = None;
        for ((said, is), words) in self.said.iter_mut().zip(is_given_up).zip(WORDS) {
            if is && !*said {
                *said = true;
                news = Some(words);
            }
        }
        news
    }

    /// What was given up so far.
    pub fn given_up(&self) -> GivenUp {
        self.given_up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> Duration = Duration::from_millis;

    /// A solver that does without both as it is told.
    fn both(effort: Effort) -> Spared {
        Spared {
            looks: effort >= Effort::NoLooks,
            rows: effort >= Effort::NoRows,
        }
    }

    #[test]
    fn things_are_given_up_in_order_and_come_back_in_the_other() {
        let mut overload = Overload::new(100.0);
        let mut words = 0;
        let mut solves = |overload: &mut Overload, count: u32, time| {
            for _ in 0..count {
                let spared = both(overload.effort());
                words += u32::from(overload.note(time, 0, spared).is_some());
            }
            words
        };
        // One late solve now and then is none.
        for _ in 0..50 {
            solves(&mut overload, 2, MS(30));
            assert_eq!(solves(&mut overload, 1, MS(2)), 0);
        }
        assert_eq!(overload.effort(), Effort::Full);
        assert_eq!(solves(&mut overload, 3, MS(11)), 0);
        assert_eq!(overload.effort(), Effort::NoLooks);
        assert_eq!(solves(&mut overload, 3, MS(11)), 1);
        assert_eq!(overload.effort(), Effort::NoRows);
        assert_eq!(solves(&mut overload, 1, MS(11)), 2);
        assert_eq!(solves(&mut overload, 49, MS(11)), 3);
        solves(&mut overload, 99, MS(2));
        assert_eq!(overload.effort(), Effort::NoRows);
        solves(&mut overload, 1, MS(2));
        assert_eq!(overload.effort(), Effort::NoLooks);
        solves(&mut overload, 100, MS(2));
        assert_eq!(overload.effort(), Effort::Full);
        // It is said once.
        assert_eq!(solves(&mut overload, 9, MS(11)), 3);
        let given_up = overload.given_up();
        assert_eq!((given_up.looks, given_up.rows), (3 + 150 + 100 + 6, 153));
    }

    /// A model has neither looks nor rows.
    #[test]
    fn what_cannot_be_given_up_is_neither_counted_nor_said() {
        let mut overload = Overload::new(100.0);
        let mut note = || overload.note(MS(30), 2, Spared::default());
        let words: Vec<_> = (0..20).filter_map(|_| note()).collect();
        assert_eq!(words.len(), 1);
        assert!(words[0].contains("nothing else"), "{words:?}");
        let expected = GivenUp {
            solves: 40,
            ..GivenUp::default()
        };
        assert_eq!(overload.given_up(), expected);
    }

    #[test]
    fn solves_that_were_due_in_a_longer_one_are_counted() {
        let mut overload = Overload::new(200.0);
        overload.note(MS(61), 12, Spared::default());
        overload.note(MS(1), 0, Spared::default());
        assert_eq!(overload.given_up().solves, 12);
        assert_eq!(overload.effort(), Effort::Full);
    }
}
