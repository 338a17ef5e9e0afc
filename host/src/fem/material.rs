//! Isotropic linear elasticity: two numbers, checked.

use thiserror::Error;

/// An isotropic material at small strain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Young's modulus \[Pa\], above zero.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio, above -1 and below 0.5.
    pub poisson_ratio: f64,
}

/// Why a material is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MaterialError {
    /// No stiffness, or not a number.
    #[error("Young's modulus is {0} Pa; it must be finite and above zero")]
    YoungsModulus(f64),
    /// Outside the range in which the energy is positive.
    #[error(
        "Poisson's ratio is {0}; it must be above -1 and below 0.5 (0.45 to 0.49 for soft tissue)"
    )]
    PoissonRatio(f64),
}

impl Material {
    /// Checks the two numbers.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(self) -> Result<(), MaterialError> {
        if !(self.youngs_modulus_pa.is_finite() && self.youngs_modulus_pa > 0.0) {
            return Err(MaterialError::YoungsModulus(self.youngs_modulus_pa));
        }
        if !(self.poisson_ratio > -1.0 && self.poisson_ratio < 0.5) {
            return Err(MaterialError::PoissonRatio(self.poisson_ratio));
        }
        Ok(())
    }

    /// Lame's parameters (lambda, mu) \[Pa\].
    pub fn lame(self) -> (f64, f64) {
        let (e, nu) = (self.youngs_modulus_pa, self.poisson_ratio);
        (
            e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)),
            e / (2.0 * (1.0 + nu)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_checked() {
        let material = |youngs_modulus_pa, poisson_ratio| Material {
            youngs_modulus_pa,
            poisson_ratio,
        };
        assert!(material(1.0, 0.49).check().is_ok());
        assert!(material(1.0, -0.5).check().is_ok());
        for (e, nu) in [
            (0.0, 0.3),
            (-1.0, 0.3),
            (f64::NAN, 0.3),
            (f64::INFINITY, 0.3),
            (1.0, 0.5),
            (1.0, -1.0),
            (1.0, f64::NAN),
        ] {
            assert!(material(e, nu).check().is_err(), "{e} {nu}");
        }
    }
}
