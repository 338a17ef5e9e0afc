//! What a session reports when it is over: the JSON object of `sutura run`.
//!
//! Entry point: [`Summary`]. Key names carry their units and are a contract with scripts: add, never rename.

use super::limited::Cuts;
use super::overload::GivenUp;
use super::statistics::{FAINT_N, MOST_SPOILT};
use super::{Chosen, Ending, EndingKind, LimitedTicks};
use super::{MachineLate, Scheduling};
use crate::wound::Overlap;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;

/// Percentiles of a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Latency {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are shorter.
    pub p99: f64,
    /// 999 of 1000 are shorter.
    pub p999: f64,
    /// Longest.
    pub max: f64,
}

/// Percentiles of an age.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Age {
    /// Median.
    pub p50: f64,
    /// Oldest.
    pub max: f64,
}

/// Percentiles of a solver step's time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct StepTime {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are shorter.
    pub p99: f64,
    /// Longest.
    pub max: f64,
}

/// Frames of both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Frames {
    /// Frames that the host sent.
    pub sent: u64,
    /// Frames that never came, by gaps in the sequence: states at the host, the host's at the console.
    pub lost: u64,
    /// Frames refused, at either end.
    pub rejected: u64,
    /// Contacts that came to the console when they were too old to be used.
    pub late: u64,
    /// Values replaced by newer ones before they were used: states at the host, contacts at either end.
    /// By design, not a loss.
    pub superseded: u64,
}

/// Contact force on the grip, as the console commanded it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Force {
    /// Largest magnitude \[N\].
    pub peak: f64,
    /// Largest magnitude that a solver step found for the driven tool, where it ended or a period ahead of that \[N\]: with a
    /// fixture, or between steps that are far apart, another force may be felt.
    pub solved_peak: f64,
    /// Root of the mean square over all ticks \[N\].
    pub rms: f64,
}

/// Passivity observer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Energy {
    /// Least energy that the hand had put into the tissue so far, over the session \[J\]. Below zero the
    /// console has given out more than it was given.
    pub min: f64,
}

/// Round trips of pings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct RoundTrip {
    /// Fastest.
    pub min: f64,
    /// Median.
    pub p50: f64,
    /// 99 of 100 are faster.
    pub p99: f64,
    /// Slowest.
    pub max: f64,
}

/// The console's clock as the host knows it at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct ConsoleClock {
    /// Console clock less host clock, which starts with the link \[us\].
    pub offset_us: f64,
    /// How much faster the console's clock runs \[ppm\].
    pub drift_ppm: f64,
    /// By how much the offset may be wrong \[us\].
    pub uncertainty_us: f64,
}

/// Bytes a second each way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Throughput {
    /// To the console.
    pub down: f64,
    /// From the console.
    pub up: f64,
}

/// The link in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct LinkSummary {
    /// Round trips without the console's own part \[us\]; 0 in lockstep.
    pub rtt_us: RoundTrip,
    /// Those of the last second \[us\], while it runs.
    #[serde(skip)]
    pub rtt_now_us: RoundTrip,
    /// The clock; none in lockstep.
    pub clock: Option<ConsoleClock>,
    /// Bytes a second.
    pub bytes_per_s: Throughput,
    /// Sessions, the first one included: one more for every time the console was lost and came back.
    pub sessions: u32,
}

/// Request of a person that brings the console to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Rest until somebody arms it.
    Safe,
    /// Way of its tool out of the tissue, without a force.
    TakeOut,
}

/// A safe stop that a person asked for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct SafeStop {
    /// Session time at which it was asked for \[s\].
    pub at_s: f64,
    /// Name of the person who asked: a page by its number, or the terminal.
    pub by: String,
}

/// A session in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Summary {
    /// `ok`, or a word and its reason, the first of these: `fault`, `not-rendered`, `inside`, `overlap`, `untouched`,
    /// `behind`, `faint`, `stopped`, `idle`, `limited`.
    pub status: String,
    /// The same, to be compared.
    #[serde(skip)]
    pub ending: Ending,
    /// How the console was reached: `virtual`, `qemu`, or a port.
    pub console: String,
    /// Name of the device.
    pub device: String,
    /// Control rate \[Hz\].
    pub tick_hz: u32,
    /// Control ticks from the session's first state to its last.
    pub ticks: u64,
    /// Ticks whose computation took longer than their period.
    pub tick_overruns: u64,
    /// Ticks that started more than a period late; they were run, never skipped.
    pub ticks_late: u64,
    /// Control mode at the end.
    pub mode: String,
    /// Faults latched at the end; bits that this program does not know as one number, `0x400`.
    pub faults: Vec<String>,
    /// Solver steps a second that the session aimed at \[Hz\].
    pub host_hz: f64,
    /// What the console was given to render from: `hold`, `tangent` or `rows`.
    pub rendering: &'static str,
    /// Most rows that line and board take at that rate; 0: none were sent.
    pub most_rows: usize,
    /// Frames of 24 rows a second that the board has time for, by the scene's device file \[Hz\]; none if that does not say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub board_rows_hz: Option<f64>,
    /// Solver steps a second that it reached, by the console's clock \[Hz\].
    pub host_hz_reached: f64,
    /// Solver steps after which nothing was sent, by what was wrong with their result.
    pub steps_withheld: BTreeMap<&'static str, u64>,
    /// Why the newest steps were withheld, and how many in a row; none if the newest one was sent.
    #[serde(skip)]
    pub withheld_last: Option<(&'static str, u64)>,
    /// Which end of the link refused many of its frames, and why, in words; empty on a good line.
    #[serde(skip)]
    pub refusals: Vec<String>,
    /// Times that the console found its contact data too old and let the force decay.
    pub decays: u64,
    /// Ticks in which the console let through so much less force than the contact asks for that a finger notices it: what an
    /// outage has taken away comes back slowly, and what nobody has paid for only once the tool has left the tissue.
    pub ticks_withheld: u64,
    /// Ticks in which a limit of the device took a part of the force away. A session with more than ten by force or power is
    /// `limited`; one with more than ten by slew, or in `ticks_withheld`, if the largest force that was felt is less than half of
    /// the largest that steps found.
    pub ticks_limited: LimitedTicks,
    /// Safe stops that a person asked for, the first hundred.
    pub safe_stops: Vec<SafeStop>,
    /// Solver steps in which the needle in the grip touched nothing, since the console was armed with it in the tissue and it
    /// had not been outside since.
    pub needle_waited_steps: u64,
    /// Solver steps whose hands were faster than a step follows: what was felt is the balance where the tools were by then, and the
    /// next steps went on from there.
    pub steps_behind: u64,
    /// How far a tool lagged in them at most \[m\].
    pub most_lag_m: f64,
    /// Those of them in which it lagged by more than it touched: its force was held, and none was foretold from it.
    pub steps_outrun: u64,
    /// Those of them in which it touched nothing where its hand was in the tissue.
    pub steps_missed: u64,
    /// Frames.
    pub frames: Frames,
    /// The link.
    pub link: LinkSummary,
    /// From the state's time stamp to the tick that was given its contact, in time or too late, by the console's clock \[us\].
    pub latency_us: Latency,
    /// Age of the contact data in use, every tick while armed \[ms\].
    pub age_ms: Age,
    /// Horizon of the contacts that were sent \[ms\].
    pub horizon_ms: Age,
    /// What the solver's thread had of a core in a solve, which does not depend on what else runs \[us\]; in lockstep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub core_us: Option<Percentiles>,
    /// All that the solver's thread did for a solve, on the wall \[us\].
    pub session_us: StepTime,
    /// Largest mean of `session_us` in a second of the session \[us\].
    pub worst_second_us: f64,
    /// Solver steps in which the driven tool touched, or what its grip holds: tissue, or a taut thread.
    pub contact_steps: u64,
    /// What was given up because solves took too long.
    pub overload: GivenUp,
    /// Times that the console was armed again after it had let go.
    pub rearmed: u64,
    /// Wall-clock time of a solver step \[us\].
    pub step_us: StepTime,
    /// Mean time of each stage of a step, of sending it, and of the rest that no stage names \[us\].
    pub stages_us: BTreeMap<&'static str, f64>,
    /// Contact force.
    pub force_n: Force,
    /// Energy.
    pub energy_j: Energy,
    /// Running hash of the console over every tick's inputs, outputs and state, in hexadecimal.
    pub trace_hash: String,
    /// Console time of the session \[s\].
    pub seconds: f64,
    /// Wall-clock time of the session \[s\].
    pub wall_s: f64,
    /// Which model was taken for the budget, from what was measured before the session; none if that was not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chosen: Option<Chosen>,
    /// What the session's threads got of the system; none in lockstep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scheduling: Option<Scheduling>,
    /// How late a thread was woken that only slept, beside the session \[us\]; none in lockstep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub machine_late_us: Option<MachineLate>,
    /// Wake-ups of that thread that were more than 5 ms late.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub machine_late_over_5ms: Option<u64>,
    /// How it was shown; none without a page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<ViewSummary>,
    /// What the scene reports.
    pub scene: serde_json::Map<String, serde_json::Value>,
}

/// How a session was shown on a page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct ViewSummary {
    /// Where the page was.
    pub url: String,
    /// Clients that came.
    pub clients: u64,
    /// Pictures that were wanted, made, and sent to all clients together.
    pub pictures: Pictures,
    /// Time on a core for making one \[us\].
    pub picture_us: Percentiles,
    /// Time that offering one took in the solver's thread, on the wall \[us\].
    pub offer_us: Percentiles,
}

/// Pictures of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Pictures {
    /// That were wanted while somebody watched.
    pub wanted: u64,
    /// That were made.
    pub made: u64,
    /// That were sent.
    pub sent: u64,
}

/// Half of all, and 99 of 100, are no longer than these.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are shorter.
    pub p99: f64,
}

impl ViewSummary {
    /// Of a page at `url`; pictures wanted, made and sent; medians and 99 of 100 of their times \[us\].
    pub fn new(
        url: String,
        clients: u64,
        [wanted, made, sent]: [u64; 3],
        picture_us: [f64; 2],
        offer_us: [f64; 2],
    ) -> Self {
        let percentiles = |[p50, p99]: [f64; 2]| Percentiles { p50, p99 };
        Self {
            url,
            clients,
            pictures: Pictures { wanted, made, sent },
            picture_us: percentiles(picture_us),
            offer_us: percentiles(offer_us),
        }
    }
}

impl Summary {
    /// Adds what the scene reports, and ends with parts that are in each other if there is nothing graver.
    pub(super) fn with_scene(mut self, scene: serde_json::Map<String, serde_json::Value>) -> Self {
        let ratio = scene.get("penetration_ratio");
        if let Some(overlap) = ratio.and_then(|ratio| Overlap::of(ratio.as_f64()?))
            && EndingKind::Overlap < self.ending.kind
        {
            self.ending = Ending::new(EndingKind::Overlap, overlap.to_string());
            self.status = self.ending.to_string();
        }
        self.scene = scene;
        self
    }

    /// Whether limits of the device, or its energy account, took away more of the force than a session that is `ok` may lose.
    pub fn is_cut(&self) -> bool {
        let cuts = Cuts {
            limited: self.ticks_limited,
            withheld: self.ticks_withheld,
            felt_n: self.force_n.peak,
            solved_n: self.force_n.solved_peak,
        };
        cuts.are_many()
    }

    /// Whether no finger notices the largest force, felt or found.
    pub fn is_faint(&self) -> bool {
        self.force_n.peak.max(self.force_n.solved_peak) < FAINT_N
    }

    /// Why most of the steps were withheld that were; none if those were no more than a session may have of its steps in
    /// contact.
    pub fn mostly_withheld(&self) -> Option<&'static str> {
        let withheld: u64 = self.steps_withheld.values().sum();
        let most = self.steps_withheld.iter().max_by_key(|(_, steps)| **steps);
        most.map(|(why, _)| *why)
            .filter(|_| withheld as f64 > MOST_SPOILT * self.contact_steps as f64)
    }
}
