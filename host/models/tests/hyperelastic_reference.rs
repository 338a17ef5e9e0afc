//! Newton's method against programs that are not ours, on the same meshes.

use serde_json::Value;
use sutura_mesh::{TetMesh, read_msh};
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

fn data(name: &str) -> String {
    let path = format!("{}/../../tests/data/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).expect("test data")
}

fn three(value: &Value) -> [f64; 3] {
    let numbers = value.as_array().expect("an array");
    [0, 1, 2].map(|axis| numbers[axis].as_f64().expect("a number"))
}

fn nodes(value: &Value) -> Vec<u32> {
    let numbers = value.as_array().expect("an array");
    numbers
        .iter()
        .map(|node| node.as_u64().expect("a node") as u32)
        .collect()
}

struct Case {
    mesh: TetMesh,
    law: Law,
    held: Vec<(u32, [f64; 3])>,
    force_n: Vec<[f64; 3]>,
    expected: Vec<[f64; 3]>,
    moved: Vec<u32>,
    reaction: Option<[f64; 3]>,
}

fn case(name: &str) -> Case {
    let json: Value = serde_json::from_str(&data(name)).expect("JSON");
    let scale = json["scale_to_m"].as_f64().expect("a scale");
    let mesh = read_msh(&data(json["mesh"].as_str().expect("a mesh")), scale).expect("a mesh");
    let material = Material {
        youngs_modulus_pa: json["material"]["youngs_modulus_pa"].as_f64().expect("E"),
        poisson_ratio: json["material"]["poisson_ratio"].as_f64().expect("nu"),
    };
    let mut held: Vec<_> = nodes(&json["fixed_nodes"])
        .into_iter()
        .map(|node| (node, [0.0; 3]))
        .collect();
    let mut moved = Vec::new();
    if !json["moved_nodes"].is_null() {
        moved = nodes(&json["moved_nodes"]);
        let by = three(&json["moved_by_m"]);
        held.extend(moved.iter().map(|&node| (node, by)));
    }
    held.sort_unstable_by_key(|(node, _)| *node);
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    for load in json["loads"].as_array().into_iter().flatten() {
        force_n[load["node"].as_u64().expect("a node") as usize] = three(&load["force_n"]);
    }
    Case {
        mesh,
        law: Law::neo_hookean(material),
        held,
        force_n,
        expected: json["displacement_m"]
            .as_array()
            .expect("rows")
            .iter()
            .map(three)
            .collect(),
        moved,
        reaction: json["reaction_on_moved_n"]
            .as_array()
            .map(|_| three(&json["reaction_on_moved_n"])),
    }
}

fn norm(x: impl Iterator<Item = f64>) -> f64 {
    x.map(|x| x * x).sum::<f64>().sqrt()
}

/// Displacement of every node within 1e-5 of the largest, reaction within 1e-5 of itself. The files have
/// nine digits.
fn agrees(name: &str) {
    let case = case(name);
    let mut tissue =
        Hyperelastic::new(&case.mesh, &[case.law], Settings::default()).expect("tissue");
    let drive = BoundaryConditions {
        held: &case.held,
        force_n: &case.force_n,
    };
    let done = tissue.step(&drive, 0.0);
    assert_eq!(done.outcome, Outcome::Converged, "{done:?}");
    let found = tissue.positions_m().iter().zip(case.mesh.points_m());
    let (mut most, mut largest) = (0.0f64, 0.0f64);
    for ((x, rest), expected) in found.zip(&case.expected) {
        most = most.max(norm((0..3).map(|i| x[i] - rest[i] - expected[i])));
        largest = largest.max(norm(expected.iter().copied()));
    }
    println!(
        "{name}: displacement off by {:.1e} of {largest} m, {} iterations, residual {:.1e}",
        most / largest,
        done.iterations,
        done.residual
    );
    assert!(most < 1e-5 * largest, "{most} of {largest}");
    if let Some(expected) = case.reaction {
        let mut sum = [0.0; 3];
        for ((node, _), reaction) in case.held.iter().zip(tissue.reactions_n()) {
            if case.moved.contains(node) {
                sum = [0, 1, 2].map(|i| sum[i] + reaction[i]);
            }
        }
        let off = norm((0..3).map(|i| sum[i] - expected[i])) / norm(expected.iter().copied());
        println!("{name}: reaction off by {off:.1e}");
        assert!(off < 1e-5, "{sum:?} {expected:?}");
    }
}

#[test]
fn a_stretched_beam() {
    agrees("neo-beam-axial.json");
}

#[test]
fn a_bent_beam() {
    agrees("neo-beam-bend.json");
}

#[test]
fn a_compressed_cylinder() {
    agrees("neo-cylinder-compressed.json");
}

#[test]
fn a_sheared_cube() {
    agrees("neo-cube-sheared.json");
}

/// zhang-2017's beam on `beam_1000.msh`: mean displacement \[m\] of the right face along an axis under
/// a force along it \[N\].
fn tip(cells: Cells, poisson_ratio: f64, axis: usize, force: f64) -> f64 {
    let Case { mesh, held, .. } = case("neo-beam-axial.json");
    let law = Law::neo_hookean(Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio,
    });
    let settings = Settings {
        cells,
        ..Settings::default()
    };
    let far = |node: &u32| mesh.points_m()[*node as usize][0];
    let end = (0..mesh.points_m().len() as u32)
        .map(|node| far(&node))
        .fold(f64::MIN, f64::max);
    let mut face = mesh.surface().triangles;
    face.retain(|triangle| triangle.iter().all(|node| far(node) > end - 1e-9));
    let mut tissue = Hyperelastic::new(&mesh, &[law], settings).expect("tissue");
    let mut force_n = [0.0; 3];
    force_n[axis] = force;
    tissue.add_traction(&face, force_n).expect("faces");
    let drive = BoundaryConditions {
        held: &held,
        force_n: &[],
    };
    let done = tissue.step(&drive, 0.0);
    assert_eq!(done.outcome, Outcome::Converged, "{done:?}");
    let tip = tissue.mean_displacement_m(&face)[axis];
    println!(
        "{cells:?}, nu {poisson_ratio}, axis {axis}: {:.5} mm",
        1e3 * tip
    );
    tip
}

/// Origin: felupe 11.3.0 on the same mesh, linear and quadratic cells, to the digits that are known.
#[test]
fn a_stretched_beam_of_quadratic_cells() {
    assert!((tip(Cells::Linear, 0.49, 0, 0.8) - 13.004_78e-3).abs() < 0.6e-8);
    assert!((tip(Cells::Quadratic, 0.49, 0, 0.8) - 13.278e-3).abs() < 0.6e-6);
}

/// Linear cells lock, averaged ones much less. Origin: -175 mm of linear and -318.8 mm of quadratic cells in felupe
/// on the same mesh.
#[test]
fn averaged_cells_bend_where_linear_ones_lock() {
    let truth = 318.8e-3;
    let linear = tip(Cells::Linear, 0.49, 2, -0.05);
    assert!((linear + 175e-3).abs() < 0.6e-3);
    let averaged = tip(Cells::Averaged, 0.49, 2, -0.05);
    let missing = |tip: f64| 1.0 + tip / truth;
    assert!(
        missing(linear) > 0.44 && missing(averaged) < 0.16,
        "{averaged}"
    );
}

/// All cells at several Poisson's ratios. Origin at 0.45 and 0.49: felupe, linear and quadratic cells.
/// `cargo test --release -p sutura-models --test all hyperelastic_reference:: -- --ignored --nocapture`.
#[test]
#[ignore = "a minute in the test profile"]
fn bent_beams_of_all_cells() {
    for (nu, known) in [
        (0.0, None),
        (0.3, None),
        (0.45, Some([238.4e-3, 320.8e-3])),
        (0.49, Some([175e-3, 318.8e-3])),
    ] {
        let all = [Cells::Linear, Cells::Averaged, Cells::Quadratic];
        let [linear, averaged, quadratic] = all.map(|cells| tip(cells, nu, 2, -0.05));
        assert!(linear > averaged && averaged > quadratic);
        if let Some([of_linear, of_quadratic]) = known {
            assert!((linear + of_linear).abs() < 0.5e-3);
            assert!((quadratic + of_quadratic).abs() < 0.1e-3);
        }
    }
}
