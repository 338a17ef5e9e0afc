//! Error against the Newton solution by number of visits, for every form, on zhang-2017's cases.
//!
//! `cargo run --release -p sutura-models --example energy_balance_accuracy`

use serde_json::Value;
use std::error::Error;
use sutura_mesh::{TetMesh, read_msh_raw};
use sutura_models::energy_balance::{EnergyBalance, Form, Lanes, Motion, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

/// A case and its solution.
struct Case {
    name: &'static str,
    mesh: TetMesh,
    held: Vec<(u32, [f64; 3])>,
    moved: Vec<bool>,
    force_n: Vec<[f64; 3]>,
    solution_m: Vec<[f64; 3]>,
    /// Nodes of the red line, and the component that is compared there.
    line: Vec<usize>,
    axis: usize,
    reaction_n: Option<[f64; 3]>,
}

fn triple(value: &Value) -> Result<[f64; 3], Box<dyn Error>> {
    Ok(serde_json::from_value(value.clone())?)
}

fn case(
    name: &'static str,
    file: &str,
    axis: usize,
    on_line: impl Fn(&[f64; 3]) -> bool,
) -> Result<Case, Box<dyn Error>> {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/");
    let read = |file: &str| std::fs::read_to_string(format!("{data}{file}"));
    let json: Value = serde_json::from_str(&read(file)?)?;
    let mesh = read_msh_raw(&read(json["mesh"].as_str().unwrap_or_default())?)?
        .scaled(json["scale_to_m"].as_f64().unwrap_or(1.0))?
        .check()?;
    let nodes = mesh.points_m().len();
    let mut held: Vec<(u32, [f64; 3])> = Vec::new();
    let fixed: Vec<u32> = serde_json::from_value(json["fixed_nodes"].clone())?;
    held.extend(fixed.iter().map(|node| (*node, [0.0; 3])));
    let mut moved_nodes = Vec::new();
    if !json["moved_nodes"].is_null() {
        let by = triple(&json["moved_by_m"])?;
        moved_nodes = serde_json::from_value(json["moved_nodes"].clone())?;
        held.extend(moved_nodes.iter().map(|node| (*node, by)));
    }
    held.sort_by_key(|(node, _)| *node);
    let mut force_n = Vec::new();
    if let Some(loads) = json["loads"].as_array() {
        force_n = vec![[0.0; 3]; nodes];
        for load in loads {
            let node = load["node"].as_u64().unwrap_or_default() as usize;
            force_n[node] = triple(&load["force_n"])?;
        }
    }
    let points = mesh.points_m().iter().enumerate();
    let line = points.filter(|(_, p)| on_line(p)).map(|(k, _)| k).collect();
    Ok(Case {
        name,
        moved: held
            .iter()
            .map(|(node, _)| moved_nodes.contains(node))
            .collect(),
        held,
        force_n,
        solution_m: serde_json::from_value(json["displacement_m"].clone())?,
        line,
        axis,
        reaction_n: triple(&json["reaction_on_moved_n"]).ok(),
        mesh,
    })
}

/// Largest and root mean square error of the compared component on the red line, over its largest value;
/// relative 2-norm of the error of the whole field; of the reaction.
fn errors(case: &Case, model: &EnergyBalance) -> [f64; 4] {
    let u = |node: usize, c: usize| model.positions_m()[node][c] - case.mesh.points_m()[node][c];
    let (mut most, mut squares, mut largest) = (0.0f64, 0.0, 0.0f64);
    for node in &case.line {
        let exact = case.solution_m[*node][case.axis];
        let error = u(*node, case.axis) - exact;
        most = most.max(error.abs());
        squares += error * error;
        largest = largest.max(exact.abs());
    }
    let (mut lack, mut whole) = (0.0, 0.0);
    for (node, exact) in case.solution_m.iter().enumerate() {
        for (c, exact) in exact.iter().enumerate() {
            lack += (u(node, c) - exact).powi(2);
            whole += exact.powi(2);
        }
    }
    let reaction = case.reaction_n.map_or(f64::NAN, |exact| {
        let mut sum = [0.0; 3];
        for (reaction, moved) in model.reactions_n().iter().zip(&case.moved) {
            if *moved {
                (0..3).for_each(|c| sum[c] += reaction[c]);
            }
        }
        let squared = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        (squared([0, 1, 2].map(|c| sum[c] - exact[c])) / squared(exact)).sqrt()
    });
    let rms = (squares / case.line.len() as f64).sqrt();
    [
        most / largest,
        rms / largest,
        (lack / whole).sqrt(),
        reaction,
    ]
}

fn main() -> Result<(), Box<dyn Error>> {
    let cases = [
        case("beam 0.8 N", "neo-beam-axial.json", 0, |_| true)?,
        case("cylinder -0.4 m", "neo-cylinder-compressed.json", 0, |p| {
            p[1].abs() < 0.06 && p[0] > 0.0 && p[0].hypot(p[1]) > 0.499
        })?,
        case("cube 0.5 m", "neo-cube-sheared.json", 2, |p| {
            (p[0] - 2.0).abs() < 1e-6 && (p[1] - 1.0).abs() < 0.16
        })?,
    ];
    let law = Law::neo_hookean(Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio: 0.49,
    });
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    println!(
        "{:16} {:24} {:>5} {:>5} {:>8} {:>9} {:>9} {:>9} {:>9} {:>9} {:>10} {:>9}",
        "case",
        "form",
        "parts",
        "its",
        "visits",
        "line max",
        "line rms",
        "field",
        "reaction",
        "residual",
        "energy J",
        "RED"
    );
    for case in &cases {
        for (name, form, lanes, points, proximity) in [
            ("printed", Form::Printed, Lanes::Scalar, 0, 1.0),
            ("averaged", Form::Averaged, Lanes::Scalar, 0, 1.0),
            ("compliant", Form::Compliant, Lanes::Scalar, 0, 6.0),
            (
                "balanced, no lattice",
                Form::Balanced,
                Lanes::Scalar,
                0,
                1.0,
            ),
            ("balanced", Form::Balanced, Lanes::Scalar, 64, 1.0),
            ("balanced, wide", Form::Balanced, Lanes::Wide, 64, 1.0),
        ] {
            if !chosen.is_empty() && !chosen.iter().any(|c| c == name) {
                continue;
            }
            for (load_steps, iterations) in [
                (1, 10),
                (1, 20),
                (1, 50),
                (1, 100),
                (1, 200),
                (1, 500),
                (1, 1000),
                (1, 2000),
            ] {
                let mut model = EnergyBalance::new(
                    &case.mesh,
                    &[law],
                    Settings {
                        form,
                        iterations,
                        load_steps,
                        lanes,
                        lattice_points: points,
                        proximity,
                        tolerance: 1e-9,
                        motion: Motion::QuasiStatic,
                        ..Settings::default()
                    },
                )?;
                let drive = BoundaryConditions {
                    held: &case.held,
                    force_n: &case.force_n,
                };
                let report = model.step(&drive, 0.01);
                let [most, rms, field, reaction] = errors(case, &model);
                print!(
                    "{:16} {name:24} {load_steps:5} {iterations:5} {:8}",
                    case.name, report.iterations
                );
                if let Outcome::Failed(why) = report.outcome {
                    println!(" failed: {why}");
                } else {
                    println!(
                        " {most:9.2e} {rms:9.2e} {field:9.2e} {reaction:9.2e} {:9.2e} {:10.4e} {:9.2e}",
                        report.residual, report.energy_j, report.energy_difference
                    );
                }
            }
        }
    }
    Ok(())
}
