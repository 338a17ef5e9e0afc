//! Files that a page asks for: the last seconds, and the end of a recording.
//!
//! Entry points: [`Saves::last`], [`Saves::end`]. A page names no files: they go to the folder that the program was started in, or
//! beside the recording that was asked for there, and take nobody's place.

use super::telemetry::Telemetry;
use crate::files::{has_something, never_over};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use sutura_files::may_write;
use sutura_host::recording::Saver;
use sutura_view::Reply;

/// What can be saved of a session.
pub struct Saves {
    saver: Saver,
    telemetry: Arc<Telemetry>,
    /// Where the last seconds go, if there is no such file yet.
    last: PathBuf,
    /// All of the session, as long as it is written.
    file: Option<PathBuf>,
    saving: Option<Saving>,
}

/// The last seconds, on their way to a file.
struct Saving {
    thread: JoinHandle<()>,
    /// There is nothing left but to say so.
    written: Arc<AtomicBool>,
}

impl Saves {
    /// Of a session that is recorded in `file`, if anywhere.
    pub fn new(
        saver: Saver,
        telemetry: Arc<Telemetry>,
        last: PathBuf,
        file: Option<PathBuf>,
    ) -> Self {
        Self {
            saver,
            telemetry,
            last,
            file,
            saving: None,
        }
    }

    /// Where all of the session is written, if anywhere.
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Writes the last seconds to a file, in a thread of its own: the session does not wait.
    pub fn last(&mut self, reply: Reply) {
        let is_over = |saving: &mut Saving| {
            saving.written.load(Ordering::Relaxed) || saving.thread.is_finished()
        };
        // A panic of it has been printed.
        let _ = self
            .saving
            .take_if(is_over)
            .map(|saving| saving.thread.join());
        if self.saving.is_some() {
            return reply.refuse("the last seconds are being written", "wait until they are");
        }
        let (saver, telemetry) = (self.saver.clone(), self.telemetry.clone());
        let path = unused(&self.last);
        let thread = std::thread::Builder::new().name("sutura-save".to_owned());
        let written = Arc::new(AtomicBool::new(false));
        let is_written = written.clone();
        let saving = thread.spawn(move || {
            let saved = saver.save_last(&path);
            // Who hears that it is over may ask again at once.
            is_written.store(true, Ordering::Relaxed);
            match saved {
                Ok(bytes) => {
                    let mb = 1e-6 * bytes as f64;
                    let text = format!("the last seconds are in {} ({mb:.1} MB)", path.display());
                    note!("{text}");
                    telemetry.event("saved", &text, "");
                    reply.done();
                }
                Err(error) => refuse(reply, &error.to_string()),
            }
        });
        match saving {
            Ok(thread) => self.saving = Some(Saving { thread, written }),
            // The reply is gone with the thread: the page hears that there is none.
            Err(error) => tracing::error!("there is no thread to write the last seconds: {error}"),
        }
    }

    /// Ends the recording.
    pub fn end(&mut self, reply: Reply) {
        let Some(file) = self.file.take() else {
            return reply.refuse(
                "this session is not recorded",
                "say `record` with `on`: true",
            );
        };
        match self.saver.end_file() {
            Ok(_) => {
                let text = format!("recorded in {}", file.display());
                note!("{text}");
                self.telemetry.event("saved", &text, "");
                reply.done();
            }
            Err(error) => refuse(reply, &error.to_string()),
        }
    }
}

fn refuse(reply: Reply, why: &str) {
    reply.refuse(why, "see whether its folder can be written, and has room");
}

/// This file, or one with the first number that no file has.
pub fn unused(file: &Path) -> PathBuf {
    let mut names = (1..).map(|number| numbered(file, number));
    let found = names.find(|path| !path.exists());
    found.unwrap_or_else(|| file.to_owned())
}

/// The file of a session with this number: the first of the name itself or with a number from there on that may be written. With
/// `overwrite` that is each that is not among those which are `read`.
pub fn named(file: &Path, number: u32, (read, overwrite): (&[PathBuf], bool)) -> PathBuf {
    let is_free = |path: &PathBuf| {
        never_over(path, read).is_ok()
            && may_write(path).is_ok()
            && (overwrite || !has_something(path))
    };
    let mut names = (number..).map(|number| numbered(file, number));
    names.find(is_free).unwrap_or_else(|| file.to_owned())
}

/// The first has the name itself.
fn numbered(file: &Path, number: u32) -> PathBuf {
    if number == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let end = file.extension().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}-{number}.{end}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_file_takes_the_place_of_another() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("a.mcap");
        for expected in ["a.mcap", "a-2.mcap", "a-3.mcap"] {
            let path = unused(&file);
            assert_eq!(path, folder.path().join(expected));
            std::fs::write(&path, b"1")?;
        }
        // A session's number is where the search begins, and what is read is passed whatever is asked.
        let read = [folder.path().join("a-2.mcap")];
        let of = |number, overwrite| named(&file, number, (&read, overwrite));
        for (found, expected) in [
            (of(1, false), "a-4.mcap"),
            (of(1, true), "a.mcap"),
            (of(2, true), "a-3.mcap"),
            (of(5, false), "a-5.mcap"),
        ] {
            assert_eq!(found, folder.path().join(expected));
        }
        Ok(())
    }
}
