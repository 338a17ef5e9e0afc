//! A host that is killed while it renders force: the console, which goes on, lets the force go to zero.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{Said, Tap, device, force, undisturbed};
use crate::support::session_of;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_hil::{Pty, serve};
use sutura_shared::control::STALE_DECAY_US;
use sutura_shared::simulated_console::SimulatedConsole;
use sutura_shared::wire::message::{Mode, State};

/// Longer than any machine needs.
const LONG: Duration = Duration::from_secs(120);

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn sutura(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command
        .args(arguments)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
        .env_remove("RUST_LOG");
    command
}

fn wait_for(said: &Said, what: &str, mut found: impl FnMut(&[State]) -> bool) -> Vec<State> {
    let deadline = Instant::now() + LONG;
    loop {
        let states = said.states();
        if found(&states) {
            return states;
        }
        assert!(Instant::now() < deadline, "{what}: not in {LONG:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn the_force_of_a_killed_host_decays_and_another_host_can_come() {
    let pty = Pty::open().unwrap();
    let path = pty.path().to_owned();
    let (tap, said) = Tap::new(Box::new(pty));
    let console = SimulatedConsole::new(&device(), 7).unwrap();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| serve(console, Box::new(tap), &stop));
        // Whatever fails below, the console must end for the test to end.
        let checked =
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| check(&path, &said)));
        stop.store(true, Ordering::Relaxed);
        if let Err(panic) = checked {
            std::panic::resume_unwind(panic);
        }
    });
}

/// A session that presses; none where the machine was late for so long that the console went to rest before.
fn pressing(path: &str) -> Option<Killed> {
    let run = ["run", "--console", path, "--seconds", "600", "--stream"];
    let mut host = Killed(sutura(&run).stdout(Stdio::piped()).spawn().unwrap());
    let lines = BufReader::new(host.0.stdout.take().unwrap()).lines();
    let mut was_armed = false;
    for line in lines.map_while(Result::ok) {
        let note: serde_json::Value = serde_json::from_str(&line).unwrap();
        match note["mode"].as_str() {
            Some("armed") if note["force_n"][2].as_f64().unwrap() > 0.5 => return Some(host),
            Some("idle") if was_armed => return None,
            mode => was_armed |= mode == Some("armed"),
        }
    }
    None
}

fn check(path: &str, said: &Said) {
    let mut host = undisturbed(|| pressing(path));
    // SIGKILL: nothing is said to the console.
    host.0.kill().unwrap();
    host.0.wait().unwrap();

    let alive = said.states().len();
    let states = wait_for(said, "idle again", |states| {
        states.last().is_some_and(|s| s.mode == Mode::Idle)
    });
    let armed = states
        .iter()
        .rposition(|state| state.mode == Mode::Armed)
        .unwrap();
    let end = &states[armed..];
    assert!(alive > 0);
    let pressed = |state: &State| state.mode == Mode::Armed && force(state) > 0.3;
    assert!(states[..=armed].iter().any(pressed), "it was pressed");
    assert_eq!(end[1].mode, Mode::Decaying);
    // The scene's horizon, by the console's own clock and the age that it gives.
    let horizon_us = end[0].contact_age_us + 1000;
    assert!(horizon_us <= 151_000, "{horizon_us}");
    for pair in end.windows(2) {
        let [before, state] = pair else {
            unreachable!()
        };
        assert_eq!(state.tick, before.tick + 1, "no tick is missing");
        if state.mode == Mode::Decaying {
            assert_eq!(
                state.contact_age_us,
                before.contact_age_us + 1000,
                "nothing came"
            );
            if state.contact_age_us >= horizon_us + STALE_DECAY_US {
                assert_eq!(
                    state.force_n, [0.0; 3],
                    "at an age of {} us",
                    state.contact_age_us
                );
            }
        }
    }
    let rest = end.last().unwrap();
    assert_eq!((rest.force_n, rest.current_a), ([0.0; 3], [0.0; 3]));
    let decaying = end
        .iter()
        .filter(|state| state.mode == Mode::Decaying)
        .count();
    assert!(
        decaying > STALE_DECAY_US as usize / 1000,
        "{decaying} ticks"
    );

    // A machine that stands still has the line overrun: frames are lost, and cut. What the dead host never read does not count.
    undisturbed(|| {
        let next = session_of(&["run", "--console", path, "--seconds", "0.3"]);
        assert!(next.ended_well(), "{}", next.stderr);
        let summary = next.json();
        let ticks = summary["ticks"].as_u64().unwrap();
        let frames = &summary["frames"];
        let lost = frames["lost"].as_u64().unwrap();
        // The end is seen by the first state after it that is not lost.
        assert!((1..=300 + lost).contains(&ticks), "{summary}");
        (lost < 300 && frames["rejected"] == 0).then_some(())
    });
}

/// The same through the console's own process, which is told to end by a signal.
#[test]
fn a_console_of_its_own_serves_one_host_after_the_other_and_ends_when_told() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("bench");
    let link = link.to_str().unwrap();
    let mut console = Killed(
        sutura(&["console", "--link", link])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    BufReader::new(console.0.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    assert_eq!(line.trim(), link);
    for _ in 0..2 {
        let ran = session_of(&["run", "--console", link, "--seconds", "0.2"]);
        assert!(ran.ended_well(), "{}", ran.stderr);
        assert!(ran.json()["ticks"].as_u64() > Some(0), "{}", ran.stdout);
    }
    let pid = console.0.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-TERM", &pid])
            .status()
            .unwrap()
            .success()
    );
    assert_eq!(console.0.wait().unwrap().code(), Some(0));
    assert!(
        !std::path::Path::new(link).is_symlink(),
        "the link goes with the console"
    );
}
