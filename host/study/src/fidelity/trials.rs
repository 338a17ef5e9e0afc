//! What cases that repeat one phase, one orientation, one ideal host and one tissue hide: each of these changed by itself
//! around the same plan, and all of them together, drawn by a seed.
//!
//! Entry points: [`one_at_a_time`], [`drawn`], [`known_worst`], [`spreads`]. Forces are compared as they are commanded, for the
//! time for which they are: a console that is not as described delays and scales them, which is no error of the host's.

use super::around::{Around, Blocking, TRANSIT_S};
use super::case::{Case, Place, Question, Spec};
use super::corners::{DEVICES, HANDS};
use super::draws::{Draw, draws};
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::plant::{Mechanics, Off};
use super::random::Random;
use super::scenes::slab::Law;
use super::scenes::turned::Turn;
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::Rendering;

/// What is other than planned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Factor {
    /// Nothing: what the others are compared with.
    Planned,
    /// The phase of the host's turns.
    Phase,
    /// The scene's orientation: to (1, 1, 1) for 0, by a seed for others.
    Turn(u8),
    /// The same, or as it stands, on a console of which nothing has axes: its encoders' steps are too small to tell.
    Isotropic(Option<u8>),
    /// Nothing is computed beforehand.
    Cold,
    /// The host blocks.
    Stalls,
    /// The console is not as described, and the hand gives way.
    Device,
    /// All of it.
    Draw(Draw),
}

impl Factor {
    /// As tables group it.
    pub fn word(&self) -> &'static str {
        match self {
            Factor::Planned => "planned",
            Factor::Phase => "phase",
            Factor::Turn(_) => "turn",
            Factor::Isotropic(Some(_)) => "isotropic-turn",
            Factor::Isotropic(None) => "isotropic",
            Factor::Cold => "cold",
            Factor::Stalls => "stalls",
            Factor::Device => "device",
            Factor::Draw(_) => "draw",
        }
    }

    /// As a case is named.
    pub fn name(&self, around: &Around) -> String {
        match self {
            Factor::Planned | Factor::Cold | Factor::Device | Factor::Isotropic(None) => {
                self.word().to_owned()
            }
            Factor::Phase => format!("phase phase-{:.2}", around.phase),
            Factor::Turn(number) => format!("turn turn-{number}"),
            Factor::Isotropic(Some(number)) => format!("isotropic-turn turn-{number}"),
            Factor::Stalls => format!("stalls stalls-{}", around.blocks.unwrap_or_default()),
            Factor::Draw(draw) => format!("draw draw-{}", draw.draw),
        }
    }
}

/// What is touched, and how.
pub const GROUNDS: [(Place, Motion); 18] = [
    (Place::Palpation, Motion::Presses),
    (Place::Palpation, Motion::Taps),
    (Place::Palpation, Motion::Strokes),
    (Place::Needle, Motion::Presses),
    (Place::Needle, Motion::Taps),
    (Place::Thread, Motion::Pulls),
    (Place::RoundThin, Motion::RoundThin),
    (Place::RoundThick, Motion::RoundThick),
    (Place::Slab(Law::Corotational), Motion::Presses),
    (Place::Slab(Law::Corotational), Motion::Taps),
    (Place::Slab(Law::Corotational), Motion::Strokes),
    (Place::Slab(Law::Hyperelastic), Motion::Presses),
    (Place::Slab(Law::Hyperelastic), Motion::Taps),
    (Place::Slab(Law::Hyperelastic), Motion::Strokes),
    (Place::Rubbing, Motion::Taps),
    (Place::Rubbing, Motion::Strokes),
    (Place::RubbingThin, Motion::RoundThin),
    (Place::RubbingThick, Motion::RoundThick),
];
/// The host's rate \[1/s\].
pub const HOST_HZ: f64 = 60.0;
/// Phases, and seeds of hosts that block.
const PHASES: u32 = 10;
/// Seeds of stalls that are counted together.
pub const SEEDS: u64 = 10;
/// Turns beside the one to (1, 1, 1), and of which numbers.
const TURNS: u8 = 8;
const TURNS_SEED: u64 = 5;

fn trial((place, motion): (Place, Motion), hz: f64, factor: Factor) -> Spec {
    Spec {
        question: Question::Trial(factor),
        seconds: match place {
            // The suture is drawn together in four seconds.
            Place::Thread => 4.0,
            _ => 2.0,
        },
        ..Spec::errors(place, motion, Rendering::Rows, hz)
    }
}

fn phased(ground: (Place, Motion), hz: f64, phase: f64) -> Spec {
    let spec = trial(ground, hz, Factor::Phase);
    Spec {
        around: Around {
            phase,
            ..spec.around
        },
        ..spec
    }
}

/// The same on a host that blocks.
fn blocking(spec: Spec, seed: u64) -> Spec {
    Spec {
        link: LinkSpec {
            delay_s: TRANSIT_S,
            ..spec.link
        },
        around: Around {
            blocks: Some(seed),
            ..spec.around
        },
        ..spec
    }
}

/// Seeds change the phase, too: a stall that meets a hand always in the same place is one stall.
fn stalled(ground: (Place, Motion), hz: f64, seed: u64) -> Spec {
    let spec = trial(ground, hz, Factor::Stalls);
    let around = Around {
        phase: Random::new(seed).unit(),
        ..spec.around
    };
    blocking(Spec { around, ..spec }, seed)
}

/// To (1, 1, 1) for 0, by a seed for others.
fn turned(spec: Spec, number: u8) -> Spec {
    let mut random = Random::new(TURNS_SEED);
    let mut turn = Turn::diagonal();
    for _ in 0..number {
        turn = Turn::of([(); 3].map(|()| random.unit()));
    }
    Spec {
        around: Around {
            turn,
            ..spec.around
        },
        ..spec
    }
}

fn isotropic(ground: (Place, Motion), number: Option<u8>) -> Spec {
    let spec = Spec {
        mechanics: Mechanics::ISOTROPIC,
        ..trial(ground, HOST_HZ, Factor::Isotropic(number))
    };
    match number {
        Some(number) => turned(spec, number),
        None => spec,
    }
}

fn given_way(ground: (Place, Motion), off: Off, grasp: Grasp) -> Spec {
    Spec {
        grasp,
        mechanics: Mechanics {
            off,
            ..Mechanics::LIGHT
        },
        ..trial(ground, HOST_HZ, Factor::Device)
    }
}

/// Every factor by itself.
pub fn one_at_a_time() -> Vec<Spec> {
    let mut specs = Vec::new();
    let phases = || (0..PHASES).map(|part| f64::from(part) / f64::from(PHASES));
    for ground in GROUNDS {
        specs.push(trial(ground, HOST_HZ, Factor::Planned));
        specs.extend(phases().map(|phase| phased(ground, HOST_HZ, phase)));
        specs.extend((0..SEEDS).map(|seed| stalled(ground, HOST_HZ, seed)));
    }
    for ground in [
        (Place::Palpation, Motion::Taps),
        (Place::Needle, Motion::Taps),
    ] {
        specs.extend(phases().map(|phase| phased(ground, 30.0, phase)));
    }
    let point = (Place::Point, Motion::Presses);
    specs.push(trial(point, HOST_HZ, Factor::Planned));
    let linear = GROUNDS.into_iter().take(6);
    for ground in linear.chain([point]) {
        specs.push(isotropic(ground, None));
        for number in 0..=TURNS {
            let turn = trial(ground, HOST_HZ, Factor::Turn(number));
            specs.push(turned(turn, number));
            specs.push(isotropic(ground, Some(number)));
        }
    }
    for ground in GROUNDS.into_iter().take(3) {
        specs.extend(phases().map(|phase| cold(ground, phase)));
        specs.extend(DEVICES.map(|off| given_way(ground, off, Grasp::PEN)));
        specs.extend([HANDS[0], HANDS[2]].map(|hand| given_way(ground, Off::NONE, hand)));
    }
    specs
}

fn cold(ground: (Place, Motion), phase: f64) -> Spec {
    let spec = trial(ground, HOST_HZ, Factor::Cold);
    Spec {
        around: Around {
            phase,
            cold: true,
            ..spec.around
        },
        ..spec
    }
}

/// So many draws of everything, on every ground.
pub fn drawn(count: usize, seed: u64) -> Vec<Spec> {
    let draws = draws(count, seed);
    let all = GROUNDS.into_iter();
    all.flat_map(|ground| draws.iter().map(move |draw| of_draw(ground, *draw)))
        .collect()
}

fn of_draw(ground: (Place, Motion), draw: Draw) -> Spec {
    let spec = Spec {
        around: draw.around(),
        mechanics: Mechanics {
            off: draw.off(),
            ..Mechanics::LIGHT
        },
        // Where a true force on any way costs no more than this.
        grasp: match ground.0 {
            Place::Palpation
            | Place::RoundThin
            | Place::RoundThick
            | Place::RubbingThin
            | Place::RubbingThick => draw.grasp(),
            _ => Grasp::Rigid,
        },
        ..trial(ground, HOST_HZ, Factor::Draw(draw))
    };
    match draw.blocks {
        Some(seed) => blocking(spec, seed),
        None => spec,
    }
}

/// The worst of each kind that is known, for the short form.
pub fn known_worst() -> Vec<Spec> {
    let [presses, taps] = [Motion::Presses, Motion::Taps].map(|m| (Place::Palpation, m));
    let needle = (Place::Needle, Motion::Taps);
    let corotational = (Place::Slab(Law::Corotational), Motion::Taps);
    let hyperelastic = |motion| (Place::Slab(Law::Hyperelastic), motion);
    let round = (Place::RoundThin, Motion::RoundThin);
    let mut specs = vec![
        trial(presses, HOST_HZ, Factor::Planned),
        isotropic(presses, None),
        isotropic(presses, Some(0)),
        isotropic(presses, Some(6)),
        isotropic(needle, None),
        isotropic(needle, Some(0)),
        phased(taps, 30.0, 0.9),
        phased(needle, HOST_HZ, 0.8),
        phased(round, HOST_HZ, 0.8),
        phased((Place::Rubbing, Motion::Taps), HOST_HZ, 0.4),
        phased((Place::RubbingThin, Motion::RoundThin), HOST_HZ, 0.9),
        stalled((Place::Palpation, Motion::Strokes), HOST_HZ, 8),
        stalled(
            (Place::Slab(Law::Corotational), Motion::Strokes),
            HOST_HZ,
            6,
        ),
        stalled(corotational, HOST_HZ, 6),
        phased(corotational, HOST_HZ, 0.8),
        phased(hyperelastic(Motion::Taps), HOST_HZ, 0.8),
        stalled(hyperelastic(Motion::Strokes), HOST_HZ, 4),
        stalled(hyperelastic(Motion::Presses), HOST_HZ, 8),
    ];
    // Whole, for what is counted of all seeds together.
    let rubbing = (Place::Rubbing, Motion::Strokes);
    for ground in [needle, hyperelastic(Motion::Taps), rubbing] {
        specs.extend((0..SEEDS).map(|seed| stalled(ground, HOST_HZ, seed)));
    }
    specs
}

/// Median, 95th percentile and worst of some runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Three {
    /// Of all, half are at most this.
    pub median: f64,
    /// 19 of 20 are.
    pub p95: f64,
    /// All are.
    pub worst: f64,
}

impl Three {
    /// Of figures that are better the smaller they are.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let part = |share: f64| {
            let index = (share * values.len() as f64).ceil() as usize;
            values.get(index.saturating_sub(1)).copied()
        };
        Three {
            median: part(0.5).unwrap_or(0.0),
            p95: part(0.95).unwrap_or(0.0),
            worst: part(1.0).unwrap_or(0.0),
        }
    }
}

/// All runs of one ground that differ in the same factor.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Spread {
    /// Scene, hand, rate and factor.
    pub group: String,
    /// Which scene.
    pub scene: String,
    /// What the hand does.
    pub hand: &'static str,
    /// \[1/s\].
    pub host_hz: f64,
    /// [`Factor::word`].
    pub factor: &'static str,
    /// How many.
    pub runs: usize,
    /// Root mean square of the error of what is commanded, % of the largest true force.
    pub rms_pct: Three,
    /// Largest, with the motors' delay, % of the same.
    pub peak_pct: Three,
    /// Contact in which the command is off by more than a finger notices, %.
    pub beyond_pct: Three,
    /// The same of the contact of all runs together.
    pub beyond_of_all_pct: f64,
    /// Dropouts in a minute of contact, of all runs together.
    pub dropouts_per_min: f64,
    /// 19 of 20 ticks in contact are within this of the true direction \[degree\].
    pub direction_p95_deg: Three,
    /// Given back in 100 ms beyond the true tissue \[mJ\].
    pub given_back_mj: Three,
    /// Punctures in truth, and of these those that are not felt, %.
    pub punctures: usize,
    /// See `punctures`.
    pub missed_pct: f64,
    /// How far the fall that is felt is off the true one at the run's worst puncture, %.
    pub fall_off_pct: Three,
    /// By how much the fall is felt too early or too late at the run's worst puncture \[ms\].
    pub fall_late_ms: Three,
    /// Part of the time in which the host stalls, %.
    pub stalled_pct: f64,
    /// The case with the largest root mean square.
    pub worst: String,
}

/// The trials among some cases, in groups.
pub fn spreads(cases: &[Case]) -> Vec<Spread> {
    let key = |case: &Case| {
        let trial = case.trial.as_ref()?;
        Some((case.scene.clone(), case.hand, case.host_hz, trial.factor))
    };
    let mut keys = Vec::new();
    for found in cases.iter().filter_map(key) {
        if !keys.contains(&found) {
            keys.push(found);
        }
    }
    let spread = |group: (String, &'static str, f64, &'static str)| {
        let of: Vec<&Case> = cases
            .iter()
            .filter(|case| key(case).as_ref() == Some(&group))
            .collect();
        spread(group, &of)
    };
    keys.into_iter().map(spread).collect()
}

fn spread(
    (scene, hand, host_hz, factor): (String, &'static str, f64, &'static str),
    cases: &[&Case],
) -> Spread {
    let three = |of: &dyn Fn(&Case) -> Option<f64>| {
        Three::of(cases.iter().filter_map(|case| of(case)).collect())
    };
    let sum = |of: &dyn Fn(&Case) -> Option<f64>| {
        let values = cases.iter().filter_map(|case| of(case));
        values.sum::<f64>()
    };
    let contact_s = sum(&|c| Some(c.noticed?.contact_s)).max(1e-3);
    let beyond = sum(&|c| Some(c.noticed?.contact_s * c.noticed?.beyond_pct));
    let dropouts = sum(&|c| Some(f64::from(c.noticed?.dropouts)));
    let punctures = sum(&|c| Some(c.punctures?.punctures as f64));
    let missed = sum(&|c| Some(c.punctures?.punctures_missed as f64));
    let rms = |case: &Case| case.errors.map_or(0.0, |errors| errors.rms_pct_meant);
    let worst = cases.iter().max_by(|a, b| rms(a).total_cmp(&rms(b)));
    Spread {
        group: format!("{scene} {hand} {host_hz:.0} Hz {factor}"),
        scene,
        hand,
        host_hz,
        factor,
        runs: cases.len(),
        rms_pct: three(&|c| Some(c.errors?.rms_pct_meant)),
        peak_pct: three(&|c| Some(c.errors?.peak_pct)),
        beyond_pct: three(&|c| Some(c.noticed?.beyond_pct)),
        beyond_of_all_pct: beyond / contact_s,
        dropouts_per_min: 60.0 * dropouts / contact_s,
        direction_p95_deg: three(&|c| Some(c.noticed?.direction_p95_deg)),
        given_back_mj: three(&|c| c.given_back_mj),
        punctures: punctures as usize,
        // A sum of none is -0.
        missed_pct: (100.0 * missed / punctures.max(1.0)).max(0.0),
        fall_off_pct: three(&|c| Some(c.punctures?.puncture_fall_off_pct)),
        fall_late_ms: three(&|c| Some(c.punctures?.puncture_max_ms)),
        stalled_pct: sum(&|c| Some(c.trial.as_ref()?.stalled_pct)) / cases.len().max(1) as f64,
        worst: worst.map_or(String::new(), |case| case.case.clone()),
    }
}

/// Part of a run in which its host stalls, %.
pub fn stalled_pct(blocking: Option<&Blocking>, seconds: f64) -> f64 {
    blocking.map_or(0.0, |blocking| 100.0 * blocking.stalled_part(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_p95_and_worst() {
        let values: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        let found = Three::of(values);
        assert_eq!(
            (found.median, found.p95, found.worst),
            (100.0, 190.0, 200.0)
        );
        assert_eq!(Three::of(vec![3.0]).p95, 3.0);
        assert_eq!(Three::of(Vec::new()), Three::default());
    }

    #[test]
    fn every_trial_has_a_name_of_its_own() {
        let mut specs = one_at_a_time();
        specs.extend(drawn(3, 1));
        let mut names: Vec<_> = specs.iter().map(|spec| spec.case().case).collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        let worst = known_worst();
        let known = worst.iter().all(|spec| specs.contains(spec));
        assert!(known, "what the short form has is in the full one");
    }
}
