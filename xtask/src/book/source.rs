//! What can be seen only in the book's Markdown: pages that no table of contents names, formulas whose backslash is lost, files of
//! the checkout that are not there. Entry point: [`wrong`].

use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::path::Path;

/// Where paths in a text begin that are meant from the checkout's root.
const FOLDERS: [&str; 14] = [
    ".ci/",
    ".config/",
    "client/",
    "devices/",
    "docs/",
    "firmware/",
    "fuzz/",
    "hil/",
    "host/",
    "scenes/",
    "shared/",
    "testkit/",
    "tests/",
    "xtask/",
];

/// Everything that is wrong in the book's pages, and in the other texts of the checkout. `built` are the pages that mdBook made.
///
/// # Errors
/// If a page cannot be read.
pub fn wrong(root: &Path, built: &BTreeSet<String>) -> Result<Vec<String>> {
    let mut wrong = Vec::new();
    let folder = root.join("docs/src");
    let list = std::fs::read_dir(&folder).with_context(|| format!("no {}", folder.display()))?;
    let mut texts = vec!["README.md".to_owned(), "firmware/README.md".to_owned()];
    for entry in list {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if let Some(stem) = name.strip_suffix(".md") {
            let page = format!("{stem}.html");
            if name != "SUMMARY.md" && !built.contains(&page) {
                wrong.push(format!("docs/src/{name}: SUMMARY.md does not name it"));
            }
            texts.push(format!("docs/src/{name}"));
        }
    }
    texts.sort();
    for name in texts {
        let path = root.join(&name);
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("no {}", path.display()))?;
        let exists = |path: &str| root.join(path).exists();
        wrong.extend(
            in_text(&text, exists)
                .into_iter()
                .map(|what| format!("{name}:{what}")),
        );
    }
    Ok(wrong)
}

/// What is wrong in a text, each with its line.
fn in_text(text: &str, exists: impl Fn(&str) -> bool) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut fenced = false;
    for (index, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        }
        let mut say = |what: String| wrong.push(format!("{}: {what}", index + 1));
        let is_code = fenced || line.starts_with("    ");
        // Every other piece between backquotes is code.
        for (number, piece) in line.split('`').enumerate() {
            let is_code = is_code || number % 2 == 1;
            if is_code {
                for path in paths(piece).filter(|path| !exists(path)) {
                    say(format!("there is no {path}"));
                }
            } else if let Some(lost) = lost_backslash(piece) {
                say(format!(
                    "write `\\{lost}`: of `{lost}` Markdown leaves no backslash"
                ));
            }
        }
    }
    wrong
}

/// Words that are paths of the checkout, what cargo builds left out.
fn paths(code: &str) -> impl Iterator<Item = &str> {
    let words = code.split(|c: char| c.is_whitespace() || "\"'(),;=".contains(c));
    let words = words.map(|word| {
        let word = word.trim_end_matches(['.', ':']);
        // `file.rs:12` and `folder/` name the file and the folder.
        word.split_once(':').map_or(word, |(path, _)| path)
    });
    words.filter(|word| {
        FOLDERS.iter().any(|folder| word.starts_with(folder))
            && !word.contains(['*', '{', '<', '$'])
            && !word.contains("/target/")
    })
}

/// The first bracket of a formula that has one backslash. Square ones are units, unless a line begins with one.
fn lost_backslash(text: &str) -> Option<&str> {
    let bytes = text.as_bytes();
    let is_lost = |at: &usize| {
        let before = bytes[..*at]
            .iter()
            .rev()
            .take_while(|byte| **byte == b'\\')
            .count();
        let is_bracket = b"()".contains(&bytes[*at]) || *at == 1 && bytes[1] == b'[';
        before == 1 && is_bracket
    };
    let at = (1..bytes.len()).find(is_lost)?;
    text.get(at - 1..=at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_formula_needs_two_backslashes_and_a_file_to_be_there() {
        let exists = |path: &str| path == "scenes/palpation.toml";
        let good = "With \\\\(a\\\\) \\[m\\] in `scenes/palpation.toml:3`.\n\n    sutura run scenes/palpation.toml\n\n`\\(` is code, `scenes/*.toml` a pattern.";
        assert_eq!(in_text(good, exists), [""; 0]);
        for (text, said) in [
            ("one\nand \\(a\\\\)", "2: write `\\\\(`"),
            ("\\[ a \\\\]", "1: write `\\\\[`"),
            (
                "run `sutura run scenes/palpate.toml`",
                "1: there is no scenes/palpate.toml",
            ),
            (
                "    sutura run --device devices/none.toml",
                "1: there is no devices/none.toml",
            ),
        ] {
            let wrong = in_text(text, exists);
            assert!(wrong.len() == 1 && wrong[0].starts_with(said), "{wrong:?}");
        }
    }
}
