//! `sutura stability` from end to end, in its short form.

use crate::support::sutura;
use serde_json::Value;

fn report(only: &str) -> Vec<Value> {
    let output = sutura(&["stability", "--only", only, "--format", "json"]);
    assert_eq!(output.code, 0, "{}\n{}", output.stdout, output.stderr);
    let report: Value = serde_json::from_str(&output.stdout).expect("one object");
    assert_eq!(report["status"], "ok");
    report["cases"].as_array().expect("cases").clone()
}

/// The worst of each kind for every model: nothing but the three outcomes, and reasons where there must be.
#[test]
fn no_model_has_a_defect() {
    let output = sutura(&["stability", "--format", "json"]);
    assert_eq!(output.code, 0, "{}\n{}", output.stdout, output.stderr);
    let report: Value = serde_json::from_str(&output.stdout).expect("one object");
    let cases = report["cases"].as_array().expect("cases");
    assert!(cases.len() >= 60, "{}", cases.len());
    for case in cases {
        for key in ["tissue", "what", "value", "outcome", "note"] {
            assert!(!case[key].is_null(), "{key}: {case}");
        }
        assert!(case.get("largest_stable").is_some(), "{case}");
        let noted = !case["note"].as_str().expect("a note").is_empty();
        match case["outcome"].as_str().expect("a word") {
            "stable" => assert!(!noted, "{case}"),
            "degraded" | "refused" => assert!(noted, "{case}"),
            other => panic!("{other}: {case}"),
        }
    }
}

/// What must hold whatever else changes: corotational tissue turns freely, rows may have any unit.
#[test]
fn what_is_known_to_be_stable() {
    for only in ["corotational turn", "rows unit"] {
        for case in report(only) {
            assert_eq!(case["outcome"], "stable", "{case}");
        }
    }
    // Linear tissue cannot turn, and the criteria see it.
    for case in report("linear turn") {
        assert_ne!(case["outcome"], "defect", "{case}");
    }
}

#[test]
fn words_that_nothing_has_are_refused() {
    let output = sutura(&["stability", "--only", "linear nonsense"]);
    assert_eq!(output.code, 2, "{}", output.stderr);
    assert!(output.stderr.contains("nonsense"), "{}", output.stderr);
}
