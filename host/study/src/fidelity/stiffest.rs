//! The largest stiffness that a hold is stable with.
//!
//! Entry point: [`stiffest`].

use super::hand::{Grasp, Motion};
use super::measure::{STABLE_SWING, Steadiness, steadiness};
use super::notice::{given_back_as_described_j, given_back_j};
use super::plant::Mechanics;
use super::run::{Host, Knock, Record, Setup, run};
use super::scenes::point::Point;
use super::switches::Mendings;
use super::targets::GIVEN_BACK_MJ;
use sutura_shared::control::Tuning;
use sutura_shared::device::DeviceError;

/// How far the hand presses without the tissue \[m\], as [`Motion::Hold`] has it.
const PRESSED_M: f64 = 10e-3;
/// Farther than any weight sinks \[m\].
const SUNK_M: f64 = 10.0;
/// How long a hold by a hand's spring lasts, and one by a weight, which nothing damps but tissue and console \[s\].
const HELD_S: [f64; 2] = [3.0, 10.0];

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
    /// Who holds it: a spring or a weight.
    pub grasp: Grasp,
    /// What is made stiffer and stiffer.
    pub tissue: Point,
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
    /// Most that the motors gave back in 100 ms beyond the true tissue in any of the stable runs \[J\].
    pub most_given_back_j: f64,
    /// What ended the search.
    pub ends_by: Ends,
}

/// Why the next stiffer tissue is not stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// The force swings.
    Swing,
    /// It swings little, but ever more.
    Growth,
    /// Less than half of the true force is left.
    Force,
    /// It comes to rest, but gave back too much energy until then.
    Energy,
    /// A fault is latched.
    Fault,
    /// All that was tried is stable.
    Nothing,
}

impl Ends {
    fn of(steady: &Steadiness) -> Self {
        if !steady.is_faultless {
            Ends::Fault
        } else if steady.is_stable && steady.force_ratio < LEAST_RATIO {
            Ends::Force
        } else if steady.is_stable {
            Ends::Energy
        } else if steady.swing <= STABLE_SWING {
            Ends::Growth
        } else {
            Ends::Swing
        }
    }

    /// As tables print it.
    pub fn word(self) -> &'static str {
        match self {
            Ends::Swing => "swing",
            Ends::Growth => "growth",
            Ends::Force => "force",
            Ends::Energy => "energy",
            Ends::Fault => "fault",
            Ends::Nothing => "nothing",
        }
    }
}

/// Least force over the true one in a hold that counts: guards that just switch the force off do not.
pub const LEAST_RATIO: f64 = 0.5;
/// Most that a hold that counts may give back in 100 ms beyond the true tissue \[J\], by motors as described: swings that end do not
/// count where they first throw the hand about.
const MOST_GIVEN_BACK_J: f64 = 1e-3 * GIVEN_BACK_MJ;
/// Least and largest stiffness tried \[N/m\], and the factor between two.
const RANGE: (f64, f64, f64) = (40.0, 20_000.0, 1.25);

/// One hold of tissue whose stiffness there is `k`, with a knock of 1 N for 20 ms.
///
/// # Errors
/// None with sound mechanics.
pub fn hold(search: &Search, k: f64) -> Result<(Steadiness, Record), DeviceError> {
    let scene = tissue(k, search);
    let record = run(&Setup {
        scene: &scene,
        motion: Motion::Hold,
        grasp: search.grasp,
        mechanics: search.mechanics,
        tuning: search.tuning,
        host: search.host,
        tangent_scale: search.tangent_scale,
        most_rows: 24,
        seconds: match search.grasp {
            Grasp::Weight { .. } => HELD_S[1],
            Grasp::Spring { .. } | Grasp::Rigid => HELD_S[0],
        },
        knock: Some(Knock {
            from_s: 1.5,
            until_s: 1.52,
            force_n: [0.0, 0.0, -1.0],
        }),
        truth: None,
        phase: 0.0,
        cold: false,
        blocking: None,
        arms_s: 0.0,
        stop: None,
        mendings: Mendings::ALL,
    })?;
    Ok((steadiness(&record), record))
}

/// The largest stable stiffness, to 3 %, with at least half of the true force and without giving back what the tissue did not.
///
/// # Errors
/// None with sound mechanics.
pub fn stiffest(search: &Search) -> Result<Stiffest, DeviceError> {
    let (mut k, highest, factor) = RANGE;
    let mut found = Stiffest {
        k_max_n_per_m: 0.0,
        least_energy_j: 0.0,
        least_force_ratio: f64::INFINITY,
        most_given_back_j: 0.0,
        ends_by: Ends::Nothing,
    };
    let mut first_bad = highest;
    let mut take = |k: f64| -> Result<bool, DeviceError> {
        let (steady, record) = hold(search, k)?;
        let of_described_j = given_back_as_described_j(&record, search.mechanics.off.torque);
        let counts = steady.is_stable
            && steady.force_ratio >= LEAST_RATIO
            && of_described_j <= MOST_GIVEN_BACK_J;
        if counts {
            found.k_max_n_per_m = k;
            found.least_energy_j = found.least_energy_j.min(record.least_energy_j);
            found.most_given_back_j = found.most_given_back_j.max(given_back_j(&record));
            found.least_force_ratio = found.least_force_ratio.min(steady.force_ratio);
        } else {
            found.ends_by = Ends::of(&steady);
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
fn tissue(k: f64, search: &Search) -> Point {
    let held = |tissue: Point| match search.grasp {
        // Nothing pushes a rigid hand anywhere; it is where it wants to be.
        Grasp::Rigid => tissue.stiffness_held_by(|_| f64::INFINITY, PRESSED_M),
        Grasp::Spring {
            stiffness_n_per_m, ..
        } => tissue.stiffness_held_by(|deep| stiffness_n_per_m * (PRESSED_M - deep), PRESSED_M),
        Grasp::Weight { force_n, .. } => tissue.stiffness_held_by(|_| force_n, SUNK_M),
    };
    let (mut low, mut high) = (1e-3, 1e3);
    for _ in 0..60 {
        let times: f64 = f64::sqrt(low * high);
        if held(search.tissue.stiffer(times)) < k {
            low = times;
        } else {
            high = times;
        }
    }
    search.tissue.stiffer(low)
}
