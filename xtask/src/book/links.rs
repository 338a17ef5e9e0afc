//! Links between the book's pages as its Markdown has them, for where mdBook is not at hand: pages, places in them, pictures and
//! included files. Entry point: [`broken`].

use anyhow::{Context, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Everything that leads nowhere, with page and line.
///
/// # Errors
/// If a page cannot be read.
pub fn broken(root: &Path) -> Result<Vec<String>> {
    let folder = root.join("docs/src");
    let list = std::fs::read_dir(&folder).with_context(|| format!("no {}", folder.display()))?;
    let mut texts = BTreeMap::new();
    for entry in list {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "md") {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            texts.insert(name.into_owned(), std::fs::read_to_string(&path)?);
        }
    }
    // A page that includes another text has its places.
    let whole = |text: &str| {
        let lines = text.lines().flat_map(targets);
        let pages = lines.filter(|path| path.ends_with(".md") && !texts.contains_key(path));
        let included = pages.filter_map(|path| std::fs::read_to_string(folder.join(path)).ok());
        included.fold(text.to_owned(), |whole, more| whole + "\n" + &more)
    };
    let places: BTreeMap<&str, BTreeSet<String>> = texts
        .iter()
        .map(|(name, text)| (name.as_str(), places(&whole(text))))
        .collect();
    let is_there = |path: &str| folder.join(path).exists();
    let wrong = texts.iter().flat_map(|(name, text)| {
        let wrong = in_page(name, text, &places, is_there);
        wrong
            .into_iter()
            .map(move |what| format!("docs/src/{name}:{what}"))
    });
    Ok(wrong.collect())
}

/// What of a page's links leads nowhere.
fn in_page(
    own: &str,
    text: &str,
    places: &BTreeMap<&str, BTreeSet<String>>,
    is_there: impl Fn(&str) -> bool,
) -> Vec<String> {
    let mut wrong = Vec::new();
    for (number, line) in prose(text) {
        for target in targets(&line) {
            let (path, place) = target.split_once('#').unwrap_or((&target, ""));
            let path = if path.is_empty() { own } else { path };
            let known = places.get(path);
            if known.is_none() && !is_there(path) {
                wrong.push(format!("{number}: `{target}` leads to no file"));
            } else if !place.is_empty() && known.is_some_and(|known| !known.contains(place)) {
                wrong.push(format!("{number}: `{target}` leads to no place of {path}"));
            }
        }
    }
    wrong
}

/// Lines that are no code, from 1, without the code in them.
fn prose(text: &str) -> impl Iterator<Item = (usize, String)> {
    let mut fenced = false;
    text.lines().enumerate().filter_map(move |(index, line)| {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
            return None;
        }
        if fenced || line.starts_with("    ") {
            return None;
        }
        // A link around code stays one.
        let parts = line.split('`').enumerate();
        let kept = parts.map(|(number, part)| if number % 2 == 0 { part } else { "" });
        Some((index + 1, kept.collect()))
    })
}

/// Where a line's links, pictures and includes lead, but for those that leave the book.
fn targets(line: &str) -> Vec<String> {
    let ends = |rest: &str, end: char| rest.split(end).next().unwrap_or_default().to_owned();
    let links = line.split("](").skip(1).map(|rest| ends(rest, ')'));
    let includes = line.split("{{#include ").skip(1).map(|rest| {
        let path = ends(rest, '}');
        // Lines of it, or a part with a name.
        ends(&path, ':')
    });
    // `[name]: page.md`, which links by that name lead to.
    let named = line
        .strip_prefix('[')
        .and_then(|line| line.split_once("]: "));
    let named = named.map(|(_, target)| target.trim().to_owned());
    let is_elsewhere = |target: &String| target.contains("://") || target.starts_with("mailto:");
    links
        .chain(includes)
        .chain(named)
        .filter(|target| !is_elsewhere(target))
        .collect()
}

/// Places of a page that links can name: its headings, as mdBook calls them, and those with an `id` of their own.
fn places(text: &str) -> BTreeSet<String> {
    let mut places = BTreeSet::new();
    let mut fenced = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        }
        let ids = line.split(" id=\"").skip(1);
        places.extend(
            ids.filter_map(|rest| rest.split('"').next())
                .map(str::to_owned),
        );
        let heading = line.trim_start_matches('#');
        if fenced || heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        let name = named(heading.trim());
        let again = (1..).map(|count| format!("{name}-{count}"));
        let mut names = std::iter::once(name.clone()).chain(again);
        places.extend(names.find(|name| !places.contains(name)));
    }
    places
}

/// What mdBook calls a heading: its letters, digits, `_` and `-` in lower case, and `-` for each blank.
fn named(heading: &str) -> String {
    let mut text = String::new();
    let mut rest = heading;
    // Of a link its words.
    while let Some((before, after)) = rest.split_once("](") {
        text.push_str(before);
        rest = after.split_once(')').map_or("", |(_, after)| after);
    }
    text.push_str(rest);
    let letters = text.chars().filter_map(|letter| match letter {
        '_' | '-' => Some(letter),
        letter if letter.is_alphanumeric() => Some(letter.to_ascii_lowercase()),
        letter if letter.is_whitespace() => Some('-'),
        _ => None,
    });
    letters.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::root;

    #[test]
    fn links_of_the_book_lead_somewhere() {
        let wrong = broken(&root()).expect("readable");
        assert_eq!(wrong, [""; 0]);
    }

    #[test]
    fn what_leads_nowhere_is_named_with_its_line() {
        let page = "# One `two`, three\n\n## One\n\n## One\n\n<a id=\"own\"></a>\n```\n# no heading\n[a](code.md)\n```\n    [a](code.md)\n";
        let expected = ["one", "one-1", "one-two-three", "own"].map(str::to_owned);
        assert_eq!(places(page), BTreeSet::from(expected));
        let known = BTreeMap::from([("a.md", places(page)), ("b.md", places("# B"))]);
        let is_there = |path: &str| path == "view/a.png";
        let good = "[x](#one-1) ![p](view/a.png) [`y`](a.md#own) `[z](none.md)` [w](https://e.org/#q)\n\n    [a](code.md)\n{{#include a.md:3:4}}\n";
        assert_eq!(in_page("a.md", good, &known, is_there), [""; 0]);
        for (bad, said) in [
            ("[x](#two)", "1: `#two` leads to no place of a.md"),
            ("\n[x](b.md#a)", "2: `b.md#a` leads to no place of b.md"),
            ("![x](view/b.png)", "1: `view/b.png` leads to no file"),
            ("{{#include c.rs:all}}", "1: `c.rs` leads to no file"),
            ("[x]: c.md", "1: `c.md` leads to no file"),
        ] {
            assert_eq!(in_page("a.md", bad, &known, is_there), [said]);
        }
    }
}
