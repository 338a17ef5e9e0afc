//! Threads and contact from scene file to console: a wound is sewn and drawn together.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::{root, sutura, sutura_in};
use serde_json::Value;
use std::ops::{ControlFlow, Range};
use std::path::Path;
use std::sync::{Arc, Mutex};
use sutura_hil::NativeConsole;
use sutura_host::link::{LinkError, LockstepConsole};
use sutura_host::scene::{Document, Scene};
use sutura_host::session::{
    LINE_BYTES_PER_S, Moment, Plan, Rendering, SceneSolver, Solve, Solved, run_lockstep,
};
use sutura_host::step::{Status, ToolContact};
use sutura_host::thread::ThreadPlace;
use sutura_host::tool::ToolSample;
use sutura_shared::wire::message::{Contact, End, State, Tension, Thread};
use sutura_shared::wire::{Accumulator, Unchecked, Valid, decode};
use sutura_testkit::full;

/// `scenes/wound-slabs.toml` with fewer cells, and without what comes after the gap has closed.
fn coarse() -> String {
    let text = std::fs::read_to_string(root().join("scenes/wound-slabs.toml")).unwrap();
    let coarse = text.replace("divisions = [8, 12, 4]", "divisions = [5, 7, 3]");
    assert_ne!(text, coarse);
    coarse
}

fn run(directory: &Path, text: &str) -> Value {
    std::fs::write(directory.join("wound.toml"), text).unwrap();
    let ran = sutura_in(
        directory,
        &["run", "wound.toml", "--lockstep", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

fn number(object: &Value, key: &str) -> f64 {
    object[key]
        .as_f64()
        .unwrap_or_else(|| panic!("no number {key} in {object:#}"))
}

#[test]
fn a_wound_is_sewn_and_closed() {
    let directory = tempfile::tempdir().unwrap();
    let summary = run(directory.path(), &coarse());
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    let scene = &summary["scene"];
    assert_eq!(scene["punctures"], 16, "{scene}");
    let thread = &scene["threads"][0];
    assert_eq!(
        (&thread["state"], &thread["punctures"], &thread["bridges"]),
        (&"taut".into(), &16.into(), &7.into()),
        "{thread}"
    );
    // The tail's hand, and the console's by the needle.
    assert_eq!(thread["held_by"], serde_json::json!([2, 0]));
    // Frictionless: one tension.
    let tension = |end: usize| thread["tension_n"][end].as_f64().unwrap();
    assert!(
        tension(0) > 0.1 && (tension(0) - tension(1)).abs() < 1e-9,
        "{thread}"
    );
    assert_eq!(number(scene, "tension_n"), tension(0).max(tension(1)));
    // As long as what there is of it.
    let excess = number(thread, "length_m") - number(thread, "available_m");
    assert!(excess.abs() < 1e-6, "{excess} m");
    assert!(number(scene, "gap_ratio") < 0.5, "{scene}");
    assert!(number(scene, "pulled_m") > 0.02, "{scene}");
    assert!(number(scene, "penetration_ratio") >= 0.0, "{scene}");
    let gap = number(scene, "rim_gap_m");
    let welded = number(scene, "rim_gap_welded_m");
    assert!((number(scene, "rim_gap_vs_welded") - gap / welded).abs() < 1e-12);
    assert!(number(scene, "stress_peak_pa") > 1e3, "{scene}");

    let again = run(directory.path(), &coarse());
    assert_eq!(summary["trace_hash"], again["trace_hash"]);
    assert_eq!(scene, &again["scene"]);
}

fn solve(directory: &Path, text: &str, more: &[&str]) -> Value {
    std::fs::write(directory.join("wound.toml"), text).unwrap();
    let words = [
        "solve",
        "wound.toml",
        "--out",
        "out.json",
        "--overwrite",
        "--format",
        "json",
    ];
    let ran = sutura_in(directory, &[&words, more].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

/// Before anything has happened: the gap is that of the mesh.
#[test]
fn an_open_wound_is_reported_as_it_is_made() {
    let directory = tempfile::tempdir().unwrap();
    let solved = solve(directory.path(), &coarse(), &["--at", "0"]);
    let wound = &solved["wound"];
    assert!(
        (number(wound, "rim_gap_m") - 0.004).abs() < 1e-12,
        "{wound}"
    );
    assert!((number(wound, "gap_ratio") - 1.0).abs() < 1e-12, "{wound}");
    assert_eq!(number(wound, "penetration_ratio"), 0.0);
    assert_eq!(number(wound, "stress_peak_pa"), 0.0);
    assert_eq!(
        (number(wound, "tension_n"), number(wound, "pulled_m")),
        (0.0, 0.0)
    );
    assert_eq!(wound["threads"][0]["state"], "slack");
    // No thread bridges it yet.
    for key in ["bridge_ratio", "rim_gap_vs_welded"] {
        assert!(wound.get(key).is_none(), "{wound}");
    }
}

/// What bridges the gap is as short as the scene says, and what has been drawn out for that is told.
#[test]
fn bridges_are_as_short_as_they_are_tightened() {
    let text = coarse();
    let (before, rest) = text.split_once("length_m = 0.3\nhold = [").unwrap();
    let (_, after) = rest.split_once("]\n").unwrap();
    let tighten = "length_m = 0.3\nhold = [{ time_s = 6.57, end = \"tail\", at_m = [-0.0128, -0.0091, 0.0064] }]\n\
                   tighten = [{ time_s = 6.7, until_s = 8.7, ratio = 0.4 }]\n";
    let directory = tempfile::tempdir().unwrap();
    let whole = [before, tighten, after].concat();
    let wound_at = |at_s: &str| solve(directory.path(), &whole, &["--at", at_s])["wound"].clone();
    let half_way = wound_at("7.7");
    assert!(
        (number(&half_way, "bridge_ratio") - 0.7).abs() < 0.01,
        "{half_way}"
    );
    let done = wound_at("9.0");
    // Meanwhile the console pulls at the head, and thread comes to the last span as it is drawn out of that.
    assert!((number(&done, "bridge_ratio") - 0.4).abs() < 0.03, "{done}");
    let drawn = |wound: &Value| number(&wound["threads"][0], "drawn_m");
    assert!(drawn(&done) > drawn(&half_way) + 0.005, "{done}");
    let ends = done["threads"][0]["pulled_m"].as_array().unwrap();
    let at_ends: f64 = ends.iter().map(|end| end.as_f64().unwrap()).sum();
    let all_m = number(&done, "pulled_m");
    assert!((all_m - at_ends - drawn(&done)).abs() < 1e-12, "{done}");
    assert!(number(&done, "gap_ratio") < number(&half_way, "gap_ratio"));
    assert!(number(&done, "gap_ratio") < 0.6, "{done}");
}

/// Two knots pull at one slab: both threads have their tension, and the console's hand feels its own alone.
#[test]
fn two_threads_pull_at_one_slab() {
    let ran = sutura(&[
        "run",
        "scenes/two-threads.toml",
        "--lockstep",
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    assert_eq!(summary["decays"], 0);
    assert_eq!(summary["scene"]["punctures"], 4);
    for (thread, by) in [(0, 0), (1, 1)] {
        let thread = &summary["scene"]["threads"][thread];
        assert_eq!(thread["held_by"], serde_json::json!([null, by]));
        assert!(
            (0.1..0.6).contains(&number(thread, "peak_tension_n")),
            "{thread}"
        );
        assert_eq!(thread["state"], "slack", "{thread}");
    }
    let peak = number(&summary["force_n"], "peak");
    assert!((0.2..1.0).contains(&peak), "{peak} N");
}

/// What the console feels at most of a scene in lockstep \[N\], in which no step was withheld.
fn peak_n(text: &str) -> f64 {
    let directory = tempfile::tempdir().unwrap();
    let summary = run(directory.path(), text);
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    assert_eq!(summary["decays"], 0);
    number(&summary["force_n"], "peak")
}

/// A shaft that lifts a span feels the tension times the turn; without the section the thread goes through it.
#[test]
fn a_shaft_lifts_a_thread() {
    let path = root().join("scenes/thread-over-shaft.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let section = "[[body_contact]]\nbetween = [{ thread = 0 }, { tool = 0 }]\n";
    assert!(text.contains(section));
    let peaks = [text.clone(), text.replace(section, "")].map(|text| peak_n(&text));
    assert!((0.4..0.7).contains(&peaks[0]), "{peaks:?}");
    assert!(peaks[1] < 0.1 * peaks[0], "{peaks:?}");
}

/// A shaft laid on another one feels the spring that the hand and the pair are in a row, and friction across it; without the section it
/// goes through.
#[test]
fn a_shaft_is_drawn_along_another_one() {
    let path = root().join("scenes/shaft-on-shaft.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let (before, after) = text.split_once("[[body_contact]]").unwrap();
    let (_, after) = after.split_once("friction = 0.2\n").unwrap();
    let smooth = text.replace("friction = 0.2", "friction = 0.0");
    let peaks = [text.clone(), smooth, [before, after].concat()].map(|text| peak_n(&text));
    // 1.5 mm on two springs of 1000 N/m in a row; the console's own friction takes 0.15 N at most.
    assert!((0.6..0.76).contains(&peaks[1]), "{peaks:?}");
    // Friction adds its fifth across.
    let more = peaks[0] / peaks[1];
    assert!((1.005..1.06).contains(&more), "{peaks:?}");
    assert_eq!(peaks[2], 0.0, "{peaks:?}");
}

/// A needle that was let go in a slab is pushed over, and felt; without the section the shaft goes through it.
#[test]
fn a_needle_that_was_let_go_is_pushed() {
    let path = root().join("scenes/needle-pushed.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let section = "[[body_contact]]\nbetween = [{ needle = 0 }, { tool = 0 }]\n";
    assert!(text.contains(section));
    let peaks = [text.clone(), text.replace(section, "")].map(|text| peak_n(&text));
    assert!((0.3..0.45).contains(&peaks[0]), "{peaks:?}");
    assert_eq!(peaks[1], 0.0, "{peaks:?}");
}

/// What hands that tighten draw out of two tubes depends on friction along the thread, and closes them bite by bite.
#[test]
fn an_anastomosis_is_drawn_together_bite_by_bite() {
    let text = std::fs::read_to_string(root().join("scenes/anastomosis-50-tighten.toml")).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let drawn = |friction: &str| {
        let other = text.replace("\nfriction = 0.1\n", &format!("\nfriction = {friction}\n"));
        let summary = run(directory.path(), &other);
        assert_eq!(
            summary["steps_withheld"],
            serde_json::json!({}),
            "{friction}"
        );
        let scene = &summary["scene"];
        assert!(number(scene, "gap_ratio") < 0.2, "{scene}");
        assert!(number(scene, "bridge_ratio") < 0.2, "{scene}");
        let thread = &scene["threads"][0];
        let over_m = number(thread, "length_m") - number(thread, "available_m");
        assert!(over_m < 1e-6, "{thread}");
        assert!(number(thread, "drawn_m") > 0.1, "{thread}");
        let spent = number(thread, "dissipated_j");
        (summary["trace_hash"].clone(), spent)
    };
    let [without, some, more] = ["0.0", "0.1", "1.0"].map(drawn);
    assert_eq!(without.1, 0.0);
    assert!(0.0 < some.1 && some.1 < more.1, "{some:?} {more:?}");
    assert!(without.0 != some.0 && some.0 != more.0 && without.0 != more.0);
}

/// The same with a thread that hardly slides, and with one that drags: tensions before most passages are next to nothing, and what sticks and what
/// slides is found all the same.
#[test]
fn an_anastomosis_is_drawn_together_by_a_thread_that_locks() {
    let text = std::fs::read_to_string(root().join("scenes/anastomosis-50-tighten.toml")).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let more: &[&str] = match full() {
        true => &[
            "1.5",
            "2.0",
            "3.0",
            "0.1\ndrag_n_per_m = 1.0",
            "0.3\ndrag_n_per_m = 1.0",
        ],
        false => &[],
    };
    for friction in [&["5.0"], more].concat() {
        let other = text.replace("\nfriction = 0.1\n", &format!("\nfriction = {friction}\n"));
        assert_ne!(text, other);
        let summary = run(directory.path(), &other);
        let withheld = summary["steps_withheld"].as_object().unwrap();
        let withheld: u64 = withheld.values().map(|steps| steps.as_u64().unwrap()).sum();
        let steps = summary["contact_steps"].as_u64().unwrap();
        println!("{friction}: {withheld} of {steps} steps withheld");
        assert!(
            steps > 700 && 100 * withheld < steps,
            "{friction}: {withheld} {steps}"
        );
        assert_eq!(summary["decays"], 0, "{friction}");
        assert!(number(&summary["scene"], "gap_ratio") < 0.2, "{friction}");
    }
}

/// Nothing of a thread is reported or sent where there is none.
#[test]
fn a_scene_without_a_thread_has_nothing_of_it() {
    let text = coarse();
    let (before, rest) = text.split_once("# Frictionless, and held").unwrap();
    let (_, after) = rest.split_once("# The console's own.").unwrap();
    let directory = tempfile::tempdir().unwrap();
    let summary = run(directory.path(), &[before, "# ", after].concat());
    let scene = summary["scene"].as_object().unwrap();
    for key in ["threads", "gap_ratio", "tension_n", "stress_peak_pa"] {
        assert!(!scene.contains_key(key), "{key}");
    }
}

/// A console whose line is tapped on the way down.
struct Tapped {
    console: NativeConsole,
    down: Accumulator,
    up: Accumulator,
    contacts: Vec<(u64, Contact)>,
    threads: Vec<(u64, Thread)>,
    /// Of each tick.
    states: Arc<Mutex<Vec<Tick>>>,
}

/// A tick: console time \[us\], and what the console says of it.
struct Tick {
    us: u64,
    state: State,
}

fn norm(vector: [f32; 3]) -> f64 {
    let square: f32 = vector.iter().map(|axis| axis * axis).sum();
    f64::from(square.sqrt())
}

impl Tapped {
    fn new(plan: &Plan) -> Self {
        Self {
            console: NativeConsole::new(&plan.device).unwrap(),
            down: Accumulator::new(),
            up: Accumulator::new(),
            contacts: Vec::new(),
            threads: Vec::new(),
            states: Arc::default(),
        }
    }
}

impl LockstepConsole for Tapped {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        for byte in down {
            let packet = self.down.push(*byte);
            let message = packet.map(|packet| packet.and_then(|packet| decode(packet)?.unpack()));
            match message {
                Some(Ok(Unchecked::Contact(header, body))) => {
                    self.contacts.push((header.console_time_us, body));
                }
                Some(Ok(Unchecked::Thread(header, body))) => {
                    self.threads.push((header.console_time_us, body));
                }
                _ => {}
            }
        }
        let before = up.len();
        self.console.exchange(down, up)?;
        for byte in &up[before..] {
            let packet = self.up.push(*byte);
            let message = packet.map(|packet| packet.and_then(|packet| decode(packet)?.unpack()));
            if let Some(Ok(Unchecked::State(header, body))) = message {
                self.states.lock().unwrap().push(Tick {
                    us: header.console_time_us,
                    state: body,
                });
            }
        }
        Ok(())
    }

    fn name(&self) -> &str {
        self.console.name()
    }
}

fn plan(scene: &Scene) -> Plan {
    Plan {
        device: scene.device.unwrap().description,
        hand: scene.hand.unwrap(),
        host_hz: scene.host.host_hz,
        seconds: scene.seconds,
        tick_hz: 1000,
        state_every: 1,
        horizon_us: scene.host.horizon_us,
        clear_fault: false,
        fixture: sutura_shared::wire::message::Fixture::None,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
    }
}

/// What the console is told of the thread at its needle: first how much of it is left, then how it pulls.
#[test]
fn the_console_is_told_how_the_thread_pulls() {
    let document = Document::embedded("wound.toml", Path::new(""), &coarse());
    let scene = Scene::read(&document, "wound").unwrap();
    let mut solver = SceneSolver::new(&scene).unwrap();
    let plan = plan(&scene);
    let mut tapped = Tapped::new(&plan);
    let summary = run_lockstep(&mut tapped, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(summary.unwrap().status, "ok");
    // From when on the console holds the needle.
    let began_us = tapped.contacts[0].0;
    let held_us = scene.needles[0].holds.last().unwrap().time_s * 1e6;
    let first_us = tapped.threads[0].0 - began_us;
    assert!((first_us as f64 - held_us).abs() <= 5000.0, "{first_us}");
    let mut taut = 0;
    for (time_us, thread) in &tapped.threads {
        assert_eq!((thread.tool, thread.thread, thread.end), (0, 0, End::Head));
        let contact = tapped.contacts.iter().find(|(t, _)| t == time_us);
        let (_, contact) = contact.expect("with each thread");
        if thread.state == Tension::Slack {
            assert_eq!(thread.tension_n, 0.0);
            continue;
        }
        taut += 1;
        // Only the thread pulls at a needle that is out of the tissue.
        for axis in 0..3 {
            let pull = thread.tension_n * thread.direction[axis];
            let felt = contact.wrench[axis];
            assert!(
                (pull - felt).abs() < 1e-4 + 1e-4 * pull.abs(),
                "{pull} N, {felt} N"
            );
        }
        assert!(thread.stiffness_n_per_m > 0.0, "{thread:?}");
    }
    assert!(taut > 100, "{taut} of {}", tapped.threads.len());
    assert!(tapped.contacts.len() > tapped.threads.len() + 500);
}

/// A solver that keeps what it was asked, and from when on its thread bent over tissue.
struct Asked {
    solver: SceneSolver,
    states: Vec<Valid<State>>,
    bent: Option<usize>,
}

impl Solve for Asked {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        self.states.push(*state);
        let solved = self.solver.solve(state);
        // A look at all of the thread takes longer than a solve.
        if self.bent.is_none() && self.states.len().is_multiple_of(20) {
            let (model, state, _) = self.solver.parts().unwrap();
            let path = state.thread_path(model, 0, &state.positions(model));
            let bends = path.iter().any(|point| point.what == ThreadPlace::Wraps);
            self.bent = bends.then_some(self.states.len());
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, Value> {
        self.solver.scene()
    }
}

/// From a copy of its state all goes on as from the state itself, what is looked at ahead included.
#[test]
fn a_copy_of_a_bent_thread_goes_on_with_the_same_bits() {
    let document = Document::embedded("wound.toml", Path::new(""), &coarse());
    let scene = Scene::read(&document, "wound").unwrap();
    let plan = plan(&scene);
    let mut asked = Asked {
        solver: SceneSolver::for_session(&scene, &plan).unwrap(),
        states: Vec::new(),
        bent: None,
    };
    let mut console = NativeConsole::new(&plan.device).unwrap();
    run_lockstep(&mut console, &plan, &mut asked, |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    let (before, rest) = asked
        .states
        .split_at(asked.bent.expect("a thread that bends"));
    assert!(rest.len() > 100, "{}", rest.len());
    // The bits of a step also depend on what was solved before: two solvers that have solved the same.
    let mut two = [(); 2].map(|()| SceneSolver::for_session(&scene, &plan).unwrap());
    for state in before {
        for solver in &mut two {
            solver.solve(state);
        }
    }
    let [original, copy] = &mut two;
    copy.go_on_from(&original.moment().unwrap());
    for (step, state) in rest[..100].iter().enumerate() {
        let [first, second] = [&mut *original, &mut *copy].map(|solver| {
            let solved = solver.solve(state);
            let bits = |contact: ToolContact| contact.wrench.map(f64::to_bits);
            let thread = solved.thread.map(|thread| thread.tension_n.to_bits());
            (
                solver.hash(),
                solved.contact.map(bits),
                thread,
                solved.looked,
            )
        });
        assert_eq!(first, second, "step {step}");
    }
}

#[test]
fn a_wound_is_explained() {
    let ran = sutura(&[
        "scene",
        "explain",
        "scenes/wound-slabs.toml",
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object: Value = serde_json::from_str(&ran.stdout).unwrap();
    let parts = object["components"].as_array().unwrap();
    let part = |name: &str| {
        let found = parts.iter().find(|part| part["name"] == name);
        found.unwrap_or_else(|| panic!("no {name} in {object:#}"))
    };
    for (name, words) in [
        ("thread 0", "through 16 boundaries"),
        ("contact of left and right", "pairs of features press"),
        ("displacement of all nodes", "where threads bend"),
    ] {
        let part = part(name);
        assert_eq!(part["built"], true, "{part}");
        assert!(part["why"].as_str().unwrap().contains(words), "{part}");
    }
}

#[test]
fn slips_are_told_at_their_place() {
    let directory = tempfile::tempdir().unwrap();
    for (from, to, message, help) in [
        (
            "needle = 0\nlength_m",
            "needle = 1\nlength_m",
            "there is no needle 1",
            "this scene's needles are [0]",
        ),
        (
            "between = [\"left\", \"right\"]",
            "between = [\"left\", \"rihgt\"]",
            "the mesh has no region \"rihgt\"",
            "did you mean \"right\"?",
        ),
        (
            "end = \"tail\", tool = 2",
            "end = \"tail\", tool = 7",
            "there is no tool 7",
            "this scene's tools are [0, 1, 2]",
        ),
    ] {
        let text = coarse();
        assert!(text.contains(from), "{from}");
        std::fs::write(
            directory.path().join("slip.toml"),
            text.replacen(from, to, 1),
        )
        .unwrap();
        let ran = sutura_in(directory.path(), &["scene", "check", "slip.toml"]);
        assert_eq!(ran.code, 2, "{to}: {}", ran.stderr);
        let told = ran.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        for words in [message, help, "slip.toml:"] {
            assert!(told.contains(words), "{to}: no {words:?} in {}", ran.stderr);
        }
    }
}

/// The console's grip 9 cm away from the needle takes nothing, the run says where to bring it, and the check that its script does
/// not; the tail is taken.
#[test]
fn a_console_9_cm_away_holds_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let far = "position_m = [0.0979756, 0.0094000, 0.0013755]";
    let text = coarse();
    let (near, end) = (
        "position_m = [0.0079756, 0.0094000, 0.0013755]",
        "position_m = [0.0211756, 0.0094000, 0.0189755]",
    );
    assert_eq!(
        (text.matches(near).count(), text.matches(end).count()),
        (2, 1)
    );
    let text = text.replace(near, far).replace(end, far);
    let path = directory.path().join("far.toml");
    std::fs::write(&path, text).unwrap();
    let ran = sutura_in(
        directory.path(),
        &["run", "far.toml", "--lockstep", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
    let scene = &summary["scene"];
    assert_eq!(scene["needles"][0]["held_by"], 1, "{scene}");
    assert_eq!(scene["threads"][0]["held_by"], serde_json::json!([2, 1]));
    let events = scene["events"].as_array().unwrap();
    let [missed] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(
        (&missed["event"], &missed["tool"], &missed["needle"]),
        (&"missed".into(), &0.into(), &0.into())
    );
    assert!(
        (number(missed, "distance_m") - 0.09).abs() < 5e-4,
        "{missed}"
    );
    assert!((number(missed, "time_s") - 6.57).abs() < 0.01, "{missed}");
    let said = "tool 0 was to take needle 0, 90.0 mm away: bring its grip to (8.0, 9.4, ";
    assert!(ran.stderr.contains(said), "{}", ran.stderr);

    let checked = sutura_in(directory.path(), &["scene", "check", "far.toml"]);
    assert_eq!(checked.code, 0, "{}", checked.stderr);
    assert!(
        checked.stderr.contains("out of reach"),
        "{}",
        checked.stderr
    );
}

/// Between its needle's tool and a place that are farther apart than it is long a thread breaks at once; the check says so before.
#[test]
fn a_thread_that_is_too_short_is_told_of() {
    let directory = tempfile::tempdir().unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/thread-over-shaft.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let long = "length_m = 0.0808\n";
    assert_eq!(text.matches(long).count(), 1);
    // It stretches by four sevenths before it breaks, and is held 51 mm from its needle at first.
    for (short, breaks) in [("length_m = 0.04\n", false), ("length_m = 0.03\n", true)] {
        let said = text.replace(long, short);
        std::fs::write(directory.path().join("short.toml"), &said).unwrap();
        let checked = sutura_in(directory.path(), &["scene", "check", "short.toml"]);
        assert_eq!(checked.code, 0, "{}", checked.stderr);
        // Once the needle is through.
        let warned = "mm long, and its ends are held 64.6 mm from each other at 3.20 s";
        assert!(checked.stderr.contains(warned), "{}", checked.stderr);
        let arguments = [
            "run",
            "short.toml",
            "--lockstep",
            "--seconds",
            "0.3",
            "--format",
            "json",
        ];
        let ran = sutura_in(directory.path(), &arguments);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
        let events = summary["scene"]["events"].as_array().unwrap();
        let broke = events.iter().any(|event| event["event"] == "broke");
        assert_eq!(broke, breaks, "{events:?}");

        // What is cut before is not held by both ends then: one is too short from the start, the other one would be later.
        let cut = "\n[[thread.cut]]\ntime_s = 1.0\nat_m = [0.0, 0.0, 0.05]\n";
        let text = said.replacen("\n[[body_contact]]", &format!("{cut}\n[[body_contact]]"), 1);
        assert_eq!(text.matches("[[thread.cut]]").count(), 1);
        std::fs::write(directory.path().join("cut.toml"), text).unwrap();
        let checked = sutura_in(directory.path(), &["scene", "check", "cut.toml"]);
        assert_eq!(checked.code, 0, "{}", checked.stderr);
        let warns = checked.stderr.contains("mm long, and its ends are held");
        assert_eq!(warns, breaks, "{}", checked.stderr);
    }
}

/// A thread in weak grips slips through them: the session tells it in one event an end and time, which add up to what has slipped.
#[test]
fn what_slips_in_a_session_is_told() {
    let directory = tempfile::tempdir().unwrap();
    let text = coarse().replace("length_m = 0.3\n", "length_m = 0.3\ngrip_n = 0.03\n");
    let summary = run(directory.path(), &text);
    assert_eq!(summary["status"], "ok");
    let scene = &summary["scene"];
    let thread = &scene["threads"][0];
    let slipped = thread["slipped_m"][0].as_f64().unwrap();
    assert!(slipped > 1e-3, "{thread}");
    let events = scene["events"].as_array().unwrap();
    assert!(!events.is_empty() && events.len() < 256, "{}", events.len());
    let mut told = 0.0;
    for event in events {
        assert_eq!(
            (
                &event["event"],
                &event["thread"],
                &event["end"],
                &event["tool"]
            ),
            (&"slipped".into(), &0.into(), &"tail".into(), &2.into())
        );
        assert!(number(event, "time_s") > 6.57, "{event}");
        assert!(
            number(event, "until_s") >= number(event, "time_s"),
            "{event}"
        );
        told += number(event, "length_m");
    }
    assert!((told - slipped).abs() < 1e-12, "{told} {slipped}");
}

/// A straight thread through a slab, its tail held: 200 N over 40 mm are 5 kN/m.
const LOCKED: &str = r#"
name = "A locked thread"
seconds = 6.0
device = "cartesian-bench"

[mesh.slab]
size_m = [0.03, 0.03, 0.02]
divisions = [7, 7, 5]

[tissue]
youngs_modulus_pa = 20e3
poisson_ratio = 0.4

[tissue.needle]
friction_n_per_m = 0.0
puncture_pa = 1e5

[[fixed]]
plane = { axis = "x", at_m = -0.015 }

[[fixed]]
plane = { axis = "x", at_m = 0.015 }

[[needle]]
shape = "straight"
length_m = 0.02
thickness_m = 0.0008
end_m = [0.0013, 0.0007, 0.022]
direction = [0.0, 0.0, -1.0]
hold = [{ time_s = 0.0, tool = 0 }]

[[thread]]
needle = 0
length_m = 0.2
axial_stiffness_n = 200.0
hold = [{ time_s = 3.0, end = "tail", tool = 1 }]

[[tool]]
id = 0
shape = "grip"

[[tool]]
id = 1
shape = "grip"
reach_m = 0.02
position_m = [0.0013, 0.0007, 0.01]

[hand]
stiffness_n_per_m = 800.0
damping_n_s_per_m = 4.0
way_point = [
  { time_s = 0.0, position_m = [0.0013, 0.0007, 0.022] },
  { time_s = 2.8, position_m = [0.0013, 0.0007, -0.03] },
  { time_s = 3.2, position_m = [0.0013, 0.0007, -0.03] },
  { time_s = 3.6, position_m = [0.0013, 0.0007, -0.034] },
  { time_s = 4.0, position_m = [0.0013, 0.0007, -0.034] },
  { time_s = 4.1, position_m = [0.0013, 0.0007, -0.03] },
  { time_s = 4.2, position_m = [0.0013, 0.0007, -0.034] },
  { time_s = 4.3, position_m = [0.0013, 0.0007, -0.03] },
  { time_s = 4.4, position_m = [0.0013, 0.0007, -0.034] },
  { time_s = 6.0, position_m = [0.0013, 0.0007, -0.034] },
]

[host]
host_hz = 200.0
horizon_ms = 60.0
"#;

/// A hand that pulls and shakes a thread that locks gets no energy out of the console, whatever the host's rate, and feels its tension.
#[test]
fn a_locked_thread_gives_no_energy() {
    let directory = tempfile::tempdir().unwrap();
    for host_hz in ["60.0", "200.0", "1000.0"] {
        let text = LOCKED.replace("host_hz = 200.0", &format!("host_hz = {host_hz}"));
        let summary = run(directory.path(), &text);
        assert_eq!(summary["status"], "ok");
        assert_eq!(summary["faults"], serde_json::json!([]));
        let least_j = summary["energy_j"]["min"].as_f64().unwrap();
        let peak_n = summary["force_n"]["peak"].as_f64().unwrap();
        let thread = &summary["scene"]["threads"][0];
        let tension_n = number(thread, "peak_tension_n");
        println!("{host_hz} Hz: {least_j} J, {peak_n} N of {tension_n} N");
        assert!(least_j >= -1e-3, "{least_j}");
        assert!(tension_n > 2.5, "{thread}");
        assert!(
            (peak_n / tension_n - 1.0).abs() < 0.1,
            "{peak_n} {tension_n}"
        );
        assert_eq!(thread["state"], "taut");
    }
}

/// A shipped scene in lockstep.
fn shipped(name: &str) -> Value {
    let ran = sutura(&["run", name, "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

/// What the console feels at most beside the tension there: they are one where it draws hardest.
fn feels_the_tension(summary: &Value) {
    let felt = number(&summary["force_n"], "peak");
    let pulled = number(&summary["scene"]["threads"][0], "peak_tension_n");
    assert!(felt > 0.3, "{felt} N");
    assert!((felt / pulled - 1.0).abs() < 0.01, "{felt} {pulled} N");
}

/// Each stitch is drawn together by its knot, cut, and stays closed.
#[test]
fn interrupted_stitches_stay_closed() {
    let summary = shipped("scenes/wound-slabs-knots.toml");
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    let scene = &summary["scene"];
    // Stitches open a little as the next ones are drawn.
    assert!(number(scene, "bridge_ratio") < 0.12, "{scene}");
    // All four welded bring it to less than half; one of them would not.
    let gap = number(scene, "rim_gap_m") / number(scene, "gap_ratio");
    assert!(number(scene, "rim_gap_welded_m") < 0.5 * gap, "{scene}");
    let thread = &scene["threads"][0];
    let count = |key: &str| thread[key].as_u64().unwrap();
    assert_eq!((count("punctures"), count("bridges")), (16, 4), "{thread}");
    // The last one is cut too: nobody pulls any more, and every passage of every stitch is pressed on.
    assert_eq!(thread["tension_n"][1], 0.0, "{thread}");
    let pressures = thread["thread_pressure_pa"].as_array().unwrap();
    assert_eq!(pressures.len(), 8, "{thread}");
    assert!(pressures.iter().all(|one| one.as_f64().unwrap() > 1e5));
    let cuts: Vec<f64> = scene["events"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|event| event["event"] == "cut")
        .map(|event| number(event, "along_m"))
        .collect();
    assert_eq!(cuts.len(), 4, "{scene}");
    assert!(cuts.is_sorted(), "{cuts:?}");
    feels_the_tension(&summary);
}

/// A running suture that rubs is drawn together bite by bite: one hand pulls at the needle, another one keeps what is closed.
#[test]
fn a_running_suture_is_drawn_together_by_hand() {
    let summary = shipped("tests/data/wound-by-hand.toml");
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    let scene = &summary["scene"];
    assert_eq!(scene["events"], serde_json::json!([]), "{scene}");
    assert!(number(scene, "gap_ratio") < 0.25, "{scene}");
    let thread = &scene["threads"][0];
    assert_eq!(thread["punctures"], 16, "{thread}");
    // The place at the tail, and the console by the needle; the hand between the bites has let go.
    assert_eq!(thread["held_by"], serde_json::json!([null, 0]));
    assert!(thread["hands"].is_null(), "{thread}");
    let excess = number(thread, "length_m") - number(thread, "available_m");
    assert!(excess.abs() < 1e-6, "{excess} m");
    assert!(number(thread, "dissipated_j") > 1e-4, "{thread}");
    // Friction keeps what was drawn together: the tail has less than the console, and not nothing.
    let tension = |end: usize| thread["tension_n"][end].as_f64().unwrap();
    assert!(0.2 < tension(0) && tension(0) < tension(1), "{thread}");
    feels_the_tension(&summary);
}

/// Where a thread bends over tissue is found after a balance, and may leave none near it: the bends of before go on then. Without that no
/// step of this scene has a balance from 11.4 s on.
#[test]
fn new_bends_of_a_thread_do_not_stop_a_session() {
    let summary = shipped("tests/data/bridge-by-hand.toml");
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    let scene = &summary["scene"];
    assert_eq!(scene["events"], serde_json::json!([]), "{scene}");
    let thread = &scene["threads"][0];
    let tensions = thread["hands"].as_array().unwrap().iter();
    let tensions = tensions.map(|hand| hand["tension_n"][1].as_f64().unwrap());
    let most = tensions.fold(0.0, f64::max);
    assert!((0.5..3.0).contains(&most), "{thread}");
}

/// All that a scene does, turned about z: its tissue stays, so that what pierces it does so elsewhere in its mesh.
fn turned(text: &str, degrees: f64) -> String {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (tissue, hands) = text.split_once("[[needle]]").unwrap();
    let mut all = format!("{tissue}[[needle]]");
    let mut rest = hands;
    while let Some(at) = rest.find(" = [") {
        let (key, after) = rest.split_at(at + 4);
        all.push_str(key);
        rest = after;
        let is_vector = [
            "position_m",
            "end_m",
            "direction",
            "towards",
            "rotation_deg",
        ]
        .iter()
        .any(|name| key[..at].ends_with(name));
        if is_vector {
            let (vector, after) = rest.split_once(']').unwrap();
            let numbers: Vec<f64> = vector
                .split(',')
                .map(|x| x.trim().parse().unwrap())
                .collect();
            let [x, y, z] = numbers[..] else {
                panic!("{vector}")
            };
            let turned = [cos * x - sin * y, sin * x + cos * y, z].map(|x| format!("{x:.7}"));
            all.push_str(&turned.join(", "));
            all.push(']');
            rest = after;
        }
    }
    all + rest
}

/// A solver beside which another one goes from where it was after a solve on to the next one's state in a step a tick, over these times of
/// the console \[us\].
struct TickByTick {
    solver: SceneSolver,
    other: SceneSolver,
    over_us: Vec<Range<u64>>,
    ticks: Arc<Mutex<Vec<Tick>>>,
    /// After the solve before, and the ticks until then.
    before: Option<(Moment, usize)>,
    /// Force on the console's grip and tension there, as that other solver has it, of each of these ticks \[N\].
    felt: Vec<[f64; 2]>,
}

impl TickByTick {
    fn follow(&mut self, moment: &Moment, from: usize) {
        self.other.go_on_from(moment);
        let id = self.other.driven().unwrap();
        for tick in &self.ticks.lock().unwrap()[from..] {
            let report = self.other.step(ToolSample {
                id,
                position_m: tick.state.position_m.map(f64::from),
                orientation: tick.state.orientation.map(f64::from),
                velocity_m_per_s: tick.state.velocity_m_per_s.map(f64::from),
                console_time_us: tick.us,
            });
            assert_eq!(report.status, Status::Ok, "{} us", tick.us);
            let mut hands = report.hands().iter();
            let hand = hands.find(|hand| hand.tool == Some(id)).unwrap();
            let tension_n = hand.tension_n[0].max(hand.tension_n[1]);
            self.felt.push([norm(tick.state.force_n), tension_n]);
        }
    }
}

impl Solve for TickByTick {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        if let Some((moment, from)) = self.before.take() {
            self.follow(&moment, from);
        }
        let solved = self.solver.solve(state);
        let now_us = state.console_time_us();
        if self.over_us.iter().any(|time| time.contains(&now_us)) {
            let ticks = self.ticks.lock().unwrap().len();
            self.before = Some((self.solver.moment().unwrap(), ticks));
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, Value> {
        self.solver.scene()
    }
}

/// 20 punctures of a thread that rubs are closed: nothing was withheld but for what was not computed yet, each bridge is within 5 %, and the
/// length is kept.
fn all_are_closed(summary: &Value) {
    assert_eq!(summary["status"], "ok");
    let withheld = summary["steps_withheld"].as_object().unwrap();
    assert!(withheld.keys().all(|why| why == "waiting"), "{withheld:?}");
    let scene = &summary["scene"];
    assert_eq!(scene["events"], serde_json::json!([]), "{scene}");
    let thread = &scene["threads"][0];
    assert_eq!(thread["punctures"], 20, "{thread}");
    let bridging = thread["bridging"].as_array().unwrap();
    assert_eq!(bridging.len(), 5, "{thread}");
    assert!(
        bridging.iter().all(|one| number(one, "ratio") <= 0.05),
        "{thread}"
    );
    let excess = number(thread, "length_m") - number(thread, "available_m");
    assert!(excess.abs() < 1e-6, "{excess} m");
    // The hand in between has let go, the console's has not.
    let hands = thread["hands"].as_array().unwrap();
    assert_eq!(
        (hands.len(), &hands[0]["held_by"]),
        (1, &Value::from(0)),
        "{thread}"
    );
}

fn by_hand(degrees: f64) -> String {
    let path = root().join("scenes/anastomosis-20-by-hand.toml");
    turned(&std::fs::read_to_string(path).unwrap(), degrees)
}

/// The same hands close it on tissue that turns with its edges, wherever in the mesh: `SUTURA_FULL=1`, for more than a minute each.
#[test]
fn a_suture_that_rubs_is_closed_on_corotational_tissue() {
    if !full() {
        return;
    }
    for degrees in [200.0, 0.0, 3.0, 6.0, 17.0, 90.0] {
        let linear = "model = \"linear\"";
        let text = by_hand(degrees);
        assert_eq!(text.matches(linear).count(), 1);
        let directory = tempfile::tempdir().unwrap();
        let text = text.replace(linear, "model = \"corotational\"");
        let summary = run(directory.path(), &text);
        println!(
            "{degrees} degrees: {}",
            summary["scene"]["threads"][0]["bridging"]
        );
        all_are_closed(&summary);
    }
}

/// Errors of what the console feels while it draws, of the tension at its grip, [`TickByTick`]: of each tick, and the peak of what is felt \[N\].
fn felt_by_hand(scene: &Scene, draws_s: &[[f64; 2]]) -> (Vec<f64>, f64) {
    const PULLS_N: f64 = 0.3;
    let plan = plan(scene);
    let mut tapped = Tapped::new(&plan);
    let [solver, other] = [(); 2].map(|()| SceneSolver::for_session(scene, &plan).unwrap());
    let us = |s: f64| (1e6 * s) as u64;
    let over_us = draws_s.iter().map(|[from, to]| us(*from)..us(*to));
    let mut solver = TickByTick {
        solver,
        other,
        over_us: over_us.collect(),
        ticks: tapped.states.clone(),
        before: None,
        felt: Vec::new(),
    };
    let summary = run_lockstep(&mut tapped, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    });
    let summary = serde_json::to_value(summary.unwrap()).unwrap();
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    all_are_closed(&summary);

    let pulls = solver
        .felt
        .iter()
        .filter(|[_, tension_n]| *tension_n > PULLS_N);
    let peak_n = pulls
        .clone()
        .fold(0.0_f64, |most, [felt_n, _]| most.max(*felt_n));
    let errors = pulls.map(|[felt_n, tension_n]| (felt_n / tension_n - 1.0).abs());
    (errors.collect(), peak_n)
}

/// The median of errors, p99 and the worst.
fn spread(mut errors: Vec<f64>) -> [f64; 3] {
    errors.sort_by(f64::total_cmp);
    let of = |share: f64| errors[((share * errors.len() as f64) as usize).min(errors.len() - 1)];
    [0.5, 0.99, 1.0].map(of)
}

/// Twenty punctures of a thread that rubs are drawn together span by span, wherever they are in the mesh: every bite closes, though a pull
/// at the ends would close the last ones alone, the length is kept, and while the console pulls it feels the tension at its grip.
#[test]
fn a_suture_that_rubs_is_closed_span_by_span() {
    // The console draws twice. Where a stretch begins to slide, or tubes to press, the slope changes within a frame. At 125 frames a second a rim
    // slips over a corner of the other one in one of these twelve draws: then tensions fall by a tenth within 30 ms.
    let all_turns = &[0.0, 3.0, 6.0, 17.0, 90.0, 200.0][..];
    let (cases, draws_s) = match full() {
        true => (
            [(250, all_turns), (500, all_turns), (125, all_turns)].to_vec(),
            &[[23.0, 27.96], [33.65, 38.61]][..],
        ),
        false => (
            [(250, &[90.0][..]), (500, &[17.0])].to_vec(),
            &[[23.0, 27.96]][..],
        ),
    };
    for (rate_hz, degrees) in cases {
        let mut all = Vec::new();
        for degrees in degrees {
            let rate = "host_hz = 250.0";
            let text = by_hand(*degrees);
            assert_eq!(text.matches(rate).count(), 1);
            let text = text.replace(rate, &format!("host_hz = {rate_hz}.0"));
            let document = Document::embedded("by-hand.toml", Path::new(""), &text);
            let scene = Scene::read(&document, "by-hand").unwrap();
            let (errors, peak_n) = felt_by_hand(&scene, draws_s);
            let ticks = errors.len();
            assert!(ticks > 1000 && peak_n > 1.0, "{ticks} {peak_n} N");
            all.extend_from_slice(&errors);
            let [p50, p99, worst] = spread(errors);
            println!(
                "{rate_hz} Hz, {degrees} degrees: {ticks} ticks, up to {peak_n} N, off by {p50:.4}, {p99:.4}, {worst:.4}"
            );
        }
        let [p50, p99, worst] = spread(all);
        println!("{rate_hz} Hz: {p50:.4}, {p99:.4}, {worst:.4}");
        // As shipped it is 1 % in every tick. At 500 a rim slips over a corner, too, by less.
        let most = match rate_hz {
            125 => 0.11,
            250 => 0.01,
            _ => 0.0105,
        };
        assert!(
            p50 < 0.0015 && p99 < 0.0085 && worst < most,
            "{p50} {p99} {worst}"
        );
    }
}
