//! `sutura scene` from the command line: good and bad scenes, their parts, and the schema of their files.

use crate::support::{Ran, root, sutura, sutura_in};
use serde_json::Value;
use std::path::Path;

fn json(ran: &Ran) -> Value {
    serde_json::from_str(&ran.stdout).unwrap_or_else(|_| panic!("{}{}", ran.stdout, ran.stderr))
}

/// Two tetrahedra of 1 m on one face, in the regions 5, called fat, and 6.
const MESH: &str = "\
$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 5 \"fat\"\n$EndPhysicalNames\n\
$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n$EndNodes\n\
$Elements\n2\n1 4 2 5 1 1 2 3 4\n77 4 2 6 1 2 3 4 5\n$EndElements\n";

const SCENE: &str = "\
[mesh]
file = \"mesh.msh\"
scale_to_m = 1.0

[tissue]
youngs_modulus_pa = 3000.0
poisson_ratio = 0.4

[[region]]
tag = \"fat\"
youngs_modulus_pa = 1000.0
poisson_ratio = 0.45

[[fixed]]
nodes = [0, 1, 2]
";

fn scene(directory: &Path, text: &str, command: &[&str]) -> Ran {
    std::fs::write(directory.join("mesh.msh"), MESH).expect("writable");
    std::fs::write(directory.join("scene.toml"), text).expect("writable");
    let words = [&["scene"], command, &["scene.toml", "--format", "json"]].concat();
    sutura_in(directory, &words)
}

#[test]
fn a_region_is_named_by_its_name_or_number_and_an_unknown_one_is_shown() {
    let directory = tempfile::tempdir().expect("a directory");
    let check = |text: &str| scene(directory.path(), text, &["check"]);
    for text in [SCENE.to_owned(), SCENE.replace("\"fat\"", "6")] {
        let ran = check(&text);
        assert_eq!(
            (ran.code, &json(&ran)["regions"]),
            (0, &1.into()),
            "{}",
            ran.stderr
        );
    }
    let ran = check(&SCENE.replace("\"fat\"", "\"fatt\""));
    assert_eq!((ran.code, &json(&ran)["status"]), (2, &"bad-input".into()));
    for words in [
        "the mesh has no region \"fatt\"",
        "scene.toml:10:7",
        "did you mean \"fat\"? The mesh has 5 or \"fat\" (1 cells), 6 (1 cells)",
    ] {
        assert!(ran.stderr.contains(words), "no {words} in:\n{}", ran.stderr);
    }
}

/// The model is built: three nodes on one line let the tissue turn.
#[test]
fn check_sees_what_only_the_solver_can() {
    let directory = tempfile::tempdir().expect("a directory");
    let ran = scene(
        directory.path(),
        &SCENE.replace("[0, 1, 2]", "[0, 1]"),
        &["check"],
    );
    assert_eq!(ran.code, 2);
    let object = json(&ran);
    let message = object["message"].as_str().expect("a message");
    assert!(message.contains("singular: 2 nodes are fixed"), "{message}");
}

#[test]
fn warnings_have_their_place_and_do_not_fail() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = format!("{SCENE}\n[[tool]]\nradius_m = 0.1\n");
    let ran = scene(directory.path(), &text, &["check"]);
    let object = json(&ran);
    assert_eq!((ran.code, &object["status"]), (0, &"ok".into()));
    let warning = &object["warnings"][0];
    assert_eq!(
        (&warning["line"], &warning["column"]),
        (&18.into(), &12.into()),
        "{object}"
    );
    assert!(ran.stderr.contains("measured error"), "{}", ran.stderr);
}

#[test]
fn every_shipped_scene_is_good_and_explains_itself() {
    for path in scenes() {
        let ran = sutura(&["scene", "check", &path, "--format", "json"]);
        assert_eq!(
            (ran.code, &json(&ran)["warnings"]),
            (0, &serde_json::json!([])),
            "{path}: {}",
            ran.stderr
        );
        let ran = sutura(&["scene", "explain", &path, "--format", "json"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let object = json(&ran);
        let parts = object["components"].as_array().expect("parts");
        for part in parts {
            for key in ["name", "built", "why", "rows", "bytes", "us"] {
                assert!(part.get(key).is_some(), "{path}: no {key} in {part}");
            }
            assert!(
                part["why"].as_str().is_some_and(|why| !why.is_empty()),
                "{part}"
            );
        }
        let names = |built: bool| {
            parts
                .iter()
                .filter(move |part| part["built"] == built)
                .count()
        };
        assert!(names(true) >= 4 && names(false) >= 4, "{path}: {object}");
    }
}

/// A tool on a slab that a hand presses into it within 0.6 s.
fn pressed(size_m: [f64; 3], divisions: [u32; 3], tool: &str, from_to_m: [f64; 2]) -> String {
    let [from_m, to_m] = from_to_m;
    format!(
        "device = \"cartesian-bench\"\nseconds = 0.6\n[mesh.slab]\nsize_m = {size_m:?}\ndivisions = {divisions:?}\n\
         [tissue]\nyoungs_modulus_pa = 3e3\npoisson_ratio = 0.45\n[[fixed]]\nplane = {{ axis = \"z\", at_m = {} }}\n\
         [[tool]]\n{tool}\n[hand]\nstiffness_n_per_m = 2000.0\ndamping_n_s_per_m = 10.0\n\
         way_point = [{{ time_s = 0.0, position_m = [0.0, 0.0, {from_m}] }}, {{ time_s = 0.2, position_m = [0.0, 0.0, {to_m}] }}]\n\
         [host]\nhost_hz = 100.0\n",
        -size_m[2]
    )
}

/// A session withholds the steps of the first scene, and check and explain refuse it before with the limit; the second is good.
fn is_refused_before_the_session([crowded, roomy]: [String; 2], limit: &str) {
    let folder = tempfile::tempdir().expect("a directory");
    let ran = |scene: &str, words: &[&str]| {
        std::fs::write(folder.path().join("pressed.toml"), scene).expect("writable");
        sutura_in(folder.path(), words)
    };
    let run = ran(&crowded, &["run", "pressed.toml", "--lockstep"]);
    assert_eq!(run.code, 8, "{}{}", run.stdout, run.stderr);
    assert!(run.stdout.contains("too-many-rows"), "{}", run.stdout);
    for words in ["check", "explain"] {
        let line = ["scene", words, "pressed.toml", "--format", "json"];
        let ran = ran(&crowded, &line);
        assert_eq!(ran.code, 2, "{words}: {}{}", ran.stdout, ran.stderr);
        let object = json(&ran);
        let message = object["message"].as_str().expect("a message");
        assert!(message.contains(limit), "{message}");
        let help = object["help"].as_str().expect("help");
        assert!(help.contains("a coarser mesh or a smaller tool"), "{help}");
    }
    let ran = ran(&roomy, &["scene", "check", "pressed.toml"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
}

/// A punch on a mesh that is far finer than it. A smaller one is good, though as many vertices are near it.
#[test]
fn too_fine_a_mesh_for_its_tool_is_refused_before_the_session() {
    let punches = [0.012, 0.006].map(|radius_m| {
        let tool = format!("shape = \"flat-punch\"\nradius_m = {radius_m}");
        pressed([0.03, 0.03, 0.01], [24, 24, 2], &tool, [0.002, -0.001])
    });
    is_refused_before_the_session(punches, "a step has room for 192 in contact");
}

/// A grip's bar that lies down on a mesh with more places under it than a body has room for, and a thinner one that has room.
#[test]
fn too_fine_a_mesh_for_a_body_is_refused_before_the_session() {
    let bars = [0.008, 0.002].map(|radius_m| {
        let tool = format!(
            "shape = \"grip\"\nbody = {{ radius_m = {radius_m}, length_m = 0.026, axis = [1.0, 0.0, 0.0], offset_m = [0.013, 0.0, 0.0] }}"
        );
        pressed([0.03, 0.03, 0.006], [14, 14, 2], &tool, [0.010, 0.0055])
    });
    is_refused_before_the_session(bars, "than the 64 for which it has room");
}

#[test]
fn the_text_says_the_same_for_people() {
    let ran = sutura(&["scene", "explain", "scenes/palpation.toml"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for words in [
        "linear tissue, factored",
        "contact of tool 0, sphere",
        "us / step",
        "not built",
        "needle",
    ] {
        assert!(ran.stdout.contains(words), "no {words} in:\n{}", ran.stdout);
    }
    let ran = sutura(&["scene", "check", "scenes/palpation.toml"]);
    assert!(
        ran.stdout.contains("good (warnings: 0, notes: 1)"),
        "{}",
        ran.stdout
    );
}

/// The board of the scene's device has time for 40 frames of rows a second, and is asked for 60.
#[test]
fn a_session_says_what_the_board_has_time_for_and_sends_no_more() {
    let folder = tempfile::tempdir().expect("a directory");
    let read = |path: &str| std::fs::read_to_string(root().join(path)).expect("it ships");
    let slow = format!(
        "board_rows_hz = 40.0\n{}",
        read("devices/cartesian-bench.toml")
    );
    std::fs::write(folder.path().join("slow.toml"), slow).expect("writable");
    let scene = read("scenes/palpation.toml");
    let scene = scene.replace("\"cartesian-bench\"", "\"slow.toml\"");
    std::fs::write(folder.path().join("scene.toml"), scene).expect("writable");
    let run = |more: &[&str]| {
        let words = ["run", "scene.toml", "--lockstep", "--seconds", "0.05"];
        let ran = sutura_in(folder.path(), &[&words, more].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        ran
    };
    let summary = json(&run(&["--host-hz", "60", "--format", "json"]));
    assert_eq!(summary["board_rows_hz"], 40.0);
    let most = summary["most_rows"].as_u64();
    assert!(most >= Some(12) && most < Some(24), "{most:?}");
    let said = run(&["--host-hz", "40"]).stdout;
    let words =
        "time for 40 frames of 24 rows a second, by its device file: up to 24 a frame at 40 Hz";
    assert!(said.contains(words), "{said}");
}

/// Counts for a millimetre are warned of at their line of the device's file.
#[test]
fn a_coarse_encoder_is_warned_of_in_the_devices_file() {
    let folder = tempfile::tempdir().expect("a directory");
    let read = |path: &str| std::fs::read_to_string(root().join(path)).expect("it ships");
    let device = read("devices/cartesian-bench.toml");
    let coarse = device.replacen("counts_per_m = 81487.0", "counts_per_m = 81.487", 1);
    let line = coarse.lines().position(|line| line.contains("81.487"));
    std::fs::write(folder.path().join("coarse.toml"), &coarse).expect("writable");
    let scene = read("scenes/palpation.toml");
    let scene = scene.replace("\"cartesian-bench\"", "\"coarse.toml\"");
    std::fs::write(folder.path().join("scene.toml"), scene).expect("writable");
    let words = ["scene", "check", "scene.toml", "--format", "json"];
    let ran = sutura_in(folder.path(), &words);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let warnings = &json(&ran)["warnings"];
    assert_eq!(warnings.as_array().map(Vec::len), Some(1), "{warnings}");
    let [message, help] = ["message", "help"].map(|key| warnings[0][key].as_str().expect("text"));
    assert!(
        message.contains("counts_per_m = 81.487: a step of 12.3 mm"),
        "{message}"
    );
    assert!(help.contains("times 1000 it is 12.3 um"), "{help}");
    assert_eq!(
        warnings[0]["line"].as_u64(),
        line.map(|line| line as u64 + 1)
    );
    let file = warnings[0]["file"].as_str().expect("text");
    assert!(file.ends_with("coarse.toml"), "{file}");
    assert!(ran.stderr.contains("coarse.toml:"), "{}", ran.stderr);
}

/// The held punch presses on the tissue all the time that the console's sphere goes about; both share the
/// step's rows.
#[test]
fn a_session_steps_the_tools_that_are_held_too() {
    let two = "scenes/two-tools.toml";
    let ran = sutura(&["run", two, "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object = json(&ran);
    let scene = &object["scene"];
    assert!(scene["peak"]["force_n"].as_f64() > Some(0.5), "{scene}");
    let held = &scene["held"][0];
    assert_eq!(held["tool"], 1, "{scene}");
    assert!(
        held["force_n"][2].as_f64() < Some(-0.5),
        "pushes down: {scene}"
    );
    assert!(held["rows"].as_u64() > Some(10), "{scene}");
    assert_eq!(scene["held"].as_array().map(Vec::len), Some(1));
}

/// Jaws are explained, lift a slab in lockstep and let it slip, the same each time; models without rows refuse them.
#[test]
fn jaws_are_explained_run_and_reported() {
    let lift = "scenes/jaws-lift.toml";
    let run = || {
        let ran = sutura(&["run", lift, "--lockstep", "--format", "json"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&ran)
    };
    let object = run();
    let scene = &object["scene"];
    let events: Vec<_> = scene["events"].as_array().into_iter().flatten().collect();
    let named = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert_eq!((named("grasped"), named("lost")), (2, 1), "{scene}");
    let jaws = &scene["jaws"][0];
    assert_eq!((&jaws["tool"], &jaws["closed"]), (&0.into(), &false.into()));
    assert!(jaws["peak_n"].as_f64() > Some(0.9), "{scene}");
    assert!(jaws["friction_j"].as_f64() > Some(1e-4), "{scene}");
    // The console feels the lift: it pulls, which a contact alone does not.
    assert!(object["force_n"]["peak"].as_f64() > Some(0.5), "{object}");
    assert_eq!(object["trace_hash"], run()["trace_hash"]);
    let explained = sutura(&["scene", "explain", lift]);
    assert!(
        explained.stdout.contains("hold 1.00 N in their plane"),
        "{}",
        explained.stdout
    );
    let sticking = sutura(&["run", lift, "--tissue", "shape-matching", "--lockstep"]);
    assert_ne!(sticking.code, 0);
    let said = "it has jaws, whose friction only tissue with rows takes";
    assert!(sticking.stderr.contains(said), "{}", sticking.stderr);
}

/// What a scene adds by a key of its own is said by a session, and by an explanation of the scene; what is wrong with it at
/// its place.
#[test]
fn springs_are_explained_checked_and_reported() {
    let slab = "scenes/tied-slab.toml";
    let ran = sutura(&["run", slab, "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object = json(&ran);
    let tension = &object["scene"]["added"]["spring 1"]["tension_n"];
    assert!(tension.as_f64() > Some(0.05), "{object}");
    let explained = sutura(&["scene", "explain", slab]);
    assert!(
        explained.stdout.contains("`[[spring]]`: 60 N/m"),
        "{}",
        explained.stdout
    );
    let sticking = sutura(&["run", slab, "--tissue", "shape-matching", "--lockstep"]);
    assert_ne!(sticking.code, 0);
    let said = "it has spring 0, which only tissue with rows takes";
    assert!(sticking.stderr.contains(said), "{}", sticking.stderr);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("wrong.toml");
    let text = std::fs::read_to_string(root().join(slab)).expect("a scene");
    std::fs::write(&file, text.replace("60.0", "-60.0")).expect("a file");
    let refused = sutura(&["scene", "check", &file.display().to_string()]);
    assert_ne!(refused.code, 0);
    let said = "`stiffness_n_per_m` is -60; it must be above 0";
    assert!(refused.stderr.contains(said), "{}", refused.stderr);
}

/// A tool that rubs says what its friction took.
#[test]
fn a_dragged_tool_reports_what_friction_took() {
    let ran = sutura(&["run", "scenes/drag.toml", "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let taken = &json(&ran)["scene"]["friction_j"];
    // 60 mm at 0.3 of 1.2 N, less what sticks.
    let is_near = |taken: f64| (5e-3..40e-3).contains(&taken);
    assert!(taken.as_f64().is_some_and(is_near), "{taken}");
}

/// Loads press one slab on the other before the first step, and nothing moves after it.
#[test]
fn slabs_touch_without_a_needle() {
    let slabs = "scenes/touching-slabs.toml";
    let ran = sutura(&["run", slabs, "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object = json(&ran);
    assert_eq!(object["steps_withheld"], serde_json::json!({}), "{object}");
    let scene = &object["scene"];
    assert!(scene["touching"].as_u64() > Some(10), "{scene}");
    assert!(scene["penetration_ratio"].as_f64() < Some(1e-3), "{scene}");
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("slabs.json").display().to_string();
    let ran = sutura(&["solve", slabs, "--out", &out, "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let solved = json(&ran);
    assert_eq!(solved["wound"]["touching"], scene["touching"], "{solved}");
    assert!(solved["residual"].as_f64() < Some(1e-9), "{solved}");
    for command in ["check", "explain"] {
        let ran = sutura(&["scene", command, slabs, "--format", "json"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }
}

/// Paths of all scenes that ship.
fn scenes() -> Vec<String> {
    let list = std::fs::read_dir(root().join("scenes")).expect("the folder is there");
    let paths = list.map(|entry| entry.expect("readable").path());
    let scenes = paths.filter(|path| path.extension().is_some_and(|e| e == "toml"));
    scenes.map(|path| path.display().to_string()).collect()
}

fn as_json(path: &str, edit: impl Fn(&str) -> String) -> Value {
    let text = std::fs::read_to_string(path).expect("readable");
    let table: toml::Table = toml::from_str(&edit(&text)).expect("TOML");
    serde_json::to_value(table).expect("a scene has no date")
}

/// An independent validator takes every scene that ships, and none with a slip.
#[test]
fn the_schema_takes_what_is_shipped_and_not_a_misspelt_key() {
    let ran = sutura(&["scene", "schema", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let schema = json(&ran);
    let validator = jsonschema::validator_for(&schema).expect("a schema");
    assert!(scenes().len() >= 2);
    for path in scenes() {
        let scene = as_json(&path, str::to_owned);
        if let Err(error) = validator.validate(&scene) {
            panic!("{path}: {error} at {}", error.instance_path());
        }
        for (from, to) in [
            ("youngs_modulus_pa", "yungs_modulus_pa"),
            ("poisson_ratio = 0", "poisson_ratio = \"soft\" # 0"),
            ("[tissue]", "[tisue]"),
            ("model = \"", "model = \"w"),
            ("axis = \"", "axis = \"w"),
        ] {
            let slip = as_json(&path, |text| {
                assert!(text.contains(from), "{path} has no {from}");
                text.replacen(from, to, 1)
            });
            assert!(!validator.is_valid(&slip), "{path} with {to}");
        }
    }
}
