//! Texts of users: bytes that are none, and what would steer a terminal or never ends.
//!
//! Entry points: [`utf8`] for files that come, [`escaped`] and [`one_line`] for results that go, [`harmless`] for messages.

use thiserror::Error;

/// Letters of a line that are shown: lists of all that a key may be are shorter, lines of a file that is no text are not.
pub const MOST_LETTERS: usize = 2000;

/// Bytes that are no text in UTF-8, and the first of them that is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("it is no text: byte {byte}, in line {line}, is 0x{found:02X}, which UTF-8 has not there")]
pub struct NotText {
    /// After so many bytes.
    pub byte: usize,
    /// In this line, from 1.
    pub line: usize,
    /// What stands there.
    pub found: u8,
    is_utf16: bool,
}

impl NotText {
    /// What the user can do.
    pub fn help(&self) -> &'static str {
        match self.is_utf16 {
            true => {
                "it begins as UTF-16 does: save it as UTF-8, or `iconv -f UTF-16 -t UTF-8 FILE > NEW`"
            }
            false => {
                "name a text file; if it is one, save it as UTF-8, or `iconv -f LATIN1 -t UTF-8 FILE > NEW`"
            }
        }
    }
}

/// The text of a file's bytes.
///
/// # Errors
/// [`NotText`], at the first byte that is not of UTF-8.
pub fn utf8(bytes: Vec<u8>) -> Result<String, NotText> {
    String::from_utf8(bytes).map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        let bytes = error.as_bytes();
        let (before, rest) = bytes.split_at(byte);
        NotText {
            byte,
            line: 1 + before.iter().filter(|byte| **byte == b'\n').count(),
            found: rest.first().copied().unwrap_or_default(),
            is_utf16: matches!(bytes, [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..]),
        }
    })
}

/// A text as a terminal may have it, whatever names and lines of files are in it: letters that would steer it, end a line or turn
/// the order of others around are written out. Ends of lines and tabs stay.
pub fn escaped(text: &str) -> String {
    with_steering(text, |letter, shown| shown.extend(letter.escape_default()))
}

/// Escapes as [`escaped`] does, and ends of lines as well: a name or a path ends no line of a result.
pub fn one_line(text: &str) -> String {
    escaped(text).replace('\n', "\\n")
}

/// Escapes a text in JSON: the same letters become JSON escapes, and the values stay the same.
pub fn escaped_json(text: &str) -> String {
    with_steering(text, |letter, shown| {
        *shown += &format!("\\u{:04x}", u32::from(letter));
    })
}

/// Whether a letter steers a terminal, ends a line (U+2028, U+2029), or changes the direction in which the letters beside it are
/// shown (Unicode's bidirectional controls, and those that were taken out of use).
fn steers(letter: char) -> bool {
    let turns = matches!(letter, '\u{061c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{206f}');
    turns || (letter.is_control() && !matches!(letter, '\t' | '\n'))
}

fn with_steering(text: &str, write: impl Fn(char, &mut String)) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        match steers(letter) {
            true => write(letter, &mut shown),
            false => shown.push(letter),
        }
    }
    shown
}

/// Escapes as [`escaped`] does, and cuts after [`MOST_LETTERS`].
pub fn harmless(text: &str) -> String {
    let lines = text.split('\n').map(|line| {
        let end = line.char_indices().nth(MOST_LETTERS);
        match end {
            Some((end, _)) => escaped(&line[..end]) + " ...",
            None => escaped(line),
        }
    });
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_no_text_are_told_by_place() {
        assert_eq!(utf8("ä\n".into()), Ok("ä\n".to_owned()));
        let told = |bytes: &[u8]| utf8(bytes.to_vec()).expect_err("no text");
        let latin = told(b"a = 1\nname = \"K\xF6rper\"\n");
        assert_eq!(
            latin.to_string(),
            "it is no text: byte 15, in line 2, is 0xF6, which UTF-8 has not there"
        );
        assert!(latin.help().contains("LATIN1"), "{}", latin.help());
        let wide = told(b"\xFF\xFEa\0=\0");
        assert_eq!((wide.byte, wide.line, wide.found), (0, 1, 0xFF));
        assert!(wide.help().contains("UTF-16"), "{}", wide.help());
        // A letter that is cut off at the end.
        assert_eq!(told(b"ab\xC3").byte, 2);
    }

    #[test]
    fn names_do_not_steer_terminals_and_lines_end() {
        assert_eq!(
            harmless("a\u{1b}[31mb\tc\nd\u{7}"),
            "a\\u{1b}[31mb\tc\nd\\u{7}"
        );
        let long = harmless(&"x".repeat(100_000));
        assert!(
            long.len() < 2100 && long.ends_with("x ..."),
            "{}",
            long.len()
        );
        let csi = "a\u{9b}2J\u{7f}\tb\n";
        assert_eq!(escaped(csi), "a\\u{9b}2J\\u{7f}\tb\n");
        assert_eq!(one_line("a\nb\t\u{85}c"), "a\\nb\t\\u{85}c");
        assert_eq!(escaped_json("\"\u{9b}\u{7f}\""), r#""\u009b\u007f""#);
        assert_eq!(escaped(&"x".repeat(5000)).len(), 5000);
        // The name of a file that seems to end in `.txt`, and lines that end where none should.
        let turned = "\u{202e}txt.mcap\u{2066}a\u{2028}b\u{2029}\u{200f}\u{61c}";
        let shown = escaped(turned);
        assert_eq!(
            shown,
            r"\u{202e}txt.mcap\u{2066}a\u{2028}b\u{2029}\u{200f}\u{61c}"
        );
        assert_eq!(
            escaped_json(turned),
            shown.replace(['{', '}'], "").replace("u61c", "u061c")
        );
        let words = "\u{5e9}\u{5dc} \u{e9}\u{200d}\u{1f44d}";
        assert_eq!(escaped(words), words, "words of other scripts stay");
        let (good, short) = ("cannot read `ä`: no", "y".repeat(MOST_LETTERS));
        assert_eq!((harmless(good), harmless(&short)), (good.to_owned(), short));
    }
}
