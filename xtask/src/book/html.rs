//! What a built page points at, and what in it can be pointed at. Entry points: [`Page::read`], [`Page::broken`].

use std::collections::BTreeSet;

/// A page of the book.
#[derive(Debug, Default)]
pub struct Page {
    /// Places that links can name.
    pub anchors: BTreeSet<String>,
    /// Links, pictures and files that it takes, as written.
    pub links: Vec<String>,
    /// Formulas that Markdown took apart.
    pub torn: Vec<String>,
}

/// What is at a path.
pub enum Found<'a> {
    /// A page with places in it.
    Page(&'a Page),
    /// Another file.
    File,
    /// Nothing.
    Nothing,
}

impl Page {
    /// Reads what mdBook wrote: tags are closed, and `<` is never part of a text.
    pub fn read(html: &str) -> Page {
        let mut page = Page::default();
        let mut rest = html;
        while let Some(at) = rest.find('<') {
            let tag = &rest[at + 1..];
            let end = tag.find('>').unwrap_or(tag.len());
            let (inside, after) = (&tag[..end], &tag[end..]);
            page.anchors.extend(attribute(inside, "id"));
            for name in ["href", "src"] {
                page.links.extend(attribute(inside, name));
            }
            // A program's text is not the page's.
            let is_script = inside.starts_with("script");
            let skipped = if is_script {
                after.find("</script>")
            } else {
                None
            };
            rest = &after[skipped.unwrap_or(0)..];
        }
        page.torn = torn(&without_code(html));
        page
    }

    /// What its links do not find. `own` is its path in the book.
    pub fn broken<'a>(&self, own: &str, look_up: impl Fn(&str) -> Found<'a>) -> Vec<String> {
        let links = self.links.iter().filter_map(|link| {
            if is_elsewhere(link) {
                return None;
            }
            let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
            let path = match decoded(path) {
                path if path.is_empty() => own.to_owned(),
                path => joined(own, &path),
            };
            match look_up(&path) {
                Found::Nothing => Some(format!("`{link}` leads to no file")),
                Found::Page(page)
                    if !anchor.is_empty() && !page.anchors.contains(&decoded(anchor)) =>
                {
                    Some(format!("`{link}` leads to no place of {path}"))
                }
                _ => None,
            }
        });
        let torn = self
            .torn
            .iter()
            .map(|text| format!("Markdown is at work in the formula `{text}`"));
        links.chain(torn).collect()
    }
}

/// The value of an attribute of a tag.
fn attribute(tag: &str, name: &str) -> Option<String> {
    let (_, value) = tag.split_once(&format!(" {name}=\""))?;
    let (value, _) = value.split_once('"')?;
    Some(value.replace("&amp;", "&").replace("&#39;", "'"))
}

fn is_elsewhere(link: &str) -> bool {
    // `https:`, `mailto:`, `data:`; a path of the book has no colon.
    link.split(['/', '#', '?'])
        .next()
        .is_some_and(|first| first.contains(':'))
}

/// `%20` as the letter that it stands for.
fn decoded(text: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let [first, others @ ..] = rest {
        let code = others
            .get(..2)
            .and_then(|two| std::str::from_utf8(two).ok());
        let code = code.and_then(|two| u8::from_str_radix(two, 16).ok());
        match code.filter(|_| *first == b'%') {
            Some(byte) => {
                bytes.push(byte);
                rest = &others[2..];
            }
            None => {
                bytes.push(*first);
                rest = others;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// A path as seen from a page.
fn joined(own: &str, path: &str) -> String {
    let mut parts: Vec<&str> = own.split('/').collect();
    parts.pop();
    for part in path.split('/') {
        match part {
            "." | "" => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// The page without what stands in `<code>` and `<script>`.
fn without_code(html: &str) -> String {
    let mut text = html.to_owned();
    for (open, close) in [("<script", "</script>"), ("<code", "</code>")] {
        let mut kept = String::new();
        let mut rest = text.as_str();
        while let Some((before, inside)) = rest.split_once(open) {
            kept.push_str(before);
            rest = inside.split_once(close).map_or("", |(_, after)| after);
        }
        kept.push_str(rest);
        text = kept;
    }
    text
}

/// Formulas with tags in them: stars or underscores that were taken for emphasis.
fn torn(html: &str) -> Vec<String> {
    let mut torn = Vec::new();
    for (open, close) in [("\\(", "\\)"), ("\\[", "\\]")] {
        let formulas = html
            .split(open)
            .skip(1)
            .map(|rest| rest.split_once(close).map_or(rest, |(formula, _)| formula));
        torn.extend(
            formulas
                .filter(|formula| formula.contains('<'))
                .map(|formula| formula.chars().take(80).collect::<String>()),
        );
    }
    torn
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "<h2 id=\"one-two\"><a class=\"header\" href=\"#one-two\">One two</a></h2>\
        <p><a href=\"other.html#there\">there</a> <img src=\"view/a%20b.png\"> \\(a_i\\) <code>\\(*a*\\)</code></p>\
        <script>let a = '<a href=\"nowhere.html\">';</script><a href=\"https://example.org/x#y\">far</a>";

    fn broken(page: &str) -> Vec<String> {
        let (own, other) = (Page::read(page), Page::read("<h1 id=\"there\"></h1>"));
        own.broken("page.html", |path| match path {
            "page.html" => Found::Page(&own),
            "other.html" => Found::Page(&other),
            "view/a b.png" => Found::File,
            _ => Found::Nothing,
        })
    }

    #[test]
    fn what_is_there_is_found() {
        assert_eq!(broken(PAGE), [""; 0]);
        assert_eq!(Page::read(PAGE).links.len(), 4);
    }

    #[test]
    fn what_is_not_there_is_named() {
        for (from, to, said) in [
            (
                "other.html#there",
                "other.html#here",
                "`other.html#here` leads to no place of other.html",
            ),
            (
                "other.html",
                "others.html",
                "`others.html#there` leads to no file",
            ),
            (
                "href=\"#one-two",
                "href=\"#one",
                "`#one` leads to no place of page.html",
            ),
            ("a%20b", "c", "`view/c.png` leads to no file"),
            ("a_i", "a<em>i", "the formula `a<em>i`"),
        ] {
            let wrong = broken(&PAGE.replace(from, to));
            assert!(
                wrong.len() == 1 && wrong[0].contains(said),
                "{from}: {wrong:?}"
            );
        }
    }

    #[test]
    fn paths_are_seen_from_their_page() {
        assert_eq!(joined("a/b.html", "../c.html"), "c.html");
        assert_eq!(joined("b.html", "view/c.png"), "view/c.png");
        assert_eq!(joined("b.html", "../../c.rs"), "../../c.rs");
    }
}
