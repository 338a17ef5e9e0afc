//! What an image was made of: `IMAGE.sha256` beside it, in the format of `sha256sum`. Entry point: [`write`].
//!
//! The first line is the image, the others are the files that it was built from, relative to the checkout. Tests that run the image
//! refuse one that these sources would not make: `sutura_hil::board_image::provenance`.

use crate::run::root;
use anyhow::{Context, Result};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Files that decide about an image and that the compiler does not name.
const BESIDES: [&str; 4] = [
    "firmware/Cargo.lock",
    "firmware/Cargo.toml",
    "shared/Cargo.toml",
    "Cargo.toml",
];

/// Writes the list beside an image that has just been built.
///
/// # Errors
/// If a file cannot be read, or the list not written.
pub fn write(image: &Path) -> Result<()> {
    let named = image.with_extension("d");
    let rule = std::fs::read_to_string(&named)
        .with_context(|| format!("cargo has not written {}", named.display()))?;
    let root = root();
    // In order, so that the same sources give the same list.
    let files: BTreeSet<PathBuf> = prerequisites(&rule)
        .into_iter()
        .map(|file| relative(&root, &file))
        .chain(BESIDES.map(PathBuf::from))
        .collect();
    let name = PathBuf::from(image.file_name().unwrap_or_default());
    let mut list = line(image, &name)?;
    for file in files {
        list.push_str(&line(&root.join(&file), &file)?);
    }
    let path = image.with_added_extension("sha256");
    std::fs::write(&path, list).with_context(|| format!("cannot write {}", path.display()))
}

fn relative(root: &Path, file: &Path) -> PathBuf {
    file.strip_prefix(root).unwrap_or(file).to_owned()
}

fn line(path: &Path, shown: &Path) -> Result<String> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut line = String::new();
    for byte in Sha256::digest(&bytes) {
        write!(line, "{byte:02x}")?;
    }
    writeln!(line, "  {}", shown.display())?;
    Ok(line)
}

/// The files of a rule as cargo writes it: `IMAGE: FILE FILE`, a space within a name as `\ `.
fn prerequisites(rule: &str) -> Vec<PathBuf> {
    let Some((_, files)) = rule.lines().next().and_then(|line| line.split_once(": ")) else {
        return Vec::new();
    };
    let files = files.replace("\\ ", "\0");
    let names = files.split_whitespace().map(|name| name.replace('\0', " "));
    names.map(PathBuf::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_names_its_files() {
        let files = prerequisites("/a/image: /a/b\\ c.rs /a/d.rs\n");
        assert_eq!(
            files,
            [PathBuf::from("/a/b c.rs"), PathBuf::from("/a/d.rs")]
        );
        assert!(prerequisites("").is_empty());
    }

    /// As `sha256sum` writes it.
    #[test]
    fn a_line_is_hash_and_name() {
        let lock = root().join("firmware/Cargo.lock");
        let line = line(&lock, Path::new("firmware/Cargo.lock")).expect("readable");
        let (hash, name) = line.split_once("  ").expect("two columns");
        assert_eq!((hash.len(), name), (64, "firmware/Cargo.lock\n"));
    }
}
