//! The lines of a mesh file, and errors that say which.
//!
//! Entry point: [`Lines::new`].

use super::MeshError;

/// The lines of a file, counted.
pub(super) struct Lines<'a> {
    lines: std::str::Lines<'a>,
    /// The current line, from 1.
    pub number: usize,
}

impl<'a> Lines<'a> {
    pub fn new(text: &'a str) -> Self {
        Self {
            lines: text.lines(),
            number: 0,
        }
    }

    /// The next line that is not blank, trimmed.
    pub fn next_filled(&mut self) -> Option<&'a str> {
        loop {
            self.number += 1;
            let line = self.lines.next()?.trim();
            if !line.is_empty() {
                return Some(line);
            }
        }
    }

    pub fn next(&mut self, expected: &str) -> Result<&'a str, MeshError> {
        self.next_filled().ok_or_else(|| MeshError::Truncated {
            line: self.number,
            expected: expected.into(),
        })
    }

    pub fn skip_to(&mut self, end: &str) -> Result<(), MeshError> {
        while self.next(end)? != end {}
        Ok(())
    }

    pub fn end(&mut self, end: &str) -> Result<(), MeshError> {
        let line = self.next(end)?;
        if line == end {
            Ok(())
        } else {
            Err(self.expected(end, line))
        }
    }

    pub fn expected(&self, expected: &str, found: &str) -> MeshError {
        let mut found: String = found.chars().take(60).collect();
        found = format!("`{found}`");
        MeshError::Syntax {
            line: self.number,
            expected: expected.into(),
            found,
        }
    }

    pub fn integer(&self, word: Option<&str>, line: &str, what: &str) -> Result<u64, MeshError> {
        word.and_then(|word| word.parse().ok())
            .ok_or_else(|| self.expected(what, line))
    }

    /// A line of exactly N unsigned integers.
    pub fn integers<const N: usize>(&mut self, what: &str) -> Result<[u64; N], MeshError> {
        let line = self.next(what)?;
        let mut words = line.split_whitespace();
        let mut values = [0; N];
        for value in &mut values {
            *value = self.integer(words.next(), line, what)?;
        }
        if words.next().is_some() {
            return Err(self.expected(what, line));
        }
        Ok(values)
    }

    pub fn point<'w>(
        &self,
        words: &mut impl Iterator<Item = &'w str>,
        line: &str,
    ) -> Result<[f64; 3], MeshError> {
        let mut at = [0.0; 3];
        for x in &mut at {
            *x = words
                .next()
                .and_then(|word| word.parse().ok())
                .ok_or_else(|| self.expected("three coordinates", line))?;
        }
        Ok(at)
    }

    /// A region's number; some programs write it as a decimal.
    pub fn region(&self, word: &str, line: &str) -> Result<i64, MeshError> {
        let exact = |x: &f64| x.fract() == 0.0 && x.abs() < 9e15;
        word.parse::<f64>()
            .ok()
            .filter(exact)
            .map(|x| x as i64)
            .ok_or_else(|| self.expected("a whole number as the region", line))
    }

    /// Goes past one line, whatever it has.
    pub fn skip_one(&mut self) {
        self.number += 1;
        self.lines.next();
    }

    /// Goes past the next blank line.
    pub fn skip_past_blank(&mut self) {
        for line in self.lines.by_ref() {
            self.number += 1;
            if line.trim().is_empty() {
                break;
            }
        }
    }
}
