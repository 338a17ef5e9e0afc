//! Linear tissue against what must come out: patch test, order of convergence, solutions of others.

use nalgebra::{Matrix3, Vector3};
use serde_json::Value;
use std::path::PathBuf;
use sutura_host::fem::{
    Anchor, Handle, LinearTissue, Loads, Material, Materials, NodeLoad, TissueError,
};
use sutura_host::mesh::{TetMesh, read_msh, slab};

const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};

fn data(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/data")
        .join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn data_mesh(name: &str, scale_to_m: f64) -> TetMesh {
    read_msh(&data(name), scale_to_m).expect("a sound mesh")
}

fn point(mesh: &TetMesh, node: u32) -> Vector3<f64> {
    Vector3::from(mesh.points_m()[node as usize])
}

/// A linear field on the boundary has to come back inside, with one stress everywhere.
fn patch_test(mesh: &TetMesh) {
    let gradient = Matrix3::new(1.0, -2.0, 0.5, 0.3, 0.7, -1.1, 0.9, 0.2, -0.4) * 1e-2;
    let shift = Vector3::new(1e-3, -2e-3, 3e-3);
    let field = |node: u32| gradient * point(mesh, node) + shift;
    let boundary = mesh.surface().vertices;
    let loads = Loads {
        fixed_displacement_m: boundary
            .iter()
            .map(|&node| (node, field(node).into()))
            .collect(),
        ..Loads::default()
    };
    let tissue = LinearTissue::new(mesh, SOFT, &boundary).expect("tissue");
    let solution = tissue.solve(&loads).expect("a solution");

    let inner = mesh.points_m().len() - boundary.len();
    assert!(inner > 20, "{inner} nodes are inside");
    let largest = solution
        .displacement_m
        .iter()
        .flatten()
        .fold(0.0f64, |m, u| m.max(u.abs()));
    for (node, u) in (0u32..).zip(&solution.displacement_m) {
        let error = (Vector3::from(*u) - field(node)).norm() / largest;
        assert!(
            error < 1e-12,
            "node {node} is off by {error:e} of the largest displacement"
        );
    }

    let strain = (gradient + gradient.transpose()) * 0.5;
    let (lambda, mu) = SOFT.lame();
    let stress = strain * (2.0 * mu) + Matrix3::identity() * (lambda * strain.trace());
    for (cell, found) in tissue
        .stress(&solution.displacement_m)
        .into_iter()
        .enumerate()
    {
        let error = (Matrix3::from(found) - stress).norm() / stress.norm();
        assert!(error < 1e-11, "cell {cell}: stress off by {error:e}");
    }
    assert!(
        solution.residual < 1e-12,
        "residual {:e}",
        solution.residual
    );
}

#[test]
fn a_linear_field_is_reproduced_on_a_slab() {
    patch_test(&slab([0.08, 0.06, 0.03], [6, 5, 4]).expect("a slab"));
}

#[test]
fn a_linear_field_is_reproduced_on_an_unstructured_mesh() {
    patch_test(&data_mesh("cube_1650.msh", 1.0));
}

/// Two layers of a column in series. With nu = 0 nothing bulges, so linear cells are exact: the stress
/// F / A is everywhere, the strain of each layer F / (A E).
#[test]
fn layers_in_series_stretch_by_their_own_stiffness() {
    let (size, divisions) = ([0.02, 0.03, 0.08], [2, 3, 8]);
    let mesh = slab(size, divisions).expect("a slab");
    let material = |youngs_modulus_pa| Material {
        youngs_modulus_pa,
        poisson_ratio: 0.0,
    };
    let (soft, stiff) = (2e3, 50e3);
    let middle = -0.03;
    let height = |cell: [u32; 4]| cell.iter().map(|&n| point(&mesh, n).z).sum::<f64>() / 4.0;
    let of_cell: Vec<u32> = mesh
        .cells()
        .iter()
        .map(|cell| u32::from(height(*cell) > middle))
        .collect();
    let layers = Materials::by_cell(vec![material(soft), material(stiff)], of_cell.clone());
    let bottom: Vec<u32> = (0..mesh.points_m().len() as u32)
        .filter(|&node| point(&mesh, node).z < 1e-9 - size[2])
        .collect();
    let tissue = LinearTissue::new(&mesh, layers, &bottom).expect("tissue");

    let stress = 300.0;
    // A triangle's corner carries a third of its load.
    let mut forces = Vec::new();
    let surface = mesh.surface();
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|node| point(&mesh, node));
        if a.z.min(b.z).min(c.z) < -1e-9 {
            continue;
        }
        let share = stress * 0.5 * (b - a).cross(&(c - a)).norm() / 3.0;
        forces.extend(triangle.map(|node| NodeLoad {
            node,
            force_n: [0.0, 0.0, share],
        }));
    }
    let loads = Loads {
        forces,
        ..Loads::default()
    };
    let solution = tissue.solve(&loads).expect("a solution");
    for (node, u) in (0u32..).zip(&solution.displacement_m) {
        let z = point(&mesh, node).z;
        let expected =
            stress * ((z.min(middle) + size[2]) / soft + (z.max(middle) - middle) / stiff);
        assert!(
            (u[2] - expected).abs() < 1e-11 && u[0].abs().max(u[1].abs()) < 1e-11,
            "node {node} moved by {u:?}, expected {expected} upwards"
        );
    }
    for found in tissue.stress(&solution.displacement_m) {
        let mut error = Matrix3::from(found);
        error[(2, 2)] -= stress;
        assert!(error.norm() < 1e-9 * stress, "stress off by {error}");
    }
}

#[test]
fn one_material_in_two_regions_is_one_material() {
    let mesh = slab([0.08, 0.06, 0.03], [4, 3, 3]).expect("a slab");
    let bottom: Vec<u32> = (0..20).collect();
    let loads = Loads {
        forces: vec![NodeLoad {
            node: 70,
            force_n: [0.1, -0.2, 0.3],
        }],
        ..Loads::default()
    };
    let regions = Materials::by_cell(
        vec![SOFT, SOFT],
        (0..mesh.cells().len() as u32)
            .map(|cell| cell % 2)
            .collect(),
    );
    let solve = |materials: Materials| {
        let tissue = LinearTissue::new(&mesh, materials, &bottom).expect("tissue");
        tissue.solve(&loads).expect("a solution")
    };
    assert_eq!(solve(regions), solve(SOFT.into()), "bit for bit");

    let too_few = Materials::by_cell(vec![SOFT], vec![0; 3]);
    assert!(matches!(
        LinearTissue::new(&mesh, too_few, &bottom),
        Err(TissueError::Material(_))
    ));
}

/// u = (sin sin sin) in each component, with the body force that balances it.
struct Manufactured {
    lambda: f64,
    mu: f64,
}

impl Manufactured {
    const PI: f64 = std::f64::consts::PI;

    /// Phase of each component, so that they differ.
    fn field(&self, x: Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|c, _| Self::value(c, x, [0, 0, 0]))
    }

    /// Derivative of component c: `orders` times by x, y, z. Component c is
    /// prod_a sin(pi (1 + [a = c]) x_a + 0.3 (c + 1)).
    fn value(c: usize, x: Vector3<f64>, orders: [usize; 3]) -> f64 {
        (0..3)
            .map(|a| {
                let k = Self::PI * if a == c { 2.0 } else { 1.0 };
                let phase = k * x[a] + 0.3 * (c as f64 + 1.0);
                k.powi(orders[a] as i32) * (phase + 0.5 * Self::PI * orders[a] as f64).sin()
            })
            .product()
    }

    fn body_force(&self, x: Vector3<f64>) -> Vector3<f64> {
        let second = |c: usize, a: usize, b: usize| {
            let mut orders = [0; 3];
            orders[a] += 1;
            orders[b] += 1;
            Self::value(c, x, orders)
        };
        Vector3::from_fn(|i, _| {
            let laplacian: f64 = (0..3).map(|j| second(i, j, j)).sum();
            let gradient_of_divergence: f64 = (0..3).map(|j| second(j, j, i)).sum();
            -(self.mu * laplacian + (self.lambda + self.mu) * gradient_of_divergence)
        })
    }
}

/// Quadrature exact to degree 3 (Keast 1986, five points): barycentric coordinates and weights.
fn quadrature() -> [([f64; 4], f64); 5] {
    let near = |corner: usize| {
        let mut at = [1.0 / 6.0; 4];
        at[corner] = 0.5;
        (at, 0.45)
    };
    [([0.25; 4], -0.8), near(0), near(1), near(2), near(3)]
}

#[test]
fn displacement_converges_with_order_two() {
    let material = Material {
        youngs_modulus_pa: 1.0,
        poisson_ratio: 0.3,
    };
    let (lambda, mu) = material.lame();
    let exact = Manufactured { lambda, mu };
    let mut errors = Vec::new();
    for divisions in [4, 8, 16] {
        let mesh = slab([1.0, 1.0, 1.0], [divisions; 3]).expect("a slab");
        let corners = |cell: [u32; 4]| cell.map(|node| point(&mesh, node));
        let volume =
            |p: [Vector3<f64>; 4]| (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0])) / 6.0;
        let boundary = mesh.surface().vertices;
        let mut loads = Loads {
            fixed_displacement_m: boundary
                .iter()
                .map(|&node| (node, exact.field(point(&mesh, node)).into()))
                .collect(),
            ..Loads::default()
        };
        for &cell in mesh.cells() {
            let p = corners(cell);
            for (at, weight) in quadrature() {
                let x: Vector3<f64> = p.iter().zip(at).map(|(p, at)| p * at).sum();
                let force = exact.body_force(x) * (weight * volume(p));
                for (&node, at) in cell.iter().zip(at) {
                    loads.forces.push(NodeLoad {
                        node,
                        force_n: (force * at).into(),
                    });
                }
            }
        }
        let tissue = LinearTissue::new(&mesh, material, &boundary).expect("tissue");
        let u = tissue.solve(&loads).expect("a solution").displacement_m;
        let mut squared = 0.0;
        for &cell in mesh.cells() {
            let p = corners(cell);
            for (at, weight) in quadrature() {
                let x: Vector3<f64> = p.iter().zip(at).map(|(p, at)| p * at).sum();
                let found: Vector3<f64> = cell
                    .iter()
                    .zip(at)
                    .map(|(&n, at)| Vector3::from(u[n as usize]) * at)
                    .sum();
                squared += (found - exact.field(x)).norm_squared() * weight * volume(p);
            }
        }
        errors.push(squared.sqrt());
    }
    let orders: Vec<f64> = errors
        .windows(2)
        .map(|pair| (pair[0] / pair[1]).log2())
        .collect();
    println!("L2 errors {errors:?}, orders {orders:.3?}");
    // 1.8 on the coarse pair, where the field's half waves span only four edges.
    assert!(
        orders[0] > 1.7 && (1.9..2.2).contains(&orders[1]),
        "orders {orders:?}"
    );
}

fn numbers(value: &Value) -> Vec<f64> {
    let values = value.as_array().expect("an array");
    values
        .iter()
        .map(|x| x.as_f64().expect("a number"))
        .collect()
}

fn triples(value: &Value) -> Vec<[f64; 3]> {
    let values = value.as_array().expect("an array");
    values
        .iter()
        .map(|row| numbers(row).try_into().expect("three"))
        .collect()
}

fn indices(value: &Value) -> Vec<u32> {
    numbers(value).into_iter().map(|x| x as u32).collect()
}

/// Largest difference over the largest value.
fn relative(found: &[[f64; 3]], expected: &[[f64; 3]]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let scale = expected
        .iter()
        .flatten()
        .fold(0.0f64, |m, x| m.max(x.abs()));
    let difference = found
        .iter()
        .flatten()
        .zip(expected.iter().flatten())
        .fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
    difference / scale
}

/// Origin: scikit-fem 12.0.2 and SuperLU on the whole KKT system, printed with nine digits.
fn agrees_with_scikit_fem(name: &str) {
    let case: Value = serde_json::from_str(&data(name)).expect("JSON");
    let scale = case["scale_to_m"].as_f64().expect("a scale");
    let mesh = data_mesh(case["mesh"].as_str().expect("a name"), scale);
    let material = Material {
        youngs_modulus_pa: case["material"]["youngs_modulus_pa"].as_f64().expect("E"),
        poisson_ratio: case["material"]["poisson_ratio"].as_f64().expect("nu"),
    };
    let handles = case["handles"]
        .as_array()
        .expect("handles")
        .iter()
        .map(|handle| Handle {
            anchor: Anchor {
                vertices: indices(&handle["vertices"]),
                weights: numbers(&handle["barycentric"]),
            },
            target_displacement_m: numbers(&handle["target_displacement_m"])
                .try_into()
                .expect("three"),
        });
    let loads = Loads {
        handles: handles.collect(),
        ..Loads::default()
    };
    let tissue =
        LinearTissue::new(&mesh, material, &indices(&case["fixed_nodes"])).expect("tissue");
    let solution = tissue.solve(&loads).expect("a solution");
    let displacement = relative(&solution.displacement_m, &triples(&case["displacement_m"]));
    let force = relative(
        &solution.handle_force_n,
        &triples(&case["force_on_tissue_n"]),
    );
    println!(
        "{name}: displacement {displacement:.2e}, force {force:.2e}, residual {:.2e}",
        solution.residual
    );
    assert!(
        displacement < 1e-6,
        "displacement differs by {displacement:e}"
    );
    assert!(force < 1e-6, "force differs by {force:e}");
    // Pulling one point takes a force with a part along the pull.
    if let ([handle], [force]) = (&loads.handles[..], &solution.handle_force_n[..]) {
        let pull = Vector3::from(handle.target_displacement_m);
        assert!(pull.dot(&Vector3::from(*force)) > 0.0);
    }
    // What handles put in, fixed nodes take out.
    let sum: Vector3<f64> = solution
        .node_force_n
        .iter()
        .map(|f| Vector3::from(*f))
        .sum();
    let largest = solution
        .handle_force_n
        .iter()
        .flatten()
        .fold(0.0f64, |m, f| m.max(f.abs()));
    assert!(sum.norm() < 1e-9 * largest, "forces add up to {sum}");
}

#[test]
fn one_handle_on_a_cube_agrees_with_scikit_fem() {
    agrees_with_scikit_fem("linear-cube-1-handle.json");
}

#[test]
fn twenty_handles_on_tubes_agree_with_scikit_fem() {
    agrees_with_scikit_fem("linear-tubes-20-handles.json");
}

#[test]
fn tissue_that_floats_or_has_nothing_to_move_is_refused() {
    let mesh = slab([0.1, 0.1, 0.1], [2, 2, 2]).expect("a slab");
    let refusal = |fixed: &[u32]| LinearTissue::new(&mesh, SOFT, fixed).expect_err("refused");
    assert_eq!(refusal(&[]), TissueError::Floating { fixed: 0 });
    assert_eq!(refusal(&[4]), TissueError::Floating { fixed: 1 });
    // Nodes 0, 1, 2 lie on one edge: the slab can swing about it.
    assert_eq!(refusal(&[0, 1, 2]), TissueError::Floating { fixed: 3 });
    assert!(
        LinearTissue::new(&mesh, SOFT, &[0, 2, 6]).is_ok(),
        "three corners hold it"
    );
    assert_eq!(
        refusal(&(0..27).collect::<Vec<_>>()),
        TissueError::AllFixed(27)
    );
    assert!(matches!(
        refusal(&[27]),
        TissueError::NoSuchNode {
            node: 27,
            nodes: 27,
            ..
        }
    ));
    let stiff = Material {
        poisson_ratio: 0.5,
        ..SOFT
    };
    assert!(matches!(
        LinearTissue::new(&mesh, stiff, &[0]),
        Err(TissueError::Material(_))
    ));
}

#[test]
fn loads_and_handles_that_make_no_sense_are_refused() {
    let mesh = slab([0.1, 0.1, 0.1], [2, 2, 2]).expect("a slab");
    let bottom: Vec<u32> = (0..9).collect();
    let tissue = LinearTissue::new(&mesh, SOFT, &bottom).expect("tissue");
    let handle = |vertices: &[u32], weights: &[f64]| Handle {
        anchor: Anchor {
            vertices: vertices.to_vec(),
            weights: weights.to_vec(),
        },
        target_displacement_m: [0.0, 0.0, 1e-3],
    };
    let refusal = |loads: Loads| tissue.solve(&loads).expect_err("refused");
    let handles = |handles: Vec<Handle>| Loads {
        handles,
        ..Loads::default()
    };
    assert_eq!(
        refusal(handles(vec![handle(&[20], &[1.0]), handle(&[20], &[1.0])])),
        TissueError::HandlesConflict { handle: 1 }
    );
    assert_eq!(
        refusal(handles(vec![handle(&[3], &[1.0])])),
        TissueError::HandlesConflict { handle: 0 }
    );
    assert_eq!(
        refusal(handles(vec![handle(&[20, 21], &[1.0])])),
        TissueError::AnchorWeights { handle: 0 }
    );
    assert!(matches!(
        refusal(handles(vec![handle(&[99], &[1.0])])),
        TissueError::NoSuchNode { node: 99, .. }
    ));
    let force = |node, x| Loads {
        forces: vec![NodeLoad {
            node,
            force_n: [x, 0.0, 0.0],
        }],
        ..Loads::default()
    };
    assert!(matches!(
        refusal(force(99, 1.0)),
        TissueError::NoSuchNode { node: 99, .. }
    ));
    assert_eq!(
        refusal(force(20, f64::NAN)),
        TissueError::NotFinite("a load")
    );
    let moved = Loads {
        fixed_displacement_m: vec![(20, [0.0; 3])],
        ..Loads::default()
    };
    assert_eq!(refusal(moved), TissueError::NotFixed(20));
}
