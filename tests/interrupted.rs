//! What is left of a table of which the making is interrupted, or that a full disk takes no more of.
#![cfg(unix)]

use crate::support::described::assert_described;
use crate::support::{Ran, ran, sutura};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Three tables, by words that choose many quick lines.
const TABLES: [(&str, &[&str]); 3] = [
    ("tradeoff", &["--only", "beam-tension", "--errors"]),
    ("stability", &["--full", "--only", "chainmail"]),
    ("fidelity", &["--only", "return point", "--threads", "1"]),
];

fn table(at: &Path, name: &str, words: &[&str]) -> Command {
    let mut table = Command::new(env!("CARGO_BIN_EXE_sutura"));
    table.arg(name).args(words);
    table
        .args(["--plot", "out", "--format", "json"])
        .current_dir(at);
    table
}

/// Sends it Ctrl-C when its first line is kept.
fn interrupted(at: &Path, mut table: Command) -> Ran {
    let table = table.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let table = table.expect("it starts");
    let kept = at.join("out/cases.jsonl");
    while std::fs::metadata(&kept).map_or(0, |file| file.len()) == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let id = table.id().to_string();
    let told = Command::new("kill").args(["-INT", &id]).status();
    assert!(told.is_ok_and(|told| told.success()));
    let output = table.wait_with_output().expect("it ends");
    let text = |bytes| String::from_utf8(bytes).expect("output is text");
    Ran {
        code: output.status.code().expect("it ends by itself"),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

/// Ctrl-C in the middle: the lines by then are printed and written, and nothing says that the table is whole.
#[test]
fn interrupted_tables_keep_what_they_had() {
    for (name, words) in TABLES {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        let ran = interrupted(at, table(at, name, words));
        assert_eq!(ran.code, 130, "{name}: {}", ran.stderr);
        let printed = ran.json();
        assert_described(name, &printed);
        assert_eq!(printed["status"], "interrupted");
        let lines = printed["cases"].as_array().expect("lines").len();
        let said = format!("interrupted: the table has the {lines} lines by then");
        assert!(ran.stderr.contains(&said), "{name}: {}", ran.stderr);
        let read =
            |file: &str| std::fs::read_to_string(at.join("out").join(file)).expect("written");
        let written: Value = serde_json::from_str(&read(&format!("{name}.json"))).expect("JSON");
        assert_eq!(written["cases"], printed["cases"], "{name}");
        assert_eq!(read("cases.jsonl").lines().count(), lines, "{name}");
        if name == "tradeoff" {
            let merged = sutura(&[
                "tradeoff",
                "merge",
                &at.join("out/tradeoff.json").display().to_string(),
            ]);
            let words = "it was interrupted: measure this share again";
            assert!(
                merged.code == 2 && merged.stderr.contains(words),
                "{}",
                merged.stderr
            );
        }
    }
}

/// Files that may not grow stand in for a full disk: the table is printed all the same.
#[test]
fn a_full_disk_takes_no_table() {
    let tables: [(&str, &str); 3] = [
        ("tradeoff", "beam-tension linear"),
        ("stability", "linear turn"),
        ("fidelity", "return point outage-300-ms pen rows"),
    ];
    for (name, only) in tables {
        let folder = tempfile::tempdir().expect("a folder");
        let line = format!(
            "trap '' XFSZ; ulimit -f 0; exec {} {name} --only '{only}' --plot out --format json",
            env!("CARGO_BIN_EXE_sutura")
        );
        let ran = ran(Command::new("sh")
            .args(["-c", &line])
            .current_dir(folder.path()));
        assert_eq!(ran.code, 1, "{name}: {}", ran.stderr);
        let said = format!("cannot write out/{name}.json: ");
        assert!(ran.stderr.contains(&said), "{name}: {}", ran.stderr);
        assert!(ran.json()["cases"].is_array(), "{name}: {}", ran.stdout);
        assert_eq!(ran.json()["status"], "failed", "{name}: {}", ran.stdout);
    }
}
