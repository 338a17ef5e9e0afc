//! The dynamic loop of zhang-2017 (5.13) to (5.15) on its beam: what 0.8 N do in one period of it.
//!
//! `cargo run --release -p sutura-models --example energy_balance_loop`. The load is there at once and nothing
//! damps, so the end swings between zero and twice its displacement in balance, 13.0 mm on this mesh.

use serde_json::Value;
use std::error::Error;
use sutura_mesh::read_msh;
use sutura_models::energy_balance::{EnergyBalance, Form, Lanes, Motion, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

fn main() -> Result<(), Box<dyn Error>> {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/");
    let read = |file: &str| std::fs::read_to_string(format!("{data}{file}"));
    let json: Value = serde_json::from_str(&read("neo-beam-axial.json")?)?;
    let mesh = read_msh(&read("beam_1000.msh")?, 1.0)?;
    let fixed: Vec<u32> = serde_json::from_value(json["fixed_nodes"].clone())?;
    let mut held: Vec<(u32, [f64; 3])> = fixed.iter().map(|node| (*node, [0.0; 3])).collect();
    held.sort_by_key(|(node, _)| *node);
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    let mut end = Vec::new();
    for load in json["loads"].as_array().into_iter().flatten() {
        let node = load["node"].as_u64().unwrap_or_default() as usize;
        force_n[node] = serde_json::from_value(load["force_n"].clone())?;
        end.push(node);
    }
    let law = Law::neo_hookean(Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio: 0.49,
    });
    // Length over the speed of a bar's wave, four times; below edge over the dilatational speed (5.12).
    let (period_s, step_s) = (4.0 * 2.0 / (3_000.0f64 / 1_000.0).sqrt(), 0.004);
    println!(
        "{:10} {:>5} {:>10} {:>10} {:>12}",
        "form", "its", "mean mm", "most mm", "energy J"
    );
    for form in [
        Form::Printed,
        Form::Averaged,
        Form::Compliant,
        Form::Balanced,
    ] {
        for iterations in [1, 5, 20] {
            let settings = Settings {
                form,
                iterations,
                motion: Motion::Dynamic,
                lanes: Lanes::Scalar,
                ..Settings::default()
            };
            let mut model = EnergyBalance::new(&mesh, &[law], settings)?;
            let drive = BoundaryConditions {
                held: &held,
                force_n: &force_n,
            };
            let (mut sum, mut most, mut energy_j) = (0.0, 0.0f64, 0.0);
            let steps = (period_s / step_s) as u32;
            for _ in 0..steps {
                let report = model.step(&drive, step_s);
                energy_j = report.energy_j;
                if matches!(report.outcome, Outcome::Failed(_)) {
                    most = f64::INFINITY;
                    break;
                }
                let moved = end
                    .iter()
                    .map(|n| model.positions_m()[*n][0] - mesh.points_m()[*n][0]);
                let mean = moved.sum::<f64>() / end.len() as f64;
                sum += mean / f64::from(steps);
                most = most.max(mean);
            }
            println!(
                "{:10} {iterations:5} {:10.3} {:10.3} {energy_j:12.4e}",
                format!("{form:?}"),
                1e3 * sum,
                1e3 * most
            );
        }
    }
    Ok(())
}
