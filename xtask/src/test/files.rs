//! Test files are modules of one binary a crate: one that no `mod` names would never run.

use crate::run::root;
use std::path::{Path, PathBuf};

/// Files and folders beside a `main.rs` or `mod.rs` that it does not name.
fn forgotten(folder: &Path) -> Vec<PathBuf> {
    let read = |path: PathBuf| std::fs::read_to_string(path).unwrap_or_default();
    let text = read(folder.join("main.rs")) + &read(folder.join("mod.rs"));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let named = text.contains(&format!("mod {stem};"));
        let is_source = path.extension().is_some_and(|end| end == "rs");
        let is_file = is_source && stem != "main" && stem != "mod";
        let is_module = path.join("mod.rs").is_file();
        // A folder with a `main.rs` would be a binary of its own.
        let alone = path.join("main.rs").is_file();
        if alone || ((is_file || is_module) && !named) {
            found.push(path.clone());
        }
        if is_module {
            found.extend(forgotten(&path));
        }
    }
    found
}

#[test]
fn every_test_file_is_a_module_of_its_crate() {
    for folder in [
        "tests",
        "host/tests",
        "host/models/tests",
        "shared/tests",
        "hil/tests",
    ] {
        let folder = root().join(folder);
        assert!(folder.join("main.rs").is_file(), "{}", folder.display());
        let forgotten = forgotten(&folder);
        assert!(
            forgotten.is_empty(),
            "no `mod` for {forgotten:?}: they would never run"
        );
    }
}

#[test]
fn a_file_without_a_module_is_found() {
    let folder = std::env::temp_dir().join(format!("sutura-files-{}", std::process::id()));
    let deep = folder.join("deep");
    std::fs::create_dir_all(&deep).expect("writable");
    for (name, text) in [
        ("main.rs", "mod a;\nmod deep;\n"),
        ("a.rs", ""),
        ("b.rs", ""),
        ("deep/mod.rs", "mod c;\n"),
        ("deep/c.rs", ""),
        ("deep/d.rs", ""),
    ] {
        std::fs::write(folder.join(name), text).expect("writable");
    }
    let mut found = forgotten(&folder);
    found.sort();
    assert_eq!(found, [folder.join("b.rs"), deep.join("d.rs")]);
    std::fs::remove_dir_all(&folder).expect("removable");
}
