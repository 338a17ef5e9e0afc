//! The published cases, and how they are run.
//!
//! Entry points: [`specs`], [`measure`].

use super::case::{Case, Place, Question, Scenes, Spec};
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::plant::Mechanics;
use super::scenes::rogue::Rogue;
use super::stops::{STOPS, Stop};
use super::trials::Factor;
use super::{corners, draws, returns, trials};
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};
use sutura_shared::control::{Guards, Rendering};
use sutura_shared::device::DeviceError;
use sutura_shared::wire::message::MAX_ROWS;

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
pub(super) const RATES: [f64; 3] = [30.0, 60.0, 100.0];
/// Rates of simulators that are nearly as quick as the console \[1/s\].
pub(super) const FAST_RATES: [f64; 3] = [250.0, 500.0, 1000.0];
/// Contacts that come with more than a tangent, on a line that loses one frame in twenty.
const COMPANIONS_LOST: [(Place, Motion); 3] = [
    (Place::Needle, Motion::Presses),
    (Place::Needle, Motion::Taps),
    (Place::Rubbing, Motion::Strokes),
];
/// How wrong tangents are.
const SCALES: [f64; 4] = [0.5, 0.75, 1.25, 2.0];

/// Everything that is measured.
pub fn specs(extent: Extent) -> Vec<Spec> {
    let mut specs = core(extent, Guards::ALL);
    specs.extend(trials::known_worst());
    specs.extend(first_stalls());
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
    for motion in Motion::NAMED {
        for hz in [30.0, 60.0] {
            specs.push(Spec::errors(Place::Rubbing, motion, Rendering::Rows, hz));
        }
    }
    let phases = match extent {
        Extent::Short => 4,
        Extent::Full => 16,
    };
    for phase in 1..phases {
        let mut spec = Spec::errors(Place::Rubbing, Motion::Strokes, Rendering::Rows, 60.0);
        spec.around.phase = f64::from(phase) / f64::from(phases);
        specs.push(spec);
    }
    for hz in FAST_RATES {
        for motion in [Motion::Presses, Motion::Strokes] {
            specs.push(Spec::errors(
                Place::Palpation,
                motion,
                Rendering::Tangent,
                hz,
            ));
        }
        for place in [Place::Palpation, Place::Rubbing] {
            specs.push(Spec {
                // On a line that is fast enough for them.
                most_rows: Some(MAX_ROWS),
                ..Spec::errors(place, Motion::Strokes, Rendering::Rows, hz)
            });
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
    for (place, motion) in COMPANIONS_LOST {
        specs.push(Spec {
            link: LinkSpec {
                loss: 0.05,
                ..LinkSpec::ideal(60.0)
            },
            ..Spec::errors(place, motion, Rendering::Rows, 60.0)
        });
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
    specs.extend(match extent {
        Extent::Short => returns::known_worst(),
        Extent::Full => returns::specs(),
    });
    specs.extend(STOPS.map(Stop::spec));
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

/// Strokes through stalls of up to 80 ms, the first that their hosts know of.
pub(super) fn first_stalls() -> Vec<Spec> {
    const SEEDS: [u64; 5] = [2, 3, 4, 5, 9];
    let is_one = |spec: &Spec| {
        matches!(spec.question, Question::Trial(Factor::Stalls))
            && (spec.place, spec.motion) == (Place::Palpation, Motion::Strokes)
            && spec.around.blocks.is_some_and(|seed| SEEDS.contains(&seed))
    };
    let trials = trials::one_at_a_time().into_iter();
    trials.filter(is_one).collect()
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
pub(super) const SLOW_HZ: f64 = 15.0;

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

/// Runs them all, on as many threads as asked. `done` is called after each with how many are done and what it came to, and says
/// whether to go on: else there are the cases by then.
///
/// # Errors
/// Mechanics that make no valid device.
pub fn measure(
    specs: &[Spec],
    scenes: &Scenes,
    threads: usize,
    done: &(dyn Fn(usize, &Case) -> ControlFlow<()> + Sync),
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
                    // What fails ends the whole run.
                    let told = case.clone().unwrap_or_else(|_| spec.case());
                    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
                    if let Some(place) = results.get_mut(index) {
                        *place = Some(case);
                    }
                    drop(results);
                    if done(finished.fetch_add(1, Ordering::Relaxed) + 1, &told).is_break() {
                        next.store(specs.len(), Ordering::Relaxed);
                    }
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
