//! What an outage has taken away comes back, and so does what a console is armed inside of: at a bounded rate, for a bounded
//! energy, and once only until it is paid back.

#![allow(
    clippy::unwrap_used,
    clippy::single_range_in_vec_init,
    reason = "a test, with one outage or several"
)]

use crate::grip::{DAMPING, MASS, device};
use crate::rig::{frame, wall};
use core::ops::Range;
use sutura_shared::control::{Control, Guards, Rendering, TickInput, Tuning};
use sutura_shared::wire::inputs;
use sutura_shared::wire::message::{Command, Contact};

const STEPS: u32 = 20;
const STEP_S: f64 = 1e-3 / STEPS as f64;
const COUNTS_PER_M: f64 = 81_487.0;
/// Rate at which a force may come back \[N/s\], and the most energy of an outage \[J\].
const RATE: f64 = 5.0;
const CREDIT: f64 = 15e-3;

/// Hands: stiffness \[N/m\] and damping \[N s/m\]; none goes where it wants.
const HANDS: [Option<(f64, f64)>; 4] = [
    Some((50.0, 1.0)),
    Some((200.0, 2.0)),
    Some((800.0, 4.0)),
    None,
];

/// From 2 mm above the tissue to `deep` into it in half a second, and held there.
fn hold(deep: f64) -> impl Fn(f64) -> f64 {
    move |t: f64| {
        let s = f64::min(t / 0.5, 1.0);
        2e-3 - (deep + 2e-3) * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
    }
}

/// A hand on tissue that is solved 60 times a second and as much later.
struct Scene<'a> {
    /// Where the hand wants the grip at a time \[s\] \[m\].
    path: &'a dyn Fn(f64) -> f64,
    hand: Option<(f64, f64)>,
    stiffness: f32,
    /// Frames of these times are lost \[ms\].
    lost: &'a [Range<u32>],
    /// When the console is armed \[ms\].
    armed: u32,
    ms: u32,
    guards: Guards,
}

#[derive(Clone, Copy)]
struct Tick {
    /// Place of the grip \[m\].
    z: f64,
    /// Commanded, and that of the tissue there \[N\].
    force: f64,
    truth: f64,
    /// Taken from the hand so far \[J\].
    energy: f64,
    withheld: bool,
}

fn feel(scene: &Scene) -> Vec<Tick> {
    let tuning = Tuning {
        rendering: Rendering::Tangent,
        guards: scene.guards,
    };
    let mut control = Control::tuned(device(COUNTS_PER_M), tuning).unwrap();
    let path = scene.path;
    let mut z = path(0.0);
    let (mut v, mut acting, mut commanded, mut energy) = (0.0, 0.0, 0.0, 0.0);
    let mut on_the_way: Vec<(u32, u64, Contact)> = Vec::new();
    let mut solves = 0;
    let ticks = 1..=scene.ms;
    let felt = ticks.map(|ms| {
        if ms == scene.armed {
            control.command(Command::Arm);
        }
        let counts = (z * COUNTS_PER_M).floor() as i32;
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: [0, 0, counts],
            ..TickInput::default()
        };
        let arrived = on_the_way.extract_if(.., |(at, ..)| *at <= ms).last();
        let fresh = arrived.map(|(_, time_us, body)| frame(ms, time_us, body).into());
        let state = control.tick(&input, fresh.as_ref()).state;
        assert_eq!(state.faults, 0);
        if ms * 60 / 1000 > solves {
            solves = ms * 60 / 1000;
            let contact = Contact {
                horizon_us: 67_000,
                ..wall(scene.stiffness, state.position_m)
            };
            if !scene.lost.iter().any(|lost| lost.contains(&ms)) {
                on_the_way.push((ms + 17, input.now_us, contact));
            }
        }
        (acting, commanded) = (commanded, f64::from(state.force_n[2]));
        let tick = Tick {
            z,
            force: commanded,
            truth: f64::min(f64::from(scene.stiffness) * f64::max(-z, 0.0), 10.0),
            energy,
            withheld: state.inputs & inputs::WITHHELD != 0,
        };
        for step in 0..STEPS {
            let t = f64::from(ms - 1) * 1e-3 + f64::from(step) * STEP_S;
            match scene.hand {
                None => v = (path(t + STEP_S) - z) / STEP_S,
                Some((stiffness, damping)) => {
                    let pace = (path(t + STEP_S) - path(t)) / STEP_S;
                    let hand = stiffness * (path(t) - z) + damping * (pace - v);
                    v += STEP_S * (acting + hand - DAMPING * v) / MASS;
                }
            }
            z += STEP_S * v;
            energy -= acting * v * STEP_S;
        }
        tick
    });
    felt.collect()
}

/// What a return is like, from the tick at which frames come again.
#[derive(Debug)]
struct Return {
    /// Until the force is 90 % of the true one for good \[s\], and how long it may take.
    after_s: f64,
    may_s: f64,
    /// Largest change in 20 ms in all of which force was withheld \[N/s\].
    rate: f64,
    /// How far the hand has come out of where it rests at the end \[m\].
    past_m: f64,
    /// Force at the end \[N\], by how much it is off \[N\], and over the true one.
    force_n: f64,
    off_n: f64,
    share: f64,
    /// Ticks in which force was withheld.
    withheld: usize,
}

fn returned(ticks: &[Tick]) -> Return {
    let late = ticks.iter().rposition(|t| t.force < 0.9 * t.truth);
    let last = ticks[ticks.len() - 1];
    let size = ticks
        .get(late.map_or(0, |late| late + 1))
        .map_or(last.truth, |t| t.truth);
    let kept_back = ticks.windows(21).filter(|w| w.iter().all(|t| t.withheld));
    let rates = kept_back.map(|w| (w[20].force - w[0].force) / 20e-3);
    Return {
        after_s: late.map_or(0.0, |late| (late + 1) as f64 * 1e-3),
        may_s: f64::max(1.0, 0.25 + size / RATE),
        rate: rates.fold(0.0, f64::max),
        past_m: ticks.iter().map(|t| t.z).fold(f64::MIN, f64::max) - last.z,
        force_n: last.force,
        off_n: (last.force - last.truth).abs(),
        share: last.force / last.truth,
        withheld: ticks.iter().filter(|t| t.withheld).count(),
    }
}

/// Least energy taken from the hand so far \[J\].
fn least(ticks: &[Tick]) -> f64 {
    ticks.iter().map(|t| t.energy).fold(0.0, f64::min)
}

const STIFFNESSES: [f32; 3] = [300.0, 800.0, 1500.0];
const DEEP: [f64; 2] = [6e-3, 10e-3];

/// Where hand and tissue balance, as a force \[N\], and what pushing the hand out to there takes \[J\].
fn balance(hand: Option<(f64, f64)>, stiffness: f32, deep: f64) -> (f64, f64) {
    let stiffness = f64::from(stiffness);
    match hand {
        None => (stiffness * deep, 0.0),
        Some((hand, _)) => {
            let force = deep * hand * stiffness / (hand + stiffness);
            (force, force * force / (2.0 * hand))
        }
    }
}

fn check(what: &str, ticks: &[Tick], from: usize) {
    let found = returned(&ticks[from..]);
    assert!(found.after_s <= found.may_s, "{what}: {found:?}");
    assert!(found.rate <= RATE, "{what}: {found:?}");
    assert!(found.past_m <= 2e-3, "{what}: {found:?}");
    // To what a finger notices.
    assert!(
        found.off_n < 0.1 * found.force_n + 0.03,
        "{what}: {found:?}"
    );
    // It says so while it keeps force back, and no longer.
    assert!(found.withheld > 20, "{what}: {found:?}");
    assert!(
        (found.withheld as f64) < 1e3 * found.may_s,
        "{what}: {found:?}"
    );
    assert!(least(ticks) > -CREDIT - 0.5e-3, "{what}: {}", least(ticks));
}

#[test]
fn what_an_outage_takes_away_comes_back() {
    for hand in HANDS {
        for stiffness in STIFFNESSES {
            for deep in DEEP {
                for out_ms in [100, 200, 300, 500] {
                    let scene = Scene {
                        path: &hold(deep),
                        hand,
                        stiffness,
                        lost: &[1500..1500 + out_ms],
                        armed: 1,
                        ms: 4500,
                        guards: Guards::ALL,
                    };
                    let what = format!("{hand:?}, {stiffness} N/m, {deep} m, {out_ms} ms");
                    // The first frame comes within a period and as much.
                    check(&what, &feel(&scene), 1500 + out_ms as usize + 34);
                }
            }
        }
    }
}

#[test]
fn what_a_console_is_armed_inside_of_comes() {
    for hand in HANDS {
        for stiffness in STIFFNESSES {
            for deep in DEEP {
                let (_, work) = balance(hand, stiffness, deep);
                // More than may be lent: the tool is deeper inside than a hand of that stiffness ever pressed.
                if work > CREDIT {
                    continue;
                }
                let scene = Scene {
                    path: &|_| -deep,
                    hand,
                    stiffness,
                    lost: &[],
                    armed: 200,
                    ms: 4000,
                    guards: Guards::ALL,
                };
                check(
                    &format!("{hand:?}, {stiffness} N/m, {deep} m"),
                    &feel(&scene),
                    200,
                );
            }
        }
    }
}

/// The console before: one stall, and the tissue is gone until the hand leaves it.
#[test]
fn without_credit_the_tissue_is_lost() {
    let press = hold(10e-3);
    let scene = |lost: &'static [Range<u32>], armed, path| Scene {
        path,
        hand: Some((200.0, 2.0)),
        stiffness: 300.0,
        lost,
        armed,
        ms: 6000,
        guards: Guards {
            credit: false,
            ..Guards::ALL
        },
    };
    let stalled = feel(&scene(&[1500..1700], 1, &press));
    let inside = feel(&scene(&[], 200, &|_| -10e-3));
    for ticks in [stalled, inside] {
        let found = returned(&ticks[2000..]);
        assert!(found.share < 0.5 && found.withheld > 3900, "{found:?}");
    }
}

/// Stall upon stall in one press: the line of credit is one, whatever happens, and the console says when it is out of it.
#[test]
fn a_second_outage_begins_no_second_credit() {
    let lost: Vec<Range<u32>> = (0..20).map(|n| 1500 + 1500 * n..1800 + 1500 * n).collect();
    for (stiffness, out) in [(300.0, false), (1500.0, true)] {
        let ticks = feel(&Scene {
            path: &hold(10e-3),
            hand: Some((200.0, 2.0)),
            stiffness,
            lost: &lost,
            armed: 1,
            ms: 32_000,
            guards: Guards::ALL,
        });
        let least = least(&ticks);
        assert!(least > -CREDIT - 0.5e-3 && least < -0.8 * CREDIT, "{least}");
        let last = returned(&ticks[31_000..]);
        assert!(last.share < 0.9 && last.withheld > 900, "{out} {last:?}");
    }
}

/// What is owed is paid back by the hand's motion: a minute of presses, and the next stall has credit again.
#[test]
fn what_is_owed_is_paid_back() {
    let stalls = [1500..1800, 3000..3300, 4500..4800, 6000..6300, 7500..7800];
    let late = 60_000..60_300;
    let lost = [&stalls[..], core::slice::from_ref(&late)].concat();
    let path = |t: f64| match t {
        t if t < 9.0 => hold(10e-3)(t),
        t if t < 58.0 => -4e-3 - 6e-3 * (2.0 * core::f64::consts::PI * (t - 9.0)).cos(),
        t => 2e-3 + hold(10e-3)(t - 58.0) - 2e-3,
    };
    let ticks = feel(&Scene {
        path: &path,
        hand: Some((200.0, 2.0)),
        stiffness: 300.0,
        lost: &lost,
        armed: 1,
        ms: 63_000,
        guards: Guards::ALL,
    });
    for ms in [8_900, 20_000, 40_000, 57_900] {
        println!("{ms} {:.2} mJ", 1e3 * ticks[ms].energy);
    }
    let again = returned(&ticks[60_334..]);
    assert!(again.after_s < 1.0 && again.share > 0.9, "{again:?}");
    // In presses that are paid for nothing is withheld.
    let presses = returned(&ticks[50_000..57_000]);
    assert!(presses.withheld == 0, "{presses:?}");
}
