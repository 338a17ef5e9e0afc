//! The palpation scene's deepest point against an independent solution.

use serde_json::Value;
use std::path::PathBuf;
use sutura_host::scene;
use sutura_host::step::{Status, step};
use sutura_host::tool::ToolSample;

fn path(relative: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(relative)
}

fn numbers(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|axis: usize| value[axis].as_f64().expect("a number"))
}

/// Origin: tests/reference/palpation_peak.py, which solves for force and position together; here the
/// position is given. A scene that has changed since then fails: run the script again.
#[test]
fn the_deepest_point_agrees_with_scikit_fem() {
    let text = std::fs::read_to_string(path("tests/data/palpation-peak.json")).expect("the file");
    let expected: Value = serde_json::from_str(&text).expect("JSON");
    let scene = scene::load(&path("scenes/palpation.toml")).expect("the scene");
    let (model, mut state, mut work) = scene.build().expect("a model");
    work.vertices_per_step = usize::MAX;
    let tool = scene.tools[0].id;
    let mut press = |position_m: [f64; 3]| {
        let sample = ToolSample {
            id: tool,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: 0,
        };
        step(&model, &mut state, &[sample], &mut work)
    };
    assert_eq!(press([0.0, 0.0, 0.03]).rows, 0);
    let report = press(numbers(&expected["position_m"]));
    assert_eq!(report.status, Status::Ok);
    let force = &report.contacts()[0].wrench[..3];
    let target = numbers(&expected["force_on_tool_n"]);
    let scale = expected["force_n"].as_f64().expect("a number");
    let error = (0..3)
        .map(|axis| (force[axis] - target[axis]).abs())
        .fold(0.0, f64::max)
        / scale;
    println!("force {force:?} N, expected {target:?} N: off by {error:.1e}");
    assert!(error < 1e-6, "off by {error:e}");
    assert_eq!(
        Some(u64::from(report.rows)),
        expected["touched_vertices"].as_u64()
    );
    let energy = expected["stored_energy_j"].as_f64().expect("a number");
    assert!((report.stored_energy_j / energy - 1.0).abs() < 1e-6);
}
