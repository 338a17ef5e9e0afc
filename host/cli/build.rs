//! The commit that `sutura --version` says: git's of this checkout, else what `git archive` wrote into `commit.txt`, else none.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=commit.txt");
    let commit = of_checkout().or_else(of_archive);
    let version = env!("CARGO_PKG_VERSION");
    let said = match commit {
        Some(commit) => format!("{version} ({commit})"),
        None => version.to_owned(),
    };
    println!("cargo:rustc-env=SUTURA_VERSION={said}");
}

/// Commit and date, where this folder is in a checkout and not only below somebody else's.
fn of_checkout() -> Option<String> {
    // A new commit moves what one of these says; also one that takes this file in.
    for name in ["HEAD", "logs/HEAD"] {
        let path = git(&["rev-parse", "--git-path", name])?;
        if Path::new(&path).exists() {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    git(&["ls-files", "--error-unmatch", "build.rs"])?;
    git(&["log", "-1", "--format=%h, %cs", "--abbrev=12"])
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

/// The same of a tarball that git made: `.gitattributes` has the file filled in.
fn of_archive() -> Option<String> {
    let text = std::fs::read_to_string("commit.txt").ok()?;
    let filled = !text.contains("$Format");
    filled
        .then(|| text.trim().to_owned())
        .filter(|text| !text.is_empty())
}
