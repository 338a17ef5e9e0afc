//! The tissue model that was chosen for a session, and from what.
//!
//! Entry point: [`Chosen`]; `sutura_study::choice` makes it.

use crate::scene::ContactLaw;
use schemars::JsonSchema;
use serde::Serialize;

/// One model with one setting.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Candidate {
    /// Name of the model.
    pub model: &'static str,
    /// Its setting in words; empty if it has none.
    pub setting: String,
    /// What `--tissue` takes it by.
    pub tissue: String,
    /// Median and slowest hundredth of the steps in contact \[us\], each the fastest of the repetitions; none if it was not run,
    /// or fails.
    pub step_us: Option<StepUs>,
    /// Force on the tool against the reference's under the same contact law: root of the mean square over the press, over the
    /// largest; none if it was not compared.
    pub error: Option<f64>,
    /// Displacement of all nodes against the reference's: root of the mean square, over that of the reference.
    pub displacement_error: Option<f64>,
    /// Why something was not measured, if so.
    pub note: String,
}

/// Time of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct StepUs {
    /// Median \[us\].
    pub p50: f64,
    /// 99 of 100 are faster \[us\].
    pub p99: f64,
}

/// What was taken, from what.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Chosen {
    /// Name of the model.
    pub model: &'static str,
    /// Its setting in words.
    pub setting: String,
    /// Its time.
    pub step_us: Option<StepUs>,
    /// Its error, as [`Candidate::error`].
    pub error: Option<f64>,
    /// How tools touch, with every candidate: what has another contact law is none.
    pub contact: ContactLaw,
    /// What a step may take \[ms\].
    pub budget_ms: f64,
    /// Whether its measured steps do, with `sutura_study::choice::SAFE_SHARE` to spare.
    pub holds_budget: bool,
    /// Wall-clock time of the measurement \[s\].
    pub calibration_s: f64,
    /// All that was looked at.
    pub candidates: Vec<Candidate>,
}
