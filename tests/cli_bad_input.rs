//! Every kind of bad input: the right exit code, and a message that names the thing and the way out.

use crate::support::{Ran, sutura, sutura_in};
use std::path::Path;

/// A scene on `mesh.msh` in the same directory.
const SCENE: &str = "\
[mesh]
file = \"mesh.msh\"
scale_to_m = 0.001

[tissue]
youngs_modulus_pa = 3000.0
poisson_ratio = 0.4

[[fixed]]
plane = { axis = \"z\", at_m = 0.0 }

[[handle]]
vertices = [3]
barycentric = [1.0]
target_displacement_m = [0.0, 0.0, -0.0001]
";

/// gmsh 2.2, one tetrahedron of 1 mm; `element` is its node list, `extra` more nodes.
fn mesh(element: &str, extra: &[&str]) -> String {
    let corners = ["1 0 0 0", "2 1 0 0", "3 0.1 1 0", "4 0.2 0.3 1.5"];
    let nodes: Vec<&str> = corners.iter().chain(extra).copied().collect();
    format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n{}\n$EndNodes\n\
         $Elements\n1\n77 4 2 0 1 {element}\n$EndElements\n",
        nodes.len(),
        nodes.join("\n")
    )
}

fn solve(scene: &str, mesh: Option<&str>) -> Ran {
    let directory = tempfile::tempdir().expect("a directory");
    let write = |name: &str, text: &str| {
        std::fs::write(directory.path().join(name), text).expect("writable");
    };
    write("scene.toml", scene);
    if let Some(mesh) = mesh {
        write("mesh.msh", mesh);
    }
    let ran = sutura_in(
        directory.path(),
        &["solve", "scene.toml", "--out", "out.json"],
    );
    assert_eq!(
        directory.path().join("out.json").is_file(),
        ran.code == 0,
        "{}",
        ran.stderr
    );
    ran
}

fn refused(ran: &Ran, said: &[&str]) {
    assert_eq!(ran.code, 2, "{}{}", ran.stdout, ran.stderr);
    for words in said {
        assert!(
            ran.stderr.contains(words),
            "no \"{words}\" in:\n{}",
            ran.stderr
        );
    }
    assert!(ran.stdout.is_empty(), "results on stdout: {}", ran.stdout);
}

#[test]
fn the_good_scene_of_these_tests_is_good() {
    let ran = solve(SCENE, Some(&mesh("1 2 3 4", &[])));
    assert_eq!(ran.code, 0, "{}", ran.stderr);
}

#[test]
fn a_misspelt_key_is_shown_at_its_line_with_the_right_one() {
    let ran = solve(
        &SCENE.replace("poisson", "poison"),
        Some(&mesh("1 2 3 4", &[])),
    );
    refused(
        &ran,
        &[
            "unknown key `poison_ratio`",
            "scene.toml:7:1",
            "did you mean `poisson_ratio`?",
        ],
    );
}

#[test]
fn a_negative_modulus_is_shown_at_its_value() {
    let ran = solve(
        &SCENE.replace("3000.0", "-3000.0"),
        Some(&mesh("1 2 3 4", &[])),
    );
    refused(
        &ran,
        &[
            "youngs_modulus_pa = -3000: must be positive",
            "scene.toml:6:21",
        ],
    );
}

#[test]
fn an_inverted_element_is_named_by_the_number_in_its_file() {
    let ran = solve(SCENE, Some(&mesh("2 1 3 4", &[])));
    refused(
        &ran,
        &["mesh.msh", "element 77", "inverted", "scene.toml:2:8"],
    );
}

#[test]
fn an_unreferenced_node_is_named_by_the_number_in_its_file() {
    let ran = solve(SCENE, Some(&mesh("1 2 3 4", &["99 2 2 2"])));
    refused(&ran, &["mesh.msh", "node 99", "belongs to no tetrahedron"]);
}

#[test]
fn a_missing_mesh_is_shown_where_the_scene_names_it() {
    refused(
        &solve(SCENE, None),
        &[
            "cannot read the mesh mesh.msh",
            "No such file",
            "scene.toml:2:8",
        ],
    );
}

#[test]
fn a_missing_scene_is_named() {
    refused(
        &sutura(&["solve", "scenes/none.toml", "--out", "x.json"]),
        &["cannot read scenes/none.toml"],
    );
}

#[test]
fn tissue_that_can_float_away_is_refused() {
    let scene = SCENE.replace("plane = { axis = \"z\", at_m = 0.0 }", "nodes = [0]");
    refused(
        &solve(&scene, Some(&mesh("1 2 3 4", &[]))),
        &["the stiffness matrix is singular", "[[fixed]]"],
    );
}

#[test]
fn a_scene_with_nothing_to_solve_says_what_could_be_added() {
    let scene = SCENE.split("[[handle]]").next().expect("the part before");
    refused(
        &solve(scene, Some(&mesh("1 2 3 4", &[]))),
        &["nothing to solve", "add a `[[handle]]`"],
    );
}

#[test]
fn a_wrong_extension_is_refused_before_anything_is_read() {
    let ran = sutura(&["solve", "scenes/none.toml", "--out", "field.csv"]);
    refused(&ran, &["field.csv: not a result format", ".json or .vtu"]);
}

#[test]
fn a_result_that_cannot_be_written_is_told() {
    let ran = sutura(&[
        "solve",
        "scenes/cube-handle.toml",
        "--out",
        "no/such/place.json",
    ]);
    refused(&ran, &["cannot write no/such/place.json", "No such file"]);
    assert!(!Path::new("no").exists());
}

#[test]
fn a_wrong_flag_is_refused_with_the_usage() {
    refused(
        &sutura(&["solve", "--quickly"]),
        &["unexpected argument '--quickly'", "--help"],
    );
    refused(
        &sutura(&["slove"]),
        &["unrecognized subcommand 'slove'", "solve"],
    );
}

#[test]
fn a_failure_is_one_json_object_when_asked_for() {
    let ran = sutura(&[
        "--format",
        "json",
        "solve",
        "scenes/none.toml",
        "--out",
        "x.json",
    ]);
    assert_eq!(ran.code, 2);
    let object: serde_json::Value = serde_json::from_str(&ran.stdout).expect("one JSON object");
    assert_eq!(object["status"], "bad-input");
    assert_eq!(object["exit_code"], 2);
    assert!(
        object["message"]
            .as_str()
            .expect("text")
            .contains("scenes/none.toml")
    );
}

#[test]
fn every_command_has_help_with_examples() {
    for command in ["run", "console", "solve", "bench", "mesh"] {
        let ran = sutura(&[command, "--help"]);
        assert_eq!(ran.code, 0, "{command}: {}", ran.stderr);
        assert!(
            ran.stdout.contains("Examples:"),
            "{command} has no examples"
        );
        assert!(
            ran.stdout.contains(&format!("sutura {command}")),
            "{command}"
        );
    }
}

/// A line that is not understood is an object too, when it asks for JSON; help is no failure.
#[test]
fn bad_usage_is_one_object_when_json_is_asked_for() {
    for line in [
        &["solve", "--format", "json"][..],
        &["--format=json", "run", "--nonsense"],
        &["sing", "--format", "json"],
        &["run", "--seconds", "no", "--format", "json"],
    ] {
        let ran = sutura(line);
        assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
        let object: serde_json::Value = serde_json::from_str(&ran.stdout).expect("one JSON object");
        assert_eq!(object["status"], "bad-input");
        assert_eq!(object["exit_code"], 2);
        let message = object["message"].as_str().expect("a message");
        assert!(
            ran.stderr
                .contains(message.split(['\'', ':']).next().unwrap_or("")),
            "{message}"
        );
        assert!(
            object["help"]
                .as_str()
                .is_some_and(|help| help.contains("--help")),
            "{object}"
        );
    }
    let ran = sutura(&["run", "--nonsense"]);
    assert_eq!((ran.code, ran.stdout.as_str()), (2, ""));
    let ran = sutura(&["solve", "--help", "--format", "json"]);
    assert_eq!(ran.code, 0);
    assert!(ran.stdout.contains("Usage:"), "{}", ran.stdout);
}

/// More than there is memory for is refused in words, before it is begun; it used to end in an abort of the allocator.
#[cfg(target_os = "linux")]
#[test]
fn a_mesh_beyond_the_free_memory_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = std::fs::read_to_string(crate::support::root().join("scenes/palpation.toml"))
        .expect("a scene");
    let large = scene.replace("divisions = [20, 20, 8]", "divisions = [36, 36, 18]");
    assert_ne!(large, scene);
    let file = folder.path().join("large.toml");
    std::fs::write(&file, large).expect("a file");
    for tissue in ["linear", "corotational", "hyperelastic"] {
        let line = format!(
            "ulimit -v 600000; exec {} run {} --lockstep --seconds 0.01 --tissue {tissue} --format json",
            env!("CARGO_BIN_EXE_sutura"),
            file.display()
        );
        let output = std::process::Command::new("sh")
            .args(["-c", &line])
            .output()
            .expect("a shell");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{tissue}: {stderr}");
        for part in ["GB of memory", "is free"] {
            assert!(stderr.contains(part), "{tissue}: {stderr}");
        }
        let object: serde_json::Value =
            serde_json::from_slice(&output.stdout).expect("one JSON object");
        assert_eq!(object["status"], "bad-input", "{tissue}");
    }
}

/// A rate that no session can have is said before a port is opened: some boards start anew with that.
#[test]
fn a_rate_that_is_too_low_is_refused_before_the_console_is_looked_for() {
    const NOWHERE: [&str; 3] = ["run", "--console", "/dev/does-not-exist"];
    let refused = |ran: &Ran| {
        assert_eq!(ran.code, 2, "{}", ran.stderr);
        assert!(ran.stderr.contains("--host-hz 14"), "{}", ran.stderr);
    };
    refused(&sutura(&[&NOWHERE[..], &["--host-hz", "5"]].concat()));
    let directory = tempfile::tempdir().expect("a directory");
    let scene = directory.path().join("slow.toml");
    // The mesh that it names is not there: that it is slow is known before.
    let text = format!("{SCENE}\n[host]\nhost_hz = 5.0\n");
    std::fs::write(&scene, text).expect("writable");
    let scene = scene.to_str().expect("a path in letters");
    refused(&sutura(&[&NOWHERE[..], &[scene]].concat()));
    // With another rate it is the port.
    let ran = sutura(&[&NOWHERE[..], &[scene, "--host-hz", "20"]].concat());
    assert_eq!(ran.code, 3, "{}", ran.stderr);
}
