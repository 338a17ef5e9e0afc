//! The weight of tissue: what it bends, what carries it, and what tools feel of it.

use nalgebra::{Rotation3, Vector3};
use std::fmt::Write;
use std::path::Path;
use sutura_host::fem::Equilibrium;
use sutura_host::mesh::TetMesh;
use sutura_host::scene::{Document, Pose, Scene, read};
use sutura_host::script::at_rest;
use sutura_host::step::{State, Status, StepOptions, StepReport, step};

const DOWN: [f64; 3] = [0.0, 0.0, -9.81];
/// Tissues with a balance of forces.
const WITH_ROWS: [&str; 3] = ["linear", "corotational", "hyperelastic"];

fn scene(text: &str) -> Scene {
    read(&Document::embedded("test.toml", "".as_ref(), text)).expect("good")
}

/// A bar that lies along x, held at its lower end, of so many cubes along its edges.
fn bar(size_m: [f64; 3], divisions: [usize; 3], tissue: &str) -> String {
    format!(
        "gravity_m_per_s2 = {DOWN:?}\n[mesh.slab]\nsize_m = {size_m:?}\ndivisions = {divisions:?}\n[tissue]\n{tissue}\n\
         [[fixed]]\nplane = {{ axis = \"x\", at_m = {} }}\n",
        -0.5 * size_m[0]
    )
}

/// How it rests, and what nodes get from outside.
fn rest(scene: &Scene) -> Equilibrium {
    let (model, state, _) = scene.build().expect("a balance");
    model.equilibrium(&state).expect("finite")
}

/// Mean drop of the free end of a bar along x \[m\].
fn drop_m(scene: &Scene) -> f64 {
    let points = scene.mesh.points_m();
    let far = points.iter().map(|x| x[0]).fold(f64::MIN, f64::max);
    let rest = rest(scene);
    let end = points.iter().zip(&rest.displacement_m);
    let drops: Vec<f64> = end
        .filter(|(x, _)| (x[0] - far).abs() < 1e-9)
        .map(|(_, u)| -u[2])
        .collect();
    drops.iter().sum::<f64>() / drops.len() as f64
}

/// Force of all that is fixed on the tissue \[N\], (3): what its nodes get from outside without their own weight and loads.
fn reaction_n(scene: &Scene, rest: &Equilibrium) -> Vector3<f64> {
    let mut reaction = Vector3::zeros();
    for node in &scene.fixed {
        reaction += Vector3::from(rest.node_force_n[*node as usize]);
    }
    for load in scene.acting().forces {
        if scene.fixed.binary_search(&load.node).is_ok() {
            reaction -= Vector3::from(load.force_n);
        }
    }
    reaction
}

#[test]
fn trial() {
    let (length, height) = (0.06, 0.015);
    for nu in [0.0, 0.3, 0.45] {
        for n in [2usize, 3, 4, 6, 8] {
            let tissue = format!(
                "youngs_modulus_pa = 200e3\npoisson_ratio = {nu}\ndensity_kg_per_m3 = 1000.0"
            );
            let scene = scene(&bar([length, height, height], [4 * n, n, n], &tissue));
            let (e, rho) = (200e3, 1000.0);
            let load = rho * 9.81 * height * height;
            let bending = load * length.powi(4) / (8.0 * e * height.powi(4) / 12.0);
            let g = e / (2.0 * (1.0 + nu));
            let shear = load * length.powi(2) / (2.0 * 5.0 / 6.0 * g * height * height);
            println!(
                "nu {nu} n {n}: {:.6} mm, beam {:.6}",
                1e3 * drop_m(&scene),
                1e3 * (bending + shear)
            );
        }
    }
}
