//! What bodies of the registry's models are made of.
//!
//! Entry point: [`Substance`].

use sutura_models::Material;
use sutura_models::law::Law;

/// What a body is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Substance {
    /// At small strain, without fibres.
    pub material: Material,
    /// Modulus of fibres over the shear modulus, and their direction.
    pub fibres: Option<(f64, [f64; 3])>,
    /// Share of the stress that fades, and the time in which it does \[s\].
    pub relaxation: Option<(f64, f64)>,
    /// \[kg/m^3\].
    pub density_kg_per_m3: f64,
}

impl Substance {
    /// The law of the answers: neo-Hookean, with fibres if there are any.
    pub fn law(&self) -> Law {
        match self.fibres {
            None => Law::neo_hookean(self.material),
            Some((ratio, direction)) => {
                Law::fibred(self.material, ratio * self.material.lame().1, direction)
            }
        }
    }
}
