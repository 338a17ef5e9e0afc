//! The published cases, and the bars that they must meet.
//!
//! Entry points: [`specs`], [`measure`], [`bars`].

use super::case::{Case, Place, Question, Scenes, Spec, all_but, guards_by_name};
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::plant::Mechanics;
use super::scenes::rogue::Rogue;
use super::{corners, draws, targets, trials};
use serde::Serialize;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};
use sutura_shared::control::{Guards, Rendering};
use sutura_shared::device::DeviceError;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// What the bars need, with shorter runs: a minute on one core.
    Short,
    /// All tables.
    Full,
}

/// All renderings, the ones for comparison first.
const RENDERINGS: [Rendering; 4] = [
    Rendering::Hold,
    Rendering::LinearTime,
    Rendering::Tangent,
    Rendering::Rows,
];
/// Host rates of the tables \[1/s\].
const RATES: [f64; 3] = [30.0, 60.0, 100.0];
/// How wrong tangents are.
const SCALES: [f64; 4] = [0.5, 0.75, 1.25, 2.0];

/// Everything that is measured.
pub fn specs(extent: Extent) -> Vec<Spec> {
    let mut specs = core(extent, Guards::ALL);
    specs.extend(trials::known_worst());
    specs.extend(corners::known_worst());
    if extent == Extent::Short {
        return specs;
    }
    for place in [Place::Point, Place::Palpation] {
        for motion in Motion::NAMED {
            specs.push(Spec::errors(place, motion, Rendering::Hold, 1000.0).full());
            for rendering in RENDERINGS {
                specs.extend(RATES.map(|hz| Spec::errors(place, motion, rendering, hz)));
            }
        }
    }
    for motion in [Motion::Presses, Motion::Taps, Motion::Tremor] {
        for rendering in RENDERINGS {
            specs.extend(RATES.map(|hz| Spec::errors(Place::Needle, motion, rendering, hz)));
        }
    }
    for rendering in RENDERINGS {
        let pulled = |hz| Spec::errors(Place::Thread, Motion::Pulls, rendering, hz);
        specs.extend([30.0, 60.0].map(pulled));
    }
    for rendering in RENDERINGS {
        for hz in RATES {
            specs.push(Spec::stiffest(rendering, hz, 1.0));
        }
    }
    for (motion, hz) in Motion::NAMED
        .into_iter()
        .flat_map(|motion| [30.0, 60.0].map(|hz| (motion, hz)))
    {
        // What the force costs when the tangent is wrong.
        for scale in SCALES {
            specs.push(Spec {
                tangent_scale: scale,
                ..Spec::errors(Place::Point, motion, Rendering::Tangent, hz)
            });
        }
        // What it costs when the line has no room for all rows.
        for rows in [24, 16, 8, 0] {
            specs.push(Spec {
                most_rows: Some(rows),
                ..Spec::errors(Place::Palpation, motion, Rendering::Rows, hz)
            });
        }
    }
    for damping in [0.1, 0.2, 1.0, 2.0, 4.0] {
        let mechanics = Mechanics {
            damping_n_s_per_m: damping,
            ..Mechanics::LIGHT
        };
        for rendering in RENDERINGS {
            specs.push(Spec {
                mechanics,
                ..Spec::stiffest(rendering, 30.0, 1.0)
            });
        }
        specs.push(Spec {
            mechanics,
            ..Spec::stiffest(Rendering::Hold, 1000.0, 1.0).full()
        });
    }
    specs.extend(baselines());
    specs.extend(corners::specs());
    specs.extend(trials::one_at_a_time());
    specs.extend(trials::drawn(draws::DRAWS, draws::SEED));
    without_repeats(specs)
}

/// What is compared with is compared without our guards, too: they cut what is not true. And what bad links give back then.
fn baselines() -> Vec<Spec> {
    let mut specs = Vec::new();
    for place in [Place::Point, Place::Palpation] {
        for motion in Motion::NAMED {
            for rendering in [Rendering::Hold, Rendering::LinearTime] {
                specs.extend(RATES.map(|hz| Spec {
                    guards: unguarded(),
                    ..Spec::errors(place, motion, rendering, hz)
                }));
            }
        }
    }
    let lossy = core(Extent::Short, unguarded()).into_iter();
    specs.extend(lossy.filter(|spec| {
        let is_slow = spec.place == Place::Gristle;
        spec.question == Question::Errors && spec.case().is_lossy() && !is_slow
    }));
    specs
}

/// Neither tank nor damping.
fn unguarded() -> Guards {
    Guards {
        tank: false,
        damping: false,
        ..Guards::ALL
    }
}

/// What the bars need.
pub fn core(extent: Extent, guards: Guards) -> Vec<Spec> {
    let seconds = if extent == Extent::Short { 2.0 } else { 4.0 };
    let mut specs = Vec::new();
    for motion in Motion::NAMED {
        for hz in [30.0, 60.0] {
            specs.push(Spec::errors(Place::Palpation, motion, Rendering::Rows, hz));
        }
    }
    for hz in [30.0, 60.0] {
        for motion in [Motion::Presses, Motion::Taps] {
            specs.push(Spec::errors(Place::Needle, motion, Rendering::Rows, hz));
        }
        specs.push(Spec::errors(
            Place::Thread,
            Motion::Pulls,
            Rendering::Rows,
            hz,
        ));
    }
    specs.push(Spec::stiffest(Rendering::Hold, 1000.0, 1.0).full());
    specs.push(Spec::stiffest(Rendering::Tangent, 30.0, 1.0));
    for scale in SCALES {
        specs.extend(RATES.map(|hz| Spec::stiffest(Rendering::Tangent, hz, scale)));
    }
    for place in [Place::Point, Place::Palpation] {
        for (motion, link) in Motion::NAMED
            .into_iter()
            .flat_map(|motion| bad_links().map(|link| (motion, link)))
        {
            for grasp in [Grasp::PEN, Grasp::Rigid] {
                // The real solver follows a hand that gives way at every tick: for the long form.
                let costly = place == Place::Palpation && grasp == Grasp::PEN;
                if costly && extent == Extent::Short {
                    continue;
                }
                specs.push(Spec {
                    grasp,
                    link,
                    ..Spec::errors(place, motion, Rendering::Rows, link.host_hz)
                });
            }
        }
    }
    specs.push(Spec::gap(30.0));
    specs.push(Spec::gap(60.0));
    specs.extend(guarded(seconds));
    for rogue in Rogue::WILD {
        specs.extend([Motion::Hold, Motion::Presses, Motion::Throw].map(|m| Spec::rogue(rogue, m)));
    }
    for spec in &mut specs {
        spec.guards = guards;
        // The suture is drawn together in four seconds.
        if spec.question == Question::Errors && spec.place != Place::Thread {
            spec.seconds = seconds;
        }
    }
    specs
}

/// What shows what single guards are for: wrong tangents (trust), a host that is slow, or sends forces alone
/// (damping), rows that nobody can solve (residual), and forces that one limit bounds alone (force, slew, power).
pub fn guarded(seconds: f64) -> Vec<Spec> {
    let mut specs = Vec::new();
    for motion in [Motion::Presses, Motion::Tremor] {
        for (hz, tangent_scale) in [(30.0, 0.5), (30.0, 2.0), (60.0, 0.5), (60.0, 2.0)] {
            specs.push(Spec {
                tangent_scale,
                ..Spec::errors(Place::Point, motion, Rendering::Tangent, hz)
            });
        }
    }
    specs.extend([0.5, 1.0, 2.0].map(|tangent_scale| Spec {
        grasp: Grasp::PEN,
        tangent_scale,
        link: LinkSpec {
            loss: 0.2,
            ..LinkSpec::ideal(SLOW_HZ)
        },
        ..Spec::errors(Place::Gristle, Motion::Strokes, Rendering::Tangent, SLOW_HZ)
    }));
    let rows = Place::Rogue(Rogue::Rows);
    specs.push(Spec::errors(rows, Motion::Presses, Rendering::Rows, 100.0));
    for spec in &mut specs {
        spec.seconds = seconds;
    }
    specs.push(Spec::stiffest(Rendering::Hold, 30.0, 1.0));
    specs.push(Spec::rogue(Rogue::Stiff, Motion::Presses));
    specs.push(Spec::rogue(Rogue::Slope, Motion::Swing));
    specs.push(Spec {
        mechanics: Mechanics::WEAK,
        ..Spec::rogue(Rogue::Stiff, Motion::Swing)
    });
    specs
}

/// A host that is too slow for its scene \[1/s\].
const SLOW_HZ: f64 = 15.0;

/// Links that lose, stop and reorder.
fn bad_links() -> [LinkSpec; 3] {
    let ideal = LinkSpec::ideal(60.0);
    let jitter_s = 5e-3;
    [
        LinkSpec {
            loss: 0.2,
            jitter_s,
            ..ideal
        },
        LinkSpec {
            burst_every_s: 0.37,
            burst_s: 0.05,
            ..ideal
        },
        LinkSpec {
            reordered: 0.2,
            jitter_s,
            ..ideal
        },
    ]
}

fn without_repeats(specs: Vec<Spec>) -> Vec<Spec> {
    let mut kept: Vec<Spec> = Vec::with_capacity(specs.len());
    for spec in specs {
        if !kept.contains(&spec) {
            kept.push(spec);
        }
    }
    kept
}

/// Runs them all, on as many threads as asked, and tells after each how many are done.
///
/// # Errors
/// Mechanics that make no valid device.
pub fn measure(
    specs: &[Spec],
    scenes: &Scenes,
    threads: usize,
    done: &(dyn Fn(usize, &str) + Sync),
) -> Result<Vec<Case>, DeviceError> {
    let next = AtomicUsize::new(0);
    let finished = AtomicUsize::new(0);
    let results = Mutex::new(vec![None; specs.len()]);
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                while let Some((index, spec)) = {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    specs.get(index).map(|spec| (index, spec))
                } {
                    let case = spec.measure(scenes);
                    let name = spec.case().case;
                    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
                    if let Some(place) = results.get_mut(index) {
                        *place = Some(case);
                    }
                    drop(results);
                    done(finished.fetch_add(1, Ordering::Relaxed) + 1, &name);
                }
            });
        }
    });
    let results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut cases = results
        .into_iter()
        .flatten()
        .collect::<Result<Vec<_>, _>>()?;
    relate(&mut cases);
    Ok(cases)
}

/// Stiffness over that of the full loop on the same console.
fn relate(cases: &mut [Case]) {
    let full: Vec<(f64, f64)> = cases
        .iter()
        .filter(|case| case.rendering == "full")
        .filter_map(|case| Some((case.device_damping_n_s_per_m, case.k_max_n_per_m?)))
        .collect();
    for case in cases {
        let own = full
            .iter()
            .find(|(damping, _)| *damping == case.device_damping_n_s_per_m);
        if let (Some((_, full)), Some(k)) = (own, case.k_max_n_per_m) {
            case.k_ratio = Some(k / full);
        }
    }
}

/// A figure and what it must be.
#[derive(Clone, Debug, PartialEq, Serialize)]
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
        Some(Bar {
            name: self.name.clone(),
            value,
            must_be: if self.at_least { ">=" } else { "<=" },
            bar: self.bar,
            ok: if self.at_least {
                value >= self.bar
            } else {
                value <= self.bar
            },
            open: false,
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
    let hands = Motion::NAMED.map(|motion| ("palpation", motion.name()));
    for (scene, hand) in hands.into_iter().chain([
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
            let punctured = |c: &Case| counts(c) && c.punctures.is_some();
            let timing: Figure = |c| Some(c.punctures?.puncture_p95_ms);
            rule(&name("puncture p95 ms"), &punctured, &timing, false, 8.0);
        }
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
        rule(&name, &lossy, &|c| Some(1e3 * c.energy_min_j), true, -1.0);
    }
    let gap = |c: &Case| c.question == "gap";
    rule(
        "energy mJ, gap of 300 ms",
        &gap,
        &|c| Some(1e3 * c.energy_min_j),
        true,
        -1.0,
    );
    rule(
        "ms until 90 % of the force is back, gap of 300 ms",
        &gap,
        &|c| c.recovery?.time_to_90_ms,
        false,
        1000.0,
    );
    rule(
        "force N at the end of a gap",
        &gap,
        &|c| Some(c.recovery?.gap_force_n),
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

/// What a guard is for: the bars that fail without it and not with it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mutant {
    /// The guard that is off.
    pub guard: &'static str,
    /// What fails then, with its value.
    pub fails: Vec<Bar>,
}

/// Each guard off in turn, in the short form.
///
/// # Errors
/// Mechanics that make no valid device.
pub fn mutants(
    scenes: &Scenes,
    threads: usize,
    done: &(dyn Fn(usize, &str) + Sync),
) -> Result<Vec<Mutant>, DeviceError> {
    let names = guards_by_name(&Guards::ALL).map(|(name, _)| name);
    let all = core(Extent::Short, Guards::ALL);
    let with_all = bars(&measure(&all, scenes, threads, done)?);
    let mut mutants = Vec::new();
    for (index, guard) in names.into_iter().enumerate() {
        let specs = core(Extent::Short, all_but(guard));
        let told = |n: usize, name: &str| done(index * all.len() + n, name);
        let found = bars(&measure(&specs, scenes, threads, &told)?);
        let met = |bar: &&Bar| with_all.iter().any(|with| with.name == bar.name && with.ok);
        let fails = found.iter().filter(|bar| !bar.ok).filter(met);
        mutants.push(Mutant {
            guard,
            fails: fails.cloned().collect(),
        });
    }
    Ok(mutants)
}
