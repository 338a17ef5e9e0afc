//! Runs a target on all cores: blocks of frames or files, each with a seed of its own.
//!
//! Entry point: [`run`].

use crate::files::{self, Files};
use crate::traffic::{Tally, Traffic};
use crate::{host_end, mesh, recordings, scene, seeds};
use clap::ValueEnum;
use std::panic::catch_unwind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use sutura_shared::wire::Reject;

/// Frames that one console is sent; then comes another one, with the next seed.
const BLOCK: u64 = 100_000;
/// Files of one seed.
const FILES_BLOCK: u64 = 5_000;

/// What is fuzzed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Target {
    /// Bytes from a host, to the console's link and control.
    Stream,
    /// Bytes from a console, to the host's link.
    Host,
    /// Scene and device files.
    Scene,
    /// Mesh files.
    Mesh,
    /// Recordings, read and replayed.
    Recording,
}

impl Target {
    /// All of them.
    pub const ALL: [Target; 5] = [
        Target::Stream,
        Target::Host,
        Target::Scene,
        Target::Mesh,
        Target::Recording,
    ];

    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Target::Stream => "stream",
            Target::Host => "host",
            Target::Scene => "scene",
            Target::Mesh => "mesh",
            Target::Recording => "recording",
        }
    }

    /// Frames or files that take seconds.
    pub fn short(self) -> u64 {
        match self {
            Target::Stream => 1_000_000,
            Target::Host => 300_000,
            Target::Scene | Target::Mesh => 20_000,
            Target::Recording => 4_000,
        }
    }
}

/// What a target counted.
#[allow(
    clippy::large_enum_variant,
    reason = "one of a run, never stored in bulk"
)]
#[derive(Clone, Copy, Debug)]
pub enum Counts {
    /// Of frames.
    Frames(Tally),
    /// Of files.
    Files(Files),
}

/// Runs blocks of frames or files, `count` in all from `seed` on, on so many threads; the counts, and whether a defect was
/// found, which is on stderr then.
pub fn run(target: Target, seed: u64, count: u64, threads: Option<usize>) -> (Counts, bool) {
    let frames = seeds::frames();
    let files = match target {
        Target::Scene | Target::Mesh => seeds::files(target.name()),
        Target::Stream | Target::Host | Target::Recording => Vec::new(),
    };
    let recordings = seeds::recordings();
    let is_frames = matches!(target, Target::Stream | Target::Host);
    let block = if is_frames { BLOCK } else { FILES_BLOCK };
    let sum = Mutex::new(if is_frames {
        Counts::Frames(Tally::default())
    } else {
        Counts::Files(Files::default())
    });
    let (next, defect) = (AtomicU64::new(0), AtomicBool::new(false));
    let threads = threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from));
    let work = || {
        loop {
            let done = next.fetch_add(1, Ordering::Relaxed);
            let left = count.saturating_sub(done * block).min(block);
            if left == 0 || defect.load(Ordering::Relaxed) {
                return;
            }
            let seed = seed + done;
            let last = Mutex::new(Vec::new());
            let outcome = catch_unwind(|| match target {
                Target::Stream => Counts::Frames(Traffic::new(&frames, seed).run(left)),
                Target::Host => Counts::Frames(host_end::run(&frames, seed, left)),
                Target::Scene | Target::Mesh => {
                    let reader = if target == Target::Scene { scene } else { mesh };
                    Counts::Files(files::run(reader, &files, seed, left, |file| {
                        keep(&last, file)
                    }))
                }
                Target::Recording => {
                    Counts::Files(recordings::run(&recordings, seed, left, |file| {
                        keep(&last, file)
                    }))
                }
            });
            match outcome {
                Ok(counts) => add(
                    &mut sum.lock().unwrap_or_else(PoisonError::into_inner),
                    &counts,
                ),
                Err(_) => {
                    defect.store(true, Ordering::Relaxed);
                    let name = target.name();
                    eprintln!(
                        "defect in {name}; again: cargo xtask fuzz {name} --seed {seed} --count {left}"
                    );
                    save(target, &last);
                }
            }
            if (done * block * 10 / count) != ((done + 1) * block * 10 / count) {
                eprintln!(
                    "{}: {} of {count}",
                    target.name(),
                    ((done + 1) * block).min(count)
                );
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads.unwrap_or(1) {
            scope.spawn(work);
        }
    });
    (
        sum.into_inner().unwrap_or_else(PoisonError::into_inner),
        defect.into_inner(),
    )
}

fn keep(last: &Mutex<Vec<u8>>, file: &[u8]) {
    let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
    last.clear();
    last.extend_from_slice(file);
}

/// Writes the file that a reader broke on to where it becomes a seed.
fn save(target: Target, last: &Mutex<Vec<u8>>) {
    let last = last.lock().unwrap_or_else(PoisonError::into_inner);
    if last.is_empty() {
        return;
    }
    let path: PathBuf = std::env::temp_dir().join(format!("sutura-fuzz-{}", target.name()));
    match std::fs::write(&path, &*last) {
        Ok(()) => eprintln!(
            "the file is {}; add it to fuzz/corpus/{}",
            path.display(),
            target.name()
        ),
        Err(error) => eprintln!("the file cannot be written to {}: {error}", path.display()),
    }
}

fn add(sum: &mut Counts, more: &Counts) {
    match (sum, more) {
        (Counts::Frames(sum), Counts::Frames(more)) => sum.add(more),
        (Counts::Files(sum), Counts::Files(more)) => {
            sum.files += more.files;
            sum.accepted += more.accepted;
            sum.slowest_us = sum.slowest_us.max(more.slowest_us);
        }
        _ => {}
    }
}

impl Counts {
    /// The counts with their names.
    pub fn rows(&self) -> Vec<(&'static str, u64)> {
        match self {
            Counts::Frames(tally) => vec![
                ("frames", tally.frames),
                ("mutated", tally.mutated),
                ("restamped", tally.restamped),
                ("decoded", tally.decoded),
                ("validated", tally.validated),
                ("accepted", tally.accepted),
                ("heard_again", tally.heard_again),
                ("sessions", tally.sessions),
                ("ticks", tally.ticks),
                ("ticks_under_torque", tally.ticks_under_torque),
            ],
            Counts::Files(files) => vec![
                ("files", files.files),
                ("accepted", files.accepted),
                ("slowest_us", files.slowest_us),
            ],
        }
    }

    /// Refusals by reason.
    pub fn refused(&self) -> Vec<(Reject, u64)> {
        let Counts::Frames(tally) = self else {
            return Vec::new();
        };
        let numbered = tally.refused.iter().zip(0..);
        numbered
            .filter_map(|(count, number)| Some((Reject::from_number(number)?, *count)))
            .filter(|(_, count)| *count > 0)
            .collect()
    }
}
