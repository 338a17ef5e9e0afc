//! Keys of what commands print: those that `sutura schema` describes, which are those of the book's tables.

use crate::support::described::assert_described;
#[cfg(unix)]
use crate::support::ran;
use crate::support::{root, sutura, sutura_in};
use serde_json::Value;
use std::collections::BTreeSet;

/// Every name that `sutura schema` has.
fn names() -> BTreeSet<String> {
    let names = sutura(&["schema", "--format", "json"]).json();
    let names = names["names"].as_array().expect("names");
    names
        .iter()
        .map(|name| name.as_str().expect("a name").to_owned())
        .collect()
}

/// Between its marks a page has what the command prints now, and every name has its place in the book.
#[test]
fn the_books_tables_are_those_of_the_types() {
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(root().join("docs/src")).expect("readable") {
        let path = entry.expect("readable").path();
        if path.extension().is_none_or(|end| end != "md") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("readable");
        for part in text.split("<!-- schema ").skip(1) {
            let (name, rest) = part.split_once(" -->").expect("a mark ends");
            let end = format!("<!-- /schema {name} -->");
            let (table, _) = rest.split_once(&end).expect("a mark has its end");
            let printed = sutura(&["schema", name]);
            assert_eq!(printed.code, 0, "{}", printed.stderr);
            assert_eq!(
                table.trim(),
                printed.stdout.trim(),
                "{}: run `cargo xtask book --tables`",
                path.display()
            );
            found.insert(name.to_owned());
        }
    }
    assert_eq!(found, names());
}

/// Sessions with and without needles, threads and jaws, in lockstep.
#[test]
fn a_sessions_summary_has_the_keys_that_are_described() {
    let page = std::fs::read_to_string(root().join("docs/src/output.md")).expect("there");
    let words = page.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let said: BTreeSet<String> = words.map(str::to_owned).collect();
    for (scene, more) in [
        ("scenes/palpation.toml", &["--tissue", "shape-matching"][..]),
        ("scenes/needle-arc.toml", &[]),
        ("scenes/anastomosis-20.toml", &[]),
        ("scenes/jaws-lift.toml", &[]),
        ("scenes/tied-slab.toml", &[]),
    ] {
        let line = [
            "run",
            scene,
            "--lockstep",
            "--seconds",
            "0.3",
            "--format",
            "json",
        ];
        let ran = sutura(&[&line[..], more].concat());
        let summary = ran.json();
        assert_described("run", &summary);
        let unsaid: Vec<_> = keys(&summary["scene"]).difference(&said).cloned().collect();
        assert!(
            unsaid.is_empty(),
            "{scene}: docs/src/output.md does not say {unsaid:?}"
        );
    }
}

/// All keys of an object, and of what is in it; what a scene adds by a key of its own has names of its own.
fn keys(value: &Value) -> BTreeSet<String> {
    match value {
        Value::Object(map) => {
            let inner = map.iter().flat_map(|(key, value)| match key.as_str() {
                "added" => value
                    .as_object()
                    .into_iter()
                    .flatten()
                    .flat_map(|(_, value)| keys(value))
                    .collect(),
                _ => keys(value),
            });
            map.keys().cloned().chain(inner).collect()
        }
        Value::Array(list) => list.iter().flat_map(keys).collect(),
        _ => BTreeSet::new(),
    }
}

/// One in real time has what only that has, and a line each while it runs.
#[cfg(unix)]
#[test]
fn a_session_in_real_time_has_them_too() {
    let ran = sutura(&["run", "--seconds", "0.5", "--stream", "--format", "json"]);
    let mut lines: Vec<_> = ran.stdout.lines().collect();
    let summary = lines.pop().expect("a summary");
    assert_described("run", &serde_json::from_str(summary).expect("an object"));
    assert!(!lines.is_empty());
    for line in lines.iter().take(3) {
        assert_described("run-line", &serde_json::from_str(line).expect("an object"));
    }
}

#[test]
fn commands_that_look_at_files_print_the_keys_that_are_described() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for name in ["scenes", "tests"] {
        #[cfg(unix)]
        std::os::unix::fs::symlink(root().join(name), at.join(name)).expect("a link");
    }
    for (name, line) in [
        (
            "scene-check",
            &["scene", "check", "scenes/palpation.toml"][..],
        ),
        (
            "scene-explain",
            &["scene", "explain", "scenes/palpation.toml"],
        ),
        ("mesh-info", &["mesh", "info", "tests/data/cube_350.msh"]),
        (
            "mesh-info",
            &["mesh", "info", "tests/data/cube_350.msh", "--scale", "1000"],
        ),
        (
            "mesh-convert",
            &[
                "mesh",
                "convert",
                "tests/data/cube_350.msh",
                "--out",
                "a.vtk",
            ],
        ),
        (
            "solve",
            &["solve", "scenes/cube-handle.toml", "--out", "a.json"],
        ),
        (
            "solve",
            &[
                "solve",
                "scenes/needle-slabs.toml",
                "--at",
                "0.5",
                "--out",
                "b.json",
            ],
        ),
        ("failure", &["solve", "scenes/none.toml", "--out", "c.json"]),
        ("failure", &["run", "--nonsense"]),
        ("stability", &["stability", "--only", "linear turn"]),
        (
            "run",
            &[
                "run",
                "--lockstep",
                "--seconds",
                "0.3",
                "--record",
                "a.mcap",
            ],
        ),
        ("replay", &["replay", "a.mcap"]),
    ] {
        let ran = sutura_in(at, &[line, &["--format", "json"]].concat());
        assert_described(name, &ran.json());
    }
    for file in ["a.json", "b.json"] {
        let text = std::fs::read_to_string(at.join(file)).expect("written");
        assert_described("solution", &serde_json::from_str(&text).expect("JSON"));
    }
}

/// A board that tests itself, of which one check fails.
#[cfg(unix)]
#[test]
fn a_self_test_prints_the_keys_that_are_described() {
    use std::time::{Duration, Instant};
    use sutura_host::link::Port;
    const SAID: &[u8] = b"pass reset cause 1, epitaph 0\r\nuntimed clocks 0 cycles\r\nFAIL stop_cuts enable stayed high\r\nend 1 passed\r\n";
    let mut board = sutura_hil::Pty::open().expect("a pseudo-terminal");
    let path = board.path().to_owned();
    let there = std::thread::spawn(move || {
        let began = Instant::now();
        let mut asked = [0; 8];
        while began.elapsed() < Duration::from_secs(60) {
            let count = board.read(&mut asked, Duration::from_millis(50));
            if count.expect("readable") > 0 {
                board.write(SAID).expect("room");
                break;
            }
        }
        board
    });
    let tested = sutura(&["device", "selftest", &path, "--format", "json"]);
    let _board = there.join().expect("it ends");
    assert_eq!(tested.code, 1, "{}", tested.stderr);
    let printed = tested.json();
    assert_described("device-selftest", &printed);
    assert_eq!(printed["failed"], serde_json::json!(["stop_cuts"]));
    let verdicts = ["pass", "untimed", "FAIL"];
    for (check, verdict) in printed["checks"]
        .as_array()
        .expect("a list")
        .iter()
        .zip(verdicts)
    {
        assert_eq!(check["verdict"], verdict);
    }
}

/// Without a console on USB it is a failure, with its keys.
#[test]
fn a_list_of_consoles_is_described_with_and_without_any() {
    let listed = sutura(&["device", "list", "--format", "json"]);
    match listed.code {
        0 => assert_described("device-list", &listed.json()),
        3 => assert_described("failure", &listed.json()),
        code => panic!("exit code {code}: {}", listed.stderr),
    }
}

/// A console of its own says where it is before anything else.
#[cfg(unix)]
#[test]
fn a_console_prints_the_keys_that_are_described() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let folder = tempfile::tempdir().expect("a folder");
    let mut console = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(["console", "--link", "bench", "--format", "json"])
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut line = String::new();
    let mut stdout = BufReader::new(console.stdout.take().expect("a pipe"));
    let read = stdout.read_line(&mut line);
    let told = ran(Command::new("kill").arg(console.id().to_string()));
    let ended = console.wait().expect("it ends");
    assert!(read.is_ok() && told.code == 0 && ended.success(), "{ended}");
    let printed: Value = serde_json::from_str(&line).expect("an object");
    assert_described("console", &printed);
    assert_eq!(printed["port"], "bench");
}
