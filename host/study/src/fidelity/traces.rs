//! Force over time, for pictures: that of the tissue and of three renderings, in a second of each hand that was measured.
//!
//! Entry point: [`of`].

use super::case::{Case, Place, Scenes, Spec};
use super::hand::Motion;
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::Rendering;

/// Force along the skin's normal.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Trace {
    hand: &'static str,
    /// `true` for the tissue's own.
    rendering: &'static str,
    time_s: Vec<f64>,
    force_n: Vec<f64>,
}

/// Of all hands that touched the palpation scene in the cases.
pub fn of(cases: &[Case], scenes: &Scenes) -> Vec<Trace> {
    let was_measured = |motion: &Motion| {
        let own = |case: &Case| case.scene == "palpation" && case.hand == motion.name();
        cases.iter().any(own)
    };
    let motions = Motion::NAMED.into_iter().filter(was_measured);
    motions.flat_map(|motion| of_hand(motion, scenes)).collect()
}

fn of_hand(motion: Motion, scenes: &Scenes) -> Vec<Trace> {
    let mut traces: Vec<Trace> = Vec::new();
    for rendering in [Rendering::Hold, Rendering::Tangent, Rendering::Rows] {
        let spec = Spec {
            seconds: 2.0,
            ..Spec::errors(Place::Palpation, motion, rendering, 30.0)
        };
        let Ok(record) = spec.record(scenes) else {
            continue;
        };
        let second = || record.ticks.iter().filter(|tick| tick.time_s >= 1.0);
        let trace = |rendering, force_n: Vec<f64>| Trace {
            hand: motion.name(),
            rendering,
            time_s: second().map(|tick| short(tick.time_s)).collect(),
            force_n: force_n.into_iter().map(short).collect(),
        };
        if traces.is_empty() {
            traces.push(trace(
                "true",
                second().map(|tick| tick.truth_n[2]).collect(),
            ));
        }
        let felt = second().map(|tick| tick.acting_n[2]).collect();
        traces.push(trace(spec.case().rendering, felt));
    }
    traces
}

/// As many digits as a picture shows, and some more.
fn short(value: f64) -> f64 {
    (1e5 * value).round() / 1e5
}
