//! Time of ellipsoid-bounded ChainMail steps by the number of elements moved.
//!
//! `cargo run --release -p sutura-models --example chainmail_speed`

use std::time::Instant;
use sutura_mesh::{TetMesh, slab};
use sutura_models::chainmail::{EllipsoidChainMail, EllipsoidSettings};
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.47,
};

/// One step: elements moved, adjusted, microseconds, whether all links ended within their bounds.
type Sample = (usize, usize, f64, bool);

/// A patch of the top moved by `at(step)`, the bottom held.
fn run(
    mesh: &TetMesh,
    settings: EllipsoidSettings,
    half_m: f64,
    steps: u32,
    at: impl Fn(f64) -> [f64; 3],
) -> Result<Vec<Sample>, Box<dyn std::error::Error>> {
    let heights = mesh.points_m().iter().map(|p| p[2]);
    let low = heights.fold(f64::INFINITY, f64::min);
    let mut tissue = EllipsoidChainMail::new(mesh, LIVER, settings)?;
    let (mut held, mut patch) = (Vec::new(), Vec::new());
    for (node, p) in mesh.points_m().iter().enumerate() {
        let top = p[2] > -1e-9 && p[0].abs() <= half_m && p[1].abs() <= half_m;
        if top || p[2] < low + 1e-9 {
            if top {
                patch.push(held.len());
            }
            held.push((node as u32, [0.0; 3]));
        }
    }
    let mut samples = Vec::new();
    for step in 1..=steps {
        let by = at(f64::from(step) * 1e-3);
        for index in &patch {
            held[*index].1 = by;
        }
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let start = Instant::now();
        let report = tissue.step(&drive, 1e-3);
        let us = start.elapsed().as_secs_f64() * 1e6;
        let within = report.outcome == Outcome::Converged;
        samples.push((tissue.moved(), tissue.adjusted(), us, within));
    }
    Ok(samples)
}

/// The same mesh with its nodes numbered at random.
fn shuffled(mesh: &TetMesh) -> Result<TetMesh, Box<dyn std::error::Error>> {
    let mut number: Vec<u32> = (0..mesh.points_m().len() as u32).collect();
    let mut state = 1u64;
    for last in (1..number.len()).rev() {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        number.swap(last, (state >> 33) as usize % (last + 1));
    }
    let mut points_m = vec![[0.0; 3]; number.len()];
    for (point, to) in mesh.points_m().iter().zip(&number) {
        points_m[*to as usize] = *point;
    }
    let cells = mesh.cells().iter();
    let cells = cells.map(|cell| cell.map(|node| number[node as usize]));
    Ok(TetMesh::new(points_m, cells.collect())?)
}

/// Median, tenth and ninetieth hundredth.
fn spread(mut values: Vec<f64>) -> (f64, f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
    (at(0.5), at(0.1), at(0.9))
}

fn print(what: &str, samples: &[Sample]) {
    if samples.is_empty() {
        return;
    }
    let (us, us_low, us_high) = spread(samples.iter().map(|s| s.2).collect());
    let (ns, ns_low, ns_high) = spread(samples.iter().map(|s| 1e3 * s.2 / s.0 as f64).collect());
    let (moved, ..) = spread(samples.iter().map(|s| s.0 as f64).collect());
    let (adjusted, ..) = spread(samples.iter().map(|s| s.1 as f64).collect());
    let in_time = samples.iter().filter(|s| s.2 < 1000.0).count();
    let within = samples.iter().filter(|s| s.3).count();
    println!(
        "{what:<34} {moved:>7.0} {adjusted:>9.0} {us:>7.0} ({us_low:.0} - {us_high:.0}) {ns:>7.1} ({ns_low:.1} - {ns_high:.1}) {:>6.1} {:>6.1} {:>6}",
        100.0 * in_time as f64 / samples.len() as f64,
        100.0 * within as f64 / samples.len() as f64,
        samples.len()
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "{:<34} {:>7} {:>9} {:>7} (10 - 90 %) {:>7} (10 - 90 %) {:>6} {:>6} {:>6}",
        "", "moved", "adjusted", "us", "ns each", "% <1ms", "% done", "steps"
    );
    let wave = |mm: f64, hz: f64| {
        move |t: f64| {
            let depth = mm * 1e-3 * (std::f64::consts::TAU * hz * t).sin();
            [0.3 * depth, 0.0, -depth]
        }
    };
    for divisions in [15, 28] {
        let size = 1.25e-3 * divisions as f64;
        let mesh = slab([size; 3], [divisions; 3])?;
        let nodes = mesh.points_m().len();
        let half = 0.25 * size;
        let mm = 150.0 * size;
        let default = EllipsoidSettings::default();
        let samples = run(&mesh, default, half, 1200, wave(mm, 1.0))?;
        print(&format!("poke at 1 Hz, {nodes} nodes"), &samples[200..]);
        let tight = EllipsoidSettings {
            strain_limit: [0.05; 3],
            ..default
        };
        let samples = run(&mesh, tight, size, 1200, wave(45.0 * size, 1.0))?;
        print(&format!("all near 5 %, {nodes} nodes"), &samples[200..]);
        let bare = EllipsoidSettings {
            stiffness: 0.0,
            ..default
        };
        let samples = run(&mesh, bare, half, 1200, wave(mm, 1.0))?;
        print(&format!("as printed, poke, {nodes} nodes"), &samples[200..]);
        let samples = run(&shuffled(&mesh)?, default, half, 700, wave(mm, 1.0))?;
        print(
            &format!("numbered at random, {nodes} nodes"),
            &samples[200..],
        );
    }
    // One large body: its cost follows what moves.
    let mesh = slab([0.075; 3], [60; 3])?;
    let samples = run(&mesh, EllipsoidSettings::default(), 0.004, 400, |t| {
        [0.0, 0.0, -0.05 * t]
    })?;
    let nodes = mesh.points_m().len();
    for (low, high) in [
        (3_500, 4_700),
        (9_000, 11_000),
        (20_000, 23_000),
        (40_000, 45_000),
    ] {
        let within: Vec<Sample> = samples
            .iter()
            .filter(|s| (low..high).contains(&s.0))
            .copied()
            .collect();
        print(&format!("poke at 50 mm/s of {nodes} nodes"), &within);
    }
    Ok(())
}
