//! What a caller chooses.
//!
//! Entry point: [`Settings`].

use super::motion::Motion;
use crate::BuildError;
use crate::law::Law;

/// The shape functions of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cells {
    /// Four nodes. Far too stiff in bending where volume is nearly kept.
    Linear,
    /// Four nodes, the pressure averaged over the cells about each node: does not lock. Second derivatives
    /// couple neighbours of neighbours, so that a step costs several times as much.
    Averaged,
    /// Ten nodes, with straight edges at rest, four points: third order in displacement.
    Quadratic,
}

/// How tissue is discretised and solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Shape functions.
    pub cells: Cells,
    /// Statics or dynamics.
    pub motion: Motion,
    /// Largest force out of balance at free nodes as a share of the forces that act, 2-norms. 1e-9, as a
    /// reference has to be better than what is compared with it; a step also ends where round-off does.
    pub tolerance: f64,
    /// Newton iterations of a whole step.
    pub most_iterations: u32,
    /// Parts in which a step goes to its drive to begin with; they are halved where there is no way, and
    /// doubled again.
    pub load_steps: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            cells: Cells::Linear,
            motion: Motion::Static,
            tolerance: 1e-9,
            most_iterations: 400,
            load_steps: 1,
        }
    }
}

impl Settings {
    pub(super) fn check(&self) -> Result<(), BuildError> {
        let refuse = |name, value, limit| Err(BuildError::Setting { name, value, limit });
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return refuse("tolerance", self.tolerance, "above 0 and below 1");
        }
        for (name, value) in [
            ("most_iterations", self.most_iterations),
            ("load_steps", self.load_steps),
        ] {
            if value == 0 {
                return refuse(name, 0.0, "at least 1");
            }
        }
        if let Motion::Implicit {
            density_kg_per_m3: density,
            drag_per_s: drag,
            ..
        } = self.motion
        {
            if !(density.is_finite() && density > 0.0) {
                return refuse("density_kg_per_m3", density, "finite and above 0");
            }
            if !(drag.is_finite() && drag >= 0.0) {
                return refuse("drag_per_s", drag, "finite and at least 0");
            }
        }
        Ok(())
    }
}

/// Moduli with which the energy has its minimum at rest.
pub(super) fn check_law(law: &Law) -> Result<(), BuildError> {
    let (mu, bulk, eta, fibre) = match *law {
        Law::StVenantKirchhoff { lambda, mu } => (mu, lambda + 2.0 / 3.0 * mu, 0.0, 1.0),
        Law::NeoHookean {
            mu,
            kappa,
            eta,
            fibre,
        } => (mu, kappa, eta, fibre.norm()),
    };
    let above = |name, value: f64| {
        if value.is_finite() && value > 0.0 {
            Ok(())
        } else {
            Err(BuildError::Setting {
                name,
                value,
                limit: "finite and above 0",
            })
        }
    };
    above("shear modulus of a law", mu)?;
    above("bulk modulus of a law", bulk)?;
    if !(eta.is_finite() && eta >= 0.0) {
        return Err(BuildError::Setting {
            name: "fibre modulus of a law",
            value: eta,
            limit: "finite and at least 0",
        });
    }
    if (fibre - 1.0).abs() < 1e-6 {
        return Ok(());
    }
    Err(BuildError::Setting {
        name: "length of a law's fibre direction",
        value: fibre,
        limit: "1",
    })
}
