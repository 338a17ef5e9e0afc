//! Recordings, and what `sutura replay` makes of them.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{Overrunning, patient, undisturbed};
use crate::support::{root, sutura};
use serde_json::Value;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use sutura_hil::{NativeConsole, VirtualConsole};
use sutura_host::link::LockstepConsole;
use sutura_host::recording::replay::{
    ConsoleVerdict, HostVerdict, NativeTicks, Outcome, WholeConsole, replay_console, replay_host,
    stuffed,
};
use sutura_host::recording::{
    About, Begins, Direction, End, Frame, Recorder, Recording, RecordingError, SolveSample,
    TappedConsole, TappedPort, TappedSolver,
};
use sutura_host::scene::{self, Document, Scene, Sources, Tissue};
use sutura_host::session::{
    Effort, LINE_BYTES_PER_S, Line, Plan, Rendering, SceneSolver, Solve, Solved, contact_frame,
    run_lockstep, run_real_time,
};
use sutura_host::step::{Arrival, ToolContact};
use sutura_shared::control::CODE;
use sutura_shared::link::{HostEvent, HostLink};
use sutura_shared::wire::message::{Command as SharedCommand, Fixture, State};
use sutura_shared::wire::{
    Accumulator, Checked, HEADER_SIZE, Kind, MAX_FRAME, Valid, decode, encode, inputs,
};
use tempfile::TempDir;

const BUILD: &str = "test";

fn read_scene(name: &str) -> (Scene, Sources) {
    let document = Document::read(&root().join("scenes").join(name)).unwrap();
    (scene::read(&document).unwrap(), document.sources())
}

fn plan(scene: &Scene, seconds: f64) -> Plan {
    Plan {
        device: scene.device.unwrap().description,
        hand: scene.hand.unwrap(),
        host_hz: scene.host.host_hz,
        seconds,
        tick_hz: 1000,
        state_every: 1,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
        horizon_us: scene.host.horizon_us,
        clear_fault: false,
        fixture: Fixture::None,
    }
}

/// A solver that gives up what is asked of it, as in real time on a machine that is late: the number of a solve says what.
struct Tiring<'a> {
    solver: TappedSolver<'a>,
    solves: usize,
    effort: fn(usize) -> Effort,
}

impl Solve for Tiring<'_> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        self.solver.spare((self.effort)(self.solves));
        self.solves += 1;
        self.solver.solve(state)
    }

    fn scene(&self) -> serde_json::Map<String, Value> {
        self.solver.scene()
    }
}

/// Records a session in lockstep, in this process.
fn in_lockstep(name: &str, seconds: f64, file: &Path) -> Recording {
    with_effort(name, seconds, file, |_| Effort::Full)
}

/// As [`in_lockstep`], with a solver that gives something up.
fn with_effort(name: &str, seconds: f64, file: &Path, effort: fn(usize) -> Effort) -> Recording {
    recorded(name, seconds, file, effort, &[])
}

/// As [`with_effort`], by a console that finds in these ticks that the one before overran.
fn recorded(
    name: &str,
    seconds: f64,
    file: &Path,
    effort: fn(usize) -> Effort,
    overran: &'static [u32],
) -> Recording {
    let (scene, sources) = read_scene(name);
    let plan = plan(&scene, seconds);
    let about = About {
        lockstep: true,
        ..About::here(BUILD.to_owned(), &plan, scene.tissue.word())
    };
    let recorder = Recorder::start(Some(file), about, sources).unwrap();
    let mut solver = SceneSolver::for_session(&scene, &plan).unwrap();
    let mut solver = Tiring {
        solver: TappedSolver::new(&mut solver, recorder.tap()),
        solves: 0,
        effort,
    };
    let console = NativeConsole::new(&plan.device).unwrap();
    let mut console = Overrunning::new(console, overran);
    let mut console = TappedConsole::new(&mut console, recorder.tap());
    run_lockstep(&mut console, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    let recorded = recorder.finish().unwrap();
    assert_eq!(recorded.lost, Default::default());
    let recording = Recording::read(file).unwrap();
    assert_eq!(recording.end, End::Whole);
    let (frames, solves) = (recording.frames.len(), recording.solves.len());
    assert_eq!(
        (frames as u64, solves as u64),
        (recorded.frames, recorded.solves)
    );
    recording
}

fn of_console(recording: &Recording) -> ConsoleVerdict {
    let device = &recording.about.plan.device;
    replay_console(recording, &mut NativeTicks::new(device))
}

fn of_host(recording: &Recording) -> HostVerdict {
    let scene = scene::read(&Document::from_sources(&recording.sources)).unwrap();
    let mut solver = SceneSolver::for_session(&scene, &recording.about.plan).unwrap();
    replay_host(recording, &mut solver, true, |_, _| {})
}

fn assert_same(recording: &Recording) {
    let console = of_console(recording);
    assert_eq!(console.why, None);
    assert_eq!(
        (console.verified_ticks, console.unverified_ticks),
        (console.ticks, 0)
    );
    assert!(console.ticks > 0);
    let host = of_host(recording);
    assert_eq!(host.why, None);
    assert!(host.identical && host.verified_steps == host.steps && host.steps > 0);
    assert_eq!(host.largest_difference, 0.0);
}

/// What a frame holds: kind, sequence, console time and state, if it is sound.
fn look(frame: &Frame) -> Option<(Kind, u32, u64, Option<State>)> {
    let mut accumulator = Accumulator::new();
    let (last, most) = frame.bytes.split_last()?;
    assert!(most.iter().all(|byte| accumulator.push(*byte).is_none()));
    let decoded = decode(accumulator.push(*last)?.ok()?).ok()?;
    let header = decoded.header;
    let to_host = sutura_shared::wire::Direction::ToHost;
    let state = match decoded.unpack().and_then(|body| body.validate(to_host)) {
        Ok(Checked::State(state)) => Some(*state.body()),
        _ => None,
    };
    Some((header.kind, header.sequence, header.console_time_us, state))
}

/// Header and body of a frame.
fn content(frame: &[u8]) -> Vec<u8> {
    let mut packet = frame[..frame.len() - 1].to_vec();
    let length = cobs::decode_in_place(&mut packet).unwrap();
    packet.truncate(length - 4);
    packet
}

/// Changes the recorded state of a tick, checksum and all.
fn change_state(recording: &mut Recording, tick: u32, change: impl Fn(&mut State)) {
    for frame in &mut recording.frames {
        if let Some((_, sequence, time_us, Some(mut state))) = look(frame)
            && state.tick == tick
        {
            let session = u32::from_le_bytes(content(&frame.bytes)[2..6].try_into().unwrap());
            change(&mut state);
            let mut bytes = [0; MAX_FRAME];
            let length = encode(session, sequence, time_us, &state, &mut bytes).unwrap();
            frame.bytes = bytes[..length].to_vec();
            return;
        }
    }
    panic!("no state of tick {tick}");
}

#[test]
fn a_session_in_lockstep_comes_out_the_same_in_this_process_and_as_a_whole_console() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("palpation.toml", 1.0, &folder.path().join("a.mcap"));
    assert_same(&recording);
    let device = recording.about.plan.device;
    let mut console = NativeConsole::new(&device).unwrap();
    let whole = replay_console(&recording, &mut WholeConsole::new(&mut console));
    assert_eq!(whole, of_console(&recording));
    // Two recordings are the same file: nothing in it depends on the machine's pace.
    let again = in_lockstep("palpation.toml", 1.0, &folder.path().join("b.mcap"));
    assert_eq!(again, recording);
}

/// Ticks that a console which keeps time found late are found late again, in this process and as a whole console.
#[test]
fn ticks_that_overran_come_out_the_same() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let full = |_| Effort::Full;
    let recording = recorded("palpation.toml", 0.7, &file, full, &[300, 301, 555]);
    let states = recording.frames.iter().filter_map(|frame| look(frame)?.3);
    let overran = states.filter(|state| state.inputs & inputs::OVERRUN != 0);
    let overran: Vec<_> = overran.map(|state| state.tick).collect();
    assert_eq!(overran, [300, 301, 555]);
    assert_same(&recording);
    let mut console = NativeConsole::new(&recording.about.plan.device).unwrap();
    let whole = replay_console(&recording, &mut WholeConsole::new(&mut console));
    assert_eq!(whole, of_console(&recording));
}

#[test]
fn a_driven_needle_comes_out_the_same() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("needle-arc.toml", 1.5, &folder.path().join("a.mcap"));
    assert_same(&recording);
}

/// Tissue that hangs is part of what is recorded, and the tool feels nothing until it comes to where that is: over the unloaded top
/// for 1.4 s, then 10 mm below it.
#[test]
fn tissue_under_its_own_weight_comes_out_the_same_and_is_felt_where_it_hangs() {
    let folder = TempDir::new().unwrap();
    let name = "organ-under-its-own-weight.toml";
    let recording = in_lockstep(name, 3.0, &folder.path().join("a.mcap"));
    assert_same(&recording);
    let states = recording.frames.iter().filter_map(look);
    let states = states.filter_map(|(_, _, time_us, state)| Some((time_us, state?)));
    let felt: Vec<(u64, f32)> = states
        .map(|(time_us, state)| (time_us, state.force_n[2]))
        .collect();
    let begun_us = felt[0].0;
    let within = |from_s: f64, to_s: f64| {
        let span = begun_us + (1e6 * from_s) as u64..begun_us + (1e6 * to_s) as u64;
        let each = felt
            .iter()
            .filter(move |(time_us, _)| span.contains(time_us));
        each.map(|(_, force_n)| force_n.abs()).fold(0.0, f32::max)
    };
    assert_eq!(within(0.0, 1.4), 0.0);
    assert!(within(2.4, 3.0) > 0.2, "{}", within(2.4, 3.0));
}

/// One bit anywhere is found, at the tick that it belongs to.
#[test]
fn a_changed_state_is_found_at_its_tick() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("palpation.toml", 0.6, &folder.path().join("a.mcap"));
    let changes: [fn(&mut State); 4] = [
        |state| state.trace_hash ^= 1 << 40,
        |state| state.force_n[2] += 0.001,
        |state| state.encoder_counts[1] ^= 1,
        |state| state.velocity_m_per_s[0] = f32::from_bits(state.velocity_m_per_s[0].to_bits() ^ 1),
    ];
    for change in changes {
        let mut changed = recording.clone();
        change_state(&mut changed, 333, change);
        let verdict = of_console(&changed);
        assert_eq!(verdict.diverged_at, Some(333), "{verdict:?}");
        // The session's first state is that of tick 1.
        assert_eq!(verdict.verified_ticks, 332);
    }
}

/// A frame of the host with another number in it is found in the tick that heard it.
#[test]
fn a_changed_contact_is_found_where_it_was_heard_and_where_it_was_solved() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("palpation.toml", 1.2, &folder.path().join("a.mcap"));
    let of_kind = |kind| {
        let frames = recording.frames.iter().enumerate();
        frames.filter_map(move |(index, frame)| {
            let (found, sequence, time_us, _) = look(frame)?;
            (found == kind).then_some((index, sequence, time_us))
        })
    };
    let contacts: Vec<_> = of_kind(Kind::Contact).collect();
    let (index, sequence, time_us) = contacts[contacts.len() / 2];
    let states = recording.frames.iter().filter_map(|frame| look(frame)?.3);
    let heard = states
        .clone()
        .find(|state| state.heard_sequence >= sequence)
        .unwrap();
    let solved = recording
        .solves
        .iter()
        .position(|(_, solve)| solve.console_time_us == time_us);

    let mut changed = recording.clone();
    let mut bytes = content(&changed.frames[index].bytes);
    // The lowest bit of the force along z: tool, position and orientation stand before, 4 bytes a number.
    bytes[HEADER_SIZE + 1 + 7 * 4 + 2 * 4] ^= 1;
    changed.frames[index].bytes = stuffed(&bytes);
    assert_ne!(changed, recording);
    let console = of_console(&changed);
    assert_eq!(console.diverged_at, Some(heard.tick), "{console:?}");
    let host = of_host(&changed);
    assert_eq!(
        host.diverged_step,
        Some(solved.unwrap() as u64 + 1),
        "{host:?}"
    );
    assert_eq!(host.diverged_at, Some((time_us / 1000) as u32));
}

/// A recording of the last seconds is compared as far as it needs no past: all ticks if its opening is in the file, else their poses;
/// of solves the contacts that went down.
#[test]
fn the_last_seconds_are_compared_as_far_as_they_go() {
    let folder = TempDir::new().unwrap();
    let mut recording = in_lockstep("palpation.toml", 1.2, &folder.path().join("a.mcap"));
    recording.about.begins = Begins::Later;
    let console = of_console(&recording);
    assert_eq!((&console.why, console.poses), (&None, 0));
    assert!(console.ticks > 1000 && console.verified_ticks == console.ticks);
    let outcome = Outcome::of(&recording, &console, &of_host(&recording));
    assert_eq!(outcome, Outcome::NotReplayed);
    let host = of_host(&recording);
    assert_eq!((host.verified_steps, host.unverifiable_from), (0, Some(1)));
    assert!(
        host.contacts > 200 && host.contacts <= host.steps,
        "{host:?}"
    );

    // Its opening is gone.
    let opens = |frame: &Frame| {
        look(frame).is_some_and(|(.., state)| state.is_some_and(|state| state.tick == 400))
    };
    let first = recording.frames.iter().position(opens).unwrap();
    recording.frames.drain(..first);
    let console = of_console(&recording);
    assert_eq!((console.verified_ticks, console.poses), (0, console.ticks));
    assert!(console.ticks > 700 && console.diverged_at.is_none());
    assert_eq!(console.unverifiable_from, Some(400));
    assert!(console.why.unwrap().contains("last seconds"));

    let mut changed = recording.clone();
    change_state(&mut changed, 900, |state| state.position_m[2] += 1e-6);
    let console = of_console(&changed);
    assert_eq!((console.diverged_at, console.poses), (Some(900), 500));

    let mut changed = recording.clone();
    let (place, time_us) = (0..)
        .zip(&changed.solves)
        .filter_map(|(place, (_, solve))| {
            Some((place, solve.wrench.map(|_| solve.console_time_us)?))
        })
        .nth(100)
        .unwrap();
    changed.solves[place].1.wrench.as_mut().unwrap()[2] += 1e-3;
    let host = of_host(&changed);
    assert_eq!(host.diverged_step, Some(place as u64 + 1), "{host:?}");
    assert_eq!(host.diverged_at, Some((time_us / 1000) as u32));
}

#[test]
fn a_changed_solve_and_a_changed_pose_are_found_at_their_step() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("palpation.toml", 1.0, &folder.path().join("a.mcap"));
    let (number, solve) = recording.solves[77].clone();
    let tick = (solve.console_time_us / 1000) as u32;

    let mut changed = recording.clone();
    changed.solves[77].1.state_hash = format!("{:016x}", 7);
    let verdict = of_host(&changed);
    assert_eq!(
        (verdict.diverged_step, verdict.diverged_at),
        (Some(78), Some(tick))
    );

    let mut changed = recording.clone();
    change_state(&mut changed, tick, |state| state.position_m[2] -= 1e-4);
    let verdict = of_host(&changed);
    assert_eq!(
        (verdict.diverged_step, verdict.diverged_at),
        (Some(u64::from(number)), Some(tick))
    );
    assert_eq!(of_console(&changed).diverged_at, Some(tick));

    // By another build bits may differ, forces may not.
    let mut changed = recording.clone();
    changed.solves[77].1.state_hash = format!("{:016x}", 7);
    let scene = scene::read(&Document::from_sources(&changed.sources)).unwrap();
    let solver = || SceneSolver::for_session(&scene, &changed.about.plan).unwrap();
    let verdict = replay_host(&changed, &mut solver(), false, |_, _| {});
    assert_eq!((verdict.diverged_step, verdict.identical), (None, false));
    let touched = changed
        .solves
        .iter()
        .rposition(|(_, solve)| solve.rows > 0)
        .unwrap();
    changed.solves[touched].1.wrench.as_mut().unwrap()[2] *= 1.0 + 1e-6;
    let verdict = replay_host(&changed, &mut solver(), false, |_, _| {});
    assert_eq!(verdict.diverged_step, Some(touched as u64 + 1));
}

/// What the line lost is found out; what is not in the recording is said.
#[test]
fn missing_frames_and_states_are_said() {
    let folder = TempDir::new().unwrap();
    let recording = in_lockstep("palpation.toml", 0.6, &folder.path().join("a.mcap"));
    let at = |recording: &Recording, which: &dyn Fn(Kind, Option<State>) -> bool| {
        let frames = recording.frames.iter();
        let mut found =
            frames.map(|frame| look(frame).is_some_and(|(kind, _, _, state)| which(kind, state)));
        found.position(|is| is).unwrap()
    };
    // A tick in which nothing new was heard: the simulated mechanics bridge it.
    let states: Vec<State> = recording
        .frames
        .iter()
        .filter_map(|frame| look(frame)?.3)
        .collect();
    let alike = |three: &&[State]| {
        three
            .iter()
            .all(|state| state.heard_sequence == three[0].heard_sequence)
    };
    let tick = states[400..].windows(3).find(alike).unwrap()[1].tick;
    let mut without = recording.clone();
    let quiet = at(&recording, &|_, state| {
        state.is_some_and(|state| state.tick == tick)
    });
    without.frames.remove(quiet);
    let verdict = of_console(&without);
    assert_eq!(
        (verdict.diverged_at, verdict.unverifiable_from),
        (None, None),
        "{verdict:?}"
    );
    assert_eq!(verdict.verified_ticks, of_console(&recording).ticks - 1);

    let mut without = recording.clone();
    let contact = at(&recording, &|kind, _| kind == Kind::Contact);
    let (_, sequence, _, _) = look(&recording.frames[contact]).unwrap();
    without.frames.remove(contact);
    let verdict = of_console(&without);
    let states = recording.frames.iter().filter_map(|frame| look(frame)?.3);
    let heard = states
        .clone()
        .find(|state| state.heard_sequence >= sequence)
        .unwrap();
    assert_eq!(verdict.unverifiable_from, Some(heard.tick), "{verdict:?}");
    assert_eq!(verdict.diverged_at, None);

    let mut without = recording.clone();
    without.solves.remove(10);
    let verdict = of_host(&without);
    assert_eq!(
        (verdict.unverifiable_from, verdict.verified_steps),
        (Some(11), 10)
    );
}

/// A console that was up before, and is not told what it is, as one with motors: its past is not in the recording, and is
/// forgotten by its filters before it is armed.
#[test]
fn a_console_with_a_past_is_joined() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let (scene, sources) = read_scene("palpation.toml");
    let plan = plan(&scene, 0.4);
    let mut console = NativeConsole::new(&plan.device).unwrap();
    let mut solver = SceneSolver::for_session(&scene, &plan).unwrap();
    run_lockstep(&mut console, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    })
    .unwrap();

    // Until it is nobody's any more.
    for _ in 0..400 {
        console.exchange(&[], &mut Vec::new()).unwrap();
    }

    let about = About {
        lockstep: true,
        ..About::here(BUILD.to_owned(), &plan, scene.tissue.word())
    };
    let recorder = Recorder::start(Some(&file), about, sources).unwrap();
    let mut console = TappedConsole::new(&mut console, recorder.tap());
    let mut end = HostLink::new(1000);
    let (mut frame, mut up) = ([0; MAX_FRAME], Vec::new());
    let length = end.hello(77, &mut frame).unwrap();
    let mut down = frame[..length].to_vec();
    let mut newest: Option<State> = None;
    for tick in 0..1500 {
        up.clear();
        console.exchange(&down, &mut up).unwrap();
        down.clear();
        for byte in &up {
            if let Some(HostEvent::State(state)) = end.receive(*byte) {
                newest = Some(*state.body());
            }
        }
        let Some(state) = newest else { continue };
        let now_us = 1000 * u64::from(state.tick);
        let mut send = |length: usize, frame: &[u8]| down.extend_from_slice(&frame[..length]);
        if tick == 700 {
            send(
                end.send(now_us, &SharedCommand::Arm, &mut frame).unwrap(),
                &frame,
            );
        }
        if tick % 10 == 0 {
            let spring = ToolContact {
                wrench: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
                normal: [0.0, 0.0, 1.0],
                ..ToolContact::default()
            };
            let contact = contact_frame(&state, &spring, 50_000);
            send(end.send(now_us, &contact, &mut frame).unwrap(), &frame);
        }
    }
    recorder.finish().unwrap();
    let recording = Recording::read(&file).unwrap();
    let verdict = of_console(&recording);
    assert_eq!((verdict.why, verdict.diverged_at), (None, None));
    assert!(verdict.ticks > 1400, "{}", verdict.ticks);
    assert!(
        (1..700).contains(&verdict.unverified_ticks),
        "{}",
        verdict.unverified_ticks
    );
    assert_eq!(
        verdict.verified_ticks + verdict.unverified_ticks,
        verdict.ticks
    );
    // It was armed, and felt something.
    let states = recording.frames.iter().filter_map(|frame| look(frame)?.3);
    assert!(states.map(|state| state.force_n[2]).fold(0.0, f32::max) > 0.9);
}

/// Two seconds of palpation in real time, with a thread that computes columns.
fn with_a_thread(file: &Path, mut solver: SceneSolver) -> Recording {
    let (scene, sources) = read_scene("palpation.toml");
    let plan = plan(&scene, 2.0);
    let about = About {
        worker: true,
        ..About::here(BUILD.to_owned(), &plan, scene.tissue.word())
    };
    let recorder = Recorder::start(Some(file), about, sources).unwrap();
    solver.start_worker();
    let mut tapped = TappedSolver::new(&mut solver, recorder.tap());
    let mut console = VirtualConsole::start(&plan.device).unwrap();
    let port = TappedPort::new(console.host_port().unwrap(), recorder.tap());
    let line = Line::from(Box::new(port) as Box<dyn sutura_host::link::Port>);
    run_real_time(line, patient(), &plan, &mut tapped, |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    recorder.finish().unwrap();
    let recording = Recording::read(file).unwrap();
    assert_eq!(recording.end, End::Whole);
    recording
}

/// A thread computes columns here, and when they come depends on the machine: what the recording says of that is enough.
#[test]
fn a_session_in_real_time_comes_out_the_same_whenever_columns_came() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let (scene, _) = read_scene("palpation.toml");
    let plan = plan(&scene, 2.0);
    // Nothing is computed beforehand, so that the thread has something to do.
    let unprepared = || {
        let mut solver = SceneSolver::new(&scene).unwrap();
        solver.reduce_to(plan.most_rows(), 2.0 / plan.host_hz);
        solver
    };
    let recording = undisturbed(|| {
        let recording = with_a_thread(&file, unprepared());
        let came = recording
            .solves
            .iter()
            .any(|(_, solve)| !solve.arrivals.is_empty());
        came.then_some(recording)
    });

    let console = of_console(&recording);
    assert_eq!((console.why, console.diverged_at), (None, None));
    // The console was up for a moment before.
    assert!(console.verified_ticks > 0);
    assert_eq!(
        console.verified_ticks + console.unverified_ticks,
        console.ticks
    );
    let host = replay_host(&recording, &mut unprepared(), true, |_, _| {});
    assert_eq!(host.why, None);
    assert!(host.identical && host.verified_steps == host.steps);
}

/// As above for the factors of tissue that turns: a replay that takes them over in other steps is another session.
#[test]
fn a_session_on_corotational_tissue_comes_out_the_same_whenever_factors_came() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    // Coarser than shipped, so that a slow build keeps its pace.
    let shipped = std::fs::read_to_string(root().join("scenes/palpation.toml")).unwrap();
    let coarse = folder.path().join("coarse.toml");
    std::fs::write(&coarse, shipped.replace("[20, 20, 8]", "[8, 8, 4]")).unwrap();
    let mut scene = scene::read(&Document::read(&coarse).unwrap()).unwrap();
    scene.tissue = Tissue::named("corotational").unwrap();
    let solver = || SceneSolver::new(&scene).unwrap();
    let came = |solve: &SolveSample| {
        solve
            .arrivals
            .iter()
            .any(|(_, what)| *what == Arrival::FACTOR)
    };
    let mut recording = undisturbed(|| {
        let recording = with_a_thread(&file, solver());
        let any = recording.solves.iter().any(|(_, solve)| came(solve));
        any.then_some(recording)
    });
    let host = replay_host(&recording, &mut solver(), true, |_, _| {});
    assert_eq!(host.why, None);
    assert!(host.identical && host.verified_steps == host.steps);

    for (_, solve) in &mut recording.solves {
        solve.arrivals.clear();
    }
    let host = replay_host(&recording, &mut solver(), true, |_, _| {});
    assert!(host.diverged_step.is_some() && !host.identical);
}

/// What a late host gave up is not in the recording: neither what is felt nor what comes of it depends on that.
#[test]
fn a_session_that_gave_something_up_comes_out_the_same() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let falls_and_rises = |solve: usize| match (solve / 9) % 3 {
        0 => Effort::NoRows,
        1 => Effort::NoLooks,
        _ => Effort::Full,
    };
    // The tangent of a touch to come is there for two solves before each touch only.
    assert_same(&with_effort("palpation.toml", 1.0, &file, |_| {
        Effort::NoRows
    }));
    assert_same(&with_effort(
        "needle-slabs.toml",
        1.0,
        &file,
        falls_and_rises,
    ));
}

#[test]
fn a_file_that_is_cut_off_is_replayed_as_far_as_it_goes() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let whole = in_lockstep("palpation.toml", 0.6, &file);
    let bytes = std::fs::read(&file).unwrap();
    let cut = folder.path().join("cut.mcap");
    let mut most = 0;
    for part in [
        0,
        7,
        100,
        2000,
        bytes.len() / 2,
        bytes.len() - 2000,
        bytes.len() - 1,
    ] {
        std::fs::write(&cut, &bytes[..part]).unwrap();
        match Recording::read(&cut) {
            Ok(recording) => {
                most = most.max(recording.frames.len());
                assert!(part > 2000 || recording.frames.is_empty());
                if part < bytes.len() - 1 {
                    assert!(matches!(recording.end, End::Cut(_)), "{part}");
                }
                let verdict = of_console(&recording);
                assert_eq!(
                    (verdict.diverged_at, verdict.unverifiable_from),
                    (None, None)
                );
                assert_eq!(verdict.verified_ticks, verdict.ticks);
            }
            Err(error) => {
                assert!(part <= 2000, "{part}: {error}");
                assert!(
                    matches!(error, RecordingError::NotARecording { .. }),
                    "{error}"
                );
            }
        }
    }
    assert_eq!(most, whole.frames.len());
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let ran = sutura(&["replay", cut.to_str().unwrap(), "--format", "json"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("cut off"), "{}", ran.stderr);
    let object: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert!(object["console"]["verified_ticks"].as_u64().unwrap() > 100);
    // A bit that has tipped over in the file ends what can be read there.
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 4;
    std::fs::write(&cut, &damaged).unwrap();
    let recording = Recording::read(&cut).unwrap();
    assert!(matches!(recording.end, End::Cut(_)) && !recording.frames.is_empty());
}

#[test]
fn other_files_are_refused_with_what_they_are() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str, bytes: &[u8]| -> PathBuf {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let empty = mcap_file(&folder.path().join("foreign.mcap"), None);
    let (scene, _) = read_scene("palpation.toml");
    let words = |key: &str, word: &str| {
        let about = About::here(BUILD.to_owned(), &plan(&scene, 1.0), "linear");
        let mut words = about.words();
        words.insert(key.to_owned(), word.to_owned());
        words
    };
    let other = mcap_file(
        &folder.path().join("other.mcap"),
        Some(words("schema_hash", "0123456789abcdef")),
    );
    let code = mcap_file(
        &folder.path().join("code.mcap"),
        Some(words("console_code", "0")),
    );
    let layout = mcap_file(
        &folder.path().join("layout.mcap"),
        Some(words("layout", "99")),
    );
    let plan = mcap_file(&folder.path().join("plan.mcap"), Some(words("plan", "{}")));
    for (file, says) in [
        (path("text.mcap", b"no recording at all"), "no MCAP file"),
        (path("empty.mcap", b""), "no MCAP file"),
        (folder.path().join("absent.mcap"), "cannot read"),
        (empty, "without this program's metadata"),
        (other, "schema 0123456789abcdef"),
        (code, "with console code 0"),
        (layout, "layout is 99"),
        (plan, "`plan`"),
    ] {
        let ran = sutura(&["replay", file.to_str().unwrap()]);
        assert_eq!(ran.code, 2, "{}: {}", file.display(), ran.stderr);
        assert!(
            ran.stderr.contains(says),
            "{}: {}",
            file.display(),
            ran.stderr
        );
    }
}

/// A good recording whose metadata say another code of the console, or none, is not replayed; as it was, it is.
#[test]
fn a_recording_by_other_console_code_is_refused_before_anything_is_replayed() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let recording = in_lockstep("palpation.toml", 0.2, &file);
    assert_eq!(recording.about.console_code, CODE);
    let whole = std::fs::read(&file).unwrap();
    let other = folder.path().join("other.mcap");
    let told = format!("this program has console code {CODE}");
    for (code, says) in [
        (Some("99"), "with console code 99, by version 0."),
        (Some("x"), "with console code x"),
        (None, "with a console code that had no number yet"),
    ] {
        let mut words = recording.about.words();
        words.remove("console_code");
        words.extend(code.map(|code| ("console_code".to_owned(), code.to_owned())));
        std::fs::write(&other, with_words(&whole, &words)).unwrap();
        assert!(matches!(
            Recording::read(&other),
            Err(RecordingError::OtherConsole { .. })
        ));
        let name = other.to_str().unwrap();
        let ran = sutura(&["replay", name, "--format", "json"]);
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        let object: Value = serde_json::from_str(&ran.stdout).unwrap();
        assert_eq!(object["status"], "bad-input");
        assert_eq!(object.get("console"), None, "{object}");
        let message = object["message"].as_str().unwrap();
        for word in [name, says, &told] {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
        let help = object["help"].as_str().unwrap();
        assert!(help.contains("the release that recorded it"), "{help}");
    }
    std::fs::write(&other, with_words(&whole, &recording.about.words())).unwrap();
    let again = Recording::read(&other).unwrap();
    assert_eq!(again.about, recording.about);
    assert_same(&again);
}

/// The bytes of a recording with other words about it: the record is the file's second.
fn with_words(bytes: &[u8], words: &std::collections::BTreeMap<String, String>) -> Vec<u8> {
    let record = |at: usize| {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        at + 9 + length as usize
    };
    let begins = record(mcap::MAGIC.len());
    let ends = record(begins);
    let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    let map: Vec<u8> = words
        .iter()
        .flat_map(|(key, word)| [text(key), text(word)].concat())
        .collect();
    let map_length = (map.len() as u32).to_le_bytes();
    let body = [text("sutura"), map_length.to_vec(), map].concat();
    let length = (body.len() as u64).to_le_bytes();
    let head = &bytes[..=begins];
    [head, &length, &body, &bytes[ends..]].concat()
}

fn mcap_file(path: &Path, words: Option<std::collections::BTreeMap<String, String>>) -> PathBuf {
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    if let Some(metadata) = words {
        let name = "sutura".to_owned();
        writer
            .write_metadata(&mcap::records::Metadata { name, metadata })
            .unwrap();
    }
    writer.finish().unwrap();
    path.to_owned()
}

/// Scripts rely on these keys and codes.
#[test]
fn the_command_records_and_replays() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mcap");
    let file = file.to_str().unwrap();
    let ran = sutura(&[
        "run",
        "--lockstep",
        "--seconds",
        "0.5",
        "--record",
        file,
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let ran = sutura(&["replay", file, "--verify", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(
        (&object["diverged_at"], &object["cut_off"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(object["console"]["verified_ticks"], object["ticks"]);
    assert_eq!(object["console"]["hash"], object["hash"]);
    assert_eq!(object["status"], "ok");
    assert_eq!(object["host"]["identical"], true);
    assert_eq!(object["host"]["largest_difference"], 0.0);
    assert_eq!(object["host"]["steps"], object["host"]["verified_steps"]);
    let ran = sutura(&["replay", file]);
    assert!(
        ran.code == 0 && ran.stdout.contains("to the bit"),
        "{}",
        ran.stdout
    );
    let ran = sutura(&[
        "run",
        "--lockstep",
        "--seconds",
        "0.5",
        "--record",
        "/nowhere/a.mcap",
    ]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("/nowhere/a.mcap"), "{}", ran.stderr);
}

/// The console goes away in the middle of a session: the last seconds are there to be looked at, and say that they are
/// not more.
#[test]
#[expect(clippy::zombie_processes, reason = "both are waited for in the end")]
fn the_last_seconds_are_saved_when_the_console_is_lost() {
    let folder = TempDir::new().unwrap();
    let (link, last) = (
        folder.path().join("console"),
        folder.path().join("last.mcap"),
    );
    let mut console = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(["console", "--link", link.to_str().unwrap()])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while !link.exists() {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "the console does not start"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    // Until it has felt the console for a while; anew where this machine was so late that the console went to rest before.
    let (mut host, mut said) = undisturbed(|| {
        // It waits for the console to come back until then.
        let words = ["run", "--seconds", "10", "--stream"];
        let mut host = Command::new(env!("CARGO_BIN_EXE_sutura"))
            .args(words)
            .args(["--console", link.to_str().unwrap()])
            .args(["--save-last", last.to_str().unwrap()])
            .current_dir(root())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut said = std::io::BufReader::new(host.stdout.take().unwrap());
        loop {
            let mut line = String::new();
            if std::io::BufRead::read_line(&mut said, &mut line).unwrap() == 0 {
                host.wait().unwrap();
                return None;
            }
            let note: Value = serde_json::from_str(&line).unwrap();
            if note["elapsed_s"].as_f64() > Some(0.2) {
                return Some((host, said));
            }
        }
    });
    // Its terminal's number is another test's next: the host must not find that one.
    std::fs::remove_file(&link).unwrap();
    console.kill().unwrap();
    console.wait().unwrap();
    std::io::copy(&mut said, &mut std::io::sink()).unwrap();
    // Lost; or at rest before that, on a machine that was late for half a second.
    let code = host.wait().unwrap().code();
    assert!(matches!(code, Some(3 | 1)), "{code:?}");
    let recording = Recording::read(&last).unwrap();
    assert_eq!(
        (recording.about.begins, &recording.end),
        (Begins::Later, &End::Whole)
    );
    let up = recording
        .frames
        .iter()
        .filter(|frame| frame.direction == Direction::Up);
    assert!(up.count() > 0);
    for more in [&[][..], &["--verify"]] {
        let ran = sutura(&[&["replay", last.to_str().unwrap()], more].concat());
        assert_eq!(ran.code, 9, "{}", ran.stderr);
        assert!(ran.stderr.contains("last seconds"), "{}", ran.stderr);
    }
}

/// The recording of the whole session outlives whoever wants the last seconds in its place.
#[cfg(unix)]
#[test]
fn the_last_seconds_are_never_written_over_the_whole_recording() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let Recording { about, sources, .. } = in_lockstep("palpation.toml", 0.1, &at("a.mcap"));
    let recorder = Recorder::start(Some(&at("whole.mcap")), about, sources).unwrap();
    std::os::unix::fs::symlink("whole.mcap", at("link.mcap")).unwrap();
    for name in ["whole.mcap", "link.mcap"] {
        let error = recorder.save_last(&at(name)).unwrap_err().to_string();
        assert!(
            error.contains("the recording of the whole session"),
            "{error}"
        );
    }
    assert!(recorder.save_last(&at("last.mcap")).unwrap() > 0);
    recorder.finish().unwrap();
    let whole = Recording::read(&at("whole.mcap")).unwrap();
    assert_eq!(
        (whole.end, whole.about.begins),
        (End::Whole, Begins::Session)
    );
}

/// A file of the last seconds is no success for scripts; what it cannot give is said before any work, and before a browser starts.
#[test]
fn what_a_file_of_the_last_seconds_cannot_give_is_said_at_once() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (whole, last) = (path("a.mcap"), path("last.mcap"));
    let ran = sutura(&["run", "--lockstep", "--seconds", "0.5", "--record", &whole]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let bytes = std::fs::read(&whole).unwrap();
    let mut words = Recording::read(Path::new(&whole)).unwrap().about.words();
    words.insert("begins".to_owned(), "later".to_owned());
    std::fs::write(&last, with_words(&bytes, &words)).unwrap();

    let ran = sutura(&["replay", &last, "--format", "json"]);
    assert_eq!(ran.code, 9, "{}", ran.stderr);
    let object = ran.json();
    assert_eq!(object["console"]["verified_ticks"], object["ticks"]);
    assert_eq!(object["status"], "not-replayed", "{object}");
    assert_eq!(object["host"]["identical"], false, "{object}");
    assert_eq!(object["host"]["verified_steps"], 0);
    assert!(object["host"]["contacts"].as_u64() > Some(50), "{object}");
    for words in ["cannot be run again", "last seconds", "--record"] {
        assert!(ran.stderr.contains(words), "{}", ran.stderr);
    }
    let (png, series) = (path("a.png"), path("series"));
    for asked in [
        &["view", &last, "--shot", &png][..],
        &["replay", &last, "--series", &series],
    ] {
        let ran = sutura(asked);
        assert_eq!(ran.code, 9, "{asked:?}: {}", ran.stderr);
        for words in ["last.mcap holds the last seconds", "--record"] {
            assert!(ran.stderr.contains(words), "{}", ran.stderr);
        }
        assert!(!ran.stderr.contains("see it"), "{}", ran.stderr);
    }
    assert!(!Path::new(&png).exists() && !Path::new(&series).exists());

    // A whole recording has no picture after its end.
    for at in ["8", "0.51", "-1", "nan"] {
        let ran = sutura(&["view", &whole, "--shot", &png, &format!("--at={at}")]);
        assert_eq!(ran.code, 2, "{at}: {}", ran.stderr);
        assert!(!ran.stderr.contains("see it"), "{at}: {}", ran.stderr);
    }
}
