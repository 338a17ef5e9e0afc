//! Sessions over a real pseudo-terminal by the wall clock, and what they come to in lockstep. In real time only that is asserted
//! which no scheduler can change: how a session may end, that no frame is refused, order, and bounds.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{
    DEPTH_M, LONG, NoNumber, PLANE_N_PER_M, Plane, ended_well, force, force_at_rest, patient, plan,
    undisturbed, went_idle,
};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use sutura_hil::{FaultProxy, NativeConsole, VirtualConsole};
use sutura_host::link::{Link, LinkError, LockstepConsole, Order, open_serial};
use sutura_host::session::{
    Arms, Attendant, Line, Plan, SessionError, Solve, Solved, Summary, run_lockstep, run_real_time,
};
use sutura_host::step::Status;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Mode, Simulate, State};

/// What the plane gives at most \[N\]: where the hand wants to be, and a third more for its swing.
const DEEPEST_N: f64 = 1.3 * DEPTH_M * PLANE_N_PER_M;

/// States of a new session until one satisfies `enough`.
fn look(console: &mut VirtualConsole, enough: impl Fn(&State) -> bool) -> State {
    let link = Link::open(console.host_port().unwrap(), patient(), |_| {}).unwrap();
    let deadline = Instant::now() + LONG;
    loop {
        let state = *link.state(deadline).unwrap().expect("in time").body();
        if enough(&state) {
            return state;
        }
    }
}

/// A session in simulated time.
fn in_lockstep(console: &mut dyn LockstepConsole, plan: &Plan) -> Summary {
    run_lockstep(console, plan, &mut Plane, |_| ControlFlow::Continue(())).unwrap()
}

#[test]
fn a_session_feels_the_plane() {
    let plan = plan(1.5);
    let mut console = NativeConsole::new(&plan.device).unwrap();
    let summary = in_lockstep(&mut console, &plan);
    assert_eq!((summary.frames.lost, summary.frames.rejected), (0, 0));
    assert_eq!(
        (summary.status.as_str(), summary.mode.as_str()),
        ("ok", "armed")
    );
    assert_eq!(
        (summary.ticks, summary.seconds, summary.decays),
        (1500, 1.5, 0)
    );
    assert_eq!(summary.device, "cartesian-bench");
    // Both springs in series. Friction (0.15 N in the stage) holds the grip up to that far from balance;
    // one encoder count is 4 mN.
    let (peak, expected) = (summary.force_n.peak, force_at_rest());
    assert!((peak - expected).abs() < 0.3, "{peak} N for {expected} N");
    // A solve takes one period.
    assert_eq!(summary.latency_us.p50, 10_000.0);
}

#[test]
fn a_session_in_real_time_ends_as_it_may_and_leaves_the_console_at_rest() {
    let plan = plan(1.5);
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    let (mut notes, mut before) = (0, 0.0);
    let port = console.host_port().unwrap();
    let summary = run_real_time(port, patient(), &plan, &mut Plane, |note| {
        notes += 1;
        let elapsed_s = note.elapsed_s;
        assert!(
            (before..=1.5 + 1e-9).contains(&elapsed_s),
            "{before} {elapsed_s}"
        );
        before = note.elapsed_s;
        ControlFlow::Continue(())
    })
    .unwrap();
    println!("{summary:#?}");
    assert!(notes > 0);
    assert_eq!(summary.frames.rejected, 0);
    assert!(ended_well(&summary), "{}", summary.status);
    assert!(summary.ticks <= 1500 && (summary.ticks == 1500 || went_idle(&summary)));
    assert_eq!(summary.device, "cartesian-bench");
    let (peak, most) = (summary.force_n.peak, DEEPEST_N);
    assert!(peak < most, "{peak} N where {most} N are the most");
    assert!(
        summary.latency_us.p50 >= 1000.0 || went_idle(&summary),
        "a contact cannot be used in its own state's tick"
    );

    let rest = look(&mut console, |state| state.mode == Mode::Idle);
    assert_eq!((rest.force_n, rest.current_a), ([0.0; 3], [0.0; 3]));
}

#[test]
fn a_session_that_is_stopped_ends_with_its_summary() {
    let plan = plan(3600.0);
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    let summary = undisturbed(|| {
        let port = console.host_port().unwrap();
        let ran = run_real_time(port, patient(), &plan, &mut Plane, |note| {
            if note.elapsed_s > 0.2 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        ran.ok().filter(|summary| !went_idle(summary))
    });
    assert_eq!(summary.status, "ok");
    assert!(summary.seconds > 0.2 && summary.seconds < 3600.0);
    look(&mut console, |state| state.mode == Mode::Idle);
}

/// A console behind a bad line: of the frames from the tenth exchange that has any on, one in five is cut short, and one in
/// four comes behind noise.
struct BadLine {
    console: NativeConsole,
    frames: usize,
    noise: sutura_testkit::Random,
}

impl LockstepConsole for BadLine {
    fn name(&self) -> &str {
        self.console.name()
    }

    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let mut line = Vec::new();
        if !down.is_empty() {
            self.frames += 1;
            let frames = self.frames;
            if frames > 10 && frames.is_multiple_of(4) {
                for _ in 0..frames % 90 {
                    line.push(self.noise.bits() as u8);
                }
            }
            let cut = if frames > 10 && frames.is_multiple_of(5) {
                down.len() / 2
            } else {
                down.len()
            };
            line.extend_from_slice(&down[..cut]);
        }
        self.console.exchange(&line, up)
    }
}

#[test]
fn a_bad_line_costs_frames_and_never_more_force() {
    let plan = plan(1.5);
    let mut console = BadLine {
        console: NativeConsole::new(&plan.device).unwrap(),
        frames: 0,
        noise: sutura_testkit::Random::new(1),
    };
    let summary = in_lockstep(&mut console, &plan);
    println!("{:?}", summary.frames);
    assert!(
        summary.frames.rejected > 0 && summary.frames.lost > 0,
        "{:?}",
        summary.frames
    );
    assert_eq!((summary.status.as_str(), summary.ticks), ("ok", 1500));
    // Nothing of the noise is felt: no more force than the springs can give. And it is still felt.
    let (peak, rest) = (summary.force_n.peak, force_at_rest());
    assert!(
        peak < DEEPEST_N && peak > 0.5 * rest,
        "{peak} N, at rest {rest} N"
    );
}

/// The same noise in real time: the session outlives it.
#[test]
fn a_bad_line_in_real_time_never_gives_more_force() {
    let plan = plan(1.5);
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    let (mut frames, mut largest) = (0_usize, 0.0_f32);
    let port = FaultProxy::new(console.host_port().unwrap(), move |bytes| {
        frames += 1;
        if frames > 10 && frames.is_multiple_of(5) {
            return bytes[..bytes.len() / 2].to_vec();
        }
        bytes.to_vec()
    });
    let line = Line::from(Box::new(port) as Box<dyn sutura_host::link::Port>);
    let summary = run_real_time(line, patient(), &plan, &mut Plane, |note| {
        largest = largest.max(note.state.map_or(0.0, force));
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(ended_well(&summary), "{}", summary.status);
    assert!(
        summary.force_n.peak < DEEPEST_N && f64::from(largest) < DEEPEST_N,
        "{:?}",
        summary.force_n
    );
}

#[test]
fn an_emergency_stop_ends_the_session_in_a_fault_that_only_the_user_clears() {
    let mut plan = plan(3600.0);
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    // Pressed while nobody has a session, so that the next one finds the fault.
    let press = |console: &mut VirtualConsole, pressed: bool| {
        let link = Link::open(console.host_port().unwrap(), patient(), |_| {}).unwrap();
        link.order(Order::Simulate(Simulate::EmergencyStop(pressed)))
            .unwrap();
        link.close();
    };
    press(&mut console, true);
    let fault = look(&mut console, |state| state.mode == Mode::Fault);
    assert_eq!((fault.force_n, fault.current_a), ([0.0; 3], [0.0; 3]));
    let mut run = |plan: &_| {
        let port = console.host_port().unwrap();
        run_real_time(port, patient(), plan, &mut Plane, |note| {
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
        run_real_time(port, patient(), plan, &mut Plane, |note| {
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
    let summary = run(&plan).unwrap();
    assert!(ended_well(&summary), "{}", summary.status);
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

    fn arms(&mut self) -> Arms {
        match self.arms {
            true => Arms::ByItself,
            false => Arms::No,
        }
    }
}

/// A session in the middle of which the console is replaced by one that has just booted; none if the console went to rest
/// before that.
fn try_with_a_loss(arms: bool) -> Option<(Summary, Vec<&'static str>, f64)> {
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
    let summary = run_real_time(line, patient(), &plan, &mut Plane, |note| {
        if !replaced && note.elapsed_s > 0.3 {
            replaced = true;
            *console.lock().unwrap() = None;
            *console.lock().unwrap() = Some(start());
        }
        let idle = note.state.filter(|state| state.mode == Mode::Idle);
        if let Some(state) = idle.filter(|_| replaced) {
            resting = resting.max(f64::from(force(state)));
        }
        ControlFlow::Continue(())
    });
    // It is away until the session's time is over, where the machine takes that long.
    let summary = summary.ok().filter(|_| replaced)?;
    let told = told.lock().unwrap().clone();
    (told == ["lost", "back"]).then_some((summary, told, resting))
}

fn run_with_a_loss(arms: bool) -> (Summary, Vec<&'static str>, f64) {
    undisturbed(|| try_with_a_loss(arms))
}

#[test]
fn a_console_that_comes_back_goes_on_in_the_same_session_once_it_is_armed() {
    // Where the machine is so late that the session's time is over before the console is armed, it is not.
    let (summary, told, _) = undisturbed(|| {
        let ran = try_with_a_loss(true)?;
        (!ran.0.status.contains("nobody armed")).then_some(ran)
    });
    assert_eq!(told, ["lost", "back"]);
    assert!(ended_well(&summary), "{}", summary.status);
    assert_eq!(summary.link.sessions, 2);
    // The hand starts anew with its console.
    assert!(
        summary.ticks > 300 && summary.seconds <= 1.5 + 1e-9,
        "{}",
        summary.ticks
    );
    assert_eq!(
        summary.frames.rejected, 0,
        "nothing of the reset is counted"
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
    let (ran, told) = undisturbed(|| {
        let console = VirtualConsole::start(&plan.device).unwrap();
        let path = console.path().unwrap().to_owned();
        let mut console = Some(console);
        let unplugged = Arc::new(AtomicBool::new(false));
        let gone = unplugged.clone();
        let told = Arc::new(Mutex::new(Vec::new()));
        let line = Line::Again {
            // Unplugged, its terminal's number is another test's next.
            connect: Box::new(move || match gone.load(Ordering::Relaxed) {
                true => Err(LinkError::NoPort {
                    name: path.clone(),
                    found: Vec::new().into(),
                }),
                false => open_serial(&path),
            }),
            attendant: Box::new(Bystander {
                told: told.clone(),
                arms: true,
            }),
        };
        let ran = run_real_time(line, patient(), &plan, &mut Plane, |note| {
            if note.elapsed_s > 0.2 {
                unplugged.store(true, Ordering::Relaxed);
                drop(console.take());
            }
            ControlFlow::Continue(())
        });
        let told = told.lock().unwrap().clone();
        // It went to rest before it was unplugged.
        let early = ran.as_ref().is_ok_and(went_idle);
        (!early).then_some((ran, told))
    });
    assert!(
        matches!(ran, Err(SessionError::Link(LinkError::Gone { .. }))),
        "{ran:?}"
    );
    assert_eq!(told, ["lost"]);
}

/// What the console would refuse is not sent, in real time and in lockstep, and the session goes on and says how often.
#[test]
fn a_solve_that_cannot_be_sent_is_withheld_and_counted() {
    let plan = plan(1.0);
    let mut console = NativeConsole::new(&plan.device).unwrap();
    let mut solver = NoNumber::default();
    let lockstep = run_lockstep(&mut console, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    });
    let lockstep = lockstep.unwrap();
    assert_eq!(lockstep.status, "ok");
    let counted = |summary: &Summary| summary.steps_withheld.get("unsendable").copied();
    // The last solve is not waited for.
    assert!(solver.without >= 9 && counted(&lockstep) >= Some(solver.without - 1));
    assert_eq!((lockstep.frames.lost, lockstep.frames.rejected), (0, 0));

    let (summary, without) = undisturbed(|| {
        let mut console = VirtualConsole::start_in_memory(&plan.device).unwrap();
        let line = Line::Once {
            port: console.host_port().unwrap(),
            attendant: None,
            limits: None,
        };
        let mut solver = NoNumber::default();
        let ran = run_real_time(line, patient(), &plan, &mut solver, |_| {
            ControlFlow::Continue(())
        });
        let summary = ran.ok()?;
        (summary.status == "ok" && solver.without > 1).then_some((summary, solver.without))
    });
    // A newer one may have taken its place before it was written.
    let counted = counted(&summary).unwrap_or_default();
    assert!((1..=without).contains(&counted), "{counted} of {without}");
    assert_eq!((summary.frames.lost, summary.frames.rejected), (0, 0));
}

/// Finds a few contacts in a row, and then nothing that may be felt for longer than the console waits.
#[derive(Default)]
struct Withheld {
    solves: u32,
}

impl Solve for Withheld {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        self.solves += 1;
        if self.solves % 100 < 10 {
            return Plane.solve(state);
        }
        Solved {
            status: Status::Inside,
            ..Solved::default()
        }
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        serde_json::Map::new()
    }
}

/// Arms by itself as long as it may, then by hand.
struct Keeper(Arc<Mutex<Vec<Duration>>>);

impl Attendant for Keeper {
    fn lost(&mut self, _: &LinkError) {}

    fn back(&mut self) {}

    fn let_go(&mut self, wait: Duration) {
        self.0.lock().unwrap().push(wait);
    }

    fn arms(&mut self) -> Arms {
        match self.0.lock().unwrap().last() {
            Some(wait) if wait.is_zero() => Arms::ByItself,
            Some(_) => Arms::ByHand,
            None => Arms::No,
        }
    }
}

/// Three times by itself; then it waits, and somebody who asks need not.
#[test]
fn a_console_that_let_go_is_armed_again() {
    let plan = plan(3600.0);
    let (summary, waits) = undisturbed(|| {
        let mut console = VirtualConsole::start_in_memory(&plan.device).unwrap();
        let waits = Arc::new(Mutex::new(Vec::new()));
        let line = Line::Once {
            port: console.host_port().unwrap(),
            attendant: Some(Box::new(Keeper(waits.clone()))),
            limits: None,
        };
        let told = waits.clone();
        let ran = run_real_time(line, patient(), &plan, &mut Withheld::default(), |_| {
            if told.lock().unwrap().len() >= 6 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        let waits = waits.lock().unwrap().clone();
        let ran = ran.ok()?;
        // Where all this takes longer than a minute, nobody has to wait.
        (waits.len() == 6 && !waits[3].is_zero()).then_some((ran, waits))
    });
    assert_eq!(waits[..3], [Duration::ZERO; 3]);
    assert!(waits[3] <= Duration::from_secs(60), "{waits:?}");
    // Once more may have been ordered before the end.
    assert!((5..=6).contains(&summary.rearmed), "{}", summary.rearmed);
}

/// A line on standard input arms the console, one that was there before does not.
#[test]
fn a_script_arms_a_console_that_let_go() {
    use std::io::{BufRead, BufReader, Write};
    use std::process::{Command, Stdio};
    let directory = tempfile::tempdir().unwrap();
    let scene = crate::support::too_deep(directory.path());
    let mut child = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(["run", "--stream", "--seconds", "3600"])
        .arg(&scene)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(b"\n").unwrap();
    let stdout = BufReader::new(child.stdout.take().unwrap());
    let (tell, modes) = std::sync::mpsc::channel();
    let reading = std::thread::spawn(move || {
        for line in stdout.lines() {
            let note: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
            if tell
                .send(note["mode"].as_str().unwrap().to_owned())
                .is_err()
            {
                return;
            }
        }
    });
    let said = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut said = said.map(Result::unwrap);
    let lets_go = said.find(|line| line.contains("has let go")).unwrap();
    assert!(lets_go.contains("a line on standard input"), "{lets_go}");
    // The line of before arms nothing.
    let session = modes.iter().skip_while(|mode| mode != "armed");
    let rests = session.skip_while(|mode| mode != "idle").take(20);
    let rests: Vec<_> = rests.collect();
    assert!(rests.iter().all(|mode| mode == "idle"), "{rests:?}");
    stdin.write_all(b"\n").unwrap();
    assert!(modes.iter().any(|mode| mode != "idle"));
    // Who goes away ends the session.
    drop(modes);
    reading.join().unwrap();
    child.wait().unwrap();
}
