//! `sutura run` on other tissue models, and the choice among them, from the command line.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::{Ran, root, sutura};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A coarse slab that a hand presses once.
const SCENE: &str = r#"
name = "Coarse"
seconds = 0.6
device = "cartesian-bench"

[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [6, 6, 3]

[tissue]
MODEL
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.03 }

[[tool]]
radius_m = 0.035
# For a solve.
position_m = [0.0, 0.0, 0.033]

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [
    { time_s = 0.0, position_m = [0.0, 0.0, 0.037] },
    { time_s = 0.4, position_m = [0.001, 0.0, 0.031] },
]

[host]
host_hz = 50.0
"#;

fn scene(folder: &TempDir, model: &str) -> PathBuf {
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, SCENE.replace("MODEL", model)).unwrap();
    path
}

fn run(scene: &Path, more: &[&str]) -> Ran {
    let scene = scene.to_str().unwrap();
    sutura(&[&["run", scene, "--lockstep", "--format", "json"], more].concat())
}

fn summary(ran: &Ran) -> Value {
    serde_json::from_str(&ran.stdout).unwrap_or_else(|_| panic!("{}", ran.stderr))
}

#[test]
fn a_model_of_the_scene_and_of_the_line_are_one_and_replay_has_its_bits() {
    let folder = TempDir::new().unwrap();
    let by_line = scene(&folder, "");
    let file = folder.path().join("a.mcap");
    let file = file.to_str().unwrap();
    let tissue = "shape-matching: 1 ring";
    let ran = run(&by_line, &["--tissue", tissue, "--record", file]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let first = summary(&ran);
    assert_eq!(first["scene"]["tissue"], "shape-matching");
    assert_eq!(first["scene"]["model"]["setting"], "1 ring");
    assert_eq!(first["rendering"], "tangent");
    assert!(first["force_n"]["peak"].as_f64().unwrap() > 0.05, "{first}");
    let by_scene = scene(&folder, "model = \"shape-matching\"\nsetting = \"1 ring\"");
    let again = summary(&run(&by_scene, &[]));
    assert_eq!(first["trace_hash"], again["trace_hash"]);
    // The recorded scene says linear; the recording says what was run.
    let ran = sutura(&["replay", file, "--verify", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(summary(&ran)["host"]["identical"], true);
}

#[test]
fn what_a_model_does_not_take_is_refused_with_the_reason() {
    let folder = TempDir::new().unwrap();
    let own = scene(&folder, "");
    let needles = Path::new("scenes/needle-slabs.toml");
    for (ran, said) in [
        (
            run(needles, &["--tissue", "chainmail-ellipsoid"]),
            [
                "chainmail-ellipsoid tissue does not take this scene: it has needles",
                "compliance",
                "--tissue linear",
            ],
        ),
        (
            run(needles, &["--tissue", "energy-balance-neo-hookean"]),
            [
                "energy-balance-neo-hookean tissue does not take this scene: it has needles",
                "compliance",
                "--tissue hyperelastic",
            ],
        ),
        (
            run(
                needles,
                &["--tissue", "hyperelastic: quadratic cells, to 1e-3"],
            ),
            ["hyperelastic tissue", "linear or averaged cells", ""],
        ),
        (
            run(&own, &["--tissue", "shape-matching", "--rendering", "rows"]),
            ["rows need the compliance", "--rendering tangent", ""],
        ),
        (
            run(&own, &["--tissue", "shape-maching"]),
            ["did you mean `shape-matching`?", "`hyperelastic`", "`auto`"],
        ),
        (
            run(
                &scene(&folder, "model = \"shape-matching\"\nsetting = \"3 rings\""),
                &[],
            ),
            [
                "no setting of shape-matching `3 rings`",
                "`4 rings`",
                "scene.toml",
            ],
        ),
        (
            sutura(&[
                "solve",
                scene(&folder, "model = \"shape-matching\"")
                    .to_str()
                    .unwrap(),
                "--out",
                folder.path().join("a.vtu").to_str().unwrap(),
            ]),
            ["runs in sessions only", "sutura run", ""],
        ),
    ] {
        assert_eq!(ran.code, 2, "{said:?}: {}{}", ran.stdout, ran.stderr);
        for words in said {
            assert!(
                ran.stderr.contains(words),
                "no \"{words}\" in:\n{}",
                ran.stderr
            );
        }
    }
}

#[test]
fn scene_check_and_explain_know_the_model() {
    let folder = TempDir::new().unwrap();
    let path = scene(&folder, "model = \"shape-matching\"");
    let path = path.to_str().unwrap();
    let ran = sutura(&["scene", "check", path]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let ran = sutura(&["scene", "explain", path]);
    for words in ["shape-matching tissue", "2 rings", "us / step", "not built"] {
        assert!(ran.stdout.contains(words), "no {words} in:\n{}", ran.stdout);
    }
}

/// With time for everything the least error is taken, with time for nothing the fastest, and then the budget is missed.
#[test]
fn a_budget_takes_the_best_that_holds_it_or_the_fastest() {
    let folder = TempDir::new().unwrap();
    let auto = scene(&folder, "model = \"auto\"");
    let ran = run(&auto, &["--budget-ms", "100000", "--seconds", "0.2"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let chosen = &summary(&ran)["chosen"];
    let candidates = chosen["candidates"].as_array().unwrap();
    let errors = candidates.iter().filter_map(|row| row["error"].as_f64());
    let least = errors.fold(f64::INFINITY, f64::min);
    assert!(candidates.len() > 8, "{chosen}");
    assert_eq!(
        (chosen["error"].as_f64(), &chosen["holds_budget"]),
        (Some(least), &true.into())
    );
    assert!(
        least < 1e-3,
        "the reference's own law is among them: {chosen}"
    );
    // Pressed by little, laws are alike in force and in form. What tools stick to has another contact, and no figure.
    let laws = ["linear", "corotational", "hyperelastic"];
    for row in candidates {
        let is_law = laws.contains(&row["model"].as_str().unwrap());
        for key in ["error", "displacement_error"] {
            let error = row[key].as_f64();
            assert_eq!(error.is_some(), is_law, "{key} of {row}");
            assert!(error.is_none_or(|error| error < 0.3), "{key} of {row}");
        }
        let note = row["note"].as_str().unwrap();
        assert_eq!(note.contains("stick"), !is_law, "{row}");
        assert_eq!(row["step_us"].is_null(), !is_law, "{row}");
    }
    assert_eq!(chosen["contact"], "frictionless");
    for words in ["taken: --tissue", "contact without friction"] {
        assert!(ran.stderr.contains(words), "{}", ran.stderr);
    }

    // Also without `auto`, as the model is not fixed on the line.
    let linear = scene(&folder, "");
    let ran = run(&linear, &["--budget-ms", "0.001", "--seconds", "0.2"]);
    assert_eq!(ran.code, 7, "{}", ran.stderr);
    let chosen = &summary(&ran)["chosen"];
    let time = |row: &Value| row["step_us"]["p99"].as_f64();
    let candidates = chosen["candidates"].as_array().unwrap();
    let fastest = candidates
        .iter()
        .filter_map(time)
        .fold(f64::INFINITY, f64::min);
    assert_eq!(
        (time(chosen), &chosen["holds_budget"]),
        (Some(fastest), &false.into())
    );
    assert!(ran.stderr.contains("the fastest"), "{}", ran.stderr);

    let ran = run(
        &linear,
        &[
            "--budget-ms",
            "0.001",
            "--seconds",
            "0.2",
            "--tissue",
            "linear",
        ],
    );
    assert_eq!(ran.code, 7, "{}", ran.stderr);
    assert!(summary(&ran)["chosen"].is_null());
}

/// A scene whose tool rubs is compared with its friction; what is taken is what the line names, and a replay has it too.
#[test]
fn what_auto_takes_is_what_the_line_names_and_replays() {
    let folder = TempDir::new().unwrap();
    let own = scene(&folder, "model = \"corotational\"");
    // A tongue, held at one end and pressed down at the other: it turns, and linear tissue grows as it does.
    let mut text = std::fs::read_to_string(&own).unwrap();
    for (slab, tongue) in [
        ("[0.06, 0.06, 0.03]", "[0.06, 0.02, 0.006]"),
        ("[6, 6, 3]", "[12, 4, 2]"),
        ("axis = \"z\"", "axis = \"x\""),
        ("radius_m = 0.035", "radius_m = 0.01\nfriction = 0.3"),
        ("= 10e3", "= 50e3"),
        ("[0.0, 0.0, 0.037]", "[0.022, 0.0, 0.012]"),
        ("[0.001, 0.0, 0.031]", "[0.022, 0.0, -0.01]"),
    ] {
        assert!(text.contains(slab), "{slab}");
        text = text.replace(slab, tongue);
    }
    std::fs::write(&own, text).unwrap();
    let file = folder.path().join("a.mcap");
    let file = file.to_str().unwrap();
    let line = [
        "--tissue",
        "auto",
        "--rendering",
        "rows",
        "--seconds",
        "0.3",
    ];
    let more = ["--budget-ms", "100000", "--record", file];
    let ran = run(&own, &[&line[..], &more].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let taken = summary(&ran);
    assert_eq!(taken["chosen"]["model"], "hyperelastic", "{taken}");
    assert_eq!(taken["chosen"]["contact"], "coulomb", "{taken}");
    let setting = taken["chosen"]["setting"].as_str().unwrap();
    let named = format!("hyperelastic: {setting}");
    let ran = run(
        &own,
        &[
            "--tissue",
            &named,
            "--rendering",
            "rows",
            "--seconds",
            "0.3",
        ],
    );
    assert_eq!(summary(&ran)["trace_hash"], taken["trace_hash"]);
    let ran = sutura(&["replay", file, "--verify", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(summary(&ran)["host"]["identical"], true);
}

/// Without a budget a step may take the host's period; where rows are asked for, what is taken has them.
#[test]
fn auto_has_the_hosts_period_and_gives_rows_if_asked() {
    let folder = TempDir::new().unwrap();
    let auto = scene(&folder, "model = \"auto\"");
    let line = ["--host-hz", "20", "--rendering", "rows", "--seconds", "0.2"];
    let summary = summary(&run(&auto, &line));
    let chosen = &summary["chosen"];
    assert_eq!(chosen["budget_ms"].as_f64(), Some(50.0));
    let model = chosen["model"].as_str().unwrap();
    let with_rows = ["linear", "corotational", "hyperelastic"];
    assert!(with_rows.contains(&model), "{chosen}");
    assert_eq!(summary["rendering"], "rows");
}

/// One law of contact for all three: for one and the same hand friction is the scene's, whichever tissue it rubs.
#[test]
fn the_law_of_contact_does_not_change_with_the_tissue() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("drag.toml");
    let drag = std::fs::read_to_string(root().join("scenes/drag.toml")).unwrap();
    let drag = drag
        .replace("[20, 13, 7]", "[10, 7, 4]")
        .replace("host_hz = 200.0", "host_hz = 60.0");
    for friction in ["friction = 0.3", "friction = 0.0"] {
        let text = drag
            .replace("static_friction = 0.4", "")
            .replace("friction = 0.3", friction);
        std::fs::write(&path, text).unwrap();
        let peaks = ["linear", "corotational", "hyperelastic"].map(|tissue| {
            let ran = run(&path, &["--tissue", tissue]);
            assert_eq!(ran.code, 0, "{}", ran.stderr);
            let summary = summary(&ran);
            assert_eq!(summary["rendering"], "rows", "{tissue}");
            assert_eq!(summary["decays"], 0, "{tissue}");
            let frames = &summary["frames"];
            assert_eq!(frames["rejected"], 0, "{tissue}: {frames}");
            // What is sent may have been tried ahead, where friction is not what the step's end has.
            let solved = summary["force_n"]["solved_peak"].as_f64().unwrap();
            let hardest = summary["scene"]["peak"]["force_n"].as_f64().unwrap();
            assert!(solved >= hardest, "{tissue}: {solved} of {hardest} N");
            summary["force_n"]["peak"].as_f64().unwrap()
        });
        println!("{friction}: {peaks:?} N");
        let [linear, ..] = peaks;
        for peak in peaks {
            assert!((peak / linear - 1.0).abs() < 0.25, "{peaks:?} N");
        }
    }
}

/// The palpation scene's hand on hyperelastic tissue: each step in contact is rendered, twice the same, and nothing decays.
#[test]
fn palpation_of_hyperelastic_tissue_runs_in_lockstep() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("palpation.toml");
    let text = std::fs::read_to_string(root().join("scenes/palpation.toml")).unwrap();
    let text = text
        .replace("[20, 20, 8]", "[10, 10, 4]")
        .replace("model = \"linear\"", "model = \"hyperelastic\"");
    std::fs::write(&path, text).unwrap();
    let again = [(); 2].map(|()| {
        let ran = run(&path, &["--host-hz", "60"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        summary(&ran)
    });
    let [summary, second] = again;
    assert_eq!(summary["trace_hash"], second["trace_hash"]);
    assert_eq!(summary["decays"], 0);
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    assert_eq!(summary["frames"]["rejected"], 0);
    // The tissue without friction lets the sphere slip where it would stick.
    let peak = summary["force_n"]["peak"].as_f64().unwrap();
    assert!((3.0..4.5).contains(&peak), "{peak} N");
    assert!(summary["energy_j"]["min"].as_f64().unwrap() > -1e-3);

    // And at rest, where the scene holds the tool.
    let file = folder.path().join("a.json");
    let (path, file) = (path.to_str().unwrap(), file.to_str().unwrap());
    let ran = sutura(&["solve", path, "--out", file, "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let solved: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert!(solved["residual"].as_f64().unwrap() < 1e-8, "{solved}");
    let force = solved["tools"][0]["force_n"][2].as_f64().unwrap();
    assert!((-3.6..-3.1).contains(&force), "{force} N");
}

/// No reference has needles: linear tissue is taken, and the reason said.
#[test]
fn auto_with_needles_is_linear_and_says_why() {
    let needles = Path::new("scenes/needle-slabs.toml");
    let ran = run(needles, &["--tissue", "auto", "--seconds", "0.1"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert_eq!(summary(&ran)["scene"]["tissue"], "linear");
    assert_eq!(summary(&ran)["rendering"], "rows");
    for words in ["linear tissue is taken without a measurement", "needles"] {
        assert!(ran.stderr.contains(words), "no {words} in:\n{}", ran.stderr);
    }
}
