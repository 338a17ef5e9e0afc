//! Corners of the device: consoles that are not as their description says, held by all kinds of hands.
//!
//! Entry points: [`specs`], [`table`]. Each is measured at 30 Hz with a delay of a period, against its own reference: the
//! same console, hand and device with a host that solves every millisecond, without delay. A control that leans on the
//! described delay does well at the described device and nowhere else, which a comparison with another console hides.

use super::case::{Case, Question, Spec};
use super::hand::Grasp;
use super::plant::{Mechanics, Off};
use serde::{Deserialize, Serialize};
use sutura_shared::control::Rendering;

/// The host's rate at the corners \[1/s\].
pub const HOST_HZ: f64 = 30.0;

/// A tick more and less of delay, a current loop's lag, half and twice the mass, a fifth more and less torque.
pub const DEVICES: [Off; 9] = [
    Off::NONE,
    Off {
        ticks: 1,
        ..Off::NONE
    },
    Off {
        ticks: -1,
        ..Off::NONE
    },
    Off {
        lag_s: 1e-3,
        ..Off::NONE
    },
    Off {
        lag_s: 2e-3,
        ..Off::NONE
    },
    Off {
        mass: 0.5,
        ..Off::NONE
    },
    Off {
        mass: 2.0,
        ..Off::NONE
    },
    Off {
        torque: 0.8,
        ..Off::NONE
    },
    Off {
        torque: 1.2,
        ..Off::NONE
    },
];

/// Springs of 50, 200 and 800 N/m that damp their mass alike, masses of 10 and 100 g that are one with the grip, and none:
/// these three pushed by 1 N.
pub const HANDS: [Grasp; 6] = [
    Grasp::Spring {
        stiffness_n_per_m: 50.0,
        damping_n_s_per_m: 1.0,
    },
    Grasp::PEN,
    Grasp::Spring {
        stiffness_n_per_m: 800.0,
        damping_n_s_per_m: 4.0,
    },
    weight(0.01),
    weight(0.1),
    weight(0.0),
];

const fn weight(mass_kg: f64) -> Grasp {
    Grasp::Weight {
        mass_kg,
        force_n: 1.0,
    }
}

/// One corner.
pub fn spec(off: Off, grasp: Grasp) -> Spec {
    Spec {
        question: Question::Corner,
        grasp,
        mechanics: Mechanics {
            off,
            ..Mechanics::LIGHT
        },
        ..Spec::stiffest(Rendering::Tangent, HOST_HZ, 1.0)
    }
}

/// Every device with every hand.
pub fn specs() -> Vec<Spec> {
    let hands = HANDS.into_iter();
    hands
        .flat_map(|hand| DEVICES.map(|off| spec(off, hand)))
        .collect()
}

/// The nominal corner and the worst of each kind, for the short form.
pub fn known_worst() -> Vec<Spec> {
    let [soft, _, firm, _, heavy, light] = HANDS;
    let [_, late, early, lagging, _, _, massive, _, strong] = DEVICES;
    vec![
        spec(Off::NONE, Grasp::PEN),
        spec(late, light),
        spec(early, Grasp::PEN),
        spec(lagging, firm),
        spec(massive, heavy),
        spec(strong, soft),
        spec(strong, light),
    ]
}

/// A line of the table of corners, with fewer digits than were found: a search ends within 3 %.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// As [`Off::word`] has it.
    pub device: String,
    /// As [`Grasp::word`] has it.
    pub hand: String,
    /// Largest stable stiffness \[N/m\].
    pub k_max_n_per_m: f64,
    /// The same with a host that solves every millisecond, without delay \[N/m\].
    pub k_reference_n_per_m: f64,
    /// One over the other.
    pub k_of_reference: f64,
    /// Least mean force over the true one, in any stable hold; 0 if none is stable.
    pub force_ratio: f64,
    /// Most that the motors gave back in 100 ms beyond the true tissue, in any stable hold \[mJ\].
    pub given_back_mj: f64,
    /// The same of the reference \[mJ\].
    pub reference_given_back_mj: f64,
    /// What makes stiffer tissue unstable: `swing`, `growth`, `force` below half of the true one, `energy` given back, `fault`.
    pub ends_by: String,
}

/// The corners among some cases.
pub fn table(cases: &[Case]) -> Vec<Line> {
    let round = |value: f64, digits: f64| (value * digits).round() / digits;
    let line = |case: &Case| {
        let corner = case.corner?;
        Some(Line {
            device: case.device.clone(),
            hand: case.grasp.clone(),
            k_max_n_per_m: round(case.k_max_n_per_m?, 10.0),
            k_reference_n_per_m: round(corner.k_reference_n_per_m, 10.0),
            k_of_reference: round(corner.k_of_reference, 1e3),
            force_ratio: round(case.force_ratio.unwrap_or(0.0), 1e3),
            given_back_mj: round(corner.given_back_mj, 1e3),
            reference_given_back_mj: round(corner.reference_given_back_mj, 1e3),
            ends_by: corner.ends_by.to_owned(),
        })
    };
    cases.iter().filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_corner_has_a_name_of_its_own() {
        let mut names: Vec<_> = specs().iter().map(|spec| spec.case().case).collect();
        assert_eq!(names[1], "corner point hold hand-50 tangent 30-hz +1-tick");
        names.sort();
        names.dedup();
        assert_eq!(names.len(), DEVICES.len() * HANDS.len());
    }
}
