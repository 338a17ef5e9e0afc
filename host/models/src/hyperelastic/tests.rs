//! Energy, forces and tangent of every kind of cell and law against one another.

use super::discrete::Discrete;
use super::elastic::Elastic;
use super::{Cells, Hyperelastic, Settings};
use crate::law::Law;
use crate::{BuildError, Material};
use nalgebra::{Rotation3, Vector3};
use sutura_mesh::{TetMesh, slab};

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.45,
};
const CELLS: [Cells; 3] = [Cells::Linear, Cells::Averaged, Cells::Quadratic];

fn laws() -> [Law; 3] {
    [
        Law::st_venant_kirchhoff(LIVER),
        Law::neo_hookean(LIVER),
        Law::fibred(LIVER, 2_400.0, [1.0, 2.0, -0.5]),
    ]
}

fn mesh() -> TetMesh {
    slab([0.3, 0.2, 0.1], [3, 2, 1]).expect("a slab")
}

fn every() -> impl Iterator<Item = (Elastic, String)> {
    CELLS.into_iter().flat_map(|cells| {
        laws().into_iter().map(move |law| {
            let elastic = Elastic::new(Discrete::new(&mesh(), cells), &[law]);
            (elastic, format!("{cells:?} {law:?}"))
        })
    })
}

/// A wave of different sign and size at every node and axis.
fn wave(nodes: usize, seed: f64) -> Vec<Vector3<f64>> {
    (0..nodes)
        .map(|node| {
            let at = seed + 1.7 * node as f64;
            Vector3::new(at.sin(), (2.3 * at).cos(), (0.9 * at + 1.0).sin())
        })
        .collect()
}

fn plus(x: &[Vector3<f64>], share: f64, by: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    x.iter().zip(by).map(|(x, by)| x + share * by).collect()
}

fn gradient(elastic: &mut Elastic, x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut out = vec![Vector3::zeros(); x.len()];
    elastic.gradient(x, &mut out);
    out
}

fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

#[test]
fn forces_and_tangent_are_derivatives_of_one_energy() {
    for (mut elastic, what) in every() {
        let rest = elastic.discrete.rest.clone();
        // Strains of some tens of per cent.
        let x = plus(&rest, 0.008, &wave(rest.len(), 0.3));
        assert!(elastic.energy(&x).is_finite(), "{what}");
        let way = wave(rest.len(), 5.0);
        let h = 1e-7;
        let (ahead, behind) = (plus(&x, h, &way), plus(&x, -h, &way));
        let forces = gradient(&mut elastic, &x);
        let by_difference = (elastic.energy(&ahead) - elastic.energy(&behind)) / (2.0 * h);
        let exact = dot(&forces, &way);
        let scale = dot(&forces, &forces).sqrt();
        assert!(
            (exact - by_difference).abs() < 1e-6 * scale,
            "{what}: {exact} {by_difference}"
        );

        let mut values = vec![0.0; elastic.pattern.entries()];
        elastic.tangent(&x, false, &mut values);
        let mut change = vec![Vector3::zeros(); x.len()];
        elastic.pattern.multiply(&values, &way, &mut change);
        let difference = plus(
            &gradient(&mut elastic, &ahead),
            -1.0,
            &gradient(&mut elastic, &behind),
        );
        let off = plus(&change, -0.5 / h, &difference);
        let relative = (dot(&off, &off) / dot(&change, &change)).sqrt();
        assert!(relative < 1e-6, "{what}: {relative}");

        // Cell by cell, without the matrix.
        let mut product = vec![Vector3::zeros(); x.len()];
        elastic.product(&x, &way, &mut product);
        let off = plus(&product, -1.0, &change);
        let relative = (dot(&off, &off) / dot(&change, &change)).sqrt();
        assert!(relative < 1e-13, "{what}: {relative}");
    }
}

/// Least curvature of a tangent, by power iteration: of the two ends of its spectrum the one that is farther from zero comes first.
fn least_curvature(elastic: &Elastic, values: &[f64], nodes: usize) -> f64 {
    let end = |shift: f64| {
        let (mut way, mut curvature) = (wave(nodes, 0.7), 0.0);
        for _ in 0..3000 {
            let length = dot(&way, &way).sqrt();
            way.iter_mut().for_each(|x| *x /= length);
            let mut change = vec![Vector3::zeros(); nodes];
            elastic.pattern.multiply(values, &way, &mut change);
            curvature = dot(&way, &change);
            way = plus(&change, -shift, &way);
        }
        curvature
    };
    let one = end(0.0);
    one.min(end(one))
}

/// What is pressed hard has negative curvatures, projected it has none, whichever way it lies; at rest both are one. Allocates nothing.
#[test]
fn a_projected_tangent_has_no_negative_curvature() {
    for (mut elastic, what) in every() {
        let rest = elastic.discrete.rest.clone();
        let mut least = |x: &[Vector3<f64>], projected| {
            let mut values = vec![0.0; elastic.pattern.entries()];
            elastic.tangent(x, projected, &mut values);
            (least_curvature(&elastic, &values, x.len()), values)
        };
        let pressed: Vec<_> = rest
            .iter()
            .map(|x| Vector3::new(x.x, x.y, 0.3 * x.z))
            .collect();
        let (plain, values) = least(&pressed, false);
        let largest = values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        assert!(plain < -1e-3 * largest, "{what}: {plain} of {largest}");
        let (projected, _) = least(&pressed, true);
        assert!(
            projected > -1e-9 * largest,
            "{what}: {projected} of {largest}"
        );
        let turn = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        let turned: Vec<_> = pressed.iter().map(|x| turn * x).collect();
        // Of corotated ways the curvature is the same.
        let along = |elastic: &mut Elastic, x: &[Vector3<f64>], way: &[Vector3<f64>]| {
            let mut values = vec![0.0; elastic.pattern.entries()];
            let counted = allocation_counter::measure(|| elastic.tangent(x, true, &mut values));
            assert_eq!(counted.count_total, 0, "{what}");
            let mut change = vec![Vector3::zeros(); x.len()];
            elastic.pattern.multiply(&values, way, &mut change);
            dot(way, &change)
        };
        let way = wave(rest.len(), 5.0);
        let turned_way: Vec<_> = way.iter().map(|x| turn * x).collect();
        let lying = along(&mut elastic, &pressed, &way);
        let standing = along(&mut elastic, &turned, &turned_way);
        assert!(
            (standing / lying - 1.0).abs() < 1e-9,
            "{what}: {standing} {lying}"
        );
        let mut tangent = |projected| {
            let mut values = vec![0.0; elastic.pattern.entries()];
            elastic.tangent(&rest, projected, &mut values);
            values
        };
        let (plain, projected) = (tangent(false), tangent(true));
        for (plain, projected) in plain.iter().zip(&projected) {
            assert!((plain - projected).abs() < 1e-9 * largest, "{what}");
        }
    }
}

/// No force from any motion of a rigid body, at any place; forces and moments of a deformed body sum to
/// nothing.
#[test]
fn rigid_motion_gives_no_force() {
    for (mut elastic, what) in every() {
        let rest = elastic.discrete.rest.clone();
        let turn = Rotation3::from_euler_angles(0.0, std::f64::consts::PI, 0.4);
        let away = Vector3::new(0.5, -1.0, 2.0);
        let rigid = |x: &[Vector3<f64>]| -> Vec<_> { x.iter().map(|x| turn * x + away).collect() };
        let bent = plus(&rest, 0.005, &wave(rest.len(), 1.0));
        let scale = dot(
            &gradient(&mut elastic, &bent),
            &gradient(&mut elastic, &bent),
        )
        .sqrt();
        let turned = gradient(&mut elastic, &rigid(&rest));
        assert!(dot(&turned, &turned).sqrt() < 1e-10 * scale, "{what}");
        assert!(elastic.energy(&rigid(&rest)).abs() < 1e-12, "{what}");
        let still = elastic.energy(&bent);
        assert!(
            (elastic.energy(&rigid(&bent)) / still - 1.0).abs() < 1e-10,
            "{what}"
        );
        let forces = gradient(&mut elastic, &rigid(&bent));
        let sum: Vector3<f64> = forces.iter().sum();
        let moment: Vector3<f64> = rigid(&bent)
            .iter()
            .zip(&forces)
            .map(|(x, force)| x.cross(force))
            .sum();
        assert!(
            sum.norm() < 1e-10 * scale && moment.norm() < 1e-10 * scale,
            "{what}"
        );
    }
}

/// The same state of the same stretch has the same energy in every kind of cell: that of the law.
#[test]
fn kinds_of_cells_agree_where_the_deformation_is_uniform() {
    let f = nalgebra::Matrix3::new(1.2, 0.3, 0.0, -0.1, 0.9, 0.2, 0.1, 0.0, 1.1);
    for (mut elastic, what) in every() {
        let x: Vec<_> = elastic.discrete.rest.iter().map(|x| f * x).collect();
        let expected = 0.006 * elastic.law(0).energy(&f);
        assert!(
            (elastic.energy(&x) / expected - 1.0).abs() < 1e-12,
            "{what}"
        );
    }
}

/// Each cell has its own law.
#[test]
fn laws_go_by_cell() {
    let soft = Law::neo_hookean(LIVER);
    let hard = Law::st_venant_kirchhoff(Material {
        youngs_modulus_pa: 7e4,
        ..LIVER
    });
    let laws: Vec<Law> = (0..mesh().cells().len())
        .map(|cell| if cell % 3 == 0 { hard } else { soft })
        .collect();
    let f = nalgebra::Matrix3::new(1.1, 0.2, 0.0, 0.0, 0.9, 0.1, 0.1, 0.0, 1.1);
    for cells in CELLS {
        let mut elastic = Elastic::new(Discrete::new(&mesh(), cells), &laws);
        let x: Vec<_> = elastic.discrete.rest.iter().map(|x| f * x).collect();
        let volumes = elastic.discrete.volume.clone();
        let terms = volumes.iter().zip(&laws);
        let expected: f64 = terms.map(|(volume, law)| volume * law.energy(&f)).sum();
        assert!(
            (elastic.energy(&x) / expected - 1.0).abs() < 1e-12,
            "{cells:?}"
        );
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let build = |laws: &[Law], settings| Hyperelastic::new(&mesh(), laws, settings).map(|_| ());
    let law = Law::neo_hookean(LIVER);
    let settings = Settings::default();
    assert_eq!(
        build(&[law, law], settings),
        Err(BuildError::Count {
            what: "laws",
            given: 2,
            cells: 36
        })
    );
    let refused = |result| matches!(result, Err(BuildError::Setting { .. }));
    for law in [
        Law::StVenantKirchhoff {
            lambda: -1.0,
            mu: 1.0,
        },
        Law::neo_hookean(Material {
            poisson_ratio: 0.5,
            ..LIVER
        }),
        Law::neo_hookean(Material {
            youngs_modulus_pa: f64::NAN,
            ..LIVER
        }),
        Law::fibred(LIVER, -1.0, [1.0, 0.0, 0.0]),
        Law::fibred(LIVER, 1.0, [0.0; 3]),
    ] {
        assert!(refused(build(&[law], settings)), "{law:?}");
    }
    for tolerance in [0.0, 1.0, f64::NAN] {
        assert!(refused(build(
            &[law],
            Settings {
                tolerance,
                ..settings
            }
        )));
    }
    assert!(refused(build(
        &[law],
        Settings {
            load_steps: 0,
            ..settings
        }
    )));
    assert!(refused(build(
        &[law],
        Settings {
            most_iterations: 0,
            ..settings
        }
    )));
}
