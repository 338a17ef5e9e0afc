//! The book's tables that are made of the command's types: what `sutura schema NAME` prints goes between `<!-- schema NAME -->` and
//! `<!-- /schema NAME -->`. Entry point: [`write()`]. That they are what it prints is checked by the command's own tests.

use crate::run::{Tool, root};
use anyhow::{Context, Result};
use std::fs;

const BEGIN: &str = "<!-- schema ";

/// Writes the tables of all pages; names the pages that changed.
///
/// # Errors
/// If the command does not build, or knows no such name; a mark without its end.
pub fn write() -> Result<()> {
    for entry in fs::read_dir(root().join("docs/src"))? {
        let path = entry?.path();
        if path.extension().is_none_or(|end| end != "md") {
            continue;
        }
        let text = fs::read_to_string(&path)?;
        let new = replaced(&text, |name| {
            Tool::new("cargo run --quiet --locked --package sutura -- schema")
                .arg(name)
                .output()
        })
        .with_context(|| path.display().to_string())?;
        if new != text {
            fs::write(&path, new)?;
            eprintln!("written: {}", path.display());
        }
    }
    Ok(())
}

/// A page with `table` of every mark between it and its end.
fn replaced(text: &str, table: impl Fn(&str) -> Result<String>) -> Result<String> {
    let mut new = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(BEGIN) {
        let (name, after) = after
            .split_once(" -->\n")
            .context("a mark has no end of line")?;
        let end = format!("<!-- /schema {name} -->");
        let (_, after) = after
            .split_once(&end)
            .with_context(|| format!("there is no {end}"))?;
        new += &format!(
            "{before}{BEGIN}{name} -->\n\n{}\n\n{end}",
            table(name)?.trim_end()
        );
        rest = after;
    }
    Ok(new + rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_between_marks_is_replaced() {
        let text = "a\n<!-- schema run -->\nold\n<!-- /schema run -->\nb\n";
        let table = |name: &str| Ok(format!("table of {name}\n"));
        let new = replaced(text, table).expect("whole");
        assert_eq!(
            new,
            "a\n<!-- schema run -->\n\ntable of run\n\n<!-- /schema run -->\nb\n"
        );
        assert_eq!(replaced(&new, table).expect("whole"), new);
        let open = text.replace("/schema", "schema");
        let error = replaced(&open, table).expect_err("no end");
        assert!(
            error.to_string().contains("<!-- /schema run -->"),
            "{error}"
        );
    }
}
