//! `cargo xtask plots`: the book's pictures, drawn from the reports in `docs/data`, and from the texts in `docs/wiring`.
//! Entry point: [`all`].

mod circuit;
mod sheet;

use crate::run::root;
use anyhow::{Context, Result, bail};
use flate2::Compression;
use flate2::GzBuilder;
use flate2::read::GzDecoder;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use sutura_plot::{Kind, Picture, pictures};

/// Reports that the book has pictures of; those of each lie in a folder of its name.
const KINDS: [Kind; 2] = [Kind::Tradeoff, Kind::Fidelity];

fn data(kind: Kind) -> PathBuf {
    root()
        .join("docs/data")
        .join(format!("{}.json.gz", kind.name()))
}

fn folder(kind: Kind) -> PathBuf {
    root().join("docs/src").join(kind.name())
}

/// Draws, checks, takes a report, or makes the sheet.
pub fn all(check: bool, from: Option<&Path>, with_sheet: bool) -> Result<()> {
    if let Some(report) = from {
        take(report)?;
    }
    gated(check)?;
    if with_sheet {
        sheet::write()?;
    }
    Ok(())
}

/// The report of a kind and its pictures, if the book has one.
fn drawn(kind: Kind) -> Result<Option<Vec<Picture>>> {
    let path = data(kind);
    if !path.exists() {
        return Ok(None);
    }
    let said = || format!("reading {}", path.display());
    let packed = fs::read(&path).with_context(said)?;
    let mut text = String::new();
    GzDecoder::new(packed.as_slice())
        .read_to_string(&mut text)
        .with_context(said)?;
    let report: Value = serde_json::from_str(&text).with_context(said)?;
    Ok(Some(pictures(&report).with_context(said)?))
}

/// Draws all pictures; with `check` it only says which are not as they would be drawn.
fn gated(check: bool) -> Result<()> {
    let mut stale = Vec::new();
    let mut folders = vec![(root().join("docs/src/wiring"), circuit::all()?)];
    for kind in KINDS {
        folders.extend(drawn(kind)?.map(|pictures| (folder(kind), pictures)));
    }
    for (folder, pictures) in folders {
        fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
        for path in different(&folder, &pictures)? {
            let shown = path
                .strip_prefix(root())
                .unwrap_or(&path)
                .display()
                .to_string();
            if check {
                stale.push(shown);
                continue;
            }
            let own = pictures
                .iter()
                .find(|picture| path.ends_with(&picture.name));
            match own {
                Some(picture) => fs::write(&path, &picture.svg),
                None => fs::remove_file(&path),
            }
            .with_context(|| format!("writing {}", path.display()))?;
            println!("{shown}{}", if own.is_some() { "" } else { " removed" });
        }
    }
    if !stale.is_empty() {
        bail!(
            "not what is drawn from docs/data and docs/wiring: {}; run `cargo xtask plots`, look at them, and `cargo xtask plots --sheet`",
            stale.join(", ")
        );
    }
    Ok(())
}

/// Pictures of a folder that are missing, differ, or are of nothing.
fn different(folder: &Path, pictures: &[Picture]) -> Result<BTreeSet<PathBuf>> {
    let mut different: BTreeSet<_> = pictures
        .iter()
        .filter(|picture| {
            let old = fs::read_to_string(folder.join(&picture.name));
            !old.is_ok_and(|old| old == picture.svg)
        })
        .map(|picture| folder.join(&picture.name))
        .collect();
    let entries = fs::read_dir(folder).with_context(|| format!("reading {}", folder.display()))?;
    for entry in entries {
        let path = entry?.path();
        let is_picture = path.extension().is_some_and(|end| end == "svg");
        let is_drawn = pictures.iter().any(|picture| path.ends_with(&picture.name));
        if is_picture && !is_drawn {
            different.insert(path);
        }
    }
    Ok(different)
}

/// Puts a report in the place of the book's.
fn take(report: &Path) -> Result<()> {
    let said = || {
        format!(
            "{}: not what `sutura tradeoff` or `sutura fidelity` writes with --format json",
            report.display()
        )
    };
    let text =
        fs::read_to_string(report).with_context(|| format!("reading {}", report.display()))?;
    let value: Value = serde_json::from_str(&text).with_context(said)?;
    let kind = Kind::of(&value).with_context(said)?;
    // What cannot be drawn does not replace what can.
    pictures(&value).with_context(said)?;
    if value["extent"] != "full" {
        eprintln!("the report is of the short form: say so on the page that shows its pictures");
    }
    let path = data(kind);
    fs::write(&path, packed(&text)?).with_context(|| format!("writing {}", path.display()))?;
    println!("{}", path.strip_prefix(root()).unwrap_or(&path).display());
    Ok(())
}

/// The same bytes for the same text: without a time.
fn packed(text: &str) -> Result<Vec<u8>> {
    let mut packer = GzBuilder::new().write(Vec::new(), Compression::best());
    packer.write_all(text.as_bytes())?;
    Ok(packer.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_pictures_are_those_of_the_data() {
        gated(true).expect("`cargo xtask plots` has been run");
    }

    #[test]
    fn a_picture_that_differs_or_is_of_nothing_is_named() {
        let folder = std::env::temp_dir().join(format!("sutura-plots-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("writable");
        let picture = |name: &str| Picture {
            name: name.to_owned(),
            svg: name.to_owned(),
        };
        let pictures = ["same.svg", "other.svg", "missing.svg"].map(picture);
        for (name, text) in [
            ("same.svg", "same.svg"),
            ("other.svg", "x"),
            ("old.svg", "x"),
            ("sheet.png", "x"),
        ] {
            fs::write(folder.join(name), text).expect("writable");
        }
        let found = different(&folder, &pictures).expect("readable");
        fs::remove_dir_all(&folder).expect("ours");
        let names: Vec<_> = found.iter().filter_map(|path| path.file_name()).collect();
        assert_eq!(names, ["missing.svg", "old.svg", "other.svg"]);
    }

    #[test]
    fn what_is_packed_is_the_same_each_time_and_comes_back() {
        let text = "{\"truths\": []}";
        let bytes = packed(text).expect("packed");
        assert_eq!(bytes, packed(text).expect("packed"));
        let mut back = String::new();
        GzDecoder::new(bytes.as_slice())
            .read_to_string(&mut back)
            .expect("whole");
        assert_eq!(back, text);
    }
}
