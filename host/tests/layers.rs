//! Which rooms of the host may name which: arrows go down, and between crates they end in no circle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// From the bottom up. A room may name its own layer and those below.
const LAYERS: [&[&str]; 8] = [
    &[
        "boxes",
        "clock",
        "core_time",
        "hash",
        "marks",
        "text",
        "tool",
        "work",
    ],
    &["fem"],
    &["body", "columns", "contact", "renewal", "rows"],
    &[
        "anchors", "collide", "event", "jaws", "model", "needle", "rod", "source", "step", "thread",
    ],
    &["registry"],
    &["output", "scene", "script", "wound"],
    &["prescribed"],
    &["picture", "recording", "session", "solve"],
];

/// What lives elsewhere, under a name of this crate.
const OTHERS: [&str; 5] = ["link", "mesh", "models", "scheduling", "times"];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("readable");
    let paths = entries.map(|entry| entry.expect("readable").path());
    let each = paths.flat_map(|path| {
        if path.is_dir() {
            sources(&path)
        } else {
            vec![path]
        }
    });
    each.filter(|path| path.extension().is_some_and(|e| e == "rs"))
        .collect()
}

/// Rooms that a file names, but in its comments, its documents and its tests.
fn named(text: &str) -> BTreeSet<String> {
    let own = text.split("#[cfg(test)]\nmod tests {").next();
    let lines = own.unwrap_or_default().lines();
    let code = lines.filter(|line| !line.trim_start().starts_with("//"));
    let words = code.flat_map(|line| line.split("crate::").skip(1));
    let room = |word: &str| -> String {
        let letters = word.chars();
        letters
            .take_while(|c| c.is_ascii_lowercase() || *c == '_')
            .collect()
    };
    words.map(room).filter(|room| !room.is_empty()).collect()
}

#[test]
fn rooms_name_what_is_below_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let layer_of: BTreeMap<&str, usize> = (0..)
        .zip(LAYERS)
        .flat_map(|(layer, rooms)| rooms.iter().map(move |room| (*room, layer)))
        .collect();
    let (mut seen, mut wrong) = (BTreeSet::new(), Vec::new());
    for path in sources(&root) {
        let place = path.strip_prefix(&root).expect("inside");
        let first = place.components().next().expect("a name").as_os_str();
        let room = first.to_string_lossy().trim_end_matches(".rs").to_owned();
        let stem = path.file_stem().expect("a name").to_string_lossy();
        if room == "lib" || stem.ends_with("tests") || stem == "testing" {
            continue;
        }
        let layer = layer_of.get(room.as_str());
        let Some(layer) = layer else {
            panic!("`{room}` is in no layer: give it one in this file");
        };
        let text = std::fs::read_to_string(&path).expect("readable");
        for other in named(&text) {
            if OTHERS.contains(&other.as_str()) {
                continue;
            }
            // A macro or an item of the crate itself has no layer.
            match layer_of.get(other.as_str()) {
                Some(below) if below > layer => {
                    wrong.push(format!("{} names `{other}`", place.display()));
                }
                _ => {}
            }
        }
        seen.insert(room);
    }
    let known: BTreeSet<String> = layer_of.keys().map(|room| (*room).to_owned()).collect();
    assert_eq!(seen, known, "rooms that there are, and rooms of the list");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Crates of the workspace, and which of each other they need.
#[test]
fn crates_need_what_is_below_them() {
    const ORDER: [&[&str]; 7] = [
        &[
            "sutura-shared",
            "sutura-factor",
            "sutura-files",
            "sutura-plot",
            "sutura-scene-file",
            "sutura-testkit",
            "sutura-view",
        ],
        &[
            "sutura-board",
            "sutura-client",
            "sutura-mesh",
            "sutura-firmware",
        ],
        &["sutura-models"],
        &["sutura-host", "sutura-capi"],
        &["sutura-hil", "sutura-instructions", "sutura-study"],
        &["sutura", "sutura-python"],
        &["sutura-fuzz", "xtask"],
    ];
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let layer = |name: &str| ORDER.iter().position(|layer| layer.contains(&name));
    let mut found = 0;
    for folder in [
        "shared",
        "firmware",
        "client",
        "client/capi",
        "host",
        "host/board",
        "host/factor",
        "host/files",
        "host/mesh",
        "host/models",
        "host/scene-file",
        "host/study",
        "host/plot",
        "host/instructions",
        "host/view",
        "host/cli",
        "hil",
        "python",
        "testkit",
        "xtask",
        "fuzz",
    ] {
        let text = std::fs::read_to_string(root.join(folder).join("Cargo.toml"));
        let file: toml::Table = text.expect("a manifest").parse().expect("good TOML");
        let name = file["package"]["name"].as_str().expect("a name");
        let own = layer(name).unwrap_or_else(|| panic!("{name} is in no layer"));
        let needs = file.get("dependencies").and_then(toml::Value::as_table);
        let needs = needs.into_iter().flat_map(toml::Table::keys);
        for need in needs.filter(|need| need.starts_with("sutura")) {
            let below = layer(need).unwrap_or_else(|| panic!("{need} is in no layer"));
            assert!(below < own, "{name} needs {need}");
        }
        found += 1;
    }
    assert_eq!(found, 21);
}

/// Lines of every function of a file, with where it begins.
fn functions(text: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let indent = |line: &str| line.len() - line.trim_start().len();
    let is_head = |line: &str| {
        let words = line.trim_start();
        let bare = words.trim_start_matches("pub ").split(") ").last();
        words.starts_with("fn ") || bare.is_some_and(|rest| rest.starts_with("fn "))
    };
    let heads = lines.iter().enumerate().filter(|(_, line)| is_head(line));
    let measured = heads.map(|(first, head)| {
        let after = &lines[first..];
        let ends = |line: &&str| line.trim_start() == "}" && indent(line) == indent(head);
        let count = after.iter().position(ends).unwrap_or(0);
        let name = head.trim().to_owned();
        (name, count + 1)
    });
    measured.collect()
}

/// The solver is read: its outline on a page, and no function of it longer than one.
#[test]
fn functions_of_the_solver_fit_a_page() {
    const MOST: usize = 80;
    const OUTLINE: usize = 60;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let (mut count, mut long) = (0, Vec::new());
    for room in LAYERS[..4].concat() {
        let folder = root.join(room);
        let files = if folder.is_dir() {
            sources(&folder)
        } else {
            vec![]
        };
        let file = root.join(format!("{room}.rs"));
        for path in files.into_iter().chain(file.is_file().then_some(file)) {
            let text = std::fs::read_to_string(&path).expect("readable");
            let is_outline = path.ends_with("step/outline.rs");
            let most = if is_outline { OUTLINE } else { MOST };
            if path.ends_with("anchors/tests.rs") {
                continue;
            }
            for (name, lines) in functions(&text) {
                count += 1;
                if lines > most {
                    long.push(format!("{}: {name} has {lines} lines", path.display()));
                }
            }
        }
    }
    assert!(count > 600, "{count} functions were found");
    assert!(long.is_empty(), "{long:#?}");
}
