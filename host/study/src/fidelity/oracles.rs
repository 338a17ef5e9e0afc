//! The simulation against theory: bounds that are known in closed form, on the plant and the control of all other figures.
//!
//! Entry point: [`oracles`]. A wall of stiffness K on a device with damping b, rendered by the console's control with all
//! guards off, from a host that solves every millisecond: *stable* below K = b / (T/2 + t_d) (Gil, Avello, Rubio and
//! Florez 2004, for short delay and low damping); *passive* below K T/2 = b (Colgate and Schenkel 1997), and with an
//! encoder of step D and Coulomb friction f below K = min(2 b / T, 2 f / D) (Abbott and Okamura 2005). Passive means: no
//! way of the hand gets energy out of wall and device. The ways that are tried are the worst: to and fro at every sample.

use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::plant::Mechanics;
use super::run::{Host, Record, Setup, run};
use super::scenes::point::Point;
use super::stiffest::{Search, stiffest};
use super::switches::Mendings;
use schemars::JsonSchema;
use serde::Serialize;
use sutura_shared::control::{Guards, Rendering, TICK_S, Tuning};
use sutura_shared::device::DeviceError;

/// One figure against theory.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Oracle {
    /// What.
    pub name: String,
    /// Found.
    pub value: f64,
    /// By theory: the bound itself, or the sign of the energy.
    pub expected: f64,
    /// Of both.
    pub unit: &'static str,
    /// Whether they agree: within 15 %, or in sign.
    pub ok: bool,
}

/// A wall that neither hardens nor relaxes.
const WALL: Point = Point {
    stiffness_n_per_m: 100.0,
    hardening_m: 1e9,
};
/// Encoders too fine to matter \[1/m\].
const FINE: f64 = 1e8;
/// What presses on the wall \[N\]: more than a knock takes away.
const WEIGHT_N: f64 = 4.0;

/// How deep the hand is that rattles \[nm\]: motors of 15 N hold the hardest wall there.
const DEPTH_NM: f64 = 1e6;

/// The force as the host has it: nothing watches over it, nothing leads it.
const PLAIN: Tuning = Tuning {
    rendering: Rendering::Tangent,
    guards: Guards {
        blend: false,
        trust: false,
        lead: false,
        bend: false,
        swing: false,
        tank: false,
        along: false,
        credit: false,
        damping: false,
        horizon: false,
        force: false,
        slew: false,
        power: false,
        overspeed: false,
        residual: false,
        rubs: false,
        emergency_stop: false,
        encoder_jump: false,
        encoder_burst: false,
        disarm: false,
    },
};

/// The largest stiffness with which a weight comes to rest on the wall.
fn stiffest_wall(mechanics: Mechanics) -> Result<f64, DeviceError> {
    let found = stiffest(&Search {
        tuning: PLAIN,
        host: Host::Late(LinkSpec::IMMEDIATE),
        tangent_scale: 1.0,
        mechanics,
        grasp: Grasp::Weight {
            mass_kg: 0.0,
            force_n: WEIGHT_N,
        },
        tissue: WALL,
    })?;
    Ok(found.k_max_n_per_m)
}

/// Energy that a rattling hand gets out of wall and device \[J\], the device's damping and friction counted.
fn got_j(stiffness_n_per_m: f64, mechanics: Mechanics, rattle: Motion) -> Result<f64, DeviceError> {
    let wall = Point {
        stiffness_n_per_m,
        ..WALL
    };
    let record = run(&Setup {
        scene: &wall,
        motion: rattle,
        grasp: Grasp::Rigid,
        mechanics,
        tuning: PLAIN,
        host: Host::Late(LinkSpec::IMMEDIATE),
        tangent_scale: 1.0,
        most_rows: 0,
        seconds: 0.5,
        knock: None,
        truth: None,
        phase: 0.0,
        cold: false,
        blocking: None,
        arms_s: 0.0,
        stop: None,
        mendings: Mendings::ALL,
    })?;
    Ok(got_of(&record, mechanics))
}

/// While it rattles, which ends where it began.
fn got_of(record: &Record, mechanics: Mechanics) -> f64 {
    let [from, until] = Motion::RATTLES_MS;
    let ticks = record.ticks.get(from..=until).unwrap_or_default();
    let of_pairs = ticks.windows(2).map(|pair| {
        let way = pair[1].position_m[2] - pair[0].position_m[2];
        let damped = mechanics.damping_n_s_per_m * way * way / f64::from(TICK_S);
        pair[0].energy_j - pair[1].energy_j - damped - mechanics.coulomb_n * way.abs()
    });
    of_pairs.sum()
}

/// The most that any of some ways gets \[J\].
fn most_got_j(stiffness_n_per_m: f64, mechanics: Mechanics) -> Result<f64, DeviceError> {
    let step_nm = 1e9 / mechanics.counts_per_m;
    let mut most = f64::NEG_INFINITY;
    // Across the edge of an encoder's step by a hundredth of it, by some steps, and by far more.
    for size_nm in [0.01 * step_nm, 2.0 * step_nm, 1e5, 1e6] {
        let edges = (DEPTH_NM / step_nm).floor() * step_nm;
        let rattle = Motion::Rattle {
            depth_nm: (edges - 0.5 * size_nm) as u32,
            size_nm: size_nm.max(1.0) as u32,
        };
        most = most.max(got_j(stiffness_n_per_m, mechanics, rattle)?);
    }
    Ok(most)
}

/// All of them.
///
/// # Errors
/// None: the mechanics are sound.
pub fn oracles() -> Result<Vec<Oracle>, DeviceError> {
    let mut found = Vec::new();
    let plain = Mechanics {
        actuation_ticks: 0,
        counts_per_m: FINE,
        ..Mechanics::LIGHT
    };
    let late = |ticks, damping_n_s_per_m| Mechanics {
        actuation_ticks: ticks,
        damping_n_s_per_m,
        ..plain
    };
    for (mechanics, name) in [
        (plain, "no delay"),
        (late(1, 0.5), "one period of delay"),
        (late(2, 0.5), "two periods of delay"),
        (late(1, 1.0), "device damping 1 N s/m, one period of delay"),
    ] {
        let period_s = f64::from(TICK_S);
        let delay_s = period_s * mechanics.actuation_ticks as f64;
        let expected = mechanics.damping_n_s_per_m / (0.5 * period_s + delay_s);
        let value = stiffest_wall(mechanics)?;
        found.push(Oracle {
            name: format!("Gil, stability, {name}"),
            value,
            expected,
            unit: "N/m",
            ok: (value / expected - 1.0).abs() <= 0.15,
        });
    }
    let rubbing = |coulomb_n| Mechanics {
        coulomb_n,
        counts_per_m: Mechanics::LIGHT.counts_per_m,
        ..plain
    };
    // Friction of 3 mN at 12.3 um: the encoder limits; of 50 mN: damping does.
    for (mechanics, name) in [
        (plain, "Colgate-Schenkel, b 0.5"),
        (late(0, 2.0), "Colgate-Schenkel, b 2"),
        (
            rubbing(3e-3),
            "Abbott-Okamura, friction 3 mN, encoder limits",
        ),
        (
            rubbing(0.05),
            "Abbott-Okamura, friction 50 mN, damping limits",
        ),
    ] {
        let damped = 2.0 * mechanics.damping_n_s_per_m / f64::from(TICK_S);
        let bound = if mechanics.coulomb_n > 0.0 {
            damped.min(2.0 * mechanics.coulomb_n * mechanics.counts_per_m)
        } else {
            damped
        };
        for share in [0.85, 1.15] {
            let got = 1e3 * most_got_j(share * bound, mechanics)?;
            found.push(Oracle {
                name: format!("{name}: most energy got at {share} of {bound:.0} N/m"),
                value: got,
                expected: if share < 1.0 { 0.0 } else { f64::MIN_POSITIVE },
                unit: "mJ",
                ok: (got > 0.0) == (share > 1.0),
            });
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_simulation_agrees_with_theory() {
        for oracle in oracles().expect("sound mechanics") {
            println!("{oracle:?}");
            assert!(oracle.ok, "{oracle:?}");
        }
    }
}
