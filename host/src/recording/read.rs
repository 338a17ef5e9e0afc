//! A recording as it is read.
//!
//! Entry point: [`Recording::read`]. A file that was cut off, as by a killed process, is read as far as it goes.

use super::about::{ABOUT, About, CONSOLE_CODE};
use super::file::{DOCUMENT, ENDED, FILE};
use super::samples::SolveSample;
use super::tap::Direction;
use super::{DOWN, SOLVE, UP};
use crate::scene::{self, Document, Scene, SceneError, Sources, Tissue};
use mcap::read::{ChunkFlattener, Options};
use mcap::records::Record;
use std::collections::{BTreeMap, HashMap};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use sutura_files::read_plain;
use sutura_models::memory::require;
use sutura_shared::control::CODE;
use sutura_shared::wire::{PROTOCOL_VERSION, SCHEMA_HASH};
use thiserror::Error;

/// Why a recording cannot be written or read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RecordingError {
    /// The system does not take it.
    #[error("cannot write the recording {}: {reason}", path.display())]
    Unwritable {
        /// Where it was to be.
        path: PathBuf,
        /// What the system says.
        reason: String,
        /// Its kind.
        kind: ErrorKind,
    },
    /// The system does not give it.
    #[error("cannot read the recording {}: {reason}", path.display())]
    Unreadable {
        /// Where it was to be.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// It is something else.
    #[error("{} is no recording of this program: {reason}", path.display())]
    NotARecording {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// It holds frames of another protocol.
    #[error(
        "{} was recorded with protocol version {protocol}, schema {schema_hash:016x}, by version {program}; this program \
         has protocol version {PROTOCOL_VERSION}, schema {SCHEMA_HASH:016x}",
        path.display()
    )]
    OtherProtocol {
        /// Which file.
        path: PathBuf,
        /// Its version of the protocol.
        protocol: u8,
        /// Its messages.
        schema_hash: u64,
        /// The program that wrote it.
        program: String,
    },
    /// It was made with a console that computes other bits.
    #[error(
        "{} was recorded with {}, by version {program}; this program has console code {CODE}",
        path.display(),
        code_in_words(code.as_deref())
    )]
    OtherConsole {
        /// Which file.
        path: PathBuf,
        /// Its console's code, as it says; none in recordings of programs that did not say.
        code: Option<String>,
        /// The program that wrote it.
        program: String,
    },
}

fn code_in_words(code: Option<&str>) -> String {
    code.map_or_else(
        || "a console code that had no number yet".to_owned(),
        |code| format!("console code {code}"),
    )
}

impl RecordingError {
    /// What the user can do.
    pub fn help(&self) -> &'static str {
        match self {
            RecordingError::Unwritable { .. } => {
                "give a path in a folder that exists, on a disk with room: some 10 to 30 MB a minute"
            }
            RecordingError::Unreadable { .. } => "give the path of a plain file that exists",
            RecordingError::NotARecording { .. } => {
                "give a file that `sutura run --record FILE` has written"
            }
            RecordingError::OtherProtocol { .. } | RecordingError::OtherConsole { .. } => {
                "replay it with the release that recorded it; other programs still show its channels"
            }
        }
    }
}

/// A frame as it went over the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Which way.
    pub direction: Direction,
    /// Counts the frames of its direction; a gap says that some are missing.
    pub sequence: u32,
    /// When, by the host's clock \[ns\].
    pub time_ns: u64,
    /// Its bytes, delimiter included; damaged ones are there too.
    pub bytes: Vec<u8>,
}

/// How a recording ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// As it should.
    Whole,
    /// The file was cut off or is damaged; why, in words.
    Cut(String),
}

/// A recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What it says of itself.
    pub about: About,
    /// The scene, and the files that it names.
    pub sources: Sources,
    /// Frames, in the order in which they were written down.
    pub frames: Vec<Frame>,
    /// Solves, with their number in the session.
    pub solves: Vec<(u32, SolveSample)>,
    /// How it ends.
    pub end: End,
}

/// Largest recording that is read \[bytes\]: a day has 14 to 43 GB.
const MOST_BYTES: u64 = 64 << 30;

impl Recording {
    /// Reads a file.
    ///
    /// # Errors
    /// [`RecordingError`], but for one that was cut off: see [`Recording::end`].
    pub fn read(path: &Path) -> Result<Recording, RecordingError> {
        let unreadable = |reason: String| RecordingError::Unreadable {
            path: path.to_owned(),
            reason,
        };
        // The bytes, and what they say.
        let length = path
            .metadata()
            .map_or(0, |found| found.len().min(MOST_BYTES));
        require("a recording", 2 * length).map_err(|shortage| unreadable(shortage.to_string()))?;
        let bytes = read_plain(path, MOST_BYTES).map_err(|error| unreadable(error.to_string()))?;
        Self::from_bytes(path, &bytes)
    }

    /// The scene that was run, with the tissue that it was run with.
    ///
    /// # Errors
    /// What this program does not take of it.
    pub fn scene(&self) -> Result<Scene, SceneError> {
        let mut scene = scene::read(&Document::from_sources(&self.sources))?;
        if let Ok(tissue) = Tissue::named(&self.about.tissue) {
            scene.tissue = tissue.instead_of(scene.tissue);
        }
        Ok(scene)
    }

    /// Reads what is in a file; `path` is for messages.
    ///
    /// # Errors
    /// As [`Recording::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Recording, RecordingError> {
        let not = |reason: String| RecordingError::NotARecording {
            path: path.to_owned(),
            reason,
        };
        if !bytes.starts_with(mcap::MAGIC) {
            return Err(not("it is no MCAP file".to_owned()));
        }
        let mut parts = Parts::default();
        let read = parts.take_in(bytes);
        let Some(words) = &parts.about else {
            return Err(not(match read {
                Ok(()) => "it is an MCAP file without this program's metadata".to_owned(),
                Err(reason) => format!("it ends before it begins: {reason}"),
            }));
        };
        // The protocol first: the rest may have another form with another one.
        if let (Some(protocol), Some(schema_hash)) = (
            words.get("protocol").and_then(|word| word.parse().ok()),
            words
                .get("schema_hash")
                .and_then(|word| u64::from_str_radix(word, 16).ok()),
        ) && (protocol, schema_hash) != (PROTOCOL_VERSION, SCHEMA_HASH)
        {
            return Err(RecordingError::OtherProtocol {
                path: path.to_owned(),
                protocol,
                schema_hash,
                program: words.get("program").cloned().unwrap_or_default(),
            });
        }
        let code = words.get(CONSOLE_CODE);
        if code.and_then(|code| code.parse().ok()) != Some(CODE) {
            return Err(RecordingError::OtherConsole {
                path: path.to_owned(),
                code: code.cloned(),
                program: words.get("program").cloned().unwrap_or_default(),
            });
        }
        let about = About::from_words(words).map_err(not)?;
        Ok(Recording {
            about,
            sources: parts.sources,
            frames: parts.frames,
            solves: parts.solves,
            end: match read {
                Ok(()) if parts.ended => End::Whole,
                Ok(()) => End::Cut("it was not finished".to_owned()),
                Err(reason) => End::Cut(reason),
            },
        })
    }
}

#[derive(Default)]
struct Parts {
    about: Option<BTreeMap<String, String>>,
    ended: bool,
    topics: HashMap<u16, String>,
    sources: Sources,
    frames: Vec<Frame>,
    solves: Vec<(u32, SolveSample)>,
}

impl Parts {
    /// As far as it goes; otherwise why it ends there.
    fn take_in(&mut self, bytes: &[u8]) -> Result<(), String> {
        let options = Options::IgnoreEndMagic | Options::ValidateChunkCrcs;
        let records = ChunkFlattener::new_with_options(bytes, options);
        for record in records.map_err(|error| error.to_string())? {
            self.take(record.map_err(|error| error.to_string())?)?;
        }
        Ok(())
    }

    fn take(&mut self, record: Record<'_>) -> Result<(), String> {
        match record {
            Record::Metadata(metadata) if metadata.name == ABOUT => {
                self.about = Some(metadata.metadata);
            }
            Record::Metadata(metadata) if metadata.name == ENDED => self.ended = true,
            Record::Attachment { header, data, .. } => {
                if let Some(name) = header.name.strip_prefix(DOCUMENT) {
                    self.sources.name = name.to_owned();
                    self.sources.text = String::from_utf8(data.into_owned())
                        .map_err(|_| "the attached scene is not text".to_owned())?;
                } else if let Some(name) = header.name.strip_prefix(FILE) {
                    self.sources
                        .files
                        .insert(name.to_owned(), data.into_owned());
                }
            }
            Record::Channel(channel) => {
                self.topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                let topic = self.topics.get(&header.channel_id).map(String::as_str);
                let direction = match topic {
                    Some(DOWN) => Direction::Down,
                    Some(UP) => Direction::Up,
                    Some(SOLVE) => {
                        let sample = serde_json::from_slice(&data)
                            .map_err(|error| format!("a solve cannot be read: {error}"))?;
                        self.solves.push((header.sequence, sample));
                        return Ok(());
                    }
                    _ => return Ok(()),
                };
                self.frames.push(Frame {
                    direction,
                    sequence: header.sequence,
                    time_ns: header.log_time,
                    bytes: data.into_owned(),
                });
            }
            _ => {}
        }
        Ok(())
    }
}
