//! Nanoseconds per cell and iteration, by law, precision and form.
//!
//! `cargo run --release -p sutura-models --example energy_balance_speed`

use std::error::Error;
use std::time::Instant;
use sutura_mesh::{TetMesh, slab};
use sutura_models::energy_balance::{EnergyBalance, Form, Lanes, Prony, Settings};
use sutura_models::law::Law;
use sutura_models::{Drive, Material, Tissue};

const REPEATS: usize = 201;

/// Seconds of a step, sorted: the bottom held, the top moved a little further every time.
fn steps(mesh: &TetMesh, law: Law, settings: Settings) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut model = EnergyBalance::new(mesh, &[law], settings)?;
    let top = mesh
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MIN, f64::max);
    let bottom = mesh
        .points_m()
        .iter()
        .map(|p| p[2])
        .fold(f64::MAX, f64::min);
    let mut seconds = Vec::with_capacity(REPEATS);
    for repeat in 0..REPEATS + 5 {
        let by = 1e-5 * repeat as f64;
        let held: Vec<(u32, [f64; 3])> = (0u32..)
            .zip(mesh.points_m())
            .filter_map(|(node, p)| {
                if p[2] >= top - 1e-9 {
                    Some((node, [by, 0.0, -by]))
                } else {
                    (p[2] <= bottom + 1e-9).then_some((node, [0.0; 3]))
                }
            })
            .collect();
        let drive = Drive {
            held: &held,
            force_n: &[],
        };
        let start = Instant::now();
        let report = model.step(&drive, 0.001);
        let taken = start.elapsed().as_secs_f64();
        assert!(report.residual.is_finite());
        if repeat >= 5 {
            seconds.push(taken);
        }
    }
    seconds.sort_by(f64::total_cmp);
    Ok(seconds)
}

fn main() -> Result<(), Box<dyn Error>> {
    let material = Material {
        youngs_modulus_pa: 3_500.0,
        poisson_ratio: 0.49,
    };
    let (_, mu) = material.lame();
    let laws = [
        ("neo-Hookean", Law::neo_hookean(material)),
        ("fibred", Law::fibred(material, 2.0 * mu, [0.0, 0.0, 1.0])),
        ("St Venant-Kirchhoff", Law::st_venant_kirchhoff(material)),
    ];
    println!("{:?}", pulp::Arch::new());
    println!(
        "{:>6} {:>6} {:20} {:22} {:7} {:>10} {:>16} {:>10}",
        "cells", "nodes", "law", "form", "lanes", "step ms", "10 to 90 % ms", "ns/cell/it"
    );
    for divisions in [[9, 9, 6], [12, 10, 7], [16, 16, 10]] {
        let mesh = slab([0.1, 0.1, 0.05], divisions)?;
        for (law_name, law) in laws {
            for (form_name, form, lattice_points, prony) in [
                ("balanced, lattice 96", Form::Balanced, 96, false),
                ("balanced, no lattice", Form::Balanced, 0, false),
                ("balanced, Prony term", Form::Balanced, 96, true),
                ("compliant", Form::Compliant, 0, false),
            ] {
                for lanes in [Lanes::Scalar, Lanes::Wide] {
                    let iterations = 20;
                    let relaxation = if prony {
                        vec![Prony {
                            share: 0.5,
                            time_s: 0.58,
                        }]
                    } else {
                        Vec::new()
                    };
                    let settings = Settings {
                        form,
                        lanes,
                        iterations,
                        lattice_points,
                        relaxation,
                        tolerance: 0.0,
                        ..Settings::default()
                    };
                    let seconds = steps(&mesh, law, settings)?;
                    let at = |share: f64| 1e3 * seconds[(share * (REPEATS - 1) as f64) as usize];
                    let visits = f64::from(iterations) * mesh.cells().len() as f64;
                    println!(
                        "{:6} {:6} {law_name:20} {form_name:22} {:7} {:10.3} {:7.3} to {:5.3} {:10.2}",
                        mesh.cells().len(),
                        mesh.points_m().len(),
                        format!("{lanes:?}"),
                        at(0.5),
                        at(0.1),
                        at(0.9),
                        1e6 * at(0.5) / visits,
                    );
                }
            }
        }
    }
    Ok(())
}
