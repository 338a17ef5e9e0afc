//! A TOML file that people write: parsing and complaints that point at the character.
//!
//! Entry point: [`Document`]. Every complaint about a scene or a device is a [`SceneError`] made here.

use crate::model::ModelError;
use crate::text::{NotText, utf8};
use miette::{Diagnostic, NamedSource, Severity, SourceSpan};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf, absolute};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use sutura_files::{MOST_TEXT, read_plain};
use sutura_models::memory::Shortage;
use thiserror::Error;
use toml::Spanned;

/// Why a scene or a device file cannot be used.
#[derive(Debug, Error, Diagnostic)]
pub enum SceneError {
    /// The file itself cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    #[diagnostic(help("name a plain file that exists, by its path from the directory you are in"))]
    Unreadable {
        /// As asked for.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// What is read is no text.
    #[error("cannot read {}: {source}", path.display())]
    #[diagnostic(help("{}", source.help()))]
    NotText {
        /// As asked for.
        path: PathBuf,
        /// Where it is none.
        source: NotText,
    },
    /// Something in the file is wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Flaw(Box<Flaw>),
    /// A model that has no solver but that of sessions.
    #[error("{model} tissue runs in sessions only: it has no rows and no solve at rest")]
    #[diagnostic(help(
        "`sutura run` takes it; here change `model` in `[tissue]` to `linear`, `corotational` or `hyperelastic`"
    ))]
    OnlySessions {
        /// The model.
        model: &'static str,
    },
    /// More than there is memory for.
    #[error("a mesh of {nodes} nodes is too large for this machine: {shortage}")]
    #[diagnostic(help(
        "take a coarser mesh: with half the `divisions` along each axis the factor takes about a sixteenth; or close other programs"
    ))]
    TooLarge {
        /// Nodes of the mesh.
        nodes: usize,
        /// What is missing.
        shortage: Shortage,
    },
    /// Tissue that cannot bear its own weight.
    #[error(
        "the tissue finds no balance under its weight of {weight_n:.3} N and its loads: at small displacements it would sag by {:.1} mm, \
         and it is {:.1} mm in size",
        1e3 * sag_m,
        1e3 * size_m
    )]
    #[diagnostic(help(
        "see that `youngs_modulus_pa` is in Pa, `density_kg_per_m3` in kg/m^3 and `gravity_m_per_s2` in m/s^2; then make the tissue stiffer, or \
         hold more of it by `[[fixed]]`"
    ))]
    Collapses {
        /// Its weight \[N\].
        weight_n: f64,
        /// How far linear tissue would go \[m\].
        sag_m: f64,
        /// Largest side of the box around it \[m\].
        size_m: f64,
    },
    /// The parts are good each by itself, but the solver cannot be built from them.
    #[error("the scene cannot be built: {0}")]
    #[diagnostic(help(
        "see what holds the tissue, what acts on it and what touches it: `[[fixed]]`, `[[handle]]`, `[[load]]`, `[[tool]]`, `[[needle]]`"
    ))]
    Build(ModelError),
}

/// One complaint or warning about a file, with the place it is about.
#[derive(Debug, Error)]
#[error("{message}")]
pub struct Flaw {
    message: String,
    label: String,
    help: Option<String>,
    severity: Severity,
    source_code: NamedSource<String>,
    span: SourceSpan,
}

impl Flaw {
    /// Returns an error with another message at the same place.
    pub(super) fn saying(&self, message: String) -> Self {
        Self {
            message,
            label: self.label.clone(),
            help: self.help.clone(),
            severity: Severity::Error,
            source_code: NamedSource::new(
                self.source_code.name(),
                self.source_code.inner().clone(),
            )
            .with_language("TOML"),
            span: self.span,
        }
    }

    /// Where in the file: offset and length \[bytes\].
    pub fn span(&self) -> SourceSpan {
        self.span
    }
}

impl Diagnostic for Flaw {
    fn severity(&self) -> Option<Severity> {
        Some(self.severity)
    }

    fn help<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        self.help
            .as_ref()
            .map(|h| Box::new(h) as Box<dyn std::fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        Some(&self.source_code)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = miette::LabeledSpan> + '_>> {
        let label = Some(self.label.clone()).filter(|l| !l.is_empty());
        Some(Box::new(std::iter::once(
            miette::LabeledSpan::new_with_span(label, self.span),
        )))
    }
}

/// A file's text with the name and the directory that it is known by.
#[derive(Clone, Debug)]
pub struct Document {
    name: String,
    directory: PathBuf,
    text: String,
    files: Files,
}

/// Files that documents name, by their paths as seen from the document's directory.
#[derive(Clone, Debug)]
enum Files {
    /// On disk; those that have been read so far are kept.
    Disk(Arc<Mutex<Read>>),
    /// These and no others.
    Given(Arc<BTreeMap<String, Vec<u8>>>),
}

/// Files that have been read from disk.
#[derive(Debug, Default)]
struct Read {
    /// By their paths as seen from the document's directory, without the document itself.
    files: BTreeMap<String, Vec<u8>>,
    /// Their absolute paths, with the document's: the program may go to another directory.
    paths: Vec<PathBuf>,
}

/// A document with all files that were read for it: what it takes to read it again elsewhere.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sources {
    /// What the document is known by.
    pub name: String,
    /// Its text.
    pub text: String,
    /// The files, by their paths as the document sees them.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Document {
    /// Reads a file.
    ///
    /// # Errors
    /// [`SceneError::Unreadable`] when the system says so, [`SceneError::NotText`].
    pub fn read(path: &Path) -> Result<Document, SceneError> {
        let read = Read {
            paths: vec![whole(path)],
            ..Read::default()
        };
        let files = Files::Disk(Arc::new(Mutex::new(read)));
        Self::from_bytes(path, read_plain(path, MOST_TEXT), files)
    }

    /// What was read at `path`, or why not; the files that it names are among `files`.
    fn from_bytes(
        path: &Path,
        read: io::Result<Vec<u8>>,
        files: Files,
    ) -> Result<Document, SceneError> {
        let path_of = || path.to_owned();
        let bytes = read.map_err(|source| SceneError::Unreadable {
            path: path_of(),
            source,
        })?;
        let text = utf8(bytes).map_err(|source| SceneError::NotText {
            path: path_of(),
            source,
        })?;
        Ok(Document {
            name: path.display().to_string(),
            directory: path.parent().unwrap_or(Path::new("")).to_owned(),
            text,
            files,
        })
    }

    /// A document from what [`Document::sources`] gave; the disk is not looked at.
    pub fn from_sources(sources: &Sources) -> Document {
        Document {
            name: sources.name.clone(),
            directory: PathBuf::new(),
            text: sources.text.clone(),
            files: Files::Given(Arc::new(sources.files.clone())),
        }
    }

    /// The document and every file that has been read through it so far.
    pub fn sources(&self) -> Sources {
        let files = match &self.files {
            Files::Disk(read) => lock(read).files.clone(),
            Files::Given(files) => (**files).clone(),
        };
        Sources {
            name: self.name.clone(),
            text: self.text.clone(),
            files,
        }
    }

    /// Every file on disk that has been read for the document so far, and its own, by absolute paths: what nothing may be written over.
    pub fn paths(&self) -> Vec<PathBuf> {
        match &self.files {
            Files::Disk(read) => lock(read).paths.clone(),
            Files::Given(_) => Vec::new(),
        }
    }

    /// A file held in memory; its relative paths start at `directory`.
    pub fn embedded(name: &str, directory: &Path, text: &str) -> Document {
        Document {
            name: name.to_owned(),
            directory: directory.to_owned(),
            text: text.to_owned(),
            files: Files::Disk(Arc::default()),
        }
    }

    /// Its text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The same with another text.
    pub fn with_text(self, text: String) -> Document {
        Document { text, ..self }
    }

    /// Its name without folders and extension.
    pub fn stem(&self) -> String {
        let stem = Path::new(&self.name).file_stem();
        stem.map(|stem| stem.to_string_lossy().into_owned())
            .unwrap_or_default()
    }

    /// A path written in this file.
    pub fn resolve(&self, path: &str) -> PathBuf {
        self.directory.join(path)
    }

    /// Reads a plain file of at most `most` bytes at a [resolved](Self::resolve) path.
    ///
    /// # Errors
    /// The same as [`read_plain`]'s.
    pub fn file(&self, path: &Path, most: u64) -> io::Result<Vec<u8>> {
        let key = self.key(path);
        match &self.files {
            Files::Given(files) => files.get(&key).cloned().ok_or_else(|| {
                io::Error::new(io::ErrorKind::NotFound, "it did not come with the document")
            }),
            Files::Disk(read) => {
                let bytes = read_plain(path, most)?;
                let mut read = lock(read);
                read.paths.push(whole(path));
                read.files.insert(key, bytes.clone());
                Ok(bytes)
            }
        }
    }

    /// Whether there is a file at a [resolved](Self::resolve) path.
    pub fn has_file(&self, path: &Path) -> bool {
        match &self.files {
            Files::Given(files) => files.contains_key(&self.key(path)),
            Files::Disk(_) => path.exists(),
        }
    }

    /// The document at a [resolved](Self::resolve) path.
    ///
    /// # Errors
    /// As of [`Document::read`].
    pub fn open(&self, path: &Path) -> Result<Document, SceneError> {
        Self::from_bytes(path, self.file(path, MOST_TEXT), self.files.clone())
    }

    fn key(&self, path: &Path) -> String {
        let seen = path.strip_prefix(&self.directory).unwrap_or(path);
        seen.to_string_lossy().into_owned()
    }

    /// Reads the text as `T`; unknown keys are refused where `T` refuses them.
    ///
    /// # Errors
    /// A [`Flaw`] at the character, with the nearest known key for a misspelt one.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, SceneError> {
        toml::from_str(&self.text).map_err(|error| self.unread(&error))
    }

    /// What the parser said of the text: a [`Flaw`] at the character, with the nearest known key for a misspelt one.
    pub(super) fn unread(&self, error: &toml::de::Error) -> SceneError {
        self.said(error.span().unwrap_or(0..0), error.message().trim_end())
    }

    /// As [`Self::unread`], in the parser's words.
    pub(super) fn said(&self, span: Range<usize>, message: &str) -> SceneError {
        let (message, label, help) = explain(message);
        self.flaw(span, message, label, help.as_deref())
    }

    /// A complaint about `span`.
    pub fn flaw(
        &self,
        span: Range<usize>,
        message: impl Into<String>,
        label: impl Into<String>,
        help: Option<&str>,
    ) -> SceneError {
        let flaw = self.note(Severity::Error, span, message.into(), label.into(), help);
        SceneError::Flaw(Box::new(flaw))
    }

    /// A warning about `span`.
    pub fn warning(&self, span: Range<usize>, message: &str, label: &str, help: &str) -> Flaw {
        self.note(
            Severity::Warning,
            span,
            message.to_owned(),
            label.to_owned(),
            Some(help),
        )
    }

    /// Says something of a place that does not keep the scene from being used.
    pub(super) fn note(
        &self,
        severity: Severity,
        span: Range<usize>,
        message: String,
        label: String,
        help: Option<&str>,
    ) -> Flaw {
        // A span over several lines (a whole table) is marked at its first.
        let covered = self.text.get(span.clone()).unwrap_or("");
        let first_line = covered.lines().next().unwrap_or("").len();
        let span = span.start..span.start + first_line;
        Flaw {
            message,
            label,
            help: help.map(str::to_owned),
            severity,
            source_code: NamedSource::new(&self.name, self.text.clone()).with_language("TOML"),
            span: span.into(),
        }
    }

    /// The value, if it is finite and `ok` holds for it.
    ///
    /// # Errors
    /// A [`Flaw`] at the value: "`key` = value: must be `rule`".
    pub fn number(
        &self,
        key: &str,
        value: &Spanned<f64>,
        rule: &str,
        ok: impl Fn(f64) -> bool,
        help: &str,
    ) -> Result<f64, SceneError> {
        let number = *value.get_ref();
        if number.is_finite() && ok(number) {
            return Ok(number);
        }
        let message = format!("{key} = {number}: must be {rule}");
        Err(self.flaw(value.span(), message, format!("must be {rule}"), Some(help)))
    }

    /// The vector, if all its entries are finite.
    ///
    /// # Errors
    /// A [`Flaw`] at the vector.
    pub fn finite<const N: usize>(
        &self,
        key: &str,
        value: &Spanned<[f64; N]>,
    ) -> Result<[f64; N], SceneError> {
        if value.get_ref().iter().all(|v| v.is_finite()) {
            return Ok(*value.get_ref());
        }
        let message = format!("{key}: every entry must be a finite number");
        Err(self.flaw(
            value.span(),
            message,
            "not finite",
            Some("`inf` and `nan` are no places"),
        ))
    }
}

/// The path from the root on, of a file that is read now.
fn whole(path: &Path) -> PathBuf {
    absolute(path).unwrap_or_else(|_| path.to_owned())
}

fn lock(read: &Mutex<Read>) -> MutexGuard<'_, Read> {
    read.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What to do who asks for cells of a higher order.
const CELLS: &str = "tools, needles and threads meet cells of four nodes: mesh finer, or for a truth to compare with take `model = \"hyperelastic\"` with `setting = \"quadratic cells, to 1e-3\"`, whose nodes on edges are its own";

/// Message, label and help for what the parser said.
fn explain(message: &str) -> (String, String, Option<String>) {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let (what, word, known) = match quoted.split_first() {
        Some((word, known)) if message.starts_with("unknown field") => ("key", *word, known),
        Some((word, known)) if message.starts_with("unknown variant") => ("value", *word, known),
        Some((word, _)) if message.starts_with("missing field") => {
            let help = format!("add `{word} = ...`, or `[{word}]` if it is a section");
            return (
                format!("missing key `{word}`"),
                "needed here".to_owned(),
                Some(help),
            );
        }
        _ => return (in_words(message), String::new(), None),
    };
    let all = known
        .iter()
        .map(|k| format!("`{k}`"))
        .collect::<Vec<_>>()
        .join(", ");
    let help = match nearest(word, known) {
        _ if (what, word) == ("key", "cells") => format!("{CELLS}; known here: {all}"),
        Some(near) => format!("did you mean `{near}`? Known here: {all}"),
        None => format!("known here: {all}"),
    };
    (
        format!("unknown {what} `{word}`"),
        format!("no such {what}"),
        Some(help),
    )
}

/// What a parser says of a value of another kind, without names of types.
fn in_words(message: &str) -> String {
    let Some((found, wanted)) = message.split_once(", expected ") else {
        return message.to_owned();
    };
    let kinds = found
        .strip_prefix("invalid type: ")
        .or(found.strip_prefix("invalid value: "));
    let length = found.strip_prefix("invalid length ");
    let found = match (kinds, length) {
        (Some(found), _) => in_place(found),
        (None, Some(length)) => format!("a list of {length}"),
        (None, None) => return message.to_owned(),
    };
    let of_length = ["an array of length ", "a tuple of size ", "a sequence of "];
    let length = of_length
        .iter()
        .find_map(|words| wanted.strip_prefix(words));
    let wanted = match (wanted, length) {
        (_, Some(length)) => format!("a list of {length}"),
        ("f64" | "f32", _) => "a number".to_owned(),
        ("u8", _) => "a whole number from 0 to 255".to_owned(),
        ("usize" | "u16" | "u32" | "u64", _) => "a whole number from 0 up".to_owned(),
        ("i8" | "i16" | "i32" | "i64" | "isize", _) => "a whole number".to_owned(),
        ("a string", _) => "text".to_owned(),
        ("a boolean", _) => "true or false".to_owned(),
        ("a sequence", _) => "a list".to_owned(),
        ("a map", _) => "a section".to_owned(),
        (wanted, _) if wanted.starts_with("struct ") => "a section".to_owned(),
        (wanted, _) => wanted.to_owned(),
    };
    format!("{wanted} is needed here, not {found}")
}

/// What stands in the place of something else: a value as it is written, text and more by its kind.
fn in_place(found: &str) -> String {
    let by_itself = ["integer ", "floating point ", "boolean "];
    let value = by_itself.iter().find_map(|kind| found.strip_prefix(kind));
    match (value, found.strip_prefix("string "), found) {
        (Some(value), ..) => value.to_owned(),
        (None, Some(text), _) => format!("the text {text}"),
        (None, None, "sequence") => "a list".to_owned(),
        (None, None, "map") => "a section".to_owned(),
        (None, None, other) => other.to_owned(),
    }
}

/// The known word nearest to a misspelt one, if one is near enough to be meant.
pub fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    // A wrong unit suffix ("radius_mm" for "radius_m") is near; an unrelated word is not.
    let scored = known.iter().map(|k| (strsim::jaro_winkler(word, k), *k));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= 0.8).then_some(best.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of values of another kind the parser names types of the language that nobody who writes a scene has to know.
    #[test]
    fn values_of_another_kind_are_told_in_words() {
        for (text, said) in [
            (
                "n = \"a\"",
                "a whole number from 0 up is needed here, not the text \"a\"",
            ),
            (
                "n = -5",
                "a whole number from 0 up is needed here, not `-5`",
            ),
            ("x = true", "a number is needed here, not `true`"),
            (
                "at = [1.0, 2.0]",
                "a list of 3 is needed here, not a list of 2",
            ),
            ("at = 1.0", "a list of 3 is needed here, not `1.0`"),
            ("part = 3", "a section is needed here, not `3`"),
            ("x = [1.0]", "a number is needed here, not a list"),
            ("x = { y = 1 }", "a number is needed here, not a section"),
        ] {
            let document = Document::embedded("a.toml", Path::new(""), text);
            let error = document.parse::<Anything>().expect_err(text);
            assert_eq!(error.to_string(), said, "{text}");
        }
    }

    #[derive(Debug, serde::Deserialize)]
    #[allow(dead_code, reason = "never read")]
    struct Anything {
        n: Option<usize>,
        x: Option<f64>,
        at: Option<[f64; 3]>,
        part: Option<Part>,
    }

    #[derive(Debug, serde::Deserialize)]
    struct Part {}

    #[test]
    fn a_misspelt_word_finds_its_neighbour_and_a_foreign_one_none() {
        let known = ["youngs_modulus_pa", "poisson_ratio", "model"];
        assert_eq!(
            nearest("yungs_modulus_pa", &known),
            Some("youngs_modulus_pa")
        );
        assert_eq!(nearest("poison_ratio", &known), Some("poisson_ratio"));
        assert_eq!(
            nearest("youngs_modulus_kpa", &known),
            Some("youngs_modulus_pa")
        );
        assert_eq!(nearest("colour", &known), None);
    }
}
