//! What the hand can get out of the console: the ledger here is the true motion's, at 20 kHz, and not the console's own.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{frame, wall};
use sutura_shared::control::{Control, Guards, Rendering, TickInput, Tuning};
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Contact};

const STEPS: u32 = 20;
const STEP_S: f64 = 1e-3 / STEPS as f64;
const COUNTS_PER_M: f64 = 81_487.0;
const MASS: f64 = 0.1;
const DAMPING: f64 = 0.5;
/// A hand's stiffness \[N/m\] and damping \[N s/m\].
const HAND: (f64, f64) = (200.0, 2.0);

fn device() -> DeviceDescription {
    let joint = Joint {
        counts_per_unit: COUNTS_PER_M as f32,
        zero_counts: 0,
        effort_per_amp: 1.0,
        max_current_a: 40.0,
        max_slew_per_s: 4000.0,
        max_speed_per_s: 5.0,
        inertia: MASS as f32,
        damping: DAMPING as f32,
        coulomb: 0.0,
    };
    DeviceDescription {
        name: [0; 16],
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [joint; 3],
        gravity_mass_kg: [0.0; 3],
        max_force_n: 30.0,
        max_power_w: 30.0,
        max_grip_speed_m_per_s: 3.0,
        actuation_delay_us: 1000,
    }
}

/// Where the hand wants the grip at a time \[s\]: place \[m\] and velocity \[m/s\].
type Path = fn(f64) -> (f64, f64);

/// From 2 mm above the wall to 10 mm into it, once a second.
fn press(t: f64) -> (f64, f64) {
    let (sine, cosine) = (2.0 * core::f64::consts::PI * t).sin_cos();
    (6e-3 * cosine - 4e-3, -12e-3 * core::f64::consts::PI * sine)
}

/// Down to 30 mm in half a second, and held there.
fn sink(t: f64) -> (f64, f64) {
    if t < 0.5 {
        (5e-3 - 0.07 * t, -0.07)
    } else {
        (-0.03, 0.0)
    }
}

/// One axis of a console on a wall of `stiffness`, whose frames come every `period_ms` and as much later.
struct Scene {
    path: Path,
    stiffness: f32,
    period_ms: u32,
    /// Whether the frame of the tick in ms is lost.
    lost: fn(u32) -> bool,
    /// What the tangent is wrong by.
    tangent: f32,
    guards: Guards,
    /// The hand keeps to its path whatever the force.
    rigid: bool,
    ms: u32,
}

impl Scene {
    fn new(path: Path) -> Self {
        Scene {
            path,
            stiffness: 1500.0,
            period_ms: 33,
            lost: |_| false,
            tangent: 1.0,
            guards: Guards::ALL,
            rigid: false,
            ms: 6000,
        }
    }
}

#[derive(Debug, Default)]
struct Felt {
    /// Least energy taken from the hand \[J\].
    least_j: f64,
    /// RMS error of the acting force against the wall's, as part of the wall's largest.
    rms: f64,
    /// Force at the end over the wall's there.
    share: f64,
    /// Distance of the grip's extremes in the last second \[m\].
    swing_m: f64,
    faults: u16,
}

fn feel(scene: &Scene) -> Felt {
    let tuning = Tuning {
        rendering: Rendering::Tangent,
        guards: scene.guards,
    };
    let mut control = Control::tuned(device(), tuning).unwrap();
    control.command(Command::Arm);
    let (mut z, mut v) = (scene.path)(0.0);
    let (mut acting, mut commanded, mut energy) = (0.0, 0.0, 0.0);
    let (mut squares, mut largest) = (0.0, 0.0_f64);
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    let mut on_the_way: Vec<(u32, u64, Contact)> = Vec::new();
    let mut felt = Felt::default();
    let wall_force = |z: f64| f64::from(scene.stiffness) * f64::max(-z, 0.0);
    for ms in 1..=scene.ms {
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: [0, 0, (z * COUNTS_PER_M).floor() as i32],
            ..TickInput::default()
        };
        let arrived = on_the_way.extract_if(.., |(at, ..)| *at <= ms).last();
        let fresh = arrived.map(|(_, time_us, body)| frame(ms, time_us, body).into());
        let state = control.tick(&input, fresh.as_ref()).state;
        felt.faults |= state.faults;
        if ms.is_multiple_of(scene.period_ms) && !(scene.lost)(ms) {
            let mut contact = wall(scene.stiffness, state.position_m);
            contact.tangent[11] *= scene.tangent;
            on_the_way.push((ms + scene.period_ms, input.now_us, contact));
        }
        (acting, commanded) = (commanded, f64::from(state.force_n[2]));
        for step in 0..STEPS {
            let t = f64::from(ms - 1) * 1e-3 + f64::from(step) * STEP_S;
            let (target, speed) = (scene.path)(t);
            let hand = HAND.0 * (target - z) + HAND.1 * (speed - v);
            if scene.rigid {
                v = ((scene.path)(t + STEP_S).0 - z) / STEP_S;
            } else {
                v += STEP_S * (acting + hand - DAMPING * v) / MASS;
            }
            z += STEP_S * v;
            energy -= acting * v * STEP_S;
            felt.least_j = felt.least_j.min(energy);
            squares += (acting - wall_force(z)).powi(2);
            largest = largest.max(wall_force(z));
        }
        if ms + 1000 > scene.ms {
            (low, high) = (low.min(z), high.max(z));
        }
    }
    felt.rms = (squares / f64::from(scene.ms * STEPS)).sqrt() / largest;
    felt.share = acting / wall_force(z);
    felt.swing_m = high - low;
    felt
}

const WITHOUT_TANK: Guards = Guards {
    tank: false,
    damping: false,
    ..Guards::ALL
};

/// The bar on the energy that a console may give away \[J\], and on what it may give for forces that come back.
const BAR: f64 = -1e-3;
const CREDIT: f64 = -15e-3;

/// Frames of a fifth of a second are lost, over and over: the horizon ends, the hand sinks in, and the force comes
/// back where nobody has paid for it.
#[test]
fn a_force_that_comes_back_is_paid_for() {
    let gaps = |ms: u32| ms % 700 < 200;
    for stiffness in [300.0, 1500.0] {
        for period_ms in [10, 17, 33] {
            for path in [press as Path, sink] {
                let scene = |guards| Scene {
                    stiffness,
                    period_ms,
                    lost: gaps,
                    guards,
                    ..Scene::new(path)
                };
                let felt = feel(&scene(Guards::ALL));
                let bar = BAR + CREDIT;
                assert!(felt.least_j > bar, "{stiffness} {period_ms}: {felt:?}");
                assert_eq!(felt.faults, 0);
                let unlent = feel(&scene(Guards {
                    credit: false,
                    ..Guards::ALL
                }));
                assert!(unlent.least_j > BAR, "{stiffness} {period_ms}: {unlent:?}");
            }
        }
    }
    let free = feel(&Scene {
        lost: gaps,
        guards: WITHOUT_TANK,
        ..Scene::new(press)
    });
    assert!(free.least_j < 10.0 * BAR, "{free:?}");
}

/// An elastic wall gives back what it took: the guards must not be felt there.
#[test]
fn presses_at_one_hertz_do_not_feel_the_guards() {
    for period_ms in [17, 33] {
        for rigid in [true, false] {
            for stiffness in [300.0, 1500.0] {
                let scene = |guards| Scene {
                    stiffness,
                    period_ms,
                    rigid,
                    guards,
                    ..Scene::new(press)
                };
                let (with, without) = (feel(&scene(Guards::ALL)), feel(&scene(WITHOUT_TANK)));
                assert!(with.rms < without.rms + 0.003, "{with:?} {without:?}");
                assert!(with.rms < 0.01 && with.least_j > BAR, "{with:?}");
            }
        }
    }
}

/// Tangents that are wrong by a factor swing up; the tank ends it, and most of the force stays.
#[test]
fn wrong_tangents_give_no_energy_away() {
    let scene = |stiffness, tangent, guards| Scene {
        tangent,
        stiffness,
        guards,
        ..Scene::new(sink)
    };
    for stiffness in [400.0, 800.0, 3000.0, 6000.0] {
        for tangent in [0.5, 0.75, 1.0, 1.25, 2.0] {
            let felt = feel(&scene(stiffness, tangent, Guards::ALL));
            assert!(felt.least_j > BAR, "{stiffness} {tangent}: {felt:?}");
            assert!(
                felt.share > 0.5 && felt.swing_m < 1e-4,
                "{stiffness} {tangent}: {felt:?}"
            );
        }
    }
    // Where nothing is learnt of the tangent either, nor of the swing, that would go on; with the tank alone it cannot be fed.
    let untrusting = |tank| Guards {
        trust: false,
        bend: false,
        swing: false,
        tank,
        damping: tank,
        ..Guards::ALL
    };
    for (stiffness, tangent) in [(400.0, 2.0), (3000.0, 0.5)] {
        let free = feel(&scene(stiffness, tangent, untrusting(false)));
        assert!(free.least_j < 100.0 * BAR, "{free:?}");
        let held = feel(&scene(stiffness, tangent, untrusting(true)));
        assert!(held.least_j > BAR && held.share > 0.5, "{held:?}");
    }
}

/// A grip that is faster than its limit under power for five ticks is a fault; without power it is not.
#[test]
fn a_grip_that_is_too_fast_is_a_fault_under_power_only() {
    let fault_after = |armed: bool, counts: i32| {
        let mut control = Control::new(device()).unwrap();
        if armed {
            control.command(Command::Arm);
        }
        let ticks = 1..=60_i32;
        let mut at = 0;
        let first = ticks.map(|tick| {
            // Up to speed by steps that are no jump.
            at += ((tick - 20).max(0) * 75).min(counts);
            let input = TickInput {
                now_us: tick as u64 * 1000,
                encoder_counts: [0, 0, at],
                ..TickInput::default()
            };
            control.tick(&input, None).state.faults
        });
        let faults: Vec<u16> = first.collect();
        assert!(faults.iter().all(|f| *f == 0 || *f == faults::OVERSPEED));
        faults.iter().position(|f| *f != 0)
    };
    // 3 m/s are 244 counts in a tick.
    assert_eq!(fault_after(true, 230), None);
    assert_eq!(fault_after(false, 300), None);
    let found = fault_after(true, 300).unwrap();
    // At speed from tick 24 on, index 23: five ticks, and two until the estimate is there.
    assert!((27..=30).contains(&found), "{found}");
}

/// Without any host: a wall that the console renders by itself, pressed and left at 1 Hz.
#[test]
fn a_fixed_wall_needs_no_host_and_gives_no_energy_away() {
    use sutura_shared::wire::message::{Fixture, Mode};
    use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, ValidFixture};
    let mut control = Control::new(device()).unwrap();
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::Fixture,
        session: 1,
        sequence: 1,
        console_time_us: 0,
    };
    let fixture = |fixture| ValidFixture::new(header, fixture).unwrap();
    control.fix(&fixture(Fixture::Wall {
        point_m: [0.0; 3],
        normal: [0.0, 0.0, 1.0],
        stiffness_n_per_m: 1000.0,
        damping_n_s_per_m: 1.0,
    }));
    control.command(Command::Arm);
    let (mut z, mut v) = press(0.0);
    let (mut commanded, mut energy, mut least) = (0.0, 0.0, 0.0_f64);
    let (mut worst, mut deepest) = (0.0_f64, 0.0_f64);
    for ms in 1..=4000_u32 {
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts: [0, 0, (z * COUNTS_PER_M).floor() as i32],
            ..TickInput::default()
        };
        let state = control.tick(&input, None).state;
        assert!(ms < 3 || state.mode == Mode::Armed);
        let acting = core::mem::replace(&mut commanded, f64::from(state.force_n[2]));
        for step in 0..STEPS {
            let t = f64::from(ms - 1) * 1e-3 + f64::from(step) * STEP_S;
            let (target, speed) = press(t);
            let hand = HAND.0 * (target - z) + HAND.1 * (speed - v);
            v += STEP_S * (acting + hand - DAMPING * v) / MASS;
            z += STEP_S * v;
            energy -= acting * v * STEP_S;
            least = least.min(energy);
            let wall = 1000.0 * f64::max(-z, 0.0) - if z < 0.0 { v } else { 0.0 };
            worst = worst.max((acting - wall.max(0.0)).abs());
            deepest = deepest.max(-z);
        }
    }
    assert!(least > BAR, "{least}");
    assert!(
        deepest > 1e-3 && worst < 0.1 * 1000.0 * deepest,
        "{worst} N, {deepest} m"
    );
    // Taken down, nothing is left.
    control.fix(&fixture(Fixture::None));
    let input = TickInput {
        now_us: 4_001_000,
        encoder_counts: [0, 0, -400],
        ..TickInput::default()
    };
    control.tick(&input, None);
    assert_eq!(control.tick(&input, None).state.force_n, [0.0; 3]);
}
