//! `sutura mesh` from the command line: figures of good and bad meshes, conversion there and back.

use crate::support::{Ran, sutura, sutura_in};
use serde_json::Value;
use std::path::Path;

/// Two tetrahedra of 1 mm on the face 2 3 4, the second with `last`, in regions 5 and 6.
fn two_cells(second: &str) -> String {
    format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 6 \"fat\"\n$EndPhysicalNames\n\
         $Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n$EndNodes\n\
         $Elements\n2\n1 4 2 5 1 1 2 3 4\n77 4 2 6 1 {second}\n$EndElements\n"
    )
}

fn json(ran: &Ran) -> Value {
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    serde_json::from_str(&ran.stdout).expect("one JSON object")
}

fn info(directory: &Path, file: &str) -> Value {
    json(&sutura_in(
        directory,
        &["mesh", "info", file, "--format", "json"],
    ))
}

/// Counts as tests/data/README.md has them; a cube with an edge of 1 m.
#[test]
fn a_good_mesh_in_figures() {
    let cube = "tests/data/cube_1650.msh";
    let report = json(&sutura(&["mesh", "info", cube, "--format", "json"]));
    assert_eq!(report["status"], "ok");
    assert_eq!(
        (&report["nodes"], &report["cells"]),
        (&1520.into(), &6502.into())
    );
    assert_eq!(
        (&report["inverted"], &report["usable"]),
        (&0.into(), &true.into())
    );
    let quality = |key: &str| report["quality"][key].as_f64().expect("a number");
    assert_eq!(report["quality"]["measure"], "mean-ratio");
    assert!(0.0 < quality("min") && quality("min") <= quality("p01"));
    assert!(quality("p01") <= quality("p50") && quality("p50") <= 1.0);
    let volume = report["volume_m3"].as_f64().expect("a number");
    assert!((volume - 1.0).abs() < 1e-9, "{volume}");
    let text = sutura(&["mesh", "info", cube]);
    assert!(
        text.stdout.contains("scenes take this mesh"),
        "{}",
        text.stdout
    );
}

/// Times are those of this machine: only that they are there, and when they are not asked for.
#[test]
fn times_are_measured_on_small_meshes_and_where_asked_for() {
    let cylinder = "tests/data/cylinder_1650.msh";
    let report = json(&sutura(&[
        "mesh", "info", cylinder, "--rows", "20", "--format", "json",
    ]));
    for key in [
        "factor_ms",
        "factor_mb",
        "column_us",
        "step_us",
        "step_radius_m",
    ] {
        assert!(report[key].as_f64() > Some(0.0), "{key}: {report}");
    }
    assert_eq!(report["step_status"], "ok");
    assert!(report["step_rows"].as_u64() > Some(5), "{report}");
    let text = sutura(&["mesh", "info", cylinder]).stdout;
    assert!(text.contains(" rows, a sphere of "), "{text}");

    let directory = tempfile::tempdir().expect("a directory");
    let flat = two_cells("2 3 4 1").replace("4 0 0 1", "4 0.5 0.5 0");
    std::fs::write(directory.path().join("a.msh"), flat).expect("writable");
    let report = info(directory.path(), "a.msh");
    assert_eq!(
        (&report["usable"], &report["step_us"]),
        (&false.into(), &Value::Null)
    );
    assert_eq!(report["step_status"], "scenes refuse this mesh");
}

#[test]
fn scale_is_metres_per_unit() {
    let directory = tempfile::tempdir().expect("a directory");
    std::fs::write(directory.path().join("a.msh"), two_cells("2 3 4 5")).expect("writable");
    let ran = sutura_in(
        directory.path(),
        &[
            "mesh", "info", "a.msh", "--scale", "0.001", "--format", "json",
        ],
    );
    let report = json(&ran);
    // Corner of a cube, 1/6, and the tetrahedron on its far face, 1/3.
    let volume = report["volume_m3"].as_f64().expect("a number");
    assert!((volume - 0.5e-9).abs() < 1e-20, "{volume}");
    assert_eq!(report["regions"][1]["name"], "fat");
    let ran = sutura_in(directory.path(), &["mesh", "info", "a.msh", "--scale", "0"]);
    assert_eq!(ran.code, 2);
    assert!(
        ran.stderr.contains("must be finite and above zero"),
        "{}",
        ran.stderr
    );
}

#[test]
fn an_inverted_cell_is_counted_and_named() {
    let directory = tempfile::tempdir().expect("a directory");
    std::fs::write(directory.path().join("bad.msh"), two_cells("3 2 4 5")).expect("writable");
    let report = info(directory.path(), "bad.msh");
    assert_eq!(
        (&report["inverted"], &report["usable"]),
        (&1.into(), &false.into())
    );
    assert_eq!(report["boundary_faces"], 6);
    assert!(report["quality"]["min"].as_f64() < Some(0.0));
    let refusal = report["refusal"].as_str().expect("a reason");
    assert!(refusal.contains("element 77"), "{refusal}");
    let text = sutura_in(directory.path(), &["mesh", "info", "bad.msh"]);
    assert_eq!(text.code, 0);
    assert!(
        text.stdout.contains("scenes refuse this mesh"),
        "{}",
        text.stdout
    );
}

/// Through every format and back: the same figures, except for names that a format cannot hold.
#[test]
fn formats_convert_into_each_other() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    std::fs::write(path.join("a.msh"), two_cells("2 3 4 5")).expect("writable");
    for (from, to) in [("a.msh", "b.node"), ("b.ele", "c.vtk"), ("c.vtk", "d.msh")] {
        let ran = sutura_in(path, &["mesh", "convert", from, "--out", to]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }
    let keep = |mut report: Value| {
        report["file"].take();
        report["regions"][1]["name"].take();
        for measured in ["factor_ms", "column_us", "step_us"] {
            report[measured].take();
        }
        report
    };
    assert_eq!(keep(info(path, "a.msh")), keep(info(path, "d.msh")));
    let ran = sutura_in(path, &["mesh", "convert", "a.msh", "--out", "e.vtu"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let text = std::fs::read_to_string(path.join("e.vtu")).expect("written");
    let document = roxmltree::Document::parse(&text).expect("well-formed XML");
    let array = |name| {
        let node = document
            .descendants()
            .find(|n| n.attribute("Name") == Some(name));
        let text = node.and_then(|n| n.text()).expect("the array is there");
        text.split_whitespace()
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    assert_eq!(array("region"), ["5", "6"]);
    assert_eq!(array("mean_ratio").len(), 2);
}

#[test]
fn what_cannot_be_used_is_refused_with_its_place() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    std::fs::write(path.join("a.msh"), two_cells("2 3 4 x")).expect("writable");
    std::fs::write(path.join("lone.ele"), "0 4 0\n").expect("writable");
    for (arguments, said) in [
        (vec!["info", "a.msh"], ["a.msh: line 19", "2 3 4 x"]),
        (
            vec!["info", "none.msh"],
            ["cannot read none.msh", "No such file"],
        ),
        (vec!["info", "part.stl"], ["part.stl", ".vtk"]),
        (
            vec!["info", "lone.ele"],
            ["cannot read lone.node", "No such file"],
        ),
        (
            vec!["convert", "a.msh", "--out", "a.obj"],
            ["a.obj", ".vtu"],
        ),
    ] {
        let ran = sutura_in(path, &[&["mesh"], &arguments[..]].concat());
        assert_eq!(ran.code, 2, "{arguments:?}: {}", ran.stderr);
        for words in said {
            assert!(ran.stderr.contains(words), "no {words} in {}", ran.stderr);
        }
        assert!(ran.stdout.is_empty());
    }
}

/// A node too many and a cell inside out: written as they are, or mended with `--clean`; never over the file itself.
#[test]
fn cleaning_says_what_it_did_and_spares_the_input() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path();
    let bad = two_cells("3 2 4 5").replace("5\n1 0 0 0", "6\n6 9 9 9\n1 0 0 0");
    std::fs::write(path.join("bad.msh"), &bad).expect("writable");
    let run = |arguments: &[&str]| sutura_in(path, &[&["mesh", "convert"], arguments].concat());
    let kept = json(&run(&["bad.msh", "--out", "kept.msh", "--format", "json"]));
    assert_eq!(
        (&kept["inverted"], &kept["unreferenced"]),
        (&1.into(), &1.into())
    );
    assert_eq!(kept["cleaned"], Value::Null);
    let ran = run(&[
        "bad.msh",
        "--out",
        "clean.vtu",
        "--clean",
        "--format",
        "json",
    ]);
    let clean = json(&ran);
    assert_eq!(clean["cleaned"]["dropped_nodes"], 1);
    assert_eq!(clean["cleaned"]["turned_cells"], 1);
    assert_eq!(
        (&clean["usable"], &clean["nodes"]),
        (&true.into(), &5.into())
    );
    let text = run(&["bad.msh", "--out", "clean.node", "--clean"]).stdout;
    let said = "1 nodes without a cell dropped, 1 inverted cells turned";
    assert!(text.contains(said), "{text}");
    for file in ["clean.vtu", "clean.ele"] {
        let report = info(path, file);
        assert_eq!(report["usable"], true, "{file}");
        assert_eq!(report["regions"], {
            let mut regions = clean["regions"].clone();
            regions[1].as_object_mut().expect("a region").remove("name");
            regions
        });
    }
    for (file, out) in [("bad.msh", "./bad.msh"), ("clean.node", "clean.ele")] {
        let ran = run(&[file, "--out", out, "--clean", "--overwrite"]);
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        assert!(ran.stderr.contains("over itself"), "{}", ran.stderr);
    }
    let after = std::fs::read_to_string(path.join("bad.msh")).expect("still there");
    assert_eq!(after, bad);
}

/// What a reader leaves out is said, in text and as `notes`.
#[test]
fn ten_node_cells_are_taken_with_a_note() {
    let file = "tests/data/meshes/gmsh41-order2.msh";
    let run = |format| sutura(&["mesh", "info", file, "--scale", "0.001", "--format", format]);
    let report = json(&run("json"));
    assert_eq!(
        (&report["nodes"], &report["usable"]),
        (&84.into(), &true.into())
    );
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("218 cells of 10 nodes are taken as cells of 4"),
        "{notes}"
    );
    assert!(
        run("text")
            .stdout
            .contains("nodes in the middle of edges are dropped")
    );
}

/// An organ in millimetres without a scale is 40 m long: told, with the factor.
#[test]
fn a_mesh_in_millimetres_gets_its_hint() {
    let report = json(&sutura(&[
        "mesh",
        "info",
        "tests/data/meshes/gmsh.inp",
        "--format",
        "json",
    ]));
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("0.001"), "{warnings}");
}

/// What a mesh's reader leaves out is said once where a scene is loaded, and in `scene check`.
#[test]
fn scenes_say_what_was_made_of_their_mesh() {
    let directory = tempfile::tempdir().expect("a directory");
    let mesh = crate::support::root().join("tests/data/meshes/gmsh41-order2.msh");
    std::fs::copy(mesh, directory.path().join("a.msh")).expect("a copy");
    let info = info(directory.path(), "a.msh");
    let said = info["notes"].as_array().expect("a list");
    assert!(!said.is_empty(), "{info}");
    let [x, y, z] = [0, 1, 2].map(|axis| info["size_m"][axis].as_f64().expect("a number"));
    let scale = 0.05 / x.max(y).max(z);
    let scene = |more: &str| {
        let text = format!(
            "gravity_m_per_s2 = [0.0, 0.0, -9.81]\n[mesh]\nfile = \"a.msh\"\nscale_to_m = {scale}\n{more}\n[[fixed]]\nnodes = [0, 1, 2, 3]\n\
             [tissue]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.4\ndensity_kg_per_m3 = 1000.0\n"
        );
        std::fs::write(directory.path().join("a.toml"), text).expect("writable");
    };
    scene("");
    let checked = json(&sutura_in(
        directory.path(),
        &["scene", "check", "a.toml", "--format", "json"],
    ));
    let notes = checked["notes"].as_array().expect("a list");
    assert_eq!(notes.len(), said.len(), "{checked}");
    for (note, said) in notes.iter().zip(said) {
        let (note, said) = (
            note["message"].as_str().expect("text"),
            said.as_str().expect("text"),
        );
        assert!(
            note.contains("a.msh") && note.contains(said),
            "{note}, not {said}"
        );
    }
    assert_eq!(notes[0]["line"], 3);
    let ran = sutura_in(directory.path(), &["solve", "a.toml", "--out", "a.json"]);
    let text = ran.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    for said in said {
        let said = said.as_str().expect("text");
        assert_eq!(text.matches(said).count(), 1, "{said} in {text}");
    }
    // Cells of ten nodes are asked for in vain, with what to do instead.
    scene("cells = \"quadratic\"");
    let ran = sutura_in(directory.path(), &["scene", "check", "a.toml"]);
    let text = ran
        .stderr
        .split_whitespace()
        .filter(|word| *word != "\u{2502}");
    let text = text.collect::<Vec<_>>().join(" ");
    assert_eq!(ran.code, 2, "{text}");
    for words in [
        "unknown key `cells`",
        "mesh finer",
        "setting = \"quadratic cells, to 1e-3\"",
    ] {
        assert!(text.contains(words), "no {words} in {text}");
    }
}

/// A cell array of another name is told, and taken where it is named: by the command and by a scene.
#[test]
fn regions_are_taken_from_the_array_that_is_named() {
    let directory = tempfile::tempdir().expect("a directory");
    let at = directory.path();
    let grid = "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n\
        0 0 0 0.03 0 0 0 0.03 0 0 0 0.03 0.03 0.03 0.03\nCELLS 2 10\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 2\n10\n10\n\
        CELL_DATA 2\nSCALARS tissue_class int 1\nLOOKUP_TABLE default\n3 4\n";
    std::fs::write(at.join("a.vtk"), grid).expect("writable");
    let regions = |report: &Value| {
        let regions = report["regions"].as_array().expect("a list").iter();
        regions
            .map(|region| region["region"].as_i64())
            .collect::<Vec<_>>()
    };
    let plain = info(at, "a.vtk");
    assert_eq!(regions(&plain), [Some(0)]);
    let notes = plain["notes"].to_string();
    assert!(notes.contains("--region tissue_class"), "{notes}");
    let named = ["--region", "tissue_class", "--format", "json"];
    let run = |command: &[&str], more: &[&str]| sutura_in(at, &[command, more].concat());
    let report = json(&run(&["mesh", "info", "a.vtk"], &named));
    assert_eq!(regions(&report), [Some(3), Some(4)]);
    assert_eq!(report["notes"], serde_json::json!([]));
    json(&run(
        &["mesh", "convert", "a.vtk", "--out", "a.msh"],
        &named,
    ));
    assert_eq!(regions(&info(at, "a.msh")), [Some(3), Some(4)]);
    for (file, said) in [
        (
            "a.vtk",
            "with a number for each cell there are: tissue_class",
        ),
        ("a.msh", "there is none with a number for each cell"),
    ] {
        let ran = run(&["mesh", "info", file], &["--region", "labels"]);
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        for words in ["no cell array `labels`", said] {
            assert!(ran.stderr.contains(words), "{file}: {}", ran.stderr);
        }
    }
    // Region 4 is stiffer: without its array there is no such region.
    let check = |key: &str| {
        let text = format!(
            "[mesh]\nfile = \"a.vtk\"\nscale_to_m = 1.0\n{key}\n[[fixed]]\nnodes = [0, 1, 2]\n\
             [tissue]\nyoungs_modulus_pa = 1e4\npoisson_ratio = 0.4\n[[region]]\ntag = 4\nyoungs_modulus_pa = 2e4\npoisson_ratio = 0.4\n"
        );
        std::fs::write(at.join("a.toml"), text).expect("writable");
        run(&["scene", "check", "a.toml"], &["--format", "json"])
    };
    let good = json(&check("region_array = \"tissue_class\""));
    assert_eq!(good["notes"], serde_json::json!([]));
    let without = check("");
    assert_eq!(without.code, 2, "{}", without.stdout);
    let wrong = check("region_array = \"labels\"");
    assert_eq!(wrong.code, 2, "{}", wrong.stdout);
    for words in ["region_array", "no such cell array", "tissue_class"] {
        assert!(wrong.stderr.contains(words), "{words}: {}", wrong.stderr);
    }
}
