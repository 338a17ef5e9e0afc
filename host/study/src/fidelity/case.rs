//! One line of the tables: what was run, and what came of it.
//!
//! Entry point: [`Case`], which [`Spec::measure`] fills in.

use super::draws::Draw;
use super::measure::{Errors, Peaks, Punctures, Slips};
use super::notice::Noticed;
use super::plant::{Mechanics, Off};
use super::returns::Returned;
use super::trials::Factor;
use schemars::JsonSchema;
use serde::Serialize;

pub use super::places::{Place, Scenes};
pub use super::spec::{Question, Spec};

/// One line of the tables. Numbers that were not asked for are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Case {
    /// All words below, for people and `--only`.
    pub case: String,
    /// `errors`, `trial`, `stability`, `corner`, `return`, `stop` or `rogue`.
    pub question: &'static str,
    /// Which scene.
    pub scene: String,
    /// What the hand does.
    pub hand: &'static str,
    /// `rigid`, `pen`, `free`, `hand-50` (N/m), `weight-10-g`.
    pub grasp: String,
    /// `full` for the scene solved in every tick.
    pub rendering: &'static str,
    /// \[1/s\].
    pub host_hz: f64,
    /// From the state to the arrival of its frame, without jitter \[ms\].
    pub delay_ms: f64,
    /// \[ms\].
    pub jitter_ms: f64,
    /// Part of the frames that is lost.
    pub loss: f64,
    /// Length of the bursts in which all is lost \[ms\].
    pub burst_ms: f64,
    /// Part of the frames that come after their successors.
    pub reordered: f64,
    /// How wrong the tangent is.
    pub tangent_scale: f64,
    /// Most rows in a frame.
    pub most_rows: usize,
    /// Damping of the console \[N s/m\].
    pub device_damping_n_s_per_m: f64,
    /// Most power of the console \[W\].
    pub device_max_power_w: f64,
    /// How it differs from its description: `nominal`, `+1-tick`, `lag-1-ms`, `mass-x2`, `torque-x0.8`.
    pub device: String,
    /// What is off of the console's guards and of what the host does about its being late.
    pub guards_off: Vec<&'static str>,
    /// Errors, if asked for.
    #[serde(flatten)]
    pub errors: Option<Errors>,
    /// Largest stable stiffness \[N/m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_max_n_per_m: Option<f64>,
    /// That over the one of the full 1 kHz loop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_ratio: Option<f64>,
    /// Least mean force in a stable hold, over the true one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_ratio: Option<f64>,
    /// The corner, if asked for.
    #[serde(flatten)]
    pub corner: Option<Corner>,
    /// How a force came back, if asked for.
    #[serde(flatten)]
    pub returned: Option<Returned>,
    /// Largest force after a stop, if asked for \[N\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_after_stop_n: Option<f64>,
    /// When punctures were felt, where there were any.
    #[serde(flatten)]
    pub punctures: Option<Punctures>,
    /// When slips were felt, where a tool rubs.
    #[serde(flatten)]
    pub slips: Option<Slips>,
    /// Extremes, if asked for.
    #[serde(flatten)]
    pub peaks: Option<Peaks>,
    /// Most that the motors gave back in 100 ms beyond the true tissue \[mJ\], with errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub given_back_mj: Option<f64>,
    /// What a hand would notice, if it was a trial.
    #[serde(flatten)]
    pub noticed: Option<Noticed>,
    /// The trial, if it was one.
    #[serde(flatten)]
    pub trial: Option<Trial>,
    /// Least energy that the motors had taken, less what they had given \[J\]: the integral of F v of the true
    /// motion.
    pub energy_min_j: f64,
}

/// What makes a trial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Trial {
    /// What is not as planned.
    pub factor: &'static str,
    /// Part of the time in which the host stalls, %.
    pub stalled_pct: f64,
    /// The longest stall \[ms\].
    pub longest_stall_ms: f64,
    /// All that was drawn, of a draw.
    #[serde(flatten)]
    pub draw: Option<Draw>,
}

/// What a corner of the device has beside its largest stable stiffness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Corner {
    /// Largest stable stiffness of the same console, hand and device with a host that solves every millisecond, without
    /// delay \[N/m\].
    pub k_reference_n_per_m: f64,
    /// The case's own over that.
    pub k_of_reference: f64,
    /// Most that the motors gave back in 100 ms beyond the true tissue, in any stable hold \[mJ\].
    pub given_back_mj: f64,
    /// The same of the reference \[mJ\].
    pub reference_given_back_mj: f64,
    /// What makes stiffer tissue unstable: `swing`, `growth`, `force` below half, `fault`.
    pub ends_by: &'static str,
}

impl Case {
    /// Whether some frames did not come when they should.
    pub fn is_lossy(&self) -> bool {
        self.loss > 0.0 || self.burst_ms > 0.0 || self.reordered > 0.0
    }

    /// Whether neither tank nor damping watches over energy.
    pub fn is_unguarded(&self) -> bool {
        ["tank", "damping"]
            .iter()
            .all(|name| self.guards_off.contains(name))
    }

    pub(super) fn words(&self, spec: &Spec) -> String {
        let mut words = vec![
            self.question.to_owned(),
            self.scene.clone(),
            self.hand.to_owned(),
            self.grasp.clone(),
            self.rendering.to_owned(),
        ];
        if self.rendering != "full" {
            words.push(format!("{:.0}-hz", self.host_hz));
            if self.tangent_scale != 1.0 {
                words.push(format!("x{}", self.tangent_scale));
            }
            if spec.most_rows.is_some() {
                words.push(format!("{}-rows", self.most_rows));
            }
        }
        if self.loss > 0.0 {
            words.push(format!("loss-{}", self.loss));
        }
        match spec.question {
            Question::Return(away) => words.push(away.word()),
            Question::Stop(stop) => words.push(stop.word().to_owned()),
            _ => {}
        }
        if self.burst_ms > 0.0 && self.question != "return" {
            words.push(format!("burst-{:.0}-ms", self.burst_ms));
        }
        if self.reordered > 0.0 {
            words.push("reordered".to_owned());
        }
        if self.device_damping_n_s_per_m != Mechanics::LIGHT.damping_n_s_per_m {
            words.push(format!("b-{}", self.device_damping_n_s_per_m));
        }
        if self.device_max_power_w != Mechanics::LIGHT.max_power_w {
            words.push(format!("{}-w", self.device_max_power_w));
        }
        if let Question::Trial(factor) = spec.question {
            words.push(factor.name(&spec.around));
            if matches!(factor, Factor::Draw(_)) {
                return words.join(" ");
            }
            if factor == Factor::Cold {
                words.push(format!("phase-{:.2}", spec.around.phase));
            }
        }
        if spec.question == Question::Errors && spec.around.phase > 0.0 {
            words.push(format!("phase-{:.4}", spec.around.phase));
        }
        if spec.question == Question::Corner || spec.mechanics.off != Off::NONE {
            words.push(self.device.clone());
        }
        for name in &self.guards_off {
            words.push(format!("no-{name}"));
        }
        words.join(" ")
    }
}
