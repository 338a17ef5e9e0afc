//! Time of a step of 20 visits, by law, form and precision, and how many cells go into a millisecond.
//!
//! `cargo run --release -p sutura-models --example energy_balance_speed`. All that a step does counts: the
//! visits, a last one for energy and residual, and moving the held nodes. Cells at 1 kHz are in proportion.

use std::error::Error;
use std::time::Instant;
use sutura_mesh::{TetMesh, slab};
use sutura_models::energy_balance::{EnergyBalance, Form, Lanes, Prony, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Tissue};

const REPEATS: usize = 101;
const VISITS: u32 = 20;

/// Seconds of a step, sorted, each with as many iterations as were asked for: the bottom held, the top moved to and
/// fro.
fn steps(mesh: &TetMesh, law: Law, settings: Settings) -> Result<Vec<f64>, Box<dyn Error>> {
    let asked = settings.iterations;
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
        let by = 1e-4 * (0.7 * repeat as f64).sin();
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
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let start = Instant::now();
        let report = model.step(&drive, 0.001);
        let taken = start.elapsed().as_secs_f64();
        if repeat >= 5 {
            if report.iterations != asked {
                let done = report.iterations;
                return Err(format!(
                    "{done} iterations in a step, {asked} asked for: not comparable"
                )
                .into());
            }
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
    let neo = ("neo-Hookean", Law::neo_hookean(material));
    let fibred = ("fibred", Law::fibred(material, 2.0 * mu, [0.0, 0.0, 1.0]));
    let st_venant = ("St Venant-Kirchhoff", Law::st_venant_kirchhoff(material));
    let term = Prony {
        share: 0.5,
        time_s: 0.58,
    };
    let bare = Settings {
        lattice_points: 0,
        ..Settings::default()
    };
    let relaxing = Settings {
        relaxation: vec![term],
        ..Settings::default()
    };
    let compliant = Settings {
        form: Form::Compliant,
        ..Settings::default()
    };
    println!(
        "| cells | law | form | lanes | least us | median us | ns a cell and visit | cells at 1 kHz |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (divisions, (law_name, law), form_name, settings) in [
        ([12, 10, 7], neo, "balanced", Settings::default()),
        ([12, 10, 7], fibred, "balanced", Settings::default()),
        ([12, 10, 7], st_venant, "balanced", Settings::default()),
        ([9, 9, 6], neo, "balanced", Settings::default()),
        ([10, 10, 5], fibred, "balanced", Settings::default()),
        ([16, 16, 10], neo, "balanced", Settings::default()),
        ([12, 10, 7], neo, "balanced, no lattice", bare),
        ([12, 10, 7], neo, "balanced, Prony term", relaxing),
        ([12, 10, 7], neo, "compliant", compliant),
    ] {
        let mesh = slab([0.1, 0.1, 0.05], divisions)?;
        let cells = mesh.cells().len();
        for lanes in [Lanes::Wide, Lanes::Scalar] {
            let settings = Settings {
                lanes,
                iterations: VISITS,
                tolerance: 0.0,
                ..settings.clone()
            };
            let seconds = steps(&mesh, law, settings)?;
            let (least, median) = (1e6 * seconds[0], 1e6 * seconds[REPEATS / 2]);
            println!(
                "| {cells} | {law_name} | {form_name} | {lanes:?} | {least:.0} | {median:.0} | {:.1} | {:.0} |",
                1e3 * median / (f64::from(VISITS) * cells as f64),
                1e3 * cells as f64 / median,
            );
        }
    }
    Ok(())
}
