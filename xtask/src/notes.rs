//! `cargo xtask notes`: what a release brings, as its tag says it: its section of CHANGELOG.md. Entry point: [`print()`].

use crate::run::root;
use anyhow::{Context, Result, bail};
use std::fs::read_to_string;

/// Prints the notes of a tag, or of the version that the manifests have, whether it is released or not.
///
/// # Errors
/// If there are none, or if those of the tag are not closed by a date.
pub fn print(tag: Option<&str>) -> Result<()> {
    let changelog = read_to_string(root().join("CHANGELOG.md")).context("CHANGELOG.md")?;
    let version = match tag {
        Some(tag) => tag.trim_start_matches('v').to_owned(),
        None => version()?,
    };
    let (date, notes) = section(&changelog, &version)?;
    if tag.is_some() && !is_date(date) {
        bail!(
            "CHANGELOG.md: the section [{version}] says `{date}`: put the day in its place, as 2026-12-24, and commit that first"
        );
    }
    println!("{notes}");
    Ok(())
}

/// The version of all packages, as the manifest of the workspace has it.
fn version() -> Result<String> {
    let text = read_to_string(root().join("Cargo.toml"))?;
    let manifest: toml::Table = text.parse()?;
    let version = manifest["workspace"]["package"]["version"].as_str();
    Ok(version.context("Cargo.toml: no version")?.to_owned())
}

/// What stands behind a version's heading, and what is below it.
fn section<'a>(changelog: &'a str, version: &str) -> Result<(&'a str, &'a str)> {
    let heading = format!("## [{version}] - ");
    let sections = changelog.split_inclusive('\n');
    let mut from = 0;
    let mut found = None;
    for line in sections {
        let at = from;
        from += line.len();
        match found {
            None => {
                let date = line.strip_prefix(&heading);
                found = date.map(|date| (date.trim(), from));
            }
            Some((date, begin)) if line.starts_with("## ") => {
                return Ok((date, changelog[begin..at].trim()));
            }
            Some(_) => {}
        }
    }
    let (date, begin) = found.with_context(|| {
        format!("CHANGELOG.md has no section `{heading}YYYY-MM-DD`: name it as the version that Cargo.toml has")
    })?;
    Ok((date, changelog[begin..].trim()))
}

/// Whether it is a day as ISO 8601 has it.
fn is_date(text: &str) -> bool {
    let pattern = "dddd-dd-dd".chars();
    let fits = |(letter, like): (char, char)| match like {
        'd' => letter.is_ascii_digit(),
        like => letter == like,
    };
    text.len() == pattern.clone().count() && text.chars().zip(pattern).all(fits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: &str = "# Changelog\n\n## [0.2.0] - Unreleased\n\n### Added\n\n- b\n\n## [0.1.0] - 2026-12-24\n\n- a\n";

    #[test]
    fn notes_are_what_is_below_a_versions_heading() {
        let (date, notes) = section(TWO, "0.2.0").expect("there");
        assert_eq!((date, notes), ("Unreleased", "### Added\n\n- b"));
        assert_eq!(section(TWO, "0.1.0").expect("there"), ("2026-12-24", "- a"));
        let error = section(TWO, "0.1").expect_err("no such version");
        assert!(
            error.to_string().contains("no section `## [0.1] - "),
            "{error}"
        );
        for (text, expected) in [
            ("2026-12-24", true),
            ("Unreleased", false),
            ("2026-12-2", false),
            ("24.12.2026", false),
        ] {
            assert_eq!(is_date(text), expected, "{text}");
        }
    }

    /// Whatever version the manifests have, somebody has said what it brings.
    #[test]
    fn the_version_of_the_manifests_has_notes() {
        let changelog = read_to_string(root().join("CHANGELOG.md")).expect("there");
        let (date, notes) = section(&changelog, &version().expect("there")).expect("a section");
        assert!(is_date(date) || date == "Unreleased", "{date}");
        assert!(notes.contains("\n- "), "{notes}");
    }
}
