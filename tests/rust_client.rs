//! Another simulator's session from Rust: no solver, a sphere by its tangent, and what goes wrong.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{self, Said, Tap, undisturbed};
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_client::message::{Fixture, HandScript, Mode, Simulate, WAY_POINTS, WayPoint};
use sutura_client::{Console, Contact, Error, Options, Pose};
use sutura_hil::{Pty, VirtualConsole, serve};
use sutura_shared::control::LOST_AFTER_US;
use sutura_shared::simulated_console::SimulatedConsole;

/// Longer than any machine needs.
const LONG: Duration = Duration::from_secs(60);
/// Poses at rest after which a console is armed again.
const ARM_AGAIN: u32 = 50;
const STIFFNESS: f32 = 400.0;
/// Of the sphere, whose top is the origin \[m\].
const RADIUS: f32 = 0.05;

fn length(v: [f32; 3]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

/// Force of the sphere on a grip there \[N\], and its normal.
fn law([x, y, z]: [f32; 3]) -> ([f32; 3], [f32; 3], f32) {
    let away = [x, y, z + RADIUS];
    let distance = length(away);
    let normal = away.map(|x| x / distance);
    let push = STIFFNESS * (RADIUS - distance).max(0.0);
    (normal.map(|n| push * n), normal, distance)
}

fn sphere(pose: &Pose) -> Contact {
    let (force, normal, distance) = law(pose.position_m);
    let stiffness = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let along = normal[i] * normal[j];
            let across = if i == j { 1.0 - along } else { -along };
            length(force) / distance * across - STIFFNESS * along
        })
    });
    let contact = if distance > RADIUS {
        Contact::apart(distance - RADIUS, normal)
    } else {
        Contact::touching(force, normal)
    };
    contact.with_stiffness(stiffness)
}

/// From 10 mm above the sphere to 10 mm below its top and 6 mm aside.
fn hand() -> Simulate {
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    way_points[0].position_m = [0.0, 0.0, 0.01];
    way_points[1] = WayPoint {
        time_s: 0.4,
        position_m: [0.006, 0.0, -0.01],
    };
    Simulate::Hand(HandScript {
        stiffness_n_per_m: 1000.0,
        damping_n_s_per_m: 10.0,
        start_joint: [0.0, 0.0, 0.01],
        count: 2,
        way_points,
    })
}

fn open(console: &mut VirtualConsole, options: Options) -> Console {
    Console::open(console.path().unwrap(), options).unwrap()
}

/// Reads poses and answers them, every `period`, until one satisfies `enough`. A console that went to rest, because this
/// machine was late for half a second, is armed again.
fn render(
    console: &Console,
    period: Duration,
    answer: impl Fn(&Console, &Pose),
    enough: impl Fn(&Pose) -> bool,
) -> Pose {
    let deadline = Instant::now() + LONG;
    let mut resting = 0;
    loop {
        let pose = console.pose(LONG).unwrap().expect("in time");
        if enough(&pose) {
            return pose;
        }
        assert!(Instant::now() < deadline, "never: {pose:?}");
        resting = if pose.mode == Mode::Idle {
            resting + 1
        } else {
            0
        };
        if resting == ARM_AGAIN {
            console.arm().unwrap();
            resting = 0;
        }
        answer(console, &pose);
        std::thread::sleep(period);
    }
}

/// At 30 contacts a second the console's own 1 kHz makes the sphere: at rest its force is the sphere's law to three steps
/// of the encoders, 15 mN.
#[test]
fn a_slow_simulator_renders_its_sphere() {
    let mut bench = VirtualConsole::start(&session::device()).unwrap();
    let options = Options {
        horizon: Duration::from_millis(150),
        ..Options::default()
    };
    let console = open(&mut bench, options);
    assert!(console.info().simulated);
    console.simulate(&hand()).unwrap();
    console.arm().unwrap();
    let answer = |console: &Console, pose: &Pose| {
        console.send_contact(pose, &sphere(pose)).unwrap();
    };
    let rest = render(&console, Duration::from_millis(33), answer, |pose| {
        let (force, ..) = law(pose.position_m);
        let off = [0, 1, 2].map(|i| pose.force_n[i] - force[i]);
        let still = pose.velocity_m_per_s == [0.0; 3];
        pose.mode == Mode::Armed && length(force) > 2.0 && still && length(off) < 0.015
    });
    println!("{rest:?}");
    assert!(rest.is_armed() && rest.fault_names().next().is_none());
    assert!(
        rest.force_n[0] > 0.1,
        "the normal of a sphere turns: {rest:?}"
    );
    let counters = console.close();
    assert!(counters.contacts_sent > 0 && counters.frames.frames_rejected == 0);
}

#[test]
fn a_plain_force_is_felt_and_fades_when_nobody_renews_it() {
    let mut bench = VirtualConsole::start(&session::device()).unwrap();
    let console = open(&mut bench, Options::default());
    console.simulate(&hand()).unwrap();
    console.arm().unwrap();
    let push = |console: &Console, pose: &Pose| {
        console.send_force(pose, [0.0, 0.0, 1.0]).unwrap();
    };
    let held = render(&console, Duration::ZERO, push, |pose| {
        // What the hand has not put in is not given.
        pose.force_n[2] > 0.9
    });
    assert!(held.force_n[2] < 1.01, "{held:?}");
    // A simulator that hangs.
    let deadline = Instant::now() + LONG;
    let faded = loop {
        let pose = console.pose(LONG).unwrap().expect("in time");
        if pose.force_n == [0.0; 3] {
            break pose;
        }
        assert!(Instant::now() < deadline, "never: {pose:?}");
    };
    assert!(faded.contact_age_us > 60_000, "{faded:?}");
}

#[test]
fn what_a_console_would_refuse_is_not_sent() {
    let mut bench = VirtualConsole::start(&session::device()).unwrap();
    let console = open(&mut bench, Options::default());
    let pose = console.pose(LONG).unwrap().unwrap();
    let slanted = Contact::touching([0.0, 0.0, 1.0], [0.0, 1.0, 1.0]);
    let strong = Contact::force([0.0, 0.0, f32::MAX]);
    let empty = Contact::force([f32::NAN, 0.0, 0.0]);
    for contact in [slanted, strong, empty] {
        let refused = console.send_contact(&pose, &contact);
        assert!(
            matches!(&refused, Err(Error::Unsendable { .. })),
            "{refused:?}"
        );
        assert!(!refused.unwrap_err().help().is_empty());
    }
    let wall = Fixture::Wall {
        point_m: [0.0; 3],
        normal: [0.0; 3],
        stiffness_n_per_m: 100.0,
        damping_n_s_per_m: 0.0,
    };
    assert!(matches!(
        console.fixture(&wall),
        Err(Error::Unsendable { .. })
    ));
    console.send_contact(&pose, &sphere(&pose)).unwrap();
    let counters = console.close();
    assert_eq!(
        (counters.frames.frames_rejected, counters.frames.frames_lost),
        (0, 0)
    );
}

/// By an order, not because nothing comes any more: the console is at rest before it would have been of itself.
#[test]
fn a_dropped_console_is_disarmed() {
    let age_at_rest_us = undisturbed(|| {
        let pty = Pty::open().unwrap();
        let path = pty.path().to_owned();
        let (tap, said) = Tap::new(Box::new(pty));
        let bench = SimulatedConsole::new(&session::device(), 7).unwrap();
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| serve(bench, Box::new(tap), &stop));
            // Whatever fails, the console must end for the test to end.
            let age = std::panic::catch_unwind(AssertUnwindSafe(|| dropped(&path, &said)));
            stop.store(true, Ordering::Relaxed);
            age.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    });
    assert!(age_at_rest_us < LOST_AFTER_US, "{age_at_rest_us}");
}

/// Renders, drops the console, and waits until it rests: the age of its contact then \[us\]. None where this machine was
/// late for so long that it went to rest by itself.
fn dropped(path: &str, said: &Said) -> Option<u32> {
    let console = Console::open(path, Options::default()).unwrap();
    console.simulate(&hand()).unwrap();
    console.arm().unwrap();
    let answer = |console: &Console, pose: &Pose| {
        console.send_contact(pose, &sphere(pose)).unwrap();
    };
    render(&console, Duration::ZERO, answer, |pose| {
        pose.mode == Mode::Armed && pose.contact_age_us < LOST_AFTER_US
    });
    drop(console);
    let deadline = Instant::now() + LONG;
    loop {
        let states = said.states();
        let armed = states.iter().rposition(|state| state.mode == Mode::Armed)?;
        let rest = states[armed..]
            .iter()
            .find(|state| state.mode == Mode::Idle);
        if let Some(rest) = rest {
            return (rest.contact_age_us < LOST_AFTER_US).then_some(rest.contact_age_us);
        }
        assert!(Instant::now() < deadline, "it never rests");
        std::thread::sleep(Duration::from_millis(50));
    }
}
