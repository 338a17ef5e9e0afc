//! Both lock files must resolve everything that `sutura-shared` uses to the same versions, or the console
//! and the host would not run the same code. Entry point: [`check`].

use crate::run::root;
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// The package whose dependencies must agree.
const SHARED: &str = "sutura-shared";

#[derive(Deserialize)]
struct Lock {
    package: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    #[serde(default)]
    checksum: Option<String>,
    #[serde(default)]
    dependencies: Vec<String>,
}

/// Compares the two lock files of the checkout.
pub fn check() -> Result<()> {
    let read = |name: &str| {
        std::fs::read_to_string(root().join(name)).with_context(|| format!("cannot read {name}"))
    };
    let manifest = read("shared/Cargo.toml")?;
    let workspace = resolved(&read("Cargo.lock")?, &manifest)?;
    let firmware = resolved(&read("firmware/Cargo.lock")?, &manifest)?;
    let differences = compare(&workspace, &firmware);
    if !differences.is_empty() {
        bail!(
            "Cargo.lock and firmware/Cargo.lock resolve what {SHARED} uses differently:\n{}\n\
             run `cargo update -p NAME --precise VERSION` in firmware/ (or here)",
            differences.join("\n")
        );
    }
    let both = workspace
        .keys()
        .filter(|name| firmware.contains_key(*name))
        .count();
    eprintln!("{both} packages below {SHARED} agree");
    Ok(())
}

/// The version of a package in the workspace's lock file.
pub fn version(package: &str) -> Result<String> {
    let path = root().join("Cargo.lock");
    let text = std::fs::read_to_string(path).context("cannot read Cargo.lock")?;
    let lock: Lock = toml::from_str(&text).context("Cargo.lock is no lock file")?;
    let found = lock.package.into_iter().find(|other| other.name == package);
    let found = found.with_context(|| format!("Cargo.lock has no {package}"))?;
    Ok(found.version)
}

/// Version and checksum of everything below shared, by name.
type Resolved = BTreeMap<String, BTreeSet<String>>;

/// Walks the lock file from shared's normal dependencies on; those that only its tests use do not count.
fn resolved(lock: &str, shared_manifest: &str) -> Result<Resolved> {
    let lock: Lock = toml::from_str(lock).context("not a lock file")?;
    let manifest: toml::Table = toml::from_str(shared_manifest).context("not a manifest")?;
    let normal = manifest.get("dependencies").and_then(toml::Value::as_table);
    let normal: BTreeSet<&str> = normal
        .into_iter()
        .flat_map(|table| table.keys().map(String::as_str))
        .collect();
    let shared = lock.package.iter().find(|package| package.name == SHARED);
    let shared = shared.with_context(|| format!("{SHARED} is not in the lock file"))?;

    let mut todo: Vec<&str> = shared.dependencies.iter().map(String::as_str).collect();
    todo.retain(|entry| normal.contains(entry.split(' ').next().unwrap_or_default()));
    let mut found = Resolved::new();
    while let Some(entry) = todo.pop() {
        // "name", or "name version" where there are several.
        let mut words = entry.split(' ');
        let (name, version) = (words.next(), words.next());
        let package = lock.package.iter().find(|package| {
            Some(package.name.as_str()) == name
                && version.is_none_or(|version| package.version == version)
        });
        let package = package.with_context(|| format!("{entry} is not in the lock file"))?;
        let exact = format!(
            "{} {}",
            package.version,
            package.checksum.as_deref().unwrap_or("(path)")
        );
        if found.entry(package.name.clone()).or_default().insert(exact) {
            todo.extend(package.dependencies.iter().map(String::as_str));
        }
    }
    Ok(found)
}

/// What both resolve, but differently. A package on one side only comes from features that the other side
/// does not ask for: it cannot differ.
fn compare(workspace: &Resolved, firmware: &Resolved) -> Vec<String> {
    let versions = |set: &BTreeSet<String>| {
        let short: Vec<&str> = set
            .iter()
            .filter_map(|exact| exact.split(' ').next())
            .collect();
        short.join(" and ")
    };
    workspace
        .iter()
        .filter_map(|(name, here)| {
            let there = firmware.get(name).filter(|there| *there != here)?;
            let (here, there) = (versions(here), versions(there));
            Some(format!("  {name}: {here} here, {there} in firmware/"))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANIFEST: &str = "[dependencies]\nlibm.workspace = true\ncobs = \"0.5\"\n[dev-dependencies]\nproptest = \"1\"\n";

    fn lock(libm: &str, proptest: &str) -> String {
        format!(
            r#"
version = 4
[[package]]
name = "sutura-shared"
version = "0.1.0"
dependencies = ["cobs 0.5.1", "libm", "proptest"]
[[package]]
name = "cobs"
version = "0.3.0"
checksum = "aa"
[[package]]
name = "cobs"
version = "0.5.1"
checksum = "bb"
dependencies = ["thiserror"]
[[package]]
name = "thiserror"
version = "2.0.0"
checksum = "cc"
[[package]]
name = "libm"
version = "{libm}"
checksum = "dd"
[[package]]
name = "proptest"
version = "{proptest}"
checksum = "ee"
"#
        )
    }

    #[test]
    fn another_version_below_shared_is_named_and_test_dependencies_do_not_count() {
        let here = resolved(&lock("0.2.15", "1.0.0"), MANIFEST).expect("a lock file");
        let same = resolved(&lock("0.2.15", "1.9.0"), MANIFEST).expect("a lock file");
        assert_eq!(
            here.keys().collect::<Vec<_>>(),
            ["cobs", "libm", "thiserror"]
        );
        assert!(compare(&here, &same).is_empty());

        let other = resolved(&lock("0.2.16", "1.0.0"), MANIFEST).expect("a lock file");
        assert_eq!(
            compare(&here, &other),
            ["  libm: 0.2.15 here, 0.2.16 in firmware/"]
        );
    }

    #[test]
    fn a_package_that_only_features_of_one_side_need_does_not_count() {
        let here = resolved(&lock("0.2.15", "1.0.0"), MANIFEST).expect("a lock file");
        let mut there = here.clone();
        there.remove("thiserror");
        assert!(compare(&here, &there).is_empty());
        assert!(compare(&there, &here).is_empty());
    }

    #[test]
    fn the_named_one_of_two_versions_is_followed() {
        let found = resolved(&lock("0.2.15", "1.0.0"), MANIFEST).expect("a lock file");
        assert_eq!(found["cobs"], BTreeSet::from(["0.5.1 bb".to_owned()]));
    }

    #[test]
    fn a_lock_file_without_shared_is_refused() {
        assert!(resolved("package = []", MANIFEST).is_err());
    }
}
