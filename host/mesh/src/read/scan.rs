//! A mesh file from front to back: words, numbers as text or as bytes, and errors that say where.
//!
//! Entry point: [`Scan::new`]. Nothing is set aside for a count that a file announces: what is read grows with
//! the bytes that are there.

use super::super::{MeshError, Place};
use std::str::Utf8Error;

/// Letters of a file that a message shows.
const SHOWN: usize = 60;

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Endian {
    Little,
    Big,
}

/// How numbers stand in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Coding {
    /// As text, a record in a line.
    Lines,
    /// As text, wherever lines end.
    Words,
    /// As bytes; names between them are text.
    Binary(Endian),
}

/// A type of numbers in a binary file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// A number of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Number {
    Whole(i128),
    Real(f64),
}

impl Kind {
    /// Bytes of one.
    pub fn size(self) -> usize {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::I64 | Kind::U64 | Kind::F64 => 8,
        }
    }

    /// One from its bytes, of which there are [`Self::size`].
    pub fn read(self, bytes: &[u8], endian: Endian) -> Number {
        let mut low_first = [0; 8];
        for (place, byte) in low_first.iter_mut().zip(bytes) {
            *place = *byte;
        }
        if endian == Endian::Big {
            low_first[..self.size()].reverse();
        }
        let bits = u64::from_le_bytes(low_first);
        Number::Whole(match self {
            Kind::I8 => i128::from(bits as i8),
            Kind::I16 => i128::from(bits as i16),
            Kind::I32 => i128::from(bits as i32),
            Kind::I64 => i128::from(bits as i64),
            Kind::U8 | Kind::U16 | Kind::U32 | Kind::U64 => i128::from(bits),
            Kind::F32 => return Number::Real(f64::from(f32::from_bits(bits as u32))),
            Kind::F64 => return Number::Real(f64::from_bits(bits)),
        })
    }
}

impl Number {
    /// From text.
    pub fn parse(word: &str) -> Option<Number> {
        let whole = word.parse().ok().map(Number::Whole);
        whole.or_else(|| word.parse().ok().map(Number::Real))
    }

    pub fn real(self) -> f64 {
        match self {
            Number::Whole(x) => x as f64,
            Number::Real(x) => x,
        }
    }

    /// A whole number from 0 up.
    pub fn index(self) -> Option<u64> {
        match self {
            Number::Whole(x) => u64::try_from(x).ok(),
            Number::Real(_) => None,
        }
    }

    /// A region's number; some programs write it as a decimal.
    pub fn region(self) -> Option<i64> {
        match self {
            Number::Whole(x) => i64::try_from(x).ok(),
            Number::Real(x) => (x.fract() == 0.0 && x.abs() < 9e15).then_some(x as i64),
        }
    }
}

/// Bytes that are no text where text is expected, those from `start` of the file.
pub(crate) fn no_text(expected: &str, bytes: &[u8], start: usize, error: Utf8Error) -> MeshError {
    let found = bytes.get(error.valid_up_to()).copied().unwrap_or_default();
    MeshError::Syntax {
        at: Place::Byte(start + error.valid_up_to()),
        expected: expected.into(),
        found: format!("0x{found:02X}, which is no text"),
    }
}

/// A file and the place in it.
#[derive(Clone)]
pub(crate) struct Scan<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The current line, from 1, and where it begins.
    line: usize,
    line_start: usize,
    /// Decided by a file's head.
    pub coding: Coding,
    /// What is left out up to the end of a line.
    comment: Option<u8>,
}

impl<'a> Scan<'a> {
    pub fn new(bytes: &'a [u8], coding: Coding, comment: Option<u8>) -> Self {
        Self {
            bytes,
            at: 0,
            line: 1,
            line_start: 0,
            coding,
            comment,
        }
    }

    /// Where the file is read.
    pub fn place(&self) -> Place {
        match self.coding {
            Coding::Binary(_) => Place::Byte(self.at),
            _ => Place::Line(self.line),
        }
    }

    /// Passes blanks and comments; with `across` the ends of lines too.
    fn skip_blank(&mut self, across: bool) {
        while let Some(&byte) = self.bytes.get(self.at) {
            match byte {
                b'\n' if across => {
                    self.line += 1;
                    self.line_start = self.at + 1;
                }
                b'\n' => return,
                _ if byte.is_ascii_whitespace() => {}
                _ if Some(byte) == self.comment => {
                    let rest = &self.bytes[self.at..];
                    let end = rest.iter().position(|b| *b == b'\n');
                    self.at += end.unwrap_or(rest.len());
                    continue;
                }
                _ => return,
            }
            self.at += 1;
        }
    }

    fn ended(&self) -> bool {
        self.at >= self.bytes.len()
    }

    /// Goes to the next line with a word; false at the end of the file.
    pub fn next_record(&mut self) -> bool {
        self.skip_blank(true);
        !self.ended()
    }

    /// As [`Self::next_record`] where text says what comes; numbers as bytes follow each other without a mark.
    pub fn record(&mut self, what: &str) -> Result<(), MeshError> {
        if matches!(self.coding, Coding::Binary(_)) || self.next_record() {
            return Ok(());
        }
        Err(self.cut_off(what))
    }

    /// That nothing is left in the line.
    pub fn end_record(&mut self, what: &str) -> Result<(), MeshError> {
        if matches!(self.coding, Coding::Binary(_)) {
            return Ok(());
        }
        self.skip_blank(false);
        match self.bytes.get(self.at) {
            None | Some(b'\n') => Ok(()),
            Some(_) => {
                let word = self.peek().into_owned();
                Err(self.expected(what, &word))
            }
        }
    }

    /// The next word, at which the file stands.
    fn peek(&self) -> std::borrow::Cow<'a, str> {
        let rest = &self.bytes[self.at..];
        let end = rest
            .iter()
            .position(|b| b.is_ascii_whitespace() || Some(*b) == self.comment);
        String::from_utf8_lossy(&rest[..end.unwrap_or(rest.len())])
    }

    pub fn next_word(&mut self) -> Option<&'a str> {
        self.skip_blank(self.coding != Coding::Lines);
        let rest = &self.bytes[self.at..];
        let ends = |b: &u8| b.is_ascii_whitespace() || Some(*b) == self.comment;
        let end = rest.iter().position(ends).unwrap_or(rest.len());
        if end == 0 {
            return None;
        }
        self.at += end;
        // What is no text is no word that a format knows.
        Some(std::str::from_utf8(&rest[..end]).unwrap_or("\u{fffd}"))
    }

    pub fn word(&mut self, what: &str) -> Result<&'a str, MeshError> {
        if let Some(word) = self.next_word() {
            return Ok(word);
        }
        if self.ended() {
            return Err(self.cut_off(what));
        }
        Err(self.expected(what, "the end of the line"))
    }

    pub fn keyword(&mut self, keyword: &str) -> Result<(), MeshError> {
        self.record(keyword)?;
        match self.word(keyword)? {
            word if word == keyword => Ok(()),
            word => Err(self.expected(keyword, word)),
        }
    }

    /// What is left of the line, trimmed.
    pub fn rest_of_line(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.at += end;
        rest[..end].trim_ascii()
    }

    /// Goes past the end of the line.
    pub fn next_line(&mut self) {
        self.rest_of_line();
        if !self.ended() {
            self.at += 1;
            self.line += 1;
            self.line_start = self.at;
        }
    }

    /// Goes past the next blank line.
    pub fn skip_paragraph(&mut self) {
        self.next_line();
        while !self.ended() && !self.rest_of_line().is_empty() {
            self.next_line();
        }
    }

    /// Goes on to the line that begins with `keyword`, after which it stands; false where there is none, and nothing is passed.
    pub fn skip_to(&mut self, keyword: &str) -> bool {
        let from = self.at.saturating_sub(1);
        let starts = |at: &usize| {
            let before = *at == 0 || self.bytes[*at - 1] == b'\n';
            let rest = &self.bytes[*at..];
            let after = rest.get(keyword.len());
            before
                && rest.starts_with(keyword.as_bytes())
                && after.is_none_or(u8::is_ascii_whitespace)
        };
        let Some(start) = (from..self.bytes.len()).find(starts) else {
            return false;
        };
        let passed = self.bytes[self.at.min(start)..start].iter();
        self.line += passed.filter(|b| **b == b'\n').count();
        self.line_start = start;
        self.at = start + keyword.len();
        true
    }

    /// Puts the place back to where the current line begins.
    pub fn back_to_line(&mut self) {
        self.at = self.line_start;
    }

    pub fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], MeshError> {
        let end = self.at.checked_add(count);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or_else(|| self.cut_off(what))?;
        self.at += count;
        Ok(taken)
    }

    /// A number: as a word, or as the bytes of its type.
    pub fn number(&mut self, kind: Kind, what: &str) -> Result<Number, MeshError> {
        if let Coding::Binary(endian) = self.coding {
            return Ok(kind.read(self.take(kind.size(), what)?, endian));
        }
        self.text_number(what)
    }

    /// A number as a word, also between bytes.
    pub fn text_number(&mut self, what: &str) -> Result<Number, MeshError> {
        let word = self.word(what)?;
        Number::parse(word).ok_or_else(|| self.expected(what, word))
    }

    /// As [`Self::text_number`], a whole number from 0 up.
    pub fn text_index(&mut self, what: &str) -> Result<u64, MeshError> {
        let number = self.text_number(what)?;
        number.index().ok_or_else(|| self.no(number, what))
    }

    /// That nothing is left in a line of text, and goes past it: bytes begin right there.
    pub fn end_text(&mut self, what: &str) -> Result<(), MeshError> {
        let rest = self.rest_of_line();
        if !rest.is_empty() {
            return Err(self.expected(what, &String::from_utf8_lossy(rest)));
        }
        self.next_line();
        Ok(())
    }

    pub fn real(&mut self, kind: Kind, what: &str) -> Result<f64, MeshError> {
        Ok(self.number(kind, what)?.real())
    }

    /// A whole number from 0 up.
    pub fn index(&mut self, kind: Kind, what: &str) -> Result<u64, MeshError> {
        let number = self.number(kind, what)?;
        number.index().ok_or_else(|| self.no(number, what))
    }

    pub fn region(&mut self, kind: Kind, what: &str) -> Result<i64, MeshError> {
        let number = self.number(kind, what)?;
        let what = format!("{what}, a whole number");
        number.region().ok_or_else(|| self.no(number, &what))
    }

    pub fn point(&mut self, kind: Kind) -> Result<[f64; 3], MeshError> {
        let mut at = [0.0; 3];
        for x in &mut at {
            *x = self.real(kind, "three coordinates")?;
        }
        Ok(at)
    }

    /// The error of a number that may not stand here.
    pub fn no(&self, number: Number, what: &str) -> MeshError {
        let found = match number {
            Number::Whole(x) => x.to_string(),
            Number::Real(x) => format!("{x}"),
        };
        self.expected(what, &found)
    }

    /// What stands here is not what the format asks for.
    pub fn expected(&self, expected: &str, found: &str) -> MeshError {
        let cut = |text: &str| text.chars().take(SHOWN).collect::<String>();
        let mut said = format!("`{}`", cut(found));
        if !matches!(self.coding, Coding::Binary(_)) {
            let start = self.line_start.min(self.at);
            let line = &self.bytes[start..];
            let end = line.iter().position(|b| *b == b'\n').unwrap_or(line.len());
            let line = match std::str::from_utf8(&line[..end]) {
                Ok(line) => line.trim_ascii(),
                Err(error) => return no_text(expected, line, start, error),
            };
            if line != found && !line.is_empty() {
                said = format!("{said} in `{}`", cut(line));
            }
        }
        MeshError::Syntax {
            at: self.place(),
            expected: expected.into(),
            found: said,
        }
    }

    /// The file ends here.
    pub fn cut_off(&self, expected: &str) -> MeshError {
        let at = match self.coding {
            Coding::Binary(_) => Place::Byte(self.bytes.len()),
            _ => Place::Line(self.line + usize::from(self.line_start < self.bytes.len())),
        };
        MeshError::Truncated {
            at,
            expected: expected.into(),
        }
    }
}
