//! Tables and sessions that are interrupted, or of which a full disk takes no more: the lines that are left.
#![cfg(unix)]

use crate::support::described::assert_described;
use crate::support::{Ran, ran, root, sutura};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_hil::NativeConsole;
use sutura_host::scene::load;
use sutura_host::session::{Plan, SceneSolver, Solve, Solved, run_lockstep};
use sutura_host::work::stop_with;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Three tables, by words that choose many quick lines.
const TABLES: [(&str, &[&str]); 3] = [
    ("tradeoff", &["--only", "beam-tension", "--errors"]),
    ("stability", &["--full", "--only", "chainmail"]),
    ("fidelity", &["--only", "return point", "--threads", "1"]),
];

fn table(at: &Path, name: &str, words: &[&str]) -> Command {
    let mut table = Command::new(env!("CARGO_BIN_EXE_sutura"));
    table.arg(name).args(words);
    table
        .args(["--plot", "out", "--format", "json"])
        .current_dir(at);
    table
}

/// Sends it Ctrl-C when its first line is kept.
fn interrupted(at: &Path, mut table: Command) -> Ran {
    let table = table.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let table = table.expect("it starts");
    let kept = at.join("out/cases.jsonl");
    while std::fs::metadata(&kept).map_or(0, |file| file.len()) == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let id = table.id().to_string();
    let told = Command::new("kill").args(["-INT", &id]).status();
    assert!(told.is_ok_and(|told| told.success()));
    let output = table.wait_with_output().expect("it ends");
    let text = |bytes| String::from_utf8(bytes).expect("output is text");
    Ran {
        code: output.status.code().expect("it ends by itself"),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

/// Ctrl-C in the middle: the lines by then are printed and written, and nothing says that the table is whole.
#[test]
fn interrupted_tables_keep_what_they_had() {
    for (name, words) in TABLES {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        let ran = interrupted(at, table(at, name, words));
        assert_eq!(ran.code, 130, "{name}: {}", ran.stderr);
        let printed = ran.json();
        assert_described(name, &printed);
        assert_eq!(printed["status"], "interrupted");
        let lines = printed["cases"].as_array().expect("lines").len();
        let said = format!("interrupted: the table has the {lines} lines by then");
        assert!(ran.stderr.contains(&said), "{name}: {}", ran.stderr);
        let read =
            |file: &str| std::fs::read_to_string(at.join("out").join(file)).expect("written");
        let written: Value = serde_json::from_str(&read(&format!("{name}.json"))).expect("JSON");
        assert_eq!(written["cases"], printed["cases"], "{name}");
        assert_eq!(read("cases.jsonl").lines().count(), lines, "{name}");
        if name == "tradeoff" {
            let merged = sutura(&[
                "tradeoff",
                "merge",
                &at.join("out/tradeoff.json").display().to_string(),
            ]);
            let words = "it was interrupted: measure this share again";
            assert!(
                merged.code == 2 && merged.stderr.contains(words),
                "{}",
                merged.stderr
            );
        }
    }
}

/// Files that may not grow stand in for a full disk: the table is printed all the same.
#[test]
fn a_full_disk_takes_no_table() {
    let tables: [(&str, &str); 3] = [
        ("tradeoff", "beam-tension linear"),
        ("stability", "linear turn"),
        ("fidelity", "return point outage-300-ms pen rows"),
    ];
    for (name, only) in tables {
        let folder = tempfile::tempdir().expect("a folder");
        let line = format!(
            "trap '' XFSZ; ulimit -f 0; exec {} {name} --only '{only}' --plot out --format json",
            env!("CARGO_BIN_EXE_sutura")
        );
        let ran = ran(Command::new("sh")
            .args(["-c", &line])
            .current_dir(folder.path()));
        assert_eq!(ran.code, 1, "{name}: {}", ran.stderr);
        let said = format!("cannot write out/{name}.json: ");
        assert!(ran.stderr.contains(&said), "{name}: {}", ran.stderr);
        assert!(ran.json()["cases"].is_array(), "{name}: {}", ran.stdout);
        assert_eq!(ran.json()["status"], "failed", "{name}: {}", ran.stdout);
    }
}

/// The last seconds that could not be written when they were asked for are said, and the session does not end as if they had been.
#[test]
fn last_seconds_that_are_not_written_are_no_success() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    std::fs::create_dir(at.join("gone")).expect("a folder");
    let mut session = Command::new(env!("CARGO_BIN_EXE_sutura"));
    session
        .args([
            "run",
            "--lockstep",
            "--seconds",
            "80000",
            "--format",
            "json",
        ])
        .args(["--record", "whole.mcap", "--save-last", "gone/last.mcap"])
        .current_dir(at)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut session = session.spawn().expect("it starts");
    let kept = at.join("whole.mcap");
    while std::fs::metadata(&kept).map_or(0, |file| file.len()) == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    std::fs::remove_dir(at.join("gone")).expect("removed");
    let id = session.id().to_string();
    let tell = |signal: &str| {
        let told = Command::new("kill").args([signal, id.as_str()]).status();
        assert!(told.is_ok_and(|told| told.success()));
    };
    tell("-USR1");
    let stderr = BufReader::new(session.stderr.take().expect("piped"));
    let mut lines = stderr.lines().map_while(Result::ok);
    let said = lines.find(|line| line.contains("gone/last.mcap"));
    assert!(said.is_some_and(|said| said.contains("cannot write")));
    tell("-INT");
    let rest: Vec<_> = lines.collect();
    let output = session.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(2), "{rest:?}");
    let printed: Value = serde_json::from_slice(&output.stdout).expect("a summary");
    assert_eq!(printed["status"], "bad-input");
}

/// Sets a flag in the midst of a solve.
struct Stopping {
    solver: SceneSolver,
    stop: Arc<AtomicBool>,
    left: u32,
}

impl Solve for Stopping {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        self.left = self.left.saturating_sub(1);
        self.stop.store(self.left == 0, Ordering::Relaxed);
        self.solver.solve(state)
    }

    fn scene(&self) -> serde_json::Map<String, Value> {
        self.solver.scene()
    }
}

/// A signal is heard within a solver step, and ends the session in lockstep with the step before.
#[test]
fn a_step_is_given_up_when_it_is_told_to() {
    let scene = load(&root().join("scenes/palpation.toml")).expect("a good scene");
    let plan = Plan::of_scene(&scene).expect("a plan");
    let stop = Arc::new(AtomicBool::new(false));
    let mut solver = Stopping {
        solver: SceneSolver::for_session(&scene, &plan).expect("a solver"),
        stop: stop.clone(),
        // In contact.
        left: 200,
    };
    let mut console = NativeConsole::new(&plan.device).expect("a console");
    stop_with(Some(stop));
    let summary = run_lockstep(&mut console, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    });
    stop_with(None);
    let summary = summary.expect("a session");
    assert!(
        summary.contact_steps > 0 && summary.ticks < 1100,
        "{}",
        summary.ticks
    );
    assert_eq!(summary.steps_withheld, BTreeMap::new());
    assert_eq!(summary.status, "ok");
}
