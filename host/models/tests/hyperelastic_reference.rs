//! Newton's method against programs that are not ours, on the same meshes.

use serde_json::Value;
use sutura_mesh::{TetMesh, read_msh};
use sutura_models::hyperelastic::{Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{Drive, Material, Outcome, Tissue};

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
    let drive = Drive {
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
