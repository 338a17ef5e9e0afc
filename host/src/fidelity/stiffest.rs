//! The largest stiffness that a hold is stable with.
//!
//! Entry point: [`stiffest`].

use super::hand::{Grasp, Motion};
use super::measure::{Steadiness, steadiness};
use super::plant::Mechanics;
use super::run::{Host, Knock, Setup, run};
use super::scenes::point::Point;
use sutura_shared::control::Tuning;
use sutura_shared::device::DeviceError;

/// Stiffness of the hand \[N/m\] and how far it presses without the tissue \[m\], as [`Grasp::PEN`] and
/// [`Motion::Hold`] have them.
const HAND_N_PER_M: f64 = 200.0;
const PRESSED_M: f64 = 10e-3;

/// What is searched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// What the console renders, with which guards.
    pub tuning: Tuning,
    /// Who solves.
    pub host: Host,
    /// How wrong the tangent is.
    pub tangent_scale: f64,
    /// The console's mechanics.
    pub mechanics: Mechanics,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiffest {
    /// Stiffness that a fast motion feels at the hold \[N/m\]: all smaller ones tried are stable.
    pub k_max_n_per_m: f64,
    /// Least energy that the motors had taken in any of the stable runs \[J\].
    pub least_energy_j: f64,
    /// Least mean force over the true one in any of the stable runs.
    pub least_force_ratio: f64,
}

/// Least force over the true one in a hold that counts: guards that just switch the force off do not.
pub const LEAST_RATIO: f64 = 0.5;
/// Least and largest stiffness tried \[N/m\], and the factor between two.
const RANGE: (f64, f64, f64) = (40.0, 20_000.0, 1.25);

/// One hold of tissue whose stiffness there is `k`, with a knock of 1 N for 20 ms.
///
/// # Errors
/// None with sound mechanics.
pub fn hold(search: &Search, k: f64) -> Result<(Steadiness, f64), DeviceError> {
    let scene = tissue(k);
    let record = run(&Setup {
        scene: &scene,
        motion: Motion::Hold,
        grasp: Grasp::PEN,
        mechanics: search.mechanics,
        tuning: search.tuning,
        host: search.host,
        tangent_scale: search.tangent_scale,
        most_rows: 24,
        seconds: 3.0,
        knock: Some(Knock {
            from_s: 1.5,
            until_s: 1.52,
            force_n: [0.0, 0.0, -1.0],
        }),
        truth: None,
    })?;
    Ok((steadiness(&record), record.least_energy_j))
}

/// The largest stable stiffness, to 3 %, with at least half of the true force.
///
/// # Errors
/// None with sound mechanics.
pub fn stiffest(search: &Search) -> Result<Stiffest, DeviceError> {
    let (mut k, highest, factor) = RANGE;
    let mut found = Stiffest {
        k_max_n_per_m: 0.0,
        least_energy_j: 0.0,
        least_force_ratio: f64::INFINITY,
    };
    let mut first_bad = highest;
    let mut take = |k: f64| -> Result<bool, DeviceError> {
        let (steady, energy) = hold(search, k)?;
        let counts = steady.is_stable && steady.force_ratio >= LEAST_RATIO;
        if counts {
            found.k_max_n_per_m = k;
            found.least_energy_j = found.least_energy_j.min(energy);
            found.least_force_ratio = found.least_force_ratio.min(steady.force_ratio);
        }
        Ok(counts)
    };
    let mut last_good = 0.0;
    while k <= highest {
        if !take(k)? {
            first_bad = k;
            break;
        }
        last_good = k;
        k *= factor;
    }
    while last_good > 0.0 && first_bad / last_good > 1.03 {
        let middle = (last_good * first_bad).sqrt();
        if take(middle)? {
            last_good = middle;
        } else {
            first_bad = middle;
        }
    }
    Ok(found)
}

/// The point of tissue that has stiffness `k` where the hand rests.
fn tissue(k: f64) -> Point {
    let (mut low, mut high) = (1e-3, 1e3);
    for _ in 0..60 {
        let times: f64 = f64::sqrt(low * high);
        let found = Point::TISSUE
            .stiffer(times)
            .stiffness_held_by(HAND_N_PER_M, PRESSED_M);
        if found < k {
            low = times;
        } else {
            high = times;
        }
    }
    Point::TISSUE.stiffer(low)
}
