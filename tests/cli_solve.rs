//! `sutura solve` from end to end: against an independent solution, and files that others can read.

use crate::support::{root, sutura, sutura_in};
use serde_json::Value;

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("JSON")
}

fn read_json(path: &std::path::Path) -> Value {
    json(&std::fs::read_to_string(path).expect("the file is there"))
}

fn vectors(value: &Value) -> Vec<[f64; 3]> {
    serde_json::from_value(value.clone()).expect("a list of vectors")
}

/// Largest difference of two lists of vectors over the largest length in the second.
fn relative_error(got: &[[f64; 3]], expected: &[[f64; 3]]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| norm([a[0] - b[0], a[1] - b[1], a[2] - b[2]]);
    let error = got.iter().zip(expected).map(apart).fold(0.0, f64::max);
    error / expected.iter().map(|v| norm(*v)).fold(0.0, f64::max)
}

/// Expected: scikit-fem 12.0.2 assembly, scipy SuperLU on the full system (tests/data). The file gives 9
/// digits.
#[test]
fn the_cube_with_one_handle_agrees_with_an_independent_solver() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("cube.json");
    let ran = sutura(&[
        "solve",
        "scenes/cube-handle.toml",
        "--out",
        &out.to_string_lossy(),
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let got = read_json(&out);
    let expected = read_json(&root().join("tests/data/linear-cube-1-handle.json"));
    let displacement = vectors(&got["displacement_m"]);
    assert_eq!(vectors(&got["points_m"]).len(), displacement.len());
    let error = relative_error(&displacement, &vectors(&expected["displacement_m"]));
    assert!(error < 1e-6, "displacement: {error:e}");
    let reactions = got["reactions"].as_array().expect("a list");
    assert_eq!(reactions[0]["handle"], 0);
    let force: Vec<[f64; 3]> = reactions
        .iter()
        .map(|r| vectors(&json(&format!("[{}]", r["force_n"])))[0])
        .collect();
    let error = relative_error(&force, &vectors(&expected["force_on_tissue_n"]));
    assert!(error < 1e-6, "force: {error:e}");
    assert!(got["residual"].as_f64().expect("a number") < 1e-9);
    assert!(ran.stdout.contains("handle side"), "{}", ran.stdout);
}

/// The two formats hold the same field, up to the last bit, which a quick JSON reader may lose.
#[test]
fn the_grid_file_reads_back_as_the_json_file() {
    let directory = tempfile::tempdir().expect("a directory");
    let [grid, plain] = ["cube.vtu", "cube.json"].map(|name| directory.path().join(name));
    for out in [&grid, &plain] {
        let ran = sutura(&[
            "solve",
            "scenes/cube-handle.toml",
            "-o",
            &out.to_string_lossy(),
        ]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }
    let text = std::fs::read_to_string(&grid).expect("the file is there");
    let document = roxmltree::Document::parse(&text).expect("well-formed XML");
    let plain = read_json(&plain);
    for name in ["points_m", "displacement_m"] {
        let array = document
            .descendants()
            .find(|n| n.attribute("Name") == Some(name));
        let words = array
            .and_then(|n| n.text())
            .expect("the array is there")
            .split_whitespace();
        let numbers: Vec<f64> = words.map(|w| w.parse().expect("a number")).collect();
        let expected = vectors(&plain[name]).concat();
        assert_eq!(numbers.len(), expected.len(), "{name}");
        for (a, b) in numbers.iter().zip(&expected) {
            assert!((a - b).abs() <= 4e-16 * b.abs(), "{name}: {a:e} and {b:e}");
        }
    }
    // One row for each cell; the equivalent stress is that of the row.
    let array = |name: &str| -> Vec<f64> {
        let array = document
            .descendants()
            .find(|n| n.attribute("Name") == Some(name));
        let words = array.and_then(|n| n.text()).expect("the array is there");
        let number = |word: &str| word.parse().expect("a number");
        words.split_whitespace().map(number).collect()
    };
    let (principal, von_mises) = (array("principal_stress_pa"), array("von_mises_pa"));
    assert!(!von_mises.is_empty() && von_mises.len() == array("types").len());
    assert_eq!(principal.len(), 3 * von_mises.len());
    for (row, equivalent) in principal.chunks_exact(3).zip(&von_mises) {
        let [a, b, c] = [row[0], row[1], row[2]];
        assert!(a >= b && b >= c);
        let expected = (0.5 * ((a - b).powi(2) + (b - c).powi(2) + (c - a).powi(2))).sqrt();
        assert!((equivalent - expected).abs() <= 1e-12 * expected);
    }
    assert!(von_mises.iter().any(|stress| *stress > 1.0), "under load");
    let left: Vec<_> = std::fs::read_dir(directory.path())
        .expect("readable")
        .collect();
    assert_eq!(left.len(), 2, "partial files are left: {left:?}");
}

/// With `--format json` stdout is one object and nothing else.
#[test]
fn the_summary_is_one_json_object_when_asked_for() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("cube.json");
    let out = out.to_string_lossy();
    let ran = sutura(&[
        "solve",
        "scenes/cube-handle.toml",
        "--out",
        &out,
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let summary = json(&ran.stdout);
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["nodes"], 1520);
    assert_eq!(summary["cells"], 6502);
    assert_eq!(summary["reactions"][0]["name"], "side");
}

/// A bar under its weight, held at an end; `tissue` is what it is made of.
const HANGS: &str = r#"
gravity_m_per_s2 = [0.0, 0.0, -9.81]
[mesh.slab]
size_m = [0.04, 0.015, 0.015]
divisions = [8, 3, 3]
[[fixed]]
plane = { axis = "x", at_m = -0.02 }
[[fixed]]
nodes = [0, 1]
[tissue]
poisson_ratio = 0.4
density_kg_per_m3 = 1000.0
"#;

/// Linear tissue from a tenth of its size on, any other from its size on.
#[test]
fn tissue_that_sags_far_is_told_with_what_to_do() {
    let directory = tempfile::tempdir().expect("a directory");
    let solved = |tissue: &str| {
        std::fs::write(
            directory.path().join("a.toml"),
            format!("{HANGS}{tissue}\n"),
        )
        .expect("writable");
        let arguments = [
            "solve",
            "a.toml",
            "--out",
            "a.json",
            "--overwrite",
            "--format",
            "json",
        ];
        let ran = sutura_in(directory.path(), &arguments);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        // A terminal breaks lines.
        let said = ran.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        (ran.json(), said)
    };
    let (report, said) = solved("youngs_modulus_pa = 5e3");
    for words in [
        "sags by ",
        "mm under its weight",
        "% of its size of 40.0 mm",
        "model = \"corotational\"",
    ] {
        assert!(said.contains(words), "no {words} in {said}");
    }
    // Its weight of 9 ml of water, whatever the sag.
    let weight_n = 9.81 * 1000.0 * 0.04 * 0.015 * 0.015;
    let held = vectors(&serde_json::json!([report["fixed_force_n"]]))[0];
    assert!(
        (held[2] / weight_n - 1.0).abs() < 1e-9 && held[0].abs() < 1e-9,
        "{held:?}"
    );
    let each = report["fixed_reactions"].as_array().expect("a list");
    let nodes: Vec<_> = each.iter().map(|own| own["nodes"].as_u64()).collect();
    assert_eq!(nodes, [Some(16), Some(1)]);
    assert_eq!(
        read_json(&directory.path().join("a.json"))["fixed_force_n"],
        report["fixed_force_n"]
    );
    let (_, said) = solved("youngs_modulus_pa = 60e3");
    assert!(!said.contains("sags by"), "{said}");
    let (_, said) = solved("youngs_modulus_pa = 5e3\nmodel = \"corotational\"");
    assert!(!said.contains("sags by"), "{said}");
    let (_, said) = solved("youngs_modulus_pa = 300.0\nmodel = \"hyperelastic\"");
    assert!(
        said.contains("see that `youngs_modulus_pa` is in Pa") && !said.contains("linear"),
        "{said}"
    );
}

/// These have scenes of their own, without weight.
#[test]
fn a_scene_is_refused_where_none_is_taken() {
    for command in ["fidelity", "tradeoff", "stability"] {
        let ran = sutura(&[command, "scenes/organ-under-its-own-weight.toml"]);
        assert_eq!(ran.code, 2, "{command}: {}", ran.stderr);
        assert!(
            ran.stderr.contains("organ-under-its-own-weight.toml"),
            "{}",
            ran.stderr
        );
    }
}
