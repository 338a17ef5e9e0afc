//! A recording as it is written: channels, schemas, attachments, metadata.
//!
//! Entry points: [`RecordingFile::create`], [`RecordingFile::write`], [`RecordingFile::finish`].

use super::about::{ABOUT, About};
use super::read::RecordingError;
use super::samples::{SolveSample, ToolSample};
use super::scene_sample::SceneSample;
use super::tap::Lost;
use super::{DOWN, SCENE, SOLVE, TOOL, UP};
use crate::scene::Sources;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, WriteOptions, Writer};
use schemars::{JsonSchema, schema_for};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sutura_files::may_write;

/// Bytes after which a chunk is closed and written: a third of a second, so that little is lost with a process that is
/// killed.
const CHUNK_BYTES: u64 = 64 << 10;
/// Name of the metadata record at the end.
pub(super) const ENDED: &str = "sutura-end";
/// How the attached document is called in the file; what follows is the path that it is known by.
pub(super) const DOCUMENT: &str = "scene:";
/// And the files that it names.
pub(super) const FILE: &str = "file:";
/// How frames are encoded.
pub(super) const FRAME_ENCODING: &str = "x-sutura-frame";

/// A message of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// [`DOWN`], [`UP`], [`SOLVE`], [`TOOL`] or [`SCENE`].
    pub topic: &'static str,
    /// Counts the messages of the topic from 1; a gap says that some were left out.
    pub sequence: u32,
    /// \[ns\]: since 1970, or in lockstep since the console booted.
    pub time_ns: u64,
    /// What it holds.
    pub bytes: Arc<[u8]>,
}

/// A recording that is being written.
pub struct RecordingFile {
    path: PathBuf,
    writer: Writer<File>,
    channels: BTreeMap<&'static str, u16>,
}

impl RecordingFile {
    /// Begins a file, in place of what was there.
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`].
    pub fn create(
        path: &Path,
        about: &About,
        sources: &Sources,
    ) -> Result<RecordingFile, RecordingError> {
        let begin = || -> Result<_, McapError> {
            let options = WriteOptions::new()
                .profile("")
                .library(format!("sutura {}", about.program))
                .chunk_size(Some(CHUNK_BYTES))
                // Chunks go out whole: what is in the file can be read.
                .disable_seeking(true);
            may_write(path)?;
            let mut writer = Writer::with_options(File::create(path)?, options)?;
            writer.write_metadata(&Metadata {
                name: ABOUT.to_owned(),
                metadata: about.words(),
            })?;
            attach(
                &mut writer,
                DOCUMENT,
                &sources.name,
                sources.text.as_bytes(),
            )?;
            for (name, bytes) in &sources.files {
                attach(&mut writer, FILE, name, bytes)?;
            }
            let none = BTreeMap::new();
            let solve = schema::<SolveSample>(&mut writer, "sutura.Solve")?;
            let tool = schema::<ToolSample>(&mut writer, "sutura.Tool")?;
            let scene = schema::<SceneSample>(&mut writer, "foxglove.SceneUpdate")?;
            let mut channels = BTreeMap::new();
            for (topic, schema, encoding) in [
                (DOWN, 0, FRAME_ENCODING),
                (UP, 0, FRAME_ENCODING),
                (SOLVE, solve, "json"),
                (TOOL, tool, "json"),
                (SCENE, scene, "json"),
            ] {
                channels.insert(topic, writer.add_channel(schema, topic, encoding, &none)?);
            }
            Ok((writer, channels))
        };
        let (writer, channels) = begin().map_err(|error| unwritable(path, error))?;
        Ok(RecordingFile {
            path: path.to_owned(),
            writer,
            channels,
        })
    }

    /// Appends a message.
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`]; nothing can be appended afterwards.
    pub fn write(&mut self, entry: &Entry) -> Result<(), RecordingError> {
        let Some(channel_id) = self.channels.get(entry.topic).copied() else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id,
            sequence: entry.sequence,
            log_time: entry.time_ns,
            publish_time: entry.time_ns,
        };
        let written = self.writer.write_to_known_channel(&header, &entry.bytes);
        written.map_err(|error| unwritable(&self.path, error))
    }

    /// Ends the file, with what was left out; its length \[bytes\].
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`].
    pub fn finish(mut self, lost: &Lost) -> Result<u64, RecordingError> {
        let words = [
            ("lost_down", lost.down),
            ("lost_up", lost.up),
            ("lost_solves", lost.solves),
        ];
        let metadata = Metadata {
            name: ENDED.to_owned(),
            metadata: words
                .into_iter()
                .map(|(key, count)| (key.to_owned(), count.to_string()))
                .collect(),
        };
        let end = |writer: &mut Writer<File>| {
            writer.write_metadata(&metadata)?;
            writer.finish()?;
            Ok(())
        };
        end(&mut self.writer).map_err(|error| unwritable(&self.path, error))?;
        let length = self.writer.into_inner().metadata();
        Ok(length.map_or(0, |metadata| metadata.len()))
    }
}

fn attach(
    writer: &mut Writer<File>,
    kind: &str,
    name: &str,
    bytes: &[u8],
) -> Result<(), McapError> {
    let media_type = if name.ends_with(".toml") {
        "application/toml"
    } else {
        "application/octet-stream"
    };
    writer.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: format!("{kind}{name}"),
        media_type: media_type.to_owned(),
        data: bytes.into(),
    })
}

fn schema<T: JsonSchema>(writer: &mut Writer<File>, name: &str) -> Result<u16, McapError> {
    let schema = serde_json::to_vec(&schema_for!(T)).map_err(io::Error::other)?;
    writer.add_schema(name, "jsonschema", &schema)
}

fn unwritable(path: &Path, error: McapError) -> RecordingError {
    let (reason, kind) = match error {
        McapError::Io(error) => (error.to_string(), error.kind()),
        error => (error.to_string(), io::ErrorKind::Other),
    };
    RecordingError::Unwritable {
        path: path.to_owned(),
        reason,
        kind,
    }
}
