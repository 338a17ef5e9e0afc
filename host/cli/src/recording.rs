//! What `sutura run` records: the whole session if asked to, and the last seconds always.
//!
//! Entry point: [`Recording::start`].

use crate::failure::{Cause, Failure};
use crate::run::RunArgs;
use std::cell::Cell;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use sutura_host::recording::{About, Recorder, RecordingError, Saver, Seen, Tap};
use sutura_host::scene::{Scene, Sources};
use sutura_host::session::{Plan, Summary};
use sutura_shared::hash::TraceHash;

/// Where the last seconds go if nothing else is said.
pub const LAST: &str = "sutura-last.mcap";

/// The recorder of a session.
pub struct Recording {
    recorder: Recorder,
    file: Option<PathBuf>,
    /// Whether the user has named it.
    is_named: bool,
    last: Option<PathBuf>,
    /// Why the last seconds could not be written when they were to be.
    unsaved: Cell<Option<RecordingError>>,
    /// Set by SIGUSR1.
    asked: Arc<AtomicBool>,
}

impl Recording {
    /// Begins to record: where the user says, or to be `kept` for as long as the program runs. `seen` is shown what passes.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn start(
        args: &RunArgs,
        plan: &Plan,
        scene: &Scene,
        sources: Sources,
        lockstep: bool,
        asked: Arc<AtomicBool>,
        (kept, seen): (Option<&Path>, Option<Seen>),
    ) -> Result<Recording, Failure> {
        // Nobody replays the last seconds.
        let named = file(args);
        let file = named.clone().or_else(|| kept.map(Path::to_owned));
        let build = file.as_ref().map(|_| build()).unwrap_or_default();
        let about = About {
            console: args.console.clone(),
            lockstep,
            worker: !lockstep,
            ..About::here(build, plan, &scene.tissue.to_string())
        };
        let seen = seen.unwrap_or_else(|| Box::new(|_| {}));
        let recorder = Recorder::start_seen(file.as_deref(), about, sources, seen);
        Ok(Recording {
            recorder: recorder.map_err(failure)?,
            file,
            is_named: named.is_some(),
            last: args.save_last.clone(),
            unsaved: Cell::new(None),
            asked,
        })
    }

    /// Where all of the session goes, if anywhere.
    pub fn file(&self) -> Option<PathBuf> {
        self.file.clone()
    }

    /// Who asks it for files, and where the last seconds go.
    pub fn saver(&self) -> (Saver, PathBuf) {
        let last = self.last.clone().unwrap_or_else(|| LAST.into());
        (self.recorder.saver(), last)
    }

    /// Where what passes is told.
    pub fn tap(&self) -> Tap {
        self.recorder.tap()
    }

    /// Writes the last seconds if SIGUSR1 came.
    pub fn save_if_asked(&self) {
        if self.asked.swap(false, Ordering::Relaxed) {
            self.save(self.last.as_deref().unwrap_or(Path::new(LAST)));
        }
    }

    fn save(&self, path: &Path) {
        match self.recorder.save_last(path) {
            Ok(bytes) => note!(
                "the last seconds are in {} ({:.1} MB)",
                path.display(),
                1e-6 * bytes as f64
            ),
            Err(error) => {
                note!("{error}");
                self.unsaved.set(Some(error));
            }
        }
    }

    /// Ends the recording of a session that came out like this, and says what there is to say of it. A file that could not be
    /// written takes nothing from the summary: its failure is beside it, and that of the last seconds'.
    ///
    /// # Errors
    /// The session's.
    pub fn finish(self, session: Result<Summary, Failure>) -> Result<(Summary, Written), Failure> {
        let bad = match &session {
            Ok(summary) => summary.mode == "fault",
            Err(failure) => matches!(failure.cause, Cause::Fault | Cause::NoConsole),
        };
        if let Some(last) = self.last.as_deref().filter(|_| bad) {
            self.save(last);
        }
        let saved = self
            .unsaved
            .take()
            .map_or(Ok(()), |error| Err(failure(error)));
        let recorded = self.recorder.finish();
        let summary = session?;
        let recorded = match recorded {
            Ok(recorded) => recorded,
            Err(error) => return Ok((summary, [Err(failure(error)), saved])),
        };
        if let Some(file) = self.file.as_ref().filter(|_| self.is_named) {
            note!(
                "recorded {} frames and {} solves in {} ({:.1} MB)",
                recorded.frames,
                recorded.solves,
                file.display(),
                1e-6 * recorded.bytes as f64
            );
        }
        let lost = recorded.lost;
        if self.is_named && lost != Default::default() {
            note!(
                "the disk was too slow: {} pieces down, {} up and {} solves are missing, and cannot be replayed",
                lost.down,
                lost.up,
                lost.solves
            );
        }
        Ok((summary, [Ok(()), saved]))
    }
}

/// Whether all of the session was written, and its last seconds, as far as they were asked for.
pub type Written = [Result<(), Failure>; 2];

/// Where all of the session goes, if anywhere.
pub fn file(args: &RunArgs) -> Option<PathBuf> {
    let beside = || Some(args.series.as_ref()?.join("session.mcap"));
    args.record.clone().or_else(beside)
}

/// A failure of a recording.
pub fn failure(error: RecordingError) -> Failure {
    let cause = match &error {
        RecordingError::Unwritable { kind, .. } => crate::files::cause(*kind),
        RecordingError::OtherProtocol { .. }
        | RecordingError::OtherConsole { .. }
        | RecordingError::Unreadable { .. }
        | RecordingError::NotARecording { .. } => Cause::BadInput,
    };
    let help = error.help();
    Failure::say(cause, error.to_string(), help)
}

/// Which build of the program this is: a hash of its file. Empty where that cannot be read.
pub fn build() -> String {
    let hash = || -> std::io::Result<u64> {
        let mut file = std::fs::File::open(std::env::current_exe()?)?;
        let mut hash = TraceHash::new();
        let mut chunk = vec![0; 1 << 20];
        loop {
            let count = file.read(&mut chunk)?;
            if count == 0 {
                return Ok(hash.value());
            }
            for word in chunk[..count].chunks(4) {
                let mut bytes = [0; 4];
                bytes[..word.len()].copy_from_slice(word);
                hash.word(u32::from_le_bytes(bytes));
            }
        }
    };
    hash().map_or_else(|_| String::new(), |hash| format!("{hash:016x}"))
}

/// A flag that SIGUSR1 sets, which would end the process otherwise: for the very start.
pub fn asked() -> Arc<AtomicBool> {
    let asked = Arc::new(AtomicBool::new(false));
    #[cfg(unix)]
    {
        let flag = asked.clone();
        if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGUSR1, flag) {
            tracing::warn!("SIGUSR1 cannot be heard: {error}");
        }
    }
    asked
}
