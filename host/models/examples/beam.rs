//! A beam stretched and bent under refinement, with every kind of cell: tip displacement, iterations, time.
//!
//! `cargo run --release -p sutura-models --example beam`; with `coarse`, without the finest meshes.
//! zhang-2017 5.3.1's beam: 2 x 0.2 x 0.2 m, E = 3 kPa, nu = 0.49, left face held, a dead load on the right one.
//! Graded meshes have smaller cells where the exact stress is singular: towards the edges of the held face.

use std::time::Instant;
use sutura_mesh::{MeshError, TetMesh, slab};
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Tissue};

const MATERIAL: Material = Material {
    youngs_modulus_pa: 3_000.0,
    poisson_ratio: 0.49,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let coarse = std::env::args().any(|argument| argument == "coarse");
    println!(
        "| cells | divisions | nodes solved for | pulled by 0.8 N (mm) | bent by 0.05 N (mm) | iterations | s |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (cells, most, graded) in [
        (Cells::Linear, 8, false),
        (Cells::Averaged, 8, false),
        (Cells::Quadratic, 6, false),
        (Cells::Quadratic, 6, true),
    ] {
        for thick in [1, 2, 4, 6, 8] {
            if thick <= most.min(if coarse { 4 } else { 8 }) {
                row(cells, thick, graded)?;
            }
        }
    }
    Ok(())
}

/// The same beam with its nodes drawn towards the held end and the four sides.
fn grade(mesh: &TetMesh) -> Result<TetMesh, MeshError> {
    let side = |y: f64| 0.1 * (y / 0.1 * std::f64::consts::FRAC_PI_2).sin();
    let moved = mesh.points_m().iter().map(|&[x, y, z]| {
        let along = 0.5 * (x + 1.0);
        [2.0 * along.powf(1.5) - 1.0, side(y), side(z + 0.1) - 0.1]
    });
    TetMesh::new(moved.collect(), mesh.cells().to_vec())
}

fn row(cells: Cells, thick: usize, graded: bool) -> Result<(), Box<dyn std::error::Error>> {
    let divisions = [10 * thick, thick, thick];
    let mut mesh = slab([2.0, 0.2, 0.2], divisions)?;
    if graded {
        mesh = grade(&mesh)?;
    }
    let at = |node: &u32, x: f64| (mesh.points_m()[*node as usize][0] - x).abs() < 1e-9;
    let held: Vec<_> = (0..mesh.points_m().len() as u32)
        .filter(|node| at(node, -1.0))
        .map(|node| (node, [0.0; 3]))
        .collect();
    let mut face = mesh.surface().triangles;
    face.retain(|triangle| triangle.iter().all(|node| at(node, 1.0)));
    let (mut tips, mut iterations, mut nodes) = ([0.0; 2], 0, 0);
    let start = Instant::now();
    for (tip, (axis, force)) in tips.iter_mut().zip([(0, 0.8), (2, -0.05)]) {
        let settings = Settings {
            cells,
            ..Settings::default()
        };
        let mut tissue = Hyperelastic::new(&mesh, &[Law::neo_hookean(MATERIAL)], settings)?;
        let mut force_n = [0.0; 3];
        force_n[axis] = force;
        tissue.add_traction(&face, force_n)?;
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let done = tissue.step(&drive, 0.0);
        if done.outcome != sutura_models::Outcome::Converged {
            return Err(format!("{done:?}").into());
        }
        *tip = 1e3 * tissue.mean_displacement_m(&face)[axis];
        iterations += done.iterations;
        nodes = tissue.node_count();
    }
    println!(
        "| {cells:?}{} | {} x {thick} x {thick} | {nodes} | {:.3} | {:.2} | {iterations} | {:.1} |",
        if graded { ", graded" } else { "" },
        10 * thick,
        tips[0],
        tips[1],
        start.elapsed().as_secs_f64()
    );
    Ok(())
}
