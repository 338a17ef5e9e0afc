//! Every key of a scene that changes a force: sessions, single steps and solves without a console feel the same. The table
//! `tests/data/scene-keys.toml` says what each key is tried with; `python/tests/test_keys.py` tries the same from Python.

use nalgebra::Vector3;
use serde_json::Value as Json;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::PathBuf;
use sutura_host::link::{LinkError, LockstepConsole};
use sutura_host::scene::{Document, Scene, read, schema};
use sutura_host::session::{LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, run_lockstep};
use sutura_host::solve::solve;
use sutura_host::step::Status;
use sutura_host::tool::ToolSample;
use sutura_shared::simulated_console::SimulatedConsole;
use sutura_shared::wire::message::Fixture;
use toml::{Table, Value};

/// Relative difference of two answers, unless a case says another one.
const TOLERANCE: f64 = 1e-3;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data")
}

fn table() -> Table {
    let text = std::fs::read_to_string(folder().join("scene-keys.toml")).expect("the table");
    text.parse().expect("TOML")
}

fn text_of(value: &Value) -> &str {
    value.as_str().expect("text")
}

fn list<'a>(of: &'a Table, key: &str) -> &'a [Value] {
    of[key].as_array().expect("a list")
}

/// Keys that have no keys below them, into `keys`; whether `node` has any.
fn leaves(schema: &Json, node: &Json, path: &str, keys: &mut BTreeSet<String>) -> bool {
    let mut any = false;
    if let Some(name) = node["$ref"].as_str() {
        let name = name.rsplit('/').next().unwrap_or_default();
        any |= leaves(schema, &schema["$defs"][name], path, keys);
    }
    for choice in ["anyOf", "oneOf", "allOf"] {
        for node in node[choice].as_array().into_iter().flatten() {
            any |= leaves(schema, node, path, keys);
        }
    }
    if node["items"].is_object() {
        any |= leaves(schema, &node["items"], &format!("{path}[]"), keys);
    }
    for (key, node) in node["properties"].as_object().into_iter().flatten() {
        let path = format!("{path}.{key}").trim_start_matches('.').to_owned();
        any = true;
        if !leaves(schema, node, &path, keys) {
            keys.insert(path);
        }
    }
    any
}

#[test]
fn every_key_of_the_schema_is_in_the_table() {
    let (table, schema) = (table(), schema());
    let mut keys = BTreeSet::new();
    leaves(&schema, &schema, "", &mut keys);
    assert!(keys.len() > 150, "{} keys", keys.len());
    let cases = list(&table, "case").iter();
    let tried = cases.flat_map(|case| list(case.as_table().expect("a case"), "keys"));
    let mut known: BTreeSet<String> = tried.map(|key| text_of(key).to_owned()).collect();
    for (key, why) in table["unfelt"].as_table().expect("a table") {
        assert!(!text_of(why).is_empty(), "{key}: why is it not tried?");
        assert!(known.insert(key.clone()), "{key} is in a case as well");
    }
    let missing: Vec<_> = keys.difference(&known).collect();
    assert!(
        missing.is_empty(),
        "{missing:?}: add a case to tests/data/scene-keys.toml, or a line to its [unfelt] that says why it changes no force"
    );
    let gone: Vec<_> = known.difference(&keys).collect();
    assert!(gone.is_empty(), "the schema has no {gone:?}");
}

/// Puts a value in the place of that at a path, whose numbers are places in lists.
fn put(scene: &mut Table, path: &str, value: &Value) {
    let keys: Vec<&str> = path.split('.').collect();
    let (last, way) = keys.split_last().expect("a key");
    let Some((first, way)) = way.split_first() else {
        scene.insert((*last).to_owned(), value.clone());
        return;
    };
    let mut at = scene.get_mut(*first).expect(path);
    for key in way {
        at = match key.parse::<usize>() {
            Ok(place) => &mut at[place],
            Err(_) => &mut at[*key],
        };
    }
    match (at, last.parse::<usize>()) {
        (Value::Array(list), Ok(place)) => list[place] = value.clone(),
        (Value::Table(table), _) => {
            table.insert((*last).to_owned(), value.clone());
        }
        _ => panic!("no {path}"),
    }
}

fn scene_of(text: &Table) -> Scene {
    let text = toml::to_string(text).expect("TOML");
    let document = Document::embedded("case.toml", &folder(), &text);
    read(&document).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

/// A tick for each exchange.
struct Console(SimulatedConsole);

impl LockstepConsole for Console {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.0.feed(down);
        self.0.tick(Default::default());
        self.0.drain(up);
        Ok(())
    }

    fn name(&self) -> &str {
        "simulated"
    }
}

/// Grip position at the solver's largest force, that force \[N\], and the largest rendered force \[N\].
struct Peak {
    position_m: [f64; 3],
    force_n: f64,
    felt_n: f64,
}

fn session(scene: &Scene) -> Peak {
    let plan = Plan {
        device: scene.device.as_ref().expect("a device").description,
        hand: scene.hand.expect("a hand"),
        host_hz: scene.host.host_hz,
        seconds: scene.seconds,
        tick_hz: 1000,
        state_every: 1,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
        horizon_us: None,
        clear_fault: false,
        fixture: Fixture::None,
    };
    let mut console = Console(SimulatedConsole::new(&plan.device, 0).expect("a console"));
    let mut solver = SceneSolver::for_session(scene, &plan).expect("a solver");
    let summary = run_lockstep(&mut console, &plan, &mut solver, |_| {
        ControlFlow::Continue(())
    });
    let summary = summary.expect("a session");
    let peak = &summary.scene["peak"];
    let number = |value: &Json| value.as_f64().expect("a number");
    Peak {
        position_m: [0, 1, 2].map(|axis: usize| number(&peak["position_m"][axis])),
        force_n: number(&peak["force_n"]),
        felt_n: summary.force_n.peak,
    }
}

/// The scene whose hand ends where the session's was at its peak, with the driven tool held there.
fn ending_at(scene: &Table, driven: u8, position_m: [f64; 3]) -> Table {
    let mut scene = scene.clone();
    let place = Value::Array(position_m.map(Value::Float).to_vec());
    let points = scene["hand"]["way_point"].as_array_mut().expect("a way");
    for point in points.iter_mut().rev().take(2) {
        let point = point.as_table_mut().expect("a point");
        point.insert("position_m".to_owned(), place.clone());
    }
    let tools = scene["tool"].as_array_mut().expect("tools");
    for (index, tool) in tools.iter_mut().enumerate() {
        let tool = tool.as_table_mut().expect("a tool");
        let id = tool.get("id").and_then(Value::as_integer);
        if id.unwrap_or(index as i64) == i64::from(driven) {
            tool.insert("position_m".to_owned(), place.clone());
        }
    }
    scene
}

/// Force of single steps along the hand's way, and some more at its end \[N\].
fn by_steps(scene: &Scene, driven: u8) -> f64 {
    let mut solver = SceneSolver::new(scene).expect("a solver");
    let hand = scene.hand.expect("a hand");
    let steps = (scene.seconds * scene.host.host_hz).round() as u32;
    let mut found = Vector3::zeros();
    for number in 0..=steps + 20 {
        let time_s = f64::from(number.min(steps)) / scene.host.host_hz;
        let sample = ToolSample {
            id: driven,
            position_m: sutura_host::scene::position_at(&hand, time_s),
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: (1e6 * f64::from(number) / scene.host.host_hz) as u64,
        };
        let mut report = solver.step(sample);
        for _ in 0..1000 {
            match report.status {
                Status::Waiting | Status::Behind => report = solver.step(sample),
                _ => break,
            }
        }
        assert_eq!(report.status, Status::Ok, "at {time_s} s");
        found = Vector3::from_column_slice(&report.contacts()[0].wrench[..3]);
    }
    found.norm()
}

/// Force of a solve without a console \[N\].
fn by_solve(scene: &Scene, driven: u8) -> f64 {
    let solution = solve(scene).expect("a rest");
    let mut tools = solution.tools.iter();
    let own = tools.find(|tool| tool.tool == driven).expect("the tool");
    Vector3::from(own.force_n).norm()
}

#[test]
fn sessions_steps_and_solves_feel_one_force() {
    let table = table();
    let bases = table["base"].as_table().expect("bases");
    let peaks: Vec<(&String, f64)> = bases
        .iter()
        .map(|(name, base)| {
            let scene = scene_of(base.as_table().expect("a scene"));
            (name, session(&scene).force_n)
        })
        .collect();
    let mut off = Vec::new();
    for case in list(&table, "case") {
        let case = case.as_table().expect("a case");
        let (name, base) = (text_of(&case["name"]), text_of(&case["base"]));
        let mut text = bases[base].as_table().expect("a scene").clone();
        for change in list(case, "set") {
            let change = change.as_array().expect("path and value");
            put(&mut text, text_of(&change[0]), &change[1]);
        }
        let scene = scene_of(&text);
        let driven = scene.driven().expect("a driven tool").id;
        let peak = session(&scene);
        let held = scene_of(&ending_at(&text, driven, peak.position_m));
        let [steps_n, solved_n] = [by_steps(&held, driven), by_solve(&held, driven)];
        let tolerance = case.get("tolerance").and_then(Value::as_float);
        let tolerance = tolerance.unwrap_or(TOLERANCE);
        let error = |force_n: f64| (force_n / peak.force_n - 1.0).abs();
        println!(
            "{name}: session {:.6} N, steps off by {:.1e}, solve by {:.1e}, rendered {:.3} N",
            peak.force_n,
            error(steps_n),
            error(solved_n),
            peak.felt_n
        );
        // Not a number where there is no force: that is off, too.
        let one = error(steps_n) <= tolerance && error(solved_n) <= tolerance;
        let is_felt = peak.force_n > 0.05 && peak.felt_n > 0.0;
        let (_, of_base) = peaks.iter().find(|(own, _)| *own == base).expect("a base");
        let differs = (peak.force_n / of_base - 1.0).abs() > 1e-6;
        let changes = differs || case.contains_key("as_base");
        if !(one && is_felt && changes) {
            off.push(format!(
                "{name}: session {} N, steps {steps_n} N, solve {solved_n} N, rendered {} N; base {of_base} N",
                peak.force_n, peak.felt_n
            ));
        }
    }
    assert!(off.is_empty(), "{off:#?}");
}
