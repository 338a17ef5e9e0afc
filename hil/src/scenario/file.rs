//! The sections of a scenario file as they are written: units in the names, unknown keys refused.
//!
//! Entry point: [`ScenarioFile`]; [`read`](super::read) makes a [`Scenario`](super::Scenario) of it.

use serde::Deserialize;
use sutura_host::scene::HandSection;
use toml::Spanned;

/// A number and where it stands.
pub(super) type Number = Spanned<f64>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScenarioFile {
    pub about: Spanned<String>,
    pub seconds: Number,
    #[serde(default)]
    pub seed: u64,
    pub device: Option<Spanned<String>>,
    pub consoles: Option<Spanned<Vec<Spanned<String>>>>,
    pub host: HostSection,
    pub hand: Option<Spanned<HandSection>>,
    #[serde(default)]
    pub order: Vec<OrderSection>,
    #[serde(default)]
    pub fault: Vec<Spanned<FaultSection>>,
    pub expect: ExpectSection,
    pub mutant: Option<MutantSection>,
}

/// `[host]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HostSection {
    pub model: Spanned<String>,
    pub hz: Number,
    pub delay_ms: Option<Number>,
    pub horizon_ms: Option<Number>,
    pub arms: Option<bool>,
    pub process: Option<Spanned<bool>>,
    pub scene: Option<Spanned<String>>,
    pub stiffness_n_per_m: Option<Number>,
    pub radius_m: Option<Number>,
    pub force_n: Option<Number>,
}

/// `[[order]]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OrderSection {
    pub at_ms: Number,
    pub say: Spanned<String>,
}

/// `[[fault]]`: when, one key that says what, and what must hold.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultSection {
    pub at_ms: Number,
    pub for_ms: Option<Number>,
    pub way: Option<Spanned<String>>,

    pub loss: Option<Share>,
    pub bursts: Option<Bursts>,
    pub duplicates: Option<Duplicates>,
    pub reordering: Option<Reordering>,
    pub bit_flips: Option<BitFlips>,
    pub truncation: Option<Share>,
    pub delay: Option<Time>,
    pub jitter: Option<Time>,
    pub stall: Option<Nothing>,
    pub cable_pulled: Option<Nothing>,
    pub solver_wedged: Option<Wedged>,
    pub wrong_clock: Option<WrongClock>,
    pub insane: Option<Insane>,
    pub replay: Option<Replay>,
    pub flood: Option<Flood>,
    pub second_host: Option<SecondHost>,
    pub host_killed: Option<HostKilled>,
    pub console_reset: Option<Nothing>,
    pub emergency_stop: Option<Nothing>,
    pub encoder_jump: Option<EncoderCounts>,
    pub encoder_burst: Option<EncoderCounts>,

    pub zero_within_ms: Option<Number>,
    pub recovers_within_ms: Option<Number>,
    pub reconnects_within_ms: Option<Number>,
    pub silent_within_ms: Option<Number>,
    pub holds_n: Option<Number>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Nothing {}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Share {
    pub share: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Time {
    pub ms: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Bursts {
    pub lost_ms: Number,
    pub every_ms: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Duplicates {
    pub share: Number,
    pub after_ms: Option<Number>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Reordering {
    pub share: Number,
    pub by_ms: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BitFlips {
    pub share: Number,
    pub bits: Option<Number>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wedged {
    pub contacts: Spanned<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WrongClock {
    pub offset_ms: Option<Number>,
    pub drift_ppm: Option<Number>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Insane {
    pub what: Spanned<String>,
    pub value: Option<Number>,
    pub share: Option<Number>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Replay {
    pub frames_per_ms: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Flood {
    pub with: Spanned<String>,
    pub bytes_per_ms: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SecondHost {
    pub every_ms: Number,
    #[serde(default)]
    pub wrong_schema: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HostKilled {
    pub back_after_ms: Option<Number>,
    #[serde(default)]
    pub arms: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EncoderCounts {
    pub counts: Spanned<[i32; 3]>,
}

/// `[expect]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExpectSection {
    pub force_n: Option<Number>,
    pub felt_n: Option<Number>,
    pub step_n: Option<Number>,
    pub given_back_j: Option<Number>,
    pub mode: Option<Spanned<String>>,
    pub faults: Option<Spanned<Vec<Spanned<String>>>>,
    pub rejected: Option<Spanned<[u32; 2]>>,
    pub lost: Option<Spanned<[u32; 2]>>,
    pub sessions: Option<Spanned<[u32; 2]>>,
    pub refusals: Option<Spanned<[u32; 2]>>,
}

/// `[mutant]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MutantSection {
    pub off: Spanned<Vec<Spanned<String>>>,
}
