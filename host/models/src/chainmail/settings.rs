//! What an ellipsoid-bounded ChainMail can be told.
//!
//! Entry point: [`EllipsoidSettings`].

use crate::BuildError;
use crate::setting::within;

/// Where links stay this many times the tolerance beyond their limits, the mail is jammed: what brings them back is no
/// force, it only shows how far there is to go.
pub(super) const JAMMED: f64 = 10.0;

/// What an [`super::EllipsoidChainMail`] can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EllipsoidSettings {
    /// Strain at which a link stops giving, along x, y, z; from 0.001 to 0.9. 0.3, the middle one of
    /// zhang-2017's three soft tissues.
    pub strain_limit: [f64; 3],
    /// Mass density \[kg/m^3\]; 1060, of liver.
    pub density_kg_per_m3: f64,
    /// Stiffness of the links as a share of what their material asks for; 1. 0 gives links without springs,
    /// as printed.
    pub stiffness: f64,
    /// Time in which the slowest motion dies away \[s\]; 0.05, so that tissue follows a hand (up to 5 Hz)
    /// and does not ring.
    pub relaxation_s: f64,
    /// How far beyond its limit a link may stay, as a share of its rest length; 0.001, a tenth of what can
    /// be seen and felt, for a tenth of the visits.
    pub tolerance: f64,
    /// Visits of elements in a step, for each one awake; 4, which is what 20,000 elements in 1 ms allow.
    /// What is then still beyond its limits is left to the next step, and said.
    pub visits: u32,
    /// Speed below which elements fall asleep \[m/s\]; 1e-6, a tenth of a millimetre in 100 s.
    pub sleep_m_per_s: f64,
}

impl Default for EllipsoidSettings {
    fn default() -> Self {
        Self {
            strain_limit: [0.3; 3],
            density_kg_per_m3: 1060.0,
            stiffness: 1.0,
            relaxation_s: 0.05,
            tolerance: 1e-3,
            visits: 4,
            sleep_m_per_s: 1e-6,
        }
    }
}

impl EllipsoidSettings {
    /// Refuses what is out of range.
    pub(super) fn check(&self) -> Result<(), BuildError> {
        check_limit(self.strain_limit)?;
        let density = self.density_kg_per_m3;
        within("density_kg_per_m3", density, 1.0, 1e5, "from 1 to 1e5")?;
        within("stiffness", self.stiffness, 0.0, 1e3, "from 0 to 1000")?;
        within(
            "relaxation_s",
            self.relaxation_s,
            0.0,
            1e3,
            "from 0 to 1000",
        )?;
        within("tolerance", self.tolerance, 1e-9, 0.1, "from 1e-9 to 0.1")?;
        within("visits", f64::from(self.visits), 1.0, 1e6, "from 1 to 1e6")?;
        within("sleep_m_per_s", self.sleep_m_per_s, 0.0, 1.0, "from 0 to 1")
    }
}

/// Refuses a strain limit out of range.
pub(super) fn check_limit(limit: [f64; 3]) -> Result<(), BuildError> {
    limit
        .into_iter()
        .try_for_each(|value| within("strain_limit", value, 1e-3, 0.9, "from 0.001 to 0.9"))
}
