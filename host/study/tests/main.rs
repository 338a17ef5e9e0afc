//! The simulation of the force: that it tells good renderings from bad ones, and a few of the bars, in a form
//! short enough for every run of the tests. `sutura fidelity` has them all.

use std::ops::ControlFlow;
use sutura_shared::control::Rendering;
use sutura_study::fidelity::around::Around;
use sutura_study::fidelity::bars::{Bar, bars};
use sutura_study::fidelity::case::{Case, Place, Question, Scenes, Spec};
use sutura_study::fidelity::hand::{Grasp, Motion};
use sutura_study::fidelity::link::LinkSpec;
use sutura_study::fidelity::returns::{self, Away};
use sutura_study::fidelity::stops::{STOPS, Stop};
use sutura_study::fidelity::suite::{guarded, measure};
use sutura_study::fidelity::switches::all_but;
use sutura_study::fidelity::trials::{Factor, one_at_a_time};

fn run(specs: &[Spec]) -> Vec<Case> {
    let scenes = Scenes::load().expect("the shipped scene");
    let cases =
        measure(specs, &scenes, 1, &|_, _| ControlFlow::Continue(())).expect("sound mechanics");
    for case in &cases {
        println!("{case:?}");
    }
    cases
}

fn rms(case: &Case) -> f64 {
    case.errors.expect("errors were asked for").rms_pct
}

/// What every published comparison rests on: a held force is far off, the tangent follows.
#[test]
fn the_tangent_is_many_times_truer_than_a_held_force() {
    let of = |rendering| Spec {
        seconds: 1.5,
        ..Spec::errors(Place::Point, Motion::Presses, rendering, 60.0)
    };
    let full = of(Rendering::Hold).full();
    let cases = run(&[of(Rendering::Hold), of(Rendering::Tangent), full]);
    let [hold, tangent, full] = [0, 1, 2].map(|i: usize| rms(&cases[i]));
    // A speed of 38 mm/s held for 25 ms on average, over 10 mm.
    assert!((5.0..15.0).contains(&hold), "{hold}");
    assert!(tangent < 0.2 * hold && tangent < 1.5, "{tangent}");
    // A tick and a half of delay at the same speed, but nothing else.
    assert!(full < 0.7, "{full}");
}

#[test]
fn the_real_solver_behind_a_late_link_meets_its_bars_in_presses() {
    let spec = Spec {
        seconds: 1.2,
        ..Spec::errors(Place::Palpation, Motion::Presses, Rendering::Rows, 60.0)
    };
    let cases = run(&[spec]);
    let bars = bars(&cases);
    assert_eq!(bars.len(), 3, "{bars:?}");
    assert!(bars.iter().all(|bar| bar.ok), "{bars:?}");
}

/// The same seeds, the same figures.
#[test]
fn a_run_can_be_repeated() {
    let spec = Spec {
        seconds: 0.5,
        grasp: Grasp::PEN,
        link: LinkSpec {
            loss: 0.2,
            jitter_s: 5e-3,
            reordered: 0.2,
            ..LinkSpec::ideal(60.0)
        },
        ..Spec::errors(Place::Point, Motion::Taps, Rendering::Rows, 60.0)
    };
    let cases = run(&[spec, spec]);
    assert_eq!(cases[0], cases[1]);
}

/// Stiff tissue at 30 Hz: the held force loses nearly all of what the full loop can, the tangent keeps it, also
/// if it is wrong.
#[test]
fn the_tangent_keeps_the_stiffness_of_the_full_loop() {
    let cases = run(&[
        Spec::stiffest(Rendering::Hold, 1000.0, 1.0).full(),
        Spec::stiffest(Rendering::Hold, 30.0, 1.0),
        Spec::stiffest(Rendering::Tangent, 30.0, 1.0),
        Spec::stiffest(Rendering::Tangent, 30.0, 2.0),
    ]);
    let ratio = |i: usize| cases[i].k_ratio.expect("stiffness was asked for");
    assert!(ratio(1) < 0.2 * ratio(2), "{}", ratio(1));
    assert!(ratio(2) > 0.9, "{}", ratio(2));
    assert!(ratio(3) > 0.5, "{}", ratio(3));
}

/// A needle that is pressed in and drawn out at 60 Hz: what is felt, and when the boundary gives way.
#[test]
fn the_needle_goes_on_as_the_tissue_does() {
    let of = |rendering| Spec {
        seconds: 2.0,
        ..Spec::errors(Place::Needle, Motion::Presses, rendering, 60.0)
    };
    let cases = run(&[of(Rendering::Rows), of(Rendering::Tangent)]);
    let punctures = cases[0].punctures.expect("two punctures");
    assert_eq!(punctures.punctures, 2);
    assert!(punctures.puncture_max_ms <= 8.0, "{punctures:?}");
    // Measured: 2.2 % and 16 %.
    let errors = cases[0].errors.expect("errors were asked for");
    assert!(
        errors.rms_pct <= 3.0 && errors.peak_pct <= 20.0,
        "{errors:?}"
    );
    assert!(errors.rms_pct < 0.3 * rms(&cases[1]));
}

#[test]
fn a_sutures_pull_meets_its_bars() {
    let spec = Spec::errors(Place::Thread, Motion::Pulls, Rendering::Rows, 60.0);
    let cases = run(&[spec]);
    // Slack at first: without a pull there is nothing to be wrong about.
    assert!(cases[0].errors.expect("errors").force_max_n > 0.3);
    let bars = bars(&cases);
    assert_eq!(bars.len(), 3, "{bars:?}");
    assert!(bars.iter().all(|bar| bar.ok || bar.open), "{bars:?}");
}

/// Without one guard the bar that shows what it is for fails, and with all of them it does not.
#[test]
fn a_bar_fails_without_its_guard() {
    let mut cheap: Vec<Spec> = guarded(1.2)
        .into_iter()
        .filter(|spec| spec.question != Question::Stiffest && spec.place != Place::Gristle)
        .collect();
    cheap.extend(STOPS.map(Stop::spec));
    let outage = Away::Outage(300);
    cheap.push(returns::spec(Place::Point, Grasp::PEN, outage, 60.0));
    let failing = |bars: &[Bar]| {
        let failing = bars.iter().filter(|bar| !bar.ok);
        failing.map(|bar| bar.name.clone()).collect::<Vec<_>>()
    };
    let with_all = bars(&run(&cheap));
    assert_eq!(failing(&with_all), [""; 0], "{with_all:?}");
    for (guard, bar) in [
        (
            "trust",
            "point presses and tremor, tangent x0.5 and x2, rms %",
        ),
        ("force", "rogue host: force N"),
        ("slew", "hard slope: force across it while it grows N"),
        ("power", "rogue host: power W, console of 5 W"),
        ("residual", "rows that nobody can solve: rms %"),
        (
            "credit",
            "return point: 90 % of the force, of the time allowed",
        ),
        ("horizon", "force N at the end of an outage"),
        ("emergency_stop", "force N after a stop"),
        ("encoder_jump", "force N after a stop"),
        ("encoder_burst", "force N after a stop"),
        ("disarm", "force N after a stop"),
    ] {
        let specs: Vec<Spec> = cheap
            .iter()
            .map(|spec| Spec {
                guards: all_but(guard),
                ..*spec
            })
            .collect();
        let failing = failing(&bars(&run(&specs)));
        assert!(
            failing.iter().any(|name| name == bar),
            "{guard}: {failing:?}"
        );
    }
}

/// What ran before changes no bit of a case: nothing is handed on from run to run that a run can feel.
#[test]
fn the_order_of_cases_changes_no_bit() {
    let of = |motion, hz| Spec {
        seconds: 0.8,
        ..Spec::errors(Place::Palpation, motion, Rendering::Rows, hz)
    };
    let (taps, strokes) = (of(Motion::Taps, 30.0), of(Motion::Strokes, 60.0));
    let first = run(&[taps, strokes]);
    let last = run(&[strokes, taps]);
    assert_eq!([&first[0], &first[1]], [&last[1], &last[0]]);
    assert!(rms(&first[0]) > 0.0 && rms(&first[1]) > 0.0);
}

/// A host that blocks is late by its recorded solves; the same seed, the same run.
#[test]
fn a_blocking_host_stalls_by_its_seed() {
    let stalled = one_at_a_time().into_iter().find(|spec| {
        matches!(spec.question, Question::Trial(Factor::Stalls)) && spec.place == Place::RoundThin
    });
    let stalled = stalled.expect("there are some");
    let planned = Spec {
        around: Around::planned(),
        ..stalled
    };
    let cases = run(&[stalled, planned, stalled]);
    assert_eq!(cases[0], cases[2]);
    assert_ne!(cases[0].errors, cases[1].errors);
    let trial = |i: usize| cases[i].trial.expect("a trial");
    // At least two stalls of more than a period in two seconds.
    assert!(trial(0).stalled_pct > 1.5, "{:?}", trial(0));
    assert_eq!(trial(1).stalled_pct, 0.0);
}

/// The host's phase is no factor where the hand rests, and is one where it taps.
#[test]
fn a_phase_shifts_the_hosts_turns() {
    let of = |motion, phase| Spec {
        seconds: 1.0,
        around: Around {
            phase,
            ..Around::planned()
        },
        ..Spec::errors(Place::Point, motion, Rendering::Tangent, 30.0)
    };
    let cases = run(&[
        of(Motion::Taps, 0.0),
        of(Motion::Taps, 0.5),
        of(Motion::Taps, 1.0),
    ]);
    assert_ne!(rms(&cases[0]), rms(&cases[1]));
    // A whole period later the same turns are there but for the first.
    let errors = |i: usize| cases[i].errors.expect("errors");
    assert!((errors(0).rms_pct - errors(2).rms_pct).abs() < 0.05 * errors(0).rms_pct);
}
