//! `cargo xtask book`: the book as mdBook builds it, with every link, anchor, formula and path in it looked up.
//! Entry point: [`build`].
//!
//! mdBook itself looks nothing up: a link to a page that is not there is a link in its pages. So what it has written is read here.

mod html;
#[cfg(test)]
mod links;
mod source;
mod tables;

use crate::run::{Tool, root, target};
use anyhow::{Context, Result, bail};
use html::Page;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Of the program that builds the book; a newer one may write other pages.
const VERSION: &str = "0.5.4";

/// Beside the book's pages, and not pages of it.
const NOT_PAGES: [&str; 3] = ["print.html", "404.html", "toc.html"];

/// Builds the book and says where it is. `with_tables`: writes those first that the command's types make.
///
/// # Errors
/// What is wrong with it, all of it, by page.
pub fn build(with_tables: bool) -> Result<()> {
    if with_tables {
        tables::write()?;
    }
    let program = program()?;
    let out = target()?.join("book");
    let mut wrong = said_by(
        Tool::new(&program.display().to_string())
            .arg("build")
            .arg(root().join("docs"))
            .arg("--dest-dir")
            .arg(&out),
    )?;
    let pages = pages(&out)?;
    for (path, page) in &pages {
        let broken = page.broken(path, |path| look_up(&out, &pages, path));
        wrong.extend(broken.into_iter().map(|what| format!("{path}: {what}")));
    }
    wrong.extend(source::wrong(&root(), &pages.keys().cloned().collect())?);
    if !wrong.is_empty() {
        bail!(
            "{} things are wrong in the book:\n{}",
            wrong.len(),
            wrong.join("\n")
        );
    }
    let links: usize = pages.values().map(|page| page.links.len()).sum();
    eprintln!(
        "{} pages, {links} links: {}",
        pages.len(),
        out.join("index.html").display()
    );
    Ok(())
}

/// Installs mdBook into a folder of its own, where it is not there in this version; its path.
///
/// # Errors
/// If it cannot be had.
pub fn program() -> Result<PathBuf> {
    let folder = target()?.join("tools");
    let program = folder.join("bin/mdbook");
    let version = || {
        Tool::new(&program.display().to_string())
            .arg("--version")
            .output()
    };
    let is_right = |text: &String| text.trim().ends_with(VERSION);
    if !version().is_ok_and(|text| is_right(&text)) {
        // Without its server and its search, which are most of it.
        let install = Tool::new("cargo install mdbook --debug --locked --no-default-features")
            .arg("--version")
            .arg(format!("={VERSION}"))
            .arg("--root")
            .arg(&folder)
            // Of the lines of a program that is only run.
            .env("CARGO_PROFILE_DEV_DEBUG", "false");
        eprintln!("installing mdBook from source: {}", install.shown());
        install.run().context("mdBook is missing")?;
    }
    eprintln!("book: {}", version()?.trim());
    Ok(program)
}

/// What mdBook complains of while it builds: it goes on after a file that is not there.
fn said_by(tool: Tool) -> Result<Vec<String>> {
    let (_, said) = tool.both()?;
    let complaints = said.lines().filter(|line| is_complaint(line));
    Ok(complaints.map(str::to_owned).collect())
}

fn is_complaint(line: &str) -> bool {
    ["WARN", "ERROR"].iter().any(|level| line.contains(level))
}

/// The built pages by their paths in the book.
fn pages(out: &Path) -> Result<BTreeMap<String, Page>> {
    let mut pages = BTreeMap::new();
    let list = std::fs::read_dir(out).with_context(|| format!("no {}", out.display()))?;
    for entry in list {
        let path = entry?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if name.ends_with(".html") && !NOT_PAGES.contains(&name.as_str()) {
            let text = std::fs::read_to_string(&path)?;
            pages.insert(name, Page::read(&text));
        }
    }
    Ok(pages)
}

/// A page, or that there is such a file and nothing in it to point at.
fn look_up<'a>(out: &Path, pages: &'a BTreeMap<String, Page>, path: &str) -> html::Found<'a> {
    match pages.get(path) {
        Some(page) => html::Found::Page(page),
        None if out.join(path).exists() => html::Found::File,
        None => html::Found::Nothing,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_mdbook_complains_of_is_heard() {
        assert!(is_complaint(
            "2026-01-01 [ERROR] (mdbook::preprocess): no such file"
        ));
        assert!(is_complaint(" WARN unclosed HTML tag"));
        assert!(!is_complaint(" INFO Book building has started"));
    }
}
