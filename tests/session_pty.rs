//! Sessions in real time over a real pseudo-terminal. Wall-clock times are reported, never asserted.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{DEPTH_M, PLANE_N_PER_M, Plane, force, force_at_rest, plan};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use sutura_hil::{Meddler, VirtualConsole};
use sutura_host::link::{Link, LinkError, LinkOptions, Order, open_serial};
use sutura_host::session::{Attendant, Line, Plan, SessionError, Summary, run_real_time};
use sutura_shared::wire::message::{Mode, Simulate, State};

/// Longer than any machine needs.
const LONG: Duration = Duration::from_secs(60);

/// What the plane gives at most \[N\]: where the hand wants to be, and a third more for its swing.
const DEEPEST_N: f64 = 1.3 * DEPTH_M * PLANE_N_PER_M;

/// A session with a new console, and that console; once more where this machine kept the line's bytes for so long that the
/// console counted as gone.
fn whole(
    plan: &Plan,
    mut session: impl FnMut(&mut VirtualConsole) -> Result<Summary, SessionError>,
) -> (Summary, VirtualConsole) {
    for _ in 0..5 {
        let mut console = VirtualConsole::start(&plan.device).unwrap();
        match session(&mut console) {
            Err(SessionError::Link(LinkError::Gone { .. })) => {}
            ended => return (ended.unwrap(), console),
        }
    }
    panic!("the line stands still for more than half a second each time");
}

/// Whether the console was still in the session at its end. Where the machine was late with the last frames, the
/// force was decaying by then.
fn in_session(summary: &Summary) -> bool {
    summary.mode == "armed" || (summary.mode == "decaying" && summary.decays > 0)
}

/// States of a new session until one satisfies `enough`.
fn look(console: &mut VirtualConsole, enough: impl Fn(&State) -> bool) -> State {
    let link = Link::open(console.host_port().unwrap(), LinkOptions::default(), |_| {}).unwrap();
    let deadline = Instant::now() + LONG;
    loop {
        let state = *link.state(deadline).unwrap().expect("in time").body();
        if enough(&state) {
            return state;
        }
    }
}

#[test]
fn a_session_feels_the_plane_and_leaves_the_console_at_rest() {
    let plan = plan(1.5);
    let mut notes = 0;
    let (summary, mut console) = whole(&plan, |console| {
        let port = console.host_port().unwrap();
        run_real_time(port, LinkOptions::default(), &plan, &mut Plane, |note| {
            notes += 1;
            assert!(note.elapsed_s <= 1.5 + 1e-9);
            ControlFlow::Continue(())
        })
    });
    println!("{summary:#?}");
    assert!(notes > 0);
    assert_eq!((summary.frames.lost, summary.frames.rejected), (0, 0));
    assert_eq!(summary.status, "ok");
    assert!(in_session(&summary), "{}", summary.mode);
    assert_eq!((summary.ticks, summary.seconds), (1500, 1.5));
    assert_eq!(summary.device, "cartesian-bench");
    // Both springs in series. Friction (0.15 N in the stage) holds the grip up to that far from balance;
    // one encoder count is 4 mN.
    let (peak, expected) = (summary.force_n.peak, force_at_rest());
    assert!(peak > expected - 0.3, "{peak} N for {expected} N");
    // A machine so busy that the force had to decay lets the hand go deeper before it is back.
    let most = if summary.decays == 0 {
        expected + 0.3
    } else {
        DEEPEST_N
    };
    assert!(peak < most, "{peak} N for {expected} N");
    assert!(
        summary.latency_us.p50 >= 1000.0,
        "a contact cannot be used in its own state's tick"
    );

    let rest = look(&mut console, |_| true);
    assert_eq!(rest.mode, Mode::Idle);
    assert_eq!((rest.force_n, rest.current_a), ([0.0; 3], [0.0; 3]));
}

#[test]
fn a_session_that_is_stopped_ends_with_its_summary() {
    let plan = plan(3600.0);
    let (summary, mut console) = whole(&plan, |console| {
        let port = console.host_port().unwrap();
        run_real_time(port, LinkOptions::default(), &plan, &mut Plane, |note| {
            if note.elapsed_s > 0.2 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })
    });
    assert!(summary.seconds > 0.2 && summary.seconds < 3600.0);
    assert_eq!(look(&mut console, |_| true).mode, Mode::Idle);
}

/// Every frame from the tenth on: one in five cut short, one in four behind noise.
#[test]
fn a_bad_line_costs_frames_and_never_more_force() {
    let plan = plan(1.5);
    let mut largest = 0.0_f32;
    let (summary, _) = whole(&plan, |console| {
        let mut frames = 0_usize;
        let mut noise = 1_u32;
        let port = Meddler::new(console.host_port().unwrap(), move |bytes| {
            frames += 1;
            let mut line = Vec::new();
            if frames > 10 && frames.is_multiple_of(4) {
                for _ in 0..frames % 90 {
                    // xorshift (Marsaglia 2003), zeros and all
                    noise ^= noise << 13;
                    noise ^= noise >> 17;
                    noise ^= noise << 5;
                    line.push(noise as u8);
                }
            }
            let cut = if frames > 10 && frames.is_multiple_of(5) {
                bytes.len() / 2
            } else {
                bytes.len()
            };
            line.extend_from_slice(&bytes[..cut]);
            line
        });
        run_real_time(
            Line::Once(Box::new(port)),
            LinkOptions::default(),
            &plan,
            &mut Plane,
            |note| {
                largest = largest.max(force(note.state));
                ControlFlow::Continue(())
            },
        )
    });
    println!("{:?}", summary.frames);
    assert!(
        summary.frames.rejected > 0 && summary.frames.lost > 0,
        "{:?}",
        summary.frames
    );
    assert!(in_session(&summary), "{}", summary.mode);
    assert_eq!(summary.ticks, 1500);
    // Nothing of the noise is felt: no more force than the springs can give.
    let bound = DEEPEST_N;
    assert!(
        summary.force_n.peak < bound && f64::from(largest) < bound,
        "{:?}",
        summary.force_n
    );
    assert!(
        summary.force_n.peak > 0.5 * force_at_rest(),
        "and it is still felt"
    );
}

#[test]
fn an_emergency_stop_ends_the_session_in_a_fault_that_only_the_user_clears() {
    let mut plan = plan(3600.0);
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    // Pressed while nobody has a session, so that the next one finds the fault.
    let press = |console: &mut VirtualConsole, pressed: bool| {
        let link =
            Link::open(console.host_port().unwrap(), LinkOptions::default(), |_| {}).unwrap();
        link.order(Order::Simulate(Simulate::EmergencyStop(pressed)))
            .unwrap();
        link.close();
    };
    press(&mut console, true);
    let fault = look(&mut console, |state| state.mode == Mode::Fault);
    assert_eq!((fault.force_n, fault.current_a), ([0.0; 3], [0.0; 3]));
    let mut run = |plan: &_| {
        let port = console.host_port().unwrap();
        run_real_time(port, LinkOptions::default(), plan, &mut Plane, |note| {
            if note.elapsed_s > 0.1 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })
    };
    let refused = run(&plan);
    assert!(
        matches!(&refused, Err(SessionError::Fault { faults }) if faults == &["e_stop"]),
        "{refused:?}"
    );
    press(&mut console, false);
    let mut run = |plan: &_| {
        let port = console.host_port().unwrap();
        run_real_time(port, LinkOptions::default(), plan, &mut Plane, |note| {
            if note.elapsed_s > 0.1 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })
    };
    assert!(
        matches!(run(&plan), Err(SessionError::Fault { .. })),
        "a fault stays latched"
    );
    plan.clear_fault = true;
    assert!(in_session(&run(&plan).unwrap()));
}

/// Counts what it is told, and arms or not.
struct Bystander {
    told: Arc<Mutex<Vec<&'static str>>>,
    arms: bool,
}

impl Attendant for Bystander {
    fn lost(&mut self, _: &LinkError) {
        self.told.lock().unwrap().push("lost");
    }

    fn back(&mut self) {
        self.told.lock().unwrap().push("back");
    }

    fn arms(&mut self) -> bool {
        self.arms
    }
}

/// A session in the middle of which the console is replaced by one that has just booted.
fn run_with_a_loss(arms: bool) -> (Summary, Vec<&'static str>, f64) {
    let plan = plan(1.5);
    let start = move || VirtualConsole::start(&plan.device).unwrap();
    let console = Arc::new(Mutex::new(Some(start())));
    let socket = console.clone();
    let connect = move || match socket.lock().unwrap().as_mut() {
        Some(console) => console.host_port(),
        None => Err(LinkError::NoPort {
            name: "socket".to_owned(),
            found: Vec::new().into(),
        }),
    };
    let told = Arc::new(Mutex::new(Vec::new()));
    let line = Line::Again {
        connect: Box::new(connect),
        attendant: Box::new(Bystander {
            told: told.clone(),
            arms,
        }),
    };
    let (mut replaced, mut resting) = (false, 0.0_f64);
    let summary = run_real_time(line, LinkOptions::default(), &plan, &mut Plane, |note| {
        if !replaced && note.elapsed_s > 0.3 {
            replaced = true;
            *console.lock().unwrap() = None;
            *console.lock().unwrap() = Some(start());
        }
        if replaced && note.state.mode == Mode::Idle {
            resting = resting.max(f64::from(force(note.state)));
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let told = told.lock().unwrap().clone();
    (summary, told, resting)
}

#[test]
fn a_console_that_comes_back_goes_on_in_the_same_session_once_it_is_armed() {
    let (summary, told, _) = run_with_a_loss(true);
    assert_eq!(told, ["lost", "back"]);
    assert_eq!(summary.status, "ok");
    assert!(in_session(&summary), "{}", summary.mode);
    assert_eq!(summary.link.sessions, 2);
    // The hand starts anew with its console, and is felt again.
    assert!(
        summary.ticks > 400 && summary.seconds <= 1.5 + 1e-9,
        "{}",
        summary.ticks
    );
    let counted = (summary.frames.lost, summary.frames.rejected);
    assert!(
        counted.0 < 1000 && counted.1 < 1000,
        "nothing of the reset is counted: {counted:?}"
    );
}

#[test]
fn a_console_that_nobody_arms_again_stays_without_force() {
    let (summary, told, resting) = run_with_a_loss(false);
    assert_eq!(told, ["lost", "back"]);
    assert_eq!(summary.mode, "idle");
    assert!(
        summary.status.contains("nobody armed"),
        "{}",
        summary.status
    );
    assert_eq!(resting, 0.0);
    assert!(summary.seconds < 1.5);
}

#[test]
fn a_console_that_stays_away_ends_the_session_with_the_reason() {
    let plan = plan(0.8);
    let console = Arc::new(Mutex::new(Some(
        VirtualConsole::start(&plan.device).unwrap(),
    )));
    let path = console
        .lock()
        .unwrap()
        .as_ref()
        .unwrap()
        .path()
        .unwrap()
        .to_owned();
    let told = Arc::new(Mutex::new(Vec::new()));
    let line = Line::Again {
        connect: Box::new(move || open_serial(&path)),
        attendant: Box::new(Bystander {
            told: told.clone(),
            arms: true,
        }),
    };
    let ran = run_real_time(line, LinkOptions::default(), &plan, &mut Plane, |note| {
        if note.elapsed_s > 0.2 {
            *console.lock().unwrap() = None;
        }
        ControlFlow::Continue(())
    });
    assert!(
        matches!(ran, Err(SessionError::Link(LinkError::Gone { .. }))),
        "{ran:?}"
    );
    assert_eq!(*told.lock().unwrap(), ["lost"]);
}
