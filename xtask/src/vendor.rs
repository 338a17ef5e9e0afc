//! `cargo xtask vendor`: what the page uses of others, as npm's packages have it. Entry point: [`gated`].

use crate::run::{Tool, root, target};
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Beside the packages' folders.
const LOCK: &str = "host/view/vendor/vendor.toml";

#[derive(Deserialize)]
struct Lock {
    package: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    /// Of the package's archive, as in npm's lock files.
    integrity: String,
    /// Paths in the package and in its folder here.
    files: Vec<String>,
}

/// What `npm pack --json` says of an archive.
#[derive(Deserialize)]
struct Packed {
    filename: String,
    integrity: String,
}

/// Writes all files, or only compares them.
pub fn gated(check: bool) -> Result<()> {
    let text =
        fs::read_to_string(root().join(LOCK)).with_context(|| format!("cannot read {LOCK}"))?;
    let lock: Lock = toml::from_str(&text).with_context(|| format!("{LOCK} is no lock file"))?;
    let mut differences = Vec::new();
    for package in &lock.package {
        let folder = fetched(package)?;
        for file in &package.files {
            let path = format!("host/view/vendor/{}/{file}", package.name);
            let wanted = fs::read(folder.join(file))
                .with_context(|| format!("{}@{} has no {file}", package.name, package.version))?;
            if check {
                let found = fs::read(root().join(&path)).unwrap_or_default();
                differences.extend((found != wanted).then_some(path));
            } else {
                write(&root().join(path), &wanted)?;
            }
        }
        if check {
            differences.extend(unnamed(package)?);
        }
        eprintln!(
            "{} {}: {} files, {}",
            package.name,
            package.version,
            package.files.len(),
            package.integrity
        );
    }
    if !differences.is_empty() {
        bail!(
            "not as {LOCK} and npm say:\n{}\nrun `cargo xtask vendor`, and remove what {LOCK} does not name",
            differences.join("\n")
        );
    }
    Ok(())
}

/// Folder with the package's files, from an archive that is what the lock file names.
fn fetched(package: &Package) -> Result<PathBuf> {
    let name = format!("{}@{}", package.name, package.version);
    let folder = target()?.join("vendor").join(&package.name);
    fs::create_dir_all(&folder)?;
    let said = Tool::new("npm pack --json --pack-destination")
        .arg(&folder)
        .arg(&name)
        .output()
        .with_context(|| format!("cannot fetch {name}: npm and its registry are needed"))?;
    let packed: Vec<Packed> =
        serde_json::from_str(&said).with_context(|| format!("npm pack says of {name}:\n{said}"))?;
    let packed = packed.first().context("npm pack names no archive")?;
    if packed.integrity != package.integrity {
        bail!(
            "{name} is {}, {LOCK} has {}",
            packed.integrity,
            package.integrity
        );
    }
    Tool::new("tar -xzf")
        .arg(folder.join(&packed.filename))
        .arg("-C")
        .arg(&folder)
        .run()?;
    Ok(folder.join("package"))
}

/// Files in the package's folder that the lock file does not name.
fn unnamed(package: &Package) -> Result<Vec<String>> {
    let top = root().join("host/view/vendor").join(&package.name);
    let mut folders = vec![top.clone()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder).with_context(|| format!("{}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let inside = path.strip_prefix(&top)?.to_string_lossy().into_owned();
            if !package.files.contains(&inside) {
                found.push(format!("host/view/vendor/{}/{inside}", package.name));
            }
        }
    }
    Ok(found)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
