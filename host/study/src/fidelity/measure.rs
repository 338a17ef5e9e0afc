//! What a run says: errors against the truth, and whether it was stable.
//!
//! Entry points: [`errors`], [`steadiness`].

use super::run::{Record, Tick};
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::TICK_S;
use sutura_shared::wire::message::Mode;

/// Errors of the force on the hand, in percent of the largest true force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Errors {
    /// Largest true force \[N\]: 100 %.
    pub force_max_n: f64,
    /// Mean force acting in each tick against the true mean of that tick: root mean square.
    pub rms_pct: f64,
    /// The largest.
    pub peak_pct: f64,
    /// When that was \[s\].
    pub peak_at_s: f64,
    /// As `rms_pct`, of the force that was commanded for that tick: on a console that is as described it is the same.
    pub rms_pct_meant: f64,
    /// Command of each tick against the truth at its pose, without the motors' delay: root mean square.
    pub rms_pct_sampled: f64,
    /// Largest jump of the command, beyond the truth's own, in ticks that took a new frame.
    pub step_pct: f64,
    /// The same in all other ticks: noise of the encoders, for comparison.
    pub other_step_pct: f64,
}

/// Where a run starts to count \[s\]: after boot and the first frames.
const FROM_S: f64 = 0.1;

/// Errors of a run, from 0.1 s on, in the ticks that count.
fn errors_where(record: &Record, counts: &[bool]) -> Errors {
    let ticks = &record.ticks;
    let largest = ticks.iter().map(|t| length(t.truth_n)).fold(1e-9, f64::max);
    let mut sums = (0.0, 0.0, 0.0, 0.0);
    let mut errors = Errors {
        force_max_n: largest,
        rms_pct: 0.0,
        peak_pct: 0.0,
        peak_at_s: 0.0,
        rms_pct_meant: 0.0,
        rms_pct_sampled: 0.0,
        step_pct: 0.0,
        other_step_pct: 0.0,
    };
    let percent = 100.0 / largest;
    for (three, counts) in ticks.windows(3).zip(counts.iter().skip(1)) {
        let [before, now, after] = three else {
            continue;
        };
        if now.time_s < FROM_S || !counts {
            continue;
        }
        let mean = [0, 1, 2].map(|i: usize| 0.5 * (now.truth_n[i] + after.truth_n[i]));
        let error = length(minus(now.acting_n, mean));
        sums.0 += 1.0;
        sums.1 += error * error;
        sums.2 += length(minus(now.command_n, now.truth_n)).powi(2);
        sums.3 += length(minus(now.meant_n, mean)).powi(2);
        if error * percent > errors.peak_pct {
            errors.peak_pct = error * percent;
            errors.peak_at_s = now.time_s;
        }
        let jump = minus(now.command_n, before.command_n);
        let own = minus(now.truth_n, before.truth_n);
        let excess = length(minus(jump, own)) * percent;
        let step = if now.swapped {
            &mut errors.step_pct
        } else {
            &mut errors.other_step_pct
        };
        *step = step.max(excess);
    }
    let count: f64 = f64::max(sums.0, 1.0);
    errors.rms_pct = percent * (sums.1 / count).sqrt();
    errors.rms_pct_meant = percent * (sums.3 / count).sqrt();
    errors.rms_pct_sampled = percent * (sums.2 / count).sqrt();
    errors
}

/// Ticks on either side of a puncture that are left out: when it comes is a figure of its own.
const PUNCTURE_TICKS: usize = 20;

/// Errors of a run, from 0.1 s on, but for 20 ms on either side of a puncture.
pub fn errors(record: &Record) -> Errors {
    let ticks = &record.ticks;
    let mut quiet = vec![true; ticks.len()];
    for (index, pair) in ticks.windows(2).enumerate() {
        if pair[0].punctures != pair[1].punctures {
            let from = index.saturating_sub(PUNCTURE_TICKS);
            let until = (index + PUNCTURE_TICKS).min(quiet.len());
            quiet[from..until].fill(false);
        }
    }
    errors_where(record, &quiet)
}

/// What a held press looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steadiness {
    /// Swing of the force on the hand in the last half second, root mean square about its mean, in its
    /// true mean.
    pub swing: f64,
    /// That swing over the one of the half second before.
    pub growth: f64,
    /// Mean force on the hand over the true mean.
    pub force_ratio: f64,
    /// Whether no fault was latched.
    pub is_faultless: bool,
    /// Whether it counts as stable.
    pub is_stable: bool,
}

/// Largest swing of a stable hold: the least change of a force that a hand notices (7 to 10 %).
pub const STABLE_SWING: f64 = 0.10;
/// Least swing whose growth counts: below this it is the encoders' steps.
const QUIET_SWING: f64 = 0.03;
/// Growth within half a second that is no longer chance.
const GROWTH: f64 = 1.5;

/// Of a run that ends with a held press of at least a second.
///
/// Stable: in the last half second the force swings by at most a tenth of the true one, it does not swing more
/// than in the half second before (unless that is below 3 %), and no fault is latched.
pub fn steadiness(record: &Record) -> Steadiness {
    let ticks = &record.ticks;
    let last = &ticks[ticks.len().saturating_sub(500)..];
    let before = &ticks[ticks.len().saturating_sub(1000)..ticks.len().saturating_sub(500)];
    let mean = |ticks: &[Tick], of: fn(&Tick) -> f64| {
        ticks.iter().map(of).sum::<f64>() / ticks.len().max(1) as f64
    };
    let truth = mean(last, |t| length(t.truth_n)).max(1e-9);
    let force = mean(last, |t| t.acting_n[2]);
    let swing = |ticks: &[Tick]| {
        let middle = mean(ticks, |t| t.acting_n[2]);
        let squares = ticks.iter().map(|t| (t.acting_n[2] - middle).powi(2));
        (squares.sum::<f64>() / ticks.len().max(1) as f64).sqrt() / truth
    };
    let (now, then) = (swing(last), swing(before));
    let growth = now / then.max(1e-12);
    let faultless = ticks.iter().all(|t| t.faults == 0);
    let grows = growth > GROWTH && now > QUIET_SWING;
    Steadiness {
        swing: now,
        growth,
        force_ratio: force / truth,
        is_faultless: faultless,
        is_stable: now <= STABLE_SWING && !grows && faultless && now.is_finite(),
    }
}

/// When the punctures of a run are felt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Punctures {
    /// In truth.
    pub punctures: usize,
    /// Between the fall of the true force and that of the command, 19 of 20 are within this \[ms\].
    pub puncture_p95_ms: f64,
    /// The worst \[ms\].
    pub puncture_max_ms: f64,
    /// How far the fall of the command is off that of the true force, at worst, %.
    pub puncture_fall_off_pct: f64,
    /// Punctures at which the command falls by less than half as much.
    pub punctures_missed: usize,
}

/// Ticks in which a force falls when a boundary gives way.
const FALL_TICKS: usize = 3;
/// Ticks on either side of a true puncture in which the felt one is looked for.
const LOOK_TICKS: usize = 60;

/// A fall that is less than this part of the true one is no puncture.
const FELT: f64 = 0.5;

/// Of a run with any. Felt is a puncture where the force falls most in 3 ms.
pub fn punctures(record: &Record) -> Option<Punctures> {
    let ticks = &record.ticks;
    let mut off_ms: Vec<f64> = Vec::new();
    let (mut most_off, mut missed) = (0.0_f64, 0);
    for (index, pair) in ticks.windows(2).enumerate() {
        if pair[0].punctures == pair[1].punctures || pair[1].time_s < FROM_S {
            continue;
        }
        let from = index.saturating_sub(LOOK_TICKS);
        let until = (index + LOOK_TICKS).min(ticks.len());
        let window = &ticks[from..until];
        let fall = |of: fn(&Tick) -> [f64; 3]| {
            let falls = window.windows(FALL_TICKS + 1).enumerate();
            let falls = falls.map(|(at, t)| (at, length(of(&t[0])) - length(of(&t[FALL_TICKS]))));
            falls
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .map_or((0.0, 0.0), |(at, fall)| (at as f64, fall))
        };
        let (felt, truth) = (fall(|t| t.command_n), fall(|t| t.truth_n));
        off_ms.push((felt.0 - truth.0).abs());
        let part = felt.1 / truth.1.max(1e-9);
        most_off = most_off.max((part - 1.0).abs());
        missed += usize::from(part < FELT);
    }
    off_ms.sort_by(f64::total_cmp);
    let last = off_ms.last()?;
    let p95 = (0.95 * off_ms.len() as f64).ceil() as usize;
    Some(Punctures {
        punctures: off_ms.len(),
        puncture_p95_ms: off_ms[p95.saturating_sub(1).min(off_ms.len() - 1)],
        puncture_max_ms: *last,
        puncture_fall_off_pct: 100.0 * most_off,
        punctures_missed: missed,
    })
}

/// When a tool that is dragged is felt to slip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Slips {
    /// Turns of the way across the skin after which it slips in truth.
    pub onsets: usize,
    /// Between when the true force has turned and when the command has, 19 of 20 are within this \[ms\].
    pub onset_p95_ms: f64,
    /// The worst \[ms\].
    pub onset_max_ms: f64,
}

/// Part of the change of the force across the skin, from turn to turn of the way, after which it counts as slipping.
const SLIPPING: f64 = 0.9;

/// Of a run in which the tool is dragged to and fro along x: after each turn the force along x goes from one side to the
/// other, and onset is when 9/10 of that has come. None if it is never dragged back.
pub fn slips(record: &Record) -> Option<Slips> {
    let ticks = &record.ticks;
    let turns = ticks.windows(2).enumerate().filter_map(|(index, pair)| {
        let [from, to] = [&pair[0], &pair[1]].map(|tick| tick.velocity_m_per_s[0]);
        (from * to < 0.0 || (from != 0.0 && to == 0.0)).then_some(index)
    });
    let turns: Vec<usize> = turns.collect();
    let mut off_ms = Vec::new();
    for pair in turns.windows(2) {
        let way = &ticks[pair[0]..pair[1]];
        let (Some(first), true) = (way.first(), way.len() > SLIP_TICKS) else {
            continue;
        };
        let sign = -first.truth_n[0].signum();
        let along = |of: fn(&Tick) -> [f64; 3]| way.iter().map(move |tick| sign * of(tick)[0]);
        let most = along(|t| t.truth_n)
            .take(SLIP_TICKS)
            .fold(f64::MIN, f64::max);
        let from = sign * first.truth_n[0];
        let level = from + SLIPPING * (most - from);
        let when = |of: fn(&Tick) -> [f64; 3]| along(of).position(|force| force >= level);
        let (truth, felt) = (when(|t| t.truth_n)?, when(|t| t.command_n));
        off_ms.push(felt.map_or(way.len() as f64, |felt| (felt as f64 - truth as f64).abs()));
    }
    off_ms.sort_by(f64::total_cmp);
    let last = off_ms.last()?;
    let p95 = (0.95 * off_ms.len() as f64).ceil() as usize;
    Some(Slips {
        onsets: off_ms.len(),
        onset_p95_ms: off_ms[p95.saturating_sub(1).min(off_ms.len() - 1)],
        onset_max_ms: *last,
    })
}

/// Ticks after a turn in which a tool that is dragged at 0.1 m/s slips.
const SLIP_TICKS: usize = 150;

/// The most that the motors did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Peaks {
    /// \[N\].
    pub force_peak_n: f64,
    /// Of the force at the grip \[N/s\].
    pub slew_peak_n_per_s: f64,
    /// Part of the force across the line of the true one, while it grows \[N\].
    pub across_peak_n: f64,
    /// Force times velocity, out of or into the console \[W\].
    pub power_peak_w: f64,
    /// Of the grip while the amplifiers were on \[m/s\].
    pub speed_peak_m_per_s: f64,
    /// Most ticks in a row in which the amplifiers were on and the grip faster than it may be.
    pub ticks_too_fast: u32,
    /// Faults that were latched, bits.
    pub faults: u16,
}

/// The extremes of a run, with a grip that may be so fast \[m/s\].
pub fn peaks(record: &Record, fastest_m_per_s: f64) -> Peaks {
    let mut peaks = Peaks {
        force_peak_n: 0.0,
        slew_peak_n_per_s: 0.0,
        across_peak_n: 0.0,
        power_peak_w: 0.0,
        speed_peak_m_per_s: 0.0,
        ticks_too_fast: 0,
        faults: 0,
    };
    let mut before = [0.0; 3];
    let mut in_a_row = 0;
    for tick in &record.ticks {
        let on = matches!(tick.mode, Mode::Armed | Mode::Decaying);
        let force = length(tick.command_n);
        peaks.force_peak_n = peaks.force_peak_n.max(force);
        if force > length(before) {
            peaks.across_peak_n = peaks.across_peak_n.max(across(tick));
        }
        // To nothing at once is what a fault is for.
        if on {
            let slew = length(minus(tick.command_n, before)) / f64::from(TICK_S);
            peaks.slew_peak_n_per_s = peaks.slew_peak_n_per_s.max(slew);
            let speed = length(tick.velocity_m_per_s);
            peaks.speed_peak_m_per_s = peaks.speed_peak_m_per_s.max(speed);
            in_a_row = if speed > fastest_m_per_s {
                in_a_row + 1
            } else {
                0
            };
            peaks.ticks_too_fast = peaks.ticks_too_fast.max(in_a_row);
        }
        let pairs = tick.acting_n.iter().zip(&tick.velocity_m_per_s);
        let power: f64 = pairs.map(|(f, v)| f * v).sum();
        peaks.power_peak_w = peaks.power_peak_w.max(power.abs());
        peaks.faults |= tick.faults;
        before = tick.command_n;
    }
    peaks
}

/// Part of the command across the line of the true force \[N\].
fn across(tick: &Tick) -> f64 {
    let along = length(tick.truth_n);
    if along <= 0.0 {
        return 0.0;
    }
    let pairs = tick.command_n.iter().zip(&tick.truth_n);
    let share = pairs.map(|(f, t)| f * t).sum::<f64>() / (along * along);
    length(minus(tick.command_n, tick.truth_n.map(|t| t * share)))
}

pub(super) fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i: usize| a[i] - b[i])
}
