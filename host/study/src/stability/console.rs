//! The console with a host that is late by a millisecond to a second, in simulation.
//!
//! Entry point: [`slow_host`].

use super::judge::Verdict;
use crate::fidelity::case::{Place, Scenes, Spec};
use crate::fidelity::hand::Motion;
use sutura_shared::control::Rendering;

/// What the console may lose \[J\]: a hand that is pushed by more feels that the tissue is alive.
const MOST_ENERGY_J: f64 = 1e-3;
/// Largest force error that is stable \[%\], RMS.
const MOST_ERROR_PCT: f64 = 10.0;

/// A hand that presses into linear tissue, with the host's answers a period late.
pub fn slow_host(scenes: &Scenes, rendering: Rendering, period_ms: f64) -> Verdict {
    let spec = Spec {
        seconds: 4.0,
        ..Spec::errors(
            Place::Palpation,
            Motion::Presses,
            rendering,
            1e3 / period_ms,
        )
    };
    let case = match spec.measure(scenes) {
        Ok(case) => case,
        Err(error) => return Verdict::Refused(error.to_string()),
    };
    let rms = case.errors.map_or(f64::NAN, |errors| errors.rms_pct);
    let energy = case.energy_min_j;
    if !(rms.is_finite() && energy.is_finite()) {
        Verdict::Defect("the force is not a number".to_owned())
    } else if energy < -MOST_ENERGY_J {
        Verdict::Degraded(format!(
            "gives {:.1} mJ more than it took; force {rms:.0} % off",
            -1e3 * energy
        ))
    } else if rms > MOST_ERROR_PCT {
        Verdict::Degraded(format!("passive; force {rms:.0} % off"))
    } else {
        Verdict::Stable
    }
}
