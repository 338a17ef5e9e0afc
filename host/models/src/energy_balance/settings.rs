//! What an energy-balance model is to do.
//!
//! Entry point: [`Settings`].

use crate::BuildError;

/// How positions follow from the cells' energies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Zhang-2017 (5.8) and (5.9) as printed: each cell steps towards W = 0, and the steps of all cells of a
    /// node are summed. Not an equilibrium; on a bulk mesh it diverges.
    Printed,
    /// The same with the mean of the cells' steps instead of their sum: stays finite, goes towards W = 0.
    Averaged,
    /// Each cell is a constraint C = sqrt(2 W) with compliance 1, so that 1/2 C^2 = W (Macklin et al.
    /// 2016); cells follow one another. At rest only where loads and stresses balance.
    Compliant,
    /// The nodes' summed energy gradients less the loads, along conjugate directions: the same balance in
    /// far fewer visits.
    Balanced,
}

/// What cells are computed in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lanes {
    /// One cell at a time in double precision.
    Scalar,
    /// Sixteen cells side by side in single precision.
    Wide,
}

/// How inertia counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Not at all: a step goes towards balance, velocity is dropped.
    QuasiStatic,
    /// Zhang-2017 (5.13) to (5.15). Every load step is a time step.
    Dynamic,
}

/// One term of the relaxation function, zhang-2017 (5.30).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prony {
    /// Share of the stress that fades.
    pub share: f64,
    /// Time in which it does \[s\].
    pub time_s: f64,
}

/// Settings of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Default [`Form::Balanced`].
    pub form: Form,
    /// Visits of all cells in each load step; 20 as in zhang-2017.
    pub iterations: u32,
    /// Parts in which a step's change of held nodes and loads is applied; 1.
    pub load_steps: u32,
    /// Density \[kg/m^3\]; 1000.
    pub density_kg_per_m3: f64,
    /// Default [`Lanes::Wide`].
    pub lanes: Lanes,
    /// Viscoelasticity; none. Only with [`Form::Balanced`].
    pub relaxation: Vec<Prony>,
    /// Default [`Motion::QuasiStatic`].
    pub motion: Motion,
    /// Residual at which iterations stop; 1e-4.
    pub tolerance: f64,
    /// Most points of the lattice that carries the smooth part of a correction ([`Form::Balanced`]); 0
    /// for none. 64: its dense inverse fits a second-level cache beside the cells and costs a tenth of a visit.
    pub lattice_points: u32,
    /// Stiffness with which a quasi-static [`Form::Compliant`] step holds each node back, as a share of the
    /// node's own stiffness; 6, as with 3 momentum diverges on a slender beam. Does not move the point of balance, only the way there.
    pub proximity: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            form: Form::Balanced,
            iterations: 20,
            load_steps: 1,
            density_kg_per_m3: 1_000.0,
            lanes: Lanes::Wide,
            relaxation: Vec::new(),
            motion: Motion::QuasiStatic,
            tolerance: 1e-4,
            lattice_points: 64,
            proximity: 6.0,
        }
    }
}

impl Settings {
    /// # Errors
    /// The first setting that is out of range.
    pub(super) fn check(&self) -> Result<(), BuildError> {
        let setting = |name, value: f64, fits, limit| {
            if fits {
                Ok(())
            } else {
                Err(BuildError::Setting { name, value, limit })
            }
        };
        let count = |value: u32| f64::from(value);
        let positive = |x: f64| x.is_finite() && x > 0.0;
        let above = "finite and above zero";
        setting(
            "iterations",
            count(self.iterations),
            self.iterations > 0,
            "at least 1",
        )?;
        setting(
            "load_steps",
            count(self.load_steps),
            self.load_steps > 0,
            "at least 1",
        )?;
        let density = self.density_kg_per_m3;
        setting("density_kg_per_m3", density, positive(density), above)?;
        let proximity = self.proximity;
        setting("proximity", proximity, positive(proximity), above)?;
        let tolerance = self.tolerance;
        let fits = tolerance.is_finite() && tolerance >= 0.0;
        setting("tolerance", tolerance, fits, "finite and not below zero")?;
        setting(
            "lattice_points",
            count(self.lattice_points),
            self.lattice_points <= 1000,
            "at most 1000",
        )?;
        let mut left = 1.0;
        for term in &self.relaxation {
            setting("time_s", term.time_s, positive(term.time_s), above)?;
            let fits = term.share.is_finite() && term.share >= 0.0;
            setting("share", term.share, fits, "finite and not below zero")?;
            left -= term.share;
        }
        setting("sum of shares", 1.0 - left, left > 0.0, "below 1")?;
        let fits = self.relaxation.is_empty() || self.form == Form::Balanced;
        setting(
            "relaxation terms",
            self.relaxation.len() as f64,
            fits,
            "none unless the form is Balanced",
        )
    }
}
