//! Hyperelastic laws: energy density, first Piola-Kirchhoff stress and its change with F.
//!
//! Entry point: [`Law`]. After zhang-2017, 5.2.5, with P = dPsi/dF derived by hand and checked by finite
//! differences; the fibre term of (5.38) is corrected to `2 eta J^(-2/3) (I4bar - 1) (A0 - I4/3 C^-1)`.

use crate::Material;
use nalgebra::{Matrix3, Vector3};

/// A law with its moduli \[Pa\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    /// St Venant-Kirchhoff, zhang-2017 (5.33). Softens under compression: its force is largest at a
    /// stretch of 0.58 and nothing resists inversion.
    StVenantKirchhoff {
        /// First Lame parameter.
        lambda: f64,
        /// Shear modulus.
        mu: f64,
    },
    /// Neo-Hookean, zhang-2017 (5.35), with fibres (5.37) where `eta` is not zero.
    NeoHookean {
        /// Shear modulus.
        mu: f64,
        /// Bulk modulus.
        kappa: f64,
        /// Modulus of the fibres; zero for none.
        eta: f64,
        /// Direction of the fibres at rest, a unit vector.
        fibre: Vector3<f64>,
    },
}

impl Law {
    /// St Venant-Kirchhoff of a material.
    pub fn st_venant_kirchhoff(material: Material) -> Self {
        let (lambda, mu) = material.lame();
        Self::StVenantKirchhoff { lambda, mu }
    }

    /// Neo-Hookean of a material: kappa = E / (3 (1 - 2 nu)).
    pub fn neo_hookean(material: Material) -> Self {
        let (lambda, mu) = material.lame();
        Self::NeoHookean {
            mu,
            kappa: lambda + 2.0 / 3.0 * mu,
            eta: 0.0,
            fibre: Vector3::z(),
        }
    }

    /// Transversely isotropic neo-Hookean with fibres of modulus `eta_pa` along `fibre`, which is
    /// normalised; zhang-2017 sets eta = 2 mu.
    pub fn fibred(material: Material, eta_pa: f64, fibre: [f64; 3]) -> Self {
        let (lambda, mu) = material.lame();
        Self::NeoHookean {
            mu,
            kappa: lambda + 2.0 / 3.0 * mu,
            eta: eta_pa,
            fibre: Vector3::from(fibre).normalize(),
        }
    }

    /// Energy density \[J/m^3\] at the deformation gradient `f`; infinite where a neo-Hookean cell is
    /// flat or inverted.
    pub fn energy(&self, f: &Matrix3<f64>) -> f64 {
        match *self {
            Self::StVenantKirchhoff { lambda, mu } => {
                let e = 0.5 * (f.tr_mul(f) - Matrix3::identity());
                0.5 * lambda * e.trace().powi(2) + mu * e.norm_squared()
            }
            Self::NeoHookean {
                mu,
                kappa,
                eta,
                fibre,
            } => {
                let j = f.determinant();
                if j <= 0.0 {
                    return f64::INFINITY;
                }
                let shape = j.powf(-2.0 / 3.0);
                let along = shape * (f * fibre).norm_squared() - 1.0;
                0.5 * mu * (shape * f.norm_squared() - 3.0)
                    + 0.5 * eta * along * along
                    + 0.5 * kappa * (j - 1.0) * (j - 1.0)
            }
        }
    }

    /// First Piola-Kirchhoff stress P = dPsi/dF \[Pa\]; not finite where the energy is not.
    pub fn stress(&self, f: &Matrix3<f64>) -> Matrix3<f64> {
        match *self {
            Self::StVenantKirchhoff { lambda, mu } => {
                let e = 0.5 * (f.tr_mul(f) - Matrix3::identity());
                f * (2.0 * mu * e + Matrix3::from_diagonal_element(lambda * e.trace()))
            }
            Self::NeoHookean {
                mu,
                kappa,
                eta,
                fibre,
            } => {
                let j = f.determinant();
                let cofactor = cofactor(f);
                let inverse = cofactor / j;
                let shape = if j > 0.0 {
                    j.powf(-2.0 / 3.0)
                } else {
                    f64::NAN
                };
                let turned = f * fibre;
                let i4 = turned.norm_squared();
                let pull = 2.0 * eta * shape * (shape * i4 - 1.0);
                mu * shape * (f - inverse * (f.norm_squared() / 3.0))
                    + pull * (turned * fibre.transpose() - inverse * (i4 / 3.0))
                    + kappa * (j - 1.0) * cofactor
            }
        }
    }

    /// Change of P with a small change `df` of F \[Pa\].
    pub fn stress_change(&self, f: &Matrix3<f64>, df: &Matrix3<f64>) -> Matrix3<f64> {
        match *self {
            Self::StVenantKirchhoff { lambda, mu } => {
                let e = 0.5 * (f.tr_mul(f) - Matrix3::identity());
                let de = 0.5 * (df.tr_mul(f) + f.tr_mul(df));
                df * (2.0 * mu * e + Matrix3::from_diagonal_element(lambda * e.trace()))
                    + f * (2.0 * mu * de + Matrix3::from_diagonal_element(lambda * de.trace()))
            }
            Self::NeoHookean {
                mu,
                kappa,
                eta,
                fibre,
            } => {
                let j = f.determinant();
                let cofactor = cofactor(f);
                let inverse = cofactor / j;
                let d_inverse = -inverse * df.transpose() * inverse;
                let dj = cofactor.dot(df);
                let shape = if j > 0.0 {
                    j.powf(-2.0 / 3.0)
                } else {
                    f64::NAN
                };
                let d_shape = -2.0 / 3.0 * shape * dj / j;
                let i1 = f.norm_squared();
                let di1 = 2.0 * f.dot(df);
                let (turned, d_turned) = (f * fibre, df * fibre);
                let i4 = turned.norm_squared();
                let di4 = 2.0 * turned.dot(&d_turned);
                let pull = 2.0 * eta * shape * (shape * i4 - 1.0);
                let d_pull = 2.0
                    * eta
                    * (d_shape * (shape * i4 - 1.0) + shape * (d_shape * i4 + shape * di4));
                let row = fibre.transpose();
                mu * d_shape * (f - inverse * (i1 / 3.0))
                    + mu * shape * (df - inverse * (di1 / 3.0) - d_inverse * (i1 / 3.0))
                    + d_pull * (turned * row - inverse * (i4 / 3.0))
                    + pull * (d_turned * row - inverse * (di4 / 3.0) - d_inverse * (i4 / 3.0))
                    + kappa * dj * cofactor
                    + kappa * (j - 1.0) * (dj * inverse + j * d_inverse)
            }
        }
    }
}

/// dJ/dF = J F^-T, also of a singular matrix.
pub fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c] = [0, 1, 2].map(|column| f.column(column).into_owned());
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIVER: Material = Material {
        youngs_modulus_pa: 3_500.0,
        poisson_ratio: 0.45,
    };

    fn laws() -> [Law; 3] {
        [
            Law::st_venant_kirchhoff(LIVER),
            Law::neo_hookean(LIVER),
            Law::fibred(LIVER, 2_400.0, [1.0, 2.0, -0.5]),
        ]
    }

    fn near_identity() -> impl Strategy<Value = Matrix3<f64>> {
        proptest::array::uniform9(-0.25..0.25)
            .prop_map(|entries: [f64; 9]| Matrix3::identity() + Matrix3::from_row_slice(&entries))
    }

    proptest! {
        #[test]
        fn stress_is_the_gradient_of_the_energy(f in near_identity(), df in near_identity()) {
            for law in laws() {
                let h = 1e-5;
                let by_difference =
                    (law.energy(&(f + h * df)) - law.energy(&(f - h * df))) / (2.0 * h);
                let exact = law.stress(&f).dot(&df);
                prop_assert!((exact - by_difference).abs() < 1e-7 * (1e3 + exact.abs()), "{law:?}");
            }
        }

        #[test]
        fn stress_change_is_the_derivative_of_stress(f in near_identity(), df in near_identity()) {
            for law in laws() {
                let h = 1e-5;
                let by_difference = (law.stress(&(f + h * df)) - law.stress(&(f - h * df))) / (2.0 * h);
                let exact = law.stress_change(&f, &df);
                prop_assert!((exact - by_difference).norm() < 1e-6 * exact.norm(), "{law:?}");
            }
        }

        #[test]
        fn a_rotation_changes_nothing(f in near_identity(), axis in proptest::array::uniform3(-2.0..2.0)) {
            let turn = nalgebra::Rotation3::new(Vector3::from(axis)).into_inner();
            for law in laws() {
                let (still, turned) = (law.energy(&f), law.energy(&(turn * f)));
                prop_assert!((still - turned).abs() < 1e-9 * (1.0 + still));
                let difference: Matrix3<f64> = law.stress(&(turn * f)) - turn * law.stress(&f);
                prop_assert!(difference.norm() < 1e-8 * (1.0 + law.stress(&f).norm()));
            }
        }
    }

    #[test]
    fn at_rest_it_is_the_linear_material() {
        let (lambda, mu) = LIVER.lame();
        let strain = Matrix3::new(0.3, 0.1, -0.2, 0.1, -0.4, 0.5, -0.2, 0.5, 0.2);
        let linear = 2.0 * mu * strain + Matrix3::from_diagonal_element(lambda * strain.trace());
        for law in &laws()[..2] {
            assert!(law.stress(&Matrix3::identity()).norm() < 1e-9);
            let change = law.stress_change(&Matrix3::identity(), &strain);
            assert!((change - linear).norm() < 1e-9 * linear.norm(), "{law:?}");
        }
    }
}
