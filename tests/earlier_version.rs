//! Host and console of commit 1e64281 with those of today: version 1 of the protocol has been given meanings since for bits that
//! were 0 everywhere, and nothing else. Those are 128, 256 and 512 of a state's faults and 32, 64 and 128 of its inputs.
//!
//! In every run: what that program's two ends said in two sessions (`tests/golden/1e64281`: all kinds of frames that they send),
//! to today's console, its image, and today's host. Where the checkout has its history: that commit's host in Python on today's
//! console, and its reading of every new bit. `SUTURA_FULL=1`, with the history: the program itself is built, and both work
//! together over pseudo-terminals, either way round; and the recordings are what it makes.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{self, Plane, device, force, undisturbed};
use crate::support::{Ran, ran, root, session_of};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_hil::{NativeConsole, Pty, VirtualConsole, serve};
use sutura_host::link::{LinkError, LockstepConsole, Port};
use sutura_host::session::{EndingKind, run_lockstep};
use sutura_shared::simulated_console::SimulatedConsole;
use sutura_shared::wire::message::{Mode, State};
use sutura_shared::wire::{
    Accumulator, Kind, MAX_FRAME, Unchecked, decode, encode, faults, inputs,
};
use sutura_testkit::full;

const COMMIT: &str = "1e64281";
/// Scenes of the recorded sessions.
const RECORDED: [&str; 2] = ["press", "needle"];
const NEW_FAULTS: [u16; 3] = [faults::TIME_BASE, faults::AMPLIFIER, faults::SUPPLY];
const NEW_INPUTS: [u8; 3] = [inputs::AMPLIFIER, inputs::SUPPLY, inputs::WITHHELD];
/// Ticks of a recording after the host's last frame but pings, for which it waits for the console's report.
const TAIL: usize = 20;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn golden() -> PathBuf {
    root().join("tests/golden").join(COMMIT)
}

/// What went over the line in a tick of a session in lockstep: down before it, up after it.
#[derive(Clone, Debug, Default, PartialEq)]
struct Exchange {
    down: Vec<u8>,
    up: Vec<u8>,
}

fn down(exchange: &Exchange) -> &Vec<u8> {
    &exchange.down
}

fn up(exchange: &Exchange) -> &Vec<u8> {
    &exchange.up
}

/// A recorded session: a line a tick, down and up in hex, `-` where nothing was said.
fn recorded(name: &str) -> Vec<Exchange> {
    let text = std::fs::read_to_string(golden().join(format!("{name}.hex"))).unwrap();
    let bytes = |word: &str| -> Vec<u8> {
        let digits = if word == "-" { "" } else { word };
        let pairs = (0..digits.len()).step_by(2);
        pairs
            .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap())
            .collect()
    };
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let (down, up) = line.split_once(' ').unwrap();
            Exchange {
                down: bytes(down),
                up: bytes(up),
            }
        })
        .collect()
}

/// Frames of either end, in order: kind, and the state if it is one.
fn frames(bytes: &[u8]) -> Vec<(Kind, Option<State>)> {
    let mut accumulator = Accumulator::new();
    let mut frames = Vec::new();
    for byte in bytes {
        let Some(packet) = accumulator.push(*byte) else {
            continue;
        };
        let decoded = decode(packet.unwrap()).unwrap();
        let state = match decoded.unpack() {
            Ok(Unchecked::State(_, state)) => Some(state),
            _ => None,
        };
        frames.push((decoded.header.kind, state));
    }
    frames
}

fn states(bytes: &[u8]) -> Vec<State> {
    let frames = frames(bytes).into_iter();
    frames.filter_map(|(_, state)| state).collect()
}

fn peak_n(states: &[State]) -> f32 {
    states.iter().map(force).fold(0.0, f32::max)
}

fn all(recorded: &[Exchange], way: fn(&Exchange) -> &Vec<u8>) -> Vec<u8> {
    recorded.iter().flat_map(way).copied().collect()
}

/// What a console says to the recorded host.
fn answers(console: &mut dyn LockstepConsole, recorded: &[Exchange]) -> Vec<u8> {
    let mut up = Vec::new();
    for Exchange { down, .. } in recorded {
        console.exchange(down, &mut up).unwrap();
    }
    up
}

#[test]
fn the_recordings_have_every_frame_that_a_session_has() {
    let mut kinds = BTreeMap::<u8, usize>::new();
    for name in RECORDED {
        let recorded = recorded(name);
        for way in [down, up] {
            for (kind, _) in frames(&all(&recorded, way)) {
                *kinds.entry(kind as u8).or_default() += 1;
            }
        }
    }
    println!("{kinds:?}");
    let expected = [1, 2, 3, 4, 5, 6, 7, 8, 16, 17, 18, 20];
    assert!(kinds.keys().copied().eq(expected), "{kinds:?}");
}

/// Every frame is taken, and what is felt is what that console felt, for whose poses the contacts were solved: its device weighs nothing, or
/// the weight, which comes over 300 ms since, would have the grip elsewhere.
#[test]
fn a_console_feels_what_the_earlier_host_says() {
    for name in RECORDED {
        let recorded = recorded(name);
        let mut console = NativeConsole::new(&device()).unwrap();
        let said = answers(&mut console, &recorded);
        let counters = console.console().counters();
        let sent = frames(&all(&recorded, down)).len();
        assert_eq!(
            (counters.frames_rejected, counters.frames_lost),
            (0, 0),
            "{name}: {counters:?}"
        );
        assert_eq!(counters.frames_received as usize, sent, "{name}");
        let (here, there) = (states(&said), states(&all(&recorded, up)));
        assert_eq!(here.len(), there.len(), "{name}");
        let modes = |states: &[State]| -> Vec<Mode> {
            let mut modes: Vec<Mode> = states.iter().map(|state| state.mode).collect();
            modes.dedup();
            modes
        };
        assert_eq!(modes(&here), modes(&there), "{name}");
        assert!(here.iter().all(|state| state.faults == 0), "{name}");
        let (felt, was) = (peak_n(&here), peak_n(&there));
        println!("{name}: {felt} N, {was} N then");
        assert!(
            was > 0.1 && (felt / was - 1.0).abs() < 0.02,
            "{name}: {felt} {was}"
        );
    }
}

/// The image does with the same bytes what the console in this process does.
#[cfg(feature = "qemu-tests")]
#[test]
fn the_image_feels_what_the_earlier_host_says() {
    use sutura_hil::{QemuConsole, qemu};
    for name in RECORDED {
        let recorded = recorded(name);
        let mut native = NativeConsole::new(&device()).unwrap();
        let image = qemu::default_image();
        let mut emulated = QemuConsole::start(image, Duration::from_secs(300)).unwrap();
        assert!(answers(&mut native, &recorded) == answers(&mut emulated, &recorded));
    }
}

/// A console that says what was recorded, whatever it is told.
struct Played(std::vec::IntoIter<Exchange>);

impl LockstepConsole for Played {
    fn exchange(&mut self, _: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        up.extend(self.0.next().unwrap_or_default().up);
        Ok(())
    }

    fn name(&self) -> &str {
        COMMIT
    }
}

#[test]
fn a_host_hears_the_earlier_console_to_its_end() {
    for name in RECORDED {
        let recorded = recorded(name);
        let there = states(&all(&recorded, up));
        let felt = there.iter().filter(|state| state.mode == Mode::Armed);
        let ticks = felt.count();
        let plan = session::plan(1e-3 * (ticks - 1) as f64);
        let mut console = Played(recorded.into_iter());
        let ran = run_lockstep(&mut console, &plan, &mut Plane, |_| {
            ControlFlow::Continue(())
        });
        let summary = ran.unwrap();
        assert_eq!(summary.mode, "armed", "{name}");
        // The forces are of another solver's contacts, which the plane here may not find.
        let ending = summary.ending.kind;
        assert!(
            matches!(ending, EndingKind::Ok | EndingKind::Untouched),
            "{name}: {}",
            summary.status
        );
        assert_eq!((summary.frames.lost, summary.frames.rejected), (0, 0));
        assert_eq!(summary.ticks as usize, ticks - 1, "{name}");
        let (heard, said) = (summary.force_n.peak, f64::from(peak_n(&there)));
        assert!((heard - said).abs() < 1e-6, "{name}: {heard} {said}");
    }
}

/// What the history has of a file; none, with a message, where the checkout has no such history.
fn then(path: &str) -> Option<Vec<u8>> {
    let mut git = Command::new("git");
    git.arg("show").arg(format!("{COMMIT}:{path}"));
    match git.current_dir(root()).output() {
        Ok(output) if output.status.success() => Some(output.stdout),
        _ => {
            eprintln!("skipped: no commit {COMMIT} in this checkout's history");
            None
        }
    }
}

/// A folder with that commit's host in Python.
fn python_then() -> Option<tempfile::TempDir> {
    if let Err(error) = Command::new("python3").arg("--version").output() {
        eprintln!("skipped: no python3 ({error})");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    for name in ["sutura_peer.py", "press.py"] {
        let text = then(&format!("hil/python/{name}"))?;
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    Some(folder)
}

/// What a program in Python says.
fn python(folder: &Path, arguments: &[&str]) -> Ran {
    ran(Command::new("python3")
        .arg("-B")
        .args(arguments)
        .current_dir(folder))
}

/// A state with each new bit alone and with all of them: the earlier host reads the bit as a number, and all else as it is.
#[test]
fn the_earlier_host_reads_what_it_does_not_know() {
    let Some(folder) = python_then() else { return };
    let up = all(&recorded("press"), up);
    let armed = |state: &&State| state.mode == Mode::Armed && force(state) > 0.1;
    let plain = *states(&up).iter().find(armed).unwrap();
    // Faults and inputs that are told.
    let bits = [(0, 0)].into_iter();
    let bits = bits.chain(NEW_FAULTS.map(|fault| (fault, 0)));
    let bits = bits.chain(NEW_INPUTS.map(|input| (0, input)));
    let every = (
        NEW_FAULTS.iter().sum::<u16>(),
        NEW_INPUTS.iter().sum::<u8>(),
    );
    let told: Vec<State> = bits
        .chain([every])
        .map(|(faults, inputs)| {
            let mut state = plain;
            state.faults = faults;
            state.inputs |= inputs;
            state
        })
        .collect();
    let lines = told.iter().map(|state| {
        let mut frame = [0; MAX_FRAME];
        let length = encode(7, 9, 1000, state, &mut frame).unwrap();
        hex(&frame[..length - 1]) + "\n"
    });
    let lines: String = lines.collect();
    std::fs::write(folder.path().join("told.hex"), lines).unwrap();
    let program = "import json, sutura_peer as peer
for line in open('told.hex'):
    name, body, *header = peer.decode(bytes.fromhex(line))
    print(json.dumps([name, body, header]))";
    let said = python(folder.path(), &["-c", program]);
    assert_eq!(said.code, 0, "{}", said.stderr);
    let heard = said.stdout.lines().map(serde_json::from_str);
    let heard: Vec<Value> = heard.collect::<Result<_, _>>().unwrap();
    assert_eq!(heard.len(), told.len());
    let heard_plain = heard[0].clone();
    for (heard, told) in heard.iter().zip(&told) {
        let mut expected = heard_plain[1].clone();
        expected["faults"] = told.faults.into();
        expected["inputs"] = told.inputs.into();
        assert_eq!((&heard[0], &heard[1]), (&"State".into(), &expected));
    }
}

/// That host in Python renders its plane on today's console, over a pseudo-terminal.
#[test]
fn the_earlier_host_in_python_renders_its_plane() {
    let Some(folder) = python_then() else { return };
    let least = session::force_at_rest() - 0.3;
    // When the hand gets there is up to the machine.
    let felt = undisturbed(|| {
        let console = VirtualConsole::start(&device()).unwrap();
        let said = python(folder.path(), &["press.py", console.path().unwrap(), "2"]);
        assert_eq!(said.code, 0, "{}", said.stderr);
        let seen = said.json();
        assert_eq!(seen["refused"], 0, "{seen}");
        seen["peak_n"].as_f64().filter(|peak_n| *peak_n > least)
    });
    println!("{felt} N");
}

/// A program that is ended with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The program of that commit, built from the checkout's history; none where there is no such history.
fn program_then() -> Option<PathBuf> {
    then("Cargo.toml")?;
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(COMMIT);
    let sources = folder.join("sources");
    if !sources.exists() {
        let (archive, partial) = (folder.join("sources.tar"), folder.join("partial"));
        std::fs::create_dir_all(&partial).unwrap();
        let mut git = Command::new("git");
        git.arg("archive").arg("-o").arg(&archive).arg(COMMIT);
        done(git.current_dir(root()));
        let mut tar = Command::new("tar");
        done(tar.arg("-xf").arg(&archive).arg("-C").arg(&partial));
        std::fs::rename(partial, &sources).unwrap();
    }
    let target = folder.join("target");
    let mut cargo = Command::new("cargo");
    cargo.args(["build", "-p", "sutura", "--bin", "sutura", "--locked"]);
    cargo.env("CARGO_TARGET_DIR", &target);
    done(cargo.current_dir(sources));
    Some(target.join("debug/sutura"))
}

fn done(command: &mut Command) {
    let ran = ran(command);
    assert_eq!(ran.code, 0, "{command:?}: {}", ran.stderr);
}

/// `sutura console` of a program: it, and its port.
fn console_of(program: &Path) -> (Running, String) {
    let mut command = Command::new(program);
    let child = command.arg("console").stdout(Stdio::piped()).spawn();
    let mut child = Running(child.unwrap());
    let mut port = String::new();
    let stdout = child.0.stdout.take().unwrap();
    BufReader::new(stdout).read_line(&mut port).unwrap();
    (child, port.trim().to_owned())
}

/// A session of the earlier program in real time.
fn session_then(program: &Path, console: &str) -> Ran {
    let scene = golden().join("press.toml");
    let words = ["--console", console, "--seconds", "0.6", "--format", "json"];
    let mut command = Command::new(program);
    ran(command.arg("run").arg(scene).args(words))
}

/// What is said of a session that this machine did not disturb.
fn felt(whose: &str, mut session: impl FnMut() -> Ran) -> Value {
    let summary = undisturbed(|| {
        let ran = session();
        let summary: Value = serde_json::from_str(&ran.stdout).unwrap_or_default();
        eprintln!("exit code {}, {}", ran.code, ran.stderr);
        (ran.code == 0 && summary["decays"] == 0).then_some(summary)
    });
    println!("{whose}: {}; {}", summary["frames"], summary["force_n"]);
    assert_eq!(
        (&summary["status"], &summary["mode"]),
        (&"ok".into(), &"armed".into())
    );
    assert_eq!(summary["frames"]["rejected"], 0, "{summary}");
    assert_eq!(summary["faults"], Value::Array(Vec::new()));
    summary
}

#[test]
fn the_earlier_program_and_this_one_work_together() {
    if !full() {
        return;
    }
    let Some(then) = program_then() else { return };
    the_recordings_are_what_it_makes(&then);
    host_and_console_work_together_either_way_round(&then);
    it_takes_new_bits_for_what_they_are(&then);
}

fn host_and_console_work_together_either_way_round(then: &Path) {
    let (_console, port) = console_of(env!("CARGO_BIN_EXE_sutura").as_ref());
    let earlier_host = felt("the earlier host", || session_then(then, &port));
    let (_console, port) = console_of(then);
    let scene = golden().join("press.toml");
    let scene = scene.to_str().unwrap();
    let earlier_console = felt("the earlier console", || {
        session_of(&["run", scene, "--console", &port, "--seconds", "0.6"])
    });
    let recorded_n = f64::from(peak_n(&states(&all(&recorded("press"), up))));
    for summary in [earlier_host, earlier_console] {
        let peak_n = summary["force_n"]["peak"].as_f64().unwrap();
        assert!(
            (peak_n / recorded_n - 1.0).abs() < 0.1,
            "{peak_n} {recorded_n}"
        );
    }
}

/// The console's end of a pseudo-terminal that changes each state on its way out.
struct Changed<F> {
    pty: Pty,
    change: F,
    accumulator: Accumulator,
}

impl<F: FnMut(&mut State) + Send + 'static> Port for Changed<F> {
    fn name(&self) -> String {
        self.pty.name()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.pty.read(into, wait)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut out = Vec::new();
        for frame in bytes.split_inclusive(|byte| *byte == 0) {
            let (last, most) = frame.split_last().unwrap();
            assert!(
                most.iter()
                    .all(|byte| self.accumulator.push(*byte).is_none())
            );
            let packet = self.accumulator.push(*last);
            let unpacked = packet.map(|packet| decode(packet.unwrap()).unwrap().unpack());
            let Some(Ok(Unchecked::State(header, mut state))) = unpacked else {
                out.extend_from_slice(frame);
                continue;
            };
            (self.change)(&mut state);
            let (session, sequence) = (header.session, header.sequence);
            let mut changed = [0; MAX_FRAME];
            let length = encode(
                session,
                sequence,
                header.console_time_us,
                &state,
                &mut changed,
            );
            out.extend_from_slice(&changed[..length.unwrap()]);
        }
        // What a host does not take is gone, as on a wire.
        self.pty.write(&out)?;
        Ok(bytes.len())
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

/// A session of the earlier program with a console that says of its states what `change` makes of them.
fn with_changed(program: &Path, change: impl FnMut(&mut State) + Send + 'static) -> Ran {
    let pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let port = Changed {
        pty,
        change,
        accumulator: Accumulator::new(),
    };
    let console = SimulatedConsole::new(&device(), 7).unwrap();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| serve(console, Box::new(port), &stop));
        let ran = session_then(program, &path);
        stop.store(true, Ordering::Relaxed);
        ran
    })
}

/// Bits that it does not know: inputs are nothing to it, faults end its session as all do, with the names that it knows.
fn it_takes_new_bits_for_what_they_are(then: &Path) {
    felt("with every new input", || {
        with_changed(then, |state| state.inputs |= NEW_INPUTS.iter().sum::<u8>())
    });
    let told: [(u16, &[&str]); 3] = [
        (faults::TIME_BASE, &[]),
        (faults::AMPLIFIER | faults::BOARD, &["board"]),
        (faults::SUPPLY | faults::BOARD, &["board"]),
    ];
    for (bits, names) in told {
        let (code, summary) = undisturbed(|| {
            let mut felt = false;
            let ran = with_changed(then, move |state| {
                felt |= force(state) > 0.1;
                if felt {
                    (state.faults, state.mode) = (bits, Mode::Fault);
                }
            });
            let summary: Value = serde_json::from_str(&ran.stdout).unwrap_or_default();
            println!("{bits:#x}: exit code {}, {}", ran.code, summary["status"]);
            (summary["mode"] == "fault").then_some((ran.code, summary))
        });
        assert_eq!(code, 5, "{summary}");
        assert_eq!(summary["faults"], serde_json::json!(names));
        assert_eq!(summary["frames"]["rejected"], 0);
    }
}

/// Frames that the earlier program recorded in a session in lockstep, tick by tick.
fn exchanges(recording: &Path) -> Vec<Exchange> {
    const TICK_NS: u64 = 1_000_000;
    let bytes = std::fs::read(recording).unwrap();
    let mut exchanges = Vec::<Exchange>::new();
    let mut last = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let is_down = match message.channel.topic.as_str() {
            "/frames/down" => true,
            "/frames/up" => false,
            _ => continue,
        };
        // What comes up is told once the tick is over.
        let ticks = (message.log_time / TICK_NS) as usize;
        let tick = if is_down { ticks } else { ticks - 1 };
        if exchanges.len() <= tick {
            exchanges.resize(tick + 1, Exchange::default());
        }
        let Exchange { down, up } = &mut exchanges[tick];
        if is_down {
            if kinds(&message.data) != [Kind::Ping] {
                last = tick;
            }
            down.extend_from_slice(&message.data);
        } else {
            up.extend_from_slice(&message.data);
        }
    }
    exchanges.truncate(last + TAIL);
    exchanges
}

/// The same frames in the same ticks, and the same bytes where this machine's solver rounds as that did which made them.
/// `SUTURA_BLESS=1` writes them.
fn the_recordings_are_what_it_makes(then: &Path) {
    let folder = tempfile::tempdir().unwrap();
    for name in RECORDED {
        let file = folder.path().join("recorded.mcap");
        let scene = golden().join(format!("{name}.toml"));
        let mut command = Command::new(then);
        command.arg("run").arg(scene).arg("--record").arg(&file);
        let ran = ran(command.args(["--lockstep", "--fixture", "wall:z=-0.05,k=100"]));
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let made = exchanges(&file);
        std::fs::remove_file(file).unwrap();
        if std::env::var_os("SUTURA_BLESS").is_some() {
            write(name, &made);
        }
        let recorded = recorded(name);
        println!("{name}: to the byte: {}", made == recorded);
        assert_eq!(made.len(), recorded.len(), "{name}");
        for (tick, (made, recorded)) in made.iter().zip(&recorded).enumerate() {
            for way in [down, up] {
                assert_eq!(kinds(way(made)), kinds(way(recorded)), "{name}, {tick}");
            }
        }
    }
}

fn kinds(bytes: &[u8]) -> Vec<Kind> {
    frames(bytes).into_iter().map(|(kind, _)| kind).collect()
}

fn write(name: &str, exchanges: &[Exchange]) {
    let word = |bytes: &[u8]| match bytes {
        [] => "-".to_owned(),
        bytes => hex(bytes),
    };
    let lines = exchanges
        .iter()
        .map(|Exchange { down, up }| format!("{} {}\n", word(down), word(up)));
    let text: String = lines.collect();
    let head = format!(
        "# {name}.toml in lockstep, as host and console of {COMMIT} spoke: a line a tick, down and up.\n"
    );
    std::fs::write(golden().join(format!("{name}.hex")), head + &text).unwrap();
}
