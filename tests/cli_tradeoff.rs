//! `sutura tradeoff` from end to end, on its cheapest cases.

use crate::support::described::assert_described;
use crate::support::sutura;
use serde_json::Value;

#[test]
fn lines_fronts_and_files() {
    let directory = tempfile::tempdir().expect("a directory");
    let files = directory.path().to_str().expect("a path");
    let output = sutura(&[
        "tradeoff", "--only", "beam", "--plot", files, "--format", "json",
    ]);
    assert_eq!(output.code, 0, "{}", output.stderr);
    let report: Value = serde_json::from_str(&output.stdout).expect("one object");
    assert_described("tradeoff", &report);
    assert_eq!(report["extent"], "short");
    let cases = report["cases"].as_array().expect("cases");
    for case in cases {
        for key in ["case", "tissue", "settings", "nodes", "cells", "pareto"] {
            assert!(!case[key].is_null(), "{key}: {case}");
        }
        for key in [
            "step_us",
            "disp_rms_pct",
            "disp_max_pct",
            "force_pct",
            "red_line_pct",
            "truth_disp_rms_pct",
        ] {
            assert!(case.get(key).is_some(), "{key}: {case}");
        }
    }
    let line = |case: &str, tissue: &str, words: &str| {
        let found = cases.iter().find(|line| {
            line["case"] == case
                && line["tissue"] == tissue
                && line["settings"]
                    .as_str()
                    .is_some_and(|own| own.contains(words))
        });
        found
            .unwrap_or_else(|| panic!("{case} {tissue} {words}"))
            .clone()
    };
    let pct = |line: &Value, key: &str| line[key].as_f64().expect("a number");

    // The worst of what a hand meets: late, elsewhere, or with another force.
    for case in cases {
        let parts = ["arrival_rms_pct", "truth_disp_rms_pct", "truth_force_pct"];
        let worst = parts
            .map(|key| pct(case, key))
            .into_iter()
            .fold(0.0, f64::max);
        assert_eq!(pct(case, "error_pct"), worst, "{case}");
    }
    // What moves in time has gone nowhere yet when the load has come, and comes to rest later.
    for case in ["beam-tension", "beam-bending"] {
        let late = line(case, "chainmail-ellipsoid", "");
        assert!(pct(&late, "arrival_rms_pct") > 90.0, "{late}");
        assert!(pct(&late, "truth_disp_rms_pct") < 50.0, "{late}");
    }

    // The same balance by another way: Newton's own error is its tolerance.
    for case in ["beam-tension", "beam-bending"] {
        let newton = line(case, "hyperelastic", "linear cells");
        assert!(pct(&newton, "disp_rms_pct") < 0.1, "{newton}");
    }
    // In small strain all laws are one; what linear cells lock is the mesh's error, not the law's.
    let linear = line("beam-tension", "linear", "");
    // Along the edge: across it this mesh, one cube wide, bends as it is pulled, each law by another amount.
    assert!(pct(&linear, "red_line_pct") < 5.0, "{linear}");
    assert!(pct(&linear, "truth_disp_rms_pct") > pct(&linear, "disp_rms_pct"));
    // A load is carried, whoever carries it.
    for tissue in ["linear", "corotational", "hyperelastic"] {
        let line = line("beam-tension", tissue, "");
        assert!(pct(&line, "force_pct") < 1.0, "{line}");
    }
    // Large rotations: linear tissue is off, corotational is not.
    let bent = line("beam-bending", "corotational", "1e-10");
    assert!(pct(&bent, "disp_rms_pct") < 5.0, "{bent}");

    let truths = report["truths"].as_array().expect("answers");
    assert_eq!(truths.len(), 2);
    let fronts = cases.iter().filter(|case| case["pareto"] == true);
    assert!(fronts.count() >= 2);
    let best = report["best"].as_array().expect("a table");
    assert_eq!(best.len(), 8);
    assert!(report["literature"].as_array().expect("figures").len() > 10);

    let table = std::fs::read_to_string(directory.path().join("tradeoff.csv")).expect("a table");
    assert_eq!(table.lines().count(), cases.len() + 1);
    for name in [
        "tradeoff.json",
        "tradeoff-best.csv",
        "tradeoff-truths.csv",
        "tradeoff-beam-bending.svg",
    ] {
        assert!(directory.path().join(name).exists(), "{name}");
    }
}

/// One bite, closed on three tissues and two meshes.
#[test]
fn a_suture_is_closed_on_every_tissue_that_needles_go_through() {
    let directory = tempfile::tempdir().expect("a directory");
    let files = directory.path().to_str().expect("a path");
    let output = sutura(&[
        "tradeoff",
        "--only",
        "suture-closed",
        "--plot",
        files,
        "--format",
        "json",
    ]);
    assert_eq!(output.code, 0, "{}", output.stderr);
    let report: Value = serde_json::from_str(&output.stdout).expect("one object");
    assert_eq!(report["cases"], serde_json::json!([]));
    let rows = report["sutures"].as_array().expect("lines");
    let number = |row: &Value, key: &str| row[key].as_f64().expect("a number");
    for tissue in ["linear", "corotational", "hyperelastic"] {
        let own: Vec<_> = rows.iter().filter(|row| row["tissue"] == tissue).collect();
        assert_eq!(own.len(), 2, "{rows:?}");
        for row in &own {
            assert_eq!(row["outcome"], "converged", "{row}");
            // It closes, it is taut, and less is drawn out than the hands go, as the tissue gives way.
            let gap = number(row, "gap_ratio");
            assert!((0.05..0.9).contains(&gap), "{row}");
            assert!((0.02..5.0).contains(&number(row, "tension_n")), "{row}");
            let pulled_m = number(row, "pulled_m");
            assert!((0.001..0.006).contains(&pulled_m), "{row}");
            assert!(number(row, "p99_us") >= number(row, "step_us"), "{row}");
        }
        assert!(number(own[1], "cells") > 2.0 * number(own[0], "cells"));
        // All are off the truth but that itself.
        let off = own.iter().filter(|row| row["error_pct"].is_f64()).count();
        assert_eq!(off, if tissue == "hyperelastic" { 1 } else { 2 });
    }
    let table = std::fs::read_to_string(directory.path().join("tradeoff-sutures.csv"));
    assert_eq!(table.expect("a table").lines().count(), rows.len() + 1);
    assert!(directory.path().join("tradeoff-suture-closed.svg").exists());
}

#[test]
fn lines_stream_as_they_are_measured() {
    let output = sutura(&[
        "tradeoff",
        "--only",
        "cube-sheared linear",
        "--stream",
        "--format",
        "json",
    ]);
    assert_eq!(output.code, 0, "{}", output.stderr);
    let objects: Vec<Value> = output
        .stdout
        .lines()
        .map(|line| serde_json::from_str(line).expect("an object"))
        .collect();
    let last = objects.last().expect("a report");
    assert_eq!(
        last["cases"].as_array().expect("cases").len() + 1,
        objects.len()
    );
    assert_eq!(objects[0]["case"], "cube-sheared");
}

#[test]
fn words_that_nothing_has_are_refused() {
    let output = sutura(&["tradeoff", "--only", "beam nonsense"]);
    assert_eq!(output.code, 2, "{}", output.stderr);
    assert!(output.stderr.contains("nonsense"), "{}", output.stderr);
}

/// Shares, measured apart, are the table of one process; those of two machines are told apart by name.
#[test]
fn shares_are_merged_into_one_table_or_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = |name: &str| directory.path().join(name).display().to_string();
    let words = ["tradeoff", "--only", "beam linear", "--errors"];
    let measured = |more: &[&str]| {
        let arguments = [&words[..], &["--format", "json"], more].concat();
        let output = sutura(&arguments);
        assert_eq!(output.code, 0, "{}", output.stderr);
        output.stdout
    };
    for number in ["1", "2"] {
        let text = measured(&["--cases", &format!("{number}/2")]);
        std::fs::write(path(number), text).expect("a file");
    }
    let (first, second, both) = (path("1"), path("2"), path("both"));
    let merge = ["tradeoff", "merge", &first, &second];
    let merged = sutura(&[&merge[..], &["--plot", &both, "--format", "json"]].concat());
    assert_eq!(merged.code, 0, "{}", merged.stderr);
    let table: Value = serde_json::from_str(&merged.stdout).expect("one object");
    assert_described("tradeoff", &table);
    let whole: Value = serde_json::from_str(&measured(&[])).expect("one object");
    for key in ["cases", "truths", "best", "sutures", "literature", "extent"] {
        assert_eq!(table[key], whole[key], "{key}");
    }
    let lines = table["cases"].as_array().expect("lines");
    assert!(lines.iter().all(|line| line["step_us"].is_null()));
    assert!(lines.iter().any(|line| line["error_pct"].is_f64()));
    let csv = std::fs::read_to_string(directory.path().join("both/tradeoff.csv"));
    assert_eq!(csv.expect("a table").lines().count(), lines.len() + 1);
    let text = sutura(&merge).stdout;
    assert!(
        text.contains("1/2") && text.contains("beam-bending"),
        "{text}"
    );

    let share = std::fs::read_to_string(&second).expect("a share");
    let mut other: Value = serde_json::from_str(&share).expect("an object");
    other["made"][0]["machine"]["host"] = "elsewhere".into();
    std::fs::write(&second, other.to_string()).expect("a file");
    // Errors alone are the same everywhere; times are not.
    assert_eq!(sutura(&merge).code, 0);
    for path in [&first, &second] {
        let text = std::fs::read_to_string(path).expect("a share");
        let timed = text.replace("\"timed\":false", "\"timed\":true");
        std::fs::write(path, timed).expect("a file");
    }
    let refused = sutura(&merge);
    assert_eq!(refused.code, 2, "{}", refused.stdout);
    for word in [
        "are not of one table: the machine is `",
        "`elsewhere` (",
        "times of two machines make no front",
    ] {
        assert!(refused.stderr.contains(word), "{word}: {}", refused.stderr);
    }
    let alone = sutura(&["tradeoff", "merge", &first]);
    assert_eq!(alone.code, 2);
    assert!(
        alone.stderr.contains("of the 2 shares 2/2 are missing"),
        "{}",
        alone.stderr
    );
    let nothing = sutura(&["tradeoff", "--only", "beam", "--cases", "3/2"]);
    assert!(
        nothing.stderr.contains("give I/N with I from 1 to N"),
        "{}",
        nothing.stderr
    );
}
