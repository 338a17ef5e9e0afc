//! Principal stresses of a stress tensor, and the equivalent stress of von Mises.
//!
//! Entry points: [`principal_stress_pa`], [`von_mises_pa`]. Any text on elasticity, e.g. Timoshenko & Goodier,
//! art. 77.

use nalgebra::Matrix3;

/// Principal values of a symmetric stress (3 x 3), descending, tension positive, in its unit; of what is no number
/// none is a number. Turning the stress does not change them.
pub fn principal_stress_pa(stress_pa: &[[f64; 3]; 3]) -> [f64; 3] {
    let stress = Matrix3::from(*stress_pa);
    let stress = (stress + stress.transpose()) * 0.5;
    let scale = stress.amax();
    // Neither the iteration nor the largest of the entries sees what is no number.
    if !stress.iter().all(|x| x.is_finite()) {
        return [f64::NAN; 3];
    }
    if scale == 0.0 {
        return [0.0; 3];
    }
    let mut principal: [f64; 3] = (stress / scale).symmetric_eigenvalues().into();
    principal.sort_by(|a, b| b.total_cmp(a));
    principal.map(|value| value * scale)
}

/// Equivalent stress of von Mises: the tension along one axis that distorts as much.
pub fn von_mises_pa(principal_pa: &[f64; 3]) -> f64 {
    let [a, b, c] = principal_pa;
    (a - b).hypot(b - c).hypot(c - a) * std::f64::consts::FRAC_1_SQRT_2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::{CorotationalTissue, Loads, Material, Policy};
    use crate::mesh::{TetMesh, slab};
    use crate::model::{Model, Passes};
    use nalgebra::{Rotation3, Vector3};

    const SOFT: Material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.3,
    };

    fn mesh() -> TetMesh {
        slab([0.03, 0.02, 0.02], [2, 1, 2]).expect("a slab")
    }

    /// Displacement of every node under a deformation gradient \[m\].
    fn displaced(mesh: &TetMesh, gradient: &Matrix3<f64>) -> Vec<[f64; 3]> {
        let at = |point: &[f64; 3]| {
            let point = Vector3::from(*point);
            (gradient * point - point).into()
        };
        mesh.points_m().iter().map(at).collect()
    }

    fn models() -> (Model, Model) {
        let (mesh, fixed) = (mesh(), [0, 1, 2, 5]);
        let linear = Model::new(&mesh, SOFT, &fixed, Loads::default(), &[]).expect("a model");
        let turning = Model::corotational(
            &mesh,
            SOFT,
            &fixed,
            Loads::default(),
            &[],
            Policy::default(),
            Passes::default(),
        );
        (linear, turning.expect("a model"))
    }

    fn close(found: [f64; 3], expected: [f64; 3], part: f64) -> bool {
        let scale = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        found
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() <= part * scale)
    }

    /// States of stress by hand: (strain, principal stresses, von Mises). E = 15 kPa, nu = 0.3.
    #[test]
    fn uniform_strain_has_the_stress_of_the_book_in_every_cell() {
        let (e, nu) = (SOFT.youngs_modulus_pa, SOFT.poisson_ratio);
        let (bulk, shear) = (e / (3.0 * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu)));
        let small = 1e-3;
        let cases = [
            // One tension along y: strain -nu across.
            ([-nu, 1.0, -nu], 0.0, [e, 0.0, 0.0], e),
            ([nu, nu, -1.0], 0.0, [0.0, 0.0, -e], e),
            ([1.0; 3], 0.0, [3.0 * bulk; 3], 0.0),
            ([-1.0; 3], 0.0, [-3.0 * bulk; 3], 0.0),
            // Pure shear of 1/2 gamma = 1.
            (
                [0.0; 3],
                1.0,
                [2.0 * shear, 0.0, -2.0 * shear],
                3f64.sqrt() * 2.0 * shear,
            ),
        ];
        let mesh = mesh();
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.9, -1.7, 0.4)).into_inner();
        let axes = Rotation3::from_scaled_axis(Vector3::new(-0.3, 0.8, 1.1)).into_inner();
        let (linear, corotational) = models();
        for (normal, shear, expected, equivalent) in cases {
            let mut strain = Matrix3::from_diagonal(&Vector3::from(normal));
            (strain[(0, 1)], strain[(1, 0)]) = (shear, shear);
            // Along any axes.
            let strain = axes * strain * axes.transpose() * small;
            let stretch = Matrix3::identity() + strain;
            let expected = expected.map(|stress| stress * small);
            for (model, gradient) in [
                (&linear, stretch),
                (&corotational, stretch),
                // Turned as well, which linear tissue takes for strain.
                (&corotational, turn * stretch),
            ] {
                let found = model.principal_stress_pa(&displaced(&mesh, &gradient));
                assert_eq!(found.len(), mesh.cells().len());
                for found in found {
                    assert!(close(found, expected, 1e-10), "{found:?} for {expected:?}");
                    let off = von_mises_pa(&found) - equivalent * small;
                    assert!(off.abs() < 1e-10 * expected[0].abs().max(expected[2].abs()));
                }
            }
        }
        // Of another mesh.
        assert!(linear.principal_stress_pa(&[[0.0; 3]]).is_empty());
        assert!(corotational.principal_stress_pa(&[]).is_empty());
    }

    /// dE/d(stretch along an axis) = volume x principal stress, by central differences, at finite strain and turn.
    #[test]
    fn it_is_the_derivative_of_the_energy() {
        let mesh = mesh();
        let volume = 0.03 * 0.02 * 0.02;
        let axes = Rotation3::from_scaled_axis(Vector3::new(-0.3, 0.8, 1.1)).into_inner();
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.9, -1.7, 0.4)).into_inner();
        let stretch = |values: [f64; 3]| {
            axes * Matrix3::from_diagonal(&Vector3::from(values)) * axes.transpose()
        };
        // Descending, so that the stresses are.
        let values = [1.21, 0.97, 0.88];
        let (linear, corotational) = models();
        let (lambda, mu) = SOFT.lame();
        let of_strain = |values: [f64; 3]| {
            let strain = stretch(values) - Matrix3::identity();
            volume * (mu * strain.norm_squared() + 0.5 * lambda * strain.trace().powi(2))
        };
        let tissue = CorotationalTissue::new(&mesh, SOFT, &[0, 1, 2, 5], Policy::default());
        let tissue = tissue.expect("tissue");
        let of_tissue = |values: [f64; 3]| {
            let mut state = tissue.state();
            let mut work = tissue.workspace();
            let u = displaced(&mesh, &(turn * stretch(values)));
            for (node, u) in (0u32..).zip(&u) {
                match tissue.first_unknown(node) {
                    Some(first) => state.unknowns_mut()[first..first + 3].copy_from_slice(u),
                    None => state.move_fixed(&tissue, node, *u).expect("a fixed node"),
                }
            }
            tissue.update(&mut state, &mut work);
            tissue.energy_j(&work)
        };
        let slope = |energy: &dyn Fn([f64; 3]) -> f64| {
            [0, 1, 2].map(|axis: usize| {
                let at = |step: f64| {
                    let mut values = values;
                    values[axis] += step;
                    energy(values)
                };
                (at(1e-5) - at(-1e-5)) / (2e-5 * volume)
            })
        };
        for (model, gradient, expected) in [
            (&linear, stretch(values), slope(&of_strain)),
            (&corotational, turn * stretch(values), slope(&of_tissue)),
        ] {
            for found in model.principal_stress_pa(&displaced(&mesh, &gradient)) {
                assert!(close(found, expected, 1e-8), "{found:?} for {expected:?}");
            }
        }
    }

    #[test]
    fn any_numbers_have_principal_values_in_order() {
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.9, -1.7, 0.4)).into_inner();
        for values in [
            [3.0, 2.0, 1.0],
            [1.0, 1.0 - 1e-9, -5.0],
            [1e200, 1e-200, -1e150],
            [2e-310, 1e-310, 0.0],
            [0.0; 3],
            [7.0; 3],
        ] {
            let stress = turn * Matrix3::from_diagonal(&Vector3::from(values)) * turn.transpose();
            let found = principal_stress_pa(&stress.into());
            assert!(close(found, values, 1e-12), "{found:?} for {values:?}");
            assert!(found[0] >= found[1] && found[1] >= found[2]);
        }
        for bad in [f64::NAN, f64::INFINITY] {
            let found = principal_stress_pa(&[[1.0, bad, 0.0], [bad, 1.0, 0.0], [0.0; 3]]);
            assert!(found.iter().all(|x| x.is_nan()));
        }
        assert_eq!(von_mises_pa(&[5.0, 5.0, 5.0]), 0.0);
        assert!((von_mises_pa(&[5.0, 2.0, 2.0]) - 3.0).abs() < 1e-15);
    }
}
