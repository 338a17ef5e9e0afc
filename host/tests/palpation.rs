//! The palpation scene's deepest point against an independent solution.

use serde_json::Value;
use std::path::PathBuf;
use sutura_host::scene;
use sutura_host::step::{Status, StepOptions, step};
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
    let scene = scene::load(&path("scenes/palpation-frictionless.toml")).expect("the scene");
    let (model, mut state, mut work) = scene.build().expect("a model");
    let options = StepOptions::with_vertices(usize::MAX);
    let tool = scene.tools[0].id;
    let mut press = |position_m: [f64; 3]| {
        let sample = ToolSample {
            id: tool,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: 0,
        };
        step(&model, &mut state, &[sample], &options, &mut work)
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

/// The palpation scene's hand on corotational tissue, a step every host period without a console: every
/// step has a contact, but for those that wait for columns of a new factor.
#[test]
fn corotational_tissue_follows_the_scenes_hand() {
    let text =
        std::fs::read_to_string(path("scenes/palpation-frictionless.toml")).expect("the scene");
    let text = text.replace("model = \"linear\"", "model = \"corotational\"");
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("palpation-corotational.toml");
    std::fs::write(&file, text).expect("a file");
    let scene = scene::load(&file).expect("the scene");
    let (model, mut state, mut work) = scene.build().expect("a model");
    let options = StepOptions::default();
    let hand = scene.hand.expect("a hand");
    let (mut waiting, mut touching, mut refactorisations) = (0, 0, 0);
    let (mut times, mut stages) = (Vec::new(), [0.0; 5]);
    let (mut error, mut imbalance) = (0.0f64, 0.0f64);
    // The first two presses.
    for number in 0..(2.6 * scene.host.host_hz) as u32 {
        let time_s = f64::from(number) / scene.host.host_hz;
        let mut position_m = scene::position_at(&hand, time_s);
        // The hand is a spring that gives way: about as far in as in a session.
        position_m[2] = position_m[2].max(0.006);
        let sample = ToolSample {
            id: scene.tools[0].id,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: 0,
        };
        let started = std::time::Instant::now();
        let report = step(&model, &mut state, &[sample], &options, &mut work);
        times.push(started.elapsed().as_secs_f64() * 1e3);
        refactorisations += report.refactorisations;
        let s = report.stages;
        for (sum, ns) in stages.iter_mut().zip([
            s.tissue_ns,
            s.detect_ns,
            s.columns_ns,
            s.solve_ns,
            s.field_ns,
            s.reduce_ns,
        ]) {
            *sum += ns as f64 * 1e-6;
        }
        match report.status {
            Status::Ok => {
                touching += u32::from(report.rows > 0);
                error = error.max(report.tangent_error);
                imbalance = imbalance.max(report.imbalance);
            }
            Status::Waiting => waiting += 1,
            other => panic!("{other:?} at {time_s} s: {report:?}"),
        }
    }
    times.sort_by(f64::total_cmp);
    println!(
        "ms in tissue, detect, columns, solve, reduce: {stages:.0?}; {touching} steps in contact, {waiting} waiting, {refactorisations} refactorisations; ms p50 {:.2} \
         p99 {:.2} max {:.2}; tangent error {error:.2}, imbalance {imbalance:.3}",
        times[times.len() / 2],
        times[times.len() * 99 / 100],
        times[times.len() - 1]
    );
    assert!(touching > 200, "{touching}");
    assert!(waiting < touching / 4, "{waiting}");
}
