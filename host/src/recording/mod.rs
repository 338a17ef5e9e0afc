//! A session in one file, so that it can be run again bit by bit, and looked at with other programs.
//!
//! Entry points: [`Recorder`] writes while a session runs, [`Recording::read`] reads, [`replay`] runs it again. The container
//! is MCAP (<https://mcap.dev>), without compression. Whatever passes is told to a [`Tap`]: [`TappedPort`],
//! [`TappedConsole`] and [`TappedSolver`] stand where the real ones do, and never wait.

mod about;
mod file;
mod read;
mod recorder;
pub mod replay;
mod ring;
mod samples;
mod scene_sample;
mod tap;
mod tapped;

pub use about::{About, Begins, simd_level};
pub use file::RecordingFile;
pub use read::{End, Frame, Recording, RecordingError};
pub use recorder::{Passed, Recorded, Recorder, Saver, Seen};
pub use ring::{LAST, LAST_BYTES, Ring};
pub use samples::{SolveSample, ToolSample};
pub use scene_sample::SceneSample;
pub use tap::{Direction, Tap};
pub use tapped::{TappedConsole, TappedPort, TappedSolver};

/// Channel of frames to the console.
pub const DOWN: &str = "/frames/down";
/// Channel of frames from the console.
pub const UP: &str = "/frames/up";
/// Channel of the solver's steps.
pub const SOLVE: &str = "/solve";
/// Channel of grip and force, for plots.
pub const TOOL: &str = "/tool";
/// Channel of needles, threads and tools, for programs that draw them.
pub const SCENE: &str = "/scene";
