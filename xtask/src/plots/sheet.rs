//! All pictures of the book on one, as PNG: to be looked at. Entry point: [`write`].

use super::{KINDS, drawn};
use crate::run::{Tool, is_there, root};
use anyhow::{Context, Result, bail};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Columns, and the size of a picture there \[px\]: of its own 800 x 480.
const COLUMNS: usize = 3;
const CELL: (usize, usize) = (520, 312);
/// Height of the line that says what this is \[px\].
const HEAD: usize = 32;
/// More than this for a picture is not kept in the book \[B\].
const MOST: u64 = 30_000;

/// Draws the sheet into the book, with the date and the commit.
pub fn write() -> Result<()> {
    let mut pictures = Vec::new();
    for kind in KINDS {
        pictures.extend(
            drawn(kind)?
                .into_iter()
                .flatten()
                .map(|picture| picture.svg),
        );
    }
    let size = (
        COLUMNS * CELL.0,
        HEAD + pictures.len().div_ceil(COLUMNS) * CELL.1,
    );
    let mut sheet = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\">\
         <rect width=\"{0}\" height=\"{1}\" fill=\"#ffffff\"/>\
         <text x=\"12\" y=\"22\" font-family=\"sans-serif\" font-size=\"15\">{2} pictures of the book, {3}</text>",
        size.0,
        size.1,
        pictures.len(),
        version()?
    );
    for (index, svg) in pictures.iter().enumerate() {
        let (x, y) = (index % COLUMNS * CELL.0, HEAD + index / COLUMNS * CELL.1);
        // Its size here is not its own.
        let inside = svg.split_once(" viewBox").map_or("", |(_, rest)| rest);
        let _ = writeln!(
            sheet,
            "<svg x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" viewBox{inside}",
            CELL.0, CELL.1
        );
    }
    sheet.push_str("</svg>\n");
    let path = root().join("docs/src/sheet.png");
    let drawing = std::env::temp_dir().join(format!("sutura-sheet-{}.svg", std::process::id()));
    fs::write(&drawing, sheet).with_context(|| format!("writing {}", drawing.display()))?;
    let made = rasterised(&drawing, &path, size);
    let _ = fs::remove_file(&drawing);
    made?;
    let bytes = fs::metadata(&path)?.len();
    let most = MOST * pictures.len() as u64;
    if bytes > most {
        bail!("docs/src/sheet.png has {bytes} B, more than {most}: make its cells smaller");
    }
    println!("docs/src/sheet.png: {} pictures, {bytes} B", pictures.len());
    Ok(())
}

/// Date and commit, and whether pictures differ from it.
fn version() -> Result<String> {
    let commit = Tool::new("git log -1 --format=%cs/%h").output()?;
    let changed = Tool::new("git status --porcelain -- docs/data docs/src host/plot").output()?;
    let more = if changed.trim().is_empty() {
        ""
    } else {
        " and changes"
    };
    let said = commit.trim().replacen('/', ", commit ", 1);
    Ok(format!("{said}{more}"))
}

fn rasterised(drawing: &Path, png: &Path, (width, height): (usize, usize)) -> Result<()> {
    if is_there("rsvg-convert") {
        return Tool::new("rsvg-convert --output")
            .arg(png)
            .arg(drawing)
            .run();
    }
    let browsers = ["chromium", "chromium-browser", "google-chrome"];
    let Some(browser) = browsers.into_iter().find(|name| is_there(name)) else {
        bail!(
            "no program here makes a PNG of an SVG: install librsvg2-bin (rsvg-convert) or chromium"
        );
    };
    Tool::new(browser)
        .arg("--headless")
        .arg("--no-sandbox")
        .arg("--hide-scrollbars")
        .arg(format!("--window-size={width},{height}"))
        .arg(format!("--screenshot={}", png.display()))
        .arg(format!("file://{}", drawing.display()))
        .run()
        .context("the browser made no picture; rsvg-convert (librsvg2-bin) does it too")
}
