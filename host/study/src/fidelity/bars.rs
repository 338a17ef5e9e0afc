//! The bars that the published cases must meet.
//!
//! Entry point: [`bars`].

use super::case::Case;
use super::hand::Motion;
use super::plant::Mechanics;
use super::scenes::rogue::Rogue;
use super::suite::{FAST_RATES, RATES, SLOW_HZ};
use super::targets::{self, LEAST_ENERGY_MJ};
use schemars::JsonSchema;
use serde::Serialize;

/// A figure and what it must be.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Bar {
    /// What.
    pub name: String,
    /// Of the worst case.
    pub value: f64,
    /// `<=` or `>=`.
    pub must_be: &'static str,
    /// The bound.
    pub bar: f64,
    /// Whether it is met.
    pub ok: bool,
    /// Missed, and known to be: nothing fails for it until it is met.
    pub open: bool,
    /// The worst case.
    pub worst: String,
}

/// A bound on one figure of some cases.
struct Rule<'a> {
    name: String,
    /// Whether a case counts.
    counts: &'a dyn Fn(&Case) -> bool,
    figure: &'a dyn Fn(&Case) -> Option<f64>,
    at_least: bool,
    bar: f64,
}

impl Rule<'_> {
    /// None if no case counts.
    fn judge(&self, cases: &[Case]) -> Option<Bar> {
        let mut worst: Option<(f64, &Case)> = None;
        for case in cases.iter().filter(|case| (self.counts)(case)) {
            // What should be there and is not fails.
            let missing = if self.at_least {
                f64::NEG_INFINITY
            } else {
                f64::INFINITY
            };
            let value = (self.figure)(case).unwrap_or(missing);
            let is_worse = |best: f64| (value < best) == self.at_least && value != best;
            if worst.is_none_or(|(best, _)| is_worse(best)) {
                worst = Some((value, case));
            }
        }
        let (value, case) = worst?;
        let ok = if self.at_least {
            value >= self.bar
        } else {
            value <= self.bar
        };
        Some(Bar {
            name: self.name.clone(),
            value,
            must_be: if self.at_least { ">=" } else { "<=" },
            bar: self.bar,
            ok,
            open: !ok && targets::is_open(&self.name, self.at_least, value),
            worst: case.case.clone(),
        })
    }
}

/// A figure of a case, if it has it.
type Figure = fn(&Case) -> Option<f64>;

/// What the figures must be.
pub fn bars(cases: &[Case]) -> Vec<Bar> {
    let mut bars = Vec::new();
    let mut rule = |name: &str,
                    counts: &dyn Fn(&Case) -> bool,
                    figure: &dyn Fn(&Case) -> Option<f64>,
                    at_least: bool,
                    bar: f64| {
        let rule = Rule {
            name: name.to_owned(),
            counts,
            figure,
            at_least,
            bar,
        };
        bars.extend(rule.judge(cases));
    };
    let hands = |scene| Motion::NAMED.map(|motion| (scene, motion.name()));
    let hands = hands("palpation").into_iter().chain(hands("rubbing"));
    for (scene, hand) in hands.chain([
        ("needle", "presses"),
        ("needle", "taps"),
        ("thread", "pulls"),
    ]) {
        for (hz, rms) in [(60.0, 1.5), (30.0, 3.0)] {
            let counts = |c: &Case| {
                c.question == "errors"
                    && c.scene == scene
                    && c.rendering == "rows"
                    && c.hand == hand
                    && c.grasp == "rigid"
                    && c.host_hz == hz
                    && c.most_rows == 24
                    && c.tangent_scale == 1.0
                    && !c.is_lossy()
            };
            let name = |what: &str| format!("{scene} {hand} rows {hz:.0} Hz {what}");
            let (rms_of, peak, step): (Figure, Figure, Figure) = (
                |c| Some(c.errors?.rms_pct),
                |c| Some(c.errors?.peak_pct),
                |c| Some(c.errors?.step_pct),
            );
            rule(&name("rms %"), &counts, &rms_of, false, rms);
            if hz == 60.0 {
                rule(&name("peak %"), &counts, &peak, false, 7.0);
                rule(&name("step %"), &counts, &step, false, 1.0);
            }
            let slips = |c: &Case| counts(c) && c.slips.is_some();
            let onset: Figure = |c| Some(c.slips?.onset_p95_ms);
            rule(&name("slip p95 ms"), &slips, &onset, false, 5.0);
            let punctured = |c: &Case| counts(c) && c.punctures.is_some();
            let timing: Figure = |c| Some(c.punctures?.puncture_p95_ms);
            rule(&name("puncture p95 ms"), &punctured, &timing, false, 8.0);
        }
    }
    let fast = |c: &Case| {
        c.question == "errors" && c.rendering != "full" && FAST_RATES.contains(&c.host_hz)
    };
    let smooth = |c: &Case| fast(c) && c.scene == "palpation";
    let peak: Figure = |c| Some(c.errors?.peak_pct);
    rule(
        "fast hosts, presses and strokes, peak %",
        &smooth,
        &peak,
        false,
        7.0,
    );
    let rubs = |c: &Case| fast(c) && c.scene == "rubbing";
    let rms: Figure = |c| Some(c.errors?.rms_pct);
    rule(
        "fast hosts, strokes that rub, rms %",
        &rubs,
        &rms,
        false,
        1.5,
    );
    for (scene, rms, peak) in [("needle", 1.5, 7.0), ("rubbing", 3.0, 12.0)] {
        let lossy = |c: &Case| {
            c.question == "errors" && c.scene == scene && c.loss == 0.05 && !c.is_unguarded()
        };
        let (rms_of, peak_of): (Figure, Figure) =
            (|c| Some(c.errors?.rms_pct), |c| Some(c.errors?.peak_pct));
        let name = |what: &str| format!("{scene}, one frame in 20 lost, {what} %");
        rule(&name("rms"), &lossy, &rms_of, false, rms);
        rule(&name("peak"), &lossy, &peak_of, false, peak);
    }
    let stability = |c: &Case| {
        c.question == "stability"
            && c.rendering == "tangent"
            && c.device_damping_n_s_per_m == Mechanics::LIGHT.damping_n_s_per_m
    };
    let ratio = |c: &Case| c.k_ratio;
    let exact = |c: &Case| stability(c) && c.host_hz == 30.0 && c.tangent_scale == 1.0;
    rule(
        "stiffness 30 Hz, exact tangent, of full",
        &exact,
        &ratio,
        true,
        0.9,
    );
    for hz in RATES {
        let quarter =
            |c: &Case| stability(c) && c.host_hz == hz && [0.75, 1.25].contains(&c.tangent_scale);
        let name = format!("stiffness {hz:.0} Hz, tangent 25 % wrong, of full");
        rule(&name, &quarter, &ratio, true, 0.5);
    }
    let wrong = |c: &Case| stability(c) && [0.5, 2.0].contains(&c.tangent_scale);
    // Never unstable: wherever the full loop itself is stable.
    rule(
        "stiffness, tangent x0.5 and x2, of full",
        &wrong,
        &ratio,
        true,
        1.0,
    );
    let off = |c: &Case| stability(c) && c.tangent_scale != 1.0;
    rule(
        "force over true, wrong tangents",
        &off,
        &|c| c.force_ratio,
        true,
        0.5,
    );
    let off = |c: &Case| {
        c.question == "errors"
            && c.rendering == "tangent"
            && c.scene == "point"
            && ["presses", "tremor"].contains(&c.hand)
            && [30.0, 60.0].contains(&c.host_hz)
            && [0.5, 2.0].contains(&c.tangent_scale)
    };
    let rms_of: Figure = |c| Some(c.errors?.rms_pct);
    rule(
        "point presses and tremor, tangent x0.5 and x2, rms %",
        &off,
        &rms_of,
        false,
        10.0,
    );
    let slow = |c: &Case| c.question == "errors" && c.scene == "gristle" && c.host_hz == SLOW_HZ;
    rule(
        "gristle strokes, pen hand, slow host, rms %",
        &slow,
        &rms_of,
        false,
        20.0,
    );
    let held = |c: &Case| {
        c.question == "stability"
            && c.rendering == "hold"
            && c.host_hz == 30.0
            && c.device_damping_n_s_per_m == Mechanics::LIGHT.damping_n_s_per_m
    };
    rule(
        "stiffness 30 Hz, held force, of full",
        &held,
        &ratio,
        true,
        0.5,
    );
    let unsolvable = |c: &Case| c.scene == Rogue::Rows.scene_name();
    rule(
        "rows that nobody can solve: rms %",
        &unsolvable,
        &rms_of,
        false,
        5.0,
    );
    for (grasp, scene) in [
        ("pen", "point"),
        ("pen", "palpation"),
        ("rigid", "point"),
        ("rigid", "palpation"),
    ] {
        let lossy = |c: &Case| {
            c.question == "errors"
                && c.is_lossy()
                && !c.is_unguarded()
                && c.grasp == grasp
                && c.scene == scene
        };
        let name = format!("energy mJ, bad links, {scene}, {grasp} hand");
        rule(
            &name,
            &lossy,
            &|c| Some(1e3 * c.energy_min_j),
            true,
            LEAST_ENERGY_MJ,
        );
    }
    let stopped = |c: &Case| c.question == "stop";
    rule(
        "force N after a stop",
        &stopped,
        &|c| c.force_after_stop_n,
        false,
        0.0,
    );
    let rogue = |c: &Case| c.question == "rogue";
    let device = Mechanics::LIGHT.description();
    let limit = |value: f32| 1.001 * f64::from(value);
    // Of three axes at once.
    let slew = 3f32.sqrt() * device.joints[0].max_slew_per_s;
    rule(
        "rogue host: force N",
        &rogue,
        &|c| Some(c.peaks?.force_peak_n),
        false,
        limit(device.max_force_n),
    );
    rule(
        "rogue host: slew at the grip N/s",
        &rogue,
        &|c| Some(c.peaks?.slew_peak_n_per_s),
        false,
        limit(slew),
    );
    let slope = |c: &Case| rogue(c) && c.scene == Rogue::Slope.scene_name();
    rule(
        "hard slope: force across it while it grows N",
        &slope,
        &|c| Some(c.peaks?.across_peak_n),
        false,
        0.2,
    );
    let weak = Mechanics::WEAK.max_power_w;
    let braked = |c: &Case| rogue(c) && c.device_max_power_w == weak;
    rule(
        "rogue host: power W, console of 5 W",
        &braked,
        &|c| Some(c.peaks?.power_peak_w),
        false,
        // The hand gains speed until the force acts.
        1.1 * weak,
    );
    let strong = |c: &Case| rogue(c) && c.device_max_power_w > weak;
    rule(
        "rogue host: power W",
        &strong,
        &|c| Some(c.peaks?.power_peak_w),
        false,
        limit(device.max_power_w),
    );
    rule(
        "rogue host: ticks with torque beyond the speed limit",
        &rogue,
        &|c| Some(f64::from(c.peaks?.ticks_too_fast)),
        false,
        // Five are a fault, and the estimate of the velocity comes after the motion.
        10.0,
    );
    bars.extend(targets::bars(cases));
    bars
}
