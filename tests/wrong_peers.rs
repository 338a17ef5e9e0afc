//! Consoles that are not there, silent, of another make, or in a fault: exit code, message, next step.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{self, Plane, patient};
use crate::support::{Ran, session_of, sutura};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_hil::{Pty, VirtualConsole};
use sutura_host::link::{Link, LinkError, LinkOptions, Order, Port, open_serial};
use sutura_host::session::{Arms, Attendant, Line, SessionError, run_lockstep, run_real_time};
use sutura_shared::link::{ConsoleLink, Identity, LinkEvent};
use sutura_shared::wire::message::{Command, Hello, Mode, Simulate, State};
use sutura_shared::wire::{MAX_FRAME, PROTOCOL_VERSION, SCHEMA_HASH, Unchecked, decode, encode};

#[test]
fn a_missing_port_is_named() {
    let Ran {
        code,
        stdout,
        stderr,
    } = sutura(&[
        "run",
        "--console",
        "/dev/no-such-console",
        "--format",
        "json",
    ]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("/dev/no-such-console") && stderr.contains("--console virtual"),
        "{stderr}"
    );
    let object: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&object["status"], &object["exit_code"]),
        (&"no-console".into(), &3.into())
    );
}

#[test]
fn a_port_in_use_is_busy() {
    let pty = Pty::open().unwrap();
    let _first = open_serial(pty.path()).unwrap();
    let Ran { code, stderr, .. } = sutura(&["run", "--console", pty.path()]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("in use"), "{stderr}");
}

#[test]
fn a_port_where_nobody_answers_is_no_console() {
    let pty = Pty::open().unwrap();
    let Ran { code, stderr, .. } = sutura(&["run", "--console", pty.path()]);
    assert_eq!(code, 3, "{stderr}");
    assert!(
        stderr.contains("no console answered") && stderr.contains("nothing came"),
        "{stderr}"
    );
}

/// A pseudo-terminal has no cable, no power and no reset; its PC may be busy.
#[test]
fn a_virtual_console_is_not_looked_for_at_its_cable() {
    let pty = Pty::open().unwrap();
    let Ran { code, stderr, .. } = sutura(&["run", "--console", pty.path()]);
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("busy"), "{stderr}");
    for word in ["cable", "power", "reset"] {
        assert!(!stderr.contains(word), "{word}: {stderr}");
    }
}

/// Who has a port is told, where the system knows.
#[cfg(target_os = "linux")]
#[test]
fn a_busy_port_names_its_holder() {
    let pty = Pty::open().unwrap();
    let _first = open_serial(pty.path()).unwrap();
    let Ran { code, stderr, .. } = sutura(&["run", "--console", pty.path()]);
    assert_eq!(code, 3, "{stderr}");
    let holder = format!("process {}", std::process::id());
    assert!(stderr.contains(&holder), "{stderr}");
}

/// A console that is not there is said before a mesh is made and factored: this one would be refused for its size.
#[test]
fn a_port_is_opened_before_the_long_work() {
    let pty = Pty::open().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene =
        std::fs::read_to_string(crate::support::root().join("scenes/palpation.toml")).unwrap();
    let large = scene.replace("divisions = [20, 20, 8]", "divisions = [900, 900, 900]");
    assert_ne!(large, scene);
    std::fs::write(folder.path().join("large.toml"), large).unwrap();
    let file = folder.path().join("large.toml");
    let run = |console: &str| sutura(&["run", file.to_str().unwrap(), "--console", console]);
    let Ran { code, stderr, .. } = run(pty.path());
    assert_eq!(code, 3, "{stderr}");
    assert!(stderr.contains("no console answered"), "{stderr}");
    assert_eq!(run("virtual").code, 2);
}

/// Answers every hello with what `forge` makes of a good console's answer; whether it was told anything besides, but to disarm.
fn impostor(pty: &mut Pty, stop: &AtomicBool, forge: impl Fn(&[u8]) -> Vec<u8>) -> bool {
    let device_name = *b"impostor\0\0\0\0\0\0\0\0";
    let mut console = ConsoleLink::new(
        Identity {
            tick_hz: 1000,
            simulated: true,
            device_name,
        },
        1,
    );
    let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 512]);
    let mut is_told = false;
    while !stop.load(Ordering::Relaxed) {
        let count = pty.read(&mut chunk, Duration::from_millis(5)).unwrap_or(0);
        let mut rest = &chunk[..count];
        while let Some(event) = console.receive(&mut rest, 0) {
            is_told |= match event {
                // With that every session ends.
                LinkEvent::Command(command) => *command.body() != Command::Disarm,
                LinkEvent::Simulate(_) | LinkEvent::Fixture(_) => true,
                _ => false,
            };
        }
        if let Some(length) = console.take_reply(0, &mut frame) {
            pty.write(&forge(&frame[..length])).unwrap();
        }
    }
    is_told
}

/// A session with an [`impostor`], and whether that was told anything.
fn run_against(forge: impl Fn(&[u8]) -> Vec<u8> + Send) -> (Ran, bool) {
    let mut pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (pty, stop) = (&mut pty, &stop);
        let impostor = scope.spawn(move || impostor(pty, stop, forge));
        let ran = sutura(&["run", "--console", &path]);
        stop.store(true, Ordering::Relaxed);
        (ran, impostor.join().unwrap())
    })
}

/// Header, body and checksum of a frame.
fn packet(frame: &[u8]) -> Vec<u8> {
    let mut packet = frame[..frame.len() - 1].to_vec();
    let length = cobs::decode_in_place(&mut packet).unwrap();
    packet.truncate(length);
    packet
}

#[test]
fn another_protocol_version_is_refused_by_name() {
    const OTHER: u8 = 7;
    let (ran, _) = run_against(|frame| {
        let mut packet = packet(frame);
        packet[0] = OTHER;
        let content = packet.len() - 4;
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&packet[..content]);
        packet[content..].copy_from_slice(&crc.to_le_bytes());
        let mut forged = vec![0; cobs::max_encoding_length(packet.len())];
        let length = cobs::encode(&packet, &mut forged);
        forged.truncate(length);
        forged.push(0);
        forged
    });
    assert_eq!(ran.code, 4, "{}", ran.stderr);
    for part in [
        format!("version {OTHER}"),
        format!("version {PROTOCOL_VERSION}"),
        // It answers at a pseudo-terminal: no board's image is to blame.
        "start the virtual console from the same build".into(),
    ] {
        assert!(ran.stderr.contains(&part), "{part:?} in {}", ran.stderr);
    }
}

/// The frame of another hello.
fn forged(frame: &[u8], forge: impl Fn(Hello) -> Hello) -> Vec<u8> {
    let packet = packet(frame);
    let Unchecked::Hello(_, hello) = decode(&packet).unwrap().unpack().unwrap() else {
        panic!("it is a hello")
    };
    let mut forged = [0; MAX_FRAME];
    let length = encode(0, 0, 0, &forge(hello), &mut forged).unwrap();
    forged[..length].to_vec()
}

/// Forces and limits of a scene are chosen for its device: another one with motors is told nothing, and both are named.
#[test]
fn another_device_with_motors_is_not_armed() {
    let (ran, is_told) = run_against(|frame| {
        forged(frame, |hello| Hello {
            simulated: false,
            ..hello
        })
    });
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(!is_told);
    for name in ["impostor", "cartesian-bench"] {
        assert!(ran.stderr.contains(name), "{name} in {}", ran.stderr);
    }
}

#[test]
fn another_schema_is_refused_by_both_hashes() {
    let other = SCHEMA_HASH ^ 0xFF;
    let (ran, _) = run_against(|frame| {
        forged(frame, |hello| Hello {
            schema_hash: other,
            ..hello
        })
    });
    assert_eq!(ran.code, 4, "{}", ran.stderr);
    for hash in [other, SCHEMA_HASH] {
        assert!(
            ran.stderr.contains(&format!("{hash:016x}")),
            "{}",
            ran.stderr
        );
    }
}

#[test]
fn a_latched_fault_has_its_own_exit_code_until_it_is_cleared() {
    let mut console = VirtualConsole::start(&session::device()).unwrap();
    let path = console.path().unwrap().to_owned();
    let mut press = |pressed| {
        let port = console.host_port().unwrap();
        let link = Link::open(port, patient(), |_| {}).unwrap();
        link.order(Order::Simulate(Simulate::EmergencyStop(pressed)))
            .unwrap();
        let deadline = std::time::Instant::now() + Duration::from_secs(60);
        while link.state(deadline).unwrap().expect("in time").body().mode != Mode::Fault {}
        link.close();
    };
    press(true);
    let ran = session_of(&["run", "--console", &path, "--seconds", "0.2"]);
    assert_eq!(ran.code, 5, "{}", ran.stderr);
    assert!(
        ran.stderr.contains("e_stop") && ran.stderr.contains("--clear-fault"),
        "{}",
        ran.stderr
    );
    press(false);
    let ran = session_of(&[
        "run",
        "--console",
        &path,
        "--seconds",
        "0.2",
        "--clear-fault",
    ]);
    assert!(ran.ended_well(), "{}", ran.stderr);
    assert!(ran.json()["ticks"].as_u64() > Some(0), "{}", ran.stdout);
}

/// A state at rest.
fn state(tick: u32) -> State {
    State {
        tick,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        force_n: [0.0; 3],
        current_a: [0.0; 3],
        mode: Mode::Idle,
        faults: 0,
        contact_sequence: 0,
        contact_age_us: u32::MAX,
        applied_age_us: 0,
        trace_hash: 0,
        encoder_counts: [0; 3],
        inputs: 0,
        heard_sequence: 0,
    }
}

/// A state's frame.
fn sent(session: u32, sequence: u32, state: &State) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let time_us = 1000 * u64::from(sequence);
    let length = encode(session, sequence, time_us, state, &mut frame).unwrap();
    frame[..length].to_vec()
}

/// Bytes that a peer sends in the n-th millisecond of a session.
type Sends = fn(session: u32, turn: u32) -> Vec<u8>;

/// Peers that open a session and send no state that can be used, and the word of the reason.
const USELESS: [(&str, Sends, &str); 9] = [
    (
        "a place that is no number",
        |session, turn| {
            let position_m = [f32::NAN, 0.0, 0.0];
            sent(
                session,
                turn,
                &State {
                    position_m,
                    ..state(turn)
                },
            )
        },
        "frames were refused: a number is not finite",
    ),
    (
        "turned by no unit quaternion",
        |session, turn| {
            let orientation = [0.0, 0.0, 0.0, 2.0];
            sent(
                session,
                turn,
                &State {
                    orientation,
                    ..state(turn)
                },
            )
        },
        "frames were refused: a value is out of range",
    ),
    (
        "an old sequence",
        |session, turn| sent(session, 9, &state(turn)),
        "frames were refused: duplicate or out of order",
    ),
    (
        "another session",
        |session, turn| sent(session ^ 1, turn, &state(turn)),
        "frames were refused: not of the open session",
    ),
    (
        "ticks that stand still",
        |session, turn| sent(session, turn, &state(7)),
        "its ticks stand still",
    ),
    (
        "ticks that crawl",
        |session, turn| sent(session, turn, &state(turn / 100)),
        "its ticks stand still",
    ),
    ("zeros", |_, _| vec![0; 200], "bytes came, no whole frame"),
    (
        "junk",
        |_, turn| (1..40).map(|at: u32| (at * turn % 255) as u8).collect(),
        "frames were refused",
    ),
    ("nothing", |_, _| Vec::new(), "nothing came"),
];

/// Opens every session that it is asked for, and sends what it sends.
fn useless(pty: &mut Pty, stop: &AtomicBool, sends: Sends) {
    let mut console = ConsoleLink::new(
        Identity {
            tick_hz: 1000,
            simulated: true,
            device_name: *b"useless\0\0\0\0\0\0\0\0\0",
        },
        1,
    );
    let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 512]);
    let (mut session, mut turn) = (0, 0);
    while !stop.load(Ordering::Relaxed) {
        let count = pty.read(&mut chunk, Duration::from_millis(1)).unwrap_or(0);
        let mut rest = &chunk[..count];
        while console.receive(&mut rest, 0).is_some() {}
        if let Some(length) = console.take_reply(0, &mut frame)
            && let Ok(Unchecked::Hello(_, hello)) =
                decode(&packet(&frame[..length])).unwrap().unpack()
        {
            (session, turn) = (hello.session, 0);
            pty.write(&frame[..length]).unwrap();
        }
        if session != 0 {
            turn += 1;
            // A line that is full loses it.
            let _ = pty.write(&sends(session, turn));
        }
    }
}

/// A session with such a peer; `again`: that is looked for when it is lost.
fn session_with(sends: Sends, again: bool, stops: bool) -> SessionError {
    struct Nobody;
    impl Attendant for Nobody {
        fn lost(&mut self, _: &LinkError) {}
        fn back(&mut self) {}
        fn arms(&mut self) -> Arms {
            Arms::No
        }
    }
    let mut pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let stop = AtomicBool::new(false);
    let plan = session::plan(3600.0);
    std::thread::scope(|scope| {
        let (pty, stop) = (&mut pty, &stop);
        scope.spawn(move || useless(pty, stop, sends));
        // A machine that is busy answers late.
        let options = LinkOptions {
            answer_within: patient().answer_within,
            ..LinkOptions::default()
        };
        let line = match again {
            true => Line::Again {
                connect: Box::new(move || open_serial(&path)),
                attendant: Box::new(Nobody),
            },
            false => open_serial(&path).unwrap().into(),
        };
        let ran = run_real_time(line, options, &plan, &mut Plane, |_| match stops {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        });
        stop.store(true, Ordering::Relaxed);
        ran.unwrap_err()
    })
}

/// Nothing is waited for that only the other side can bring: the session ends with the reason.
#[test]
fn a_peer_without_a_state_that_can_be_used_is_named_with_the_reason() {
    std::thread::scope(|scope| {
        for (name, sends, reason) in USELESS {
            for again in [false, true] {
                scope.spawn(move || {
                    let error = session_with(sends, again, false);
                    let is_meant = match &error {
                        SessionError::Silent { .. } => !again,
                        SessionError::Link(LinkError::NoStates { .. }) => again,
                        _ => false,
                    };
                    assert!(is_meant, "{name}, again {again}: {error:?}");
                    let text = error.to_string();
                    // Some frames may have been refused for another reason while the session was opened.
                    let mut words = reason.split(": ");
                    assert!(
                        words.all(|words| text.contains(words)),
                        "{name}, again {again}: {text}"
                    );
                });
            }
        }
    });
}

/// Ctrl-C is heard before a first state has come.
#[test]
fn a_session_is_stopped_before_its_first_state() {
    for again in [false, true] {
        let error = session_with(|_, _| vec![0; 200], again, true);
        let is_meant = matches!(error, SessionError::Link(LinkError::GivenUp { .. }));
        assert!(is_meant, "{error:?}");
    }
}

/// The command's exit codes: refused frames are another protocol, silence is no console.
#[test]
fn useless_peers_have_an_exit_code_and_a_next_step() {
    for (at, code, help) in [(0, 4, "same build"), (4, 3, "busy")] {
        let mut pty = Pty::open().unwrap();
        let path = pty.path().to_owned();
        let stop = AtomicBool::new(false);
        let (_, sends, reason) = USELESS[at];
        let ran = std::thread::scope(|scope| {
            let (pty, stop) = (&mut pty, &stop);
            scope.spawn(move || useless(pty, stop, sends));
            let ran = sutura(&["run", "--console", &path, "--seconds", "3600"]);
            stop.store(true, Ordering::Relaxed);
            ran
        });
        assert_eq!(ran.code, code, "{}", ran.stderr);
        for part in [reason, help] {
            assert!(ran.stderr.contains(part), "{part:?} in {}", ran.stderr);
        }
    }
}

/// A console in lockstep that says nothing after its first states.
struct Stuck(sutura_hil::NativeConsole, u32);

impl sutura_host::link::LockstepConsole for Stuck {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.1 += 1;
        self.0.exchange(down, up)?;
        if self.1 > 300 {
            up.clear();
        }
        Ok(())
    }

    fn name(&self) -> &str {
        "stuck"
    }
}

#[test]
fn a_console_in_lockstep_that_falls_silent_is_named_with_the_reason() {
    let plan = session::plan(3600.0);
    let console = sutura_hil::NativeConsole::new(&plan.device).unwrap();
    let mut stuck = Stuck(console, 0);
    let ran = run_lockstep(&mut stuck, &plan, &mut Plane, |_| ControlFlow::Continue(()));
    let error = ran.unwrap_err();
    assert!(matches!(error, SessionError::Silent { .. }), "{error:?}");
    assert!(error.to_string().contains("nothing came"), "{error}");
}
