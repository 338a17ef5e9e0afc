//! What a replay came to, with the keys that programs read.
//!
//! Entry points: [`Report::of`], [`Outcome::of`].

use super::super::read::{End, Recording};
use super::{ConsoleVerdict, HostVerdict};
use crate::session::LimitedTicks;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::Path;

/// What `--format json` prints.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(rename = "Replayed")]
pub struct Report {
    /// `ok`: all of it was compared and came out the same; `partly`: a part could not be compared, `console.why` and `host.why` say
    /// which; `not-replayed`: so it is of all ticks or all solves; `cut-off`: the file ends before the session did; `diverged`; `failed`:
    /// with `--verify`, in place of `partly`.
    pub status: &'static str,
    /// The recording.
    pub file: String,
    /// States in it.
    pub ticks: u64,
    /// The console's tick that came out differently first, at either end; none where nothing that was compared did. `status` says
    /// whether all was.
    pub diverged_at: Option<u32>,
    /// Trace hash of the console's last tick, in hexadecimal.
    pub hash: String,
    /// Why the recording ends before the session did, if so.
    pub cut_off: Option<String>,
    /// The console's ticks.
    pub console: OfConsole,
    /// The solver's steps.
    pub host: OfHost,
    /// Files that `--series` has written.
    pub pictures: Option<usize>,
}

/// The console's ticks, run again.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct OfConsole {
    /// Ticks that came out the same.
    pub verified_ticks: u64,
    /// Those at the beginning of sessions that could not be compared.
    pub unverified_ticks: u64,
    /// Those of a session whose opening is not in the recording, of which the pose alone was compared.
    pub poses: u64,
    /// Frames of the host that the line must have lost for the rest to come out the same.
    pub lost_frames: u64,
    /// The tick that came out differently first.
    pub diverged_at: Option<u32>,
    /// The tick from which on nothing can be compared.
    pub unverifiable_from: Option<u32>,
    /// Why, of either.
    pub why: Option<String>,
    /// Ticks that were run in which a limit of the device took a part of the force away; none where that cannot be told.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ticks_limited: Option<LimitedTicks>,
    /// Trace hash of the last tick that was run, in hexadecimal.
    pub hash: String,
}

/// The solver's steps, run again.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct OfHost {
    /// Solves in the recording.
    pub steps: u64,
    /// Those that came out the same.
    pub verified_steps: u64,
    /// Whether all of those have the same bits; false where none of the solves was compared.
    pub identical: bool,
    /// Contacts that went down as they had been solved, of a session whose beginning is not in the recording.
    pub contacts: u64,
    /// Largest difference of an entry of a wrench, over the largest of the session so far.
    pub largest_difference: f64,
    /// The console's tick of the first solve that came out differently.
    pub diverged_at: Option<u32>,
    /// That solve, from 1.
    pub diverged_step: Option<u64>,
    /// The first solve that cannot be run again.
    pub unverifiable_from: Option<u64>,
    /// Why, of any of these.
    pub why: Option<String>,
    /// Hash of the solver's state after the last solve, in hexadecimal.
    pub hash: String,
}

/// What a replay came to, as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All was compared, and came out the same.
    Same,
    /// A part could not be compared; the rest came out the same.
    Partly,
    /// None of the ticks, or none of the solves, could be compared.
    NotReplayed,
    /// The recording ends before the session did; what is there came out the same, as far as it could be compared.
    CutOff,
    /// Something came out differently.
    Diverged,
}

impl Outcome {
    /// Of a recording that was run again at both ends.
    pub fn of(recording: &Recording, console: &ConsoleVerdict, host: &HostVerdict) -> Outcome {
        let none = |all: u64, verified: u64| all > 0 && verified == 0;
        let is_partly = console.unverifiable_from.is_some() || host.unverifiable_from.is_some();
        if console.diverged_at.is_some() || host.diverged_at.is_some() {
            Outcome::Diverged
        } else if recording.end != End::Whole {
            Outcome::CutOff
        } else if !is_partly {
            Outcome::Same
        } else if none(console.ticks, console.verified_ticks)
            || none(host.steps, host.verified_steps)
        {
            Outcome::NotReplayed
        } else {
            Outcome::Partly
        }
    }

    /// The word for `status`.
    pub fn word(self) -> &'static str {
        match self {
            Outcome::Same => "ok",
            Outcome::Partly => "partly",
            Outcome::NotReplayed => "not-replayed",
            Outcome::CutOff => "cut-off",
            Outcome::Diverged => "diverged",
        }
    }
}

impl Report {
    /// Of a recording at `path` that was run again at both ends, without pictures.
    pub fn of(
        path: &Path,
        recording: &Recording,
        console: &ConsoleVerdict,
        host: &HostVerdict,
    ) -> Report {
        let cut_off = match &recording.end {
            End::Whole => None,
            End::Cut(reason) => Some(reason.clone()),
        };
        let both = [console.diverged_at, host.diverged_at];
        Report {
            status: Outcome::of(recording, console, host).word(),
            file: path.display().to_string(),
            ticks: console.ticks,
            diverged_at: both.into_iter().flatten().min(),
            hash: format!("{:016x}", console.hash),
            cut_off,
            console: OfConsole {
                verified_ticks: console.verified_ticks,
                unverified_ticks: console.unverified_ticks,
                poses: console.poses,
                lost_frames: console.lost_frames,
                diverged_at: console.diverged_at,
                unverifiable_from: console.unverifiable_from,
                why: console.why.clone(),
                ticks_limited: console.ticks_limited,
                hash: format!("{:016x}", console.hash),
            },
            host: OfHost {
                steps: host.steps,
                verified_steps: host.verified_steps,
                identical: host.identical && (host.verified_steps > 0 || host.steps == 0),
                contacts: host.contacts,
                largest_difference: host.largest_difference,
                diverged_at: host.diverged_at,
                diverged_step: host.diverged_step,
                unverifiable_from: host.unverifiable_from,
                why: host.why.clone(),
                hash: format!("{:016x}", host.hash),
            },
            pictures: None,
        }
    }
}
