//! `sutura fidelity` from end to end, on its cheapest cases.

use crate::support::described::assert_described;
use crate::support::sutura;
use serde_json::Value;

#[test]
fn cases_bars_and_files() {
    let directory = tempfile::tempdir().expect("a directory");
    let files = directory.path().to_str().expect("a path");
    let output = sutura(&[
        "fidelity",
        "--only",
        "return point outage-300-ms pen",
        "--plot",
        files,
        "--format",
        "json",
    ]);
    assert_eq!(output.code, 0, "{}", output.stderr);
    let report: Value = serde_json::from_str(&output.stdout).expect("one object");
    assert_described("fidelity", &report);
    assert_eq!(report["extent"], "short");
    let cases = report["cases"].as_array().expect("cases");
    assert_eq!(cases.len(), 2);
    for case in cases {
        for key in [
            "rendering",
            "host_hz",
            "delay_ms",
            "loss",
            "tangent_scale",
            "energy_min_j",
            "past_rest_mm",
        ] {
            assert!(!case[key].is_null(), "{key}: {case}");
        }
        assert_eq!(case["question"], "return");
    }
    let bars = report["bars"].as_array().expect("bars");
    assert_eq!(bars.len(), 7, "{bars:?}");
    let table = std::fs::read_to_string(directory.path().join("cases.csv")).expect("a table");
    let lines: Vec<_> = table.lines().collect();
    assert_eq!(lines.len(), 3, "{table}");
    let columns = lines[0].split(',').count();
    assert!(columns > 15 && lines.iter().all(|line| line.split(',').count() == columns));
    for name in ["fidelity.json", "bars.csv"] {
        assert!(directory.path().join(name).exists(), "{name}");
    }
}

#[test]
fn words_that_no_case_has_are_refused() {
    let output = sutura(&["fidelity", "--only", "palpation nonsense"]);
    assert_eq!(output.code, 2, "{}", output.stderr);
    assert!(output.stderr.contains("nonsense"), "{}", output.stderr);
}
