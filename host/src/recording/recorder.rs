//! The thread that writes a recording, and keeps the last seconds.
//!
//! Entry points: [`Recorder::start`], [`Recorder::tap`], [`Recorder::finish`]. Sessions tell what passes through a bounded
//! queue; this thread cuts bytes into frames, thins grip and force out for plots, and writes.

use super::about::{About, Begins};
use super::file::{Entry, RecordingFile};
use super::read::RecordingError;
use super::ring::{LAST, LAST_BYTES, Ring};
use super::samples::{SolveSample, ToolSample};
use super::tap::{Direction, Event, Lost, Tap};
use super::{DOWN, SCENE, SOLVE, TOOL, UP};
use crate::scene::Sources;
use serde::Serialize;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use sutura_files::lead_to_one;
use sutura_shared::wire::message::State;
use sutura_shared::wire::{Accumulator, Checked, Valid, decode};

/// Events that may wait: two seconds of 1000 states, 1000 contacts and 1000 solves.
const QUEUE: usize = 8192;
/// Longest piece without a delimiter that is kept as a frame \[bytes\]; on a broken line more may come.
const LONGEST: usize = 8192;
/// Time between two samples of grip and force \[us\]: a plot of a session shows no more.
const TOOL_EVERY_US: u64 = 20_000;
/// How long the last seconds may take to be written.
const SAVE_WITHIN: Duration = Duration::from_secs(60);

/// What passes, for whoever looks on.
#[derive(Clone, Copy, Debug)]
pub enum Passed<'a> {
    /// A state of the console.
    State(&'a Valid<State>),
    /// A solve, with its times on the wall.
    Solve(&'a SolveSample),
}

/// Who looks on; must not wait for anybody.
pub type Seen = Box<dyn FnMut(Passed<'_>) + Send>;

/// A running recorder. Dropping it ends the file as [`Recorder::finish`] does.
#[derive(Debug)]
pub struct Recorder {
    tap: Tap,
    thread: Option<JoinHandle<Result<Recorded, RecordingError>>>,
}

/// Who asks a recorder for files while it runs.
#[derive(Clone, Debug)]
pub struct Saver(Tap);

impl Saver {
    /// Writes the last seconds to a file; its length \[bytes\].
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`].
    pub fn save_last(&self, path: &Path) -> Result<u64, RecordingError> {
        let saved = path.to_owned();
        self.ask(path, |done| Event::Save { path: saved, done })
    }

    /// Ends the file that all is written to; its length \[bytes\], 0 if there is none. What comes later is not in it.
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`], also of something that was told earlier.
    pub fn end_file(&self) -> Result<u64, RecordingError> {
        self.ask(Path::new(""), |done| Event::Close { done })
    }

    fn ask(
        &self,
        path: &Path,
        what: impl FnOnce(Sender<Result<u64, RecordingError>>) -> Event,
    ) -> Result<u64, RecordingError> {
        let (done, answer) = channel();
        self.0.must_tell(what(done));
        let answered = answer.recv_timeout(SAVE_WITHIN);
        answered.unwrap_or_else(|error| {
            Err(RecordingError::Unwritable {
                path: path.to_owned(),
                reason: format!("the recorder does not answer: {error}"),
                kind: ErrorKind::TimedOut,
            })
        })
    }
}

/// What was recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recorded {
    /// Length of the file \[bytes\]; 0 without one.
    pub bytes: u64,
    /// Frames, both ways.
    pub frames: u64,
    /// Solves.
    pub solves: u64,
    /// What was left out.
    pub lost: Lost,
}

impl Recorder {
    /// Starts the thread, with a file or to keep the last seconds alone.
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`].
    pub fn start(
        file: Option<&Path>,
        about: About,
        sources: Sources,
    ) -> Result<Recorder, RecordingError> {
        Self::start_seen(file, about, sources, Box::new(|_| {}))
    }

    /// As [`Self::start`]; `seen` is shown everything that passes, in this thread.
    ///
    /// # Errors
    /// As there.
    pub fn start_seen(
        file: Option<&Path>,
        about: About,
        sources: Sources,
        seen: Seen,
    ) -> Result<Recorder, RecordingError> {
        let open = |path| RecordingFile::create(path, &about, &sources);
        let path = file.map(Path::to_owned);
        let file = file.map(open).transpose()?;
        let (queue, events) = sync_channel(QUEUE);
        let tap = Tap::new(queue, about.lockstep, file.is_some());
        let mut writing = Writing {
            tap: tap.clone(),
            about,
            sources,
            path,
            file,
            failed: None,
            ring: Ring::new(LAST, LAST_BYTES),
            lines: [Line::new(DOWN), Line::new(UP)],
            solves: Numbers::default(),
            tools: 0,
            next_tool_us: 0,
            recorded: Recorded::default(),
            seen,
        };
        let thread = std::thread::Builder::new()
            .name("sutura-record".to_owned())
            .spawn(move || {
                writing.serve(&events);
                writing.finish()
            });
        let thread = thread.map_err(|error| RecordingError::Unwritable {
            path: PathBuf::new(),
            reason: format!("no thread to write it: {error}"),
            kind: error.kind(),
        })?;
        Ok(Recorder {
            tap,
            thread: Some(thread),
        })
    }

    /// A handle for whoever has something to tell.
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// A handle for whoever asks for files.
    pub fn saver(&self) -> Saver {
        Saver(self.tap())
    }

    /// As [`Saver::save_last`].
    ///
    /// # Errors
    /// As there.
    pub fn save_last(&self, path: &Path) -> Result<u64, RecordingError> {
        self.saver().save_last(path)
    }

    /// Writes what waits, and ends the file.
    ///
    /// # Errors
    /// [`RecordingError::Unwritable`], also of something that was told earlier.
    pub fn finish(mut self) -> Result<Recorded, RecordingError> {
        self.end()
    }

    fn end(&mut self) -> Result<Recorded, RecordingError> {
        let Some(thread) = self.thread.take() else {
            return Ok(Recorded::default());
        };
        self.tap.must_tell(Event::End);
        thread.join().unwrap_or_else(|_| {
            Err(RecordingError::Unwritable {
                path: PathBuf::new(),
                reason: "the thread that writes it failed".to_owned(),
                kind: ErrorKind::Other,
            })
        })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!("{error}");
        }
    }
}

/// Whether events follow each other.
#[derive(Debug, Default)]
struct Numbers {
    newest: u64,
}

impl Numbers {
    /// How many were left out before this one.
    fn left_out_before(&mut self, number: u64) -> u64 {
        let missing = number.saturating_sub(self.newest + 1);
        self.newest = number;
        missing
    }
}

/// Bytes of one direction to frames.
struct Line {
    topic: &'static str,
    numbers: Numbers,
    sequence: u32,
    frame: Vec<u8>,
}

impl Line {
    fn new(topic: &'static str) -> Self {
        Line {
            topic,
            numbers: Numbers::default(),
            sequence: 0,
            frame: Vec::with_capacity(LONGEST),
        }
    }

    /// The frames that end in these bytes.
    fn cut(&mut self, number: u64, time_ns: u64, bytes: &[u8], mut each: impl FnMut(Entry)) {
        if self.numbers.left_out_before(number) > 0 {
            // The other half of this frame may be among what is missing.
            self.frame.clear();
            self.sequence = self.sequence.wrapping_add(1);
        }
        for byte in bytes {
            self.frame.push(*byte);
            if *byte == 0 || self.frame.len() == LONGEST {
                // Delimiters in a row are no frames.
                if self.frame.len() > 1 {
                    self.sequence = self.sequence.wrapping_add(1);
                    each(Entry {
                        topic: self.topic,
                        sequence: self.sequence,
                        time_ns,
                        bytes: self.frame.as_slice().into(),
                    });
                }
                self.frame.clear();
            }
        }
    }
}

/// What the thread has.
struct Writing {
    tap: Tap,
    about: About,
    sources: Sources,
    /// Path of the file that all is written to, also once it has ended.
    path: Option<PathBuf>,
    file: Option<RecordingFile>,
    /// Why nothing is written any more.
    failed: Option<RecordingError>,
    ring: Ring,
    lines: [Line; 2],
    solves: Numbers,
    tools: u32,
    next_tool_us: u64,
    recorded: Recorded,
    seen: Seen,
}

impl Writing {
    fn serve(&mut self, events: &Receiver<Event>) {
        let mut entries = Vec::new();
        while let Ok(event) = events.recv() {
            match event {
                Event::Bytes {
                    direction,
                    number,
                    time_ns,
                    bytes,
                } => {
                    let [down, up] = &mut self.lines;
                    let line = match direction {
                        Direction::Down => down,
                        Direction::Up => up,
                    };
                    line.cut(number, time_ns, &bytes, |entry| entries.push(entry));
                    self.recorded.frames += entries.len() as u64;
                    for entry in std::mem::take(&mut entries) {
                        let tool = self.tool(&entry);
                        self.keep(entry);
                        tool.into_iter().for_each(|entry| self.keep(entry));
                    }
                }
                Event::Solve {
                    number,
                    time_ns,
                    sample,
                } => self.solve(number, time_ns, &sample),
                Event::Sketch {
                    number,
                    time_ns,
                    sketch,
                } => self.json(SCENE, number, time_ns, &sketch.sample(time_ns)),
                Event::Save { path, done } => {
                    // Who asked may have gone.
                    let _ = done.send(self.save(&path));
                }
                Event::Close { done } => {
                    let _ = done.send(self.close());
                }
                Event::End => return,
            }
        }
    }

    fn solve(&mut self, number: u64, time_ns: u64, sample: &SolveSample) {
        // The number counts those that were left out, too.
        self.solves.left_out_before(number);
        self.recorded.solves += 1;
        (self.seen)(Passed::Solve(sample));
        let timeless = (!self.tap.keeps_wall_time()).then(|| sample.clone().without_times());
        self.json(SOLVE, number, time_ns, timeless.as_ref().unwrap_or(sample));
    }

    fn json(&mut self, topic: &'static str, number: u64, time_ns: u64, sample: &impl Serialize) {
        match serde_json::to_vec(sample) {
            Ok(bytes) => self.keep(Entry {
                topic,
                sequence: number as u32,
                time_ns,
                bytes: bytes.into(),
            }),
            Err(error) => tracing::error!("{topic} was not recorded: {error}"),
        }
    }

    /// Grip and force of a state, now and then.
    fn tool(&mut self, entry: &Entry) -> Option<Entry> {
        if entry.topic != UP {
            return None;
        }
        let mut accumulator = Accumulator::new();
        let packet = entry
            .bytes
            .iter()
            .take(entry.bytes.len().saturating_sub(1))
            .all(|byte| accumulator.push(*byte).is_none());
        let packet = accumulator.push(0).filter(|_| packet)?.ok()?;
        let decoded = decode(packet).ok()?;
        let now_us = decoded.header.console_time_us;
        let direction = sutura_shared::wire::Direction::ToHost;
        let Ok(Checked::State(state)) = decoded.unpack().and_then(|body| body.validate(direction))
        else {
            return None;
        };
        (self.seen)(Passed::State(&state));
        if now_us < self.next_tool_us && now_us + TOOL_EVERY_US >= self.next_tool_us {
            return None;
        }
        self.next_tool_us = now_us + TOOL_EVERY_US;
        self.tools = self.tools.wrapping_add(1);
        Some(Entry {
            topic: TOOL,
            sequence: self.tools,
            time_ns: entry.time_ns,
            bytes: serde_json::to_vec(&ToolSample::from(state.body()))
                .ok()?
                .into(),
        })
    }

    fn keep(&mut self, entry: Entry) {
        if let Some(file) = &mut self.file
            && let Err(error) = file.write(&entry)
        {
            tracing::error!("recording ends here: {error}");
            self.failed = Some(error);
            self.file = None;
        }
        self.ring.push(entry);
    }

    fn save(&self, path: &Path) -> Result<u64, RecordingError> {
        if self
            .path
            .as_ref()
            .is_some_and(|file| lead_to_one(file, path))
        {
            return Err(RecordingError::Unwritable {
                path: path.to_owned(),
                reason: "it is the recording of the whole session".to_owned(),
                kind: ErrorKind::InvalidInput,
            });
        }
        let about = About {
            begins: Begins::Later,
            ..self.about.clone()
        };
        let mut file = RecordingFile::create(path, &about, &self.sources)?;
        for entry in self.ring.entries() {
            file.write(entry)?;
        }
        file.finish(&self.tap.lost())
    }

    /// Ends the file.
    fn close(&mut self) -> Result<u64, RecordingError> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        let file = self.file.take();
        file.map_or(Ok(0), |file| file.finish(&self.tap.lost()))
    }

    fn finish(mut self) -> Result<Recorded, RecordingError> {
        Ok(Recorded {
            bytes: self.close()?,
            lost: self.tap.lost(),
            ..self.recorded
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames are whole whatever pieces they come in; a piece that was left out takes a number, so that the gap is seen.
    #[test]
    fn pieces_become_frames_and_gaps_are_seen() {
        let mut line = Line::new(UP);
        let mut cut = |number, bytes: &[u8]| {
            let mut frames = Vec::new();
            line.cut(number, 9, bytes, |entry| {
                frames.push((entry.sequence, entry.bytes.to_vec()));
            });
            frames
        };
        assert_eq!(cut(1, &[0, 0, 3, 4]), []);
        assert_eq!(
            cut(2, &[5, 0, 6, 0, 7]),
            [(1, vec![3, 4, 5, 0]), (2, vec![6, 0])]
        );
        // The third is missing.
        assert_eq!(cut(4, &[8, 0, 9, 0]), [(4, vec![8, 0]), (5, vec![9, 0])]);
        // What never ends is no frame, and takes no more room than one.
        let endless = vec![1; 3 * LONGEST];
        assert!(
            cut(5, &endless)
                .iter()
                .all(|(_, frame)| frame.len() == LONGEST)
        );
    }
}
