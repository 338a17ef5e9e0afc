//! `sutura bench` from end to end, on a scene small enough for a test.

use crate::support::described::assert_described;
use crate::support::{sutura, sutura_in};
use serde_json::Value;

/// A coarse slab, pressed 2 mm deep and left again within a fifth of a second.
const SCENE: &str = r#"
name = "small"
seconds = 0.2
device = "cartesian-bench"

[mesh.slab]
size_m = [0.04, 0.04, 0.02]
divisions = [8, 8, 4]

[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.02 }

[[tool]]
radius_m = 0.018

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [
    { time_s = 0.0, position_m = [0.0, 0.0, 0.022] },
    { time_s = 0.1, position_m = [0.0, 0.0, 0.016] },
    { time_s = 0.2, position_m = [0.0, 0.0, 0.022] },
]
"#;

#[test]
fn a_case_counts_what_it_did_and_its_times_are_consistent() {
    let directory = tempfile::tempdir().expect("a directory");
    std::fs::write(directory.path().join("small.toml"), SCENE).expect("writable");
    let ran = sutura_in(
        directory.path(),
        &["bench", "small.toml", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report: Value = serde_json::from_str(&ran.stdout).expect("one JSON object");
    assert_described("bench", &report);
    assert_eq!(report["status"], "ok");
    assert!(report["machine"]["threads"].as_u64() >= Some(1));
    let case = &report["cases"][0];
    assert_eq!(case["scene"], "small");
    assert_eq!(case["tissue"], "linear");
    assert_eq!(case["nodes"], 9 * 9 * 5);
    assert_eq!(case["cells"], 6 * 8 * 8 * 4);
    // 40 steps, of which the path spends the middle in contact.
    let steps = case["steps"].as_u64().expect("a count");
    assert!((5..40).contains(&steps), "{steps}");
    assert_eq!(case["steps_not_ok"], 0);
    assert!(case["rows"].as_u64() >= Some(1));
    let number = |value: &Value| value.as_f64().expect("a number");
    let step = &case["step_us"];
    assert!(number(&step["p50"]) <= number(&step["p99"]));
    assert!(number(&step["p99"]) <= number(&step["max"]));
    // All that a session's solver does, over all phases: the second of which the mean is largest is among them.
    let session = &case["session_us"];
    assert!(number(&session["p50"]) <= number(&session["p99"]));
    assert!(number(&session["p99"]) <= number(&session["max"]));
    let worst = number(&case["worst_second_us"]);
    assert!(worst > 0.0 && worst <= number(&session["max"]), "{case}");
    for key in ["field_us", "factor_ms", "first_touch_us", "memory_mb"] {
        assert!(number(&case[key]) > 0.0, "{key}");
    }
    for stage in ["detect", "columns", "solve", "reduce"] {
        assert!(number(&case["stages_us"][stage]) >= 0.0, "{stage}");
    }
}

#[test]
fn a_scene_without_a_hand_cannot_be_walked() {
    let ran = sutura(&["bench", "scenes/cube-handle.toml"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("has no hand"), "{}", ran.stderr);
}

/// The suite itself is for release builds; what it is asked for is checked in any.
#[test]
fn a_part_of_the_suite_that_is_not_there_is_said() {
    let ran = sutura(&["bench", "--suite", "--only", "skating"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("`skating`"), "{}", ran.stderr);
    assert!(ran.stderr.contains("`sliding on`"), "{}", ran.stderr);
    let ran = sutura(&["bench", "--only", "sliding"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("--suite"), "{}", ran.stderr);
}
