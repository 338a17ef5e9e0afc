//! What a hand would notice of a run, and what its motors gave back: figures that a light touch cannot hide in.
//!
//! Entry points: [`noticed`], [`given_back_j`]. Unlike errors in percent of the largest force these are counted in time:
//! contact in which the force is off by more than a finger notices, and dropouts.

use super::run::{Record, Tick};
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::TICK_S;

/// The least change of a force that a finger notices, in the force (7 to 10 %), and what it never does \[N\].
const NOTICE: f64 = 0.10;
const NOTICE_N: f64 = 30e-3;
/// A dropout: less than this part of the true force, for longer than so many ticks. What is less than a finger notices at
/// all cannot drop out.
const DROPPED: f64 = 0.5;
const DROPPED_TICKS: usize = 10;
/// The window of the energy \[ticks\].
const WINDOW_TICKS: usize = 100;
/// Where a run starts to count \[s\]: after boot and the first frames.
const FROM_S: f64 = 0.1;

/// What a hand notices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Noticed {
    /// Time in contact \[s\]: where there is a true force, or one that is felt.
    pub contact_s: f64,
    /// Part of it in which what was commanded is off by more than 10 % of the true force and 30 mN, in percent.
    pub beyond_pct: f64,
    /// How often it is below half of the true force for more than 10 ms.
    pub dropouts: u32,
    /// That in a minute of contact.
    pub dropouts_per_min: f64,
    /// In 19 of 20 ticks in which both forces are more than a finger feels at least, the angle between them is at most
    /// this \[degree\].
    pub direction_p95_deg: f64,
}

/// Of what was commanded for each tick of a run against the true mean of that tick, from 0.1 s on.
pub fn noticed(record: &Record) -> Noticed {
    let mut found = Noticed::default();
    let (mut contact, mut beyond, mut low) = (0_usize, 0_usize, 0_usize);
    let mut angles = Vec::new();
    for pair in record.ticks.windows(2) {
        let [tick, after] = pair else { continue };
        if tick.time_s < FROM_S {
            continue;
        }
        let truth_n = [0, 1, 2].map(|i: usize| 0.5 * (tick.truth_n[i] + after.truth_n[i]));
        let (truth, command) = (length(truth_n), length(tick.meant_n));
        let off = length([0, 1, 2].map(|i: usize| tick.meant_n[i] - truth_n[i]));
        contact += usize::from(truth > 0.0 || command > NOTICE_N);
        beyond += usize::from(off > NOTICE * truth + NOTICE_N);
        // Along the true force: what pushes elsewhere does not hold up.
        let along: f64 = tick.meant_n.iter().zip(&truth_n).map(|(f, t)| f * t).sum();
        if truth > NOTICE_N && command > NOTICE_N {
            angles.push(
                (along / (truth * command))
                    .clamp(-1.0, 1.0)
                    .acos()
                    .to_degrees(),
            );
        }
        let is_low = truth > NOTICE_N / DROPPED && along < DROPPED * truth * truth;
        low = if is_low { low + 1 } else { 0 };
        found.dropouts += u32::from(low == DROPPED_TICKS + 1);
    }
    angles.sort_by(f64::total_cmp);
    let p95 = (0.95 * angles.len() as f64).ceil() as usize;
    found.direction_p95_deg = angles.get(p95.saturating_sub(1)).copied().unwrap_or(0.0);
    let tick_s = f64::from(TICK_S);
    found.contact_s = contact as f64 * tick_s;
    found.beyond_pct = 100.0 * beyond as f64 / contact.max(1) as f64;
    found.dropouts_per_min = 60.0 * f64::from(found.dropouts) / found.contact_s.max(tick_s);
    found
}

/// Most energy that the motors gave to the grip in 100 ms beyond what the true tissue gave on the same way in the same
/// 100 ms \[J\]; 0 if never.
///
/// Each tick's work counts by itself: what motors or tissue take in, by friction, damping or springs, is spent and no
/// credit for another tick.
pub fn given_back_j(record: &Record) -> f64 {
    most_in_a_window(record, &excess_j)
}

/// The same of the ticks that count.
pub fn given_back_where_j(record: &Record, counts: &dyn Fn(&Tick) -> bool) -> f64 {
    most_in_a_window(record, &|pair| match pair {
        [now, _] if counts(now) => excess_j(pair),
        _ => 0.0,
    })
}

/// The same, if motors that are so many times as strong as described were as described: what the console could know of.
pub fn given_back_as_described_j(record: &Record, torque: f64) -> f64 {
    most_in_a_window(record, &|pair| given_j(pair) / torque - true_j(pair))
}

fn most_in_a_window(record: &Record, work_j: &dyn Fn(&[Tick]) -> f64) -> f64 {
    let works: Vec<f64> = record.ticks.windows(2).map(work_j).collect();
    let mut sum = works.iter().take(WINDOW_TICKS).sum::<f64>();
    let mut most = sum.max(0.0);
    for (leaves, comes) in works.iter().zip(works.iter().skip(WINDOW_TICKS)) {
        sum += comes - leaves;
        most = most.max(sum);
    }
    most
}

/// What the motors gave in the first of two ticks, less what the true tissue gave \[J\].
pub(super) fn excess_j(pair: &[Tick]) -> f64 {
    given_j(pair) - true_j(pair)
}

/// What the motors gave in the first of two ticks \[J\]; what they took is none.
fn given_j(pair: &[Tick]) -> f64 {
    let [now, after] = pair else { return 0.0 };
    (now.energy_j - after.energy_j).max(0.0)
}

/// The same of the true tissue on the same way.
fn true_j(pair: &[Tick]) -> f64 {
    let [now, after] = pair else { return 0.0 };
    let work = |i: usize| {
        let way = after.position_m[i] - now.position_m[i];
        0.5 * (now.truth_n[i] + after.truth_n[i]) * way
    };
    (0..3).map(work).sum::<f64>().max(0.0)
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::wire::message::Mode;

    /// A second of a true force along z and of a command, by time.
    fn record(of: impl Fn(f64) -> (f64, f64)) -> Record {
        let tick = |number: u32| {
            let time_s = f64::from(number) * 1e-3;
            let (truth, command) = of(time_s);
            Tick {
                time_s,
                position_m: [0.0; 3],
                velocity_m_per_s: [0.0; 3],
                acting_n: [0.0, 0.0, command],
                command_n: [0.0, 0.0, command],
                meant_n: [0.0, 0.0, command],
                truth_n: [0.0, 0.0, truth],
                punctures: 0,
                swapped: false,
                energy_j: 0.0,
                mode: Mode::Armed,
                faults: 0,
            }
        };
        Record {
            ticks: (0..=1100).map(tick).collect(),
            least_energy_j: 0.0,
            sent: 0,
        }
    }

    #[test]
    fn beyond_notice_is_a_tenth_and_30_mn() {
        // 1 N: 130 mN are the limit. 0.1 N: 40 mN.
        for (truth, command, percent) in [
            (1.0, 1.129, 0.0),
            (1.0, 0.869, 100.0),
            (0.1, 0.139, 0.0),
            (0.1, 0.141, 100.0),
        ] {
            let found = noticed(&record(|_| (truth, command)));
            assert_eq!(found.beyond_pct, percent, "{truth} {command}");
            assert!((found.contact_s - 1.0).abs() < 1e-6);
        }
        // A quarter of the contact, which is half of the time.
        let part = noticed(&record(|t| match t {
            t if t < 0.6 => (0.0, 0.0),
            t if t < 0.725 => (1.0, 0.0),
            _ => (1.0, 1.0),
        }));
        assert!((part.beyond_pct - 25.0).abs() < 0.3, "{part:?}");
        assert!((part.contact_s - 0.5).abs() < 2e-3);
        assert_eq!(part.dropouts, 1);
        // Before the first frames nothing counts.
        let early = noticed(&record(|t| (1.0, f64::from(t > 0.0995))));
        assert_eq!((early.beyond_pct, early.dropouts), (0.0, 0));
    }

    /// A force where there should be none is contact, too, and off.
    #[test]
    fn what_pushes_in_the_air_is_noticed() {
        let found = noticed(&record(|t| (0.0, if t < 0.6 { 0.5 } else { 0.0 })));
        assert_eq!(found.beyond_pct, 100.0);
        assert_eq!(found.dropouts, 0);
    }

    #[test]
    fn a_dropout_is_longer_than_10_ms_and_counts_once() {
        let gap = |ticks: f64| {
            let low = move |t: f64| (0.5..0.5 + ticks * 1e-3 - 1e-9).contains(&t);
            noticed(&record(|t| (1.0, if low(t) { 0.49 } else { 1.0 }))).dropouts
        };
        assert_eq!([gap(10.0), gap(11.0), gap(300.0)], [0, 1, 1]);
        let two = noticed(&record(|t| (1.0, if t % 0.5 > 0.25 { 0.0 } else { 1.0 })));
        assert_eq!(two.dropouts, 2);
        assert!((two.dropouts_per_min - 120.0).abs() < 0.2);
        // The other way is no support.
        assert_eq!(noticed(&record(|_| (1.0, -1.0))).dropouts, 1);
        // Below what a finger notices at all.
        assert_eq!(noticed(&record(|_| (0.05, 0.0))).dropouts, 0);
    }

    /// Nine in ten at 30 degrees, and one in ten the other way.
    #[test]
    fn directions_count_by_their_angle() {
        let mut turned = record(|_| (1.0, 1.0));
        for (number, tick) in turned.ticks.iter_mut().enumerate() {
            tick.meant_n = [1.0, 0.0, 3.0_f64.sqrt()];
            if number % 10 == 0 {
                tick.meant_n = [0.0, 0.0, -1.0];
            }
        }
        assert!((noticed(&turned).direction_p95_deg - 180.0).abs() < 1e-9);
        for tick in turned.ticks.iter_mut().step_by(10).skip(1).step_by(2) {
            tick.meant_n = [1.0, 0.0, 3.0_f64.sqrt()];
        }
        assert!((noticed(&turned).direction_p95_deg - 30.0).abs() < 1e-6);
    }

    /// A tick moves by a tenth of a millimetre, out where `out`, under these forces.
    fn moved(of: impl Fn(usize) -> (bool, f64, f64)) -> Record {
        let mut found = record(|_| (0.0, 0.0));
        let (mut place, mut energy) = (0.0, 0.0);
        for (number, tick) in found.ticks.iter_mut().enumerate() {
            let (out, truth, acting) = of(number);
            let way = if out { 1e-4 } else { -1e-4 };
            tick.position_m[2] = place;
            tick.energy_j = energy;
            tick.truth_n[2] = truth;
            place += way;
            energy -= acting * way;
        }
        found
    }

    #[test]
    fn what_the_true_tissue_gives_back_too_is_no_fault() {
        let near = |found: f64, expected: f64| {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        };
        // 100 ticks of 0.1 mm at 2 N more than the truth.
        let strong = moved(|_| (true, 1.0, 3.0));
        near(given_back_j(&strong), 100.0 * 2e-4);
        near(given_back_as_described_j(&strong, 3.0), 0.0);
        near(given_back_as_described_j(&strong, 1.5), 100.0 * 1e-4);
        near(given_back_j(&moved(|_| (true, 1.0, 1.0))), 0.0);
        // Only 30 of them.
        let short = |n: usize| (true, 0.0, f64::from(u8::from((500..530).contains(&n))));
        near(given_back_j(&moved(short)), 30.0 * 1e-4);
    }

    /// Friction before, beside and after what is given back pays for nothing.
    #[test]
    fn what_is_spent_is_no_credit() {
        // Every other tick takes five times what the next one gives.
        let rubbed = |n: usize| {
            if n.is_multiple_of(2) {
                (true, 0.0, 1.0)
            } else {
                (true, 0.0, -5.0)
            }
        };
        let found = given_back_j(&moved(rubbed));
        assert!((found - 50.0 * 1e-4).abs() < 1e-9, "{found}");
        // The truth's own friction is no excuse for the motors, either.
        let found = given_back_j(&moved(|_| (true, -3.0, 1.0)));
        assert!((found - 100.0 * 1e-4).abs() < 1e-9, "{found}");
    }
}
