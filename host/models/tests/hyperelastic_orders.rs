//! Orders of convergence on a manufactured solution at large strain.
//!
//! The displacement is chosen, and the body force that balances it is worked out from the law's own second
//! derivatives: b = -div P(F(X)), with dP/dX_k = A : dF/dX_k. It vanishes on the boundary, all of which is
//! held, so that nothing is approximated there.

use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;
use sutura_mesh::slab;
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

/// Largest displacement along each axis, of a cube with an edge of 1 m.
const SIZE: [f64; 3] = [0.12, -0.09, 0.1];

/// One factor of cos(pi x) cos(pi y) sin(pi (z + 1)), zero on the slab's boundary: value, first and second
/// derivative.
fn factor(axis: usize, at: f64) -> [f64; 3] {
    let t = PI * (at + if axis == 2 { 1.0 } else { 0.5 });
    [t.sin(), PI * t.cos(), -PI * PI * t.sin()]
}

struct Exact {
    u: Vector3<f64>,
    f: Matrix3<f64>,
    /// Change of F along each axis.
    df: [Matrix3<f64>; 3],
}

fn exact(p: [f64; 3]) -> Exact {
    let mut exact = Exact {
        u: Vector3::zeros(),
        f: Matrix3::identity(),
        df: [Matrix3::zeros(); 3],
    };
    let factors = [0, 1, 2].map(|axis| factor(axis, p[axis]));
    for (i, size) in SIZE.into_iter().enumerate() {
        let derivative = |order: [usize; 3]| {
            size * (0..3)
                .map(|axis| factors[axis][order[axis]])
                .product::<f64>()
        };
        exact.u[i] = derivative([0; 3]);
        for j in 0..3 {
            let mut order = [0; 3];
            order[j] = 1;
            exact.f[(i, j)] += derivative(order);
            for k in 0..3 {
                let mut order = order;
                order[k] += 1;
                exact.df[k][(i, j)] = derivative(order);
            }
        }
    }
    exact
}

/// -div P \[N/m^3\].
fn body_force(law: &Law, p: [f64; 3]) -> [f64; 3] {
    let exact = exact(p);
    let mut force = Vector3::zeros();
    for (k, df) in exact.df.iter().enumerate() {
        force -= law.stress_change(&exact.f, df).column(k);
    }
    force.into()
}

/// An even sampling of each cell: the 20 points of a lattice of order three, moved inwards.
fn samples() -> Vec<[f64; 4]> {
    let mut at = Vec::new();
    for a in 0..=3 {
        for b in 0..=3 - a {
            for c in 0..=3 - a - b {
                let lattice = [a, b, c, 3 - a - b - c];
                at.push(lattice.map(|n| 0.7 * f64::from(n) / 3.0 + 0.075));
            }
        }
    }
    at
}

/// Errors in the L2 norms of displacement \[m\] and gradient, over the unit cube.
fn errors(cells: Cells, law: Law, n: usize) -> [f64; 2] {
    let mesh = slab([1.0; 3], [n; 3]).expect("a cube");
    let settings = Settings {
        cells,
        ..Settings::default()
    };
    let mut tissue = Hyperelastic::new(&mesh, &[law], settings).expect("tissue");
    tissue.add_body_force(|p| body_force(&law, p));
    let held: Vec<_> = mesh
        .surface()
        .vertices
        .iter()
        .map(|&node| (node, [0.0; 3]))
        .collect();
    let drive = BoundaryConditions {
        held: &held,
        force_n: &[],
    };
    let done = tissue.step(&drive, 0.0);
    assert_eq!(done.outcome, Outcome::Converged, "{cells:?} {n}: {done:?}");
    let samples = samples();
    let mut sums = [0.0; 2];
    let weight = 1.0 / (mesh.cells().len() * samples.len()) as f64;
    for (cell, corners) in mesh.cells().iter().enumerate() {
        let p = mesh.corners(*corners);
        for at in &samples {
            let point: Vector3<f64> = (0..4).map(|c| p[c] * at[c]).sum();
            let exact = exact(point.into());
            let (u, f) = tissue.deformation(cell, *at).expect("a cell");
            sums[0] += weight * (Vector3::from(u) - exact.u).norm_squared();
            sums[1] += weight * (Matrix3::from_fn(|i, j| f[i][j]) - exact.f).norm_squared();
        }
    }
    sums.map(f64::sqrt)
}

fn orders(cells: Cells, law: Law, coarse: usize, fine: usize, expected: [f64; 2], within: f64) {
    let (a, b) = (errors(cells, law, coarse), errors(cells, law, fine));
    let span = (fine as f64 / coarse as f64).ln();
    let found = [0, 1].map(|k| (a[k] / b[k]).ln() / span);
    println!(
        "{cells:?}: {coarse} to {fine} cubes an edge, errors {:.2e} {:.2e} to {:.2e} {:.2e}, orders {found:.2?}",
        a[0], a[1], b[0], b[1]
    );
    for k in 0..2 {
        assert!(
            (found[k] - expected[k]).abs() < within,
            "{cells:?} {found:?}"
        );
    }
}

fn neo_hookean() -> Law {
    Law::neo_hookean(Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio: 0.3,
    })
}

#[test]
fn the_strain_is_large() {
    let mut most = 0.0f64;
    for cell in 0..1000 {
        let at = |k: usize| ((cell / k) % 10) as f64 / 9.0;
        let f = exact([at(1) - 0.5, at(10) - 0.5, at(100) - 1.0]).f;
        assert!(f.determinant() > 0.4);
        most = most.max((f.tr_mul(&f) - Matrix3::identity()).norm() / 2.0);
    }
    assert!(most > 0.3, "{most}");
}

#[test]
fn linear_cells_converge_at_orders_two_and_one() {
    orders(Cells::Linear, neo_hookean(), 6, 9, [2.0, 1.0], 0.25);
}

#[test]
fn averaged_cells_converge_at_orders_two_and_one() {
    orders(Cells::Averaged, neo_hookean(), 6, 9, [2.0, 1.0], 0.35);
}

#[test]
fn quadratic_cells_converge_at_orders_three_and_two() {
    orders(Cells::Quadratic, neo_hookean(), 4, 6, [3.0, 2.0], 0.35);
}

/// `cargo test --release -p sutura-models --test all hyperelastic_orders:: -- --ignored --nocapture`, the figures of
/// the book.
#[test]
#[ignore = "minutes in the test profile"]
fn orders_of_fine_meshes() {
    for n in [8, 12, 16] {
        orders(Cells::Linear, neo_hookean(), n, n + 4, [2.0, 1.0], 0.25);
    }
    for n in [4, 8, 12] {
        orders(Cells::Averaged, neo_hookean(), n, n + 4, [2.0, 1.0], 0.5);
    }
    for n in [4, 6, 8] {
        orders(Cells::Quadratic, neo_hookean(), n, n + 2, [3.0, 2.0], 0.35);
    }
}
